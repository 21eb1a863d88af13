//! Greatest stiffness of a hand that an admittance-controlled robot bears, against the closed forms of the paper of Keemink et al.

use std::f64::consts::TAU;

use nalgebra::{Complex, Matrix2};
use serde_json::Value;

use crate::chart::{Axis, Chart, Color, Mark, Panel, Series};
use crate::sweep::{Clock, Report, Sweep, Table};
use yieldwall_motion::control::{
    Compensation, Follower, Gains, Gears, Grip, HeldLoop, Outer, Pose, Sampling, admittance,
};
use yieldwall_motion::elementary;

/// Table 1 of the paper: virtual mass, robot before and behind its sensor in kg, friction in N s/m, servo in N s/m and N/m.
const VIRTUAL_KG: f64 = 2.0;
const ROBOT_KG: f64 = 10.0;
const BEHIND_SENSOR_KG: f64 = 2.0;
const VISCOUS_N_S_PER_M: f64 = 5.0;
const PROPORTIONAL_N_S_PER_M: f64 = 100.0;
const INTEGRAL_N_PER_M: f64 = 2000.0;
/// Fig. 9a.
const FILTER_S: f64 = 0.05;
/// Fig. 10a.
const COMPENSATION: Compensation = Compensation { mass_kg: 2.0, time_constant_s: 0.1 };
/// Fig. 11a.
const VIRTUAL_DAMPING_N_S_PER_M: f64 = 2.0;
/// Fig. 15a: share of the robot's mass behind its transmission, stiffness in N/m and damping in N s/m.
const BEHIND_TRANSMISSION: f64 = 0.5;
const TRANSMISSION: [f64; 2] = [1000.0, 100.0];

/// Cycles in ms; zero is the limit.
const CYCLES_MS: [f64; 4] = [1.0, 0.2, 0.05, 0.0];
/// Damping of the hand in N s/m.
const HANDS_N_S_PER_M: [f64; 2] = [15.0, 5.0];
/// The stiffness is known when it is that near the edge.
const EDGE: f64 = 1e-8;
/// Frequencies that are looked at, Hz, and how many.
const FREQUENCIES_HZ: [f64; 2] = [1e-3, 1e3];
const FREQUENCIES: u32 = 6000;

/// A row of the paper: one change of the baseline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Case {
    Baseline,
    ForceFilter,
    Compensation,
    VirtualDamping,
    NoIntegral,
    Elastic,
}

pub(super) const CASES: [Case; 6] =
    [Case::Baseline, Case::ForceFilter, Case::Compensation, Case::VirtualDamping, Case::NoIntegral, Case::Elastic];

