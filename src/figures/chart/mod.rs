//! Charts of studies: curves, dots and maps over two axes, in panels side by side.

mod draw;
mod swatch;
mod tick;

pub use draw::{DrawError, png, svg};

/// One picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    /// Line above all panels.
    pub title: String,
    /// Panels, row by row, two in a row.
    pub panels: Vec<Panel>,
}

/// One pair of axes. Names of series stand once below the chart: series of one name and mark in several panels are one.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// Line above the panel.
    pub title: String,
    /// Axis across.
    pub x: Axis,
    /// Axis upward.
    pub y: Axis,
    /// Series of the panel, the last on top. Points that are not finite are left out. Marks beyond the range of an axis, and marks not
    /// above zero on a logarithmic one, are drawn as triangles at its edge, a row for each series. The title shows their number, and the
    /// legend explains them. Lines are cut off at the edge, and end at such zeros.
    pub series: Vec<Series>,
}

/// An axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Name, with the unit in parentheses.
    pub name: String,
    /// Whether powers of ten are evenly apart.
    pub is_logarithmic: bool,
    /// Least and greatest value; `None`: those of the series.
    pub range: Option<[f64; 2]>,
    /// Words at 1, 2, ... in place of numbers; empty: numbers.
    pub words: Vec<String>,
}

/// Points that belong together.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Name in the legend; empty: not in the legend.
    pub name: String,
    /// Points, in the order in which a line joins them.
    pub points: Vec<(f64, f64)>,
    /// Style of the series.
    pub mark: Mark,
    /// Colour.
    pub color: Color,
}

/// Style of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// A line.
    Line,
    /// A dashed line.
    Dashed,
    /// A line with a filled mark at each point, of a shape that goes with the colour.
    MarkedLine,
    /// A dashed line with an open mark at each point, of a shape that goes with the colour.
    MarkedDashes,
    /// The marks of [`Mark::MarkedLine`] alone.
    Marks,
    /// A wide ring about each point, which marks one among others.
    Rings,
    /// A thin line: an interval.
    Whisker,
    /// Squares as wide as this many parts of a thousand of the panel: the cells of a map.
    Cells(u32),
}

/// A value with the ends of its interval, which are not finite without an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl From<f64> for Estimate {
    fn from(value: f64) -> Self {
        Self { value, low: f64::NAN, high: f64::NAN }
    }
}

impl Series {
    /// Creates a series without points.
    pub fn new(name: String, mark: Mark, color: Color) -> Self {
        Self { name, points: Vec::new(), mark, color }
    }

    /// Draws this series through estimates, on top of the intervals of both coordinates.
    pub fn through(self, estimates: &[(Estimate, Estimate)]) -> Vec<Self> {
        let whiskers = estimates
            .iter()
            .flat_map(|(x, y)| [[(x.low, y.value), (x.high, y.value)], [(x.value, y.low), (x.value, y.high)]]);
        let is_known = |ends: &[(f64, f64); 2]| {
            ends.iter().all(|(x, y)| x.is_finite() && y.is_finite()) && ends.first() != ends.last()
        };
        let whisker =
            |ends: [(f64, f64); 2]| Self { name: String::new(), points: ends.into(), mark: Mark::Whisker, ..self };
        let mut all: Vec<Self> = whiskers.filter(is_known).map(whisker).collect();
        let points = estimates.iter().map(|(x, y)| (x.value, y.value)).collect();
        all.push(Self { points, ..self });
        all
    }
}

/// Colours that colour-blind readers can distinguish, the most different first.
///
/// # Source
/// Okabe, Ito, *Color Universal Design* (2008); wine and olive are those of Tol, *Colour Schemes* (2021).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Color {
    /// Black.
    Black,
    /// Blue.
    Blue,
    /// Vermilion.
    Vermilion,
    /// Bluish green.
    Green,
    /// Reddish purple.
    Purple,
    /// Orange.
    Orange,
    /// Sky blue.
    Sky,
    /// Wine red, beyond the seven of lines.
    Wine,
    /// Olive, beyond the seven of lines.
    Olive,
    /// Grey, beyond the seven of lines.
    Gray,
    /// Light grey, for what lies behind.
    Pale,
}

impl Color {
    /// The colours of lines, to be taken in turn.
    pub const LINES: [Self; 7] =
        [Self::Blue, Self::Vermilion, Self::Green, Self::Purple, Self::Orange, Self::Sky, Self::Black];
}

impl Axis {
    /// Creates an axis with even steps over the range of the series.
    pub fn linear(name: &str) -> Self {
        Self { name: name.to_owned(), is_logarithmic: false, range: None, words: Vec::new() }
    }

    /// Creates an axis with a word at each of 1, 2, ...
    pub fn of_words(name: &str, words: Vec<String>) -> Self {
        let range = Some([0.5, words.len() as f64 + 0.5]);
        Self { range, words, ..Self::linear(name) }
    }

    /// Creates an axis with powers of ten over the range of the series.
    pub fn logarithmic(name: &str) -> Self {
        Self { is_logarithmic: true, ..Self::linear(name) }
    }

    /// Replaces the range.
    pub fn over(self, low: f64, high: f64) -> Self {
        Self { range: Some([low, high]), ..self }
    }
}
