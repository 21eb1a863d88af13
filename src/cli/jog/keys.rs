//! Keys on standard input with which a person moves a joint, and the line that shows its angle.
//!
//! ```text
//! thread "keys":  standard input --> Keys, which the loop looks at once a cycle; the angle --> standard error
//! ```
//! A terminal delivers keys at once and does not echo them; signals and output are unchanged. Any other input delivers bytes until
//! it ends.

use std::io::{self, IsTerminal, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::{Errno, read};
use rustix::stdio::stdin;
use rustix::termios::{InputModes, LocalModes, OptionalActions, SpecialCodeIndex, Termios, tcgetattr, tcsetattr};

use crate::failure::{Exit, Failure};
use yieldwall_run::{Key, Keys};

/// Interval at which the thread checks whether the reading is over.
const LOOK: Timespec = Timespec { tv_sec: 0, tv_nsec: 50_000_000 };
/// Time from one line to the next.
const REFRESH: Duration = Duration::from_millis(100);

/// Description of the keys.
pub(super) const KEYS: &str = "press right or + for counter-clockwise, left or - for clockwise; space stops, q quits";

/// So near to its bound a joint is at it, rad.
const AT_BOUND_RAD: f64 = 1e-3;

/// An angle in rad that one thread sets and another one shows; not a number until it is set.
#[derive(Debug)]
pub(super) struct Shown(AtomicU64);

impl Default for Shown {
    fn default() -> Self {
        Self(AtomicU64::new(f64::NAN.to_bits()))
    }
}

impl Shown {
    /// Real-time: yes.
    pub(super) fn tell(&self, angle_rad: f64) {
        self.0.store(angle_rad.to_bits(), Ordering::Relaxed);
    }

    fn angle_rad(&self) -> Option<f64> {
        Some(f64::from_bits(self.0.load(Ordering::Relaxed))).filter(|angle| !angle.is_nan())
    }
}

/// Standard input while it is read; the terminal is as before afterwards.
pub(super) struct Reader {
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    before: Option<Termios>,
    /// Whether a line is shown.
    shows: bool,
}

impl Reader {
    /// Forwards the keys of standard input. If `shows`, it also displays the angle of this joint, whose travel to either side is
    /// limited to a number of rad.
    pub(super) fn start(
        keys: Arc<Keys>,
        shown: Arc<Shown>,
        (name, within_rad): (&str, f64),
        shows: bool,
    ) -> Result<Self, Failure> {
        let failed = |error: io::Error| Failure::new(Exit::Internal, format!("standard input: {error}"), "write --by");
        let before = if io::stdin().is_terminal() {
            Some(tcgetattr(stdin()).map_err(|error| failed(error.into()))?)
        } else {
            None
        };
        let is_over = Arc::new(AtomicBool::new(false));
        let shows = shows && io::stderr().is_terminal();
        let mut reader = Self { is_over: Arc::clone(&is_over), thread: None, before, shows };
        if let Some(before) = &reader.before {
            let mut at_once = before.clone();
            at_once.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
            // Without Ctrl-S and Ctrl-Z: stopped output or a stopped process would miss keys.
            at_once.input_modes.remove(InputModes::IXON);
            at_once.special_codes[SpecialCodeIndex::VSUSP] = 0;
            // Keys from before count for nothing.
            tcsetattr(stdin(), OptionalActions::Flush, &at_once).map_err(|error| failed(error.into()))?;
        }
        let name = name.to_owned();
        let mut from = None;
        let work = move || {
            attend(&keys, &is_over, || {
                if let Some(angle) = shown.angle_rad().filter(|_| shows) {
                    let way = angle - *from.get_or_insert(angle);
                    // If standard error is closed, no message can reach anybody.
                    let _ = write!(io::stderr(), "\r{}\u{1b}[K", line(&name, angle, way, within_rad));
                }
            });
            // Whatever has ended it: nobody can stop the joint by a key any more.
            keys.press(Key::End);
        };
        reader.thread = Some(thread::Builder::new().name("keys".to_owned()).spawn(work).map_err(failed)?);
        Ok(reader)
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has reported its end before.
            let _ = thread.join();
        }
        if self.shows {
            let _ = write!(io::stderr(), "\r\u{1b}[K");
        }
        if let Some(before) = &self.before {
            // Unread keys are not for the next reader. A closed terminal takes nothing.
            let _ = tcsetattr(stdin(), OptionalActions::Flush, before);
        }
    }
}

