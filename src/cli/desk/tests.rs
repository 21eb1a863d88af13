//! Cases that no command line can produce on a simulation that has just begun.

use std::time::Duration;

use super::place::{BusArguments, DeviceSession};
use super::reached::DeviceHandle;
use super::state::{disable_voltage, refuse_powered, reset_fault, statusword};
use crate::failure::Exit;
use crate::output::Output;
use yieldwall_fieldbus::canopen::{NmtCommand, NmtState, nmt, node_id};
use yieldwall_fieldbus::objects::Address;
use yieldwall_run::explanation::{self, Explanation};

fn desk() -> (DeviceSession, Output) {
    let mut output = Output::new(true, false, false);
    (DeviceSession::open(&BusArguments::default(), &mut output).unwrap(), output)
}

#[test]
fn a_drive_in_fault_is_taken_out_of_it_and_stays_without_torque() {
    let (mut desk, mut output) = desk();
    let node = desk.node("left").unwrap();
    let mut write = |index, sub, value: &[u8]| desk.service.write(node.id, Address::new(index, sub), value).unwrap();
    // A lost master is a fault, and the master says something once.
    write(0x6007, 0, &[1, 0]);
    write(0x1016, 1, &[20, 0, 127, 0]);
    desk.service.command(NmtCommand::StartRemoteNode, Some(node.id)).unwrap();
    desk.service.send(&nmt::heartbeat(node_id(127).unwrap(), NmtState::Operational)).unwrap();
    desk.service.listen(Duration::from_millis(200), |_| {}).unwrap();
    let mut reached = DeviceHandle::Node(Box::new(desk), node);
    let word = statusword(&mut reached).unwrap();
    assert_eq!(word & 0x4f, 0x08, "{word:04x}: Fault");
    let after = reset_fault(true, &mut reached, word, &mut output).unwrap();
    assert_eq!((after, statusword(&mut reached).unwrap() & 0x4f), (word, 0x08));
    let after = reset_fault(false, &mut reached, word, &mut output).unwrap();
    assert_eq!(after & 0x4f, 0x40, "{after:04x}: Switch On Disabled");
    let again = reset_fault(false, &mut reached, after, &mut output).unwrap_err();
    assert_eq!(again.exit, Exit::Usage);
}

#[test]
fn nothing_is_written_to_a_drive_whose_power_stage_is_on() {
    let (mut desk, _) = desk();
    let node = desk.node("left").unwrap();
    // By an SDO of somebody else: no command of this program writes it.
    desk.service.command(NmtCommand::StartRemoteNode, Some(node.id)).unwrap();
    let mut reached = DeviceHandle::Node(Box::new(desk), node);
    assert!(refuse_powered(&mut reached).is_ok());
    for word in [6_u16, 7] {
        reached.objects().unwrap().write(Address::new(0x6040, 0), &word.to_le_bytes()).unwrap();
    }
    let refused = refuse_powered(&mut reached).unwrap_err();
    assert_eq!(refused.exit, Exit::SafetyStop);
    let DeviceHandle::Node(mut desk, _) = reached else { panic!("on CAN") };
    let sensor = desk.node("wrist").unwrap();
    assert!(refuse_powered(&mut DeviceHandle::Node(desk, sensor)).is_ok());
}

#[test]
fn a_drive_that_stays_in_quick_stop_active_loses_its_torque() {
    let (mut desk, mut output) = desk();
    let node = desk.node("left").unwrap();
    let mut write = |index, value: &[u8]| desk.service.write(node.id, Address::new(index, 0), value).unwrap();
    write(0x605a, &[6, 0]);
    desk.service.command(NmtCommand::StartRemoteNode, Some(node.id)).unwrap();
    let mut reached = DeviceHandle::Node(Box::new(desk), node);
    for word in [0x06_u16, 0x07, 0x0f, 0x02] {
        reached.objects().unwrap().write(Address::new(0x6040, 0), &word.to_le_bytes()).unwrap();
        reached.pause(Duration::from_millis(5)).unwrap();
    }
    reached.pause(Duration::from_secs(2)).unwrap();
    let word = statusword(&mut reached).unwrap();
    assert_eq!(word & 0x6f, 0x07, "{word:04x}: Quick Stop Active");
    let dry = disable_voltage(true, &mut reached, word, &mut output).unwrap();
    assert_eq!(dry & 0x6f, 0x07, "{dry:04x}: nothing was written");
    let after = disable_voltage(false, &mut reached, word, &mut output).unwrap();
    assert_eq!(after & 0x4f, 0x40, "{after:04x}: Switch On Disabled");
    let again = disable_voltage(false, &mut reached, after, &mut output).unwrap_err();
    assert_eq!(again.exit, Exit::Usage);
}

/// Commands in advice come to the same device, wherever it is.
#[test]
fn advice_names_the_place() {
    let (mut desk, _) = desk();
    let node = desk.node("left").unwrap();
    let told = |desk: &DeviceSession, text: &'static str| {
        let explanation = Explanation { next: text.into(), ..explanation::statusword(0x0250) };
        desk.placed(&node, explanation).next.into_owned()
    };
    assert_eq!(
        told(&desk, "`yieldwall emcy NODE` or `yieldwall od write`"),
        "`yieldwall emcy 1` or `yieldwall od write`"
    );
    assert_eq!(
        told(&desk, "`yieldwall run RIG.yaml` enables it"),
        "`yieldwall run builtin:paper-admittance.yaml` enables it"
    );
    (desk.arguments, desk.rig) = (" --bus can0".to_owned(), None);
    for (text, wanted) in [
        ("`yieldwall emcy NODE`; NODE", "`yieldwall emcy 1 --bus can0`; NODE"),
        ("`yieldwall od read NODE 1016h:1`", "`yieldwall od read 1 1016h:1 --bus can0`"),
        ("`yieldwall run RIG.yaml` enables it", "`yieldwall run RIG.yaml --bus can0` enables it"),
        ("`yieldwall bus budget RIG.yaml`", "`yieldwall bus budget RIG.yaml`"),
        ("`yieldwall scan` shows it", "`yieldwall scan --bus can0` shows it"),
        ("nothing: it waits", "nothing: it waits"),
    ] {
        assert_eq!(told(&desk, text), wanted);
    }
}

#[test]
fn a_node_is_named_by_its_id_or_by_the_rig() {
    let (mut desk, _) = desk();
    assert_eq!(desk.node("left").unwrap().id, desk.node("1").unwrap().id);
    assert_eq!(desk.node("10").unwrap().words(), "node 10 (wrist)");
    assert_eq!(desk.node("5").unwrap().words(), "node 5");
    for word in ["0", "128", "-1", "", "rihgt"] {
        assert_eq!(desk.node(word).unwrap_err().exit, Exit::Usage, "{word}");
    }
}
