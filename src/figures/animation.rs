//! Runs beside each other, as a picture that moves.

use std::fmt::Write;

use super::axes::range_of;
use super::{Error, Excerpt, SurfaceLine, TimeSpan, heading, legend, surface_lines};
use yieldwall_motion::elementary::hypot;
use yieldwall_record::{Row, Trace};

/// Most runs that [`animation`] draws.
pub const MOST_MOVING: usize = 3;
/// Width of the picture and height of a panel, px; room above for its texts, and below all panels for the legend.
const WIDTH: f64 = 800.0;
const PANEL_HEIGHT: f64 = 200.0;
const HEAD: f64 = 78.0;
const FOOT: f64 = 62.0;
const GAP: f64 = 16.0;
/// Sizes of letters, px: 10 pt and 8 pt where the picture is 160 mm wide.
const LARGE: f64 = 18.0;
const SMALL: f64 = 15.0;
/// Width of bold letters, in parts of the width of others.
const BOLD: f64 = 1.15;
/// Least way of the tools that fills a panel, m.
const LEAST_WAY_M: f64 = 0.005;
/// Length of an arrow for the greatest yield force of the runs, and room around the ways of the tools, px.
const YIELD_PX: f64 = 60.0;
const ROOM: f64 = 76.0;
/// Pictures a second.
const RATE_HZ: f64 = 30.0;
/// Time for which the last picture stays, s.
const REST_S: f64 = 1.0;
/// A hand that presses with less than this share of the yield force does not hold the tool.
const HELD_SHARE: f64 = 0.025;
/// Width of the band on the forbidden side of a curve, px. The forbidden side of a straight line is filled.
const BAND: f64 = 14.0;
/// Half of the width of the marks, and distance of the measure of a throw from the way, px.
const MARK: f64 = 7.0;
const RING: f64 = 10.0;
const MEASURE: f64 = 30.0;
/// Shorter throws have no measure but their number, px.
const LEAST_MEASURE: f64 = 12.0;

/// Returns the tool of each run with its force, the yield force as a circle and the surfaces, as an animated SVG that repeats.
/// All panels show the same part of the plane, cropped to the ways of the tools, for the time of the shortest run. How far each tool is
/// thrown back stands there from the first picture on, also for viewers that show no motion.
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
    let size = [(WIDTH + GAP) / runs.len() as f64 - GAP, PANEL_HEIGHT];
    let view = Panel::around(&rows, size, YIELD_PX / yield_n);
    let height = HEAD + PANEL_HEIGHT + FOOT;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" width=\"{WIDTH}\" height=\"{height}\" \
         font-family=\"DejaVu Sans, Verdana, sans-serif\" role=\"img\">\n<title>Tools with the forces on them</title>\
         <rect width=\"{WIDTH}\" height=\"{height}\" fill=\"#fff\"/><defs><marker id=\"head\" viewBox=\"0 0 8 8\" refX=\"6\" refY=\"4\" \
         markerWidth=\"4\" markerHeight=\"4\" orient=\"auto\"><path d=\"M0 0L8 4L0 8z\" fill=\"#d55e00\"/></marker>\
         <marker id=\"thrown\" viewBox=\"0 0 8 8\" refX=\"8\" refY=\"4\" markerWidth=\"6\" markerHeight=\"6\" orient=\"auto\">\
         <path d=\"M0 0L8 4L0 8z\"/></marker>\
         <clipPath id=\"panel\"><rect width=\"{}\" height=\"{}\"/></clipPath></defs>\n",
        size[0], size[1]
    );
    for (at, ((name, trace), rows)) in runs.iter().zip(&rows).enumerate() {
        let x = at as f64 * (size[0] + GAP);
        // Writing to a string does not fail.
        let _ = writeln!(svg, "<g transform=\"translate({x} 0)\">{}</g>", view.panel(name, trace, rows, end_s));
    }
    let traces: Vec<&Trace> = runs.iter().map(|(_, trace)| *trace).collect();
    draw_legend(&mut svg, &traces);
    svg.push_str("</svg>\n");
    Ok(svg)
}

