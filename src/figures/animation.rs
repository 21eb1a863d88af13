//! Runs beside each other, as a picture that moves.

use std::fmt::Write;

use super::{Error, Excerpt, SurfaceLine, TimeSpan, surface_lines};
use yieldwall_motion::elementary::hypot;
use yieldwall_record::{Row, Trace};

/// Most runs that [`animation`] draws.
pub const MOST_MOVING: usize = 3;
/// Width and height of a panel, and the room above for its texts, px.
const PANEL: [f64; 2] = [360.0, 260.0];
const HEAD: f64 = 50.0;
const GAP: f64 = 16.0;
/// Room around the ways of the tools, m.
const MARGIN_M: f64 = 0.03;
/// Length of an arrow for the greatest yield force of the runs, px.
const YIELD_PX: f64 = 60.0;
/// Pictures a second.
const RATE_HZ: f64 = 30.0;
/// Time for which the last picture stays, s.
const REST_S: f64 = 1.0;
/// A hand that presses with less than this share of the yield force does not hold the tool.
const HELD_SHARE: f64 = 0.025;
/// Width of the band on the forbidden side, px.
const BAND: f64 = 14.0;

/// Returns the tool of each run with its force, the yield force as a circle and the surfaces, as an animated SVG that repeats.
/// All panels show the same part of the plane, cropped to the ways of the tools, for the time of the shortest run.
///
/// # Errors
/// [`Error::PanelCount`] for no trace or more than three; further as [`super::trajectory_and_time`].
pub fn animation(runs: &[(&str, &Trace)]) -> Result<String, Error> {
    if runs.is_empty() || runs.len() > MOST_MOVING {
        return Err(Error::PanelCount { count: runs.len(), most: MOST_MOVING });
    }
    let shown = runs.iter().map(|(_, trace)| Excerpt::new(trace, TimeSpan::Whole)).collect::<Result<Vec<_>, _>>()?;
    let all = || shown.iter().map(|excerpt| excerpt.rows.as_slice());
    let end_s = all().filter_map(|rows| Some(rows.last()?.time_s)).fold(f64::INFINITY, f64::min);
    let rows: Vec<&[&Row]> =
        all().map(|rows| rows.split_at(rows.partition_point(|row| row.time_s <= end_s)).0).collect();
    let yield_n = runs.iter().map(|(_, trace)| trace.yield_n).fold(0.0, f64::max);
    let view = Panel::around(&rows, YIELD_PX / yield_n);
    let width = runs.len() as f64 * (PANEL[0] + GAP) - GAP;
    let height = HEAD + PANEL[1];
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
         font-family=\"system-ui, sans-serif\" role=\"img\">\n<title>Tools with the forces on them</title><defs><marker id=\"head\" viewBox=\"0 0 8 8\" refX=\"6\" refY=\"4\" \
         markerWidth=\"4\" markerHeight=\"4\" orient=\"auto\"><path d=\"M0 0L8 4L0 8z\" fill=\"#d55e00\"/></marker>\
         <clipPath id=\"panel\"><rect width=\"{}\" height=\"{}\"/></clipPath></defs>\n",
        PANEL[0], PANEL[1]
    );
    for (at, ((name, trace), rows)) in runs.iter().zip(&rows).enumerate() {
        let x = at as f64 * (PANEL[0] + GAP);
        // Writing to a string does not fail.
        let _ = writeln!(svg, "<g transform=\"translate({x} 0)\">{}</g>", view.panel(name, trace, rows, end_s));
    }
    svg.push_str("</svg>\n");
    Ok(svg)
}

/// Part of the plane that every panel shows.
struct Panel {
    center_m: [f64; 2],
    px_per_m: f64,
    px_per_n: f64,
}

impl Panel {
    fn around(rows: &[&[&Row]], px_per_n: f64) -> Self {
        let tools = || rows.iter().flat_map(|rows| rows.iter()).map(|row| row.tool_m);
        let range = |axis: usize| {
            let values = || tools().map(|tool_m| tool_m[axis]);
            [values().fold(f64::INFINITY, f64::min) - MARGIN_M, values().fold(f64::NEG_INFINITY, f64::max) + MARGIN_M]
        };
        let (x, y) = (range(0), range(1));
        let px_per_m = (PANEL[0] / (x[1] - x[0])).min(PANEL[1] / (y[1] - y[0]));
        Self { center_m: [(x[0] + x[1]) / 2.0, (y[0] + y[1]) / 2.0], px_per_m, px_per_n }
    }

