//! A shipped rig, what is changed about it, and the session in which it runs.

use std::sync::{Arc, Mutex};

use yieldwall::canopen::Frame;
use yieldwall::config::{self, NotNegative, Positive, Rig, Scene, Source};
use yieldwall::ethercat::frame::{self, Command, Datagrams};
use yieldwall::guard::{Fault, Request};
use yieldwall::injection::Injection;
use yieldwall::link::CandumpWriter;
use yieldwall::link::Packet;
use yieldwall::record::Row;
use yieldwall::rig::{EmbeddedRig, RigError};
use yieldwall::time::Time;

use crate::observe::Recording;

/// A rig and a scene, ready to be changed and started.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// File of the rig below `config`.
    pub file: &'static str,
    /// The rig.
    pub rig: Rig,
    /// The scene.
    pub scene: Scene,
    /// Seed in place of the scene's.
    pub seed: u64,
}

impl Scenario {
    /// A rig of `config` with the scene that it names.
    ///
    /// # Panics
    /// If a file does not load; the message is that of the loader.
    pub fn shipped(file: &'static str) -> Self {
        let path = format!("{}/../config/{file}", env!("CARGO_MANIFEST_DIR"));
        let source = Source::disk(path);
        let rig = config::load_rig(source).unwrap_or_else(|report| panic!("{file}: {report}"));
        let scene = rig.scene().unwrap_or_else(|report| panic!("{file}: {report}")).value;
        Self { file, rig: rig.value, seed: scene.seed, scene }
    }

    /// The rig whose loop closes here, in cyclic synchronous torque mode.
    pub fn torque() -> Self {
        Self::shipped("paper-admittance.yaml")
    }

    /// The rig whose loop closes in the drives, in cyclic synchronous position mode.
    pub fn position() -> Self {
        Self::shipped("paper-admittance-csp.yaml")
    }

    /// The same with a hand that does nothing, so that the tool stays where it is.
    ///
    /// # Panics
    /// Never: the numbers are in their range.
    #[must_use]
    pub fn still(mut self) -> Self {
        let none = || NotNegative::new(0.0).expect("zero");
        let hand = &mut self.scene.hand;
        hand.stiffness_n_per_m = Positive::new(1e-6).expect("above zero");
        (hand.mass_kg, hand.damping_n_s_per_m, hand.tremor) = (none(), none(), None);
        self
    }

    /// The command that runs the shipped files with this seed.
    pub fn replay(&self) -> String {
        format!("yieldwall run config/{} --seed {}", self.file, self.seed)
    }

    /// Cycle time in s.
    pub fn period_s(&self) -> f64 {
        f64::from(self.rig.cycle.period_us) * 1e-6
    }

    /// The rig, switched off, with an observer on its bus.
    ///
    /// # Panics
    /// If the rig cannot be built.
    pub fn start(&self) -> Session {
        let machine = EmbeddedRig::new(&self.rig, &self.scene, &self.rig.fixture, self.seed);
        let mut machine = machine.unwrap_or_else(|error| panic!("{error}; replay: {}", self.replay()));
        let recording = Arc::new(Mutex::new(Recording::default()));
        let outputs = Arc::new(Mutex::new(Vec::new()));
        let (tap, outputs_tap) = (recording.clone(), outputs.clone());
        machine.set_tap(Box::new(move |time, packet| match packet {
            Packet::Can(frame) => tap.lock().expect("one thread").push(time, frame),
            Packet::Ethernet { bytes, .. } => outputs_tap.lock().expect("one thread").extend(controlwords(bytes)),
        }));
        Session { machine, recording, outputs, rows: Vec::new(), replay: self.replay() }
    }

    /// The rig, enabled.
    ///
    /// # Panics
    /// If the rig cannot be built or enabled.
    pub fn enabled(&self) -> Session {
        let mut session = self.start();
        session.machine.enable().unwrap_or_else(|error| panic!("{error}; replay: {}", self.replay()));
        session
    }

