//! Margins of a rig's loop as lines and as JSON.

use serde_json::{Value, json};

use yieldwall_config::{CommandMode, ControlGains, Diagnostic, Loaded, Rig, Severity};
use yieldwall_motion::control::{self, Gains};
use yieldwall_rig::analysis::{
    LEAST_MARGINS, PROPOSED_MARGINS, PoseMargins, has_margins, pose_margins, proposed_gains,
};

/// Stability of a rig's position loop, as far as it is known.
#[derive(Debug)]
pub(super) enum Margins {
    /// The loop closes in this program.
    Torque(PoseMargins),
    /// The velocity loop closes in the drives: the gain times the period.
    Velocity { gain_period: f64 },
    /// The position loop closes in the drives.
    Position,
    /// They cannot be taken, and why.
    Unknown(String),
}

/// Whether the simulated machine has another inertia than the loop's margins assume; a message then replaces the margins.
pub(super) fn has_other_inertia(rig: &Loaded<Rig>) -> bool {
    rig.warnings.iter().any(|warning| warning.key == "control.feed_forward.inertia")
}

impl Margins {
    /// Takes them from a checked rig.
    pub(super) fn of(rig: &Rig) -> Self {
        match (rig.rig.command_mode, pose_margins(rig), rig.control.gains) {
            (_, Err(error), _) => Self::Unknown(error.to_string()),
            (CommandMode::Torque, Ok(Some(margins)), _) => Self::Torque(margins),
            (CommandMode::Velocity, _, ControlGains::Rate { gain_per_s }) => {
                Self::Velocity { gain_period: *gain_per_s * f64::from(rig.cycle.period_us) * 1e-6 }
            }
            _ => Self::Position,
        }
    }

    /// Whether the loop is known to be unstable: then nothing else that its numbers say of the rig counts.
    pub(super) fn is_unstable(&self) -> bool {
        matches!(self, Self::Torque(found) if !found.worst.without_friction.stable)
    }

    /// Returns a loop that is unstable or marginal, at its gains, with gains that are neither.
    pub(super) fn finding(&self, rig: &Loaded<Rig>) -> Option<Diagnostic> {
        let Self::Torque(found) = self else { return None };
        let worst = found.worst.without_friction;
        if has_margins(&worst, LEAST_MARGINS) {
            return None;
        }
        let key = if found.is_cartesian { "control.gains.cartesian" } else { "control.gains.joint" };
        let (gain_db, phase_deg) = LEAST_MARGINS;
        let message = if worst.stable {
            format!(
                "the gains in `{key}` leave +{:.1}/-{:.1} dB of gain margin and {:.0} degrees of phase margin at the worst pose; the \
                 limits are {gain_db} dB and {phase_deg} degrees",
                worst.gain_db, worst.gain_reduction_db, worst.phase_deg
            )
        } else {
            format!("the gains in `{key}` make the loop unstable at the worst pose along the surface")
        };
        let (gain_db, phase_deg) = PROPOSED_MARGINS;
        let help = match proposed_gains(&rig.value, found) {
            Some(tuned) => {
                let gains = gains_words(tuned.gains, found.is_cartesian);
                format!("write `{gains}`: {gain_db} dB and {phase_deg} degrees by the same computation")
            }
            None => {
                format!("no gains found with {gain_db} dB and {phase_deg} degrees; check the period and the inertia")
            }
        };
        let see = [("cycle.period_us", "the period"), ("control.feed_forward.inertia", "the inertia of the model")];
        Some(rig.finding(Severity::Warning, key, message, help, &see))
    }

    /// Returns the text for a person.
    pub(super) fn lines(&self) -> Vec<String> {
        match self {
            Self::Torque(margins) => {
                let space = if margins.is_cartesian { "tool" } else { "joints" };
                let unit = if margins.is_cartesian { "kg" } else { "kg m^2" };
                let [least, greatest] = margins.inertia;
                vec![
                    format!("loop at the {space}, worst pose:"),
                    format!("inertia              {least:.2} to {greatest:.2} {unit}"),
                    format!("delay                {} + zero-order hold", cycles(margins.delay_cycles)),
                    format!("viscous friction     {}", words(&margins.worst.with_friction)),
                    format!("no viscous friction  {}", words(&margins.worst.without_friction)),
                ]
            }
            Self::Velocity { gain_period } => {
                vec![format!("velocity loop in the drives: rate gain x period {gain_period:.3} (overshoot from 0.25)")]
            }
            Self::Position => vec!["position loop in the drives: no margins to compute here".to_owned()],
            Self::Unknown(why) => vec![format!("no margins: {why}")],
        }
    }

