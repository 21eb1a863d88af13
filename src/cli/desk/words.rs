//! Objects and their values for a person.

use std::borrow::Cow;

use serde_json::{Value as Json, json};
use yieldwall_drives::cia402::{OperationMode, Statusword};
use yieldwall_drives::eds::{Eds, Value};
use yieldwall_drives::scaling::AxisScaling;

use crate::failure::{Exit, Failure};
use crate::printable::one_line;
use yieldwall_config::nearest_word;
use yieldwall_fieldbus::canopen::{EmcyCode, NmtState};
use yieldwall_fieldbus::objects::Address;
use yieldwall_run::explanation::state_name;
pub(super) use yieldwall_service::titled;
use yieldwall_service::{known, named, names, number, type_by_length};

/// Columns of a terminal.
pub(super) const COLUMNS: usize = 80;

/// A value as it is shown.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Shown {
    /// As the device has it.
    pub(super) raw: String,
    /// Meaning of the value: in SI units, or the name of a state.
    pub(super) means: Option<String>,
}

/// Objects by the unit of their values.
const COUNTS: [u16; 5] = [0x6064, 0x6065, 0x607a, 0x60b0, 0x60f4];
const COUNTS_PER_S: [u16; 3] = [0x606c, 0x60b1, 0x60ff];
const COUNTS_PER_S2: [u16; 3] = [0x6083, 0x6084, 0x6085];
const PER_MILLE: [u16; 7] = [0x6071, 0x6072, 0x6074, 0x6077, 0x60b2, 0x60e0, 0x60e1];

/// Returns the object for a word: `6041h`, `0x1018:2`, `1018h:2` or `1018sub2`, or a name. `0x` or `h` may be left out.
pub(super) fn object(word: &str, eds: Option<&Eds>) -> Result<Address, Failure> {
    if let Some(at) = address(word) {
        return Ok(at);
    }
    match named(word, eds).as_slice() {
        [only] => Ok(*only),
        [] => {
            let names = names(eds);
            let help = match nearest_word(word, names.iter().map(String::as_str)) {
                Some(meant) => format!("did you mean {meant}?"),
                None if eds.is_some() => {
                    "write its address, as 6041h or 1018h:2, or its name in the data sheet; `od dump` lists all"
                        .to_owned()
                }
                None => "write its address, as 6041h or 1018h:2; a data sheet (--eds) gives the names of the vendor"
                    .to_owned(),
            };
            Err(Failure::new(Exit::Usage, format!("no object is called {word}"), help))
        }
        several => {
            let each: Vec<String> = several.iter().take(8).map(ToString::to_string).collect();
            let message = format!("{} objects are called {word}", several.len());
            Err(Failure::new(Exit::Usage, message, format!("write one of their addresses: {}", each.join(", "))))
        }
    }
}

/// Returns the object for an address: `6041h`, `0x1018:2`, `1018h:2` or `1018sub2`.
pub(crate) fn address(word: &str) -> Option<Address> {
    let lower = word.to_ascii_lowercase();
    let (index, sub) = match lower.split_once(':').or_else(|| lower.split_once("sub")) {
        Some((index, sub)) => (index, hexadecimal(sub).filter(|sub| *sub <= 0xff)? as u8),
        None => (lower.as_str(), 0),
    };
    let has_mark = index.starts_with("0x") || index.ends_with('h');
    let index = hexadecimal(index).filter(|number| *number <= 0xffff && (has_mark || index.len() == 4))?;
    Some(Address::new(index as u16, sub))
}

pub(super) fn hexadecimal(word: &str) -> Option<u32> {
    let digits = word.strip_prefix("0x").unwrap_or_else(|| word.strip_suffix('h').unwrap_or(word));
    let is_number = !digits.is_empty() && digits.bytes().all(|one| one.is_ascii_hexdigit());
    is_number.then(|| u32::from_str_radix(digits, 16).ok()).flatten()
}

/// Returns the name of an object, or its address if it has no name.
pub(super) fn name(at: Address, eds: Option<&Eds>) -> String {
    known(at, eds).map_or_else(String::new, |known| known.name)
}

