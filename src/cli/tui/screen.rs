//! The terminal: its screen and its keys.

use std::io::{self, IsTerminal};
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use ratatui::crossterm::event::{self, Event as Input};

use super::draw::{Offer, draw};
use super::keys::{Act, Keys};
use super::view::View;
use crate::failure::{Exit, Failure};
use yieldwall_run::Orders;

/// Time from one picture to the next.
const REFRESH: Duration = Duration::from_millis(100);
/// Time from one look whether the screen is over to the next.
const LOOK: Duration = Duration::from_millis(50);

/// A screen that is shown until it ends; the terminal is then as before, also after a panic.
pub(crate) struct Screen {
    is_over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

/// Refuses an output that is no terminal.
pub(crate) fn check_terminal() -> Result<(), Failure> {
    if io::stdout().is_terminal() && io::stdin().is_terminal() {
        return Ok(());
    }
    let help = "leave out --tui: events are then printed a line each, with --jsonl an object each";
    Err(Failure::new(Exit::Usage, "--tui needs a terminal, for standard input and standard output", help))
}

impl Screen {
    /// Takes the terminal, and has its stop keys set `is_interrupted`.
    /// With orders its keys can also reset and enable a rig that a fault has stopped, each with a second key.
    pub(crate) fn start(
        view: &Arc<Mutex<View>>,
        is_interrupted: &Arc<AtomicBool>,
        orders: Option<Arc<Orders>>,
    ) -> Result<Self, Failure> {
        let failed = |error: io::Error| {
            Failure::new(Exit::Internal, format!("the terminal cannot be used: {error}"), "leave out --tui")
        };
        // Restores the terminal when any thread panics, before the panic is printed.
        let mut terminal = ratatui::try_init().map_err(failed)?;
        let mut screen = Self { is_over: Arc::default(), threads: Vec::new() };
        let (is_over, stop) = (Arc::clone(&screen.is_over), Arc::clone(is_interrupted));
        let (can_come_back, armed) = (orders.is_some(), Arc::new(AtomicU8::new(0)));
        let of_keys = Arc::clone(&armed);
        // First: who can stop has to be there before anything is shown.
        screen
            .threads
            .push(spawn("keys", move || attend(&is_over, &stop, orders.as_deref(), &of_keys)).map_err(failed)?);
        let (is_over, stop, view) = (Arc::clone(&screen.is_over), Arc::clone(is_interrupted), Arc::clone(view));
        let show = move || {
            while !is_over.load(Ordering::Relaxed) && !thread_has_panicked() {
                let now = view.lock().unwrap_or_else(PoisonError::into_inner).clone();
                let offer = Offer {
                    is_stopping: stop.load(Ordering::Relaxed),
                    can_come_back,
                    armed: Act::of(armed.load(Ordering::Relaxed)),
                };
                if terminal.draw(|frame| draw(frame, &now, offer)).is_err() {
                    // The terminal is closed; the rig continues, and SIGTERM or SIGHUP ends it.
                    return;
                }
                thread::sleep(REFRESH);
            }
        };
        screen.threads.push(spawn("screen", show).map_err(failed)?);
        Ok(screen)
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // A thread that panicked has printed its message.
            let _ = thread.join();
        }
        ratatui::restore();
    }
}

/// Whether a picture would go to a terminal that a panic has restored.
fn thread_has_panicked() -> bool {
    ratatui::crossterm::terminal::is_raw_mode_enabled().is_ok_and(|is_raw| !is_raw)
}

fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> io::Result<JoinHandle<()>> {
    thread::Builder::new().name(name.to_owned()).spawn(work)
}

/// Waits for keys, and carries out their acts.
fn attend(is_over: &AtomicBool, is_interrupted: &AtomicBool, orders: Option<&Orders>, armed: &AtomicU8) {
    let mut keys = Keys::default();
    while !is_over.load(Ordering::Relaxed) {
        let key = event::poll(LOOK).and_then(|has_come| if has_come { event::read().map(Some) } else { Ok(None) });
        let now = Instant::now();
        match key {
            Ok(Some(Input::Key(key))) => match (keys.press(&key, now, orders.is_some()), orders) {
                (Some(Act::Stop), _) => is_interrupted.store(true, Ordering::Relaxed),
                (Some(Act::Reset), Some(orders)) => orders.reset(),
                (Some(Act::Enable), Some(orders)) => orders.enable(),
                _ => {}
            },
            Ok(_) => {}
            // Without keys nobody could stop the rig from here: it is stopped.
            Err(_) => {
                is_interrupted.store(true, Ordering::Relaxed);
                return;
            }
        }
        armed.store(keys.armed(now).map_or(0, |act| act as u8), Ordering::Relaxed);
    }
}
