//! From drives that answer to an arm that may be run: ordered steps, each of which finds something wrong with a machine or passes.
//!
//! Steps at rest come first. Each step that enables the rig boots the network anew, has a permit for a small motion with little torque, and
//! gives the drives their torque limit back. A step that fails ends the commissioning: what comes after it would move a machine of which
//! something is known to be wrong.

mod bench;
mod moving;
mod resting;
mod unheld;

use std::borrow::Cow;
use std::sync::atomic::AtomicBool;

use crate::drilled::Drilled;
use crate::permit::{Bounds, Permit};
use crate::place::Place;
use crate::proof::{DriveIdentity, NotProven};
use crate::runner::Runner;
use bench::Bench;
use yieldwall_config as config;
use yieldwall_motion::quantity::Force;

/// A step of a commissioning.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Step {
    /// Do the drives answer, always?
    Communication,
    /// Do both drives have the identity in the rig file, and are there two?
    Identity,
    /// Does a drive keep its torque limit?
    Limits,
    /// Has another program left a value in a drive that adds to its set-points or cuts them, and does it come back after a power
    /// cycle?
    Parameters,
    /// Does the force sensor rest when nobody touches the handle?
    SensorRest,
    /// Does it feel a force in the true direction and at the true size?
    SensorAxes,
    /// Do the drives stop by themselves when their master falls silent?
    Watchdogs,
    /// Does each link turn in the direction and by the angle that its encoder reports?
    Rotation,
    /// Does each motor make the torque that its drive reports, at every angle?
    Motor,
    /// Has each joint at most the friction of the rig file?
    Friction,
    /// Does the rig's own loop stay where it is when nobody holds the handle?
    Admittance,
}

/// The steps in their order.
pub const STEPS: [Step; 11] = [
    Step::Communication,
    Step::Identity,
    Step::Limits,
    Step::Parameters,
    Step::SensorRest,
    Step::SensorAxes,
    Step::Watchdogs,
    Step::Rotation,
    Step::Motor,
    Step::Friction,
    Step::Admittance,
];

impl Step {
    /// Returns the name of the step for reports.
    pub fn name(self) -> &'static str {
        match self {
            Step::Communication => "communication",
            Step::Identity => "identity",
            Step::Limits => "limits",
            Step::Parameters => "parameters",
            Step::SensorRest => "sensor-rest",
            Step::SensorAxes => "sensor-axes",
            Step::Watchdogs => "watchdogs",
            Step::Rotation => "rotation",
            Step::Motor => "motor",
            Step::Friction => "friction",
            Step::Admittance => "admittance",
        }
    }

    /// Returns the step of this name.
    pub fn named(name: &str) -> Option<Self> {
        STEPS.into_iter().find(|step| step.name() == name)
    }

    /// Describes what the step does, for the person who decides whether it may run.
    pub fn does(self) -> &'static str {
        match self {
            Step::Communication => "reads 1000h of each drive a thousand times, within 10 s; enables nothing",
            Step::Identity => "reads 1018h of each drive; enables nothing",
            Step::Limits => {
                "writes the torque limit of each drive, reads it back, and restores it; shows a limit that a drive keeps itself; enables nothing"
            }
            Step::Parameters => {
                "reads offsets and limits of set-points, before and after a power cycle of the drives; enables nothing"
            }
            Step::SensorRest => "reads the force sensor for a second; nobody may touch the handle; enables nothing",
            Step::SensorAxes => "reads the force sensor under a pull of 8 N along x, then along y; enables nothing",
            Step::Watchdogs => {
                "enables the rig at rest for each watchdog, and stops one signal; nobody may touch the handle"
            }
            Step::Rotation => {
                "turns each link by 4 degrees and back, with 10 % of the rated torque, or up to 50 % if needed"
            }
            Step::Motor => {
                "turns each link by 8 degrees back and forth, without and with a pull of 8 N at the tool, with as little torque as possible"
            }
            Step::Friction => {
                "turns each link by 8 degrees back and forth, with as little torque as possible (limit 50 % of rated)"
            }
            Step::Admittance => {
                "runs the rig with its fixture for 10 s, with torque for the friction only; nobody may touch the handle"
            }
        }
    }

    /// Returns how far a joint may go from where it was enabled, rad; `None` if nothing is enabled.
    pub fn motion_bound_rad(self) -> Option<f64> {
        let way = match self {
            Step::Communication
            | Step::Identity
            | Step::Limits
            | Step::Parameters
            | Step::SensorRest
            | Step::SensorAxes => return None,
            Step::Watchdogs => 0.0,
            Step::Rotation => moving::ROTATION_RAD,
            Step::Motor | Step::Friction | Step::Admittance => moving::TRAVEL_RAD,
        };
        Some(way + moving::BEYOND_RAD)
    }
}

