//! The objects of a device over its mailbox, and what it says by itself there.

use std::time::Duration;

use super::{SegmentError, SegmentService, TRIES};
use crate::{Bytes, Error, ObjectAccess};
use yieldwall_bus::ethercat::SegmentFailure;
use yieldwall_fieldbus::ethercat::coe::CoeEmergency;
use yieldwall_fieldbus::ethercat::mailbox::{Counter, MailboxClient};
use yieldwall_fieldbus::ethercat::sii::{MailboxArea, Sii};
use yieldwall_fieldbus::ethercat::{AlState, BufferMode, Direction, SyncManager, frame, registers as register};
use yieldwall_fieldbus::objects::{Address, ObjectAnswer, ObjectError, ObjectRequest};
use yieldwall_link::EthernetLink;

/// How long a device may take to answer.
const PATIENCE: Duration = Duration::from_secs(1);
/// Object that every device has: its type.
const DEVICE_TYPE: Address = Address::new(0x1000, 0);

/// The objects of a device on a segment.
#[derive(Debug)]
pub struct DeviceObjects<'a, L> {
    service: &'a mut SegmentService<L>,
    position: u16,
}

impl<L: EthernetLink> SegmentService<L> {
    /// The objects of a device, over its mailboxes as its sync managers have them. A device in INIT is brought to PRE-OP, where it has
    /// mailboxes, and stays there.
    ///
    /// # Errors
    /// If the device has an error in INIT, does not come to PRE-OP or has no mailbox, and as [`SegmentService::read`].
    pub fn objects(&mut self, position: u16) -> Result<DeviceObjects<'_, L>, SegmentError> {
        if !self.mailboxes.contains_key(&position) {
            let (status, code) = self.state(position)?;
            if status.state() == Some(AlState::Init) {
                if status.has_error() {
                    return Err(SegmentError::NoMailbox { status, code });
                }
                self.change_state(position, AlState::PreOperational)?;
            }
            let bytes = self.read(position, register::SYNC_MANAGER, 2 * SyncManager::SIZE)?;
            let area = |number: usize, direction: Direction| {
                let bytes = bytes.get(number * SyncManager::SIZE..)?.first_chunk()?;
                let manager = SyncManager::decode(bytes);
                let is_mailbox = manager.is_enabled && manager.mode() == Some(BufferMode::Mailbox);
                let is_it = is_mailbox && manager.direction() == Some(direction);
                is_it.then_some(MailboxArea { start: manager.start, len: manager.len })
            };
            let areas = area(0, Direction::Write).zip(area(1, Direction::Read));
            let (to_device, from_device) = areas.ok_or(SegmentFailure::NoCoe)?;
            let mut mailbox = MailboxClient::at_position(position, PATIENCE);
            mailbox.start_with(to_device, from_device, Counter::of(self.now()));
            self.mailboxes.insert(position, mailbox);
        }
        Ok(DeviceObjects { service: self, position })
    }

    /// The emergencies that devices have sent while they were asked, with their positions; they are taken away.
    pub fn take_emergencies(&mut self) -> Vec<(u16, CoeEmergency)> {
        std::mem::take(&mut self.emergencies)
    }

    /// Moves the mailbox of a device until what was asked has ended; with `until`, up to that moment, for what the device says by itself.
    fn converse(&mut self, position: u16, until: Option<yieldwall_fieldbus::time::Time>) -> Result<(), SegmentError> {
        let mut buffer = [0; frame::LONGEST];
        let mut lost = 0;
        loop {
            let now = self.now();
            let Some(mailbox) = self.mailboxes.get_mut(&position) else { return Ok(()) };
            let is_over = until.map_or(!mailbox.is_busy(), |until| now >= until && !mailbox.is_busy());
            if is_over {
                return Ok(());
            }
            let Some(ask) = mailbox.next(now, &mut buffer) else {
                let next = mailbox.next_deadline().since(now).max(super::LOOK_AGAIN / 10);
                self.end_if_wished()?;
                self.pause(next);
                continue;
            };
            let data = buffer.get(..ask.len).unwrap_or_default().to_vec();
            let back = self.once(ask.command, ask.address, &data)?;
            let now = self.now();
            let Some(mailbox) = self.mailboxes.get_mut(&position) else { return Ok(()) };
            match back {
                Some((bytes, working_counter)) => {
                    lost = 0;
                    let emergency = mailbox.on_reply(now, &bytes, working_counter);
                    self.emergencies.extend(emergency.map(|emergency| (position, emergency)));
                }
                None => {
                    lost += 1;
                    mailbox.on_loss();
                    if lost >= TRIES {
                        mailbox.forget();
                        return Err(SegmentFailure::NoReply { tries: TRIES }.into());
                    }
                }
            }
        }
    }
}

