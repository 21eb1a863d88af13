//! Ethernet frames with EtherCAT datagrams.
//!
//! ```text
//! destination 6 | source 6 | 88A4h | length 11 bits, 0, type 4 bits | datagram | datagram | .. | padding up to 60 bytes
//! datagram: command, index, address 4, length 11 bits | 000 | circulating | more, interrupt 2, data, working counter 2
//! ```
//!
//! # Source
//! ETG.1000.4, 5.3 and 5.4.

use super::{EthercatError, u16_at};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::ops::Range;

/// Bytes before the first datagram: Ethernet header and EtherCAT header.
pub const HEADER: usize = 16;
/// Bytes of a datagram before its data.
pub const DATAGRAM_HEADER: usize = 10;
/// Bytes of the working counter behind the data.
pub const WORKING_COUNTER: usize = 2;
/// Shortest Ethernet frame, without its check sequence.
pub const SHORTEST: usize = 60;
/// Longest Ethernet frame, without its check sequence.
pub const LONGEST: usize = 1514;
/// Bytes on the wire before a frame: preamble and start of frame.
pub const PREAMBLE: usize = 8;
/// Bytes on the wire behind a frame: its check sequence.
pub const CHECK_SEQUENCE: usize = 4;
/// Bytes for which the wire is silent between two frames, at least.
pub const GAP: usize = 12;
/// Time of a byte at 100 Mbit/s, in ns.
pub const BYTE_NS: u64 = 80;
/// Time that a device takes there and back, in ns: that of usual controllers.
pub const DEVICE_NS: u64 = 1000;

const ETHERTYPE: [u8; 2] = [0x88, 0xa4];
const DATAGRAMS: u16 = 1;
const LENGTH: u16 = 0x07ff;
const CIRCULATING: u16 = 1 << 14;
const MORE: u16 = 1 << 15;

/// Set in the first byte of the source address by the first device that a frame passes.
pub const PROCESSED: u8 = 0x02;
/// Set in the first byte of the address of a group.
const GROUP: u8 = 0x01;

/// Source address of a master on a segment where nobody else can be: a simulated one in its own process.
pub const SOURCE: [u8; 6] = [0x10; 6];

/// Returns the source address of a master on an interface, drawn by `random`: the address of one station, without the mark of devices.
///
/// Two masters with one address would take each other's frames for their own.
pub const fn source(random: u64) -> [u8; 6] {
    let [first, second, third, fourth, fifth, sixth, ..] = random.to_le_bytes();
    [first & !(PROCESSED | GROUP), second, third, fourth, fifth, sixth]
}

/// Command of a datagram: its action and its kind of address.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Command {
    /// NOP: nothing.
    Nop = 0,
    /// APRD: read by position.
    Aprd = 1,
    /// APWR: write by position.
    Apwr = 2,
    /// APRW: read and write by position.
    Aprw = 3,
    /// FPRD: read by station address.
    Fprd = 4,
    /// FPWR: write by station address.
    Fpwr = 5,
    /// FPRW: read and write by station address.
    Fprw = 6,
    /// BRD: read from all, their bytes combined by OR.
    Brd = 7,
    /// BWR: write to all.
    Bwr = 8,
    /// BRW: read from all and write to all.
    Brw = 9,
    /// LRD: read process data by logical address.
    Lrd = 10,
    /// LWR: write process data by logical address.
    Lwr = 11,
    /// LRW: read and write process data by logical address.
    Lrw = 12,
    /// ARMW: read from one by position, write what was read to all others.
    Armw = 13,
    /// FRMW: read from one by station address, write what was read to all others.
    Frmw = 14,
}

impl Command {
    /// All commands, ascending.
    pub const ALL: [Command; 15] = {
        use Command::*;
        [Nop, Aprd, Apwr, Aprw, Fprd, Fpwr, Fprw, Brd, Bwr, Brw, Lrd, Lwr, Lrw, Armw, Frmw]
    };

