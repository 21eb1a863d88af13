use super::*;
use crate::elementary;
use crate::quantity::{JointRates, JointTorques};
use nalgebra::{Matrix2, Vector2};

const MASSES: MassModel =
    MassModel { motor_kg_m2: [0.2, 0.15], proximal_kg: [0.8, 0.6], distal_kg: [0.5, 0.4], tool_kg: 0.7 };

/// The masses of `config/paper-admittance.yaml`.
const PAPER_MASSES: MassModel =
    MassModel { motor_kg_m2: [0.25; 2], proximal_kg: [0.0; 2], distal_kg: [0.0; 2], tool_kg: 1.0 };

const DESK_MASSES: MassModel =
    MassModel { motor_kg_m2: [0.2; 2], proximal_kg: [0.8; 2], distal_kg: [0.5; 2], tool_kg: 0.5 };

fn model() -> impl Strategy<Value = MassModel> {
    let rods = || prop_oneof![1 => Just([0.0; 2]), 3 => [0.0..2.0_f64, 0.0..2.0_f64]];
    ([0.01..0.5_f64, 0.01..0.5_f64], rods(), rods(), 0.0..2.0_f64).prop_map(
        |(motor_kg_m2, proximal_kg, distal_kg, tool_kg)| MassModel { motor_kg_m2, proximal_kg, distal_kg, tool_kg },
    )
}

fn rates() -> impl Strategy<Value = JointRates> {
    [-3.0..3.0_f64, -3.0..3.0_f64].prop_map(JointRates::from)
}

fn moved(posture: &Posture, rates: JointRates, time: f64) -> JointAngles {
    posture.angles + rates.for_s(time)
}

/// Kinetic energy from the bodies' own velocities: rods by their centre and their turning, all by differences of the
/// points of the forward map.
fn energy_of_bodies(arm: &FiveBar, model: &MassModel, posture: &Posture, rates: JointRates) -> f64 {
    let geometry = arm.geometry();
    let points: [f64; 8] = derivative(1e-4, |time| {
        let at = arm.forward(moved(posture, rates, time)).unwrap();
        let [e0, e1] = at.elbows_m;
        let [tx, ty] = at.tip.to_array();
        [e0[0], e0[1], e1[0], e1[1], at.wrist_m[0], at.wrist_m[1], tx, ty]
    });
    let velocity = |i: usize| Vector2::new(points[2 * i], points[2 * i + 1]);
    let (wrist, tip) = (velocity(2), velocity(3));
    let mut energy = 0.5 * model.tool_kg * tip.norm_squared();
    for i in 0..2 {
        let elbow = velocity(i);
        let rate = rates.0[i];
        let proximal = model.proximal_kg[i] * elementary::powi(geometry.proximal_m[i], 2);
        // A rod about its end: its centre moves with half its length, and it turns about its centre.
        energy += 0.5 * (model.motor_kg_m2[i] + proximal / 4.0 + proximal / 12.0) * rate * rate;
        let centre = 0.5 * (elbow + wrist);
        let turn_rate = (wrist - elbow).norm() / geometry.distal_m[i];
        let about_centre = model.distal_kg[i] * elementary::powi(geometry.distal_m[i], 2) / 12.0;
        energy += 0.5 * model.distal_kg[i] * centre.norm_squared() + 0.5 * about_centre * turn_rate * turn_rate;
    }
    energy
}

#[test]
fn skew_scene_has_the_equations_of_a_computation_with_60_digits() {
    let arm = five_bar(SKEW);
    let found = arm.dynamics(&MASSES, JointAngles::new(2.1, 0.9), JointRates::new(1.3, -2.1)).unwrap();
    let mass = Matrix2::new(0.3000180526577848, -0.0066430576831253045, -0.0066430576831253045, 0.3095466044492046);
    assert!((found.mass - mass).amax() < 1e-15);
    assert!(gap(found.bias.to_array(), [0.4396193529101255, -0.3798663172707585]) < 1e-15, "{:?}", found.bias);
}

