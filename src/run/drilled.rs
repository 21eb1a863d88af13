//! What a watchdog drill finds: does each drive stop by itself when it no longer hears what it watches, and how soon?

use std::time::Duration;

use yieldwall_config as config;
use yieldwall_drives::cia402::State;
use yieldwall_drives::profiles::{Reaction, Servo, SetPointWatch, SyncWatch};
pub use yieldwall_drives::watchdog::TORQUE_LIMIT;
use yieldwall_drives::watchdog::Watchdog;

/// Longest time that a drive is waited for.
pub const DRILL_LIMIT: Duration = Duration::from_secs(1);
/// Cycles from enabling to the silence: the arm rests.
pub const CYCLES_BEFORE_SILENCE: u32 = 50;

/// Reaction of one watchdog.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The watchdog.
    pub watchdog: Watchdog,
    /// Time from the last thing heard to leaving Operation Enabled, of the left and of the right drive; `None` if it did not
    /// within [`DRILL_LIMIT`].
    pub stopped_after: [Option<Duration>; 2],
    /// The first state in which each was seen then; `None` also where that is not kept.
    pub stopped_in: [Option<State>; 2],
}

impl Finding {
    /// Returns the worse reaction of the chosen drives: the drive that goes on, or else the slower one. `None` if it is not known.
    fn worst_of(&self, chosen: [bool; 2]) -> Option<Option<(Duration, State)>> {
        let mut worst = None;
        for ((after, state), is_chosen) in self.stopped_after.iter().zip(self.stopped_in).zip(chosen) {
            let Some(after) = after.filter(|_| is_chosen) else {
                if is_chosen {
                    return Some(None);
                }
                continue;
            };
            let stops = (after, state?);
            if worst.is_none_or(|(slowest, _)| slowest < after) {
                worst = Some(stops);
            }
        }
        worst.map(Some)
    }
}

/// Result of a drill.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Drilled {
    /// One finding a watchdog.
    pub findings: Vec<Finding>,
    /// Longest time between two looks at a drive: the true times may be shorter by this.
    pub resolution: Duration,
}

/// Result of a drill for a watch that a profile does not fully describe, and the text for a person to write there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Settled {
    /// Name of the profile.
    pub profile: String,
    /// Whether it comes with the program, so that a copy has to be made before anything is written into it.
    pub is_shipped: bool,
    /// The watch.
    pub watchdog: Watchdog,
    /// Time that a drive took to stop, and its state then; `None` if it went on.
    pub stops: Option<(Duration, State)>,
    /// The key in the profile.
    pub key: String,
    /// Value to write there.
    pub value: String,
}

/// Why a rig with these drives must not be enabled.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unsafe {
    /// A drive goes on.
    #[error("the {side} drive goes on for more than {} s without {}", DRILL_LIMIT.as_secs_f64(), .watchdog.name())]
    GoesOn {
        /// The drive.
        side: &'static str,
        /// Watchdog that is missing.
        watchdog: Watchdog,
    },
    /// A drive in torque mode is too slow.
    #[error(
        "torque mode needs a drive that stops by itself within {} ms when the master dies; the {side} drive takes {:.1} ms",
        TORQUE_LIMIT.as_millis(),
        1e3 * .takes.as_secs_f64()
    )]
    TooSlow {
        /// The drive.
        side: &'static str,
        /// How long it takes.
        takes: Duration,
    },
}

/// Demands of a rig on the watchdogs of its drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Demands {
    /// Whether torque is commanded.
    pub is_torque: bool,
    /// The watchdogs of such drives.
    pub watchdogs: &'static [Watchdog],
    /// Watchdogs that the left and the right drive do not have by their profiles, a bit each ([`Watchdog::bit`]).
    pub lacks: [u8; 2],
}

/// Returns the watchdogs by which the drives of a rig watch their master, on their bus.
pub fn watchdogs(rig: &config::Rig) -> &'static [Watchdog] {
    if rig.has_drives_on_ethercat() { &Watchdog::ETHERCAT } else { &Watchdog::CANOPEN }
}

impl Demands {
    /// Returns the demands of a rig.
    pub fn of(rig: &config::Rig) -> Self {
        let lacks = |drive: &config::Drive| {
            let servo = drive.profile.get().and_then(|profile| profile.servo());
            let lacking =
                Watchdog::CANOPEN.into_iter().filter(|watchdog| servo.is_some_and(|servo| servo.lacks(*watchdog)));
            lacking.fold(0, |bits, watchdog| bits | watchdog.bit())
        };
        Self {
            is_torque: rig.rig.command_mode == config::CommandMode::Torque,
            watchdogs: watchdogs(rig),
            lacks: rig.drives.each_ref().map(lacks),
        }
    }
}

