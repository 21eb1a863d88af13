//! What runs in every cycle does not allocate.
//!
//! One test in one program: the counter counts for the thread that asks, so that the harness does not disturb it.
#![allow(unsafe_code)] // A global allocator cannot be written without; this one only counts and passes on.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use hil_tests::{
    Scenario,
    cable::{Cable, permit},
    segment::{Bench, Mastered},
};
use nalgebra::Vector2;
use yieldwall::canopen::{Frame, Outbox};
use yieldwall::cycle::{Cycle, DriveSample, Inputs, LinkEvents, Timing};
use yieldwall::elementary;
use yieldwall::ethercat::AlStatusCode;
use yieldwall::fixture::{Admittance, Chain, Coupling, Curvature, Fixture, Forbidden, Limits, Parameters, Rearm, Side};
use yieldwall::guard::{Device, DeviceSet, Request, State};
use yieldwall::injection::{Injection, Kind};
use yieldwall::link::{Arrival, CanLink, SendError, Wires};
use yieldwall::objects::{Address, ObjectAnswer, ObjectRequest};
use yieldwall::record::CycleRecord;
use yieldwall::record::recording::{Backpressure, Feed, Sink};
use yieldwall::rig::{DeviceServer, EmbeddedRig};
use yieldwall::run::{Ask, Enable, Enabling, Metronome, Pace, Runner};
use yieldwall::sensing::RawSample;
use yieldwall::time::Time;
use yieldwall_drives::cia402;

const CYCLES: usize = 100_000;

thread_local! {
    /// Calls of the allocator since counting began; `None` while nobody counts.
    static COUNT: Cell<Option<u64>> = const { Cell::new(None) };
}

/// The system's allocator with a counter.
struct Counting;

impl Counting {
    fn note() {
        // The thread may be past the end of its own storage.
        let _ = COUNT.try_with(|count| count.set(count.get().map(|calls| calls + 1)));
    }
}

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        Counting::note();
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        Counting::note();
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        Counting::note();
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Calls of the allocator in `act`, on this thread.
fn calls(act: impl FnOnce()) -> u64 {
    COUNT.set(Some(0));
    act();
    COUNT.take().unwrap_or_default()
}

fn inputs(cycle: usize, angles: [f64; 2], state: cia402::State) -> Inputs {
    // A hand that pushes round in circles, beyond R every now and then, and a frame that is missing now and then.
    let turn = cycle as f64 * 2e-3;
    let force = 2000.0 + 2500.0 * elementary::sin(turn * 0.1);
    let counts = [(force * elementary::cos(turn)) as i32, (force * elementary::sin(turn)) as i32, 0, 0, 0, 0];
    let is_lost = |every: usize| cycle % every == every - 1;
    Inputs {
        drives: [0, 1].map(|joint| DriveSample {
            angle_rad: (!is_lost(977)).then_some(angles[joint]),
            state,
            follows_command: true,
            has_voltage: true,
            has_warning: is_lost(701),
        }),
        sample: (!is_lost(499)).then_some(RawSample {
            counts,
            sequence: Some(cycle as u8),
            overload: is_lost(20_011),
            invalid: is_lost(20_017),
            age_ns: 420_000,
        }),
        link: LinkEvents {
            bad_length: DeviceSet::SENSOR.only_if(is_lost(30_011)),
            emergency: DeviceSet::SENSOR.only_if(is_lost(40_009)),
            ..LinkEvents::default()
        },
        timing: Timing::default(),
        // A person who resets and enables after every fault.
        request: match cycle % 1000 {
            200 => Request::Reset,
            210 => Request::Enable,
            _ => Request::None,
        },
    }
}

fn run_cycles(cycle: &mut Cycle, start: [f64; 2]) -> [usize; 8] {
    let (mut angles, mut state) = (start, cia402::State::ReadyToSwitchOn);
    let mut visits = [0; 8];
    for at in 0..CYCLES {
        let outputs = cycle.step(&inputs(at, angles, state));
        visits[outputs.directive.state as usize] += 1;
        angles = outputs.signals.target_angles.to_array();
        state = match outputs.directive.goal {
            cia402::Goal::OperationEnabled => cia402::State::OperationEnabled,
            cia402::Goal::SwitchedOn => cia402::State::SwitchedOn,
            cia402::Goal::QuickStop => cia402::State::QuickStopActive,
            _ => cia402::State::ReadyToSwitchOn,
        };
    }
    visits
}

