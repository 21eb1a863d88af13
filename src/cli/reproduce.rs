//! `yieldwall reproduce`: the figures of the paper, run and drawn again.

use std::path::PathBuf;

use serde_json::{Value, json};

use super::compare::Table;
use super::ending::{above_bound, rig_failure};
use super::failure::{self, Exit, Failure};
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
    /// Figure of the paper, all figures, or your own file, such as a copy of config/figures/fig9.yaml. All figures are one table;
    /// --verbose adds the measures of each run
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
    // Traces are large: none is kept beyond its figure.
    let (mut entries, mut rows, mut details) = (Vec::new(), Vec::new(), Vec::new());
    let (mut drawings, mut end): (usize, Result<(), Failure>) = (0, Ok(()));
    let names = match &arguments.figure {
        Choice::Paper(figures) => figures.clone(),
        Choice::File(path) => vec![path.as_str()],
    };
    for figure in &names {
        let progress = Progress::new(output);
        let at = |figure: &str, mode: Mode, stage: Stage| {
            progress.begin(&format!("{figure}, {}", mode.in_words()));
            progress.at(stage);
        };
        let runs = match &arguments.figure {
            Choice::Paper(_) => reproduce(figure, hand, at).map(|runs| (runs, Vec::new())),
            Choice::File(path) => reproduce_file(path, hand, at),
        };
        progress.end();
        let (runs, warnings) = runs.map_err(failure)?;
        output.configuration(&warnings)?;
        for named in drawing::figure(&runs).map_err(|error| drawing_failure(&error))? {
            for ending in ["svg", "png"] {
                let path = arguments.out.join(format!("{}.{ending}", named.name));
                check_picture(&path, arguments.replace)?;
                write_drawing(&named.drawing, &path)?;
            }
            drawings += 1;
        }
        for run in &runs {
            entries.push(entry(run));
            rows.push(row(run));
            details.push(text(run));
        }
        let judged = judge(&runs);
        if judged.as_ref().is_err_and(|failure| failure.exit == Exit::SafetyStop) {
            end = judged;
            break;
        }
        end = end.and(judged);
    }
    if output.is_json() {
        return match end {
            Err(failure) if failure.exit == Exit::SafetyStop => Err(failure),
            end => output.end(json!({ "figures": entries }), end),
        };
    }
    let count = |number: usize, one: &str| if number == 1 { format!("1 {one}") } else { format!("{number} {one}s") };
    let well = format!("{} of {}, energy within its limit", count(details.len(), "run"), count(names.len(), "figure"));
    let mut lines = vec![failure::verdict(&end, || well)];
    let has_table = names.len() > 1;
    if has_table {
        lines.extend(table(rows));
    }
    if !has_table || tracing::enabled!(tracing::Level::DEBUG) {
        lines.extend(details);
    }
    let folder = arguments.out.display();
    lines.push(format!("drawn     {} in {folder}, each as .svg and .png", count(drawings, "drawing")));
    output.news(&lines.join("\n"))?;
    end
}

/// Judges the runs of a figure: none may be stopped, and the energy of each has to be within its limit.
fn judge(runs: &[FigureRun]) -> Result<(), Failure> {
    if let Some(run) = runs.iter().find(|run| run.report.state.is_some_and(|state| state.is_latched())) {
        let cause = run.report.cause.map_or("", |cause| cause.fault.row().name);
        let message = format!("{}, {}: the rig was stopped by {cause}", run.figure, run.mode.in_words());
        return Err(Failure::new(Exit::SafetyStop, message, "the scene asks for more than the rig's limits allow"));
    }
    let Some(run) = runs.iter().find(|run| !run.measures().is_within_bound()) else { return Ok(()) };
    let help = "`yieldwall config check` shows the loop margins of each machine that the figure names";
    Err(above_bound(run.measures(), &format!("{}, {}", run.figure, run.mode.in_words()), help))
}

