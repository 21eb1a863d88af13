//! Energy that the rig gives to the hand and takes from it.

use nalgebra::Vector2;

use super::super::excuse::Excuse;
use super::super::invariant::Invariant;
use super::super::observation::Observation;
use super::super::tolerance;
use super::{Findings, Limits, Peaks};
use yieldwall_motion::guard::State;

/// The balance at the hand, from the true force and the true motion of the tool.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Energy {
    past: Option<Past>,
    /// Whether a stretch has begun.
    is_begun: bool,
    /// Net work on the hand since the stretch began, J.
    returned_j: f64,
    /// The part of it that the sensed force did not show, while a hand shakes the tool, J.
    hidden_j: f64,
    /// Energy that the rig held when the stretch began: as motion, and in the servo that holds the tool to the proxy, J.
    held_j: f64,
    /// By how much the sums may be off, at most: force and way are known once a cycle, J.
    quadrature_j: f64,
    /// Whether the stretch has already passed its bound, which is reported once.
    is_told: bool,
}

#[derive(Clone, Copy, Debug)]
struct Past {
    tool: Vector2<f64>,
    hand_n: Vector2<f64>,
    sensed_n: Vector2<f64>,
    proxy: Vector2<f64>,
}

impl Energy {
    /// Checks passivity: over any stretch of running, the rig returns at most the energy that it held in the beginning.
    pub(super) fn check(
        &mut self,
        limits: &Limits,
        seen: &Observation,
        peaks: &mut Peaks,
        findings: &mut Findings<'_>,
    ) {
        let now = Past {
            tool: Vector2::from(seen.truth.tool_m),
            hand_n: Vector2::from(seen.truth.hand_n),
            sensed_n: Vector2::from(seen.reported.force_n),
            proxy: Vector2::from(seen.reported.proxy_m),
        };
        let falsified = seen.falsified;
        let is_false = falsified.force || falsified.angles || falsified.drives || falsified.arm || falsified.timing;
        let is_running = seen.state == State::Running;
        findings.expect_unless(Invariant::Passivity, !(is_running && is_false), Some(Excuse::Falsified), String::new);
        let counts = is_running && !is_false;
        let Some(past) = self.past.filter(|_| counts) else {
            *self = Self { past: counts.then_some(now), ..Self::default() };
            return;
        };
        let way = now.tool - past.tool;
        let work_j = -0.5 * (now.hand_n + past.hand_n).dot(&way);
        // What the rig gives a hand that shakes the tool is the small difference of strokes to and fro, and a force that is
        // sensed late hides some of it: the guard is judged by the force that it was told.
        let told_j = -0.5 * (now.sensed_n + past.sensed_n).dot(&way);
        let hidden_j = if falsified.hand { work_j - told_j } else { 0.0 };
        let speed = (now.proxy - past.proxy).norm().max((now.tool - past.tool).norm()) / limits.period_s;
        // A servo whose tool a hand has carried ahead of the proxy is a spring: it gives back at most force times way.
        let ahead_j = now.hand_n.dot(&(now.tool - now.proxy)).max(0.0);
        let held_j = 0.5 * limits.mass_kg.max(tolerance::ARM_KG) * speed * speed + ahead_j;
        // What is long past is forgotten, or steps of sensor and encoder would add up. What the rig still holds is not.
        let is_beyond = self.returned_j > self.held_j;
        let kept = if is_beyond { 1.0 - limits.period_s / tolerance::FORGETTING_S } else { 1.0 };
        (self.returned_j, self.held_j) = (self.returned_j * kept + work_j, self.held_j * kept);
        self.hidden_j = self.hidden_j * kept + hidden_j;
        self.quadrature_j = self.quadrature_j * kept + 0.5 * (now.hand_n - past.hand_n).dot(&way).abs();
        // A stretch begins with what is held then, and anew wherever that makes it worse.
        if !self.is_begun || self.returned_j - self.held_j < -held_j {
            *self = Self { is_begun: true, held_j, ..Self::default() };
        }
        let beyond_j = self.returned_j - self.held_j - self.hidden_j.max(0.0);
        peaks.returned_j = peaks.returned_j.max(beyond_j);
        // The guard sees a cycle's energy at its end, and acts in the next one.
        let delay_j = 2.0 * work_j.max(0.0);
        let holds = beyond_j <= limits.energy_j * (1.0 + tolerance::GUARD_SHARE) + self.quadrature_j + delay_j;
        findings.expect(Invariant::Passivity, holds || self.is_told, || {
            format!("the hand got {:.1} mJ, and the rig had held {:.1} mJ", 1e3 * self.returned_j, 1e3 * self.held_j)
        });
        self.is_told |= !holds;
        self.past = Some(now);
    }
}
