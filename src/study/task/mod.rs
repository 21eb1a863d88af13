//! A simulated user traces a line, a circle and a curve under each kind of fixture: time against error, and what the fixture
//! does besides.
//!
//! ```text
//! starts on the way -> traces it, aiming wrong by some millimetres -> presses off it -> lets go
//! ```
//! The user is a hand with mass, stiffness and damping, tremor as a force, and an aim that errs slowly and by more the
//! faster it moves. It supports mechanical claims (error, energy, jump), none about how well people do.

mod way;

use std::ops::ControlFlow;

use crate::elementary;
use serde_json::Value;

use self::way::{WAYS, Way, finite, positive};
use super::chart::{Axis, Chart, Color, Mark, Panel, Series};
use super::sweep::{Clock, Report, Row, Study, Sweep, Table, median};
use crate::config::{self, AimError, FixtureLaw, NotNegative, PathSegment};
use crate::injection::{Injection, Kind};
use crate::report::{Overrides, RunReport, Watch, run_rig};

/// Mean speeds of the aim along the way, in m/s: slow care to a quick sweep.
const SPEEDS_M_PER_S: [f64; 5] = [0.02, 0.04, 0.08, 0.16, 0.25];
/// Users: seeds of tremor and aim.
const USERS: u64 = 12;
/// Error of the aim at rest, RMS on each axis, in m, and how it grows with the speed, in s. Chosen: a user who does not look closely errs by half a
/// centimetre, and by as far as the aim moves in 50 ms more (that the error grows in proportion to the speed is Schmidt et
/// al. 1979, "Motor-output variability"; the size is not). The results below say what hangs on it.
const AIM_AT_REST_M: f64 = 0.005;
const AIM_PER_SPEED_S: f64 = 0.05;
/// Its corner in Hz: people move by intent below some 2 Hz.
const AIM_CORNER_HZ: f64 = 0.8;
/// Rest before the way, in s: the error of the aim has grown by its end.
const BEFORE_S: f64 = 0.5;
/// The press off the way: how far beyond it the aim goes, in m (16 N by the hand's spring), how fast and for how long, in s.
const PRESS_M: f64 = 0.04;
const PRESS_IN_S: f64 = 0.5;
const PRESS_FOR_S: f64 = 0.6;
/// How long the hand has let go at the end, in s.
const LET_GO_S: f64 = 0.8;
/// Half of the width within which the user shall stay, in m.
const HALF_WIDTH_M: f64 = 0.002;
/// A proxy that is further from the way than this, in m, has left it.
const LEFT_M: f64 = 1e-4;

/// The spring whose force has a limit.
const SATURATED: &str = "elastic, at most 20 N";

/// A fixture to trace with.
struct Aid {
    name: &'static str,
    yield_n: f64,
    law: fn() -> Option<FixtureLaw>,
}

const fn plastic(name: &'static str, yield_n: f64) -> Aid {
    Aid { name, yield_n, law: || None }
}

/// The spring is as stiff as the hand's own and more; its damping is half the critical one of M = 2 kg. The viscous field
/// is twenty times as hard across as along.
const AIDS: [Aid; 8] = [
    Aid { name: "none", yield_n: 20.0, law: || Some(FixtureLaw::Free {}) },
    Aid {
        name: "viscous",
        yield_n: 20.0,
        law: || {
            Some(FixtureLaw::Viscous { across_n_s_per_m: not_negative(200.0), along_n_s_per_m: not_negative(10.0) })
        },
    },
    Aid { name: "elastic", yield_n: 20.0, law: || Some(elastic(false)) },
    Aid { name: SATURATED, yield_n: 20.0, law: || Some(elastic(true)) },
    plastic("plastic, R = 5 N", 5.0),
    plastic("plastic, R = 10 N", 10.0),
    plastic("plastic, R = 20 N", 20.0),
    plastic("plastic, R = 40 N", 40.0),
];

fn elastic(is_saturated: bool) -> FixtureLaw {
    FixtureLaw::Elastic { stiffness_n_per_m: positive(1000.0), damping_n_s_per_m: not_negative(45.0), is_saturated }
}

fn not_negative(value: f64) -> NotNegative {
    NotNegative::new(value).unwrap_or_else(|| unreachable!("{value} is not negative"))
}

/// The study `task`.
pub(super) struct Task([Box<dyn Sweep>; 1]);

