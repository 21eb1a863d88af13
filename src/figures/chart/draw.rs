//! Charts drawn with the plots of the plotting crate, as SVG and PNG.

use std::sync::Arc;
use yieldwall_motion::elementary;

use kuva::RasterBackend;
use kuva::backend::svg::SvgBackend;
use kuva::plot::legend::{LegendEntry, LegendShape};
use kuva::plot::line::{LinePlot, LineStyle};
use kuva::plot::scatter::{MarkerShape, ScatterPlot};
use kuva::render::figure::{Figure, FigureLegendPosition};
use kuva::render::layout::{Layout, TickFormat};
use kuva::render::plots::Plot;
use kuva::render::render::Scene;
use thiserror::Error;

use super::{Axis, Chart, Color, Mark, Panel, Series};

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
const LINE: f64 = 1.8;
const WHISKER: f64 = 1.0;
/// By how much a mark is larger than that of the next series, so that its rim is seen where both stand in one place.
const RIM: f64 = 0.08;
/// How far within the frame marks stand that lie beyond it, as a share of the axis, and how much farther those of the next series.
const EDGE: f64 = 0.015;
const NEXT_EDGE: f64 = 0.03;
/// Between these a logarithmic axis has decimals at its ticks.
const LEAST_PLAIN: f64 = 0.001;
const MOST_PLAIN: f64 = 100_000.0;
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
    let entries = legend(chart);
    if !entries.is_empty() {
        figure = figure.with_shared_legend_position(FigureLegendPosition::Bottom).with_shared_legend_entries(entries);
    }
    figure.render()
}

/// Returns one entry for each name of which something is drawn, as it is drawn first.
fn legend(chart: &Chart) -> Vec<LegendEntry> {
    let mut entries: Vec<LegendEntry> = Vec::new();
    let all = chart.panels.iter().flat_map(|panel| panel.series.iter().map(move |series| (panel, series)));
    for (panel, series) in all {
        let is_seen = !drawn(panel, series).is_empty() || !beyond_values(panel, series).is_empty();
        if series.name.is_empty() || !is_seen || entries.iter().any(|entry| entry.label == series.name) {
            continue;
        }
        entries.push(LegendEntry {
            label: series.name.clone(),
            color: code(series.color).to_owned(),
            shape: match series.mark {
                Mark::Line | Mark::Dashed | Mark::Whisker => LegendShape::Line,
                Mark::MarkedLine | Mark::MarkedDashes | Mark::Marks => LegendShape::Marker(shape(series)),
                Mark::Rings => LegendShape::Marker(MarkerShape::Circle),
                Mark::Cells(_) => LegendShape::Rect,
            },
            dasharray: if series.mark == Mark::Dashed { LineStyle::Dashed.dasharray() } else { None },
        });
    }
    entries
}

fn layout(panel: &Panel) -> Layout {
    let [x, y] = [(&panel.x, 0), (&panel.y, 1)].map(|(axis, which)| range(axis, panel, which));
    let beyond = panel.series.iter().map(|series| beyond_values(panel, series).len()).sum::<usize>();
    let title = match beyond {
        0 => panel.title.clone(),
        _ => format!("{} ({beyond} {})", panel.title, edge_words(panel)),
    };
    let mut layout = Layout::new(x, y)
        .with_title(&title)
        .with_title_size(fitting(&title, PANEL.0, LABEL))
        .with_x_label(&panel.x.name)
        .with_y_label(&panel.y.name)
        .with_label_size(fitting(&panel.x.name, PANEL.0, LABEL).min(fitting(&panel.y.name, PANEL.1, LABEL)))
        .with_tick_size(LEAST_LETTERS)
        .with_clamp_axis()
        .with_box_axes();
    if !panel.x.words.is_empty() {
        layout = layout.with_x_categories(panel.x.words.clone());
    }
    if panel.x.is_logarithmic {
        layout = layout.with_log_x().with_x_tick_format(powers(x));
    }
    if panel.y.is_logarithmic {
        layout = layout.with_log_y().with_y_tick_format(powers(y));
    }
    if panel.x.range.is_some() {
        layout = layout.with_x_axis_min(x.0).with_x_axis_max(x.1);
    }
    if panel.y.range.is_some() {
        layout = layout.with_y_axis_min(y.0).with_y_axis_max(y.1);
    }
    layout
}

