//! A nudge on a whole rig without dry friction: does the swing grow?

#[cfg(test)]
mod drawn_rig;
#[cfg(test)]
mod tests;

use std::f64::consts::TAU;
use std::time::Duration;

use super::drawn::{PEAK, finite, not_negative, positive};
use yieldwall_config::{self as config, PathSegment};
use yieldwall_motion::control::Grip;
use yieldwall_motion::elementary;
use yieldwall_motion::guard::{Fault, Request, State};
use yieldwall_record::Row;
use yieldwall_rig::EmbeddedRig;
use yieldwall_rig::analysis::is_sampled_at_sync;

/// Limits of a nudge: acceleration in m/s^2 of the virtual mass, and force of the hand in N. They are far above the effect of torque
/// counts, and far below what the torques can follow.
const NUDGE_M_PER_S2: f64 = 1.5;
const NUDGE_N: f64 = 8.0;
/// Cycles in which the hand's aim is displaced, at least: the sensor has to see it.
const NUDGE_CYCLES: f64 = 4.0;
/// Direction of the nudge, rad: along no axis.
const NUDGE_RAD: f64 = 0.6;
/// By how much a sample is later than the moment that its phase says, s: it is to be behind SYNC for certain.
const BEHIND_S: f64 = 1e-6;
/// Delay in s of a sample on EtherCAT behind SYNC0 of both drives. A sample between the steps of their loops would see the step of one
/// drive and not of the other, for as long as its phase stays.
const BEHIND_SYNC0_S: f64 = 5e-6;
/// Effective mass of the arms at the tool, kg, and lever of the tool on a joint, m: what a count of torque moves.
const ARM_KG: f64 = 2.0;
const LEVER_M: f64 = 0.3;
/// Counts of torque in the rated one, and how many of them a loop near its edge makes of one.
const COUNTS: f64 = 1000.0;
const COUNTS_FELT: f64 = 4.0;
/// A nudge changes the speed of the tool in a cycle by at least so many times of what counts of the drives do.
const OVER_COUNTS: f64 = 20.0;
/// Torque that drives with a loop of their own have, in torques that the nudge asks them for.
const TORQUE_RESERVE: f64 = 4.0;
/// By how much weaker the hand nudges again if the guard took the nudge for chatter, and how often.
const WEAKER: f64 = 0.3;
const NUDGES: i32 = 3;
/// Windows of a run.
const WINDOWS: usize = 16;
/// Least and greatest length of a run, s.
const DURATION_S: [f64; 2] = [3.0, 60.0];
/// So many swings of the virtual mass on the hand's spring are in a run.
const SWINGS: f64 = 40.0;
/// Below this share of its greatest window a motion has died away.
const DIED: f64 = 0.006;
/// Below this share little is left of it, in which counts show; a swing then grows by so many times in a quarter of a run.
const LITTLE: f64 = 0.05;
const GROWING: f64 = 1.5;
/// A motion falls if it is below so much of what it was a quarter of the run before. A motion that swings at its torque limit stays.
const FALLS: f64 = 0.98;
/// Above so many times its first window a motion grows.
const GROWN: f64 = 4.0;
/// The sensor's range over the greatest force of the nudge.
const RANGE_RESERVE: f64 = 6.0;
/// A rig that stops above so many times that force was swinging.
const SWINGING: f64 = 3.0;
/// Counts of a turn of a joint.
const DRIVE_COUNTS: f64 = 2e9;
/// Least of the greatest torques, N m. In torque mode it is less, since more than a nudge needs makes the counts on the bus coarse; with slow cycles
/// servos are softer. It is the rated torque too: the simulated drives cut what is above (60E0h, 60E1h).
const TORQUE_N_M: f64 = 20.0;
const MOST_TORQUE_N_M: f64 = 2.0;

/// A rig without dry friction, in free space, with fine counts and without limits that a nudge reaches; and a hand that
/// nudges it.
pub(crate) struct Bench {
    rig: config::Rig,
    scene: config::Scene,
    grip: Grip,
    tool_m: [f64; 2],
    phases: u32,
    /// The phase that last showed a swing that grows: it is tried first.
    worst: u32,
}

/// A rig that runs, with a hand that is about to nudge it.
struct Trial {
    machine: EmbeddedRig,
    /// A tool that is faster than a nudge has it move, m/s.
    fast_m_per_s: f64,
    /// Greatest force of the nudge on a tool that rests, N.
    nudge_n: f64,
    /// Least speed of a swing, m/s.
    floor_m_per_s: f64,
}

impl Bench {
    /// `phases` of the sensor's clock are looked at, where it has one of its own.
    pub(crate) fn new(rig: &config::Rig, scene: &config::Scene, grip: &Grip, tool_m: [f64; 2], phases: u32) -> Self {
        let phases = if is_sampled_at_sync(rig) { 1 } else { phases };
        Self { rig: frictionless(rig), scene: scene.clone(), grip: *grip, tool_m, phases, worst: 0 }
    }

