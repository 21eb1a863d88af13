//! One message of a CAN socket with all control data of the kernel.
//!
//! This module calls `recvmsg` itself, because no safe wrapper passes on all three facts that a link needs:
//!
//! - whether the frame is an own one (`MSG_CONFIRM`, which nix cuts off),
//! - when it came (`SO_TIMESTAMPING`, which rustix drops),
//! - how many frames were lost before it (`SO_RXQ_OVFL`, which the crate `socketcan` drops).
#![allow(unsafe_code)]

use std::io;
use std::mem::{size_of, zeroed};
use std::os::fd::{AsRawFd, BorrowedFd};
use std::time::Duration;

/// A `can_frame` and what came with it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Message {
    /// Identifier with flags, length and bytes, as the kernel has them.
    pub(super) frame: libc::can_frame,
    /// Whether the socket that received it has sent it.
    pub(super) is_own: bool,
    /// Whether it is a frame of CAN FD, of which the first 8 bytes are here. Only a socket that was asked for them has them.
    pub(super) is_fd: bool,
    /// Control data of the kernel for this frame.
    pub(super) told: ControlMessages,
}

/// Contents of the control messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct ControlMessages {
    /// Time at which the kernel had it, since the start of the wall clock.
    pub(super) software: Option<Duration>,
    /// Time at which the controller had it, on its own clock.
    pub(super) hardware: Option<Duration>,
    /// Messages that the socket has lost so far; wraps.
    pub(super) lost: Option<u32>,
}

/// Bytes of a `size_t`, to which control messages are aligned.
const WORD: usize = size_of::<usize>();
/// Length, level and type.
const HEADER: usize = WORD + 8;
/// Bytes of a `timespec`: seconds and nanoseconds, half of it each.
const TIMESPEC: usize = size_of::<libc::timespec>();

impl ControlMessages {
    /// Reads control messages as the kernel lays them out (`cmsghdr`, and `scm_timestamping` of `include/uapi/linux/errqueue.h`: software,
    /// nothing, hardware). Messages of another layout are left out.
    fn read(mut control: &[u8]) -> Self {
        let mut told = Self::default();
        while let Some((length, rest)) = control.split_first_chunk::<WORD>() {
            let length = usize::from_ne_bytes(*length);
            let kind = (number(rest, 0, 4), number(rest, 4, 4));
            let Some(data) = control.get(HEADER..length) else { break };
            let is = |name: libc::c_int| kind == (Some(libc::SOL_SOCKET.into()), Some(name.into()));
            if is(libc::SO_TIMESTAMPING) {
                (told.software, told.hardware) = (stamp(data, 0), stamp(data, 2));
            } else if is(libc::SO_RXQ_OVFL) {
                told.lost = number(data, 0, 4).map(|lost| lost as u32);
            }
            control = control.get(length.next_multiple_of(WORD)..).unwrap_or_default();
        }
        told
    }
}

/// Returns one `timespec` of several; `None` for zero, which stands for no time, and for an invalid time.
fn stamp(data: &[u8], at: usize) -> Option<Duration> {
    let half = TIMESPEC / 2;
    let seconds = u64::try_from(number(data, at * TIMESPEC, half)?).ok()?;
    let nanos = u32::try_from(number(data, at * TIMESPEC + half, half)?).ok().filter(|nanos| *nanos < 1_000_000_000)?;
    Some(Duration::new(seconds, nanos)).filter(|stamp| !stamp.is_zero())
}

/// Returns a signed number of 4 or 8 bytes of this machine.
fn number(data: &[u8], from: usize, size: usize) -> Option<i64> {
    let bytes = data.get(from..from + size)?;
    match size {
        4 => Some(i32::from_ne_bytes(bytes.try_into().ok()?).into()),
        _ => Some(i64::from_ne_bytes(bytes.try_into().ok()?)),
    }
}

/// Room for the two control messages, aligned as `cmsghdr` has to be.
#[repr(C, align(8))]
struct Control([u8; 128]);

