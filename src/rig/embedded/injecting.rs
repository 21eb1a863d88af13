//! Injections carried out: each begins and ends as the script says, in the part of the simulation that it concerns.

use super::injectable::{InjectableDrive, InjectableSensor};
use super::simulation::Simulation;
use crate::error::RigError;
use crate::far_end::{Plug, SENSOR};
use crate::line::Line;
use crate::world::Body;
use yieldwall_config::injection::{Injection, Kind, Lasts, Medium, Target};
use yieldwall_fieldbus::time::Time;

/// Slack of moments in s, far below a cycle.
const SLACK_S: f64 = 1e-9;

/// Where an injection acts.
enum InjectionPoint {
    /// On frames of CAN, and on the master's interfaces there.
    Buses,
    /// On frames of a segment, and on the master's interface there.
    Cable,
    /// On all of the master's interfaces.
    Interfaces,
    /// In the devices that its target names.
    Devices,
    /// On hand and arm.
    Body,
    /// On the computer that runs the master.
    Computer,
}

impl Simulation {
    /// Adds an injection. It acts from the first cycle at or after its start to the last one before its end; what is
    /// there from switching on acts at once.
    ///
    /// # Errors
    /// If it is not possible, on this rig or at all.
    pub(super) fn inject(&mut self, injection: Injection) -> Result<(), RigError> {
        injection.check_on(self.medium(injection))?;
        if injection.kind == Kind::ArmBlocked && matches!(self.far.world.body, Body::Ideal(_)) {
            return Err(RigError::NoArmToBlock);
        }
        if let Some(needed) = self.wires.needed(injection) {
            return Err(RigError::InjectionNeeds { injection: injection.kind.row().name, needed });
        }
        if injection.kind.row().lasts == Lasts::FromBoot {
            self.begin(injection);
        } else {
            self.script.add(injection);
        }
        Ok(())
    }

    fn medium(&self, injection: Injection) -> Medium {
        injection.medium(|device| self.far.line.as_ref().is_some_and(|line| line.has(device)))
    }

    fn place_of(&self, injection: Injection) -> InjectionPoint {
        let Injection { kind, target, .. } = injection;
        let is_on_segment = self.medium(injection) == Medium::Ethercat;
        match target {
            Target::Hand => InjectionPoint::Body,
            Target::Host | Target::Operator => InjectionPoint::Computer,
            _ if kind == Kind::ArmBlocked => InjectionPoint::Body,
            Target::Link if is_on_segment => InjectionPoint::Interfaces,
            Target::Bus if is_on_segment => InjectionPoint::Cable,
            // Its interface is that to the segment.
            _ if is_on_segment && injection.is_at_master() => InjectionPoint::Cable,
            _ if is_on_segment || InjectableDrive::has(kind) || InjectableSensor::has(kind) => InjectionPoint::Devices,
            _ => InjectionPoint::Buses,
        }
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
        self.cable.iter_mut().for_each(|(_, cable)| cable.clear());
        self.far.drives.iter_mut().flatten().for_each(InjectableDrive::clear);
        self.far.sensor.iter_mut().for_each(InjectableSensor::clear);
        self.far.line.iter_mut().for_each(Line::clear);
        self.computer.clear();
    }

    /// Begins and ends what is due at the beginning of a cycle.
    pub(super) fn follow_script(&mut self, sync_at: Time) {
        let time_s = self.sampled_for(sync_at).as_secs_f64() - self.far.world.hand_from_s + SLACK_S;
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
        let place = self.place_of(injection);
        let Self { wires, cable, far, computer, now, .. } = self;
        let (now, scene_from_s) = (*now, far.world.hand_from_s);
        match place {
            InjectionPoint::Buses => wires.switch(now, injection, is_on),
            InjectionPoint::Cable => cable.iter_mut().for_each(|(_, cable)| cable.switch(injection, is_on)),
            InjectionPoint::Interfaces => {
                wires.switch(now, injection, is_on);
                match injection.kind {
                    Kind::CableOut => far.line.iter_mut().for_each(|line| line.segment.set_cable(0, !is_on)),
                    _ => cable.iter_mut().for_each(|(_, cable)| cable.switch(injection, is_on)),
                }
            }
            InjectionPoint::Body => far.world.switch(injection, is_on),
            InjectionPoint::Computer => computer.switch(injection, is_on),
            InjectionPoint::Devices => {
                for (joint, (device, axis)) in far.seats.into_iter().enumerate() {
                    let drive = far.drives.get_mut(device).and_then(Option::as_mut);
                    if let Some(drive) = drive.filter(|_| injection.target.has_device(joint)) {
                        drive.switch(now, axis, injection, is_on, &mut Plug { wire: &mut *wires, device, now });
                    }
                }
                if let Some(sensor) = far.sensor.as_mut().filter(|_| injection.target.has_device(SENSOR)) {
                    let plug = &mut Plug { wire: wires, device: SENSOR, now };
                    sensor.switch(now, scene_from_s, injection, is_on, plug);
                }
                far.line.iter_mut().for_each(|line| line.switch(now, scene_from_s, injection, is_on));
            }
        }
    }
}
