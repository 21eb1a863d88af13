//! What the time of a cycle goes into: every part run alone over a recorded stretch of the run.

use std::hint::black_box;

use hil_tests::machine::Machine;
use hil_tests::stopwatch::{Spread, Stopwatch};
use hil_tests::tape::Tape;
use nalgebra::UnitComplex;
use yieldwall::bus::Packet;
use yieldwall::canopen::{Frame, cob};
use yieldwall::control::{AxisController, EffortRange, InertiaTerm};
use yieldwall::cycle::{Servo, Signals, Timing};
use yieldwall::guard::{Fault, FaultCounts, Measured, Request, State, Supervisor, View};
use yieldwall::quantity::{JointRates, JointTorques};
use yieldwall::rig::RigError;
use yieldwall::sim::can::{BitTiming, QueueOrder, VirtualBus};
use yieldwall::time::Time;
use yieldwall_drives::cia402;

use crate::Effort;

/// The tool meets the circle, is pressed onto it and pulled off it in this stretch of the tour.
const SKIP: usize = 1000;
const PERIODS: usize = 4000;

const CASES: [(&str, u32); 3] = [("paper-admittance", 100), ("paper-admittance", 1000), ("paper-admittance-csp", 100)];

pub(crate) fn measure(effort: &Effort) -> Result<(), RigError> {
    for (name, plant_step_us) in CASES {
        let label = format!("{name}/{plant_step_us}");
        if !effort.is_wanted(&label) {
            continue;
        }
        let machine = Machine::builtin(name, "circle-tour").with_plant_step_us(plant_step_us);
        let periods = PERIODS.min(effort.cycles);
        let stages = Stages { tape: Tape::record(machine, SKIP, periods)?, repetitions: effort.runs };
        println!("\ncost of a cycle of {label} in ns, each part alone over {periods} cycles: median (least, most)");
        stages.print();
    }
    Ok(())
}

struct Stages {
    tape: Tape,
    repetitions: usize,
}

impl Stages {
    fn print(&self) {
        println!("  control step");
        let parts = [
            ("sensing", self.sensing()),
            ("linkage forward", self.forward()),
            ("linkage clearance", self.clearance()),
            ("fixture", self.fixture()),
            ("linkage inverse", self.inverse()),
            ("linkage dynamics", self.dynamics()),
            ("control", self.control()),
            ("guard", self.guard()),
        ];
        let step = self.cycle();
        show(4, &parts, step, "all of the control step");
        println!("  rig");
        let parts = [
            ("control step", step),
            ("master without the control step", self.master().less(step.median)),
            ("bus", self.bus()),
            ("drives", self.drives()),
            ("sensor", self.sensor()),
            ("plant: arm and hand", self.plant()),
            ("plant: what the sensor feels", self.feel()),
        ];
        show(4, &parts, self.whole(), "all of the rig");
    }

    /// Time per period of `body`, which gets the parts anew for every repetition from `prepare`.
    fn time<P>(&self, prepare: impl Fn() -> P, body: impl Fn(&mut P)) -> Spread {
        let per_period = |_| {
            let mut parts = prepare();
            let start = Stopwatch::start();
            body(&mut parts);
            let elapsed = start.elapsed().on_core_ns;
            black_box(&parts);
            elapsed / self.tape.periods.len() as f64
        };
        Spread::of((0..self.repetitions).map(per_period).collect())
    }

    fn signals(&self) -> impl Iterator<Item = &Signals> {
        self.tape.periods.iter().map(|period| black_box(&period.outputs.signals))
    }

    fn sensing(&self) -> Spread {
        let prepare = || self.tape.cycle().sensing().clone();
        self.time(prepare, |sensing| {
            for period in &self.tape.periods {
                black_box(sensing.step(
                    black_box(&period.inputs).sample.as_ref(),
                    UnitComplex::from_cos_sin_unchecked(0.6, 0.8),
                    Default::default(),
                ));
            }
        })
    }

    fn forward(&self) -> Spread {
        let linkage = self.tape.cycle().linkage();
        self.time(|| (), |()| self.signals().for_each(|signals| keep(linkage.forward(signals.measured_angles))))
    }

    fn clearance(&self) -> Spread {
        let linkage = self.tape.cycle().linkage();
        let postures: Vec<_> =
            self.signals().filter_map(|signals| linkage.forward(signals.measured_angles).ok()).collect();
        self.time(|| (), |()| postures.iter().for_each(|posture| keep(linkage.clearance(black_box(posture)).nearest())))
    }

