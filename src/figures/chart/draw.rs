//! Charts drawn with the plots of the plotting crate, as SVG and PNG.

use yieldwall_motion::elementary;

use kuva::RasterBackend;
use kuva::backend::svg::SvgBackend;
use kuva::plot::line::{LinePlot, LineStyle};
use kuva::plot::scatter::{MarkerShape, ScatterPlot};
use kuva::render::figure::{Figure, FigureLegendPosition};
use kuva::render::layout::{AxisLabelOverlap, Layout};
use kuva::render::plots::Plot;
use kuva::render::render::{Primitive, Scene, TextAnchor};
use thiserror::Error;

use super::{Axis, Chart, Color, Mark, Panel, Series, swatch, tick};

/// Panels in a row at most.
const COLUMNS: usize = 2;
/// Size of a panel in pixels of the SVG: on the width of a page, 160 mm, the smallest letters have 7 points.
const PANEL: (f64, f64) = (340.0, 290.0);
/// Part of a panel's width that lies within its axes, about.
const WITHIN: f64 = 0.72;
/// Sizes of letters in pixels of the SVG: of the chart's title, of those of panels and axes, and of ticks and the longest titles.
const TITLE: u32 = 16;
const LABEL: u32 = 13;
const LEAST_LETTERS: u32 = 12;
/// Width of a letter over its size, about.
const LETTER_WIDTH: f64 = 0.56;
/// Half the width of a mark, in pixels of the SVG.
const MARK: f64 = 4.0;
/// Radius of a ring about a mark.
const RING: f64 = 9.0;
/// Widths of lines, in pixels of the SVG: of a series, and of an interval.
pub(super) const LINE: f64 = 1.8;
const WHISKER: f64 = 1.0;
/// Width of the white rim of a line over cells beyond that of the line, in pixels of the SVG: the rim sets the line off in grey.
const LINE_RIM: f64 = 2.4;
/// Dashes and gaps of a line, in pixels of the SVG: its sample has two.
pub(super) const DASHES: &str = "8 4";
/// Size of the white part of an open mark, as a share of the mark.
pub(super) const OPEN: f64 = 0.55;
pub(super) const WHITE: &str = "#ffffff";
/// By how much a mark is larger than that of the next series, so that its rim is seen where both stand in one place.
const RIM: f64 = 0.08;
/// Distance from the frame of marks for points beyond it, as a share of the axis, and the further distance of the next series.
const EDGE: f64 = 0.015;
const NEXT_EDGE: f64 = 0.03;
/// Distance from the frame of all such marks in a panel with rings: the frame does not cut a ring about one of them.
const RING_EDGE: f64 = 0.05;
/// Pixels of the PNG for each of the SVG.
const PICTURE_SCALE: f32 = 2.0;

/// Reason why a chart could not be drawn.
#[derive(Debug, Error)]
pub enum DrawError {
    /// The encoder of pictures failed.
    #[error("the chart cannot be written as PNG: {0}")]
    Encode(String),
}

/// Returns a chart as an SVG document.
pub fn svg(chart: &Chart) -> String {
    SvgBackend::new().render_scene(&scene(chart))
}

/// Returns a chart as a PNG picture.
///
/// # Errors
/// If the encoder fails.
pub fn png(chart: &Chart) -> Result<Vec<u8>, DrawError> {
    RasterBackend::new().with_scale(PICTURE_SCALE).render_scene(&scene(chart)).map_err(DrawError::Encode)
}

