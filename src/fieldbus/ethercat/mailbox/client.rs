//! The mailbox of one device, as the master uses it: one datagram at a time, whatever frames are lost.
//!
//! ```text
//! Rest --message--> Write --> Rest (looks until an answer is there) --> Read --> Rest
//!                                                                        | reply lost
//!                                                                        v
//!                                              Repeat --> Repeated --> Read
//! ```
//! A message whose reply is lost is written once more with the same counter, so that the device recognises it. If the frame with an answer
//! is lost, the master requests the answer again by the repeat bit of sync manager 1.
//!
//! Both repeats can deliver a message twice. A device counts its messages from 1 to 7, so that the counter shows a repeated message; 0 is
//! no counter. Some devices do not count, and send the same number for ever. So the client drops a message only after a loss, if it has
//! counter and bytes of the one before. If an answer is lost that way, the client requests it anew. No message is taken for the answer to
//! another request.

use super::{Counter, HEADER, MailboxError, Protocol, SHORTEST, decode, seal};
use crate::ethercat::coe::{CoeAnswer, CoeClient, CoeEmergency, CoeEvent, CoeRequest, ListKind};
use crate::ethercat::frame::{Ask, Command, address};
use crate::ethercat::registers as register;
use crate::ethercat::sii::MailboxArea;
use crate::ethercat::{EthercatError, SyncManager};
use crate::objects::{AbortCode, ObjectAnswer, ObjectError, ObjectRequest};
use crate::time::Time;
use std::time::Duration;

/// Registers of sync manager 1, which holds the device's messages.
const STATUS: u16 = register::SYNC_MANAGER + (SyncManager::SIZE + SyncManager::STATUS) as u16;
const ACTIVATE: u16 = register::SYNC_MANAGER + (SyncManager::SIZE + SyncManager::ACTIVATE) as u16;
/// Time between two polls for an answer, or for an unsolicited message of the device.
const LOOK_FOR_ANSWER: Duration = Duration::from_micros(200);
const LOOK_FOR_EMERGENCY: Duration = Duration::from_millis(20);
/// Most bytes of a value that is read or written.
const MOST_VALUE: usize = 4096;
/// Looks for a repeated message before the device is taken for one that cannot repeat.
const REPEATED_LOOKS: u8 = 100;
/// Messages after a loss among which one may come twice: the answer to what was written twice, and what follows it.
const IN_DOUBT: u8 = 2;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    /// No transfer is running.
    Rest,
    /// A message is to be written.
    Write,
    /// A message is to be read.
    Read,
    /// The last message is asked for once more.
    Repeat,
    /// It has to be there again.
    Repeated { looks: u8 },
}

/// The mailbox of one device and the client of its objects.
#[derive(Clone, Debug)]
pub struct MailboxClient {
    /// Station address or position, and the commands that read and write there.
    station: u16,
    commands: [Command; 2],
    to_device: MailboxArea,
    from_device: MailboxArea,
    client: CoeClient,
    counter: Counter,
    /// The last message of the device, with its header.
    heard: Vec<u8>,
    /// Number of next messages that may repeat the one before.
    in_doubt: u8,
    outgoing: Vec<u8>,
    step: Step,
    /// The message that is being written may be there already.
    is_retry: bool,
    /// Time at which a message that the device did not take is written again.
    write_at: Option<Time>,
    /// Last value of the repeat bit.
    repeat: bool,
    look_at: Time,
    /// Reason why the device refused the last message, if it did.
    refused: Option<MailboxError>,
    /// Messages that nobody waited for.
    pub unexpected: u32,
}

impl MailboxClient {
    /// Returns the mailbox of a station, whose answers may take so long.
    pub fn new(station: u16, timeout: Duration) -> Self {
        MailboxClient {
            station,
            commands: [Command::Fprd, Command::Fpwr],
            to_device: MailboxArea::default(),
            from_device: MailboxArea::default(),
            client: CoeClient::within(MOST_VALUE, timeout),
            counter: Counter::FIRST,
            heard: Vec::new(),
            in_doubt: 0,
            outgoing: Vec::new(),
            step: Step::Rest,
            is_retry: false,
            write_at: None,
            repeat: false,
            look_at: Time(0),
            refused: None,
            unexpected: 0,
        }
    }

    /// Creates the mailbox of the device at a position, 0 at the master.
    pub fn at_position(position: u16, timeout: Duration) -> Self {
        let commands = [Command::Aprd, Command::Apwr];
        Self { commands, ..Self::new(0u16.wrapping_sub(position), timeout) }
    }

    /// Starts again with a device that has just reached PRE-OP, with the mailboxes of its SII.
    pub fn start(&mut self, to_device: MailboxArea, from_device: MailboxArea) {
        self.start_with(to_device, from_device, Counter::FIRST);
    }

