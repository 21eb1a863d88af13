//! A simulated segment on an Ethernet interface.

use std::sync::atomic::{AtomicBool, Ordering};

use super::serve::{ABSENCE, LOOK_UP, ServeError};
use crate::ethercat::frame::LONGEST;
use crate::link::{EthernetLink, EthernetReceived, SendError};
use crate::rig::SegmentServer;

/// Frames that are taken before the wish to end is looked at.
const MOST_AT_ONCE: usize = 64;

/// Serves a segment until `is_over` or the interface is removed. Of what came while the process was stopped, or could not run for a
/// second, nothing is taken. An interface that is down is waited for: the devices then hear nothing, as with the cable out.
///
/// # Errors
/// If the simulated arm cannot go on, or there is no interface any more.
pub fn serve_segment<L: EthernetLink>(
    server: &mut SegmentServer,
    link: &mut L,
    is_over: &AtomicBool,
) -> Result<(), ServeError> {
    let mut buffer = [0; LONGEST];
    let mut looked_at = link.now();
    while !is_over.load(Ordering::Relaxed) {
        let wall = link.now();
        let was_away = wall.since(std::mem::replace(&mut looked_at, wall)) > ABSENCE;
        for _ in 0..MOST_AT_ONCE {
            let Some(arrival) = link.receive(&mut buffer) else { break };
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
        let wall = link.now();
        back(link, |send| server.poll(wall, send))?;
        link.wait(server.next_deadline().min(wall + LOOK_UP));
    }
    Ok(())
}

/// Sends what comes back. A frame that the interface does not take is lost.
fn back<L: EthernetLink>(
    link: &mut L,
    act: impl FnOnce(&mut dyn FnMut(&[u8])) -> Result<(), crate::rig::RigError>,
) -> Result<(), ServeError> {
    let mut is_gone = false;
    act(&mut |frame| is_gone |= matches!(link.send(frame), Err(SendError::Gone)))?;
    if is_gone { Err(ServeError::Gone) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use super::*;
    use crate::config;
    use crate::ethercat::frame::{Command, FrameWriter, address};
    use crate::link::EthernetArrival;
    use crate::run::Pace;
    use crate::time::Time;

    /// Frames, and at which moment the process looks at them; when there are none any more it is over.
    struct Script<'a> {
        now: Time,
        coming: VecDeque<(Time, Vec<u8>)>,
        sent: Vec<Vec<u8>>,
        is_over: &'a AtomicBool,
    }

    impl EthernetLink for Script<'_> {
        fn now(&self) -> Time {
            self.now
        }

        fn receive(&mut self, buffer: &mut [u8]) -> Option<EthernetArrival> {
            let (time, _) = self.coming.front().filter(|(looked_at, _)| *looked_at <= self.now)?;
            let time = *time;
            let (_, frame) = self.coming.pop_front()?;
            buffer[..frame.len()].copy_from_slice(&frame);
            Some(EthernetArrival { time, what: EthernetReceived::Frame { length: frame.len() } })
        }

        fn send(&mut self, frame: &[u8]) -> Result<(), SendError> {
            self.sent.push(frame.to_vec());
            Ok(())
        }

        fn wait(&mut self, _: Time) -> bool {
            match self.coming.front() {
                Some((looked_at, _)) => self.now = self.now.max(*looked_at),
                None => self.is_over.store(true, Ordering::Relaxed),
            }
            true
        }
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
        let mut link = Script { now: Time(0), coming: coming.into(), sent: Vec::new(), is_over: &is_over };
        serve_segment(&mut server, &mut link, &is_over).unwrap();
        assert_eq!((server.counts().frames, server.counts().returned, link.sent.len()), (2, 2, 2));
        // All three in INIT, and each has counted.
        assert!(link.sent.iter().all(|sent| sent[26..30] == [0x01, 0, 3, 0]), "{:02x?}", link.sent);
    }
}
