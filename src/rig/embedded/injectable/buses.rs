//! The buses with what is broken on them.

use std::time::Duration;

use super::super::buses::{Buses, STRANGER};
use super::held::Held;
use super::interfaces::Interfaces;
use super::participant::{Participants, needed, participants};
use super::passage::Disturbance;
use super::stranger::{Stranger, send_once};
use crate::error::RigError;
use crate::far_end::Wire;
use yieldwall_bus::LinkEvent;
use yieldwall_config as config;
use yieldwall_config::injection::{Injection, Kind, Lasts};
use yieldwall_fieldbus::canopen::{BusId, Frame};
use yieldwall_fieldbus::time::Time;
use yieldwall_link::SendError;
use yieldwall_sim::can::Passage;

/// Buses whose frames may be lost or changed, on which foreign nodes may send, and to which the master's interfaces may fail.
#[derive(Debug)]
pub(in crate::embedded) struct InjectableBuses {
    pub(in crate::embedded) buses: Buses,
    participants: Participants,
    disturbance: Disturbance,
    stranger: Stranger,
    interfaces: Interfaces,
    held: Held,
}

impl InjectableBuses {
    /// Creates the idle buses of a rig without faults. Random values come from `seed`.
    ///
    /// # Errors
    /// A bus or a node that cannot be.
    pub(in crate::embedded) fn new(rig: &config::Rig, seed: u64) -> Result<Self, RigError> {
        Ok(Self {
            participants: participants(rig)?,
            buses: Buses::new(rig)?,
            disturbance: Disturbance::none(seed),
            stranger: Stranger::default(),
            interfaces: Interfaces::default(),
            held: Held::default(),
        })
    }

    /// Returns the requirement of an injection that the devices of this rig do not meet.
    pub(in crate::embedded) fn needed(&self, injection: Injection) -> Option<&'static str> {
        needed(&self.participants, injection)
    }

    pub(in crate::embedded) fn clear(&mut self) {
        self.disturbance.clear();
        self.stranger.clear();
        self.interfaces.clear();
        self.held.clear();
    }

    /// Begins an injection, or ends it.
    pub(in crate::embedded) fn switch(&mut self, now: Time, injection: Injection, is_on: bool) {
        let Self { buses, participants, disturbance, stranger, interfaces, held } = self;
        match injection.kind {
            kind if kind.row().lasts == Lasts::Once => send_once(now, injection, participants, held),
            kind if Stranger::has(kind) => stranger.switch(injection, is_on),
            kind if Interfaces::has(injection) => {
                interfaces.switch(injection, is_on);
                if matches!(kind, Kind::TransmitStalled | Kind::CableOut | Kind::WrongBitRate) {
                    buses.hold(now, |bus| interfaces.is_transmit_held(participants, bus));
                }
            }
            _ => disturbance.switch(injection, is_on),
        }
    }

    /// Lets foreign nodes send the frames of the cycle that begins at `sync_at`.
    pub(in crate::embedded) fn begin_cycle(&mut self, sync_at: Time, period: Duration) {
        self.stranger.begin_cycle(sync_at, period, &self.participants, &mut self.held);
    }

    /// Returns the time of the next arrival.
    pub(in crate::embedded) fn next_event(&self) -> Time {
        self.buses.next_event().min(self.held.next())
    }

    /// Returns the next frame that arrives, or is lost on its way, not later than `until`, the moment of
    /// [`InjectableBuses::next_event`].
    pub(in crate::embedded) fn advance(&mut self, until: Time) -> Option<Passage> {
        loop {
            if let Some(delivery) = self.buses.advance(until) {
                let (from, sent) = (delivery.from, delivery.frame);
                self.stranger.overhear(from, sent, &self.participants);
                let received = self.disturbance.pass(until, from, sent, &self.participants, &mut self.held);
                return Some(Passage { time: delivery.time, from, sent, received });
            }
            match self.held.take(until)? {
                (STRANGER, frame) => self.buses.submit_foreign(until, frame),
                (from, sent) => return Some(Passage { time: until, from, sent, received: Some(sent) }),
            }
        }
    }

    /// Lets the master send a frame on its bus.
    ///
    /// # Errors
    /// If its interface takes none.
    pub(in crate::embedded) fn submit_own(&mut self, now: Time, frame: Frame) -> Result<(), SendError> {
        if !self.interfaces.sends(&self.participants, frame.bus()) {
            return Err(SendError::Down);
        }
        self.buses.submit_own(now, frame);
        Ok(())
    }

    /// Whether the master hears a frame of others.
    pub(in crate::embedded) fn hears(&self, frame: &Frame) -> bool {
        self.interfaces.hears(&self.participants, frame.bus())
    }

    /// Returns the events of the master's interfaces in every cycle, with the number of the bus.
    pub(in crate::embedded) fn link_events(&self) -> impl Iterator<Item = (BusId, LinkEvent)> {
        let Self { participants, interfaces, .. } = self;
        let on_can = participants.iter().filter(|device| device.is_on_can());
        on_can.filter_map(|device| Some((device.bus, interfaces.event(participants, device.bus)?)))
    }
}

impl Wire for InjectableBuses {
    fn submit(&mut self, device: usize, now: Time, frame: Frame) {
        Wire::submit(&mut self.buses, device, now, frame);
    }

    fn offer(&mut self, device: usize, now: Time, frame: Frame) -> bool {
        self.buses.offer(device, now, frame)
    }
}
