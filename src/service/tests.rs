//! Against the simulated devices of the shipped rigs.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use yieldwall_drives::eds::{Eds, Node as Of};

use super::*;
use yieldwall_config as config;
use yieldwall_fieldbus::canopen::{BusId, NmtCommand, NmtState, NodeId, cob, nmt, node_id};
use yieldwall_fieldbus::objects::{AbortCode, Address};
use yieldwall_rig::live::VirtualLink;

fn node(raw: u8) -> NodeId {
    node_id(raw).unwrap()
}

fn service() -> Service<VirtualLink> {
    of_rig("paper-admittance.yaml")
}

fn of_rig(name: &str) -> Service<VirtualLink> {
    let rig = config::load_rig(config::builtin(name)).unwrap();
    let scene = rig.scene().unwrap().value;
    let link = VirtualLink::new(&rig.value, &scene, 1).unwrap();
    Service::new(link, BusId::FIRST, Arc::new(AtomicBool::new(false)))
}

fn at(index: u16, sub: u8) -> Address {
    Address::new(index, sub)
}

/// A PDO goes out of use before its mapping changes, and into use at last; the heartbeat comes after all else.
#[test]
fn downloads_come_in_an_order_that_devices_take() {
    let text = "[1000]\nParameterName=Type\nDataType=7\nAccessType=ro\nParameterValue=1\n\
        [1017]\nParameterName=Heartbeat\nDataType=6\nAccessType=rw\nParameterValue=20\n\
        [1400]\nParameterName=RPDO\nObjectType=9\n\
        [1400sub1]\nParameterName=COB-ID\nDataType=7\nAccessType=rw\nParameterValue=$NODEID+0x200\n\
        [1400sub2]\nParameterName=Type\nDataType=5\nAccessType=rw\nParameterValue=1\n\
        [1600]\nParameterName=Mapping\nObjectType=9\n\
        [1600sub0]\nParameterName=Count\nDataType=5\nAccessType=rw\nParameterValue=1\n\
        [1600sub1]\nParameterName=First\nDataType=7\nAccessType=rw\nParameterValue=0x60400010\n\
        [2000]\nParameterName=Own\nDataType=6\nAccessType=rw\nParameterValue=5\n\
        [6040]\nParameterName=Controlword\nDataType=6\nAccessType=rw\nParameterValue=15\n\
        [6072]\nParameterName=Max torque\nDataType=6\nAccessType=rw\nParameterValue=900\n";
    let eds = yieldwall_drives::eds::Eds::read(text.as_bytes()).unwrap().eds;
    let node = yieldwall_fieldbus::canopen::node_id(5).unwrap();
    let written = |explained| -> Vec<(String, Vec<u8>)> {
        super::downloads(&eds, explained, node.raw()).0.into_iter().map(|(at, bytes)| (at.to_string(), bytes)).collect()
    };
    let wanted: [(&str, &[u8]); 8] = [
        ("6072h:0", &[0x84, 3]),
        ("1400h:1", &[5, 2, 0, 0x80]),
        ("1600h:0", &[0]),
        ("1600h:1", &[0x10, 0, 0x40, 0x60]),
        ("1600h:0", &[1]),
        ("1400h:2", &[1]),
        ("1400h:1", &[5, 2, 0, 0]),
        ("1017h:0", &[20, 0]),
    ];
    let wanted: Vec<(String, Vec<u8>)> = wanted.map(|(at, bytes)| (at.to_owned(), bytes.to_vec())).to_vec();
    assert_eq!(written(None), wanted);
    // With a data sheet the vendor's own object is written too; a controlword never is.
    let explained = written(Some(&eds));
    assert_eq!(explained[0], ("2000h:0".to_owned(), vec![5, 0]));
    assert_eq!(explained.len(), wanted.len() + 1);
}

