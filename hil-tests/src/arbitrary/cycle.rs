//! The real-time step alone, with any inputs.

use std::sync::LazyLock;

use yieldwall::config::{self, builtin};
use yieldwall::cycle::{Cycle, DriveSample, Inputs, LinkEvents, Outputs, Timing};
use yieldwall::guard::{DeviceSet, Request};
use yieldwall::quantity::TipPoint;
use yieldwall::sensing::RawSample;
use yieldwall_drives::cia402::{Goal, State};

use super::bytes::{Bytes, Script};
use super::laws::Witness;
use super::sensing::sample;

/// Most cycles of one input, so that its length does not decide how long it takes.
const MOST_CYCLES: usize = 2000;

/// One rig per command mode.
const FILES: [&str; 4] = [
    "paper-admittance.yaml",
    "paper-admittance-csp.yaml",
    "paper-admittance-csv.yaml",
    "paper-admittance-cartesian.yaml",
];

/// A rig at rest, the angles of its home in rad, and its torque limit in N m.
struct Start {
    cycle: Cycle,
    home: [f64; 2],
    torque_limit_n_m: f64,
}

static STARTS: LazyLock<[Start; 4]> = LazyLock::new(|| {
    FILES.map(|file| {
        let rig = config::load_rig(builtin(file)).expect("a shipped rig").value;
        let cycle = yieldwall::assembly::cycle(&rig, &rig.fixture).expect("a rig that can be built");
        let home = cycle.linkage().inverse(TipPoint::new(0.02, 0.0)).expect("a point in reach").to_array();
        Start { cycle, home, torque_limit_n_m: rig.guard.torque_limit_n_m.get() }
    })
});

/// What surrounds the cycle when nothing is wrong: drives that obey, joints that follow, a sensor that counts.
struct World {
    drives: [State; 2],
    angles: [f64; 2],
    counts: [i32; 6],
    sequence: u8,
}

impl World {
    fn inputs(&mut self, request: Request) -> Inputs {
        self.sequence = self.sequence.wrapping_add(1);
        let drive = |joint: usize| DriveSample {
            angle_rad: Some(self.angles[joint]),
            state: self.drives[joint],
            follows_command: true,
            has_voltage: true,
            has_warning: false,
        };
        let sample = RawSample { counts: self.counts, sequence: Some(self.sequence), ..RawSample::default() };
        let (link, timing) = (LinkEvents::default(), Timing::default());
        Inputs { drives: [drive(0), drive(1)], sample: Some(sample), link, timing, request }
    }

    fn follow(&mut self, outputs: &Outputs) {
        self.angles = outputs.signals.target_angles.to_array();
        for drive in &mut self.drives {
            *drive = match (outputs.directive.goal, *drive) {
                (_, State::Fault) if outputs.directive.fault_reset => State::SwitchOnDisabled,
                (_, State::Fault) => State::Fault,
                (Goal::OperationEnabled, _) => State::OperationEnabled,
                (Goal::QuickStop, _) => State::QuickStopActive,
                (Goal::SwitchedOn, _) => State::SwitchedOn,
                (Goal::ReadyToSwitchOn, _) => State::ReadyToSwitchOn,
                (Goal::SwitchOnDisabled, _) => State::SwitchOnDisabled,
            };
        }
    }
}

/// Spoils one thing about the inputs.
fn spoil(bytes: &mut Bytes<'_>, inputs: &mut Inputs) {
    let joint = usize::from(bytes.u8() % 2);
    let drive = &mut inputs.drives[joint];
    match bytes.u8() % 9 {
        0 => drive.angle_rad = None,
        1 => drive.angle_rad = Some(bytes.f64()),
        2 => drive.angle_rad = drive.angle_rad.map(|angle| angle + bytes.f64()),
        3 => drive.state = bytes.pick(&State::ALL),
        4 => drive.follows_command = false,
        5 => inputs.sample = None,
        6 => inputs.sample = Some(sample(bytes)),
        7 => inputs.link = link(bytes),
        _ => {
            inputs.timing = timing(bytes);
        }
    }
}

/// A cycle that runs at any time.
pub(super) fn timing(bytes: &mut Bytes<'_>) -> Timing {
    Timing {
        sync_late_ns: bytes.u32(),
        compute_late_ns: bytes.u32(),
        last_compute_ns: bytes.u32(),
        skipped: bytes.pick(&[0, 0, 1, u32::MAX]),
        suspended: bytes.u8() == 1,
    }
}

