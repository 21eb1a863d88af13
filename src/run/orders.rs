//! Orders of a person for a rig that a fault has stopped.

use std::sync::atomic::{AtomicBool, Ordering};

/// Orders of a person from another thread, each given once by a deliberate act. An order that comes in a state that does not accept
/// it is forgotten: nothing is reset or enabled later than it was asked for.
#[derive(Debug, Default)]
pub struct Orders {
    reset: AtomicBool,
    enable: AtomicBool,
}

impl Orders {
    /// Asks to forget what has stopped the rig; nothing is enabled.
    pub fn reset(&self) {
        self.reset.store(true, Ordering::Relaxed);
    }

    /// Asks to enable the rig again, after a reset.
    pub fn enable(&self) {
        self.enable.store(true, Ordering::Relaxed);
    }

    /// Returns the orders since the last call: a reset, to be enabled.
    ///
    /// Real-time: yes.
    pub(super) fn take(&self) -> [bool; 2] {
        [&self.reset, &self.enable].map(|order| order.swap(false, Ordering::Relaxed))
    }
}
