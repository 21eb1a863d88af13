//! Objects of CANopen nodes, by SDO.
//!
//! One client a node configures it and serves whoever asks later: a node has one server on the default channel.

use super::CanNetwork;
use super::node::Node;
use crate::bus::access::{ObjectAnswer, ObjectError, ObjectRequest};
use crate::bus::error::BootFailure;
use crate::bus::phase::Phase;
use crate::canopen::{CanopenError, Frame, Outbox, SdoOutcome, Time};
use crate::guard::Device;

/// Where the request stands that a node was asked last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Asked {
    Nothing,
    Read(Progress),
    Write(Progress),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Progress {
    Pending,
    Done,
    Failed(ObjectError),
}

impl CanNetwork {
    /// Begins to read or to write an object of a device.
    ///
    /// # Errors
    /// If the device has no objects, has not answered the last request, or the value is too long.
    pub(in crate::bus) fn ask(
        &mut self,
        now: Time,
        device: Device,
        request: ObjectRequest<'_>,
        out: &mut impl Outbox,
    ) -> Result<(), ObjectError> {
        if self.phase == Phase::Configuring {
            return Err(ObjectError::Busy);
        }
        let node = self.nodes.iter_mut().find(|node| node.device == device).ok_or(ObjectError::NoObjects)?;
        let mut out = out.on(node.bus);
        let (asked, started) = match request {
            ObjectRequest::Read { index, sub } => {
                (Asked::Read(Progress::Pending), node.client.start_upload(now, index, sub, &mut out))
            }
            ObjectRequest::Write { index, sub, data } => {
                (Asked::Write(Progress::Pending), node.client.start_download(now, index, sub, data, &mut out))
            }
        };
        started.map_err(|error| match error {
            CanopenError::SdoBuffer { len, .. } => ObjectError::TooLong(len),
            _ => ObjectError::Busy,
        })?;
        node.asked = asked;
        Ok(())
    }

    /// How what was asked of a device last has ended.
    ///
    /// Real-time: yes.
    pub(in crate::bus) fn answer(&self, device: Device) -> ObjectAnswer<'_> {
        match self.nodes.iter().find(|node| node.device == device) {
            Some(node) => node.answer(),
            None => ObjectAnswer::Failed(ObjectError::NoObjects),
        }
    }

    /// The node id of a device; `None` for a sensor on plain CAN.
    pub(in crate::bus) fn node_id(&self, device: Device) -> Option<u8> {
        self.nodes.iter().find(|node| node.device == device).map(|node| node.id.raw())
    }
}

impl Node {
    fn answer(&self) -> ObjectAnswer<'_> {
        let (progress, data) = match self.asked {
            Asked::Nothing => return ObjectAnswer::NotAsked,
            Asked::Read(progress) => (progress, self.client.data()),
            Asked::Write(progress) => (progress, &[][..]),
        };
        match progress {
            Progress::Pending => ObjectAnswer::Pending,
            Progress::Done => ObjectAnswer::Done(data),
            Progress::Failed(error) => ObjectAnswer::Failed(error),
        }
    }

    fn is_asked(&self) -> bool {
        matches!(self.asked, Asked::Read(Progress::Pending) | Asked::Write(Progress::Pending))
    }

    /// When the request has to be looked at again.
    ///
    /// Real-time: yes.
    pub(super) fn asked_deadline(&self) -> Time {
        if self.is_asked() { self.client.next_deadline() } else { Time::NEVER }
    }

    /// Takes a frame for the request.
    ///
    /// Real-time: yes.
    pub(super) fn hear_answer(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
        if self.is_asked() {
            let outcome = self.client.on_frame(now, frame, out);
            self.end_request(outcome);
        }
    }

    /// Repeats the request or gives it up, when that is due.
    ///
    /// Real-time: yes.
    pub(super) fn poll_answer(&mut self, now: Time, out: &mut impl Outbox) {
        if self.is_asked() {
            let outcome = self.client.poll(now, out);
            self.end_request(outcome);
        }
    }

    fn end_request(&mut self, outcome: Option<SdoOutcome>) {
        let ended = match outcome {
            None => return,
            Some(SdoOutcome::Uploaded { .. } | SdoOutcome::Downloaded { .. }) => Progress::Done,
            Some(SdoOutcome::Aborted { code, .. }) => Progress::Failed(ObjectError::Aborted(code)),
            Some(SdoOutcome::TimedOut { .. }) => Progress::Failed(ObjectError::NoAnswer),
        };
        self.end(ended);
    }

    /// Ends a request that a node which starts anew will not answer.
    pub(super) fn give_up_request(&mut self) {
        if self.is_asked() {
            self.end(Progress::Failed(ObjectError::NoAnswer));
        }
    }

    fn end(&mut self, ended: Progress) {
        self.asked = match self.asked {
            Asked::Nothing => Asked::Nothing,
            Asked::Read(_) => Asked::Read(ended),
            Asked::Write(_) => Asked::Write(ended),
        };
    }

    /// Begins to configure it.
    pub(super) fn start_boot(&mut self, now: Time, out: &mut impl Outbox) -> Result<(), BootFailure> {
        self.boot.start(now, &mut self.client, &mut out.on(self.bus))
    }

    /// Begins to configure it anew, since it has restarted.
    pub(super) fn restart_boot(&mut self, now: Time, out: &mut impl Outbox) -> Result<(), BootFailure> {
        self.boot.restart(now, &mut self.client, &mut out.on(self.bus))
    }

    /// Brings its configuration forward when something is due.
    pub(super) fn poll_boot(&mut self, now: Time, out: &mut impl Outbox) -> Result<(), BootFailure> {
        self.boot.poll(now, &mut self.client, &mut out.on(self.bus))
    }

    /// Brings its configuration forward by a frame of its bus.
    pub(super) fn hear_boot(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) -> Result<(), BootFailure> {
        self.boot.on_frame(now, frame, &mut self.client, &mut out.on(self.bus))
    }
}