#[test]
fn paper_scene_has_the_equations_of_a_computation_with_60_digits() {
    let arm = five_bar(PAPER);
    let cases = [
        (
            [0.0, 0.0],
            0.34415889732550675,
            -0.0244640408485793,
            0.34415889732550675,
            [0.24965819821165408, -0.05238627359227355],
        ),
        (
            [0.1, 0.06],
            0.33607926274599764,
            0.0003219020684536308,
            0.3398418131601902,
            [0.23036467826909687, -0.06903812754940136],
        ),
        (
            [-0.08, 0.12],
            0.33605584037642167,
            0.01937522399296155,
            0.3263727601152098,
            [0.19635221320410423, -0.11633835474559696],
        ),
    ];
    for (tip, m00, m01, m11, bias) in cases {
        let angles = arm.inverse(TipPoint::from(tip)).unwrap();
        let found = arm.dynamics(&PAPER_MASSES, angles, JointRates::new(1.0, 2.0)).unwrap();
        assert!((found.mass - Matrix2::new(m00, m01, m01, m11)).amax() < 1e-15);
        assert!(gap(found.bias.to_array(), bias) < 2e-15, "{:?}", found.bias);
    }
}

/// Mass at the handle along the axis of symmetry, from an independent study of this arm.
#[test]
fn desk_scene_has_the_known_mass_at_the_handle() {
    let arm = five_bar(DESK);
    let handle = |y: f64| {
        let angles = arm.inverse(point(0.0, y)).unwrap();
        let at = arm.dynamics(&DESK_MASSES, angles, JointRates::default()).unwrap();
        (at.jacobian * at.mass.try_inverse().unwrap() * at.jacobian.transpose()).try_inverse().unwrap()
    };
    let reach = (elementary::powi(0.55, 2) - elementary::powi(0.05, 2)).sqrt();
    let near =
        |found: f64, expected: f64, share: f64| assert!((found / expected - 1.0).abs() < share, "{found} {expected}");
    near(handle(0.36).m11, 5.5, 0.01);
    near(handle(0.36).m22, 3.9, 0.01);
    near(handle(0.05).m11, 219.0, 0.01);
    near(handle(0.001).m11, 5.5e5, 0.01);
    near(handle(reach - 0.1).m22, 6.0, 0.1);
    near(handle(reach - 0.01).m22, 49.0, 0.02);
    near(handle(reach - 0.001).m22, 490.0, 0.02);
}

#[test]
fn a_parallelogram_without_rods_has_the_inertias_of_two_vectors() {
    let arm = five_bar(PARALLELOGRAM);
    let found = arm.dynamics(&PAPER_MASSES, JointAngles::new(2.0, 0.7), JointRates::new(3.0, -2.0)).unwrap();
    // The tool is 0.3 (u(2.0) + u(0.7)), so m l^2 and the angle between the cranks say it all.
    let coupling = 0.09 * elementary::cos(1.3);
    assert!((found.mass - Matrix2::new(0.34, coupling, coupling, 0.34)).amax() < 1e-15);
    let sine = 0.09 * elementary::sin(1.3);
    assert!(gap(found.bias.to_array(), [sine * 4.0, -sine * 9.0]) < 1e-14, "{:?}", found.bias);
    let expected = [
        -0.3 * (9.0 * elementary::cos(2.0) + 4.0 * elementary::cos(0.7)),
        -0.3 * (9.0 * elementary::sin(2.0) + 4.0 * elementary::sin(0.7)),
    ];
    assert!(gap(found.tip_bias_m_per_s2, expected) < 1e-14);
}

#[test]
fn masses_of_no_machine_are_refused() {
    assert_eq!(MASSES.check(), Ok(()));
    assert_eq!(PAPER_MASSES.check(), Ok(()));
    for bad in [-1e-9, f64::NAN, f64::INFINITY] {
        let refused = |model: MassModel| match model.check() {
            Err(GeometryError::Mass { what, .. }) => what,
            other => panic!("{other:?}"),
        };
        assert_eq!(refused(MassModel { motor_kg_m2: [0.1, bad], ..MASSES }), "motor_kg_m2");
        assert_eq!(refused(MassModel { proximal_kg: [bad, 0.1], ..MASSES }), "proximal_kg");
        assert_eq!(refused(MassModel { distal_kg: [0.1, bad], ..MASSES }), "distal_kg");
        assert_eq!(refused(MassModel { tool_kg: bad, ..MASSES }), "tool_kg");
    }
    assert!(MassModel { motor_kg_m2: [0.0, 0.1], ..MASSES }.check().is_err());
    let nothing = MassModel { motor_kg_m2: [0.0; 2], proximal_kg: [0.0; 2], distal_kg: [0.0; 2], tool_kg: 0.0 };
    let refused = five_bar(SKEW).dynamics(&nothing, JointAngles::new(2.1, 0.9), JointRates::default());
    assert_eq!(refused, Err(LinkageError::MassNotPositive { determinant: 0.0 }));
}

