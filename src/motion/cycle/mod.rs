//! The real-time step: the only place that names all stages of the signal path.
//!
//! [`Cycle::step`] takes what the bus brought in one period and gives what the bus shall carry in the next. It is pure:
//! time is the fixed period, and nothing in it allocates, locks, logs or panics.

mod lead;
mod monitor;
mod reference;
mod servo;
mod watch;

use crate::fixture::{EXCESS_FORGETTING_S, Excess, Fixture, Shape2};
use crate::guard::{
    Allowed, Cause, DeviceSet, Directive, Fault, FaultCounts, Gate, JointCommand, JointRest, Measured, Motion,
    Reaction, Request, State, StopRamp, Supervisor,
};
use crate::linkage::{FiveBar, Posture};
use crate::quantity::{Force, JointAngles, JointTorques, TipDisplacement, TipPoint};
use crate::sensing::{RawSample, Reading, Sensing, SensingError, TareParameters, Wrench};
use lead::Lead;
use reference::Track;
use watch::{Balance, Chatter};
use yieldwall_drives::cia402;

pub use lead::LeadLimits;
pub use reference::Reference;
pub use servo::{Deviation, Servo, TorqueServo, TorqueServoParameters, TorqueStep};

/// Report of one drive in this cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveSample {
    /// Angle of the proximal link in rad; `None` if no process data arrived.
    pub angle_rad: Option<f64>,
    /// State of the drive, the last known one if no process data arrived.
    pub state: cia402::State,
    /// Whether the drive follows its command value (status word bit 12).
    pub follows_command: bool,
    /// Whether the power stage has voltage (status word bit 4).
    pub has_voltage: bool,
    /// Whether the drive warns (status word bit 7).
    pub has_warning: bool,
}

/// Events on the bus since the last cycle, with their devices.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkEvents {
    /// A process data frame had the wrong length.
    pub bad_length: DeviceSet,
    /// A process data frame came twice.
    pub duplicated: DeviceSet,
    /// A process data frame came after the cycle it belongs to.
    pub late: DeviceSet,
    /// A node announced its start.
    pub node_reset: DeviceSet,
    /// A heartbeat is missing, or a node left Operational.
    pub heartbeat_lost: DeviceSet,
    /// Two devices answer to one node id.
    pub duplicate_node: DeviceSet,
    /// An emergency message arrived.
    pub emergency: DeviceSet,
    /// An emergency message that is a warning arrived.
    pub emergency_warning: DeviceSet,
    /// Another participant sent NMT commands, SYNC or set-points, or has written to a node by SDO.
    pub intruder: bool,
    /// The interfaces that the frames of the last cycle have not left yet.
    pub transmit_stalled: DeviceSet,
    /// The interfaces that are error-passive.
    pub error_passive: DeviceSet,
    /// The interfaces that are bus-off.
    pub bus_off: DeviceSet,
    /// The interfaces over which own frames could not be sent, or that are down.
    pub send_failed: DeviceSet,
    /// The drives that did not take the outputs of the cycle before. CAN does not report this.
    pub outputs_missed: DeviceSet,
    /// The devices of a segment that left OP.
    pub device_state: DeviceSet,
    /// The devices whose clocks are not with the grid of the cycles.
    pub clock_lost: DeviceSet,
    /// The devices of which a port counts errors, and those behind a port without a link.
    pub port_errors: DeviceSet,
}

impl std::ops::BitOr for LinkEvents {
    type Output = Self;

    /// Returns the events of both networks.
    fn bitor(self, other: Self) -> Self {
        Self {
            bad_length: self.bad_length | other.bad_length,
            duplicated: self.duplicated | other.duplicated,
            late: self.late | other.late,
            node_reset: self.node_reset | other.node_reset,
            heartbeat_lost: self.heartbeat_lost | other.heartbeat_lost,
            duplicate_node: self.duplicate_node | other.duplicate_node,
            emergency: self.emergency | other.emergency,
            emergency_warning: self.emergency_warning | other.emergency_warning,
            intruder: self.intruder | other.intruder,
            transmit_stalled: self.transmit_stalled | other.transmit_stalled,
            error_passive: self.error_passive | other.error_passive,
            bus_off: self.bus_off | other.bus_off,
            send_failed: self.send_failed | other.send_failed,
            outputs_missed: self.outputs_missed | other.outputs_missed,
            device_state: self.device_state | other.device_state,
            clock_lost: self.clock_lost | other.clock_lost,
            port_errors: self.port_errors | other.port_errors,
        }
    }
}

