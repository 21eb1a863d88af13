//! Data types of CiA 301 and the Rust types that hold them.

use std::fmt;

/// A basic data type; the number is the index under which CiA 301 describes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DataType {
    /// One bit in a PDO, one byte in an SDO.
    Boolean = 0x01,
    /// Signed, 8 bits.
    Integer8 = 0x02,
    /// Signed, 16 bits.
    Integer16 = 0x03,
    /// Signed, 32 bits.
    Integer32 = 0x04,
    /// Unsigned, 8 bits.
    Unsigned8 = 0x05,
    /// Unsigned, 16 bits.
    Unsigned16 = 0x06,
    /// Unsigned, 32 bits.
    Unsigned32 = 0x07,
    /// IEEE 754, 32 bits.
    Real32 = 0x08,
    /// ASCII text.
    VisibleString = 0x09,
    /// Bytes.
    OctetString = 0x0a,
    /// Bytes of any kind, often a file.
    Domain = 0x0f,
    /// Signed, 24 bits.
    Integer24 = 0x10,
    /// IEEE 754, 64 bits.
    Real64 = 0x11,
    /// Signed, 40 bits.
    Integer40 = 0x12,
    /// Signed, 48 bits.
    Integer48 = 0x13,
    /// Signed, 56 bits.
    Integer56 = 0x14,
    /// Signed, 64 bits.
    Integer64 = 0x15,
    /// Unsigned, 24 bits.
    Unsigned24 = 0x16,
    /// Unsigned, 40 bits.
    Unsigned40 = 0x18,
    /// Unsigned, 48 bits.
    Unsigned48 = 0x19,
    /// Unsigned, 56 bits.
    Unsigned56 = 0x1a,
    /// Unsigned, 64 bits.
    Unsigned64 = 0x1b,
}

/// Comparison rule for the bits of a basic type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Unsigned,
    Signed,
    Real,
    Bytes,
}

impl DataType {
    /// Returns the length in bits as in a PDO mapping: 1 for BOOLEAN; `None` for strings and domains.
    pub const fn bits(self) -> Option<u8> {
        use DataType::*;
        Some(match self {
            Boolean => 1,
            Integer8 | Unsigned8 => 8,
            Integer16 | Unsigned16 => 16,
            Integer24 | Unsigned24 => 24,
            Integer32 | Unsigned32 | Real32 => 32,
            Integer40 | Unsigned40 => 40,
            Integer48 | Unsigned48 => 48,
            Integer56 | Unsigned56 => 56,
            Integer64 | Unsigned64 | Real64 => 64,
            VisibleString | OctetString | Domain => return None,
        })
    }

    /// Returns the length in bytes as in an SDO; `None` for strings and domains.
    pub const fn size(self) -> Option<usize> {
        match self.bits() {
            Some(bits) => Some((bits as usize).div_ceil(8)),
            None => None,
        }
    }

    /// Whether its values are signed whole numbers.
    pub const fn is_signed(self) -> bool {
        matches!(self.kind(), Kind::Signed)
    }

    pub(super) const fn kind(self) -> Kind {
        use DataType::*;
        match self {
            Boolean | Unsigned8 | Unsigned16 | Unsigned24 | Unsigned32 | Unsigned40 | Unsigned48 | Unsigned56
            | Unsigned64 => Kind::Unsigned,
            Integer8 | Integer16 | Integer24 | Integer32 | Integer40 | Integer48 | Integer56 | Integer64 => {
                Kind::Signed
            }
            Real32 | Real64 => Kind::Real,
            VisibleString | OctetString | Domain => Kind::Bytes,
        }
    }
}

impl fmt::Display for DataType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        use DataType::*;
        match (self.kind(), self.bits()) {
            (Kind::Unsigned, Some(1)) => f.write_str("BOOLEAN"),
            (Kind::Unsigned, Some(bits)) => write!(f, "UNSIGNED{bits}"),
            (Kind::Signed, Some(bits)) => write!(f, "INTEGER{bits}"),
            (Kind::Real, Some(bits)) => write!(f, "REAL{bits}"),
            _ => f.write_str(match self {
                VisibleString => "VISIBLE_STRING",
                OctetString => "OCTET_STRING",
                _ => "DOMAIN",
            }),
        }
    }
}

/// Returns the low `bits` (0 to 64) bits set.
pub const fn mask(bits: u8) -> u64 {
    match bits {
        0 => 0,
        1..64 => (1 << bits) - 1,
        _ => u64::MAX,
    }
}

/// Returns the low `bits` (1 to 64) bits of `raw` read as two's complement; 0 for no bits.
pub const fn sign_extend(raw: u64, bits: u8) -> i64 {
    match bits {
        0 => 0,
        1..64 => ((raw << (64 - bits)) as i64) >> (64 - bits),
        _ => raw as i64,
    }
}