/// Returns the range of an object, from the limits of its data sheet and its type: `0 to 1000`; `None` for other types than whole
/// numbers.
pub(super) fn range(at: Address, data_type: u16, node_id: u8, eds: Option<&Eds>) -> Option<String> {
    let of_type = Value::range(data_type)?;
    let entry = eds.and_then(|eds| eds.entry(at.index, at.sub));
    let limit = |value: Option<&Value>| match value {
        Some(Value::Integer(number)) => Some(*number),
        Some(Value::OfNode(number)) => Some(number + i128::from(node_id)),
        _ => None,
    };
    let low = entry.and_then(|entry| limit(entry.low.as_ref()));
    let high = entry.and_then(|entry| limit(entry.high.as_ref()));
    let by = if low.or(high).is_some() { ", by the data sheet" } else { "" };
    Some(format!("{} to {}{by}", low.unwrap_or(of_type.start), high.unwrap_or(of_type.end - 1)))
}

/// Returns the value of an object.
pub(super) fn value(at: Address, data_type: Option<u16>, bytes: &[u8], scaling: Option<&AxisScaling>) -> Shown {
    let data_type = data_type.or_else(|| type_by_length(bytes.len()));
    let value = data_type.map_or_else(|| Value::Bytes(bytes.to_vec()), |data_type| Value::from_bytes(data_type, bytes));
    let raw = match &value {
        Value::Integer(value) => {
            let digits = 2 * bytes.len();
            let word = bytes.iter().rev().fold(0_u128, |word, byte| word << 8 | u128::from(*byte));
            format!("{value} ({word:0digits$X}h)")
        }
        Value::Real(value) => format!("{value}"),
        Value::Text(text) => format!("\"{}\"", one_line(text)),
        Value::OfNode(_) | Value::Bytes(_) => {
            let shown = bytes.iter().take(24).map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(" ");
            if bytes.len() > 24 { format!("{shown} .. ({} bytes)", bytes.len()) } else { shown }
        }
    };
    let means = match &value {
        Value::Integer(value) => meaning(at, *value, bytes, scaling),
        _ => None,
    };
    Shown { raw, means }
}

fn meaning(at: Address, value: i128, bytes: &[u8], scaling: Option<&AxisScaling>) -> Option<String> {
    let word = number(bytes);
    match at.index {
        0x6041 => return Some(state_words(word as u16)),
        0x603f if word != 0 => return Some(EmcyCode(word as u16).meaning().to_owned()),
        0x6060 | 0x6061 => return Some(mode_code_words(word as u8 as i8)),
        0x6502 => {
            let modes: Vec<&str> =
                OperationMode::ALL.into_iter().filter(|mode| mode.is_in(word)).map(mode_words).collect();
            return Some(modes.join(", "));
        }
        0x6076 => return Some(format!("{} N m", value as f64 * 1e-3)),
        0x6080 => return Some(format!("{value} r/min")),
        0x1600..0x1800 | 0x1a00..0x1c00 if at.sub > 0 && word != 0 => return Some(mapped(word)),
        0x1016 if at.sub > 0 && word != 0 => {
            return Some(format!("node {}, {} ms", word >> 16 & 0x7f, word & 0xffff));
        }
        0x1400..0x1600 | 0x1800..0x1a00 if at.sub == 1 => {
            let id = word & 0x7ff;
            return Some(if word >> 31 == 0 { format!("identifier {id:03X}h") } else { "not used".to_owned() });
        }
        _ => {}
    }
    let scaling = scaling?;
    let per_count = 1.0 / scaling.counts_per_rad();
    let (factor, unit) = match at.index {
        // An angle has a zero and a sign; a window has neither.
        0x6064 | 0x607a => return Some(format!("{:.6} rad", scaling.angle_rad(i64::try_from(value).ok()?))),
        index if COUNTS.contains(&index) => (per_count, "rad"),
        index if COUNTS_PER_S.contains(&index) => (per_count, "rad/s"),
        index if COUNTS_PER_S2.contains(&index) => (per_count, "rad/s^2"),
        index if PER_MILLE.contains(&index) => (scaling.rated_torque_n_m() * 1e-3, "N m"),
        _ => return None,
    };
    Some(format!("{:.6} {unit}", value as f64 * factor))
}

