//! A progress bar on a terminal, nothing elsewhere.

use std::io::{self, IsTerminal};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::output::Output;
use yieldwall_rig::report::Stage;

/// Steps of the bar.
const STEPS: u64 = 1000;

/// Returns a bar; hidden with `--json`, with `--quiet`, and where standard error is no terminal.
pub(super) fn bar(output: &Output, steps: u64, template: &str) -> ProgressBar {
    let bar = ProgressBar::new(steps);
    if output.is_json() || output.is_quiet() || !io::stderr().is_terminal() {
        bar.set_draw_target(ProgressDrawTarget::hidden());
    }
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar
}

/// The bar of one run.
pub(super) struct Progress(ProgressBar);

impl Progress {
    pub(super) fn new(output: &Output) -> Self {
        Self(bar(output, STEPS, "{msg:16} {bar:40} {percent:>3} %  {elapsed}"))
    }

    /// Returns a hidden progress display.
    pub(super) fn hidden() -> Self {
        Self(ProgressBar::hidden())
    }

    /// Names the current activity.
    pub(super) fn begin(&self, what: &str) {
        if self.0.message() != what {
            self.0.set_message(what.to_owned());
        }
    }

    pub(super) fn at(&self, stage: Stage) {
        let share = (stage.time_s / stage.end_s).clamp(0.0, 1.0);
        let position = (share * STEPS as f64) as u64;
        if position != self.0.position() {
            self.0.set_position(position);
        }
    }

    pub(super) fn end(self) {
        self.0.finish_and_clear();
    }
}
