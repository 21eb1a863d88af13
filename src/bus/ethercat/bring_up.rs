//! Bring-up of an unknown segment to SAFE-OP: one datagram after the other, each repeated if its frame is lost.
//!
//! ```text
//! look    BRD 0130h, then each device's state: nothing is written before it is certain that nobody else is the master
//! reset   INIT, no FMMU, no sync manager, no SYNC0; station addresses
//! know    SII of each device of the rig: mailboxes, identity; what its controller has, its ports
//! ask     mailboxes, PRE-OP; objects, mapping, sync types
//! clocks  receive times of one frame: delays and offsets
//! open    sync managers, FMMUs, watchdog, SYNC0; SAFE-OP, and there the mode in force
//! ```

use std::time::Duration;

use super::failure::{SegmentFailure, SegmentSign};
use super::flight::{FRAME_WAIT, Purpose};
use super::ports::PortWatch;
use super::station::{FIRST_STATION, Station};
use super::topology::{Ports, delays};
use super::writes::{self, Write};
use super::{Asked, EthercatNetwork, EthernetOutbox, service_address};
use crate::Waiting;
use crate::error::BootFailure;
use crate::phase::Phase;
use yieldwall_fieldbus::ethercat::frame::{Ask, Command, address};
use yieldwall_fieldbus::ethercat::registers::{self as register, feature, sii_control};
use yieldwall_fieldbus::ethercat::sii::{Sii, SiiError, words_needed};
use yieldwall_fieldbus::ethercat::{
    AlControl, AlState, AlStatus, AlStatusCode, Fmmu, SyncManager, array, u16_at, u32_at,
};
use yieldwall_fieldbus::objects::ObjectAnswer;
use yieldwall_fieldbus::time::Time;

/// Devices that a segment may have.
const MOST_DEVICES: u16 = 64;
/// How often a datagram is asked whose frame is lost, or that no device processes.
const TRIES: u8 = 10;
/// Time between two looks at what takes a while: a state, the memory chip.
const LOOK_AGAIN: Duration = Duration::from_micros(500);
const CHIP_AGAIN: Duration = Duration::from_micros(50);
/// Looks at the memory chip before it is given up.
const CHIP_LOOKS: usize = 2000;
/// Time in which a device that gets no outputs any more has left OP by its watchdog, as long as cycles of 20 ms need twice.
const LEFT_ALONE: Duration = Duration::from_millis(200);
/// Length of what is read of the memory chip's registers: control, address, data.
const CHIP_LEN: usize = 14;

/// Values written to all devices before they get addresses.
const RESETS: [(u16, &[u8]); 9] = [
    (register::AL_CONTROL, &[AlState::Init as u8 | AlControl::ACKNOWLEDGE as u8, 0]),
    (register::DC_ACTIVATION, &[0]),
    (register::FMMU, &[0; 8 * Fmmu::SIZE]),
    (register::SYNC_MANAGER, &[0; 8 * SyncManager::SIZE]),
    (register::DC_OFFSET, &[0; 8]),
    (register::DC_DELAY, &[0; 4]),
    (register::DC_SPEED_START, &[0, 0x10]),
    // The memory chip is the master's, by force if need be.
    (register::SII_CONFIGURATION, &[2]),
    (register::SII_CONFIGURATION, &[0]),
];

/// One task; most tasks concern one device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Task {
    Count,
    Look,
    Reset,
    Address,
    State(AlState),
    Sii,
    Identify,
    Describe,
    Mailboxes,
    Objects,
    /// Objects that a device may show in SAFE-OP alone.
    LateObjects,
    Latch,
    Times,
    Clocks,
    Exchange,
    Sync0,
    Reference,
}

impl Task {
    fn doing(self) -> &'static str {
        match self {
            Task::Count => "look for devices",
            Task::Look => "look for another master",
            Task::Reset => "bring all devices to INIT",
            Task::Address => "give the device its address",
            Task::State(AlState::Init) => "go to INIT",
            Task::State(AlState::PreOperational) => "go to PRE-OP",
            Task::State(_) => "go to SAFE-OP",
            Task::Sii => "read its SII",
            Task::Identify => "check its identity",
            Task::Describe => "look what its controller has",
            Task::Mailboxes => "set up its mailbox",
            Task::Objects | Task::LateObjects => "set its objects",
            Task::Latch | Task::Times => "measure the delay to it",
            Task::Clocks => "set its clock",
            Task::Exchange => "set up its process data",
            Task::Sync0 => "set up SYNC0",
            Task::Reference => "read the reference clock",
        }
    }

    /// Whether the place of the task is that of a device of the rig; otherwise it is a position on the segment.
    fn is_of_station(self) -> bool {
        matches!(
            self,
            Task::State(_)
                | Task::Sii
                | Task::Identify
                | Task::Mailboxes
                | Task::Objects
                | Task::LateObjects
                | Task::Exchange
                | Task::Sync0
        )
    }
}