fn the_cycle_does_not_allocate(scenario: &Scenario) {
    let mut cycle = yieldwall::assembly::cycle(&scenario.rig, &scenario.rig.fixture).expect("a shipped rig");
    let start = {
        let geometry = scenario.rig.linkage.geometry();
        let linkage = yieldwall::linkage::FiveBar::new(geometry).expect("a shipped linkage");
        linkage.inverse(yieldwall::quantity::TipPoint::new(0.05, 0.02)).expect("a point in reach").to_array()
    };
    let mut visits = [0; 8];
    let count = calls(|| visits = run_cycles(&mut cycle, start));
    println!("{}: {count} calls in {CYCLES} cycles, states {visits:?}", scenario.file);
    assert!(visits[State::Running as usize] > CYCLES / 4, "it ran: {visits:?}");
    for state in [State::Idle, State::Enabling, State::Holding, State::Stopping, State::Stopped] {
        assert!(visits[state as usize] > 0, "{state:?} was visited: {visits:?}");
    }
    assert_eq!(count, 0, "{}: calls of the allocator in {CYCLES} cycles", scenario.file);
}

/// A fixture whose surface has pieces: over and along it, and through the middle, where all are equally near.
fn the_fixture_does_not_allocate(pieces: usize) {
    let ring: Vec<_> = (0..pieces)
        .map(|index| {
            let angle = index as f64 / pieces as f64 * std::f64::consts::TAU;
            Vector2::new(elementary::cos(angle), elementary::sin(angle)) * 0.1
        })
        .collect();
    let parameters = Parameters {
        coupling: Coupling::Admittance(Admittance { mass_kg: 2.0 }),
        limits: Limits { friction_n: 3.0, yield_n: 20.0 },
        side: Side::Bilateral,
        hold_steps: 100,
        rearm: Rearm::default(),
        curvature: Curvature::Tangent,
        period_s: 1e-3,
    };
    let polygon = Chain::polygon(&ring, Forbidden::Inside).expect("a polygon");
    let mut fixture = Fixture::new(polygon, parameters).expect("a fixture");
    let mut on_surface = 0;
    let count = calls(|| {
        for step in 0..20_000 {
            if step % 2000 == 0 {
                fixture.reset(&Vector2::zeros()).expect("a finite start");
            }
            let turn = f64::from(step) * 1e-3;
            let target =
                Vector2::new(elementary::cos(turn), elementary::sin(turn)) * (0.2 * elementary::sin(3.0 * turn));
            let step = fixture.step_admittance(&((target - fixture.proxy()) * 300.0));
            on_surface += usize::from(step.signed_distance_m == 0.0);
        }
    });
    assert!(on_surface > 100, "{on_surface} steps end on the surface");
    assert_eq!(count, 0, "calls of the allocator of a fixture on {pieces} pieces");
}

/// An outbox of fixed size, as a real interface has one.
#[derive(Default)]
struct Fixed {
    frames: [Frame; 8],
    len: usize,
}

impl Outbox for Fixed {
    fn push(&mut self, frame: Frame) {
        if let Some(place) = self.frames.get_mut(self.len) {
            *place = frame;
            self.len += 1;
        }
    }
}

/// Takes records and forgets them.
struct Forget(u64);

impl Sink<CycleRecord> for Forget {
    type Report = ();

    fn take(&mut self, _: &CycleRecord) -> std::io::Result<()> {
        self.0 += 1;
        Ok(())
    }

    fn finish(&mut self) -> std::io::Result<()> {
        Ok(())
    }

    fn stored(&self) -> u64 {
        self.0
    }

    fn report(self) {}
}

/// The cable with devices at its end, whose own calls of the allocator do not count: they are another process on a real bus.
struct Uncounted(Cable);

impl Uncounted {
    fn beyond<R>(&mut self, act: impl FnOnce(&mut Cable) -> R) -> R {
        let count = COUNT.take();
        let result = act(&mut self.0);
        COUNT.set(count);
        result
    }
}

