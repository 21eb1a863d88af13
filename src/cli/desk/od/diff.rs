//! `yieldwall od diff`: the differences between two devices, or a device and a file.

use std::path::{Path, PathBuf};

use serde_json::json;
use yieldwall_drives::eds::{Eds, Entry, Value};

use super::super::place::BusArguments;
use super::super::reached::DeviceHandle;
use super::super::words::{self, COLUMNS, titled};
use super::dump::objects;
use super::{is_file, sheet_of};
use crate::failure::{Exit, Failure};
use crate::output::Output;
use yieldwall_fieldbus::objects::Address;
use yieldwall_service::{is_shown, known, of_node};

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Device (node id, EtherCAT position, or name), or file with values (DCF or concise DCF)
    first: String,
    /// Device or file to compare with the first
    second: String,
    /// Also compare values that a device reports but does not store, such as its position
    #[arg(long)]
    all: bool,
    /// Data sheet (EDS or DCF) with the names and types of vendor objects
    #[arg(long, value_name = "FILE.eds")]
    eds: Option<PathBuf>,
    #[command(flatten)]
    place: BusArguments,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let eds = sheet_of(arguments.eds.as_deref(), output)?;
    let words = [&arguments.first, &arguments.second];
    let mut files = Vec::new();
    for word in words {
        files.push(if is_file(word) { Some(super::values(Path::new(word), eds.as_ref(), output)?) } else { None });
    }
    // Devices are read by the objects of the data sheet, or by those of the file; otherwise the command searches for all objects.
    let by = eds.clone().or_else(|| files.iter().flatten().next().cloned());
    let (mut reached, mut values) = (None::<DeviceHandle>, Vec::new());
    for (word, file) in words.into_iter().zip(files) {
        if let Some(file) = file {
            values.push(file);
            continue;
        }
        let mut device = match reached.take() {
            Some(mut there) => {
                there.turn_to(word, output)?;
                there
            }
            None => DeviceHandle::open(&arguments.place, word, output)?,
        };
        values.push(objects(&mut device, by.as_ref(), output)?.0);
        reached = Some(device);
    }
    let [first, second] = values.as_slice() else { return Err(Failure::new(Exit::Internal, "two sides", "")) };
    let differences = differences(first, second, eds.as_ref(), arguments.all);
    let end = match differences.len() {
        0 => Ok(()),
        count => {
            let noun = if count == 1 { "object differs" } else { "objects differ" };
            Err(Failure::new(Exit::OutOfTolerance, format!("{count} {noun}"), ""))
        }
    };
    if output.is_json() {
        let each = differences.iter().map(|Difference { at, name, first, second }| {
            json!({ "object": at.to_string(), "name": name, "first": first, "second": second })
        });
        return output.end(json!({ "differences": each.collect::<Vec<_>>() }), end);
    }
    output.result(&lines(&differences))?;
    let is_one_sided = |difference: &Difference| difference.first.is_none() || difference.second.is_none();
    if differences.is_empty() {
        output.news("no difference")?;
    } else if differences.iter().any(is_one_sided) {
        let legend =
            format!("{NONE}: {} or {} has no such object, or no value of it", arguments.first, arguments.second);
        output.news(words::wrapped(&legend).trim_end())?;
    }
    end
}

struct Difference {
    at: Address,
    name: String,
    /// `None` where that side has no such object, or no value of it.
    first: Option<String>,
    second: Option<String>,
}

/// Text for a side without a value.
const NONE: &str = "(none)";

/// Returns the differences, a line each; where that is too long, values stand below.
fn lines(differences: &[Difference]) -> String {
    let titles: Vec<String> = differences.iter().map(|difference| titled(difference.at, &difference.name)).collect();
    let width = titles.iter().map(|title| title.chars().count()).max().unwrap_or_default();
    let each = differences.iter().zip(titles).map(|(Difference { first, second, .. }, title)| {
        let [first, second] = [first, second].map(|value| value.as_deref().unwrap_or(NONE));
        let line = format!("{title:width$}  {first} -> {second}");
        if line.chars().count() <= COLUMNS { line + "\n" } else { format!("{title}\n{}", words::change(first, second)) }
    });
    each.collect()
}

