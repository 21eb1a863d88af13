//! Positions of the mapped objects in a PDO.

use canopen_rs::MappingEntry;

use super::super::{CanopenError, NodeId};
use crate::objects::{mask, sign_extend};

/// The bits of one mapped object within a PDO seen as a little-endian word.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Field {
    shift: u8,
    bits: u8,
}

impl Field {
    /// Returns the bits `shift` to `shift + bits - 1`; `None` if they do not lie within 64 bits or are none.
    pub const fn new(shift: u8, bits: u8) -> Option<Self> {
        if bits == 0 || shift > 63 || bits > 64 - shift { None } else { Some(Field { shift, bits }) }
    }

    /// Returns the position of the lowest bit, 0 to 63.
    pub const fn shift(self) -> u8 {
        self.shift
    }

    /// Returns the number of bits, 1 to 64.
    pub const fn bits(self) -> u8 {
        self.bits
    }

    /// Returns the unsigned value in `word`.
    ///
    /// Real-time: yes.
    pub const fn get_unsigned(self, word: u64) -> u64 {
        (word >> self.shift) & mask(self.bits)
    }

    /// Returns the two's complement value in `word`.
    ///
    /// Real-time: yes.
    pub const fn get_signed(self, word: u64) -> i64 {
        sign_extend(word >> self.shift, self.bits)
    }

    /// Puts an unsigned value into `word`; a value that does not fit becomes the largest one that does.
    ///
    /// Real-time: yes.
    pub const fn put_unsigned(self, word: &mut u64, value: u64) {
        let top = mask(self.bits);
        self.put_bits(word, if value > top { top } else { value });
    }

    /// Puts a signed value into `word`; a value that does not fit becomes the nearest one that does.
    ///
    /// Real-time: yes.
    pub const fn put_signed(self, word: &mut u64, value: i64) {
        let top = (mask(self.bits) >> 1) as i64;
        let kept = if value > top {
            top
        } else if value < -top - 1 {
            -top - 1
        } else {
            value
        };
        self.put_bits(word, kept as u64);
    }

    /// Puts the low bits of `raw` into `word`.
    ///
    /// Real-time: yes.
    pub const fn put_bits(self, word: &mut u64, raw: u64) {
        let mask = mask(self.bits);
        *word = (*word & !(mask << self.shift)) | ((raw & mask) << self.shift);
    }
}

/// Whether `index` is a dummy object: a data type 0001h to 0007h mapped to skip bits.
///
/// # Source
/// CiA 301, RPDO mapping: dummy entries.
pub const fn is_dummy(index: u16) -> bool {
    index >= 0x0001 && index <= 0x0007
}

/// A PDO mapping compiled to bit positions; entries follow each other from bit 0 on.
///
/// Shared by both sides of the bus, so that what the master packs is what a device unpacks.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Layout {
    entries: Vec<(MappingEntry, Field)>,
    bits: u8,
}

impl Layout {
    /// Objects as (index, sub-index, bits), in the order of the mapping record. Dummy objects 0001h to 0007h skip
    /// their bits.
    ///
    /// # Errors
    /// [`CanopenError::PdoBits`] for more than 64 bits, [`CanopenError::NotMappable`] for an entry of no bits.
    pub fn new(objects: &[(u16, u8, u8)]) -> Result<Self, CanopenError> {
        let total: u32 = objects.iter().map(|object| u32::from(object.2)).sum();
        let mut layout = Layout { entries: Vec::with_capacity(objects.len()), bits: 0 };
        for &(index, sub, bits) in objects {
            if bits == 0 {
                return Err(CanopenError::NotMappable { index, sub, bits });
            }
            let field = Field::new(layout.bits, bits).ok_or(CanopenError::PdoBits(total))?;
            layout.entries.push((MappingEntry::new(index, sub, bits), field));
            layout.bits += bits;
        }
        Ok(layout)
    }

    /// Returns the position of an object; `None` if it is not mapped or a dummy. An object mapped twice has its first position.
    pub fn field(&self, index: u16, sub: u8) -> Option<Field> {
        let wanted = |entry: &MappingEntry| entry.address.index == index && entry.address.subindex == sub;
        self.entries.iter().find(|(entry, _)| wanted(entry) && !is_dummy(index)).map(|&(_, field)| field)
    }

    /// Returns the mapping entries and their places, in order.
    pub fn entries(&self) -> &[(MappingEntry, Field)] {
        &self.entries
    }

    /// Returns the total length in bits, 0 to 64.
    pub const fn bits(&self) -> u8 {
        self.bits
    }

    /// Returns the length of the CAN frame in bytes, 0 to 8.
    pub const fn len(&self) -> u8 {
        self.bits.div_ceil(8)
    }

    /// Whether nothing is mapped.
    pub const fn is_empty(&self) -> bool {
        self.bits == 0
    }
}

/// The parameters of one PDO as a device declares them by default.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PdoParameters {
    /// 14xxh/18xxh:1. Bit 31 set: the PDO is not used.
    pub cob_id: u32,
    /// 14xxh/18xxh:2. 0 to 240 synchronous, 254 and 255 event-driven.
    pub transmission_type: u8,
    /// 18xxh:3 in 100 us: shortest time between two event-driven TPDOs; not used by RPDOs.
    pub inhibit_time_100_us: u16,
    /// 14xxh/18xxh:5 in ms: of an RPDO the longest time between two frames, of an event-driven TPDO the longest time
    /// without one; 0 for none.
    pub event_timer_ms: u16,
    /// Objects as (index, sub-index, bits).
    pub mapping: Vec<(u16, u8, u8)>,
}

