//! The master on a bus with simulated devices, a wire that spoils frames, and strangers.

use std::sync::LazyLock;
use std::time::Duration;

use yieldwall::bus::{BootFailure, LinkEvent, Master, Packet, Phase};
use yieldwall::canopen::{BusId, Frame};
use yieldwall::config::{self, builtin};
use yieldwall::cycle::Timing;
use yieldwall::guard::{Request, State};
use yieldwall::quantity::TipPoint;
use yieldwall::rig::EmbeddedRig;
use yieldwall::sim::{Drive, ForceSensor};
use yieldwall::time::Time;
use yieldwall_drives::cia402::Goal;

use super::bytes::{Bytes, Script};
use super::cycle::timing;
use super::laws::{Witness, live};
use crate::observe::{DRIVE_NODES, SENSOR_NODE};

/// Most things that happen in one input, so that its length does not decide how long it takes.
const MOST_EVENTS: usize = 1500;
/// Most frames that the master sends in answer to one: the first request to each node, or an abort and a request.
const MOST_PER_FRAME: usize = 4;
/// Most frames of one poll: a heartbeat, an abort per node, and what restarts.
const MOST_PER_POLL: usize = 1 + 3 + 3;
/// Most exchanges back and forth that the configuration of all nodes takes.
const MOST_EXCHANGES: usize = 400;
/// Longest time that the nodes have between the reset and the exchange of process data, but for their configuration.
const PHASE_LIMIT: Duration = Duration::from_millis(5001);

/// How long frames of devices may take while nothing happens on the bus, and how many of such times are looked at.
const SLICE: Duration = Duration::from_millis(10);
const MOST_SLICES: u128 = 100;

/// Who is told to be reset and to start.
const NODES: [u16; 3] = [DRIVE_NODES[0], DRIVE_NODES[1], SENSOR_NODE];

/// One rig per command mode.
const FILES: [&str; 3] = ["paper-admittance.yaml", "paper-admittance-csp.yaml", "paper-admittance-csv.yaml"];

/// The parts of a rig at one moment.
#[derive(Clone)]
struct Parts {
    master: Master,
    drives: [Drive; 2],
    sensor: ForceSensor,
    now: Time,
}

/// A rig that is switched off, and the same that runs.
struct Start {
    off: Parts,
    running: Parts,
    torque_limit_n_m: f64,
}

static STARTS: LazyLock<[Start; 3]> = LazyLock::new(|| {
    FILES.map(|file| {
        let source = builtin(file);
        let rig = config::load_rig(source).expect("a shipped rig");
        let scene = rig.scene().expect("a shipped scene").value;
        let rig = rig.value;
        let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, 1).expect("a rig that can be built");
        let parts = |machine: &EmbeddedRig| Parts {
            master: machine.master().clone(),
            drives: std::array::from_fn(|drive| machine.drives()[drive].clone()),
            sensor: machine.force_sensor().expect("a sensor on CAN").clone(),
            now: machine.now(),
        };
        let mut off = parts(&machine);
        let home = off.master.cycle().linkage().inverse(TipPoint::new(0.02, 0.0)).expect("a point in reach");
        for (drive, angle) in off.drives.iter_mut().zip(home.to_array()) {
            drive.measure(angle, 0.0);
        }
        machine.enable().expect("a rig that can be enabled");
        Start { off, running: parts(&machine), torque_limit_n_m: rig.guard.torque_limit_n_m.get() }
    })
});

/// The network and what is known of it.
struct Net {
    parts: Parts,
    /// What the master has sent and nobody has heard yet.
    sent: Vec<Frame>,
    /// Set-points that were sent and not seen on the bus.
    unseen: usize,
    torque_limit_n_m: f64,
    witness: Witness,
    phase: Phase,
    phase_since: Time,
    /// Per drive whether the last word said Operation Enabled, and whether one did since SYNC.
    words: [(bool, Option<bool>); 2],
    was_asked: bool,
}

impl Net {
    fn new(start: &Start, is_running: bool) -> Self {
        let mut parts = if is_running { &start.running } else { &start.off }.clone();
        // What was on its way has arrived.
        for id in [0x200 + DRIVE_NODES[0], 0x200 + DRIVE_NODES[1]] {
            parts.master.networks_mut().on_echo(&Frame::new(id, &[]));
        }
        let phase = parts.master.networks().phase().clone();
        Net {
            unseen: 0,
            phase_since: parts.now,
            sent: Vec::new(),
            torque_limit_n_m: start.torque_limit_n_m,
            witness: Witness::of(parts.master.cycle().state()),
            phase,
            words: [(is_running, None); 2],
            was_asked: is_running,
            parts,
        }
    }

