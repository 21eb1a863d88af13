//! Causes of a failed run, and their exit codes.

use super::desk::placed_text;
use super::failure::{Exit, Failure};
use yieldwall_bus::ethercat::SegmentFailure;
use yieldwall_bus::{BootError, BootFailure};
use yieldwall_config as config;
use yieldwall_config::injection::Injection;
use yieldwall_motion::guard::{Cause, DeviceSet, Fault};
use yieldwall_rig::RigError;
use yieldwall_rig::report::RunReport;
use yieldwall_rig::report::measures::Measures;
use yieldwall_run::explanation::{self, Explanation};

/// Remedy for an impedance device that generates energy.
pub(super) const SOFTER_COUPLING: &str =
    "lower fixture.coupling's stiffness_n_per_m; `yieldwall tune fixture` shows what the device bears";

/// Returns the failure of a run that gave the hand more energy than a fixture without storage can; `help` is the remedy.
pub(super) fn above_bound(measures: &Measures, what: &str, help: &str) -> Failure {
    // With a stiff coupling the bound rounds to zero at one decimal.
    let decimals = if measures.energy_bound_j < 1e-3 { 6 } else { 1 };
    let message = format!(
        "{what} gave the hand {:.decimals$} mJ {}, above the bound of {:.decimals$} mJ: the loop of hand, fixture and arm swings",
        1e3 * measures.bounded_energy_j(),
        scope_text(measures),
        1e3 * measures.energy_bound_j
    );
    Failure::new(Exit::OutOfTolerance, message, help)
}

/// Describes which part of the hand's energy is counted.
fn scope_text(measures: &Measures) -> &'static str {
    match measures.energy_excess_j {
        Some(_) => "in one go beyond what the proxy held and moving surfaces brought",
        None => "in one go",
    }
}

/// Returns the failure of a run that a fault stopped.
pub(super) fn stopped(report: &RunReport, rig: &config::Rig) -> Failure {
    stopped_by(report.cause, report.trace.rows.last().map_or(0.0, |row| row.time_s), rig)
}

/// Returns the failure of a run in which joints were at their torque limit for long.
pub(super) fn at_limit_too_long(at_limit_s: f64, simulated_s: f64) -> Failure {
    let message = format!(
        "a joint was at its torque limit for {at_limit_s:.3} s of {simulated_s:.3} s, impacts apart: the loop \
         oscillates, or the arm is too weak for this motion"
    );
    let help = "soften control.gains, or raise guard.torque_limit_n_m as far as the drives allow";
    Failure::new(Exit::OutOfTolerance, message, help)
}

/// Returns the failure of a run whose end came while this fault held the rig at rest.
pub(super) fn ended_held(fault: Fault) -> Failure {
    let row = fault.row();
    let message =
        format!("the end came while the rig was held at rest by {}: {} ({})", row.name, row.meaning, row.cause);
    Failure::new(Exit::SafetyStop, message, row.next)
}

/// Returns the failure of a run that faults held for long, this one most of all.
pub(super) fn held_too_long(fault: Fault, held_s: f64, simulated_s: f64) -> Failure {
    let row = fault.row();
    let message = format!(
        "the rig was held at rest for {held_s:.3} s of {simulated_s:.3} s, most of all by {}: {} ({})",
        row.name, row.meaning, row.cause
    );
    Failure::new(Exit::SafetyStop, message, row.next)
}

/// Returns the failure of a run that ended before an injection of `--fault` began.
pub(super) fn never_came(injection: &Injection, simulated_s: f64) -> Failure {
    let message = format!(
        "the fault {} at {} s never came: the scene ran for {simulated_s:.3} s",
        injection.kind.row().name,
        injection.start_s
    );
    Failure::new(Exit::OutOfTolerance, message, "set an earlier time in --fault, or a longer --duration")
}

/// Returns the failure of a rig that `cause` stopped at this time of its scene; without a cause its process died.
pub(super) fn stopped_by(cause: Option<Cause>, time_s: f64, rig: &config::Rig) -> Failure {
    let (exit, message, help) = match cause {
        Some(cause) => {
            let Explanation { name, meaning, cause: why, next, .. } = explanation::fault(cause.fault);
            let at = describe(cause, &bus_names(rig));
            (exit_of(cause), format!("stopped by {name} ({at}): {meaning} ({why})"), next)
        }
        None => (
            Exit::SafetyStop,
            "left without a master: its process died, and the drives stopped by their own watchdogs".to_owned(),
            "start the program anew".into(),
        ),
    };
    Failure::new(exit, format!("after {time_s:.3} s the rig was {message}"), help)
}