/// Time of the cycle, relative to its grid. All zero for a cycle in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timing {
    /// Time from the grid point to the moment at which SYNC was sent, ns.
    pub sync_late_ns: u32,
    /// Time from the planned moment of the computation to its begin, ns.
    pub compute_late_ns: u32,
    /// Duration of the computation of the cycle before until its frames were handed over, ns.
    pub last_compute_ns: u32,
    /// Grid points that passed without a cycle since the last one.
    pub skipped: u32,
    /// Whether the computer was suspended since the last cycle.
    pub suspended: bool,
}

/// Everything that enters one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inputs {
    /// The two drives, left and right.
    pub drives: [DriveSample; 2],
    /// A new force sample, if one arrived.
    pub sample: Option<RawSample>,
    /// Events on the bus.
    pub link: LinkEvents,
    /// Timing of this cycle.
    pub timing: Timing,
    /// Request of the person.
    pub request: Request,
}

/// Everything that leaves one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outputs {
    /// Command to the joints.
    pub command: Allowed<JointCommand>,
    /// Decision of the supervisor.
    pub directive: Directive,
    /// Whether brakes that the master holds are released; of a drive that is in Operation Enabled alone.
    pub releases_brakes: bool,
    /// Intermediate results of the stages, for the record.
    pub signals: Signals,
}

/// The signals of one cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Signals {
    /// Force of the hand on the tool as sensed.
    pub force: Force,
    /// Age of the sample that the force comes from, in s, from its arrival.
    pub force_age_s: f64,
    /// Tool point by the measured angles.
    pub tool: TipPoint,
    /// Proxy, or the measured tool point while there is no reference.
    pub proxy: TipPoint,
    /// Displacement of the fixture's surfaces from their place.
    pub surface: TipDisplacement,
    /// Angles that the proxy asks for.
    pub target_angles: JointAngles,
    /// Measured angles.
    pub measured_angles: JointAngles,
    /// Signed distance of `proxy` from the surface in m, negative on the forbidden side.
    pub signed_distance_m: f64,
    /// Whether the fixture keeps the proxy on the surface.
    pub is_on_surface: bool,
    /// Steps for which the proxy is still held.
    pub hold_counter: u32,
    /// Whether the proxy met the surface in this cycle.
    pub is_impact: bool,
    /// Whether a torque was cut to its limit; the proxy is then drawn back.
    pub is_saturated: bool,
}

/// Settings of the cycle besides its stages.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Cycle time in s, positive.
    pub period_s: f64,
    /// Least distance of the arm to a singularity or to the workspace edge, in m.
    pub singularity_margin_m: f64,
    /// Greatest speed of the reference in m/s.
    pub tool_speed_limit_m_per_s: f64,
    /// Greatest rate of a joint in rad/s; a faster encoder has jumped.
    pub joint_speed_limit_rad_per_s: f64,
    /// Greatest sensed force in N.
    pub force_limit_n: f64,
    /// Greatest distance of a joint from its command in rad.
    pub following_error_limit_rad: f64,
    /// Greatest deceleration of the stop ramp in m/s^2.
    pub stop_deceleration_m_per_s2: f64,
    /// Greatest mean torque of a joint in N m that force and motion do not account for; `None` for no watch.
    pub residual_limit_n_m: Option<f64>,
    /// Greatest energy in J that the rig may give the hand in one go beyond what it held and what its surfaces brought.
    pub energy_limit_j: f64,
    /// Longest time in s from the request to Operation Enabled, of the left and of the right drive.
    pub enabling_limit_s: [f64; 2],
    /// Longest time in s that a computation may take.
    pub compute_budget_s: f64,
    /// Closing time of the brakes that the master controls, s: torque stays on meanwhile. 0 without brakes.
    pub brake_s: f64,
}

