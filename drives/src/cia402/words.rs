//! Statusword and controlword.

/// State of the CiA 402 power drive system.
///
/// # Source
/// CiA 402-2, statusword 6041h and controlword 6040h.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "config", derive(serde::Serialize, serde::Deserialize, schemars::JsonSchema))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"))]
pub enum State {
    /// Starting up.
    NotReadyToSwitchOn,
    /// Initialised; high voltage may be absent.
    SwitchOnDisabled,
    /// High voltage may be switched on.
    ReadyToSwitchOn,
    /// High voltage is on, no torque.
    SwitchedOn,
    /// The drive follows its set-points.
    OperationEnabled,
    /// A quick stop runs, or has ended with the drive held.
    QuickStopActive,
    /// The reaction to a fault runs.
    FaultReactionActive,
    /// Fault: no torque until a reset edge.
    Fault,
}

impl State {
    /// Every state.
    pub const ALL: [State; 8] = [
        State::NotReadyToSwitchOn,
        State::SwitchOnDisabled,
        State::ReadyToSwitchOn,
        State::SwitchedOn,
        State::OperationEnabled,
        State::QuickStopActive,
        State::FaultReactionActive,
        State::Fault,
    ];

    /// Whether a drive in this state may make torque.
    ///
    /// Real-time: yes.
    pub const fn has_torque(self) -> bool {
        matches!(self, State::OperationEnabled | State::QuickStopActive | State::FaultReactionActive)
    }

    /// The state that a statusword encodes; `None` for bit patterns that the standard does not define.
    ///
    /// Bit 5 counts only where the standard has it count: a drive may show either value of it in the four states whose
    /// mask is 4Fh.
    ///
    /// Real-time: yes.
    pub const fn decode(statusword: u16) -> Option<State> {
        match statusword & 0x4f {
            0x00 => return Some(State::NotReadyToSwitchOn),
            0x40 => return Some(State::SwitchOnDisabled),
            0x0f => return Some(State::FaultReactionActive),
            0x08 => return Some(State::Fault),
            _ => {}
        }
        match statusword & 0x6f {
            0x21 => Some(State::ReadyToSwitchOn),
            0x23 => Some(State::SwitchedOn),
            0x27 => Some(State::OperationEnabled),
            0x07 => Some(State::QuickStopActive),
            _ => None,
        }
    }

    /// The state bits (0 to 3, 5, 6) that a drive shows in this state.
    ///
    /// Real-time: yes.
    pub const fn bits(self) -> u16 {
        match self {
            State::NotReadyToSwitchOn => 0x00,
            State::SwitchOnDisabled => 0x40,
            State::ReadyToSwitchOn => 0x21,
            State::SwitchedOn => 0x23,
            State::OperationEnabled => 0x27,
            State::QuickStopActive => 0x07,
            State::FaultReactionActive => 0x0f,
            State::Fault => 0x08,
        }
    }
}

/// A statusword (6041h) with names for its bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Statusword(pub u16);

impl Statusword {
    /// Bit 4: the power stage has voltage.
    pub const VOLTAGE_ENABLED: u16 = 1 << 4;
    /// Bit 7: warning.
    pub const WARNING: u16 = 1 << 7;
    /// Bit 9: the controlword is processed.
    pub const REMOTE: u16 = 1 << 9;
    /// Bit 10: target reached; in Quick Stop Active: standstill reached.
    pub const TARGET_REACHED: u16 = 1 << 10;
    /// Bit 11: an internal limit (torque, position) is active.
    pub const INTERNAL_LIMIT: u16 = 1 << 11;
    /// Bit 12 in the cyclic synchronous modes: the drive follows the command value. If 0 it ignores the set-point.
    pub const FOLLOWS_COMMAND: u16 = 1 << 12;
    /// Bit 13 in cyclic synchronous position mode: following error.
    pub const FOLLOWING_ERROR: u16 = 1 << 13;
    /// Bit 12 in homing mode: home was found. With [`Statusword::TARGET_REACHED`] homing is over.
    pub const HOMING_ATTAINED: u16 = 1 << 12;
    /// Bit 13 in homing mode: the drive has given up.
    pub const HOMING_ERROR: u16 = 1 << 13;

    /// The state, if the pattern is a defined one.
    ///
    /// Real-time: yes.
    pub const fn state(self) -> Option<State> {
        State::decode(self.0)
    }

    /// Whether all bits of `mask` are set.
    ///
    /// Real-time: yes.
    pub const fn has(self, mask: u16) -> bool {
        self.0 & mask == mask
    }
}

