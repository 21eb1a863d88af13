//! The texts of a new rig, of its simulation and of its scene.

use yieldwall_drives::profiles::EncoderKind;

use super::choice::{Choice, Law, Mode, OWN_NODE, Protocol};
use super::geometry::{Geometry, MARGIN_M};
use yieldwall_motion::control::Gains;
use yieldwall_motion::elementary;

/// Cycle time in us above which heartbeats are slower: their periods are whole cycles.
const FAST_US: u32 = 2000;
/// Stiffness of the scene's hand, N/m.
const HAND_N_PER_M: f64 = 400.0;
/// Force below which the fixture holds, N, and with which the hand presses without breaking out.
const YIELD_N: f64 = 20.0;
const PRESS_N: f64 = 14.0;

/// Numbers that follow from the choices.
#[derive(Clone, Copy, Debug)]
pub(super) struct Numbers {
    pub(super) compute_at_us: u32,
    pub(super) gains: Gains,
    pub(super) mass_kg: f64,
}

impl Numbers {
    /// Returns the choice before any computation: a rig that can be read.
    pub(super) fn first(choice: &Choice) -> Self {
        let gains = Gains { stiffness: 1000.0, damping: 20.0, integral: 1000.0 };
        Self { compute_at_us: choice.period_us * 3 / 5, gains, mass_kg: 2.0 }
    }
}