#[test]
fn all_127_nodes_are_asked_within_two_seconds() {
    let mut service = service();
    let found = scan(&mut service).unwrap();
    let nodes: Vec<u8> = found.iter().map(|found| found.node.raw()).collect();
    assert_eq!(nodes, [1, 2, 10]);
    assert_eq!(found[0].device_type, Some(0x0002_0192));
    assert_eq!(found[2].identity, [Some(0xffff_5957), Some(0x404), Some(0x0001_0000), Some(3)]);
    assert_eq!(found[0].name.as_deref(), Some("simulated-servo"));
    assert_eq!(found[0].heard.state, Some(NmtState::PreOperational));
    assert!(service.now().as_secs_f64() < 2.0, "{:?}", service.now());
}

#[test]
fn what_a_node_does_not_have_is_told_apart_from_a_node_that_is_not_there() {
    let mut service = service();
    assert_eq!(service.read(node(1), at(0x5000, 0)), Err(Error::Refused(AbortCode::NO_OBJECT)));
    assert_eq!(service.read(node(5), at(0x1000, 0)), Err(Error::NoAnswer));
    assert_eq!(service.write(node(1), at(0x6041, 0), &[0, 0]), Err(Error::Refused(AbortCode::READ_ONLY)));
    service.command(NmtCommand::StopRemoteNode, Some(node(1))).unwrap();
    assert_eq!(service.state(node(1)), Ok(Some(NmtState::Stopped)));
    assert_eq!(service.read(node(1), at(0x1000, 0)), Err(Error::NoAnswer));
    assert_eq!(service.state(node(5)), Ok(None));
}

/// Written as a file and read again, so that what the file cannot say does not count.
fn dumped(service: &mut Service<VirtualLink>) -> Eds {
    let (eds, missed) = inventory(service, node(1), |_| {}).unwrap();
    // Of the error history nothing is there to be read.
    assert!(missed.iter().all(|missed| missed.at.index == 0x1003), "{missed:?}");
    let reading = Eds::read(eds.to_dcf(&Of { id: 1, ..Of::default() }).as_bytes()).unwrap();
    assert_eq!(reading.findings, []);
    reading.eds
}

#[test]
fn five_changed_objects_are_found_and_put_back() {
    let mut service = service();
    let before = dumped(&mut service);
    assert_eq!(plan(&mut service.objects(node(1)), 1, &before, None).unwrap(), Plan::default());
    let changes: [(u16, u8, &[u8]); 12] = [
        (0x6072, 0, &[0x84, 3]),
        (0x605a, 0, &[6, 0]),
        (0x1017, 0, &[100, 0]),
        // TPDO 1 carries another object, every second SYNC, and TPDO 2 comes into use.
        (0x1800, 1, &[0x81, 1, 0, 0x80]),
        (0x1a00, 0, &[0]),
        (0x1a00, 1, &[0x20, 0, 0x64, 0x60]),
        (0x1a00, 2, &[0x10, 0, 0x41, 0x60]),
        (0x1a00, 0, &[2]),
        (0x1800, 2, &[2]),
        (0x1800, 1, &[0x81, 1, 0, 0]),
        (0x1801, 1, &[0x81, 2, 0, 0]),
        // Process data: no parameter.
        (0x607a, 0, &[1, 0, 0, 0]),
    ];
    for (index, sub, value) in changes {
        service.write(node(1), at(index, sub), value).unwrap_or_else(|error| panic!("{index:04x}:{sub}: {error}"));
    }
    let plan_of = |service: &mut Service<VirtualLink>| plan(&mut service.objects(node(1)), 1, &before, None).unwrap();
    let back = plan_of(&mut service);
    let changed: Vec<u16> = back.steps.iter().map(|step| step.at.index).collect();
    assert!(
        [0x6072, 0x605a, 0x1017, 0x1800, 0x1801, 0x1a00].iter().all(|index| changed.contains(index)),
        "{changed:04x?}"
    );
    let left_out: Vec<Why> = back.left_out.iter().map(|left_out| left_out.why).collect();
    assert_eq!(left_out, [Why::Caution(Caution::SetPoint)]);
    for step in &back.steps {
        let made = carry_out(&mut service.objects(node(1)), step).unwrap();
        assert_eq!(made, WriteOutcome::Written, "{step:?}");
    }
    assert_eq!(plan_of(&mut service).steps, []);
    assert_eq!(service.read(node(1), at(0x1a00, 1)), Ok(vec![0x10, 0, 0x41, 0x60]));
}

