//! Margins of a rig's loop as lines and as JSON.

use serde_json::{Value, json};

use crate::analysis::{PoseMargins, pose_margins};
use crate::config::{CommandMode, ControlGains, Rig};
use crate::control;

/// Gain margin in dB and phase margin in degrees below which a line says so.
const WANTED: (f64, f64) = (6.0, 30.0);

/// What is known of the stability of a rig's position loop.
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

    /// For a person to read.
    pub(super) fn lines(&self) -> Vec<String> {
        match self {
            Self::Torque(margins) => {
                let space = if margins.is_cartesian { "tool" } else { "joints" };
                let unit = if margins.is_cartesian { "kg" } else { "kg m^2" };
                let [least, greatest] = margins.inertia;
                vec![
                    format!(
                        "loop at the {space}, worst pose, {} cycle of delay and the hold, {least:.2} to {greatest:.2} {unit}:",
                        margins.delay_cycles
                    ),
                    format!("with viscous friction     {}", words(&margins.worst.with_friction)),
                    format!("without viscous friction  {}", words(&margins.worst.without_friction)),
                ]
            }
            Self::Velocity { gain_period } => {
                vec![format!(
                    "velocity loop in the drives; rate gain times period {gain_period:.3}, overshoot from 0.25"
                )]
            }
            Self::Position => vec!["position loop in the drives: no margins of this program's own".to_owned()],
            Self::Unknown(why) => vec![format!("no margins: {why}")],
        }
    }

    /// For a program to read.
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

fn words(margins: &control::Margins) -> String {
    let delay_ms = 1e3 * margins.delay_margin_s;
    let text = format!(
        "gain up {:.1} dB, down {:.1} dB, phase {:.1} deg at {:.0} Hz, delay {delay_ms:.2} ms",
        margins.gain_db, margins.gain_reduction_db, margins.phase_deg, margins.crossover_hz
    );
    let (gain_db, phase_deg) = WANTED;
    if !margins.stable {
        format!("UNSTABLE: {text}")
    } else if margins.gain_db < gain_db || margins.gain_reduction_db < gain_db || margins.phase_deg < phase_deg {
        format!("{text}: below {gain_db} dB or {phase_deg} deg")
    } else {
        text
    }
}

/// An infinite margin is `null`: JSON has no infinity.
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
    use crate::config::{Positive, builtin, load_rig};

    fn shipped(name: &str) -> Rig {
        load_rig(builtin(name)).unwrap().value
    }

    #[test]
    fn shipped_torque_rigs_have_wanted_margins() {
        for name in ["paper-admittance.yaml", "paper-admittance-cartesian.yaml"] {
            let margins = Margins::of(&shipped(name));
            let Margins::Torque(found) = &margins else { panic!("{name}: {margins:?}") };
            for case in [found.worst.with_friction, found.worst.without_friction] {
                assert!(case.stable && case.gain_db >= WANTED.0 && case.phase_deg >= WANTED.1, "{name}: {case:?}");
            }
            assert!(margins.lines().iter().all(|line| !line.contains("below")), "{name}");
            let json = margins.to_json();
            assert!(json["without_viscous_friction"]["gain_db"].as_f64().unwrap() >= WANTED.0);
            assert_eq!(json["delay_cycles"], 1.0);
        }
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
        assert!(low[2].contains("below 6 dB or 30 deg"), "{low:?}");
        stiffer(20.0, &mut rig);
        let bad = Margins::of(&rig).lines();
        assert!(bad[2].contains("UNSTABLE"), "{bad:?}");
    }

    #[test]
    fn other_modes_say_where_the_loop_closes() {
        assert!(Margins::of(&shipped("paper-admittance-csp.yaml")).lines()[0].contains("in the drives"));
        let csv = Margins::of(&shipped("paper-admittance-csv.yaml"));
        assert!(csv.lines()[0].contains("0.060"), "{:?}", csv.lines());
        assert_eq!(csv.to_json()["loop"], "drive_velocity");
    }
}
