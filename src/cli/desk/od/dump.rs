//! `yieldwall od dump`: all objects of a device, as a device configuration file.

use std::path::PathBuf;

use serde_json::{Value, json};
use yieldwall_drives::eds::{DeviceInfo, Eds, Node as Of, concise};

use super::super::place::{BusArguments, DeviceSession, Node};
use super::super::reached::DeviceHandle;
use super::super::segment::scan::name;
use super::super::segment::{Device, SegmentSession};
use super::super::words;
use super::sheet_of;
use crate::failure::{Exit, Failure};
use crate::output::Output;
use crate::progress::Progress;
use crate::replace::Replace;
use yieldwall_fieldbus::objects::Address;
use yieldwall_rig::report::Stage;
use yieldwall_service::{Unread, UnreadObject, downloads, inventory, inventory_of, values_of};

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Node id, EtherCAT position, or device name from the rig
    node: String,
    /// Output file; default: standard output
    #[arg(long, value_name = "FILE.dcf")]
    out: Option<PathBuf>,
    /// Data sheet (EDS or DCF): read its objects by their types
    ///
    /// Without one, the command tries every index, which takes a minute.
    #[arg(long, value_name = "FILE.eds")]
    eds: Option<PathBuf>,
    /// Write a concise DCF: only the parameters, in write order
    ///
    /// A CANopen manager keeps this format in 1F22h. Vendor objects need --eds.
    #[arg(long, requires = "out")]
    concise: bool,
    #[command(flatten)]
    replace: Replace,
    #[command(flatten)]
    place: BusArguments,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    if let Some(path) = &arguments.out {
        arguments.replace.check_new(path)?;
    }
    let eds = sheet_of(arguments.eds.as_deref(), output)?;
    let mut reached = DeviceHandle::open(&arguments.place, &arguments.node, output)?;
    if arguments.concise && !reached.is_on_can() {
        let message = "a concise DCF is what a CANopen manager takes, and this place is on EtherCAT";
        return Err(Failure::new(Exit::Usage, message, "leave out --concise"));
    }
    let (found, missed) = objects(&mut reached, eds.as_ref(), output)?;
    let (text, count) = if arguments.concise {
        let (writes, left_out) = downloads(&found, eds.as_ref(), reached.named().node_id());
        for left_out in &left_out {
            output.aside(
                words::wrapped(&format!("left out  {}: {}", words::titled(left_out.at, &left_out.name), left_out.why))
                    .trim_end(),
            );
        }
        (concise(writes.iter().map(|(at, bytes)| (at.index, at.sub, bytes.as_slice()))), writes.len())
    } else {
        let text = found.to_dcf(&Of {
            id: reached.named().node_id(),
            name: reached.name().unwrap_or_default().to_owned(),
            bit_rate_kbit_per_s: None,
        });
        (text.into_bytes(), found.entries().filter(|(.., entry)| entry.value.is_some()).count())
    };
    if let Some(path) = &arguments.out {
        arguments.replace.write(path, &text)?;
    }
    let end = certain(&missed, &reached.words());
    if output.is_json() {
        let document = reached.document(json!({
            "file": arguments.out,
            "objects": document(&found),
            "missed": missed.iter().map(|missed| json!({ "object": missed.at.to_string(), "why": missed.why.to_string() })).collect::<Vec<_>>(),
        }));
        return output.end(document, end);
    }
    for missed in &missed {
        let verb = if missed.why.is_uncertain() { "uncertain" } else { "not read" };
        let line =
            format!("{verb}  {}: {}", words::titled(missed.at, &words::name(missed.at, eds.as_ref())), missed.why);
        output.aside(words::wrapped(&line).trim_end());
    }
    let told = format!(
        "{count} values of {}{}",
        reached.words(),
        match missed.iter().filter(|missed| !missed.why.is_uncertain()).count() {
            0 => String::new(),
            unread => format!(", {unread} could not be read"),
        }
    );
    match &arguments.out {
        Some(path) => output.news(&format!("{told}, into {}", path.display())),
        None => output.verbatim(&String::from_utf8_lossy(&text)),
    }?;
    end
}

