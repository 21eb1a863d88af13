//! Contestants: methods of our own and settings of MuJoCo, run on the same scenes and timed alike.

use nalgebra::Vector2;
use std::path::Path;

use super::method::{Method, Run};
use super::mujoco::{self, Effort, Settings, Softness};
use super::scene::{CYCLE_S, Scene};
use crate::sweep::Clock;

/// Cycles that are run before a timed stretch.
const WARM: usize = 100;
/// A timed stretch takes at least this many steps, so that it is long against the grain of the clock.
const LEAST_STEPS: f64 = 20_000.0;

/// Something that moves an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Contestant {
    /// A method of this program.
    Ours(Method),
    /// MuJoCo.
    Mujoco(Settings),
}

/// Ours, the shipped one first.
pub(super) const OURS: [Contestant; 5] = [
    Contestant::Ours(Method::Midpoint),
    Contestant::Ours(Method::SemiImplicit),
    Contestant::Ours(Method::Events),
    Contestant::Ours(Method::Smooth { scale_rad_per_s: 0.01 }),
    Contestant::Ours(Method::Smooth { scale_rad_per_s: 0.001 }),
];

/// MuJoCo's, the best at a step of 1 ms last.
pub(super) const MUJOCO: [Contestant; 5] = [
    mujoco("implicitfast", Softness::Default),
    mujoco("RK4", Softness::Default),
    mujoco("implicitfast", Softness::Tuned),
    mujoco("RK4", Softness::Tuned),
    mujoco("RK4", Softness::Hardest),
];

const fn mujoco(integrator: &'static str, softness: Softness) -> Contestant {
    Contestant::Mujoco(Settings { integrator, softness })
}

/// Result of a scene.
#[derive(Clone, Debug)]
pub(super) struct SceneRun {
    /// Tool point at the end of each cycle, as far as it went, in m.
    pub(super) tips: Vec<Vector2<f64>>,
    /// Time of one run of the scene on the core, in s; NaN if it stopped.
    pub(super) seconds: f64,
    /// The farthest that the two chains were apart, in m; NaN where they cannot be.
    pub(super) loop_gap_m: f64,
    /// Why it stopped.
    pub(super) stopped: Option<String>,
}

impl Contestant {
    pub(super) fn engine(&self) -> &'static str {
        match self {
            Self::Ours(_) => "yieldwall",
            Self::Mujoco(_) => "mujoco",
        }
    }

    pub(super) fn method(&self) -> String {
        match self {
            Self::Ours(method) => method.to_string(),
            Self::Mujoco(settings) => settings.name(),
        }
    }

    /// Runs a scene once, untimed. Without the program MuJoCo stops at once and says so.
    pub(super) fn run(&self, program: Option<&Path>, scene: &Scene, step_s: f64) -> SceneRun {
        let still: Clock<'_> = &|| std::time::Duration::ZERO;
        self.timed(program, scene, step_s, Effort { warm: 0, repeats: 1 }, still)
    }

    /// Runs a scene as often as a measurement needs.
    pub(super) fn measured(&self, program: Option<&Path>, scene: &Scene, step_s: f64, clock: Clock<'_>) -> SceneRun {
        let steps = scene.cycles as f64 * (CYCLE_S / step_s).round();
        let repeats = (LEAST_STEPS / steps).ceil() as usize;
        self.timed(program, scene, step_s, Effort { warm: WARM, repeats }, clock)
    }

    fn timed(&self, program: Option<&Path>, scene: &Scene, step_s: f64, effort: Effort, clock: Clock<'_>) -> SceneRun {
        match self {
            Self::Ours(method) => ours(*method, scene, step_s, effort, clock),
            Self::Mujoco(settings) => {
                let found = program.map_or_else(
                    || Err("not computed: this point needs --mujoco PROGRAM".to_owned()),
                    |program| mujoco::run(program, *settings, scene, step_s, effort),
                );
                match found {
                    Ok(mujoco::MujocoRun { tips, on_core_s: seconds, loop_gap_m, .. }) => {
                        SceneRun { tips, seconds, loop_gap_m, stopped: None }
                    }
                    Err(why) => {
                        SceneRun { tips: Vec::new(), seconds: f64::NAN, loop_gap_m: f64::NAN, stopped: Some(why) }
                    }
                }
            }
        }
    }
}

fn ours(method: Method, scene: &Scene, step_s: f64, effort: Effort, clock: Clock<'_>) -> SceneRun {
    let mut run = Run::new(scene);
    let mut stopped = run.run(method, step_s, effort.warm).err();
    let before = clock();
    for _ in 0..effort.repeats {
        stopped = stopped.or(run.run(method, step_s, scene.cycles).err());
    }
    let seconds = clock().saturating_sub(before).as_secs_f64() / effort.repeats as f64;
    SceneRun {
        tips: run.tips(),
        seconds: if stopped.is_some() { f64::NAN } else { seconds },
        loop_gap_m: f64::NAN,
        stopped: stopped.map(|error| error.to_string()),
    }
}

/// The greatest and the mean (root of squares) distance between two ways; NaN if they are not equally long.
pub(super) fn distances(one: &[Vector2<f64>], other: &[Vector2<f64>]) -> (f64, f64) {
    if one.len() != other.len() || one.is_empty() {
        return (f64::NAN, f64::NAN);
    }
    let squares = || one.iter().zip(other).map(|(a, b)| (a - b).norm_squared());
    // A NaN must not get lost in a maximum.
    let most = squares().fold(0.0, |most: f64, square| if square > most || square.is_nan() { square } else { most });
    (most.sqrt(), (squares().sum::<f64>() / one.len() as f64).sqrt())
}

/// How fast the tool still moves in the second half of a scene in which nothing should move, in m/s.
pub(super) fn creep_m_per_s(tips: &[Vector2<f64>]) -> f64 {
    match (tips.get(tips.len() / 2), tips.last()) {
        (Some(middle), Some(last)) if tips.len() > 2 => {
            (last - middle).norm() / ((tips.len() - 1 - tips.len() / 2) as f64 * CYCLE_S)
        }
        _ => f64::NAN,
    }
}
