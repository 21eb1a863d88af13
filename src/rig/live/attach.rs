//! Devices of one arm in several processes: each sends and receives on the bus by itself, and is connected to the arm over a
//! socket.
//!
//! ```text
//! the process with the arm                      a process with one device
//! Call: time, SYNC or due, what it feels  --->  its frames up to that moment, then the device
//!                                         <---  what it sends; then Answer: torque, state, when something is due
//! ```
//! The process with the arm sets the moments, so that all devices share one clock. The measurements of a device up to a SYNC are on
//! the bus before the other devices answer that SYNC. A device that does not answer within half a second, 5 s in lockstep, is
//! removed for good, and its joint has no torque.

use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::os::fd::AsFd;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::{Answer, Call, DeviceServer, Peer};
use yieldwall_drives::cia402;
use yieldwall_fieldbus::canopen::{Frame, Outbox, cob};
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{CanLink, LinkOutbox, Received};
use yieldwall_run::Pace;
use yieldwall_sim::{Drive, ForceSensor};

/// How long a device may take to answer by the wall clock ...
const PATIENCE: Duration = Duration::from_millis(500);
/// ... and in lockstep, where time waits for it. The death of a device's process is noticed at once: its end of the socket is closed.
const LOCKSTEP_PATIENCE: Duration = Duration::from_secs(5);
/// How long a device waits for a SYNC that the arm has announced.
const SYNC_PATIENCE: Duration = Duration::from_millis(20);
/// Longest wait before the server checks for a request to end.
const LOOK_UP: Timespec = Timespec { tv_sec: 0, tv_nsec: 50_000_000 };

const CALL_BYTES: usize = 8 + 1 + 6 * 8;
const ANSWER_BYTES: usize = 8 + 1 + 8;

/// States by their number on the socket.
const STATES: [cia402::State; 8] = [
    cia402::State::NotReadyToSwitchOn,
    cia402::State::SwitchOnDisabled,
    cia402::State::ReadyToSwitchOn,
    cia402::State::SwitchedOn,
    cia402::State::OperationEnabled,
    cia402::State::QuickStopActive,
    cia402::State::FaultReactionActive,
    cia402::State::Fault,
];

fn encode_call(call: &Call) -> [u8; CALL_BYTES] {
    let mut bytes = [0; CALL_BYTES];
    bytes[..8].copy_from_slice(&call.now.0.to_le_bytes());
    bytes[8] = u8::from(call.is_sync);
    for (place, value) in bytes[9..].chunks_exact_mut(8).zip(call.felt) {
        place.copy_from_slice(&value.to_le_bytes());
    }
    bytes
}

fn decode_call(bytes: &[u8; CALL_BYTES]) -> Call {
    let mut felt = [0.0; 6];
    for (value, place) in felt.iter_mut().zip(bytes[9..].chunks_exact(8)) {
        *value = f64::from_le_bytes(place.try_into().unwrap_or_default());
    }
    Call { now: Time(number(&bytes[..8])), is_sync: bytes[8] != 0, felt }
}

fn encode_answer(answer: &Answer) -> [u8; ANSWER_BYTES] {
    let mut bytes = [0; ANSWER_BYTES];
    bytes[..8].copy_from_slice(&answer.torque_n_m.to_le_bytes());
    bytes[8] = STATES.iter().position(|state| *state == answer.state).unwrap_or_default() as u8;
    bytes[9..].copy_from_slice(&answer.next.0.to_le_bytes());
    bytes
}

/// Returns `None` for an answer that no device gives.
fn decode_answer(bytes: &[u8; ANSWER_BYTES]) -> Option<Answer> {
    let torque_n_m = f64::from_bits(number(&bytes[..8]));
    let state = *STATES.get(usize::from(bytes[8]))?;
    torque_n_m.is_finite().then_some(Answer { torque_n_m, state, next: Time(number(&bytes[9..])) })
}

fn number(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |number, byte| number << 8 | u64::from(*byte))
}

/// A device at the other end of a stream.
struct Remote(UnixStream);

