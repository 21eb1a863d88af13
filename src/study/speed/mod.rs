//! Study of a simulated user who chooses the speed by the visible error and follows a path within a band: the time and the
//! deviation under each kind of fixture.
//!
//! ```text
//! error seen, late -> speed and correction of the aim -> hand -> fixture and arm -> tool -> error
//! ```
//! Time and error are both outcomes. It is mechanics and a model of a policy (`docs/user-model.md`), no evidence about people. The loop is
//! the [bench](super::bench) of all studies: exact angles and forces, no bus, no counts, no guard.

mod draw;
pub(super) mod page;
mod runs;
mod track;
mod trial;
mod user;

use self::runs::{Runs, VARIED, WIDTHS_AGAIN_M, WIDTHS_M, aids};
use self::track::Track;
use self::trial::LIMIT_S;
use super::sweep::{Report, Row, Study, Sweep, Table};
use super::task::Aid;

/// The study `speed`.
pub(super) struct Speed(Vec<Box<dyn Sweep>>);

impl Speed {
    pub(super) fn new() -> Self {
        Self(vec![
            Box::new(Runs::widths()),
            Box::new(Runs::lengths()),
            Box::new(Runs::varied()),
            Box::new(Runs::beside()),
            Box::new(Runs::again()),
        ])
    }
}

/// The row of a fixture among rows.
fn of_aid<'a>(mut rows: impl Iterator<Item = Row<'a>>, aid: &Aid) -> Option<Row<'a>> {
    rows.find(|row| {
        row.word("law") == aid.law.name()
            && row.cell("hardness").as_f64() == aid.hardness
            && row.cell("yield_n").as_f64() == aid.yield_n
    })
}

/// A fixture with its R, in words.
fn name(aid: &Aid) -> String {
    match aid.yield_n {
        Some(yield_n) => format!("{}, R = {yield_n} N", aid.name()),
        None => aid.name(),
    }
}

/// The line of least squares through points: where it begins, and its slope.
fn line(points: &[(f64, f64)]) -> Option<(f64, f64)> {
    let count = points.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (x, y) = (mean(|point| point.0), mean(|point| point.1));
    let spread: f64 = points.iter().map(|point| (point.0 - x) * (point.0 - x)).sum();
    let slope = points.iter().map(|point| (point.0 - x) * (point.1 - y)).sum::<f64>() / spread;
    slope.is_finite().then_some((y - slope * x, slope))
}

/// Time against length over width of those rows in which the median user came to the end.
fn times(widths: &Table, track: Track, aid: &Aid) -> Vec<(f64, f64)> {
    let at = |width_m: f64| {
        let is_meant = |row: &Row<'_>| row.word("way") == track.name() && row.number("width_m") == width_m;
        let row = of_aid(widths.rows().filter(is_meant), aid)?;
        let time_s = row.number("time_s");
        (time_s < LIMIT_S).then_some((row.number("length_over_width"), time_s))
    };
    WIDTHS_M.into_iter().filter_map(at).collect()
}

/// By how much times and errors of `widths` move in a variant of `again`, at most, in percent, and of which row.
fn moved(widths: &Table, again: &Table, variant: &str, column: &str) -> Option<(f64, String)> {
    let all = WIDTHS_AGAIN_M.into_iter().flat_map(|width_m| aids().into_iter().map(move |aid| (width_m, aid)));
    let moves = all.filter_map(|(width_m, aid)| {
        let is_meant = |row: &Row<'_>| row.word("way") == "circle" && row.number("width_m") == width_m;
        let before = of_aid(widths.rows().filter(is_meant), &aid)?.number(column);
        let is_again = |row: &Row<'_>| row.word("variant") == variant && row.number("width_m") == width_m;
        let after = of_aid(again.rows().filter(is_again), &aid)?.number(column);
        Some((100.0 * (after / before - 1.0).abs(), format!("{}, {} mm", name(&aid), 1e3 * width_m)))
    });
    moves.max_by(|one, other| one.0.total_cmp(&other.0))
}

