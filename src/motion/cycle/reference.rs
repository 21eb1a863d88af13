//! The reference that the joints follow: the proxy while the rig runs, a stop ramp while it halts.

use nalgebra::Vector2;

use super::servo::Deviation;
use super::{Cycle, Settings, Signals};
use crate::guard::{Fault, Motion, StopRamp};
use crate::linkage::{Closure, Posture};
use crate::quantity::{JointAngles, JointRates, TipDisplacement, TipPoint, TipVelocity};
use crate::sensing::Reading;

/// Reserve in m beyond twice the braking distance: within both of the margin, the clearance is checked. The arm is not quite where its
/// reference is, and a clearance may change faster than the tool moves.
const BRAKING_RESERVE_M: f64 = 0.01;
/// Steps towards the point at which the clearance is as it may be.
const BRAKING_STEPS: u32 = 3;
/// Step of the difference quotient for the gradient of the clearance, m.
const GRADIENT_STEP_M: f64 = 1e-6;
/// Tolerance of a clearance, m.
const CLEARANCE_TOLERANCE_M: f64 = 1e-8;

/// The reference of one cycle, its derivatives by backward differences over one period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference {
    /// Desired state of the tool.
    pub point: TipPoint,
    /// Its velocity.
    pub velocity: TipVelocity,
    /// Its acceleration in m/s^2, base frame.
    pub acceleration: Vector2<f64>,
    /// The linkage with its tool there.
    pub closure: Closure,
    /// Their rates.
    pub rates: JointRates,
    /// Their accelerations in rad/s^2.
    pub accelerations: Vector2<f64>,
}

impl Reference {
    /// Returns the joint angles that put the tool there.
    pub fn angles(&self) -> JointAngles {
        self.closure.angles()
    }

    /// Creates a reference at rest at the measured position of the arm.
    pub fn at_rest(point: TipPoint, closure: Closure) -> Self {
        Self {
            point,
            velocity: TipVelocity::default(),
            acceleration: Vector2::zeros(),
            closure,
            rates: JointRates::default(),
            accelerations: Vector2::zeros(),
        }
    }

    /// Returns the reference of the next cycle, which reached this point within `period_s`.
    ///
    /// Real-time: yes.
    #[must_use]
    pub fn moved(&self, point: TipPoint, closure: Closure, period_s: f64) -> Self {
        let velocity = (point - self.point).over_s(period_s);
        let rates = (closure.angles() - self.angles()).over_s(period_s);
        Self {
            point,
            velocity,
            acceleration: ((velocity - self.velocity) / period_s).0,
            closure,
            rates,
            accelerations: ((rates - self.rates) / period_s).0,
        }
    }
}

/// The reference that is followed, and beside it the one to come. A fault on the way to that one leaves the first as it is.
///
/// A reference is 200 bytes. It stays where it was written: what changes from cycle to cycle is which of the two is which.
#[derive(Clone, Debug, Default)]
pub(super) struct Track {
    slots: [Option<Reference>; 2],
    is_second: bool,
}

impl Track {
    /// Returns the reference that is followed.
    #[inline]
    pub(super) fn now(&self) -> Option<&Reference> {
        self.slots[usize::from(self.is_second)].as_ref()
    }

    /// Returns the next reference.
    #[inline]
    pub(super) fn next(&self) -> Option<&Reference> {
        self.slots[usize::from(!self.is_second)].as_ref()
    }

    /// Sets the next reference.
    fn begin(&mut self, next: Reference) {
        self.slots[usize::from(!self.is_second)] = Some(next);
    }

    /// Sets the next reference: the present one after it moved to this point within `period_s`. Does nothing without a present one.
    #[inline]
    fn lead_on(&mut self, point: TipPoint, closure: Closure, period_s: f64) {
        let [first, second] = &mut self.slots;
        let (now, next) = if self.is_second { (second, first) } else { (first, second) };
        if let Some(now) = now {
            *next = Some(now.moved(point, closure, period_s));
        }
    }

    /// Follows what comes next.
    #[inline]
    pub(super) fn follow(&mut self) {
        self.is_second = !self.is_second;
    }

    /// Follows nothing.
    pub(super) fn forget(&mut self) {
        self.slots[usize::from(self.is_second)] = None;
    }

    /// Returns the reference that is followed, for tests that put one elsewhere.
    #[cfg(test)]
    pub(super) fn now_mut(&mut self) -> Option<&mut Reference> {
        self.slots[usize::from(self.is_second)].as_mut()
    }
}

/// Where the reference is that is followed, without its loop.
struct Last {
    point: TipPoint,
    velocity: TipVelocity,
    angles: JointAngles,
}

impl Last {
    fn of(reference: &Reference) -> Self {
        Self { point: reference.point, velocity: reference.velocity, angles: reference.angles() }
    }
}

