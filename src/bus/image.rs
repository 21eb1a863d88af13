//! The process image: which bits of which frame are which quantity.

mod plan;

use super::error::BootFailure;
use super::setup::{CommandMode, DriveSetup, SensorNode};
use crate::canopen::pdo::Field;
use crate::canopen::{Frame, NodeId, Outbox, Time, cob};
use crate::cycle::DriveSample;
use crate::guard::{Allowed, DeviceSet, JointCommand};
use crate::plain_can::{Client, Heard};
use crate::sensing::RawSample;
use yieldwall_drives::cia402::{Goal, State, StateWalk, Statusword};
use yieldwall_drives::profiles::StatusBits;
use yieldwall_drives::scaling::{AxisScaling, CountUnwrapper, wrap};

use plan::Incomings;

/// Identifiers of 11 bits.
const IDENTIFIERS: usize = 0x800;
/// No frame of the image.
const NO_SLOT: u8 = u8::MAX;
/// A frame that only the master sends.
const OWN_SLOT: u8 = u8::MAX - 1;
/// A frame of the sensor on plain CAN.
const PLAIN_SLOT: u8 = u8::MAX - 2;
/// A set-point, which only the master sends.
const SET_POINT_SLOT: u8 = u8::MAX - 3;

#[derive(Clone, Copy, Debug)]
enum Source {
    Status(usize),
    Position(usize),
    Count(usize),
    SensorStatus,
    SampleCounter,
}

#[derive(Clone, Debug)]
struct Incoming {
    len: u8,
    /// Joint, or `None` for the sensor.
    joint: Option<usize>,
    fields: Vec<(Source, Field)>,
    word: u64,
    has_arrived: bool,
    /// Whether it did not arrive in the cycle before, and not after it either: it may still come.
    is_owed: bool,
}

impl Incoming {
    fn device(&self) -> DeviceSet {
        self.joint.map_or(DeviceSet::SENSOR, DeviceSet::drive)
    }

    /// The sensor's sample counter in `word`, if this frame carries it.
    fn counter(&self, word: u64) -> Option<u8> {
        let field = self.fields.iter().find(|(source, _)| matches!(source, Source::SampleCounter));
        field.map(|(_, field)| field.get_unsigned(word) as u8)
    }

    /// Whether `word` is of a later sample than the one that is there.
    fn is_newer(&self, word: u64) -> bool {
        let counters = self.counter(self.word).zip(self.counter(word));
        counters.is_some_and(|(known, new)| (1..=127).contains(&new.wrapping_sub(known)))
    }
}

/// What a frame is to the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Taken {
    /// One of its process data.
    Image,
    /// One that only the master sends.
    Own,
    /// A set-point for a drive, which only the master sends.
    SetPoint,
    /// None of its business.
    Other,
}

/// What arrived that should not have, or not like this.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Irregular {
    pub(super) bad_length: DeviceSet,
    pub(super) duplicated: DeviceSet,
    pub(super) late: DeviceSet,
}

#[derive(Clone, Copy, Debug)]
struct Outgoing {
    bus: u8,
    id: u16,
    len: u8,
    controlword: Field,
    set_point: Field,
}

#[derive(Clone, Debug)]
struct Drive {
    scaling: AxisScaling,
    /// Counts at the angle near which the first position is unwrapped.
    expected_counts: i64,
    unwrapper: CountUnwrapper,
    walk: StateWalk,
    statusword: Statusword,
    outgoing: Outgoing,
}

/// What arrived since the last cycle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arrivals {
    pub(super) drives: [DriveSample; 2],
    pub(super) sample: Option<RawSample>,
    pub(super) irregular: Irregular,
}

/// The image of two drives and one sensor.
#[derive(Clone, Debug)]
pub(super) struct Image {
    slots: Box<[u8]>,
    incoming: Vec<Incoming>,
    drives: [Drive; 2],
    sample: RawSample,
    /// What the bits of the sensor's status mean.
    status_bits: StatusBits,
    /// When the last frame of `sample` came.
    sampled_at: Time,
    /// Number of the sensor's bus.
    sensor_bus: u8,
    /// The sensor, if it speaks plain CAN.
    plain: Option<Client>,
    irregular: Irregular,
    /// Whether the process data of this cycle may arrive: from SYNC to the computation.
    is_open: bool,
}

