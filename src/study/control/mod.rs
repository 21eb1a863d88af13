//! Influence of period, delay, law, space, feed-forward and gears on a rig that traces a circle.
//!
//! Every setting has the stiffest gains that keep 6 dB and 30 degrees at every pose of the circle. All settings are therefore
//! compared at the same distance from instability: see [`servo`]. The gears are not in that model, as in `config check`. The loop
//! is the [bench](super::bench) of all studies: exact angles and forces, no bus, no counts, no guard.

mod machine;
pub(super) mod page;
mod servo;
mod trial;

use serde_json::Value;

use self::machine::Machine;
use self::servo::{GAIN_DB, PHASE_DEG, tune};
use self::trial::{MOST_DELAY, Setting, computing_s, run};
use super::chart::{Axis, Chart, Color, Mark, Panel, Series};
use super::sweep::{Clock, Report, Row, Study, Sweep, Table};
use yieldwall_config as config;
use yieldwall_motion::control::Law;
use yieldwall_run::assembly::bus_plan;

/// Radius of the circle about the origin: the paper's.
const RADIUS_M: f64 = 0.12;
const RATES_HZ: [u32; 6] = [250, 500, 1000, 2000, 4000, 8000];
const LAWS: [(Law, &str); 2] = [(Law::Psmc, "psmc"), (Law::Pid, "pid")];

/// The study `control`.
pub(super) struct Control([Box<dyn Sweep>; 3]);

impl Control {
    pub(super) fn new() -> Self {
        Self([Box::new(Settings), Box::new(BusLoad), Box::new(Computing)])
    }
}

struct Settings;

/// The setting of a point; its name of rate comes from [`RATES_HZ`].
fn setting(index: u64) -> (u32, Setting) {
    let mut rest = index as usize;
    let mut take = |count: usize| {
        let place = rest % count;
        rest /= count;
        place
    };
    let (rate, delay_cycles, law, space) = (take(RATES_HZ.len()), take(MOST_DELAY + 1), take(2), take(2));
    let (forward, gears) = (take(2), take(2));
    let setting = Setting {
        period_s: 1.0 / f64::from(RATES_HZ[rate]),
        delay_cycles,
        law: LAWS[law].0,
        is_cartesian: space == 1,
        feeds_forward: forward == 0,
        is_elastic: gears == 1,
    };
    (RATES_HZ[rate], setting)
}

impl Sweep for Settings {
    fn name(&self) -> &'static str {
        "settings"
    }

    fn columns(&self) -> Vec<&str> {
        vec![
            "rate_hz",
            "delay_cycles",
            "law",
            "space",
            "feeds_forward",
            "is_elastic",
            "outcome",
            "bandwidth",
            "crossover_hz",
            "gain_margin_db",
            "phase_margin_deg",
            "steady_rms_m",
            "whole_max_m",
            "proxy_depth_m",
            "tool_depth_m",
            "held_tool_depth_m",
            "peak_torque_n_m",
        ]
    }

    fn points(&self) -> u64 {
        (RATES_HZ.len() * (MOST_DELAY + 1) * 16) as u64
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let (rate_hz, setting) = setting(index);
        let machine = Machine::shipped();
        let law = LAWS.iter().find(|(law, _)| *law == setting.law).map_or("", |(_, name)| name);
        let mut cells: Vec<Value> = vec![
            rate_hz.into(),
            setting.delay_cycles.into(),
            law.into(),
            space(setting.is_cartesian).into(),
            setting.feeds_forward.into(),
            setting.is_elastic.into(),
        ];
        let Some(tuned) = tune(&machine, setting.is_cartesian, setting.period_s, setting.delay_cycles as f64) else {
            cells.push("no gains keep the margins".into());
            cells.resize(self.columns().len(), Value::Null);
            return cells;
        };
        let result = run(&machine, setting, tuned.gains);
        let margins = tuned.margins;
        let before = [tuned.bandwidth, margins.crossover_hz, margins.gain_db, margins.phase_deg].map(Value::from);
        match result {
            Ok(outcome) => {
                cells.push(if outcome.is_released { "released" } else { "ran" }.into());
                cells.extend(before);
                cells.extend([
                    outcome.steady_rms_m.into(),
                    outcome.whole_max_m.into(),
                    outcome.proxy_depth_m.into(),
                    outcome.tool_depth_m.into(),
                    outcome.held_tool_depth_m.into(),
                    outcome.peak_torque_n_m.into(),
                ]);
            }
            Err(error) => {
                cells.push(error.to_string().into());
                cells.extend(before);
                cells.resize(self.columns().len(), Value::Null);
            }
        }
        cells
    }
}

/// Bus load of the shipped rig at each rate.
struct BusLoad;

