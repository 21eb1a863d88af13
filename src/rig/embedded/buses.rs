//! The virtual buses of a rig.

use std::sync::{Arc, Mutex, PoisonError};

use crate::devices::simulated;
use crate::error::RigError;
use crate::far_end::Wire;
use yieldwall_config as config;
use yieldwall_fieldbus::canopen::{BusId, Frame};
use yieldwall_fieldbus::time::Time;
use yieldwall_run::assembly::device_buses;
use yieldwall_sim::can::{BitTiming, BusCounters, Delivery, QueueOrder, Tamper, VirtualBus, Witness};

/// Port of the master on each bus.
pub(super) const MASTER: usize = 0;
/// Ports of the left drive, the right drive, the sensor.
pub(super) const DEVICES: [usize; 3] = [1, 2, 3];
/// Port of foreign nodes on a bus.
pub(super) const STRANGER: usize = 4;
/// Ports of each bus: those of the rig, and one for foreign nodes.
const PORT_COUNT: usize = STRANGER + 1;

/// All buses. Each has the same ports, of which a device uses those of its own bus alone. A segment is none: it has a
/// [`Cable`](super::cable::Cable).
#[derive(Debug)]
pub(super) struct Buses {
    buses: Vec<Option<VirtualBus>>,
    /// The buses of the left drive, the right drive and the sensor.
    of_devices: [BusId; 3],
}

impl Buses {
    /// Creates idle buses, numbered in the order of their names.
    pub(super) fn new(rig: &config::Rig) -> Result<Self, RigError> {
        let mut orders = [QueueOrder::Priority; PORT_COUNT];
        orders[MASTER] = QueueOrder::Fifo;
        let how = simulated(rig)?.timing;
        let bus = |bus: &config::Bus| {
            let Some(canopen) = bus.canopen() else { return Ok(None) };
            let bit_rate = canopen.bit_rate_bit_per_s;
            let timing = match how {
                config::BusTiming::Arbitrated => BitTiming::Arbitrated { bit_rate },
                config::BusTiming::Ideal => BitTiming::Ideal,
            };
            Ok::<_, RigError>(Some(VirtualBus::new(timing, &orders)?))
        };
        let buses = rig.buses.values().map(bus).collect::<Result<_, _>>()?;
        Ok(Self { buses, of_devices: device_buses(rig)? })
    }

    /// Returns the bus of a device.
    pub(super) fn of_device(&self, device: usize) -> BusId {
        self.of_devices.get(device).copied().unwrap_or_default()
    }

    /// Returns the time of the next delivery on any bus.
    pub(super) fn next_event(&self) -> Time {
        self.buses.iter().flatten().map(VirtualBus::next_event).fold(Time::NEVER, Time::min)
    }

    /// Returns the next frame that is delivered at `until`, which is not later than [`Buses::next_event`].
    pub(super) fn advance(&mut self, until: Time) -> Option<Delivery> {
        BusId::all().zip(&mut self.buses).find_map(|(bus, virtual_bus)| {
            let delivery = virtual_bus.as_mut()?.advance(until)?;
            Some(Delivery { frame: delivery.frame.on_bus(bus), ..delivery })
        })
    }

    /// Lets the master send a frame on its bus.
    pub(super) fn submit_own(&mut self, now: Time, frame: Frame) {
        self.submit(MASTER, now, frame);
    }

    /// Loses what waits in the master's ports.
    pub(super) fn clear(&mut self) {
        self.buses.iter_mut().flatten().for_each(|bus| bus.clear(MASTER));
    }

    /// Holds the frames in the master's port on the buses that `is_held` names, or releases them from `now` on.
    pub(super) fn hold(&mut self, now: Time, is_held: impl Fn(BusId) -> bool) {
        let buses = BusId::all().zip(&mut self.buses).filter_map(|(which, bus)| Some((which, bus.as_mut()?)));
        buses.for_each(|(which, bus)| bus.hold(MASTER, now, is_held(which)));
    }

    /// Returns the counters of each bus so far; `None` for a segment.
    pub(super) fn counters(&self) -> impl Iterator<Item = Option<&BusCounters>> {
        self.buses.iter().map(|bus| bus.as_ref().map(VirtualBus::counters))
    }

    pub(super) fn set_tamper(&mut self, tamper: impl Tamper + Send + 'static) {
        let tamper = Arc::new(Mutex::new(tamper));
        for (which, bus) in BusId::all().zip(&mut self.buses) {
            let Some(bus) = bus else { continue };
            let tamper = Arc::clone(&tamper);
            bus.set_tamper(move |time: Time, from: usize, frame: Frame| {
                let mut tamper = tamper.lock().unwrap_or_else(PoisonError::into_inner);
                tamper.pass(time, from, frame).map(|frame| frame.on_bus(which))
            });
        }
    }

    pub(super) fn set_witness(&mut self, witness: Witness) {
        let witness = Arc::new(Mutex::new(witness));
        for bus in self.buses.iter_mut().flatten() {
            let witness = Arc::clone(&witness);
            bus.set_witness(Box::new(move |passage| {
                let mut witness = witness.lock().unwrap_or_else(PoisonError::into_inner);
                witness(passage);
            }));
        }
    }

    /// Lets a node outside the rig send a frame.
    pub(super) fn submit_foreign(&mut self, now: Time, frame: Frame) {
        self.submit(STRANGER, now, frame);
    }

    fn submit(&mut self, port: usize, now: Time, frame: Frame) {
        if let Some(Some(bus)) = self.buses.get_mut(frame.bus().index()) {
            bus.submit(port, now, frame);
        }
    }
}

impl Wire for Buses {
    fn submit(&mut self, device: usize, now: Time, frame: Frame) {
        let frame = frame.on_bus(self.of_device(device));
        if let Some(port) = DEVICES.get(device) {
            Buses::submit(self, *port, now, frame);
        }
    }

    fn offer(&mut self, device: usize, now: Time, frame: Frame) -> bool {
        let bus = self.buses.get(self.of_device(device).index()).and_then(Option::as_ref);
        let has_room = DEVICES.get(device).zip(bus).is_some_and(|(port, bus)| bus.has_room(*port));
        if has_room {
            Wire::submit(self, device, now, frame);
        }
        has_room
    }
}
