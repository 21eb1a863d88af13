//! The least stable virtual mass against the stiffness of the hand.

use serde_json::Value;

use super::held::{NudgeEffect, PLAIN, Setting};
use super::{Agreement, STUDY, cell, cells_below, on_grid};
use crate::chart::{Axis, Chart, Color, Mark, Panel, Series};
use crate::sweep::{Clock, Report, Row, Sweep, Table};

const MAP_HANDS: u64 = 40;
const MAP_MASSES: u64 = 30;
const HANDS_N_PER_M: [f64; 2] = [100.0, 10_000.0];
const MASSES_KG: [f64; 2] = [0.01, 10.0];
const MAP_DURATION_S: f64 = 2.0;
/// Share of a panel's width that a cell takes, in thousandths.
const CELL: u32 = 25;

/// Name of the formula for a continuous servo.
const CROSSOVER: &str = "continuous servo, hand no load";

const MAPS: [Setting; 12] = [
    Setting { name: "no delay", ..PLAIN },
    Setting { name: "1 cycle of delay", delay: 1, ..PLAIN },
    Setting { name: "3 cycles of delay", delay: 3, ..PLAIN },
    Setting { name: "force at 500 Hz", sample_cycles: 2, ..PLAIN },
    Setting { name: "force at 200 Hz", sample_cycles: 5, ..PLAIN },
    Setting { name: "low pass of 30 Hz", low_pass_hz: Some(30.0), ..PLAIN },
    Setting { name: "low pass of 10 Hz", low_pass_hz: Some(10.0), ..PLAIN },
    Setting { name: "joint torques 1 cycle late", servo_delay: 1, ..PLAIN },
    Setting { name: "hand of 0.5 kg, torques 1 cycle late", servo_delay: 1, hand_kg: 0.5, ..PLAIN },
    Setting { name: "hand of 1.5 kg, torques 1 cycle late", servo_delay: 1, hand_kg: 1.5, ..PLAIN },
    Setting { name: "dry joints, 1 cycle", delay: 1, coulomb_n_m: 10.0, nudge_n: 30.0, ..PLAIN },
    Setting {
        name: "dry joints, 1 cycle, F = 3 N",
        delay: 1,
        coulomb_n_m: 10.0,
        friction_n: 3.0,
        nudge_n: 30.0,
        ..PLAIN
    },
];

/// Every hand with every mass in every setting.
pub(super) struct Map;

impl Sweep for Map {
    fn name(&self) -> &'static str {
        "mass"
    }

    fn columns(&self) -> Vec<&str> {
        vec!["setting", "hand_n_per_m", "virtual_mass_kg", "outcome"]
    }

    fn points(&self) -> u64 {
        MAPS.len() as u64 * MAP_HANDS * MAP_MASSES
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let (rest, mass) = (index / MAP_MASSES, index % MAP_MASSES);
        let setting = MAPS[(rest / MAP_HANDS) as usize];
        let hand_n_per_m = cell(rest % MAP_HANDS, MAP_HANDS, HANDS_N_PER_M);
        let mass_kg = cell(mass, MAP_MASSES, MASSES_KG);
        let outcome = setting.run(hand_n_per_m, mass_kg, MAP_DURATION_S);
        vec![setting.name.into(), hand_n_per_m.into(), mass_kg.into(), outcome.word().into()]
    }
}

/// The boundary of each map by theory, which knows no dry friction.
pub(super) struct Theory;

impl Sweep for Theory {
    fn name(&self) -> &'static str {
        "mass-theory"
    }

    fn columns(&self) -> Vec<&str> {
        vec!["setting", "hand_n_per_m", "least_mass_kg", "crossover_kg"]
    }

    fn points(&self) -> u64 {
        MAPS.len() as u64 * MAP_HANDS
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let setting = MAPS[(index / MAP_HANDS) as usize];
        let hand_n_per_m = cell(index % MAP_HANDS, MAP_HANDS, HANDS_N_PER_M);
        vec![
            setting.name.into(),
            hand_n_per_m.into(),
            setting.least_mass_kg(hand_n_per_m).into(),
            setting.least_mass_by_crossover_kg(hand_n_per_m).into(),
        ]
    }
}

