//! Marks: the forbidden side of a wall, begin and end of a run, places where a surface gave way, and faults.

use super::curve::{Frame, Point};
use super::page::{BLACK, Color, GREY, Page, Stroke, WHITE};
use yieldwall_motion::elementary;

/// The strokes on the forbidden side of a wall: thinner than its line, 1.6 mm long, 2.2 mm apart.
const HATCH: Stroke = Stroke { color: GREY, width: 1.5, dash: &[] };
const HATCH_LENGTH: f64 = 16.0;
const HATCH_SPACING: f64 = 22.0;
/// Line of all marks.
const LINE: Stroke = Stroke { color: BLACK, width: 3.5, dash: &[] };
/// Light orange, which is also light in print without colours.
const ORANGE: Color = Color(0xf5, 0xb0, 0x2e);

/// Mark at a place. The marks differ in shape and lightness, and an end within its own start leaves both to be seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mark {
    /// Ring.
    Start,
    /// Black square.
    End,
    /// Light diamond.
    BreakOut,
    /// Cross.
    Fault,
}

impl Mark {
    /// Half of its width.
    pub(super) fn size(self) -> f64 {
        match self {
            Self::Start => 14.0,
            Self::End => 8.0,
            Self::BreakOut => 15.0,
            Self::Fault => 11.0,
        }
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::End => "end",
            Self::BreakOut => "surface gives way",
            Self::Fault => "fault",
        }
    }

    /// Draws it, filled with a colour if it is not its own.
    pub(super) fn draw(self, page: &mut Page, (x, y): Point, color: Option<Color>) {
        let size = self.size();
        match self {
            Self::Start => page.ring((x, y), size, WHITE, LINE),
            Self::End => {
                let corners = [(x - size, y - size), (x + size, y - size), (x + size, y + size), (x - size, y + size)];
                page.shape(&corners, color.unwrap_or(BLACK), LINE);
            }
            Self::BreakOut => {
                let corners = [(x, y - size), (x + size, y), (x, y + size), (x - size, y)];
                page.shape(&corners, color.unwrap_or(ORANGE), LINE);
            }
            Self::Fault => {
                for down in [1.0, -1.0] {
                    page.chain(&[(x - size, y - down * size), (x + size, y + down * size)], LINE);
                }
            }
        }
    }
}

/// Draws one mark at the places within a frame, each at least its width from the one before, and returns it if there is one.
pub(super) fn draw(
    page: &mut Page,
    frame: Frame,
    mark: Mark,
    color: Option<Color>,
    places: impl Iterator<Item = Point>,
) -> Option<Mark> {
    let mut last: Option<Point> = None;
    for (x, y) in places.filter(|place| frame.contains(*place)) {
        if last.is_none_or(|last| elementary::hypot(x - last.0, y - last.1) >= 2.0 * mark.size()) {
            mark.draw(page, (x, y), color);
            last = Some((x, y));
        }
    }
    last.map(|_| mark)
}

/// Strokes to the right of a way on paper, and backward: the forbidden side of a wall.
pub(super) fn hatch(page: &mut Page, points: &[Point]) {
    for stroke in hatch_strokes(points) {
        page.chain(&stroke, HATCH);
    }
}

/// Returns their ends, first the end on the way.
pub(super) fn hatch_strokes(points: &[Point]) -> impl Iterator<Item = [Point; 2]> + '_ {
    let mut left = HATCH_SPACING / 2.0;
    points.windows(2).flat_map(move |pair| {
        let [(x0, y0), (x1, y1)] = [pair[0], pair[1]];
        let length = elementary::hypot(x1 - x0, y1 - y0);
        let count = if length > left { ((length - left) / HATCH_SPACING).floor() + 1.0 } else { 0.0 };
        let first = left;
        left += count * HATCH_SPACING - length;
        let (along, down) = if length > 0.0 { ((x1 - x0) / length, (y1 - y0) / length) } else { (0.0, 0.0) };
        (0..count as u32).map(move |stroke| {
            let way = first + f64::from(stroke) * HATCH_SPACING;
            let (x, y) = (x0 + along * way, y0 + down * way);
            let reach = HATCH_LENGTH * std::f64::consts::FRAC_1_SQRT_2;
            // On paper y points down, so that the right of (along, down) is (-down, along).
            [(x, y), (x + reach * (-down - along), y + reach * (along - down))]
        })
    })
}
