//! Limits that a drive observes.

#[cfg(feature = "config")]
use garde::Validate;
#[cfg(feature = "config")]
use schemars::JsonSchema;
#[cfg(feature = "config")]
use serde::{Deserialize, Serialize};

use super::Entry;
#[cfg(feature = "config")]
use super::{nullable, present};

/// Limits that a drive observes. A limit that the drive lacks is null.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct Limits {
    /// Torque in per mille of the rated torque: 6072h.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(deserialize_with = "present"), schemars(schema_with = "nullable::<Entry>"))]
    pub torque: Option<Entry>,
    /// Torque in another unit, such as the current in mA; left out if `torque` is the limit, or if there is none.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(default, skip_serializing_if = "Option::is_none"))]
    pub current: Option<CurrentLimit>,
    /// Object of the limit of the motor's speed.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(
        feature = "config",
        serde(deserialize_with = "present"),
        schemars(schema_with = "nullable::<MotorSpeed>")
    )]
    pub motor_speed: Option<MotorSpeed>,
    /// Following error in counts: 6065h.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(deserialize_with = "present"), schemars(schema_with = "nullable::<Entry>"))]
    pub following_error: Option<Entry>,
}

impl Limits {
    /// Returns the torque limit, if the drive has one.
    pub fn of_torque(&self) -> Option<TorqueLimit<'_>> {
        let current = || self.current.as_ref().map(TorqueLimit::Current);
        self.torque.as_ref().map(TorqueLimit::PerMille).or_else(current)
    }
}

/// Object that limits the torque of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TorqueLimit<'a> {
    /// This object, in per mille of the rated torque: 6072h.
    PerMille(&'a Entry),
    /// An object in another unit.
    Current(&'a CurrentLimit),
}

impl<'a> TorqueLimit<'a> {
    /// The object of the limit.
    pub fn object(self) -> &'a Entry {
        match self {
            Self::PerMille(limit) => limit,
            Self::Current(current) => &current.limit,
        }
    }

    /// The setter of the limit.
    pub fn set_by(self) -> LimitSetter {
        match self {
            Self::PerMille(_) => LimitSetter::Master,
            Self::Current(current) => current.set_by,
        }
    }
}

/// A torque limit in another unit: the current in mA, or per mille of another rating.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct CurrentLimit {
    /// The limit, 16 or 32 bits.
    #[cfg_attr(feature = "config", garde(dive))]
    pub limit: Entry,
    /// Value at which the motor makes its rated torque, in the unit of the limit: its rated current. 16 or 32 bits.
    #[cfg_attr(feature = "config", garde(dive))]
    pub rated: Entry,
    /// The setter of the limit.
    pub set_by: LimitSetter,
}

impl CurrentLimit {
    /// Returns the limit in its unit for a torque in per mille of rated, rounded down; `rated` is the device's rated value.
    pub fn value(per_mille: u16, rated: u32) -> u32 {
        u32::try_from(u64::from(per_mille) * u64::from(rated) / 1000).unwrap_or(u32::MAX)
    }

    /// Returns the torque in per mille of rated that a limit allows, rounded up; `u32::MAX` where `rated` is 0.
    pub fn per_mille(value: u32, rated: u32) -> u32 {
        let per_mille = (1000 * u64::from(value)).checked_add(u64::from(rated).saturating_sub(1));
        let per_mille = per_mille.and_then(|sum| sum.checked_div(rated.into()));
        per_mille.and_then(|per_mille| u32::try_from(per_mille).ok()).unwrap_or(u32::MAX)
    }
}

/// The setter of a torque limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"))]
pub enum LimitSetter {
    /// The master writes it.
    Master,
    /// The drive has its own limit, which its maker's tool sets. The master compares it.
    Drive,
}

/// A limit of the motor's speed in r/min, and the encoder resolution for its computation.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct MotorSpeed {
    /// The limit, r/min: 6080h.
    #[cfg_attr(feature = "config", garde(dive))]
    pub limit: Entry,
    /// Increments of the encoder: 608Fh:1.
    #[cfg_attr(feature = "config", garde(dive))]
    pub increments: Entry,
    /// Revolutions for these increments: 608Fh:2.
    #[cfg_attr(feature = "config", garde(dive))]
    pub revolutions: Entry,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_limit_in_another_unit_allows_more_torque_than_was_asked_for(per_mille in any::<u16>(), rated in 1..=u32::MAX) {
            let value = CurrentLimit::value(per_mille, rated);
            prop_assert!(value == u32::MAX || CurrentLimit::per_mille(value, rated) <= u32::from(per_mille));
        }
    }

    #[test]
    fn a_rating_of_zero_allows_any_torque() {
        assert_eq!((CurrentLimit::value(500, 0), CurrentLimit::per_mille(1, 0)), (0, u32::MAX));
        assert_eq!((CurrentLimit::value(500, 4760), CurrentLimit::per_mille(9520, 4760)), (2380, 2000));
    }
}