/// Measured value of a step, with its limit.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// Name of the measured quantity.
    pub what: Cow<'static, str>,
    /// Value.
    pub value: f64,
    /// Largest good value.
    pub limit: f64,
    /// Unit of both.
    pub unit: Cow<'static, str>,
}

impl Figure {
    /// Whether the value is above its limit, or not a number.
    pub fn is_bad(&self) -> bool {
        self.value.is_nan() || self.value > self.limit
    }
}

/// How a step ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The step passed.
    Pass,
    /// Something is wrong.
    Fail,
    /// The step was skipped.
    Skipped,
}

impl Verdict {
    /// Returns the name for reports.
    pub fn name(self) -> &'static str {
        match self {
            Verdict::Pass => "pass",
            Verdict::Fail => "fail",
            Verdict::Skipped => "skipped",
        }
    }
}

/// A curve that a step has measured.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curve {
    /// Title of the curve.
    pub title: String,
    /// Quantity along the horizontal axis, with its unit.
    pub across: &'static str,
    /// Quantity along the vertical axis, with its unit.
    pub up: &'static str,
    /// The lines, by name.
    pub lines: Vec<(String, Vec<[f64; 2]>)>,
}

/// Findings of a step.
#[derive(Clone, Debug, PartialEq)]
pub struct StepReport {
    /// The step.
    pub step: Step,
    /// How it ended.
    pub verdict: Verdict,
    /// Figure that decided the result.
    pub figure: Option<Figure>,
    /// Why it failed or was skipped, and what to do next.
    pub reason: Option<String>,
    /// Further measured values: name and value.
    pub evidence: Vec<(String, String)>,
    /// Curves.
    pub curves: Vec<Curve>,
}

impl StepReport {
    /// Returns the figure that decided; `None` for a step that failed for another reason.
    pub fn headline(&self) -> Option<&Figure> {
        self.figure.as_ref().filter(|figure| self.verdict != Verdict::Fail || figure.is_bad())
    }
}

/// Person at the arm during commissioning, who does what no drive can do.
pub trait Attendant {
    /// Returns the permit for a small motion with little torque, of the present boot.
    ///
    /// # Errors
    /// Why the rig may not be enabled.
    fn prove(&mut self, runner: &mut Runner<dyn Place>, rig: &config::Rig, bounds: Bounds)
    -> Result<Permit, NotProven>;

    /// Stores the findings of a drill, and returns the place, if there is one.
    ///
    /// # Errors
    /// Why not.
    fn keep(
        &mut self,
        rig: &config::Rig,
        drives: [DriveIdentity; 2],
        drilled: &Drilled,
    ) -> Result<Option<String>, String>;

    /// Records where the link of a joint (0: left) is, so that a later look gives the angle by which it has turned. Nothing is
    /// booted.
    fn look(&mut self, place: &dyn Place, joint: usize);

    /// Returns the angle by which that link has turned since, counter-clockwise, in rad; `None` without an earlier look. Nothing is
    /// booted.
    fn turned(&mut self, place: &dyn Place, joint: usize) -> Option<f64>;

