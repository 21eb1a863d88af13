//! Frames that come over the link, and their times.

use std::time::Duration;

use super::Runner;
use crate::place::Place;
use yieldwall_bus::{LinkEvent, Master};
use yieldwall_fieldbus::canopen::Frame;
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{Arrival, EthernetReceived, LinkOutbox, Packet, Received};

/// How long lockstep listens before the first cycle, in wall-clock time, for the devices' answers to the boot. In lockstep time
/// goes so fast that the answers of a second device with the same node ID could come after the drives were enabled.
const LISTEN: Duration = Duration::from_millis(250);
/// Arrivals that are taken at one wake-up; more wait for the next one. Four cycles of the fullest bus are fewer.
const ARRIVALS: usize = 256;
/// Wall-clock time between two looks at the link above which the frames in between say nothing about lockstep's time. The process
/// was stopped meanwhile, and devices that are left alone follow the wall clock.
const ABSENCE: Duration = Duration::from_millis(500);

impl<P: Place + ?Sized> Runner<P> {
    /// Takes what comes for [`LISTEN`]. The drives wait for heartbeats already.
    pub(super) fn listen(&mut self) {
        let until = self.now() + LISTEN;
        while self.now() < until {
            let sent = self.send(|master, now, out| master.networks_mut().repeat_heartbeat(now, out).unwrap_or(now));
            let next = until.min(sent + self.between_heartbeats()).min(self.master.networks().next_deadline());
            self.wait_until(self.started + next.since(Time(0)));
            self.drain();
            self.send(|master, now, out| master.networks_mut().poll(now, out));
        }
    }

    /// Returns the longest time from one call of `repeat_heartbeat` to the next.
    pub(super) fn between_heartbeats(&self) -> Duration {
        self.master.networks().heartbeat_period().unwrap_or(LISTEN)
    }

    /// Takes what the link holds, until `is_enough` or for as long as there is patience.
    pub(super) fn wait_for(&mut self, patience: Duration, is_enough: impl Fn(&Master) -> bool) {
        let until = self.place.now() + patience;
        loop {
            self.drain();
            if is_enough(&self.master) || self.place.now() >= until {
                return;
            }
            self.wait_until(until);
        }
    }

    /// Waits until something comes over the link, or until a moment of its clock.
    pub(crate) fn wait_until(&mut self, moment: Time) -> bool {
        self.standstill.wait_until(moment);
        self.place.wait(moment)
    }

    /// Takes what the link holds; whether that was anything.
    pub(super) fn drain(&mut self) -> bool {
        let wall = self.place.now();
        self.standstill.run(wall);
        if self.waits {
            if wall.since(self.looked_at) > ABSENCE {
                self.back_since = wall;
            }
            self.looked_at = wall;
        }
        let mut has_come = false;
        for _ in 0..ARRIVALS {
            let Some(arrival) = self.place.receive() else { break };
            self.take(&arrival);
            has_come = true;
        }
        self.drain_ethernet() || has_come
    }

    /// Takes what has come over the segment; whether that was anything.
    pub(crate) fn drain_ethernet(&mut self) -> bool {
        let Some(bus) = self.master.networks().ethernet_bus() else { return false };
        let mut has_come = false;
        for _ in 0..ARRIVALS {
            let Self { place, buffer, .. } = &mut *self;
            let Some(arrival) = place.receive_ethernet(&mut buffer[..]) else { break };
            has_come = true;
            let time = self.on_own_clock(arrival.time);
            match arrival.what {
                EthernetReceived::Frame { length } => {
                    self.counts.received += 1;
                    let Self { master, place, buffer, tap, .. } = &mut *self;
                    let packet = Packet::Ethernet { bus, bytes: buffer.get(..length).unwrap_or_default() };
                    if let Some(tap) = tap {
                        tap(time, packet);
                    }
                    master.networks_mut().on_packet(time, packet, &mut LinkOutbox::new(place));
                    // What the frame has made the master send.
                    self.send(|_, _, _| ());
                }
                EthernetReceived::TooLong { .. } => self.counts.received += 1,
                EthernetReceived::Down | EthernetReceived::Gone => {
                    self.master.networks_mut().on_link(bus, LinkEvent::SendFailed)
                }
            }
        }
        has_come
    }

    pub(crate) fn take(&mut self, arrival: &Arrival) {
        let time = self.time_of(arrival);
        if let Some(event) = arrival.what.link_event() {
            self.master.networks_mut().on_link(arrival.bus, event);
        }
        match arrival.what {
            Received::Frame(frame) => {
                self.counts.received += 1;
                self.show(time, &frame);
                self.send(|master, _, out| master.networks_mut().on_packet(time, Packet::Can(&frame), out));
                if self.waits && arrival.time < self.back_since {
                    self.master.networks_mut().forget_heartbeat_times();
                }
            }
            Received::Echo(frame) => {
                self.counts.echoed += 1;
                self.show(time, &frame);
                self.master.networks_mut().on_echo(&frame);
            }
            Received::Overflow { frames } => self.counts.overflowed += u64::from(frames),
            Received::Other(_) | Received::Error(_) | Received::Down | Received::Gone => {}
        }
    }

    /// Returns the time of an arrival, since switching on.
    pub(crate) fn time_of(&self, arrival: &Arrival) -> Time {
        self.on_own_clock(arrival.time)
    }

    fn on_own_clock(&self, time: Time) -> Time {
        if self.waits { self.lockstep_now } else { Time(time.since(self.started).as_nanos() as u64) }
    }

    fn show(&mut self, time: Time, frame: &Frame) {
        if let Some(tap) = &mut self.tap {
            tap(time, Packet::Can(frame));
        }
    }
}
