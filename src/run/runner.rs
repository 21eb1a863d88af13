//! The loop.

mod alone;
mod arrivals;
mod cycle;
mod motion_bound;
mod network;
mod objects;
mod permission;

use std::any::Any;
use std::time::Duration;

use super::conduct::Enabling;
use super::drilled::watchdogs;
use super::error::RunError;
use super::inquiry::{ErrorWatch, Inquiry};
use super::metronome::Metronome;
use super::pace::Pace;
use super::permit::{Boot, Permit};
use super::place::{OnLink, Place, Process, VirtualPlace};
use super::sensor::Tared;
use super::standstill::{LEAST, StandstillWatch};
use crate::assembly::{homing_master, master, request_timeouts};
pub use alone::ANNOUNCED;
use motion_bound::MotionBound;
pub use network::END_OF_WATCH;
use yieldwall_bus::{LinkEvent, Master, Waiting};
use yieldwall_config as config;
use yieldwall_drives::profiles::Tried;
use yieldwall_drives::watchdog::Watchdog;
use yieldwall_fieldbus::canopen::BusId;
use yieldwall_fieldbus::ethercat::frame::LONGEST;
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{LinkOutbox, Packet, SendError, Wires};
use yieldwall_motion::cycle::{LeadLimits, Outputs, Timing};
use yieldwall_motion::guard::{Cause, DeviceSet, State};
use yieldwall_motion::quantity::JointAngles;
use yieldwall_record::{CycleRecord, Stages, Standstill};

