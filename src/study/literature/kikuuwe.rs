//! One joint under admittance control that is blocked for a second, by laws that bound its torque.

use std::f64::consts::TAU;

use serde_json::Value;

use crate::sweep::{Clock, Report, Sweep, Table};
use yieldwall_motion::control::{Axis, AxisController, EffortRange, Gains, Law};
use yieldwall_motion::elementary;

const PERIOD_S: f64 = 1e-3;
const JOINT_KG_M2: f64 = 0.3;
const VISCOUS_N_M_S: f64 = 1.0;
const PROXY_KG_M2: f64 = 0.5;
const PROXY_N_M_S: f64 = 2.0;
const GAINS: Gains = Gains { stiffness: 6000.0, damping: 70.0, integral: 20_000.0 };
const SLIDING_S: f64 = 0.1;
const LIMIT_N_M: f64 = 30.0;
/// Torque of the hand while the joint is blocked.
const HAND_N_M: f64 = 5.0;
const BLOCKED_S: f64 = 1.0;
const AFTERWARDS_S: f64 = 4.0;
/// Rest is nearer than this to where the reference ends, rad.
const REST_RAD: f64 = 1e-3;

/// A law, and whether the reference is drawn back to where the law would want no more than it may.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Case {
    law: Law,
    is_drawn_back: bool,
}

const CASES: [Case; 4] = [
    Case { law: Law::Pid, is_drawn_back: false },
    Case { law: Law::Psmc, is_drawn_back: false },
    Case { law: Law::Pid, is_drawn_back: true },
    Case { law: Law::Psmc, is_drawn_back: true },
];

impl Case {
    fn name(self) -> &'static str {
        match (self.law, self.is_drawn_back) {
            (Law::Pid, false) => "PID, integral clamped",
            (Law::Psmc, false) => "PSMC",
            (Law::Pid, true) => "PID, reference drawn back",
            (Law::Psmc, true) => "PSMC, reference drawn back",
        }
    }

    fn controller(self) -> Axis {
        let law = self.law.controller(GAINS, SLIDING_S, PERIOD_S);
        law.unwrap_or_else(|error| unreachable!("gains above zero: {error}"))
    }
}

/// A joint under its law, and the proxy that it follows.
struct Joint {
    case: Case,
    law: Axis,
    angle_rad: f64,
    rate_rad_per_s: f64,
    reference_rad: f64,
    earlier_rad: f64,
}

impl Joint {
    fn new(case: Case) -> Self {
        Self { case, law: case.controller(), angle_rad: 0.0, rate_rad_per_s: 0.0, reference_rad: 0.0, earlier_rad: 0.0 }
    }

    /// One period under a torque of the hand; the torque of the law.
    fn step(&mut self, hand_n_m: f64, limit_n_m: f64, is_blocked: bool) -> f64 {
        let inert = PROXY_KG_M2 + PROXY_N_M_S * PERIOD_S;
        let moved = (self.reference_rad - self.earlier_rad) * PROXY_KG_M2 / inert;
        let next = self.reference_rad + moved + hand_n_m * PERIOD_S * PERIOD_S / inert;
        self.earlier_rad = self.reference_rad;
        self.reference_rad = next;
        let error = self.reference_rad - self.angle_rad;
        let step = self.law.step(error, EffortRange::symmetric(limit_n_m));
        if self.case.is_drawn_back && step.saturated {
            let by = (step.wanted - step.effort) / self.law.step_stiffness();
            self.reference_rad -= by;
            self.law.draw_back(error - by);
        }
        if is_blocked {
            self.rate_rad_per_s = 0.0;
        } else {
            // Exact under a held torque.
            let lost = -elementary::exp_m1(-VISCOUS_N_M_S / JOINT_KG_M2 * PERIOD_S);
            let end = step.effort / VISCOUS_N_M_S;
            self.angle_rad += end * PERIOD_S + (self.rate_rad_per_s - end) * lost * JOINT_KG_M2 / VISCOUS_N_M_S;
            self.rate_rad_per_s += (end - self.rate_rad_per_s) * lost;
        }
        step.effort
    }
}

/// Greatest difference from PID in N m and greatest torque, with the same errors and no limit.
fn unsaturated(case: Case) -> (f64, f64) {
    let (mut joint, mut law) = (Joint::new(CASES[0]), case.controller());
    let (mut difference, mut most) = (0.0_f64, 0.0_f64);
    for cycle in 0..5000 {
        let hand_n_m = HAND_N_M * elementary::sin(TAU * 0.7 * f64::from(cycle) * PERIOD_S);
        let before_rad = joint.angle_rad;
        let effort = joint.step(hand_n_m, 1e9, false);
        let same = law.step(joint.reference_rad - before_rad, EffortRange::symmetric(1e9)).effort;
        difference = difference.max((same - effort).abs());
        most = most.max(effort.abs());
    }
    (difference, most)
}