/// Returns the exit code of a rig that a fault stopped or kept from running.
pub(super) fn exit_of(cause: Cause) -> Exit {
    match cause.fault {
        Fault::DriveFault => Exit::DeviceFault,
        Fault::SyncJitter | Fault::Overrun | Fault::Stalled | Fault::Suspended => Exit::TimingMissed,
        Fault::DuplicateNode => Exit::DeviceMismatch,
        _ => Exit::SafetyStop,
    }
}

/// Describes the place of a fault: the stage, and the devices if there are any.
pub(super) fn describe(cause: Cause, buses: &[String]) -> String {
    let stage = format!("{:?}", cause.fault.row().stage).to_lowercase();
    let devices = devices_text(cause.devices, buses);
    // Faults of the host have the host as their device.
    if devices.is_empty() || devices == stage { stage } else { format!("{stage}, {devices}") }
}

/// Returns the devices, interfaces by the names of their buses.
pub(super) fn devices_text(devices: DeviceSet, buses: &[String]) -> String {
    (0..).zip(buses).fold(devices.to_string(), |text, (number, bus)| {
        text.replace(&DeviceSet::interface(number).to_string(), &format!("interface of bus `{bus}`"))
    })
}

/// Returns the names of the buses, in their order.
pub(super) fn bus_names(rig: &config::Rig) -> Vec<String> {
    rig.buses.keys().cloned().collect()
}

/// Returns the failure for an error of a rig.
pub(super) fn rig_failure(error: &RigError) -> Failure {
    let (exit, help) = match error {
        RigError::Boot(error) => (boot_exit(&error.failure), boot_help(&error.failure)),
        RigError::NotEnabled { cause: Some(cause), .. } => (exit_of(*cause), cause.fault.row().next),
        RigError::NotEnabled { .. } => {
            (Exit::DeviceFault, "`yieldwall state DRIVE` shows a drive's error code (603Fh) and what it means")
        }
        RigError::NotStopped { .. } => (
            Exit::SafetyStop,
            "the simulated drives went on to make torque after Disable Voltage; please report it with the rig file",
        ),
        RigError::Arm(_) => (Exit::SafetyStop, "the scene leads the simulated arm where it cannot go"),
        _ => (
            Exit::ConfigInvalid,
            "fix what is named; `yieldwall config check RIG.yaml` also names the line of each finding",
        ),
    };
    Failure::new(exit, error.to_string(), help)
}

/// Adds advice on the node to a failure. If the node does not answer, the advice names the command that finds the cause. If the rig
/// has another sensor, the advice names the profiles of force sensors. `arguments` are those with which a command reaches the node.
pub(super) fn point_to_node(mut failure: Failure, error: &BootError, rig: &config::Rig, arguments: &str) -> Failure {
    let number = error.node_id.map(u16::from).or_else(|| position_of(&error.name, rig));
    let (Some(number), Some(finding)) = (number, failure.report.diagnostics.first_mut()) else { return failure };
    if is_other_device(&error.failure) && is_title(&error.name, &rig.sensor.name) {
        finding.help = Some(other_sensor(&rig.sensor));
        return failure;
    }
    let help = finding.help.take().map(|help| placed_text(&help, number, arguments, None));
    finding.help = match (&error.failure, error.node_id) {
        (BootFailure::Missing { .. } | BootFailure::NoAnswer { .. }, Some(node_id)) => {
            let help = help.map_or(String::new(), |help| format!("; {help}"));
            Some(format!("`yieldwall doctor node {node_id}{arguments}` finds out why{help}"))
        }
        _ => help,
    };
    failure
}

/// Returns the position of a device on EtherCAT, by the title that a failure of the boot has.
fn position_of(title: &str, rig: &config::Rig) -> Option<u16> {
    let drives = rig.drives.iter().map(|drive| (&drive.name, drive.address.position()));
    let mut devices = drives.chain([(&rig.sensor.name, rig.sensor.protocol.position())]);
    devices.find(|(name, _)| is_title(title, name))?.1
}

