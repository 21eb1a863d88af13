//! The process image: which bits of which frame are which word.

mod plan;

use super::node::Node;
use crate::axis::{DriveOrders, DriveWords};
use crate::error::BootFailure;
use crate::sample::{NO_SAMPLE, SampleCodec};
use crate::setup::{BrakeWords, DriveSetup, SensorNode};
use yieldwall_drives::cia402::CommandMode;
use yieldwall_drives::profiles::Quantity;
use yieldwall_fieldbus::canopen::pdo::Field;
use yieldwall_fieldbus::canopen::{BusId, Frame, NodeId, Outbox, cob};
use yieldwall_fieldbus::plain_can::{Client, SensorEvent};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::guard::DeviceSet;
use yieldwall_motion::sensing::RawSample;

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
    Status,
    Position,
    /// A quantity of the sensor's sample.
    Sample(Quantity),
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
        let field = self.fields.iter().find(|(source, _)| matches!(source, Source::Sample(Quantity::SampleCounter)));
        field.map(|(_, field)| field.get_unsigned(word) as u8)
    }

    /// Whether `word` is of a later sample than the one that is there.
    fn is_newer(&self, word: u64) -> bool {
        let counters = self.counter(self.word).zip(self.counter(word));
        counters.is_some_and(|(known, new)| (1..=127).contains(&new.wrapping_sub(known)))
    }
}

/// Meaning of a frame to the process image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Taken {
    /// One of its process data.
    Image,
    /// A frame that only the master sends.
    Own,
    /// A set-point for a drive, which only the master sends.
    SetPoint,
    /// None of its business.
    Other,
}

/// Devices whose frames were irregular.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Irregular {
    pub(super) bad_length: DeviceSet,
    pub(super) duplicated: DeviceSet,
    pub(super) late: DeviceSet,
}

/// The frame that a drive is sent.
#[derive(Clone, Copy, Debug)]
struct Outgoing {
    bus: BusId,
    id: u16,
    len: u8,
    /// Values of objects that are nothing to the rig.
    word: u64,
    controlword: Field,
    target: Field,
    /// Digital outputs, of a drive whose brake the master holds.
    brake: Option<(Field, BrakeWords)>,
}

/// Frames that arrived since the last cycle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arrivals {
    pub(super) drives: [DriveWords; 2],
    pub(super) sample: Option<RawSample>,
    pub(super) irregular: Irregular,
}

/// The image of the drives and the sensor.
#[derive(Clone, Debug)]
pub(super) struct Image {
    slots: Box<[u8]>,
    incoming: Vec<Incoming>,
    outgoing: Vec<Outgoing>,
    /// Meaning of the bits of the sensor's frames.
    codec: SampleCodec,
    /// When the last frame of the sensor came.
    sampled_at: Time,
    /// The sensor's bus.
    sensor_bus: BusId,
    /// The sensor, if it speaks plain CAN.
    plain: Option<Client>,
    irregular: Irregular,
    /// Whether the process data of this cycle may arrive: from SYNC to the computation.
    is_open: bool,
}

/// Frames of the sensor.
pub(super) enum SensorFrames<'a> {
    /// TPDOs.
    Canopen(&'a SensorNode, NodeId),
    /// Frames of a sensor on plain CAN.
    PlainCan(Client),
}