fn scene(chart: &Chart) -> Scene {
    let columns = chart.panels.len().clamp(1, COLUMNS);
    let rows = chart.panels.len().div_ceil(columns);
    let plots: Vec<Vec<Plot>> = chart.panels.iter().map(plots).collect();
    let layouts = chart.panels.iter().map(layout).collect();
    let mut figure = Figure::new(rows, columns)
        .with_title(&chart.title)
        .with_title_size(fitting(&chart.title, columns as f64 * PANEL.0, TITLE))
        .with_cell_size(PANEL.0, PANEL.1)
        .with_plots(plots)
        .with_layouts(layouts);
    let legend = swatch::legend(chart);
    if !legend.is_empty() {
        figure = figure
            .with_shared_legend_position(FigureLegendPosition::Bottom)
            .with_shared_legend_entries(swatch::entries(&legend));
    }
    let mut scene = figure.render();
    swatch::put_samples(&mut scene, &legend);
    for text in chart.panels.iter().flat_map(|panel| [title(panel), panel.x.name.clone()]) {
        if text != chart.title {
            move_within(&mut scene, &text);
        }
    }
    scene
}

/// Moves a text, which stands above or below the middle of the axes, so far that it does not leave its panel.
fn move_within(scene: &mut Scene, text: &str) {
    for element in &mut scene.elements {
        let Primitive::Text { x, content, size, anchor: TextAnchor::Middle, rotate: None, .. } = element else {
            continue;
        };
        if content == text {
            let half = (0.5 * text_width(content, *size)).min(0.5 * PANEL.0);
            *x = x.clamp(half, PANEL.0 - half);
        }
    }
}

/// Returns the width of a text in pixels, about.
fn text_width(text: &str, size: u32) -> f64 {
    LETTER_WIDTH * f64::from(size) * text.chars().count() as f64
}

/// Returns the line above a panel, with the number of points that have no place on its axes.
fn title(panel: &Panel) -> String {
    let beyond = panel.series.iter().map(|series| beyond_values(panel, series).len()).sum::<usize>();
    match edge_words(std::slice::from_ref(panel)) {
        None => panel.title.clone(),
        Some(EITHER) => format!("{} ({beyond} at the edge)", panel.title),
        Some(words) => format!("{} ({beyond} {words})", panel.title),
    }
}

fn layout(panel: &Panel) -> Layout {
    let [x, y] = [(&panel.x, 0), (&panel.y, 1)].map(|(axis, which)| range(axis, panel, which));
    let title = title(panel);
    let mut layout = Layout::new(x, y)
        .with_title(&title)
        .with_title_size(fitting(&title, PANEL.0, LABEL))
        .with_x_label(&panel.x.name)
        .with_y_label(&panel.y.name)
        .with_label_size(fitting(&panel.x.name, PANEL.0, LABEL).min(fitting(&panel.y.name, PANEL.1, LABEL)))
        .with_tick_size(LEAST_LETTERS)
        .with_x_label_overlap(AxisLabelOverlap::Thin)
        .with_clamp_axis()
        .with_box_axes();
    let tick_format = |axis: &Axis, range, pixels| match axis.is_logarithmic {
        true => tick::of_powers(range, pixels),
        false => tick::of_steps(range),
    };
    layout = layout
        .with_x_tick_format(tick_format(&panel.x, x, Some(WITHIN * PANEL.0)))
        .with_y_tick_format(tick_format(&panel.y, y, None));
    if !panel.x.words.is_empty() {
        layout = layout.with_x_categories(panel.x.words.clone());
    }
    if !panel.y.words.is_empty() {
        layout = layout.with_y_categories(panel.y.words.clone());
    }
    if panel.x.is_logarithmic {
        layout = layout.with_log_x();
    }
    if panel.y.is_logarithmic {
        layout = layout.with_log_y();
    }
    // The plotting crate rounds the range of other axes.
    if panel.x.range.is_some() || panel.x.is_logarithmic {
        layout = layout.with_x_axis_min(x.0).with_x_axis_max(x.1);
    }
    if panel.y.range.is_some() || panel.y.is_logarithmic {
        layout = layout.with_y_axis_min(y.0).with_y_axis_max(y.1);
    }
    layout
}

/// Words for points of which some are zero on a logarithmic axis and others are beyond the ends of an axis.
const EITHER: &str = "at zero or beyond the axis";

