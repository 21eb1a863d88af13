//! The tables: each row is a group of users under one fixture.

use std::ops::Range;

use serde_json::Value;

use super::super::sweep::{Clock, Sweep, median, median_interval, wilson};
use super::super::task::{Aid, GRIPS, Grip};
use super::track::Track;
use super::trial::{Trial, UserRun};
use super::user::Policy;

/// Widths of the band, in m.
pub(super) const WIDTHS_M: [f64; 5] = [0.002, 0.004, 0.008, 0.016, 0.032];
/// Widths at which the user is varied and rows are computed again.
pub(super) const WIDTHS_AGAIN_M: [f64; 2] = [0.004, 0.016];
/// How far the reference lies beside the way, in m, and the width of the band there.
pub(super) const BESIDE_M: [f64; 4] = [0.001, 0.002, 0.004, 0.008];
pub(super) const WIDTH_BESIDE_M: f64 = 0.008;
/// Yield forces, in N.
pub(super) const YIELDS_N: [f64; 2] = [5.0, 20.0];
/// Users of a row: seeds of aim and tremor.
pub(super) const USERS: u64 = 40;
/// Lengths of the way on the circle over the usual one.
pub(super) const LENGTH_SHARES: [f64; 2] = [0.5, 1.5];
/// The laws that are tried at those.
pub(super) const AIDS_AT_LENGTHS: [Aid; 3] = [Aid::NONE, Aid::plastic(YIELDS_N[0]), Aid::plastic(YIELDS_N[1])];

/// The soft hand with four times its damping: 0.5 of the critical one with the virtual mass of the rig.
const DAMPED: Grip = Grip { name: "damped", damping_n_s_per_m: 32.0, ..GRIPS[0] };

/// The user whose numbers are varied one at a time.
pub(super) const USUAL: Policy = Policy {
    grip: GRIPS[0],
    delay_s: 0.2,
    caution: 1.0,
    correction_per_s: 2.0,
    free_m_per_s: 0.3,
    regains_s: 1.0,
    rest_m: 0.0003,
    per_speed_s: 0.025,
};

/// The user with one number changed, and its name.
pub(super) const VARIED: [(&str, Policy); 14] = [
    ("delay 150 ms", Policy { delay_s: 0.15, ..USUAL }),
    ("delay 250 ms", Policy { delay_s: 0.25, ..USUAL }),
    ("caution 0.5", Policy { caution: 0.5, ..USUAL }),
    ("caution 2", Policy { caution: 2.0, ..USUAL }),
    ("correction 1/s", Policy { correction_per_s: 1.0, ..USUAL }),
    ("correction 4/s", Policy { correction_per_s: 4.0, ..USUAL }),
    ("free at 0.15 m/s", Policy { free_m_per_s: 0.15, ..USUAL }),
    ("free at 0.6 m/s", Policy { free_m_per_s: 0.6, ..USUAL }),
    ("regains in 0.5 s", Policy { regains_s: 0.5, ..USUAL }),
    ("regains in 2 s", Policy { regains_s: 2.0, ..USUAL }),
    ("half the noise", Policy { rest_m: 0.00015, per_speed_s: 0.0125, ..USUAL }),
    ("twice the noise", Policy { rest_m: 0.0006, per_speed_s: 0.05, ..USUAL }),
    ("stiff hand", Policy { grip: GRIPS[1], ..USUAL }),
    ("damped hand", Policy { grip: DAMPED, ..USUAL }),
];

/// The laws that stand beside each other: none, and at each R plastic, springs that are cut to R, and viscous fields.
pub(super) fn aids() -> Vec<Aid> {
    let at = |yield_n| {
        [
            Aid::plastic(yield_n),
            Aid::saturated(1e3, yield_n),
            Aid::saturated(1e5, yield_n),
            Aid::viscous(0.1, yield_n),
            Aid::viscous(0.01, yield_n),
        ]
    };
    [Aid::NONE].into_iter().chain(YIELDS_N.into_iter().flat_map(at)).collect()
}

/// Users under one fixture.
struct Group {
    trial: Trial,
    users: Range<u64>,
    /// Difference from the table `widths`.
    variant: &'static str,
}

/// One table.
pub(super) struct Runs {
    name: &'static str,
    groups: Vec<Group>,
}

fn trial(policy: Policy, track: Track, width_m: f64, aid: Aid) -> Trial {
    Trial { policy, track, length_share: 1.0, width_m, aid, beside_m: 0.0, step_share: 1.0 }
}

fn group(trial: Trial, variant: &'static str) -> Group {
    Group { trial, users: 0..USERS, variant }
}

impl Runs {
    /// Widths of the band, on both ways.
    pub(super) fn widths() -> Self {
        let mut groups = Vec::new();
        for track in [Track::Circle, Track::Line] {
            for aid in aids() {
                groups.extend(WIDTHS_M.map(|width_m| group(trial(USUAL, track, width_m, aid), "")));
            }
        }
        Self { name: "widths", groups }
    }

