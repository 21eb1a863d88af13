//! Requests for objects by the drives of one device, which has one mailbox or one SDO server.

use yieldwall_drives::objects;
use yieldwall_drives::profiles::AxisOffset;
use yieldwall_fieldbus::objects::{Address, ObjectAnswer, ObjectError, ObjectRequest};
use yieldwall_motion::guard::Device;

/// Objects by which a simulated device shows itself.
const SIMULATION: std::ops::RangeInclusive<u16> = objects::SIMULATION_LACKS.index..=objects::SIMULATION_MARK.index;
/// Bytes of an answer that can wait for its drive; no object of a drive has more.
const LONGEST: usize = 8;

/// Turns of the drives of one device. Each names objects as those of a first axis.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Turns {
    /// Distances of the objects of the left and of the right drive.
    offsets: [AxisOffset; 2],
    /// The last device that has asked.
    asker: Option<Device>,
    /// Whether another one was refused since.
    waits: bool,
    /// Answers to the left and to the right drive from before the other one has asked.
    kept: [Kept; 2],
}

/// An answer that waits for its drive.
#[derive(Clone, Copy, Debug, Default)]
enum Kept {
    #[default]
    Nothing,
    Done([u8; LONGEST], usize),
    Failed(ObjectError),
}

impl Kept {
    fn of(answer: ObjectAnswer<'_>) -> Self {
        match answer {
            ObjectAnswer::Done(data) if data.len() <= LONGEST => {
                let mut bytes = [0; LONGEST];
                bytes.iter_mut().zip(data).for_each(|(to, byte)| *to = *byte);
                Self::Done(bytes, data.len())
            }
            ObjectAnswer::Failed(error) => Self::Failed(error),
            _ => Self::Nothing,
        }
    }

    fn answer(&self) -> ObjectAnswer<'_> {
        match self {
            Self::Nothing => ObjectAnswer::NotAsked,
            Self::Done(bytes, len) => ObjectAnswer::Done(bytes.get(..*len).unwrap_or_default()),
            Self::Failed(error) => ObjectAnswer::Failed(*error),
        }
    }
}

/// Place of a drive; `None` for a sensor, which shares its device with no other.
const fn place(device: Device) -> Option<usize> {
    match device {
        Device::LeftDrive => Some(0),
        Device::RightDrive => Some(1),
        Device::Sensor => None,
    }
}

impl Turns {
    /// Returns turns of drives whose objects have these offsets from the objects of the first axis.
    pub(super) fn new(offsets: [AxisOffset; 2]) -> Self {
        Self { offsets, ..Self::default() }
    }

    /// Forgets the waiting drives. The earlier request of the asking drive has ended.
    pub(super) fn restart(&mut self) {
        *self = Self { asker: self.asker, ..Self::new(self.offsets) };
    }