impl Task {
    pub(super) fn new() -> Self {
        Self([Box::new(Traces)])
    }
}

struct Traces;

/// One user on one way.
struct Trial {
    way: Way,
    aid: &'static Aid,
    speed_m_per_s: f64,
    user: u64,
}

impl Trial {
    fn of(index: u64) -> Self {
        let (rest, user) = (index / USERS, index % USERS);
        let (rest, speed) = (rest as usize / SPEEDS_M_PER_S.len(), rest as usize % SPEEDS_M_PER_S.len());
        let (way, aid) = (WAYS[rest / AIDS.len()], &AIDS[rest % AIDS.len()]);
        Self { way, aid, speed_m_per_s: SPEEDS_M_PER_S[speed], user }
    }

    fn trace_s(&self) -> f64 {
        self.way.length_m() / self.speed_m_per_s
    }

    fn press_from_s(&self) -> f64 {
        BEFORE_S + self.trace_s()
    }

    fn let_go_s(&self) -> f64 {
        self.press_from_s() + PRESS_IN_S + PRESS_FOR_S
    }

    /// The rig of the paper with this fixture, and a scene with this hand in place of its own.
    fn run(&self) -> Result<RunReport, String> {
        let source = config::builtin("paper-admittance.yaml");
        let loaded = config::load_rig(source).map_err(|report| report.to_string())?;
        let mut scene = loaded.scene().map_err(|report| report.to_string())?.value;
        let mut rig = loaded.value;
        rig.fixture.surface = self.way.surface();
        rig.fixture.law = (self.aid.law)();
        rig.fixture.yield_n = positive(self.aid.yield_n);
        let rms_m = AIM_AT_REST_M + AIM_PER_SPEED_S * self.speed_m_per_s;
        scene.hand.aim_error = Some(AimError { rms_m: not_negative(rms_m), corner_hz: positive(AIM_CORNER_HZ) });
        scene.hand.start_m = self.way.start_m().map(finite).to_vec();
        let mut path = vec![PathSegment::Wait { for_s: positive(BEFORE_S) }];
        path.extend(self.way.segments(self.trace_s()));
        let point_m = self.way.beyond_m(PRESS_M).map(finite).to_vec();
        path.push(PathSegment::To { point_m, in_s: positive(PRESS_IN_S) });
        path.push(PathSegment::Wait { for_s: positive(PRESS_FOR_S + LET_GO_S) });
        scene.hand.path = path;
        scene.duration_s = positive(self.let_go_s() + LET_GO_S);
        scene.seed = 1 + self.user;
        let let_go = Injection::new(Kind::HandStiff, self.let_go_s()).lasting(None).sized(0.0);
        let overrides = Overrides { faults: vec![let_go], ..Overrides::default() };
        run_rig(&rig, &scene, &overrides, Watch::default(), |_| ControlFlow::Continue(()))
            .map_err(|error| error.to_string())
    }
}