    /// Returns the command of a byte; `None` if the standard defines none.
    pub const fn from_byte(byte: u8) -> Option<Command> {
        if (byte as usize) < Self::ALL.len() { Some(Self::ALL[byte as usize]) } else { None }
    }

    /// Whether devices take over what the datagram holds, or what another device has put into it.
    pub const fn writes(self) -> bool {
        use Command::*;
        matches!(self, Apwr | Aprw | Fpwr | Fprw | Bwr | Brw | Lwr | Lrw | Armw | Frmw)
    }

    /// Whether no device changes the data of the datagram.
    const fn keeps_data(self) -> bool {
        use Command::*;
        matches!(self, Apwr | Fpwr | Bwr | Lwr)
    }

    /// Whether each device that the datagram passes counts its position up.
    const fn counts_up(self) -> bool {
        use Command::*;
        matches!(self, Aprd | Apwr | Aprw | Brd | Bwr | Brw | Armw)
    }

    /// Returns the name, as in the standard.
    pub const fn name(self) -> &'static str {
        const NAMES: [&str; 15] = [
            "NOP", "APRD", "APWR", "APRW", "FPRD", "FPWR", "FPRW", "BRD", "BWR", "BRW", "LRD", "LWR", "LRW", "ARMW",
            "FRMW",
        ];
        NAMES[self as usize]
    }
}

/// The header of a datagram. `address` is that of the wire: position or station in the low word and offset in the high one, or a
/// logical address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DatagramHeader {
    /// Command; not one of [`Command`] if the sender made it up.
    pub command: u8,
    /// Index, which the master chooses and devices leave alone.
    pub index: u8,
    /// Address.
    pub address: u32,
    /// Bytes of data, 0 to 2047.
    pub len: u16,
    /// The frame went round a ring that is open.
    pub is_circulating: bool,
    /// Another datagram follows.
    pub has_more: bool,
    /// Interrupt bits, ORed by all devices.
    pub interrupt: u16,
}

impl DatagramHeader {
    /// Returns the header in ten bytes.
    pub const fn decode(bytes: &[u8; DATAGRAM_HEADER]) -> Self {
        let length = u16::from_le_bytes([bytes[6], bytes[7]]);
        Self {
            command: bytes[0],
            index: bytes[1],
            address: u32::from_le_bytes([bytes[2], bytes[3], bytes[4], bytes[5]]),
            len: length & LENGTH,
            is_circulating: length & CIRCULATING != 0,
            has_more: length & MORE != 0,
            interrupt: u16::from_le_bytes([bytes[8], bytes[9]]),
        }
    }

    /// Returns the ten bytes of the header.
    pub fn encode(&self) -> [u8; DATAGRAM_HEADER] {
        let bit = |is_set: bool, mask: u16| if is_set { mask } else { 0 };
        let length = (self.len & LENGTH) | bit(self.is_circulating, CIRCULATING) | bit(self.has_more, MORE);
        let ([a, b, c, d], [e, f], [g, h]) =
            (self.address.to_le_bytes(), length.to_le_bytes(), self.interrupt.to_le_bytes());
        [self.command, self.index, a, b, c, d, e, f, g, h]
    }

    /// Returns the position or station address: the low word of the address.
    pub const fn adp(&self) -> u16 {
        self.address as u16
    }

    /// Returns the offset in the device: the high word of the address.
    pub const fn ado(&self) -> u16 {
        (self.address >> 16) as u16
    }
}

/// Returns the position or station address, and offset, as one address.
pub const fn address(adp: u16, ado: u16) -> u32 {
    adp as u32 | (ado as u32) << 16
}

/// One datagram that is to be sent; its data stand elsewhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ask {
    /// Command.
    pub command: Command,
    /// Address, as on the wire.
    pub address: u32,
    /// Bytes of data.
    pub len: usize,
}

impl Ask {
    /// Creates a request for a datagram with `len` bytes of data.
    pub const fn new(command: Command, address: u32, len: usize) -> Self {
        Ask { command, address, len }
    }
}

