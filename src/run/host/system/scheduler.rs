//! Priority and locked memory. The only calls for which no crate of this workspace has a safe wrapper are here.
#![allow(unsafe_code)]

use std::io;

use rustix::mm::{MlockAllFlags, mlockall};

/// Priority of the loop under SCHED_FIFO: above the kernel's interrupt threads (50), below its watchdogs (99).
pub const PRIORITY: i32 = 80;

/// Request that this computer did not grant.
#[derive(Debug, thiserror::Error)]
pub enum Refusal {
    /// No real-time priority.
    #[error(
        "no SCHED_FIFO {PRIORITY} ({0}): the loop competes with everything else. Raise `rtprio` in \
         /etc/security/limits.d for this user, or LimitRTPRIO of the systemd unit, to at least {PRIORITY}"
    )]
    Priority(io::Error),
    /// No locked memory.
    #[error(
        "no locked memory ({0}): the loop may wait for a page. Set `memlock` to unlimited in /etc/security/limits.d for \
         this user, or LimitMEMLOCK=infinity of the systemd unit"
    )]
    Memory(io::Error),
}

/// Keeps all memory of this process, present and future, in RAM.
///
/// # Errors
/// If the system refuses.
pub fn lock_memory() -> Result<(), Refusal> {
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE).map_err(|error| Refusal::Memory(error.into()))
}

/// Runs the calling thread before every thread of a lower priority (SCHED_FIFO).
///
/// # Errors
/// If the system refuses.
pub fn run_first() -> Result<(), Refusal> {
    // SAFETY: it is a struct of numbers, and of more of them with some C libraries than with others.
    let mut parameters: libc::sched_param = unsafe { std::mem::zeroed() };
    parameters.sched_priority = PRIORITY;
    // SAFETY: `parameters` is a valid `sched_param` that the call only reads; 0 names the calling thread.
    let result = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) };
    if result == 0 { Ok(()) } else { Err(Refusal::Priority(io::Error::last_os_error())) }
}
