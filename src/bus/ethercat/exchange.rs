//! The two moments of a cycle, and the service requests between them.
//!
//! ```text
//! open   input frame:  FRMW 0910h | per device LRD inputs, FPRD 0130h      -> comes back filled
//! take   what has come; a frame that comes later is late and not used
//! close  output frame: per device LWR outputs
//!        behind it at most one service frame: ports, mailbox, difference of a clock, request of OP
//! repeat the outputs once more, shortly before SYNC0, of devices that act there
//! ```

use std::time::Duration;

use super::failure::SegmentFailure;
use super::flight::Purpose;
use super::held::Turn;
use super::ports::Shown;
use super::setup::Acts;
use super::writes::Altered;
use super::{Asked, EthercatNetwork, EthernetOutbox, Station, service_address};
use crate::axis::{Arrived, DriveOrders};
use crate::phase::Phase;
use yieldwall_fieldbus::ethercat::frame::{self, Command, Datagrams};
use yieldwall_fieldbus::ethercat::{
    AlControl, AlState, AlStatus, AlStatusCode, array, registers as register, u16_at, u32_at,
};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::cycle::LinkEvents;
use yieldwall_motion::guard::DeviceSet;

/// Bytes from AL status to AL status code.
pub(super) const STATUS_LEN: usize = 6;
/// Step on the way to OP: clock synchronisation.
const CLOCKS: &str = "bring the clocks together";
const TO_OP: &str = "go to OP";
/// How long the clocks may take to come together.
const SETTLING: Duration = Duration::from_secs(10);
/// Number of service frames after which a clock is compared, whatever else waits. At a cycle of 20 ms every cycle otherwise only
/// looks for emergencies.
const COMPARED_AFTER: u32 = 8;
/// Orders to drives that nobody has enabled; they do not bring a drive nearer to Operation Enabled.
const REST: DriveOrders = DriveOrders { controlword: 0, target: 0, releases: false };

/// Cycles that the network runs by itself from SAFE-OP until a caller takes them over.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    /// Grid point of the next cycle; [`Time::NEVER`] if a caller runs the cycles.
    next_open: Time,
    next_close: Time,
    /// Stations that were asked for OP.
    asked: u64,
    is_asking: bool,
    cycles: u64,
}

impl Grid {
    pub(super) fn new() -> Self {
        Grid { next_open: Time::NEVER, next_close: Time::NEVER, asked: 0, is_asking: false, cycles: 0 }
    }

    pub(super) fn begin(&mut self, at: Time) {
        *self = Grid { next_open: at, ..Grid::new() };
    }

    pub(super) fn next_deadline(&self) -> Time {
        self.next_open.min(self.next_close)
    }

    /// A station has taken the request of OP.
    pub(super) fn note_asked(&mut self, place: usize) {
        self.asked |= 1 << place.min(63);
    }

    fn is_asked(&self, place: usize) -> bool {
        self.asked & 1 << place.min(63) != 0
    }
}

impl EthercatNetwork {
    /// Notes how late the next input frame is against its grid point. The servo subtracts this delay from the reading of the
    /// reference clock.
    ///
    /// Real-time: yes.
    pub fn note_late(&mut self, late: Duration) {
        self.servo.note_late(late);
        self.repeat.note_late(late);
    }

    /// The begin of a cycle: the input frame. The caller runs the cycles from the first call on.
    ///
    /// Real-time: yes.
    pub fn open(&mut self, out: &mut impl EthernetOutbox) {
        (self.grid.next_open, self.grid.next_close) = (Time::NEVER, Time::NEVER);
        self.repeat.forget();
        self.send_inputs(out);
    }

