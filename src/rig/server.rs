//! The simulated devices of a rig behind a real bus: the same devices as in the embedded simulation, under another clock.

use std::time::Duration;

use super::device_slot::{DeviceSlot, Peer};
use super::error::RigError;
use super::far_end::{DEVICES, FarEnd, Wire};

use super::world::{Body, World};
use yieldwall_config as config;
use yieldwall_drives::cia402;
use yieldwall_drives::watchdog::{Clock, Watchdog};
use yieldwall_fieldbus::canopen::{BusId, Frame, Outbox, cob};
use yieldwall_fieldbus::time::Time;
use yieldwall_run::Pace;
use yieldwall_sim::{Drive, ForceSensor};

/// Wall-clock time without SYNC after which a simulation in lockstep goes on by itself. A master in lockstep waits less long for
/// process data.
pub(super) const GRACE: Duration = Duration::from_secs(2);

/// Simulated time that a simulation in lockstep catches up at once while it runs by itself. If it cannot keep up with the wall
/// clock, it falls behind but still receives. Free time never falls behind.
pub(super) const LAG: Duration = Duration::from_millis(5);

/// Step of simulated time.
const SHORTEST: Duration = Duration::from_nanos(1);

/// Two simulated drives, a force sensor, and the arm and the hand between them, as devices on a bus.
///
/// The server does no I/O, like every engine: frames and wall-clock moments come in, frames go to an [`Outbox`]. The hand takes the
/// tool when both drives are in Operation Enabled, and lets go of it when neither makes torque any more.
#[derive(Debug)]
pub struct DeviceServer {
    far: FarEnd<DeviceSlot<Drive>, DeviceSlot<ForceSensor>>,
    seed: u64,
    /// Noise of the force sensor, while it is on.
    noise_counts: f64,
    pace: Pace,
    period: Duration,
    /// Simulated time.
    now: Time,
    /// A moment of the wall clock, and its simulated time.
    anchor: (Time, Time),
    /// The last SYNC by the wall clock while time waits for the next one.
    waits_since: Option<Time>,
    /// The buses whose SYNC of this period has come, a bit each.
    synced: u8,
    counts: Served,
}

/// Counters of the devices.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Served {
    /// SYNC messages.
    pub syncs: u64,
    /// Frames that the devices sent.
    pub sent: u64,
}

/// All devices on one outbox, each on its bus.
struct Bus<'a, O> {
    out: &'a mut O,
    buses: [BusId; DEVICES],
    sent: &'a mut u64,
}

impl<O: Outbox> Wire for Bus<'_, O> {
    fn submit(&mut self, device: usize, _now: Time, frame: Frame) {
        *self.sent += 1;
        self.out.push(frame.on_bus(self.bus_of(device)));
    }

    fn offer(&mut self, device: usize, _now: Time, frame: Frame) -> bool {
        let is_taken = self.out.offer(frame.on_bus(self.bus_of(device)));
        *self.sent += u64::from(is_taken);
        is_taken
    }
}

impl<O> Bus<'_, O> {
    fn bus_of(&self, device: usize) -> BusId {
        self.buses.get(device).copied().unwrap_or_default()
    }
}

impl DeviceServer {
    /// Creates devices that are switched off, with the arm where the scene's hand starts. `seed` replaces the scene's.
    ///
    /// # Errors
    /// If parts of the configuration do not fit together, and for a scene without an arm.
    pub fn new(rig: &config::Rig, scene: &config::Scene, seed: u64, pace: Pace) -> Result<Self, RigError> {
        let FarEnd { drives, seats, sensor, line, world, buses } =
            FarEnd::new(rig, scene, seed, ([false; DEVICES], pace))?;
        let seat =
            |drive: Option<Drive>| drive.map_or_else(DeviceSlot::empty, |drive| DeviceSlot::Local(Box::new(drive)));
        let clock = match pace {
            Pace::Lockstep => Clock::Sync,
            Pace::Free => Clock::Wall,
        };
        let drives = drives.map(|mut drive| {
            drive.iter_mut().for_each(|drive| drive.set_clock(clock));
            drive
        });
        let sensor = sensor.map_or_else(DeviceSlot::empty, |sensor| DeviceSlot::Local(Box::new(sensor)));
        let mut far = FarEnd { drives: drives.map(seat), seats, sensor, line, world, buses };
        if matches!(far.world.body, Body::Ideal(_)) {
            return Err(RigError::IdealOnBus);
        }
        let noise_counts = far.world.noise_counts;
        if pace == Pace::Lockstep {
            far.world.noise_counts = 0.0;
        }
        Ok(Self {
            far,
            seed,
            noise_counts,
            pace,
            period: Duration::from_micros(rig.cycle.period_us.into()),
            now: Time(0),
            anchor: (Time(0), Time(0)),
            waits_since: None,
            synced: 0,
            counts: Served::default(),
        })
    }

