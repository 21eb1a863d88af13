//! The charts of the study.

use super::super::chart::{Axis, Chart, Color, Estimate, Mark, Panel, Series};
use super::super::sweep::{Row, Table, wilson};
use super::aid::{Aid, DRIFTS_M_PER_S, Law, SPRINGS_N_PER_M, YIELDS_N};
use super::runs::{AIM_M, AIMS_M, OTHER_SPEEDS_M_PER_S, PRESS_N, SPEED_M_PER_S, USERS};
use super::trial::GRIPS;
use super::{device, of_aid, of_errors};

/// A tool that jumps back by less than this, in m, is not thrown.
pub(super) const THROWN_M: f64 = 1e-3;
/// A law that lets a press above R move the tool by this share of what it moves without a fixture gives way.
const GIVES_WAY: f64 = 0.5;
/// A law that errs by more than this share of another's error is alike.
const ALIKE: f64 = 0.9;
/// Newtons per millimetre in one newton per metre.
const N_PER_MM: f64 = 1e-3;
/// Width of a cell of the map, in thousandths of the panel.
const CELL: u32 = 190;

/// Columns with their intervals of 95 %.
const ERROR: [&str; 3] = ["error_rms_m", "error_low_m", "error_high_m"];
const JUMP: [&str; 3] = ["jump_m", "jump_low_m", "jump_high_m"];

type Named = (&'static str, Chart);

/// All charts.
pub(super) fn charts(errors: &Table, speeds: &Table, device: &Table) -> Vec<Named> {
    vec![
        ("study-task-speed", speed(errors, speeds)),
        ("study-task-price", price(errors)),
        ("study-task-map", map(errors)),
        ("study-task-device", on_device(device)),
    ]
}

/// How a fixture is drawn, whatever its R.
fn look(aid: &Aid) -> (Color, Mark) {
    let of_spring = |stiffness: f64| {
        let place = SPRINGS_N_PER_M.iter().position(|it| *it == stiffness).unwrap_or(0);
        [Color::Orange, Color::Vermilion, Color::Green, Color::Purple][place]
    };
    let drift_m_per_s = aid.yield_n.zip(aid.hardness).map(|(r, d)| r / d);
    match aid.law {
        Law::None => (Color::Black, Mark::MarkedLine),
        Law::Plastic => (Color::Blue, Mark::MarkedLine),
        Law::Saturated | Law::Spring => (of_spring(aid.hardness.unwrap_or_default()), Mark::MarkedLine),
        Law::Viscous if drift_m_per_s > Some(DRIFTS_M_PER_S[1]) => (Color::Sky, Mark::MarkedLine),
        Law::Viscous if drift_m_per_s > Some(DRIFTS_M_PER_S[2]) => (Color::Wine, Mark::MarkedDashes),
        Law::Viscous => (Color::Black, Mark::MarkedDashes),
    }
}

/// Returns the aids that are drawn at an R.
fn drawn_at(yield_n: f64) -> Vec<Aid> {
    [Aid::NONE].into_iter().chain(Aid::at(yield_n)).collect()
}

fn series(aid: &Aid, points: &[(Estimate, Estimate)]) -> Vec<Series> {
    let (color, mark) = look(aid);
    Series::new(aid.name(), mark, color).through(points)
}

fn speed(errors: &Table, speeds: &Table) -> Chart {
    let [slow, quick @ ..] = OTHER_SPEEDS_M_PER_S;
    let all = [slow, SPEED_M_PER_S].into_iter().chain(quick);
    let panel = |yield_n: f64| {
        let of = |aid: &Aid| {
            let at = |speed: f64| {
                let rows = of_errors(errors, GRIPS[0].name, AIM_M).chain(speeds.rows());
                of_aid(rows.filter(|row| row.number("speed_m_per_s") == speed), aid)
                    .map(|row| (Estimate::from(speed), row.estimate(ERROR, 1e3)))
            };
            series(aid, &all.clone().filter_map(at).collect::<Vec<_>>())
        };
        Panel {
            title: format!("R = {yield_n} N"),
            x: Axis::logarithmic("imposed speed (m/s)").over(0.03, 0.3),
            y: Axis::logarithmic("RMS error (mm)").over(0.01, 30.0),
            series: drawn_at(yield_n).iter().flat_map(of).collect(),
        }
    };
    Chart {
        title: format!(
            "Error at an imposed speed, circle, aim off by {} mm at rest; medians of {USERS} users, 95 % intervals",
            1e3 * AIM_M
        ),
        panels: YIELDS_N.map(panel).to_vec(),
    }
}

fn price(errors: &Table) -> Chart {
    let axes = [
        (
            "energy",
            ["energy_across_j", "energy_low_j", "energy_high_j"],
            1e3,
            Axis::logarithmic("energy given across the way (mJ)").over(0.01, 1000.0),
        ),
        ("jump", JUMP, 1e3, Axis::linear("jump when let go (mm)").over(-2.0, 42.0)),
        // The greatest force has no interval.
        ("force", ["force_max_n"; 3], 1.0, Axis::logarithmic("greatest force while tracing (N)").over(1.0, 100.0)),
    ];
    let mut panels = Vec::new();
    for (price, columns, factor, x) in axes {
        for yield_n in [YIELDS_N[0], YIELDS_N[2]] {
            let of = |aid: &Aid| {
                let at = |aim_m: f64| {
                    of_aid(of_errors(errors, GRIPS[0].name, aim_m), aid)
                        .map(|row| (row.estimate(columns, factor), row.estimate(ERROR, 1e3)))
                };
                series(aid, &AIMS_M.into_iter().filter_map(at).collect::<Vec<_>>())
            };
            panels.push(Panel {
                title: format!("{price}, R = {yield_n} N"),
                x: x.clone(),
                y: Axis::logarithmic("RMS error (mm)").over(0.01, 30.0),
                series: drawn_at(yield_n).iter().flat_map(of).collect(),
            });
        }
    }
    Chart {
        title: format!(
            "Error against its price, circle at {SPEED_M_PER_S} m/s, soft hand; medians with intervals of 95 %"
        ),
        panels,
    }
}

/// Returns the number of users for whom `row` errs less than `other` by more than [`ALIKE`], and the number of all users.
fn wins(row: &Row<'_>, other: &Row<'_>) -> (u64, u64) {
    let each = |row: &Row<'_>| -> Vec<Option<f64>> {
        row.word("each_error_um").split(' ').map(|word| word.parse().ok()).collect()
    };
    let pairs: Vec<(f64, f64)> =
        each(row).into_iter().zip(each(other)).filter_map(|(one, other)| one.zip(other)).collect();
    (pairs.iter().filter(|(one, other)| *one < ALIKE * other).count() as u64, pairs.len() as u64)
}

