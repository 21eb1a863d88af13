//! Messages from the thread of the cycle to the caller.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::time::Duration;

use crate::commission::StepReport;
use crate::{BootSteps, BootWatch, Finding, Homed, Wrenches};
use yieldwall_bus::Waiting;

/// How long the boot waits before it is reported.
const QUIET: Duration = Duration::from_secs(1);

/// One piece of it.
#[derive(Clone, Debug, PartialEq)]
pub enum News {
    /// This computer did not grant something.
    Refused(String),
    /// Another step of the boot, which each node takes in its turn.
    Step(&'static str),
    /// It is shown that the drives stop by themselves, and the rig is enabled next.
    Proved,
    /// Reaction of one watchdog of the drives in a drill.
    Found(Finding),
    /// The joints were homed once, well or not.
    Homed(Homed),
    /// A step of a commissioning is over.
    Stepped(Box<StepReport>),
    /// Readings of the force sensor within the last interval, with the begin of the interval in s after the first.
    Sensed(f64, Box<Wrenches>),
    /// Reason why the boot waits, if it has waited for a while; `None` once it is over.
    Waiting(Option<String>),
}

/// Reports why a boot waits, and ends it when a person asks for the end.
pub(super) fn boot_watch(news: Sender<News>, is_interrupted: Arc<AtomicBool>) -> BootWatch {
    let mut was_told = false;
    let mut steps = BootSteps::default();
    Box::new(move |waiting| {
        if let Some(step) = steps.new_step(waiting) {
            // Nobody listens if the thread that waits has died.
            let _ = news.send(News::Step(step));
        }
        let text = worth_telling(waiting);
        if was_told || text.is_some() {
            was_told = text.is_some();
            let _ = news.send(News::Waiting(text));
        }
        is_interrupted.load(Ordering::Relaxed)
    })
}

fn worth_telling(waiting: Option<Waiting<'_>>) -> Option<String> {
    waiting.filter(|waiting| waiting.waited >= QUIET).map(|waiting| waiting.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc;

    fn waiting(waited_ms: u64) -> Option<Waiting<'static>> {
        let [waited, left] = [waited_ms, 5000 - waited_ms].map(Duration::from_millis);
        Some(Waiting { node_id: Some(1), name: "left", step: "wait for the boot-up message", waited, left })
    }

    #[test]
    fn a_boot_that_takes_a_while_says_for_whom_it_waits_what_for_and_how_long_still() {
        let (news, told) = mpsc::channel();
        let is_interrupted = Arc::new(AtomicBool::new(false));
        let mut watch = boot_watch(news, Arc::clone(&is_interrupted));
        for waited_ms in [0, 999, 1000, 1100] {
            assert!(!watch(waiting(waited_ms)));
        }
        is_interrupted.store(true, Ordering::Relaxed);
        assert!(watch(None) && watch(None), "the boot is to end");
        drop(watch);
        let text = |left| Some(format!("node 1 (left): wait for the boot-up message, for {left} s at most"));
        let told: Vec<News> = told.iter().collect();
        let step = News::Step("wait for the boot-up message");
        let [first, second, last] = [text("4.0"), text("3.9"), None].map(News::Waiting);
        assert_eq!(told, [step, first, second, last], "a step is told once");
    }
}
