//! Timing that a measurement has shown of a computer, kept for the runs by the wall clock that ask for it.

use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::latency::{Lateness, STOCK_CYCLES, Tier};
use crate::fnv1a;
use yieldwall_config as config;
use yieldwall_record::trusted;

/// Greatest tool speed on a computer of tier B, m/s.
///
/// # Source
/// Reduced speed of ISO 10218-1 (2011).
pub const REDUCED_SPEED_M_PER_S: f64 = 0.25;
/// Greatest force on the tool on a computer of tier B, N.
///
/// # Source
/// ISO/TS 15066 (2016), table A.2: quasi-static contact of hand and fingers.
pub const REDUCED_FORCE_N: f64 = 140.0;

/// All on which it depends how late a loop wakes up, and that stays the same from one start of the computer to the next.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Computer {
    /// Its name: a folder of records may be shared.
    pub name: String,
    /// Release and version of the kernel, as `uname -rv` has them.
    pub kernel: String,
    /// Profile by which the program was built, such as `dist`; empty in records that do not name it.
    #[serde(default)]
    pub profile: String,
    /// Whether the loop has the priority that it asks for.
    pub has_priority: bool,
    /// Whether its memory is locked.
    pub has_locked_memory: bool,
}

impl fmt::Display for Computer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let with = |is_so| if is_so { "with" } else { "without" };
        let Self { name, kernel, profile, has_priority, has_locked_memory } = self;
        let (priority, memory) = (with(*has_priority), with(*has_locked_memory));
        write!(f, "{name} ({kernel}; {priority} SCHED_FIFO, {memory} locked memory, built by the profile `{profile}`)")
    }
}

/// A measurement on disk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Where.
    pub computer: Computer,
    /// At which cycle, in us.
    pub period_us: u32,
    /// Measured delays of the wake-ups.
    pub lateness: Lateness,
    /// Load on the computer during the measurement; `None` if there was none on purpose.
    #[serde(default)]
    pub load: Option<String>,
    /// When it ended, in s since 1970.
    pub ended_unix_s: u64,
    /// Version of the program that measured.
    pub version: String,
}

/// The measurement that counts from now on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stored {
    /// Path of the file.
    pub path: PathBuf,
    /// Whether it is an earlier one, which proves more.
    pub is_earlier: bool,
}

impl Measured {
    /// Creates the record of a measurement without load that ended at a moment in s since 1970.
    pub fn new(computer: Computer, period_us: u32, lateness: Lateness, ended_unix_s: u64) -> Self {
        let version = env!("CARGO_PKG_VERSION").to_owned();
        Self { computer, period_us, lateness, load: None, ended_unix_s, version }
    }

    /// Returns the measurement with this load.
    #[must_use]
    pub fn under(self, load: Option<String>) -> Self {
        Self { load, ..self }
    }

    fn path(&self, folder: &Path) -> PathBuf {
        let Computer { name, kernel, profile, has_priority, has_locked_memory } = &self.computer;
        let text = format!("{name}\n{kernel}\n{profile}\n{has_priority} {has_locked_memory} {}", self.period_us);
        folder.join(format!("{:016x}.json", fnv1a(text.as_bytes())))
    }

    /// Stores it in place of an earlier measurement of this computer at this cycle. An earlier one that has proved a higher tier
    /// stays if this one is too short to prove that tier and does not contradict it.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn store(&self, folder: &Path) -> io::Result<Stored> {
        let path = self.path(folder);
        let (tier, proven) = (self.lateness.tier(self.period_us), self.lateness.proven(self.period_us));
        let is_better = |other: &Self| {
            let other_proven = other.lateness.proven(self.period_us);
            other.computer == self.computer && other_proven < proven && tier <= other_proven
        };
        if read(&path).ok().flatten().as_ref().is_some_and(is_better) {
            return Ok(Stored { path, is_earlier: true });
        }
        trusted::write(&path, serde_json::to_string_pretty(self)?.as_bytes())?;
        Ok(Stored { path, is_earlier: false })
    }

    /// Describes the result and its age at `now_unix_s`, for a person.
    fn shown(&self, period_us: u32, now_unix_s: u64) -> String {
        let Lateness { cycles, missed, p999_us, p9999_us, max_us } = self.lateness;
        let ago = ago(now_unix_s.saturating_sub(self.ended_unix_s));
        let at = if self.period_us == period_us { String::new() } else { format!(" at {} us", self.period_us) };
        let load = if self.load.is_some() { "under load" } else { "without load" };
        format!(
            "{cycles} cycles{at} measured {load} {ago}: lateness 99.9 % {p999_us:.0} us, 99.99 % {p9999_us:.0} us, max {max_us:.0} us; \
             {missed} missed"
        )
    }
}

