//! Simulated devices on a link.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use thiserror::Error;

use crate::{DeviceServer, RigError};
use yieldwall_fieldbus::canopen::cob;
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{CanLink, LinkOutbox, Received, SendError};

/// Longest wait for a frame before the server checks for a request to end.
pub(super) const LOOK_UP: Duration = Duration::from_millis(50);

/// Time between two looks at the link above which the frames in between are stale: the process was stopped. A master in lockstep
/// waits this long for process data.
pub(super) const ABSENCE: Duration = Duration::from_secs(1);

/// Why simulated devices could not go on.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ServeError {
    /// The simulated arm cannot go on.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// The interface was removed.
    #[error("the interface is gone")]
    Gone,
}

/// Switches on the devices that are simulated here and serves them, until `is_over` or the interface is removed. If the process was
/// stopped, or could not run for a second, it takes only the NMT commands from that time. It waits for an interface that is down:
/// the devices then receive nothing, as with an unplugged cable. `between` is called at least twenty times a second.
///
/// # Errors
/// If the simulated arm cannot go on, or there is no interface any more.
pub fn serve<L: CanLink>(
    server: &mut DeviceServer,
    link: &mut L,
    is_over: &AtomicBool,
    mut between: impl FnMut(&mut DeviceServer),
) -> Result<(), ServeError> {
    let wall = link.now();
    send(link, |out| {
        server.switch_on(wall, out);
        Ok(())
    })?;
    let mut looked_at = wall;
    let mut back_since = Time::default();
    while !is_over.load(Ordering::Relaxed) {
        while let Some(arrival) = link.receive() {
            let wall = link.now();
            if wall.since(std::mem::replace(&mut looked_at, wall)) > ABSENCE {
                back_since = wall;
            }
            match arrival.what {
                // What was commanded of devices that were away is no longer meant. NMT commands are, whenever they come.
                Received::Frame(frame) if arrival.time < back_since && frame.id() != cob::NMT => {}
                Received::Frame(frame) => {
                    send(link, |out| server.on_frame(arrival.time, &frame, out))?;
                }
                Received::Gone => return Err(ServeError::Gone),
                _ => {}
            }
        }
        between(server);
        let wall = link.now();
        if wall.since(std::mem::replace(&mut looked_at, wall)) > ABSENCE {
            back_since = wall;
        }
        send(link, |out| server.poll(wall, out))?;
        link.wait(server.next_deadline().min(wall + LOOK_UP));
    }
    Ok(())
}

