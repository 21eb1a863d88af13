//! One period after another.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use super::Runner;
use super::motion_bound::MotionBound;
use crate::permit::Ask;
use crate::place::{Place, Process};
use crate::standstill::LEAST;
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::cycle::{Outputs, Timing};
use yieldwall_motion::guard::Request;
use yieldwall_record::{CycleRecord, Moment, Standstill};

/// How long lockstep waits for the process data of a cycle, in wall-clock time ...
const PATIENCE: Duration = Duration::from_secs(1);
/// ... and for those of a device that already let it wait in vain.
const IMPATIENCE: Duration = Duration::from_millis(2);
/// Time by which the clock that counts suspended time has to have gained on the other since the last cycle. Less may be the
/// time that passed between reading the one and the other.
const SUSPENDED: Duration = Duration::from_millis(50);
impl<P: Place + ?Sized> Runner<P> {
    /// Runs one period: SYNC, process data, the cycle, set-points. Once a cycle has panicked the set-points stop the drives. A
    /// period in which the cycle panics or the process does not run returns `None`. A rig that is guided farther than its permit
    /// allows is stopped. A permit of another boot asks for nothing.
    ///
    /// Real-time: yes, if the observer and the tap are.
    pub fn run_cycle(&mut self, ask: Ask<'_>) -> Option<CycleRecord> {
        let ask = match ask {
            Ask::Enable(permit) if self.check_permit(permit).is_err() => Ask::Nothing,
            ask => ask,
        };
        if let Ask::Enable(permit) = ask {
            self.motion_bound = permit.motion_bound_rad().map(MotionBound::new);
        }
        let mut request = match ask {
            Ask::Nothing if self.is_led_away() => Request::Stop,
            _ => ask.request(),
        };
        if self.next_sync == Time::NEVER {
            // The first one may be too near.
            self.begin(2);
        }
        self.repeat_outputs();
        if self.is_virtual {
            self.attend_until(self.next_sync);
            self.process = self.place.begin_cycle(self.next_sync);
            if self.process != Process::Runs {
                self.miss_cycle();
                return None;
            }
            if self.place.takes_stop() {
                request = Request::Stop;
            }
        }
        let grid = if self.waits { self.begin_in_lockstep() } else { self.begin_on_the_clock() };
        let begin = self.now();
        let planned = grid + self.compute_at;
        self.timing.compute_late_ns = nanos(begin.since(planned));
        let suspended = self.place.suspended();
        self.timing.suspended |=
            suspended.saturating_sub(std::mem::replace(&mut self.suspended, suspended)) > SUSPENDED;
        let timing = std::mem::take(&mut self.timing);
        let Some((outputs, stepped)) = self.compute(begin, request, timing) else {
            self.next_sync = self.after(grid, 1);
            return None;
        };
        let end = if self.waits { begin } else { self.now() };
        self.timing.last_compute_ns = nanos(end.since(begin));
        self.stages.stepped_ns = nanos(stepped.since(planned));
        self.stages.sent_ns = nanos(end.since(planned));
        // The first grid point that has not passed; the next cycle is told of those before it, and they are never made up for.
        self.timing.skipped = self.periods_between(grid, end);
        self.next_sync = self.after(grid, self.timing.skipped + 1);
        if self.waits {
            self.wait_for(self.patience_with_frames(), |master| !master.networks().is_in_flight());
        }
        if let Some(bound) = &mut self.motion_bound {
            bound.look(self.master.state(), outputs.signals.target_angles);
        }
        let moment = Moment {
            index: self.cycles,
            sync_ns: grid.0,
            compute_ns: planned.0,
            scene_time_s: self.scene_from.map_or(f64::NEG_INFINITY, |from| grid.as_secs_f64() - from.as_secs_f64()),
            stages: std::mem::take(&mut self.stages),
            standstill: self.standstill_of_cycles(),
        };
        self.note_cause();
        self.cycles += 1;
        let record =
            CycleRecord::new(moment, self.master.last_inputs(), &outputs, self.master.cause(), self.place.truth());
        if let Some(observer) = &mut self.observer {
            observer(&record);
        }
        Some(record)
    }

    /// Returns the grid point after this number of periods. The grid follows the clock of a segment.
    pub(crate) fn after(&self, grid: Time, periods: u32) -> Time {
        let next = grid + self.period * periods;
        Time(next.0.saturating_add_signed(self.master.networks().grid_shift_ns()))
    }

    /// Whether a rig was guided farther than its permit allows.
    pub(crate) fn is_led_away(&self) -> bool {
        self.motion_bound.is_some_and(|bound| bound.is_left())
    }

    /// Sends the outputs of the last cycle once more before drives act on them, if there is time for it.
    fn repeat_outputs(&mut self) {
        let Some(before) = self.master.networks().repeats_before() else { return };
        let at = Time(self.next_sync.0.saturating_sub(before.as_nanos() as u64));
        if self.waits {
            self.lockstep_now = self.lockstep_now.max(at);
            self.send(|master, _, _| master.networks_mut().repeat());
            self.wait_for(self.patience_with_frames(), |master| !master.networks().is_in_flight());
        } else if at >= self.now() {
            self.attend_until(at);
            self.send(|master, _, _| master.networks_mut().repeat());
        }
    }

