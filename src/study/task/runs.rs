//! The tables: each row is a group of users under one fixture.

use std::ops::Range;

use serde_json::Value;

use super::super::sweep::{Clock, Sweep, median, median_interval};
use super::aid::{Aid, Law};
use super::device;
use super::trial::{FOUND, GRIPS, Grip, Trial};
use super::way::{WAYS, Way};

/// Mean speeds of the aim along the way, in m/s: care to a quick sweep.
pub(super) const SPEEDS_M_PER_S: [f64; 4] = [0.04, 0.08, 0.16, 0.25];
/// The speed at which the error of the aim is swept.
pub(super) const SPEED_M_PER_S: f64 = 0.08;
/// Errors of the aim at rest, RMS on each axis, in m, and the one at which speed is swept.
pub(super) const AIMS_M: [f64; 4] = [0.00125, 0.0025, 0.005, 0.01];
pub(super) const AIM_M: f64 = 0.005;
/// Errors of the aim at which rows are computed again.
pub(super) const AIMS_AGAIN_M: [f64; 2] = [0.005, 0.01];
/// Users of a row: seeds of tremor and aim.
const USERS: u64 = 24;
/// Press off the way on the rig, in N.
const PRESS_N: f64 = 16.0;

/// Which machine runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Machine {
    Rig,
    Device,
}

/// Users under one fixture.
struct Group {
    trial: Trial,
    users: Range<u64>,
    machine: Machine,
    /// What is other than in the table `errors`.
    variant: &'static str,
}

/// One table.
pub(super) struct Runs {
    name: &'static str,
    groups: Vec<Group>,
}

fn on_rig(way: Way, grip: Grip, aim_m: f64, aid: Aid, speed_m_per_s: f64) -> Trial {
    Trial { way, grip, aim_m, aid, speed_m_per_s, user: 0, press_n: PRESS_N, step_share: 1.0 }
}

fn group(trial: Trial, machine: Machine) -> Group {
    Group { trial, users: 0..USERS, machine, variant: "" }
}

impl Runs {
    /// Imposed speeds.
    pub(super) fn speeds() -> Self {
        let mut groups = Vec::new();
        for way in WAYS {
            for aid in Aid::all() {
                groups
                    .extend(SPEEDS_M_PER_S.map(|speed| group(on_rig(way, GRIPS[0], AIM_M, aid, speed), Machine::Rig)));
            }
        }
        Self { name: "speeds", groups }
    }

    /// Errors of the aim, with a soft and a stiff hand.
    pub(super) fn errors() -> Self {
        let mut groups = Vec::new();
        for grip in GRIPS {
            for aim_m in AIMS_M {
                let trial = |aid| group(on_rig(Way::Circle, grip, aim_m, aid, SPEED_M_PER_S), Machine::Rig);
                groups.extend(Aid::all().into_iter().map(trial));
            }
        }
        Self { name: "errors", groups }
    }

    /// The impedance device.
    pub(super) fn device() -> Self {
        let mut groups = Vec::new();
        for grip in GRIPS {
            let mut aids = vec![Aid::NONE];
            for stiffness in device::STIFFNESSES_N_PER_M {
                aids.push(Aid { law: Law::Spring, hardness: Some(stiffness), yield_n: None });
                for yield_n in device::YIELDS_N {
                    aids.push(Aid::saturated(stiffness, yield_n));
                    aids.push(Aid { hardness: Some(stiffness), ..Aid::plastic(yield_n) });
                }
            }
            let trial = |aid| Trial { press_n: device::PRESS_N, ..on_rig(Way::Ring, grip, AIM_M, aid, SPEED_M_PER_S) };
            groups.extend(aids.into_iter().map(|aid| group(trial(aid), Machine::Device)));
        }
        Self { name: "device", groups }
    }

    /// The rows of `errors` again for the soft hand: with other users, and with half the step of the simulation.
    pub(super) fn again() -> Self {
        let mut groups = Vec::new();
        for aim_m in AIMS_AGAIN_M {
            for aid in Aid::all() {
                let trial = on_rig(Way::Circle, GRIPS[0], aim_m, aid, SPEED_M_PER_S);
                let others = USERS..2 * USERS;
                groups.push(Group { users: others, variant: "other users", ..group(trial, Machine::Rig) });
                let trial = Trial { step_share: 0.5, ..trial };
                groups.push(Group { variant: "half the step", ..group(trial, Machine::Rig) });
            }
        }
        Self { name: "again", groups }
    }
}

