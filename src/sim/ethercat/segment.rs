//! Controllers in a line.

use super::application::EthercatApplication;
use super::controller::{Controller, Links};
use std::time::Duration;
use yieldwall_fieldbus::ethercat::frame::{self, BYTE_NS, DEVICE_NS};
use yieldwall_fieldbus::time::Time;

/// A virtual segment: devices in a line, the first one at the master.
///
/// The owner calls [`Segment::poll`] at each [`Segment::next_deadline`]. Events with a moment of their own (SYNC0, the control
/// loop of a drive, a watchdog) then happen in time. [`Segment::process`] catches up with events that are due.
#[derive(Clone, Debug)]
pub struct Segment<D> {
    controllers: Vec<Controller<D>>,
    /// Whether the cable before each device is plugged in.
    plugged: Vec<bool>,
}

impl<D: EthercatApplication> Segment<D> {
    /// A segment of these devices, all switched on at `now`.
    pub fn new(now: Time, controllers: impl IntoIterator<Item = Controller<D>>) -> Self {
        let mut controllers: Vec<_> = controllers.into_iter().collect();
        controllers.iter_mut().for_each(|controller| controller.power_on(now));
        let plugged = vec![true; controllers.len()];
        let mut segment = Segment { controllers, plugged };
        segment.link();
        segment
    }

    /// Number of devices, reached or not.
    pub fn len(&self) -> usize {
        self.controllers.len()
    }

    /// Whether there is no device.
    pub fn is_empty(&self) -> bool {
        self.controllers.is_empty()
    }

    /// A device by its place, 0 at the master; `None` behind the last one.
    pub fn controller(&self, place: usize) -> Option<&Controller<D>> {
        self.controllers.get(place)
    }

    /// A device by its place, to be changed.
    pub fn controller_mut(&mut self, place: usize) -> Option<&mut Controller<D>> {
        self.controllers.get_mut(place)
    }

    /// All devices.
    pub fn controllers_mut(&mut self) -> impl Iterator<Item = &mut Controller<D>> {
        self.controllers.iter_mut()
    }

    /// Devices that a frame reaches: up to the first cable that is pulled or device that is switched off.
    pub fn reached(&self) -> usize {
        let is_reached = |(controller, is_plugged): &(&Controller<D>, &bool)| **is_plugged && controller.is_powered();
        self.controllers.iter().zip(&self.plugged).take_while(is_reached).count()
    }

    /// Pulls the cable before a device (0: between the master and the first one), or plugs it in again.
    pub fn set_cable(&mut self, place: usize, is_plugged: bool) {
        if let Some(plugged) = self.plugged.get_mut(place) {
            *plugged = is_plugged;
            self.link();
        }
    }

    /// Switches a device off, or on again with all registers as after power-on.
    pub fn set_power(&mut self, now: Time, place: usize, is_on: bool) {
        if let Some(controller) = self.controllers.get_mut(place) {
            if is_on {
                controller.power_on(now);
            } else {
                controller.switch_off(now);
            }
            self.link();
        }
    }

    /// Informs each device which of its ports have a link.
    fn link(&mut self) {
        let is_linked = |place: usize| {
            let is_on = |place: usize| self.controllers.get(place).is_some_and(Controller::is_powered);
            let is_plugged = self.plugged.get(place).copied().unwrap_or_default();
            is_plugged && is_on(place) && (place == 0 || is_on(place - 1))
        };
        let links: Vec<Links> = (0..self.len())
            .map(|place| Links { towards_master: is_linked(place), away: is_linked(place + 1) })
            .collect();
        self.controllers.iter_mut().zip(links).for_each(|(controller, links)| controller.set_links(links));
    }

    /// When to poll next.
    pub fn next_deadline(&self) -> Time {
        self.controllers.iter().map(Controller::next_deadline).min().unwrap_or(Time::NEVER)
    }

    /// Does what is due in each device.
    pub fn poll(&mut self, now: Time) {
        self.controllers.iter_mut().for_each(|controller| controller.poll(now));
    }

    /// Sends a frame through the segment; its first bit is at the first device at `now`. Changes the frame in place, and returns
    /// the moment at which its last bit is back at the master. `None` if nothing comes back: the first cable is pulled, or the
    /// bytes are no EtherCAT frame.
    ///
    /// A frame with a datagram that cannot be comes back with the datagrams before it processed.
    ///
    /// Real-time: yes.
    pub fn process(&mut self, now: Time, bytes: &mut [u8]) -> Option<Time> {
        self.poll(now);
        let reached = self.reached();
        let end = frame::end(bytes);
        if reached == 0
            || matches!(end, Err(yieldwall_fieldbus::ethercat::EthercatError::NotEthercat))
            || bytes.len() < frame::HEADER
        {
            return None;
        }
        if let Some(first) = bytes.get_mut(6) {
            *first |= frame::PROCESSED;
        }
        // Half of the time of a device is on the way there.
        let at = |place: usize| now + Duration::from_nanos(DEVICE_NS / 2 * place as u64);
        for (place, controller) in self.controllers.iter_mut().take(reached).enumerate() {
            let behind = reached - 1 - place;
            let back = at(place) + Duration::from_nanos(DEVICE_NS * behind as u64);
            controller.begin_frame(at(place), back);
            match end {
                Ok(end) => Self::pass(controller, bytes, end),
                Err(_) => controller.count_bad_frame(),
            }
            controller.end_frame(at(place));
        }
        let wire_bytes = (frame::PREAMBLE + bytes.len().max(frame::SHORTEST) + frame::CHECK_SEQUENCE) as u64;
        Some(now + Duration::from_nanos(wire_bytes * BYTE_NS + DEVICE_NS * reached as u64))
    }

    /// Makes a device process all datagrams of a frame.
    fn pass(controller: &mut Controller<D>, bytes: &mut [u8], end: usize) {
        let mut next = Some(frame::HEADER);
        while let Some(at) = next {
            match frame::datagram_at(bytes, at, end) {
                Ok(span) => {
                    next = span.header.has_more.then_some(span.end());
                    if let Some(datagram) = bytes.get_mut(span.start..span.end()) {
                        controller.process(&span.header, datagram);
                    }
                }
                Err(_) => {
                    controller.count_bad_frame();
                    next = None;
                }
            }
        }
    }
}
