//! Decoders and engines fed arbitrary bytes.
//!
//! A body takes bytes for a stream of time steps, frames and numbers, or for a text, drives one part of the program with
//! them and asserts what that part promises whatever it is given. `hil-tests/tests/scenarios/arbitrary.rs` runs every body of
//! [`TARGETS`] on random bytes and on altered [`Target::seeds`]; `hil-tests/fuzz` has each as a target for a fuzzer.

mod bus;
mod bytes;
mod cia402;
mod config;
mod cycle;
mod device;
mod ethercat;
mod handshake;
mod laws;
mod pdo;
mod plain_can;
mod recording;
mod sdo;
mod sensing;
mod sim;
mod watch;

pub use bus::master;
pub use cia402::{cia402, scaling};
pub use config::configuration;
pub use cycle::cycle;
pub use device::{device, dictionary};
pub use ethercat::{coe_client, ethercat_description, ethercat_frames, ethercat_master, ethercat_sii};
pub use handshake::handshake;
pub use pdo::{pdo_layout, pdo_parameters};
pub use plain_can::plain_can;
pub use recording::recording;
pub use sdo::sdo_client;
pub use sensing::{calibration, sensing};
pub use sim::{drive, force_sensor};
pub use watch::{frames, heartbeat};

/// One body.
#[derive(Clone, Copy)]
pub struct Target {
    /// Its name, which is that of the function.
    pub name: &'static str,
    /// The body; it panics where a law is broken.
    pub body: fn(&[u8]),
    /// Inputs that lead far into the part, to be altered.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

macro_rules! targets {
    ($($body:ident: $seeds:expr,)*) => {
        /// Every body, in alphabetical order.
        pub const TARGETS: &[Target] = &[$(Target { name: stringify!($body), body: $body, seeds: $seeds }),*];
    };
}

targets! {
    calibration: sensing::calibrations,
    cia402: cia402::walks,
    coe_client: ethercat::answers,
    configuration: config::shipped,
    cycle: cycle::runs,
    device: device::conversations,
    dictionary: device::dictionaries,
    drive: sim::drives,
    ethercat_description: ethercat::descriptions,
    ethercat_frames: ethercat::frames,
    ethercat_master: ethercat::masters,
    ethercat_sii: ethercat::images,
    force_sensor: sim::force_sensors,
    frames: watch::messages,
    handshake: handshake::heads,
    heartbeat: watch::heartbeats,
    master: bus::networks,
    pdo_layout: pdo::layouts,
    pdo_parameters: pdo::parameters,
    plain_can: plain_can::conversations,
    recording: recording::recordings,
    scaling: cia402::positions,
    sdo_client: sdo::transfers,
    sensing: sensing::chains,
}
