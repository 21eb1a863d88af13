//! `yieldwall reg`: registers of a device on EtherCAT.

use serde_json::json;

use super::place::BusArguments;
use super::segment::{Device, SegmentSession};
use super::words::{hexadecimal, table};
use crate::failure::{Exit, Failure};
use crate::output::Output;
use yieldwall_bus::ethercat::SegmentFailure;
use yieldwall_config::nearest_word;
use yieldwall_fieldbus::ethercat::registers::{self as register, NAMED};
use yieldwall_fieldbus::ethercat::{AlStatus, AlStatusCode, u16_at};
use yieldwall_service::{Bytes, SegmentError};

#[derive(Debug, clap::Subcommand)]
pub(crate) enum Command {
    /// Read registers
    Read(Read),
    /// Write one register and read it back; the value is lost at power-off
    Write(Write),
}

#[derive(Debug, clap::Args)]
pub(crate) struct Read {
    /// EtherCAT position, or device name from the rig
    node: String,
    /// Registers by address (0130h) or by name (al-status); default: all that have a name
    registers: Vec<String>,
    /// Bytes of each register; default: the length of the named register, or 2
    #[arg(long, value_name = "BYTES", value_parser = clap::value_parser!(u16).range(1..=1024), requires = "registers")]
    length: Option<u16>,
    #[command(flatten)]
    place: BusArguments,
}

#[derive(Debug, clap::Args)]
pub(crate) struct Write {
    /// EtherCAT position, or device name from the rig
    node: String,
    /// Register by address (0420h) or by name (watchdog-sync-manager)
    register: String,
    /// New value: decimal, or hexadecimal after 0x
    value: String,
    /// Bytes to write; default: the length of the named register, or 2
    #[arg(long, value_name = "BYTES", value_parser = clap::value_parser!(u16).range(1..=8))]
    length: Option<u16>,
    /// Print what would be written, and write nothing
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    place: BusArguments,
}

/// Bytes of a register that has no name.
const USUAL_LENGTH: usize = 2;

/// The selected register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Register {
    pub(super) address: u16,
    pub(super) len: usize,
    pub(super) name: &'static str,
}

pub(crate) fn run(command: &Command, output: &mut Output) -> Result<(), Failure> {
    match command {
        Command::Read(arguments) => read(arguments, output),
        Command::Write(arguments) => write(arguments, output),
    }
}

/// Returns the register for a word.
pub(super) fn meant(word: &str, length: Option<u16>) -> Result<Register, Failure> {
    let lower = word.to_ascii_lowercase();
    let by_name = NAMED.iter().find(|(_, _, name)| *name == lower);
    let has_mark = lower.starts_with("0x") || lower.ends_with('h') || lower.len() == 4;
    let by_address = || hexadecimal(&lower).filter(|_| has_mark).and_then(|number| u16::try_from(number).ok());
    let (address, known) = match by_name {
        Some((address, len, name)) => (*address, Some((*len, *name))),
        None => {
            let Some(address) = by_address() else {
                let help = match nearest_word(word, NAMED.iter().map(|(_, _, name)| *name)) {
                    Some(near) => format!("did you mean {near}?"),
                    None => {
                        "write its address, as 0130h, or a name; `yieldwall reg read NODE` lists the names".to_owned()
                    }
                };
                return Err(Failure::new(Exit::Usage, format!("no register is called {word}"), help));
            };
            let known = NAMED.iter().find(|(known, _, _)| *known == address);
            (address, known.map(|(_, len, name)| (*len, *name)))
        }
    };
    let (len, name) = known.unwrap_or((USUAL_LENGTH, ""));
    Ok(Register { address, len: length.map_or(len, usize::from), name })
}

fn read(arguments: &Read, output: &mut Output) -> Result<(), Failure> {
    let registers: Vec<Register> = match arguments.registers.as_slice() {
        [] => NAMED.iter().map(|(address, len, name)| Register { address: *address, len: *len, name }).collect(),
        words => words.iter().map(|word| meant(word, arguments.length)).collect::<Result<_, _>>()?,
    };
    let mut desk = SegmentSession::only(&arguments.place, output)?;
    let device = desk.device(&arguments.node)?;
    let mut read = Vec::new();
    for register in registers {
        let doing = format!("reading register {:04X}h", register.address);
        match desk.service.read(device.position, register.address, register.len) {
            Ok(bytes) => read.push((register, bytes)),
            // Not every controller has all of those that have a name.
            Err(SegmentError::Failed(SegmentFailure::NotProcessed { .. })) if arguments.registers.is_empty() => {}
            Err(error) => return Err(desk.failure(&device, &doing, error)),
        }
    }
    if output.is_json() {
        let registers: Vec<_> = read.iter().map(|(register, bytes)| document(*register, bytes)).collect();
        return output.report(json!({ "place": desk.place, "position": device.position, "registers": registers }));
    }
    output.result(&text(&device, &read))
}

/// Returns the reason if this command does not write a register, and the command that does.
fn refusal(register: Register) -> Option<(&'static str, &'static str)> {
    let (first, end) = (register.address, usize::from(register.address) + register.len);
    let touches = |from: u16, to: u16| first < to && end > from.into();
    if touches(register::AL_CONTROL, register::AL_STATUS) {
        return Some(("the AL state is asked for there", "`yieldwall state NODE init|preop|safeop|ack` does that"));
    }
    if touches(register::SII_CONFIGURATION, register::FMMU) {
        return Some(("the memory chip is reached there", "`yieldwall sii write` and `yieldwall alias` write it"));
    }
    (end > register::PROCESS_DATA.into()).then_some((
        "process data and mailboxes lie there",
        "`yieldwall run` sends process data, and `yieldwall od write` objects",
    ))
}