/// Returns the rig in `file`, with its simulation in the file beside it.
pub(super) fn rig(choice: &Choice, geometry: &Geometry, numbers: &Numbers, file: &str, simulation: &str) -> String {
    let Choice { period_us, nodes: [left, right, _], .. } = choice;
    let name = quoted(file.trim_end_matches(".yml").trim_end_matches(".yaml"));
    let mode = match choice.mode {
        Mode::Torque => "torque",
        Mode::Velocity => "velocity",
        Mode::Position => "position",
    };
    let heartbeat_ms = if *period_us <= FAST_US { 20 } else { 100 };
    let Geometry { links_m: [proximal, distal], half_base_m: half, below_m: below, working_m, circle_m } = geometry;
    let Numbers { compute_at_us, mass_kg, .. } = numbers;
    let is_on_can = choice.sensor != Protocol::Ethercat;
    let bus = if is_on_can {
        format!(
            "    canopen:
      bit_rate_bit_per_s: 1000000
      node_id: {OWN_NODE}              # node id of this program
      heartbeat_ms: {heartbeat_ms}          # period of this program's heartbeat; a drive without it for two periods stops by itself
"
        )
    } else {
        "    ethercat: {}                # outputs take effect at SYNC0; SYNC0 has the period of the cycle\n".to_owned()
    };
    let address = |node: &u8| match is_on_can {
        true => format!(
            "      canopen:
        node_id: {node}
        heartbeat_ms: {heartbeat_ms}       # period of the drive's heartbeat; without it for two periods the rig stops
"
        ),
        false => format!(
            "      ethercat:
        position: {}             # number of devices between the computer and this device
",
            node - 1
        ),
    };
    let (per_n, per_n_m, range) = if is_on_can { (0.00625, 0.0003, 32_000) } else { (1.0e-6, 1.0e-6, 500_000_000) };
    let drive = |side: &str, node: &u8, profile: &str| {
        let address = address(node);
        let profile = quoted(profile);
        let encoder = match choice.encoder {
            Some(EncoderKind::MultiTurn) => {
                "    encoder: multi_turn         # absolute over several turns at power-on\n"
            }
            Some(EncoderKind::SingleTurn) => "    encoder: single_turn        # absolute within one turn at power-on\n",
            _ => "",
        };
        format!(
            "  - name: {side}
    bus: main
    address:
{address}    profile: {profile}    # device model: identity, process data, watchdogs
{encoder}    encoder_counts_per_rev: 800000   # per turn of the proximal link, gear included
    direction: 1                # 1 or -1: sign of the counts for a positive angle
    zero_offset_rad: 0.0        # angle of the proximal link at 0 counts
    rated_torque_n_m: 60.0      # at the link, after the gear
"
        )
    };
    let drives = drive("left", left, &choice.profiles[0]) + &drive("right", right, &choice.profiles[1]);
    let sensor = sensor(choice, heartbeat_ms);
    let control = control(choice, numbers);
    format!(
        "# A five-bar admittance rig, written by `yieldwall new`. Unknown numbers have plausible defaults: replace the values of
# drives, sensor and linkage by those of your machine, and check the file with `yieldwall config check`.
rig:
  name: {name}
  command_mode: {mode}          # torque (CST), velocity (CSV) or position (CSP)

cycle:
  period_us: {period_us}
  compute_at_us: {compute_at_us}           # control step: after the last measured value, early enough for the set-points to arrive
                                # before the next SYNC; middle of the window of `yieldwall bus budget`

buses:
  main:
{bus}
drives:
{drives}
{sensor}  # wrench = matrix * counts; rows Fx, Fy, Fz (N), Tx, Ty, Tz (N m); copy them from the sensor's calibration sheet
  calibration:
    - [{per_n:?}, 0.0, 0.0, 0.0, 0.0, 0.0]
    - [0.0, {per_n:?}, 0.0, 0.0, 0.0, 0.0]
    - [0.0, 0.0, {per_n:?}, 0.0, 0.0, 0.0]
    - [0.0, 0.0, 0.0, {per_n_m:?}, 0.0, 0.0]
    - [0.0, 0.0, 0.0, 0.0, {per_n_m:?}, 0.0]
    - [0.0, 0.0, 0.0, 0.0, 0.0, {per_n_m:?}]
  range_counts: {range}
  mounted_on: right_distal      # base, left_distal or right_distal: the link that carries the sensor
  mounting_angle_rad: 0.0       # angle of the sensor's x axis from that link
  handle_mass_kg: 0.0           # mass beyond the sensor; its inertia is subtracted from the reading
  low_pass_hz: null             # null: no filter

linkage:
  base_m: [[-{half:?}, -{below:?}], [{half:?}, -{below:?}]]   # base joints; the origin is the centre of the working disc
  proximal_m: [{proximal:?}, {proximal:?}]
  distal_m: [{distal:?}, {distal:?}]
  elbows: [left, right]         # side of each elbow, looking from base joint to wrist; here outward
  wrist: forward                # forward: wrist to the left of the line from left to right elbow
  tool:
    fixed_to: right             # distal link that carries the tool
    along_m: 0.0                # from the wrist along that link, away from its elbow
    across_m: 0.0               # from the wrist, perpendicular, to the left of that direction
  working_radius_m: {working_m:?}        # radius of the disc around the origin that the arm must reach

{control}  feed_forward:                 # model of the machine
    coulomb_n_m: [8.0, 8.0]     # below the real dry friction; any excess pushes a joint at rest
    viscous_n_m_s_per_rad: [0.5, 0.5]
    inertia:                    # null disables it
      motor_kg_m2: [0.25, 0.25]
      proximal_kg: [0.0, 0.0]
      distal_kg: [0.0, 0.0]
      tool_kg: 1.0

fixture:
  coupling:
    admittance: {{mass_kg: {mass_kg:?}}}   # `yieldwall tune fixture` prints the stable masses
  friction_n: 3.0               # F: force below which the tool does not move, off the surface and along it
  yield_n: {YIELD_N:?}                 # R: the surface yields above this force
  side: bilateral               # bilateral or unilateral
  hold_steps: 0                 # N_wait in cycles. 0: fast impacts stop up to 2 mm beyond the surface; otherwise 2 or more
  curvature: tangent            # tangent or exact
  surface:
    circle: {{center_m: [0.0, 0.0], radius_m: {circle_m:?}, forbidden: inside}}   # forbidden: side that `unilateral` blocks

guard:                          # safety limits: beyond them the rig holds or stops
  torque_limit_n_m: 60.0
  joint_speed_limit_rad_per_s: 6.0
  tool_speed_limit_m_per_s: 1.5
  force_limit_n: 150.0
  force_step_limit_n: 80.0      # largest change between two samples
  residual_limit_n_m: 30.0      # torque mode: torque that force and motion do not explain; null disables it
  energy_limit_j: 0.5           # largest energy burst into the hand, beyond the energy that the rig held
  singularity_margin_m: {MARGIN_M:?}
  following_error_limit_rad: 0.05
  stop_deceleration_m_per_s2: 10.0   # braking ramp of a stop

# Simulated machine and scene. A rig on a real bus needs neither.
simulation: {simulation}
",
        simulation = quoted(simulation),
    )
}