    fn inverse(&self) -> Spread {
        let linkage = self.tape.cycle().linkage();
        self.time(
            || (),
            |()| {
                for signals in self.signals() {
                    keep(linkage.close_near(signals.proxy, signals.target_angles));
                }
            },
        )
    }

    fn dynamics(&self) -> Spread {
        let linkage = self.tape.cycle().linkage();
        let Servo::Torque(servo) = self.tape.cycle().servo() else { return Spread::NONE };
        let Some(model) = &servo.inertia else { return Spread::NONE };
        let closures =
            || self.signals().filter_map(|signals| linkage.close(signals.target_angles).ok()).collect::<Vec<_>>();
        self.time(closures, |closures| {
            for closure in closures {
                keep(linkage.dynamics_of(model, closure, JointRates::new(0.1, -0.2)));
            }
        })
    }

    fn fixture(&self) -> Spread {
        let prepare = || self.tape.cycle().fixture().clone();
        self.time(prepare, |fixture| {
            self.signals().for_each(|signals| keep(fixture.step_admittance(&signals.force.0)));
        })
    }

    /// Feed-forward and both axes.
    fn control(&self) -> Spread {
        let Servo::Torque(servo) = self.tape.cycle().servo() else { return Spread::NONE };
        let linkage = self.tape.cycle().linkage();
        let inertia = servo.inertia.and_then(|model| {
            let signals = self.signals().next()?;
            let dynamics = linkage.dynamics(&model, signals.target_angles, JointRates::default()).ok()?;
            let accelerations = nalgebra::Vector2::new(0.5, -0.5);
            Some(InertiaTerm { mass_matrix: dynamics.mass, accelerations, bias_n_m: dynamics.bias.0 })
        });
        self.time(
            || servo.clone(),
            |servo| {
                for signals in self.signals() {
                    let error = signals.target_angles - signals.measured_angles;
                    let forward = servo.feed_forward.step(JointRates::new(0.1, -0.2), black_box(inertia.as_ref()));
                    let each = servo.axes.iter_mut().zip(servo.effort_limit).zip(forward.torques.to_array());
                    for (((axis, limit), forward), error) in each.zip(error.to_array()) {
                        black_box(axis.step(error, EffortRange::around(limit, forward).1));
                    }
                }
            },
        )
    }

    /// All counters of faults, the supervisor and the gate.
    fn guard(&self) -> Spread {
        let prepare = || (self.tape.cycle().gate().clone(), FaultCounts::default(), Supervisor::new());
        self.time(prepare, |(gate, faults, supervisor)| {
            for period in &self.tape.periods {
                for fault in ALL_OBSERVED {
                    faults.observe(fault, black_box(false));
                }
                let drives = [cia402::State::OperationEnabled; 2];
                let worst = faults.worst();
                let view = View { drives, worst, is_measured: true, at_rest: true, request: Request::None };
                black_box(supervisor.step(&view));
                let measured =
                    Measured { angles: period.outputs.signals.measured_angles, rates: JointRates::default() };
                keep(gate.check(black_box(period.outputs.command.get()), &measured));
            }
        })
    }

    fn cycle(&self) -> Spread {
        let prepare = || self.tape.cycle().clone();
        self.time(prepare, |cycle| {
            self.tape.periods.iter().for_each(|period| keep(cycle.step(black_box(&period.inputs))));
        })
    }

    fn master(&self) -> Spread {
        let own = self.tape.machine.rig.own_node().expect("a bus").node_id;
        let prepare = || (self.tape.master.clone(), Vec::with_capacity(64));
        self.time(prepare, |(master, out)| {
            for period in &self.tape.periods {
                out.clear();
                master.networks_mut().open(out);
                for (time, frame) in &period.frames {
                    if master.networks().next_deadline() <= *time {
                        master.networks_mut().poll(*time, out);
                    }
                    if is_from_master(frame, own) {
                        master.networks_mut().on_echo(frame);
                    } else {
                        master.networks_mut().on_packet(*time, Packet::Can(frame), out);
                    }
                }
                black_box(master.on_compute(period.compute_at, Request::None, Timing::default(), out));
            }
            assert_eq!(master.cycle().state(), State::Running);
        })
    }

