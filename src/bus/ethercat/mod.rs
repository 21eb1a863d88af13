//! The EtherCAT segment of a rig as one network: bring-up, then raw words that come and go twice a cycle.
//!
//! ```text
//! Off -> Configuring (device by device, one frame after the other) -> Starting (cycles of its own, clocks settle, OP) -> Operational
//!              |                                                          |
//!              +------------------------> Failed <------------------------+      nothing is enabled
//! ```
//! Sans-I/O: bytes and moments come in, bytes go into the outbox. `flight` has the frames that are on their way, `bring_up` what comes before
//! the exchange, `exchange` the two moments of a cycle and what is asked beside it, `mailbox` the objects of one device.

mod bring_up;
mod clock;
mod exchange;
mod failure;
mod flight;
mod mailbox;
mod setup;
mod station;
#[cfg(all(test, feature = "sim"))]
mod tests;
mod topology;
mod writes;

use std::time::Duration;

use super::error::{BootError, BootFailure};
use super::phase::{LinkEvent, Phase};
use crate::canopen::BusId;
use crate::cycle::LinkEvents;
use crate::ethercat::coe::CoeEmergency;
use crate::ethercat::frame::{self, Command, Datagrams};
use crate::ethercat::{AlState, AlStatus, AlStatusCode};
use crate::guard::{Device, DeviceSet};
use crate::objects::{ObjectAnswer, ObjectError, ObjectRequest};
use crate::time::Time;
use bring_up::BringUp;
use clock::GridServo;
use exchange::Grid;
use flight::{Flight, Purpose, Taken};
use station::Station;

pub use failure::{SegmentFailure, SegmentSign};
pub use flight::SegmentCounts;
pub use setup::{Acts, Mapped, ProcessData, SOURCE, SegmentDrive, SegmentSetup, StationSetup, StatusMasks};

/// Emergencies that are remembered.
const EMERGENCIES: usize = 8;
/// Time that the outputs of a cycle need from the computation to SYNC0: computing, the frame, the device.
const OUTPUTS_NEED: Duration = Duration::from_micros(50);

/// Where frames go that are to be sent.
pub trait EthernetOutbox {
    /// Takes a frame, from the destination on and without check sequence.
    fn push(&mut self, bytes: &[u8]);
}

impl EthernetOutbox for Vec<Vec<u8>> {
    fn push(&mut self, bytes: &[u8]) {
        Vec::push(self, bytes.to_vec());
    }
}

/// Frames that are to be sent, in room of a fixed size: those of a cycle, one beside them and one more.
#[derive(Clone, Debug)]
pub(super) struct Outgoing {
    frames: Box<[[u8; frame::LONGEST]; Self::MOST]>,
    lengths: [usize; Self::MOST],
    count: usize,
}

impl Outgoing {
    const MOST: usize = 4;

    /// Gives the frames away.
    pub(super) fn drain(&mut self, mut send: impl FnMut(&[u8])) {
        let count = std::mem::take(&mut self.count);
        let frames = self.frames.iter().zip(self.lengths).take(count);
        frames.filter_map(|(bytes, len)| bytes.get(..len)).for_each(&mut send);
    }
}

impl Default for Outgoing {
    fn default() -> Self {
        Outgoing { frames: Box::new([[0; frame::LONGEST]; Self::MOST]), lengths: [0; Self::MOST], count: 0 }
    }
}

impl EthernetOutbox for Outgoing {
    /// Takes a frame if there is room; one for which there is none is lost, as on the wire.
    fn push(&mut self, bytes: &[u8]) {
        let place = self.count;
        let to = self.frames.get_mut(place).and_then(|to| to.get_mut(..bytes.len()));
        if let (Some(to), Some(len)) = (to, self.lengths.get_mut(place)) {
            to.copy_from_slice(bytes);
            *len = bytes.len();
            self.count += 1;
        }
    }
}

/// What a device has told by an emergency message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SegmentTold {
    /// When the message came.
    pub time: Time,
    /// The device.
    pub device: Device,
    /// The message.
    pub emergency: CoeEmergency,
}

/// One datagram that is asked beside the cycle. Its data stand at the begin of a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Ask {
    command: Command,
    address: u32,
    len: usize,
}

impl Ask {
    fn new(command: Command, address: u32, len: usize) -> Self {
        Ask { command, address, len }
    }
}

/// Register of a station as an address.
fn service_address(station: u16, register: u16) -> u32 {
    frame::address(station, register)
}

/// Who waits for the frame that was asked beside the cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Asked {
    BringUp,
    Mailbox(usize),
    Difference(usize),
    Operational(usize),
}

