//! The other end of a bus: the simulated devices on a link of their own, in one process or in several, or behind a link in virtual
//! time.

#[cfg(all(feature = "socketcan", target_os = "linux"))]
mod attach;
mod planted;
mod segment;
mod serve;
mod virtual_link;
mod virtual_segment;

#[cfg(all(feature = "socketcan", target_os = "linux"))]
pub use attach::{AttachError, Attached, Entrance, attach};
pub use planted::{PlantedLink, Trouble};
pub use segment::serve_segment;
pub use serve::{ServeError, serve};
pub use virtual_link::VirtualLink;
pub use virtual_segment::VirtualSegment;
