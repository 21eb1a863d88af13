//! What a watchdog drill finds: does each drive stop by itself when it no longer hears what it watches, and how soon?

use std::time::Duration;

use crate::config;
pub use yieldwall_drives::watchdog::TORQUE_LIMIT;
use yieldwall_drives::watchdog::Watchdog;

/// Longest time that a drive is waited for.
pub const DRILL_LIMIT: Duration = Duration::from_secs(1);
/// Cycles from enabling to the silence: the arm rests.
pub const CYCLES_BEFORE_SILENCE: u32 = 50;

/// What one watchdog does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Which one.
    pub watchdog: Watchdog,
    /// Time from the last thing heard to leaving Operation Enabled, of the left and of the right drive; `None` if it did not
    /// within [`DRILL_LIMIT`].
    pub stopped_after: [Option<Duration>; 2],
}

/// What a drill has found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Drilled {
    /// One finding a watchdog.
    pub findings: Vec<Finding>,
    /// Longest time between two looks at a drive: by so much the true times may be shorter.
    pub resolution: Duration,
}

/// Why a rig with these drives must not be enabled.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unsafe {
    /// A drive goes on.
    #[error("the {side} drive goes on for more than {} s when {} stay away", DRILL_LIMIT.as_secs_f64(), .watchdog.name())]
    GoesOn {
        /// Which drive.
        side: &'static str,
        /// What it does not watch.
        watchdog: Watchdog,
    },
    /// A drive in torque mode is too slow.
    #[error(
        "torque mode needs a drive that stops by itself within {} ms when the master dies; the {side} drive takes {:.1} ms",
        TORQUE_LIMIT.as_millis(),
        1e3 * .takes.as_secs_f64()
    )]
    TooSlow {
        /// Which drive.
        side: &'static str,
        /// How long it takes.
        takes: Duration,
    },
}

/// What a rig asks of the watchdogs of its drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Demands {
    /// Whether torque is commanded.
    pub is_torque: bool,
    /// Watchdogs that the left and the right drive do not have by their profiles, a bit each ([`Watchdog::bit`]).
    pub lacks: [u8; 2],
}

impl Demands {
    /// Of a rig.
    pub fn of(rig: &config::Rig) -> Self {
        let lacks = |drive: &config::Drive| {
            let servo = drive.profile.get().and_then(|profile| profile.servo());
            let lacking =
                Watchdog::ALL.into_iter().filter(|watchdog| servo.is_some_and(|servo| servo.lacks(*watchdog)));
            lacking.fold(0, |bits, watchdog| bits | watchdog.bit())
        };
        Self { is_torque: rig.rig.command_mode == config::CommandMode::Torque, lacks: rig.drives.each_ref().map(lacks) }
    }
}

impl Drilled {
    /// Whether drives with these watchdogs may be enabled. That for the heartbeat has to stop each drive, and so has each other
    /// one that the drive has by its profile; in torque mode the one that is fastest when the master dies has to within
    /// [`TORQUE_LIMIT`].
    ///
    /// # Errors
    /// Why not.
    pub fn judge(&self, demands: Demands) -> Result<(), Unsafe> {
        for (drive, side) in ["left", "right"].into_iter().enumerate() {
            let mut fastest = Duration::MAX;
            for watchdog in Watchdog::ALL {
                let finding = self.findings.iter().find(|finding| finding.watchdog == watchdog);
                match finding.and_then(|finding| finding.stopped_after.get(drive).copied().flatten()) {
                    Some(takes) => fastest = fastest.min(takes),
                    None if watchdog != Watchdog::Heartbeat && demands.lacks[drive] & watchdog.bit() != 0 => {}
                    None => return Err(Unsafe::GoesOn { side, watchdog }),
                }
            }
            if demands.is_torque && fastest > TORQUE_LIMIT {
                return Err(Unsafe::TooSlow { side, takes: fastest });
            }
        }
        Ok(())
    }
}
