//! The object dictionary of a device.

mod builder;
#[cfg(test)]
mod tests;

use std::marker::PhantomData;

pub use builder::{Builder, Object};

use super::value::{Kind, load_le, mask, sign_extend};
use super::{AbortCode, Address, DataType, DictionaryError, Scalar};

/// Access rights of the bus to an object; the device itself may always read and write it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Read only; the device may change it.
    ReadOnly,
    /// Write only.
    WriteOnly,
    /// Read and write.
    ReadWrite,
    /// Read only, never changes.
    Const,
}

/// Into which PDOs an object may be mapped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mappable {
    /// None.
    No,
    /// RPDOs: the master writes it.
    Rpdo,
    /// TPDOs: the master reads it.
    Tpdo,
    /// Both.
    Both,
}

/// Bytes between two values, so that each basic value is one aligned little-endian word.
const WORD: usize = 8;

/// One declared object; its value lies in the arena.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    key: u32,
    pub(super) data_type: DataType,
    access: Access,
    mappable: Mappable,
    offset: usize,
    capacity: usize,
    len: usize,
    power_on_len: usize,
    factory_len: usize,
    lo: Option<u64>,
    hi: Option<u64>,
    name: &'static str,
}

/// Description of one object of a dictionary.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Description {
    /// Its address.
    pub at: Address,
    /// Its name; empty if it has none.
    pub name: &'static str,
    /// Its type.
    pub data_type: DataType,
    /// Access rights of the bus.
    pub access: Access,
    /// Process data that may carry it.
    pub mappable: Mappable,
    /// Bytes of a basic type, or most bytes of a string.
    pub capacity: usize,
}

const fn key(at: Address) -> u32 {
    (at.index as u32) << 8 | at.sub as u32
}

/// Names one object of the dictionary that issued it: access without a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Handle<T> {
    offset: usize,
    bits: u8,
    value: PhantomData<T>,
}

impl<T: Scalar> Handle<T> {
    /// A handle that reads as zero and writes nowhere, for fields that are filled in later.
    pub const NOWHERE: Handle<T> = Handle { offset: usize::MAX, bits: 0, value: PhantomData };
}

/// Objects sorted by address over one byte arena; fixed in shape once built.
#[derive(Clone, Debug, Default)]
pub struct ObjectDictionary {
    entries: Vec<Entry>,
    arena: Vec<u8>,
    /// Values that a reset restores: the non-volatile memory.
    power_on: Vec<u8>,
    /// Values with which the dictionary was built.
    factory: Vec<u8>,
}

impl ObjectDictionary {
    /// Returns an empty dictionary to be filled.
    pub fn builder() -> Builder {
        Builder::default()
    }

    /// Returns the handle of an object of a basic type.
    ///
    /// # Errors
    /// [`DictionaryError::NoObject`], or [`DictionaryError::TypeMismatch`] if `T` does not hold the object's type.
    pub fn handle<T: Scalar>(&self, index: u16, sub: u8) -> Result<Handle<T>, DictionaryError> {
        self.handle_if(index, sub, T::holds)
    }

    /// Returns the handle of the bits of an object of a basic type, whatever their meaning: zero-extended, a REAL32 as it is stored.
    ///
    /// # Errors
    /// [`DictionaryError::NoObject`], or [`DictionaryError::TypeMismatch`] if the object is a string.
    pub fn bits_handle(&self, index: u16, sub: u8) -> Result<Handle<u64>, DictionaryError> {
        self.handle_if(index, sub, |_| true)
    }

    fn handle_if<T: Scalar>(
        &self,
        index: u16,
        sub: u8,
        is_held: impl FnOnce(DataType) -> bool,
    ) -> Result<Handle<T>, DictionaryError> {
        let (_, entry) = self.find(Address::new(index, sub)).map_err(|_| DictionaryError::NoObject { index, sub })?;
        match entry.data_type.bits() {
            Some(bits) if is_held(entry.data_type) => Ok(Handle { offset: entry.offset, bits, value: PhantomData }),
            _ => Err(DictionaryError::TypeMismatch { index, sub, is: entry.data_type, wanted: T::DATA_TYPE }),
        }
    }

