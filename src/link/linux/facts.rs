//! State of an interface, as the system reports it.

use std::fs;
use std::path::Path;

use socketcan::nl::CanState;
use socketcan::{CanAddr, CanCtrlMode, CanInterface, CanSocket, Socket};

use super::adapter::{Attachment, Folder, NET};
use super::error::LinkError;
use super::queue;
use crate::checkup::{Check, Verdict};

/// `ARPHRD_CAN` of `linux/if_arp.h`.
const TYPE_CAN: &str = "280";
/// Sample points in per mille that nodes get on with. CiA 301 asks for 87.5 %; adapters take 75 % at 1 Mbit/s.
const SAMPLE_POINTS: std::ops::RangeInclusive<u32> = 700..=900;

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
    /// Error counters for transmission and reception, where the driver reports them.
    pub error_counters: Option<(u16, u16)>,
    /// Time in ms after which the kernel restarts a controller that is bus-off; 0 for never.
    pub restart_ms: Option<u32>,
    /// Whether its controller stamps frames with a clock of its own.
    pub has_hardware_time: bool,
    /// Whether a frame is not repeated after an error or a lost arbitration; `None` if unknown.
    pub is_one_shot: Option<bool>,
    /// Whether the controller reports each error on the bus by a frame of its own; `None` if unknown.
    pub reports_bus_errors: Option<bool>,
    /// Whether own frames come back after they have left, and not already when they enter the queue; `None` if unknown.
    pub has_echo: Option<bool>,
    /// Number of frames that its queue holds; `None` if unknown.
    pub tx_queue_len: Option<u32>,
    /// Name of its queueing discipline; `None` if unknown.
    pub queueing: Option<String>,
    /// Connection between the computer and the controller.
    pub attachment: Attachment,
    /// Name of the driver; `None` if unknown.
    pub driver: Option<String>,
}

impl InterfaceFacts {
    /// Whether it has no controller, and so no bit rate, no arbitration and no error frames.
    pub fn is_virtual(&self) -> bool {
        self.bit_rate.is_none() && self.state.is_none()
    }

    /// Reads the state of an interface, whatever it is. `wanted` is the bit rate in bit/s that it should have, for the message.
    ///
    /// # Errors
    /// If there is no such interface, it is of another type, or it may not be used.
    pub fn read(name: &str, wanted: Option<u32>) -> Result<Self, LinkError> {
        let index = find(name, wanted)?;
        let socket = CanSocket::open_iface(index).map_err(|source| LinkError::from_open(name, source, interfaces))?;
        query(name, index, &socket)
    }

    /// Returns the changes to make before a rig runs on it, one sentence each.
    pub fn advice(&self) -> Vec<String> {
        let warnings = self.checks(None).into_iter().filter(|check| check.verdict == Verdict::Warning);
        warnings.map(|check| check.to_string()).collect()
    }

    /// Returns the checks of the interface, for a rig of this bit rate in bit/s if one is known.
    pub fn checks(&self, wanted: Option<u32>) -> Vec<Check> {
        let name = &self.name;
        let kind = if self.is_virtual() { "virtual" } else { "with a controller" };
        let mut checks = vec![match self.is_up {
            true => Check::ok("interface", format!("up, {kind}")),
            false => LinkError::Down { interface: name.clone(), bit_rate: self.bit_rate_if_down(wanted) }.check(),
        }];
        if self.is_virtual() {
            checks.push(Check::ok("controller", "none: neither bit rate nor error state"));
        } else {
            checks.extend([self.controller(), self.timing(wanted), self.sample_point()]);
        }
        checks.extend(queue::checks(name, self.is_virtual(), self.queueing.as_deref(), self.tx_queue_len));
        if !self.is_virtual() {
            checks.extend([self.restart(), self.one_shot(), self.bus_errors()]);
        }
        checks.push(self.echo());
        checks
    }

    fn bit_rate_if_down(&self, wanted: Option<u32>) -> Option<u32> {
        if self.is_virtual() { None } else { wanted.or(self.bit_rate) }
    }