    /// Keeps the standstill that was before the present fault began.
    fn note_cause(&mut self) {
        let cause = self.master.cause();
        if cause != self.cause {
            (self.cause, self.stood) = (cause, cause.and(self.standstill_of_cycles()));
        }
    }

    fn standstill_of_cycles(&self) -> Option<Standstill> {
        let least = if self.waits { LEAST } else { self.period };
        self.standstill.last(self.place.now(), least)
    }

    /// Returns the longest time that lockstep waits for own frames, by the wall clock.
    fn patience_with_frames(&self) -> Duration {
        if self.absent.is_empty() { PATIENCE } else { IMPATIENCE }
    }

    /// Handles a period in which the process does not run.
    fn miss_cycle(&mut self) {
        let grid = self.next_sync;
        match self.process {
            Process::Suspended => self.timing.suspended = true,
            _ => self.timing.skipped = self.timing.skipped.saturating_add(1),
        }
        self.place.sleep_until(self.started + (grid + self.compute_at).since(Time(0)), Time::NEVER);
        self.next_sync = grid + self.period;
    }

    /// Sends SYNC on its grid point, then sleeps until the computation. Returns the grid point.
    fn begin_on_the_clock(&mut self) -> Time {
        let mut grid = self.next_sync;
        let mut woke = self.attend_until(grid);
        let missed = self.periods_between(grid, woke);
        if missed > 0 {
            // The first grid point ahead: the cycle that was missed is not made up for.
            self.timing.skipped = self.timing.skipped.saturating_add(missed + 1);
            grid = grid + self.period * (missed + 1);
            woke = self.attend_until(grid);
        }
        self.stages.sync_woke_ns = nanos(woke.since(grid));
        let sent = self.now();
        self.timing.sync_late_ns = nanos(sent.since(grid));
        self.master.networks_mut().note_late(sent.since(grid));
        self.send_sync();
        // Process data follow SYNC, however late that was.
        let woke = self.attend_until(sent + self.compute_at);
        self.stages.woke_ns = nanos(woke.since(grid + self.compute_at));
        grid
    }

    /// Lets time pass until a moment, and takes what has come; when the loop woke up.
    fn attend_until(&mut self, moment: Time) -> Time {
        loop {
            let on_clock = |time: Time| self.started + time.since(Time(0));
            let runs = self.process == Process::Runs;
            let deadline = if runs { self.master.networks().next_deadline() } else { Time::NEVER };
            self.standstill.wait_until(on_clock(moment));
            self.place.sleep_until(on_clock(moment), on_clock(deadline));
            let woke = self.now();
            let has_come = self.drain();
            if !self.is_virtual {
                return woke;
            }
            if has_come {
                continue;
            }
            if deadline <= woke {
                self.send(|master, now, out| master.networks_mut().poll(now, out));
            } else if woke >= moment {
                return woke;
            }
        }
    }

    /// Sends SYNC, then waits for the process data. Returns the grid point.
    fn begin_in_lockstep(&mut self) -> Time {
        let grid = self.next_sync;
        self.lockstep_now = grid;
        self.drain();
        self.send_sync();
        if !self.master.networks().is_sync_held() {
            let absent = self.absent;
            self.wait_for(PATIENCE, |master| absent.contains(master.networks().missing(grid)));
            self.wait_for(IMPATIENCE, |master| master.networks().missing(grid).is_empty());
            self.absent = self.master.networks().missing(grid);
        }
        self.lockstep_now = grid + self.compute_at;
        grid
    }

    fn send_sync(&mut self) {
        if self.master.networks().is_silent() {
            self.place.drop_queue();
        }
        self.send(|master, _, out| master.networks_mut().open(out));
    }

    /// Runs the cycle, and returns its outputs and the moment after its computation; `None` if it panicked, after a last quick stop.
    fn compute(&mut self, begin: Time, request: Request, timing: Timing) -> Option<(Outputs, Time)> {
        if self.master.networks().next_deadline() <= begin {
            self.send(|master, now, out| master.networks_mut().poll(now, out));
        }
        let result = catch_unwind(AssertUnwindSafe(|| {
            let outputs = self.master.step(begin, request, timing);
            self.place.computed(&outputs);
            let stepped = self.now();
            self.send(|master, now, out| master.send_set_points(now, out));
            (outputs, stepped)
        }));
        match result {
            Ok((outputs, stepped)) => {
                self.last = Some(outputs);
                Some((outputs, stepped))
            }
            Err(panic) => {
                (self.has_panicked, self.panic) = (true, Some(panic));
                self.send(|master, now, out| master.quick_stop_now(now, out));
                None
            }
        }
    }
}

fn nanos(time: Duration) -> u32 {
    time.as_nanos().min(u128::from(u32::MAX)) as u32
}
