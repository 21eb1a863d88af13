//! `yieldwall dc`: the distributed clocks of a segment.

use serde_json::{Value, json};

use super::place::BusArguments;
use super::segment::{Device, SegmentSession};
use super::words::{table, wrapped};
use crate::failure::Failure;
use crate::output::Output;
use yieldwall_service::ClockFacts;

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// EtherCAT position, or device name from the rig; default: all devices
    node: Option<String>,
    #[command(flatten)]
    place: BusArguments,
}

/// A device, and its clock if it has one.
pub(super) type Clock = (Device, Option<ClockFacts>);

pub(crate) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let mut desk = SegmentSession::only(&arguments.place, output)?;
    let clocks = read(&mut desk, arguments.node.as_deref())?;
    if output.is_json() {
        let devices: Vec<Value> = clocks.iter().map(document).collect();
        return output.report(json!({ "place": desk.place, "devices": devices }));
    }
    output.result(&text(&clocks))
}

pub(super) fn read(desk: &mut SegmentSession, word: Option<&str>) -> Result<Vec<Clock>, Failure> {
    let mut clocks = Vec::new();
    for device in desk.devices_of(word)? {
        let clock = desk.service.clock(device.position);
        let clock = clock.map_err(|error| desk.failure(&device, "reading its clock", error))?;
        clocks.push((device, clock));
    }
    Ok(clocks)
}

pub(super) fn text(clocks: &[Clock]) -> String {
    let mut rows = vec![["device", "bits", "delay ns", "apart ns", "SYNC0"].map(str::to_owned)];
    for (device, clock) in clocks {
        let Some(clock) = clock else {
            rows.push([device.words(), "no clock".to_owned(), String::new(), String::new(), String::new()]);
            continue;
        };
        let sync0 = clock.sync0.map_or_else(|| "off".to_owned(), |(cycle, _)| format!("every {} us", us(cycle)));
        rows.push([
            device.words(),
            if clock.is_64 { "64" } else { "32" }.to_owned(),
            clock.delay_ns.to_string(),
            clock.difference_ns.to_string(),
            sync0,
        ]);
    }
    let first = clocks.iter().find(|(_, clock)| clock.is_some());
    let reference = first.map_or_else(String::new, |(device, _)| {
        wrapped(&format!("reference clock: {}; apart: offset of each clock from it", device.words()))
    });
    table(&rows) + &reference
}

fn us(ns: u32) -> f64 {
    f64::from(ns) * 1e-3
}

fn document((device, clock): &Clock) -> Value {
    json!({
        "position": device.position,
        "rig_entry": device.entry.as_ref().map(|entry| entry.name.clone()),
        "clock": clock.map(|clock| json!({
            "bits": if clock.is_64 { 64 } else { 32 },
            "time_ns": clock.time_ns,
            "offset_ns": clock.offset_ns,
            "delay_ns": clock.delay_ns,
            "difference_ns": clock.difference_ns,
            "sync0_cycle_ns": clock.sync0.map(|(cycle, _)| cycle),
            "sync0_next_ns": clock.sync0.map(|(_, next)| next),
        })),
    })
}
