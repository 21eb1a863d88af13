//! The values that devices held before a program changed them: on disk before anything is written, and restored at the end.
//!
//! ```text
//! Journals::begin      reads what will be written -> a file of the journals' folder
//! Journal::restore     writes the values back, reads each -> the file goes
//! Journals::refuse_left  a file that stayed names the interfaces on which nothing may move
//! ```
//! A process that is killed leaves its journal open. Until somebody restores the devices, nobody should move a rig on their interfaces.

mod device;
#[cfg(test)]
mod tests;

use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};
use thiserror::Error;
use yieldwall_drives::objects;

use crate::{Connect, LeftOut, WriteOutcome, carry_out, number, plan, sheet_of, titled};
use device::Devices;
pub use device::{DeviceError, DevicePlace, is_powered};
use yieldwall_bus::Written;
use yieldwall_fieldbus::objects::Address;
use yieldwall_record::trusted;

/// Journals of a computer, and the begin of a new one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Journals {
    /// Folder of the journals. Without one no journal is found, and none begins.
    pub folder: Option<PathBuf>,
    /// Command that changes the devices, as a person calls it: `jog`.
    pub command: String,
    /// Present time in s since 1970.
    pub now_unix_s: u64,
}

/// An interface of a rig, in the order of its buses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BusInterface {
    /// Name of the interface.
    pub name: String,
    /// It has an EtherCAT segment, and not a CAN bus.
    pub is_on_ethercat: bool,
}

/// An open journal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Journal {
    path: PathBuf,
    kept: Kept,
}

/// Outcome of a restoration.
#[derive(Debug)]
pub struct Restored {
    /// Devices that got something back, each with the number of objects that were written.
    pub devices: Vec<(String, usize)>,
    /// Objects that could not be read before, with their devices. They stay as they were written.
    pub unreadable: Vec<(String, Address)>,
    /// Success if all other objects hold their former values.
    pub end: Result<(), JournalError>,
}

impl Default for Restored {
    /// Nothing had to be restored.
    fn default() -> Self {
        Self { devices: Vec::new(), unreadable: Vec::new(), end: Ok(()) }
    }
}

/// Reason why a journal stops a program, did not begin or stays open.
#[derive(Debug, Error)]
pub enum JournalError {
    /// A program that did not come to its end has left a journal of devices on one of these interfaces. Nothing was sent.
    #[error("{0}")]
    Left(Box<Journal>),
    /// A program is at work on one of these interfaces. Nothing was sent.
    #[error("`yieldwall {command}` (process {process}) is at work on these devices")]
    AtWork {
        /// Its command.
        command: String,
        /// Its process.
        process: u32,
    },
    /// A journal cannot be read, and may be of devices that have to be restored. Nothing was sent.
    #[error("the journal {}: {error}; it may be of devices that are to be restored", path.display())]
    Unreadable {
        /// Its file, or its folder.
        path: PathBuf,
        /// Reason.
        error: io::Error,
    },
    /// There is no folder for a journal. Nothing was written.
    #[error("there is no folder for a journal")]
    NoFolder,
    /// The journal cannot be written. Nothing was written to the devices.
    #[error("the journal {}: {error}; nothing was written to the devices", path.display())]
    NotKept {
        /// Its file.
        path: PathBuf,
        /// Reason.
        error: io::Error,
    },
    /// A device could not be read. Nothing was written to the devices.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// Not all objects hold what they held; the journal stays open.
    #[error("not all is as it was before `yieldwall {command}`: {}", joined(lacking))]
    NotRestored {
        /// Command that changed them.
        command: String,
        /// File of the journal.
        path: PathBuf,
        /// Interfaces of the journal.
        interfaces: Vec<String>,
        /// Objects and devices.
        lacking: Vec<Unrestored>,
    },
    /// All is restored, and the file of the journal cannot be removed.
    #[error("the devices are as they were, and their journal {} stays: {error}", path.display())]
    NotRemoved {
        /// Its file.
        path: PathBuf,
        /// Reason.
        error: io::Error,
    },
}

/// An object or a device that did not get back what it held.
#[derive(Debug, Error)]
pub enum Unrestored {
    /// The object is not for writing.
    #[error("{device}: {} {}", titled(object.at, &object.name), object.why)]
    LeftOut {
        /// Name of the device.
        device: String,
        /// The object.
        object: LeftOut,
    },
    /// The device did not take the value.
    #[error("{device}: {} is {} and was {was}", titled(*at, name), is.map_or_else(|| "?".to_owned(), |is| is.to_string()))]
    Differs {
        /// Name of the device.
        device: String,
        /// The object.
        at: Address,
        /// Name of the object.
        name: String,
        /// Value before the restoration, if it could be read.
        is: Option<u32>,
        /// Value in the journal.
        was: u32,
    },
    /// The device was given up.
    #[error("{}", Self::at_device(device, *restored, error))]
    Device {
        /// Name of the device.
        device: String,
        /// Objects that were restored before.
        restored: usize,
        /// Reason.
        error: DeviceError,
    },
}

