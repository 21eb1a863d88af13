//! Whether drives have been switched off and on since the network was left.
//!
//! A node of a CANopen bus says so by its boot-up message (CiA 301). A device of an EtherCAT segment has lost the station address that the
//! bring-up gave it (0010h, ETG.1000.4): it is asked for by its position.

use crate::assembly::{AssemblyError, bus_id};
use yieldwall_config as config;
use yieldwall_fieldbus::canopen::{BusId, Frame, NmtState, nmt};
use yieldwall_fieldbus::ethercat::frame::{Command, Datagrams, FrameWriter, LONGEST, SHORTEST, address};
use yieldwall_fieldbus::ethercat::registers::STATION_ADDRESS;
use yieldwall_link::{EthernetReceived, Received, Wires};

/// Arrivals that one look takes of each kind at most. Buses that are left have few.
const ARRIVALS: usize = 4096;

/// Sign that a drive has restarted.
#[derive(Clone, Copy, Debug)]
enum Sign {
    /// The boot-up message of this node.
    BootUp { bus: BusId, node_id: u8 },
    /// No station address at this position.
    NoAddress { position: u16 },
}

/// Detector of restarted drives while nothing is booted.
#[derive(Clone, Copy, Debug)]
pub struct Restarts {
    signs: [Sign; 2],
    seen: [bool; 2],
}

impl Restarts {
    /// Creates a detector that has not yet seen anything of this rig's drives; earlier frames in `wires` do not count.
    ///
    /// # Errors
    /// If a drive is on a bus that the rig does not have.
    pub fn of(rig: &config::Rig, wires: &mut (impl Wires + ?Sized)) -> Result<Self, AssemblyError> {
        let sign = |drive: &config::Drive| -> Result<Sign, AssemblyError> {
            Ok(match drive.address {
                config::Address::Canopen(node) => Sign::BootUp { bus: bus_id(rig, &drive.bus)?, node_id: node.node_id },
                config::Address::Ethercat(place) => Sign::NoAddress { position: place.position },
            })
        };
        let [left, right] = &rig.drives;
        let mut restarts = Self { signs: [sign(left)?, sign(right)?], seen: [false; 2] };
        restarts.take(wires);
        restarts.seen = [false; 2];
        Ok(restarts)
    }

    /// Takes the frames since the last call, and asks the devices of a segment anew for the next call. Returns which drives have
    /// restarted.
    pub fn look(&mut self, wires: &mut (impl Wires + ?Sized)) -> [bool; 2] {
        self.take(wires);
        for (joint, sign) in self.signs.into_iter().enumerate() {
            let Sign::NoAddress { position } = sign else { continue };
            let mut buffer = [0; SHORTEST];
            let asked = FrameWriter::new(&mut buffer, wires.source()).and_then(|mut writer| {
                // Each device that the datagram passes counts the address up; the one that finds 0 answers.
                let position = position.wrapping_neg();
                writer.push(Command::Aprd, joint as u8, address(position, STATION_ADDRESS), &[0; 2])?;
                Ok(writer.finish().len())
            });
            if asked.is_ok() {
                // What cannot be sent now is sent at the next look.
                let _ = wires.send_ethernet(&buffer);
            }
        }
        self.seen
    }

    fn take(&mut self, wires: &mut (impl Wires + ?Sized)) {
        for arrival in (0..ARRIVALS).map_while(|_| wires.receive()) {
            if let Received::Frame(frame) = arrival.what {
                self.on_frame(&frame);
            }
        }
        let mut buffer = [0; LONGEST];
        for _ in 0..ARRIVALS {
            let Some(arrival) = wires.receive_ethernet(&mut buffer) else { break };
            if let EthernetReceived::Frame { length } = arrival.what {
                self.on_ethernet(buffer.get(..length).unwrap_or_default());
            }
        }
    }

    fn on_frame(&mut self, frame: &Frame) {
        let Some((node, NmtState::Initialising)) = nmt::decode_heartbeat(frame) else { return };
        for (sign, seen) in self.signs.iter().zip(&mut self.seen) {
            *seen |= matches!(sign, Sign::BootUp { bus, node_id } if *bus == frame.bus() && *node_id == node.raw());
        }
    }