fn write(arguments: &Write, output: &mut Output) -> Result<(), Failure> {
    let register = meant(&arguments.register, arguments.length)?;
    let title = format!("{:04X}h {}", register.address, register.name).trim_end().to_owned();
    if let Some((why, help)) = refusal(register) {
        return Err(Failure::new(Exit::Usage, format!("{title}: not written: {why}"), help));
    }
    let number = match arguments.value.strip_prefix("0x") {
        Some(digits) => u64::from_str_radix(digits, 16).ok(),
        None => arguments.value.parse().ok(),
    };
    let number = number.filter(|number| register.len >= 8 || number >> (8 * register.len) == 0);
    let number = number.ok_or_else(|| {
        let message = format!("{title}: {} is no number of {} bytes", arguments.value, register.len);
        Failure::new(Exit::Usage, message, "write a decimal number, or a hexadecimal one behind 0x")
    })?;
    let new = number.to_le_bytes().into_iter().take(register.len).collect::<Bytes>();
    let mut desk = SegmentSession::only(&arguments.place, output)?;
    let device = desk.device(&arguments.node)?;
    desk.refuse_led()?;
    let doing = format!("writing register {title}");
    let old = desk.service.read(device.position, register.address, register.len);
    let old = old.map_err(|error| desk.failure(&device, &doing, error))?;
    let mut end = Ok(());
    if !arguments.dry_run {
        let written = desk.service.write(device.position, register.address, &new);
        written.map_err(|error| desk.failure(&device, &doing, error))?;
        let held = desk.service.read(device.position, register.address, register.len);
        let held = held.map_err(|error| desk.failure(&device, &doing, error))?;
        if held != new {
            let message = format!("{}: {doing}: it holds {} afterwards", device.words(), value(&held));
            end = Err(Failure::new(Exit::DeviceMismatch, message, "a master may not write all bits of all registers"));
        }
    }
    if output.is_json() {
        let document = json!({
            "place": desk.place,
            "position": device.position,
            "dry_run": arguments.dry_run,
            "register": format!("{:04X}h", register.address),
            "name": register.name,
            "old": value(&old),
            "new": value(&new),
        });
        return output.end(document, end);
    }
    let word = if arguments.dry_run { "would write" } else { "wrote" };
    output.result(&format!("{word:11} {title}\n    {} -> {}\n", value(&old), value(&new)))?;
    end
}

fn text(device: &Device, read: &[(Register, Bytes)]) -> String {
    let rows: Vec<[String; 4]> = read
        .iter()
        .map(|(register, bytes)| {
            let means = meaning(*register, bytes).unwrap_or_default();
            [format!("{:04X}h", register.address), register.name.to_owned(), value(bytes), means]
        })
        .collect();
    format!("{}\n{}", device.words(), table(&rows))
}

/// Formats up to eight bytes as a number, and more bytes as they are.
pub(super) fn value(bytes: &[u8]) -> String {
    if matches!(bytes.len(), 1 | 2 | 4 | 8) {
        let number: String = bytes.iter().rev().map(|byte| format!("{byte:02X}")).collect();
        return format!("{number}h");
    }
    bytes.iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(" ")
}

fn meaning(register: Register, bytes: &[u8]) -> Option<String> {
    let word = u16_at(bytes, 0);
    match register.address {
        register::AL_STATUS => Some(AlStatus::from_register(word).to_string()),
        register::AL_STATUS_CODE if word != 0 => Some(AlStatusCode(word).meaning().to_owned()),
        register::STATION_ADDRESS | register::STATION_ALIAS => Some(word.to_string()),
        register::DL_STATUS => {
            let ports: Vec<String> =
                (0..4).filter(|port| word & 1 << (4 + port) != 0).map(|port: u16| port.to_string()).collect();
            Some(format!("links at ports {}", if ports.is_empty() { "none".to_owned() } else { ports.join(", ") }))
        }
        _ => None,
    }
}

fn document(register: Register, bytes: &[u8]) -> serde_json::Value {
    let hexadecimal: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    json!({
        "register": format!("{:04X}h", register.address),
        "name": register.name,
        "bytes": hexadecimal,
        "value": value(bytes),
        "means": meaning(register, bytes),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_register_is_meant_by_its_address_or_its_name() {
        let status = Register { address: 0x0130, len: 2, name: "al-status" };
        for word in ["0130h", "0x130", "0130", "al-status", "AL-Status"] {
            assert_eq!(meant(word, None).unwrap(), status, "{word}");
        }
        assert_eq!(meant("0900h", Some(16)).unwrap(), Register { address: 0x0900, len: 16, name: "" });
        for word in ["", "130", "10000h", "al-statsu", "-1"] {
            assert_eq!(meant(word, None).unwrap_err().exit, Exit::Usage, "{word}");
        }
    }

    #[test]
    fn what_other_commands_write_is_refused() {
        for (word, is_refused) in [
            ("al-control", true),
            ("011Fh", true),
            ("0132h", false),
            ("0508h", true),
            ("1000h", true),
            ("0fffh", true),
            ("watchdog-sync-manager", false),
            ("station-address", false),
        ] {
            assert_eq!(refusal(meant(word, None).unwrap()).is_some(), is_refused, "{word}");
        }
    }

    #[test]
    fn values_are_numbers_the_lowest_byte_first_on_the_wire() {
        assert_eq!(value(&[0x34, 0x12]), "1234h");
        assert_eq!(value(&[1, 2, 3]), "01 02 03");
    }
}
