//! Diagnosis from the facts of one node: a chain of questions that ends at the first trouble.

use super::{NodeFacts, Probe};
use yieldwall_fieldbus::canopen::{NmtState, NodeSet, cob};
use yieldwall_link::SendError;
use yieldwall_link::checkup::Check;

/// So many requests of the pattern are answered twice where two devices answer; CAN itself doubles a frame now and then.
const DOUBLED: usize = 3;
/// So many frames that were destroyed on the wire in 2 s are no accident.
const MANY_ERRORS: u32 = 3;
/// So many boot-up messages in 2 s are of a device that does not stay up.
const MANY_BOOT_UPS: u32 = 2;

/// An interface in the commands for a simulation, which has none.
const EXAMPLE: &str = "can0";

/// Facts besides the node itself.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Around {
    /// The node as a person calls it, such as `node 1 (left)`.
    pub name: String,
    /// Arguments that bring commands to the same bus, with a space before: ` --bus can0`; empty for a simulation.
    pub arguments: String,
    /// Name of the interface; `None` for a simulation.
    pub interface: Option<String>,
    /// Bit rate in bit/s that the bus has or should have, where one is known; `None` for a virtual interface.
    pub bit_rate: Option<u32>,
    /// The node ids of the rig on this bus; empty without a rig.
    pub rig: NodeSet,
}

/// How a node is. The last check is the one that ends the search: the trouble, or that the node answers.
pub fn judge(facts: &NodeFacts, around: &Around) -> Vec<Check> {
    let mut checks = Vec::new();
    let questions: [fn(&NodeFacts, &Around) -> Check; 6] = [link, heard, alive, identifiers, doubled, answers];
    for question in questions {
        let check = question(facts, around);
        let is_trouble = check.verdict == yieldwall_link::checkup::Verdict::Wrong;
        checks.push(check);
        if is_trouble {
            break;
        }
    }
    checks
}

/// Whether frames come onto the bus and from it.
fn link(facts: &NodeFacts, around: &Around) -> Check {
    let interface = around.interface.as_deref();
    let name = interface.map_or("the simulated interface".to_owned(), |interface| format!("`{interface}`"));
    if facts.link.is_bus_off {
        let check = Check::wrong("bus-off", format!("the controller of {name} went bus-off: it saw too many errors"));
        let first = "look at the cable, at its terminators and at the bit rate of every node first";
        return with_command(check, around, first, |interface| {
            format!("sudo ip link set {interface} type can restart")
        });
    }
    if let Some(error @ (SendError::Down | SendError::Gone)) = facts.link.refused {
        let check = Check::wrong("interface", format!("{name}: {error}"));
        return match error {
            SendError::Down => with_command(check, around, "", |interface| format!("sudo ip link set {interface} up")),
            _ => check,
        };
    }
    if facts.link.is_unheard || facts.link.refused.is_some() {
        let found = format!("nobody acknowledges what {name} sends");
        return with_bit_rates(
            Check::wrong("acknowledge", found),
            around,
            "no device is switched on, the cable is out, a terminator is missing, or all devices have another bit rate.",
        );
    }
    if facts.link.bus_errors >= MANY_ERRORS {
        let found = format!("{} frames were destroyed on the wire of {name}", facts.link.bus_errors);
        return with_bit_rates(
            Check::wrong("bit rate", found),
            around,
            "somebody has another bit rate than this interface, or the cable is bad.",
        );
    }
    Check::ok("interface", format!("frames come and go on {name}"))
}

/// Whether anybody is heard.
fn heard(facts: &NodeFacts, around: &Around) -> Check {
    let other = facts.link.others;
    let is_silent = facts.own_frames == 0 && facts.others.is_empty() && facts.frames == 0;
    if is_silent && !other.is_none() {
        return Check::wrong("silence", format!("no frame of CANopen was heard, and nobody answers; {other} came"))
            .follows(
                "the bit rate is right, and something else than CANopen uses this bus: no CANopen device is switched on, or this is \
                 the cable of another bus. This shows the frames",
            )
            .fix(format!("yieldwall monitor{}", around.arguments));
    }
    if is_silent {
        let check = Check::wrong("silence", "no frame of anybody was heard, and nobody answers");
        return match (&around.interface, around.bit_rate) {
            (Some(_), Some(_)) => with_bit_rates(
                check,
                around,
                "no device is switched on, the cable is out, or all devices have another bit rate.",
            ),
            (Some(interface), None) => check
                .follows("a virtual interface has simulated devices alone, and none of them runs")
                .fix(format!("yieldwall sim RIG.yaml --bus {interface}")),
            (None, _) => check,
        };
    }
    let from = match (facts.others.is_empty(), wrong_identifier(facts)) {
        (true, _) => String::new(),
        // Who sends under an identifier that was delivered wrongly is not known.
        (false, Some(_)) => format!("; more came under identifiers of {}", nodes(facts.others)),
        (false, None) => {
            format!("; {} {} there beside it", nodes(facts.others), if facts.others.len() == 1 { "is" } else { "are" })
        }
    };
    let other = if other.is_none() { String::new() } else { format!("; {other}, which are none of CANopen, came too") };
    Check::ok("heard", format!("{} frames before anything was asked{from}{other}", facts.frames))
}