/// No sample yet.
const NO_SAMPLE: RawSample = RawSample { counts: [0; 6], sequence: None, overload: false, invalid: false, age_ns: 0 };

/// What is known of the sensor's frames.
pub(super) enum SensorFrames<'a> {
    /// TPDOs.
    Canopen(&'a SensorNode, NodeId),
    /// Those of a sensor on plain CAN.
    PlainCan(Client),
}

impl Image {
    pub(super) fn new(
        mode: CommandMode,
        drives: [(&DriveSetup, NodeId); 2],
        sensor_bus: u8,
        sensor: SensorFrames<'_>,
    ) -> Result<Self, BootFailure> {
        let [(left, _), (right, _)] = &drives;
        let mut image = Incomings::new(left.bus.max(right.bus).max(sensor_bus));
        let [left, right] = drives;
        let rpdos = [left, right].map(|(drive, node)| (drive.bus, [1, 2, 3, 4].map(|number| cob::rpdo(number, node))));
        let drives = [image.drive(mode, 0, left)?, image.drive(mode, 1, right)?];
        let (plain, status_bits) = match sensor {
            SensorFrames::Canopen(setup, node) => (None, image.sensor(sensor_bus, setup, node)?),
            SensorFrames::PlainCan(client) => (Some(client), StatusBits::default()),
        };
        let Incomings { slots, incoming } = image;
        let mut image = Self {
            slots,
            incoming,
            drives,
            sample: NO_SAMPLE,
            status_bits,
            sampled_at: Time::default(),
            sensor_bus,
            plain,
            irregular: Irregular::default(),
            is_open: false,
        };
        // A drive may take set-points by the RPDOs that the master leaves as it found them, too.
        for (bus, ids) in rpdos {
            ids.into_iter().flatten().for_each(|id| image.keep(bus, id, SET_POINT_SLOT));
        }
        Ok(image)
    }

    /// Frames with this identifier are the master's alone on this bus.
    pub(super) fn reserve(&mut self, bus: u8, id: u16) {
        self.keep(bus, id, OWN_SLOT);
    }

    fn keep(&mut self, bus: u8, id: u16, wanted: u8) {
        if let Some(slot) = self.slots.get_mut(slot_index(bus, id)) {
            *slot = wanted;
        }
    }

    /// Keeps the identifiers of a sensor on plain CAN for it; those of the master are reserved before.
    pub(super) fn claim_plain(&mut self) -> Result<(), BootFailure> {
        let Some(client) = self.plain else { return Ok(()) };
        let [first, second] = client.protocol().data_ids();
        let order = client.protocol().order_id();
        for (id, wanted) in [(first, PLAIN_SLOT), (second, PLAIN_SLOT), (order, OWN_SLOT)] {
            let is_sent = self.is_set_point(&Frame::new(id, &[]).on_bus(self.sensor_bus));
            match self.slots.get_mut(slot_index(self.sensor_bus, id)) {
                Some(slot) if *slot == NO_SLOT || (*slot == SET_POINT_SLOT && !is_sent) => *slot = wanted,
                _ => return Err(BootFailure::Identifier { id }),
            }
        }
        Ok(())
    }

    /// The sensor, if it speaks plain CAN.
    pub(super) fn plain(&self) -> Option<&Client> {
        self.plain.as_ref()
    }

    /// The same, to be told something.
    pub(super) fn plain_mut(&mut self) -> Option<&mut Client> {
        self.plain.as_mut()
    }

    /// Forgets all that arrived and where the drives were.
    pub(super) fn restart(&mut self) {
        for incoming in &mut self.incoming {
            (incoming.word, incoming.has_arrived, incoming.is_owed) = (0, false, false);
        }
        for drive in &mut self.drives {
            drive.unwrapper = CountUnwrapper::near(drive.expected_counts);
            (drive.walk, drive.statusword) = (StateWalk::new(), Statusword::default());
        }
        (self.sample, self.irregular, self.is_open) = (NO_SAMPLE, Irregular::default(), false);
        if let Some(client) = &mut self.plain {
            client.restart();
        }
    }

