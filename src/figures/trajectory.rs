//! A run as a whole: like [KTF08, Figs 8, 9, 11 and 12].

use super::axes::{Axes, number, range_of};
use super::curve::{Frame, Point};
use super::history::{Positions, faults, force_panel, force_range, power_panel, power_range, right_of, time_range};
use super::legend::{self, Entry, Sample};
use super::page::{Anchor, Color, GREY, Page, Stroke, WIDTH};
use super::plane::{self, MM_PER_M, Places};
use super::{Drawing, Error, Excerpt, Options, heading};
use yieldwall_motion::elementary;
use yieldwall_record::{ForceMeaning, Phase, Row, Trace};

pub(super) const LEFT: f64 = 100.0;
/// Distance of a panel's letter from its frame, to the left.
pub(super) const LETTER_OFFSET: f64 = 58.0;
const ARROW: Stroke = Stroke { color: Color(0x50, 0x50, 0x50), width: 2.5, dash: &[] };
/// Length on paper of the force below which 98 of 100 lie, or of `R` if that is larger: 11 mm.
const ARROW_LENGTH: f64 = 110.0;
/// The frame is made large enough for arrows up to this length: a hard impact shall not shrink the way to a dot.
const LONGEST_ARROW: f64 = 2.0 * ARROW_LENGTH;
/// Arrows shorter than this are left out.
const LEAST_ARROW: f64 = 4.0;
/// Least distance on paper between the tails of two arrows, or between their tips: 8 mm.
const ARROW_SPACING: f64 = 80.0;
/// Left edge of the panels over time, and their distance.
pub(super) const BESIDE_PLANE: (f64, f64) = (950.0, 84.0);
/// Least height of the panels.
pub(super) const LEAST_HEIGHT: f64 = 600.0;
/// Distance of a phase's letter from the way: 3.4 mm.
const BESIDE: f64 = 34.0;
/// Least range of a way, in mm.
const LEAST_WAY_MM: f64 = 0.01;

