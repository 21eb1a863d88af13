//! The simulated devices, fed frames and motion.

use std::sync::LazyLock;

use yieldwall::canopen::{Frame, cob, node_id};
use yieldwall::config::shipped_profile;
use yieldwall::sim::{
    Drive, DriveQuirks, DriveSettings, Encoder, ForceSensor, ForceSensorSettings, PositionLoop, Speaks,
};
use yieldwall::time::Time;
use yieldwall_drives::cia402::State;
use yieldwall_drives::scaling::{AxisScaling, Direction};

use super::bytes::{Bytes, Script};
use super::laws::{assert_is_of_device, live};

/// Most frames in answer to one, or of one poll: those of the node, an emergency and a reset of emergencies, and the
/// TPDOs once more when the statusword has changed.
const MOST_FRAMES: usize = 14 + 2 + 4;

/// Node id of the devices.
const NODE: u8 = 1;

static SCALING: LazyLock<AxisScaling> =
    LazyLock::new(|| AxisScaling::new(800_000.0, Direction::Reversed, 0.25, 60.0).expect("a good scaling"));

fn new_drive(encoder: Encoder) -> Drive {
    Drive::new(DriveSettings {
        node: node_id(NODE).expect("a node id"),
        profile: shipped_profile("simulated-servo"),
        serial: 1,
        scaling: *SCALING,
        position_loop: PositionLoop {
            period_us: 125,
            stiffness_n_m_per_rad: 6000.0,
            damping_n_m_s_per_rad: 70.0,
            integral_n_m_per_rad_s: 100_000.0,
        },
        encoder,
        manner: DriveQuirks::default(),
    })
    .expect("a good drive")
}

/// A drive that anything is said and done to: its torque is finite and within its limits, and there is none unless its
/// state machine has one; it is enabled only from where the standard lets it.
///
/// # Panics
/// If a law is broken.
pub fn drive(bytes: &[u8]) {
    play(bytes);
}

/// The largest torque in N m.
fn play(bytes: &[u8]) -> f64 {
    let mut bytes = Bytes::new(bytes);
    let mut drive = new_drive(if bytes.bool() { Encoder::Exact } else { Encoder::Quantised });
    let node = node_id(NODE).expect("a node id");
    let (most_n_m, mut largest_n_m) = (SCALING.torque_n_m(i16::MAX).abs(), 0.0f64);
    let (mut now, mut out, mut is_powered) = (Time::default(), Vec::new(), true);
    drive.boot(now, &mut out);
    drive.on_frame(now, &Frame::new(cob::NMT, &[1, 0]), &mut out);
    while !bytes.is_empty() {
        out.clear();
        let before = drive.state();
        match bytes.u8() % 16 {
            0..8 => {
                drive.on_frame(
                    now,
                    &bytes.frame(&[0x201, 0x201, 0x080, 0x080, 0x601, 0x601, 0x000, 0x77f, 0x301]),
                    &mut out,
                );
                assert!(out.len() <= MOST_FRAMES);
            }
            8..12 => {
                now = now + bytes.wait();
                let out = &mut out;
                live(&mut drive, now, Drive::next_deadline, |drive, now| {
                    let sent = out.len();
                    drive.poll(now, out);
                    assert!(out.len() - sent <= MOST_FRAMES);
                });
            }
            12 => drive.measure(bytes.f64(), bytes.f64()),
            13 => drive.raise_fault(now, bytes.u16(), &mut out),
            14 => match bytes.u8() {
                0..8 => {
                    drive.switch_off();
                    is_powered = false;
                }
                8..32 => {
                    drive.boot(now, &mut out);
                    is_powered = true;
                }
                warning => drive.set_warning(warning & 1 != 0),
            },
            _ => drive.set_voltage(now, bytes.u8() >= 32, &mut out),
        }
        out.iter().for_each(|frame| assert_is_of_device(node, frame));
        assert!(is_powered || out.is_empty(), "a drive that is off sends {out:x?}");
        let (torque, state) = (drive.torque_n_m(), drive.state());
        assert!(torque.is_finite() && torque.abs() <= most_n_m, "{torque} N m");
        largest_n_m = largest_n_m.max(torque.abs());
        let may_push = matches!(state, State::OperationEnabled | State::QuickStopActive | State::FaultReactionActive);
        assert!(torque == 0.0 || (may_push && is_powered), "{torque} N m in {state:?}");
        if state == State::OperationEnabled {
            let is_legal = matches!(
                before,
                State::OperationEnabled | State::ReadyToSwitchOn | State::SwitchedOn | State::QuickStopActive
            );
            assert!(is_legal, "enabled from {before:?}");
        }
    }
    largest_n_m
}