/// Returns the words for the place of points that do not fit on the axes of these panels; `None` if all fit.
pub(super) fn edge_words(panels: &[Panel]) -> Option<&'static str> {
    let of_panel = |panel: &Panel| {
        let values: Vec<_> = panel.series.iter().flat_map(|series| beyond_values(panel, series)).collect();
        let is_below_powers = |(x, y): (f64, f64)| {
            [(x, &panel.x), (y, &panel.y)].into_iter().any(|(value, axis)| axis.is_logarithmic && value <= 0.0)
        };
        values.into_iter().map(is_below_powers).collect::<Vec<_>>()
    };
    let all: Vec<bool> = panels.iter().flat_map(of_panel).collect();
    match (all.contains(&true), all.contains(&false)) {
        (true, true) => Some(EITHER),
        (true, false) => Some("at zero"),
        (false, true) => Some("beyond the axis"),
        (false, false) => None,
    }
}

/// Returns the size of letters in which a text takes no more than so many pixels: `most`, or as small as it has to be.
fn fitting(text: &str, pixels: f64, most: u32) -> u32 {
    let letters = text.chars().count().max(1) as f64;
    ((pixels / (LETTER_WIDTH * letters)) as u32).clamp(LEAST_LETTERS, most)
}

/// Returns the range of an axis: as given, or that of what is drawn with a twentieth of it on both sides. A logarithmic one then ends at its
/// ticks. Another one does not go below zero unless a value does.
fn range(axis: &Axis, panel: &Panel, which: usize) -> (f64, f64) {
    if let Some([low, high]) = axis.range {
        return (low, high);
    }
    let values =
        panel.series.iter().flat_map(|series| drawn(panel, series)).map(|(x, y)| if which == 0 { x } else { y });
    let (low, high) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    match (low < high, axis.is_logarithmic) {
        (true, true) => {
            let factor = elementary::powf(high / low, 0.05);
            tick::around_powers(low / factor, high * factor)
        }
        (true, false) => {
            let margin = 0.05 * (high - low);
            (if low < 0.0 { low - margin } else { (low - margin).max(0.0) }, high + margin)
        }
        (false, true) if low.is_finite() => (0.5 * low, 2.0 * low),
        (false, false) if low.is_finite() => (low - 0.5, low + 0.5),
        (false, true) => (0.1, 1.0),
        (false, false) => (0.0, 1.0),
    }
}

/// Whether every axis can show a point, within its range or beyond.
fn is_drawable(panel: &Panel, (x, y): (f64, f64)) -> bool {
    let has_place = |value: f64, axis: &Axis| value.is_finite() && (value > 0.0 || !axis.is_logarithmic);
    has_place(x, &panel.x) && has_place(y, &panel.y)
}

/// Returns the points that every axis can show, within its range or beyond.
fn drawable(panel: &Panel, series: &Series) -> Vec<(f64, f64)> {
    series.points.iter().copied().filter(|&point| is_drawable(panel, point)).collect()
}

/// Returns the pieces of a line. It ends where a point is not above zero on a logarithmic axis.
fn pieces(panel: &Panel, series: &Series) -> Vec<Vec<(f64, f64)>> {
    let finite: Vec<_> = series.points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
    let pieces = finite.split(|&point| !is_drawable(panel, point)).map(<[_]>::to_vec);
    pieces.filter(|piece| !piece.is_empty()).collect()
}

fn is_within(panel: &Panel, (x, y): (f64, f64)) -> bool {
    let holds = |value: f64, axis: &Axis| {
        (value > 0.0 || !axis.is_logarithmic) && axis.range.is_none_or(|[low, high]| (low..=high).contains(&value))
    };
    holds(x, &panel.x) && holds(y, &panel.y)
}

/// Returns the points that have a place on the axes.
pub(super) fn drawn(panel: &Panel, series: &Series) -> Vec<(f64, f64)> {
    drawable(panel, series).into_iter().filter(|&point| is_within(panel, point)).collect()
}

