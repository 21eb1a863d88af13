//! The legend: one entry for each name, with a sample of its line and its mark.

use kuva::plot::legend::{LegendEntry, LegendShape};
use kuva::plot::scatter::MarkerShape;
use kuva::render::render::{PathData, Primitive, Scene, TextAnchor};

use yieldwall_motion::elementary;

use super::draw::{DASHES, LINE, OPEN, WHITE, beyond_values, code, drawn, edge_words, is_open, ringed, shape};
use super::{Chart, Color, Mark, Series};

/// Half the width of a mark and the radius of a ring, in pixels of the SVG.
const MARK: f64 = 4.0;
const RING: f64 = 5.5;
/// Half the length of the line in a sample, and the distance from the middle at which it begins beside a mark, in pixels of the SVG.
const REACH: f64 = 10.0;
const BESIDE_MARK: f64 = 6.5;
/// Middle of a sample, from the end that the plotting crate gives it.
const MIDDLE: f64 = 5.0;

/// An entry, as the plotting crate has it, and the series whose sample replaces its line.
pub(super) struct Entry<'a> {
    entry: LegendEntry,
    series: Option<&'a Series>,
}

/// Returns one entry for each name of which something is drawn, as it is drawn first, and the meaning of triangles if there are any.
pub(super) fn legend(chart: &Chart) -> Vec<Entry<'_>> {
    let mut entries: Vec<Entry<'_>> = Vec::new();
    let all = chart.panels.iter().flat_map(|panel| panel.series.iter().map(move |series| (panel, series)));
    for (panel, series) in all {
        let is_seen = [drawn, beyond_values, ringed].iter().any(|points| !points(panel, series).is_empty());
        if series.name.is_empty() || !is_seen || entries.iter().any(|known| known.entry.label == series.name) {
            continue;
        }
        let is_cell = matches!(series.mark, Mark::Cells(_));
        let entry = LegendEntry {
            label: series.name.clone(),
            color: code(series.color).to_owned(),
            shape: if is_cell { LegendShape::Rect } else { LegendShape::Line },
            dasharray: None,
        };
        entries.push(Entry { entry, series: (!is_cell).then_some(series) });
    }
    if let Some(words) = edge_words(&chart.panels) {
        let entry = LegendEntry {
            label: format!("triangle: {words}"),
            color: code(Color::Black).to_owned(),
            shape: LegendShape::Marker(MarkerShape::TriangleDown),
            dasharray: None,
        };
        entries.push(Entry { entry, series: None });
    }
    entries
}

/// Returns the entries for the plotting crate.
pub(super) fn entries(legend: &[Entry<'_>]) -> Vec<LegendEntry> {
    legend.iter().map(|entry| entry.entry.clone()).collect()
}

/// Puts the sample of each series in place of the line behind its name. The plotting crate knows neither open marks nor marks on a line.
pub(super) fn put_samples(scene: &mut Scene, legend: &[Entry<'_>]) {
    for Entry { entry, series } in legend {
        let Some(series) = series else { continue };
        let is_name = |primitive: &Primitive| match primitive {
            Primitive::Text { content, anchor: TextAnchor::Start, .. } => *content == entry.label,
            _ => false,
        };
        let line = scene.elements.iter().rposition(is_name).map_or(usize::MAX, |name| name + 1);
        if let Some(&Primitive::Line { x1, y1, .. }) = scene.elements.get(line) {
            scene.elements.splice(line..=line, sample(series, (x1 + MIDDLE, y1)));
        }
    }
}

fn sample(series: &Series, middle: (f64, f64)) -> Vec<Primitive> {
    let color = code(series.color);
    let line = |from: f64, to: f64, dashes: Option<&str>| Primitive::Line {
        x1: middle.0 + from,
        y1: middle.1,
        x2: middle.0 + to,
        y2: middle.1,
        stroke: color.into(),
        stroke_width: LINE,
        stroke_dasharray: dashes.map(str::to_owned),
    };
    let mut all = match series.mark {
        Mark::Line | Mark::Whisker | Mark::MarkedLine => vec![line(-REACH, REACH, None)],
        Mark::Dashed => vec![line(-REACH, REACH, Some(DASHES))],
        Mark::MarkedDashes => vec![line(-REACH, -BESIDE_MARK, None), line(BESIDE_MARK, REACH, None)],
        Mark::Marks | Mark::Rings | Mark::Cells(_) => Vec::new(),
    };
    match series.mark {
        Mark::MarkedLine | Mark::MarkedDashes | Mark::Marks => {
            all.extend(marker(shape(series), middle, MARK, color));
            if is_open(series) {
                all.extend(marker(shape(series), middle, OPEN * MARK, WHITE));
            }
        }
        Mark::Rings => all.push(Primitive::Circle {
            cx: middle.0,
            cy: middle.1,
            r: RING,
            fill: "none".into(),
            fill_opacity: None,
            stroke: Some(color.into()),
            stroke_width: Some(LINE),
        }),
        Mark::Line | Mark::Dashed | Mark::Whisker | Mark::Cells(_) => {}
    }
    all
}

/// Returns a mark, in the sizes that the plotting crate gives its shapes.
fn marker(shape: MarkerShape, (x, y): (f64, f64), size: f64, color: &str) -> Vec<Primitive> {
    // Corners at even angles, the first one above; of a star every second one is within.
    let corners = |count: u32, outer: f64, inner: f64, turn: f64| {
        let at = |corner: u32| {
            let angle = std::f64::consts::TAU * (f64::from(corner) / f64::from(count) + turn);
            let radius = size * if corner.is_multiple_of(2) { outer } else { inner };
            let (sin, cos) = elementary::sin_cos(angle);
            format!("{:.2},{:.2}", x + radius * sin, y - radius * cos)
        };
        let path = (0..count).map(at).collect::<Vec<_>>().join(" L");
        vec![Primitive::Path(Box::new(PathData {
            d: format!("M{path} Z"),
            fill: Some(color.into()),
            stroke: color.into(),
            stroke_width: 0.5,
            opacity: None,
            stroke_dasharray: None,
        }))]
    };
    let stroke = |way: [f64; 2]| Primitive::Line {
        x1: x - size * way[0],
        y1: y - size * way[1],
        x2: x + size * way[0],
        y2: y + size * way[1],
        stroke: color.into(),
        stroke_width: 1.5,
        stroke_dasharray: None,
    };
    match shape {
        MarkerShape::Circle => vec![Primitive::Circle {
            cx: x,
            cy: y,
            r: size,
            fill: color.into(),
            fill_opacity: None,
            stroke: None,
            stroke_width: None,
        }],
        MarkerShape::Square => corners(4, std::f64::consts::SQRT_2, std::f64::consts::SQRT_2, 0.125),
        MarkerShape::Triangle => corners(3, 1.15, 1.15, 0.0),
        MarkerShape::TriangleDown => corners(3, 1.15, 1.15, 0.5),
        MarkerShape::Diamond => corners(4, 1.3, 1.3, 0.0),
        MarkerShape::Star => corners(10, 1.25, 0.5, 0.0),
        MarkerShape::Pentagon => corners(5, 1.2, 1.2, 0.0),
        MarkerShape::Hexagon => corners(6, 1.15, 1.15, 0.0),
        MarkerShape::Cross => vec![stroke([0.9, 0.9]), stroke([0.9, -0.9])],
        MarkerShape::Plus => vec![stroke([0.9, 0.0]), stroke([0.0, 0.9])],
    }
}
