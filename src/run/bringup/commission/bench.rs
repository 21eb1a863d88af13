//! A rig on the bench: what all steps of a commissioning do with it.

use std::sync::atomic::{AtomicBool, Ordering};

use super::{Attendant, Curve, Figure, Step, StepReport, Verdict};
use crate::bringup::jog::{Jog, Jogged, jog};
use crate::conduct::settling_on_bus;
use crate::drilled::Drilled;
use crate::error::RunError;
use crate::permit::{Ask, Bounds};
use crate::place::Place;
use crate::proof::{DriveIdentity, DriveLimit, NotProven};
use crate::runner::Runner;
use crate::scene::Ended;
use yieldwall_config::{self as config, Positive};
use yieldwall_motion::cycle::LeadLimits;
use yieldwall_motion::guard::Device;
use yieldwall_motion::quantity::JointAngles;
use yieldwall_record::CycleRecord;

/// Rate at which joints are guided, rad/s: 6 degrees in a second.
pub(super) const RATE: f64 = 6.0 * std::f64::consts::PI / 180.0;
/// Time in which a joint comes up to its rate, s.
const COMES_UP_S: f64 = 0.2;

/// Why a step does not go on.
#[derive(Debug)]
pub(super) enum Halt {
    /// A person asked for the end.
    Interrupted,
    /// Something is wrong.
    Failed(String),
    /// It cannot be tried.
    Skipped(String),
}

impl From<RunError> for Halt {
    fn from(error: RunError) -> Self {
        match error {
            RunError::Interrupted => Self::Interrupted,
            error => Self::Failed(error.to_string()),
        }
    }
}

impl From<NotProven> for Halt {
    fn from(error: NotProven) -> Self {
        match error {
            NotProven::Run(error) => error.into(),
            error @ NotProven::Unproven(_) => {
                Self::Failed(format!("{error}; continue with --from watchdogs, which saves the drill"))
            }
        }
    }
}

/// Findings of a step so far.
#[derive(Debug, Default)]
pub(super) struct Found {
    pub(super) figure: Option<Figure>,
    pub(super) evidence: Vec<(String, String)>,
    pub(super) curves: Vec<Curve>,
}

impl Found {
    pub(super) fn note(&mut self, name: impl Into<String>, value: impl Into<String>) {
        self.evidence.push((name.into(), value.into()));
    }

    /// Takes a figure if it is nearer to its limit, or further beyond it, than the one before.
    pub(super) fn measure(&mut self, figure: Figure) {
        // One that is no number is beyond every limit.
        let share = |figure: &Figure| {
            let share = figure.value / figure.limit.max(f64::MIN_POSITIVE);
            if share.is_nan() { f64::INFINITY } else { share }
        };
        if self.figure.as_ref().is_none_or(|before| share(before) <= share(&figure)) {
            self.figure = Some(figure);
        }
    }

    /// Whether the figure is beyond its limit, or not a number.
    pub(super) fn is_bad(&self) -> bool {
        self.figure.as_ref().is_some_and(Figure::is_bad)
    }
}

/// Record of a joint's travel.
#[derive(Debug)]
pub(super) struct Travel {
    pub(super) jogged: Jogged,
    /// Angle in rad and torque in N m as the drive reported them while the joint moved at its full rate.
    pub(super) torques: Vec<[f64; 2]>,
}

impl Travel {
    /// Returns the mean torque, N m.
    pub(super) fn mean_n_m(&self) -> f64 {
        self.torques.iter().map(|[_, torque]| torque).sum::<f64>() / self.torques.len() as f64
    }
}

/// Returns the result of a step, or the error of restoring the torque limits after it. If both failed, the error names both.
pub(super) fn with_restored<T>(done: Result<T, Halt>, restored: Result<(), Halt>) -> Result<T, Halt> {
    match (done, restored) {
        (done, Ok(())) => done,
        (Err(Halt::Failed(first)), Err(Halt::Failed(then))) => Err(Halt::Failed(format!("{first}; {then}"))),
        (_, Err(restored)) => Err(restored),
    }
}

/// A rig that is commissioned, and who is at it.
pub(super) struct Bench<'a> {
    pub(super) runner: &'a mut Runner<dyn Place>,
    pub(super) rig: &'a config::Rig,
    pub(super) attendant: &'a mut dyn Attendant,
    pub(super) is_interrupted: &'a AtomicBool,
    pub(super) settling: u32,
    /// The drives that these have to be, if that is known.
    pub(super) wanted: Option<[DriveIdentity; 2]>,
    /// Identities that the drives report.
    pub(super) drives: Option<[DriveIdentity; 2]>,
    /// Findings of the drill of the watchdogs.
    pub(super) drilled: Option<Drilled>,
}

