//! One EtherCAT slave controller and the device behind it.

mod access;
mod buffers;
mod clock;
mod guarded;
mod mailbox;
mod sii;
mod state;

use super::application::EthercatApplication;
use super::process_data::Mapping;
use buffers::{Ended, Manager};
use clock::{Clock, SyncSignals};
use sii::Chip;
use state::State;
use std::time::Duration;
use yieldwall_fieldbus::ethercat::coe::{CoeEmergency, CoeServer};
use yieldwall_fieldbus::ethercat::frame::{Command, DATAGRAM_HEADER, DatagramHeader, WORKING_COUNTER};
use yieldwall_fieldbus::ethercat::registers::{self as register, feature};
use yieldwall_fieldbus::ethercat::sii::{MailboxArea, Sii};
use yieldwall_fieldbus::ethercat::{AlControl, Fmmu, SyncManager, array, u16_at, u32_at};
use yieldwall_fieldbus::objects::Reset;
use yieldwall_fieldbus::time::Time;

/// FMMUs and sync managers of a controller.
const FMMUS: usize = 8;
const MANAGERS: usize = 8;
/// Sync managers by what they are for.
const MAILBOX_OUT: usize = 0;
const MAILBOX_IN: usize = 1;
const OUTPUTS: usize = 2;
const INPUTS: usize = 3;
/// Process data memory in kB, and the first byte behind it.
const RAM_KB: u8 = 8;
const RAM_END: usize = register::PROCESS_DATA as usize + 1024 * RAM_KB as usize;
/// Things that one poll does at most before it passes over the rest: a device that was not polled for hours does not catch up.
const MOST_EVENTS: u32 = 4096;

/// Settings of a controller.
#[derive(Clone, Debug)]
pub struct ControllerSettings {
    /// SII image, as [`Sii::write`](yieldwall_fieldbus::ethercat::sii::Sii::write) makes it or as it was read from a device.
    pub sii: Vec<u8>,
    /// By how much its clock is too fast, in parts per billion, -1 000 000 to 1 000 000.
    pub drift_ppb: i32,
    /// Time of its clock at power-on, in ns.
    pub clock_start_ns: i64,
    /// How long it takes to answer a mailbox.
    pub mailbox_time: Duration,
    /// Whether it has distributed clocks.
    pub has_dc: bool,
    /// Its deviations from the standard.
    pub manner: Manner,
}

/// Deviations of a device from the standard, or from most devices.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Manner {
    /// Bits of AL status that are always set; of bit 5 and above.
    pub al_status_bits: u16,
    /// The counter of all its mailbox messages; `None` if it counts.
    pub mailbox_counter: Option<u8>,
    /// Answer to a request for SDO information.
    pub information: Information,
    /// Whether the cable that comes from the master is in its output: port 1 has that link, and port 0 the one away from the master.
    pub is_turned: bool,
}

/// Answer to a request for SDO information.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Information {
    /// It is answered.
    #[default]
    Answered,
    /// It is dropped.
    Unanswered,
    /// An SDO abort answers it.
    Aborted,
    /// A mailbox error answers it.
    MailboxError,
}

impl ControllerSettings {
    /// A controller with this SII image, a perfect clock from 0 and a mailbox that answers at once.
    pub fn new(sii: Vec<u8>) -> Self {
        ControllerSettings {
            sii,
            drift_ppb: 0,
            clock_start_ns: 0,
            mailbox_time: Duration::ZERO,
            has_dc: true,
            manner: Manner::default(),
        }
    }
}

/// Links of the ports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Links {
    pub(super) towards_master: bool,
    pub(super) away: bool,
}

/// Registers that a frame changed and that the device examines after the frame has passed.
#[derive(Clone, Copy, Debug, Default)]
struct Touched {
    al_control: bool,
    outputs: bool,
    inputs: bool,
    mailbox: bool,
}

