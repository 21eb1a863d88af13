//! Cycle time against accuracy and stability of the whole rig: CAN and EtherCAT, drives in torque, velocity and position mode.
//!
//! Every rig has the gains that `tune gains` proposes. Loops that this program closes are therefore compared at the same distance
//! from instability. Every rig computes as early as its bus allows. A rig whose bus cannot keep the cycle is refused and not run.

mod draw;
mod machine;
pub(super) mod page;
mod trial;

use serde_json::Value;

use self::machine::{MODES, Machine, Mode, PERIODS_US, Setting, WIRES, Wire};
use self::trial::{Found, IMPACTS, computing_s, least_kg, strike};
use super::sweep::{Clock, Report, Row, Study, Sweep, Table, median, median_interval, wilson};

/// The study `cycle`.
pub(super) struct CycleStudy([Box<dyn Sweep>; 4]);

impl CycleStudy {
    pub(super) fn new() -> Self {
        Self([Box::new(Rigs), Box::new(Shortest), Box::new(Again), Box::new(Computing)])
    }
}

/// The word of a rig that was run.
const RAN: &str = "ran";
const REFUSED: &str = "refused by the bus budget";

/// The rigs.
struct Rigs;

/// A median with its interval.
fn with_interval(found: &[Found], of: fn(&Found) -> f64) -> [Value; 3] {
    let interval = median_interval(found.iter().map(of));
    [median(found.iter().map(of)).into(), interval.map(|it| it[0]).into(), interval.map(|it| it[1]).into()]
}

/// Returns the values of the columns [`MOTION`]: a trace, and impacts in all phases of the cycle.
fn motion(machine: &Machine) -> Vec<Value> {
    let strikes = |has_hold: bool| -> (Vec<Found>, Option<String>) {
        let (mut found, mut why) = (Vec::new(), None);
        for number in 0..IMPACTS {
            match strike(machine, f64::from(number) / f64::from(IMPACTS), has_hold, false) {
                Ok(one) => found.push(one),
                Err(error) => why = Some(error),
            }
        }
        (found, why)
    };
    let ((free, free_why), (held, held_why)) = (strikes(false), strikes(true));
    let (traced, outcome) = match strike(machine, 0.0, true, true) {
        Ok(traced) => (Some(traced), RAN.to_owned()),
        Err(error) => (None, error),
    };
    let through = free.iter().filter(|found| found.is_through()).count() as u64;
    let [low, high] = wilson(through, free.len() as u64);
    let mut cells: Vec<Value> = vec![
        outcome.into(),
        traced.map(|found| found.error_rms_m).into(),
        traced.map(|found| found.error_max_m).into(),
        free.len().into(),
        free_why.or(held_why).into(),
        through.into(),
        low.into(),
        high.into(),
    ];
    cells.extend(with_interval(&free, |found| found.proxy_depth_m));
    cells.push(held.iter().filter(|found| found.is_through()).count().into());
    cells.extend(with_interval(&held, |found| found.tool_depth_m));
    cells
}

/// Columns of [`motion`].
macro_rules! with_motion {
    ([$($before:literal),*], [$($behind:literal),*]) => {
        vec![
            $($before,)*
            "outcome",
            "error_rms_m",
            "error_max_m",
            "impacts",
            "impact_outcome",
            "through",
            "through_low",
            "through_high",
            "proxy_depth_m",
            "proxy_low_m",
            "proxy_high_m",
            "held_through",
            "held_tool_depth_m",
            "held_tool_low_m",
            "held_tool_high_m",
            $($behind,)*
        ]
    };
}

/// The least virtual mass as it is printed, and as runs show it.
fn stability(machine: &Machine) -> [Value; 3] {
    match least_kg(machine) {
        Ok((printed_kg, run_kg)) => [printed_kg.into(), run_kg.into(), Value::Null],
        Err(error) => [Value::Null, Value::Null, error.into()],
    }
}

