//! `yieldwall commission`: ordered steps that bring a rig from answering drives to a released arm, and their report.

mod earlier;
#[cfg(target_os = "linux")]
mod on_bus;
mod page;

use std::path::PathBuf;

use serde_json::{Value, json};

use super::bus::check_buses;
use super::clock::now_unix_s;
use super::ending::rig_failure;
use super::failure::{Exit, Failure, both};
use super::fit;
use super::interrupt::on_interrupt;
use super::output::Output;
use super::page::{Pace, Page, PageOf, ViewArgument};
use super::replace::Replace;
use super::unsafe_drives;
use earlier::Earlier;
use yieldwall_config::injection::{DEFECTS, Defect, DefectError};
use yieldwall_config::{self as config, Source};
use yieldwall_rig::EmbeddedRig;
use yieldwall_run::commission::{Begin, Commissioned, STEPS, Step, StepReport, Verdict};

/// Columns of a defect's name in the list.
const DEFECT_COLUMNS: usize = 24;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Rig file; `builtin:paper-admittance.yaml` is the copy in the program
    #[arg(value_name = "RIG.yaml", required_unless_present = "defect")]
    rig: Option<String>,
    /// Start with this step, and skip the steps before it
    #[arg(long, value_name = "STEP", value_parser = step)]
    from: Option<Step>,
    /// Continue after the last step that passed in an earlier run, given its --json output
    ///
    /// The earlier run had this rig file and these drives. The report includes the steps of both runs.
    #[arg(long, value_name = "FILE.json", conflicts_with = "from")]
    resume: Option<PathBuf>,
    /// Inject a defect into the simulated machine, for a step to find; repeatable. `list` prints all names
    #[cfg_attr(target_os = "linux", arg(conflicts_with = "bus"))]
    #[arg(long, value_name = "NAME[=SIZE][:left|right]")]
    defect: Vec<String>,
    /// Ask nothing: the joints still move; skip what only a person can judge
    #[arg(long)]
    yes: bool,
    /// Write the report as an HTML page with the curves
    #[arg(long, value_name = "FILE.html")]
    html: Option<PathBuf>,
    /// Only restore the objects that a killed command had changed
    ///
    /// Without this option the command restores them first and goes on.
    #[cfg(target_os = "linux")]
    #[arg(long, requires = "bus", conflicts_with_all = ["from", "resume", "html"])]
    restore: bool,
    #[command(flatten)]
    replace: Replace,
    #[command(flatten)]
    page: ViewArgument,
    #[cfg(target_os = "linux")]
    #[command(flatten)]
    on_bus: super::first_motion::OnBus,
}

fn step(text: &str) -> Result<Step, String> {
    Step::named(text).ok_or_else(|| {
        let names = STEPS.map(Step::name);
        match config::nearest_word(text, names) {
            Some(meant) => format!("there is no step {text}; did you mean {meant}?"),
            None => format!("there is no step {text}; write one of {}", names.join(", ")),
        }
    })
}

/// Gives the machine of a scene these defects.
pub(super) fn add_defects(scene: &mut config::Scene, rig: &config::Rig, defects: &[String]) -> Result<(), Failure> {
    for text in defects {
        let defect: Defect = text.parse().map_err(|error: DefectError| {
            let known = DEFECTS.iter().map(|row| row.name);
            let help = match &error {
                DefectError::Unknown { name } => {
                    config::nearest_word(name, known).map(|meant| format!("did you mean {meant}?"))
                }
                _ => None,
            };
            let help = help.unwrap_or_else(|| "`yieldwall commission --defect list` lists all defects".to_owned());
            Failure::new(Exit::Usage, format!("--defect {text}: {error}"), help)
        })?;
        if let Some([why, which]) = rig.excludes(defect.kind) {
            return Err(Failure::new(Exit::Usage, format!("--defect {text}: {why}"), format!("try it on {which}")));
        }
        let is_same = |known: &config::SceneDefect| {
            known.defect().is_ok_and(|known| known.kind == defect.kind && known.drive == defect.drive)
        };
        if scene.defects.iter().any(is_same) {
            let message = format!("--defect {text}: the machine already has this defect");
            return Err(Failure::new(Exit::Usage, message, "name each defect once"));
        }
        scene.defects.push(defect.into());
    }
    Ok(())
}

