//! Facts about this computer that decide how soon it reacts: its kernel, its sleep states, and the handlers of interrupts.

use std::fs::{self, File};
use std::io::Read;
use std::path::Path;
use std::time::Duration;

use super::PRIORITY;
use yieldwall_link::checkup::Check;

/// Share of the cycle that waking up from an idle state may take: the bound of tier A for a late wake-up.
const WAKING_SHARE: u32 = 10;

/// Facts that were read. `None` means that a value could not be read: it is unknown, and not fine.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Readiness {
    /// Whether the kernel is PREEMPT_RT.
    pub is_realtime_kernel: Option<bool>,
    /// The idle state that a processor may enter and from which it wakes up slowest: its name, and the time that takes.
    pub deepest_idle: Option<(String, Duration)>,
    /// Threads that handle the interrupts of an interface: name and real-time priority, 0 for none.
    pub interrupt_threads: Vec<(String, u32)>,
    /// Threads to which the kernel hands on what it received, where that is much (`ksoftirqd/0`, ...), likewise.
    pub softirq_threads: Vec<(String, u32)>,
    /// Whether an interrupt has the name of the interface. One of USB has not: it is that of the USB controller.
    pub has_interrupt: bool,
}

impl Readiness {
    /// Reads `/sys`, `/proc` and `/dev` below `root`, and what there is of `interface`.
    pub fn read(root: &Path, interface: Option<&str>) -> Self {
        let text = |path: &str| fs::read_to_string(root.join(path)).ok();
        let version = text("proc/sys/kernel/version");
        let is_realtime_kernel = match text("sys/kernel/realtime") {
            Some(flag) => Some(flag.trim() == "1"),
            None => version.map(|version| version.contains("PREEMPT_RT")),
        };
        let folders = |path: &str| {
            let entries = fs::read_dir(root.join(path)).into_iter().flatten().flatten();
            entries.map(|entry| entry.path()).collect::<Vec<_>>()
        };
        let states = folders("sys/devices/system/cpu").into_iter().flat_map(|cpu| {
            let entries = fs::read_dir(cpu.join("cpuidle")).into_iter().flatten().flatten();
            entries.map(|entry| entry.path()).collect::<Vec<_>>()
        });
        // Somebody may have asked for a latency for as long as the file is open; without the right to read it that is unknown.
        let asked_for = asked_latency(&root.join("dev/cpu_dma_latency"));
        let is_entered = |(_, latency): &(String, Duration)| asked_for.is_none_or(|most| *latency <= most);
        let deepest_idle =
            states.filter_map(|state| idle_state(&state)).filter(is_entered).max_by_key(|(_, latency)| *latency);
        let mut readiness = Self { is_realtime_kernel, deepest_idle, ..Self::default() };
        if let Some(interface) = interface {
            readiness.has_interrupt = folders("proc/irq").iter().any(|irq| irq.join(interface).is_dir());
            for process in folders("proc") {
                let Some(name) = name_of(&process) else { continue };
                let threads = if is_interrupt_thread(&name, interface) {
                    &mut readiness.interrupt_threads
                } else if name.starts_with("ksoftirqd/") {
                    &mut readiness.softirq_threads
                } else {
                    continue;
                };
                threads.extend(priority_of(&process).map(|priority| (name, priority)));
            }
            readiness.interrupt_threads.sort();
            readiness.softirq_threads.sort();
        }
        readiness
    }

    /// Returns one line for each fact: its state or that it is unknown, and the remedy if it should differ.
    pub fn told(&self, period: Duration, interface: Option<&str>) -> Vec<String> {
        let each = self.checks(period, interface);
        each.iter().map(|check| format!("{:9} {check}", check.subject)).collect()
    }

    /// Checks the computer for a rig of this cycle, and the threads that handle the frames of an interface.
    pub fn checks(&self, period: Duration, interface: Option<&str>) -> Vec<Check> {
        let of_interface = interface.map(|interface| [self.interrupts(interface), self.softirqs()]);
        [self.kernel(), self.idle(period)].into_iter().chain(of_interface.into_iter().flatten()).collect()
    }

    fn kernel(&self) -> Check {
        match self.is_realtime_kernel {
            Some(true) => Check::ok("kernel", "PREEMPT_RT"),
            Some(false) => {
                Check::warning("kernel", "not PREEMPT_RT").follows("under load, nothing bounds the lateness of a cycle")
            }
            None => Check::unknown("kernel", "PREEMPT_RT unknown"),
        }
    }