impl Sweep for Rigs {
    fn name(&self) -> &'static str {
        "rigs"
    }

    fn columns(&self) -> Vec<&str> {
        with_motion!(
            [
                "bus",
                "mode",
                "period_ms",
                "bus_load",
                "compute_at_us",
                "sample_hz",
                "gain",
                "gain_margin_db",
                "phase_margin_deg"
            ],
            ["printed_least_kg", "run_least_kg", "least_outcome"]
        )
    }

    fn points(&self) -> u64 {
        (PERIODS_US.len() * WIRES.len() * MODES.len()) as u64
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let setting = Setting::of(index);
        let period_ms = f64::from(setting.period_us) / 1000.0;
        let mut cells: Vec<Value> = vec![setting.wire.name().into(), setting.mode.name().into(), period_ms.into()];
        match setting.machine() {
            Ok(machine) => {
                let servo = machine.servo;
                cells.extend([
                    machine.carried.load.into(),
                    machine.rig.cycle.compute_at_us.into(),
                    machine.rig.sensor.sample_rate_hz.get().into(),
                    servo.map(|servo| servo.gain).into(),
                    servo.map(|servo| servo.gain_db).into(),
                    servo.map(|servo| servo.phase_deg).into(),
                ]);
                match (machine.carried.is_in_time, servo) {
                    (false, _) => cells.push(REFUSED.into()),
                    (true, None) => cells.push("no gains keep the margins".into()),
                    (true, Some(_)) => {
                        cells.extend(motion(&machine));
                        cells.extend(stability(&machine));
                    }
                }
            }
            Err(error) => {
                cells.resize(9, Value::Null);
                cells.push(error.into());
            }
        }
        cells.resize(self.columns().len(), Value::Null);
        cells
    }
}

/// Rigs again: with half the step of the simulation, and with another seed of the sensor's noise.
struct Again;

const AGAIN: [&str; 2] = ["half the step", "another seed"];

impl Sweep for Again {
    fn name(&self) -> &'static str {
        "again"
    }

    fn columns(&self) -> Vec<&str> {
        with_motion!(["variant", "bus", "mode", "period_ms"], [])
    }

    fn points(&self) -> u64 {
        AGAIN.len() as u64 * Rigs.points()
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let setting = Setting::of(index % Rigs.points());
        let variant = AGAIN[(index / Rigs.points()) as usize];
        let period_ms = f64::from(setting.period_us) / 1000.0;
        let mut cells: Vec<Value> =
            vec![variant.into(), setting.wire.name().into(), setting.mode.name().into(), period_ms.into()];
        match setting.machine() {
            Ok(machine) if !machine.carried.is_in_time => cells.push(REFUSED.into()),
            Ok(mut machine) => {
                match &mut machine.scene.model {
                    Some(model) if variant == AGAIN[0] => model.plant_step_us /= 2,
                    _ => machine.scene.seed += 1,
                }
                cells.extend(motion(&machine));
            }
            Err(error) => cells.push(error.into()),
        }
        cells.resize(self.columns().len(), Value::Null);
        cells
    }
}

/// The shortest cycle whose frames a bus carries in time.
struct Shortest;

impl Sweep for Shortest {
    fn name(&self) -> &'static str {
        "shortest"
    }

    fn columns(&self) -> Vec<&str> {
        vec!["bus", "mode", "shortest_ms", "bus_load", "outcome"]
    }

    fn points(&self) -> u64 {
        (WIRES.len() * MODES.len()) as u64
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let setting = of_pair(index);
        let (found, outcome) = match setting.shortest() {
            Ok(found) => (found, RAN.to_owned()),
            Err(error) => (None, error),
        };
        vec![
            setting.wire.name().into(),
            setting.mode.name().into(),
            found.map(|(period_us, _)| f64::from(period_us) / 1000.0).into(),
            found.map(|(_, carried)| carried.load).into(),
            outcome.into(),
        ]
    }
}

/// How long a control step is computed, by bus and mode, at 1 ms.
struct Computing;

const COMPUTING_US: u32 = 1000;

/// A bus and a mode at 1 ms.
fn of_pair(index: u64) -> Setting {
    let index = index as usize;
    Setting { wire: WIRES[index % WIRES.len()], mode: MODES[index / WIRES.len()], period_us: COMPUTING_US }
}

impl Sweep for Computing {
    fn name(&self) -> &'static str {
        "computing"
    }

    fn columns(&self) -> Vec<&str> {
        vec!["bus", "mode", "step_ns", "outcome"]
    }

    fn points(&self) -> u64 {
        (WIRES.len() * MODES.len()) as u64
    }

    fn is_timed(&self) -> bool {
        true
    }

    fn point(&self, index: u64, clock: Clock<'_>) -> Vec<Value> {
        let setting = of_pair(index);
        let time = setting.machine().and_then(|machine| computing_s(&machine.rig, &machine.scene, clock));
        let (step_ns, outcome) = match time {
            Ok(time_s) => (Some(1e9 * time_s), RAN.to_owned()),
            Err(error) => (None, error),
        };
        vec![setting.wire.name().into(), setting.mode.name().into(), step_ns.into(), outcome.into()]
    }
}

/// The rows of a bus and a mode.
fn of(table: &Table, wire: Wire, mode: Mode) -> impl Iterator<Item = Row<'_>> {
    table.rows().filter(move |row| row.word("bus") == wire.name() && row.word("mode") == mode.name())
}