/// Draws the trajectory and its time curves. The left panel has the ways of tool and proxy, seen along z, with all surfaces, and the force
/// on the hand as arrows at the tool. The right panels have two curves over time: the power, and the force component along the surface's
/// normal (its magnitude if there is no surface), with `F` and `R`.
///
/// Surfaces that move are drawn where they are at rest, where they are farthest and between. Surfaces in space are cut at the heights at
/// which the proxy lay on them. With either a third panel shows the distances of tool and proxy from the surface. The forbidden side of a
/// wall is hatched. The left panel shows the part of the plane that the tool used.
///
/// Marks stand at the start, at the end and where the surface gave way. Faults that held or stopped the rig are crosses beside the way, and
/// lines with their names over time. The time after a stop is drawn without the proxy, which leads nothing then. Letters of the trace's
/// phases stand below the force curve and beside the way.
/// An arrow that would leave the frame is left out: a force far above `R`, as at a hard impact, shows in the curve over time alone.
///
/// # Errors
/// - [`Error::Empty`], [`Error::EmptySpan`], [`Error::NoImpact`] when there is nothing to draw;
/// - [`Error::Value`] and [`Error::Setting`] for numbers that cannot be drawn;
/// - [`Error::NoLine`] for a surface that is not a line in the plane of x and y.
///
/// # Source
/// [KTF08, Figs 8 and 11].
pub fn trajectory_and_time(trace: &Trace, options: &Options) -> Result<Drawing, Error> {
    let excerpt = Excerpt::new(trace, options.time_span)?;
    let places = Places::new(trace, &excerpt);
    let heading = heading::lines(&[trace], options);
    let head = heading::height(&heading);
    let (above, side) = (head + 110.0, 720.0);
    // Whether tool and proxy are on a surface that moves, or that is cut at many heights, the plane alone does not report.
    let positions = (places.moves || places.heights_mm.is_some()).then(|| Positions::new(trace, &excerpt));
    let least = if positions.is_some() { side } else { LEAST_HEIGHT };
    let (axes, arrows) = fit(plane::frame(LEFT, above, side, side), trace, &excerpt, least, options)?;
    let height = axes.frame.bottom - axes.frame.top;
    // What comes into sight is in the legend, whose height shifts the frame.
    let mut scratch = Page::new(above);
    let sight = plane::ways(&mut scratch, &axes, trace, &excerpt, &places)?;
    let arrow = arrows.draw(&mut scratch, &axes).then(|| arrows.entry(trace));
    let marks = plane::marks(&mut scratch, &axes, trace, &excerpt, None);
    let mut entries = plane::way_entries();
    entries.extend(places.entries(trace, sight).into_iter().chain(marks).chain(arrow));
    let room = WIDTH - LEFT;
    let top = above + legend::further_height(&entries, room);
    let mut page = Page::new(top + height + 96.0);
    heading::draw(&mut page, &heading);
    legend::draw(&mut page, (LEFT, head + 40.0), room, &entries);

    let frame = plane::frame(LEFT, top, side, height);
    let axes = Axes { frame, ..axes };
    plane::ways(&mut page, &axes, trace, &excerpt, &places)?;
    arrows.draw(&mut page, &axes);
    phase_letters(&mut page, &axes, trace, &excerpt);
    plane::marks(&mut page, &axes, trace, &excerpt, None);
    axes.draw(&mut page, Some("x (mm)"), "y (mm)");
    super::panel_letter(&mut page, (frame.left - LETTER_OFFSET, top - 15.0), 0);
    let (left, gap) = BESIDE_PLANE;
    let width = WIDTH - left - right_of(&[trace]);
    let shares: &[f64] = if positions.is_some() { &[0.4, 0.33, 0.27] } else { &[0.56, 0.44] };
    let height = height - gap * (shares.len() - 1) as f64;
    let mut below = top;
    let frames: Vec<Frame> = shares
        .iter()
        .map(|share| {
            let frame = plane::frame(left, below, width, share * height);
            below = frame.bottom + gap;
            frame
        })
        .collect();
    let x = time_range(&excerpt);
    let mut ranges = vec![force_range(std::iter::once((trace, &excerpt)))];
    ranges.extend(positions.iter().map(|positions| Positions::range(std::iter::once(positions))));
    ranges.push(power_range(&excerpt));
    let panels: Vec<Axes> = frames.into_iter().zip(ranges).map(|(frame, y)| Axes { frame, x, y }).collect();
    if let ([upper, .., lower], between) = (&panels[..], panels.get(1)) {
        phase_marks(&mut page, &panels, trace, &excerpt);
        force_panel(&mut page, upper, trace, &excerpt);
        upper.draw(&mut page, None, &force_name(trace));
        if let (Some(positions), Some(axes)) = (&positions, between) {
            positions.draw(&mut page, axes);
            axes.draw(&mut page, None, "distance from the surface (mm)");
        }
        power_panel(&mut page, lower, &excerpt);
        lower.draw(&mut page, Some(excerpt.label), "power (W)");
    }
    faults(&mut page, &panels, trace, &excerpt);
    super::panel_letter(&mut page, (left - LETTER_OFFSET, top - 15.0), 1);
    Ok(Drawing::new(page, options))
}

pub(super) fn force_name(trace: &Trace) -> String {
    let part = match &trace.references[..] {
        [] => "size of the",
        [only] if plane::circle(only).is_some() => "radial",
        _ => "normal",
    };
    format!("{part} force on the hand, {} (N)", symbol(trace))
}

/// Axes that hold the ways and the arrows, and the arrows. The arrows' place on paper depends on the axes and the
/// axes' range on the arrows: the ways alone give a first scale, the arrows at that scale the range.
fn fit(
    frame: Frame,
    trace: &Trace,
    excerpt: &Excerpt<'_>,
    least: f64,
    options: &Options,
) -> Result<(Axes, Arrows), Error> {
    if let Some(window) = options.window {
        let (x, y) = plane::ranges(window)?;
        let axes = Axes::with_equal_scales(frame, x, y);
        return Ok((axes, Arrows::new(&axes, trace, excerpt, options.arrow_limit)));
    }
    let mut points: Vec<(f64, f64)> =
        excerpt.rows.iter().flat_map(|row| [row.tool_m, row.proxy_m]).map(plane::in_mm).collect();
    let ways = around(frame, &points, 0.02, least);
    let arrows = Arrows::new(&ways, trace, excerpt, options.arrow_limit);
    let per_length = 1.0 / ways.length_per_unit();
    points.extend(arrows.all.iter().filter_map(|Arrow { tail, along }| {
        let (x, y) = (along.0 * arrows.length_per_n, along.1 * arrows.length_per_n);
        (elementary::hypot(x, y) <= LONGEST_ARROW).then_some((tail.0 + x * per_length, tail.1 + y * per_length))
    }));
    let axes = around(frame, &points, 0.03, least);
    let arrows = Arrows::new(&axes, trace, excerpt, options.arrow_limit);
    Ok((axes, arrows))
}

