//! How many bits a frame takes on the wire.

use yieldwall_fieldbus::canopen::Frame;

/// Generator polynomial of the CRC of classic CAN, without its highest term.
///
/// # Source
/// ISO 11898-1, CRC of 15 bits.
const CRC_POLYNOMIAL: u16 = 0x4599;

/// Bits of the stuffed part that come before the data: SOF, identifier, RTR, IDE, r0, DLC.
const HEADER_BITS: u32 = 19;
const CRC_BITS: u32 = 15;
/// CRC delimiter, ACK slot, ACK delimiter and end of frame, never stuffed.
const TRAILER_BITS: u32 = 10;
/// Interframe space before the next frame can start.
pub const INTERFRAME_BITS: u32 = 3;

/// CRC-15 of one more byte, by the eight bits that leave the register.
static CRC_TABLE: [u16; 256] = crc_table();

/// Stuff bits and next state for each state and each byte.
///
/// A state is the last bit and how often it has come in a row (1 to 4): `bit * 4 + run - 1`. After five equal bits the
/// stuff bit follows at once, so that the run never stands at five. An entry is the number of stuff bits in the high
/// nibble and the next state in the low one.
static STUFF_TABLE: [[u8; 256]; 8] = stuff_table();

const fn crc_table() -> [u16; 256] {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut crc = (byte as u16) << 7;
        let mut bit = 0;
        while bit < 8 {
            crc = (crc << 1) ^ if crc & 0x4000 != 0 { CRC_POLYNOMIAL } else { 0 };
            bit += 1;
        }
        table[byte] = crc & 0x7fff;
        byte += 1;
    }
    table
}

const fn stuff_table() -> [[u8; 256]; 8] {
    let mut table = [[0; 256]; 8];
    let mut from = 0;
    while from < 8 {
        let mut byte = 0;
        while byte < 256 {
            let (mut last, mut run, mut stuffed) = (from / 4, from % 4 + 1, 0);
            let mut shift = 8;
            while shift > 0 {
                shift -= 1;
                let bit = (byte >> shift) & 1;
                run = if bit == last { run + 1 } else { 1 };
                last = bit;
                if run == 5 {
                    stuffed += 1;
                    last = 1 - bit;
                    run = 1;
                }
            }
            table[from][byte] = (stuffed << 4 | (last * 4 + run - 1)) as u8;
            byte += 1;
        }
        from += 1;
    }
    table
}

/// CRC-15 after one more byte, highest bit first. Zero bits in front of everything do not change it.
fn crc15(crc: u16, byte: u8) -> u16 {
    ((crc << 8) ^ CRC_TABLE[usize::from((crc >> 7) as u8 ^ byte)]) & 0x7fff
}

/// Counts stuff bits along whole bytes.
struct Stuffing {
    state: usize,
    count: u32,
}

impl Stuffing {
    fn take(&mut self, byte: u8) {
        let entry = STUFF_TABLE[self.state][usize::from(byte)];
        self.count += u32::from(entry >> 4);
        self.state = usize::from(entry & 0x7);
    }
}

