//! What the embedded simulation is made of: devices and the bus between them, in virtual time.

pub mod can;
mod device;
mod drive;
mod force_sensor;

pub use device::DeviceError;
pub use drive::{Drive, DriveSettings, Encoder, PositionLoop};
pub use force_sensor::{ForceSensor, ForceSensorSettings};

#[cfg(test)]
mod tests;
