//! The physical side of the embedded simulation: the arm with the hand on it, and what the devices feel of it.

use nalgebra::Vector2;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;

use super::error::RigError;
use crate::canopen::Time;
use crate::linkage::FiveBar;
use crate::quantity::{Force, JointAngles, JointRates, JointTorques, TipPoint, TipVelocity};
use crate::sensing::{Calibration, Mounting};
use crate::sim::arm::Arm;
use crate::sim::hand::Hand;

/// How the tool follows the drives.
#[derive(Clone, Debug)]
pub(super) enum Body {
    /// The arm with its inertia and friction.
    Arm(Arm),
    /// No arm: the joints are where the drives were told to be.
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
    /// The hand lets go of the rig until this moment, so that it starts at rest and is enabled unloaded.
    pub(super) hand_from_s: f64,
    pub(super) truth: Truth,
}

impl World {
    pub(super) fn noise_from(seed: u64) -> Xoshiro256PlusPlus {
        // Apart from the hand's own stream, which starts from the seed itself.
        Xoshiro256PlusPlus::seed_from_u64(seed ^ 0x5e15_0000_0000_0001)
    }

    /// Moves on to `now` under the torques in force.
    pub(super) fn settle(&mut self, now: Time) -> Result<(), RigError> {
        let (torques, from) = (self.torques, self.hand_from_s);
        let hand = &mut self.hand;
        if let Body::Arm(arm) = &mut self.body {
            arm.advance_to(now.as_secs_f64(), self.longest_step_s, torques, |time, tip| {
                if time < from { Default::default() } else { hand.load(time - from, tip.0) }
            })?;
        }
        Ok(())
    }

    /// Angles and rates as the encoders see them.
    pub(super) fn joints(&self) -> (JointAngles, JointRates) {
        match &self.body {
            Body::Arm(arm) => (arm.motor_angles(), arm.motor_rates()),
            Body::Ideal(ideal) => (ideal.angles, JointRates::default()),
        }
    }

    /// Puts the ideal joints on their targets, one SYNC later.
    pub(super) fn follow(&mut self, now: Time, targets: JointAngles) -> Result<(), RigError> {
        if let Body::Ideal(ideal) = &mut self.body {
            let elapsed = now.as_secs_f64() - ideal.time_s;
            let tip = ideal.linkage.forward(targets)?.tip;
            if elapsed > 0.0 {
                let velocity = TipVelocity((tip.0 - ideal.tip.0) / elapsed);
                ideal.acceleration = (velocity.0 - ideal.velocity.0) / elapsed;
                ideal.velocity = velocity;
            }
            ideal.time_s = now.as_secs_f64();
            (ideal.angles, ideal.tip) = (targets, tip);
        }
        Ok(())
    }

    /// What the force sensor's channels read at `now`, in counts; notes the truth of this moment.
    pub(super) fn feel(&mut self, now: Time) -> Result<[i32; 6], RigError> {
        let time = now.as_secs_f64() - self.hand_from_s;
        let (posture, position, velocity, acceleration) = match &self.body {
            Body::Arm(arm) => {
                let posture = arm.posture()?;
                let tip = arm.tip_in(&posture);
                (posture, tip.position, tip.velocity, Vector2::from(tip.acceleration_m_per_s2))
            }
            Body::Ideal(ideal) => (ideal.linkage.forward(ideal.angles)?, ideal.tip, ideal.velocity, ideal.acceleration),
        };
        let force = if time < 0.0 {
            Force::default()
        } else {
            Force(self.hand.force_on_tool(time, position.0, velocity.0, acceleration))
        };
        self.truth = Truth { tip: position, velocity, force };
        let link_angle = self.mounting.link_angle_rad(posture.distal_angle_rad);
        let mut counts = self.calibration.counts_for(&self.mounting.to_sensor(force, 0.0, link_angle));
        if self.noise_counts > 0.0 {
            let range = self.calibration.range_counts();
            for count in &mut counts {
                let sample: f64 = StandardNormal.sample(&mut self.noise);
                *count = (f64::from(*count) + self.noise_counts * sample).round() as i32;
                *count = (*count).clamp(-range, range);
            }
        }
        Ok(counts)
    }
}
