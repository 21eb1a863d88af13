//! The EtherCAT segment of a rig as one network: bring-up, then raw words that come and go twice a cycle.
//!
//! ```text
//! Off -> Configuring (device by device, one frame after the other) -> Starting (cycles of its own, clocks settle, OP) -> Operational
//!              |                                                          |
//!              +------------------------> Failed <------------------------+      nothing is enabled
//! ```
//! Sans-I/O: bytes and moments come in, bytes go into the outbox. `flight` has the frames that are on their way, `bring_up` what comes before
//! the exchange, `exchange` the two moments of a cycle and what is asked beside it.

mod bring_up;
mod budget;
mod clock;
mod exchange;
mod failure;
mod flight;
mod held;
mod limits;
mod network;
mod ports;
mod repeat;
mod setup;
mod station;
#[cfg(test)]
mod tests;
pub mod topology;
mod writes;

use std::time::Duration;

use super::LinkEvent;
use super::emergency::{EmergencyReport, LastTold};
use super::error::{BootError, BootFailure};
use super::phase::Phase;
use super::script::Written;
use bring_up::BringUp;
use clock::GridServo;
use exchange::Grid;
use flight::{Flight, Taken};
use ports::PortWatch;
use repeat::Repeat;
use station::Station;
use yieldwall_fieldbus::canopen::{BusId, EmcyCode, ErrorRegister};
use yieldwall_fieldbus::ethercat::coe::CoeEmergency;
use yieldwall_fieldbus::ethercat::frame::{self, Command, Datagrams};
use yieldwall_fieldbus::ethercat::{AlState, AlStatus, AlStatusCode};
use yieldwall_fieldbus::objects::{ObjectAnswer, ObjectError, ObjectRequest};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::cycle::LinkEvents;
use yieldwall_motion::guard::{Device, DeviceSet};

pub use budget::{Advice, Budget, FrameBudget, PlannedDatagram, PlannedFrame, advise};
pub use failure::{SegmentFailure, SegmentSign};
pub use flight::{Purpose, SegmentCounts};
pub use network::SEGMENT_LISTENING;
pub(crate) use network::Segment;
pub use setup::{Acts, Mapped, ProcessData, SegmentDrive, SegmentSensor, SegmentSetup, StationAxis, StationSetup};
#[cfg(test)]
pub(crate) use station::sample_of;

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

/// Register of a station as an address.
fn service_address(station: u16, register: u16) -> u32 {
    frame::address(station, register)
}

/// Requester of the service frame, which is sent in addition to the frames of the cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Asked {
    BringUp,
    Mailbox(usize),
    Difference(usize),
    Operational(usize),
    /// Registers of a device.
    Held,
    /// Watchdogs of all devices were written back, and devices were asked to leave OP.
    Defence,
    /// Devices from this position on.
    Ports(usize),
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
    /// Requester of the service frame that is under way, and the time when it was sent.
    asked: Option<(Asked, Time)>,
    bring_up: BringUp,
    servo: GridServo,
    /// The cycles that it runs until somebody else does.
    grid: Grid,
    /// Outputs that are sent once more before the devices act on them.
    repeat: Repeat,
    events: LinkEvents,
    /// Devices whose clock is not where that of the reference is, or all if the grid has lost that.
    clock_lost: DeviceSet,
    /// Whether a register was ever written.
    has_written: bool,
    /// Whether the devices are where this master has put them, and nobody else was heard since.
    is_ours: bool,
    is_silent: bool,
    /// How far the cycles were from the reference clock when they had lost it.
    grid_off_ns: Option<i64>,
    ports: PortWatch,
    /// Devices behind a port that has lost its link since the network was started.
    cut_off: DeviceSet,
    told: LastTold,
    /// Whose registers are read back next.
    held: held::Turn,
    /// Whether somebody else has written to the devices since the network was started, as far as it was seen.
    has_intruder: bool,
    /// Source address of the first foreign frame since then.
    foreign_source: Option<[u8; 6]>,
    /// Whether the devices are asked for SAFE-OP without an intruder.
    leaves_op: bool,
    /// Whether this master has asked the devices for SAFE-OP because of either.
    has_defended: bool,
    /// Whether the devices' watchdogs are to be written back, and whether they were in the cycle before.
    restores: bool,
    has_restored: bool,
    /// Whether the drives are being stopped.
    is_stopping: bool,
    /// Station whose turn it is to be asked beside the cycle.
    turn: usize,
    /// Station whose clock is compared next, and frames beside the cycle since one was.
    compared: usize,
    uncompared: u32,
    scratch: Box<[u8; frame::LONGEST]>,
}