/// Returns the values of the marks that have none. A line alone has no marks.
pub(super) fn beyond_values(panel: &Panel, series: &Series) -> Vec<(f64, f64)> {
    if !matches!(series.mark, Mark::MarkedLine | Mark::MarkedDashes | Mark::Marks) {
        return Vec::new();
    }
    let is_finite = |(x, y): &(f64, f64)| x.is_finite() && y.is_finite();
    series.points.iter().copied().filter(is_finite).filter(|&point| !is_within(panel, point)).collect()
}

/// Returns these marks, each near the nearest place on the edge, and whether its value lies below. `row` counts the series that have such
/// marks before this one.
fn beyond(panel: &Panel, series: &Series, row: usize) -> Vec<((f64, f64), bool)> {
    let values = beyond_values(panel, series);
    values.into_iter().map(|point| (at_edge(panel, point, row), point.1 < at_edge(panel, point, row).1)).collect()
}

/// Returns the places of rings: of a point beyond the axes the place of its mark.
pub(super) fn ringed(panel: &Panel, series: &Series) -> Vec<(f64, f64)> {
    let points = series.points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite());
    points.filter(|_| series.mark == Mark::Rings).map(|point| at_edge(panel, point, 0)).collect()
}

/// Returns the place of a point, or, if that is beyond the axes, the nearest one within their edge.
fn at_edge(panel: &Panel, (x, y): (f64, f64), row: usize) -> (f64, f64) {
    let has_rings = panel.series.iter().any(|series| series.mark == Mark::Rings);
    let inward = if has_rings { RING_EDGE } else { EDGE + NEXT_EDGE * row as f64 };
    let [of_x, of_y] = [(&panel.x, 0), (&panel.y, 1)].map(|(axis, which)| (axis, range(axis, panel, which)));
    (edge(x, of_x.0, of_x.1, EDGE), edge(y, of_y.0, of_y.1, inward))
}

/// Returns a value on the axis, or the place within the end that it lies beyond, by a share of the axis.
fn edge(value: f64, axis: &Axis, (low, high): (f64, f64), inward: f64) -> f64 {
    let share = match value {
        _ if value < low => inward,
        _ if value > high => 1.0 - inward,
        _ => return value,
    };
    if axis.is_logarithmic { low * elementary::powf(high / low, share) } else { low + share * (high - low) }
}