    fn on_ethernet(&mut self, bytes: &[u8]) {
        for datagram in Datagrams::of(bytes).into_iter().flatten().map_while(Result::ok) {
            let header = datagram.header;
            let has_no_address = header.command == Command::Aprd as u8
                && header.ado() == STATION_ADDRESS
                && (datagram.data, datagram.working_counter) == (&[0, 0], 1);
            if let (true, Some(Sign::NoAddress { .. }), Some(seen)) = (
                has_no_address,
                self.signs.get(usize::from(header.index)),
                self.seen.get_mut(usize::from(header.index)),
            ) {
                *seen = true;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use super::*;
    use yieldwall_fieldbus::time::Time;
    use yieldwall_link::{Arrival, CanLink, EthernetArrival, SendError};

    /// What has come, and what was sent over a segment.
    #[derive(Default)]
    struct Held {
        frames: VecDeque<Frame>,
        packets: VecDeque<Vec<u8>>,
        sent: Vec<Vec<u8>>,
    }

    impl CanLink for Held {
        fn now(&self) -> Time {
            Time(0)
        }

        fn receive(&mut self) -> Option<Arrival> {
            let frame = self.frames.pop_front()?;
            Some(Arrival { time: Time(0), bus: frame.bus(), what: Received::Frame(frame) })
        }

        fn send(&mut self, _: &Frame) -> Result<(), SendError> {
            panic!("nothing is asked of a node");
        }

        fn wait(&mut self, _: Time) -> bool {
            false
        }
    }

    impl Wires for Held {
        fn receive_ethernet(&mut self, buffer: &mut [u8]) -> Option<EthernetArrival> {
            let packet = self.packets.pop_front()?;
            buffer[..packet.len()].copy_from_slice(&packet);
            Some(EthernetArrival { time: Time(0), what: EthernetReceived::Frame { length: packet.len() } })
        }

        fn send_ethernet(&mut self, bytes: &[u8]) -> Result<(), SendError> {
            self.sent.push(bytes.to_vec());
            Ok(())
        }
    }

    fn rig(name: &str) -> config::Rig {
        config::load_rig(config::Source::named(name)).unwrap().value
    }

    #[test]
    fn a_node_has_restarted_by_its_own_boot_up_on_its_own_bus_and_by_no_older_one() {
        let rig = rig("builtin:paper-admittance.yaml");
        let nodes = rig.drives.each_ref().map(|drive| u16::from(drive.address.node_id().unwrap()));
        let of = |joint: usize, state| Frame::new(0x700 + nodes[joint], &[state]);
        let mut held = Held::default();
        held.frames.push_back(of(1, 0));
        let mut restarts = Restarts::of(&rig, &mut held).unwrap();
        assert_eq!(restarts.look(&mut held), [false; 2], "that one was before");
        // A heartbeat in pre-operational, a boot-up of somebody else, and one on another bus.
        let elsewhere = of(0, 0).on_bus(BusId::new(3));
        held.frames.extend([of(0, 0x7f), Frame::new(0x77f, &[0]), elsewhere, Frame::new(0x700 + nodes[0], &[0, 0])]);
        assert_eq!(restarts.look(&mut held), [false; 2]);
        held.frames.push_back(of(1, 0));
        assert_eq!(restarts.look(&mut held), [false, true]);
        held.frames.extend([of(0, 0), of(0, 0x7f)]);
        assert_eq!(restarts.look(&mut held), [true; 2]);
        assert!(held.sent.is_empty());
    }

    #[test]
    fn a_device_has_restarted_where_the_one_at_its_position_has_no_address() {
        let mut held = Held::default();
        let mut restarts = Restarts::of(&rig("builtin:paper-ethercat.yaml"), &mut held).unwrap();
        assert_eq!(restarts.look(&mut held), [false; 2]);
        // APRD of 0010h of the devices at positions 0 and 1.
        let [first, second] = [0, 1].map(|joint| held.sent[joint].clone());
        assert_eq!(first[14..30], [0x0e, 0x10, 1, 0, 0, 0, 0x10, 0, 2, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(second[14..30], [0x0e, 0x10, 1, 1, 0xff, 0xff, 0x10, 0, 2, 0, 0, 0, 0, 0, 0, 0]);
        let answered = |sent: &[u8], address: [u8; 2], counter: u8| {
            let mut answer = sent.to_vec();
            answer[26..28].copy_from_slice(&address);
            answer[28] = counter;
            answer
        };
        // One that has its address, and one that nobody has answered.
        held.packets.extend([answered(&first, [1, 0x10], 1), answered(&second, [0, 0], 0)]);
        assert_eq!(restarts.look(&mut held), [false; 2]);
        held.packets.push_back(answered(&second, [0, 0], 1));
        assert_eq!(restarts.look(&mut held), [false, true]);
        held.packets.extend([vec![0; 9], answered(&first, [0, 0], 1)]);
        assert_eq!(restarts.look(&mut held), [true; 2]);
    }
}