#[test]
fn rates_of_no_machine_are_refused() {
    let arm = five_bar(SKEW);
    for bad in [1.1 * RATE_LIMIT_RAD_PER_S, -f64::MAX, f64::NAN, f64::INFINITY] {
        for rates in [JointRates::new(bad, 0.0), JointRates::new(0.0, bad)] {
            let refused = arm.dynamics(&MASSES, JointAngles::new(2.1, 0.9), rates);
            assert!(
                matches!(refused, Err(LinkageError::NotFinite { what: "joint rates in rad/s", .. })),
                "{refused:?}"
            );
        }
    }
}

/// A frictionless arm that has been pushed keeps its energy over a second of classical fourth-order Runge-Kutta.
#[test]
fn energy_is_kept_in_a_frictionless_run() {
    for (geometry, model, start) in
        [(SKEW, MASSES, [2.1, 0.9]), (DESK, DESK_MASSES, [2.2, 0.9]), (PAPER, PAPER_MASSES, [2.4, 0.76])]
    {
        let arm = five_bar(geometry);
        let slope = |q: Vector2<f64>, v: Vector2<f64>| {
            let at = arm.dynamics(&model, JointAngles(q), JointRates(v)).unwrap();
            at.mass.try_inverse().unwrap() * -at.bias.0
        };
        let energy = |q: Vector2<f64>, v: Vector2<f64>| {
            let at = arm.dynamics(&model, JointAngles(q), JointRates(v)).unwrap();
            0.5 * v.dot(&(at.mass * v))
        };
        let (mut q, mut v) = (Vector2::from(start), Vector2::new(0.3, -0.2));
        let first = energy(q, v);
        let path = q;
        let mut swing: f64 = 0.0;
        let step = 1e-3;
        for _ in 0..1000 {
            let a1 = slope(q, v);
            let (v2, a2) = (v + a1 * (step / 2.0), slope(q + v * (step / 2.0), v + a1 * (step / 2.0)));
            let (v3, a3) = (v + a2 * (step / 2.0), slope(q + v2 * (step / 2.0), v + a2 * (step / 2.0)));
            let (v4, a4) = (v + a3 * step, slope(q + v3 * step, v + a3 * step));
            q += (v + 2.0 * v2 + 2.0 * v3 + v4) * (step / 6.0);
            v += (a1 + 2.0 * a2 + 2.0 * a3 + a4) * (step / 6.0);
            swing = swing.max((v - Vector2::new(0.3, -0.2)).amax());
        }
        assert!((q - path).amax() > 0.1 && swing > 0.005, "the run must move: {q} {swing}");
        assert!((energy(q, v) / first - 1.0).abs() < 1e-11, "{}", energy(q, v) / first - 1.0);
    }
}

