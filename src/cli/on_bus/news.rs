//! What the thread of the cycle tells, for a person.

use crate::cli::on_bus::warn;
use crate::cli::output::Output;
use crate::cli::progress::Progress;
use crate::host::News;

/// Prints each piece of news; with `is_strict` what was refused is told as an error later.
pub(in crate::cli) fn print_news(is_strict: bool, output: &mut Output) -> impl FnMut(News) {
    let mut line: Option<Progress> = None;
    move |news| match news {
        News::Refused(_) if is_strict => {}
        News::Refused(refusal) => warn(output, refusal),
        News::Waiting(Some(text)) => line.get_or_insert_with(|| Progress::line(output)).begin(&text),
        News::Waiting(None) => line.take().into_iter().for_each(Progress::end),
    }
}
