//! The figures of the paper, run again on the simulated machines.

use std::fmt;
use std::path::Path;

use super::machine::{Machine, to_the_end};
use yieldwall_config::{self as config, Loaded, Report, Source};
use yieldwall_record::Trace;
use yieldwall_rig::RigError;
use yieldwall_rig::report::measures::Measures;
use yieldwall_rig::report::{IMPEDANCE_DEVICE, Overrides, RunReport, Stage, Watch, drive, run_rig};

/// The figures that can be reproduced, in the paper's order.
pub const FIGURES: [&str; 8] = ["fig8", "fig9", "fig11", "fig12", "fig13", "fig14", "fig15", "fig16"];

/// The figure of parts of others.
pub(super) const FIG13: &str = "fig13";

/// The figures that Fig. 13 shows enlarged.
const MAGNIFIED_IN_FIG13: [&str; 2] = ["fig8", "fig11"];

/// How a machine is driven.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Mode {
    /// Admittance rig, drives in cyclic synchronous torque mode.
    Cst,
    /// Admittance rig, drives in cyclic synchronous velocity mode.
    Csv,
    /// Admittance rig, drives in cyclic synchronous position mode.
    Csp,
    /// Impedance device.
    Impedance,
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Mode::Cst => "cst",
            Mode::Csv => "csv",
            Mode::Csp => "csp",
            Mode::Impedance => "impedance",
        })
    }
}

impl Mode {
    /// Returns how the machine was driven, in words.
    pub fn in_words(self) -> &'static str {
        match self {
            Mode::Cst => drive(config::CommandMode::Torque),
            Mode::Csv => drive(config::CommandMode::Velocity),
            Mode::Csp => drive(config::CommandMode::Position),
            Mode::Impedance => IMPEDANCE_DEVICE,
        }
    }
}

/// One run of a figure.
#[derive(Clone, Debug)]
pub struct FigureRun {
    /// Name of the figure, such as `fig11`.
    pub figure: String,
    /// Title of the figure.
    pub title: String,
    /// How the machine was driven.
    pub mode: Mode,
    /// `N_wait`.
    pub hold_steps: u32,
    /// The finished run.
    pub report: RunReport,
    /// Measures of the same run without feed-forward; `None` where the drives close the loop.
    pub without_feed_forward: Option<Measures>,
    /// Parts of the plane that the figure shows enlarged.
    pub magnified: Vec<config::MagnifiedWindow>,
}

impl FigureRun {
    /// The rows.
    pub fn trace(&self) -> &Trace {
        &self.report.trace
    }

    /// Returns the measures of the runs.
    pub fn measures(&self) -> &Measures {
        &self.report.measures
    }
}

/// Why a figure could not be reproduced.
#[derive(Debug)]
pub enum ReproduceError {
    /// A file of the figure was refused.
    Config(Report),
    /// A machine could not be built or could not go on.
    Rig {
        /// The figure.
        figure: String,
        /// How the machine was driven.
        mode: Mode,
        /// The error.
        source: RigError,
    },
}

impl From<Report> for ReproduceError {
    fn from(report: Report) -> Self {
        ReproduceError::Config(report)
    }
}

/// A hand as a multiple of the scene's own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandScale {
    /// Factor on stiffness and damping.
    pub stiffness: f64,
    /// Factor on the mass.
    pub mass: f64,
}

impl HandScale {
    /// The scene's own hand.
    pub const SAME: HandScale = HandScale { stiffness: 1.0, mass: 1.0 };
}

/// Runs every machine and every hold of a figure. Fig. 13 shows runs of Figs 8 and 11, which carry its name here.
///
/// `progress` gets the figure, the mode and the stage of the run.
///
/// # Errors
/// A file that was refused, or a machine that could not be run.
pub fn reproduce(
    figure: &str,
    hand: HandScale,
    mut progress: impl FnMut(&str, Mode, Stage),
) -> Result<Vec<FigureRun>, ReproduceError> {
    let of_file = |file: &str| config::load_figure(config::builtin(format!("figures/{file}.yaml")));
    if figure != FIG13 {
        return run_figure(figure, &of_file(figure)?, hand, &mut progress);
    }
    let mut runs = Vec::new();
    for shown in MAGNIFIED_IN_FIG13 {
        runs.extend(run_figure(figure, &of_file(shown)?, hand, &mut progress)?);
    }
    Ok(runs)
}

