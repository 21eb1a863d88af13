//! The drives' own watchdogs: what they do, and how soon, when the master falls silent in part or altogether. Times are
//! virtual.

use hil_tests::{Scenario, Session};
use yieldwall::canopen::Frame;
use yieldwall::time::Time;
use yieldwall_drives::cia402;

/// Port of the master on the virtual bus.
const MASTER: usize = 0;
/// SYNC or set-points may stay away for so many cycles.
const LOST_CYCLES: u64 = 5;
/// Heartbeats of the master every 20 ms; the drives are told to wait for two of them.
const HEARTBEAT_WAIT_US: u64 = 40_000;

/// What is lost of what the master sends.
type IsLost = fn(u16) -> bool;

/// From now on what `is_lost` of the master's frames does not arrive. Runs until both drives have left Operation Enabled
/// and have no torque; when each drive had left, and when neither had torque any more, in us since the last such frame
/// that arrived.
fn silence(session: &mut Session, is_lost: IsLost) -> ([u64; 2], u64) {
    let heard = |session: &Session| -> Time {
        let recording = session.recording();
        recording.frames.iter().rev().find(|seen| is_lost(seen.frame.id())).expect("it was sent before").time
    };
    let last = heard(session);
    session.tamper(move |_, from, frame: Frame| (from != MASTER || !is_lost(frame.id())).then_some(frame));
    let (mut left, mut off) = ([None; 2], None);
    for _ in 0..2000 {
        session.run(1);
        let now = session.machine.now().since(last).as_micros() as u64;
        let drives = session.machine.drives();
        for (left, drive) in left.iter_mut().zip(&drives) {
            if drive.state() != cia402::State::OperationEnabled {
                left.get_or_insert(now);
            }
        }
        if left.iter().all(Option::is_some) && drives.iter().all(|drive| drive.torque_n_m() == 0.0) {
            off.get_or_insert(now);
            break;
        }
    }
    let replay = &session.replay;
    (
        left.map(|left| left.unwrap_or_else(|| panic!("a drive goes on; {replay}"))),
        off.unwrap_or_else(|| panic!("torque stays; {replay}")),
    )
}

fn drill(name: &str, is_lost: IsLost, bound_us: u64) {
    for scenario in [Scenario::torque(), Scenario::position()] {
        let mut session = scenario.run(700);
        let (left, off) = silence(&mut session, is_lost);
        let mode = &scenario.rig.rig.name;
        let apart = left[0].abs_diff(left[1]);
        println!(
            "{mode}: {name} lost: left operation after {left:?} us, {apart} us apart, without torque after {off} us"
        );
        assert!(left.iter().all(|left| *left <= bound_us), "{mode}: {name}: {left:?} us; {}", session.replay);
        // The quick stop ramp of an arm at hand speed takes no longer than this.
        assert!(off <= bound_us + 300_000, "{mode}: {name}: {off} us; {}", session.replay);
        // When the master is heard again, nothing starts by itself.
        session.tamper(|_, _, frame: Frame| Some(frame));
        session.run(300);
        for drive in session.machine.drives() {
            assert_ne!(drive.state(), cia402::State::OperationEnabled, "{}", session.replay);
        }
    }
}

// The resolution of these times is one cycle of 1 ms: the drives are looked at once a cycle.

#[test]
fn without_sync_the_drives_stop() {
    drill("SYNC", |id| id == 0x080, (LOST_CYCLES + 2) * 1000);
}

#[test]
fn without_set_points_the_drives_stop() {
    drill("set-points", |id| id == 0x201 || id == 0x202, (LOST_CYCLES + 2) * 1000);
}

#[test]
fn without_heartbeat_the_drives_stop() {
    drill("heartbeat", |id| id == 0x77f, HEARTBEAT_WAIT_US + 2000);
}

#[test]
fn a_master_that_is_killed_stops_the_drives() {
    drill("everything", |_| true, (LOST_CYCLES + 2) * 1000);
}