/// One segment with the devices of a rig.
#[derive(Clone)]
pub struct EthercatNetwork {
    bus: BusId,
    period: Duration,
    compute_at: Duration,
    phase: Phase,
    phase_since: Time,
    stations: Vec<Station>,
    /// Station address of the reference clock, if a device has one.
    reference: Option<u16>,
    flight: Flight,
    /// Who waits for the service frame, and since when.
    asked: Option<(Asked, Time)>,
    bring_up: BringUp,
    servo: GridServo,
    /// The cycles that it runs until somebody else does.
    grid: Grid,
    events: LinkEvents,
    /// Devices whose clock is not where that of the reference is, or all if the grid has lost that.
    clock_lost: DeviceSet,
    /// Whether a register was ever written.
    has_written: bool,
    is_silent: bool,
    /// What the devices told last, a ring, and where the next one goes.
    told: [Option<SegmentTold>; EMERGENCIES],
    next_told: usize,
    /// Station whose turn it is to be asked beside the cycle.
    turn: usize,
    scratch: Box<[u8; frame::LONGEST]>,
}

impl EthercatNetwork {
    /// A network to which nothing was sent yet.
    ///
    /// # Errors
    /// If two devices have one position, process data are no whole bytes, a frame of the cycle would be too long, or the outputs would come
    /// too late for SYNC0.
    pub fn new(setup: &SegmentSetup) -> Result<Self, BootError> {
        const PLAN: &str = "plan the process data";
        let mut stations: Vec<Station> = Vec::new();
        for device in &setup.stations {
            let refused = |failure| refuse(&format!("{} (position {})", device.name, device.position), PLAN, failure);
            if stations.iter().any(|other| other.setup.position == device.position) {
                return Err(refused(SegmentFailure::Position { position: device.position }));
            }
            stations.push(Station::new(device).map_err(refused)?);
        }
        let whole = |failure| refuse("master", PLAN, failure);
        let inputs = stations.iter().flat_map(|station| [station.inputs.len, exchange::STATUS_LEN]);
        for (what, len) in [
            ("input", flight::frame_len(inputs.chain([8]))),
            ("output", flight::frame_len(stations.iter().map(|station| station.outputs.len))),
        ] {
            if len > frame::LONGEST {
                return Err(whole(SegmentFailure::FrameTooLong { what, len }));
            }
        }
        let us = |duration: Duration| duration.as_micros() as i64;
        let left_us = us(setup.period) - us(setup.sync0_phase) - us(setup.compute_at);
        if stations.iter().any(Station::is_synchronous) && left_us < us(OUTPUTS_NEED) {
            return Err(whole(SegmentFailure::NoTime { left_us, needed_us: us(OUTPUTS_NEED) }));
        }
        Ok(EthercatNetwork {
            bus: setup.bus,
            period: setup.period,
            compute_at: setup.compute_at,
            phase: Phase::Off,
            phase_since: Time(0),
            stations,
            reference: None,
            flight: Flight::new(setup.source),
            asked: None,
            bring_up: BringUp::new(),
            servo: GridServo::new(setup.period, setup.sync0_phase),
            grid: Grid::new(),
            events: LinkEvents::default(),
            clock_lost: DeviceSet::NONE,
            has_written: false,
            is_silent: false,
            told: [None; EMERGENCIES],
            next_told: 0,
            turn: 0,
            scratch: Box::new([0; frame::LONGEST]),
        })
    }

    /// The bus of the rig that it is.
    pub fn bus(&self) -> BusId {
        self.bus
    }

    /// Where the network stands.
    pub fn phase(&self) -> &Phase {
        &self.phase
    }

    /// What has become of the frames.
    pub fn counts(&self) -> SegmentCounts {
        self.flight.counts
    }

    /// Whether nothing is sent any more, so that the devices' watchdogs act.
    pub fn is_silent(&self) -> bool {
        self.is_silent
    }

    /// Falls silent, or goes on when a person has the exchange go on.
    pub fn set_silent(&mut self, is_silent: bool) {
        self.is_silent = is_silent;
    }

    /// Takes the clocks as they are: the grid is not moved, and the phase that is seen first is the wanted one.
    pub fn set_lockstep(&mut self) {
        self.servo = self.servo.in_lockstep();
    }

    /// State and AL status code of a device as it told them last; `None` for one that is not on the segment.
    pub fn al_status(&self, device: Device) -> Option<(AlStatus, AlStatusCode)> {
        self.station(device).map(|station| (station.status, station.code))
    }

    /// How often inputs of a device did not come and it did not take its outputs, since the network was started; `None` for one that is not on
    /// the segment.
    pub fn missed(&self, device: Device) -> Option<(u64, u64)> {
        self.station(device).map(|station| (station.inputs_missed, station.outputs_missed))
    }

