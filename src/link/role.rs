//! Roles that only one process has on an interface.

use std::fmt;

/// Role that only one process of a computer has on an interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// To be the master.
    Master,
    /// To be the CANopen device with this node id.
    Node(u8),
    /// To be the device on plain CAN that sends this identifier.
    PlainCan(u16),
    /// To be the devices of an EtherCAT segment.
    Segment,
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Role::Master => write!(f, "a master"),
            Role::Node(node_id) => write!(f, "node {node_id}"),
            Role::PlainCan(id) => write!(f, "the device that sends {id:03X}h"),
            Role::Segment => write!(f, "an EtherCAT segment"),
        }
    }
}

/// A process of this computer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    /// Its number.
    pub pid: i32,
    /// The user that it runs as, if that is another one than the caller.
    pub user: Option<String>,
    /// Command line of the process, if the system shows it.
    pub command: Option<String>,
}

impl Holder {
    /// Describes the process that has a role on an interface, and how a person ends it; the kernel may not show which process it is.
    #[cfg(all(feature = "ethernet", target_os = "linux"))]
    pub(super) fn told(holder: Option<&Self>, interface: &str) -> String {
        let Some(Self { pid, user, .. }) = holder else {
            return format!(
                "another process of this computer, which `sudo ss -xap | grep yieldwall/{interface}/` names. End it"
            );
        };
        let by = user.as_ref().map_or("", |_| ", as that user or as root,");
        let holder = holder.map_or_else(String::new, ToString::to_string);
        format!("{holder} of this computer. End it{by} with `kill -INT {pid}`, or with `kill -KILL {pid}` if it hangs")
    }
}

impl fmt::Display for Holder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "process {}", self.pid)?;
        if let Some(user) = &self.user {
            write!(f, " of the user {user}")?;
        }
        self.command.as_ref().map_or(Ok(()), |command| write!(f, " (`{command}`)"))
    }
}
