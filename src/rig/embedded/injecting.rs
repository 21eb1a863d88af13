//! Injections carried out: what begins and ends, and what it does to devices, hand and arm.

use super::schedule::Schedule;
use super::simulation::Simulation;
use super::trouble::is_at;
use super::{RigError, STRANGER};
use crate::canopen::{Frame, Time, cob};
use crate::injection::{Injection, Kind, Lasts};
use crate::rig::far_end::Plug;
use crate::rig::world::{Body, Push, PushShape};

/// Slack of moments in s, far below a cycle.
const SLACK_S: f64 = 1e-9;
/// Emergency of a drive: voltage of the DC link too high; of the sensor: device hardware.
const EMERGENCIES: [u16; 3] = [0x3210, 0x3210, 0x5000];
/// Download of 6007h = 0 in two bytes: the drive goes on when its master's heartbeat stays away.
const ABORT_CONNECTION_IGNORED: [u8; 8] = [0x2b, 0x07, 0x60, 0, 0, 0, 0, 0];
/// Emergency that is a warning: messages were lost.
const WARNING: u16 = 0x8110;

impl Simulation {
    /// Adds an injection. It acts from the first cycle at or after its start to the last one before its end; what is
    /// there from switching on acts at once.
    ///
    /// # Errors
    /// If it is not possible, on this rig or at all.
    pub(super) fn inject(&mut self, injection: Injection) -> Result<(), RigError> {
        injection.check()?;
        if injection.kind == Kind::ArmBlocked && matches!(self.far.world.body, Body::Ideal(_)) {
            let message = "arm-blocked needs `model.tracking: rigid`: there is no arm to block";
            return Err(RigError::Mismatch(message.into()));
        }
        if let Some(needed) = self.troubles.refuse(injection) {
            return Err(RigError::Mismatch(format!("{} needs {needed}", injection.kind.row().name)));
        }
        if injection.kind.row().lasts == Lasts::FromBoot {
            self.begin(injection);
        } else {
            self.schedule.waiting.push(injection);
        }
        self.plan();
        Ok(())
    }

    /// Ends all injections and has these follow.
    ///
    /// # Errors
    /// As [`EmbeddedRig::inject`].
    pub(super) fn set_injections(&mut self, injections: &[Injection]) -> Result<(), RigError> {
        self.schedule.waiting.clear();
        self.end_where(|_| true);
        injections.iter().try_for_each(|injection| self.inject(*injection))
    }

    /// Forgets what was injected and what the scene would.
    pub(super) fn clear_injections(&mut self) {
        self.schedule = Schedule::default();
        self.troubles.clear();
    }

    fn plan(&mut self) {
        let starts = self.schedule.waiting.iter().map(|injection| injection.start_s);
        self.schedule.next_change_s = starts.fold(self.troubles.next_end_s(), f64::min);
    }

    /// Begins and ends what is due at the beginning of a cycle.
    pub(super) fn follow_injections(&mut self, sync_at: Time) {
        let time_s = sync_at.as_secs_f64() - self.far.world.hand_from_s + SLACK_S;
        if time_s < self.schedule.next_change_s {
            return;
        }
        self.end_where(|injection| injection.end_s() <= time_s);
        while let Some(at) = self.schedule.waiting.iter().position(|injection| injection.start_s <= time_s) {
            let injection = self.schedule.waiting.remove(at);
            self.begin(injection);
        }
        self.plan();
    }

    fn end_where(&mut self, is_over: impl Fn(&Injection) -> bool) {
        while let Some(injection) = self.troubles.end_one(&is_over) {
            self.switch(injection, false);
        }
    }

    fn begin(&mut self, injection: Injection) {
        tracing::debug!(name = injection.kind.row().name, target = injection.target.name(), "injection");
        if injection.kind.row().lasts == Lasts::Once {
            self.happen(injection);
        } else {
            self.troubles.begin(injection);
            self.switch(injection, true);
        }
    }

