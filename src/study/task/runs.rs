//! The tables: each row is a group of users under one fixture.

use std::ops::Range;

use serde_json::Value;

use super::super::sweep::{Clock, Sweep, median, median_interval, wilson};
use super::aid::{Aid, Law};
use super::device;
use super::trial::{FOUND, GRIPS, Grip, Trial};
use super::way::Way;

/// Mean speed of the aim along the way, in m/s, at which the error of the aim is swept.
pub(super) const SPEED_M_PER_S: f64 = 0.08;
/// The other ones: care to a quick sweep.
pub(super) const OTHER_SPEEDS_M_PER_S: [f64; 3] = [0.04, 0.16, 0.25];
/// Errors of the aim at rest, RMS on each axis, in m, and the one at which speed is swept.
pub(super) const AIMS_M: [f64; 4] = [0.00125, 0.0025, 0.005, 0.01];
pub(super) const AIM_M: f64 = 0.005;
/// Errors of the aim at which rows are computed again.
pub(super) const AIMS_AGAIN_M: [f64; 2] = [0.005, 0.01];
/// Users of a row: seeds of tremor and aim.
pub(super) const USERS: u64 = 100;
/// Users who are run on the whole rig and with half the step too.
const FEW_USERS: u64 = 6;
/// Press off the way on the rig, in N.
pub(super) const PRESS_N: f64 = 16.0;

/// Variants of the table `again`.
pub(super) const OTHER: &str = "other users";
pub(super) const HALF: &str = "half of the users";
pub(super) const FEW: &str = "few users";
pub(super) const FINE: &str = "few users, half the step";
pub(super) const RIG: &str = "few users, whole rig";

/// Machine that runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Machine {
    /// The arm of the rig with fixture and servo.
    Bench,
    /// The arm with bus, counts, noise and guard.
    Rig,
    Device,
}

/// Users under one fixture.
#[derive(Clone)]
struct Group {
    trial: Trial,
    users: Range<u64>,
    machine: Machine,
    /// Difference from the table `errors`.
    variant: &'static str,
}

/// One table.
pub(super) struct Runs {
    name: &'static str,
    groups: Vec<Group>,
    /// Whether the error of each user is kept.
    keeps_each: bool,
}

fn trial(way: Way, grip: Grip, aim_m: f64, aid: Aid, speed_m_per_s: f64) -> Trial {
    Trial { way, grip, aim_m, aid, speed_m_per_s, user: 0, press_n: PRESS_N, step_share: 1.0 }
}

fn group(trial: Trial, machine: Machine) -> Group {
    Group { trial, users: 0..USERS, machine, variant: "" }
}

/// The soft hand on the circle.
fn soft(aim_m: f64, aid: Aid, speed_m_per_s: f64) -> Trial {
    trial(Way::Circle, GRIPS[0], aim_m, aid, speed_m_per_s)
}

impl Runs {
    /// Imposed speeds, without the speed of `errors`, which is there.
    pub(super) fn speeds() -> Self {
        let mut groups = Vec::new();
        for aid in Aid::all() {
            groups.extend(OTHER_SPEEDS_M_PER_S.map(|speed| group(soft(AIM_M, aid, speed), Machine::Bench)));
        }
        Self { name: "speeds", groups, keeps_each: false }
    }

    /// Errors of the aim, with a soft and a stiff hand.
    pub(super) fn errors() -> Self {
        let mut groups = Vec::new();
        for grip in GRIPS {
            for aim_m in AIMS_M {
                let of = |aid| group(trial(Way::Circle, grip, aim_m, aid, SPEED_M_PER_S), Machine::Bench);
                groups.extend(Aid::all().into_iter().map(of));
            }
        }
        Self { name: "errors", groups, keeps_each: true }
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
            let of = |aid| Trial { press_n: device::PRESS_N, ..trial(Way::Ring, grip, AIM_M, aid, SPEED_M_PER_S) };
            groups.extend(aids.into_iter().map(|aid| group(of(aid), Machine::Device)));
        }
        Self { name: "device", groups, keeps_each: false }
    }

    /// The rows of `errors` again for the soft hand: with other users, and at one error of the aim with half of the users. Then few users as
    /// there, with half the step of the simulation, and on the whole rig.
    pub(super) fn again() -> Self {
        let mut groups = Vec::new();
        for aim_m in AIMS_AGAIN_M {
            for aid in Aid::all() {
                let all = group(soft(aim_m, aid, SPEED_M_PER_S), Machine::Bench);
                groups.push(Group { variant: OTHER, users: USERS..2 * USERS, ..all });
            }
        }
        for aid in Aid::all() {
            let all = group(soft(AIM_M, aid, SPEED_M_PER_S), Machine::Bench);
            let few = Group { variant: FEW, users: 0..FEW_USERS, ..all.clone() };
            groups.push(Group { variant: HALF, users: 0..USERS / 2, ..all });
            let trial = Trial { step_share: 0.5, ..few.trial };
            groups.push(few.clone());
            groups.push(Group { variant: FINE, trial, ..few.clone() });
            groups.push(Group { variant: RIG, machine: Machine::Rig, ..few });
        }
        Self { name: "again", groups, keeps_each: false }
    }
}

impl Group {
    fn run(&self, user: u64) -> (Vec<Value>, Option<f64>) {
        let trial = Trial { user, ..self.trial };
        let ran = match self.machine {
            Machine::Bench => trial.on_bench(),
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

    fn columns(&self) -> Vec<&str> {
        vec![
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
            "inside",
            "inside_low",
            "inside_high",
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
        cells.push(middle("error_max_m"));
        // Those who never left the band.
        let inside = column("outside_share").into_iter().filter(|share| *share == 0.0).count();
        let [low, high] = wilson(inside as u64, ran as u64);
        cells.extend([inside.into(), low.into(), high.into()]);
        cells.extend(["outside_share", "force_max_n"].map(middle));
        cells.extend(with_interval("energy_given_across_j"));
        cells.push(middle("press_m"));
        cells.extend(with_interval("jump_back_m"));
        cells.push(median(runs.iter().filter_map(|run| run.1)).into());
        // Of each user, in order, so that two laws can be compared user by user; a dash for a run that did not come to its end.
        let each = runs.iter().map(|run| match run.0[1].as_f64().filter(|_| outcome(run) == RAN) {
            Some(error_m) if error_m < 1e-4 => format!("{:.1}", 1e6 * error_m),
            Some(error_m) => format!("{:.0}", 1e6 * error_m),
            None => "-".to_owned(),
        });
        cells.push(self.keeps_each.then(|| each.collect::<Vec<_>>().join(" ")).into());
        cells
    }

    /// Returns the parameters of a row; the rest is empty.
    #[cfg(test)]
    pub(super) fn asked(&self, index: u64) -> Vec<Value> {
        let group = &self.groups[index as usize];
        let mut cells = vec![Value::from(group.variant)];
        cells.extend(group.trial.asked());
        cells.resize(self.columns().len(), Value::Null);
        cells
    }
}
