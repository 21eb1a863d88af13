//! Single frames, and the heartbeats that they make up.

use std::collections::BTreeMap;
use std::time::Duration;

use yieldwall::canopen::nmt::{self, MAX_WATCHED};
use yieldwall::canopen::{Emergency, Frame, HeartbeatChange, HeartbeatConsumer, NmtState, cob, node_id};
use yieldwall::time::Time;

use super::bytes::{Bytes, Script};

/// Decoding a frame and encoding what came out gives the frame again, and no frame is two things.
///
/// # Panics
/// If a law is broken.
pub fn frames(bytes: &[u8]) {
    let mut bytes = Bytes::new(bytes);
    while !bytes.is_empty() {
        let frame = bytes.frame(&[0x000, 0x080, 0x081, 0x0ff, 0x701, 0x77f]);
        let mut meanings = 0;
        if let Some((command, node)) = nmt::decode_command(&frame) {
            assert_eq!(nmt::command(command, node), frame);
            meanings += 1;
        }
        if let Some((node, state)) = nmt::decode_heartbeat(&frame) {
            // Bit 7 is the toggle bit of node guarding: it may be there, and says nothing.
            assert_eq!(nmt::heartbeat(node, state), Frame::new(frame.id(), &[frame.data()[0] & 0x7f]));
            meanings += 1;
        }
        if let Some(emergency) = Emergency::decode(&frame) {
            assert_eq!(emergency.frame(), frame);
            let text = emergency.to_string();
            assert!(!text.chars().any(char::is_control) && text.contains(emergency.code.meaning()), "{text}");
            meanings += 1;
        }
        assert!(meanings <= 1, "{frame:x?}");
        assert!(frame.id() <= 0x7ff && frame.data().len() == usize::from(frame.len()));
        assert_eq!(Frame::from_bits(frame.id(), frame.bits(), frame.len()), frame);
    }
}

pub(super) fn messages() -> Vec<Vec<u8>> {
    let all = [
        (0x000, &[1, 0][..]),
        (0x000, &[0x81, 5]),
        (0x705, &[5]),
        (0x701, &[0]),
        (0x081, &[0x10, 0x82, 0x11, 1, 0, 0, 0, 0]),
    ];
    vec![all.iter().fold(Script::new(), |script, (id, data)| script.frame(*id, data)).finish()]
}

/// What a watched node is thought to do.
#[derive(Clone, Copy)]
struct Watched {
    timeout: Duration,
    /// When it is lost, while it is heard.
    deadline: Option<Time>,
    state: Option<NmtState>,
}

/// The heartbeat consumer against a model: a node is lost when its time is up, once, and not before.
///
/// # Panics
/// If a law is broken.
pub fn heartbeat(bytes: &[u8]) {
    let mut bytes = Bytes::new(bytes);
    let mut consumer = HeartbeatConsumer::new();
    let mut model: BTreeMap<u8, Watched> = BTreeMap::new();
    let mut now = Time::default();
    while !bytes.is_empty() {
        match bytes.u8() % 8 {
            0 => {
                let (raw, timeout) = (bytes.u8(), bytes.wait());
                let Ok(node) = node_id(raw) else { continue };
                let has_room = model.contains_key(&raw) || model.len() < MAX_WATCHED;
                assert_eq!(consumer.watch(node, timeout), has_room && !timeout.is_zero());
                if has_room && !timeout.is_zero() {
                    model.insert(raw, Watched { timeout, deadline: None, state: None });
                }
            }
            1 => {
                let raw = bytes.u8();
                let Ok(node) = node_id(raw) else { continue };
                consumer.start(now, node);
                if let Some(watched) = model.get_mut(&raw) {
                    watched.deadline = Some(now + watched.timeout);
                }
            }
            2..6 => {
                let frame = bytes.frame(&[0x701, 0x702, 0x703]);
                let event = consumer.on_frame(now, &frame).map(|event| (event.node.raw(), event.change));
                assert_eq!(event, hear(&mut model, now, &frame));
            }
            _ => {
                now = now + bytes.wait();
                for _ in 0..=MAX_WATCHED {
                    let Some(event) = consumer.poll(now) else { break };
                    assert_eq!(event.change, HeartbeatChange::Lost);
                    let watched = model.get_mut(&event.node.raw()).expect("a watched node");
                    assert!(
                        watched.deadline.is_some_and(|deadline| deadline <= now),
                        "node {} lost too soon",
                        event.node.raw()
                    );
                    (watched.deadline, watched.state) = (None, None);
                }
                assert!(model.values().all(|watched| watched.deadline.is_none_or(|deadline| deadline > now)));
                assert!(consumer.next_deadline() > now);
            }
        }
        let earliest = model.values().filter_map(|watched| watched.deadline).min();
        assert!(consumer.next_deadline() <= earliest.unwrap_or(Time::NEVER), "a deadline is forgotten");
        for (&raw, watched) in &model {
            assert_eq!(consumer.state(node_id(raw).expect("it was one")), watched.state);
        }
    }
}

/// What a frame tells about a watched node.
fn hear(model: &mut BTreeMap<u8, Watched>, now: Time, frame: &Frame) -> Option<(u8, HeartbeatChange)> {
    let (node, state) = nmt::decode_heartbeat(frame)?;
    let watched = model.get_mut(&node.raw())?;
    let before = watched.state;
    let change = if state == NmtState::Initialising {
        (watched.deadline, watched.state) = (None, None);
        HeartbeatChange::BootUp
    } else {
        (watched.deadline, watched.state) = (Some(now + watched.timeout), Some(state));
        match before {
            None => HeartbeatChange::Present(state),
            Some(before) if before == state => return None,
            Some(_) => HeartbeatChange::State(state),
        }
    };
    Some((node.raw(), change))
}

pub(super) fn heartbeats() -> Vec<Vec<u8>> {
    let node = node_id(1).expect("a node id");
    let mut script = Script::new().raw(&[0, 1]).wait_us(50_000).raw(&[0, 2]).wait_us(20_000).raw(&[1, 2]);
    for data in [0x00, 0x7f, 0x05, 0x05, 0x04] {
        script = script.raw(&[2]).frame(cob::heartbeat(node), &[data]).raw(&[7]).wait_us(20_000);
    }
    vec![script.raw(&[7]).wait_us(50_000).finish()]
}
