//! Against the simulated devices of the shipped rigs.

use std::cell::RefCell;
use std::ops::Range;
use std::rc::Rc;

use super::*;
use crate::{AnySegmentService, AnyService, ConnectError, SegmentService, Service};
use yieldwall_config as config;
use yieldwall_fieldbus::canopen::{BusId, Frame};
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{Arrival, CanLink, EthernetArrival, EthernetLink, SendError};
use yieldwall_rig::live::{VirtualLink, VirtualSegment};

/// One link for several connections, one after the other.
struct Shared<L>(Rc<RefCell<L>>);

impl<L: CanLink> CanLink for Shared<L> {
    fn now(&self) -> Time {
        self.0.borrow().now()
    }

    fn receive(&mut self) -> Option<Arrival> {
        self.0.borrow_mut().receive()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        self.0.borrow_mut().send(frame)
    }

    fn wait(&mut self, until: Time) -> bool {
        self.0.borrow_mut().wait(until)
    }
}

impl<L: EthernetLink> EthernetLink for Shared<L> {
    fn now(&self) -> Time {
        self.0.borrow().now()
    }

    fn source(&self) -> [u8; 6] {
        self.0.borrow().source()
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Option<EthernetArrival> {
        self.0.borrow_mut().receive(buffer)
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), SendError> {
        self.0.borrow_mut().send(bytes)
    }

    fn wait(&mut self, until: Time) -> bool {
        self.0.borrow_mut().wait(until)
    }
}

/// The devices of a rig in place of interfaces.
enum Simulated {
    Can(Rc<RefCell<VirtualLink>>),
    Segment(Rc<RefCell<VirtualSegment>>),
}

impl Simulated {
    fn on_can() -> Self {
        let rig = config::load_rig(config::builtin("paper-admittance.yaml")).unwrap();
        let scene = rig.scene().unwrap().value;
        Self::Can(Rc::new(RefCell::new(VirtualLink::new(&rig.value, &scene, 1).unwrap())))
    }

    fn on_ethercat() -> Self {
        let rig = config::load_rig(config::builtin("paper-ethercat.yaml")).unwrap();
        let scene = rig.scene().unwrap().value;
        Self::Segment(Rc::new(RefCell::new(VirtualSegment::new(&rig.value, &scene, 1).unwrap())))
    }

    /// Its interface.
    fn interfaces(&self) -> [BusInterface; 1] {
        [BusInterface { name: "bus0".to_owned(), is_on_ethercat: matches!(self, Self::Segment(_)) }]
    }

    /// Reads or writes objects of the first drive.
    fn objects<T>(&mut self, act: impl FnOnce(&mut dyn crate::ObjectAccess) -> T) -> T {
        let is_over = Arc::default();
        match self {
            Self::Can(_) => {
                let node = yieldwall_fieldbus::canopen::node_id(1).unwrap();
                act(&mut self.can("bus0", &is_over).unwrap().objects(node))
            }
            Self::Segment(_) => act(&mut self.segment("bus0", &is_over).unwrap().objects(0).unwrap()),
        }
    }

    fn torque(&mut self) -> u32 {
        self.objects(|objects| number(&objects.read(TORQUE).unwrap()))
    }

    fn set_torque(&mut self, thousandths: u16) {
        self.objects(|objects| objects.write(TORQUE, &thousandths.to_le_bytes()).unwrap());
    }
}

impl Connect for Simulated {
    fn can(&mut self, _: &str, is_over: &Arc<AtomicBool>) -> Result<AnyService, ConnectError> {
        let Self::Can(link) = self else { return Err(ConnectError::NotCan { interface: "bus0".to_owned() }) };
        let link: Box<dyn CanLink> = Box::new(Shared(Rc::clone(link)));
        Ok(Service::new(link, BusId::FIRST, Arc::clone(is_over)))
    }

