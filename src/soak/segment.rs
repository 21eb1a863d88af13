//! Observation of the cable of an EtherCAT segment: the frames of a cycle and the replies to them.
//!
//! Frames are decoded here by the literal layout of ETG.1000.4 and of the shipped profiles; nothing of the master or of the EtherCAT
//! engines is used for it.
//!
//! ```text
//! input frame:   LRD of each device with inputs, the left drive first      output frame:  LWR of each drive, the left one first
//! ```

use super::observation::{Setpoint, Status};

/// Bytes before the first datagram.
const HEADER: usize = 16;
/// Bytes of a datagram before its data, and of the working counter behind it.
const DATAGRAM_HEADER: usize = 10;
const WORKING_COUNTER: usize = 2;
/// The type of EtherCAT.
const ETHERTYPE: [u8; 2] = [0x88, 0xa4];
/// Offset of the source address, and the bit of its first byte that the first device sets.
const SOURCE: usize = 6;
const PROCESSED: u8 = 0x02;
/// LRD and LWR.
const LOGICAL_READ: u8 = 10;
const LOGICAL_WRITE: u8 = 11;
/// Length of the data, whether it went round an open ring, and whether another datagram follows.
const LENGTH: u16 = 0x07ff;
const CIRCULATING: u16 = 0x4000;
const MORE: u16 = 0x8000;

/// Event on the cable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OnCable {
    /// The input frame leaves: a cycle begins.
    Open,
    /// The output frame leaves: the set-point of each drive.
    Outputs([Option<Setpoint>; 2]),
    /// The last input frame is back: the report of each drive that has answered.
    Inputs([Option<Status>; 2]),
    /// The output frame is back that left last: whether each drive has taken what is in it.
    Taken([bool; 2]),
}

/// Something that passed, and when.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OnCableAt {
    /// Time in ns since switching on.
    pub time_ns: u64,
    /// The event.
    pub what: OnCable,
}

/// The frames that left last, to which a reply is compared.
#[derive(Clone, Debug, Default)]
pub(super) struct Segment {
    inputs: Vec<u8>,
    outputs: Vec<u8>,
    /// Whether outputs have left in this cycle: the master sends them once more before SYNC0.
    has_outputs: bool,
}

/// A datagram: header, data, working counter.
struct Datagram<'a> {
    header: &'a [u8],
    data: &'a [u8],
    counter: u16,
}

impl Datagram<'_> {
    fn command(&self) -> u8 {
        self.header.first().copied().unwrap_or_default()
    }

    /// Whether one device has read or written.
    fn is_answered(&self) -> bool {
        self.counter == 1
    }

    /// Whether it is the other one on its way back: command, index, address and length are what they were.
    fn is_back_of(&self, sent: &Self) -> bool {
        let shape = |header: &[u8]| Some((header.get(..6)?.to_vec(), length(header)? & (LENGTH | CIRCULATING | MORE)));
        shape(self.header) == shape(sent.header)
    }
}

/// Returns the word with the length in a header.
fn length(header: &[u8]) -> Option<u16> {
    Some(u16::from_le_bytes([*header.get(6)?, *header.get(7)?]))
}

/// Returns the datagrams of a frame; `None` if it is not an EtherCAT frame or is cut.
fn datagrams(bytes: &[u8]) -> Option<Vec<Datagram<'_>>> {
    if bytes.get(12..14)? != ETHERTYPE {
        return None;
    }
    let mut all = Vec::new();
    let mut at = HEADER;
    loop {
        let header = bytes.get(at..at + DATAGRAM_HEADER)?;
        let length = length(header)?;
        let data = at + DATAGRAM_HEADER;
        let end = data + usize::from(length & LENGTH);
        let counter = bytes.get(end..end + WORKING_COUNTER)?;
        let counter = u16::from_le_bytes([counter[0], counter[1]]);
        all.push(Datagram { header, data: bytes.get(data..end)?, counter });
        if length & MORE == 0 {
            return Some(all);
        }
        at = end + WORKING_COUNTER;
    }
}

/// Returns the data for each drive in the datagrams of `command`: the drives' datagrams are the first two.
fn of_drives<T>(all: &[Datagram<'_>], command: u8, of: impl Fn(&Datagram<'_>) -> T) -> [Option<T>; 2] {
    let mut theirs = all.iter().filter(|datagram| datagram.command() == command).map(of);
    [theirs.next(), theirs.next()]
}

