//! Requests to single devices on a bus while no rig runs: which devices are there, and how to read and write their objects.
//!
//! ```text
//! CanLink <-> Service: one SDO channel for each node, what was heard of each
//!                |-- scan       who is there
//!                |-- doctor     why a node does not answer
//!                |-- adopt      what a drive can do, tried out and put back -> a device profile
//!                |-- inventory  all objects, found without a data sheet or by one
//!                `-- restore    values of a file against those of the device -> steps in order -> written and read back
//! EthernetLink <-> SegmentService: registers, SII and objects of each device of an EtherCAT segment, by position
//! ObjectAccess   the objects of one device, on either
//! journal        what devices held: on disk before a program changes them, restored at its end
//! ```
//! Nothing here is real-time, and nothing sends a set-point or brings a drive nearer to Operation Enabled
//! ([`Caution::of_write`]).

pub mod adopt;
mod axes;
mod caution;
mod connect;
mod connection;
mod described_image;
pub mod doctor;
mod inventory;
pub mod journal;
mod known;
mod listen;
mod object_access;
mod restore;
#[cfg(test)]
#[path = "../sample.rs"]
mod sample;
mod scan;
mod segment;
#[cfg(test)]
mod tests;

pub use axes::{MOST_AXES, count_axes, count_axes_by, statusword_of};
pub use caution::Caution;
#[cfg(all(feature = "socketcan", target_os = "linux"))]
pub use connect::OnInterfaces;
pub use connect::{AnySegmentService, AnyService, Connect, ConnectError};
pub use connection::{Bytes, Error, NodeTraffic, Service};
pub use described_image::{DescribedImage, ImageError, LeftOutOfImage, described_image};
pub use inventory::{Unread, UnreadObject, inventory, inventory_of, sheet_of, type_by_length, values_of};
pub use known::{Known, known, named, names, titled, torque_limit, type_held};
pub use listen::listen;
pub use object_access::{NodeObjects, ObjectAccess};
pub use restore::{LeftOut, Plan, Step, Why, WriteOutcome, carry_out, downloads, is_shown, plan};
pub use scan::{FoundDevice, Identity, identify, number, of_node, scan};
pub use segment::{ClockFacts, Counters, DeviceObjects, PortCounters, Present, SegmentError, SegmentService};
