//! Figures of traces, as SVG and PNG, laid out like those of [KTF08, Figs 8 to 16]. This package and the charts of studies alone name the plotting crate.
//!
//! All figures are 160 mm wide with letters of about 7 pt. Curves differ in lightness, width and dashes as well as in colour, so that
//! readers can distinguish them in print without colours, also if they are colour-blind.
//!
//! Long traces are thinned for drawing only, without visible loss. Way curves leave out corners that would move the line by less than 0.04
//! mm on paper. Time curves keep the first, lowest, highest and last value of every 0.05 mm.

mod animation;
mod axes;
pub mod chart;
mod comparison;
mod curve;
mod error;
mod heading;
mod history;
mod legend;
mod magnified;
mod marks;
mod page;
mod plane;
mod trajectory;

#[cfg(test)]
mod tests;

pub use animation::{MOST_MOVING, Throw, animation};
pub use comparison::comparison;
pub use error::Error;
pub use heading::differences;
pub use history::hold_comparison;
pub use magnified::{View, magnified};
pub use trajectory::trajectory_and_time;

use page::Page;
use std::path::Path;
use yieldwall_record::{FaultMark, Reference, Row, Trace};

/// Part of the plane of x and y: a square, or the middle square of a wider panel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Centre in m.
    pub center_m: [f64; 2],
    /// Half of the least width and height in m, above zero.
    pub half_width_m: f64,
}

/// Rows to draw.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum TimeSpan {
    /// All rows.
    #[default]
    Whole,
    /// Rows whose time lies between two times, both included.
    Between {
        /// Begin in s.
        from_s: f64,
        /// End in s, after the begin.
        to_s: f64,
    },
    /// Rows around the first moment at which the proxy meets the surface, stopped or not; time then counts from it,
    /// in ms.
    AroundImpact {
        /// Time before the impact, in s.
        before_s: f64,
        /// Time after the impact, in s.
        after_s: f64,
    },
}

/// Choices of the caller.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Title above the line with drive, law, `R`, `F`, `M`, `T` and `N_wait`; may be empty. `None`: neither, since a paper has its caption.
    pub heading: Option<String>,
    /// Rows to draw.
    pub time_span: TimeSpan,
    /// Part of the plane that [`trajectory_and_time`] shows; `None`: the part that the tool used, with a margin.
    pub window: Option<Window>,
    /// The most force arrows that are drawn, at least 1.
    pub arrow_limit: usize,
    /// Whether SVG files carry their font, which makes them look the same everywhere and 3 MB larger.
    pub is_font_embedded: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { heading: None, time_span: TimeSpan::Whole, window: None, arrow_limit: 35, is_font_embedded: false }
    }
}

/// A finished figure.
#[derive(Debug)]
pub struct Drawing {
    page: Page,
    is_font_embedded: bool,
}

impl Drawing {
    /// Returns the figure as an SVG document, 160 mm wide.
    pub fn svg(&self) -> String {
        self.page.svg(self.is_font_embedded)
    }

    /// Returns the figure as a PNG picture; 1890 pixels across give 300 dots per inch.
    ///
    /// # Errors
    /// [`Error::PictureWidth`] outside 100 to 20 000 pixels; [`Error::Encode`] when the encoder fails.
    pub fn png(&self, width_px: u32) -> Result<Vec<u8>, Error> {
        self.page.png(width_px)
    }

    /// Writes [`Drawing::svg`] to a file, in place of what was there.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write_svg(&self, path: &Path) -> Result<(), Error> {
        write(path, self.svg().as_bytes())
    }

    /// Writes [`Drawing::png`] to a file, in place of what was there.
    ///
    /// # Errors
    /// As [`Drawing::png`], and [`Error::Write`].
    pub fn write_png(&self, path: &Path, width_px: u32) -> Result<(), Error> {
        write(path, &self.png(width_px)?)
    }

    fn new(page: Page, options: &Options) -> Self {
        Self { page, is_font_embedded: options.is_font_embedded }
    }
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    std::fs::write(path, bytes).map_err(|source| Error::Write { path: path.to_path_buf(), source })
}

/// The rows of a span, all of them fit to be drawn, and how their time is shown.
#[derive(Debug)]
struct Excerpt<'a> {
    rows: Vec<&'a Row>,
    /// Rows up to the fault that stopped the rig: those in which a proxy leads the tool.
    led: usize,
    origin_s: f64,
    per_second: f64,
    label: &'static str,
    span: [f64; 2],
}

