//! One user on the arm of the shipped rig under one fixture.

use nalgebra::Vector2;

use super::super::bench::{Bench, BenchParameters};
use super::super::drawn::{bench, positive, shipped};
use super::super::task::Aid;
use super::track::Track;
use super::user::{Errand, Policy, User};
use yieldwall_motion::fixture::{Fixture, Shape2};

const PERIOD_S: f64 = 1e-3;
/// Longest step of the arm, in s.
const PLANT_STEP_S: f64 = 5e-4;
/// Rest before the start signal, in s: the error of the aim has grown by its end.
const BEFORE_S: f64 = 0.5;
/// A user who has not come to the end by then has not, in s after the start signal.
pub(super) const LIMIT_S: f64 = 30.0;
/// A tool so far off the way has been thrown off, in m.
const THROWN_M: f64 = 0.05;

/// Users on one way under one fixture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Trial {
    pub(super) policy: Policy,
    pub(super) track: Track,
    /// The length of the way over the usual one.
    pub(super) length_share: f64,
    /// Width of the band in whose middle the way runs, in m.
    pub(super) width_m: f64,
    pub(super) aid: Aid,
    /// How far the reference of the fixture, and with it the tool at the start, lies beside the way, in m.
    pub(super) beside_m: f64,
    /// Step of the arm's simulation over the usual one.
    pub(super) step_share: f64,
}

/// Result of one user.
#[derive(Clone, Debug, Default)]
pub(super) struct UserRun {
    /// Why the end was not reached; `None` if it was.
    pub(super) ended: Option<String>,
    /// From the start signal to the end of the way, in s; [`LIMIT_S`] for a user who did not come there.
    pub(super) time_s: f64,
    /// Distance of the tool from the way until then, in m.
    pub(super) error_rms_m: f64,
    pub(super) error_max_m: f64,
    /// Share of that time outside of the band.
    pub(super) outside_share: f64,
    /// Sum of the energy that went out to the hand across the way, in J.
    pub(super) across_j: f64,
}

/// A trial made ready: what all its users share.
pub(super) struct Ready {
    trial: Trial,
    errand: Errand,
    bench: BenchParameters,
    fixture: Fixture<Shape2, 2>,
}

impl Trial {
    pub(super) fn length_m(&self) -> f64 {
        self.length_share * self.track.length_m()
    }

    /// # Errors
    /// If a shipped file or a number is refused.
    pub(super) fn ready(&self) -> Result<Ready, String> {
        let (mut rig, scene) = shipped("paper-admittance.yaml")?;
        rig.fixture.surface = self.track.surface(self.beside_m);
        rig.fixture.law = self.aid.config();
        rig.fixture.yield_n = self.aid.yield_n.map_or(rig.fixture.yield_n, positive);
        let errand = Errand {
            track: self.track,
            width_m: self.width_m,
            start_off_m: self.beside_m,
            friction_n: rig.fixture.friction_n.get(),
            period_s: PERIOD_S,
        };
        let start = self.track.at(0.0);
        let start_m = start.point_m + start.across * self.beside_m;
        let (bench, fixture) = bench(&rig, &scene, start_m, self.step_share * PLANT_STEP_S)?;
        Ok(Ready { trial: *self, errand, bench, fixture })
    }
}

impl Ready {
    /// One user, by number.
    ///
    /// # Errors
    /// If a number is refused.
    pub(super) fn run(&self, number: u64) -> Result<UserRun, String> {
        let Trial { policy, track, width_m, .. } = self.trial;
        let mut user = User::new(policy, self.errand, number).map_err(|error| error.to_string())?;
        let mut bench = Bench::new(&self.bench, self.fixture.clone()).map_err(|error| error.to_string())?;
        let mut tool_m = self.bench.start_m;
        let mut run = UserRun { time_s: LIMIT_S, ended: Some("not at the end".to_owned()), ..UserRun::default() };
        let (mut square, mut outside, mut count) = (0.0, 0_u32, 0_u32);
        for cycle in 0..((BEFORE_S + LIMIT_S) / PERIOD_S) as u64 {
            let time_s = cycle as f64 * PERIOD_S;
            let since_s = time_s - BEFORE_S;
            user.look(time_s, track.place(tool_m).1, since_s >= 0.0);
            let seen = match bench.run_cycle(cycle.saturating_sub(1), |time_s, tip| user.load(time_s, tip.0)) {
                Ok(seen) => seen,
                Err(error) => {
                    run.ended = Some(error.to_string());
                    break;
                }
            };
            tool_m = seen.tool_m;
            if since_s < 0.0 {
                continue;
            }
            let (along_m, off_m) = track.place(tool_m);
            if along_m >= self.trial.length_m() {
                (run.ended, run.time_s) = (None, since_s);
                break;
            }
            if off_m.abs() > THROWN_M {
                run.ended = Some("thrown off".to_owned());
                break;
            }
            let across: Vector2<f64> = track.at(along_m).across;
            // What the machine does to the hand is what the hand does to it.
            let across_w = -seen.force_n.dot(&across) * seen.tool_velocity_m_per_s.dot(&across);
            run.across_j += across_w.max(0.0) * PERIOD_S;
            run.error_max_m = run.error_max_m.max(off_m.abs());
            square += off_m * off_m;
            outside += u32::from(off_m.abs() > 0.5 * width_m);
            count += 1;
        }
        run.error_rms_m = (square / f64::from(count.max(1))).sqrt();
        run.outside_share = f64::from(outside) / f64::from(count.max(1));
        Ok(run)
    }
}