fn plots(panel: &Panel) -> Vec<Plot> {
    let mut plots = Vec::new();
    let named = panel.series.iter().filter(|series| !series.name.is_empty());
    let (mut under, mut rows) = (named.count(), 0);
    let is_over_cells = panel.series.iter().any(|series| matches!(series.mark, Mark::Cells(_)));
    for series in &panel.series {
        under = under.saturating_sub(usize::from(!series.name.is_empty()));
        let mark = MARK * (1.0 + RIM * under as f64);
        let points = drawn(panel, series);
        let color = code(series.color);
        let line = |points: &[(f64, f64)], color: &str, width: f64, style| {
            let line = LinePlot::new().with_data(points.to_vec()).with_color(color);
            Plot::from(line.with_stroke_width(width).with_line_style(style))
        };
        let marks = |points: Vec<(f64, f64)>, marker, size| {
            ScatterPlot::new().with_data(points).with_color(color).with_marker(marker).with_size(size)
        };
        let style = match series.mark {
            Mark::Line | Mark::MarkedLine => Some(LineStyle::Solid),
            Mark::Dashed | Mark::MarkedDashes => Some(LineStyle::Custom(DASHES.to_owned())),
            Mark::Marks | Mark::Rings | Mark::Whisker | Mark::Cells(_) => None,
        };
        if let Some(style) = style {
            // What lies beyond the axes is cut off at their frame.
            for piece in pieces(panel, series) {
                if is_over_cells {
                    plots.push(line(&piece, WHITE, LINE + LINE_RIM, LineStyle::Solid));
                }
                plots.push(line(&piece, color, LINE, style.clone()));
            }
        }
        if series.mark == Mark::Whisker && !drawable(panel, series).is_empty() {
            let ends = series.points.iter().filter(|(x, y)| x.is_finite() && y.is_finite());
            let [of_x, of_y] = [(&panel.x, 0), (&panel.y, 1)].map(|(axis, which)| range(axis, panel, which));
            // An end beyond the frame is drawn at it.
            let ends: Vec<_> = ends.map(|&(x, y)| (x.clamp(of_x.0, of_x.1), y.clamp(of_y.0, of_y.1))).collect();
            plots.push(line(&ends, color, WHISKER, LineStyle::Solid));
        }
        match series.mark {
            Mark::Rings => {
                let rings = marks(ringed(panel, series), MarkerShape::Circle, RING).with_marker_opacity(0.0);
                plots.push(rings.with_marker_stroke_width(LINE).into());
            }
            _ if points.is_empty() => {}
            Mark::Line | Mark::Dashed | Mark::Whisker => {}
            Mark::MarkedLine | Mark::MarkedDashes | Mark::Marks => {
                plots.push(marks(points.clone(), shape(series), mark).into());
                if is_open(series) {
                    plots.push(marks(points, shape(series), OPEN * mark).with_color(WHITE).into());
                }
            }
            Mark::Cells(width) => {
                let half = 0.5 * f64::from(width) / 1000.0 * WITHIN * PANEL.0;
                plots.push(marks(points, MarkerShape::Square, half).into());
            }
        }
        let (below, above): (Vec<_>, Vec<_>) =
            beyond(panel, series, rows).into_iter().partition(|(_, is_below)| *is_below);
        rows += usize::from(!(below.is_empty() && above.is_empty()));
        for (points, shape) in [(above, MarkerShape::Triangle), (below, MarkerShape::TriangleDown)] {
            if !points.is_empty() {
                plots.push(marks(points.into_iter().map(|(point, _)| point).collect(), shape, MARK).into());
            }
        }
    }
    plots
}

/// Returns the shape of a series' marks. Triangles are the marks of points beyond the edge. Upright crosses would not be seen on intervals.
pub(super) fn shape(series: &Series) -> MarkerShape {
    match (series.color, series.mark == Mark::MarkedDashes) {
        (Color::Blue | Color::Pale, _) | (Color::Sky, false) => MarkerShape::Circle,
        (Color::Vermilion, _) | (Color::Black, true) => MarkerShape::Square,
        (Color::Green | Color::Wine, _) => MarkerShape::Diamond,
        (Color::Purple | Color::Gray, _) => MarkerShape::Star,
        (Color::Orange | Color::Olive, _) => MarkerShape::Pentagon,
        (Color::Sky, true) => MarkerShape::Hexagon,
        (Color::Black, false) => MarkerShape::Cross,
    }
}

/// Whether the marks of a series are white within. Sky blue ones are, since the orange ones are of the same grey.
pub(super) fn is_open(series: &Series) -> bool {
    series.mark == Mark::MarkedDashes || series.color == Color::Sky
}

pub(super) fn code(color: Color) -> &'static str {
    match color {
        Color::Black => "#000000",
        Color::Blue => "#0072b2",
        Color::Vermilion => "#d55e00",
        Color::Green => "#009e73",
        Color::Purple => "#cc79a7",
        Color::Orange => "#e69f00",
        Color::Sky => "#56b4e9",
        Color::Wine => "#882255",
        Color::Olive => "#999933",
        Color::Gray => "#7f7f7f",
        Color::Pale => "#d9d9d9",
    }
}

#[cfg(test)]
mod tests {
    use super::super::Estimate;
    use super::*;