    fn idle(&self, period: Duration) -> Check {
        match &self.deepest_idle {
            None => Check::unknown("idle", "idle states are unknown"),
            Some((name, latency)) if *latency * WAKING_SHARE > period => {
                let most_us = period.as_micros() / u128::from(WAKING_SHARE);
                Check::warning("idle", wakes_up(name, *latency))
                    .follows(
                        "this is more than 10 % of the cycle; the command disables such states until the next start",
                    )
                    .fix(format!("sudo cpupower idle-set -D {most_us}"))
            }
            Some((name, latency)) => Check::ok("idle", wakes_up(name, *latency)),
        }
    }

    fn interrupts(&self, interface: &str) -> Check {
        let subject = "interrupt";
        if self.interrupt_threads.is_empty() {
            let has_name = format!("the interrupt of {interface} has no thread");
            let has_none = format!("unknown: no interrupt has the name {interface}");
            return match self.has_interrupt {
                true => Check::ok(subject, has_name),
                false => Check::unknown(subject, has_none),
            };
        }
        let each = self.interrupt_threads.iter().map(|(name, priority)| format!("{name} at priority {priority}"));
        let found = each.collect::<Vec<_>>().join("; ");
        let is_above = |(_, priority): &&(String, u32)| u32::try_from(PRIORITY).is_ok_and(|own| *priority >= own);
        let above = self.interrupt_threads.iter().filter(is_above);
        let commands = above.map(|(name, _)| format!("sudo chrt -f -p 50 $(pgrep -x {name})"));
        match commands.collect::<Vec<_>>().join(" && ") {
            commands if commands.is_empty() => Check::ok(subject, found),
            commands => {
                Check::warning(subject, found).follows(format!("not below the loop at {PRIORITY}")).fix(commands)
            }
        }
    }

    fn softirqs(&self) -> Check {
        let subject = "softirq";
        match self.softirq_threads.iter().min_by_key(|(_, priority)| *priority) {
            None => Check::unknown(subject, "unknown: no ksoftirqd thread"),
            Some((name, 0)) => Check::warning(subject, format!("{name} has ordinary priority"))
                .follows("under many frames, frames wait for this thread")
                .fix("for pid in $(pgrep ksoftirqd); do sudo chrt -f -p 49 $pid; done"),
            Some((name, priority)) => Check::ok(subject, format!("{name} at priority {priority}")),
        }
    }
}

/// Describes an idle state.
fn wakes_up(name: &str, latency: Duration) -> String {
    format!("{name}: {} us to wake up", latency.as_micros())
}

/// Returns name and wake-up time of an idle state that is not switched off.
fn idle_state(state: &Path) -> Option<(String, Duration)> {
    let text = |name: &str| fs::read_to_string(state.join(name)).ok().map(|text| text.trim().to_owned());
    let is_off = text("disable").is_some_and(|flag| flag != "0");
    let latency = Duration::from_micros(text("latency")?.parse().ok()?);
    (!is_off).then_some((text("name")?, latency))
}

/// Returns the longest wake-up time that any program asks for: a number of 32 bits in us. The processor does not enter idle states
/// that take longer.
fn asked_latency(file: &Path) -> Option<Duration> {
    let mut number = [0; 4];
    File::open(file).and_then(|mut file| file.read_exact(&mut number)).ok()?;
    u64::try_from(i32::from_ne_bytes(number)).ok().map(Duration::from_micros)
}

fn name_of(process: &Path) -> Option<String> {
    Some(fs::read_to_string(process.join("comm")).ok()?.trim().to_owned())
}

/// Whether it is a thread of the kernel such as `irq/42-can0`.
fn is_interrupt_thread(name: &str, interface: &str) -> bool {
    let Some((_, of)) = name.strip_prefix("irq/").and_then(|rest| rest.split_once('-')) else { return false };
    // A second thread of the same interrupt has `s-` before its name, and names are cut off after 15 bytes.
    let of = of.strip_prefix("s-").unwrap_or(of);
    let is_cut = name.len() >= 15 && !of.is_empty();
    of == interface || (is_cut && interface.starts_with(of))
}