    /// The frames in the three portions in which they are queued: set-points, SYNC, what devices answer.
    fn bus(&self) -> Spread {
        let rig = &self.tape.machine.rig;
        let bit_rate = rig.own_node().map_or(1_000_000, |bus| bus.bit_rate_bit_per_s);
        let orders = [QueueOrder::Fifo, QueueOrder::Priority, QueueOrder::Priority, QueueOrder::Priority];
        let [left, right] = rig.drives.each_ref().map(|drive| drive.address.node_id().unwrap_or_default());
        let nodes = [left, right, self.sensor_node()];
        let prepare = || VirtualBus::new(BitTiming::Arbitrated { bit_rate }, &orders).expect("the rate of the rig");
        let portion_and_port = |frame: &Frame| match nodes.iter().position(|node| is_from_node(frame, *node)) {
            Some(place) => (2, place + 1),
            None => (usize::from(frame.id() == cob::SYNC), 0),
        };
        let mut portions = Vec::new();
        for period in &self.tape.periods {
            let mut split: [Vec<(usize, Frame)>; 3] = Default::default();
            for (_, frame) in &period.frames {
                let (portion, port) = portion_and_port(frame);
                split[portion].push((port, *frame));
            }
            portions.extend(split.map(|portion| (period.sync_at, portion)));
        }
        self.time(prepare, |bus| {
            for (now, portion) in &portions {
                for (port, frame) in portion {
                    bus.submit(*port, *now, *frame);
                }
                loop {
                    let next = bus.next_event();
                    if next == Time::NEVER {
                        break;
                    }
                    keep(bus.advance(next));
                }
            }
        })
    }

    fn drives(&self) -> Spread {
        let nodes = self.tape.machine.rig.drives.each_ref().map(|drive| drive.address.node_id().unwrap_or_default());
        let prepare = || (self.tape.drives.clone(), Vec::with_capacity(64));
        self.time(prepare, |(drives, out): &mut (_, Vec<Frame>)| {
            for period in &self.tape.periods {
                out.clear();
                let angles = period.outputs.signals.measured_angles.to_array();
                for ((drive, node), angle) in drives.iter_mut().zip(nodes).zip(angles) {
                    for (time, frame) in &period.frames {
                        while drive.next_deadline() < *time {
                            drive.measure(angle, 0.1);
                            drive.poll(drive.next_deadline(), out);
                        }
                        if frame.id() == cob::SYNC {
                            drive.measure(angle, 0.1);
                        }
                        if !is_from_node(frame, node) {
                            drive.on_frame(*time, frame, out);
                        }
                    }
                }
            }
            assert!(drives.iter().all(|drive| drive.state() == cia402::State::OperationEnabled));
        })
    }

    fn sensor_node(&self) -> u8 {
        self.tape.machine.rig.sensor.protocol.node_id().expect("a sensor on CANopen")
    }

    fn sensor(&self) -> Spread {
        let node = self.sensor_node();
        let prepare = || (self.tape.sensor.clone(), Vec::with_capacity(64));
        self.time(prepare, |(sensor, out): &mut (_, Vec<Frame>)| {
            for period in &self.tape.periods {
                out.clear();
                sensor.measure(period.inputs.sample.map_or([0; 6], |sample| sample.counts));
                for (time, frame) in &period.frames {
                    if sensor.next_deadline() <= *time {
                        sensor.poll(*time, out);
                    }
                    if !is_from_node(frame, node) {
                        sensor.on_frame(*time, frame, out);
                    }
                }
            }
        })
    }

    /// Moved on from stop to stop as the rig does: to each SYNC, and to each tick of drives that close a loop.
    fn plant(&self) -> Spread {
        let rig = &self.tape.machine.rig;
        let stops: u32 = match self.tape.cycle().servo() {
            Servo::Torque(_) => 1,
            _ => rig.cycle.period_us / rig.simulated().expect("a simulated rig").drive_position_loop.period_us,
        };
        let step_s = self.tape.machine.plant_step_s();
        let (period_s, from_s) = (self.tape.machine.period_s(), self.tape.hand_from_s);
        let prepare = || (self.tape.arm.clone(), self.tape.hand.clone());
        self.time(prepare, |(arm, hand)| {
            // Torques set at one SYNC act until the next.
            let mut held_n_m = self.tape.drives.each_ref().map(|drive| drive.torque_n_m());
            for period in &self.tape.periods {
                let start_s = arm.time_s();
                let torques = JointTorques::from(std::mem::replace(&mut held_n_m, period.torques_n_m));
                for stop in 1..=stops {
                    let end_s = start_s + period_s * f64::from(stop) / f64::from(stops);
                    let moved = arm.advance_to(end_s, step_s, torques, |time, tip| hand.load(time - from_s, tip.0));
                    // Replayed torques do not answer the motion; the arm stays in reach for such a stretch.
                    if black_box(moved).is_err() {
                        return;
                    }
                }
            }
        })
    }