    /// Takes a watch off both drives, as [`Drive::ignore`].
    pub fn ignore(&mut self, watchdog: Watchdog) {
        self.far.drives.iter_mut().filter_map(DeviceSlot::local_mut).for_each(|drive| drive.ignore(watchdog));
    }

    /// Sets the time that both drives take from a reset to their boot-up message.
    pub fn set_reset_time(&mut self, time: Duration) {
        self.far.drives.iter_mut().filter_map(DeviceSlot::local_mut).for_each(|drive| drive.set_reset_time(time));
    }

    /// Keeps the hand from taking the tool, for good.
    pub fn take_hand_away(&mut self) {
        self.far.world.has_hand = false;
    }

    /// Sets the time that both drives take to answer an SDO request.
    pub fn set_sdo_time(&mut self, time: Duration) {
        self.far.drives.iter_mut().filter_map(DeviceSlot::local_mut).for_each(|drive| drive.set_sdo_time(time));
    }

    /// Makes the state machine of a drive, 0 the left, ignore the controlword, or follow it again.
    pub fn set_ignores_controlword(&mut self, drive: usize, ignores: bool) {
        let (place, axis) = self.far.seats.get(drive).copied().unwrap_or_default();
        let drive = self.far.drives.get_mut(place).and_then(DeviceSlot::local_mut);
        drive.into_iter().for_each(|drive| drive.on_axis(axis, |drive| drive.set_ignores_controlword(ignores)));
    }

    /// Switches all devices on at a moment of the wall clock.
    pub fn switch_on(&mut self, wall: Time, out: &mut impl Outbox) {
        self.anchor = (wall, self.now);
        let buses = self.far.buses;
        for device in 0..DEVICES {
            self.far.switch_on(device, self.now, &mut Bus { out: &mut *out, buses, sent: &mut self.counts.sent });
        }
    }

    /// Takes a frame that the devices did not send themselves; `wall` is the time of its arrival, not of its processing.
    ///
    /// # Errors
    /// If the simulated arm cannot go on.
    pub fn on_frame(&mut self, wall: Time, frame: &Frame, out: &mut impl Outbox) -> Result<(), RigError> {
        if frame.id() == cob::NMT {
            self.run_on(wall);
        }
        // Devices elsewhere have heard already what waited here to be taken: if that made up for lost time in lockstep, they would
        // miss heartbeats.
        let is_alone = (0..DEVICES).all(|device| self.is_here(device));
        let goes_on = is_alone || self.pace == Pace::Free || frame.id() == cob::SYNC;
        let mut now = if goes_on { self.due(wall) } else { self.quiet_until(wall) };
        if frame.id() == cob::SYNC {
            self.counts.syncs += 1;
            let own = frame.bus().bit();
            if self.pace == Pace::Lockstep {
                // One SYNC of each bus belongs to a period; the second one of a bus begins the next.
                if self.waits_since.is_none() || self.synced & own != 0 {
                    self.synced = 0;
                }
                if self.waits_since.is_some() && self.synced == 0 {
                    now = self.now + self.period;
                }
                if self.waits_since.is_none() {
                    self.advance(now, out)?;
                    self.begin(now);
                }
                self.synced |= own;
                self.waits_since = Some(wall);
            }
        }
        self.advance(now, out)?;
        let buses = self.far.buses;
        self.far.on_frame(now, None, frame, &mut Bus { out, buses, sent: &mut self.counts.sent })?;
        if frame.id() == cob::SYNC {
            self.far.world.lead_hand(self.now, &self.drive_states());
        }
        Ok(())
    }

