//! Drawing in the plane of x and y: the surfaces, and the ways of tool and proxy.

use super::axes::{Axes, Kind, number, range_of};
use super::curve::{Frame, Point};
use super::legend::{Entry, Sample};
use super::marks::{self, Mark};
use super::page::{self, Color, GREY, PALE, Page, SKY, Stroke, VERMILION};
use super::{Error, Excerpt, SurfaceLine, Window};
use std::f64::consts::TAU;
use yieldwall_motion::elementary;
use yieldwall_record::{Reference, Row, Trace};

pub(super) const MM_PER_M: f64 = 1000.0;
pub(super) const TOOL: Stroke = Stroke { color: SKY, width: 7.0, dash: &[] };
pub(super) const PROXY: Stroke = Stroke { color: VERMILION, width: 3.0, dash: &[14.0, 8.0] };
pub(super) const SURFACE_BAND: Stroke = Stroke { color: PALE, width: 13.0, dash: &[] };
pub(super) const SURFACE: Stroke = Stroke { color: GREY, width: 2.0, dash: &[] };
/// A surface where it is farthest from its place.
const SWUNG: Stroke = Stroke { color: GREY, width: 2.0, dash: &[6.0, 8.0] };
/// A surface where it is between the two.
const BETWEEN: Stroke = Stroke { color: PALE, width: 2.0, dash: &[] };
/// The farthest that a surface reaches, as it is seen along z.
const OUTLINE: Stroke = Stroke { color: GREY, width: 2.0, dash: &[3.0, 7.0] };
/// Places between the two ends of a surface's way.
const PLACES_BETWEEN: u32 = 7;
/// Size of a point that is a reference, on paper.
const DOT: f64 = 5.0;
/// Largest motion of a surface, and largest change of height, that counts as none, in m.
const STILL_M: f64 = 1e-9;
/// A section that comes as near as this to the outline shows it, in mm.
const AT_OUTLINE_MM: f64 = 0.1;

/// Greatest distance of a drawn circle from the true one, in tenths of a millimetre.
const SAGITTA: f64 = 0.1;
/// Enlargement of a drawing elsewhere up to which its circles show no corners.
const ENLARGED: f64 = 25.0;
/// Most corners of a drawn circle: reached only when it is a hundred metres wide on paper.
const MOST_CORNERS: f64 = 20_000.0;

/// Places at which the surfaces of a run are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Places {
    /// How far they are from their place, in m, where they are nearest to it. The third component also lowers them by the
    /// height at which they are cut.
    first: [f64; 3],
    /// Distance in m at the other end of the drawn range: where the surfaces are farthest, or cut at another height.
    last: Option<[f64; 3]>,
    /// Whether they move.
    pub moves: bool,
    /// Lowest and highest z of the proxy on the surface, in mm, where it matters to what is seen of the surfaces.
    pub heights_mm: Option<[f64; 2]>,
}

impl Places {
    pub(super) fn new(trace: &Trace, excerpt: &Excerpt<'_>) -> Self {
        let length = |[x, y, z]: &[f64; 3]| elementary::hypot(elementary::hypot(*x, *y), *z);
        let by_length = |a: &[f64; 3], b: &[f64; 3]| length(a).total_cmp(&length(b));
        let all = || excerpt.rows.iter().map(|row| row.surface_m);
        let (least, most) = (all().min_by(by_length).unwrap_or_default(), all().max_by(by_length).unwrap_or_default());
        let moves = length(&most) - length(&least) > STILL_M;
        let has_height = trace.references.iter().any(Reference::has_height);
        let heights_m = has_height.then(|| heights_m(excerpt));
        let cut = |[x, y, z]: [f64; 3], height_m: f64| [x, y, z - height_m];
        let (first, last) = match heights_m {
            Some([low, high]) if moves => {
                let middle = (low + high) / 2.0;
                (cut(least, middle), Some(cut(most, middle)))
            }
            Some([low, high]) => (cut(least, low), (high - low > STILL_M).then(|| cut(least, high))),
            None => (least, moves.then_some(most)),
        };
        Self { first, last, moves, heights_mm: heights_m.map(|heights| heights.map(|height| height * MM_PER_M)) }
    }