    fn send_inputs(&mut self, out: &mut impl EthernetOutbox) {
        if self.flight.give_up(Purpose::Outputs) {
            // Nobody knows whether the devices took their outputs.
            for station in self.stations.iter_mut().filter(|station| station.outputs.len > 0) {
                self.events.outputs_missed |= station.miss_outputs();
            }
        }
        for station in &mut self.stations {
            station.begin_cycle();
        }
        self.flight.give_up(Purpose::Repeat);
        if self.is_silent {
            self.flight.give_up(Purpose::Inputs);
            return;
        }
        let (stations, reference) = (&self.stations, self.reference);
        let sent = self.flight.send(Purpose::Inputs, |to| {
            if let Some(station) = reference {
                to.read(Command::Frmw, service_address(station, register::DC_SYSTEM_TIME), 8);
            }
            for station in stations {
                if station.inputs.len > 0 {
                    to.read(Command::Lrd, station.inputs.logical, station.inputs.len);
                }
                to.read(Command::Fprd, service_address(station.address, register::AL_STATUS), STATUS_LEN);
            }
        });
        sent.into_iter().for_each(|bytes| out.push(bytes));
    }

    /// The input frame has come back.
    pub(super) fn on_inputs(&mut self, now: Time, bytes: &[u8]) {
        let Ok(mut datagrams) = Datagrams::of(bytes) else { return };
        let mut next = || datagrams.next().and_then(Result::ok);
        // Where this master has asked a device to leave OP, that it does is nothing to report.
        let is_running = self.phase == Phase::Operational && !self.is_defending();
        if self.reference.is_some()
            && let Some(time) = next()
        {
            if time.working_counter > 0 {
                self.servo.on_time(u64::from_le_bytes(array(time.data, 0)));
            } else {
                self.servo.on_silence();
            }
        }
        for station in &mut self.stations {
            if station.inputs.len > 0
                && let Some(inputs) = next()
                && inputs.working_counter == 1
            {
                station.take_inputs(now, inputs.data);
            }
            if let Some(status) = next()
                && status.working_counter == 1
            {
                station.has_status = true;
                station.status = AlStatus::from_register(u16_at(status.data, 0));
                station.code = AlStatusCode(u16_at(status.data, 4));
                if is_running && station.left.is_none() && station.status != AlStatus::new(AlState::Operational, false)
                {
                    station.left = Some((station.status, station.code));
                }
            }
            if station.was_there && !station.has_status {
                self.ports.hurry(station.setup.position);
            }
            station.was_there = station.has_status;
        }
        if self.servo.is_lost() {
            self.clock_lost |= self.all();
            self.grid_off_ns.get_or_insert(self.servo.last_ns());
        }
    }

    /// The output frame has come back.
    pub(super) fn on_outputs(&mut self, bytes: &[u8]) {
        let Ok(mut datagrams) = Datagrams::of(bytes) else { return };
        for station in self.stations.iter_mut().filter(|station| station.outputs.len > 0) {
            let is_taken = datagrams.next().and_then(Result::ok).is_some_and(|it| it.working_counter == 1);
            if !is_taken {
                self.events.outputs_missed |= station.miss_outputs();
            }
        }
    }

    /// The devices of which something of this cycle has not come.
    ///
    /// Real-time: yes.
    pub fn missing(&self) -> DeviceSet {
        let missing = self.stations.iter().filter(|station| !station.has_inputs && station.inputs.len > 0);
        missing.fold(DeviceSet::NONE, |set, station| set | station.setup.devices)
    }

    /// Returns the data that have come in this cycle. Later data are late: a value measured in one cycle is never used in
    /// another.
    ///
    /// Real-time: yes.
    pub(crate) fn take(&mut self, now: Time) -> Arrived {
        if self.flight.give_up(Purpose::Inputs) && self.reference.is_some() {
            self.servo.on_silence();
        }
        let mut arrived = Arrived::default();
        let is_running = self.phase == Phase::Operational;
        for station in &mut self.stations {
            let devices = station.setup.devices;
            for (joint, words) in station.words() {
                arrived.drives.get_mut(joint).into_iter().for_each(|to| *to = words);
            }
            if devices.contains(DeviceSet::SENSOR) {
                arrived.sample = station.sample(now);
            }
            self.events.device_state |= devices.only_if(is_running && station.left.is_some());
            station.inputs_missed =
                station.inputs_missed.saturating_add(u64::from(station.inputs.len > 0 && !station.has_inputs));
        }
        if is_running {
            self.events.clock_lost |= self.clock_lost;
            self.events.port_errors |= self.cut_off;
        }
        arrived.link = std::mem::take(&mut self.events);
        arrived
    }