impl Peer for Remote {
    fn call(&mut self, call: &Call) -> Option<Answer> {
        let mut bytes = [0; ANSWER_BYTES];
        self.0.write_all(&encode_call(call)).ok()?;
        self.0.read_exact(&mut bytes).ok()?;
        decode_answer(&bytes)
    }
}

/// Takes devices in that attach to an arm.
#[derive(Debug)]
pub struct Entrance {
    listener: UnixListener,
    patience: Duration,
}

/// Why a device could not go on with an arm elsewhere.
#[derive(Debug, thiserror::Error)]
pub enum AttachError {
    /// Nobody listens there.
    #[error("no process with the arm is at this socket: {0}")]
    NoArm(io::Error),
    /// The arm did not take the device in.
    #[error("the process with the arm did not take this device in: it has the device itself, or has ended")]
    NotTaken,
    /// The arm has gone away.
    #[error("the process with the arm has ended, or another process has attached this device")]
    Gone,
    /// The system refuses to wait.
    #[error("waiting for the arm and the bus: {0}")]
    Wait(io::Error),
}

impl Entrance {
    /// Listens at `path`, where nothing may be yet, for devices of this pace.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn open(path: &Path, pace: Pace) -> io::Result<Self> {
        let listener = UnixListener::bind(path)?;
        listener.set_nonblocking(true)?;
        let patience = if pace == Pace::Lockstep { LOCKSTEP_PATIENCE } else { PATIENCE };
        Ok(Self { listener, patience })
    }

    /// Admits the devices that have connected. A device that sends nothing, or that is simulated here already, is rejected.
    pub fn admit(&self, server: &mut DeviceServer) {
        while let Ok((mut stream, _)) = self.listener.accept() {
            let mut device = [0];
            let is_ready = stream.set_nonblocking(false).is_ok()
                && stream.set_read_timeout(Some(self.patience)).is_ok()
                && stream.set_write_timeout(Some(self.patience)).is_ok()
                && stream.read_exact(&mut device).is_ok();
            let device = usize::from(device[0]);
            if is_ready && device < 3 && !server.is_here(device) {
                server.attach(device, Box::new(Remote(stream)));
            }
        }
    }
}

/// A device that is attached to an arm elsewhere.
#[derive(Debug)]
pub enum Attached {
    /// A drive, with the number of its joint.
    Drive(usize, Box<Drive>),
    /// The force sensor.
    Sensor(Box<ForceSensor>),
}

impl Attached {
    fn number(&self) -> u8 {
        match self {
            Attached::Drive(joint, _) => *joint as u8,
            Attached::Sensor(_) => 2,
        }
    }

    fn boot(&mut self, now: Time, out: &mut impl Outbox) {
        match self {
            Attached::Drive(_, drive) => drive.boot(now, out),
            Attached::Sensor(sensor) => sensor.boot(now, out),
        }
    }

    fn measure(&mut self, felt: [f64; 6]) {
        match self {
            Attached::Drive(_, drive) => drive.measure(felt[0], felt[1]),
            Attached::Sensor(sensor) => sensor.measure(felt.map(|count| count as i32)),
        }
    }

    fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
        match self {
            Attached::Drive(_, drive) => drive.on_frame(now, frame, out),
            Attached::Sensor(sensor) => sensor.on_frame(now, frame, out),
        }
    }

    fn poll(&mut self, now: Time, out: &mut impl Outbox) {
        match self {
            Attached::Drive(_, drive) => drive.poll(now, out),
            Attached::Sensor(sensor) => sensor.poll(now, out),
        }
    }

    fn answer(&self) -> Answer {
        match self {
            Attached::Drive(_, drive) => {
                Answer { torque_n_m: drive.torque_n_m(), state: drive.state(), next: drive.next_deadline() }
            }
            Attached::Sensor(sensor) => {
                Answer { torque_n_m: 0.0, state: cia402::State::NotReadyToSwitchOn, next: sensor.next_deadline() }
            }
        }
    }
}

