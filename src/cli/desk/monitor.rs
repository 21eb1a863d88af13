//! `yieldwall monitor`: the frames on a bus, one by one, in words. The command sends nothing.

use std::time::Duration;

use serde_json::{Value, json};

use super::place::{BusArguments, DeviceSession, Entry};
use super::words::{nmt_words, spaced};
use crate::failure::{Exit, Failure};
use crate::output::Output;
use yieldwall_fieldbus::canopen::{Emergency, Frame, NmtState, cob, nmt};
use yieldwall_fieldbus::objects::{AbortCode, Address, sign_extend};
use yieldwall_link::{Arrival, OtherTraffic, Received};
use yieldwall_run::explanation;

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Seconds to listen; Ctrl-C ends earlier
    #[arg(long = "for", value_name = "S", default_value_t = 3.0, value_parser = crate::usage::seconds)]
    seconds: f64,
    /// Hide SYNC and process data
    #[arg(long)]
    services: bool,
    #[command(flatten)]
    place: BusArguments,
}

/// Most frames of one JSON document.
const MOST: usize = 200_000;

pub(crate) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    if !(arguments.seconds > 0.0 && arguments.seconds <= 1e6) {
        let message = format!("--for is {}: it lasts more than 0 and at most 1 000 000 seconds", arguments.seconds);
        return Err(Failure::new(Exit::Usage, message, "give a number of seconds, such as --for 10"));
    }
    let mut desk = DeviceSession::only_listening(&arguments.place, output)?;
    let begun = desk.service.now();
    let entries = desk.entries.clone();
    let several = desk.buses.len() > 1;
    let (mut count, mut documents, mut failed) = (0_u64, Vec::new(), Ok(()));
    let mut others = OtherTraffic::default();
    let each = |arrival: &Arrival| {
        let what = words(arrival, &entries);
        let is_left_out =
            arguments.services && matches!(&arrival.what, Received::Frame(frame) if is_process_data(frame));
        if is_left_out || failed.is_err() {
            return;
        }
        count += 1;
        if let Received::Other(frame) = &arrival.what {
            others.count(frame);
        }
        let time_s = arrival.time.since(begun).as_secs_f64();
        if output.is_json() {
            if documents.len() < MOST {
                documents.push(document(time_s, arrival, &what));
            }
            return;
        }
        let bus = if several { format!("{} ", arrival.bus) } else { String::new() };
        let id = match &arrival.what {
            Received::Frame(frame) | Received::Echo(frame) => format!("{:03X}h", frame.id()),
            Received::Other(frame) => {
                format!("{:0digits$X}h", frame.id, digits = if frame.is_extended { 8 } else { 3 })
            }
            _ => "-".to_owned(),
        };
        failed = output.result(&format!("{time_s:11.6}  {bus}{id:4}  {what}\n"));
    };
    let listened = desk.service.listen(Duration::from_secs_f64(arguments.seconds), each);
    failed?;
    // An interruption by the person is no failure.
    if let Err(error) = listened
        && error != yieldwall_service::Error::Interrupted
    {
        return Err(desk.bus_failure(error));
    }
    if output.is_json() {
        return output.report(json!({
            "place": desk.place,
            "count": count,
            "extended_frames": others.extended,
            "fd_frames": others.fd,
            "frames": documents,
        }));
    }
    output.news(&match others.is_none() {
        true => format!("{count} frames"),
        false => format!("{count} frames, {others} among them: something else than CANopen uses this bus"),
    })
}

/// Whether a frame is SYNC, TIME or a PDO.
fn is_process_data(frame: &Frame) -> bool {
    let id = frame.id();
    id == cob::SYNC || id == cob::TIME || (0x180..0x580).contains(&id)
}

fn words(arrival: &Arrival, entries: &[Entry]) -> String {
    match &arrival.what {
        Received::Frame(frame) | Received::Echo(frame) => of_frame(frame, entries),
        Received::Other(frame) => frame.to_string(),
        Received::Error(error) => format!("the controller reports: {error:?}"),
        Received::Overflow { frames } => format!("{frames} frames were lost here"),
        Received::Down => "the interface went down".to_owned(),
        Received::Gone => "the interface is gone".to_owned(),
    }
}

