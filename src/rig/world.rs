//! The physical side of the embedded simulation: the arm with the hand on it, and what the devices feel of it.

use nalgebra::Vector2;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;
use yieldwall_motion::elementary;

use super::defects::Defects;
use super::error::RigError;
use yieldwall_drives::cia402;
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::linkage::{FiveBar, Posture};
use yieldwall_motion::quantity::{Force, JointAngles, JointRates, JointTorques, TipPoint, TipVelocity};
use yieldwall_motion::sensing::{Calibration, Mounting};
use yieldwall_sim::arm::Arm;
use yieldwall_sim::hand::{Hand, HandLoad, PathPoint};
use yieldwall_sim::standard_normal;

/// How the tool follows the drives.
#[derive(Clone, Debug)]
pub(super) enum Body {
    /// The arm with its inertia and friction.
    Arm(Arm),
    /// No arm: the joints are at the commanded positions of the drives.
    Ideal(Ideal),
}

/// Joints that follow their targets at once, with the tool's motion by differences over one SYNC period.
#[derive(Clone, Debug)]
pub(super) struct Ideal {
    pub(super) linkage: FiveBar,
    pub(super) angles: JointAngles,
    pub(super) tip: TipPoint,
    pub(super) velocity: TipVelocity,
    pub(super) acceleration: Vector2<f64>,
    pub(super) time_s: f64,
}

/// The truth at one moment, for the record.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Truth {
    pub(super) tip: TipPoint,
    pub(super) velocity: TipVelocity,
    pub(super) force: Force,
}

/// Time in which a hand that has taken the tool again returns it to its path, in s.
const RETURN_S: f64 = 1.5;

/// How the hand has the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Grip {
    /// It follows its path with it.
    Firm,
    /// Not at all.
    LetGo,
    /// It took it at a moment, in s since the scene began, where it was: so far from the path, in m. It comes back to
    /// the path from there.
    Again { from_s: f64, offset_m: Vector2<f64> },
}

impl Grip {
    /// Returns how far from its path the hand aims, in m; `None` if it does not hold the tool.
    fn offset_m(self, time_s: f64) -> Option<Vector2<f64>> {
        match self {
            _ if time_s < 0.0 => None,
            Grip::LetGo => None,
            Grip::Firm => Some(Vector2::zeros()),
            Grip::Again { from_s, .. } if time_s < from_s => None,
            Grip::Again { from_s, offset_m } => {
                let share = ((time_s - from_s) / RETURN_S).min(1.0);
                // Minimum jerk from one to zero.
                Some(offset_m * (1.0 - elementary::powi(share, 3) * (10.0 - 15.0 * share + 6.0 * share * share)))
            }
        }
    }
}

/// Force of the hand besides that of its path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Push {
    pub(super) shape: PushShape,
    pub(super) size_n: f64,
    /// In s since the scene began.
    pub(super) start_s: f64,
    pub(super) end_s: f64,
}

/// How a push runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PushShape {
    /// Along the circle about the task's origin, with short ramps.
    Along,
    /// Along the circle, as a half sine.
    Blow,
    /// To and fro along the circle, once.
    Swing,
    /// To and fro along the circle.
    Tremble,
    /// Away from the task's origin, with long ramps.
    Outward,
}

impl Push {
    const SHORT_RAMP_S: f64 = 0.02;
    const LONG_RAMP_S: f64 = 1.0;
    const TREMBLE_HZ: f64 = 25.0;

    fn force_n(&self, time_s: f64, tip: Vector2<f64>) -> Vector2<f64> {
        let (from_start, to_end) = (time_s - self.start_s, self.end_s - time_s);
        if from_start < 0.0 || to_end < 0.0 {
            return Vector2::zeros();
        }
        let ramp = |ramp_s: f64| (from_start.min(to_end) / ramp_s).min(1.0);
        let turn = std::f64::consts::TAU * from_start;
        let (share, is_along) = match self.shape {
            PushShape::Along => (ramp(Self::SHORT_RAMP_S), true),
            PushShape::Blow => (elementary::sin(0.5 * turn / (self.end_s - self.start_s)), true),
            PushShape::Swing => (elementary::sin(turn / (self.end_s - self.start_s)), true),
            PushShape::Tremble => (elementary::sin(turn * Self::TREMBLE_HZ), true),
            PushShape::Outward => (ramp(Self::LONG_RAMP_S), false),
        };
        let outward = tip.try_normalize(1e-6).unwrap_or_else(Vector2::x);
        let direction = if is_along { Vector2::new(-outward.y, outward.x) } else { outward };
        direction * (self.size_n * share)
    }
}