    /// Forgets what arrived; the process data of the next SYNC follow.
    ///
    /// Real-time: yes.
    pub(super) fn begin_cycle(&mut self) {
        for incoming in &mut self.incoming {
            incoming.is_owed = !incoming.has_arrived;
            incoming.has_arrived = false;
        }
        self.is_open = true;
    }

    /// The devices of which something that has to come by `now` in this cycle has not arrived.
    ///
    /// Real-time: yes.
    pub(super) fn missing(&self, now: Time) -> DeviceSet {
        let owes_sample = self.plain.as_ref().is_some_and(|client| client.is_owed(now));
        let late = self.incoming.iter().filter(|incoming| !incoming.has_arrived).map(Incoming::device);
        late.fold(DeviceSet::SENSOR.only_if(owes_sample), |missing, device| missing | device)
    }

    /// Takes a frame from another node, and says what it is.
    ///
    /// A frame that comes after the computation is too late for its cycle and not used. Of two in one cycle the first
    /// counts and the second is a duplicate, unless one is owed from the cycle before, or the sample counter says that the
    /// second is newer: then the first was the late one, and the second counts. A late frame that comes alone in the next
    /// cycle cannot be told from that cycle's own. A sensor on plain CAN has its own clock: its frames may come at any time.
    ///
    /// Real-time: yes.
    pub(super) fn on_frame(&mut self, now: Time, frame: &Frame) -> Taken {
        let slot = self.slots.get(slot_index(frame.bus(), frame.id())).copied().unwrap_or(NO_SLOT);
        let Some(incoming) = self.incoming.get_mut(usize::from(slot)) else {
            return match (slot, &mut self.plain) {
                (OWN_SLOT, _) => Taken::Own,
                (SET_POINT_SLOT, _) => Taken::SetPoint,
                (PLAIN_SLOT, Some(client)) => {
                    let is_short = client.on_frame(now, frame) == Heard::BadLength;
                    self.irregular.bad_length |= DeviceSet::SENSOR.only_if(is_short);
                    Taken::Image
                }
                _ => Taken::Other,
            };
        };
        let device = incoming.device();
        if frame.len() != incoming.len {
            self.irregular.bad_length |= device;
        } else if !self.is_open {
            self.irregular.late |= device;
            // What was owed has come.
            incoming.has_arrived = true;
        } else if incoming.has_arrived && !incoming.is_owed && !incoming.is_newer(frame.bits()) {
            self.irregular.duplicated |= device;
        } else {
            if incoming.has_arrived {
                incoming.is_owed = false;
                self.irregular.late |= device;
            }
            incoming.word = frame.bits();
            incoming.has_arrived = true;
            if device == DeviceSet::SENSOR {
                self.sampled_at = now;
            }
        }
        Taken::Image
    }

    /// What has arrived by `now` in this cycle, in SI. The force sensor's frames count only together.
    ///
    /// Real-time: yes.
    pub(super) fn arrivals(&mut self, now: Time) -> Arrivals {
        self.is_open = false;
        let mut position = [None; 2];
        let mut sensor_is_whole = true;
        for incoming in &self.incoming {
            sensor_is_whole &= incoming.joint.is_some() || incoming.has_arrived;
            if !incoming.has_arrived {
                continue;
            }
            for (source, field) in &incoming.fields {
                match *source {
                    Source::Status(joint) => {
                        if let Some(drive) = self.drives.get_mut(joint) {
                            drive.statusword = Statusword(field.get_unsigned(incoming.word) as u16);
                        }
                    }
                    Source::Position(joint) => {
                        if let (Some(drive), Some(position)) = (self.drives.get_mut(joint), position.get_mut(joint)) {
                            // From the expected angle each time: a corrupted report leaves no wrong turn behind.
                            drive.unwrapper = CountUnwrapper::near(drive.expected_counts);
                            let counts = drive.unwrapper.unwrap(field.get_signed(incoming.word) as i32);
                            *position = Some(drive.scaling.angle_rad(counts));
                        }
                    }
                    _ => {}
                }
            }
        }
        let [left, right] = &self.drives;
        let [left_angle, right_angle] = position;
        Arrivals {
            drives: [sample_of(left, left_angle), sample_of(right, right_angle)],
            sample: match &mut self.plain {
                Some(client) => client.take(now),
                None if sensor_is_whole => self.read_sensor(now),
                None => None,
            },
            irregular: std::mem::take(&mut self.irregular),
        }
    }