/// State of a position, whether the rig has a device there or not.
#[derive(Clone, Copy, Debug, Default)]
struct Node {
    ports: Ports,
    fmmus: u8,
    sync_managers: u8,
    /// Its own time at which the measuring frame passed.
    local_ns: u64,
    delay_ns: Option<u32>,
}

/// How far the bring-up is.
#[derive(Clone, Debug)]
pub(super) struct BringUp {
    tasks: Vec<(Task, usize)>,
    at: usize,
    /// Within a task.
    progress: usize,
    since: Time,
    tries: u8,
    /// Nothing is sent before.
    pub(super) wait_until: Time,
    nodes: Vec<Node>,
    /// The SII that is being read.
    image: Vec<u8>,
    /// How often in a row the memory chip returned another word than the one requested.
    other_words: u8,
    writes: Vec<Write>,
    is_reading_back: bool,
    /// Moment of system time at which SYNC0 comes first.
    sync0_from_ns: u64,
    /// How often SYNC0 was set up too late.
    sync0_tries: u8,
    /// When the present datagram was sent.
    sent: Time,
    /// Whether an object was asked for whose answer has not been looked at.
    has_asked: bool,
}

type Step = Result<(), BootFailure>;

impl BringUp {
    pub(super) fn new() -> Self {
        BringUp {
            tasks: vec![(Task::Count, 0)],
            at: 0,
            progress: 0,
            since: Time(0),
            tries: 0,
            wait_until: Time(0),
            nodes: Vec::new(),
            image: Vec::new(),
            other_words: 0,
            writes: Vec::new(),
            is_reading_back: false,
            sync0_from_ns: 0,
            sync0_tries: 0,
            sent: Time(0),
            has_asked: false,
        }
    }

    fn task(&self) -> Option<(Task, usize)> {
        self.tasks.get(self.at).copied()
    }

    fn finish(&mut self, now: Time) {
        self.at += 1;
        (self.progress, self.tries, self.since, self.wait_until) = (0, 0, now, now);
        (self.is_reading_back, self.has_asked) = (false, false);
        self.writes.clear();
        self.image.clear();
        self.other_words = 0;
    }

    /// All that follows the count of devices.
    fn plan(&mut self, devices: usize, stations: usize) {
        self.tasks.truncate(1);
        let mut add = |task: Task, places: usize| self.tasks.extend((0..places).map(|place| (task, place)));
        add(Task::Look, devices);
        add(Task::Reset, 1);
        add(Task::Address, devices);
        add(Task::State(AlState::Init), stations);
        add(Task::Sii, stations);
        add(Task::Identify, stations);
        add(Task::Describe, devices);
        for place in 0..stations {
            let all = [Task::Mailboxes, Task::State(AlState::PreOperational), Task::Objects];
            self.tasks.extend(all.map(|task| (task, place)));
        }
        self.tasks.push((Task::Latch, 0));
        self.tasks.extend((0..devices).map(|place| (Task::Times, place)));
        self.tasks.extend((0..devices).map(|place| (Task::Clocks, place)));
        for place in 0..stations {
            let all = [Task::Exchange, Task::Sync0, Task::State(AlState::SafeOperational), Task::LateObjects];
            self.tasks.extend(all.map(|task| (task, place)));
        }
        self.tasks.push((Task::Reference, 0));
    }

    /// The write that is due, or its read back.
    fn write(&self, station: u16, buffer: &mut [u8]) -> Option<Ask> {
        let write = self.writes.get(self.progress)?;
        let to = buffer.get_mut(..write.bytes.len())?;
        let at = service_address(station, write.register);
        if self.is_reading_back {
            to.fill(0);
            return Some(Ask::new(Command::Fprd, at, write.bytes.len()));
        }
        to.copy_from_slice(&write.bytes);
        Some(Ask::new(Command::Fpwr, at, write.bytes.len()))
    }

