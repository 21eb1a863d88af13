//! The configuration of one node by SDO, as a list of steps.

use crate::error::BootFailure;
use crate::script::{self, Action, Script, Step, command, common, lacking, servo, state, unit, width_mask};
use crate::setup::{DriveSetup, MasterSetup, SensorNode};
use std::time::Duration;
use yieldwall_drives::objects;
use yieldwall_drives::profiles::{
    DeviceProfile, Entry, Fieldbus, HeartbeatWatch, Identity, MappedObject, MappedPdo, Reset, Servo, SetPointWatch,
    SyncWatch, TimeUnit, TimedObject,
};
use yieldwall_drives::watchdog::{HEARTBEAT_PERIODS, WATCHED_CYCLES};
use yieldwall_fieldbus::canopen::{Frame, NmtCommand, NodeId, Outbox, SdoClient, SdoOutcome, cob};
use yieldwall_fieldbus::objects::{ObjectError, ObjectRequest};
use yieldwall_fieldbus::time::Time;

/// How often a node may restart while it is configured: a node that was switched on together with the master
/// announces itself once more after the reset command.
const RESTARTS: u8 = 3;
/// Bit 30 of 1005h and 1012h: the node makes the frames.
const PRODUCES: u32 = 1 << 30;
/// Bit 30 of 18xxh:1: the TPDO is not sent on remote frames.
const NO_REMOTE: u32 = 1 << 30;
/// PDOs of each direction that the master knows of; those that the profile does not name stay as the device has them.
const PDO_COUNT: u8 = 4;

/// The configuration of one node, step by step, over its SDO client.
#[derive(Clone, Debug)]
pub(super) struct Boot {
    script: Script,
    reset: Reset,
    started: bool,
    restarts: u8,
}

impl Boot {
    /// The boot of a device with these drives: one, or those that are its axes.
    pub(super) fn drives(master: &MasterSetup, drives: &[&DriveSetup], node: NodeId) -> Result<Self, BootFailure> {
        let [first, ..] = drives else { return Err(BootFailure::NodeId { node_id: node.raw() }) };
        let profile = &*first.profile;
        let mut steps = script::identity(profile);
        for drive in drives {
            let (profile, mode) = (&*drive.profile, script::operation(master.mode, drive.homing));
            let servo = servo(profile)?;
            steps.push(script::has_mode(servo, mode));
            script::homing(profile, servo, drive.homing, &mut steps)?;
        }
        steps.extend(no_producer());
        steps.push(heartbeat(first.heartbeat.as_millis() as u32));
        if let HeartbeatWatch::Consumer(consumer) = &servo(profile)?.watchdogs.heartbeat {
            let watch_ms = master.heartbeat.as_millis() as u32 * HEARTBEAT_PERIODS;
            let value = u32::from(master.node_id) << 16 | watch_ms;
            // The write begins the watch anew.
            steps.push(command("set the heartbeat watchdog", consumer, value));
        }
        for (number, drive) in drives.iter().enumerate() {
            let own = axis(master, drive)?;
            if number == 0 { steps.extend(own) } else { script::add_axis(&mut steps, own) }
        }
        steps.extend(free_identifiers(master, drives)?);
        for drive in drives {
            let map = script::pdos(&drive.profile, Some(master.mode.operation_mode()))?;
            let deadline_ms = match servo(&drive.profile)?.watchdogs.set_points {
                SetPointWatch::EventTimer { .. } => rpdo_deadline_ms(master.period.as_micros() as u32),
                SetPointWatch::None | SetPointWatch::BuiltIn(_) | SetPointWatch::Object(_) => 0,
            };
            steps.extend(pdos(&drive.profile, &map, node, deadline_ms)?);
        }
        Ok(Self::new(profile, first.waits.sdo, steps))
    }

