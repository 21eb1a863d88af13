//! Part of a profile about a servo drive.

#[cfg(feature = "config")]
use garde::Validate;
#[cfg(feature = "config")]
use schemars::JsonSchema;
#[cfg(feature = "config")]
use serde::{Deserialize, Serialize};

use super::{Axes, Entry, Limits, PdoMap, Quantity};
#[cfg(feature = "config")]
use super::{nullable, present};
use crate::cia402::{OperationMode, State};
use crate::watchdog::Watchdog;

/// A servo drive of CiA 402.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct Servo {
    /// Axes of a device with several axes; left out if it has one.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(default, skip_serializing_if = "Option::is_none"))]
    pub axes: Option<Axes>,
    /// Its objects.
    #[cfg_attr(feature = "config", garde(dive))]
    pub objects: ServoObjects,
    /// Its PDOs in each mode that the master may use.
    #[cfg_attr(feature = "config", garde(dive))]
    pub process_data: ProcessData,
    /// States in which the mode of operation may change. The master changes it in `switch_on_disabled`.
    #[cfg_attr(feature = "config", garde(length(min = 1, max = 8)))]
    pub mode_changes_in: Vec<State>,
    /// Option codes: the drive's own reactions.
    #[cfg_attr(feature = "config", garde(dive))]
    pub option_codes: OptionCodes,
    /// Other objects that are set before it is started, in this order.
    #[cfg_attr(feature = "config", garde(length(max = 64), dive))]
    pub settings: Vec<Setting>,
    /// Limits that the drive observes. The master sets them to the limits of the rig.
    #[cfg_attr(feature = "config", garde(dive))]
    pub limits: Limits,
    /// Watchdogs with which the drive monitors its master.
    #[cfg_attr(feature = "config", garde(dive))]
    pub watchdogs: Watchdogs,
    /// Time from SYNC0 to SYNC1 on EtherCAT, us, for a drive that needs both (AssignActivate 0700h in its device description). 0
    /// to 1 000 000. Left out: only SYNC0 (0300h).
    #[cfg_attr(feature = "config", garde(range(max = 1_000_000)))]
    #[cfg_attr(feature = "config", serde(default, skip_serializing_if = "Option::is_none"))]
    pub sync1_us: Option<u32>,
    /// Homing by the drive itself. Left out if the drive has none, or if no source describes it.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(default, skip_serializing_if = "Option::is_none"))]
    pub homing: Option<Homing>,
    /// Its encoder.
    pub encoder: Encoder,
    /// The brake of its axis.
    #[cfg_attr(feature = "config", garde(dive))]
    pub brake: Brake,
}

impl Servo {
    /// Returns the object of a mapped quantity.
    pub(super) fn object(&self, quantity: Quantity) -> Option<&Entry> {
        match quantity {
            Quantity::DigitalOutputs => self.brake.of_master().map(|output| &output.value),
            quantity => self.objects.of(quantity),
        }
    }

    /// Returns the known modes as bits of 6502h: the modes of the master, and homing.
    pub fn supported_modes(&self) -> u32 {
        let homing = if self.homing.is_some() { OperationMode::Homing.supported_bit() } else { 0 };
        self.process_data.supported_modes() | homing
    }

    /// Whether the drive lacks a watchdog, as far as the profile says.
    pub fn lacks(&self, watchdog: Watchdog) -> bool {
        match watchdog {
            Watchdog::Sync => self.watchdogs.sync == SyncWatch::None,
            Watchdog::SetPoints => self.watchdogs.set_points == SetPointWatch::None,
            Watchdog::Heartbeat => self.watchdogs.heartbeat == HeartbeatWatch::None,
            // The controller has it, and the master sets it or asks for it.
            Watchdog::Outputs | Watchdog::Operational => false,
        }
    }
}

