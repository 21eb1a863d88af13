//! Observation of one cycle from outside: frames on the wire, the cycle's own report, and the simulated truth.
//!
//! Frames are decoded here by the literal layouts of the shipped profiles; nothing of the master or of the CANopen
//! engines is used for it.

use yieldwall_drives::cia402;

use super::segment::OnCableAt;
use yieldwall_fieldbus::canopen::Frame;
use yieldwall_motion::guard::{Fault, Request, State};

/// Sender of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sender {
    /// This program's master.
    Master,
    /// The drive of joint 0 (left) or 1 (right).
    Drive(usize),
    /// The force sensor.
    Sensor,
    /// Whoever else is on the bus.
    Stranger,
}

/// A frame, as it left its sender or as it arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sighting {
    /// End of the frame in ns since switching on.
    pub time_ns: u64,
    /// Sender of the frame; `None` for an arrival, whose sender is unknown.
    pub sender: Option<Sender>,
    /// The frame.
    pub frame: Frame,
}

/// State of the reference and the fixture, as the cycle reports it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reported {
    /// Force of the hand on the tool as sensed, N.
    pub force_n: [f64; 2],
    /// Proxy, m.
    pub proxy_m: [f64; 2],
    /// Angles that the proxy asks for, rad.
    pub target_rad: [f64; 2],
    /// Measured angles, rad.
    pub measured_rad: [f64; 2],
    /// Signed distance of the proxy from the surface, m.
    pub distance_m: f64,
    /// Whether the fixture keeps the proxy on the surface.
    pub is_on_surface: bool,
    /// Steps for which it is still held there.
    pub hold_counter: u32,
    /// Whether it met the surface in this cycle.
    pub is_impact: bool,
    /// Whether the torques reached their limit, and the proxy was drawn back.
    pub is_saturated: bool,
    /// Whether it took process data of each drive for those of this cycle.
    pub has_inputs: [bool; 2],
    /// Whether the cycle knew of each drive that it did not take the outputs of the cycle before.
    pub outputs_missed: [bool; 2],
}

/// State that only a simulation knows, at the moment of the computation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Angles of the joints, rad.
    pub angles_rad: [f64; 2],
    /// Tool point at SYNC, m.
    pub tool_m: [f64; 2],
    /// Velocity of the tool at SYNC, m/s.
    pub velocity_m_per_s: [f64; 2],
    /// Force of the hand on the tool at SYNC, N.
    pub hand_n: [f64; 2],
    /// Torques of the drives, N m.
    pub torques_n_m: [f64; 2],
    /// States of the drives.
    pub drives: [cia402::State; 2],
}

/// Values that injected faults falsify while they last, so that a judgement over them has no meaning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Falsified {
    /// The sensed force is not the hand's.
    pub force: bool,
    /// The reported angles are not the joints'.
    pub angles: bool,
    /// The drives do not obey their commands.
    pub drives: bool,
    /// The hand shakes the tool faster than its force is sensed in step with the motion.
    pub hand: bool,
    /// The arm is held or pushed by something other than the hand and the drives.
    pub arm: bool,
    /// SYNC or the computation do not come at their time, or not at all.
    pub timing: bool,
    /// The host's frames do not reach the wire.
    pub link: bool,
    /// The watchdogs of the drives may be others than the master has set.
    pub watchdog: bool,
}

impl Falsified {
    /// Joins the values that either falsifies.
    pub fn join(&mut self, other: Self) {
        self.force |= other.force;
        self.angles |= other.angles;
        self.drives |= other.drives;
        self.hand |= other.hand;
        self.arm |= other.arm;
        self.timing |= other.timing;
        self.link |= other.link;
        self.watchdog |= other.watchdog;
    }
}

