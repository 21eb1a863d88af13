//! The shipped rig at another cycle, on CAN or EtherCAT, with drives in each mode and gains by one rule.

use super::super::drawn::{not_negative, positive, shipped};
use yieldwall_bus::{budget, ethercat};
use yieldwall_config::{self as config, CommandMode, ControlGains, SensorProtocol};
use yieldwall_motion::control::{Gains, Margins, ServoLoop, stiffest, worst_margins};
use yieldwall_rig::analysis::{
    PROPOSED_MARGINS, PoseMargins, has_margins, pose_margins, proposed_gains, proposed_rate_gain, rate_margins,
};
use yieldwall_run::assembly::{bus_plan, segment};

/// Steps in us in which the earliest moment of the computation is looked for.
const COMPUTE_STEP_US: u32 = 10;
/// Rates of the sensor on CAN in Hz, the fastest first: by SYNC at 1 kHz, by its own clock below.
const SENSOR_HZ: [f64; 3] = [1000.0, 500.0, 200.0];
/// Shortest cycle in us that is looked at.
const SHORTEST_US: u32 = 50;
/// From this cycle in us on heartbeats are this far apart, in ms.
const SLOW_US: u32 = 2000;
const SLOW_HEARTBEAT_MS: u16 = 100;

/// Medium of the process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wire {
    /// CAN at 1 Mbit/s.
    Can,
    /// EtherCAT at 100 Mbit/s.
    Ethercat,
}

impl Wire {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Can => "CAN",
            Self::Ethercat => "EtherCAT",
        }
    }
}

pub(super) const WIRES: [Wire; 2] = [Wire::Can, Wire::Ethercat];
/// Command mode of the drives, which also determines whether the drive or the program closes the joint loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mode {
    /// Torques: this program closes it.
    Torque,
    /// Velocities: the drives close that loop, this program the one around it.
    Velocity,
    /// Positions: the drives close it, as they are shipped.
    Position,
    /// Positions, with drives as stiff as the margins let them.
    StiffPosition,
}

pub(super) const MODES: [Mode; 4] = [Mode::Torque, Mode::Velocity, Mode::Position, Mode::StiffPosition];

impl Mode {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Torque => "torque",
            Self::Velocity => "velocity",
            Self::Position => "position",
            Self::StiffPosition => "position (stiff drives)",
        }
    }

    fn command(self) -> CommandMode {
        match self {
            Self::Torque => CommandMode::Torque,
            Self::Velocity => CommandMode::Velocity,
            Self::Position | Self::StiffPosition => CommandMode::Position,
        }
    }
}

/// Cycles in us.
pub(super) const PERIODS_US: [u32; 6] = [250, 500, 1000, 2000, 5000, 10_000];

/// A rig of the chart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Setting {
    pub(super) wire: Wire,
    pub(super) mode: Mode,
    pub(super) period_us: u32,
}

/// Load of a bus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Carried {
    /// Share of the time that it is busy at most, above 1 for more than it carries.
    pub(super) load: f64,
    pub(super) is_in_time: bool,
}

/// Joint loop: where it is closed, and how far it is from instability.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Loop {
    /// N m/rad in torque and position mode, 1/s in velocity mode.
    pub(super) gain: f64,
    pub(super) gain_db: f64,
    pub(super) phase_deg: f64,
}

/// A setting made into a rig.
pub(super) struct Machine {
    pub(super) rig: config::Rig,
    pub(super) scene: config::Scene,
    pub(super) carried: Carried,
    /// `None` if there are no gains.
    pub(super) servo: Option<Loop>,
}

impl Setting {
    pub(super) fn of(index: u64) -> Self {
        let index = index as usize;
        let (period, rest) = (index % PERIODS_US.len(), index / PERIODS_US.len());
        Self { wire: WIRES[rest % WIRES.len()], mode: MODES[rest / WIRES.len()], period_us: PERIODS_US[period] }
    }

    /// Returns the shortest cycle in us in which all frames are in time, and the bus load in that cycle. The search takes steps of
    /// 10 us; the result is `None` if no cycle up to 2 ms is long enough.
    ///
    /// # Errors
    /// As [`Setting::machine`].
    pub(super) fn shortest(&self) -> Result<Option<(u32, Carried)>, String> {
        for period_us in (SHORTEST_US..=SLOW_US).step_by(COMPUTE_STEP_US as usize) {
            let (mut rig, _) = Self { period_us, ..*self }.base()?;
            rig.rig.command_mode = self.mode.command();
            let carried = compute_early(&mut rig)?;
            if carried.is_in_time {
                return Ok(Some((period_us, carried)));
            }
        }
        Ok(None)
    }

    /// The rig, with its computation as early as the bus allows and gains by the rule of `tune gains`.
    ///
    /// # Errors
    /// If a shipped file or a number is refused.
    pub(super) fn machine(&self) -> Result<Machine, String> {
        let (mut rig, scene) = self.base()?;
        let torque = pose_margins(&rig).map_err(|error| error.to_string())?.ok_or("not in torque mode")?;
        rig.rig.command_mode = self.mode.command();
        let carried = compute_early(&mut rig)?;
        let servo = tuned(&mut rig, self.mode, &torque)?;
        Ok(Machine { rig, scene, carried, servo })
    }

