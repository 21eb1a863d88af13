//! A simulated segment on an Ethernet interface, and the devices of its rig that are on CAN.

use std::sync::atomic::{AtomicBool, Ordering};

use super::serve::{ABSENCE, LOOK_UP, ServeError};
use crate::{RigError, SegmentServer};
use yieldwall_fieldbus::canopen::cob;
use yieldwall_fieldbus::ethercat::frame::LONGEST;
use yieldwall_link::{EthernetReceived, Received, SendError, Wires};

/// Number of frames before the server checks for a request to end.
const MOST_AT_ONCE: usize = 64;

/// Serves a segment, and devices on CAN beside it, until `is_over` or an interface is removed. If the process was stopped, or could
/// not run for a second, it takes only the NMT commands from that time. It waits for an interface that is down: the devices then
/// receive nothing, as with an unplugged cable. `between` is called at least twenty times a second.
///
/// # Errors
/// If the simulated arm cannot go on, or there is no interface any more.
pub fn serve_segment<L: Wires>(
    server: &mut SegmentServer,
    link: &mut L,
    is_over: &AtomicBool,
    mut between: impl FnMut(&mut SegmentServer),
) -> Result<(), ServeError> {
    let mut buffer = [0; LONGEST];
    let mut looked_at = link.now();
    while !is_over.load(Ordering::Relaxed) {
        let wall = link.now();
        let was_away = wall.since(std::mem::replace(&mut looked_at, wall)) > ABSENCE;
        for _ in 0..MOST_AT_ONCE {
            let arrival = link.receive_ethernet(&mut buffer);
            // A master sends SYNC before the frame of the segment, and so it is taken before it.
            take_can(server, link, was_away)?;
            let Some(arrival) = arrival else { break };
            match arrival.what {
                // What was commanded of devices that were away is no longer meant.
                EthernetReceived::Frame { .. } if was_away => {}
                EthernetReceived::Frame { length } => {
                    let frame = buffer.get_mut(..length).unwrap_or_default();
                    back(link, |send| server.on_frame(arrival.time, frame, send))?;
                }
                EthernetReceived::Gone => return Err(ServeError::Gone),
                _ => {}
            }
        }
        between(server);
        let wall = link.now();
        back(link, |send| server.poll(wall, send))?;
        send_can(server, link)?;
        link.wait(server.next_deadline().min(wall + LOOK_UP));
    }
    Ok(())
}

/// Takes what has come over CAN.
fn take_can<L: Wires>(server: &mut SegmentServer, link: &mut L, was_away: bool) -> Result<(), ServeError> {
    for _ in 0..MOST_AT_ONCE {
        let Some(arrival) = link.receive() else { break };
        match arrival.what {
            Received::Frame(frame) if was_away && frame.id() != cob::NMT => {}
            Received::Frame(frame) => {
                server.on_can(arrival.time, &frame)?;
                send_can(server, link)?;
            }
            Received::Gone => return Err(ServeError::Gone),
            _ => {}
        }
    }
    Ok(())
}

/// Sends what devices on CAN have sent. A frame for which the queue of the interface has no room waits.
fn send_can<L: Wires>(server: &mut SegmentServer, link: &mut L) -> Result<(), ServeError> {
    let mut is_gone = false;
    server.drain_can(|frame| {
        let sent = link.send(frame);
        is_gone |= sent == Err(SendError::Gone);
        sent != Err(SendError::Full)
    });
    if is_gone { Err(ServeError::Gone) } else { Ok(()) }
}

