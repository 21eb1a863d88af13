//! The second opinion of a build without ethercrab.

use serde_json::Value;

use super::SegmentSession;
use crate::checkup::Section;
use crate::failure::{Exit, Failure};
use crate::output::Output;

/// A person's consent, which nobody is asked for.
#[derive(Debug)]
pub(crate) enum Consent {}

/// Refuses.
pub(crate) fn consent(_: &[&str], _: bool) -> Result<Consent, Failure> {
    let help = "build the program with it: `cargo build --release --features ethercrab`";
    Err(Failure::new(Exit::Usage, "this build has no `--second-opinion`", help))
}

/// Never called: nobody has the word.
pub(in crate::desk) fn sections(
    _: &mut SegmentSession,
    _: &str,
    consent: &Consent,
    _: &Output,
) -> Result<(Vec<Section>, Value), Failure> {
    match *consent {}
}
