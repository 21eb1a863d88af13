//! The charts of the study.

use super::super::chart::{Axis, Chart, Color, Estimate, Mark, Panel, Series};
use super::super::sweep::{Row, Table};
use super::super::task::{Aid, Law};
use super::runs::{
    AIDS_AT_LENGTHS, BESIDE_M, LENGTH_SHARES, USERS, VARIED, WIDTH_BESIDE_M, WIDTHS_AGAIN_M, WIDTHS_M, YIELDS_N, aids,
};
use super::track::Track;
use super::{name, of_aid};

/// How far apart fixtures stand beside each other at one kind of user.
const BESIDE_EACH_OTHER: f64 = 0.12;
/// Ends of the axes of time, in s.
const TIMES_S: [f64; 2] = [0.7, 12.0];

/// Columns with their intervals of 95 %.
const TIME: [&str; 3] = ["time_s", "time_low_s", "time_high_s"];
const ERROR: [&str; 3] = ["error_rms_m", "error_low_m", "error_high_m"];
const OUTSIDE: [&str; 3] = ["outside_share", "outside_low", "outside_high"];

type Named = (&'static str, Chart);

/// All charts.
pub(super) fn charts(widths: &Table, lengths: &Table, varied: &Table, beside: &Table) -> Vec<Named> {
    vec![
        ("study-speed-law", law(widths)),
        ("study-speed-lengths", length(widths, lengths)),
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

/// Returns the aids that are drawn at an R.
fn drawn_at(yield_n: f64) -> impl Iterator<Item = Aid> {
    // Plastic on top of a stiff spring, which often lies in the same place.
    let mut all: Vec<Aid> = aids().into_iter().filter(|aid| aid.yield_n.is_none_or(|of| of == yield_n)).collect();
    all.sort_by_key(|aid| aid.law == Law::Plastic);
    all.into_iter()
}

fn series(aid: &Aid, points: &[(Estimate, Estimate)]) -> Vec<Series> {
    Series::new(aid.name(), Mark::MarkedLine, look(aid)).through(points)
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
                    at(widths, track, width_m, &aid)
                        .map(|row| (row.number("length_over_width").into(), row.estimate(TIME, 1.0)))
                };
                series(&aid, &WIDTHS_M.into_iter().filter_map(point).collect::<Vec<_>>())
            };
            panels.push(Panel {
                title: format!("{}, R = {yield_n} N", track.name()),
                x: Axis::logarithmic("length over width of the band").over(4.0, 130.0),
                y: Axis::logarithmic("time (s)").over(TIMES_S[0], TIMES_S[1]),
                series: drawn_at(yield_n).flat_map(of).collect(),
            });
        }
    }
    let title =
        format!("A simulated user chooses speed: time along a band, medians of {USERS} users with intervals of 95 %");
    Chart { title, panels }
}

/// Ways of three lengths on the circle: whether the time is one line over length over width.
fn length(widths: &Table, lengths: &Table) -> Chart {
    let usual_m = Track::Circle.length_m();
    let panel = |aid: Aid| {
        let of = |(share, color): (f64, Color)| {
            let (table, length_m) = (if share == 1.0 { widths } else { lengths }, share * usual_m);
            let is_meant = |row: &Row<'_>| row.word("way") == "circle" && row.number("length_m") == length_m;
            let point = |width_m: f64| {
                let rows = table.rows().filter(|row| is_meant(row) && row.number("width_m") == width_m);
                of_aid(rows, &aid).map(|row| (row.number("length_over_width").into(), row.estimate(TIME, 1.0)))
            };
            let points: Vec<_> = WIDTHS_M.into_iter().filter_map(point).collect();
            Series::new(format!("way of {:.0} mm", 1e3 * length_m), Mark::MarkedLine, color).through(&points)
        };
        let shares = [LENGTH_SHARES[0], 1.0, LENGTH_SHARES[1]];
        Panel {
            title: name(&aid),
            x: Axis::linear("length over width of the band").over(0.0, 130.0),
            y: Axis::linear("time (s)").over(0.0, 9.0),
            series: shares.into_iter().zip([Color::Sky, Color::Black, Color::Vermilion]).flat_map(of).collect(),
        }
    };
    Chart {
        title: format!(
            "Ways of three lengths on the circle: time along a band, medians of {USERS} users with intervals of 95 %"
        ),
        panels: AIDS_AT_LENGTHS.map(panel).to_vec(),
    }
}

