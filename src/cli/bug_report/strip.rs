//! Text without the names of people and computers, and without serial numbers.

use std::collections::BTreeSet;
use std::path::Path;

use super::contents::{Content, Entry};

/// Word that replaces a name.
const USER: &str = "USER";
const HOST: &str = "HOST";
/// Folders below which each user has one.
const HOMES: [&str; 4] = ["/home/", "/Users/", "/var/home/", "\\Users\\"];
/// Names of users and computers that identify nobody.
const NOBODY: [&str; 5] = ["root", "localhost", "user", "host", "nobody"];
/// Number of digits below which a serial number is only replaced where it is labelled as one.
const TELLING_DIGITS: usize = 5;

/// Names that are taken out.
#[derive(Clone, Debug, Default)]
pub(super) struct Stripper {
    /// Whole paths, the longest first, with their replacements.
    paths: Vec<(String, &'static str)>,
    /// Words, with their replacements.
    words: Vec<(String, &'static str)>,
    /// Serial numbers as they are written.
    serials: BTreeSet<String>,
    with_serials: bool,
}

impl Stripper {
    /// Returns a stripper for the user and the computer of this process, and for the serial numbers in the entries.
    pub(super) fn of_this_computer(with_serials: bool, entries: &[Entry]) -> Self {
        let variables = ["USER", "LOGNAME", "USERNAME", "SUDO_USER"].map(std::env::var);
        let mut users: Vec<String> = variables.into_iter().flatten().collect();
        let homes: Vec<String> = ["HOME", "USERPROFILE"].map(std::env::var).into_iter().flatten().collect();
        users.extend(homes.iter().filter_map(|home| Some(Path::new(home).file_name()?.to_str()?.to_owned())));
        let files = ["/proc/sys/kernel/hostname", "/etc/hostname", "/proc/sys/kernel/domainname"];
        let mut hosts: Vec<String> = files.iter().filter_map(|file| std::fs::read_to_string(file).ok()).collect();
        hosts.extend(["HOSTNAME", "COMPUTERNAME"].map(std::env::var).into_iter().flatten());
        Self::new(&users, &hosts, &homes, with_serials, entries)
    }

    /// Returns a stripper for these names, and for the serial numbers in the entries.
    pub(super) fn new(
        users: &[String],
        hosts: &[String],
        homes: &[String],
        with_serials: bool,
        entries: &[Entry],
    ) -> Self {
        let mut paths: Vec<(String, &str)> = Vec::new();
        for home in homes {
            let home = home.trim_end_matches('/');
            let real = std::fs::canonicalize(home).ok().and_then(|path| path.to_str().map(str::to_owned));
            let each = [Some(home.to_owned()), real].into_iter().flatten();
            // The folder of root identifies nobody, and "/" is everywhere.
            paths.extend(each.filter(|path| path.len() > 1 && path != "/root").map(|path| (path, "~")));
        }
        paths.sort_by_key(|(path, _)| std::cmp::Reverse(path.len()));
        paths.dedup();
        let mut words: Vec<(String, &str)> = Vec::new();
        // The whole name of a computer, and its part before the domain.
        let hosts = hosts.iter().flat_map(|host| [host.trim(), host.trim().split('.').next().unwrap_or_default()]);
        let each = users.iter().map(|user| (user.trim(), USER)).chain(hosts.map(|host| (host, HOST)));
        for (word, by) in each {
            let tells = word.len() > 1 && !NOBODY.contains(&word.to_lowercase().as_str()) && word != "(none)";
            if tells && !words.iter().any(|(known, _)| known == word) {
                words.push((word.to_owned(), by));
            }
        }
        words.sort_by_key(|(word, _)| std::cmp::Reverse(word.len()));
        let mut stripper = Self { paths, words, serials: BTreeSet::new(), with_serials };
        if !with_serials {
            for entry in entries {
                if let Content::Text(text) = &entry.content {
                    let found = serial_spans(text).into_iter().filter_map(|(from, to)| text.get(from..to));
                    stripper.serials.extend(found.filter(|number| number.len() >= TELLING_DIGITS).map(str::to_owned));
                }
            }
        }
        stripper
    }

    /// Returns a text without names.
    pub(super) fn text(&self, text: &str) -> String {
        let mut text = text.to_owned();
        for (path, by) in &self.paths {
            text = text.replace(path.as_str(), by);
        }
        for home in HOMES {
            text = without_homes(&text, home);
        }
        for (word, by) in &self.words {
            text = without_word(&text, word, by);
        }
        if !self.with_serials {
            for (from, to) in serial_spans(&text).into_iter().rev() {
                text.replace_range(from..to, "0");
            }
            for serial in &self.serials {
                text = without_word(&text, serial, "0");
            }
        }
        text
    }

    /// Returns a file's name without personal names.
    pub(super) fn name(&self, name: &str) -> String {
        self.text(name).replace('~', "home")
    }
}

/// Replaces the name of any person after `/home/`.
fn without_homes(text: &str, home: &str) -> String {
    let mut parts = text.split(home);
    let mut whole = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let end = part
            .find(|one: char| matches!(one, '/' | '\\' | '"' | '\'' | ':' | ',' | ';' | ')') || one.is_whitespace());
        let (name, rest) = part.split_at(end.unwrap_or(part.len()));
        whole.push_str(home);
        whole.push_str(if name.is_empty() { "" } else { USER });
        whole.push_str(rest);
    }
    whole
}

/// Whether a letter is part of a word that is a name.
fn is_of_word(one: char) -> bool {
    one.is_alphanumeric()
}

/// Replaces a word in a text, in capitals or not. The word stays where it is part of a longer one, as `ann` in `channel`.
fn without_word(text: &str, word: &str, by: &str) -> String {
    let mut whole = String::with_capacity(text.len());
    let mut rest = text;
    let mut before = None;
    'text: while let Some(first) = rest.chars().next() {
        if !before.is_some_and(is_of_word) {
            // Letter by letter: capitals may take another number of bytes.
            let mut letters = rest.char_indices();
            let mut is_it = true;
            for wanted in word.chars() {
                is_it &= letters.next().is_some_and(|(_, one)| one.to_lowercase().eq(wanted.to_lowercase()));
            }
            let after = letters.next();
            if is_it && !after.is_some_and(|(_, one)| is_of_word(one)) {
                whole.push_str(by);
                before = by.chars().next_back();
                rest = after.and_then(|(at, _)| rest.get(at..)).unwrap_or_default();
                continue 'text;
            }
        }
        whole.push(first);
        before = Some(first);
        rest = rest.get(first.len_utf8()..).unwrap_or_default();
    }
    whole
}

