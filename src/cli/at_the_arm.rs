//! Somebody at the arm who is asked on the terminal.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::confirm::{ask, is_yes};
use yieldwall_motion::quantity::Force;
use yieldwall_run::Task;

/// Interval at which a wait checks whether a person has asked for the end.
const LOOK_UP: Duration = Duration::from_millis(100);

/// Source of typed answers.
pub(super) struct Typed {
    is_interrupted: Arc<AtomicBool>,
}

impl Typed {
    pub(super) fn new(is_interrupted: Arc<AtomicBool>) -> Self {
        Self { is_interrupted }
    }

    /// Returns the answer; `None` if nobody answers, and after an interrupt.
    pub(super) fn ask(&self, question: &str) -> Option<String> {
        ask(question, || !self.is_interrupted.load(Ordering::Relaxed))
    }

    /// Asks for a yes, and runs an action several times a second meanwhile. Returns whether the answer is yes.
    pub(super) fn agrees_while(&self, question: &str, mut meanwhile: impl FnMut()) -> bool {
        meanwhile();
        let answer = ask(question, || {
            meanwhile();
            !self.is_interrupted.load(Ordering::Relaxed)
        });
        is_yes(answer.as_deref())
    }

    /// Waits for a condition, up to a time limit, and returns whether it became true. An interrupt ends the wait.
    pub(super) fn wait(&self, longest: Duration, mut is_so: impl FnMut() -> bool) -> bool {
        let started = Instant::now();
        loop {
            if is_so() {
                return true;
            }
            if started.elapsed() >= longest || self.is_interrupted.load(Ordering::Relaxed) {
                return false;
            }
            std::thread::sleep(LOOK_UP);
        }
    }

    /// Asks for a known force at the tool, or for none, and returns whether it is there.
    pub(super) fn pull(&self, force: Force, otherwise: &str) -> bool {
        if force == Force::default() {
            self.ask("Remove the pull, then press Enter:");
            return true;
        }
        let (along, size) = if force.x() != 0.0 { ("x", force.x()) } else { ("y", force.y()) };
        let (way, size) = if size < 0.0 { ("against ", -size) } else { ("along ", size) };
        let question = format!(
            "Pull at the tool with {size} N {way}{along} of the base frame, with a weight over a pulley or a spring balance. The arm has to rest \
             under this force without torque. Then write yes; {otherwise}:"
        );
        is_yes(self.ask(&question).as_deref())
    }

    /// Asks for the preparation of a measurement, and returns whether it was done.
    pub(super) fn help(&self, task: Task) -> bool {
        match task {
            Task::Pull(force) => self.pull(force, "anything else ends"),
            Task::LeadTo(at, point) => {
                let [x, y] = point.to_array().map(|at| 1e3 * at);
                let question = format!(
                    "{}. Guide the tool by hand to x {x:.2} mm, y {y:.2} mm of the base frame, let it rest there, and press Enter:",
                    at + 1
                );
                self.ask(&question).is_some()
            }
        }
    }
}