impl EthercatNetwork {
    /// A network to which nothing was sent yet.
    ///
    /// # Errors
    /// If two devices have one position, process data are no whole bytes, or a frame of the cycle would be too long.
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
        for each in &Budget::new(setup).frames {
            let (what, len) = (each.frame.purpose.word(), each.frame.len());
            if len > frame::LONGEST {
                return Err(whole(SegmentFailure::FrameTooLong { what, len }));
            }
        }
        Ok(EthercatNetwork {
            bus: setup.bus,
            period: setup.period,
            compute_at: setup.compute_at,
            phase: Phase::Off,
            phase_since: Time(0),
            stations,
            reference: None,
            flight: Flight::new(frame::SOURCE),
            asked: None,
            bring_up: BringUp::new(),
            servo: GridServo::new(setup.period, setup.sync0_phase),
            grid: Grid::new(),
            repeat: Repeat::new(setup),
            events: LinkEvents::default(),
            clock_lost: DeviceSet::NONE,
            has_written: false,
            is_ours: false,
            is_silent: false,
            grid_off_ns: None,
            ports: PortWatch::default(),
            cut_off: DeviceSet::NONE,
            told: LastTold::default(),
            held: held::Turn::START,
            has_intruder: false,
            foreign_source: None,
            leaves_op: false,
            has_defended: false,
            restores: false,
            has_restored: false,
            is_stopping: false,
            turn: 0,
            compared: 0,
            uncompared: 0,
            scratch: Box::new([0; frame::LONGEST]),
        })
    }

    /// The bus of the rig that it is.
    pub fn bus(&self) -> BusId {
        self.bus
    }

    /// Returns the phase of the network.
    pub fn phase(&self) -> &Phase {
        &self.phase
    }

    /// Returns the frame counters.
    pub fn counts(&self) -> SegmentCounts {
        self.flight.counts
    }

    /// Whether nothing is sent any more, so that the devices' watchdogs act.
    pub fn is_silent(&self) -> bool {
        self.is_silent
    }

    /// Sets whether the drives are being stopped. If another master has written to the devices, this master then requests SAFE-OP: in that
    /// state a drive takes no outputs, whoever sends them.
    ///
    /// Real-time: yes.
    pub(crate) fn set_stopping(&mut self, is_stopping: bool) {
        self.is_stopping = is_stopping;
    }

    /// Asks the devices for SAFE-OP, until the network is started again.
    pub(crate) fn leave_op(&mut self) {
        self.leaves_op = true;
    }

    /// Stops sending, or resumes when a person resumes the exchange.
    pub fn set_silent(&mut self, is_silent: bool) {
        self.is_silent = is_silent;
    }

    /// Sets the source address of the frames. It has to differ from the address of any other master ([`frame::source`]). The default is
    /// [`frame::SOURCE`], for a segment that cannot have another master.
    pub fn set_source(&mut self, source: [u8; 6]) {
        self.flight.set_source(source);
    }

    /// Takes the clocks as they are: the grid is not moved, and the phase that is seen first is the wanted one.
    pub fn set_lockstep(&mut self) {
        self.servo = self.servo.in_lockstep();
    }

    /// Returns the state and the AL status code that a device reported last; `None` if the device is not on the segment.
    pub fn al_status(&self, device: Device) -> Option<(AlStatus, AlStatusCode)> {
        self.station(device).map(|station| (station.status, station.code))
    }

    /// Returns how often a device's inputs did not come, and how often it did not take its outputs. All cycles count, whoever runs them.
    /// `None` if the device is not on the segment.
    pub fn missed(&self, device: Device) -> Option<(u64, u64)> {
        self.station(device).map(|station| (station.inputs_missed, station.outputs_missed))
    }

    /// Returns the last emergency reports of the devices, at most eight, the oldest first.
    pub fn told(&self) -> impl Iterator<Item = EmergencyReport> {
        self.told.iter()
    }

    /// Forgets the emergency reports of the devices.
    pub(super) fn forget_told(&mut self) {
        self.told.forget();
    }

    /// Returns the objects that the boot writes, of each device.
    pub(crate) fn written(&self) -> impl Iterator<Item = Written> + '_ {
        let of = |station: &Station| {
            let StationSetup { position, name, .. } = &station.setup;
            Written::new(self.bus, *position, name, &station.setup.script())
        };
        self.stations.iter().map(of)
    }

    /// Returns the faults of the devices since the network was started, a line each, for reports: states, clocks, ports, frames.
    pub fn findings(&self) -> Vec<String> {
        let title = |position: u16| {
            let station = self.stations.iter().find(|station| station.setup.position == position);
            station.map_or_else(|| format!("the device at position {position}"), Station::title)
        };
        let left = self.stations.iter().filter_map(|station| {
            let (status, code) = station.left?;
            Some(format!("{} left OP: {status}, AL status code {code}", station.title()))
        });
        let grid = self.grid_off_ns.map(|ns| format!("the cycles were {:.1} us beside the reference clock", us(ns)));
        let clocks = self.stations.iter().filter(|station| self.clock_lost.contains(station.setup.devices));
        let clocks = clocks.filter_map(|station| {
            let ns = station.lost_ns?;
            Some(format!("the clock of {} was {:.1} us beside the reference clock", station.title(), us(ns)))
        });
        let links = self.ports.lost().map(|(position, port, behind)| {
            let cut: Vec<String> = (behind.from..behind.to).filter(|at| *at != position).map(title).collect();
            let cut = if cut.is_empty() { String::new() } else { format!("; behind it: {}", cut.join(", ")) };
            format!("the link at port {port} of {} was lost{cut}", title(position))
        });
        let errors = self.ports.errors().map(|(position, port, errors)| {
            format!("port {port} of {} counted {errors} damaged frames", title(position))
        });
        let missed = self.stations.iter().filter(|station| station.inputs_missed + station.outputs_missed > 0);
        let missed = missed.map(|station| {
            let (inputs, outputs) = (station.inputs_missed, station.outputs_missed);
            format!("{}: inputs missing in {inputs} cycles, outputs not taken in {outputs}", station.title())
        });
        let altered = self.stations.iter().filter_map(|station| Some(station.altered?.sentence(&station.title())));
        let foreign =
            self.foreign_source.map(|source| format!("another master writes: {}", SegmentSign::Frame(source)));
        foreign
            .into_iter()
            .chain(altered)
            .chain(left)
            .chain(grid)
            .chain(clocks)
            .chain(links)
            .chain(errors)
            .chain(missed)
            .collect()
    }

    /// Whether a device is on the segment.
    pub fn has(&self, device: Device) -> bool {
        self.station(device).is_some()
    }

    fn station(&self, device: Device) -> Option<&Station> {
        self.stations.iter().find(|station| station.setup.devices.contains(device.set()))
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
        let station = self.stations.iter_mut().find(|station| station.setup.devices.contains(device.set()));
        station.ok_or(ObjectError::NoObjects)?.ask_as(now, device, request)
    }

    /// How what was asked of a device last has ended.
    ///
    /// Real-time: yes.
    pub fn answer(&self, device: Device) -> ObjectAnswer<'_> {
        match self.station(device) {
            Some(station) => station.answer_to(device),
            None => ObjectAnswer::Failed(ObjectError::NoObjects),
        }
    }

    /// Begins to bring the segment up: first it is only looked at, and left alone if somebody else has put a device into SAFE-OP or OP. After a
    /// start of its own the devices may be in any state.
    /// Nothing is remembered of what was before but the emergencies, and nothing is enabled.
    pub fn start(&mut self, now: Time, out: &mut impl EthernetOutbox) {
        if let Phase::Failed(BootError { failure: BootFailure::Segment(failure), .. }) = &self.phase
            && matches!(**failure, SegmentFailure::OtherMaster { .. })
        {
            return;
        }
        for purpose in Purpose::ALL {
            self.flight.give_up(purpose);
        }
        self.repeat.forget();
        self.stations.iter_mut().for_each(Station::restart);
        (self.asked, self.reference) = (None, None);
        self.bring_up = BringUp::new();
        self.servo = self.servo.anew();
        self.grid = Grid::new();
        self.events = LinkEvents::default();
        (self.clock_lost, self.is_silent) = (DeviceSet::NONE, false);
        (self.grid_off_ns, self.ports, self.cut_off) = (None, PortWatch::default(), DeviceSet::NONE);
        (self.has_intruder, self.leaves_op, self.restores) = (false, false, false);
        self.foreign_source = None;
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
            Some(Asked::Difference(_) | Asked::Operational(_) | Asked::Ports(_) | Asked::Held | Asked::Defence)
            | None => {}
        }
    }

    /// Takes a frame that has come over the wire.
    ///
    /// Real-time: yes, while operational.
    pub fn on_frame(&mut self, now: Time, bytes: &[u8], out: &mut impl EthernetOutbox) {
        match self.flight.take(bytes) {
            Taken::Reply(Purpose::Inputs) => self.on_inputs(now, bytes),
            Taken::Reply(Purpose::Outputs) => self.on_outputs(bytes),
            // The first frame says whether the devices have taken their outputs.
            Taken::Reply(Purpose::Repeat) => {}
            Taken::Reply(Purpose::Service) => self.on_service(now, bytes, out),
            Taken::Late => self.events.late |= self.all(),
            Taken::Again => self.events.duplicated |= self.all(),
            Taken::Foreign(source) => self.on_foreign(now, source),
            Taken::Nothing => {}
        }
    }

    fn on_foreign(&mut self, now: Time, source: [u8; 6]) {
        self.is_ours = false;
        match self.phase {
            Phase::Operational => {
                self.events.intruder = true;
                (self.has_intruder, self.restores) = (true, true);
                self.foreign_source = self.foreign_source.or(Some(source));
            }
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
                let Some(station) = self.stations.get_mut(place) else { return };
                let emergency = station.mailbox.on_reply(now, data, counter);
                if let Some(altered) = station.take_limit() {
                    self.note_altered(place, altered);
                }
                if let Some(emergency) = emergency {
                    self.hear(now, place, emergency);
                }
            }
            Asked::Difference(place) if counter > 0 => self.on_difference(place, data),
            Asked::Operational(place) if counter > 0 => self.grid.note_asked(place),
            Asked::Ports(first) => self.on_ports(first, bytes),
            Asked::Held => self.on_held(bytes),
            Asked::Defence | Asked::Difference(_) | Asked::Operational(_) => {}
        }
    }

    /// Notes an event of the interface to the segment; the next cycle acts on it.
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
        // It does not say which axis it is of, and stands for the whole device under the first one.
        let devices = station.setup.devices;
        let Some(device) = Device::ALL.into_iter().find(|device| devices.contains(device.set())) else { return };
        let CoeEmergency { code, register, vendor } = emergency;
        let (code, register) = (EmcyCode(code), ErrorRegister(register));
        let told = EmergencyReport { time: now, device, code, register, vendor, is_withdrawn: false };
        if self.told.hear(told) {
            let events =
                if code.is_warning() { &mut self.events.emergency_warning } else { &mut self.events.emergency };
            *events |= devices;
        }
    }

    /// All devices of the rig on the segment.
    fn all(&self) -> DeviceSet {
        self.stations.iter().fold(DeviceSet::NONE, |all, station| all | station.setup.devices)
    }

    /// Leaves the network, for a rig that was stopped or did not come up. Devices that this master has taken beyond INIT go to PRE-OP,
    /// where no watchdog waits for outputs. If another master is on the segment, only the devices that are in SAFE-OP at this master's
    /// request go there.
    pub fn leave(&mut self, out: &mut impl EthernetOutbox) {
        let is_ours = std::mem::take(&mut self.is_ours);
        let is_left = |status: AlStatus| self.has_defended && status.state() == Some(AlState::SafeOperational);
        self.stations.iter_mut().for_each(|station| station.is_led &= is_ours || is_left(station.status));
        self.phase = Phase::Off;
        self.asked = None;
        self.flight.give_up(Purpose::Service);
        let stations = &self.stations;
        let sent = self.flight.send(Purpose::Service, |to| {
            for station in stations.iter().filter(|station| station.is_led) {
                let request = (AlState::PreOperational as u16).to_le_bytes();
                let address = service_address(station.address, yieldwall_fieldbus::ethercat::registers::AL_CONTROL);
                to.push(Command::Fpwr, address, &request);
            }
        });
        sent.into_iter().for_each(|bytes| out.push(bytes));
    }
}

/// Nanoseconds as microseconds, without a sign.
fn us(ns: i64) -> f64 {
    ns.unsigned_abs() as f64 * 1e-3
}

fn refuse(name: &str, step: &'static str, failure: SegmentFailure) -> BootError {
    BootError { node_id: None, name: name.to_owned(), step, failure: failure.into() }
}
