//! A packet socket of Linux.

use std::fs;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use rustix::event::{PollFd, PollFlags};
use rustix::io::Errno;
use rustix::net::{AddressFamily, SendFlags, SocketFlags, SocketType, netdevice, send, socket_with};

use super::error::EthernetError;
use super::system::{self, Device};
use super::{EthernetArrival, EthernetLink, EthernetReceived};
use crate::clock::{monotonic, wait_for_any};
use crate::hold::{Hold, NotHeld};
use crate::{Role, SendError};
use yieldwall_fieldbus::ethercat::frame;
use yieldwall_fieldbus::time::Time;

/// An Ethernet interface that carries EtherCAT.
///
/// Opening one takes the privilege `CAP_NET_RAW`.
#[derive(Debug)]
pub struct PacketSocket {
    socket: OwnedFd,
    interface: String,
    source: [u8; 6],
    /// It went down and was not seen up again.
    is_down: bool,
    _hold: Option<Hold>,
}

impl PacketSocket {
    /// Opens an interface and checks that it can be used: that it is there, is an Ethernet interface and is up. Takes the role on it.
    ///
    /// # Errors
    /// What is wrong with it or who has the role, and what to try next.
    pub fn open(interface: &str, role: Role) -> Result<Self, EthernetError> {
        Self::opened(interface, Some(role))
    }

    /// Opens a socket without a role, so that another process may hold the role. It suits a process that sends nothing, and a process that
    /// sends in place of the one that has the role.
    ///
    /// # Errors
    /// The fault of the interface, and the next step to try.
    pub fn listening(interface: &str) -> Result<Self, EthernetError> {
        Self::opened(interface, None)
    }

    fn opened(interface: &str, role: Option<Role>) -> Result<Self, EthernetError> {
        let failed = |step| {
            let interface = interface.to_owned();
            move |source| EthernetError::System { interface, step, source }
        };
        // Any socket may ask about interfaces, and the answer says more than a refusal to open this one.
        let asking = socket_with(AddressFamily::UNIX, SocketType::DGRAM, SocketFlags::CLOEXEC, None)
            .map_err(|error| failed("describe it")(error.into()))?;
        let device = system::device(asking.as_fd(), interface);
        let device = device.map_err(|_| EthernetError::missing(interface, interfaces(asking.as_fd())))?;
        if device.kind != libc::ARPHRD_ETHER {
            return Err(EthernetError::not_ethernet(interface, device.kind, interfaces(asking.as_fd())));
        }
        if !device.is_up {
            return Err(EthernetError::Down { interface: interface.to_owned() });
        }
        let hold = role.map(|role| {
            Hold::take(interface, role).map_err(|error| match error {
                NotHeld::Taken(holder) => EthernetError::Held { interface: interface.to_owned(), role, holder },
                NotHeld::System(source) => failed("keep it for one process")(source),
            })
        });
        let hold = hold.transpose()?;
        let index = netdevice::name_to_index(&asking, interface).map_err(|error| failed("find it")(error.into()))?;
        // Of no type yet: a socket that is not bound hears those of its type on all interfaces.
        let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
        let socket = socket_with(AddressFamily::PACKET, SocketType::RAW, flags, None);
        let socket = socket.map_err(|error| EthernetError::from_open(interface, error))?;
        system::bind(socket.as_fd(), index).map_err(failed("hear what comes over it"))?;
        let source = frame::source(RandomState::new().build_hasher().finish());
        Ok(Self { socket, interface: interface.to_owned(), source, is_down: false, _hold: hold })
    }

    /// Returns the name of the interface.
    pub fn interface(&self) -> &str {
        &self.interface
    }

    /// Whether a cable is in, or the other end of a virtual pair is up. Nothing is heard and nothing leaves without.
    pub fn has_carrier(&self) -> bool {
        system::device(self.socket.as_fd(), &self.interface).is_ok_and(|device| device.has_carrier)
    }
}

/// Whether there is such an interface and it is an Ethernet interface.
pub fn is_ethernet(interface: &str) -> bool {
    let asking = socket_with(AddressFamily::UNIX, SocketType::DGRAM, SocketFlags::CLOEXEC, None);
    let device = asking.ok().and_then(|asking| system::device(asking.as_fd(), interface).ok());
    device.is_some_and(|device| device.kind == libc::ARPHRD_ETHER)
}

impl AsFd for PacketSocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

impl EthernetLink for PacketSocket {
    fn now(&self) -> Time {
        monotonic()
    }

    fn source(&self) -> [u8; 6] {
        self.source
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Option<EthernetArrival> {
        // Calls that are interrupted, and frames of this machine, are passed over; both are rare.
        for _ in 0..4 {
            let what = match system::receive(self.socket.as_fd(), buffer) {
                Ok((_, true)) => continue,
                Ok((length, false)) if length <= buffer.len() => EthernetReceived::Frame { length },
                Ok((length, false)) => EthernetReceived::TooLong { length },
                Err(error) => match Errno::from_io_error(&error) {
                    Some(Errno::AGAIN) if self.is_down && self.is_gone() => EthernetReceived::Gone,
                    Some(Errno::AGAIN) => return None,
                    Some(Errno::NETDOWN) => self.lost(),
                    Some(Errno::NODEV | Errno::NXIO) => EthernetReceived::Gone,
                    _ => continue,
                },
            };
            return Some(EthernetArrival { time: monotonic(), what });
        }
        None
    }

    fn send(&mut self, frame: &[u8]) -> Result<(), SendError> {
        match send(&self.socket, frame, SendFlags::DONTWAIT) {
            Ok(_) => Ok(()),
            Err(error) => Err(match error {
                Errno::NOBUFS | Errno::AGAIN => SendError::Full,
                Errno::NETDOWN => SendError::Down,
                Errno::NODEV | Errno::NXIO => SendError::Gone,
                other => SendError::System { errno: other.raw_os_error() },
            }),
        }
    }

    fn wait(&mut self, until: Time) -> bool {
        wait_for_any(&mut [PollFd::new(&self.socket, PollFlags::IN)], until)
    }
}

impl PacketSocket {
    /// Handles a lost interface. A removed interface goes down first, and its socket reports no more than that.
    fn lost(&mut self) -> EthernetReceived {
        self.is_down = true;
        if self.is_gone() { EthernetReceived::Gone } else { EthernetReceived::Down }
    }

    /// Returns whether the interface no longer exists. Once it is up again, the link does not query it until it goes down once more.
    fn is_gone(&mut self) -> bool {
        let device = system::device(self.socket.as_fd(), &self.interface);
        self.is_down = device.as_ref().is_ok_and(|device| !device.is_up);
        device.is_err()
    }
}

/// Returns the Ethernet interfaces that are there, by name.
fn interfaces(asking: BorrowedFd<'_>) -> Vec<String> {
    // Of the network namespace of this process, which `/sys` need not be of.
    let table = fs::read_to_string("/proc/self/net/dev").unwrap_or_default();
    let names = table.lines().filter_map(|line| Some(line.split_once(':')?.0.trim()));
    let is_ethernet =
        |name: &&str| system::device(asking, name).is_ok_and(|Device { kind, .. }| kind == libc::ARPHRD_ETHER);
    let mut names: Vec<_> = names.filter(is_ethernet).map(str::to_owned).collect();
    names.sort();
    names
}