#[test]
fn a_file_of_another_node_gives_a_device_its_own_identifiers() {
    let mut service = service();
    let of_one = dumped(&mut service);
    assert_eq!(plan(&mut service.objects(node(2)), 2, &of_one, None).unwrap().steps, []);
}

#[test]
fn what_nobody_explains_and_what_was_measured_stay_as_they_are() {
    let mut service = service();
    let text = "[DeviceInfo]\nVendorName=x\n[DeviceComissioning]\nNodeID=1\n\
        [6072]\nParameterName=Max torque\nObjectType=7\nDataType=6\nAccessType=rw\nParameterValue=700\n\
        [608F]\nParameterName=Encoder\nObjectType=9\nSubNumber=1\n\
        [608Fsub1]\nParameterName=Increments\nDataType=7\nAccessType=rw\nParameterValue=4096\n\
        [2010]\nParameterName=Of the vendor\nObjectType=7\nDataType=5\nAccessType=rw\nParameterValue=5\n\
        [6040]\nParameterName=Controlword\nObjectType=7\nDataType=6\nAccessType=rw\nParameterValue=15\n\
        [5000]\nParameterName=Not there\nObjectType=7\nDataType=5\nAccessType=rw\nParameterValue=1\n";
    let wanted = Eds::read(text.as_bytes()).unwrap().eds;
    let plan = plan(&mut service.objects(node(1)), 1, &wanted, None).unwrap();
    let steps: Vec<Address> = plan.steps.iter().map(|step| step.at).collect();
    assert_eq!(steps, [at(0x6072, 0)]);
    let left_out: Vec<(u16, Why)> = plan.left_out.iter().map(|left_out| (left_out.at.index, left_out.why)).collect();
    assert_eq!(
        left_out,
        [
            (0x2010, Why::Unexplained),
            (0x5000, Why::Unreadable(Error::Refused(AbortCode::NO_OBJECT))),
            (0x6040, Why::Caution(Caution::Enables)),
            (0x608f, Why::Caution(Caution::Measured)),
        ]
    );
}

#[test]
fn a_device_tells_of_its_errors_while_nobody_asks() {
    let mut service = service();
    // The drive watches node 127, which says something once.
    service.write(node(1), at(0x1016, 1), &[20, 0, 127, 0]).unwrap();
    service.send(&nmt::heartbeat(node(127), NmtState::Operational)).unwrap();
    let mut heard = 0;
    service.listen(Duration::from_millis(100), |_| heard += 1).unwrap();
    let told: Vec<u16> = service.emergencies().iter().map(|(_, emergency)| emergency.code.0).collect();
    assert_eq!((told, heard), (vec![0x8130], 1));
    assert_eq!(service.emergencies()[0].1.frame().id(), cob::emcy(node(1)));
}

/// A link that notes what is sent, and has somebody wish to end after so many frames.
struct Watched {
    link: VirtualLink,
    sent: Vec<yieldwall_fieldbus::canopen::Frame>,
    ends_after: usize,
    is_over: Arc<AtomicBool>,
}

impl yieldwall_link::CanLink for Watched {
    fn now(&self) -> yieldwall_fieldbus::time::Time {
        self.link.now()
    }

    fn receive(&mut self) -> Option<yieldwall_link::Arrival> {
        self.link.receive()
    }

    fn send(&mut self, frame: &yieldwall_fieldbus::canopen::Frame) -> Result<(), yieldwall_link::SendError> {
        self.sent.push(*frame);
        self.is_over.fetch_or(self.sent.len() == self.ends_after, std::sync::atomic::Ordering::Relaxed);
        self.link.send(frame)
    }

