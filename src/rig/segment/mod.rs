//! The devices of a rig on an EtherCAT segment, and the arm and the hand between them.

mod on_can;

use std::time::Duration;

use self::on_can::Queue;
use super::error::RigError;
use super::far_end::{DEVICES, FarEnd, SENSOR};
use super::frame_faults::FrameFaults;
use super::script::Script;
use super::server::{GRACE, LAG};
use super::world::{Body, World};
use yieldwall_config as config;
use yieldwall_config::injection::{Injection, Kind, Medium, Target};
use yieldwall_drives::cia402;
use yieldwall_drives::watchdog::Clock;
use yieldwall_fieldbus::canopen::{Frame, cob};
use yieldwall_fieldbus::ethercat::frame::{self, Command, Datagram, Datagrams};
use yieldwall_fieldbus::ethercat::registers::SII_CONTROL;
use yieldwall_fieldbus::time::Time;
use yieldwall_run::Pace;
use yieldwall_sim::ethercat::{Segment, SimulatedDevice};

/// Slack of moments in s, far below a cycle.
const SLACK_S: f64 = 1e-9;

/// Events that begin a period of lockstep, a bit each: SYNC on CAN, and the frame that reads process data.
const SYNC: u8 = 1;
const READ: u8 = 2;

/// The simulated drives and the force sensor of a rig on an EtherCAT segment, on one arm with a hand. The sensor may be on CAN.
///
/// The server does no I/O, like every engine: frames and wall-clock moments come in, and returning frames go to a closure.
/// Simulated time follows the wall clock. In lockstep it stands still from a frame that reads process data to the next one that
/// reads the same, which is a period later. It follows the wall clock in whole periods before the first such frame, 2 s after the
/// last one, and after an NMT command. It also does when a master writes to all devices or asks a memory chip. The clocks of
/// devices do not drift in lockstep. A SYNC on CAN belongs to the same period as the frame that follows it. The hand takes the tool
/// when all drives are in Operation Enabled, and lets go of it when none makes torque any more.
#[derive(Debug)]
pub struct SegmentServer {
    far: FarEnd,
    seed: u64,
    /// Noise of the force sensor, while it is on.
    noise_counts: f64,
    pace: Pace,
    period: Duration,
    /// Simulated time.
    now: Time,
    /// A moment of the wall clock, and its simulated time.
    anchor: (Time, Time),
    /// Wall-clock time of the last read of process data, while time waits for the next one.
    waits_since: Option<Time>,
    /// Bits of [`SYNC`] and [`READ`] for the events of this period; `has_synced`: whether a SYNC has come since time waits.
    begun_by: u8,
    has_synced: bool,
    /// The logical address with whose reading a period begins.
    opener: Option<u32>,
    script: Script,
    on_frames: FrameFaults,
    on_can: Queue,
    counts: SegmentServed,
}

/// Counters of a segment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SegmentServed {
    /// Frames that came.
    pub frames: u64,
    /// Frames that went back, those that were injected included.
    pub returned: u64,
    /// SYNC messages on CAN.
    pub syncs: u64,
    /// Frames that devices on CAN sent.
    pub sent: u64,
}

impl SegmentServer {
    /// Switches the devices on at this moment of the wall clock, with the arm where the scene's hand starts. The left drive, right
    /// drive and sensor are on the segment if they are `here`; the joint of another drive has no torque. `seed` replaces the
    /// scene's seed.
    ///
    /// # Errors
    /// If parts of the configuration do not fit together, and for a scene without an arm.
    pub fn new(
        rig: &config::Rig,
        scene: &config::Scene,
        seed: u64,
        pace: Pace,
        here: [bool; DEVICES],
        wall: Time,
    ) -> Result<Self, RigError> {
        let mut far = FarEnd::new(rig, scene, seed, (here, pace))?;
        if matches!(far.world.body, Body::Ideal(_)) {
            return Err(RigError::IdealOnBus);
        }
        let noise_counts = far.world.noise_counts;
        if pace == Pace::Lockstep {
            far.world.noise_counts = 0.0;
        }
        let clock = match pace {
            Pace::Lockstep => Clock::Sync,
            Pace::Free => Clock::Wall,
        };
        far.line.iter_mut().for_each(|line| line.set_clock(clock));
        far.begin_segment()?;
        let mut on_can = Queue::new(far.buses);
        if here.get(SENSOR) != Some(&true) {
            far.sensor = None;
        }
        far.sensor.is_some().then(|| far.switch_on(SENSOR, Time(0), &mut on_can));
        Ok(Self {
            far,
            seed,
            noise_counts,
            pace,
            period: Duration::from_micros(rig.cycle.period_us.into()),
            now: Time(0),
            anchor: (wall, Time(0)),
            waits_since: None,
            begun_by: 0,
            has_synced: false,
            opener: None,
            script: Script::default(),
            on_frames: FrameFaults::new(seed),
            on_can,
            counts: SegmentServed::default(),
        })
    }