impl Study for Speed {
    fn name(&self) -> &'static str {
        "speed"
    }

    fn about(&self) -> &'static str {
        "a simulated user chooses speed by the error seen, within a band: time and error under each fixture, for many kinds of users"
    }

    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.0
    }

    fn report(&self, tables: &[Table]) -> Report {
        let [widths, lengths, varied, beside, again] = tables else { return Report::default() };
        let mut notes = vec![format!(
            "time in s along the circle in bands of {} mm, medians (intervals of 95 %); RMS error in mm",
            { WIDTHS_M.map(|width_m| (1e3 * width_m).to_string()).join(", ") }
        )];
        for aid in aids() {
            let mut line_of = format!("{:38}", name(&aid));
            for width_m in WIDTHS_M {
                let is_meant = |row: &Row<'_>| row.word("way") == "circle" && row.number("width_m") == width_m;
                let Some(row) = of_aid(widths.rows().filter(is_meant), &aid) else { continue };
                line_of += &format!(
                    "  {:.2} ({:.2} to {:.2}) {:.3}",
                    row.number("time_s"),
                    row.number("time_low_s"),
                    row.number("time_high_s"),
                    1e3 * row.number("error_rms_m")
                );
            }
            notes.push(line_of);
        }
        for track in [Track::Circle, Track::Line] {
            for aid in aids() {
                let points = times(widths, track, &aid);
                if let Some((begin_s, slope_s)) = line(&points) {
                    notes.push(format!(
                        "{}, {}: time = {begin_s:.2} s + {:.0} ms * length/width, of {} bands",
                        track.name(),
                        name(&aid),
                        1e3 * slope_s,
                        points.len()
                    ));
                }
            }
        }
        for variant in ["other users", "twice the users", "half the step"] {
            for column in ["time_s", "error_rms_m"] {
                notes.extend(
                    moved(widths, again, variant, column)
                        .map(|(percent, of)| format!("{variant}: {column} moves by {percent:.0} % at most ({of})")),
                );
            }
        }
        for (letter, (name, _)) in ('b'..='o').zip(VARIED) {
            notes.push(format!("user {letter}: {name}"));
        }
        for table in tables {
            let sum = |column: &str| table.rows().map(|row| row.number(column)).sum::<f64>();
            notes.push(format!(
                "{}: {} of {} users did not come to the end in {LIMIT_S} s",
                table.name,
                sum("users") - sum("finished"),
                sum("users")
            ));
        }
        notes.push("mechanics and a model of a policy: no evidence about people".to_owned());
        Report { notes, charts: draw::charts(widths, lengths, varied, beside) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(sweep: &Runs, is_meant: impl Fn(&Row<'_>) -> bool, aid: &Aid) -> serde_json::Value {
        let index = (0..sweep.points()).find(|&index| {
            let mut table = Table::new(sweep);
            table.insert(index, sweep.with_users(index, 0..0));
            of_aid(table.rows().filter(|row| is_meant(row)), aid).is_some()
        });
        let mut table = Table::new(sweep);
        let index = index.unwrap();
        table.insert(index, sweep.with_users(index, 0..6));
        table.rows().next().unwrap().json()
    }

    /// Without a fixture a narrow band costs time; a fixture that holds the tool frees the user from it.
    #[test]
    fn a_fixture_that_holds_gives_speed() {
        let widths = Runs::widths();
        let time = |aid: &Aid, width: f64| {
            let is_meant = |row: &Row<'_>| row.word("way") == "circle" && row.number("width_m") == width;
            row(&widths, is_meant, aid)["time_s"].as_f64().unwrap()
        };
        let (wide, narrow) = (time(&Aid::NONE, 0.032), time(&Aid::NONE, 0.004));
        assert!(narrow > 2.0 * wide, "{narrow} {wide}");
        let held = time(&Aid::plastic(20.0), 0.004);
        assert!(held < 0.5 * narrow, "{held} {narrow}");
    }

    #[test]
    fn points_on_a_line_give_the_line() {
        let (begin, slope) = line(&[(1.0, 2.5), (3.0, 3.5), (7.0, 5.5)]).unwrap();
        assert!((begin - 2.0).abs() < 1e-12 && (slope - 0.5).abs() < 1e-12);
        assert_eq!(line(&[(1.0, 2.0)]), None);
    }
}
