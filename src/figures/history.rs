//! Curves over time: force and power of a run, and runs with and without a hold side by side.

use super::axes::{Axes, Kind, range_of};
use super::legend::{self, Entry, Sample};
use super::marks::{self, Mark};
use super::page::{Anchor, BLACK, Color, GREY, Page, Stroke, VERMILION, WIDTH};
use super::plane::{self, MM_PER_M, PROXY, SURFACE, SURFACE_BAND, TOOL};
use super::{Drawing, Error, Excerpt, Options, heading};
use yieldwall_record::{Row, Trace};

const FORCE: Stroke = Stroke { color: BLACK, width: 3.0, dash: &[] };
const LEVEL: Stroke = Stroke { color: BLACK, width: 2.0, dash: &[18.0, 10.0] };
/// Samples stand apart as dots when they are at least this far from one another: 1.2 mm.
const DOT_SPACING: f64 = 12.0;
/// Least distance of two level names, so that they do not touch.
const NAME_SPACING: f64 = 29.0;
/// Least height of a range, so that a curve without change has an axis: 0.1 N, 10 mW, 0.1 mm, and in time 1 ms.
const LEAST: f64 = 0.1;
const LEAST_POWER_W: f64 = 0.01;
/// The line at a fault.
const FAULT: Stroke = Stroke { color: VERMILION, width: 2.5, dash: &[4.0, 5.0] };
/// Rows of names of faults, their distance, and the room beside the line.
const FAULT_ROWS: usize = 4;
const FAULT_ROW: f64 = 34.0;
const FAULT_GAP: f64 = 10.0;

/// Most columns of [`hold_comparison`].
const MOST_COLUMNS: usize = 3;
const LEFT: f64 = 100.0;
const RIGHT: f64 = 60.0;
/// As above, with the name of an outward yield force.
const RIGHT_OUTWARD: f64 = 112.0;

/// Returns the force component along the normal; without a surface the magnitude of the force.
pub(super) fn shown_force_n(trace: &Trace, row: &Row) -> f64 {
    if trace.references.is_empty() {
        return row.force_n.iter().map(|component| component * component).sum::<f64>().sqrt();
    }
    trace.drawn_sign() * trace.normal_force_n(row)
}

/// Draws the force along the normal, with the levels `F` and `R` and the break-outs.
pub(super) fn force_panel(page: &mut Page, axes: &Axes, trace: &Trace, excerpt: &Excerpt<'_>) {
    axes.zero_line(page);
    levels(page, axes, trace);
    let values = || excerpt.rows.iter().map(|row| (excerpt.shown_time(row.time_s), shown_force_n(trace, row)));
    axes.curve(page, values(), Kind::History, FORCE);
    dots(page, axes, values(), FORCE);
    break_outs(page, axes, trace, excerpt, None);
}

/// Marks where the surface gave way in the force along the normal.
pub(super) fn break_outs(page: &mut Page, axes: &Axes, trace: &Trace, excerpt: &Excerpt<'_>, color: Option<Color>) {
    let places = excerpt.break_outs(trace).map(|row| {
        let (x, y) = (excerpt.shown_time(row.time_s), shown_force_n(trace, row));
        axes.place(x, y)
    });
    marks::draw(page, axes.frame, Mark::BreakOut, color, places);
}

/// Draws the power delivered to the hand.
pub(super) fn power_panel(page: &mut Page, axes: &Axes, excerpt: &Excerpt<'_>) {
    axes.zero_line(page);
    let values = excerpt.rows.iter().map(|row| (excerpt.shown_time(row.time_s), row.power_w));
    axes.curve(page, values, Kind::History, Stroke { color: GREY, ..FORCE });
}

/// Returns the range of the force axis: all values and zero, and `R` on each side on which the force goes beyond half of `F`.
pub(super) fn force_range<'a>(excerpts: impl Iterator<Item = (&'a Trace, &'a Excerpt<'a>)> + Clone) -> [f64; 2] {
    let values = excerpts
        .clone()
        .flat_map(|(trace, excerpt)| excerpt.rows.iter().map(move |row| shown_force_n(trace, row)).collect::<Vec<_>>());
    let [low, high] = range_of(values.chain([0.0]), 0.0, 0.0);
    let with_surface = excerpts.filter(|(trace, _)| !trace.references.is_empty());
    let levels = with_surface.flat_map(|(trace, _)| {
        let [most, least] = yields_n(trace);
        let up = most.filter(|_| high > trace.friction_n / 2.0);
        let down = least.filter(|_| low < -trace.friction_n / 2.0);
        up.into_iter().chain(down)
    });
    range_of(levels.chain([low, high]), LEAST, 0.06)
}

pub(super) fn power_range(excerpt: &Excerpt<'_>) -> [f64; 2] {
    range_of(excerpt.rows.iter().map(|row| row.power_w).chain([0.0]), LEAST_POWER_W, 0.06)
}

