//! The charts of the study.

use super::super::chart::{Axis, Chart, Color, Mark, Panel, Series};
use super::super::sweep::{Row, Table};
use super::super::task::{Aid, Law};
use super::of_aid;
use super::runs::{BESIDE_M, VARIED, WIDTH_BESIDE_M, WIDTHS_AGAIN_M, WIDTHS_M, YIELDS_N, aids};
use super::track::Track;

/// Ends of the axes of time, in s.
const TIMES_S: [f64; 2] = [0.7, 12.0];

type Named = (&'static str, Chart);

/// All charts.
pub(super) fn charts(widths: &Table, varied: &Table, beside: &Table) -> Vec<Named> {
    vec![
        ("study-speed-law", law(widths)),
        ("study-speed-error", error(widths)),
        ("study-speed-varied", users(widths, varied)),
        ("study-speed-beside", misplaced(widths, beside)),
    ]
}

/// How a fixture is drawn, whatever its R: by marks that differ in grey too.
fn look(aid: &Aid) -> Color {
    let is_hard = match aid.law {
        Law::Viscous => aid.yield_n.zip(aid.hardness).is_some_and(|(r, d)| r / d < 0.05),
        _ => aid.hardness.is_some_and(|stiffness| stiffness > 1e4),
    };
    match (aid.law, is_hard) {
        (Law::None, _) => Color::Black,
        (Law::Plastic, _) => Color::Blue,
        (Law::Viscous, false) => Color::Sky,
        (Law::Viscous, true) => Color::Green,
        (_, false) => Color::Purple,
        (_, true) => Color::Vermilion,
    }
}

/// Those that are drawn at an R.
fn drawn_at(yield_n: f64) -> impl Iterator<Item = Aid> {
    // Plastic on top of a stiff spring, which often lies in the same place.
    let mut all: Vec<Aid> = aids().into_iter().filter(|aid| aid.yield_n.is_none_or(|of| of == yield_n)).collect();
    all.sort_by_key(|aid| aid.law == Law::Plastic);
    all.into_iter()
}

fn series(aid: &Aid, points: Vec<(f64, f64)>) -> Series {
    Series { name: aid.name(), points, mark: Mark::MarkedLine, color: look(aid) }
}

/// The row of a way, a width and a fixture.
fn at<'a>(widths: &'a Table, track: Track, width_m: f64, aid: &Aid) -> Option<Row<'a>> {
    let is_meant = |row: &Row<'_>| row.word("way") == track.name() && row.number("width_m") == width_m;
    of_aid(widths.rows().filter(is_meant), aid)
}

fn law(widths: &Table) -> Chart {
    let mut panels = Vec::new();
    for track in [Track::Circle, Track::Line] {
        for yield_n in YIELDS_N {
            let of = |aid: Aid| {
                let point = |width_m: f64| {
                    at(widths, track, width_m, &aid).map(|row| (row.number("length_over_width"), row.number("time_s")))
                };
                series(&aid, WIDTHS_M.into_iter().filter_map(point).collect())
            };
            panels.push(Panel {
                title: format!("{}, R = {yield_n} N", track.name()),
                x: Axis::logarithmic("length over width of the band").over(4.0, 130.0),
                y: Axis::logarithmic("time (s)").over(TIMES_S[0], TIMES_S[1]),
                series: drawn_at(yield_n).map(of).collect(),
            });
        }
    }
    Chart { title: "A simulated user chooses speed: time along a band, medians of 40 users".into(), panels, columns: 2 }
}

fn error(widths: &Table) -> Chart {
    let panel = |yield_n: f64| {
        let of = |aid: Aid| {
            let point = |width_m: f64| {
                at(widths, Track::Circle, width_m, &aid)
                    .map(|row| (row.number("time_s"), 1e3 * row.number("error_rms_m")))
            };
            series(&aid, WIDTHS_M.into_iter().filter_map(point).collect())
        };
        Panel {
            title: format!("R = {yield_n} N"),
            x: Axis::logarithmic("time (s)").over(TIMES_S[0], TIMES_S[1]),
            y: Axis::logarithmic("RMS error (mm)").over(0.01, 20.0),
            series: drawn_at(yield_n).map(of).collect(),
        }
    };
    Chart {
        title: "Error against the time that users take, circle; a line runs over bands of 2, 4, 8, 16 and 32 mm".into(),
        panels: YIELDS_N.map(panel).to_vec(),
        columns: 2,
    }
}

/// Time of each kind of user, the usual one first.
fn users(widths: &Table, varied: &Table) -> Chart {
    let mut panels = Vec::new();
    for width_m in WIDTHS_AGAIN_M {
        for yield_n in YIELDS_N {
            let of = |aid: Aid| {
                let usual = at(widths, Track::Circle, width_m, &aid).map(|row| (1.0, row.number("time_s")));
                let of_kind = |(place, (variant, _)): (usize, &(&str, _))| {
                    let is_meant = |row: &Row<'_>| row.word("variant") == *variant && row.number("width_m") == width_m;
                    of_aid(varied.rows().filter(is_meant), &aid).map(|row| (2.0 + place as f64, row.number("time_s")))
                };
                let points = usual.into_iter().chain(VARIED.iter().enumerate().filter_map(of_kind)).collect();
                Series { mark: Mark::Marks, ..series(&aid, points) }
            };
            panels.push(Panel {
                title: format!("band of {} mm, R = {yield_n} N", 1e3 * width_m),
                x: Axis::of_words("kind of user", ('a'..='o').map(String::from).collect()),
                y: Axis::logarithmic("time (s)").over(TIMES_S[0], TIMES_S[1]),
                series: drawn_at(yield_n).map(of).collect(),
            });
        }
    }
    Chart { title: "Users of other numbers: a the usual ones, b to o one number changed".into(), panels, columns: 2 }
}

/// A reference beside the way.
fn misplaced(widths: &Table, beside: &Table) -> Chart {
    let mut panels = Vec::new();
    let kinds = [
        ("time_s", 1.0, Axis::logarithmic("time (s)").over(TIMES_S[0], TIMES_S[1])),
        ("outside_share", 100.0, Axis::linear("time outside of the band (%)").over(-3.0, 103.0)),
    ];
    for yield_n in YIELDS_N {
        for (column, factor, y) in kinds.clone() {
            let of = |aid: Aid| {
                let on = at(widths, Track::Circle, WIDTH_BESIDE_M, &aid).map(|row| (0.0, factor * row.number(column)));
                let off = |beside_m: f64| {
                    let is_meant = |row: &Row<'_>| row.number("beside_m") == beside_m;
                    of_aid(beside.rows().filter(is_meant), &aid)
                        .map(|row| (1e3 * beside_m, factor * row.number(column)))
                };
                series(&aid, on.into_iter().chain(BESIDE_M.into_iter().filter_map(off)).collect())
            };
            panels.push(Panel {
                title: format!("R = {yield_n} N"),
                x: Axis::linear("fixture beside the way (mm)").over(-0.4, 8.4),
                y,
                series: drawn_at(yield_n).map(of).collect(),
            });
        }
    }
    Chart {
        title: "A fixture beside the way, on which the tool starts; circle, band of 8 mm, whose edge is at 4 mm".into(),
        panels,
        columns: 2,
    }
}
