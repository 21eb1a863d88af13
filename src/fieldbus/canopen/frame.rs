//! The CAN frame and the outgoing queue that every engine takes as arguments.

use std::fmt;

/// One of a participant's buses; the first if there is only one.
///
/// The number distinguishes frames of several buses, and is the index of the data stored for each bus. It is not sent on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BusId(u8);

impl BusId {
    /// The first bus, also where there is no other.
    pub const FIRST: Self = Self(0);

    /// Returns the bus with this number, counted from 0.
    pub const fn new(number: u8) -> Self {
        Self(number)
    }

    /// Returns all buses, in the order of their numbers.
    pub fn all() -> impl DoubleEndedIterator<Item = Self> {
        (0..=u8::MAX).map(Self)
    }

    /// Its place in a list of all buses.
    ///
    /// Real-time: yes.
    pub const fn index(self) -> usize {
        self.0 as usize
    }

    /// Its bit in a set of eight buses; none beyond the eighth.
    ///
    /// Real-time: yes.
    pub const fn bit(self) -> u8 {
        if self.0 < 8 { 1 << self.0 } else { 0 }
    }
}

/// Its number.
impl fmt::Display for BusId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// A classic CAN frame with an 11-bit identifier (ISO 11898-1); extended frames are not used.
///
/// A remote frame asks for the data frame of its identifier: node guarding alone uses it. Its payload is empty,
/// whatever length it asks for, so that no decoder takes it for data.
///
/// A participant in several buses distinguishes the frames by [`Frame::bus`]. The bus is not sent on the wire: engines of one node neither
/// read nor set it, and [`Outbox::on`] sets it for them.
// It is copied often: aligned, as one piece.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(align(8))]
pub struct Frame {
    id: u16,
    len: u8,
    /// Data length code of a remote frame; `None` for a data frame.
    requested: Option<u8>,
    bus: BusId,
    data: [u8; 8],
}

impl Frame {
    /// Creates a frame with identifier `id` (0 to 7FFh; higher bits are cut off) and up to 8 bytes of `data` (the rest is cut
    /// off). Bytes beyond the length are zero.
    ///
    /// Real-time: yes.
    pub fn new(id: u16, data: &[u8]) -> Self {
        let mut frame =
            Frame { id: id & 0x7ff, len: data.len().min(8) as u8, requested: None, bus: BusId::FIRST, data: [0; 8] };
        for (to, from) in frame.data.iter_mut().zip(data) {
            *to = *from;
        }
        frame
    }

    /// Returns the frame whose payload is the low `len` bytes of `bits`, little-endian.
    ///
    /// Real-time: yes.
    pub fn from_bits(id: u16, bits: u64, len: u8) -> Self {
        let len = len.min(8);
        let kept = if len == 8 { bits } else { bits & ((1u64 << (8 * len)) - 1) };
        Frame { id: id & 0x7ff, len, requested: None, bus: BusId::FIRST, data: kept.to_le_bytes() }
    }

    /// Returns the remote frame that asks for the `len` (at most 8) bytes of `id`.
    ///
    /// Real-time: yes.
    pub fn remote(id: u16, len: u8) -> Self {
        Frame { id: id & 0x7ff, len: 0, requested: Some(len.min(8)), bus: BusId::FIRST, data: [0; 8] }
    }

    /// Returns the frame for another bus.
    ///
    /// Real-time: yes.
    #[must_use]
    pub const fn on_bus(self, bus: BusId) -> Self {
        Frame { bus, ..self }
    }

    /// Returns the bus that it comes from or goes to; the first where there is one.
    pub const fn bus(&self) -> BusId {
        self.bus
    }

    /// Whether this is a remote frame.
    pub const fn is_remote(&self) -> bool {
        self.requested.is_some()
    }

    /// Returns the data length code on the wire: the payload length, or what a remote frame asks for.
    pub const fn length_code(&self) -> u8 {
        match self.requested {
            Some(len) => len,
            None => self.len,
        }
    }

    /// Returns the identifier, 0 to 7FFh.
    pub const fn id(&self) -> u16 {
        self.id
    }

    /// Returns the payload length, 0 to 8; 0 for a remote frame.
    pub const fn len(&self) -> u8 {
        self.len
    }

    /// Whether the payload is empty.
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Returns the payload.
    pub fn data(&self) -> &[u8] {
        self.data.get(..usize::from(self.len)).unwrap_or_default()
    }

    /// Returns all eight bytes; those beyond the length are zero.
    pub const fn bytes(&self) -> &[u8; 8] {
        &self.data
    }

    /// Returns all eight bytes as one little-endian word; those beyond the length are zero.
    pub const fn bits(&self) -> u64 {
        u64::from_le_bytes(self.data)
    }
}

/// Queue for the frames that an engine wants to send, oldest first.
pub trait Outbox {
    /// Queues one frame. A full queue counts the loss; it never blocks.
    fn push(&mut self, frame: Frame);

    /// Queues a frame that can wait, if there is room for it now; returns whether it was taken. After a refusal the caller keeps the frame
    /// and offers it again later. An outbox that does not know its room takes every frame.
    fn offer(&mut self, frame: Frame) -> bool {
        self.push(frame);
        true
    }

    /// Returns an outbox for an engine that knows of one bus: every frame goes to that bus.
    fn on(&mut self, bus: BusId) -> OnBus<'_, Self>
    where
        Self: Sized,
    {
        OnBus { out: self, bus }
    }
}

/// The part of an [`Outbox`] that leads to one bus.
#[derive(Debug)]
pub struct OnBus<'a, O> {
    out: &'a mut O,
    bus: BusId,
}

impl<O: Outbox> Outbox for OnBus<'_, O> {
    fn push(&mut self, frame: Frame) {
        self.out.push(frame.on_bus(self.bus));
    }

    fn offer(&mut self, frame: Frame) -> bool {
        self.out.offer(frame.on_bus(self.bus))
    }
}

impl<O: Outbox + ?Sized> Outbox for &mut O {
    fn push(&mut self, frame: Frame) {
        (**self).push(frame);
    }

    fn offer(&mut self, frame: Frame) -> bool {
        (**self).offer(frame)
    }
}

impl Outbox for Vec<Frame> {
    fn push(&mut self, frame: Frame) {
        Vec::push(self, frame);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buses_have_places_and_the_first_eight_a_bit() {
        assert_eq!(BusId::all().position(|bus| bus == BusId::new(200)), Some(BusId::new(200).index()));
        assert_eq!([0, 1, 7, 8, 255].map(|number| BusId::new(number).bit()), [1, 2, 0x80, 0, 0]);
        assert_eq!((BusId::default(), BusId::new(3).to_string().as_str()), (BusId::FIRST, "3"));
    }
}
