//! What this computer is like, as far as it decides how a rig runs. What commands find out about it belongs here too.

use std::fs;
use std::path::Path;

/// Type of a CAN interface in `/sys/class/net/*/type`.
const CAN: &str = "280";
/// What is read of an interface.
const OF_INTERFACE: [&str; 6] =
    ["mtu", "operstate", "tx_queue_len", "statistics/rx_errors", "statistics/tx_errors", "statistics/tx_dropped"];

/// A text with one fact a line; of what cannot be read it says so.
pub(super) fn system(root: &Path) -> String {
    let read = |path: &str| {
        fs::read_to_string(root.join(path)).map_or_else(|_| "unknown".to_owned(), |text| text.trim().to_owned())
    };
    let mut text = String::new();
    for (what, path) in [
        ("kernel", "proc/sys/kernel/osrelease"),
        ("built", "proc/sys/kernel/version"),
        ("realtime", "sys/kernel/realtime"),
        ("clock source", "sys/devices/system/clocksource/clocksource0/current_clocksource"),
        ("governor", "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"),
        ("real-time share", "proc/sys/kernel/sched_rt_runtime_us"),
    ] {
        text += &format!("{what:16} {}\n", read(path));
    }
    text += &format!("{:16} {}\n", "processors", std::thread::available_parallelism().map_or(0, usize::from));
    let limits = read("proc/self/limits");
    for line in
        limits.lines().filter(|line| line.starts_with("Max realtime priority") || line.starts_with("Max locked memory"))
    {
        let words: Vec<&str> = line.split_whitespace().collect();
        text += &format!("{}\n", words.join(" "));
    }
    let mut interfaces: Vec<_> = fs::read_dir(root.join("sys/class/net"))
        .into_iter()
        .flatten()
        .flatten()
        .filter(|entry| fs::read_to_string(entry.path().join("type")).is_ok_and(|kind| kind.trim() == CAN))
        .collect();
    interfaces.sort_by_key(std::fs::DirEntry::file_name);
    for entry in interfaces {
        let facts = OF_INTERFACE.map(|fact| {
            let value = fs::read_to_string(entry.path().join(fact)).unwrap_or_else(|_| "unknown".to_owned());
            format!("{fact} {}", value.trim())
        });
        text += &format!("{:16} {}\n", entry.file_name().to_string_lossy(), facts.join(", "));
    }
    text
}
