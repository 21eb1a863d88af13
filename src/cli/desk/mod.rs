//! Commands on single devices: on a bus with `--bus`, or else on a rig's simulation, for rehearsal.

pub(super) mod adopt;
pub(super) mod alias;
pub(super) mod dc;
#[cfg(target_os = "linux")]
pub(super) mod doctor;
pub(super) mod emcy;
pub(super) mod errors;
pub(super) mod info;
#[cfg(target_os = "linux")]
pub(super) mod journal;
mod keeping;
pub(super) mod lss;
pub(super) mod monitor;
pub(super) mod nmt;
pub(super) mod od;
pub(super) mod pdo;
mod place;
pub(super) mod plan;
mod reached;
pub(super) mod reg;
pub(super) mod scan;
mod segment;
pub(super) mod sii;
pub(super) mod state;
#[cfg(test)]
mod tests;
mod words;

pub(super) use place::placed_text;
pub(super) use words::{address, mapped, state_words};