/// A controller in a line, with its device.
///
/// Registers behave as ETG.1000.4 says: what the master may write it can write, what shows something is brought up to date when it is
/// read.
#[derive(Clone, Debug)]
pub struct Controller<D> {
    device: D,
    settings: ControllerSettings,
    memory: Box<[u8]>,
    scratch: Box<[u8]>,
    fmmus: [Fmmu; FMMUS],
    managers: [Manager; MANAGERS],
    chip: Chip,
    /// Mailbox to the device, and from it, by the SII.
    areas: [MailboxArea; 2],
    has_dc: bool,
    clock: Clock,
    signals: SyncSignals,
    /// When SYNC0 comes next.
    sync0_due: Time,
    state: State,
    mailbox: mailbox::Mailbox,
    outputs: Mapping,
    inputs: Mapping,
    links: Links,
    is_powered: bool,
    is_silent: bool,
    stays_in_safe_op: bool,
    touched: Touched,
    /// When the frame that is being processed began here, and when it was back at port 1.
    frame_at: Time,
    frame_back: Time,
}

impl<D: EthercatApplication> Controller<D> {
    /// A controller that is switched off.
    pub fn new(device: D, settings: ControllerSettings) -> Self {
        let chip = Chip::new(settings.sii.clone());
        let image = chip.image();
        let sii = Sii::read(image).ok().filter(Sii::has_coe);
        let areas = sii.and_then(|sii| sii.mailbox_areas()).unwrap_or_default();
        Controller {
            mailbox: mailbox::Mailbox::new(CoeServer::new(&device), settings.mailbox_time, settings.manner),
            device,
            memory: vec![0; RAM_END].into_boxed_slice(),
            scratch: vec![0; 2048].into_boxed_slice(),
            fmmus: [Fmmu::default(); FMMUS],
            managers: [Manager::new(); MANAGERS],
            chip,
            areas,
            has_dc: settings.has_dc,
            clock: Clock::new(Time(0), 0, 0),
            signals: SyncSignals::default(),
            sync0_due: Time::NEVER,
            state: State::new(),
            outputs: Mapping::new(),
            inputs: Mapping::new(),
            links: Links { towards_master: true, away: false },
            is_powered: false,
            is_silent: false,
            stays_in_safe_op: false,
            touched: Touched::default(),
            frame_at: Time(0),
            frame_back: Time(0),
            settings,
        }
    }

    /// The device.
    pub fn device(&self) -> &D {
        &self.device
    }

    /// The device, to be changed: its physical side, its faults.
    pub fn device_mut(&mut self) -> &mut D {
        &mut self.device
    }

    /// Whether it is switched on.
    pub fn is_powered(&self) -> bool {
        self.is_powered
    }

    /// Makes it pass frames on without processing them, as a controller with a fault does. The working counter is then short.
    pub fn set_silent(&mut self, is_silent: bool) {
        self.is_silent = is_silent;
    }

    /// Makes it stay in SAFE-OP without an error when OP is requested, or go on again.
    pub fn set_stays_in_safe_op(&mut self, stays: bool) {
        self.stays_in_safe_op = stays;
    }

    /// Makes it refuse mailboxes, or accept them again.
    pub fn set_mailbox_stuck(&mut self, is_stuck: bool) {
        self.mailbox.set_stuck(is_stuck);
    }

    /// Sets the time that it takes to answer a mailbox.
    pub fn set_mailbox_time(&mut self, time: Duration) {
        self.mailbox.set_time(time);
    }

    /// Makes the device send an emergency as soon as its mailbox has room.
    pub fn send_emergency(&mut self, emergency: CoeEmergency) {
        self.mailbox.queue(emergency);
    }

    /// Makes the device send an emergency between the next request and its answer, or none.
    pub fn interrupt_request(&mut self, emergency: Option<CoeEmergency>) {
        self.mailbox.interruption = emergency;
    }

