//! A network of a third kind: what it takes to have one.

use super::*;
use yieldwall_fieldbus::Packet;
use yieldwall_fieldbus::canopen::Outbox;
use yieldwall_fieldbus::objects::{ObjectAnswer, ObjectError, ObjectRequest};
use yieldwall_motion::cycle::LinkEvents;
use yieldwall_motion::guard::{Device, DeviceSet, Directive};
use yieldwall_motion::sensing::RawSample;

/// Memory that the master shares with its devices: what was written last is there at the next cycle.
#[derive(Clone)]
struct Memory {
    phase: Phase,
    /// Statusword and position of each drive.
    drives: [DriveWords; 2],
    orders: [DriveOrders; 2],
    sequence: u8,
    /// The interface has told of a failure.
    has_failed: bool,
    is_silent: bool,
}

impl Network for Memory {
    fn phase(&self) -> &Phase {
        &self.phase
    }

    fn listening(&self) -> Duration {
        Duration::ZERO
    }

    fn start(&mut self, _: Time, _: &mut dyn Outbox) {
        self.phase = Phase::Operational;
    }

    fn next_deadline(&self) -> Time {
        Time::NEVER
    }

    fn poll(&mut self, _: Time, _: &mut dyn Outbox) {}

    fn waiting(&self, _: Time) -> Option<Waiting<'_>> {
        None
    }

    fn leave(&mut self, _: &mut dyn Outbox) {
        self.phase = Phase::Off;
    }

    fn on_packet(&mut self, _: Time, _: Packet<'_>, _: &mut dyn Outbox) {}

    fn on_link(&mut self, _: BusId, _: LinkEvent) {
        self.has_failed = true;
    }

    /// The drives act.
    fn open(&mut self, _: &mut dyn Outbox) {
        for (drive, orders) in self.drives.iter_mut().zip(self.orders) {
            let word = match orders.controlword & 0x8f {
                0x06 => 0x0231,
                0x07 => 0x0233,
                0x0f => 0x1237,
                _ => 0x0250,
            };
            drive.statusword = Some(word);
        }
    }

    fn missing(&self, _: Time) -> DeviceSet {
        DeviceSet::NONE
    }

    fn take(&mut self, _: Time) -> Arrived {
        self.sequence = self.sequence.wrapping_add(1);
        let sample =
            RawSample { counts: [0; 6], sequence: Some(self.sequence), overload: false, invalid: false, age_ns: 0 };
        let send_failed = if self.has_failed { DeviceSet::interface(0) } else { DeviceSet::NONE };
        let link = LinkEvents { send_failed, ..LinkEvents::default() };
        Arrived { drives: self.drives, sample: Some(sample), link }
    }

    fn heed(&mut self, _: State, directive: &Directive) {
        self.is_silent = directive.is_silent;
    }

    fn close(&mut self, _: Time, orders: &[DriveOrders; 2], _: &mut dyn Outbox) {
        self.orders = *orders;
    }

    fn is_silent(&self) -> bool {
        self.is_silent
    }

    fn is_in_flight(&self) -> bool {
        false
    }

    fn repeat_sync(&mut self, out: &mut dyn Outbox) {
        self.open(out);
    }

    fn repeat_set_points(&mut self, now: Time, orders: &[DriveOrders; 2], out: &mut dyn Outbox) {
        self.close(now, orders, out);
    }

    fn has(&self, _: Device) -> bool {
        true
    }

    fn ask(&mut self, _: Time, _: Device, _: ObjectRequest<'_>, _: &mut dyn Outbox) -> Result<(), ObjectError> {
        Err(ObjectError::NoObjects)
    }

    fn answer(&self, _: Device) -> ObjectAnswer<'_> {
        ObjectAnswer::NotAsked
    }

    fn told(&self) -> Vec<EmergencyReport> {
        Vec::new()
    }

    fn forget_told(&mut self) {}

    fn written(&self) -> Vec<Written> {
        Vec::new()
    }

    fn boxed(&self) -> Box<dyn Network> {
        Box::new(self.clone())
    }
}

/// Drives that stand where the arm's home is.
fn memory(home: [f64; 2]) -> Memory {
    let drives = home.map(|angle_rad| DriveWords {
        statusword: Some(0x0250),
        position: Some(scaling(0.0).counts(angle_rad).unwrap() as i32),
    });
    let orders = Default::default();
    Memory { phase: Phase::Off, drives, orders, sequence: 0, has_failed: false, is_silent: false }
}

/// A master on such a network, which is read back as it was last written.
struct Third {
    master: Master,
    now: Time,
    sent: Vec<Frame>,
}

impl Third {
    fn booted() -> Self {
        let (cycle, home) = torque_cycle();
        let networks = Networks::new(None, None).unwrap().with(Box::new(memory(home)));
        let axes = home.map(|angle_rad| axis(scaling(0.0), angle_rad));
        let mut third = Self { master: Master::on(networks, axes, cycle), now: Time(0), sent: Vec::new() };
        assert_eq!(*third.master.networks().phase(), Phase::Off);
        third.master.start(third.now, &mut third.sent);
        assert_eq!(*third.master.networks().phase(), Phase::Operational);
        third
    }

    fn cycle(&mut self, request: Request) -> Outputs {
        self.now = self.now + Duration::from_millis(1);
        self.master.networks_mut().open(&mut self.sent);
        self.master.on_compute(self.now, request, Timing::default(), &mut self.sent)
    }

    fn running() -> Self {
        let mut third = Self::booted();
        third.cycle(Request::None);
        third.cycle(Request::Enable);
        let enabled = (0..10).find(|_| {
            third.cycle(Request::None);
            third.master.state() == State::Running
        });
        assert!(enabled.is_some(), "{:?} {:?}", third.master.state(), third.master.cause());
        third
    }
}

#[test]
fn a_rig_on_a_network_of_a_third_kind_is_enabled_and_stopped_by_its_faults() {
    let mut third = Third::running();
    for _ in 0..100 {
        third.cycle(Request::None);
    }
    assert_eq!((third.master.state(), third.master.cause()), (State::Running, None));
    third.master.networks_mut().on_link(BusId::FIRST, LinkEvent::SendFailed);
    let outputs = third.cycle(Request::None);
    assert_eq!(third.master.cause().map(|cause| cause.fault), Some(Fault::LinkDown), "{outputs:?}");
    assert!(third.master.state().is_latched());
    assert_eq!(third.sent, [], "nothing goes to a CAN bus");
}

#[test]
fn of_several_networks_the_one_that_is_behind_counts() {
    let (_, home) = torque_cycle();
    let can = Networks::new(Some(&setup(CommandMode::Torque)), None).unwrap();
    let mut both = can.with(Box::new(memory(home)));
    let mut sent = Vec::new();
    both.start(Time(0), &mut sent);
    assert_eq!(*both.phase(), Phase::Resetting, "the CAN bus boots, and the other one is there");
    assert!(!both.missing(Time(0)).is_empty() && both.take(Time(0)).sample.is_some());
    let copy = both.clone();
    assert_eq!(*copy.phase(), Phase::Resetting);
    both.leave(&mut sent);
    assert_eq!((both.phase(), copy.phase()), (&Phase::Off, &Phase::Resetting));
}
