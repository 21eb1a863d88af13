//! The other end of a real bus: the simulated devices on a link of their own, in one process or in several.

#[cfg(all(feature = "socketcan", target_os = "linux"))]
mod attach;
mod listen;
mod serve;

#[cfg(all(feature = "socketcan", target_os = "linux"))]
pub use attach::{AttachError, Attached, Entrance, attach};
pub use listen::listen;
pub use serve::{ServeError, serve};