    /// Makes its clock fast by this many parts per billion from now on.
    pub fn set_drift(&mut self, now: Time, drift_ppb: i32) {
        self.settings.drift_ppb = drift_ppb.clamp(-1_000_000, 1_000_000);
        self.clock.set_drift(now, self.settings.drift_ppb);
        self.renew_sync0();
    }

    /// Makes its clock jump by this many ns.
    pub fn jump_clock(&mut self, now: Time, by_ns: i64) {
        self.clock.jump(now, by_ns);
        self.renew_sync0();
    }

    /// Its system time in ns, as register 0910h shows it.
    pub fn system_time_ns(&self, now: Time) -> i64 {
        self.clock.at(now).wrapping_add(i64::from_le_bytes(array(&self.memory, register::DC_OFFSET.into())))
    }

    /// SYNC0 pulses since they were activated.
    pub fn sync0_count(&self) -> u64 {
        self.signals.count
    }

    /// The SII image as it is in its chip, to be damaged.
    pub fn sii_mut(&mut self) -> &mut [u8] {
        self.chip.image_mut()
    }

    /// Counts a frame that was damaged on the way to a port (0 to 3): in the counter of invalid frames.
    pub fn count_receive_error(&mut self, port: usize) {
        if port < 4 {
            self.count(register::RX_ERROR + 2 * port as u16);
        }
    }

    /// Counts one more, up to FFh.
    fn count(&mut self, at: u16) {
        let count = self.byte(at).saturating_add(1);
        self.set_byte(at, count);
    }

    /// Counts a frame with a datagram that cannot be.
    pub(super) fn count_bad_frame(&mut self) {
        self.count(register::PROCESSING_UNIT_ERROR);
    }

    /// Switches it on: registers and device as after power-on.
    pub fn power_on(&mut self, now: Time) {
        self.is_powered = true;
        self.memory.fill(0);
        self.fmmus = [Fmmu::default(); FMMUS];
        self.managers = [Manager::new(); MANAGERS];
        self.set_drift(now, self.settings.drift_ppb);
        self.clock = Clock::new(now, self.settings.clock_start_ns, self.settings.drift_ppb);
        self.signals = SyncSignals::default();
        self.renew_sync0();
        self.touched = Touched::default();
        let features = if self.has_dc { feature::DC | feature::DC_64 | 0x01c0 } else { 0x01c0 };
        self.set_byte(register::TYPE, 0x11);
        self.set_byte(register::FMMU_COUNT, FMMUS as u8);
        self.set_byte(register::SYNC_MANAGER_COUNT, MANAGERS as u8);
        self.set_byte(register::RAM_SIZE, RAM_KB);
        // Ports 0 and 1 are MII, 2 and 3 are not there.
        self.set_byte(register::PORT_DESCRIPTOR, 0x0f);
        self.set_word(register::FEATURES, features);
        self.set_byte(register::DL_CONTROL, 0x01);
        self.set_word(register::WATCHDOG_DIVIDER, 2498);
        self.set_word(register::WATCHDOG_PDI, 1000);
        self.set_word(register::WATCHDOG_SYNC_MANAGER, 1000);
        self.set_byte(register::WATCHDOG_STATUS, 1);
        self.set_word(register::DC_SPEED_START, 0x1000);
        self.set_byte(register::DC_FILTER_DEPTH, 4);
        let alias = self.chip.load();
        self.set_word(register::STATION_ALIAS, alias);
        self.restart_state();
        self.mailbox.reset();
        self.device.od_mut().restore_power_on_values(0, u16::MAX);
        self.device.reset(now, Reset::Node);
        self.show_links();
    }

    /// Switches it off: no frame passes it.
    pub fn switch_off(&mut self, now: Time) {
        if self.is_powered {
            self.device.set_operational(now, false);
            self.is_powered = false;
        }
    }