    fn chart() -> Chart {
        let series = |name: &str, mark, color, factor: f64| Series {
            name: name.to_owned(),
            points: (1..=20).map(|i| (f64::from(i), factor * f64::from(i * i))).collect(),
            mark,
            color,
        };
        let panel = |title: &str, y: Axis| Panel {
            title: title.to_owned(),
            x: Axis::linear("speed (m/s)"),
            y,
            series: vec![
                series("cells", Mark::Cells(30), Color::Pale, 0.5),
                series("measured", Mark::MarkedLine, Color::Blue, 1.0),
                series("theory", Mark::Dashed, Color::Black, 1.2),
                series("", Mark::Marks, Color::Vermilion, -1.0),
            ],
        };
        let panels = vec![
            panel("left", Axis::linear("error (um)")),
            panel("right", Axis::logarithmic("error (um)").over(1.0, 1000.0)),
        ];
        Chart { title: "A chart".to_owned(), panels }
    }

    #[test]
    fn a_chart_names_what_it_shows() {
        let svg = svg(&chart());
        for text in ["A chart", "left", "right", "speed (m/s)", "measured", "theory"] {
            assert!(svg.contains(text), "{text}");
        }
        assert_eq!(svg.matches(">measured<").count(), 1, "one legend for all panels");
        assert!(png(&chart()).unwrap().starts_with(b"\x89PNG"));
    }

    #[test]
    fn what_has_no_place_on_an_axis_is_left_out() {
        let mut chart = chart();
        chart.panels.truncate(1);
        chart.panels[0].y = Axis::logarithmic("y");
        chart.panels[0].series[0].points = vec![(1.0, 0.0), (f64::NAN, 1.0), (2.0, f64::INFINITY)];
        assert!(drawn(&chart.panels[0], &chart.panels[0].series[0]).is_empty());
        assert!(drawn(&chart.panels[0], &chart.panels[0].series[3]).is_empty());
        assert!(!svg(&chart).contains("NaN"));
    }

    #[test]
    fn marks_beyond_the_edge_are_drawn_there_and_counted() {
        let mut chart = chart();
        chart.panels.truncate(1);
        let panel = &mut chart.panels[0];
        panel.y = Axis::linear("y").over(-300.0, 324.0);
        // 19^2 and 20^2 of `measured` are above, -18^2 to -20^2 of the marks are below; the dashed line is only cut off.
        let counts: Vec<_> = panel.series.iter().map(|series| beyond(panel, series, 0).len()).collect();
        assert_eq!(counts, [0, 2, 0, 3]);
        let near = |((x, y), is_below): ((f64, f64), bool)| (x, y.round(), is_below);
        assert_eq!(near(beyond(panel, &panel.series[1], 0)[0]), (19.0, 315.0, false));
        assert_eq!(near(beyond(panel, &panel.series[3], 0)[0]), (18.0, -291.0, true));
        assert_eq!(near(beyond(panel, &panel.series[3], 2)[0]), (18.0, -253.0, true), "beside those of two others");
        assert!((edge(1e9, &Axis::logarithmic("x"), (1.0, 1e4), EDGE) / 8.7e3 - 1.0).abs() < 0.01);
        assert!(svg(&chart).contains("left (5 beyond the axis)"));
        assert!(svg(&chart).contains(">triangle: beyond the axis<"));
    }

    #[test]
    fn an_estimate_has_a_line_over_its_interval_as_far_as_the_axes_reach() {
        let estimate = |value: f64, low: f64, high: f64| Estimate { value, low, high };
        let estimates = [
            (1.0.into(), estimate(10.0, 5.0, 20.0)),
            (estimate(2.0, 1.5, 2.5), estimate(30.0, -1.0, 2e4)),
            (3.0.into(), f64::NAN.into()),
            (4.0.into(), estimate(40.0, 40.0, 40.0)),
        ];
        let all = Series::new("law".into(), Mark::MarkedLine, Color::Blue).through(&estimates);
        let ends: Vec<_> = all.iter().filter(|it| it.mark == Mark::Whisker).map(|it| it.points.clone()).collect();
        let expected = [[(1.0, 5.0), (1.0, 20.0)], [(1.5, 30.0), (2.5, 30.0)], [(2.0, -1.0), (2.0, 2e4)]];
        assert_eq!(ends, expected.map(Vec::from));
        assert_eq!(all.last().unwrap().points.len(), 4, "the series itself is on top");
        let mut chart = chart();
        chart.panels.truncate(1);
        chart.panels[0].y = Axis::logarithmic("y").over(1.0, 1e3);
        chart.panels[0].series = all;
        assert_eq!(plots(&chart.panels[0]).len(), 3 + 2, "three lines, a line and its marks");
        let svg = svg(&chart);
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        assert_eq!(swatch::legend(&chart).len(), 1);
    }

