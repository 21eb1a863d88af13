//! Values written into the registers of a controller: mailboxes, process data, watchdog and SYNC0.

use std::time::Duration;

use super::failure::SegmentFailure;
use super::flight;
use super::station::Station;
use yieldwall_fieldbus::ethercat::registers as register;
use yieldwall_fieldbus::ethercat::sii::Sii;
use yieldwall_fieldbus::ethercat::{Direction, Fmmu, SyncManager};
use yieldwall_fieldbus::objects::Address;

/// Time from the moment at which SYNC0 is set up to its first pulse.
const SYNC0_AHEAD: Duration = Duration::from_millis(100);
/// Tick of the watchdog as it is written to 0400h, and so many of its periods after which outputs are missed.
const WATCHDOG_DIVIDER: u16 = 2498;
const WATCHDOG_TICK: Duration = Duration::from_micros(100);

/// Where outputs and inputs lie in a device whose SII does not say it.
const OUTPUTS_START: u16 = 0x1800;
const INPUTS_START: u16 = 0x1c00;

const _: () = assert!(flight::FRAME_WAIT.as_nanos() < SYNC0_AHEAD.as_nanos());

/// Registers that are written, and whether they are read back.
#[derive(Clone, Debug)]
pub(super) struct Write {
    pub(super) register: u16,
    pub(super) bytes: Vec<u8>,
    pub(super) is_compared: bool,
}

/// Where something stands in a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WriteTarget {
    /// The byte of a register.
    Register(u16),
    Object(Address),
}

/// A place that holds something else than this master has written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Altered {
    pub(super) place: WriteTarget,
    /// Value written.
    pub(super) written: u32,
    /// Value in the register.
    pub(super) is: u32,
}

impl Altered {
    /// A sentence about the device of this name.
    pub(super) fn sentence(&self, title: &str) -> String {
        let Altered { place, written, is } = self;
        let place = match place {
            WriteTarget::Register(register) => format!("register {register:04X}h"),
            WriteTarget::Object(at) => format!("object {:04X}h:{:02X}", at.index, at.sub),
        };
        format!("somebody else has set {place} of {title} to {is:X}h; this program had set it to {written:X}h")
    }
}

impl Write {
    /// The address behind the last byte.
    pub(super) fn end(&self) -> usize {
        usize::from(self.register) + self.bytes.len()
    }

    /// The first byte that is not as it was written; what a device sets itself, and what a mailbox needs to repeat, does not count.
    ///
    /// Real-time: yes.
    pub(super) fn first_difference(&self, data: &[u8]) -> Option<Altered> {
        let managers = register::SYNC_MANAGER..register::SYNC_MANAGER + 16 * SyncManager::SIZE as u16;
        let counts = |register: u16| match usize::from(register) % SyncManager::SIZE {
            _ if !managers.contains(&register) => u8::MAX,
            SyncManager::STATUS | SyncManager::PDI_CONTROL => 0,
            SyncManager::ACTIVATE => 1,
            _ => u8::MAX,
        };
        let mut bytes = (self.register..).zip(self.bytes.iter().zip(data));
        bytes.find_map(|(register, (written, is))| {
            let place = WriteTarget::Register(register);
            let altered = Altered { place, written: u32::from(*written), is: u32::from(*is) };
            ((written ^ is) & counts(register) != 0).then_some(altered)
        })
    }

    /// Whether what was written stands there.
    pub(super) fn is_held(&self, data: &[u8]) -> bool {
        data.len() == self.bytes.len() && self.first_difference(data).is_none()
    }
}

fn manager(number: u16, settings: SyncManager) -> Write {
    let register = register::SYNC_MANAGER + number * SyncManager::SIZE as u16;
    Write { register, bytes: settings.encode().to_vec(), is_compared: true }
}

/// Sync managers 0 and 1 as the SII wants them; afterwards the device may have its memory chip.
pub(super) fn mailboxes(station: &Station) -> Result<Vec<Write>, SegmentFailure> {
    let managers = station.sii.as_ref().filter(|sii| sii.has_coe()).and_then(Sii::mailbox_managers);
    let [to, from] = managers.ok_or(SegmentFailure::NoCoe)?;
    let offer = Write { register: register::SII_CONFIGURATION, bytes: vec![1], is_compared: false };
    Ok(vec![manager(0, to), manager(1, from), offer])
}