/// A Rust type that holds values of a basic data type.
pub trait Scalar: Copy {
    /// The type of the same width: `i32` is INTEGER32.
    const DATA_TYPE: DataType;

    /// Whether every value of `data_type` fits: `i32` also holds INTEGER24, `u64` also UNSIGNED40 to 56.
    fn holds(data_type: DataType) -> bool;

    /// Returns the value as little-endian bits, sign-extended to 64.
    fn to_word(self) -> u64;

    /// Returns the value from the low `bits` bits.
    fn from_word(raw: u64, bits: u8) -> Self;

    /// Returns the value from little-endian `data` of exactly the size of [`Scalar::DATA_TYPE`]; `None` for another size.
    fn from_le_slice(data: &[u8]) -> Option<Self> {
        let bits = Self::DATA_TYPE.bits()?;
        (Self::DATA_TYPE.size() == Some(data.len())).then(|| Self::from_word(load_le(data), bits))
    }
}

/// Returns up to 8 little-endian bytes as a zero-extended word; bytes beyond the eighth do not count.
pub fn load_le(data: &[u8]) -> u64 {
    let mut word = [0; 8];
    for (to, from) in word.iter_mut().zip(data) {
        *to = *from;
    }
    u64::from_le_bytes(word)
}

macro_rules! integer_scalar {
    ($($type:ty, $data_type:ident, $extend:ident $(, $also:ident)*;)*) => {$(
        impl Scalar for $type {
            const DATA_TYPE: DataType = DataType::$data_type;
            fn holds(data_type: DataType) -> bool {
                matches!(data_type, DataType::$data_type $(| DataType::$also)*)
            }
            fn to_word(self) -> u64 {
                self as i64 as u64
            }
            fn from_word(raw: u64, bits: u8) -> Self {
                $extend(raw, bits) as $type
            }
        }
    )*};
}

const fn zero_extend(raw: u64, bits: u8) -> u64 {
    raw & mask(bits)
}

integer_scalar! {
    i8, Integer8, sign_extend;
    i16, Integer16, sign_extend;
    i32, Integer32, sign_extend, Integer24;
    i64, Integer64, sign_extend, Integer40, Integer48, Integer56;
    u8, Unsigned8, zero_extend;
    u16, Unsigned16, zero_extend;
    u32, Unsigned32, zero_extend, Unsigned24;
    u64, Unsigned64, zero_extend, Unsigned40, Unsigned48, Unsigned56;
}

impl Scalar for bool {
    const DATA_TYPE: DataType = DataType::Boolean;
    fn holds(data_type: DataType) -> bool {
        data_type == DataType::Boolean
    }
    fn to_word(self) -> u64 {
        self.into()
    }
    fn from_word(raw: u64, _: u8) -> Self {
        raw & 1 != 0
    }
}

impl Scalar for f32 {
    const DATA_TYPE: DataType = DataType::Real32;
    fn holds(data_type: DataType) -> bool {
        data_type == DataType::Real32
    }
    fn to_word(self) -> u64 {
        self.to_bits().into()
    }
    fn from_word(raw: u64, _: u8) -> Self {
        f32::from_bits(raw as u32)
    }
}

impl Scalar for f64 {
    const DATA_TYPE: DataType = DataType::Real64;
    fn holds(data_type: DataType) -> bool {
        data_type == DataType::Real64
    }
    fn to_word(self) -> u64 {
        self.to_bits()
    }
    fn from_word(raw: u64, _: u8) -> Self {
        f64::from_bits(raw)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn narrow_integers_are_sign_extended() {
        assert_eq!(i32::from_word(0xff_fffe, 24), -2);
        assert_eq!(u32::from_word(0xff_fffe, 24), 0xff_fffe);
        assert_eq!(i64::from_word(0x80_0000_0000, 40), -(1 << 39));
        assert_eq!(i16::from_le_slice(&[0xfe, 0xff]), Some(-2));
        assert_eq!(i16::from_le_slice(&[0xfe]), None);
        assert_eq!(f32::from_le_slice(&[0, 0, 0x80, 0x3f]), Some(1.0));
        assert_eq!((sign_extend(1, 0), mask(0), mask(64)), (0, 0, u64::MAX));
    }

    #[test]
    fn prints_as_in_the_standard() {
        use DataType::*;
        let names = [Boolean, Unsigned24, Integer56, Real32, VisibleString, Domain].map(|t| t.to_string());
        assert_eq!(names, ["BOOLEAN", "UNSIGNED24", "INTEGER56", "REAL32", "VISIBLE_STRING", "DOMAIN"]);
    }
}