    pub(super) fn set_links(&mut self, links: Links) {
        let lost = |was: bool, is: bool| was && !is;
        if self.is_powered {
            if lost(self.links.towards_master, links.towards_master) {
                self.count(register::LOST_LINK);
            }
            if lost(self.links.away, links.away) {
                self.count(register::LOST_LINK + 1);
            }
        }
        self.links = links;
        self.show_links();
    }

    /// DL status: the device runs, link bits, and two bits a port: loop open with communication, or loop closed.
    fn show_links(&mut self) {
        let Links { towards_master, away } = self.links;
        let (towards_master, away) =
            if self.settings.manner.is_turned { (away, towards_master) } else { (towards_master, away) };
        let port = |is_linked: bool| if is_linked { 0b10 } else { 0b01 };
        let links = u16::from(towards_master) << 4 | u16::from(away) << 5;
        let loops = port(towards_master) << 8 | port(away) << 10 | 0b01 << 12 | 0b01 << 14;
        self.set_word(register::DL_STATUS, links | loops);
    }

    /// When to poll next.
    pub fn next_deadline(&self) -> Time {
        if !self.is_powered {
            return Time::NEVER;
        }
        self.next_sync0().min(self.state.next_deadline()).min(self.mailbox.due()).min(self.device.next_deadline())
    }

    /// When SYNC0 comes next.
    pub fn next_sync0(&self) -> Time {
        self.sync0_due
    }

    /// Works out anew when SYNC0 comes next: the clock, its offset or the signals have changed.
    fn renew_sync0(&mut self) {
        let offset = i64::from_le_bytes(array(&self.memory, register::DC_OFFSET.into()));
        let due = |next: i64| self.clock.moment_of(next.wrapping_sub(offset));
        self.sync0_due = self.signals.next.map_or(Time::NEVER, due);
    }

    /// Does what is due up to `now`, one thing after the other.
    pub fn poll(&mut self, now: Time) {
        for _ in 0..MOST_EVENTS {
            let next = self.next_deadline();
            if !self.is_powered || next > now {
                return;
            }
            self.poll_at(next, next);
        }
        // Nobody has looked for very long: what would have happened meanwhile is passed over.
        self.skip_sync0(now);
        self.poll_at(now, now);
    }

    fn poll_at(&mut self, now: Time, due: Time) {
        if self.next_sync0() <= due {
            let cycle = self.double(register::DC_SYNC0_CYCLE);
            self.signals.fire(cycle);
            self.renew_sync0();
            self.sync0(now);
        }
        self.device.poll(now);
        self.poll_state(now);
        self.poll_mailbox(now);
        // What could not be taken, since the mailbox of the answer is full, waits for that and not for time.
        if self.mailbox.due() <= now {
            self.mailbox.wait();
        }
    }

    fn skip_sync0(&mut self, now: Time) {
        let cycle = i64::from(self.double(register::DC_SYNC0_CYCLE));
        let system_time = self.system_time_ns(now);
        if let Some(next) = self.signals.next.filter(|next| *next <= system_time && cycle > 0) {
            let missed = system_time.wrapping_sub(next) / cycle + 1;
            self.signals.next = Some(next.wrapping_add(missed.wrapping_mul(cycle)));
            self.signals.count = self.signals.count.wrapping_add(missed as u64);
            self.renew_sync0();
        }
    }

    pub(super) fn begin_frame(&mut self, at: Time, back: Time) {
        (self.frame_at, self.frame_back) = (at, back);
        self.touched = Touched::default();
        if self.is_free_running() {
            self.give_inputs();
        }
    }

    /// Examines the changes of a frame after it has passed.
    pub(super) fn end_frame(&mut self, at: Time) {
        self.renew_sync0();
        let touched = std::mem::take(&mut self.touched);
        if touched.al_control {
            let control = AlControl(self.word(register::AL_CONTROL));
            self.request_state(at, control);
        }
        if touched.outputs {
            self.outputs_came(at);
        }
        if touched.mailbox {
            if self.managers[MAILBOX_OUT].is_full {
                self.mailbox.expect(at);
            }
            self.poll_mailbox(at);
        }
    }

