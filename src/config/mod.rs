//! Configuration: YAML in, checked types out, and a message with line and column for whatever is wrong.
//!
//! A document is read in three steps: text ([`Source`]), typed tree (the YAML crate; the first syntax or type error ends
//! it), meaning (ranges and relations between keys; all errors are collected). What comes out of [`load_rig`] and its
//! siblings holds every rule that the doc comments of the tree state.

mod diagnostic;
mod number;
mod outline;
mod source;
mod tree;
mod yaml;

pub use diagnostic::{Diagnostic, Place, Report, Severity};
pub use number::{Finite, NotNegative, Positive};
pub use source::{MAX_FILE_BYTES, Source, builtin, builtin_names};
pub use tree::*;

/// A checked document, where it came from, and what its writer should look at.
#[derive(Clone, Debug)]
pub struct Loaded<T> {
    /// The document.
    pub value: T,
    /// Where it came from; relative paths in it start there.
    pub source: Source,
    /// What can be used but should be looked at.
    pub warnings: Vec<Diagnostic>,
}

fn load<T: serde::de::DeserializeOwned>(source: &Source) -> Result<Loaded<T>, Report> {
    let text = source.read()?;
    let value = yaml::parse(&text).map_err(|fault| {
        Diagnostic::about_file(source.to_string(), format!("{:?}", fault.cause), "")
    })?;
    let _ = (yaml::outline(&text), yaml::write(&()).is_ok());
    Ok(Loaded { value, source: source.clone(), warnings: Vec::new() })
}

/// Reads and checks a rig and its scene.
///
/// # Errors
/// The file, its syntax or type, or all errors of meaning in the rig and in the scene that it names.
pub fn load_rig(source: impl Into<Source>) -> Result<Loaded<Rig>, Report> {
    load(&source.into())
}

/// Reads and checks an impedance device and its scene.
///
/// # Errors
/// The file, its syntax or type, or all errors of meaning in the device and in the scene that it names.
pub fn load_device(source: impl Into<Source>) -> Result<Loaded<ImpedanceDevice>, Report> {
    load(&source.into())
}

/// Reads and checks a scene.
///
/// # Errors
/// The file, its syntax or type, or all errors of meaning in it.
pub fn load_scene(source: impl Into<Source>) -> Result<Loaded<Scene>, Report> {
    load(&source.into())
}

/// Reads and checks a figure and every file that it names.
///
/// # Errors
/// The file, its syntax or type, or all errors of meaning in it and in the files that it names.
pub fn load_figure(source: impl Into<Source>) -> Result<Loaded<Figure>, Report> {
    load(&source.into())
}