/// Objects of a servo drive. An object that the drive lacks is null.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct ServoObjects {
    /// Controlword, 16 bits: 6040h.
    #[cfg_attr(feature = "config", garde(dive))]
    pub controlword: Entry,
    /// Statusword, 16 bits: 6041h.
    #[cfg_attr(feature = "config", garde(dive))]
    pub statusword: Entry,
    /// Requested mode of operation, 8 bits: 6060h.
    #[cfg_attr(feature = "config", garde(dive))]
    pub mode_of_operation: Entry,
    /// Present mode of operation, 8 bits: 6061h.
    #[cfg_attr(feature = "config", garde(dive))]
    pub mode_display: Entry,
    /// Supported modes, 32 bits: 6502h.
    #[cfg_attr(feature = "config", garde(dive))]
    pub supported_modes: Entry,
    /// Actual position in counts, 32 bits: 6064h.
    #[cfg_attr(feature = "config", garde(dive))]
    pub position_actual: Entry,
    /// Target position in counts, 32 bits: 607Ah.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(deserialize_with = "present"), schemars(schema_with = "nullable::<Entry>"))]
    pub target_position: Option<Entry>,
    /// Target velocity in counts/s, 32 bits: 60FFh.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(deserialize_with = "present"), schemars(schema_with = "nullable::<Entry>"))]
    pub target_velocity: Option<Entry>,
    /// Target torque in per mille of the rated torque, 16 bits: 6071h.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(deserialize_with = "present"), schemars(schema_with = "nullable::<Entry>"))]
    pub target_torque: Option<Entry>,
    /// Cycle time (60C2h); null if the drive does not need it.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(
        feature = "config",
        serde(deserialize_with = "present"),
        schemars(schema_with = "nullable::<CycleTime>")
    )]
    pub cycle_time: Option<CycleTime>,
}

impl ServoObjects {
    pub(super) fn of(&self, quantity: Quantity) -> Option<&Entry> {
        match quantity {
            Quantity::Controlword => Some(&self.controlword),
            Quantity::Statusword => Some(&self.statusword),
            Quantity::PositionActual => Some(&self.position_actual),
            Quantity::TargetPosition => self.target_position.as_ref(),
            Quantity::TargetVelocity => self.target_velocity.as_ref(),
            Quantity::TargetTorque => self.target_torque.as_ref(),
            _ => None,
        }
    }
}

/// Objects that hold the cycle time.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct CycleTime {
    /// The number, 8 bits: 60C2h:1.
    #[cfg_attr(feature = "config", garde(dive))]
    pub value: Entry,
    /// Power of ten of a second, 8 bits: 60C2h:2.
    #[cfg_attr(feature = "config", garde(dive))]
    pub exponent: Entry,
}

/// PDOs of a drive in each mode that the master may use. A mode that the drive lacks is null.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct ProcessData {
    /// Largest number of objects in one PDO. 1 to 64.
    #[cfg_attr(feature = "config", garde(range(min = 1, max = 64)))]
    pub mapping_entries: u8,
    /// Cyclic synchronous torque (CST).
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(deserialize_with = "present"), schemars(schema_with = "nullable::<PdoMap>"))]
    pub torque: Option<PdoMap>,
    /// Cyclic synchronous velocity (CSV).
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(deserialize_with = "present"), schemars(schema_with = "nullable::<PdoMap>"))]
    pub velocity: Option<PdoMap>,
    /// Cyclic synchronous position (CSP).
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(deserialize_with = "present"), schemars(schema_with = "nullable::<PdoMap>"))]
    pub position: Option<PdoMap>,
}

