//! Path from the loop to the printed events: rings that the loop fills, and a thread that empties them.

use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::narrator::Narrator;
use super::{Event, Events};
use crate::failure::{Exit, Failure};
use crate::tui::View;
use yieldwall_config as config;
use yieldwall_fieldbus::canopen::{Emergency, Frame};
use yieldwall_fieldbus::time::Time;
use yieldwall_link::Packet;
use yieldwall_record::CycleRecord;
use yieldwall_record::recording::{Feed, Outlet, Sink, side_ring};
use yieldwall_run::recorder::{Watched, ring};
use yieldwall_run::{BootSteps, DriveError, Watch};

/// Emergencies and errors that wait for the thread.
const ASIDE: usize = 64;
/// Time from one state of the line to the next.
const REFRESH: Duration = Duration::from_millis(100);

/// Events under way.
pub(crate) struct Listening(Feed<()>);

impl Listening {
    /// Starts the listener, and returns the observer of the rig.
    pub(crate) fn start(events: &Events, watched: Watched<'_>, rig: &config::Rig) -> Result<(Self, Watch), Failure> {
        // The simulation has its own progress bar.
        if matches!(watched, Watched::Simulation(_)) {
            events.clear();
        }
        let (mut emergencies, emergencies_out) = side_ring(ASIDE);
        let (mut errors, errors_out) = side_ring(ASIDE);
        let listener = Listener {
            events: events.clone(),
            narrator: Narrator::new(rig, !matches!(watched, Watched::Simulation(_))),
            emergencies: Aside { outlet: emergencies_out, waiting: None },
            errors: Aside { outlet: errors_out, waiting: None },
            has_line: events.has_line(),
            shown_at: None,
            screen: events.view(),
            taken: 0,
        };
        let feed = Feed::start("events", ring(rig.cycle.period_us), watched.backpressure(), listener);
        let (mut cycles, feed) =
            feed.map_err(|error| Failure::new(Exit::Internal, format!("thread of the events: {error}"), ""))?;
        let mut steps = BootSteps::default();
        let events = events.clone();
        let clock = events.clock();
        clock.set(Time(0));
        // The cycle that comes next: all of them are called on the thread of the loop.
        let next_cycle = Arc::new(AtomicU64::new(0));
        let [of_frames, of_errors] = [(); 2].map(|()| Arc::clone(&next_cycle));
        let watch = Watch {
            observer: Some(Box::new(move |record| {
                cycles.push(record);
                next_cycle.store(record.moment.index + 1, Ordering::Relaxed);
            })),
            tap: Some(Box::new(move |time, packet| {
                clock.set(time);
                if let Packet::Can(frame) = packet
                    && Emergency::decode(frame).is_some()
                {
                    emergencies.push(&(of_frames.load(Ordering::Relaxed), (time, *frame)));
                }
            })),
            boot: Some(Box::new(move |waiting| {
                if let Some(step) = steps.new_step(waiting) {
                    events.tell(&Event::new("boot", None, step));
                }
                false
            })),
            errors: Some(Box::new(move |error| errors.push(&(of_errors.load(Ordering::Relaxed), *error)))),
        };
        Ok((Self(feed), watch))
    }

    /// Waits until every event was reported.
    pub(crate) fn finish(self) -> Result<(), Failure> {
        self.0.finish().map(|_| ()).map_err(|error| Failure::new(Exit::Internal, error.to_string(), ""))
    }
}

/// A stream beside the cycles, each item with the cycle before which it came. An empty ring may have more items later, which a
/// `Peekable` forgets.
struct Aside<T> {
    outlet: Outlet<(u64, T)>,
    /// Item that came before a cycle that was not taken yet.
    waiting: Option<(u64, T)>,
}

impl<T> Aside<T> {
    /// Returns the next one that came before this cycle.
    fn next_before(&mut self, cycle: u64) -> Option<T> {
        match self.waiting.take().or_else(|| self.outlet.next())? {
            (before, item) if before <= cycle => Some(item),
            later => {
                self.waiting = Some(later);
                None
            }
        }
    }
}

struct Listener {
    events: Events,
    narrator: Narrator,
    emergencies: Aside<(Time, Frame)>,
    errors: Aside<DriveError>,
    has_line: bool,
    shown_at: Option<Instant>,
    screen: Option<Arc<Mutex<View>>>,
    taken: u64,
}

impl Listener {
    /// Reports the items that came before this cycle.
    fn take_aside(&mut self, cycle: u64) {
        while let Some((time, frame)) = self.emergencies.next_before(cycle) {
            self.narrator.emergency(time, &frame).iter().for_each(|event| self.events.tell(event));
        }
        while let Some(error) = self.errors.next_before(cycle) {
            self.events.tell(&self.narrator.error(&error));
        }
    }
}

impl Sink<CycleRecord> for Listener {
    type Report = ();

    fn take(&mut self, record: &CycleRecord) -> io::Result<()> {
        self.take_aside(record.moment.index);
        let events = &self.events;
        self.narrator.record(record, &mut |event| events.tell(&event));
        if let Some(view) = &self.screen {
            view.lock().unwrap_or_else(PoisonError::into_inner).take(record);
        }
        if self.has_line && self.shown_at.is_none_or(|at| at.elapsed() >= REFRESH) {
            self.shown_at = Some(Instant::now());
            self.events.show(&self.narrator.line());
        }
        self.taken += 1;
        Ok(())
    }

    fn finish(&mut self) -> io::Result<()> {
        self.take_aside(u64::MAX);
        self.events.lock().ended_s = self.narrator.time_s();
        Ok(())
    }

    fn stored(&self) -> u64 {
        self.taken
    }

    fn report(self) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_after_a_look_at_an_empty_ring_is_told_before_its_cycle() {
        let (mut inlet, outlet) = side_ring(4);
        let mut aside = Aside { outlet, waiting: None };
        assert_eq!(aside.next_before(0), None);
        inlet.push(&(3, 'a'));
        inlet.push(&(5, 'b'));
        assert_eq!([2, 3, 4, 5, 6].map(|cycle| aside.next_before(cycle)), [None, Some('a'), None, Some('b'), None]);
    }
}
