//! The first message to a client: the machine, its fixture, the fields of its records.

use std::collections::BTreeMap;

use serde::Serialize;
use yieldwall_motion::guard::fault::{FaultRow, Step, TABLE};
use yieldwall_record::recording::{FieldLayout, Layout};

/// Version of the messages.
const PROTOCOL: u32 = 1;

/// Description of the machine that the page shows. The server adds the layout of the records and the list of recordings.
///
/// Lengths are in m in the base frame, forces in N. JSON has no infinite numbers; such a number arrives as `null`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Hello {
    /// Name and version of the program: the words `yieldwall` and 0.1.0.
    pub program: String,
    /// Name of the command that serves the page.
    pub command: &'static str,
    /// Tier of real time that this computer has proved for the rig, or why it needs none; `None` if it is not known.
    pub tier: Option<String>,
    /// The rig that runs, or the machine of the first recording.
    #[serde(flatten)]
    pub machine: Description,
    /// Words for each fault by its name, as [`faults`] returns them.
    pub faults: BTreeMap<String, FaultWords>,
    /// Controls of the page; `None` on a read-only page.
    pub play: Option<Play>,
}

/// Controls of a page that takes orders.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Play {
    /// Numbers, each with its range.
    pub settings: Vec<Setting>,
    /// Laws of the fixture to choose from.
    pub laws: Vec<Choice>,
    /// Key of the law that acts.
    pub law: &'static str,
    /// Faults that can be injected.
    pub faults: Vec<Injectable>,
}

/// A number that a person can change.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Setting {
    /// Key in [`Order::Set`](crate::Order::Set).
    pub key: &'static str,
    /// Name with the symbol, such as `yield force R`.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// Least value.
    pub least: f64,
    /// Greatest value.
    pub most: f64,
    /// Step from one value to the next.
    pub step: f64,
    /// Present value.
    pub value: f64,
}

/// Entry of a list to choose from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Choice {
    /// Key in [`Order::Law`](crate::Order::Law).
    pub key: &'static str,
    /// Name for people.
    pub name: &'static str,
}

/// A fault that can be injected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Injectable {
    /// Name in [`Order::Fault`](crate::Order::Fault).
    pub name: &'static str,
    /// Effect in one sentence.
    pub meaning: &'static str,
}

/// Description of a rig or of an impedance device with its fixture.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Description {
    /// Name.
    pub name: String,
    /// Period of the cycle in s.
    pub period_s: f64,
    /// Dimensions of the five-bar arm; `None` for an impedance device.
    pub arm: Option<Arm>,
    /// Surfaces of the fixture at their first place.
    pub surfaces: Vec<Surface>,
    /// Part of the plane to show: least x, least y, greatest x, greatest y.
    pub view_m: [f64; 4],
    /// Law and parameters of the fixture.
    pub fixture: Fixture,
}

/// Dimensions of a five-bar arm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Arm {
    /// Axes of the left and the right motor, each x and y.
    pub bases_m: [[f64; 2]; 2],
    /// Lengths of the proximal links, left and right.
    pub proximal_m: [f64; 2],
    /// Lengths of the distal links, left and right.
    pub distal_m: [f64; 2],
    /// Least distance from any singularity at which the guard lets the rig run.
    pub singularity_margin_m: Option<f64>,
    /// The tool.
    pub tool: Tool,
}

/// Place of a tool on an arm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Tool {
    /// Chain whose distal link carries it: `left` or `right`.
    pub fixed_to: &'static str,
    /// Offset from the wrist along that link, away from its elbow.
    pub along_m: f64,
    /// Offset from the wrist to the left of that direction.
    pub across_m: f64,
}

/// A surface as a polyline.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Surface {
    /// Corners, each x and y.
    pub points_m: Vec<[f64; 2]>,
    /// Whether the last corner joins the first.
    pub is_closed: bool,
    /// Forbidden side, as seen from a walk along the corners.
    pub forbidden: Forbidden,
}

/// Forbidden side of a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Forbidden {
    /// The left side.
    Left,
    /// The right side.
    Right,
    /// Neither side: a guide.
    None,
}

/// Law and parameters of a fixture.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Fixture {
    /// Law, such as `plastic`, `elastic`, `viscous` or `none`.
    pub law: String,
    /// Yield force R in N; `None` for a law without one.
    pub yield_force_n: Option<f64>,
    /// All parameters: name and value as text, such as `Yield force R` and `20 N`.
    pub rows: Vec<(String, String)>,
}

/// Words for a fault.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FaultWords {
    /// Meaning of the fault.
    pub meaning: String,
    /// Each reaction with its rate, its bound and the state in which the rig ends.
    pub reaction: String,
    /// Advice for the person at the rig.
    pub next: String,
}

/// Returns the words of `docs/faults.md` for every fault, by the names that `cause` has in records.
pub fn faults() -> BTreeMap<String, FaultWords> {
    let words = |row: &FaultRow| {
        let step = |step: &Step| {
            let Step { reaction, bound, .. } = *step;
            let (rate, state) = (row.rate_in_words(step), row.final_state(reaction));
            format!("{rate}: {reaction} within {bound}, ends in {state:?}")
        };
        let reaction = row.steps.iter().map(step).collect::<Vec<_>>().join("; ");
        (row.name.to_owned(), FaultWords { meaning: row.meaning.into(), reaction, next: row.next.into() })
    };
    TABLE.iter().map(words).collect()
}

/// The first message as JSON.
#[derive(Serialize)]
struct FirstMessage<'a> {
    kind: &'static str,
    protocol: u32,
    is_live: bool,
    record: RecordMessage<'a>,
    recordings: &'a [RecordingMessage<'a>],
    #[serde(flatten)]
    hello: &'a Hello,
}

#[derive(Serialize)]
struct RecordMessage<'a> {
    bytes: usize,
    fields: Vec<FieldMessage<'a>>,
}

#[derive(Serialize)]
struct FieldMessage<'a> {
    name: &'a str,
    unit: &'a str,
    meaning: &'a str,
    r#type: &'a str,
    offset: usize,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    codes: BTreeMap<&'a str, u64>,
}

/// A recording in the first message.
#[derive(Serialize)]
pub(crate) struct RecordingMessage<'a> {
    pub(crate) name: String,
    pub(crate) records: u64,
    pub(crate) machine: &'a Description,
}

impl Hello {
    /// Returns the first message. `recordings` is `None` while a rig runs.
    pub(crate) fn first_message(
        &self,
        layout: &Layout,
        recordings: Option<&[RecordingMessage<'_>]>,
    ) -> Result<String, serde_json::Error> {
        let field = |field| {
            let &FieldLayout { name, unit, meaning, type_name, offset, ref codes, .. } = field;
            let codes = codes.iter().map(|(name, number)| (name.as_str(), *number)).collect();
            FieldMessage { name, unit, meaning, r#type: type_name, offset, codes }
        };
        serde_json::to_string(&FirstMessage {
            kind: "hello",
            protocol: PROTOCOL,
            is_live: recordings.is_none(),
            record: RecordMessage { bytes: layout.stride, fields: layout.fields.iter().map(field).collect() },
            recordings: recordings.unwrap_or_default(),
            hello: self,
        })
    }
}
