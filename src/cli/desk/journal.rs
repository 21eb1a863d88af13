//! What a command changes in the devices of a rig on a bus: on disk before anything is written, and given back when the command ends.
//!
//! A process that is killed leaves its journal open. Until it is closed no command that moves a rig goes to the same interfaces.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};
use yieldwall_drives::objects;

use super::place::DeviceSession;
use super::reached::DeviceHandle;
use super::segment::SegmentSession;
use super::state::refuse_powered;
use super::words::titled;
use crate::clock::now_unix_s;
use crate::failure::{Exit, Failure};
use crate::interfaces::Interfaces;
use crate::interrupt::{on_interrupt, uninterrupted};
use crate::keep::state_folder;
use crate::output::Output;
use yieldwall_bus::Written;
use yieldwall_config::{Bus, Rig};
use yieldwall_fieldbus::canopen::NmtCommand;
use yieldwall_fieldbus::ethercat::{AlState, AlStatus};
use yieldwall_fieldbus::objects::Address;
use yieldwall_record::trusted;
use yieldwall_service::{Error, WriteOutcome, carry_out, number, plan, sheet_of};

/// What tells a device from others of its kind and from other kinds: vendor, product, serial number.
const IDENTITY: [Address; 3] = [Address::new(0x1018, 1), Address::new(0x1018, 2), Address::new(0x1018, 4)];

/// An open journal.
#[derive(Debug)]
pub(crate) struct Journal {
    path: PathBuf,
    kept: Kept,
}

