//! The study's parts of `docs/studies.md`.

use super::super::page::{PageError, Rows, Tables, bullets, digits, markdown};

/// PSMC with joint gains and feed-forward on a rigid arm.
fn usual<'a>(all: &Rows<'a>) -> Rows<'a> {
    all.with("law", "psmc").with("space", "joint").with("feeds_forward", true).with("is_elastic", false)
}

pub(crate) fn rates(tables: &Tables<'_>) -> Result<String, PageError> {
    let settings = tables.read("settings")?;
    let late = usual(&settings.all()).with("delay_cycles", 1);
    let mut lines = Vec::new();
    for rate_hz in [250, 500, 1000, 2000, 8000] {
        let row = late.with("rate_hz", rate_hz);
        let mm = |column| Ok::<_, PageError>(digits(1e3 * row.number(column)?, 2));
        lines.push(vec![
            format!("{rate_hz} Hz"),
            format!("{:.0} Hz", row.number("crossover_hz")?),
            mm("steady_rms_m")?,
            mm("whole_max_m")?,
            mm("held_tool_depth_m")?,
        ]);
    }
    let head = [
        "rate",
        "crossover",
        "off the circle, steady, RMS mm",
        "at most, with the turn, mm",
        "tool beyond it at the held impact, mm",
    ];
    Ok(markdown(&head, &lines))
}

pub(crate) fn findings(tables: &Tables<'_>) -> Result<String, PageError> {
    let settings = tables.read("settings")?;
    let usual = usual(&settings.all());
    let mut costs = Vec::new();
    for rate_hz in [250, 500, 1000, 2000, 4000] {
        let late = usual.with("rate_hz", 2 * rate_hz).with("delay_cycles", 1);
        let prompt_m = usual.with("rate_hz", rate_hz).with("delay_cycles", 0).number("whole_max_m")?;
        late.check("a cycle of delay costs more than half the rate", |row| row.number("whole_max_m") > prompt_m)?;
        costs.push(100.0 * (late.number("whole_max_m")? / prompt_m - 1.0));
    }
    costs.sort_by(f64::total_cmp);
    let all = settings.all();
    all.with("is_elastic", false).check("rigid arms stay on the circle", |row| row.word("outcome") == "ran")?;
    let elastic = all.with("is_elastic", true);
    let released = elastic.with("outcome", "released");
    released.check("settings that leave the circle have feed-forward and a delay", |row| {
        row.is("feeds_forward") && row.number("delay_cycles") > 0.0
    })?;
    Ok(bullets(&[
        format!(
            "**One cycle of delay costs more than half the rate.** The greatest error is {:.0} to {:.0} % above that of half the rate without delay.",
            costs[0], costs[4]
        ),
        format!(
            "**With elastic gears {} of {} settings leave the circle while tracing.** All of them have feed-forward and a delay, and crossovers of {:.0} to {:.0} Hz. On a rigid arm none leaves it.",
            released.count(),
            elastic.count(),
            released.least("crossover_hz")?,
            released.greatest("crossover_hz")?
        ),
    ]))
}
