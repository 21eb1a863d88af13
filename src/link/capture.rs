//! Frames of all buses of a rig in one file of [pcapng](https://www.ietf.org/archive/id/draft-ietf-opsawg-pcapng-03.html), which Wireshark
//! reads.

use std::io::{self, ErrorKind, Read, Write};

use super::Packet;
use yieldwall_fieldbus::canopen::Frame;
use yieldwall_fieldbus::time::Time;

/// Types of blocks.
const SECTION: u32 = 0x0a0d_0d0a;
const INTERFACE: u32 = 1;
const PACKET: u32 = 6;

/// Link types of the registry of tcpdump.
const ETHERNET: u16 = 1;
const SOCKET_CAN: u16 = 227;

/// Options: of a section the program, of an interface name, description and resolution of time.
const PROGRAM: u16 = 4;
const NAME: u16 = 2;
const DESCRIPTION: u16 = 3;
const RESOLUTION: u16 = 9;
/// Times in powers of ten: nanoseconds.
const NANOSECONDS: u8 = 9;

/// Bit of the identifier in the form of SocketCAN.
const REMOTE: u32 = 0x4000_0000;

/// A bus of a rig in a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CapturedBus<'a> {
    /// Its name in the rig.
    pub name: &'a str,
    /// Whether it is an EtherCAT segment, and not CAN.
    pub is_segment: bool,
    /// The interface of this computer that was its.
    pub interface: Option<&'a str>,
}

/// Writes frames of the buses of a rig, an interface of the file each, with times in ns.
///
/// Times are virtual and start at 0. There is no date in the file, so that the same frames give the same bytes.
#[derive(Debug)]
pub struct CaptureWriter<W> {
    out: W,
    block: Vec<u8>,
}

impl<W: Write> CaptureWriter<W> {
    /// Returns a capture of these buses, in the order of their numbers. `out` should be buffered.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn new<'a>(out: W, buses: impl IntoIterator<Item = CapturedBus<'a>>) -> io::Result<Self> {
        let mut capture = Self { out, block: Vec::new() };
        capture.begin(&MAGIC);
        capture.block.extend([1, 0, 0, 0]);
        // Of a length that is not known before.
        capture.block.extend((-1_i64).to_le_bytes());
        capture.option(PROGRAM, concat!("yieldwall ", env!("CARGO_PKG_VERSION")).as_bytes());
        capture.end_options();
        capture.end(SECTION)?;
        for bus in buses {
            capture.begin(&if bus.is_segment { ETHERNET } else { SOCKET_CAN }.to_le_bytes());
            // No frame is cut.
            capture.block.extend([0; 6]);
            capture.option(NAME, bus.name.as_bytes());
            bus.interface.iter().for_each(|interface| capture.option(DESCRIPTION, interface.as_bytes()));
            capture.option(RESOLUTION, &[NANOSECONDS]);
            capture.end_options();
            capture.end(INTERFACE)?;
        }
        Ok(capture)
    }

    /// Appends one frame.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn record(&mut self, time: Time, packet: Packet<'_>) -> io::Result<()> {
        let (bus, length) = match packet {
            Packet::Can(frame) => (frame.bus(), CAN_HEADER + frame.data().len()),
            Packet::Ethernet { bus, bytes } => (bus, bytes.len()),
        };
        self.begin(&(bus.index() as u32).to_le_bytes());
        for word in [(time.0 >> 32) as u32, time.0 as u32, length as u32, length as u32] {
            self.block.extend(word.to_le_bytes());
        }
        match packet {
            Packet::Can(frame) => self.put_can(frame),
            Packet::Ethernet { bytes, .. } => self.block.extend(bytes),
        }
        self.pad();
        self.end(PACKET)
    }

    /// Hands what was appended on to the writer's end.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    fn put_can(&mut self, frame: &Frame) {
        let remote = if frame.is_remote() { REMOTE } else { 0 };
        self.block.extend((u32::from(frame.id()) | remote).to_be_bytes());
        self.block.extend([frame.length_code(), 0, 0, 0]);
        self.block.extend(frame.data());
    }

    fn begin(&mut self, bytes: &[u8]) {
        self.block.clear();
        self.block.extend(bytes);
    }

    fn option(&mut self, code: u16, value: &[u8]) {
        self.block.extend(code.to_le_bytes());
        self.block.extend((value.len() as u16).to_le_bytes());
        self.block.extend(value);
        self.pad();
    }

    fn end_options(&mut self) {
        self.block.extend([0; 4]);
    }

    /// Fills up to a multiple of four bytes.
    fn pad(&mut self) {
        self.block.resize(self.block.len().next_multiple_of(4), 0);
    }

    fn end(&mut self, kind: u32) -> io::Result<()> {
        let length = (self.block.len() as u32 + 12).to_le_bytes();
        self.out.write_all(&kind.to_le_bytes())?;
        self.out.write_all(&length)?;
        self.out.write_all(&self.block)?;
        self.out.write_all(&length)
    }
}

