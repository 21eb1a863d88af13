//! Gains that a rig can have.

use super::margins::PoseMargins;
use yieldwall_config as config;
use yieldwall_motion::control::{Gains, Margins, ServoLoop, Tuned, at_bandwidth, stiffest, worst_margins};
use yieldwall_motion::elementary;
use yieldwall_run::assembly::{gains, period_s};

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

/// Returns the stiffest gains, of three digits each, with which a rig in torque mode has [`PROPOSED_MARGINS`] at every pose of
/// `found`, without viscous friction. Candidates are the rig's own gains at another bandwidth and gains of a usual shape; the
/// stiffer set wins. `None` if there are none.
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
            let factor = yieldwall_motion::elementary::powi(SOFTER, times as i32);
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

/// Margins of a loop that commands rates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateMargins {
    /// How much the gain may grow, dB.
    pub gain_db: f64,
    /// Phase margin, degrees.
    pub phase_deg: f64,
    /// Lag of the drives, in cycles, with which the loop becomes unstable.
    pub lag_cycles: f64,
}

/// Gain times period of the rate loop from which it overshoots.
const OVERSHOOTS_FROM: f64 = 0.25;

/// Returns the margins of the rate loop with this gain times period, above 0, for drives that follow a rate at once, with one cycle
/// of delay. The open loop is `gain_period / (z (z - 1))`. `None` if it is unstable, at 1 and above.
pub fn rate_margins(gain_period: f64) -> Option<RateMargins> {
    if !(gain_period > 0.0 && gain_period < 1.0) {
        return None;
    }
    // |1 / (z - 1)| is 1 / (2 sin(w / 2)) and its phase -90 degrees - w / 2; the delay takes another w.
    let crossover = 2.0 * elementary::asin(gain_period / 2.0);
    let phase = std::f64::consts::FRAC_PI_2 - 1.5 * crossover;
    // The phase is -180 degrees at a sixth of the sampling frequency, where the gain is that of the loop.
    let gain_db = -20.0 * elementary::log10(gain_period);
    Some(RateMargins { gain_db, phase_deg: phase.to_degrees(), lag_cycles: phase / crossover })
}

/// Returns the greatest rate gain, 1/s, with which drives without lag do not overshoot. It leaves more than [`PROPOSED_MARGINS`],
/// for the lag of drives that are not known.
pub fn proposed_rate_gain(rig: &config::Rig) -> f64 {
    OVERSHOOTS_FROM / period_s(rig)
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
    use yieldwall_config::{NotNegative, Positive};

    #[test]
    fn margins_of_a_rate_loop_are_those_of_its_polynomial() {
        // z^2 - z + k: on the unit circle at k = 1, and with a double pole at k = 1/4.
        let margins = rate_margins(0.5).unwrap();
        assert!((margins.gain_db - 6.0206).abs() < 1e-3, "{margins:?}");
        // |z (z - 1)| = k at the crossover, and its angle there.
        for k in [0.06, 0.25, 0.5, 0.9] {
            let margins = rate_margins(k).unwrap();
            let w = (90.0 - margins.phase_deg).to_radians() / 1.5;
            let z = nalgebra::Complex::new(elementary::cos(w), elementary::sin(w));
            let open = nalgebra::Complex::new(k, 0.0) / (z * (z - 1.0));
            assert!((elementary::hypot(open.re, open.im) - 1.0).abs() < 1e-9, "{k}: {open}");
            assert!(
                (elementary::atan2(open.im, open.re).to_degrees() + 180.0 - margins.phase_deg).abs() < 1e-6,
                "{k}: {open}"
            );
        }
        assert!([0.0, -1.0, 1.0, f64::NAN, f64::INFINITY].into_iter().all(|k| rate_margins(k).is_none()));
        assert!(has_reserve(rate_margins(OVERSHOOTS_FROM).unwrap()));
    }

    fn has_reserve(margins: RateMargins) -> bool {
        let (gain_db, phase_deg) = PROPOSED_MARGINS;
        margins.gain_db > gain_db && margins.phase_deg > phase_deg && margins.lag_cycles > 1.0
    }

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
