//! A CANopen node without I/O: NMT slave, error control, emergencies, SDO server and PDOs over the dictionary of a device.

mod application;
mod emergency;
mod exchange;
mod network;
mod service;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::time::Duration;

pub use application::Application;
use emergency::Emergencies;

use super::communication::{HEARTBEAT_PRODUCERS, MAX_PDOS, is_place};
use super::guarding::LifeGuard;
use super::lss::{LssAddress, LssSlave};
use super::nmt::{self, HeartbeatChange, HeartbeatConsumer, HeartbeatEvent};
use super::pdo::{self, NO_ID, Pdo, Rpdo, Tpdo};
use super::sdo::SdoServer;
use super::{CanopenError, EmcyCode, ErrorRegister, Frame, NmtCommand, NmtState, NodeId, Outbox, cob};
use crate::objects::{Address, ObjectDictionary, Reset};
use crate::time::Time;

/// PDOs of each direction that every device has places for.
const PDOS: usize = MAX_PDOS as usize;

/// Returns the places of PDOs: the first ones, and those of other axes that are declared.
fn places(od: &ObjectDictionary) -> Vec<u8> {
    let is_declared = |place: &u8| {
        let place = u16::from(*place);
        [0x1400, 0x1800].iter().any(|base| od.data_type(Address::new(base + place, 1)).is_some())
    };
    let others = (MAX_PDOS..=u8::MAX).filter(|place| is_place(*place)).filter(is_declared);
    (0..MAX_PDOS).chain(others).collect()
}

/// First vendor byte of emergency 8130h when it was life guarding: no node id.
const LIFE_GUARDING: u8 = 0;

/// Time without SYNC after which a device that is not Operational takes it that no process data run on the bus.
const SYNC_REST: Duration = Duration::from_secs(1);

/// Default time for which the SDO server waits for a client.
const SDO_TIMEOUT: Duration = Duration::from_secs(1);

/// A CANopen device (NMT slave).
///
/// Every method takes the time; frames to send go to an [`Outbox`]. Call [`Node::boot`] once, [`Node::on_frame`] for
/// each frame on the bus and [`Node::poll`] no later than [`Node::next_deadline`]. No frame makes it panic.
#[derive(Clone, Debug)]
pub struct Node {
    id: NodeId,
    state: NmtState,
    sync_id: u16,
    has_sync_counter: bool,
    sync_window: Duration,
    /// End of the synchronous window of this cycle.
    window_until: Time,
    /// Until then process data are taken to run for the last SYNC alone.
    synced_until: Time,
    time_id: u16,
    /// Places of its PDOs among all that a device may have, counted from 0.
    places: Vec<u8>,
    rpdo_ids: Vec<u16>,
    rpdos: Vec<Rpdo>,
    tpdos: Vec<Tpdo>,
    sdo: SdoServer,
    emergencies: Emergencies,
    heartbeats: HeartbeatConsumer,
    heartbeat_period: Duration,
    heartbeat_at: Time,
    life_guard: LifeGuard,
    lss: LssSlave,
    is_powered: bool,
    /// Time from a reset to the boot-up message.
    reset_time: Duration,
    /// Time at which it is sent.
    starts_at: Time,
    /// Time from an SDO request to what answers it.
    sdo_time: Duration,
    /// Time from a request to what answers it, of objects that take longer to write.
    write_times: Vec<(Address, Duration)>,
    /// Objects that are sent with another length than that of their type, bytes.
    sent_lengths: Vec<(Address, usize)>,
    /// Answers that wait for their time.
    answers: VecDeque<(Time, Frame)>,
    next: Time,
}

