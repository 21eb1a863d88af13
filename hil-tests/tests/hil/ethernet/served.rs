//! A simulated segment at the far end of the cable, in this process: what its devices do is seen on their own clock, and they can be broken
//! while programs run on `veth0`.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use yieldwall::config::{self, Source};
use yieldwall::ethercat::frame::{Command, Datagrams};
use yieldwall::link::{EthernetLink, EthernetReceived, PacketSocket, Role};
use yieldwall::rig::SegmentServer;
use yieldwall::run::Pace;
use yieldwall::time::Time;
use yieldwall_drives::cia402::State;

use super::super::programs::LIMIT;

/// The end of the cable at which the devices are.
pub(super) const FAR: &str = "veth1";

type Act = Box<dyn FnOnce(&mut SegmentServer) + Send>;
type Sabotage = Box<dyn FnMut(&mut SegmentServer) + Send>;

/// What was seen of the devices, all moments in simulated time.
#[derive(Clone, Default)]
pub(super) struct Seen {
    /// States of both drives, each from its moment on.
    pub(super) states: Vec<(Time, [State; 2])>,
    /// Where the tool was, in m.
    pub(super) tool: Vec<(Time, [f64; 2])>,
    /// When the last frame with outputs came, and its bytes.
    pub(super) outputs: Option<(Time, Vec<u8>)>,
    /// Frames that came, and those among them that write something.
    pub(super) frames: usize,
    pub(super) writing: usize,
    /// Frames with outputs, one a cycle of the master.
    pub(super) cycles: u64,
}

impl Seen {
    /// The states of both drives now.
    pub(super) fn last(&self) -> Option<[State; 2]> {
        self.states.last().map(|(_, states)| *states)
    }

    /// Whether both drives are in Operation Enabled.
    pub(super) fn is_enabled(&self) -> bool {
        self.last() == Some([State::OperationEnabled; 2])
    }

    /// Whether a drive ever was in Operation Enabled.
    pub(super) fn was_enabled(&self) -> bool {
        self.states.iter().any(|(_, states)| states.contains(&State::OperationEnabled))
    }

    /// When each drive left Operation Enabled for the last time.
    pub(super) fn stopped_at(&self) -> [Option<Time>; 2] {
        [0, 1].map(|drive| {
            let is_on = |(_, states): &(Time, [State; 2])| states[drive] == State::OperationEnabled;
            let last = self.states.iter().rposition(is_on)?;
            self.states.get(last + 1).map(|(time, _)| *time)
        })
    }

    /// How far the tool went from where it was at a moment, in m.
    pub(super) fn moved_since(&self, moment: Time) -> f64 {
        let mut after = self.tool.iter().skip_while(|(time, _)| *time < moment).map(|(_, tool)| *tool);
        let Some([x, y]) = after.next() else { return 0.0 };
        after.fold(0.0, |most: f64, [to_x, to_y]| most.max(((to_x - x) * (to_x - x) + (to_y - y) * (to_y - y)).sqrt()))
    }
}

