//! Numbers of a configuration: finite by construction, and a sign rule that the type names.

use std::borrow::Cow;
use std::ops::Deref;

use garde::Validate;
use garde::error::{Error, Path};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};

/// Error for a number that is not finite.
pub(super) const NOT_FINITE: &str = "is not a finite number";
/// Error for a number of absurd size.
pub(super) const TOO_LARGE: &str = "is larger than 1e12";

/// Largest number of a configuration: no rig has one near it, and products of a few of them stay finite.
const LARGEST: f64 = 1e12;
/// Smallest number for values above zero: quotients stay finite.
const SMALLEST: f64 = 1e-12;

macro_rules! number {
    ($(#[$doc:meta])* $name:ident, $holds:expr, $rule:literal, $schema:tt) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, PartialOrd, Serialize, Deserialize)]
        #[serde(try_from = "f64", into = "f64")]
        pub struct $name(f64);

        impl $name {
            /// The number, or `None` when the rule of the type does not hold for it.
            pub fn new(value: f64) -> Option<Self> {
                let holds: fn(f64) -> bool = $holds;
                (value.abs() <= LARGEST && holds(value)).then_some(Self(value))
            }

            /// The plain number.
            pub const fn get(self) -> f64 {
                self.0
            }
        }

        // The sign is checked after reading, by `Validate`, so that one bad sign does not hide the next.
        impl TryFrom<f64> for $name {
            type Error = &'static str;

            fn try_from(value: f64) -> Result<Self, Self::Error> {
                match value.is_finite() {
                    true if value.abs() <= LARGEST => Ok(Self(value)),
                    true => Err(TOO_LARGE),
                    false => Err(NOT_FINITE),
                }
            }
        }

        impl From<$name> for f64 {
            fn from(number: $name) -> f64 {
                number.0
            }
        }

        impl Deref for $name {
            type Target = f64;

            fn deref(&self) -> &f64 {
                &self.0
            }
        }

        impl Validate for $name {
            type Context = ();

            fn validate_into(&self, (): &(), parent: &mut dyn FnMut() -> Path, report: &mut garde::Report) {
                if Self::new(self.0).is_none() {
                    let rule = if self.0 > 0.0 { "must be 1e-12 or more" } else { $rule };
                    report.append(parent(), Error::new(rule));
                }
            }
        }

        impl JsonSchema for $name {
            fn inline_schema() -> bool {
                true
            }

            fn schema_name() -> Cow<'static, str> {
                stringify!($name).into()
            }

            fn json_schema(_: &mut SchemaGenerator) -> Schema {
                json_schema!($schema)
            }
        }
    };
}

number!(
    /// A finite number: neither NaN nor infinite, at most 1e12 in size.
    Finite,
    |_| true,
    "is not a finite number",
    { "type": "number" }
);
number!(
    /// A finite number above zero, from 1e-12 to 1e12. A loaded configuration holds no other.
    Positive,
    |value| value >= SMALLEST,
    "must be above 0",
    { "type": "number", "exclusiveMinimum": 0 }
);
number!(
    /// A finite number that is zero or above, at most 1e12. A loaded configuration holds no other.
    NotNegative,
    |value| value >= 0.0,
    "must be 0 or above",
    { "type": "number", "minimum": 0 }
);

/// Reads a key that may be `null` but must be written: leaving it out is an error, not a silent default.
pub(super) fn present<'de, D, T>(deserializer: D) -> Result<Option<T>, D::Error>
where
    D: serde::Deserializer<'de>,
    T: Deserialize<'de>,
{
    Option::deserialize(deserializer)
}

/// The schema of a key that may be `null` but must be written.
pub(super) fn nullable<T: JsonSchema>(generator: &mut SchemaGenerator) -> Schema {
    generator.subschema_for::<Option<T>>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signs_are_kept_apart() {
        assert!(Finite::new(-1.0).is_some() && NotNegative::new(-1.0).is_none() && Positive::new(-1.0).is_none());
        assert!(NotNegative::new(0.0).is_some() && Positive::new(0.0).is_none());
        assert!(Positive::new(1e-12).is_some() && Positive::new(f64::MIN_POSITIVE).is_none());
    }

    #[test]
    fn absurd_sizes_never_enter() {
        assert!(Finite::new(-1e12).is_some() && Finite::new(-1.1e12).is_none());
        assert_eq!(Positive::try_from(1e200), Err(TOO_LARGE));
    }

    #[test]
    fn nan_and_infinity_never_enter() {
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(Finite::new(value).is_none() && Finite::try_from(value).is_err());
            assert!(Positive::new(value).is_none() && Positive::try_from(value).is_err());
            assert!(NotNegative::new(value).is_none() && NotNegative::try_from(value).is_err());
        }
    }
}
