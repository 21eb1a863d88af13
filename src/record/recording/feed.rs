//! The way out of the cycle: a ring that the cycle fills without waiting, and a thread that empties it.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// Rest of the emptying thread when it finds nothing.
const REST: Duration = Duration::from_millis(2);
/// Rest of the filling side when it waits for room.
const WAIT: Duration = Duration::from_micros(100);
/// Number of such rests for a thread that takes nothing: about a second.
const PATIENCE: u32 = 10_000;

/// Takes what comes out of a ring, on a thread of its own.
pub trait Sink<T>: Send + 'static {
    /// Report at the end.
    type Report: Send + 'static;

    /// Takes one item.
    ///
    /// # Errors
    /// If the item is lost. Later items are lost too, but counted.
    fn take(&mut self, item: &T) -> io::Result<()>;

    /// Takes note that the ring is empty, every few milliseconds. So far the ring had no room for `dropped` items.
    fn rest(&mut self, _dropped: u64) {}

    /// Puts all that was taken in place.
    ///
    /// # Errors
    /// If something of it is lost.
    fn finish(&mut self) -> io::Result<()>;

    /// Returns the number of items that are stored for good.
    fn stored(&self) -> u64;

    /// Ends, and returns the final report.
    fn report(self) -> Self::Report;
}

/// Treatment of an item that finds no room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backpressure {
    /// It is lost and counted; [`Producer::push`] does not wait. For real time.
    Drop,
    /// [`Producer::push`] waits for room as long as the thread takes something at least once a second, else as with
    /// `Drop`. For simulations, which are faster than any disk and for which wall-clock time does not count.
    Wait,
}

/// Numbers of items by their fate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Items that are where they belong.
    pub kept: u64,
    /// Items for which the ring had no room.
    pub dropped: u64,
    /// Items that the sink could not take.
    pub refused: u64,
}

impl Counts {
    /// Items that were lost.
    pub fn lost(&self) -> u64 {
        self.dropped + self.refused
    }
}

#[derive(Default)]
struct Shared {
    dropped: AtomicU64,
    taken: AtomicU64,
    is_over: AtomicBool,
}

/// The side that fills the ring.
pub struct Producer<T> {
    ring: rtrb::Producer<T>,
    shared: Arc<Shared>,
    backpressure: Backpressure,
    /// Whether the thread was waited for in vain and has not made room since.
    is_given_up: bool,
}

impl<T: Copy> Producer<T> {
    /// Puts an item into the ring; if there is no room, as [`Backpressure`] says.
    ///
    /// Real-time: yes, with [`Backpressure::Drop`].
    pub fn push(&mut self, item: &T) {
        if self.ring.push(*item).is_ok() {
            self.is_given_up = false;
            return;
        }
        let may_wait = self.backpressure == Backpressure::Wait && !self.is_given_up;
        if may_wait && self.wait_for_room() && self.ring.push(*item).is_ok() {
            return;
        }
        self.shared.dropped.fetch_add(1, Ordering::Relaxed);
    }

    fn wait_for_room(&mut self) -> bool {
        let (mut taken, mut waits) = (self.shared.taken.load(Ordering::Relaxed), 0_u32);
        while self.ring.is_full() && !self.ring.is_abandoned() {
            std::thread::sleep(WAIT);
            let now = self.shared.taken.load(Ordering::Relaxed);
            waits = if now == taken { waits + 1 } else { 0 };
            taken = now;
            if waits > PATIENCE {
                self.is_given_up = true;
                return false;
            }
        }
        true
    }
}

/// Filling side of a ring beside a sink's own ring. An item that finds no room is lost.
pub struct Inlet<T>(rtrb::Producer<T>);

/// Emptying side of such a ring, which a [`Sink`] keeps: an iterator over the items that the ring holds. An item put in before an item of
/// the sink's own ring is available when that item is taken.
pub struct Outlet<T>(rtrb::Consumer<T>);

/// Returns a ring beside that of a sink, with room for `capacity` items: for what comes seldom and belongs between its items.
pub fn side_ring<T: Copy>(capacity: usize) -> (Inlet<T>, Outlet<T>) {
    let (producer, consumer) = rtrb::RingBuffer::new(capacity);
    (Inlet(producer), Outlet(consumer))
}

impl<T: Copy> Inlet<T> {
    /// Puts an item in, if there is room.
    ///
    /// Real-time: yes.
    pub fn push(&mut self, item: &T) {
        // Who fills it waits for nobody.
        let _ = self.0.push(*item);
    }
}

impl<T> Iterator for Outlet<T> {
    type Item = T;

    fn next(&mut self) -> Option<T> {
        self.0.pop().ok()
    }
}

/// A ring with the thread that empties it into a [`Sink`].
pub struct Feed<R> {
    shared: Arc<Shared>,
    thread: JoinHandle<(R, Counts, Option<io::Error>)>,
}

/// Result of a feed.
#[derive(Debug)]
pub struct Finished<R> {
    /// Report of the sink.
    pub report: R,
    /// Numbers of items by their fate.
    pub counts: Counts,
    /// The first error of the sink.
    pub error: Option<io::Error>,
}

impl<R: Send + 'static> Feed<R> {
    /// Returns a ring with room for `capacity` items, and a thread with `name` that empties it into `sink`.
    ///
    /// # Errors
    /// If there is no thread to be had.
    pub fn start<T: Copy + Send + 'static>(
        name: &str,
        capacity: usize,
        backpressure: Backpressure,
        sink: impl Sink<T, Report = R>,
    ) -> io::Result<(Producer<T>, Self)> {
        let (producer, consumer) = rtrb::RingBuffer::new(capacity);
        let shared = Arc::new(Shared::default());
        let seen = Arc::clone(&shared);
        let thread = std::thread::Builder::new().name(name.to_owned()).spawn(move || drain(consumer, &seen, sink))?;
        let producer = Producer { ring: producer, shared: Arc::clone(&shared), backpressure, is_given_up: false };
        Ok((producer, Self { shared, thread }))
    }

    /// Lets the sink take the items in the ring, and ends it. Items pushed afterwards are lost.
    ///
    /// # Errors
    /// If the thread has panicked.
    pub fn finish(self) -> io::Result<Finished<R>> {
        self.shared.is_over.store(true, Ordering::Release);
        let (report, mut counts, error) =
            self.thread.join().map_err(|_| io::Error::other("the writing thread has panicked"))?;
        counts.dropped = self.shared.dropped.load(Ordering::Relaxed);
        Ok(Finished { report, counts, error })
    }
}

fn drain<T: Copy, S: Sink<T>>(
    mut ring: rtrb::Consumer<T>,
    shared: &Shared,
    mut sink: S,
) -> (S::Report, Counts, Option<io::Error>) {
    let mut error = None;
    loop {
        // Asked before the ring is: what was pushed before the end is in the ring by then.
        let is_over = shared.is_over.load(Ordering::Acquire) || ring.is_abandoned();
        while let Ok(item) = ring.pop() {
            if error.is_none() {
                error = sink.take(&item).err();
            }
            shared.taken.fetch_add(1, Ordering::Relaxed);
        }
        sink.rest(shared.dropped.load(Ordering::Relaxed));
        if is_over {
            break;
        }
        std::thread::sleep(REST);
    }
    let finished = sink.finish();
    let kept = sink.stored();
    let refused = shared.taken.load(Ordering::Relaxed).saturating_sub(kept);
    (sink.report(), Counts { kept, dropped: 0, refused }, error.or(finished.err()))
}
