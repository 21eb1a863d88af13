//! Reasons why an Ethernet interface cannot be used, with the next step to try.

use std::io;

use rustix::io::Errno;

use crate::{Holder, Role};

/// Fault of an interface.
#[derive(Debug, thiserror::Error)]
pub enum EthernetError {
    /// The process may not open packet sockets.
    #[error(
        "`{interface}` cannot be opened: EtherCAT takes packet sockets, and this process lacks the privilege for them \
         (CAP_NET_RAW). Give it to the program: `sudo setcap cap_net_raw+ep {}`, or run it as root",
        .program
    )]
    NotPermitted {
        /// Name of the interface.
        interface: String,
        /// The path of this program, quoted for a shell.
        program: String,
    },
    /// The kernel has no packet sockets.
    #[error("this kernel has no packet sockets. Load them with `sudo modprobe af_packet`")]
    NoPackets,
    /// There is no such interface.
    #[error("there is no interface `{interface}`; {}. {}", found(.others), next(.interface))]
    Missing {
        /// Its name.
        interface: String,
        /// The Ethernet interfaces that are there.
        others: Vec<String>,
    },
    /// The interface is of another type.
    #[error("`{interface}` is {kind}, and EtherCAT runs on Ethernet; {}. {}", found(.others), next(.interface))]
    NotEthernet {
        /// Its name.
        interface: String,
        /// Type of the interface.
        kind: &'static str,
        /// The Ethernet interfaces that are there.
        others: Vec<String>,
    },
    /// The interface is down.
    #[error("`{interface}` is down. Take it up with `sudo ip link set {interface} up`")]
    Down {
        /// Its name.
        interface: String,
    },
    /// Another process of this computer does on the interface what only one may do.
    #[error(
        "{role} is on this wire; nothing was sent: on `{interface}` it is {}, or name another interface with --bus",
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

impl EthernetError {
    pub(super) fn missing(interface: &str, others: Vec<String>) -> Self {
        Self::Missing { interface: interface.to_owned(), others }
    }

    pub(super) fn not_ethernet(interface: &str, kind: u16, others: Vec<String>) -> Self {
        let kind = match kind {
            libc::ARPHRD_CAN => "a CAN interface",
            libc::ARPHRD_LOOPBACK => "the loopback interface",
            _ => "an interface of another kind",
        };
        Self::NotEthernet { interface: interface.to_owned(), kind, others }
    }

    /// Converts the error of a socket that could not be opened.
    pub(super) fn from_open(interface: &str, error: Errno) -> Self {
        match error {
            Errno::PERM | Errno::ACCESS => {
                let program = std::env::current_exe().map(|path| quoted(&path.to_string_lossy()));
                let program = program.unwrap_or_else(|_| "PROGRAM".to_owned());
                Self::NotPermitted { interface: interface.to_owned(), program }
            }
            Errno::AFNOSUPPORT => Self::NoPackets,
            error => Self::System { interface: interface.to_owned(), step: "open it", source: error.into() },
        }
    }
}

/// Returns a path as a shell takes it.
fn quoted(path: &str) -> String {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "/._-+@".contains(letter);
    if path.chars().all(is_plain) { path.to_owned() } else { format!("'{}'", path.replace('\'', r"'\''")) }
}

fn found(others: &[String]) -> String {
    match others {
        [] => "there is no Ethernet interface here".to_owned(),
        others => format!("Ethernet interfaces here: {}", others.join(", ")),
    }
}

/// Returns the advice that names or creates an interface.
fn next(interface: &str) -> String {
    let (end, peer) = match interface.strip_prefix("veth") {
        Some("0") => ("veth0", "veth1"),
        Some(_) => (interface, "veth0"),
        None => ("veth1", "veth0"),
    };
    format!(
        "Name one with --bus, or make a virtual pair of them: `sudo ip link add {end} type veth peer name {peer} && sudo ip \
         link set {end} up && sudo ip link set {peer} up`"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_name_the_next_thing_to_try() {
        let missing = |interface: &str, others: &[&str]| {
            EthernetError::missing(interface, others.iter().map(|&other| other.to_owned()).collect()).to_string()
        };
        assert_eq!(
            missing("veth1", &["eth0"]),
            "there is no interface `veth1`; Ethernet interfaces here: eth0. Name one with --bus, or make a virtual pair of \
             them: `sudo ip link add veth1 type veth peer name veth0 && sudo ip link set veth1 up && sudo ip link set veth0 up`"
        );
        assert!(missing("eth7", &[]).contains("there is no Ethernet interface here"));
        assert!(missing("veth0", &[]).contains("add veth0 type veth peer name veth1"));
        let other = EthernetError::not_ethernet("vcan0", 280, Vec::new()).to_string();
        assert!(other.starts_with("`vcan0` is a CAN interface, and EtherCAT runs on Ethernet"), "{other}");
        let down = EthernetError::Down { interface: "eth1".to_owned() }.to_string();
        assert_eq!(down, "`eth1` is down. Take it up with `sudo ip link set eth1 up`");
    }

    #[test]
    fn who_lacks_the_privilege_is_given_the_line_for_this_very_program() {
        let refused = EthernetError::from_open("veth1", Errno::PERM).to_string();
        let program = std::env::current_exe().unwrap();
        let line = format!("`sudo setcap cap_net_raw+ep {}`", quoted(&program.to_string_lossy()));
        assert!(refused.contains(&line), "{refused}");
        assert!(matches!(EthernetError::from_open("veth1", Errno::AFNOSUPPORT), EthernetError::NoPackets));
        assert_eq!(quoted("/opt/it's here/yieldwall"), r"'/opt/it'\''s here/yieldwall'");
    }

    #[test]
    fn a_segment_that_is_served_already_is_named() {
        let holder = Holder {
            pid: 42,
            user: Some("guest (1001)".to_owned()),
            command: Some("yieldwall sim rig.yaml --bus veth1".to_owned()),
        };
        let role = Role::Segment;
        let held = EthernetError::Held { interface: "veth1".to_owned(), role, holder: Some(holder) }.to_string();
        assert!(
            held.starts_with(
                "an EtherCAT segment is on this wire; nothing was sent: on `veth1` it is process 42 of the user guest (1001) (`"
            ) && held.contains("End it, as that user or as root, with `kill -INT 42`"),
            "{held}"
        );
    }
}
