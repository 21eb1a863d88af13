//! A cable in memory with any number of participants, each on a thread of its own, and one clock for all.
//!
//! One participant runs at a time. It gives its turn up when it waits, and time then goes on to the next moment at which one
//! of them has something to do: whatever the computer does, the same happens again.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use yieldwall::canopen::Frame;
use yieldwall::link::{Arrival, CanLink, Received, SendError, Wires};
use yieldwall::run::Metronome;
use yieldwall::time::Time;

/// How long a frame takes to the others, and its echo to its sender.
pub const DELAY: Duration = Duration::from_micros(100);

#[derive(Default)]
struct End {
    /// Whether it has begun; before that it hears nothing.
    is_on: bool,
    inbox: VecDeque<Arrival>,
    /// When it wants to go on, while it waits.
    wakes: Option<Time>,
    /// Whether a frame wakes it before.
    hears: bool,
}

struct Cable {
    now: Time,
    ends: Vec<End>,
    running: Option<usize>,
    log: Vec<(Time, usize, Frame)>,
}

impl Cable {
    fn next_of(&self, end: &End) -> Option<Time> {
        let heard = end.inbox.front().filter(|_| end.hears).map_or(Time::NEVER, |arrival| arrival.time);
        end.wakes.map(|wakes| wakes.min(heard).max(self.now))
    }

    /// Gives the turn to who wants to go on first; of several at the same moment to the one with the lowest number.
    fn pass_on(&mut self) {
        let ends = self.ends.iter().enumerate();
        let next = ends.filter_map(|(number, end)| Some((self.next_of(end)?, number))).min();
        self.running = next.map(|(_, number)| number);
        if let Some((at, number)) = next {
            self.now = at;
            self.ends[number].wakes = None;
        }
    }
}

struct Shared {
    cable: Mutex<Cable>,
    turns: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Cable> {
        self.cable.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn with<R>(&self, act: impl FnOnce(&mut Cable) -> R) -> R {
        act(&mut self.lock())
    }
}

/// A cable for so many participants.
#[derive(Clone)]
pub struct SharedCable(Arc<Shared>);

/// One participant's end of the cable. Clones are the same end.
#[derive(Clone)]
pub struct Plug {
    shared: Arc<Shared>,
    number: usize,
}

/// Ends a participant when it is dropped, so that nobody waits for it.
pub struct Turn(Plug);

impl SharedCable {
    /// A cable whose participants begin at these moments. Each has to [`Plug::begin`].
    pub fn new(begins: &[Time]) -> (Self, Vec<Plug>) {
        let ends = begins.iter().map(|begin| End { wakes: Some(*begin), ..End::default() });
        let mut cable = Cable { now: Time(0), ends: ends.collect(), running: None, log: Vec::new() };
        cable.pass_on();
        let shared = Arc::new(Shared { cable: Mutex::new(cable), turns: Condvar::new() });
        let plugs = (0..begins.len()).map(|number| Plug { shared: Arc::clone(&shared), number });
        (Self(Arc::clone(&shared)), plugs.collect())
    }

    /// All that was sent: when, the number of the participant, and the frame.
    pub fn log(&self) -> Vec<(Time, usize, Frame)> {
        self.0.with(|cable| cable.log.clone())
    }
}

impl Plug {
    /// Waits for the moment at which this participant begins.
    pub fn begin(&self) -> Turn {
        self.wait_for_turn();
        self.shared.with(|cable| cable.ends[self.number].is_on = true);
        Turn(self.clone())
    }

    fn wait_for_turn(&self) {
        let is_another = |cable: &mut Cable| cable.running != Some(self.number);
        drop(self.shared.turns.wait_while(self.shared.lock(), is_another).unwrap_or_else(PoisonError::into_inner));
    }

    fn pause(&self, until: Time, hears: bool) {
        self.shared.with(|cable| {
            let end = &mut cable.ends[self.number];
            (end.wakes, end.hears) = (Some(until), hears);
            cable.pass_on();
        });
        self.shared.turns.notify_all();
        self.wait_for_turn();
    }

    fn has_arrived(&self) -> bool {
        self.shared.with(|cable| cable.ends[self.number].inbox.front().is_some_and(|arrival| arrival.time <= cable.now))
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        self.0.shared.with(Cable::pass_on);
        self.0.shared.turns.notify_all();
    }
}

impl CanLink for Plug {
    fn now(&self) -> Time {
        self.shared.with(|cable| cable.now)
    }

    fn receive(&mut self) -> Option<Arrival> {
        self.has_arrived().then(|| self.shared.with(|cable| cable.ends[self.number].inbox.pop_front())).flatten()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        self.shared.with(|cable| {
            let time = cable.now + DELAY;
            cable.log.push((cable.now, self.number, *frame));
            for (number, end) in cable.ends.iter_mut().enumerate().filter(|(_, end)| end.is_on) {
                let is_own = number == self.number;
                let what = if is_own { Received::Echo(*frame) } else { Received::Frame(*frame) };
                end.inbox.push_back(Arrival { time, bus: frame.bus(), what });
            }
        });
        Ok(())
    }

    fn wait(&mut self, until: Time) -> bool {
        if !self.has_arrived() && self.now() < until {
            self.pause(until, true);
        }
        self.has_arrived()
    }
}

impl Wires for Plug {}

impl Metronome for Plug {
    fn sleep_until(&mut self, moment: Time) {
        if self.now() < moment {
            self.pause(moment, false);
        }
    }

    fn suspended(&self) -> Duration {
        Duration::ZERO
    }
}