/// Returns the line for a joint at this angle after this travel in rad.
fn line(name: &str, angle_rad: f64, way_rad: f64, within_rad: f64) -> String {
    let is_at_bound = way_rad.abs() >= within_rad.abs() - AT_BOUND_RAD;
    let bound = if is_at_bound { " (limit of --within)" } else { "" };
    format!("{name}: {:.2} deg{bound}", angle_rad.to_degrees())
}

/// Forwards keys until the motion is over, standard input ends or the terminal closes.
fn attend(keys: &Keys, is_over: &AtomicBool, mut show: impl FnMut()) {
    let mut shown_at: Option<Instant> = None;
    while !is_over.load(Ordering::Relaxed) {
        if shown_at.is_none_or(|at| at.elapsed() >= REFRESH) {
            shown_at = Some(Instant::now());
            show();
        }
        let stdin = stdin();
        match poll(&mut [PollFd::new(&stdin, PollFlags::IN)], Some(&LOOK)) {
            Ok(0) | Err(Errno::INTR) => continue,
            Ok(_) => {}
            Err(_) => return,
        }
        let mut bytes = [0; 64];
        match read(stdin, &mut bytes) {
            Err(Errno::INTR | Errno::AGAIN) => {}
            Ok(0) | Err(_) => return,
            Ok(count) => {
                for key in keys_in(bytes.get(..count).unwrap_or_default()) {
                    keys.press(key);
                }
            }
        }
    }
}

/// Returns the keys in bytes that arrived together, and ignores other bytes.
fn keys_in(mut bytes: &[u8]) -> Vec<Key> {
    const ESCAPE: u8 = 0x1b;
    let mut keys = Vec::new();
    while let Some((first, rest)) = bytes.split_first() {
        let key = match first {
            b'+' | b'=' => Some(Key::Forward),
            b'-' => Some(Key::Backward),
            b' ' => Some(Key::Rest),
            // Ctrl-D.
            b'q' | b'Q' | 0x04 => Some(Key::End),
            &ESCAPE => match rest.split_first() {
                Some((b'[' | b'O', rest)) => {
                    // Up to the letter that ends the sequence; the arrows have nothing before it.
                    let last = rest.iter().position(|byte| byte.is_ascii_alphabetic() || *byte == b'~');
                    let (sequence, behind) = rest.split_at(last.map_or(rest.len(), |last| last + 1));
                    bytes = behind;
                    keys.extend(match sequence {
                        b"C" => Some(Key::Forward),
                        b"D" => Some(Key::Backward),
                        _ => None,
                    });
                    continue;
                }
                // Esc, whatever comes with it.
                _ => Some(Key::End),
            },
            _ => None,
        };
        keys.extend(key);
        bytes = rest;
    }
    keys
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_joint_at_its_bound_is_told_to_be_there() {
        assert_eq!(Shown::default().angle_rad(), None);
        assert_eq!(line("left", 1.0, 0.1, 0.2), "left: 57.30 deg");
        assert_eq!(line("left", 1.0, -0.2, 0.2), "left: 57.30 deg (limit of --within)");
    }

    #[test]
    fn arrows_signs_and_what_ends_are_keys_and_nothing_else_is() {
        use Key::{Backward, End, Forward, Rest};
        for (bytes, keys) in [
            (b"\x1b[C\x1b[C\x1b[D".as_slice(), &[Forward, Forward, Backward][..]),
            (b"+=-", &[Forward, Forward, Backward]),
            (b"\x1bOC", &[Forward]),
            (b" ", &[Rest]),
            (b"\x1b", &[End]),
            (b"+\x1b", &[Forward, End]),
            (b"\x1b+", &[End, Forward]),
            (b"\x1b\x1b[C", &[End, Forward]),
            (b"q", &[End]),
            (b"\x04", &[End]),
            // Page up, F5, up, and letters: a held arrow with Control is none either.
            (b"\x1b[5~\x1b[15~\x1b[A\x1b[1;5Cxyz\r\n", &[]),
            ("ä€".as_bytes(), &[]),
        ] {
            assert_eq!(keys_in(bytes), keys, "{bytes:?}");
        }
    }
}