/// Returns the real-time priority of a thread; 0 for none.
fn priority_of(process: &Path) -> Option<u32> {
    let stat = fs::read_to_string(process.join("stat")).ok()?;
    // After the name in brackets; the priority is the 40th field of all.
    stat.rsplit_once(") ")?.1.split(' ').nth(37)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Tree(std::path::PathBuf);

    impl Tree {
        fn new(name: &str) -> Self {
            let root = std::env::temp_dir().join(format!("yieldwall-computer-{name}-{}", std::process::id()));
            let _ = fs::remove_dir_all(&root);
            fs::create_dir_all(&root).unwrap();
            Self(root)
        }

        fn file(&self, path: &str, text: &str) -> &Self {
            let path = self.0.join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
            self
        }

        fn state(&self, place: &str, name: &str, latency_us: u32, disable: u32) -> &Self {
            let folder = format!("sys/devices/system/cpu/{place}");
            self.file(&format!("{folder}/name"), name)
                .file(&format!("{folder}/latency"), &latency_us.to_string())
                .file(&format!("{folder}/disable"), &disable.to_string())
        }
    }

    impl Drop for Tree {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn what_cannot_be_read_is_unknown() {
        let tree = Tree::new("empty");
        let found = Readiness::read(&tree.0, Some("can0"));
        assert_eq!(found, Readiness::default());
        let told = found.told(MS, Some("can0")).join("\n");
        assert_eq!(told.matches("unknown").count(), 4, "{told}");
    }

    #[test]
    fn the_slowest_idle_state_that_may_be_entered_counts() {
        let tree = Tree::new("idle");
        tree.state("cpu0/cpuidle/state0", "POLL", 0, 0).state("cpu0/cpuidle/state1", "C1\n", 2, 0);
        tree.state("cpu1/cpuidle/state2", "C6", 133, 0).state("cpu1/cpuidle/state3", "C8", 900, 1);
        let found = Readiness::read(&tree.0, None);
        assert_eq!(found.deepest_idle, Some(("C6".to_owned(), Duration::from_micros(133))));
        let told = found.told(MS, None);
        assert!(
            told[1].contains("C6: 133 us to wake up") && told[1].ends_with("`sudo cpupower idle-set -D 100`"),
            "{told:?}"
        );
        assert!(!found.told(2 * MS, None)[1].contains("cpupower"));
        assert_eq!(told.len(), 2);
        // Somebody asks for 100 us: the kernel enters nothing slower.
        fs::create_dir_all(tree.0.join("dev")).unwrap();
        fs::write(tree.0.join("dev/cpu_dma_latency"), 100_i32.to_ne_bytes()).unwrap();
        assert_eq!(Readiness::read(&tree.0, None).deepest_idle, Some(("C1".to_owned(), Duration::from_micros(2))));
    }

    #[test]
    fn the_kernel_tells_what_it_is() {
        let kernel = |name, path, text| Readiness::read(&Tree::new(name).file(path, text).0, None).is_realtime_kernel;
        assert_eq!(kernel("flag", "sys/kernel/realtime", "1\n"), Some(true));
        assert_eq!(kernel("rt", "proc/sys/kernel/version", "#1 SMP PREEMPT_RT Debian"), Some(true));
        assert_eq!(kernel("stock", "proc/sys/kernel/version", "#1 SMP PREEMPT_DYNAMIC"), Some(false));
    }

    #[test]
    fn the_thread_of_an_interrupt_is_found_by_name_and_its_priority_read() {
        let tree = Tree::new("irq");
        let fields = |priority: u32| {
            let zeros = vec!["0"; 37].join(" ");
            format!("7 (irq/16-can0) {zeros} {priority} 1 0")
        };
        fs::create_dir_all(tree.0.join("proc/irq/16/can0")).unwrap();
        tree.file("proc/7/comm", "irq/16-can0\n").file("proc/7/stat", &fields(50));
        tree.file("proc/8/comm", "irq/17-can01\n").file("proc/8/stat", &fields(50));
        tree.file("proc/9/comm", "bash\n").file("proc/9/stat", &fields(0));
        let found = Readiness::read(&tree.0, Some("can0"));
        assert_eq!(found.interrupt_threads, [("irq/16-can0".to_owned(), 50)]);
        assert!(found.has_interrupt);
        assert_eq!(found.told(MS, Some("can0"))[2], "interrupt irq/16-can0 at priority 50");
        assert!(found.told(MS, Some("can0"))[3].contains("unknown"));
        tree.file("proc/14/comm", "ksoftirqd/0\n").file("proc/14/stat", &fields(49));
        tree.file("proc/22/comm", "ksoftirqd/1\n").file("proc/22/stat", &fields(0));
        let soft = Readiness::read(&tree.0, Some("can0"));
        assert_eq!(soft.softirq_threads, [("ksoftirqd/0".to_owned(), 49), ("ksoftirqd/1".to_owned(), 0)]);
        assert!(soft.told(MS, Some("can0"))[3].contains("ksoftirqd/1 has ordinary priority"));
        tree.file("proc/22/stat", &fields(49));
        assert_eq!(
            Readiness::read(&tree.0, Some("can0")).told(MS, Some("can0"))[3],
            "softirq   ksoftirqd/0 at priority 49"
        );
        let loud = Readiness { interrupt_threads: vec![("irq/16-can0".to_owned(), 90)], ..found.clone() };
        assert!(loud.told(MS, Some("can0"))[2].contains("sudo chrt -f -p 50 $(pgrep -x irq/16-can0)"));
        let bare = Readiness { interrupt_threads: Vec::new(), ..found };
        assert!(bare.told(MS, Some("can0"))[2].contains("has no thread"));
    }
}