impl Case {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Baseline => "baseline",
            Self::ForceFilter => "force filter 50 ms",
            Self::Compensation => "post-sensor compensation",
            Self::VirtualDamping => "virtual damping 2 N s/m",
            Self::NoIntegral => "no integral part",
            Self::Elastic => "elastic transmission",
        }
    }

    fn figure(self) -> &'static str {
        match self {
            Self::Baseline => "6a",
            Self::ForceFilter => "9a",
            Self::Compensation => "10a",
            Self::VirtualDamping => "11a",
            Self::NoIntegral => "none",
            Self::Elastic => "15a",
        }
    }

    /// Greatest stable stiffness in N/m by the roots of the polynomial of the paper's closed form, for [`HANDS_N_S_PER_M`].
    pub(super) fn closed_form_n_per_m(self) -> [f64; 2] {
        match self {
            Self::Baseline => [588.784_849_557_5, 362.285_305_113_5],
            Self::ForceFilter => [357.142_857_142_9, 164.502_164_502_2],
            Self::Compensation => [222.337_173_360_0, 61.491_880_490_9],
            Self::VirtualDamping => [625.070_188_337_6, 410.041_222_300_2],
            Self::NoIntegral => [434.210_526_315_8, 134.615_384_615_4],
            Self::Elastic => [393.443_525_520_1, 242.107_457_438_2],
        }
    }

    /// Limits of the comparison.
    fn remark(self) -> &'static str {
        match self {
            Self::Elastic => "half of the robot's mass is behind the transmission, as in a reproduction of the figure",
            Self::NoIntegral => "K_p of the baseline; the paper has no figure of this row",
            _ => "parameters as printed",
        }
    }

    fn follower(self) -> Follower {
        let stiffness = if self == Self::NoIntegral { 0.0 } else { INTEGRAL_N_PER_M };
        // The integral of the rate's error is a position error.
        let gains = Gains { stiffness, damping: PROPORTIONAL_N_S_PER_M, integral: 0.0 };
        Follower::Host { gains, delay_cycles: 0.0 }
    }

    fn pose(self) -> Pose {
        let one = Matrix2::identity();
        let gears = Gears {
            motor: one * ((1.0 - BEHIND_TRANSMISSION) * ROBOT_KG),
            stiffness: one * TRANSMISSION[0],
            damping: one * TRANSMISSION[1],
        };
        Pose {
            mass: one * ROBOT_KG,
            viscous: one * VISCOUS_N_S_PER_M,
            jacobian: one,
            forward_mass: Matrix2::zeros(),
            forward_viscous: Matrix2::zeros(),
            gears: (self == Self::Elastic).then_some(gears),
        }
    }

    fn outer(self, period_s: f64) -> Outer {
        Outer {
            period_s,
            sampling: Sampling::at_sync(period_s),
            low_pass: (self == Self::ForceFilter).then_some((1.0 / (TAU * FILTER_S), period_s)),
            damping_n_s_per_m: if self == Self::VirtualDamping { VIRTUAL_DAMPING_N_S_PER_M } else { 0.0 },
            handle_kg: 0.0,
            compensation: (self == Self::Compensation).then_some(COMPENSATION),
        }
    }

    /// Impedance that a hand feels in the limit, N s/m, with the mass behind the sensor; NaN where there is none.
    fn impedance(self, frequency_hz: f64) -> Complex<f64> {
        let s = Complex::new(0.0, TAU * frequency_hz);
        let found = admittance(&self.follower(), &self.pose(), &self.outer(1e-3), VIRTUAL_KG, frequency_hz);
        let robot = found.map_or(Complex::from(f64::NAN), |found| Complex::from(1.0) / found[(0, 0)]);
        robot + s * BEHIND_SENSOR_KG
    }

    /// The mass that a hand feels at a frequency, in kg.
    fn apparent_kg(self, frequency_hz: f64) -> f64 {
        self.impedance(frequency_hz).im / (TAU * frequency_hz)
    }

    /// The greatest phase that the admittance lags by, as a phase in degrees and its frequency in Hz.
    fn least_phase(self) -> (f64, f64) {
        // The phase at a frequency, by whole turns as near to another one as can be.
        let phase = |frequency_hz: f64, near: f64| {
            let impedance = self.impedance(frequency_hz);
            let phase = -elementary::atan2(impedance.im, impedance.re);
            phase - TAU * ((phase - near) / TAU).round()
        };
        let (mut last, mut least) = (0.0, (f64::INFINITY, f64::NAN));
        for frequency_hz in frequencies() {
            last = phase(frequency_hz, last);
            if last < least.0 {
                least = (last, frequency_hz);
            }
        }
        // Between the neighbours it has one least value.
        let step = elementary::powf(FREQUENCIES_HZ[1] / FREQUENCIES_HZ[0], 1.0 / f64::from(FREQUENCIES));
        let [mut low, mut high] = [least.1 / step, least.1 * step];
        for _ in 0..60 {
            let third = (high - low) / 3.0;
            if phase(low + third, least.0) < phase(high - third, least.0) { high -= third } else { low += third }
        }
        least = (phase(low, least.0), low);
        (least.0.to_degrees(), least.1)
    }

    /// Greatest stable stiffness in the limit: the least of those at which the hand's impedance is the robot's, turned round.
    fn limit_n_per_m(self, damping_n_s_per_m: f64) -> f64 {
        let excess = |frequency_hz: f64| self.impedance(frequency_hz).re + damping_n_s_per_m;
        let mut least = f64::INFINITY;
        let all: Vec<f64> = frequencies().collect();
        for pair in all.windows(2) {
            let [mut low, mut high] = [pair[0], pair[1]];
            let is_above = excess(low) > 0.0;
            if is_above == (excess(high) > 0.0) {
                continue;
            }
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if (excess(middle) > 0.0) == is_above { low = middle } else { high = middle }
            }
            let stiffness = TAU * low * self.impedance(low).im;
            if stiffness > 0.0 {
                least = least.min(stiffness);
            }
        }
        least
    }

    /// Greatest stable stiffness of the sampled loop.
    fn sampled_n_per_m(self, period_s: f64, damping_n_s_per_m: f64) -> f64 {
        let is_stable = |stiffness_n_per_m: f64| {
            let grip = Grip { stiffness_n_per_m, damping_n_s_per_m, mass_kg: BEHIND_SENSOR_KG };
            let held = HeldLoop::new(&self.follower(), &self.pose(), &grip, &self.outer(period_s), 0);
            held.is_ok_and(|held| held.is_stable(VIRTUAL_KG))
        };
        let (mut low, mut high) = (10.0, 12.0);
        if !is_stable(low) {
            return f64::NAN;
        }
        while is_stable(high) {
            (low, high) = (high, 1.2 * high);
        }
        while high / low > 1.0 + EDGE {
            let middle = 0.5 * (low + high);
            if is_stable(middle) { low = middle } else { high = middle }
        }
        low
    }
}

