//! Addresses of the registers of an EtherCAT slave controller (ESC).
//!
//! # Source
//! ETG.1000.4, clause 6; names as there.

/// Type of the controller, u8.
pub const TYPE: u16 = 0x0000;
/// Number of FMMUs, u8.
pub const FMMU_COUNT: u16 = 0x0004;
/// Number of sync managers, u8.
pub const SYNC_MANAGER_COUNT: u16 = 0x0005;
/// Size of the process data memory in kB, u8.
pub const RAM_SIZE: u16 = 0x0006;
/// Port descriptor, two bits a port, u8.
pub const PORT_DESCRIPTOR: u16 = 0x0007;
/// Features, u16: see [`feature`].
pub const FEATURES: u16 = 0x0008;
/// Configured station address, u16.
pub const STATION_ADDRESS: u16 = 0x0010;
/// Configured station alias, u16.
pub const STATION_ALIAS: u16 = 0x0012;
/// DL control, u32: bit 24 lets the alias be an address.
pub const DL_CONTROL: u16 = 0x0100;
/// DL status, u16: bits 4 to 7 link at port 0 to 3, then two bits a port: loop closed, communication.
pub const DL_STATUS: u16 = 0x0110;
/// AL control, u16.
pub const AL_CONTROL: u16 = 0x0120;
/// AL status, u16.
pub const AL_STATUS: u16 = 0x0130;
/// AL status code, u16.
pub const AL_STATUS_CODE: u16 = 0x0134;
/// Receive errors, two u8 a port: invalid frames, physical errors.
pub const RX_ERROR: u16 = 0x0300;
/// Forwarded receive errors, u8 a port.
pub const FORWARDED_RX_ERROR: u16 = 0x0308;
/// Errors of the processing unit: frames with datagrams that cannot be, u8.
pub const PROCESSING_UNIT_ERROR: u16 = 0x030c;
/// Errors of the process data interface, u8.
pub const PDI_ERROR: u16 = 0x030d;
/// Lost links, u8 a port.
pub const LOST_LINK: u16 = 0x0310;
/// Watchdog divider in 40 ns less 2, u16.
pub const WATCHDOG_DIVIDER: u16 = 0x0400;
/// Time of the watchdog of the process data interface in divided ticks, u16.
pub const WATCHDOG_PDI: u16 = 0x0410;
/// Time of the watchdog of the sync managers in divided ticks, u16; 0 switches it off.
pub const WATCHDOG_SYNC_MANAGER: u16 = 0x0420;
/// Whether the watchdog of the sync managers is content, u16, bit 0.
pub const WATCHDOG_STATUS: u16 = 0x0440;
/// Number of times that the watchdog of the sync managers ran out, u8.
pub const WATCHDOG_COUNTER: u16 = 0x0442;
/// SII configuration: bit 0 offers the SII to the device, bit 1 takes it back; u8.
pub const SII_CONFIGURATION: u16 = 0x0500;
/// Whether the device has the SII, u8, bit 0.
pub const SII_PDI_ACCESS: u16 = 0x0501;
/// SII control and status, u16: see [`sii_control`].
pub const SII_CONTROL: u16 = 0x0502;
/// SII address in words, u32.
pub const SII_ADDRESS: u16 = 0x0504;
/// SII data, 8 bytes.
pub const SII_DATA: u16 = 0x0508;
/// First FMMU; 16 bytes each.
pub const FMMU: u16 = 0x0600;
/// First sync manager; 8 bytes each.
pub const SYNC_MANAGER: u16 = 0x0800;
/// Receive time at port 0 to 3, u32 each; a write latches them.
pub const DC_RECEIVE_TIME: u16 = 0x0900;
/// System time, u64; a write is compared with the own one.
pub const DC_SYSTEM_TIME: u16 = 0x0910;
/// Receive time at the processing unit, u64, in the time of the device.
pub const DC_RECEIVE_TIME_UNIT: u16 = 0x0918;
/// Offset added to the time of the device, u64.
pub const DC_OFFSET: u16 = 0x0920;
/// Delay from the reference clock, u32, ns.
pub const DC_DELAY: u16 = 0x0928;
/// Mean difference from the reference clock, sign (bit 31, set if the own time is behind) and magnitude in ns.
pub const DC_DIFFERENCE: u16 = 0x092c;
/// Speed counter start, u16.
pub const DC_SPEED_START: u16 = 0x0930;
/// Speed counter difference, i16.
pub const DC_SPEED_DIFFERENCE: u16 = 0x0932;
/// Depth of the filter of the difference, u8: a mean of 2^depth.
pub const DC_FILTER_DEPTH: u16 = 0x0934;
/// Owner of the cyclic unit, u8.
pub const DC_CYCLIC_CONTROL: u16 = 0x0980;
/// Activation of the sync signals, u8: bit 0 the unit, bit 1 SYNC0, bit 2 SYNC1.
pub const DC_ACTIVATION: u16 = 0x0981;
/// Whether sync signals are pending, u8: bit 0 SYNC0.
pub const DC_ACTIVATION_STATUS: u16 = 0x0984;
/// Start of the sync signals, u64, system time; read: the next SYNC0.
pub const DC_START_TIME: u16 = 0x0990;
/// Cycle of SYNC0, u32, ns; 0 gives one pulse.
pub const DC_SYNC0_CYCLE: u16 = 0x09a0;
/// SYNC1 after SYNC0, u32, ns.
pub const DC_SYNC1_CYCLE: u16 = 0x09a4;
/// First byte of the process data memory.
pub const PROCESS_DATA: u16 = 0x1000;

