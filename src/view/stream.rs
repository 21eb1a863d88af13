//! The way from a feed to the clients.

use std::io;
use std::marker::PhantomData;
use std::sync::{Arc, Mutex, PoisonError};

use axum::body::Bytes;
use tokio::sync::broadcast;
use yieldwall_record::recording::{FieldLayout, Layout, Recorded, Sink, layout};

use crate::packet::Packet;

/// Records that the ring of a view's feed has room for: half a second at 1 kHz.
pub const RING: usize = 512;
/// Most records in a packet.
pub(crate) const RECORDS: u32 = 16;
/// Rests of the feed after which an incomplete packet leaves: about 20 ms.
const RESTS: u32 = 10;
/// Packets that wait for the slowest client; older ones are lost to it.
pub(crate) const WAITING: usize = 64;

/// A packet on its way to every client.
#[derive(Clone, Debug)]
pub(crate) struct Published {
    /// Records in the stream before this packet.
    pub(crate) before: u64,
    /// Records in the packet.
    pub(crate) count: u32,
    pub(crate) bytes: Bytes,
}

/// Figures of the stream up to the last packet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Figures {
    /// Records that were sent.
    pub(crate) records: u64,
    /// Records for which the ring had no room.
    pub(crate) lost: u64,
    /// Delay of the last record's computation in ns; `None` without such a field.
    pub(crate) late_ns: Option<u64>,
    /// Greatest delay in ns.
    pub(crate) most_late_ns: Option<u64>,
    /// Number of the supervisor's state; `None` without such a field.
    pub(crate) state: Option<u64>,
    /// Number of the fault that led to the state.
    pub(crate) fault: Option<u64>,
}

struct Shared {
    packets: broadcast::Sender<Published>,
    layout: Layout,
    figures: Mutex<Figures>,
}

/// The records of a running rig, for a [`Server`](crate::Server).
#[derive(Clone)]
pub struct Stream(Arc<Shared>);

impl std::fmt::Debug for Stream {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Stream").field(&self.figures()).finish()
    }
}

impl Stream {
    pub(crate) fn layout(&self) -> &Layout {
        &self.0.layout
    }

    pub(crate) fn packets(&self) -> &broadcast::Sender<Published> {
        &self.0.packets
    }

    pub(crate) fn figures(&self) -> Figures {
        *self.0.figures.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn set_figures(&self, figures: Figures) {
        *self.0.figures.lock().unwrap_or_else(PoisonError::into_inner) = figures;
    }
}

/// The fields that `/metrics` shows, as far as the records have them.
struct Shown {
    late: Option<FieldLayout>,
    state: Option<FieldLayout>,
    has_cause: Option<FieldLayout>,
    cause: Option<FieldLayout>,
}

impl Shown {
    fn of(layout: &Layout) -> Self {
        let field = |name| layout.field(name).cloned();
        Self {
            late: field("compute_late_ns"),
            state: field("state"),
            has_cause: field("has_cause"),
            cause: field("cause"),
        }
    }

    fn note(&self, record: &[u8], figures: &mut Figures) {
        let bits = |field: &Option<FieldLayout>| field.as_ref().and_then(|field| field.bits(record));
        figures.records += 1;
        figures.late_ns = bits(&self.late);
        figures.most_late_ns = figures.most_late_ns.max(figures.late_ns);
        figures.state = bits(&self.state);
        figures.fault = bits(&self.cause).filter(|_| bits(&self.has_cause) == Some(1));
    }
}

/// Sink of a feed: packs the records and hands them to the clients.
pub struct ViewSink<T> {
    stream: Stream,
    shown: Shown,
    packet: Packet,
    figures: Figures,
    /// Rests since the packet has its first record.
    rests: u32,
    records: PhantomData<fn(&T)>,
}

/// Returns a stream of records `T`, and the sink of the feed that fills it.
pub fn stream<T: Recorded>() -> (Stream, ViewSink<T>) {
    let layout = layout::<T>();
    let (shown, packet) = (Shown::of(&layout), Packet::new(RECORDS, layout.stride));
    let packets = broadcast::Sender::new(WAITING);
    let stream = Stream(Arc::new(Shared { packets, layout, figures: Mutex::default() }));
    let sink =
        ViewSink { stream: stream.clone(), shown, packet, figures: Figures::default(), rests: 0, records: PhantomData };
    (stream, sink)
}

impl<T> ViewSink<T> {
    fn flush(&mut self) {
        self.rests = 0;
        let count = self.packet.count();
        if let Some(bytes) = self.packet.take(self.figures.lost) {
            self.stream.set_figures(self.figures);
            let before = self.figures.records - u64::from(count);
            // An error means that nobody looks.
            let _ = self.stream.packets().send(Published { before, count, bytes });
        }
    }
}

impl<T: Recorded> Sink<T> for ViewSink<T> {
    type Report = ();

    fn take(&mut self, record: &T) -> io::Result<()> {
        let bytes = self.packet.push(record);
        self.shown.note(bytes, &mut self.figures);
        if self.packet.count() == RECORDS {
            self.flush();
        }
        Ok(())
    }

    fn rest(&mut self, dropped: u64) {
        self.figures.lost = dropped;
        if self.packet.count() > 0 {
            self.rests += 1;
            if self.rests == RESTS {
                self.flush();
            }
        }
    }

    fn finish(&mut self) -> io::Result<()> {
        self.flush();
        self.stream.set_figures(self.figures);
        Ok(())
    }

    fn stored(&self) -> u64 {
        self.figures.records
    }

    fn report(self) {}
}