impl Node {
    /// Returns the node of a device whose dictionary contains a [`CommunicationProfile`](super::CommunicationProfile); it is silent
    /// until [`Node::boot`]. The dictionary that methods are given later has to be this one.
    ///
    /// # Errors
    /// [`CanopenError::Dictionary`] for a missing communication object,
    /// [`CanopenError::NotMappable`], [`CanopenError::PdoBits`], [`CanopenError::CobId`] or
    /// [`CanopenError::TransmissionType`] for bad default PDOs.
    pub fn new(id: NodeId, od: &ObjectDictionary) -> Result<Self, CanopenError> {
        let places = places(od);
        for place in places.iter().copied() {
            pdo::verify(od, Pdo::Receive(place))?;
            pdo::verify(od, Pdo::Transmit(place))?;
        }
        od.handle::<u32>(0x1005, 0)?;
        od.handle::<u32>(0x1007, 0)?;
        od.handle::<u16>(0x100c, 0)?;
        od.handle::<u8>(0x100d, 0)?;
        od.handle::<u32>(0x1012, 0)?;
        od.handle::<u8>(0x1019, 0)?;
        od.handle::<u16>(0x1017, 0)?;
        od.handle::<u8>(0x1029, 1)?;
        let identity = |sub| od.raw(0x1018, sub) as u32;
        let address = LssAddress {
            vendor_id: identity(1),
            product_code: identity(2),
            revision: identity(3),
            serial: identity(4),
        };
        let mut node = Node {
            id,
            state: NmtState::Initialising,
            sync_id: NO_ID,
            has_sync_counter: false,
            sync_window: Duration::ZERO,
            window_until: Time::NEVER,
            synced_until: Time(0),
            time_id: NO_ID,
            rpdo_ids: vec![NO_ID; places.len()],
            rpdos: places.iter().map(|place| Rpdo::new(od, *place)).collect(),
            tpdos: places.iter().map(|place| Tpdo::new(od, *place)).collect(),
            places,
            sdo: SdoServer::new(od.longest(), SDO_TIMEOUT),
            emergencies: Emergencies::new(od)?,
            heartbeats: HeartbeatConsumer::new(),
            heartbeat_period: Duration::ZERO,
            heartbeat_at: Time::NEVER,
            life_guard: LifeGuard::new(),
            lss: LssSlave::new(address, Some(id)),
            is_powered: false,
            reset_time: Duration::ZERO,
            starts_at: Time::NEVER,
            sdo_time: Duration::ZERO,
            write_times: Vec::new(),
            sent_lengths: Vec::new(),
            answers: VecDeque::new(),
            next: Time::NEVER,
        };
        node.reload(Time::default(), od);
        Ok(node)
    }

    /// Makes it a device as delivered without a node id: from the next [`Node::boot`] on it answers LSS alone, until LSS
    /// has given it one. Identifiers that follow the node id are moved with it.
    pub fn forget_node_id(&mut self) {
        self.lss.forget_node_id();
    }

    /// Returns the index of the PDO of this place among its PDOs.
    fn at(&self, place: u8) -> Option<usize> {
        self.places.iter().position(|known| *known == place)
    }

    /// Returns the node id; of a device without one, that for which its dictionary was built.
    pub fn id(&self) -> NodeId {
        self.id
    }

    /// Returns the NMT state; Initialising before [`Node::boot`].
    pub fn state(&self) -> NmtState {
        self.state
    }

    /// Takes over all communication objects (1000h to 1FFFh); timers and SYNC counts start anew. Call it after the device itself
    /// has changed any.
    pub fn reload(&mut self, now: Time, od: &ObjectDictionary) {
        for index in [0x1005, 0x1007, 0x100c, 0x1012, 0x1014, 0x1016, 0x1017, 0x1019] {
            self.take_over(now, index, od);
        }
        for at in 0..self.places.len() {
            let place = self.places.get(at).copied().map_or(0, u16::from);
            self.take_over(now, 0x1400 + place, od);
            self.take_over(now, 0x1800 + place, od);
        }
    }

    /// Sets how long the SDO server waits for the next request of a transfer before it aborts; 1 s unless set. In a block
    /// transfer it waits four times as long, and repeats an acknowledgement after half the time.
    pub fn set_sdo_timeout(&mut self, timeout: Duration) {
        self.sdo.set_timeout(timeout);
    }

    /// Sets the time from a reset to the boot-up message, in which the device is deaf and silent; zero unless set.
    pub fn set_reset_time(&mut self, time: Duration) {
        self.reset_time = time;
    }

    /// Sets the answer time of the SDO server; zero unless set.
    pub fn set_sdo_time(&mut self, time: Duration) {
        self.sdo_time = time;
    }

    /// Sets the time of the SDO server to answer a write of one object, whatever its time for others.
    pub fn set_sdo_write_time(&mut self, at: Address, time: Duration) {
        self.write_times.retain(|(known, _)| *known != at);
        self.write_times.push((at, time));
    }

    /// Makes the SDO server send every value in segments, also values of 4 bytes and less, and refuse blocks (05040001h).
    pub fn set_sdo_segments_only(&mut self, is_so: bool) {
        self.sdo.set_segments_only(is_so);
    }

