//! Listening before anything is sent, for those that are no master of a rig.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use yieldwall_bus::HeardFrame;
use yieldwall_fieldbus::canopen::Frame;
use yieldwall_link::{CanLink, Received};

/// Longest wait before the wish to end is looked at.
const LOOK_UP: Duration = Duration::from_millis(50);

/// Takes what others send for `time`, on the wall, or until `is_over`; the first frame in which `find` finds something.
pub fn listen<L: CanLink>(
    link: &mut L,
    time: Duration,
    is_over: &AtomicBool,
    find: impl Fn(&Frame) -> Option<HeardFrame>,
) -> Option<HeardFrame> {
    let until = link.now() + time;
    loop {
        while let Some(arrival) = link.receive() {
            if let Received::Frame(frame) = arrival.what
                && let Some(heard) = find(&frame)
            {
                return Some(heard);
            }
        }
        // What has come while this process was stopped is looked at as well.
        let now = link.now();
        if is_over.load(Ordering::Relaxed) || (now >= until && !link.wait(until)) {
            return None;
        }
        link.wait(until.min(now + LOOK_UP));
    }
}
