//! The whole rig in one process, in virtual time.

use std::time::Duration;

mod boot;
mod buses;
mod events;
mod host;
mod injecting;
mod probe;
mod trouble;

pub use probe::{BodyTruth, PORTS};

use super::assembly;
use super::build;
use super::conduct::Enabling;
use super::drill::Silence;
use super::error::RigError;
use super::far_end::FarEnd;
use super::world::{Body, Truth};
use crate::bus::Master;
use crate::canopen::{Frame, Time};
use crate::config;
use crate::cycle::Outputs;
use crate::guard::{Cause, Request, State};
use crate::quantity::JointTorques;
use crate::record::{self, CycleRecord, Moment, Row, Stages};
use crate::sim::arm::Arm;
use crate::sim::can::{BusCounters, Tamper};
use crate::sim::hand::Hand;
use crate::sim::{Drive, ForceSensor, Watchdog};
use buses::Buses;
use host::Computer;
use injecting::Schedule;
use trouble::{Device, Troubles};

/// Ports of each virtual bus.
const MASTER: usize = 0;
/// The left drive, the right drive, the sensor.
const DEVICES: [usize; 3] = [1, 2, 3];
/// Whoever else is on a bus.
const STRANGER: usize = 4;

/// Gets every frame that went over a bus ([`Frame::bus`]), with the moment of its end.
pub type Tap = Box<dyn FnMut(Time, &Frame) + Send>;

/// Gets the record of every cycle, right after the cycle has run.
pub type Observer = Box<dyn FnMut(&CycleRecord) + Send>;

/// Master, virtual buses, simulated devices, arm and hand.
///
/// [`EmbeddedRig::new`] assembles them, [`EmbeddedRig::enable`] boots the network and enables the drives, and every
/// [`EmbeddedRig::run_cycle`] is one period of the rig. The same configuration and seed give the same frames.
pub struct EmbeddedRig {
    master: Master,
    buses: Buses,
    far: FarEnd,
    tap: Option<Tap>,
    observer: Option<Observer>,
    cycles: u64,
    schedule: Schedule,
    troubles: Troubles,
    host: Computer,
    /// What a drill keeps from the devices.
    pub(super) silence: Option<Silence>,
    period: Duration,
    /// Time from one sample of the force sensor to the next.
    sample_period: Duration,
    compute_at: Duration,
    enabling: Enabling,
    now: Time,
    next_sync: Time,
    last: Option<Outputs>,
}

impl EmbeddedRig {
    /// A rig that is switched off, its arm where the scene's hand starts.
    ///
    /// `fixture` stands in place of the rig's own, `seed` in place of the scene's.
    ///
    /// # Errors
    /// Where parts of the configuration do not fit together.
    pub fn new(
        rig: &config::Rig,
        scene: &config::Scene,
        fixture: &config::Fixture,
        seed: u64,
    ) -> Result<Self, RigError> {
        let mut machine = Self {
            master: build::master(rig, fixture)?,
            buses: Buses::new(rig)?,
            far: FarEnd::new(rig, scene, seed)?,
            tap: None,
            observer: None,
            cycles: 0,
            schedule: Schedule::default(),
            troubles: Troubles::new(devices(rig)?, super::buses::device_buses(rig)?, seed),
            host: Computer::default(),
            silence: None,
            period: Duration::from_micros(rig.cycle.period_us.into()),
            sample_period: build::sample_period(rig),
            compute_at: Duration::from_micros(rig.cycle.compute_at_us.into()),
            enabling: Enabling::new(rig),
            now: Time::default(),
            next_sync: Time::NEVER,
            last: None,
        };
        for fault in &scene.faults {
            machine.inject(fault.injection()?)?;
        }
        Ok(machine)
    }

    /// Takes a watch off both drives, as [`Drive::ignore`].
    pub fn ignore(&mut self, watchdog: Watchdog) {
        self.far.drives.iter_mut().for_each(|drive| drive.ignore(watchdog));
    }

    /// Has both drives take so long from a reset to their boot-up message.
    pub fn set_reset_time(&mut self, time: Duration) {
        self.far.drives.iter_mut().for_each(|drive| drive.set_reset_time(time));
    }

    /// Has both drives take so long to answer an SDO request.
    pub fn set_sdo_time(&mut self, time: Duration) {
        self.far.drives.iter_mut().for_each(|drive| drive.set_sdo_time(time));
    }

    /// Has the force sensor take its next sample so long after the next SYNC is due, and the others by an exact clock, so that
    /// the phase between both is known. Nothing happens where SYNC is the sensor's clock.
    pub fn align_sensor(&mut self, after_sync: Duration) {
        self.far.sensor.set_clock(self.next_sync + after_sync, self.sample_period);
    }

    /// Forgets what was injected and what the scene would.
    pub(super) fn clear_injections(&mut self) {
        self.schedule = Schedule::default();
        self.troubles.clear();
    }

    /// Has `tap` get every frame from now on.
    pub fn set_tap(&mut self, tap: Tap) {
        self.tap = Some(tap);
    }

    /// Has `observer` get the record of every cycle from now on, those of enabling and stopping included.
    pub fn set_observer(&mut self, observer: Observer) {
        self.observer = Some(observer);
    }

    /// Has every frame pass through `tamper` from now on.
    pub fn set_tamper(&mut self, tamper: impl Tamper + Send + 'static) {
        self.buses.set_tamper(tamper);
    }

