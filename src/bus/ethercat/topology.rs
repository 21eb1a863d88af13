//! Topology and delays of a segment: the devices behind each port, and the time that a frame takes to each device. Both follow
//! from the moments at which one frame passed the ports.

/// Ports in the order in which a frame leaves them; it comes in at the first.
const ORDER: [usize; 4] = [0, 3, 1, 2];
/// Longest delay that can be, in ns: more than 100 km of cable.
const MOST_NS: u32 = 1_000_000;

/// Ports of one device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ports {
    /// DL status, 0110h: bits 4 to 7 say which ports have a link.
    pub links: u16,
    /// Whether it has a clock, and so `times`.
    pub has_clock: bool,
    /// Receive times of the ports, 0900h to 090Fh, in ns of its own clock, modulo 2^32.
    pub times: [u32; 4],
}

impl Ports {
    /// Ports with a link, a bit each.
    pub(super) fn linked(&self) -> u8 {
        (self.links >> 4) as u8 & 0xf
    }

    fn is_linked(&self, port: usize) -> bool {
        self.links & 0x10 << port != 0
    }

    /// Time from the moment at which the frame came back into one port, or came to the device, to that at another.
    fn between(&self, from: usize, to: usize) -> u32 {
        let time = |port: usize| self.times.get(port).copied().unwrap_or_default();
        time(to).wrapping_sub(time(from))
    }
}

/// A port behind which a device is: the device that it is of, the port at which the frame was before, and the port.
#[derive(Clone, Copy, Debug)]
struct Attachment {
    parent: usize,
    before: usize,
    port: usize,
}

/// Delay of each device from the first one that has a clock, in ns, in the order of positions; `None` without a clock.
///
/// Returns the delay of each device. A frame goes out at each port and comes back into it before it goes out at the next. The
/// time for this, less the time that the device behind the port needs for the devices behind itself, is twice the delay to that
/// device.
///
/// # Errors
/// The first device whose ports do not fit those before it.
pub fn delays(devices: &[Ports]) -> Result<Vec<Option<u32>>, usize> {
    let mut delays: Vec<Option<u32>> = Vec::with_capacity(devices.len());
    // Ports that nobody was found behind yet, the next one last.
    let mut open: Vec<Option<Attachment>> = vec![None];
    for (place, ports) in devices.iter().enumerate() {
        let attachment = open.pop().ok_or(place)?;
        if !ports.is_linked(0) {
            return Err(place);
        }
        let mut last = 0;
        let mut behind = Vec::with_capacity(3);
        for port in ORDER.into_iter().skip(1).filter(|port| ports.is_linked(*port)) {
            // A device without a clock is taken for a piece of cable.
            let here = Attachment { parent: place, before: last, port };
            behind.push(if ports.has_clock { Some(here) } else { attachment });
            last = port;
        }
        open.extend(behind.into_iter().rev());
        let delay = match attachment.and_then(|it| Some((it, devices.get(it.parent)?, (*delays.get(it.parent)?)?))) {
            None => 0,
            Some((Attachment { before, port, .. }, parent, delay)) => {
                let there_and_back = parent.between(before, port);
                let own = if last == 0 { 0 } else { ports.between(0, last) };
                let way = there_and_back.saturating_sub(own) / 2;
                delay.saturating_add(parent.between(0, before)).saturating_add(way)
            }
        };
        if ports.has_clock && delay > MOST_NS {
            return Err(place);
        }
        delays.push(ports.has_clock.then_some(delay));
    }
    Ok(delays)
}

/// Positions of devices: from the first one to the one before the last.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Behind {
    pub(super) from: u16,
    pub(super) to: u16,
}

impl Behind {
    /// Whether a position is among them.
    pub(super) fn has(self, position: u16) -> bool {
        (self.from..self.to).contains(&position)
    }
}

/// The device before each one and the port of that device, in the order of positions; `None` for the first device. The list ends before the
/// first device whose ports do not fit those before it.
pub fn parents(devices: &[Ports]) -> Vec<Option<(usize, usize)>> {
    let mut parents = Vec::with_capacity(devices.len());
    let mut open: Vec<Option<(usize, usize)>> = vec![None];
    for (place, ports) in devices.iter().enumerate() {
        let Some(parent) = open.pop() else { break };
        parents.push(parent);
        open.extend(
            ORDER.into_iter().skip(1).rev().filter(|port| ports.is_linked(*port)).map(|port| Some((place, port))),
        );
    }
    parents
}

