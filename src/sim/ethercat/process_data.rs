//! Objects in the process data.

use yieldwall_fieldbus::ethercat::AlStatusCode;
use yieldwall_fieldbus::objects::{AbortCode, Address, Mappable, ObjectDictionary, load_le, mask};

/// Most objects that the process data of one direction carry.
const MOST_OBJECTS: usize = 256;

/// Outputs or inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Flow {
    Outputs,
    Inputs,
}

impl Flow {
    /// The object that says which process data objects are exchanged.
    pub(super) const fn assignment(self) -> u16 {
        match self {
            Flow::Outputs => 0x1c12,
            Flow::Inputs => 0x1c13,
        }
    }

    pub(super) const fn mappable(self) -> Mappable {
        match self {
            Flow::Outputs => Mappable::Rpdo,
            Flow::Inputs => Mappable::Tpdo,
        }
    }

    /// Whether an index is that of a mapping of this direction.
    pub(super) const fn has_mapping(self, index: u16) -> bool {
        match self {
            Flow::Outputs => matches!(index, 0x1600..=0x17ff),
            Flow::Inputs => matches!(index, 0x1a00..=0x1bff),
        }
    }

    /// Returns the AL status code for a mapping that names missing objects.
    pub(super) const fn invalid_mapping(self) -> AlStatusCode {
        match self {
            Flow::Outputs => AlStatusCode::INVALID_OUTPUT_MAPPING,
            Flow::Inputs => AlStatusCode::INVALID_INPUT_MAPPING,
        }
    }

    /// Returns the AL status code for a sync manager that does not match the mapping.
    pub(super) const fn invalid_length(self) -> AlStatusCode {
        match self {
            Flow::Outputs => AlStatusCode::INVALID_OUTPUTS,
            Flow::Inputs => AlStatusCode::INVALID_INPUTS,
        }
    }
}

/// One object of the process data.
#[derive(Clone, Copy, Debug)]
struct Carried {
    /// First bit in the process data.
    bit: usize,
    bits: u8,
    /// Where the value lies in the dictionary.
    offset: usize,
}

/// All objects that the process data of one direction carry.
#[derive(Clone, Debug)]
pub(super) struct Mapping {
    carried: Vec<Carried>,
    bits: usize,
}

/// One entry of a mapping object: index, sub-index and length in bits.
pub(super) const fn entry(raw: u32) -> (Address, u8) {
    (Address::new((raw >> 16) as u16, (raw >> 8) as u8), raw as u8)
}

impl Mapping {
    pub(super) fn new() -> Self {
        Mapping { carried: Vec::with_capacity(MOST_OBJECTS), bits: 0 }
    }

    pub(super) fn clear(&mut self) {
        self.carried.clear();
        self.bits = 0;
    }

    /// Takes what the assignment and the mapping objects say. It does not allocate.
    ///
    /// # Errors
    /// The abort code with which an object is refused; nothing is mapped then.
    pub(super) fn load(&mut self, od: &ObjectDictionary, flow: Flow) -> Result<(), AbortCode> {
        self.clear();
        let result = self.add_all(od, flow);
        if result.is_err() {
            self.clear();
        }
        result
    }

    fn add_all(&mut self, od: &ObjectDictionary, flow: Flow) -> Result<(), AbortCode> {
        for place in 1..=od.raw(flow.assignment(), 0).min(255) as u8 {
            let index = od.raw(flow.assignment(), place) as u16;
            if index == 0 {
                continue;
            }
            if !flow.has_mapping(index) || od.describe(Address::new(index, 0)).is_err() {
                return Err(AbortCode::NO_OBJECT);
            }
            for place in 1..=od.raw(index, 0).min(255) as u8 {
                self.add(od, flow, od.raw(index, place) as u32)?;
            }
        }
        Ok(())
    }

    fn add(&mut self, od: &ObjectDictionary, flow: Flow, raw: u32) -> Result<(), AbortCode> {
        let (at, bits) = entry(raw);
        // Index 0 is a gap.
        if at.index != 0 {
            if self.carried.len() >= MOST_OBJECTS {
                return Err(AbortCode::PDO_LENGTH);
            }
            let offset = od.mappable_offset(at, bits, flow.mappable())?;
            self.carried.push(Carried { bit: self.bits, bits, offset });
        }
        self.bits += usize::from(bits);
        Ok(())
    }

