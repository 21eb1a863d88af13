//! Producing SYNC.

use canopen_rs::SyncCounter;

use super::{CanopenError, Frame, cob};

/// Makes SYNC frames, with a counter if wanted. When to send them is the master's cycle, not decided here.
#[derive(Clone, Debug)]
pub struct SyncProducer {
    id: u16,
    counter: SyncCounter,
}

impl SyncProducer {
    /// Creates a producer of SYNC at `id`, counting 1 to `overflow` (1019h: 2 to 240), or without a counter for 0.
    ///
    /// # Errors
    /// [`CanopenError::SyncOverflow`], or [`CanopenError::CobId`] for a restricted identifier.
    pub fn new(id: u16, overflow: u8) -> Result<Self, CanopenError> {
        if cob::is_restricted(id.into()) {
            return Err(CanopenError::CobId(id.into()));
        }
        let counter = SyncCounter::new(overflow).map_err(|_| CanopenError::SyncOverflow(overflow))?;
        Ok(SyncProducer { id, counter })
    }

    /// Returns the next SYNC frame.
    ///
    /// Real-time: yes.
    pub fn next_frame(&mut self) -> Frame {
        match self.counter.advance() {
            Some(count) => Frame::new(self.id, &[count]),
            None => Frame::new(self.id, &[]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_from_1_to_the_overflow_value() {
        let mut sync = SyncProducer::new(0x80, 3).unwrap();
        let counts = [(); 4].map(|()| sync.next_frame().data()[0]);
        assert_eq!(counts, [1, 2, 3, 1]);
    }

    #[test]
    fn is_empty_without_a_counter() {
        assert_eq!(SyncProducer::new(0x80, 0).unwrap().next_frame(), Frame::new(0x80, &[]));
        assert_eq!(SyncProducer::new(0x80, 1).unwrap_err(), CanopenError::SyncOverflow(1));
        assert_eq!(SyncProducer::new(0x80, 241).unwrap_err(), CanopenError::SyncOverflow(241));
        assert_eq!(SyncProducer::new(0x601, 0).unwrap_err(), CanopenError::CobId(0x601));
    }
}
