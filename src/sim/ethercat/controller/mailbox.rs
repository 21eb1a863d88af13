//! The mailbox of a device: requests one at a time, answers that can be repeated, emergencies.

use super::super::application::EthercatApplication;
use super::guarded::Guarded;
use super::{Controller, Information, MAILBOX_IN, MAILBOX_OUT, Manner};
use std::time::Duration;
use yieldwall_fieldbus::ethercat::mailbox::{self, Counter, MailboxError, Protocol};
use yieldwall_fieldbus::ethercat::{AlState, SyncManager, coe::CoeEmergency, coe::CoeServer, u16_at};
use yieldwall_fieldbus::time::Time;

/// Emergencies that wait for the mailbox; more are lost.
const EMERGENCIES: usize = 8;

/// One mailbox message that was given out.
#[derive(Clone, Debug)]
struct Given {
    bytes: Vec<u8>,
}

impl Given {
    fn new() -> Self {
        Given { bytes: Vec::with_capacity(mailbox::LONGEST) }
    }

    fn set(&mut self, bytes: &[u8]) {
        self.bytes.clear();
        self.bytes.extend_from_slice(bytes.get(..mailbox::LONGEST).unwrap_or(bytes));
    }
}

/// State of the device's mailbox.
#[derive(Clone, Debug)]
pub(super) struct Mailbox {
    server: CoeServer,
    counter: Counter,
    /// The counter of the last request; 0 for none.
    last_request: u8,
    /// When the request that lies there is taken.
    due: Time,
    /// It could be taken, but its answer has no room.
    is_waiting: bool,
    time: Duration,
    /// The message that lies in the mailbox or was read last, and the one before.
    current: Given,
    previous: Given,
    /// The message before was asked for once more and lies there in place of the current one.
    owes_current: bool,
    request: Vec<u8>,
    answer: Vec<u8>,
    emergencies: [Option<CoeEmergency>; EMERGENCIES],
    /// Comes before the answer to the next request.
    pub(super) interruption: Option<CoeEmergency>,
    is_stuck: bool,
    manner: Manner,
}

impl Mailbox {
    pub(super) fn new(server: CoeServer, time: Duration, manner: Manner) -> Self {
        Mailbox {
            server,
            counter: Counter::FIRST,
            last_request: 0,
            due: Time::NEVER,
            is_waiting: false,
            time,
            current: Given::new(),
            previous: Given::new(),
            owes_current: false,
            request: Vec::with_capacity(mailbox::LONGEST),
            answer: vec![0; mailbox::LONGEST],
            emergencies: [None; EMERGENCIES],
            interruption: None,
            is_stuck: false,
            manner,
        }
    }

    /// As after power-on.
    pub(super) fn reset(&mut self) {
        self.server.reset();
        (self.counter, self.last_request, self.due) = (Counter::FIRST, 0, Time::NEVER);
        self.is_waiting = false;
        self.current.bytes.clear();
        self.previous.bytes.clear();
        self.owes_current = false;
        (self.emergencies, self.interruption) = ([None; EMERGENCIES], None);
    }

    pub(super) fn due(&self) -> Time {
        if self.is_stuck { Time::NEVER } else { self.due }
    }

    pub(super) fn set_time(&mut self, time: Duration) {
        self.time = time;
    }

    pub(super) fn set_stuck(&mut self, is_stuck: bool) {
        self.is_stuck = is_stuck;
    }

    /// A request is taken as soon as its answer has room.
    pub(super) fn wait(&mut self) {
        (self.is_waiting, self.due) = (self.due != Time::NEVER, Time::NEVER);
    }

    /// A request has come.
    pub(super) fn expect(&mut self, now: Time) {
        if !self.is_waiting && self.due == Time::NEVER {
            self.due = now + self.time;
        }
    }

    pub(super) fn queue(&mut self, emergency: CoeEmergency) {
        if let Some(room) = self.emergencies.iter_mut().find(|room| room.is_none()) {
            *room = Some(emergency);
        }
    }

