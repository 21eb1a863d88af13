//! `--page`: findings and tables in the pages of the documentation.

use std::path::Path;

use serde_json::json;

use crate::failure::{Exit, Failure};
use crate::output::Output;
use crate::replace::{exchange, unwritten};
use yieldwall_study::page::{PAGES, PageError, refresh};
use yieldwall_study::sweep::Study;

/// Writes the blocks of some studies into the pages in the folder `docs`.
pub(super) fn write(
    docs: &Path,
    tables: &Path,
    studies: &[Box<dyn Study>],
    output: &mut Output,
) -> Result<(), Failure> {
    let paths = PAGES.map(|page| docs.join(page));
    let mut pages = Vec::new();
    for path in &paths {
        pages.push(std::fs::read_to_string(path).map_err(|error| {
            let help = "name the folder of the pages with --page=DIR, or run in the folder of the repository";
            Failure::about_file(Exit::ConfigInvalid, path, format!("{}: {error}", path.display()), help)
        })?);
    }
    let (before, mut changed) = (pages.clone(), Vec::new());
    for study in studies {
        changed.extend(refresh(&mut pages, study.as_ref(), tables).map_err(|error| failure(docs, &error))?);
    }
    for ((path, page), _) in paths.iter().zip(&pages).zip(&before).filter(|((_, page), before)| page != before) {
        exchange(path, page, |error| unwritten(path, &error), |_| Ok(()))?;
    }
    if output.is_json() {
        return output.report(json!({ "pages": paths, "tables": tables, "changed": changed }));
    }
    let [findings, behind] = paths.map(|path| path.display().to_string());
    output.news(&match changed.as_slice() {
        [] => format!("{findings} and {behind} show the tables in {} already", tables.display()),
        changed => format!("{findings} and {behind}: {} written from {}", changed.join(", "), tables.display()),
    })
}

fn failure(docs: &Path, error: &PageError) -> Failure {
    let inner = match error {
        PageError::Block { error, .. } => error,
        error => error,
    };
    let (file, help) = match inner {
        PageError::Table { path, from, .. } => {
            let study = from.split('/').next().unwrap_or_default();
            let help = format!(
                "compute it with `yieldwall study {study}` and copy out/study/{from} to {}, or name another folder with --tables",
                path.display()
            );
            (path.as_path(), help)
        }
        PageError::Marker(_) => {
            (docs, "a block stands between its line `begin` and `<!-- end -->`: correct the page".to_owned())
        }
        _ => (docs, "look at these rows; compute the table again, or correct the block in src/study".to_owned()),
    };
    let message = if file == docs { format!("{}: {error}", docs.display()) } else { error.to_string() };
    Failure::about_file(Exit::ConfigInvalid, file, message, help)
}
