//! ethercrab's frames to a simulated segment and back, in virtual time.

use std::cell::Cell;
use std::future::{Future, poll_fn};
use std::pin::pin;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use ethercrab::{PduRx, PduTx};
use yieldwall::time::Time;

thread_local! {
    static NOW: Cell<Time> = const { Cell::new(Time(0)) };
}

/// Time of the clock that ethercrab's timers and the segment live on.
pub fn now() -> Time {
    NOW.with(Cell::get)
}

/// The clock of ethercrab's timers.
struct Clock;

impl embassy_time_driver::Driver for Clock {
    fn now(&self) -> u64 {
        now().0 / 1000
    }

    /// Nobody sleeps here: whoever waits is polled at every step.
    fn schedule_wake(&self, _: u64, _: &Waker) {}
}

embassy_time_driver::time_driver_impl!(static CLOCK: Clock = Clock);

/// How far time goes on when no frame is on its way.
const STEP: Duration = Duration::from_micros(5);
/// Time after which a run has hung.
const LONGEST: Duration = Duration::from_secs(120);

/// Waits for a moment.
pub async fn sleep_until(moment: Time) {
    poll_fn(|_| if now() >= moment { Poll::Ready(()) } else { Poll::Pending }).await;
}

/// Runs a master to its end. `segment` changes a frame in place and says when it is back.
///
/// # Panics
/// If the master has not ended after two minutes of virtual time.
pub fn run<T>(
    mut tx: PduTx<'_>,
    mut rx: PduRx<'_>,
    mut segment: impl FnMut(Time, &mut [u8]) -> Time,
    mut tap: impl FnMut(Time, &[u8]),
    master: impl Future<Output = T>,
) -> T {
    let mut master = pin!(master);
    let mut frame: Vec<u8> = Vec::with_capacity(1514);
    loop {
        if let Poll::Ready(result) = master.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
            return result;
        }
        assert!(now() < Time(0) + LONGEST, "the master has not ended");
        let Some(sendable) = tx.next_sendable_frame() else {
            NOW.set(now() + STEP);
            continue;
        };
        frame.clear();
        let sent = sendable.send_blocking(|bytes| {
            frame.extend_from_slice(bytes);
            Ok(bytes.len())
        });
        sent.expect("a frame is taken whole");
        tap(now(), &frame);
        let back = segment(now(), &mut frame);
        NOW.set(back.max(now() + Duration::from_micros(1)));
        tap(now(), &frame);
        rx.receive_frame(&frame).expect("the reply is the master's own frame");
    }
}