    /// Returns both ends of what is shown.
    pub(super) fn ends(&self) -> impl Iterator<Item = [f64; 3]> + use<> {
        std::iter::once(self.first).chain(self.last)
    }

    /// Returns the places between both ends.
    fn between(&self) -> impl Iterator<Item = [f64; 3]> + use<> {
        let first = self.first;
        self.last.into_iter().flat_map(move |last| {
            (1..=PLACES_BETWEEN).map(move |place| {
                let share = f64::from(place) / f64::from(PLACES_BETWEEN + 1);
                std::array::from_fn(|axis| first[axis] + share * (last[axis] - first[axis]))
            })
        })
    }

    /// Entries of the legend for what is in sight.
    pub(super) fn entries(&self, trace: &Trace, sight: Sight) -> Vec<Entry> {
        let lines = vec![SURFACE_BAND, SURFACE];
        let is_wall = is_wall(trace);
        let base = if is_wall { "wall" } else { "reference surface" };
        let at = match self.heights_mm {
            Some([low, high]) if (high - low).abs() < 0.1 => format!(" at z = {} mm", number(low, 1)),
            Some([low, high]) => format!(" at z = {} to {} mm", number(low, 1), number(high, 1)),
            None => String::new(),
        };
        let mut entries = Vec::new();
        if sight.surface {
            entries.push(match is_wall {
                true => Entry::new(Sample::Hatched(lines), format!("{base}{at} (hatched side forbidden)")),
                false => Entry::new(Sample::Lines(lines), format!("{base}{at}")),
            });
        }
        if sight.swung {
            entries.push(Entry::new(Sample::Lines(vec![SWUNG]), "where it swings to"));
        }
        if sight.outline {
            entries.push(Entry::new(Sample::Lines(vec![OUTLINE]), "outline"));
        }
        entries
    }
}

/// Returns the lowest and highest z of the proxy on the surface, in m; where it never lies there, those of the tool.
fn heights_m(excerpt: &Excerpt<'_>) -> [f64; 2] {
    let on = || excerpt.rows.iter().filter(|row| row.is_on_surface).map(|row| row.proxy_m[2]);
    if on().next().is_some() {
        range_of(on(), 0.0, 0.0)
    } else {
        range_of(excerpt.rows.iter().map(|row| row.tool_m[2]), 0.0, 0.0)
    }
}

/// Whether one side of the surfaces is forbidden, and can be shown.
fn is_wall(trace: &Trace) -> bool {
    trace.is_unilateral && trace.references.iter().any(|reference| !matches!(reference, Reference::Point { .. }))
}

/// Parts of the surfaces that came into the frame.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sight {
    pub surface: bool,
    pub swung: bool,
    pub outline: bool,
}

/// Draws surfaces and ways in mm, and says what of the surfaces came into the frame; frame and ticks are drawn last, by the
/// caller.
pub(super) fn ways(
    page: &mut Page,
    axes: &Axes,
    trace: &Trace,
    excerpt: &Excerpt<'_>,
    places: &Places,
) -> Result<Sight, Error> {
    let sight = surfaces(page, axes, trace, places)?;
    axes.curve(page, excerpt.rows.iter().map(|row| in_mm(row.tool_m)), Kind::Way, TOOL);
    axes.curve(page, excerpt.led().map(|row| in_mm(row.proxy_m)), Kind::Way, PROXY);
    Ok(sight)
}