    /// The shipped rig in torque mode with this cycle, and its scene.
    fn base(&self) -> Result<(config::Rig, config::Scene), String> {
        let file = match self.wire {
            Wire::Can => "paper-admittance.yaml",
            Wire::Ethercat => "paper-ethercat.yaml",
        };
        let (mut rig, scene) = shipped(file)?;
        rig.cycle.period_us = self.period_us;
        if self.period_us > SLOW_US {
            slow_heartbeats(&mut rig);
        }
        if self.wire == Wire::Can {
            let cycle_hz = 1e6 / f64::from(self.period_us);
            let rate_hz = SENSOR_HZ.into_iter().find(|rate_hz| *rate_hz <= cycle_hz).unwrap_or(SENSOR_HZ[2]);
            rig.sensor.sample_rate_hz = positive(rate_hz);
        }
        Ok((rig, scene))
    }
}

fn slow_heartbeats(rig: &mut config::Rig) {
    rig.buses.values_mut().filter_map(config::Bus::canopen_mut).for_each(|bus| bus.heartbeat_ms = SLOW_HEARTBEAT_MS);
    let nodes = rig.drives.iter_mut().filter_map(|drive| drive.address.canopen_mut());
    nodes.for_each(|node| node.heartbeat_ms = SLOW_HEARTBEAT_MS);
    if let SensorProtocol::Canopen { heartbeat_ms, .. } = &mut rig.sensor.protocol {
        *heartbeat_ms = SLOW_HEARTBEAT_MS;
    }
}

/// Returns the load of the rig's bus as it is.
fn carried(rig: &config::Rig) -> Result<Carried, String> {
    if rig.segment_of_drives().is_some() {
        let budget = ethercat::Budget::new(&segment(rig).map_err(|error| error.to_string())?);
        return Ok(Carried { load: budget.load(), is_in_time: budget.is_schedulable() });
    }
    let (setup, conditions) = bus_plan(rig).map_err(|error| error.to_string())?;
    let conditions = conditions.into_iter().next().ok_or("no bus")?;
    let budget = budget::Budget::new(&setup, conditions).map_err(|error| error.to_string())?;
    Ok(Carried { load: budget.load(), is_in_time: budget.is_schedulable() })
}

/// Puts the computation where all frames are in time, as early as that goes; in the middle of the cycle if it does not.
fn compute_early(rig: &mut config::Rig) -> Result<Carried, String> {
    for compute_at_us in (COMPUTE_STEP_US..rig.cycle.period_us).step_by(COMPUTE_STEP_US as usize) {
        rig.cycle.compute_at_us = compute_at_us;
        let carried = carried(rig)?;
        if carried.is_in_time {
            return Ok(carried);
        }
    }
    rig.cycle.compute_at_us = rig.cycle.period_us / 2;
    carried(rig)
}

/// Gains with 6 dB and 45 degrees where the loop is closed here, and in stiff drives; otherwise the drives' own are left as they are.
fn tuned(rig: &mut config::Rig, mode: Mode, torque: &PoseMargins) -> Result<Option<Loop>, String> {
    let period_s = f64::from(rig.cycle.period_us) * 1e-6;
    Ok(match mode {
        Mode::Torque => {
            let Some(tuned) = proposed_gains(rig, torque) else { return Ok(None) };
            rig.control.gains = ControlGains::Joint {
                stiffness_n_m_per_rad: positive(tuned.gains.stiffness),
                damping_n_m_s_per_rad: not_negative(tuned.gains.damping),
                integral_n_m_per_rad_s: not_negative(tuned.gains.integral),
            };
            let (gain_db, phase_deg) = (tuned.margins.gain_db, tuned.margins.phase_deg);
            Some(Loop { gain: tuned.gains.stiffness, gain_db, phase_deg })
        }
        Mode::Velocity => {
            let gain_per_s = proposed_rate_gain(rig);
            rig.control.gains = ControlGains::Rate { gain_per_s: positive(gain_per_s) };
            rate_margins(gain_per_s * period_s).map(|margins| Loop {
                gain: gain_per_s,
                gain_db: margins.gain_db,
                phase_deg: margins.phase_deg,
            })
        }
        Mode::Position | Mode::StiffPosition => {
            let drive = &mut rig.simulation.as_mut().ok_or("not simulated")?.drive_position_loop;
            let shape = Gains {
                stiffness: drive.stiffness_n_m_per_rad.get(),
                damping: drive.damping_n_m_s_per_rad.get(),
                integral: drive.integral_n_m_per_rad_s.get(),
            };
            let period_s = f64::from(drive.period_us) * 1e-6;
            let (gains, margins) = if mode == Mode::Position {
                let servo = ServoLoop { gains: shape, period_s, delay_cycles: 0.0 };
                (shape, worst_margins(&servo, &torque.inertia, 0.0).map_err(|error| error.to_string())?)
            } else {
                let is_wanted = |margins: &Margins| has_margins(margins, PROPOSED_MARGINS);
                let Some(tuned) = stiffest(shape, period_s, 0.0, &torque.inertia, is_wanted) else { return Ok(None) };
                (tuned.gains, tuned.margins)
            };
            drive.stiffness_n_m_per_rad = positive(gains.stiffness);
            drive.damping_n_m_s_per_rad = not_negative(gains.damping);
            drive.integral_n_m_per_rad_s = not_negative(gains.integral);
            Some(Loop { gain: gains.stiffness, gain_db: margins.gain_db, phase_deg: margins.phase_deg })
        }
    })
}
