//! Result of a drill, kept for the next runs with the same drives and the same configuration.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use thiserror::Error;

use super::drilled::{Demands, Drilled, Finding, Unsafe};
use super::error::RunError;
use super::pace::Pace;
use super::permit::{Bounds, Permit};
use super::place::Place;
use super::runner::Runner;
use crate::assembly::torque_limits_per_mille;
use yieldwall_config as config;
use yieldwall_drives::profiles::{CurrentLimit, LimitSetter, TorqueLimit};
use yieldwall_drives::watchdog::Watchdog;
use yieldwall_fieldbus::objects::Address;
use yieldwall_motion::guard::Device;
use yieldwall_record::trusted;

/// Identity of a drive, as the drive reports it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DriveIdentity {
    /// Node ID; `None` on a segment, where the serial number identifies the drive.
    pub node_id: Option<u8>,
    /// Vendor, 1018h:1.
    pub vendor_id: u32,
    /// Product code, 1018h:2.
    pub product_code: u32,
    /// Revision, 1018h:3.
    pub revision: u32,
    /// Serial number, 1018h:4.
    pub serial_number: u32,
}

/// Subject of a drill: the drives, and all of the configuration that their watchdogs depend on.
#[derive(Clone, Debug, PartialEq)]
pub struct Subject {
    drives: [DriveIdentity; 2],
    configuration: Value,
    demands: Demands,
}

/// A drill's record on disk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Record {
    drives: [DriveIdentity; 2],
    configuration: Value,
    /// By name of the watchdog: time in ms after which the left and the right drive stopped.
    stopped_after_ms: Vec<(String, [Option<f64>; 2])>,
    resolution_ms: f64,
    version: String,
}

