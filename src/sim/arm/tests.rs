use nalgebra::{Matrix2, Vector2};
use proptest::prelude::*;
use std::f64::consts::TAU;

use super::oracle::{Oracle, STUDY_ARM, StudyArm};
use super::*;
use crate::linkage::{Chain, Geometry, Side, Tool, WristSide};

fn five_bar(arm: &StudyArm) -> FiveBar {
    FiveBar::new(Geometry {
        base_m: [[-arm.half_base_m, 0.0], [arm.half_base_m, 0.0]],
        proximal_m: [arm.proximal_m; 2],
        distal_m: [arm.distal_m; 2],
        elbows: [Side::Left, Side::Right],
        wrist: WristSide::Forward,
        tool: Tool { fixed_to: Chain::Right, along_m: 0.0, across_m: 0.0 },
    })
    .unwrap()
}

fn parameters(arm: &StudyArm) -> ArmParameters {
    ArmParameters {
        linkage: five_bar(arm),
        mass: MassModel {
            motor_kg_m2: [arm.motor_kg_m2; 2],
            proximal_kg: [arm.proximal_kg; 2],
            distal_kg: [arm.distal_kg; 2],
            tool_kg: arm.tool_kg,
        },
        handle_kg: 0.0,
        coulomb_n_m: [arm.coulomb_n_m; 2],
        viscous_n_m_s_per_rad: [arm.viscous_n_m_s_per_rad; 2],
        joint_elasticity: None,
    }
}

fn arm_at(parameters: &ArmParameters, tip: Vector2<f64>) -> Arm {
    let start = parameters.linkage.inverse(TipPoint(tip)).unwrap();
    Arm::new(parameters, start).unwrap()
}

fn no_load(_: f64, _: TipPoint) -> HandLoad<2> {
    HandLoad::default()
}

fn push(force_n: Vector2<f64>) -> impl Fn(f64, TipPoint) -> HandLoad<2> {
    move |_, _| HandLoad { force_n, ..HandLoad::default() }
}

/// The study: an arc to and fro, tracked by a PD controller at 1 kHz, while a hand aims 8 mm beside it and trembles.
#[derive(Clone, Copy)]
struct Study {
    hand_n_per_m: f64,
    hand_n_s_per_m: f64,
    duration_ms: u32,
}

const STUDY: Study = Study { hand_n_per_m: 500.0, hand_n_s_per_m: 15.0, duration_ms: 2000 };

impl Study {
    fn on_arc(radius_m: f64, time_s: f64) -> (Vector2<f64>, Vector2<f64>) {
        let (sin, cos) = (TAU * time_s).sin_cos();
        let (angle, rate) = (0.3 + 0.75 * (1.0 - cos), 0.75 * TAU * sin);
        let direction = Vector2::new(angle.cos(), angle.sin());
        let point = Vector2::new(0.0, 0.36) + direction * radius_m;
        (point, Vector2::new(-direction.y, direction.x) * (rate * radius_m))
    }

    fn hand_target(time_s: f64) -> (Vector2<f64>, Vector2<f64>) {
        let (sin, cos) = (TAU * 9.0 * time_s).sin_cos();
        let (point, velocity) = Self::on_arc(0.108 + 0.5e-3 * sin, time_s);
        let outward = (point - Vector2::new(0.0, 0.36)).normalize();
        (point, velocity + outward * (0.5e-3 * TAU * 9.0 * cos))
    }

    fn control(time_s: f64, angles: Vector2<f64>, rates: Vector2<f64>) -> Vector2<f64> {
        let (point, velocity) = Self::on_arc(0.10, time_s);
        let wanted = STUDY_ARM.inverse(point);
        let jacobian = STUDY_ARM.motion(wanted, Vector2::zeros()).jacobian;
        (wanted - angles) * 4000.0 + (jacobian.try_inverse().unwrap() * velocity - rates) * 45.0
    }

    /// Tool points at each millisecond.
    fn run(&self, step_s: f64) -> Vec<Vector2<f64>> {
        let parameters = parameters(&STUDY_ARM);
        let mut arm = arm_at(&parameters, Self::on_arc(0.10, 0.0).0);
        let load = |time_s: f64, tip: TipPoint| {
            let (target, velocity) = Self::hand_target(time_s);
            HandLoad {
                force_n: (target - tip.0) * self.hand_n_per_m + velocity * self.hand_n_s_per_m,
                damping_n_s_per_m: self.hand_n_s_per_m,
                stiffness_n_per_m: self.hand_n_per_m,
            }
        };
        (0..self.duration_ms)
            .map(|ms| {
                let torque = Self::control(arm.time_s(), arm.angles().0, arm.rates().0);
                arm.advance_to(f64::from(ms + 1) * 1e-3, step_s, JointTorques(torque), load).unwrap();
                arm.tip().unwrap().position.0
            })
            .collect()
    }

    fn run_oracle(&self, step_s: f64) -> (Vec<Vector2<f64>>, u32) {
        let load = |time_s: f64, tip: Vector2<f64>, tip_velocity: Vector2<f64>| {
            let (target, velocity) = Self::hand_target(time_s);
            (target - tip) * self.hand_n_per_m + (velocity - tip_velocity) * self.hand_n_s_per_m
        };
        let start = STUDY_ARM.inverse(Self::on_arc(0.10, 0.0).0);
        let mut oracle = Oracle::new(STUDY_ARM, start, load);
        let tips = (0..self.duration_ms)
            .map(|ms| {
                let torque = Self::control(oracle.time_s, oracle.angles, oracle.rates);
                oracle.run_to(f64::from(ms + 1) * 1e-3, step_s, torque);
                STUDY_ARM.motion(oracle.angles, oracle.rates).tip
            })
            .collect();
        (tips, oracle.events)
    }
}

fn greatest_distance(one: &[Vector2<f64>], other: &[Vector2<f64>]) -> f64 {
    assert_eq!(one.len(), other.len());
    one.iter().zip(other).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
}

#[test]
fn probe() {
    let (truth, events) = STUDY.run_oracle(0.25e-3);
    let (finer, _) = STUDY.run_oracle(0.1e-3);
    println!("events {events}, oracle self {:e}", greatest_distance(&truth, &finer));
    for step in [1e-3, 0.5e-3, 0.25e-3, 1e-4, 5e-5, 2e-5, 1e-5] {
        println!("{step:e}: {:e}", greatest_distance(&STUDY.run(step), &finer));
    }
    for k in [5e3, 5e4, 1e6] {
        let stiff = Study { hand_n_per_m: k, ..STUDY };
        let (a, events) = stiff.run_oracle(1e-4);
        let (b, _) = stiff.run_oracle(2e-6);
        println!("{k} events {events}, oracle self {:e}", greatest_distance(&a, &b));
        let fine = stiff.run(2e-6);
        println!("fine to oracle {:e}", greatest_distance(&fine, &b));
        for step in [1e-3, 0.25e-3, 1e-4, 5e-5, 2e-5, 1e-5] {
            let r = stiff.run(step);
            println!("{step:e}: oracle {:e} self {:e}", greatest_distance(&r, &b), greatest_distance(&r, &fine));
        }
    }
}