    /// Processes all events that are due at a moment of the wall clock.
    ///
    /// # Errors
    /// If the simulated arm cannot go on.
    pub fn poll(&mut self, wall: Time, out: &mut impl Outbox) -> Result<(), RigError> {
        if self.waits_since.is_some_and(|since| wall >= since + GRACE) {
            self.run_on(wall);
        }
        let until = self.due(wall);
        self.advance(until, out)
    }

    /// Returns the moment of the wall clock by which [`DeviceServer::poll`] has to be called again.
    pub fn next_deadline(&self) -> Time {
        match (self.waits_since, self.far.next_deadline()) {
            (Some(since), _) => since + GRACE,
            (None, Time::NEVER) => Time::NEVER,
            (None, next) => {
                let next = if self.pace == Pace::Lockstep {
                    self.whole(next + self.period.saturating_sub(SHORTEST))
                } else {
                    next
                };
                self.anchor.0 + next.since(self.anchor.1)
            }
        }
    }

    /// Returns the simulated time since switching on.
    pub fn now(&self) -> Time {
        self.now
    }

    /// Returns the counters of the devices.
    pub fn counts(&self) -> Served {
        self.counts
    }

    /// Leaves out of left drive, right drive and sensor those that are not `here`: they have to be attached.
    #[must_use]
    pub fn only(mut self, here: [bool; DEVICES]) -> Self {
        let [has_left, has_right, has_sensor] = here;
        let seats = self.far.seats.into_iter().zip([has_left, has_right]);
        for (place, slot) in self.far.drives.iter_mut().enumerate() {
            // Axes of one device are here together.
            if !seats.clone().any(|((device, _), is_here)| device == place && is_here) {
                *slot = DeviceSlot::empty();
            }
        }
        if !has_sensor {
            self.far.sensor = DeviceSlot::empty();
        }
        self
    }

    /// Attaches `peer` as a device that is not simulated here: 0 the left drive, 1 the right drive, 2 the sensor.
    pub fn attach(&mut self, device: usize, peer: Box<dyn Peer>) {
        match self.far.drives.get_mut(device) {
            Some(seat) => seat.attach(self.now, peer),
            None => self.far.sensor.attach(self.now, peer),
        }
    }

    /// Whether a device is simulated here.
    pub fn is_here(&self, device: usize) -> bool {
        let drive = self.far.seats.get(device).and_then(|(place, _)| self.far.drives.get(*place));
        match drive {
            Some(seat) => seat.here().is_some(),
            None => self.far.sensor.here().is_some(),
        }
    }

    /// States of the drives, left and right.
    pub fn drive_states(&self) -> [cia402::State; 2] {
        self.far.drive_states()
    }

    /// Returns the present record of arm, hand and drives for observers. The master's part in it is blank.
    #[cfg(feature = "recording")]
    pub fn record(&mut self) -> yieldwall_record::CycleRecord {
        let states = self.drive_states();
        self.far.world.record(self.now, states)
    }

    /// Torques of the drives in N m.
    pub fn torques_n_m(&self) -> [f64; 2] {
        self.far.torques_n_m()
    }

    /// Returns the simulated time at a moment of the wall clock.
    fn time_at(&self, wall: Time) -> Time {
        if self.waits_since.is_some() {
            return self.now;
        }
        let time = self.anchor.1 + wall.since(self.anchor.0);
        self.now.max(if self.pace == Pace::Lockstep { self.whole(time) } else { time })
    }

    /// Returns the end of the last whole period before a moment or at it.
    fn whole(&self, time: Time) -> Time {
        Time(time.0 - time.0 % self.period.as_nanos() as u64)
    }

    /// Returns the simulated time up to which events are due now.
    fn due(&mut self, wall: Time) -> Time {
        let until = self.time_at(wall);
        // Up to the next thing that is due there is nothing to make up for.
        let idle_until = self.now.max(self.far.next_deadline().min(until));
        let latest = self.whole(idle_until + LAG.max(self.period));
        if self.pace == Pace::Free || until <= latest {
            return until;
        }
        self.anchor = (wall, latest);
        latest
    }