/// Sync managers 2 and 3, FMMUs and watchdog.
pub(super) fn exchange(
    station: &Station,
    fmmus_there: u8,
    managers_there: u8,
    period: Duration,
) -> Result<Vec<Write>, SegmentFailure> {
    const MANAGERS: u8 = 4;
    if managers_there < MANAGERS {
        return Err(SegmentFailure::Lacks { what: "sync managers", has: managers_there, needs: MANAGERS });
    }
    let sii = station.sii.as_ref().ok_or(SegmentFailure::NoCoe)?;
    let mut writes = Vec::new();
    let mut fmmus = 0;
    // Memory behind mailboxes and outputs, which have three buffers.
    let areas = sii.mailbox_areas().unwrap_or_default();
    let mut free = areas.iter().map(|area| area.start.saturating_add(area.len)).max().unwrap_or_default();
    for (number, area, direction) in [(2, &station.outputs, Direction::Write), (3, &station.inputs, Direction::Read)] {
        let delivered = sii.sync_managers.get(usize::from(number)).map(|it| it.settings);
        let default = if direction == Direction::Write { OUTPUTS_START } else { INPUTS_START };
        let delivered = delivered.map(|it| it.start).filter(|start| *start >= register::PROCESS_DATA);
        let start = delivered.unwrap_or(default.max(free.next_multiple_of(2)));
        let control = match direction {
            // Three buffers: each side has the newest whole one.
            Direction::Write => SyncManager::WRITE | SyncManager::INTERRUPT | SyncManager::WATCHDOG,
            Direction::Read => SyncManager::INTERRUPT,
        };
        let len = area.len as u16;
        free = free.max(start.saturating_add(3 * len));
        writes.push(manager(number, SyncManager { start, len, control, is_enabled: len > 0, repeat: false }));
        if len > 0 {
            let register = register::FMMU + fmmus * Fmmu::SIZE as u16;
            let fmmu = Fmmu::bytes(area.logical, len, start, direction);
            writes.push(Write { register, bytes: fmmu.encode().to_vec(), is_compared: true });
            fmmus += 1;
        }
    }
    if fmmus_there < fmmus as u8 {
        return Err(SegmentFailure::Lacks { what: "FMMUs", has: fmmus_there, needs: fmmus as u8 });
    }
    let compared = |register, bytes: &[u8]| Write { register, bytes: bytes.to_vec(), is_compared: true };
    let watched = period * yieldwall_drives::watchdog::WATCHED_CYCLES;
    let ticks = watched.as_nanos().div_ceil(WATCHDOG_TICK.as_nanos()).clamp(1, u16::MAX.into()) as u16;
    writes.push(compared(register::WATCHDOG_DIVIDER, &WATCHDOG_DIVIDER.to_le_bytes()));
    writes.push(compared(register::WATCHDOG_SYNC_MANAGER, &ticks.to_le_bytes()));
    Ok(writes)
}

/// Returns the writes for SYNC0, and for SYNC1 at its distance if there is one, from a while after a moment of system time on.
/// Also returns the moment of the first SYNC0: the master must switch SYNC0 on before it.
pub(super) fn sync0(period: Duration, sync1: Option<Duration>, system_time_ns: u64) -> (Vec<Write>, u64) {
    let period_ns = period.as_nanos().clamp(1, u32::MAX.into()) as u64;
    let earliest = system_time_ns.saturating_add(SYNC0_AHEAD.as_nanos() as u64);
    let start = earliest.div_ceil(period_ns).saturating_mul(period_ns);
    let write = |register, bytes: &[u8], is_compared| Write { register, bytes: bytes.to_vec(), is_compared };
    let mut writes = vec![
        write(register::DC_CYCLIC_CONTROL, &[0, 0], true),
        write(register::DC_SYNC0_CYCLE, &(period_ns as u32).to_le_bytes(), true),
    ];
    if let Some(after) = sync1 {
        let after_ns = after.as_nanos().min(u32::MAX.into()) as u32;
        writes.push(write(register::DC_SYNC1_CYCLE, &after_ns.to_le_bytes(), true));
    }
    // The register then reads as the next pulse.
    writes.push(write(register::DC_START_TIME, &start.to_le_bytes(), false));
    writes.push(write(register::DC_ACTIVATION, &[if sync1.is_some() { 7 } else { 3 }], true));
    (writes, start)
}
