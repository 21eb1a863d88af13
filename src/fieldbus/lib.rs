//! Codecs and engines of the buses, for masters and for devices, without I/O: bytes and moments come in, bytes go out.
//!
//! ```text
//! engine.on_frame(now, frame, out)    engine.poll(now, out)    engine.next_deadline()
//! ```
//! One code runs in virtual time, on a virtual bus and on hardware.

pub mod canopen;
pub mod ethercat;
mod link_event;
pub mod objects;
mod packet;
pub mod plain_can;
pub mod time;

pub use link_event::LinkEvent;
pub use packet::Packet;
