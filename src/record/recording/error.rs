//! Reasons why a recording cannot be read.

use std::io;

/// Reason why a file is no recording of this program, or not a usable one.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be read.
    #[error("{}", io_words(.0))]
    Io(#[from] io::Error),
    /// The first bytes are not those of MCAP.
    #[error("is not an MCAP file")]
    NotMcap,
    /// The description of the run is missing: the file ends too early, or another program wrote it.
    #[error("has no description of what was recorded{}", .0.as_ref().map(|damage| format!(": {damage}")).unwrap_or_default())]
    NoDescription(Option<super::Damage>),
    /// The description of the run differs from the one written.
    #[error("has a damaged description of what was recorded: its sum does not fit")]
    DamagedDescription,
    /// It is one of another kind of machine.
    #[error("is the recording of another machine, whose document is `{name}`")]
    OtherMachine {
        /// Name of that document.
        name: &'static str,
    },
    /// The fields are not those that this program records.
    #[error("has other fields than this program records; it was written by version {}", .version.escape_debug())]
    OtherFields {
        /// Version of the program that wrote it.
        version: String,
    },
}

fn io_words(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::NotFound => "does not exist".to_owned(),
        // Said by this program, of a file that it does not try to read.
        io::ErrorKind::InvalidInput => error.to_string(),
        _ => format!("cannot be read: {error}"),
    }
}