/// The stages of one rig, and what they remember between cycles.
#[derive(Clone, Debug)]
pub struct Cycle {
    settings: Settings,
    linkage: FiveBar,
    sensing: Sensing,
    fixture: Fixture<Shape2, 2>,
    servo: Servo,
    gate: Gate,
    supervisor: Supervisor,
    faults: FaultCounts,
    measured: Measured,
    posture: Option<Posture>,
    /// Distance of `posture` from the nearest singularity in m; not a number without a posture.
    clearance_m: f64,
    missed: [u16; 2],
    /// Whether each drive reported Operation Enabled in the last cycle.
    were_enabled: [bool; 2],
    track: Track,
    halt: Option<StopRamp>,
    /// In place of the fixture.
    lead: Option<Lead>,
    /// Whether the drives move the joints without the master.
    homes: bool,
    /// Joints that are pushed and do not move, while they are guided or their drives move them.
    blocked: DeviceSet,
    /// Torques that the reference's motion needs; known in torque mode alone.
    needed: Option<JointTorques>,
    enabling_cycles: u32,
    /// Cycles for which the brakes of a rig that is stopped have been closed.
    braked_cycles: u32,
    /// Rest of the joints in a latched state.
    joint_rest: JointRest,
    excess: Excess<2>,
    /// Work of the fixture on the proxy in its last step, beyond what its spring lost, J.
    brought_j: f64,
    chatter: Chatter,
    balance: Balance,
}

impl Cycle {
    /// Creates a rig at rest: nothing measured yet, drives not enabled.
    pub fn new(
        settings: Settings,
        linkage: FiveBar,
        sensing: Sensing,
        fixture: Fixture<Shape2, 2>,
        servo: Servo,
        gate: Gate,
    ) -> Self {
        let period_s = settings.period_s;
        let mass_kg = fixture.stiffness_n_per_m() * period_s * period_s;
        Self {
            settings,
            linkage,
            sensing,
            fixture,
            servo,
            gate,
            supervisor: Supervisor::new(),
            faults: FaultCounts::default(),
            measured: Measured::default(),
            posture: None,
            clearance_m: f64::NAN,
            missed: [u16::MAX; 2],
            were_enabled: [false; 2],
            track: Track::default(),
            halt: None,
            lead: None,
            homes: false,
            blocked: DeviceSet::default(),
            needed: None,
            enabling_cycles: 0,
            braked_cycles: 0,
            joint_rest: JointRest::default(),
            excess: Excess::new(period_s, mass_kg, EXCESS_FORGETTING_S),
            brought_j: 0.0,
            chatter: Chatter::default(),
            balance: Balance::default(),
        }
    }

    /// Starts again as a rig at rest that has measured nothing yet, with its own limit of torque; what was tared stays.
    pub fn restart(&mut self) {
        self.gate.restore_torque();
        if let Servo::Torque(servo) = &mut self.servo {
            servo.restore_torque();
        }
        self.sensing.restart();
        self.supervisor = Supervisor::new();
        self.faults = FaultCounts::default();
        (self.measured, self.posture, self.clearance_m) = (Measured::default(), None, f64::NAN);
        (self.missed, self.were_enabled) = ([u16::MAX; 2], [false; 2]);
        (self.track, self.halt, self.needed, self.enabling_cycles) = (Track::default(), None, None, 0);
        self.lead.iter_mut().for_each(Lead::forget);
        self.excess.restart();
        (self.brought_j, self.chatter, self.balance) = Default::default();
    }

