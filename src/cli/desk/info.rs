//! `yieldwall info`: one device.

use serde_json::{Map, Value, json};
use yieldwall_drives::profiles::AxisOffset;
use yieldwall_drives::scaling::AxisScaling;

use super::place::{BusArguments, DeviceSession};
use super::scan::{fit, kind};
use super::segment::{self, SegmentSession};
use super::words::{self, nmt_words, table};
use crate::failure::Failure;
use crate::output::Output;
use yieldwall_fieldbus::objects::Address;
use yieldwall_run::explanation::Explanation;
use yieldwall_service::{Bytes, Error, FoundDevice, count_axes, identify, known, number};

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Node id, EtherCAT position, or device name from the rig
    node: String,
    #[command(flatten)]
    place: BusArguments,
}

/// Whose heartbeat is watched.
const HEARTBEAT_CONSUMER: u16 = 0x1016;
/// The last error of a drive.
const ERROR_CODE: u16 = 0x603f;

/// Objects that are read from any device, and from a drive.
const OBJECTS: [(u16, u8, &str); 14] = [
    (0x1009, 0, "hardware"),
    (0x100a, 0, "software"),
    (0x1001, 0, "error register"),
    (0x1003, 0, "errors stored"),
    (0x1017, 0, "heartbeat, ms"),
    (HEARTBEAT_CONSUMER, 1, "watches heartbeat of"),
    (0x6502, 0, "modes"),
    (0x6061, 0, "mode display"),
    (0x6041, 0, "state"),
    (0x603f, 0, "error code"),
    (0x6064, 0, "position"),
    (0x6076, 0, "rated torque"),
    (0x6072, 0, "torque limit"),
    (0x6080, 0, "motor speed limit"),
];

pub(crate) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    if let Some(desk) = SegmentSession::open(&arguments.place, output)? {
        return segment::info::run(&arguments.node, desk, output);
    }
    let mut desk = DeviceSession::open(&arguments.place, output)?;
    let node = desk.node(&arguments.node)?;
    let failed = |desk: &DeviceSession, error| desk.failure(&node, "reading its identity", error);
    let device_type = match desk.service.read(node.id, Address::new(0x1000, 0)) {
        Ok(bytes) => Some(number(&bytes)),
        Err(Error::Refused(_)) => None,
        Err(error) => return Err(failed(&desk, error)),
    };
    let state = desk.service.state(node.id).map_err(|error| failed(&desk, error))?;
    let identities = identify(&mut desk.service, &[node.id]).map_err(|error| failed(&desk, error))?;
    let (identity_parts, name) = identities.into_iter().next().unwrap_or_default();
    let axes = count_axes(|at| match desk.service.read(node.id, at) {
        Ok(_) => Ok(true),
        Err(Error::Refused(_)) => Ok(false),
        Err(error) => Err(failed(&desk, error)),
    })?;
    let heard = desk.service.heard(node.id);
    let found = FoundDevice { node: node.id, heard, device_type, identity: identity_parts, name, axes: Some(axes) };
    let asked: Vec<_> = asked(node.axis).map(|at| (node.id, at)).collect();
    let answers = desk.service.read_each(&asked).map_err(|error| desk.bus_failure(error))?;
    let mut rows =
        vec![["device".to_owned(), format!("{}: {}", kind(device_type), found.name.as_deref().unwrap_or("no name"))]];
    for (part, value) in ["vendor", "product", "revision", "serial"].into_iter().zip(found.identity) {
        rows.extend(value.map(|value| [part.to_owned(), format!("{value:08X}h")]));
    }
    rows.push(["rig".to_owned(), fit(&desk, &found)]);
    rows.push(["NMT".to_owned(), state.map_or("tells none".to_owned(), |state| nmt_words(state).to_owned())]);
    rows.extend(axes_row(axes));
    let (more, objects) = objects(answers, node.scaling(), node.axis, |code| desk.explained(&node, code));
    rows.extend(more);
    if output.is_json() {
        let [vendor, product, revision, serial] = found.identity;
        return output.report(json!({
            "place": desk.place,
            "node_id": node.id.raw(),
            "name": found.name,
            "device_type": device_type,
            "vendor_id": vendor,
            "product_code": product,
            "revision": revision,
            "serial": serial,
            "nmt": state.map(|state| format!("{state:?}")),
            "axes": axes,
            "rig": fit(&desk, &found),
            "objects": Value::Object(objects),
        }));
    }
    output.result(&format!("{}\n{}", node.words(), table(&rows)))
}

/// Returns the line with the number of axes of a multi-axis device.
pub(super) fn axes_row(axes: u8) -> Option<[String; 2]> {
    (axes > 1).then(|| ["axes".to_owned(), axes.to_string()])
}

/// Returns the objects that are read from any device, for this axis of a drive.
pub(super) fn asked(axis: AxisOffset) -> impl Iterator<Item = Address> {
    OBJECTS.into_iter().map(move |(index, sub, _)| Address::new(axis.index(index), sub))
}

/// Returns the content of the answers, in the order of [`asked`], as text and as data.
pub(super) fn objects(
    answers: impl IntoIterator<Item = Result<Bytes, Error>>,
    scaling: Option<&AxisScaling>,
    axis: AxisOffset,
    explained: impl Fn(u16) -> Explanation,
) -> (Vec<[String; 2]>, Map<String, Value>) {
    let (mut rows, mut objects) = (Vec::new(), Map::new());
    for ((index, sub, what), answer) in OBJECTS.into_iter().zip(answers) {
        let at = Address::new(index, sub);
        let Ok(bytes) = answer else { continue };
        let data_type = known(at, None).map(|known| known.data_type);
        let mut shown = words::value(at, data_type, &bytes, scaling);
        let explained = (index == ERROR_CODE && number(&bytes) != 0).then(|| explained(number(&bytes) as u16));
        if index == HEARTBEAT_CONSUMER && number(&bytes) == 0 {
            shown.means = Some("nobody".to_owned());
        }
        if let Some(explained) = &explained {
            shown.means = Some(explained.meaning.to_string());
        }
        let own = Address::new(axis.index(index), sub);
        objects.insert(what.to_owned(), words::document(own, &words::name(at, None), &bytes, &shown));
        rows.push([what.to_owned(), shown.means.map_or(shown.raw.clone(), |means| format!("{means}  {}", shown.raw))]);
        if let Some(explained) = explained {
            rows.push(["  cause".to_owned(), explained.cause.into_owned()]);
            rows.push(["  next".to_owned(), explained.next.into_owned()]);
        }
    }
    (rows, objects)
}
