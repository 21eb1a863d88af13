//! `--tui`: a screen with axes, force, lateness and events, and a key that stops the rig.
//!
//! ```text
//! thread "events":  records and events --> View (a lock that neither the cycle nor the keys ever take)
//! thread "screen":  View, ten times a second --> terminal
//! thread "keys":    terminal --> the flag that Ctrl-C sets, which the loop looks at once a cycle
//! ```
//! Reset and enabling again take two keys each, and go to the loop as [`Orders`](yieldwall_run::Orders). A stop goes from the key to the
//! flag and passes nothing that draws: it works also while the screen is slow or stands still.

#[cfg(feature = "full")]
mod draw;
#[cfg(feature = "full")]
mod keys;
#[cfg(feature = "full")]
mod screen;
mod view;

#[cfg(not(feature = "full"))]
pub(super) use super::full::{Screen, check_terminal};
#[cfg(feature = "full")]
pub(super) use screen::{Screen, check_terminal};
pub(super) use view::View;