/// Any events on the bus, most of them not there.
fn link(bytes: &mut Bytes<'_>) -> LinkEvents {
    let bits = bytes.u16();
    let devices = DeviceSet::from_bits(bytes.u8().into());
    let at = |bit: u32| devices.only_if(bits >> bit & 1 != 0);
    let is = |bit: u32| bits >> bit & 1 != 0;
    LinkEvents {
        bad_length: at(0),
        duplicated: at(1),
        late: at(2),
        node_reset: at(3),
        heartbeat_lost: at(4),
        duplicate_node: at(5),
        emergency: at(6),
        emergency_warning: at(7),
        intruder: is(8),
        transmit_stalled: DeviceSet::interface(0).only_if(is(9)),
        error_passive: DeviceSet::interface(1).only_if(is(10)),
        bus_off: DeviceSet::interface(2).only_if(is(11)),
        send_failed: DeviceSet::interface(3).only_if(is(12)),
        outputs_missed: at(13) & DeviceSet::DRIVES,
        device_state: at(14),
        clock_lost: at(15),
        port_errors: at(15) & DeviceSet::DRIVES,
    }
}

/// Cycles with any inputs: outputs are finite and within their limits, nothing moves unless every drive is enabled, and
/// only a person enables and resets.
///
/// # Panics
/// If a law is broken.
pub fn cycle(bytes: &[u8]) {
    play(bytes);
}

/// Which states the rig was in, by their number.
fn play(bytes: &[u8]) -> [bool; 8] {
    let mut bytes = Bytes::new(bytes);
    let start = &STARTS[usize::from(bytes.u8()) % STARTS.len()];
    let mut cycle = start.cycle.clone();
    let mut world = World { drives: [State::SwitchOnDisabled; 2], angles: start.home, counts: [0; 6], sequence: 0 };
    let (mut witness, mut visited) = (Witness::default(), [false; 8]);
    let mut step = |world: &mut World, inputs: &Inputs| {
        let outputs = cycle.step(inputs);
        let are_enabled = inputs.drives.iter().all(|drive| drive.state == State::OperationEnabled);
        witness.look(are_enabled, inputs.request, start.torque_limit_n_m, &outputs);
        assert_eq!(outputs.directive.state, cycle.state());
        visited[cycle.state() as usize] = true;
        world.follow(&outputs);
    };
    let mut cycles = 0;
    while !bytes.is_empty() && cycles < MOST_CYCLES {
        let (count, mut inputs) = match bytes.u8() {
            // A person asks.
            0..16 => (1, world.inputs(bytes.pick(&[Request::Enable, Request::Stop, Request::Reset]))),
            // The hand pushes.
            16..32 => {
                world.counts = [0; 6].map(|_| i32::from(bytes.u16() as i16));
                (1, world.inputs(Request::None))
            }
            count @ 32..96 => (usize::from(count - 32), world.inputs(Request::None)),
            // One or more things are wrong.
            many => {
                let mut inputs = world.inputs(Request::None);
                for _ in 0..=many % 4 {
                    spoil(&mut bytes, &mut inputs);
                }
                (1, inputs)
            }
        };
        for _ in 0..count {
            step(&mut world, &inputs);
            inputs = world.inputs(Request::None);
            cycles += 1;
        }
    }
    visited
}

pub(super) fn runs() -> Vec<Vec<u8>> {
    (0..FILES.len() as u8)
        .map(|mode| {
            // Ten cycles of rest, enable, a push, a lost angle, more of it, a stop, a reset and once more.
            let push = |script: Script, count: i16| script.raw(&[16]).raw(&count.to_le_bytes().repeat(6));
            let script = push(Script::new().raw(&[mode, 42, 0, 0, 60]), 300).raw(&[90, 100, 0, 0, 60]);
            push(script, -900).raw(&[95, 0, 1, 90, 0, 2, 40, 0, 0, 60]).finish()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use yieldwall::guard::State;

    use super::*;

    #[test]
    fn runs_lead_through_the_states() {
        for seed in runs() {
            let visited = play(&seed);
            for state in [State::Idle, State::Enabling, State::Running, State::Stopping, State::Stopped] {
                assert!(visited[state as usize], "{state:?} in {seed:?}");
            }
        }
    }
}
