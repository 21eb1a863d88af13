//! The whole rig in one process, in virtual time.

use std::time::Duration;

use super::build;
use super::error::RigError;
use super::world::{Body, Ideal, Truth, World};
use crate::bus::{CommandMode, Master, Phase};
use crate::canopen::{Frame, Time, cob, node_id};
use crate::config;
use crate::cycle::{Cycle, Outputs, Timing};
use crate::guard::{Cause, Request, State};
use crate::linkage::{FiveBar, MassModel};
use crate::quantity::{JointTorques, TipPoint, TipVelocity};
use crate::record::{self, CycleRecord, Moment, Row};
use crate::sim::arm::{Arm, ArmParameters, JointElasticity};
use crate::sim::can::{BitTiming, BusCounters, QueueOrder, Tamper, VirtualBus};
use crate::sim::hand::Hand;
use crate::sim::{Drive, DriveSettings, Encoder, ForceSensor, ForceSensorSettings, PositionLoop};
use nalgebra::Vector2;

/// Ports of the virtual bus.
const MASTER: usize = 0;
const DRIVES: [usize; 2] = [1, 2];
const SENSOR: usize = 3;

/// Longest time from switching on to the exchange of process data, virtual.
const BOOT_LIMIT: Duration = Duration::from_secs(5);
/// Cycles of process data before the rig asks to be enabled: the drives have answered, the sensor has samples.
const CYCLES_BEFORE_ENABLING: u32 = 10;
/// Longest time from asking to running, virtual.
const ENABLE_LIMIT_S: f64 = 1.0;
/// Longest time that a stop may take, virtual.
const STOP_LIMIT_S: f64 = 2.0;

/// Gets every frame that went over the bus, with the moment of its end.
pub type Tap = Box<dyn FnMut(Time, &Frame) + Send>;

/// Gets the record of every cycle, right after the cycle has run.
pub type Observer = Box<dyn FnMut(&CycleRecord) + Send>;

