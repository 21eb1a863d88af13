//! The study's parts of `docs/studies.md`.

use super::super::page::{PageError, Rows, Tables, bullets, length, markdown, relation};
use super::draw::DEFAULT;
use super::trial::{RULES, Rule};
use super::{CASES, ONSETS_MS};

const GRIPS: [&str; 3] = ["usual", "soft", "little damped"];
/// From the impact to the push, in s.
const ONSET_S: f64 = 0.1;

fn of_rule<'a>(rows: &Rows<'a>, rule: Rule) -> Rows<'a> {
    rows.with("rule", rule.name()).with("window_ms", rule.window_ms())
}

pub(crate) fn windows(tables: &Tables<'_>) -> Result<String, PageError> {
    let (impacts, pushes) = (tables.read("impacts")?, tables.read("pushes")?);
    let impacts = impacts.all().with("variant", "").with("place", "wall").with("hands", CASES);
    let pushes = pushes.all().with("grip", GRIPS[0]).with("onset_s", ONSET_S);
    let mut lines = Vec::new();
    for rule in RULES.into_iter().filter(|rule| rule.window_ms() > 0) {
        let mut line = vec![format!("{}, {} ms", rule.name(), rule.window_ms())];
        for grip in GRIPS {
            let row = of_rule(&impacts.with("grip", grip), rule);
            let [low, high] = [100.0 * row.number("share_low")?, 100.0 * row.number("share_high")?];
            let (through, depth) = (row.number("through")?, length(row.number("depth_max_m")?));
            line.push(format!("{through} ({low:.1} to {high:.1} %), {depth}"));
        }
        let delay = of_rule(&pushes, rule);
        let [median, most] = [1e3 * delay.number("delay_s")?, 1e3 * delay.number("delay_95_s")?];
        line.push(format!("{median:.0}, {most:.0}"));
        lines.push(line);
    }
    let [usual, soft, little] = GRIPS;
    let usual = format!("{usual} grips: break-throughs of {CASES} (95 %), greatest depth");
    Ok(markdown(&["rule, window", &usual, soft, little, "delay of a push: median, 95 %, ms"], &lines))
}

pub(crate) fn findings(tables: &Tables<'_>) -> Result<String, PageError> {
    let (impacts, pushes) = (tables.read("impacts")?, tables.read("pushes")?);
    let impacts = impacts.all().with("variant", "").with("hands", CASES);
    let [short, long] = [100, 500].map(Rule::Automatic);
    let usual = |rule| of_rule(&impacts.with("grip", GRIPS[0]), rule);
    let (through, through_short) = (usual(DEFAULT).greatest("through")?, usual(short).greatest("through")?);
    usual(DEFAULT)
        .check("the default window lets fewer usual hands through", |row| row.number("through") < through_short)?;
    let push = |rule| of_rule(&pushes.all().with("grip", GRIPS[0]).with("onset_s", ONSET_S), rule);
    let (delay, delay_short) = (1e3 * push(DEFAULT).number("delay_s")?, 1e3 * push(short).number("delay_s")?);
    relation(delay > delay_short, "the default window delays a push more", push(DEFAULT).iter())?;

    let onsets = of_rule(&pushes.all().with("grip", GRIPS[0]), DEFAULT);

    let soft = of_rule(&impacts.with("grip", GRIPS[1]), DEFAULT);
    let little = impacts.with("grip", GRIPS[2]).with("rule", "automatic").with("place", "wall");
    little.check("little damped grips break through each window", |row| row.number("through") > 0.0)?;
    let of_wall = |rule| of_rule(&little, rule).number("through");
    let (little_default, little_long) = (of_wall(DEFAULT)?, of_wall(long)?);
    let window = DEFAULT.window_ms();
    let through = if through == 0.0 { "none".to_owned() } else { format!("at most {through}") };
    Ok(bullets(&[
        format!(
            "An **automatic hold with a window of {window} ms** lets {through} of {CASES} hands with usual grips through at each of \
             {} surfaces (95 %: up to {:.1} %). With soft grips {} to {} get through. With usual grips a push of 1.5 R takes {:.0} \
             to {:.0} ms to break through the wall, in the median. It begins {} to {} ms after the impact; the lower end is its own \
             rise. Rows: {}, {}, {}.",
            usual(DEFAULT).count(),
            100.0 * usual(DEFAULT).greatest("share_high")?,
            soft.least("through")?,
            soft.greatest("through")?,
            1e3 * onsets.least("delay_s")?,
            1e3 * onsets.greatest("delay_s")?,
            ONSETS_MS[0],
            ONSETS_MS[ONSETS_MS.len() - 1],
            usual(DEFAULT).places(),
            soft.places(),
            onsets.places()
        ),
        format!(
            "**Little damped grips break through every window** of the automatic hold: at the wall {little_default} of {CASES} with {window} ms and {little_long} with 500 ms. Rows: {}.",
            little.places()
        ),
    ]))
}