/// Why a rig on a real bus must not be enabled.
#[derive(Debug, Error)]
pub enum Unproven {
    /// There is no record.
    #[error("no watchdog drill is on record for these drives with this configuration ({})", .path.display())]
    Missing {
        /// Expected path of the record.
        path: PathBuf,
    },
    /// The record cannot be read.
    #[error("{}: {reason}", .path.display())]
    Unreadable {
        /// Its file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// The drill has shown that a drive does not stop, or not soon enough.
    #[error("the watchdog drill: {0}")]
    Unsafe(#[from] Unsafe),
}

/// Source of the proof that the drives of a rig stop by themselves.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Proof {
    /// In virtual time, by a drill of the same simulated drives, for lockstep, in which no drill is possible. The drives on the bus
    /// report that they are simulated (2012h), and whether they lack a watchdog.
    InVirtualTime(Drilled),
    /// In the records of drills on a bus, which are in this folder.
    OnRecord(PathBuf),
}

/// Why a rig may not be enabled.
#[derive(Debug, Error)]
pub enum NotProven {
    /// The drives do not report their identity, or are simulated for another pace.
    #[error(transparent)]
    Run(#[from] RunError),
    /// There is no proof that the drives stop by themselves.
    #[error(transparent)]
    Unproven(#[from] Unproven),
}

impl<P: Place + ?Sized> Runner<P> {
    /// Asks the drives of a booted network for their identities, and looks for the proof that such drives stop by themselves. The
    /// permit is of this boot.
    ///
    /// # Errors
    /// Why the rig may not be enabled.
    pub fn prove(&mut self, rig: &config::Rig, proof: &Proof) -> Result<Permit, NotProven> {
        self.check_simulation()?;
        match proof {
            // What the drives were asked makes sure that they are simulated ones in lockstep.
            Proof::InVirtualTime(drilled) if self.pace() == Pace::Lockstep => {
                drilled.judge(Demands::of(rig)).map_err(Unproven::from)?;
                Ok(Permit::proved(self))
            }
            Proof::InVirtualTime(_) => Err(RunError::NotSimulated { which: self.which(Device::LeftDrive) }.into()),
            Proof::OnRecord(drills) => {
                Subject::new(rig, self.identities()?).check(drills)?;
                Ok(Permit::proved(self))
            }
        }
    }
}

impl<P: Place + ?Sized> Runner<P> {
    /// Proves the watchdogs as [`Runner::prove`] does, for the first motion of a rig: the permit is for a small motion with little
    /// torque. Each drive gets its torque limit, which holds in every command mode until the network is booted anew. So no other
    /// permit of this boot allows more torque. A drive that stops has no more torque either.
    ///
    /// # Errors
    /// Why the rig may not be enabled; [`RunError::NoTorqueLimit`] for a drive that takes no limit.
    pub fn prove_for_bring_up(
        &mut self,
        rig: &config::Rig,
        proof: &Proof,
        bounds: Bounds,
    ) -> Result<Permit, NotProven> {
        self.prove(rig, proof)?;
        self.limit_torque(rig, bounds.torque_n_m)?;
        Ok(Permit::bounded(self, bounds))
    }

    /// Sets the torque limit of both drives, at most the rig's own, and that of the controllers, which then do not count on more.
    /// If a drive keeps its own limit, that limit must not be higher, unless a person has confirmed it.
    pub(crate) fn limit_torque(&mut self, rig: &config::Rig, most: config::Positive) -> Result<(), RunError> {
        self.master.cycle_mut().lower_torque(most.get());
        let mut limited = rig.clone();
        if most.get() < rig.guard.torque_limit_n_m.get() {
            limited.guard.torque_limit_n_m = most;
        }
        let per_mille = torque_limits_per_mille(&limited)?;
        for (device, per_mille) in Device::DRIVES.into_iter().zip(per_mille) {
            match torque_limit_of(rig, device) {
                None if self.accepts_drive_limits => {}
                None => return Err(RunError::NoTorqueLimit { which: self.which(device) }),
                Some(TorqueLimit::PerMille(_)) => self.put_torque_limit(rig, device, Some(per_mille.into()))?,
                Some(TorqueLimit::Current(current)) if current.set_by == LimitSetter::Master => {
                    let rated = self.read(device, current.rated.index, current.rated.sub)?;
                    self.put_torque_limit(rig, device, Some(CurrentLimit::value(per_mille, rated)))?;
                }
                Some(TorqueLimit::Current(current)) => {
                    let own = self.kept_limit(rig, device, current)?;
                    if own.per_mille > u32::from(per_mille) && !self.accepts_drive_limits {
                        let (own_n_m, most_n_m) = (own.torque_n_m, limited.guard.torque_limit_n_m.get());
                        return Err(RunError::DriveLimit { which: self.which(device), own_n_m, most_n_m });
                    }
                }
            }
        }
        Ok(())
    }

    /// Returns the torque limit of a drive whose limit the master does not set.
    pub(crate) fn drive_limit(&mut self, rig: &config::Rig, device: Device) -> Result<DriveLimit, RunError> {
        match torque_limit_of(rig, device) {
            None => Ok(DriveLimit::Untold),
            Some(TorqueLimit::Current(current)) if current.set_by == LimitSetter::Drive => {
                Ok(DriveLimit::Kept(self.kept_limit(rig, device, current)?))
            }
            Some(_) => Ok(DriveLimit::OfMaster),
        }
    }

    fn kept_limit(&mut self, rig: &config::Rig, device: Device, current: &CurrentLimit) -> Result<KeptLimit, RunError> {
        let held = self.read(device, current.limit.index, current.limit.sub)?;
        let rated = self.read(device, current.rated.index, current.rated.sub)?;
        let per_mille = CurrentLimit::per_mille(held, rated);
        let torque_n_m = f64::from(per_mille) * 1e-3 * rated_n_m(rig, device);
        // As a person finds it in the device.
        let model = drive_of(rig, device).and_then(|drive| rig.model(drive));
        let index = model.map(|model| model.offset()).unwrap_or_default().index(current.limit.index);
        Ok(KeptLimit { at: Address::new(index, current.limit.sub), held, per_mille, torque_n_m })
    }

    /// Returns the largest torque of a drive at its joint by its present limit, N m; the rig's own limit if no object holds it.
    pub(crate) fn torque_limit_n_m(&mut self, rig: &config::Rig, device: Device) -> Result<f64, RunError> {
        match torque_limit_of(rig, device) {
            None => Ok(rig.guard.torque_limit_n_m.get()),
            Some(TorqueLimit::Current(current)) => Ok(self.kept_limit(rig, device, current)?.torque_n_m),
            Some(TorqueLimit::PerMille(limit)) => {
                let per_mille = self.read(device, limit.index, limit.sub)?;
                Ok(f64::from(per_mille) * 1e-3 * rated_n_m(rig, device))
            }
        }
    }

    /// Returns the torque limit of a drive, in the unit of its object; `None` for a drive that keeps its own.
    pub(crate) fn torque_limit(&mut self, rig: &config::Rig, device: Device) -> Result<Option<u32>, RunError> {
        let limit = torque_limit_of(rig, device).filter(|limit| limit.set_by() == LimitSetter::Master);
        let Some(object) = limit.map(TorqueLimit::object) else { return Ok(None) };
        self.read(device, object.index, object.sub).map(Some)
    }

    /// Sets a drive's torque limit, in the unit of its object, and checks that it was accepted; a drive that keeps its own gets
    /// none.
    pub(crate) fn put_torque_limit(
        &mut self,
        rig: &config::Rig,
        device: Device,
        value: Option<u32>,
    ) -> Result<(), RunError> {
        let limit = torque_limit_of(rig, device).filter(|limit| limit.set_by() == LimitSetter::Master);
        let Some((object, value)) = limit.map(TorqueLimit::object).zip(value) else { return Ok(()) };
        let bytes = value.to_le_bytes();
        let bytes = bytes.get(..usize::from(object.bytes())).unwrap_or(&bytes);
        self.write(device, Address::new(object.index, object.sub), bytes)?;
        let has_taken = self.read(device, object.index, object.sub)? == value;
        if has_taken { Ok(()) } else { Err(RunError::NoTorqueLimit { which: self.which(device) }) }
    }
}

/// Returns the torque limit of a drive by its profile; `None` if the profile names none.
fn torque_limit_of(rig: &config::Rig, device: Device) -> Option<TorqueLimit<'_>> {
    let profile = drive_of(rig, device)?.profile.get()?;
    profile.servo()?.limits.of_torque()
}

/// The owner of a drive's torque limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum DriveLimit {
    /// The master sets it.
    OfMaster,
    /// The drive keeps it.
    Kept(KeptLimit),
    /// No object holds it.
    Untold,
}

/// A torque limit that a drive keeps by itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct KeptLimit {
    /// Its object, and what that holds.
    pub(crate) at: Address,
    pub(crate) held: u32,
    /// The torque that it allows, per mille of rated, and at the joint in N m.
    pub(crate) per_mille: u32,
    pub(crate) torque_n_m: f64,
}