/// Master, virtual bus, simulated devices, arm and hand.
///
/// [`EmbeddedRig::new`] assembles them, [`EmbeddedRig::enable`] boots the network and enables the drives, and every
/// [`EmbeddedRig::run_cycle`] is one period of the rig. The same configuration and seed give the same frames.
pub struct EmbeddedRig {
    master: Master,
    bus: VirtualBus,
    drives: [Drive; 2],
    sensor: ForceSensor,
    world: World,
    tap: Option<Tap>,
    observer: Option<Observer>,
    cycles: u64,
    period: Duration,
    compute_at: Duration,
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
        let cycle: Cycle = build::cycle(rig, fixture)?;
        let setup = build::master(rig)?;
        let timing = rig.buses.values().next().map_or(BitTiming::Ideal, |bus| match bus.timing {
            config::BusTiming::Arbitrated => BitTiming::Arbitrated { bit_rate: bus.bit_rate_bit_per_s },
            config::BusTiming::Ideal => BitTiming::Ideal,
        });
        let orders = [QueueOrder::Fifo, QueueOrder::Priority, QueueOrder::Priority, QueueOrder::Priority];
        let [left, right] = &rig.drives;
        Ok(Self {
            master: Master::new(&setup, cycle)?,
            bus: VirtualBus::new(timing, &orders)?,
            drives: [drive(rig, scene, left, 1)?, drive(rig, scene, right, 2)?],
            sensor: force_sensor(rig)?,
            world: world(rig, scene, seed)?,
            tap: None,
            observer: None,
            cycles: 0,
            period: Duration::from_micros(rig.cycle.period_us.into()),
            compute_at: Duration::from_micros(rig.cycle.compute_at_us.into()),
            now: Time::default(),
            next_sync: Time::NEVER,
            last: None,
        })
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
        self.bus.set_tamper(tamper);
    }

    /// Switches everything on, boots the network and enables the drives; the hand takes the handle when the rig runs.
    ///
    /// # Errors
    /// [`RigError::Boot`] if a node is missing or is not what it should be, [`RigError::NotEnabled`] if the rig did not
    /// come to run.
    pub fn enable(&mut self) -> Result<(), RigError> {
        self.boot()?;
        for _ in 0..CYCLES_BEFORE_ENABLING {
            self.run_cycle(Request::None)?;
        }
        self.run_cycle(Request::Enable)?;
        let limit = (ENABLE_LIMIT_S / self.period.as_secs_f64()) as u32;
        for _ in 0..limit {
            if self.state() == State::Running {
                self.world.hand_from_s = self.next_sync.as_secs_f64();
                return Ok(());
            }
            self.run_cycle(Request::None)?;
        }
        let cause = self.cause().map_or(String::new(), |cause| format!(", {}", cause.fault.row().name));
        Err(RigError::NotEnabled { waited_s: ENABLE_LIMIT_S, state: format!("{:?}{cause}", self.state()) })
    }

    /// Stops the rig along its ramp and runs until no drive makes torque; at once done if none does.
    ///
    /// # Errors
    /// [`RigError::NotStopped`] if a drive still makes torque after 2 s; else as [`EmbeddedRig::run_cycle`].
    pub fn stop(&mut self) -> Result<(), RigError> {
        let limit = (STOP_LIMIT_S / self.period.as_secs_f64()) as u32;
        for _ in 0..limit {
            if !self.drives.iter().any(has_torque) {
                return Ok(());
            }
            self.run_cycle(Request::Stop)?;
        }
        Err(RigError::NotStopped { waited_s: STOP_LIMIT_S, state: format!("{:?}", self.state()) })
    }

    /// State of the supervisor.
    pub fn state(&self) -> State {
        self.master.state()
    }

    /// The fault that led to the present state.
    pub fn cause(&self) -> Option<Cause> {
        self.master.cause()
    }

    /// The master, for reports.
    pub fn master(&self) -> &Master {
        &self.master
    }

    /// Puts a simulated drive (0 left, 1 right) into fault with an error code (603Fh), as its own monitoring would; any
    /// other number does nothing.
    pub fn raise_drive_fault(&mut self, joint: usize, code: u16) {
        if let (Some(drive), Some(port)) = (self.drives.get_mut(joint), DRIVES.get(joint)) {
            drive.raise_fault(self.now, code, &mut self.bus.outbox(*port, self.now));
        }
    }

    /// The simulated drives, left and right, for reports.
    pub fn drives(&self) -> &[Drive; 2] {
        &self.drives
    }

    /// The force sensor.
    pub fn force_sensor(&self) -> &ForceSensor {
        &self.sensor
    }

    /// The arm; `None` if the joints follow their targets without one.
    pub fn arm(&self) -> Option<&Arm> {
        match &self.world.body {
            Body::Arm(arm) => Some(arm),
            Body::Ideal(_) => None,
        }
    }

    /// The hand.
    pub fn hand(&self) -> &Hand<2> {
        &self.world.hand
    }

    /// What has gone over the bus so far.
    pub fn bus_counters(&self) -> &BusCounters {
        self.bus.counters()
    }

    /// Virtual time since switching on.
    pub fn now(&self) -> Time {
        self.now
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
    /// # Errors
    /// If the simulated arm cannot go on.
    pub fn run_cycle(&mut self, request: Request) -> Result<Row, RigError> {
        let sync_at = self.next_sync;
        if sync_at == Time::NEVER {
            return Err(RigError::NotEnabled { waited_s: 0.0, state: "the network was not booted".to_owned() });
        }
        self.pump(sync_at)?;
        self.master.on_sync(&mut self.bus.outbox(MASTER, sync_at));
        let compute_at = sync_at + self.compute_at;
        self.pump(compute_at)?;
        let outputs =
            self.master.on_compute(compute_at, request, Timing::default(), &mut self.bus.outbox(MASTER, compute_at));
        self.last = Some(outputs);
        self.next_sync = sync_at + self.period;
        let record = self.record(sync_at, compute_at, &outputs);
        self.cycles += 1;
        if let Some(observer) = &mut self.observer {
            observer(&record);
        }
        Ok(record.row())
    }

    fn record(&self, sync_at: Time, compute_at: Time, outputs: &Outputs) -> CycleRecord {
        let Truth { tip, velocity, .. } = self.world.truth;
        let [left, right] = &self.drives;
        let moment = Moment {
            index: self.cycles,
            sync_ns: sync_at.0,
            compute_ns: compute_at.0,
            scene_time_s: sync_at.as_secs_f64() - self.world.hand_from_s,
        };
        let truth =
            record::Truth { tool: tip, velocity, torques: JointTorques::new(left.torque_n_m(), right.torque_n_m()) };
        CycleRecord::new(moment, self.master.last_inputs(), outputs, self.cause(), Some(truth))
    }

    fn boot(&mut self) -> Result<(), RigError> {
        for (drive, port) in self.drives.iter_mut().zip(DRIVES) {
            drive.boot(self.now, &mut self.bus.outbox(port, self.now));
        }
        self.sensor.boot(self.now, &mut self.bus.outbox(SENSOR, self.now));
        self.master.start(self.now, &mut self.bus.outbox(MASTER, self.now));
        let limit = self.now + BOOT_LIMIT;
        while self.now < limit {
            match self.master.phase() {
                Phase::Operational => {
                    let period = self.period.as_nanos() as u64;
                    self.next_sync = Time((self.now.0 / period + 1) * period);
                    return Ok(());
                }
                Phase::Failed(error) => return Err(error.clone().into()),
                _ => {}
            }
            let next = self.next_event().min(limit);
            self.pump(next)?;
            self.now = next;
        }
        Err(RigError::NotEnabled { waited_s: BOOT_LIMIT.as_secs_f64(), state: format!("{:?}", self.master.phase()) })
    }

    fn next_event(&self) -> Time {
        let [left, right] = &self.drives;
        let devices = left.next_deadline().min(right.next_deadline()).min(self.sensor.next_deadline());
        self.bus.next_event().min(devices).min(self.master.next_deadline())
    }

    /// Lets everything happen that is due up to `until`, in order of time; of one moment, frames come first.
    fn pump(&mut self, until: Time) -> Result<(), RigError> {
        loop {
            let next = self.next_event();
            if next > until {
                break;
            }
            self.now = next;
            while let Some(delivery) = self.bus.advance(next) {
                if let Some(tap) = &mut self.tap {
                    tap(delivery.time, &delivery.frame);
                }
                self.deliver(delivery.from, &delivery.frame)?;
            }
            self.poll_devices()?;
            if self.master.next_deadline() <= next {
                self.master.poll(next, &mut self.bus.outbox(MASTER, next));
            }
        }
        self.now = until;
        Ok(())
    }

    fn deliver(&mut self, from: usize, frame: &Frame) -> Result<(), RigError> {
        let now = self.now;
        if frame.id() == cob::SYNC {
            self.sample()?;
        }
        for (drive, port) in self.drives.iter_mut().zip(DRIVES) {
            if port != from {
                drive.on_frame(now, frame, &mut self.bus.outbox(port, now));
            }
        }
        if from != SENSOR {
            self.sensor.on_frame(now, frame, &mut self.bus.outbox(SENSOR, now));
        }
        if from == MASTER {
            self.master.on_echo(frame);
        } else {
            self.master.on_frame(now, frame, &mut self.bus.outbox(MASTER, now));
        }
        self.take_torques()
    }

    /// Gives every device the state of the machine at this moment.
    fn sample(&mut self) -> Result<(), RigError> {
        if let Some(outputs) = &self.last {
            self.world.follow(self.now, outputs.signals.target_angles)?;
        }
        self.world.settle(self.now)?;
        let counts = self.world.feel(self.now)?;
        self.sensor.measure(counts);
        self.measure_joints();
        Ok(())
    }

    fn measure_joints(&mut self) {
        let (angles, rates) = self.world.joints();
        for (drive, (angle, rate)) in self.drives.iter_mut().zip(angles.to_array().into_iter().zip(rates.to_array())) {
            drive.measure(angle, rate);
        }
    }

    fn poll_devices(&mut self) -> Result<(), RigError> {
        let now = self.now;
        let [left, right] = &self.drives;
        if left.next_deadline().min(right.next_deadline()) <= now {
            self.world.settle(now)?;
            self.measure_joints();
            for (drive, port) in self.drives.iter_mut().zip(DRIVES) {
                if drive.next_deadline() <= now {
                    drive.poll(now, &mut self.bus.outbox(port, now));
                }
            }
            self.take_torques()?;
        }
        if self.sensor.next_deadline() <= now {
            self.world.settle(now)?;
            let counts = self.world.feel(now)?;
            self.sensor.measure(counts);
            self.sensor.poll(now, &mut self.bus.outbox(SENSOR, now));
        }
        Ok(())
    }

    /// New torques act from now on; what was before is settled under the old ones.
    fn take_torques(&mut self) -> Result<(), RigError> {
        let [left, right] = &self.drives;
        let torques = JointTorques::new(left.torque_n_m(), right.torque_n_m());
        if torques != self.world.torques {
            self.world.settle(self.now)?;
            self.world.torques = torques;
        }
        Ok(())
    }
}