    /// Makes the SDO server send an object with `bytes` bytes (1 to 8, clamped) whatever its type. Additional bytes repeat the sign of the
    /// value or are zero; missing bytes are cut off. A write still has the length of the type.
    pub fn set_sdo_length(&mut self, at: Address, bytes: usize) {
        self.sent_lengths.retain(|(known, _)| *known != at);
        self.sent_lengths.push((at, bytes.clamp(1, 8)));
    }

    /// Sets how many segments of a block download the SDO server requests at a time (1 to 127, clamped; 127 unless set). Also sets the time
    /// between two segments that it sends while process data run (250 us unless set; zero sends a whole block at once). Process data run in
    /// Operational, and for 1 s after each SYNC. Otherwise the server sends a block as fast as the outbox takes it ([`Outbox::offer`]).
    pub fn set_sdo_block(&mut self, block_size: u8, segment_interval: Duration) {
        self.sdo.set_block(block_size, segment_interval);
    }

    /// Powers the device on. All values return to those that were stored (1010h) or that the dictionary was built with. The device sends
    /// its boot-up message, then it is Pre-operational. A reset command does the same. A device without a node id stays silent.
    pub fn boot(&mut self, now: Time, app: &mut impl Application, out: &mut impl Outbox) {
        self.is_powered = true;
        self.lss.power_on();
        self.reset(now, Reset::Node, app, out);
    }

    /// Takes one frame from the bus; returns whether the node reads it. A frame that the node does not read changes nothing.
    ///
    /// Real-time: yes, for PDOs, SYNC and heartbeats.
    #[inline]
    pub fn on_frame(&mut self, now: Time, frame: &Frame, app: &mut impl Application, out: &mut impl Outbox) -> bool {
        let id = frame.id();
        if frame.is_remote() {
            self.on_remote(now, id, app, out);
        } else if id == self.sync_id {
            self.on_sync(now, frame, app, out);
        } else if let Some(place) = self.rpdo_ids.iter().position(|&rpdo_id| rpdo_id == id) {
            self.on_rpdo(now, place, frame, app, out);
        } else if id == cob::sdo_request(self.id) {
            self.on_sdo(now, frame, app, out);
        } else if id == cob::NMT {
            self.on_command(now, frame, app, out);
        } else if id == self.time_id {
            self.on_time(now, frame, app);
        } else if id == cob::LSS_REQUEST {
            self.on_lss(now, frame, app, out);
        } else if id > 0x700 {
            self.on_heartbeat(now, frame, app, out);
        } else {
            return false;
        }
        true
    }

    /// Does what is due: heartbeat, heartbeat watch, RPDO and TPDO event timers, SDO timeout.
    ///
    /// Real-time: yes.
    #[inline]
    pub fn poll(&mut self, now: Time, app: &mut impl Application, out: &mut impl Outbox) {
        if now >= self.next {
            self.do_what_is_due(now, app, out);
        }
    }

    /// Returns the time of the next poll: possibly earlier than the next action is due, never later. After a poll it lies in the future.
    pub fn next_deadline(&self) -> Time {
        self.next
    }

    /// Asks for event-driven TPDO `number` (type 254 or 255) now, or as soon as its inhibit time has passed, and for a
    /// TPDO of type 0 at the next SYNC. Does nothing outside Operational.
    ///
    /// Real-time: yes.
    pub fn trigger_tpdo(&mut self, now: Time, number: u8, od: &ObjectDictionary, out: &mut impl Outbox) {
        let Some(tpdo) = self.at(number.wrapping_sub(1)).and_then(|at| self.tpdos.get_mut(at)) else { return };
        if self.state != NmtState::Operational {
            return;
        }
        tpdo.trigger();
        if let Some(frame) = tpdo.poll(now, od) {
            out.push(frame);
        }
        self.next = self.next.min(tpdo.deadline());
    }

    /// Reports an error: sets `bits` in 1001h (and the generic bit), enters 1003h and, unless stopped, sends the
    /// emergency message. An error that is active (same code and same first vendor byte) is not reported again.
    ///
    /// Real-time: yes.
    pub fn raise_emergency(
        &mut self,
        od: &mut ObjectDictionary,
        code: EmcyCode,
        bits: ErrorRegister,
        vendor: [u8; 5],
        out: &mut impl Outbox,
    ) {
        let message = self.emergencies.raise(od, code, bits, vendor);
        self.send_emergency(message, out);
    }

