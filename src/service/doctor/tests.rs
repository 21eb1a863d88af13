//! Troubles planted into facts, and into the frames from which facts are made.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::*;
use yieldwall_fieldbus::canopen::BusId;
use yieldwall_link::checkup::{Check, Verdict};
use yieldwall_rig::live::{PlantedLink, Trouble, VirtualLink};

fn node(raw: u8) -> NodeId {
    cob::node_id(raw).unwrap()
}

fn around(raw: u8) -> Around {
    Around {
        name: format!("node {raw}"),
        arguments: " --bus can0".to_owned(),
        interface: Some("can0".to_owned()),
        bit_rate: Some(500_000),
        rig: [1, 2, 10].map(node).into_iter().collect(),
    }
}

fn last(facts: &NodeFacts) -> Check {
    judge(facts, &around(facts.node.raw())).pop().unwrap()
}

/// A connection to the simulation, with a trouble.
fn service(trouble: Option<(u8, Trouble)>) -> Service<Box<dyn CanLink>> {
    let rig = yieldwall_config::load_rig(yieldwall_config::builtin("paper-admittance.yaml")).unwrap();
    let scene = rig.scene().unwrap().value;
    let link = VirtualLink::new(&rig.value, &scene, 1).unwrap();
    let link: Box<dyn CanLink> = match trouble {
        Some((raw, trouble)) => Box::new(PlantedLink::new(link, node(raw), trouble)),
        None => Box::new(link),
    };
    Service::new(link, BusId::FIRST, Arc::new(AtomicBool::new(false)))
}

/// The findings of `doctor node` for a simulated node with a trouble.
fn examined(raw: u8, trouble: Option<(u8, Trouble)>, is_silent: bool) -> NodeFacts {
    examine(&mut service(trouble), node(raw), is_silent).unwrap()
}

#[test]
fn a_scan_counts_frames_that_are_none_of_canopen() {
    let mut alone = service(None);
    assert_eq!(crate::scan(&mut alone).unwrap().len(), 3);
    assert!(alone.others().is_none());
    let mut shared = service(Some((1, Trouble::OtherTraffic)));
    assert_eq!(crate::scan(&mut shared).unwrap(), []);
    assert!(shared.others().extended > 2, "{}", shared.others());
}

#[test]
fn each_trouble_in_the_frames_is_found_by_name_with_the_command_that_mends_it() {
    for (raw, trouble, subject, found, fix) in [
        (1, Trouble::Silent, "silent", "node 1 is silent; 2 and 10 answered", "yieldwall lss find --bus can0"),
        (
            1,
            Trouble::OtherNodeId(node(5)),
            "silent",
            "node 1 is silent; 2, 5 and 10 answered",
            "yieldwall lss set-id 5 1 --bus can0",
        ),
        (2, Trouble::Stopped, "stopped", "node 2 is in Stopped", "yieldwall nmt 2 preop --bus can0"),
        (
            1,
            Trouble::Double,
            "node id",
            "two devices answer as node 1, and 1018h:4 is not the same in both",
            "yieldwall lss set-id 1 126 --bus can0",
        ),
        (
            10,
            Trouble::OtherIdentifiers,
            "identifiers",
            "answers came under 58Eh in place of 58Ah (bits 004h)",
            "ethtool -i can0",
        ),
        (
            1,
            Trouble::BusOff,
            "bus-off",
            "the controller of `can0` went bus-off: it saw too many errors",
            "sudo ip link set can0 type can restart",
        ),
    ] {
        let check = last(&examined(raw, Some((raw, trouble)), false));
        assert_eq!((check.subject, check.found.as_str(), check.fix.as_deref()), (subject, found, Some(fix)));
        assert_eq!(check.verdict, Verdict::Wrong, "{trouble:?}");
    }
    let facts = examined(1, Some((1, Trouble::OtherTraffic)), false);
    let check = last(&facts);
    assert!(facts.link.others.extended > 2 && facts.link.others.fd == 0, "{facts:#?}");
    assert_eq!((check.subject, check.verdict), ("silence", Verdict::Wrong));
    assert!(check.found.contains("frames with 29-bit identifiers came"), "{}", check.found);
    assert!(check.follows.starts_with("the bit rate is right"), "{}", check.follows);
    assert_eq!(check.fix.as_deref(), Some("yieldwall monitor --bus can0"));
    let facts = examined(1, Some((1, Trouble::OtherBitRate)), false);
    let check = last(&facts);
    assert_eq!((check.subject, check.verdict), ("bit rate", Verdict::Wrong), "{facts:#?}");
    assert!(check.fix.unwrap().contains("type can bitrate $rate listen-only on"));
}

#[test]
fn a_good_node_passes_every_question() {
    for raw in [1, 2, 10] {
        let facts = examined(raw, None, false);
        let checks = judge(&facts, &around(raw));
        assert!(checks.iter().all(|check| check.verdict == Verdict::Ok), "{checks:#?}");
        assert_eq!(checks.len(), 6);
        assert_eq!(facts.asked.len(), PATTERN.len());
    }
}

#[test]
fn who_only_listens_sends_nothing_and_says_what_it_does_not_know() {
    let facts = examined(1, None, true);
    assert!(facts.sent.is_empty() && facts.asked.is_empty());
    let checks = judge(&facts, &around(1));
    let unknown = checks.iter().filter(|check| check.verdict == Verdict::Unknown).count();
    assert!(checks.iter().all(|check| check.verdict < Verdict::Warning) && unknown == 3, "{checks:#?}");
}