/// By how much a number of the rigs moves in a variant, at most, in percent.
fn moved(rigs: &Table, again: &Table, variant: &str, column: &str) -> Option<String> {
    let key = |row: &Row<'_>| format!("{}, {}, {} ms", row.word("bus"), row.word("mode"), row.number("period_ms"));
    let moves = again.rows().filter(|row| row.word("variant") == variant).filter_map(|row| {
        let before = rigs.rows().find(|before| key(before) == key(&row))?.number(column);
        Some((100.0 * (row.number(column) / before - 1.0).abs(), key(&row))).filter(|(percent, _)| percent.is_finite())
    });
    let (percent, of) = moves.max_by(|one, other| one.0.total_cmp(&other.0))?;
    Some(format!("{variant}: {column} moves by {percent:.1} % at most ({of})"))
}

impl Study for CycleStudy {
    fn name(&self) -> &'static str {
        "cycle"
    }

    fn about(&self) -> &'static str {
        "cycle time of the whole rig on CAN and EtherCAT: path error, penetration, least virtual mass, bus load, computing time"
    }

    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.0
    }

    fn report(&self, tables: &[Table]) -> Report {
        let [rigs, shortest, again, computing] = tables else { return Report::default() };
        let mut notes = vec![format!(
            "{:9} {:23} {:>6} {:>7} {:>10} {:>9} {:>9} {:>9} {:>8} {:>8}  outcome",
            "bus", "mode", "ms", "load %", "RMS um", "max um", "proxy mm", "held mm", "least kg", "runs kg"
        )];
        for row in rigs.rows() {
            notes.push(format!(
                "{:9} {:23} {:>6} {:>7.1} {:>10.1} {:>9.1} {:>9.3} {:>9.3} {:>8.3} {:>8.3}  {}",
                row.word("bus"),
                row.word("mode"),
                row.number("period_ms"),
                100.0 * row.number("bus_load"),
                1e6 * row.number("error_rms_m"),
                1e6 * row.number("error_max_m"),
                1e3 * row.number("proxy_depth_m"),
                1e3 * row.number("held_tool_depth_m"),
                row.number("printed_least_kg"),
                row.number("run_least_kg"),
                row.word("outcome"),
            ));
        }
        for row in shortest.rows() {
            notes.push(format!(
                "{}, {}: the shortest cycle that the frames leave is {} ms, with a load of {:.0} %",
                row.word("bus"),
                row.word("mode"),
                row.number("shortest_ms"),
                100.0 * row.number("bus_load")
            ));
        }
        for variant in AGAIN {
            for column in ["error_rms_m", "held_tool_depth_m", "proxy_depth_m"] {
                notes.extend(moved(rigs, again, variant, column));
            }
        }
        for row in computing.rows() {
            notes.push(format!(
                "{}, {}: a control step is computed in {:.0} ns (measured)",
                row.word("bus"),
                row.word("mode"),
                row.number("step_ns")
            ));
        }
        Report { notes, charts: vec![("study-cycle", draw::chart(rigs, computing))] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn can_ends_where_its_budget_refuses_and_ethercat_goes_on() {
        let carried = |wire, period_us| {
            let setting = Setting { wire, mode: Mode::Torque, period_us };
            setting.machine().unwrap().carried
        };
        assert!(carried(Wire::Can, 1000).is_in_time && !carried(Wire::Can, 500).is_in_time);
        assert!(carried(Wire::Can, 500).load > 1.0);
        assert!(carried(Wire::Ethercat, 250).is_in_time);
    }

    /// On EtherCAT the sample lies behind SYNC0, at which drives in position mode begin another line.
    #[test]
    fn what_is_printed_of_a_rig_on_ethercat_is_what_its_runs_show() {
        let usual = crate::sample::share([500, 1000, 5000], 1).into_iter().map(|period_us| (Mode::Position, period_us));
        for (mode, period_us) in usual.chain([(Mode::StiffPosition, 10_000)]) {
            let setting = Setting { wire: Wire::Ethercat, mode, period_us };
            let (printed_kg, run_kg) = least_kg(&setting.machine().unwrap()).unwrap();
            let ratio = printed_kg.unwrap() / run_kg.unwrap();
            assert!((0.97..1.03).contains(&ratio), "{mode:?}, {period_us} us: {printed_kg:?} {run_kg:?}");
        }
    }

    #[test]
    fn every_rig_has_the_margins_of_the_rule() {
        for index in 0..Rigs.points() {
            let setting = Setting::of(index);
            let servo = setting.machine().unwrap().servo.unwrap_or_else(|| panic!("{setting:?}"));
            assert!(servo.gain_db >= 6.0 && servo.phase_deg >= 45.0, "{setting:?}: {servo:?}");
        }
    }
}
