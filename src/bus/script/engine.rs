//! The way through the steps of one device: what is asked next, and what an answer leads to.
//!
//! ```text
//! State     read --equal--> next            Unit     read its states, the last first --all equal--> behind the unit
//!           | differs, or is refused                 | one differs, or is refused
//!           v                                        v
//!           write --> read back --> next             its steps, each state written without that first look
//! Command   write (--> read back) --> next
//! ```
//! A refused write of a state is judged by what the object holds: the value that was wanted is good.

use super::{Action, CyclePart, Step, check, check_current, cycle_time, little_endian, motor_speed, width_mask};
use crate::error::BootFailure;
use std::time::Duration;
use yieldwall_drives::profiles::{CurrentLimit, Identity};
use yieldwall_fieldbus::objects::{AbortCode, Address, ObjectError, ObjectRequest};
use yieldwall_fieldbus::time::Time;

/// Time between two looks at an object that has not come to its value.
const READ_AGAIN: Duration = Duration::from_millis(10);
/// Bytes of the largest object that is read.
const LONGEST: usize = 8;

/// Progress of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// The object is read.
    Look,
    /// The state at this place, a part of the unit, is read.
    Compare(usize),
    Write,
    /// The object is read back; the code with which its write was refused, if it was.
    Verify(Option<AbortCode>),
}

/// The steps of one device, and their progress. The bus of the device carries each request.
#[derive(Clone, Debug)]
pub(crate) struct Script {
    /// Longest time to the answer of one request.
    timeout: Duration,
    identity: Identity,
    steps: Vec<Step>,
    next: usize,
    stage: Stage,
    /// States before this place belong to a unit that differs.
    open_until: usize,
    /// The identifier of the present PDO as it was read last, or has to be: its bits that stay as the device has them.
    kept: u32,
    /// Increments and revolutions of the encoder, as the drive reports them.
    resolution: [u32; 2],
    /// The value of a limit in another unit at the rated torque.
    rated: u32,
    /// Power of ten of the cycle time, as the drive has it.
    exponent: Option<i8>,
    /// Time that it takes to copy its outputs, as the device reports it, in ns.
    copy_ns: u32,
    /// When the object is read again that has not come to its value yet, and when it is given up.
    pub(crate) again_at: Time,
    given_up_at: Time,
}

/// The next request to the device.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wanted {
    at: Address,
    /// Little-endian bytes to write, and how many of them; none to read.
    written: Option<([u8; 4], u8)>,
}

impl Wanted {
    /// The request.
    pub(crate) fn request(&self) -> ObjectRequest<'_> {
        match &self.written {
            Some((bytes, len)) => ObjectRequest::Write(self.at, bytes.get(..usize::from(*len)).unwrap_or(bytes)),
            None => ObjectRequest::Read(self.at),
        }
    }
}

impl Script {
    /// Steps that were not begun.
    pub(crate) fn new(identity: Identity, timeout: Duration, steps: Vec<Step>) -> Self {
        let mut script = Self {
            timeout,
            identity,
            steps,
            next: 0,
            stage: Stage::Look,
            open_until: 0,
            kept: 0,
            resolution: [0; 2],
            rated: 0,
            exponent: None,
            copy_ns: 0,
            again_at: Time::NEVER,
            given_up_at: Time::NEVER,
        };
        script.restart();
        script
    }

    /// Begins anew.
    pub(crate) fn restart(&mut self) {
        (self.open_until, self.kept, self.copy_ns) = (0, 0, 0);
        (self.resolution, self.rated, self.exponent) = ([0; 2], 0, None);
        self.again_at = Time::NEVER;
        self.go_to(0);
    }

    /// All that it does, in its order, and the identity that it looks for.
    pub(crate) fn steps(&self) -> (&[Step], &Identity) {
        (&self.steps, &self.identity)
    }