    fn next_emergency(&mut self) -> Option<CoeEmergency> {
        let first = self.emergencies[0].take();
        self.emergencies.rotate_left(1);
        first
    }

    /// The answer to a request that lies in `request`, in `answer`: its bytes, 0 for none. `room` bytes fit the mailbox.
    fn serve<D: EthercatApplication>(&mut self, device: &mut D, state: AlState, room: usize) -> usize {
        let Mailbox { server, request, answer, manner, .. } = self;
        let answer = answer.get_mut(..room).unwrap_or_default();
        let Some((header, message)) = answer.split_first_chunk_mut::<{ mailbox::HEADER }>() else { return 0 };
        let _ = header;
        let served = match mailbox::decode(request) {
            Err(_) => Err(MailboxError::INVALID_SIZE),
            Ok((header, _)) if header.counter != 0 && header.counter == self.last_request => return 0,
            Ok((header, body)) => {
                self.last_request = header.counter;
                match Protocol::from_number(header.protocol) {
                    Some(Protocol::Coe) if u16_at(body, 0) >> 12 == INFORMATION => match manner.information {
                        Information::Answered => server.on_message(body, &mut Guarded { device, state }, message),
                        Information::Unanswered => Ok(0),
                        Information::Aborted => Ok(abort(message)),
                        Information::MailboxError => Err(MailboxError::SERVICE_NOT_SUPPORTED),
                    },
                    Some(Protocol::Coe) => server.on_message(body, &mut Guarded { device, state }, message),
                    _ => Err(MailboxError::UNSUPPORTED_PROTOCOL),
                }
            }
        };
        match served {
            Ok(0) => 0,
            Ok(len) => mailbox::seal(answer, Protocol::Coe, self.counter.take(), len),
            Err(error) => {
                let bytes = error.encode();
                let Some(to) = message.get_mut(..bytes.len()) else { return 0 };
                to.copy_from_slice(&bytes);
                mailbox::seal(answer, Protocol::Error, self.counter.take(), bytes.len())
            }
        }
    }
}

/// Service of CoE: SDO information.
const INFORMATION: u16 = 8;

/// An SDO abort (05040001h) of no object; its bytes, 0 without room.
fn abort(message: &mut [u8]) -> usize {
    const ABORT: [u8; 10] = [0, 0x20, 0x80, 0, 0, 0, 0x01, 0x00, 0x04, 0x05];
    let Some(to) = message.first_chunk_mut() else { return 0 };
    *to = ABORT;
    ABORT.len()
}

impl<D: EthercatApplication> Controller<D> {
    /// Takes a request that is due, and puts the next message where the master reads it.
    pub(super) fn poll_mailbox(&mut self, now: Time) {
        let has_mailbox = !matches!(self.al_state(), AlState::Init | AlState::Bootstrap);
        if !has_mailbox || self.mailbox.is_stuck {
            return;
        }
        self.answer_repeat();
        while let Some(emergency) = self.device.take_emergency() {
            self.mailbox.queue(emergency);
        }
        let outbox = &self.managers[MAILBOX_IN];
        if outbox.is_full || !outbox.is_active() {
            return;
        }
        let room = usize::from(outbox.settings.len).min(mailbox::LONGEST);
        if self.mailbox.owes_current {
            self.mailbox.owes_current = false;
            self.put(false);
            return;
        }
        let is_asked = (self.mailbox.is_waiting || now >= self.mailbox.due) && self.managers[MAILBOX_OUT].is_full;
        if is_asked && let Some(emergency) = self.mailbox.interruption.take() {
            self.mailbox.queue(emergency);
        }
        let sent = if let Some(emergency) = self.mailbox.next_emergency() {
            let answer = self.mailbox.answer.get_mut(..room).unwrap_or_default();
            let len = emergency.encode(answer.get_mut(mailbox::HEADER..).unwrap_or_default());
            let counter = self.mailbox.counter.take();
            if len == 0 { 0 } else { mailbox::seal(answer, Protocol::Coe, counter, len) }
        } else if self.mailbox.server.has_more() {
            let answer = self.mailbox.answer.get_mut(..room).unwrap_or_default();
            let len = self.mailbox.server.poll(answer.get_mut(mailbox::HEADER..).unwrap_or_default());
            if len == 0 { 0 } else { mailbox::seal(answer, Protocol::Coe, self.mailbox.counter.take(), len) }
        } else if is_asked {
            self.take_request();
            let state = self.al_state();
            self.mailbox.serve(&mut self.device, state, room)
        } else {
            0
        };
        if sent > 0 {
            if let (Some(counter), Some(byte)) = (self.mailbox.manner.mailbox_counter, self.mailbox.answer.get_mut(5)) {
                *byte = *byte & 0x0f | counter << 4;
            }
            std::mem::swap(&mut self.mailbox.previous, &mut self.mailbox.current);
            let bytes = self.mailbox.answer.get(..sent).unwrap_or_default();
            self.mailbox.current.set(bytes);
            self.put(false);
        }
    }