/// Returns the next message of a CAN socket, without waiting if `flags` are `MSG_DONTWAIT`, else within its timeout.
///
/// # Errors
/// `WouldBlock` if there is none, `Interrupted` after a signal, the socket's pending error, and `InvalidData` for what is no
/// classic frame.
pub(super) fn receive(socket: BorrowedFd<'_>, flags: libc::c_int) -> io::Result<Message> {
    // SAFETY: both are plain C structures for which all bits zero are a valid value.
    let (mut frame, mut header): (libc::can_frame, libc::msghdr) = unsafe { (zeroed(), zeroed()) };
    let mut control = Control([0; 128]);
    let mut part = libc::iovec { iov_base: (&raw mut frame).cast(), iov_len: size_of::<libc::can_frame>() };
    header.msg_iov = &raw mut part;
    header.msg_iovlen = 1;
    header.msg_control = control.0.as_mut_ptr().cast();
    header.msg_controllen = control.0.len() as _;
    // SAFETY: `header` points to one part and to control memory that are alive and as long as it says.
    let len = unsafe { libc::recvmsg(socket.as_raw_fd(), &raw mut header, flags) };
    if len < 0 {
        return Err(io::Error::last_os_error());
    }
    if len as usize != size_of::<libc::can_frame>() {
        return Err(io::ErrorKind::InvalidData.into());
    }
    let is_own = header.msg_flags & libc::MSG_CONFIRM != 0;
    // A `canfd_frame` begins as a `can_frame` and is longer.
    let is_fd = header.msg_flags & libc::MSG_TRUNC != 0;
    // The kernel has put the true length into the header, whose type is another one with another C library.
    let length: usize = header.msg_controllen as _;
    let told = ControlMessages::read(control.0.get(..length).unwrap_or_default());
    Ok(Message { frame, is_own, is_fd, told })
}

#[cfg(all(test, target_pointer_width = "64", target_endian = "little"))]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// SOL_SOCKET 1, SO_TIMESTAMPING 37, three times; then SO_RXQ_OVFL 40, four bytes and four of padding.
    #[rustfmt::skip]
    const BOTH: [u8; 88] = [
        64, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 37, 0, 0, 0,
        0x00, 0xe4, 0x20, 0x69, 0, 0, 0, 0, 0x15, 0xcd, 0x5b, 0x07, 0, 0, 0, 0,
        0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,
        0x2a, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xc9, 0x9a, 0x3b, 0, 0, 0, 0,
        20, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 40, 0, 0, 0, 0xfe, 0xff, 0xff, 0xff, 0, 0, 0, 0,
    ];

    #[test]
    fn both_stamps_and_the_loss_are_read() {
        let expected = ControlMessages {
            software: Some(Duration::new(0x6920_e400, 123_456_789)),
            hardware: Some(Duration::new(42, 999_999_999)),
            lost: Some(0xffff_fffe),
        };
        assert_eq!(ControlMessages::read(&BOTH), expected);
        // In the other order, and the last one without its padding.
        let turned = [&BOTH[64..], &BOTH[..64]].concat();
        assert_eq!(ControlMessages::read(&turned), expected);
        assert_eq!(ControlMessages::read(&BOTH[..84]), expected);
    }

    #[test]
    fn a_stamp_that_is_zero_is_none() {
        let mut without = BOTH;
        without[48..64].fill(0);
        assert_eq!(ControlMessages::read(&without), ControlMessages { hardware: None, ..ControlMessages::read(&BOTH) });
        without[16..32].fill(0);
        assert_eq!(
            ControlMessages::read(&without),
            ControlMessages { lost: Some(0xffff_fffe), ..ControlMessages::default() }
        );
    }

    #[test]
    fn what_is_no_time_is_none() {
        let mut wrong = BOTH;
        wrong[23] = 0x80;
        wrong[60] = 0xff;
        assert_eq!(
            ControlMessages::read(&wrong),
            ControlMessages { lost: Some(0xffff_fffe), ..ControlMessages::default() }
        );
    }

    #[test]
    fn other_messages_are_passed_over_and_cut_ones_left_out() {
        let mut other = BOTH;
        other[12] = 35;
        assert_eq!(
            ControlMessages::read(&other),
            ControlMessages { lost: Some(0xffff_fffe), ..ControlMessages::default() }
        );
        other[8] = 101;
        other[12] = 37;
        assert_eq!(
            ControlMessages::read(&other),
            ControlMessages { lost: Some(0xffff_fffe), ..ControlMessages::default() }
        );
        assert_eq!(ControlMessages::read(&BOTH[..63]), ControlMessages::default());
        assert_eq!(ControlMessages::read(&BOTH[..80]), ControlMessages { lost: None, ..ControlMessages::read(&BOTH) });
        assert_eq!(ControlMessages::read(&[]), ControlMessages::default());
    }

    proptest! {
        #[test]
        fn no_bytes_are_read_for_ever(control in prop::collection::vec(any::<u8>(), 0..200)) {
            ControlMessages::read(&control);
        }

        #[test]
        fn no_length_is_believed(length: u64) {
            let mut control = BOTH;
            control[..8].copy_from_slice(&length.to_le_bytes());
            ControlMessages::read(&control);
        }
    }
}