    fn read_sensor(&mut self, now: Time) -> Option<RawSample> {
        self.sample.age_ns = now.since(self.sampled_at).as_nanos().min(u128::from(u32::MAX)) as u32;
        for incoming in self.incoming.iter().filter(|incoming| incoming.joint.is_none()) {
            for (source, field) in &incoming.fields {
                match *source {
                    Source::Count(axis) => {
                        if let Some(count) = self.sample.counts.get_mut(axis) {
                            *count = field.get_signed(incoming.word) as i32;
                        }
                    }
                    Source::SensorStatus => {
                        let status = field.get_unsigned(incoming.word) as u8;
                        self.sample.overload = status & self.status_bits.overload != 0;
                        self.sample.invalid = status & self.status_bits.invalid != 0;
                    }
                    Source::SampleCounter => {
                        self.sample.sequence = Some(field.get_unsigned(incoming.word) as u8);
                    }
                    _ => {}
                }
            }
        }
        Some(self.sample)
    }

    /// Whether an own frame is a set-point.
    ///
    /// Real-time: yes.
    pub(super) fn is_set_point(&self, frame: &Frame) -> bool {
        let own = (frame.bus(), frame.id());
        self.drives.iter().any(|drive| (drive.outgoing.bus, drive.outgoing.id) == own)
    }

    /// Asks every drive in Fault for one reset.
    pub(super) fn request_fault_reset(&mut self) {
        for drive in &mut self.drives {
            drive.walk.request_fault_reset();
        }
    }

    /// Drops resets that could not be sent: what fails in the meantime was not seen by the person who asked.
    pub(super) fn cancel_fault_reset(&mut self) {
        for drive in &mut self.drives {
            drive.walk.cancel_fault_reset();
        }
    }

    /// Sends every drive one step towards `goal`, with its share of `command`.
    ///
    /// Real-time: yes.
    pub(super) fn send(&mut self, goal: Goal, command: &Allowed<JointCommand>, out: &mut impl Outbox) {
        let set_points = raw_set_points(command, &self.drives);
        for (drive, set_point) in self.drives.iter_mut().zip(set_points) {
            drive.walk.set_goal(goal);
            let controlword = drive.walk.step(drive.statusword).controlword;
            let Outgoing { bus, id, len, controlword: control, set_point: target } = drive.outgoing;
            let mut word = 0;
            control.put_unsigned(&mut word, u64::from(controlword));
            target.put_signed(&mut word, set_point);
            out.push(Frame::from_bits(id, word, len).on_bus(bus));
        }
    }
}

/// Place of an identifier of a bus among the slots.
fn slot_index(bus: u8, id: u16) -> usize {
    usize::from(bus) * IDENTIFIERS + usize::from(id)
}

fn sample_of(drive: &Drive, angle_rad: Option<f64>) -> DriveSample {
    DriveSample {
        angle_rad,
        state: drive.statusword.state().unwrap_or(State::NotReadyToSwitchOn),
        follows_command: drive.statusword.has(Statusword::FOLLOWS_COMMAND),
        has_voltage: drive.statusword.has(Statusword::VOLTAGE_ENABLED),
        has_warning: drive.statusword.has(Statusword::WARNING),
    }
}

/// Scales an allowed command. A value that cannot be scaled keeps the joint where it is.
fn raw_set_points(command: &Allowed<JointCommand>, drives: &[Drive; 2]) -> [i64; 2] {
    let [left, right] = drives;
    let each = |values: [f64; 2], scale: &dyn Fn(&Drive, f64) -> i64| [scale(left, values[0]), scale(right, values[1])];
    match command.get() {
        JointCommand::Position(angles) => each(angles.to_array(), &|drive, angle| {
            let here = drive.unwrapper.counts();
            i64::from(wrap(drive.scaling.counts(angle).unwrap_or(here)))
        }),
        JointCommand::Velocity(rates) => each(rates.to_array(), &|drive, rate| {
            drive.scaling.rate_counts_per_s(rate).map_or(0, |raw| i64::from(raw.value))
        }),
        JointCommand::Torque(torques) => each(torques.to_array(), &|drive, torque| {
            drive.scaling.torque_per_mille(torque).map_or(0, |raw| i64::from(raw.value))
        }),
    }
}
