//! Identity of a device.

use super::{Access, Object};

/// Identity of a device, on any bus.
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

impl DeviceIdentity {
    /// Returns the objects that say it: 1000h, 1008h and 1018h.
    pub fn objects(&self) -> [Object; 7] {
        let own = |index, sub, value: u32, name| Object::new(index, sub, value).access(Access::ReadOnly).named(name);
        [
            own(0x1000, 0, self.device_type, "Device type"),
            Object::text(0x1008, 0, &self.name).named("Device name"),
            Object::highest_sub(0x1018, 4).named("Identity"),
            own(0x1018, 1, self.vendor_id, "Vendor ID"),
            own(0x1018, 2, self.product_code, "Product code"),
            own(0x1018, 3, self.revision, "Revision"),
            own(0x1018, 4, self.serial, "Serial number"),
        ]
    }
}
