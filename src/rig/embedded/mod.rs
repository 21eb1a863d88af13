//! The whole rig in one process, in virtual time.

use std::panic::resume_unwind;
use std::time::Duration;

mod boot;
#[cfg(test)]
mod brake_tests;
mod buses;
mod cable;
mod commission;
#[cfg(test)]
mod commission_tests;
mod computer;
#[cfg(test)]
mod force_age_tests;
#[cfg(test)]
mod home_tests;
mod injectable;
mod injecting;
#[cfg(test)]
mod jog_tests;
mod probe;
mod simulation;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tune_loop_tests;

pub use probe::{BodyTruth, PORTS};

use super::error::RigError;
use super::far_end::{DEVICES, FarEnd};
use super::silence::Silence;
use super::world::Body;
use cable::Cable;
use computer::Injected;
use injectable::InjectableBuses;
use simulation::Simulation;
use yieldwall_bus::Master;
use yieldwall_config as config;
use yieldwall_config::injection::Injection;
use yieldwall_drives::cia402;
use yieldwall_drives::watchdog::Watchdog;
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::cycle::Outputs;
use yieldwall_motion::guard::{Cause, Request, State};
use yieldwall_motion::quantity::TipPoint;
use yieldwall_record::{CycleRecord, Moment, Row, Stages};
use yieldwall_run::assembly;
use yieldwall_run::{
    Ask, BootWatch, DriveError, Enabling, ErrorWatch, Observer, Pace, Permit, Place, RunError, Runner, Tap, Watch,
};
use yieldwall_sim::arm::Arm;
use yieldwall_sim::can::{BusCounters, Tamper};
use yieldwall_sim::hand::{Hand, PathPoint};
use yieldwall_sim::{Drive, ForceSensor};

/// Master, virtual buses, simulated devices, arm and hand.
///
/// [`EmbeddedRig::new`] assembles them, [`EmbeddedRig::enable`] boots the network and enables the drives, and every
/// [`EmbeddedRig::run_cycle`] is one period of the rig. Equal configurations and seeds give equal frames.
///
/// ```
/// use yieldwall_config as config;
/// use yieldwall_motion::guard::{Request, State};
/// use yieldwall_rig::EmbeddedRig;
///
/// let rig = config::load_rig(config::Source::named("builtin:paper-admittance.yaml"))?;
/// let scene = rig.scene()?.value;
/// let mut machine = EmbeddedRig::new(&rig.value, &scene, &rig.value.fixture, scene.seed)?;
/// machine.enable()?;
/// let start_m = machine.run_cycle(Request::None)?.tool_m;
/// // The hand of the scene leads the tool for a second.
/// for _ in 0..1000 {
///     machine.run_cycle(Request::None)?;
/// }
/// assert_ne!(machine.run_cycle(Request::None)?.tool_m, start_m);
/// assert_eq!(machine.state(), State::Running);
/// machine.stop()?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct EmbeddedRig {
    runner: Runner<Simulation>,
    /// Time from one sample of the force sensor to the next.
    sample_period: Duration,
    compute_at: Duration,
    enabling: Enabling,
    /// Permit of the last boot.
    permit: Permit,
}

impl EmbeddedRig {
    /// Creates a rig that is switched off, with its arm where the scene's hand starts.
    ///
    /// `fixture` replaces the rig's own, `seed` the scene's.
    ///
    /// # Errors
    /// If parts of the configuration do not fit together.
    pub fn new(
        rig: &config::Rig,
        scene: &config::Scene,
        fixture: &config::Fixture,
        seed: u64,
    ) -> Result<Self, RigError> {
        let period = Duration::from_micros(rig.cycle.period_us.into());
        let far = FarEnd::new(rig, scene, seed, ([true; DEVICES], Pace::Free))?;
        let cable = assembly::segment_bus(rig)?.map(|bus| (bus, Cable::new(seed)));
        if cable.is_some() && matches!(far.world.body, Body::Ideal(_)) {
            return Err(RigError::IdealOnEthercat);
        }
        let place =
            Simulation::new(InjectableBuses::new(rig, seed)?, cable, far, (period, assembly::sampled_before(rig)));
        let runner = Runner::in_virtual_time(rig, fixture, place).map_err(|error| match error {
            RunError::Assembly(error) => error.into(),
            other => RigError::Run(other),
        })?;
        let permit = Permit::in_virtual_time(&runner);
        let mut machine = Self {
            runner,
            sample_period: assembly::sample_period(rig),
            compute_at: Duration::from_micros(rig.cycle.compute_at_us.into()),
            enabling: Enabling::new(rig),
            permit,
        };
        for fault in &scene.faults {
            machine.inject(fault.injection()?)?;
        }
        Ok(machine)
    }

    fn place(&self) -> &Simulation {
        self.runner.place()
    }

    fn place_mut(&mut self) -> &mut Simulation {
        self.runner.place_mut()
    }

    fn drives_mut(&mut self) -> impl Iterator<Item = &mut Drive> {
        self.place_mut().far.drives.iter_mut().flatten().map(|drive| &mut drive.drive)
    }

