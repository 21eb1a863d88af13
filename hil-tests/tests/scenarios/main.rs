//! Scenarios over the whole rig in virtual time, and what is held of the program from outside: one program, since each links the whole
//! library.
//!
//! `cargo test -p hil-tests --test scenarios faults::` runs those of one file.

mod adopt;
mod arbitrary;
mod axes;
mod bus_budget;
mod buses;
mod captured;
mod data_sheets;
mod device_descriptions;
mod endings;
mod examples;
mod exchange;
mod faults;
mod figures;
mod fixed_objects;
mod fixed_process_data;
mod force_sensors;
mod hostile;
mod injections;
mod json;
mod live;
mod live_page;
mod mujoco;
mod processes;
mod profiles;
mod recording;
mod sensor_profiles;
mod soak;
mod sources;
mod strangers;
mod two_masters;
mod waits;
mod watchdogs;
