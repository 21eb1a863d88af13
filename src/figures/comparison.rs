//! Several runs over one another.

use super::axes::{Axes, Kind};
use super::history::{Positions, break_outs, force_range, levels, right_of, shown_force_n, time_range};
use super::legend::{self, Entry, Sample};
use super::page::{Color, LETTER, Page, SKY, Stroke, VERMILION, WIDTH};
use super::plane::{self, Places, SURFACE, SURFACE_BAND};
use super::trajectory::{BESIDE_PLANE, LEAST_HEIGHT, LEFT, LETTER_OFFSET, around, force_name};
use super::{Drawing, Error, Excerpt, Options, heading};
use yieldwall_record::Trace;

/// Lines that differ in lightness, width and dashes as well as in colour, the widest first: it lies below the others.
const LINES: [Stroke; 6] = [
    Stroke { color: SKY, width: 8.0, dash: &[] },
    Stroke { color: VERMILION, width: 4.0, dash: &[] },
    Stroke { color: Color(0x00, 0x00, 0x00), width: 2.5, dash: &[14.0, 7.0] },
    Stroke { color: Color(0x00, 0x9e, 0x73), width: 3.5, dash: &[24.0, 6.0, 5.0, 6.0] },
    Stroke { color: Color(0xe6, 0x9f, 0x00), width: 3.5, dash: &[4.0, 6.0] },
    Stroke { color: Color(0xcc, 0x79, 0xa7), width: 3.0, dash: &[30.0, 10.0] },
];
/// Room for a name in the legend.
const NAME_ROOM: f64 = 1400.0;

