//! Values as a device sends and takes them.

use std::ops::Range;

use super::{Value, number};

impl Value {
    /// Returns the value that a device sends as `bytes` for an object of this type (0007h for UNSIGNED32). If a whole number has
    /// too many bytes, the excess is dropped if it is zero or repeats the sign. Any other length, or a number that is not finite,
    /// stays bytes.
    pub fn from_bytes(data_type: u16, bytes: &[u8]) -> Self {
        let word = || bytes.iter().rev().fold(0_u64, |word, byte| word << 8 | u64::from(*byte));
        if let Some((bits, is_signed)) = number::integer(data_type) {
            let Some((own, more)) = bytes.split_at_checked(bits.div_ceil(8) as usize) else {
                return Self::Bytes(bytes.to_vec());
            };
            let range = 1_i128 << bits;
            let number = i128::from(own.iter().rev().fold(0_u64, |word, byte| word << 8 | u64::from(*byte)));
            // Some devices send more bytes than the type has.
            let fill = if is_signed && number >= range / 2 { u8::MAX } else { 0 };
            if more.iter().any(|byte| *byte != fill) {
                return Self::Bytes(bytes.to_vec());
            }
            return Self::Integer(if is_signed && number >= range / 2 { number - range } else { number });
        }
        let real = match (data_type, bytes.len()) {
            (0x08, 4) => Some(f64::from(f32::from_bits(word() as u32))),
            (0x11, 8) => Some(f64::from_bits(word())),
            _ => None,
        };
        match (data_type, real) {
            (_, Some(real)) if real.is_finite() => Self::Real(real),
            (0x09, _) => match std::str::from_utf8(bytes) {
                Ok(text) => Self::Text(text.trim_end_matches('\0').to_owned()),
                Err(_) => Self::Bytes(bytes.to_vec()),
            },
            _ => Self::Bytes(bytes.to_vec()),
        }
    }

    /// The whole numbers that an object of this type holds, 0 to 65535 for UNSIGNED16; `None` for a type that has other values.
    pub fn range(data_type: u16) -> Option<Range<i128>> {
        number::integer(data_type).map(|(bits, is_signed)| number::range(bits, is_signed))
    }

    /// Returns the bytes that a device with this node id expects for the value; `None` if the type has no place for it.
    pub fn to_bytes(&self, data_type: u16, node_id: u8) -> Option<Vec<u8>> {
        let integer = |value: i128| {
            let (bits, is_signed) = number::integer(data_type)?;
            let value = number::fit(value, bits, is_signed)?;
            value.to_le_bytes().get(..bits.div_ceil(8) as usize).map(<[u8]>::to_vec)
        };
        match self {
            Self::Integer(value) => integer(*value),
            Self::OfNode(value) => integer(value + i128::from(node_id)),
            Self::Real(value) if data_type == 0x08 => Some((*value as f32).to_le_bytes().to_vec()),
            Self::Real(value) if data_type == 0x11 => Some(value.to_le_bytes().to_vec()),
            Self::Real(_) => None,
            Self::Text(text) => Some(text.clone().into_bytes()),
            Self::Bytes(bytes) => Some(bytes.clone()),
        }
    }

    /// The value that a person writes for an object of this type.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(text: &str, data_type: u16) -> Result<Self, String> {
        number::value(text.trim(), data_type)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_the_bytes_of_their_types() {
        for (value, data_type, bytes) in [
            (Value::Integer(-2), 0x03, &[0xfe, 0xff][..]),
            (Value::Integer(0x1234), 0x06, &[0x34, 0x12]),
            (Value::Integer(-1), 0x10, &[0xff; 3]),
            (Value::Real(1.0), 0x08, &[0, 0, 0x80, 0x3f]),
            (Value::Text("EPOS".into()), 0x09, b"EPOS"),
            (Value::Bytes(vec![1, 2]), 0x0a, &[1, 2]),
            (Value::Integer(1), 0x01, &[1]),
        ] {
            assert_eq!(value.to_bytes(data_type, 0).as_deref(), Some(bytes), "{value:?}");
            assert_eq!(Value::from_bytes(data_type, bytes), value);
        }
        assert_eq!(Value::OfNode(0x200).to_bytes(0x07, 5), Some(vec![5, 2, 0, 0]));
    }

    #[test]
    fn more_bytes_than_the_type_has_change_no_number() {
        assert_eq!(Value::from_bytes(0x06, &[1, 0, 0, 0]), Value::Integer(1));
        assert_eq!(Value::from_bytes(0x02, &[0xfd, 0xff]), Value::Integer(-3));
        assert_eq!(Value::from_bytes(0x02, &[0xfd, 0]), Value::Bytes(vec![0xfd, 0]));
    }

    #[test]
    fn what_does_not_fit_is_left_alone() {
        assert_eq!(Value::Integer(256).to_bytes(0x05, 0), None);
        assert_eq!(Value::Real(1.0).to_bytes(0x07, 0), None);
        // Too few bytes, and more that are neither zero nor repeat a sign.
        for bytes in [&[1][..], &[1, 0, 0, 1], &[0xff, 0xff, 0xff, 0xff]] {
            assert_eq!(Value::from_bytes(0x06, bytes), Value::Bytes(bytes.to_vec()));
        }
        assert_eq!(Value::from_bytes(0x08, &[0, 0, 0xc0, 0x7f]), Value::Bytes(vec![0, 0, 0xc0, 0x7f]));
        assert_eq!(Value::from_bytes(0x09, &[0xff]), Value::Bytes(vec![0xff]));
        assert!(Value::parse("12x", 0x07).is_err());
    }
}