/// Bits that `frame` takes on the wire from SOF to the end of the interframe space, stuff bits included.
///
/// Between `47 + 8 s` and `55 + 10 s` for `s` data bytes. The bit pattern is the real one, CRC included, so that the
/// figure is exact for a frame without errors.
///
/// # Source
/// ISO 11898-1, base frame format: a stuff bit follows each five equal bits between SOF and the end of the CRC.
pub fn frame_bits(frame: &Frame) -> u32 {
    // SOF, IDE, r0 and, of a data frame, RTR are 0 (dominant). 19 bits, which the checksum sees as 3 bytes with zeros in front.
    let header = u32::from(frame.id()) << 7 | u32::from(frame.is_remote()) << 6 | u32::from(frame.length_code());
    let mut crc = header.to_be_bytes().into_iter().skip(1).fold(0, crc15);
    // SOF is one 0; the first identifier bit is taken alone, which leaves 17 bits of the header and whole bytes with
    // the checksum, each shifted by the one bit that is left over from the byte before.
    let mut stuffing = Stuffing { state: if frame.id() >> 10 & 1 == 0 { 1 } else { 4 }, count: 0 };
    stuffing.take((header >> 9) as u8);
    stuffing.take((header >> 1) as u8);
    let mut before = header as u8;
    for &byte in frame.data() {
        crc = crc15(crc, byte);
        stuffing.take(before << 7 | byte >> 1);
        before = byte;
    }
    stuffing.take(before << 7 | (crc >> 8) as u8);
    stuffing.take(crc as u8);
    HEADER_BITS + 8 * u32::from(frame.len()) + CRC_BITS + stuffing.count + TRAILER_BITS + INTERFRAME_BITS
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The same, bit by bit as the standard puts it.
    fn frame_bits_by_definition(frame: &Frame) -> u32 {
        let mut bits = vec![0u8];
        bits.extend((0..11).rev().map(|n| (frame.id() >> n & 1) as u8));
        bits.extend([u8::from(frame.is_remote()), 0, 0]);
        bits.extend((0..4).rev().map(|n| frame.length_code() >> n & 1));
        for byte in frame.data() {
            bits.extend((0..8).rev().map(|n| byte >> n & 1));
        }
        let mut crc = 0u16;
        for &bit in &bits {
            let next = bit ^ (crc >> 14) as u8 & 1;
            crc = (crc << 1) & 0x7fff;
            if next == 1 {
                crc ^= CRC_POLYNOMIAL;
            }
        }
        bits.extend((0..15).rev().map(|n| (crc >> n & 1) as u8));
        let (mut last, mut run, mut stuffed) = (2, 0, 0);
        for &bit in &bits {
            run = if bit == last { run + 1 } else { 1 };
            last = bit;
            if run == 5 {
                stuffed += 1;
                last = 1 - bit;
                run = 1;
            }
        }
        bits.len() as u32 + stuffed + 13
    }

    #[test]
    fn the_crc_has_the_published_check_value() {
        assert_eq!(b"123456789".iter().fold(0, |crc, &byte| crc15(crc, byte)), 0x059e);
    }

    #[test]
    fn literal_lengths() {
        // 000h without data is 34 zeros, CRC included: a stuff bit after each fifth.
        assert_eq!(frame_bits(&Frame::new(0x000, &[])), 47 + 6);
        // 0000 1 | 16 zeros: 3 stuff bits | 111 | 7 zeros: 1 | 101
        assert_eq!(frame_bits(&Frame::new(0x080, &[])), 47 + 4);
        // 01010101010 | 1 | 7 zeros: 1 | 110011101001100
        assert_eq!(frame_bits(&Frame::new(0x555, &[])), 47 + 1);
        // Nothing to stuff at all: the lower bound.
        assert_eq!(frame_bits(&Frame::new(0x333, &[0x55; 8])), 111);
        // The most of 20480 regular patterns; the bound of 135 assumes runs that the fixed bits do not allow.
        assert_eq!(frame_bits(&Frame::new(0x02f, &[0x3c; 8])), 131);
        // What a drive sends in Operation Enabled, and what it gets.
        assert_eq!(frame_bits(&Frame::new(0x181, &[0x37, 0x16, 0, 0, 0, 0])), 102);
        assert_eq!(frame_bits(&Frame::new(0x201, &[0x0f, 0, 0, 0])), 86);
    }

    #[test]
    fn a_remote_frame_has_the_length_it_asks_for_and_no_data() {
        // 1110000010 1 | 1 | 00 0001, 15 bits of checksum.
        for (id, len) in [(0x705, 1), (0x705, 0), (0x000, 8), (0x7ff, 8)] {
            let frame = Frame::remote(id, len);
            assert_eq!(frame_bits(&frame), frame_bits_by_definition(&frame));
            assert!((47..=55).contains(&frame_bits(&frame)));
        }
    }

    proptest! {
        #[test]
        fn tables_agree_with_the_definition(id in 0u16..0x800, bits: u64, len in 0u8..9) {
            let frame = Frame::from_bits(id, bits, len);
            prop_assert_eq!(frame_bits(&frame), frame_bits_by_definition(&frame));
        }

        #[test]
        fn sparse_frames_agree_too_and_no_frame_leaves_its_bounds(
            id in 0u16..0x800, len in 0u8..9, zeros in 0u32..64, ones: bool
        ) {
            let bits = if ones { u64::MAX << zeros } else { 1u64 << zeros };
            let frame = Frame::from_bits(id, bits, len);
            let length = frame_bits(&frame);
            let s = u32::from(len);
            prop_assert_eq!(length, frame_bits_by_definition(&frame));
            prop_assert!((47 + 8 * s..=55 + 10 * s).contains(&length), "{} bits", length);
        }
    }
}