    fn wait(&mut self, until: yieldwall_fieldbus::time::Time) -> bool {
        self.link.wait(until)
    }
}

fn watched(ends_after: usize) -> Service<Watched> {
    let rig = config::load_rig(config::builtin("paper-admittance.yaml")).unwrap();
    let scene = rig.scene().unwrap().value;
    let link = VirtualLink::new(&rig.value, &scene, 1).unwrap();
    let is_over = Arc::new(AtomicBool::new(false));
    let link = Watched { link, sent: Vec::new(), ends_after, is_over: Arc::clone(&is_over) };
    Service::new(link, BusId::FIRST, is_over)
}

#[test]
fn a_drive_is_adopted_and_has_its_values_again() {
    let mut service = watched(usize::MAX);
    let (before, _) = inventory(&mut service, node(1), |_| {}).unwrap();
    let values = adopt::originals(&mut service.objects(node(1))).unwrap();
    let survey = adopt::survey(&mut service.objects(node(1)), &values, None, None).unwrap();
    assert_eq!((survey.modes.len(), survey.mapping_entries, survey.has_dummies), (3, 8, true));
    assert_eq!((survey.lost_master, survey.follows_sync, survey.limits), (Some(3), [true; 2], [true; 3]));
    assert!(survey.has_rpdo_timer && survey.watches_heartbeat && survey.takes_cycle_time, "{survey:?}");
    let (after, _) = inventory(&mut service, node(1), |_| {}).unwrap();
    for (index, sub, entry) in before.entries().filter(|(index, ..)| *index != 0x6064) {
        assert_eq!(after.entry(index, sub).map(|entry| &entry.value), Some(&entry.value), "{index:04x}:{sub}");
    }
    // The file is a profile, and says the same.
    let (text, missing) = adopt::profile(&survey, None, "found", "0");
    let source = config::Source::among("found.yaml", [("found.yaml".into(), text.clone().into())]);
    let config::Document::Profile(profile) = config::load(source).unwrap() else { panic!("{text}") };
    assert_eq!(profile.value.servo().unwrap().process_data.supported_modes(), 0x380);
    assert!(missing.iter().any(|line| line.contains("by the result of `yieldwall drill`")), "{missing:?}");
    // Its controlword was never written, nor did anybody start it.
    let is_harmless = |frame: &&yieldwall_fieldbus::canopen::Frame| match frame.id() {
        0x601 | 0x701 => true,
        // Whether it has LSS: identify remote slave.
        0x7e5 => (0x46..=0x4b).contains(&frame.bytes()[0]),
        _ => false,
    };
    assert!(service.link().sent.iter().all(|frame| is_harmless(&frame)), "only SDO, guarding and the question for LSS");
    assert!(
        before.device.has_lss && (before.device.rpdos, before.device.tpdos) == (Some(4), Some(4)),
        "{:?}",
        before.device
    );
    let writes_controlword = |frame: &&yieldwall_fieldbus::canopen::Frame| {
        frame.bytes()[0] & 0xe0 == 0x20 && frame.bytes()[1..3] == [0x40, 0x60]
    };
    assert_eq!(service.link().sent.iter().filter(writes_controlword).count(), 0);
}

#[test]
fn whoever_ends_an_adoption_leaves_the_drive_as_it_was() {
    let frames = {
        let mut service = watched(usize::MAX);
        let values = adopt::originals(&mut service.objects(node(1))).unwrap();
        let begun = service.link().sent.len();
        adopt::survey(&mut service.objects(node(1)), &values, None, None).unwrap();
        begun + 1..service.link().sent.len()
    };
    let mut interrupted = 0;
    for ends_after in frames.step_by(7) {
        let mut service = watched(ends_after);
        let values = adopt::originals(&mut service.objects(node(1))).unwrap();
        match adopt::survey(&mut service.objects(node(1)), &values, None, None) {
            Err(adopt::Refusal::Service(Error::Interrupted)) => interrupted += 1,
            other => assert!(other.is_ok(), "{ends_after}: {other:?}"),
        }
        service.finish();
        for (at, value) in &values {
            assert_eq!(service.read(node(1), *at).as_ref(), Ok(value), "{at} after {ends_after} frames");
        }
    }
    assert!(interrupted > 10, "{interrupted}");
}

