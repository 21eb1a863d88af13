//! TIME: the network time.
//!
//! # Source
//! CiA 301, time stamp object and data type TIME_OF_DAY.

use super::{CanopenError, Frame, cob};

pub use canopen_rs::time::TimeOfDay;

/// Makes TIME frames. When to send them, and where the time comes from, is not decided here.
#[derive(Clone, Copy, Debug)]
pub struct TimeProducer {
    id: u16,
}

impl TimeProducer {
    /// TIME at `id`.
    ///
    /// # Errors
    /// [`CanopenError::CobId`] for a restricted identifier.
    pub fn new(id: u16) -> Result<Self, CanopenError> {
        if cob::is_restricted(id.into()) { Err(CanopenError::CobId(id.into())) } else { Ok(TimeProducer { id }) }
    }

    /// The frame that tells `time`.
    ///
    /// Real-time: yes.
    pub fn frame(&self, time: TimeOfDay) -> Frame {
        Frame::new(self.id, &time.encode())
    }
}

/// The time in the payload of a TIME frame; `None` unless it has six bytes and less than a day of milliseconds.
///
/// Real-time: yes.
pub fn decode(frame: &Frame) -> Option<TimeOfDay> {
    let time = TimeOfDay::decode(<&[u8; 6]>::try_from(frame.data()).ok()?).ok()?;
    (time.milliseconds < canopen_rs::time::MS_PER_DAY).then_some(time)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn six_bytes_both_ways() {
        // 12:00 on the second day.
        let noon = TimeOfDay::new(43_200_000, 1);
        let frame = TimeProducer::new(0x100).unwrap().frame(noon);
        assert_eq!(frame, Frame::new(0x100, &[0x00, 0x2e, 0x93, 0x02, 0x01, 0x00]));
        assert_eq!(decode(&frame), Some(noon));
        assert_eq!(TimeProducer::new(0x101).unwrap_err(), CanopenError::CobId(0x101));
    }

    #[test]
    fn other_lengths_and_impossible_times_are_nothing() {
        for bytes in [&[][..], &[0; 5], &[0; 7], &[0x00, 0x5c, 0x26, 0x05, 0, 0]] {
            assert_eq!(decode(&Frame::new(0x100, bytes)), None);
        }
        assert_eq!(decode(&Frame::new(0x100, &[0xff, 0x5b, 0x26, 0xf5, 0, 0])), Some(TimeOfDay::new(86_399_999, 0)));
    }
}