fn error(widths: &Table) -> Chart {
    let panel = |yield_n: f64| {
        let of = |aid: Aid| {
            let point = |width_m: f64| {
                at(widths, Track::Circle, width_m, &aid).map(|row| (row.estimate(TIME, 1.0), row.estimate(ERROR, 1e3)))
            };
            series(&aid, &WIDTHS_M.into_iter().filter_map(point).collect::<Vec<_>>())
        };
        Panel {
            title: format!("R = {yield_n} N"),
            x: Axis::logarithmic("time (s)").over(TIMES_S[0], TIMES_S[1]),
            y: Axis::logarithmic("RMS error (mm)").over(0.01, 20.0),
            series: drawn_at(yield_n).flat_map(of).collect(),
        }
    };
    Chart {
        title: "Error against the time that users take, circle; a line runs over bands of 2, 4, 8, 16 and 32 mm".into(),
        panels: YIELDS_N.map(panel).to_vec(),
    }
}

/// Time of each kind of user, the usual one first.
fn users(widths: &Table, varied: &Table) -> Chart {
    let mut panels = Vec::new();
    for width_m in WIDTHS_AGAIN_M {
        for yield_n in YIELDS_N {
            let aids: Vec<Aid> = drawn_at(yield_n).collect();
            let of = |(beside, aid): (usize, &Aid)| {
                // Each fixture beside the last one, around the place of its kind of user.
                let x = BESIDE_EACH_OTHER * (beside as f64 - 0.5 * (aids.len() - 1) as f64);
                let time = |place: f64, row: Row<'_>| (Estimate::from(place + x), row.estimate(TIME, 1.0));
                let usual = at(widths, Track::Circle, width_m, aid).map(|row| time(1.0, row));
                let of_kind = |(place, (variant, _)): (usize, &(&str, _))| {
                    let is_meant = |row: &Row<'_>| row.word("variant") == *variant && row.number("width_m") == width_m;
                    of_aid(varied.rows().filter(is_meant), aid).map(|row| time(2.0 + place as f64, row))
                };
                let points: Vec<_> = usual.into_iter().chain(VARIED.iter().enumerate().filter_map(of_kind)).collect();
                Series::new(aid.name(), Mark::Marks, look(aid)).through(&points)
            };
            panels.push(Panel {
                title: format!("band of {} mm, R = {yield_n} N", 1e3 * width_m),
                x: Axis::of_words("kind of user", ('a'..='o').map(String::from).collect()),
                y: Axis::logarithmic("time (s)").over(TIMES_S[0], TIMES_S[1]),
                series: aids.iter().enumerate().flat_map(of).collect(),
            });
        }
    }
    let title =
        "Users of other numbers: a the usual ones, b to o one number changed; medians with intervals of 95 %".into();
    Chart { title, panels }
}

/// A reference beside the way.
fn misplaced(widths: &Table, beside: &Table) -> Chart {
    let mut panels = Vec::new();
    let kinds = [
        (TIME, 1.0, Axis::logarithmic("time (s)").over(TIMES_S[0], TIMES_S[1])),
        (OUTSIDE, 100.0, Axis::linear("time outside of the band (%)").over(-3.0, 103.0)),
    ];
    for yield_n in YIELDS_N {
        for (columns, factor, y) in kinds.clone() {
            let of = |aid: Aid| {
                let point =
                    |beside_m: f64, row: Row<'_>| (Estimate::from(1e3 * beside_m), row.estimate(columns, factor));
                let on = at(widths, Track::Circle, WIDTH_BESIDE_M, &aid).map(|row| point(0.0, row));
                let off = |beside_m: f64| {
                    let is_meant = |row: &Row<'_>| row.number("beside_m") == beside_m;
                    of_aid(beside.rows().filter(is_meant), &aid).map(|row| point(beside_m, row))
                };
                series(&aid, &on.into_iter().chain(BESIDE_M.into_iter().filter_map(off)).collect::<Vec<_>>())
            };
            panels.push(Panel {
                title: format!("R = {yield_n} N"),
                x: Axis::linear("fixture beside the way (mm)").over(-0.4, 8.4),
                y,
                series: drawn_at(yield_n).flat_map(of).collect(),
            });
        }
    }
    Chart {
        title: "A fixture beside the way, on which the tool starts; circle, band of 8 mm; intervals of 95 %".into(),
        panels,
    }
}