/// Position of a datagram in a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Span {
    /// Header.
    pub header: DatagramHeader,
    /// First byte of the header.
    pub start: usize,
    /// Bytes of the data; the working counter lies behind.
    pub data: Range<usize>,
}

impl Span {
    /// Returns the first byte behind the working counter.
    pub const fn end(&self) -> usize {
        self.data.end + WORKING_COUNTER
    }
}

/// Returns the end of the datagrams of a frame. The length is that in its EtherCAT header, whatever padding follows.
///
/// # Errors
/// If it is not EtherCAT, or shorter than the length in its header.
pub fn end(frame: &[u8]) -> Result<usize, EthercatError> {
    let what = "the frame";
    if frame.len() < HEADER {
        return Err(EthercatError::Short { what, len: frame.len(), needed: HEADER });
    }
    let header = u16_at(frame, 14);
    if frame.get(12..14) != Some(&ETHERTYPE[..]) || header >> 12 != DATAGRAMS {
        return Err(EthercatError::NotEthercat);
    }
    let needed = HEADER + usize::from(header & LENGTH);
    if frame.len() < needed { Err(EthercatError::Short { what, len: frame.len(), needed }) } else { Ok(needed) }
}

/// Returns the datagram that begins at `at` of a frame whose datagrams end at `end`.
///
/// # Errors
/// If it does not end there or before.
pub fn datagram_at(frame: &[u8], at: usize, end: usize) -> Result<Span, EthercatError> {
    let rest = frame.get(at..end).unwrap_or_default();
    let short = |needed| EthercatError::Short { what: "a datagram", len: rest.len(), needed };
    let header = rest.first_chunk().ok_or(short(DATAGRAM_HEADER + WORKING_COUNTER))?;
    let header = DatagramHeader::decode(header);
    let needed = DATAGRAM_HEADER + usize::from(header.len) + WORKING_COUNTER;
    if rest.len() < needed {
        return Err(short(needed));
    }
    let first = at + DATAGRAM_HEADER;
    Ok(Span { header, start: at, data: first..first + usize::from(header.len) })
}

/// One datagram of a frame, to read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Datagram<'a> {
    /// Header.
    pub header: DatagramHeader,
    /// Data.
    pub data: &'a [u8],
    /// Working counter.
    pub working_counter: u16,
}

/// The datagrams of a frame, one after the other; after an error there are no more.
#[derive(Clone, Debug)]
pub struct Datagrams<'a> {
    frame: &'a [u8],
    at: Option<usize>,
    end: usize,
}

impl<'a> Datagrams<'a> {
    /// Returns the datagrams of a frame.
    ///
    /// # Errors
    /// If it is not EtherCAT, or shorter than its header says.
    pub fn of(frame: &'a [u8]) -> Result<Self, EthercatError> {
        Ok(Datagrams { frame, at: Some(HEADER), end: end(frame)? })
    }
}

impl<'a> Iterator for Datagrams<'a> {
    type Item = Result<Datagram<'a>, EthercatError>;

    fn next(&mut self) -> Option<Self::Item> {
        let at = self.at.take()?;
        Some(datagram_at(self.frame, at, self.end).map(|span| {
            self.at = span.header.has_more.then_some(span.end());
            Datagram {
                header: span.header,
                data: self.frame.get(span.data.clone()).unwrap_or_default(),
                working_counter: u16_at(self.frame, span.data.end),
            }
        }))
    }
}

/// Whether a frame is the returned copy of another one. Both have the same datagrams. The addresses are equal, except where devices count
/// them up. The data are equal where devices do not change them.
///
/// Real-time: yes.
pub fn answers(sent: &[u8], got: &[u8]) -> bool {
    let (Ok(mut sent), Ok(mut got)) = (Datagrams::of(sent), Datagrams::of(got)) else { return false };
    loop {
        match (sent.next(), got.next()) {
            (None, None) => return true,
            (Some(Ok(sent)), Some(Ok(got))) if is_same(&sent, &got) => {}
            _ => return false,
        }
    }
}