/// A first-order low pass within the force sensor, behind which its converters are.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SensorFilter {
    /// Its time constant, s; 0 for none.
    lag_s: f64,
    output: Vector2<f64>,
    at_s: f64,
}

impl SensorFilter {
    /// Creates a filter with this time constant, s, without any input yet; 0 for none.
    pub(super) fn new(lag_s: f64) -> Self {
        Self { lag_s, ..Self::default() }
    }

    /// Goes on to `time_s` with a force that has been the same since it went on last.
    fn advance_to(&mut self, time_s: f64, force_n: Vector2<f64>) {
        let elapsed_s = time_s - self.at_s;
        if elapsed_s > 0.0 {
            self.output += (force_n - self.output) * (1.0 - elementary::exp(-elapsed_s / self.lag_s));
            self.at_s = time_s;
        }
    }
}

/// Arm, hand and the transducer between them.
#[derive(Clone, Debug)]
pub(super) struct World {
    pub(super) body: Body,
    pub(super) hand: Hand<2>,
    pub(super) calibration: Calibration,
    pub(super) mounting: Mounting,
    pub(super) noise_counts: f64,
    pub(super) noise: Xoshiro256PlusPlus,
    pub(super) longest_step_s: f64,
    pub(super) torques: JointTorques,
    /// Whether the brakes of the joints are closed.
    pub(super) are_braked: [bool; 2],
    /// Angles of the links, as a person sees them; with play they differ from the motors' angles.
    pub(super) links: JointAngles,
    /// The hand lets go of the rig until this moment, so that it starts at rest and is enabled unloaded.
    pub(super) hand_from_s: f64,
    pub(super) grip: Grip,
    pub(super) pushes: Vec<Push>,
    /// Force at the tool besides the hand's, as of a weight over a pulley; it acts even if nobody holds the tool.
    pub(super) weight: Force,
    /// Defects of the machine.
    pub(super) defects: Defects,
    /// Mass on the hand's side of the force sensor, kg: a part of the tool's own.
    pub(super) handle_kg: f64,
    /// The low pass of the force sensor.
    pub(super) filter: SensorFilter,
    /// Whether there is one at all.
    pub(super) has_hand: bool,
    /// Stiffness of the hand as the scene has it, N/m.
    pub(super) hand_stiffness_n_per_m: f64,
    pub(super) truth: Truth,
    /// The truth at the last SYNC0 that no cycle has read yet, where drives sample by that.
    pub(super) sampled: Option<Truth>,
}

impl World {
    pub(super) fn noise_from(seed: u64) -> Xoshiro256PlusPlus {
        // Apart from the hand's own stream, which starts from the seed itself.
        Xoshiro256PlusPlus::seed_from_u64(seed ^ 0x5e15_0000_0000_0001)
    }

    /// Moves on to `now` under the torques in force.
    pub(super) fn settle(&mut self, now: Time) -> Result<(), RigError> {
        let Self { torques, hand_from_s, grip, hand, pushes, weight, .. } = self;
        if let Body::Arm(arm) = &mut self.body {
            arm.advance_to(now.as_secs_f64(), self.longest_step_s, *torques, |time, tip| {
                let time = time - *hand_from_s;
                let Some(offset) = grip.offset_m(time) else {
                    return HandLoad { force_n: weight.0, ..HandLoad::default() };
                };
                let mut load = hand.load(time, tip.0 - offset);
                load.force_n += weight.0 + pushes.iter().map(|push| push.force_n(time, tip.0)).sum::<Vector2<f64>>();
                load
            })?;
        }
        if self.filter.lag_s > 0.0 {
            // Torques are the same since the last moment to which the machine was moved on.
            let (_, truth, acceleration) = self.present(now)?;
            self.filter.advance_to(now.as_secs_f64(), self.carried_n(&truth, acceleration));
        }
        Ok(())
    }