/// Bytes before the data of a CAN frame.
const CAN_HEADER: usize = 8;

/// Byte-order magic of a section, as this computer writes it.
const MAGIC: [u8; 4] = 0x1a2b_3c4d_u32.to_le_bytes();
/// Bytes of a block without content: its type, and its length before and behind.
const EMPTY_BLOCK: u32 = 12;
/// Longest block that is believed, in bytes: far above that of the longest frame.
const LONGEST_BLOCK: u32 = 1 << 20;

/// The begin of a file that is whole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Whole {
    /// Length of the whole begin in bytes.
    pub bytes: u64,
    /// Frames in it.
    pub frames: u64,
}

/// Finds out how far a capture consists of whole blocks. `file` should be buffered.
///
/// # Errors
/// `InvalidData` if it begins as no capture of this program does, and those of the reader.
pub fn whole_blocks(mut file: impl Read) -> io::Result<Whole> {
    let (mut whole, mut block) = (Whole::default(), Vec::new());
    loop {
        block.clear();
        file.by_ref().take(8).read_to_end(&mut block)?;
        let Some(length) = word(&block, 4) else { break };
        if !(EMPTY_BLOCK..=LONGEST_BLOCK).contains(&length) || !length.is_multiple_of(4) {
            break;
        }
        file.by_ref().take(u64::from(length) - 8).read_to_end(&mut block)?;
        if word(&block, length as usize - 4) != Some(length) {
            break;
        }
        let kind = word(&block, 0);
        if whole.bytes == 0 && (kind, block.get(8..12)) != (Some(SECTION), Some(&MAGIC[..])) {
            return Err(io::Error::new(ErrorKind::InvalidData, "it begins as no capture of this program does"));
        }
        whole.bytes += u64::from(length);
        whole.frames += u64::from(kind == Some(PACKET));
    }
    Ok(whole)
}