impl Group {
    fn run(&self, user: u64) -> (Vec<Value>, Option<f64>) {
        let trial = Trial { user, ..self.trial };
        let ran = match self.machine {
            Machine::Rig => trial.on_rig(),
            Machine::Device => device::run(&trial),
        };
        match ran {
            Ok((outcome, moments)) => {
                let resting = Trial::resting_m_per_s(&moments);
                (trial.measured(outcome, &moments), resting)
            }
            Err(error) => {
                let mut cells = vec![Value::from(error)];
                cells.resize(FOUND.len(), Value::Null);
                (cells, None)
            }
        }
    }
}

/// Whether a run came to its end.
const RAN: &str = "ran";

impl Sweep for Runs {
    fn name(&self) -> &'static str {
        self.name
    }

    fn columns(&self) -> &'static [&'static str] {
        &[
            "variant",
            "way",
            "grip",
            "aim_rms_m",
            "law",
            "hardness",
            "yield_n",
            "speed_m_per_s",
            "users",
            "ran",
            "first_outcome",
            "error_rms_m",
            "error_low_m",
            "error_high_m",
            "error_max_m",
            "outside_share",
            "force_max_n",
            "energy_across_j",
            "energy_low_j",
            "energy_high_j",
            "press_m",
            "jump_m",
            "jump_low_m",
            "jump_high_m",
            "resting_m_per_s",
            "each_error_um",
        ]
    }

    fn points(&self) -> u64 {
        self.groups.len() as u64
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        self.with_users(index, self.groups[index as usize].users.clone())
    }
}

impl Runs {
    /// The cells of a row, of these users.
    pub(super) fn with_users(&self, index: u64, users: Range<u64>) -> Vec<Value> {
        let group = &self.groups[index as usize];
        let mut cells = vec![Value::from(group.variant)];
        cells.extend(group.trial.asked());
        let runs: Vec<_> = users.clone().map(|user| group.run(user)).collect();
        let outcome = |run: &(Vec<Value>, Option<f64>)| run.0[0].as_str().unwrap_or_default().to_owned();
        let ran = runs.iter().filter(|run| outcome(run) == RAN).count();
        let first = runs.iter().map(outcome).find(|outcome| outcome != RAN);
        // Of those that came to their end.
        let column = |name: &str| -> Vec<f64> {
            let place = FOUND.iter().position(|found| *found == name).unwrap_or(0);
            runs.iter().filter(|run| outcome(run) == RAN).filter_map(|run| run.0[place].as_f64()).collect()
        };
        let middle = |name: &str| Value::from(median(column(name)));
        let with_interval = |name: &str| {
            let interval = median_interval(column(name));
            [middle(name), interval.map(|it| it[0]).into(), interval.map(|it| it[1]).into()]
        };
        cells.extend([(users.end - users.start).into(), ran.into(), first.into()]);
        cells.extend(with_interval("error_rms_m"));
        cells.extend(["error_max_m", "outside_share", "force_max_n"].map(middle));
        cells.extend(with_interval("energy_given_across_j"));
        cells.push(middle("press_m"));
        cells.extend(with_interval("jump_back_m"));
        cells.push(median(runs.iter().filter_map(|run| run.1)).into());
        // Of each user, in order, so that two laws can be compared user by user; a dash for a run that did not come to its end.
        let each = runs.iter().map(|run| match run.0[1].as_f64().filter(|_| outcome(run) == RAN) {
            Some(error_m) => format!("{:.1}", 1e6 * error_m),
            None => "-".to_owned(),
        });
        cells.push(each.collect::<Vec<_>>().join(" ").into());
        cells
    }

    /// What a row asks, the rest empty.
    #[cfg(test)]
    pub(super) fn asked(&self, index: u64) -> Vec<Value> {
        let group = &self.groups[index as usize];
        let mut cells = vec![Value::from(group.variant)];
        cells.extend(group.trial.asked());
        cells.resize(self.columns().len(), Value::Null);
        cells
    }
}
