//! The far end of the bus: arm, hand, simulated drives and sensor, and the virtual CAN bus.
//!
//! The devices are served from object dictionaries over frames; the master sees nothing else of them.

pub mod arm;
pub mod can;
mod device;
mod drive;
pub mod ethercat;
mod force_sensor;
pub mod hand;
mod normal;
pub mod point_mass;
mod substeps;
mod uniform;

pub use device::DeviceError;
pub use drive::{
    AxisSettings, AxisView, Drive, DriveQuirks, DriveSettings, Encoder, EthercatDrive, OddObject, PositionLoop,
};
pub use force_sensor::{
    ForceSensor, ForceSensorSettings, ForceTorqueSensor, ForceTorqueSettings, SYNC_RATE_HZ, Speaks,
};
pub use normal::standard_normal;
pub use uniform::share_of_one;

#[cfg(test)]
mod tests;
