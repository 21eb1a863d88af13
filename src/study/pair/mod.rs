//! A telemanipulation pair with its fixture on the master's or on the slave's side: what the hand feels, how deep the slave
//! goes, and what energy the delay makes.
//!
//! Forces of hand and tissue move one proxy, which both tools track. A hand of 0.5 kg goes towards a wall of R = 20 N and
//! presses on it with 12 N; 10 mm before the wall there may lie a tissue. The loop is of its own: two tools with delays between
//! them, in one dimension, where [`bench`](super::bench) has one arm.

mod machine;
pub(super) mod page;
mod trial;

pub use machine::{Pair, PairParameters, PairRow, PairServo, Placement, Surroundings};

use serde_json::Value;

use self::trial::{Case, RULES, Rule, run};
use super::chart::{Axis, Chart, Color, Mark, Panel, Series};
use super::sweep::{Clock, Report, Study, Sweep, Table};

const DELAYS_MS: [u32; 8] = [0, 1, 2, 5, 10, 20, 35, 50];
/// A soft and a braced hand, N/m.
const HANDS_N_PER_M: [f64; 2] = [300.0, 3000.0];
/// Nothing, soft and stiff tissue, N/m.
const TISSUES_N_PER_M: [f64; 3] = [0.0, 300.0, 3000.0];
/// A pair that moves more than this in the end swings, m/s.
const SWINGING_M_PER_S: f64 = 5e-3;

/// The study `pair`.
pub(super) struct PairStudy(Vec<Box<dyn Sweep>>);

impl PairStudy {
    /// With its table.
    pub(super) fn new() -> Self {
        Self(vec![Box::new(Delays)])
    }
}

/// Every rule under every delay.
struct Delays;

impl Delays {
    fn case(index: u64) -> Case {
        let index = index as usize;
        let (index, delay) = (index / DELAYS_MS.len(), index % DELAYS_MS.len());
        let (index, tissue) = (index / TISSUES_N_PER_M.len(), index % TISSUES_N_PER_M.len());
        let (rule, hand) = (index / HANDS_N_PER_M.len(), index % HANDS_N_PER_M.len());
        Case {
            rule: RULES[rule],
            delay_ms: DELAYS_MS[delay],
            hand_n_per_m: HANDS_N_PER_M[hand],
            tissue_n_per_m: TISSUES_N_PER_M[tissue],
        }
    }
}

impl Sweep for Delays {
    fn name(&self) -> &'static str {
        "delays"
    }

    fn columns(&self) -> Vec<&str> {
        vec![
            "fixture",
            "hand_n_per_m",
            "tissue_n_per_m",
            "delay_s",
            "peak_n",
            "held_n",
            "depth_m",
            "slave_depth_m",
            "unrest_m_per_s",
            "given_j",
            "dissipated_j",
        ]
    }

    fn points(&self) -> u64 {
        (RULES.len() * HANDS_N_PER_M.len() * TISSUES_N_PER_M.len() * DELAYS_MS.len()) as u64
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let case = Self::case(index);
        let mut cells = vec![
            case.rule.name().into(),
            case.hand_n_per_m.into(),
            case.tissue_n_per_m.into(),
            (f64::from(case.delay_ms) * 1e-3).into(),
        ];
        match run(&case) {
            Ok(found) => cells.extend([
                found.peak_n.into(),
                found.held_n.into(),
                found.depth_m.into(),
                found.slave_depth_m.into(),
                found.unrest_m_per_s.into(),
                found.given_j.into(),
                found.dissipated_j.into(),
            ]),
            Err(_) => cells.resize(self.columns().len(), Value::Null),
        }
        cells
    }
}

/// A column over the delay in ms, for one rule, hand and tissue.
fn over_delay(table: &Table, rule: Rule, hand: f64, tissue: f64, column: &str, scale: f64) -> Vec<(f64, f64)> {
    let is_asked = |row: &super::sweep::Row<'_>| {
        row.word("fixture") == rule.name()
            && row.number("hand_n_per_m") == hand
            && row.number("tissue_n_per_m") == tissue
    };
    let asked = table.rows().filter(is_asked);
    asked.map(|row| (1e3 * row.number("delay_s"), scale * row.number(column))).collect()
}

/// The longest delay up to which the pair comes to rest at every shorter one too, in ms.
fn longest_at_rest_ms(table: &Table, rule: Rule, hand: f64, tissue: f64) -> Option<f64> {
    let unrest = over_delay(table, rule, hand, tissue, "unrest_m_per_s", 1.0);
    unrest.iter().take_while(|(_, speed)| *speed < SWINGING_M_PER_S).last().map(|(delay_ms, _)| *delay_ms)
}

