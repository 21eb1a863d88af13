//! Configuration: YAML in, checked types out, and a message with line and column for whatever is wrong.
//!
//! The program reads a document in three steps: text ([`Source`]), typed tree (the first syntax or type error ends it), meaning
//! (ranges and relations between keys; all errors are collected). The results of [`load_rig`] and its siblings satisfy every rule
//! that the doc comments of the tree state.

mod check;
mod compose;
#[cfg(test)]
mod compose_tests;
mod diagnostic;
mod explain;
pub mod injection;
mod kind;
mod load;
mod locator;
#[cfg(test)]
mod malformed;
#[cfg(test)]
#[path = "malformed/tests.rs"]
mod malformed_tests;
mod number;
mod outline;
mod reader;
mod schema;
mod set_value;
mod source;
mod suggest;
mod tree;
mod yaml;

pub use check::HEARTBEAT_CYCLES;
pub use check::MAX_DURATION_S;
pub use diagnostic::{Diagnostic, Related, Report, Severity, TextSpan};
pub use kind::Kind;
pub use load::{
    Document, Loaded, load, load_device, load_error_codes, load_figure, load_named_profile, load_profile, load_rig,
    load_scene, load_simulation, to_yaml,
};
pub use number::{Finite, NotNegative, Positive};
pub use schema::{key_description, nearest_key, schema};
pub use set_value::{SetValue, SetValueError};
pub use source::{MAX_FILE_BYTES, Source, builtin, builtin_names};
pub use suggest::nearest as nearest_word;
pub use tree::*;
