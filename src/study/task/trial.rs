//! One user on one way, on the arm of the admittance rig alone or on the whole rig; and what is measured of a run on any machine.

use std::ops::ControlFlow;

use serde_json::Value;

use super::super::bench::Bench;
use super::super::drawn::{bench, finite, not_negative, positive, shipped};
use super::aid::Aid;
use super::way::{Way, vector};
use yieldwall_config::injection::{Injection, Kind};
use yieldwall_config::{self as config, PathSegment};
use yieldwall_motion::elementary;
use yieldwall_rig::report::{Overrides, Watch, run_rig};
use yieldwall_sim::hand::{AimError, Hand, HandParameters, Leg, NoiseBand, Path};

/// How the error of the aim grows with its speed, in s.
///
/// # Source
/// In proportion to the speed: R. A. Schmidt et al., *Motor-output variability: a theory for the accuracy of rapid motor acts* (1979). The
/// size is chosen, and the error at rest is swept.
const AIM_PER_SPEED_S: f64 = 0.05;
/// Its corner in Hz: people move by intent below some 2 Hz.
const AIM_CORNER_HZ: f64 = 0.8;
/// Rest before the way, in s: the error of the aim has grown by its end.
const BEFORE_S: f64 = 0.5;
/// How fast the user presses off the way, and for how long, in s.
const PRESS_IN_S: f64 = 0.5;
const PRESS_FOR_S: f64 = 0.6;
/// How long the hand has let go at the end, in s.
pub(super) const LET_GO_S: f64 = 0.8;
/// Half of the width within which the user shall stay, in m.
const HALF_WIDTH_M: f64 = 0.002;
/// The end of a run in which the tool should be at rest, in s.
const RESTING_S: f64 = 0.3;
/// Longest step of the arm without the rig around it, in s.
const PLANT_STEP_S: f64 = 5e-4;

/// Mass, greatest force and tremor of the hand of the rig's scene.
const HAND_KG: f64 = 0.5;
pub(crate) const HAND_LIMIT_N: f64 = 40.0;
pub(crate) const TREMOR: NoiseBand = NoiseBand { rms: 0.1, low_hz: 8.0, high_hz: 12.0 };

/// A hand: its spring and damper. Its mass is that of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Grip {
    pub(crate) name: &'static str,
    pub(crate) stiffness_n_per_m: f64,
    pub(crate) damping_n_s_per_m: f64,
}

/// The hand of the rig's scene, and a braced one.
pub(crate) const GRIPS: [Grip; 2] = [
    Grip { name: "soft", stiffness_n_per_m: 400.0, damping_n_s_per_m: 8.0 },
    Grip { name: "stiff", stiffness_n_per_m: 3000.0, damping_n_s_per_m: 40.0 },
];

/// A user with a machine's fixture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Trial {
    pub(super) way: Way,
    pub(super) grip: Grip,
    /// Error of the aim at rest, RMS on each axis, in m.
    pub(super) aim_m: f64,
    pub(super) aid: Aid,
    /// Mean speed of the aim, in m/s: imposed, by a clock.
    pub(super) speed_m_per_s: f64,
    pub(super) user: u64,
    /// Force of the press off the way, in the hand's own spring, in N.
    pub(super) press_n: f64,
    /// Step of the arm's simulation over the usual one. The whole rig has that of its scene.
    pub(super) step_share: f64,
}

/// A moment of a run.
pub(super) struct Moment {
    pub(super) time_s: f64,
    pub(super) tool_m: [f64; 2],
    pub(super) velocity_m_per_s: [f64; 2],
    /// Force of the machine on the hand, in N.
    pub(super) force_n: [f64; 2],
}

/// Columns of [`Trial::measured`].
pub(super) const FOUND: [&str; 8] = [
    "outcome",
    "error_rms_m",
    "error_max_m",
    "outside_share",
    "force_max_n",
    "energy_given_across_j",
    "press_m",
    "jump_back_m",
];

impl Trial {
    fn trace_s(&self) -> f64 {
        self.way.length_m() / self.speed_m_per_s
    }

    pub(super) fn press_from_s(&self) -> f64 {
        BEFORE_S + self.trace_s()
    }

    pub(super) fn let_go_s(&self) -> f64 {
        self.press_from_s() + PRESS_IN_S + PRESS_FOR_S
    }