/// Draws a comparison of several runs. The left panel has the ways of the tools of all runs with the surfaces of all, seen along z. The
/// right panels have the force along the normal and the distance of the tools from the surface over time; they are left out where a run has
/// no surface. `F` and `R` are drawn where they are the same for all. Each name stands in the legend, in the order of the traces.
///
/// # Errors
/// [`Error::PanelCount`] for no trace or more than six; further as [`super::trajectory_and_time`].
pub fn comparison(runs: &[(&str, &Trace)], options: &Options) -> Result<Drawing, Error> {
    let Some((_, first)) = runs.first().filter(|_| runs.len() <= LINES.len()) else {
        return Err(Error::PanelCount { count: runs.len(), most: LINES.len() });
    };
    let all = runs.iter().map(|(_, trace)| Overlaid::new(trace, options)).collect::<Result<Vec<_>, _>>()?;
    let traces: Vec<&Trace> = runs.iter().map(|(_, trace)| *trace).collect();
    let heading = heading::lines(&traces, options);
    let head = heading::height(&heading);
    let (above, side) = (head + 110.0, 720.0);

    let frame = plane::frame(LEFT, above, side, side);
    let points: Vec<_> = all.iter().flat_map(Overlaid::way).collect();
    let axes = around(frame, &points, 0.05, LEAST_HEIGHT);
    let mut entries: Vec<Entry> = runs.iter().zip(LINES).map(|((name, _), line)| entry(name, line)).collect();
    // What of the surfaces comes into sight is in the legend, whose height shifts the frame.
    let mut scratch = Page::new(above);
    for one in all.iter().enumerate().filter_map(|(at, one)| is_new(&all, at).then_some(one)) {
        let sight = plane::surfaces(&mut scratch, &axes, one.trace, &one.places)?;
        legend::add(&mut entries, one.places.entries(one.trace, sight));
    }
    for one in &all {
        legend::add(&mut entries, plane::marks(&mut scratch, &axes, one.trace, &one.excerpt, None));
    }
    let room = WIDTH - LEFT;
    let top = above + legend::further_height(&entries, room);
    let height = axes.frame.bottom - axes.frame.top;
    let mut page = Page::new(top + height + 96.0);
    heading::draw(&mut page, &heading);
    legend::draw(&mut page, (LEFT, head + 40.0), room, &entries);

    let axes = Axes { frame: plane::frame(LEFT, top, side, height), ..axes };
    for (at, one) in all.iter().enumerate() {
        if is_new(&all, at) {
            plane::surfaces(&mut page, &axes, one.trace, &one.places)?;
        }
    }
    for (one, line) in all.iter().zip(LINES) {
        axes.curve(&mut page, one.way(), Kind::Way, line);
    }
    for (one, line) in all.iter().zip(LINES) {
        plane::marks(&mut page, &axes, one.trace, &one.excerpt, Some(line.color));
    }
    axes.draw(&mut page, Some("x (mm)"), "y (mm)");
    super::panel_letter(&mut page, (LEFT - LETTER_OFFSET, top - 15.0), 0);

    let (left, gap) = BESIDE_PLANE;
    let width = WIDTH - left - right_of(&traces);
    let x = all
        .iter()
        .map(|one| time_range(&one.excerpt))
        .fold([f64::INFINITY, f64::NEG_INFINITY], |all, one| [all[0].min(one[0]), all[1].max(one[1])]);
    let has_distance = all.iter().all(|one| !one.trace.references.is_empty());
    let height = if has_distance { (height - gap) / 2.0 } else { height };
    let label = all.first().map(|one| one.excerpt.label);
    let upper = Axes {
        frame: plane::frame(left, top, width, height),
        x,
        y: force_range(all.iter().map(|one| (one.trace, &one.excerpt))),
    };
    upper.zero_line(&mut page);
    let has_levels_of = |other: &Overlaid<'_>| {
        let of = |trace: &Trace| (trace.friction_n, trace.yield_n, trace.outward_yield_n, trace.is_unilateral);
        of(other.trace) == of(first)
    };
    if all.iter().all(has_levels_of) {
        let yielding = traces.iter().find(|trace| !trace.setup.is_unyielding);
        levels(&mut page, &upper, yielding.unwrap_or(first));
    }
    for (one, line) in all.iter().zip(LINES) {
        let shown = |row: &&yieldwall_record::Row| (one.excerpt.shown_time(row.time_s), shown_force_n(one.trace, row));
        upper.curve(&mut page, one.excerpt.rows.iter().map(shown), Kind::History, thinner(line));
    }
    for (one, line) in all.iter().zip(LINES) {
        break_outs(&mut page, &upper, one.trace, &one.excerpt, Some(line.color));
    }
    let is_like_first = |one: &Overlaid<'_>| force_name(one.trace) == force_name(first);
    let name = if all.iter().all(is_like_first) { force_name(first) } else { "force along the normal (N)".to_owned() };
    upper.draw(&mut page, label.filter(|_| !has_distance), &name);
    super::panel_letter(&mut page, (left - LETTER_OFFSET, top - 15.0), 1);
    if has_distance {
        let positions: Vec<Positions> = all.iter().map(|one| Positions::new(one.trace, &one.excerpt)).collect();
        let frame = plane::frame(left, top + height + gap, width, height);
        let lower = Axes { frame, x, y: Positions::range(positions.iter()) };
        for stroke in [SURFACE_BAND, SURFACE] {
            lower.level(&mut page, 0.0, stroke);
        }
        for (positions, line) in positions.iter().zip(LINES) {
            lower.curve(&mut page, positions.tool.iter().copied(), Kind::History, thinner(line));
        }
        lower.draw(&mut page, label, "distance of the tool from the surface (mm)");
    }
    Ok(Drawing::new(page, options))
}

/// One of the runs.
struct Overlaid<'a> {
    trace: &'a Trace,
    excerpt: Excerpt<'a>,
    places: Places,
}

impl<'a> Overlaid<'a> {
    fn new(trace: &'a Trace, options: &Options) -> Result<Self, Error> {
        let excerpt = Excerpt::new(trace, options.time_span)?;
        Ok(Self { trace, places: Places::new(trace, &excerpt), excerpt })
    }

    /// Returns the way of the tool, in mm.
    fn way(&self) -> impl Iterator<Item = (f64, f64)> {
        self.excerpt.rows.iter().map(|row| plane::in_mm(row.tool_m))
    }
}

/// Whether no run before this one has the same surfaces.
fn is_new(all: &[Overlaid<'_>], at: usize) -> bool {
    let drawn = |one: &Overlaid<'_>| (one.trace.references.clone(), one.trace.is_unilateral, one.places);
    all.get(at).is_some_and(|one| all.iter().take(at).all(|before| drawn(before) != drawn(one)))
}

/// Returns a line over time, which lies closer than a way.
fn thinner(line: Stroke) -> Stroke {
    Stroke { width: 0.75 * line.width, ..line }
}

fn entry(name: &str, line: Stroke) -> Entry {
    Entry::new(Sample::Lines(vec![line]), legend::shortened(name, NAME_ROOM, LETTER.into()))
}
