//! Watch for drives that home, push and do not move their joints. A blocked joint looks so, and so does a frozen encoder. The
//! position alone distinguishes neither from a drive at rest.

use super::NotHome;
use crate::bringup::push::{Push, Stand};
use crate::bringup::torque_meter::{Metered, TorqueMeter};
use crate::error::RunError;
use crate::place::Place;
use crate::runner::Runner;
use yieldwall_config as config;
use yieldwall_drives::objects::TORQUE_ACTUAL;
use yieldwall_motion::guard::Device;

/// How long a drive may be silent about its torque, s.
const SILENT_S: f64 = 0.5;

/// Watch of both joints. It asks the two drives for their torque alternately, since a bus may have no room for both.
pub(super) struct PushWatch {
    joints: [Watched; 2],
    /// Joint whose drive is asked.
    turn: usize,
}

struct Watched {
    meter: TorqueMeter,
    /// Time of its last reported torque, s.
    told_s: f64,
    push: Push,
    /// How fast it goes, rad/s.
    rate_rad_per_s: f64,
}

impl PushWatch {
    /// Creates a watch of joints that go at these rates, rad/s. It reads each drive's torque and torque limit.
    pub(super) fn new(
        runner: &mut Runner<dyn Place>,
        rig: &config::Rig,
        rates_rad_per_s: [f64; 2],
    ) -> Result<Self, RunError> {
        let mut of = |joint: usize, device, rate_rad_per_s| -> Result<Watched, RunError> {
            let meter = TorqueMeter::new(rig, joint, 0)?;
            runner.read(device, TORQUE_ACTUAL.index, TORQUE_ACTUAL.sub)?;
            let limit_n_m = runner.torque_limit_n_m(rig, device)?;
            Ok(Watched { meter, told_s: 0.0, push: Push::new(limit_n_m), rate_rad_per_s })
        };
        let [left, right] = rates_rad_per_s;
        Ok(Self { joints: [of(0, Device::LeftDrive, left)?, of(1, Device::RightDrive, right)?], turn: 0 })
    }

    /// Returns why neither joint may go on, `time_s` after the first one began: a joint is blocked, or its torque is unknown.
    /// `rests` marks the joints that are to rest.
    ///
    /// Real-time: yes.
    pub(super) fn step(&mut self, runner: &mut Runner<dyn Place>, time_s: f64, rests: [bool; 2]) -> Option<NotHome> {
        let angles = runner.angles().to_array();
        let (joint, angle_rad) = (self.turn, angles.get(self.turn).copied().unwrap_or_default());
        if let Some(asked) = self.joints.get_mut(joint) {
            let told = asked.meter.take(runner);
            if let Metered::Torque(torque_n_m) = told {
                asked.told_s = time_s;
                let now = Stand { time_s, angle_rad, led_rad: asked.rate_rad_per_s * time_s };
                if asked.push.is_blocked(now, torque_n_m, rests.get(joint) == Some(&true)) {
                    return Some(NotHome::Blocked(joint, torque_n_m));
                }
            }
            if told != Metered::Pending {
                self.turn = 1 - joint;
                self.joints.iter_mut().skip(self.turn).take(1).for_each(|next| next.meter.ask(runner, None));
            }
        }
        let silent = self.joints.iter().position(|joint| time_s - joint.told_s > SILENT_S);
        silent.map(NotHome::Silent)
    }

    /// Waits for what was asked last.
    pub(super) fn finish(&mut self, runner: &mut Runner<dyn Place>) {
        self.joints.iter_mut().for_each(|joint| joint.meter.finish(runner));
    }
}