    /// A request of a device for an object of its axis.
    ///
    /// Real-time: yes.
    pub(super) fn moved<'a>(&self, device: Device, request: ObjectRequest<'a>) -> ObjectRequest<'a> {
        let offset = place(device).and_then(|place| self.offsets.get(place)).copied().unwrap_or_default();
        let moved = |at: Address| match at.index {
            // Objects by which a simulated device shows itself are of all axes.
            index if SIMULATION.contains(&index) => at,
            index => Address::new(offset.index(index), at.sub),
        };
        match request {
            ObjectRequest::Read(at) => ObjectRequest::Read(moved(at)),
            ObjectRequest::Write(at, data) => ObjectRequest::Write(moved(at), data),
        }
    }

    /// A device is about to ask; `last` is the answer to the last request. Its drive gets that later, if it has not taken it.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// [`ObjectError::Busy`] while another drive waits for its answer, and once where another one waits for its turn.
    pub(super) fn begin(&mut self, device: Device, last: ObjectAnswer<'_>) -> Result<(), ObjectError> {
        let Some(other) = self.asker.filter(|asker| *asker != device) else {
            return if std::mem::take(&mut self.waits) { Err(ObjectError::Busy) } else { Ok(()) };
        };
        if last == ObjectAnswer::Pending {
            self.waits = true;
            return Err(ObjectError::Busy);
        }
        if let Some(kept) = place(other).and_then(|place| self.kept.get_mut(place)) {
            *kept = Kept::of(last);
        }
        Ok(())
    }

    /// A device has asked.
    ///
    /// Real-time: yes.
    pub(super) fn note_asked(&mut self, device: Device) {
        (self.asker, self.waits) = (Some(device), false);
        if let Some(kept) = place(device).and_then(|place| self.kept.get_mut(place)) {
            *kept = Kept::Nothing;
        }
    }

    /// The answer to a device; `last` is that to the last request.
    ///
    /// Real-time: yes.
    pub(super) fn answer<'a>(&'a self, device: Device, last: ObjectAnswer<'a>) -> ObjectAnswer<'a> {
        if self.asker == Some(device) {
            return last;
        }
        place(device).and_then(|place| self.kept.get(place)).map_or(ObjectAnswer::NotAsked, Kept::answer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const READ: ObjectRequest<'static> = ObjectRequest::Read(Address::new(0x6041, 0));
    const LEFT: Device = Device::LeftDrive;
    const RIGHT: Device = Device::RightDrive;

    fn ask(turns: &mut Turns, device: Device, last: ObjectAnswer<'_>) -> Result<(), ObjectError> {
        turns.begin(device, last)?;
        turns.note_asked(device);
        Ok(())
    }

    #[test]
    fn each_drive_asks_for_objects_of_its_axis() {
        let profile = yieldwall_config::load_profile(yieldwall_config::builtin("vendors/profiles/three-axes.yaml"));
        let axes = profile.unwrap().value.servo().unwrap().axes.clone().unwrap();
        let turns = Turns::new([axes.offset(0), axes.offset(2)]);
        assert_eq!(turns.moved(LEFT, READ), READ);
        assert_eq!(turns.moved(RIGHT, READ), ObjectRequest::Read(Address::new(0x7041, 0)));
        let write = ObjectRequest::Write(Address::new(0x2200, 1), &[7]);
        assert_eq!(turns.moved(RIGHT, write), ObjectRequest::Write(Address::new(0x2400, 1), &[7]));
        assert_eq!(
            turns.moved(RIGHT, ObjectRequest::Read(Address::new(0x1001, 0))),
            ObjectRequest::Read(Address::new(0x1001, 0))
        );
    }

    #[test]
    fn drives_of_one_device_ask_in_turns_and_no_answer_is_lost() {
        let mut turns = Turns::default();
        assert_eq!(ask(&mut turns, LEFT, ObjectAnswer::NotAsked), Ok(()));
        assert_eq!(ask(&mut turns, RIGHT, ObjectAnswer::Pending), Err(ObjectError::Busy));
        let of_left = ObjectAnswer::Done(&[1, 2]);
        assert_eq!((turns.answer(LEFT, of_left), turns.answer(RIGHT, of_left)), (of_left, ObjectAnswer::NotAsked));
        // The left drive gives way once, and finds its answer later.
        assert_eq!(ask(&mut turns, LEFT, of_left), Err(ObjectError::Busy));
        assert_eq!(ask(&mut turns, RIGHT, of_left), Ok(()));
        assert_eq!(turns.answer(LEFT, ObjectAnswer::Pending), of_left);
        assert_eq!(turns.answer(RIGHT, ObjectAnswer::Pending), ObjectAnswer::Pending);
        let of_right = ObjectAnswer::Failed(ObjectError::NoAnswer);
        assert_eq!(ask(&mut turns, LEFT, of_right), Ok(()));
        assert_eq!(
            (turns.answer(LEFT, ObjectAnswer::Pending), turns.answer(RIGHT, ObjectAnswer::Pending)),
            (ObjectAnswer::Pending, of_right)
        );
        turns.restart();
        assert_eq!(turns.answer(LEFT, of_right), of_right);
        assert_eq!(turns.answer(RIGHT, of_right), ObjectAnswer::NotAsked);
    }

    #[test]
    fn one_drive_never_waits_for_another() {
        let mut turns = Turns::default();
        for last in [ObjectAnswer::NotAsked, ObjectAnswer::Pending, ObjectAnswer::Done(&[0; 64])] {
            assert_eq!(ask(&mut turns, RIGHT, last), Ok(()));
            assert_eq!(turns.answer(RIGHT, last), last);
        }
    }
}
