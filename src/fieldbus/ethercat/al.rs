//! States of a device (AL states), and the codes with which it refuses or leaves one.

use std::fmt;

/// A state of the EtherCAT state machine; the number is that of the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum AlState {
    /// INIT: registers alone.
    Init = 1,
    /// PRE-OP: mailbox.
    PreOperational = 2,
    /// BOOT: firmware over the mailbox.
    Bootstrap = 3,
    /// SAFE-OP: inputs.
    SafeOperational = 4,
    /// OP: inputs and outputs.
    Operational = 8,
}

impl AlState {
    /// Returns the state of a number; `None` for a number without a state.
    pub const fn from_number(number: u8) -> Option<AlState> {
        Some(match number {
            1 => AlState::Init,
            2 => AlState::PreOperational,
            3 => AlState::Bootstrap,
            4 => AlState::SafeOperational,
            8 => AlState::Operational,
            _ => return None,
        })
    }

    /// Returns the name, as in the standard.
    pub const fn name(self) -> &'static str {
        match self {
            AlState::Init => "INIT",
            AlState::PreOperational => "PRE-OP",
            AlState::Bootstrap => "BOOT",
            AlState::SafeOperational => "SAFE-OP",
            AlState::Operational => "OP",
        }
    }

    /// Whether a device may go from here to there in one step; it may always stay.
    pub const fn may_become(self, to: AlState) -> bool {
        use AlState::*;
        match self {
            Init => matches!(to, Init | PreOperational | Bootstrap),
            Bootstrap => matches!(to, Init | Bootstrap),
            PreOperational => matches!(to, Init | PreOperational | SafeOperational),
            SafeOperational | Operational => !matches!(to, Bootstrap),
        }
    }
}

impl fmt::Display for AlState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Value that a master writes to AL control (0120h).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AlControl(pub u16);

impl AlControl {
    /// Acknowledges an error.
    pub const ACKNOWLEDGE: u16 = 0x10;

    /// Asks for a state.
    pub const fn request(state: AlState) -> Self {
        AlControl(state as u16)
    }

    /// Asks for a state and acknowledges an error.
    pub const fn acknowledge(state: AlState) -> Self {
        AlControl(state as u16 | Self::ACKNOWLEDGE)
    }

    /// Returns the state that is asked for; `None` for one that there is not.
    pub const fn state(self) -> Option<AlState> {
        AlState::from_number((self.0 & 0x0f) as u8)
    }

    /// Whether an error is acknowledged.
    pub const fn acknowledges(self) -> bool {
        self.0 & Self::ACKNOWLEDGE != 0
    }
}

/// AL status (0130h): the state that a device is in, and whether it could not get or stay where it should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AlStatus(pub u16);

impl AlStatus {
    /// The error bit.
    pub const ERROR: u16 = 0x10;

    /// Reads the status from the register, without bits that say something else: bit 5 (an identification is loaded) and reserved ones.
    pub const fn from_register(word: u16) -> Self {
        AlStatus(word & 0x1f)
    }

    /// Creates the status from its two parts.
    pub const fn new(state: AlState, has_error: bool) -> Self {
        AlStatus(state as u16 | if has_error { Self::ERROR } else { 0 })
    }

    /// Returns the state; `None` for one that there is not, as where several devices answer a BRD.
    pub const fn state(self) -> Option<AlState> {
        AlState::from_number((self.0 & 0x0f) as u8)
    }

    /// Whether the error bit is set; the AL status code then says why.
    pub const fn has_error(self) -> bool {
        self.0 & Self::ERROR != 0
    }

    /// Whether, with this code, only a master that exchanges process data keeps a device there: OP, or SAFE-OP to which the watchdog has not
    /// brought it.
    pub fn shows_master(self, code: AlStatusCode) -> bool {
        match self.state() {
            Some(AlState::Operational) => true,
            Some(AlState::SafeOperational) => code != AlStatusCode::SYNC_MANAGER_WATCHDOG,
            _ => false,
        }
    }
}

impl fmt::Display for AlStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.state() {
            Some(state) => write!(f, "{state}")?,
            None => write!(f, "{:X}h", self.0 & 0x0f)?,
        }
        f.write_str(if self.has_error() { "+ERR" } else { "" })
    }
}

/// An AL status code (0134h) as it is on the wire.
///
/// `Display` prints code, meaning and likely cause.
///
/// # Source
/// ETG.1000.6, table of AL status codes; ETG.1020.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct AlStatusCode(pub u16);

