//! `yieldwall tune gains`: gains from the model of a rig alone, and their place in its file.

pub(super) mod file;

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use self::file::{Edit, GainsSource};
use crate::confirm::agreed;
use crate::ending::rig_failure;
use crate::failure::{Exit, Failure};
use crate::margins::Margins;
use crate::masses::Masses;
use crate::output::Output;
use yieldwall_config::{
    self as config, CommandMode, ControlGains, ControlLaw, Loaded, NotNegative, Positive, Rig, Source,
};
use yieldwall_motion::control::Gains;
use yieldwall_rig::analysis::{
    PROPOSED_MARGINS, has_margins, pose_margins, proposed_gains, proposed_rate_gain, rate_margins,
};

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Rig file; `builtin:paper-admittance.yaml` is the copy in the program
    #[arg(value_name = "RIG.yaml")]
    rig: String,
    /// Write the gains into the file after a person confirms; change nothing else in it
    #[arg(long)]
    write: bool,
    /// Confirm without a question, for scripts
    #[arg(long, requires = "write")]
    yes: bool,
}

/// A gain: its key in the rig, its old value and its new value.
type Change = (String, f64, f64);

pub(crate) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let rig = config::load_rig(Source::named(&arguments.rig))?;
    output.configuration(&rig.warnings)?;
    let tuned = tuned(&rig)?;
    let margins = [&rig, &tuned].map(|rig| Margins::of(&rig.value));
    let proposal = Proposal::new(&rig, tuned, margins);
    // Softer gains hold a hand less well.
    if let Ok(masses) = Masses::of_scene(&proposal.tuned) {
        output.warnings(&masses.finding(&proposal.tuned).into_iter().collect::<Vec<_>>());
    }
    if !output.is_json() {
        output.result(&format!(
            "rig       {}: {}\n{}",
            rig.value.rig.name,
            title(&rig.value),
            proposal.text(&rig.value)
        ))?;
    }
    let written = proposal.write(&rig, arguments.write, arguments.yes)?;
    if output.is_json() {
        return output.report(proposal.document(&rig.value, written.as_deref()));
    }
    proposal.tell(written.as_deref(), output)
}

/// Other gains for a rig.
pub(super) struct Proposal {
    tuned: Loaded<Rig>,
    changes: Vec<Change>,
    place: GainsSource,
    /// Before and after.
    margins: [Margins; 2],
}

impl Proposal {
    /// Returns the gains of `tuned` for `rig`, with the margins before and after.
    pub(super) fn new(rig: &Loaded<Rig>, tuned: Loaded<Rig>, margins: [Margins; 2]) -> Self {
        let changes = changes(&rig.value.control.gains, &tuned.value.control.gains);
        let place = file::place(rig, &changes);
        Self { tuned, changes, place, margins }
    }

    /// Returns the rig with these gains.
    pub(super) fn tuned(&self) -> &Loaded<Rig> {
        &self.tuned
    }

    fn is_tuned(&self) -> bool {
        self.changes.iter().all(|(_, old, new)| old == new)
    }

    /// Writes the gains into the file if this is requested and a person agrees. Returns the path.
    pub(super) fn write(&self, rig: &Loaded<Rig>, is_asked: bool, says_yes: bool) -> Result<Option<PathBuf>, Failure> {
        if !is_asked || self.is_tuned() {
            return Ok(None);
        }
        let edit = Edit::of(rig, &self.tuned.value, &self.changes, &self.place)?;
        let what = format!("{}: {}", edit.path().display(), edit.words());
        if !says_yes && !agreed(&what) {
            return Err(Failure::new(Exit::Usage, "nothing written", "answer yes, or add --yes"));
        }
        edit.carry_out().map(Some)
    }