    /// Of a method whose value is zero the legend would speak, and no panel would show it.
    #[test]
    fn zeros_on_a_logarithmic_axis_are_marked_at_its_edge_and_a_name_without_a_mark_is_not_in_the_legend() {
        let mut chart = chart();
        for panel in &mut chart.panels {
            panel.y = Axis::logarithmic("error (um)");
            panel.series[1].points = vec![(1.0, 0.0), (2.0, 0.0)];
            panel.series[2].points = vec![(1.0, f64::NAN)];
        }
        let panel = &chart.panels[0];
        let (low, high) = range(&panel.y, panel, 1);
        for ((_, y), is_below) in beyond(panel, &panel.series[1], 0) {
            assert!(is_below && low < y && y < low * elementary::powf(high / low, 0.05));
        }
        let names: Vec<_> = swatch::entries(&swatch::legend(&chart)).into_iter().map(|entry| entry.label).collect();
        assert_eq!(names, ["cells", "measured", "triangle: at zero"], "the theory has no point");
        // Two of `measured`, and the twenty negative ones of the marks.
        assert!(svg(&chart).contains("left (22 at zero)"), "{}", svg(&chart));
        let counts = plots(panel).len();
        chart.panels[0].series[1].points.clear();
        assert!(plots(&chart.panels[0]).len() < counts, "triangles");
    }

    /// A mark at the edge stands where the axis ends: the plotting crate does not round the range of an axis of powers.
    #[test]
    fn an_axis_of_powers_ends_where_the_marks_at_its_edge_stand() {
        let mut chart = chart();
        let panel = &mut chart.panels[0];
        panel.y = Axis::logarithmic("error (um)");
        panel.series[1].points[0].1 = 0.0;
        let (low, high) = range(&panel.y, panel, 1);
        assert_eq!((low, high), (0.1, 1000.0), "0.5 to 1.2 * 20^2 between two powers");
        let layout = layout(panel);
        assert_eq!((layout.y_axis_min, layout.y_axis_max), (Some(low), Some(high)));
    }

    #[test]
    fn a_line_does_not_pass_over_a_zero_that_its_axis_cannot_show() {
        let mut chart = chart();
        let panel = &mut chart.panels[1];
        panel.series[1].points = vec![(1.0, 2.0), (2.0, f64::NAN), (3.0, 2.0), (4.0, 0.0), (5.0, 2.0)];
        assert_eq!(pieces(panel, &panel.series[1]), [vec![(1.0, 2.0), (3.0, 2.0)], vec![(5.0, 2.0)]]);
    }

    #[test]
    fn an_axis_goes_below_zero_only_for_values_below_zero() {
        let mut chart = chart();
        let panel = &mut chart.panels[0];
        panel.series.truncate(2);
        assert_eq!(range(&panel.y, panel, 1).0, 0.0);
        panel.series[0].points[0].1 = -1.0;
        assert!(range(&panel.y, panel, 1).0 < -1.0);
    }

