//! The automatic hold against fixed ones: hands with mass that strike a surface, and pushes that are meant.
//!
//! The plant is plane: the tool of an arm, 4 kg, under a position servo. Its stiffness and damping are those of the paper's rig
//! at the tool; its force limit is 200 N, its delay one cycle. The hand has mass and holds the tool by a grip with stiffness and
//! damping; the sensor reads the force of the grip. Its voluntary force aims at a velocity and never exceeds its own limit, which
//! is below `R`. The linkage of [`bench`](super::bench) is left out.
//!
//! A row is 1000 hands under one rule. How many break through has Wilson's interval of 95 % beside it.

mod draw;
pub(super) mod page;
mod trial;

use serde_json::Value;

use self::trial::{
    GRIPS, Grips, Hand, PLACES, RULES, Rule, Strike, StrikeResult, StruckSurface, run_all, wall_of_case,
};
use super::sweep::{Clock, Report, Row, Study, Sweep, Table, median, wilson};

/// Hands of a row.
const CASES: u64 = 1000;
/// Seed of all hands, and another one.
const SEED: u64 = 2026;
const OTHER_SEED: u64 = 2027;
/// From the impact to the push, in ms.
const ONSETS_MS: [u32; 5] = [20, 50, 100, 200, 400];
/// Quantile of the delays that the study reports besides the median and the longest delay.
const MOST: f64 = 0.95;

/// The study `hold`.
pub(super) struct Hold(Vec<Box<dyn Sweep>>);

impl Hold {
    /// With its three tables.
    pub(super) fn new() -> Self {
        Self(vec![Box::new(Impacts::all()), Box::new(Pushes), Box::new(Impacts::again())])
    }
}

/// Hands that are struck with.
#[derive(Clone, Copy, Debug)]
struct Setting {
    variant: &'static str,
    strike: Strike,
    grips: Grips,
    seed: u64,
    is_moving: bool,
}

impl Setting {
    fn of(rule: Rule, place: StruckSurface, grips: Grips) -> Self {
        Self { variant: "", strike: Strike::at(rule, place), grips, seed: SEED, is_moving: false }
    }

    fn case(&self, case: u64) -> (Strike, Hand) {
        if !self.is_moving {
            return (self.strike, Hand::of_case(&self.grips, self.seed, case));
        }
        let (wall_m_per_s, hand) = wall_of_case(&self.grips, self.seed, case);
        (Strike { wall_m_per_s, ..self.strike }, hand)
    }

    fn outcomes(&self, cases: u64) -> Vec<StrikeResult> {
        run_all((0..cases).map(|case| self.case(case)))
    }
}

/// Table of the hands that break through at an impact.
struct Impacts {
    name: &'static str,
    settings: Vec<Setting>,
}

impl Impacts {
    /// Every rule, grip and place, and walls that move.
    fn all() -> Self {
        let mut settings = Vec::new();
        for grips in GRIPS {
            for place in PLACES {
                settings.extend(RULES.map(|rule| Setting::of(rule, place, grips)));
            }
        }
        for rule in [Rule::Fixed(0), Rule::Automatic(100), Rule::Automatic(200)] {
            let setting = Setting::of(rule, StruckSurface::Wall, GRIPS[0]);
            settings.push(Setting { variant: "moving wall", is_moving: true, ..setting });
        }
        Self { name: "impacts", settings }
    }

    /// The plane wall again: with other hands, and automatic holds with half the step of the plant.
    fn again() -> Self {
        let mut settings = Vec::new();
        for grips in GRIPS {
            for rule in RULES {
                let setting = Setting::of(rule, StruckSurface::Wall, grips);
                settings.push(Setting { variant: "other hands", seed: OTHER_SEED, ..setting });
                if let Rule::Automatic(_) = rule {
                    let strike = Strike { finer: 2, ..setting.strike };
                    settings.push(Setting { variant: "half the step", strike, ..setting });
                }
            }
        }
        Self { name: "again", settings }
    }

    /// The cells of a row, of the first `cases` hands.
    fn with_cases(&self, index: u64, cases: u64) -> Vec<Value> {
        let setting = self.settings[index as usize];
        let outcomes: Vec<StrikeResult> = setting.outcomes(cases);
        let met = outcomes.iter().filter(|outcome| outcome.is_met).count() as u64;
        let through = outcomes.iter().filter(|outcome| outcome.is_through()).count() as u64;
        let first = outcomes.iter().position(StrikeResult::is_through);
        let [low, high] = wilson(through, met);
        let deepest = |of: fn(&StrikeResult) -> f64| outcomes.iter().map(of).fold(0.0, f64::max);
        let mut cells = asked(&setting);
        cells.extend([
            cases.into(),
            met.into(),
            through.into(),
            (through as f64 / met.max(1) as f64).into(),
            low.into(),
            high.into(),
            first.into(),
            deepest(|outcome| outcome.depth_m).into(),
            deepest(|outcome| outcome.tool_depth_m).into(),
        ]);
        cells
    }
}