    fn segment(&mut self, _: &str, is_over: &Arc<AtomicBool>) -> Result<AnySegmentService, ConnectError> {
        let Self::Segment(link) = self else { return Err(ConnectError::Unusable("no segment".into())) };
        let link: Box<dyn EthernetLink> = Box::new(Shared(Rc::clone(link)));
        Ok(SegmentService::new(link, Arc::clone(is_over)))
    }
}

/// Greatest torque of a drive in thousandths of its rated torque.
const TORQUE: Address = Address::new(0x6072, 0);

/// The objects of the devices with these numbers; no device has the second one.
fn written(numbers: Range<u16>) -> Vec<Written> {
    let objects = vec![TORQUE, Address::new(0x5fff, 0)];
    let of_device =
        |number| Written { bus: BusId::FIRST, number, name: format!("drive {number}"), objects: objects.clone() };
    numbers.map(of_device).collect()
}

/// A folder that goes in the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("yieldwall-journals-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        Self(folder)
    }

    fn journals(&self) -> Journals {
        Journals { folder: Some(self.0.clone()), command: "jog".to_owned(), now_unix_s: 7 }
    }

    /// Number of open journals.
    fn count(&self) -> usize {
        fs::read_dir(&self.0).map_or(0, Iterator::count)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn begin(journals: &Journals, devices: &mut Simulated, numbers: Range<u16>) -> Result<Journal, JournalError> {
    journals.begin(&written(numbers), &devices.interfaces(), devices, &Arc::default())
}

/// A journal of nothing on `bus0`.
fn empty() -> Kept {
    Kept {
        command: "jog".to_owned(),
        process: 1,
        process_began: Some(2),
        begun_unix_s: 3,
        version: "0".to_owned(),
        devices: vec![KeptDevice {
            name: "left".to_owned(),
            interface: "bus0".to_owned(),
            is_on_ethercat: false,
            number: 1,
            identity: [None; 3],
            objects: Vec::new(),
            unreadable: Vec::new(),
        }],
    }
}

#[test]
fn devices_get_back_what_they_held_on_either_bus() {
    for (mut devices, numbers) in [(Simulated::on_can(), 1..3), (Simulated::on_ethercat(), 0..2)] {
        let folder = Folder::new(if numbers.start == 1 { "can" } else { "ethercat" });
        let held = devices.torque();
        let journal = begin(&folder.journals(), &mut devices, numbers.clone()).unwrap();
        assert_eq!(folder.count(), 1);
        devices.set_torque(123);
        let restored = journal.restore(&mut devices);
        restored.end.unwrap();
        // The other drive was not changed, and an object that no device has cannot be restored.
        let first = format!("drive {}", numbers.start);
        assert_eq!(restored.devices, [(first, 1)]);
        assert_eq!((restored.unreadable.len(), restored.unreadable[0].1), (2, Address::new(0x5fff, 0)));
        assert_eq!((devices.torque(), folder.count()), (held, 0));
    }
}

#[test]
fn the_journal_of_a_killed_process_refuses_its_interfaces_alone_until_the_devices_are_restored() {
    let (folder, mut devices) = (Folder::new("killed"), Simulated::on_can());
    let journals = folder.journals();
    let held = devices.torque();
    // A killed process restores nothing.
    drop(begin(&journals, &mut devices, 1..3).unwrap());
    devices.set_torque(123);
    let refused = journals.refuse_left(&["bus0".to_owned()]).unwrap_err();
    let JournalError::Left(left) = refused else { panic!("{refused}") };
    let says = left.to_string();
    assert!(says.starts_with("a `yieldwall jog` that did not come to its end has left its journal, "), "{says}");
    assert!(says.ends_with("(drive 1 1 objects, drive 2 1 objects)"), "{says}");
    journals.refuse_left(&["bus1".to_owned()]).unwrap();
    left.restore(&mut devices).end.unwrap();
    journals.refuse_left(&["bus0".to_owned()]).unwrap();
    assert_eq!(devices.torque(), held);
}

#[cfg(target_os = "linux")]
#[test]
fn a_process_that_is_at_work_is_named_and_its_journal_is_left_alone() {
    let folder = Folder::new("at-work");
    let parent = std::os::unix::process::parent_id();
    let kept = Kept { process: parent, process_began: began(parent), ..empty() };
    store(&folder.0.join("1-1.json"), &kept).unwrap();
    let error = folder.journals().left_on(&["bus0".to_owned()]).unwrap_err();
    assert!(matches!(error, JournalError::AtWork { process, .. } if process == parent), "{error}");
}

#[test]
fn a_journal_that_cannot_be_written_begins_nothing() {
    let (folder, mut devices) = (Folder::new("unwritable"), Simulated::on_can());
    fs::create_dir(&folder.0).unwrap();
    let file = folder.0.join("file");
    fs::write(&file, "").unwrap();
    let journals = Journals { folder: Some(file), ..folder.journals() };
    let error = begin(&journals, &mut devices, 1..3).unwrap_err();
    assert!(matches!(error, JournalError::NotKept { .. }), "{error}");
    assert!(error.to_string().ends_with("nothing was written to the devices"), "{error}");
    let error = begin(&Journals { folder: None, ..journals }, &mut devices, 1..3).unwrap_err();
    assert!(matches!(error, JournalError::NoFolder), "{error}");
}

#[test]
fn a_device_that_does_not_answer_keeps_a_journal_from_beginning() {
    let (folder, mut devices) = (Folder::new("silent"), Simulated::on_can());
    let error = begin(&folder.journals(), &mut devices, 99..100).unwrap_err();
    assert_eq!(error.to_string(), "node 99: reading its objects: no answer");
    let (mut devices, journals) = (Simulated::on_ethercat(), folder.journals());
    let error = begin(&journals, &mut devices, 9..10).unwrap_err();
    assert!(matches!(error, JournalError::Device(DeviceError::Missing { .. })), "{error}");
    assert_eq!(folder.count(), 0);
}

#[test]
fn another_device_in_the_place_of_one_gets_nothing() {
    let (folder, mut devices) = (Folder::new("other"), Simulated::on_can());
    let mut journal = begin(&folder.journals(), &mut devices, 1..3).unwrap();
    devices.set_torque(123);
    journal.kept.devices[0].identity[2] = Some(4711);
    let restored = journal.restore(&mut devices);
    assert_eq!((restored.devices, devices.torque()), (Vec::new(), 123));
    let error = restored.end.unwrap_err();
    let says =
        "not all is as it was before `yieldwall jog`: drive 1: nothing could be given back: another device answers now";
    assert_eq!(error.to_string(), says);
    assert_eq!(folder.count(), 1, "the journal stays open");
}

#[test]
fn a_process_is_told_by_its_number_and_its_begin() {
    let status = "4711 (a) b (c) S 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 4242 20 21";
    assert_eq!(began_in(status), Some(4242));
    assert_eq!(began_in("4711 (x) S 1"), None);
}

#[test]
fn a_journal_that_cannot_be_read_is_named() {
    let folder = Folder::new("unreadable");
    assert_eq!(all(&folder.0).unwrap().len(), 0);
    let kept = empty();
    store(&folder.0.join("1-1.json"), &kept).unwrap();
    let journals = all(&folder.0).unwrap();
    assert_eq!((journals.len(), &journals[0].kept), (1, &kept));
    #[cfg(all(feature = "socketcan", target_os = "linux"))]
    {
        crate::sample::let_others_write(&folder.0.join("1-1.json"));
        let error = all(&folder.0).unwrap_err().to_string();
        assert!(error.contains("`chmod go-w "), "{error}");
        store(&folder.0.join("1-1.json"), &kept).unwrap();
    }
    fs::write(folder.0.join("2-1.json"), "{").unwrap();
    let error = folder.journals().refuse_left(&["bus9".to_owned()]).unwrap_err().to_string();
    assert!(error.contains("2-1.json") && error.contains("it may be of devices that are to be restored"), "{error}");
}