    /// State of the supervisor; [`State::Lost`] if an injection killed its process, since the drives' watchdogs act.
    pub fn state(&self) -> State {
        match self.master.state() {
            state if state.is_latched() || !self.host.is_dead => state,
            _ => State::Lost,
        }
    }

    /// The fault that led to the present state.
    pub fn cause(&self) -> Option<Cause> {
        self.master.cause()
    }

    /// The master, for reports.
    pub fn master(&self) -> &Master {
        &self.master
    }

    /// The simulated drives, left and right, for reports.
    pub fn drives(&self) -> &[Drive; 2] {
        &self.far.drives
    }

    /// The force sensor.
    pub fn force_sensor(&self) -> &ForceSensor {
        &self.far.sensor
    }

    /// The arm; `None` if the joints follow their targets without one.
    pub fn arm(&self) -> Option<&Arm> {
        match &self.far.world.body {
            Body::Arm(arm) => Some(arm),
            Body::Ideal(_) => None,
        }
    }

    /// The hand.
    pub fn hand(&self) -> &Hand<2> {
        &self.far.world.hand
    }

    /// What has gone over each bus so far, in the order of their names; the sum is that of the rig.
    pub fn bus_counters(&self) -> impl Iterator<Item = &BusCounters> {
        self.buses.counters()
    }

    /// Virtual time since switching on.
    pub fn now(&self) -> Time {
        self.now
    }

    /// Time of the next cycle since the scene began, in s; minus infinity before it has.
    pub fn scene_time_s(&self) -> f64 {
        self.next_sync.as_secs_f64() - self.far.world.hand_from_s
    }

    /// When the next cycle begins.
    pub fn next_sync(&self) -> Time {
        self.next_sync
    }

    /// What the last cycle gave.
    pub fn last_outputs(&self) -> Option<&Outputs> {
        self.last.as_ref()
    }

    /// One period: SYNC, process data, the cycle, set-points.
    ///
    /// While an injection keeps the process from running, the row is that of the last cycle at the present truth, and no
    /// observer is called.
    ///
    /// # Errors
    /// If the simulated arm cannot go on.
    pub fn run_cycle(&mut self, request: Request) -> Result<Row, RigError> {
        let grid = self.next_sync;
        if grid == Time::NEVER {
            return Err(RigError::NotEnabled {
                waited_s: 0.0,
                state: "the network was not booted".to_owned(),
                cause: None,
            });
        }
        self.pump(grid)?;
        self.follow_injections(grid);
        self.troubles.begin_cycle(grid, self.period);
        let host = self.troubles.host();
        if host.is_stopped || self.host.is_dead {
            self.sleep(grid, &host)?;
            return self.idle_row(grid);
        }
        self.wake();
        let sync_at = grid + host.sync_late;
        self.pump(sync_at)?;
        self.send_sync(sync_at);
        let compute_at = sync_at + self.compute_at + host.compute_late;
        self.pump(compute_at)?;
        let Some(outputs) = self.compute(compute_at, &host, request)? else { return self.idle_row(grid) };
        self.last = Some(outputs);
        self.next_sync = self.next_grid(grid, self.now);
        let stages = host.stages(self.now.since(compute_at));
        let record = self.record(grid, compute_at, stages, &outputs);
        self.cycles += 1;
        if let Some(observer) = &mut self.observer {
            observer(&record);
        }
        Ok(record.row())
    }

    /// The row of a period without a cycle.
    fn idle_row(&mut self, grid: Time) -> Result<Row, RigError> {
        self.next_sync = grid + self.period;
        let state = "the process does not run".to_owned();
        let outputs = self.last.ok_or(RigError::NotEnabled { waited_s: 0.0, state, cause: None })?;
        Ok(self.record(grid, grid + self.compute_at, Stages::default(), &outputs).row())
    }

    fn record(&self, sync_at: Time, compute_at: Time, stages: Stages, outputs: &Outputs) -> CycleRecord {
        let Truth { tip, velocity, .. } = self.far.world.truth;
        let [left, right] = &self.far.drives;
        let moment = Moment {
            index: self.cycles,
            sync_ns: sync_at.0,
            compute_ns: compute_at.0,
            scene_time_s: sync_at.as_secs_f64() - self.far.world.hand_from_s,
            stages,
        };
        let truth =
            record::Truth { tool: tip, velocity, torques: JointTorques::new(left.torque_n_m(), right.torque_n_m()) };
        CycleRecord::new(moment, self.master.last_inputs(), outputs, self.cause(), Some(truth))
    }
}

fn devices(rig: &config::Rig) -> Result<[Device; 3], RigError> {
    let device = |node: u8, heartbeat_ms: u16| {
        let heartbeat = Duration::from_millis(heartbeat_ms.into());
        Ok::<_, RigError>(Device::Node { node: assembly::node(node)?, heartbeat })
    };
    let [left, right] = &rig.drives;
    let sensor = match rig.sensor.protocol {
        config::SensorProtocol::Canopen { node_id, heartbeat_ms, .. } => device(node_id, heartbeat_ms)?,
        config::SensorProtocol::Streaming { .. } => Device::Plain { can_be_invalid: false },
        config::SensorProtocol::Polled { invalid_bits, .. } => Device::Plain { can_be_invalid: invalid_bits != 0 },
    };
    Ok([device(left.node_id, left.heartbeat_ms)?, device(right.node_id, right.heartbeat_ms)?, sensor])
}
