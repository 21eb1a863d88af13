//! `--page`: tables and findings in a page of the documentation.

use std::path::Path;

use serde_json::json;

use crate::failure::{Exit, Failure};
use crate::output::Output;
use crate::replace::{exchange, unwritten};
use yieldwall_study::page::{PageError, refresh};
use yieldwall_study::sweep::Study;

/// Writes the blocks of some studies into the page.
pub(super) fn write(
    path: &Path,
    tables: &Path,
    studies: &[Box<dyn Study>],
    output: &mut Output,
) -> Result<(), Failure> {
    let page = std::fs::read_to_string(path).map_err(|error| {
        let help = "name the page with --page=FILE, or run in the folder of the repository";
        Failure::about_file(Exit::ConfigInvalid, path, format!("{}: {error}", path.display()), help)
    })?;
    let (mut new, mut changed) = (page, Vec::new());
    for study in studies {
        let blocks = refresh(&new, study.as_ref(), tables).map_err(|error| failure(path, &error))?;
        new = blocks.0;
        changed.extend(blocks.1);
    }
    if !changed.is_empty() {
        exchange(path, &new, |error| unwritten(path, &error), |_| Ok(()))?;
    }
    if output.is_json() {
        return output.report(json!({ "page": path, "tables": tables, "changed": changed }));
    }
    output.news(&match changed.as_slice() {
        [] => format!("{} shows the tables in {} already", path.display(), tables.display()),
        changed => format!("{}: {} written from {}", path.display(), changed.join(", "), tables.display()),
    })
}

fn failure(page: &Path, error: &PageError) -> Failure {
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
            (page, "a block stands between its line `begin` and `<!-- end -->`: correct the page".to_owned())
        }
        _ => (page, "look at these rows; compute the table again, or correct the block in src/study".to_owned()),
    };
    let message = if file == page { format!("{}: {error}", page.display()) } else { error.to_string() };
    Failure::about_file(Exit::ConfigInvalid, file, message, help)
}
