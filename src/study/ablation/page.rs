//! The study's part of `docs/studies.md`.

use super::super::page::{PageError, Tables, markdown};

/// Each term with the number of runs that model it and of those in which it has an effect.
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
    counts.sort_by(|one, other| (other.2 * one.1).cmp(&(one.2 * other.1)));
    let lines: Vec<_> =
        counts.into_iter().map(|(term, runs, effects)| vec![term, runs.to_string(), effects.to_string()]).collect();
    Ok(markdown(&["term", "runs that model it", "runs in which it has an effect"], &lines))
}
