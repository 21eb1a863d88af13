//! One message of a CAN socket with all that the kernel says about it.
//!
//! `recvmsg` is called here because no safe wrapper passes on all three things that are needed: whether the frame is an own
//! one (`MSG_CONFIRM`, which nix cuts off), when it came (`SO_TIMESTAMPNS`, which rustix drops) and how many were lost
//! before it (`SO_RXQ_OVFL`, which the crate `socketcan` drops).
#![allow(unsafe_code)]

use std::io;
use std::mem::{size_of, zeroed};
use std::os::fd::{AsRawFd, BorrowedFd};
use std::time::Duration;

/// A `can_frame` and what came with it.
#[derive(Clone, Copy)]
pub(super) struct Message {
    /// Identifier with flags, length and bytes, as the kernel has them.
    pub(super) frame: libc::can_frame,
    /// Whether the socket that received it has sent it.
    pub(super) is_own: bool,
    /// When it came, since the begin of the wall clock.
    pub(super) stamp: Option<Duration>,
    /// Messages that the socket has lost so far; wraps.
    pub(super) lost: Option<u32>,
}

/// Room for the two control messages, aligned as `cmsghdr` has to be.
#[repr(C, align(8))]
struct Control([u8; 128]);

/// The next message of a CAN socket, without waiting.
///
/// # Errors
/// `WouldBlock` if there is none, the socket's pending error, and `InvalidData` for what is no classic frame.
pub(super) fn receive(socket: BorrowedFd<'_>) -> io::Result<Message> {
    // SAFETY: both are plain C structures for which all bits zero are a valid value.
    let (mut frame, mut header): (libc::can_frame, libc::msghdr) = unsafe { (zeroed(), zeroed()) };
    let mut control = Control([0; 128]);
    let mut part = libc::iovec { iov_base: (&raw mut frame).cast(), iov_len: size_of::<libc::can_frame>() };
    header.msg_iov = &raw mut part;
    header.msg_iovlen = 1;
    header.msg_control = control.0.as_mut_ptr().cast();
    header.msg_controllen = control.0.len() as _;
    // SAFETY: `header` points to one part and to control memory that are alive and as long as it says.
    let len = unsafe { libc::recvmsg(socket.as_raw_fd(), &raw mut header, libc::MSG_DONTWAIT) };
    if len < 0 {
        return Err(io::Error::last_os_error());
    }
    if len as usize != size_of::<libc::can_frame>() {
        return Err(io::ErrorKind::InvalidData.into());
    }
    let is_own = header.msg_flags & libc::MSG_CONFIRM != 0;
    let mut message = Message { frame, is_own, stamp: None, lost: None };
    // SAFETY: the kernel has filled in the control memory, of which `header` now holds the true length.
    let mut next = unsafe { libc::CMSG_FIRSTHDR(&raw const header) };
    // The memory has room for fewer.
    for _ in 0..8 {
        if next.is_null() {
            break;
        }
        // SAFETY: `next` is not null and points to a control message within the memory; its data are as long as the type
        // of the message says, and need no alignment here.
        unsafe {
            let data = libc::CMSG_DATA(next);
            match ((*next).cmsg_level, (*next).cmsg_type) {
                (libc::SOL_SOCKET, libc::SO_TIMESTAMPNS) => {
                    let stamp = data.cast::<libc::timespec>().read_unaligned();
                    message.stamp = Some(Duration::new(stamp.tv_sec.max(0) as u64, stamp.tv_nsec as u32));
                }
                (libc::SOL_SOCKET, libc::SO_RXQ_OVFL) => message.lost = Some(data.cast::<u32>().read_unaligned()),
                _ => {}
            }
            next = libc::CMSG_NXTHDR(&raw const header, next);
        }
    }
    Ok(message)
}