/// One cycle, from the end of the computation before it to the end of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// Number of the cycle since the boot.
    pub cycle: u32,
    /// Moment of its SYNC in ns since switching on.
    pub sync_ns: u64,
    /// Request of the person.
    pub request: Request,
    /// The supervisor's state after it.
    pub state: State,
    /// Fault that led to the state.
    pub cause: Option<Fault>,
    /// Whether a cycle ran; if not, all but the frames and the truth is that of the last one.
    pub ran: bool,
    /// All frames on CAN since the computation before: first the set-points of the cycle before, then SYNC and what follows.
    pub frames: Vec<Sighting>,
    /// Events on the cable of a segment since the computation before: the output frame of the cycle before, the input frame, and
    /// the replies.
    pub on_cable: Vec<OnCableAt>,
    /// The cycle's own report.
    pub reported: Reported,
    /// True state.
    pub truth: Truth,
    /// Values that are falsified now.
    pub falsified: Falsified,
    /// Most frames that ever waited in one port of the bus.
    pub queue_high_water: usize,
    /// Frames lost so far because a queue was full.
    pub queue_lost: u64,
}

/// A set-point: 6040h, then 6071h (4 bytes), or 607Ah or 60FFh (6 bytes).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setpoint {
    /// Controlword.
    pub controlword: u16,
    /// Target torque in per mille, position in counts or rate in counts per second.
    pub target: i32,
}

impl Setpoint {
    /// Decodes an RPDO of a drive; `None` for another length.
    pub fn decode(frame: &Frame) -> Option<Self> {
        Self::of(frame.data())
    }

    /// Decodes the process data for a drive; `None` for another length.
    pub(super) fn of(data: &[u8]) -> Option<Self> {
        match *data {
            [a, b, c, d] => {
                Some(Self { controlword: u16::from_le_bytes([a, b]), target: i32::from(i16::from_le_bytes([c, d])) })
            }
            [a, b, c, d, e, f] => {
                Some(Self { controlword: u16::from_le_bytes([a, b]), target: i32::from_le_bytes([c, d, e, f]) })
            }
            _ => None,
        }
    }

    /// Whether the controlword is Enable Operation: bits 0 to 3 set, bit 7 not.
    pub fn enables(&self) -> bool {
        self.controlword & 0x8f == 0x0f
    }

    /// Whether bit 7, fault reset, is set.
    pub fn resets(&self) -> bool {
        self.controlword & 0x80 != 0
    }
}

/// Report of a drive: 6041h, 6064h.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    /// Statusword.
    pub statusword: u16,
    /// Actual position in counts.
    pub position: i32,
}

impl Status {
    /// Decodes a TPDO of a drive; `None` for another length.
    pub fn decode(frame: &Frame) -> Option<Self> {
        Self::of(frame.data())
    }

    /// Decodes the process data of a drive; `None` for another length.
    pub(super) fn of(data: &[u8]) -> Option<Self> {
        let &[a, b, c, d, e, f] = data else { return None };
        Some(Self { statusword: u16::from_le_bytes([a, b]), position: i32::from_le_bytes([c, d, e, f]) })
    }

    /// Whether the drive is in Operation Enabled.
    pub fn is_enabled(&self) -> bool {
        self.statusword & 0x6f == 0x27
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn literal_frames() {
        let torque = Setpoint::decode(&Frame::new(0x201, &[0x0f, 0x00, 0x18, 0xfc])).unwrap();
        assert_eq!((torque.controlword, torque.target, torque.enables(), torque.resets()), (0x0f, -1000, true, false));
        let position = Setpoint::decode(&Frame::new(0x202, &[0x80, 0, 0x00, 0x00, 0x00, 0x80])).unwrap();
        assert_eq!((position.target, position.enables(), position.resets()), (i32::MIN, false, true));
        assert_eq!(Setpoint::decode(&Frame::new(0x201, &[0x0f, 0, 0])), None);
        let status = Status::decode(&Frame::new(0x181, &[0x37, 0x16, 0xff, 0xff, 0xff, 0xff])).unwrap();
        assert_eq!((status.position, status.is_enabled()), (-1, true));
        assert!(!Status::decode(&Frame::new(0x181, &[0x07, 0, 0, 0, 0, 0])).unwrap().is_enabled());
        assert_eq!(Status::decode(&Frame::new(0x181, &[0x37])), None);
    }
}
