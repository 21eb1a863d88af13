//! Output of the commands on the simulated segment, and on broken devices.

use super::*;
use yieldwall_config::injection::{Injection, Kind, Target};
use yieldwall_drives::esi::Esi;
use yieldwall_fieldbus::ethercat::AlStatusCode;
use yieldwall_fieldbus::objects::ServedDevice as _;
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{EthernetArrival, EthernetLink, EthernetReceived, SendError};
use yieldwall_sim::ethercat::{Segment, SimulatedDevice};

/// The devices of the shipped rig.
fn link() -> VirtualSegment {
    let rig = config::load_rig(config::builtin("paper-ethercat.yaml")).unwrap();
    VirtualSegment::new(&rig.value, &rig.scene().unwrap().value, 1).unwrap()
}

/// The desk at these devices.
fn at(link: VirtualSegment) -> SegmentSession {
    let rig = config::load_rig(config::builtin("paper-ethercat.yaml")).unwrap();
    SegmentSession {
        service: SegmentService::new(Box::new(link), Arc::new(AtomicBool::new(false))),
        entries: entries(&rig.value).unwrap(),
        place: String::new(),
        arguments: String::new(),
        is_simulated: true,
        heard: None,
    }
}

/// The desk at devices to which something was done.
fn desk(break_it: impl FnOnce(&mut Segment<SimulatedDevice>)) -> SegmentSession {
    let mut link = link();
    break_it(link.server_mut().segment_mut().unwrap());
    at(link)
}

fn scanned(desk: &mut SegmentSession) -> String {
    let found: Vec<_> = (0..desk.devices().unwrap()).map(|position| desk.service.present(position).unwrap()).collect();
    scan::text(desk, &found)
}

#[test]
fn devices_are_found_in_their_order() {
    insta::assert_snapshot!("segment-scan", scanned(&mut desk(|_| ())));
}

/// The checksum of one device is wrong, a category of another one is torn, and the third has an error.
#[test]
fn a_damaged_sii_names_word_and_meaning_and_leaves_the_others_legible() {
    let mut desk = desk(|segment| {
        segment.controller_mut(0).unwrap().sii_mut()[14] ^= 0x55;
        let sensor = segment.controller_mut(2).unwrap().sii_mut();
        sensor[2 * 0x41..2 * 0x42].copy_from_slice(&0x7000_u16.to_le_bytes());
        segment.controller_mut(1).unwrap().fail(Time(0), AlStatusCode::SYNC_ERROR);
    });
    insta::assert_snapshot!("segment-scan-damaged", scanned(&mut desk));
}

/// The master refuses what the desk would, by one identity.
#[test]
fn another_vendor_s_sensor_is_another_device() {
    let mut desk = desk(|segment| {
        segment.controller_mut(2).unwrap().sii_mut()[2 * 0x08..2 * 0x0a].copy_from_slice(&0x11d_u32.to_le_bytes());
    });
    let found = scanned(&mut desk);
    assert!(found.contains("wrist is another device (ati-ethercat)"), "{found}");
}

#[test]
fn a_device_is_meant_by_position_name_or_role() {
    let mut desk = desk(|_| ());
    for (word, position, words) in [
        ("0", 0, "left (position 0)"),
        ("right", 1, "right (position 1)"),
        ("wrist", 2, "wrist (position 2)"),
        ("sensor", 2, "wrist (position 2)"),
    ] {
        let device = desk.device(word).unwrap();
        assert_eq!((device.position, device.words().as_str()), (position, words), "{word}");
    }
    assert_eq!(desk.device("rihgt").unwrap_err().exit, Exit::Usage);
    let missing = desk.device("3").unwrap_err();
    assert_eq!(missing.exit, Exit::DeviceMismatch);
    let message = &missing.report.diagnostics[0].message;
    assert!(message.contains("3 devices answer, and this one would be the one at position 3"), "{message}");
}

/// A wire on which each datagram comes back with a working counter of 65 535.
struct Many(VirtualSegment);

impl EthernetLink for Many {
    fn now(&self) -> Time {
        self.0.now()
    }