impl Cycle {
    /// Finds the reference to come. The first one after enabling is where the arm is, at rest and with zero force.
    ///
    /// # Errors
    /// [`Fault::OverSpeed`], or [`Fault::NotFinite`] if the fixture's answer is unusable.
    pub(super) fn advance(&mut self, motion: Motion, reading: &Reading, signals: &mut Signals) -> Result<(), Fault> {
        let Some(last) = self.track.now().map(Last::of) else {
            return self.start();
        };
        let candidate = match motion {
            Motion::Run if self.lead.is_some() => self.led(&last),
            Motion::Run => self.run(&last, reading, signals)?,
            Motion::Halt | Motion::Rest => self.stop(&last)?,
        };
        // Joints that are led are not led around an edge: they stay before it.
        let braked = self.brake(candidate, &last).filter(|point| self.lead.is_none() || *point == candidate);
        let period_s = self.settings.period_s;
        if let Some(point) = braked
            && let Some(closure) = self.admit(point, last.angles)
        {
            self.faults.observe(Fault::WorkspaceEdge, point != candidate);
            if point != candidate && motion == Motion::Run {
                self.fixture.hold_back_to(&point.0).map_err(|_| Fault::NotFinite)?;
            }
            self.track.lead_on(point, closure, period_s);
        } else {
            self.faults.observe(Fault::WorkspaceEdge, true);
            self.reset_fixture(last.point)?;
            self.lead.iter_mut().for_each(|lead| lead.rest(last.angles));
            self.halt = self.halt.map(|_| StopRamp::new(last.point, TipVelocity::default(), 1.0));
            if let Some(closure) = self.track.now().map(|now| now.closure) {
                self.track.lead_on(last.point, closure, period_s);
            }
        }
        let speed = self.track.next().map_or(0.0, |next| next.velocity.norm());
        if speed > self.settings.tool_speed_limit_m_per_s { Err(Fault::OverSpeed) } else { Ok(()) }
    }

    /// Sets the next reference to the measured position of the arm.
    #[cold]
    fn start(&mut self) -> Result<(), Fault> {
        let Some(posture) = &self.posture else { return Err(Fault::NotFinite) };
        let closure = self.linkage.close(posture.angles).map_err(|_| Fault::NotFinite)?;
        let start = Reference::at_rest(posture.tip, closure);
        self.servo.reset(&start, posture);
        self.reset_fixture(start.point)?;
        self.lead.iter_mut().for_each(|lead| lead.rest(start.angles()));
        self.track.begin(start);
        Ok(())
    }

    fn run(&mut self, last: &Last, reading: &Reading, signals: &mut Signals) -> Result<TipPoint, Fault> {
        if self.halt.take().is_some() {
            self.fixture.lead_to(&last.point.0);
        }
        let (before, stored_j) = (*self.fixture.proxy(), self.fixture.stored_j());
        let step = self.fixture.step_admittance(&reading.force.0);
        self.brought_j = step.force_n.dot(&(step.proxy - before)) + self.fixture.stored_j() - stored_j;
        signals.signed_distance_m = step.signed_distance_m;
        signals.is_on_surface = step.is_on();
        signals.hold_counter = step.hold_count;
        signals.is_impact = step.is_impact;
        let tool = self.posture.as_ref().map_or(last.point, |posture| posture.tip);
        let point = TipPoint(self.fixture.dissipate(&tool.0, &reading.force.0));
        if point.is_finite() { Ok(point) } else { Err(Fault::NotFinite) }
    }

    /// Guides the joints. They stay where the linkage cannot follow. After a halt they stay until they are guided again.
    fn led(&mut self, last: &Last) -> TipPoint {
        let was_halted = self.halt.take().is_some();
        let period_s = self.settings.period_s;
        let angles = self.lead.as_mut().map_or(last.angles, |lead| {
            if was_halted {
                lead.rest(last.angles);
            }
            lead.step(last.angles, period_s)
        });
        self.linkage.forward(angles).map_or(last.point, |posture| posture.tip)
    }

    /// Draws the proxy back to where the controllers would not have wanted more than they can have, so that it does not
    /// run away from an arm that is blocked.
    ///
    /// # Source
    /// The idea: R. Kikuuwe, *Torque-bounded admittance control realized by a set-valued algebraic feedback* (2019).
    pub(super) fn draw_back(&mut self, overreach: Deviation) -> Result<(), Fault> {
        let (Some(posture), Some(now), Some(next)) = (&self.posture, self.track.now(), self.track.next()) else {
            return Ok(());
        };
        let by = match overreach {
            Deviation::Tool(by) => by.0,
            Deviation::Joints(by) => posture.tip_velocity(JointRates(by.0)).map_err(|_| Fault::NotFinite)?.0,
        };
        let point = TipPoint(self.fixture.draw_back(&by));
        let drawn = self.admit(point, now.angles()).map(|closure| now.moved(point, closure, self.settings.period_s));
        match drawn.filter(|drawn| drawn.velocity.norm() <= self.settings.tool_speed_limit_m_per_s) {
            Some(drawn) => {
                self.servo.draw_back(&drawn, posture);
                self.track.begin(drawn);
                Ok(())
            }
            // Where the linkage does not go, or not so fast, the reference stays as it is.
            None => self.fixture.hold_back_to(&next.point.0).map_err(|_| Fault::NotFinite),
        }
    }

