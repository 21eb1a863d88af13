//! The calls of the system about packet sockets for which rustix has no safe wrapper: `bind`, `recvfrom` and `setsockopt` with the
//! addresses and options of `packet(7)`, and the questions of `netdevice(7)`.
#![allow(unsafe_code)]

use std::io;
use std::mem::{size_of, zeroed};
use std::os::fd::{AsRawFd, BorrowedFd};

/// The type of EtherCAT in an Ethernet frame.
pub(super) const ETHERCAT: u16 = 0x88a4;

/// State of an interface, as the system reports it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Device {
    /// `ARPHRD_...` of `linux/if_arp.h`.
    pub(super) kind: u16,
    pub(super) is_up: bool,
    /// Whether a cable is in, or the other end of a pair is up.
    pub(super) has_carrier: bool,
}

/// Asks about an interface over any socket.
pub(super) fn device(socket: BorrowedFd<'_>, name: &str) -> io::Result<Device> {
    // SAFETY: a plain C structure for which all bits zero are a valid value.
    let mut request: libc::ifreq = unsafe { zeroed() };
    // One byte stays zero and ends the name.
    let Some(place) = request.ifr_name.get_mut(..name.len()).filter(|place| place.len() < libc::IFNAMSIZ) else {
        return Err(io::Error::from_raw_os_error(libc::ENODEV));
    };
    place.iter_mut().zip(name.bytes()).for_each(|(place, byte)| *place = byte as libc::c_char);
    let ask = |what, request: &mut libc::ifreq| {
        // SAFETY: these requests read the name of an `ifreq` and write into it, and it is alive.
        match unsafe { libc::ioctl(socket.as_raw_fd(), what, &raw mut *request) } {
            0 => Ok(()),
            _ => Err(io::Error::last_os_error()),
        }
    };
    ask(libc::SIOCGIFHWADDR, &mut request)?;
    // SAFETY: the request has filled this member.
    let kind = unsafe { request.ifr_ifru.ifru_hwaddr.sa_family };
    ask(libc::SIOCGIFFLAGS, &mut request)?;
    // SAFETY: the request has filled this member.
    let flags = libc::c_int::from(unsafe { request.ifr_ifru.ifru_flags });
    let is_up = flags & libc::IFF_UP != 0;
    Ok(Device { kind, is_up, has_carrier: is_up && flags & libc::IFF_RUNNING != 0 })
}

/// Binds a packet socket to one interface, so that it receives every frame with the type of EtherCAT, whatever its destination.
pub(super) fn bind(socket: BorrowedFd<'_>, index: u32) -> io::Result<()> {
    // Before the socket hears anything: other sockets of this machine may send on the same interface.
    set(socket, libc::PACKET_IGNORE_OUTGOING, &libc::c_int::from(true))?;
    let everything = libc::packet_mreq {
        mr_ifindex: index as libc::c_int,
        mr_type: libc::PACKET_MR_PROMISC as libc::c_ushort,
        mr_alen: 0,
        mr_address: [0; 8],
    };
    set(socket, libc::PACKET_ADD_MEMBERSHIP, &everything)?;
    // SAFETY: a plain C structure for which all bits zero are a valid value.
    let mut address: libc::sockaddr_ll = unsafe { zeroed() };
    address.sll_family = libc::AF_PACKET as libc::c_ushort;
    address.sll_protocol = ETHERCAT.to_be();
    address.sll_ifindex = index as libc::c_int;
    let length = size_of::<libc::sockaddr_ll>() as libc::socklen_t;
    // SAFETY: `address` is alive and as long as `length` says.
    let result = unsafe { libc::bind(socket.as_raw_fd(), (&raw const address).cast(), length) };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

fn set<T>(socket: BorrowedFd<'_>, option: libc::c_int, value: &T) -> io::Result<()> {
    let length = size_of::<T>() as libc::socklen_t;
    // SAFETY: `value` is alive and as long as `length` says.
    let result = unsafe {
        libc::setsockopt(socket.as_raw_fd(), libc::SOL_PACKET, option, std::ptr::from_ref(value).cast(), length)
    };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// Returns the next frame without waiting: its length, which may be more than the buffer holds, and whether this machine has sent it.
///
/// # Errors
/// `WouldBlock` if there is none, `Interrupted` after a signal, and the socket's pending error.
pub(super) fn receive(socket: BorrowedFd<'_>, buffer: &mut [u8]) -> io::Result<(usize, bool)> {
    // SAFETY: a plain C structure for which all bits zero are a valid value.
    let mut from: libc::sockaddr_ll = unsafe { zeroed() };
    let mut from_length = size_of::<libc::sockaddr_ll>() as libc::socklen_t;
    let flags = libc::MSG_DONTWAIT | libc::MSG_TRUNC;
    // SAFETY: `buffer` and `from` are alive and as long as is said.
    let length = unsafe {
        let (to, room) = (buffer.as_mut_ptr().cast(), buffer.len());
        libc::recvfrom(socket.as_raw_fd(), to, room, flags, (&raw mut from).cast(), &raw mut from_length)
    };
    let length = usize::try_from(length).map_err(|_| io::Error::last_os_error())?;
    Ok((length, from.sll_pkttype == libc::PACKET_OUTGOING))
}