    /// Ends a cycle: sends the output frame, and after it a service frame.
    ///
    /// Real-time: yes.
    pub(crate) fn close(&mut self, now: Time, orders: &[DriveOrders; 2], out: &mut impl EthernetOutbox) {
        if self.is_silent {
            return;
        }
        self.send_outputs(Purpose::Outputs, orders, |_| true, out);
        self.repeat.take(*orders);
        self.send_service(now, out);
    }

    /// Time before the next grid point at which [`EthercatNetwork::repeat`] is due; `None` where there is nothing to repeat.
    ///
    /// Real-time: yes.
    pub(crate) fn repeats_before(&self) -> Option<Duration> {
        let copying = self.stations.iter().filter(|station| station.setup.acts == Acts::AtSync0);
        let copying = copying.map(|station| station.script.copy_time()).max()?;
        if self.repeat.is_due() && !self.is_silent { self.repeat.before(copying) } else { None }
    }

    /// Sends the outputs of this cycle once more to the devices that act on them at SYNC0. They then replace outputs that a
    /// foreign master has sent since. A device that acts on arrival would take them for a second set-point.
    ///
    /// Real-time: yes.
    pub(crate) fn repeat(&mut self, out: &mut impl EthernetOutbox) {
        if let Some(orders) = self.repeat.forget().filter(|_| !self.is_silent) {
            self.send_outputs(Purpose::Repeat, &orders, |station| station.setup.acts == Acts::AtSync0, out);
        }
    }

    fn send_outputs(
        &mut self,
        purpose: Purpose,
        orders: &[DriveOrders; 2],
        is_meant: impl Fn(&Station) -> bool,
        out: &mut impl EthernetOutbox,
    ) {
        let stations = &self.stations;
        let sent = self.flight.send(purpose, |to| {
            for station in stations.iter().filter(|station| station.outputs.len > 0 && is_meant(station)) {
                let mut data = [0; frame::LONGEST];
                let Some(data) = data.get_mut(..station.outputs.len) else { continue };
                station.put_outputs(orders, data);
                to.push(Command::Lwr, station.outputs.logical, data);
            }
        });
        sent.into_iter().for_each(|bytes| out.push(bytes));
    }

    /// By how much the next grid point is moved so that the cycles follow the reference clock, in ns: at most 1 % of a period.
    ///
    /// Real-time: yes.
    pub fn grid_shift_ns(&self) -> i64 {
        if self.reference.is_some() { self.servo.shift_ns() } else { 0 }
    }

    /// Delay of the last cycle's input frame against its place after SYNC0, in ns.
    ///
    /// Real-time: yes.
    pub fn grid_error_ns(&self) -> i64 {
        self.servo.last_ns()
    }

    /// Devices whose clocks are not together with the grid any more, since the network was started. Outputs do not act when they should
    /// then.
    ///
    /// Real-time: yes.
    pub fn clock_lost(&self) -> DeviceSet {
        self.clock_lost
    }

    /// Hands the cycles over to another caller, and returns the grid point of the next cycle. `None` between the two moments of a
    /// cycle, before the first cycle, and if another caller already has the cycles.
    pub fn take_over_cycles(&mut self) -> Option<Time> {
        let next = std::mem::replace(&mut self.grid.next_open, Time::NEVER);
        if next == Time::NEVER {
            return None;
        }
        // What was missed is counted of the cycles of whoever runs them.
        self.stations.iter_mut().for_each(Station::forget_missed);
        Some(next)
    }

    /// Whether a frame has not come back.
    ///
    /// Real-time: yes.
    pub(crate) fn is_in_flight(&self) -> bool {
        Purpose::ALL.into_iter().any(|purpose| self.flight.is_out(purpose))
    }