impl CanLink for Uncounted {
    fn now(&self) -> Time {
        self.0.now()
    }

    fn receive(&mut self) -> Option<Arrival> {
        self.beyond(Cable::receive)
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        self.beyond(|cable| cable.send(frame))
    }

    fn wait(&mut self, until: Time) -> bool {
        self.beyond(|cable| cable.wait(until))
    }
}

impl Wires for Uncounted {}

impl Metronome for Uncounted {
    fn sleep_until(&mut self, moment: Time) {
        self.beyond(|cable| cable.sleep_until(moment));
    }

    fn suspended(&self) -> Duration {
        self.0.suspended()
    }
}

/// The loop for a real bus: link, master, cycle, records; in motion, through a node that resets itself, and at rest.
fn the_loop_does_not_allocate(scenario: &Scenario, pace: Pace) {
    let server = DeviceServer::new(&scenario.rig, &scenario.scene, scenario.seed, pace).expect("a shipped rig");
    let cable = Cable::new(server);
    let ends = [(), ()].map(|()| Uncounted(cable.clone()));
    let [link, metronome] = ends;
    let mut live = Runner::on_link(&scenario.rig, link, metronome, pace).expect("a shipped rig");
    let (mut ring, feed) = Feed::start("test", 512, Backpressure::Drop, Forget(0)).expect("a thread");
    live.set_observer(Box::new(move |record| ring.push(record)));
    let seen = Arc::new(AtomicU64::new(0));
    let frames = Arc::clone(&seen);
    live.set_tap(Box::new(move |_, _| {
        frames.fetch_add(1, Ordering::Relaxed);
    }));
    live.boot().expect("all devices are there");
    let permit = permit(&live);
    let mut enabling = Enabling::new(&scenario.rig);
    while let Enable::Ask(ask) = enabling.next(live.state(), &permit) {
        live.run_cycle(ask);
    }
    let run = |live: &mut Runner<_>, cycles: u32| {
        calls(|| {
            for _ in 0..cycles {
                live.run_cycle(Ask::Nothing);
            }
        })
    };
    let count = run(&mut live, 3000);
    assert_eq!((live.state(), count), (State::Running, 0), "{} {pace:?} in motion", scenario.file);
    cable.set_passage(|_, is_master, frame| is_master || frame.id() & 0x7f != 1);
    let count = run(&mut live, 500);
    assert!(live.state().is_latched());
    assert_eq!(count, 0, "{} {pace:?} without one node", scenario.file);
    cable.set_down(true);
    assert_eq!(run(&mut live, 100), 0, "{} {pace:?} without the interface", scenario.file);
    assert!(seen.load(Ordering::Relaxed) > 20_000, "the tap was used");
    feed.finish().expect("the thread ends");
}

/// The whole embedded rig, master and simulated devices alike, and frames that a master gets from strangers.
fn the_rig_does_not_allocate(scenario: &Scenario) {
    let mut machine =
        EmbeddedRig::new(&scenario.rig, &scenario.scene, &scenario.rig.fixture, scenario.seed).expect("a shipped rig");
    // As a page has it: a ring that a thread empties into the stream of its clients.
    let (_stream, sink) = yieldwall_view::stream::<CycleRecord>();
    let (mut ring, feed) = Feed::start("view", yieldwall_view::RING, Backpressure::Drop, sink).expect("a thread");
    machine.set_observer(Box::new(move |record| ring.push(record)));
    machine.enable().expect("it is enabled");
    // Queues have grown to their size by then.
    for _ in 0..100 {
        machine.run_cycle(Request::None).expect("it goes on");
    }
    let cycles = CYCLES / 4;
    let count = calls(|| {
        for _ in 0..cycles {
            machine.run_cycle(Request::None).expect("it goes on");
        }
    });
    println!("{}: {count} calls in {cycles} cycles of the whole rig", scenario.file);
    assert_eq!(machine.state(), State::Running);
    assert_eq!(count, 0, "{}: calls of the allocator in {cycles} cycles of the whole rig", scenario.file);
    machine.inject(Injection::new(Kind::DriveFault, machine.scene_time_s())).expect("a drive can fail");
    let count = calls(|| {
        for request in (0..2000).map(|at| if at == 1000 { Request::Reset } else { Request::None }) {
            machine.run_cycle(request).expect("it goes on");
        }
    });
    assert_eq!(count, 0, "{}: calls of the allocator on the way through a fault", scenario.file);
    let counts = feed.finish().expect("the thread ends").counts;
    assert!(counts.kept > 0, "the ring was used: {counts:?}");
}