    /// Guides the joints from now on, in place of the fixture: no force moves the reference. `None` returns the reference to the fixture.
    /// Call this while the rig idles; while it has a reference nothing changes. When the rig starts to run, its joints rest where they are,
    /// until [`Cycle::lead_to`]. A fault that would stop the rig along a ramp takes its torque off.
    pub fn lead(&mut self, limits: Option<LeadLimits>) {
        if self.track.now().is_none() {
            (self.lead, self.blocked) = (limits.map(Lead::new), DeviceSet::default());
        }
    }

    /// Lets the drives move the joints by themselves from now on: there is no reference, and the command is the one that moves nothing. Any
    /// fault that would hold or stop the rig is a quick stop of both drives. Call this while the rig idles.
    pub fn home(&mut self, homes: bool) {
        if self.track.now().is_none() {
            (self.homes, self.blocked) = (homes, DeviceSet::default());
        }
    }

    /// Takes the torque off the joints, because one of them, 0 the left one, is pushed and does not move: a following error. The joint is
    /// guided, or its drive moves it by itself. A ramp by an encoder that stands still would go on pushing.
    ///
    /// Real-time: yes.
    pub fn report_blocked(&mut self, joint: usize) {
        self.blocked = DeviceSet::drives_where([0, 1].map(|one| (self.homes || self.lead.is_some()) && one == joint));
    }

    /// Leads the joints of a rig that runs to these angles, within its limits. Targets that are not finite are passed over.
    ///
    /// Real-time: yes.
    pub fn lead_to(&mut self, targets: JointAngles) {
        self.lead.iter_mut().for_each(|lead| lead.lead_to(targets));
    }

    /// Starts a tare of the force sensor over the samples to come, as [`Sensing::start_tare`]. To be called while the rig idles; the force is
    /// zero and not valid meanwhile.
    ///
    /// # Errors
    /// As [`Sensing::start_tare`].
    pub fn start_tare(&mut self, parameters: TareParameters) -> Result<(), SensingError> {
        self.sensing.start_tare(parameters)
    }

    /// Takes a wrench for the zero of the force sensor, as [`Sensing::set_bias`].
    pub fn set_bias(&mut self, bias: Wrench) {
        self.sensing.set_bias(bias);
    }

    /// Whether the reference rests at the targets of the joints.
    ///
    /// Real-time: yes.
    pub fn is_there(&self) -> bool {
        self.lead.zip(self.track.now()).is_some_and(|(lead, reference)| lead.is_there(reference.angles()))
    }

    /// Lowers the greatest torque of each joint, in N m, until [`Cycle::restart`]. It is not raised before.
    pub fn lower_torque(&mut self, torque_n_m: f64) {
        self.gate.lower_torque(torque_n_m);
        if let Servo::Torque(servo) = &mut self.servo {
            servo.lower_torque(torque_n_m, &self.linkage);
        }
    }

    /// Returns the free share of the joints' way to `targets`, 0 to 1. The way begins at the last measured angles, and both joints move at
    /// the same pace; the function checks it every 5 mrad. A posture is free if it keeps 1 mm from the margin, where the reference is not
    /// braked, or the clearance of the start. Returns 0 if no posture was measured.
    pub fn free_share(&self, targets: JointAngles) -> f64 {
        const STEP_RAD: f64 = 5e-3;
        const MOST_STEPS: f64 = 2000.0;
        const RESERVE_M: f64 = 1e-3;
        let Some(posture) = &self.posture else { return 0.0 };
        let least_m = self.clearance_of_m(posture).min(self.settings.singularity_margin_m + RESERVE_M);
        let (from, whole) = (self.measured.angles, targets - self.measured.angles);
        let [left, right] = whole.to_array();
        let steps = (left.abs().max(right.abs()) / STEP_RAD).ceil().clamp(1.0, MOST_STEPS);
        let is_free = |step: &u32| {
            let posture = self.linkage.forward(from + whole * (f64::from(*step) / steps));
            posture.is_ok_and(|posture| self.clearance_of_m(&posture) >= least_m)
        };
        let free = (1..=steps as u32).take_while(is_free).last();
        free.map_or(0.0, |step| f64::from(step) / steps)
    }

