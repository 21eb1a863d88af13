//! What the simulation of a rig needs and a real bus does not.

use garde::Validate;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use thiserror::Error;
use yieldwall_drives::profiles::Role;

use super::arm::ArmModel;
use super::profile::ProfileName;
use super::rig::NamedProfile;
use crate::number::{NotNegative, Positive};

/// What the simulation of a rig takes the machine to be, and what happens in it. Nothing of it is used on a real bus.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Simulation {
    /// How frames are timed on the buses.
    pub timing: BusTiming,
    /// Inertia and friction of the arm.
    #[garde(dive)]
    pub arm: ArmModel,
    /// The loop closed inside each drive in position and velocity mode.
    #[garde(dive)]
    pub drive_position_loop: DrivePositionLoop,
    /// What both simulated drives are, if they are not what the rig's profiles say: of another model, or odd. Left out: by the
    /// rig's profiles.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drive_model: Option<DriveModel>,
    /// Devices on an EtherCAT segment that are odd, and devices beside those of the rig. Left out: none.
    #[garde(length(max = 16), dive)]
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub segment: Vec<SegmentDevice>,
    /// File with the scene to run, relative to this file.
    #[garde(length(min = 1))]
    pub scene: String,
}

/// What a simulated drive is: the model, and what it does in a manner of its own, which no profile says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct DriveModel {
    /// The device model of both drives, whatever the rig takes them for.
    pub profile: ProfileName,
    /// Whether bytes of an RPDO can be skipped by dummy entries (0005h and the like).
    pub has_dummies: bool,
    /// Whether a mode (6060h) is refused with 08000022h in a state in which it cannot change; it is taken over later otherwise.
    pub refuses_mode: bool,
    /// How it answers over SDO.
    #[garde(dive)]
    pub sdo_server: SdoServer,
    /// Objects that are otherwise than those of CiA 402, on CAN and on EtherCAT.
    #[garde(length(max = 64), dive)]
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub objects: Vec<OddObject>,
    /// Error code of the Fault in which both drives are from power-on until a fault reset, whatever resets the node. Left out: they are in none.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub fault_code: u16,
    /// Time from a start until the power stages have voltage, ms: each drive sends the emergency 3220h at its start, and withdraws it then (0000h). 0 to
    /// 60 000. Left out: they have it at once.
    #[garde(range(max = 60_000))]
    #[serde(default, skip_serializing_if = "is_zero")]
    pub supply_ms: u32,
}

/// An object of a simulated drive that is otherwise than that of CiA 402.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct OddObject {
    /// Index of the object.
    pub index: u16,
    /// Its sub-index; left out for all that the index has.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sub: Option<u8>,
    /// Whether the drive does not have it.
    #[serde(default, skip_serializing_if = "is_false")]
    pub absent: bool,
    /// Whether a write is refused with 06010002h.
    #[serde(default, skip_serializing_if = "is_false")]
    pub read_only: bool,
    /// Its value at power-on, if it is another one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub holds: Option<i64>,
    /// Bits that are set at power-on, and without which a write is refused with 06090030h.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub needed_bits: u32,
    /// Time from the request of a write to its answer on CAN, ms; 0 for that of all objects. 0 to 60 000.
    #[garde(range(max = 60_000))]
    #[serde(default, skip_serializing_if = "is_zero")]
    pub write_ms: u32,
}

fn is_false(value: &bool) -> bool {
    !value
}

fn is_zero<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// Oddities of a simulated device on EtherCAT, or a device beside those of the rig.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct SegmentDevice {
    /// Its position in the segment, 0 at the master. Where the rig has no device it is one without
    /// objects. 0 to 63.
    #[garde(range(max = 63))]
    pub position: u16,
    /// Its SII image in hexadecimal digits, with blanks between them; FFh follows up to the size that word 3Eh says. Left
    /// out: the one that its objects make, and of a device without objects an empty chip.
    #[garde(inner(length(max = 400_000), custom(check_digits)))]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sii: Option<String>,
    /// Answer to a request for SDO information. Left out: it is answered.
    #[serde(default, skip_serializing_if = "is_answered")]
    pub sdo_information: SdoInformation,
    /// Counter of all its mailbox messages. 0 to 7. Left out: it counts from 1 to 7.
    #[garde(inner(range(max = 7)))]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mailbox_counter: Option<u8>,
    /// Bits of AL status (0130h) that are always set, of bit 5 and above. Left out: 0.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub al_status_bits: u16,
    /// Whether the cable from the master is in its output. Left out: it is in its input.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub is_turned: bool,
}