/// Returns the difference in [`DC_DIFFERENCE`] in ns, below 0 if the own time is behind.
pub const fn difference_ns(raw: u32) -> i64 {
    let magnitude = (raw & 0x7fff_ffff) as i64;
    if raw >> 31 == 0 { magnitude } else { -magnitude }
}

/// Registers for a person to read: address, bytes, name.
pub const NAMED: [(u16, usize, &str); 27] = [
    (TYPE, 1, "type"),
    (0x0001, 1, "revision"),
    (0x0002, 2, "build"),
    (FMMU_COUNT, 1, "fmmus"),
    (SYNC_MANAGER_COUNT, 1, "sync-managers"),
    (RAM_SIZE, 1, "ram-kb"),
    (PORT_DESCRIPTOR, 1, "port-descriptor"),
    (FEATURES, 2, "features"),
    (STATION_ADDRESS, 2, "station-address"),
    (STATION_ALIAS, 2, "station-alias"),
    (DL_CONTROL, 4, "dl-control"),
    (DL_STATUS, 2, "dl-status"),
    (AL_CONTROL, 2, "al-control"),
    (AL_STATUS, 2, "al-status"),
    (AL_STATUS_CODE, 2, "al-status-code"),
    (RX_ERROR, 8, "rx-error"),
    (FORWARDED_RX_ERROR, 4, "forwarded-rx-error"),
    (PROCESSING_UNIT_ERROR, 1, "processing-unit-error"),
    (PDI_ERROR, 1, "pdi-error"),
    (LOST_LINK, 4, "lost-link"),
    (WATCHDOG_DIVIDER, 2, "watchdog-divider"),
    (WATCHDOG_SYNC_MANAGER, 2, "watchdog-sync-manager"),
    (WATCHDOG_STATUS, 2, "watchdog-status"),
    (WATCHDOG_COUNTER, 1, "watchdog-counter"),
    (SII_CONTROL, 2, "sii-control"),
    (DC_SYSTEM_TIME, 8, "dc-system-time"),
    (DC_DIFFERENCE, 4, "dc-difference"),
];

/// Bits of [`FEATURES`].
pub mod feature {
    /// Distributed clocks.
    pub const DC: u16 = 1 << 2;
    /// They have 64 bits.
    pub const DC_64: u16 = 1 << 3;
    /// LRW is not supported.
    pub const NO_LRW: u16 = 1 << 9;
}

/// Bits of [`SII_CONTROL`].
pub mod sii_control {
    /// Enables a write that comes in the same datagram.
    pub const WRITE_ENABLE: u16 = 1 << 0;
    /// The device emulates the memory.
    pub const EMULATED: u16 = 1 << 5;
    /// A read gives 8 bytes, otherwise 4.
    pub const EIGHT_BYTES: u16 = 1 << 6;
    /// The memory is larger than 2 kB.
    pub const LARGE: u16 = 1 << 7;
    /// Read.
    pub const READ: u16 = 1 << 8;
    /// Write.
    pub const WRITE: u16 = 1 << 9;
    /// Reload the configuration.
    pub const RELOAD: u16 = 1 << 10;
    /// The checksum of the configuration is wrong.
    pub const CHECKSUM_ERROR: u16 = 1 << 11;
    /// The configuration is not loaded.
    pub const NOT_LOADED: u16 = 1 << 12;
    /// The memory did not answer, or the command does not exist.
    pub const COMMAND_ERROR: u16 = 1 << 13;
    /// A write without its enable bit.
    pub const WRITE_ENABLE_ERROR: u16 = 1 << 14;
    /// A command is being carried out.
    pub const BUSY: u16 = 1 << 15;
}