pub(super) fn drives() -> Vec<Vec<u8>> {
    let frame = |script: Script, id: u16, data: &[u8]| script.raw(&[0]).frame(id, data);
    // Modes 8, 9 and 10 with their targets 607Ah, 60FFh and 6071h.
    let walk = |mode: u8, target: [u8; 8]| {
        let mut script = Script::new().raw(&[0]).raw(&[12]).number(0.5).number(0.0);
        script = frame(script, 0x601, &[0x2f, 0x60, 0x60, 0, mode, 0, 0, 0]);
        for word in [0x06, 0x07, 0x0f] {
            script = frame(script, 0x201, &[word, 0]);
        }
        for _ in 0..5 {
            script = frame(frame(script, 0x601, &target), 0x080, &[]).raw(&[8]).wait_us(1000);
        }
        frame(script, 0x201, &[0x02, 0]).raw(&[8]).wait_us(1_000_000)
    };
    let position = walk(8, [0x23, 0x7a, 0x60, 0, 0x10, 0x86, 0xff, 0xff]).finish();
    let velocity = walk(9, [0x23, 0xff, 0x60, 0, 0x10, 0x27, 0, 0]).raw(&[13, 0x10, 0x42]).finish();
    let torque = frame(walk(10, [0x2b, 0x71, 0x60, 0, 100, 0, 0, 0]), 0x201, &[0x80, 0]);
    vec![position, velocity, torque.raw(&[15, 0, 15, 255, 14, 40, 14, 0, 14, 8]).finish()]
}

/// A force sensor that anything is said and done to.
///
/// # Panics
/// If a law is broken.
pub fn force_sensor(bytes: &[u8]) {
    let mut bytes = Bytes::new(bytes);
    let node = node_id(NODE).expect("a node id");
    let settings = ForceSensorSettings {
        speaks: Speaks::Canopen {
            node,
            profile: shipped_profile("simulated-force-sensor"),
            serial: 1,
            counts_per_unit: [1; 2],
        },
        sample_rate_hz: bytes.pick(&[200, 500, 1000]),
        phase_us: u32::from(bytes.u16() % 1000),
        range_counts: i32::from(bytes.u16() as i16),
    };
    let range_counts = settings.range_counts;
    let Ok(mut sensor) = ForceSensor::new(settings) else {
        return assert!(range_counts < 1, "{range_counts}");
    };
    let (mut now, mut out, mut is_powered) = (Time::default(), Vec::new(), true);
    sensor.boot(now, &mut out);
    sensor.on_frame(now, &Frame::new(cob::NMT, &[1, 0]), &mut out);
    while !bytes.is_empty() {
        out.clear();
        match bytes.u8() % 8 {
            0..4 => {
                sensor.on_frame(now, &bytes.frame(&[0x080, 0x080, 0x601, 0x601, 0x000, 0x77f]), &mut out);
                assert!(out.len() <= MOST_FRAMES);
            }
            4..6 => {
                now = now + bytes.wait();
                let out = &mut out;
                live(&mut sensor, now, ForceSensor::next_deadline, |sensor, now| sensor.poll(now, out));
            }
            6 => sensor.measure([0; 6].map(|_| bytes.u32() as i32)),
            _ => match bytes.u8() {
                0..32 => {
                    sensor.switch_off();
                    is_powered = false;
                }
                _ => {
                    sensor.boot(now, &mut out);
                    is_powered = true;
                }
            },
        }
        out.iter().for_each(|frame| assert_is_of_device(node, frame));
        assert!(is_powered || out.is_empty(), "a sensor that is off sends {out:x?}");
    }
}

pub(super) fn force_sensors() -> Vec<Vec<u8>> {
    let mut script = Script::new().raw(&[2, 0, 0, 0, 0x7d]);
    // The TPDOs on, a zero, samples at and beyond the range.
    for payload in [
        [0x23, 0x00, 0x18, 1, 0x81, 1, 0, 0],
        [0x23, 0x01, 0x18, 1, 0x81, 2, 0, 0],
        [0x23, 0x25, 0x61, 1, 0x7a, 0x65, 0x72, 0x6f],
    ] {
        script = script.raw(&[0]).frame(0x601, &payload);
    }
    for counts in [[1, 0, 0, 0], [0, 0, 0, 0x80], [0xff; 4]] {
        script = script.raw(&[6]).raw(&counts.repeat(6)).raw(&[0]).frame(0x080, &[]).raw(&[4]).wait_us(1000);
    }
    vec![script.finish()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_drive_comes_to_push() {
        for seed in drives() {
            assert!(play(&seed) > 1.0, "{seed:?}");
        }
    }
}
