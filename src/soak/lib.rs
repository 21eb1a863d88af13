//! Deterministic fault simulation of the whole rig: machines, hands, faults and people drawn from seeds, and a checker
//! that watches every cycle from outside.

mod attempt;
mod campaign;
mod checker;
mod dice;
mod draw;
mod excuse;
mod invariant;
mod nature;
mod observation;
mod operator;
mod report;
mod script;
mod seed;
mod segment;
mod session;
mod shrink;
mod store;
mod tally;
mod tolerance;
mod verdict;

pub use campaign::{Campaign, run};
pub use checker::{Checker, Limits, Peaks};
pub use draw::{Machine, RIGS, Shipped};
pub use excuse::Excuse;
pub use invariant::{Invariant, Violation};
pub use observation::{Falsified, Observation, Reported, Sender, Setpoint, Sighting, Status, Truth};
pub use report::{markdown, text};
pub use script::Script;
pub use seed::run_seed;
pub use segment::{OnCable, OnCableAt};
pub use session::{Course, End, Event, Play, play, play_watched};
pub use store::{Store, StoreError};
pub use tally::{FaultTally, InjectionTally, Latency, SeedResult, Tally};
pub use verdict::{Followed, ObservedFault};