    fn window_m(&self) -> [f64; 4] {
        let [x, y] = self.center_m;
        let [half_x, half_y] = PANEL.map(|side| side / 2.0 / self.px_per_m);
        [x - half_x, y - half_y, x + half_x, y + half_y]
    }

    fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [center_x, center_y] = self.center_m;
        [PANEL[0] / 2.0 + (x - center_x) * self.px_per_m, PANEL[1] / 2.0 - (y - center_y) * self.px_per_m]
    }

    fn panel(&self, name: &str, trace: &Trace, rows: &[&Row], end_s: f64) -> String {
        let frames = Frames::new(self, trace, rows, end_s);
        let mut svg = frames.texts(name, trace, rows);
        let _ = write!(
            svg,
            "<g transform=\"translate(0 {HEAD})\" clip-path=\"url(#panel)\"><rect width=\"{}\" height=\"{}\" fill=\"#fff\"/>",
            PANEL[0], PANEL[1]
        );
        surface_lines(&trace.references, self.window_m()).iter().for_each(|line| self.surface(&mut svg, line, trace));
        frames.bodies(&mut svg, trace.yield_n * self.px_per_n);
        svg.push_str("</g>");
        svg
    }

    fn surface(&self, svg: &mut String, line: &SurfaceLine, trace: &Trace) {
        let points: Vec<[f64; 2]> = line.points_m.iter().map(|point_m| self.place(*point_m)).collect();
        let close = if line.is_closed { "Z" } else { "" };
        if trace.is_unilateral && line.has_sides {
            // On the page y points down: the right of the way is its left.
            let beside = points.iter().enumerate().map(|(at, point)| {
                let (from, to) = (points[at.saturating_sub(1)], points[(at + 1).min(points.len() - 1)]);
                let [x, y] = [to[0] - from[0], to[1] - from[1]];
                let length = hypot(x, y).max(1e-9);
                [point[0] - BAND * y / length, point[1] + BAND * x / length]
            });
            let beside: Vec<[f64; 2]> = beside.collect();
            let band: Vec<[f64; 2]> = points.iter().copied().chain(beside.into_iter().rev()).collect();
            let _ = write!(svg, "<path d=\"{}Z\" fill=\"#000\" opacity=\".12\"/>", path(&band));
        }
        let _ = write!(svg, "<path d=\"{}{close}\" fill=\"none\" stroke=\"#333\" stroke-width=\"2\"/>", path(&points));
    }
}

fn path(points: &[[f64; 2]]) -> String {
    let corner = |(at, [x, y]): (usize, &[f64; 2])| format!("{}{x:.1} {y:.1}", if at == 0 { "M" } else { "L" });
    points.iter().enumerate().map(corner).collect()
}

/// The pictures of a run.
struct Frames {
    tools: Vec<[f64; 2]>,
    tips: Vec<[f64; 2]>,
    is_held: Vec<bool>,
    /// Number of the first picture after which the hand never holds the tool again.
    gone_from: usize,
    lasts_s: f64,
}

impl Frames {
    fn new(panel: &Panel, trace: &Trace, rows: &[&Row], end_s: f64) -> Self {
        let from_s = rows.first().map_or(0.0, |row| row.time_s);
        let count = ((end_s - from_s) * RATE_HZ) as usize + (REST_S * RATE_HZ) as usize;
        let (mut tools, mut tips, mut is_held) = (Vec::new(), Vec::new(), Vec::new());
        for frame in 0..=count {
            let time_s = (from_s + frame as f64 / RATE_HZ).min(end_s);
            let Some(row) = rows.get(rows.partition_point(|row| row.time_s < time_s)).or(rows.last()) else { continue };
            let ([x, y, _], force_n) = (row.tool_m, trace.force_on_hand_n(row));
            let [tool_x, tool_y] = panel.place([x, y]);
            tools.push([tool_x, tool_y]);
            // The hand presses against the force on it.
            tips.push([tool_x - force_n[0] * panel.px_per_n, tool_y + force_n[1] * panel.px_per_n]);
            is_held.push(is_held_in(trace, row));
        }
        let gone_from = is_held.iter().rposition(|held| *held).map_or(0, |last| last + 1);
        Self { tools, tips, is_held, gone_from, lasts_s: count as f64 / RATE_HZ }
    }