fn has_torque(drive: &Drive) -> bool {
    use yieldwall_drives::cia402::State::{FaultReactionActive, OperationEnabled, QuickStopActive};
    matches!(drive.state(), OperationEnabled | QuickStopActive | FaultReactionActive)
}

fn node(raw: u8) -> Result<crate::canopen::NodeId, RigError> {
    node_id(raw).map_err(|error| RigError::Device(error.to_string()))
}

fn model(scene: &config::Scene) -> Result<&config::SceneModel, RigError> {
    scene.model.as_ref().ok_or_else(|| RigError::Mismatch("the scene has no `model` of a rig".into()))
}

fn drive(rig: &config::Rig, scene: &config::Scene, drive: &config::Drive, serial: u32) -> Result<Drive, RigError> {
    let servo = &rig.plant.drive_position_loop;
    Drive::new(DriveSettings {
        node: node(drive.node_id)?,
        profile: build::profile(&drive.profile)?,
        serial,
        scaling: build::scaling(drive)?,
        position_loop: PositionLoop {
            period_us: servo.period_us,
            stiffness_n_m_per_rad: servo.stiffness_n_m_per_rad.get(),
            damping_n_m_s_per_rad: servo.damping_n_m_s_per_rad.get(),
            integral_n_m_per_rad_s: servo.integral_n_m_per_rad_s.get(),
        },
        encoder: match model(scene)?.encoder {
            config::EncoderModel::Exact => Encoder::Exact,
            config::EncoderModel::Quantised => Encoder::Quantised,
        },
    })
    .map_err(|error| RigError::Device(error.to_string()))
}

