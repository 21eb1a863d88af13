//! What an observer on the bus sees. It decodes frames by the literal layouts of the shipped profiles and knows nothing
//! of the master's mind.

use yieldwall::canopen::Frame;
use yieldwall::time::Time;

/// Node ids of the drives, left and right.
pub const DRIVE_NODES: [u16; 2] = [1, 2];
/// Node id of the force sensor.
pub const SENSOR_NODE: u16 = 10;

/// A frame at the end of its transmission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ObservedFrame {
    /// End of the frame.
    pub time: Time,
    /// The frame.
    pub frame: Frame,
}

/// What an RPDO told a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setpoint {
    /// End of the frame.
    pub time: Time,
    /// Controlword.
    pub controlword: u16,
    /// Target torque in per mille (4 bytes), or target position in counts or velocity in counts per second (6 bytes).
    pub target: i32,
}

impl Setpoint {
    /// Whether the controlword is Enable Operation.
    pub fn enables(&self) -> bool {
        self.controlword & 0x8f == 0x0f
    }
}

/// What a TPDO of a drive told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    /// End of the frame.
    pub time: Time,
    /// Statusword.
    pub statusword: u16,
    /// Actual position in counts.
    pub position: i32,
}

impl Status {
    /// Whether the drive is in Operation Enabled.
    pub fn is_enabled(&self) -> bool {
        self.statusword & 0x6f == 0x27
    }
}

/// All frames in the order on the wire.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// The frames.
    pub frames: Vec<ObservedFrame>,
}

impl Recording {
    pub(crate) fn push(&mut self, time: Time, frame: &Frame) {
        self.frames.push(ObservedFrame { time, frame: *frame });
    }

    /// Frames with identifier `id`.
    pub fn with_id(&self, id: u16) -> impl Iterator<Item = &ObservedFrame> {
        self.frames.iter().filter(move |seen| seen.frame.id() == id)
    }

    /// The set-points sent to drive `joint` (0 left, 1 right).
    pub fn setpoints(&self, joint: usize) -> Vec<Setpoint> {
        self.with_id(0x200 + DRIVE_NODES[joint]).map(setpoint).collect()
    }

    /// What drive `joint` (0 left, 1 right) reported.
    pub fn statuses(&self, joint: usize) -> Vec<Status> {
        self.with_id(0x180 + DRIVE_NODES[joint]).map(status).collect()
    }

    /// The exchange cut at every SYNC: what was seen from one SYNC, itself included, to before the next. What comes before
    /// the first SYNC is left out.
    pub fn cycles(&self) -> Vec<&[ObservedFrame]> {
        let starts: Vec<usize> = (0..self.frames.len()).filter(|&at| self.frames[at].frame.id() == 0x080).collect();
        let ends = starts.iter().skip(1).copied().chain([self.frames.len()]);
        starts.iter().zip(ends).map(|(&start, end)| &self.frames[start..end]).collect()
    }
}

/// Decodes an RPDO of a drive: 6040h, then 6071h (4 bytes), or 607Ah or 60FFh (6 bytes).
pub fn setpoint(seen: &ObservedFrame) -> Setpoint {
    let target = match *seen.frame.data() {
        [_, _, a, b] => i32::from(i16::from_le_bytes([a, b])),
        [_, _, a, b, c, d] => i32::from_le_bytes([a, b, c, d]),
        ref other => panic!("an RPDO of {} bytes", other.len()),
    };
    let bytes = seen.frame.bytes();
    Setpoint { time: seen.time, controlword: u16::from_le_bytes([bytes[0], bytes[1]]), target }
}

/// Decodes a TPDO of a drive: 6041h, 6064h.
pub fn status(seen: &ObservedFrame) -> Status {
    let &[a, b, c, d, e, f] = seen.frame.data() else { panic!("a TPDO of {} bytes", seen.frame.len()) };
    Status { time: seen.time, statusword: u16::from_le_bytes([a, b]), position: i32::from_le_bytes([c, d, e, f]) }
}
