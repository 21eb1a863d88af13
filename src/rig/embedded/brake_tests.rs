//! Brakes that the master holds by an output of the drives, on the embedded simulation.

use std::sync::{Arc, Mutex};

use super::*;
use yieldwall_config::injection::{Kind, Target};
use yieldwall_drives::profiles::{BitState, Brake, BrakeHolder, BrakeOutput, Entry, Quantity, Role};
use yieldwall_link::Packet;

const CLOSES_IN_MS: u32 = 30;

/// The shipped rig in torque mode, with such brakes.
fn braked(file: &str, closed_if: BitState) -> (config::Rig, config::Scene) {
    let loaded = config::load_rig(config::builtin(file)).unwrap();
    let scene = loaded.scene().unwrap().value;
    let mut rig = loaded.value;
    let entry = |sub| Entry { index: 0x60fe, sub, bits: 32, source: "here".to_owned() };
    for drive in &mut rig.drives {
        let mut profile = (**drive.profile.get().unwrap()).clone();
        let Role::Servo(servo) = &mut profile.device else { unreachable!() };
        let output = BrakeOutput { value: entry(1), mask: entry(2), bit: 3, closed_if, closes_in_ms: CLOSES_IN_MS };
        servo.brake = Brake { held_by: BrakeHolder::Output, output: Some(output) };
        servo.process_data.torque.as_mut().unwrap().rpdo[0].maps.push(Quantity::DigitalOutputs);
        drive.profile.set(profile, None);
    }
    (rig, scene)
}

/// Observations of one drive on CAN with each of its RPDOs: controlword, whether its brake is released, and its last statusword.
type Seen = Arc<Mutex<Vec<(u16, bool, u16)>>>;

fn watch(machine: &mut EmbeddedRig, closed_if: BitState) -> Seen {
    let seen = Seen::default();
    let (told, mut status) = (Arc::clone(&seen), 0);
    machine.set_tap(Box::new(move |_, packet| {
        let Packet::Can(frame) = packet else { return };
        match (frame.id(), frame.data()) {
            (0x181, [low, high, ..]) => status = u16::from_le_bytes([*low, *high]),
            (0x201, [low, high, _, _, outputs, ..]) => {
                let is_released = (outputs & 1 << 3 != 0) != (closed_if == BitState::Set);
                told.lock().unwrap().push((u16::from_le_bytes([*low, *high]), is_released, status));
            }
            _ => {}
        }
    }));
    seen
}

#[test]
fn a_brake_is_released_in_operation_enabled_alone_and_closed_before_torque_goes() {
    for closed_if in [BitState::Set, BitState::Cleared] {
        let (rig, scene) = braked("paper-admittance.yaml", closed_if);
        let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).unwrap();
        let seen = watch(&mut machine, closed_if);
        machine.enable().unwrap();
        let from = machine.run_cycle(Request::None).unwrap().tool_m;
        let mut farthest = 0.0_f64;
        for _ in 0..1500 {
            let row = machine.run_cycle(Request::None).unwrap();
            farthest = farthest.max((row.tool_m[0] - from[0]).abs() + (row.tool_m[1] - from[1]).abs());
        }
        assert!(farthest > 0.01, "{closed_if:?}: the hand does not move it");
        assert!(!machine.drives()[0].is_braked());
        machine.stop().unwrap();
        assert!(machine.drives().iter().all(|drive| drive.is_braked()));
        let seen = seen.lock().unwrap();
        assert!(seen.iter().any(|(_, is_released, _)| *is_released));
        for (at, (word, is_released, status)) in seen.iter().enumerate() {
            let is_enabled = status & 0x6f == 0x27;
            assert!(!is_released || (is_enabled && *word == 0x0f), "{closed_if:?} {at}: {word:04x} {status:04x}");
        }
        // From the last frame that releases it to the first that takes the drive out of Operation Enabled.
        let last = seen.iter().rposition(|(_, is_released, _)| *is_released).unwrap();
        let stays = seen[last + 1..].iter().take_while(|(word, ..)| *word == 0x0f).count();
        assert!((CLOSES_IN_MS as usize..=CLOSES_IN_MS as usize + 2).contains(&stays), "{closed_if:?}: {stays} ms");
    }
}

#[test]
fn a_fault_closes_the_brakes_of_both_joints_with_the_quick_stop() {
    for file in ["paper-admittance.yaml", "paper-ethercat.yaml"] {
        let (rig, scene) = braked(file, BitState::Set);
        let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).unwrap();
        machine.inject(Injection::new(Kind::DriveFault, 0.5).on(Target::RightDrive)).unwrap();
        let seen = watch(&mut machine, BitState::Set);
        machine.enable().unwrap();
        for _ in 0..700 {
            machine.run_cycle(Request::None).unwrap();
        }
        assert!(machine.state().is_latched(), "{file}");
        let before = machine.run_cycle(Request::None).unwrap().tool_m;
        for _ in 0..500 {
            machine.run_cycle(Request::None).unwrap();
        }
        // The hand pulls on, and the joints are held.
        let after = machine.run_cycle(Request::None).unwrap().tool_m;
        assert!((0..2).all(|axis| (after[axis] - before[axis]).abs() < 1e-4), "{file}: {before:?} {after:?}");
        if file == "paper-admittance.yaml" {
            let seen = seen.lock().unwrap();
            let stopped = seen.iter().position(|(word, is_released, _)| *word != 0x0f && !is_released);
            let last = seen.iter().rposition(|(_, is_released, _)| *is_released).unwrap();
            assert!(stopped.is_some() && seen[last + 1].0 != 0x0f, "{:?}", seen[last + 1]);
        }
    }
}
