//! The line of samples with their names above a figure.

use super::curve::Point;
use super::marks::{self, Mark};
use super::page::{Anchor, LETTER, Page, Stroke};

/// Length of a line's sample: four dashes of the proxy and the gaps between them.
const SAMPLE: f64 = 80.0;
/// Mean width of a letter, in parts of its height, by the font's own tables.
const LETTER_WIDTH: f64 = 0.54;
/// Room between a sample and its name, and behind a name.
const GAP: f64 = 14.0;
const BEHIND: f64 = 36.0;
/// Distance of the base lines of two rows.
const ROW: f64 = 42.0;

/// Picture beside a name of the legend.
#[derive(Clone, Debug)]
pub(super) enum Sample {
    /// Lines on top of one another.
    Lines(Vec<Stroke>),
    /// Lines with the strokes that mark a forbidden side.
    Hatched(Vec<Stroke>),
    /// An arrow of this length.
    Arrow(f64, Stroke),
    /// A mark at a place.
    Mark(Mark),
}

/// One sample with its name.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    pub sample: Sample,
    pub name: String,
}

impl Entry {
    pub(super) fn new(sample: Sample, name: impl Into<String>) -> Self {
        Self { sample, name: name.into() }
    }

    pub(super) fn mark(mark: Mark) -> Self {
        Self::new(Sample::Mark(mark), mark.name())
    }

    fn sample_width(&self) -> f64 {
        match self.sample {
            Sample::Arrow(length, _) => length,
            Sample::Mark(mark) => 2.0 * mark.size(),
            _ => SAMPLE,
        }
    }

    fn width(&self) -> f64 {
        self.sample_width() + GAP + text_width(&self.name) + BEHIND
    }
}

/// Returns the approximate width of a text.
pub(super) fn text_width(text: &str) -> f64 {
    LETTER_WIDTH * f64::from(LETTER) * text.chars().count() as f64
}

/// Returns a text in letters of this height that is no wider than there is room for.
pub(super) fn shortened(text: &str, room: f64, height: f64) -> String {
    let most = (room / (LETTER_WIDTH * height)) as usize;
    match text.chars().count() > most {
        true => text.chars().take(most.saturating_sub(1)).chain(['\u{2026}']).collect(),
        false => text.to_owned(),
    }
}

/// Adds entries, each name once.
pub(super) fn add(entries: &mut Vec<Entry>, new: impl IntoIterator<Item = Entry>) {
    for entry in new {
        if entries.iter().all(|known| known.name != entry.name) {
            entries.push(entry);
        }
    }
}

/// Returns the height of a legend beyond its first row.
pub(super) fn further_height(entries: &[Entry], room: f64) -> f64 {
    places(entries, room).last().map_or(0.0, |(_, row)| ROW * *row as f64)
}

/// Returns the distance from the left, and row, of each entry.
fn places(entries: &[Entry], room: f64) -> Vec<(f64, usize)> {
    let (mut left, mut row) = (0.0, 0);
    let place = |entry: &Entry| {
        // What stands behind a name may stand over the edge.
        if left > 0.0 && left + entry.width() - BEHIND > room {
            (left, row) = (0.0, row + 1);
        }
        let place = (left, row);
        left += entry.width();
        place
    };
    entries.iter().map(place).collect()
}

/// Draws the entries from a point on, to the right, in as many rows as they need.
pub(super) fn draw(page: &mut Page, (left, y): Point, room: f64, entries: &[Entry]) {
    for (entry, (offset, row)) in entries.iter().zip(places(entries, room)) {
        let (x, y) = (left + offset, y + ROW * row as f64);
        let (middle, width) = (y - 9.0, entry.sample_width());
        let line = [(x, middle), (x + width, middle)];
        match &entry.sample {
            Sample::Lines(strokes) => strokes.iter().for_each(|stroke| page.chain(&line, *stroke)),
            Sample::Hatched(strokes) => {
                strokes.iter().for_each(|stroke| page.chain(&line, *stroke));
                marks::hatch(page, &line);
            }
            Sample::Arrow(_, stroke) => page.arrow(line[0], line[1], stroke.color, stroke.width),
            Sample::Mark(mark) => mark.draw(page, (x + width / 2.0, middle), None),
        }
        page.text((x + width + GAP, y), Anchor::Start, &entry.name);
    }
}
