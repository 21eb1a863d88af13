//! Common parts of simulated devices.

use yieldwall_drives::objects::{self, DataType};
use yieldwall_drives::profiles::{DeviceProfile, Entry, MappedPdo, Pdo};

use yieldwall_fieldbus::canopen::CanopenError;
use yieldwall_fieldbus::objects::{
    Access, Address, DeviceIdentity, DictionaryError, Handle, Mappable, Object, ObjectDictionary, Scalar,
};

/// Error when a simulated device is built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DeviceError {
    /// The object dictionary cannot be built.
    #[error("object dictionary: {0}")]
    Dictionary(#[from] CanopenError),
    /// The profile is of another kind of device.
    #[error("the device model {profile} is not a {wanted}")]
    Role {
        /// Name of the profile.
        profile: String,
        /// The wanted kind of device.
        wanted: &'static str,
    },
    /// The simulated device has an object that the profile says lies elsewhere, or has another length.
    #[error("the simulated drive has its {what} at {wanted}, and its profile says {index:04X}h:{sub} with {bits} bits")]
    Elsewhere {
        /// Meaning of the object.
        what: &'static str,
        /// Its place in the simulated device.
        wanted: String,
        /// Index in the profile.
        index: u16,
        /// Sub-index in the profile.
        sub: u8,
        /// Length in the profile.
        bits: u8,
    },
    /// An object is said to be odd that the simulated device does not have.
    #[error("the simulated drive has no object {at} that could be odd")]
    Lacks {
        /// The object.
        at: Address,
    },
    /// A setting is outside its range.
    #[error("{setting} is {value}, but has to be {range}")]
    Setting {
        /// Name of the setting.
        setting: &'static str,
        /// Its value.
        value: f64,
        /// Allowed range.
        range: &'static str,
    },
}

impl From<DictionaryError> for DeviceError {
    fn from(error: DictionaryError) -> Self {
        DeviceError::Dictionary(error.into())
    }
}

/// An object with its power-on value, cut off to its type; text is declared by the identity alone.
pub(super) fn declare(object: objects::Object, value: i64) -> Object {
    let (index, sub) = (object.index, object.sub);
    let declared = match object.data_type {
        DataType::I8 => Object::new(index, sub, value as i8),
        DataType::I16 => Object::new(index, sub, value as i16),
        DataType::I32 => Object::new(index, sub, value as i32),
        DataType::U8 => Object::new(index, sub, value as u8),
        DataType::U16 => Object::new(index, sub, value as u16),
        DataType::U32 => Object::new(index, sub, value as u32),
        DataType::Text => Object::text(index, sub, ""),
    };
    declared.named(object.name)
}

/// A read-only object that a TPDO can carry.
pub(super) fn shown(object: objects::Object) -> Object {
    declare(object, 0).access(Access::ReadOnly).mappable(Mappable::Tpdo)
}

/// An object that an RPDO can carry.
pub(super) fn commanded(object: objects::Object, value: i64) -> Object {
    declare(object, value).mappable(Mappable::Both)
}

/// Device type of drives of CiA 402 that say no more (1000h).
const DRIVES: u32 = 402;

/// Returns the identity of a device of a model.
pub(super) fn identity(profile: &DeviceProfile, serial: u32) -> DeviceIdentity {
    DeviceIdentity {
        device_type: profile.identity.device_type.unwrap_or(if profile.servo().is_some() { DRIVES } else { 0 }),
        name: profile.name().to_owned(),
        vendor_id: profile.identity.vendor_id,
        product_code: profile.identity.product_codes.first().copied().unwrap_or_default(),
        revision: profile.identity.revisions.example(),
        serial,
    }
}

/// The mark of a simulated device.
pub(super) fn mark() -> impl Iterator<Item = Object> {
    let mark = objects::SIMULATION_MARK;
    let words = (mark.sub..).zip(objects::SIMULATED_DEVICE);
    let words = words.map(move |(sub, word)| declare(mark.at(sub), word.into()).access(Access::ReadOnly));
    std::iter::once(Object::highest_sub(mark.index, objects::SIMULATED_DEVICE.len() as u8).named(mark.name))
        .chain(words)
}

/// The mapped objects of a PDO as the dictionary takes them.
pub(super) fn mapping(profile: &DeviceProfile, pdo: &Pdo) -> Vec<(u16, u8, u8)> {
    entries(&profile.mapped_pdo(pdo))
}

/// The mapped objects of a PDO: index, sub-index, bits.
pub(super) fn entries(pdo: &MappedPdo) -> Vec<(u16, u8, u8)> {
    pdo.objects.iter().map(|object| (object.index, object.sub, object.bits)).collect()
}

/// An unsigned object of a profile, 0 at power-on.
pub(super) fn plain(entry: &Entry) -> Object {
    holding(entry, 0)
}

/// An unsigned object of a profile that holds this at power-on, or as much of it as it can.
pub(super) fn holding(entry: &Entry, value: u16) -> Object {
    match entry.bits {
        8 => Object::new(entry.index, entry.sub, u8::try_from(value).unwrap_or(u8::MAX)),
        16 => Object::new(entry.index, entry.sub, value),
        _ => Object::new(entry.index, entry.sub, u32::from(value)),
    }
}

/// Access to an unsigned object of a profile.
#[derive(Clone, Copy, Debug)]
pub(super) enum Unsigned {
    U8(Handle<u8>),
    U16(Handle<u16>),
    U32(Handle<u32>),
}

impl Unsigned {
    pub(super) fn of(od: &ObjectDictionary, entry: &Entry) -> Result<Self, DictionaryError> {
        let (index, sub) = (entry.index, entry.sub);
        Ok(match entry.bits {
            8 => Self::U8(od.handle(index, sub)?),
            16 => Self::U16(od.handle(index, sub)?),
            _ => Self::U32(od.handle(index, sub)?),
        })
    }

    pub(super) fn get(self, od: &ObjectDictionary) -> u32 {
        match self {
            Self::U8(handle) => od.get(handle).into(),
            Self::U16(handle) => od.get(handle).into(),
            Self::U32(handle) => od.get(handle),
        }
    }
}

/// The handle of an object that the device has declared.
pub(super) fn handle<T: Scalar>(od: &ObjectDictionary, object: objects::Object) -> Result<Handle<T>, DictionaryError> {
    od.handle(object.index, object.sub)
}
