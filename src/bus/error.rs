//! Why the network did not come up.

use std::fmt;

use thiserror::Error;

use super::ethercat::SegmentFailure;
use super::signs::HeardFrame;
use yieldwall_fieldbus::canopen::{Emergency, NmtState, NodeSet};
use yieldwall_fieldbus::objects::AbortCode;

/// Last messages of a node since the boot began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Said {
    /// The state in its last heartbeat; [`NmtState::Initialising`] for its boot-up message.
    pub state: Option<NmtState>,
    /// Its last emergency.
    pub emergency: Option<Emergency>,
}

impl Said {
    /// Whether nothing came after its boot-up message, of a node whose heartbeat period (1017h) the boot has set.
    pub fn sends_no_heartbeat(&self) -> bool {
        self.state == Some(NmtState::Initialising)
    }
}

impl fmt::Display for Said {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.state {
            None => write!(out, "; nothing was heard of it")?,
            Some(NmtState::Initialising) => write!(out, "; its last word was its boot-up message")?,
            Some(NmtState::PreOperational) => write!(out, "; its last heartbeat says Pre-operational")?,
            Some(state) => write!(out, "; its last heartbeat says {state:?}")?,
        }
        self.emergency.map_or(Ok(()), |emergency| write!(out, "; its last emergency is {}", emergency.code))
    }
}

/// Nodes heard since the reset on the bus of a silent node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Others {
    /// Nodes of the rig that have announced themselves.
    pub answered: NodeSet,
    /// Nodes that the rig does not have.
    pub strangers: NodeSet,
}

/// `1, 2 and 10 answered; 11, which the rig does not have, was heard`.
impl fmt::Display for Others {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.answered.is_empty() {
            true => write!(out, "no other node of its bus answered")?,
            false => write!(out, "{} answered", self.answered)?,
        }
        match self.strangers.len() {
            0 => Ok(()),
            1 => write!(out, "; {}, which the rig does not have, was heard", self.strangers),
            _ => write!(out, "; {}, which the rig does not have, were heard", self.strangers),
        }
    }
}

