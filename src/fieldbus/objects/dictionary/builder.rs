//! Declaring the objects of a device.

use super::super::value::mask;
use super::super::{Address, DataType, DictionaryError, Scalar};
use super::{Access, Entry, Mappable, ObjectDictionary, WORD, check_limits, is_above, key};

/// One object to be declared: read-write, not mappable and without limits by default.
#[derive(Clone, Debug)]
pub struct Object {
    at: Address,
    data_type: DataType,
    access: Access,
    mappable: Mappable,
    value: Vec<u8>,
    capacity: usize,
    lo: Option<u64>,
    hi: Option<u64>,
    name: &'static str,
}

impl Object {
    /// Creates an object of the type that belongs to `T`, with its power-on value.
    pub fn new<T: Scalar>(index: u16, sub: u8, value: T) -> Self {
        Self::narrow(index, sub, T::DATA_TYPE, value)
    }

    /// Creates an object of a basic type that `T` holds, such as INTEGER24 by `i32`; bits beyond its width are cut off.
    pub fn narrow<T: Scalar>(index: u16, sub: u8, data_type: DataType, value: T) -> Self {
        let size = data_type.size().unwrap_or(0);
        let raw = value.to_word() & mask(data_type.bits().unwrap_or(0));
        Self::bytes(index, sub, data_type, raw.to_le_bytes().get(..size).unwrap_or_default(), size)
    }

    /// Creates sub-index 0 of a record or array: its highest sub-index.
    pub fn highest_sub(index: u16, highest: u8) -> Self {
        Self::new(index, 0, highest).access(Access::Const)
    }

    /// Creates a VISIBLE_STRING that can only be read.
    pub fn text(index: u16, sub: u8, text: &str) -> Self {
        Self::bytes(index, sub, DataType::VisibleString, text.as_bytes(), text.len()).access(Access::Const)
    }

    /// Creates a string, domain or basic value from its bytes, with room for `capacity` bytes.
    pub fn bytes(index: u16, sub: u8, data_type: DataType, value: &[u8], capacity: usize) -> Self {
        Object {
            at: Address::new(index, sub),
            data_type,
            access: Access::ReadWrite,
            mappable: Mappable::No,
            value: value.to_vec(),
            capacity: data_type.size().unwrap_or(capacity),
            lo: None,
            hi: None,
            name: "",
        }
    }

    /// Returns the bytes of its value.
    pub fn value(&self) -> &[u8] {
        &self.value
    }

    /// Sets another power-on value of a basic type; bits beyond its width are cut off. A string keeps its own.
    pub fn holding(mut self, raw: u64) -> Self {
        if let Some(bits) = self.data_type.bits() {
            let raw = (raw & mask(bits)).to_le_bytes();
            self.value.iter_mut().zip(raw).for_each(|(to, byte)| *to = byte);
        }
        self
    }

    /// Sets these access rights.
    pub fn access(mut self, access: Access) -> Self {
        self.access = access;
        self
    }

    /// Makes the object mappable into these PDOs.
    pub fn mappable(mut self, mappable: Mappable) -> Self {
        self.mappable = mappable;
        self
    }

    /// Sets the name under which a device reports the object.
    pub fn named(mut self, name: &'static str) -> Self {
        self.name = name;
        self
    }

    /// Sets these limits on values that the bus writes, both included.
    pub fn limits<T: Scalar>(mut self, lo: T, hi: T) -> Self {
        (self.lo, self.hi) = (Some(lo.to_word()), Some(hi.to_word()));
        self
    }
}

/// Collects objects for an [`ObjectDictionary`].
#[derive(Clone, Debug, Default)]
pub struct Builder {
    objects: Vec<Object>,
}

impl Builder {
    /// Declares one object.
    pub fn object(mut self, object: Object) -> Self {
        self.objects.push(object);
        self
    }

    /// Declares several objects.
    pub fn objects(mut self, objects: impl IntoIterator<Item = Object>) -> Self {
        self.objects.extend(objects);
        self
    }

    /// Declares sub-index 0 of a record or array: its highest sub-index.
    pub fn highest_sub(self, index: u16, highest: u8) -> Self {
        self.object(Object::highest_sub(index, highest))
    }

    /// Declares what `revise` makes of an object, or no such object; whether it was declared before.
    pub fn revise(&mut self, at: Address, revise: impl FnOnce(Object) -> Option<Object>) -> bool {
        let Some(place) = self.objects.iter().position(|object| object.at == at) else { return false };
        let object = self.objects.remove(place);
        self.objects.extend(revise(object));
        true
    }

    /// Returns the sub-indices that are declared of an index.
    pub fn subs(&self, index: u16) -> Vec<u8> {
        self.objects.iter().filter(|object| object.at.index == index).map(|object| object.at.sub).collect()
    }

    /// Whether an object is declared.
    pub fn has(&self, index: u16, sub: u8) -> bool {
        self.objects.iter().any(|object| object.at == Address::new(index, sub))
    }

    /// Returns the finished dictionary.
    ///
    /// # Errors
    /// An address declared twice, a value of the wrong size, limits that are inverted or exclude the power-on value.
    pub fn build(mut self) -> Result<ObjectDictionary, DictionaryError> {
        self.objects.sort_by_key(|object| key(object.at));
        let mut built = ObjectDictionary::default();
        for object in self.objects {
            built.append(object)?;
        }
        built.power_on = built.arena.clone();
        built.factory = built.arena.clone();
        Ok(built)
    }
}

impl ObjectDictionary {
    fn append(&mut self, object: Object) -> Result<(), DictionaryError> {
        let (index, sub) = (object.at.index, object.at.sub);
        let (len, capacity) = (object.value.len(), object.capacity);
        if self.entries.last().is_some_and(|last| last.key == key(object.at)) {
            return Err(DictionaryError::Duplicate { index, sub });
        }
        if len > capacity || (object.data_type.size().is_some() && len != capacity) {
            return Err(DictionaryError::Length { index, sub, len, capacity });
        }
        let entry = Entry {
            key: key(object.at),
            data_type: object.data_type,
            access: object.access,
            mappable: object.mappable,
            offset: self.arena.len(),
            capacity,
            len,
            power_on_len: len,
            factory_len: len,
            lo: object.lo,
            hi: object.hi,
            name: object.name,
        };
        let raw = super::load_le(&object.value);
        let is_ordered = match (object.lo, object.hi, object.data_type.bits()) {
            (None, None, _) => true,
            (Some(lo), Some(hi), Some(bits)) => {
                is_above(object.data_type, lo, hi) == Some(false) && check_limits(&entry, raw, bits).is_ok()
            }
            _ => false,
        };
        if !is_ordered {
            return Err(DictionaryError::Limits { index, sub });
        }
        self.entries.push(entry);
        self.arena.extend_from_slice(&object.value);
        let end = self.arena.len() - len + capacity.max(1).next_multiple_of(WORD);
        self.arena.resize(end, 0);
        Ok(())
    }
}
