//! All that is read of this computer, and how it is for a rig.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::time::Duration;

use super::Readiness;
use yieldwall_link::checkup::Check;

/// Clock sources that are read in some tens of ns and do not stop.
const GOOD_CLOCKS: [&str; 4] = ["tsc", "kvm-clock", "arch_sys_counter", "hyperv_clocksource_tsc_page"];
/// Longest text of the kernel that is shown.
const LONGEST: usize = 60;

/// Facts about a computer. `None` means that a value could not be read: it is unknown, and not fine.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ComputerFacts {
    /// Release of the kernel.
    pub release: Option<String>,
    /// Kernel and sleep.
    pub readiness: Readiness,
    /// Governors of the processors' frequency, and how many processors have each; empty if the kernel reports none.
    pub governors: BTreeMap<String, usize>,
    /// The processors that are kept free of other work, as the kernel lists them; empty for none.
    pub isolated: Option<String>,
    /// Number of processors.
    pub processors: usize,
    /// The clock source, and those that there are.
    pub clock: Option<(String, Vec<String>)>,
    /// Time in us of each second that real-time threads may have; -1 for all of it.
    pub realtime_runtime_us: Option<i64>,
    /// Whether this process may forbid sleep (`/dev/cpu_dma_latency` can be opened for writing).
    pub may_forbid_sleep: Option<bool>,
}

