//! The simulated devices of a rig on EtherCAT on an Ethernet interface, with its sensor on a CAN interface if the sensor is on CAN.

use serde_json::json;

use super::{Arguments, Own, milliseconds, named, names};
use crate::ending::rig_failure;
use crate::failure::{Exit, Failure};
use crate::interfaces::Interfaces;
use crate::interrupt::on_interrupt;
use crate::on_bus::{only_for_can, open_failure};
use crate::output::Output;
use crate::page::{Page, PageOf};
use yieldwall_config as config;
use yieldwall_config::injection::{Injection, Medium};
use yieldwall_fieldbus::canopen::BusId;
use yieldwall_link::{CanLink, CobFilter, Role};
use yieldwall_rig::SegmentServer;
use yieldwall_rig::live::{ServeError, serve_segment};
use yieldwall_run::host::open_buses;
use yieldwall_run::host::system::run_first;

pub(super) fn run(
    arguments: &Arguments,
    rig: &config::Rig,
    scene: &config::Scene,
    seed: u64,
    output: &mut Output,
) -> Result<(), Failure> {
    let faults: Vec<Injection> = arguments.fault.iter().map(|fault| fault.of_rig(rig)).collect::<Result<_, _>>()?;
    refuse(arguments, &faults)?;
    let here = named(arguments, rig)?;
    let interfaces = Interfaces::of(rig, &arguments.bus)?;
    let is_interrupted = on_interrupt()?;
    let own = rig.is_on_can().then(|| Own::new(rig, here)).transpose()?;
    let roles = |bus: BusId| match (&own, rig.buses.values().nth(bus.index()).and_then(config::Bus::canopen)) {
        (Some(own), Some(_)) => own.roles(bus),
        _ => vec![Role::Segment],
    };
    let everything = |_| (vec![CobFilter::EVERYTHING], Vec::new());
    let link = open_buses(rig, interfaces.names(), roles, everything);
    let mut link = link.map_err(|error| open_failure(&error))?;
    if let Some(own) = &own {
        own.listen(link.can_mut(), &is_interrupted, |frame| *frame)?;
    }
    let server = SegmentServer::new(rig, scene, seed, arguments.pace.pace(), here, link.now());
    let mut server = server.map_err(|error| rig_failure(&error))?;
    server.set_sdo_time(milliseconds(arguments.sdo_ms));
    if arguments.no_hand {
        server.take_hand_away();
    }
    for fault in faults {
        server.inject(fault).map_err(|error| no_fault(&error))?;
    }
    // Its threads have no real-time priority.
    let mut page = Page::default();
    page.open(&arguments.page, rig, PageOf { command: "sim", pace: arguments.pace.into() })?;
    let names = names(rig, here).join(", ");
    output.news(&format!(
        "simulated {names} on {}, {}; Ctrl-C ends it",
        interfaces.shown(rig),
        arguments.pace.name()
    ))?;
    if link.segment().is_some_and(|segment| !segment.has_carrier()) {
        output.news("cable     no link yet: nothing is heard until the other end is up")?;
    }
    // Devices do not wait for a processor; where the system refuses, they are as late as it is.
    let _ = run_first();
    let mut show = page.show_devices(rig);
    let served =
        serve_segment(&mut server, &mut link, &is_interrupted, |server| show(server.now(), &mut || server.record()));
    drop(show);
    let (counts, time_s) = (server.counts(), server.now().as_secs_f64());
    let end = served.map_err(|error| match &error {
        ServeError::Rig(error) => rig_failure(error),
        ServeError::Gone => Failure::new(Exit::BusUnavailable, error.to_string(), "plug the adapter in again"),
    });
    page.end(&end);
    if output.is_json() {
        let drives = server.drive_states().into_iter().zip(server.torques_n_m());
        let drives: Vec<_> = drives
            .map(|(state, torque)| state.map(|state| json!({ "state": format!("{state:?}"), "torque_n_m": torque })))
            .collect();
        let mut document =
            json!({ "time_s": time_s, "frames": counts.frames, "returned": counts.returned, "drives": drives });
        if rig.is_on_can() {
            document["syncs"] = counts.syncs.into();
            document["sent"] = counts.sent.into();
        }
        return output.end(document, end);
    }
    let (frames, returned) = (counts.frames, counts.returned);
    let on_can = if rig.is_on_can() {
        format!("; {} SYNC, {} frames sent on CAN", counts.syncs, counts.sent)
    } else {
        String::new()
    };
    output.news(&format!("served    {frames} frames, {returned} went back{on_can}; {time_s:.3} s simulated"))?;
    end
}

/// Refuses arguments for devices on CAN.
fn refuse(arguments: &Arguments, faults: &[Injection]) -> Result<(), Failure> {
    only_for_can(&[
        (
            "--plant",
            arguments.plant.is_some(),
            "a segment is one line of devices in one process; --nodes leaves some out",
        ),
        (
            "--attach",
            arguments.attach.is_some(),
            "a segment is one line of devices in one process; --nodes leaves some out",
        ),
        (
            "--unwatched",
            !arguments.unwatched.is_empty(),
            "on EtherCAT the watchdog is in the controllers, and the master sets it",
        ),
        ("--reset-ms", arguments.reset_ms.is_some(), "devices on EtherCAT send no boot-up message"),
    ])?;
    faults.iter().try_for_each(|fault| fault.check_on(Medium::Ethercat).map_err(|error| no_fault(&error)))
}

/// Returns the failure for a fault that cannot be injected.
fn no_fault(error: &dyn std::error::Error) -> Failure {
    Failure::new(Exit::Usage, format!("--fault {error}"), "`yieldwall faults NAME` says where it acts")
}
