//! Text in an image.

/// Returns the text of a string: up to the first NUL, UTF-8 where it is that, else Latin-1. Characters that a terminal would obey become
/// spaces.
pub(super) fn decode(bytes: &[u8]) -> String {
    let bytes = bytes.split(|byte| *byte == 0).next().unwrap_or_default();
    let shown = |one: char| if is_obeyed(one) { ' ' } else { one };
    match std::str::from_utf8(bytes) {
        Ok(text) => text.chars().map(shown).collect(),
        // Old images hold Latin-1.
        Err(_) => bytes.iter().map(|byte| shown(char::from(*byte))).collect(),
    }
}

/// Whether a terminal obeys a character instead of showing it: controls, and what turns the direction of text.
fn is_obeyed(one: char) -> bool {
    let turns = matches!(one, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    one.is_control() || turns
}

/// Returns the bytes of a string: UTF-8, as many whole characters as a string of an image can have.
pub(super) fn encode(text: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    for one in text.chars().take_while(|one| *one != '\0') {
        if bytes.len() + one.len_utf8() > u8::MAX.into() {
            break;
        }
        bytes.extend_from_slice(one.encode_utf8(&mut [0; 4]).as_bytes());
    }
    bytes
}
