//! A simulated user traces a way at an imposed speed under each kind of fixture: how far off it is, and what the fixture
//! does besides.
//!
//! ```text
//! starts on the way -> traces it, aiming wrong by some millimetres -> presses off it -> lets go
//! ```
//! The user is a hand with mass, stiffness and damping, tremor as a force, and an aim that errs slowly and by more the
//! faster it moves. A clock drives the aim: the user answers neither the fixture nor the error. It supports mechanical claims (error, energy,
//! jump), none about how well people do.
//!
//! The rig is the [bench](super::bench) of all studies: exact angles and forces, no bus, no counts, no guard. Few users are run on the whole
//! rig besides.

mod aid;
mod device;
mod draw;
pub(super) mod page;
mod runs;
mod trial;
mod way;

pub(super) use self::aid::{Aid, Law};
use self::runs::{AIM_M, AIMS_AGAIN_M, FEW, FINE, HALF, OTHER, RIG, Runs, SPEED_M_PER_S};
pub(super) use self::trial::{GRIPS, Grip, HAND_LIMIT_N, TREMOR};
use super::sweep::{Report, Row, Study, Sweep, Table};

/// The study `task`.
pub(super) struct Task(Vec<Box<dyn Sweep>>);

impl Task {
    pub(super) fn new() -> Self {
        Self(vec![
            Box::new(Runs::errors()),
            Box::new(Runs::speeds()),
            Box::new(Runs::device()),
            Box::new(Runs::again()),
        ])
    }
}

/// The row of a fixture among rows.
fn of_aid<'a>(mut rows: impl Iterator<Item = Row<'a>>, aid: &Aid) -> Option<Row<'a>> {
    let is_same = |row: &Row<'_>, column: &str, value: Option<f64>| row.cell(column).as_f64() == value;
    rows.find(|row| {
        row.word("law") == aid.law.name()
            && is_same(row, "hardness", aid.hardness)
            && is_same(row, "yield_n", aid.yield_n)
    })
}

/// The rows of a grip and an error of the aim.
fn of_errors<'a>(errors: &'a Table, grip: &'a str, aim_m: f64) -> impl Iterator<Item = Row<'a>> {
    errors.rows().filter(move |row| row.word("grip") == grip && row.number("aim_rms_m") == aim_m)
}

/// One line of the notes.
fn line(name: &str, row: &Row<'_>) -> String {
    let milli = |column: &str| 1e3 * row.number(column);
    let yields = row.cell("yield_n").as_f64().map_or(String::new(), |yield_n| format!("{yield_n}"));
    format!(
        "{name:24} {yields:>5} {:>8.3} ({:.3} to {:.3})  {:>9.2} ({:.2} to {:.2})  {:>8.2} {:>7.1}  {:>2} of {}",
        milli("error_rms_m"),
        milli("error_low_m"),
        milli("error_high_m"),
        milli("energy_across_j"),
        milli("energy_low_j"),
        milli("energy_high_j"),
        // A zero without its sign.
        1e-2 * (1e5 * row.number("jump_m")).round() + 0.0,
        row.number("force_max_n"),
        row.number("ran"),
        row.number("users"),
    )
}

/// By how much a number moves from one variant of a table to another one, at most, in percent, and of which fixture.
fn moved(from: (&Table, &str), to: (&Table, &str), column: &str, least: f64) -> Option<(f64, String)> {
    let all = AIMS_AGAIN_M.into_iter().flat_map(|aim_m| Aid::all().into_iter().map(move |aid| (aim_m, aid)));
    let moves = all.filter_map(|(aim_m, aid)| {
        let of = |(table, variant): (&Table, &str)| {
            let rows = of_errors(table, trial::GRIPS[0].name, aim_m).filter(|row| row.word("variant") == variant);
            of_aid(rows, &aid).map(|row| row.number(column))
        };
        let (before, after) = (of(from)?, of(to)?);
        let is_told = before.max(after) >= least;
        let of = aid.yield_n.map_or(String::new(), |yield_n| format!(", R = {yield_n} N"));
        is_told.then(|| (100.0 * (after / before - 1.0).abs(), format!("{}{of}, {} mm", aid.name(), 1e3 * aim_m)))
    });
    moves.max_by(|one, other| one.0.total_cmp(&other.0))
}