impl<L: EthernetLink> DeviceObjects<'_, L> {
    /// Takes what the device says by itself, for so long; [`SegmentService::take_emergencies`] has it then.
    ///
    /// # Errors
    /// If no frame comes back.
    pub fn listen(&mut self, time: Duration) -> Result<(), SegmentError> {
        let until = self.service.now() + time;
        self.service.converse(self.position, Some(until))
    }

    /// The time of the link.
    pub(crate) fn time(&self) -> yieldwall_fieldbus::time::Time {
        self.service.now()
    }

    /// Lets time pass.
    pub(crate) fn pass(&mut self, time: Duration) -> Result<(), Error> {
        self.listen(time).map_err(of_segment)
    }

    /// Its state.
    pub(crate) fn state(&mut self) -> Result<AlState, Error> {
        let (status, _) = self.service.state(self.position).map_err(of_segment)?;
        Ok(status.state().unwrap_or(AlState::Init))
    }

    /// From now on nobody can end what is done.
    pub(crate) fn end_later(&mut self) {
        self.service.end_later();
    }

    /// Whether the SII of the device says that it gives no information about its objects.
    fn lacks_information(&mut self) -> Result<bool, Error> {
        match self.service.sii_image(self.position) {
            Ok(image) => Ok(Sii::read(&image).is_ok_and(|sii| sii.lacks_information())),
            // Without the chip nothing says so.
            Err(SegmentError::Failed(_)) => Ok(false),
            Err(error) => Err(of_segment(error)),
        }
    }

    fn mailbox(&mut self) -> Result<&mut MailboxClient, Error> {
        self.service.mailboxes.get_mut(&self.position).ok_or(Error::NoAnswer)
    }

    fn one(&mut self, request: ObjectRequest<'_>) -> Result<Bytes, Error> {
        let now = self.service.now();
        self.mailbox()?.ask(now, request).map_err(of_object)?;
        self.service.converse(self.position, None).map_err(of_segment)?;
        match self.mailbox()?.answer() {
            ObjectAnswer::Done(value) => Ok(value.to_vec()),
            ObjectAnswer::Failed(error) => Err(of_object(error)),
            ObjectAnswer::NotAsked | ObjectAnswer::Pending => Err(Error::NoAnswer),
        }
    }
}

fn of_object(error: ObjectError) -> Error {
    match error {
        ObjectError::Aborted(code) => Error::Refused(code),
        ObjectError::TooLong(len) => Error::TooLong(len),
        _ => Error::NoAnswer,
    }
}

fn of_segment(error: SegmentError) -> Error {
    match error {
        SegmentError::Link(error) => Error::Link(error),
        SegmentError::Interrupted => Error::Interrupted,
        SegmentError::Failed(_) | SegmentError::NoMailbox { .. } => Error::NoAnswer,
    }
}

impl<L: EthernetLink> ObjectAccess for DeviceObjects<'_, L> {
    fn read(&mut self, at: Address) -> Result<Bytes, Error> {
        // A device drops a request whose counter is that of the last one, which may be that of a process before this one.
        match self.one(ObjectRequest::Read(at)) {
            Err(Error::NoAnswer) => self.one(ObjectRequest::Read(at)),
            answer => answer,
        }
    }

    fn write(&mut self, at: Address, value: &[u8]) -> Result<(), Error> {
        match self.one(ObjectRequest::Write(at, value)) {
            Ok(_) => Ok(()),
            Err(Error::NoAnswer) => Err(Error::MayBeWritten),
            Err(error) => Err(error),
        }
    }

    fn indices(&mut self) -> Result<Option<Vec<u16>>, Error> {
        if self.lacks_information()? {
            return Ok(None);
        }
        let now = self.service.now();
        self.mailbox()?.ask_list(now).map_err(of_object)?;
        self.service.converse(self.position, None).map_err(of_segment)?;
        let mailbox = self.mailbox()?;
        match (mailbox.list(), mailbox.answer()) {
            (Some(indices), _) => Ok(Some(indices.to_vec())),
            // Silent in this alone, or altogether.
            (None, ObjectAnswer::Failed(ObjectError::NoAnswer)) => match self.read(DEVICE_TYPE) {
                Ok(_) | Err(Error::Refused(_)) => Ok(None),
                Err(error) => Err(error),
            },
            (None, _) => Ok(None),
        }
    }
}
