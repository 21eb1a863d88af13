//! Bodies for any bus.

use std::time::Duration;

use hil_tests::Scenario;
use hil_tests::network::{Lossy, Network, PATIENCE, Peer, Served, bare, client, device, hear, lss, run, transfer};
use yieldwall::assembly::master;
use yieldwall::bus::{Packet, Phase};
use yieldwall::canopen::lss::{LssAddress, LssMaster, LssOutcome, LssRequest};
use yieldwall::canopen::{EmcyCode, Emergency, Frame, NmtCommand, NmtState, SdoClient, SdoOutcome, cob, nmt, node_id};
use yieldwall::cycle::Timing;
use yieldwall::guard::Request;
use yieldwall::link::{CanLink, Received};
use yieldwall::objects::{AbortCode, Address};
use yieldwall::rig::DeviceServer;
use yieldwall::run::Pace;

const NODE: u8 = 5;

/// `len` bytes that follow from `seed`.
fn bytes(len: usize, seed: u64) -> Vec<u8> {
    (0..len as u64).map(|place| ((place + seed).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56) as u8).collect()
}

/// How a value is transferred.
#[derive(Clone, Copy, Debug)]
enum Way {
    Plain,
    Blocks,
}

fn write(link: &mut impl CanLink, client: &mut SdoClient, object: (u16, u8), data: &[u8], way: Way) {
    let (index, sub) = object;
    let outcome = transfer(link, client, |client, now, out| {
        match way {
            Way::Plain => client.start_download(now, index, sub, data, out),
            Way::Blocks => client.start_block_download(now, index, sub, data, out),
        }
        .expect("idle");
    });
    assert_eq!(outcome, SdoOutcome::Downloaded { at: Address::new(index, sub) }, "{} bytes, {way:?}", data.len());
}

fn read(link: &mut impl CanLink, client: &mut SdoClient, object: (u16, u8), way: Way) -> Vec<u8> {
    let (index, sub) = object;
    let outcome = transfer(link, client, |client, now, out| {
        match way {
            Way::Plain => client.start_upload(now, index, sub, out),
            Way::Blocks => client.start_block_upload(now, index, sub, out),
        }
        .expect("idle");
    });
    assert!(matches!(outcome, SdoOutcome::Uploaded { .. }), "{index:04X}h:{sub}, {way:?}: {outcome:?}");
    client.data().to_vec()
}

pub(crate) fn short_values_are_written_and_read(bus: &mut impl Network) {
    let mut link = bus.link();
    bus.attach(device(NODE));
    let mut client = client(NODE);
    for value in [0u32, 0x1122_3344, u32::MAX] {
        write(&mut link, &mut client, (0x2000, 0), &value.to_le_bytes(), Way::Plain);
        assert_eq!(read(&mut link, &mut client, (0x2000, 0), Way::Plain), value.to_le_bytes());
    }
    assert_eq!(read(&mut link, &mut client, (0x1018, 1), Way::Plain), 0x0102_0304u32.to_le_bytes());
}

pub(crate) fn long_values_pass_in_segments_and_in_blocks(bus: &mut impl Network) {
    let mut link = bus.link();
    bus.attach(device(NODE));
    let mut client = client(NODE);
    assert_eq!(read(&mut link, &mut client, (0x1008, 0), Way::Plain), b"a peer for other stacks");
    for (len, seed) in [(0, 1), (1, 2), (7, 3), (8, 4), (889, 5), (890, 6), (5000, 7)] {
        let data = bytes(len, seed);
        for (there, back) in [(Way::Plain, Way::Blocks), (Way::Blocks, Way::Plain)] {
            write(&mut link, &mut client, (0x2001, 0), &data, there);
            assert_eq!(read(&mut link, &mut client, (0x2001, 0), back), data, "{len} bytes");
        }
    }
}