    pub(super) fn sensor(sensor: &SensorNode, node: NodeId, timeout: Duration) -> Result<Self, BootFailure> {
        let profile = &*sensor.profile;
        let mut steps = script::identity(profile);
        steps.extend(no_producer());
        steps.push(heartbeat(sensor.heartbeat.as_millis() as u32));
        steps.extend(script::sensor(profile, &sensor.start)?);
        steps.extend(pdos(profile, &script::pdos(profile, None)?, node, 0)?);
        Ok(Self::new(profile, timeout, steps))
    }

    fn new(profile: &DeviceProfile, timeout: Duration, steps: Vec<Step>) -> Self {
        let script = Script::new(profile.identity.clone(), timeout, steps);
        Self { script, reset: profile.node.reset, started: false, restarts: 0 }
    }

    /// As it was before anything was sent.
    pub(super) fn reset(&mut self) {
        self.script.restart();
        (self.started, self.restarts) = (false, 0);
    }

    /// All that it does, in its order, and the identity that it looks for.
    pub(super) fn steps(&self) -> (&[Step], &Identity) {
        self.script.steps()
    }

    /// The command by which the node comes to its power-on values.
    pub(super) fn reset_command(&self) -> NmtCommand {
        match self.reset {
            Reset::Node => NmtCommand::ResetNode,
            Reset::Communication => NmtCommand::ResetCommunication,
        }
    }

    /// Words for the present step.
    pub(super) fn doing(&self) -> &'static str {
        self.script.doing()
    }

    pub(super) fn is_done(&self) -> bool {
        self.script.is_done()
    }

    pub(super) fn next_deadline(&self, client: &SdoClient) -> Time {
        let due = client.next_deadline().min(self.script.again_at);
        if self.is_done() || !self.started { Time::NEVER } else { due }
    }

    /// Sends the first request.
    pub(super) fn start(
        &mut self,
        now: Time,
        client: &mut SdoClient,
        out: &mut impl Outbox,
    ) -> Result<(), BootFailure> {
        self.started = true;
        self.request(now, client, out)
    }

    /// Begins anew with a node that has restarted: what was written to it is gone.
    pub(super) fn restart(
        &mut self,
        now: Time,
        client: &mut SdoClient,
        out: &mut impl Outbox,
    ) -> Result<(), BootFailure> {
        self.restarts += 1;
        if self.restarts > RESTARTS {
            return Err(BootFailure::Restarted { times: self.restarts });
        }
        client.cancel(out);
        self.script.restart();
        self.start(now, client, out)
    }

    pub(super) fn on_frame(
        &mut self,
        now: Time,
        frame: &Frame,
        client: &mut SdoClient,
        out: &mut impl Outbox,
    ) -> Result<(), BootFailure> {
        match client.on_frame(now, frame, out) {
            Some(outcome) => self.on_outcome(now, outcome, client, out),
            None => Ok(()),
        }
    }

    pub(super) fn poll(&mut self, now: Time, client: &mut SdoClient, out: &mut impl Outbox) -> Result<(), BootFailure> {
        if now >= self.script.again_at {
            self.script.again_at = Time::NEVER;
            return self.request(now, client, out);
        }
        match client.poll(now, out) {
            Some(outcome) => self.on_outcome(now, outcome, client, out),
            None => Ok(()),
        }
    }

    fn request(&mut self, now: Time, client: &mut SdoClient, out: &mut impl Outbox) -> Result<(), BootFailure> {
        let Some(wanted) = self.script.wanted()? else { return Ok(()) };
        let (at, started) = match wanted.request() {
            ObjectRequest::Read(at) => (at, client.start_upload(now, at.index, at.sub, out)),
            ObjectRequest::Write(at, data) => (at, client.start_download(now, at.index, at.sub, data, out)),
        };
        started.map_err(|_| BootFailure::NoAnswer { index: at.index, sub: at.sub })
    }

    fn on_outcome(
        &mut self,
        now: Time,
        outcome: SdoOutcome,
        client: &mut SdoClient,
        out: &mut impl Outbox,
    ) -> Result<(), BootFailure> {
        let answer = match outcome {
            SdoOutcome::Aborted { code, .. } => Err(ObjectError::Aborted(code)),
            SdoOutcome::TimedOut { .. } => Err(ObjectError::NoAnswer),
            SdoOutcome::Downloaded { .. } => Ok(&[][..]),
            SdoOutcome::Uploaded { .. } => Ok(client.data()),
        };
        self.script.on_answer(now, answer)?;
        if self.script.again_at != Time::NEVER { Ok(()) } else { self.request(now, client, out) }
    }
}