const ROW_HANDS_N_PER_M: [f64; 5] = [300.0, 500.0, 1000.0, 3000.0, 10_000.0];
const ROW_MASSES: u64 = 48;
const ROW_MASSES_KG: [f64; 2] = [0.02, 10.0];
const ROW_DURATION_S: f64 = 4.0;
/// All masses of the grid were stable.
const ANY: f64 = 0.0;
/// None was.
const NONE: f64 = f64::INFINITY;

/// A setting, and the results of an independent implementation of the same arm, hand and servo. That implementation has the same
/// grid of masses, and its own criterion for motion that dies away.
type Reference = (Setting, [f64; 5]);

const DRY: Setting = Setting { coulomb_n_m: 10.0, nudge_n: 30.0, ..LATE };
const LATE: Setting = Setting { delay: 1, ..PLAIN };

const ROWS: [Reference; 15] = [
    (Setting { name: "no delay", ..PLAIN }, [ANY, ANY, ANY, 0.37, 2.3]),
    (Setting { name: "1 cycle", ..LATE }, [0.04, 0.05, 0.09, 0.55, 3.0]),
    (Setting { name: "3 cycles", delay: 3, ..PLAIN }, [0.10, 0.11, 0.17, 0.93, NONE]),
    (Setting { name: "low pass 30 Hz", low_pass_hz: Some(30.0), ..PLAIN }, [0.10, 0.11, 0.19, 4.0, NONE]),
    (Setting { name: "low pass 10 Hz", low_pass_hz: Some(10.0), ..PLAIN }, [0.13, 0.17, NONE, NONE, NONE]),
    (Setting { name: "1 cycle, b 10 N s/m", damping_n_s_per_m: 10.0, ..LATE }, [ANY, ANY, ANY, ANY, 2.3]),
    (Setting { name: "1 cycle, b 30 N s/m", damping_n_s_per_m: 30.0, ..LATE }, [ANY, ANY, ANY, ANY, 1.4]),
    (Setting { name: "1 cycle, servo x2", bandwidth: 2.0, ..LATE }, [0.03, 0.04, 0.04, 0.10, 0.71]),
    (Setting { name: "1 cycle, servo /2", bandwidth: 0.5, ..LATE }, [0.06, 0.10, 0.37, 2.7, 5.2]),
    (Setting { name: "1 cycle, B_h 5 N s/m", hand_n_s_per_m: 5.0, ..LATE }, [0.03, 0.05, 0.19, 1.4, 5.2]),
    (Setting { name: "1 cycle, B_h 40 N s/m", hand_n_s_per_m: 40.0, ..LATE }, [0.09, 0.10, 0.11, 0.22, 1.6]),
    (Setting { name: "dry, 1 cycle", ..DRY }, [1.2, 1.4, 1.6, NONE, NONE]),
    (Setting { name: "dry, 1 cycle, b 30", damping_n_s_per_m: 30.0, ..DRY }, [ANY, ANY, ANY, 8.8, NONE]),
    (Setting { name: "dry, 1 cycle, F 3 N", friction_n: 3.0, ..DRY }, [0.03, 0.03, 0.04, 0.25, NONE]),
    (Setting { name: "dry, F 3 N, servo x2", friction_n: 3.0, bandwidth: 2.0, ..DRY }, [0.03, 0.03, 0.04, 0.09, 0.62]),
];

/// The least mass of a finer grid from which on all masses are stable, for a few hands in more settings.
pub(super) struct Rows;

impl Sweep for Rows {
    fn name(&self) -> &'static str {
        "mass-rows"
    }

    fn columns(&self) -> Vec<&str> {
        vec![
            "setting",
            "hand_n_per_m",
            "joint_friction_n_m",
            "measured_kg",
            "theory_kg",
            "crossover_kg",
            "reference_kg",
        ]
    }

    fn points(&self) -> u64 {
        (ROWS.len() * ROW_HANDS_N_PER_M.len()) as u64
    }

    /// No stable mass and no theory are `null`; a mass of zero stands for the whole grid.
    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let hand = index as usize % ROW_HANDS_N_PER_M.len();
        let (setting, reference) = ROWS[index as usize / ROW_HANDS_N_PER_M.len()];
        let hand_n_per_m = ROW_HANDS_N_PER_M[hand];
        let mut place = ROW_MASSES;
        while place > 0 {
            let mass_kg = on_grid(place - 1, ROW_MASSES, ROW_MASSES_KG);
            if setting.run(hand_n_per_m, mass_kg, ROW_DURATION_S) != NudgeEffect::Dies {
                break;
            }
            place -= 1;
        }
        vec![
            setting.name.into(),
            hand_n_per_m.into(),
            setting.coulomb_n_m.into(),
            least_of(place).into(),
            setting.least_mass_kg(hand_n_per_m).into(),
            setting.least_mass_by_crossover_kg(hand_n_per_m).into(),
            reference[hand].into(),
        ]
    }
}