    /// Computes one cycle of the rig, from the received data to the data to send.
    ///
    /// Real-time: yes.
    pub fn step(&mut self, inputs: &Inputs) -> Outputs {
        self.faults.begin_cycle();
        // measure
        self.measure(inputs);
        let reading = self.sense(inputs.sample.as_ref());
        // supervise
        self.observe(inputs, &reading);
        let mut directive = self.supervise(&inputs.drives, inputs.request);
        // move the reference, command the joints, pass the gate
        let mut signals = Signals::default();
        let command = match self.act(directive.motion, &reading, &mut signals) {
            Ok(command) => command,
            Err(fault) => {
                // A fault found on the way stops all axes in this same cycle: along the ramp, from the last reference
                // that could be followed, or at once.
                self.faults.observe(fault, true);
                directive = self.supervise(&inputs.drives, Request::None);
                self.act(directive.motion, &reading, &mut signals).unwrap_or_else(|fault| {
                    // A position to rest at would be a leap for drives that still move.
                    let devices = self.faults.devices(fault);
                    directive = self.supervisor.stop_at_once(Cause { fault, devices });
                    self.rest()
                })
            }
        };
        self.weigh(&reading, &command);
        self.note(&reading, &mut signals);
        let releases_brakes = match directive.state {
            State::Running | State::Holding => true,
            State::Stopping => self.braked_cycles == 0,
            _ => false,
        };
        Outputs { command, directive, releases_brakes, signals }
    }

    /// Returns the outputs before the first cycle: nothing moves.
    pub fn idle(&self) -> Outputs {
        let command = Allowed::rest(&self.servo.rest(), JointAngles::default());
        Outputs { command, directive: Directive::IDLE, releases_brakes: false, signals: Signals::default() }
    }

    /// Returns the state of the supervisor.
    pub fn state(&self) -> State {
        self.supervisor.state()
    }

    /// Returns the fault that led to the present state.
    pub fn cause(&self) -> Option<Cause> {
        self.supervisor.cause()
    }

    /// Returns the observations of every fault, for reports.
    pub fn faults(&self) -> &FaultCounts {
        &self.faults
    }

    /// Returns the fixture, for reports.
    pub fn fixture(&self) -> &Fixture<Shape2, 2> {
        &self.fixture
    }

    /// Returns the linkage, for reports.
    pub fn linkage(&self) -> &FiveBar {
        &self.linkage
    }

    /// Returns the force sensing, for reports.
    pub fn sensing(&self) -> &Sensing {
        &self.sensing
    }

    /// Returns the control laws, for reports.
    pub fn servo(&self) -> &Servo {
        &self.servo
    }

    /// Its settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Returns the gate, for reports.
    pub fn gate(&self) -> &Gate {
        &self.gate
    }

    fn sense(&mut self, sample: Option<&RawSample>) -> Reading {
        let distal = self.posture.as_ref().map(|posture| posture.distal_rotation).unwrap_or_default();
        let link = self.sensing.mounting().link_rotation(distal);
        let acceleration = self.track.now().map(|reference| reference.acceleration).unwrap_or_default();
        self.sensing.step(sample, link, acceleration)
    }

    fn supervise(&mut self, drives: &[DriveSample; 2], request: Request) -> Directive {
        let is_resting = self.halt.as_ref().is_none_or(StopRamp::is_at_rest);
        // Brakes close once the reference of a rig that is stopped rests, and torque goes once they are closed.
        let is_stopped = is_resting && self.supervisor.state() == State::Stopping;
        self.braked_cycles = if is_stopped { self.braked_cycles.saturating_add(1) } else { 0 };
        let Settings { brake_s, period_s, .. } = self.settings;
        let is_measured = self.missed == [0; 2];
        let at_rest = if self.supervisor.state().is_latched() {
            self.joint_rest.step(is_measured.then_some(self.measured.angles), period_s, brake_s)
        } else {
            self.joint_rest = JointRest::default();
            is_resting && (!is_stopped || f64::from(self.braked_cycles) > (brake_s / period_s).ceil())
        };
        self.supervisor.step(&crate::guard::View {
            drives: drives.map(|drive| drive.state),
            worst: self.faults.worst().map(|(cause, reaction)| (cause, self.led_reaction(cause.fault, reaction))),
            is_measured,
            at_rest,
            request,
        })
    }

