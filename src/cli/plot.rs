//! `yieldwall plot`: a drawing of a recording.

use std::path::PathBuf;

use serde_json::json;

use super::failure::Failure;
use super::output::Output;
use super::picture::{check_picture, drawing_failure, write_drawing};
use super::replace::Replace;
use super::replay::{damage, failure, open, recording_file, records};
use yieldwall_rig::report::replay::recorded;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Recording: a cycles.mcap, its folder, or a black-box file
    #[arg(value_name = "RECORDING")]
    recording: PathBuf,
    /// Draw trajectory, force and power into this .svg or .png file; missing folders are created
    #[arg(long, value_name = "PATH", default_value = "recording.svg")]
    figure: PathBuf,
    #[command(flatten)]
    replace: Replace,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let (path, figure) = (&recording_file(&arguments.recording), &arguments.figure);
    check_picture(figure, arguments.replace)?;
    let mut recording = open(path)?;
    let (trace, _) = recorded(&mut recording).map_err(|error| failure(path, error))?;
    output.warnings(&damage(recording.damage(), path));
    let drawing = yieldwall_figures::run(&trace, String::new()).map_err(|error| drawing_failure(&error))?;
    write_drawing(&drawing, figure)?;
    if output.is_json() {
        return output.report(json!({ "recording": path, "figure": figure, "rows": trace.rows.len(), "rows_after_stop": trace.after.len() }));
    }
    let after = match trace.after.len() {
        0 => String::new(),
        count => format!(", and {count} after {}", trace.faults.last().map_or("the stop", |mark| mark.fault)),
    };
    output.news(&format!("{}: {} {} of the scene{after}", figure.display(), trace.rows.len(), records(&recording)))
}
