//! Faults and codes in words: what each means, what usually lies behind it, and what to do next.
//!
//! One place for all that prints them: `explain`, the messages of a run, and the commands that ask devices.
//!
//! | of | where the words stand |
//! |---|---|
//! | [`fault`] | the fault table, [`guard::fault::TABLE`](yieldwall_motion::guard::fault::TABLE) |
//! | [`injection`] | the catalogue of what can be broken on purpose |
//! | [`defect`] | the table of what a simulated machine can have that a commissioning finds |
//! | [`error_code`] | the vendor's table (`drives/codes`), or else [`EmcyCode`] |
//! | [`abort`] | [`AbortCode`] |
//! | [`al_status`] | [`AlStatusCode`] |
//! | [`statusword`] | here, a row for each state of CiA 402 |

mod status;
#[cfg(test)]
mod tests;

use std::borrow::Cow;
use std::fmt;

use yieldwall_drives::cia402::Statusword;
use yieldwall_drives::codes::ErrorCodes;

use yieldwall_config::injection::{DefectKind, FoundBy, Kind};
use yieldwall_fieldbus::canopen::EmcyCode;
use yieldwall_fieldbus::ethercat::AlStatusCode;
use yieldwall_fieldbus::objects::AbortCode;
use yieldwall_motion::guard::Fault;
use yieldwall_motion::guard::fault::FaultRow;

pub use status::state_name;

/// Meaning of a fault or a code.
///
/// `Display` prints what a message has room for: code, meaning and cause. The next action goes with the message as its help.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Explanation {
    /// Kind with the article: `a fault of the rig`.
    pub what: &'static str,
    /// The code in hexadecimal as devices show it, such as `8130h`; `None` of a fault of the rig.
    pub code: Option<String>,
    /// Short name, such as `heartbeat-lost`; for a vendor's table the name in its file.
    pub name: Cow<'static, str>,
    /// Text of the meaning.
    pub meaning: Cow<'static, str>,
    /// Usual cause.
    pub cause: Cow<'static, str>,
    /// Next action.
    pub next: Cow<'static, str>,
    /// Table and document of a vendor's code.
    pub source: Option<String>,
}

impl fmt::Display for Explanation {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let word = self.code.as_deref().unwrap_or(&self.name);
        let separator = if self.code.is_some() { "" } else { ":" };
        write!(out, "{word}{separator} {} ({})", self.meaning, self.cause)
    }
}

/// Explains a fault of the rig.
pub fn fault(fault: Fault) -> Explanation {
    let FaultRow { name, meaning, cause, next, .. } = *fault.row();
    Explanation {
        what: "a fault of the rig",
        code: None,
        name: name.into(),
        meaning: meaning.into(),
        cause: cause.into(),
        next: next.into(),
        source: None,
    }
}

/// Explains a fault that can be injected: its effect, and the remedy for the faults that follow.
pub fn injection(kind: Kind) -> Explanation {
    let row = kind.row();
    let next: Vec<FaultRow> = row.expected.faults.iter().map(|fault| *fault.row()).collect();
    let next = match next.as_slice() {
        [] => "nothing: the rig goes on".to_owned(),
        [only] => only.next.to_owned(),
        several => several.iter().map(|row| format!("{}: {}", row.name, row.next)).collect::<Vec<_>>().join("\n"),
    };
    Explanation {
        what: "a fault to inject, `yieldwall run RIG.yaml --fault`",
        code: None,
        name: row.name.into(),
        meaning: row.meaning.into(),
        cause: "requested with --fault or by the scene".into(),
        next: next.into(),
        source: None,
    }
}

/// Explains a defect of a simulated machine, and how to find it.
pub fn defect(kind: DefectKind) -> Explanation {
    let row = kind.row();
    Explanation {
        what: "a defect of a simulated machine, `yieldwall commission RIG.yaml --defect`",
        code: None,
        name: row.name.into(),
        meaning: row.meaning.into(),
        cause: "requested with --defect; on a bench, wiring, parameters or wear".into(),
        next: match row.found_by {
            FoundBy::Step(_) => format!("commission the rig: {} finds it and says what to do", row.found_by).into(),
            FoundBy::Command(_) => format!("{} finds it", row.found_by).into(),
        },
        source: None,
    }
}

/// Explains an error code of an emergency message, of 603Fh or of 1003h: by the table of the device's vendor if that has it, or
/// else by the standards.
pub fn error_code(code: u16, of_vendor: Option<&ErrorCodes>) -> Explanation {
    let what = "an error code, of an emergency message or in 603Fh";
    let written = Some(format!("{code:04X}h"));
    if let Some((table, known)) = of_vendor.and_then(|table| Some((table, table.of(code)?))) {
        let document = table.document(known).unwrap_or(&known.source);
        return Explanation {
            what,
            code: written,
            name: known.name.clone().into(),
            meaning: known.meaning.clone().into(),
            cause: known.cause.clone().into(),
            next: known.next.clone().into(),
            source: Some(format!("{document} (table {})", table.error_codes.name)),
        };
    }
    let code = EmcyCode(code);
    Explanation {
        what,
        code: written,
        name: code.name().into(),
        meaning: code.meaning().into(),
        cause: code.likely_cause().into(),
        next: code.next().into(),
        source: None,
    }
}

/// Explains an SDO abort code.
pub fn abort(code: AbortCode) -> Explanation {
    Explanation {
        what: "an SDO abort code",
        code: Some(format!("{:08X}h", code.0)),
        name: code.name().into(),
        meaning: code.meaning().into(),
        cause: code.likely_cause().into(),
        next: code.next().into(),
        source: None,
    }
}

/// Explains an AL status code of EtherCAT; `None` for a code that the standard does not define.
pub fn al_status(code: AlStatusCode) -> Option<Explanation> {
    AlStatusCode::ALL.contains(&code).then(|| Explanation {
        what: "an AL status code of EtherCAT (0134h)",
        code: Some(format!("{:04X}h", code.0)),
        name: "al-status".into(),
        meaning: code.meaning().into(),
        cause: code.likely_cause().into(),
        next: "fix what is named; the master then acknowledges the error and asks for the state again".into(),
        source: None,
    })
}

/// Explains a statusword (6041h): its state, and the meaning of its other bits.
pub fn statusword(word: u16) -> Explanation {
    let word = Statusword(word);
    let row = status::row(word.state());
    let bits = status::bits(word);
    let meaning =
        if bits.is_empty() { row.meaning.to_owned() } else { format!("{}; {}", row.meaning, bits.join("; ")) };
    Explanation {
        what: "a statusword (6041h)",
        code: Some(format!("{:04X}h", word.0)),
        name: state_name(word.state()).into(),
        meaning: meaning.into(),
        cause: row.cause.into(),
        next: row.next.into(),
        source: None,
    }
}