fn is_same(sent: &Datagram<'_>, got: &Datagram<'_>) -> bool {
    kept(sent) == kept(got) && !got.header.is_circulating
}

/// Returns the parts of a datagram that devices do not change.
fn kept<'a>(datagram: &Datagram<'a>) -> (u8, u8, u32, u16, bool, &'a [u8]) {
    let DatagramHeader { command, index, address, len, has_more, .. } = datagram.header;
    let is = |of: fn(Command) -> bool| Command::from_byte(command).is_some_and(of);
    let address = if is(Command::counts_up) { u32::from(datagram.header.ado()) } else { address };
    let data = if is(Command::keeps_data) { datagram.data } else { &[] };
    (command, index, address, len, has_more, data)
}

/// Returns a number for what devices leave of a frame as it was sent. Frames that [`answers`] takes for one another have one number; other
/// frames have it once in 2^64.
///
/// Real-time: yes.
pub fn digest(frame: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    Datagrams::of(frame).into_iter().flatten().map_while(Result::ok).for_each(|each| kept(&each).hash(&mut hasher));
    hasher.finish()
}

/// Whether a datagram of a frame writes into a device, and how often devices have processed its datagrams in all.
///
/// Real-time: yes.
pub fn effect(frame: &[u8]) -> (bool, u32) {
    let datagrams = Datagrams::of(frame).into_iter().flatten().map_while(Result::ok);
    datagrams.fold((false, 0), |(writes, processed), each| {
        let is_write = Command::from_byte(each.header.command).is_some_and(Command::writes);
        (writes || is_write, processed + u32::from(each.working_counter))
    })
}

/// Writes a frame into a buffer, datagram by datagram.
///
/// Real-time: yes.
#[derive(Debug)]
pub struct FrameWriter<'a> {
    buffer: &'a mut [u8],
    len: usize,
    last: Option<usize>,
}

impl<'a> FrameWriter<'a> {
    /// Creates a frame to all, from a source address.
    ///
    /// # Errors
    /// If the buffer does not hold the headers.
    pub fn new(buffer: &'a mut [u8], source: [u8; 6]) -> Result<Self, EthercatError> {
        let room = buffer.len();
        let start = buffer.first_chunk_mut::<HEADER>();
        let start = start.ok_or(EthercatError::Full { what: "the header", len: HEADER, room })?;
        *start = [0xff; HEADER];
        start[6..12].copy_from_slice(&source);
        start[12..14].copy_from_slice(&ETHERTYPE);
        Ok(FrameWriter { buffer, len: HEADER, last: None })
    }

    /// Adds a datagram with these data, and gives where they lie in the frame.
    ///
    /// # Errors
    /// If there is no room in the buffer or in an Ethernet frame.
    pub fn push(
        &mut self,
        command: Command,
        index: u8,
        address: u32,
        data: &[u8],
    ) -> Result<Range<usize>, EthercatError> {
        let len = DATAGRAM_HEADER + data.len() + WORKING_COUNTER;
        let room = self.buffer.len().min(LONGEST).saturating_sub(self.len);
        let full = EthercatError::Full { what: "a datagram", len, room };
        if len > room {
            return Err(full);
        }
        let header = DatagramHeader {
            command: command as u8,
            index,
            address,
            len: data.len() as u16,
            is_circulating: false,
            has_more: false,
            interrupt: 0,
        };
        let first = self.len + DATAGRAM_HEADER;
        let to = self.buffer.get_mut(self.len..self.len + len).ok_or(full)?;
        let (head, rest) = to.split_at_mut(DATAGRAM_HEADER);
        head.copy_from_slice(&header.encode());
        let (body, counter) = rest.split_at_mut(data.len());
        body.copy_from_slice(data);
        counter.fill(0);
        if let Some(high) = self.last.and_then(|last| self.buffer.get_mut(last + 7)) {
            *high |= (MORE >> 8) as u8;
        }
        self.last = Some(self.len);
        self.len += len;
        Ok(first..first + data.len())
    }