impl<'a> Bench<'a> {
    pub(super) fn new(
        runner: &'a mut Runner<dyn Place>,
        rig: &'a config::Rig,
        attendant: &'a mut dyn Attendant,
        is_interrupted: &'a AtomicBool,
    ) -> Self {
        let settling = settling_on_bus(rig);
        Self { runner, rig, attendant, is_interrupted, settling, wanted: None, drives: None, drilled: None }
    }

    /// Takes a step; the network is left in the end. Nothing if a person has asked for the end.
    pub(super) fn report(&mut self, step: Step) -> Option<StepReport> {
        let mut found = Found::default();
        // What the devices say of a watchdog that was tried is no part of what comes later.
        self.runner.master.networks_mut().forget_told();
        let done = match step {
            Step::Communication => self.communication(&mut found),
            Step::Identity => self.identity(&mut found),
            Step::Limits => self.limits(&mut found),
            Step::Parameters => self.parameters(&mut found),
            Step::SensorRest => self.sensor_rest(&mut found),
            Step::SensorAxes => self.sensor_axes(&mut found),
            Step::Watchdogs => self.watchdogs(&mut found),
            Step::Rotation => self.rotation(&mut found),
            Step::Motor => self.motor(&mut found),
            Step::Friction => self.friction(&mut found),
            Step::Admittance => self.admittance(&mut found),
        };
        self.runner.leave();
        let (verdict, reason) = match done {
            Ok(()) if found.is_bad() => (Verdict::Fail, None),
            Ok(()) => (Verdict::Pass, None),
            Err(Halt::Failed(reason)) => (Verdict::Fail, Some(reason)),
            Err(Halt::Skipped(reason)) => (Verdict::Skipped, Some(reason)),
            Err(Halt::Interrupted) => return None,
        };
        let Found { figure, evidence, curves } = found;
        Some(StepReport { step, verdict, figure, reason, evidence, curves })
    }

    /// Boots the network; nothing is enabled.
    pub(super) fn boot(&mut self) -> Result<(), Halt> {
        self.check_interrupt()?;
        Ok(self.runner.boot()?)
    }

    pub(super) fn check_interrupt(&self) -> Result<(), Halt> {
        if self.is_interrupted.load(Ordering::Relaxed) { Err(Halt::Interrupted) } else { Ok(()) }
    }

    /// Lets the rig idle for a time.
    pub(super) fn idle(&mut self, time_s: f64, mut each: impl FnMut(&CycleRecord)) -> Result<(), Halt> {
        for _ in 0..self.cycles_in(time_s) {
            self.check_interrupt()?;
            self.runner.run_cycle(Ask::Nothing).iter().for_each(&mut each);
        }
        Ok(())
    }

    pub(super) fn cycles_in(&self, time_s: f64) -> u32 {
        (time_s / self.runner.period().as_secs_f64()).ceil() as u32
    }

