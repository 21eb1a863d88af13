//! Parts of a rig that only a simulation needs.

use garde::Validate;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::arm::ArmModel;
use super::profile::{Fitting, ProfileName};
use super::rig::NamedProfile;
use crate::number::{NotNegative, Positive};

/// Machine model and scene of the simulation of a rig. A real bus uses nothing of it.
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
    /// Model of both simulated drives, if it differs from the rig's profiles: another device model, or odd behaviour. Left out:
    /// the rig's profiles.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drive_model: Option<DriveModel>,
    /// Oddities of simulated EtherCAT devices, and devices that the rig does not have. Left out: none.
    #[garde(length(max = 16), dive)]
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub segment: Vec<SegmentDevice>,
    /// File with the scene to run, relative to this file.
    #[garde(length(min = 1))]
    pub scene: String,
}

/// A simulated drive: its device model, and odd behaviour that no profile describes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct DriveModel {
    /// Device model of both drives, whatever model the rig expects.
    pub profile: ProfileName,
    /// Whether bytes of an RPDO can be skipped by dummy entries (0005h and the like).
    pub has_dummies: bool,
    /// Whether the drive refuses a mode (6060h) with 08000022h in a state in which the mode cannot change. Otherwise it takes the
    /// mode over later.
    pub refuses_mode: bool,
    /// Behaviour of its SDO server.
    #[garde(dive)]
    pub sdo_server: SdoServer,
    /// Objects that differ from CiA 402, on CAN and on EtherCAT.
    #[garde(length(max = 64), dive)]
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub objects: Vec<OddObject>,
    /// Error code of the Fault state in which both drives are from power-on. Only a fault reset ends it; a reset of the node does
    /// not. Left out: no fault.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub fault_code: u16,
    /// Time from a start until the power stages have voltage, ms. 0 to 60 000. Each drive sends the emergency 3220h at its start,
    /// and withdraws it (0000h) after this time. Left out: voltage from the start.
    #[garde(range(max = 60_000))]
    #[serde(default, skip_serializing_if = "is_zero")]
    pub supply_ms: u32,
}

/// An object of a simulated drive that differs from CiA 402.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct OddObject {
    /// Index of the object.
    pub index: u16,
    /// Sub-index of the object. Left out: all sub-indices of the index.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sub: Option<u8>,
    /// Whether the drive lacks the object.
    #[serde(default, skip_serializing_if = "is_false")]
    pub absent: bool,
    /// Whether the drive refuses a write with 06010002h.
    #[serde(default, skip_serializing_if = "is_false")]
    pub read_only: bool,
    /// Value at power-on, if it differs from the usual one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub holds: Option<i64>,
    /// Bits that are set at power-on, and that every write must contain; the drive refuses others with 06090030h.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub needed_bits: u32,
    /// Time from a write request to its answer on CAN, ms. 0 to 60 000; 0 for the time of all other objects.
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

/// Oddities of a simulated device on EtherCAT, or a device that the rig does not have.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct SegmentDevice {
    /// Position in the segment, 0 next to the master. 0 to 63. A position that the rig does not use gets a device without
    /// objects.
    #[garde(range(max = 63))]
    pub position: u16,
    /// SII image in hexadecimal digits, separated by blanks. FFh fills the rest up to the size in word 3Eh. Left out: an image
    /// made from its objects; for a device without objects an empty chip.
    #[garde(inner(length(max = 400_000), custom(check_digits)))]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sii: Option<String>,
    /// Reaction to a request for SDO information. Left out: an answer.
    #[serde(default, skip_serializing_if = "is_answered")]
    pub sdo_information: SdoInformation,
    /// Counter in all its mailbox messages. 0 to 7. Left out: a count from 1 to 7.
    #[garde(inner(range(max = 7)))]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mailbox_counter: Option<u8>,
    /// Bits of AL status (0130h) that are always set, of bit 5 and above. Left out: 0.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub al_status_bits: u16,
    /// Whether the cable from the master is plugged into its output. Left out: into its input.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub is_turned: bool,
}

/// Reaction to a request for SDO information.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SdoInformation {
    /// The device answers it.
    #[default]
    Answered,
    /// The device drops it.
    Unanswered,
    /// The device answers with an SDO abort.
    Aborted,
    /// The device answers with a mailbox error.
    MailboxError,
}

fn is_answered(information: &SdoInformation) -> bool {
    *information == SdoInformation::Answered
}

/// Checks that a text has two hexadecimal digits per byte.
fn check_digits(text: &str, (): &()) -> garde::Result {
    match digits(text).map(|digits| digits.len() % 2) {
        Some(0) => Ok(()),
        _ => Err(garde::Error::new("is not two hexadecimal digits for each byte")),
    }
}

/// Returns the digits of a text that has nothing but digits and blanks.
fn digits(text: &str) -> Option<Vec<u8>> {
    let digits = text.chars().filter(|one| !one.is_whitespace());
    digits.map(|one| one.to_digit(16).map(|digit| digit as u8)).collect()
}

impl SegmentDevice {
    /// Returns its SII image, if it has its own.
    pub fn image(&self) -> Option<Vec<u8>> {
        let digits = digits(self.sii.as_ref()?)?;
        let (pairs, _) = digits.as_chunks::<2>();
        Some(pairs.iter().map(|[high, low]| high << 4 | low).collect())
    }
}

/// Behaviour of the SDO server of a simulated drive.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct SdoServer {
    /// Time from a request to the answer, ms. 0 to 1000.
    #[garde(range(max = 1000))]
    pub answer_ms: u32,
    /// Whether the server sends every value in segments, even values of 4 bytes and less, and refuses block transfers.
    pub segments_only: bool,
    /// Objects that are sent with a length that does not fit their type.
    #[garde(length(max = 64), dive)]
    pub lengths: Vec<SentLength>,
}

/// An object that is sent with a length that does not fit its type.
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

/// Error: the file of a rig that should be simulated names no simulation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("the rig has no `simulation`, which only a rig on a real bus does without")]
pub struct NotSimulated;

impl Simulation {
    /// Replaces the file name of a device profile.
    pub fn rename_profile_files(&mut self, renamed: impl Fn(&str) -> String) {
        for (_, name, _) in self.profiles_mut().into_iter().filter(|(_, name, _)| name.is_file()) {
            name.rename(renamed(name.as_str()));
        }
    }

    /// Returns the device model that it names.
    pub(crate) fn profiles_mut(&mut self) -> Vec<NamedProfile<'_>> {
        let model = self.drive_model.as_mut();
        model.map(|model| ("drive_model.profile", &mut model.profile, Fitting::SERVO)).into_iter().collect()
    }
}

/// The schema of a simulation in a rig: the document itself, its file, or nothing.
pub(super) fn named_simulation(generator: &mut SchemaGenerator) -> Schema {
    let whole = generator.subschema_for::<Simulation>();
    json_schema!({ "anyOf": [{ "type": "string", "minLength": 1 }, whole, { "type": "null" }] })
}

/// Timing of frames in the embedded simulation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BusTiming {
    /// Bits take time, and priorities decide which frame waits.
    Arbitrated,
    /// Frames arrive at once.
    Ideal,
}

/// The loop closed inside each drive in position and velocity mode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct DrivePositionLoop {
    /// Period of the loop, us; the control period is a whole multiple of it. 10 to 10 000.
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