/// Returns a word at a place of a block, if the block is so long.
fn word(block: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(*block.get(at..)?.first_chunk()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_fieldbus::canopen::BusId;

    /// Each block: type and content; the length stands before and behind it.
    fn blocks(mut file: &[u8]) -> Vec<(u32, Vec<u8>)> {
        let word = |bytes: &[u8]| u32::from_le_bytes(bytes[..4].try_into().unwrap());
        let mut blocks = Vec::new();
        while !file.is_empty() {
            let length = word(&file[4..]) as usize;
            assert_eq!((length % 4, word(&file[length - 4..]) as usize), (0, length));
            blocks.push((word(file), file[8..length - 4].to_vec()));
            file = &file[length..];
        }
        blocks
    }

    #[test]
    fn a_capture_has_an_interface_for_each_bus_and_frames_in_the_form_of_their_links() {
        let mut file = Vec::new();
        let buses = [("main", true, None), ("sensor", false, Some("can0"))];
        let buses = buses.map(|(name, is_segment, interface)| CapturedBus { name, is_segment, interface });
        let mut capture = CaptureWriter::new(&mut file, buses).unwrap();
        let bytes = [7; 61];
        capture.record(Time(5_000_000_001), Packet::Ethernet { bus: BusId::FIRST, bytes: &bytes }).unwrap();
        let on_sensor = BusId::new(1);
        capture.record(Time(2), Packet::Can(&Frame::new(0x181, &[1, 2, 3]).on_bus(on_sensor))).unwrap();
        capture.record(Time(3), Packet::Can(&Frame::remote(0x705, 1).on_bus(on_sensor))).unwrap();
        let blocks = blocks(&file);
        assert_eq!(blocks.iter().map(|(kind, _)| *kind).collect::<Vec<_>>(), [SECTION, 1, 1, 6, 6, 6]);
        assert_eq!(blocks[0].1[..16], [0x4d, 0x3c, 0x2b, 0x1a, 1, 0, 0, 0, 255, 255, 255, 255, 255, 255, 255, 255]);
        assert_eq!(
            blocks[1].1,
            [&[1, 0, 0, 0, 0, 0, 0, 0, 2, 0, 4, 0][..], b"main", &[9, 0, 1, 0, 9, 0, 0, 0, 0, 0, 0, 0]].concat()
        );
        let interface =
            [&[227, 0, 0, 0, 0, 0, 0, 0, 2, 0, 6, 0][..], b"sensor\0\0", &[3, 0, 4, 0], b"can0", &[9, 0, 1, 0, 9]];
        assert!(blocks[2].1.starts_with(&interface.concat()), "{:02x?}", blocks[2].1);
        // Times have a high and a low word.
        let head = [[0, 0, 0, 0], [1, 0, 0, 0], 705_032_705_u32.to_le_bytes(), [61, 0, 0, 0], [61, 0, 0, 0]].concat();
        assert_eq!(blocks[3].1, [&head[..], &bytes, &[0; 3]].concat());
        let can = [[1, 0, 0, 0], [0, 0, 0, 0], [2, 0, 0, 0], [11, 0, 0, 0], [11, 0, 0, 0], [0, 0, 1, 0x81]].concat();
        assert_eq!(blocks[4].1, [&can[..], &[3, 0, 0, 0, 1, 2, 3, 0]].concat());
        assert_eq!(blocks[5].1[20..], [0x40, 0, 7, 5, 1, 0, 0, 0]);
    }

    /// Returns a capture with a frame of a segment and two of CAN, and where each block ends.
    fn captured() -> (Vec<u8>, Vec<usize>) {
        let mut file = Vec::new();
        let buses = ["main", "sensor"].map(|name| CapturedBus { name, is_segment: name == "main", interface: None });
        let mut capture = CaptureWriter::new(&mut file, buses).unwrap();
        for time in 0..2 {
            capture.record(Time(time), Packet::Ethernet { bus: BusId::FIRST, bytes: &[7; 61] }).unwrap();
            let frame = Frame::new(0x181, &[1, 2, 3]).on_bus(BusId::new(1));
            capture.record(Time(time), Packet::Can(&frame)).unwrap();
        }
        let mut ends = vec![0];
        ends.extend(blocks(&file).iter().scan(0, |end, (_, content)| {
            *end += content.len() + 12;
            Some(*end)
        }));
        (file, ends)
    }

    #[test]
    fn a_capture_that_is_cut_at_any_byte_is_whole_up_to_its_last_whole_block() {
        let (file, ends) = captured();
        assert_eq!((ends.len(), *ends.last().unwrap()), (8, file.len()));
        for cut in 0..=file.len() {
            let blocks = ends.iter().rposition(|end| *end <= cut).unwrap();
            // The section and two interfaces come first.
            let expected = Whole { bytes: ends[blocks] as u64, frames: blocks.saturating_sub(3) as u64 };
            assert_eq!(whole_blocks(&file[..cut]).unwrap(), expected, "cut at {cut}");
        }
    }

    #[test]
    fn no_length_is_believed_before_the_same_one_stands_behind_it() {
        let (file, ends) = captured();
        let begin = |bytes| Whole { bytes, frames: 1 };
        for (at, byte) in [(ends[4] + 4, 0), (ends[4] + 4, 1), (ends[4] + 7, 0xff), (ends[5] - 1, 9), (ends[5] - 4, 8)]
        {
            let mut damaged = file.clone();
            damaged[at] = byte;
            assert_eq!(whole_blocks(&damaged[..]).unwrap(), begin(ends[4] as u64), "{byte} at {at}");
        }
        let mut other = file.clone();
        other[8..12].reverse();
        for other in [&other[..], &file[ends[1]..]] {
            assert_eq!(whole_blocks(other).unwrap_err().kind(), ErrorKind::InvalidData);
        }
    }
}
