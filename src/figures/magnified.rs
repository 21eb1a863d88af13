//! Magnified views of ways, without forces: like [KTF08, Figs 13 and 16].

use super::axes::Axes;
use super::legend::{self, Entry};
use super::page::{Page, WIDTH};
use super::plane::Places;
use super::trajectory::LETTER_OFFSET;
use super::{Drawing, Error, Excerpt, Options, Window, heading, plane};
use yieldwall_record::Trace;

/// Most panels: three rows of three.
const MOST_PANELS: usize = 9;
const LEFT: f64 = 100.0;
const RIGHT: f64 = 30.0;
/// Room above a panel for its letter and the name of its axis; where `N_wait` stands there too, two lines.
const ABOVE: f64 = 46.0;
const ABOVE_WITH_HOLD: f64 = 84.0;
const BELOW: f64 = 96.0;

/// One panel: a part of the plane as one trace passes through it.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The trace.
    pub trace: &'a Trace,
    /// The part of the plane.
    pub window: Window,
}

/// Draws square panels side by side, each with the ways of tool and proxy and the reference surface at equal scales. Each
/// panel is headed by a letter, and by its trace's `N_wait` if that is not in the heading.
///
/// # Errors
/// As for the data of [`super::trajectory_and_time`]; [`Error::PanelCount`] for no panel or more than nine.
///
/// # Source
/// [KTF08, Figs 13 and 16].
pub fn magnified(views: &[View<'_>], options: &Options) -> Result<Drawing, Error> {
    let columns = match views.len() {
        1..=3 => views.len(),
        4 => 2,
        5..=MOST_PANELS => 3,
        count => return Err(Error::PanelCount { count, most: MOST_PANELS }),
    };
    let cell = WIDTH / columns as f64;
    let side = (cell - LEFT - RIGHT).min(900.0);
    let lines = views.len().div_ceil(columns);
    let traces: Vec<&Trace> = views.iter().map(|view| view.trace).collect();
    let heading = heading::lines(&traces, options);
    let has_hold = heading::has_hold(&traces, options);
    let above = if has_hold { ABOVE } else { ABOVE_WITH_HOLD };
    let excerpts =
        views.iter().map(|view| Excerpt::new(view.trace, options.time_span)).collect::<Result<Vec<_>, _>>()?;
    let panels = |page: &mut Page, head: f64| -> Result<Vec<Entry>, Error> {
        let mut entries = plane::way_entries();
        for (number, (view, excerpt)) in views.iter().zip(&excerpts).enumerate() {
            let left = (number % columns) as f64 * cell + LEFT + (cell - LEFT - RIGHT - side) / 2.0;
            let top = head + (number / columns) as f64 * (above + side + BELOW) + above;
            let (x, y) = plane::ranges(view.window)?;
            let axes = Axes::with_equal_scales(plane::frame(left, top, side, side), x, y);
            let places = Places::new(view.trace, excerpt);
            let sight = plane::ways(page, &axes, view.trace, excerpt, &places)?;
            let marks = plane::marks(page, &axes, view.trace, excerpt, None);
            legend::add(&mut entries, places.entries(view.trace, sight).into_iter().chain(marks));
            axes.draw(page, Some("x (mm)"), "y (mm)");
            if has_hold {
                super::panel_letter(page, (left - LETTER_OFFSET, top - 15.0), number);
            } else {
                super::panel_letter(page, (left, top - 52.0), number);
                super::hold_steps(page, (left, top - 52.0), view.trace);
            }
        }
        Ok(entries)
    };
    // What comes into sight is in the legend, whose height shifts the panels.
    let legend_y = heading::height(&heading) + 32.0;
    let further = legend::further_height(&panels(&mut Page::new(0.0), 0.0)?, WIDTH - LEFT);
    let head = legend_y + further + 14.0;
    let mut page = Page::new(head + lines as f64 * (above + side + BELOW));
    heading::draw(&mut page, &heading);
    let entries = panels(&mut page, head)?;
    legend::draw(&mut page, (LEFT, legend_y), WIDTH - LEFT, &entries);
    Ok(Drawing::new(page, options))
}
