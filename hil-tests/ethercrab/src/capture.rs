//! Frames in a file of pcap (libpcap's format 2.4, link type Ethernet, nanoseconds), which Wireshark reads.

use std::io::{self, Write};

use yieldwall::time::Time;

/// The frames of Ethernet in a file: of pcap of either resolution of time, or of pcapng, whose other frames are left out.
///
/// # Errors
/// If it is no little-endian capture of Ethernet, or ends within a frame.
pub fn read(bytes: &[u8]) -> io::Result<Vec<&[u8]>> {
    match word(bytes, 0)? {
        0x0a0d_0d0a if word(bytes, 8)? == 0x1a2b_3c4d => read_blocks(bytes),
        0xa1b2_c3d4 | 0xa1b2_3c4d if word(bytes, 20)? == 1 => read_records(bytes),
        _ => Err(no_capture("it is no little-endian capture of Ethernet")),
    }
}

fn read_records(bytes: &[u8]) -> io::Result<Vec<&[u8]>> {
    let mut rest = bytes.get(24..).unwrap_or_default();
    let mut frames = Vec::new();
    while !rest.is_empty() {
        let end = 16 + word(rest, 8)? as usize;
        frames.push(rest.get(16..end).ok_or_else(|| no_capture("it ends within a frame"))?);
        rest = rest.get(end..).unwrap_or_default();
    }
    Ok(frames)
}

/// Blocks of pcapng: 1 describes an interface, 6 is a frame.
fn read_blocks(mut rest: &[u8]) -> io::Result<Vec<&[u8]>> {
    let (mut is_ethernet, mut frames) = (Vec::new(), Vec::new());
    while !rest.is_empty() {
        let (kind, length) = (word(rest, 0)?, word(rest, 4)? as usize);
        let (block, behind) =
            rest.split_at_checked(length.max(12)).ok_or_else(|| no_capture("it ends within a block"))?;
        match kind {
            1 => is_ethernet.push(word(block, 8)? & 0xffff == 1),
            6 if is_ethernet.get(word(block, 8)? as usize) == Some(&true) => {
                let end = 28 + word(block, 20)? as usize;
                frames.push(block.get(28..end).ok_or_else(|| no_capture("a frame is longer than its block"))?);
            }
            _ => {}
        }
        rest = behind;
    }
    Ok(frames)
}

fn no_capture(why: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, why)
}

fn word(bytes: &[u8], at: usize) -> io::Result<u32> {
    let word = bytes.get(at..).and_then(|rest| rest.first_chunk::<4>()).copied().map(u32::from_le_bytes);
    word.ok_or_else(|| no_capture("it ends too early"))
}

/// A file of frames.
pub struct Capture<W> {
    out: W,
}

impl<W: Write> Capture<W> {
    /// Begins a file.
    pub fn new(mut out: W) -> io::Result<Self> {
        out.write_all(&0xa1b2_3c4d_u32.to_le_bytes())?;
        out.write_all(&[2, 0, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0])?;
        out.write_all(&0xffff_u32.to_le_bytes())?;
        out.write_all(&1_u32.to_le_bytes())?;
        Ok(Self { out })
    }

    /// Adds a frame, from the destination on and without check sequence.
    pub fn frame(&mut self, at: Time, bytes: &[u8]) -> io::Result<()> {
        let length = (bytes.len() as u32).to_le_bytes();
        self.out.write_all(&((at.0 / 1_000_000_000) as u32).to_le_bytes())?;
        self.out.write_all(&((at.0 % 1_000_000_000) as u32).to_le_bytes())?;
        self.out.write_all(&[length, length].concat())?;
        self.out.write_all(bytes)
    }

    /// Ends the file.
    pub fn end(mut self) -> io::Result<()> {
        self.out.flush()
    }
}
