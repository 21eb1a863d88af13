//! The devices of an EtherCAT segment asked one by one, with datagrams of this program alone.
//!
//! Devices are addressed by position, so that nothing has to be written to find them, and a device that is broken is reached as far as its
//! controller answers.

mod counters;
mod objects;
mod present;
mod sii;
mod state;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use thiserror::Error;

use super::Bytes;
use yieldwall_bus::ethercat::{SegmentFailure, SegmentSign};
use yieldwall_fieldbus::ethercat::coe::CoeEmergency;
use yieldwall_fieldbus::ethercat::frame::{self, Command, FrameWriter, address, answers};
use yieldwall_fieldbus::ethercat::mailbox::MailboxClient;
use yieldwall_fieldbus::ethercat::{AlStatus, AlStatusCode, array, registers as register, u16_at};
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{EthernetLink, EthernetReceived, SendError};

pub use counters::{ClockFacts, Counters, PortCounters};
pub use objects::DeviceObjects;
pub use present::Present;

/// Devices that are asked at most, as many as a rig's master takes.
const MOST_DEVICES: u16 = 64;
/// Time after which a frame is given up. Frames go round in microseconds; what takes time is a computer that does not look.
const FRAME_WAIT: Duration = Duration::from_millis(50);
/// How often a datagram is sent whose frame is lost, or that no device processes.
const TRIES: u8 = 10;
/// Time between two looks at what takes a while.
const LOOK_AGAIN: Duration = Duration::from_micros(500);
/// Longest wait before the wish to end is looked at.
const LOOK_UP: Duration = Duration::from_millis(50);
/// Bytes from AL status to AL status code.
const STATUS_LEN: usize = 6;

/// Why something was not asked of a segment, or not answered.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SegmentError {
    /// The segment or a device did not do it.
    #[error(transparent)]
    Failed(#[from] SegmentFailure),
    /// A frame could not be sent.
    #[error("a frame could not be sent: {0}")]
    Link(#[from] SendError),
    /// The device is in a state in which it has no mailbox.
    #[error(
        "its objects are read and written in PRE-OP, SAFE-OP and OP, and it is in {status}{}",
        if *.code == AlStatusCode::NONE { String::new() } else { format!(" with {code}") }
    )]
    NoMailbox {
        /// Its state.
        status: AlStatus,
        /// Why it has an error.
        code: AlStatusCode,
    },
    /// Somebody wishes to end.
    #[error("interrupted")]
    Interrupted,
}

/// The connection to the devices of a segment.
///
/// Whoever makes one has seen to it that no other master is on the segment.
#[derive(Debug)]
pub struct SegmentService<L> {
    link: L,
    is_over: Arc<AtomicBool>,
    /// Index of the next datagram.
    index: u8,
    buffer: Box<[u8; frame::LONGEST]>,
    /// Whether a frame came back that no device had marked.
    has_come_back: bool,
    /// Mailbox clients of the devices whose objects were requested, by their positions.
    mailboxes: BTreeMap<u16, MailboxClient>,
    emergencies: Vec<(u16, CoeEmergency)>,
}

impl<L: EthernetLink> SegmentService<L> {
    /// A connection over a link. Waiting ends when `is_over` is set.
    pub fn new(link: L, is_over: Arc<AtomicBool>) -> Self {
        let (mailboxes, emergencies) = (BTreeMap::new(), Vec::new());
        let buffer = Box::new([0; frame::LONGEST]);
        Self { link, is_over, index: 0, buffer, has_come_back: false, mailboxes, emergencies }
    }

    /// Whether somebody wishes to end. Whoever has to give something back first takes the wish.
    pub fn is_over(&self) -> &AtomicBool {
        &self.is_over
    }

    /// From now on nobody can end what is done.
    pub fn end_later(&mut self) {
        self.is_over = Arc::new(AtomicBool::new(false));
    }

    /// The time of the link.
    pub fn now(&self) -> Time {
        self.link.now()
    }

    /// Listens for `time` before anything is sent; the first EtherCAT frame that comes is that of another master.
    ///
    /// # Errors
    /// [`SegmentError::Interrupted`].
    pub fn listen(&mut self, time: Duration) -> Result<Option<SegmentSign>, SegmentError> {
        let until = self.now() + time;
        loop {
            while let Some(arrival) = self.link.receive(&mut self.buffer[..]) {
                let EthernetReceived::Frame { length } = arrival.what else { continue };
                let bytes = self.buffer.get(..length).unwrap_or_default();
                if frame::end(bytes).is_ok() {
                    return Ok(Some(SegmentSign::Frame(array(bytes, 6))));
                }
            }
            let now = self.now();
            if now >= until {
                return Ok(None);
            }
            self.end_if_wished()?;
            self.link.wait(until.min(now + LOOK_UP));
        }
    }