/// Draws start, end, break-outs and faults, in a colour or each in its own, and returns the entries of the legend for those within the
/// frame.
pub(super) fn marks(
    page: &mut Page,
    axes: &Axes,
    trace: &Trace,
    excerpt: &Excerpt<'_>,
    color: Option<Color>,
) -> Vec<Entry> {
    let place = |point_m: [f64; 3]| {
        let (x, y) = in_mm(point_m);
        axes.place(x, y)
    };
    let tool = |row: Option<&&Row>| row.map(|row| place(row.tool_m)).into_iter();
    let mut draw = |mark, places: &mut dyn Iterator<Item = Point>| marks::draw(page, axes.frame, mark, color, places);
    let break_out = draw(Mark::BreakOut, &mut excerpt.break_outs(trace).map(|row| place(row.proxy_m)));
    let start = draw(Mark::Start, &mut tool(excerpt.rows.first()));
    let end = draw(Mark::End, &mut tool(excerpt.rows.last()));
    let fault = draw(Mark::Fault, &mut excerpt.faults(trace).into_iter().map(|(_, _, tool_m)| place(tool_m)));
    [start, end, break_out, fault].into_iter().flatten().map(Entry::mark).collect()
}

pub(super) fn in_mm([x, y, _]: [f64; 3]) -> Point {
    (x * MM_PER_M, y * MM_PER_M)
}

/// Draws the surfaces alone.
pub(super) fn surfaces(page: &mut Page, axes: &Axes, trace: &Trace, places: &Places) -> Result<Sight, Error> {
    let mut sight = Sight::default();
    let draw = |page: &mut Page, place: [f64; 3], strokes: &[Stroke], is_hatched: bool| -> Result<bool, Error> {
        let mut is_seen = false;
        for reference in &trace.references {
            let line = line(reference, place, axes).ok_or_else(|| Error::NoLine { title: trace.title.clone() })?;
            for stroke in strokes {
                is_seen |= axes.curve(page, line.iter().copied(), Kind::Way, *stroke);
            }
            let has_sides = !matches!(reference, Reference::Point { .. });
            if is_hatched && has_sides && trace.is_unilateral {
                let points: Vec<Point> = line.iter().map(|(x, y)| axes.place(*x, *y)).collect();
                page.within(axes.frame, |page| marks::hatch(page, &points));
            }
            if let (true, Reference::Point { point_m: [x, y], .. }) = (is_hatched, reference) {
                let at = axes.place((x + place[0]) * MM_PER_M, (y + place[1]) * MM_PER_M);
                if axes.frame.contains(at) {
                    page.dot(at, DOT, GREY);
                    is_seen = true;
                }
            }
        }
        Ok(is_seen)
    };
    for place in places.between() {
        draw(page, place, &[BETWEEN], false)?;
    }
    sight.surface = draw(page, places.first, &[SURFACE_BAND, SURFACE], true)?;
    if let Some(last) = places.last {
        match places.moves {
            true => sight.swung = draw(page, last, &[SWUNG], true)?,
            false => sight.surface |= draw(page, last, &[SURFACE_BAND, SURFACE], true)?,
        }
    }
    sight.outline = outlines(page, axes, trace, places);
    Ok(sight)
}

/// Draws how far surfaces in space reach, where no section does, and says whether one came into the frame.
fn outlines(page: &mut Page, axes: &Axes, trace: &Trace, places: &Places) -> bool {
    let mut is_seen = false;
    for reference in trace.references.iter().filter(|reference| has_outline(reference)) {
        let Some((reach_mm, middle)) = reach(reference) else { continue };
        let reaches = |[_, _, z]: [f64; 3]| {
            section(reference, z).is_some_and(|section_mm| reach_mm - section_mm <= AT_OUTLINE_MM)
        };
        if places.ends().any(reaches) {
            continue;
        }
        let place = [places.first[0], places.first[1], -middle];
        if let Some(line) = line(reference, place, axes) {
            is_seen |= axes.curve(page, line.into_iter(), Kind::Way, OUTLINE);
        }
    }
    is_seen
}

/// Whether its sections may be smaller than what is seen of it along z.
fn has_outline(reference: &Reference) -> bool {
    matches!(reference, Reference::Sphere { .. } | Reference::Box { .. })
}

/// Returns the radius, or half of the width, in mm of the largest section, and its z in m.
fn reach(reference: &Reference) -> Option<(f64, f64)> {
    match reference {
        Reference::Sphere { center_m: [_, _, z], radius_m, .. } => Some((radius_m * MM_PER_M, *z)),
        Reference::Box { center_m: [_, _, z], half_size_m: [half, ..], .. } => Some((half * MM_PER_M, *z)),
        _ => None,
    }
}