/// The virtual EtherCAT segment: cycles with process data, clocks and mailbox, a device that leaves OP, and is kept there.
fn the_segment_does_not_allocate() {
    let mut bench = Bench::operational();
    let count = calls(|| {
        (0..2000).for_each(|_| bench.cycle());
        bench.segment.controllers_mut().for_each(|controller| controller.fail(Time(0), AlStatusCode::NO_INPUTS));
        (0..100).for_each(|_| bench.cycle());
    });
    assert_eq!(count, 0, "calls of the allocator in 2100 cycles of an EtherCAT segment");
    let status = bench.segment.controller(0).map(|controller| controller.al_status().to_string());
    assert_eq!(status.as_deref(), Some("SAFE-OP+ERR"));
}

/// The master of a segment: input frame, output frame and what is asked beside them, objects too, through a device that leaves OP and one that
/// is silent.
fn the_master_of_a_segment_does_not_allocate() {
    let mut bench = Mastered::operational();
    let before = bench.network.counts().returned;
    // Four bytes, 278 in segments, and one that is written.
    let limit = [0x2c, 1];
    let asked = [
        (Device::LeftDrive, ObjectRequest::Read(Address::new(0x6072, 0))),
        (Device::Sensor, ObjectRequest::Read(Address::new(0x2041, 0))),
        (Device::RightDrive, ObjectRequest::Write(Address::new(0x6072, 0), &limit)),
    ];
    let mut answered = [0; 3];
    let count = calls(|| {
        for _ in 0..20_000 {
            bench.step();
            for ((device, request), answered) in asked.into_iter().zip(&mut answered) {
                if bench.network.answer(device) != ObjectAnswer::Pending {
                    *answered += u32::from(matches!(bench.network.answer(device), ObjectAnswer::Done(_)));
                    bench.network.ask(bench.now, device, request).unwrap_or_default();
                }
            }
        }
        bench
            .segment
            .controllers_mut()
            .take(1)
            .for_each(|controller| controller.fail(Time(0), AlStatusCode::NO_INPUTS));
        (0..2000).for_each(|_| bench.step());
        bench.segment.controllers_mut().for_each(|controller| controller.set_silent(true));
        (0..2000).for_each(|_| bench.step());
    });
    assert!(answered.iter().all(|count| *count > 20), "{answered:?}");
    assert!(bench.network.counts().returned > before + 2000, "{:?}", bench.network.counts());
    assert_eq!(count, 0, "calls of the allocator of the master of an EtherCAT segment");
}

#[test]
fn what_runs_every_cycle_does_not_allocate() {
    // The counter counts.
    assert_eq!(calls(|| drop(std::hint::black_box(vec![1u8]))), 2);
    let mut out = Fixed::default();
    assert_eq!(calls(|| out.push(Frame::new(0x80, &[]))), 0);
    assert_eq!((out.len, Time::default()), (1, Time(0)));
    for pieces in [3, 64, 4096] {
        the_fixture_does_not_allocate(pieces);
    }
    the_segment_does_not_allocate();
    the_master_of_a_segment_does_not_allocate();
    for scenario in [Scenario::torque(), Scenario::position()] {
        the_cycle_does_not_allocate(&scenario);
        the_rig_does_not_allocate(&scenario);
    }
    let files = [
        "paper-admittance-streaming.yaml",
        "paper-admittance-polled.yaml",
        "paper-admittance-two-buses.yaml",
        "paper-ethercat.yaml",
        "paper-ethercat-can-sensor.yaml",
    ];
    for file in files {
        the_rig_does_not_allocate(&Scenario::shipped(file));
    }
    for pace in [Pace::Free, Pace::Lockstep] {
        for scenario in [Scenario::torque(), Scenario::position(), Scenario::shipped("paper-admittance-two-buses.yaml")]
        {
            the_loop_does_not_allocate(&scenario, pace);
        }
    }
}
