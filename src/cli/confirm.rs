//! Questions to a person before an action.
//!
//! The answer to a question of safety has to come from a person who has read the question. On a terminal [`ask`] therefore discards
//! all input from before the question, and all input within [`READING`] after it; then it asks again. Only the word `yes` counts as
//! a yes. Input that is no terminal cannot be discarded: each question takes its next line.

use std::io::{self, BufRead, Write};
use std::os::fd::BorrowedFd;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::read;
use rustix::stdio::stdin;
use rustix::termios::{QueueSelector, isatty, tcflush};

use super::fit;
use super::printable::printable;

/// Nobody reads a question and answers it in less time.
const READING: Duration = Duration::from_millis(300);
/// Interval at which a question checks whether it still waits for an answer.
const LOOK_UP: Duration = Duration::from_millis(100);
/// Longest answer in bytes; a longer one is none.
const LONGEST: usize = 4096;

/// Whether a person answers yes.
pub(super) fn agreed(what: &str) -> bool {
    is_yes(ask(&format!("{what}. Write yes to continue; anything else stops here:"), || true).as_deref())
}

/// Whether an answer is the one word that counts as a yes.
pub(super) fn is_yes(answer: Option<&str>) -> bool {
    answer == Some("yes")
}

/// Returns a person's answer on standard input, without the spaces around it. Returns `None` if nobody answers, at a signal that
/// the program handles, and once `waits` returns false. The function calls `waits` several times a second.
pub(super) fn ask(question: &str, waits: impl FnMut() -> bool) -> Option<String> {
    let columns = fit::columns(io::stderr()).unwrap_or(fit::USUAL);
    ask_on(stdin(), &mut io::stderr(), &fit::fitted(&printable(question), columns), waits)
}

fn ask_on(from: BorrowedFd<'_>, to: &mut dyn Write, question: &str, mut waits: impl FnMut() -> bool) -> Option<String> {
    let is_terminal = isatty(from);
    loop {
        if is_terminal {
            tcflush(from, QueueSelector::IFlush).ok()?;
        }
        // If standard error is closed, no message can reach anybody.
        let _ = write!(to, "{question} ").and_then(|()| to.flush());
        if !is_terminal || !comes_within_reading(from, &mut waits)? {
            break;
        }
        let _ = writeln!(to, "\nkeys pressed before the question are ignored: answer now");
        // A key that is held down is asked nothing until it is released.
        while comes_within_reading(from, &mut waits)? {
            tcflush(from, QueueSelector::IFlush).ok()?;
        }
    }
    // One byte at a time: the next line is for the next question.
    let (mut line, mut byte) = (Vec::new(), [0]);
    loop {
        if !comes_within(from, LOOK_UP)? {
            if waits() { continue } else { return None }
        }
        match read(from, &mut byte) {
            Ok(0) if line.is_empty() => {
                // The next line is none of an answer.
                let _ = writeln!(to);
                return None;
            }
            Ok(0) => break,
            Ok(_) if byte == *b"\n" => break,
            Ok(_) if line.len() < LONGEST => line.extend(byte),
            _ => return None,
        }
    }
    Some(String::from_utf8_lossy(&line).trim().to_owned())
}

/// Whether input comes before anybody can have read a question; `None` where nobody can answer.
fn comes_within_reading(from: BorrowedFd<'_>, waits: &mut impl FnMut() -> bool) -> Option<bool> {
    let asked = Instant::now();
    while let Some(left) = READING.checked_sub(asked.elapsed()).filter(|left| !left.is_zero()) {
        if comes_within(from, left.min(LOOK_UP))? {
            return Some(true);
        }
        if !waits() {
            return None;
        }
    }
    Some(false)
}