    /// What the devices told last, at most eight, the oldest first.
    pub fn told(&self) -> impl Iterator<Item = SegmentTold> {
        let (newer, older) = self.told.split_at(self.next_told);
        older.iter().chain(newer).copied().flatten()
    }

    fn station(&self, device: Device) -> Option<&Station> {
        self.stations.iter().find(|station| station.setup.device == device)
    }

    /// Begins to read or to write an object of a device, beside the cycle too.
    ///
    /// # Errors
    /// If the network is not up, the device has no objects or has not answered the last request.
    pub fn ask(&mut self, now: Time, device: Device, request: ObjectRequest<'_>) -> Result<(), ObjectError> {
        match self.phase {
            Phase::Starting | Phase::Operational => {}
            Phase::Configuring => return Err(ObjectError::Busy),
            Phase::Off | Phase::Resetting | Phase::Failed(_) => return Err(ObjectError::NotBooted),
        }
        let station = self.stations.iter_mut().find(|station| station.setup.device == device);
        station.ok_or(ObjectError::NoObjects)?.mailbox.ask(now, request)
    }

    /// How what was asked of a device last has ended.
    ///
    /// Real-time: yes.
    pub fn answer(&self, device: Device) -> ObjectAnswer<'_> {
        match self.station(device) {
            Some(station) => station.mailbox.answer(),
            None => ObjectAnswer::Failed(ObjectError::NoObjects),
        }
    }

    /// Begins to bring the segment up: first it is only looked at, and left alone if somebody else has put a device into SAFE-OP or OP.
    /// Nothing is remembered of what was before but the emergencies, and nothing is enabled.
    pub fn start(&mut self, now: Time, out: &mut impl EthernetOutbox) {
        if let Phase::Failed(BootError { failure: BootFailure::Segment(failure), .. }) = &self.phase
            && matches!(**failure, SegmentFailure::OtherMaster { .. })
        {
            return;
        }
        for purpose in [Purpose::Inputs, Purpose::Outputs, Purpose::Service] {
            self.flight.give_up(purpose);
        }
        self.stations.iter_mut().for_each(Station::restart);
        (self.asked, self.reference) = (None, None);
        self.bring_up = BringUp::new();
        self.servo = self.servo.anew();
        self.grid = Grid::new();
        self.events = LinkEvents::default();
        (self.clock_lost, self.is_silent) = (DeviceSet::NONE, false);
        self.enter(now, Phase::Configuring);
        self.poll(now, out);
    }

    fn enter(&mut self, now: Time, phase: Phase) {
        tracing::debug!(?phase, "segment");
        (self.phase, self.phase_since) = (phase, now);
    }

    fn fail(&mut self, now: Time, name: &str, step: &'static str, failure: impl Into<BootFailure>) {
        let error = BootError { node_id: None, name: name.to_owned(), step, failure: failure.into() };
        self.flight.give_up(Purpose::Service);
        self.asked = None;
        self.enter(now, Phase::Failed(error));
    }

    /// When [`EthercatNetwork::poll`] has to be called again at the latest.
    ///
    /// Real-time: yes.
    pub fn next_deadline(&self) -> Time {
        let service = self.asked.map_or(Time::NEVER, |(_, sent)| sent + flight::FRAME_WAIT);
        match self.phase {
            Phase::Configuring if self.asked.is_none() => self.bring_up.wait_until,
            Phase::Configuring => service,
            Phase::Starting | Phase::Operational => service.min(self.grid.next_deadline()),
            Phase::Off | Phase::Resetting | Phase::Failed(_) => Time::NEVER,
        }
    }

    /// Does what time asks for: frames that did not come back, the next step of the bring-up, cycles until somebody else runs them.
    pub fn poll(&mut self, now: Time, out: &mut impl EthernetOutbox) {
        if self.asked.is_some_and(|(_, sent)| now >= sent + flight::FRAME_WAIT) {
            self.flight.give_up(Purpose::Service);
            self.on_service_loss(now);
        }
        match self.phase {
            Phase::Configuring => self.poll_bring_up(now, out),
            Phase::Starting | Phase::Operational => self.poll_grid(now, out),
            Phase::Off | Phase::Resetting | Phase::Failed(_) => {}
        }
    }

    /// The frame that was asked beside the cycle did not come back.
    fn on_service_loss(&mut self, now: Time) {
        match self.asked.take().map(|(asked, _)| asked) {
            Some(Asked::BringUp) => self.on_bring_up_loss(now),
            Some(Asked::Mailbox(place)) => {
                if let Some(station) = self.stations.get_mut(place) {
                    station.mailbox.on_loss();
                }
            }
            Some(Asked::Difference(_) | Asked::Operational(_)) | None => {}
        }
    }

    /// Takes a frame that has come over the wire.
    ///
    /// Real-time: yes, while operational.
    pub fn on_frame(&mut self, now: Time, bytes: &[u8], out: &mut impl EthernetOutbox) {
        match self.flight.take(bytes) {
            Taken::Reply(Purpose::Inputs) => self.on_inputs(now, bytes),
            Taken::Reply(Purpose::Outputs) => self.on_outputs(bytes),
            Taken::Reply(Purpose::Service) => self.on_service(now, bytes, out),
            Taken::Late => self.events.late |= self.all(),
            Taken::Foreign(source) => self.on_foreign(now, source),
            Taken::Nothing => {}
        }
    }

    fn on_foreign(&mut self, now: Time, source: [u8; 6]) {
        match self.phase {
            Phase::Operational => self.events.intruder = true,
            Phase::Failed(_) => {}
            Phase::Off | Phase::Resetting | Phase::Configuring | Phase::Starting => {
                let (sign, has_written) = (SegmentSign::Frame(source), self.has_written);
                let step = if matches!(self.phase, Phase::Off) { "listen" } else { "bring up the segment" };
                self.is_silent = true;
                self.fail(now, "master", step, SegmentFailure::OtherMaster { sign, has_written });
            }
        }
    }

    fn on_service(&mut self, now: Time, bytes: &[u8], out: &mut impl EthernetOutbox) {
        let Some((asked, _)) = self.asked.take() else { return };
        let Some(reply) = Datagrams::of(bytes).ok().and_then(|mut datagrams| datagrams.next()?.ok()) else { return };
        let (data, counter) = (reply.data, reply.working_counter);
        match asked {
            Asked::BringUp => {
                self.on_bring_up(now, data, counter);
                self.poll_bring_up(now, out);
            }
            Asked::Mailbox(place) => {
                let station = self.stations.get_mut(place);
                if let Some(emergency) = station.and_then(|station| station.mailbox.on_reply(now, data, counter)) {
                    self.hear(now, place, emergency);
                }
            }
            Asked::Difference(place) if counter > 0 => self.on_difference(place, data),
            Asked::Operational(place) if counter > 0 => self.grid.note_asked(place),
            Asked::Difference(_) | Asked::Operational(_) => {}
        }
    }

    /// Notes what the interface to the segment tells; the next cycle acts on it.
    ///
    /// Real-time: yes.
    pub fn on_link(&mut self, event: LinkEvent) {
        match event {
            LinkEvent::SendFailed => self.events.send_failed |= DeviceSet::interface(self.bus.index()),
            // Of controllers of CAN.
            LinkEvent::ErrorPassive | LinkEvent::BusOff => {}
        }
    }

    /// Notes an emergency of a device.
    fn hear(&mut self, now: Time, place: usize, emergency: CoeEmergency) {
        let Some(station) = self.stations.get(place) else { return };
        let device = station.setup.device;
        let code = crate::canopen::EmcyCode(emergency.code);
        if !code.is_reset() {
            if code.is_warning() {
                self.events.emergency_warning |= device.set();
            } else {
                self.events.emergency |= device.set();
            }
        }
        if let Some(place) = self.told.get_mut(self.next_told) {
            *place = Some(SegmentTold { time: now, device, emergency });
        }
        self.next_told = (self.next_told + 1) % EMERGENCIES;
    }

    /// All devices of the rig on the segment.
    fn all(&self) -> DeviceSet {
        self.stations.iter().fold(DeviceSet::NONE, |all, station| all | station.setup.device.set())
    }

    /// Leaves the network: devices go to PRE-OP, where nobody waits for outputs. For a rig that was stopped.
    pub fn leave(&mut self, out: &mut impl EthernetOutbox) {
        let is_up = matches!(self.phase, Phase::Starting | Phase::Operational);
        self.phase = Phase::Off;
        if !is_up {
            return;
        }
        self.asked = None;
        let stations = &self.stations;
        let sent = self.flight.send(Purpose::Service, |to| {
            for station in stations {
                let request = (AlState::PreOperational as u16).to_le_bytes();
                let address = service_address(station.address, crate::ethercat::registers::AL_CONTROL);
                to.push(Command::Fpwr, address, &request);
            }
        });
        sent.into_iter().for_each(|bytes| out.push(bytes));
    }
}

fn refuse(name: &str, step: &'static str, failure: SegmentFailure) -> BootError {
    BootError { node_id: None, name: name.to_owned(), step, failure: failure.into() }
}