    /// Returns the reaction to a fault. The encoders of guided joints may count against the direction of their motors, since no check has
    /// shown it yet. A ramp of a loop that is closed the wrong way drives them on, so guided joints lose their torque at once. They are
    /// slow.
    fn led_reaction(&self, fault: Fault, reaction: Reaction) -> Reaction {
        match reaction {
            // The ramps of drives that home are their own, and none where the encoder may stand still.
            reaction if self.homes && fault == Fault::FollowingError => reaction.max(Reaction::TorqueOff),
            reaction if self.homes && reaction > Reaction::Count => reaction.max(Reaction::QuickStop),
            // Joints that follow are brought to rest by whom a person asks to stop.
            Reaction::StopRamp if fault == Fault::StopRequested => reaction,
            reaction if self.lead.is_some() && reaction >= Reaction::StopRamp => reaction.max(Reaction::TorqueOff),
            reaction => reaction,
        }
    }

    /// Returns the command of this cycle. The reference that goes with it is followed from now on; a fault leaves the one that there was.
    fn act(
        &mut self,
        motion: Motion,
        reading: &Reading,
        signals: &mut Signals,
    ) -> Result<Allowed<JointCommand>, Fault> {
        if motion == Motion::Rest || self.homes || self.posture.is_none() {
            return Ok(self.rest());
        }
        self.advance(motion, reading, signals)?;
        let (Some(posture), Some(reference)) = (&self.posture, self.track.next()) else {
            return Ok(self.rest());
        };
        let effort = self.servo.command(&self.linkage, reference, posture)?;
        let (allowed, cut) = self.gate.check(&effort.command, &self.measured)?;
        self.needed = effort.needed;
        signals.is_saturated = cut || effort.overreach.is_some();
        // Joints that are led go where they are led; one that is blocked is a following error.
        if let (Some(overreach), None, Motion::Run) = (effort.overreach, self.lead, motion) {
            self.draw_back(overreach)?;
        }
        self.track.follow();
        Ok(allowed)
    }

    /// Returns the command that moves nothing; forgets the reference, so that the next run starts from the measurement.
    fn rest(&mut self) -> Allowed<JointCommand> {
        self.track.forget();
        self.halt = None;
        self.lead.iter_mut().for_each(Lead::forget);
        self.needed = None;
        self.gate.rest(&self.servo.rest(), &self.measured)
    }

    /// Puts the torques of this cycle into the balance.
    fn weigh(&mut self, reading: &Reading, command: &Allowed<JointCommand>) {
        let posture = self.posture.as_ref().filter(|_| reading.is_usable());
        let hand = posture.and_then(|posture| posture.joint_torques(reading.force).ok());
        let sent = match command.get() {
            JointCommand::Torque(torques) => Some(*torques),
            _ => None,
        };
        self.balance.step(hand, self.needed, sent);
    }

    fn note(&self, reading: &Reading, signals: &mut Signals) {
        signals.force = reading.force;
        signals.force_age_s = reading.age_s;
        signals.measured_angles = self.measured.angles;
        signals.tool = self.posture.as_ref().map(|posture| posture.tip).unwrap_or_default();
        signals.proxy = self.track.now().map_or(signals.tool, |reference| reference.point);
        signals.surface = TipDisplacement(self.fixture.origin());
        signals.signed_distance_m = match signals.is_on_surface {
            // The fixture's own figure is exact there.
            true => signals.signed_distance_m,
            false => self.fixture.signed_distance_m(&signals.proxy.0),
        };
        signals.target_angles = self.track.now().map_or(self.measured.angles, Reference::angles);
    }
}

#[cfg(test)]
mod tests;
