//! SDO abort codes with names, meanings and likely causes.

use std::fmt;

/// An SDO abort code as it is on the bus.
///
/// `Display` prints code, name, meaning and likely cause; a code that neither CiA 301 nor ETG.1000.6 defines prints as vendor specific.
///
/// # Source
/// CiA 301, table of SDO abort codes; those of EtherCAT alone: ETG.1000.6, SDO abort codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct AbortCode(pub u32);

macro_rules! abort_codes {
    ($($code:literal $constant:ident $name:literal, $meaning:literal, $cause:literal, $next:expr;)*) => {
        impl AbortCode {
            $(
                #[doc = concat!("`", stringify!($code), "`: ", $meaning, ".")]
                pub const $constant: AbortCode = AbortCode($code);
            )*

            /// All codes that CiA 301 and ETG.1000.6 define, ascending.
            pub const ALL: &'static [AbortCode] = &[$(AbortCode::$constant),*];

            fn texts(self) -> Option<[&'static str; 4]> {
                match self.0 {
                    $($code => Some([$name, $meaning, $cause, $next]),)*
                    _ => None,
                }
            }
        }
    };
}

const RETRY_ALONE: &str = "end other masters and service tools, then try again";
const REPORT: &str = "report it with `yieldwall monitor` of the transfer";
const MANUAL: &str = "look the object up in the device's manual or data sheet";
const DUMP: &str = "`yieldwall od dump NODE` shows what the device has; compare with its profile and data sheet";
const TYPE: &str = "compare the object's data type with the device's data sheet (--eds)";
const LIMITS: &str = "compare the value and its unit with the device's data sheet and its limit objects";

abort_codes! {
    0x0503_0000 TOGGLE "toggle", "toggle bit did not alternate", "a segment was lost or repeated, or two clients use one channel", RETRY_ALONE;
    0x0504_0000 TIMEOUT "timeout", "the other side did not answer in time", "node absent, stopped or overloaded; raise its SDO timeout", "`yieldwall scan` shows which nodes answer";
    0x0504_0001 COMMAND "command", "command specifier unknown or not valid now", "service not supported or sides out of step", RETRY_ALONE;
    0x0504_0002 BLOCK_SIZE "block-size", "block size not valid", "block transfer parameters outside 1 to 127", REPORT;
    0x0504_0003 SEQUENCE "sequence", "sequence number not valid", "a block segment was lost", RETRY_ALONE;
    0x0504_0004 CRC "crc", "checksum differs", "data damaged or assembled in the wrong order", RETRY_ALONE;
    0x0504_0005 OUT_OF_MEMORY "out-of-memory", "no memory for the data", "value longer than the receiver's buffer", TYPE;
    0x0601_0000 ACCESS "access", "access to this object not supported", "object cannot be accessed this way; see the drive manual", MANUAL;
    0x0601_0001 WRITE_ONLY "write-only", "a write-only object was read", "wrong object or sub-index", MANUAL;
    0x0601_0002 READ_ONLY "read-only", "a read-only object was written", "wrong object or sub-index, or a fixed mapping", MANUAL;
    0x0601_0003 SUB_ZERO_NOT_ZERO "sub-0-not-0", "sub-index 0 has to be 0 before this one is written", "write 0 to sub-index 0 first, then the others, then their number", "write 0 to sub-index 0 first, then the others, then their number";
    0x0601_0004 NO_COMPLETE_ACCESS "no-complete-access", "the object has no complete access", "it is one value, or of variable length: use its sub-indices", "read and write its sub-indices one by one";
    0x0601_0006 MAPPED_OUTPUT "mapped-output", "the object is mapped into outputs that are exchanged", "process data would overwrite it: leave OP first", "end the run, then write it";
    0x0602_0000 NO_OBJECT "no-object", "the dictionary has no such object", "this device has no such object; see its EDS", DUMP;
    0x0604_0041 NOT_MAPPABLE "not-mappable", "the object cannot be mapped into this PDO", "object not PDO mappable, wrong direction or wrong bit length", "compare the profile's process data with the drive's data sheet; `yieldwall pdo show NODE` shows what is mapped";
    0x0604_0042 PDO_LENGTH "pdo-length", "mapped objects exceed the PDO length", "more than 64 bits or more entries than the device allows", "map fewer objects: at most 8 bytes a PDO, and mapping_entries of the profile as the device has them";
    0x0604_0043 PARAMETER_INCOMPATIBLE "incompatible", "parameters contradict each other", "e.g. one node id entered twice in 1016h", "`yieldwall od read NODE OBJECT` shows what stands there already; take that out first";
    0x0604_0047 INTERNAL_INCOMPATIBLE "internal", "incompatible inside the device", "vendor restriction; see the manual", MANUAL;
    0x0606_0000 HARDWARE "hardware", "hardware error on access", "non-volatile memory or encoder not answering", "switch the device off and on; `yieldwall emcy NODE` shows what it has stored";
    0x0607_0010 LENGTH "length", "data type or length does not match", "wrong data type in the configuration", TYPE;
    0x0607_0012 TOO_LONG "too-long", "more data than the object takes", "wrong data type: value wider than the object", TYPE;
    0x0607_0013 TOO_SHORT "too-short", "less data than the object needs", "wrong data type: value narrower than the object", TYPE;
    0x0609_0011 NO_SUB_INDEX "no-sub-index", "the object has no such sub-index", "fewer entries on this device than expected", DUMP;
    0x0609_0030 VALUE "value", "value not allowed", "outside the allowed set, or a PDO parameter changed while the PDO is valid", "compare the value with the device's data sheet; `yieldwall od write` takes a PDO out of use while it changes it";
    0x0609_0031 VALUE_HIGH "value-high", "value above the upper limit", "unit or scaling mistake, or a limit object of the device", LIMITS;
    0x0609_0032 VALUE_LOW "value-low", "value below the lower limit", "unit or scaling mistake, or a limit object of the device", LIMITS;
    0x0609_0036 LIMITS_INVERTED "limits-inverted", "maximum is less than minimum", "write the limits in the other order", "write the greater limit first";
    0x060A_0023 RESOURCE "resource", "resource not available: SDO connection", "all channels of the device are in use", "end other masters and service tools, then try again";
    0x0800_0000 GENERAL "general", "general error", "vendor specific; see the error objects 1003h and 603Fh", "`yieldwall emcy NODE` and `yieldwall state NODE` show what the device adds";
    0x0800_0020 TRANSFER "transfer", "data cannot be transferred or stored", "application refused; wrong store signature (1010h)?", MANUAL;
    0x0800_0021 LOCAL_CONTROL "local-control", "refused because of local control", "device is controlled by its own panel or service tool", "switch the device to remote, or end its maker's program";
    0x0800_0022 DEVICE_STATE "device-state", "refused in the present device state", "wrong NMT or drive state: go to Pre-operational, disable the PDO or the drive", "`yieldwall state NODE` shows NMT and drive state; `yieldwall nmt NODE preop` brings it to Pre-operational";
    0x0800_0023 NO_DICTIONARY "no-dictionary", "dictionary not present or not generated", "device lacks its stored configuration file", MANUAL;
    0x0800_0024 NO_DATA "no-data", "no data available", "the value has not been measured or stored yet", "try again once the device has measured or stored it";
}

