//! LSS: giving node ids and bit rates to devices that have none or the wrong ones.
//!
//! # Source
//! CiA 305, layer setting services. All frames have eight bytes; unused ones are zero.

mod master;
mod slave;
#[cfg(test)]
mod tests;

pub use master::{LssMaster, LssOutcome, LssRequest};
pub(super) use slave::{LssEvent, LssSlave};

type Payload = [u8; 8];

/// Node id of a device without one.
const UNCONFIGURED: u8 = 0xff;
/// Bit number in a fastscan request that asks whether there is any device without node id.
const FASTSCAN_ANYBODY: u8 = 0x80;

mod command {
    pub(super) const SWITCH_GLOBAL: u8 = 0x04;
    pub(super) const CONFIGURE_NODE_ID: u8 = 0x11;
    pub(super) const CONFIGURE_BIT_TIMING: u8 = 0x13;
    pub(super) const ACTIVATE_BIT_TIMING: u8 = 0x15;
    pub(super) const STORE: u8 = 0x17;
    pub(super) const SWITCH_SELECTIVE: u8 = 0x40;
    pub(super) const SELECTED: u8 = 0x44;
    pub(super) const IDENTIFY_FIRST: u8 = 0x46;
    pub(super) const IDENTIFY_LAST: u8 = 0x4b;
    pub(super) const IDENTIFY_UNCONFIGURED: u8 = 0x4c;
    pub(super) const IDENTIFIED: u8 = 0x4f;
    pub(super) const UNCONFIGURED_IDENTIFIED: u8 = 0x50;
    pub(super) const FASTSCAN: u8 = 0x51;
    pub(super) const INQUIRE_IDENTITY: u8 = 0x5a;
    pub(super) const INQUIRE_NODE_ID: u8 = 0x5e;
}

/// Unique address of a device: object 1018h.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct LssAddress {
    /// 1018h:1.
    pub vendor_id: u32,
    /// 1018h:2.
    pub product_code: u32,
    /// 1018h:3.
    pub revision: u32,
    /// 1018h:4.
    pub serial: u32,
}

impl LssAddress {
    /// Returns the four numbers in the order of 1018h.
    const fn parts(self) -> [u32; 4] {
        [self.vendor_id, self.product_code, self.revision, self.serial]
    }

    const fn of_parts([vendor_id, product_code, revision, serial]: [u32; 4]) -> Self {
        LssAddress { vendor_id, product_code, revision, serial }
    }
}

/// Returns the bit rate in bit/s of an index in the table of CiA 301; `None` for an index that the table does not have.
pub const fn bit_rate(index: u8) -> Option<u32> {
    Some(match index {
        0 => 1_000_000,
        1 => 800_000,
        2 => 500_000,
        3 => 250_000,
        4 => 125_000,
        6 => 50_000,
        7 => 20_000,
        8 => 10_000,
        _ => return None,
    })
}

fn with_number(command: u8, number: u32) -> Payload {
    let [a, b, c, d] = number.to_le_bytes();
    [command, a, b, c, d, 0, 0, 0]
}

fn number(payload: &Payload) -> u32 {
    let [_, a, b, c, d, ..] = *payload;
    u32::from_le_bytes([a, b, c, d])
}
