//! Reasons why an interface cannot be used, with the next step to try.

use std::io;

use rustix::io::Errno;

use crate::checkup::Check;
use crate::hold::NotHeld;
use crate::{Holder, Role};

/// Fault of an interface.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The kernel knows nothing of CAN.
    #[error(
        "this kernel has no CAN sockets. Load them with `{LOAD}`; if there is no such module, run the command \
         as `hil-tests/vcan COMMAND`, which boots a kernel that has them"
    )]
    NoCan,
    /// The process may not open CAN sockets.
    #[error(
        "this process may not open CAN sockets. No privilege is needed for them, so something takes them away: look for \
         RestrictAddressFamilies of a systemd unit (add AF_CAN) or for a seccomp profile of the container"
    )]
    NotPermitted,
    /// There is no such interface.
    #[error("there is no interface `{interface}`{}. {}", found(.others), next(.interface, *.wanted))]
    Missing {
        /// Its name.
        interface: String,
        /// The CAN interfaces that are there.
        others: Vec<String>,
        /// Bit rate in bit/s that it should have.
        wanted: Option<u32>,
    },
    /// The interface is of another type.
    #[error(
        "`{interface}` is no CAN interface{}. {}",
        found(.others),
        if .others.is_empty() {
            "Plug an adapter in, and look for it with `dmesg | grep -i can`; for simulated devices make one: `sudo ip link add \
             vcan0 type vcan && sudo ip link set vcan0 up`"
        } else {
            "Name one of them with --bus"
        }
    )]
    NotCan {
        /// Its name.
        interface: String,
        /// The CAN interfaces that are there.
        others: Vec<String>,
    },
    /// The interface is down.
    #[error("`{interface}` is down. Take it up with `{}`", up(.interface, *.bit_rate))]
    Down {
        /// Its name.
        interface: String,
        /// Bit rate in bit/s that it should have, unless it is virtual.
        bit_rate: Option<u32>,
    },
    /// The controller has left the bus.
    #[error(
        "the controller of `{interface}` is bus-off: it saw too many errors. Check cable, termination and the bit rate of \
         every node, then `{}`",
        restart(.interface)
    )]
    BusOff {
        /// Name of the interface.
        interface: String,
    },
    /// The driver does not report when a frame has left.
    #[error(
        "the driver of `{interface}` ({}) does not report when a frame has left, so that a stuck frame looks like a sent one. No \
         option changes that: take an adapter whose `ip -details link show` has ECHO among \
         its flags; docs/adapters.md",
        .driver.as_deref().unwrap_or("of unknown name")
    )]
    NoEcho {
        /// Name of the interface.
        interface: String,
        /// Name of the driver, where it is known.
        driver: Option<String>,
    },
    /// The interface has another bit rate than the rig.
    #[error(
        "`{interface}` runs at {has} bit/s and the rig at {wanted} bit/s. Change the interface with \
         `{}`, or the key `bit_rate_bit_per_s` of the rig's bus",
        change(.interface, *.wanted)
    )]
    BitRate {
        /// Name of the interface.
        interface: String,
        /// Its bit rate in bit/s.
        has: u32,
        /// The wanted one in bit/s.
        wanted: u32,
    },
    /// Another process of this computer does on the interface what only one may do.
    #[error(
        "{role} is on this bus; nothing was sent: on `{interface}` it is {}, or name another interface with --bus",
        Holder::told(.holder.as_ref(), .interface)
    )]
    Held {
        /// Name of the interface.
        interface: String,
        /// Role of this process.
        role: Role,
        /// The process that holds the role, if the kernel shows it.
        holder: Option<Holder>,
    },
    /// Anything else that the system refuses.
    #[error("`{interface}`: the system refuses to {step}: {source}")]
    System {
        /// Name of the interface.
        interface: String,
        /// Operation that failed.
        step: &'static str,
        /// Error of the system.
        source: io::Error,
    },
}

impl LinkError {
    /// Converts the error of a role on an interface that this process could not get.
    pub(super) fn not_held(interface: &str, role: Role, error: NotHeld) -> Self {
        let interface = interface.to_owned();
        match error {
            NotHeld::Taken(holder) => Self::Held { interface, role, holder },
            NotHeld::System(source) => Self::System { interface, step: "keep it for one process", source },
        }
    }