    /// The rig, enabled and run for `cycles` cycles.
    ///
    /// # Panics
    /// As [`Scenario::enabled`], and if the simulation cannot go on.
    pub fn run(&self, cycles: usize) -> Session {
        let mut session = self.enabled();
        session.run(cycles);
        session
    }
}

/// A rig that runs, and all that was seen of it.
pub struct Session {
    /// The rig.
    pub machine: EmbeddedRig,
    /// The rows since it was enabled.
    pub rows: Vec<Row>,
    /// The command that runs the shipped files with this seed; it belongs in every message of a failure.
    pub replay: String,
    recording: Arc<Mutex<Recording>>,
    /// Controlwords of the output frames of a segment.
    outputs: Arc<Mutex<Vec<[Option<u16>; 2]>>>,
}

/// The controlwords of an output frame of the master of a segment, as it leaves: of each drive the first word that is written.
fn controlwords(bytes: &[u8]) -> Option<[Option<u16>; 2]> {
    let is_sent = bytes.get(6).is_some_and(|first| first & frame::PROCESSED == 0);
    let datagrams = Datagrams::of(bytes).ok().filter(|_| is_sent)?;
    let written = datagrams.flatten().filter(|datagram| datagram.header.command == Command::Lwr as u8);
    let mut words = written.map(|datagram| Some(u16::from_le_bytes([*datagram.data.first()?, *datagram.data.get(1)?])));
    let left = words.next()?;
    Some([left, words.next().flatten()])
}

impl Session {
    /// One cycle.
    ///
    /// # Panics
    /// If the simulation cannot go on.
    pub fn step(&mut self, request: Request) -> Row {
        let row = self.machine.run_cycle(request).unwrap_or_else(|error| panic!("{error}; replay: {}", self.replay));
        self.rows.push(row);
        row
    }

    /// `cycles` cycles without a request.
    ///
    /// # Panics
    /// As [`Session::step`].
    pub fn run(&mut self, cycles: usize) {
        for _ in 0..cycles {
            self.step(Request::None);
        }
    }

    /// The controlwords of both drives of a segment, output frame by output frame.
    ///
    /// # Panics
    /// Never.
    pub fn segment_controlwords(&self) -> Vec<[Option<u16>; 2]> {
        self.outputs.lock().expect("one thread").clone()
    }

    /// The fault that led to the present state.
    pub fn fault(&self) -> Option<Fault> {
        self.machine.cause().map(|cause| cause.fault)
    }

    /// Injects with the next cycle.
    ///
    /// # Panics
    /// If it is not possible.
    pub fn inject(&mut self, injection: Injection) {
        let start_s = self.machine.scene_time_s().max(0.0);
        let injected = self.machine.inject(Injection { start_s, ..injection });
        injected.unwrap_or_else(|error| panic!("{error}; replay: {}", self.replay));
    }

    /// Has every frame pass through `tamper` from now on.
    pub fn tamper(&mut self, tamper: impl FnMut(Time, usize, Frame) -> Option<Frame> + Send + 'static) {
        self.machine.set_tamper(tamper);
    }

    /// Tries to enable the rig.
    ///
    /// # Errors
    /// As [`EmbeddedRig::enable`].
    pub fn enable(&mut self) -> Result<(), RigError> {
        self.machine.enable()
    }

    /// What has been seen on the bus so far.
    ///
    /// # Panics
    /// Never: there is one thread.
    pub fn recording(&self) -> Recording {
        self.recording.lock().expect("one thread").clone()
    }

    /// The bus traffic as candump text.
    ///
    /// # Panics
    /// Never: memory can be written.
    pub fn candump(&self) -> Vec<u8> {
        let mut log = CandumpWriter::new(Vec::new(), ["vcan0", "vcan1", "vcan2"]);
        for seen in self.recording().frames {
            log.record(seen.time, &seen.frame).expect("memory can be written");
        }
        log.finish().expect("memory can be written")
    }
}
