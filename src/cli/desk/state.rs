//! `yieldwall state`: where a drive is in the state machine of CiA 402, out of Fault, and out of every state with torque.

use std::time::Duration;

use serde_json::json;
use yieldwall_drives::cia402::{Command, State, Statusword};

use super::place::{BusArguments, DeviceSession};
use super::reached::DeviceHandle;
use super::segment::state::Target;
use super::segment::{self, SegmentSession};
use super::words::{mode_code_words, nmt_words, state_words};
use crate::explain;
use crate::failure::{Exit, Failure};
use crate::output::Output;
use yieldwall_fieldbus::objects::Address;
use yieldwall_run::explanation;
use yieldwall_service::journal::is_powered;
use yieldwall_service::{Error, MOST_AXES, number, statusword_of};

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Node id, EtherCAT position or `all`, or device name from the rig
    node: String,
    /// Axis of a multi-axis device, 0 for the first; a drive of the rig uses its own axis
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..8))]
    axis: Option<u8>,
    /// EtherCAT: bring the device to this state
    #[arg(value_enum, group = "change")]
    target: Option<Target>,
    /// Reset a drive from Fault to Switch On Disabled; it has no torque before and after
    #[arg(long, group = "change")]
    reset_fault: bool,
    /// Remove the drive's torque, for example in Quick Stop Active. Hold the arm: it may drop
    #[arg(long, group = "change")]
    disable_voltage: bool,
    /// EtherCAT: change the state even if another master controls the devices
    ///
    /// The other master loses control of the devices, and moving drives stop by their watchdogs.
    #[arg(long, requires = "target")]
    take_over: bool,
    /// Print what would be written, and write nothing
    #[arg(long, requires = "change")]
    dry_run: bool,
    #[command(flatten)]
    place: BusArguments,
}

const STATUSWORD: Address = Address::new(0x6041, 0);
const CONTROLWORD: Address = Address::new(0x6040, 0);
const ERROR_CODE: Address = Address::new(0x603f, 0);
const MODE: Address = Address::new(0x6061, 0);
/// Number of reads of the statusword until a drive has left a state, and the time between them: a second in all.
const LOOKS: u32 = 50;
const LOOK: Duration = Duration::from_millis(20);

pub(crate) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let mut reached = match SegmentSession::taking_over(&arguments.place, arguments.take_over, output)? {
        Some(desk) if arguments.reset_fault || arguments.disable_voltage || arguments.axis.is_some() => {
            DeviceHandle::on_segment(desk, &arguments.node, output)?
        }
        Some(desk) => {
            let how = (arguments.take_over, arguments.dry_run);
            return segment::state::run(&arguments.node, arguments.target, how, desk, output);
        }
        None if arguments.target.is_some() => {
            let message = "init, preop, safeop and ack are states of devices on EtherCAT, and this place is on CAN";
            let help = "`yieldwall nmt NODE preop` is that of CAN; name an Ethernet interface with --bus or a rig on EtherCAT with --rig";
            return Err(Failure::new(Exit::Usage, message, help));
        }
        None => {
            let mut desk = DeviceSession::open(&arguments.place, output)?;
            let node = desk.node(&arguments.node)?;
            DeviceHandle::Node(Box::new(desk), node)
        }
    };
    arguments.axis.into_iter().for_each(|axis| reached.turn_to_axis(axis));
    let mut word = statusword(&mut reached)?;
    if arguments.reset_fault {
        word = reset_fault(arguments.dry_run, &mut reached, word, output)?;
    }
    if arguments.disable_voltage {
        word = disable_voltage(arguments.dry_run, &mut reached, word, output)?;
    }
    let error = reached.number_of(reached.at(ERROR_CODE), "reading its objects")?;
    let mode = reached.number_of(reached.at(MODE), "reading its objects")?;
    let (key, of_network) = match &mut reached {
        DeviceHandle::Node(desk, node) => {
            let nmt = desk.service.state(node.id);
            let nmt = nmt.map_err(|error| desk.failure(node, "asking its state", error))?;
            ("NMT", (nmt.map(|state| format!("{state:?}")), nmt.map_or("tells none", nmt_words).to_owned()))
        }
        DeviceHandle::Device(desk, device) => {
            let al = desk.service.state(device.position);
            let (al, _) = al.map_err(|error| desk.failure(device, "reading its state", error))?;
            ("AL", (Some(al.to_string()), al.to_string()))
        }
    };
    let mode = mode.map(|mode| format!("{} ({})", mode_code_words(mode as u8 as i8), mode as u8 as i8));
    let explained = error.filter(|code| *code != 0).map(|code| reached.explained(code as u16));
    let error_words = error.map(|_| match &explained {
        None => "none".to_owned(),
        Some(explained) => format!("{} {}", explained.code.as_deref().unwrap_or_default(), explained.meaning),
    });
    let of_state = reached.placed(explanation::statusword(word));
    if output.is_json() {
        let mut document = json!({
            "dry_run": arguments.dry_run,
            "statusword": word,
            "state": Statusword(word).state().map(|state| format!("{state:?}")),
            "mode": mode,
            "error_code": error,
            "error": error_words,
            "explained": explain::document(explained.as_ref().unwrap_or(&of_state)),
        });
        document[key.to_lowercase()] = of_network.0.into();
        return output.report(reached.document(document));
    }
    let rows = [
        ("state", Some(format!("{} ({word:04X}h)", state_words(word)))),
        (key, Some(of_network.1)),
        ("mode", mode),
        ("error", error_words),
    ];
    let rows = rows.into_iter().filter_map(|(key, says)| Some(explain::line(0, key, &says?)));
    let why = explain::lines(0, explained.as_ref().unwrap_or(&of_state));
    output.result(&format!("{}\n{}{why}", reached.words(), rows.collect::<String>()))
}