impl Sweep for Traces {
    fn name(&self) -> &'static str {
        "traces"
    }

    fn columns(&self) -> &'static [&'static str] {
        &[
            "way",
            "fixture",
            "speed_m_per_s",
            "user",
            "outcome",
            "trace_s",
            "error_rms_m",
            "error_max_m",
            "outside_share",
            "penetrations",
            "force_max_n",
            "energy_given_j",
            "energy_given_across_j",
            "press_m",
            "jump_back_m",
        ]
    }

    fn points(&self) -> u64 {
        (WAYS.len() * AIDS.len() * SPEEDS_M_PER_S.len()) as u64 * USERS
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let trial = Trial::of(index);
        let mut cells: Vec<Value> =
            vec![trial.way.name().into(), trial.aid.name.into(), trial.speed_m_per_s.into(), trial.user.into()];
        let report = match trial.run() {
            Ok(report) => report,
            Err(error) => {
                cells.push(error.into());
                cells.resize(self.columns().len(), Value::Null);
                return cells;
            }
        };
        let is_stopped = report.state.is_some_and(|state| state.is_latched());
        let cause = report.cause.filter(|_| is_stopped).map(|cause| format!("stopped by {}", cause.fault.row().name));
        let rows = &report.trace.rows;
        let between = |from_s: f64, to_s: f64| rows.iter().filter(move |row| row.time_s >= from_s && row.time_s < to_s);
        let plane = |point: [f64; 3]| [point[0], point[1]];
        let error = |row: &crate::record::Row| trial.way.distance_m(plane(row.tool_m));
        let traced: Vec<_> = between(BEFORE_S, trial.press_from_s()).collect();
        let count = traced.len().max(1) as f64;
        let square: f64 = traced.iter().map(|row| elementary::powi(error(row), 2)).sum();
        let is_off = |row: &crate::record::Row| row.signed_distance_m.abs() > LEFT_M;
        let penetrations = traced.windows(2).filter(|pair| !is_off(pair[0]) && is_off(pair[1])).count();
        let force = |row: &crate::record::Row| elementary::hypot(row.force_n[0], row.force_n[1]);
        let place = |at_s: f64| rows.iter().rfind(|row| row.time_s < at_s).map(|row| plane(row.tool_m));
        let pressed = place(trial.let_go_s()).map(|at| trial.way.distance_m(at));
        let jump = pressed.zip(rows.last()).map(|(pressed, last)| pressed - error(last));
        // What is given along the way is the momentum of tool and proxy; what a fixture stores comes back across it.
        let across_w = |row: &crate::record::Row| {
            let [x, y] = trial.way.normal(plane(row.tool_m));
            let force = row.force_n[0] * x + row.force_n[1] * y;
            -force * (row.tool_velocity_m_per_s[0] * x + row.tool_velocity_m_per_s[1] * y)
        };
        let period_s = report.period_s;
        let across_j: f64 = rows.iter().map(|row| across_w(row).max(0.0) * period_s).sum();
        cells.extend([
            cause.unwrap_or_else(|| "ran".to_owned()).into(),
            trial.trace_s().into(),
            (square / count).sqrt().into(),
            traced.iter().map(|row| error(row)).fold(0.0, f64::max).into(),
            (traced.iter().filter(|row| error(row) > HALF_WIDTH_M).count() as f64 / count).into(),
            // Only a plastic fixture has a proxy that can be on the way or off it.
            (trial.aid.law)().map_or(Value::from(penetrations), |_| Value::Null),
            traced.iter().map(|row| force(row)).fold(0.0, f64::max).into(),
            report.measures.energy_given_j.into(),
            across_j.into(),
            pressed.into(),
            jump.into(),
        ]);
        cells
    }
}

/// A column of all users.
fn of_users(table: &Table, way: Way, aid: &Aid, speed: f64, column: &str) -> Vec<f64> {
    let is_meant = |row: &Row<'_>| {
        row.word("way") == way.name() && row.word("fixture") == aid.name && row.number("speed_m_per_s") == speed
    };
    table.rows().filter(is_meant).map(|row| row.number(column)).collect()
}

/// How the users are taken together; not a number if there is none.
type Together = fn(Vec<f64>) -> f64;

fn middle(values: Vec<f64>) -> f64 {
    median(values).unwrap_or(f64::NAN)
}

/// Of small counts, which a median would hide.
fn mean(values: Vec<f64>) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

