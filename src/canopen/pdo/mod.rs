//! PDO mappings, and the PDO engine of a device.

mod layout;

pub use layout::{Field, Layout, PdoParameters, is_dummy};