impl Drilled {
    /// Returns the drill's results for SYNC and set-point watches that the rig's profiles lack or give no reaction for. Drives that
    /// are simulated by these same profiles show nothing about the real drives.
    pub fn settled(&self, rig: &config::Rig) -> Vec<Settled> {
        let mut all: Vec<Settled> = Vec::new();
        let names = rig.drives.each_ref().map(|drive| drive.profile.get().map(|profile| profile.name()));
        for drive in &rig.drives {
            let Some(profile) = drive.profile.get() else { continue };
            let Some(servo) = profile.servo() else { continue };
            for finding in &self.findings {
                let own = names.map(|name| name == Some(profile.name()));
                let Some(stops) = finding.worst_of(own) else { continue };
                let Some((key, value)) = to_write(servo, finding.watchdog, stops.map(|(_, state)| state)) else {
                    continue;
                };
                let (profile, watchdog) = (profile.name().to_owned(), finding.watchdog);
                let is_shipped = !drive.profile.is_file();
                let settled = Settled { profile, is_shipped, watchdog, stops, key, value };
                if !all.contains(&settled) {
                    all.push(settled);
                }
            }
        }
        all
    }

    /// Checks whether drives with these watchdogs may be enabled. The heartbeat watchdog must stop each drive, and so must each other
    /// watchdog that the drive has by its profile. In torque mode the fastest watchdog after the master's death must stop the drive
    /// within [`TORQUE_LIMIT`].
    ///
    /// # Errors
    /// Why not.
    pub fn judge(&self, demands: Demands) -> Result<(), Unsafe> {
        for (drive, side) in ["left", "right"].into_iter().enumerate() {
            let mut fastest = Duration::MAX;
            for &watchdog in demands.watchdogs {
                let finding = self.findings.iter().find(|finding| finding.watchdog == watchdog);
                // Records of drills that did not try it are believed for what they tried.
                let was_tried = finding.is_some() || watchdog.guards_against_silence();
                match finding.and_then(|finding| finding.stopped_after.get(drive).copied().flatten()) {
                    Some(takes) if watchdog.guards_against_silence() => fastest = fastest.min(takes),
                    Some(_) => {}
                    None if !was_tried => {}
                    None if matches!(watchdog, Watchdog::Sync | Watchdog::SetPoints)
                        && demands.lacks[drive] & watchdog.bit() != 0 => {}
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

/// Returns the key and the value to write into a profile that leaves a reaction open. The value follows from the state in which the
/// drive stopped, or from the fact that it went on.
fn to_write(servo: &Servo, watchdog: Watchdog, stops_in: Option<State>) -> Option<(String, String)> {
    let (word, kind, reaction) = match watchdog {
        Watchdog::Heartbeat | Watchdog::Outputs => return None,
        Watchdog::Operational => {
            let reaction = servo.watchdogs.leaving_op.as_ref().map_or(Reaction::Unknown, |leaving| leaving.reaction);
            let seen = stops_in.map(seen_in).filter(|_| reaction == Reaction::Unknown)?;
            let key = "device.servo.watchdogs.leaving_op".to_owned();
            return Some((key, format!("{{reaction: {seen}, source: drill}}")));
        }
        Watchdog::Sync => match &servo.watchdogs.sync {
            SyncWatch::None => ("sync", "none", Reaction::Nothing),
            SyncWatch::BuiltIn(watch) => ("sync", "built_in", watch.reaction),
            SyncWatch::Object(timed) => ("sync", "object", timed.reaction),
        },
        Watchdog::SetPoints => match &servo.watchdogs.set_points {
            SetPointWatch::None => ("set_points", "none", Reaction::Nothing),
            SetPointWatch::BuiltIn(watch) => ("set_points", "built_in", watch.reaction),
            SetPointWatch::EventTimer { reaction, .. } => ("set_points", "event_timer", *reaction),
            SetPointWatch::Object(timed) => ("set_points", "object", timed.reaction),
        },
    };
    let key = format!("device.servo.watchdogs.{word}");
    let seen = stops_in.map(seen_in);
    match (kind, reaction, seen) {
        ("none", _, Some(seen)) => {
            Some((key, format!("{{built_in: {{periods: null, reaction: {seen}, source: drill}}}}")))
        }
        ("none", ..) => None,
        (_, Reaction::Unknown, Some(seen)) => Some((format!("{key}.{kind}.reaction"), seen.to_owned())),
        (_, Reaction::Unknown, None) => Some((key, "none".to_owned())),
        _ => None,
    }
}

/// Returns the reaction of a drive that stops in this state.
fn seen_in(state: State) -> &'static str {
    match state {
        State::Fault | State::FaultReactionActive => "fault",
        _ => "abort_connection",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settled(profiles: [&str; 2], after_ms: [Option<u64>; 2], state: State) -> Vec<(String, String)> {
        let mut rig = config::load_rig(config::builtin("paper-admittance-csp.yaml")).unwrap().value;
        for (drive, profile) in rig.drives.iter_mut().zip(profiles) {
            drive.profile = profile.to_owned().into();
        }
        let finding = |watchdog| Finding {
            watchdog,
            stopped_after: after_ms.map(|ms| ms.map(Duration::from_millis)),
            stopped_in: after_ms.map(|ms| ms.map(|_| state)),
        };
        let drilled = Drilled { findings: Watchdog::CANOPEN.map(finding).to_vec(), resolution: Duration::ZERO };
        drilled.settled(&rig).into_iter().map(|settled| (settled.key, settled.value)).collect()
    }

    fn wanted(lines: &[(&str, &str)]) -> Vec<(String, String)> {
        let key = |key: &str| format!("device.servo.watchdogs.{key}");
        lines.iter().map(|(at, value)| (key(at), (*value).to_owned())).collect()
    }

    /// The profile of this drive says that it has an event timer, not what it does then, and that it does not watch SYNC.
    const OPEN: [&str; 2] = ["zeroerr-edriver"; 2];

    #[test]
    fn what_a_drive_does_when_something_stays_away_is_a_line_of_its_profile() {
        let stops = [Some(5), Some(6)];
        assert_eq!(
            settled(OPEN, stops, State::FaultReactionActive),
            wanted(&[
                ("sync", "{built_in: {periods: null, reaction: fault, source: drill}}"),
                ("set_points.event_timer.reaction", "fault"),
            ])
        );
        assert_eq!(
            settled(OPEN, stops, State::QuickStopActive),
            wanted(&[
                ("sync", "{built_in: {periods: null, reaction: abort_connection, source: drill}}"),
                ("set_points.event_timer.reaction", "abort_connection"),
            ])
        );
        assert_eq!(settled(["simulated-servo"; 2], stops, State::Fault), [], "its profile says it all");
    }

    /// Torque mode, a drive on EtherCAT.
    #[test]
    fn a_drive_that_keeps_its_torque_when_it_leaves_op_is_refused_and_a_record_that_did_not_try_it_counts() {
        let demands = Demands { is_torque: true, watchdogs: &Watchdog::ETHERCAT, lacks: [0; 2] };
        let finding = |watchdog, after_ms: [Option<u64>; 2]| Finding {
            watchdog,
            stopped_after: after_ms.map(|ms| ms.map(Duration::from_millis)),
            stopped_in: [None; 2],
        };
        let judged = |of_op: Option<[Option<u64>; 2]>| {
            let findings = [finding(Watchdog::Outputs, [Some(5); 2])].into_iter();
            let findings = findings.chain(of_op.map(|after_ms| finding(Watchdog::Operational, after_ms))).collect();
            Drilled { findings, resolution: Duration::ZERO }.judge(demands)
        };
        assert_eq!(judged(None), Ok(()));
        assert_eq!(judged(Some([Some(40), Some(1)])), Ok(()), "outputs guard against a master that dies");
        let goes_on = Unsafe::GoesOn { side: "right", watchdog: Watchdog::Operational };
        assert_eq!(judged(Some([Some(1), None])), Err(goes_on));
    }

    #[test]
    fn what_a_drive_does_when_it_leaves_op_is_a_line_of_its_profile() {
        let mut rig = config::load_rig(config::builtin("paper-ethercat.yaml")).unwrap().value;
        let settled = |rig: &config::Rig| {
            let stops = [Some(Duration::from_millis(1)); 2];
            let finding = Finding {
                watchdog: Watchdog::Operational,
                stopped_after: stops,
                stopped_in: [Some(State::QuickStopActive), Some(State::SwitchOnDisabled)],
            };
            Drilled { findings: vec![finding], resolution: Duration::ZERO }.settled(rig)
        };
        assert_eq!(settled(&rig), [], "its profile says it");
        rig.drives.iter_mut().for_each(|drive| drive.profile = "zeroerr-edriver".to_owned().into());
        let lines: Vec<_> = settled(&rig).into_iter().map(|settled| (settled.key, settled.value)).collect();
        assert_eq!(lines, wanted(&[("leaving_op", "{reaction: abort_connection, source: drill}")]));
    }

    #[test]
    fn of_two_drives_of_a_profile_the_one_that_goes_on_counts() {
        for after_ms in [[Some(5), None], [None, Some(5)], [None, None]] {
            assert_eq!(
                settled(OPEN, after_ms, State::Fault).last(),
                wanted(&[("set_points", "none")]).last(),
                "{after_ms:?}"
            );
        }
    }
}
