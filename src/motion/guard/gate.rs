//! The gate: the only maker of [`Allowed`] commands.

use super::fault::Fault;
use crate::quantity::{JointAngles, JointRates, JointTorques};

/// Next command to the joints, in the rig's command mode. A set-point has its unit in its type:
///
/// ```
/// use yieldwall_motion::guard::JointCommand;
/// use yieldwall_motion::quantity::JointTorques;
/// let command = JointCommand::Torque(JointTorques::new(1.0, 2.0));
/// ```
/// ```compile_fail
/// use yieldwall_motion::guard::JointCommand;
/// use yieldwall_motion::quantity::JointAngles;
/// let command = JointCommand::Torque(JointAngles::new(1.0, 2.0));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JointCommand {
    /// Target angles for drives that close the position loop themselves (CSP).
    Position(JointAngles),
    /// Target rates for drives that close the velocity loop themselves (CSV).
    Velocity(JointRates),
    /// Torques (CST).
    Torque(JointTorques),
}

/// A command that passed the gate. Nothing else can be scaled and encoded.
///
/// ```compile_fail
/// use yieldwall_motion::guard::{Allowed, JointCommand};
/// use yieldwall_motion::quantity::JointTorques;
/// let command = JointCommand::Torque(JointTorques::new(1.0, 2.0));
/// // Only the gate says so.
/// let allowed = Allowed(command);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allowed<T>(T);

impl<T> Allowed<T> {
    /// Returns the allowed value.
    pub fn get(&self) -> &T {
        &self.0
    }
}

impl Allowed<JointCommand> {
    /// Returns the command that moves nothing: `angles`, no rate, no torque, in the mode of `like`.
    ///
    /// Real-time: yes.
    pub fn rest(like: &JointCommand, angles: JointAngles) -> Self {
        Allowed(match like {
            JointCommand::Position(_) => JointCommand::Position(angles),
            JointCommand::Velocity(_) => JointCommand::Velocity(JointRates::default()),
            JointCommand::Torque(_) => JointCommand::Torque(JointTorques::default()),
        })
    }
}

/// Measurements of the joints in this cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measured {
    /// Angles of the proximal links.
    pub angles: JointAngles,
    /// Their rates, backward difference over one cycle.
    pub rates: JointRates,
}

/// Limits of the gate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Cycle time in s, positive.
    pub period_s: f64,
    /// Largest torque of each joint in N m, positive. Larger torques are cut to it.
    pub torque_n_m: [f64; 2],
    /// Largest rate of a joint in rad/s, positive. A faster command is a fault.
    pub joint_speed_rad_per_s: f64,
}

/// The gate with the target that it let through last.
#[derive(Clone, Debug)]
pub struct Gate {
    limits: Limits,
    /// The largest torque of each joint as it was made, N m.
    own_torque_n_m: [f64; 2],
    last_target: Option<JointAngles>,
}

impl Gate {
    /// Creates a gate that has let nothing through yet.
    pub fn new(limits: Limits) -> Self {
        Self { limits, own_torque_n_m: limits.torque_n_m, last_target: None }
    }

    /// Returns the command that moves nothing, at the measured angles: [`Allowed::rest`]. After it a position target starts from
    /// there.
    ///
    /// Real-time: yes.
    pub fn rest(&mut self, like: &JointCommand, measured: &Measured) -> Allowed<JointCommand> {
        self.last_target = Some(measured.angles);
        Allowed::rest(like, measured.angles)
    }

    /// Lets as much torque through as when it was made.
    pub fn restore_torque(&mut self) {
        self.limits.torque_n_m = self.own_torque_n_m;
    }

    /// Lets less torque through from now on: at most `torque_n_m` of each joint, in N m. It lets no more through until
    /// [`Gate::restore_torque`].
    pub fn lower_torque(&mut self, torque_n_m: f64) {
        self.limits.torque_n_m.iter_mut().for_each(|most| *most = most.min(torque_n_m.max(0.0)));
    }

