//! PDO mappings, and the PDO engine of a device.

mod engine;
mod layout;
mod parameters;

pub(super) use engine::{NO_ID, Reception, Rpdo, Tpdo};
pub use layout::{Field, Layout, PdoParameters, is_dummy};
pub(super) use parameters::{Pdo, check_cob_id, check_write, locate, verify};
