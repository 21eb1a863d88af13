//! The states of CiA 402 in words.

use yieldwall_drives::cia402::{State, Statusword};

/// Text about a state.
pub(super) struct StateText {
    pub(super) meaning: &'static str,
    pub(super) cause: &'static str,
    pub(super) next: &'static str,
}

/// Bits of a statusword with a meaning besides the state, and their texts.
const BITS: [(u16, &str); 7] = [
    (Statusword::VOLTAGE_ENABLED, "the power stage has voltage"),
    (Statusword::WARNING, "warning"),
    (Statusword::REMOTE, "the controlword is processed"),
    (Statusword::TARGET_REACHED, "target reached"),
    (Statusword::INTERNAL_LIMIT, "an internal limit is active"),
    (Statusword::FOLLOWS_COMMAND, "cyclic synchronous modes: the drive follows the set-point"),
    (Statusword::FOLLOWING_ERROR, "cyclic synchronous position: following error"),
];

/// Returns the name of a state in the standard: `Switch On Disabled`.
pub fn state_name(state: Option<State>) -> &'static str {
    match state {
        Some(State::NotReadyToSwitchOn) => "Not Ready To Switch On",
        Some(State::SwitchOnDisabled) => "Switch On Disabled",
        Some(State::ReadyToSwitchOn) => "Ready To Switch On",
        Some(State::SwitchedOn) => "Switched On",
        Some(State::OperationEnabled) => "Operation Enabled",
        Some(State::QuickStopActive) => "Quick Stop Active",
        Some(State::FaultReactionActive) => "Fault Reaction Active",
        Some(State::Fault) => "Fault",
        None => "no state of CiA 402",
    }
}

/// Returns the bits that are set, without those of the state.
pub(super) fn bits(word: Statusword) -> Vec<&'static str> {
    BITS.iter().filter(|(bit, _)| word.has(*bit)).map(|(_, says)| *says).collect()
}

pub(super) fn row(state: Option<State>) -> StateText {
    let row = |meaning, cause, next| StateText { meaning, cause, next };
    match state {
        Some(State::NotReadyToSwitchOn) => row(
            "the drive starts or tests itself, and has no torque",
            "it was just switched on",
            "wait; if it stays, `yieldwall emcy NODE` shows what it has stored",
        ),
        Some(State::SwitchOnDisabled) => row(
            "the drive is well and has no torque",
            "no master has enabled the drive, its supply is off, or safe torque off is active",
            "`yieldwall run RIG.yaml` enables it; if it stays, check supply, enable input and safe torque off",
        ),
        Some(State::ReadyToSwitchOn) => row(
            "the drive may be switched on, and has no torque",
            "a master began to enable it, or took its torque away",
            "nothing: it waits for its master",
        ),
        Some(State::SwitchedOn) => row(
            "the power stage is on, and the drive takes no set-point",
            "a master enables it just now, or took set-points away",
            "stay clear of the arm; `yieldwall state NODE --disable-voltage` takes its torque away",
        ),
        Some(State::OperationEnabled) => row(
            "the drive has torque and follows its set-points",
            "a master has enabled it",
            "stay clear of the arm; `yieldwall state NODE --disable-voltage` takes its torque away",
        ),
        Some(State::QuickStopActive) => row(
            "the drive comes to rest by its quick stop, or has",
            "a quick stop was commanded, or the drive misses its master; some drives stay here with torque (605Ah 5 to 8)",
            "hold the arm, and take the torque away by `yieldwall state NODE --disable-voltage`; then start the run again",
        ),
        Some(State::FaultReactionActive) => row(
            "the drive has found a fault and comes to rest",
            "see its error code (603Fh)",
            "`yieldwall state NODE` shows error and cause",
        ),
        Some(State::Fault) => row(
            "the drive has found a fault, and has no torque",
            "see its error code (603Fh)",
            "fix what `yieldwall state NODE` names, then `yieldwall state NODE --reset-fault`",
        ),
        None => row(
            "its bits are those of no state",
            "no drive of CiA 402, a wrong mapping, or a damaged value",
            "`yieldwall info NODE` shows what the device is, `yieldwall pdo show NODE` what it maps",
        ),
    }
}