    /// RMS of the aim's error at this speed, in m.
    fn aim_error(&self) -> (f64, f64) {
        (self.aim_m + AIM_PER_SPEED_S * self.speed_m_per_s, AIM_CORNER_HZ)
    }

    /// How far beyond the way the aim goes in the end, in m.
    fn press_m(&self) -> f64 {
        self.press_n / self.grip.stiffness_n_per_m
    }

    /// Where the hand aims, for the scene of a rig.
    fn segments(&self) -> Vec<PathSegment> {
        let point_m = self.way.beyond_m(self.press_m()).map(finite).to_vec();
        vec![
            PathSegment::Wait { for_s: positive(BEFORE_S) },
            self.way.segment(self.trace_s()),
            PathSegment::To { point_m, in_s: positive(PRESS_IN_S) },
            PathSegment::Wait { for_s: positive(PRESS_FOR_S + LET_GO_S) },
        ]
    }

    /// The hand of this user, the same as that of the scene.
    pub(super) fn hand(&self) -> Result<Hand<2>, String> {
        let legs = [
            Leg::Wait { for_s: BEFORE_S },
            self.way.leg(self.trace_s()),
            Leg::To { point_m: vector(self.way.beyond_m(self.press_m())), in_s: PRESS_IN_S },
            Leg::Wait { for_s: PRESS_FOR_S + LET_GO_S },
        ];
        let path = Path::new(vector(self.way.start_m()), &legs).map_err(|error| error.to_string())?;
        let (rms_m, corner_hz) = self.aim_error();
        let parameters = HandParameters {
            mass_kg: HAND_KG,
            stiffness_n_per_m: self.grip.stiffness_n_per_m,
            damping_n_s_per_m: self.grip.damping_n_s_per_m,
            voluntary_force_limit_n: HAND_LIMIT_N,
            tremor: Some(TREMOR),
            aim_error: Some(AimError { rms_m, corner_hz }),
        };
        Hand::new(parameters, path, self.seed()).map_err(|error| error.to_string())
    }

    fn seed(&self) -> u64 {
        1 + self.user
    }

    /// Returns the parameters of the trial, except the user.
    pub(super) fn asked(&self) -> Vec<Value> {
        vec![
            self.way.name().into(),
            self.grip.name.into(),
            self.aim_m.into(),
            self.aid.law.name().into(),
            self.aid.hardness.into(),
            self.aid.yield_n.into(),
            self.speed_m_per_s.into(),
        ]
    }

    /// The rig of the paper with this fixture, and its scene.
    fn machine(&self) -> Result<(config::Rig, config::Scene), String> {
        let (mut rig, scene) = shipped("paper-admittance.yaml")?;
        rig.fixture.surface = self.way.surface();
        rig.fixture.law = self.aid.config();
        rig.fixture.yield_n = self.aid.yield_n.map_or(rig.fixture.yield_n, positive);
        Ok((rig, scene))
    }

    /// On the arm of the rig without bus, counts, noise and guard: how it ended, and the moments.
    pub(super) fn on_bench(&self) -> Result<(String, Vec<Moment>), String> {
        let (rig, scene) = self.machine()?;
        let (parameters, fixture) = bench(&rig, &scene, vector(self.way.start_m()), self.step_share * PLANT_STEP_S)?;
        let mut bench = Bench::new(&parameters, fixture).map_err(|error| error.to_string())?;
        let mut hand = self.hand()?;
        let cycles = ((self.let_go_s() + LET_GO_S) / parameters.period_s).round() as u64;
        let mut moments = Vec::with_capacity(cycles as usize);
        for cycle in 0..cycles {
            if cycle as f64 * parameters.period_s >= self.let_go_s() {
                hand.set_stiffness(0.0).map_err(|error| error.to_string())?;
            }
            let seen = match bench.run_cycle(cycle.saturating_sub(1), |time_s, tip| hand.load(time_s, tip.0)) {
                Ok(seen) => seen,
                Err(error) => return Ok((error.to_string(), moments)),
            };
            moments.push(Moment {
                time_s: seen.time_s,
                tool_m: seen.tool_m.into(),
                velocity_m_per_s: seen.tool_velocity_m_per_s.into(),
                force_n: (-seen.force_n).into(),
            });
        }
        Ok(("ran".to_owned(), moments))
    }