    /// Begins an injection at its moment, counted in simulated time from switching on.
    ///
    /// # Errors
    /// If it is not possible on a segment, or its target is not here.
    pub fn inject(&mut self, injection: Injection) -> Result<(), RigError> {
        injection.check_on(Medium::Ethercat)?;
        if injection.is_at_master() {
            return Err(RigError::InjectionAtMaster(injection.kind.row().name));
        }
        let is_here = |device| self.far.line.as_ref().is_some_and(|line| line.has(device));
        let is_device =
            matches!(injection.target, Target::LeftDrive | Target::RightDrive | Target::Drives | Target::Sensor);
        if is_device && !(0..DEVICES).any(|device| injection.target.has_device(device) && is_here(device)) {
            let (injection, target) = (injection.kind.row().name, injection.target.name());
            return Err(RigError::NotHere { injection, target });
        }
        self.script.add(injection);
        Ok(())
    }

    /// Passes a frame that came at this moment of the wall clock through the segment; frames that come back at once go to `back`.
    ///
    /// # Errors
    /// If the simulated arm cannot go on.
    pub fn on_frame(&mut self, wall: Time, bytes: &mut [u8], mut back: impl FnMut(&[u8])) -> Result<(), RigError> {
        if self.waits_since.is_some() && is_bring_up(bytes) {
            self.follow_the_wall(wall);
        }
        let mark = self.reads_process_data(bytes).then_some(READ);
        self.advance_to_frame(wall, mark)?;
        self.counts.frames += 1;
        let Self { on_frames, far, now, counts, .. } = self;
        let mut back = |frame: &[u8]| {
            counts.returned += 1;
            back(frame);
        };
        on_frames.send_due(*now, &mut back);
        let process = |bytes: &mut [u8]| Ok::<_, RigError>(far.on_ethernet(*now, bytes)?.map(|_| *now));
        on_frames.pass(bytes, process, &mut |_, bytes: &[u8]| back(bytes))?;
        self.lead_hand();
        Ok(())
    }

    /// Takes a CAN frame that came at this moment of the wall clock.
    ///
    /// # Errors
    /// If the simulated arm cannot go on.
    pub fn on_can(&mut self, wall: Time, frame: &Frame) -> Result<(), RigError> {
        if frame.id() == cob::NMT && self.waits_since.is_some() {
            self.follow_the_wall(wall);
        }
        let mark = (frame.id() == cob::SYNC).then_some(SYNC);
        self.advance_to_frame(wall, mark)?;
        self.counts.syncs += u64::from(mark.is_some());
        self.far.on_frame(self.now, None, frame, &mut self.on_can)?;
        self.lead_hand();
        Ok(())
    }

    /// Gives away what devices on CAN have sent, in its order, up to a frame that is not taken: it stays for the next time.
    pub fn drain_can(&mut self, mut send: impl FnMut(&Frame) -> bool) {
        self.counts.sent += self.on_can.drain(&mut send);
    }