/// Whether the node itself is there, and in a state in which it answers.
fn alive(facts: &NodeFacts, around: &Around) -> Check {
    let (name, arguments, raw) = (&around.name, &around.arguments, facts.node.raw());
    let (answered, asked) = (cob::sdo_response(facts.node), cob::sdo_request(facts.node));
    let is_answering = facts.is_answering();
    let state = facts.state.map_or(" and reports no state", state_words);
    if facts.state == Some(NmtState::Stopped) {
        return Check::wrong("stopped", format!("{name} is in Stopped"))
            .follows("there it answers no SDO; it is there, and the bus is good")
            .fix(format!("yieldwall nmt {raw} preop{arguments}"));
    }
    // Of two devices that were switched on together both have said so.
    if facts.boot_ups >= MANY_BOOT_UPS && !is_answering {
        return Check::wrong("restarts", format!("{name} has started {} times in about 2 s", facts.boot_ups)).follows(
            "its supply breaks down, its watchdog restarts it, or two devices have its node id: look at the supply first",
        );
    }
    if facts.own_frames == 0 && !is_answering && !has_misplaced(facts) {
        return silent(facts, around);
    }
    if facts.asked.is_empty() {
        return Check::ok("node", format!("{name} is heard{state}; nothing was asked"));
    }
    if is_answering || has_misplaced(facts) {
        return Check::ok("node", format!("{name} is there{state}"));
    }
    if facts.unasked > 0 {
        return Check::wrong("COB-ID", format!("{answered:03X}h came {} times unasked", facts.unasked))
            .follows(format!(
                "that is where {name} should answer: somebody uses it for something else. This shows who sends what"
            ))
            .fix(format!("yieldwall monitor --services{arguments}"));
    }
    if facts.foreign_requests > 0 {
        return Check::wrong(
            "COB-ID",
            format!("somebody else sent {} frames under {asked:03X}h", facts.foreign_requests),
        )
        .follows(format!("{name} is asked there: another client, or a device that uses it for process data"))
        .fix(format!("yieldwall monitor --services{arguments}"));
    }
    match facts.state {
        Some(_) => Check::wrong("SDO", format!("{name} is there{state}, and answers no SDO"))
            .follows(format!(
                "its SDO server listens under another identifier than {asked:03X}h (1200h), or hangs: resetting its \
                 communication brings the default back"
            ))
            .fix(format!("yieldwall nmt {raw} reset-comm{arguments}")),
        None => Check::wrong("stopped", format!("{name} is heard, and reports neither its state nor an object"))
            .follows("in Stopped a node answers no SDO")
            .fix(format!("yieldwall nmt {raw} preop{arguments}")),
    }
}

/// A node that nothing was heard of.
fn silent(facts: &NodeFacts, around: &Around) -> Check {
    let (arguments, raw) = (&around.arguments, facts.node.raw());
    let heard = facts.others.without(facts.answered);
    let others = match (facts.answered.is_empty(), heard.is_empty()) {
        (true, true) => "and so is everybody else".to_owned(),
        (false, true) => format!("{} answered", facts.answered),
        (true, false) => format!("{heard} {} heard", verb(heard)),
        (false, false) => format!("{} answered, and {heard} {} heard", facts.answered, verb(heard)),
    };
    let check = Check::wrong("silent", format!("{} is silent; {others}", around.name));
    let strangers = facts.others.without(around.rig);
    match strangers.iter().next().filter(|_| !around.rig.is_empty()) {
        Some(stranger) => check
            .follows(format!(
                "{} {} none of the rig's: if that is the device that is meant, give it its node id by this and by a reset",
                nodes(strangers),
                if strangers.len() == 1 { "is" } else { "are" },
            ))
            .fix(format!("yieldwall lss set-id {} {raw}{arguments}", stranger.raw())),
        None => check
            .follows(
                "the bus is good, so look at this device: its supply, its plug, its node id, its bit rate. A device without a \
                 node id answers this",
            )
            .fix(format!("yieldwall lss find{arguments}")),
    }
}

/// Whether identifiers come as they were sent.
fn identifiers(facts: &NodeFacts, around: &Around) -> Check {
    let own = cob::sdo_response(facts.node);
    let found = match (wrong_identifier(facts), facts.link.altered) {
        (Some(id), _) => format!("answers came under {id:03X}h in place of {own:03X}h (bits {:03X}h)", id ^ own),
        (None, Some(id)) => format!("an own frame came back under {id:03X}h, under which none was sent"),
        (None, None) if facts.asked.is_empty() => {
            return Check::unknown(
                "identifiers",
                "nothing was asked that would show whether they are delivered as sent",
            );
        }
        (None, None) => {
            let count = facts.asked.iter().map(|asked| asked.answers.len()).sum::<usize>();
            return Check::ok("identifiers", format!("{count} answers came under {own:03X}h, as they should"));
        }
    };
    let follows = "the adapter delivers wrong identifiers, or the device answers under another one (1200h): try another adapter. The \
                   command shows its driver and firmware: look for newer ones";
    with_command(Check::wrong("identifiers", found), around, follows, |interface| format!("ethtool -i {interface}"))
}

