//! `yieldwall pdo show` on EtherCAT: the process data that a device's sync managers exchange every cycle.

use serde_json::{Value, json};

use super::super::reached::DeviceHandle;
use super::super::words::mapped;
use super::SegmentSession;
use crate::failure::Failure;
use crate::output::Output;
use yieldwall_fieldbus::objects::Address;

/// Process data of one direction.
pub(super) struct Exchange {
    pub(super) direction: &'static str,
    sync_manager: u8,
    /// By sub-index 1 of its synchronisation, such as 1C32h:1.
    sync_type: Option<u32>,
    /// Assigned mappings, with the content of each.
    pdos: Vec<(u16, Vec<u32>)>,
}

/// Reads an object as a number; `None` if the device has none.
type Numbers<'a> = dyn FnMut(Address) -> Result<Option<u32>, Failure> + 'a;

#[cfg(feature = "ethercrab")]
impl Exchange {
    /// Bytes that they have.
    pub(super) fn bytes(&self) -> u32 {
        let entries = self.pdos.iter().flat_map(|(_, entries)| entries);
        // The lowest byte of a mapping entry is the length in bits.
        entries.map(|entry| entry & 0xff).sum::<u32>().div_ceil(8)
    }
}

/// The type of each sync manager: 3 for outputs, 4 for inputs.
const SYNC_MANAGER_TYPES: u16 = 0x1c00;
/// First objects of the sync managers' assignments, and of their synchronisation.
const ASSIGNMENT: u16 = 0x1c10;
const SYNCHRONISATION: u16 = 0x1c30;
/// Sync managers of process data in a device that does not describe their use.
const USUAL: [(&str, u8); 2] = [("outputs", 2), ("inputs", 3)];
/// Sync managers that a controller has at most.
const MOST_MANAGERS: u32 = 16;
const DOING: &str = "reading its process data";

pub(in crate::desk) fn run(word: &str, desk: SegmentSession, output: &mut Output) -> Result<(), Failure> {
    let mut reached = DeviceHandle::on_segment(desk, word, output)?;
    let exchanged = read(&mut |at| reached.number_of(at, DOING))?;
    if output.is_json() {
        let exchanged: Vec<Value> = exchanged.iter().map(document).collect();
        return output.report(reached.document(json!({ "process_data": exchanged })));
    }
    output.result(&text(&reached.words(), &exchanged))
}

#[cfg(test)]
pub(super) fn shown(reached: &mut DeviceHandle) -> Result<String, Failure> {
    let exchanged = read(&mut |at| reached.number_of(at, DOING))?;
    Ok(text(&reached.words(), &exchanged))
}

/// Returns the sync managers that exchange process data, and their content.
fn managers(number_of: &mut Numbers<'_>) -> Result<Vec<(&'static str, u8)>, Failure> {
    let mut of = |sub| number_of(Address::new(SYNC_MANAGER_TYPES, sub));
    let count = of(0)?.unwrap_or_default().min(MOST_MANAGERS) as u8;
    let mut managers = Vec::new();
    for number in 0..count {
        let direction = match of(number + 1)? {
            Some(3) => Some("outputs"),
            Some(4) => Some("inputs"),
            _ => None,
        };
        managers.extend(direction.map(|direction| (direction, number)));
    }
    Ok(if managers.is_empty() { USUAL.to_vec() } else { managers })
}

/// Process data of the sync managers of a device.
pub(super) fn read(number_of: &mut Numbers<'_>) -> Result<Vec<Exchange>, Failure> {
    let mut exchanged = Vec::new();
    for (direction, sync_manager) in managers(number_of)? {
        let (assignment, synchronisation) =
            (ASSIGNMENT + u16::from(sync_manager), SYNCHRONISATION + u16::from(sync_manager));
        let mut of = |index, sub| number_of(Address::new(index, sub));
        let count = of(assignment, 0)?.unwrap_or_default();
        let sync_type = of(synchronisation, 1)?;
        let mut pdos = Vec::new();
        for number in 1..=count as u8 {
            let Some(index) = of(assignment, number)?.map(|index| index as u16).filter(|index| *index != 0) else {
                continue;
            };
            let mut entries = Vec::new();
            for sub in 1..=of(index, 0)?.unwrap_or_default() as u8 {
                entries.extend(of(index, sub)?);
            }
            pdos.push((index, entries));
        }
        exchanged.push(Exchange { direction, sync_manager, sync_type, pdos });
    }
    Ok(exchanged)
}

/// Describes a synchronisation type.
fn when(sync_type: u32) -> String {
    match sync_type {
        0 => "free run".to_owned(),
        1 => "with its sync manager".to_owned(),
        2 => "at SYNC0".to_owned(),
        3 => "at SYNC1".to_owned(),
        0x22 => "with the outputs".to_owned(),
        other => format!("type {other:02X}h"),
    }
}

fn text(words: &str, exchanged: &[Exchange]) -> String {
    let mut text = format!("{words}\n");
    for exchange in exchanged {
        let when = exchange.sync_type.map_or(String::new(), |kind| format!(", {}", when(kind)));
        let none = if exchange.pdos.is_empty() { ", none assigned" } else { "" };
        text.push_str(&format!("{}  sync manager {}{when}{none}\n", exchange.direction, exchange.sync_manager));
        for (index, entries) in &exchange.pdos {
            text.push_str(&format!("    {index:04X}h\n"));
            entries.iter().for_each(|entry| text.push_str(&format!("        {}\n", mapped(*entry))));
        }
    }
    text
}

fn document(exchange: &Exchange) -> Value {
    let pdos = exchange.pdos.iter().map(|(index, entries)| {
        json!({ "index": index, "maps": entries.iter().map(|entry| mapped(*entry)).collect::<Vec<_>>() })
    });
    json!({
        "direction": exchange.direction,
        "sync_manager": exchange.sync_manager,
        "sync_type": exchange.sync_type,
        "pdos": pdos.collect::<Vec<_>>(),
    })
}
