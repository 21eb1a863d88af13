//! Objects of the dictionary, and possible meanings of a value of four bytes.

use yieldwall_drives::objects;

use super::super::desk::mapped;
use yieldwall_fieldbus::objects::{AbortCode, Address};
use yieldwall_run::explanation::{self, Explanation};
use yieldwall_service::known;

/// The first bytes of the abort codes that the standards and the makers of drives use.
const ABORT_CLASSES: [u32; 4] = [0x05, 0x06, 0x08, 0x0f];

/// Returns an object of the dictionary.
pub(super) fn object(at: Address) -> Explanation {
    let listed = objects::ALL.iter().find(|object| (object.index, object.sub) == (at.index, at.sub));
    let is_of_vendor = (0x2000..0x6000).contains(&at.index);
    let known = known(at, None);
    let meaning = match (&known, listed.filter(|_| !is_of_vendor)) {
        (_, Some(object)) => object.meaning,
        (Some(_), None) => "an object of the standards",
        (None, None) if is_of_vendor => "an object of the vendor: its data sheet (EDS) says what it is",
        (None, None) => "no object of the standards that this program knows",
    };
    explained(
        "an object of the dictionary",
        at.to_string(),
        known.map_or_else(|| "unknown".to_owned(), |known| known.name),
        meaning.to_owned(),
        format!("`yieldwall od read NODE {at}` reads it"),
    )
}

/// Returns the possible readings of a code of more than two bytes. They are an abort code, or else a value that `od read` and
/// `od dump` show: a mapping, 1016h or a COB-ID.
pub(super) fn readings(code: u32) -> Vec<Explanation> {
    let abort = explanation::abort(AbortCode(code));
    if AbortCode::ALL.contains(&AbortCode(code)) {
        return vec![abort];
    }
    let word = || format!("{code:08X}h");
    let mut all = Vec::new();
    let (index, bits) = (code >> 16, code & 0xff);
    let is_dummy = (1..=7).contains(&index) && code & 0xff00 == 0;
    let is_identifier = code & 0x3fff_f800 == 0 && code & 0xc000_0000 != 0;
    if (1..=64).contains(&bits) && (index >= 0x1000 || is_dummy) && !is_identifier {
        let meaning = match is_dummy {
            true => format!("{bits} bits that are skipped (a dummy entry of data type {index:04X}h)"),
            false => mapped(code),
        };
        let next = "`yieldwall pdo show NODE` shows what a device maps".to_owned();
        all.push(explained("a mapped object of a PDO (1600h, 1A00h)", word(), "mapping".to_owned(), meaning, next));
    }
    let (node, ms) = (code >> 16, code & 0xffff);
    if (1..=127).contains(&node) && ms > 0 {
        let meaning = format!("the heartbeat of node {node} is watched: it comes within {ms} ms");
        let next = "`yieldwall od read NODE 1016h:1` shows what a device watches".to_owned();
        let what = "a watched heartbeat (1016h)";
        all.push(explained(what, word(), "consumer-heartbeat".to_owned(), meaning, next));
    }
    if is_identifier {
        let used = if code >> 31 == 0 { "used" } else { "not used" };
        let rtr = if code & 0x4000_0000 == 0 { "" } else { ", and cannot be asked for by a remote frame" };
        let meaning = format!("identifier {:03X}h; the PDO is {used}{rtr}", code & 0x7ff);
        let next = "`yieldwall pdo show NODE` shows the PDOs of a device".to_owned();
        all.push(explained("a COB-ID of a PDO (1400h:1, 1800h:1)", word(), "cob-id".to_owned(), meaning, next));
    }
    if all.is_empty() || ABORT_CLASSES.contains(&(code >> 24)) {
        all.push(abort);
    }
    all
}

fn explained(what: &'static str, code: String, name: String, meaning: String, next: String) -> Explanation {
    let (name, meaning, next) = (name.into(), meaning.into(), next.into());
    Explanation { what, code: Some(code), name, meaning, cause: "".into(), next, source: None }
}
