//! Events of a running rig, one at a time.
//!
//! ```text
//! loop --CycleRecord, EMCY, DriveError (rings)--> Listener [ Narrator ] --Event--> Events --> standard output, line of the terminal
//! boot --News-------------------------------------------------------------------------^
//! ```
//! [`Events`] prints them: a line each without a terminal, and an object each with `--jsonl`. On a terminal it prints urgent events
//! above one line that it refreshes.

mod listener;
mod narrator;

use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::{Map, Value, json};

use super::failure::{Exit, Failure};
use super::fit;
use super::output::Output;
use super::printable::printable;
use super::report_text::{finding_json, finding_text};
#[cfg(target_os = "linux")]
use super::tui::View;
pub(super) use listener::Listening;
use yieldwall_fieldbus::time::Time;
#[cfg(target_os = "linux")]
use yieldwall_run::Finding;
#[cfg(target_os = "linux")]
use yieldwall_run::host::News;

/// Columns before the text, as in every report.
const HEAD: usize = 10;
/// Widest that an event is printed on a terminal, in columns.
const WIDTH: usize = 110;

/// Event output of a command.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub(super) struct Stream {
    /// Print each event as a JSON object on its own line; the last line is the document of --json
    #[arg(long)]
    pub(super) jsonl: bool,
}

/// Something that has happened.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Event {
    /// Its kind, in one word.
    pub(super) name: &'static str,
    /// Time of the scene in s; `None` before it began.
    pub(super) time_s: Option<f64>,
    /// Time on the clock of the rig in s, which starts at power-on in a simulation and when the program opens a real bus; `None` without
    /// such a clock.
    boot_s: Option<f64>,
    /// Description of the event.
    pub(super) text: String,
    /// Meaning of the event, in the words of `explain`.
    pub(super) words: Vec<(&'static str, String)>,
    /// Event as data.
    pub(super) facts: Map<String, Value>,
}

impl Event {
    pub(super) fn new(name: &'static str, time_s: Option<f64>, text: impl Into<String>) -> Self {
        Self { name, time_s, boot_s: None, text: text.into(), words: Vec::new(), facts: Map::new() }
    }

    /// Adds a fact to the event.
    pub(super) fn with(mut self, key: &str, value: impl Into<Value>) -> Self {
        self.facts.insert(key.to_owned(), value.into());
        self
    }