fn sensor(choice: &Choice, heartbeat_ms: u32) -> String {
    let cycle_hz = 1_000_000 / choice.period_us;
    let head = "sensor:\n  name: wrist\n  bus: main\n";
    match choice.sensor {
        Protocol::Canopen => {
            // The rates of the profile; the loop takes the fastest one up to the rate of the cycle.
            let rate = [1000, 500, 200].into_iter().find(|rate| *rate <= cycle_hz).unwrap_or(200);
            format!(
                "{head}  protocol:
    canopen:                    # canopen, streaming or polled: see docs/force-sensors.md
      node_id: {}
      profile: simulated-force-sensor
      heartbeat_ms: {heartbeat_ms}          # period of the sensor's heartbeat
  sample_rate_hz: {rate}
",
                choice.nodes[2]
            )
        }
        Protocol::Streaming => format!(
            "{head}  protocol:
    streaming:                  # canopen, streaming or polled: see docs/force-sensors.md
      command_id: 0x35f         # commands start, stop and zero
      data_ids: [0x360, 0x361]  # the two frames of a sample; no node on the bus may use these ids
      pair_gap_us: 600          # longest time between the two frames of a sample
      zero_at_start: true       # the sensor loses its zero at power-off; nobody may touch the handle at the start
  sample_rate_hz: {}
",
            [500, 200, 100].into_iter().find(|rate| *rate <= cycle_hz).unwrap_or(100)
        ),
        Protocol::Ethercat => format!(
            "{head}  protocol:
    ethercat:                   # see docs/force-sensors.md
      position: 2
  sample_rate_hz: 8000          # of the sensor's own clock
"
        ),
        Protocol::Polled => format!(
            "{head}  protocol:
    polled:                     # canopen, streaming or polled: see docs/force-sensors.md
      base_id: 0x1b0            # request; the answers use 0x1b5 and 0x1b6
      byte_order: big_endian    # big_endian or little_endian
      overload_bits: 0x0002     # bit of the status word: a channel is saturated
      invalid_bits: 0x8000      # bit of the status word: the sample is invalid
      pair_gap_us: 300          # longest time between the two frames of an answer
      zero_at_start: true       # the sensor loses its zero at power-off; nobody may touch the handle at the start
  sample_rate_hz: 1000          # internal rate of the sensor, independent of the requests
"
        ),
    }
}

fn control(choice: &Choice, numbers: &Numbers) -> String {
    let law = match choice.law {
        Law::Psmc => "psmc",
        Law::Pid => "pid",
    };
    let Gains { stiffness, damping, integral } = numbers.gains;
    let head = format!("control:\n  law: {law}                     # psmc or pid, in torque mode\n");
    let gains = match choice.mode {
        Mode::Torque => format!(
            "  # Stiffest gains with 6 dB of gain margin and 45 degrees of phase margin at every pose along the surface, for the inertia
  # below. `yieldwall tune gains` computes them again.
  gains:
    joint:                      # joint, or cartesian with gains in N/m
      stiffness_n_m_per_rad: {stiffness:?}
      damping_n_m_s_per_rad: {damping:?}
      integral_n_m_per_rad_s: {integral:?}
"
        ),
        Mode::Velocity => format!(
            "  gains:
    rate:                       # rate command = rate of the reference + gain * angle error
      gain_per_s: {:?}          # 6 % of the cycle rate; an ideal drive overshoots from 25 % on
",
            0.06e6 / f64::from(choice.period_us)
        ),
        Mode::Position => "  # The drives close the loop: position mode does not use these gains.
  gains:
    joint:
      stiffness_n_m_per_rad: 5000.0
      damping_n_m_s_per_rad: 60.0
      integral_n_m_per_rad_s: 50000.0
"
        .to_owned(),
    };
    format!("{head}{gains}  sliding_time_s: 0.02          # H: sliding time of PSMC\n")
}