fn frequencies() -> impl Iterator<Item = f64> {
    let [least, most] = FREQUENCIES_HZ;
    (0..=FREQUENCIES)
        .map(move |place| least * elementary::powf(most / least, f64::from(place) / f64::from(FREQUENCIES)))
}

/// Every row of the paper under both hands at every cycle.
pub(super) struct Rows;

impl Sweep for Rows {
    fn name(&self) -> &'static str {
        "keemink"
    }

    fn columns(&self) -> Vec<&str> {
        vec![
            "case",
            "figure",
            "hand_damping_n_s_per_m",
            "cycle_ms",
            "closed_form_n_per_m",
            "found_n_per_m",
            "difference_percent",
            "least_phase_deg",
            "least_phase_hz",
            "mass_at_0_kg",
            "mass_at_infinity_kg",
            "remark",
        ]
    }

    fn points(&self) -> u64 {
        (CASES.len() * HANDS_N_S_PER_M.len() * CYCLES_MS.len()) as u64
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let index = index as usize;
        let (rest, cycle_ms) = (index / CYCLES_MS.len(), CYCLES_MS[index % CYCLES_MS.len()]);
        let (case, hand) = (CASES[rest / HANDS_N_S_PER_M.len()], rest % HANDS_N_S_PER_M.len());
        let (damping, published) = (HANDS_N_S_PER_M[hand], case.closed_form_n_per_m()[hand]);
        let is_limit = cycle_ms == 0.0;
        let found = if is_limit { case.limit_n_per_m(damping) } else { case.sampled_n_per_m(1e-3 * cycle_ms, damping) };
        let mut cells = vec![
            case.name().into(),
            case.figure().into(),
            damping.into(),
            cycle_ms.into(),
            published.into(),
            found.into(),
            (100.0 * (found / published - 1.0)).into(),
        ];
        if is_limit {
            let (phase_deg, phase_hz) = case.least_phase();
            cells.extend([phase_deg.into(), phase_hz.into()]);
            cells.extend([1e-4, 1e5].map(|frequency_hz| Value::from(case.apparent_kg(frequency_hz))));
            cells.push(case.remark().into());
        } else {
            cells.extend([Value::Null, Value::Null, Value::Null, Value::Null]);
            cells.push("sampled loop; phase and masses are those of the limit".into());
        }
        cells
    }
}