    /// Sends at most one service frame besides the frames of the cycle.
    fn send_service(&mut self, now: Time, out: &mut impl EthernetOutbox) {
        let is_due = self.ports.is_due();
        if self.defend(now, out) || self.flight.is_out(Purpose::Service) {
            return;
        }
        let count = self.stations.len();
        let starting = (self.phase == Phase::Starting && self.grid.is_asking)
            .then(|| (0..count).find(|place| !self.grid.is_asked(*place)))
            .flatten();
        if let Some(place) = starting {
            let request = AlControl::request(AlState::Operational).0.to_le_bytes();
            return self.send_to(now, place, Asked::Operational(place), register::AL_CONTROL, Err(request), out);
        }
        if is_due {
            let first = self.ports.take_turn();
            self.asked = Some((Asked::Ports(first), now));
            let sent = self.flight.send(Purpose::Service, |to| self.ports.ask(first, to));
            return sent.into_iter().for_each(|bytes| out.push(bytes));
        }
        if self.phase == Phase::Operational && self.held.is_due(now) && self.read_back(now, out) {
            return;
        }
        self.uncompared = self.uncompared.saturating_add(1);
        if self.uncompared >= COMPARED_AFTER && self.compare_clock(now, out) {
            return;
        }
        for step in 0..count {
            let place = (self.turn + step) % count;
            let Some(station) = self.stations.get_mut(place) else { continue };
            if self.phase == Phase::Operational {
                station.check_limits(now);
            }
            if station.mailbox.next_deadline() > now {
                continue;
            }
            if let Some(ask) = station.mailbox.next(now, &mut self.scratch[..]) {
                self.turn = (place + 1) % count;
                self.asked = Some((Asked::Mailbox(place), now));
                let data = self.scratch.get(..ask.len).unwrap_or_default();
                let sent = self.flight.send(Purpose::Service, |to| to.push(ask.command, ask.address, data));
                return sent.into_iter().for_each(|bytes| out.push(bytes));
            }
        }
        self.compare_clock(now, out);
    }

    /// Defends the devices after a foreign master has written to them. It writes their addresses and watchdogs back at once.
    /// While the drives are being stopped, it also requests SAFE-OP from devices that are not there yet. Returns whether anything
    /// was sent.
    fn defend(&mut self, now: Time, out: &mut impl EthernetOutbox) -> bool {
        // Not in each cycle: somebody who never ends would keep the mailboxes from being asked.
        let restores = self.restores && !self.has_restored;
        self.restores &= !restores;
        self.has_restored = restores;
        let leaves = self.is_defending();
        self.has_defended |= leaves;
        let is_stopping = self.is_stopping;
        self.stations.iter_mut().for_each(|station| station.disarm(now, leaves, is_stopping));
        if !restores && self.stations.iter().all(|station| station.wanted.is_none()) {
            return false;
        }
        if self.flight.give_up(Purpose::Service) {
            self.on_service_loss(now);
        }
        let stations = &self.stations;
        let sent = self.flight.send(Purpose::Service, |to| {
            for station in stations {
                let position = station.setup.position;
                if restores {
                    station.held.restore(position, to);
                }
                if let Some(state) = station.wanted {
                    let request = AlControl::request(state).0.to_le_bytes();
                    to.push(Command::Apwr, frame::address(position.wrapping_neg(), register::AL_CONTROL), &request);
                }
            }
        });
        let is_sent = sent.is_some();
        sent.into_iter().for_each(|bytes| out.push(bytes));
        if is_sent {
            self.asked = Some((Asked::Defence, now));
        }
        is_sent
    }

    /// Whether devices are asked to leave OP, as a rule since another master writes to them.
    fn is_defending(&self) -> bool {
        self.leaves_op || self.has_intruder && self.is_stopping
    }

    /// Reads registers of the next device; whether there are any.
    fn read_back(&mut self, now: Time, out: &mut impl EthernetOutbox) -> bool {
        let turn = self.held;
        let Some(station) = self.stations.get(turn.place) else { return false };
        let place = (station.setup.position, station.address);
        let sent = self.flight.send(Purpose::Service, |to| turn.ask(&station.held, place, to));
        let is_sent = sent.is_some();
        sent.into_iter().for_each(|bytes| out.push(bytes));
        if is_sent {
            self.asked = Some((Asked::Held, now));
        }
        is_sent
    }

