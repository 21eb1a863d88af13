//! `yieldwall reproduce`: the figures of the paper, run and drawn again.

use std::path::PathBuf;

use serde_json::{Value, json};

use super::ending::{above_bound, rig_failure};
use super::failure::{Exit, Failure};
use super::output::Output;
use super::picture::{check_picture, drawing_failure, write_drawing};
use super::progress::Progress;
use super::replace::Replace;
use super::report_text::{measures_text, tool_text};
use yieldwall_rig::report::Stage;
use yieldwall_study::drawing;
use yieldwall_study::reproduce::{FIGURES, FigureRun, HandScale, Mode, ReproduceError, reproduce, reproduce_file};

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Figure of the paper, all figures, or your own file, such as a copy of config/figures/fig9.yaml
    #[arg(value_name = "FIGURE", value_parser = parse_figure)]
    figure: Choice,
    /// Folder for the drawings, each as .svg and .png; created if missing
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    /// Factor on the hand's stiffness and damping, to see their influence
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = parse_factor, allow_negative_numbers = true)]
    hand_stiffness: f64,
    /// Factor on the hand's mass, to see its influence
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = parse_factor, allow_negative_numbers = true)]
    hand_mass: f64,
    #[command(flatten)]
    replace: Replace,
}

#[derive(Clone, Debug)]
enum Choice {
    Paper(Vec<&'static str>),
    File(String),
}

fn parse_figure(text: &str) -> Result<Choice, String> {
    if text == "all" {
        return Ok(Choice::Paper(FIGURES.to_vec()));
    }
    match FIGURES.iter().find(|figure| **figure == text) {
        Some(figure) => Ok(Choice::Paper(vec![figure])),
        None if text.contains(['.', '/', ':']) => Ok(Choice::File(text.to_owned())),
        None => Err(format!("the figures are {}, all; or name a file, FIGURE.yaml", FIGURES.join(", "))),
    }
}

fn parse_factor(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(factor) if (0.1..=10.0).contains(&factor) => Ok(factor),
        _ => Err("a factor is a number from 0.1 to 10".to_owned()),
    }
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let hand = HandScale { stiffness: arguments.hand_stiffness, mass: arguments.hand_mass };
    let mut entries: Vec<Value> = Vec::new();
    let mut out_of_bound = None;
    let names = match &arguments.figure {
        Choice::Paper(figures) => figures.clone(),
        Choice::File(path) => vec![path.as_str()],
    };
    for figure in names {
        let progress = Progress::new(output);
        let at = |figure: &str, mode: Mode, stage: Stage| {
            progress.begin(&format!("{figure} {mode}"));
            progress.at(stage);
        };
        let runs = match &arguments.figure {
            Choice::Paper(_) => reproduce(figure, hand, at).map(|runs| (runs, Vec::new())),
            Choice::File(path) => reproduce_file(path, hand, at),
        };
        progress.end();
        let (runs, warnings) = runs.map_err(failure)?;
        output.configuration(&warnings)?;
        let mut files = Vec::new();
        let drawings = drawing::figure(&runs).map_err(|error| drawing_failure(&error))?;
        for named in drawings {
            for ending in ["svg", "png"] {
                let path = arguments.out.join(format!("{}.{ending}", named.name));
                check_picture(&path, arguments.replace)?;
                write_drawing(&named.drawing, &path)?;
                files.push(path);
            }
        }
        for run in &runs {
            entries.push(entry(run));
            output.news(&text(run))?;
        }
        for file in files.iter().filter(|file| file.extension().is_some_and(|ending| ending == "svg")) {
            output.news(&format!("  drawn in {} and .png", file.display()))?;
        }
        if let Some(run) = runs.iter().find(|run| run.report.state.is_some_and(|state| state.is_latched())) {
            let cause = run.report.cause.map_or("", |cause| cause.fault.row().name);
            let message = format!("{figure} {}: the rig was stopped by {cause}", run.mode);
            return Err(Failure::new(Exit::SafetyStop, message, "the scene asks for more than the rig's limits allow"));
        }
        if let Some(run) = runs.iter().find(|run| !run.measures().is_within_bound()) {
            out_of_bound.get_or_insert_with(|| {
                let help = "`yieldwall config check` shows the loop margins of each machine that the figure names";
                above_bound(run.measures(), &format!("{figure} {}", run.mode), help)
            });
        }
    }
    if output.is_json() {
        return output.end(json!({ "figures": entries }), out_of_bound.map_or(Ok(()), Err));
    }
    out_of_bound.map_or(Ok(()), Err)
}

/// Returns the measures of a run, after its name.
fn entry(run: &FigureRun) -> Value {
    let mut entry = json!({ "figure": run.figure, "mode": run.mode.to_string(), "n_wait": run.hold_steps });
    if let (Value::Object(entry), Ok(Value::Object(measures))) = (&mut entry, serde_json::to_value(run.measures())) {
        entry.extend(measures);
        let bare = run.without_feed_forward.as_ref();
        entry.insert(
            "without_feed_forward".to_owned(),
            json!(bare.map(|bare| json!({
                "tool_rms_tracing_mm": bare.tool_rms_tracing_mm,
                "tool_rms_on_surface_mm": bare.tool_rms_on_surface_mm,
                "tool_max_on_surface_mm": bare.tool_max_on_surface_mm,
            }))),
        );
    }
    entry
}

fn text(run: &FigureRun) -> String {
    let mut lines = vec![format!("{} {}, N_wait {}", run.figure, run.mode, run.hold_steps)];
    lines.extend(measures_text(run.measures()).into_iter().map(|line| format!("  {line}")));
    if let Some(bare) = &run.without_feed_forward
        && let Some(line) = tool_text(bare)
    {
        lines.push(format!("  without feed-forward: {}", line.trim_start_matches("tool").trim_start()));
    }
    lines.join("\n")
}

fn failure(error: ReproduceError) -> Failure {
    match error {
        ReproduceError::Config(report) => report.into(),
        ReproduceError::Rig { figure, mode, source } => {
            let mut failure = rig_failure(&source);
            for finding in &mut failure.report.diagnostics {
                finding.message = format!("{figure} {mode}: {}", finding.message);
            }
            failure
        }
    }
}