pub(super) fn report(table: &Table, report: &mut Report) {
    report.notes.push("Keemink et al. 2018, greatest stable stiffness of the hand at T -> 0, N/m:".to_owned());
    for row in table.rows().filter(|row| row.number("cycle_ms") == 0.0) {
        report.notes.push(format!(
            "  {:25} B_h {:2} N s/m: closed form {:.2}, found {:.2} ({:+.4} %); least phase {:.1} deg at {:.2} Hz; {:.2} kg at 0, {:.2} kg at infinity",
            row.word("case"),
            row.number("hand_damping_n_s_per_m"),
            row.number("closed_form_n_per_m"),
            row.number("found_n_per_m"),
            row.number("difference_percent"),
            row.number("least_phase_deg"),
            row.number("least_phase_hz"),
            row.number("mass_at_0_kg"),
            row.number("mass_at_infinity_kg"),
        ));
    }
    let panel = |damping: f64| {
        let of_hand = || table.rows().filter(move |row| row.number("hand_damping_n_s_per_m") == damping);
        let place = |cycle_ms: f64| {
            CYCLES_MS.iter().rposition(|known| *known == cycle_ms).map_or(0, |place| CYCLES_MS.len() - place)
        };
        let mut series = Vec::new();
        for (case, color) in CASES.into_iter().zip(Color::LINES) {
            let points = of_hand()
                .filter(|row| row.word("case") == case.name())
                .map(|row| (place(row.number("cycle_ms")) as f64, row.number("found_n_per_m")));
            series.push(Series {
                name: case.name().to_owned(),
                points: points.collect(),
                mark: Mark::MarkedLine,
                color,
            });
        }
        let published =
            of_hand().filter(|row| row.number("cycle_ms") == 0.0).map(|row| (0.7, row.number("closed_form_n_per_m")));
        series.push(Series {
            name: "closed form of the paper".to_owned(),
            points: published.collect(),
            mark: Mark::Marks,
            color: Color::Black,
        });
        let words = CYCLES_MS
            .iter()
            .rev()
            .map(|cycle_ms| if *cycle_ms == 0.0 { "limit 0".to_owned() } else { format!("{cycle_ms} ms") });
        Panel {
            title: format!("hand with {damping} N s/m"),
            x: Axis::of_words("cycle", words.collect()),
            y: Axis::linear("hand's stable stiffness, most (N/m)").over(0.0, 700.0),
            series,
        }
    };
    let chart = Chart {
        title: "A cycle of 1 ms changes the stable stiffness by 1 to 3 %, a force filter or a compensation by far more"
            .to_owned(),
        panels: HANDS_N_S_PER_M.into_iter().map(panel).collect(),
    };
    report.charts.push(("study-literature-keemink", chart));
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn whole() -> Table {
        let mut table = Table::new(&Rows);
        (0..Rows.points()).for_each(|index| table.insert(index, Rows.point(index, &|| Duration::ZERO)));
        table
    }

    /// The published closed forms at T -> 0, and the sampled loop on the straight line to them.
    #[test]
    fn published_stiffnesses_are_met() {
        let table = whole();
        for row in table.rows().filter(|row| row.number("cycle_ms") == 0.0) {
            assert!(row.number("difference_percent").abs() < 1e-4, "{}", row.json());
        }
        let rows: Vec<_> = table.rows().collect();
        for four in rows.chunks(CYCLES_MS.len()) {
            let [coarse, fine] = [four[1].number("found_n_per_m"), four[2].number("found_n_per_m")];
            let limit = fine - (coarse - fine) * CYCLES_MS[2] / (CYCLES_MS[1] - CYCLES_MS[2]);
            assert!((limit / four[3].number("closed_form_n_per_m") - 1.0).abs() < 1e-3, "{}: {limit}", four[3].json());
        }
    }

    /// Virtual mass and that behind the sensor at low frequencies, all masses that no spring parts from the hand at high ones.
    #[test]
    fn apparent_masses_are_those_of_the_closed_forms() {
        let expected = [(4.0, 12.0), (4.0, 12.0), (2.0, 12.0), (4.003, 12.0), (4.1, 12.0), (4.0, 7.0)];
        for (case, (low, high)) in CASES.into_iter().zip(expected) {
            assert!((case.apparent_kg(1e-4) - low).abs() < 1e-4, "{case:?} {}", case.apparent_kg(1e-4));
            assert!((case.apparent_kg(1e5) - high).abs() < 1e-3, "{case:?} {}", case.apparent_kg(1e5));
        }
        // Roots and phases of the same polynomials, by another program.
        let phases = [
            (-142.065, 4.444),
            (-247.457, 5.033),
            (-147.049, 3.858),
            (-140.062, 4.510),
            (-119.385, 4.652),
            (-159.279, 3.703),
        ];
        for (case, (phase_deg, hz)) in CASES.into_iter().zip(phases) {
            let found = case.least_phase();
            assert!((found.0 - phase_deg).abs() < 0.01 && (found.1 / hz - 1.0).abs() < 3e-3, "{case:?} {found:?}");
        }
    }
}
