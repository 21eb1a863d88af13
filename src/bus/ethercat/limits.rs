//! The objects by which a drive limits itself, read again beside the cycle: nobody here hears what somebody else writes to its mailbox.

use std::time::Duration;

use super::writes::{Altered, WriteTarget};
use crate::script::{Action, Step};
use yieldwall_drives::objects::of_first_axis;
use yieldwall_fieldbus::objects::{Address, ObjectAnswer, ObjectRequest};
use yieldwall_fieldbus::time::Time;

/// Without the master (6007h), following error window (6065h), torque limit (6072h).
const INDICES: [u16; 3] = [0x6007, 0x6065, 0x6072];
/// Time from one object of an axis to the next: all of them within ten seconds, also where frames are lost.
const EVERY: Duration = Duration::from_millis(2500);

/// Whether an index is that of such an object, of whatever axis.
///
/// # Source
/// CiA 402-2: objects of axes lie 800h apart.
fn is_limit(index: u16) -> bool {
    INDICES.contains(&of_first_axis(index))
}

/// One object.
#[derive(Clone, Copy, Debug)]
struct Limit {
    at: Address,
    /// Value that the boot writes.
    value: u32,
    /// Whether it stands there: not after this master has written something else.
    is_known: bool,
}

/// The objects of one drive.
#[derive(Clone, Debug, Default)]
pub(super) struct Limits {
    all: Vec<Limit>,
    next: usize,
    /// Whether the next one is being read.
    pub(super) is_asked: bool,
    at: Time,
}

impl Limits {
    /// Returns the limits that the boot of a device writes and that no process data carry.
    pub(super) fn of(steps: &[Step], mut is_mapped: impl FnMut(Address) -> bool) -> Self {
        let mut all: Vec<Limit> = Vec::new();
        for step in steps.iter().filter(|step| is_limit(step.index)) {
            let (Action::State { value, .. }, at) = (step.action, Address::new(step.index, step.sub)) else {
                continue;
            };
            all.retain(|limit| limit.at != at);
            if !is_mapped(at) {
                all.push(Limit { at, value, is_known: true });
            }
        }
        Limits { all, ..Limits::default() }
    }

    /// The boot writes all of them anew.
    pub(super) fn restart(&mut self) {
        self.all.iter_mut().for_each(|limit| limit.is_known = true);
        (self.next, self.is_asked, self.at) = (0, false, Time(0));
    }

    /// This master writes an object.
    pub(super) fn note_write(&mut self, at: Address) {
        self.all.iter_mut().filter(|limit| limit.at == at).for_each(|limit| limit.is_known = false);
    }

    /// Returns the request that is due now, if any.
    ///
    /// Real-time: yes.
    pub(super) fn due(&mut self, now: Time) -> Option<ObjectRequest<'static>> {
        if self.is_asked || now < self.at {
            return None;
        }
        let axes = self.all.len().div_ceil(INDICES.len()).max(1) as u32;
        (self.at, self.next) = (now + EVERY / axes, (self.next + 1) % self.all.len().max(1));
        let limit = self.all.get(self.next).filter(|limit| limit.is_known)?;
        self.is_asked = true;
        Some(ObjectRequest::Read(limit.at))
    }

    /// The end of what was asked; what differs, if that does. A drive that does not answer says nothing.
    ///
    /// Real-time: yes.
    pub(super) fn take(&mut self, answer: ObjectAnswer<'_>) -> Option<Altered> {
        self.is_asked = false;
        let limit = self.all.get(self.next).filter(|limit| limit.is_known)?;
        let ObjectAnswer::Done(bytes) = answer else { return None };
        let is = bytes.iter().take(4).rev().fold(0, |value, byte| value << 8 | u32::from(*byte));
        let mask = u32::MAX.checked_shr(32 - 8 * bytes.len().clamp(1, 4) as u32).unwrap_or(u32::MAX);
        let written = limit.value & mask;
        (is != written).then_some(Altered { place: WriteTarget::Object(limit.at), written, is })
    }
}
