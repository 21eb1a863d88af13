//! The torque that a drive tells (6077h) while its joint is led, asked for over SDO beside the cycles, in every command mode.

use super::bench::Halt;
use crate::assembly::scaling;
use crate::config;
use crate::guard::Device;
use crate::objects::{Address, ObjectAnswer, ObjectRequest};
use crate::run::permit::Ask;
use crate::run::place::Place;
use crate::run::runner::Runner;
use yieldwall_drives::objects::TORQUE_ACTUAL;
use yieldwall_drives::scaling::AxisScaling;

/// Cycles for which the last answer is waited at most.
const LAST_CYCLES: u32 = 1000;

/// Asks one drive again and again.
pub(super) struct TorqueMeter {
    drive: Device,
    scaling: AxisScaling,
    is_pending: bool,
    /// The angle at which it was asked, if that counts.
    asked_at_rad: Option<f64>,
    /// Angle in rad and torque in N m.
    samples: Vec<[f64; 2]>,
}

impl TorqueMeter {
    /// A meter at the drive of a joint that takes so many samples at most.
    pub(super) fn new(rig: &config::Rig, joint: usize, most: u32) -> Result<Self, Halt> {
        let drive = rig.drives.get(joint).zip(Device::DRIVES.get(joint).copied());
        let (drive, device) = drive.ok_or_else(|| Halt::Failed("there is no such joint".to_owned()))?;
        let scaling = scaling(drive).map_err(|error| Halt::Failed(error.to_string()))?;
        let samples = Vec::with_capacity(most as usize);
        Ok(Self { drive: device, scaling, is_pending: false, asked_at_rad: None, samples })
    }

    /// Takes an answer that has come, and asks again, where the joint is at an angle that counts.
    ///
    /// Real-time: yes.
    pub(super) fn step<P: Place>(&mut self, runner: &mut Runner<P>, angle_rad: Option<f64>) {
        if self.is_pending {
            match runner.master().answer(self.drive) {
                ObjectAnswer::Pending => return,
                ObjectAnswer::Done(&[low, high, ..]) => {
                    let torque_n_m = self.scaling.torque_n_m(i16::from_le_bytes([low, high]));
                    if let Some(angle) = self.asked_at_rad.filter(|_| self.samples.len() < self.samples.capacity()) {
                        self.samples.push([angle, torque_n_m]);
                    }
                }
                ObjectAnswer::Done(_) | ObjectAnswer::NotAsked | ObjectAnswer::Failed(_) => {}
            }
            self.is_pending = false;
        }
        self.asked_at_rad = angle_rad;
        let request = ObjectRequest::Read(Address::new(TORQUE_ACTUAL.index, TORQUE_ACTUAL.sub));
        self.is_pending = runner.send(|master, now, out| master.ask(now, self.drive, request, out)).is_ok();
    }

    /// Waits for what was asked last, so that the drive can be asked for something else.
    pub(super) fn finish<P: Place>(&mut self, runner: &mut Runner<P>) {
        for _ in 0..LAST_CYCLES {
            if !matches!(runner.master().answer(self.drive), ObjectAnswer::Pending) {
                break;
            }
            runner.run_cycle(Ask::Nothing);
        }
    }

    /// What it has seen.
    pub(super) fn into_samples(self) -> Vec<[f64; 2]> {
        self.samples
    }
}
