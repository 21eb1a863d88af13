//! All that is known of one control cycle.

use std::time::Duration;

use super::Row;
use yieldwall_motion::cycle::{Inputs, Outputs, Signals};
use yieldwall_motion::guard::{Cause, Directive, Fault, JointCommand, State};
use yieldwall_motion::quantity::{JointTorques, TipPoint, TipVelocity};

/// Number of a cycle, and its planned time. Times are those of the cycle's own clock: virtual in a simulation. The cycle's lateness, and
/// the duration of the cycle before, are in [`Inputs::timing`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moment {
    /// Number of the cycle, from 0 at the first one after the boot.
    pub index: u64,
    /// Planned moment of SYNC in ns since switching on.
    pub sync_ns: u64,
    /// Planned begin of the computation in ns since switching on.
    pub compute_ns: u64,
    /// Moment of SYNC in s since the scene began; minus infinity before.
    pub scene_time_s: f64,
    /// End times of its stages.
    pub stages: Stages,
    /// The last standstill of the computer, if it was not long ago. Not recorded.
    pub standstill: Option<Standstill>,
}

/// A time in which the loop was due and the computer did not let it run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Standstill {
    /// Its length.
    pub lasted: Duration,
    /// Time since its end.
    pub ago: Duration,
}

/// When the stages of a cycle were over, beside those that the cycle itself has to know
/// ([`Timing`](yieldwall_motion::cycle::Timing)): in their order
///
/// ```text
/// grid point         sync_woke_ns    frames taken, SYNC leaves: sync_late_ns
/// planned compute    woke_ns         frames taken, decoding begins: compute_late_ns    stepped_ns    sent_ns
/// ```
/// Each in ns after the moment in front of its line; zero in lockstep, whose clock stands still meanwhile.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stages {
    /// The loop woke up for SYNC.
    pub sync_woke_ns: u32,
    /// The loop woke up for the computation.
    pub woke_ns: u32,
    /// Frames were decoded, and the cycle was stepped.
    pub stepped_ns: u32,
    /// Set-points were handed to the interface.
    pub sent_ns: u32,
}

/// State of the simulated machine that no device reports.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// Tool point.
    pub tool: TipPoint,
    /// Velocity of the tool.
    pub velocity: TipVelocity,
    /// Torques of the drives.
    pub torques: JointTorques,
}

/// Inputs and outputs of one cycle.
///
/// The record has a fixed size and uses no heap memory: a cycle may write it into memory set aside before. The command is a copy of the one
/// that the gate let through; nothing can be sent from it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CycleRecord {
    /// Number and time of the cycle.
    pub moment: Moment,
    /// Inputs of the cycle.
    pub inputs: Inputs,
    /// Command to the joints.
    pub command: JointCommand,
    /// Decision of the supervisor.
    pub directive: Directive,
    /// The fault that led to the supervisor's state, if one did, and the devices that it concerns.
    pub cause: Option<Cause>,
    /// Intermediate results of the stages.
    pub signals: Signals,
    /// The truth of a simulation.
    pub truth: Option<Truth>,
}

impl CycleRecord {
    /// Returns the record of a cycle that took `inputs` and gave `outputs`.
    ///
    /// Real-time: yes.
    pub fn new(moment: Moment, inputs: &Inputs, outputs: &Outputs, cause: Option<Cause>, truth: Option<Truth>) -> Self {
        let Outputs { command, directive, signals, .. } = *outputs;
        Self { moment, inputs: *inputs, command: *command.get(), directive, cause, signals, truth }
    }

    /// Returns the row that figures and measures read. Without a simulation the tool is the measured one, its velocity is zero, and torques
    /// are known in torque mode only.
    ///
    /// Real-time: yes.
    pub fn row(&self) -> Row {
        let signals = &self.signals;
        let truth = self.truth.unwrap_or(Truth { tool: signals.tool, ..Truth::default() });
        let planar = |[x, y]: [f64; 2]| [x, y, 0.0];
        Row {
            time_s: self.moment.scene_time_s,
            tool_m: planar(truth.tool.to_array()),
            proxy_m: planar(signals.proxy.to_array()),
            tool_velocity_m_per_s: planar(truth.velocity.to_array()),
            force_n: planar(signals.force.to_array()),
            force_age_s: signals.force_age_s,
            torques_n_m: match self.command {
                JointCommand::Torque(torques) => torques.to_array(),
                _ => truth.torques.to_array(),
            },
            target_angles_rad: signals.target_angles.to_array(),
            measured_angles_rad: signals.measured_angles.to_array(),
            surface_m: planar(signals.surface.to_array()),
            signed_distance_m: signals.signed_distance_m,
            is_on_surface: signals.is_on_surface,
            hold_counter: signals.hold_counter,
            is_impact: signals.is_impact,
            supervisor_state: self.directive.state as u8,
            // The rest is for those who know the surfaces.
            ..Row::default()
        }
    }
}

/// Returns how much a fault has taken from the person: 0 nothing, 1 the motion for now, 2 the rig until a reset.
///
/// Real-time: yes.
pub fn fault_severity(state: State, cause: Option<Cause>) -> u8 {
    match (cause, state) {
        (None, _) | (Some(Cause { fault: Fault::StopRequested, .. }), _) => 0,
        (_, State::Idle | State::Enabling | State::Running) => 0,
        (_, State::Holding) => 1,
        (_, State::Stopping | State::Stopped | State::Disabled | State::Lost) => 2,
    }
}