    /// Returns the name of the drive of a joint.
    pub(super) fn name(&self, joint: usize) -> &'a str {
        self.rig.drives.get(joint).map_or("", |drive| drive.name.as_str())
    }

    /// This share of the lower rated torque, within the rig's own limit, N m.
    pub(super) fn torque_n_m(&self, share: f64) -> f64 {
        let [left, right] = self.rig.drives.each_ref().map(|drive| drive.rated_torque_n_m.get());
        (share * left.min(right)).min(self.rig.guard.torque_limit_n_m.get())
    }

    /// Returns the last measured angles.
    pub(super) fn angles(&self) -> JointAngles {
        self.runner.last_outputs().map(|outputs| outputs.signals.measured_angles).unwrap_or_default()
    }

    /// Returns the torque limits of both drives, each in the unit of its object; `None` for a drive that keeps its own.
    pub(super) fn torque_limits(&mut self) -> Result<[Option<u32>; 2], Halt> {
        let [left, right] = Device::DRIVES.map(|device| self.runner.torque_limit(self.rig, device));
        Ok([left?, right?])
    }

    /// Shows the torque limits that drives keep by themselves to the person at the arm, who confirms them once. The network is left
    /// meanwhile.
    pub(super) fn confirm_drive_limits(&mut self) -> Result<(), Halt> {
        if self.runner.accepts_drive_limits {
            return Ok(());
        }
        let mut kept = Vec::new();
        for (joint, device) in Device::DRIVES.into_iter().enumerate() {
            let name = self.name(joint);
            match self.runner.drive_limit(self.rig, device)? {
                DriveLimit::OfMaster => {}
                DriveLimit::Kept(limit) => kept.push(format!(
                    "{name} keeps its own torque limit: {} holds {}, {:.2} N m at the joint.",
                    limit.at, limit.held, limit.torque_n_m
                )),
                DriveLimit::Untold => {
                    kept.push(format!(
                        "{name} has no object for a torque limit: read the limit in the manufacturer's tool."
                    ));
                }
            }
        }
        if kept.is_empty() {
            return Ok(());
        }
        let most_n_m = self.rig.guard.torque_limit_n_m.get();
        kept.push(format!("The first motion cannot have a lower limit. The rig file allows {most_n_m:.2} N m."));
        self.runner.leave();
        if !self.attendant.accepts_drive_limit(&kept.join(" ")) {
            return Err(Halt::Failed(format!(
                "{} This is not confirmed: lower the limit with the manufacturer's tool, or confirm it (--accept-drive-limit)",
                kept.join(" ")
            )));
        }
        self.runner.accept_drive_limits();
        self.boot()
    }

    /// Gives each drive its torque limit, unless it may still make torque.
    pub(super) fn restore_torque_limits(&mut self, limits: [Option<u32>; 2]) -> Result<(), Halt> {
        let mut lowered = Vec::new();
        for (joint, (device, limit)) in Device::DRIVES.into_iter().zip(limits).enumerate() {
            let drives = self.runner.master().last_inputs().drives;
            let why = match drives.get(joint) {
                Some(drive) if drive.state.has_torque() => "still reports torque: press the emergency stop",
                _ if self.runner.put_torque_limit(self.rig, device, limit).is_ok() => continue,
                _ => "rejects its old limit",
            };
            lowered.push(format!("{} {why}", self.name(joint)));
        }
        if lowered.is_empty() {
            return Ok(());
        }
        let lowered = lowered.join("; ");
        Err(Halt::Failed(format!("a torque limit stays lowered until the next boot: {lowered}")))
    }

    /// Boots, runs a step within bounds of motion and torque, and restores the torque limits.
    pub(super) fn within<T>(
        &mut self,
        bound_rad: f64,
        torque_n_m: f64,
        act: impl FnOnce(&mut Self, Bounds) -> Result<T, Halt>,
    ) -> Result<T, Halt> {
        self.boot()?;
        self.confirm_drive_limits()?;
        let limits = self.torque_limits()?;
        let positive =
            |value: f64| Positive::new(value).ok_or_else(|| Halt::Failed("the rig file allows no torque".to_owned()));
        let bounds = Bounds { motion_rad: positive(bound_rad)?, torque_n_m: positive(torque_n_m)? };
        let done = act(self, bounds);
        let restored = self.restore_torque_limits(limits);
        with_restored(done, restored)
    }

    /// Boots, guides a joint by an angle with at most this torque, and stops it. Then it restores the torque limits.
    pub(super) fn travel(
        &mut self,
        joint: usize,
        by_rad: f64,
        bound_rad: f64,
        torque_n_m: f64,
    ) -> Result<Travel, Halt> {
        self.within(bound_rad, torque_n_m, |bench, bounds| bench.led(joint, by_rad, bounds))
    }

    fn led(&mut self, joint: usize, by_rad: f64, bounds: Bounds) -> Result<Travel, Halt> {
        let permit = self.attendant.prove(self.runner, self.rig, bounds)?;
        let mut by = [0.0; 2];
        by.iter_mut().skip(joint).take(1).for_each(|by| *by = by_rad);
        let limits = LeadLimits { rate_rad_per_s: RATE, acceleration_rad_per_s2: RATE / COMES_UP_S };
        let asked = Jog { by: by.into(), keys: None, limits, settling: self.settling, is_metered: true };
        let mut torques = Vec::with_capacity(self.cycles_in(by_rad.abs() / RATE + 1.0) as usize);
        let jogged = jog(self.runner, self.rig, &asked, &permit, self.is_interrupted, |_, told| {
            if let Some(told) = told.filter(|told| told.is_steady && torques.len() < torques.capacity()) {
                torques.push([told.angle_rad, told.torque_n_m]);
            }
        })?;
        if jogged.ended == Ended::Interrupted {
            return Err(Halt::Interrupted);
        }
        Ok(Travel { jogged, torques })
    }
}
