//! Declaring the objects of a device.

use super::super::pdo::PdoParameters;
use super::super::value::mask;
use super::super::{Address, CanopenError, DataType, MappingEntry, NodeId, Scalar, cob};
use super::{Access, Entry, Mappable, ObjectDictionary, WORD, check_limits, is_above, key};

/// Most PDOs of each direction that a device can declare.
pub(in super::super) const MAX_PDOS: u8 = 4;
/// Most objects in one PDO of a device.
pub(in super::super) const MAX_MAPPED: usize = 8;
/// Entries of the error history 1003h.
pub(in super::super) const ERROR_HISTORY: u8 = 8;
/// Nodes whose heartbeat a device can watch (1016h).
pub(in super::super) const HEARTBEAT_PRODUCERS: u8 = 4;

/// What 1010h and 1011h read as: parameters are stored and restored on command.
const ON_COMMAND: u32 = 1;

/// One object to be declared: read-write, not mappable and without limits unless said otherwise.
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
}

impl Object {
    /// An object of the type that belongs to `T`, with its power-on value.
    pub fn new<T: Scalar>(index: u16, sub: u8, value: T) -> Self {
        Self::narrow(index, sub, T::DATA_TYPE, value)
    }

    /// An object of a basic type that `T` holds, such as INTEGER24 by `i32`; bits beyond its width are cut off.
    pub fn narrow<T: Scalar>(index: u16, sub: u8, data_type: DataType, value: T) -> Self {
        let size = data_type.size().unwrap_or(0);
        let raw = value.to_word() & mask(data_type.bits().unwrap_or(0));
        Self::bytes(index, sub, data_type, raw.to_le_bytes().get(..size).unwrap_or_default(), size)
    }

    /// A VISIBLE_STRING that can only be read.
    pub fn text(index: u16, sub: u8, text: &str) -> Self {
        Self::bytes(index, sub, DataType::VisibleString, text.as_bytes(), text.len()).access(Access::Const)
    }

    /// A string, domain or basic value from its bytes, with room for `capacity` bytes.
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
        }
    }

    /// With these access rights.
    pub fn access(mut self, access: Access) -> Self {
        self.access = access;
        self
    }

    /// Mappable into these PDOs.
    pub fn mappable(mut self, mappable: Mappable) -> Self {
        self.mappable = mappable;
        self
    }

    /// With these limits on what the bus may write, both included.
    pub fn limits<T: Scalar>(mut self, lo: T, hi: T) -> Self {
        (self.lo, self.hi) = (Some(lo.to_word()), Some(hi.to_word()));
        self
    }
}

/// Who a device says it is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceIdentity {
    /// 1000h: device profile in the low 16 bits (402 for drives), type bits above.
    pub device_type: u32,
    /// 1008h: device name; may be empty.
    pub name: String,
    /// 1018h:1.
    pub vendor_id: u32,
    /// 1018h:2.
    pub product_code: u32,
    /// 1018h:3.
    pub revision: u32,
    /// 1018h:4.
    pub serial: u32,
}

