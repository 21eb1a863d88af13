//! Injected faults: wrappers around the buses, the drives and the sensor. Without an injection they have no effect.
//!
//! ```text
//! master <-> [interfaces] <-> virtual buses <-> [passage, strangers] <-> [drive | sensor] <-> arm and hand
//! ```

mod body;
mod buses;
mod drive;
mod held;
mod interfaces;
mod participant;
mod passage;
mod sensor;
mod stranger;

pub(super) use buses::InjectableBuses;
pub(super) use drive::InjectableDrive;
pub(super) use sensor::InjectableSensor;