impl Study for PairStudy {
    fn name(&self) -> &'static str {
        "pair"
    }

    fn about(&self) -> &'static str {
        "fixture at the master or at the slave of a pair with delay: force felt, depth at the slave, energy"
    }

    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.0
    }

    fn report(&self, tables: &[Table]) -> Report {
        let [delays] = tables else { return Report::default() };
        let [soft, braced] = HANDS_N_PER_M;
        let [nothing, _, stiff] = TISSUES_N_PER_M;
        let mut notes = vec![format!(
            "{:16} longest delay one way at which the pair comes to rest, in ms: hand {soft} / {braced} N/m, tissue 0 / 300 / 3000 N/m",
            ""
        )];
        for rule in RULES {
            let cells = HANDS_N_PER_M.iter().flat_map(|&hand| TISSUES_N_PER_M.map(|tissue| (hand, tissue)));
            let cells = cells.map(|(hand, tissue)| {
                longest_at_rest_ms(delays, rule, hand, tissue)
                    .map_or("none".to_owned(), |delay_ms| delay_ms.to_string())
            });
            notes.push(format!("{:16} {}", rule.name(), cells.collect::<Vec<_>>().join("  ")));
        }
        let panel = |title: &str, y: Axis, hand, tissue, column: &str, scale| Panel {
            title: title.to_owned(),
            x: Axis::linear("delay one way (ms)").over(0.0, 52.0),
            y,
            series: RULES
                .into_iter()
                .zip(Color::LINES)
                .map(|(rule, color)| Series {
                    name: rule.name().to_owned(),
                    points: over_delay(delays, rule, hand, tissue, column, scale),
                    mark: Mark::MarkedLine,
                    color,
                })
                .collect(),
        };
        const FREE: &str = "braced hand, nothing before the wall";
        const STIFF: &str = "soft hand, stiff tissue before the wall";
        let felt = || Axis::linear("force felt, most (N)");
        let given = || Axis::logarithmic("largest burst into the hand (J)");
        let chart = Chart {
            title: "A pair that presses on a wall with 12 N, by the place of its fixture".to_owned(),
            panels: vec![
                panel(FREE, felt(), braced, nothing, "peak_n", 1.0),
                panel(FREE, Axis::logarithmic("slave beyond the wall (mm)"), braced, nothing, "slave_depth_m", 1e3),
                panel(FREE, given(), braced, nothing, "given_j", 1.0),
                panel(STIFF, felt(), soft, stiff, "peak_n", 1.0),
                panel(STIFF, Axis::linear("speed in the end (mm/s)"), soft, stiff, "unrest_m_per_s", 1e3),
                panel(STIFF, given(), soft, stiff, "given_j", 1.0),
            ],
        };
        Report { notes, charts: vec![("study-pair", chart)] }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn found(table: &Table, rule: usize, hand: f64, tissue: f64, column: &str) -> Vec<f64> {
        over_delay(table, RULES[rule], hand, tissue, column, 1.0).into_iter().map(|(_, value)| value).collect()
    }

    #[test]
    fn the_side_without_the_fixture_has_the_delay_in_its_loop() {
        let mut table = Table::new(&Delays);
        for index in 0..Delays.points() {
            table.insert(index, Delays.point(index, &|| Duration::ZERO));
        }
        let ([soft, braced], [nothing, _, stiff]) = (HANDS_N_PER_M, TISSUES_N_PER_M);
        let [master, slave, master_controlled, slave_controlled] = [0, 1, 2, 3];
        // Without tissue the hand at the master feels no delay at all; with the fixture at the slave it swings.
        let felt = found(&table, master, braced, nothing, "peak_n");
        assert!(felt.len() == DELAYS_MS.len() && felt.iter().all(|force| *force == felt[0]), "{felt:?}");
        assert_eq!(longest_at_rest_ms(&table, RULES[slave], braced, nothing), Some(20.0));
        // On a stiff tissue it is the other way about.
        assert_eq!(longest_at_rest_ms(&table, RULES[master], soft, stiff), Some(5.0));
        assert_eq!(longest_at_rest_ms(&table, RULES[slave], soft, stiff), Some(50.0));
        for (rule, plain) in [(master_controlled, master), (slave_controlled, slave)] {
            for (hand, tissue) in
                HANDS_N_PER_M.into_iter().flat_map(|hand| TISSUES_N_PER_M.map(|tissue| (hand, tissue)))
            {
                assert_eq!(longest_at_rest_ms(&table, RULES[rule], hand, tissue), Some(50.0), "{hand} {tissue}");
                let [kept, given] = [rule, plain].map(|rule| found(&table, rule, hand, tissue, "given_j"));
                let most = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
                assert!(most(&given) < 1.0 || most(&kept) < 0.3 * most(&given), "{hand} {tissue}");
            }
        }
    }
}
