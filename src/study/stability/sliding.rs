//! Sliding mode after saturation: overshoot against the time constant `H`.

use serde_json::Value;

use super::held::PERIOD_S;
use super::{STUDY, cell};
use crate::chart::{Axis, Chart, Color, Mark, Panel, Series};
use crate::sweep::{Clock, Report, Sweep, Table};
use yieldwall_motion::control::{AxisController, EffortRange, Gains, Psmc};
use yieldwall_sim::arm::slip_rate;

/// One joint of the rig of the paper with its gains.
const INERTIA_KG_M2: f64 = 0.35;
const GAINS: Gains = Gains { stiffness: 10_000.0, damping: 95.0, integral: 150_000.0 };
const DELAY_CYCLES: usize = 1;
const SUBSTEPS: u32 = 10;
const LIMITS_N_M: [f64; 2] = [20.0, 60.0];
const FRICTIONS_N_M: [f64; 2] = [0.0, 10.0];
const STEPS_RAD: [f64; 5] = [0.05, 0.1, 0.2, 0.4, 0.8];
const TIMES: u64 = 40;
const TIMES_S: [f64; 2] = [1e-3, 0.2];
const DURATION_S: f64 = 4.0;
/// The factor of the law `H >= 1.3 v/(2 a)`.
const LAW: f64 = 1.3;
/// Below this share of the step it counts as none.
const OVERSHOOT: f64 = 0.01;

/// A step of the set-point of one joint that saturates its torque, for every `H`.
pub(super) struct Overshoot;

impl Sweep for Overshoot {
    fn name(&self) -> &'static str {
        "sliding"
    }

    fn columns(&self) -> Vec<&str> {
        vec![
            "torque_limit_n_m",
            "friction_n_m",
            "step_rad",
            "sliding_time_s",
            "peak_rad_per_s",
            "law_time_s",
            "overshoot_share",
        ]
    }

    fn points(&self) -> u64 {
        (LIMITS_N_M.len() * FRICTIONS_N_M.len() * STEPS_RAD.len()) as u64 * TIMES
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let (case, time) = (index as usize / TIMES as usize, index % TIMES);
        let step_rad = STEPS_RAD[case % STEPS_RAD.len()];
        let friction_n_m = FRICTIONS_N_M[case / STEPS_RAD.len() % FRICTIONS_N_M.len()];
        let limit_n_m = LIMITS_N_M[case / STEPS_RAD.len() / FRICTIONS_N_M.len()];
        let sliding_time_s = cell(time, TIMES, TIMES_S);
        let found = run(limit_n_m, friction_n_m, step_rad, sliding_time_s);
        let law_s = found.map(|(peak, _)| LAW * peak * INERTIA_KG_M2 / (2.0 * (limit_n_m + friction_n_m)));
        vec![
            limit_n_m.into(),
            friction_n_m.into(),
            step_rad.into(),
            sliding_time_s.into(),
            found.map(|(peak, _)| peak).into(),
            law_s.into(),
            found.map(|(_, overshoot)| overshoot).into(),
        ]
    }
}

/// Peak speed in rad/s and overshoot as a share of the step.
fn run(limit_n_m: f64, friction_n_m: f64, step_rad: f64, sliding_time_s: f64) -> Option<(f64, f64)> {
    let mut law = Psmc::new(GAINS, sliding_time_s, PERIOD_S).ok()?;
    law.reset(step_rad);
    let range = EffortRange::symmetric(limit_n_m);
    let mut efforts = [0.0; DELAY_CYCLES + 1];
    let (mut angle, mut rate) = (0.0, 0.0);
    let (mut peak, mut farthest): (f64, f64) = (0.0, 0.0);
    let dt = PERIOD_S / f64::from(SUBSTEPS);
    for _ in 0..(DURATION_S / PERIOD_S) as u32 {
        efforts.rotate_right(1);
        efforts[0] = law.step(step_rad - angle, range).effort;
        for _ in 0..SUBSTEPS {
            let before: f64 = rate;
            rate = slip_rate(INERTIA_KG_M2, INERTIA_KG_M2 * rate + dt * efforts[DELAY_CYCLES], dt * friction_n_m);
            angle += 0.5 * (before + rate) * dt;
            peak = peak.max(rate.abs());
            farthest = farthest.max(angle);
        }
    }
    Some((peak, (farthest - step_rad).max(0.0) / step_rad))
}

pub(super) fn report(table: &Table, report: &mut Report) {
    let (mut kept, mut broken, mut needless) = (0, Vec::new(), 0);
    let mut saturated = 0;
    for row in table.rows() {
        let is_free = row.number("overshoot_share") <= OVERSHOOT;
        saturated += 1;
        match (row.number("sliding_time_s") >= row.number("law_time_s"), is_free) {
            (true, true) => kept += 1,
            (true, false) => broken.push(row.command(STUDY)),
            (false, true) => needless += 1,
            (false, false) => {}
        }
    }
    report.notes.push(format!(
        "sliding mode after saturation, {saturated} steps: H >= 1.3 v/(2 a) leaves {kept} without overshoot above 1 %, {} with{}; \
         {needless} of those below it have none either",
        broken.len(),
        broken.first().map_or(String::new(), |again| format!(" (first: {again})"))
    ));
    let mut panels = Vec::new();
    for limit_n_m in LIMITS_N_M {
        for friction_n_m in FRICTIONS_N_M {
            let mut series: Vec<_> = STEPS_RAD
                .into_iter()
                .zip(Color::LINES)
                .map(|(step_rad, color)| Series {
                    name: format!("step of {step_rad} rad"),
                    points: table
                        .rows()
                        .filter(|row| {
                            row.number("torque_limit_n_m") == limit_n_m
                                && row.number("friction_n_m") == friction_n_m
                                && row.number("step_rad") == step_rad
                        })
                        .map(|row| {
                            let ratio = row.number("sliding_time_s") / row.number("law_time_s");
                            (ratio, 100.0 * row.number("overshoot_share"))
                        })
                        .collect(),
                    mark: Mark::MarkedLine,
                    color,
                })
                .collect();
            series.push(Series {
                name: "H = 1.3 v/(2 a)".to_owned(),
                points: vec![(1.0, 0.0), (1.0, 60.0)],
                mark: Mark::Line,
                color: Color::Black,
            });
            panels.push(Panel {
                title: format!("limit {limit_n_m} N m, friction {friction_n_m} N m"),
                x: Axis::logarithmic("H over 1.3 v/(2 a)").over(0.01, 10.0),
                y: Axis::linear("overshoot (% of the step)").over(-2.0, 60.0),
                series,
            });
        }
    }
    let chart = Chart { title: "Overshoot of one joint under PSMC after saturation".to_owned(), panels };
    report.charts.push(("study-stability-sliding", chart));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_law_keeps_from_overshoot_and_a_fifth_of_it_does_not() {
        // The law's own time by the peak speed of the same run.
        let at = |sliding_time_s: f64| {
            let (peak, overshoot) = run(60.0, 0.0, 0.4, sliding_time_s).unwrap();
            (sliding_time_s / (LAW * peak * INERTIA_KG_M2 / (2.0 * 60.0)), overshoot)
        };
        let [(above, kept), (below, broken)] = [0.035, 0.007].map(at);
        assert!(above > 1.0 && above < 1.3 && kept < 1e-3, "{above} {kept}");
        assert!(below < 0.2 && broken > 0.5, "{below} {broken}");
    }
}