impl ProcessData {
    /// Modes in the order of the keys, with their words and set-points.
    pub fn modes(&self) -> [(OperationMode, &'static str, Quantity, Option<&PdoMap>); 3] {
        [
            (OperationMode::CyclicTorque, "torque", Quantity::TargetTorque, self.torque.as_ref()),
            (OperationMode::CyclicVelocity, "velocity", Quantity::TargetVelocity, self.velocity.as_ref()),
            (OperationMode::CyclicPosition, "position", Quantity::TargetPosition, self.position.as_ref()),
        ]
    }

    /// PDOs in a mode.
    pub fn of(&self, mode: OperationMode) -> Option<&PdoMap> {
        self.modes().into_iter().find(|(of, ..)| *of == mode)?.3
    }

    /// Returns its modes as bits of 6502h.
    pub fn supported_modes(&self) -> u32 {
        self.modes().into_iter().filter(|mode| mode.3.is_some()).fold(0, |bits, mode| bits | mode.0.supported_bit())
    }
}

/// Option codes, which set the drive's own reactions: an object and its value each, null if the drive lacks the object.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct OptionCodes {
    /// Reaction to the loss of the master: 6007h, a stop.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(deserialize_with = "present"), schemars(schema_with = "nullable::<Setting>"))]
    pub lost_master: Option<Setting>,
    /// Reaction to a communication error: 1029h:1.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(deserialize_with = "present"), schemars(schema_with = "nullable::<Setting>"))]
    pub communication_error: Option<Setting>,
    /// Reaction to a quick stop: 605Ah, a ramp that ends in Switch On Disabled.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(deserialize_with = "present"), schemars(schema_with = "nullable::<Setting>"))]
    pub quick_stop: Option<Setting>,
}

/// An object and the value that it gets.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct Setting {
    /// The object.
    #[cfg_attr(feature = "config", garde(dive))]
    pub object: Entry,
    /// Value; a negative value is written in two's complement.
    pub value: i64,
}

impl Setting {
    /// Returns the value as the bits of the object, in the low part.
    pub fn raw(&self) -> u32 {
        (self.value as u32) & (u32::MAX >> (32 - u32::from(self.object.bits).clamp(1, 32)))
    }

    /// Whether the object can hold the value.
    pub fn fits(&self) -> bool {
        let bits = u32::from(self.object.bits).clamp(1, 32);
        (-(1i64 << (bits - 1))..1i64 << bits).contains(&self.value)
    }
}

/// Watchdogs with which a drive monitors its master. The profile does not decide which of them are sufficient.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct Watchdogs {
    /// Watchdog for the master's heartbeat.
    #[cfg_attr(feature = "config", garde(dive))]
    pub heartbeat: HeartbeatWatch,
    /// Watchdog for set-points.
    #[cfg_attr(feature = "config", garde(dive))]
    pub set_points: SetPointWatch,
    /// Watchdog for SYNC.
    #[cfg_attr(feature = "config", garde(dive))]
    pub sync: SyncWatch,
    /// Reaction on EtherCAT if the device leaves OP while it makes torque. Left out if no source gives it.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(default, skip_serializing_if = "Option::is_none"))]
    pub leaving_op: Option<LeavingOp>,
}

/// Reaction of a drive whose device leaves OP while it makes torque.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct LeavingOp {
    /// The reaction.
    pub reaction: Reaction,
    /// Its source: a key of `profile.sources`.
    #[cfg_attr(feature = "config", garde(length(min = 1)))]
    pub source: String,
}