/// Fails if the inventory cannot vouch for each value of the device.
fn certain(missed: &[UnreadObject], device: &str) -> Result<(), Failure> {
    let uncertain: Vec<_> = missed.iter().filter(|missed| missed.why.is_uncertain()).collect();
    if uncertain.is_empty() {
        return Ok(());
    }
    let noun = if uncertain.len() == 1 { "value is" } else { "values are" };
    let message = format!("{device}: {} {noun} not certain", uncertain.len());
    let is_padded = uncertain.iter().any(|missed| matches!(missed.why, Unread::Padded(_)));
    let help = if is_padded {
        "give the data sheet of the device with --eds, which has the types of its objects"
    } else {
        "correct the types of these objects in the data sheet, or leave out --eds"
    };
    Err(Failure::new(Exit::OutOfTolerance, message, help))
}

/// Returns all objects of a device with their values.
pub(super) fn objects(
    reached: &mut DeviceHandle,
    eds: Option<&Eds>,
    output: &Output,
) -> Result<(Eds, Vec<UnreadObject>), Failure> {
    match reached {
        DeviceHandle::Node(desk, node) => on_can(desk, node, eds, output),
        DeviceHandle::Device(desk, device) => on_segment(desk, device, eds, output),
    }
}

/// Reads the objects on CAN.
fn on_can(
    desk: &mut DeviceSession,
    node: &Node,
    eds: Option<&Eds>,
    output: &Output,
) -> Result<(Eds, Vec<UnreadObject>), Failure> {
    let progress = Progress::new(output);
    progress.begin("reading");
    let at = |share: f64| progress.at(Stage { time_s: share, end_s: 1.0 });
    let read = match eds {
        Some(eds) => values_of(&mut desk.service.objects(node.id), node.id.raw(), eds, at),
        None => inventory(&mut desk.service, node.id, at),
    };
    progress.end();
    read.map_err(|error| desk.failure(node, "reading all its objects", error))
}

/// Reads the objects on EtherCAT: by the device's own list of objects, if it has one.
fn on_segment(
    desk: &mut SegmentSession,
    device: &Device,
    eds: Option<&Eds>,
    output: &Output,
) -> Result<(Eds, Vec<UnreadObject>), Failure> {
    let present = desk.service.present(device.position);
    let present = present.map_err(|error| desk.failure(device, "reading its identity", error))?;
    let [vendor_number, product_number, revision_number, _] = present.identity;
    let product = name(&present).unwrap_or_default();
    let who = DeviceInfo { vendor_number, product_number, revision_number, product, ..DeviceInfo::default() };
    let progress = Progress::new(output);
    progress.begin("reading");
    let at = |share: f64| progress.at(Stage { time_s: share, end_s: 1.0 });
    let mut objects = desk.objects(device)?;
    let read = match eds {
        Some(eds) => values_of(&mut objects, 0, eds, at),
        None => inventory_of(&mut objects, 0, Eds { device: who, ..Eds::default() }, at),
    };
    progress.end();
    read.map_err(|error| desk.object_failure(device, "reading all its objects", error))
}

fn document(eds: &Eds) -> Vec<Value> {
    let valued = eds.entries().filter_map(|(index, sub, entry)| {
        let at = Address::new(index, sub);
        let bytes = entry.value.as_ref()?.to_bytes(entry.data_type, 0)?;
        let shown = words::value(at, Some(entry.data_type), &bytes, None);
        Some(words::document(at, &words::name(at, Some(eds)), &bytes, &shown))
    });
    valued.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_service::Error;

    #[test]
    fn a_dump_with_a_value_that_is_not_certain_is_no_success() {
        let missed = |why| UnreadObject { at: Address::new(0x2001, 0), why };
        let unread = missed(Unread::Failed(Error::NoAnswer));
        assert!(certain(&[unread], "node 1").is_ok(), "the device gives no value");
        for (why, message, help) in [
            (Unread::Padded(4), "node 1: 1 value is not certain", "--eds, which"),
            (Unread::Unfit(4), "node 1: 1 value is not certain", "leave out --eds"),
        ] {
            let failure = certain(&[unread, missed(why)], "node 1").unwrap_err();
            assert_eq!(failure.exit, Exit::OutOfTolerance);
            let finding = &failure.report.diagnostics[0];
            assert_eq!(finding.message, message);
            assert!(finding.help.as_ref().is_some_and(|text| text.contains(help)), "{:?}", finding.help);
        }
    }
}