/// Steps that set the option codes, mode, limits and watchdogs of a drive.
fn axis(master: &MasterSetup, drive: &DriveSetup) -> Result<Vec<Step>, BootFailure> {
    let (servo, mode) = (servo(&drive.profile)?, script::operation(master.mode, drive.homing));
    let mut steps = Vec::new();
    let options = &servo.option_codes;
    script::settings(servo, options.lost_master.iter().chain(&options.communication_error), &mut steps);
    script::brake(servo, &mut steps);
    let period_us = master.period.as_micros() as u32;
    script::mode(servo, mode, period_us, &mut steps)?;
    let (speed, window) = (drive.speed_limit_counts_per_s, drive.following_error_counts);
    script::limits(servo, drive.torque_limit_per_mille, speed, window, &mut steps);
    watches(servo, period_us, &mut steps)?;
    Ok(steps)
}

/// Keeps PDOs of a first axis that nobody uses from the default identifiers that PDOs of other axes use.
fn free_identifiers(master: &MasterSetup, drives: &[&DriveSetup]) -> Result<Vec<Step>, BootFailure> {
    let mut used: [Vec<MappedPdo>; 2] = Default::default();
    for drive in drives {
        let maps = script::pdos(&drive.profile, Some(master.mode.operation_mode()))?;
        used.iter_mut().zip(maps).for_each(|(used, pdos)| used.extend(pdos));
    }
    let mut steps = Vec::new();
    for (used, communication) in used.iter().zip([0x1400, 0x1800]) {
        for taken in used.iter().filter(|pdo| pdo.canopen_number() != pdo.identifier) {
            let number = u16::from(taken.identifier);
            if (1..=u16::from(PDO_COUNT)).contains(&number) && !used.iter().any(|pdo| pdo.number == number) {
                let action = Action::Bits { mask: cob::INVALID, value: cob::INVALID };
                let index = communication + number - 1;
                steps.push(Step { doing: "free identifiers for its other axes", index, sub: 1, bytes: 4, action });
            }
        }
    }
    steps.extend(unused_axes(master, drives)?);
    Ok(steps)
}

/// Switches off process data that an earlier rig may have stored for axes that no drive is: they would take set-points of others.
fn unused_axes(master: &MasterSetup, drives: &[&DriveSetup]) -> Result<Vec<Step>, BootFailure> {
    let mut steps = Vec::new();
    let Some((profile, own)) = drives.first().and_then(|drive| Some((&drive.profile, drive.profile.axis()?))) else {
        return Ok(steps);
    };
    let step =
        profile.servo().and_then(|servo| servo.axes.as_ref()).map_or(0, |axes| axes.pdo_step_on(Fieldbus::Canopen));
    let maps = script::pdos(profile, Some(master.mode.operation_mode()))?;
    let is_used = |axis: &u8| drives.iter().any(|drive| drive.profile.axis() == Some(*axis));
    for axis in (0..profile.axes()).filter(|axis| !is_used(axis)) {
        for (pdos, communication) in maps.iter().zip([0x1400, 0x1800]) {
            let first = |pdo: &MappedPdo| pdo.number.saturating_sub(step * u16::from(own));
            steps.extend(pdos.iter().map(|pdo| Step {
                doing: "switch off axes that are not used",
                index: communication + (first(pdo) + step * u16::from(axis)).saturating_sub(1),
                sub: 1,
                bytes: 4,
                action: Action::Bits { mask: cob::INVALID, value: cob::INVALID },
            }));
        }
    }
    Ok(steps)
}

