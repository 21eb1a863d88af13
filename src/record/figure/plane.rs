//! What is drawn in the plane of x and y: the reference surface, the ways of tool and proxy, the legend.

use super::axes::{Axes, Kind};
use super::curve::{Frame, Point};
use super::page::{Anchor, GREY, PALE, Page, SKY, Stroke, VERMILION};
use super::{Error, Excerpt, Window};
use crate::elementary;
use crate::record::{Reference, Trace};
use std::f64::consts::TAU;

pub(super) const MM_PER_M: f64 = 1000.0;
pub(super) const TOOL: Stroke = Stroke { color: SKY, width: 7.0, dash: &[] };
pub(super) const PROXY: Stroke = Stroke { color: VERMILION, width: 3.0, dash: &[14.0, 8.0] };
pub(super) const SURFACE_BAND: Stroke = Stroke { color: PALE, width: 13.0, dash: &[] };
pub(super) const SURFACE: Stroke = Stroke { color: GREY, width: 2.0, dash: &[] };
/// A surface where it is farthest from its place.
const SWUNG: Stroke = Stroke { color: GREY, width: 2.0, dash: &[6.0, 8.0] };
/// Size of a point that is a reference, on paper.
const DOT: f64 = 5.0;
/// Ways of a surface that are no motion, in m.
const STILL_M: f64 = 1e-9;

/// Length of the samples in the legend: four dashes of the proxy and the gaps between them.
const SAMPLE: f64 = 80.0;
/// Greatest distance of a drawn circle from the true one, in tenths of a millimetre.
const SAGITTA: f64 = 0.1;
/// Most corners of a drawn circle: reached only when it is a hundred metres wide on paper.
const MOST_CORNERS: f64 = 20_000.0;

/// Draws ways and surfaces in mm; frame and ticks are drawn last, by the caller.
pub(super) fn ways(page: &mut Page, axes: &Axes, trace: &Trace, excerpt: &Excerpt<'_>) -> Result<(), Error> {
    let (place, swung) = places(excerpt);
    let strokes = [SURFACE_BAND, SURFACE].map(|stroke| (stroke, Some(place))).into_iter().chain([(SWUNG, swung)]);
    for (stroke, place) in strokes {
        let Some(place) = place else { continue };
        for reference in &trace.references {
            let line = line(reference, place, axes).ok_or_else(|| Error::NoLine { title: trace.title.clone() })?;
            axes.curve(page, line.into_iter(), Kind::Way, stroke);
        }
    }
    for place in std::iter::once(place).chain(swung) {
        for reference in &trace.references {
            let Reference::Point { point_m: [x, y], .. } = reference else { continue };
            let at = axes.place((x + place[0]) * MM_PER_M, (y + place[1]) * MM_PER_M);
            if axes.frame.contains(at) {
                page.dot(at, DOT, GREY);
            }
        }
    }
    let in_mm = |[x, y, _]: [f64; 3]| (x * MM_PER_M, y * MM_PER_M);
    axes.curve(page, excerpt.rows.iter().map(|row| in_mm(row.tool_m)), Kind::Way, TOOL);
    axes.curve(page, excerpt.rows.iter().map(|row| in_mm(row.proxy_m)), Kind::Way, PROXY);
    Ok(())
}

/// How far the surfaces are from their place where they are nearest to it, and, if they move, where they are farthest.
pub(super) fn places(excerpt: &Excerpt<'_>) -> ([f64; 3], Option<[f64; 3]>) {
    let length = |[x, y, z]: &[f64; 3]| elementary::hypot(elementary::hypot(*x, *y), *z);
    let all = || excerpt.rows.iter().map(|row| row.surface_m);
    let by_length = |a: &[f64; 3], b: &[f64; 3]| length(a).total_cmp(&length(b));
    let (least, most) = (all().min_by(by_length).unwrap_or_default(), all().max_by(by_length).unwrap_or_default());
    (least, (length(&most) - length(&least) > STILL_M).then_some(most))
}

/// Points of a surface's line in mm, close enough together for the scale of the axes; `None` if it is no line as seen
/// along z. `moved_m` is how far the surface is from its place.
fn line(reference: &Reference, moved_m: [f64; 3], axes: &Axes) -> Option<Vec<Point>> {
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
        Reference::Circle { .. } | Reference::Cylinder { .. } | Reference::Point { .. } => {
            let ([cx, cy], radius_m) = circle(reference)?;
            let (cx, cy) = (cx * MM_PER_M + moved_x, cy * MM_PER_M + moved_y);
            let radius = radius_m * MM_PER_M;
            let on_paper = radius * axes.length_per_unit();
            let corners = (TAU / (8.0 * SAGITTA / on_paper).sqrt()).clamp(60.0, MOST_CORNERS).ceil();
            Some(
                (0..=corners as usize)
                    .map(|corner| elementary::sin_cos(corner as f64 / corners * TAU))
                    .map(|(sine, cosine)| (cx + radius * cosine, cy + radius * sine))
                    .collect(),
            )
        }
    }
}

/// Centre and radius in m of a surface that is a circle as seen along z, or of a point's capture circle.
pub(super) fn circle(reference: &Reference) -> Option<([f64; 2], f64)> {
    match reference {
        Reference::Circle { center_m, radius_m } => Some((*center_m, *radius_m)),
        Reference::Point { point_m, capture_radius_m } => Some((*point_m, *capture_radius_m)),
        Reference::Cylinder { axis_point_m: [x, y, _], axis_direction: [dx, dy, dz], radius_m } => {
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

/// Draws samples of the curves with their names in a row, from a point to the right; gives the place behind them.
pub(super) fn legend(page: &mut Page, (left, y): Point, has_surface: bool, moves: bool) -> f64 {
    let middle = y - 9.0;
    let mut x = left;
    let mut entry = |name: &str, strokes: &[Stroke], room: f64| {
        for stroke in strokes {
            page.chain(&[(x, middle), (x + SAMPLE, middle)], *stroke);
        }
        page.text((x + SAMPLE + 14.0, y), Anchor::Start, name);
        x += room;
    };
    entry("tool", &[TOOL], 195.0);
    entry("proxy", &[PROXY], 210.0);
    if has_surface && moves {
        entry("surface", &[SURFACE_BAND, SURFACE], 225.0);
        entry("swung", &[SWUNG], 205.0);
    } else if has_surface {
        entry("reference surface", &[SURFACE_BAND, SURFACE], 375.0);
    }
    x
}

/// A frame from its left upper corner and its size.
pub(super) fn frame(left: f64, top: f64, width: f64, height: f64) -> Frame {
    Frame { left, top, right: left + width, bottom: top + height }
}
