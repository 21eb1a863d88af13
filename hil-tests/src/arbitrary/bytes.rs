//! Bytes read as a stream of values, and the values that give a stream.

use std::time::Duration;

use yieldwall::canopen::Frame;

/// Time steps in us that a stream can ask for: those of a cycle of 1 ms, time limits of the protocols, and some that are
/// far too long.
const WAITS_US: [u64; 16] =
    [0, 0, 1, 100, 125, 380, 500, 620, 1000, 1000, 5000, 20_000, 50_000, 250_000, 1_000_000, 3_600_000_000];

/// What stands before an identifier that is spelled out.
const SPELLED: u8 = 0xff;

/// Numbers that arithmetic trips over.
const HARD: [f64; 8] =
    [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -0.0, f64::MAX, f64::MIN_POSITIVE, f64::MIN_POSITIVE / 4.0];

/// A stream of values. At its end every value is zero.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Bytes(bytes)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    fn array<const N: usize>(&mut self) -> [u8; N] {
        let mut array = [0; N];
        let taken = self.0.len().min(N);
        let (head, rest) = self.0.split_at(taken);
        array[..taken].copy_from_slice(head);
        self.0 = rest;
        array
    }

    pub(super) fn u8(&mut self) -> u8 {
        u8::from_le_bytes(self.array())
    }

    pub(super) fn u16(&mut self) -> u16 {
        u16::from_le_bytes(self.array())
    }

    pub(super) fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.array())
    }

    pub(super) fn u64(&mut self) -> u64 {
        u64::from_le_bytes(self.array())
    }

    pub(super) fn bool(&mut self) -> bool {
        self.u8() & 1 != 0
    }

    /// Up to 255 bytes.
    pub(super) fn slice(&mut self) -> &'a [u8] {
        let taken = usize::from(self.u8()).min(self.0.len());
        let (head, rest) = self.0.split_at(taken);
        self.0 = rest;
        head
    }

    /// Any number: one that is hard, any bit pattern, or more often one of everyday size.
    pub(super) fn f64(&mut self) -> f64 {
        match self.u8() {
            hard @ 0..8 => HARD[usize::from(hard)],
            8..64 => f64::from_bits(self.u64()),
            _ => f64::from(self.u32() as i32) * 1e-6,
        }
    }

    pub(super) fn pick<T: Copy>(&mut self, among: &[T]) -> T {
        among[usize::from(self.u8()) % among.len()]
    }

    pub(super) fn wait(&mut self) -> Duration {
        Duration::from_micros(self.pick(&WAITS_US))
    }

    /// A frame, more often than not at one of `ids` and of eight bytes.
    pub(super) fn frame(&mut self, ids: &[u16]) -> Frame {
        let id = match self.u8() {
            SPELLED => self.u16(),
            at => ids[usize::from(at) % ids.len()],
        };
        let len = match self.u8() {
            len @ 0..128 => usize::from(len % 9),
            _ => 8,
        };
        let data: [u8; 8] = self.array();
        Frame::new(id, &data[..len])
    }
}

/// Builds the bytes that [`Bytes`] reads as these values.
#[derive(Clone, Debug, Default)]
pub(super) struct Script(Vec<u8>);

impl Script {
    pub(super) fn new() -> Self {
        Self::default()
    }

    pub(super) fn finish(self) -> Vec<u8> {
        self.0
    }

    pub(super) fn raw(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }

    /// A number of everyday size.
    pub(super) fn number(self, value: f64) -> Self {
        self.raw(&[u8::MAX]).raw(&((value * 1e6) as i32).to_le_bytes())
    }

    /// # Panics
    /// If a stream cannot ask for this time step.
    pub(super) fn wait_us(self, us: u64) -> Self {
        let at = WAITS_US.iter().position(|&wait| wait == us).expect("a time step of the table");
        self.raw(&[at as u8])
    }

    pub(super) fn frame(self, id: u16, data: &[u8]) -> Self {
        let mut padded = [0; 8];
        padded[..data.len()].copy_from_slice(data);
        self.raw(&[SPELLED]).raw(&id.to_le_bytes()).raw(&[data.len() as u8]).raw(&padded)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_script_says_is_what_is_read() {
        let script = Script::new().raw(&[7]).wait_us(380).frame(0x601, &[0x40, 1, 2]).number(-0.25).finish();
        let mut bytes = Bytes::new(&script);
        assert_eq!((bytes.u8(), bytes.wait()), (7, Duration::from_micros(380)));
        assert_eq!(bytes.frame(&[0]), Frame::new(0x601, &[0x40, 1, 2]));
        assert_eq!((bytes.f64(), bytes.is_empty()), (-0.25, true));
    }

    #[test]
    fn after_the_end_everything_is_zero() {
        let mut bytes = Bytes::new(&[0xff, 0x34]);
        assert_eq!(bytes.frame(&[0]), Frame::new(0x034, &[]));
        assert_eq!((bytes.u64(), bytes.wait(), bytes.slice()), (0, Duration::ZERO, &[][..]));
    }
}