/// Returns the mass at a place on the grid of rows.
fn least_of(place: u64) -> f64 {
    match place {
        0 => ANY,
        ROW_MASSES => NONE,
        place => on_grid(place, ROW_MASSES, ROW_MASSES_KG),
    }
}

/// Place of a mass on the grid of rows.
fn row_place(mass_kg: f64) -> u64 {
    // A cell without a number is a mass beyond all. A hair less, since a grid value is met to rounding.
    let below = |&place: &u64| on_grid(place, ROW_MASSES, ROW_MASSES_KG) < mass_kg * (1.0 - 1e-9);
    if mass_kg.is_nan() { ROW_MASSES } else { (0..ROW_MASSES).filter(below).count() as u64 }
}

pub(super) fn report(map: &Table, theory: &Table, rows: &Table, report: &mut Report) {
    let mut panels = Vec::new();
    report.notes.push("least stable virtual mass, map by map:".to_owned());
    for setting in MAPS {
        let points: Vec<_> = map.rows().filter(|row| row.word("setting") == setting.name).collect();
        let bound = |column: &str| -> Vec<_> {
            let rows = theory.rows().filter(|row| row.word("setting") == setting.name);
            rows.map(|row| (row.number("hand_n_per_m"), row.number(column))).collect()
        };
        let sampled = bound("least_mass_kg");
        let by_crossover = if setting.has_crossover() { bound("crossover_kg") } else { Vec::new() };
        if setting.coulomb_n_m == 0.0 {
            let agreement = map_agreement(&points, &sampled);
            report.notes.push(format!("  {}", agreement.line(setting.name)));
            report.notes.extend(agreement.beyond.iter().map(|line| format!("    {line}")));
        }
        if setting.has_crossover() {
            let agreement = map_agreement(&points, &by_crossover);
            report.notes.push(format!("  {}", agreement.line(&format!("{}, {CROSSOVER}", setting.name))));
            report.notes.extend(agreement.ends().map(|line| format!("    {line}")));
        }
        panels.push(panel(setting.name, &points, sampled, by_crossover));
    }
    let others = panels.split_off(MAPS.len() / 2);
    for (name, panels) in [("study-stability-mass", panels), ("study-stability-mass-others", others)] {
        let title = "Does a nudge of a hand on the tool die away? Virtual mass against stiffness of the hand";
        report.charts.push((name, Chart { title: title.to_owned(), panels }));
    }
    row_notes(rows, report);
}