    /// Posture and force at a sample, and the counts that they make, without their noise.
    fn feel(&self) -> Spread {
        let tape = &self.tape;
        let (calibration, mounting) = (tape.cycle().sensing().calibration(), tape.cycle().sensing().mounting());
        let prepare = || (tape.arm.clone(), tape.hand.clone());
        self.time(prepare, |(arm, hand)| {
            for period in &tape.periods {
                let Ok(posture) = black_box(&*arm).posture() else { return };
                let tip = arm.tip_in(&posture);
                let time_s = period.sync_at.as_secs_f64() - tape.hand_from_s;
                let acceleration = tip.acceleration_m_per_s2.into();
                let force = hand.force_on_tool(time_s, tip.position.0, tip.velocity.0, acceleration);
                let link = mounting.link_rotation(posture.distal_rotation);
                let wrench = mounting.to_sensor(yieldwall::quantity::Force(force), 0.0, link);
                black_box(calibration.counts_for(&wrench));
            }
        })
    }

    fn whole(&self) -> Spread {
        let prepare = || {
            let mut rig = self.tape.machine.enabled().expect("it was enabled before");
            for _ in 0..SKIP {
                rig.run_cycle(Request::None).expect("it ran before");
            }
            rig
        };
        self.time(prepare, |rig| {
            for _ in &self.tape.periods {
                keep(rig.run_cycle(Request::None));
            }
        })
    }
}

/// Faults whose counters every control step brings up to date.
const ALL_OBSERVED: [Fault; 21] = [
    Fault::EncoderJump,
    Fault::PdoMissed,
    Fault::Posture,
    Fault::StopRequested,
    Fault::SensorSaturated,
    Fault::SensorStale,
    Fault::ForceLimit,
    Fault::PdoLength,
    Fault::NodeReset,
    Fault::HeartbeatLost,
    Fault::Emergency,
    Fault::LinkDown,
    Fault::DriveFault,
    Fault::DriveLeftOperation,
    Fault::DriveIgnoresCommand,
    Fault::FollowingError,
    Fault::Runaway,
    Fault::WorkspaceLeft,
    Fault::OverSpeed,
    Fault::NotFinite,
    Fault::WorkspaceEdge,
];

/// Has the value computed although nobody reads it.
fn keep<T>(value: T) {
    let _ = black_box(value);
}

fn show(indent: usize, parts: &[(&str, Spread)], whole: Spread, name: &str) {
    let line = |name: &str, value: String, share: f64| {
        println!("{:indent$}{name:<34} {value:>24} {share:>5.0} %", "");
    };
    let share = |ns: f64| 100.0 * ns / whole.median;
    for (name, part) in parts.iter().filter(|(_, part)| !part.median.is_nan()) {
        line(name, format!("{part:.0}"), share(part.median));
    }
    let rest = whole.median - parts.iter().map(|(_, part)| part.median).filter(|ns| !ns.is_nan()).sum::<f64>();
    line("rest", format!("{rest:.0}"), share(rest));
    line(name, format!("{whole:.0}"), 100.0);
}

/// By its identifier: the default connection set of CiA 301 says who sends what.
fn is_from_node(frame: &Frame, node: u8) -> bool {
    let (function, addressee) = (frame.id() & 0x780, frame.id() & 0x7f);
    addressee == u16::from(node) && matches!(function, 0x080 | 0x180 | 0x280 | 0x380 | 0x480 | 0x580 | 0x700)
}

fn is_from_master(frame: &Frame, master: u8) -> bool {
    let (function, addressee) = (frame.id() & 0x780, frame.id() & 0x7f);
    matches!(function, 0x000 | 0x200 | 0x300 | 0x400 | 0x500 | 0x600)
        || frame.id() == 0x080
        || (function == 0x700 && addressee == u16::from(master))
}