    /// Reports the written gains, or the gains that would be written.
    pub(super) fn tell(&self, written: Option<&Path>, output: &mut Output) -> Result<(), Failure> {
        match (written, &self.place) {
            _ if self.is_tuned() => output.news("nothing written; the rig already has these gains"),
            (Some(path), _) => output.news(&format!("written   {}", path.display())),
            (None, GainsSource::Here(_)) => output.news("nothing written; add --write to write the gains"),
            (None, GainsSource::Inherited { from }) => {
                output.news(&format!(
                    "nothing written; this rig inherits its gains from {from}\nadd --write to write gains into this rig's own file"
                ))
            }
            (None, GainsSource::Unclear { key }) => {
                output.news(&format!("nothing written; `{key}` is not a plain number in this file"))
            }
        }
    }

    /// Returns the text for a person.
    pub(super) fn text(&self, rig: &Rig) -> String {
        let [before, after] = &self.margins;
        text(rig, &self.changes, [before, after])
    }

    /// Returns the data for a program.
    pub(super) fn document(&self, rig: &Rig, written: Option<&Path>) -> Value {
        let [before, after] = &self.margins;
        document(rig, &self.changes, [before, after], &self.place, written)
    }
}

/// Returns the rig with gains that have their margins at every pose.
fn tuned(rig: &Loaded<Rig>) -> Result<Loaded<Rig>, Failure> {
    let mut tuned = rig.clone();
    match rig.value.rig.command_mode {
        CommandMode::Position => {
            let message = "in position mode the drives close the loop; this program has no gains";
            return Err(Failure::new(
                Exit::Usage,
                message,
                "tune the drives with their manufacturer's program, or write `command_mode: torque`",
            ));
        }
        CommandMode::Velocity => {
            let gain_per_s = Positive::new(proposed_rate_gain(&rig.value));
            if let (ControlGains::Rate { gain_per_s: gain }, Some(new)) = (&mut tuned.value.control.gains, gain_per_s) {
                *gain = new;
            }
        }
        CommandMode::Torque => {
            let found = pose_margins(&rig.value).map_err(|error| rig_failure(&error))?;
            let proposed = found.as_ref().and_then(|found| proposed_gains(&rig.value, found)).ok_or_else(nothing)?;
            set(&mut tuned.value.control.gains, proposed.gains);
            // At every pose, not at the least and greatest inertia alone.
            let reached = pose_margins(&tuned.value).map_err(|error| rig_failure(&error))?;
            let is_reached = reached.is_some_and(|reached| {
                [reached.worst.without_friction, reached.worst.with_friction]
                    .iter()
                    .all(|worst| has_margins(worst, PROPOSED_MARGINS))
            });
            if !is_reached {
                return Err(nothing());
            }
        }
    }
    Ok(tuned)
}

pub(super) fn nothing() -> Failure {
    let (gain_db, phase_deg) = PROPOSED_MARGINS;
    let message = format!(
        "no gains found with a gain margin of {gain_db} dB and a phase margin of {phase_deg} degrees at every pose"
    );
    Failure::new(Exit::OutOfTolerance, message, "check `cycle.period_us` and `control.feed_forward.inertia`")
}

/// Replaces the gains.
pub(super) fn set(gains: &mut ControlGains, new: Gains) {
    let (stiffness, damping, integral) =
        (Positive::new(new.stiffness), NotNegative::new(new.damping), NotNegative::new(new.integral));
    let (Some(stiffness), Some(damping), Some(integral)) = (stiffness, damping, integral) else { return };
    match gains {
        ControlGains::Joint { stiffness_n_m_per_rad: k, damping_n_m_s_per_rad: b, integral_n_m_per_rad_s: l }
        | ControlGains::Cartesian { stiffness_n_per_m: k, damping_n_s_per_m: b, integral_n_per_m_s: l } => {
            (*k, *b, *l) = (stiffness, damping, integral);
        }
        ControlGains::Rate { .. } => {}
    }
}