    /// A write, or its read back, has come back; whether it was the last one.
    fn on_write(&mut self, data: &[u8]) -> Result<bool, SegmentFailure> {
        let Some(write) = self.writes.get(self.progress) else { return Ok(true) };
        if write.is_compared && !self.is_reading_back {
            self.is_reading_back = true;
            return Ok(false);
        }
        if write.is_compared && !write.is_held(data) {
            let digits = |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>().into();
            let (written, received) = (digits(&write.bytes), digits(data));
            return Err(SegmentFailure::ReadBack { register: write.register, written, received });
        }
        self.is_reading_back = false;
        self.progress += 1;
        Ok(self.progress >= self.writes.len())
    }
}

impl EthercatNetwork {
    /// Sends the next datagram of the bring-up, if it is due and none is on its way.
    pub(super) fn poll_bring_up(&mut self, now: Time, out: &mut impl EthernetOutbox) {
        while self.phase == Phase::Configuring && self.asked.is_none() && now >= self.bring_up.wait_until {
            let Some((task, place)) = self.bring_up.task() else {
                return self.begin_grid(now);
            };
            let asked = self.next_ask(now, task, place);
            match asked {
                Err(failure) => return self.fail_task(now, task, place, failure),
                Ok(None) => continue,
                Ok(Some(ask)) => {
                    self.asked = Some((Asked::BringUp, now));
                    self.bring_up.sent = now;
                    let writes = !matches!(ask.command, Command::Brd | Command::Aprd | Command::Fprd);
                    self.has_written |= writes;
                    let data = self.scratch.get(..ask.len).unwrap_or_default();
                    let sent = self.flight.send(Purpose::Service, |to| to.push(ask.command, ask.address, data));
                    sent.into_iter().for_each(|bytes| out.push(bytes));
                }
            }
        }
    }