impl AbortCode {
    /// Returns the short name, for logs and tests.
    pub fn name(self) -> &'static str {
        self.texts().map_or("vendor", |[name, ..]| name)
    }

    /// Returns the meaning of the code.
    pub fn meaning(self) -> &'static str {
        self.texts().map_or("code not defined by CiA 301", |[_, meaning, ..]| meaning)
    }

    /// Whether a device refuses to change the object at all: 06010002h, or 06010000h from devices that make no difference.
    ///
    /// Real-time: yes.
    pub fn is_read_only(self) -> bool {
        matches!(self, AbortCode::READ_ONLY | AbortCode::ACCESS)
    }

    /// Whether a device does not have the object: 06020000h, or 06090011h for a sub-index.
    ///
    /// Real-time: yes.
    pub fn is_absent(self) -> bool {
        matches!(self, AbortCode::NO_OBJECT | AbortCode::NO_SUB_INDEX)
    }

    /// Returns the usual cause.
    pub fn likely_cause(self) -> &'static str {
        self.texts().map_or("vendor specific: see the device manual", |[_, _, cause, _]| cause)
    }

    /// Returns the next step for a person.
    pub fn next(self) -> &'static str {
        self.texts().map_or(MANUAL, |[.., next]| next)
    }
}

impl fmt::Display for AbortCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:08X}h {}: {} ({})", self.0, self.name(), self.meaning(), self.likely_cause())
    }
}

impl std::error::Error for AbortCode {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prints_code_name_meaning_and_cause() {
        assert_eq!(
            AbortCode(0x0609_0011).to_string(),
            "06090011h no-sub-index: the object has no such sub-index (fewer entries on this device than expected)"
        );
        assert_eq!(AbortCode(0x1234).name(), "vendor");
    }

    #[test]
    fn all_codes_are_there_once_in_order() {
        // 31 of CiA 301, 3 of ETG.1000.6.
        assert_eq!(AbortCode::ALL.len(), 34);
        assert!(AbortCode::ALL.windows(2).all(|pair| pair[0] < pair[1]));
        assert!(AbortCode::ALL.iter().all(|code| code.name() != "vendor"));
    }
}
