//! A stretch of a run, recorded so that its parts can be run again alone.

use std::sync::{Arc, Mutex};

use yieldwall::bus::Master;
use yieldwall::canopen::Frame;
use yieldwall::cycle::{Cycle, Inputs, Outputs};
use yieldwall::guard::Request;
use yieldwall::rig::RigError;
use yieldwall::sim::arm::Arm;
use yieldwall::sim::hand::Hand;
use yieldwall::sim::{Drive, ForceSensor};
use yieldwall::time::Time;

use crate::machine::Machine;

/// One period as the parts saw it.
#[derive(Clone, Debug)]
pub struct Period {
    /// When SYNC was queued.
    pub sync_at: Time,
    /// When the cycle ran.
    pub compute_at: Time,
    /// Frames on the bus in this period, with the moments at which they arrived.
    pub frames: Vec<(Time, Frame)>,
    /// What entered the cycle.
    pub inputs: Inputs,
    /// What left it.
    pub outputs: Outputs,
    /// Torques of the drives at the end of the period, in N m.
    pub torques_n_m: [f64; 2],
}

/// The parts as they were before the first period, and the periods.
pub struct Tape {
    /// The machine.
    pub machine: Machine,
    /// The master with its cycle.
    pub master: Master,
    /// The drives.
    pub drives: [Drive; 2],
    /// The force sensor.
    pub sensor: ForceSensor,
    /// The arm.
    pub arm: Arm,
    /// The hand.
    pub hand: Hand<2>,
    /// When the hand took the handle, in s of virtual time: its own time starts there.
    pub hand_from_s: f64,
    /// The periods in order.
    pub periods: Vec<Period>,
}

impl Tape {
    /// Records `count` periods from `skip` periods after the start of the scene.
    ///
    /// # Errors
    /// As the rig.
    ///
    /// # Panics
    /// If the rig has no arm, or if a cycle run again does not give what it gave in the rig.
    pub fn record(machine: Machine, skip: usize, count: usize) -> Result<Self, RigError> {
        let mut rig = machine.enabled()?;
        let frames = Arc::new(Mutex::new(Vec::new()));
        let tapped = Arc::clone(&frames);
        rig.set_tap(Box::new(move |time, packet| {
            tapped.lock().expect("one thread").extend(packet.can().map(|frame| (time, *frame)));
        }));
        let mut hand_from_s = 0.0;
        for _ in 0..skip {
            let sync_at = rig.next_sync();
            hand_from_s = sync_at.as_secs_f64() - rig.run_cycle(Request::None)?.time_s;
        }
        frames.lock().expect("one thread").clear();
        let mut tape = Self {
            master: rig.master().clone(),
            drives: std::array::from_fn(|drive| rig.drives()[drive].clone()),
            sensor: rig.force_sensor().expect("a sensor on CAN").clone(),
            arm: rig.arm().expect("a rig with an arm").clone(),
            hand: rig.hand().clone(),
            hand_from_s,
            periods: Vec::with_capacity(count),
            machine,
        };
        for _ in 0..count {
            let sync_at = rig.next_sync();
            rig.run_cycle(Request::None)?;
            let outputs = *rig.last_outputs().expect("a cycle has run");
            let frames = std::mem::take(&mut *frames.lock().expect("one thread"));
            tape.periods.push(Period {
                sync_at,
                compute_at: rig.now(),
                inputs: *rig.master().last_inputs(),
                frames,
                outputs,
                torques_n_m: rig.drive_torques_n_m(),
            });
        }
        tape.check();
        Ok(tape)
    }

    /// The cycle before the first period.
    pub fn cycle(&self) -> &Cycle {
        self.master.cycle()
    }

    fn check(&self) {
        let mut cycle = self.cycle().clone();
        for period in &self.periods {
            assert_eq!(cycle.step(&period.inputs), period.outputs, "period at {} s", period.sync_at.as_secs_f64());
        }
    }
}