fn force_sensor(rig: &config::Rig) -> Result<ForceSensor, RigError> {
    let sensor = &rig.sensor;
    ForceSensor::new(ForceSensorSettings {
        node: node(sensor.node_id)?,
        profile: build::profile(&sensor.profile)?,
        serial: 3,
        sample_rate_hz: sensor.sample_rate_hz.get().round() as u32,
        phase_us: 0,
        range_counts: i32::from(sensor.range_counts),
    })
    .map_err(|error| RigError::Device(error.to_string()))
}

fn world(rig: &config::Rig, scene: &config::Scene, seed: u64) -> Result<World, RigError> {
    let linkage: FiveBar = build::linkage(rig)?;
    let hand = build::hand::<2>(scene, seed)?;
    let start = TipPoint::new(scene.hand.start_m[0].get(), scene.hand.start_m[1].get());
    let angles = linkage.inverse(start)?;
    let model = model(scene)?;
    let body = match model.tracking {
        config::Tracking::Rigid => {
            let mass: MassModel = build::plant_mass(rig);
            let arm = &rig.plant.arm;
            Body::Arm(Arm::new(
                &ArmParameters {
                    linkage,
                    mass,
                    handle_kg: hand.mass_kg(),
                    coulomb_n_m: arm.coulomb_n_m.map(|value| value.get()),
                    viscous_n_m_s_per_rad: arm.viscous_n_m_s_per_rad.map(|value| value.get()),
                    joint_elasticity: model.joint_elasticity.as_ref().map(|elasticity| JointElasticity {
                        stiffness_n_m_per_rad: elasticity.stiffness_n_m_per_rad.get(),
                        damping_n_m_s_per_rad: elasticity.damping_n_m_s_per_rad.get(),
                        motor_share: elasticity.motor_share.get(),
                    }),
                },
                angles,
            )?)
        }
        config::Tracking::Ideal => {
            if build::command_mode(rig) != CommandMode::Position {
                let message = "model.tracking ideal needs command_mode position: a torque has no place to go to";
                return Err(RigError::Mismatch(message.into()));
            }
            Body::Ideal(Ideal {
                linkage,
                angles,
                tip: start,
                velocity: TipVelocity::default(),
                acceleration: Vector2::zeros(),
                time_s: 0.0,
            })
        }
    };
    let (calibration, mounting) = build::calibration(rig)?;
    Ok(World {
        body,
        hand,
        calibration,
        mounting,
        noise_counts: match model.force_sensor {
            config::ForceSensorModel::Noisy => model.force_noise_counts.get(),
            config::ForceSensorModel::Quantised => 0.0,
        },
        noise: World::noise_from(seed),
        longest_step_s: f64::from(model.plant_step_us) * 1e-6,
        torques: JointTorques::default(),
        hand_from_s: f64::INFINITY,
        truth: Truth::default(),
    })
}