    /// Returns the speed in m/s that one count of the force, or of the torque on the bus, gives proxy and tool by the end of a
    /// cycle. A slower motion is no swing.
    fn floor_m_per_s(&self, mass_kg: f64, force_count_n: f64) -> f64 {
        count_m_per_s2(&self.rig).max(COUNTS_FELT * force_count_n / mass_kg) * self.period_s()
    }

    fn period_s(&self) -> f64 {
        period_s(&self.rig)
    }

    /// The rig at a phase of the sensor's clock: 0 samples right behind SYNC.
    fn trial(&self, mass_kg: f64, phase: u32, share: f64) -> Result<Trial, String> {
        let Grip { stiffness_n_per_m, damping_n_s_per_m, .. } = self.grip;
        let nudge_n = share * (nudge_m_per_s2(&self.rig) * mass_kg).min(NUDGE_N);
        // So long that spring and damper share the force.
        let nudge_s = (PEAK * damping_n_s_per_m / stiffness_n_per_m).max(NUDGE_CYCLES * self.period_s());
        let nudge_m = nudge_n / (stiffness_n_per_m + damping_n_s_per_m * PEAK / nudge_s);
        let fast_m_per_s = SWINGING * nudge_m * (PEAK / nudge_s).max((stiffness_n_per_m / mass_kg).sqrt());
        let mut rig = self.rig.clone();
        let per_count = RANGE_RESERVE * nudge_n / f64::from(rig.sensor.range_counts);
        for (row, gains) in rig.sensor.calibration.iter_mut().enumerate() {
            *gains = std::array::from_fn(|column| finite(if row == column { per_count } else { 0.0 }));
        }
        rig.fixture.coupling = config::Coupling::Admittance { mass_kg: positive(mass_kg) };
        let scene = nudge(&self.scene, &self.grip, self.tool_m, nudge_m, nudge_s);
        let mut machine =
            EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).map_err(|error| error.to_string())?;
        machine.enable().map_err(|error| error.to_string())?;
        let interval_s = rig.sensor.sample_rate_hz.get().recip();
        let share = f64::from(phase) / f64::from(self.phases);
        // The phase stays: a sample that drifts past the frame, and shows more counts there, looks like a swing that grows.
        machine.stop_drift();
        let behind_s = if rig.has_drives_on_ethercat() { BEHIND_SYNC0_S } else { BEHIND_S };
        machine.align_sensor(Duration::from_secs_f64(behind_s + share * interval_s));
        let floor_m_per_s = self.floor_m_per_s(mass_kg, per_count);
        Ok(Trial { machine, fast_m_per_s, nudge_n, floor_m_per_s })
    }

    /// Whether the nudge dies away at this phase.
    fn dies_away(&self, mass_kg: f64, phase: u32) -> Result<bool, String> {
        let mut end = Ok(false);
        for nudge in 0..NUDGES {
            end = self.dies_away_after(mass_kg, phase, elementary::powi(WEAKER, nudge))?;
            if end != Err(Fault::Chatter) {
                break;
            }
        }
        match end {
            Ok(dies) => Ok(dies),
            // However weak the nudge was.
            Err(Fault::Chatter) => Ok(false),
            Err(fault) => Err(fault.row().name.to_owned()),
        }
    }

    /// Whether a nudge of this share of the usual one dies away. The inner error is the fault that stopped the rig before that was
    /// clear.
    fn dies_away_after(&self, mass_kg: f64, phase: u32, share: f64) -> Result<Result<bool, Fault>, String> {
        let Trial { mut machine, fast_m_per_s, nudge_n, floor_m_per_s } = self.trial(mass_kg, phase, share)?;
        let [least_s, most_s] = DURATION_S;
        let duration_s = (SWINGS * TAU * (mass_kg / self.grip.stiffness_n_per_m).sqrt()).clamp(least_s, most_s);
        let window_cycles = (duration_s / self.period_s() / WINDOWS as f64).ceil() as u32;
        let mut swing = Swing { floor_m_per_s, ..Swing::default() };
        let mut greatest_n = 0.0_f64;
        for _ in 0..WINDOWS {
            for _ in 0..window_cycles {
                let row = machine.run_cycle(Request::None).map_err(|error| error.to_string())?;
                swing.add(&row);
                greatest_n = greatest_n.max(size(row.force_n));
                if machine.state() != State::Running {
                    let fault = machine.cause().map(|cause| cause.fault).ok_or("stopped without a cause")?;
                    // A reference that the arm has lost, or a force beyond the sensor, is more than any nudge.
                    let is_beyond = matches!(fault, Fault::FollowingError | Fault::SensorSaturated);
                    let is_swing = greatest_n > SWINGING * nudge_n || swing.is_faster(fast_m_per_s) || is_beyond;
                    return Ok(if is_swing { Ok(false) } else { Err(fault) });
                }
            }
            swing.end_window();
            if swing.has_died() {
                return Ok(Ok(true));
            }
            if swing.has_grown() {
                return Ok(Ok(false));
            }
        }
        Ok(Ok(swing.falls()))
    }

    /// Whether the nudge dies away at all phases.
    ///
    /// # Errors
    /// Why a run came to nothing.
    pub(crate) fn is_stable(&mut self, mass_kg: f64) -> Result<bool, String> {
        for phase in 0..self.phases {
            let phase = (self.worst + phase) % self.phases;
            if !self.dies_away(mass_kg, phase)? {
                self.worst = phase;
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Returns the edge between stable and unstable masses near `printed_kg`, the last stable mass as printed. The factor `towards`
    /// points from there into the stable masses: for example 1.02 at the least mass, and its inverse at the greatest. The result is
    /// `None` if there is no edge within a factor of ten.
    ///
    /// # Errors
    /// Why a run came to nothing.
    pub(crate) fn edge_kg(&mut self, printed_kg: f64, towards: f64, beyond: f64) -> Result<Option<f64>, String> {
        let within = |mass_kg: f64| (0.1..=10.0).contains(&(mass_kg / printed_kg));
        let (mut stable_kg, mut unstable_kg) = (printed_kg * towards, printed_kg / beyond);
        if self.is_stable(stable_kg)? {
            while self.is_stable(unstable_kg)? {
                (stable_kg, unstable_kg) = (unstable_kg, unstable_kg / beyond);
                if !within(unstable_kg) {
                    return Ok(None);
                }
            }
        } else {
            (unstable_kg, stable_kg) = (stable_kg, stable_kg * beyond);
            while !self.is_stable(stable_kg)? {
                (unstable_kg, stable_kg) = (stable_kg, stable_kg * beyond);
                if !within(stable_kg) {
                    return Ok(None);
                }
            }
        }
        while (stable_kg / unstable_kg).max(unstable_kg / stable_kg) > EDGE_RATIO {
            let middle_kg = (stable_kg * unstable_kg).sqrt();
            if self.is_stable(middle_kg)? { stable_kg = middle_kg } else { unstable_kg = middle_kg }
        }
        Ok(Some((stable_kg * unstable_kg).sqrt()))
    }
}

/// An edge is known when the stable side is that near the unstable one.
const EDGE_RATIO: f64 = 1.01;

/// How fast the tool moves, and how fast that changes, window by window: a swing that grows below a slow motion shows in the
/// second first.
#[derive(Debug, Default)]
struct Swing {
    floor_m_per_s: f64,
    last: Option<[f64; 2]>,
    sums: [f64; 2],
    count: u32,
    /// Mean squares of each window.
    windows: Vec<[f64; 2]>,
}

impl Swing {
    fn add(&mut self, row: &Row) {
        let [x, y, _] = row.tool_velocity_m_per_s;
        if let Some([x_before, y_before]) = self.last {
            self.sums[0] += x * x + y * y;
            self.sums[1] += (x - x_before) * (x - x_before) + (y - y_before) * (y - y_before);
            self.count += 1;
        }
        self.last = Some([x, y]);
    }

    fn end_window(&mut self) {
        self.windows.push(self.sums.map(|sum| sum / f64::from(self.count.max(1))));
        (self.sums, self.count) = ([0.0; 2], 0);
    }

    fn greatest(&self, which: usize) -> f64 {
        self.windows.iter().map(|window| window[which]).fold(0.0, f64::max)
    }

    fn is_faster(&self, speed_m_per_s: f64) -> bool {
        self.last.is_some_and(|[x, y]| elementary::hypot(x, y) > speed_m_per_s)
    }

    /// Whether the mean square of this part of the motion is below such a share of its greatest, or so small that counts make it.
    fn is_below(&self, share: f64, which: usize, square: f64) -> bool {
        square <= (share * share * self.greatest(which)).max(self.floor_m_per_s * self.floor_m_per_s)
    }

    fn has_died(&self) -> bool {
        self.windows.last().is_some_and(|last| (0..2).all(|which| self.is_below(DIED, which, last[which])))
    }

    fn has_grown(&self) -> bool {
        let ends = self.windows.first().zip(self.windows.last());
        ends.is_some_and(|(first, last)| last[0] > GROWN * GROWN * first[0])
    }

    /// Whether the last quarter is below the one before, in each part of the motion. The residual motion that counts
    /// cause does not fall. Where little motion is left, a swing therefore has to grow to count.
    fn falls(&self) -> bool {
        let quarter = WINDOWS / 4;
        let mean = |from: usize, which: usize| {
            let windows = self.windows.get(from..from + quarter).unwrap_or_default();
            windows.iter().map(|window| window[which]).sum::<f64>() / quarter as f64
        };
        (0..2).all(|which| {
            let [before, last] = [mean(WINDOWS - 2 * quarter, which), mean(WINDOWS - quarter, which)];
            let is_little = self.is_below(LITTLE, which, last);
            last < before * if is_little { GROWING * GROWING } else { FALLS * FALLS }
        })
    }
}

fn size([x, y, _]: [f64; 3]) -> f64 {
    elementary::hypot(x, y)
}

fn period_s(rig: &config::Rig) -> f64 {
    f64::from(rig.cycle.period_us) * 1e-6
}

/// Acceleration in m/s^2 of the tool that counts bring: of the torque on the bus, or of target and angle in drives with a position loop.
fn count_m_per_s2(rig: &config::Rig) -> f64 {
    let count_n_m = match (rig.rig.command_mode, &rig.simulation) {
        (config::CommandMode::Torque, _) => rig.guard.torque_limit_n_m.get() / COUNTS,
        (config::CommandMode::Position, Some(simulation)) => {
            let servo = &simulation.drive_position_loop;
            let damping = servo.damping_n_m_s_per_rad.get() / period_s(rig);
            TAU / DRIVE_COUNTS * (servo.stiffness_n_m_per_rad.get() + damping)
        }
        _ => 0.0,
    };
    COUNTS_FELT * count_n_m / LEVER_M / ARM_KG
}

/// Acceleration in m/s^2 of the virtual mass to which a nudge is limited.
fn nudge_m_per_s2(rig: &config::Rig) -> f64 {
    NUDGE_M_PER_S2.max(OVER_COUNTS * count_m_per_s2(rig))
}

fn frictionless(rig: &config::Rig) -> config::Rig {
    let mut rig = rig.clone();
    rig.drives.iter_mut().for_each(|drive| drive.encoder_counts_per_rev = DRIVE_COUNTS as u32);
    rig.simulation.iter_mut().for_each(|simulation| simulation.arm.coulomb_n_m = [not_negative(0.0); 2]);
    rig.control.feed_forward.coulomb_n_m = [not_negative(0.0); 2];
    let fixture = &mut rig.fixture;
    fixture.friction_n = not_negative(0.0);
    fixture.hold_steps = 0;
    fixture.automatic_hold = None;
    fixture.passivity = None;
    fixture.motion = None;
    fixture.law = Some(config::FixtureLaw::Free {});
    let torque_n_m = match rig.rig.command_mode {
        config::CommandMode::Torque => (TORQUE_N_M / (f64::from(rig.cycle.period_us) * 1e-3)).min(MOST_TORQUE_N_M),
        // The rate of the target changes by that much in a cycle.
        _ => {
            let damping =
                rig.simulation.as_ref().map_or(0.0, |one| one.drive_position_loop.damping_n_m_s_per_rad.get());
            TORQUE_N_M.max(TORQUE_RESERVE * damping * nudge_m_per_s2(&rig) * period_s(&rig) / LEVER_M)
        }
    };
    let guard = &mut rig.guard;
    guard.torque_limit_n_m = positive(torque_n_m);
    guard.joint_speed_limit_rad_per_s = positive(10.0);
    guard.tool_speed_limit_m_per_s = positive(10.0);
    guard.force_limit_n = positive(1e4);
    guard.force_step_limit_n = positive(1e4);
    guard.residual_limit_n_m = None;
    guard.energy_limit_j = positive(1e3);
    for drive in &mut rig.drives {
        drive.rated_torque_n_m = positive(torque_n_m);
    }
    rig
}

fn nudge(scene: &config::Scene, grip: &Grip, tool_m: [f64; 2], nudge_m: f64, nudge_s: f64) -> config::Scene {
    let mut scene = scene.clone();
    if let Some(model) = &mut scene.model {
        model.tracking = config::Tracking::Rigid;
        model.encoder = config::EncoderModel::Exact;
        model.force_sensor = config::ForceSensorModel::Quantised;
    }
    scene.faults.clear();
    let [x, y] = tool_m;
    let aim_m = [x + nudge_m * elementary::cos(NUDGE_RAD), y + nudge_m * elementary::sin(NUDGE_RAD)];
    scene.hand = config::Hand {
        mass_kg: not_negative(grip.mass_kg),
        stiffness_n_per_m: positive(grip.stiffness_n_per_m),
        damping_n_s_per_m: not_negative(grip.damping_n_s_per_m),
        voluntary_force_limit_n: None,
        tremor: None,
        aim_error: None,
        start_m: tool_m.map(finite).to_vec(),
        path: vec![PathSegment::To { point_m: aim_m.map(finite).to_vec(), in_s: positive(nudge_s) }],
    };
    scene
}
