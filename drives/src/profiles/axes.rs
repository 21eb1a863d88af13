//! Devices with several axes: drives that share one address, one dictionary and one network state.

use std::sync::Arc;

#[cfg(feature = "config")]
use garde::Validate;
#[cfg(feature = "config")]
use schemars::JsonSchema;
#[cfg(feature = "config")]
use serde::{Deserialize, Serialize};

use super::{
    DeviceProfile, Entry, Fieldbus, HeartbeatWatch, Pdo, Quantity, Role, Servo, SetPointWatch, SyncWatch, Unused,
};

/// First objects of the first axis and of a vendor, and the first object after all axes.
const FIRST_OF_AXIS: u16 = 0x6000;
const FIRST_OF_VENDOR: u16 = 0x2000;
const BEHIND_AXES: u16 = 0xa000;

/// Axes of a device with several axes: `device.servo` describes the first axis, and the others lie at fixed distances from it.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct Axes {
    /// Number of axes. 2 to 8.
    #[cfg_attr(feature = "config", garde(range(min = 2, max = 8)))]
    pub count: u8,
    /// Distance of objects from 6000h upward from one axis to the next. 1 to 0x2000; 0x800 if left out.
    #[cfg_attr(feature = "config", garde(range(min = 1, max = 0x2000)), serde(default = "object_step"))]
    pub object_step: u16,
    /// Distance of PDO numbers from one axis to the next. 1 to 255; 64 on CANopen and 16 on EtherCAT if left out.
    #[cfg_attr(feature = "config", garde(range(min = 1, max = 255)))]
    #[cfg_attr(feature = "config", serde(default, skip_serializing_if = "Option::is_none"))]
    pub pdo_step: Option<u16>,
    /// Distance of a vendor's objects (2000h to 5FFFh) from one axis to the next. Left out: 0, for objects that all axes share.
    #[cfg_attr(feature = "config", serde(default))]
    pub vendor_object_step: u16,
    /// Distance from one axis to the next of the indices that mark gaps in process data; the index of the last axis is below
    /// 0x1000. Left out: 0, that is index 0000h at all axes.
    #[cfg_attr(feature = "config", serde(default))]
    pub gap_step: u16,
    /// The axis of a profile that was moved to it.
    #[cfg_attr(feature = "config", serde(skip))]
    pub(super) moved: Option<Moved>,
}

/// The axis of a profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Moved {
    axis: u8,
    /// Number of used axes of the device before it.
    pub(super) rank: u8,
}

/// Returns the distance of objects if a profile names none.
///
/// # Source
/// CiA 402-2: at most eight axes, with their objects 800h apart.
#[cfg(feature = "config")]
fn object_step() -> u16 {
    0x800
}

impl Axes {
    /// Distance of PDO numbers on a bus.
    ///
    /// # Source
    /// CiA 402-3: 64 on CANopen.
    pub fn pdo_step_on(&self, bus: Fieldbus) -> u16 {
        self.pdo_step.unwrap_or(match bus {
            Fieldbus::Canopen => 64,
            Fieldbus::Ethercat => 16,
        })
    }

    /// The index of an object of the first axis at another axis; objects of the device stay.
    pub fn index(&self, index: u16, axis: u8) -> u16 {
        self.offset(axis).index(index)
    }

    /// Distances of the objects of an axis from those of the first one.
    pub fn offset(&self, axis: u8) -> AxisOffset {
        let [objects, vendor] =
            [self.object_step, self.vendor_object_step].map(|step| step.saturating_mul(axis.into()));
        AxisOffset { objects, vendor }
    }

    /// Returns an object of the first axis that has no place at the last axis, or that axes would share though each axis needs
    /// its own.
    pub fn misplaced<'a>(&self, servo: &'a Servo) -> Option<&'a Entry> {
        let last = self.count.saturating_sub(1);
        servo.of_each_axis().into_iter().find(|entry| {
            let moved = self.index(entry.index, last);
            let has_room = match entry.index {
                FIRST_OF_AXIS..BEHIND_AXES => moved < BEHIND_AXES,
                FIRST_OF_VENDOR..FIRST_OF_AXIS => moved < FIRST_OF_AXIS && moved != entry.index,
                _ => false,
            };
            !has_room
        })
    }
}