    /// Lets the person switch the drives off and on again, and returns whether both certainly were. Nothing is booted.
    fn power_cycle(&mut self, rig: &config::Rig, place: &mut dyn Place) -> bool;

    /// Whether a drive that keeps its own torque limit may be moved with it; `text` names the limit. Nothing is booted.
    fn accepts_drive_limit(&mut self, text: &str) -> bool;

    /// Lets this force in N, in the base frame, pull at the tool until a force of zero removes it. Returns whether the force pulls.
    fn pull(&mut self, place: &mut dyn Place, force: Force) -> bool;
}

/// A commissioning that came to its end.
#[derive(Clone, Debug, PartialEq)]
pub struct Commissioned {
    /// All steps, in their order.
    pub steps: Vec<StepReport>,
    /// The step in which a person has asked for the end, if there was one; it and the later steps are skipped.
    pub interrupted_in: Option<Step>,
    /// Identities that the drives report, if a step asked for them.
    pub drives: Option<[DriveIdentity; 2]>,
    /// Findings of the drill of the watchdogs, if it was made.
    pub drilled: Option<Drilled>,
}

/// First step of a commissioning, and the expected drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Begin {
    /// First step; earlier steps are skipped.
    pub from: Step,
    /// Drives at the end of an earlier commissioning: the present drives have to be the same, which is checked first.
    pub drives: Option<[DriveIdentity; 2]>,
}

impl From<Step> for Begin {
    fn from(from: Step) -> Self {
        Self { from, drives: None }
    }
}

impl Commissioned {
    /// Returns [`Verdict::Fail`] if a step has failed or the commissioning was broken off, else [`Verdict::Pass`], whatever was
    /// skipped.
    pub fn verdict(&self) -> Verdict {
        let has_failed = self.steps.iter().any(|step| step.verdict == Verdict::Fail);
        if has_failed || self.interrupted_in.is_some() { Verdict::Fail } else { Verdict::Pass }
    }
}

/// Takes the steps of a commissioning from its first step up to the first that fails. Earlier steps are skipped, except
/// [`Step::Identity`] if the drives must be those of an earlier commissioning. Whatever happens, in the end no drive makes torque
/// and the torque limits are restored. `told` receives each report when its step is over.
pub fn commission(
    runner: &mut Runner<dyn Place>,
    rig: &config::Rig,
    begin: Begin,
    attendant: &mut dyn Attendant,
    is_interrupted: &AtomicBool,
    mut told: impl FnMut(&StepReport),
) -> Commissioned {
    let mut interrupted_in = None;
    let mut steps: Vec<StepReport> = Vec::with_capacity(STEPS.len());
    let mut bench = Bench::new(runner, rig, attendant, is_interrupted);
    bench.wanted = begin.drives;
    let first = STEPS.iter().position(|step| *step == begin.from).unwrap_or(0);
    for (at, step) in STEPS.into_iter().enumerate() {
        let failed = steps.iter().find(|report| report.verdict == Verdict::Fail).map(|report| report.step);
        let report = match failed {
            Some(failed) => skipped(step, format!("{} has failed", failed.name())),
            None if interrupted_in.is_some() => skipped(step, INTERRUPTED.to_owned()),
            None if at < first && !(step == Step::Identity && begin.drives.is_some()) => {
                skipped(step, format!("the run begins with {}", begin.from.name()))
            }
            None => bench.report(step).unwrap_or_else(|| {
                interrupted_in = Some(step);
                skipped(step, INTERRUPTED.to_owned())
            }),
        };
        told(&report);
        steps.push(report);
    }
    Commissioned { steps, interrupted_in, drives: bench.drives, drilled: bench.drilled }
}

/// Why steps are skipped after a person has asked for the end.
const INTERRUPTED: &str = "interrupted by a person";

fn skipped(step: Step, reason: String) -> StepReport {
    StepReport {
        step,
        verdict: Verdict::Skipped,
        figure: None,
        reason: Some(reason),
        evidence: Vec::new(),
        curves: Vec::new(),
    }
}