impl Unrestored {
    /// The text of [`Unrestored::Device`] with the reason in words of the caller.
    pub fn at_device(device: &str, restored: usize, why: &dyn fmt::Display) -> String {
        let how_far = if restored == 0 { "nothing".to_owned() } else { format!("no more than {restored} objects") };
        format!("{device}: {how_far} could be given back: {why}")
    }
}

fn joined(lacking: &[Unrestored]) -> String {
    lacking.iter().map(Unrestored::to_string).collect::<Vec<_>>().join("; ")
}

/// Content of the file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Kept {
    /// The command.
    command: String,
    /// Its process, and the begin of the process: numbers of processes come again.
    process: u32,
    process_began: Option<u64>,
    begun_unix_s: u64,
    /// Version of the program.
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

impl KeptDevice {
    fn place(&self) -> DevicePlace {
        DevicePlace { interface: self.interface.clone(), is_on_ethercat: self.is_on_ethercat, number: self.number }
    }
}

impl Journals {
    /// The oldest journal that a killed program has left on one of these interfaces.
    ///
    /// # Errors
    /// If the program is at work, and if a journal cannot be read.
    pub fn left_on(&self, interfaces: &[String]) -> Result<Option<Journal>, JournalError> {
        let Some(folder) = &self.folder else { return Ok(None) };
        let is_here = |journal: &Journal| journal.kept.devices.iter().any(|one| interfaces.contains(&one.interface));
        let Some(journal) = all(folder)?.into_iter().find(is_here) else { return Ok(None) };
        if journal.is_at_work() {
            let Kept { command, process, .. } = journal.kept;
            return Err(JournalError::AtWork { command, process });
        }
        Ok(Some(journal))
    }

    /// Refuses interfaces on which a journal is open.
    ///
    /// # Errors
    /// [`JournalError::Left`], and as [`Journals::left_on`].
    pub fn refuse_left(&self, interfaces: &[String]) -> Result<(), JournalError> {
        self.left_on(interfaces)?.map_or(Ok(()), |journal| Err(JournalError::Left(Box::new(journal))))
    }

    /// Reads the objects that will be written, and keeps their values on disk. `interfaces` are those of the rig's buses, in their order.
    /// On EtherCAT the devices are in PRE-OP afterwards. Reading ends when `is_over` is set.
    ///
    /// # Errors
    /// If a device does not answer or the journal cannot be kept; then nothing may be written.
    pub fn begin(
        &self,
        written: &[Written],
        interfaces: &[BusInterface],
        connect: &mut (impl Connect + ?Sized),
        is_over: &Arc<AtomicBool>,
    ) -> Result<Journal, JournalError> {
        let mut reach = Devices::new(connect, is_over);
        let mut devices = Vec::new();
        for (at, interface) in interfaces.iter().enumerate() {
            for written in written.iter().filter(|written| written.bus.index() == at) {
                let BusInterface { name, is_on_ethercat } = interface.clone();
                let place = DevicePlace { interface: name, is_on_ethercat, number: written.number };
                devices.push(kept(&mut reach, place, written)?);
            }
        }
        let process = std::process::id();
        let kept = Kept {
            command: self.command.clone(),
            process,
            process_began: began(process),
            begun_unix_s: self.now_unix_s,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            devices,
        };
        let folder = self.folder.as_ref().ok_or(JournalError::NoFolder)?;
        let path = folder.join(format!("{}-{process}.json", kept.begun_unix_s));
        match store(&path, &kept) {
            Ok(()) => Ok(Journal { path, kept }),
            Err(error) => Err(JournalError::NotKept { path, error }),
        }
    }
}

impl Journal {
    /// Closes a journal of devices to which nothing was written.
    pub fn discard(self) {
        // A file that stays names devices that are as they were.
        let _ = fs::remove_file(&self.path);
    }

    /// Writes into each device what it held, reads it back, and closes the journal. Objects that hold it already are not written. A device
    /// that does not answer is given up by itself, and nothing else ends the restoration.
    pub fn restore(self, connect: &mut (impl Connect + ?Sized)) -> Restored {
        let is_over = Arc::default();
        let mut reach = Devices::new(connect, &is_over);
        let (mut devices, mut unreadable, mut lacking) = (Vec::new(), Vec::new(), Vec::new());
        for device in &self.kept.devices {
            let mut count = 0;
            let restored = restore(&mut reach, device, &mut count, &mut lacking);
            if count > 0 {
                devices.push((device.name.clone(), count));
            }
            let of_device = device.unreadable.iter();
            unreadable.extend(of_device.map(|(index, sub)| (device.name.clone(), Address::new(*index, *sub))));
            if let Err(error) = restored {
                lacking.push(Unrestored::Device { device: device.name.clone(), restored: count, error });
                reach.close();
            }
        }
        let Self { path, kept } = self;
        let end = if lacking.is_empty() {
            fs::remove_file(&path).map_err(|error| JournalError::NotRemoved { path, error })
        } else {
            let mut interfaces: Vec<String> = kept.devices.into_iter().map(|device| device.interface).collect();
            interfaces.dedup();
            Err(JournalError::NotRestored { command: kept.command, path, interfaces, lacking })
        };
        Restored { devices, unreadable, end }
    }

