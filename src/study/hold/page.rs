//! The study's parts of `docs/studies.md`.

use super::super::page::{PageError, Rows, Tables, bullets, length, markdown, relation};
use super::CASES;
use super::draw::DEFAULT;
use super::trial::{RULES, Rule};

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
    let push = |rule| {
        Ok(1e3 * of_rule(&pushes.all().with("grip", GRIPS[0]).with("onset_s", ONSET_S), rule).number("delay_s")?)
    };
    let (delay, delay_short): (f64, f64) = (push(DEFAULT)?, push(short)?);
    let usual_pushes = pushes.all().with("grip", GRIPS[0]);
    relation(delay > delay_short, "the default window delays a push more", of_rule(&usual_pushes, DEFAULT).iter())?;

    let fixed = pushes.all().with("rule", "N_wait");
    let automatic =
        pushes.all().with("rule", "automatic").filter("window_ms < 500", |row| row.number("window_ms") < 500.0);
    automatic.check("the automatic hold delays a push less than N_wait of its length", |row| {
        let same = ["grip", "window_ms", "onset_s"]
            .into_iter()
            .fold(fixed.clone(), |rows, column| rows.with(column, row.cell(column).clone()));
        same.number("delay_s").is_ok_and(|delay_s| row.number("delay_s") < delay_s)
    })?;
    let waits = push(Rule::Fixed(100))?;

    let little = impacts.with("grip", GRIPS[2]).with("rule", "automatic");
    let wall = little.with("place", "wall");
    wall.check("little damped grips break through each window", |row| row.number("through") > 0.0)?;
    let of_wall = |rule| of_rule(&wall, rule).number("through");
    let (little_default, little_long) = (of_wall(DEFAULT)?, of_wall(long)?);
    let depth = length(of_rule(&little, DEFAULT).greatest("depth_max_m")?);
    let default = format!("{} ms", DEFAULT.window_ms());
    Ok(bullets(&[
        format!(
            "**The default window is {default}.** At most {through} of {CASES} usual hands break through each of the {} surfaces; with a window of 100 ms it is up to {through_short}. \
             The price: a push waits {delay:.0} ms in the median, and with 100 ms it waits {delay_short:.0} ms.",
            usual(DEFAULT).count()
        ),
        format!(
            "**The automatic hold delays a push less than N_wait of the same length**, in all {} pairs of the tables. With 100 ms the medians are {delay_short:.0} and {waits:.0} ms.",
            automatic.count()
        ),
        format!(
            "**Little damped grips break through every window.** At the wall {little_default} of {CASES} do with {default} and {little_long} with 500 ms. With {default} the proxy gets up to {depth} beyond a surface."
        ),
    ]))
}