    /// Makes the hand take the tool when all drives are in Operation Enabled, and let go of it when none makes torque any more.
    pub(super) fn lead_hand(&mut self, now: Time, states: &[cia402::State]) {
        if !self.has_hand {
            return;
        }
        if !states.is_empty() && states.iter().all(|state| *state == cia402::State::OperationEnabled) {
            self.take_tool(now);
        } else if self.hand_from_s.is_finite() && !states.iter().any(|state| state.has_torque()) {
            self.let_go();
        }
    }

    /// Makes the hand let go of the tool until [`World::take_tool`].
    pub(super) fn let_go(&mut self) {
        self.grip = Grip::LetGo;
    }

    /// Makes the hand take the tool from `now` on: the scene begins, or goes on where its path is by now.
    pub(super) fn take_tool(&mut self, now: Time) {
        let now_s = now.as_secs_f64();
        if self.hand_from_s == f64::INFINITY {
            self.hand_from_s = now_s;
        } else if self.grip == Grip::LetGo {
            let from_s = now_s - self.hand_from_s;
            let offset_m = self.truth.tip.0 - self.hand.target(from_s).position_m;
            self.grip = Grip::Again { from_s, offset_m };
        }
    }

    /// Replaces the hand's path by a person's motion: from `now` on the hand holds the tool and aims so, or has let go of it.
    pub(super) fn move_hand(&mut self, now: Time, aim: Option<PathPoint<2>>) {
        // States of the drives neither take the tool nor let go of it.
        self.has_hand = false;
        self.grip = if aim.is_some() { Grip::Firm } else { Grip::LetGo };
        if let Some(aim) = aim {
            self.hand.aim_at(now.as_secs_f64() - self.hand_from_s, aim);
        }
    }

    /// Angles and rates of the joints.
    fn motion(&self) -> (JointAngles, JointRates) {
        match &self.body {
            Body::Arm(arm) => (arm.motor_angles(), arm.motor_rates()),
            Body::Ideal(ideal) => (ideal.angles, JointRates::default()),
        }
    }

    /// Returns the record of the machine without a master: the supervisor idles in it, and there is no proxy.
    #[cfg(feature = "recording")]
    pub(super) fn record(&mut self, now: Time, states: [cia402::State; 2]) -> yieldwall_record::CycleRecord {
        use yieldwall_record::recording::Recorded;
        use yieldwall_record::{self as record, CycleRecord, Moment};
        let mut record = CycleRecord::blank();
        // Before the first SYNC nothing has been sampled.
        let present = self.present(now).map(|(_, truth, _)| truth);
        let Truth { tip, velocity, force } = present.unwrap_or(self.truth);
        let sync_ns = now.0;
        record.moment = Moment {
            sync_ns,
            compute_ns: sync_ns,
            scene_time_s: now.as_secs_f64() - self.hand_from_s,
            ..record.moment
        };
        record.inputs.drives.iter_mut().zip(states).for_each(|(drive, state)| drive.state = state);
        let (angles, none) = (self.motion().0, TipPoint(Vector2::repeat(f64::NAN)));
        let signals = &mut record.signals;
        (signals.tool, signals.force, signals.proxy) = (tip, force, none);
        (signals.measured_angles, signals.target_angles) = (angles, angles);
        record.truth = Some(record::Truth { tool: tip, velocity, torques: self.torques });
        record
    }

    /// Closes and opens the brakes of the joints.
    pub(super) fn brake(&mut self, are_braked: [bool; 2]) {
        self.are_braked = are_braked;
        if let Body::Arm(arm) = &mut self.body {
            arm.set_braked(are_braked);
        }
    }

    /// Makes a person guide the tool of an arm that nobody holds to a point, and let it rest there.
    ///
    /// # Errors
    /// If the linkage does not reach it.
    pub(super) fn put(&mut self, tip: TipPoint) -> Result<(), RigError> {
        if let Body::Arm(arm) = &mut self.body {
            arm.put(arm.linkage().inverse(tip)?);
        }
        Ok(())
    }