/// Passes a value both ways in blocks over a line that loses frames; how many.
fn over_a_lossy_line(
    bus: &mut impl Network,
    patience: Duration,
    is_lost: impl FnMut(bool, &Frame) -> bool,
    seed: u64,
) -> usize {
    let mut link = Lossy::new(bus.link(), is_lost);
    let mut client = client(NODE);
    client.set_timeout(2 * patience);
    client.set_retries(8);
    let data = bytes(4000, seed);
    write(&mut link, &mut client, (0x2001, 0), &data, Way::Blocks);
    assert_eq!(read(&mut link, &mut client, (0x2001, 0), Way::Blocks), data);
    link.lost
}

/// How long a device waits that soon notices what is lost.
const ALERT: Duration = Duration::from_millis(100);
/// How long one waits to which a computer that stands still for a while is no loss: where every acknowledgement is lost once, one more that
/// is repeated too early is taken for news, and the transfer is broken off by its length or its checksum.
const PATIENT: Duration = Duration::from_millis(600);

/// A device that notices after half of `patience` what is lost.
fn noticing(patience: Duration) -> Peer {
    let mut peer = device(NODE);
    peer.node.set_sdo_timeout(patience);
    peer
}

pub(crate) fn blocks_pass_when_every_seventh_data_frame_is_lost(bus: &mut impl Network) {
    bus.attach(noticing(ALERT));
    let mut counts = [0u32; 2];
    let every_seventh = |is_own, frame: &Frame| {
        let is_sdo = matches!(frame.id() & 0x780, 0x580 | 0x600);
        // Acknowledgements and confirmations are A0h to BFh; all else on either way carries data or announces it.
        if !is_sdo || frame.data()[0] >> 5 == 5 {
            return false;
        }
        let count = &mut counts[usize::from(is_own)];
        *count += 1;
        count.is_multiple_of(7)
    };
    let lost = over_a_lossy_line(bus, ALERT, every_seventh, 1);
    assert!(lost > 2 * 4000 / 7 / 7, "{lost}");
}