#[test]
fn other_traffic_beside_a_good_node_is_named() {
    let others = OtherTraffic { extended: 200, fd: 1 };
    let facts = NodeFacts { link: LinkFacts { others, ..LinkFacts::default() }, ..good(1) };
    let checks = judge(&facts, &around(1));
    assert!(checks.iter().all(|check| check.verdict == Verdict::Ok), "{checks:#?}");
    assert!(
        checks.iter().any(|check| check.found.contains("200 frames with 29-bit identifiers and 1 frame of CAN FD"))
    );
}

/// Facts of a node that answers all of the pattern.
fn good(raw: u8) -> NodeFacts {
    let id = cob::sdo_response(node(raw));
    let asked = PATTERN.map(|(index, sub)| {
        let [low, high] = index.to_le_bytes();
        Probe { at: Address::new(index, sub), answers: vec![(id, [0x43, low, high, sub, 1, 0, 0, 0])] }
    });
    NodeFacts {
        frames: 100,
        own_frames: 20,
        state: Some(NmtState::PreOperational),
        asked: asked.to_vec(),
        ..NodeFacts::new(node(raw), BusId::FIRST)
    }
}

fn unanswered(raw: u8) -> NodeFacts {
    let asked = |(index, sub)| Probe { at: Address::new(index, sub), answers: Vec::new() };
    NodeFacts { asked: PATTERN.into_iter().take(2).map(asked).collect(), ..good(raw) }
}

#[test]
fn what_no_simulation_has_is_planted_into_facts() {
    assert_eq!(last(&good(5)).verdict, Verdict::Ok);
    let link = |link| NodeFacts { link, ..unanswered(5) };
    let restored =
        "trap 'sudo ip link set can0 down; sudo ip link set can0 up type can bitrate 500000 listen-only off' EXIT";
    for (facts, subject) in [
        (link(LinkFacts { bus_errors: 3, ..LinkFacts::default() }), "bit rate"),
        (link(LinkFacts { is_unheard: true, ..LinkFacts::default() }), "acknowledge"),
        (link(LinkFacts { refused: Some(SendError::Full), ..LinkFacts::default() }), "acknowledge"),
        (NodeFacts { frames: 0, own_frames: 0, state: None, ..unanswered(5) }, "silence"),
    ] {
        let check = last(&facts);
        assert_eq!(check.subject, subject);
        let command = check.fix.unwrap();
        assert!(command.contains("; for rate in ") && command.contains(restored), "{subject}: {command}");
        // On a simulation it is the command for a bus.
        let rehearsed = judge(&facts, &Around { interface: None, ..around(5) }).pop().unwrap();
        let is_silence = subject == "silence";
        assert_eq!(rehearsed.fix.as_deref(), (!is_silence).then_some(command.as_str()), "{subject}");
        assert!(is_silence || rehearsed.follows.contains("On a bus"), "{}", rehearsed.follows);
    }
    for (facts, subject, fix) in [
        (
            link(LinkFacts { refused: Some(SendError::Down), ..LinkFacts::default() }),
            "interface",
            "sudo ip link set can0 up",
        ),
        (NodeFacts { unasked: 7, ..unanswered(5) }, "COB-ID", "yieldwall monitor --services --bus can0"),
        (NodeFacts { foreign_requests: 7, ..unanswered(5) }, "COB-ID", "yieldwall monitor --services --bus can0"),
        (unanswered(5), "SDO", "yieldwall nmt 5 reset-comm --bus can0"),
        (NodeFacts { state: None, ..unanswered(5) }, "stopped", "yieldwall nmt 5 preop --bus can0"),
    ] {
        let check = last(&facts);
        assert_eq!((check.subject, check.fix.as_deref()), (subject, Some(fix)));
    }
    assert_eq!(last(&NodeFacts { boot_ups: 3, ..unanswered(5) }).subject, "restarts");
    let altered = LinkFacts { altered: Some(0x609), ..LinkFacts::default() };
    assert_eq!(last(&NodeFacts { link: altered, ..good(5) }).subject, "identifiers");
}

/// Who is there is not told from identifiers that were delivered wrongly.
#[test]
fn wrong_identifiers_are_not_taken_for_nodes_that_are_there() {
    let facts = examined(1, Some((1, Trouble::OtherIdentifiers)), false);
    let checks = judge(&facts, &around(1));
    let found: Vec<&str> = checks.iter().map(|check| check.found.as_str()).collect();
    assert!(found.iter().any(|found| found.ends_with("more came under identifiers of nodes 5, 6 and 14")), "{found:?}");
    assert!(found.contains(&"node 1 is there and reports no state"), "{found:?}");
    assert!(!found.iter().any(|found| found.contains("there beside it")), "{found:?}");
}

#[test]
fn a_frame_that_can_doubled_by_itself_is_no_second_device() {
    let mut facts = good(5);
    for at in [0, 3] {
        let answer = facts.asked[at].answers[0];
        facts.asked[at].answers.push(answer);
    }
    assert_eq!(last(&facts).subject, "SDO");
    let answer = facts.asked[7].answers[0];
    facts.asked[7].answers.push(answer);
    assert_eq!(last(&facts).subject, "node id");
    let mut facts = good(5);
    let (id, mut bytes) = facts.asked[6].answers[0];
    bytes[4] = 2;
    facts.asked[6].answers.push((id, bytes));
    assert_eq!(last(&facts).found, "two devices answer as node 5, and 1018h:4 is not the same in both");
}