    /// Bytes of the process data.
    pub(super) fn len(&self) -> usize {
        self.bits.div_ceil(8)
    }

    /// Copies outputs into the dictionary.
    pub(super) fn apply(&self, od: &mut ObjectDictionary, outputs: &[u8]) {
        for carried in &self.carried {
            let (byte, shift) = (carried.bit / 8, carried.bit % 8);
            let rest = outputs.get(byte..).unwrap_or_default();
            let low = load_le(rest) >> shift;
            // A value of 64 bits that does not begin with a byte reaches into a ninth one.
            let ninth = rest.get(8).map_or(0, |byte| u64::from(*byte));
            let high = if shift > 0 { ninth << (64 - shift) } else { 0 };
            od.save(carried.offset, (low | high) & mask(carried.bits));
        }
    }

    /// Copies inputs out of the dictionary.
    pub(super) fn gather(&self, od: &ObjectDictionary, inputs: &mut [u8]) {
        for carried in &self.carried {
            let (byte, shift) = (carried.bit / 8, carried.bit % 8);
            let value = od.load(carried.offset) & mask(carried.bits);
            if shift == 0 && carried.bits.is_multiple_of(8) {
                let to = inputs.get_mut(byte..byte + usize::from(carried.bits) / 8).unwrap_or_default();
                to.iter_mut().zip(value.to_le_bytes()).for_each(|(to, new)| *to = new);
                continue;
            }
            let touched = (shift + usize::from(carried.bits)).div_ceil(8);
            let word = u128::from(value) << shift;
            let keep = !(u128::from(mask(carried.bits)) << shift);
            let to = inputs.get_mut(byte..).unwrap_or_default();
            for ((to, new), keep) in to.iter_mut().zip(word.to_le_bytes()).zip(keep.to_le_bytes()).take(touched) {
                *to = *to & keep | new;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_fieldbus::objects::{Access, Object};

    #[test]
    fn bits_and_words_lie_one_behind_the_other() {
        let shown = |index, value: u16| Object::new(index, 0, value).access(Access::ReadOnly).mappable(Mappable::Both);
        let od = ObjectDictionary::builder()
            .object(shown(0x6041, 0x1234))
            .object(Object::new(0x2000, 0, true).mappable(Mappable::Both))
            .object(Object::new(0x2001, 0, 0x0102_0304_0506_0708u64).mappable(Mappable::Both))
            .object(Object::new(0x1a00, 0, 4u8))
            .objects(
                [0x2000_0001u32, 0x6041_0010, 0x0000_0002, 0x2001_0040]
                    .into_iter()
                    .zip(1..)
                    .map(|(raw, sub)| Object::new(0x1a00, sub, raw)),
            )
            .objects([Object::new(0x1c13, 0, 1u8), Object::new(0x1c13, 1, 0x1a00u16)])
            .objects([Object::new(0x1c12, 0, 1u8), Object::new(0x1c12, 1, 0x1a00u16)]);
        let mut od = od.build().unwrap();
        let mut mapping = Mapping::new();
        mapping.load(&od, Flow::Inputs).unwrap();
        let mut inputs = [0; 11];
        mapping.gather(&od, &mut inputs);
        // 1 bit, 16 bits, a gap of 2 bits, 64 bits: 83 bits.
        let value = 1u128 | 0x1234 << 1 | 0x0102_0304_0506_0708 << 19;
        assert_eq!((mapping.len(), &inputs[..]), (11, &value.to_le_bytes()[..11]));
        od.set_bytes(Address::new(0x6041, 0), &[0, 0]).unwrap();
        od.set_bytes(Address::new(0x2001, 0), &[0; 8]).unwrap();
        mapping.apply(&mut od, &inputs);
        assert_eq!((od.raw(0x6041, 0), od.raw(0x2001, 0)), (0x1234, 0x0102_0304_0506_0708));
        assert_eq!(mapping.load(&od, Flow::Outputs), Err(AbortCode::NO_OBJECT));
        assert_eq!(mapping.len(), 0);
    }
}
