//! The communication and mapping parameters of a device's PDOs (14xxh, 16xxh, 18xxh, 1Axxh) and the rules for
//! changing them.
//!
//! # Source
//! CiA 301, objects 1400h to 1BFFh and the procedure for remapping. Where the standard names no abort code:
//! 08000022h for a mapping changed while in use, 06090030h for a value that is not allowed.

use super::super::communication::{MAX_MAPPED, is_place};
use super::super::{CanopenError, MappingEntry, cob};
use super::{Field, is_dummy};
use crate::objects::{AbortCode, Address, Mappable, ObjectDictionary};

/// One PDO of a device, by direction and place, counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) enum Pdo {
    Receive(u8),
    Transmit(u8),
}

impl Pdo {
    /// Returns the index of the communication parameter.
    pub(super) const fn communication(self) -> u16 {
        match self {
            Pdo::Receive(place) => 0x1400 + place as u16,
            Pdo::Transmit(place) => 0x1800 + place as u16,
        }
    }

    /// Returns the index of the mapping parameter.
    pub(super) const fn mapping(self) -> u16 {
        self.communication() + 0x200
    }

    const fn wanted(self) -> Mappable {
        match self {
            Pdo::Receive(_) => Mappable::Rpdo,
            Pdo::Transmit(_) => Mappable::Tpdo,
        }
    }
}

/// Returns the PDO that an index configures, and whether it is the mapping parameter.
pub(in super::super) fn locate(index: u16) -> Option<(Pdo, bool)> {
    let place = u8::try_from(index & 0x1ff).ok().filter(|place| is_place(*place))?;
    match index & 0xfe00 {
        0x1400 => Some((Pdo::Receive(place), false)),
        0x1600 => Some((Pdo::Receive(place), true)),
        0x1800 => Some((Pdo::Transmit(place), false)),
        0x1a00 => Some((Pdo::Transmit(place), true)),
        _ => None,
    }
}

/// Whether a client may write `value` to a PDO parameter now; the function does not check other objects.
pub(in super::super) fn check_write(od: &ObjectDictionary, at: Address, value: u64) -> Result<(), AbortCode> {
    let Some((pdo, is_mapping)) = locate(at.index) else { return Ok(()) };
    let old_cob_id = od.raw(pdo.communication(), 1) as u32;
    let is_used = old_cob_id & cob::INVALID == 0;
    match (is_mapping, at.sub) {
        (false, 1) => check_cob_id(old_cob_id, value as u32),
        (false, 2) if !is_served(value as u8) => Err(AbortCode::VALUE),
        (false, 3 | 6) if is_used && value != od.raw(at.index, at.sub) => Err(AbortCode::DEVICE_STATE),
        (true, _) if is_used => Err(AbortCode::DEVICE_STATE),
        (true, 0) => Mapping::compile(od, pdo, value as usize).map(|_| ()),
        (true, _) if od.raw(at.index, 0) != 0 => Err(AbortCode::DEVICE_STATE),
        (true, _) if value != 0 => target(od, pdo, MappingEntry::from_u32(value as u32)).map(|_| ()),
        _ => Ok(()),
    }
}

/// Whether a COB-ID with a validity bit (PDO, EMCY) may change from `old` to `new`.
pub(in super::super) fn check_cob_id(old: u32, new: u32) -> Result<(), AbortCode> {
    let id = new & 0x3fff_ffff;
    if new & cob::INVALID != 0 {
        return Ok(());
    }
    let is_renamed_in_use = old & cob::INVALID == 0 && id != old & 0x3fff_ffff;
    if is_renamed_in_use || cob::is_restricted(id) { Err(AbortCode::VALUE) } else { Ok(()) }
}

/// Returns the transmission types that the engine serves: synchronous and event-driven, not by remote request.
pub(super) const fn is_served(transmission_type: u8) -> bool {
    matches!(transmission_type, 0..=240 | 254 | 255)
}