/// The identifier of an answer that should have come under another one.
fn wrong_identifier(facts: &NodeFacts) -> Option<u16> {
    let own = cob::sdo_response(facts.node);
    facts.asked.iter().flat_map(|asked| &asked.answers).map(|(id, _)| *id).find(|id| *id != own)
}

/// Whether one device has the node id.
fn doubled(facts: &NodeFacts, around: &Around) -> Check {
    let doubled = facts.asked.iter().filter(|asked| asked.answers.len() > 1).count();
    let differing = facts.asked.iter().find(|asked| differs(asked));
    if doubled < DOUBLED && differing.is_none() {
        return match facts.asked.is_empty() {
            true => Check::unknown("node id", "nothing was asked that would show whether two devices have it"),
            false => Check::ok("node id", format!("one device answers as {}", around.name)),
        };
    }
    let by = differing.map_or(String::new(), |asked| format!(", and {} is not the same in both", asked.at));
    let taken = |raw: &u8| {
        let is_free = |node| node != facts.node && !facts.others.contains(node) && !around.rig.contains(node);
        cob::node_id(*raw).is_ok_and(is_free)
    };
    let free = (1..=126).rev().find(taken).unwrap_or(126);
    Check::wrong("node id", format!("two devices answer as {}{by}", around.name))
        .follows(
            "switch one of them off and give the other another node id, until its next reset or for good with --save",
        )
        .fix(format!("yieldwall lss set-id {} {free}{}", facts.node.raw(), around.arguments))
}

/// Whether the node answers all that it was asked.
fn answers(facts: &NodeFacts, around: &Around) -> Check {
    let (asked, unanswered) = (facts.asked.len(), facts.asked.iter().filter(|asked| asked.answers.is_empty()).count());
    if asked == 0 {
        return Check::unknown("SDO", "nothing was asked");
    }
    if unanswered == 0 {
        return Check::ok("SDO", format!("{asked} of {asked} objects answered"));
    }
    Check::warning("SDO", format!("{} of {asked} objects answered by {}", asked - unanswered, around.name))
        .follows("frames are lost on the way, or its SDO server is slower than 0.4 s: `waits` of its entry in the rig")
}

/// Whether two different values came for one object.
fn differs(asked: &Probe) -> bool {
    let mut answers = asked.answers.iter();
    let first = answers.next();
    answers.any(|answer| first.is_some_and(|first| first != answer))
}

/// Whether answers for what was asked came under another identifier.
fn has_misplaced(facts: &NodeFacts) -> bool {
    facts.asked.iter().any(|asked| !asked.answers.is_empty())
}

/// With what follows, and the command for the interface; for a simulation the one that it would be on a bus.
fn with_command(check: Check, around: &Around, follows: &str, command: impl Fn(&str) -> String) -> Check {
    match &around.interface {
        Some(interface) => check.follows(follows).fix(command(interface)),
        None => {
            let stop = if follows.is_empty() { "" } else { ". " };
            check.follows(format!("{follows}{stop}On a bus with the interface {EXAMPLE} it is")).fix(command(EXAMPLE))
        }
    }
}

/// With what follows and the command that listens at the usual bit rates, where there is a controller that has one.
fn with_bit_rates(check: Check, around: &Around, follows: &str) -> Check {
    let Some(bit_rate) = around.bit_rate else { return check.follows(follows.trim_end_matches('.')) };
    let follows = format!(
        "{follows} The command listens for 3 s at each of the usual bit rates and sends nothing. It puts {bit_rate} bit/s back, also \
         after Ctrl-C. Switch the device off and on again while it runs"
    );
    with_command(check, around, &follows, |interface| listen_at_bit_rates(interface, bit_rate))
}

/// Returns a command that listens for 3 s at each of the bit rates of CiA 301. It sends nothing, not even an acknowledgement. A
/// trap of its shell restores the present rate at the end. If the controller lacks a rate, `ip` reports it, and the command goes
/// on.
fn listen_at_bit_rates(interface: &str, present: u32) -> String {
    let down = format!("sudo ip link set {interface} down");
    let up = format!("sudo ip link set {interface} up type can bitrate");
    format!(
        "( trap '{down}; {up} {present} listen-only off' EXIT; trap 'exit 130' INT; for rate in 1000000 800000 500000 250000 \
         125000 50000 20000 10000; do {down}; echo $rate bit/s:; {up} $rate listen-only on && timeout --foreground 3 candump -n 5 \
         {interface}; done; )"
    )
}

fn nodes(set: NodeSet) -> String {
    format!("{} {set}", if set.len() == 1 { "node" } else { "nodes" })
}

fn verb(set: NodeSet) -> &'static str {
    if set.len() == 1 { "was" } else { "were" }
}

fn state_words(state: NmtState) -> &'static str {
    match state {
        NmtState::Initialising => ", starting",
        NmtState::PreOperational => ", in Pre-operational",
        NmtState::Operational => ", in Operational",
        NmtState::Stopped => ", in Stopped",
    }
}