fn heartbeat(period_ms: u32) -> Step {
    common("set the heartbeat", objects::PRODUCER_HEARTBEAT, Action::State { value: period_ms, kept: 0 })
}

/// Keeps the node from making SYNC and TIME: the master alone makes them. Bit 30 of their identifiers (1005h, 1012h) would have it do so.
fn no_producer() -> [Step; 2] {
    let step =
        |doing, index| Step { doing, index, sub: 0, bytes: 4, action: Action::Bits { mask: PRODUCES, value: 0 } };
    [step("disable SYNC generation", 0x1005), step("disable TIME generation", 0x1012)]
}

/// The watchdogs that are set by objects of their own.
fn watches(servo: &Servo, period_us: u32, steps: &mut Vec<Step>) -> Result<(), BootFailure> {
    let after_us = period_us.saturating_mul(WATCHED_CYCLES);
    let mut watch = |doing, timed: &TimedObject| {
        let Entry { index, sub, .. } = timed.object;
        let value = match timed.unit {
            TimeUnit::Us(unit) => after_us.div_ceil(unit.max(1)),
            TimeUnit::Cycles => WATCHED_CYCLES,
        };
        if value > width_mask(timed.object.bytes()) {
            return Err(BootFailure::WatchTime { index, sub, after_us });
        }
        steps.push(state(doing, &timed.object, value));
        Ok(())
    };
    if let SetPointWatch::Object(timed) = &servo.watchdogs.set_points {
        watch("let the drive watch for set-points", timed)?;
    }
    if let SyncWatch::Object(timed) = &servo.watchdogs.sync {
        watch("let the drive watch for SYNC", timed)?;
    }
    Ok(())
}

/// Milliseconds (14xxh:5) in which at least [`WATCHED_CYCLES`] cycles of `period_us` fit.
fn rpdo_deadline_ms(period_us: u32) -> u32 {
    period_us.saturating_mul(WATCHED_CYCLES).div_ceil(1000)
}

/// The PDOs of the profile, received and sent, each a unit.
fn pdos(
    profile: &DeviceProfile,
    [rpdo, tpdo]: &[Vec<MappedPdo>; 2],
    node: NodeId,
    rpdo_deadline_ms: u32,
) -> Result<Vec<Step>, BootFailure> {
    let mut steps = Vec::new();
    for (used, is_rpdo) in [(rpdo, true), (tpdo, false)] {
        for number in 1..=PDO_COUNT {
            let Some(pdo) = used.iter().find(|pdo| pdo.identifier == number) else { continue };
            let id = if is_rpdo { cob::rpdo(number, node) } else { cob::tpdo(number, node) };
            // An identifier of 0 would be a network command.
            let id = id.ok_or_else(|| lacking(profile, "an identifier"))?;
            let deadline_ms = if is_rpdo { rpdo_deadline_ms } else { 0 };
            steps.extend(remap(pdo, is_rpdo, id.into(), deadline_ms));
        }
    }
    Ok(steps)
}