/// Draws the legend, and below it the facts that are the same for all runs.
fn draw_legend(svg: &mut String, traces: &[&Trace]) {
    let y = HEAD + PANEL_HEIGHT + 24.0;
    let middle = y - 5.0;
    let mut x = 12.0;
    let mut entry = |sample: String, half: f64, name: &str| {
        let at = x + half;
        let _ = write!(svg, "<g transform=\"translate({at:.1} {middle})\">{sample}</g>");
        *svg += &text([at + half + 6.0, y], SMALL, false, name);
        x = at + half + 6.0 + 0.56 * SMALL * name.chars().count() as f64 + 20.0;
    };
    entry(format!("<circle r=\"{MARK}\"/>"), MARK, "tool");
    let arrow = "<line x1=\"-20\" x2=\"18\" stroke=\"#d55e00\" stroke-width=\"4\" marker-end=\"url(#head)\"/>";
    entry(arrow.to_owned(), 20.0, "push of the hand");
    if traces.iter().any(|trace| !trace.setup.is_unyielding) {
        let circle = "<circle r=\"9\" fill=\"none\" stroke=\"#0072b2\" stroke-width=\"1.5\" stroke-dasharray=\"4 3\"/>";
        entry(circle.to_owned(), 9.0, "yield force R");
    }
    if traces.iter().any(|trace| trace.break_outs().next().is_some()) {
        entry(DIAMOND.to_owned(), MARK, "surface gives way");
    }
    entry(ring(), RING, "hand lets go");
    *svg += &text([4.0, y + 26.0], SMALL, false, &heading::in_common(traces));
}

/// Mark where a surface gives way.
const DIAMOND: &str = "<path d=\"M0-8L8 0L0 8L-8 0Z\" fill=\"#f5b02e\" stroke=\"#000\" stroke-width=\"1.5\"/>";

/// Mark where the hand lets go.
fn ring() -> String {
    format!("<circle r=\"{RING}\" fill=\"none\" stroke=\"#000\" stroke-width=\"2\"/>")
}

fn text([x, y]: [f64; 2], size: f64, is_bold: bool, content: &str) -> String {
    let weight = if is_bold { " font-weight=\"700\"" } else { "" };
    let content = content.replace('&', "&amp;").replace('<', "&lt;");
    format!("<text x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"{size}\"{weight}>{content}</text>")
}

/// Part of the plane that every panel shows.
struct Panel {
    size: [f64; 2],
    center_m: [f64; 2],
    px_per_m: f64,
    px_per_n: f64,
}

impl Panel {
    fn around(rows: &[&[&Row]], size: [f64; 2], px_per_n: f64) -> Self {
        let tools = || rows.iter().flat_map(|rows| rows.iter()).map(|row| row.tool_m);
        let [x, y] = [0, 1].map(|axis| range_of(tools().map(|tool_m| tool_m[axis]), LEAST_WAY_M, 0.0));
        let px_per_m = ((size[0] - 2.0 * ROOM) / (x[1] - x[0])).min((size[1] - 2.0 * ROOM) / (y[1] - y[0]));
        Self { size, center_m: [(x[0] + x[1]) / 2.0, (y[0] + y[1]) / 2.0], px_per_m, px_per_n }
    }

    fn window_m(&self) -> [f64; 4] {
        let [x, y] = self.center_m;
        let [half_x, half_y] = self.size.map(|side| side / 2.0 / self.px_per_m);
        [x - half_x, y - half_y, x + half_x, y + half_y]
    }

    fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [center_x, center_y] = self.center_m;
        [self.size[0] / 2.0 + (x - center_x) * self.px_per_m, self.size[1] / 2.0 - (y - center_y) * self.px_per_m]
    }

    fn panel(&self, name: &str, trace: &Trace, rows: &[&Row], end_s: f64) -> String {
        let frames = Frames::new(self, trace, rows, end_s);
        let throw = Throw::of(trace, rows);
        let mut svg = texts(name, self.size[0], trace, rows, throw.as_ref());
        let _ = write!(svg, "<g transform=\"translate(0 {HEAD})\" clip-path=\"url(#panel)\">");
        surface_lines(&trace.references, self.window_m()).iter().for_each(|line| self.surface(&mut svg, line, trace));
        let _ = write!(svg, "<path d=\"{}\" fill=\"none\" stroke=\"#888\" stroke-width=\"2\"/>", path(&frames.tools));
        self.break_outs(&mut svg, trace, end_s);
        if let Some(throw) = &throw {
            self.measure(&mut svg, throw);
        }
        let radius = (!trace.setup.is_unyielding).then_some(trace.yield_n * self.px_per_n);
        frames.bodies(&mut svg, radius);
        let [width, height] = self.size;
        let _ = write!(
            svg,
            "<rect width=\"{width}\" height=\"{height}\" fill=\"none\" stroke=\"#999\" stroke-width=\"2\"/></g>"
        );
        svg
    }

    /// Marks where the surface gave way, each mark beside the one before.
    fn break_outs(&self, svg: &mut String, trace: &Trace, end_s: f64) {
        let mut last: Option<[f64; 2]> = None;
        for row in trace.break_outs().filter_map(|at| trace.rows.get(at)).filter(|row| row.time_s <= end_s) {
            let [x, y] = self.place([row.proxy_m[0], row.proxy_m[1]]);
            if last.is_none_or(|last| hypot(x - last[0], y - last[1]) >= 2.0 * MARK) {
                let _ = write!(svg, "<g transform=\"translate({x:.1} {y:.1})\">{DIAMOND}</g>");
                last = Some([x, y]);
            }
        }
    }

    /// Draws where the hand let go, and how far from there the tool went.
    fn measure(&self, svg: &mut String, throw: &Throw) {
        let (from, to) = (self.place(throw.from_m), self.place(throw.to_m));
        let _ = write!(svg, "<g transform=\"translate({:.1} {:.1})\">{}</g>", from[0], from[1], ring());
        let way = [to[0] - from[0], to[1] - from[1]];
        let length = hypot(way[0], way[1]);
        // Below the way on paper; right of one that runs upright.
        let across = match length >= LEAST_MEASURE {
            true => [-way[1] / length, way[0] / length],
            false => [0.0, 1.0],
        };
        let side = if across[1] < 0.0 || (across[1] == 0.0 && across[0] < 0.0) { -MEASURE } else { MEASURE };
        let beside =
            |point: [f64; 2], share: f64| [point[0] + share * side * across[0], point[1] + share * side * across[1]];
        if length >= LEAST_MEASURE {
            let ([x1, y1], [x2, y2]) = (beside(from, 1.0), beside(to, 1.0));
            let ends =
                [[beside(from, 0.5), beside(from, 1.3)], [beside(to, 0.5), beside(to, 1.3)]].map(|end| path(&end));
            let _ = write!(
                svg,
                "<path d=\"{}{}\" stroke=\"#000\"/><line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" \
                 stroke=\"#000\" stroke-width=\"2\" marker-end=\"url(#thrown)\"/>",
                ends[0], ends[1]
            );
        }
        let [x, y] = beside([from[0] + 0.75 * way[0], from[1] + 0.75 * way[1]], 1.7);
        let _ = write!(
            svg,
            "<text x=\"{x:.1}\" y=\"{:.1}\" font-size=\"{LARGE}\" font-weight=\"700\" text-anchor=\"middle\" \
             stroke=\"#fff\" stroke-width=\"4\" paint-order=\"stroke\">{}</text>",
            y + 6.0,
            mm(throw.back_m)
        );
    }

    fn surface(&self, svg: &mut String, line: &SurfaceLine, trace: &Trace) {
        let points: Vec<[f64; 2]> = line.points_m.iter().map(|point_m| self.place(*point_m)).collect();
        let close = if line.is_closed { "Z" } else { "" };
        if trace.is_unilateral && line.has_sides {
            let band = if points.len() == 2 { 2.0 * WIDTH } else { BAND };
            // On the page y points down: the right of the way is its left.
            let beside = points.iter().enumerate().map(|(at, point)| {
                let (from, to) = (points[at.saturating_sub(1)], points[(at + 1).min(points.len() - 1)]);
                let [x, y] = [to[0] - from[0], to[1] - from[1]];
                let length = hypot(x, y).max(1e-9);
                [point[0] - band * y / length, point[1] + band * x / length]
            });
            let beside: Vec<[f64; 2]> = beside.collect();
            let band: Vec<[f64; 2]> = points.iter().copied().chain(beside.into_iter().rev()).collect();
            let _ = write!(svg, "<path d=\"{}Z\" opacity=\".12\"/>", path(&band));
        }
        let _ = write!(svg, "<path d=\"{}{close}\" fill=\"none\" stroke=\"#333\" stroke-width=\"3\"/>", path(&points));
    }
}

/// Returns a length in mm, with a decimal where it counts.
fn mm(length_m: f64) -> String {
    let length_mm = 1e3 * length_m;
    let decimals = usize::from((0.05..9.95).contains(&length_mm));
    format!("{length_mm:.decimals$} mm")
}