/// Returns the radius, or half of the width, in mm of the section at z = 0; `None` if there is none. The surface is moved along z by
/// `moved_z_m`.
fn section(reference: &Reference, moved_z_m: f64) -> Option<f64> {
    match reference {
        Reference::Sphere { center_m: [_, _, z], radius_m, .. } => {
            let off = z + moved_z_m;
            let squared = radius_m * radius_m - off * off;
            (squared > 0.0).then(|| squared.sqrt() * MM_PER_M)
        }
        Reference::Box { center_m: [_, _, z], half_size_m: [half, _, half_z], .. } => {
            ((z + moved_z_m).abs() <= *half_z).then_some(half * MM_PER_M)
        }
        _ => None,
    }
}

/// Returns points of a surface's line in mm, close enough together for the scale of the axes. The forbidden side is to the right of the way
/// through them. The list is empty if the plane of x and y does not cut the surface. The result is `None` if the surface is no line as seen
/// along z. `moved_m` is how far the surface is from its place.
pub(super) fn line(reference: &Reference, moved_m: [f64; 3], axes: &Axes) -> Option<Vec<Point>> {
    let [moved_x, moved_y, moved_z] = moved_m.map(|component| component * MM_PER_M);
    match reference {
        Reference::Plane { point_m, normal: [x, y, z] } => {
            let length_squared = x * x + y * y;
            if length_squared <= 1e-18 * z * z || length_squared == 0.0 {
                return None;
            }
            let [px, py, pz] = point_m.map(|component| component * MM_PER_M);
            let (px, py, pz) = (px + moved_x, py + moved_y, pz + moved_z);
            // The point of the section with the plane of x and y that is nearest to the middle of the axes.
            let middle = [(axes.x[0] + axes.x[1]) / 2.0, (axes.y[0] + axes.y[1]) / 2.0];
            let gap = (x * (px - middle[0]) + y * (py - middle[1]) + z * pz) / length_squared;
            let (cx, cy) = (middle[0] + x * gap, middle[1] + y * gap);
            let reach = (axes.x[1] - axes.x[0] + axes.y[1] - axes.y[0]) / length_squared.sqrt();
            Some(vec![(cx - y * reach, cy + x * reach), (cx + y * reach, cy - x * reach)])
        }
        Reference::Curve { points_m, is_closed } => {
            let closing = points_m.first().filter(|_| *is_closed);
            let points = points_m.iter().chain(closing);
            Some(points.map(|[x, y]| (x * MM_PER_M + moved_x, y * MM_PER_M + moved_y)).collect())
        }
        Reference::Box { center_m: [x, y, _], half_size_m: [half_x, half_y, _], is_inside_forbidden } => {
            if section(reference, moved_m[2]).is_none() {
                return Some(Vec::new());
            }
            // Against the clock, the inside to the left.
            let mut corners = vec![(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)];
            if *is_inside_forbidden {
                corners.reverse();
            }
            let corner = |(right, up): (f64, f64)| {
                ((x + right * half_x) * MM_PER_M + moved_x, (y + up * half_y) * MM_PER_M + moved_y)
            };
            Some(corners.into_iter().map(corner).collect())
        }
        Reference::Sphere { center_m: [x, y, _], is_inside_forbidden, .. } => {
            let Some(radius) = section(reference, moved_m[2]) else { return Some(Vec::new()) };
            Some(round((x * MM_PER_M + moved_x, y * MM_PER_M + moved_y), radius, *is_inside_forbidden, axes))
        }
        Reference::Circle { is_inside_forbidden, .. } | Reference::Cylinder { is_inside_forbidden, .. } => {
            let ([x, y], radius_m) = circle(reference)?;
            let center = (x * MM_PER_M + moved_x, y * MM_PER_M + moved_y);
            Some(round(center, radius_m * MM_PER_M, *is_inside_forbidden, axes))
        }
        Reference::Point { point_m: [x, y], capture_radius_m } => {
            let center = (x * MM_PER_M + moved_x, y * MM_PER_M + moved_y);
            Some(round(center, capture_radius_m * MM_PER_M, false, axes))
        }
    }
}

