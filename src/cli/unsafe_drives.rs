//! Drives that would continue after the death of their master: the reason in their profiles, and the remedy.

use yieldwall_drives::profiles::{BuiltInWatch, HeartbeatWatch, Reaction, Servo, SetPointWatch, SyncWatch};
use yieldwall_drives::watchdog::{HEARTBEAT_PERIODS, TORQUE_LIMIT, Watchdog};

use super::failure::{Exit, Failure};
use super::report_text::{copy_of, copying};
use yieldwall_config::{CommandMode, Drive, HEARTBEAT_CYCLES, Rig};
use yieldwall_run::{Demands, Drilled, Unsafe};

/// Statement of a refusal before any drive on a bus was enabled.
pub(crate) const NOTHING_ENABLED: &str = "nothing was enabled";

/// Refuses drives that would continue after the death of their master; `before` names the actions on the rig until then.
pub(crate) fn judge(drilled: &Drilled, rig: &Rig, before: &str) -> Result<(), Failure> {
    drilled.judge(Demands::of(rig)).map_err(|error| {
        Failure::new(Exit::OutOfTolerance, error.to_string(), format!("{before}; {}", advice(&error, rig)))
    })
}

/// Returns the remedy for drives that a rig must not enable.
pub(crate) fn advice(error: &Unsafe, rig: &Rig) -> String {
    let [left, right] = &rig.drives;
    match error {
        Unsafe::GoesOn { side, watchdog } => goes_on(if *side == "left" { left } else { right }, *watchdog, rig),
        Unsafe::TooSlow { .. } => too_slow(rig),
    }
}

/// A drive on a segment that continues without outputs.
const OUTPUTS: &str = "the master sets the watchdog of its sync manager (0420h): check in the manual whether the drive's controller has this watchdog";

/// A drive that keeps its torque in SAFE-OP.
const OPERATIONAL: &str = "the drive kept its torque in SAFE-OP: check in its manual the reaction to leaving OP (usually 6007h), and set it to stop";

/// Describes a drive in torque mode that stops too late.
fn too_slow(rig: &Rig) -> String {
    let period_us = rig.cycle.period_us;
    let most_ms = TORQUE_LIMIT.as_millis() / u128::from(HEARTBEAT_PERIODS);
    let is_allowed = 1000 * most_ms >= u128::from(HEARTBEAT_CYCLES) * u128::from(period_us);
    let what = if is_allowed {
        format!("shorten `cycle.period_us`, or write a `heartbeat_ms` of at most {most_ms}")
    } else {
        format!(
            "shorten `cycle.period_us`; a `heartbeat_ms` of at most {most_ms} has to be {HEARTBEAT_CYCLES} cycles or more"
        )
    };
    format!(
        "drives watch SYNC and set-points for a number of cycles of {period_us} us, and the heartbeat for {HEARTBEAT_PERIODS} periods of the master \
         (`heartbeat_ms` of its bus): {what}. In position and velocity mode (`rig.command_mode`) a drive may stop later"
    )
}

/// Describes a drive that continues without a monitored signal.
fn goes_on(drive: &Drive, watchdog: Watchdog, rig: &Rig) -> String {
    let Some(servo) = drive.profile.get().and_then(|profile| profile.servo()) else { return String::new() };
    let why = match watchdog {
        Watchdog::Heartbeat => return without_heartbeat(drive, servo),
        Watchdog::Outputs => return OUTPUTS.to_owned(),
        Watchdog::Operational => return OPERATIONAL.to_owned(),
        Watchdog::Sync => watch_of_sync(servo),
        Watchdog::SetPoints => watch_of_set_points(servo),
    };
    let key = match watchdog {
        Watchdog::SetPoints => "device.servo.watchdogs.set_points",
        _ => "device.servo.watchdogs.sync",
    };
    let name = drive.profile.get().map_or("", |profile| profile.name());
    let says = match why {
        Why::NoReaction(kind) => format!(
            "states that the drive watches {}, but no reaction: write `{key}.{kind}.reaction` from the drive's manual, \
             abort_connection or fault",
            watchdog.name()
        ),
        Why::NoTime => format!(
            "states that the drive watches {}, but no time, so that the simulated drive never reacts: write \
             `{key}.built_in.periods` from the drive's manual",
            watchdog.name()
        ),
        Why::Nothing => format!("states no reaction of the drive to missing {}", watchdog.name()),
        Why::Contradicted => format!(
            "states that the drive stops without {}, but it continues: check this setting in the drive",
            watchdog.name()
        ),
    };
    let enough = match rig.rig.command_mode {
        CommandMode::Torque => format!(
            "in position and velocity mode (`rig.command_mode`) the heartbeat watchdog is then sufficient; torque mode needs a \
             watchdog that stops the drive within {} ms",
            TORQUE_LIMIT.as_millis()
        ),
        CommandMode::Velocity | CommandMode::Position => {
            "in this mode the heartbeat watchdog is then sufficient, if the drill confirms it".to_owned()
        }
    };
    let copy = match drive.profile.is_file() {
        true => String::new(),
        false => format!(
            "\n`{name}` is a shipped profile: copy it with `{}`, and write `profile: {}` in the rig",
            copying(name),
            copy_of(name)
        ),
    };
    format!("the profile `{name}` {says}; or write `{key}: none` if the drive has no such watchdog: {enough}{copy}")
}

/// Reason why a drive continues although its profile has a watch.
enum Why {
    /// The profile does not state the reaction; the key of the watch.
    NoReaction(&'static str),
    /// The profile does not state its waiting time.
    NoTime,
    /// It does nothing by its profile.
    Nothing,
    /// By its profile it stops.
    Contradicted,
}

impl Why {
    fn of(kind: &'static str, reaction: Reaction, has_time: bool) -> Self {
        match reaction {
            Reaction::Unknown => Self::NoReaction(kind),
            Reaction::Nothing => Self::Nothing,
            _ if !has_time => Self::NoTime,
            _ => Self::Contradicted,
        }
    }