    /// Runs the same user on the whole rig, with a scene that has this hand in place of its own.
    pub(super) fn on_rig(&self) -> Result<(String, Vec<Moment>), String> {
        let (rig, mut scene) = self.machine()?;
        let (rms_m, corner_hz) = self.aim_error();
        scene.hand.aim_error = Some(config::AimError { rms_m: not_negative(rms_m), corner_hz: positive(corner_hz) });
        scene.hand.stiffness_n_per_m = positive(self.grip.stiffness_n_per_m);
        scene.hand.damping_n_s_per_m = not_negative(self.grip.damping_n_s_per_m);
        scene.hand.start_m = self.way.start_m().map(finite).to_vec();
        scene.hand.path = self.segments();
        scene.duration_s = positive(self.let_go_s() + LET_GO_S);
        scene.seed = self.seed();
        let let_go = Injection::new(Kind::HandStiff, self.let_go_s()).lasting(None).sized(0.0);
        let overrides = Overrides { faults: vec![let_go], ..Overrides::default() };
        let report = run_rig(&rig, &scene, &overrides, Watch::default(), |_| ControlFlow::Continue(()))
            .map_err(|error| error.to_string())?;
        let cause = report.cause.filter(|_| report.state.is_some_and(|state| state.is_latched()));
        let outcome = cause.map_or_else(|| "ran".to_owned(), |cause| format!("stopped by {}", cause.fault.row().name));
        let moment = |row: &yieldwall_record::Row| Moment {
            time_s: row.time_s,
            tool_m: [row.tool_m[0], row.tool_m[1]],
            velocity_m_per_s: [row.tool_velocity_m_per_s[0], row.tool_velocity_m_per_s[1]],
            force_n: [-row.force_n[0], -row.force_n[1]],
        };
        Ok((outcome, report.trace.rows.iter().map(moment).collect()))
    }

    /// The cells of [`FOUND`].
    pub(super) fn measured(&self, outcome: String, moments: &[Moment]) -> Vec<Value> {
        let between = |from_s: f64, to_s: f64| moments.iter().filter(move |it| it.time_s >= from_s && it.time_s < to_s);
        let error = |moment: &Moment| self.way.distance_m(moment.tool_m);
        let traced: Vec<_> = between(BEFORE_S, self.press_from_s()).collect();
        let count = traced.len().max(1) as f64;
        let square: f64 = traced.iter().map(|moment| elementary::powi(error(moment), 2)).sum();
        let pressed = moments.iter().rfind(|moment| moment.time_s < self.let_go_s()).map(error);
        let jump = pressed.zip(moments.last()).map(|(pressed, last)| pressed - error(last));
        // What is given along the way is the momentum of tool and proxy; what a fixture stores comes back across it.
        let across_w = |moment: &Moment| {
            let [x, y] = self.way.normal(moment.tool_m);
            let force = moment.force_n[0] * x + moment.force_n[1] * y;
            force * (moment.velocity_m_per_s[0] * x + moment.velocity_m_per_s[1] * y)
        };
        let power = |pair: &[Moment]| across_w(&pair[0]).max(0.0) * (pair[1].time_s - pair[0].time_s);
        let across_j: f64 = moments.windows(2).map(power).sum();
        let force = |moment: &&Moment| elementary::hypot(moment.force_n[0], moment.force_n[1]);
        vec![
            outcome.into(),
            (square / count).sqrt().into(),
            traced.iter().map(|moment| error(moment)).fold(0.0, f64::max).into(),
            (traced.iter().filter(|moment| error(moment) > HALF_WIDTH_M).count() as f64 / count).into(),
            traced.iter().map(force).fold(0.0, f64::max).into(),
            across_j.into(),
            pressed.into(),
            jump.into(),
        ]
    }

    /// RMS speed in m/s at the end of a run: how fast a tool moves that nobody holds.
    pub(super) fn resting_m_per_s(moments: &[Moment]) -> Option<f64> {
        let end_s = moments.last()?.time_s;
        let last: Vec<f64> = moments
            .iter()
            .filter(|moment| moment.time_s > end_s - RESTING_S)
            .map(|moment| {
                elementary::powi(elementary::hypot(moment.velocity_m_per_s[0], moment.velocity_m_per_s[1]), 2)
            })
            .collect();
        Some((last.iter().sum::<f64>() / last.len().max(1) as f64).sqrt())
    }
}