    /// Switches everything on.
    fn switch_on(&mut self) {
        let (now, mut boot) = (self.parts.now, Vec::new());
        for drive in &mut self.parts.drives {
            drive.boot(now, &mut boot);
        }
        self.parts.sensor.boot(now, &mut boot);
        self.act(1 + NODES.len(), |master, out| master.start(now, out));
    }

    /// Has the master do something and looks at what it sends.
    fn act<T>(&mut self, most: usize, what: impl FnOnce(&mut Master, &mut Vec<Frame>) -> T) -> T {
        let before = self.sent.len();
        let result = what(&mut self.parts.master, &mut self.sent);
        let fresh = &self.sent[before..];
        assert!(fresh.len() <= most, "too many frames: {fresh:x?}");
        for frame in fresh {
            check_sent(frame, self.parts.master.networks().phase());
        }
        let phase = self.parts.master.networks().phase();
        if *phase != self.phase {
            assert!(follows(&self.phase, phase), "{:?} to {phase:?}", self.phase);
            (self.phase, self.phase_since) = (phase.clone(), self.parts.now);
        }
        result
    }

    fn hear(&mut self, frame: &Frame) {
        for ((_, word), node) in self.words.iter_mut().zip(DRIVE_NODES) {
            if frame.id() == 0x180 + node && frame.len() == 6 {
                let is_enabled = frame.bits() & 0x6f == 0x27;
                *word = Some(word.unwrap_or(false) || is_enabled);
            }
        }
        let now = self.parts.now;
        self.act(MOST_PER_FRAME, |master, out| master.networks_mut().on_packet(now, Packet::Can(frame), out));
    }

    /// Gives the devices what the master has sent, and the master what they answer, through `wire`; whether anything was
    /// said.
    fn exchange(&mut self, mut wire: impl FnMut(Frame) -> Option<Frame>) -> bool {
        let (now, requests) = (self.parts.now, std::mem::take(&mut self.sent));
        let mut answers = Vec::new();
        for request in requests {
            let Some(frame) = wire(request) else { continue };
            self.parts.master.networks_mut().on_echo(&request);
            self.unseen -= usize::from(is_set_point(&request));
            for drive in &mut self.parts.drives {
                drive.on_frame(now, &frame, &mut answers);
            }
            self.parts.sensor.on_frame(now, &frame, &mut answers);
        }
        let is_busy = !answers.is_empty();
        for frame in answers.into_iter().filter_map(wire) {
            self.hear(&frame);
        }
        is_busy
    }

    /// Time passes, and what the devices send arrives within a slice; the end of a long wait is one slice.
    fn wait(&mut self, wait: Duration) {
        let slices = (wait.as_millis() / SLICE.as_millis()).min(MOST_SLICES) as u32;
        for _ in 0..slices {
            self.wait_slice(SLICE);
        }
        self.wait_slice(wait - SLICE * slices);
    }

    fn wait_slice(&mut self, wait: Duration) {
        let until = self.parts.now + wait;
        let mut answers = Vec::new();
        for drive in &mut self.parts.drives {
            live(drive, until, Drive::next_deadline, |drive, now| drive.poll(now, &mut answers));
        }
        live(&mut self.parts.sensor, until, ForceSensor::next_deadline, |sensor, now| sensor.poll(now, &mut answers));
        let next = |net: &Net| net.parts.master.networks().next_deadline();
        live(self, until, next, |net, now| {
            net.parts.now = now.max(net.parts.now);
            net.act(MOST_PER_POLL, |master, out| master.networks_mut().poll(now, out));
        });
        let is_limited = matches!(self.phase, Phase::Resetting | Phase::Starting);
        let lasted = self.parts.now.since(self.phase_since);
        assert!(!is_limited || lasted <= PHASE_LIMIT, "{:?} for {lasted:?}", self.phase);
        answers.iter().for_each(|frame| self.hear(frame));
    }