    fn of_built_in(watch: &BuiltInWatch) -> Self {
        Self::of("built_in", watch.reaction, watch.periods.is_some())
    }
}

fn watch_of_sync(servo: &Servo) -> Why {
    match &servo.watchdogs.sync {
        SyncWatch::None => Why::Nothing,
        SyncWatch::BuiltIn(watch) => Why::of_built_in(watch),
        SyncWatch::Object(timed) => Why::of("object", timed.reaction, true),
    }
}

fn watch_of_set_points(servo: &Servo) -> Why {
    match &servo.watchdogs.set_points {
        SetPointWatch::None => Why::Nothing,
        SetPointWatch::BuiltIn(watch) => Why::of_built_in(watch),
        SetPointWatch::EventTimer { reaction, .. } => Why::of("event_timer", *reaction, true),
        SetPointWatch::Object(timed) => Why::of("object", timed.reaction, true),
    }
}

/// The master's heartbeat has to stop every drive in every mode: a dead program no longer sends it.
fn without_heartbeat(drive: &Drive, servo: &Servo) -> String {
    let name = drive.profile.get().map_or("", |profile| profile.name());
    let needed = "every drive has to watch the heartbeat, in every mode: a program that has failed sends none";
    match (&servo.watchdogs.heartbeat, &servo.option_codes.lost_master) {
        (HeartbeatWatch::None, _) => {
            format!(
                "{needed}; the profile `{name}` has no such watchdog (1016h), and no mode avoids it: use another drive"
            )
        }
        (_, None) => format!(
            "{needed}; the profile `{name}` does not state how to set the drive to stop then: write \
             `device.servo.option_codes.lost_master` (6007h) from its manual"
        ),
        (_, Some(setting)) => format!(
            "{needed}; the drive was set to watch it, and {:04X}h = {} to stop then: compare both with its manual",
            setting.object.index, setting.value
        ),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use yieldwall_config as config;
    use yieldwall_run::Finding;

    /// Returns the advice if nothing stops drives with these profiles.
    fn advice(profile: &str, mode: CommandMode, goes_on: &[Watchdog], after_ms: u64) -> String {
        advice_at(1000, profile, mode, goes_on, after_ms)
    }

    fn advice_at(period_us: u32, profile: &str, mode: CommandMode, goes_on: &[Watchdog], after_ms: u64) -> String {
        let mut rig = config::load_rig(config::builtin("paper-admittance-csp.yaml")).unwrap().value;
        (rig.rig.command_mode, rig.cycle.period_us) = (mode, period_us);
        rig.drives.iter_mut().for_each(|drive| drive.profile = profile.to_owned().into());
        let finding = |watchdog| Finding {
            watchdog,
            stopped_after: [(!goes_on.contains(&watchdog)).then(|| Duration::from_millis(after_ms)); 2],
            stopped_in: [None; 2],
        };
        let drilled = Drilled { findings: Watchdog::CANOPEN.map(finding).to_vec(), resolution: Duration::ZERO };
        let failure = judge(&drilled, &rig, NOTHING_ENABLED).unwrap_err();
        failure.report.diagnostics[0].help.clone().unwrap()
    }

    #[test]
    fn a_heartbeat_is_advised_that_the_cycle_allows() {
        let advice = |period_us| advice_at(period_us, "simulated-servo", CommandMode::Torque, &[], 40);
        assert!(advice(2500).contains("or write a `heartbeat_ms` of at most 5"), "{}", advice(2500));
        let slow = advice(5000);
        assert!(
            slow.contains("shorten `cycle.period_us`; a `heartbeat_ms` of at most 5 has to be 2 cycles or more"),
            "{slow}"
        );
    }

    #[test]
    fn advice_says_what_a_profile_lacks_and_which_choice_helps() {
        let both = [Watchdog::Sync, Watchdog::SetPoints];
        for (profile, mode, goes_on, says) in [
            ("maxon-epos4", CommandMode::Position, &both[..], "`device.servo.watchdogs.set_points.built_in.periods`"),
            ("maxon-epos4", CommandMode::Position, &both, "in this mode the heartbeat watchdog is then sufficient"),
            (
                "maxon-epos4",
                CommandMode::Torque,
                &both,
                "torque mode needs a watchdog that stops the drive within 10 ms",
            ),
            (
                "zeroerr-edriver",
                CommandMode::Position,
                &both,
                "`device.servo.watchdogs.set_points.event_timer.reaction`",
            ),
            ("simulated-servo", CommandMode::Position, &both, "but it continues: check this setting in the drive"),
            ("simulated-servo", CommandMode::Position, &[Watchdog::Heartbeat], "6007h = 3 to stop then"),
            ("simulated-servo", CommandMode::Torque, &[], "write a `heartbeat_ms` of at most 5"),
        ] {
            let help = advice(profile, mode, goes_on, 40);
            assert!(help.contains(says), "{profile} {mode:?}: {help}");
            let is_of_file = goes_on.first() == Some(&Watchdog::Sync);
            let copy = format!("`yieldwall config show builtin:profiles/{profile}.yaml > my-{profile}.yaml`");
            assert_eq!(help.contains(&copy), is_of_file, "{help}");
        }
        for profile in ["maxon-epos4", "zeroerr-edriver", "elmo-gold", "simulated-servo"] {
            config::load(config::Source::named(&format!("builtin:profiles/{profile}.yaml"))).unwrap();
        }
    }
}
