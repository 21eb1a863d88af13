//! The tables beside the first: what is held, a stiff hand, and distal links that come into line.

use nalgebra::Vector2;
use std::path::PathBuf;
use std::sync::OnceLock;

use serde_json::Value;

use super::contestant::{Contestant, MUJOCO, OURS, creep_m_per_s, distances};
use super::method::Method;
use super::scene::{CYCLE_S, HOLD, Scene, Spring, lock, stiff};
use crate::sweep::{Clock, Sweep};

/// All contestants, as far as the program is there.
fn contestants(program: Option<&PathBuf>) -> Vec<Contestant> {
    let peers = if program.is_some() { &MUJOCO[..] } else { &[] };
    OURS.iter().chain(peers).copied().collect()
}

/// Motors off, a push of a third of what dry friction holds, for 2 s.
pub(super) struct Hold {
    pub(super) program: Option<PathBuf>,
}

/// Steps of this table in s.
const HOLD_STEPS_S: [f64; 4] = [1e-3, 5e-4, 2e-4, 1e-4];

impl Sweep for Hold {
    fn name(&self) -> &'static str {
        "hold"
    }

    fn columns(&self) -> Vec<&str> {
        vec!["engine", "method", "step_s", "moved_m", "creep_m_per_s", "is_exactly_still", "stopped"]
    }

    fn points(&self) -> u64 {
        (contestants(self.program.as_ref()).len() * HOLD_STEPS_S.len()) as u64
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let (which, step) = (index as usize / HOLD_STEPS_S.len(), index as usize % HOLD_STEPS_S.len());
        let (contestant, step_s) = (contestants(self.program.as_ref())[which], HOLD_STEPS_S[step]);
        let outcome = contestant.run(self.program.as_deref(), &HOLD, step_s);
        let start = HOLD.arm.motion(HOLD.start(), Vector2::zeros()).tip;
        let moved_m = outcome.tips.last().map_or(f64::NAN, |tip| (tip - start).norm());
        let is_still = !outcome.tips.is_empty() && outcome.tips.iter().all(|tip| *tip == start);
        vec![
            contestant.engine().into(),
            contestant.method().into(),
            step_s.into(),
            moved_m.into(),
            creep_m_per_s(&outcome.tips).into(),
            is_still.into(),
            outcome.stopped.into(),
        ]
    }
}

/// The scene of the study with stiff hands.
pub(super) struct Stiff {
    program: Option<PathBuf>,
    references: [OnceLock<Reference>; HANDS.len()],
}

/// Reference solution with one hand.
#[derive(Debug)]
struct Reference {
    tips: Vec<Vector2<f64>>,
    /// How far the same method comes out elsewhere with another step, in m.
    gap_m: f64,
}

impl Stiff {
    pub(super) fn new(program: Option<PathBuf>) -> Self {
        Self { program, references: [const { OnceLock::new() }; HANDS.len()] }
    }
}

const HANDS: [Spring; 4] = [
    Spring { n_per_m: 5e3, n_s_per_m: 15.0 },
    Spring { n_per_m: 5e4, n_s_per_m: 15.0 },
    Spring { n_per_m: 1e6, n_s_per_m: 15.0 },
    Spring { n_per_m: 1e6, n_s_per_m: 300.0 },
];
const STIFF_STEPS_S: [f64; 3] = [1e-3, 2.5e-4, 5e-5];
/// Steps of the reference, and of the solution that shows its accuracy, in s.
const STIFF_REFERENCE_S: [f64; 2] = [2e-6, 5e-6];

impl Sweep for Stiff {
    fn name(&self) -> &'static str {
        "stiff-hand"
    }

    fn columns(&self) -> Vec<&str> {
        vec![
            "hand_n_per_m",
            "hand_n_s_per_m",
            "engine",
            "method",
            "step_s",
            "max_error_m",
            "rms_error_m",
            "reference_gap_m",
            "stopped",
        ]
    }

    fn points(&self) -> u64 {
        (HANDS.len() * contestants(self.program.as_ref()).len() * STIFF_STEPS_S.len()) as u64
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let all = contestants(self.program.as_ref());
        let (rest, step) = (index as usize / STIFF_STEPS_S.len(), index as usize % STIFF_STEPS_S.len());
        let (hand, contestant, step_s) = (HANDS[rest / all.len()], all[rest % all.len()], STIFF_STEPS_S[step]);
        let scene = stiff(hand);
        let reference = self.references[rest / all.len()].get_or_init(|| {
            let [tips, other] =
                STIFF_REFERENCE_S.map(|step_s| Contestant::Ours(Method::Events).run(None, &scene, step_s).tips);
            Reference { gap_m: distances(&other, &tips).0, tips }
        });
        let outcome = contestant.run(self.program.as_deref(), &scene, step_s);
        let (most_m, mean_m) = distances(&outcome.tips, &reference.tips);
        vec![
            hand.n_per_m.into(),
            hand.n_s_per_m.into(),
            contestant.engine().into(),
            contestant.method().into(),
            step_s.into(),
            most_m.into(),
            mean_m.into(),
            reference.gap_m.into(),
            outcome.stopped.into(),
        ]
    }
}

/// Motors that pull short distal links into line, where the linkage locks.
pub(super) struct Lock {
    pub(super) program: Option<PathBuf>,
}

const LOCK_CASES: [(&str, f64); 2] = [("outward", 1.0), ("inward", -1.0)];
const LOCK_STEPS_S: [f64; 2] = [1e-3, 1e-4];

impl Sweep for Lock {
    fn name(&self) -> &'static str {
        "lock"
    }

    fn columns(&self) -> Vec<&str> {
        vec!["pull", "engine", "method", "step_s", "end_s", "fastest_m_per_s", "is_finite", "loop_gap_m", "stopped"]
    }

    fn points(&self) -> u64 {
        (LOCK_CASES.len() * contestants(self.program.as_ref()).len() * LOCK_STEPS_S.len()) as u64
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let all = contestants(self.program.as_ref());
        let (rest, step) = (index as usize / LOCK_STEPS_S.len(), index as usize % LOCK_STEPS_S.len());
        let ((name, sign), contestant) = (LOCK_CASES[rest / all.len()], all[rest % all.len()]);
        let scene: Scene = lock(sign);
        let outcome = contestant.run(self.program.as_deref(), &scene, LOCK_STEPS_S[step]);
        let tips = &outcome.tips;
        let fastest = tips.windows(2).map(|pair| (pair[1] - pair[0]).norm() / CYCLE_S).fold(0.0, f64::max);
        vec![
            name.into(),
            contestant.engine().into(),
            contestant.method().into(),
            LOCK_STEPS_S[step].into(),
            (tips.len() as f64 * CYCLE_S).into(),
            fastest.into(),
            tips.iter().flatten().all(|value| value.is_finite()).into(),
            outcome.loop_gap_m.into(),
            outcome.stopped.into(),
        ]
    }
}