/// Lines of surfaces at their place, as [`surface_lines`](super::surface_lines).
pub(super) fn lines_m(references: &[Reference], window_m: [f64; 4]) -> Vec<SurfaceLine> {
    let [x, y, end_x, end_y] = window_m.map(|value| value * MM_PER_M);
    let edge = ENLARGED * page::WIDTH;
    let frame = Frame { left: 0.0, top: 0.0, right: edge, bottom: edge };
    let axes = Axes { frame, x: [x, end_x], y: [y, end_y] };
    let in_m = |reference: &Reference| {
        let line = line(reference, [0.0; 3], &axes).filter(|line| !line.is_empty())?;
        let is_closed = match reference {
            Reference::Plane { .. } => false,
            Reference::Curve { is_closed, .. } => *is_closed,
            _ => true,
        };
        // The first corner of a closed line stands at its end again.
        let corners = line.len() - usize::from(is_closed);
        let points_m = line.into_iter().take(corners).map(|(x, y)| [x / MM_PER_M, y / MM_PER_M]).collect();
        Some(SurfaceLine { points_m, is_closed, has_sides: !matches!(reference, Reference::Point { .. }) })
    };
    references.iter().filter_map(in_m).collect()
}

/// Returns the points of a circle: against the clock, or with it where the inside is to be on the right.
fn round((x, y): Point, radius: f64, is_clockwise: bool, axes: &Axes) -> Vec<Point> {
    let on_paper = radius * axes.length_per_unit();
    let corners = (TAU / (8.0 * SAGITTA / on_paper).sqrt()).clamp(60.0, MOST_CORNERS).ceil();
    let turn = if is_clockwise { -TAU } else { TAU };
    (0..=corners as usize)
        .map(|corner| elementary::sin_cos(corner as f64 / corners * turn))
        .map(|(sine, cosine)| (x + radius * cosine, y + radius * sine))
        .collect()
}

/// Returns the centre and radius in m of what is a circle as seen along z: a surface, or a point's capture circle.
pub(super) fn circle(reference: &Reference) -> Option<([f64; 2], f64)> {
    match reference {
        Reference::Circle { center_m, radius_m, .. } => Some((*center_m, *radius_m)),
        Reference::Sphere { center_m: [x, y, _], radius_m, .. } => Some(([*x, *y], *radius_m)),
        Reference::Point { point_m, capture_radius_m } => Some((*point_m, *capture_radius_m)),
        Reference::Cylinder { axis_point_m: [x, y, _], axis_direction: [dx, dy, dz], radius_m, .. } => {
            (elementary::hypot(*dx, *dy) <= 1e-9 * dz.abs() && *dz != 0.0).then_some(([*x, *y], *radius_m))
        }
        _ => None,
    }
}

/// Ranges of x and y in mm that a window asks for.
///
/// # Errors
/// [`Error::Setting`] for a window without width or with numbers that cannot be drawn.
pub(super) fn ranges(window: Window) -> Result<([f64; 2], [f64; 2]), Error> {
    let Window { center_m: [x, y], half_width_m } = window;
    for value in [x, y] {
        super::error::expect("center_m of a window", value, true, "a finite number up to 1e9")?;
    }
    // Below a nanometre the positions themselves have no more digits to show.
    super::error::expect("half_width_m of a window", half_width_m, half_width_m >= 1e-9, "a length of 1e-9 m or more")?;
    let about = |middle: f64| [(middle - half_width_m) * MM_PER_M, (middle + half_width_m) * MM_PER_M];
    Ok((about(x), about(y)))
}

/// Entries of the legend for the ways.
pub(super) fn way_entries() -> Vec<Entry> {
    [("tool", TOOL), ("proxy", PROXY)].map(|(name, stroke)| Entry::new(Sample::Lines(vec![stroke]), name)).into()
}

/// Returns a frame from its left upper corner and its size.
pub(super) fn frame(left: f64, top: f64, width: f64, height: f64) -> Frame {
    Frame { left, top, right: left + width, bottom: top + height }
}