macro_rules! al_status_codes {
    ($($code:literal $constant:ident $meaning:literal, $cause:literal;)*) => {
        impl AlStatusCode {
            $(
                #[doc = concat!("`", stringify!($code), "`: ", $meaning, ".")]
                pub const $constant: AlStatusCode = AlStatusCode($code);
            )*

            /// All codes that the standard defines, ascending.
            pub const ALL: &'static [AlStatusCode] = &[$(AlStatusCode::$constant),*];

            fn texts(self) -> Option<(&'static str, &'static str)> {
                match self.0 {
                    $($code => Some(($meaning, $cause)),)*
                    _ => None,
                }
            }
        }
    };
}

al_status_codes! {
    0x0000 NONE "no error", "nothing to do";
    0x0001 UNSPECIFIED "unspecified error", "vendor specific: see the manual and the device's own error objects";
    0x0002 NO_MEMORY "no memory", "less would fit: fewer mapped objects or smaller mailboxes";
    0x0003 INVALID_SETUP "invalid device setup", "modules or parameters do not match the hardware";
    0x0006 FIRMWARE_MISMATCH "SII and firmware do not match", "the SII is of another firmware version: write the right one";
    0x0007 FIRMWARE_UPDATE "firmware update failed", "the file was damaged or is of another device";
    0x000e LICENCE "licence error", "a licence is missing";
    0x0011 INVALID_STATE_CHANGE "requested state change is not allowed", "a state was left out on the way, as from INIT to OP";
    0x0012 UNKNOWN_STATE "requested state is not known", "AL control holds no state of the standard";
    0x0013 NO_BOOTSTRAP "BOOT is not supported", "the device has no firmware update over EtherCAT";
    0x0014 NO_FIRMWARE "no valid firmware", "a firmware update was not finished";
    0x0015 INVALID_BOOT_MAILBOX "mailbox configuration not valid in BOOT", "sync managers 0 and 1 do not match words 14h to 17h of the SII";
    0x0016 INVALID_MAILBOX "mailbox configuration not valid", "sync managers 0 and 1 do not match words 18h to 1Bh of the SII";
    0x0017 INVALID_SYNC_MANAGER "sync manager configuration not valid", "a sync manager lies outside the memory or over another one";
    0x0018 NO_INPUTS "no valid inputs", "the device measures nothing valid: look at its own error objects";
    0x0019 NO_OUTPUTS "no valid outputs", "no output frame came before or after OP was asked for";
    0x001a SYNC_ERROR "synchronisation error", "output frames and SYNC0 did not keep step: late frames or a drifting clock";
    0x001b SYNC_MANAGER_WATCHDOG "sync manager watchdog", "output frames stayed away for longer than 0400h times 0420h";
    0x001c INVALID_SYNC_MANAGER_TYPES "sync manager types not valid", "1C00h and the sync managers differ";
    0x001d INVALID_OUTPUTS "output configuration not valid", "length of sync manager 2 and the mapping in 1C12h differ";
    0x001e INVALID_INPUTS "input configuration not valid", "length of sync manager 3 and the mapping in 1C13h differ";
    0x001f INVALID_WATCHDOG "watchdog configuration not valid", "the time of 0400h times 0420h is not possible here";
    0x0020 COLD_START "device needs a cold start", "switch it off and on";
    0x0021 NEEDS_INIT "device needs INIT", "ask for INIT first";
    0x0022 NEEDS_PREOP "device needs PRE-OP", "ask for PRE-OP first";
    0x0023 NEEDS_SAFEOP "device needs SAFE-OP", "ask for SAFE-OP first";
    0x0024 INVALID_INPUT_MAPPING "input mapping not valid", "1C13h or 1A00h names an object that is not there";
    0x0025 INVALID_OUTPUT_MAPPING "output mapping not valid", "1C12h or 1600h names an object that is not there";
    0x0026 INCONSISTENT_SETTINGS "inconsistent settings", "parameters contradict each other";
    0x0027 NO_FREE_RUN "free run is not supported", "distributed clocks or 1C32h have to be set";
    0x0028 NO_SYNC_MODE "synchronous mode is not supported", "1C32h asks for what the device lacks";
    0x0029 FREE_RUN_THREE_BUFFERS "free run needs three buffers", "control byte of sync manager 2 or 3";
    0x002a BACKGROUND_WATCHDOG "background watchdog", "firmware error";
    0x002b NO_PROCESS_DATA "no valid inputs and outputs", "look at the device's own error objects";
    0x002c FATAL_SYNC "fatal synchronisation error", "SYNC0 did not arrive in OP";
    0x002d NO_SYNC "no SYNC0 was seen", "SYNC0 is not activated (0981h), or its start (0990h) is in the past";
    0x002e CYCLE_TOO_SHORT "cycle time too short", "faster than 1C32h:05 allows";
    0x0030 INVALID_DC "distributed clocks: configuration not valid", "0980h to 09A7h do not match what the device offers in its ESI";
    0x0031 INVALID_DC_LATCH "distributed clocks: latch configuration not valid", "09A8h and up";
    0x0032 PLL "distributed clocks: PLL error", "the master's clock jitters or drifts too much";
    0x0033 DC_IO "distributed clocks: input or output error", "signal errors in the device";
    0x0034 DC_TIMEOUT "distributed clocks: time-out", "output frames came too late for SYNC0";
    0x0035 INVALID_CYCLE "distributed clocks: cycle time not valid", "09A0h is not a multiple that the device allows";
    0x0036 INVALID_SYNC0_CYCLE "distributed clocks: SYNC0 cycle not valid", "09A0h";
    0x0037 INVALID_SYNC1_CYCLE "distributed clocks: SYNC1 cycle not valid", "09A4h";
    0x0041 MAILBOX_AOE "mailbox: AoE error", "see the device manual";
    0x0042 MAILBOX_EOE "mailbox: EoE error", "see the device manual";
    0x0043 MAILBOX_COE "mailbox: CoE error", "see the device manual";
    0x0044 MAILBOX_FOE "mailbox: FoE error", "see the device manual";
    0x0045 MAILBOX_SOE "mailbox: SoE error", "see the device manual";
    0x004f MAILBOX_VOE "mailbox: VoE error", "see the device manual";
    0x0050 SII_NO_ACCESS "SII: the device has no access", "the master still owns the SII: release it (write 1 to 0500h)";
    0x0051 SII_ERROR "SII: access error", "memory chip or its content";
    0x0052 EXTERNAL_HARDWARE "external hardware not ready", "supply or attached module";
    0x0060 RESTARTED "device restarted by itself", "supply dip or firmware error";
    0x0061 IDENTIFICATION "device identification changed", "the selector was turned: switch off and on";
    0x0070 MODULES "detected modules do not match", "F030h and F050h differ";
    0x00f0 CONTROLLER "application controller available", "nothing to do";
}