/// Devices that are served until this is dropped.
pub(super) struct Served {
    seen: Arc<Mutex<Seen>>,
    acts: Sender<Act>,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Served {
    /// All devices of a rig.
    pub(super) fn new(rig: &str, scene: &str) -> Self {
        Self::with(rig, scene, [true; 3], |_| ())
    }

    /// Those of its devices that are `here`; `sabotage` is done to them again and again, the first time before they are switched on.
    pub(super) fn with(
        rig: &str,
        scene: &str,
        here: [bool; 3],
        sabotage: impl FnMut(&mut SegmentServer) + Send + 'static,
    ) -> Self {
        let rig = config::load_rig(Source::named(rig)).expect("a good rig").value;
        let scene = config::load_scene(Source::named(scene)).expect("a good scene").value;
        let link = PacketSocket::open(FAR, Role::Segment).unwrap_or_else(|error| panic!("{error}"));
        let server = SegmentServer::new(&rig, &scene, scene.seed, Pace::Free, here, link.now());
        let server = server.expect("a rig that can be simulated");
        let (acts, asked) = channel();
        let (seen, is_over) = (Arc::<Mutex<Seen>>::default(), Arc::new(AtomicBool::new(false)));
        let mut far = Far { server, link, seen: Arc::clone(&seen), sabotage: Box::new(sabotage) };
        let end = Arc::clone(&is_over);
        (far.sabotage)(&mut far.server);
        let thread = std::thread::spawn(move || {
            // Devices do not wait for a processor. Without the privilege the tests are as patient as they can be.
            let _ = yieldwall::host::system::run_first();
            far.serve(&end, &asked);
        });
        Self { seen, acts, is_over, thread: Some(thread) }
    }

    /// Does something to the devices.
    pub(super) fn act(&self, act: impl FnOnce(&mut SegmentServer) + Send + 'static) {
        self.acts.send(Box::new(act)).expect("they are served");
    }

    /// What was seen up to now.
    pub(super) fn seen(&self) -> Seen {
        self.seen.lock().expect("nobody panics with it").clone()
    }

    /// Waits until that is so of what was seen, or `is_over`; whether it is so.
    pub(super) fn until(&self, is_over: impl Fn() -> bool, is_so: impl Fn(&Seen) -> bool) -> bool {
        let started = Instant::now();
        loop {
            let ends = is_over();
            if is_so(&self.seen.lock().expect("nobody panics with it")) {
                return true;
            }
            if ends {
                return false;
            }
            assert!(started.elapsed() < LIMIT, "it does not come: {:?}", self.seen().last());
            assert!(!self.thread.as_ref().is_some_and(JoinHandle::is_finished), "they are served");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// What was seen, once nothing is served any more.
    pub(super) fn end(mut self) -> Seen {
        self.is_over.store(true, Ordering::Relaxed);
        self.thread.take().expect("once").join().expect("the devices can go on");
        self.seen()
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(std::thread::panicking() || ended.is_none_or(|ended| ended.is_ok()), "the devices have failed");
    }
}

struct Far {
    server: SegmentServer,
    link: PacketSocket,
    seen: Arc<Mutex<Seen>>,
    sabotage: Sabotage,
}

impl Far {
    fn serve(&mut self, is_over: &AtomicBool, acts: &Receiver<Act>) {
        let mut buffer = [0; 1514];
        while !is_over.load(Ordering::Relaxed) {
            acts.try_iter().for_each(|act| act(&mut self.server));
            while let Some(arrival) = self.link.receive(&mut buffer) {
                if let EthernetReceived::Frame { length } = arrival.what {
                    self.run_to(arrival.time);
                    self.take(arrival.time, &mut buffer[..length]);
                }
            }
            let now = self.link.now();
            self.run_to(now);
            self.link.wait(self.server.next_deadline().min(now + Duration::from_millis(10)));
        }
    }

    /// One event after the other, so that each change has its own moment.
    fn run_to(&mut self, wall: Time) {
        loop {
            let at = self.server.next_deadline().min(wall);
            let Self { server, link, .. } = self;
            // What an interface that is down does not take is lost.
            server.poll(at, |bytes| _ = link.send(bytes)).expect("the simulated arm can go on");
            self.look();
            if at >= wall {
                return;
            }
        }
    }

    fn take(&mut self, wall: Time, frame: &mut [u8]) {
        let commands: Vec<u8> = Datagrams::of(frame)
            .map(|all| all.filter_map(Result::ok).map(|datagram| datagram.header.command).collect())
            .unwrap_or_default();
        let reading = [Command::Nop, Command::Aprd, Command::Fprd, Command::Brd, Command::Lrd].map(|one| one as u8);
        {
            let mut seen = self.seen.lock().expect("nobody panics with it");
            seen.frames += 1;
            seen.writing += usize::from(commands.iter().any(|command| !reading.contains(command)));
            if commands.contains(&(Command::Lwr as u8)) {
                seen.outputs = Some((self.server.now(), frame.to_vec()));
                seen.cycles += 1;
            }
        }
        let Self { server, link, .. } = self;
        server.on_frame(wall, frame, |bytes| _ = link.send(bytes)).expect("the simulated arm can go on");
        self.look();
    }

    fn look(&mut self) {
        (self.sabotage)(&mut self.server);
        let now = self.server.now();
        let states = self.server.drive_states().map(|state| state.unwrap_or(State::NotReadyToSwitchOn));
        let tool = self.server.truth().0.to_array();
        let mut seen = self.seen.lock().expect("nobody panics with it");
        if seen.last() != Some(states) {
            seen.states.push((now, states));
        }
        seen.tool.push((now, tool));
    }
}
