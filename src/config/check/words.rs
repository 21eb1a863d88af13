//! Numbers in messages.

/// A text in which long numbers are cut to three significant digits.
pub(super) fn shorten_numbers(text: &str) -> String {
    let shorten = |word: &str| {
        let number = word.trim_end_matches([',', ';', ':']);
        let tail = word.get(number.len()..).unwrap_or_default();
        match number.parse::<f64>() {
            Ok(value) if number.len() > 6 && value.is_finite() => format!("{}{tail}", round(value)),
            _ => word.to_owned(),
        }
    };
    text.split(' ').map(shorten).collect::<Vec<_>>().join(" ")
}

/// Three significant digits, for messages.
pub(super) fn round(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_numbers_are_cut_and_words_stay() {
        assert_eq!(shorten_numbers("0.75 m, 0.050000000000000044, short"), "0.75 m, 0.05, short");
        assert_eq!(shorten_numbers("infinity"), "infinity");
    }
}
