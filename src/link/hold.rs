//! Roles that only one process of a computer may have on an interface.
//!
//! The process with the role holds an abstract Unix socket. The network namespace scopes the socket's name, as it does for interfaces. The
//! socket is in no file system, and it disappears with the process, however that ends. A process that is refused asks the kernel which
//! process listens there.
#![allow(unsafe_code)]

use std::fs;
use std::io;
use std::mem::size_of;
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::fs::MetadataExt;

use rustix::io::Errno;
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, bind, connect, listen, socket_with};
use rustix::process::geteuid;

use super::role::{Holder, Role};

/// Reason why this process does not have a role.
#[derive(Debug)]
pub(super) enum NotHeld {
    /// Another process has the role. The value is that process, if the kernel shows it.
    Taken(Option<Holder>),
    /// The system refuses.
    System(io::Error),
}

impl From<Errno> for NotHeld {
    fn from(error: Errno) -> Self {
        Self::System(error.into())
    }
}

/// Attempts to hold a role that another process releases at the same moment.
const ATTEMPTS: u32 = 4;
/// Characters of a command line that are shown.
const LONGEST_COMMAND: usize = 200;

/// A role that this process holds, for as long as this lives.
#[derive(Debug)]
pub(super) struct Hold {
    _socket: OwnedFd,
}

impl Hold {
    /// Takes a role on an interface.
    pub(super) fn take(interface: &str, role: Role) -> Result<Self, NotHeld> {
        let name = match role {
            Role::Master => format!("yieldwall/{interface}/master"),
            Role::Node(node_id) => format!("yieldwall/{interface}/node/{node_id}"),
            Role::PlainCan(id) => format!("yieldwall/{interface}/id/{id:03X}"),
            Role::Segment => format!("yieldwall/{interface}/segment"),
        };
        let address = SocketAddrUnix::new_abstract_name(name.as_bytes())?;
        let mut holder = None;
        for _ in 0..ATTEMPTS {
            let socket = stream()?;
            match bind(&socket, &address) {
                Ok(()) => {
                    listen(&socket, i32::MAX)?;
                    return Ok(Self { _socket: socket });
                }
                Err(Errno::ADDRINUSE) => {}
                Err(error) => return Err(error.into()),
            }
            holder = who_listens(&address)?.or_else(|| who_bound(&name));
            if holder.is_some() {
                break;
            }
        }
        Err(NotHeld::Taken(holder))
    }
}

fn stream() -> Result<OwnedFd, Errno> {
    socket_with(AddressFamily::UNIX, SocketType::STREAM, SocketFlags::CLOEXEC | SocketFlags::NONBLOCK, None)
}

/// Returns the process that listens at an address; `None` if nobody does, if too many have asked it before, or if it is none of this
/// process namespace.
fn who_listens(address: &SocketAddrUnix) -> Result<Option<Holder>, Errno> {
    let socket = stream()?;
    match connect(&socket, address) {
        Ok(()) => {}
        Err(Errno::CONNREFUSED | Errno::AGAIN) => return Ok(None),
        Err(error) => return Err(error),
    }
    let mut peer = libc::ucred { pid: 0, uid: 0, gid: 0 };
    let mut length = size_of::<libc::ucred>() as libc::socklen_t;
    // SAFETY: `peer` and `length` are alive and the length is that of `peer`. rustix has no wrapper that may be told pid 0, which
    // a process of another namespace has.
    let result = unsafe {
        libc::getsockopt(
            socket.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_PEERCRED,
            (&raw mut peer).cast(),
            &raw mut length,
        )
    };
    if result != 0 {
        return Err(Errno::from_io_error(&io::Error::last_os_error()).unwrap_or(Errno::INVAL));
    }
    Ok((peer.pid > 0).then(|| holder(peer.pid, peer.uid)))
}