    /// Words for the present step.
    pub(crate) fn doing(&self) -> &'static str {
        self.steps.get(self.next).map_or("start", |step| step.doing)
    }

    /// Whether what comes next is to be seen once the device exchanges process data: some show their mode only then.
    pub(crate) fn is_late(&self) -> bool {
        self.steps.get(self.next).is_some_and(|step| step.action.is_late())
    }

    /// Time that the device takes to copy its outputs before SYNC0; 0 if the device does not report it.
    ///
    /// Real-time: yes.
    pub(crate) fn copy_time(&self) -> Duration {
        Duration::from_nanos(self.copy_ns.into())
    }

    pub(crate) fn is_done(&self) -> bool {
        self.next >= self.steps.len()
    }

    /// The next request; nothing when all is done.
    ///
    /// # Errors
    /// If what the device said before does not let the next step be made.
    pub(crate) fn wanted(&mut self) -> Result<Option<Wanted>, BootFailure> {
        let Some(step) = self.present()? else { return Ok(None) };
        let part = match self.stage {
            Stage::Compare(place) => self.steps.get(place).copied().unwrap_or(step),
            _ => step,
        };
        let written = match (self.stage, step.action) {
            (Stage::Write, Action::Bits { mask, value }) => Some(self.kept & !mask | value),
            (Stage::Write, action) => action.value().map(|value| value | self.kept & action.kept()),
            _ => None,
        };
        let written = written.map(|value| (value.to_le_bytes(), step.bytes));
        Ok(Some(Wanted { at: part.at(), written }))
    }

    /// Takes the answer to what was asked last: the bytes that were read, none after a write. Afterwards [`Script::wanted`] says what comes
    /// next, unless `again_at` lies ahead.
    ///
    /// # Errors
    /// Why the device cannot be used.
    pub(crate) fn on_answer(&mut self, now: Time, answer: Result<&[u8], ObjectError>) -> Result<(), BootFailure> {
        let Some(step) = self.present()? else { return Ok(()) };
        let Address { index, sub } = match self.stage {
            Stage::Compare(place) => self.steps.get(place).map_or(step.at(), Step::at),
            _ => step.at(),
        };
        match (answer, self.stage) {
            (Err(ObjectError::Aborted(code)), _) => self.on_abort(&step, code),
            (Err(_), _) => Err(BootFailure::NoAnswer { index, sub }),
            (Ok(_), Stage::Write) => {
                self.on_written(&step);
                Ok(())
            }
            (Ok(data), _) if data.len() > LONGEST => Err(BootFailure::Refused { index, sub, code: AbortCode::LENGTH }),
            (Ok(data), Stage::Compare(place)) => {
                self.on_compared(place, little_endian(data));
                Ok(())
            }
            (Ok(data), Stage::Look) => self.on_look(now, &step, little_endian(data)),
            (Ok(data), Stage::Verify(refused)) => self.on_read_back(&step, little_endian(data), refused),
        }
    }

    /// The present step, whose value may depend on what was read before. Steps that this makes needless are passed.
    fn present(&mut self) -> Result<Option<Step>, BootFailure> {
        while let Some(step) = self.steps.get(self.next).copied() {
            let action = match step.action {
                Action::LimitSpeed { counts_per_s } => {
                    Action::State { value: motor_speed(counts_per_s, self.resolution)?, kept: 0 }
                }
                Action::LimitCurrent { per_mille } => {
                    Action::State { value: CurrentLimit::value(per_mille, self.rated), kept: 0 }
                }
                Action::CycleTime { period_us, part } => match cycle_time(period_us, self.exponent, part)? {
                    Some(value) => Action::State { value, kept: 0 },
                    None => {
                        self.go_to(self.next + 1);
                        continue;
                    }
                },
                action => action,
            };
            return Ok(Some(Step { action, ..step }));
        }
        Ok(None)
    }

    /// Begins the step at a place.
    fn go_to(&mut self, place: usize) {
        self.next = place;
        self.given_up_at = Time::NEVER;
        let is_open = place < self.open_until;
        if !is_open {
            self.kept = 0;
        }
        self.stage = match self.steps.get(place).map(|step| step.action) {
            Some(Action::Command { .. } | Action::Off { .. }) => Stage::Write,
            Some(Action::State { .. }) if is_open => Stage::Write,
            Some(Action::Unit { steps }) => match self.part_before(place + 1 + steps) {
                Some(part) => Stage::Compare(part),
                None => return self.go_to(place + 1),
            },
            _ => Stage::Look,
        };
    }

    fn finish(&mut self, step: &Step) {
        tracing::debug!(object = %step.at(), "{}: done", step.doing);
        self.go_to(self.next + 1);
    }

    /// The last step before a place, but behind the present one, that says what an object of the present unit holds in the end.
    fn part_before(&self, place: usize) -> Option<usize> {
        let range = self.next + 1..place.min(self.steps.len());
        range.rev().find(|place| self.steps.get(*place).is_some_and(Step::is_part))
    }

    /// A part of the present unit was read.
    fn on_compared(&mut self, place: usize, received: u32) {
        let (Some(unit), Some(part)) = (self.steps.get(self.next), self.steps.get(place)) else { return };
        let end = match unit.action {
            Action::Unit { steps } => self.next + 1 + steps,
            _ => place,
        };
        if part.action.kept() != 0 {
            self.kept = received;
        }
        match self.part_before(place) {
            _ if !part.is_held(received) => self.open(end),
            Some(before) => self.stage = Stage::Compare(before),
            None => {
                tracing::debug!(object = %unit.at(), "{}: stands", unit.doing);
                self.go_to(end);
            }
        }
    }

    /// The present unit differs: its steps follow.
    fn open(&mut self, end: usize) {
        self.open_until = self.open_until.max(end);
        self.go_to(self.next + 1);
    }

    fn on_look(&mut self, now: Time, step: &Step, received: u32) -> Result<(), BootFailure> {
        if self.has_to_wait(now, step, received) {
            self.again_at = now + READ_AGAIN;
            return Ok(());
        }
        match step.action {
            Action::State { .. } | Action::SyncType { .. } if !step.is_held(received) => {
                self.stage = Stage::Write;
                return Ok(());
            }
            Action::Bits { .. } if !step.is_held(received) => {
                (self.kept, self.stage) = (received, Stage::Write);
                return Ok(());
            }
            Action::Resolution { part } => {
                if let Some(known) = self.resolution.get_mut(part) {
                    *known = received;
                }
            }
            Action::RatedCurrent => {
                self.rated = received & width_mask(step.bytes);
                check_current(step, received, self.rated)?;
            }
            Action::KeepsCurrent { .. } => check_current(step, received, self.rated)?,
            Action::Exponent => self.exponent = Some(received as u8 as i8),
            Action::CopyTime => self.copy_ns = received,
            _ => check(step, received, &self.identity)?,
        }
        self.finish(step);
        Ok(())
    }

    fn on_written(&mut self, step: &Step) {
        match step.action {
            Action::Off { .. } | Action::Command { is_verified: false, .. } => self.finish(step),
            _ => self.stage = Stage::Verify(None),
        }
    }

    fn on_read_back(&mut self, step: &Step, received: u32, refused: Option<AbortCode>) -> Result<(), BootFailure> {
        let Address { index, sub } = step.at();
        let wanted = match step.action {
            Action::Bits { mask, value } => self.kept & !mask | value,
            action => action.value().unwrap_or_default() | self.kept & action.kept(),
        };
        if step.is_held(received) {
            self.finish(step);
            return Ok(());
        }
        let source = self.steps.get(self.next).map(|step| step.action);
        Err(match (refused, source) {
            (Some(code), Some(Action::CycleTime { period_us, part: CyclePart::Exponent })) => {
                BootFailure::FixedExponent { index, sub, period_us, exponent: received as u8 as i8, code }
            }
            (Some(code), _) => BootFailure::Keeps { index, sub, held: received & width_mask(step.bytes), wanted, code },
            (None, _) => BootFailure::ReadBack { index, sub, written: wanted, received },
        })
    }

    /// The device has refused what was asked last.
    fn on_abort(&mut self, step: &Step, code: AbortCode) -> Result<(), BootFailure> {
        let Address { index, sub } = step.at();
        match (self.stage, step.action) {
            // The write shows whether it has the object.
            (Stage::Look, Action::State { .. }) => self.stage = Stage::Write,
            (Stage::Compare(_), Action::Unit { steps }) => self.open(self.next + 1 + steps),
            (Stage::Look, Action::Bits { .. } | Action::Exponent | Action::CopyTime) => self.finish(step),
            (Stage::Look, Action::SyncType { .. } | Action::Synchronised { .. }) if code.is_absent() => {
                self.finish(step);
            }
            (Stage::Write, Action::SyncType { .. }) if code.is_absent() || code.is_read_only() => self.finish(step),
            // A TPDO that allows no remote frames.
            (Stage::Write, action) if code == AbortCode::VALUE && action.kept() & !self.kept != 0 => {
                self.kept |= action.kept();
            }
            // The next steps show whether the device needs that.
            (Stage::Write, Action::Off { .. }) => self.finish(step),
            (Stage::Write, Action::State { .. } | Action::Bits { .. }) => self.stage = Stage::Verify(Some(code)),
            (Stage::Write, Action::Command { .. }) if code.is_read_only() => self.stage = Stage::Verify(Some(code)),
            (Stage::Verify(Some(refused)), _) => return Err(BootFailure::Refused { index, sub, code: refused }),
            _ => return Err(BootFailure::Refused { index, sub, code }),
        }
        Ok(())
    }

    /// Whether the object has not come to its value yet and has time to.
    fn has_to_wait(&mut self, now: Time, step: &Step, received: u32) -> bool {
        if !matches!(step.action, Action::Await { .. } | Action::Synchronised { .. }) {
            return false;
        }
        self.given_up_at = self.given_up_at.min(now + self.timeout);
        !step.is_held(received) && now < self.given_up_at
    }
}