fn of_frame(frame: &Frame, entries: &[Entry]) -> String {
    let id = frame.id();
    let own = |entry: &&Entry| u16::from(entry.node.raw()) == id & 0x7f && entry.bus == frame.bus();
    // Drives that are axes of one node differ by the identifiers of their process data.
    let is_mapped = |entry: &&Entry| own(entry) && has_pdo(entry, id);
    let entry = entries.iter().find(is_mapped).or_else(|| entries.iter().find(own));
    let who = match entry {
        Some(entry) => format!("{} ({})", entry.node.raw(), entry.name),
        None => format!("{}", id & 0x7f),
    };
    let bytes = || frame.data().iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(" ");
    if frame.is_remote() {
        let asks = if cob::is_heartbeat(id) {
            format!("node {who} is asked for its state")
        } else {
            "remote frame".to_owned()
        };
        return asks;
    }
    match id {
        cob::NMT => match nmt::decode_command(frame) {
            Some((command, node)) => {
                let node = node.map_or("all nodes".to_owned(), |node| format!("node {}", node.raw()));
                format!("NMT: {} to {node}", spaced(&format!("{command:?}")))
            }
            None => format!("NMT, of no command: {}", bytes()),
        },
        cob::SYNC => "SYNC".to_owned(),
        cob::TIME => "TIME".to_owned(),
        cob::LSS_REQUEST => format!("LSS request: {}", bytes()),
        cob::LSS_ANSWER => format!("LSS answer: {}", bytes()),
        0x081..=0x0ff => match Emergency::decode(frame) {
            Some(emergency) => {
                let code = emergency.code.0;
                let explained = explanation::error_code(code, entry.and_then(|entry| entry.codes.as_deref()));
                format!("EMCY of {who}: {code:04X}h {}, register {:02X}h", explained.meaning, emergency.register.0)
            }
            None => format!("EMCY of {who}, of another length: {}", bytes()),
        },
        0x581..=0x5ff | 0x601..=0x67f => sdo(frame, &who, id >= 0x600),
        0x701..=0x77f => match nmt::decode_heartbeat(frame) {
            Some((_, NmtState::Initialising)) => format!("boot-up of {who}"),
            Some((_, state)) => format!("heartbeat of {who}: {}", nmt_words(state)),
            None => format!("error control of {who}: {}", bytes()),
        },
        0x180..=0x57f => process_data(frame, entry, &who),
        _ => bytes(),
    }
}

/// Whether process data of a device have an identifier.
fn has_pdo(entry: &Entry, id: u16) -> bool {
    let Some([rpdo, tpdo]) = entry.profile.as_ref().and_then(|profile| profile.mapped(entry.mode)) else {
        return false;
    };
    let received = rpdo.iter().filter_map(|pdo| cob::rpdo(pdo.identifier, entry.node));
    received.chain(tpdo.iter().filter_map(|pdo| cob::tpdo(pdo.identifier, entry.node))).any(|own| own == id)
}

/// Describes a PDO by its default identifier: its bytes, or its mapped values if the rig knows the mapping.
fn process_data(frame: &Frame, entry: Option<&Entry>, who: &str) -> String {
    let (number, is_tpdo) = ((frame.id() - 0x180) / 0x100 + 1, (frame.id() - 0x180) % 0x100 < 0x80);
    let direction = if is_tpdo { "TPDO" } else { "RPDO" };
    let bytes = frame.data().iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(" ");
    let fields = entry.and_then(|entry| fields(frame, entry, number as u8, is_tpdo));
    format!("{direction} {number} of {who}: {}", fields.unwrap_or(bytes))
}

/// Returns the values of a PDO by its profile, in the mode of the rig.
fn fields(frame: &Frame, entry: &Entry, number: u8, is_tpdo: bool) -> Option<String> {
    let profile = entry.profile.as_deref()?;
    let [rpdo, tpdo] = profile.mapped(entry.mode)?;
    let pdos = if is_tpdo { tpdo } else { rpdo };
    let pdo = pdos.iter().find(|pdo| pdo.identifier == number)?;
    if pdo.bytes() != frame.data().len() {
        return None;
    }
    let mut at = 0;
    let each = pdo.objects.iter().filter_map(|object| {
        let (bits, word) = (u32::from(object.bits), frame.bits().checked_shr(at).unwrap_or_default());
        at += bits;
        let quantity = object.quantity?;
        let masked = word & u64::MAX.checked_shr(64 - bits).unwrap_or_default();
        let is_word = quantity.word().ends_with("word") || quantity.word() == "status";
        let shown = match (is_word, bits) {
            (true, bits) => format!("{masked:0digits$X}h", digits = bits as usize / 4),
            (_, 8) => masked.to_string(),
            (_, 16) => (masked as i16).to_string(),
            _ => sign_extend(masked, object.bits).to_string(),
        };
        Some(format!("{} {shown}", quantity.word()))
    });
    let each: Vec<String> = each.collect();
    Some(each.join(", "))
}