/// Returns the law with the least error at one R and one error of the aim, user by user. In most users, by the interval of 95 %,
/// it errs less than each other law by at least a tenth. `None` if there is no such law.
fn best<'a>(rows: &[Row<'a>], yield_n: f64, may: impl Fn(&Row<'_>) -> bool) -> Option<Law> {
    let of_law = |law: Law| {
        let aids = Aid::at(yield_n).into_iter().filter(move |aid| aid.law == law);
        let found = aids.filter_map(|aid| of_aid(rows.iter().copied(), &aid)).filter(|row| may(row));
        found.min_by(|one, other| one.number("error_rms_m").total_cmp(&other.number("error_rms_m")))
    };
    let laws: Vec<(Law, Row<'a>)> = [Law::Plastic, Law::Saturated, Law::Viscous]
        .into_iter()
        .filter_map(|law| of_law(law).map(|row| (law, row)))
        .collect();
    let is_best = |(law, row): &&(Law, Row<'a>)| {
        laws.iter().filter(|(other, _)| other != law).all(|(_, other)| {
            let (wins, users) = wins(row, other);
            wilson(wins, users)[0] > 0.5
        })
    };
    laws.iter().find(is_best).map(|(law, _)| *law)
}

/// Laws that may win a cell of the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Field {
    All,
    /// Laws that give way, and with which the tool is not thrown.
    Yielding,
}

/// The law that wins a cell of the map, if one does.
fn winner(errors: &Table, grip: &str, yield_n: f64, aim_m: f64, field: Field) -> Option<Law> {
    let rows: Vec<Row<'_>> = of_errors(errors, grip, aim_m).collect();
    let free_m = of_aid(rows.iter().copied(), &Aid::NONE).map_or(f64::NAN, |row| row.number("press_m"));
    let gives_way = |row: &Row<'_>| yield_n >= PRESS_N || row.number("press_m") > GIVES_WAY * free_m;
    let is_yielding = |row: &Row<'_>| row.number("jump_m") < THROWN_M && gives_way(row);
    best(&rows, yield_n, |row| row.number("ran") > 0.0 && (field == Field::All || is_yielding(row)))
}