    /// Adds an injection. It acts from the first cycle at or after its start to the last one before its end; what is
    /// there from switching on acts at once.
    ///
    /// # Errors
    /// If it is not possible, on this rig or at all.
    pub fn inject(&mut self, injection: Injection) -> Result<(), RigError> {
        self.place_mut().inject(injection)
    }

    /// Ends all injections and has these follow.
    ///
    /// # Errors
    /// As [`EmbeddedRig::inject`].
    pub fn set_injections(&mut self, injections: &[Injection]) -> Result<(), RigError> {
        self.place_mut().set_injections(injections)
    }

    /// Takes a watch off the drives on CAN, as [`Drive::ignore`].
    pub fn ignore(&mut self, watchdog: Watchdog) {
        self.drives_mut().for_each(|drive| drive.ignore(watchdog));
    }

    /// Sets the time that the drives on CAN take from a reset to their boot-up message.
    pub fn set_reset_time(&mut self, time: Duration) {
        self.drives_mut().for_each(|drive| drive.set_reset_time(time));
    }

    /// Sets the time that both drives take to answer a request for an object.
    pub fn set_sdo_time(&mut self, time: Duration) {
        self.drives_mut().for_each(|drive| drive.set_sdo_time(time));
        self.place_mut().far.line.iter_mut().for_each(|line| line.set_mailbox_time(time));
    }

    /// Makes the force sensor take its next sample at this time after the next SYNC is due, or on a segment the next SYNC0. It
    /// takes the others by an exact clock, so that the phase between both is known. It has no effect if SYNC is the sensor's clock.
    pub fn align_sensor(&mut self, after_sync: Duration) {
        let period = self.sample_period;
        let place = self.place();
        let next = place.next_sample(self.next_sync()) + after_sync;
        let far = &mut self.place_mut().far;
        far.sensor.iter_mut().for_each(|sensor| sensor.sensor.set_clock(next, period));
        far.line.iter_mut().for_each(|line| line.align_sensor(next, period));
    }

    /// Stops the drift of all device clocks on EtherCAT from now on.
    pub fn stop_drift(&mut self) {
        let Simulation { now, far, .. } = self.place_mut();
        far.line.iter_mut().for_each(|line| line.stop_drift(*now));
    }

    /// Takes the drives on a segment from OP to SAFE-OP.
    pub(super) fn leave_op(&mut self) {
        let Simulation { now, far, .. } = self.place_mut();
        far.line.iter_mut().for_each(|line| line.leave_op(*now));
    }

    /// Forgets what was injected and what the scene would.
    pub(super) fn clear_injections(&mut self) {
        self.place_mut().clear_injections();
    }

    /// Returns the filter by which a drill keeps frames from the devices.
    pub(super) fn silence_mut(&mut self) -> &mut Option<Silence> {
        &mut self.place_mut().silence
    }

    /// Installs these closures from now on.
    pub fn set_watch(&mut self, Watch { tap, observer, boot, errors }: Watch) {
        tap.into_iter().for_each(|tap| self.set_tap(tap));
        observer.into_iter().for_each(|observer| self.set_observer(observer));
        boot.into_iter().for_each(|boot| self.set_boot_watch(boot));
        errors.into_iter().for_each(|errors| self.set_error_watch(errors));
    }

    /// Passes every frame to `tap` from now on.
    pub fn set_tap(&mut self, tap: Tap) {
        self.place_mut().tap = Some(tap);
    }

    /// Passes the record of every cycle to `observer` from now on, including cycles of enabling and stopping.
    pub fn set_observer(&mut self, observer: Observer) {
        self.runner.set_observer(observer);
    }

    /// Takes the hand off the path of its scene: from now on it holds the tool and aims so, or has let go of it.
    pub fn move_hand(&mut self, aim: Option<PathPoint<2>>) {
        let Simulation { now, far, .. } = self.place_mut();
        far.world.move_hand(*now, aim);
    }

    /// Sets the stiffness of the hand, N/m.
    ///
    /// # Errors
    /// For a number that is negative or not finite.
    pub fn set_hand_stiffness(&mut self, stiffness_n_per_m: f64) -> Result<(), RigError> {
        Ok(self.place_mut().far.world.hand.set_stiffness(stiffness_n_per_m)?)
    }

    /// Returns the place of the tool in the base frame.
    pub fn tool(&self) -> TipPoint {
        self.place().far.world.truth.tip
    }

    /// Reports every boot to `watch` from now on.
    pub fn set_boot_watch(&mut self, watch: BootWatch) {
        self.runner.set_boot_watch(watch);
    }

    /// Passes each drive's report on a fault to `watch`, from now on.
    pub fn set_error_watch(&mut self, watch: ErrorWatch) {
        self.runner.set_error_watch(watch);
    }

    /// Goes on asking both drives what is wrong with them, as [`Runner::ask_for_errors`].
    pub fn ask_for_errors(&mut self) {
        self.runner.ask_for_errors();
    }

