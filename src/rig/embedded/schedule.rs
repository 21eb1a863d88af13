//! Injections that wait.

use crate::injection::Injection;

/// What waits for its moment.
#[derive(Debug)]
pub(super) struct Schedule {
    pub(super) waiting: Vec<Injection>,
    /// When something begins or ends next, in s since the scene began.
    pub(super) next_change_s: f64,
}

impl Default for Schedule {
    fn default() -> Self {
        Self { waiting: Vec::new(), next_change_s: f64::INFINITY }
    }
}
