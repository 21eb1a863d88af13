//! This program's own readings of the devices, as in `doctor`. The program writes no registers except those of the memory chips. It
//! brings a device in INIT to PRE-OP for its objects, and back.

use super::super::pdo;
use super::super::{Device, SegmentSession};
use super::reading::{Area, DeviceReading};
use crate::failure::Failure;
use yieldwall_bus::ethercat::topology::{Ports, delays, parents};
use yieldwall_fieldbus::ethercat::registers::{self as register, feature};
use yieldwall_fieldbus::ethercat::sii::{Pdo, Sii};
use yieldwall_fieldbus::ethercat::{AlState, u16_at, u32_at};
use yieldwall_service::{Error, ObjectAccess, number};

/// Protocols by their bits in the SII.
const PROTOCOLS: [&str; 6] = ["AOE", "EOE", "COE", "FOE", "SOE", "VOE"];
/// A process data object that no sync manager carries.
const UNUSED: u8 = 0xff;
const DOING: &str = "reading it for the second opinion";

/// Returns all devices, without delays.
pub(super) fn read(desk: &mut SegmentSession) -> Result<Vec<DeviceReading>, Failure> {
    let all = desk.devices_of(None)?;
    let mut readings = Vec::new();
    for device in &all {
        readings.push(of_device(desk, device)?);
    }
    let ports = ports(desk)?;
    let parents = parents(&ports);
    for (place, reading) in readings.iter_mut().enumerate() {
        let links = ports.get(place).map_or(0, |ports| ports.links);
        reading.ports = Some((0..4).filter(|port| links & 0x10 << port != 0).collect());
        reading.parent = parents.get(place).copied().flatten().and_then(|(parent, _)| u16::try_from(parent).ok());
    }
    Ok(readings)
}

/// Adds the delays, from the times at which the last latched frame passed the ports.
pub(super) fn add_delays(desk: &mut SegmentSession, readings: &mut [DeviceReading]) -> Result<(), Failure> {
    let delays = delays(&ports(desk)?).unwrap_or_default();
    readings.iter_mut().zip(delays).for_each(|(reading, delay)| reading.delay_ns = delay);
    Ok(())
}

fn of_device(desk: &mut SegmentSession, device: &Device) -> Result<DeviceReading, Failure> {
    let present = desk.service.present(device.position).map_err(|error| desk.failure(device, DOING, error))?;
    let mut reading = DeviceReading { identity: present.identity, ..DeviceReading::default() };
    let Ok(sii) = &present.sii else { return Ok(reading) };
    reading.name = Some(sii.order.clone());
    reading.full_name = Some(sii.name.clone());
    let areas = sii.mailbox_areas();
    reading.mailboxes = areas.unwrap_or_default().map(|area| Some(Area { start: area.start, len: area.len }));
    let protocols = if areas.is_some() { sii.protocols } else { 0 };
    reading.protocols = Some(named(protocols));
    [reading.outputs, reading.inputs] = if sii.has_coe() && areas.is_some() {
        let is_in_init = present.status.state() == Some(AlState::Init);
        by_objects(desk, device, is_in_init)?
    } else {
        by_sii(sii)
    };
    Ok(reading)
}

fn named(protocols: u16) -> Vec<String> {
    let bits = PROTOCOLS.iter().enumerate().filter(|(bit, _)| protocols & 1 << bit != 0);
    bits.map(|(_, name)| (*name).to_owned()).collect()
}

/// Bytes of outputs and inputs by the objects of a device; `None` where it does not answer for them.
fn by_objects(desk: &mut SegmentSession, device: &Device, is_in_init: bool) -> Result<[Option<u32>; 2], Failure> {
    let position = device.position;
    let is_reached = !is_in_init || desk.service.change_state(position, AlState::PreOperational).is_ok();
    let exchanged = is_reached.then(|| {
        pdo::read(&mut |at| {
            let held = desk.objects(device)?.read(at);
            match held {
                Ok(bytes) => Ok(Some(number(&bytes))),
                Err(Error::Refused(_)) => Ok(None),
                Err(error) => Err(desk.object_failure(device, DOING, error)),
            }
        })
    });
    if is_in_init {
        let back = desk.service.change_state(position, AlState::Init);
        back.map_err(|error| desk.failure(device, "taking it back to INIT", error))?;
    }
    let Some(Ok(exchanged)) = exchanged else { return Ok([None; 2]) };
    Ok(["outputs", "inputs"].map(|direction| {
        let of_direction = exchanged.iter().filter(|exchange| exchange.direction == direction);
        Some(of_direction.map(pdo::Exchange::bytes).sum())
    }))
}

/// Bytes of outputs and inputs as the SII has them.
fn by_sii(sii: &Sii) -> [Option<u32>; 2] {
    let bits = |pdo: &Pdo| pdo.entries.iter().map(|entry| u32::from(entry.bits)).sum::<u32>();
    [&sii.rx_pdos, &sii.tx_pdos].map(|pdos| {
        let of_manager =
            |manager: u8| pdos.iter().filter(move |pdo| pdo.sync_manager == manager).map(bits).sum::<u32>();
        Some((0..UNUSED).map(|manager| of_manager(manager).div_ceil(8)).sum())
    })
}

/// Returns the links of all devices, and the times that they latched.
fn ports(desk: &mut SegmentSession) -> Result<Vec<Ports>, Failure> {
    let mut all = Vec::new();
    for device in desk.devices_of(None)? {
        let mut read = |register, len| {
            let read = desk.service.read(device.position, register, len);
            read.map_err(|error| desk.failure(&device, DOING, error))
        };
        let links = u16_at(&read(register::DL_STATUS, 2)?, 0);
        let has_clock = u16_at(&read(register::FEATURES, 2)?, 0) & feature::DC != 0;
        let times = match has_clock {
            true => read(register::DC_RECEIVE_TIME, 16)?,
            false => Vec::new(),
        };
        let times = [0, 4, 8, 12].map(|at| u32_at(&times, at));
        all.push(Ports { links, has_clock, times });
    }
    Ok(all)
}