/// Failure of one step of the boot.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum BootFailure {
    /// Somebody else is the master of a bus. Nothing more is sent.
    #[error("{}: heard {heard}", if *.has_sent {
        "another master began at the same moment; nothing was enabled"
    } else {
        "a master is on this bus; nothing was sent"
    })]
    OtherMaster {
        /// The frame that shows it, with its bus.
        heard: HeardFrame,
        /// Whether this master had sent something before.
        has_sent: bool,
    },
    /// A sensor on plain CAN did not begin to send samples.
    #[error("no whole sample within {waited_ms} ms")]
    NoSample {
        /// How long the master waited, in ms.
        waited_ms: u64,
    },
    /// A sensor on plain CAN uses an identifier of something else.
    #[error("identifier {id:03X}h has another use on this bus")]
    Identifier {
        /// The identifier.
        id: u16,
    },
    /// The node did not announce itself after the reset.
    #[error(
        "no boot-up message within {waited_ms} ms after the reset{}{said}",
        if *.is_unheard { "; the interface is error-passive: nobody acknowledges its frames" } else { "" }
    )]
    Missing {
        /// How long the master waited, in ms.
        waited_ms: u64,
        /// Whether the interface reported bus-off, or that nobody acknowledges its frames.
        is_unheard: bool,
        /// Messages of the node in the meantime.
        said: Said,
        /// Other nodes heard on its bus.
        others: Box<Others>,
    },
    /// The node did not become Operational after the start command.
    #[error(
        "not Operational within {waited_ms} ms after the start command{said}{}",
        if said.sends_no_heartbeat() { "; object 1017h was set, and no heartbeat came" } else { "" }
    )]
    NotStarted {
        /// How long the master waited, in ms.
        waited_ms: u64,
        /// Last messages of the node.
        said: Said,
    },
    /// The node restarted, so that its configuration is lost.
    #[error("the node restarted {times} times while it was configured and started, or two nodes have its node id")]
    Restarted {
        /// How often.
        times: u8,
    },
    /// The node did not answer.
    #[error("no answer from object {index:04X}h:{sub}")]
    NoAnswer {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
    },
    /// The node refused.
    #[error("object {index:04X}h:{sub} refused: {code}")]
    Refused {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// The abort code.
        code: AbortCode,
    },
    /// The node keeps what an object holds, and refuses what is wanted.
    #[error(
        "object {index:04X}h:{sub} holds {held:#x} and does not take {wanted:#x}: {code}; {}",
        advice(*.index)
    )]
    Keeps {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Value in the object.
        held: u32,
        /// Value written.
        wanted: u32,
        /// The abort code.
        code: AbortCode,
    },
    /// The motor's rated current is 0, so that a torque limit has no value in its unit.
    #[error("object {index:04X}h:{sub} holds 0 as the rated current: enter the motor's data by the maker's tool")]
    NoRating {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
    },
    /// The torque limit that a drive keeps by itself allows more than the rig.
    #[error(
        "object {index:04X}h:{sub} holds a torque limit of {held}, and the rig allows {most}: lower it with the vendor's tool and \
         store it, or raise `guard.torque_limit_n_m`"
    )]
    KeepsMore {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Value in the object.
        held: u32,
        /// The most that the rig allows.
        most: u32,
    },
    /// A force sensor has other counts per unit than the rig.
    #[error(
        "object {index:04X}h:{sub} holds {counts} counts per unit, and `sensor.calibration` has {wanted}: calibrate for {counts}, or \
         set the unit with the vendor's tool"
    )]
    Scaling {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Counts per unit that the sensor reports.
        counts: u32,
        /// Counts per unit that the rig uses.
        wanted: u32,
    },
    /// The power of ten of the cycle time cannot be changed, and the cycle time is no multiple of it.
    #[error(
        "object {index:04X}h:{sub} holds {exponent} and takes no other power of ten of a second: {code}. `cycle.period_us` of \
         {period_us} has to be 1 to 255 times 10^{exponent} s"
    )]
    FixedExponent {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// The cycle time in us.
        period_us: u32,
        /// The power of ten that it holds.
        exponent: i8,
        /// The abort code.
        code: AbortCode,
    },
    /// In SAFE-OP a device on EtherCAT is synchronised in another way than the rig says.
    #[error(
        "object {index:04X}h:{sub} is {received} ({}) in SAFE-OP, and the rig needs {wanted} ({}): set it with the vendor's tool, or \
         give the rig's bus the `outputs` of the device",
        synchronisation(*.received),
        synchronisation(*.wanted)
    )]
    Synchronisation {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// The type of synchronisation that the rig wants.
        wanted: u32,
        /// The type of synchronisation that the device is in.
        received: u32,
    },
    /// An object that says what the device is has another value than the profile.
    #[error("object {index:04X}h:{sub} is {received:#x}, and the profile says {expected}")]
    Identity {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Value in the profile.
        expected: Box<str>,
        /// The device's value.
        received: u32,
    },
    /// The drive does not report how many increments its encoder has.
    #[error(
        "its encoder has {increments} increments in {revolutions} revolutions (608Fh), which gives no speed limit in r/min \
         (6080h); set the encoder's resolution in the drive"
    )]
    Resolution {
        /// 608Fh:1.
        increments: u32,
        /// 608Fh:2.
        revolutions: u32,
    },
    /// An object does not hold what was written to it.
    #[error("object {index:04X}h:{sub} was set to {written:#x} and reads back {received:#x}")]
    ReadBack {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Value written.
        written: u32,
        /// Value read back.
        received: u32,
    },
    /// The drive is not in the commanded mode of operation.
    #[error("the drive is in mode {} (6061h), not in the commanded mode {wanted} (6060h)", *.received as u8 as i8)]
    Mode {
        /// Code of the mode in 6060h.
        wanted: u32,
        /// Mode in 6061h.
        received: u32,
    },
    /// The profile has no process data for the rig's command mode.
    #[error("profile {profile} has no process data for {mode}")]
    NoMapping {
        /// Name of the profile.
        profile: Box<str>,
        /// The mode.
        mode: &'static str,
    },
    /// The cycle time cannot be represented in the drives.
    #[error("a cycle time of {period_us} us cannot be written to 60C2h: at most 255 times a power of ten of a second")]
    CycleTime {
        /// The cycle time in us.
        period_us: u32,
    },
    /// Two nodes have the same identifier.
    #[error("node id {node_id} is used twice")]
    DuplicateNodeId {
        /// The identifier.
        node_id: u8,
    },
    /// A node identifier is outside 1 to 127.
    #[error("node id {node_id} is outside 1 to 127")]
    NodeId {
        /// The identifier.
        node_id: u8,
    },
    /// A process data frame would be longer than 8 bytes, or lacks an object that the rig needs.
    #[error("the process data of profile {profile} lack {lacking}, or are longer than 8 bytes")]
    Layout {
        /// Name of the profile.
        profile: Box<str>,
        /// Objects that they lack.
        lacking: &'static str,
    },
    /// The profile is not one of this kind of device.
    #[error("profile {profile} is not one of {wanted}")]
    Role {
        /// Name of the profile.
        profile: Box<str>,
        /// The wanted kind of device.
        wanted: &'static str,
    },
    /// A step on an EtherCAT segment.
    #[error(transparent)]
    Segment(Box<SegmentFailure>),
    /// The object of a watchdog cannot hold the time that it has to.
    #[error("object {index:04X}h:{sub} cannot hold {after_us} us, after which the drive has to stop")]
    WatchTime {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// The time in us.
        after_us: u32,
    },
}