/// Returns each gain by its key.
fn keyed(gains: &ControlGains) -> Vec<(String, f64)> {
    let (group, each) = match *gains {
        ControlGains::Joint { stiffness_n_m_per_rad: k, damping_n_m_s_per_rad: b, integral_n_m_per_rad_s: l } => (
            "joint",
            vec![
                ("stiffness_n_m_per_rad", k.get()),
                ("damping_n_m_s_per_rad", b.get()),
                ("integral_n_m_per_rad_s", l.get()),
            ],
        ),
        ControlGains::Cartesian { stiffness_n_per_m: k, damping_n_s_per_m: b, integral_n_per_m_s: l } => (
            "cartesian",
            vec![("stiffness_n_per_m", k.get()), ("damping_n_s_per_m", b.get()), ("integral_n_per_m_s", l.get())],
        ),
        ControlGains::Rate { gain_per_s } => ("rate", vec![("gain_per_s", gain_per_s.get())]),
    };
    each.into_iter().map(|(key, value)| (format!("control.gains.{group}.{key}"), value)).collect()
}

fn changes(old: &ControlGains, new: &ControlGains) -> Vec<Change> {
    let pairs = keyed(old).into_iter().zip(keyed(new));
    pairs.map(|((key, old), (_, new))| (key, old, new)).collect()
}

/// Returns the tuned object, and the source of the computation.
fn title(rig: &Rig) -> String {
    match rig.rig.command_mode {
        CommandMode::Velocity => "rate gain, from the cycle time".to_owned(),
        _ => format!("gains of the {} law, from a model of the arm", law(rig)),
    }
}

fn law(rig: &Rig) -> &'static str {
    match (rig.rig.command_mode, rig.control.law) {
        (CommandMode::Velocity, _) => "rate",
        (_, ControlLaw::Psmc) => "PSMC",
        (_, ControlLaw::Pid) => "PID",
    }
}

fn text(rig: &Rig, changes: &[Change], [before, after]: [&Margins; 2]) -> String {
    let mut text = String::new();
    for (key, old, new) in changes {
        text += &format!("  {:48} {old:>10} -> {new}\n", key);
    }
    for (when, margins, at) in [("before", before, 1), ("after", after, 2)] {
        text += &format!("{when}\n");
        margins.lines().iter().for_each(|line| text += &format!("  {line}\n"));
        if let (Margins::Velocity { .. }, Some((_, old, new))) = (margins, changes.first()) {
            let gain = if at == 1 { *old } else { *new };
            rate_lines(gain, rig).iter().for_each(|line| text += &format!("  {line}\n"));
        }
    }
    text
}

/// Returns the margins of a rate gain with ideal drives, a line each.
fn rate_lines(gain_per_s: f64, rig: &Rig) -> Vec<String> {
    let period_s = f64::from(rig.cycle.period_us) * 1e-6;
    match rate_margins(gain_per_s * period_s) {
        Some(margins) => vec![
            format!("ideal drives         gain +{:.1} dB, phase {:.1} deg", margins.gain_db, margins.phase_deg),
            format!("remaining lag        {:.2} ms", 1e3 * margins.lag_cycles * period_s),
        ],
        None => vec!["ideal drives         UNSTABLE".to_owned()],
    }
}

fn document(
    rig: &Rig,
    changes: &[Change],
    [before, after]: [&Margins; 2],
    place: &GainsSource,
    written: Option<&Path>,
) -> Value {
    let gains = changes.iter().map(|(key, old, new)| json!({ "key": key, "old": old, "new": new }));
    let inherited = match place {
        GainsSource::Inherited { from } => Some(from),
        _ => None,
    };
    let mut document = json!({
        "rig": rig.rig.name,
        "law": law(rig),
        "gains": gains.collect::<Vec<_>>(),
        "before": before.to_json(),
        "after": after.to_json(),
        "inherited_from": inherited,
        "written": written,
    });
    if let (CommandMode::Velocity, Some((_, old, new))) = (rig.rig.command_mode, changes.first()) {
        for (when, gain) in [("before", old), ("after", new)] {
            let margins = rate_margins(gain * f64::from(rig.cycle.period_us) * 1e-6);
            document[when]["ideal_drive"] = json!(margins.map(|margins| json!({
                "gain_db": margins.gain_db, "phase_deg": margins.phase_deg, "lag_cycles": margins.lag_cycles,
            })));
        }
    }
    document
}

#[cfg(test)]
mod tests;