/// The remap order of CiA 301: switch the PDO off, clear the mapping, write it, set the type, switch it on. The mapping is a unit
/// of its own: a mapping that is fixed and right stays while the parameters change. If the profile calls the mapping fixed, the
/// boot only compares it.
fn remap(pdo: &MappedPdo, is_rpdo: bool, id: u32, deadline_ms: u32) -> impl Iterator<Item = Step> {
    let access = |index: u16, sub: u8, bytes: u8, action: Action| Step {
        doing: "map the process data",
        index,
        sub,
        bytes,
        action,
    };
    let state = |value: u32| Action::State { value, kept: 0 };
    let offset = pdo.number.saturating_sub(1);
    let (comm, map, kept) = if is_rpdo { (0x1400, 0x1600, 0) } else { (0x1800, 0x1a00, NO_REMOTE) };
    let (comm, map) = (comm + offset, map + offset);
    let mut steps = vec![access(comm, 1, 4, Action::Off { value: id | cob::INVALID, kept })];
    let entries: Vec<u32> = pdo.objects.iter().map(MappedObject::to_u32).collect();
    steps.extend(script::mapping_steps(map, pdo.is_fixed, &entries));
    steps.push(access(comm, 2, 1, state(pdo.transmission_type.into())));
    if deadline_ms > 0 {
        steps.push(access(comm, 5, 2, state(deadline_ms)));
    }
    steps.push(access(comm, 1, 4, Action::State { value: id, kept }));
    unit(steps)
}