/// The devices behind each port of each device, in the order of positions; behind port 0 that is the device itself and all that a frame
/// reaches through it. Devices whose ports do not fit those before them are behind none.
pub(super) fn behind(devices: &[Ports]) -> Vec<[Behind; 4]> {
    let mut all = vec![[Behind::default(); 4]; devices.len()];
    let parents = parents(devices);
    for place in 0..parents.len() {
        let mut reached = Some((place, 0));
        while let Some((device, port)) = reached {
            let mut extend = |port: usize| {
                if let Some(span) = all.get_mut(device).and_then(|spans| spans.get_mut(port)) {
                    span.from = if span.to == 0 { place as u16 } else { span.from };
                    span.to = place as u16 + 1;
                }
            };
            extend(port);
            if port != 0 {
                extend(0);
            }
            reached = parents.get(device).copied().flatten();
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ports(links: &[usize], times: [u32; 4]) -> Ports {
        let links = links.iter().fold(0, |links, port| links | 0x10 << port);
        Ports { links, has_clock: true, times }
    }

    #[test]
    fn a_line_of_three() {
        let start = u32::MAX - 500;
        let line = [
            ports(&[0, 1], [7, 2007, 0, 0]),
            // Its clock goes round meanwhile.
            ports(&[0, 1], [start, start.wrapping_add(1000), 0, 0]),
            ports(&[0], [99, 0, 0, 0]),
        ];
        assert_eq!(delays(&line), Ok(vec![Some(0), Some(500), Some(1000)]));
    }

    #[test]
    fn a_device_without_a_clock_is_a_piece_of_cable() {
        let bare = Ports { has_clock: false, ..ports(&[0, 1], [0; 4]) };
        let line = [bare, ports(&[0, 1], [0, 3000, 0, 0]), bare, ports(&[0], [0; 4])];
        assert_eq!(delays(&line), Ok(vec![None, Some(0), None, Some(1500)]));
    }

    #[test]
    fn a_junction_is_left_at_port_3_first() {
        // 400 there and back at port 3, then 1000 at port 1, behind which another one is 300 away.
        let tree = [
            ports(&[0, 1, 3], [0, 1400, 0, 400]),
            ports(&[0], [0; 4]),
            ports(&[0, 1], [0, 300, 0, 0]),
            ports(&[0], [0; 4]),
        ];
        assert_eq!(delays(&tree), Ok(vec![Some(0), Some(200), Some(400 + 350), Some(750 + 150)]));
    }

    #[test]
    fn behind_a_port_is_a_range_of_positions() {
        let device = |links: &[usize]| ports(links, [0; 4]);
        // 0 has 1 at port 3, and behind port 1 comes 2 with 3 at port 1.
        let tree = [device(&[0, 1, 3]), device(&[0]), device(&[0, 1]), device(&[0])];
        let spans = |from, to| Behind { from, to };
        let none = Behind::default();
        let expected = [
            [spans(0, 4), spans(2, 4), none, spans(1, 2)],
            [spans(1, 2), none, none, none],
            [spans(2, 4), spans(3, 4), none, none],
            [spans(3, 4), none, none, none],
        ];
        assert_eq!(behind(&tree), expected);
        assert_eq!(parents(&tree), [None, Some((0, 3)), Some((0, 1)), Some((2, 1))]);
        assert_eq!(parents(&[device(&[0]), device(&[0])]), [None], "nothing is behind the first one");
        assert_eq!(behind(&[device(&[0]), device(&[0])])[1], [none; 4], "nothing is behind the first one");
    }

    #[test]
    fn ports_that_do_not_fit_are_told() {
        let leaf = ports(&[0], [0; 4]);
        assert_eq!(delays(&[leaf, leaf]), Err(1), "nothing is behind the first one");
        assert_eq!(delays(&[ports(&[1], [0; 4])]), Err(0), "it was put in the wrong way round");
        assert_eq!(delays(&[ports(&[0, 1], [0, 3_000_000, 0, 0]), leaf]), Err(1), "300 km");
    }

    proptest! {
        #[test]
        fn any_registers_are_survived(raw in proptest::collection::vec((any::<u16>(), any::<bool>(), any::<[u32; 4]>()), 0..40)) {
            let devices: Vec<_> = raw.into_iter().map(|(links, has_clock, times)| Ports { links, has_clock, times }).collect();
            prop_assert_eq!(behind(&devices).len(), devices.len());
            if let Ok(delays) = delays(&devices) {
                prop_assert_eq!(delays.len(), devices.len());
                prop_assert!(delays.iter().flatten().all(|delay| *delay <= MOST_NS));
            }
        }
    }
}
