//! The devices of a rig on EtherCAT, served on an Ethernet interface.

use serde_json::json;

use super::{Arguments, milliseconds, named, names};
use crate::cli::ending::rig_failure;
use crate::cli::failure::{Exit, Failure};
use crate::cli::interfaces::Interfaces;
use crate::cli::interrupt::on_interrupt;
use crate::cli::on_bus::only_for_can;
use crate::cli::output::Output;
use crate::config;
use crate::host::system::run_first;
use crate::injection::{Injection, Medium};
use crate::link::{EthernetLink, PacketSocket, Role};
use crate::live::{ServeError, serve_segment};
use crate::rig::SegmentServer;

pub(super) fn run(
    arguments: &Arguments,
    rig: &config::Rig,
    scene: &config::Scene,
    seed: u64,
    output: &mut Output,
) -> Result<(), Failure> {
    let faults: Vec<Injection> = arguments.fault.iter().map(|fault| fault.of_rig(rig)).collect::<Result<_, _>>()?;
    if rig.is_on_can() {
        let message =
            "sim serves devices on one kind of bus, and this rig has its drives on EtherCAT and its sensor on CAN";
        let help = "`yieldwall run` without --bus runs it on the embedded simulation";
        return Err(Failure::new(Exit::Usage, message, help));
    }
    refuse(arguments, &faults)?;
    let here = named(arguments, rig)?;
    let interfaces = Interfaces::of(rig, &arguments.bus)?;
    let interface = interfaces.names().concat();
    let is_interrupted = on_interrupt()?;
    let link = PacketSocket::open(&interface, Role::Segment);
    let mut link = link.map_err(|error| Failure::new(Exit::BusUnavailable, error.to_string(), ""))?;
    let server = SegmentServer::new(rig, scene, seed, arguments.pace.pace(), here, link.now());
    let mut server = server.map_err(|error| rig_failure(&error))?;
    server.set_sdo_time(milliseconds(arguments.sdo_ms));
    for fault in faults {
        server.inject(fault).map_err(|error| no_fault(&error))?;
    }
    let names = names(rig, here).join(", ");
    output.news(&format!("simulated {names} on {interface}, {}; Ctrl-C ends it", arguments.pace.name()))?;
    if !link.has_carrier() {
        output.news("cable     no link yet: nothing is heard until the other end is up")?;
    }
    // Devices do not wait for a processor; where the system refuses, they are as late as it is.
    let _ = run_first();
    let served = serve_segment(&mut server, &mut link, &is_interrupted);
    let (counts, time_s) = (server.counts(), server.now().as_secs_f64());
    let end = served.map_err(|error| match &error {
        ServeError::Rig(error) => rig_failure(error),
        ServeError::Gone => Failure::new(Exit::BusUnavailable, error.to_string(), "plug the adapter in again"),
    });
    if output.is_json() {
        let drives = server.drive_states().into_iter().zip(server.torques_n_m());
        let drives: Vec<_> = drives
            .map(|(state, torque)| state.map(|state| json!({ "state": format!("{state:?}"), "torque_n_m": torque })))
            .collect();
        let document =
            json!({ "time_s": time_s, "frames": counts.frames, "returned": counts.returned, "drives": drives });
        return output.end(document, end);
    }
    let (frames, returned) = (counts.frames, counts.returned);
    output.news(&format!("served    {frames} frames, {returned} went back, {time_s:.3} s simulated"))?;
    end
}

/// What is for devices on CAN.
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

/// The failure that a fault is which cannot be brought about.
fn no_fault(error: &dyn std::error::Error) -> Failure {
    Failure::new(Exit::Usage, format!("--fault {error}"), "`yieldwall faults NAME` says where it acts")
}