    /// Returns an element that moves an attribute through all pictures.
    fn animate(&self, attribute: &str, mode: &str, values: impl Iterator<Item = String>) -> String {
        let values = values.collect::<Vec<_>>().join(";");
        format!(
            "<animate attributeName=\"{attribute}\" values=\"{values}\" dur=\"{:.2}s\" calcMode=\"{mode}\" repeatCount=\"indefinite\"/>",
            self.lasts_s
        )
    }

    fn moved(&self, attribute: &str, points: &[[f64; 2]], axis: usize) -> String {
        self.animate(attribute, "linear", points.iter().map(|point| format!("{:.1}", point[axis])))
    }

    fn bodies(&self, svg: &mut String, radius: f64) {
        let shown = self.animate("opacity", "discrete", self.is_held.iter().map(|held| u8::from(*held).to_string()));
        let place = |x: &str, y: &str, points| self.moved(x, points, 0) + &self.moved(y, points, 1);
        let [at, circle] = [place("cx", "cy", &self.tools), place("cx", "cy", &self.tools)];
        let arrow = place("x1", "y1", &self.tools) + &place("x2", "y2", &self.tips);
        let _ = write!(
            svg,
            "<g>{shown}<circle r=\"{radius}\" fill=\"none\" stroke=\"#0072b2\" stroke-dasharray=\"4 4\">{circle}</circle>\
             <line stroke=\"#d55e00\" stroke-width=\"4\" marker-end=\"url(#head)\">{arrow}</line></g>\
             <circle r=\"7\" fill=\"#000\">{at}</circle>"
        );
    }

    fn texts(&self, name: &str, trace: &Trace, rows: &[&Row]) -> String {
        let mut svg = String::new();
        let name = name.replace('&', "&amp;").replace('<', "&lt;");
        let _ = write!(svg, "<text x=\"4\" y=\"20\" font-size=\"18\" font-weight=\"600\" fill=\"#777\">{name}</text>");
        let most_n = rows.iter().map(|row| force_n(trace, row)).fold(0.0, f64::max);
        let gone = match thrown_back_m(trace, rows) {
            Some(back_m) => format!("the hand lets go: the tool moves {:.1} mm", 1e3 * back_m),
            None => String::new(),
        };
        for (text, is_gone) in [(format!("the hand pushes with up to {most_n:.0} N"), false), (gone, true)] {
            let is_shown =
                (0..self.is_held.len()).map(|frame| u8::from((frame >= self.gone_from) == is_gone).to_string());
            let shown = self.animate("opacity", "discrete", is_shown);
            let _ = write!(svg, "<text x=\"4\" y=\"40\" font-size=\"14\" fill=\"#777\">{text}{shown}</text>");
        }
        svg
    }
}

/// Returns the way of the tool after the hand has released it for good, m; `None` if it never does.
fn thrown_back_m(trace: &Trace, rows: &[&Row]) -> Option<f64> {
    let is_held = |row: &&&Row| is_held_in(trace, row);
    let (last, end) = (rows.iter().rev().find(is_held)?, rows.last()?);
    let way_m = [0, 1].map(|axis| end.tool_m[axis] - last.tool_m[axis]);
    (end.time_s > last.time_s + 0.1).then(|| hypot(way_m[0], way_m[1]))
}

/// Returns the force between hand and tool in the plane, N.
fn force_n(trace: &Trace, row: &Row) -> f64 {
    let [x, y, _] = trace.force_on_hand_n(row);
    hypot(x, y)
}

fn is_held_in(trace: &Trace, row: &Row) -> bool {
    force_n(trace, row) > HELD_SHARE * trace.yield_n
}
