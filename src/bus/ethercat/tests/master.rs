//! A whole master on a segment: the cycle, the guard and the walk of the drives do not know the bus.

use super::*;
use crate::bus::Master;
use crate::canopen::Frame;
use crate::cycle::Timing;
use crate::cycle::tests::position_cycle;
use crate::guard::{Fault, Request, State};
use yieldwall_drives::cia402;

/// A master and a segment.
struct Rig {
    master: Master,
    segment: Segment<SimulatedDevice>,
    now: Time,
    next_open: Time,
    /// Frames of CAN, of which there are none.
    can: Vec<Frame>,
    loses: bool,
}

impl Rig {
    /// All devices in OP.
    fn operational() -> Self {
        let (cycle, home) = position_cycle();
        let scaling = AxisScaling::new(100_000.0, Direction::Same, 0.0, 60.0).unwrap();
        let master = Master::on_segment(&setup(), home.map(|angle| (scaling, angle)), cycle).unwrap();
        let mut segment = Segment::new(Time(0), devices());
        for (place, angle) in home.into_iter().enumerate() {
            segment.controller_mut(place).unwrap().device_mut().drive_mut().unwrap().measure(angle, 0.0);
        }
        let now = Time(1000);
        let mut rig = Rig { master, segment, now, next_open: Time::NEVER, can: Vec::new(), loses: false };
        rig.master.start(rig.now, &mut rig.can);
        for _ in 0..200_000 {
            rig.advance(rig.now + Duration::from_micros(20));
            let first = rig.master.first_grid_point().unwrap();
            if *rig.master.phase() == Phase::Operational && first != Time::NEVER {
                rig.next_open = first;
                return rig;
            }
        }
        panic!("{:?}", rig.master.phase());
    }

    /// Sends what waits, and brings back what comes of it.
    fn exchange(&mut self) {
        for _ in 0..4 {
            let mut sent = Vec::new();
            self.master.drain_ethernet(|bytes| sent.push(bytes.to_vec()));
            for mut bytes in sent {
                let back = self.segment.process(self.now, &mut bytes);
                if let Some(back) = back.filter(|_| !self.loses) {
                    self.now = self.now.max(back);
                    self.master.on_ethernet(back, &bytes);
                }
            }
        }
    }

    fn advance(&mut self, until: Time) {
        self.now = self.now.max(until);
        self.segment.poll(self.now);
        self.master.poll(self.now, &mut self.can);
        self.exchange();
    }

    fn cycle(&mut self, request: Request) -> State {
        let open = self.next_open;
        self.advance(open);
        self.master.on_sync(&mut self.can);
        self.exchange();
        let compute = open + COMPUTE_AT;
        self.now = self.now.max(compute);
        self.segment.poll(self.now);
        self.master.on_compute(compute, request, Timing::default(), &mut self.can);
        self.exchange();
        self.next_open = Time((open + PERIOD).0.saturating_add_signed(self.master.grid_shift_ns()));
        assert!(self.can.is_empty());
        self.master.state()
    }

    fn cycles(&mut self, count: usize) -> State {
        for _ in 0..count {
            self.cycle(Request::None);
        }
        self.master.state()
    }

    /// A rig that runs.
    fn running() -> Self {
        let mut rig = Rig::operational();
        rig.cycles(5);
        rig.cycle(Request::Enable);
        assert_eq!(rig.cycles(50), State::Running, "{:?}", rig.master.cause());
        rig
    }

    fn drives(&mut self) -> [cia402::State; 2] {
        [0, 1].map(|place| self.segment.controller_mut(place).unwrap().device_mut().drive_mut().unwrap().state())
    }

    fn fault(&self) -> Option<Fault> {
        self.master.cause().map(|cause| cause.fault)
    }
}

#[test]
fn a_rig_is_enabled_and_runs() {
    let mut rig = Rig::running();
    assert_eq!(rig.drives(), [cia402::State::OperationEnabled; 2]);
    let inputs = rig.master.last_inputs();
    assert!(inputs.sample.is_some() && inputs.drives.iter().all(|drive| drive.angle_rad.is_some()));
    assert_eq!(inputs.link, LinkEvents::default());
    rig.cycle(Request::Stop);
    assert_eq!((rig.cycles(1000).is_latched(), rig.fault()), (true, Some(Fault::StopRequested)));
}

#[test]
fn frames_that_stay_away_stop_both_axes_and_then_the_drives_stop_by_themselves() {
    let mut rig = Rig::running();
    rig.loses = true;
    let stopped = rig.cycles(10);
    assert!(stopped.is_latched(), "{stopped:?}");
    assert_eq!(rig.fault(), Some(Fault::PdoMissed));
    let enabled = rig.drives().into_iter().filter(|state| *state == cia402::State::OperationEnabled).count();
    assert_eq!(enabled, 0, "the quick stop came to both");
}

#[test]
fn a_device_that_leaves_op_and_a_clock_that_jumps_stop_both_axes() {
    for what in 0..3 {
        let mut rig = Rig::running();
        let now = rig.now;
        match what {
            0 => rig.segment.controller_mut(1).unwrap().fail(now, AlStatusCode::SYNC_ERROR),
            place => rig.segment.controller_mut(place - 1).unwrap().jump_clock(now, 100_000),
        }
        let state = rig.cycles(60);
        assert!(state.is_latched(), "{what}: {state:?}");
        assert!(rig.drives().iter().all(|state| *state != cia402::State::OperationEnabled), "{what}");
        // Nothing is enabled again by itself.
        let state = rig.cycles(2000);
        assert!(state.is_latched() && rig.drives().iter().all(|state| *state != cia402::State::OperationEnabled));
    }
}