/// Distances of the objects of an axis from those of the first one; 0 for the first axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxisOffset {
    objects: u16,
    vendor: u16,
}

impl AxisOffset {
    /// Returns the distances of an axis in CiA 402, if no profile names others: 800h from one axis to the next.
    pub const fn standard(axis: u8) -> Self {
        Self::apart(0x800, axis)
    }

    /// Returns the distances of an axis whose objects lie `step` apart from one axis to the next.
    pub const fn apart(step: u16, axis: u8) -> Self {
        Self { objects: (axis as u16).saturating_mul(step), vendor: 0 }
    }

    /// Returns the index at this axis for an object of the first axis; objects of the device keep theirs.
    ///
    /// Real-time: yes.
    pub const fn index(self, index: u16) -> u16 {
        match index {
            FIRST_OF_AXIS..BEHIND_AXES => index.saturating_add(self.objects),
            FIRST_OF_VENDOR..FIRST_OF_AXIS => index.saturating_add(self.vendor),
            _ => index,
        }
    }
}

impl DeviceProfile {
    /// Number of axes of the device.
    pub fn axes(&self) -> u8 {
        self.servo().and_then(|servo| servo.axes.as_ref()).map_or(1, |axes| axes.count.max(1))
    }

    /// The axis of the profile; `None` if it was not moved to an axis.
    pub fn axis(&self) -> Option<u8> {
        self.servo()?.axes.as_ref()?.moved.map(|moved| moved.axis)
    }

    /// Distances of its objects from those of the first axis.
    pub fn offset(&self) -> AxisOffset {
        self.servo().map(Servo::offset).unwrap_or_default()
    }

    /// Returns the profile with the objects and PDOs of an axis; `rank` is the number of used axes of the device before it.
    /// Returns the profile itself if the device has one axis.
    pub fn of_axis(self: &Arc<Self>, axis: u8, rank: u8, bus: Fieldbus) -> Arc<Self> {
        let Some(axes) = self.servo().and_then(|servo| servo.axes.clone()) else { return self.clone() };
        let mut moved = (**self).clone();
        if let Role::Servo(servo) = &mut moved.device {
            servo.move_to(&axes, axis, bus);
            servo.axes = Some(Axes { moved: Some(Moved { axis, rank }), ..axes });
        }
        Arc::new(moved)
    }

    /// Returns the difference between the numbers of PDOs and their default identifiers, for a direction with `pdos` PDOs: axes
    /// take identifiers in their order. `None` if the identifiers follow the numbers.
    pub(super) fn identifiers_before(&self, pdos: usize) -> Option<usize> {
        Some(usize::from(self.servo()?.axes.as_ref()?.moved?.rank) * pdos)
    }
}

impl Servo {
    /// Distances of its objects from those of the first axis.
    pub fn offset(&self) -> AxisOffset {
        let moved = self.axes.as_ref().and_then(|axes| Some(axes.offset(axes.moved?.axis)));
        moved.unwrap_or_default()
    }

    /// Objects that each axis needs for itself.
    fn of_each_axis(&self) -> Vec<&Entry> {
        let own = &self.objects;
        let mut all = vec![
            &own.controlword,
            &own.statusword,
            &own.mode_of_operation,
            &own.mode_display,
            &own.supported_modes,
            &own.position_actual,
        ];
        all.extend([&own.target_position, &own.target_velocity, &own.target_torque].into_iter().flatten());
        all.extend(own.cycle_time.iter().flat_map(|time| [&time.value, &time.exponent]));
        let limits = &self.limits;
        all.extend([&limits.torque, &limits.following_error].into_iter().flatten());
        all.extend(limits.current.iter().flat_map(|current| [&current.limit, &current.rated]));
        all.extend(limits.motor_speed.iter().flat_map(|speed| [&speed.limit, &speed.increments, &speed.revolutions]));
        all.extend(self.homing.iter().flat_map(|homing| {
            [&homing.method, &homing.switch_speed, &homing.zero_speed, &homing.acceleration, &homing.offset]
        }));
        all.extend(self.brake.output.iter().flat_map(|output| [&output.value, &output.mask]));
        all
    }

