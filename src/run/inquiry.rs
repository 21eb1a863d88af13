//! Reports of both drives on a fault: read over SDO, one object after the other, while the cycles go on.

use super::place::{Place, Process};
use super::runner::Runner;
use yieldwall_bus::Master;
use yieldwall_drives::objects;
use yieldwall_fieldbus::canopen::Outbox;
use yieldwall_fieldbus::objects::{Address, ObjectAnswer, ObjectRequest};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::guard::{Device, Fault};

/// Objects that are read from a drive, in this order: the state comes last, since a fault reaction takes a while.
const OBJECTS: [objects::Object; 3] = [objects::ERROR_CODE, objects::ERROR_REGISTER, objects::STATUSWORD];

/// Report of a drive on a fault. A value that it did not return within its own SDO timeout is `None`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DriveError {
    /// The drive.
    pub drive: Device,
    /// Its last error code (603Fh); 0 for none.
    pub code: Option<u16>,
    /// Its error register (1001h).
    pub register: Option<u8>,
    /// Its statusword (6041h).
    pub statusword: Option<u16>,
}

/// Receives a drive's report on a fault, on the thread of the loop, in a cycle of a rig that is stopped.
pub type ErrorWatch = Box<dyn FnMut(&DriveError) + Send>;

/// One drive that is asked.
#[derive(Clone, Copy, Debug)]
struct Asked {
    error: DriveError,
    /// Index of the next object.
    next: usize,
    is_pending: bool,
}

impl Asked {
    fn new(drive: Device) -> Self {
        Self { error: DriveError { drive, code: None, register: None, statusword: None }, next: 0, is_pending: false }
    }

    /// Takes an answer and asks for the next object. Returns the drive's report once it is complete.
    fn step(&mut self, master: &mut Master, now: Time, out: &mut impl Outbox) -> Option<DriveError> {
        if self.is_pending {
            let value = match master.networks().answer(self.error.drive) {
                ObjectAnswer::Pending => return None,
                ObjectAnswer::Done(&[low, high, ..]) => Some(u16::from_le_bytes([low, high])),
                ObjectAnswer::Done(&[low]) => Some(low.into()),
                ObjectAnswer::Done(_) | ObjectAnswer::NotAsked | ObjectAnswer::Failed(_) => None,
            };
            let DriveError { code, register, statusword, .. } = &mut self.error;
            match self.next {
                0 => *code = value,
                1 => *register = value.map(|value| value as u8),
                _ => *statusword = value,
            }
            (self.is_pending, self.next) = (false, self.next + 1);
            if self.next == OBJECTS.len() {
                return Some(self.error);
            }
        }
        let object = OBJECTS.get(self.next)?;
        let request = ObjectRequest::Read(Address::new(object.index, object.sub));
        self.is_pending = master.networks_mut().ask(now, self.error.drive, request, out).is_ok();
        None
    }
}

/// Requests to both drives since the last boot.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inquiry([Asked; 2]);

impl Inquiry {
    pub(super) fn new() -> Self {
        Self(Device::DRIVES.map(Asked::new))
    }
}

impl<P: Place + ?Sized> Runner<P> {
    /// Passes each drive's report on a fault to `watch`, from now on.
    pub fn set_error_watch(&mut self, watch: ErrorWatch) {
        self.error_watch = Some(watch);
    }

    /// Whether the reports of drives on a fault are wanted.
    pub fn has_error_watch(&self) -> bool {
        self.error_watch.is_some()
    }

    /// Goes on asking both drives of a rig that a fault has stopped for error code (603Fh), error register (1001h) and statusword
    /// (6041h): to be called before each cycle. Once all is known it does nothing. Nothing is asked while the master is silent, since
    /// the drives' watchdogs have to act; nor where another master may be, or two devices answer to one node id.
    ///
    /// Real-time: yes, if the watch is.
    pub fn ask_for_errors(&mut self) {
        let is_shared = |fault| matches!(fault, Fault::Intruder | Fault::DuplicateNode);
        let is_kept_from =
            self.master().networks().is_silent() || self.cause().is_some_and(|cause| is_shared(cause.fault));
        if is_kept_from || self.process != Process::Runs || self.has_panicked() {
            return;
        }
        let Inquiry(mut drives) = self.inquiry;
        for drive in &mut drives {
            if let Some(error) = self.send(|master, now, out| drive.step(master, now, out))
                && let Some(watch) = &mut self.error_watch
            {
                watch(&error);
            }
        }
        self.inquiry = Inquiry(drives);
    }

    /// Repeats the requests of [`Runner::ask_for_errors`]: the report on another fault may differ.
    pub fn forget_errors(&mut self) {
        self.inquiry = Inquiry::new();
    }

    /// Returns the reports of the drives that were asked for all objects.
    pub fn errors(&self) -> impl Iterator<Item = DriveError> {
        self.inquiry.0.iter().filter(|drive| drive.next == OBJECTS.len()).map(|drive| drive.error)
    }
}