/// Returns the objects whose values differ between the two sides, and those that only one side has.
fn differences(first: &Eds, second: &Eds, eds: Option<&Eds>, all: bool) -> Vec<Difference> {
    let mut found = Vec::new();
    let mut addresses: Vec<(u16, u8)> =
        first.entries().chain(second.entries()).map(|(index, sub, _)| (index, sub)).collect();
    addresses.sort_unstable();
    addresses.dedup();
    // An identifier that counts from the node id is the same on both sides if its offset is the same.
    let ids = [first, second].map(|side| side.node.as_ref().map(|node| node.id));
    let own = [ids[0].or(ids[1]), ids[1].or(ids[0])].map(Option::unwrap_or_default);
    for (index, sub) in addresses {
        let at = Address::new(index, sub);
        let entries = [first, second].map(|side| side.entry(index, sub).filter(|entry| entry.value.is_some()));
        if !all && (is_shown(at) || entries.iter().flatten().any(|entry| !entry.access.is_writable())) {
            continue;
        }
        let data_type = common_type(at, &entries, eds);
        let [one, other] = entries;
        let bytes = [(one, own[0]), (other, own[1])].map(|(entry, node_id)| {
            let entry = entry?;
            entry.value.as_ref()?.to_bytes(data_type.unwrap_or(entry.data_type), node_id)
        });
        let [one, other] = [(&bytes[0], own[0]), (&bytes[1], own[1])].map(|(bytes, node_id)| {
            let value = Value::from_bytes(data_type.unwrap_or(0x0a), bytes.as_deref()?);
            Some(of_node(at, value, node_id))
        });
        if one == other {
            continue;
        }
        let [one, other] = bytes.map(|bytes| {
            bytes.map(|bytes| {
                let shown = words::value(at, data_type, &bytes, None);
                shown.means.map_or(shown.raw.clone(), |means| format!("{} {means}", shown.raw))
            })
        });
        let name = words::name(at, eds);
        found.push(Difference { at, name, first: one, second: other });
    }
    found
}

/// Returns the data type in which both sides are compared. It comes from the data sheet or the standards, or else from the first side
/// whose type has a place for both values.
fn common_type(at: Address, sides: &[Option<&Entry>; 2], eds: Option<&Eds>) -> Option<u16> {
    let fits = |data_type: u16| {
        let mut values = sides.iter().flatten().filter_map(|entry| entry.value.as_ref());
        values.all(|value| value.to_bytes(data_type, 0).is_some())
    };
    let known = known(at, eds).map(|known| known.data_type);
    let own = sides.iter().flatten().map(|entry| entry.data_type);
    known.into_iter().chain(own).find(|data_type| fits(*data_type)).or(known)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sheet(index: &str, data_type: &str, value: &str) -> Eds {
        let text = format!(
            "[DeviceInfo]\nVendorName=x\n[{index}]\nParameterName=Limit\nObjectType=7\nDataType={data_type}\nAccessType=rw\n\
             ParameterValue={value}\n"
        );
        Eds::read(text.as_bytes()).unwrap().eds
    }

    #[test]
    fn a_negative_limit_is_compared_in_the_type_of_its_file() {
        let negative = sheet("60E1", "3", "-500");
        for (index, data_type, value, wanted) in [
            ("60E1", "3", "-500", None),
            // The bits of -500, as a dump without a data sheet has them.
            ("60E1", "6", "65036", None),
            ("60E1", "3", "-400", Some(("-500 (FE0Ch)", "-400 (FE70h)"))),
            ("60E1", "6", "500", Some(("-500 (FE0Ch)", "500 (01F4h)"))),
        ] {
            let found = differences(&negative, &sheet(index, data_type, value), None, false);
            let shown =
                found.first().map(|one| (one.first.as_deref().unwrap_or(NONE), one.second.as_deref().unwrap_or(NONE)));
            assert_eq!(shown, wanted, "{value}");
        }
        // Siblings: one and four bytes.
        for (data_type, value) in [("2", "-100"), ("4", "-70000")] {
            let side = sheet("60E0", data_type, value);
            assert!(differences(&side, &side, None, false).is_empty());
            let found = differences(&side, &sheet("60E0", data_type, "-99"), None, false);
            assert!(found.first().is_some_and(|one| one.first.is_some() && one.second.is_some()), "{value}");
        }
    }
}
