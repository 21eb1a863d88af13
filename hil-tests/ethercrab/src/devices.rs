//! Two servo drives, each with a joint to turn, and a six-axis force sensor on the simulated segment.

use std::time::Duration;

use yieldwall::config::shipped_profile;
use yieldwall::objects::ServedDevice;
use yieldwall::sim::ethercat::{Controller, ControllerSettings, Segment, SimulatedDevice, sii};
use yieldwall::sim::{AxisSettings, Encoder, EthercatDrive, ForceTorqueSensor, ForceTorqueSettings, PositionLoop};
use yieldwall::time::Time;
use yieldwall_drives::scaling::{AxisScaling, Direction};

/// Inertia and viscous friction of a joint.
const INERTIA_KG_M2: f64 = 0.3;
const FRICTION_N_M_S_PER_RAD: f64 = 1.0;

/// A joint and its motion.
#[derive(Clone, Copy, Default)]
struct Joint {
    angle_rad: f64,
    rate_rad_per_s: f64,
}

impl Joint {
    /// Turns it by the torque of its drive, and shows the drive where it is.
    fn turn(&mut self, time: Duration, drive: &mut EthercatDrive) {
        let seconds = time.as_secs_f64();
        let torque_n_m = drive.torque_n_m() - FRICTION_N_M_S_PER_RAD * self.rate_rad_per_s;
        let before = self.rate_rad_per_s;
        self.rate_rad_per_s += torque_n_m / INERTIA_KG_M2 * seconds;
        self.angle_rad += (before + self.rate_rad_per_s) / 2.0 * seconds;
        drive.measure(self.angle_rad, self.rate_rad_per_s);
    }
}

/// The segment, and what its drives turn.
pub struct Devices {
    segment: Segment<SimulatedDevice>,
    joints: [Joint; 2],
    now: Time,
}

impl Devices {
    /// Two drives whose clocks differ, and a sensor that takes its time for a mailbox, all switched on at `now`.
    pub fn new(now: Time) -> Self {
        let sensor = ForceTorqueSensor::new(&ForceTorqueSettings::new(3)).expect("good settings");
        let sensor = on_segment(SimulatedDevice::ForceTorque(Box::new(sensor)), |settings| {
            settings.mailbox_time = Duration::from_micros(200);
        });
        let segment = Segment::new(now, [servo(1, 20_000), servo(2, -35_000), sensor]);
        Self { segment, joints: [Joint::default(); 2], now }
    }

    /// When to poll next.
    pub fn next_deadline(&self) -> Time {
        self.segment.next_deadline()
    }

    /// Does what is due, each thing at its moment.
    pub fn poll(&mut self, now: Time) {
        while self.next_deadline() <= now {
            let next = self.next_deadline();
            self.turn(next);
            self.segment.poll(next);
        }
    }

    /// Sends a frame through the segment: changes it in place, and says when it is back.
    pub fn process(&mut self, now: Time, frame: &mut [u8]) -> Option<Time> {
        self.poll(now);
        self.turn(now);
        self.segment.process(now, frame)
    }

    fn turn(&mut self, now: Time) {
        let time = now.since(self.now);
        self.now = self.now.max(now);
        let drives = self.segment.controllers_mut().filter_map(|controller| controller.device_mut().drive_mut());
        for (joint, drive) in self.joints.iter_mut().zip(drives) {
            joint.turn(time, drive);
        }
    }
}

fn on_segment(device: SimulatedDevice, set: impl FnOnce(&mut ControllerSettings)) -> Controller<SimulatedDevice> {
    let mut settings = ControllerSettings::new(sii(device.od()).write());
    set(&mut settings);
    Controller::new(device, settings)
}

fn servo(serial: u32, drift_ppb: i32) -> Controller<SimulatedDevice> {
    let axis = AxisSettings {
        scaling: AxisScaling::new(800_000.0, Direction::Same, 0.0, 60.0).expect("a good scaling"),
        position_loop: PositionLoop {
            period_us: 125,
            stiffness_n_m_per_rad: 6000.0,
            damping_n_m_s_per_rad: 70.0,
            integral_n_m_per_rad_s: 100_000.0,
        },
        encoder: Encoder::Quantised,
    };
    let drive = EthercatDrive::new(&shipped_profile("simulated-servo"), serial, &axis).expect("good settings");
    on_segment(SimulatedDevice::Drive(Box::new(drive)), |settings| {
        settings.drift_ppb = drift_ppb;
        settings.clock_start_ns = i64::from(serial) * 1_234_567_891;
    })
}