    /// Angles as a person sees them who looks at the arm.
    pub(super) fn seen_angles(&self) -> JointAngles {
        self.links
    }

    /// Angles and rates as the encoders see them.
    pub(super) fn joints(&mut self) -> (JointAngles, JointRates) {
        let (angles, rates) = self.motion();
        self.links = self.defects.links(self.links, angles);
        self.defects.measured(angles, rates)
    }

    /// Returns the true torques of the joints, for the torques that the drives mean to make.
    pub(super) fn made_of(&self, meant: JointTorques) -> JointTorques {
        if self.defects.is_none() { meant } else { self.defects.made_of(meant, self.motion().0) }
    }

    /// Puts the ideal joints on their targets, one SYNC later.
    pub(super) fn follow(&mut self, now: Time, targets: JointAngles) -> Result<(), RigError> {
        if let Body::Ideal(ideal) = &mut self.body {
            let elapsed = now.as_secs_f64() - ideal.time_s;
            let tip = ideal.linkage.forward(targets)?.tip;
            if elapsed > 0.0 {
                let velocity = (tip - ideal.tip).over_s(elapsed);
                ideal.acceleration = ((velocity - ideal.velocity) / elapsed).0;
                ideal.velocity = velocity;
            }
            ideal.time_s = now.as_secs_f64();
            (ideal.angles, ideal.tip) = (targets, tip);
        }
        Ok(())
    }

    /// Notes the truth of this moment as what the drives have sampled.
    pub(super) fn sample(&mut self, now: Time) -> Result<(), RigError> {
        let (_, truth, _) = self.present(now)?;
        self.truth = truth;
        self.sampled = Some(truth);
        Ok(())
    }

    /// Returns the arm's posture at `now`, the truth of this moment, and the acceleration of the tool, m/s^2.
    fn present(&mut self, now: Time) -> Result<(Posture, Truth, Vector2<f64>), RigError> {
        let time = now.as_secs_f64() - self.hand_from_s;
        let (posture, position, velocity, acceleration) = match &self.body {
            Body::Arm(arm) => {
                let posture = arm.posture()?;
                let tip = arm.tip_in(&posture);
                (posture, tip.position, tip.velocity, Vector2::from(tip.acceleration_m_per_s2))
            }
            Body::Ideal(ideal) => (ideal.linkage.forward(ideal.angles)?, ideal.tip, ideal.velocity, ideal.acceleration),
        };
        let force = match self.grip.offset_m(time) {
            None => self.weight,
            Some(offset) => {
                let pushed = self.pushes.iter().map(|push| push.force_n(time, position.0)).sum::<Vector2<f64>>();
                let pushed = pushed + self.weight.0;
                Force(self.hand.force_on_tool(time, position.0 - offset, velocity.0, acceleration) + pushed)
            }
        };
        Ok((posture, Truth { tip: position, velocity, force }, acceleration))
    }

    /// Returns the force in the sensor, N: the force of the hand, less the force that accelerates the handle between both.
    fn carried_n(&self, truth: &Truth, acceleration: Vector2<f64>) -> Vector2<f64> {
        truth.force.0 - acceleration * self.handle_kg
    }

    /// Returns the readings of the force sensor's channels at `now`, in counts; notes the true state of this moment.
    pub(super) fn feel(&mut self, now: Time) -> Result<[i32; 6], RigError> {
        let (posture, truth, acceleration) = self.present(now)?;
        self.truth = truth;
        let carried = self.carried_n(&truth, acceleration);
        let felt = if self.filter.lag_s > 0.0 { self.filter.output } else { carried };
        let link = self.mounting.link_rotation(posture.distal_rotation);
        let mut counts = self.calibration.counts_for(&self.mounting.to_sensor(Force(felt), 0.0, link));
        if self.noise_counts > 0.0 {
            let range = self.calibration.range_counts();
            for count in &mut counts {
                *count = (f64::from(*count) + self.noise_counts * standard_normal(&mut self.noise)).round() as i32;
                *count = (*count).clamp(-range, range);
            }
        }
        Ok(self.defects.counts(counts))
    }
}