pub(super) fn time_range(excerpt: &Excerpt<'_>) -> [f64; 2] {
    range_of(excerpt.span.into_iter(), 1e-3, 0.0)
}

/// Returns the greatest and the least force on the hand that the surface answers with. A wall answers along its normal alone: the
/// hand pulls off it against `F`.
fn yields_n(trace: &Trace) -> [Option<f64>; 2] {
    let against = |sign: f64| {
        let push = -sign * trace.drawn_sign();
        (push < 0.0 || !trace.is_unilateral).then(|| sign * trace.yield_against_n(push))
    };
    [against(1.0), against(-1.0)]
}

/// Returns the room that the names of the levels of these runs need.
pub(super) fn right_of(traces: &[&Trace]) -> f64 {
    if traces.iter().any(|trace| trace.outward_yield_n.is_some()) { RIGHT_OUTWARD } else { RIGHT }
}

/// Draws dashed lines at `F` and `R` on both sides of zero, named at the right edge.
pub(super) fn levels(page: &mut Page, axes: &Axes, trace: &Trace) {
    let [most, least] = yields_n(trace);
    // A yield force of its own against pushes out of the forbidden side has a name of its own.
    let is_outward = |sign: f64| trace.outward_yield_n.is_some() && -sign * trace.drawn_sign() > 0.0;
    let yield_below = |sign: f64| if is_outward(sign) { "out" } else { "" };
    let friction = trace.friction_n;
    let [most, least] = [most, least].map(|yields| yields.filter(|_| !trace.setup.is_unyielding));
    let names = [
        (most, "", "R", yield_below(1.0)),
        (least, "\u{2212}", "R", yield_below(-1.0)),
        (Some(friction), "", "F", ""),
        (Some(-friction), "\u{2212}", "F", ""),
    ];
    let mut taken: Vec<f64> = Vec::new();
    for (value, sign, letter, below) in names {
        let Some(value) = value else { continue };
        let (right, y) = axes.place(axes.x[1], value);
        if !axes.frame.contains((right, y)) {
            continue;
        }
        axes.level(page, value, LEVEL);
        if taken.iter().all(|other| (other - y).abs() >= NAME_SPACING) {
            page.text((right + 8.0, y + 9.0), Anchor::Start, sign);
            let shift = if sign.is_empty() { 8.0 } else { 30.0 };
            page.symbol((right + shift, y + 9.0), letter, below);
            taken.push(y);
        }
    }
}

/// Lines where faults held or stopped the rig, through all panels, named in the first.
pub(super) fn faults(page: &mut Page, panels: &[Axes], trace: &Trace, excerpt: &Excerpt<'_>) {
    let Some(first) = panels.first() else { return };
    let mut ends = [f64::NEG_INFINITY; FAULT_ROWS];
    for (time, name, _) in excerpt.faults(trace) {
        for axes in panels {
            let (x, _) = axes.place(time, axes.y[0]);
            page.chain(&[(x, axes.frame.top), (x, axes.frame.bottom)], FAULT);
        }
        let (x, _) = first.place(time, first.y[0]);
        let width = legend::text_width(name);
        let right = x + FAULT_GAP + width;
        let left = if right <= first.frame.right { x + FAULT_GAP } else { x - FAULT_GAP - width };
        // Names that would lie on one another stand in rows; those that no row has room for are left to their lines.
        let Some((row, end)) = ends.iter_mut().enumerate().find(|(_, end)| **end < left) else { continue };
        *end = left + width + FAULT_GAP;
        let y = first.frame.top + 32.0 + FAULT_ROW * row as f64;
        page.blank((left + width / 2.0, y - 9.0), width, 32.0);
        page.text((left, y), Anchor::Start, name);
    }
}

/// Shows the single samples where there is room for them.
fn dots(page: &mut Page, axes: &Axes, values: impl Iterator<Item = (f64, f64)>, stroke: Stroke) {
    let places: Vec<_> = values.map(|(x, y)| axes.place(x, y)).collect();
    let width = axes.frame.right - axes.frame.left;
    if width < DOT_SPACING * places.len() as f64 {
        return;
    }
    for place in places.into_iter().filter(|place| axes.frame.contains(*place)) {
        page.dot(place, 1.5 * stroke.width.min(4.0), stroke.color);
    }
}