impl Sweep for BusLoad {
    fn name(&self) -> &'static str {
        "bus-load"
    }

    fn columns(&self) -> Vec<&str> {
        vec!["rate_hz", "cyclic_load"]
    }

    fn points(&self) -> u64 {
        RATES_HZ.len() as u64
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let rate_hz = RATES_HZ[index as usize];
        let rig = config::load_rig(config::builtin("paper-admittance.yaml"));
        let rig = rig.unwrap_or_else(|report| panic!("{report}")).value;
        let plan = bus_plan(&rig).ok().and_then(|(setup, conditions)| {
            let conditions = conditions.into_iter().next()?;
            yieldwall_bus::budget::Budget::new(&setup, conditions).ok()
        });
        let per_cycle_s = f64::from(rig.cycle.period_us) * 1e-6;
        let load = plan.map(|plan| plan.cyclic_load() * per_cycle_s * f64::from(rate_hz));
        vec![rate_hz.into(), load.into()]
    }
}

/// How long a cycle computes, by law, space and feed-forward.
struct Computing;

impl Computing {
    fn setting(index: u64) -> (&'static str, Setting) {
        let (law, name) = LAWS[(index % 2) as usize];
        let setting = Setting {
            period_s: 1e-3,
            delay_cycles: 1,
            law,
            is_cartesian: index / 2 % 2 == 1,
            feeds_forward: index / 4 == 0,
            is_elastic: false,
        };
        (name, setting)
    }
}

impl Sweep for Computing {
    fn name(&self) -> &'static str {
        "computing"
    }

    fn columns(&self) -> Vec<&str> {
        vec!["law", "space", "feeds_forward", "cycle_ns"]
    }

    fn points(&self) -> u64 {
        8
    }

    fn is_timed(&self) -> bool {
        true
    }

    fn point(&self, index: u64, clock: Clock<'_>) -> Vec<Value> {
        let (law, setting) = Self::setting(index);
        let machine = Machine::shipped();
        let tuned = tune(&machine, setting.is_cartesian, setting.period_s, setting.delay_cycles as f64);
        let time_s = tuned.and_then(|tuned| computing_s(&machine, setting, tuned.gains, clock).ok());
        vec![
            law.into(),
            space(setting.is_cartesian).into(),
            setting.feeds_forward.into(),
            time_s.map(|time_s| 1e9 * time_s).into(),
        ]
    }
}

fn space(is_cartesian: bool) -> &'static str {
    if is_cartesian { "cartesian" } else { "joint" }
}

/// Fixed parameters of one line of a chart.
#[derive(Clone, Copy)]
struct Line {
    delay_cycles: usize,
    law: &'static str,
    space: &'static str,
    feeds_forward: bool,
    is_elastic: bool,
}

const SHIPPED: Line = Line { delay_cycles: 1, law: "psmc", space: "joint", feeds_forward: true, is_elastic: false };

impl Line {
    fn holds(&self, row: &Row<'_>) -> bool {
        row.number("delay_cycles") == self.delay_cycles as f64
            && row.word("law") == self.law
            && row.word("space") == self.space
            && row.is("feeds_forward") == self.feeds_forward
            && row.is("is_elastic") == self.is_elastic
    }

    fn over_rates(&self, settings: &Table, column: &str, factor: f64) -> Vec<(f64, f64)> {
        let rows = settings.rows().filter(|row| self.holds(row));
        rows.map(|row| (row.number("rate_hz"), factor * row.number(column))).collect()
    }
}