impl Study for Task {
    fn name(&self) -> &'static str {
        "task"
    }

    fn about(&self) -> &'static str {
        "a simulated user traces line, circle and curve under each fixture: time against error, energy, jump on release"
    }

    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.0
    }

    fn report(&self, tables: &[Table]) -> Report {
        let [traces] = tables else { return Report::default() };
        let colors = [
            Color::Black,
            Color::Sky,
            Color::Orange,
            Color::Vermilion,
            Color::Pale,
            Color::Purple,
            Color::Green,
            Color::Blue,
        ];
        let chart_of = |title: &str, axis: Axis, column: &'static str, factor: f64, together: Together| {
            let curve = |way: Way, aid: &Aid, color| Series {
                name: aid.name.to_owned(),
                points: SPEEDS_M_PER_S
                    .map(|speed| (0.1 / speed, factor * together(of_users(traces, way, aid, speed, column))))
                    .to_vec(),
                // Dashes let the other spring be seen, on which this one lies.
                mark: if aid.name == SATURATED { Mark::MarkedDashes } else { Mark::MarkedLine },
                color,
            };
            let panels = WAYS.map(|way| Panel {
                title: way.name().to_owned(),
                x: Axis::logarithmic("time for 100 mm of the way (s)"),
                y: axis.clone(),
                series: (AIDS.iter().zip(colors))
                    .map(|(aid, color)| curve(way, aid, color))
                    .filter(|series| series.points.iter().any(|point| point.1.is_finite()))
                    .collect(),
            });
            Chart { title: title.to_owned(), panels: panels.to_vec(), columns: WAYS.len() }
        };
        let mut notes = vec![format!(
            "{:22} {:>9} {:>9} {:>9} {:>12} {:>10} {:>10} {:>9}",
            "circle, medians", "speed m/s", "RMS mm", "max mm", "leaves, mean", "across mJ", "press mm", "back mm"
        )];
        for aid in &AIDS {
            for speed in SPEEDS_M_PER_S {
                let value = |column| middle(of_users(traces, Way::Circle, aid, speed, column));
                let penetrations = mean(of_users(traces, Way::Circle, aid, speed, "penetrations"));
                let count = if penetrations.is_nan() { String::new() } else { format!("{penetrations:.1}") };
                notes.push(format!(
                    "{:22} {speed:>9.2} {:>9.3} {:>9.3} {count:>12} {:>10.2} {:>10.2} {:>9.3}",
                    aid.name,
                    1e3 * value("error_rms_m"),
                    1e3 * value("error_max_m"),
                    1e3 * value("energy_given_across_j"),
                    1e3 * value("press_m"),
                    // A zero without its sign.
                    1e-3 * (1e6 * value("jump_back_m")).round() + 0.0,
                ));
            }
        }
        notes.push(
            "a simulated user supports mechanical claims only: error, energy, jump; none about people".to_owned(),
        );
        let stopped: Vec<_> = traces.rows().filter(|row| row.word("outcome") != "ran").collect();
        notes.push(format!("{} of {} runs did not come to their end", stopped.len(), traces.points));
        notes.extend(stopped.iter().take(10).map(|row| format!("  {}: {}", row.command("task"), row.word("outcome"))));
        let charts = vec![
            (
                "study-task-error",
                chart_of(
                    "Time against error, medians",
                    Axis::logarithmic("RMS error (mm)"),
                    "error_rms_m",
                    1e3,
                    middle,
                ),
            ),
            (
                "study-task-energy",
                chart_of(
                    "Energy given to the hand across the way, medians",
                    Axis::logarithmic("energy (mJ)"),
                    "energy_given_across_j",
                    1e3,
                    middle,
                ),
            ),
            (
                "study-task-jump",
                chart_of(
                    "Jump back when the hand lets go, medians",
                    Axis::linear("jump (mm)"),
                    "jump_back_m",
                    1e3,
                    middle,
                ),
            ),
            (
                "study-task-penetrations",
                chart_of(
                    "How often a user who traces leaves a plastic guide, mean of the users",
                    Axis::linear("times a trace"),
                    "penetrations",
                    1.0,
                    mean,
                ),
            ),
        ];
        Report { notes, charts }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// The point of a trial as JSON.
    fn trial(way: Way, aid: &str, speed: f64) -> Value {
        let index = (0..Traces.points())
            .find(|&index| {
                let trial = Trial::of(index);
                trial.way == way && trial.aid.name == aid && trial.speed_m_per_s == speed
            })
            .unwrap();
        let mut table = Table::new(&Traces);
        table.insert(index, Traces.point(index, &|| Duration::ZERO));
        table.rows().next().unwrap().json()
    }

    #[test]
    fn a_plastic_guide_holds_the_user_on_the_way_and_does_not_throw_the_tool() {
        for way in WAYS {
            let free = trial(way, "none", 0.16);
            let spring = trial(way, "elastic", 0.16);
            let plastic = trial(way, "plastic, R = 20 N", 0.16);
            for run in [&free, &spring, &plastic] {
                assert_eq!(run["outcome"], "ran", "{run}");
            }
            let number = |run: &Value, column: &str| run[column].as_f64().unwrap();
            assert!(number(&plastic, "error_rms_m") < 0.2 * number(&spring, "error_rms_m"), "{plastic} {spring}");
            assert!(number(&spring, "error_rms_m") < number(&free, "error_rms_m"), "{spring} {free}");
            assert!(number(&spring, "jump_back_m") > 0.004, "{spring}");
            assert!(number(&plastic, "jump_back_m") < 0.001, "{plastic}");
        }
    }
}
