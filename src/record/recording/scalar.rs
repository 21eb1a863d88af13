//! The kinds of value that a field may have.

use std::fmt::Write;

use yieldwall_drives::cia402;
use yieldwall_motion::guard::{DeviceSet, Fault, Motion, Request, State, fault};

/// A value of at most eight bytes.
pub trait Scalar: Copy {
    /// Its name in a message definition.
    const TYPE: &'static str;
    /// Its size in bytes, which is its alignment too.
    const SIZE: usize;

    /// Its bits, in the lowest [`Scalar::SIZE`] bytes.
    fn bits(self) -> u64;

    /// Returns the value with these bits; `None` if no value has them.
    fn of_bits(bits: u64) -> Option<Self>;

    /// Writes the value as text.
    fn text(self, out: &mut String);

    /// Names of the codes, where the value is one of few.
    fn codes() -> Vec<(String, u64)> {
        Vec::new()
    }
}

/// Numbers that are written as Rust writes them.
macro_rules! number {
    ($($type:ty: $name:literal, $size:literal, $bits:expr, $of_bits:expr;)*) => {$(
        impl Scalar for $type {
            const TYPE: &'static str = $name;
            const SIZE: usize = $size;

            fn bits(self) -> u64 {
                ($bits)(self)
            }

            fn of_bits(bits: u64) -> Option<Self> {
                ($of_bits)(bits)
            }

            fn text(self, out: &mut String) {
                // A string takes everything.
                let _ = write!(out, "{self}");
            }
        }
    )*};
}

number! {
    f64: "float64", 8, f64::to_bits, |bits| Some(f64::from_bits(bits));
    u64: "uint64", 8, |value| value, Some;
    u32: "uint32", 4, u64::from, |bits| u32::try_from(bits).ok();
    i32: "int32", 4, |value: i32| u64::from(value.cast_unsigned()), |bits| u32::try_from(bits).ok().map(u32::cast_signed);
    u8: "uint8", 1, u64::from, |bits| u8::try_from(bits).ok();
}

impl Scalar for bool {
    const TYPE: &'static str = "bool";
    const SIZE: usize = 1;

    fn bits(self) -> u64 {
        self.into()
    }

    fn of_bits(bits: u64) -> Option<Self> {
        match bits {
            0 => Some(false),
            1 => Some(true),
            _ => None,
        }
    }

    fn text(self, out: &mut String) {
        out.push(if self { '1' } else { '0' });
    }
}

/// Kind of the numbers of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CommandKind {
    Position,
    Velocity,
    Torque,
}

/// Enumerations, by number in a message and by name in text.
macro_rules! coded {
    ($($type:ty: $($variant:ident = $code:literal $name:literal),+;)*) => {$(
        impl Scalar for $type {
            const TYPE: &'static str = "uint8";
            const SIZE: usize = 1;

            fn bits(self) -> u64 {
                match self {
                    $(Self::$variant => $code,)+
                }
            }

            fn of_bits(bits: u64) -> Option<Self> {
                match bits {
                    $($code => Some(Self::$variant),)+
                    _ => None,
                }
            }

            fn text(self, out: &mut String) {
                out.push_str(match self {
                    $(Self::$variant => $name,)+
                });
            }

            fn codes() -> Vec<(String, u64)> {
                vec![$(($name.to_owned(), $code)),+]
            }
        }
    )*};
}

coded! {
    State: Idle = 0 "idle", Enabling = 1 "enabling", Running = 2 "running", Holding = 3 "holding",
        Stopping = 4 "stopping", Stopped = 5 "stopped", Disabled = 6 "disabled", Lost = 7 "lost";
    Request: None = 0 "none", Enable = 1 "enable", Stop = 2 "stop", Reset = 3 "reset";
    Motion: Rest = 0 "rest", Run = 1 "run", Halt = 2 "halt";
    cia402::Goal: SwitchOnDisabled = 0 "switch-on-disabled", ReadyToSwitchOn = 1 "ready-to-switch-on",
        SwitchedOn = 2 "switched-on", OperationEnabled = 3 "operation-enabled", QuickStop = 4 "quick-stop";
    cia402::State: NotReadyToSwitchOn = 0 "not-ready-to-switch-on", SwitchOnDisabled = 1 "switch-on-disabled",
        ReadyToSwitchOn = 2 "ready-to-switch-on", SwitchedOn = 3 "switched-on",
        OperationEnabled = 4 "operation-enabled", QuickStopActive = 5 "quick-stop-active",
        FaultReactionActive = 6 "fault-reaction-active", Fault = 7 "fault";
    CommandKind: Position = 0 "position", Velocity = 1 "velocity", Torque = 2 "torque";
}

/// By its number, which is its place in the table of faults.
impl Scalar for Fault {
    const TYPE: &'static str = "uint8";
    const SIZE: usize = 1;

    fn bits(self) -> u64 {
        self as u64
    }

    fn of_bits(bits: u64) -> Option<Self> {
        fault::TABLE.get(usize::try_from(bits).ok()?).map(|row| row.fault)
    }

    fn text(self, out: &mut String) {
        out.push_str(self.row().name);
    }

    fn codes() -> Vec<(String, u64)> {
        fault::TABLE.iter().map(|row| (row.name.to_owned(), row.fault as u64)).collect()
    }
}

impl Scalar for DeviceSet {
    const TYPE: &'static str = "uint16";
    const SIZE: usize = 2;

    fn bits(self) -> u64 {
        DeviceSet::bits(self).into()
    }

    fn of_bits(bits: u64) -> Option<Self> {
        let set = Self::from_bits(u16::try_from(bits).ok()?);
        (u64::from(DeviceSet::bits(set)) == bits).then_some(set)
    }

    fn text(self, out: &mut String) {
        out.push_str(&self.to_string().replace(", ", "+"));
    }

    fn codes() -> Vec<(String, u64)> {
        Self::from_bits(u16::MAX)
            .iter()
            .map(|device| (device.to_string().replace(' ', "-"), DeviceSet::bits(device).into()))
            .collect()
    }
}