/// Returns axes that hold all points, in a frame that is no higher than they need, but at least of `least` height.
pub(super) fn around(frame: Frame, points: &[(f64, f64)], margin: f64, least: f64) -> Axes {
    let x = range_of(points.iter().map(|point| point.0), LEAST_WAY_MM, margin);
    let y = range_of(points.iter().map(|point| point.1), LEAST_WAY_MM, margin);
    let needed = (frame.right - frame.left) * (y[1] - y[0]) / (x[1] - x[0]);
    let bottom = frame.bottom.min(frame.top + needed.max(least));
    Axes::with_equal_scales(Frame { bottom, ..frame }, x, y)
}

/// A force at the tool: where, in mm, and how much, in N.
struct Arrow {
    tail: (f64, f64),
    along: (f64, f64),
}

/// Force arrows of a figure, few enough to be distinct.
struct Arrows {
    all: Vec<Arrow>,
    length_per_n: f64,
}

impl Arrows {
    fn new(axes: &Axes, trace: &Trace, excerpt: &Excerpt<'_>, limit: usize) -> Self {
        let length_per_n = ARROW_LENGTH / large_force_n(trace, excerpt);
        let mut spacing = ARROW_SPACING;
        loop {
            let all = spaced(axes, trace, excerpt, length_per_n, spacing);
            if all.len() <= limit.max(1) || spacing > 1e5 {
                return Self { all, length_per_n };
            }
            spacing *= 1.25;
        }
    }

    /// Draws those within the frame, and says whether there are any.
    fn draw(&self, page: &mut Page, axes: &Axes) -> bool {
        let mut is_pointed = false;
        for Arrow { tail, along } in &self.all {
            let from = axes.place(tail.0, tail.1);
            let to = (from.0 + along.0 * self.length_per_n, from.1 - along.1 * self.length_per_n);
            if axes.frame.contains(from) && axes.frame.contains(to) {
                page.arrow(from, to, ARROW.color, ARROW.width);
                is_pointed = true;
            }
        }
        is_pointed
    }

    /// Returns an arrow of a round force, for scale.
    fn entry(&self, trace: &Trace) -> Entry {
        let power = elementary::powf(10.0, elementary::log10(ARROW_LENGTH / self.length_per_n).floor());
        let fits = |force: &f64| force * self.length_per_n <= ARROW_LENGTH;
        let force = [5.0, 2.0, 1.0].map(|digit| digit * power).into_iter().find(fits).unwrap_or(power);
        let decimals = (-elementary::log10(force).floor()).max(0.0) as usize;
        let name = format!("{} N (force on the hand, {})", number(force, decimals), symbol(trace));
        Entry::new(Sample::Arrow(force * self.length_per_n, ARROW), name)
    }
}

/// Returns the symbol of the force on the hand.
fn symbol(trace: &Trace) -> &'static str {
    match trace.force_meaning {
        ForceMeaning::HandOnTool => "\u{2212}h",
        ForceMeaning::ActuatorOnTool => "f",
    }
}

/// Arrows at least `spacing` from one another, at the tail or at the tip, and half of it at the tail; the earlier before the later.
fn spaced(axes: &Axes, trace: &Trace, excerpt: &Excerpt<'_>, length_per_n: f64, spacing: f64) -> Vec<Arrow> {
    let mut placed: Vec<(Point, Point)> = Vec::new();
    let mut all = Vec::new();
    for row in &excerpt.rows {
        let [fx, fy, _] = trace.force_on_hand_n(row);
        let tail = (row.tool_m[0] * MM_PER_M, row.tool_m[1] * MM_PER_M);
        let from = axes.place(tail.0, tail.1);
        let to = (from.0 + fx * length_per_n, from.1 - fy * length_per_n);
        if !axes.frame.contains(from) || elementary::hypot(fx, fy) * length_per_n < LEAST_ARROW {
            continue;
        }
        // From the last backward: most rows lie near the arrow drawn just before.
        let is_apart = |(tail, tip): &(Point, Point)| {
            far(*tail, from, spacing / 2.0) && (far(*tail, from, spacing) || far(*tip, to, spacing))
        };
        if placed.iter().rev().all(is_apart) {
            placed.push((from, to));
            all.push(Arrow { tail, along: (fx, fy) });
        }
    }
    all
}

