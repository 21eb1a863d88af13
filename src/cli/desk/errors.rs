//! `yieldwall errors`: the error counters of the ports of devices on EtherCAT.

use serde_json::{Value, json};

use super::place::BusArguments;
use super::segment::{Device, SegmentSession};
use super::words::{table, wrapped};
use crate::failure::Failure;
use crate::output::Output;
use yieldwall_service::{Counters, PortCounters};

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// EtherCAT position, or device name from the rig; default: all devices
    node: Option<String>,
    /// Reset the counters of the devices afterwards
    #[arg(long)]
    clear: bool,
    #[command(flatten)]
    place: BusArguments,
}

pub(crate) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let mut desk = SegmentSession::only(&arguments.place, output)?;
    let devices = desk.devices_of(arguments.node.as_deref())?;
    let mut counted = Vec::new();
    for device in devices {
        let counters = desk.service.counters(device.position);
        let counters = counters.map_err(|error| desk.failure(&device, "reading its counters", error))?;
        counted.push((device, counters));
    }
    if arguments.clear {
        for (device, _) in &counted {
            let cleared = desk.service.clear_counters(device.position);
            cleared.map_err(|error| desk.failure(device, "clearing its counters", error))?;
        }
    }
    if output.is_json() {
        let devices: Vec<Value> = counted.iter().map(|(device, counters)| document(device, counters)).collect();
        return output.report(json!({ "place": desk.place, "cleared": arguments.clear, "devices": devices }));
    }
    let cleared = if arguments.clear { "the devices count from 0 again\n" } else { "" };
    output.result(&(text(&counted) + cleared))
}

/// Whether a port has counted anything.
fn is_used(port: &PortCounters) -> bool {
    *port != PortCounters::default()
}

pub(super) fn text(counted: &[(Device, Counters)]) -> String {
    let heads = ["device", "port", "link", "damaged", "physical", "forwarded", "lost links"];
    let mut rows = vec![heads.map(str::to_owned)];
    let mut findings = Vec::new();
    for (device, counters) in counted {
        let mut name = device.words();
        for (number, port) in counters.ports.iter().enumerate().filter(|(_, port)| is_used(port)) {
            let link = if port.is_linked { "yes" } else { "no" };
            let counts = [port.invalid_frames, port.physical_errors, port.forwarded, port.lost_links];
            let [damaged, physical, forwarded, lost] = counts.map(|count| count.to_string());
            rows.push([
                std::mem::take(&mut name),
                number.to_string(),
                link.to_owned(),
                damaged,
                physical,
                forwarded,
                lost,
            ]);
        }
        findings.extend(found(device, counters));
    }
    if findings.is_empty() {
        findings.push("no errors counted".to_owned());
    }
    table(&rows) + &findings.iter().map(|finding| wrapped(finding)).collect::<String>()
}

fn times(count: u8) -> String {
    if count == 1 { "once".to_owned() } else { format!("{count} times") }
}

/// Returns the findings from a device's counters, and the advice on them.
pub(super) fn found(device: &Device, counters: &Counters) -> Vec<String> {
    let name = device.words();
    let mut findings = Vec::new();
    for (number, port) in counters.ports.iter().enumerate() {
        let own = u16::from(port.invalid_frames) + u16::from(port.physical_errors);
        if own > port.forwarded.into() {
            findings.push(format!(
                "{name}: frames come in damaged at port {number}: look at the cable and the plugs there"
            ));
        }
        if port.lost_links > 0 {
            findings.push(format!(
                "{name}: the link at port {number} was lost {}: look at the cable, the plugs and the power of the device there",
                times(port.lost_links)
            ));
        }
    }
    if counters.processing_unit > 0 {
        findings.push(format!(
            "{name}: impossible datagrams arrived {}: another device sends on this segment; disconnect it",
            times(counters.processing_unit)
        ));
    }
    if counters.process_data_interface > 0 {
        findings.push(format!(
            "{name}: its EtherCAT controller and its processor failed to exchange data {}: update its firmware, or replace it",
            times(counters.process_data_interface)
        ));
    }
    if counters.watchdog > 0 {
        findings.push(format!(
            "{name}: its watchdog ran out {}: a master fell silent, or was late",
            times(counters.watchdog)
        ));
    }
    findings
}

fn document(device: &Device, counters: &Counters) -> Value {
    let ports = counters.ports.iter().enumerate().map(|(number, port)| {
        json!({
            "port": number,
            "link": port.is_linked,
            "damaged": port.invalid_frames,
            "physical": port.physical_errors,
            "forwarded": port.forwarded,
            "lost_links": port.lost_links,
        })
    });
    json!({
        "position": device.position,
        "rig_entry": device.entry.as_ref().map(|entry| entry.name.clone()),
        "ports": ports.collect::<Vec<_>>(),
        "processing_unit": counters.processing_unit,
        "process_data_interface": counters.process_data_interface,
        "watchdog": counters.watchdog,
        "found": found(device, counters),
    })
}