/// Returns the texts above a panel.
fn texts(name: &str, width: f64, trace: &Trace, rows: &[&Row], throw: Option<&Throw>) -> String {
    let fitted = |size: f64| legend::shortened(name, width, BOLD * size);
    let size = if fitted(LARGE) == name { LARGE } else { SMALL };
    let most_n = rows.iter().map(|row| force_n(trace, row)).fold(0.0, f64::max);
    let yields = if trace.break_outs().next().is_some() { ": it yields" } else { "" };
    let push = format!("a push of up to {most_n:.0} N{yields}");
    let end = match throw {
        Some(throw) => format!("let go: thrown back {}", mm(throw.back_m)),
        None => "not let go".to_owned(),
    };
    text([4.0, 20.0], size, true, &fitted(size))
        + &text([4.0, 44.0], SMALL, false, &push)
        + &text([4.0, 66.0], SMALL, true, &end)
}

/// Motion of the tool in the plane after the hand has let go for good.
pub struct Throw {
    from_m: [f64; 2],
    to_m: [f64; 2],
    /// Way in the direction of the force on the hand in its strongest push, m.
    pub back_m: f64,
    /// Distance of the proxy from the surface when the hand let go, m.
    pub depth_m: f64,
}

impl Throw {
    /// Returns the throw of a whole run; `None` if the hand never lets go.
    pub fn in_run(trace: &Trace) -> Option<Self> {
        Self::of(trace, &trace.rows.iter().collect::<Vec<_>>())
    }

    /// Returns `None` if the hand never lets go.
    fn of(trace: &Trace, rows: &[&Row]) -> Option<Self> {
        let is_held = |row: &&&Row| is_held_in(trace, row);
        let (last, end) = (rows.iter().rev().find(is_held)?, rows.last()?);
        let strongest = rows.iter().max_by(|a, b| force_n(trace, a).total_cmp(&force_n(trace, b)))?;
        let [force_x, force_y, _] = trace.force_on_hand_n(strongest);
        let [from_m, to_m] = [last, end].map(|row| [row.tool_m[0], row.tool_m[1]]);
        let way = (to_m[0] - from_m[0]) * force_x + (to_m[1] - from_m[1]) * force_y;
        let back_m = (way / hypot(force_x, force_y).max(1e-9)).max(0.0);
        let depth_m = last.signed_distance_m.abs();
        (end.time_s > last.time_s + 0.1).then_some(Self { from_m, to_m, back_m, depth_m })
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
        Self { tools, tips, is_held, lasts_s: count as f64 / RATE_HZ }
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

    /// Draws tool and hand. Without animation the tool is where it ends.
    fn bodies(&self, svg: &mut String, radius: Option<f64>) {
        let shown = self.animate("opacity", "discrete", self.is_held.iter().map(|held| u8::from(*held).to_string()));
        let place = |x: &str, y: &str, points| self.moved(x, points, 0) + &self.moved(y, points, 1);
        let at = place("cx", "cy", &self.tools);
        let circle = radius.map_or(String::new(), |radius| {
            format!("<circle r=\"{radius}\" fill=\"none\" stroke=\"#0072b2\" stroke-width=\"1.5\" stroke-dasharray=\"4 3\">{at}</circle>")
        });
        let arrow = place("x1", "y1", &self.tools) + &place("x2", "y2", &self.tips);
        let hands: Vec<[f64; 2]> = self.tools.iter().map(|[x, y]| [*x, y - 16.0]).collect();
        let hand = place("x", "y", &hands);
        let [x, y] = self.tools.last().copied().unwrap_or_default();
        let _ = write!(
            svg,
            "<g opacity=\"0\">{shown}{circle}<line stroke=\"#d55e00\" stroke-width=\"4\" marker-end=\"url(#head)\">{arrow}</line>\
             <text font-size=\"{SMALL}\" text-anchor=\"middle\">hand{hand}</text></g>\
             <circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{MARK}\">{at}</circle>"
        );
    }
}

/// Returns the force between hand and tool in the plane, N.
fn force_n(trace: &Trace, row: &Row) -> f64 {
    let [x, y, _] = trace.force_on_hand_n(row);
    hypot(x, y)
}

fn is_held_in(trace: &Trace, row: &Row) -> bool {
    force_n(trace, row) > HELD_SHARE * trace.yield_n
}