    /// Returns the value behind a handle. A handle of another dictionary reads some value of this one, or zero.
    ///
    /// Real-time: yes.
    #[inline]
    pub fn get<T: Scalar>(&self, handle: Handle<T>) -> T {
        T::from_word(self.load(handle.offset), handle.bits)
    }

    /// Sets the value behind a handle; bits beyond the object's width (an `i32` in an INTEGER24) are cut off. Access
    /// rights and limits bind the bus, not the device.
    ///
    /// Real-time: yes.
    #[inline]
    pub fn set<T: Scalar>(&mut self, handle: Handle<T>, value: T) {
        self.save(handle.offset, value.to_word() & mask(handle.bits));
    }

    /// Reads over the bus: the little-endian bytes of the value.
    ///
    /// # Errors
    /// 06020000h no object, 06090011h no sub-index, 06010001h write-only.
    pub fn read(&self, at: Address) -> Result<&[u8], AbortCode> {
        let (_, entry) = self.find(at)?;
        if entry.access == Access::WriteOnly {
            return Err(AbortCode::WRITE_ONLY);
        }
        Ok(self.bytes_of(entry))
    }

    /// Writes over the bus, subject to access rights, length and limits.
    ///
    /// # Errors
    /// Errors of [`ObjectDictionary::check_write`]; the value is then unchanged.
    pub fn write(&mut self, at: Address, data: &[u8]) -> Result<(), AbortCode> {
        self.check_write(at, data)?;
        self.store(at, data);
        Ok(())
    }

    /// Whether [`ObjectDictionary::write`] would succeed.
    ///
    /// # Errors
    /// - 06020000h no object, 06090011h no sub-index;
    /// - 06010002h read-only;
    /// - 06070012h too long, 06070013h too short;
    /// - 06090030h not a BOOLEAN or not a number where limits are set;
    /// - 06090031h and 06090032h above or below the limits.
    pub fn check_write(&self, at: Address, data: &[u8]) -> Result<(), AbortCode> {
        let entry = self.check_size(at, data.len())?;
        match entry.data_type.bits() {
            Some(bits) => check_limits(entry, load_le(data), bits),
            None => Ok(()),
        }
    }

    /// Whether a value of `len` bytes may be written, before its bytes are known.
    ///
    /// # Errors
    /// Errors of [`ObjectDictionary::check_write`] that do not depend on the value.
    pub fn check_write_len(&self, at: Address, len: usize) -> Result<(), AbortCode> {
        self.check_size(at, len).map(|_| ())
    }

    /// Whether the object exists and may be written at all.
    ///
    /// # Errors
    /// 06020000h no object, 06090011h no sub-index, 06010002h read-only.
    pub fn check_writable(&self, at: Address) -> Result<(), AbortCode> {
        self.writable(at).map(|_| ())
    }

    /// Returns the bytes of a value regardless of access rights; `None` without such an object.
    pub fn bytes(&self, at: Address) -> Option<&[u8]> {
        self.find(at).ok().map(|(_, entry)| self.bytes_of(entry))
    }

    /// Sets the bytes of a value regardless of access rights and limits, for the device itself.
    ///
    /// # Errors
    /// 06020000h, 06090011h, 06070012h, 06070013h.
    pub fn set_bytes(&mut self, at: Address, data: &[u8]) -> Result<(), AbortCode> {
        fits(self.find(at)?.1, data.len())?;
        self.store(at, data);
        Ok(())
    }

    /// Returns the data type of an object; `None` without such an object.
    pub fn data_type(&self, at: Address) -> Option<DataType> {
        self.find(at).ok().map(|(_, entry)| entry.data_type)
    }

    /// Returns the description of an object.
    ///
    /// # Errors
    /// 06020000h no object, 06090011h no sub-index.
    pub fn describe(&self, at: Address) -> Result<Description, AbortCode> {
        self.find(at).map(|(_, entry)| entry.describe())
    }

    /// Returns all objects, ascending by address.
    pub fn descriptions(&self) -> impl Iterator<Item = Description> {
        self.entries.iter().map(Entry::describe)
    }