fn rated_n_m(rig: &config::Rig, device: Device) -> f64 {
    drive_of(rig, device).map_or(0.0, |drive| drive.rated_torque_n_m.get())
}

fn drive_of(rig: &config::Rig, device: Device) -> Option<&config::Drive> {
    Device::DRIVES.iter().position(|one| *one == device).and_then(|at| rig.drives.get(at))
}

impl<P: Place + ?Sized> Runner<P> {
    /// Proves as [`Runner::prove_for_bring_up`], in a place where no real drive moves and nothing has to be proved.
    ///
    /// # Errors
    /// [`RunError::NotVirtual`] if the rig was not made [in virtual time](Runner::in_virtual_time).
    /// [`RunError::NoTorqueLimit`] for a drive that takes no limit.
    pub fn bring_up_in_virtual_time(&mut self, rig: &config::Rig, bounds: Bounds) -> Result<Permit, RunError> {
        if !self.is_virtual {
            return Err(RunError::NotVirtual);
        }
        self.limit_torque(rig, bounds.torque_n_m)?;
        Ok(Permit::bounded(self, bounds))
    }
}

impl Subject {
    /// Creates the subject of these drives in this rig.
    pub fn new(rig: &config::Rig, drives: [DriveIdentity; 2]) -> Self {
        let mut configuration = json!({
            "command_mode": rig.rig.command_mode,
            "period_us": rig.cycle.period_us,
            "master": rig.own_node().map(|own| json!({ "node_id": own.node_id, "heartbeat_ms": own.heartbeat_ms })),
            "drives": rig.drives,
            "torque_limit_n_m": rig.guard.torque_limit_n_m,
            "profiles": rig.drives.each_ref().map(|drive| drive.profile.get().map(|profile| &**profile)),
        });
        // How long the master waits is nothing to a watchdog.
        for drive in configuration["drives"].as_array_mut().into_iter().flatten().filter_map(Value::as_object_mut) {
            drive.retain(|key, _| !matches!(key.as_str(), "waits" | "enabling_ms"));
        }
        Self { drives, configuration, demands: Demands::of(rig) }
    }