    /// Returns the next point of the ramp, which leads neither through a surface nor off one: there the reference stops at once, as it
    /// does at an impact.
    fn stop(&mut self, last: &Last) -> Result<TipPoint, Fault> {
        let is_led = self.lead.is_some();
        // A fixture whose step was refused is not where the reference is.
        if !is_led && self.halt.is_none() && *self.fixture.proxy() != last.point.0 {
            self.reset_fixture(last.point)?;
        }
        let deceleration = self.settings.stop_deceleration_m_per_s2;
        let ramp = self.halt.get_or_insert_with(|| StopRamp::new(last.point, last.velocity, deceleration));
        let point = ramp.advance(self.settings.period_s);
        Ok(if is_led { point } else { TipPoint(self.fixture.lead_to(&point.0)) })
    }

    /// Returns the linkage with its tool at `candidate` and angles near these. Returns `None` if the linkage cannot go there, or if the arm
    /// is within the margin and `candidate` is further in.
    fn admit(&self, candidate: TipPoint, near: JointAngles) -> Option<Closure> {
        let closure = self.linkage.close_near(candidate, near).ok()?;
        if self.clearance_m >= self.settings.singularity_margin_m {
            return Some(closure);
        }
        let clearance = |closure: &Closure| self.clearance_of_m(&self.linkage.posture(closure));
        let here = clearance(&self.track.now()?.closure);
        let least = here.min(self.settings.singularity_margin_m) - CLEARANCE_TOLERANCE_M;
        (clearance(&closure) >= least).then_some(closure)
    }

    /// Returns `candidate`, brought back so far that the reference can still come to rest at the margin within the deceleration of a stop.
    /// Its clearance may fall by `sqrt(2 a (clearance - margin))` in a second. Only the motion across the edge is brought back; along it
    /// and away from it the reference goes on. Returns `None` if no such point is found.
    ///
    /// Far from the edge nothing is computed.
    fn brake(&self, candidate: TipPoint, last: &Last) -> Option<TipPoint> {
        let Settings { period_s, singularity_margin_m: margin, stop_deceleration_m_per_s2: deceleration, .. } =
            self.settings;
        let speed = (candidate - last.point).norm() / period_s;
        if self.clearance_m > margin + BRAKING_RESERVE_M + speed * speed / deceleration {
            return Some(candidate);
        }
        let clearance = |point: TipPoint| {
            let closure = self.linkage.close_near(point, last.angles).ok()?;
            Some(self.clearance_of_m(&self.linkage.posture(&closure)))
        };
        let here = clearance(last.point)?;
        let fall = (2.0 * deceleration * (here - margin).max(0.0)).sqrt() * period_s;
        let least = (here - fall).max(here.min(margin));
        let offered = clearance(candidate);
        if offered.is_some_and(|offered| offered >= least) {
            return Some(candidate);
        }
        // The way back is that of the gradient, taken behind the reference, where the linkage is known to reach.
        let [x, y] = last.point.to_array();
        let slope = |behind: TipPoint| Some((here - clearance(behind)?) / GRADIENT_STEP_M);
        let gradient =
            Vector2::new(slope(TipPoint::new(x - GRADIENT_STEP_M, y))?, slope(TipPoint::new(x, y - GRADIENT_STEP_M))?);
        let mut point = candidate;
        // Where the linkage does not reach, the gradient says how far beyond that is.
        let mut there = offered.unwrap_or((here + gradient.dot(&(candidate - last.point).0)).min(least));
        for _ in 0..BRAKING_STEPS {
            // A hair more than asked for, so that nothing creeps into the margin.
            let missing = least + 0.5 * CLEARANCE_TOLERANCE_M - there;
            point += TipDisplacement(gradient * (missing / gradient.norm_squared()));
            there = clearance(point)?;
            if there >= least {
                return Some(point);
            }
        }
        None
    }

    fn reset_fixture(&mut self, at: TipPoint) -> Result<(), Fault> {
        self.fixture.reset(&at.0).map_err(|_| Fault::NotFinite)
    }

    pub(super) fn clearance_of_m(&self, posture: &Posture) -> f64 {
        self.linkage.clearance(posture).least_m()
    }
}