/// Returns the statusword of a drive.
pub(super) fn statusword(reached: &mut DeviceHandle) -> Result<u16, Failure> {
    match reached.read(reached.at(STATUSWORD)) {
        Ok(bytes) => Ok(number(&bytes) as u16),
        Err(error @ Error::Refused(_)) => {
            let at = reached.at(STATUSWORD).index;
            let message = format!("{} has no statusword ({at:04X}h): {error}", reached.words());
            let help = format!("it is no drive of CiA 402; {} shows what it is", reached.command("info"));
            Err(Failure::new(Exit::DeviceMismatch, message, help))
        }
        Err(error) => Err(reached.failure("reading its statusword", error)),
    }
}

/// Returns the reason against a write to a device: the power stage of an axis is on, or about to go off.
pub(super) fn refuse_powered(reached: &mut DeviceHandle) -> Result<(), Failure> {
    for axis in 0..MOST_AXES {
        // Without the first statusword it is no drive; axes may lie farther apart than by CiA 402.
        let word = reached.number_of(statusword_of(axis), "reading its statusword")?;
        let Some(word) = word.map(|word| word as u16) else {
            if axis == 0 {
                return Ok(());
            }
            continue;
        };
        if is_powered(Statusword(word)) {
            return Err(powered(&reached.words(), reached.number(), (axis, reached.arguments()), word));
        }
    }
    Ok(())
}

/// Returns the failure that the power stage of a drive is on.
pub(super) fn powered(words: &str, number: u16, (axis, arguments): (u8, &str), word: u16) -> Failure {
    let (of_axis, option) = match axis {
        0 => (String::new(), String::new()),
        axis => (format!(", axis {axis},"), format!(" --axis {axis}")),
    };
    let message =
        format!("{words}{of_axis} is in {}: nothing is written while its power stage is on", state_words(word));
    let help =
        format!("`yieldwall state {number}{option} --disable-voltage{arguments}` takes its torque away; hold the arm");
    Failure::new(Exit::SafetyStop, message, help)
}

/// Out of Fault, if the drive is there; the statusword afterwards.
pub(super) fn reset_fault(
    is_dry: bool,
    reached: &mut DeviceHandle,
    word: u16,
    output: &mut Output,
) -> Result<u16, Failure> {
    let is_fault = |word: u16| Statusword(word).state() == Some(State::Fault);
    if !is_fault(word) {
        let message = format!("{} is in {} and not in Fault; nothing was written", reached.words(), state_words(word));
        return Err(Failure::new(Exit::Usage, message, "leave out --reset-fault"));
    }
    // The edge of bit 7 counts.
    let words = [Command::DisableVoltage, Command::FaultReset, Command::DisableVoltage];
    let after = write_words(is_dry, reached, &words, "resetting its fault", is_fault, output)?;
    if is_dry || !is_fault(after) {
        return Ok(after);
    }
    let code = reached.read(reached.at(ERROR_CODE)).map_or(0, |bytes| number(&bytes) as u16);
    let explained = reached.explained(code);
    let message = format!("{} stays in Fault: {explained}", reached.words());
    let help = format!("its cause is still there: {}", explained.next);
    Err(Failure::new(Exit::DeviceFault, message, help))
}

/// Out of any state in which the power stage is on; the statusword afterwards.
pub(super) fn disable_voltage(
    is_dry: bool,
    reached: &mut DeviceHandle,
    word: u16,
    output: &mut Output,
) -> Result<u16, Failure> {
    let is_on = |word: u16| is_powered(Statusword(word));
    if !is_on(word) {
        let message = format!(
            "{} is in {}: its power stage is off already; nothing was written",
            reached.words(),
            state_words(word)
        );
        return Err(Failure::new(Exit::Usage, message, "leave out --disable-voltage"));
    }
    let words = [Command::DisableVoltage];
    let after = write_words(is_dry, reached, &words, "taking its torque away", is_on, output)?;
    if is_dry || !is_on(after) {
        return Ok(after);
    }
    let message = format!("{} stays in {}: it may still make torque", reached.words(), state_words(after));
    let help = "use the emergency stop if it moves; a master that sends process data overwrites the controlword, so end its program";
    Err(Failure::new(Exit::SafetyStop, message, help))
}

/// Writes controlwords one after another, and waits a second for the drive to leave the states for which `stays` is true. Returns
/// its statusword then.
fn write_words(
    is_dry: bool,
    reached: &mut DeviceHandle,
    words: &[Command],
    doing: &str,
    stays: impl Fn(u16) -> bool,
    output: &mut Output,
) -> Result<u16, Failure> {
    let words: Vec<u16> = words.iter().map(|command| command.controlword()).collect();
    let at = reached.at(CONTROLWORD);
    if is_dry {
        let each: Vec<_> =
            words.iter().map(|word| format!("would write {:04X}h:0 controlword {word:04X}h", at.index)).collect();
        output.news(&each.join("\n"))?;
        return statusword(reached);
    }
    for word in words {
        let written = reached.objects()?.write(at, &word.to_le_bytes());
        written.map_err(|error| reached.failure(doing, error))?;
    }
    for _ in 0..LOOKS {
        let word = statusword(reached)?;
        if !stays(word) {
            return Ok(word);
        }
        reached.pause(LOOK)?;
    }
    statusword(reached)
}