impl Segment {
    /// Classifies a frame that passes the master's end of the cable.
    pub(super) fn see(&mut self, bytes: &[u8]) -> Option<OnCable> {
        let all = datagrams(bytes)?;
        let has = |command| all.iter().any(|datagram| datagram.command() == command);
        let is_sent = bytes.get(SOURCE)? & PROCESSED == 0;
        match (is_sent, has(LOGICAL_READ), has(LOGICAL_WRITE)) {
            (true, true, _) => {
                (self.inputs, self.has_outputs) = (bytes.to_vec(), false);
                Some(OnCable::Open)
            }
            (true, _, true) => {
                let told = |all: &[Datagram<'_>]| {
                    of_drives(all, LOGICAL_WRITE, |datagram| Setpoint::of(datagram.data)).map(Option::flatten)
                };
                let before = datagrams(&self.outputs).map(|before| told(&before));
                if self.has_outputs && before == Some(told(&all)) {
                    return None;
                }
                self.has_outputs = true;
                let told = told(&all);
                self.outputs = bytes.to_vec();
                Some(OnCable::Outputs(told))
            }
            (false, true, _) if is_back(&self.inputs, &all) => {
                let told = |datagram: &Datagram<'_>| Status::of(datagram.data).filter(|_| datagram.is_answered());
                Some(OnCable::Inputs(of_drives(&all, LOGICAL_READ, told).map(Option::flatten)))
            }
            (false, _, true) if is_back(&self.outputs, &all) => {
                let taken = of_drives(&all, LOGICAL_WRITE, |datagram| datagram.is_answered());
                Some(OnCable::Taken(taken.map(Option::unwrap_or_default)))
            }
            _ => None,
        }
    }
}

/// Whether `all` are the datagrams of `sent`, each on its way back.
fn is_back(sent: &[u8], all: &[Datagram<'_>]) -> bool {
    let Some(sent) = datagrams(sent) else { return false };
    sent.len() == all.len() && sent.iter().zip(all).all(|(sent, back)| back.is_back_of(sent))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A frame with these datagrams: command, index, data, working counter.
    fn frame(source: u8, all: &[(u8, u8, &[u8], u16)]) -> Vec<u8> {
        let mut bytes = vec![0xff; SOURCE];
        bytes.extend([source, 0, 0, 0, 0, 1, 0x88, 0xa4, 0, 0x10]);
        for (at, (command, index, data, counter)) in all.iter().enumerate() {
            let more = if at + 1 < all.len() { MORE } else { 0 };
            bytes.extend([*command, *index, 0, 0, at as u8, 0]);
            bytes.extend((data.len() as u16 | more).to_le_bytes());
            bytes.extend([0, 0]);
            bytes.extend(*data);
            bytes.extend(counter.to_le_bytes());
        }
        bytes
    }

    #[test]
    fn literal_frames() {
        let mut segment = Segment::default();
        let none: &[u8] = &[0; 6];
        let inputs = |index, left: &'static [u8], counters: [u16; 2]| {
            let source = if counters == [0; 2] { 0 } else { PROCESSED };
            frame(source, &[(14, 1, &[0; 8], 2), (10, index, left, counters[0]), (10, index, none, counters[1])])
        };
        assert_eq!(segment.see(&inputs(7, &[0; 6], [0; 2])), Some(OnCable::Open));
        let back = |segment: &mut Segment, index, counters| {
            segment.see(&inputs(index, &[0x37, 0x16, 0xff, 0xff, 0xff, 0xff], counters))
        };
        let [left, right] =
            [Status { statusword: 0x1637, position: -1 }, Status { statusword: 0, position: 0 }].map(Some);
        assert_eq!(back(&mut segment, 7, [1, 1]), Some(OnCable::Inputs([left, right])));
        assert_eq!(back(&mut segment, 7, [1, 0]), Some(OnCable::Inputs([left, None])));
        assert_eq!(back(&mut segment, 6, [1, 1]), None, "the reply to an earlier frame");
        let outputs = |source, counters: [u16; 2]| {
            frame(source, &[(11, 9, &[0x0f, 0, 0x18, 0xfc], counters[0]), (11, 9, &[0x06, 0, 0, 0], counters[1])])
        };
        let told = [(0x0f, -1000), (0x06, 0)].map(|(controlword, target)| Some(Setpoint { controlword, target }));
        assert_eq!(segment.see(&outputs(0, [0, 0])), Some(OnCable::Outputs(told)));
        assert_eq!(segment.see(&outputs(PROCESSED, [1, 0])), Some(OnCable::Taken([true, false])));
        assert_eq!(segment.see(&outputs(PROCESSED, [1, 0])[..30]), None, "cut");
        let again = |index| frame(0, &[(11, index, &[0x0f, 0, 0x18, 0xfc], 0), (11, index, &[0x06, 0, 0, 0], 0)]);
        assert_eq!(segment.see(&again(10)), None, "once more in the same cycle");
        let other = frame(0, &[(11, 10, &[0x0f, 0, 0x18, 0xfd], 0), (11, 10, &[0x06, 0, 0, 0], 0)]);
        assert!(matches!(segment.see(&other), Some(OnCable::Outputs(_))), "others in the same cycle");
        segment.see(&inputs(8, &[0; 6], [0; 2]));
        assert_eq!(segment.see(&again(11)), Some(OnCable::Outputs(told)), "in the next cycle");
    }
}
