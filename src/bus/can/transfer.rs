//! Objects of one node, by SDO.

use std::time::Duration;

use yieldwall_fieldbus::canopen::{CanopenError, Frame, NodeId, Outbox, SdoClient, SdoOutcome};
use yieldwall_fieldbus::objects::{Address, ObjectAnswer, ObjectError, ObjectRequest};
use yieldwall_fieldbus::time::Time;

/// Bytes of the largest object that is read or written. A client has memory for so many from the start, so that a transfer beside the
/// cycle allocates nothing.
const CAPACITY: usize = 1024;

/// Last request to the node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Asked {
    Nothing,
    Read(Progress),
    Write(Progress),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Progress {
    Pending,
    Done,
    Failed(ObjectError),
}

/// The one client of a node, which has one server on the default channel: it configures the node and serves whoever asks later.
#[derive(Clone, Debug)]
pub(super) struct Transfer {
    timeout: Duration,
    pub(super) client: SdoClient,
    asked: Asked,
}

impl Transfer {
    /// Nothing was asked yet. An answer may take `timeout`.
    pub(super) fn new(node: NodeId, timeout: Duration) -> Self {
        Self { timeout, client: SdoClient::new(node, timeout, CAPACITY), asked: Asked::Nothing }
    }

    /// Forgets what is on its way; a node that starts anew does not answer it.
    pub(super) fn restart(&mut self) {
        if self.is_pending() {
            self.end(Progress::Failed(ObjectError::NoAnswer));
        }
        self.client = SdoClient::new(self.client.node(), self.timeout, CAPACITY);
    }

    /// Begins to read or to write an object.
    ///
    /// # Errors
    /// If the last request has not ended, or the value is too long.
    pub(super) fn ask(
        &mut self,
        now: Time,
        request: ObjectRequest<'_>,
        out: &mut impl Outbox,
    ) -> Result<(), ObjectError> {
        let (asked, started) = match request {
            ObjectRequest::Read(Address { index, sub }) => {
                (Asked::Read(Progress::Pending), self.client.start_upload(now, index, sub, out))
            }
            ObjectRequest::Write(Address { index, sub }, data) => {
                (Asked::Write(Progress::Pending), self.client.start_download(now, index, sub, data, out))
            }
        };
        started.map_err(|error| match error {
            CanopenError::SdoBuffer { len, .. } => ObjectError::TooLong(len),
            _ => ObjectError::Busy,
        })?;
        self.asked = asked;
        Ok(())
    }

    /// How the last request has ended.
    ///
    /// Real-time: yes.
    pub(super) fn answer(&self) -> ObjectAnswer<'_> {
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

    fn is_pending(&self) -> bool {
        matches!(self.asked, Asked::Read(Progress::Pending) | Asked::Write(Progress::Pending))
    }

    /// When the request has to be looked at again.
    ///
    /// Real-time: yes.
    pub(super) fn deadline(&self) -> Time {
        if self.is_pending() { self.client.next_deadline() } else { Time::NEVER }
    }

    /// Takes a frame for the request.
    ///
    /// Real-time: yes.
    pub(super) fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
        if self.is_pending() {
            let outcome = self.client.on_frame(now, frame, out);
            self.take(outcome);
        }
    }

    /// Repeats the request or gives it up, when that is due.
    ///
    /// Real-time: yes.
    pub(super) fn poll(&mut self, now: Time, out: &mut impl Outbox) {
        if self.is_pending() {
            let outcome = self.client.poll(now, out);
            self.take(outcome);
        }
    }

    fn take(&mut self, outcome: Option<SdoOutcome>) {
        match outcome {
            None => {}
            Some(SdoOutcome::Uploaded { .. } | SdoOutcome::Downloaded { .. }) => self.end(Progress::Done),
            Some(SdoOutcome::Aborted { code, .. }) => self.end(Progress::Failed(ObjectError::Aborted(code))),
            Some(SdoOutcome::TimedOut { .. }) => self.end(Progress::Failed(ObjectError::NoAnswer)),
        }
    }

    fn end(&mut self, ended: Progress) {
        self.asked = match self.asked {
            Asked::Nothing => Asked::Nothing,
            Asked::Read(_) => Asked::Read(ended),
            Asked::Write(_) => Asked::Write(ended),
        };
    }
}
