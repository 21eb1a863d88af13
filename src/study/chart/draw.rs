//! Charts drawn with the plots of the plotting crate, as SVG and PNG.

use kuva::RasterBackend;
use kuva::backend::svg::SvgBackend;
use kuva::plot::legend::{LegendEntry, LegendShape};
use kuva::plot::line::{LinePlot, LineStyle};
use kuva::plot::scatter::{MarkerShape, ScatterPlot};
use kuva::render::figure::{Figure, FigureLegendPosition};
use kuva::render::layout::Layout;
use kuva::render::plots::Plot;
use kuva::render::render::Scene;
use thiserror::Error;

use super::{Axis, Chart, Color, Mark, Panel, Series};

/// Size of a panel in pixels of the SVG.
const PANEL: (f64, f64) = (520.0, 400.0);
/// Part of a panel's width that lies within its axes, about.
const WITHIN: f64 = 0.82;
/// Pixels of the PNG for each of the SVG.
const PICTURE_SCALE: f32 = 2.0;

/// Why a chart could not be drawn.
#[derive(Debug, Error)]
pub enum DrawError {
    /// The encoder of pictures failed.
    #[error("the chart cannot be written as PNG: {0}")]
    Encode(String),
}

/// A chart as an SVG document.
pub fn svg(chart: &Chart) -> String {
    SvgBackend::new().render_scene(&scene(chart))
}

/// A chart as a PNG picture.
///
/// # Errors
/// If the encoder fails.
pub fn png(chart: &Chart) -> Result<Vec<u8>, DrawError> {
    RasterBackend::new().with_scale(PICTURE_SCALE).render_scene(&scene(chart)).map_err(DrawError::Encode)
}

fn scene(chart: &Chart) -> Scene {
    let columns = chart.columns.clamp(1, chart.panels.len().max(1));
    let rows = chart.panels.len().div_ceil(columns);
    let plots: Vec<Vec<Plot>> = chart.panels.iter().map(plots).collect();
    let layouts = chart.panels.iter().map(layout).collect();
    let mut figure = Figure::new(rows, columns)
        .with_title(&chart.title)
        .with_title_size(16)
        .with_cell_size(PANEL.0, PANEL.1)
        .with_plots(plots)
        .with_layouts(layouts);
    let entries = legend(chart);
    if !entries.is_empty() {
        figure = figure.with_shared_legend_position(FigureLegendPosition::Right).with_shared_legend_entries(entries);
    }
    figure.render()
}

/// One entry for each name, as it is drawn first.
fn legend(chart: &Chart) -> Vec<LegendEntry> {
    let mut entries: Vec<LegendEntry> = Vec::new();
    for series in chart.panels.iter().flat_map(|panel| &panel.series) {
        if series.name.is_empty() || entries.iter().any(|entry| entry.label == series.name) {
            continue;
        }
        entries.push(LegendEntry {
            label: series.name.clone(),
            color: code(series.color).to_owned(),
            shape: match series.mark {
                Mark::Line | Mark::Dashed | Mark::DottedLine => LegendShape::Line,
                Mark::Dots => LegendShape::Circle,
                Mark::Crosses => LegendShape::Marker(MarkerShape::Cross),
                Mark::Cells(_) => LegendShape::Rect,
            },
            dasharray: if series.mark == Mark::Dashed { LineStyle::Dashed.dasharray() } else { None },
        });
    }
    entries
}

fn layout(panel: &Panel) -> Layout {
    let [x, y] = [(&panel.x, 0), (&panel.y, 1)].map(|(axis, which)| range(axis, panel, which));
    let mut layout = Layout::new(x, y)
        .with_title(&panel.title)
        .with_title_size(13)
        .with_x_label(&panel.x.name)
        .with_y_label(&panel.y.name)
        .with_label_size(13)
        .with_tick_size(11)
        .with_clamp_axis()
        .with_box_axes();
    if panel.x.is_logarithmic {
        layout = layout.with_log_x();
    }
    if panel.y.is_logarithmic {
        layout = layout.with_log_y();
    }
    layout
}

/// Range of an axis: as given, or that of what is drawn with a twentieth of it on both sides.
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
            let factor = (high / low).powf(0.05);
            (low / factor, high * factor)
        }
        (true, false) => (low - 0.05 * (high - low), high + 0.05 * (high - low)),
        (false, true) if low.is_finite() => (0.5 * low, 2.0 * low),
        (false, false) if low.is_finite() => (low - 0.5, low + 0.5),
        (false, true) => (0.1, 1.0),
        (false, false) => (0.0, 1.0),
    }
}

/// The points that have a place on the axes.
fn drawn(panel: &Panel, series: &Series) -> Vec<(f64, f64)> {
    let has_place = |value: f64, axis: &Axis| {
        let is_within = axis.range.is_none_or(|[low, high]| (low..=high).contains(&value));
        value.is_finite() && is_within && (value > 0.0 || !axis.is_logarithmic)
    };
    series.points.iter().copied().filter(|&(x, y)| has_place(x, &panel.x) && has_place(y, &panel.y)).collect()
}

fn plots(panel: &Panel) -> Vec<Plot> {
    let mut plots = Vec::new();
    for series in &panel.series {
        let points = drawn(panel, series);
        let color = code(series.color);
        if points.is_empty() {
            continue;
        }
        let line = |style| {
            LinePlot::new().with_data(points.clone()).with_color(color).with_stroke_width(1.8).with_line_style(style)
        };
        let dots = |marker, size| {
            ScatterPlot::new().with_data(points.clone()).with_color(color).with_marker(marker).with_size(size)
        };
        match series.mark {
            Mark::Line => plots.push(line(LineStyle::Solid).into()),
            Mark::Dashed => plots.push(line(LineStyle::Dashed).into()),
            Mark::DottedLine => {
                plots.push(line(LineStyle::Solid).into());
                plots.push(dots(MarkerShape::Circle, 3.5).into());
            }
            Mark::Dots => plots.push(dots(MarkerShape::Circle, 3.5).into()),
            Mark::Crosses => plots.push(dots(MarkerShape::Cross, 4.0).into()),
            Mark::Cells(width) => {
                let half = 0.5 * f64::from(width) / 1000.0 * WITHIN * PANEL.0;
                plots.push(dots(MarkerShape::Square, half).into());
            }
        }
    }
    plots
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
        Color::Pale => "#d9d9d9",
    }
}

#[cfg(test)]
mod tests {
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
                series("measured", Mark::DottedLine, Color::Blue, 1.0),
                series("theory", Mark::Dashed, Color::Black, 1.2),
                series("", Mark::Dots, Color::Vermilion, -1.0),
            ],
        };
        let panels = vec![
            panel("left", Axis::linear("error (um)")),
            panel("right", Axis::logarithmic("error (um)").over(1.0, 1000.0)),
        ];
        Chart { title: "A chart".to_owned(), panels, columns: 2 }
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
}