#[test]
fn what_is_no_drive_at_rest_is_not_adopted() {
    let mut service = service();
    assert!(matches!(adopt::originals(&mut service.objects(node(10))), Err(adopt::Refusal::NoDrive(0x0002_0194))));
    service.command(NmtCommand::StartRemoteNode, Some(node(1))).unwrap();
    assert_eq!(adopt::originals(&mut service.objects(node(1))), Err(adopt::Refusal::Nmt(NmtState::Operational)));
    service.write(node(2), at(0x6040, 0), &[6, 0]).unwrap();
    assert!(matches!(adopt::originals(&mut service.objects(node(2))), Err(adopt::Refusal::State(Some(_)))));
    assert_eq!(adopt::originals(&mut service.objects(node(5))), Err(adopt::Refusal::Service(Error::NoAnswer)));
}

#[test]
fn drives_of_five_odd_vendors_are_adopted_for_what_they_are() {
    type Shows = fn(&adopt::Survey) -> bool;
    let vendors: [(&str, &str, Shows); 5] = [
        ("four-entries", "no bytes can be skipped", |survey| survey.mapping_entries == 4 && !survey.has_dummies),
        ("mode-below-enabled", "the event timer of an RPDO", |survey| {
            survey.mapping_entries == 8 && survey.has_dummies
        }),
        ("no-rpdo-timer", "no event timer of RPDOs (1400h:5)", |survey| !survey.has_rpdo_timer),
        ("slow-segments", "the event timer of an RPDO", |survey| survey.slowest >= Duration::from_millis(40)),
        ("wrong-lengths", "6041h:0 statusword comes with 4 bytes in place of 2", |survey| survey.lengths.len() > 3),
    ];
    for (name, says, shows) in vendors {
        let mut service = of_rig(&format!("vendors/{name}.yaml"));
        let found = scan(&mut service).unwrap();
        assert_eq!(found[0].name.as_deref(), Some(name));
        assert!(service.now().as_secs_f64() < 3.0, "{name}: {:?}", service.now());
        let values = adopt::originals(&mut service.objects(node(1))).unwrap();
        let survey = adopt::survey(&mut service.objects(node(1)), &values, None, None)
            .unwrap_or_else(|refusal| panic!("{name}: {refusal}"));
        assert!(shows(&survey), "{name}: {survey:?}");
        assert_eq!(survey.modes.len(), 3, "{name}: {:?}", survey.refused_modes);
        assert_eq!((survey.lost_master, survey.follows_sync, survey.limits), (Some(3), [true; 2], [true; 3]), "{name}");
        assert!(survey.watches_heartbeat && survey.stops_on_error && survey.takes_cycle_time, "{name}: {survey:?}");
        for (at, value) in &values {
            assert_eq!(service.read(node(1), *at).as_ref(), Ok(value), "{name}: {at}");
        }
        let (text, missing) = adopt::profile(&survey, None, name, "0");
        let source = config::Source::among("found.yaml", [("found.yaml".into(), text.clone().into())]);
        assert!(config::load_profile(source).is_ok(), "{text}");
        assert!(missing.iter().any(|line| line.contains(says)), "{name}: {missing:#?}");
    }
}

/// A drive that holds one value in one object, as if in a type of its own.
struct Holder(Address, Vec<u8>);

impl ObjectAccess for Holder {
    fn read(&mut self, at: Address) -> Result<Vec<u8>, Error> {
        if at == self.0 { Ok(self.1.clone()) } else { Err(Error::Refused(AbortCode::NO_OBJECT)) }
    }

