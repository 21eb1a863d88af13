//! A live page of a rig, and of recordings, served to a browser on the same computer.
//!
//! ```text
//! cycle -> Producer (wait-free ring) ... Feed (own thread) -> ViewSink: 16 records a packet -> broadcast(64)
//!                                                                        | Server (own thread)
//! recording on disk -> Reader -> packets                                  +-> WebSocket clients, /metrics
//!                        +-> /recordings/N
//! ```
//! The cycle pays one push of a record. A client that does not keep up loses records and gets their number. It delays
//! neither the cycle nor the other clients.
//!
//! The page is read-only: [`gate`] admits GET alone, and data from a client close its connection. The page of a simulation
//! alone takes an [`Order`]: [`Source::Play`] has the [`Desk`] for it.
//! `docs/live-page.md` has the threat model.
//!
//! ```
//! use yieldwall_record::{CycleRecord, recording::{Backpressure, Feed, Recorded}};
//! use yieldwall_view::{Description, Fixture, Hello, RING, Server, Source, faults, stream};
//!
//! let hello = Hello {
//!     program: "yieldwall 0.1.0".into(),
//!     command: "run",
//!     tier: None,
//!     machine: Description {
//!         name: "bench".into(),
//!         period_s: 0.001,
//!         arm: None,
//!         surfaces: Vec::new(),
//!         view_m: [-0.2, 0.0, 0.2, 0.4],
//!         fixture: Fixture { law: "plastic".into(), yield_force_n: Some(20.0), rows: Vec::new() },
//!     },
//!     faults: faults(),
//!     play: None,
//! };
//! let (stream, sink) = stream::<CycleRecord>();
//! let (mut producer, feed) = Feed::start("view", RING, Backpressure::Drop, sink)?;
//! let server = Server::start("127.0.0.1:0".parse()?, hello, Source::Live(stream))?;
//! println!("{}", server.address_line());
//! producer.push(&CycleRecord::blank());
//! // The feed hands over what is in its ring, then the clients get the end.
//! feed.finish()?;
//! server.end("The scene ended after 1 cycle.");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod client;
mod files;
pub mod gate;
mod hello;
mod metrics;
mod order;
mod packet;
mod patient;
mod recordings;
mod server;
mod stream;
#[cfg(test)]
mod tests;

pub use hello::{
    Arm, Choice, Description, FaultWords, Fixture, Forbidden, Hello, Injectable, Play, Setting, Surface, Tool, faults,
};
pub use order::{Desk, Order, orders};
pub use recordings::RecordingFile;
pub use server::{BusLoad, Server, Source, StartError};
pub use stream::{RING, Stream, ViewSink, stream};
