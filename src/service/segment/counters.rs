//! Error counters and clocks of a device.

use super::{SegmentError, SegmentService};
use yieldwall_fieldbus::ethercat::registers::{self as register, feature};
use yieldwall_fieldbus::ethercat::{array, u16_at, u32_at};
use yieldwall_link::EthernetLink;

/// Ports of a device.
const PORTS: usize = 4;
/// Bytes from the receive errors to the lost links.
const COUNTERS_LEN: usize = 20;
/// Bytes from the system time to the difference.
const CLOCK_LEN: usize = (register::DC_DIFFERENCE - register::DC_SYSTEM_TIME) as usize + 4;
/// Bytes from who controls SYNC0 to its cycle.
const SYNC_LEN: usize = (register::DC_SYNC0_CYCLE - register::DC_CYCLIC_CONTROL) as usize + 4;

/// Counters of one port of a device, each up to 255.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PortCounters {
    /// Whether it has a link now.
    pub is_linked: bool,
    /// Frames that came in damaged.
    pub invalid_frames: u8,
    /// Errors of the physical layer.
    pub physical_errors: u8,
    /// Damaged frames that a device before this one has counted already.
    pub forwarded: u8,
    /// Lost links.
    pub lost_links: u8,
}

/// Counters of a device since power-on, or since they were cleared; each up to 255.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Its ports.
    pub ports: [PortCounters; PORTS],
    /// Frames with datagrams that cannot be.
    pub processing_unit: u8,
    /// Errors between the controller and the processor of the device.
    pub process_data_interface: u8,
    /// How often the watchdog of the sync managers ran out.
    pub watchdog: u8,
}

/// The distributed clock of a device, as its registers show it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockFacts {
    /// Whether it has 64 bits.
    pub is_64: bool,
    /// System time, ns.
    pub time_ns: u64,
    /// Offset added to its own time, ns.
    pub offset_ns: i64,
    /// Delay from the reference clock, ns.
    pub delay_ns: u32,
    /// Mean difference from the reference clock, ns; below 0 if it is behind.
    pub difference_ns: i64,
    /// Cycle of SYNC0 in ns, and its next moment in system time; `None` if it is off.
    pub sync0: Option<(u32, u64)>,
}

impl<L: EthernetLink> SegmentService<L> {
    /// Reads the counters of a device.
    ///
    /// # Errors
    /// As [`SegmentService::read`].
    pub fn counters(&mut self, position: u16) -> Result<Counters, SegmentError> {
        let links = u16_at(&self.read(position, register::DL_STATUS, 2)?, 0);
        let bytes = self.read(position, register::RX_ERROR, COUNTERS_LEN)?;
        let [watchdog] = array(&self.read(position, register::WATCHDOG_COUNTER, 1)?, 0);
        let at = |address: u16| bytes.get(usize::from(address - register::RX_ERROR)).copied().unwrap_or_default();
        let port = |port: u16| PortCounters {
            is_linked: links & 1 << (4 + port) != 0,
            invalid_frames: at(register::RX_ERROR + 2 * port),
            physical_errors: at(register::RX_ERROR + 2 * port + 1),
            forwarded: at(register::FORWARDED_RX_ERROR + port),
            lost_links: at(register::LOST_LINK + port),
        };
        Ok(Counters {
            ports: [port(0), port(1), port(2), port(3)],
            processing_unit: at(register::PROCESSING_UNIT_ERROR),
            process_data_interface: at(register::PDI_ERROR),
            watchdog,
        })
    }

    /// Clears the counters of a device.
    ///
    /// # Errors
    /// As [`SegmentService::read`].
    pub fn clear_counters(&mut self, position: u16) -> Result<(), SegmentError> {
        // A write to one of a group clears all of them.
        for (register, len) in [
            (register::RX_ERROR, PORTS * 2),
            (register::PROCESSING_UNIT_ERROR, 1),
            (register::PDI_ERROR, 1),
            (register::LOST_LINK, PORTS),
            (register::WATCHDOG_COUNTER, 1),
        ] {
            self.write(position, register, [0; PORTS * 2].get(..len).unwrap_or_default())?;
        }
        Ok(())
    }

    /// The clock of a device; `None` if it has none.
    ///
    /// # Errors
    /// As [`SegmentService::read`].
    pub fn clock(&mut self, position: u16) -> Result<Option<ClockFacts>, SegmentError> {
        let features = u16_at(&self.read(position, register::FEATURES, 2)?, 0);
        if features & feature::DC == 0 {
            return Ok(None);
        }
        let clock = self.read(position, register::DC_SYSTEM_TIME, CLOCK_LEN)?;
        let sync = self.read(position, register::DC_CYCLIC_CONTROL, SYNC_LEN)?;
        let at = |address: u16| usize::from(address - register::DC_SYSTEM_TIME);
        let in_sync = |address: u16| usize::from(address - register::DC_CYCLIC_CONTROL);
        let [activation] = array(&sync, in_sync(register::DC_ACTIVATION));
        let start = u64::from_le_bytes(array(&sync, in_sync(register::DC_START_TIME)));
        let has_sync0 = activation & 0b11 == 0b11;
        Ok(Some(ClockFacts {
            is_64: features & feature::DC_64 != 0,
            time_ns: u64::from_le_bytes(array(&clock, 0)),
            offset_ns: i64::from_le_bytes(array(&clock, at(register::DC_OFFSET))),
            delay_ns: u32_at(&clock, at(register::DC_DELAY)),
            difference_ns: register::difference_ns(u32_at(&clock, at(register::DC_DIFFERENCE))),
            sync0: has_sync0.then(|| (u32_at(&sync, in_sync(register::DC_SYNC0_CYCLE)), start)),
        }))
    }
}