impl<'a> Excerpt<'a> {
    fn new(trace: &'a Trace, span: TimeSpan) -> Result<Self, Error> {
        error::check(trace)?;
        let (from_s, to_s, origin_s) = match span {
            TimeSpan::Whole => (f64::NEG_INFINITY, f64::INFINITY, 0.0),
            TimeSpan::Between { from_s, to_s } => (from_s, to_s, 0.0),
            TimeSpan::AroundImpact { before_s, after_s } => {
                let contact = trace.contacts().next().and_then(|at| trace.rows.get(at));
                let at_s = contact.ok_or_else(|| Error::NoImpact { title: trace.title.clone() })?.time_s;
                (at_s - before_s, at_s + after_s, at_s)
            }
        };
        let is_inside = |row: &&Row| (from_s..=to_s).contains(&row.time_s);
        let rows: Vec<&Row> = trace.rows.iter().chain(&trace.after).filter(is_inside).collect();
        let led = trace.rows.iter().filter(is_inside).count();
        let (Some(first), Some(last)) = (rows.first(), rows.last()) else {
            return Err(Error::EmptySpan { title: trace.title.clone(), from_s, to_s });
        };
        let (per_second, label) = match span {
            TimeSpan::AroundImpact { .. } => (1000.0, "time since impact (ms)"),
            _ => (1.0, "time t (s)"),
        };
        let span = [first.time_s, last.time_s].map(|time_s| (time_s - origin_s) * per_second);
        Ok(Self { rows, led, origin_s, per_second, label, span })
    }

    /// Returns the rows in which a proxy leads the tool.
    fn led(&self) -> impl Iterator<Item = &'a Row> + '_ {
        self.rows.iter().take(self.led).copied()
    }

    /// Returns the faults within the span: the shown time and the name of each, and where the tool was.
    fn faults(&self, trace: &Trace) -> Vec<(f64, &'static str, [f64; 3])> {
        let seen = |mark: &FaultMark| {
            let row = self.rows.iter().find(|row| row.time_s >= mark.time_s)?;
            let is_inside = self.rows.first().is_some_and(|first| first.time_s <= mark.time_s);
            is_inside.then(|| (self.shown_time(mark.time_s), mark.fault, row.tool_m))
        };
        trace.faults.iter().filter_map(seen).collect()
    }

    /// Returns the rows in which the surface gave way.
    fn break_outs(&self, trace: &'a Trace) -> impl Iterator<Item = &'a Row> + '_ {
        let [from_s, to_s] = [self.rows.first(), self.rows.last()].map(|row| row.map_or(0.0, |row| row.time_s));
        let rows = trace.break_outs().filter_map(|at| trace.rows.get(at));
        rows.filter(move |row| (from_s..=to_s).contains(&row.time_s))
    }

    /// Returns the time of a moment on the shown axis.
    fn shown_time(&self, time_s: f64) -> f64 {
        (time_s - self.origin_s) * self.per_second
    }
}

/// Draws (a), (b) and so on.
fn panel_letter(page: &mut Page, at: curve::Point, number: usize) {
    let letter = ('a'..='z').nth(number).unwrap_or('?');
    page.bold_text(at, &format!("({letter})"));
}

/// Draws the hold of a panel's run behind the panel's letter.
fn hold_steps(page: &mut Page, (x, y): curve::Point, trace: &Trace) {
    if let Some(hold) = heading::hold_steps(trace) {
        page.text((x + 55.0, y), page::Anchor::Start, &hold);
    }
}

/// A surface as a line in the plane of x and y.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceLine {
    /// Corners in m, base frame, at least one. The forbidden side of a unilateral fixture lies to the right of the way along them.
    pub points_m: Vec<[f64; 2]>,
    /// Whether the last corner joins the first.
    pub is_closed: bool,
    /// Whether it has sides, of which a fixture may forbid one; a point has none.
    pub has_sides: bool,
}

/// Lines of surfaces at their place, in the order of `references`. Surfaces in space are cut at z = 0; those that no line shows are left out.
/// `window_m` is the part of the plane that is shown, in m, base frame: least x, least y, greatest x, greatest y.
pub fn surface_lines(references: &[Reference], window_m: [f64; 4]) -> Vec<SurfaceLine> {
    plane::lines_m(references, window_m)
}

/// Returns the drawing of one run: trajectory with forces, force and power against time. The title may be empty.
///
/// # Errors
/// As [`trajectory_and_time`].
pub fn run(trace: &Trace, title: String) -> Result<Drawing, Error> {
    trajectory_and_time(trace, &Options { heading: Some(title), ..Options::default() })
}