impl ComputerFacts {
    /// Reads `/sys`, `/proc` and `/dev` below `root`.
    pub fn read(root: &Path) -> Self {
        let text = |path: &str| {
            let text = fs::read_to_string(root.join(path)).ok()?;
            Some(text.trim().chars().filter(|one| !one.is_control()).take(LONGEST).collect::<String>())
        };
        let mut governors = BTreeMap::new();
        let mut processors = 0;
        for entry in fs::read_dir(root.join("sys/devices/system/cpu")).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let is_processor = name.strip_prefix("cpu").is_some_and(|number| number.parse::<u32>().is_ok());
            if !is_processor {
                continue;
            }
            processors += 1;
            if let Some(governor) = text(&format!("sys/devices/system/cpu/{name}/cpufreq/scaling_governor")) {
                *governors.entry(governor).or_insert(0) += 1;
            }
        }
        let clock = |name: &str| text(&format!("sys/devices/system/clocksource/clocksource0/{name}_clocksource"));
        let available = clock("available").unwrap_or_default();
        let sleep = root.join("dev/cpu_dma_latency");
        Self {
            release: text("proc/sys/kernel/osrelease"),
            readiness: Readiness::read(root, None),
            governors,
            isolated: text("sys/devices/system/cpu/isolated"),
            processors,
            clock: clock("current").map(|current| (current, available.split_whitespace().map(str::to_owned).collect())),
            realtime_runtime_us: text("proc/sys/kernel/sched_rt_runtime_us").and_then(|number| number.parse().ok()),
            // Opened and closed at once: what is forbidden is forbidden for as long as it is open.
            may_forbid_sleep: sleep.exists().then(|| fs::OpenOptions::new().write(true).open(&sleep).is_ok()),
        }
    }

    /// Checks the computer for a rig of this cycle.
    pub fn checks(&self, period: Duration) -> Vec<Check> {
        let release = self.release.as_deref().unwrap_or("of unknown release");
        let mut checks = self.readiness.checks(period, None);
        for kernel in checks.iter_mut().filter(|check| check.subject == "kernel") {
            kernel.found = format!("{release}, {}", kernel.found);
        }
        checks.extend([self.sleep(), self.governor(), self.isolation(), self.clock(), self.throttling()]);
        checks
    }

    fn sleep(&self) -> Check {
        let subject = "sleep";
        match self.may_forbid_sleep {
            None => Check::unknown(subject, "no /dev/cpu_dma_latency"),
            Some(true) => Check::ok(subject, "this process can disable slow idle states"),
            Some(false) => Check::ok(subject, "only root can disable idle states (/dev/cpu_dma_latency)"),
        }
    }

    fn governor(&self) -> Check {
        let subject = "governor";
        if self.governors.is_empty() {
            return Check::unknown(subject, "none reported: virtual machine or fixed frequency");
        }
        let each = self.governors.iter().map(|(name, count)| format!("{name} on {count}"));
        let found = format!("{} of {} processors", each.collect::<Vec<_>>().join(", "), self.processors);
        if self.governors.keys().all(|name| name == "performance") {
            return Check::ok(subject, found);
        }
        Check::warning(subject, found)
            .follows("the processor is slow when the loop wakes up")
            .fix("sudo cpupower frequency-set -g performance")
    }

    fn isolation(&self) -> Check {
        let subject = "isolation";
        match self.isolated.as_deref() {
            None => Check::unknown(subject, "the kernel does not report which processors are isolated"),
            Some("") if self.readiness.is_realtime_kernel == Some(true) && self.processors > 1 => {
                let last = self.processors - 1;
                Check::warning(subject, "no isolated processor")
                    .follows(format!(
                        "for tier A add isolcpus=managed_irq,domain,{last} nohz_full={last} rcu_nocbs={last} to the kernel's \
                         command line, update the boot loader, reboot, and start the rig with `taskset -c {last}`"
                    ))
                    .fix("sudoedit /etc/default/grub")
            }
            Some("") => Check::ok(subject, "no isolated processor; only useful with PREEMPT_RT"),
            Some(list) => Check::ok(
                subject,
                format!("processors {list}: start the rig with `taskset -c PROCESSOR` on one of them"),
            ),
        }
    }

    fn clock(&self) -> Check {
        let subject = "clock";
        let Some((current, available)) = &self.clock else {
            return Check::unknown(subject, "the kernel does not report its clock source");
        };
        if GOOD_CLOCKS.contains(&current.as_str()) {
            return Check::ok(subject, current);
        }
        let check = Check::warning(subject, format!("clock source {current}"));
        match available.iter().find(|name| GOOD_CLOCKS.contains(&name.as_str())) {
            Some(better) => check.follows("each reading takes 1 us or more").fix(format!(
                "echo {better} | sudo tee /sys/devices/system/clocksource/clocksource0/current_clocksource"
            )),
            None => check
                .follows(
                    "each reading takes 1 us or more, and the kernel trusts no better clock; the command shows why",
                )
                .fix("sudo dmesg | grep -i -E 'tsc|clocksource'"),
        }
    }

    fn throttling(&self) -> Check {
        let subject = "throttling";
        match self.realtime_runtime_us {
            None => Check::unknown(subject, "the kernel does not report how long real-time threads may run"),
            Some(..0) => Check::warning(subject, "no limit for real-time threads")
                .follows(
                    "a real-time thread in an endless loop blocks the computer; the control loop sleeps in each cycle and needs less",
                )
                .fix("sudo sysctl kernel.sched_rt_runtime_us=950000"),
            Some(0) => Check::wrong(subject, "real-time threads get no time")
                .fix("sudo sysctl kernel.sched_rt_runtime_us=950000"),
            Some(us) => Check::ok(subject, format!("real-time threads limited to {} ms per second", us / 1000)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_link::checkup::Verdict;

    fn good() -> ComputerFacts {
        ComputerFacts {
            release: Some("6.12.1-rt".to_owned()),
            readiness: Readiness {
                is_realtime_kernel: Some(true),
                deepest_idle: Some(("C1".to_owned(), Duration::from_micros(2))),
                ..Readiness::default()
            },
            governors: BTreeMap::from([("performance".to_owned(), 4)]),
            isolated: Some("3".to_owned()),
            processors: 4,
            clock: Some(("tsc".to_owned(), vec!["tsc".to_owned(), "hpet".to_owned()])),
            realtime_runtime_us: Some(950_000),
            may_forbid_sleep: Some(false),
        }
    }

    #[test]
    fn each_trouble_alone_is_found_by_name_with_its_command() {
        let ms = Duration::from_millis(1);
        assert!(good().checks(ms).iter().all(|check| check.verdict == Verdict::Ok), "{:#?}", good().checks(ms));
        let stock = Readiness { is_realtime_kernel: Some(false), ..good().readiness };
        let asleep =
            Readiness { deepest_idle: Some(("C6".to_owned(), Duration::from_micros(133))), ..good().readiness };
        let hpet = vec!["tsc".to_owned(), "hpet".to_owned()];
        for (facts, subject, fix) in [
            (ComputerFacts { readiness: stock, ..good() }, "kernel", None),
            (ComputerFacts { readiness: asleep, ..good() }, "idle", Some("sudo cpupower idle-set -D 100")),
            (
                ComputerFacts {
                    governors: BTreeMap::from([("performance".to_owned(), 3), ("powersave".to_owned(), 1)]),
                    ..good()
                },
                "governor",
                Some("sudo cpupower frequency-set -g performance"),
            ),
            (
                ComputerFacts { clock: Some(("hpet".to_owned(), hpet)), ..good() },
                "clock",
                Some("echo tsc | sudo tee /sys/devices/system/clocksource/clocksource0/current_clocksource"),
            ),
            (
                ComputerFacts { isolated: Some(String::new()), ..good() },
                "isolation",
                Some("sudoedit /etc/default/grub"),
            ),
            (
                ComputerFacts { realtime_runtime_us: Some(-1), ..good() },
                "throttling",
                Some("sudo sysctl kernel.sched_rt_runtime_us=950000"),
            ),
        ] {
            let bad: Vec<Check> = facts.checks(ms).into_iter().filter(|check| check.verdict != Verdict::Ok).collect();
            let named: Vec<_> = bad.iter().map(|check| (check.subject, check.fix.as_deref())).collect();
            assert_eq!(named, [(subject, fix)]);
        }
    }

    #[test]
    fn what_cannot_be_read_is_unknown_and_never_fine() {
        let nothing = ComputerFacts::read(Path::new("/no/such/folder"));
        assert_eq!(nothing, ComputerFacts::default());
        let checks = nothing.checks(Duration::from_millis(1));
        assert!(checks.iter().all(|check| check.verdict == Verdict::Unknown), "{checks:#?}");
    }

    #[test]
    fn a_tree_is_read() {
        let root = std::env::temp_dir().join(format!("yieldwall-facts-{}", std::process::id()));
        let file = |path: &str, text: &str| {
            let path = root.join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        };
        for (number, governor) in [(0, "powersave"), (1, "performance"), (10, "performance")] {
            file(&format!("sys/devices/system/cpu/cpu{number}/cpufreq/scaling_governor"), &format!("{governor}\n"));
        }
        file("sys/devices/system/cpu/cpufreq/boost", "1");
        file("sys/devices/system/cpu/isolated", "\n");
        file("sys/devices/system/clocksource/clocksource0/current_clocksource", "hpet\n");
        file("sys/devices/system/clocksource/clocksource0/available_clocksource", "tsc hpet acpi_pm \n");
        file("proc/sys/kernel/sched_rt_runtime_us", "-1\n");
        file("proc/sys/kernel/osrelease", "6.12.1\u{1b}[2J\n");
        let facts = ComputerFacts::read(&root);
        fs::remove_dir_all(&root).unwrap();
        assert_eq!(facts.governors, BTreeMap::from([("performance".to_owned(), 2), ("powersave".to_owned(), 1)]));
        assert_eq!((facts.processors, facts.isolated.as_deref(), facts.realtime_runtime_us), (3, Some(""), Some(-1)));
        let clocks = ["tsc", "hpet", "acpi_pm"].map(str::to_owned).to_vec();
        assert_eq!(facts.clock, Some(("hpet".to_owned(), clocks)));
        assert_eq!(facts.release.as_deref(), Some("6.12.1[2J"));
    }
}
