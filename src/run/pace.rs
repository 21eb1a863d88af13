//! Time base of a rig and of its devices.

/// Time base of a rig on a bus, and of simulated devices there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Simulated time advances by one period with each SYNC, or with the SYNCs of all buses. Before the first SYNC, after an NMT
    /// command, and 2 s after the last SYNC, it follows the wall clock in whole periods. So the network can be booted, and
    /// watchdogs act on a master that has died. The clock of a force sensor and its noise begin with the first SYNC, so that the
    /// moment of the boot does not matter.
    Lockstep,
    /// Simulated time follows the wall clock. So does a rig, on the clock of its place.
    Free,
}