    /// Returns the reports of the drives that were asked.
    pub fn errors(&self) -> impl Iterator<Item = DriveError> {
        self.runner.errors()
    }

    /// Passes every frame through `tamper` from now on.
    pub fn set_tamper(&mut self, tamper: impl Tamper + Send + 'static) {
        self.place_mut().wires.buses.set_tamper(tamper);
    }

    /// Returns the state of the supervisor; [`State::Lost`] if an injection killed its process, since the drives' watchdogs act.
    pub fn state(&self) -> State {
        self.runner.state()
    }

    /// Returns the fault that caused the present state.
    pub fn cause(&self) -> Option<Cause> {
        self.runner.cause()
    }

    /// Returns the master, for reports.
    pub fn master(&self) -> &Master {
        self.runner.master()
    }

    /// Returns the simulated drives on CAN, the left one first, for reports.
    pub fn drives(&self) -> Vec<&Drive> {
        self.place().far.drives.iter().flatten().map(|drive| &drive.drive).collect()
    }

    /// States of the drives, left and right.
    pub fn drive_states(&self) -> [cia402::State; 2] {
        self.place().far.drive_states()
    }

    /// Torques in N m that the drives mean to make, left and right.
    pub fn drive_torques_n_m(&self) -> [f64; 2] {
        self.place().drive_torques_n_m()
    }

    /// Returns the force sensor, if it is on CAN.
    pub fn force_sensor(&self) -> Option<&ForceSensor> {
        self.place().far.sensor.as_ref().map(|sensor| &sensor.sensor)
    }

    /// Returns the arm; `None` if the joints follow their targets without one.
    pub fn arm(&self) -> Option<&Arm> {
        match &self.place().far.world.body {
            Body::Arm(arm) => Some(arm),
            Body::Ideal(_) => None,
        }
    }

    /// Returns the hand.
    pub fn hand(&self) -> &Hand<2> {
        &self.place().far.world.hand
    }

    /// Returns the counters of each bus so far, in the order of the bus names; their sum is that of the rig.
    pub fn bus_counters(&self) -> impl Iterator<Item = &BusCounters> {
        let Simulation { wires, cable, .. } = self.place();
        let of_segment = cable.as_ref().map(|(_, cable)| cable.counters());
        wires.buses.counters().filter_map(move |of_can| of_can.or(of_segment))
    }

    /// Returns the virtual time since switching on.
    pub fn now(&self) -> Time {
        self.place().now
    }

    /// Returns the time of the next cycle since the scene began, in s; minus infinity before the scene.
    pub fn scene_time_s(&self) -> f64 {
        self.scene_time_at(self.next_sync())
    }

    fn scene_time_at(&self, grid: Time) -> f64 {
        self.place().sampled_for(grid).as_secs_f64() - self.place().far.world.hand_from_s
    }

    /// Returns the time at which the next cycle begins.
    pub fn next_sync(&self) -> Time {
        self.runner.next_sync()
    }

    /// Returns the outputs of the last cycle.
    pub fn last_outputs(&self) -> Option<&Outputs> {
        self.runner.last_outputs()
    }

    /// Runs one period: SYNC, process data, the cycle, set-points.
    ///
    /// While an injection keeps the process from running, the row is the last cycle's at the present truth, and no observer is
    /// called.
    ///
    /// # Errors
    /// If the simulated arm cannot go on.
    pub fn run_cycle(&mut self, request: Request) -> Result<Row, RigError> {
        let grid = self.next_sync();
        if grid == Time::NEVER {
            return Err(RigError::NotEnabled {
                waited_s: 0.0,
                state: "the network was not booted".to_owned(),
                cause: None,
            });
        }
        let record = self.runner.run_cycle(match request {
            Request::None => Ask::Nothing,
            Request::Enable => Ask::Enable(&self.permit),
            Request::Stop => Ask::Stop,
            Request::Reset => Ask::Reset,
        });
        self.go_on()?;
        record.map_or_else(|| self.idle_row(grid), |record| Ok(record.row()))
    }

    /// Fails if the simulation cannot go on, and panics as the cycle has, unless an injection caused that panic.
    fn go_on(&mut self) -> Result<(), RigError> {
        if let Some(error) = self.place_mut().failure.take() {
            return Err(error);
        }
        match self.runner.take_panic() {
            Some(panic) if !panic.is::<Injected>() => resume_unwind(panic),
            _ => Ok(()),
        }
    }

    /// Returns the row of a period without a cycle.
    fn idle_row(&self, grid: Time) -> Result<Row, RigError> {
        let state = "the process does not run".to_owned();
        let outputs = self.last_outputs().ok_or(RigError::NotEnabled { waited_s: 0.0, state, cause: None })?;
        let moment = Moment {
            index: 0,
            sync_ns: grid.0,
            compute_ns: (grid + self.compute_at).0,
            scene_time_s: self.scene_time_at(grid),
            stages: Stages::default(),
            standstill: None,
        };
        let truth = self.place().truth();
        Ok(CycleRecord::new(moment, self.master().last_inputs(), outputs, self.cause(), truth).row())
    }
}