    fn take_request(&mut self) {
        let range = self.managers[MAILBOX_OUT].seen();
        self.mailbox.request.clear();
        let bytes = self.memory.get(range).unwrap_or_default();
        self.mailbox.request.extend_from_slice(bytes.get(..mailbox::LONGEST).unwrap_or(bytes));
        self.managers[MAILBOX_OUT].is_full = false;
        (self.mailbox.due, self.mailbox.is_waiting) = (Time::NEVER, false);
        self.show_manager(MAILBOX_OUT);
    }

    /// Puts the current message, or the one before, into the mailbox.
    fn put(&mut self, is_previous: bool) {
        let message = if is_previous { &self.mailbox.previous } else { &self.mailbox.current };
        let range = self.managers[MAILBOX_IN].device_write();
        if let Some(to) = self.memory.get_mut(range) {
            to.iter_mut().zip(&message.bytes).for_each(|(to, from)| *to = *from);
        }
        self.managers[MAILBOX_IN].device_done();
        self.show_manager(MAILBOX_IN);
    }

    /// A master that has lost a message asks for it once more. The last message that was read is it; one that lies there unread comes
    /// after it.
    fn answer_repeat(&mut self) {
        let manager = &self.managers[MAILBOX_IN];
        if manager.settings.repeat == manager.repeat_answered || !manager.is_active() {
            return;
        }
        let is_unread = manager.is_full && !self.mailbox.owes_current;
        let lost = if is_unread { &self.mailbox.previous } else { &self.mailbox.current };
        if !lost.bytes.is_empty() {
            self.mailbox.owes_current = is_unread;
            self.put(is_unread);
        }
        let repeat = self.managers[MAILBOX_IN].settings.repeat;
        self.managers[MAILBOX_IN].repeat_answered = repeat;
        self.show_manager(MAILBOX_IN);
    }

    /// Empties the mailbox of the master and forgets what was asked, as at the start of PRE-OP.
    pub(super) fn start_mailbox(&mut self) {
        self.mailbox.reset();
        for place in [MAILBOX_OUT, MAILBOX_IN] {
            self.managers[place].repeat_answered = self.managers[place].settings.repeat;
            self.managers[place].empty();
            self.show_manager(place);
        }
    }

    /// Whether sync managers 0 and 1 are as the SII wants them: at its addresses, and no longer than it allows.
    pub(super) fn has_mailbox(&self) -> bool {
        let is_good = |place: usize, is_written: bool, start: u16, most: u16| {
            let manager = &self.managers[place];
            let SyncManager { start: is, len, .. } = manager.settings;
            let kind = manager.settings.control & 0x0f;
            let wanted = SyncManager::MAILBOX | if is_written { SyncManager::WRITE } else { 0 };
            let fits = (mailbox::SHORTEST..=usize::from(most)).contains(&usize::from(len));
            manager.settings.is_enabled && kind == wanted && is == start && fits
        };
        is_good(MAILBOX_OUT, true, self.areas[0].start, self.areas[0].len)
            && is_good(MAILBOX_IN, false, self.areas[1].start, self.areas[1].len)
    }
}