    /// Returns the fault as a check, without the command that fixes it.
    pub fn check(&self) -> Check {
        match self {
            Self::NoCan => Check::wrong("CAN sockets", "this kernel has none")
                .follows("where it has no such module either, `hil-tests/vcan COMMAND` boots a kernel that has them")
                .fix(LOAD),
            Self::NotPermitted => Check::wrong("permission", "this process may not open CAN sockets")
                .follows(
                    "CAN sockets need no privilege, so something takes them away: RestrictAddressFamilies of a systemd unit, \
                     which has to name AF_CAN, or a seccomp profile of the container",
                )
                .fix("sudo systemctl edit $(ps -o unit= -p $$)"),
            Self::Missing { interface, others, .. } => {
                let check = Check::wrong("interface", format!("there is no `{interface}`{}", found(others)));
                match is_virtual(interface) {
                    true => check.fix(make(interface)),
                    false => check
                        .follows("the kernel has found no adapter of that name: this command shows what it has found")
                        .fix("sudo dmesg | grep -i can"),
                }
            }
            Self::NotCan { interface, others } => {
                Check::wrong("interface", format!("`{interface}` is no CAN interface{}", found(others)))
                    .follows("this command lists those that there are")
                    .fix("ip -brief link show type can")
            }
            Self::Down { interface, bit_rate } => Check::wrong("interface", format!("`{interface}` is down"))
                .follows("nothing comes and nothing goes")
                .fix(up(interface, *bit_rate)),
            Self::BusOff { interface } => {
                Check::wrong("controller", format!("the controller of `{interface}` is bus-off: it saw too many errors"))
                    .follows("look at the cable, at its terminators and at the bit rate of every node first")
                    .fix(restart(interface))
            }
            Self::NoEcho { interface, driver } => {
                let driver = driver.as_deref().unwrap_or("of unknown name");
                Check::wrong("echo", format!("the driver of `{interface}` ({driver}) does not report when a frame has left"))
                    .follows("no option changes that: take another adapter; docs/adapters.md")
            }
            Self::BitRate { interface, has, wanted } => {
                Check::wrong("bit rate", format!("`{interface}` runs at {has} bit/s and the rig at {wanted} bit/s"))
                    .follows("nobody understands anybody: change this, or the key `bit_rate_bit_per_s` of the rig's bus")
                    .fix(change(interface, *wanted))
            }
            Self::Held { holder, .. } => {
                let check = Check::wrong("master", self.to_string());
                match holder {
                    Some(holder) => check.fix(format!("kill -INT {}", holder.pid)),
                    None => check,
                }
            }
            Self::System { .. } => Check::wrong("interface", self.to_string()),
        }
    }

    /// Converts the error of a socket that could not be opened or bound; `others` returns the CAN interfaces of this computer.
    pub(super) fn from_open(interface: &str, source: io::Error, others: impl FnOnce() -> Vec<String>) -> Self {
        match Errno::from_io_error(&source) {
            Some(Errno::AFNOSUPPORT | Errno::PROTONOSUPPORT) => Self::NoCan,
            Some(Errno::PERM | Errno::ACCESS) => Self::NotPermitted,
            // The interface has an index, and yet is none that can be bound to.
            Some(Errno::NODEV) => Self::NotCan { interface: interface.to_owned(), others: others() },
            _ => Self::System { interface: interface.to_owned(), step: "open it", source },
        }
    }
}

/// The command that loads CAN sockets.
const LOAD: &str = "sudo modprobe can-raw";

/// Returns the command that takes an interface up.
fn up(interface: &str, bit_rate: Option<u32>) -> String {
    let bit_rate = bit_rate.map_or_else(String::new, |bit_rate| format!(" type can bitrate {bit_rate}"));
    format!("sudo ip link set {interface} up{bit_rate}")
}

/// Returns the command that starts a controller after bus-off.
fn restart(interface: &str) -> String {
    format!("sudo ip link set {interface} type can restart")
}

/// Returns the command that gives an interface another bit rate.
fn change(interface: &str, bit_rate: u32) -> String {
    format!("sudo ip link set {interface} down && sudo ip link set {interface} up type can bitrate {bit_rate}")
}

fn found(others: &[String]) -> String {
    match others {
        [] => ", and no other CAN interface".to_owned(),
        others => format!("; CAN interfaces here: {}", others.join(", ")),
    }
}

/// Whether an interface is a virtual one, by its name.
fn is_virtual(interface: &str) -> bool {
    ["vcan", "vxcan"].iter().any(|kind| interface.starts_with(kind))
}

/// Returns the command that makes a virtual interface.
fn make(interface: &str) -> String {
    format!("sudo ip link add {interface} type vcan && sudo ip link set {interface} up")
}