/// Advice for an object whose value the device keeps.
fn advice(index: u16) -> &'static str {
    match index {
        0x1400..0x1c00 | 0x1c12 | 0x1c13 => {
            "have `process_data` of the profile say what `yieldwall pdo show` shows of the device, or change that with the vendor's tool"
        }
        0x1005 | 0x1012 => "clear bit 30 with the vendor's tool: beside this program no device may make SYNC or TIME",
        _ => "set it with the vendor's tool, or have the rig file or the profile ask for what it holds",
    }
}

/// A type of synchronisation in words.
///
/// # Source
/// ETG.1020, 1C32h:01 and 1C33h:01.
fn synchronisation(kind: u32) -> &'static str {
    match kind {
        0 => "free run",
        1 => "with its process data",
        2 => "SYNC0",
        3 => "SYNC1",
        0x22 => "with the outputs",
        _ => "not known",
    }
}

impl From<SegmentFailure> for BootFailure {
    fn from(failure: SegmentFailure) -> Self {
        BootFailure::Segment(Box::new(failure))
    }
}

/// A failed boot: which node, in which step, and why. Nothing was enabled.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{}{}: {step}: {failure}", named(*.node_id, .name), silence(.failure))]
pub struct BootError {
    /// Node id; `None` for a sensor on plain CAN.
    pub node_id: Option<u8>,
    /// The node's name in the configuration.
    pub name: String,
    /// Step that failed.
    pub step: &'static str,
    /// The failure.
    #[source]
    pub failure: BootFailure,
}

/// Returns ` is silent; 2 and 10 answered` for a node that was never heard; an empty text for any other failure.
fn silence(failure: &BootFailure) -> String {
    match failure {
        BootFailure::Missing { said, others, .. } if *said == Said::default() => format!(" is silent; {others}"),
        _ => String::new(),
    }
}

/// `node 1 (left)`, or the name alone where there is no node id.
pub(super) fn named(node_id: Option<u8>, name: &str) -> String {
    node_id.map_or_else(|| name.to_owned(), |node_id| format!("node {node_id} ({name})"))
}
