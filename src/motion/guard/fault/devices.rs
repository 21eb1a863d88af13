//! Devices at which a fault was seen.

use std::fmt;

/// A device of the rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Device {
    /// The drive of the left joint.
    LeftDrive,
    /// The drive of the right joint.
    RightDrive,
    /// The force sensor.
    Sensor,
}

impl Device {
    /// Both drives, left and right.
    pub const DRIVES: [Self; 2] = [Self::LeftDrive, Self::RightDrive];
    /// All, drives first.
    pub const ALL: [Self; 3] = [Self::LeftDrive, Self::RightDrive, Self::Sensor];

    /// Returns the set of this device if `is_so`, else none.
    ///
    /// Real-time: yes.
    pub const fn only_if(self, is_so: bool) -> DeviceSet {
        self.set().only_if(is_so)
    }

    /// Returns the set of this device.
    ///
    /// Real-time: yes.
    pub const fn set(self) -> DeviceSet {
        match self {
            Self::LeftDrive => DeviceSet::LEFT_DRIVE,
            Self::RightDrive => DeviceSet::RIGHT_DRIVE,
            Self::Sensor => DeviceSet::SENSOR,
        }
    }
}

/// The devices that a fault concerns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct DeviceSet(u16);

impl DeviceSet {
    /// No device.
    pub const NONE: Self = Self(0);
    /// The drive of the left joint.
    pub const LEFT_DRIVE: Self = Self(1);
    /// The drive of the right joint.
    pub const RIGHT_DRIVE: Self = Self(2);
    /// The force sensor.
    pub const SENSOR: Self = Self(4);
    /// This computer.
    pub const HOST: Self = Self(8);
    /// Both drives.
    pub const DRIVES: Self = Self(3);

    const NAMES: [&'static str; 8] = [
        "left drive",
        "right drive",
        "force sensor",
        "host",
        "first interface",
        "second interface",
        "third interface",
        "fourth interface",
    ];

    /// Returns this computer's interface to the bus of this number, 0 to 3; the computer itself for another number.
    ///
    /// Real-time: yes.
    pub const fn interface(bus: usize) -> Self {
        if bus < 4 { Self(0x10 << bus) } else { Self::HOST }
    }

    /// Returns the drive of joint 0 (left) or 1 (right); none for another number.
    ///
    /// Real-time: yes.
    pub const fn drive(joint: usize) -> Self {
        match joint {
            0 => Self::LEFT_DRIVE,
            1 => Self::RIGHT_DRIVE,
            _ => Self::NONE,
        }
    }

    /// Returns the joints for which `concerns` says yes.
    ///
    /// Real-time: yes.
    pub fn drives_where(concerns: [bool; 2]) -> Self {
        let [left, right] = concerns;
        Self(u16::from(left) | u16::from(right) << 1)
    }

    /// Returns this set if `is_so`, else none.
    ///
    /// Real-time: yes.
    pub const fn only_if(self, is_so: bool) -> Self {
        if is_so { self } else { Self::NONE }
    }

    /// Whether the set is empty.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether all of `other` are in it.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Returns one bit per device: left drive, right drive, force sensor, host, interfaces.
    pub const fn bits(self) -> u16 {
        self.0
    }

    /// Returns the set with these bits; bits of no device are left out.
    pub const fn from_bits(bits: u16) -> Self {
        Self(bits & ((1 << Self::NAMES.len()) - 1))
    }

    /// Returns the devices, one at a time.
    pub fn iter(self) -> impl Iterator<Item = Self> {
        (0..Self::NAMES.len()).map(move |bit| self & Self(1 << bit)).filter(|device| !device.is_empty())
    }
}

impl std::ops::BitOr for DeviceSet {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl std::ops::BitAnd for DeviceSet {
    type Output = Self;

    fn bitand(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }
}

impl std::ops::BitOrAssign for DeviceSet {
    fn bitor_assign(&mut self, other: Self) {
        *self = *self | other;
    }
}

impl fmt::Display for DeviceSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut separator = "";
        for (bit, name) in Self::NAMES.iter().enumerate() {
            if self.0 & (1 << bit) != 0 {
                write!(f, "{separator}{name}")?;
                separator = ", ";
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_join_and_name_their_devices() {
        assert_eq!([0, 1, 2].map(DeviceSet::drive), [DeviceSet::LEFT_DRIVE, DeviceSet::RIGHT_DRIVE, DeviceSet::NONE]);
        assert_eq!(DeviceSet::DRIVES.bits(), 3);
        assert_eq!(DeviceSet::SENSOR | DeviceSet::SENSOR, DeviceSet::SENSOR);
        let mut set = DeviceSet::drive(1);
        set |= DeviceSet::SENSOR;
        assert_eq!(set.to_string(), "right drive, force sensor");
        assert!(set.contains(DeviceSet::SENSOR) && !set.contains(DeviceSet::DRIVES));
        assert_eq!(DeviceSet::drives_where([true, true]), DeviceSet::DRIVES);
        assert_eq!(set & DeviceSet::DRIVES, DeviceSet::RIGHT_DRIVE);
        assert_eq!(DeviceSet::from_bits(0xa2).to_string(), "right drive, second interface, fourth interface");
        assert_eq!(DeviceSet::from_bits(0xffff).iter().map(DeviceSet::bits).sum::<u16>(), 0xff);
        assert_eq!([0, 3, 4].map(|bus| DeviceSet::interface(bus).bits()), [0x10, 0x80, 8]);
        assert!(DeviceSet::drive(2).is_empty() && DeviceSet::HOST.only_if(false).is_empty());
        assert_eq!(DeviceSet::NONE.to_string(), "");
    }
}