/// The timing that a rig may count on.
#[derive(Clone, Debug, PartialEq)]
pub struct ProvenTiming {
    /// Tier that was proved for the cycle.
    pub tier: Tier,
    /// Description of the measurement, with its age.
    pub shown: String,
}

/// Why a rig must not run by the wall clock of this computer.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Untimely {
    /// Nothing was measured.
    #[error("no measured wake-up latency of {computer} at a cycle of {period_us} us or below ({})", .folder.display())]
    Missing {
        /// The computer.
        computer: Computer,
        /// The rig's cycle in us.
        period_us: u32,
        /// Folder of the records.
        folder: PathBuf,
    },
    /// There may be a record, but others may have written it.
    #[error("no trusted record of this computer's wake-up latency at a cycle of {period_us} us or below: {reason}")]
    Unbelieved {
        /// The rig's cycle in us.
        period_us: u32,
        /// Why, with the command that changes it.
        reason: String,
    },
    /// The cycle is not kept.
    #[error(
        "this computer is of tier C at the rig's cycle of {period_us} us, but the wall clock requires tier B (3000 cycles, \
         99.9 % at most {} us late): {shown}",
        .period_us / 2
    )]
    Late {
        /// The rig's cycle in us.
        period_us: u32,
        /// Description of the measurement, with its age.
        shown: String,
    },
    /// The cycle was kept in too few cycles for a proof.
    #[error(
        "too few cycles at the rig's cycle of {period_us} us: {cycles} of the {STOCK_CYCLES} that tier B needs (99.9 % at most {} us \
         late): {shown}",
        .period_us / 2
    )]
    Short {
        /// The rig's cycle in us.
        period_us: u32,
        /// Measured cycles.
        cycles: u64,
        /// Description of the measurement, with its age.
        shown: String,
    },
    /// The limits are those of a higher tier.
    #[error(
        "the rig's {key} of {has} {unit} requires tier A, but this computer has proved tier B (limit {most} {unit}): {shown}"
    )]
    Limit {
        /// The key of the limit.
        key: &'static str,
        /// Configured value.
        has: f64,
        /// Largest permitted value.
        most: f64,
        /// Its unit.
        unit: &'static str,
        /// Description of the measurement, with its age.
        shown: String,
    },
}

impl Computer {
    /// Returns the timing that this computer has proved for a rig, at a moment in s since 1970.
    ///
    /// Among the measurements at cycles that are not longer than the rig's, the one at the longest cycle counts. A computer that
    /// keeps a cycle keeps a slower one as well, and its measured delays show how well.
    ///
    /// # Errors
    /// Why the rig must not run by the wall clock.
    pub fn check(&self, rig: &config::Rig, folder: &Path, now_unix_s: u64) -> Result<ProvenTiming, Untimely> {
        let period_us = rig.cycle.period_us;
        let files = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
        let mut unbelieved = None;
        let found = files.filter_map(|path| {
            read(&path).unwrap_or_else(|error| {
                unbelieved.get_or_insert(error.to_string());
                None
            })
        });
        let own = found.filter(|found| found.computer == *self && found.period_us <= period_us);
        let Some(found) = own.max_by_key(|found| found.period_us) else {
            return Err(match unbelieved {
                Some(reason) => Untimely::Unbelieved { period_us, reason },
                None => Untimely::Missing { computer: self.clone(), period_us, folder: folder.to_owned() },
            });
        };
        let (tier, shown) = (found.lateness.proven(period_us), found.shown(period_us, now_unix_s));
        let limits = [
            ("guard.tool_speed_limit_m_per_s", rig.guard.tool_speed_limit_m_per_s.get(), REDUCED_SPEED_M_PER_S, "m/s"),
            ("guard.force_limit_n", rig.guard.force_limit_n.get(), REDUCED_FORCE_N, "N"),
        ];
        match tier {
            Tier::A => Ok(ProvenTiming { tier, shown }),
            Tier::B => match limits.into_iter().find(|(_, has, most, _)| has > most) {
                Some((key, has, most, unit)) => Err(Untimely::Limit { key, has, most, unit, shown }),
                None => Ok(ProvenTiming { tier, shown }),
            },
            Tier::C if found.lateness.tier(period_us) != Tier::C => {
                Err(Untimely::Short { period_us, cycles: found.lateness.cycles, shown })
            }
            Tier::C => Err(Untimely::Late { period_us, shown }),
        }
    }
}

