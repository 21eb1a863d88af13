//! TIME: the network time.
//!
//! # Source
//! CiA 301, time stamp object and data type TIME_OF_DAY.

use super::Frame;

pub use canopen_rs::time::TimeOfDay;

/// Returns the time in the payload of a TIME frame; `None` unless it has six bytes and less than a day of milliseconds.
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
    fn six_bytes_are_milliseconds_and_days() {
        // 12:00 on the second day.
        let noon = Frame::new(0x100, &[0x00, 0x2e, 0x93, 0x02, 0x01, 0x00]);
        assert_eq!(decode(&noon), Some(TimeOfDay::new(43_200_000, 1)));
    }

    #[test]
    fn other_lengths_and_impossible_times_are_nothing() {
        for bytes in [&[][..], &[0; 5], &[0; 7], &[0x00, 0x5c, 0x26, 0x05, 0, 0]] {
            assert_eq!(decode(&Frame::new(0x100, bytes)), None);
        }
        assert_eq!(decode(&Frame::new(0x100, &[0xff, 0x5b, 0x26, 0xf5, 0, 0])), Some(TimeOfDay::new(86_399_999, 0)));
    }
}