/// Collects objects and PDOs for an [`ObjectDictionary`].
#[derive(Clone, Debug, Default)]
pub struct Builder {
    objects: Vec<Object>,
    mapping_entries: Option<u8>,
    fault: Option<CanopenError>,
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
        self.object(Object::new(index, 0, highest).access(Access::Const))
    }

    /// Whether an object is declared.
    pub fn has(&self, index: u16, sub: u8) -> bool {
        self.objects.iter().any(|object| (object.at.index, object.at.subindex) == (index, sub))
    }

    /// Objects that one PDO carries at most, 1 to 8; 8 unless set. For the PDOs that are declared after this.
    pub fn mapping_entries(mut self, most: u8) -> Self {
        self.mapping_entries = Some(most.clamp(1, MAX_MAPPED as u8));
        self
    }

    /// Declares what [`Node`](super::super::Node) needs: 1000h, 1001h, 1003h, 1005h to 1008h, 100Ch, 100Dh, 1010h to
    /// 1012h, 1014h, 1016h to 1019h, 1029h and 1200h, with SYNC at 080h without counter and window, EMCY at
    /// 080h + node id, no error control, TIME not consumed and error behaviour 0.
    pub fn communication_profile(self, node: NodeId, identity: &DeviceIdentity) -> Self {
        let own_u32 = |index, sub, value: u32| Object::new(index, sub, value).access(Access::ReadOnly);
        let history = (1..=ERROR_HISTORY).map(|sub| own_u32(0x1003, sub, 0));
        let watched = (1..=HEARTBEAT_PRODUCERS).map(|sub| Object::new(0x1016, sub, 0u32));
        self.object(own_u32(0x1000, 0, identity.device_type))
            .object(Object::new(0x1001, 0, 0u8).access(Access::ReadOnly).mappable(Mappable::Tpdo))
            .object(Object::new(0x1003, 0, 0u8))
            .objects(history)
            .object(Object::new(0x1005, 0, u32::from(cob::SYNC)))
            .object(Object::new(0x1006, 0, 0u32))
            .object(Object::new(0x1007, 0, 0u32))
            .object(Object::text(0x1008, 0, &identity.name))
            .object(Object::new(0x100c, 0, 0u16))
            .object(Object::new(0x100d, 0, 0u8))
            .highest_sub(0x1010, 1)
            .object(Object::new(0x1010, 1, ON_COMMAND))
            .highest_sub(0x1011, 1)
            .object(Object::new(0x1011, 1, ON_COMMAND))
            .object(Object::new(0x1012, 0, u32::from(cob::TIME)))
            .object(Object::new(0x1014, 0, u32::from(cob::emcy(node))))
            .highest_sub(0x1016, HEARTBEAT_PRODUCERS)
            .objects(watched)
            .object(Object::new(0x1017, 0, 0u16))
            .highest_sub(0x1018, 4)
            .object(own_u32(0x1018, 1, identity.vendor_id))
            .object(own_u32(0x1018, 2, identity.product_code))
            .object(own_u32(0x1018, 3, identity.revision))
            .object(own_u32(0x1018, 4, identity.serial))
            .object(Object::new(0x1019, 0, 0u8).limits(0u8, 240))
            .highest_sub(0x1029, 1)
            .object(Object::new(0x1029, 1, 0u8).limits(0u8, 2))
            .highest_sub(0x1200, 2)
            .object(own_u32(0x1200, 1, cob::sdo_request(node).into()))
            .object(own_u32(0x1200, 2, cob::sdo_response(node).into()))
    }

    /// Declares RPDO `number` (1 to 4): 14xxh and 16xxh. [`Builder::build`] reports a bad number or mapping.
    pub fn rpdo(self, number: u8, parameters: &PdoParameters) -> Self {
        self.pdo(0x1400, number, parameters)
    }

    /// Declares TPDO `number` (1 to 4): 18xxh and 1Axxh. [`Builder::build`] reports a bad number or mapping.
    pub fn tpdo(self, number: u8, parameters: &PdoParameters) -> Self {
        self.pdo(0x1800, number, parameters)
    }

    fn pdo(mut self, base: u16, number: u8, parameters: &PdoParameters) -> Self {
        if !(1..=MAX_PDOS).contains(&number) {
            self.fault.get_or_insert(CanopenError::PdoNumber(number));
            return self;
        }
        let most = self.mapping_entries.map_or(MAX_MAPPED, usize::from);
        if parameters.mapping.len() > most {
            self.fault.get_or_insert(CanopenError::PdoEntries(parameters.mapping.len()));
            return self;
        }
        let (communication, mapping) = (base + u16::from(number) - 1, base + 0x200 + u16::from(number) - 1);
        let is_tpdo = base == 0x1800;
        let entry = |place: usize| {
            let mapped = parameters.mapping.get(place).copied();
            mapped.map_or(0u32, |(index, sub, bits)| MappingEntry::new(index, sub, bits).to_u32())
        };
        let number_mapped = Object::new(mapping, 0, parameters.mapping.len() as u8);
        let entries = (0..most).map(|place| Object::new(mapping, place as u8 + 1, entry(place)));
        let tpdo_only = [
            Object::new(communication, 3, parameters.inhibit_time_100_us),
            Object::new(communication, 6, 0u8).limits(0u8, 240),
        ];
        self.highest_sub(communication, if is_tpdo { 6 } else { 5 })
            .object(Object::new(communication, 1, parameters.cob_id))
            .object(Object::new(communication, 2, parameters.transmission_type))
            .objects(tpdo_only.into_iter().filter(|_| is_tpdo))
            .object(Object::new(communication, 5, parameters.event_timer_ms))
            .object(if most < MAX_MAPPED { number_mapped.limits(0u8, most as u8) } else { number_mapped })
            .objects(entries)
    }

    /// The finished dictionary.
    ///
    /// # Errors
    /// A bad PDO number or too many mapped objects, an address declared twice, a value of the wrong size, limits
    /// that are inverted or exclude the power-on value. Mappings are checked by [`Node::new`](super::super::Node::new).
    pub fn build(mut self) -> Result<ObjectDictionary, CanopenError> {
        if let Some(fault) = self.fault {
            return Err(fault);
        }
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
    fn append(&mut self, object: Object) -> Result<(), CanopenError> {
        let (index, sub) = (object.at.index, object.at.subindex);
        let (len, capacity) = (object.value.len(), object.capacity);
        if self.entries.last().is_some_and(|last| last.key == key(object.at)) {
            return Err(CanopenError::Duplicate { index, sub });
        }
        if len > capacity || (object.data_type.size().is_some() && len != capacity) {
            return Err(CanopenError::Length { index, sub, len, capacity });
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
            return Err(CanopenError::Limits { index, sub });
        }
        self.entries.push(entry);
        self.arena.extend_from_slice(&object.value);
        let end = self.arena.len() - len + capacity.max(1).next_multiple_of(WORD);
        self.arena.resize(end, 0);
        Ok(())
    }
}
