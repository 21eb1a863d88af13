//! What the system says of an interface.

use std::fs;

use socketcan::nl::CanState;
use socketcan::{CanAddr, CanInterface, CanSocket, Socket};

use super::error::LinkError;

/// `ARPHRD_CAN` of `linux/if_arp.h`.
const TYPE_CAN: &str = "280";

/// State of a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControllerState {
    /// Both error counters below 96.
    ErrorActive,
    /// An error counter of 96 or more.
    ErrorWarning,
    /// An error counter of 128 or more.
    ErrorPassive,
    /// It has left the bus.
    BusOff,
    /// It is not running.
    Stopped,
    /// It sleeps.
    Sleeping,
}

/// An interface as the system described it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InterfaceFacts {
    /// Its name.
    pub name: String,
    /// Whether it is up.
    pub is_up: bool,
    /// Bit rate in bit/s; `None` for a virtual one.
    pub bit_rate: Option<u32>,
    /// Sample point as a share of the bit, in per mille.
    pub sample_point_per_mille: Option<u32>,
    /// State of the controller; `None` for a virtual one.
    pub state: Option<ControllerState>,
    /// Error counters for transmission and reception, where the driver tells them.
    pub error_counters: Option<(u16, u16)>,
    /// Time in ms after which the kernel restarts a controller that is bus-off; 0 for never.
    pub restart_ms: Option<u32>,
    /// Whether its controller stamps frames with a clock of its own.
    pub has_hardware_time: bool,
}

impl InterfaceFacts {
    /// Whether it has no controller, and so no bit rate, no arbitration and no error frames.
    pub fn is_virtual(&self) -> bool {
        self.bit_rate.is_none() && self.state.is_none()
    }

    /// What should be changed before a rig runs on it, one sentence each.
    pub fn advice(&self) -> Vec<String> {
        let name = &self.name;
        let mut advice = Vec::new();
        if self.restart_ms.is_some_and(|wait| wait != 0) {
            advice.push(format!(
                "`{name}` restarts by itself after bus-off and then sends what it still holds: set \
                 `sudo ip link set {name} type can restart-ms 0`"
            ));
        }
        if matches!(self.state, Some(ControllerState::ErrorWarning | ControllerState::ErrorPassive)) {
            advice.push(format!("the controller of `{name}` has seen errors: check cable, termination and bit rates"));
        }
        advice
    }

    /// Whether a rig can run on it.
    pub(super) fn check(&self, wanted: Option<u32>) -> Result<(), LinkError> {
        let interface = self.name.clone();
        if !self.is_up {
            let bit_rate = if self.is_virtual() { None } else { wanted.or(self.bit_rate) };
            return Err(LinkError::Down { interface, bit_rate });
        }
        if self.state == Some(ControllerState::BusOff) {
            return Err(LinkError::BusOff { interface });
        }
        match (self.bit_rate, wanted) {
            (Some(has), Some(wanted)) if has != wanted => Err(LinkError::BitRate { interface, has, wanted }),
            _ => Ok(()),
        }
    }
}

/// The CAN interfaces that are there, by name.
pub(super) fn interfaces() -> Vec<String> {
    let Ok(entries) = fs::read_dir("/sys/class/net") else { return Vec::new() };
    let is_can = |entry: &fs::DirEntry| {
        fs::read_to_string(entry.path().join("type")).is_ok_and(|number| number.trim() == TYPE_CAN)
    };
    let mut names: Vec<_> =
        entries.flatten().filter(is_can).map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// The index of an interface, once it is clear that there are CAN sockets at all.
pub(super) fn find(name: &str, wanted: Option<u32>) -> Result<u32, LinkError> {
    // Of no interface in particular.
    CanSocket::open_iface(0).map_err(|source| LinkError::from_open(name, source))?;
    match CanAddr::from_iface(name) {
        Ok(address) => Ok(address.ifindex()),
        Err(_) => Err(LinkError::Missing { interface: name.to_owned(), others: interfaces(), wanted }),
    }
}

/// Asks the kernel for all that it knows.
pub(super) fn query(name: &str, index: u32, socket: &CanSocket) -> Result<InterfaceFacts, LinkError> {
    let details = CanInterface::open_iface(index).details().map_err(|error| LinkError::System {
        interface: name.to_owned(),
        step: "describe it over netlink",
        source: std::io::Error::other(error.to_string()),
    })?;
    let can = details.can;
    Ok(InterfaceFacts {
        name: name.to_owned(),
        is_up: details.is_up,
        bit_rate: can.bit_timing.map(|timing| timing.bitrate).filter(|bit_rate| *bit_rate > 0),
        sample_point_per_mille: can.bit_timing.map(|timing| timing.sample_point),
        state: can.state.map(|state| match state {
            CanState::ErrorActive => ControllerState::ErrorActive,
            CanState::ErrorWarning => ControllerState::ErrorWarning,
            CanState::ErrorPassive => ControllerState::ErrorPassive,
            CanState::BusOff => ControllerState::BusOff,
            CanState::Stopped => ControllerState::Stopped,
            CanState::Sleeping => ControllerState::Sleeping,
        }),
        error_counters: can.berr_counter.map(|counters| (counters.txerr, counters.rxerr)),
        restart_ms: can.restart_ms,
        has_hardware_time: socket.has_hw_timestamps(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vcan() -> InterfaceFacts {
        InterfaceFacts {
            name: "vcan0".to_owned(),
            is_up: true,
            bit_rate: None,
            sample_point_per_mille: None,
            state: None,
            error_counters: None,
            restart_ms: None,
            has_hardware_time: false,
        }
    }

    fn can() -> InterfaceFacts {
        InterfaceFacts {
            name: "can0".to_owned(),
            bit_rate: Some(500_000),
            state: Some(ControllerState::ErrorActive),
            restart_ms: Some(0),
            ..vcan()
        }
    }

    #[test]
    fn a_virtual_interface_passes_whatever_the_bit_rate() {
        assert!(vcan().is_virtual() && vcan().check(Some(1_000_000)).is_ok());
        let down = InterfaceFacts { is_up: false, ..vcan() };
        assert!(matches!(down.check(Some(1_000_000)), Err(LinkError::Down { bit_rate: None, .. })));
    }

    #[test]
    fn a_real_one_has_to_be_what_the_rig_says() {
        assert!(can().check(Some(500_000)).is_ok() && can().check(None).is_ok() && !can().is_virtual());
        let other = can().check(Some(1_000_000));
        assert!(matches!(other, Err(LinkError::BitRate { has: 500_000, wanted: 1_000_000, .. })));
        let down = InterfaceFacts { is_up: false, state: Some(ControllerState::Stopped), ..can() };
        assert!(matches!(down.check(Some(1_000_000)), Err(LinkError::Down { bit_rate: Some(1_000_000), .. })));
        let off = InterfaceFacts { state: Some(ControllerState::BusOff), ..can() };
        assert!(matches!(off.check(None), Err(LinkError::BusOff { .. })));
    }

    #[test]
    fn a_silent_restart_is_advised_against() {
        assert!(can().advice().is_empty() && vcan().advice().is_empty());
        let restarting = InterfaceFacts { restart_ms: Some(100), ..can() };
        assert!(restarting.advice()[0].contains("restart-ms 0"));
        let worn = InterfaceFacts { state: Some(ControllerState::ErrorPassive), ..can() };
        assert_eq!(worn.advice().len(), 1);
    }
}