/// Attaches a device to the arm at `path`, switches it on and serves it until `is_over` or until the arm is gone.
///
/// # Errors
/// If there is no arm, if it does not take the device in or goes away, or if waiting fails.
pub fn attach<L: CanLink + AsFd>(
    device: &mut Attached,
    link: &mut L,
    path: &Path,
    is_over: &AtomicBool,
) -> Result<(), AttachError> {
    let mut stream = UnixStream::connect(path).map_err(AttachError::NoArm)?;
    stream.write_all(&[device.number()]).map_err(AttachError::NoArm)?;
    let mut heard = VecDeque::new();
    let mut now = Time(0);
    let mut is_on = false;
    while !is_over.load(Ordering::Relaxed) {
        let mut fds = [PollFd::new(&stream, PollFlags::IN), PollFd::new(&*link, PollFlags::IN)];
        match poll(&mut fds, Some(&LOOK_UP)) {
            Err(rustix::io::Errno::INTR) => continue,
            result => result.map_err(|error| AttachError::Wait(error.into()))?,
        };
        let is_called = !fds[0].revents().is_empty();
        listen(link, &mut heard);
        // Before its time goes on: a heartbeat that waits here is not missed.
        take(device, link, &mut heard, now, is_on);
        if is_called {
            let mut bytes = [0; CALL_BYTES];
            let gone = |_| if is_on { AttachError::Gone } else { AttachError::NotTaken };
            stream.read_exact(&mut bytes).map_err(gone)?;
            let call = decode_call(&bytes);
            now = call.now;
            if call.is_sync {
                wait_for_sync(link, &mut heard);
            }
            let mut out = LinkOutbox::new(link);
            if !std::mem::replace(&mut is_on, true) {
                device.boot(now, &mut out);
            }
            if call.is_sync {
                let after_sync = heard.iter().rposition(|frame: &Frame| frame.id() == cob::SYNC).map_or(0, |at| at + 1);
                for frame in heard.drain(..after_sync).filter(|frame| frame.id() != cob::SYNC) {
                    device.on_frame(now, &frame, &mut out);
                }
                device.measure(call.felt);
                device.on_frame(now, &Frame::new(cob::SYNC, &[]), &mut out);
            } else {
                device.measure(call.felt);
                device.poll(now, &mut out);
            }
            stream.write_all(&encode_answer(&device.answer())).map_err(|_| AttachError::Gone)?;
        }
        take(device, link, &mut heard, now, is_on);
    }
    Ok(())
}

/// Makes the device take the frames that it has received. Frames after a SYNC wait until the arm has announced that SYNC.
fn take<L: CanLink>(device: &mut Attached, link: &mut L, heard: &mut VecDeque<Frame>, now: Time, is_on: bool) {
    let mut out = LinkOutbox::new(link);
    while is_on && heard.front().is_some_and(|frame| frame.id() != cob::SYNC) {
        if let Some(frame) = heard.pop_front() {
            device.on_frame(now, &frame, &mut out);
        }
    }
}

fn listen<L: CanLink>(link: &mut L, heard: &mut VecDeque<Frame>) {
    while let Some(arrival) = link.receive() {
        if let Received::Frame(frame) = arrival.what {
            heard.push_back(frame);
        }
    }
}

fn wait_for_sync<L: CanLink>(link: &mut L, heard: &mut VecDeque<Frame>) {
    let until = link.now() + SYNC_PATIENCE;
    while !heard.iter().any(|frame| frame.id() == cob::SYNC) && link.now() < until {
        link.wait(until);
        listen(link, heard);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn calls_and_answers_come_back(
            now: u64, is_sync: bool, felt: [f64; 6], torque_n_m in -1e9..1e9_f64, state in 0_usize..8, next: u64,
        ) {
            let call = Call { now: Time(now), is_sync, felt };
            let again = decode_call(&encode_call(&call));
            prop_assert_eq!((again.now, again.is_sync), (call.now, call.is_sync));
            prop_assert_eq!(again.felt.map(f64::to_bits), felt.map(f64::to_bits));
            let answer = Answer { torque_n_m, state: STATES[state], next: Time(next) };
            prop_assert_eq!(decode_answer(&encode_answer(&answer)), Some(answer));
        }

        #[test]
        fn no_bytes_are_a_torque_that_is_none(bytes: [u8; ANSWER_BYTES]) {
            if let Some(answer) = decode_answer(&bytes) {
                prop_assert!(answer.torque_n_m.is_finite());
            }
        }
    }
}
