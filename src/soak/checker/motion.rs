//! Motion of the reference, the fixture and the arm.

use nalgebra::Vector2;
use yieldwall_motion::elementary;

use super::super::excuse::Excuse;
use super::super::invariant::Invariant;
use super::super::observation::Observation;
use super::super::tolerance;
use super::{Findings, Limits, Peaks};
use yieldwall_motion::guard::State;

/// Radius in m from the task's origin beyond which the edge of the workspace lies, with some room.
const EDGE_M: f64 = 0.18;

/// State after one cycle.
#[derive(Clone, Copy, Debug)]
struct Past {
    proxy: Vector2<f64>,
    step: Vector2<f64>,
    /// Cycles that the rig has been running for, this one included.
    running: u32,
    /// Cycles that it has been halting for.
    halting: u32,
    is_on_surface: bool,
    distance_m: f64,
}

/// A stretch of time in which the proxy has to come to rest: how long it lasts, and how fast it was in the beginning.
#[derive(Clone, Copy, Debug, Default)]
struct Quiet {
    cycles: u32,
    speed_m_per_s: f64,
}

impl Quiet {
    /// Counts one more cycle, in which the proxy went at `speed`; from the beginning unless it `goes_on`.
    fn next(&mut self, goes_on: bool, speed: f64) {
        *self = if !goes_on {
            Self::default()
        } else if self.cycles == 0 {
            Self { cycles: 1, speed_m_per_s: speed }
        } else {
            Self { cycles: self.cycles + 1, ..*self }
        };
    }

    /// Whether a deceleration that is at least this must have stopped it.
    fn is_over(&self, deceleration: f64, period_s: f64) -> bool {
        let stopped = (self.speed_m_per_s / (deceleration * period_s)).ceil();
        self.cycles > tolerance::RESTING_CYCLES && f64::from(self.cycles - tolerance::RESTING_CYCLES) > stopped
    }
}

/// Motion in the last cycles.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Motion {
    past: Option<Past>,
    unforced: Quiet,
    halted: Quiet,
    /// True angles at the last computation, rad.
    angles_rad: Option<[f64; 2]>,
}

impl Motion {
    pub(super) fn check(
        &mut self,
        limits: &Limits,
        seen: &Observation,
        peaks: &mut Peaks,
        findings: &mut Findings<'_>,
    ) {
        check_finite(seen, findings);
        check_torques(limits, seen, peaks, findings);
        let before_rad = self.angles_rad.replace(seen.truth.angles_rad).unwrap_or(seen.truth.angles_rad);
        check_measured(limits, seen, before_rad, findings);
        let proxy = Vector2::from(seen.reported.proxy_m);
        let is_running = seen.state == State::Running;
        let is_halting = matches!(seen.state, State::Holding | State::Stopping);
        let step = self.past.map_or(Vector2::zeros(), |past| proxy - past.proxy);
        let past = self.past.filter(|_| is_running || is_halting);
        let has_reference = past.is_some_and(|past| past.running + past.halting > 0);
        let now = Past {
            proxy,
            step: if has_reference { step } else { Vector2::zeros() },
            running: if is_running { past.map_or(1, |past| past.running + 1) } else { 0 },
            halting: if is_halting { past.map_or(1, |past| past.halting + 1) } else { 0 },
            is_on_surface: seen.reported.is_on_surface,
            distance_m: seen.reported.distance_m,
        };
        if has_reference {
            let speed = step.norm() / limits.period_s;
            peaks.proxy_m_per_s = peaks.proxy_m_per_s.max(speed);
            // bounded-proxy
            let most = limits.tool_speed_m_per_s * (1.0 + tolerance::ROUNDING);
            findings.expect(Invariant::BoundedProxy, speed <= most, || {
                format!("the proxy went at {speed:.4} m/s, at most {:.4}", limits.tool_speed_m_per_s)
            });
            if let Some(past) = past {
                self.check_ramp(limits, &now, &past, findings);
                check_levels(limits, seen, &now, &past, findings);
            }
            self.check_rest(limits, seen, &now, findings);
        } else {
            (self.unforced, self.halted) = (Quiet::default(), Quiet::default());
        }
        self.past = (is_running || is_halting).then_some(now).or(Some(Past { running: 0, halting: 0, ..now }));
    }