/// On disk.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Kept {
    /// The command.
    command: String,
    /// Its process, and when that began, in ticks since the computer did: numbers of processes come again.
    process: u32,
    process_began: Option<u64>,
    begun_unix_s: u64,
    /// Of the program.
    version: String,
    devices: Vec<KeptDevice>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct KeptDevice {
    name: String,
    interface: String,
    is_on_ethercat: bool,
    /// Node id, or position.
    number: u16,
    /// 1018h:1, :2 and :4, as far as the device has them.
    identity: [Option<u32>; 3],
    objects: Vec<KeptObject>,
    /// Index and sub-index of objects that cannot be read, and stay as the boot writes them.
    unreadable: Vec<(u16, u8)>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct KeptObject {
    index: u16,
    sub: u8,
    bytes: Vec<u8>,
}

impl Journal {
    /// Reads what a boot is going to write, and keeps what it holds.
    ///
    /// # Errors
    /// If a device does not answer or the journal cannot be kept; then nothing may be written. If one is open already.
    pub(crate) fn begin(
        command: &str,
        (rig, file): (&Rig, &str),
        written: &[Written],
        interfaces: &Interfaces,
    ) -> Result<Self, Failure> {
        refuse_open(rig, file, interfaces)?;
        let is_over = on_interrupt()?;
        let mut devices = Vec::new();
        for (at, (bus, interface)) in rig.buses.values().zip(interfaces.names()).enumerate() {
            let is_on_ethercat = matches!(bus, Bus::Ethercat(_));
            let mut reached: Option<DeviceHandle> = None;
            for written in written.iter().filter(|written| written.bus.index() == at) {
                reach(&mut reached, (interface, is_on_ethercat), written.number, &is_over)?;
                let Some(reached) = &mut reached else { continue };
                let mut unreadable = Vec::new();
                let objects = held(reached, &written.objects, &mut unreadable)?;
                devices.push(KeptDevice {
                    name: written.name.clone(),
                    interface: interface.clone(),
                    is_on_ethercat,
                    number: written.number,
                    identity: identity(reached)?,
                    objects,
                    unreadable,
                });
            }
        }
        let kept = Kept {
            command: command.to_owned(),
            process: std::process::id(),
            process_began: began(std::process::id()),
            begun_unix_s: now_unix_s(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            devices,
        };
        let path = folder()?.join(format!("{}-{}.json", kept.begun_unix_s, kept.process));
        store(&path, &kept).map_err(|error| {
            let message = format!("the journal {}: {error}; nothing was written to the devices", path.display());
            Failure::new(Exit::Usage, message, "make the folder one that can be written")
        })?;
        Ok(Self { path, kept })
    }

    /// The journal that a killed command has left on one of these interfaces.
    ///
    /// # Errors
    /// If the command is at work, and if a journal cannot be read.
    pub(crate) fn left_on(interfaces: &Interfaces) -> Result<Option<Self>, Failure> {
        let Some(folder) = state_folder("journals") else { return Ok(None) };
        for journal in all(&folder)? {
            let is_here = |device: &KeptDevice| interfaces.names().contains(&device.interface);
            if !journal.kept.devices.iter().any(is_here) {
                continue;
            }
            if journal.is_at_work() {
                let Kept { command, process, .. } = &journal.kept;
                let message = format!("`yieldwall {command}` (process {process}) is at work on these devices");
                return Err(Failure::new(Exit::BusUnavailable, message, "wait for its end"));
            }
            return Ok(Some(journal));
        }
        Ok(None)
    }

    /// Closes a journal of devices to which nothing was written.
    pub(crate) fn discard(&self) {
        // One that stays names devices that are as they were.
        let _ = fs::remove_file(&self.path);
    }

    /// Writes into each device what it held, reads it back, and closes the journal. Objects that hold it already are not written. Whoever
    /// wants the program to end waits for it: a device that does not answer is given up by itself.
    ///
    /// # Errors
    /// What could not be given back, by name; the journal stays open.
    pub(crate) fn give_back(self, output: &mut Output) -> Result<(), Failure> {
        let is_over = uninterrupted()?;
        let (mut given, mut lacking) = (Vec::new(), Vec::new());
        let mut reached: Option<DeviceHandle> = None;
        let mut interface = None;
        for device in &self.kept.devices {
            if interface.replace(&device.interface) != Some(&device.interface) {
                reached = None;
            }
            let mut many = 0;
            let ended = give_back(&mut reached, device, &is_over, &mut many, &mut lacking);
            if many > 0 {
                given.push(format!("{} {many}", device.name));
            }
            for (index, sub) in &device.unreadable {
                let at = titled(Address::new(*index, *sub), "");
                output.aside(&format!("{}: {at} could not be read before, and stays as it was written", device.name));
            }
            match ended {
                Ok(()) => {}
                Err(failure) => {
                    let why = failure.report.diagnostics.into_iter().next();
                    let why = why.map_or_else(String::new, |why| {
                        [Some(why.message), why.help].into_iter().flatten().collect::<Vec<_>>().join("; ")
                    });
                    let how_far = if many == 0 { "nothing".to_owned() } else { format!("no more than {many} objects") };
                    lacking.push(format!("{}: {how_far} could be given back: {why}", device.name));
                    reached = None;
                }
            }
        }
        if !given.is_empty() {
            output.aside(&format!("restored  objects as they were before: {}", given.join(", ")));
        }
        if lacking.is_empty() {
            return fs::remove_file(&self.path).map_err(|error| {
                let message =
                    format!("the devices are as they were, and their journal {} stays: {error}", self.path.display());
                Failure::new(Exit::Usage, message, "remove the file")
            });
        }
        let message = format!("not all is as it was before `yieldwall {}`: {}", self.kept.command, lacking.join("; "));
        let help = format!(
            "`yieldwall commission RIG.yaml{} --restore` tries again; no rig moves on this bus before. Where it cannot be, remove {} once the \
             devices are as they should be",
            self.buses(),
            self.path.display()
        );
        Err(Failure::new(Exit::DeviceMismatch, message, help))
    }

    /// Whether its process is still there.
    fn is_at_work(&self) -> bool {
        let Kept { process, process_began, .. } = self.kept;
        process != std::process::id() && process_began.is_some() && began(process) == process_began
    }

    /// What was begun, for a person: `commission of 2026-01-31 12:00:00Z (left 31 objects, right 31 objects)`.
    pub(crate) fn words(&self) -> String {
        let devices =
            self.kept.devices.iter().map(|device| format!("{} {} objects", device.name, device.objects.len()));
        format!(
            "a `yieldwall {}` that did not come to its end has left its journal, {} ({})",
            self.kept.command,
            self.path.display(),
            devices.collect::<Vec<_>>().join(", ")
        )
    }

    /// The interfaces as arguments, with a space before.
    fn buses(&self) -> String {
        let mut interfaces: Vec<&str> = self.kept.devices.iter().map(|device| device.interface.as_str()).collect();
        interfaces.dedup();
        interfaces.iter().map(|interface| format!(" --bus {interface}")).collect()
    }
}

/// Refuses to move a rig while a journal is open on one of its interfaces.
pub(crate) fn refuse_open(rig: &Rig, file: &str, interfaces: &Interfaces) -> Result<(), Failure> {
    let Some(journal) = Journal::left_on(interfaces)? else { return Ok(()) };
    let help = format!(
        "nothing was sent; `yieldwall commission {file} {} --restore` gives the devices back what they held",
        interfaces.arguments(rig)
    );
    Err(Failure::new(Exit::DeviceMismatch, journal.words(), help))
}

fn folder() -> Result<PathBuf, Failure> {
    state_folder("journals").ok_or_else(|| {
        let message = "there is no folder for a journal: neither XDG_STATE_HOME nor HOME is set";
        Failure::new(Exit::Usage, message, "set XDG_STATE_HOME to a folder that is kept")
    })
}

/// On disk, whole or not at all, before anything else is done.
fn store(path: &Path, kept: &Kept) -> io::Result<()> {
    trusted::write(path, serde_json::to_string_pretty(kept)?.as_bytes())
}

/// All journals of a folder, the oldest first.
fn all(folder: &Path) -> Result<Vec<Journal>, Failure> {
    let unreadable = |path: &Path, error: &dyn std::fmt::Display| {
        let message = format!("the journal {}: {error}; it may be of devices that are to be restored", path.display());
        Failure::new(Exit::ConfigInvalid, message, "remove it once the devices are as they should be")
    };
    let entries = match trusted::check(folder).and_then(|()| fs::read_dir(folder)) {
        Ok(entries) => entries,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(unreadable(folder, &error)),
    };
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut paths: Vec<PathBuf> =
        paths.filter(|path| path.extension().is_some_and(|extension| extension == "json")).collect();
    paths.sort();
    let read = |path: PathBuf| {
        let text = trusted::read(&path).map_err(|error| unreadable(&path, &error))?;
        let kept = serde_json::from_str(&text).map_err(|error| unreadable(&path, &error))?;
        Ok(Journal { path, kept })
    };
    paths.into_iter().map(read).collect()
}

/// When a process that is still there began, in ticks since the computer did.
fn began(process: u32) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    began_in(&status)
}

/// The same from its `/proc/PID/stat`: field 22. The name of its program, in brackets, may have any character.
fn began_in(status: &str) -> Option<u64> {
    let (_, fields) = status.rsplit_once(')')?;
    fields.split_whitespace().nth(19)?.parse().ok()
}

/// Comes to a device on an interface, by what was reached there before. One on EtherCAT comes to PRE-OP, also from an error that a boot
/// has left which was broken off.
fn reach(
    reached: &mut Option<DeviceHandle>,
    (interface, is_on_ethercat): (&str, bool),
    number: u16,
    is_over: &Arc<AtomicBool>,
) -> Result<(), Failure> {
    let word = number.to_string();
    if is_on_ethercat {
        let mut desk = match reached.take() {
            Some(DeviceHandle::Device(desk, _)) => desk,
            _ => Box::new(SegmentSession::on_bus(interface, Arc::clone(is_over))?),
        };
        let device = desk.device(&word)?;
        let state = desk.service.state(device.position);
        let (status, _) = state.map_err(|error| desk.failure(&device, "reading its state", error))?;
        if status != AlStatus::new(AlState::PreOperational, false) {
            let changed = desk.service.change_state(device.position, AlState::PreOperational);
            changed.map_err(|error| desk.failure(&device, "asking for PRE-OP", error))?;
        }
        desk.objects(&device)?;
        *reached = Some(DeviceHandle::Device(desk, device));
        return Ok(());
    }
    let mut desk = match reached.take() {
        Some(DeviceHandle::Node(desk, _)) => desk,
        _ => Box::new(DeviceSession::on_bus(interface, None, Arc::clone(is_over))?),
    };
    let node = desk.node(&word)?;
    *reached = Some(DeviceHandle::Node(desk, node));
    Ok(())
}

fn identity(reached: &mut DeviceHandle) -> Result<[Option<u32>; 3], Failure> {
    let [vendor, product, serial] = IDENTITY.map(|at| reached.number_of(at, "reading what it is"));
    Ok([vendor?, product?, serial?])
}

/// What objects hold that can be read; those that cannot are put with the others.
fn held(
    reached: &mut DeviceHandle,
    objects: &[Address],
    unreadable: &mut Vec<(u16, u8)>,
) -> Result<Vec<KeptObject>, Failure> {
    let mut held = Vec::new();
    for at in objects {
        match reached.read(*at) {
            Ok(bytes) => held.push(KeptObject { index: at.index, sub: at.sub, bytes: bytes.to_vec() }),
            Err(Error::Refused(_)) => unreadable.push((at.index, at.sub)),
            Err(error) => return Err(reached.failure("reading its objects", error)),
        }
    }
    Ok(held)
}

/// Gives a device back what it held, and counts the objects that were written.
fn give_back(
    reached: &mut Option<DeviceHandle>,
    device: &KeptDevice,
    is_over: &Arc<AtomicBool>,
    given: &mut usize,
    lacking: &mut Vec<String>,
) -> Result<(), Failure> {
    reach(reached, (&device.interface, device.is_on_ethercat), device.number, is_over)?;
    let Some(reached) = reached else { return Ok(()) };
    if identity(reached)? != device.identity {
        let message = "another device answers now".to_owned();
        return Err(Failure::new(Exit::DeviceMismatch, message, "put the one back that it was"));
    }
    refuse_powered(reached)?;
    rest(reached)?;
    let held: Vec<(Address, Vec<u8>)> = device
        .objects
        .iter()
        .map(|object| (Address::new(object.index, object.sub), object.bytes.clone()))
        // Of modes and states the device tells by itself.
        .filter(|(at, _)| at.index != objects::CONTROLWORD.index)
        .collect();
    let wanted = sheet_of(reached.named().node_id(), &held, None);
    let node_id = reached.named().node_id();
    let plan = plan(&mut *reached.objects()?, node_id, &wanted, Some(&wanted));
    let plan = plan.map_err(|error| reached.failure("comparing its objects", error))?;
    for left_out in &plan.left_out {
        lacking.push(format!("{}: {} {}", device.name, titled(left_out.at, &left_out.name), left_out.why));
    }
    for step in &plan.steps {
        let made = carry_out(&mut *reached.objects()?, step);
        let made = made.map_err(|error| reached.failure(&format!("writing {}", titled(step.at, &step.name)), error))?;
        let is_taken = match made {
            WriteOutcome::Written => true,
            WriteOutcome::Holds(_) => !step.is_final,
            WriteOutcome::Refused(_) => false,
        };
        *given += usize::from(is_taken && step.is_final);
        if !is_taken {
            let was = step.old.as_deref().map_or_else(|| "?".to_owned(), |old| number(old).to_string());
            let to = number(&step.new);
            lacking.push(format!("{}: {} is {was} and was {to}", device.name, titled(step.at, &step.name)));
        }
    }
    Ok(())
}

/// Has a device exchange no process data, which may not change meanwhile. One on EtherCAT was reached so.
fn rest(reached: &mut DeviceHandle) -> Result<(), Failure> {
    let DeviceHandle::Node(desk, node) = reached else { return Ok(()) };
    let sent = desk.service.command(NmtCommand::EnterPreOperational, Some(node.id));
    sent.map_err(|error| desk.failure(node, "asking for Pre-operational", error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_is_told_by_its_number_and_its_begin() {
        let status = "4711 (a) b (c) S 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 4242 20 21";
        assert_eq!(began_in(status), Some(4242));
        assert_eq!(began_in("4711 (x) S 1"), None);
    }

    #[test]
    fn a_journal_that_cannot_be_read_is_named() {
        let folder = std::env::temp_dir().join(format!("yieldwall-journals-{}", std::process::id()));
        assert_eq!(all(&folder).unwrap().len(), 0);
        let kept = Kept {
            command: "jog".to_owned(),
            process: 1,
            process_began: Some(2),
            begun_unix_s: 3,
            version: "0".to_owned(),
            devices: Vec::new(),
        };
        store(&folder.join("1-1.json"), &kept).unwrap();
        let journals = all(&folder).unwrap();
        assert_eq!((journals.len(), &journals[0].kept), (1, &kept));
        #[cfg(target_os = "linux")]
        {
            crate::sample::let_others_write(&folder.join("1-1.json"));
            let failure = all(&folder).unwrap_err();
            assert!(failure.report.diagnostics[0].message.contains("`chmod go-w "), "{failure:?}");
            store(&folder.join("1-1.json"), &kept).unwrap();
        }
        fs::write(folder.join("2-1.json"), "{").unwrap();
        let failure = all(&folder).unwrap_err();
        assert!(failure.report.diagnostics[0].message.contains("2-1.json"), "{failure:?}");
        fs::remove_dir_all(&folder).unwrap();
    }
}