impl Study for Control {
    fn name(&self) -> &'static str {
        "control"
    }

    fn about(&self) -> &'static str {
        "period, delay, law, space, feed-forward and gears at equal margins: path error, penetration, torque, bus load"
    }

    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.0
    }

    fn report(&self, tables: &[Table]) -> Report {
        let [settings, load, computing] = tables else { return Report::default() };
        let lines = [
            ("no delay", Line { delay_cycles: 0, ..SHIPPED }),
            ("shipped loop: PSMC, joint, 1 cycle", SHIPPED),
            ("2 cycles", Line { delay_cycles: 2, ..SHIPPED }),
            ("3 cycles", Line { delay_cycles: 3, ..SHIPPED }),
            ("Cartesian", Line { space: "cartesian", ..SHIPPED }),
            ("no feed-forward", Line { feeds_forward: false, ..SHIPPED }),
            ("elastic gears", Line { is_elastic: true, ..SHIPPED }),
        ];
        let panel = |title: &str, column: &'static str, y: Axis, factor: f64| Panel {
            title: title.to_owned(),
            x: Axis::logarithmic("rate of the loop (Hz)"),
            y,
            series: (lines.iter().zip(Color::LINES))
                .map(|((name, line), color)| Series {
                    name: (*name).to_owned(),
                    points: line.over_rates(settings, column, factor),
                    mark: Mark::MarkedLine,
                    color,
                })
                .collect(),
        };
        let chart = Chart {
            title: format!(
                "A rig that traces the circle, gains at {GAIN_DB} dB and {PHASE_DEG} degrees of an arm with stiff gears"
            ),
            panels: vec![
                panel("steady tracing, tool", "steady_rms_m", Axis::logarithmic("RMS error (um)"), 1e6),
                panel("tracing with its turn, tool", "whole_max_m", Axis::logarithmic("greatest error (um)"), 1e6),
                panel("tracing with its turn", "peak_torque_n_m", Axis::linear("greatest torque (N m)"), 1.0),
                panel("impact without a hold, proxy", "proxy_depth_m", Axis::linear("depth (mm)").over(0.0, 16.0), 1e3),
                panel("impact with automatic hold, tool", "held_tool_depth_m", Axis::logarithmic("depth (mm)"), 1e3),
                panel("crossover", "crossover_hz", Axis::logarithmic("crossover (Hz)"), 1.0),
            ],
        };
        let mut notes = vec![format!(
            "{:34} {:>7} {:>10} {:>10} {:>10} {:>10} {:>10} {:>10} {:>9}",
            "", "rate Hz", "cross. Hz", "steady um", "turn um", "proxy mm", "tool mm", "held mm", "peak N m"
        )];
        for (name, line) in lines {
            for row in settings.rows().filter(|row| line.holds(row)) {
                notes.push(format!(
                    "{name:34} {:>7} {:>10.1} {:>10.1} {:>10.1} {:>10.3} {:>10.3} {:>10.3} {:>9.1}{}",
                    row.number("rate_hz"),
                    row.number("crossover_hz"),
                    1e6 * row.number("steady_rms_m"),
                    1e6 * row.number("whole_max_m"),
                    1e3 * row.number("proxy_depth_m"),
                    1e3 * row.number("tool_depth_m"),
                    1e3 * row.number("held_tool_depth_m"),
                    row.number("peak_torque_n_m"),
                    if row.word("outcome") == "ran" { String::new() } else { format!("  {}", row.word("outcome")) },
                ));
            }
        }
        for row in load.rows() {
            let share = row.number("cyclic_load");
            let verdict = if share > 1.0 { ": more than it carries" } else { "" };
            notes.push(format!("bus of 1 Mbit/s at {} Hz: {:.0} %{verdict}", row.number("rate_hz"), 100.0 * share));
        }
        for row in computing.rows() {
            let forward = if row.is("feeds_forward") { "with" } else { "without" };
            let cycle_ns = row.number("cycle_ns");
            notes.push(format!(
                "a cycle of {}, {}, {forward} feed-forward computes for {cycle_ns:.0} ns: {:.2} % of a core at 8 kHz",
                row.word("law"),
                row.word("space"),
                cycle_ns * 8e3 * 1e-7
            ));
        }
        let ended = settings.rows().filter(|row| row.word("outcome") != "ran").count();
        notes.push(format!(
            "{ended} of {} settings did not run to their end on the circle; `released` left it while tracing",
            settings.points
        ));
        Report { notes, charts: vec![("study-control", chart)] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(setting: Setting) -> (yieldwall_motion::control::Tuned, trial::CircleTrial) {
        let machine = Machine::shipped();
        let tuned = tune(&machine, setting.is_cartesian, setting.period_s, setting.delay_cycles as f64).unwrap();
        (tuned, run(&machine, setting, tuned.gains).unwrap())
    }

    #[test]
    fn faster_loops_trace_better_and_later_torques_worse() {
        let shipped = Setting {
            period_s: 1e-3,
            delay_cycles: 1,
            law: Law::Psmc,
            is_cartesian: false,
            feeds_forward: true,
            is_elastic: false,
        };
        let (tuned, at_1_khz) = outcome(shipped);
        // The shipped gains were chosen for just these margins.
        assert!((0.8..1.3).contains(&tuned.bandwidth), "{tuned:?}");
        assert!(tuned.margins.gain_db >= GAIN_DB && tuned.margins.phase_deg >= PHASE_DEG);
        assert!(at_1_khz.steady_rms_m < 2e-4, "{at_1_khz:?}");
        let (_, at_4_khz) = outcome(Setting { period_s: 2.5e-4, ..shipped });
        let (_, late) = outcome(Setting { delay_cycles: 3, ..shipped });
        assert!(at_4_khz.whole_max_m < at_1_khz.whole_max_m && at_1_khz.whole_max_m < late.whole_max_m);
        // The law of capture: the depth of the proxy does not grow as the period shrinks.
        assert!(at_1_khz.proxy_depth_m > 0.0);
    }

    #[test]
    fn every_point_has_a_setting_of_its_own() {
        let all: Vec<_> = (0..Settings.points()).map(|index| format!("{:?}", setting(index))).collect();
        assert_eq!(all.iter().collect::<std::collections::BTreeSet<_>>().len(), all.len());
    }
}