/// As [`reproduce`], of a figure in a file, which has the file's name without its ending. Returns its warnings too.
///
/// # Errors
/// As [`reproduce`].
pub fn reproduce_file(
    path: &str,
    hand: HandScale,
    mut progress: impl FnMut(&str, Mode, Stage),
) -> Result<(Vec<FigureRun>, Vec<config::Diagnostic>), ReproduceError> {
    let figure = config::load_figure(Source::named(path))?;
    let name = Path::new(path).file_stem().map_or_else(|| path.into(), |stem| stem.to_string_lossy());
    let runs = run_figure(&name, &figure, hand, &mut progress)?;
    Ok((runs, figure.warnings))
}

fn run_figure(
    name: &str,
    figure: &Loaded<config::Figure>,
    hand: HandScale,
    progress: &mut impl FnMut(&str, Mode, Stage),
) -> Result<Vec<FigureRun>, ReproduceError> {
    let scene = config::load_scene(figure.source.relative(&figure.value.scene))?;
    let scene = with_hand(scene.value, hand);
    let mut runs = Vec::new();
    for machine in machines(figure)? {
        for &hold_steps in &figure.value.hold_steps {
            let mode = mode(&machine);
            let mut fixture = figure.value.fixture.clone().unwrap_or_else(|| machine.fixture().clone());
            fixture.hold_steps = hold_steps;
            fixture.automatic_hold = None;
            let overrides = Overrides { fixture: Some(fixture), ..Overrides::default() };
            let fail = |source| ReproduceError::Rig { figure: name.to_owned(), mode, source };
            let mut stage = |stage| progress(name, mode, stage);
            let report = machine.run(&scene, &overrides, &mut stage).map_err(fail)?;
            let without_feed_forward = match &machine {
                Machine::Rig(rig) if mode == Mode::Cst => {
                    let bare = stripped_of_feed_forward(rig);
                    Some(
                        run_rig(&bare, &scene, &overrides, Watch::default(), to_the_end(&mut stage))
                            .map_err(fail)?
                            .measures,
                    )
                }
                _ => None,
            };
            let magnified = figure.value.magnify.clone();
            let (figure, title) = (name.to_owned(), figure.value.title.clone());
            runs.push(FigureRun { figure, title, mode, hold_steps, report, without_feed_forward, magnified });
        }
    }
    Ok(runs)
}

/// How a machine is driven.
fn mode(machine: &Machine) -> Mode {
    match machine {
        Machine::Rig(rig) => match rig.rig.command_mode {
            config::CommandMode::Torque => Mode::Cst,
            config::CommandMode::Velocity => Mode::Csv,
            config::CommandMode::Position => Mode::Csp,
        },
        Machine::Device(_) => Mode::Impedance,
    }
}

/// The machines of a figure, torque mode before position mode.
fn machines(figure: &Loaded<config::Figure>) -> Result<Vec<Machine>, Report> {
    let device = figure.value.device.iter();
    let files = device.chain(figure.value.rigs.values()).map(|path| figure.source.relative(path));
    let mut machines = files.map(Machine::load).collect::<Result<Vec<_>, _>>()?;
    machines.sort_by_key(mode);
    Ok(machines)
}

fn stripped_of_feed_forward(rig: &config::Rig) -> config::Rig {
    let mut rig = rig.clone();
    let forward = &mut rig.control.feed_forward;
    let none = |value| config::NotNegative::new(0.0).unwrap_or(value);
    forward.coulomb_n_m = forward.coulomb_n_m.map(none);
    forward.viscous_n_m_s_per_rad = forward.viscous_n_m_s_per_rad.map(none);
    forward.inertia = None;
    rig
}

fn with_hand(mut scene: config::Scene, scale: HandScale) -> config::Scene {
    let hand = &mut scene.hand;
    let positive = |value: config::Positive, factor: f64| config::Positive::new(value.get() * factor).unwrap_or(value);
    let not_negative =
        |value: config::NotNegative, factor: f64| config::NotNegative::new(value.get() * factor).unwrap_or(value);
    hand.stiffness_n_per_m = positive(hand.stiffness_n_per_m, scale.stiffness);
    hand.damping_n_s_per_m = not_negative(hand.damping_n_s_per_m, scale.stiffness);
    hand.mass_kg = not_negative(hand.mass_kg, scale.mass);
    scene
}
