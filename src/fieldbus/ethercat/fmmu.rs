//! FMMU: how a device maps logical addresses onto its memory.

use super::{array, u16_at, u32_at};

/// Direction of the data through an FMMU, as the master sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// The master reads.
    Read,
    /// The master writes.
    Write,
}

/// One FMMU, 16 bytes of registers. It maps bits: from `start_bit` of the first logical byte to `end_bit` of the last one, onto
/// memory from `physical_bit` of byte `physical` on.
///
/// # Source
/// ETG.1000.4, 6.6.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Fmmu {
    /// First logical byte.
    pub logical: u32,
    /// Logical bytes that it touches.
    pub len: u16,
    /// First bit of the first byte, 0 to 7.
    pub start_bit: u8,
    /// Last bit of the last byte, 0 to 7.
    pub end_bit: u8,
    /// First byte of memory.
    pub physical: u16,
    /// First bit of that byte, 0 to 7.
    pub physical_bit: u8,
    /// Whether the master reads through it.
    pub reads: bool,
    /// Whether the master writes through it.
    pub writes: bool,
    /// Whether it is in use.
    pub is_active: bool,
}

impl Fmmu {
    /// Bytes of registers.
    pub const SIZE: usize = 16;

    /// Creates an FMMU that maps whole bytes.
    pub const fn bytes(logical: u32, len: u16, physical: u16, direction: Direction) -> Self {
        let reads = matches!(direction, Direction::Read);
        Fmmu {
            logical,
            len,
            start_bit: 0,
            end_bit: 7,
            physical,
            physical_bit: 0,
            reads,
            writes: !reads,
            is_active: true,
        }
    }

    /// Reads an FMMU from its registers.
    pub fn decode(bytes: &[u8; Self::SIZE]) -> Self {
        let [start_bit, end_bit] = array(bytes, 6);
        let [physical_bit, kind, activate] = array(bytes, 10);
        Fmmu {
            logical: u32_at(bytes, 0),
            len: u16_at(bytes, 4),
            start_bit: start_bit & 7,
            end_bit: end_bit & 7,
            physical: u16_at(bytes, 8),
            physical_bit: physical_bit & 7,
            reads: kind & 1 != 0,
            writes: kind & 2 != 0,
            is_active: activate & 1 != 0,
        }
    }

    /// Its registers.
    pub fn encode(&self) -> [u8; Self::SIZE] {
        let [a, b, c, d] = self.logical.to_le_bytes();
        let [e, f] = self.len.to_le_bytes();
        let [g, h] = self.physical.to_le_bytes();
        let kind = u8::from(self.reads) | u8::from(self.writes) << 1;
        let activate = u8::from(self.is_active);
        [a, b, c, d, e, f, self.start_bit & 7, self.end_bit & 7, g, h, self.physical_bit & 7, kind, activate, 0, 0, 0]
    }

    /// Whether it maps whole bytes onto whole bytes.
    pub const fn is_bytewise(&self) -> bool {
        self.start_bit == 0 && self.end_bit == 7 && self.physical_bit == 0
    }

    /// Returns the bits that it maps; 0 for one that ends before it begins.
    pub const fn bit_len(&self) -> u32 {
        if self.len == 0 {
            return 0;
        }
        ((self.len as u32 - 1) * 8 + self.end_bit as u32 + 1).saturating_sub(self.start_bit as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_bytes_both_ways() {
        let outputs = Fmmu::bytes(0x0001_0000, 13, 0x1800, Direction::Write);
        let bytes = [0x00, 0x00, 0x01, 0x00, 0x0d, 0x00, 0x00, 0x07, 0x00, 0x18, 0x00, 0x02, 0x01, 0, 0, 0];
        assert_eq!(outputs.encode(), bytes);
        assert_eq!(Fmmu::decode(&bytes), outputs);
        let inputs = Fmmu::bytes(0x11, 1, 0x080d, Direction::Read);
        assert_eq!(inputs.encode()[8..13], [0x0d, 0x08, 0x00, 0x01, 0x01]);
    }

    #[test]
    fn bits_are_counted_from_the_first_to_the_last() {
        let flag = Fmmu { start_bit: 3, end_bit: 3, physical_bit: 0, ..Fmmu::bytes(0, 1, 0x080d, Direction::Read) };
        assert_eq!((flag.bit_len(), flag.is_bytewise()), (1, false));
        let across = Fmmu { start_bit: 6, end_bit: 1, physical_bit: 5, len: 2, ..flag };
        assert_eq!(across.bit_len(), 4);
        let empty = Fmmu { start_bit: 5, end_bit: 4, ..flag };
        assert_eq!((empty.bit_len(), Fmmu::default().bit_len()), (0, 0));
        assert_eq!(Fmmu::bytes(0, 13, 0, Direction::Read).bit_len(), 104);
    }
}
