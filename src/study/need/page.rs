//! The study's parts of `docs/studies.md`.

use serde_json::Value;

use super::super::page::{PageError, Rows, Tables, bullets, digits, markdown, relation};
use super::reading::{change, of_scenes};
use crate::sweep::Row;

/// The proposal for each scene beside the model with all terms.
pub(crate) fn models(tables: &Tables<'_>) -> Result<String, PageError> {
    let table = tables.read("models")?;
    let mut lines = Vec::new();
    for rows in of_scenes(&table.all()) {
        let needed = rows.with("is_needed", true).one()?;
        let of_dearest = dearest(&rows)?.number("realtime_factor");
        lines.push(vec![
            format!("{} on {}", needed.word("scene"), needed.word("machine")),
            rows.count().to_string(),
            needed.word("model").to_owned(),
            digits(needed.number("realtime_factor"), 2),
            digits(of_dearest, 2),
            format!("{} ({})", change(&needed), needed.word("most_changed")),
        ]);
    }
    let head = [
        "scene",
        "models",
        "simplest of the fastest sufficient models",
        "x real time",
        "all terms: x real time",
        "change / tolerance",
    ];
    Ok(markdown(&head, &lines))
}

/// Terms that some scene does without, each with the number of runs that model it and of those in which it has an effect.
pub(crate) fn terms(tables: &Tables<'_>) -> Result<String, PageError> {
    let table = tables.read("terms")?;
    let modelled = table.all().with("is_modelled", true);
    modelled.check("each run without a term goes on to its end", |row| row.word("outcome") == "ran")?;
    let mut counts: Vec<(String, usize, usize)> = Vec::new();
    for row in modelled.iter().filter(|row| !row.word("term").is_empty()) {
        if counts.iter().all(|(term, ..)| term != row.word("term")) {
            let of_term = modelled.with("term", row.word("term"));
            counts.push((row.word("term").to_owned(), of_term.count(), of_term.with("has_effect", true).count()));
        }
    }
    counts.retain(|(_, runs, effects)| effects < runs);
    counts.sort_by(|one, other| (other.2 * one.1).cmp(&(one.2 * other.1)));
    let lines: Vec<_> =
        counts.into_iter().map(|(term, runs, effects)| vec![term, runs.to_string(), effects.to_string()]).collect();
    Ok(markdown(&["term", "runs that model it", "runs in which it has an effect"], &lines))
}

pub(crate) fn findings(tables: &Tables<'_>) -> Result<String, PageError> {
    let table = tables.read("models")?;
    let scenes = of_scenes(&table.all());
    let mut gains = Vec::new();
    for rows in &scenes {
        let needed = rows.with("is_needed", true);
        needed.check("a proposal is within the tolerance", |row| row.number("change_over_tolerance") <= 1.0)?;
        gains.push(needed.number("realtime_factor")? / dearest(rows)?.number("realtime_factor"));
    }
    let elastic = scenes.iter().find(|rows| rows.with("body", "elastic").count() > 0);
    let ideal = scenes.iter().find(|rows| rows.with("body", "ideal").count() > 0);
    let (Some(elastic), Some(ideal)) = (elastic, ideal) else {
        return Err(PageError::Rows("no scene has gears, or none does without an arm".to_owned()));
    };
    let stiff = all_but(elastic, &dearest(elastic)?, "body", "rigid")?;
    let of_ideal = ideal.with("body", "ideal");
    of_ideal.check("a tool without an arm changes more than the tolerance", |row| {
        let change = row.number("change_over_tolerance");
        change.is_nan() || change > 1.0
    })?;
    let most = gains.into_iter().fold(0.0, f64::max);
    let needed = table.all().with("is_needed", true);
    let apart = |row: &Row<'_>| row.number("realtime_factor_most") / row.number("realtime_factor_least");
    let all = table.all();
    let measured = all.iter().filter(|row| apart(row).is_finite());
    let widest = measured.max_by(|one, other| apart(one).total_cmp(&apart(other)));
    let widest = widest.ok_or_else(|| PageError::Rows("no model".to_owned()))?;
    let scatter = apart(widest);
    relation(most < scatter, "what the models of the rings gain is within the scatter of one model", needed.iter())?;
    Ok(bullets(&[
        format!(
            "In these scenes terms that may be left out within the tolerance **buy little time**. The models of the rings are at most {} times as \
             fast as those with all terms, and runs of one model differ by up to {} times. Rows: {}, `models` {}.",
            digits(most, 2),
            digits(scatter, 2),
            needed.places(),
            widest.index
        ),
        format!(
            "In the scene with elastic gears stiff ones change an output by **{} times its tolerance**. In position mode no arm at all changes one by {} times at least. Rows: `models` {}, {}.",
            change(&stiff),
            digits(of_ideal.least("change_over_tolerance")?, 2),
            stiff.index,
            of_ideal.places()
        ),
    ]))
}

/// The model with all terms of a scene.
fn dearest<'a>(rows: &Rows<'a>) -> Result<Row<'a>, PageError> {
    rows.with("terms", rows.greatest("terms")?).one()
}

/// The model that has all terms of `dearest` with one other choice.
fn all_but<'a>(
    rows: &Rows<'a>,
    dearest: &Row<'a>,
    column: &str,
    value: impl Into<Value>,
) -> Result<Row<'a>, PageError> {
    let choices = ["body", "plant_step_us", "timing", "encoder", "force_sensor"];
    let others = choices.into_iter().filter(|other| *other != column);
    others.fold(rows.with(column, value), |rows, other| rows.with(other, dearest.cell(other).clone())).one()
}