    /// Starts again with a device that may have received messages before; new messages begin with this counter. A device drops a message
    /// whose counter equals the counter of the last message that it received.
    pub fn start_with(&mut self, to_device: MailboxArea, from_device: MailboxArea, counter: Counter) {
        (self.to_device, self.from_device) = (to_device, from_device);
        self.client.give_up(ObjectError::NoAnswer);
        (self.counter, self.step, self.in_doubt) = (counter, Step::Rest, 0);
        // Messages are heard without allocating.
        self.heard = Vec::with_capacity(from_device.len.into());
        (self.is_retry, self.repeat, self.look_at, self.refused) = (false, false, Time(0), None);
        self.write_at = None;
        self.outgoing.clear();
        self.outgoing.resize(to_device.len.into(), 0);
    }

    /// Asks the device something.
    ///
    /// # Errors
    /// [`ObjectError::Busy`] while the last request runs, [`ObjectError::NoObjects`] without a mailbox, [`ObjectError::TooLong`] for a value of
    /// more than 4096 bytes.
    pub fn ask(&mut self, now: Time, request: ObjectRequest<'_>) -> Result<(), ObjectError> {
        let complete = false;
        self.ask_coe(
            now,
            match request {
                ObjectRequest::Read(at) => CoeRequest::Read { at, complete },
                ObjectRequest::Write(at, data) => CoeRequest::Write { at, complete, data },
            },
        )
    }

    /// Asks the device which objects it has.
    ///
    /// # Errors
    /// As [`MailboxClient::ask`].
    pub fn ask_list(&mut self, now: Time) -> Result<(), ObjectError> {
        self.ask_coe(now, CoeRequest::List(ListKind::All))
    }

    fn ask_coe(&mut self, now: Time, request: CoeRequest<'_>) -> Result<(), ObjectError> {
        if usize::from(self.to_device.len) < SHORTEST {
            return Err(ObjectError::NoObjects);
        }
        self.refused = None;
        self.client.start(now, request).map_err(|error| match error {
            EthercatError::Full { len, .. } => ObjectError::TooLong(len),
            _ => ObjectError::Busy,
        })
    }