/// Bits of the controlword (6040h) beyond the commands.
pub mod controlword {
    /// Bit 4 in homing mode: its rising edge starts homing, and as long as it is set homing goes on.
    pub const START_HOMING: u16 = 1 << 4;
    /// Bit 7: its rising edge resets a fault.
    pub const FAULT_RESET: u16 = 1 << 7;
    /// Bit 8: halt.
    pub const HALT: u16 = 1 << 8;
}

/// A command of the controlword.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Command {
    /// Transitions 2, 6, 8.
    Shutdown,
    /// Transition 3; in Operation Enabled the same bits mean disable operation (5).
    SwitchOn,
    /// Transitions 4, 16.
    EnableOperation,
    /// Transitions 7, 9, 10, 12: torque off at once.
    DisableVoltage,
    /// Transitions 7, 10, 11.
    QuickStop,
    /// Transition 15, on the rising edge of bit 7 only.
    FaultReset,
}

impl Command {
    /// The controlword that gives this command; bits 4 to 6 and 8 to 15 are zero.
    ///
    /// Real-time: yes.
    pub const fn controlword(self) -> u16 {
        match self {
            Command::Shutdown => 0x06,
            Command::SwitchOn => 0x07,
            Command::EnableOperation => 0x0f,
            Command::DisableVoltage => 0x00,
            Command::QuickStop => 0x02,
            Command::FaultReset => controlword::FAULT_RESET,
        }
    }

    /// The command in a controlword as a device sees it. [`Command::FaultReset`] is given while bit 7 is set; whether
    /// that is an edge only the device knows.
    ///
    /// Real-time: yes.
    pub const fn decode(controlword: u16) -> Command {
        if controlword & controlword::FAULT_RESET != 0 {
            Command::FaultReset
        } else if controlword & 0x02 == 0 {
            Command::DisableVoltage
        } else if controlword & 0x04 == 0 {
            Command::QuickStop
        } else if controlword & 0x01 == 0 {
            Command::Shutdown
        } else if controlword & 0x08 == 0 {
            Command::SwitchOn
        } else {
            Command::EnableOperation
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COMMANDS: [Command; 6] = [
        Command::Shutdown,
        Command::SwitchOn,
        Command::EnableOperation,
        Command::DisableVoltage,
        Command::QuickStop,
        Command::FaultReset,
    ];

    #[test]
    fn states_decode_by_the_masks_of_the_standard_for_all_words() {
        let table: [(u16, u16, State); 8] = [
            (0x4f, 0x00, State::NotReadyToSwitchOn),
            (0x4f, 0x40, State::SwitchOnDisabled),
            (0x6f, 0x21, State::ReadyToSwitchOn),
            (0x6f, 0x23, State::SwitchedOn),
            (0x6f, 0x27, State::OperationEnabled),
            (0x6f, 0x07, State::QuickStopActive),
            (0x4f, 0x0f, State::FaultReactionActive),
            (0x4f, 0x08, State::Fault),
        ];
        for word in 0..=u16::MAX {
            let mut hits = table.iter().filter(|(mask, value, _)| word & mask == *value);
            let expected = hits.next().map(|(.., state)| *state);
            assert!(hits.next().is_none(), "{word:04x} matches two rows");
            assert_eq!(State::decode(word), expected, "{word:04x}");
        }
    }

    #[test]
    fn typical_words_of_a_drive_decode() {
        assert_eq!(State::decode(0x0250), Some(State::SwitchOnDisabled));
        assert_eq!(State::decode(0x1637), Some(State::OperationEnabled));
        assert_eq!(State::decode(0x0218), Some(State::Fault));
        assert_eq!(State::decode(0x0003), None);
        for state in State::ALL {
            assert_eq!(State::decode(state.bits() | 0xf690), Some(state));
        }
    }

    #[test]
    fn commands_decode_by_the_masks_of_the_standard() {
        let table: [(u16, u16, Command); 5] = [
            (0x87, 0x06, Command::Shutdown),
            (0x8f, 0x07, Command::SwitchOn),
            (0x8f, 0x0f, Command::EnableOperation),
            (0x82, 0x00, Command::DisableVoltage),
            (0x86, 0x02, Command::QuickStop),
        ];
        for word in 0..=u16::MAX {
            let expected =
                table.iter().find(|(mask, value, _)| word & mask == *value).map_or(Command::FaultReset, |row| row.2);
            assert_eq!(Command::decode(word), expected, "{word:04x}");
        }
        for command in COMMANDS {
            assert_eq!(Command::decode(command.controlword()), command);
        }
    }
}
