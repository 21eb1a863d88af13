//! Drawing for each run, as in the paper.

use super::reproduce::{FIG13, FigureRun, Mode};
use yieldwall_figures::{Drawing, Error, Options, TimeSpan, View, Window, hold_comparison, magnified, run};
use yieldwall_record::Trace;

/// Rows shown before and after the first impact in Figs 14 and 15, in s.
const AROUND_IMPACT_S: [f64; 2] = [0.1, 0.3];

/// A finished drawing and the name of its file, without ending.
#[derive(Debug)]
pub struct NamedDrawing {
    /// Such as `fig11-cst`.
    pub name: String,
    /// The drawing.
    pub drawing: Drawing,
}

/// The drawings of one figure: one for each way in which its machine was driven.
///
/// # Errors
/// As the drawings of [`yieldwall_figures`].
pub fn figure(runs: &[FigureRun]) -> Result<Vec<NamedDrawing>, Error> {
    let mut modes: Vec<Mode> = runs.iter().map(|run| run.mode).collect();
    modes.dedup();
    let mut drawings = Vec::new();
    for mode in modes {
        let of_mode: Vec<&FigureRun> = runs.iter().filter(|run| run.mode == mode).collect();
        let Some(first) = of_mode.first() else { continue };
        let heading = Some(first.title.clone());
        // Holds side by side, or in the windows of the figure.
        let drawing = match (of_mode.len() > 1, first.magnified.is_empty()) {
            _ if first.figure == FIG13 => enlarged(&of_mode, heading)?,
            (true, false) => enlarged(&of_mode, heading)?,
            (true, true) => {
                let [before_s, after_s] = AROUND_IMPACT_S;
                let traces: Vec<&Trace> = of_mode.iter().map(|run| run.trace()).collect();
                let time_span = TimeSpan::AroundImpact { before_s, after_s };
                hold_comparison(&traces, &Options { time_span, heading, ..Options::default() })?
            }
            (false, _) => run(first.trace(), first.title.clone())?,
        };
        drawings.push(NamedDrawing { name: format!("{}-{mode}", first.figure), drawing });
    }
    Ok(drawings)
}

fn enlarged(runs: &[&FigureRun], heading: Option<String>) -> Result<Drawing, Error> {
    let views: Vec<View<'_>> = runs
        .iter()
        .flat_map(|run| {
            run.magnified.iter().map(|window| View {
                trace: run.trace(),
                window: Window {
                    center_m: window.center_m.map(|value| value.get()),
                    half_width_m: window.half_width_m.get(),
                },
            })
        })
        .collect();
    magnified(&views, &Options { heading, ..Options::default() })
}