/// Returns the command that may create an interface.
fn next(interface: &str, bit_rate: Option<u32>) -> String {
    if is_virtual(interface) {
        return format!("Make it: `{}`", make(interface));
    }
    let bit_rate = bit_rate.unwrap_or(1_000_000);
    format!(
        "Check the adapter with `dmesg | grep -i can`; one on a serial line is made by `sudo slcand`. Then: `sudo ip link set \
         {interface} up type can bitrate {bit_rate}`"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checkup::Verdict;

    fn opened(errno: Errno) -> LinkError {
        LinkError::from_open("can0", io::Error::from_raw_os_error(errno.raw_os_error()), Vec::new)
    }

    #[test]
    fn what_the_system_says_has_a_meaning() {
        assert!(matches!(opened(Errno::AFNOSUPPORT), LinkError::NoCan));
        assert!(matches!(opened(Errno::PROTONOSUPPORT), LinkError::NoCan));
        assert!(matches!(opened(Errno::PERM), LinkError::NotPermitted));
        assert!(matches!(opened(Errno::NODEV), LinkError::NotCan { .. }));
        assert!(matches!(opened(Errno::NOMEM), LinkError::System { .. }));
    }

    #[test]
    fn what_is_wrong_is_told_apart_from_the_command_that_mends_it() {
        let name = || "can0".to_owned();
        for (error, subject, fix) in [
            (LinkError::NoCan, "CAN sockets", Some("sudo modprobe can-raw")),
            (LinkError::NotPermitted, "permission", Some("sudo systemctl edit $(ps -o unit= -p $$)")),
            (
                LinkError::Missing { interface: name(), others: Vec::new(), wanted: None },
                "interface",
                Some("sudo dmesg | grep -i can"),
            ),
            (
                LinkError::Missing { interface: "vcan0".to_owned(), others: Vec::new(), wanted: None },
                "interface",
                Some("sudo ip link add vcan0 type vcan && sudo ip link set vcan0 up"),
            ),
            (
                LinkError::NotCan { interface: name(), others: Vec::new() },
                "interface",
                Some("ip -brief link show type can"),
            ),
            (LinkError::BusOff { interface: name() }, "controller", Some("sudo ip link set can0 type can restart")),
            (LinkError::NoEcho { interface: name(), driver: None }, "echo", None),
            (LinkError::Held { interface: name(), role: Role::Master, holder: None }, "master", None),
        ] {
            let check = error.check();
            assert_eq!((check.subject, check.verdict, check.fix.as_deref()), (subject, Verdict::Wrong, fix));
        }
    }

    #[test]
    fn who_is_there_already_is_named() {
        let held = |role, holder| LinkError::Held { interface: "can0".to_owned(), role, holder }.to_string();
        let holder = Holder { pid: 42, user: None, command: Some("yieldwall run rig.yaml --bus can0".to_owned()) };
        assert_eq!(
            held(Role::Master, Some(holder)),
            "a master is on this bus; nothing was sent: on `can0` it is process 42 (`yieldwall run rig.yaml --bus can0`) of \
             this computer. End it with `kill -INT 42`, or with `kill -KILL 42` if it hangs, or name another interface with \
             --bus"
        );
        assert_eq!(
            held(Role::Node(1), None),
            "node 1 is on this bus; nothing was sent: on `can0` it is another process of this computer, which \
             `sudo ss -xap | grep yieldwall/can0/` names. End it, or name another interface with --bus"
        );
    }

    #[test]
    fn messages_name_the_next_thing_to_try() {
        let missing = |interface: &str, others: &[&str]| {
            let others = others.iter().map(|&other| other.to_owned()).collect();
            LinkError::Missing { interface: interface.to_owned(), others, wanted: Some(500_000) }.to_string()
        };
        assert_eq!(
            missing("vcan0", &[]),
            "there is no interface `vcan0`, and no other CAN interface. Make it: `sudo ip link add vcan0 type vcan && sudo \
             ip link set vcan0 up`"
        );
        assert_eq!(
            missing("can1", &["can0", "vcan0"]),
            "there is no interface `can1`; CAN interfaces here: can0, vcan0. Check the adapter with `dmesg | grep -i can`; \
             one on a serial line is made by `sudo slcand`. Then: `sudo ip link set can1 up type can bitrate 500000`"
        );
        let down = |bit_rate| LinkError::Down { interface: "can0".to_owned(), bit_rate }.to_string();
        assert_eq!(down(None), "`can0` is down. Take it up with `sudo ip link set can0 up`");
        assert!(down(Some(250_000)).ends_with("`sudo ip link set can0 up type can bitrate 250000`"));
        let rates = LinkError::BitRate { interface: "can0".to_owned(), has: 125_000, wanted: 1_000_000 }.to_string();
        assert!(rates.starts_with("`can0` runs at 125000 bit/s and the rig at 1000000 bit/s."));
        assert!(rates.ends_with("or the key `bit_rate_bit_per_s` of the rig's bus"), "{rates}");
        let no_can = |others: &[&str]| {
            let others = others.iter().map(|&other| other.to_owned()).collect();
            LinkError::NotCan { interface: "lo".to_owned(), others }.to_string()
        };
        assert!(no_can(&[]).starts_with("`lo` is no CAN interface, and no other CAN interface. Plug an adapter in"));
        assert_eq!(
            no_can(&["can0"]),
            "`lo` is no CAN interface; CAN interfaces here: can0. Name one of them with --bus"
        );
    }
}