fn list(output: &mut Output) -> Result<(), Failure> {
    if output.is_json() {
        let row = |row: &yieldwall_config::injection::DefectRow| {
            let size = row
                .size
                .map(|size| json!({ "what": size.what, "usual": size.usual, "least": size.least, "most": size.most }));
            json!({ "name": row.name, "meaning": row.meaning, "found_by": row.found_by.name(), "size": size })
        };
        return output.report(json!({ "defects": DEFECTS.iter().map(row).collect::<Vec<_>>() }));
    }
    let indent = " ".repeat(DEFECT_COLUMNS);
    let line =
        |head: &str, text: &str| fit::filled(&format!("{head:DEFECT_COLUMNS$}"), &indent, text, fit::USUAL) + "\n";
    let mut text = String::new();
    for row in &DEFECTS {
        text += &line(row.name, row.meaning);
        if let Some(size) = row.size {
            let range = format!("size: {} (default {}, {} to {})", size.what, size.usual, size.least, size.most);
            text += &line("", &range);
        }
        text += &line("", &format!("found by {}", row.found_by));
    }
    output.result(&text)
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    if arguments.defect.iter().any(|defect| defect == "list") {
        return list(output);
    }
    let Some(file) = &arguments.rig else {
        let message = "--defect needs a rig";
        return Err(Failure::new(Exit::Usage, message, "write yieldwall commission RIG.yaml --defect NAME"));
    };
    let rig = config::load_rig(Source::named(file))?;
    output.configuration(&rig.warnings)?;
    check_buses(&rig, None, output)?;
    if let Some(html) = &arguments.html {
        arguments.replace.check_can_write(html)?;
    }
    #[cfg(target_os = "linux")]
    if arguments.on_bus.is_asked() {
        return on_bus::run(arguments, file, &rig, output);
    }
    let mut scene = rig.scene()?.value;
    add_defects(&mut scene, &rig.value, &arguments.defect)?;
    let mut served = Page::default();
    served.open(&arguments.page, &rig.value, PageOf { command: "commission", pace: Pace::Virtual })?;
    let end = run_simulated(arguments, &rig.value, &scene, &mut served, output);
    served.end(&end);
    end
}

/// Commissions the simulated machine of a scene.
fn run_simulated(
    arguments: &Arguments,
    rig: &config::Rig,
    scene: &config::Scene,
    served: &mut Page,
    output: &mut Output,
) -> Result<(), Failure> {
    let is_interrupted = on_interrupt()?;
    let machine = EmbeddedRig::new(rig, scene, &rig.fixture, scene.seed);
    let mut machine = machine.map_err(|error| rig_failure(&error))?;
    machine.set_watch(served.watch_by_the_clock());
    output.simulated("arm", rig, "hands off");
    let simulated = Machine::Simulated {
        defects: scene
            .defects
            .iter()
            .filter_map(|defect| defect.defect().ok())
            .map(|defect| defect.to_string())
            .collect(),
    };
    let (begin, earlier) = begin(arguments, rig, &simulated, output)?;
    let (mut printed, mut ran) = (Ok(()), Vec::new());
    let commissioned = machine.commission(rig, begin, &is_interrupted, |report| {
        ran.push((report.step, now_unix_s()));
        let line = output.news(&told(earlier.as_ref(), report));
        printed = std::mem::replace(&mut printed, Ok(())).and(line);
    });
    printed?;
    let commissioned = commissioned.map_err(|error| rig_failure(&error))?;
    end(arguments, rig, &Taken::new(earlier, commissioned, ran), &simulated, (|failure| failure, Ok(())), output)
}

/// Machine that was commissioned.
enum Machine {
    /// A simulated one with these defects.
    Simulated { defects: Vec<String> },
    /// The one on these buses, each as `NAME=INTERFACE`.
    #[cfg(target_os = "linux")]
    OnBus { buses: Vec<String>, is_lockstep: bool },
}

