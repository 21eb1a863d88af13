//! Engines of a master, run over a link.

use std::time::Duration;

use yieldwall::canopen::lss::{LssMaster, LssOutcome, LssRequest};
use yieldwall::canopen::{Frame, SdoClient, SdoOutcome, node_id};
use yieldwall::link::{Arrival, CanLink, LinkOutbox, Received};
use yieldwall::time::Time;

use super::PATIENCE;

/// Sends all of `frames`.
///
/// # Panics
/// If the link refuses one.
pub fn send_all(link: &mut impl CanLink, frames: &mut Vec<Frame>) {
    for frame in frames.drain(..) {
        link.send(&frame).unwrap_or_else(|error| panic!("{:03X}h: {error}", frame.id()));
    }
}

/// Runs an engine over a link until it gives something. `act` gets each frame of others, and `None` when the moment that it
/// asks for has come; it gives what it waited for, or the next such moment.
///
/// # Panics
/// If it takes longer than [`PATIENCE`] without frames.
pub fn run<T, L: CanLink>(
    link: &mut L,
    first: Time,
    mut act: impl FnMut(Time, Option<&Frame>, &mut LinkOutbox<'_, L>) -> Result<T, Time>,
) -> T {
    let mut act = |link: &mut L, now: Time, frame: Option<&Frame>| {
        let mut out = LinkOutbox::new(link);
        let done = act(now, frame, &mut out);
        assert_eq!(out.failure(), None);
        done
    };
    let mut deadline = first;
    let mut idle_since: Option<Time> = None;
    loop {
        let until = idle_since.map_or(deadline, |since| deadline.min(since + PATIENCE));
        if link.wait(until)
            && let Some(arrival) = link.receive()
            && let Received::Frame(frame) = arrival.what
        {
            idle_since = Some(arrival.time);
            match act(link, arrival.time, Some(&frame)) {
                Ok(result) => return result,
                Err(next) => deadline = next,
            }
            if arrival.time < deadline {
                continue;
            }
        }
        let now = link.now();
        if deadline <= now {
            match act(link, now, None) {
                Ok(result) => return result,
                Err(next) => deadline = next,
            }
        }
        assert!(now < *idle_since.get_or_insert(now) + PATIENCE, "nothing has come for {PATIENCE:?}");
    }
}

/// A client for a node, with times that a busy machine keeps, where no process data run.
///
/// # Panics
/// If `id` is no node id.
pub fn client(id: u8) -> SdoClient {
    let id = node_id(id).expect("1 to 127");
    let mut client = SdoClient::new(id, Duration::from_secs(1), SdoClient::DEFAULT_CAPACITY);
    client.set_exchanging(false);
    client
}

/// Runs the transfer that `start` begins to its end.
pub fn transfer(
    link: &mut impl CanLink,
    client: &mut SdoClient,
    start: impl FnOnce(&mut SdoClient, Time, &mut Vec<Frame>),
) -> SdoOutcome {
    let mut out = Vec::new();
    start(client, link.now(), &mut out);
    send_all(link, &mut out);
    run(link, client.next_deadline(), |now, frame, out| {
        let outcome = match frame {
            Some(frame) => client.on_frame(now, frame, out),
            None => client.poll(now, out),
        };
        outcome.ok_or_else(|| client.next_deadline())
    })
}

/// Runs an LSS request to its end.
///
/// # Panics
/// If the master is busy.
pub fn lss(link: &mut impl CanLink, master: &mut LssMaster, request: LssRequest) -> LssOutcome {
    let mut out = Vec::new();
    let at_once = master.start(link.now(), request, &mut out).expect("one request at a time");
    send_all(link, &mut out);
    at_once.unwrap_or_else(|| {
        run(link, master.next_deadline(), |now, frame, out| {
            let outcome = match frame {
                Some(frame) => master.on_frame(now, frame, out),
                None => master.poll(now, out),
            };
            outcome.ok_or_else(|| master.next_deadline())
        })
    })
}

/// The next thing that comes and for which `is_it`; everything else is passed over.
///
/// # Panics
/// If it does not come within [`PATIENCE`].
pub fn hear(link: &mut impl CanLink, is_it: impl Fn(&Received) -> bool) -> Arrival {
    let until = link.now() + PATIENCE;
    while link.now() < until {
        while let Some(arrival) = link.receive() {
            if is_it(&arrival.what) {
                return arrival;
            }
        }
        link.wait(until);
    }
    panic!("it has not come for {PATIENCE:?}");
}