    /// Reports that all errors with `code` have gone: recomputes 1001h and sends an emergency message 0000h; nothing
    /// if there were none.
    ///
    /// Real-time: yes.
    pub fn clear_emergency(&mut self, od: &mut ObjectDictionary, code: EmcyCode, out: &mut impl Outbox) {
        let message = self.emergencies.clear_code(od, code);
        self.send_emergency(message, out);
    }

    /// Reports that all errors have gone; nothing if there were none.
    ///
    /// Real-time: yes.
    pub fn clear_all_emergencies(&mut self, od: &mut ObjectDictionary, out: &mut impl Outbox) {
        let message = self.emergencies.clear_all(od);
        self.send_emergency(message, out);
    }

    fn send_emergency(&self, message: Option<Frame>, out: &mut impl Outbox) {
        if let (Some(message), NmtState::PreOperational | NmtState::Operational) = (message, self.state) {
            out.push(message);
        }
    }

    fn on_command(&mut self, now: Time, frame: &Frame, app: &mut impl Application, out: &mut impl Outbox) {
        let Some((command, addressee)) = nmt::decode_command(frame) else { return };
        if self.state == NmtState::Initialising || addressee.is_some_and(|node| node != self.id) {
            return;
        }
        match command {
            NmtCommand::StartRemoteNode => self.enter(now, NmtState::Operational, app),
            NmtCommand::StopRemoteNode => self.enter(now, NmtState::Stopped, app),
            NmtCommand::EnterPreOperational => self.enter(now, NmtState::PreOperational, app),
            NmtCommand::ResetNode => self.reset(now, Reset::Node, app, out),
            NmtCommand::ResetCommunication => self.reset(now, Reset::Communication, app, out),
        }
    }

    fn reset(&mut self, now: Time, reset: Reset, app: &mut impl Application, out: &mut impl Outbox) {
        self.state = NmtState::Initialising;
        let last = if reset == Reset::Node { u16::MAX } else { 0x1fff };
        app.od_mut().restore_power_on_values(0, last);
        self.sdo.reset();
        self.emergencies.reset();
        self.answers.clear();
        self.window_until = Time::NEVER;
        self.starts_at = Time::NEVER;
        let Some(id) = self.lss.activate() else {
            self.next = Time::NEVER;
            return;
        };
        self.take_node_id(id, app.od_mut());
        app.reset(now, reset);
        self.reload(now, app.od());
        if self.reset_time.is_zero() {
            return self.announce(now, app, out);
        }
        self.starts_at = now + self.reset_time;
        self.next = self.starts_at;
    }

    fn announce(&mut self, now: Time, app: &mut impl Application, out: &mut impl Outbox) {
        self.starts_at = Time::NEVER;
        out.push(nmt::heartbeat(self.id, NmtState::Initialising));
        self.enter(now, NmtState::PreOperational, app);
    }

    fn enter(&mut self, now: Time, state: NmtState, app: &mut impl Application) {
        if state == self.state {
            return;
        }
        self.state = state;
        if state == NmtState::Stopped {
            self.sdo.reset();
        }
        self.rpdos.iter_mut().for_each(Rpdo::stop);
        for tpdo in &mut self.tpdos {
            if state == NmtState::Operational { tpdo.start(now) } else { tpdo.stop() }
        }
        self.next = self.earliest();
        app.on_nmt(now, state);
    }

    fn on_heartbeat(&mut self, now: Time, frame: &Frame, app: &mut impl Application, out: &mut impl Outbox) {
        if self.state == NmtState::Initialising {
            return;
        }
        let event = self.heartbeats.on_frame(now, frame);
        self.next = self.next.min(self.heartbeats.next_deadline());
        if let Some(event) = event {
            self.take_heartbeat_event(now, event, app, out);
        }
    }

    fn take_heartbeat_event(
        &mut self,
        now: Time,
        event: HeartbeatEvent,
        app: &mut impl Application,
        out: &mut impl Outbox,
    ) {
        let source = event.node.raw();
        match event.change {
            HeartbeatChange::Lost => {
                self.lose_partner(now, source, app, out);
            }
            HeartbeatChange::Present(_) => {
                let message = self.emergencies.clear_one(app.od_mut(), EmcyCode::HEARTBEAT, source);
                self.send_emergency(message, out);
            }
            HeartbeatChange::BootUp | HeartbeatChange::State(_) => {}
        }
        app.on_heartbeat_event(now, event);
    }