pub(crate) fn blocks_pass_when_5_percent_of_all_frames_are_lost(bus: &mut impl Network) {
    bus.attach(noticing(ALERT));
    let mut acknowledgements = 0;
    for seed in 1..=3u64 {
        let mut state = seed;
        let five_percent = |_, frame: &Frame| {
            // SplitMix64.
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut word = state;
            word = (word ^ (word >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            word = (word ^ (word >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            let is_lost = (word ^ (word >> 31)).is_multiple_of(20);
            acknowledgements += usize::from(is_lost && frame.data()[0] >> 5 == 5);
            is_lost
        };
        let lost = over_a_lossy_line(bus, ALERT, five_percent, seed);
        assert!(lost > 30, "{lost}");
    }
    assert!(acknowledgements > 0, "no seed has lost an acknowledgement");
}

pub(crate) fn blocks_pass_when_the_last_segment_the_end_and_every_acknowledgement_are_lost_once(
    bus: &mut impl Network,
) {
    bus.attach(noticing(PATIENT));
    // 4000 bytes are 572 segments in blocks of 127 and 126 by turns: 66 in the fifth one, the last with 3 of its 7 bytes.
    const LAST: u8 = 0x80 | 66;
    const END: u8 = 0xc1 | 4 << 2;
    for kind in [LAST, END, 0xa1, 0xa2] {
        let mut is_lost_of = [false; 2];
        let once = |is_own, frame: &Frame| {
            frame.data().first() == Some(&kind) && !std::mem::replace(&mut is_lost_of[usize::from(is_own)], true)
        };
        over_a_lossy_line(bus, PATIENT, once, 1);
        assert_eq!(is_lost_of, [true; 2], "{kind:02X}h");
    }
}

pub(crate) fn a_device_refuses_what_it_does_not_have(bus: &mut impl Network) {
    let mut link = bus.link();
    bus.attach(device(NODE));
    let at = Address::new(0x5fff, 0);
    let outcome = transfer(&mut link, &mut client(NODE), |client, now, out| {
        client.start_upload(now, 0x5fff, 0, out).expect("idle");
    });
    assert_eq!(outcome, SdoOutcome::Aborted { at, code: AbortCode::NO_OBJECT, is_by_device: true });
}

fn is_heartbeat(received: &Received, wanted: NmtState) -> bool {
    matches!(received, Received::Frame(frame)
        if nmt::decode_heartbeat(frame) == Some((node_id(NODE).expect("1 to 127"), wanted)))
}

pub(crate) fn a_device_follows_its_master_and_tells_of_its_state(bus: &mut impl Network) {
    let mut link = bus.link();
    bus.attach(device(NODE));
    hear(&mut link, |received| is_heartbeat(received, NmtState::Initialising));
    write(&mut link, &mut client(NODE), (0x1017, 0), &50u16.to_le_bytes(), Way::Plain);
    for (command, state) in [
        (NmtCommand::StartRemoteNode, NmtState::Operational),
        (NmtCommand::StopRemoteNode, NmtState::Stopped),
        (NmtCommand::EnterPreOperational, NmtState::PreOperational),
        (NmtCommand::StartRemoteNode, NmtState::Operational),
        (NmtCommand::ResetNode, NmtState::Initialising),
    ] {
        link.send(&nmt::command(command, node_id(NODE).ok())).expect("sent");
        hear(&mut link, |received| is_heartbeat(received, state));
    }
    // A reset takes the heartbeat with it.
    assert_eq!(read(&mut link, &mut client(NODE), (0x1017, 0), Way::Plain), [0, 0]);
}

pub(crate) fn a_lost_heartbeat_is_an_emergency(bus: &mut impl Network) {
    let mut link = bus.link();
    bus.attach(device(NODE));
    let watched = node_id(127).expect("1 to 127");
    write(&mut link, &mut client(NODE), (0x1016, 1), &(127u32 << 16 | 100).to_le_bytes(), Way::Plain);
    link.send(&nmt::heartbeat(watched, NmtState::Operational)).expect("sent");
    let of = |code: EmcyCode| {
        move |received: &Received| {
            matches!(received, Received::Frame(frame)
                if Emergency::decode(frame).is_some_and(|emergency| emergency.node.raw() == NODE && emergency.code == code))
        }
    };
    hear(&mut link, of(EmcyCode::HEARTBEAT));
    let history = read(&mut link, &mut client(NODE), (0x1003, 1), Way::Plain);
    assert_eq!(history[..2], 0x8130u16.to_le_bytes());
    link.send(&nmt::heartbeat(watched, NmtState::Operational)).expect("sent");
    hear(&mut link, of(EmcyCode::RESET));
}

pub(crate) fn a_device_without_node_id_is_given_one(bus: &mut impl Network) {
    let mut link = bus.link();
    bus.attach(bare());
    // Silence is no answer to any of these, so that the time may be long.
    let mut master = LssMaster::new(Duration::from_secs(2));
    let address = LssAddress { vendor_id: 0x0102_0304, product_code: 0x8000_0001, revision: 1, serial: 0xffff_fffe };
    let id = node_id(9).ok();
    for (request, outcome) in [
        (LssRequest::SwitchOne(address), LssOutcome::Done),
        (LssRequest::InquireIdentity, LssOutcome::Identity(address)),
        (LssRequest::InquireNodeId, LssOutcome::NodeId(None)),
        (LssRequest::ConfigureBitTiming { index: 0xfe }, LssOutcome::Refused { error: 1, detail: 0 }),
        (LssRequest::ConfigureNodeId(id), LssOutcome::Done),
        (LssRequest::Store, LssOutcome::Done),
        (LssRequest::SwitchAll { to_configuration: false }, LssOutcome::Done),
    ] {
        assert_eq!(lss(&mut link, &mut master, request), outcome, "{request:?}");
    }
    hear(
        &mut link,
        |received| matches!(received, Received::Frame(frame) if frame.id() == 0x709 && frame.data() == [0]),
    );
    assert_eq!(read(&mut link, &mut client(9), (0x1008, 0), Way::Plain), b"a peer for other stacks");
}

pub(crate) fn own_frames_come_back_in_order(bus: &mut impl Network) {
    let (mut one, mut other) = (bus.link(), bus.link());
    let frames: Vec<Frame> = (0..40u16).map(|number| Frame::new(0x200 + number % 3, &number.to_le_bytes())).collect();
    let begin = one.now();
    for frame in &frames {
        one.send(frame).expect("sent");
    }
    // A remote frame is one, too, on both sides.
    let asking = Frame::remote(0x701, 1);
    one.send(&asking).expect("sent");
    let mut latest = begin;
    for frame in frames.iter().chain([&asking]) {
        let echo = hear(&mut one, |_| true);
        let heard = hear(&mut other, |_| true);
        assert_eq!((echo.what, heard.what), (Received::Echo(*frame), Received::Frame(*frame)));
        assert!(latest <= echo.time && echo.time <= one.now(), "{latest:?}, {echo:?}");
        latest = echo.time;
    }
    assert_eq!((one.receive(), other.receive()), (None, None));
}

pub(crate) fn nothing_comes_from_a_silent_bus(bus: &mut impl Network) {
    let mut link = bus.link();
    for wait in [30, 130].map(Duration::from_millis) {
        let until = link.now() + wait;
        assert!(!link.wait(until));
        assert!(link.now() >= until && link.receive().is_none());
        // A moment that has passed is no reason to wait.
        assert!(!link.wait(until));
    }
}

pub(crate) fn a_rig_boots_and_exchanges_process_data(bus: &mut impl Network) {
    let Scenario { rig, scene, seed, .. } = Scenario::torque();
    let mut link = bus.link();
    bus.attach(Served(DeviceServer::new(&rig, &scene, seed, Pace::Free).expect("a rig")));
    let mut master = master(&rig, &rig.fixture).expect("a rig");
    let mut out = Vec::new();
    master.start(link.now(), &mut out);
    hil_tests::network::send_all(&mut link, &mut out);
    let phase = run(&mut link, master.networks().next_deadline(), |now, frame, out| {
        match frame {
            Some(frame) => master.networks_mut().on_packet(now, Packet::Can(frame), out),
            None => master.networks_mut().poll(now, out),
        }
        match master.networks().phase() {
            phase @ (Phase::Operational | Phase::Failed(_)) => Ok(phase.clone()),
            _ => Err(master.networks().next_deadline()),
        }
    });
    assert_eq!(phase, Phase::Operational);
    for cycle in 0..50 {
        let until = link.now() + PATIENCE;
        master.networks_mut().open(&mut out);
        assert_eq!(out.iter().map(Frame::id).collect::<Vec<_>>(), [cob::SYNC], "cycle {cycle}");
        hil_tests::network::send_all(&mut link, &mut out);
        while !master.networks().missing(link.now()).is_empty() {
            assert!(link.now() < until, "no process data in cycle {cycle}");
            link.wait(until);
            take(&mut link, &mut master, &mut out);
        }
        master.on_compute(link.now(), Request::None, Timing::default(), &mut out);
        hil_tests::network::send_all(&mut link, &mut out);
        while master.networks().is_in_flight() {
            assert!(link.now() < until, "no echo in cycle {cycle}");
            link.wait(until);
            take(&mut link, &mut master, &mut out);
        }
    }
    let samples = master.last_inputs();
    assert!(samples.sample.is_some(), "{samples:?}");
}

fn take(link: &mut impl CanLink, master: &mut yieldwall::bus::Master, out: &mut Vec<Frame>) {
    while let Some(arrival) = link.receive() {
        match arrival.what {
            Received::Frame(frame) => master.networks_mut().on_packet(arrival.time, Packet::Can(&frame), out),
            Received::Echo(frame) => master.networks_mut().on_echo(&frame),
            other => panic!("{other:?}"),
        }
        hil_tests::network::send_all(link, out);
    }
}