/// Whether there is input within this time; `None` after an interrupt, and where the terminal is gone.
fn comes_within(from: BorrowedFd<'_>, longest: Duration) -> Option<bool> {
    let longest = Timespec { tv_sec: 0, tv_nsec: longest.subsec_nanos().into() };
    let mut looked = [PollFd::new(&from, PollFlags::IN)];
    let count = poll(&mut looked, Some(&longest)).ok()?;
    let [looked] = looked.map(|looked| looked.revents());
    // A pipe whose other end is closed may still hold lines.
    let is_gone = looked.intersects(PollFlags::ERR | PollFlags::NVAL);
    (!is_gone).then_some(count > 0)
}

/// Returns a person's answer to a question on which only files with a new name depend, without the spaces around it; `None` if
/// nobody answers. Answers that were typed ahead count.
pub(super) fn answer(from: &mut dyn BufRead, to: &mut dyn Write, question: &str) -> Option<String> {
    let mut line = String::new();
    let asked = write!(to, "{question} ").and_then(|()| to.flush());
    match asked.and_then(|()| from.read_line(&mut line)) {
        Ok(read) if read > 0 => Some(line.trim().to_owned()),
        // The next line is none of an answer.
        _ => writeln!(to).ok().and(None),
    }
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::os::fd::{AsFd, OwnedFd};
    use std::thread;

    use rustix::pty::{OpenptFlags, grantpt, ioctl_tiocgptpeer, openpt, unlockpt};

    use super::*;

    /// Returns the side of a person, and the side of the program.
    fn terminal() -> (File, OwnedFd) {
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let person = openpt(flags).unwrap();
        grantpt(&person).unwrap();
        unlockpt(&person).unwrap();
        let program = ioctl_tiocgptpeer(&person, flags).unwrap();
        (File::from(person), program)
    }

    /// A person who answers the first question before it can be read, and each later one long after it.
    struct Hasty {
        person: File,
        seen: String,
    }

    impl Write for Hasty {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.seen += std::str::from_utf8(bytes).unwrap();
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            let mut person = self.person.try_clone()?;
            if self.seen.matches("free?").count() == 1 {
                return person.write_all(b"yes\n");
            }
            thread::spawn(move || {
                thread::sleep(2 * READING);
                let _ = person.write_all(b" no \n");
            });
            Ok(())
        }
    }

    #[test]
    fn what_was_typed_before_a_question_could_be_read_is_no_answer_to_it() {
        let (mut person, program) = terminal();
        person.write_all(b"yes\nyes\nye").unwrap();
        let mut hasty = Hasty { person, seen: String::new() };
        assert_eq!(ask_on(program.as_fd(), &mut hasty, "Is it free?", || true).as_deref(), Some("no"));
        assert!(hasty.seen.starts_with("Is it free? \nkeys pressed before"), "{}", hasty.seen);
        assert!(hasty.seen.ends_with("answer now\nIs it free? "), "{}", hasty.seen);
    }

    #[test]
    fn a_question_ends_without_an_answer_once_it_waits_no_more_and_where_the_terminal_is_gone() {
        let (person, program) = terminal();
        let mut left = 5;
        let waits = || {
            left -= 1;
            left > 0
        };
        assert_eq!(ask_on(program.as_fd(), &mut io::sink(), "Is it free?", waits), None);
        drop(person);
        assert_eq!(ask_on(program.as_fd(), &mut io::sink(), "Is it free?", || true), None);
    }

    #[test]
    fn each_question_takes_the_next_line_of_what_is_no_terminal() {
        let (from, mut to) = io::pipe().unwrap();
        to.write_all(b" y\nyes\n\nlast").unwrap();
        drop(to);
        let answers: Vec<_> = (0..5).map(|_| ask_on(from.as_fd(), &mut io::sink(), "Is it free?", || true)).collect();
        assert_eq!(answers, [Some("y"), Some("yes"), Some(""), Some("last"), None].map(|text| text.map(str::to_owned)));
    }

    #[test]
    fn one_word_is_a_yes() {
        assert!(is_yes(Some("yes")));
        for other in ["y", "Yes", "YES", "yes.", "yes yes", "", "no"].map(Some).into_iter().chain([None]) {
            assert!(!is_yes(other), "{other:?}");
        }
    }
}