proptest! {
    #[test]
    fn mass_matrix_is_symmetric_positive_and_gives_the_energy_of_the_bodies(
        (arm, posture) in posed(0.02),
        model in model(),
        rates in rates(),
    ) {
        let found = arm.dynamics(&model, posture.angles, rates).unwrap();
        prop_assert_eq!(found.mass.m12, found.mass.m21);
        prop_assert!(found.mass.symmetric_eigenvalues().min() > 0.0);
        let energy = 0.5 * rates.0.dot(&(found.mass * rates.0));
        let expected = energy_of_bodies(&arm, &model, &posture, rates);
        prop_assert!((energy - expected).abs() < 1e-6 * expected, "{energy} {expected}");
    }

    #[test]
    fn kinematics_agree_with_the_posture((arm, posture) in posed(1e-3), rates in rates()) {
        let found = arm.dynamics(&MASSES, posture.angles, rates).unwrap();
        prop_assert_eq!(found.tip, posture.tip);
        prop_assert_eq!(found.jacobian, posture.jacobian);
        let velocity = posture.tip_velocity(rates).unwrap();
        let tolerance = 8e-15 * (1.0 + posture.jacobian.amax());
        prop_assert!(gap(found.tip_velocity.to_array(), velocity.to_array()) <= tolerance);
    }

    #[test]
    fn tip_bias_is_the_change_of_the_jacobian_along_the_motion((arm, posture) in posed(0.02), rates in rates()) {
        let found = arm.dynamics(&MASSES, posture.angles, rates).unwrap();
        let expected = derivative(1e-4, |time| {
            let at = arm.forward(moved(&posture, rates, time)).unwrap();
            at.tip_velocity(rates).unwrap().to_array()
        });
        let size = 1.0 + expected[0].abs().max(expected[1].abs());
        let bias = found.tip_bias_m_per_s2;
        prop_assert!(gap(bias, expected) < 1e-5 * size, "{bias:?} {expected:?}");
    }

    /// Lagrange: bias_k = sum_j dM_kj/dt q'_j - 1/2 q' (dM/dq_k) q'.
    #[test]
    fn bias_is_that_of_lagrange((arm, posture) in posed(0.02), model in model(), rates in rates()) {
        let mass = |angles: JointAngles| arm.dynamics(&model, angles, JointRates::default()).unwrap().mass;
        let along = derivative(1e-4, |time| (mass(moved(&posture, rates, time)) * rates.0).into());
        let energy = derivative::<2>(1e-4, |step| {
            std::array::from_fn(|k| {
                let mut angles = posture.angles;
                angles.0[k] += step;
                0.5 * rates.0.dot(&(mass(angles) * rates.0))
            })
        });
        let expected = [along[0] - energy[0], along[1] - energy[1]];
        let found = arm.dynamics(&model, posture.angles, rates).unwrap().bias;
        let size = 1.0 + along.iter().chain(&energy).fold(0.0, |most: f64, x| most.max(x.abs()));
        prop_assert!(gap(found.to_array(), expected) < 1e-5 * size, "{found:?} {expected:?}");
    }

    /// The short cut for rods without mass is no other equation: all is linear in the masses.
    #[test]
    fn equations_are_linear_in_the_masses((arm, posture) in posed(0.01), model in model(), rates in rates()) {
        let of = |model: MassModel| arm.dynamics(&model, posture.angles, rates).unwrap();
        let rods = of(MassModel { tool_kg: 0.0, ..model });
        let tool = of(MassModel { proximal_kg: [0.0; 2], distal_kg: [0.0; 2], ..model });
        let motors = of(MassModel { proximal_kg: [0.0; 2], distal_kg: [0.0; 2], tool_kg: 0.0, ..model });
        let all = of(model);
        prop_assert!((rods.mass + tool.mass - motors.mass - all.mass).amax() < 1e-13 * (1.0 + all.mass.amax()));
        prop_assert_eq!(motors.bias, JointTorques::default());
        let size = 1.0 + rods.bias.max_abs() + tool.bias.max_abs();
        prop_assert!((rods.bias + tool.bias - all.bias).max_abs() < 1e-13 * size);
    }

    /// The power of the torques is the change of the energy.
    #[test]
    fn torques_do_the_work_that_the_energy_gains(
        (arm, posture) in posed(0.02),
        model in model(),
        rates in rates(),
        acceleration in [-20.0..20.0_f64, -20.0..20.0_f64],
    ) {
        let torque = arm.torque_for(&model, posture.angles, rates, acceleration).unwrap();
        let change = Vector2::from(acceleration);
        let [gain] = derivative(1e-4, |time| {
            let angles = JointAngles(posture.angles.0 + rates.0 * time + change * (0.5 * time * time));
            let now = JointRates(rates.0 + change * time);
            let mass = arm.dynamics(&model, angles, now).unwrap().mass;
            [0.5 * now.0.dot(&(mass * now.0))]
        });
        let power = torque.0.dot(&rates.0);
        let size = 1.0 + torque.max_abs() * rates.max_abs();
        prop_assert!((power - gain).abs() < 1e-5 * size, "{power} {gain}");
    }
}
