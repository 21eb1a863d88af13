//! EtherCAT codecs and engines, without input and output; the clock is an argument.
//!
//! ```text
//! Ethernet frame -> datagrams (command, address, data, working counter) -> registers, FMMU, sync managers
//!                                                                       -> mailbox -> CoE (SDO, information, emergency)
//! SII image <-> categories (strings, general, FMMU, sync managers, PDOs)
//! ```
//!
//! | side | what |
//! |---|---|
//! | both | [`frame`], [`registers`], [`Fmmu`], [`SyncManager`], [`AlStatus`], [`sii`], [`mailbox`], [`coe`] |
//! | master | [`coe::CoeClient`], [`mailbox::MailboxClient`] |
//! | device | [`coe::CoeServer`] |
//!
//! # Source
//! ETG.1000.4 (data link layer), ETG.1000.6 (application layer), ETG.1020 (protocol enhancements), ETG.2010 (SII).

mod al;
pub mod coe;
mod error;
mod fmmu;
pub mod frame;
pub mod mailbox;
pub mod registers;
pub mod sii;
mod sync_manager;

pub use al::{AlControl, AlState, AlStatus, AlStatusCode};
pub use error::EthercatError;
pub use fmmu::{Direction, Fmmu};
pub use sync_manager::{BufferMode, SyncManager};

/// Returns the bytes `at..at + N` of `bytes`, all zero if these go beyond the end.
pub fn array<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    bytes.get(at..).and_then(|rest| rest.first_chunk()).copied().unwrap_or([0; N])
}

/// Returns the little-endian word at `at`, zero if it goes beyond the end.
pub fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes(array(bytes, at))
}

/// Returns the little-endian double word at `at`, zero if it goes beyond the end.
pub fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(array(bytes, at))
}