    /// Its process is still there.
    fn is_at_work(&self) -> bool {
        let Kept { process, process_began, .. } = self.kept;
        process != std::process::id() && process_began.is_some() && began(process) == process_began
    }
}

/// The command, the file and the devices, for a person.
impl fmt::Display for Journal {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let devices =
            self.kept.devices.iter().map(|device| format!("{} {} objects", device.name, device.objects.len()));
        write!(
            out,
            "a `yieldwall {}` that did not come to its end has left its journal, {} ({})",
            self.kept.command,
            self.path.display(),
            devices.collect::<Vec<_>>().join(", ")
        )
    }
}

/// Writes a journal to disk, whole or not at all, before anything else is done.
fn store(path: &Path, kept: &Kept) -> io::Result<()> {
    trusted::write(path, serde_json::to_string_pretty(kept)?.as_bytes())
}

/// All journals of a folder, the oldest first.
fn all(folder: &Path) -> Result<Vec<Journal>, JournalError> {
    let unreadable = |path: &Path, error| JournalError::Unreadable { path: path.to_owned(), error };
    let entries = match trusted::check(folder).and_then(|()| fs::read_dir(folder)) {
        Ok(entries) => entries,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(unreadable(folder, error)),
    };
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut paths: Vec<PathBuf> =
        paths.filter(|path| path.extension().is_some_and(|extension| extension == "json")).collect();
    paths.sort();
    let read = |path: PathBuf| {
        let text = trusted::read(&path).map_err(|error| unreadable(&path, error))?;
        let kept = serde_json::from_str(&text).map_err(|error| unreadable(&path, error.into()))?;
        Ok(Journal { path, kept })
    };
    paths.into_iter().map(read).collect()
}

/// Begin of a process that still runs, in ticks since the computer started.
fn began(process: u32) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    began_in(&status)
}

/// Field 22 of `/proc/PID/stat`. The name of the program, in brackets, may have any character.
fn began_in(status: &str) -> Option<u64> {
    let (_, fields) = status.rsplit_once(')')?;
    fields.split_whitespace().nth(19)?.parse().ok()
}

/// Reads the objects of a device that will be written.
fn kept<C: Connect + ?Sized>(
    reach: &mut Devices<'_, C>,
    place: DevicePlace,
    written: &Written,
) -> Result<KeptDevice, DeviceError> {
    let mut device = reach.reach(&place)?;
    let (mut objects, mut unreadable) = (Vec::new(), Vec::new());
    for at in &written.objects {
        match device.read(*at, "reading its objects")? {
            Some(bytes) => objects.push(KeptObject { index: at.index, sub: at.sub, bytes }),
            None => unreadable.push((at.index, at.sub)),
        }
    }
    let identity = device.identity()?;
    let DevicePlace { interface, is_on_ethercat, number } = place;
    Ok(KeptDevice { name: written.name.clone(), interface, is_on_ethercat, number, identity, objects, unreadable })
}

/// Gives a device back what it held, and counts the objects that were written.
fn restore<C: Connect + ?Sized>(
    reach: &mut Devices<'_, C>,
    kept: &KeptDevice,
    count: &mut usize,
    lacking: &mut Vec<Unrestored>,
) -> Result<(), DeviceError> {
    let mut device = reach.reach(&kept.place())?;
    if device.identity()? != kept.identity {
        return Err(DeviceError::OtherDevice);
    }
    device.refuse_powered()?;
    device.rest()?;
    let held: Vec<(Address, Vec<u8>)> = kept
        .objects
        .iter()
        .map(|object| (Address::new(object.index, object.sub), object.bytes.clone()))
        // The device tells modes and states by itself.
        .filter(|(at, _)| at.index != objects::CONTROLWORD.index)
        .collect();
    let wanted = sheet_of(device.node_id(), &held, None);
    let node_id = device.node_id();
    let plan = plan(&mut *device.objects()?, node_id, &wanted, Some(&wanted));
    let plan = plan.map_err(|error| device.failed("comparing its objects", error))?;
    lacking.extend(plan.left_out.into_iter().map(|object| Unrestored::LeftOut { device: kept.name.clone(), object }));
    for step in &plan.steps {
        let made = carry_out(&mut *device.objects()?, step);
        let made = made.map_err(|error| device.failed(format!("writing {}", titled(step.at, &step.name)), error))?;
        let is_taken = match made {
            WriteOutcome::Written => true,
            WriteOutcome::Holds(_) => !step.is_final,
            WriteOutcome::Refused(_) => false,
        };
        *count += usize::from(is_taken && step.is_final);
        if !is_taken {
            let (is, was) = (step.old.as_deref().map(number), number(&step.new));
            let (device, name) = (kept.name.clone(), step.name.clone());
            lacking.push(Unrestored::Differs { device, at: step.at, name, is, was });
        }
    }
    Ok(())
}