    /// One cycle of the exchange of process data.
    fn cycle(
        &mut self,
        request: Request,
        timing: Timing,
        mut wire: impl FnMut(Frame) -> Option<Frame>,
        strangers: &[Frame],
    ) {
        self.wait(Duration::from_micros(380));
        if self.phase != Phase::Operational {
            return;
        }
        for word in &mut self.words {
            word.1 = None;
        }
        let (unseen, was_silent) = (self.unseen, self.parts.master.networks().is_silent());
        self.act(1, |master, out| master.networks_mut().open(out));
        self.exchange(&mut wire);
        for frame in strangers {
            self.hear(frame);
        }
        self.wait(Duration::from_micros(620));
        let now = self.parts.now;
        let before = self.sent.len();
        self.was_asked |= request == Request::Enable;
        let outputs = self.act(3, |master, out| master.on_compute(now, request, timing, out));
        for (last, word) in &mut self.words {
            *last = word.unwrap_or(*last);
        }
        self.witness.look(self.words.iter().all(|(last, _)| *last), request, self.torque_limit_n_m, &outputs);
        let set_points: Vec<_> = self.sent[before..].iter().filter(|frame| is_set_point(frame)).collect();
        // One set-point per drive, unless the last ones still wait or the bus cannot be reached.
        let is_silent = self.parts.master.networks().is_silent();
        assert_eq!(
            (set_points.len(), is_silent),
            (if unseen > 0 || is_silent { 0 } else { 2 }, outputs.directive.is_silent)
        );
        for (frame, node) in set_points.iter().zip(DRIVE_NODES) {
            assert_eq!(frame.id(), 0x200 + node);
            let enables = frame.bits() & 0x8f == 0x0f;
            let is_wanted = outputs.directive.goal == Goal::OperationEnabled && self.was_asked;
            assert!(!enables || is_wanted, "{frame:x?} of {:?}", outputs.directive);
        }
        if !set_points.is_empty() {
            self.unseen = 2;
        } else if was_silent && !is_silent {
            // A person has the exchange go on: what was lost is not waited for.
            self.unseen = 0;
        }
        self.exchange(wire);
    }
}

impl Net {
    /// The cycle has panicked in the hands of whoever calls the master.
    fn panic(&mut self) {
        let now = self.parts.now;
        self.act(3, |master, out| master.quick_stop_now(now, out));
        self.witness = Witness::of(State::Disabled);
        self.unseen = 2;
        self.exchange(Some);
    }
}

fn is_set_point(frame: &Frame) -> bool {
    DRIVE_NODES.iter().any(|node| frame.id() == 0x200 + node)
}

/// What the master sends in a phase.
fn check_sent(frame: &Frame, phase: &Phase) {
    let is_operational = *phase == Phase::Operational;
    let has_given_way =
        matches!(phase, Phase::Failed(error) if matches!(error.failure, BootFailure::OtherMaster { .. }));
    assert!(!has_given_way, "{frame:x?} although there is another master");
    let is_good = match (frame.id(), frame.data()) {
        (0x000, [0x81, node]) => NODES.contains(&u16::from(*node)) && *phase == Phase::Resetting,
        // Nodes that have started by themselves are there at once.
        (0x000, [0x01, node]) => NODES.contains(&u16::from(*node)) && (is_operational || *phase == Phase::Starting),
        (0x080, []) => is_operational,
        (0x201 | 0x202, data) => is_operational && matches!(data.len(), 4 | 6),
        // A request, and the aborts of those that are given up.
        (0x601 | 0x602 | 0x60a, data) => data.len() == 8 && matches!(phase, Phase::Configuring | Phase::Failed(_)),
        (0x77f, [0x05]) => is_operational,
        (0x77f, [0x7f]) => !is_operational,
        _ => false,
    };
    assert!(is_good, "{frame:x?} in {phase:?}");
}

/// Whether the master may go from one phase to another.
fn follows(before: &Phase, after: &Phase) -> bool {
    let is_next = matches!(
        (before, after),
        (Phase::Off, Phase::Resetting)
            | (Phase::Resetting, Phase::Configuring)
            | (Phase::Configuring, Phase::Starting | Phase::Operational)
            | (Phase::Starting, Phase::Operational)
    );
    is_next || (matches!(after, Phase::Failed(_)) && !matches!(before, Phase::Off | Phase::Operational))
}

/// A wire that lets most frames pass, loses some and spoils others, as `bytes` say.
fn spoil(bytes: &mut Bytes<'_>, frame: Frame) -> Option<Frame> {
    let mut data = *frame.bytes();
    let len = usize::from(frame.len());
    match bytes.u8() {
        0..160 => Some(frame),
        160..176 => None,
        176..192 => Some(Frame::new(frame.id(), &data[..usize::from(bytes.u8()) % (len + 1)])),
        192..224 => {
            data[usize::from(bytes.u8()) % 8] ^= 1 << (bytes.u8() % 8);
            Some(Frame::new(frame.id(), &data[..len]))
        }
        _ => Some(Frame::new(frame.id() ^ (1 << (bytes.u8() % 11)), &data[..len])),
    }
}

/// Identifiers that a master listens to.
const HEARD: [u16; 14] = [
    0x180 + DRIVE_NODES[0],
    0x180 + DRIVE_NODES[1],
    0x180 + SENSOR_NODE,
    0x280 + SENSOR_NODE,
    0x580 + DRIVE_NODES[0],
    0x580 + DRIVE_NODES[1],
    0x580 + SENSOR_NODE,
    0x700 + DRIVE_NODES[0],
    0x700 + DRIVE_NODES[1],
    0x700 + SENSOR_NODE,
    0x080 + DRIVE_NODES[0],
    0x080 + SENSOR_NODE,
    0x000,
    0x77f,
];

