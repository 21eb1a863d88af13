//! Prints what the codecs of this project read in a capture, to be held against what tshark reads:
//!
//! ```text
//! target/debug/fields CAPTURE.pcap
//! ```
//!
//! One line a frame: command, index, position, offset, logical address, interrupt and working counter of all datagrams; then length, address,
//! type and counter of all mailboxes, and service, index, sub-index and abort code of CoE. Columns with tabs, several of a kind with commas.

use yieldwall::ethercat::coe::Service;
use yieldwall::ethercat::frame::{Command, Datagram, Datagrams};
use yieldwall::ethercat::mailbox::{self, Protocol};

use hil_tests_ethercrab::capture;

/// First byte of the mailboxes of the devices.
const MAILBOXES: [u16; 2] = [0x1000, 0x1400];

/// What is printed of a frame: of its datagrams, and of the mailboxes in them.
#[derive(Default)]
struct Line {
    datagrams: [Vec<String>; 7],
    mailboxes: [Vec<String>; 8],
}

fn main() {
    let path = std::env::args().nth(1).expect("a capture");
    let bytes = std::fs::read(&path).unwrap_or_else(|error| panic!("{path}: {error}"));
    for frame in capture::read(&bytes).expect("a capture of pcap") {
        let mut line = Line::default();
        for datagram in Datagrams::of(frame).expect("an EtherCAT frame") {
            line.add(&datagram.expect("a datagram"));
        }
        let columns = line.datagrams.iter().chain(&line.mailboxes);
        println!("{}", columns.map(|column| column.join(",")).collect::<Vec<_>>().join("\t"));
    }
}

impl Line {
    fn add(&mut self, datagram: &Datagram<'_>) {
        let Datagram { header, data, working_counter } = datagram;
        let [command, index, adp, ado, logical, interrupt, counter] = &mut self.datagrams;
        command.push(header.command.to_string());
        index.push(header.index.to_string());
        if is_logical(header.command) {
            logical.push(header.address.to_string());
        } else {
            adp.push(header.adp().to_string());
            ado.push(header.ado().to_string());
        }
        interrupt.push(header.interrupt.to_string());
        counter.push(working_counter.to_string());
        let is_mailbox = !is_logical(header.command) && MAILBOXES.contains(&header.ado());
        // A reply that nobody has filled is as empty as it was sent.
        if is_mailbox && (header.command != Command::Fprd as u8 || *working_counter > 0) {
            self.add_mailbox(data);
        }
    }

    fn add_mailbox(&mut self, bytes: &[u8]) {
        let [length, address, kind, counter, service, index, sub, abort] = &mut self.mailboxes;
        let (header, message) = mailbox::decode(bytes).expect("a mailbox");
        length.push(header.len.to_string());
        address.push(header.address.to_string());
        kind.push(header.protocol.to_string());
        counter.push(header.counter.to_string());
        let coe = Service::of(message).filter(|_| header.protocol == Protocol::Coe as u8);
        let Some(of) = coe else { return };
        service.push((of as u8).to_string());
        let Some([command, low, high, number]) = message.get(2..6) else { return };
        if matches!(of, Service::SdoRequest | Service::SdoResponse) && command >> 5 == 4 {
            let code = message.get(6..).and_then(|rest| rest.first_chunk::<4>()).copied().map(u32::from_le_bytes);
            abort.push(code.expect("an abort has a code").to_string());
            return;
        }
        // Segments have no address: downloads and uploads of them are 0 and 3 in a request, 1 and 0 in a response.
        let has_address = match of {
            Service::SdoRequest => !matches!(command >> 5, 0 | 3),
            Service::SdoResponse => !matches!(command >> 5, 0 | 1),
            Service::Emergency | Service::Information => false,
        };
        if has_address {
            index.push(u16::from_le_bytes([*low, *high]).to_string());
            sub.push(number.to_string());
        }
    }
}

const fn is_logical(command: u8) -> bool {
    command == Command::Lrd as u8 || command == Command::Lwr as u8 || command == Command::Lrw as u8
}