impl Machine {
    /// Returns the text for a person.
    fn words(&self) -> String {
        match self {
            Self::Simulated { defects } if defects.is_empty() => "simulated; no drive moved".to_owned(),
            Self::Simulated { defects } => {
                format!("simulated, with {}; no drive moved", defects.join(" and "))
            }
            #[cfg(target_os = "linux")]
            Self::OnBus { buses, is_lockstep } => {
                let pace = if *is_lockstep { ", simulated devices in lockstep" } else { "" };
                format!("on {}{pace}", buses.join(", "))
            }
        }
    }

    fn document(&self) -> Value {
        match self {
            Self::Simulated { defects } => json!({ "simulated": true, "defects": defects }),
            #[cfg(target_os = "linux")]
            Self::OnBus { buses, is_lockstep } => {
                json!({ "buses": buses, "lockstep": is_lockstep })
            }
        }
    }
}

/// Returns the first step of a run, and the earlier run that it continues.
fn begin(
    arguments: &Arguments,
    rig: &config::Rig,
    machine: &Machine,
    output: &Output,
) -> Result<(Begin, Option<Earlier>), Failure> {
    let Some(file) = &arguments.resume else {
        return Ok((arguments.from.unwrap_or(Step::Communication).into(), None));
    };
    let earlier = Earlier::read(file, rig, machine)?;
    let (passed, from) = (earlier.passed(), earlier.begin.from.name());
    output.aside(&format!("{passed} steps have passed in {}; next step: {from}", file.display()));
    Ok((earlier.begin, Some(earlier)))
}

/// A commissioning, with the steps of the earlier run that it continues, and the end of each step in s since 1970.
struct Taken {
    commissioned: Commissioned,
    ran: Vec<(Step, u64)>,
}

impl Taken {
    fn new(earlier: Option<Earlier>, commissioned: Commissioned, mut ran: Vec<(Step, u64)>) -> Self {
        let Some(earlier) = earlier else { return Self { commissioned, ran } };
        let (commissioned, before) = earlier.complete(commissioned, now_unix_s());
        ran.extend(before);
        Self { commissioned, ran }
    }
}

/// Returns the text of a step, also of a step that was not repeated.
fn told(earlier: Option<&Earlier>, report: &StepReport) -> String {
    let name = report.step.name();
    match earlier.and_then(|earlier| earlier.verdict(report.step)) {
        Some(verdict) if report.verdict == Verdict::Skipped => {
            format!("{:9} {name} (in the earlier run)", verdict.name())
        }
        _ => lines(report),
    }
}

/// Returns the text of a step that was carried out.
fn lines(report: &StepReport) -> String {
    let mut text = format!("{:9} {}", report.verdict.name(), report.step.name());
    if let Some(figure) = report.headline() {
        text.push_str(&format!(": {}", page::figure_text(figure)));
    }
    let evidence = report.evidence.iter().map(|(name, value)| format!("{name}: {value}"));
    for line in evidence.chain(report.reason.clone()) {
        text += &format!("\n{}", fit::filled("          ", "            ", &line, fit::USUAL));
    }
    text
}

/// Writes the report, and judges. `with_emergencies` adds the drives' reports to a failure, and `given_back` is whether the drives
/// hold their old values.
fn end(
    arguments: &Arguments,
    rig: &config::Rig,
    taken: &Taken,
    machine: &Machine,
    (with_emergencies, given_back): (impl FnOnce(Failure) -> Failure, Result<(), Failure>),
    output: &mut Output,
) -> Result<(), Failure> {
    let commissioned = &taken.commissioned;
    // The results are printed, whatever happens to the file.
    let mut page = Ok(());
    if let Some(html) = &arguments.html {
        let file = arguments.rig.as_deref().unwrap_or_default();
        page = arguments.replace.write(html, page::html(rig, file, commissioned, &machine.words()).as_bytes());
        if page.is_ok() {
            output.news(&format!("report    {}", html.display()))?;
        }
    }
    #[cfg(target_os = "linux")]
    let is_on_bus = arguments.on_bus.is_asked();
    #[cfg(not(target_os = "linux"))]
    let is_on_bus = false;
    let judged = both(
        judge(commissioned, rig, (arguments.resume.is_some(), is_on_bus), output).map_err(with_emergencies),
        both(given_back, page),
    );
    if output.is_json() {
        return output.end(document(rig, taken, machine), judged);
    }
    if judged.is_ok() {
        let count = |verdict| commissioned.steps.iter().filter(|step| step.verdict == verdict).count();
        let (passed, skipped) = (count(Verdict::Pass), count(Verdict::Skipped));
        let part = if skipped == 0 { "" } else { ": an incomplete commissioning" };
        output.news(&format!("verdict   ok: {passed} steps passed, {skipped} skipped{part}"))?;
    }
    judged
}

