//! What the embedded simulation is made of: devices and the bus between them, in virtual time.

pub mod can;