/// Draws one column for each trace, with the same scales. The upper panel has the position of tool and proxy along the surface's normal.
/// The lower panel has the force on the hand along it, with the levels `F` and `R`. Each column is headed by a letter, and by `N_wait`
/// if that is not in the heading.
///
/// Positions are signed distances from the reference surface, which is the line at zero.
///
/// # Errors
/// - [`Error::PanelCount`] for no trace or more than three;
/// - [`Error::NoLine`] without a surface or where it has no normal;
/// - the other errors of [`super::trajectory_and_time`].
///
/// # Source
/// [KTF08, Figs 14 and 15].
pub fn hold_comparison(traces: &[&Trace], options: &Options) -> Result<Drawing, Error> {
    let count = traces.len();
    if !(1..=MOST_COLUMNS).contains(&count) {
        return Err(Error::PanelCount { count, most: MOST_COLUMNS });
    }
    let columns = traces.iter().map(|trace| Column::new(trace, options)).collect::<Result<Vec<_>, _>>()?;
    let position = Positions::range(columns.iter().map(|column| &column.positions));
    let force = force_range(columns.iter().map(|column| (column.trace, &column.excerpt)));

    let heading = heading::lines(traces, options);
    let head = heading::height(&heading) + 46.0;
    let (above, height, gap) = (head + 84.0, 430.0, 62.0);
    let mut page = Page::new(above + 2.0 * height + gap + 96.0);
    heading::draw(&mut page, &heading);
    let mut entries = plane::way_entries();
    entries.push(Entry::new(Sample::Lines(vec![SURFACE_BAND, SURFACE]), "reference surface"));
    if columns.iter().any(|column| column.excerpt.break_outs(column.trace).next().is_some()) {
        entries.push(Entry::mark(Mark::BreakOut));
    }
    legend::draw(&mut page, (LEFT, head - 14.0), WIDTH - LEFT, &entries);
    let cell = WIDTH / count as f64;
    let right = right_of(traces);
    let width = (cell - LEFT - right).min(1000.0);
    for (number, column) in columns.iter().enumerate() {
        let left = number as f64 * cell + LEFT + (cell - LEFT - right - width) / 2.0;
        let x = time_range(&column.excerpt);
        let upper = Axes { frame: plane::frame(left, above, width, height), x, y: position };
        let lower = Axes { frame: plane::frame(left, above + height + gap, width, height), x, y: force };
        column.positions.draw(&mut page, &upper);
        let break_outs = column.excerpt.break_outs(column.trace);
        let places = break_outs.map(|row| upper.place(column.excerpt.shown_time(row.time_s), 0.0));
        marks::draw(&mut page, upper.frame, Mark::BreakOut, None, places);
        upper.draw(&mut page, None, "position along the normal (mm)");
        force_panel(&mut page, &lower, column.trace, &column.excerpt);
        lower.draw(&mut page, Some(column.excerpt.label), "force along the normal (N)");
        super::panel_letter(&mut page, (left, above - 52.0), number);
        if !heading::has_hold(traces, options) {
            super::hold_steps(&mut page, (left, above - 52.0), column.trace);
        }
    }
    Ok(Drawing::new(page, options))
}

/// A trace and the positions along the normal.
struct Column<'a> {
    trace: &'a Trace,
    excerpt: Excerpt<'a>,
    positions: Positions,
}

/// Positions of tool and proxy along the normal, in mm, at times as they are shown.
pub(super) struct Positions {
    pub(super) tool: Vec<(f64, f64)>,
    proxy: Vec<(f64, f64)>,
}

impl Positions {
    pub(super) fn new(trace: &Trace, excerpt: &Excerpt<'_>) -> Self {
        let shown =
            |row: &Row, distance_m: f64| (excerpt.shown_time(row.time_s), trace.drawn_sign() * distance_m * MM_PER_M);
        let tool = excerpt.rows.iter().map(|row| shown(row, row.tool_distance_m)).collect();
        let proxy = excerpt.led().map(|row| shown(row, row.signed_distance_m)).collect();
        Self { tool, proxy }
    }

    fn all(&self) -> impl Iterator<Item = f64> {
        self.tool.iter().chain(&self.proxy).map(|(_, position)| *position)
    }

    pub(super) fn range<'a>(of: impl Iterator<Item = &'a Self>) -> [f64; 2] {
        range_of(of.flat_map(Self::all).chain([0.0]), LEAST, 0.06)
    }

    pub(super) fn draw(&self, page: &mut Page, axes: &Axes) {
        for stroke in [SURFACE_BAND, SURFACE] {
            axes.level(page, 0.0, stroke);
        }
        axes.curve(page, self.tool.iter().copied(), Kind::History, TOOL);
        axes.curve(page, self.proxy.iter().copied(), Kind::History, PROXY);
        dots(page, axes, self.proxy.iter().copied(), PROXY);
    }
}

impl<'a> Column<'a> {
    fn new(trace: &'a Trace, options: &Options) -> Result<Self, Error> {
        let excerpt = Excerpt::new(trace, options.time_span)?;
        if trace.references.is_empty() {
            return Err(Error::NoLine { title: trace.title.clone() });
        }
        let positions = Positions::new(trace, &excerpt);
        Ok(Self { trace, excerpt, positions })
    }
}
