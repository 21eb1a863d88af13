//! Somebody at the arm who is asked on the terminal.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use super::fit;
use super::printable::printable;
use crate::quantity::Force;
use crate::run::Task;

/// How often a question looks whether a person has asked for the end.
const LOOK_UP: Duration = Duration::from_millis(100);

/// Where lines are typed.
pub(super) struct Typed {
    is_interrupted: Arc<AtomicBool>,
    /// Lines that were typed; a thread reads them from the first question on.
    lines: Option<Receiver<String>>,
}

impl Typed {
    pub(super) fn new(is_interrupted: Arc<AtomicBool>) -> Self {
        Self { is_interrupted, lines: None }
    }

    /// What is answered; nothing where nobody answers, and after an interrupt.
    pub(super) fn ask(&mut self, question: &str) -> Option<String> {
        self.ask_while(question, || ())
    }

    /// The same, and does something several times a second meanwhile.
    pub(super) fn ask_while(&mut self, question: &str, mut meanwhile: impl FnMut()) -> Option<String> {
        let columns = fit::columns(io::stderr()).unwrap_or(fit::USUAL);
        // Nobody can be told that standard error is closed.
        let _ = write!(io::stderr(), "{} ", fit::fitted(&printable(question), columns));
        let typed = self.lines.get_or_insert_with(|| {
            let (typed, lines) = channel();
            std::thread::spawn(move || io::stdin().lines().map_while(Result::ok).try_for_each(|line| typed.send(line)));
            lines
        });
        loop {
            meanwhile();
            match typed.recv_timeout(LOOK_UP) {
                Ok(line) => return Some(line.trim().to_owned()),
                Err(RecvTimeoutError::Disconnected) => return None,
                Err(RecvTimeoutError::Timeout) if self.is_interrupted.load(Ordering::Relaxed) => return None,
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    /// Waits until something is so, for so long at most; whether it is. An interrupt ends it.
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

    /// Asks for a known force at the tool, or for none; whether it is there.
    pub(super) fn pull(&mut self, force: Force, otherwise: &str) -> bool {
        if force == Force::default() {
            self.ask("Take the pull away, then press Enter:");
            return true;
        }
        let (along, size) = if force.x() != 0.0 { ("x", force.x()) } else { ("y", force.y()) };
        let (way, size) = if size < 0.0 { ("against ", -size) } else { ("along ", size) };
        let question = format!(
            "Have {size} N pull at the tool {way}{along} of the base frame, by a weight over a pulley or a spring balance. The arm has to rest \
             under it without torque. Write yes; {otherwise}:"
        );
        self.ask(&question).is_some_and(|text| matches!(text.as_str(), "y" | "yes"))
    }

    /// Asks for what a measurement needs; whether it was done.
    pub(super) fn help(&mut self, task: Task) -> bool {
        match task {
            Task::Pull(force) => self.pull(force, "anything else ends"),
            Task::LeadTo(at, point) => {
                let [x, y] = point.to_array().map(|at| 1e3 * at);
                let question = format!(
                    "{}. Lead the tool by hand to x {x:.2} mm, y {y:.2} mm of the base frame, let it rest there, and press Enter:",
                    at + 1
                );
                self.ask(&question).is_some()
            }
        }
    }
}
