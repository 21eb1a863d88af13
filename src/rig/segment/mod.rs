//! The devices of a rig on an EtherCAT segment, and the arm and the hand between them.

mod faults;

use std::time::Duration;

use super::devices;
use super::error::RigError;
use super::far_end::{DEVICES, SENSOR};
use super::server::{GRACE, LAG};
use super::world::{Body, World};
use crate::config;
use crate::ethercat::frame::{self, Command, Datagrams};
use crate::injection::Injection;
use crate::quantity::JointTorques;
use crate::run::Pace;
use crate::sim::ethercat::{EthercatApplication, Segment, SimulatedDevice};
use crate::time::Time;
use faults::Faults;
use yieldwall_drives::cia402;

/// The simulated drives and the force sensor of a rig on an EtherCAT segment, on one arm with a hand.
///
/// Without I/O, like every engine: frames and moments of the wall come in, and what comes back goes to a closure. Simulated time follows
/// the wall. In lockstep it stands still from the frame that reads process data to the next one that reads the same, which is a period
/// later, and follows the wall in whole periods before the first one, 2 s after the last one, and when a master writes to all devices; the clocks of devices do not drift
/// then. The hand takes the tool when all drives are in Operation Enabled, and lets go of it when none makes torque any more.
#[derive(Debug)]
pub struct SegmentServer {
    segment: Segment<SimulatedDevice>,
    /// Places of the left drive, the right drive and the sensor, where they are here.
    places: [Option<usize>; DEVICES],
    world: World,
    seed: u64,
    /// Of the force sensor, where it is on.
    noise_counts: f64,
    pace: Pace,
    period: Duration,
    /// Simulated time.
    now: Time,
    /// A moment of the wall, and the simulated time that it stands for.
    anchor: (Time, Time),
    /// When process data were read last on the wall, while time waits for the next time.
    waits_since: Option<Time>,
    /// The logical address with whose reading a period begins.
    opener: Option<u32>,
    states: [cia402::State; 2],
    faults: Faults,
    counts: SegmentServed,
}

/// What a segment took part in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SegmentServed {
    /// Frames that came.
    pub frames: u64,
    /// Frames that went back, those that were injected included.
    pub returned: u64,
}

impl SegmentServer {
    /// Devices that are switched on at this moment of the wall, the arm where the scene's hand starts. Of left drive, right drive and
    /// sensor those that are `here` are on the segment; the joint of another drive is without torque. `seed` stands in place of the
    /// scene's.
    ///
    /// # Errors
    /// Where parts of the configuration do not fit together, and for a scene without an arm.
    pub fn new(
        rig: &config::Rig,
        scene: &config::Scene,
        seed: u64,
        pace: Pace,
        here: [bool; DEVICES],
        wall: Time,
    ) -> Result<Self, RigError> {
        let mut world = devices::world(rig, scene, seed)?;
        if matches!(world.body, Body::Ideal(_)) {
            let message =
                "model.tracking ideal works in the embedded simulation only: on a bus the arm has to be rigid";
            return Err(RigError::Mismatch(message.into()));
        }
        let noise_counts = world.noise_counts;
        if pace == Pace::Lockstep {
            world.noise_counts = 0.0;
        }
        let (segment, places) = devices::segment(rig, scene, here, pace)?;
        let mut server = Self {
            segment,
            places,
            world,
            seed,
            noise_counts,
            pace,
            period: Duration::from_micros(rig.cycle.period_us.into()),
            now: Time(0),
            anchor: (wall, Time(0)),
            waits_since: None,
            opener: None,
            states: [cia402::State::NotReadyToSwitchOn; 2],
            faults: Faults::new(seed),
            counts: SegmentServed::default(),
        };
        server.measure(true)?;
        server.take_torques();
        Ok(server)
    }

    /// Has an injection begin at its moment, counted in simulated time from switching on.
    ///
    /// # Errors
    /// If it is not possible on a segment, or its target is not here.
    pub fn inject(&mut self, injection: Injection) -> Result<(), RigError> {
        self.faults.add(injection, self.places)
    }