/// A master in every phase: it sends what the phase allows and no more than it has to, the phases follow each other and
/// end, nothing is enabled before all nodes are what they should be and a person asked, and a running rig keeps its
/// promises.
///
/// # Panics
/// If a law is broken.
pub fn master(bytes: &[u8]) {
    play(bytes);
}

/// The network in the end.
fn play(bytes: &[u8]) -> Net {
    let mut bytes = Bytes::new(bytes);
    let start = &STARTS[usize::from(bytes.u8()) % STARTS.len()];
    let is_running = bytes.bool();
    let mut net = Net::new(start, is_running);
    if is_running {
        assert_eq!(net.parts.master.cycle().state(), State::Running);
    } else {
        net.switch_on();
    }
    for _ in 0..MOST_EVENTS {
        if bytes.is_empty() {
            break;
        }
        match bytes.u8() % 16 {
            0..2 => {
                let frame = bytes.frame(&HEARD);
                net.hear(&frame);
            }
            2 => {
                let wait = bytes.wait();
                net.wait(wait);
            }
            3 => {
                net.exchange(|frame| spoil(&mut bytes, frame));
            }
            4 => {
                net.exchange(Some);
            }
            5 => {
                let silent = (0..MOST_EXCHANGES).find(|_| !net.exchange(Some));
                assert!(silent.is_some(), "the conversation does not end");
            }
            6 => {
                let request = bytes.pick(&[Request::Enable, Request::Stop, Request::Reset, Request::Enable]);
                net.cycle(request, Timing::default(), Some, &[]);
            }
            7..10 => {
                let strangers: Vec<Frame> = (0..bytes.u8() % 4).map(|_| bytes.frame(&HEARD)).collect();
                let timing = if bytes.u8() < 16 { timing(&mut bytes) } else { Timing::default() };
                net.cycle(Request::None, timing, |frame| spoil(&mut bytes, frame), &strangers);
            }
            10 if net.phase == Phase::Operational && bytes.u8() < 16 => net.panic(),
            10 => net.parts.master.networks_mut().on_link(
                BusId::new(bytes.u8() % 5),
                bytes.pick(&[LinkEvent::SendFailed, LinkEvent::ErrorPassive, LinkEvent::BusOff]),
            ),
            11 => {
                let joint = usize::from(bytes.u8() % 2);
                let (now, code, mut out) = (net.parts.now, bytes.u16(), Vec::new());
                net.parts.drives[joint].raise_fault(now, code, &mut out);
                out.iter().for_each(|frame| net.hear(frame));
            }
            _ => {
                for _ in 0..bytes.u8() % 32 {
                    net.cycle(Request::None, Timing::default(), Some, &[]);
                }
            }
        }
    }
    net
}

pub(super) fn networks() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for mode in 0..FILES.len() as u8 {
        // From cold: the boot, heartbeats of the nodes, some cycles, enable, more cycles.
        let cold = Script::new().raw(&[mode, 0, 5, 2]).wait_us(20_000).raw(&[2]).wait_us(20_000);
        seeds.push(cold.raw(&[12, 10, 6, 0, 12, 31]).finish());
        // From running: cycles on a bad wire, a fault, a reset and enabling again.
        let bad = [7, 0, 255].iter().copied().chain([0; 8]).collect::<Vec<u8>>();
        seeds.push(
            Script::new()
                .raw(&[mode, 1, 12, 5])
                .raw(&bad)
                .raw(&[11, 0, 0x10, 0x42, 12, 31, 6, 2, 12, 31, 6, 0, 12, 20])
                .finish(),
        );
    }
    // Nodes that say Operational while they are configured, as those do that start by themselves.
    let mut early = Script::new().raw(&[0, 0, 4, 4]);
    for node in [DRIVE_NODES[0], DRIVE_NODES[1], SENSOR_NODE] {
        early = early.raw(&[0]).frame(0x700 + node, &[0x05]);
    }
    seeds.push(early.raw(&[5, 2]).wait_us(1_000_000).raw(&[2]).wait_us(20_000).raw(&[12, 10, 6, 0, 12, 31]).finish());
    seeds
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conversations_lead_to_where_they_are_meant_to() {
        for seed in networks() {
            let net = play(&seed);
            let (state, cause) = (net.parts.master.cycle().state(), net.parts.master.cycle().cause());
            assert_eq!((&net.phase, state), (&Phase::Operational, State::Running), "{cause:?} {seed:?}");
        }
    }
}
