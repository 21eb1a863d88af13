//! Injections carried out: each begins and ends as the script says, in the part of the simulation that it concerns.

use super::injectable::{InjectableDrive, InjectableSensor, is_at};
use super::simulation::Simulation;
use crate::injection::{Injection, Kind, Lasts, Medium, Target};
use crate::rig::error::RigError;
use crate::rig::far_end::{Plug, SENSOR};
use crate::rig::world::Body;
use crate::time::Time;

/// Slack of moments in s, far below a cycle.
const SLACK_S: f64 = 1e-9;

/// Where an injection acts.
enum Place {
    /// On frames, and on the master's interfaces.
    Buses,
    /// In the devices that its target names.
    Devices,
    /// On hand and arm.
    Body,
    /// On the computer that runs the master.
    Computer,
}

impl Place {
    fn of(injection: Injection) -> Self {
        let Injection { kind, target, .. } = injection;
        match target {
            Target::Hand => Self::Body,
            Target::Host | Target::Operator => Self::Computer,
            _ if kind == Kind::ArmBlocked => Self::Body,
            _ if InjectableDrive::has(kind) || InjectableSensor::has(kind) => Self::Devices,
            _ => Self::Buses,
        }
    }
}

impl Simulation {
    /// Adds an injection. It acts from the first cycle at or after its start to the last one before its end; what is
    /// there from switching on acts at once.
    ///
    /// # Errors
    /// If it is not possible, on this rig or at all.
    pub(super) fn inject(&mut self, injection: Injection) -> Result<(), RigError> {
        injection.check_on(Medium::Can)?;
        if injection.kind == Kind::ArmBlocked && matches!(self.far.world.body, Body::Ideal(_)) {
            let message = "arm-blocked needs `model.tracking: rigid`: there is no arm to block";
            return Err(RigError::Mismatch(message.into()));
        }
        if let Some(needed) = self.wires.needed(injection) {
            return Err(RigError::Mismatch(format!("{} needs {needed}", injection.kind.row().name)));
        }
        if injection.kind.row().lasts == Lasts::FromBoot {
            self.begin(injection);
        } else {
            self.script.add(injection);
        }
        Ok(())
    }

    /// Ends all injections and has these follow.
    ///
    /// # Errors
    /// As [`Simulation::inject`].
    pub(super) fn set_injections(&mut self, injections: &[Injection]) -> Result<(), RigError> {
        for injection in self.script.stop() {
            self.end(injection);
        }
        injections.iter().try_for_each(|injection| self.inject(*injection))
    }

    /// Forgets what was injected and what the scene would.
    pub(super) fn clear_injections(&mut self) {
        self.script.stop();
        self.wires.clear();
        self.far.drives.iter_mut().for_each(InjectableDrive::clear);
        self.far.sensor.clear();
        self.computer.clear();
    }

    /// Begins and ends what is due at the beginning of a cycle.
    pub(super) fn follow_script(&mut self, sync_at: Time) {
        let time_s = sync_at.as_secs_f64() - self.far.world.hand_from_s + SLACK_S;
        if !self.script.is_due(time_s) {
            return;
        }
        while let Some(injection) = self.script.take_ending(time_s) {
            self.end(injection);
        }
        while let Some(injection) = self.script.take_beginning(time_s) {
            self.begin(injection);
        }
    }

    fn begin(&mut self, injection: Injection) {
        tracing::debug!(name = injection.kind.row().name, target = injection.target.name(), "injection");
        self.script.begin(injection);
        self.switch(injection, true);
    }

    fn end(&mut self, injection: Injection) {
        self.switch(injection, false);
    }

    fn switch(&mut self, injection: Injection, is_on: bool) {
        let Self { wires, far, computer, now, .. } = self;
        let now = *now;
        match Place::of(injection) {
            Place::Buses => wires.switch(now, injection, is_on),
            Place::Body => far.world.switch(injection, is_on),
            Place::Computer => computer.switch(injection, is_on),
            Place::Devices => {
                for (device, drive) in far.drives.iter_mut().enumerate() {
                    if is_at(injection.target, device) {
                        drive.switch(now, injection, is_on, &mut Plug { wire: &mut *wires, device, now });
                    }
                }
                if is_at(injection.target, SENSOR) {
                    let scene_from_s = far.world.hand_from_s;
                    let plug = &mut Plug { wire: wires, device: SENSOR, now };
                    far.sensor.switch(now, scene_from_s, injection, is_on, plug);
                }
            }
        }
    }
}