/// Returns the words for the place of points that do not fit on the axes.
fn edge_words(panel: &Panel) -> &'static str {
    let all = || panel.series.iter().flat_map(|series| beyond_values(panel, series));
    let is_below_powers = |(x, y): (f64, f64)| {
        [(x, &panel.x), (y, &panel.y)].into_iter().any(|(value, axis)| axis.is_logarithmic && value <= 0.0)
    };
    match (all().any(is_below_powers), all().all(is_below_powers)) {
        (true, true) => "at zero",
        (true, false) => "at zero or beyond",
        (false, _) => "beyond",
    }
}

/// Returns the size of letters in which a text takes no more than so many pixels: `most`, or as small as it has to be.
fn fitting(text: &str, pixels: f64, most: u32) -> u32 {
    let letters = text.chars().count().max(1) as f64;
    ((pixels / (LETTER_WIDTH * letters)) as u32).clamp(LEAST_LETTERS, most)
}

/// Returns how a logarithmic axis names its ticks: all as decimals, or, where those are long, all as powers.
fn powers((low, high): (f64, f64)) -> TickFormat {
    let is_plain = low >= LEAST_PLAIN && high <= MOST_PLAIN;
    TickFormat::Custom(Arc::new(move |value| tick(value, is_plain)))
}

fn tick(value: f64, is_plain: bool) -> String {
    // A tick is one digit times a power of ten, but for rounding.
    let exact = format!("{value:.0e}");
    if is_plain { exact.parse::<f64>().map_or_else(|_| exact.clone(), |value| value.to_string()) } else { exact }
}

/// Returns the range of an axis: as given, or that of what is drawn with a twentieth of it on both sides.
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
            (low / factor, high * factor)
        }
        (true, false) => (low - 0.05 * (high - low), high + 0.05 * (high - low)),
        (false, true) if low.is_finite() => (0.5 * low, 2.0 * low),
        (false, false) if low.is_finite() => (low - 0.5, low + 0.5),
        (false, true) => (0.1, 1.0),
        (false, false) => (0.0, 1.0),
    }
}

/// Returns the points of a line: those that every axis can show, within its range or beyond.
fn drawable(panel: &Panel, series: &Series) -> Vec<(f64, f64)> {
    let has_place = |value: f64, axis: &Axis| value.is_finite() && (value > 0.0 || !axis.is_logarithmic);
    series.points.iter().copied().filter(|&(x, y)| has_place(x, &panel.x) && has_place(y, &panel.y)).collect()
}

fn is_within(panel: &Panel, (x, y): (f64, f64)) -> bool {
    let holds = |value: f64, axis: &Axis| {
        (value > 0.0 || !axis.is_logarithmic) && axis.range.is_none_or(|[low, high]| (low..=high).contains(&value))
    };
    holds(x, &panel.x) && holds(y, &panel.y)
}

/// Returns the points that have a place on the axes.
fn drawn(panel: &Panel, series: &Series) -> Vec<(f64, f64)> {
    drawable(panel, series).into_iter().filter(|&point| is_within(panel, point)).collect()
}

