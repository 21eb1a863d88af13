//! Gains that a rig can have.

use super::margins::PoseMargins;
use crate::assembly::{gains, period_s};
use crate::config;
use crate::control::{Gains, Margins, ServoLoop, Tuned, at_bandwidth, stiffest, worst_margins};

/// Margins below which a loop is marginal: gain, up and down, in dB, and phase in degrees.
pub const LEAST_MARGINS: (f64, f64) = (6.0, 30.0);
/// Margins that proposed gains have.
pub const PROPOSED_MARGINS: (f64, f64) = (6.0, 45.0);

/// How often gains are made a little softer when rounding them has cost them a margin.
const SOFTENINGS: u32 = 20;
const SOFTER: f64 = 0.99;

/// Whether a loop is stable and has these margins of gain, up and down, in dB, and of phase in degrees.
pub fn has_margins(margins: &Margins, (gain_db, phase_deg): (f64, f64)) -> bool {
    margins.stable
        && margins.gain_db >= gain_db
        && margins.gain_reduction_db >= gain_db
        && margins.phase_deg >= phase_deg
}

/// The stiffest gains, three digits each, with which a rig in torque mode has [`PROPOSED_MARGINS`] at every pose of `found`, without
/// viscous friction: the rig's own at another bandwidth, or of a usual shape, whichever are stiffer. `None` if there are none.
pub fn proposed_gains(rig: &config::Rig, found: &PoseMargins) -> Option<Tuned> {
    let (own, _) = gains(&rig.control)?;
    let is_wanted = |margins: &Margins| has_margins(margins, PROPOSED_MARGINS);
    let (period_s, delay_cycles) = (period_s(rig), found.delay_cycles);
    let of = |gains: Gains| {
        let margins = worst_margins(&ServoLoop { gains, period_s, delay_cycles }, &found.inertia, 0.0).ok()?;
        is_wanted(&margins).then_some(margins)
    };
    let rounded = |tuned: Tuned| {
        (0..SOFTENINGS).find_map(|times| {
            let factor = crate::elementary::powi(SOFTER, times as i32);
            let gains = in_three_digits(at_bandwidth(tuned.gains, factor));
            Some(Tuned { gains, bandwidth: tuned.bandwidth * factor, margins: of(gains)? })
        })
    };
    let shapes = [own, usual_shape(found.inertia, period_s)];
    shapes
        .into_iter()
        .filter_map(|shape| stiffest(shape, period_s, delay_cycles, &found.inertia, is_wanted))
        .filter_map(rounded)
        .max_by(|one, other| one.gains.stiffness.total_cmp(&other.gains.stiffness))
}

/// Gains whose loop crosses over at a twentieth of the sampling frequency at the middle inertia, and of which position and integral
/// act well below that.
fn usual_shape([least, greatest]: [f64; 2], period_s: f64) -> Gains {
    let inertia = (least * greatest).sqrt();
    let crossover = std::f64::consts::TAU / (20.0 * period_s);
    let damping = inertia * crossover;
    let stiffness = damping * crossover / 5.0;
    Gains { stiffness, damping, integral: stiffness * crossover / 30.0 }
}

fn in_three_digits(gains: Gains) -> Gains {
    let round = |value: f64| format!("{value:.2e}").parse().unwrap_or(value);
    Gains { stiffness: round(gains.stiffness), damping: round(gains.damping), integral: round(gains.integral) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::pose_margins;
    use crate::config::{NotNegative, Positive};

    #[test]
    fn proposed_gains_have_their_margins_whatever_the_rig_has() {
        for name in ["paper-admittance.yaml", "paper-admittance-cartesian.yaml"] {
            let shipped = config::load_rig(config::builtin(name)).unwrap().value;
            for (stiffer, damped, period) in
                [(1.0, 1.0, 1), (40.0, 1.0, 1), (1.0, 0.0, 1), (1.0, 1.0, 4), (1e-3, 50.0, 1)]
            {
                let mut rig = shipped.clone();
                rig.cycle.period_us *= period;
                match &mut rig.control.gains {
                    config::ControlGains::Joint { stiffness_n_m_per_rad: k, damping_n_m_s_per_rad: b, .. }
                    | config::ControlGains::Cartesian { stiffness_n_per_m: k, damping_n_s_per_m: b, .. } => {
                        *k = Positive::new(k.get() * stiffer).unwrap();
                        *b = NotNegative::new(b.get() * damped).unwrap();
                    }
                    config::ControlGains::Rate { .. } => unreachable!(),
                }
                let found = pose_margins(&rig).unwrap().unwrap();
                let tuned =
                    proposed_gains(&rig, &found).unwrap_or_else(|| panic!("{name} {stiffer} {damped} {period}"));
                let servo =
                    ServoLoop { gains: tuned.gains, period_s: period_s(&rig), delay_cycles: found.delay_cycles };
                let margins = worst_margins(&servo, &found.inertia, 0.0).unwrap();
                assert!(has_margins(&margins, PROPOSED_MARGINS), "{name} {stiffer} {damped} {period}: {tuned:?}");
            }
        }
    }
}
