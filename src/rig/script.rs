//! Schedule of injections.

use yieldwall_config::injection::{Injection, Lasts};

/// Injections that wait for their moment, and injections that act until their own.
#[derive(Debug)]
pub(super) struct Script {
    waiting: Vec<Injection>,
    /// Lasting injections that have begun, in this order.
    acting: Vec<Injection>,
    /// When something begins or ends next, in s since the scene began.
    next_change_s: f64,
}

impl Default for Script {
    fn default() -> Self {
        Self { waiting: Vec::new(), acting: Vec::new(), next_change_s: f64::INFINITY }
    }
}

impl Script {
    /// Schedules an injection for its moment.
    pub(super) fn add(&mut self, injection: Injection) {
        self.waiting.push(injection);
        // Whatever begins in a cycle finds its place.
        self.acting.reserve(self.waiting.len());
        self.plan();
    }

    /// Notes that an injection begins now.
    pub(super) fn begin(&mut self, injection: Injection) {
        if injection.kind.row().lasts != Lasts::Once {
            self.acting.push(injection);
        }
        self.plan();
    }

    /// Returns the time of the next begin or end, in s since the scene began; infinity for never.
    pub(super) fn next_change_s(&self) -> f64 {
        self.next_change_s
    }

    /// Whether something begins or ends.
    pub(super) fn is_due(&self, time_s: f64) -> bool {
        time_s >= self.next_change_s
    }

    /// Removes and returns the next injection that ends by then.
    pub(super) fn take_ending(&mut self, time_s: f64) -> Option<Injection> {
        let at = self.acting.iter().position(|injection| injection.end_s() <= time_s)?;
        let over = self.acting.remove(at);
        self.plan();
        Some(over)
    }

    /// Removes and returns the next injection that begins by then.
    pub(super) fn take_beginning(&mut self, time_s: f64) -> Option<Injection> {
        let at = self.waiting.iter().position(|injection| injection.start_s <= time_s)?;
        let due = self.waiting.remove(at);
        self.plan();
        Some(due)
    }

    /// Forgets what waits, and gives what acts: it ends.
    pub(super) fn stop(&mut self) -> Vec<Injection> {
        std::mem::take(self).acting
    }

    fn plan(&mut self) {
        let starts = self.waiting.iter().map(|injection| injection.start_s);
        let ends = self.acting.iter().map(Injection::end_s);
        self.next_change_s = starts.chain(ends).fold(f64::INFINITY, f64::min);
    }
}