    fn controller(&self) -> Check {
        let subject = "controller";
        let counters = self.error_counters.map_or(String::new(), |(transmit, receive)| {
            format!(" (error counters: {transmit} transmitting, {receive} receiving)")
        });
        match self.state {
            None => Check::unknown(subject, "the driver does not report its error state"),
            Some(ControllerState::ErrorActive) => Check::ok(subject, format!("error-active{counters}")),
            Some(ControllerState::BusOff) => LinkError::BusOff { interface: self.name.clone() }.check(),
            // Where the interface is down this is said of the interface.
            Some(ControllerState::Stopped) => Check::unknown(subject, "stopped"),
            Some(ControllerState::Sleeping) => Check::unknown(subject, "sleeping"),
            Some(state) => {
                let word = if state == ControllerState::ErrorPassive { "error-passive" } else { "error-warning" };
                let found = format!("the controller of `{}` is {word}{counters}", self.name);
                Check::warning(subject, found).follows(
                    "it has seen errors: look at the cable, at both terminators (60 ohm between CAN_H and CAN_L without \
                     power) and at the bit rate of every node",
                )
            }
        }
    }

    fn timing(&self, wanted: Option<u32>) -> Check {
        let subject = "bit rate";
        match (self.bit_rate, wanted) {
            (None, None) => Check::unknown(subject, "none is set"),
            (None, Some(wanted)) => Check::unknown(subject, format!("none is set; the rig has {wanted} bit/s")),
            (Some(has), Some(wanted)) if has != wanted => {
                LinkError::BitRate { interface: self.name.clone(), has, wanted }.check()
            }
            (Some(has), Some(_)) => Check::ok(subject, format!("{has} bit/s, as the rig's")),
            (Some(has), None) => Check::ok(subject, format!("{has} bit/s; name a rig to have it compared")),
        }
    }

    fn sample_point(&self) -> Check {
        let subject = "sample point";
        let Some(per_mille) = self.sample_point_per_mille.filter(|per_mille| *per_mille > 0) else {
            return Check::unknown(subject, "the driver does not report it");
        };
        let found = format!("at {}.{} % of the bit", per_mille / 10, per_mille % 10);
        if SAMPLE_POINTS.contains(&per_mille) {
            return Check::ok(subject, found);
        }
        let check = Check::warning(subject, format!("`{}` samples {found}", self.name))
            .follows("75 to 87.5 % is usual: with others nodes disagree on long cables");
        let Some(bit_rate) = self.bit_rate else { return check };
        check.fix(self.anew(&format!("bitrate {bit_rate} sample-point 0.875")))
    }

    fn restart(&self) -> Check {
        let name = &self.name;
        match self.restart_ms {
            None => Check::unknown("restart", "the driver does not report restart-ms"),
            Some(0) => Check::ok("restart", "never by itself after bus-off (restart-ms 0)"),
            Some(wait) => Check::warning("restart", format!("`{name}` has restart-ms {wait}"))
                .follows("it restarts by itself after bus-off and then sends what it still holds")
                .fix(self.anew("restart-ms 0")),
        }
    }

    fn one_shot(&self) -> Check {
        match self.is_one_shot {
            None => Check::unknown("one-shot", "the driver does not report"),
            Some(false) => Check::ok("one-shot", "off: frames are repeated after errors"),
            Some(true) => Check::warning("one-shot", format!("`{}` is in one-shot mode", self.name))
                .follows("a frame that meets an error or a stronger one is lost")
                .fix(self.anew("one-shot off")),
        }
    }

    fn bus_errors(&self) -> Check {
        match self.reports_bus_errors {
            None => Check::unknown("bus errors", "the driver does not report"),
            Some(false) => Check::ok("bus errors", "not reported one by one (berr-reporting off)"),
            Some(true) => {
                Check::warning("bus errors", format!("`{}` reports each error on the bus by a frame", self.name))
                    .follows("a bad cable then floods the computer; leave it on while you look for the error alone")
                    .fix(self.anew("berr-reporting off"))
            }
        }
    }

    fn echo(&self) -> Check {
        match self.has_echo {
            None => Check::unknown("echo", "when own frames come back is unknown"),
            Some(true) => Check::ok("echo", "own frames come back when they have left"),
            Some(false) if self.is_virtual() => Check::warning(
                "echo",
                format!(
                    "own frames come back on `{}` when they enter its queue, not when they have left it",
                    self.name
                ),
            )
            .follows("hardware reports when they have left. Make the interface again after this")
            .fix("sudo modprobe -r vcan && sudo modprobe vcan echo=1"),
            Some(false) => LinkError::NoEcho { interface: self.name.clone(), driver: self.driver.clone() }.check(),
        }
    }

