//! Interrupt coalescing of a network card: how long it holds received frames back before it interrupts the computer.
#![allow(unsafe_code)]

use std::io;
use std::os::fd::AsRawFd;

use rustix::io::Errno;
use rustix::net::{AddressFamily, SocketFlags, SocketType, socket_with};
use thiserror::Error;

use yieldwall_link::checkup::Check;

/// Longest name of an interface, with the zero behind it (`IFNAMSIZ`).
const LONGEST_NAME: usize = 16;
/// `ETHTOOL_GCOALESCE` of `linux/ethtool.h`.
const GET_COALESCE: u32 = 0x0000_000e;
/// `SIOCETHTOOL` of `linux/sockios.h`.
const ETHTOOL: u32 = 0x8946;

/// How long a card holds frames back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Coalescing {
    /// Time in us from the reception of a frame to the interrupt.
    pub receive_us: u32,
    /// Time in us from the sending of a frame to the interrupt.
    pub transmit_us: u32,
    /// Whether the card chooses both times by itself.
    pub is_adaptive: bool,
}

/// Why that is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum CardError {
    /// There is no such card.
    #[error("there is no network card of that name")]
    Missing,
    /// The driver does not report it.
    #[error("the driver does not report")]
    Untold,
    /// The system refuses.
    #[error("the system does not report it: {0}")]
    System(Errno),
}

/// `struct ethtool_coalesce` of `linux/ethtool.h`: the command, and 22 numbers.
#[repr(C)]
struct Request {
    command: u32,
    numbers: [u32; 22],
}

/// `struct ifreq` of `linux/if.h` with a pointer in its union, which is 24 bytes long.
#[repr(C)]
struct Card {
    name: [u8; LONGEST_NAME],
    request: *mut Request,
    rest: [u8; 16],
}

/// Returns the interrupt coalescing of a card.
///
/// # Errors
/// Why the card does not report it.
pub fn coalescing(name: &str) -> Result<Coalescing, CardError> {
    let mut card = Card { name: [0; LONGEST_NAME], request: std::ptr::null_mut(), rest: [0; 16] };
    let is_name = !name.is_empty() && name.len() < LONGEST_NAME && !name.contains('\0');
    card.name.iter_mut().zip(name.bytes()).for_each(|(to, from)| *to = from);
    if !is_name {
        return Err(CardError::Missing);
    }
    let socket = socket_with(AddressFamily::INET, SocketType::DGRAM, SocketFlags::CLOEXEC, None);
    let socket = socket.map_err(CardError::System)?;
    let mut request = Request { command: GET_COALESCE, numbers: [0; 22] };
    card.request = &raw mut request;
    // SAFETY: `card` and the `request` that it points to are alive, of the layout that this request of the kernel has, and as long:
    // the kernel reads the name and the command, and writes the numbers.
    let result = unsafe { libc::ioctl(socket.as_raw_fd(), ETHTOOL as _, &raw mut card) };
    if result < 0 {
        return Err(match Errno::from_io_error(&io::Error::last_os_error()) {
            Some(Errno::NODEV) => CardError::Missing,
            Some(Errno::OPNOTSUPP) | None => CardError::Untold,
            Some(error) => CardError::System(error),
        });
    }
    let [receive_us, _, _, _, transmit_us, _, _, _, _, receives_adaptively, transmits_adaptively, ..] = request.numbers;
    Ok(Coalescing { receive_us, transmit_us, is_adaptive: receives_adaptively != 0 || transmits_adaptively != 0 })
}

/// Checks a card for a bus whose frames must not wait.
pub fn coalescing_check(name: &str, found: Result<Coalescing, CardError>) -> Check {
    let subject = "coalescing";
    match found {
        Err(CardError::Missing) => Check::wrong(subject, format!("there is no network card `{name}`"))
            .follows("the command lists all network cards")
            .fix("ip -brief link"),
        Err(error) => Check::unknown(subject, format!("`{name}`: {error}")),
        Ok(Coalescing { receive_us: 0, transmit_us: 0, is_adaptive: false }) => {
            Check::ok(subject, "none: the card reports each frame at once")
        }
        Ok(Coalescing { receive_us, transmit_us, is_adaptive }) => {
            let adaptive = if is_adaptive { ", adaptive" } else { "" };
            let found = format!("`{name}` waits {receive_us} us receiving and {transmit_us} us transmitting{adaptive}");
            let off = if is_adaptive { " adaptive-rx off adaptive-tx off" } else { "" };
            Check::warning(subject, found)
                .follows("delays the report of frames by up to this time")
                .fix(format!("sudo ethtool -C {name}{off} rx-usecs 0 tx-usecs 0"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_link::checkup::Verdict;

    #[test]
    fn a_card_that_waits_is_told_not_to() {
        let check = coalescing_check("eth1", Ok(Coalescing { receive_us: 3, ..Coalescing::default() }));
        assert_eq!(check.fix.as_deref(), Some("sudo ethtool -C eth1 rx-usecs 0 tx-usecs 0"));
        let check = coalescing_check("eth1", Ok(Coalescing { is_adaptive: true, ..Coalescing::default() }));
        assert_eq!(
            check.fix.as_deref(),
            Some("sudo ethtool -C eth1 adaptive-rx off adaptive-tx off rx-usecs 0 tx-usecs 0")
        );
        assert_eq!(coalescing_check("eth1", Ok(Coalescing::default())).verdict, Verdict::Ok);
        assert_eq!(coalescing_check("eth1", Err(CardError::Untold)).verdict, Verdict::Unknown);
    }

    #[test]
    fn what_is_no_card_is_said_to_be_none() {
        for name in ["", "no-such-card-x", "far too long for a card", "a\0b"] {
            assert_eq!(coalescing(name), Err(CardError::Missing), "{name:?}");
        }
        // Loopback is a card that never waits, and says so or does not say.
        assert!(matches!(coalescing("lo"), Err(CardError::Untold) | Ok(_)));
    }
}
