//! Frames on their way round the segment.

use std::time::Duration;
use yieldwall_fieldbus::ethercat::frame::{self, Command, FrameWriter, answers, digest, effect};

/// Purpose of a frame. At most one frame of each purpose is on its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Inputs of a cycle, with clock and states.
    Inputs,
    /// Outputs of a cycle.
    Outputs,
    /// The outputs of the cycle once more, before the devices act on them.
    Repeat,
    /// A service request besides the cycle.
    Service,
}

impl Purpose {
    /// All of them.
    pub(super) const ALL: [Purpose; 4] = [Purpose::Inputs, Purpose::Outputs, Purpose::Repeat, Purpose::Service];

    /// The word for it, as in *input frame*.
    pub const fn word(self) -> &'static str {
        match self {
            Purpose::Inputs => "input",
            Purpose::Outputs => "output",
            Purpose::Repeat => "repeat",
            Purpose::Service => "service",
        }
    }
}

/// Counts of the frames of a segment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SegmentCounts {
    /// Frames sent.
    pub sent: u64,
    /// Frames that came back in time.
    pub returned: u64,
    /// Frames that were given up.
    pub lost: u64,
    /// Own frames that came back after they were given up, and frames with the own source that write nothing and were not sent.
    pub late: u64,
    /// Own frames that came back once more.
    pub repeated: u64,
    /// Own frames that came back without having passed a device.
    pub unprocessed: u64,
    /// Foreign EtherCAT frames: from another source, or with the own source if they write data that was never sent.
    pub foreign: u64,
}

/// So many of the frames that were given up last are known when they come late.
const GIVEN_UP: usize = 256;
/// Number of returned service frames that are remembered, so that a second copy is recognised.
const RETURNED: usize = 8;

/// Digests of the last `N` frames.
#[derive(Clone, Debug)]
struct Remembered<const N: usize> {
    digests: [Option<u64>; N],
    next: usize,
}

impl<const N: usize> Remembered<N> {
    const NONE: Self = Remembered { digests: [None; N], next: 0 };

    fn note(&mut self, frame: &[u8]) {
        if let Some(place) = self.digests.get_mut(self.next) {
            *place = Some(digest(frame));
        }
        self.next = (self.next + 1) % N;
    }

    fn has(&self, digest: u64) -> bool {
        self.digests.contains(&Some(digest))
    }
}

/// Kind of a frame that has come back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Taken {
    /// The one that was sent for this.
    Reply(Purpose),
    /// A frame with the own source that is no longer awaited.
    Late,
    /// An own one that has come before.
    Again,
    /// A foreign frame, with its source.
    Foreign([u8; 6]),
    /// Nothing to do with EtherCAT, or a frame of ours that passed no device.
    Nothing,
}

/// A frame as it was sent, and whether it is on its way.
#[derive(Clone, Debug)]
struct Row {
    is_out: bool,
    /// Whether it has come back.
    has_come: bool,
    len: usize,
    bytes: Box<[u8; frame::LONGEST]>,
}

impl Row {
    /// The frame as it was sent last.
    fn sent(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or_default()
    }
}

/// The table of frames in flight. A frame that comes back is accepted only if it equals its entry byte for byte, except in the
/// bytes that devices may change.
#[derive(Clone, Debug)]
pub(super) struct Flight {
    source: [u8; 6],
    rows: [Row; Purpose::ALL.len()],
    given_up: Remembered<GIVEN_UP>,
    returned: Remembered<RETURNED>,
    /// Number of the next frame. Its low byte is the index of the first datagram, its high byte that of the others.
    number: u16,
    pub(super) counts: SegmentCounts,
}

impl Flight {
    pub(super) fn new(source: [u8; 6]) -> Self {
        let row = || Row { is_out: false, has_come: false, len: 0, bytes: Box::new([0; frame::LONGEST]) };
        let (given_up, returned) = (Remembered::NONE, Remembered::NONE);
        let counts = SegmentCounts::default();
        Flight { source, rows: Purpose::ALL.map(|_| row()), given_up, returned, number: 0, counts }
    }