impl Study for Task {
    fn name(&self) -> &'static str {
        "task"
    }

    fn about(&self) -> &'static str {
        "a simulated user traces a way at an imposed speed: error, energy, jump and force under each fixture, where each is best"
    }

    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.0
    }

    fn report(&self, tables: &[Table]) -> Report {
        let [errors, speeds, device, again] = tables else { return Report::default() };
        let mut notes = vec![
            format!(
                "circle at {SPEED_M_PER_S} m/s, aim off by {} mm RMS at rest; medians (intervals of 95 %)",
                1e3 * AIM_M
            ),
            format!(
                "{:24} {:>5} {:>8} {:>17}  {:>9} {:>15}  {:>8} {:>7}  ran",
                "soft hand", "R, N", "RMS mm", "", "across mJ", "", "jump mm", "most N"
            ),
        ];
        for aid in Aid::all() {
            notes.extend(
                of_aid(of_errors(errors, trial::GRIPS[0].name, AIM_M), &aid).map(|row| line(&aid.name(), &row)),
            );
        }
        let all = (errors, "");
        for (from, variant) in [(all, OTHER), (all, HALF), ((again, FEW), FINE), ((again, FEW), RIG)] {
            // Below these a number is that of the servo's own unrest.
            for (column, least) in [("error_rms_m", 1e-5), ("energy_across_j", 1e-4)] {
                notes.extend(
                    moved(from, (again, variant), column, least)
                        .map(|(percent, of)| format!("{variant}: {column} moves by {percent:.0} % at most ({of})")),
                );
            }
        }
        let stopped = |table: &Table| table.rows().map(|row| row.number("users") - row.number("ran")).sum::<f64>();
        for table in tables {
            let all: f64 = table.rows().map(|row| row.number("users")).sum();
            notes.push(format!("{}: {} of {all} runs did not come to their end", table.name, stopped(table)));
        }
        notes.push(format!(
            "the device renders up to {:.0} N/m with nobody at it: b + B >= K T/2",
            device::STIFFEST_N_PER_M
        ));
        notes.push("the speed is imposed, and the user is simulated: mechanical claims, none about people".to_owned());
        Report { notes, charts: draw::charts(errors, speeds, device) }
    }
}

#[cfg(test)]
mod tests {
    use super::aid::YIELDS_N;
    use super::*;

    fn row(sweep: &Runs, is_meant: impl Fn(&Row<'_>) -> bool, aid: &Aid) -> serde_json::Value {
        // Which row is asked for is known from an empty table: what was asked stands in its first cells.
        let index = (0..sweep.points()).find(|&index| {
            let mut table = Table::new(sweep);
            table.insert(index, sweep.asked(index));
            of_aid(table.rows().filter(|row| is_meant(row)), aid).is_some()
        });
        let mut table = Table::new(sweep);
        let index = index.unwrap();
        table.insert(index, sweep.with_users(index, 0..6));
        table.rows().next().unwrap().json()
    }

    /// Within R a stiff spring is as exact as plastic; beyond R it is more exact, and throws the tool.
    #[test]
    fn the_laws_differ_beyond_the_yield_force() {
        let errors = Runs::errors();
        let is_meant = |row: &Row<'_>| row.word("grip") == "soft" && row.number("aim_rms_m") == AIM_M;
        let of = |aid: Aid| row(&errors, is_meant, &aid);
        let number = |row: &serde_json::Value, column: &str| row[column].as_f64().unwrap_or_else(|| panic!("{row}"));
        let [within, stiff] = [Aid::plastic(20.0), Aid::saturated(1e6, 20.0)].map(of);
        assert!(number(&stiff, "error_rms_m") < 1.2 * number(&within, "error_rms_m"), "{stiff} {within}");
        let [yielding, pulled] = [Aid::plastic(5.0), Aid::saturated(1e5, 5.0)].map(of);
        assert!(number(&pulled, "error_rms_m") < number(&yielding, "error_rms_m"), "{pulled} {yielding}");
        assert!(number(&pulled, "jump_m") > 0.01 && number(&yielding, "jump_m").abs() < 1e-3, "{pulled} {yielding}");
        assert!(number(&pulled, "energy_across_j") > 10.0 * number(&yielding, "energy_across_j"));
    }

    /// On the device the sampled loop caps the spring, and the coupling of a plastic fixture as well.
    #[test]
    fn beyond_the_sampled_limit_a_device_swings() {
        let device = Runs::device();
        let resting = |law: Law, stiffness: f64| {
            let yield_n = (law != Law::Spring).then_some(6.0);
            let aid = Aid { law, hardness: Some(stiffness), yield_n };
            row(&device, |row| row.word("grip") == "soft", &aid)["resting_m_per_s"].as_f64().unwrap()
        };
        for law in [Law::Spring, Law::Saturated] {
            assert!(resting(law, 1e3) < 1e-3, "{law:?}");
            assert!(resting(law, 3e4) > 0.01, "{law:?}");
        }
        assert!(resting(Law::Plastic, 1e3) < 0.1 * resting(Law::Saturated, 3e4));
    }

    #[test]
    fn at_each_yield_force_stand_all_laws() {
        for yield_n in YIELDS_N {
            let laws: Vec<_> = Aid::at(yield_n).iter().map(|aid| aid.law).collect();
            assert!([Law::Plastic, Law::Saturated, Law::Viscous].iter().all(|law| laws.contains(law)));
            assert!(Aid::at(yield_n).iter().all(|aid| aid.yield_n == Some(yield_n)));
        }
    }
}