/// Returns the places of serial numbers: first and last byte.
fn serial_spans(text: &str) -> Vec<(usize, usize)> {
    let mut spans = Vec::new();
    let lower = text.to_ascii_lowercase();
    for (at, word) in lower.match_indices("serial") {
        let mut next = at + word.len();
        let skip = |from: usize, is_skipped: &dyn Fn(u8) -> bool| {
            from + lower.as_bytes().iter().skip(from).take_while(|byte| is_skipped(**byte)).count()
        };
        // The rest of the key, such as `_number` or `-no.`.
        next = skip(next, &|byte| byte.is_ascii_alphabetic() || matches!(byte, b'_' | b'-' | b' '));
        loop {
            let from = skip(next, &|byte| {
                matches!(byte, b' ' | b'\t' | b'"' | b'\'' | b':' | b'=' | b'#' | b'.' | b'(' | b')' | b'[' | b',')
            });
            let to = skip(from, &|byte| byte.is_ascii_alphanumeric() || byte == b'-');
            let Some(number) = lower.get(from..to) else { break };
            // A number, or a number with letters as makers write them.
            if !number.bytes().any(|byte| byte.is_ascii_digit()) || spans.last().is_some_and(|(_, end)| from < *end) {
                break;
            }
            spans.push((from, to));
            next = to;
            // A value in hexadecimal may follow in brackets.
            if lower.get(to..).is_none_or(|rest| !rest.starts_with(" (")) {
                break;
            }
        }
    }
    spans
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stripper(with_serials: bool) -> Stripper {
        let names = |each: &[&str]| each.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
        Stripper::new(
            &names(&["ann", "root"]),
            &names(&["bench-7.lab.example", "localhost"]),
            &names(&["/home/ann"]),
            with_serials,
            &[],
        )
    }

    #[test]
    fn names_are_taken_out_and_words_that_hold_them_stay() {
        let stripper = stripper(false);
        for (text, wanted) in [
            ("/home/ann/rigs/a.yaml", "~/rigs/a.yaml"),
            ("/home/bob/x and /Users/Carla/y: z", "/home/USER/x and /Users/USER/y: z"),
            ("written by Ann on bench-7.lab.example (BENCH-7)", "written by USER on HOST (HOST)"),
            ("a channel, a manner, anna, ann_a", "a channel, a manner, anna, USER_a"),
            ("root of localhost", "root of localhost"),
            ("ann@bench-7:~$", "USER@HOST:~$"),
            ("", ""),
        ] {
            assert_eq!(stripper.text(text), wanted);
        }
        assert_eq!(stripper.name("config/ann-rig.yaml"), "config/USER-rig.yaml");
    }

    #[test]
    fn serial_numbers_are_zero_unless_they_are_asked_for() {
        for (text, wanted) in [
            (r#"{"serial_number": 123456, "revision": 2}"#, r#"{"serial_number": 0, "revision": 2}"#),
            ("1018h:4  serial-number  42 (0000002Ah)", "1018h:4  serial-number  0 (0"),
            ("Serial No. AB-1234", "Serial No. 0"),
            ("# serial: none", "# serial: none"),
            ("serialised 7 times", "serialised 0 times"),
        ] {
            assert!(stripper(false).text(text).starts_with(wanted), "{text}: {}", stripper(false).text(text));
            assert_eq!(stripper(true).text(text), text);
        }
    }

    #[test]
    fn a_serial_number_that_is_known_is_taken_out_where_it_is_not_called_one() {
        let text = |text: &str| Entry { name: "a".into(), content: Content::Text(text.into()) };
        let entries = [text(r#""serial_number": 1234567"#), text("drive 1234567 of 12345678")];
        let stripper = Stripper::new(&[], &[], &[], false, &entries);
        assert_eq!(stripper.text("drive 1234567 of 12345678"), "drive 0 of 12345678");
    }

    proptest::proptest! {
        #[test]
        fn whatever_the_text_no_name_is_left(text in ".{0,80}", at in 0usize..80) {
            let at = (0..=at.min(text.len())).rev().find(|at| text.is_char_boundary(*at)).unwrap_or(0);
            let (head, tail) = text.split_at(at);
            let planted = format!("{head} ann {tail} /home/ann/x bench-7 {head}");
            let left = stripper(false).text(&planted).to_lowercase();
            let words: Vec<&str> = left.split(|one: char| !one.is_alphanumeric()).collect();
            proptest::prop_assert!(!words.contains(&"ann"), "{left}");
            proptest::prop_assert!(!left.contains("bench-7"), "{left}");
        }
    }
}