    /// Returns the objects under one index, ascending by sub-index.
    pub fn under(&self, index: u16) -> impl Iterator<Item = Description> {
        let first = self.entries.partition_point(|entry| entry.key < key(Address::new(index, 0)));
        let rest = self.entries.get(first..).unwrap_or_default();
        rest.iter().map(Entry::describe).take_while(move |description| description.at.index == index)
    }

    /// Returns the first object of the next index from `index` on; `None` behind the last one.
    pub fn next_index(&self, index: u16) -> Option<Description> {
        let first = self.entries.partition_point(|entry| entry.key < key(Address::new(index, 0)));
        self.entries.get(first).map(Entry::describe)
    }

    /// Puts all objects from index `first` to `last` back to their power-on values: those that were stored last, or those
    /// they were built with.
    pub fn restore_power_on_values(&mut self, first: u16, last: u16) {
        for entry in &mut self.entries {
            if (first..=last).contains(&((entry.key >> 8) as u16)) {
                entry.len = entry.power_on_len;
                let range = entry.offset..entry.offset + entry.capacity;
                if let (Some(to), Some(from)) = (self.arena.get_mut(range.clone()), self.power_on.get(range)) {
                    to.copy_from_slice(from);
                }
            }
        }
    }

    /// Makes the present parameters the power-on values (1010h). Process data, which PDOs carry, what the bus cannot
    /// write, the error history and the node's own signatures are no parameters.
    pub fn store_parameters(&mut self) {
        for entry in self.entries.iter_mut().filter(|entry| is_parameter(entry)) {
            entry.power_on_len = entry.len;
            let range = entry.offset..entry.offset + entry.capacity;
            if let (Some(to), Some(from)) = (self.power_on.get_mut(range.clone()), self.arena.get(range)) {
                to.copy_from_slice(from);
            }
        }
    }

    /// Makes the values that the dictionary was built with the power-on values again (1011h); the present ones stay
    /// until a reset.
    pub fn forget_stored(&mut self) {
        self.power_on.clone_from(&self.factory);
        for entry in &mut self.entries {
            entry.power_on_len = entry.factory_len;
        }
    }

    /// Changes an UNSIGNED32 everywhere: now, at power-on and as built.
    pub fn change_everywhere(&mut self, at: Address, change: impl Fn(u32) -> u32) {
        let Ok((_, entry)) = self.find(at) else { return };
        let range = entry.offset..entry.offset + 4;
        if entry.data_type != DataType::Unsigned32 {
            return;
        }
        for values in [&mut self.arena, &mut self.power_on, &mut self.factory] {
            if let Some(bytes) = values.get_mut(range.clone()).and_then(|bytes| bytes.first_chunk_mut::<4>()) {
                *bytes = change(u32::from_le_bytes(*bytes)).to_le_bytes();
            }
        }
    }

    /// Returns the bits of an object of a basic type; zero without such an object.
    pub fn raw(&self, index: u16, sub: u8) -> u64 {
        self.bytes(Address::new(index, sub)).map_or(0, load_le)
    }

    /// Returns the bytes of the longest object.
    pub fn longest(&self) -> usize {
        self.entries.iter().map(|entry| entry.capacity).max().unwrap_or(0)
    }

    /// Returns the position of a mappable object's word in the arena.
    ///
    /// # Errors
    /// 06020000h no object, 06090011h no sub-index, 06040041h not mappable in this direction or with so many bits.
    pub fn mappable_offset(&self, at: Address, bits: u8, wanted: Mappable) -> Result<usize, AbortCode> {
        let (_, entry) = self.find(at)?;
        let is_allowed = entry.mappable == wanted || entry.mappable == Mappable::Both;
        if is_allowed && entry.data_type.bits() == Some(bits) { Ok(entry.offset) } else { Err(AbortCode::NOT_MAPPABLE) }
    }

    /// Returns the word at an offset; zero outside the arena.
    #[inline]
    pub fn load(&self, offset: usize) -> u64 {
        self.arena.get(offset..).and_then(|rest| rest.first_chunk::<WORD>()).map_or(0, |word| u64::from_le_bytes(*word))
    }