    /// Adds a meaning to the event.
    pub(super) fn meaning(mut self, words: Vec<(&'static str, String)>) -> Self {
        self.words = words;
        self
    }

    /// Whether a person has to know it at once.
    pub(super) fn is_grave(&self) -> bool {
        matches!(self.name, "held" | "fault" | "emergency" | "error" | "refused")
    }

    /// Returns the time of the scene, or before it the time of the rig's clock.
    fn time(&self) -> Option<String> {
        match (self.time_s, self.boot_s) {
            (Some(time_s), _) => Some(format!("{time_s:.3}")),
            (None, Some(boot_s)) => Some(format!("boot+{boot_s:.3}")),
            (None, None) => None,
        }
    }

    /// `event      2.502 s  fault      node-reset (bus, left drive): a node restarted; cause: ..; next: ..`
    fn line(&self) -> String {
        let words: String = self.words.iter().map(|(key, text)| format!("; {key}: {text}")).collect();
        let time = self.time();
        format!("event {:>10} s  {:10} {}{words}\n", time.as_deref().unwrap_or("-"), self.name, self.text)
    }

    /// Returns the event for a terminal of this width in columns.
    fn paragraph(&self, width: usize) -> String {
        let filled = |head: String, text: &str, indent: usize| {
            fit::filled(&head, &" ".repeat(indent), text, width.min(WIDTH)) + "\n"
        };
        let at = self.time().map_or_else(String::new, |time| format!("at {time} s: "));
        let first = filled(format!("{:9} ", self.name), &format!("{at}{}", self.text), HEAD);
        // What stops the rig is explained where the command ends, which is at once.
        let words = if matches!(self.name, "fault" | "refused") { &[][..] } else { &self.words };
        let words = words.iter().map(|(key, text)| filled(format!("{:HEAD$}{key:8} ", ""), text, HEAD + 9));
        std::iter::once(first).chain(words).collect()
    }

    /// For a program.
    fn document(&self) -> Value {
        let mut keys = self.facts.clone();
        keys.extend(self.words.iter().map(|(key, text)| ((*key).to_owned(), Value::from(text.as_str()))));
        keys.insert("event".to_owned(), self.name.into());
        keys.insert("time_s".to_owned(), json!(self.time_s));
        if self.time_s.is_none() {
            keys.insert("boot_s".to_owned(), json!(self.boot_s));
        }
        keys.insert("text".to_owned(), self.text.as_str().into());
        Value::Object(keys)
    }
}

/// Receiver of the events.
#[derive(Clone, Debug)]
enum Form {
    Nobody,
    /// A screen, which shows them.
    Screen(Arc<Mutex<View>>),
    /// A person at a terminal of this width in columns.
    Terminal(usize),
    Lines,
    Objects,
}

struct Teller {
    form: Form,
    /// The line of a terminal, where there is one.
    bar: Option<ProgressBar>,
    has_told: bool,
    has_ended: bool,
    /// Steps of the boot that lines leave out.
    boot_steps: u32,
    clock: Arc<Clock>,
    /// Time of the scene in its last cycle, in s.
    ended_s: Option<f64>,
}

/// Clock of the rig, as the last frame shows it, in ns. It has no time before a rig is watched.
#[derive(Debug)]
struct Clock(AtomicU64);

impl Clock {
    const UNSET: u64 = u64::MAX;

    /// Real-time: yes.
    fn set(&self, time: Time) {
        self.0.store(time.0, Ordering::Relaxed);
    }

    fn time_s(&self) -> Option<f64> {
        let ns = self.0.load(Ordering::Relaxed);
        (ns != Self::UNSET).then(|| Time(ns).as_secs_f64())
    }
}

impl Default for Clock {
    fn default() -> Self {
        Self(AtomicU64::new(Self::UNSET))
    }
}

/// Prints events from any thread except the thread of the cycle.
#[derive(Clone)]
pub(super) struct Events(Arc<Mutex<Teller>>);

impl Events {
    /// As a command prints.
    pub(super) fn of(output: &Output) -> Self {
        let stdout = io::stdout();
        let form = match () {
            () if output.is_stream() => Form::Objects,
            () if output.is_json() || output.is_quiet() => Form::Nobody,
            () if stdout.is_terminal() => Form::Terminal(fit::columns(&stdout).unwrap_or(fit::USUAL)),
            () => Form::Lines,
        };
        let has_line = !output.is_json() && !output.is_quiet() && io::stderr().is_terminal();
        let bar = has_line.then(|| {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
            bar.with_style(ProgressStyle::with_template("{wide_msg}").unwrap_or_else(|_| ProgressStyle::default_bar()))
        });
        Self(Arc::new(Mutex::new(Teller {
            form,
            bar,
            has_told: false,
            has_ended: false,
            boot_steps: 0,
            clock: Arc::default(),
            ended_s: None,
        })))
    }

    fn lock(&self) -> MutexGuard<'_, Teller> {
        // What a thread that has panicked leaves can still print.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Prints an event.
    pub(super) fn tell(&self, event: &Event) {
        self.lock().tell(event);
    }

    /// Returns the clock of the rig, for the thread that watches its frames.
    fn clock(&self) -> Arc<Clock> {
        Arc::clone(&self.lock().clock)
    }

    /// Sends later events to a screen, instead of standard output and the line.
    pub(super) fn show_on(&self, view: &Arc<Mutex<View>>) {
        self.clear();
        self.lock().form = Form::Screen(Arc::clone(view));
    }