    /// Sets the source address of the next frames.
    pub(super) fn set_source(&mut self, source: [u8; 6]) {
        self.source = source;
    }

    fn row(&self, purpose: Purpose) -> &Row {
        let [inputs, outputs, repeat, service] = &self.rows;
        match purpose {
            Purpose::Inputs => inputs,
            Purpose::Outputs => outputs,
            Purpose::Repeat => repeat,
            Purpose::Service => service,
        }
    }

    fn row_mut(&mut self, purpose: Purpose) -> &mut Row {
        let [inputs, outputs, repeat, service] = &mut self.rows;
        match purpose {
            Purpose::Inputs => inputs,
            Purpose::Outputs => outputs,
            Purpose::Repeat => repeat,
            Purpose::Service => service,
        }
    }

    /// Whether a frame is on its way.
    pub(super) fn is_out(&self, purpose: Purpose) -> bool {
        self.row(purpose).is_out
    }

    /// Gives a frame up that has not come back; whether there was one. It is late from now on.
    ///
    /// Real-time: yes.
    pub(super) fn give_up(&mut self, purpose: Purpose) -> bool {
        if !std::mem::take(&mut self.row_mut(purpose).is_out) {
            return false;
        }
        let Flight { rows, given_up, .. } = self;
        rows.get(purpose as usize).into_iter().for_each(|row| given_up.note(row.sent()));
        self.counts.lost += 1;
        true
    }

    /// Builds a frame of datagrams and gives it to be sent; one that is still on its way is given up. Without datagrams nothing is sent.
    ///
    /// Real-time: yes.
    pub(super) fn send(&mut self, purpose: Purpose, add: impl FnOnce(&mut Datagramer<'_>)) -> Option<&[u8]> {
        self.give_up(purpose);
        let [.., service] = &self.rows;
        if purpose == Purpose::Service && service.has_come {
            self.returned.note(service.sent());
        }
        let (number, source) = (self.number, self.source);
        let row = self.row_mut(purpose);
        let mut to = Datagramer { writer: FrameWriter::new(&mut row.bytes[..], source).ok()?, number, count: 0 };
        add(&mut to);
        if to.count == 0 {
            return None;
        }
        row.len = to.writer.finish().len();
        (row.is_out, row.has_come) = (true, false);
        self.number = self.number.wrapping_add(1);
        self.counts.sent += 1;
        Some(self.row(purpose).sent())
    }

    /// Says what a frame is that has come.
    ///
    /// Real-time: yes.
    pub(super) fn take(&mut self, bytes: &[u8]) -> Taken {
        if frame::end(bytes).is_err() {
            return Taken::Nothing;
        }
        let source = source(bytes);
        let [first, others @ ..] = source;
        let [own_first, own_others @ ..] = self.source;
        let is_own = others == own_others && first & !frame::PROCESSED == own_first & !frame::PROCESSED;
        if !is_own || self.counts.sent == 0 {
            self.counts.foreign += 1;
            return Taken::Foreign(source);
        }
        let is_marked = source != self.source;
        for purpose in Purpose::ALL {
            let row = self.row_mut(purpose);
            if row.is_out && answers(row.sent(), bytes) {
                // Some devices count up and do not mark what they pass on.
                if !is_marked && effect(bytes).1 == 0 {
                    self.counts.unprocessed += 1;
                    return Taken::Nothing;
                }
                (row.is_out, row.has_come) = (false, true);
                self.counts.returned += 1;
                return Taken::Reply(purpose);
            }
        }
        if self.rows.iter().any(|row| row.has_come && answers(row.sent(), bytes)) {
            self.counts.repeated += 1;
            return Taken::Again;
        }
        let digest = digest(bytes);
        if self.returned.has(digest) {
            self.counts.repeated += 1;
            return Taken::Again;
        }
        if effect(bytes).0 && !self.given_up.has(digest) {
            self.counts.foreign += 1;
            return Taken::Foreign(source);
        }
        self.counts.late += 1;
        Taken::Late
    }
}

/// The source address of a frame.
fn source(bytes: &[u8]) -> [u8; 6] {
    yieldwall_fieldbus::ethercat::array(bytes, 6)
}

/// Adds datagrams to a frame.
pub(super) struct Datagramer<'a> {
    writer: FrameWriter<'a>,
    number: u16,
    count: usize,
}