    /// Returns the data for a program.
    pub(super) fn to_json(&self) -> Value {
        match self {
            Self::Torque(margins) => json!({
                "loop": if margins.is_cartesian { "cartesian" } else { "joint" },
                "delay_cycles": margins.delay_cycles,
                "least_inertia": margins.inertia[0],
                "greatest_inertia": margins.inertia[1],
                "inertia_unit": if margins.is_cartesian { "kg" } else { "kg_m2" },
                "with_viscous_friction": figures(&margins.worst.with_friction),
                "without_viscous_friction": figures(&margins.worst.without_friction),
            }),
            Self::Velocity { gain_period } => json!({ "loop": "drive_velocity", "gain_times_period": gain_period }),
            Self::Position => json!({ "loop": "drive_position" }),
            Self::Unknown(why) => json!({ "loop": null, "why": why }),
        }
    }
}

/// Returns a number of cycles, of which one is whole.
fn cycles(count: f64) -> String {
    if count == 1.0 { "1 cycle".to_owned() } else { format!("{count:.2} cycles") }
}

fn words(margins: &control::Margins) -> String {
    let delay_ms = 1e3 * margins.delay_margin_s;
    if !margins.stable {
        return format!("UNSTABLE (phase {:.1} deg at {:.0} Hz)", margins.phase_deg, margins.crossover_hz);
    }
    let text = format!(
        "gain +{:.1}/-{:.1} dB, phase {:.1} deg at {:.0} Hz, delay {delay_ms:.2} ms",
        margins.gain_db, margins.gain_reduction_db, margins.phase_deg, margins.crossover_hz
    );
    let (gain_db, phase_deg) = LEAST_MARGINS;
    if has_margins(margins, LEAST_MARGINS) { text } else { format!("{text}: below {gain_db} dB or {phase_deg} deg") }
}

/// Gains as they are written in a rig.
fn gains_words(gains: Gains, is_cartesian: bool) -> String {
    let Gains { stiffness, damping, integral } = gains;
    if is_cartesian {
        format!(
            "cartesian: {{stiffness_n_per_m: {stiffness:?}, damping_n_s_per_m: {damping:?}, integral_n_per_m_s: {integral:?}}}"
        )
    } else {
        format!(
            "joint: {{stiffness_n_m_per_rad: {stiffness:?}, damping_n_m_s_per_rad: {damping:?}, integral_n_m_per_rad_s: {integral:?}}}"
        )
    }
}