/// Whether the parameters that a dictionary was built with can be used.
pub(in super::super) fn verify(od: &ObjectDictionary, pdo: Pdo) -> Result<(), CanopenError> {
    let communication = pdo.communication();
    if od.data_type(Address::new(communication, 1)).is_none() {
        return Ok(());
    }
    let cob_id = od.raw(communication, 1) as u32;
    let transmission_type = od.raw(communication, 2) as u8;
    check_cob_id(cob::INVALID, cob_id).map_err(|_| CanopenError::CobId(cob_id))?;
    if !is_served(transmission_type) {
        return Err(CanopenError::TransmissionType(transmission_type));
    }
    let count = od.raw(pdo.mapping(), 0) as usize;
    let mut bits = 0;
    for sub in 1..=count.min(MAX_MAPPED) as u8 {
        let entry = MappingEntry::from_u32(od.raw(pdo.mapping(), sub) as u32);
        let (index, sub) = (entry.address.index, entry.address.subindex);
        bits += u32::from(entry.bit_length);
        target(od, pdo, entry).map_err(|_| CanopenError::NotMappable { index, sub, bits: entry.bit_length })?;
    }
    Mapping::compile(od, pdo, count).map(|_| ()).map_err(|_| CanopenError::PdoBits(bits))
}

/// Returns the position of a mapped object's word in the dictionary; `None` for a dummy.
fn target(od: &ObjectDictionary, pdo: Pdo, entry: MappingEntry) -> Result<Option<usize>, AbortCode> {
    if is_dummy(entry.address.index) {
        let is_allowed = matches!(pdo, Pdo::Receive(_)) && entry.address.subindex == 0;
        let is_length_right = dummy_bits(entry.address.index) == entry.bit_length;
        return if is_allowed && is_length_right { Ok(None) } else { Err(AbortCode::NOT_MAPPABLE) };
    }
    od.mappable_offset(Address::new(entry.address.index, entry.address.subindex), entry.bit_length, pdo.wanted())
        .map(Some)
}

/// Returns the length of the data type whose index is mapped to skip bits.
const fn dummy_bits(index: u16) -> u8 {
    match index {
        0x0001 => 1,
        0x0002 | 0x0005 => 8,
        0x0003 | 0x0006 => 16,
        0x0004 | 0x0007 => 32,
        _ => 0,
    }
}

/// One mapped object: its word in the dictionary and its bits in the PDO.
#[derive(Clone, Copy, Debug, Default)]
struct Slot {
    offset: usize,
    field: Field,
}

/// A mapping compiled for the cycle: no search, no allocation.
#[derive(Clone, Debug, Default)]
pub(super) struct Mapping {
    slots: [Slot; MAX_MAPPED],
    count: usize,
    bytes: u8,
}

impl Mapping {
    /// Returns the first `count` entries of a PDO's mapping parameter.
    ///
    /// # Errors
    /// 06040042h for more entries or bits than a PDO holds, those of a bad entry otherwise.
    pub(super) fn compile(od: &ObjectDictionary, pdo: Pdo, count: usize) -> Result<Self, AbortCode> {
        if count > MAX_MAPPED {
            return Err(AbortCode::PDO_LENGTH);
        }
        let mut mapping = Mapping::default();
        let mut bits = 0u8;
        for sub in 1..=count as u8 {
            let entry = MappingEntry::from_u32(od.raw(pdo.mapping(), sub) as u32);
            let offset = target(od, pdo, entry)?;
            let field = Field::new(bits, entry.bit_length).ok_or(AbortCode::PDO_LENGTH)?;
            bits += entry.bit_length;
            if let (Some(offset), Some(slot)) = (offset, mapping.slots.get_mut(mapping.count)) {
                *slot = Slot { offset, field };
                mapping.count += 1;
            }
        }
        mapping.bytes = bits.div_ceil(8);
        Ok(mapping)
    }

    /// Returns the length of the frame in bytes.
    pub(super) const fn bytes(&self) -> u8 {
        self.bytes
    }

    /// Returns the mapped values as the word of a frame.
    ///
    /// Real-time: yes.
    pub(super) fn sample(&self, od: &ObjectDictionary) -> u64 {
        let mut word = 0;
        for slot in self.slots.iter().take(self.count) {
            slot.field.put_bits(&mut word, od.load(slot.offset));
        }
        word
    }

    /// Puts the word of a frame into the dictionary.
    ///
    /// Real-time: yes.
    pub(super) fn apply(&self, word: u64, od: &mut ObjectDictionary) {
        for slot in self.slots.iter().take(self.count) {
            od.save(slot.offset, slot.field.get_unsigned(word));
        }
    }
}