/// Returns the simulation of the rig in `rig`, with its scene in the file beside it.
pub(super) fn simulation(rig: &str, scene: &str) -> String {
    format!(
        "# Simulated machine of {rig}. A real bus does not use this file.
timing: arbitrated              # arbitrated (frames take time, by length and priority) or ideal

arm:
  motor_kg_m2: [0.25, 0.25]     # at the link, gear included
  proximal_kg: [0.0, 0.0]
  distal_kg: [0.0, 0.0]
  tool_kg: 1.0
  coulomb_n_m: [10.0, 10.0]     # dry friction of each joint
  viscous_n_m_s_per_rad: [0.5, 0.5]

drive_position_loop:            # loop inside each drive in position and velocity mode
  period_us: 125
  stiffness_n_m_per_rad: 20000.0
  damping_n_m_s_per_rad: 150.0
  integral_n_m_per_rad_s: 200000.0

scene: {}
",
        quoted(scene)
    )
}

/// Returns the scene of a hand that approaches the circle from inside, presses, traces, breaks out and returns.
pub(super) fn scene(geometry: &Geometry, rig: &str) -> String {
    let Geometry { working_m, circle_m, .. } = *geometry;
    let at = |radius_m: f64, angle_rad: f64| {
        let (sine, cosine) = elementary::sin_cos(angle_rad);
        format!("[{:.4}, {:.4}]", radius_m * cosine, radius_m * sine)
    };
    let (first, second) = (0.5, 1.3);
    let (inside, press) = (0.7 * circle_m, circle_m + PRESS_N / HAND_N_PER_M);
    // The tool comes as far beyond the circle as the hand aims beyond the yield force.
    let out = circle_m + YIELD_N / HAND_N_PER_M + 0.1 * working_m;
    format!(
        "# A hand on the rig of {rig}: it approaches the circle, presses, follows it, breaks out and comes back.
#
# With `hold_steps: 0` in the rig the tool follows the circle up to 2 mm beyond it. More cycles of hold keep it on the circle.
# The target point of the hand moves along the path below; a spring of {HAND_N_PER_M} N/m pulls the tool after it.
duration_s: 9.5
seed: 1
model:
  tracking: rigid               # ideal: the tool follows the proxy exactly, without an arm; rigid: arm with friction
  plant_step_us: 100
  encoder: quantised            # exact or quantised
  force_sensor: noisy           # quantised or noisy
  force_noise_counts: 4.0       # standard deviation per axis; used with noisy only
  joint_elasticity: null        # or {{stiffness_n_m_per_rad: .., damping_n_m_s_per_rad: .., motor_share: ..}}
tolerance:                      # for `study need`: a smaller change of an output does not matter
  distance_mm: 0.05
  force_n: 1.0
  torque_n_m: 1.0
  energy_mj: 2.0
hand:
  mass_kg: 0.5
  stiffness_n_per_m: {HAND_N_PER_M:?}
  damping_n_s_per_m: 8.0
  voluntary_force_limit_n: 40.0 # or null
  tremor: {{force_rms_n: 0.1, low_hz: 8.0, high_hz: 12.0}}   # or null
  start_m: {start}
  path:                         # of the hand's target point
    - to: {{point_m: {pressed}, in_s: 1.5}}      # approaches from inside, and presses outward with {PRESS_N} N, below R
    - wait: {{for_s: 0.3}}
    - arc: {{center_m: [0.0, 0.0], by_rad: 0.8, in_s: 1.8, speed: constant}}   # follows the circle
    - to: {{point_m: {out}, in_s: 1.2}}      # pulls with more than R: breaks out
    - wait: {{for_s: 0.3}}
    - to: {{point_m: {back}, in_s: 2.0}}      # comes back, and presses inward from outside
    - wait: {{for_s: 0.4}}
",
        start = at(inside, first),
        pressed = at(press, first),
        out = at(out, second),
        back = at(inside, second),
    )
}

/// Quotes a text for YAML, unless it is unambiguous without quotes.
fn quoted(text: &str) -> String {
    let is_plain = text.starts_with(|first: char| first.is_ascii_alphabetic())
        && text.bytes().all(|one| one.is_ascii_alphanumeric() || matches!(one, b'-' | b'_' | b'.' | b'/'))
        && !matches!(
            text.to_ascii_lowercase().as_str(),
            "null" | "true" | "false" | "yes" | "no" | "on" | "off" | "y" | "n"
        );
    if is_plain { text.to_owned() } else { serde_json::Value::from(text).to_string() }
}