/// The least mass of each column of a map against theory.
fn map_agreement(points: &[Row<'_>], bound: &[(f64, f64)]) -> Agreement {
    let mut agreement = Agreement::default();
    for &(hand_n_per_m, least_kg) in bound {
        let column: Vec<_> = points.iter().filter(|row| row.number("hand_n_per_m") == hand_n_per_m).collect();
        let unstable = column.iter().rposition(|row| row.word("outcome") != NudgeEffect::Dies.word());
        let measured = unstable.map_or(0, |last| last as u64 + 1);
        let computed = if least_kg.is_nan() { MAP_MASSES } else { cells_below(least_kg, MAP_MASSES, MASSES_KG) };
        agreement.add(measured, computed, || {
            let last = unstable.unwrap_or(0);
            let again = column.get(last).map_or(String::new(), |row| row.command(STUDY));
            format!("{hand_n_per_m:.0} N/m: {measured} of {MAP_MASSES} masses unstable, {computed} by theory: {again}")
        });
    }
    agreement
}

fn panel(title: &str, points: &[Row<'_>], sampled: Vec<(f64, f64)>, by_crossover: Vec<(f64, f64)>) -> Panel {
    let cells = |outcomes: &[NudgeEffect], color| Series {
        name: outcomes.iter().map(|outcome| outcome.word()).collect::<Vec<_>>().join(" or "),
        points: points
            .iter()
            .filter(|row| outcomes.iter().any(|outcome| row.word("outcome") == outcome.word()))
            .map(|row| (row.number("hand_n_per_m"), row.number("virtual_mass_kg")))
            .collect(),
        mark: Mark::Cells(CELL),
        color,
    };
    let line = |name: &str, points, mark, color| Series { name: name.to_owned(), points, mark, color };
    let mut series = vec![
        cells(&[NudgeEffect::Dies], Color::Pale),
        cells(&[NudgeEffect::Lasts], Color::Orange),
        cells(&[NudgeEffect::Lost, NudgeEffect::Refused], Color::Vermilion),
        line("sampled loop, no dry friction", sampled, Mark::Line, Color::Black),
    ];
    if !by_crossover.is_empty() {
        series.push(line(CROSSOVER, by_crossover, Mark::Dashed, Color::Blue));
    }
    Panel {
        title: title.to_owned(),
        x: Axis::logarithmic("stiffness of the hand (N/m)").over(HANDS_N_PER_M[0], HANDS_N_PER_M[1]),
        y: Axis::logarithmic("virtual mass (kg)").over(MASSES_KG[0], MASSES_KG[1]),
        series,
    }
}

fn row_notes(rows: &Table, report: &mut Report) {
    let header: Vec<String> = ROW_HANDS_N_PER_M.iter().map(|hand| format!("{hand:>17.0}")).collect();
    report.notes.push(format!("least stable virtual mass in kg, measured/theory/reference{}", header.join("")));
    let [mut by_theory, mut by_crossover, mut by_reference] = <[Agreement; 3]>::default();
    for (setting, _) in ROWS {
        let mut line = format!("  {:24}", setting.name);
        for row in rows.rows().filter(|row| row.word("setting") == setting.name) {
            let [measured, computed, reference] =
                ["measured_kg", "theory_kg", "reference_kg"].map(|column| row.number(column));
            let what = || format!("{} at {:.0} N/m: {}", setting.name, row.number("hand_n_per_m"), row.command(STUDY));
            if setting.coulomb_n_m == 0.0 {
                by_theory.add(row_place(measured), row_place(computed), what);
            }
            if setting.has_crossover() {
                by_crossover.add(row_place(measured), row_place(row.number("crossover_kg")), what);
            }
            let is_near = is_within_a_step(measured, reference);
            by_reference.add(0, if is_near { 0 } else { 2 }, what);
            let computed = if setting.coulomb_n_m == 0.0 { mass_text(computed) } else { "-".to_owned() };
            line += &format!("{:>17}", format!("{}/{computed}/{}", mass_text(measured), mass_text(reference)));
        }
        report.notes.push(line);
    }
    for (name, agreement) in [
        ("rows against the sampled loop", by_theory),
        ("rows against the formula for a continuous servo", by_crossover),
        ("rows against the reference", by_reference),
    ] {
        let all = agreement.within_a_step + agreement.beyond.len();
        report.notes.push(format!("{name}: {} of {all} within one grid step of 14 %", agreement.within_a_step));
        report.notes.extend(agreement.beyond.iter().map(|line| format!("    {line}")));
    }
}

/// Whether a mass of the grid is within a step of one that is rounded to two digits.
fn is_within_a_step(mass_kg: f64, rounded_kg: f64) -> bool {
    let step = on_grid(1, ROW_MASSES, ROW_MASSES_KG) / ROW_MASSES_KG[0];
    let rounding_kg = if rounded_kg < 1.0 { 0.005 } else { 0.05 };
    if !(mass_kg.is_finite() && rounded_kg.is_finite()) {
        return mass_kg.is_finite() == rounded_kg.is_finite();
    }
    let low = if rounded_kg == ANY { 0.0 } else { (rounded_kg - rounding_kg) / step };
    (low..=(rounded_kg + rounding_kg).max(ROW_MASSES_KG[0]) * step).contains(&mass_kg)
}

fn mass_text(mass_kg: f64) -> String {
    match mass_kg {
        none if !none.is_finite() => ">10".to_owned(),
        any if any < ROW_MASSES_KG[0] => "<.02".to_owned(),
        heavy if heavy > ROW_MASSES_KG[1] => ">10".to_owned(),
        mass => format!("{mass:.2}"),
    }
}