    /// Registers have come back.
    pub(super) fn on_held(&mut self, bytes: &[u8]) {
        let Ok(back) = Datagrams::of(bytes) else { return };
        let turn = self.held;
        let Some(station) = self.stations.get(turn.place) else { return };
        let altered = self.held.take(&station.held, self.stations.len(), back);
        let place = turn.place;
        if let Some(altered) = altered {
            self.note_altered(place, altered);
        }
    }

    /// Notes that a device holds something else than this master has written.
    pub(super) fn note_altered(&mut self, place: usize, altered: Altered) {
        let is_watched = self.phase == Phase::Operational;
        // A device that has restarted, or left OP, has forgotten it by itself.
        let station = self.stations.get_mut(place).filter(|station| station.has_inputs && station.left.is_none());
        if let Some(station) = station.filter(|_| is_watched) {
            station.altered = station.altered.or(Some(altered));
            self.events.intruder = true;
            (self.has_intruder, self.restores) = (true, true);
        }
    }

    /// Asks the next device for the difference of its clock; whether there is one to ask.
    fn compare_clock(&mut self, now: Time, out: &mut impl EthernetOutbox) -> bool {
        let count = self.stations.len();
        for step in 0..count {
            let place = (self.compared + step) % count;
            let is_compared = |station: &Station| station.is_synchronous() && Some(station.address) != self.reference;
            if self.stations.get(place).is_some_and(is_compared) {
                (self.compared, self.uncompared) = ((place + 1) % count, 0);
                self.send_to(now, place, Asked::Difference(place), register::DC_DIFFERENCE, Ok(4), out);
                return true;
            }
        }
        false
    }

    /// Reads registers of a station, or writes two bytes of them.
    fn send_to(
        &mut self,
        now: Time,
        place: usize,
        asked: Asked,
        register: u16,
        what: Result<usize, [u8; 2]>,
        out: &mut impl EthernetOutbox,
    ) {
        let Some(station) = self.stations.get(place) else { return };
        let address = service_address(station.address, register);
        self.asked = Some((asked, now));
        let sent = self.flight.send(Purpose::Service, |to| match what {
            Ok(len) => to.read(Command::Fprd, address, len),
            Err(data) => to.push(Command::Fpwr, address, &data),
        });
        sent.into_iter().for_each(|bytes| out.push(bytes));
    }

    /// The mean difference of a clock from that of the reference has come: magnitude, and bit 31 as the sign.
    pub(super) fn on_difference(&mut self, place: usize, data: &[u8]) {
        let lost_ns = self.servo.lost_ns();
        let is_watched = self.phase == Phase::Operational;
        let Some(station) = self.stations.get_mut(place) else { return };
        let difference_ns = register::difference_ns(u32_at(data, 0));
        station.difference_ns = Some(difference_ns);
        if is_watched && difference_ns.abs() > lost_ns {
            self.clock_lost |= station.setup.devices;
            station.lost_ns = station.lost_ns.or(station.difference_ns);
        }
    }

    /// Links and error counters of ports have come.
    pub(super) fn on_ports(&mut self, first: usize, bytes: &[u8]) {
        let Ok(datagrams) = Datagrams::of(bytes) else { return };
        let is_watched = self.phase == Phase::Operational;
        let (stations, events, cut_off) = (&self.stations, &mut self.events, &mut self.cut_off);
        let bus = DeviceSet::interface(self.bus.index());
        let devices = |is_one: &dyn Fn(u16) -> bool| {
            let concerned = stations.iter().filter(|station| is_one(station.setup.position));
            concerned.fold(DeviceSet::NONE, |set, station| set | station.setup.devices)
        };
        self.ports.take(first, datagrams, |shown| match shown {
            Shown::Errors(_) if !is_watched => {}
            Shown::Errors(position) => {
                let device = devices(&|at| at == position);
                events.port_errors |= if device.is_empty() { bus } else { device };
            }
            Shown::Lost(behind) => *cut_off |= devices(&|at| behind.has(at)),
        });
    }