    /// Returns the step for which the master waits; `None` when it waits for nothing.
    pub(crate) fn waiting(&self, now: Time) -> Option<Waiting<'_>> {
        let waited = now.since(self.phase_since);
        if self.phase == Phase::Starting {
            let (step, most) = self.starting();
            return Some(Waiting { node_id: None, name: "master", step, waited, left: most.saturating_sub(waited) });
        }
        let (task, place) = self.bring_up.task().filter(|_| self.phase == Phase::Configuring)?;
        let station = self.stations.get(place).filter(|_| task.is_of_station());
        let step = match (task, station) {
            (Task::Objects | Task::LateObjects, Some(station)) => station.script.doing(),
            _ => task.doing(),
        };
        // A datagram that does not come back is given up after so long.
        let most = match (task, station) {
            (Task::State(_), Some(station)) => station.setup.waits.start,
            (Task::Objects | Task::LateObjects, Some(station)) => station.setup.waits.sdo,
            _ => FRAME_WAIT * TRIES.into(),
        };
        let name = station.map_or("master", |station| &station.setup.name);
        Some(Waiting { node_id: None, name, step, waited, left: (self.bring_up.since + most).since(now) })
    }

    fn fail_task(&mut self, now: Time, task: Task, place: usize, failure: BootFailure) {
        let station = if task.is_of_station() {
            self.stations.get(place)
        } else {
            self.stations.iter().find(|station| usize::from(station.setup.position) == place)
        };
        let name = match (task, station) {
            (Task::Count | Task::Reset | Task::Latch | Task::Reference, _) => "master".to_owned(),
            (_, Some(station)) => station.title(),
            (_, None) => format!("the device at position {place}"),
        };
        let step = match (task, self.stations.get(place)) {
            (Task::Objects | Task::LateObjects, Some(station)) => station.script.doing(),
            _ => task.doing(),
        };
        self.fail(now, &name, step, failure);
    }

    /// Returns the next request, with its data in the scratch buffer. `None` if there is nothing to send now, or if the task is
    /// over.
    fn next_ask(&mut self, now: Time, task: Task, place: usize) -> Result<Option<Ask>, BootFailure> {
        let position = 0u16.wrapping_sub(place as u16);
        let buffer = &mut self.scratch[..];
        let mut read = |command, at: u32, len: usize| {
            buffer.iter_mut().take(len).for_each(|byte| *byte = 0);
            Ok(Some(Ask::new(command, at, len)))
        };
        match task {
            Task::Count => read(Command::Brd, address(0, register::AL_STATUS), 2),
            Task::Look => read(Command::Aprd, address(position, register::AL_STATUS), super::exchange::STATUS_LEN),
            Task::Reset => {
                let Some((register, bytes)) = RESETS.get(self.bring_up.progress) else {
                    self.bring_up.finish(now);
                    return Ok(None);
                };
                self.scratch.iter_mut().zip(*bytes).for_each(|(to, byte)| *to = *byte);
                Ok(Some(Ask::new(Command::Bwr, address(0, *register), bytes.len())))
            }
            Task::Address => {
                let station = (FIRST_STATION + place as u16).to_le_bytes();
                self.scratch.iter_mut().zip(station).for_each(|(to, byte)| *to = byte);
                Ok(Some(Ask::new(Command::Apwr, address(position, register::STATION_ADDRESS), 2)))
            }
            Task::Describe => {
                let station = FIRST_STATION + place as u16;
                match self.bring_up.progress {
                    0 => read(Command::Fprd, service_address(station, register::TYPE), 10),
                    _ => read(Command::Fprd, service_address(station, register::DL_STATUS), 2),
                }
            }
            Task::Latch => {
                self.scratch.iter_mut().take(4).for_each(|byte| *byte = 0);
                Ok(Some(Ask::new(Command::Bwr, address(0, register::DC_RECEIVE_TIME), 4)))
            }
            Task::Times => {
                if !self.bring_up.nodes.get(place).is_some_and(|node| node.ports.has_clock) {
                    self.bring_up.finish(now);
                    return Ok(None);
                }
                read(Command::Fprd, service_address(FIRST_STATION + place as u16, register::DC_RECEIVE_TIME), 32)
            }
            Task::Clocks => {
                if self.bring_up.progress == 0 && !self.bring_up.is_reading_back {
                    self.plan_clock(place).map_err(BootFailure::from)?;
                }
                if self.bring_up.writes.is_empty() {
                    self.bring_up.finish(now);
                    return Ok(None);
                }
                Ok(self.bring_up.write(FIRST_STATION + place as u16, &mut self.scratch[..]))
            }
            Task::Reference => match self.reference {
                Some(station) => read(Command::Fprd, service_address(station, register::DC_SYSTEM_TIME), 8),
                None => {
                    self.bring_up.finish(now);
                    Ok(None)
                }
            },
            task => self.next_ask_of_station(now, task, place),
        }
    }

    fn next_ask_of_station(&mut self, now: Time, task: Task, place: usize) -> Result<Option<Ask>, BootFailure> {
        let Some(station) = self.stations.get_mut(place) else { return Ok(None) };
        let at = |register| service_address(station.address, register);
        let buffer = &mut self.scratch[..];
        match task {
            Task::State(state) => {
                if self.bring_up.progress == 0 {
                    // INIT takes back errors of former times.
                    let control =
                        if state == AlState::Init { AlControl::acknowledge(state) } else { AlControl::request(state) };
                    station.is_led |= state != AlState::Init;
                    buffer.iter_mut().zip(control.0.to_le_bytes()).for_each(|(to, byte)| *to = byte);
                    return Ok(Some(Ask::new(Command::Fpwr, at(register::AL_CONTROL), 2)));
                }
                buffer.iter_mut().take(super::exchange::STATUS_LEN).for_each(|byte| *byte = 0);
                Ok(Some(Ask::new(Command::Fprd, at(register::AL_STATUS), super::exchange::STATUS_LEN)))
            }
            Task::Sii => {
                buffer.iter_mut().take(CHIP_LEN).for_each(|byte| *byte = 0);
                if self.bring_up.progress == 0 {
                    let word = (self.bring_up.image.len() / 2) as u32;
                    let command = sii_control::READ.to_le_bytes().into_iter().chain(word.to_le_bytes());
                    buffer.iter_mut().zip(command).for_each(|(to, byte)| *to = byte);
                    return Ok(Some(Ask::new(Command::Fpwr, at(register::SII_CONTROL), 6)));
                }
                Ok(Some(Ask::new(Command::Fprd, at(register::SII_CONTROL), CHIP_LEN)))
            }
            Task::Identify => {
                self.identify(place)?;
                self.bring_up.finish(now);
                Ok(None)
            }
            Task::Mailboxes => {
                if self.bring_up.writes.is_empty() {
                    self.bring_up.writes = writes::mailboxes(station)?;
                }
                Ok(self.bring_up.write(station.address, buffer))
            }
            Task::Objects | Task::LateObjects => self.next_object(now, place, task),
            Task::Exchange => {
                if self.bring_up.writes.is_empty() {
                    let node =
                        self.bring_up.nodes.get(usize::from(station.setup.position)).copied().unwrap_or_default();
                    if station.is_synchronous() && !node.ports.has_clock {
                        return Err(SegmentFailure::NoClock.into());
                    }
                    self.bring_up.writes = writes::exchange(station, node.fmmus, node.sync_managers, self.period)?;
                }
                Ok(self.bring_up.write(station.address, buffer))
            }
            Task::Sync0 if !station.is_synchronous() => {
                self.bring_up.finish(now);
                Ok(None)
            }
            // What time it is before, and whether it has come to be too late.
            Task::Sync0 if self.bring_up.progress >= self.bring_up.writes.len() => {
                buffer.iter_mut().take(8).for_each(|byte| *byte = 0);
                Ok(Some(Ask::new(Command::Fprd, at(register::DC_SYSTEM_TIME), 8)))
            }
            Task::Sync0 => Ok(self.bring_up.write(station.address, buffer)),
            _ => Ok(None),
        }
    }

    /// Goes on with the objects of a device.
    fn next_object(&mut self, now: Time, place: usize, task: Task) -> Result<Option<Ask>, BootFailure> {
        let Some(station) = self.stations.get_mut(place) else { return Ok(None) };
        if self.bring_up.progress == 0 && task == Task::Objects {
            self.bring_up.progress = 1;
            let [to, from] = station.sii.as_ref().and_then(Sii::mailbox_areas).unwrap_or_default();
            station.mailbox.start(to, from);
        }
        if self.bring_up.has_asked && !station.mailbox.is_busy() {
            self.bring_up.has_asked = false;
            if let Some(error) = station.mailbox.refused() {
                return Err(SegmentFailure::Mailbox(error).into());
            }
            match station.mailbox.answer() {
                ObjectAnswer::Done(data) => station.script.on_answer(now, Ok(data))?,
                ObjectAnswer::Failed(error) => station.script.on_answer(now, Err(error))?,
                ObjectAnswer::NotAsked | ObjectAnswer::Pending => {}
            }
        }
        if !self.bring_up.has_asked {
            if now < station.script.again_at && station.script.again_at != Time::NEVER {
                self.bring_up.wait_until = station.script.again_at;
                return Ok(None);
            }
            station.script.again_at = Time::NEVER;
            let wanted =
                if task == Task::Objects && station.script.is_late() { None } else { station.script.wanted()? };
            let Some(wanted) = wanted else {
                station.mailbox.forget();
                self.bring_up.finish(now);
                return Ok(None);
            };
            station.mailbox.ask(now, wanted.request()).map_err(|_| BootFailure::from(SegmentFailure::NoCoe))?;
            self.bring_up.has_asked = true;
        }
        let ask = station.mailbox.next(now, &mut self.scratch[..]);
        if ask.is_none() && station.mailbox.is_busy() {
            self.bring_up.wait_until = station.mailbox.next_deadline();
        }
        Ok(ask)
    }

    /// The frame of the present datagram did not come back.
    pub(super) fn on_bring_up_loss(&mut self, now: Time) {
        let Some((task, place)) = self.bring_up.task() else { return };
        self.bring_up.tries += 1;
        if let (Task::Objects | Task::LateObjects, Some(station)) = (task, self.stations.get_mut(place)) {
            station.mailbox.on_loss();
        }
        // Which of the two steps of a read of the chip it was, nobody knows.
        if task == Task::Sii {
            self.bring_up.progress = 0;
        }
        if self.bring_up.tries >= TRIES {
            let failure = match self.flight.counts.unprocessed {
                0 => SegmentFailure::NoReply { tries: TRIES },
                _ => SegmentFailure::CameBack { tries: TRIES },
            };
            self.fail_task(now, task, place, failure.into());
        }
    }

    /// The present datagram has come back.
    pub(super) fn on_bring_up(&mut self, now: Time, data: &[u8], working_counter: u16) {
        let Some((task, place)) = self.bring_up.task() else { return };
        if let (Task::Objects | Task::LateObjects, Some(station)) = (task, self.stations.get_mut(place)) {
            self.bring_up.tries = 0;
            if let Some(emergency) = station.mailbox.on_reply(now, data, working_counter) {
                self.hear(now, place, emergency);
            }
            return;
        }
        // Registers of clocks are not there in every device.
        let may_be_short = matches!(task, Task::Count | Task::Reset | Task::Latch);
        if working_counter == 0 && !may_be_short {
            self.bring_up.tries += 1;
            self.bring_up.wait_until = now + LOOK_AGAIN;
            if self.bring_up.tries >= TRIES {
                let register =
                    self.bring_up.writes.get(self.bring_up.progress).map_or(register_of(task), |it| it.register);
                let failure = SegmentFailure::NotProcessed { register, tries: TRIES };
                self.fail_task(now, task, place, failure.into());
            }
            return;
        }
        self.bring_up.tries = 0;
        if let Err(failure) = self.on_processed(now, task, place, data, working_counter) {
            self.fail_task(now, task, place, failure);
        }
    }

    fn on_processed(&mut self, now: Time, task: Task, place: usize, data: &[u8], working_counter: u16) -> Step {
        let status = || (AlStatus::from_register(u16_at(data, 0)), AlStatusCode(u16_at(data, 4)));
        match task {
            Task::Count => return self.on_count(now, working_counter),
            Task::Look => {
                let (status, code) = status();
                let is_left = self.has_defended && status.state() == Some(AlState::SafeOperational);
                if status.shows_master(code) && !self.is_ours && !is_left {
                    // What this master led itself stops by its watchdog now that nobody sends outputs.
                    if self.has_written && now < self.bring_up.since + LEFT_ALONE {
                        self.bring_up.wait_until = now + LOOK_AGAIN;
                        return Ok(());
                    }
                    self.is_silent = true;
                    let sign = SegmentSign::State { position: place as u16, status };
                    return Err(SegmentFailure::OtherMaster { sign, has_written: self.has_written }.into());
                }
                self.bring_up.finish(now);
            }
            Task::Reset => {
                let (before, is_first) = (self.bring_up.nodes.len() as u16, self.bring_up.progress == 0);
                if is_first && working_counter != before {
                    return Err(SegmentFailure::Changed { before, now: working_counter }.into());
                }
                (self.is_ours, self.has_defended) = (true, false);
                self.bring_up.progress += 1;
            }
            Task::Address => {
                if let Some(station) = self.stations.iter_mut().find(|it| usize::from(it.setup.position) == place) {
                    let bytes = station.address.to_le_bytes().to_vec();
                    station.held.note(&[Write { register: register::STATION_ADDRESS, bytes, is_compared: true }]);
                }
                self.bring_up.finish(now);
            }
            Task::State(state) => return self.on_state(now, place, state, status()),
            Task::Sii => return self.on_sii(now, place, data),
            Task::Describe => {
                let is_last = self.bring_up.progress > 0;
                let Some(node) = self.bring_up.nodes.get_mut(place) else { return Ok(()) };
                if is_last {
                    node.ports.links = u16_at(data, 0);
                    self.bring_up.finish(now);
                } else {
                    let [fmmus, sync_managers] = array(data, usize::from(register::FMMU_COUNT));
                    let features = u16_at(data, register::FEATURES.into());
                    (node.fmmus, node.sync_managers) = (fmmus, sync_managers);
                    node.ports.has_clock = features & (feature::DC | feature::DC_64) == feature::DC | feature::DC_64;
                    self.bring_up.progress = 1;
                }
            }
            Task::Latch => self.bring_up.finish(now),
            Task::Times => {
                if let Some(node) = self.bring_up.nodes.get_mut(place) {
                    node.ports.times = [0, 4, 8, 12].map(|at| u32_at(data, at));
                    node.local_ns = u64::from_le_bytes(array(data, 0x18));
                }
                self.bring_up.finish(now);
            }
            Task::Sync0 if self.bring_up.progress >= self.bring_up.writes.len() => {
                let time_ns = u64::from_le_bytes(array(data, 0));
                let is_set_up = !self.bring_up.writes.is_empty();
                if is_set_up && time_ns < self.bring_up.sync0_from_ns {
                    self.bring_up.sync0_tries = 0;
                    self.note_held(place);
                    self.bring_up.finish(now);
                    return Ok(());
                }
                self.bring_up.sync0_tries += u8::from(is_set_up);
                if self.bring_up.sync0_tries >= TRIES {
                    return Err(SegmentFailure::Sync0Late { tries: TRIES }.into());
                }
                let sync1 = self.stations.get(place).and_then(|station| station.setup.sync1);
                (self.bring_up.writes, self.bring_up.sync0_from_ns) = writes::sync0(self.period, sync1, time_ns);
                self.bring_up.progress = 0;
            }
            Task::Sync0 => {
                self.bring_up.on_write(data)?;
            }
            Task::Mailboxes | Task::Exchange => {
                if self.bring_up.on_write(data)? {
                    self.note_held(place);
                    self.bring_up.finish(now);
                }
            }
            Task::Clocks => {
                if self.bring_up.on_write(data)? {
                    self.bring_up.finish(now);
                }
            }
            Task::Reference => {
                let phase = self.servo.error_ns(u64::from_le_bytes(array(data, 0)));
                self.bring_up.finish(now);
                // A period later than that moment, less by what it was behind its place.
                let period_ns = self.period.as_nanos() as i64;
                let mut first = self.bring_up.sent.0.saturating_add_signed(period_ns - phase as i64);
                while first < now.0 {
                    first = first.saturating_add(period_ns.max(1) as u64);
                }
                self.grid.begin(Time(first));
            }
            Task::Identify | Task::Objects | Task::LateObjects => {}
        }
        Ok(())
    }

    /// The registers of a device are as they were written.
    fn note_held(&mut self, place: usize) {
        let Some(station) = self.stations.get_mut(place) else { return };
        station.held.note(&self.bring_up.writes);
    }

    fn on_count(&mut self, now: Time, found: u16) -> Step {
        if found > MOST_DEVICES {
            return Err(SegmentFailure::TooMany { found, most: MOST_DEVICES }.into());
        }
        let missing = self.stations.iter().find(|station| station.setup.position >= found);
        if let Some(station) = missing {
            let (name, position) = (station.title(), station.setup.position);
            self.fail(now, &name, Task::Count.doing(), SegmentFailure::Missing { found, position });
            return Ok(());
        }
        let stations = self.stations.len();
        self.bring_up.nodes = vec![Node::default(); found.into()];
        self.bring_up.plan(found.into(), stations);
        self.bring_up.finish(now);
        Ok(())
    }

    fn on_state(&mut self, now: Time, place: usize, to: AlState, (status, code): (AlStatus, AlStatusCode)) -> Step {
        if self.bring_up.progress == 0 {
            self.bring_up.progress = 1;
            return Ok(());
        }
        let Some(station) = self.stations.get_mut(place) else { return Ok(()) };
        (station.status, station.code) = (status, code);
        if status == AlStatus::new(to, false) {
            self.bring_up.finish(now);
            return Ok(());
        }
        if status.has_error() && to != AlState::Init {
            return Err(SegmentFailure::Refused { from: status, to, code }.into());
        }
        let (waited, most) = (now.since(self.bring_up.since), station.setup.waits.start);
        if waited >= most {
            return Err(SegmentFailure::NotReached { is: status, to, waited_ms: waited.as_millis() as u64 }.into());
        }
        self.bring_up.wait_until = now + LOOK_AGAIN;
        Ok(())
    }

    /// Takes the registers of the memory chip: its data, or the report that it needs more time.
    fn on_sii(&mut self, now: Time, place: usize, data: &[u8]) -> Step {
        let word = self.bring_up.image.len() / 2;
        if self.bring_up.progress == 0 {
            self.bring_up.progress = 1;
            return Ok(());
        }
        let status = u16_at(data, 0);
        let failed = status & sii_control::COMMAND_ERROR != 0;
        if failed || self.bring_up.progress > CHIP_LOOKS {
            return Err(SegmentFailure::SiiAccess { word: word as u16, status }.into());
        }
        if status & sii_control::BUSY != 0 {
            self.bring_up.progress += 1;
            self.bring_up.wait_until = now + CHIP_AGAIN;
            return Ok(());
        }
        if u32_at(data, 2) != word as u32 {
            // Of a read before, whose command was lost.
            self.bring_up.progress = 0;
            self.bring_up.other_words += 1;
            if self.bring_up.other_words > TRIES {
                return Err(SegmentFailure::SiiAccess { word: word as u16, status }.into());
            }
            return Ok(());
        }
        self.bring_up.other_words = 0;
        let len = if status & sii_control::EIGHT_BYTES != 0 { 8 } else { 4 };
        self.bring_up.image.extend_from_slice(data.get(6..6 + len).unwrap_or_default());
        self.bring_up.progress = 0;
        if self.bring_up.image.len() / 2 < words_needed(&self.bring_up.image) {
            return Ok(());
        }
        let sii = Sii::read(&self.bring_up.image).map_err(SegmentFailure::from)?;
        if let Some(station) = self.stations.get_mut(place) {
            station.sii = Some(sii);
        }
        self.bring_up.finish(now);
        Ok(())
    }

    /// Whether a device is the one that the rig says.
    fn identify(&self, place: usize) -> Step {
        let Some(station) = self.stations.get(place) else { return Ok(()) };
        let Some(sii) = &station.sii else { return Ok(()) };
        match station.mismatch(sii) {
            None => Ok(()),
            Some((what, expected, found)) => {
                // Of the devices that are themselves where they should not be.
                let fits = |other: &&Station| {
                    let Some(sii) = &other.sii else { return false };
                    station.mismatch(sii).is_none() && other.mismatch(sii).is_some()
                };
                let fits_at = self.stations.iter().find(fits).map(|other| other.setup.position);
                Err(SegmentFailure::Identity { what, expected: expected.into(), found, fits_at }.into())
            }
        }
    }

    /// Delays of all devices when the last of their times is known; then what is written to the clock of one.
    fn plan_clock(&mut self, place: usize) -> Result<(), SegmentFailure> {
        let nodes = &mut self.bring_up.nodes;
        if place == 0 {
            let ports: Vec<Ports> = nodes.iter().map(|node| node.ports).collect();
            let delays = delays(&ports).map_err(|place| {
                let links = ports.get(place).map_or(0, |ports| ports.links);
                SegmentFailure::Topology { position: place as u16, links }
            });
            let delays = match delays {
                Ok(delays) => delays,
                // Without SYNC0 nobody needs them.
                Err(_) if !self.stations.iter().any(Station::is_synchronous) => vec![None; nodes.len()],
                Err(failure) => return Err(failure),
            };
            nodes.iter_mut().zip(delays).for_each(|(node, delay)| node.delay_ns = delay);
            let first = nodes.iter().position(|node| node.delay_ns.is_some());
            self.reference = first.map(|position| FIRST_STATION + position as u16);
        }
        let Some(reference) = nodes.iter().find(|node| node.delay_ns.is_some()) else { return Ok(()) };
        let Some((node, delay)) = nodes.get(place).and_then(|node| Some((node, node.delay_ns?))) else { return Ok(()) };
        // The clock shows the time of the reference at the moment at which the frame passed here.
        let offset = reference.local_ns.wrapping_add(delay.into()).wrapping_sub(node.local_ns);
        self.bring_up.writes = vec![
            Write { register: register::DC_OFFSET, bytes: offset.to_le_bytes().to_vec(), is_compared: true },
            Write { register: register::DC_DELAY, bytes: delay.to_le_bytes().to_vec(), is_compared: true },
            // Forgets the differences from the time before.
            Write { register: register::DC_SPEED_START, bytes: vec![0, 0x10], is_compared: false },
        ];
        Ok(())
    }

    /// All devices are in SAFE-OP: cycles begin.
    fn begin_grid(&mut self, now: Time) {
        let ports: Vec<Ports> = self.bring_up.nodes.iter().map(|node| node.ports).collect();
        self.ports = PortWatch::new(&ports);
        if self.grid.next_deadline() == Time::NEVER {
            self.grid.begin(now + self.period);
        }
        self.enter(now, Phase::Starting);
    }
}

/// The register that a task is about, for messages.
fn register_of(task: Task) -> u16 {
    match task {
        Task::Address => register::STATION_ADDRESS,
        Task::Sii => register::SII_CONTROL,
        Task::Describe => register::TYPE,
        Task::Times | Task::Latch => register::DC_RECEIVE_TIME,
        Task::Reference | Task::Sync0 => register::DC_SYSTEM_TIME,
        _ => register::AL_STATUS,
    }
}

/// The SII of a device is damaged.
impl From<SiiError> for BootFailure {
    fn from(error: SiiError) -> Self {
        SegmentFailure::from(error).into()
    }
}