/// Answer to a request for SDO information.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SdoInformation {
    /// It is answered.
    #[default]
    Answered,
    /// It is dropped.
    Unanswered,
    /// An SDO abort answers it.
    Aborted,
    /// A mailbox error answers it.
    MailboxError,
}

fn is_answered(information: &SdoInformation) -> bool {
    *information == SdoInformation::Answered
}

/// Two hexadecimal digits a byte.
fn check_digits(text: &str, (): &()) -> garde::Result {
    match digits(text).map(|digits| digits.len() % 2) {
        Some(0) => Ok(()),
        _ => Err(garde::Error::new("is not two hexadecimal digits for each byte")),
    }
}

/// The digits of a text that has nothing else but blanks.
fn digits(text: &str) -> Option<Vec<u8>> {
    let digits = text.chars().filter(|one| !one.is_whitespace());
    digits.map(|one| one.to_digit(16).map(|digit| digit as u8)).collect()
}

impl SegmentDevice {
    /// Its SII image, if it has one of its own.
    pub fn image(&self) -> Option<Vec<u8>> {
        let digits = digits(self.sii.as_ref()?)?;
        let (pairs, _) = digits.as_chunks::<2>();
        Some(pairs.iter().map(|[high, low]| high << 4 | low).collect())
    }
}

/// How a simulated drive answers over SDO.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct SdoServer {
    /// Time from a request to what answers it, ms. 0 to 1000.
    #[garde(range(max = 1000))]
    pub answer_ms: u32,
    /// Whether every value comes in segments, those of 4 bytes and less too, and blocks are refused.
    pub segments_only: bool,
    /// Objects that are sent with another length than that of their type.
    #[garde(length(max = 64), dive)]
    pub lengths: Vec<SentLength>,
}

/// An object that is sent with another length than that of its type.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct SentLength {
    /// Index of the object.
    pub index: u16,
    /// Its sub-index.
    pub sub: u8,
    /// Bytes that are sent. 1 to 8.
    #[garde(range(min = 1, max = 8))]
    pub bytes: u8,
}

/// A rig was to be simulated, and its file names no simulation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("the rig has no `simulation`, which only a rig on a real bus does without")]
pub struct NotSimulated;

impl Simulation {
    /// Gives the file of a device profile the name that it has elsewhere.
    pub fn rename_profile_files(&mut self, renamed: impl Fn(&str) -> String) {
        for (_, name, _) in self.profiles_mut().into_iter().filter(|(_, name, _)| name.is_file()) {
            name.rename(renamed(name.as_str()));
        }
    }

    /// The device model that it names.
    pub(crate) fn profiles_mut(&mut self) -> Vec<NamedProfile<'_>> {
        let is_servo: fn(&Role) -> bool = |role| matches!(role, Role::Servo(_));
        let model = self.drive_model.as_mut();
        model.map(|model| ("drive_model.profile", &mut model.profile, is_servo)).into_iter().collect()
    }
}

/// The schema of a simulation in a rig: the document itself, its file, or nothing.
pub(super) fn named_simulation(generator: &mut SchemaGenerator) -> Schema {
    let whole = generator.subschema_for::<Simulation>();
    json_schema!({ "anyOf": [{ "type": "string", "minLength": 1 }, whole, { "type": "null" }] })
}

/// How the embedded simulation times frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BusTiming {
    /// Bits cost time and priorities decide who waits.
    Arbitrated,
    /// Frames arrive at once.
    Ideal,
}

/// The loop closed inside each drive in position and velocity mode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct DrivePositionLoop {
    /// Its period, us; the control period is a whole multiple of it. 10 to 10 000.
    #[garde(range(min = 10, max = 10_000))]
    pub period_us: u32,
    /// Position gain, N m/rad. Above 0.
    #[garde(dive)]
    pub stiffness_n_m_per_rad: Positive,
    /// Velocity gain, N m s/rad. 0 or above.
    #[garde(dive)]
    pub damping_n_m_s_per_rad: NotNegative,
    /// Integral gain, N m/(rad s). 0 or above.
    #[garde(dive)]
    pub integral_n_m_per_rad_s: NotNegative,
}