    /// Lets `command` through, with torques cut to the limit, and says whether a torque was cut.
    ///
    /// # Errors
    /// [`Fault::NotFinite`] for a NaN or infinite component, [`Fault::OverSpeed`] for a target or a rate faster than
    /// the limit.
    ///
    /// Real-time: yes.
    pub fn check(
        &mut self,
        command: &JointCommand,
        measured: &Measured,
    ) -> Result<(Allowed<JointCommand>, bool), Fault> {
        let speed = self.limits.joint_speed_rad_per_s;
        match command {
            JointCommand::Position(target) => {
                if !target.is_finite() {
                    return Err(Fault::NotFinite);
                }
                let from = self.last_target.unwrap_or(measured.angles);
                if (*target - from).max_abs() > speed * self.limits.period_s {
                    return Err(Fault::OverSpeed);
                }
                self.last_target = Some(*target);
                Ok((Allowed(*command), false))
            }
            JointCommand::Velocity(rates) => {
                if !rates.is_finite() {
                    return Err(Fault::NotFinite);
                }
                if rates.max_abs() > speed {
                    return Err(Fault::OverSpeed);
                }
                Ok((Allowed(*command), false))
            }
            JointCommand::Torque(torques) => {
                if !torques.is_finite() {
                    return Err(Fault::NotFinite);
                }
                let [left, right] = self.limits.torque_n_m;
                let cut = JointTorques::new(torques.left().clamp(-left, left), torques.right().clamp(-right, right));
                Ok((Allowed(JointCommand::Torque(cut)), cut != *torques))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn gate() -> Gate {
        Gate::new(Limits { period_s: 1e-3, torque_n_m: [60.0, 50.0], joint_speed_rad_per_s: 6.0 })
    }

    #[test]
    fn the_first_position_starts_from_the_measurement() {
        let measured = Measured { angles: JointAngles::new(1.0, 2.0), ..Measured::default() };
        assert!(gate().check(&JointCommand::Position(JointAngles::new(1.0059, 2.0)), &measured).is_ok());
        assert_eq!(
            gate().check(&JointCommand::Position(JointAngles::new(1.0061, 2.0)), &measured),
            Err(Fault::OverSpeed)
        );
    }

    #[test]
    fn what_is_at_its_limit_passes_and_the_next_number_does_not() {
        let measured = Measured::default();
        let (step, speed) = (6.0 * 1e-3, 6.0f64);
        let position = |angle: f64| JointCommand::Position(JointAngles::new(0.0, angle));
        let velocity = |rate: f64| JointCommand::Velocity(JointRates::new(rate, 0.0));
        for (at, beyond) in [(position(-step), position(-step.next_up())), (velocity(speed), velocity(speed.next_up()))]
        {
            assert_eq!(gate().check(&at, &measured), Ok((Allowed(at), false)));
            assert_eq!(gate().check(&beyond, &measured), Err(Fault::OverSpeed));
        }
        let torque = |left: f64, right: f64| JointCommand::Torque(JointTorques::new(left, right));
        for (wanted, allowed, is_cut) in [
            (torque(60.0, -50.0), torque(60.0, -50.0), false),
            (torque(-61.0, 51.0), torque(-60.0, 50.0), true),
            (torque(1.0, -51.0), torque(1.0, -50.0), true),
        ] {
            assert_eq!(gate().check(&wanted, &measured), Ok((Allowed(allowed), is_cut)));
        }
    }

    #[test]
    fn a_target_is_held_against_the_last_one_that_passed() {
        let measured = Measured { angles: JointAngles::new(0.5, 0.0), ..Measured::default() };
        let mut gate = gate();
        let mut passes =
            |angle: f64| gate.check(&JointCommand::Position(JointAngles::new(angle, 0.0)), &measured).is_ok();
        assert!(passes(0.505) && passes(0.510), "two steps, though the joint has not moved");
        assert!(!passes(0.520) && passes(0.515), "a refused target is none");
        let rest = gate.rest(&JointCommand::Position(JointAngles::default()), &measured);
        assert_eq!(*rest.get(), JointCommand::Position(measured.angles));
        let again = JointCommand::Position(JointAngles::new(0.515, 0.0));
        assert_eq!(gate.check(&again, &measured), Err(Fault::OverSpeed), "after a rest it starts from the measurement");
    }

    proptest! {
        #[test]
        fn nothing_beyond_the_limits_passes(x in any::<f64>(), y in any::<f64>()) {
            let measured = Measured::default();
            let mut gate = gate();
            if let Ok((allowed, cut)) = gate.check(&JointCommand::Torque(JointTorques::new(x, y)), &measured) {
                let JointCommand::Torque(torque) = allowed.get() else { unreachable!() };
                prop_assert!(torque.left().abs() <= 60.0 && torque.right().abs() <= 50.0);
                prop_assert_eq!(cut, x.abs() > 60.0 || y.abs() > 50.0);
            } else {
                prop_assert!(!(x.is_finite() && y.is_finite()));
            }
            if let Ok((allowed, _)) = gate.check(&JointCommand::Position(JointAngles::new(x, y)), &measured) {
                let JointCommand::Position(target) = allowed.get() else { unreachable!() };
                prop_assert!(target.max_abs() <= 6.0e-3);
            }
            if let Ok((allowed, _)) = gate.check(&JointCommand::Velocity(JointRates::new(x, y)), &measured) {
                let JointCommand::Velocity(rates) = allowed.get() else { unreachable!() };
                prop_assert!(rates.max_abs() <= 6.0);
            }
        }
    }
}