fn judge(
    commissioned: &Commissioned,
    rig: &config::Rig,
    (is_resumed, is_on_bus): (bool, bool),
    output: &Output,
) -> Result<(), Failure> {
    let Some(failed) = commissioned.steps.iter().find(|step| step.verdict == Verdict::Fail) else {
        let message = "interrupted: the rig has stopped, and no drive makes torque";
        let interrupted = |step: Step| {
            // Only a report that is printed and knows its drives can be continued.
            let can_resume = output.is_json() && commissioned.drives.is_some();
            let or = if can_resume { ", or --resume with this report" } else { "" };
            let help = format!("continue with --from {}{or}", step.name());
            Failure::new(Exit::Interrupted, message, help)
        };
        return commissioned.interrupted_in.map_or(Ok(()), |step| Err(interrupted(step)));
    };
    let name = failed.step.name();
    let why = failed.reason.clone().or_else(|| failed.headline().map(page::figure_text)).unwrap_or_default();
    // A fixed rig file is another configuration, which needs its own drill.
    let again = match failed.step {
        Step::Rotation | Step::Motor | Step::Friction | Step::Admittance if is_on_bus => {
            "watchdogs, since the drill was done with the old rig file"
        }
        _ => name,
    };
    let help = match failed.step {
        Step::Identity if is_resumed => {
            "start again without --resume: the earlier steps passed with other drives".to_owned()
        }
        _ => format!("fix the cause, and continue with --from {again}; docs/bringup.md describes each step"),
    };
    if let (Step::Watchdogs, Some(drilled)) = (failed.step, &commissioned.drilled) {
        let named = |mut failure: Failure| {
            failure.report.diagnostics.iter_mut().for_each(|one| one.message = format!("{name}: {}", one.message));
            failure
        };
        unsafe_drives::judge(drilled, rig, &help).map_err(named)?;
    }
    Err(Failure::new(Exit::OutOfTolerance, format!("{name}: {why}"), help))
}

fn document(rig: &config::Rig, Taken { commissioned, ran }: &Taken, machine: &Machine) -> Value {
    let step = |report: &StepReport| {
        let evidence: serde_json::Map<String, Value> =
            report.evidence.iter().map(|(name, value)| (name.clone(), json!(value))).collect();
        json!({
            "step": report.step.name(),
            "verdict": report.verdict.name(),
            "what": report.figure.as_ref().map(|figure| &figure.what),
            "figure": report.figure.as_ref().map(|figure| figure.value),
            "limit": report.figure.as_ref().map(|figure| figure.limit),
            "unit": report.figure.as_ref().map(|figure| &figure.unit),
            "reason": report.reason,
            "does": report.step.does(),
            "motion_bound_rad": report.step.motion_bound_rad(),
            "evidence": evidence,
            "ran_at_unix_s": ran.iter().find(|(step, _)| *step == report.step).map(|(_, at)| at)
                .filter(|_| report.verdict != Verdict::Skipped),
        })
    };
    json!({
        "rig": rig.rig.name,
        "rig_hash": earlier::rig_hash(rig),
        "machine": machine.document(),
        "drives": commissioned.drives,
        "version": env!("CARGO_PKG_VERSION"),
        "verdict": commissioned.verdict().name(),
        "steps": commissioned.steps.iter().map(step).collect::<Vec<_>>(),
    })
}
