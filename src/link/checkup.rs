//! Lines of a check-up of a computer, an interface or a device: the subject, its state, and the fix.
//!
//! One part gathers the facts, another judges them: a judgement takes facts and returns [`Check`]s, and reads nothing itself.

use std::fmt;

/// State of a subject.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// As it should be.
    Ok,
    /// The value could not be read.
    Unknown,
    /// A rig runs with reduced performance.
    Warning,
    /// It keeps a rig from running, or from running in time.
    Wrong,
}

impl Verdict {
    /// Its word.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Unknown => "unknown",
            Self::Warning => "warning",
            Self::Wrong => "wrong",
        }
    }
}

/// One subject of a check-up.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Check {
    /// Subject of the check, in a word or two.
    pub subject: &'static str,
    /// Its state.
    pub verdict: Verdict,
    /// Finding.
    pub found: String,
    /// Consequence, or the place to look at; empty if there is none.
    pub follows: String,
    /// The command that fixes it, as it is typed into a shell; `None` where no command does.
    pub fix: Option<String>,
}

impl Check {
    /// Creates a finding, from which nothing follows yet.
    pub fn new(subject: &'static str, verdict: Verdict, found: impl Into<String>) -> Self {
        Self { subject, verdict, found: found.into(), follows: String::new(), fix: None }
    }

    /// Creates a finding that is as it should be.
    pub fn ok(subject: &'static str, found: impl Into<String>) -> Self {
        Self::new(subject, Verdict::Ok, found)
    }

    /// Creates a finding that could not be read.
    pub fn unknown(subject: &'static str, found: impl Into<String>) -> Self {
        Self::new(subject, Verdict::Unknown, found)
    }

    /// Creates a finding with which a rig runs less well.
    pub fn warning(subject: &'static str, found: impl Into<String>) -> Self {
        Self::new(subject, Verdict::Warning, found)
    }

    /// Creates a finding that keeps a rig from running.
    pub fn wrong(subject: &'static str, found: impl Into<String>) -> Self {
        Self::new(subject, Verdict::Wrong, found)
    }

    /// Adds the consequence.
    #[must_use]
    pub fn follows(self, follows: impl Into<String>) -> Self {
        Self { follows: follows.into(), ..self }
    }

    /// Adds the command that fixes it.
    #[must_use]
    pub fn fix(self, command: impl Into<String>) -> Self {
        Self { fix: Some(command.into()), ..self }
    }
}

/// In one sentence, without the subject.
impl fmt::Display for Check {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.found)?;
        if !self.follows.is_empty() {
            write!(out, ": {}", self.follows)?;
        }
        self.fix.as_ref().map_or(Ok(()), |command| write!(out, "; set `{command}`"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_check_is_one_sentence() {
        let bare = Check::ok("queue", "10 frames");
        assert_eq!(bare.to_string(), "10 frames");
        let whole = Check::warning("queue", "10 000 frames").follows("they are old").fix("sudo ip");
        assert_eq!(whole.to_string(), "10 000 frames: they are old; set `sudo ip`");
    }
}