    /// Devices that answer.
    ///
    /// # Errors
    /// If no frame comes back, and if more than 64 devices would answer.
    pub fn devices(&mut self) -> Result<u16, SegmentError> {
        let found = self.datagram(Command::Brd, address(0, register::AL_STATUS), &[0; 2])?.1;
        match found {
            0..=MOST_DEVICES => Ok(found),
            _ => Err(SegmentFailure::TooMany { found, most: MOST_DEVICES }.into()),
        }
    }

    /// State and AL status code of a device.
    ///
    /// # Errors
    /// As [`SegmentService::read`].
    pub fn state(&mut self, position: u16) -> Result<(AlStatus, AlStatusCode), SegmentError> {
        let bytes = self.read(position, register::AL_STATUS, STATUS_LEN)?;
        Ok((AlStatus::from_register(u16_at(&bytes, 0)), AlStatusCode(u16_at(&bytes, 4))))
    }

    /// The first device whose state only a master gives it: OP, or SAFE-OP that its watchdog did not bring.
    ///
    /// # Errors
    /// As [`SegmentService::read`].
    pub fn led(&mut self, devices: u16) -> Result<Option<SegmentSign>, SegmentError> {
        for position in 0..devices {
            let (status, code) = self.state(position)?;
            if status.shows_master(code) {
                return Ok(Some(SegmentSign::State { position, status }));
            }
        }
        Ok(None)
    }

    /// Reads registers of a device.
    ///
    /// # Errors
    /// If no frame comes back, or the device does not process the datagram.
    pub fn read(&mut self, position: u16, register: u16, len: usize) -> Result<Bytes, SegmentError> {
        const ZEROS: [u8; frame::LONGEST] = [0; frame::LONGEST];
        self.of_device(Command::Aprd, position, register, ZEROS.get(..len).unwrap_or_default())
    }

    /// Writes registers of a device.
    ///
    /// # Errors
    /// As [`SegmentService::read`].
    pub fn write(&mut self, position: u16, register: u16, bytes: &[u8]) -> Result<(), SegmentError> {
        self.of_device(Command::Apwr, position, register, bytes).map(|_| ())
    }

    fn of_device(
        &mut self,
        command: Command,
        position: u16,
        register: u16,
        data: &[u8],
    ) -> Result<Bytes, SegmentError> {
        for _ in 0..TRIES {
            let (bytes, working_counter) =
                self.datagram(command, address(0u16.wrapping_sub(position), register), data)?;
            if working_counter > 0 {
                return Ok(bytes);
            }
            self.pause(LOOK_AGAIN);
        }
        Err(SegmentFailure::NotProcessed { register, tries: TRIES }.into())
    }

    /// A datagram as it comes back, with its working counter. One whose frame is lost is sent once more.
    fn datagram(&mut self, command: Command, address: u32, data: &[u8]) -> Result<(Bytes, u16), SegmentError> {
        self.has_come_back = false;
        for _ in 0..TRIES {
            if let Some(back) = self.once(command, address, data)? {
                return Ok(back);
            }
        }
        let tries = TRIES;
        Err(if self.has_come_back { SegmentFailure::CameBack { tries } } else { SegmentFailure::NoReply { tries } }
            .into())
    }

    /// Sends a datagram once, without a repeat; `None` if it does not come back.
    fn once(&mut self, command: Command, address: u32, data: &[u8]) -> Result<Option<(Bytes, u16)>, SegmentError> {
        self.end_if_wished()?;
        self.index = self.index.wrapping_add(1);
        let mut sent = [0; frame::LONGEST];
        let too_long = |len| SegmentFailure::FrameTooLong { what: "next", len };
        let mut writer = FrameWriter::new(&mut sent, self.link.source()).map_err(|_| too_long(0))?;
        let place = writer.push(command, self.index, address, data).map_err(|_| too_long(data.len()))?;
        let sent: &[u8] = writer.finish();
        self.link.send(sent)?;
        let until = self.link.now() + FRAME_WAIT;
        loop {
            while let Some(arrival) = self.link.receive(&mut self.buffer[..]) {
                let EthernetReceived::Frame { length } = arrival.what else { continue };
                let bytes = self.buffer.get(..length).unwrap_or_default();
                let is_marked = bytes.get(6).is_some_and(|first| first & frame::PROCESSED != 0);
                let working_counter = u16_at(bytes, place.end);
                // Some devices count up and do not mark what they pass on.
                if !answers(sent, bytes) {
                    continue;
                }
                self.has_come_back |= !is_marked;
                if is_marked || working_counter > 0 {
                    return Ok(Some((bytes.get(place).unwrap_or_default().to_vec(), working_counter)));
                }
            }
            if self.link.now() >= until {
                return Ok(None);
            }
            self.link.wait(until);
        }
    }

    /// Lets time pass; what comes then is late.
    fn pause(&mut self, time: Duration) {
        let until = self.now() + time;
        while self.now() < until {
            if self.link.wait(until) {
                self.link.receive(&mut self.buffer[..]);
            }
        }
    }

    fn end_if_wished(&self) -> Result<(), SegmentError> {
        if self.is_over.load(Ordering::Relaxed) { Err(SegmentError::Interrupted) } else { Ok(()) }
    }
}
