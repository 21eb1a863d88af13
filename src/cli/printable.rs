//! Text that cannot do anything to a terminal.

use std::borrow::Cow;

/// Returns the text on one line, with escapes for all characters that control a terminal: a device chooses its own names.
pub(super) fn one_line(text: &str) -> Cow<'_, str> {
    if !text.contains(char::is_control) {
        return Cow::Borrowed(text);
    }
    let escaped = |one: char| if one.is_control() { one.escape_debug().to_string() } else { one.to_string() };
    Cow::Owned(text.chars().map(escaped).collect())
}

/// Returns the text with escapes for characters that control a terminal: names of files and texts of devices may have them.
pub(super) fn printable(text: &str) -> Cow<'_, str> {
    let is_obeyed = |one: char| one.is_control() && !matches!(one, '\n' | '\t');
    if !text.contains(is_obeyed) {
        return Cow::Borrowed(text);
    }
    let escaped = |one: char| if is_obeyed(one) { one.escape_debug().to_string() } else { one.to_string() };
    Cow::Owned(text.chars().map(escaped).collect())
}
