//! Two frames that are one sample.

use std::time::Duration;

use crate::canopen::Frame;
use crate::time::Time;

/// Puts the two frames of a sample together.
///
/// Neither protocol numbers both halves. Two frames form one sample if the second comes right behind the first: a half without its other is
/// dropped.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair {
    ids: [u16; 2],
    gap: Duration,
    first: Option<(Time, Frame)>,
}

impl Pair {
    pub(super) fn new(ids: [u16; 2], gap: Duration) -> Self {
        Self { ids, gap, first: None }
    }

    /// Whether a frame with this identifier is a half.
    pub(super) fn has(&self, id: u16) -> bool {
        self.ids.contains(&id)
    }

    /// Forgets a half that waits for its other.
    pub(super) fn clear(&mut self) {
        self.first = None;
    }

    /// Takes a half that has come at `now`; both, if it is a second one no more than the gap behind its first.
    pub(super) fn take(&mut self, now: Time, frame: &Frame) -> Option<[Frame; 2]> {
        let [first_id, _] = self.ids;
        if frame.id() == first_id {
            self.first = Some((now, *frame));
            return None;
        }
        let (at, first) = self.first.take()?;
        (now.since(at) <= self.gap).then_some([first, *frame])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GAP: Duration = Duration::from_micros(400);

    fn first(byte: u8) -> Frame {
        Frame::new(0x360, &[byte])
    }

    fn second(byte: u8) -> Frame {
        Frame::new(0x361, &[byte])
    }

    /// What comes of frames at moments in us.
    fn pairs(frames: &[(u64, Frame)]) -> Vec<[Frame; 2]> {
        let mut pair = Pair::new([0x360, 0x361], GAP);
        frames.iter().filter_map(|(at, frame)| pair.take(Time::from_micros(*at), frame)).collect()
    }

    #[test]
    fn a_second_right_behind_its_first_makes_a_pair() {
        let found = pairs(&[(0, first(1)), (400, second(1)), (5000, first(2)), (5131, second(2))]);
        assert_eq!(found, [[first(1), second(1)], [first(2), second(2)]]);
    }

    #[test]
    fn halves_of_two_samples_are_never_one() {
        // The second of 1 was lost, and so was the first of 2.
        assert_eq!(pairs(&[(0, first(1)), (5131, second(2))]), [] as [[Frame; 2]; 0]);
        // The first of 2 takes the place of that of 1.
        assert_eq!(pairs(&[(0, first(1)), (300, first(2)), (431, second(2))]), [[first(2), second(2)]]);
        // A second alone, and one more behind a pair.
        assert_eq!(pairs(&[(0, second(1)), (10, first(2)), (20, second(2)), (30, second(2))]).len(), 1);
    }
}