/// Receives every frame that went over a wire, with the moment of its end. A frame of an EtherCAT segment comes twice: as sent and
/// as returned.
pub type Tap = Box<dyn FnMut(Time, Packet<'_>) + Send>;

/// Receives the record of every cycle, right after the cycle has run.
pub type Observer = Box<dyn FnMut(&CycleRecord) + Send>;

/// Receives the reason why the boot waits, ten times a second, and `None` when the boot is over. It returns whether a person asked
/// for the end, and the boot then ends.
pub type BootWatch = Box<dyn FnMut(Option<Waiting<'_>>) -> bool + Send>;

/// Counters of a link, besides its frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounts {
    /// Frames of other nodes.
    pub received: u64,
    /// Own frames that were seen on the bus.
    pub echoed: u64,
    /// Frames that were lost because the program did not take them in time.
    pub overflowed: u64,
    /// Frames that could not be sent.
    pub refused: u64,
}

/// A rig at a place.
///
/// [`Runner::boot`] brings the network up, and every [`Runner::run_cycle`] is one period. Under [`Pace::Free`] the periods are
/// those of the place's clock. Under [`Pace::Lockstep`] a cycle waits for its process data, however long they take, and time
/// advances by one period: for simulated devices on a computer of any speed.
pub struct Runner<P: ?Sized> {
    pub(super) master: Master,
    /// Whether the place is a [`VirtualPlace`].
    pub(super) is_virtual: bool,
    pace: Pace,
    pub(super) period: Duration,
    pub(super) compute_at: Duration,
    pub(super) started: Time,
    /// Whether time waits for the process data.
    waits: bool,
    /// Time since switching on, if the clock waits for process data.
    lockstep_now: Time,
    /// Grid point of the next cycle, since switching on.
    pub(super) next_sync: Time,
    cycles: u64,
    scene_from: Option<Time>,
    timing: Timing,
    /// Stages of the present cycle.
    stages: Stages,
    suspended: Duration,
    /// Devices for which lockstep waited in vain.
    absent: DeviceSet,
    /// Last time at which the link was read, on its clock, if time waits.
    looked_at: Time,
    /// End of the last time in which the process was stopped: earlier frames come from it.
    back_since: Time,
    standstill: StandstillWatch,
    /// The fault of the last cycle, and the standstill before it.
    cause: Option<Cause>,
    stood: Option<Standstill>,
    counts: LinkCounts,
    /// Last received frame of the segment.
    buffer: Box<[u8; LONGEST]>,
    tap: Option<Tap>,
    observer: Option<Observer>,
    boot_watch: Option<BootWatch>,
    pub(super) error_watch: Option<ErrorWatch>,
    /// Reports of the drives on the last fault.
    pub(super) inquiry: Inquiry,
    pub(super) enabling: Enabling,
    /// How the force sensor is tared before the rig is enabled, if it is.
    pub(super) tared: Option<Tared>,
    /// Whether a person has confirmed the torque limits that drives keep by themselves.
    pub(super) accepts_drive_limits: bool,
    /// Whether joints are guided in place of the fixture, so that no force moves them.
    pub(super) leads: bool,
    /// Whether each drive's profile is one of simulated drives.
    pub(super) has_simulated_profile: [bool; 2],
    /// Watchdogs by which the drives watch their master.
    pub(super) watchdogs: &'static [Watchdog],
    /// How long a drill asks each drive that does not answer.
    pub(super) patience: [Duration; 2],
    /// Boot to which a permit must belong.
    boot: Boot,
    last: Option<Outputs>,
    /// How far the rig may be guided, if it was enabled for less than all.
    motion_bound: Option<MotionBound>,
    /// State of the process at the last grid point.
    pub(super) process: Process,
    has_panicked: bool,
    panic: Option<Box<dyn Any + Send>>,
    /// How long the runner listens for another master before it sends anything.
    listening: Duration,
    /// Whether it has listened, and no other master was heard since.
    has_listened: bool,
    /// Last, so that a runner of any place can be a `Runner<dyn Place>`.
    pub(super) place: P,
}

/// Returns a master at a pace.
fn paced(mut master: Master, pace: Pace) -> Master {
    if pace == Pace::Lockstep {
        // Nothing has to be in time there, and while the network is booted time is that of a computer that may be slow.
        master.networks_mut().set_lockstep();
    }
    master
}

impl<L: Wires, M: Metronome> Runner<OnLink<L, M>> {
    /// Creates a rig on a computer that has sent nothing yet.
    ///
    /// # Errors
    /// If parts of the configuration do not fit together.
    pub fn on_link(rig: &config::Rig, link: L, metronome: M, pace: Pace) -> Result<Self, RunError> {
        Self::assembled(rig, &rig.fixture, OnLink { link, metronome }, pace, false)
    }
}

impl<P: VirtualPlace> Runner<P> {
    /// Creates a rig in virtual time that has sent nothing yet, with the file's fixture or another.
    ///
    /// # Errors
    /// If parts of the configuration do not fit together.
    pub fn in_virtual_time(rig: &config::Rig, fixture: &config::Fixture, place: P) -> Result<Self, RunError> {
        Self::assembled(rig, fixture, place, Pace::Free, true)
    }

    /// Returns the place, to change it.
    pub fn place_mut(&mut self) -> &mut P {
        &mut self.place
    }

    /// Returns the panic of a cycle, once.
    pub fn take_panic(&mut self) -> Option<Box<dyn Any + Send>> {
        self.panic.take()
    }
}

impl<P: Place> Runner<P> {
    fn assembled(
        rig: &config::Rig,
        fixture: &config::Fixture,
        place: P,
        pace: Pace,
        is_virtual: bool,
    ) -> Result<Self, RunError> {
        let (started, suspended) = (place.now(), place.suspended());
        let mut master = paced(master(rig, fixture)?, pace);
        master.networks_mut().set_source(place.source());
        let listening = master.networks().listening();
        Ok(Self {
            master,
            is_virtual,
            pace,
            period: Duration::from_micros(rig.cycle.period_us.into()),
            compute_at: Duration::from_micros(rig.cycle.compute_at_us.into()),
            started,
            waits: false,
            lockstep_now: Time(0),
            next_sync: Time::NEVER,
            cycles: 0,
            scene_from: None,
            timing: Timing::default(),
            stages: Stages::default(),
            suspended,
            absent: DeviceSet::NONE,
            looked_at: started,
            back_since: Time(0),
            standstill: StandstillWatch::new(),
            cause: None,
            stood: None,
            counts: LinkCounts::default(),
            buffer: Box::new([0; LONGEST]),
            tap: None,
            observer: None,
            boot_watch: None,
            error_watch: None,
            inquiry: Inquiry::new(),
            enabling: Enabling::new(rig),
            tared: Tared::of(rig),
            accepts_drive_limits: is_virtual,
            leads: false,
            has_simulated_profile: rig
                .drives
                .each_ref()
                .map(|drive| drive.profile.get().is_some_and(|profile| profile.profile.tried == Tried::Simulation)),
            watchdogs: watchdogs(rig),
            patience: request_timeouts(rig)?.map(|timeout| timeout * 2),
            boot: Boot::NONE,
            last: None,
            motion_bound: None,
            process: Process::Runs,
            has_panicked: false,
            panic: None,
            listening,
            has_listened: false,
            place,
        })
    }
}

impl<P: Place + ?Sized> Runner<P> {
    /// Makes the next boots bring the drives up in homing mode, for [`bringup::home`](fn@crate::bringup::home). Nothing is sent.
    ///
    /// # Errors
    /// If a drive has no homing.
    pub fn prepare_homing(&mut self, rig: &config::Rig) -> Result<(), RunError> {
        self.master = paced(homing_master(rig)?, self.pace);
        Ok(())
    }

    /// Makes later boots bring the drives up in the rig's own mode again. Nothing is sent.
    pub(super) fn prepare_leading(&mut self, rig: &config::Rig) -> Result<(), RunError> {
        self.master = paced(master(rig, &rig.fixture)?, self.pace);
        Ok(())
    }

    /// Watches the joints while the drives move them by themselves, as [`Master::home`].
    pub(super) fn watch_homing(&mut self, jump_rad: Option<f64>) {
        // No force moves them.
        self.leads = jump_rad.is_some();
        self.master.home(jump_rad);
    }

    /// Leaves the watch of the joints' travel to the caller alone.
    pub(super) fn unbind_motion(&mut self) {
        self.motion_bound = None;
    }

    /// Passes every frame to `tap` from now on; own frames when they were seen on the bus.
    pub fn set_tap(&mut self, tap: Tap) {
        self.tap = Some(tap);
    }

    /// Passes the record of every cycle to `observer` from now on.
    pub fn set_observer(&mut self, observer: Observer) {
        self.observer = Some(observer);
    }

    /// Reports every boot to `watch` from now on.
    pub fn set_boot_watch(&mut self, watch: BootWatch) {
        self.boot_watch = Some(watch);
    }

    /// Allows a first motion of drives that keep their own torque limit, without a lower one: a person has confirmed it.
    pub fn accept_drive_limits(&mut self) {
        self.accepts_drive_limits = true;
    }

    /// Checks that a permit is of the present boot of this rig. A cycle with a permit of another boot asks for nothing.
    ///
    /// # Errors
    /// [`RunError::OldPermit`] if not.
    ///
    /// Real-time: yes.
    pub fn check_permit(&self, permit: &Permit) -> Result<(), RunError> {
        if permit.is_of(self.boot) { Ok(()) } else { Err(RunError::OldPermit) }
    }

    /// Returns the state of the supervisor; [`State::Lost`] if its process never runs again, since the drives' watchdogs act.
    pub fn state(&self) -> State {
        match self.master.state() {
            state if state.is_latched() || self.process != Process::Dead => state,
            _ => State::Lost,
        }
    }

    /// Returns the fault that caused the present state.
    pub fn cause(&self) -> Option<Cause> {
        self.master.cause()
    }

    /// Returns the master, for reports.
    pub fn master(&self) -> &Master {
        &self.master
    }

    /// Guides the joints in place of the fixture, as [`Cycle::lead`](yieldwall_motion::cycle::Cycle::lead).
    pub(super) fn lead(&mut self, limits: Option<LeadLimits>) {
        self.leads = limits.is_some();
        self.master.cycle_mut().lead(limits);
    }

    /// Returns the longest standstill in the seconds before the last fault: time in which the loop was due and the computer did not
    /// run it. A standstill lasts at least a cycle by the wall clock, or a tenth of a second in lockstep; `None` if there was none.
    pub fn standstill_before_fault(&self) -> Option<Standstill> {
        self.stood
    }

    /// Returns the longest standstill of the last seconds that can explain a missing answer of a device: at least a tenth of a
    /// second.
    pub fn standstill(&self) -> Option<Standstill> {
        self.standstill.last(self.place.now(), LEAST)
    }

    /// Returns the counters of the link.
    pub fn counts(&self) -> LinkCounts {
        self.counts
    }

    /// Returns the place.
    pub fn place(&self) -> &P {
        &self.place
    }

    /// Whether a cycle has panicked: no cycle computes anything any more.
    pub fn has_panicked(&self) -> bool {
        self.has_panicked
    }

    /// Returns the grid point of the next cycle, since switching on; [`Time::NEVER`] before the first one is known.
    pub fn next_sync(&self) -> Time {
        self.next_sync
    }

    /// Returns the time base of the runner.
    pub fn pace(&self) -> Pace {
        self.pace
    }

    /// Returns the cycle time.
    pub fn period(&self) -> Duration {
        self.period
    }

    /// Returns the outputs of the last cycle.
    pub fn last_outputs(&self) -> Option<&Outputs> {
        self.last.as_ref()
    }

    /// Returns the last measured angles.
    pub(super) fn angles(&self) -> JointAngles {
        self.last.as_ref().map_or(JointAngles::default(), |outputs| outputs.signals.measured_angles)
    }

    /// Returns the angles to which the joints are guided.
    pub(super) fn led_angles(&self) -> JointAngles {
        self.last.as_ref().map_or(JointAngles::default(), |outputs| outputs.signals.target_angles)
    }

    /// Makes the scene begin with the next cycle; records count their time from there.
    pub fn begin_scene(&mut self) {
        self.scene_from = Some(self.next_sync);
    }

    /// Returns the time since switching on.
    pub(super) fn now(&self) -> Time {
        if self.waits { self.lockstep_now } else { Time(self.place.now().since(self.started).as_nanos() as u64) }
    }

    pub(super) fn sleep_until(&mut self, moment: Time) {
        self.place.sleep_until(self.started + moment.since(Time(0)), Time::NEVER);
    }

    /// Returns the number of grid points after `grid` and before a moment. A grid point at that moment does not count.
    pub(super) fn periods_between(&self, grid: Time, moment: Time) -> u32 {
        let periods = moment.since(grid).as_nanos().div_ceil(self.period.as_nanos().max(1));
        periods.saturating_sub(1).min(u128::from(u32::MAX / 2)) as u32
    }

    /// Lets the master send; the next cycle learns of a frame that could not be sent.
    pub(super) fn send<R>(&mut self, act: impl FnOnce(&mut Master, Time, &mut LinkOutbox<'_, P>) -> R) -> R {
        let now = self.now();
        let mut out = LinkOutbox::new(&mut self.place);
        let result = act(&mut self.master, now, &mut out);
        let failed = out.failed_buses();
        self.counts.refused += u64::from(out.failure().is_some());
        failed.for_each(|bus| self.master.networks_mut().on_link(bus, LinkEvent::SendFailed));
        if let Err((bus, _)) = self.send_ethernet(now) {
            self.counts.refused += 1;
            self.master.networks_mut().on_link(bus, LinkEvent::SendFailed);
        }
        result
    }

    /// Sends the master's frames for its segment, up to the first frame that could not be sent.
    fn send_ethernet(&mut self, now: Time) -> Result<(), (BusId, SendError)> {
        let Self { master, place, tap, .. } = self;
        let mut sent = Ok(());
        master.networks_mut().drain(&mut |bus, bytes| {
            if sent.is_ok() {
                sent = place.send_ethernet(bytes).map_err(|error| (bus, error));
                if let (Ok(()), Some(tap)) = (&sent, &mut *tap) {
                    tap(now, Packet::Ethernet { bus, bytes });
                }
            }
        });
        sent
    }

    /// Lets the master send, and returns an error if a frame could not be sent.
    pub(super) fn send_or_fail(
        &mut self,
        act: impl FnOnce(&mut Master, Time, &mut LinkOutbox<'_, P>),
    ) -> Result<(), RunError> {
        let now = self.now();
        let mut out = LinkOutbox::new(&mut self.place);
        act(&mut self.master, now, &mut out);
        let sent = out.failure().map_or(Ok(()), Err);
        sent.and(self.send_ethernet(now)).map_err(|(bus, error)| RunError::Send { bus, error })
    }
}
