//! `yieldwall pdo show`: the process data that a device exchanges every cycle.

use serde_json::{Value, json};

use super::place::{BusArguments, DeviceSession, Node};
use super::segment::{self, SegmentSession};
use super::words::mapped;
use crate::failure::Failure;
use crate::output::Output;
use yieldwall_fieldbus::objects::Address;
use yieldwall_service::{Error, number};

#[derive(Debug, clap::Subcommand)]
pub(crate) enum Command {
    /// Show a device's PDOs: identifier or sync manager, timing and mapping
    Show(Arguments),
}

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Node id, EtherCAT position, or device name from the rig
    node: String,
    #[command(flatten)]
    place: BusArguments,
}

/// Largest number of PDOs in each direction; the search ends at the first missing one.
const MOST: u16 = 64;

struct Pdo {
    name: String,
    cob_id: u32,
    transmission_type: u8,
    event_timer_ms: Option<u32>,
    inhibit_100_us: Option<u32>,
    maps: Vec<u32>,
}

pub(crate) fn run(command: &Command, output: &mut Output) -> Result<(), Failure> {
    let Command::Show(arguments) = command;
    if let Some(desk) = SegmentSession::open(&arguments.place, output)? {
        return segment::pdo::run(&arguments.node, desk, output);
    }
    let mut desk = DeviceSession::open(&arguments.place, output)?;
    let node = desk.node(&arguments.node)?;
    let mut pdos = Vec::new();
    for (direction, base) in [("RPDO", 0x1400), ("TPDO", 0x1800)] {
        for number in 0..MOST {
            let Some(pdo) = pdo(&mut desk, &node, direction, base + number)? else { break };
            pdos.push(pdo);
        }
    }
    if output.is_json() {
        let pdos: Vec<Value> = pdos.iter().map(document).collect();
        return output.report(json!({ "place": desk.place, "node_id": node.id.raw(), "pdos": pdos }));
    }
    let mut text = format!("{}\n", node.words());
    for pdo in &pdos {
        text.push_str(&format!("{}\n", line(pdo)));
        pdo.maps.iter().for_each(|entry| text.push_str(&format!("    {}\n", mapped(*entry))));
    }
    if pdos.is_empty() {
        text.push_str("it has no PDOs\n");
    }
    output.result(&text)
}

fn pdo(desk: &mut DeviceSession, node: &Node, direction: &str, index: u16) -> Result<Option<Pdo>, Failure> {
    let mut read = |index, sub| match desk.service.read(node.id, Address::new(index, sub)) {
        Ok(bytes) => Ok(Some(number(&bytes))),
        Err(Error::Refused(_)) => Ok(None),
        Err(error) => Err(desk.failure(node, "reading its PDOs", error)),
    };
    let Some(cob_id) = read(index, 1)? else { return Ok(None) };
    let mut pdo = Pdo {
        name: format!("{direction} {}", (index & 0x1ff) + 1),
        cob_id,
        transmission_type: read(index, 2)?.unwrap_or_default() as u8,
        inhibit_100_us: read(index, 3)?,
        event_timer_ms: read(index, 5)?,
        maps: Vec::new(),
    };
    let count = read(index + 0x200, 0)?.unwrap_or_default();
    for sub in 1..=count.min(64) as u8 {
        pdo.maps.extend(read(index + 0x200, sub)?);
    }
    Ok(Some(pdo))
}

/// Describes when a PDO is sent or takes effect.
fn when(transmission_type: u8) -> String {
    match transmission_type {
        0 => "at SYNC after a change".to_owned(),
        1 => "every SYNC".to_owned(),
        number @ 2..=240 => {
            let ending = match (number % 100, number % 10) {
                (11..=13, _) => "th",
                (_, 1) => "st",
                (_, 2) => "nd",
                (_, 3) => "rd",
                _ => "th",
            };
            format!("every {number}{ending} SYNC")
        }
        252 | 253 => "on request".to_owned(),
        number @ (254 | 255) => format!("event-driven (type {number})"),
        other => format!("type {other}, reserved"),
    }
}

fn line(pdo: &Pdo) -> String {
    if pdo.cob_id >> 31 != 0 {
        return format!("{}  not used", pdo.name);
    }
    let timer =
        |value: Option<u32>, unit: &str| value.filter(|value| *value > 0).map(|value| format!(", {unit} {value}"));
    format!(
        "{}  {:03X}h, {}{}{}",
        pdo.name,
        pdo.cob_id & 0x7ff,
        when(pdo.transmission_type),
        timer(pdo.event_timer_ms, "event timer ms").unwrap_or_default(),
        timer(pdo.inhibit_100_us, "inhibit time 100 us").unwrap_or_default()
    )
}

fn document(pdo: &Pdo) -> Value {
    json!({
        "pdo": pdo.name,
        "used": pdo.cob_id >> 31 == 0,
        "identifier": pdo.cob_id & 0x7ff,
        "transmission_type": pdo.transmission_type,
        "event_timer_ms": pdo.event_timer_ms,
        "inhibit_100_us": pdo.inhibit_100_us,
        "maps": pdo.maps.iter().map(|entry| mapped(*entry)).collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_transmission_type_is_described() {
        for (number, text) in [
            (1, "every SYNC"),
            (3, "every 3rd SYNC"),
            (12, "every 12th SYNC"),
            (22, "every 22nd SYNC"),
            (255, "event-driven (type 255)"),
        ] {
            assert_eq!(when(number), text);
        }
    }
}
