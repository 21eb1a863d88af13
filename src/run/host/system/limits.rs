//! Limits of this process for real time.

use std::io;
use std::thread;

use rustix::process::{Resource, getrlimit};

use super::scheduler::{PRIORITY, Refusal, lock_memory, run_first};
use yieldwall_link::checkup::Check;

/// Limits of this process, and the priority and memory that it gets when it asks as the loop does.
#[derive(Debug)]
pub struct Limits {
    /// Greatest real-time priority that may be asked for without a privilege (RLIMIT_RTPRIO); `None` for no limit.
    pub priority_limit: Option<u64>,
    /// Most memory in bytes that may be locked without a privilege (RLIMIT_MEMLOCK); `None` for no limit.
    pub memory_limit: Option<u64>,
    /// Whether a thread got SCHED_FIFO.
    pub priority: Result<(), Refusal>,
    /// Whether memory was locked.
    pub memory: Result<(), Refusal>,
}

/// Asks for all that the loop asks for. The memory of this process is locked from then on, if that is granted.
pub fn limits() -> Limits {
    // On a thread of its own, which ends with it.
    let thread = thread::Builder::new().spawn(run_first);
    let priority = match thread.map(thread::JoinHandle::join) {
        Ok(Ok(granted)) => granted,
        Ok(Err(_)) => Err(Refusal::Priority(io::Error::other("the thread that asked has panicked"))),
        Err(error) => Err(Refusal::Priority(error)),
    };
    Limits {
        priority_limit: getrlimit(Resource::Rtprio).current,
        memory_limit: getrlimit(Resource::Memlock).current,
        priority,
        memory: lock_memory(),
    }
}

impl Limits {
    /// Whether both are granted.
    pub fn checks(&self) -> [Check; 2] {
        let limit = |limit: Option<u64>| limit.map_or_else(|| "no limit".to_owned(), |limit| limit.to_string());
        let priority = match &self.priority {
            Ok(()) => Check::ok("priority", format!("SCHED_FIFO {PRIORITY} is granted")),
            Err(refusal) => Check::wrong(
                "priority",
                format!("no SCHED_FIFO {PRIORITY} ({}); rtprio limit {}", cause(refusal), limit(self.priority_limit)),
            )
            .follows(
                "the loop competes with all other programs. The command is for this shell; permanently: write `rtprio 80` for this \
                 user into /etc/security/limits.d, or LimitRTPRIO=80 into the unit",
            )
            .fix(format!("sudo prlimit --pid $$ --rtprio={PRIORITY}")),
        };
        let bytes =
            |limit: Option<u64>| limit.map_or_else(|| "no limit".to_owned(), |limit| format!("{} KiB", limit / 1024));
        let memory = match &self.memory {
            Ok(()) => Check::ok("memory", "locked: no page faults in the loop"),
            Err(refusal) => Check::wrong(
                "memory",
                format!("no locked memory ({}); memlock limit {}", cause(refusal), bytes(self.memory_limit)),
            )
            .follows(
                "the loop may wait for a page. The command is for this shell; permanently: write `memlock unlimited` for this user \
                 into /etc/security/limits.d, or LimitMEMLOCK=infinity into the unit",
            )
            .fix("sudo prlimit --pid $$ --memlock=unlimited"),
        };
        [priority, memory]
    }
}

fn cause(refusal: &Refusal) -> &io::Error {
    match refusal {
        Refusal::Priority(error) | Refusal::Memory(error) => error,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_link::checkup::Verdict;

    #[test]
    fn no_real_time_priority_is_found_by_name_with_the_command_that_grants_it() {
        let refused = || io::Error::from_raw_os_error(1);
        let granted = Limits { priority_limit: Some(95), memory_limit: None, priority: Ok(()), memory: Ok(()) };
        assert!(granted.checks().iter().all(|check| check.verdict == Verdict::Ok));
        let limits = Limits {
            priority_limit: Some(0),
            memory_limit: Some(8 << 20),
            priority: Err(Refusal::Priority(refused())),
            memory: Err(Refusal::Memory(refused())),
        };
        let [priority, memory] = limits.checks();
        assert_eq!((priority.subject, priority.verdict), ("priority", Verdict::Wrong));
        assert_eq!(priority.fix.as_deref(), Some("sudo prlimit --pid $$ --rtprio=80"));
        assert!(priority.found.ends_with("; rtprio limit 0"), "{}", priority.found);
        assert_eq!(memory.fix.as_deref(), Some("sudo prlimit --pid $$ --memlock=unlimited"));
        assert!(memory.found.ends_with("; memlock limit 8192 KiB"), "{}", memory.found);
    }

    #[test]
    fn what_is_asked_for_is_told_with_its_limits() {
        // Whether it is granted is up to this computer; that the question is asked and answered is not.
        let limits = limits();
        let [priority, memory] = limits.checks();
        assert_eq!(priority.fix.is_none(), limits.priority.is_ok());
        assert_eq!(memory.fix.is_none(), limits.memory.is_ok());
    }
}