impl Image {
    pub(super) fn new(
        mode: CommandMode,
        drives: &[(&DriveSetup, NodeId)],
        nodes: &[Node],
        sensor_bus: BusId,
        sensor: SensorFrames<'_>,
    ) -> Result<Self, BootFailure> {
        let last_bus = drives.iter().map(|(drive, _)| drive.bus).fold(sensor_bus, BusId::max);
        let mut image = Incomings::new(last_bus);
        let rpdos = drives.iter().map(|(drive, node)| (drive.bus, [1, 2, 3, 4].map(|number| cob::rpdo(number, *node))));
        let outgoing = drives.iter().enumerate().map(|(joint, drive)| {
            let node = nodes.iter().find(|node| node.is(drive.0.bus, drive.1));
            image.drive(mode, joint, *drive, node.map_or(&[], |node| node.boot.steps().0))
        });
        let outgoing = outgoing.collect::<Result<_, _>>()?;
        let (plain, codec) = match sensor {
            SensorFrames::Canopen(setup, node) => (None, image.sensor(sensor_bus, setup, node)?),
            SensorFrames::PlainCan(client) => (Some(client), SampleCodec::default()),
        };
        let Incomings { slots, incoming } = image;
        let mut image = Self {
            slots,
            incoming,
            outgoing,
            codec,
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
    pub(super) fn reserve(&mut self, bus: BusId, id: u16) {
        self.keep(bus, id, OWN_SLOT);
    }

    fn keep(&mut self, bus: BusId, id: u16, wanted: u8) {
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

    /// Returns the client of a sensor on plain CAN, to change it.
    pub(super) fn plain_mut(&mut self) -> Option<&mut Client> {
        self.plain.as_mut()
    }

    /// Forgets all that arrived.
    pub(super) fn restart(&mut self) {
        for incoming in &mut self.incoming {
            (incoming.word, incoming.has_arrived, incoming.is_owed) = (0, false, false);
        }
        (self.irregular, self.is_open) = (Irregular::default(), false);
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
    /// A frame that comes after the computation is too late for its cycle and is not used.
    ///
    /// If two frames come in one cycle, the first counts and the second is a duplicate. There are two exceptions: a frame of the
    /// cycle before is still missing, or the sample counter shows that the second is newer. Then the first was the late frame,
    /// and the second counts.
    ///
    /// A late frame that comes alone in the next cycle looks like that cycle's own frame. A sensor on plain CAN has its own
    /// clock: its frames may come at any time.
    ///
    /// Real-time: yes.
    pub(super) fn on_frame(&mut self, now: Time, frame: &Frame) -> Taken {
        let slot = self.slots.get(slot_index(frame.bus(), frame.id())).copied().unwrap_or(NO_SLOT);
        let Some(incoming) = self.incoming.get_mut(usize::from(slot)) else {
            return match (slot, &mut self.plain) {
                (OWN_SLOT, _) => Taken::Own,
                (SET_POINT_SLOT, _) => Taken::SetPoint,
                (PLAIN_SLOT, Some(client)) => {
                    let is_short = client.on_frame(now, frame) == SensorEvent::BadLength;
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

    /// Returns the data that have arrived by `now` in this cycle. The force sensor's frames count only together.
    ///
    /// Real-time: yes.
    pub(super) fn arrivals(&mut self, now: Time) -> Arrivals {
        self.is_open = false;
        let mut drives = [DriveWords::default(); 2];
        let mut sensor_is_whole = true;
        for incoming in &self.incoming {
            sensor_is_whole &= incoming.joint.is_some() || incoming.has_arrived;
            if !incoming.has_arrived {
                continue;
            }
            let Some(words) = incoming.joint.and_then(|joint| drives.get_mut(joint)) else { continue };
            for (source, field) in &incoming.fields {
                match source {
                    Source::Status => words.statusword = Some(field.get_unsigned(incoming.word) as u16),
                    Source::Position => words.position = Some(field.get_signed(incoming.word) as i32),
                    _ => {}
                }
            }
        }
        Arrivals {
            drives,
            sample: match &mut self.plain {
                Some(client) => client.take(now),
                None if sensor_is_whole => Some(self.read_sensor(now)),
                None => None,
            },
            irregular: std::mem::take(&mut self.irregular),
        }
    }

    fn read_sensor(&self, now: Time) -> RawSample {
        let age_ns = now.since(self.sampled_at).as_nanos().min(u128::from(u32::MAX)) as u32;
        let mut sample = RawSample { age_ns, ..NO_SAMPLE };
        for incoming in self.incoming.iter().filter(|incoming| incoming.joint.is_none()) {
            for (source, field) in &incoming.fields {
                if let Source::Sample(quantity) = *source {
                    self.codec.take(quantity, field.get_unsigned(incoming.word), field.bits(), &mut sample);
                }
            }
        }
        sample
    }

    /// Whether an own frame is a set-point.
    ///
    /// Real-time: yes.
    pub(super) fn is_set_point(&self, frame: &Frame) -> bool {
        let own = (frame.bus(), frame.id());
        self.outgoing.iter().any(|outgoing| (outgoing.bus, outgoing.id) == own)
    }

    /// Sends each drive its words.
    ///
    /// Real-time: yes.
    pub(super) fn send(&self, orders: &[DriveOrders; 2], out: &mut impl Outbox) {
        for (Outgoing { bus, id, len, word, controlword, target, brake }, orders) in self.outgoing.iter().zip(orders) {
            let mut word = *word;
            controlword.put_unsigned(&mut word, u64::from(orders.controlword));
            target.put_signed(&mut word, i64::from(orders.target));
            if let Some((outputs, words)) = brake {
                outputs.put_unsigned(&mut word, words.word(orders.releases).into());
            }
            out.push(Frame::from_bits(*id, word, *len).on_bus(*bus));
        }
    }
}

/// Place of an identifier of a bus among the slots.
fn slot_index(bus: BusId, id: u16) -> usize {
    bus.index() * IDENTIFIERS + usize::from(id)
}