    /// Widths of the band on shorter and longer ways on the circle.
    pub(super) fn lengths() -> Self {
        let mut groups = Vec::new();
        for length_share in LENGTH_SHARES {
            for aid in AIDS_AT_LENGTHS {
                let of = |width_m| Trial { length_share, ..trial(USUAL, Track::Circle, width_m, aid) };
                groups.extend(WIDTHS_M.map(|width_m| group(of(width_m), "")));
            }
        }
        Self { name: "lengths", groups }
    }

    /// Users of other numbers, on the circle.
    pub(super) fn varied() -> Self {
        let mut groups = Vec::new();
        for (variant, policy) in VARIED {
            for aid in aids() {
                groups.extend(WIDTHS_AGAIN_M.map(|width_m| group(trial(policy, Track::Circle, width_m, aid), variant)));
            }
        }
        Self { name: "varied", groups }
    }

    /// A fixture whose reference lies beside the way.
    pub(super) fn beside() -> Self {
        let mut groups = Vec::new();
        for beside_m in BESIDE_M {
            let of = |aid| Trial { beside_m, ..trial(USUAL, Track::Circle, WIDTH_BESIDE_M, aid) };
            groups.extend(aids().into_iter().map(|aid| group(of(aid), "")));
        }
        Self { name: "beside", groups }
    }

    /// Rows of `widths` again: with other users, with twice as many, and with half the step of the simulation.
    pub(super) fn again() -> Self {
        let mut groups = Vec::new();
        for aid in aids() {
            for width_m in WIDTHS_AGAIN_M {
                let trial = trial(USUAL, Track::Circle, width_m, aid);
                groups.push(Group { users: USERS..2 * USERS, ..group(trial, "other users") });
                groups.push(Group { users: 0..2 * USERS, ..group(trial, "twice the users") });
                groups.push(group(Trial { step_share: 0.5, ..trial }, "half the step"));
            }
        }
        Self { name: "again", groups }
    }
}

impl Group {
    /// Returns the parameters of a row.
    fn asked(&self) -> Vec<Value> {
        let Trial { policy, track, width_m, aid, beside_m, .. } = self.trial;
        vec![
            self.variant.into(),
            track.name().into(),
            policy.grip.name.into(),
            policy.delay_s.into(),
            policy.caution.into(),
            policy.correction_per_s.into(),
            policy.free_m_per_s.into(),
            policy.regains_s.into(),
            policy.rest_m.into(),
            policy.per_speed_s.into(),
            aid.law.name().into(),
            aid.hardness.into(),
            aid.yield_n.into(),
            beside_m.into(),
            width_m.into(),
            self.trial.length_m().into(),
            (self.trial.length_m() / width_m).into(),
            (self.users.end - self.users.start).into(),
        ]
    }

    /// Returns the results of its users.
    fn found(&self, users: Range<u64>) -> Vec<Value> {
        let run = |ready: &Result<super::trial::Ready, String>, user| match ready {
            Ok(ready) => ready.run(user),
            Err(error) => Err(error.clone()),
        };
        let ready = self.trial.ready();
        let runs: Vec<UserRun> = users
            .map(|user| run(&ready, user).unwrap_or_else(|error| UserRun { ended: Some(error), ..UserRun::default() }))
            .collect();
        let count = runs.len() as u64;
        let finished = runs.iter().filter(|run| run.ended.is_none()).count() as u64;
        let [low, high] = wilson(finished, count);
        let mut cells = vec![finished.into(), low.into(), high.into()];
        cells.push(runs.iter().find_map(|run| run.ended.clone()).into());
        let with_interval = |of: fn(&UserRun) -> f64| {
            let interval = median_interval(runs.iter().map(of));
            [median(runs.iter().map(of)).into(), interval.map(|it| it[0]).into(), interval.map(|it| it[1]).into()]
        };
        cells.extend(with_interval(|run| run.time_s));
        cells.extend(with_interval(|run| run.error_rms_m));
        cells.extend(with_interval(|run| run.outside_share));
        cells.push(median(runs.iter().map(|run| run.error_max_m)).into());
        cells.extend(with_interval(|run| run.across_j));
        cells
    }
}

impl Sweep for Runs {
    fn name(&self) -> &'static str {
        self.name
    }

    fn columns(&self) -> Vec<&str> {
        vec![
            "variant",
            "way",
            "grip",
            "delay_s",
            "caution",
            "correction_per_s",
            "free_m_per_s",
            "regains_s",
            "aim_rest_m",
            "aim_per_speed_s",
            "law",
            "hardness",
            "yield_n",
            "beside_m",
            "width_m",
            "length_m",
            "length_over_width",
            "users",
            "finished",
            "finished_low",
            "finished_high",
            "first_outcome",
            "time_s",
            "time_low_s",
            "time_high_s",
            "error_rms_m",
            "error_low_m",
            "error_high_m",
            "outside_share",
            "outside_low",
            "outside_high",
            "error_max_m",
            "energy_across_j",
            "energy_low_j",
            "energy_high_j",
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
        let mut cells = group.asked();
        cells.extend(group.found(users));
        cells
    }
}
