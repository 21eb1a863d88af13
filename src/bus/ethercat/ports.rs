//! Links and error counters of the ports of all devices, read beside the cycle.

use super::flight::Datagramer;
use super::service_address;
use super::station::FIRST_STATION;
use super::topology::{self, Behind, Ports};
use yieldwall_fieldbus::ethercat::frame::{Command, Datagrams};
use yieldwall_fieldbus::ethercat::{registers as register, u16_at};

/// Devices that are read in one frame.
const AT_ONCE: usize = 16;
/// Cycles from one frame to the next: a counter that grows is then never seen in two cycles in a row, as a lost link is.
const EVERY: u8 = 4;
/// Bytes from the receive errors to the lost links.
const COUNTERS: usize = 20;
/// First of the lost links in them; before it two bytes a port are of receive errors, the rest is of other places.
const LOST_LINKS: usize = (register::LOST_LINK - register::RX_ERROR) as usize;
/// Registers read from a device.
const READS: [(u16, usize); 2] = [(register::DL_STATUS, 2), (register::RX_ERROR, COUNTERS)];
/// Ports of a device.
pub(super) const PORTS: usize = 4;

/// One device of the segment.
#[derive(Clone, Copy, Debug, Default)]
struct Watched {
    /// Ports that had a link when the segment was brought up, a bit each.
    linked: u8,
    /// Ports whose link was lost since, a bit each.
    lost: u8,
    /// Counters as they were read last.
    counters: Option<[u8; COUNTERS]>,
    /// Damaged frames that each port has counted since.
    errors: [u32; PORTS],
    behind: [Behind; PORTS],
}

/// News from one read of the ports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shown {
    /// A port of the device at this position counts more damaged frames than before.
    Errors(u16),
    /// Nothing at these positions is reached any more.
    Lost(Behind),
}

/// Bytes of data of the datagrams of the longest frame that reads the ports of so many devices.
pub(super) fn reads(devices: usize) -> impl Iterator<Item = usize> {
    (0..devices.min(AT_ONCE)).flat_map(|_| READS.map(|(_, len)| len))
}

/// All devices of a segment.
#[derive(Clone, Debug, Default)]
pub(super) struct PortWatch {
    devices: Vec<Watched>,
    first: usize,
    cycles: u8,
    is_urgent: bool,
}

impl PortWatch {
    /// The ports of a segment that has just been brought up.
    pub(super) fn new(ports: &[Ports]) -> Self {
        let behind = topology::behind(ports);
        let device = |(ports, behind): (&Ports, [Behind; PORTS])| Watched {
            linked: ports.linked(),
            behind,
            ..Watched::default()
        };
        PortWatch { devices: ports.iter().zip(behind).map(device).collect(), ..PortWatch::default() }
    }

    /// A device at this position does not answer any more: the next frame is for the ports around it.
    ///
    /// Real-time: yes.
    pub(super) fn hurry(&mut self, position: u16) {
        self.is_urgent = true;
        self.first = usize::from(position.saturating_sub(1)) / AT_ONCE * AT_ONCE;
    }

    /// Begins a cycle; whether it is one in which ports are read.
    ///
    /// Real-time: yes.
    pub(super) fn is_due(&mut self) -> bool {
        self.cycles = (self.cycles + 1) % EVERY;
        !self.devices.is_empty() && (self.is_urgent || self.cycles == 0)
    }

    /// The devices that are read next, from this one on.
    ///
    /// Real-time: yes.
    pub(super) fn take_turn(&mut self) -> usize {
        let first = if self.first < self.devices.len() { self.first } else { 0 };
        (self.first, self.is_urgent) = (first + AT_ONCE, false);
        first
    }

    /// Adds the datagrams that read the devices from `first` on.
    ///
    /// Real-time: yes.
    pub(super) fn ask(&self, first: usize, to: &mut Datagramer<'_>) {
        for position in (first..self.devices.len()).take(AT_ONCE) {
            let station = FIRST_STATION + position as u16;
            for (register, len) in READS {
                to.read(Command::Fprd, service_address(station, register), len);
            }
        }
    }

    /// Takes what has come back of them, and gives what that shows. A device that does not answer shows nothing itself.
    ///
    /// Real-time: yes.
    pub(super) fn take(&mut self, first: usize, mut datagrams: Datagrams<'_>, mut show: impl FnMut(Shown)) {
        let mut next = || datagrams.next().and_then(Result::ok);
        for (position, device) in self.devices.iter_mut().enumerate().skip(first).take(AT_ONCE) {
            let (Some(status), Some(counters)) = (next(), next()) else { return };
            if status.working_counter == 0 || counters.working_counter == 0 {
                continue;
            }
            let links = Ports { links: u16_at(status.data, 0), ..Ports::default() }.linked();
            let now: [u8; COUNTERS] = yieldwall_fieldbus::ethercat::array(counters.data, 0);
            let before = device.counters.replace(now).unwrap_or(now);
            let count = |bytes: &[u8; COUNTERS], at: usize| bytes.get(at).copied().unwrap_or_default();
            let grown = |at: usize| count(&now, at).saturating_sub(count(&before, at));
            let mut is_counted = false;
            for (port, errors) in device.errors.iter_mut().enumerate() {
                let (bit, damaged) = (1 << port, [2 * port, 2 * port + 1].map(grown));
                let more = damaged.into_iter().map(u32::from).sum::<u32>();
                *errors = errors.saturating_add(more);
                is_counted |= more > 0;
                // A link that was away for a moment has cut off what is behind it for as long.
                let is_lost = device.linked & bit != 0 && (links & bit == 0 || grown(LOST_LINKS + port) > 0);
                if is_lost && device.lost & bit == 0 {
                    device.lost |= bit;
                    show(Shown::Lost(device.behind.get(port).copied().unwrap_or_default()));
                }
            }
            if is_counted {
                show(Shown::Errors(position as u16));
            }
        }
    }

    /// Ports that have lost their link: position, port, and what is behind it.
    pub(super) fn lost(&self) -> impl Iterator<Item = (u16, usize, Behind)> {
        let of = |(position, device): (usize, &Watched)| {
            let ports = device.behind.into_iter().enumerate().filter({
                let lost = device.lost;
                move |(port, _)| lost & 1 << port != 0
            });
            ports.map(move |(port, behind)| (position as u16, port, behind))
        };
        self.devices.iter().enumerate().flat_map(of)
    }

    /// Ports that have counted damaged frames: position, port, and how many.
    pub(super) fn errors(&self) -> impl Iterator<Item = (u16, usize, u32)> {
        let of = |(position, device): (usize, &Watched)| {
            let ports = device.errors.into_iter().enumerate().filter(|(_, errors)| *errors > 0);
            ports.map(move |(port, errors)| (position as u16, port, errors))
        };
        self.devices.iter().enumerate().flat_map(of)
    }
}
