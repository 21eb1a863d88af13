//! Drawings in files.

use std::path::Path;

use super::failure::{Exit, Failure};
use super::replace::{Replace, Written, make_folder_of, unwritten};
use yieldwall_figures::{self as figure, Drawing};

/// Width of PNG pictures: 160 mm at 300 dots per inch.
const PICTURE_WIDTH_PX: u32 = 1890;

/// Returns the failure of a drawing, with all causes that the error names.
pub(super) fn drawing_failure(error: &dyn std::error::Error) -> Failure {
    let mut message = format!("figure: {error}");
    let mut source = error.source();
    while let Some(cause) = source {
        message.push_str(&format!(": {cause}"));
        source = cause.source();
    }
    Failure::new(Exit::Usage, message, "draw a run with something to see in it")
}

/// Checks that a picture can have this name, and overwrites nothing else.
pub(super) fn check_picture(path: &Path, replace: Replace) -> Result<(), Failure> {
    picture_kind(path)?;
    replace.check(path, Written::Picture)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PictureKind {
    Svg,
    Png,
}

fn picture_kind(path: &Path) -> Result<PictureKind, Failure> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    match ending.as_deref() {
        Some("svg") => Ok(PictureKind::Svg),
        Some("png") => Ok(PictureKind::Png),
        _ => {
            let ending = ending.map_or("no ending".to_owned(), |ending| format!("the ending .{ending}"));
            let message = format!("--figure {} has {ending}: only .svg and .png are drawn", path.display());
            Err(Failure::new(Exit::Usage, message, "end the name in .svg or .png"))
        }
    }
}

/// Writes a drawing in the format of its file's extension, and creates missing folders.
pub(super) fn write_drawing(drawing: &Drawing, path: &Path) -> Result<(), Failure> {
    make_folder_of(path)?;
    let written = match picture_kind(path)? {
        PictureKind::Svg => drawing.write_svg(path),
        PictureKind::Png => drawing.write_png(path, PICTURE_WIDTH_PX),
    };
    written.map_err(|error| match &error {
        figure::Error::Write { path, source } => unwritten(path, source),
        _ => drawing_failure(&error),
    })
}