    /// Sets the word at an offset; nothing outside the arena.
    #[inline]
    pub fn save(&mut self, offset: usize, word: u64) {
        if let Some(to) = self.arena.get_mut(offset..).and_then(|rest| rest.first_chunk_mut::<WORD>()) {
            *to = word.to_le_bytes();
        }
    }

    fn find(&self, at: Address) -> Result<(usize, &Entry), AbortCode> {
        let wanted = key(at);
        let place = self.entries.partition_point(|entry| entry.key < wanted);
        match self.entries.get(place) {
            Some(entry) if entry.key == wanted => Ok((place, entry)),
            next => {
                let before = place.checked_sub(1).and_then(|place| self.entries.get(place));
                let is_same_index = |entry: &Entry| entry.key >> 8 == wanted >> 8;
                let has_index = next.is_some_and(is_same_index) || before.is_some_and(is_same_index);
                Err(if has_index { AbortCode::NO_SUB_INDEX } else { AbortCode::NO_OBJECT })
            }
        }
    }

    fn bytes_of(&self, entry: &Entry) -> &[u8] {
        self.arena.get(entry.offset..entry.offset + entry.len).unwrap_or_default()
    }

    fn writable(&self, at: Address) -> Result<&Entry, AbortCode> {
        let (_, entry) = self.find(at)?;
        match entry.access {
            Access::ReadOnly | Access::Const => Err(AbortCode::READ_ONLY),
            Access::WriteOnly | Access::ReadWrite => Ok(entry),
        }
    }

    fn check_size(&self, at: Address, len: usize) -> Result<&Entry, AbortCode> {
        let entry = self.writable(at)?;
        fits(entry, len).map(|()| entry)
    }

    /// Copies bytes that `fits` accepted.
    pub fn store(&mut self, at: Address, data: &[u8]) {
        let Ok((place, _)) = self.find(at) else { return };
        let Some(entry) = self.entries.get_mut(place) else { return };
        if let Some(to) = self.arena.get_mut(entry.offset..entry.offset + data.len()) {
            to.copy_from_slice(data);
            entry.len = data.len();
        }
    }
}

impl Entry {
    fn describe(&self) -> Description {
        Description {
            at: Address::new((self.key >> 8) as u16, self.key as u8),
            name: self.name,
            data_type: self.data_type,
            access: self.access,
            mappable: self.mappable,
            capacity: self.capacity,
        }
    }
}

fn is_parameter(entry: &Entry) -> bool {
    entry.access == Access::ReadWrite
        && entry.mappable == Mappable::No
        && !matches!(entry.key >> 8, 0x1003 | 0x1010 | 0x1011)
}

fn fits(entry: &Entry, len: usize) -> Result<(), AbortCode> {
    if len > entry.capacity {
        Err(AbortCode::TOO_LONG)
    } else if entry.data_type.bits().is_some() && len < entry.capacity {
        Err(AbortCode::TOO_SHORT)
    } else {
        Ok(())
    }
}

/// Whether `first` is greater than `second`; `None` if either is not a number.
fn is_above(data_type: DataType, first: u64, second: u64) -> Option<bool> {
    let bits = data_type.bits().unwrap_or(64);
    match data_type.kind() {
        Kind::Unsigned | Kind::Bytes => Some(first & mask(bits) > second & mask(bits)),
        Kind::Signed => Some(sign_extend(first, bits) > sign_extend(second, bits)),
        Kind::Real => {
            let number =
                |raw: u64| if bits == 32 { f64::from(f32::from_bits(raw as u32)) } else { f64::from_bits(raw) };
            number(first).partial_cmp(&number(second)).map(std::cmp::Ordering::is_gt)
        }
    }
}

fn check_limits(entry: &Entry, raw: u64, bits: u8) -> Result<(), AbortCode> {
    if bits == 1 && raw > 1 {
        return Err(AbortCode::VALUE);
    }
    if let Some(hi) = entry.hi
        && is_above(entry.data_type, raw, hi).ok_or(AbortCode::VALUE)?
    {
        return Err(AbortCode::VALUE_HIGH);
    }
    if let Some(lo) = entry.lo
        && is_above(entry.data_type, lo, raw).ok_or(AbortCode::VALUE)?
    {
        return Err(AbortCode::VALUE_LOW);
    }
    Ok(())
}
