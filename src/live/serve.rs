//! Simulated devices on a link.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use thiserror::Error;

use crate::link::{CanLink, LinkOutbox, Received, SendError};
use crate::rig::{DeviceServer, RigError};

/// Longest wait for a frame before the wish to end is looked at.
const LOOK_UP: Duration = Duration::from_millis(50);

/// Why simulated devices could not go on.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ServeError {
    /// The simulated arm cannot go on.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// The interface was removed.
    #[error("the interface is gone")]
    Gone,
}

/// Switches the devices on that are simulated here and serves them until `is_over` or the interface is removed. An interface that is down is waited
/// for: the devices then hear nothing, as on a cable that is out. `between` is called now and then, at least twenty times a second.
///
/// # Errors
/// If the simulated arm cannot go on, or there is no interface any more.
pub fn serve<L: CanLink>(
    server: &mut DeviceServer,
    link: &mut L,
    is_over: &AtomicBool,
    mut between: impl FnMut(&mut DeviceServer),
) -> Result<(), ServeError> {
    let wall = link.now();
    send(link, |out| {
        server.switch_on(wall, out);
        Ok(())
    })?;
    while !is_over.load(Ordering::Relaxed) {
        while let Some(arrival) = link.receive() {
            match arrival.what {
                Received::Frame(frame) => {
                    let wall = link.now();
                    send(link, |out| server.on_frame(wall, &frame, out))?;
                }
                Received::Gone => return Err(ServeError::Gone),
                _ => {}
            }
        }
        between(server);
        let wall = link.now();
        send(link, |out| server.poll(wall, out))?;
        link.wait(server.next_deadline().min(wall + LOOK_UP));
    }
    Ok(())
}

fn send<L: CanLink>(
    link: &mut L,
    act: impl FnOnce(&mut LinkOutbox<'_, L>) -> Result<(), RigError>,
) -> Result<(), ServeError> {
    let mut out = LinkOutbox::new(link);
    act(&mut out)?;
    if matches!(out.failure(), Some((_, SendError::Gone))) { Err(ServeError::Gone) } else { Ok(()) }
}