    /// Checks bounded-motion of a stop: the reference slows down, and not faster than configured.
    fn check_ramp(&self, limits: &Limits, now: &Past, past: &Past, findings: &mut Findings<'_>) {
        if now.halting < 2 {
            return;
        }
        let change = (now.step - past.step).norm();
        let most = tolerance::RAMP_SHARE * limits.stop_m_per_s2 * limits.period_s * limits.period_s;
        let slack = tolerance::ROUNDING * limits.period_s;
        // A surface stops it at once, as at an impact.
        let has_landed = now.distance_m.abs() <= tolerance::LANDED_M;
        let at_edge = is_near_edge(limits, past).then_some(Excuse::Edge);
        let excuse = at_edge.or(has_landed.then_some(Excuse::Impact));
        findings.expect_unless(Invariant::BoundedMotion, change <= most + slack, excuse, || {
            let (from, to) = (past.step.norm() / limits.period_s, now.step.norm() / limits.period_s);
            format!("the reference went from {from:.4} to {to:.4} m/s in one cycle of a stop")
        });
        findings.expect_unless(
            Invariant::BoundedMotion,
            now.step.norm() <= past.step.norm() + slack * limits.period_s,
            excuse,
            || "the reference got faster in a stop".to_owned(),
        );
    }

    /// Checks comes-to-rest.
    fn check_rest(&mut self, limits: &Limits, seen: &Observation, now: &Past, findings: &mut Findings<'_>) {
        let speed = now.step.norm() / limits.period_s;
        let friction = 0.5 * limits.friction_n;
        let force = Vector2::from(seen.reported.force_n).norm();
        // A proxy that is drawn back, since the torques reached their limit, is moved by more than the hand.
        let is_free = force <= friction && !seen.reported.is_saturated;
        self.unforced.next(now.running > 1 && is_free, speed);
        // The ramp begins at the speed of the cycle before, of which a surface may take a part at once.
        let before = self.past.map_or(0.0, |past| past.step.norm() / limits.period_s);
        self.halted.next(now.halting > 0, speed.max(before));
        let rests = now.step.norm() <= tolerance::RESTING_STEP_M;
        let excuse = is_near_edge(limits, now).then_some(Excuse::Edge);
        let deceleration = (limits.friction_n - friction) / limits.mass_kg;
        let is_unforced = self.unforced.is_over(deceleration, limits.period_s);
        findings.expect_unless(Invariant::ComesToRest, rests || !is_unforced, excuse, || {
            format!("the proxy still goes at {speed:.3e} m/s after {} cycles below F / 2", self.unforced.cycles)
        });
        // The ramp takes 1.5 times what its greatest deceleration would.
        let ramp = limits.stop_m_per_s2 / 1.5;
        findings.expect_unless(
            Invariant::ComesToRest,
            rests || !self.halted.is_over(ramp, limits.period_s),
            excuse,
            || format!("the reference still goes at {speed:.3e} m/s after {} cycles of a stop", self.halted.cycles),
        );
    }
}

/// Whether the guard may already brake the reference before the edge, since its braking distance reaches there.
fn is_near_edge(limits: &Limits, past: &Past) -> bool {
    let speed = past.step.norm() / limits.period_s;
    past.proxy.norm() + 0.5 * speed * speed / limits.stop_m_per_s2 > EDGE_M
}

/// Checks finite.
fn check_finite(seen: &Observation, findings: &mut Findings<'_>) {
    let reported = &seen.reported;
    let values = [reported.force_n, reported.proxy_m, reported.target_rad, reported.measured_rad];
    let truth = [seen.truth.tool_m, seen.truth.velocity_m_per_s, seen.truth.torques_n_m, seen.truth.angles_rad];
    let holds = values.iter().chain(&truth).flatten().all(|value| value.is_finite());
    findings.expect(Invariant::Finite, holds && reported.distance_m.is_finite(), || {
        format!("a value is not finite in {reported:?}, {:?}", seen.truth)
    });
}

/// Checks bounded-effort of the drives and of the force that moves the proxy.
fn check_torques(limits: &Limits, seen: &Observation, peaks: &mut Peaks, findings: &mut Findings<'_>) {
    let torque = seen.truth.torques_n_m.iter().fold(0.0f64, |most, torque| most.max(torque.abs()));
    let speed = Vector2::from(seen.truth.velocity_m_per_s).norm();
    let force = Vector2::from(seen.reported.force_n).norm();
    peaks.torque_n_m = peaks.torque_n_m.max(torque);
    peaks.speed_m_per_s = peaks.speed_m_per_s.max(speed);
    if seen.state == State::Running {
        peaks.force_n = peaks.force_n.max(force);
        findings.expect(Invariant::BoundedEffort, force <= limits.force_n * (1.0 + tolerance::ROUNDING), || {
            format!("a force of {force:.2} N moved the proxy, at most {:.2}", limits.force_n)
        });
    }
    // A drive is told its limit in whole per mille.
    let most = limits.torque_n_m * (1.0 + tolerance::TORQUE_PER_MILLE / limits.torque_per_mille[0]);
    findings.expect(Invariant::BoundedEffort, torque <= most, || {
        format!("a drive made {torque:.3} N m, at most {:.3}", limits.torque_n_m)
    });
}

