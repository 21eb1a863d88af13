//! Registers that another master changes in the devices on its way to PRE-OP: saved before and restored afterwards.

use std::sync::atomic::Ordering;

use super::super::{Device, SegmentSession};
use crate::failure::{Exit, Failure};
use yieldwall_fieldbus::ethercat::registers::{self as register, feature};
use yieldwall_fieldbus::ethercat::{AlState, AlStatus, Fmmu, SyncManager, u16_at};
use yieldwall_service::{Bytes, SegmentError};

/// Registers of a clock: speed counter start and filter depth, offset, delay. The first two start the control loop anew.
const OF_CLOCK: [(u16, usize); 4] =
    [(register::DC_FILTER_DEPTH, 2), (register::DC_SPEED_START, 2), (register::DC_OFFSET, 8), (register::DC_DELAY, 4)];
/// Place of the byte of a sync manager that switches it on.
const ACTIVATION: u16 = 6;

/// A device as it was.
#[derive(Debug)]
pub(super) struct Kept {
    device: Device,
    state: AlState,
    /// Registers with their old values, in the order of the restore.
    registers: Vec<(u16, Bytes)>,
}

#[cfg(test)]
impl Kept {
    /// Returns its state and its registers, except the status bytes of sync managers, which the device writes.
    pub(super) fn given(&self) -> (AlState, Vec<(u16, Bytes)>) {
        let mut registers = self.registers.clone();
        let managers = registers.iter_mut().filter(|(register, _)| is_sync_manager(*register));
        managers.for_each(|(_, held)| held[5] = 0);
        (self.state, registers)
    }
}

fn is_sync_manager(register: u16) -> bool {
    (register::SYNC_MANAGER..register::DC_RECEIVE_TIME).contains(&register)
}

/// Returns all devices of a segment. Refuses one that is not in INIT or PRE-OP, or has an error there.
pub(super) fn keep(desk: &mut SegmentSession) -> Result<Vec<Kept>, Failure> {
    let mut kept = Vec::new();
    for device in desk.devices_of(None)? {
        let failed = |desk: &SegmentSession, error| desk.failure(&device, "reading what it holds", error);
        let (status, _) = desk.service.state(device.position).map_err(|error| failed(desk, error))?;
        let state =
            [AlState::Init, AlState::PreOperational].into_iter().find(|state| status == AlStatus::new(*state, false));
        let Some(state) = state else { return Err(refused(desk, &device, status)) };
        let registers = registers(desk, device.position).map_err(|error| failed(desk, error))?;
        kept.push(Kept { device, state, registers });
    }
    Ok(kept)
}

/// Returns the failure that a device is in another state.
pub(super) fn refused(desk: &SegmentSession, device: &Device, status: AlStatus) -> Failure {
    let message = format!(
        "{} is in {status}: a second opinion takes each device through INIT, and starts only where all are in INIT or PRE-OP without an error",
        device.words()
    );
    let way = match status.has_error() {
        true => format!("`yieldwall state {} ack{}` acknowledges its error", device.position, desk.arguments),
        false => format!("`yieldwall state all init --take-over{}` takes the devices back", desk.arguments),
    };
    Failure::new(Exit::BusUnavailable, message, format!("end the master that has it; if there is none, {way}"))
}

fn registers(desk: &mut SegmentSession, position: u16) -> Result<Vec<(u16, Bytes)>, SegmentError> {
    let mut read = |register, len| desk.service.read(position, register, len);
    let counts = read(register::FMMU_COUNT, 2)?;
    let [fmmus, managers] = [0, 1].map(|at| u16::from(counts.get(at).copied().unwrap_or_default()).min(16));
    let has_clock = u16_at(&read(register::FEATURES, 2)?, 0) & feature::DC != 0;
    let mut places = vec![(register::STATION_ADDRESS, 2), (register::SII_CONFIGURATION, 1)];
    places.extend((0..fmmus).map(|number| (register::FMMU + number * Fmmu::SIZE as u16, Fmmu::SIZE)));
    places.extend(
        (0..managers).map(|number| (register::SYNC_MANAGER + number * SyncManager::SIZE as u16, SyncManager::SIZE)),
    );
    places.extend(OF_CLOCK.into_iter().filter(|_| has_clock));
    places.into_iter().map(|(register, len)| Ok((register, read(register, len)?))).collect()
}

/// Takes all devices to INIT, restores their values, and takes those that were in PRE-OP back there. Returns the reason for each
/// device that was not restored; the other devices are restored.
pub(super) fn give_back(desk: &mut SegmentSession, kept: &[Kept]) -> Vec<Failure> {
    let mut failed = Vec::new();
    for kept in kept {
        let given = match one(desk, kept) {
            // The devices come first; a second wish to end is heard.
            Err(SegmentError::Interrupted) => {
                desk.service.is_over().store(false, Ordering::Relaxed);
                one(desk, kept)
            }
            given => given,
        };
        failed.extend(given.err().map(|error| desk.failure(&kept.device, "giving back what it held", error)));
    }
    failed
}

fn one(desk: &mut SegmentSession, kept: &Kept) -> Result<(), SegmentError> {
    let position = kept.device.position;
    desk.service.change_state(position, AlState::Init)?;
    for (register, held) in &kept.registers {
        // Its settings are locked while it is on.
        if is_sync_manager(*register) {
            desk.service.write(position, register + ACTIVATION, &[0])?;
        }
        desk.service.write(position, *register, held)?;
    }
    match kept.state {
        AlState::Init => Ok(()),
        state => desk.service.change_state(position, state).map(|_| ()),
    }
}