    /// What happens once.
    fn happen(&mut self, injection: Injection) {
        let now = self.now;
        match injection.kind {
            Kind::StopRequest => self.computer.stop_is_requested = true,
            Kind::CyclePanic => self.computer.panics = true,
            _ => {}
        }
        for device in (0..3).filter(|device| is_at(injection.target, *device)) {
            if injection.kind == Kind::NodeReset {
                self.far.switch_on(device, now, &mut self.buses);
                continue;
            }
            let Some(node) = self.troubles.node(device) else { continue };
            let bus = self.buses.of_device(device);
            let plug = &mut Plug { wire: &mut self.buses, device, now };
            let emergency = |code: u16| {
                let [low, high] = code.to_le_bytes();
                Frame::new(cob::emcy(node), &[low, high, 0x01, 0, 0, 0, 0, 0])
            };
            match injection.kind {
                Kind::Emergency => self.troubles.send(now, device + 1, emergency(EMERGENCIES[device]).on_bus(bus)),
                Kind::EmergencyWarning => self.troubles.send(now, device + 1, emergency(WARNING).on_bus(bus)),
                Kind::IntruderNmt => {
                    self.troubles.send(now, STRANGER, Frame::new(cob::NMT, &[0x80, node.raw()]).on_bus(bus));
                }
                Kind::ForeignDownload => {
                    let download = Frame::new(cob::sdo_request(node), &ABORT_CONNECTION_IGNORED);
                    self.troubles.send(now, STRANGER, download.on_bus(bus));
                }
                Kind::DriveFault => {
                    if let Some(drive) = self.far.drives.get_mut(device) {
                        drive.raise_fault(now, injection.size as u16, plug);
                    }
                }
                Kind::DriveLeavesOperation => {
                    if let Some(drive) = self.far.drives.get_mut(device) {
                        drive.leave_operation(now, plug);
                    }
                }
                _ => {}
            }
        }
    }

    /// Switches on, or off again, what lasts; [`super::trouble::Troubles`] does the rest.
    fn switch(&mut self, injection: Injection, is_on: bool) {
        let Injection { kind, target, size, .. } = injection;
        let now = self.now;
        match kind {
            Kind::SensorInvalid => self.far.sensor.set_invalid(is_on),
            Kind::SensorStale => self.far.sensor.set_clock_rate(if is_on { 0.0 } else { 1.0 }),
            Kind::SensorClockDrift => self.far.sensor.set_clock_rate(if is_on { size } else { 1.0 }),
            Kind::HandPush | Kind::HandOverload => self.push(PushShape::Along, injection, is_on),
            Kind::HandBlow => self.push(PushShape::Blow, injection, is_on),
            Kind::HandSwing => self.push(PushShape::Swing, injection, is_on),
            Kind::HandTremble => self.push(PushShape::Tremble, injection, is_on),
            Kind::HandToEdge => self.push(PushShape::Outward, injection, is_on),
            Kind::HandStiff => {
                // The sizes of the catalogue keep it finite and not negative.
                let share = if is_on { size } else { 1.0 };
                let _ = self.far.world.hand.set_stiffness(self.far.world.hand_stiffness_n_per_m * share);
            }
            Kind::MasterKilled => (self.computer.is_asleep, self.computer.is_dead) = (true, true),
            Kind::TransmitStalled | Kind::CableOut | Kind::WrongBitRate => {
                self.buses.hold(now, |bus| self.troubles.is_transmit_held(bus));
            }
            Kind::NodeSilent => {
                for device in (0..3).filter(|device| is_at(target, *device)) {
                    match self.far.drives.get_mut(device) {
                        _ if !is_on => self.far.switch_on(device, now, &mut self.buses),
                        Some(drive) => drive.switch_off(),
                        None => self.far.sensor.switch_off(),
                    }
                }
            }
            _ => {}
        }
        for (joint, drive) in self.far.drives.iter_mut().enumerate().filter(|(joint, _)| target.has_joint(*joint)) {
            match kind {
                Kind::DriveWarning => drive.set_warning(is_on),
                Kind::DriveIgnoresCommand => drive.set_ignores_targets(is_on),
                Kind::DriveNotEnabling => drive.set_ignores_controlword(is_on),
                Kind::VoltageOff => {
                    drive.set_voltage(now, !is_on, &mut Plug { wire: &mut self.buses, device: joint, now });
                }
                Kind::ArmBlocked => {
                    if let Body::Arm(arm) = &mut self.far.world.body {
                        arm.set_blocked(joint, is_on);
                    }
                }
                _ => {}
            }
        }
    }

    fn push(&mut self, shape: PushShape, injection: Injection, is_on: bool) {
        let Injection { size, start_s, .. } = injection;
        let push = Push { shape, size_n: size, start_s, end_s: injection.end_s() };
        if is_on {
            self.far.world.pushes.push(push);
        } else {
            self.far.world.pushes.retain(|known| *known != push);
        }
    }
}
