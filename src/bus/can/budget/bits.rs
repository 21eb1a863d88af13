//! How many bits a frame can take on the wire.

/// Bits from SOF to the CRC that are there without any data, all of them stuffed.
const STUFFED: u32 = 34;
/// Bits without stuffing: delimiters, acknowledgement, end of frame, interframe space.
const PLAIN: u32 = 13;

/// The most bits that a frame with `bytes` data bytes (0 to 8) takes, whatever its identifier: stuff bits and
/// interframe space included.
///
/// # Source
/// [DBBL07, eq. 3]: `8 s + 47 + floor((34 + 8 s - 1) / 4)`, which is `55 + 10 s`.
pub const fn worst_bits(bytes: u8) -> u32 {
    shortest_bits(bytes) + (STUFFED + 8 * bytes as u32 - 1) / 4
}

/// The bits of a frame with `bytes` data bytes (0 to 8) without any stuff bit, interframe space included: none is shorter.
pub const fn shortest_bits(bytes: u8) -> u32 {
    8 * bytes as u32 + STUFFED + PLAIN
}

/// The most bits that a frame with this identifier of 11 bits and `bytes` data bytes (0 to 8) takes, over all data.
///
/// Identifier and length are known when the network is planned, and few of them can be stuffed as often as
/// [`worst_bits`] assumes: this is 2 to 4 bits less. Data and checksum are taken as free, so that no frame is longer.
pub fn longest_bits(cob_id: u16, bytes: u8) -> u32 {
    let mut runs = Runs::start();
    // SOF is 0; RTR, IDE and r0 are 0.
    runs.take(0);
    for shift in (0..11).rev() {
        runs.take(cob_id >> shift & 1);
    }
    for _ in 0..3 {
        runs.take(0);
    }
    for shift in (0..4).rev() {
        runs.take(u16::from(bytes) >> shift & 1);
    }
    for _ in 0..8 * u32::from(bytes) + 15 {
        runs.take_any();
    }
    shortest_bits(bytes) + runs.most()
}

/// The most stuff bits so far for each last bit and each run of it, 1 to 4 long; `None` where nothing leads.
#[derive(Clone, Copy)]
struct Runs([[Option<u32>; 4]; 2]);

impl Runs {
    fn start() -> Self {
        // Recessive bits before SOF are not counted: as if one had come, which SOF follows with a run of its own.
        let mut runs = Self([[None; 4]; 2]);
        runs.0[1][0] = Some(0);
        runs
    }

    fn take(&mut self, bit: u16) {
        *self = self.after(usize::from(bit & 1));
    }

    fn take_any(&mut self) {
        let (zero, one) = (self.after(0), self.after(1));
        for (bit, runs) in self.0.iter_mut().enumerate() {
            for (run, most) in runs.iter_mut().enumerate() {
                *most = zero.0[bit][run].max(one.0[bit][run]);
            }
        }
    }

    fn after(&self, bit: usize) -> Self {
        let mut next = Self([[None; 4]; 2]);
        for (last, runs) in self.0.iter().enumerate() {
            for (run, stuffed) in runs.iter().enumerate() {
                let Some(stuffed) = *stuffed else { continue };
                let run = if last == bit { run + 1 } else { 0 };
                // After the fifth equal bit comes its opposite, which is the first of a new run.
                let (bit, run, stuffed) = if run == 4 { (1 - bit, 0, stuffed + 1) } else { (bit, run, stuffed) };
                next.0[bit][run] = next.0[bit][run].max(Some(stuffed));
            }
        }
        next
    }

    fn most(&self) -> u32 {
        self.0.iter().flatten().flatten().copied().max().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_formula_gives_the_published_lengths() {
        let lengths: Vec<u32> = (0..=8).map(worst_bits).collect();
        assert_eq!(lengths, [55, 65, 75, 85, 95, 105, 115, 125, 135]);
    }

    #[test]
    fn an_identifier_takes_bits_off_the_formula() {
        // SYNC: 0000 1 | 16 zeros, 3 stuff bits, the last of them before a zero; then 15 free bits.
        assert_eq!(longest_bits(0x080, 0), 53);
        assert_eq!([longest_bits(0x181, 6), longest_bits(0x202, 6), longest_bits(0x18a, 8)], [111, 112, 131]);
        for id in 0..0x800 {
            for bytes in 0..=8 {
                let longest = longest_bits(id, bytes);
                assert!((47 + 8 * u32::from(bytes)..=worst_bits(bytes)).contains(&longest), "{id:03X}h, {bytes} bytes");
            }
        }
    }

    mod against_the_exact_length {
        use super::*;
        use proptest::prelude::*;
        use yieldwall_fieldbus::canopen::Frame;
        use yieldwall_sim::can::frame_bits;

        proptest! {
            #[test]
            fn no_frame_is_longer(id in 0u16..0x800, bits: u64, len in 0u8..9, stuffed in 0u32..64, sparse: bool) {
                let bits = if sparse { u64::MAX << stuffed } else { bits };
                let exact = frame_bits(&Frame::from_bits(id, bits, len));
                prop_assert!(exact <= longest_bits(id, len) && longest_bits(id, len) <= worst_bits(len));
            }

            /// Two data bytes and a checksum of 15 bits leave little room: the bound is met or missed by a few bits.
            #[test]
            fn the_longest_is_nearly_reached(id in 0u16..0x800) {
                let lengths = (0..=u16::MAX).map(|data| frame_bits(&Frame::new(id, &data.to_be_bytes())));
                let most = lengths.max().unwrap();
                prop_assert!(longest_bits(id, 2) - most <= 2, "{} and {}", most, longest_bits(id, 2));
            }
        }
    }
}