    /// All of its objects.
    fn entries_mut(&mut self) -> Vec<&mut Entry> {
        let own = &mut self.objects;
        let mut all = vec![
            &mut own.controlword,
            &mut own.statusword,
            &mut own.mode_of_operation,
            &mut own.mode_display,
            &mut own.supported_modes,
            &mut own.position_actual,
        ];
        all.extend([&mut own.target_position, &mut own.target_velocity, &mut own.target_torque].into_iter().flatten());
        all.extend(own.cycle_time.iter_mut().flat_map(|time| [&mut time.value, &mut time.exponent]));
        let options = &mut self.option_codes;
        let options = [&mut options.lost_master, &mut options.communication_error, &mut options.quick_stop];
        all.extend(options.into_iter().flatten().chain(&mut self.settings).map(|setting| &mut setting.object));
        let limits = &mut self.limits;
        all.extend([&mut limits.torque, &mut limits.following_error].into_iter().flatten());
        all.extend(limits.current.iter_mut().flat_map(|current| [&mut current.limit, &mut current.rated]));
        all.extend(
            limits
                .motor_speed
                .iter_mut()
                .flat_map(|speed| [&mut speed.limit, &mut speed.increments, &mut speed.revolutions]),
        );
        if let HeartbeatWatch::Consumer(consumer) = &mut self.watchdogs.heartbeat {
            all.push(consumer);
        }
        if let SetPointWatch::Object(timed) = &mut self.watchdogs.set_points {
            all.push(&mut timed.object);
        }
        if let SyncWatch::Object(timed) = &mut self.watchdogs.sync {
            all.push(&mut timed.object);
        }
        all.extend(self.homing.iter_mut().flat_map(|homing| {
            [
                &mut homing.method,
                &mut homing.switch_speed,
                &mut homing.zero_speed,
                &mut homing.acceleration,
                &mut homing.offset,
            ]
        }));
        all.extend(self.brake.output.iter_mut().flat_map(|output| [&mut output.value, &mut output.mask]));
        all
    }

    fn move_to(&mut self, axes: &Axes, axis: u8, bus: Fieldbus) {
        for entry in self.entries_mut() {
            entry.index = axes.index(entry.index, axis);
        }
        let by = axes.pdo_step_on(bus).saturating_mul(axis.into());
        let data = &mut self.process_data;
        let maps = [&mut data.torque, &mut data.velocity, &mut data.position].into_iter().flatten();
        for Pdo { number, maps, .. } in maps.flat_map(|map| map.rpdo.iter_mut().chain(&mut map.tpdo)) {
            *number = number.saturating_add(by);
            for quantity in maps {
                match quantity {
                    Quantity::Unused(Unused { index, .. }) => *index = axes.index(*index, axis),
                    Quantity::Gap(bits) if axes.gap_step > 0 && axis > 0 => {
                        let index = axes.gap_step.saturating_mul(axis.into());
                        *quantity = Quantity::Unused(Unused { index, sub: 0, bits: *bits, value: None });
                    }
                    _ => {}
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_of_an_axis_lie_behind_those_of_the_first_and_those_of_the_device_stay() {
        let axes =
            Axes { count: 3, object_step: 0x800, pdo_step: None, vendor_object_step: 0x100, gap_step: 0, moved: None };
        let at = |index| [0, 1, 2].map(|axis| axes.index(index, axis));
        assert_eq!(at(0x6040), [0x6040, 0x6840, 0x7040]);
        assert_eq!(at(0x2000), [0x2000, 0x2100, 0x2200]);
        for index in [0x0005, 0x1029, 0xa000] {
            assert_eq!(at(index), [index; 3]);
        }
        assert_eq!([Fieldbus::Canopen, Fieldbus::Ethercat].map(|bus| axes.pdo_step_on(bus)), [64, 16]);
    }
}