    fn source(&self) -> [u8; 6] {
        yieldwall_fieldbus::ethercat::frame::SOURCE
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Option<EthernetArrival> {
        let arrival = self.0.receive(buffer)?;
        if let EthernetReceived::Frame { .. } = arrival.what {
            // The counter of the one datagram is behind its data.
            let data = usize::from(u16::from_le_bytes([buffer[22], buffer[23]]) & 0x7ff);
            buffer[26 + data..28 + data].copy_from_slice(&[0xff; 2]);
        }
        Some(arrival)
    }

    fn send(&mut self, frame: &[u8]) -> Result<(), SendError> {
        self.0.send(frame)
    }

    fn wait(&mut self, until: Time) -> bool {
        self.0.wait(until)
    }
}

#[test]
fn more_devices_than_a_segment_has_are_not_asked_one_by_one() {
    let mut desk = at(link());
    desk.service = SegmentService::new(Box::new(Many(link())), Arc::new(AtomicBool::new(false)));
    let failure = desk.devices_of(None).unwrap_err();
    let message = &failure.report.diagnostics[0].message;
    assert_eq!(
        (failure.exit, message.as_str()),
        (Exit::BusUnavailable, "65535 devices answer, of which at most 64 can be there")
    );
}

#[test]
fn whoever_has_put_a_device_into_safe_op_is_offered_the_way_out() {
    let desk = desk(|_| ());
    let status = AlStatus::new(AlState::SafeOperational, false);
    let failure = desk.other_master(SegmentSign::State { position: 0, status });
    let help = failure.report.diagnostics[0].help.clone().unwrap();
    assert!(
        help.contains("or `yieldwall state` has put the device there, `yieldwall state all init --take-over`"),
        "{help}"
    );
}

#[test]
fn a_scan_that_listens_beside_a_master_names_it() {
    let mut desk = desk(|_| ());
    assert!(scan::text(&desk, &[]).starts_with("no device is heard"));
    desk.heard = Some(SegmentSign::Frame([2, 0, 0, 0, 0, 1]));
    let text = scan::text(&desk, &[]);
    assert!(text.contains("an EtherCAT frame came from 02:00:00:00:00:01"), "{text}");
}

#[test]
fn a_segment_of_which_nothing_comes_back_is_not_available() {
    let mut desk = desk(|segment| segment.set_cable(0, false));
    let failure = desk.devices().unwrap_err();
    assert_eq!(failure.exit, Exit::BusUnavailable);
    assert!(failure.report.diagnostics[0].message.contains("none came back"), "{failure:?}");
}

/// A device by device walk: what was asked, what came of it.
fn told(desk: &mut SegmentSession, word: &str, target: state::Target) -> String {
    let device = desk.device(word).unwrap();
    let (seen, end) = state::change(desk, device, Some(target)).unwrap();
    let failure = end.err().map(|failure| format!("{:?}: {}\n", failure.exit, failure.report.diagnostics[0].message));
    state::text(&[seen], None) + &failure.unwrap_or_default()
}

#[test]
fn a_device_goes_from_state_to_state_and_a_refused_one_names_step_code_and_what_to_try() {
    use state::Target;

    let mut desk = desk(|segment| {
        segment.controller_mut(1).unwrap().fail(Time(0), AlStatusCode::SYNC_ERROR);
        // A device whose mailboxes are said to be where there is none.
        let chip = segment.controller_mut(2).unwrap().sii_mut();
        let mut moved = yieldwall_fieldbus::ethercat::sii::Sii::read(chip).unwrap();
        moved.sync_managers[0].settings.start = 0x2000;
        let moved = moved.write();
        chip[..moved.len()].copy_from_slice(&moved);
    });
    let all = [
        told(&mut desk, "left", Target::Preop),
        told(&mut desk, "left", Target::Safeop),
        told(&mut desk, "left", Target::Ack),
        told(&mut desk, "left", Target::Init),
        told(&mut desk, "right", Target::Ack),
        told(&mut desk, "right", Target::Preop),
        told(&mut desk, "sensor", Target::Preop),
    ];
    insta::assert_snapshot!("segment-state", all.concat());
}

#[test]
fn devices_that_a_master_has_are_left_alone() {
    let mut desk = desk(|_| ());
    assert!(desk.refuse_led().is_ok());
    let sign = SegmentSign::State { position: 1, status: yieldwall_fieldbus::ethercat::AlStatus(8) };
    desk.arguments = " --bus eth0".to_owned();
    let failure = desk.other_master(sign);
    assert_eq!(failure.exit, Exit::BusUnavailable);
    let finding = &failure.report.diagnostics[0];
    assert!(finding.message.contains("nothing was written: the device at position 1 is in OP"), "{}", finding.message);
    assert!(finding.help.as_ref().unwrap().contains("`yieldwall state all init --take-over --bus eth0`"));
}

#[test]
fn counters_and_clocks_of_all_devices() {
    let mut desk = desk(|segment| {
        segment.controller_mut(1).unwrap().count_receive_error(0);
        segment.set_cable(2, false);
        segment.set_cable(2, true);
    });
    let mut text = String::new();
    for _ in 0..2 {
        let counted: Vec<_> = desk.devices_of(None).unwrap();
        let counted: Vec<_> =
            counted.into_iter().map(|it| (it.clone(), desk.service.counters(it.position).unwrap())).collect();
        text.push_str(&super::super::errors::text(&counted));
        (0..3).for_each(|position| desk.service.clear_counters(position).unwrap());
    }
    text.push_str(&super::super::dc::text(&super::super::dc::read(&mut desk, None).unwrap()));
    insta::assert_snapshot!("segment-errors-dc", text);
}

#[test]
fn an_sii_is_read_and_checked() {
    use super::super::sii;

    let mut desk = desk(|segment| {
        segment.controller_mut(0).unwrap().sii_mut()[14] ^= 0x55;
        segment.controller_mut(1).unwrap().sii_mut()[2 * 0x0a] ^= 1;
    });
    let untidy = desk.service.sii_image(0).unwrap();
    let untidy = yieldwall_fieldbus::ethercat::sii::Sii::read(&untidy).unwrap();
    assert!(sii::text(&untidy, 64).contains("warning          word 0007h: the checksum is "));
    let image = desk.service.sii_image(2).unwrap();
    let text = sii::text(&yieldwall_fieldbus::ethercat::sii::Sii::read(&image).unwrap(), image.len());
    let checked = sii::check_text(&sii::checked(&mut desk, None).unwrap());
    insta::assert_snapshot!("segment-sii", text + &checked);
}

fn reached(word: &str, break_it: impl FnOnce(&mut Segment<SimulatedDevice>)) -> super::super::reached::DeviceHandle {
    super::super::reached::DeviceHandle::on_segment(desk(break_it), word, &Output::new(true, false, false)).unwrap()
}

#[test]
fn objects_are_read_written_and_listed_over_the_mailbox() {
    use yieldwall_drives::eds::Eds;
    use yieldwall_fieldbus::objects::{AbortCode, Address};
    use yieldwall_service::inventory_of;

    let mut reached = reached("left", |_| ());
    let at = Address::new(0x6072, 0);
    assert_eq!(reached.read(at), Ok(vec![0xe8, 3]));
    let mut objects = reached.objects().unwrap();
    objects.write(at, &[0x84, 3]).unwrap();
    assert_eq!(objects.read(at), Ok(vec![0x84, 3]));
    assert_eq!(objects.read(Address::new(0x5000, 0)), Err(Error::Refused(AbortCode::NO_OBJECT)));
    assert_eq!(objects.write(Address::new(0x6041, 0), &[0, 0]), Err(Error::Refused(AbortCode::READ_ONLY)));
    let (found, missed) = inventory_of(&mut *objects, 0, Eds::default(), |_| {}).unwrap();
    assert_eq!(missed, []);
    assert!(found.objects.len() > 20 && found.objects.contains_key(&0x1c32), "{}", found.objects.len());
}

#[test]
fn a_device_with_a_damaged_sii_whose_mailbox_is_set_up_is_still_asked() {
    use yieldwall_fieldbus::objects::Address;

    let mut desk = desk(|_| ());
    let device = desk.device("right").unwrap();
    desk.service.change_state(1, AlState::PreOperational).unwrap();
    desk.service.write(1, 0x0500, &[2]).unwrap();
    let output = Output::new(true, false, false);
    let mut reached = super::super::reached::DeviceHandle::Device(Box::new(desk), device);
    assert_eq!(reached.read(Address::new(0x1018, 2)), Ok(vec![2, 4, 0, 0]));
    // In INIT with an error nothing is done to it unasked.
    let mut broken = self::desk(|segment| {
        segment.controller_mut(0).unwrap().fail(Time(0), AlStatusCode::SYNC_ERROR);
    });
    let device = broken.device("left").unwrap();
    let failure = broken.reach(&device, &output).unwrap_err();
    let finding = &failure.report.diagnostics[0];
    assert!(finding.message.contains("it is in INIT+ERR with 001Ah"), "{}", finding.message);
    assert!(finding.help.as_ref().unwrap().starts_with("`yieldwall state 0 preop`"), "{finding:?}");
}

#[test]
fn process_data_and_emergencies_are_shown() {
    let mut text = pdo::shown(&mut reached("left", |_| ())).unwrap();
    let mut link = link();
    link.server_mut().inject(Injection::new(Kind::Emergency, 0.3).on(Target::LeftDrive)).unwrap();
    let mut desk = at(link);
    let device = desk.device("left").unwrap();
    let output = Output::new(true, false, false);
    desk.reach(&device, &output).unwrap();
    assert!(desk.service.now() < Time(300_000_000), "{:?}", desk.service.now());
    desk.objects(&device).unwrap().listen(std::time::Duration::from_millis(400)).unwrap();
    let told = emcy::ask(&mut desk, device, &output).unwrap();
    text.push_str(&emcy::lines(&desk, &told));
    insta::assert_snapshot!("segment-pdo-emcy", text);
}

#[test]
fn an_alias_is_written_with_its_checksum_and_no_other_device_may_have_it() {
    use super::super::alias::with_alias;
    use yieldwall_fieldbus::ethercat::sii::{Sii, changes};

    let mut desk = desk(|segment| segment.controller_mut(2).unwrap().sii_mut()[14] ^= 0x55);
    let [left, right, sensor] = ["left", "right", "sensor"].map(|word| desk.device(word).unwrap());
    let held = desk.service.sii_image(0).unwrap();
    let image = with_alias(&mut desk, &left, 7).unwrap();
    desk.service.write_sii(0, &changes(&held, &image)).unwrap();
    let after = desk.service.present(0).unwrap();
    assert_eq!((after.alias, after.sii), (Some(7), Ok(Sii { alias: 7, ..Sii::read(&held).unwrap() })));
    let taken = with_alias(&mut desk, &right, 7).unwrap_err();
    assert!(taken.report.diagnostics[0].message.contains("left (position 0) has the alias 7 already"));
    let damaged = with_alias(&mut desk, &sensor, 8).unwrap_err();
    assert!(damaged.report.diagnostics[0].message.contains("its SII is damaged: word 0007h"));
    // The image of a whole one of its kind fixes it.
    let mut image = desk.service.sii_image(2).unwrap();
    let held = image.clone();
    yieldwall_fieldbus::ethercat::sii::seal(&mut image);
    desk.service.write_sii(2, &changes(&held, &image)).unwrap();
    assert!(desk.service.present(2).unwrap().sii.is_ok());
}

/// The image of a device description reads as the chip of its device, and brings a device with an empty chip back.
#[test]
fn a_description_makes_the_image_that_a_chip_lost() {
    use super::super::sii::description;
    use std::path::Path;
    use yieldwall_fieldbus::ethercat::sii::{Sii, changes};

    let mut link = link();
    let segment = link.server_mut().segment_mut().unwrap();
    let each = [0, 2].map(|at| segment.controller_mut(at).unwrap().device().od().clone());
    let mut esi = yieldwall_sim::ethercat::esi(&each[0], "vendor");
    segment.controller_mut(0).unwrap().sii_mut().fill(0xff);
    let mut desk = at(link);
    let (left, right) = (desk.device("left").unwrap(), desk.device("right").unwrap());
    let output = &mut Output::new(true, false, false);
    let mut of = |desk: &mut SegmentSession, esi: &_, device: &Device, named: Option<&str>| {
        let present = desk.service.present(device.position).unwrap();
        description::image(esi, device, &present, (Path::new("vendor.xml"), named), output)
    };
    // The right drive is of the same kind: all that its chip holds is in the image.
    let image = of(&mut desk, &esi, &right, None).unwrap();
    assert_eq!(Ok(Sii::read(&image).unwrap()), desk.service.present(1).unwrap().sii);
    let mut other = yieldwall_sim::ethercat::esi(&each[1], "vendor");
    esi.devices.append(&mut other.devices);
    let failure = of(&mut desk, &esi, &left, None).unwrap_err();
    let finding = &failure.report.diagnostics[0];
    assert!(finding.message.contains("the chip at 0 does not report a device of this vendor"), "{finding:?}");
    let (drive, sensor) = (esi.devices[0].type_name.clone(), esi.devices[1].type_name.clone());
    let help = finding.help.clone().unwrap();
    assert!(help.contains("add --device TYPE") && help.contains(&drive) && help.contains(&sensor), "{help}");
    for named in [drive.to_uppercase(), format!("{:#x}", esi.devices[0].product_code)] {
        let image = of(&mut desk, &esi, &left, Some(&named)).unwrap();
        let held = desk.service.sii_up_to(0, image.len() / 2).unwrap();
        desk.service.write_sii(0, &changes(&held, &image)).unwrap();
        let sii = desk.service.present(0).unwrap().sii.unwrap();
        assert_eq!((sii.product_code, sii.serial, sii.alias), (esi.devices[0].product_code, 0, 0));
    }
    assert!(of(&mut desk, &esi, &left, Some("S7")).unwrap_err().report.diagnostics[0].message.contains("S7"));
}

/// The description of the shipped drives with two slots, of which the first has two modules and no default.
#[test]
fn a_drive_is_adopted_with_the_modules_that_are_named() {
    use super::super::adopt::Description;
    use std::path::Path;

    let mut reached = reached("left", |_| ());
    let od = link().server_mut().segment_mut().unwrap().controller_mut(0).unwrap().device().od().clone();
    let slots = "<Slots SlotPdoIncrement=\"#x10\" SlotIndexIncrement=\"#x800\"><Slot MinInstances=\"1\"><Name>Axis</Name><ModuleIdent>1</ModuleIdent>\
                 <ModuleIdent>2</ModuleIdent></Slot><Slot MinInstances=\"0\"><ModuleIdent>1</ModuleIdent></Slot></Slots><Eeprom>";
    let modules = "</Devices><Modules><Module><Type ModuleIdent=\"1\">CSP</Type><RxPdo Sm=\"2\"><Index DependOnSlot=\"1\">#x1600</Index><Entry>\
                   <Index DependOnSlot=\"1\">#x6040</Index><BitLen>16</BitLen></Entry></RxPdo></Module><Module><Type ModuleIdent=\"2\">CST\u{7f}</Type></Module></Modules>";
    let text = yieldwall_sim::ethercat::esi(&od, "vendor").write();
    let esi = Esi::read(text.replace("<Eeprom>", slots).replace("</Devices>", modules).as_bytes()).unwrap();
    let mut of = |named: &[(u32, &str)]| {
        let named: Vec<_> = named.iter().map(|(slot, word)| (*slot, (*word).to_owned())).collect();
        Description::of(&esi, Path::new("vendor.xml"), &named, &mut reached).map_err(|failure| {
            let finding = &failure.report.diagnostics[0];
            format!("{} / {}", finding.message, finding.help.as_deref().unwrap_or_default())
        })
    };
    let refused = of(&[]).err().unwrap();
    for says in
        ["slot 1 (Axis) takes one of several modules", "CSP (#x00000001), CST (#x00000002)", "--module 1=MODULE"]
    {
        assert!(refused.contains(says), "{refused}");
    }
    let refused = of(&[(1, "CSP"), (3, "CSP")]).err().unwrap();
    assert!(refused.contains("no slot 3: the file describes 2; nothing was written / --module counts"), "{refused}");
    let one = of(&[(1, "csp")]).unwrap();
    assert_eq!(one.modules, [["slot 1 (Axis)".to_owned(), "CSP (#x00000001)".to_owned()]]);
    assert_eq!(one.axis_steps, None);
    let two = of(&[(1, "CSP"), (2, "#x1")]).unwrap();
    assert_eq!(two.device.rx_pdos.last().map(|pdo| (pdo.index, pdo.entries[0].index)), Some((0x1610, 0x6840)));
    assert_eq!(two.axis_steps.map(|steps| (steps.objects, steps.pdos, steps.vendor_objects)), Some((0x800, 16, 0)));
}

#[test]
#[cfg(target_os = "linux")]
fn doctor_tells_of_each_device_what_is_wrong_with_it() {
    let mut desk = desk(|segment| {
        segment.controller_mut(0).unwrap().sii_mut()[14] ^= 0x55;
        segment.controller_mut(0).unwrap().fail(Time(0), AlStatusCode::SYNC_ERROR);
        segment.controller_mut(1).unwrap().count_receive_error(0);
        segment.set_cable(2, false);
    });
    desk.arguments = " --bus eth0".to_owned();
    desk.service.change_state(1, AlState::PreOperational).unwrap();
    let sections = doctor::sections(&mut desk, None).unwrap();
    let text: Vec<String> = sections.iter().map(crate::checkup::Section::text).collect();
    insta::assert_snapshot!("segment-doctor", text.join("\n"));
}

/// The rig of the shipped segment whose simulation has these devices, which are odd.
#[cfg(target_os = "linux")]
fn odd(devices: &[&str]) -> SegmentSession {
    let mut rig = config::load_rig(config::builtin("paper-ethercat.yaml")).unwrap();
    let devices = devices.iter().map(|device| serde_json::from_str(device).unwrap());
    rig.value.simulation.as_mut().unwrap().segment = devices.collect();
    at(VirtualSegment::new(&rig.value, &rig.scene().unwrap().value, 1).unwrap())
}

/// The words of a coupler: an identity, and neither mailbox nor protocol.
#[cfg(target_os = "linux")]
fn coupler() -> String {
    use yieldwall_fieldbus::ethercat::sii::Sii;

    let image = Sii { vendor_id: 2, product_code: 0x044c_2c52, order: "EK1100".to_owned(), ..Sii::default() }.write();
    image.iter().map(|byte| format!("{byte:02x} ")).collect()
}

/// A coupler has no objects, a drive in INIT is asked in PRE-OP and put back, and a cable in an output is reported.
#[test]
#[cfg(target_os = "linux")]
fn doctor_takes_devices_as_they_are() {
    let coupler = format!(r#"{{"position": 3, "is_turned": true, "sii": "{}"}}"#, coupler());
    let mut desk = odd(&[&coupler]);
    let sections = doctor::sections(&mut desk, None).unwrap();
    let text: Vec<String> = sections.iter().map(crate::checkup::Section::text).collect();
    insta::assert_snapshot!("segment-doctor-odd", text.join("\n"));
    for position in 0..4 {
        assert_eq!(desk.service.state(position).unwrap().0, AlStatus::new(AlState::Init, false), "{position}");
    }
    desk.service.change_state(3, AlState::PreOperational).unwrap();
    let device = desk.at(3);
    let again = doctor::sections(&mut desk, Some("3")).unwrap();
    assert!(again[0].text().contains("none: by its SII it has no mailbox"), "{}", again[0].text());
    assert_eq!(desk.service.state(device.position).unwrap().0.state(), Some(AlState::PreOperational));
}

/// Objects are found one by one where the device does not list them, however it says so.
#[test]
#[cfg(target_os = "linux")]
fn objects_are_listed_or_asked_for_one_by_one() {
    use yieldwall_service::ObjectAccess;

    for kind in ["unanswered", "aborted", "mailbox_error"] {
        let mut desk = odd(&[&format!(r#"{{"position": 0, "sdo_information": "{kind}", "mailbox_counter": 1}}"#)]);
        let device = desk.device("left").unwrap();
        assert_eq!(desk.objects(&device).unwrap().indices(), Ok(None), "{kind}");
    }
    // The SII says it before anything is asked.
    let mut desk = odd(&[]);
    let device = desk.device("left").unwrap();
    assert!(desk.objects(&device).unwrap().indices().unwrap().is_some());
    let mut image = yieldwall_fieldbus::ethercat::sii::Sii::read(&desk.service.sii_image(0).unwrap()).unwrap();
    image.coe_details = yieldwall_fieldbus::ethercat::sii::coe_details::SDO;
    let digits: String = image.write().iter().map(|byte| format!("{byte:02x}")).collect();
    let mut desk = odd(&[&format!(r#"{{"position": 0, "sii": "{digits}"}}"#)]);
    assert_eq!(desk.objects(&device).unwrap().indices(), Ok(None));
    // A device that does not answer at all has no list, and nothing is asked for a minute.
    let mut silent = self::desk(|segment| segment.controller_mut(0).unwrap().set_mailbox_stuck(true));
    assert_eq!(silent.objects(&device).unwrap().indices(), Err(Error::NoAnswer));
}

/// An image is written if it fits the chip and is of the device; what the chip holds behind its own image is read as well.
#[test]
fn an_image_that_the_chip_has_no_room_for_is_refused() {
    let mut desk = desk(|segment| segment.controller_mut(1).unwrap().sii_mut().fill(0xff));
    for (position, empty) in [(0, false), (1, true)] {
        let held = desk.service.sii_image(position).unwrap();
        assert_eq!(yieldwall_fieldbus::ethercat::sii::Sii::read(&held).is_err(), empty);
        assert_eq!(desk.service.chip_size(position, &held).unwrap(), Some(1024), "by its controller");
        assert_eq!(desk.service.sii_up_to(position, 1024).unwrap().len(), 2048);
        let device = desk.at(position);
        let file = std::path::Path::new("image.sii");
        super::super::sii::refuse_too_long(&mut desk, &device, &[0; 2048], file).unwrap();
        let failure = super::super::sii::refuse_too_long(&mut desk, &device, &[0; 2050], file).unwrap_err();
        let message = &failure.report.diagnostics[0].message;
        assert!(
            message.contains("the image has 2050 bytes, and the memory chip 2048; nothing was written"),
            "{message}"
        );
    }
}

/// Parameters, a mapping and the assignment of a sync manager are put back, in an order that the device takes.
#[test]
fn a_device_is_put_back_to_the_values_of_a_file() {
    use yieldwall_drives::eds::Eds;
    use yieldwall_fieldbus::objects::Address;
    use yieldwall_service::{Plan, WriteOutcome, carry_out, inventory_of, plan};

    let mut reached = reached("left", |_| ());
    let mut objects = reached.objects().unwrap();
    let (before, _) = inventory_of(&mut *objects, 0, Eds::default(), |_| {}).unwrap();
    assert_eq!(plan(&mut *objects, 0, &before, None), Ok(Plan::default()));
    let mut count = objects.read(Address::new(0x1a00, 0)).unwrap();
    count[0] -= 1;
    for (index, sub, value) in
        [(0x6072, 0, &[0x84, 3][..]), (0x1c13, 0, &[0]), (0x1a00, 0, &count), (0x1c13, 0, &[1]), (0x1c12, 0, &[0])]
    {
        objects.write(Address::new(index, sub), value).unwrap();
    }
    let plan_of = |objects: &mut dyn yieldwall_service::ObjectAccess| plan(objects, 0, &before, None).unwrap();
    let back = plan_of(&mut *objects);
    assert_eq!(back.left_out, []);
    let order: Vec<_> = back.steps.iter().map(|step| (step.at.index, step.at.sub, step.new[0])).collect();
    let count = count[0] + 1;
    let wanted = [
        (0x6072, 0, 0xe8),
        (0x1c12, 0, 0),
        (0x1c12, 0, 1),
        (0x1c13, 0, 0),
        (0x1a00, 0, 0),
        (0x1a00, 0, count),
        (0x1c13, 0, 1),
    ];
    assert_eq!(order, wanted);
    for step in &back.steps {
        assert_eq!(carry_out(&mut *objects, step), Ok(WriteOutcome::Written), "{step:?}");
    }
    assert_eq!(plan_of(&mut *objects), Plan::default());
}

#[test]
fn a_drive_in_fault_is_taken_out_of_it_by_its_objects() {
    use super::super::reached::DeviceHandle;
    use super::super::state::{reset_fault, statusword};

    let mut link = link();
    link.server_mut().inject(Injection::new(Kind::DriveFault, 0.01).on(Target::LeftDrive)).unwrap();
    let mut output = Output::new(true, false, false);
    let mut reached = DeviceHandle::on_segment(at(link), "left", &output).unwrap();
    reached.pause(std::time::Duration::from_millis(50)).unwrap();
    let word = statusword(&mut reached).unwrap();
    assert_eq!(word & 0x4f, 0x08, "{word:04x}: Fault");
    assert_eq!(reset_fault(true, &mut reached, word, &mut output).unwrap(), word);
    assert_eq!(statusword(&mut reached).unwrap(), word, "nothing was written");
    let after = reset_fault(false, &mut reached, word, &mut output).unwrap();
    assert_eq!(after & 0x4f, 0x40, "{after:04x}: Switch On Disabled");
}