    /// Returns the file of its record in a folder of records.
    fn path(&self, folder: &Path) -> PathBuf {
        let text = json!([self.drives, self.configuration]).to_string();
        folder.join(format!("{:016x}.json", fnv1a(text.as_bytes())))
    }

    /// Stores the result of a drill, and returns the path.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn store(&self, drilled: &Drilled, folder: &Path) -> io::Result<PathBuf> {
        let ms = |time: Duration| 1e3 * time.as_secs_f64();
        let of =
            |finding: &Finding| (finding.watchdog.name().to_owned(), finding.stopped_after.map(|after| after.map(ms)));
        let record = Record {
            drives: self.drives,
            configuration: self.configuration.clone(),
            stopped_after_ms: drilled.findings.iter().map(of).collect(),
            resolution_ms: ms(drilled.resolution),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        };
        let path = self.path(folder);
        // Whole or not at all: a drill that is cut off proves nothing.
        trusted::write(&path, serde_json::to_string_pretty(&record)?.as_bytes())?;
        Ok(path)
    }

    /// Checks whether a drill on record permits this rig to be enabled.
    ///
    /// # Errors
    /// Why not.
    pub fn check(&self, folder: &Path) -> Result<(), Unproven> {
        let path = self.path(folder);
        let unreadable = |reason: String| Unproven::Unreadable { path: path.clone(), reason };
        let text = match trusted::read(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(Unproven::Missing { path }),
            Err(error) => return Err(unreadable(error.to_string())),
        };
        let record: Record = serde_json::from_str(&text).map_err(|error| unreadable(error.to_string()))?;
        if (record.drives, &record.configuration) != (self.drives, &self.configuration) {
            return Err(unreadable("it is of other drives or of another configuration".to_owned()));
        }
        let drilled = record.drilled().ok_or_else(|| unreadable("a time in it is none".to_owned()))?;
        Ok(drilled.judge(self.demands)?)
    }
}

impl Record {
    fn drilled(&self) -> Option<Drilled> {
        let time = |ms: f64| Duration::try_from_secs_f64(1e-3 * ms).ok();
        let mut findings = Vec::new();
        for (name, after) in &self.stopped_after_ms {
            let watchdog = Watchdog::ALL.into_iter().find(|watchdog| watchdog.name() == name)?;
            let mut stopped_after = [None; 2];
            for (to, ms) in stopped_after.iter_mut().zip(after) {
                *to = ms.map(time).map_or(Some(None), |time| time.map(Some))?;
            }
            findings.push(Finding { watchdog, stopped_after, stopped_in: [None; 2] });
        }
        Some(Drilled { findings, resolution: time(self.resolution_ms)? })
    }
}