/// Returns the process that has bound an address and does not listen there, from the open files that the kernel shows. Returns `None` if
/// the kernel shows none: a caller that is not root cannot see processes of other users.
fn who_bound(name: &str) -> Option<Holder> {
    let table = fs::read_to_string("/proc/net/unix").ok()?;
    let wanted = format!("@{name}");
    let mut rows = table.lines().map(|line| line.split_whitespace().collect::<Vec<_>>());
    // Of those who wait at the address each has a row too, in another state.
    let row = rows.find(|row| row.get(5) == Some(&"01") && row.get(7) == Some(&wanted.as_str()))?;
    let socket = format!("socket:[{}]", row.get(6)?);
    let processes = fs::read_dir("/proc").ok()?.flatten();
    let mut pids = processes.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    let pid = pids.find(|pid: &i32| {
        let files = fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
        files.filter_map(|file| fs::read_link(file.path()).ok()).any(|file| file.as_os_str() == socket.as_str())
    })?;
    let uid = fs::metadata(format!("/proc/{pid}")).ok()?.uid();
    Some(holder(pid, uid))
}

fn holder(pid: i32, uid: u32) -> Holder {
    let user = (uid != geteuid().as_raw()).then(|| match name_of(uid) {
        Some(name) => format!("{name} ({uid})"),
        None => uid.to_string(),
    });
    Holder { pid, user, command: command_of(pid) }
}

/// Returns the name of a user, without what a terminal would act on.
fn name_of(uid: u32) -> Option<String> {
    let users = fs::read_to_string("/etc/passwd").ok()?;
    let mut users = users.lines().map(|line| line.split(':').collect::<Vec<_>>());
    let user = users.find(|user| user.get(2).is_some_and(|id| id.parse() == Ok(uid)))?;
    user.first().map(|name| name.chars().filter(|letter| !letter.is_control()).collect())
}

/// Returns the command line of a process, its words with spaces in between and nothing in it that a terminal would act on.
fn command_of(pid: i32) -> Option<String> {
    let bytes = fs::read(format!("/proc/{pid}/cmdline")).ok()?;
    let words = String::from_utf8_lossy(&bytes).replace('\0', " ");
    let shown: String = words.trim_end().chars().filter(|letter| !letter.is_control()).take(LONGEST_COMMAND).collect();
    (!shown.is_empty()).then_some(shown)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns an interface that no other test names; none has to be there.
    fn interface(name: &str) -> String {
        format!("{name}{}", std::process::id())
    }

    fn refused(interface: &str, role: Role) -> Option<Holder> {
        match Hold::take(interface, role) {
            Err(NotHeld::Taken(holder)) => holder,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn one_process_holds_a_role_until_it_lets_go_and_is_named() {
        let (one, other) = (interface("a"), interface("b"));
        let hold = Hold::take(&one, Role::Master).unwrap();
        // Other roles and other interfaces are free.
        let others = [Role::Node(1), Role::Node(2), Role::PlainCan(1)].map(|role| Hold::take(&one, role).unwrap());
        drop(Hold::take(&other, Role::Master).unwrap());
        for role in [Role::Master, Role::Node(1), Role::PlainCan(1)] {
            let holder = refused(&one, role).unwrap();
            assert_eq!(u32::try_from(holder.pid), Ok(std::process::id()));
            let program = std::env::args().next().unwrap();
            assert!(holder.to_string().contains(&program), "{holder}");
        }
        drop((hold, others));
        drop(Hold::take(&one, Role::Master).unwrap());
    }

    #[test]
    fn who_was_refused_thousands_of_times_is_refused_and_does_not_hang() {
        let interface = interface("c");
        let _hold = Hold::take(&interface, Role::Master).unwrap();
        // In the end the kernel keeps no more of those who ask, and the holder is found by its open files.
        assert!((0..4500).all(|_| refused(&interface, Role::Master).is_some()));
    }

    #[test]
    fn who_has_bound_a_role_without_listening_is_named() {
        let interface = interface("d");
        let socket = stream().unwrap();
        let name = format!("yieldwall/{interface}/master");
        bind(&socket, &SocketAddrUnix::new_abstract_name(name.as_bytes()).unwrap()).unwrap();
        let holder = refused(&interface, Role::Master).unwrap();
        assert_eq!(u32::try_from(holder.pid), Ok(std::process::id()));
        assert_eq!(holder.user, None, "it is the caller's");
    }

    #[test]
    fn the_user_of_a_holder_is_named() {
        assert_eq!(name_of(0).as_deref(), Some("root"));
        assert_eq!(name_of(u32::MAX - 7), None);
        let other = holder(1, 4_000_000_000);
        assert!(other.to_string().starts_with("process 1 of the user 4000000000"), "{other}");
    }
}