    /// Processes all events that are due at a moment of the wall clock.
    ///
    /// # Errors
    /// If the simulated arm cannot go on.
    pub fn poll(&mut self, wall: Time, mut back: impl FnMut(&[u8])) -> Result<(), RigError> {
        if self.waits_since.is_some_and(|since| wall >= since + GRACE) {
            self.follow_the_wall(wall);
        }
        let until = self.due(wall);
        self.advance(until)?;
        let Self { on_frames, now, counts, .. } = self;
        on_frames.send_due(*now, &mut |frame: &[u8]| {
            counts.returned += 1;
            back(frame);
        });
        Ok(())
    }

    /// Returns the moment of the wall clock by which [`SegmentServer::poll`] has to be called again.
    pub fn next_deadline(&self) -> Time {
        match (self.waits_since, self.next_event().min(self.on_frames.next_back())) {
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

    /// Returns the segment, to inspect it or to inject faults; `None` without one.
    pub fn segment_mut(&mut self) -> Option<&mut Segment<SimulatedDevice>> {
        Some(&mut self.far.line.as_mut()?.segment)
    }

    /// Keeps the hand from taking the tool, for good.
    pub fn take_hand_away(&mut self) {
        self.far.world.has_hand = false;
    }

    /// Sets the time that the drives take to answer a mailbox request.
    pub fn set_sdo_time(&mut self, time: Duration) {
        self.far.line.iter_mut().for_each(|line| line.set_mailbox_time(time));
    }

    /// Returns the simulated time since switching on.
    pub fn now(&self) -> Time {
        self.now
    }

    /// Returns the counters of the segment.
    pub fn counts(&self) -> SegmentServed {
        self.counts
    }

    /// Returns the states of the drives, left and right, if they are here.
    pub fn drive_states(&self) -> [Option<cia402::State>; 2] {
        let [left, right] = self.far.drive_states();
        let here = |drive, state| self.far.line.as_ref().is_some_and(|line| line.has(drive)).then_some(state);
        [here(0, left), here(1, right)]
    }

    /// Returns the present record of arm, hand and drives for observers. The master's part in it is blank.
    #[cfg(feature = "recording")]
    pub fn record(&mut self) -> yieldwall_record::CycleRecord {
        let states = self.far.drive_states();
        self.far.world.record(self.now, states)
    }

    /// Torques of the drives in N m.
    pub fn torques_n_m(&self) -> [f64; 2] {
        self.far.world.torques.to_array()
    }

    /// Returns the place of the tool, in m in the base frame, and the force of the hand on it, in N.
    pub fn truth(&self) -> (yieldwall_motion::quantity::TipPoint, yieldwall_motion::quantity::Force) {
        (self.far.world.truth.tip, self.far.world.truth.force)
    }
}

impl SegmentServer {
    /// Ends the wait of simulated time.
    fn follow_the_wall(&mut self, wall: Time) {
        (self.waits_since, self.opener, self.anchor) = (None, None, (wall, self.now));
        (self.begun_by, self.has_synced) = (0, false);
        self.far.world.noise_counts = 0.0;
    }

    /// Processes all events before a frame that came at a moment of the wall clock. In lockstep a frame with a mark begins a
    /// period, unless it belongs to the period of the other mark. The clock of a sensor on CAN and the noise begin with the first
    /// such frame. They begin again with the first SYNC: until then the boot lasts as long as it does by the wall clock.
    fn advance_to_frame(&mut self, wall: Time, mark: Option<u8>) -> Result<(), RigError> {
        let Some(mark) = mark.filter(|_| self.pace == Pace::Lockstep) else {
            let until = self.due(wall);
            return self.advance(until);
        };
        let is_first_sync = mark == SYNC && !self.has_synced;
        let begins = self.begun_by & mark != 0 || is_first_sync;
        let until = match self.waits_since {
            Some(_) if begins => self.now + self.period,
            _ => self.due(wall),
        };
        self.advance(until)?;
        if self.waits_since.is_none() || is_first_sync {
            (self.far.world.noise, self.far.world.noise_counts) = (World::noise_from(self.seed), self.noise_counts);
            self.far.sensor.iter_mut().for_each(|sensor| sensor.begin_clock(until));
        }
        self.begun_by = if begins { mark } else { self.begun_by | mark };
        self.has_synced |= mark == SYNC;
        self.waits_since = Some(wall);
        Ok(())
    }

    /// Whether a frame reads process data; in lockstep the same data as the last such frame.
    fn reads_process_data(&mut self, bytes: &[u8]) -> bool {
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

    /// Returns the end of the last whole period before a moment or at it.
    fn whole(&self, time: Time) -> Time {
        Time(time.0 - time.0 % self.period.as_nanos() as u64)
    }

    /// Returns the simulated time at a moment of the wall clock; in lockstep as far as it has caught up. Free time never falls
    /// behind: the clock of a device does not stop with this computer.
    fn due(&mut self, wall: Time) -> Time {
        if self.waits_since.is_some() {
            return self.now;
        }
        let time = self.anchor.1 + wall.since(self.anchor.0);
        let until = self.now.max(if self.pace == Pace::Lockstep { self.whole(time) } else { time });
        // Up to the next thing that is due there is nothing to make up for.
        let latest = self.whole(self.now.max(self.next_event().min(until)) + LAG.max(self.period));
        if self.pace == Pace::Free || until <= latest {
            return until;
        }
        self.anchor = (wall, latest);
        latest
    }

    fn next_event(&self) -> Time {
        let change_s = self.script.next_change_s();
        let change = if change_s.is_finite() { Time((change_s * 1e9).ceil() as u64) } else { Time::NEVER };
        self.far.next_deadline().min(change)
    }

    /// Processes all events up to a moment, each at its own moment, and moves the arm up to there.
    fn advance(&mut self, until: Time) -> Result<(), RigError> {
        while self.next_event() <= until {
            self.now = self.next_event().max(self.now);
            self.follow_script();
            self.far.poll(self.now, &mut self.on_can)?;
        }
        self.now = until;
        self.far.world.settle(until)?;
        self.far.measure_joints();
        self.lead_hand();
        Ok(())
    }

    /// Begins and ends what is due.
    fn follow_script(&mut self) {
        let time_s = self.now.as_secs_f64() + SLACK_S;
        while let Some(injection) = self.script.take_ending(time_s) {
            self.switch(injection, false);
        }
        while let Some(injection) = self.script.take_beginning(time_s) {
            self.script.begin(injection);
            self.switch(injection, true);
        }
    }

    fn switch(&mut self, injection: Injection, is_on: bool) {
        tracing::debug!(name = injection.kind.row().name, target = injection.target.name(), is_on, "injection");
        let Self { far, on_frames, now, .. } = self;
        match (injection.kind, injection.target) {
            (Kind::CableOut, Target::Link) => far.line.iter_mut().for_each(|line| line.segment.set_cable(0, !is_on)),
            (_, Target::Bus) => on_frames.switch(injection, is_on),
            // The hand has a time of its own, from when it took the tool.
            (_, Target::Hand) => {
                let start_s = injection.start_s - far.world.hand_from_s;
                far.world.switch(Injection { start_s, ..injection }, is_on);
            }
            (Kind::ArmBlocked, _) => far.world.switch(injection, is_on),
            _ => far.line.iter_mut().for_each(|line| line.switch(*now, 0.0, injection, is_on)),
        }
    }

    fn lead_hand(&mut self) {
        let [left, right] = self.drive_states();
        match (left, right) {
            (Some(left), Some(right)) => self.far.world.lead_hand(self.now, &[left, right]),
            (Some(one), None) | (None, Some(one)) => self.far.world.lead_hand(self.now, &[one]),
            (None, None) => {}
        }
    }
}

/// Whether a frame is of a master that brings the segment up: it writes to all devices, or asks a memory chip, whose answer takes time.
fn is_bring_up(bytes: &[u8]) -> bool {
    let Ok(mut datagrams) = Datagrams::of(bytes) else { return false };
    datagrams.any(|datagram| {
        datagram.is_ok_and(|Datagram { header, .. }| match Command::from_byte(header.command) {
            Some(Command::Bwr) => true,
            Some(Command::Apwr | Command::Fpwr) => header.ado() == SII_CONTROL,
            _ => false,
        })
    })
}

#[cfg(test)]
mod tests;