    /// Returns the command that sets an option, which is possible only while the interface is down.
    fn anew(&self, option: &str) -> String {
        let name = &self.name;
        format!("sudo ip link set {name} down && sudo ip link set {name} up type can {option}")
    }

    /// Describes the interface for a person, without name, bit rate and state; unknown values are shown as unknown.
    pub fn told(&self) -> String {
        let or_unknown = |known: Option<String>| known.unwrap_or_else(|| "unknown".to_owned());
        let switch = |is_on: Option<bool>| is_on.map_or("unknown", |is_on| if is_on { "on" } else { "off" });
        let mut told = format!(
            "{}, driver {}; queue {} of {} frames; own frames come back {}",
            self.attachment,
            or_unknown(self.driver.clone()),
            or_unknown(self.queueing.clone()),
            or_unknown(self.tx_queue_len.map(|len| len.to_string())),
            match self.has_echo {
                Some(true) => "when they have left",
                Some(false) => "when they enter the queue",
                None => "at an unknown moment",
            },
        );
        if !self.is_virtual() {
            let (one_shot, errors) = (switch(self.is_one_shot), switch(self.reports_bus_errors));
            told += &format!("; one-shot {one_shot}, berr-reporting {errors}");
        }
        told
    }

    /// Whether a rig can run on it.
    pub(super) fn check(&self, wanted: Option<u32>) -> Result<(), LinkError> {
        let interface = self.name.clone();
        if !self.is_up {
            return Err(LinkError::Down { interface, bit_rate: self.bit_rate_if_down(wanted) });
        }
        if self.state == Some(ControllerState::BusOff) {
            return Err(LinkError::BusOff { interface });
        }
        if self.has_echo == Some(false) && !self.is_virtual() {
            return Err(LinkError::NoEcho { interface, driver: self.driver.clone() });
        }
        match (self.bit_rate, wanted) {
            (Some(has), Some(wanted)) if has != wanted => Err(LinkError::BitRate { interface, has, wanted }),
            _ => Ok(()),
        }
    }
}

