//! Torque (6077h) that a drive reports while its joint is guided, asked for over SDO beside the cycles, in every command mode.

use crate::assembly::{AssemblyError, scaling};
use crate::error::RunError;
use crate::permit::Ask;
use crate::place::Place;
use crate::runner::Runner;
use yieldwall_config as config;
use yieldwall_drives::objects::TORQUE_ACTUAL;
use yieldwall_drives::scaling::AxisScaling;
use yieldwall_fieldbus::objects::{Address, ObjectAnswer, ObjectRequest};
use yieldwall_motion::guard::Device;

/// Cycles for which the last answer is waited at most.
const LAST_CYCLES: u32 = 1000;

/// Outcome of a request.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Metered {
    /// Nothing yet.
    Pending,
    /// Nothing was asked, or the answer holds no torque.
    Nothing,
    /// The torque, N m.
    Torque(f64),
}

/// Asks one drive again and again.
pub(super) struct TorqueMeter {
    drive: Device,
    scaling: AxisScaling,
    is_pending: bool,
    /// Angle or time of the request, if it matters.
    asked_at: Option<f64>,
    /// Angle or time of the request, and torque in N m.
    samples: Vec<[f64; 2]>,
}

impl TorqueMeter {
    /// Creates a meter at the drive of a joint, for at most this number of samples.
    pub(super) fn new(rig: &config::Rig, joint: usize, most: u32) -> Result<Self, RunError> {
        let drive = rig.drives.get(joint).zip(Device::DRIVES.get(joint).copied());
        let (drive, device) = drive.ok_or(AssemblyError::NoJoint(joint))?;
        let scaling = scaling(drive)?;
        let samples = Vec::with_capacity(most as usize);
        Ok(Self { drive: device, scaling, is_pending: false, asked_at: None, samples })
    }

    /// Takes an answer that has come, and asks again. `at` is where the joint is, or when it is asked, if that counts.
    ///
    /// Real-time: yes.
    pub(super) fn step(&mut self, runner: &mut Runner<dyn Place>, at: Option<f64>) -> Metered {
        let answer = self.take(runner);
        if answer != Metered::Pending {
            self.ask(runner, at);
        }
        answer
    }

    /// Takes an answer that has come.
    ///
    /// Real-time: yes.
    pub(super) fn take(&mut self, runner: &Runner<dyn Place>) -> Metered {
        if !self.is_pending {
            return Metered::Nothing;
        }
        let answer = match runner.master().networks().answer(self.drive) {
            ObjectAnswer::Pending => return Metered::Pending,
            ObjectAnswer::Done(&[low, high, ..]) => {
                let torque_n_m = self.torque_n_m(i16::from_le_bytes([low, high]));
                if let Some(at) = self.asked_at.filter(|_| self.samples.len() < self.samples.capacity()) {
                    self.samples.push([at, torque_n_m]);
                }
                Metered::Torque(torque_n_m)
            }
            ObjectAnswer::Done(_) | ObjectAnswer::NotAsked | ObjectAnswer::Failed(_) => Metered::Nothing,
        };
        self.is_pending = false;
        answer
    }

    /// Asks the drive. `at` is the angle or the time of the request, if it matters.
    ///
    /// Real-time: yes.
    pub(super) fn ask(&mut self, runner: &mut Runner<dyn Place>, at: Option<f64>) {
        self.asked_at = at;
        let request = ObjectRequest::Read(Address::new(TORQUE_ACTUAL.index, TORQUE_ACTUAL.sub));
        self.is_pending =
            runner.send(|master, now, out| master.networks_mut().ask(now, self.drive, request, out)).is_ok();
    }

    /// Parts of a thousand of the drive's rated torque, N m.
    pub(super) fn torque_n_m(&self, per_mille: i16) -> f64 {
        self.scaling.torque_n_m(per_mille)
    }

    /// Waits for what was asked last, so that the drive can be asked for something else.
    pub(super) fn finish(&mut self, runner: &mut Runner<dyn Place>) {
        for _ in 0..LAST_CYCLES {
            if !matches!(runner.master().networks().answer(self.drive), ObjectAnswer::Pending) {
                break;
            }
            runner.run_cycle(Ask::Nothing);
        }
    }

    /// Returns the samples.
    pub(super) fn into_samples(self) -> Vec<[f64; 2]> {
        self.samples
    }
}