/// Returns the values of the marks that have none. A line alone has no marks.
fn beyond_values(panel: &Panel, series: &Series) -> Vec<(f64, f64)> {
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
    let inward = EDGE + NEXT_EDGE * row as f64;
    let [of_x, of_y] = [(&panel.x, 0), (&panel.y, 1)].map(|(axis, which)| (axis, range(axis, panel, which)));
    let at = |(x, y): (f64, f64)| (edge(x, of_x.0, of_x.1, EDGE), edge(y, of_y.0, of_y.1, inward));
    values.into_iter().map(|point| (at(point), point.1 < at(point).1)).collect()
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
    for series in &panel.series {
        under = under.saturating_sub(usize::from(!series.name.is_empty()));
        let mark = MARK * (1.0 + RIM * under as f64);
        let (points, all) = (drawn(panel, series), drawable(panel, series));
        let color = code(series.color);
        // What lies beyond the axes is cut off at their frame.
        let line = |style| {
            LinePlot::new().with_data(all.clone()).with_color(color).with_stroke_width(LINE).with_line_style(style)
        };
        let marks = |points: Vec<(f64, f64)>, marker, size| {
            ScatterPlot::new().with_data(points).with_color(color).with_marker(marker).with_size(size)
        };
        match series.mark {
            _ if all.is_empty() => {}
            Mark::Line | Mark::MarkedLine => plots.push(line(LineStyle::Solid).into()),
            Mark::Dashed | Mark::MarkedDashes => plots.push(line(LineStyle::Dashed).into()),
            Mark::Whisker => {
                let ends = series.points.iter().filter(|(x, y)| x.is_finite() && y.is_finite());
                let [of_x, of_y] = [(&panel.x, 0), (&panel.y, 1)].map(|(axis, which)| range(axis, panel, which));
                // An end beyond the frame is drawn at it.
                let ends: Vec<_> = ends.map(|&(x, y)| (x.clamp(of_x.0, of_x.1), y.clamp(of_y.0, of_y.1))).collect();
                plots.push(LinePlot::new().with_data(ends).with_color(color).with_stroke_width(WHISKER).into());
            }
            Mark::Marks | Mark::Rings | Mark::Cells(_) => {}
        }
        match series.mark {
            _ if points.is_empty() => {}
            Mark::Line | Mark::Dashed | Mark::Whisker => {}
            Mark::MarkedLine | Mark::MarkedDashes | Mark::Marks => {
                plots.push(marks(points, shape(series), mark).into());
            }
            Mark::Rings => {
                let rings = marks(points, MarkerShape::Circle, RING).with_marker_opacity(0.0);
                plots.push(rings.with_marker_stroke_width(LINE).into());
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

/// Returns the shape of a series' marks. Triangles are those of points beyond the edge.
fn shape(series: &Series) -> MarkerShape {
    let (on_line, on_dashes) = match series.color {
        Color::Blue => (MarkerShape::Circle, MarkerShape::Cross),
        Color::Vermilion => (MarkerShape::Square, MarkerShape::Plus),
        Color::Green => (MarkerShape::Diamond, MarkerShape::Star),
        Color::Purple => (MarkerShape::Star, MarkerShape::Hexagon),
        Color::Orange => (MarkerShape::Pentagon, MarkerShape::Diamond),
        Color::Sky => (MarkerShape::Hexagon, MarkerShape::Cross),
        Color::Black => (MarkerShape::Plus, MarkerShape::Square),
        Color::Wine => (MarkerShape::Diamond, MarkerShape::Hexagon),
        Color::Olive => (MarkerShape::Circle, MarkerShape::Plus),
        Color::Gray => (MarkerShape::Square, MarkerShape::Star),
        Color::Pale => (MarkerShape::Circle, MarkerShape::Cross),
    };
    if series.mark == Mark::MarkedDashes { on_dashes } else { on_line }
}

fn code(color: Color) -> &'static str {
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
        assert!(svg(&chart).contains("left (5 beyond)"));
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
        assert_eq!(legend(&chart).len(), 1);
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
        let names: Vec<_> = legend(&chart).into_iter().map(|entry| entry.label).collect();
        assert_eq!(names, ["cells", "measured"], "the theory has no point");
        // Two of `measured`, and the twenty negative ones of the marks.
        assert!(svg(&chart).contains("left (22 at zero)"), "{}", svg(&chart));
        let counts = plots(panel).len();
        chart.panels[0].series[1].points.clear();
        assert!(plots(&chart.panels[0]).len() < counts, "triangles");
    }

    #[test]
    fn the_ticks_of_an_axis_are_of_one_kind() {
        let names = |low: f64, high: f64, ticks: &[f64]| {
            let TickFormat::Custom(name) = powers((low, high)) else { panic!("numbers alone") };
            ticks.iter().map(|&tick| name(tick)).collect::<Vec<_>>()
        };
        assert_eq!(names(0.001, 10.0, &[0.001, 0.02, 0.5, 10.0]), ["0.001", "0.02", "0.5", "10"]);
        assert_eq!(names(1e-4, 10.0, &[1e-4, 0.02, 1.0, 10.0]), ["1e-4", "2e-2", "1e0", "1e1"]);
        assert_eq!(names(0.01, 1.0, &[3.0 * 0.1]), ["0.3"]);
    }
}
