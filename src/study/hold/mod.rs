//! The automatic hold against fixed ones: hands with mass that strike a wall, and pushes that are meant.
//!
//! The plant has one dimension: the tool of an arm, 4 kg, under a position servo with the stiffness and damping of the
//! rig of the paper as they are at the tool, a force limit of 200 N and a delay of one cycle. The hand has mass and holds
//! the tool by a grip with stiffness and damping, from soft to braced; what the sensor reads is the force of the grip. Its
//! voluntary force aims at a speed and never exceeds its own limit, which is below `R`. Who breaks through is settled across
//! the wall within the hold, in which the tool hardly moves along it, so the linkage of
//! [`bench`](super::bench) is left out.

mod trial;

use serde_json::Value;

use self::trial::{Hand, RULES, Rule, run, run_moving, wall_of_case};
use super::chart::{Axis, Chart, Color, Mark, Panel, Series};
use super::sweep::{Clock, Report, Study, Sweep, Table, median};

/// Hands.
const CASES: u64 = 150;
/// Hands beside walls that move, and the rules under which they meet them.
const WALLS: u64 = 300;
const WALL_RULES: [Rule; 2] = [Rule::Fixed(0), Rule::Automatic];
/// From the impact to the push, in ms.
const ONSETS_MS: [u32; 5] = [20, 50, 100, 200, 400];

/// The study `hold`.
pub(super) struct Hold(Vec<Box<dyn Sweep>>);

impl Hold {
    /// With its three tables.
    pub(super) fn new() -> Self {
        Self(vec![Box::new(Impacts), Box::new(Pushes), Box::new(Walls)])
    }
}

/// Every hand against the wall under every rule.
struct Impacts;

impl Sweep for Impacts {
    fn name(&self) -> &'static str {
        "impacts"
    }

    fn columns(&self) -> &'static [&'static str] {
        &[
            "rule",
            "case",
            "hand_kg",
            "grip_n_per_m",
            "voluntary_limit_n",
            "impact_m_per_s",
            "peak_n",
            "depth_m",
            "tool_depth_m",
        ]
    }

    fn points(&self) -> u64 {
        RULES.len() as u64 * CASES
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let (rule, case) = (RULES[(index / CASES) as usize], index % CASES);
        let hand = Hand::of_case(case);
        let outcome = run(rule, hand, None);
        vec![
            rule.name().into(),
            case.into(),
            hand.mass_kg.into(),
            hand.grip_n_per_m.into(),
            hand.limit_n.into(),
            outcome.impact_speed_m_per_s.into(),
            outcome.peak_n.into(),
            outcome.depth_m.into(),
            outcome.tool_depth_m.into(),
        ]
    }
}

/// The same impacts with a push of 1.5 R some time after.
struct Pushes;

impl Sweep for Pushes {
    fn name(&self) -> &'static str {
        "pushes"
    }

    fn columns(&self) -> &'static [&'static str] {
        &["rule", "onset_s", "case", "is_early", "is_through", "delay_s"]
    }

    fn points(&self) -> u64 {
        (RULES.len() * ONSETS_MS.len()) as u64 * CASES
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let (group, case) = (index / CASES, index % CASES);
        let (rule, onset) = (RULES[group as usize / ONSETS_MS.len()], ONSETS_MS[group as usize % ONSETS_MS.len()]);
        let onset_s = f64::from(onset) * 1e-3;
        let outcome = run(rule, Hand::of_case(case), Some(onset_s));
        vec![
            rule.name().into(),
            onset_s.into(),
            case.into(),
            outcome.is_early.into(),
            outcome.delay_s.is_some().into(),
            outcome.delay_s.into(),
        ]
    }
}

/// Hands against walls that come and go.
struct Walls;

impl Sweep for Walls {
    fn name(&self) -> &'static str {
        "walls"
    }

    fn columns(&self) -> &'static [&'static str] {
        &[
            "rule",
            "case",
            "hand_kg",
            "grip_n_per_m",
            "voluntary_limit_n",
            "wall_m_per_s",
            "impact_m_per_s",
            "peak_n",
            "depth_m",
            "tool_depth_m",
        ]
    }

    fn points(&self) -> u64 {
        WALL_RULES.len() as u64 * WALLS
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let (rule, case) = (WALL_RULES[(index / WALLS) as usize], index % WALLS);
        let (wall_m_per_s, hand) = wall_of_case(case);
        let outcome = run_moving(rule, hand, wall_m_per_s);
        vec![
            rule.name().into(),
            case.into(),
            hand.mass_kg.into(),
            hand.grip_n_per_m.into(),
            hand.limit_n.into(),
            outcome.wall_m_per_s.into(),
            outcome.impact_speed_m_per_s.into(),
            outcome.peak_n.into(),
            outcome.depth_m.into(),
            outcome.tool_depth_m.into(),
        ]
    }
}

/// What the pushes of one rule and onset gave.
struct Group {
    through: usize,
    early: usize,
    /// Of those that were not early, sorted, in s.
    delays_s: Vec<f64>,
}

fn group(pushes: &Table, rule: Rule, onset_ms: u32) -> Group {
    let onset_s = f64::from(onset_ms) * 1e-3;
    let name = rule.name();
    let rows: Vec<_> =
        pushes.rows().filter(|row| row.word("rule") == name && row.number("onset_s") == onset_s).collect();
    let mut delays_s: Vec<f64> = rows
        .iter()
        .filter(|row| row.is("is_through") && !row.is("is_early"))
        .map(|row| row.number("delay_s"))
        .collect();
    delays_s.sort_by(f64::total_cmp);
    let count = |column: &str| rows.iter().filter(|row| row.is(column)).count();
    Group { through: count("is_through"), early: count("is_early"), delays_s }
}