    /// Sends emergency 8130h and the error behaviour of a lost heartbeat or life guarding.
    fn lose_partner(&mut self, now: Time, source: u8, app: &mut impl Application, out: &mut impl Outbox) {
        let bits = ErrorRegister(ErrorRegister::COMMUNICATION);
        self.raise_emergency(app.od_mut(), EmcyCode::HEARTBEAT, bits, [source, 0, 0, 0, 0], out);
        // 1029h:1 of CiA 301: 0 leaves Operational, 1 changes nothing, 2 stops.
        match (app.od().raw(0x1029, 1), self.state) {
            (0, NmtState::Operational) => self.enter(now, NmtState::PreOperational, app),
            (2, _) => self.enter(now, NmtState::Stopped, app),
            _ => {}
        }
    }

    fn do_what_is_due(&mut self, now: Time, app: &mut impl Application, out: &mut impl Outbox) {
        if self.state == NmtState::Initialising {
            if now >= self.starts_at {
                self.announce(now, app, out);
            }
            return;
        }
        if now >= self.heartbeat_at {
            out.push(nmt::heartbeat(self.id, self.state));
            let on_grid = self.heartbeat_at + self.heartbeat_period;
            self.heartbeat_at = if on_grid > now { on_grid } else { now + self.heartbeat_period };
        }
        for _ in 0..HEARTBEAT_PRODUCERS {
            let Some(event) = self.heartbeats.poll(now) else { break };
            self.take_heartbeat_event(now, event, app, out);
        }
        if self.life_guard.is_late(now) {
            self.lose_partner(now, LIFE_GUARDING, app, out);
            app.on_life_guarding(now, true);
        }
        self.poll_pdos(now, app, out);
        self.poll_sdo(now, out);
        self.next = self.earliest();
    }

    /// Takes over a communication object after it was written.
    fn take_over(&mut self, now: Time, index: u16, od: &ObjectDictionary) {
        match index {
            0x1005 => self.sync_id = (od.raw(0x1005, 0) & 0x7ff) as u16,
            0x1007 => self.sync_window = Duration::from_micros(od.raw(0x1007, 0)),
            0x1019 => self.has_sync_counter = od.raw(0x1019, 0) != 0,
            0x100c | 0x100d => {
                let guard_time = Duration::from_millis(od.raw(0x100c, 0));
                self.life_guard.configure(guard_time, od.raw(0x100d, 0) as u8);
            }
            0x1012 => {
                let cob_id = od.raw(0x1012, 0) as u32;
                self.time_id = if cob_id & cob::INVALID == 0 { NO_ID } else { (cob_id & 0x7ff) as u16 };
            }
            0x1014 => self.emergencies.reload(od),
            0x1016 => self.watch_heartbeats(od),
            0x1017 => {
                self.heartbeat_period = Duration::from_millis(od.raw(0x1017, 0));
                let is_off = self.heartbeat_period.is_zero();
                self.heartbeat_at = if is_off { Time::NEVER } else { now + self.heartbeat_period };
            }
            _ => self.take_over_pdo(now, index, od),
        }
        self.next = self.earliest();
    }

    fn watch_heartbeats(&mut self, od: &ObjectDictionary) {
        self.heartbeats.clear();
        for sub in 1..=HEARTBEAT_PRODUCERS {
            let entry = od.raw(0x1016, sub);
            if let Ok(node) = NodeId::new((entry >> 16) as u8) {
                self.heartbeats.watch(node, Duration::from_millis(entry & 0xffff));
            }
        }
    }

    fn earliest(&self) -> Time {
        if self.state == NmtState::Initialising {
            return self.starts_at;
        }
        let answer = self.answers.front().map_or(Time::NEVER, |(time, _)| *time);
        let control = self.heartbeat_at.min(self.heartbeats.next_deadline()).min(self.life_guard.deadline());
        let others = control.min(self.sdo.next_deadline()).min(answer);
        let rpdos = self.rpdos.iter().map(Rpdo::deadline).fold(Time::NEVER, Time::min);
        self.tpdos.iter().map(Tpdo::deadline).fold(others.min(rpdos), Time::min)
    }
}