/// The objects of one PDO as the compiled layout wants them.
pub(super) fn layout_entries(pdo: &MappedPdo) -> Vec<(u16, u8, u8)> {
    pdo.objects.iter().map(|object| (object.index, object.sub, object.bits)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_drives::cia402::OperationMode;

    #[test]
    fn set_points_may_stay_away_for_five_cycles_whatever_the_cycle() {
        for (period_us, deadline_ms) in [(1000, 5), (2000, 10), (4000, 20), (500, 3), (900, 5), (1900, 10), (100, 1)] {
            assert_eq!(rpdo_deadline_ms(period_us), deadline_ms, "{period_us} us");
        }
    }

    #[test]
    fn remapping_switches_the_pdo_off_first_and_on_last() {
        let node = cob::node_id(1).unwrap();
        let profile = yieldwall_config::shipped_profile("simulated-servo");
        let mapped = profile.mapped(Some(OperationMode::CyclicTorque)).unwrap();
        let steps = pdos(&profile, &mapped, node, 5).unwrap();
        let off = |value| Action::Off { value, kept: 0 };
        let state = |value| Action::State { value, kept: 0 };
        let rpdo: Vec<_> = steps[..9].iter().map(|step| (step.index, step.sub, step.action)).collect();
        let expected = [
            (0x1400, 1, Action::Unit { steps: 9 }),
            (0x1400, 1, off(0x8000_0201)),
            (0x1600, 0, Action::Unit { steps: 4 }),
            (0x1600, 0, off(0)),
            (0x1600, 1, state(0x6040_0010)),
            (0x1600, 2, state(0x6071_0010)),
            (0x1600, 0, state(2)),
            (0x1400, 2, state(1)),
            (0x1400, 5, state(5)),
        ];
        assert_eq!(rpdo, expected);
        assert_eq!((steps[9].index, steps[9].action), (0x1400, state(0x201)));
        assert_eq!(steps.last().unwrap().action, Action::State { value: 0x181, kept: 0x4000_0000 });
    }

    /// A drive that is an axis of the shipped device of three.
    fn axis_setup(axis: u8, rank: u8) -> DriveSetup {
        let profile = yieldwall_config::load_profile(yieldwall_config::builtin("vendors/profiles/three-axes.yaml"));
        let profile = std::sync::Arc::new(profile.unwrap().value);
        let ms = Duration::from_millis;
        DriveSetup {
            name: format!("axis {axis}"),
            bus: yieldwall_fieldbus::canopen::BusId::FIRST,
            node_id: 5,
            profile: profile.of_axis(axis, rank, yieldwall_drives::profiles::Fieldbus::Canopen),
            heartbeat: ms(20),
            waits: crate::setup::Waits { boot_up: ms(1), sdo: ms(1), start: ms(1) },
            torque_limit_per_mille: 500,
            speed_limit_counts_per_s: 1000,
            following_error_counts: 100,
            homing: None,
        }
    }

    #[test]
    fn axes_of_a_node_are_one_boot_with_objects_and_identifiers_of_their_own() {
        use crate::setup::{SensorLink, SensorSetup};
        use yieldwall_drives::cia402::CommandMode;
        use yieldwall_fieldbus::canopen::BusId;
        let drives = [axis_setup(0, 0), axis_setup(2, 1)];
        let link = yieldwall_fieldbus::plain_can::Link {
            protocol: yieldwall_fieldbus::plain_can::Protocol::Streaming(
                yieldwall_fieldbus::plain_can::streaming::Ids { command: 0x10, data: [0x11, 0x12] },
            ),
            pair_gap: Duration::ZERO,
            sample_period: Duration::from_millis(1),
            zero_at_start: false,
        };
        let (waits, sample_period) = (drives[0].waits, Duration::from_millis(1));
        let (name, bus) = ("sensor".to_owned(), BusId::FIRST);
        let master = MasterSetup {
            node_id: 127,
            heartbeat: Duration::from_millis(20),
            period: Duration::from_millis(1),
            mode: CommandMode::Torque,
            drives: drives.to_vec(),
            sensor: SensorSetup { name, bus, link: SensorLink::PlainCan(link), waits, sample_period },
        };
        let node = cob::node_id(5).unwrap();
        let boot = Boot::drives(&master, &[&drives[0], &drives[1]], node).unwrap();
        let steps = boot.steps().0;
        let of = |index: u16, sub: u8| steps.iter().filter(move |step| (step.index, step.sub) == (index, sub));
        // Objects that the device has once.
        for index in [0x1000, 0x1005, 0x1012, 0x1017] {
            assert_eq!(of(index, 0).count(), 1, "{index:04X}h");
        }
        assert_eq!([of(0x1016, 1).count(), of(0x1018, 1).count(), of(0x1029, 1).count()], [1; 3]);
        // Objects of each axis; of the axis between them only its process data are switched off.
        for index in [0x6007, 0x605a, 0x6060, 0x6061, 0x6065, 0x6072, 0x6502] {
            let counts = [0, 0x800, 0x1000].map(|offset| of(index + offset, 0).count());
            assert_eq!(counts, [1, 0, 1], "{index:04X}h");
        }
        assert_eq!([0x2200, 0x2300, 0x2400].map(|index| of(index, 0).count()), [1, 0, 1]);
        // PDO 129 has the identifier of PDO 2, which has to be off.
        let last = |index: u16| of(index, 1).next_back().unwrap().action;
        let state = |value, kept| Action::State { value, kept };
        assert_eq!([last(0x1400), last(0x1480)], [state(0x205, 0), state(0x305, 0)]);
        assert_eq!([last(0x1800), last(0x1880)], [state(0x185, NO_REMOTE), state(0x285, NO_REMOTE)]);
        let off = Action::Bits { mask: 0x8000_0000, value: 0x8000_0000 };
        assert_eq!([last(0x1401), last(0x1801)], [off; 2]);
        let mapped = |index: u16, sub: u8| of(index, sub).next_back().unwrap().action;
        assert_eq!([mapped(0x1680, 1), mapped(0x1680, 2)], [state(0x7040_0010, 0), state(0x7071_0010, 0)]);
        assert_eq!([mapped(0x1a80, 1), mapped(0x1a80, 2)], [state(0x7041_0010, 0), state(0x7064_0020, 0)]);
        assert_eq!([0x1440, 0x1840].map(|index| of(index, 1).count()), [1; 2]);
        assert_eq!([last(0x1440), last(0x1840)], [off; 2]);
    }

    #[test]
    fn a_device_of_one_axis_frees_no_identifiers() {
        let profile = yieldwall_config::shipped_profile("simulated-servo");
        let drive = DriveSetup { profile, ..axis_setup(0, 0) };
        for pdos in script::pdos(&drive.profile, Some(OperationMode::CyclicTorque)).unwrap() {
            assert!(pdos.iter().all(|pdo| u16::from(pdo.identifier) == pdo.number), "{pdos:?}");
        }
    }
}
