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
    let all = settings.all();
    all.with("is_elastic", false).check("rigid arms stay on the circle", |row| row.word("outcome") == "ran")?;
    let elastic = all.with("is_elastic", true);
    let released = elastic.with("outcome", "released");
    released.check("settings that leave the circle have feed-forward and a delay", |row| {
        row.is("feeds_forward") && row.number("delay_cycles") > 0.0
    })?;
    Ok(bullets(&[format!(
        "With elastic gears **{} of {} settings leave the circle**, all of them with feed-forward and a delay; on a rigid arm none does. Rows: {}.",
        released.count(),
        elastic.count(),
        released.places()
    )]))
}