/// Sends what comes back. A frame that the interface does not take is lost.
fn back<L: Wires>(
    link: &mut L,
    act: impl FnOnce(&mut dyn FnMut(&[u8])) -> Result<(), RigError>,
) -> Result<(), ServeError> {
    let mut is_gone = false;
    act(&mut |frame| is_gone |= matches!(link.send_ethernet(frame), Err(SendError::Gone)))?;
    if is_gone { Err(ServeError::Gone) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use super::*;
    use yieldwall_config as config;
    use yieldwall_fieldbus::canopen::{BusId, Frame};
    use yieldwall_fieldbus::ethercat::frame::{Command, FrameWriter, address};
    use yieldwall_fieldbus::time::Time;
    use yieldwall_link::{Arrival, CanLink, EthernetArrival};
    use yieldwall_run::Pace;

    /// Frames, and at which moment the process looks at them; when there are none any more it is over.
    struct Script<'a> {
        now: Time,
        coming: VecDeque<(Time, Vec<u8>)>,
        sent: Vec<Vec<u8>>,
        on_can: VecDeque<(Time, Frame)>,
        sent_on_can: Vec<Frame>,
        /// Whether the process sleeps until something comes, whenever it wanted to wake up.
        oversleeps: bool,
        is_over: &'a AtomicBool,
    }

    impl Wires for Script<'_> {
        fn receive_ethernet(&mut self, buffer: &mut [u8]) -> Option<EthernetArrival> {
            let (time, _) = self.coming.front().filter(|(looked_at, _)| *looked_at <= self.now)?;
            let time = *time;
            let (_, frame) = self.coming.pop_front()?;
            buffer[..frame.len()].copy_from_slice(&frame);
            Some(EthernetArrival { time, what: EthernetReceived::Frame { length: frame.len() } })
        }

        fn send_ethernet(&mut self, frame: &[u8]) -> Result<(), SendError> {
            self.sent.push(frame.to_vec());
            Ok(())
        }
    }

    impl CanLink for Script<'_> {
        fn now(&self) -> Time {
            self.now
        }

        fn receive(&mut self) -> Option<Arrival> {
            let (time, frame) = *self.on_can.front().filter(|(looked_at, _)| *looked_at <= self.now)?;
            self.on_can.pop_front();
            Some(Arrival { time, bus: frame.bus(), what: Received::Frame(frame) })
        }

        fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
            self.sent_on_can.push(*frame);
            Ok(())
        }

        fn wait(&mut self, until: Time) -> bool {
            let on_can = self.on_can.front().map(|(looked_at, _)| *looked_at);
            match self.coming.front().map(|(looked_at, _)| *looked_at).into_iter().chain(on_can).min() {
                Some(looked_at) if self.oversleeps => self.now = self.now.max(looked_at),
                Some(looked_at) => self.now = self.now.max(looked_at.min(until)),
                None => self.is_over.store(true, Ordering::Relaxed),
            }
            true
        }
    }

    impl<'a> Script<'a> {
        fn new(is_over: &'a AtomicBool) -> Self {
            let (coming, sent, on_can, sent_on_can) = Default::default();
            Self { now: Time(0), coming, sent, on_can, sent_on_can, oversleeps: false, is_over }
        }
    }

    /// Time waits on both buses: a SYNC and the frame behind it are one period, however long they are apart.
    #[test]
    fn in_lockstep_sync_and_the_frame_behind_it_are_one_period() {
        let rig = config::load_rig(config::builtin("paper-ethercat-can-sensor.yaml")).unwrap();
        let scene = rig.scene().unwrap().value;
        let mut server = SegmentServer::new(&rig.value, &scene, 1, Pace::Lockstep, [true; 3], Time(0)).unwrap();
        let mut buffer = [0; 64];
        let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]).unwrap();
        writer.push(Command::Lrd, 1, 0x100, &[0; 2]).unwrap();
        let reading = writer.finish().to_vec();
        let sensor = BusId::new(1);
        let at = |milliseconds: u64| Time(milliseconds * 1_000_000);
        let is_over = AtomicBool::new(false);
        let mut link = Script::new(&is_over);
        // The boot: the sensor is asked and started, and frames of the segment alone advance time.
        let answers = Frame::new(0x60a, &[0x2f, 0x00, 0x18, 2, 1, 0, 0, 0]).on_bus(sensor);
        link.on_can.extend([(at(1900), answers), (at(2000), Frame::new(cob::NMT, &[1, 10]).on_bus(sensor))]);
        link.coming.extend((0..10).map(|number| (at(2001 + number), reading.clone())));
        // Then cycles, each 300 ms on the wall.
        link.on_can.extend((0..10).map(|number| (at(2100 + 300 * number), Frame::new(cob::SYNC, &[]).on_bus(sensor))));
        link.coming.extend((0..10).map(|number| (at(2100 + 300 * number + 150), reading.clone())));
        serve_segment(&mut server, &mut link, &is_over, |_| ()).unwrap();
        assert_eq!((server.counts().syncs, server.counts().frames, link.sent.len()), (10, 20, 20));
        // 2.001 s of the wall, 9 periods of the boot, 10 of the cycles.
        assert_eq!(server.now(), at(2001 + 9 + 10));
        // The boot-up message and the answer.
        let sent: Vec<_> = link.sent_on_can.iter().map(|frame| (frame.bus(), frame.id())).collect();
        assert_eq!((sent, server.counts().sent), (vec![(sensor, 0x70a), (sensor, 0x58a)], 2));
    }

    #[test]
    fn frames_come_back_but_not_those_that_came_while_nobody_looked() {
        let rig = config::load_rig(config::builtin("paper-ethercat.yaml")).unwrap();
        let scene = rig.scene().unwrap().value;
        let mut server = SegmentServer::new(&rig.value, &scene, 1, Pace::Free, [true; 3], Time(0)).unwrap();
        let mut buffer = [0; 64];
        let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]).unwrap();
        writer.push(Command::Brd, 1, address(0, 0x0130), &[0; 2]).unwrap();
        let frame = writer.finish().to_vec();
        let coming = [10, 5000, 5000, 5010].map(|milliseconds: u64| (Time(milliseconds * 1_000_000), frame.clone()));
        let is_over = AtomicBool::new(false);
        let mut link = Script { coming: coming.into(), oversleeps: true, ..Script::new(&is_over) };
        serve_segment(&mut server, &mut link, &is_over, |_| ()).unwrap();
        assert_eq!((server.counts().frames, server.counts().returned, link.sent.len()), (2, 2, 2));
        // All three in INIT, and each has counted.
        assert!(link.sent.iter().all(|sent| sent[26..30] == [0x01, 0, 3, 0]), "{:02x?}", link.sent);
    }
}