/// Checks wrapping-counters: measured angles equal the true ones, at any state of the counter. `before_rad` are the true angles at
/// the last computation.
fn check_measured(limits: &Limits, seen: &Observation, before_rad: [f64; 2], findings: &mut Findings<'_>) {
    let falsified = seen.falsified;
    let is_false = falsified.angles || falsified.timing || falsified.drives || falsified.arm;
    let has_told = |joint: usize| {
        let id = limits.status_ids[joint];
        seen.frames.iter().any(|seen| seen.sender.is_none() && seen.frame.id() == id && seen.frame.len() == 6)
    };
    for (joint, before_rad) in before_rad.into_iter().enumerate() {
        // The guard takes an encoder that moves more than twice the limit for one that has jumped.
        let away = (seen.reported.measured_rad[joint] - seen.truth.angles_rad[joint]).abs();
        let counts_rad = tolerance::MEASURED_COUNTS / limits.counts_per_rad[joint];
        let most = 2.0 * limits.joint_speed_rad_per_s * limits.period_s + counts_rad;
        if away <= most {
            continue;
        }
        let turned = (seen.truth.angles_rad[joint] - before_rad).abs() + counts_rad;
        let excuse = match () {
            () if is_false => Some(Excuse::Falsified),
            () if !has_told(joint) => Some(Excuse::Unreported),
            () => (away <= turned).then_some(Excuse::Turned),
        };
        findings.expect_unless(Invariant::WrappingCounters, false, excuse, || {
            format!("joint {joint} is {away:.3e} rad away from what was measured, at most {most:.3e}")
        });
    }
}

/// Checks yield-levels: the fixture's force on the proxy, from the proxy's equation of motion `M (q - 2 q1 + q2) / T^2 = h + f`.
fn check_levels(limits: &Limits, seen: &Observation, now: &Past, past: &Past, findings: &mut Findings<'_>) {
    let reported = &seen.reported;
    if now.running == 0 {
        return;
    }
    let is_held = limits.has_hold && reported.hold_counter > 0;
    let excuse = match () {
        // The first three cycles of a run start at rest, so that the two steps before are not those of the fixture.
        () if now.running < 4 => Some(Excuse::Start),
        () if reported.is_saturated => Some(Excuse::DrawnBack),
        () if reported.is_impact || is_held => Some(Excuse::Impact),
        () => is_near_edge(limits, past).then_some(Excuse::Edge),
    };
    let kappa = limits.mass_kg / (limits.period_s * limits.period_s);
    let force = (now.step - past.step) * kappa - Vector2::from(reported.force_n);
    let both = elementary::hypot(limits.friction_n, limits.yield_n);
    // A proxy that has just landed is put onto the surface before it is said to lie there.
    let has_landed = reported.distance_m.abs() <= tolerance::LANDED_M;
    let is_touching = reported.is_on_surface || past.is_on_surface || has_landed;
    let slack = |level: f64| {
        let share = if limits.round.is_some() { tolerance::CURVED_SHARE } else { tolerance::ROUNDING };
        level * (1.0 + share) + tolerance::LEVEL_N
    };
    let most = slack(both);
    findings.expect_unless(Invariant::YieldLevels, force.norm() <= most, excuse, || {
        format!("the fixture held the proxy with {:.4} N, at most {most:.4}", force.norm())
    });
    if is_touching {
        return;
    }
    let work = force.dot(&now.step);
    findings.expect_unless(Invariant::YieldLevels, work <= tolerance::LEVEL_N * now.step.norm(), excuse, || {
        format!("the fixture did work of {work:.3e} J on the proxy")
    });
    // Only what leads away from the surface, or deeper beyond it, meets R: all else meets F.
    let outward = limits.round.map_or(Vector2::from(limits.normal), |(center, _)| now.proxy - Vector2::from(center));
    let (along, far) = (outward.norm(), outward / outward.norm());
    if along.is_nan() {
        return;
    }
    let is_central = limits.round.is_some_and(|(_, radius)| along < 0.5 * radius);
    let excuse = excuse.or(is_central.then_some(Excuse::Centre));
    let away = if limits.round.map_or(reported.distance_m > 0.0, |(_, radius)| along > radius) { far } else { -far };
    let is_free = limits.is_unilateral && reported.distance_m > 0.0 && past.distance_m > 0.0;
    let pull = -force.dot(&away);
    let rest = if is_free || pull < 0.0 { force } else { force + away * pull };
    let most = slack(limits.friction_n);
    findings.expect_unless(Invariant::YieldLevels, rest.norm() <= most, excuse, || {
        format!("along or towards the surface the fixture held the proxy with {:.4} N, at most {most:.4}", rest.norm())
    });
}