    /// Has a frame that came at this moment of the wall go through the segment; what comes back at once goes to `back`.
    ///
    /// # Errors
    /// If the simulated arm cannot go on.
    pub fn on_frame(&mut self, wall: Time, bytes: &mut [u8], mut back: impl FnMut(&[u8])) -> Result<(), RigError> {
        if self.waits_since.is_some() && is_bring_up(bytes) {
            self.follow_the_wall(wall);
        }
        let begins = self.pace == Pace::Lockstep && self.begins_period(bytes);
        let until = match self.waits_since {
            Some(_) if begins => self.now + self.period,
            _ => self.due(wall),
        };
        self.advance(until)?;
        if begins {
            if self.waits_since.is_none() {
                (self.world.noise, self.world.noise_counts) = (World::noise_from(self.seed), self.noise_counts);
            }
            self.waits_since = Some(wall);
        }
        self.counts.frames += 1;
        let Self { faults, segment, now, counts, .. } = self;
        let mut back = |frame: &[u8]| {
            counts.returned += 1;
            back(frame);
        };
        faults.send_due(*now, &mut back);
        if faults.lets_in() && segment.process(*now, bytes).is_some() {
            faults.hand_back(*now, bytes, &mut back);
        }
        self.take_torques();
        self.lead_hand();
        Ok(())
    }

    /// Lets everything happen that is due at a moment of the wall.
    ///
    /// # Errors
    /// If the simulated arm cannot go on.
    pub fn poll(&mut self, wall: Time, mut back: impl FnMut(&[u8])) -> Result<(), RigError> {
        if self.waits_since.is_some_and(|since| wall >= since + GRACE) {
            self.follow_the_wall(wall);
        }
        let until = self.due(wall);
        self.advance(until)?;
        let Self { faults, now, counts, .. } = self;
        faults.send_due(*now, &mut |frame: &[u8]| {
            counts.returned += 1;
            back(frame);
        });
        Ok(())
    }

    /// The moment of the wall at which [`SegmentServer::poll`] has to be called again at the latest.
    pub fn next_deadline(&self) -> Time {
        match (self.waits_since, self.next_event().min(self.faults.next_back())) {
            (Some(since), _) => since + GRACE,
            (None, Time::NEVER) => Time::NEVER,
            (None, next) => {
                let next = match self.pace {
                    Pace::Lockstep => self.whole(next + self.period),
                    Pace::Free => next,
                };
                self.anchor.0 + next.since(self.anchor.1)
            }
        }
    }

    /// The segment, to look at or to break something on it.
    pub fn segment_mut(&mut self) -> &mut Segment<SimulatedDevice> {
        &mut self.segment
    }

    /// Has the drives take so long to answer a mailbox.
    pub fn set_sdo_time(&mut self, time: Duration) {
        for place in self.places.into_iter().take(SENSOR).flatten() {
            if let Some(controller) = self.segment.controller_mut(place) {
                controller.set_mailbox_time(time);
            }
        }
    }

    /// Simulated time since switching on.
    pub fn now(&self) -> Time {
        self.now
    }

    /// What the segment took part in.
    pub fn counts(&self) -> SegmentServed {
        self.counts
    }

    /// States of the drives, left and right, as far as they are here.
    pub fn drive_states(&self) -> [Option<cia402::State>; 2] {
        let [left, right, _] = self.places;
        let [left_state, right_state] = self.states;
        [left.map(|_| left_state), right.map(|_| right_state)]
    }

    /// Torques of the drives in N m.
    pub fn torques_n_m(&self) -> [f64; 2] {
        self.world.torques.to_array()
    }

    /// Where the tool is, in m in the base frame, and the force of the hand on it, in N.
    pub fn truth(&self) -> (crate::quantity::TipPoint, crate::quantity::Force) {
        (self.world.truth.tip, self.world.truth.force)
    }
}

impl SegmentServer {
    /// Time no longer waits.
    fn follow_the_wall(&mut self, wall: Time) {
        (self.waits_since, self.opener, self.anchor) = (None, None, (wall, self.now));
        self.world.noise_counts = 0.0;
    }

    /// Whether a frame begins a period of lockstep: it reads process data, the same as the last one that did.
    fn begins_period(&mut self, bytes: &[u8]) -> bool {
        let Ok(end) = frame::end(bytes) else { return false };
        let mut next = Some(frame::HEADER);
        while let Some(Ok(span)) = next.map(|at| frame::datagram_at(bytes, at, end)) {
            let command = Command::from_byte(span.header.command);
            let address = span.header.address;
            let is_first = self.waits_since.is_none() || self.opener.is_none_or(|opener| opener == address);
            if matches!(command, Some(Command::Lrd | Command::Lrw)) && is_first {
                self.opener = Some(address);
                return true;
            }
            next = span.header.has_more.then_some(span.end());
        }
        false
    }

