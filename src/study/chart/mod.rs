//! Charts of studies: curves, dots and maps over two axes, in panels side by side.

#[cfg(feature = "figures")]
mod draw;

#[cfg(feature = "figures")]
pub use draw::{DrawError, png, svg};

/// One picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    /// Line above all panels.
    pub title: String,
    /// Panels, row by row.
    pub panels: Vec<Panel>,
    /// Panels in a row, at least 1.
    pub columns: usize,
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
    /// What is drawn, the last on top. Points that are not finite are left out. Marks beyond the range of an axis, and those not
    /// above zero on a logarithmic one, are drawn as triangles at its edge, and the title says how many; lines are cut off.
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
    /// What stands at 1, 2, ... in place of numbers; empty: numbers. Across only.
    pub words: Vec<String>,
}

/// Points that belong together.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// What the legend says; empty: not in the legend.
    pub name: String,
    /// Points, in the order in which a line joins them.
    pub points: Vec<(f64, f64)>,
    /// How they are drawn.
    pub mark: Mark,
    /// Colour.
    pub color: Color,
}

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// A line.
    Line,
    /// A dashed line.
    Dashed,
    /// A line with a mark at each point, of a shape that goes with the colour.
    MarkedLine,
    /// A dashed line with a mark at each point, of another shape that goes with the colour.
    MarkedDashes,
    /// The marks of [`Mark::MarkedLine`] alone.
    Marks,
    /// Squares as wide as this many parts of a thousand of the panel: the cells of a map.
    Cells(u32),
}

/// Colours that the colour-blind can tell apart, the most different first.
///
/// # Source
/// Okabe, Ito, *Color Universal Design* (2008).
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
    /// Light grey, for what lies behind.
    Pale,
}

impl Color {
    /// The colours of lines, to be taken in turn.
    pub const LINES: [Self; 7] =
        [Self::Blue, Self::Vermilion, Self::Green, Self::Purple, Self::Orange, Self::Sky, Self::Black];
}

impl Axis {
    /// With even steps over the range of the series.
    pub fn linear(name: &str) -> Self {
        Self { name: name.to_owned(), is_logarithmic: false, range: None, words: Vec::new() }
    }

    /// With a word at each of 1, 2, ...
    pub fn of_words(name: &str, words: Vec<String>) -> Self {
        let range = Some([0.5, words.len() as f64 + 0.5]);
        Self { range, words, ..Self::linear(name) }
    }

    /// With powers of ten over the range of the series.
    pub fn logarithmic(name: &str) -> Self {
        Self { is_logarithmic: true, ..Self::linear(name) }
    }

    /// The same over another range.
    pub fn over(self, low: f64, high: f64) -> Self {
        Self { range: Some([low, high]), ..self }
    }
}
