//! Hardware in the loop: the same bodies on the bus in virtual time and on an interface of this machine.
//!
//! `hil-tests/run` runs all of them; where the kernel has no CAN it boots one that has. By hand:
//!
//! ```text
//! cargo test -p hil-tests --test hil                          # in virtual time
//! hil-tests/vcan cargo test -p hil-tests --test hil -- --ignored --test-threads 1 --skip ethernet::
//! hil-tests/veth cargo test -p hil-tests --test hil ethernet:: -- --ignored --test-threads 1
//! YIELDWALL_CAN=can0 cargo test -p hil-tests --test hil on_interface -- --ignored --test-threads 1
//! ```
//!
//! On an interface nothing is said about times: order, counts, states and contents are what counts there.

mod bodies;
#[cfg(target_os = "linux")]
mod buses;
#[cfg(target_os = "linux")]
mod desk;
#[cfg(target_os = "linux")]
mod ethernet;
#[cfg(target_os = "linux")]
mod homed;
#[cfg(target_os = "linux")]
mod interface;
#[cfg(target_os = "linux")]
mod killed;
#[cfg(target_os = "linux")]
mod lockstep;
#[cfg(target_os = "linux")]
mod masters;
#[cfg(target_os = "linux")]
mod power_cycle;
#[cfg(target_os = "linux")]
mod processes;
#[cfg(target_os = "linux")]
mod programs;
#[cfg(target_os = "linux")]
mod refused;
#[cfg(target_os = "linux")]
mod shipped;
#[cfg(target_os = "linux")]
mod wall_clock;

/// Every body once on each kind of bus.
macro_rules! on_both {
    ($($name:ident,)*) => {
        mod on_virtual {
            $(#[test] fn $name() { super::bodies::$name(&mut hil_tests::network::Virtual::new()); })*
        }
        #[cfg(target_os = "linux")]
        mod on_interface {
            $(#[test] #[ignore = "needs a CAN interface: see hil-tests/vcan"]
            fn $name() { super::bodies::$name(&mut hil_tests::network::Real::new()); })*
        }
    };
}

on_both! {
    short_values_are_written_and_read,
    long_values_pass_in_segments_and_in_blocks,
    blocks_pass_when_every_seventh_data_frame_is_lost,
    blocks_pass_when_5_percent_of_all_frames_are_lost,
    blocks_pass_when_the_last_segment_the_end_and_every_acknowledgement_are_lost_once,
    a_device_refuses_what_it_does_not_have,
    a_device_follows_its_master_and_tells_of_its_state,
    a_lost_heartbeat_is_an_emergency,
    a_device_without_node_id_is_given_one,
    own_frames_come_back_in_order,
    nothing_comes_from_a_silent_bus,
    a_rig_boots_and_exchanges_process_data,
}