/// `6064h:0 position-actual, 32 bits`.
pub(crate) fn mapped(entry: u32) -> String {
    let at = Address::new((entry >> 16) as u16, (entry >> 8) as u8);
    format!("{}, {} bits", titled(at, &name(at, None)), entry & 0xff)
}

/// Returns the state in a statusword, in words.
pub(crate) fn state_words(word: u16) -> String {
    let status = Statusword(word);
    let mut words = state_name(status.state()).to_owned();
    for (bit, says) in [(Statusword::WARNING, ", warning"), (Statusword::INTERNAL_LIMIT, ", internal limit")] {
        if status.has(bit) {
            words.push_str(says);
        }
    }
    words
}

/// Returns a state of network management as the standard writes it.
pub(super) fn nmt_words(state: NmtState) -> &'static str {
    match state {
        NmtState::Initialising => "Initialising",
        NmtState::PreOperational => "Pre-operational",
        NmtState::Operational => "Operational",
        NmtState::Stopped => "Stopped",
    }
}

/// `SwitchOnDisabled` as `Switch On Disabled`.
pub(super) fn spaced(name: &str) -> String {
    let mut words = String::new();
    for one in name.chars() {
        if one.is_uppercase() && !words.is_empty() {
            words.push(' ');
        }
        words.push(one);
    }
    words
}

/// Describes a code of 6060h or 6061h.
pub(super) fn mode_code_words(code: i8) -> String {
    match (OperationMode::from_code(code), code) {
        (Some(mode), _) => mode_words(mode).to_owned(),
        (None, 0) => "no mode".to_owned(),
        (None, ..0) => "the vendor's own".to_owned(),
        (None, _) => "reserved by CiA 402".to_owned(),
    }
}

/// Returns a mode of operation as people call it.
pub(super) fn mode_words(mode: OperationMode) -> &'static str {
    match mode {
        OperationMode::ProfilePosition => "profile position",
        OperationMode::Velocity => "velocity",
        OperationMode::ProfileVelocity => "profile velocity",
        OperationMode::ProfileTorque => "profile torque",
        OperationMode::Homing => "homing",
        OperationMode::InterpolatedPosition => "interpolated position",
        OperationMode::CyclicPosition => "CSP",
        OperationMode::CyclicVelocity => "CSV",
        OperationMode::CyclicTorque => "CST",
        OperationMode::CyclicTorqueWithAngle => "CST with angle",
    }
}

/// Returns an object with its value for a program.
pub(super) fn document(at: Address, name: &str, bytes: &[u8], shown: &Shown) -> Json {
    let hexadecimal: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    json!({ "object": at.to_string(), "name": name, "bytes": hexadecimal, "value": shown.raw, "means": shown.means })
}

/// Lines of a text that fit a terminal of 80 columns; between words alone, so that a path can be copied.
pub(super) fn wrapped(text: &str) -> String {
    wrapped_behind("", text)
}

/// Wraps the text and puts `head` before each line.
pub(super) fn wrapped_behind(head: &str, text: &str) -> String {
    let options = textwrap::Options::new(COLUMNS).initial_indent(head).subsequent_indent(head).break_words(false);
    let options = options.word_separator(textwrap::WordSeparator::AsciiSpace);
    textwrap::fill(text, options.word_splitter(textwrap::WordSplitter::NoHyphenation)) + "\n"
}

/// Formats a change of a value, `old -> new`: on one line if it fits, otherwise indented below its subject.
pub(super) fn change(old: &str, new: &str) -> String {
    let line = format!("    {old} -> {new}");
    if line.chars().count() <= COLUMNS { format!("{line}\n") } else { format!("    {old}\n    -> {new}\n") }
}