/// Whether a failure of the boot is of the device of this name; on EtherCAT its position stands behind the name, and drives of one device
/// are named together.
pub(super) fn is_title(title: &str, name: &str) -> bool {
    let names = title.split(" (position ").next().unwrap_or(title);
    names == name || names.split(" and ").any(|one| one == name)
}

/// Whether a device is another one than its profile says, or has other process data.
fn is_other_device(failure: &BootFailure) -> bool {
    match failure {
        BootFailure::Identity { .. } => true,
        BootFailure::Segment(failure) => matches!(**failure, SegmentFailure::Identity { fits_at: None, .. }),
        _ => false,
    }
}

/// Advice for a force sensor that its profile is not for.
fn other_sensor(sensor: &config::Sensor) -> String {
    let known = config::ProfileName::shipped().filter(|(_, profile)| profile.force_sensor().is_some());
    let known: Vec<&str> = known.map(|(name, _)| name).collect();
    let (key, first) = match sensor.protocol.position() {
        Some(_) => ("sensor.protocol.ethercat.profile", "ati-ethercat"),
        None => ("sensor.protocol.canopen.profile", "simulated-force-sensor"),
    };
    format!(
        "compare the sensor with its profile `{}`. The profiles of force sensors are {}. For another sensor copy one (`yieldwall config show \
         builtin:profiles/{first}.yaml > my-sensor.yaml`), write identity and process data by the manual of the sensor, and name the file at \
         `{key}`",
        sensor.protocol.profile().map_or("", config::ProfileName::as_str),
        known.join(", ")
    )
}

/// Returns the exit code of a failed boot.
fn boot_exit(failure: &BootFailure) -> Exit {
    let BootFailure::Segment(failure) = failure else { return Exit::DeviceMismatch };
    match **failure {
        SegmentFailure::OtherMaster { .. } | SegmentFailure::NoReply { .. } | SegmentFailure::CameBack { .. } => {
            Exit::BusUnavailable
        }
        SegmentFailure::Refused { .. } | SegmentFailure::NotReached { .. } => Exit::DeviceFault,
        _ => Exit::DeviceMismatch,
    }
}

