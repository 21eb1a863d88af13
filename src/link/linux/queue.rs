//! The queue in front of an interface.

use neli::consts::nl::NlmF;
use neli::consts::rtnl::{Ifla, Rtm};
use neli::consts::socket::NlFamily;
use neli::nl::{NlPayload, Nlmsghdr, NlmsghdrBuilder};
use neli::rtnl::{Ifinfomsg, IfinfomsgBuilder};
use neli::socket::synchronous::NlSocketHandle;
use neli::utils::Groups;

use crate::checkup::Check;

/// Fewest frames that the queue should hold: a boot or a cycle puts so many there at once.
const FEWEST: u32 = 10;
/// Most frames that it should hold: 17 ms at 1 Mbit/s. Whatever is in it leaves, however old it has become.
const MOST: u32 = 128;

/// Returns the name of the queueing discipline of an interface, asked over netlink; `None` if the kernel does not report it.
pub(super) fn discipline(index: u32) -> Option<String> {
    let socket = NlSocketHandle::connect(NlFamily::Route, None, Groups::empty()).ok()?;
    let about = IfinfomsgBuilder::default()
        .ifi_family(neli::consts::rtnl::RtAddrFamily::Unspecified)
        .ifi_index(i32::try_from(index).ok()?)
        .build()
        .ok()?;
    let request = NlmsghdrBuilder::default()
        .nl_type(Rtm::Getlink)
        .nl_flags(NlmF::REQUEST)
        .nl_payload(NlPayload::Payload(about))
        .build()
        .ok()?;
    socket.send(&request).ok()?;
    let answer: Nlmsghdr<Rtm, Ifinfomsg> = socket.recv().ok()?.0.next()?.ok()?;
    let attributes = answer.get_payload()?.rtattrs();
    let name = attributes.iter().find(|attribute| *attribute.rta_type() == Ifla::Qdisc)?;
    let bytes: &[u8] = name.rta_payload().as_ref();
    let text = bytes.split(|byte| *byte == 0).next()?;
    Some(String::from_utf8_lossy(text).into_owned())
}

/// Returns the state of a queue.
pub(super) fn checks(name: &str, is_virtual: bool, discipline: Option<&str>, len: Option<u32>) -> Vec<Check> {
    let kind = "queueing";
    let replaced = |check: Check| check.fix(format!("sudo tc qdisc replace dev {name} root pfifo_fast"));
    let discipline = match discipline {
        None => Check::unknown(kind, "the kernel does not report the queueing discipline"),
        Some(known @ ("pfifo_fast" | "prio" | "mq")) => Check::ok(kind, known),
        // Frames do not wait at all there.
        Some("noqueue") if is_virtual => return vec![Check::ok(kind, "noqueue, as of every virtual interface")],
        Some("noqueue") => replaced(
            Check::warning(kind, format!("`{name}` has no queue (noqueue)"))
                .follows("a frame is refused while the controller is busy with the one before"),
        ),
        Some(other) => replaced(
            Check::warning(kind, format!("the queue of `{name}` is {other}"))
                .follows("it may delay, drop or reorder frames, or have set-points wait behind services"),
        ),
    };
    let held = |len: u32| format!("the queue of `{name}` holds {len} frames");
    let set = |check: Check, len: u32| check.fix(format!("sudo ip link set {name} txqueuelen {len}"));
    let len = match len {
        None => Check::unknown("queue", "the kernel does not report how many frames the queue holds"),
        Some(len) if len < FEWEST => {
            set(Check::warning("queue", held(len)).follows("that is fewer than a cycle may bring"), FEWEST)
        }
        Some(len) if len > MOST => set(
            Check::warning("queue", held(len))
                .follows("what waits there while nobody acknowledges is sent when it is old"),
            MOST,
        ),
        Some(len) => Check::ok("queue", format!("{len} frames")),
    };
    vec![discipline, len]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checkup::Verdict;

    fn advice(name: &str, is_virtual: bool, discipline: Option<&str>, len: Option<u32>) -> Vec<String> {
        let all = checks(name, is_virtual, discipline, len);
        all.iter().filter(|check| check.verdict == Verdict::Warning).map(ToString::to_string).collect()
    }

    #[test]
    fn the_queue_of_the_kernel_for_can_needs_nothing() {
        for len in [10, 128] {
            assert_eq!(advice("can0", false, Some("pfifo_fast"), Some(len)), [""; 0]);
        }
        assert_eq!(advice("vcan0", true, Some("noqueue"), Some(0)), [""; 0]);
        // What nobody tells is no reason to change anything, and not fine.
        assert_eq!(advice("can0", false, None, None), [""; 0]);
        let verdicts = checks("can0", false, None, None).iter().map(|check| check.verdict).collect::<Vec<_>>();
        assert_eq!(verdicts, [Verdict::Unknown; 2]);
    }

    #[test]
    fn each_wrong_value_has_the_command_that_mends_it() {
        let mended = |is_virtual, discipline, len| advice("can0", is_virtual, Some(discipline), Some(len)).join("\n");
        for (discipline, is_virtual) in [("fq_codel", false), ("noqueue", false), ("pfifo", true)] {
            let said = mended(is_virtual, discipline, 10);
            assert!(said.contains(discipline), "{said}");
            assert!(said.ends_with("set `sudo tc qdisc replace dev can0 root pfifo_fast`"), "{said}");
        }
        assert!(mended(false, "pfifo_fast", 9).ends_with("set `sudo ip link set can0 txqueuelen 10`"));
        assert!(mended(false, "pfifo_fast", 129).ends_with("set `sudo ip link set can0 txqueuelen 128`"));
        assert_eq!(mended(false, "fq_codel", 1000).lines().count(), 2);
    }
}