fn sdo(frame: &Frame, who: &str, is_request: bool) -> String {
    let [command, low, high, sub, first, second, third, fourth] = *frame.bytes();
    let at = Address::new(u16::from_le_bytes([low, high]), sub);
    let data = [first, second, third, fourth];
    let value = || {
        let len = if command & 1 != 0 { 4 - usize::from(command >> 2 & 3) } else { 4 };
        data.iter().take(len).map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(" ")
    };
    if frame.data().len() != 8 {
        return format!("SDO of {who}, of another length");
    }
    match (command >> 5, is_request) {
        (4, _) => {
            let code = AbortCode(u32::from_le_bytes(data));
            format!("SDO {who}: {at} {} {code}", if is_request { "broken off:" } else { "refused:" })
        }
        (2, true) => format!("SDO {who}: read {at}"),
        (2, false) if command & 2 != 0 => format!("SDO {who}: {at} is {}", value()),
        (1, true) if command & 2 != 0 => format!("SDO {who}: write {at} {}", value()),
        (3, false) => format!("SDO {who}: {at} written"),
        (1, true) | (2, false) => format!("SDO {who}: {at} in segments, {} bytes", u32::from_le_bytes(data)),
        _ => format!("SDO {who}: segment"),
    }
}

fn document(time_s: f64, arrival: &Arrival, what: &str) -> Value {
    let (frame, other) = match &arrival.what {
        Received::Frame(frame) | Received::Echo(frame) => (Some(frame), None),
        Received::Other(other) => (None, Some(other.id)),
        _ => (None, None),
    };
    json!({
        "time_s": time_s,
        "bus": arrival.bus.index(),
        "identifier": frame.map(|frame| frame.id().into()).or(other),
        "data": frame.map(|frame| frame.data().iter().map(|byte| format!("{byte:02x}")).collect::<String>()),
        "what": what,
    })
}

#[cfg(test)]
mod tests {
    use super::super::place::{BusArguments, DeviceSession};
    use super::*;

    #[test]
    fn frames_are_told_in_words() {
        let entries =
            DeviceSession::open(&BusArguments::default(), &mut Output::new(true, false, false)).unwrap().entries;
        for (id, data, words) in [
            (0x000, &[0x80, 1][..], "NMT: Enter Pre Operational to node 1"),
            (0x080, &[], "SYNC"),
            (
                0x081,
                &[0x30, 0x81, 0x11, 0, 0, 0, 0, 0],
                "EMCY of 1 (left): 8130h heartbeat or life guarding lost, register 11h",
            ),
            (0x181, &[0x37, 0x12, 1, 0, 0, 0], "TPDO 1 of 1 (left): statusword 1237h, position_actual 1"),
            (0x201, &[0x0f, 0, 0xff, 0xff], "RPDO 1 of 1 (left): controlword 000Fh, target_torque -1"),
            (0x201, &[0x0f, 0], "RPDO 1 of 1 (left): 0F 00"),
            (0x301, &[1], "RPDO 2 of 1 (left): 01"),
            (0x601, &[0x40, 0x41, 0x60, 0, 0, 0, 0, 0], "SDO 1 (left): read 6041h:0"),
            (0x581, &[0x4b, 0x41, 0x60, 0, 0x50, 2, 0, 0], "SDO 1 (left): 6041h:0 is 50 02"),
            (0x605, &[0x2b, 0x40, 0x60, 0, 6, 0, 0, 0], "SDO 5: write 6040h:0 06 00"),
            (0x585, &[0x60, 0x40, 0x60, 0, 0, 0, 0, 0], "SDO 5: 6040h:0 written"),
            (0x70a, &[0], "boot-up of 10 (wrist)"),
            (0x70a, &[5], "heartbeat of 10 (wrist): Operational"),
            (0x70a, &[1, 2, 3], "error control of 10 (wrist): 01 02 03"),
            (0x7ff, &[1], "01"),
        ] {
            assert_eq!(of_frame(&Frame::new(id, data), &entries), words);
        }
    }
}