/// Returns the advice after a failed boot.
fn boot_help(failure: &BootFailure) -> &'static str {
    match failure {
        BootFailure::Missing { .. } | BootFailure::NoSample { .. } | BootFailure::NoAnswer { .. } => {
            "check the device's supply, its cable and its bit rate, and compare the node ids with those in the rig file"
        }
        BootFailure::NotStarted { said, .. } if said.emergency.is_some() => {
            "fix what its emergency names, and try again"
        }
        BootFailure::NotStarted { said, .. } if said.sends_no_heartbeat() => {
            "the master knows the state by heartbeats alone: `yieldwall od read NODE 1017h` shows their period in ms, 0 for none, \
             and `yieldwall monitor` whether they come. If the device takes a new period only when it starts, run `yieldwall od \
             write NODE 1017h 100 --save` and switch it off and on"
        }
        BootFailure::NotStarted { .. } => {
            "`yieldwall info NODE` shows the device's error register, `yieldwall emcy NODE` its last errors"
        }
        BootFailure::Restarted { .. } => "check the node's supply, and give each device its own node id",
        BootFailure::Segment(failure) => match **failure {
            SegmentFailure::OtherMaster { .. } => {
                "stop the other master, or use an interface with a segment of its own; if a switch joins two segments, remove it"
            }
            SegmentFailure::Identity { fits_at: None, .. } => {
                "compare the device at that position with its profile in the rig file: one of them is the wrong one"
            }
            _ => "fix what the message names, and start again: nothing goes to OP by itself",
        },
        BootFailure::Keeps { .. } | BootFailure::FixedExponent { .. } | BootFailure::Synchronisation { .. } => {
            "`yieldwall od read` with the device and the object shows what it holds; then do what the message says"
        }
        BootFailure::Mode { .. } => {
            "a drive in Fault takes no other mode: `yieldwall state NODE` shows its state; once the cause has gone, `yieldwall state NODE \
             --reset-fault` takes it out of Fault. Any other drive has to have the mode by its profile"
        }
        BootFailure::ReadBack { .. } => {
            "look for another master and for a duplicate node id: somebody else has written to the node or answered for it"
        }
        BootFailure::NoRating { .. } | BootFailure::KeepsMore { .. } => {
            "`yieldwall od read` with the device and the object shows what it holds"
        }
        _ => "compare node ids and profiles in the rig file with the devices on the bus",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_bus::Said;

    fn said(error: &RigError) -> (Exit, String) {
        let Failure { exit, report } = rig_failure(error);
        (exit, report.diagnostics[0].help.clone().unwrap_or_default())
    }

    #[test]
    fn advice_comes_to_the_device_by_its_node_id_or_its_position() {
        for (rig, node_id, name, number) in [
            ("paper-admittance.yaml", Some(2), "right", 2),
            ("paper-ethercat.yaml", None, "right (position 1)", 1),
            ("paper-ethercat.yaml", None, "wrist (position 2)", 2),
        ] {
            let rig = config::load_rig(config::builtin(rig)).unwrap().value;
            let failure = BootFailure::Mode { wanted: 8, received: 0 };
            let error = BootError { node_id, name: name.to_owned(), step: "check the command mode in force", failure };
            let failure = rig_failure(&RigError::Boot(error.clone()));
            let help = point_to_node(failure, &error, &rig, " --bus eth0").report.diagnostics[0].help.clone().unwrap();
            assert!(help.contains(&format!("`yieldwall state {number} --reset-fault --bus eth0`")), "{help}");
        }
    }

    #[test]
    fn another_sensor_points_to_the_profiles_of_sensors() {
        let rig = config::load_rig(config::builtin("paper-ethercat.yaml")).unwrap().value;
        let help = |name: &str, failure: BootFailure| {
            let error = BootError { node_id: None, name: name.to_owned(), step: "check its identity", failure };
            let failure = rig_failure(&RigError::Boot(error.clone()));
            point_to_node(failure, &error, &rig, "").report.diagnostics[0].help.clone().unwrap()
        };
        let vendor = || {
            SegmentFailure::Identity { what: "the vendor", expected: "0x732".into(), found: 0xb07a, fits_at: None }
                .into()
        };
        let count = || BootFailure::Identity { index: 0x1a00, sub: 0, expected: "0x8".into(), received: 7 };
        let sensor = format!("{} (position 2)", rig.sensor.name);
        for help in [help(&sensor, vendor()), help(&sensor, count()), help(&rig.sensor.name, count())] {
            for word in [
                "ati-ethercat, ati-ethercat-28-bytes, simulated-force-sensor",
                "yieldwall config show builtin:profiles/ati-ethercat.yaml > my-sensor.yaml",
                "`sensor.protocol.ethercat.profile`",
            ] {
                assert!(help.contains(word), "{help}");
            }
        }
        assert!(!help("left (position 0)", vendor()).contains("ati-ethercat"));
    }

    #[test]
    fn a_node_that_nobody_hears_has_supply_cable_and_bit_rate_looked_at() {
        let boot = |failure| {
            let error =
                BootError { node_id: Some(1), name: "left".to_owned(), step: "wait for the boot-up message", failure };
            said(&RigError::Boot(error))
        };
        let (said, others) = (Said::default(), Box::default());
        let (exit, help) = boot(BootFailure::Missing { waited_ms: 500, is_unheard: true, said, others });
        assert_eq!(exit, Exit::DeviceMismatch);
        assert!(["supply", "cable", "bit rate", "node ids"].iter().all(|word| help.contains(word)), "{help}");
        let (exit, help) = boot(BootFailure::Restarted { times: 4 });
        assert!(exit == Exit::DeviceMismatch && help.contains("its own node id"), "{help}");
    }

    #[test]
    fn a_fault_that_keeps_a_rig_from_being_enabled_says_what_to_do() {
        let not_enabled = |cause| said(&RigError::NotEnabled { waited_s: 1.5, state: "Idle".to_owned(), cause });
        let lost = Cause { fault: Fault::SensorLost, devices: DeviceSet::SENSOR };
        assert_eq!(not_enabled(Some(lost)), (Exit::SafetyStop, Fault::SensorLost.row().next.to_owned()));
        let (exit, help) = not_enabled(None);
        assert!(exit == Exit::DeviceFault && help.contains("603Fh"), "{help}");
    }
}