/// Returns a hash that stays the same from version to version.
///
/// # Source
/// Fowler, Noll, Vo: FNV-1a, 64 bits.
pub fn fnv1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn rig() -> config::Rig {
        config::load_rig(config::Source::named("builtin:paper-admittance.yaml")).unwrap().value
    }

    fn drives(serial_number: u32) -> [DriveIdentity; 2] {
        [1, 2].map(|node_id| DriveIdentity {
            node_id: Some(node_id),
            vendor_id: 3,
            product_code: 4,
            revision: 5,
            serial_number,
        })
    }

    fn drilled(ms: [u64; 3]) -> Drilled {
        let findings = Watchdog::CANOPEN.into_iter().zip(ms).map(|(watchdog, ms)| Finding {
            watchdog,
            stopped_after: [Some(Duration::from_millis(ms)), (ms < 900).then(|| Duration::from_millis(ms))],
            stopped_in: [None; 2],
        });
        Drilled { findings: findings.collect(), resolution: Duration::from_millis(1) }
    }

    #[test]
    fn a_known_hash() {
        assert_eq!(fnv1a(b"a"), 0xaf63_dc4c_8601_ec8c);
    }

    #[test]
    fn a_record_is_of_its_drives_and_its_configuration_alone() {
        let folder = std::env::temp_dir().join(format!("yieldwall-proof-{}", std::process::id()));
        let subject = Subject::new(&rig(), drives(7));
        assert!(matches!(subject.check(&folder), Err(Unproven::Missing { .. })));
        let path = subject.store(&drilled([5, 6, 40]), &folder).unwrap();
        subject.check(&folder).unwrap();
        // Another drive in its place, and another heartbeat.
        assert!(matches!(Subject::new(&rig(), drives(8)).check(&folder), Err(Unproven::Missing { .. })));
        let mut slower = rig();
        slower.drives[1].address.canopen_mut().unwrap().heartbeat_ms += 1;
        assert!(matches!(Subject::new(&slower, drives(7)).check(&folder), Err(Unproven::Missing { .. })));
        // The fixture is nothing to a watchdog, nor is the master's patience.
        let mut other = rig();
        other.fixture.hold_steps += 1;
        (other.drives[0].waits.sdo_ms, other.drives[1].enabling_ms) = (Some(10), 10);
        Subject::new(&other, drives(7)).check(&folder).unwrap();
        fs::write(&path, "{").unwrap();
        assert!(matches!(subject.check(&folder), Err(Unproven::Unreadable { .. })));
        fs::remove_dir_all(&folder).unwrap();
    }

    #[cfg(all(feature = "ethernet", target_os = "linux"))]
    #[test]
    fn a_record_that_others_may_have_written_enables_nothing() {
        let folder = std::env::temp_dir().join(format!("yieldwall-proof-others-{}", std::process::id()));
        let subject = Subject::new(&rig(), drives(7));
        let path = subject.store(&drilled([5, 6, 40]), &folder).unwrap();
        for at in [&path, &folder] {
            crate::sample::let_others_write(at);
            let refused = subject.check(&folder).unwrap_err();
            let command = format!("`chmod go-w {}`", at.display());
            assert!(
                matches!(refused, Unproven::Unreadable { .. }) && refused.to_string().contains(&command),
                "{refused}"
            );
        }
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn what_the_drill_has_shown_decides() {
        let folder = std::env::temp_dir().join(format!("yieldwall-proof-judged-{}", std::process::id()));
        let torque = Subject::new(&rig(), drives(1));
        let mut position = rig();
        position.rig.command_mode = config::CommandMode::Position;
        let position = Subject::new(&position, drives(1));
        for (ms, in_torque, in_position) in [
            ([5, 6, 40], true, true),
            ([11, 12, 40], false, true),
            ([5, 5, 900], false, false),
            ([5, 900, 5], false, false),
        ] {
            for (subject, wanted) in [(&torque, in_torque), (&position, in_position)] {
                subject.store(&drilled(ms), &folder).unwrap();
                assert_eq!(subject.check(&folder).is_ok(), wanted, "{ms:?}");
            }
        }
        fs::remove_dir_all(&folder).unwrap();
    }
}