/// Reads a record; `None` if the file is not a record.
///
/// # Errors
/// If it cannot be read or believed.
fn read(path: &Path) -> io::Result<Option<Measured>> {
    trusted::read(path).map(|text| serde_json::from_str(&text).ok())
}

fn ago(seconds: u64) -> String {
    match seconds {
        0..120 => format!("{seconds} s ago"),
        120..7200 => format!("{} min ago", seconds / 60),
        7200..172_800 => format!("{} h ago", seconds / 3600),
        _ => format!("{} days ago", seconds / 86_400),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::host::PROVING_CYCLES;

    const ENDED_S: u64 = 1_795_000_000;
    const NOW_S: u64 = ENDED_S + 150;

    const GOOD: Lateness = Lateness { cycles: PROVING_CYCLES, missed: 0, p999_us: 20.0, p9999_us: 40.0, max_us: 90.0 };
    const STOCK: Lateness =
        Lateness { cycles: STOCK_CYCLES, missed: 3, p999_us: 480.0, p9999_us: 4000.0, max_us: 9000.0 };

    fn computer() -> Computer {
        let (name, kernel) = ("bench".to_owned(), "6.12.1 #1 SMP PREEMPT_RT".to_owned());
        Computer { name, kernel, profile: "dist".to_owned(), has_priority: true, has_locked_memory: true }
    }

    fn rig(file: &str) -> config::Rig {
        config::load_rig(config::Source::named(&format!("builtin:{file}"))).unwrap().value
    }

    fn measured(computer: Computer, period_us: u32, lateness: Lateness) -> Measured {
        Measured::new(computer, period_us, lateness, ENDED_S)
    }

    /// A folder of its own, which does not exist yet.
    fn folder(name: &str) -> PathBuf {
        std::env::temp_dir().join(format!("yieldwall-timing-{name}-{}", std::process::id()))
    }

    #[test]
    fn the_tier_that_was_proved_decides_over_the_limits() {
        let folder = folder("limits");
        let (fast, reduced) = (rig("paper-admittance.yaml"), rig("paper-admittance-5ms.yaml"));
        assert!(matches!(computer().check(&fast, &folder, NOW_S), Err(Untimely::Missing { period_us: 1000, .. })));
        measured(computer(), 1000, STOCK).store(&folder).unwrap();
        let refused = computer().check(&fast, &folder, NOW_S).unwrap_err();
        assert!(matches!(refused, Untimely::Limit { key: "guard.tool_speed_limit_m_per_s", .. }), "{refused}");
        assert!(
            refused.to_string().contains("3000 cycles measured without load 2 min ago: lateness 99.9 % 480 us"),
            "{refused}"
        );
        // At 1 ms it is B; at 5 ms as well, since a cycle was missed.
        assert_eq!(computer().check(&reduced, &folder, NOW_S).map(|kept| kept.tier), Ok(Tier::B));
        let mut strong = reduced.clone();
        strong.guard.force_limit_n = fast.guard.force_limit_n;
        assert!(matches!(
            computer().check(&strong, &folder, NOW_S),
            Err(Untimely::Limit { key: "guard.force_limit_n", .. })
        ));
        measured(computer(), 1000, GOOD).store(&folder).unwrap();
        assert_eq!(computer().check(&fast, &folder, NOW_S).map(|kept| kept.tier), Ok(Tier::A));
        measured(computer(), 1000, Lateness { p999_us: 501.0, ..STOCK }).store(&folder).unwrap();
        assert!(matches!(computer().check(&fast, &folder, NOW_S), Err(Untimely::Late { .. })));
        // The same lateness is a tenth of a cycle of 5 ms.
        assert_eq!(computer().check(&reduced, &folder, NOW_S).map(|kept| kept.tier), Ok(Tier::B));
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn only_this_computer_at_this_cycle_or_a_faster_one_counts() {
        let folder = folder("others");
        let fast = rig("paper-admittance.yaml");
        let others = [
            Computer { name: "other".to_owned(), ..computer() },
            Computer { kernel: "6.12.2".to_owned(), ..computer() },
            Computer { profile: "release".to_owned(), ..computer() },
            Computer { profile: String::new(), ..computer() },
            Computer { has_priority: false, ..computer() },
            Computer { has_locked_memory: false, ..computer() },
        ];
        for other in others {
            measured(other, 1000, GOOD).store(&folder).unwrap();
        }
        measured(computer(), 2000, GOOD).store(&folder).unwrap();
        fs::write(folder.join("no-record.json"), "{").unwrap();
        assert!(matches!(computer().check(&fast, &folder, NOW_S), Err(Untimely::Missing { .. })));
        measured(computer(), 1000, GOOD).store(&folder).unwrap();
        assert!(computer().check(&fast, &folder, NOW_S).is_ok());
        // Of two that could count, the one nearer to the rig's cycle does.
        measured(computer(), 5000, Lateness { p999_us: 2600.0, ..STOCK }).store(&folder).unwrap();
        let slow = rig("paper-admittance-5ms.yaml");
        assert!(matches!(computer().check(&slow, &folder, NOW_S), Err(Untimely::Late { .. })));
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_short_look_takes_no_proof_away_and_a_bad_one_does() {
        let folder = folder("short");
        let fast = rig("paper-admittance.yaml");
        measured(computer(), 1000, GOOD).store(&folder).unwrap();
        measured(computer(), 1000, Lateness { cycles: 10_000, ..GOOD }).store(&folder).unwrap();
        assert_eq!(computer().check(&fast, &folder, NOW_S).map(|kept| kept.tier), Ok(Tier::A));
        measured(computer(), 1000, Lateness { cycles: 10_000, max_us: 101.0, ..GOOD }).store(&folder).unwrap();
        assert!(computer().check(&fast, &folder, NOW_S).is_err());
        // The same of tier B, which takes 3000 cycles.
        let reduced = rig("paper-admittance-5ms.yaml");
        let look = |p999_us| measured(computer(), 1000, Lateness { cycles: 200, p999_us, ..STOCK });
        let few = self::folder("few");
        look(499.0).store(&few).unwrap();
        let short = computer().check(&reduced, &few, NOW_S).unwrap_err();
        fs::remove_dir_all(&few).unwrap();
        assert!(
            short.to_string().contains("too few cycles") && short.to_string().contains("200 of the 3000"),
            "{short}"
        );
        let stored = measured(computer(), 1000, STOCK).store(&folder).unwrap();
        assert!(!stored.is_earlier && computer().check(&reduced, &folder, NOW_S).is_ok());
        assert_eq!(look(499.0).store(&folder).unwrap(), Stored { is_earlier: true, ..stored.clone() });
        assert!(computer().check(&reduced, &folder, NOW_S).is_ok());
        assert_eq!(look(501.0).store(&folder).unwrap(), stored);
        assert!(computer().check(&reduced, &folder, NOW_S).is_err());
        fs::remove_dir_all(&folder).unwrap();
    }

    #[cfg(all(feature = "ethernet", target_os = "linux"))]
    #[test]
    fn a_record_that_others_may_have_written_proves_nothing() {
        let folder = folder("unbelieved");
        let rig = rig("paper-admittance-5ms.yaml");
        let path = measured(computer(), 5000, GOOD).store(&folder).unwrap().path;
        for at in [&path, &folder] {
            crate::sample::let_others_write(at);
            let refused = computer().check(&rig, &folder, NOW_S).unwrap_err();
            let command = format!("`chmod go-w {}`", at.display());
            assert!(
                matches!(refused, Untimely::Unbelieved { .. }) && refused.to_string().contains(&command),
                "{refused}"
            );
        }
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_record_says_whether_it_was_measured_under_load() {
        let folder = folder("load");
        let rig = rig("paper-admittance-5ms.yaml");
        let shown = || computer().check(&rig, &folder, NOW_S).unwrap().shown;
        let path = measured(computer(), 5000, GOOD).under(Some("two threads".to_owned())).store(&folder).unwrap().path;
        assert!(shown().contains("cycles measured under load 2 min ago"), "{}", shown());
        assert!(fs::read_to_string(&path).unwrap().contains(r#""load": "two threads""#));
        // A record of an earlier build says nothing of it.
        let text = fs::read_to_string(&path).unwrap().replace("  \"load\": \"two threads\",\n", "");
        assert!(!text.contains("load"));
        fs::write(&path, text).unwrap();
        assert!(shown().contains("cycles measured without load 2 min ago"), "{}", shown());
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn ages_are_told_in_one_unit() {
        let told = [0, 119, 120, 7199, 7200, 172_799, 172_800, 864_000].map(ago);
        assert_eq!(
            told,
            ["0 s ago", "119 s ago", "2 min ago", "119 min ago", "2 h ago", "47 h ago", "2 days ago", "10 days ago"]
        );
    }
}
