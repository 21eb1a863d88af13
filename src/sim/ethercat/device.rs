//! The devices of a rig on a segment.

use super::super::drive::EthercatDrive;
use super::super::force_sensor::ForceTorqueSensor;
use super::application::EthercatApplication;
use yieldwall_fieldbus::ethercat::coe::CoeEmergency;
use yieldwall_fieldbus::objects::{AbortCode, Address, ObjectDictionary, Reset, ServedDevice};
use yieldwall_fieldbus::time::Time;

/// One of the devices that come with the simulation.
#[derive(Clone, Debug)]
pub enum SimulatedDevice {
    /// A servo drive.
    Drive(Box<EthercatDrive>),
    /// A six-axis sensor.
    ForceTorque(Box<ForceTorqueSensor>),
    /// Objects alone.
    Objects(Box<ObjectDictionary>),
}

impl SimulatedDevice {
    fn inner(&self) -> &dyn EthercatApplication {
        match self {
            SimulatedDevice::Drive(device) => &**device,
            SimulatedDevice::ForceTorque(device) => &**device,
            SimulatedDevice::Objects(device) => &**device,
        }
    }

    fn inner_mut(&mut self) -> &mut dyn EthercatApplication {
        match self {
            SimulatedDevice::Drive(device) => &mut **device,
            SimulatedDevice::ForceTorque(device) => &mut **device,
            SimulatedDevice::Objects(device) => &mut **device,
        }
    }

    /// The drive, if it is one.
    pub fn drive(&self) -> Option<&EthercatDrive> {
        match self {
            SimulatedDevice::Drive(drive) => Some(drive),
            _ => None,
        }
    }

    /// The drive, if it is one, to be changed.
    pub fn drive_mut(&mut self) -> Option<&mut EthercatDrive> {
        match self {
            SimulatedDevice::Drive(drive) => Some(drive),
            _ => None,
        }
    }

    /// The sensor, if it is one.
    pub fn force_torque_mut(&mut self) -> Option<&mut ForceTorqueSensor> {
        match self {
            SimulatedDevice::ForceTorque(sensor) => Some(sensor),
            _ => None,
        }
    }
}

impl ServedDevice for SimulatedDevice {
    fn od(&self) -> &ObjectDictionary {
        self.inner().od()
    }

    fn od_mut(&mut self) -> &mut ObjectDictionary {
        self.inner_mut().od_mut()
    }

    fn before_write(&mut self, at: Address, data: &[u8]) -> Result<(), AbortCode> {
        self.inner_mut().before_write(at, data)
    }

    fn after_write(&mut self, at: Address) {
        self.inner_mut().after_write(at);
    }

    fn before_read(&mut self, at: Address) -> Result<(), AbortCode> {
        self.inner_mut().before_read(at)
    }

    fn outputs_applied(&mut self, now: Time, number: u8) {
        self.inner_mut().outputs_applied(now, number);
    }

    fn outputs_late(&mut self, now: Time, number: u8) {
        self.inner_mut().outputs_late(now, number);
    }

    fn sample(&mut self, now: Time) {
        self.inner_mut().sample(now);
    }

    fn reset(&mut self, now: Time, reset: Reset) {
        self.inner_mut().reset(now, reset);
    }
}

impl EthercatApplication for SimulatedDevice {
    fn set_operational(&mut self, now: Time, is_operational: bool) {
        self.inner_mut().set_operational(now, is_operational);
    }

    fn poll(&mut self, now: Time) {
        self.inner_mut().poll(now);
    }

    fn next_deadline(&self) -> Time {
        self.inner().next_deadline()
    }

    fn refresh(&mut self) {
        self.inner_mut().refresh();
    }

    fn sync1_ns(&self) -> Option<u32> {
        self.inner().sync1_ns()
    }

    fn take_emergency(&mut self) -> Option<CoeEmergency> {
        self.inner_mut().take_emergency()
    }
}