    fn write(&mut self, at: Address, value: &[u8]) -> Result<(), Error> {
        match (at == self.0, value.len() == self.1.len()) {
            (true, true) => self.1 = value.to_vec(),
            (true, false) => return Err(Error::Refused(AbortCode::LENGTH)),
            (false, _) => return Err(Error::Refused(AbortCode::NO_OBJECT)),
        }
        Ok(())
    }
}

/// A file says which type the drive has, and the length of the drive's answer which of two types that both have a place for the value.
#[test]
fn a_torque_limit_is_restored_in_the_type_of_its_file() {
    for (index, data_type, value, held, new) in [
        (0x60e1, 3, "-500", &[0x18, 0xfc][..], &[0x0c, 0xfe][..]),
        (0x60e0, 2, "-100", &[0x64], &[0x9c]),
        (0x60e1, 4, "-70000", &[0; 4], &[0x90, 0xee, 0xfe, 0xff]),
        (0x60e1, 4, "500", &[0; 4], &[0xf4, 0x01, 0, 0]),
        // A file of somebody who writes all numbers as UNSIGNED32.
        (0x6072, 7, "500", &[0, 0], &[0xf4, 0x01]),
    ] {
        let text = format!(
            "[DeviceInfo]\nVendorName=x\n[{index:04X}]\nParameterName=Limit\nObjectType=7\nDataType={data_type}\nAccessType=rw\n\
             ParameterValue={value}\n"
        );
        let wanted = Eds::read(text.as_bytes()).unwrap().eds;
        let mut drive = Holder(at(index, 0), held.to_vec());
        let found = plan(&mut drive, 1, &wanted, None).unwrap();
        assert_eq!(found.left_out, [], "{value}");
        let [step] = &found.steps[..] else { panic!("{value}: {:?}", found.steps) };
        assert_eq!(step.new, new, "{value}");
        assert_eq!(carry_out(&mut drive, step).unwrap(), WriteOutcome::Written, "{value}");
        assert_eq!(plan(&mut drive, 1, &wanted, None).unwrap(), Plan::default(), "{value}");
        assert_eq!(downloads(&wanted, None, 1).1, [], "{value}");
    }
}

/// The dump of a drive that counts its limit as a negative number has a negative number in the file.
#[test]
fn a_negative_torque_limit_is_dumped_as_one() {
    let mut drive = Holder(at(0x60e1, 0), vec![0x18, 0xfc]);
    let (found, _) = inventory_of(&mut drive, 1, Eds::default(), |_| ()).unwrap();
    let entry = found.entry(0x60e1, 0).unwrap();
    assert_eq!((entry.data_type, &entry.value), (3, &Some(yieldwall_drives::eds::Value::Integer(-1000))));
}

/// The same entries from the drive that sends values of one to four bytes with up to eight, as from one that does not; each value whose
/// type nothing gives is named.
#[test]
fn a_dump_of_a_drive_with_wrong_lengths_loses_no_entry() {
    let places = |eds: &Eds| {
        eds.entries()
            .filter(|(.., entry)| entry.value.is_some())
            .map(|(index, sub, _)| at(index, sub))
            .collect::<Vec<_>>()
    };
    let (plain, missed) = inventory(&mut service(), node(1), |_| {}).unwrap();
    assert!(missed.iter().all(|missed| !missed.why.is_uncertain()), "{missed:?}");
    let (odd, missed) = inventory(&mut of_rig("vendors/wrong-lengths.yaml"), node(1), |_| {}).unwrap();
    let [plain, odd] = [places(&plain), places(&odd)];
    let lost: Vec<&Address> =
        plain.iter().filter(|at| !odd.contains(at) && (at.index < 0x2000 || at.index >= 0x6000)).collect();
    assert_eq!(lost, Vec::<&Address>::new());
    assert!(odd.contains(&at(0x1600, 1)));
    let uncertain: Vec<Address> =
        missed.iter().filter(|missed| missed.why.is_uncertain()).map(|missed| missed.at).collect();
    assert!(uncertain.iter().all(|at| odd.contains(at)), "{uncertain:?}");
    println!("uncertain: {uncertain:?}");
}