/// Returns the CAN interfaces that are there, by name.
pub fn interfaces() -> Vec<String> {
    let Ok(entries) = fs::read_dir("/sys/class/net") else { return Vec::new() };
    let is_can = |entry: &fs::DirEntry| {
        fs::read_to_string(entry.path().join("type")).is_ok_and(|number| number.trim() == TYPE_CAN)
    };
    let mut names: Vec<_> =
        entries.flatten().filter(is_can).map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// Returns the index of an interface, once it is clear that there are CAN sockets at all.
pub(super) fn find(name: &str, wanted: Option<u32>) -> Result<u32, LinkError> {
    // Of no interface in particular.
    CanSocket::open_iface(0).map_err(|source| LinkError::from_open(name, source, interfaces))?;
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
    let mode = |mode| can.ctrl_mode.map(|modes| modes.has_mode(mode));
    let folder = Folder::read(Path::new(NET), name);
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
        is_one_shot: mode(CanCtrlMode::OneShot),
        reports_bus_errors: mode(CanCtrlMode::BerrReporting),
        has_echo: folder.has_echo,
        tx_queue_len: folder.tx_queue_len,
        queueing: queue::discipline(index),
        attachment: folder.attachment,
        driver: folder.driver,
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
            is_one_shot: None,
            reports_bus_errors: None,
            has_echo: Some(true),
            tx_queue_len: Some(0),
            queueing: Some("noqueue".to_owned()),
            attachment: Attachment::Virtual,
            driver: None,
        }
    }

    fn can() -> InterfaceFacts {
        InterfaceFacts {
            name: "can0".to_owned(),
            bit_rate: Some(500_000),
            state: Some(ControllerState::ErrorActive),
            restart_ms: Some(0),
            is_one_shot: Some(false),
            reports_bus_errors: Some(false),
            tx_queue_len: Some(10),
            queueing: Some("pfifo_fast".to_owned()),
            attachment: Attachment::Usb { mbit_per_s: Some(480) },
            driver: Some("gs_usb".to_owned()),
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
    fn a_controller_whose_own_frames_do_not_come_back_is_refused_and_a_virtual_one_is_told_of() {
        let refused = InterfaceFacts { has_echo: Some(false), ..can() }.check(None).unwrap_err();
        assert!(matches!(&refused, LinkError::NoEcho { driver: Some(driver), .. } if driver == "gs_usb"), "{refused}");
        // What is not known is no reason to refuse.
        assert!(InterfaceFacts { has_echo: None, ..can() }.check(None).is_ok());
        let own = InterfaceFacts { has_echo: Some(false), ..vcan() };
        assert!(own.check(None).is_ok());
        assert!(own.advice().concat().contains("sudo modprobe vcan echo=1"));
    }

    #[test]
    fn options_that_lose_frames_or_flood_are_advised_against() {
        let one_shot = InterfaceFacts { is_one_shot: Some(true), ..can() }.advice().concat();
        assert!(
            one_shot.ends_with("`sudo ip link set can0 down && sudo ip link set can0 up type can one-shot off`"),
            "{one_shot}"
        );
        let reporting = InterfaceFacts { reports_bus_errors: Some(true), ..can() }.advice().concat();
        assert!(reporting.contains("up type can berr-reporting off`"), "{reporting}");
    }

    /// Returns the one check that is not as it should be.
    fn only(facts: &InterfaceFacts, wanted: Option<u32>) -> Check {
        let mut bad: Vec<Check> =
            facts.checks(wanted).into_iter().filter(|check| check.verdict >= Verdict::Warning).collect();
        assert_eq!(bad.len(), 1, "{bad:#?}");
        bad.remove(0)
    }

    #[test]
    fn each_planted_trouble_is_found_with_the_command_that_mends_it() {
        let good = InterfaceFacts { sample_point_per_mille: Some(875), ..can() };
        assert!(
            good.checks(Some(500_000)).iter().all(|check| check.verdict == Verdict::Ok),
            "{:#?}",
            good.checks(None)
        );
        let down = "sudo ip link set can0 down && sudo ip link set can0 up type can";
        for (facts, wanted, subject, verdict, fix) in [
            (
                InterfaceFacts { is_up: false, ..good.clone() },
                Some(500_000),
                "interface",
                Verdict::Wrong,
                "sudo ip link set can0 up type can bitrate 500000".to_owned(),
            ),
            (good.clone(), Some(1_000_000), "bit rate", Verdict::Wrong, format!("{down} bitrate 1000000")),
            (
                InterfaceFacts { state: Some(ControllerState::BusOff), ..good.clone() },
                None,
                "controller",
                Verdict::Wrong,
                "sudo ip link set can0 type can restart".to_owned(),
            ),
            (
                InterfaceFacts { tx_queue_len: Some(10_000), ..good.clone() },
                None,
                "queue",
                Verdict::Warning,
                "sudo ip link set can0 txqueuelen 128".to_owned(),
            ),
            (
                InterfaceFacts { sample_point_per_mille: Some(500), ..good.clone() },
                None,
                "sample point",
                Verdict::Warning,
                format!("{down} bitrate 500000 sample-point 0.875"),
            ),
            (
                InterfaceFacts { restart_ms: Some(100), ..good.clone() },
                None,
                "restart",
                Verdict::Warning,
                format!("{down} restart-ms 0"),
            ),
        ] {
            let check = only(&facts, wanted);
            assert_eq!((check.subject, check.verdict, check.fix), (subject, verdict, Some(fix)));
        }
        let no_echo = only(&InterfaceFacts { has_echo: Some(false), ..good.clone() }, None);
        assert_eq!((no_echo.subject, no_echo.verdict, no_echo.fix), ("echo", Verdict::Wrong, None));
    }

    #[test]
    fn what_is_not_known_is_said_to_be_unknown() {
        assert_eq!(
            can().told(),
            "USB at 480 Mbit/s, driver gs_usb; queue pfifo_fast of 10 frames; own frames come back when they have left; \
             one-shot off, berr-reporting off"
        );
        let unknown = InterfaceFacts {
            is_one_shot: None,
            reports_bus_errors: None,
            has_echo: None,
            tx_queue_len: None,
            queueing: None,
            attachment: Attachment::Unknown,
            driver: None,
            ..can()
        };
        assert_eq!(
            unknown.told(),
            "unknown, driver unknown; queue unknown of unknown frames; own frames come back at an unknown moment; one-shot \
             unknown, berr-reporting unknown"
        );
        assert!(unknown.advice().is_empty());
        assert!(!vcan().told().contains("one-shot"));
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