impl Datagramer<'_> {
    /// Adds a datagram. If it does not fit, it is left out: the frames of a cycle were measured in advance.
    ///
    /// Real-time: yes.
    pub(super) fn push(&mut self, command: Command, address: u32, data: &[u8]) {
        let [low, high] = self.number.to_le_bytes();
        let index = if self.count == 0 { low } else { high };
        if self.writer.push(command, index, address, data).is_ok() {
            self.count += 1;
        }
    }

    /// Adds one that brings data back.
    ///
    /// Real-time: yes.
    pub(super) fn read(&mut self, command: Command, address: u32, len: usize) {
        const ZEROS: [u8; frame::LONGEST] = [0; frame::LONGEST];
        self.push(command, address, ZEROS.get(..len).unwrap_or_default());
    }
}

/// Time after which a service frame is given up and repeated. Frames go round in microseconds; only a computer that does not look
/// makes them late.
pub(super) const FRAME_WAIT: Duration = Duration::from_millis(10);

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_fieldbus::ethercat::frame::{SOURCE, address};

    fn reply(sent: &[u8]) -> Vec<u8> {
        let mut bytes = sent.to_vec();
        bytes[6] |= frame::PROCESSED;
        bytes
    }

    fn reply_source() -> [u8; 6] {
        let [first, others @ ..] = SOURCE;
        let [a, b, c, d, e] = others;
        [first | frame::PROCESSED, a, b, c, d, e]
    }

    #[test]
    fn a_frame_is_taken_once() {
        let mut flight = Flight::new(SOURCE);
        let brd = |to: &mut Datagramer<'_>| to.read(Command::Brd, address(0, 0x0130), 2);
        let sent = flight.send(Purpose::Service, brd).unwrap().to_vec();
        let mut back = reply(&sent);
        // Two devices have counted up.
        back[18] = 2;
        assert_eq!(flight.take(&sent), Taken::Nothing, "it passed no device");
        assert_eq!(flight.take(&back), Taken::Reply(Purpose::Service));
        assert_eq!(flight.take(&back), Taken::Again);
        let counts = SegmentCounts { sent: 1, returned: 1, repeated: 1, unprocessed: 1, ..SegmentCounts::default() };
        assert_eq!(flight.counts, counts);
    }

    #[test]
    fn a_reply_to_a_frame_that_was_given_up_is_not_that_of_the_next_one() {
        let mut flight = Flight::new(SOURCE);
        let lrd = |to: &mut Datagramer<'_>| {
            to.read(Command::Frmw, address(0x1000, 0x0910), 8);
            to.read(Command::Lrd, 0x1_0000, 6);
        };
        let old = reply(flight.send(Purpose::Inputs, lrd).unwrap());
        // 256 frames later the index of the first datagram is the same.
        let mut new = Vec::new();
        for _ in 0..256 {
            new = reply(flight.send(Purpose::Inputs, lrd).unwrap());
        }
        assert_eq!(new[17], old[17]);
        assert_eq!(flight.take(&old), Taken::Late);
        assert_eq!(flight.take(&new), Taken::Reply(Purpose::Inputs));
        assert_eq!(flight.counts.lost, 256);
    }

    #[test]
    fn what_was_changed_on_the_way_is_not_taken() {
        for (at, bits) in [(16, 1), (18, 1), (20, 4), (22, 1), (22, 0x80)] {
            let mut flight = Flight::new(SOURCE);
            let fprd = |to: &mut Datagramer<'_>| to.read(Command::Fprd, address(0x1000, 0x0130), 6);
            let mut back = reply(flight.send(Purpose::Service, fprd).unwrap());
            back[at] ^= bits;
            let writes = Command::from_byte(back[16]).is_some_and(Command::writes);
            let expected = if writes { Taken::Foreign(reply_source()) } else { Taken::Late };
            assert_eq!(flight.take(&back), expected, "byte {at}");
        }
    }

    #[test]
    fn data_that_devices_leave_alone_come_back_as_they_were_sent() {
        // Logical and physical writes keep their data; what devices read into, and what one gives to all others, changes.
        for (command, is_kept) in [
            (Command::Lwr, true),
            (Command::Fpwr, true),
            (Command::Apwr, true),
            (Command::Bwr, true),
            (Command::Lrw, false),
            (Command::Frmw, false),
            (Command::Fprd, false),
        ] {
            let mut flight = Flight::new(SOURCE);
            let sent = |to: &mut Datagramer<'_>| to.push(command, address(0x1000, 0x0420), &[50, 0]);
            let mut back = reply(flight.send(Purpose::Service, sent).unwrap());
            back[26] = 0;
            let expected = if is_kept { Taken::Foreign(reply_source()) } else { Taken::Reply(Purpose::Service) };
            assert_eq!(flight.take(&back), expected, "{}", command.name());
            assert_eq!(flight.is_out(Purpose::Service), is_kept, "the own frame is still waited for");
        }
    }

    #[test]
    fn what_writes_and_was_never_sent_is_foreign_and_what_was_given_up_is_late_once() {
        let outputs = |target: u8| move |to: &mut Datagramer<'_>| to.push(Command::Lwr, 0x1_0000, &[0x0f, 0, target]);
        let mut flight = Flight::new(SOURCE);
        let old = reply(flight.send(Purpose::Outputs, outputs(1)).unwrap());
        let new = reply(flight.send(Purpose::Outputs, outputs(2)).unwrap());
        assert_eq!(flight.take(&new), Taken::Reply(Purpose::Outputs));
        assert_eq!(flight.take(&old), Taken::Late, "it was given up when the next one was sent");
        let mut forged = new.clone();
        forged[17] = 0x77;
        assert_eq!(flight.take(&forged), Taken::Foreign(reply_source()));
        flight.send(Purpose::Outputs, outputs(3)).unwrap();
        assert_eq!(flight.take(&new), Taken::Foreign(reply_source()), "outputs of a cycle before");
        // A frame that reads alone moves nothing.
        let mut read = forged;
        read[16] = Command::Lrd as u8;
        assert_eq!(flight.take(&read), Taken::Late);
        let counts = SegmentCounts { sent: 3, returned: 1, lost: 1, late: 2, foreign: 2, ..SegmentCounts::default() };
        assert_eq!(flight.counts, counts);
    }

    #[test]
    fn a_device_that_counts_and_does_not_mark_has_processed_the_frame() {
        let mut flight = Flight::new(SOURCE);
        let brd = |to: &mut Datagramer<'_>| to.read(Command::Brd, address(0, 0x0130), 2);
        let mut back = flight.send(Purpose::Service, brd).unwrap().to_vec();
        assert_eq!(flight.take(&back), Taken::Nothing, "a plug that leads the frame back");
        back[28] = 1;
        assert_eq!(flight.take(&back), Taken::Reply(Purpose::Service));
    }

    #[test]
    fn before_anything_was_sent_all_frames_are_somebody_elses() {
        let mut flight = Flight::new(SOURCE);
        let mut other = Flight::new(SOURCE);
        let brd = |to: &mut Datagramer<'_>| to.read(Command::Brd, 0, 1);
        let bytes = other.send(Purpose::Service, brd).unwrap().to_vec();
        assert_eq!(flight.take(&bytes), Taken::Foreign(SOURCE));
        assert_eq!(flight.take(&bytes[..20]), Taken::Nothing);
        assert_eq!(flight.take(&[]), Taken::Nothing);
    }
}