/// Watchdog of a drive for the master's heartbeat.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"), garde(allow_unvalidated))]
pub enum HeartbeatWatch {
    /// No watchdog.
    None,
    /// Entry of 1016h, 32 bits: node id in bits 16 to 22, time in ms in the low word.
    Consumer(#[cfg_attr(feature = "config", garde(dive))] Entry),
}

/// Watchdog of a drive for set-points.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case", deny_unknown_fields), garde(allow_unvalidated))]
pub enum SetPointWatch {
    /// No watchdog.
    None,
    /// Built-in watchdog, with a limit in interpolation periods.
    BuiltIn(#[cfg_attr(feature = "config", garde(dive))] BuiltInWatch),
    /// Event timer of each RPDO, 14xxh:5.
    EventTimer {
        /// Reaction of the drive.
        reaction: Reaction,
        /// Source: a key of `profile.sources`.
        #[cfg_attr(feature = "config", garde(length(min = 1)))]
        source: String,
    },
    /// Object that holds the longest time.
    Object(#[cfg_attr(feature = "config", garde(dive))] TimedObject),
}

/// Watchdog of a drive for SYNC.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"), garde(allow_unvalidated))]
pub enum SyncWatch {
    /// No watchdog.
    None,
    /// Built-in watchdog, with a limit in interpolation periods.
    BuiltIn(#[cfg_attr(feature = "config", garde(dive))] BuiltInWatch),
    /// Object that holds the longest time.
    Object(#[cfg_attr(feature = "config", garde(dive))] TimedObject),
}

/// A watchdog that is built into the drive.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct BuiltInWatch {
    /// Number of interpolation periods, 1 to 1000; null if no source gives it.
    #[cfg_attr(feature = "config", garde(range(min = 1, max = 1000)))]
    #[cfg_attr(feature = "config", serde(deserialize_with = "present"), schemars(schema_with = "nullable::<u32>"))]
    pub periods: Option<u32>,
    /// Reaction of the drive.
    pub reaction: Reaction,
    /// Source: a key of `profile.sources`.
    #[cfg_attr(feature = "config", garde(length(min = 1)))]
    pub source: String,
}

/// An object that holds the longest time without a message.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct TimedObject {
    /// The object.
    #[cfg_attr(feature = "config", garde(dive))]
    pub object: Entry,
    /// Unit of the time.
    #[cfg_attr(feature = "config", garde(dive))]
    pub unit: TimeUnit,
    /// Reaction of the drive.
    pub reaction: Reaction,
}

/// Unit of a time in an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"), garde(allow_unvalidated))]
pub enum TimeUnit {
    /// Microseconds per unit. 1 to 1 000 000.
    Us(#[cfg_attr(feature = "config", garde(range(min = 1, max = 1_000_000)))] u32),
    /// Interpolation periods.
    Cycles,
}

/// Reaction of a drive when a monitored message is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"))]
pub enum Reaction {
    /// No reaction except a report.
    Nothing,
    /// Reaction in 6007h.
    AbortConnection,
    /// Fault, with the reaction in 605Eh.
    Fault,
    /// No source gives the reaction. The program assumes none until the drill has shown it.
    Unknown,
}

/// Homing by the drive itself: the homing mode of CiA 402.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct Homing {
    /// Homing method, 8 bits: 6098h.
    #[cfg_attr(feature = "config", garde(dive))]
    pub method: Entry,
    /// Speed during the search for a switch in counts/s, 32 bits: 6099h:1.
    #[cfg_attr(feature = "config", garde(dive))]
    pub switch_speed: Entry,
    /// Speed during the search for zero in counts/s, 32 bits: 6099h:2.
    #[cfg_attr(feature = "config", garde(dive))]
    pub zero_speed: Entry,
    /// Acceleration in counts/s^2, 32 bits: 609Ah.
    #[cfg_attr(feature = "config", garde(dive))]
    pub acceleration: Entry,
    /// Home offset in counts, 32 bits: 607Ch.
    #[cfg_attr(feature = "config", garde(dive))]
    pub offset: Entry,
    /// Position (6064h) at home after homing.
    pub position_at_home: PositionAtHome,
    /// Homing methods that the drive has: numbers in 6098h.
    #[cfg_attr(feature = "config", garde(length(min = 1, max = 64)))]
    pub methods: Vec<i8>,
    /// Bit of the statusword, 8, 14 or 15, that reports in every mode that the position refers to home; null if there is no such
    /// bit.
    #[cfg_attr(feature = "config", serde(deserialize_with = "present"), schemars(schema_with = "nullable::<u8>"))]
    pub referenced_bit: Option<u8>,
}

impl Homing {
    /// Returns the home offset that makes the position `counts` at home.
    pub fn offset_for(&self, counts: i32) -> i32 {
        match self.position_at_home {
            PositionAtHome::Offset => counts,
            PositionAtHome::NegativeOffset => counts.wrapping_neg(),
        }
    }

    /// Whether a statusword reports that the position refers to home; never without such a bit.
    ///
    /// Real-time: yes.
    pub fn is_referenced(&self, statusword: u16) -> bool {
        self.referenced_bit.is_some_and(|bit| statusword >> bit.min(15) & 1 == 1)
    }
}

/// Position of a drive at home.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"))]
pub enum PositionAtHome {
    /// The home offset.
    Offset,
    /// The negative home offset: zero lies beyond home by the home offset.
    NegativeOffset,
}

/// The encoder of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields))]
pub struct Encoder {
    /// Kind of the encoder: how much it knows at power-on.
    pub kind: EncoderKind,
    /// Side on which it is mounted.
    pub side: EncoderSide,
}

/// Kind of an encoder: how much it knows at power-on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"))]
pub enum EncoderKind {
    /// It knows nothing: it counts from its power-on position.
    Incremental,
    /// It knows the angle within one of its turns.
    SingleTurn,
    /// It knows the angle, turns included.
    MultiTurn,
    /// The kind depends on the motor.
    Unknown,
}

/// Side on which an encoder is mounted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"))]
pub enum EncoderSide {
    /// The motor, before the gear.
    Motor,
    /// The joint, behind the gear.
    Joint,
    /// The side depends on the machine.
    Unknown,
}

/// The brake of an axis.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct Brake {
    /// Owner of the brake: it opens and closes the brake.
    pub held_by: BrakeHolder,
    /// Output with which the master opens and closes the brake; left out otherwise.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(default, skip_serializing_if = "Option::is_none"))]
    pub output: Option<BrakeOutput>,
}

impl Brake {
    /// Returns the output, if the master opens and closes the brake.
    pub fn of_master(&self) -> Option<&BrakeOutput> {
        self.output.as_ref().filter(|_| self.held_by == BrakeHolder::Output)
    }
}

/// A digital output of a drive that holds the brake of its axis.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct BrakeOutput {
    /// Digital outputs, 32 bits: 60FEh:1. Process data carry them, as `digital_outputs`.
    #[cfg_attr(feature = "config", garde(dive))]
    pub value: Entry,
    /// Outputs that the object sets, 32 bits: 60FEh:2. The boot writes it.
    #[cfg_attr(feature = "config", garde(dive))]
    pub mask: Entry,
    /// Bit of the brake, 0 to 31; in CiA 402 it is bit 0.
    #[cfg_attr(feature = "config", garde(range(max = 31)))]
    pub bit: u8,
    /// State of the bit that closes the brake: set, as in CiA 402, or cleared.
    pub closed_if: BitState,
    /// Closing time of the brake, ms. 0 to 500. At a stop of the rig the torque stays on for this time.
    #[cfg_attr(feature = "config", garde(range(max = 500)))]
    pub closes_in_ms: u32,
}

impl BrakeOutput {
    /// Returns the value of the mask.
    pub const fn mask_word(&self) -> u32 {
        1 << if self.bit < 32 { self.bit } else { 31 }
    }

    /// Returns the value of the outputs with the brake released or closed.
    pub fn word(&self, is_released: bool) -> u32 {
        let is_set = is_released != (self.closed_if == BitState::Set);
        if is_set { self.mask_word() } else { 0 }
    }

    /// Whether the brake is closed with these outputs and this mask. If the mask leaves it out, it is closed, as without current.
    pub fn is_closed(&self, value: u32, mask: u32) -> bool {
        mask & self.mask_word() == 0 || (value & self.mask_word() != 0) == (self.closed_if == BitState::Set)
    }
}

/// State of a bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"))]
pub enum BitState {
    /// 1.
    Set,
    /// 0.
    Cleared,
}

/// Owner of a brake: it opens and closes the brake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"))]
pub enum BrakeHolder {
    /// There is no brake, or nothing opens and closes it.
    None,
    /// The drive, in Operation Enabled.
    Drive,
    /// The master, with a digital output of the drive (60FEh).
    Output,
    /// No source names the owner.
    Unknown,
}