fn far(a: Point, b: Point, distance: f64) -> bool {
    elementary::hypot(a.0 - b.0, a.1 - b.1) >= distance
}

/// Returns `R`, or the force below which 98 of 100 lie if that is larger: a short impact does not shrink all other arrows.
fn large_force_n(trace: &Trace, excerpt: &Excerpt<'_>) -> f64 {
    let mut forces: Vec<f64> = excerpt.rows.iter().map(|row| planar_force_n(trace, row)).collect();
    forces.sort_unstable_by(f64::total_cmp);
    let most = forces.get(forces.len() * 98 / 100).copied().unwrap_or(0.0);
    most.max(trace.yield_n).max(1e-9)
}

fn planar_force_n(trace: &Trace, row: &Row) -> f64 {
    let [x, y, _] = trace.force_on_hand_n(row);
    elementary::hypot(x, y)
}

/// Letters beside the way, at the middle of each phase.
fn phase_letters(page: &mut Page, axes: &Axes, trace: &Trace, excerpt: &Excerpt<'_>) {
    for Phase { letter, from_s, to_s } in &trace.phases {
        let inside = |row: &&&Row| (*from_s..=*to_s).contains(&row.time_s);
        let rows: Vec<&Row> = excerpt.rows.iter().filter(inside).copied().collect();
        let Some(row) = rows.get(rows.len() / 2) else { continue };
        let place = |row: &Row| axes.place(row.tool_m[0] * MM_PER_M, row.tool_m[1] * MM_PER_M);
        let (x, y) = place(row);
        let tenth = rows.len() / 10;
        let (before, after) =
            (place(rows[rows.len() / 2 - tenth]), place(rows[(rows.len() / 2 + tenth).min(rows.len() - 1)]));
        let [fx, fy, _] = trace.force_on_hand_n(row);
        let (dx, dy) = beside((after.0 - before.0, after.1 - before.1), (fx, -fy));
        let centers = [1.0, -1.0].map(|side| (x + side * BESIDE * dx, y + side * BESIDE * dy));
        let fits =
            |(x, y): &Point| axes.frame.contains((x - 20.0, y - 20.0)) && axes.frame.contains((x + 20.0, y + 20.0));
        if let Some(center) = centers.into_iter().find(fits) {
            page.blank(center, 24.0, 30.0);
            page.text((center.0, center.1 + 9.0), Anchor::Middle, letter);
        }
    }
}

/// Returns the unit vector on the page across a motion, on the side away from a force; at rest, straight away from the force.
fn beside(motion: Point, force: Point) -> Point {
    let unit = |(x, y): Point| {
        let length = elementary::hypot(x, y);
        (length > 0.0).then(|| (x / length, y / length))
    };
    if elementary::hypot(motion.0, motion.1) < LEAST_ARROW {
        return unit(force).map_or((0.0, -1.0), |(x, y)| (-x, -y));
    }
    let (x, y) = unit(motion).map_or((0.0, -1.0), |(x, y)| (-y, x));
    if x * force.0 + y * force.1 > 0.0 { (-x, -y) } else { (x, y) }
}

/// Letters below the upper time curve and lines where phases begin and end.
fn phase_marks(page: &mut Page, panels: &[Axes], trace: &Trace, excerpt: &Excerpt<'_>) {
    let stroke = Stroke { color: GREY, width: 1.5, dash: &[3.0, 7.0] };
    let Some(upper) = panels.first() else { return };
    for Phase { letter, from_s, to_s } in &trace.phases {
        let shown = |time_s: f64| upper.place(excerpt.shown_time(time_s), upper.y[0]).0;
        for x in [*from_s, *to_s].map(shown) {
            for Frame { left, top, right, bottom } in panels.iter().map(|axes| axes.frame) {
                if left < x && x < right {
                    page.chain(&[(x, top), (x, bottom)], stroke);
                }
            }
        }
        let middle = shown((from_s + to_s) / 2.0);
        if upper.frame.contains((middle, upper.frame.bottom)) {
            page.text((middle, upper.frame.bottom + 28.0), Anchor::Middle, letter);
        }
    }
}
