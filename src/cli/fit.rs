//! Lines no wider than the terminal that they are printed on.

use std::iter::from_fn;

use terminal_size::{Width, terminal_size_of};
use textwrap::core::{Word, display_width};
use textwrap::{Options, WordSeparator, WordSplitter};

/// Minimum width in columns, however narrow the terminal is.
pub(super) const LEAST: usize = 40;

/// Columns of a terminal that does not say how many it has.
pub(super) const USUAL: usize = 80;

/// Returns the columns of a stream: those of its terminal, or else those in COLUMNS; `None` if neither is known.
#[cfg(unix)]
pub(super) fn columns(stream: impl std::os::fd::AsFd) -> Option<usize> {
    named(terminal_size_of(stream).map(|(Width(columns), _)| usize::from(columns)))
}

/// Returns the columns of a stream: those of its terminal, or else those in COLUMNS; `None` if neither is known.
#[cfg(windows)]
pub(super) fn columns(stream: impl std::os::windows::io::AsHandle) -> Option<usize> {
    named(terminal_size_of(stream).map(|(Width(columns), _)| usize::from(columns)))
}

fn named(of_terminal: Option<usize>) -> Option<usize> {
    // A terminal that does not know its size reports 0.
    let of_terminal = of_terminal.filter(|columns| *columns > 0);
    let of_shell = || std::env::var("COLUMNS").ok()?.parse().ok().filter(|columns| *columns > 0);
    of_terminal.or_else(of_shell)
}

/// Breaks each line of the text that is too wide between words. It indents the rest to the column after the first gap of two
/// spaces: to the text after a key, or to the last column of a table. Paths and text in backquotes stay whole, so that a person can
/// copy them.
pub(super) fn fitted(text: &str, columns: usize) -> String {
    let columns = columns.max(LEAST);
    let each = text
        .split('\n')
        .map(|line| if display_width(line) <= columns { line.to_owned() } else { hanging(line, columns) });
    each.collect::<Vec<_>>().join("\n")
}

fn hanging(line: &str, columns: usize) -> String {
    let margin = line.len() - line.trim_start_matches(' ').len();
    let inner = line.get(margin..).unwrap_or_default();
    let behind = |gap: usize| {
        let rest = inner.get(gap..).unwrap_or_default();
        margin + gap + rest.len() - rest.trim_start_matches(' ').len()
    };
    // A rest in the last third of the line would be a column of single words.
    let at =
        inner.find("  ").map(behind).filter(|at| display_width(line.get(..*at).unwrap_or(line)) <= columns * 2 / 3);
    let (head, body) = line.split_at_checked(at.unwrap_or(margin)).unwrap_or(("", line));
    filled(head, &" ".repeat(display_width(head)), body, columns)
}

/// Returns a text behind `head`, its further lines behind `indent`.
pub(super) fn filled(head: &str, indent: &str, text: &str, columns: usize) -> String {
    let options = Options::new(columns.max(LEAST)).initial_indent(head).subsequent_indent(indent);
    textwrap::fill(
        text,
        options.word_separator(SEPARATOR).word_splitter(WordSplitter::NoHyphenation).break_words(false),
    )
}

/// Places where a line may break: at spaces that are neither within backquotes nor between a number and its unit.
pub(super) const SEPARATOR: WordSeparator = WordSeparator::Custom(words);

fn words(line: &str) -> Box<dyn Iterator<Item = Word<'_>> + '_> {
    let mut rest = line;
    Box::new(from_fn(move || {
        let mut end = rest.len();
        let (mut is_quoted, mut begin) = (false, 0);
        for (at, one) in rest.char_indices() {
            let (before, behind) = rest.split_at_checked(at)?;
            match one {
                '`' => is_quoted = !is_quoted && behind.get(1..).is_some_and(|behind| behind.contains('`')),
                ' ' if !is_quoted && !behind.starts_with("  ") => {
                    let counts = behind
                        .get(1..)
                        .is_some_and(|behind| behind.starts_with(|one: char| one.is_ascii_alphabetic() || one == '%'));
                    if !(counts && before.get(begin..).is_some_and(is_number)) {
                        end = at + 1;
                        break;
                    }
                    begin = at + 1;
                }
                ' ' if !is_quoted => begin = at + 1,
                _ => {}
            }
        }
        let (word, behind) = rest.split_at_checked(end)?;
        rest = behind;
        (!word.is_empty()).then(|| Word::from(word))
    }))
}

fn is_number(word: &str) -> bool {
    word.starts_with(|one: char| one.is_ascii_digit()) && word.bytes().all(|one| one.is_ascii_digit() || one == b'.')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_follows_a_key_stays_behind_it_and_commands_stay_whole() {
        for (line, wanted) in [
            ("fits", "fits"),
            (
                "margins   loop at the joints, worst pose, 1 cycle of delay",
                "margins   loop at the joints, worst\n          pose, 1 cycle of delay",
            ),
            (
                "    a paragraph that is moved to the right and is too wide",
                "    a paragraph that is moved to the\n    right and is too wide",
            ),
            (
                "look at `yieldwall doctor node 5 --bus can0` and mend what it names",
                "look at\n`yieldwall doctor node 5 --bus can0` and\nmend what it names",
            ),
            (
                "a quote ` that has no end does not keep the rest together",
                "a quote ` that has no end does not keep\nthe rest together",
            ),
            (
                "kept      /home/somebody/.local/state/yieldwall/a-path-is-never-broken",
                "kept      /home/somebody/.local/state/yieldwall/a-path-is-never-broken",
            ),
            (
                "the phase is as it never was, is 33.8 deg at 56 Hz",
                "the phase is as it never was, is\n33.8 deg at 56 Hz",
            ),
            (
                "a key of forty columns that says something  x and y and z",
                "a key of forty columns that says\nsomething  x and y and z",
            ),
        ] {
            assert_eq!(fitted(line, 40), wanted);
        }
        assert_eq!(fitted("one\n\ntwo\n", 80), "one\n\ntwo\n");
    }

    /// Only spaces are lost, and a line is too wide only if it is a single word.
    #[test]
    fn every_line_fits_or_is_one_word() {
        use proptest::prelude::*;
        proptest!(|(text in "([a-z`é]{1,12}|/[a-z]{60}|  )( {1,3}[a-z`,;é]{1,12}){0,40}", columns in 1_usize..120)| {
            let fit = fitted(&text, columns);
            let letters = |text: &str| text.split_whitespace().collect::<String>();
            prop_assert_eq!(letters(&text), letters(&fit));
            for line in fit.lines().filter(|line| line.chars().count() > columns.max(LEAST)) {
                let at = line.find(|one: char| one != ' ').unwrap_or_default();
                let body = &line[at..];
                let (_, behind) = body.split_once("  ").unwrap_or(("", body));
                let is_word = |text: &str| words(text.trim_start()).count() <= 1;
                prop_assert!(is_word(body) || is_word(behind), "{:?}", line);
            }
        });
    }
}
