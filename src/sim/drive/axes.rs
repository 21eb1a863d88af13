//! The axes of one device: one dictionary and one place on the network, and a state machine, a control loop and a joint each.

use super::AxisView;
use super::device::Device;
use yieldwall_drives::cia402::State;
use yieldwall_fieldbus::canopen::{Application, HeartbeatEvent, NmtState};
use yieldwall_fieldbus::objects::{AbortCode, Address, ObjectDictionary, Reset, ServedDevice};
use yieldwall_fieldbus::time::Time;

/// PDOs of a direction that an axis has on CANopen.
pub(super) const PDOS: u8 = 4;

/// All axes of a device. The dictionary is with the axis in front; another one gets it while it acts.
#[derive(Clone, Debug)]
pub(super) struct Axes {
    front: Device,
    others: Vec<Device>,
}

impl Axes {
    /// Axes without a dictionary, and the dictionary of all of them.
    pub(super) fn new(mut front: Device, others: Vec<Device>, od: ObjectDictionary) -> Self {
        front.od = od;
        Self { front, others }
    }

    /// The axis in front.
    pub(super) fn front(&self) -> &Device {
        &self.front
    }

    /// The axis in front, to act on it.
    pub(super) fn front_mut(&mut self) -> &mut Device {
        &mut self.front
    }

    /// An axis; the first one is 0.
    pub(super) fn get(&self, axis: usize) -> Option<&Device> {
        match axis {
            0 => Some(&self.front),
            _ => self.others.get(axis - 1),
        }
    }

    /// State, torque and brake of an axis.
    pub(super) fn view(&self, axis: usize) -> Option<AxisView> {
        self.get(axis).map(|axis| AxisView::of(axis, &self.front.od))
    }

    /// Brings an axis to the front, and the one in front to its place.
    pub(super) fn exchange(&mut self, axis: usize) {
        if let Some(other) = axis.checked_sub(1).and_then(|place| self.others.get_mut(place)) {
            std::mem::swap(&mut self.front, other);
            std::mem::swap(&mut self.front.od, &mut other.od);
        }
    }

    /// Lets each axis act with the dictionary.
    pub(super) fn each(&mut self, mut act: impl FnMut(&mut Device)) {
        let Self { front, others } = self;
        act(front);
        for other in others {
            std::mem::swap(&mut front.od, &mut other.od);
            act(other);
            std::mem::swap(&mut front.od, &mut other.od);
        }
    }

    fn all(&self) -> impl Iterator<Item = &Device> {
        std::iter::once(&self.front).chain(&self.others)
    }

    /// Whether an axis is in this state.
    pub(super) fn any_is(&self, state: State) -> bool {
        self.all().any(|axis| axis.state() == state)
    }

    pub(super) fn next_deadline(&self) -> Time {
        self.all().map(Device::next_deadline).fold(Time::NEVER, Time::min)
    }

    pub(super) fn is_stale(&self) -> bool {
        self.all().any(|axis| axis.is_stale)
    }

    /// Whether a reset has left no axis in Fault.
    pub(super) fn take_reset(&mut self) -> bool {
        let mut was_reset = false;
        self.each(|axis| was_reset |= axis.take_reset());
        was_reset && !self.any_is(State::Fault) && !self.any_is(State::FaultReactionActive)
    }

    /// The error code of an axis that is to be sent.
    pub(super) fn take_emergency(&mut self) -> Option<u16> {
        let Self { front, others } = self;
        std::iter::once(front).chain(others).find_map(Device::take_emergency)
    }

    /// Number of the first PDO of an axis whose statusword has changed, an axis a call.
    pub(super) fn take_status_change(&mut self) -> Option<u8> {
        let Self { front, others } = self;
        std::iter::once(front).chain(others).find_map(|axis| axis.take_status_change().then_some(axis.first_pdo))
    }

    /// Lets an axis act on its outputs that came by the PDO of this number, or each one by what came for all.
    fn with_outputs(&mut self, number: u8, mut act: impl FnMut(&mut Device)) {
        let is_one = self.others.is_empty();
        self.each(|axis| {
            if is_one || (axis.first_pdo..axis.first_pdo + PDOS).contains(&number) {
                act(axis);
            }
        });
    }
}

impl ServedDevice for Axes {
    fn od(&self) -> &ObjectDictionary {
        &self.front.od
    }

    fn od_mut(&mut self) -> &mut ObjectDictionary {
        &mut self.front.od
    }

    fn before_write(&mut self, at: Address, data: &[u8]) -> Result<(), AbortCode> {
        let mut taken = Ok(());
        self.each(|axis| taken = taken.and_then(|()| axis.before_write(at, data)));
        taken
    }

    fn after_write(&mut self, at: Address) {
        self.each(|axis| axis.after_write(at));
    }

    fn before_read(&mut self, at: Address) -> Result<(), AbortCode> {
        let mut read = Ok(());
        self.each(|axis| read = read.and_then(|()| axis.before_read(at)));
        read
    }

    fn outputs_applied(&mut self, now: Time, number: u8) {
        self.with_outputs(number, |axis| axis.outputs_applied(now, number));
    }

    fn outputs_late(&mut self, now: Time, number: u8) {
        self.with_outputs(number, |axis| axis.outputs_late(now, number));
    }

    fn sample(&mut self, now: Time) {
        self.each(|axis| axis.sample(now));
    }

    fn reset(&mut self, now: Time, reset: Reset) {
        self.each(|axis| axis.reset(now, reset));
    }
}

impl Application for Axes {
    fn on_nmt(&mut self, now: Time, state: NmtState) {
        self.each(|axis| axis.on_nmt(now, state));
    }

    fn on_heartbeat_event(&mut self, now: Time, event: HeartbeatEvent) {
        self.each(|axis| axis.on_heartbeat_event(now, event));
    }

    fn on_life_guarding(&mut self, now: Time, is_lost: bool) {
        self.each(|axis| axis.on_life_guarding(now, is_lost));
    }
}
