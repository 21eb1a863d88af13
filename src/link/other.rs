//! Frames on a CAN bus other than CANopen.

use std::fmt;

/// A frame with a 29-bit identifier or of CAN FD, which CANopen does not use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OtherFrame {
    /// Identifier, of 29 bits or of 11.
    pub id: u32,
    /// Whether the identifier has 29 bits.
    pub is_extended: bool,
    /// Whether it is a frame of CAN FD.
    pub is_fd: bool,
    /// Bytes of data, 0 to 64.
    pub length: u8,
}

impl fmt::Display for OtherFrame {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = if self.is_fd { "frame of CAN FD" } else { "frame" };
        let identifier = if self.is_extended { "29-bit" } else { "11-bit" };
        write!(out, "{kind} with {identifier} identifier, {} bytes: none of CANopen", self.length)
    }
}

/// Number of frames other than CANopen, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OtherTraffic {
    /// Frames with 29-bit identifiers that are not of CAN FD.
    pub extended: u64,
    /// Frames of CAN FD.
    pub fd: u64,
}

impl OtherTraffic {
    /// Counts a frame.
    pub fn count(&mut self, frame: &OtherFrame) {
        *if frame.is_fd { &mut self.fd } else { &mut self.extended } += 1;
    }

    /// Whether there was none.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// `412 frames with 29-bit identifiers and 1 frame of CAN FD`.
impl fmt::Display for OtherTraffic {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let frames = |count: u64| if count == 1 { "frame" } else { "frames" };
        let Self { extended, fd } = *self;
        if extended > 0 || fd == 0 {
            let identifiers = if extended == 1 { "a 29-bit identifier" } else { "29-bit identifiers" };
            write!(out, "{extended} {} with {identifiers}", frames(extended))?;
        }
        let and = if extended > 0 { " and " } else { "" };
        if fd > 0 { write!(out, "{and}{fd} {} of CAN FD", frames(fd)) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_counted_and_named_by_kind() {
        let mut all = OtherTraffic::default();
        assert!(all.is_none());
        let frame = |is_extended, is_fd| OtherFrame { id: 0x18ff_1234, is_extended, is_fd, length: 8 };
        all.count(&frame(true, false));
        assert_eq!(all.to_string(), "1 frame with a 29-bit identifier");
        all.count(&frame(true, false));
        assert_eq!(all.to_string(), "2 frames with 29-bit identifiers");
        all.count(&frame(true, true));
        all.count(&frame(false, true));
        assert_eq!(all, OtherTraffic { extended: 2, fd: 2 });
        assert_eq!(all.to_string(), "2 frames with 29-bit identifiers and 2 frames of CAN FD");
        assert_eq!(OtherTraffic { extended: 0, fd: 1 }.to_string(), "1 frame of CAN FD");
    }
}
