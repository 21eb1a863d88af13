//! Watchdogs with which a drive monitors its master, and the time base of a simulated drive.

use std::time::Duration;

/// Heartbeat periods after which a node is taken for lost, by the master and by the drives alike.
pub const HEARTBEAT_PERIODS: u32 = 2;
/// Cycles after which a drive stops by itself whose set-points, or SYNC, stay away.
pub const WATCHED_CYCLES: u32 = 5;
/// Longest time from the last thing heard to the drive's reaction with which torque may be commanded.
pub const TORQUE_LIMIT: Duration = Duration::from_millis(10);

/// A watch that a drive keeps on its master.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Watchdog {
    /// SYNC has to come.
    Sync,
    /// Set-points have to come (14xxh:5).
    SetPoints,
    /// The master's heartbeat has to come (1016h).
    Heartbeat,
    /// Process data have to be written (the watchdog of a sync manager, 0420h).
    Outputs,
    /// The device has to be in OP. The master asks it for SAFE-OP when another master writes to it, since it takes no outputs there.
    Operational,
}

impl Watchdog {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Sync, Self::SetPoints, Self::Heartbeat, Self::Outputs, Self::Operational];
    /// Watchdogs of drives on CANopen.
    pub const CANOPEN: [Self; 3] = [Self::Sync, Self::SetPoints, Self::Heartbeat];
    /// Watches of drives on EtherCAT.
    pub const ETHERCAT: [Self; 2] = [Self::Outputs, Self::Operational];

    /// Its bit in 2010h of a simulated drive.
    pub const fn bit(self) -> u8 {
        1 << self as u8
    }

    /// Name of the monitored message.
    pub const fn name(self) -> &'static str {
        match self {
            Watchdog::Sync => "SYNC",
            Watchdog::SetPoints => "set-points",
            Watchdog::Heartbeat => "heartbeat",
            Watchdog::Outputs => "outputs",
            Watchdog::Operational => "OP",
        }
    }

    /// Whether the drive acts by it when the master dies.
    pub const fn guards_against_silence(self) -> bool {
        !matches!(self, Watchdog::Operational)
    }
}

/// Time base of a simulated drive, as it reports in 2011h.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clock {
    /// Time from another process: the embedded simulation, or the process with the arm.
    Elsewhere,
    /// SYNC: one period for each.
    Sync,
    /// The wall.
    Wall,
}

impl Clock {
    /// Value of 2011h.
    pub const fn code(self) -> u8 {
        self as u8
    }
}
