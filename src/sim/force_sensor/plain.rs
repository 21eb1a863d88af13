//! The sensors on plain CAN.

use super::sampler::{CHANNELS, Sampler};
use yieldwall_fieldbus::canopen::{Frame, Outbox};
use yieldwall_fieldbus::plain_can::{Order, Protocol, Status, Telling};
use yieldwall_fieldbus::time::Time;

/// A sensor that streams or is asked.
#[derive(Clone, Debug)]
pub(super) struct PlainSensor {
    pub(super) sampler: Sampler,
    protocol: Protocol,
    is_streaming: bool,
    newest: Telling,
}

impl PlainSensor {
    pub(super) fn new(protocol: Protocol, sampler: Sampler) -> Self {
        Self { sampler, protocol, is_streaming: false, newest: Telling::default() }
    }

    pub(super) fn boot(&mut self, now: Time) {
        self.sampler.reset(now);
        (self.is_streaming, self.newest) = (false, Telling::default());
    }

    pub(super) fn on_frame(&mut self, frame: &Frame, out: &mut impl Outbox) {
        match self.protocol.understand(frame) {
            Some(Order::Start) => self.is_streaming = true,
            Some(Order::Stop) => self.is_streaming = false,
            Some(Order::Zero) => (0..CHANNELS).for_each(|channel| self.sampler.take_zero(channel)),
            Some(Order::Read) => self.tell(out),
            None => {}
        }
    }

    pub(super) fn poll(&mut self, now: Time, out: &mut impl Outbox) {
        let Some(conversion) = self.sampler.poll(now) else { return };
        self.newest = Telling {
            counts: conversion.narrow(),
            status: Status { overload: conversion.is_overloaded, invalid: conversion.is_invalid },
            number: self.newest.number.wrapping_add(1),
        };
        if self.is_streaming {
            self.tell(out);
        }
    }

    fn tell(&self, out: &mut impl Outbox) {
        self.protocol.encode(&self.newest).into_iter().for_each(|frame| out.push(frame));
    }
}