    /// Returns the screen, if there is one.
    fn view(&self) -> Option<Arc<Mutex<View>>> {
        match &self.lock().form {
            Form::Screen(view) => Some(Arc::clone(view)),
            _ => None,
        }
    }

    /// Shows this text in the line of the terminal.
    pub(super) fn show(&self, line: &str) {
        if let Some(bar) = &self.lock().bar {
            bar.set_message(printable(line).into_owned());
        }
    }

    /// Whether there is a line that is refreshed.
    pub(super) fn has_line(&self) -> bool {
        self.lock().bar.is_some()
    }

    /// Takes the line away, before anything else is printed.
    pub(super) fn clear(&self) {
        if let Some(bar) = self.lock().bar.take() {
            bar.finish_and_clear();
        }
    }

    /// Reports how the command ends: the last event, before its result. Reports nothing if no event was reported before.
    pub(super) fn end(&self, end: &Result<(), Failure>) {
        self.clear();
        let mut teller = self.lock();
        let has_printed = matches!(end, Err(failure) if failure.report.diagnostics.is_empty());
        if !teller.has_told || teller.has_ended || has_printed {
            return;
        }
        teller.has_ended = true;
        let (exit, why) = match end {
            Ok(()) => (Exit::Ok, String::new()),
            Err(Failure { exit, report }) => {
                (*exit, report.diagnostics.first().map_or_else(String::new, |first| format!(": {}", first.message)))
            }
        };
        let event = Event::new("end", teller.ended_s, format!("exit code {}{why}", exit.code()));
        teller.tell(&event.with("exit_code", exit.code()));
    }