    /// Returns the frame as it is sent, not padded.
    pub fn finish(self) -> &'a mut [u8] {
        let length = (self.len - HEADER) as u16 & LENGTH | DATAGRAMS << 12;
        let frame = self.buffer.get_mut(..self.len).unwrap_or_default();
        if let Some(to) = frame.get_mut(14..16) {
            to.copy_from_slice(&length.to_le_bytes());
        }
        frame
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A broadcast read of one byte, as on the wire.
    const BRD: [u8; 29] = [
        0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x10, 0x10, 0x10, 0x10, 0x10, 0x10, 0x88, 0xa4, 0x0d, 0x10, 0x07, 0x2a,
        0x00, 0x00, 0x30, 0x01, 0x01, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    ];

    #[test]
    fn one_datagram_is_29_bytes() {
        let mut buffer = [0xaa; 64];
        let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]).unwrap();
        assert_eq!(writer.push(Command::Brd, 0x2a, address(0, 0x0130), &[0]), Ok(26..27));
        assert_eq!(*writer.finish(), BRD);
        let read: Vec<_> = Datagrams::of(&BRD).unwrap().collect::<Result<_, _>>().unwrap();
        assert_eq!((read.len(), read[0].header.ado(), read[0].data, read[0].working_counter), (1, 0x130, &[0][..], 0));
    }

    #[test]
    fn of_two_datagrams_the_first_says_that_more_follow() {
        let mut buffer = [0; 128];
        let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]).unwrap();
        writer.push(Command::Frmw, 1, address(0x1000, 0x0910), &[0; 8]).unwrap();
        writer.push(Command::Lrd, 2, 0x0001_0000, &[7; 3]).unwrap();
        let frame = writer.finish();
        assert_eq!(frame[14..16], [0x23, 0x10]);
        assert_eq!(frame[16..26], [14, 1, 0x00, 0x10, 0x10, 0x09, 0x08, 0x80, 0, 0]);
        assert_eq!(frame[36..46], [10, 2, 0x00, 0x00, 0x01, 0x00, 0x03, 0x00, 0, 0]);
        assert_eq!(Datagrams::of(frame).unwrap().count(), 2);
    }

    #[test]
    fn the_length_of_the_header_rules_and_padding_does_not_count() {
        let mut padded = BRD.to_vec();
        padded.resize(60, 0xee);
        assert_eq!(end(&padded), Ok(29));
        assert_eq!(end(&BRD[..28]), Err(EthercatError::Short { what: "the frame", len: 28, needed: 29 }));
        assert_eq!(end(&BRD[..15]), Err(EthercatError::Short { what: "the frame", len: 15, needed: 16 }));
        padded[22] = 2;
        let short = EthercatError::Short { what: "a datagram", len: 13, needed: 14 };
        assert_eq!(Datagrams::of(&padded).unwrap().next(), Some(Err(short)));
        padded[15] = 0x40;
        assert_eq!(end(&padded), Err(EthercatError::NotEthercat));
        padded[13] = 0x00;
        assert_eq!(end(&padded), Err(EthercatError::NotEthercat));
    }

    #[test]
    fn a_frame_holds_1514_bytes() {
        let mut buffer = [0; 2000];
        let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]).unwrap();
        assert_eq!(writer.push(Command::Lrw, 0, 0, &[0; 1486]), Ok(26..1512));
        let full = EthercatError::Full { what: "a datagram", len: 12, room: 0 };
        assert_eq!(writer.push(Command::Nop, 0, 0, &[]), Err(full));
        assert_eq!(writer.finish().len(), LONGEST);
    }

    #[test]
    fn commands_have_the_numbers_of_the_standard() {
        let names = Command::ALL.map(Command::name).join(" ");
        assert_eq!(names, "NOP APRD APWR APRW FPRD FPWR FPRW BRD BWR BRW LRD LWR LRW ARMW FRMW");
        assert!((0..15).all(|byte| Command::from_byte(byte).map(|command| command as u8) == Some(byte)));
        assert_eq!(Command::from_byte(15), None);
    }
}