/// Returns a line for each row, with the meaning of the columns.
fn table(rows: Vec<Vec<String>>) -> Vec<String> {
    let head = ["figure  machine", "N_wait", "depth", "paper", "force", "paper", "burst", "limit"];
    let mut table = Table::new(head.map(str::to_owned).to_vec());
    rows.into_iter().for_each(|row| table.push(row));
    let meanings = [
        "depth     deepest impact below R in mm; the paper: \"a few millimeters\", or none",
        "force     largest normal force on the surface in N",
        "R         3 N (impedance device), 20 N (torque and position mode)",
        "burst     largest energy burst into the hand in mJ",
    ];
    table.lines().into_iter().chain(meanings.map(str::to_owned)).collect()
}

/// Returns the measures of a run beside the paper's values, for the table.
fn row(run: &FigureRun) -> Vec<String> {
    let (measures, [depth, force]) = (run.measures(), published(run));
    vec![
        format!("{:6}  {}", run.figure, run.mode.in_words()),
        run.hold_steps.to_string(),
        format!("{:.2}", measures.penetration_mm),
        depth.to_owned(),
        measures.peak_force_on_surface_n.map_or("-".to_owned(), |force_n| format!("{force_n:.2}")),
        force.to_owned(),
        format!("{:.1}", 1e3 * measures.bounded_energy_j()),
        format!("{:.1}", 1e3 * measures.energy_bound_j),
    ]
}

/// Returns the depth of impacts and the normal force on the surface that the paper gives for this run, `-` where it gives none.
///
/// # Source
/// [KTF08], Sec. IV-B: a proxy with a mass penetrates "for a few millimeters after impacting the surface"; "such penetrations were not
/// observed in the impedance-type implementation". Sec. IV: the hand traces the surface with a force smaller than R. Sec. V: with
/// `N_wait` 5 "an impulsive force higher than the yield force was produced", and with 15 "the penetration was prevented".
fn published(run: &FigureRun) -> [&'static str; 2] {
    match (run.figure.as_str(), run.mode, run.hold_steps) {
        ("fig8" | "fig9", ..) => ["none", "<= R"],
        ("fig13", Mode::Impedance, _) => ["none", "-"],
        ("fig11" | "fig12", ..) => ["a few", "<= R"],
        ("fig13", ..) | ("fig16", _, 0) => ["a few", "-"],
        ("fig14" | "fig15", _, 5) => ["-", "> R"],
        ("fig16", _, 15) => ["none", "-"],
        _ => ["-"; 2],
    }
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
    let mut lines = vec![format!("{}, {}, N_wait {}", run.figure, run.mode.in_words(), run.hold_steps)];
    lines.extend(measures_text(run.measures()).into_iter().map(|line| format!("  {line}")));
    if let Some(bare) = &run.without_feed_forward
        && let Some([tracing, in_contact]) = tool_text(bare)
    {
        lines.push(format!("  without feed-forward: {tracing}; {in_contact}"));
    }
    lines.join("\n")
}

fn failure(error: ReproduceError) -> Failure {
    match error {
        ReproduceError::Config(report) => report.into(),
        ReproduceError::Rig { figure, mode, source } => {
            let mut failure = rig_failure(&source);
            for finding in &mut failure.report.diagnostics {
                finding.message = format!("{figure}, {}: {}", mode.in_words(), finding.message);
            }
            failure
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_has_a_row_for_each_run_with_the_papers_values_in_eighty_columns() {
        let runs = |figure| reproduce(figure, HandScale::SAME, |_, _, _| ()).unwrap();
        let rows: Vec<Vec<String>> = runs("fig8").iter().chain(&runs("fig14")).map(row).collect();
        assert_eq!(rows[0][..4], ["fig8    impedance device", "0", "0.00", "none"]);
        assert_eq!((rows[1][1].as_str(), &rows[1][5]), ("0", &"-".to_owned()));
        assert_eq!((rows[2][1].as_str(), &rows[2][5]), ("5", &"> R".to_owned()));
        let force_n: f64 = rows[2][4].parse().unwrap();
        assert!(force_n > 3.0, "the hold makes the force rise above R: {force_n} N");
        let widest = ["fig16   impedance device", "15", "1.76", "a few", "19.97", "<= R", "4.4", "24.6"];
        let lines = table(rows.into_iter().chain([widest.map(str::to_owned).to_vec()]).collect());
        assert!(lines.iter().all(|line| line.chars().count() <= 80), "{lines:#?}");
    }
}