/// The cells that say what a setting is.
fn asked(setting: &Setting) -> Vec<Value> {
    let rule = setting.strike.rule;
    vec![
        setting.variant.into(),
        setting.strike.place.name().into(),
        setting.grips.name.into(),
        rule.name().into(),
        rule.window_ms().into(),
    ]
}

impl Sweep for Impacts {
    fn name(&self) -> &'static str {
        self.name
    }

    fn columns(&self) -> Vec<&str> {
        vec![
            "variant",
            "place",
            "grip",
            "rule",
            "window_ms",
            "hands",
            "met",
            "through",
            "share",
            "share_low",
            "share_high",
            "first_through",
            "depth_max_m",
            "tool_depth_max_m",
        ]
    }

    fn points(&self) -> u64 {
        self.settings.len() as u64
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        self.with_cases(index, CASES)
    }
}

/// Table of the same impacts on the plane wall, with a push of 1.5 R some time after.
struct Pushes;

impl Pushes {
    fn setting(index: u64) -> (Setting, f64) {
        let (rest, onset) = (index as usize / ONSETS_MS.len(), index as usize % ONSETS_MS.len());
        let (grips, rule) = (GRIPS[rest / RULES.len()], RULES[rest % RULES.len()]);
        let onset_s = 1e-3 * f64::from(ONSETS_MS[onset]);
        let setting = Setting::of(rule, StruckSurface::Wall, grips);
        (Setting { strike: Strike { onset_s: Some(onset_s), ..setting.strike }, ..setting }, onset_s)
    }

    fn with_cases(index: u64, cases: u64) -> Vec<Value> {
        let (setting, onset_s) = Self::setting(index);
        let outcomes: Vec<StrikeResult> = setting.outcomes(cases);
        let early = outcomes.iter().filter(|outcome| outcome.is_through()).count() as u64;
        // Of those who were held until the push.
        let mut delays_s: Vec<f64> =
            outcomes.iter().filter(|outcome| !outcome.is_through()).filter_map(|outcome| outcome.delay_s).collect();
        delays_s.sort_by(f64::total_cmp);
        let held = cases - early;
        let most = delays_s.get((MOST * delays_s.len() as f64) as usize).copied();
        let mut cells = asked(&setting);
        cells.extend([
            onset_s.into(),
            cases.into(),
            early.into(),
            (held - delays_s.len() as u64).into(),
            median(delays_s.iter().copied()).into(),
            most.into(),
            delays_s.last().copied().into(),
        ]);
        cells
    }
}

impl Sweep for Pushes {
    fn name(&self) -> &'static str {
        "pushes"
    }

    fn columns(&self) -> Vec<&str> {
        vec![
            "variant",
            "place",
            "grip",
            "rule",
            "window_ms",
            "onset_s",
            "hands",
            "early",
            "never",
            "delay_s",
            "delay_95_s",
            "delay_max_s",
        ]
    }

    fn points(&self) -> u64 {
        (GRIPS.len() * RULES.len() * ONSETS_MS.len()) as u64
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        Self::with_cases(index, CASES)
    }
}

/// The row of a rule among rows.
fn of_rule<'a>(mut rows: impl Iterator<Item = Row<'a>>, rule: Rule) -> Option<Row<'a>> {
    rows.find(|row| row.word("rule") == rule.name() && row.number("window_ms") == f64::from(rule.window_ms()))
}

/// The rows of impacts of one place and grip, the walls at rest.
fn impacts_of<'a>(impacts: &'a Table, place: StruckSurface, grips: &'a Grips) -> impl Iterator<Item = Row<'a>> {
    impacts.rows().filter(move |row| {
        row.word("place") == place.name() && row.word("grip") == grips.name && row.word("variant").is_empty()
    })
}

/// The rows of pushes of one grip and onset.
fn pushes_of<'a>(pushes: &'a Table, grips: &'a Grips, onset_ms: u32) -> impl Iterator<Item = Row<'a>> {
    let onset_s = 1e-3 * f64::from(onset_ms);
    pushes.rows().filter(move |row| row.word("grip") == grips.name && row.number("onset_s") == onset_s)
}

