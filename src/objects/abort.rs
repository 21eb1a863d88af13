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
    ($($code:literal $constant:ident $name:literal, $meaning:literal, $cause:literal;)*) => {
        impl AbortCode {
            $(
                #[doc = concat!("`", stringify!($code), "`: ", $meaning, ".")]
                pub const $constant: AbortCode = AbortCode($code);
            )*

            /// All codes that CiA 301 and ETG.1000.6 define, ascending.
            pub const ALL: &'static [AbortCode] = &[$(AbortCode::$constant),*];

            fn texts(self) -> Option<(&'static str, &'static str, &'static str)> {
                match self.0 {
                    $($code => Some(($name, $meaning, $cause)),)*
                    _ => None,
                }
            }
        }
    };
}

abort_codes! {
    0x0503_0000 TOGGLE "toggle", "toggle bit did not alternate", "a segment was lost or repeated, or two clients use one channel";
    0x0504_0000 TIMEOUT "timeout", "the other side did not answer in time", "node absent, stopped or overloaded; raise its SDO timeout";
    0x0504_0001 COMMAND "command", "command specifier unknown or not valid now", "service not supported or sides out of step";
    0x0504_0002 BLOCK_SIZE "block-size", "block size not valid", "block transfer parameters outside 1 to 127";
    0x0504_0003 SEQUENCE "sequence", "sequence number not valid", "a block segment was lost";
    0x0504_0004 CRC "crc", "checksum differs", "data damaged or assembled in the wrong order";
    0x0504_0005 OUT_OF_MEMORY "out-of-memory", "no memory for the data", "value longer than the receiver's buffer";
    0x0601_0000 ACCESS "access", "access to this object not supported", "object cannot be accessed this way; see the drive manual";
    0x0601_0001 WRITE_ONLY "write-only", "a write-only object was read", "wrong object or sub-index";
    0x0601_0002 READ_ONLY "read-only", "a read-only object was written", "wrong object or sub-index, or a fixed mapping";
    0x0601_0003 SUB_ZERO_NOT_ZERO "sub-0-not-0", "sub-index 0 has to be 0 before this one is written", "write 0 to sub-index 0 first, then the others, then their number";
    0x0601_0004 NO_COMPLETE_ACCESS "no-complete-access", "the object has no complete access", "it is one value, or of variable length: use its sub-indices";
    0x0601_0006 MAPPED_OUTPUT "mapped-output", "the object is mapped into outputs that are exchanged", "process data would overwrite it: leave OP first";
    0x0602_0000 NO_OBJECT "no-object", "the dictionary has no such object", "device profile lacks this option; compare with the EDS";
    0x0604_0041 NOT_MAPPABLE "not-mappable", "the object cannot be mapped into this PDO", "object not PDO mappable, wrong direction or wrong bit length";
    0x0604_0042 PDO_LENGTH "pdo-length", "mapped objects exceed the PDO length", "more than 64 bits or more entries than the device allows";
    0x0604_0043 PARAMETER_INCOMPATIBLE "incompatible", "parameters contradict each other", "e.g. one node id entered twice in 1016h";
    0x0604_0047 INTERNAL_INCOMPATIBLE "internal", "incompatible inside the device", "vendor restriction; see the manual";
    0x0606_0000 HARDWARE "hardware", "hardware error on access", "non-volatile memory or encoder not answering";
    0x0607_0010 LENGTH "length", "data type or length does not match", "wrong data type in the configuration";
    0x0607_0012 TOO_LONG "too-long", "more data than the object takes", "wrong data type: value wider than the object";
    0x0607_0013 TOO_SHORT "too-short", "less data than the object needs", "wrong data type: value narrower than the object";
    0x0609_0011 NO_SUB_INDEX "no-sub-index", "the object has no such sub-index", "fewer entries on this device than expected";
    0x0609_0030 VALUE "value", "value not allowed", "outside the allowed set, or a PDO parameter changed while the PDO is valid";
    0x0609_0031 VALUE_HIGH "value-high", "value above the upper limit", "unit or scaling mistake, or a limit object of the device";
    0x0609_0032 VALUE_LOW "value-low", "value below the lower limit", "unit or scaling mistake, or a limit object of the device";
    0x0609_0036 LIMITS_INVERTED "limits-inverted", "maximum is less than minimum", "write the limits in the other order";
    0x060A_0023 RESOURCE "resource", "resource not available: SDO connection", "all channels of the device are in use";
    0x0800_0000 GENERAL "general", "general error", "vendor specific; see the error objects 1003h and 603Fh";
    0x0800_0020 TRANSFER "transfer", "data cannot be transferred or stored", "application refused; wrong store signature (1010h)?";
    0x0800_0021 LOCAL_CONTROL "local-control", "refused because of local control", "device is controlled by its own panel or service tool";
    0x0800_0022 DEVICE_STATE "device-state", "refused in the present device state", "wrong NMT or drive state: go to Pre-operational, disable the PDO or the drive";
    0x0800_0023 NO_DICTIONARY "no-dictionary", "dictionary not present or not generated", "device lacks its stored configuration file";
    0x0800_0024 NO_DATA "no-data", "no data available", "the value has not been measured or stored yet";
}

impl AbortCode {
    /// Short name, for logs and tests.
    pub fn name(self) -> &'static str {
        self.texts().map_or("vendor", |texts| texts.0)
    }

    /// What the code says.
    pub fn meaning(self) -> &'static str {
        self.texts().map_or("code not defined by CiA 301", |texts| texts.1)
    }

    /// What usually lies behind it.
    pub fn likely_cause(self) -> &'static str {
        self.texts().map_or("vendor specific: see the device manual", |texts| texts.2)
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
