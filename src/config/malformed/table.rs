//! The table.

/// A change to a file that makes it wrong.
#[derive(Debug)]
pub(crate) struct Case {
    /// What kind of mistake it is.
    pub(crate) class: &'static str,
    /// Which one of them.
    pub(crate) name: &'static str,
    /// The file that is loaded.
    pub(crate) load: &'static str,
    /// The file that is changed; empty when `to` is the whole file.
    pub(crate) base: &'static str,
    /// What is replaced, at its first place.
    pub(crate) from: &'static str,
    /// What replaces it.
    pub(crate) to: &'static str,
}

const RIG: &str = "rig.yaml";
const DEVICE: &str = "device.yaml";
const SCENE: &str = "scene.yaml";
const SPACE: &str = "space.yaml";
const FIGURE: &str = "figure.yaml";
const VARIANT: &str = "variant.yaml";

const fn case(
    class: &'static str,
    name: &'static str,
    base: &'static str,
    from: &'static str,
    to: &'static str,
) -> Case {
    Case { class, name, load: base, base, from, to }
}

/// A change to a file that another one names.
const fn linked(
    class: &'static str,
    name: &'static str,
    [load, base]: [&'static str; 2],
    from: &'static str,
    to: &'static str,
) -> Case {
    Case { class, name, load, base, from, to }
}

/// Twenty aliases.
macro_rules! ALIASES {
    () => {
        "    - *w\n    - *w\n    - *w\n    - *w\n    - *w\n    - *w\n    - *w\n    - *w\n    - *w\n    - *w\n    - *w\n    - *w\n    - *w\n    - *w\n    - *w\n    - *w\n    - *w\n    - *w\n    - *w\n    - *w\n"
    };
}

/// The surface of the rig.
macro_rules! CIRCLE {
    () => {
        "circle: {center_m: [0.0, 0.0], radius_m: 0.12, forbidden: inside}"
    };
}

/// The surface of the device.
macro_rules! CYLINDER {
    () => {
        "cylinder: {axis_point_m: [0.0, 0.0, 0.0], axis_direction: [0.0, 0.0, 1.0], radius_m: 0.04, forbidden: inside}"
    };
}

/// All of them, by class.
#[rustfmt::skip]
pub(crate) const CASES: &[Case] = &[
    case("syntax", "missing colon", RIG, "cycle:\n", "cycle\n"),
    case("syntax", "missing space after colon", RIG, "friction_n: 3.0", "friction_n:3.0"),
    case("syntax", "open bracket", RIG, "proximal_m: [0.30, 0.30]", "proximal_m: [0.30, 0.30"),
    case("syntax", "tab", RIG, "  period_us: 1000", "\tperiod_us: 1000"),
    case("syntax", "indented too far", RIG, "  compute_at_us", "      compute_at_us"),
    case("syntax", "unknown anchor", RIG, "name: left", "name: *left"),
    case("syntax", "foreign tag", RIG, "friction_n: 3.0", "friction_n: !force 3.0"),
    case("syntax", "open quote", RIG, "name: left", "name: \"left"),
    case("syntax", "comment without space", RIG, "elbows: [left, right]", "elbows: [left, right]# outward"),
    case("wrong type", "word for a number", RIG, "yield_n: 20.0", "yield_n: strong"),
    case("wrong type", "number with unit", RIG, "friction_n: 3.0", "friction_n: 3 N"),
    case("wrong type", "decimal comma", RIG, "friction_n: 3.0", "friction_n: 3,0"),
    case("wrong type", "fraction for a whole number", RIG, "period_us: 1000", "period_us: 1000.5"),
    case("wrong type", "negative whole number", RIG, "node_id: 127", "node_id: -1"),
    case("wrong type", "whole number too large", RIG, "node_id: 127", "node_id: 300"),
    case("wrong type", "list for a number", RIG, "working_radius_m: 0.16", "working_radius_m: [0.16]"),
    case("wrong type", "group for a number", RIG, "yield_n: 20.0", "yield_n: {value: 20.0}"),
    case("wrong type", "number for a group", RIG, "  tool:\n    fixed_to: right\n    along_m: 0.0\n    across_m: 0.0\n", "  tool: 0.0\n"),
    case("wrong type", "null for a number", RIG, "yield_n: 20.0", "yield_n: null"),
    case("wrong type", "nothing for a number", RIG, "yield_n: 20.0", "yield_n:"),
    case("wrong type", "choice without its group", RIG, "admittance: {mass_kg: 2.0}", "admittance"),
    case("wrong length", "one link", RIG, "proximal_m: [0.30, 0.30]", "proximal_m: [0.30]"),
    case("wrong length", "three links", RIG, "proximal_m: [0.30, 0.30]", "proximal_m: [0.30, 0.30, 0.30]"),
    case("wrong length", "row of five", RIG, "[0.00625, 0.0, 0.0, 0.0, 0.0, 0.0]", "[0.00625, 0.0, 0.0, 0.0, 0.0]"),
    case("unknown key", "slip of the pen", RIG, "  hold_steps: 0", "  hold_step: 0"),
    case("unknown key", "unit left out", RIG, "admittance: {mass_kg: 2.0}", "admittance: {mass: 2.0}"),
    case("unknown key", "at the top", RIG, "guard:\n", "safety:\n  on: true\n\nguard:\n"),
    case("unknown key", "of another place", RIG, "  friction_n: 3.0", "  friction_n: 3.0\n  mass_kg: 2.0"),
    case("missing key", "limit", RIG, "  force_limit_n: 150.0\n", ""),
    case("missing key", "filter is not optional", RIG, "  low_pass_hz: null\n", ""),
    case("missing key", "residual limit is not optional", RIG, "  residual_limit_n_m: 30.0\n", ""),
    case("missing key", "group", RIG, "master:\n  node_id: 127\n  heartbeat_ms: 20\n", ""),
    case("missing key", "in a choice", RIG, "admittance: {mass_kg: 2.0}", "admittance: {}"),
    case("missing key", "in a list", RIG, "    node_id: 2\n", ""),
    case("duplicate key", "in a group", RIG, "  yield_n: 20.0", "  yield_n: 20.0\n  yield_n: 25.0"),
    case("duplicate key", "at the top", RIG, "guard:\n", "cycle:\n  period_us: 500\n\nguard:\n"),
    case("choice", "mode by its abbreviation", RIG, "command_mode: torque", "command_mode: cst"),
    case("choice", "slip of the pen", RIG, "side: bilateral", "side: bilatral"),
    case("choice", "unknown coupling", RIG, "admittance: {mass_kg: 2.0}", "admitance: {mass_kg: 2.0}"),
    case("choice", "two couplings", RIG, "admittance: {mass_kg: 2.0}", "admittance: {mass_kg: 2.0}\n    impedance: {stiffness_n_per_m: 1.0, damping_n_s_per_m: 0.0}"),
    case("not finite", "NaN", RIG, "friction_n: 3.0", "friction_n: .nan"),
    case("not finite", "infinity", RIG, "torque_limit_n_m: 60.0", "torque_limit_n_m: .inf"),
    case("not finite", "minus infinity", RIG, "mounting_angle_rad: 0.0", "mounting_angle_rad: -.inf"),
    case("not finite", "overflow", RIG, "torque_limit_n_m: 60.0", "torque_limit_n_m: 1e999"),
    case("not finite", "NaN in quotes", RIG, "friction_n: 3.0", "friction_n: '.nan'"),
    case("not finite", "NaN where null may be", RIG, "low_pass_hz: null", "low_pass_hz: .NaN"),
    case("range", "absurdly large", RIG, "torque_limit_n_m: 60.0", "torque_limit_n_m: 6.0e+60"),
    case("range", "absurdly small", RIG, "mass_kg: 2.0", "mass_kg: 2.0e-60"),
    case("range", "a mass that no step can be computed with", RIG, "mass_kg: 2.0", "mass_kg: 4.0e+8"),
    case("range", "negative mass", RIG, "mass_kg: 2.0", "mass_kg: -2.0"),
    case("range", "no mass", RIG, "mass_kg: 2.0", "mass_kg: 0"),
    case("range", "negative damping", DEVICE, "damping_n_s_per_m: 1.5", "damping_n_s_per_m: -1.5"),
    case("range", "no energy", RIG, "energy_limit_j: 0.5", "energy_limit_j: 0.0"),
    case("range", "negative force step", RIG, "force_step_limit_n: 80.0", "force_step_limit_n: -80.0"),
    case("range", "node-ID 0", RIG, "    node_id: 1\n", "    node_id: 0\n"),
    case("range", "node-ID 128", RIG, "  node_id: 10\n", "  node_id: 128\n"),
    case("range", "period too short", RIG, "period_us: 1000", "period_us: 10"),
    case("range", "empty name", RIG, "name: base", "name: ''"),
    case("range", "direction 0", RIG, "direction: 1", "direction: 0"),
    case("range", "four coordinates", SCENE, "start_m: [0.05, 0.03]", "start_m: [0.05, 0.03, 0.0, 0.0]"),
    case("range", "empty path", SCENE, "    - to: {point_m: [0.10, 0.06], in_s: 1.0}\n    - arc: {center_m: [0.0, 0.0], by_rad: 1.2, in_s: 2.0, speed: constant}\n    - wait: {for_s: 0.5}\n", "    []\n"),
    case("bus", "bit rate of no standard", RIG, "bit_rate_bit_per_s: 1000000", "bit_rate_bit_per_s: 400000"),
    case("bus", "drive on an unknown bus", RIG, "    bus: main", "    bus: mian"),
    case("bus", "duplicate node-ID", RIG, "    node_id: 2\n", "    node_id: 1\n"),
    case("bus", "node-ID of the master", RIG, "  node_id: 10\n", "  node_id: 127\n"),
    case("bus", "same drive name", RIG, "name: right", "name: left"),
    case("bus", "no bus", RIG, "  main:\n    bit_rate_bit_per_s: 1000000\n    timing: arbitrated\n", "  {}\n"),
    case("bus", "bus without a device", RIG, "buses:\n", "buses:\n  spare:\n    bit_rate_bit_per_s: 500000\n    timing: ideal\n"),
    case("bus", "heartbeat of every cycle", RIG, "heartbeat_ms: 20", "heartbeat_ms: 1"),
    case("profile", "unknown", RIG, "profile: simulated-servo", "profile: simulated-sevro"),
    case("profile", "sensor as drive", RIG, "profile: simulated-servo", "profile: simulated-force-sensor"),
    case("profile", "sample rate", RIG, "sample_rate_hz: 1000", "sample_rate_hz: 4000"),
    case("fixture", "yield below friction", RIG, "yield_n: 20.0", "yield_n: 2.0"),
    case("fixture", "hold of one step", RIG, "hold_steps: 0", "hold_steps: 1"),
    case("fixture", "impedance on a rig", RIG, "admittance: {mass_kg: 2.0}", "impedance: {stiffness_n_per_m: 1000.0, damping_n_s_per_m: 1.5}"),
    case("fixture", "cylinder on a rig", RIG, "circle: {center_m: [0.0, 0.0], ", "cylinder: {axis_point_m: [0.0, 0.0, 0.0], axis_direction: [0.0, 0.0, 1.0], "),
    case("fixture", "axis without direction", DEVICE, "axis_direction: [0.0, 0.0, 1.0]", "axis_direction: [0.0, 0.0, 0.0]"),
    case("fixture", "exact cylinder", DEVICE, "curvature: tangent", "curvature: exact"),
    case("fixture", "two holds", RIG, "hold_steps: 0", "hold_steps: 5\n  automatic_hold: {hand_mass_kg: 1.5, longest_s: 0.1}"),
    case("fixture", "endless automatic hold", RIG, "hold_steps: 0", "hold_steps: 0\n  automatic_hold: {hand_mass_kg: 1.5, longest_s: 10.0}"),
    case("fixture", "automatic hold of a device", DEVICE, "hold_steps: 0", "hold_steps: 0\n  automatic_hold: {hand_mass_kg: 1.5, longest_s: 0.1}"),
    case("fixture", "passivity of a device", DEVICE, "hold_steps: 0", "hold_steps: 0\n  passivity: {bound_j: 0.05}"),
    case("fixture", "passivity without a bound", RIG, "hold_steps: 0", "hold_steps: 0\n  passivity: {bound_j: 1000.0}"),
    case("fixture", "passivity of a moving surface", RIG, "hold_steps: 0", "hold_steps: 0\n  passivity: {bound_j: 0.05}\n  motion: {amplitude_m: [0.01, 0.0], swing_s: 2.0}"),
    case("fixture", "passivity of a spring", RIG, "hold_steps: 0", "hold_steps: 0\n  passivity: {bound_j: 0.05}\n  law: {elastic: {stiffness_n_per_m: 1000.0, damping_n_s_per_m: 10.0, is_saturated: false}}"),
    case("fixture", "passivity above the energy limit", RIG, "hold_steps: 0", "hold_steps: 0\n  passivity: {bound_j: 0.5}"),
    case("fixture", "wall on a point", RIG, concat!("side: bilateral\n  hold_steps: 0\n  curvature: tangent\n  surface:\n    ", CIRCLE!()), "side: unilateral\n  hold_steps: 0\n  curvature: tangent\n  surface:\n    point: {point_m: [0.0, 0.1], capture_radius_m: 0.0002}"),
    case("fixture", "point twice", RIG, CIRCLE!(), "polygon: {points_m: [[0.0, 0.0], [0.1, 0.0], [0.1, 0.0]], forbidden: inside}"),
    case("fixture", "polygon crosses itself", RIG, CIRCLE!(), "polygon: {points_m: [[0.0, 0.0], [0.1, 0.1], [0.1, 0.0], [0.0, 0.1]], forbidden: inside}"),
    case("fixture", "two corners", RIG, CIRCLE!(), "polygon: {points_m: [[0.0, 0.0], [0.1, 0.1]], forbidden: inside}"),
    case("fixture", "curve tighter than its reach", RIG, CIRCLE!(), "open_curve: {points_m: [[0.0, 0.0], [0.00001, 0.0], [0.00001, 0.00001]]}"),
    case("fixture", "curve out of reach", RIG, CIRCLE!(), "open_curve: {points_m: [[0.0, 0.0], [0.6, 0.0], [0.6, 0.6]]}"),
    case("fixture", "point not finite", RIG, CIRCLE!(), "point: {point_m: [.nan, 0.0], capture_radius_m: 0.0002}"),
    case("fixture", "wide capture", RIG, CIRCLE!(), "point: {point_m: [0.0, 0.0], capture_radius_m: 0.2}"),
    case("fixture", "capture faster than the guard allows", RIG, CIRCLE!(), "point: {point_m: [0.0, 0.1], capture_radius_m: 0.003}"),
    case("fixture", "box without size", DEVICE, CYLINDER!(), "box: {center_m: [0.0, 0.0, 0.0], half_size_m: [0.1, 0.0, 0.1], forbidden: inside}"),
    case("fixture", "ring of two points", DEVICE, CYLINDER!(), "space_curve: {points_m: [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]], is_closed: true, capture_radius_m: 0.0}"),
    case("fixture", "outward below friction", RIG, "surface:\n", "law: {tube: {outward_yield_n: 2.0}}\n  surface:\n"),
    case("fixture", "elastic with a hold", RIG, "hold_steps: 0", "hold_steps: 5\n  law: {elastic: {stiffness_n_per_m: 1000.0, damping_n_s_per_m: 10.0, is_saturated: false}}"),
    case("fixture", "stiff elastic", RIG, "surface:\n", "law: {elastic: {stiffness_n_per_m: 2.0e6, damping_n_s_per_m: 10.0, is_saturated: false}}\n  surface:\n"),
    case("fixture", "viscous device", DEVICE, "surface:\n", "law: {viscous: {across_n_s_per_m: 100.0, along_n_s_per_m: 5.0}}\n  surface:\n"),
    case("fixture", "exact ellipse", RIG, "curvature: tangent", "curvature: exact\n  law: {ellipse: {}}"),
    case("fixture", "unknown law", RIG, "surface:\n", "law: {rubber: {}}\n  surface:\n"),
    case("fixture", "fast motion", RIG, "surface:\n", "motion: {amplitude_m: [0.1, 0.0], swing_s: 0.2}\n  surface:\n"),
    case("fixture", "point among others", RIG, "surface:\n", "also:\n    - point: {point_m: [0.0, 0.1], capture_radius_m: 0.0002}\n  surface:\n"),
    case("fixture", "further surface out of reach", RIG, "surface:\n", "also:\n    - circle: {center_m: [0.0, 0.0], radius_m: 2.0, forbidden: outside}\n  surface:\n"),
    case("fixture", "further surface in space", RIG, "surface:\n", "also:\n    - plane: {point_m: [0.0, 0.0, 0.0], normal: [0.0, 0.0, 1.0]}\n  surface:\n"),
    case("fixture", "radius below reach", RIG, "radius_m: 0.12", "radius_m: 8.0e-6"),
    case("timing", "step after SYNC", RIG, "compute_at_us: 700", "compute_at_us: 1000"),
    case("timing", "inner loop does not fit", RIG, "period_us: 125", "period_us: 300"),
    case("timing", "plant step does not fit", RIG, "  period_us: 1000\n", "  period_us: 1050\n"),
    case("timing", "low pass too high", RIG, "low_pass_hz: null", "low_pass_hz: 500"),
    case("timing", "no plant step in a period", SCENE, "plant_step_us: 100", "plant_step_us: 0"),
    linked("timing", "plant step above the period", [RIG, SCENE], "plant_step_us: 100", "plant_step_us: 2000"),
    linked("timing", "plant step of a device", [DEVICE, SPACE], "plant_step_us: 100", "plant_step_us: 300"),
    case("timing", "sensor faster than the cycle", RIG, "period_us: 1000", "period_us: 2000"),
    case("control", "rate gains in torque mode", RIG, "joint:\n      stiffness_n_m_per_rad: 6000.0\n      damping_n_m_s_per_rad: 70.0\n      integral_n_m_per_rad_s: 100000.0\n", "rate: {gain_per_s: 60.0}\n"),
    case("control", "joint gains in velocity mode", RIG, "command_mode: torque", "command_mode: velocity"),
    case("control", "no gains", RIG, "joint:\n      stiffness_n_m_per_rad: 6000.0\n      damping_n_m_s_per_rad: 70.0\n      integral_n_m_per_rad_s: 100000.0\n", "{}\n"),
    case("control", "velocity without a gain", RIG, "joint:\n      stiffness_n_m_per_rad: 6000.0\n      damping_n_m_s_per_rad: 70.0\n      integral_n_m_per_rad_s: 100000.0\n", "rate: {}\n"),
    case("reach", "circle too large", RIG, "radius_m: 0.12", "radius_m: 0.5"),
    case("reach", "disc too large", RIG, "working_radius_m: 0.16", "working_radius_m: 0.3"),
    case("reach", "loop never closes", RIG, "distal_m: [0.40, 0.40]", "distal_m: [0.01, 1.50]"),
    case("reach", "line outside", RIG, "circle: {center_m: [0.0, 0.0], radius_m: 0.12, forbidden: inside}", "line: {point_m: [0.0, 0.4], normal: [0.0, 1.0]}"),
    case("limits", "force limit below yield", RIG, "force_limit_n: 150.0", "force_limit_n: 15.0"),
    case("limits", "friction takes all torque", RIG, "torque_limit_n_m: 60.0", "torque_limit_n_m: 8.0"),
    case("limits", "residual below friction", RIG, "residual_limit_n_m: 30.0", "residual_limit_n_m: 6.0"),
    case("limits", "sensor too weak", RIG, "range_counts: 32000", "range_counts: 3000"),
    case("limits", "calibration without rows", RIG, "[0.0, 0.00625, 0.0, 0.0, 0.0, 0.0]", "[0.00625, 0.0, 0.0, 0.0, 0.0, 0.0]"),
    case("limits", "torque beyond the set-point", RIG, "rated_torque_n_m: 60.0", "rated_torque_n_m: 1.5"),
    case("limits", "torque below the set-point", RIG, "rated_torque_n_m: 60.0", "rated_torque_n_m: 90000.0"),
    case("limits", "window beyond the counter", RIG, "following_error_limit_rad: 0.05", "following_error_limit_rad: 20000.0"),
    case("limits", "torque axis without calibration", RIG, "[0.0, 0.0, 0.0, 0.0, 0.0, 0.0003]", "[0.0, 0.0, 0.0, 0.0, 0.0, 0.0]"),
    case("limits", "no deceleration", RIG, "stop_deceleration_m_per_s2: 10.0", "stop_deceleration_m_per_s2: 0.0"),
    case("scene", "missing file", RIG, "scene: scene.yaml", "scene: scenes/circle-tuor.yaml"),
    case("scene", "spatial scene on a rig", RIG, "scene: scene.yaml", "scene: space.yaml"),
    case("scene", "rig as scene", RIG, "scene: scene.yaml", "scene: device.yaml"),
    case("scene", "band of tremor", SCENE, "low_hz: 8.0", "low_hz: 15.0"),
    case("scene", "gear without link", SCENE, "joint_elasticity: null", "joint_elasticity: {stiffness_n_m_per_rad: 2.0e+4, damping_n_m_s_per_rad: 5.0, motor_share: 1.0}"),
    case("scene", "coordinates of a segment", SCENE, "point_m: [0.10, 0.06]", "point_m: [0.10, 0.06, 0.0]"),
    case("scene", "coordinates of an arc", SCENE, "center_m: [0.0, 0.0]", "center_m: [0.0, 0.0, 0.0]"),
    case("scene", "arc about its start", SCENE, "center_m: [0.0, 0.0]", "center_m: [0.10, 0.06]"),
    case("scene", "unknown fault", SCENE, "seed: 1", "seed: 1\nfaults:\n  - {inject: sensor-stick, at_s: 1.0}"),
    case("scene", "unknown target of a fault", SCENE, "seed: 1", "seed: 1\nfaults:\n  - {inject: pdo-lost, at_s: 1.0, target: left}"),
    case("scene", "target of a fault", SCENE, "seed: 1", "seed: 1\nfaults:\n  - {inject: pdo-lost, at_s: 1.0, target: sensor}"),
    case("scene", "size of a fault", SCENE, "seed: 1", "seed: 1\nfaults:\n  - {inject: encoder-jump, at_s: 1.0, size: 9.0}"),
    case("scene", "duration of a fault", SCENE, "seed: 1", "seed: 1\nfaults:\n  - {inject: drive-fault, at_s: 1.0, for_s: 1.0}"),
    case("scene", "speed of an arc", SCENE, "speed: constant", "speed: steady"),
    case("scene", "aim that errs too fast", SCENE, "  tremor:", "  aim_error: {rms_m: 0.01, corner_hz: 80.0}\n  tremor:"),
    case("scene", "aim that errs too far", SCENE, "  tremor:", "  aim_error: {rms_m: 1.0, corner_hz: 0.8}\n  tremor:"),
    case("scene", "tremor too fast", SCENE, "high_hz: 12.0", "high_hz: 120.0"),
    case("scene", "exact force", SCENE, "force_sensor: noisy", "force_sensor: exact"),
    case("scene", "no share before the gear", SCENE, "joint_elasticity: null", "joint_elasticity: {stiffness_n_m_per_rad: 2.0e+4, damping_n_m_s_per_rad: 5.0, motor_share: 0.0}"),
    case("scene", "gear without arm", SCENE, "tracking: rigid\n  plant_step_us: 100\n  encoder: quantised\n  force_sensor: noisy\n  force_noise_counts: 4.0\n  joint_elasticity: null", "tracking: ideal\n  plant_step_us: 100\n  encoder: quantised\n  force_sensor: noisy\n  force_noise_counts: 4.0\n  joint_elasticity: {stiffness_n_m_per_rad: 2.0e+4, damping_n_m_s_per_rad: 5.0, motor_share: 0.6}"),
    case("scene", "no model", SPACE, "device_model:\n  plant_step_us: 100\n", ""),
    case("scene", "two models", SCENE, "model:\n", "device_model: {plant_step_us: 100}\nmodel:\n"),
    linked("scene", "ideal tracking of torques", [RIG, SCENE], "tracking: rigid", "tracking: ideal"),
    linked("scene", "device model on a rig", [RIG, SCENE], "model:\n  tracking: rigid\n  plant_step_us: 100\n  encoder: quantised\n  force_sensor: noisy\n  force_noise_counts: 4.0\n  joint_elasticity: null\n", "device_model:\n  plant_step_us: 100\n"),
    linked("scene", "rig model on a device", [DEVICE, SPACE], "device_model:\n  plant_step_us: 100\n", "model:\n  tracking: rigid\n  plant_step_us: 100\n  encoder: quantised\n  force_sensor: noisy\n  force_noise_counts: 4.0\n  joint_elasticity: null\n"),
    linked("scene", "start out of reach", [RIG, SCENE], "start_m: [0.05, 0.03]", "start_m: [0.5, 0.5]"),
    case("figure", "hold of one step", FIGURE, "hold_steps: [0]", "hold_steps: [0, 1]"),
    case("figure", "no machine", FIGURE, "rigs:\n  cst: rig.yaml\n", ""),
    case("figure", "machine twice", FIGURE, "scene:", "device: device.yaml\nscene:"),
    case("figure", "device among the rigs", FIGURE, "cst: rig.yaml", "cst: device.yaml"),
    case("figure", "passivity above the energy limit", FIGURE, "fixture: null", "fixture: {coupling: {admittance: {mass_kg: 2.0}}, friction_n: 3.0, yield_n: 20.0, side: bilateral, hold_steps: 0, passivity: {bound_j: 2.0}, curvature: tangent, surface: {circle: {center_m: [0.0, 0.0], radius_m: 0.12, forbidden: inside}}}"),
    case("figure", "circle that replaces is too large", FIGURE, "fixture: null", "fixture: {coupling: {admittance: {mass_kg: 2.0}}, friction_n: 3.0, yield_n: 20.0, side: bilateral, hold_steps: 0, curvature: tangent, surface: {circle: {center_m: [0.0, 0.0], radius_m: 0.6, forbidden: inside}}}"),
    case("variant", "of a variant", VARIANT, "like: rig.yaml", "like: variant.yaml"),
    case("variant", "of no file", VARIANT, "like: rig.yaml", "like: rgi.yaml"),
    case("variant", "of a scene", VARIANT, "like: rig.yaml", "like: scene.yaml"),
    case("variant", "of nothing", VARIANT, "like: rig.yaml", "like:"),
    case("variant", "of two", VARIANT, "like: rig.yaml", "like: rig.yaml\nlike: rig.yaml"),
    case("variant", "of a list", VARIANT, "like: rig.yaml", "like: [rig.yaml]"),
    linked("variant", "of a file that is no YAML", [VARIANT, RIG], "cycle:\n", "cycle\n"),
    case("variant", "with a key that its base lacks", VARIANT, "yield_n: 25.0", "yield: 25.0"),
    case("variant", "with a value of another type", VARIANT, "yield_n: 25.0", "yield_n: 25 N"),
    case("variant", "with nothing for a number", VARIANT, "  yield_n: 25.0\n", "  yield_n:\n"),
    case("variant", "with a key twice", VARIANT, "yield_n: 25.0", "yield_n: 25.0\n  yield_n: 26.0"),
    linked("variant", "of a file with a key twice", [VARIANT, RIG], "friction_n: 3.0", "friction_n: 3.0\n  friction_n: 4.0"),
    case("variant", "out of range", VARIANT, "mass_kg: 3.0", "mass_kg: -3.0"),
    linked("variant", "of a file out of range", [VARIANT, RIG], "friction_n: 3.0", "friction_n: -3.0"),
    linked("variant", "with a value that does not suit its base", [VARIANT, VARIANT], "yield_n: 25.0", "yield_n: 2.0"),
    linked("variant", "of a file with a value that does not suit it", [VARIANT, RIG], "friction_n: 3.0", "friction_n: 30.0"),
    case("variant", "with half of another choice", VARIANT, "      byte_order: big_endian\n", ""),
    case("variant", "with two choices", VARIANT, "    polled:\n", "    canopen: {node_id: 9}\n    polled:\n"),
    case("variant", "with a drive that its base lacks", VARIANT, "name: right", "name: rigth"),
    case("variant", "with a drive without name", VARIANT, "name: right, ", ""),
    case("variant", "with a drive twice", VARIANT, "drives:\n", "drives:\n  - {name: right, node_id: 3}\n"),
    case("variant", "with a tag", VARIANT, "yield_n: 25.0", "yield_n: !force 25.0"),
    case("variant", "with an alias of itself", VARIANT, "  yield_n: 25.0\n", "  yield_n: 25.0\n  also: &a [*a]\n"),
    case("variant", "with a list as key", VARIANT, "fixture:\n", "? [1, 2]\n: 3\n\nfixture:\n"),
    case("wrong kind", "no configuration", "", "", "services:\n  web: {image: nginx}\n"),
    case("wrong kind", "a list", "", "", "- 1\n- 2\n"),
    case("wrong kind", "a word", "", "", "rig\n"),
    case("empty", "nothing", "", "", ""),
    case("empty", "comment", "", "", "# to be written\n"),
    case("empty", "null", "", "", "null\n"),
    case("several documents", "two", RIG, "guard:\n", "---\nguard:\n"),
    case("hostile", "alias bomb", "", "", "a: &a [x, x, x, x, x, x, x, x, x]\nb: &b [*a, *a, *a, *a, *a, *a, *a, *a, *a]\nc: &c [*b, *b, *b, *b, *b, *b, *b, *b, *b]\nd: &d [*c, *c, *c, *c, *c, *c, *c, *c, *c]\ne: &e [*d, *d, *d, *d, *d, *d, *d, *d, *d]\nf: &f [*e, *e, *e, *e, *e, *e, *e, *e, *e]\nrig: [*f, *f, *f, *f, *f, *f, *f, *f, *f]\ng: [*f, *f, *f, *f, *f, *f, *f, *f, *f]\nh: [*f, *f, *f, *f, *f, *f, *f, *f, *f]\ni: [*f, *f, *f, *f, *f, *f, *f, *f, *f]\nj: [*f, *f, *f, *f, *f, *f, *f, *f, *f]\nk: [*f, *f, *f, *f, *f, *f, *f, *f, *f]\n"),
    case("hostile", "deep nesting", "", "", "rig: [[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[1]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]\n"),
    case("hostile", "deep nesting by indentation", RIG, "name: left", "name:\n     a:\n      b:\n       c:\n        d:\n         e: {f: {g: {h: {i: {j: {k: {l: {m: {n: {o: {p: {q: {r: {s: {t: {u: {v: {w: {x: {y: {z: {a: {b: {c: {d: 1}}}}}}}}}}}}}}}}}}}}}}}}}"),
    case("hostile", "more aliases than allowed", SCENE, "    - wait: {for_s: 0.5}\n", concat!("    - &w {wait: {for_s: 0.5}}\n", ALIASES!(), ALIASES!(), ALIASES!(), ALIASES!(), ALIASES!(), ALIASES!())),
    case("hostile", "list as key", RIG, "guard:\n", "? [1, 2]\n: 3\n\nguard:\n"),
    case("several at once", "four mistakes of meaning", RIG, "  friction_n: 3.0\n  yield_n: 20.0\n  side: bilateral\n  hold_steps: 0\n", "  friction_n: 30.0\n  yield_n: 20.0\n  side: unilateral\n  hold_steps: 1\n"),
];