    /// Reports the news of the thread of the cycle.
    #[cfg(target_os = "linux")]
    pub(super) fn news(&self, news: News) {
        match news {
            News::Step(step) => self.tell(&Event::new("boot", None, step)),
            News::Proved => {
                self.tell(&Event::new("proved", None, "the drives have shown that they stop by themselves"));
            }
            News::Found(finding) => self.tell(&watchdog(&finding)),
            News::Waiting(Some(text)) => self.show(&format!("boot      {text}")),
            News::Waiting(None) => self.show(""),
            // A warning, reports and a row, which the command prints.
            News::Refused(_) | News::Homed(_) | News::Stepped(_) | News::Sensed(..) => {}
        }
    }
}

/// Returns the event for a watchdog of the drives in a drill.
#[cfg(target_os = "linux")]
fn watchdog(finding: &Finding) -> Event {
    let mut event = Event::new("watchdog", None, finding_text(finding));
    if let Value::Object(facts) = finding_json(finding) {
        event.facts = facts;
    }
    event
}

/// Returns lines for a file or a pipe: as long as they are, unless COLUMNS is set.
fn for_columns(lines: String) -> String {
    match fit::columns(io::stdout()) {
        Some(columns) => fit::fitted(&lines, columns),
        None => lines,
    }
}

impl Teller {
    fn tell(&mut self, event: &Event) {
        let timed;
        let event = match event.time() {
            Some(_) => event,
            None => {
                timed = Event { boot_s: self.clock.time_s(), ..event.clone() };
                &timed
            }
        };
        self.has_told = true;
        if event.name == "boot" {
            self.boot_steps += 1;
        }
        let text = match &self.form {
            Form::Nobody => return,
            Form::Screen(view) => return view.lock().unwrap_or_else(PoisonError::into_inner).tell(event),
            Form::Terminal(_) if !event.is_grave() => return,
            Form::Terminal(columns) => event.paragraph(*columns),
            Form::Lines if event.name == "boot" && !tracing::enabled!(tracing::Level::DEBUG) => return,
            Form::Lines if event.name == "booted" => {
                let text = format!("{} ({} boot steps)", event.text, self.boot_steps);
                for_columns(Event { text, ..event.clone() }.line())
            }
            Form::Lines => for_columns(event.line()),
            Form::Objects => format!("{}\n", event.document()),
        };
        let has_other_bar = matches!(self.form, Form::Terminal(_)) && self.bar.is_none() && io::stderr().is_terminal();
        let print = || {
            let mut stdout = io::stdout().lock();
            // In place of the bar of a simulation, which draws itself anew below.
            if has_other_bar {
                let _ = stdout.write_all(b"\r\x1b[2K");
            }
            // A reader that has gone away stops nothing; the result reports a full disk.
            let _ = stdout.write_all(printable(&text).as_bytes()).and_then(|()| stdout.flush());
        };
        match &self.bar {
            Some(bar) => bar.suspend(print),
            None => print(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault() -> Event {
        let words = vec![("cause", "its supply dipped".to_owned()), ("next", "check the node's supply".to_owned())];
        Event::new("fault", Some(2.5021), "node-reset (bus, left drive): a node restarted while the rig was running")
            .with("fault", "node-reset")
            .meaning(words)
    }

    #[test]
    fn an_event_is_one_line_or_one_object_or_fits_a_terminal() {
        assert_eq!(
            fault().line(),
            "event      2.502 s  fault      node-reset (bus, left drive): a node restarted while the rig was running; \
             cause: its supply dipped; next: check the node's supply\n"
        );
        let begun = Event::new("boot", None, "begun");
        assert_eq!(begun.line(), "event          - s  boot       begun\n");
        let timed = Event { boot_s: Some(0.0464), ..begun };
        assert_eq!(timed.line(), "event boot+0.046 s  boot       begun\n");
        assert_eq!((&timed.document()["time_s"], &timed.document()["boot_s"]), (&Value::Null, &json!(0.0464)));
        assert!(timed.paragraph(60).starts_with("boot      at boot+0.046 s: begun"), "{}", timed.paragraph(60));
        let document = fault().document();
        assert_eq!((&document["event"], &document["time_s"]), (&json!("fault"), &json!(2.5021)));
        assert_eq!((&document["fault"], &document["next"]), (&json!("node-reset"), &json!("check the node's supply")));
        let paragraph = fault().paragraph(60);
        assert!(paragraph.lines().all(|line| line.len() <= 60), "{paragraph}");
        assert_eq!(paragraph.lines().count(), 2, "{paragraph}");
        let held = Event { name: "held", ..fault() };
        assert_eq!(held.paragraph(60).lines().count(), 4, "the rig goes on, and nothing is told at the end");
        assert!(fault().is_grave() && !Event::new("boot", None, "").is_grave());
    }

    #[test]
    fn a_watchdog_that_was_drilled_is_an_event_with_what_each_drive_did() {
        use std::time::Duration;
        use yieldwall_drives::cia402::State;
        use yieldwall_drives::watchdog::Watchdog;
        let finding = Finding {
            watchdog: Watchdog::SetPoints,
            stopped_after: [Some(Duration::from_micros(5200)), None],
            stopped_in: [Some(State::QuickStopActive), None],
        };
        let event = watchdog(&finding);
        assert_eq!(
            event.text,
            "without set-points the left drive stops after 5.2 ms, in Quick Stop Active; the right drive goes on"
        );
        let document = event.document();
        assert_eq!((&document["event"], &document["without"]), (&json!("watchdog"), &json!("set-points")));
        assert_eq!((&document["left_stops_after_ms"], &document["right_stops_after_ms"]), (&json!(5.2), &Value::Null));
    }

    #[test]
    fn what_is_told_of_an_end_is_told_once_and_only_after_something_else() {
        let events = Events(Arc::new(Mutex::new(Teller {
            form: Form::Nobody,
            bar: None,
            has_told: false,
            has_ended: false,
            boot_steps: 0,
            clock: Arc::default(),
            ended_s: None,
        })));
        events.end(&Ok(()));
        assert!(!events.lock().has_ended, "nothing has happened that could end");
        events.tell(&fault());
        events.end(&Err(Failure::new(Exit::SafetyStop, "stopped", "")));
        assert!(events.lock().has_ended);
    }
}
