//! Listeners to a rig that runs.

use crate::{BootWatch, ErrorWatch, Observer, Tap};

/// Closures that look on while a rig runs, from switching on to the end.
#[derive(Default)]
pub struct Watch {
    /// Gets every frame on the wires.
    pub tap: Option<Tap>,
    /// Gets the record of every cycle.
    pub observer: Option<Observer>,
    /// Follows the boot.
    pub boot: Option<BootWatch>,
    /// Receives each drive's report on a fault that has stopped the rig.
    pub errors: Option<ErrorWatch>,
}

impl Watch {
    /// This one and the other, after one another. Either may follow the boot, this one if both would.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        let observer: Option<Observer> = match (self.observer, other.observer) {
            (Some(mut this), Some(mut other)) => Some(Box::new(move |record| {
                this(record);
                other(record);
            })),
            (this, other) => this.or(other),
        };
        let tap: Option<Tap> = match (self.tap, other.tap) {
            (Some(mut this), Some(mut other)) => Some(Box::new(move |time, packet| {
                this(time, packet);
                other(time, packet);
            })),
            (this, other) => this.or(other),
        };
        Self { tap, observer, boot: self.boot.or(other.boot), errors: self.errors.or(other.errors) }
    }
}