fn map(errors: &Table) -> Chart {
    let mut panels = Vec::new();
    for grip in GRIPS {
        for (what, field) in [("of all laws", Field::All), ("gives way, jumps < 1 mm", Field::Yielding)] {
            let mut cells: [Vec<(f64, f64)>; 4] = Default::default();
            for (place, yield_n) in YIELDS_N.into_iter().enumerate() {
                for (of_aim, aim_m) in AIMS_M.into_iter().enumerate() {
                    let which = match winner(errors, grip.name, yield_n, aim_m, field) {
                        Some(Law::Plastic) => 0,
                        Some(Law::Saturated) => 1,
                        Some(_) => 2,
                        None => 3,
                    };
                    cells[which].push((1.0 + place as f64, 1.0 + of_aim as f64));
                }
            }
            let names = ["plastic", "a saturated spring (cross)", "viscous", "no single law"];
            let colors = [Color::Blue, Color::Orange, Color::Sky, Color::Pale];
            let mut series: Vec<Series> = (names.into_iter().zip(colors).zip(&cells))
                .map(|((name, color), points)| Series {
                    name: name.to_owned(),
                    points: points.clone(),
                    mark: Mark::Cells(CELL),
                    color,
                })
                .collect();
            series.push(Series {
                name: String::new(),
                points: cells[1].clone(),
                mark: Mark::Marks,
                color: Color::Black,
            });
            panels.push(Panel {
                title: format!("{} hand, {what}", grip.name),
                x: Axis::of_words("R (N)", YIELDS_N.map(|it| it.to_string()).to_vec()),
                y: Axis::of_words(
                    "error of the aim at rest, RMS (mm)",
                    AIMS_M.map(|it| (1e3 * it).to_string()).to_vec(),
                ),
                series,
            });
        }
    }
    Chart {
        title: format!(
            "Law of the least error at each R, by a tenth and more, user by user, circle at {SPEED_M_PER_S} m/s"
        ),
        panels,
    }
}

fn on_device(device: &Table) -> Chart {
    let colors = [Color::Vermilion, Color::Green, Color::Blue];
    let panel = |title: &str, grip: &'static str, columns: [&'static str; 3], factor: f64, y: Axis| {
        let line = |law: Law, yield_n: Option<f64>, name: String, mark: Mark, color: Color| {
            let points: Vec<_> = device::STIFFNESSES_N_PER_M
                .into_iter()
                // How far a tool jumps that swings is chance.
                .filter(|stiffness| columns != JUMP || *stiffness <= device::STIFFEST_N_PER_M)
                .filter_map(|stiffness| {
                    let aid = Aid { law, hardness: Some(stiffness), yield_n };
                    let rows = device.rows().filter(|row| row.word("grip") == grip);
                    of_aid(rows, &aid).map(|row| (Estimate::from(N_PER_MM * stiffness), row.estimate(columns, factor)))
                })
                .collect();
            Series::new(name, mark, color).through(&points)
        };
        let mut series = line(Law::Spring, None, "spring without limit".into(), Mark::MarkedLine, Color::Black);
        for (yield_n, color) in device::YIELDS_N.into_iter().zip(colors) {
            let plastic = format!("plastic, R = {yield_n} N");
            series.extend(line(Law::Plastic, Some(yield_n), plastic, Mark::MarkedLine, color));
            let spring = format!("spring, at most {yield_n} N");
            series.extend(line(Law::Saturated, Some(yield_n), spring, Mark::MarkedDashes, color));
        }
        let Axis { range, .. } = y;
        let [low, high] = range.unwrap_or([0.0, 1.0]);
        let limit = N_PER_MM * device::STIFFEST_N_PER_M;
        let name = format!("passive springs end at {limit} N/mm");
        let points = vec![(limit, low), (limit, high)];
        series.push(Series { name, points, mark: Mark::Dashed, color: Color::Black });
        Panel { title: title.to_owned(), x: Axis::logarithmic("K (N/mm)").over(0.2, 2e3), y, series }
    };
    let error = || Axis::logarithmic("RMS error (mm)").over(0.2, 12.0);
    let rest = || Axis::logarithmic("speed when nobody holds it, RMS (mm/s)").over(0.1, 1e4);
    Chart {
        title: "An impedance device of 50 g at 1 kHz; medians with intervals of 95 %".into(),
        panels: vec![
            panel("soft hand", GRIPS[0].name, ERROR, 1e3, error()),
            panel("stiff hand", GRIPS[1].name, ERROR, 1e3, error()),
            panel(
                "soft hand, after a press of 4 N",
                GRIPS[0].name,
                JUMP,
                1e3,
                Axis::linear("jump when let go (mm)").over(0.0, 8.0),
            ),
            panel("released", GRIPS[0].name, ["resting_m_per_s"; 3], 1e3, rest()),
        ],
    }
}
