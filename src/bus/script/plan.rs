//! The plan of one device: the objects that the boot would write, by the steps that the boot itself takes.

use super::{Action, Step, check, check_current, cycle_time, little_endian, motor_speed, width_mask};
use crate::error::BootFailure;
use yieldwall_drives::profiles::{CurrentLimit, Identity};
use yieldwall_fieldbus::objects::Address;

/// An object that the boot writes, unless it holds the value already.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlannedWrite {
    /// Purpose of the request.
    pub doing: &'static str,
    /// The object.
    pub at: Address,
    /// Its bytes before, as far as they could be read.
    pub old: Option<Vec<u8>>,
    /// The bytes that are written; `None` where they depend on an object that could not be read.
    pub new: Option<Vec<u8>>,
    /// Whether it holds them already, so that it is not written, unless the reset changes it.
    pub stands: bool,
}

/// All objects that the boot reads and writes of one device.
#[derive(Clone, Debug)]
pub struct ScriptPlan {
    steps: Vec<Step>,
    identity: Identity,
}

/// Why the boot would refuse a device, and in which step.
pub type PlannedRefusal = (&'static str, BootFailure);

/// Values that a node has reported, from which later values are computed.
#[derive(Clone, Copy, Debug, Default)]
struct Told {
    resolution: [Option<u32>; 2],
    rated: Option<u32>,
    exponent: Option<i8>,
}

impl Told {
    fn hear(&mut self, action: Action, held: u32) {
        match action {
            Action::Exponent => self.exponent = Some(held as u8 as i8),
            Action::RatedCurrent => self.rated = Some(held),
            Action::Resolution { part } => {
                if let Some(known) = self.resolution.get_mut(part) {
                    *known = Some(held);
                }
            }
            _ => {}
        }
    }

    /// The value that an action writes; `None` where it depends on a value that the node has not reported.
    fn value(&self, action: Action) -> Result<Option<u32>, BootFailure> {
        match (action, self.resolution) {
            (Action::LimitSpeed { counts_per_s }, [Some(increments), Some(revolutions)]) => {
                motor_speed(counts_per_s, [increments, revolutions]).map(Some)
            }
            (Action::LimitCurrent { per_mille }, _) => {
                Ok(self.rated.map(|rated| CurrentLimit::value(per_mille, rated)))
            }
            (Action::CycleTime { period_us, part }, _) => {
                let held = self.exponent.map(|exponent| u32::from(exponent as u8));
                cycle_time(period_us, self.exponent, part).map(|value| value.or(held))
            }
            (action, _) => Ok(action.value()),
        }
    }
}

impl ScriptPlan {
    pub(crate) fn new(steps: &[Step], identity: &Identity) -> Self {
        Self { steps: steps.to_vec(), identity: identity.clone() }
    }

    /// All that is written or stands already, in its order, for a device whose objects hold what `read` says; and why the boot would refuse
    /// the device, if it would. A refusal by the device itself shows only when it is written to.
    pub fn writes(
        &self,
        mut read: impl FnMut(Address) -> Option<Vec<u8>>,
    ) -> (Vec<PlannedWrite>, Result<(), PlannedRefusal>) {
        let mut told = Told::default();
        let mut writes: Vec<PlannedWrite> = Vec::new();
        let mut refused = Ok(());
        // Ends of the units that stand, and of those that are written.
        let (mut stands_until, mut open_until) = (0, 0);
        for (place, step) in self.steps.iter().enumerate() {
            let at = step.at();
            if let Action::Unit { steps } = step.action {
                let end = place + 1 + steps;
                let until = if self.stands(place, end, &mut read) { &mut stands_until } else { &mut open_until };
                *until = end.max(*until);
                continue;
            }
            let is_passed = step.action.is_late() || matches!(step.action, Action::Off { .. }) && place < stands_until;
            if is_passed {
                continue;
            }
            let written = writes.iter().rev().find(|write| write.at == at && !write.stands);
            let old = written.and_then(|write| write.new.clone()).or_else(|| read(at));
            let held = old.as_ref().map(|held| little_endian(held));
            if !step.action.writes() {
                let Some(held) = held else { continue };
                if let (Action::Bits { mask, value }, false) = (step.action, step.is_held(held)) {
                    let new = Some((held & !mask | value).to_le_bytes().to_vec());
                    writes.push(PlannedWrite { doing: step.doing, at, old, new, stands: false });
                    continue;
                }
                told.hear(step.action, held);
                let checked = check(step, held, &self.identity);
                let checked =
                    checked.and_then(|()| told.rated.map_or(Ok(()), |rated| check_current(step, held, rated)));
                refused = refused.and(checked.map_err(|failure| (step.doing, failure)));
                continue;
            }
            let new = told.value(step.action).unwrap_or_else(|failure| {
                refused = refused.clone().and(Err((step.doing, failure)));
                None
            });
            let new = new.map(|value| value | held.unwrap_or_default() & step.action.kept());
            let is_same = held.zip(new).is_some_and(|(held, new)| (held ^ new) & width_mask(step.bytes) == 0);
            let stands = place < stands_until || is_same && step.action.is_state() && place >= open_until;
            let new = new.map(|value| value.to_le_bytes().into_iter().take(step.bytes.into()).collect());
            writes.push(PlannedWrite { doing: step.doing, at, old, new, stands });
        }
        (writes, refused)
    }

    /// Whether all objects of the unit at a place hold already what they have at its end.
    fn stands(&self, place: usize, end: usize, mut read: impl FnMut(Address) -> Option<Vec<u8>>) -> bool {
        let parts = self.steps.iter().take(end).skip(place + 1).filter(|step| step.is_part());
        parts.rev().all(|step| read(step.at()).is_some_and(|held| step.is_held(little_endian(&held))))
    }
}