fn send<L: CanLink>(
    link: &mut L,
    act: impl FnOnce(&mut LinkOutbox<'_, L>) -> Result<(), RigError>,
) -> Result<(), ServeError> {
    let mut out = LinkOutbox::new(link);
    act(&mut out)?;
    if matches!(out.failure(), Some((_, SendError::Gone))) { Err(ServeError::Gone) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use super::*;
    use crate::{Answer, Call, Peer};
    use yieldwall_config as config;
    use yieldwall_drives::cia402;
    use yieldwall_fieldbus::canopen::{BusId, Frame};
    use yieldwall_link::Arrival;
    use yieldwall_run::Pace;

    /// What comes, and at which moment the process looks at it.
    struct Script {
        now: Time,
        coming: VecDeque<(Time, Arrival)>,
        sent: Vec<Frame>,
    }

    impl CanLink for Script {
        fn now(&self) -> Time {
            self.now
        }

        fn receive(&mut self) -> Option<Arrival> {
            let (looked_at, _) = self.coming.front()?;
            self.now = self.now.max(*looked_at);
            self.coming.pop_front().map(|(_, arrival)| arrival)
        }

        fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
            self.sent.push(*frame);
            Ok(())
        }

        fn wait(&mut self, until: Time) -> bool {
            self.now = until;
            false
        }
    }

    #[test]
    fn what_came_while_the_process_was_stopped_is_dropped_but_for_nmt_commands() {
        let rig = config::load_rig(config::Source::named("builtin:paper-admittance.yaml")).unwrap().value;
        let scene = config::load_scene(config::Source::named("builtin:scenes/circle-tour.yaml")).unwrap().value;
        for pace in [Pace::Lockstep, Pace::Free] {
            let mut server = DeviceServer::new(&rig, &scene, 1, pace).unwrap();
            let at = |seconds: f64| Time((1e9 * seconds) as u64);
            let arrival = |stamp: f64, looked_at: f64, id: u16, data: &[u8]| {
                let what = Received::Frame(Frame::new(id, data));
                (at(looked_at), Arrival { time: at(stamp), bus: BusId::FIRST, what })
            };
            // One in time, then a stop of 9 s in which 4000 came, then one in time again.
            let mut coming = VecDeque::from([arrival(0.1, 0.1, cob::SYNC, &[])]);
            coming.extend((0..4000).map(|number| arrival(0.2 + 0.002 * f64::from(number), 9.1, cob::SYNC, &[])));
            coming.push_back(arrival(9.0, 9.1, cob::NMT, &[0x81, 1]));
            coming.push_back(arrival(9.2, 9.2, cob::SYNC, &[]));
            let mut link = Script { now: Time(0), coming, sent: Vec::new() };
            let is_over = AtomicBool::new(false);
            serve(&mut server, &mut link, &is_over, |_| is_over.store(true, Ordering::Relaxed)).unwrap();
            assert_eq!(server.counts().syncs, 2, "{pace:?}");
            let boot_ups = link.sent.iter().filter(|frame| frame.id() == 0x701 && frame.data() == [0]);
            assert_eq!(boot_ups.count(), 2, "{pace:?}: one of switching on, one of the reset");
        }
    }

    #[test]
    fn a_heartbeat_that_waited_to_be_taken_was_heard_when_it_came() {
        let rig = config::load_rig(config::Source::named("builtin:paper-admittance.yaml")).unwrap().value;
        let scene = config::load_scene(config::Source::named("builtin:scenes/circle-tour.yaml")).unwrap().value;
        let at = |milliseconds: u64| Time(milliseconds * 1_000_000);
        let is_lost = |pace, beats: &[(u64, u64)]| {
            let mut server = DeviceServer::new(&rig, &scene, 1, pace).unwrap();
            let arrival = |(stamp, looked_at), id: u16, data: &[u8]| {
                let what = Received::Frame(Frame::new(id, data));
                (at(looked_at), Arrival { time: at(stamp), bus: BusId::FIRST, what })
            };
            // 1016h:1: the left drive hears node 127 every 40 ms.
            let mut coming = VecDeque::from([arrival((10, 10), 0x601, &[0x23, 0x16, 0x10, 1, 40, 0, 127, 0])]);
            coming.extend(beats.iter().map(|beat| arrival(*beat, 0x77f, &[5])));
            let mut link = Script { now: Time(0), coming, sent: Vec::new() };
            let is_over = AtomicBool::new(false);
            serve(&mut server, &mut link, &is_over, |_| is_over.store(true, Ordering::Relaxed)).unwrap();
            link.sent.iter().any(|frame| frame.id() == 0x081)
        };
        for pace in [Pace::Lockstep, Pace::Free] {
            // The process stood still from 20 to 75 ms.
            assert!(!is_lost(pace, &[(20, 20), (40, 75), (60, 75), (80, 80)]), "{pace:?}");
            assert!(is_lost(pace, &[(20, 20), (80, 80)]), "{pace:?}: nobody sent one");
        }
    }

    /// A device elsewhere with nothing to do.
    struct Idle;

    impl Peer for Idle {
        fn call(&mut self, _: &Call) -> Option<Answer> {
            Some(Answer { torque_n_m: 0.0, state: cia402::State::SwitchOnDisabled, next: Time::NEVER })
        }
    }

    #[test]
    fn in_lockstep_frames_that_waited_take_no_time_from_a_device_elsewhere_that_has_heard_them() {
        let rig = config::load_rig(config::Source::named("builtin:paper-admittance.yaml")).unwrap().value;
        let scene = config::load_scene(config::Source::named("builtin:scenes/circle-tour.yaml")).unwrap().value;
        let mut server = DeviceServer::new(&rig, &scene, 1, Pace::Lockstep).unwrap().only([true, false, true]);
        server.attach(1, Box::new(Idle));
        let at = |milliseconds: u64| Time(milliseconds * 1_000_000);
        let heartbeat = |number: u64| {
            let what = Received::Frame(Frame::new(0x77f, &[5]));
            // It takes the computer long to serve each of them.
            (at(20 * number), Arrival { time: at(20), bus: BusId::FIRST, what })
        };
        let mut link = Script { now: Time(0), coming: (1..=40).map(heartbeat).collect(), sent: Vec::new() };
        let is_over = AtomicBool::new(false);
        serve(&mut server, &mut link, &is_over, |_| is_over.store(true, Ordering::Relaxed)).unwrap();
        assert!(server.now() <= at(10), "{:?}", server.now());
    }
}