impl PdoParameters {
    /// Synchronous PDO (type 1: each SYNC) at `cob_id`.
    pub fn synchronous(cob_id: u16, mapping: &[(u16, u8, u8)]) -> Self {
        PdoParameters {
            cob_id: cob_id.into(),
            transmission_type: 1,
            inhibit_time_100_us: 0,
            event_timer_ms: 0,
            mapping: mapping.to_vec(),
        }
    }

    /// Creates an event-driven PDO (type 255) at `cob_id`.
    pub fn event_driven(cob_id: u16, mapping: &[(u16, u8, u8)]) -> Self {
        PdoParameters { transmission_type: 255, ..Self::synchronous(cob_id, mapping) }
    }

    /// Switches the PDO off (bit 31 of its COB-ID) until a master configures it.
    pub fn unused(mut self) -> Self {
        self.cob_id |= super::super::cob::INVALID;
        self
    }

    /// Returns the default RPDO `number` of CiA 301 for `node`, synchronous.
    ///
    /// # Errors
    /// A number outside 1 to 4.
    pub fn default_rpdo(number: u8, node: NodeId, mapping: &[(u16, u8, u8)]) -> Result<Self, CanopenError> {
        let cob_id = super::super::cob::rpdo(number, node).ok_or(CanopenError::PdoNumber(number))?;
        Ok(Self::synchronous(cob_id, mapping))
    }

    /// Returns the default TPDO `number` of CiA 301 for `node`, synchronous.
    ///
    /// # Errors
    /// A number outside 1 to 4.
    pub fn default_tpdo(number: u8, node: NodeId, mapping: &[(u16, u8, u8)]) -> Result<Self, CanopenError> {
        let cob_id = super::super::cob::tpdo(number, node).ok_or(CanopenError::PdoNumber(number))?;
        Ok(Self::synchronous(cob_id, mapping))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn fields_follow_each_other_from_bit_0() {
        let layout = Layout::new(&[(0x6040, 0, 16), (0x0006, 0, 16), (0x607a, 0, 32)]).unwrap();
        assert_eq!(layout.field(0x6040, 0), Field::new(0, 16));
        assert_eq!(layout.field(0x607a, 0), Field::new(32, 32));
        assert_eq!((layout.field(0x0006, 0), layout.field(0x6040, 1)), (None, None));
        assert_eq!((layout.bits(), layout.len(), layout.is_empty()), (64, 8, false));
        assert_eq!(layout.entries()[1].0.to_u32(), 0x0006_0010);
    }

    #[test]
    fn at_most_64_bits_and_none_empty() {
        assert_eq!(Layout::new(&[(0x6064, 0, 32), (0x606c, 0, 32), (1, 0, 1)]), Err(CanopenError::PdoBits(65)));
        let empty = CanopenError::NotMappable { index: 0x6064, sub: 0, bits: 0 };
        assert_eq!(Layout::new(&[(0x6064, 0, 0)]), Err(empty));
        assert_eq!(Layout::new(&[(1, 0, 1), (2, 0, 8)]).unwrap().len(), 2);
        assert!(Layout::new(&[]).unwrap().is_empty());
    }

    #[test]
    fn out_of_range_values_saturate() {
        let field = Field::new(8, 16).unwrap();
        let mut word = u64::MAX;
        field.put_signed(&mut word, -40_000);
        assert_eq!((word, field.get_signed(word)), (0xffff_ffff_ff80_00ff, -32_768));
        field.put_signed(&mut word, 40_000);
        assert_eq!(field.get_signed(word), 32_767);
        field.put_unsigned(&mut word, 70_000);
        assert_eq!(field.get_unsigned(word), 0xffff);
        field.put_bits(&mut word, 0x1_2345);
        assert_eq!(field.get_unsigned(word), 0x2345);
    }

    #[test]
    fn field_must_lie_within_64_bits() {
        assert_eq!((Field::new(63, 2), Field::new(64, 1), Field::new(0, 0)), (None, None, None));
        assert_eq!(Field::new(0, 64).unwrap().get_signed(u64::MAX), -1);
    }

    proptest! {
        #[test]
        fn get_returns_what_put_stored_and_leaves_the_rest(shift in 0u8..64, bits in 1u8..=64, word: u64, raw: u64) {
            prop_assume!(bits <= 64 - shift);
            let field = Field::new(shift, bits).unwrap();
            let mut changed = word;
            field.put_bits(&mut changed, raw);
            prop_assert_eq!(field.get_unsigned(changed), raw & mask(bits));
            prop_assert_eq!((changed ^ word) & !(mask(bits) << shift), 0);
            let signed = sign_extend(raw, bits);
            field.put_signed(&mut changed, signed);
            prop_assert_eq!(field.get_signed(changed), signed);
            field.put_unsigned(&mut changed, raw & mask(bits));
            prop_assert_eq!(field.get_unsigned(changed), raw & mask(bits));
        }
    }
}