/// Hands of a rule whose proxy went through the wall with the impact.
fn broken(impacts: &Table, rule: Rule) -> usize {
    let name = rule.name();
    impacts.rows().filter(|row| row.word("rule") == name && row.number("depth_m") > 1e-9).count()
}

impl Study for Hold {
    fn name(&self) -> &'static str {
        "hold"
    }

    fn about(&self) -> &'static str {
        "automatic hold against fixed N_wait: who breaks through at an impact, how long a push that is meant waits"
    }

    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.0
    }

    fn report(&self, tables: &[Table]) -> Report {
        let [impacts, pushes, walls] = tables else { return Report::default() };
        let mut notes = vec![format!("{:12} {:>14}   delay of a push, median (longest) in ms", "", "broken through")];
        let [mut medians, mut longest] = [Vec::new(), Vec::new()];
        for (rule, color) in RULES.into_iter().zip(Color::LINES) {
            let mut line = format!("{:12} {:>7} of {CASES}  ", rule.name(), broken(impacts, rule));
            let [mut middle, mut last] = [Vec::new(), Vec::new()];
            for onset_ms in ONSETS_MS {
                let Group { through, early, delays_s } = group(pushes, rule, onset_ms);
                let (Some(half), Some(&most)) = (median(delays_s.iter().copied()), delays_s.last()) else { continue };
                line += &format!("  {onset_ms} ms: {:.0} ({:.0})", half * 1e3, most * 1e3);
                if through + early < CASES as usize {
                    line += &format!(" {} never", CASES as usize - through - early);
                }
                middle.push((f64::from(onset_ms), half * 1e3));
                last.push((f64::from(onset_ms), most * 1e3));
            }
            notes.push(line);
            let series = |points| Series { name: rule.name(), points, mark: Mark::MarkedLine, color };
            medians.push(series(middle));
            longest.push(series(last));
        }
        for rule in WALL_RULES {
            let line = format!("{:12} {:>7} of {WALLS}   beside walls that move", rule.name(), broken(walls, rule));
            notes.push(line);
        }
        let panel = |title: &str, series| Panel {
            title: title.to_owned(),
            x: Axis::linear("push begins after the impact (ms)").over(0.0, 420.0),
            y: Axis::linear("delay of the push (ms)").over(0.0, 350.0),
            series,
        };
        let shares = RULES.into_iter().zip(Color::LINES).enumerate().map(|(place, (rule, color))| {
            let share = 100.0 * broken(impacts, rule) as f64 / CASES as f64;
            Series { name: rule.name(), points: vec![(1.0 + place as f64, share)], mark: Mark::Marks, color }
        });
        let shares = Panel {
            title: "broken through at the impact".to_owned(),
            x: Axis::of_words("rule", RULES.map(Rule::name).to_vec()),
            y: Axis::linear("hands (%)").over(-3.0, 103.0),
            series: shares.collect(),
        };
        let chart = Chart {
            title: format!("{CASES} hands of 0.5 to 1.5 kg, up to 0.5 m/s; then a push of 1.5 R"),
            panels: vec![shares, panel("median", medians), panel("longest", longest)],
            columns: 3,
        };
        Report { notes, charts: vec![("study-hold", chart)] }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    /// A wall that comes or goes is met at the speed at which it is met: nobody breaks through, as at a wall at rest.
    #[test]
    fn beside_a_wall_that_moves_a_hand_with_mass_is_held() {
        let walls = table(&Walls);
        let of = |rule: Rule| walls.rows().filter(move |row| row.word("rule") == rule.name());
        let met = |is_receding: bool| {
            of(Rule::Automatic).filter(|row| (row.number("wall_m_per_s") < -0.04) == is_receding).count()
        };
        assert!(met(true) > 100 && met(false) > 100, "{} {}", met(true), met(false));
        assert!(of(Rule::Automatic).all(|row| row.number("impact_m_per_s") > 0.0), "every hand meets its wall");
        let through: Vec<_> =
            of(Rule::Automatic).filter(|row| row.number("depth_m") > 1e-9).map(|row| row.number("case")).collect();
        assert!(through.is_empty(), "{} broke through: {through:?}", through.len());
        assert!(broken(&walls, Rule::Fixed(0)) > WALLS as usize / 2);
    }

    use super::*;

    fn table(sweep: &dyn Sweep) -> Table {
        let mut table = Table::new(sweep);
        for index in 0..sweep.points() {
            table.insert(index, sweep.point(index, &|| Duration::ZERO));
        }
        table
    }

    #[test]
    fn a_hand_with_mass_is_held_and_a_push_gets_through() {
        let (impacts, pushes) = (table(&Impacts), table(&Pushes));
        assert!(impacts.rows().all(|row| row.number("impact_m_per_s") > 0.0), "every hand meets the wall");
        let deep = broken(&impacts, Rule::Automatic);
        assert!(deep <= 1, "{deep} of {CASES} hands broke through");
        // The trial is hard enough to tell: without a hold most get through.
        assert!(broken(&impacts, Rule::Fixed(0)) > CASES as usize / 2);
        for onset_ms in ONSETS_MS {
            let Group { through, delays_s, .. } = group(&pushes, Rule::Automatic, onset_ms);
            assert_eq!(through as u64, CASES, "pushes after {onset_ms} ms");
            // Never longer than the window since the last impact and the time in which a grip brings the force.
            let most = delays_s[delays_s.len() - 1];
            assert!(most <= 0.12, "{most} s after {onset_ms} ms");
            assert!(onset_ms < 200 || most <= 0.04, "{most} s after {onset_ms} ms");
        }
    }
}
