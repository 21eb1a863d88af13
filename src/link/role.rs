//! Who does on an interface what only one process does.

use std::fmt;

/// What only one process of a computer does on an interface.
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
    /// Its command line, if the system tells.
    pub command: Option<String>,
}

impl fmt::Display for Holder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "process {}", self.pid)?;
        self.command.as_ref().map_or(Ok(()), |command| write!(f, " (`{command}`)"))
    }
}