    /// Returns the result of the last request.
    pub fn answer(&self) -> ObjectAnswer<'_> {
        match self.client.answer() {
            CoeAnswer::Idle => ObjectAnswer::NotAsked,
            CoeAnswer::Pending => ObjectAnswer::Pending,
            CoeAnswer::Value(value) => ObjectAnswer::Done(value),
            CoeAnswer::Failed(error) => ObjectAnswer::Failed(*error),
            // Of requests that are not made here.
            CoeAnswer::Written | CoeAnswer::List(_) | CoeAnswer::Object(_) | CoeAnswer::Entry(_) => {
                ObjectAnswer::Done(&[])
            }
        }
    }

    /// Returns the indices that [`MailboxClient::ask_list`] has brought.
    pub fn list(&self) -> Option<&[u16]> {
        match self.client.answer() {
            CoeAnswer::List(indices) => Some(indices),
            _ => None,
        }
    }

    /// Forgets what was asked last.
    pub fn forget(&mut self) {
        self.client.give_up(ObjectError::NoAnswer);
        self.client.forget();
    }

    /// Returns why the device refused the last message, if it did.
    pub fn refused(&self) -> Option<MailboxError> {
        self.refused
    }

    /// Whether a request runs or a message is being moved.
    pub fn is_busy(&self) -> bool {
        self.client.is_busy() || self.step != Step::Rest
    }

    /// Returns the latest time at which there is something to send; [`Time::NEVER`] without a mailbox.
    ///
    /// Real-time: yes.
    pub fn next_deadline(&self) -> Time {
        if self.outgoing.is_empty() {
            return Time::NEVER;
        }
        match self.step {
            Step::Rest => self.look_at.min(self.client.next_deadline()),
            _ => Time(0),
        }
    }

    /// Returns the next datagram, whose data it puts at the start of `buffer`; nothing while there is nothing to do.
    ///
    /// Real-time: yes.
    pub fn next(&mut self, now: Time, buffer: &mut [u8]) -> Option<Ask> {
        if self.outgoing.is_empty() {
            return None;
        }
        self.client.poll(now);
        if !self.client.is_busy() {
            self.write_at = None;
        }
        if self.step == Step::Rest && self.write_at.is_some_and(|at| now >= at) {
            (self.step, self.write_at) = (Step::Write, None);
        } else if self.step == Step::Rest && self.client.is_busy() {
            let len = self.client.message(self.outgoing.get_mut(HEADER..).unwrap_or_default());
            if len > 0 {
                let sealed = seal(&mut self.outgoing, Protocol::Coe, self.counter.take(), len);
                self.outgoing.iter_mut().skip(sealed).for_each(|byte| *byte = 0);
                (self.step, self.is_retry) = (Step::Write, false);
            }
        }
        let [read, write] = self.commands;
        let (register, len) = match self.step {
            Step::Rest if now < self.look_at => return None,
            Step::Rest | Step::Repeated { .. } => (STATUS, 3),
            // What is given up while it is written is not written any more.
            Step::Write if !self.client.is_busy() => {
                (self.step, self.look_at) = (Step::Rest, now);
                (STATUS, 3)
            }
            Step::Write => {
                let to = buffer.get_mut(..self.outgoing.len())?;
                to.copy_from_slice(&self.outgoing);
                return Some(Ask::new(write, self.at(self.to_device.start), self.outgoing.len()));
            }
            Step::Read => (self.from_device.start, self.from_device.len.into()),
            Step::Repeat => {
                *buffer.first_mut()? = 1 | u8::from(self.repeat) << 1;
                return Some(Ask::new(write, self.at(ACTIVATE), 1));
            }
        };
        buffer.get_mut(..len)?.fill(0);
        Some(Ask::new(read, self.at(register), len))
    }

    fn at(&self, register: u16) -> u32 {
        address(self.station, register)
    }

    /// Handles the loss of the last datagram's frame.
    ///
    /// Real-time: yes.
    pub fn on_loss(&mut self) {
        if self.step != Step::Rest {
            self.in_doubt = IN_DOUBT;
        }
        match self.step {
            Step::Write => self.is_retry = true,
            Step::Read => {
                self.repeat = !self.repeat;
                self.step = Step::Repeat;
            }
            Step::Rest | Step::Repeat | Step::Repeated { .. } => {}
        }
    }

    /// Takes the last datagram after its return; returns an emergency, if it has brought one.
    ///
    /// Real-time: yes.
    pub fn on_reply(&mut self, now: Time, data: &[u8], working_counter: u16) -> Option<CoeEmergency> {
        let is_processed = working_counter > 0;
        let status = data.first().copied().unwrap_or_default();
        match self.step {
            // A full mailbox takes nothing: the message is there already ...
            Step::Write if is_processed || self.is_retry => self.rest(now),
            // ... or one before it waits until the master has read what the device says.
            Step::Write => {
                self.rest(now);
                self.write_at = Some(now + LOOK_FOR_ANSWER);
            }
            Step::Rest if is_processed && status & SyncManager::FULL != 0 => self.step = Step::Read,
            Step::Rest => {
                let wait = if self.client.is_busy() { LOOK_FOR_ANSWER } else { LOOK_FOR_EMERGENCY };
                self.look_at = now + wait;
            }
            Step::Repeat if is_processed => self.step = Step::Repeated { looks: 0 },
            // It is wished again, for as long as somebody waits for an answer.
            Step::Repeat if !self.client.is_busy() => self.rest(now),
            Step::Repeat => {}
            Step::Repeated { looks } => {
                let answered = data.get(2).is_some_and(|held| held & 2 != 0) == self.repeat;
                self.step = match looks {
                    _ if is_processed && answered => Step::Read,
                    REPEATED_LOOKS.. => Step::Read,
                    _ => Step::Repeated { looks: looks + 1 },
                };
            }
            Step::Read => {
                self.rest(now);
                if is_processed {
                    return self.hear(now, data);
                }
            }
        }
        None
    }

    fn rest(&mut self, now: Time) {
        (self.step, self.look_at) = (Step::Rest, now);
    }

    /// Takes a message of the device.
    fn hear(&mut self, now: Time, data: &[u8]) -> Option<CoeEmergency> {
        let Ok((header, message)) = decode(data) else {
            self.unexpected = self.unexpected.saturating_add(1);
            return None;
        };
        let whole = data.get(..HEADER + message.len()).unwrap_or_default();
        let is_in_doubt = self.in_doubt > 0;
        self.in_doubt = self.in_doubt.saturating_sub(1);
        if is_in_doubt && header.counter != 0 && whole == self.heard {
            // The one before, once more.
            return None;
        }
        self.heard.clear();
        self.heard.extend_from_slice(whole);
        let heard = match Protocol::from_number(header.protocol) {
            Some(Protocol::Coe) => self.client.on_message(now, message),
            Some(Protocol::Error) if self.client.is_busy() => {
                self.refused = MailboxError::decode(message).or(Some(MailboxError::SYNTAX));
                self.client.give_up(ObjectError::Aborted(AbortCode::GENERAL));
                CoeEvent::Answer
            }
            _ => CoeEvent::Foreign,
        };
        match heard {
            CoeEvent::Emergency(emergency) => return Some(emergency),
            CoeEvent::Foreign => self.unexpected = self.unexpected.saturating_add(1),
            CoeEvent::Answer => {}
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects::Address;

    #[test]
    fn a_device_that_takes_no_wish_to_repeat_is_not_asked_for_ever() {
        let patience = Duration::from_millis(100);
        let mut mailbox = MailboxClient::at_position(0, patience);
        let area = |start| MailboxArea { start, len: 128 };
        mailbox.start(area(0x1000), area(0x1080));
        mailbox.ask(Time(0), ObjectRequest::Read(Address { index: 0x1018, sub: 1 })).unwrap();
        let (mut buffer, mut now, mut wishes) = ([0; 2048], Time(0), 0);
        while mailbox.is_busy() {
            assert!(now < Time(0) + 2 * patience, "{wishes}");
            if mailbox.next(now, &mut buffer).is_some() {
                let emergency = match mailbox.step {
                    // What the device says is lost on its way.
                    Step::Read => {
                        mailbox.on_loss();
                        None
                    }
                    Step::Repeat => {
                        wishes += 1;
                        mailbox.on_reply(now, &[0], 0)
                    }
                    _ => mailbox.on_reply(now, &[SyncManager::FULL, 0, 0], 1),
                };
                assert_eq!(emergency, None);
            }
            now = now + Duration::from_millis(1);
        }
        assert!(wishes > 1 && matches!(mailbox.answer(), ObjectAnswer::Failed(_)), "{wishes}");
    }

    /// Returns the answer to a read of 6041h, with a counter and a value.
    fn answer(counter: u8, value: u8) -> Vec<u8> {
        let mut bytes = vec![10, 0, 0, 0, 0, counter << 4 | 3, 0, 0x30, 0x43, 0x41, 0x60, 0, value, 0, 0, 0];
        bytes.resize(128, 0);
        bytes
    }

    /// Returns the outcome of a read from a device with these messages, one after the other. A step of this kind is lost once.
    fn read(mailbox: &mut MailboxClient, now: &mut Time, said: &[Vec<u8>], mut lost: Option<Step>) -> Option<u8> {
        mailbox.ask(*now, ObjectRequest::Read(Address { index: 0x6041, sub: 0 })).unwrap();
        let (mut buffer, mut said) = ([0; 2048], said.iter());
        while mailbox.is_busy() {
            *now = *now + Duration::from_millis(1);
            if mailbox.next(*now, &mut buffer).is_none() {
                continue;
            }
            if lost == Some(mailbox.step) {
                lost = None;
                mailbox.on_loss();
                continue;
            }
            let status = if said.len() == 0 { 0 } else { SyncManager::FULL };
            let status = [status, 0, u8::from(mailbox.repeat) << 1];
            let reply = if mailbox.step == Step::Read { said.next().unwrap() } else { &status[..] };
            assert_eq!(mailbox.on_reply(*now, reply, 1), None);
        }
        match mailbox.answer() {
            ObjectAnswer::Done(value) => value.first().copied(),
            _ => None,
        }
    }

    fn mailbox() -> (MailboxClient, Time) {
        let mut mailbox = MailboxClient::at_position(0, Duration::from_millis(100));
        let area = |start| MailboxArea { start, len: 128 };
        mailbox.start(area(0x1000), area(0x1080));
        (mailbox, Time(0))
    }

    /// Counters that a device sends for ever, and those of one that counts.
    const COUNTERS: [fn(u8) -> u8; 4] = [|_| 1, |_| 0, |count| count.min(7), |count| count % 7 + 1];

    #[test]
    fn a_device_that_does_not_count_is_heard() {
        for counter in COUNTERS {
            let (mut mailbox, mut now) = mailbox();
            for (count, value) in (1..).zip([5, 5, 6, 5, 5, 5, 5, 5, 5, 9]) {
                assert_eq!(read(&mut mailbox, &mut now, &[answer(counter(count), value)], None), Some(value));
            }
        }
    }

    #[test]
    fn a_message_that_a_repeat_brings_twice_is_taken_once() {
        for counter in COUNTERS.into_iter().filter(|counter| counter(1) != 0) {
            // The device has not seen the read that was lost, and gives the message before once more.
            let (mut mailbox, mut now) = mailbox();
            let [first, second] = [(1, 5), (2, 6)].map(|(count, value)| answer(counter(count), value));
            assert_eq!(read(&mut mailbox, &mut now, std::slice::from_ref(&first), None), Some(5));
            assert_eq!(read(&mut mailbox, &mut now, &[first.clone(), second.clone()], Some(Step::Read)), Some(6));
            // It does as it was asked by each of two writes.
            let (mut mailbox, mut now) = self::mailbox();
            assert_eq!(read(&mut mailbox, &mut now, std::slice::from_ref(&first), Some(Step::Write)), Some(5));
            assert_eq!(read(&mut mailbox, &mut now, &[first, second], None), Some(6));
        }
    }
}