    /// Processes a datagram that passes: header, data and working counter.
    pub(super) fn process(&mut self, header: &DatagramHeader, datagram: &mut [u8]) {
        use Command::*;
        let Some(command) = Command::from_byte(header.command) else { return };
        if matches!(command, Aprd | Apwr | Aprw | Brd | Bwr | Brw | Armw) {
            let next = header.adp().wrapping_add(1).to_le_bytes();
            if let Some(to) = datagram.get_mut(2..4) {
                to.copy_from_slice(&next);
            }
        }
        if self.is_silent {
            return;
        }
        let Some(end) = datagram.len().checked_sub(WORKING_COUNTER) else { return };
        let Some(data) = datagram.get_mut(DATAGRAM_HEADER..end) else { return };
        let is_first = header.adp() == 0;
        let is_station = self.is_station(header.adp());
        let ado = header.ado();
        let added = match command {
            Nop => 0,
            Aprd if is_first => self.read(ado, data, false),
            Fprd if is_station => self.read(ado, data, false),
            Brd => self.read(ado, data, true),
            Apwr if is_first => self.write(ado, data),
            Fpwr if is_station => self.write(ado, data),
            Bwr => self.write(ado, data),
            Aprw if is_first => self.read_write(ado, data, false),
            Fprw if is_station => self.read_write(ado, data, false),
            Brw => self.read_write(ado, data, true),
            Armw => {
                if is_first {
                    self.read(ado, data, false)
                } else {
                    self.write(ado, data)
                }
            }
            Frmw => {
                if is_station {
                    self.read(ado, data, false)
                } else {
                    self.write(ado, data)
                }
            }
            Lrd => self.logical(header.address, data, true, false),
            Lwr => self.logical(header.address, data, false, true),
            Lrw => self.logical(header.address, data, true, true),
            Aprd | Apwr | Aprw | Fprd | Fpwr | Fprw => 0,
        };
        if added > 0 {
            let counter = u16_at(datagram, end).wrapping_add(added).to_le_bytes();
            if let Some(to) = datagram.get_mut(end..) {
                to.copy_from_slice(&counter);
            }
        }
    }

    /// Whether an address is that of the station, or its alias where DL control lets that be one.
    fn is_station(&self, address: u16) -> bool {
        let has_alias = self.byte(register::DL_CONTROL + 3) & 1 != 0;
        address == self.word(register::STATION_ADDRESS) || has_alias && address == self.word(register::STATION_ALIAS)
    }

    fn byte(&self, at: u16) -> u8 {
        self.memory.get(usize::from(at)).copied().unwrap_or_default()
    }

    fn word(&self, at: u16) -> u16 {
        u16_at(&self.memory, at.into())
    }

    fn double(&self, at: u16) -> u32 {
        u32_at(&self.memory, at.into())
    }

    fn set_bytes(&mut self, at: u16, bytes: &[u8]) {
        let at = usize::from(at);
        if let Some(to) = self.memory.get_mut(at..at + bytes.len()) {
            to.copy_from_slice(bytes);
        }
    }

    fn set_byte(&mut self, at: u16, value: u8) {
        self.set_bytes(at, &[value]);
    }

    fn set_word(&mut self, at: u16, value: u16) {
        self.set_bytes(at, &value.to_le_bytes());
    }

    /// Updates the registers to the state of a sync manager.
    fn show_manager(&mut self, place: usize) {
        let Some(manager) = self.managers.get(place) else { return };
        let (status, held) = (manager.status(), u8::from(manager.is_held) | u8::from(manager.repeat_answered) << 1);
        let at = register::SYNC_MANAGER + (SyncManager::SIZE * place) as u16;
        self.set_byte(at + SyncManager::STATUS as u16, status);
        self.set_byte(at + SyncManager::PDI_CONTROL as u16, held);
    }
}