/// Last bits of the greatest torque in which both differ.
fn bits(difference: f64, most: f64) -> f64 {
    elementary::ln(1.0 + difference / (f64::EPSILON * most)) / std::f64::consts::LN_2
}

/// Motion of a joint that was blocked and is released.
#[derive(Clone, Copy, Debug, PartialEq)]
struct LetGo {
    /// Reference ahead of the joint at the end of the block, rad.
    lead_rad: f64,
    fastest_rad_per_s: f64,
    /// Beyond the place where the reference ends, rad.
    overshoot_rad: f64,
    rest_s: f64,
}

fn let_go(case: Case) -> LetGo {
    let mut joint = Joint::new(case);
    let cycles = |time_s: f64| (time_s / PERIOD_S).round() as u32;
    for _ in 0..cycles(BLOCKED_S) {
        joint.step(HAND_N_M, LIMIT_N_M, true);
    }
    let lead_rad = joint.reference_rad - joint.angle_rad;
    let mut angles = Vec::new();
    let mut fastest_rad_per_s = 0.0_f64;
    for _ in 0..cycles(AFTERWARDS_S) {
        joint.step(0.0, LIMIT_N_M, false);
        fastest_rad_per_s = fastest_rad_per_s.max(joint.rate_rad_per_s.abs());
        angles.push(joint.angle_rad);
    }
    let end_rad = joint.reference_rad;
    let overshoot_rad = angles.iter().map(|angle| angle - end_rad).fold(0.0, f64::max);
    let moving = angles.iter().rposition(|angle| (angle - end_rad).abs() > REST_RAD);
    LetGo {
        lead_rad,
        fastest_rad_per_s,
        overshoot_rad,
        rest_s: moving.map_or(0.0, |last| (last + 1) as f64 * PERIOD_S),
    }
}

/// Every law.
pub(super) struct Laws;

impl Sweep for Laws {
    fn name(&self) -> &'static str {
        "kikuuwe"
    }

    fn columns(&self) -> Vec<&str> {
        vec![
            "law",
            "difference_n_m",
            "torque_n_m",
            "differing_bits",
            "lead_rad",
            "fastest_rad_per_s",
            "overshoot_rad",
            "rest_s",
        ]
    }

    fn points(&self) -> u64 {
        CASES.len() as u64
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let case = CASES[index as usize];
        let (difference, most) = unsaturated(case);
        let found = let_go(case);
        vec![
            case.name().into(),
            difference.into(),
            most.into(),
            bits(difference, most).into(),
            found.lead_rad.into(),
            found.fastest_rad_per_s.into(),
            found.overshoot_rad.into(),
            found.rest_s.into(),
        ]
    }
}

pub(super) fn report(table: &Table, report: &mut Report) {
    report.notes.push(format!(
        "Kikuuwe 2019, one joint blocked for {BLOCKED_S} s under {HAND_N_M} N m, with {LIMIT_N_M} N m at most, then let go:"
    ));
    for row in table.rows() {
        report.notes.push(format!(
            "  {:27} unsaturated {:.1e} N m off PID ({:.1} bits); reference {:.4} rad ahead, then up to {:.3} rad/s, {:.5} rad too far, at rest after {:.2} s",
            row.word("law"),
            row.number("difference_n_m"),
            row.number("differing_bits"),
            row.number("lead_rad"),
            row.number("fastest_rad_per_s"),
            row.number("overshoot_rad"),
            row.number("rest_s"),
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The paper's statement: a bounded law is the unbounded one until it saturates, and then neither snaps back nor overshoots.
    #[test]
    fn bounded_laws_neither_snap_back_nor_overshoot() {
        let [pid, psmc, pid_drawn, psmc_drawn] = CASES.map(let_go);
        assert!(pid.overshoot_rad > 0.05 && pid.fastest_rad_per_s > 5.0, "{pid:?}");
        assert!(psmc.overshoot_rad < 1e-3, "{psmc:?}");
        for drawn in [pid_drawn, psmc_drawn] {
            assert!(drawn.lead_rad < 0.02 && drawn.fastest_rad_per_s < 0.5 && drawn.overshoot_rad < 1e-3, "{drawn:?}");
        }
        assert_eq!(unsaturated(CASES[0]).0, 0.0);
        for case in CASES {
            let (difference, most) = unsaturated(case);
            assert!(difference <= 1e-12 * most, "{case:?} {difference} {most}");
        }
    }
}
