//! A single joint with exact Coulomb friction under the laws: what the other tests simulate, and what saturation does.

use crate::control::*;
use crate::setvalued::gsat;

pub(super) const PERIOD_S: f64 = 1e-3;
const SUBSTEPS: usize = 10;

/// `J v' + b v + tau_c Sgn(v) = u`, friction solved exactly in each backward Euler substep.
#[derive(Clone, Copy)]
pub(super) struct Joint {
    pub(super) inertia: f64,
    pub(super) coulomb: f64,
    pub(super) viscous: f64,
    pub(super) angle: f64,
    pub(super) rate: f64,
}

impl Joint {
    pub(super) fn at_rest(inertia: f64, coulomb: f64, viscous: f64) -> Self {
        Self { inertia, coulomb, viscous, angle: 0.0, rate: 0.0 }
    }

    pub(super) fn advance(&mut self, torque: f64) {
        let h = PERIOD_S / SUBSTEPS as f64;
        for _ in 0..SUBSTEPS {
            let b = self.inertia * self.rate + h * torque;
            let stuck = h * self.coulomb;
            self.rate = (b - gsat(-stuck, b, stuck)) / (self.inertia + h * self.viscous);
            self.angle += h * self.rate;
        }
    }
}

/// A step of the desired angle by `step`; overshoot and peak speed.
fn overshoot(mut law: impl AxisController, limit: f64, step: f64) -> (f64, f64) {
    let mut joint = Joint::at_rest(0.35, 10.0, 0.0);
    let (mut over, mut peak) = (0.0_f64, 0.0_f64);
    law.reset(step);
    for _ in 0..3000 {
        joint.advance(law.step(step - joint.angle, EffortRange::symmetric(limit)).effort);
        over = over.max(joint.angle - step);
        peak = peak.max(joint.rate.abs());
    }
    (over, peak)
}

#[test]
fn psmc_does_not_overshoot_after_saturation_where_the_rule_on_the_sliding_time_holds() {
    let limit = 60.0;
    let deceleration = (limit + 10.0) / 0.35;
    let (mut kept, mut broken, mut worst_broken) = (0, 0, 0.0_f64);
    for step in [0.02, 0.05, 0.1, 0.2, 0.5, 1.0] {
        for sliding_time in [0.005, 0.01, 0.02, 0.04, 0.08] {
            for integral in [0.0, 30000.0] {
                let gains = Gains { stiffness: 20000.0, damping: 150.0, integral };
                let (over, peak) = overshoot(Psmc::new(gains, sliding_time, PERIOD_S).unwrap(), limit, step);
                if sliding_time >= 1.3 * peak / (2.0 * deceleration) {
                    kept += 1;
                    assert!(
                        over <= 1e-3 * step,
                        "H {sliding_time} step {step} L {integral}: over by {over}, peak {peak}"
                    );
                } else {
                    broken += 1;
                    worst_broken = worst_broken.max(over / step);
                }
            }
        }
    }
    assert!(kept >= 20 && broken >= 10, "{kept} {broken}");
    assert!(worst_broken > 0.05, "the rule is not needed: {worst_broken}");
}

#[test]
fn pid_overshoots_after_the_same_saturation() {
    let gains = Gains { stiffness: 20000.0, damping: 150.0, integral: 30000.0 };
    let (over_pid, _) = overshoot(Pid::new(gains, PERIOD_S).unwrap(), 60.0, 0.5);
    let (over_psmc, peak) = overshoot(Psmc::new(gains, 0.04, PERIOD_S).unwrap(), 60.0, 0.5);
    assert!(over_pid > 0.05 && over_psmc < 5e-4, "{over_pid} {over_psmc} {peak}");
}