impl AlStatusCode {
    /// Returns the meaning of the code.
    pub fn meaning(self) -> &'static str {
        match self.texts() {
            Some((meaning, _)) => meaning,
            None if self.0 >= 0x8000 => "vendor specific",
            None => "code not defined by the standard",
        }
    }

    /// Returns the usual cause.
    pub fn likely_cause(self) -> &'static str {
        self.texts().map_or("see the device manual", |texts| texts.1)
    }
}

impl fmt::Display for AlStatusCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04X}h {} ({})", self.0, self.meaning(), self.likely_cause())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_sorted_and_print_what_they_mean() {
        assert!(AlStatusCode::ALL.windows(2).all(|pair| pair[0] < pair[1]));
        assert_eq!(
            AlStatusCode(0x001b).to_string(),
            "001Bh sync manager watchdog (output frames stayed away for longer than 0400h times 0420h)"
        );
        assert_eq!(AlStatusCode(0x8001).to_string(), "8001h vendor specific (see the device manual)");
        assert_eq!(AlStatusCode(0x0999).meaning(), "code not defined by the standard");
    }

    #[test]
    fn words_of_control_and_status() {
        assert_eq!(AlControl::acknowledge(AlState::Init).0, 0x0011);
        assert_eq!((AlControl(0x0008).state(), AlControl(0x0008).acknowledges()), (Some(AlState::Operational), false));
        assert_eq!(AlStatus::new(AlState::SafeOperational, true).0, 0x0014);
        assert_eq!(AlStatus(0x0014).to_string(), "SAFE-OP+ERR");
        assert_eq!(AlStatus::from_register(0xffe2), AlStatus::new(AlState::PreOperational, false));
        assert_eq!(AlStatus::from_register(0x0132), AlStatus::new(AlState::PreOperational, true));
        assert_eq!((AlStatus(0x0006).to_string(), AlStatus(0x0006).state()), ("6h".to_owned(), None));
    }

    #[test]
    fn states_follow_each_other_as_in_the_standard() {
        use AlState::*;
        let all = [Init, PreOperational, Bootstrap, SafeOperational, Operational];
        let allowed = |from: AlState| all.into_iter().filter(|to| from.may_become(*to)).collect::<Vec<_>>();
        assert_eq!(allowed(Init), [Init, PreOperational, Bootstrap]);
        assert_eq!(allowed(PreOperational), [Init, PreOperational, SafeOperational]);
        assert_eq!(allowed(Bootstrap), [Init, Bootstrap]);
        assert_eq!(allowed(SafeOperational), [Init, PreOperational, SafeOperational, Operational]);
        assert_eq!(allowed(Operational), [Init, PreOperational, SafeOperational, Operational]);
    }
}