    /// The plotting crate draws no open marks, no rings and no marks on lines in a legend.
    #[test]
    fn a_legend_shows_lines_and_marks_as_the_panels_do() {
        let mut chart = chart();
        chart.panels.truncate(1);
        let marks = [Mark::Line, Mark::Dashed, Mark::MarkedDashes, Mark::Rings];
        chart.panels[0].series = marks
            .map(|mark| Series {
                points: vec![(1.0, 1.0), (2.0, 2.0)],
                ..Series::new(format!("{mark:?}"), mark, Color::Blue)
            })
            .into();
        let scene = scene(&chart);
        let samples = |name: &str| {
            let is_name = |it: &Primitive| matches!(it, Primitive::Text { content, .. } if content == name);
            let place = scene.elements.iter().rposition(is_name).unwrap();
            let rest = scene.elements.iter().skip(place + 1);
            rest.take_while(|it| !matches!(it, Primitive::Text { .. })).collect::<Vec<_>>()
        };
        assert!(matches!(samples("Line")[..], [Primitive::Line { stroke_dasharray: None, .. }]));
        let [Primitive::Line { x1, x2, stroke_dasharray: Some(dashes), .. }] = samples("Dashed")[..] else { panic!() };
        assert_eq!((x2 - x1, dashes.as_str()), (20.0, "8 4"), "two dashes and the gap between them");
        let [
            Primitive::Line { .. },
            Primitive::Line { .. },
            Primitive::Circle { r, .. },
            Primitive::Circle { r: within, .. },
        ] = samples("MarkedDashes")[..]
        else {
            panic!()
        };
        assert!(within < r);
        assert!(samples("Rings").iter().any(|it| matches!(it, Primitive::Circle { stroke: Some(_), .. })));
    }

    fn attribute<'a>(element: &'a str, name: &str) -> Option<&'a str> {
        element.split_once(&format!(" {name}=\""))?.1.split_once('"').map(|(value, _)| value)
    }

    fn number(element: &str, name: &str) -> f64 {
        attribute(element, name).and_then(|value| value.parse().ok()).unwrap_or_else(|| panic!("{name} of {element}"))
    }

    /// Room of texts on both sides of a panel.
    const BESIDE: f64 = 7.0;

    /// Titles and ticks of the published charts of all studies.
    #[test]
    fn texts_of_published_charts_fit_and_do_not_collide() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/figures");
        let files = std::fs::read_dir(folder).unwrap().map(|file| file.unwrap().path());
        let charts = files.filter(|path| {
            let name = path.file_name().unwrap().to_string_lossy();
            name.starts_with("study-") && name.ends_with(".svg")
        });
        let mut count = 0;
        for path in charts {
            let svg = std::fs::read_to_string(&path).unwrap();
            let place = path.display();
            // Each panel has places of its own. The title of the chart comes behind the last one.
            let panels = svg.split("<g transform=\"translate(").skip(1);
            let rooms = panels.flat_map(|panel| {
                let (within, behind) = panel.split_once("</g></g>").unwrap_or((panel, ""));
                [(PANEL.0, within), (number(&svg, "width"), behind)]
            });
            for (room, texts) in rooms {
                let mut ends: Vec<(f64, [f64; 2], &str)> = Vec::new();
                for text in texts.split("<text").skip(1) {
                    let (head, rest) = text.split_once('>').unwrap();
                    let words = rest.split_once('<').unwrap().0;
                    let size = number(head, "font-size");
                    assert!(size >= f64::from(LEAST_LETTERS), "{place}: {words} has letters of {size} px");
                    if attribute(head, "text-anchor") != Some("middle") || head.contains("rotate") {
                        continue;
                    }
                    let half = 0.5 * text_width(words, size as u32);
                    let [left, right] = [-half, half].map(|side| number(head, "x") + side);
                    assert!(left >= -BESIDE && right <= room + BESIDE, "{place}: {words} is cut");
                    ends.push((number(head, "y"), [left, right], words));
                }
                ends.sort_by(|one, other| (one.0, one.1[0]).partial_cmp(&(other.0, other.1[0])).unwrap());
                for pair in ends.windows(2) {
                    let is_apart = pair[0].0 != pair[1].0 || pair[0].1[1] <= pair[1].1[0];
                    assert!(is_apart, "{place}: {} and {} collide", pair[0].2, pair[1].2);
                }
            }
            count += 1;
        }
        assert!(count >= 20, "{count} charts");
    }
}