/// Returns a table: columns as wide as their widest cell, the last as long as it is. A cell stays in its row, whatever characters
/// it has.
pub(super) fn table<const N: usize>(rows: &[[String; N]]) -> String {
    let mut widths = [0; N];
    let rows: Vec<[Cow<'_, str>; N]> = rows.iter().map(|row| row.each_ref().map(|cell| one_line(cell))).collect();
    for row in &rows {
        for (width, cell) in widths.iter_mut().zip(row) {
            *width = (*width).max(cell.chars().count());
        }
    }
    let line = |row: &[Cow<'_, str>; N]| {
        let cells: Vec<String> = row.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}")).collect();
        cells.join("  ").trim_end().to_owned() + "\n"
    };
    rows.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_are_meant_by_address_or_name() {
        for (word, index, sub) in [
            ("6041h", 0x6041, 0),
            ("0x6041", 0x6041, 0),
            ("6041", 0x6041, 0),
            ("1018h:2", 0x1018, 2),
            ("0x1018:0x4", 0x1018, 4),
            ("1018sub2", 0x1018, 2),
            ("statusword", 0x6041, 0),
            ("max torque", 0x6072, 0),
            ("vendor-id", 0x1018, 1),
        ] {
            assert_eq!(object(word, None).unwrap(), Address::new(index, sub), "{word}");
        }
        for word in ["", "604", "60411", "6041h:100", "xyz", "6041:", "-1"] {
            assert!(object(word, None).is_err(), "{word}");
        }
    }

    #[test]
    fn a_range_is_that_of_the_data_sheet_or_of_the_type() {
        let text =
            b"[DeviceInfo]\nVendorName=x\n[6072]\nParameterName=Max torque\nObjectType=7\nDataType=6\nAccessType=rw\n\
            LowLimit=10\nHighLimit=1000\n";
        let eds = Eds::read(text).unwrap().eds;
        let at = Address::new(0x6072, 0);
        assert_eq!(range(at, 6, 1, None).as_deref(), Some("0 to 65535"));
        assert_eq!(range(at, 6, 1, Some(&eds)).as_deref(), Some("10 to 1000, by the data sheet"));
        assert_eq!(range(at, 2, 1, None).as_deref(), Some("-128 to 127"));
        assert_eq!(range(at, 9, 1, None), None, "text");
    }

    #[test]
    fn values_say_what_they_mean() {
        let means = |index, data_type, bytes: &[u8]| value(Address::new(index, 1), Some(data_type), bytes, None);
        assert_eq!(means(0x6041, 6, &[0x37, 0x06]).means.as_deref(), Some("Operation Enabled"));
        assert_eq!(means(0x1a00, 7, &[0x10, 0, 0x41, 0x60]).means.as_deref(), Some("6041h:0 statusword, 16 bits"));
        assert_eq!(means(0x1800, 7, &[1, 1, 0, 0x80]).means.as_deref(), Some("not used"));
        assert_eq!(means(0x6061, 2, &[8]).means.as_deref(), Some("CSP"));
        assert_eq!(means(0x6061, 2, &[0]).means.as_deref(), Some("no mode"));
        assert_eq!(means(0x6061, 2, &[0xff]).means.as_deref(), Some("the vendor's own"));
        assert_eq!(means(0x6080, 7, &[0xb8, 0x0b, 0, 0]).means.as_deref(), Some("3000 r/min"));
        assert_eq!(means(0x6064, 4, &[0xff; 4]), Shown { raw: "-1 (FFFFFFFFh)".into(), means: None });
        assert_eq!(value(Address::new(0x2000, 0), None, &[1, 2, 3], None).raw, "01 02 03");
    }

    #[test]
    fn a_name_that_a_device_gives_itself_stays_in_its_line() {
        let shown = value(Address::new(0x1008, 0), Some(9), b"drive\n2  Operational\x1b[2J", None);
        assert_eq!(shown.raw, r#""drive\n2  Operational\u{1b}[2J""#);
        let rows = [["node", "name"], ["1", "a\nb\tc\u{85}"]].map(|row| row.map(str::to_owned));
        assert_eq!(table(&rows), "node  name\n1     a\\nb\\tc\\u{85}\n");
    }
}