    /// Returns the simulated time at a moment of the wall clock, or the last period before the next event if that is sooner.
    /// Nothing happens up to there, so there is nothing to catch up. A heartbeat that counted from earlier would be missed.
    fn quiet_until(&self, wall: Time) -> Time {
        let quiet = self.whole(Time(self.far.next_deadline().0.saturating_sub(1)));
        self.now.max(self.time_at(wall).min(quiet))
    }

    /// Begins all that is not at rest with the first SYNC: the clock of the sensor, and the noise on its samples. With noise from
    /// the start, the zero of a sensor would depend on the moment of its taring command.
    fn begin(&mut self, now: Time) {
        (self.far.world.noise, self.far.world.noise_counts) = (World::noise_from(self.seed), self.noise_counts);
        if let Some(sensor) = self.far.sensor.local_mut() {
            sensor.begin_clock(now);
        }
    }

    /// Makes time follow the wall clock from now on.
    fn run_on(&mut self, wall: Time) {
        if self.waits_since.take().is_some() {
            self.anchor = (wall, self.now);
            self.far.world.noise_counts = 0.0;
        }
    }

    fn advance(&mut self, until: Time, out: &mut impl Outbox) -> Result<(), RigError> {
        let buses = self.far.buses;
        while self.far.next_deadline() <= until {
            self.now = self.far.next_deadline().max(self.now);
            self.far.poll(self.now, &mut Bus { out: &mut *out, buses, sent: &mut self.counts.sent })?;
        }
        self.now = until;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_config::{builtin, load_rig};

    /// Before the first SYNC drives whose sensor is elsewhere hear each heartbeat when it came, and not when something was due last:
    /// otherwise those of a master that is a little slower than they are would be missed now and then.
    #[test]
    fn drives_without_a_sensor_beside_them_miss_no_heartbeat_before_sync() {
        let rig = load_rig(builtin("paper-admittance.yaml")).unwrap();
        let scene = rig.scene().unwrap().value;
        let server = DeviceServer::new(&rig.value, &scene, scene.seed, Pace::Lockstep).unwrap();
        let mut server = server.only([true, true, false]);
        let mut said: Vec<Frame> = Vec::new();
        let at = |us: u64| Time(1000 * us);
        server.switch_on(at(0), &mut said);
        let hear = |server: &mut DeviceServer, us: u64, frame: &Frame, said: &mut Vec<Frame>| {
            while server.next_deadline() <= at(us) {
                server.poll(server.next_deadline(), said).unwrap();
            }
            server.on_frame(at(us), frame, said).unwrap();
        };
        // The own heartbeat every 20 ms, the master's awaited every 40 ms; both drives started.
        for (us, node) in [(1_500_000, 1), (1_510_000, 2)] {
            for (late, data) in
                [[0x2b, 0x17, 0x10, 0, 20, 0, 0, 0], [0x23, 0x16, 0x10, 1, 40, 0, 127, 0]].iter().enumerate()
            {
                hear(&mut server, us + 5000 * late as u64, &Frame::new(0x600 + node, data), &mut said);
            }
        }
        for beat in 0..2000 {
            hear(&mut server, 1_600_000 + 20_300 * beat, &Frame::new(0x77f, &[5]), &mut said);
        }
        let emergencies = said.iter().filter(|frame| matches!(frame.id(), 0x081 | 0x082) && frame.data() != [0; 8]);
        assert_eq!(emergencies.count(), 0);
        let heartbeats = said.iter().filter(|frame| frame.id() == 0x701).count();
        assert!(heartbeats > 1900, "{heartbeats}");
        // One that is not heard for longer is missed.
        hear(&mut server, 1_600_000 + 20_300 * 2010, &Frame::new(0x77f, &[5]), &mut said);
        assert!(said.iter().any(|frame| frame.id() == 0x081 && frame.data().starts_with(&[0x30, 0x81])));
    }
}
