//! Worst-case response times of frames that compete by priority.
//!
//! # Source
//! [DBBL07]: R. I. Davis, A. Burns, R. J. Bril, J. J. Lukkien, "Controller Area Network (CAN) schedulability analysis:
//! refuted, revisited and revised", Real-Time Systems 35 (2007).

/// Longest busy period that is followed, 1 s. A bus that can be busy for longer is taken to have no bound.
const LONGEST_BUSY_NS: u64 = 1_000_000_000;

/// A stream of frames with one identifier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stream {
    /// Identifier, which is the priority: lower goes first.
    pub cob_id: u16,
    /// C: time on the wire, interframe space included, ns.
    pub transmission_ns: u64,
    /// T: least time from one release to the next, jitter apart, ns. Above 0.
    pub period_ns: u64,
    /// J: how late after its period a frame can be released, ns.
    pub jitter_ns: u64,
}

/// R: the longest time from the beginning of a period to the end of its frame, ns; `None` if there is no bound.
///
/// `blocking_ns` is the longest that a frame of lower priority keeps the bus, `before` are the streams that go first,
/// `bit_ns` is the time of one bit. Several instances in one busy period are looked at, as a frame that is sent can hold
/// up the next of its own stream; deadlines may be longer than periods.
pub fn response_ns(stream: &Stream, blocking_ns: u64, before: &[Stream], bit_ns: u64) -> Option<u64> {
    let &Stream { transmission_ns: own, period_ns, jitter_ns, .. } = stream;
    let busy = settle(own, |busy| {
        blocking_ns.saturating_add(demand(before, busy, 0)).saturating_add(demand(&[*stream], busy, 0))
    })?;
    let instances = (busy.saturating_add(jitter_ns)).div_ceil(period_ns);
    let mut worst = 0;
    let mut waiting = blocking_ns;
    for instance in 0..instances {
        let ahead = blocking_ns.saturating_add(own.saturating_mul(instance));
        waiting = settle(waiting.max(ahead), |waiting| ahead.saturating_add(demand(before, waiting, bit_ns)))?;
        let response = (jitter_ns + waiting + own).saturating_sub(instance.saturating_mul(period_ns));
        worst = worst.max(response);
    }
    Some(worst)
}

/// [`response_ns`] of one of several streams that may all be released at one moment: lower identifiers go before it, the
/// longest of the others blocks it.
pub fn response_among_ns(stream: &Stream, others: &[Stream], bit_ns: u64) -> Option<u64> {
    let before: Vec<Stream> = others.iter().copied().filter(|other| other.cob_id < stream.cob_id).collect();
    response_ns(stream, blocking_ns(others, stream.cob_id), &before, bit_ns)
}

/// The longest transmission among those with a lower priority than `cob_id`.
pub fn blocking_ns(others: &[Stream], cob_id: u16) -> u64 {
    let after = others.iter().filter(|other| other.cob_id > cob_id);
    after.map(|other| other.transmission_ns).max().unwrap_or_default()
}

/// Bus time that the streams need in a window that is open for `window_ns` and `more_ns`.
fn demand(streams: &[Stream], window_ns: u64, more_ns: u64) -> u64 {
    let each = streams.iter().map(|stream| {
        let window = window_ns.saturating_add(stream.jitter_ns).saturating_add(more_ns);
        window.div_ceil(stream.period_ns).saturating_mul(stream.transmission_ns)
    });
    each.fold(0, u64::saturating_add)
}

/// The least fixed point of a growing function from `start` on.
fn settle(start: u64, next: impl Fn(u64) -> u64) -> Option<u64> {
    let mut value = start;
    while value <= LONGEST_BUSY_NS {
        let after = next(value);
        if after == value {
            return Some(value);
        }
        value = after;
    }
    None
}

#[cfg(test)]
mod tests;