impl Study for Hold {
    fn name(&self) -> &'static str {
        "hold"
    }

    fn about(&self) -> &'static str {
        "automatic hold against fixed N_wait: which impacts break through, how long an intended push is delayed"
    }

    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.0
    }

    fn report(&self, tables: &[Table]) -> Report {
        let [impacts, pushes, again] = tables else { return Report::default() };
        let mut notes = vec![format!("through, of {CASES} hands a row (interval of 95 %, in %)")];
        for grips in &GRIPS {
            for place in PLACES {
                for rule in RULES {
                    let Some(row) = of_rule(impacts_of(impacts, place, grips), rule) else { continue };
                    notes.push(line(&format!("{:14} {:7}", grips.name, place.name()), &row));
                }
            }
        }
        for row in impacts.rows().filter(|row| !row.word("variant").is_empty()) {
            notes.push(line(&format!("{:22}", row.word("variant")), &row));
        }
        let apart = again.rows().filter(|row| {
            let grips = GRIPS.iter().find(|grips| grips.name == row.word("grip")).unwrap_or(&GRIPS[0]);
            let is_rule = |rule: &&Rule| {
                rule.name() == row.word("rule") && f64::from(rule.window_ms()) == row.number("window_ms")
            };
            let rule = RULES.iter().find(is_rule).unwrap_or(&RULES[0]);
            of_rule(impacts_of(impacts, StruckSurface::Wall, grips), *rule).is_some_and(|before| {
                row.number("share_low") > before.number("share_high")
                    || row.number("share_high") < before.number("share_low")
            })
        });
        notes.push(format!(
            "with other hands, or half the step: {} of {} rows have an interval apart from the first one",
            apart.count(),
            again.points
        ));
        notes.push("delay of a push of 1.5 R, median, 95 % and longest in ms, usual grips".to_owned());
        for rule in RULES {
            let cell = |onset_ms: u32| {
                let row = of_rule(pushes_of(pushes, &GRIPS[0], onset_ms), rule)?;
                let [middle, most, longest] =
                    ["delay_s", "delay_95_s", "delay_max_s"].map(|column| 1e3 * row.number(column));
                middle.is_finite().then(|| format!("  {onset_ms} ms: {middle:.0}, {most:.0}, {longest:.0}"))
            };
            let cells: String = ONSETS_MS.into_iter().filter_map(cell).collect();
            notes.push(format!("{:10} {:>4}{cells}", rule.name(), rule.window_ms()));
        }
        Report { notes, charts: draw::charts(impacts, pushes) }
    }
}

/// One line of the notes.
fn line(of: &str, row: &Row<'_>) -> String {
    let [low, high] = ["share_low", "share_high"].map(|column| 100.0 * row.number(column));
    format!(
        "{of} {:10} {:>4} ms {:>5} of {} ({low:.2} to {high:.2})",
        row.word("rule"),
        row.number("window_ms"),
        row.number("through"),
        row.number("met"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    const FEW: u64 = 60;

    fn shown(sweep: &dyn Sweep, cells: Vec<Value>) -> Value {
        let mut table = Table::new(sweep);
        table.insert(0, cells);
        table.rows().next().unwrap().json()
    }

    fn impacts(variant: &str, place: StruckSurface, grips: &Grips, rule: Rule) -> Value {
        let all = Impacts::all();
        let index = all.settings.iter().position(|setting| {
            (setting.variant, setting.strike.place, setting.grips.name, setting.strike.rule)
                == (variant, place, grips.name, rule)
        });
        shown(&all, all.with_cases(index.unwrap() as u64, FEW))
    }

    #[test]
    fn hands_with_mass_are_held_at_every_surface_and_go_through_without_a_hold() {
        for place in PLACES {
            let held = impacts("", place, &GRIPS[0], Rule::Automatic(200));
            assert_eq!(held["met"], FEW, "{held}");
            assert!(held["through"].as_u64().unwrap() <= 3, "{held}");
            let free = impacts("", place, &GRIPS[0], Rule::Fixed(0));
            assert!(free["through"].as_u64().unwrap() > FEW / 2, "{free}");
        }
    }

    /// A wall that comes or goes is met at the speed at which it is met.
    #[test]
    fn beside_a_wall_that_moves_a_hand_with_mass_is_held() {
        let held = impacts("moving wall", StruckSurface::Wall, &GRIPS[0], Rule::Automatic(200));
        assert_eq!((&held["met"], &held["through"]), (&FEW.into(), &0.into()), "{held}");
        let free = impacts("moving wall", StruckSurface::Wall, &GRIPS[0], Rule::Fixed(0));
        assert!(free["through"].as_u64().unwrap() > FEW / 2, "{free}");
    }

    #[test]
    fn a_push_gets_through_and_waits_no_longer_than_its_window() {
        for (place, rule) in RULES.into_iter().enumerate().filter(|(_, rule)| rule.name() == "automatic") {
            let row = shown(&Pushes, Pushes::with_cases((place * ONSETS_MS.len() + 2) as u64, FEW));
            assert_eq!((&row["rule"], &row["onset_s"], &row["never"]), (&"automatic".into(), &0.1.into(), &0.into()));
            // The time in which a grip brings the force comes on top, and an impact that follows the first.
            let most = row["delay_max_s"].as_f64().unwrap();
            assert!(most <= 1e-3 * f64::from(rule.window_ms()) + 0.1, "{row}");
        }
    }
}
