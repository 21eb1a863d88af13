//! The far end of the bus: arm, hand, simulated drives and sensor, and the virtual CAN bus.
//!
//! The devices are served from object dictionaries over frames; the master sees nothing else of them.

pub mod arm;
pub mod can;
mod device;
pub mod drive;
pub mod force_sensor;
pub mod hand;
pub mod point_mass;
mod substeps;

pub use device::DeviceError;