    /// Runs one of the network's own cycles when it is due.
    pub(super) fn poll_grid(&mut self, now: Time, out: &mut impl EthernetOutbox) {
        if now >= self.grid.next_open {
            let at = self.grid.next_open;
            self.note_late(now.since(at));
            self.send_inputs(out);
            (self.grid.next_open, self.grid.next_close) = (Time::NEVER, at + self.compute_at);
        } else if now >= self.grid.next_close {
            let open = Time(self.grid.next_close.0.saturating_sub(self.compute_at.as_nanos() as u64));
            self.take(now);
            self.close(now, &[REST; 2], out);
            let next = open + self.period;
            // Nothing moves yet: the grid goes to the reference clock at once.
            let shift_ns = self.servo.jump_ns().unwrap_or_else(|| self.grid_shift_ns());
            let next = Time(next.0.saturating_add_signed(shift_ns));
            // A computer that stood still goes on at the next grid point.
            let behind = now.since(next).as_nanos().div_ceil(self.period.as_nanos().max(1)) as u64;
            self.grid.next_open = Time(next.0 + behind * self.period.as_nanos() as u64);
            self.grid.next_close = Time::NEVER;
            self.grid.cycles += 1;
            self.watch_start(now);
        }
    }

    /// Returns the step for which the master waits in SAFE-OP, and its time limit since the phase or the request began.
    pub(super) fn starting(&self) -> (&'static str, Duration) {
        if self.grid.is_asking {
            let waits = self.stations.iter().map(|station| station.setup.waits.start);
            (TO_OP, waits.max().unwrap_or_default())
        } else {
            (CLOCKS, SETTLING)
        }
    }

    /// From SAFE-OP to OP: when the clocks are together, each device is asked, and then each has to be there.
    fn watch_start(&mut self, now: Time) {
        if self.phase != Phase::Starting {
            return;
        }
        let waited = now.since(self.phase_since);
        let wanted = if self.grid.is_asking {
            [AlState::SafeOperational, AlState::Operational]
        } else {
            [AlState::SafeOperational; 2]
        };
        let bad = self.stations.iter().find(|station| {
            let is_expected = wanted.map(Some).contains(&station.status.state());
            station.has_status && (station.status.has_error() || !is_expected)
        });
        if let Some(station) = bad {
            let (from, to, code) = (station.status, AlState::Operational, station.code);
            let title = station.title();
            return self.fail(now, &title, TO_OP, SegmentFailure::Refused { from, to, code });
        }
        if !self.grid.is_asking {
            let near = self.servo.settled_ns();
            let apart = |station: &Station| match station.difference_ns {
                _ if !station.is_synchronous() || Some(station.address) == self.reference => 0,
                Some(difference) => difference.abs(),
                None => i64::MAX,
            };
            let worst = self.stations.iter().map(apart).max().unwrap_or_default();
            if worst <= near && (self.reference.is_none() || self.servo.has_settled()) && self.grid.cycles > 1 {
                self.grid.is_asking = true;
                self.phase_since = now;
            } else if waited >= SETTLING {
                let silent = self.stations.iter().find(|station| apart(station) == i64::MAX);
                if let Some(title) = silent.map(Station::title) {
                    let (register, tries) = (register::DC_DIFFERENCE, self.grid.cycles.min(u8::MAX.into()) as u8);
                    return self.fail(now, &title, CLOCKS, SegmentFailure::NotProcessed { register, tries });
                }
                let error_ns = worst.max(self.servo.last_ns().abs());
                let failure = SegmentFailure::Unsettled { error_ns, waited_ms: waited.as_millis() as u64 };
                self.fail(now, "master", CLOCKS, failure);
            }
            return;
        }
        let operational = AlStatus::new(AlState::Operational, false);
        match self.stations.iter().find(|station| !(station.has_status && station.status == operational)) {
            None => {
                self.events = LinkEvents::default();
                self.held = Turn::of(self.stations.iter().map(|station| &station.held));
                self.enter(now, Phase::Operational);
            }
            Some(station) if waited >= station.setup.waits.start => {
                let (is, to, waited_ms) = (station.status, AlState::Operational, waited.as_millis() as u64);
                let title = station.title();
                self.fail(now, &title, TO_OP, SegmentFailure::NotReached { is, to, waited_ms });
            }
            Some(_) => {}
        }
    }
}