    /// The end of the last whole period before a moment or at it.
    fn whole(&self, time: Time) -> Time {
        Time(time.0 - time.0 % self.period.as_nanos() as u64)
    }

    /// Simulated time at a moment of the wall, as far as it is made up for.
    fn due(&mut self, wall: Time) -> Time {
        if self.waits_since.is_some() {
            return self.now;
        }
        let time = self.anchor.1 + wall.since(self.anchor.0);
        let until = self.now.max(if self.pace == Pace::Lockstep { self.whole(time) } else { time });
        // Up to the next thing that is due there is nothing to make up for.
        let latest = self.now.max(self.next_event().min(until)) + LAG.max(self.period);
        let latest = if self.pace == Pace::Lockstep { self.whole(latest) } else { latest };
        if until <= latest {
            return until;
        }
        self.anchor = (wall, latest);
        latest
    }

    fn next_event(&self) -> Time {
        self.segment.next_deadline().min(self.faults.next_change())
    }

    /// Has all that is due up to a moment happen at its moment, and the arm move up to there.
    fn advance(&mut self, until: Time) -> Result<(), RigError> {
        while self.next_event() <= until {
            self.now = self.next_event().max(self.now);
            self.measure(false)?;
            self.faults.follow_script(self.now, self.places, &mut self.segment);
            self.segment.poll(self.now);
            self.take_torques();
        }
        self.now = until;
        self.measure(false)?;
        self.lead_hand();
        Ok(())
    }

    /// Has the devices measure the arm and the hand as they are now: the sensor where it takes a sample, or where it has to.
    fn measure(&mut self, has_to_feel: bool) -> Result<(), RigError> {
        self.world.settle(self.now)?;
        let (angles, rates) = self.world.joints();
        let motions = angles.to_array().into_iter().zip(rates.to_array());
        let Self { segment, places, world, now, .. } = self;
        for (place, (angle, rate)) in places.iter().zip(motions) {
            if let Some(drive) = device(segment, *place).and_then(SimulatedDevice::drive_mut) {
                drive.measure(angle, rate);
            }
        }
        if let Some(sensor) = device(segment, places[SENSOR]).and_then(SimulatedDevice::force_torque_mut)
            && (has_to_feel || sensor.next_deadline() <= *now)
        {
            sensor.measure(world.feel(*now)?);
        }
        Ok(())
    }

    /// Hands the torques of the drives to the arm, whose motion up to now is settled.
    fn take_torques(&mut self) {
        let mut torques = [0.0; 2];
        for ((place, torque), state) in self.places.into_iter().zip(&mut torques).zip(&mut self.states) {
            let controller = place.and_then(|place| self.segment.controller_mut(place));
            *state = cia402::State::NotReadyToSwitchOn;
            let controller = controller.filter(|controller| controller.is_powered());
            if let Some(drive) = controller.and_then(|controller| controller.device_mut().drive_mut()) {
                (*torque, *state) = (drive.torque_n_m(), drive.state());
            }
        }
        let [left, right] = torques;
        self.world.torques = JointTorques::new(left, right);
    }

    fn lead_hand(&mut self) {
        let [left, right] = self.drive_states();
        match (left, right) {
            (Some(left), Some(right)) => self.world.lead_hand(self.now, &[left, right]),
            (Some(one), None) | (None, Some(one)) => self.world.lead_hand(self.now, &[one]),
            (None, None) => {}
        }
    }
}

/// Whether a frame is of a master that brings the segment up: it writes to all devices.
fn is_bring_up(bytes: &[u8]) -> bool {
    let Ok(mut datagrams) = Datagrams::of(bytes) else { return false };
    datagrams.any(|datagram| datagram.is_ok_and(|it| it.header.command == Command::Bwr as u8))
}

fn device(segment: &mut Segment<SimulatedDevice>, place: Option<usize>) -> Option<&mut SimulatedDevice> {
    Some(segment.controller_mut(place?)?.device_mut())
}

#[cfg(test)]
mod tests;