/// Returns an infinite margin as `null`: JSON has no infinity.
fn figures(margins: &control::Margins) -> Value {
    json!({
        "stable": margins.stable,
        "gain_db": margins.gain_db,
        "gain_reduction_db": margins.gain_reduction_db,
        "phase_deg": margins.phase_deg,
        "crossover_hz": margins.crossover_hz,
        "delay_margin_s": margins.delay_margin_s,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_config::{Positive, builtin, load_rig};

    fn shipped(name: &str) -> Rig {
        load_rig(builtin(name)).unwrap().value
    }

    #[test]
    fn shipped_torque_rigs_have_wanted_margins() {
        for name in ["paper-admittance.yaml", "paper-admittance-cartesian.yaml"] {
            let margins = Margins::of(&shipped(name));
            let Margins::Torque(found) = &margins else { panic!("{name}: {margins:?}") };
            for case in [found.worst.with_friction, found.worst.without_friction] {
                assert!(has_margins(&case, LEAST_MARGINS), "{name}: {case:?}");
            }
            assert!(margins.lines().iter().all(|line| !line.contains("below")), "{name}");
            let json = margins.to_json();
            assert!(json["without_viscous_friction"]["gain_db"].as_f64().unwrap() >= LEAST_MARGINS.0);
            assert_eq!(json["delay_cycles"], 1.0);
        }
    }

    /// The shipped rig on EtherCAT, computed early, with its outputs at SYNC0 and on arrival.
    #[test]
    fn outputs_on_arrival_leave_more_margin_than_at_sync0() {
        let shipped = builtin("paper-ethercat.yaml").read().unwrap().replace("like: ", "like: builtin:");
        let [at_sync0, on_arrival] = ["{}", "{outputs: on_arrival}"].map(|bus| {
            let text = shipped.replace("ethercat: {}", &format!("ethercat: {bus}"));
            let text = text + "\ncycle: {period_us: 1000, compute_at_us: 100}\n";
            let rig = yieldwall_config::load_rig(yieldwall_config::Source::memory("rig.yaml", text)).unwrap();
            let margins = Margins::of(&rig.value);
            margins.lines().iter().for_each(|line| eprintln!("{bus}: {line}"));
            let Margins::Torque(found) = margins else { panic!("{margins:?}") };
            found
        });
        assert_eq!(at_sync0.delay_cycles, 1.0);
        // 100 us from SYNC0 to the input frame, 100 to the control step, 40 for computing, and the output frame.
        assert!((0.24..0.26).contains(&on_arrival.delay_cycles), "{on_arrival:?}");
        let [slow, quick] = [at_sync0, on_arrival].map(|found| found.worst.without_friction);
        assert!(quick.phase_deg > slow.phase_deg + 5.0 && quick.gain_db > slow.gain_db + 2.0, "{slow:?} {quick:?}");
    }

    #[test]
    fn low_margins_and_unstable_loops_are_said() {
        let mut rig = shipped("paper-admittance.yaml");
        let stiffer = |factor: f64, rig: &mut Rig| {
            if let ControlGains::Joint { stiffness_n_m_per_rad, .. } = &mut rig.control.gains {
                *stiffness_n_m_per_rad = Positive::new(factor * stiffness_n_m_per_rad.get()).unwrap();
            }
        };
        stiffer(3.0, &mut rig);
        let low = Margins::of(&rig).lines();
        assert!(low[4].contains("below 6 dB or 30 deg"), "{low:?}");
        stiffer(20.0, &mut rig);
        let bad = Margins::of(&rig).lines();
        assert!(bad[4].contains("UNSTABLE (phase ") && !bad[4].contains("dB"), "{bad:?}");
    }

    /// Returns the shipped rig in torque mode with another stiffness.
    fn with_stiffness(stiffness: &str) -> Loaded<Rig> {
        let text = builtin("paper-admittance.yaml").read().unwrap().to_string();
        let (from, to) = ("stiffness_n_m_per_rad: 10000.0", format!("stiffness_n_m_per_rad: {stiffness}"));
        assert!(text.contains(from));
        load_rig(yieldwall_config::Source::memory("rig.yaml", text.replace(from, &to))).unwrap()
    }

    #[test]
    fn a_loop_that_is_unstable_or_marginal_is_a_finding_and_its_advice_mends_it() {
        let shipped = with_stiffness("10000.0");
        assert_eq!(Margins::of(&shipped.value).finding(&shipped), None);
        let found: Vec<_> = ["25000.0", "90000.0"]
            .map(|stiffness| {
                let rig = with_stiffness(stiffness);
                Margins::of(&rig.value).finding(&rig).unwrap()
            })
            .into();
        assert!(found[1].message.contains("unstable"), "{}", found[1].message);
        insta::assert_snapshot!("margins-findings", super::super::render::Renderer::new(false).render(&found));
        // The loop applies the advised values to the rig.
        for finding in found {
            let help = finding.help.unwrap();
            let (_, gains) = help.split_once('{').unwrap();
            let (gains, _) = gains.split_once('}').unwrap();
            let value = |key: &str| {
                let (_, rest) = gains.split_once(&format!("{key}: ")).unwrap();
                rest.split(',').next().unwrap().parse::<f64>().unwrap()
            };
            let mut rig = shipped.value.clone();
            rig.control.gains = ControlGains::Joint {
                stiffness_n_m_per_rad: Positive::new(value("stiffness_n_m_per_rad")).unwrap(),
                damping_n_m_s_per_rad: yieldwall_config::NotNegative::new(value("damping_n_m_s_per_rad")).unwrap(),
                integral_n_m_per_rad_s: yieldwall_config::NotNegative::new(value("integral_n_m_per_rad_s")).unwrap(),
            };
            let Margins::Torque(mended) = Margins::of(&rig) else { panic!("{rig:?}") };
            assert!(has_margins(&mended.worst.without_friction, PROPOSED_MARGINS), "{mended:?}");
        }
    }

    #[test]
    fn other_modes_say_where_the_loop_closes() {
        assert!(Margins::of(&shipped("paper-admittance-csp.yaml")).lines()[0].contains("in the drives"));
        let csv = Margins::of(&shipped("paper-admittance-csv.yaml"));
        assert!(csv.lines()[0].contains("0.060"), "{:?}", csv.lines());
        assert_eq!(csv.to_json()["loop"], "drive_velocity");
    }
}
