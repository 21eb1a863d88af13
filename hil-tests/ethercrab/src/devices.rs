//! Two drives and a force sensor on the simulated segment: their controllers, mailboxes, states and clocks are the project's own, and
//! what is behind them is as little as a master needs to see: the CiA 402 states, a position that follows its target, 278 bytes of
//! calibration.

use std::time::Duration;

use yieldwall::ethercat::SyncManager;
use yieldwall::ethercat::coe::CoeEmergency;
use yieldwall::ethercat::sii::{FmmuUse, MailboxArea, Pdo, PdoEntry, Sii, SyncManagerUse, coe_details, protocols};
use yieldwall::objects::{
    AbortCode, Access, Address, DataType, Handle, Mappable, Object, ObjectDictionary, Reset, ServedDevice,
};
use yieldwall::sim::ethercat::{Controller, ControllerSettings, EthercatApplication, Segment};
use yieldwall::time::Time;
use yieldwall_drives::cia402::{OptionCodes, State, StateMachine};

/// Bytes of each mailbox.
const MAILBOX: u16 = 128;
/// The code of the emergency when outputs stay away.
const OUTPUTS_LOST: u16 = 0x8250;

/// What a drive keeps beside its objects.
#[derive(Debug)]
struct Drive {
    machine: StateMachine,
    controlword: Handle<u16>,
    statusword: Handle<u16>,
    target: Handle<i32>,
    position: Handle<i32>,
    mode: Handle<i8>,
    mode_display: Handle<i8>,
    emergency: Option<CoeEmergency>,
}

/// A drive, or a device that only shows what it has.
#[derive(Debug)]
pub struct Device {
    od: ObjectDictionary,
    drive: Option<Drive>,
}

impl Device {
    fn drive(od: ObjectDictionary) -> Self {
        let drive = Drive {
            machine: StateMachine::new(OptionCodes::default()),
            controlword: od.handle(0x6040, 0).expect("6040h"),
            statusword: od.handle(0x6041, 0).expect("6041h"),
            target: od.handle(0x607a, 0).expect("607Ah"),
            position: od.handle(0x6064, 0).expect("6064h"),
            mode: od.handle(0x6060, 0).expect("6060h"),
            mode_display: od.handle(0x6061, 0).expect("6061h"),
            emergency: None,
        };
        Self { od, drive: Some(drive) }
    }
}

impl ServedDevice for Device {
    fn od(&self) -> &ObjectDictionary {
        &self.od
    }

    fn od_mut(&mut self) -> &mut ObjectDictionary {
        &mut self.od
    }

    fn before_read(&mut self, _: Address) -> Result<(), AbortCode> {
        self.refresh();
        Ok(())
    }

    fn outputs_applied(&mut self, _: Time, _: u8) {
        let Self { od, drive: Some(drive) } = self else { return };
        drive.machine.apply(od.get(drive.controlword));
        if drive.machine.state() == State::OperationEnabled && od.get(drive.mode) == 8 {
            let target = od.get(drive.target);
            od.set(drive.position, target);
        }
    }

    fn sample(&mut self, _: Time) {
        if let Some(drive) = &mut self.drive {
            drive.machine.standstill();
        }
        self.refresh();
    }

    fn reset(&mut self, _: Time, _: Reset) {
        if let Some(drive) = &mut self.drive {
            drive.machine = StateMachine::new(OptionCodes::default());
            drive.machine.initialise();
            drive.emergency = None;
        }
        self.refresh();
    }
}

impl EthercatApplication for Device {
    /// A drive that leaves OP while it is enabled has lost its master.
    fn set_operational(&mut self, _: Time, is_operational: bool) {
        let Some(drive) = self.drive.as_mut().filter(|_| !is_operational) else { return };
        if drive.machine.lose_connection().is_some() {
            drive.machine.standstill();
            drive.emergency = Some(CoeEmergency { code: OUTPUTS_LOST, register: 0x11, vendor: [0; 5] });
        }
        self.refresh();
    }

    fn refresh(&mut self) {
        let Self { od, drive: Some(drive) } = self else { return };
        od.set(drive.statusword, drive.machine.statusword() | 0x0200);
        let mode = od.get(drive.mode);
        od.set(drive.mode_display, mode);
    }

    fn take_emergency(&mut self) -> Option<CoeEmergency> {
        self.drive.as_mut()?.emergency.take()
    }
}

/// An object of process data: index, sub-index, bits.
type Entry = (u16, u8, u8);
const DRIVE_OUTPUTS: [Entry; 3] = [(0x6040, 0, 16), (0x607a, 0, 32), (0x6060, 0, 8)];
const DRIVE_INPUTS: [Entry; 3] = [(0x6041, 0, 16), (0x6064, 0, 32), (0x6061, 0, 8)];
const SENSOR_OUTPUTS: [Entry; 2] = [(0x7010, 1, 32), (0x7010, 2, 32)];
const SENSOR_INPUTS: [Entry; 8] = [
    (0x6000, 1, 32),
    (0x6000, 2, 32),
    (0x6000, 3, 32),
    (0x6000, 4, 32),
    (0x6000, 5, 32),
    (0x6000, 6, 32),
    (0x6010, 0, 32),
    (0x6020, 0, 32),
];

/// What a device is called and is.
struct Identity {
    name: &'static str,
    device_type: u32,
    vendor_id: u32,
    product_code: u32,
    serial: u32,
}

/// The objects that all devices have: identity, sync managers, process data.
fn common(identity: &Identity, outputs: &[Entry], inputs: &[Entry]) -> Vec<Object> {
    let fixed = |object: Object| object.access(Access::ReadOnly);
    let pdo = |index: u16, entries: &[Entry]| {
        let packed =
            entries.iter().map(|(index, sub, bits)| u32::from(*index) << 16 | u32::from(*sub) << 8 | u32::from(*bits));
        let entries: Vec<Object> = (1..).zip(packed).map(|(at, packed)| Object::new(index, at, packed)).collect();
        let count = Object::new(index, 0, entries.len() as u8);
        std::iter::once(count).chain(entries).collect::<Vec<_>>()
    };
    let mut objects = vec![
        fixed(Object::new(0x1000, 0, identity.device_type)),
        Object::text(0x1008, 0, identity.name),
        Object::highest_sub(0x1018, 4),
        fixed(Object::new(0x1018, 1, identity.vendor_id)),
        fixed(Object::new(0x1018, 2, identity.product_code)),
        fixed(Object::new(0x1018, 3, 1u32)),
        fixed(Object::new(0x1018, 4, identity.serial)),
        Object::highest_sub(0x1c00, 4),
        Object::new(0x1c12, 0, 1u8),
        Object::new(0x1c12, 1, 0x1600u16),
        Object::new(0x1c13, 0, 1u8),
        Object::new(0x1c13, 1, 0x1a00u16),
    ];
    objects.extend((1..=4).map(|kind| fixed(Object::new(0x1c00, kind, kind))));
    objects.extend(pdo(0x1600, outputs));
    objects.extend(pdo(0x1a00, inputs));
    objects
}

/// What the SII of such a device says.
fn sii(identity: &Identity, outputs: &[Entry], inputs: &[Entry]) -> Vec<u8> {
    let bytes = |entries: &[Entry]| (entries.iter().map(|entry| u32::from(entry.2)).sum::<u32>() / 8) as u16;
    let manager = |kind, start, len, control| {
        let settings = SyncManager { start, len, control, is_enabled: true, repeat: false };
        SyncManagerUse { settings, kind }
    };
    let pdo = |index, sync_manager, name: &str, entries: &[Entry]| {
        let entry =
            |(index, sub, bits): &Entry| PdoEntry { index: *index, sub: *sub, bits: *bits, ..PdoEntry::default() };
        Pdo { index, sync_manager, name: name.to_owned(), entries: entries.iter().map(entry).collect() }
    };
    let image = Sii {
        vendor_id: identity.vendor_id,
        product_code: identity.product_code,
        revision: 1,
        serial: identity.serial,
        receive_mailbox: MailboxArea { start: 0x1000, len: MAILBOX },
        send_mailbox: MailboxArea { start: 0x1400, len: MAILBOX },
        protocols: protocols::COE,
        order: identity.name.to_owned(),
        name: identity.name.to_owned(),
        coe_details: coe_details::SDO
            | coe_details::INFORMATION
            | coe_details::PDO_ASSIGN
            | coe_details::COMPLETE_ACCESS,
        fmmus: vec![FmmuUse::OUTPUTS, FmmuUse::INPUTS, FmmuUse::MAILBOX_STATE],
        sync_managers: vec![
            manager(1, 0x1000, MAILBOX, 0x26),
            manager(2, 0x1400, MAILBOX, 0x22),
            manager(3, 0x1800, bytes(outputs), 0x64),
            manager(4, 0x1c00, bytes(inputs), 0x20),
        ],
        rx_pdos: vec![pdo(0x1600, 2, "outputs", outputs)],
        tx_pdos: vec![pdo(0x1a00, 3, "inputs", inputs)],
        ..Sii::default()
    };
    image.write()
}

fn servo(serial: u32, drift_ppb: i32) -> Controller<Device> {
    let identity =
        Identity { name: "servo", device_type: 0x0002_0192, vendor_id: 0x0000_5957, product_code: 0x0000_0402, serial };
    let commanded = |object: Object| object.mappable(Mappable::Rpdo);
    let shown = |object: Object| object.access(Access::ReadOnly).mappable(Mappable::Tpdo);
    let od = ObjectDictionary::builder().objects(common(&identity, &DRIVE_OUTPUTS, &DRIVE_INPUTS)).objects([
        commanded(Object::new(0x6040, 0, 0u16)),
        shown(Object::new(0x6041, 0, 0u16)),
        commanded(Object::new(0x6060, 0, 0i8)),
        shown(Object::new(0x6061, 0, 0i8)),
        shown(Object::new(0x6064, 0, 1000i32)),
        commanded(Object::new(0x607a, 0, 0i32)),
        Object::new(0x6085, 0, 100_000u32),
    ]);
    let device = Device::drive(od.build().expect("no object twice"));
    let settings = ControllerSettings {
        drift_ppb,
        clock_start_ns: i64::from(serial) * 1_234_567_891,
        ..ControllerSettings::new(sii(&identity, &DRIVE_OUTPUTS, &DRIVE_INPUTS))
    };
    Controller::new(device, settings)
}

/// 278 bytes: serial number, part, family, date, 36 numbers, units, greatest counts, counts per N and N m, the rest zero.
fn calibration() -> Vec<u8> {
    let mut bytes = Vec::new();
    bytes.extend(b"FT00001\0");
    bytes.resize(8 + 30 + 8 + 30 + 4 * 36, 0);
    bytes.extend([2, 3]);
    bytes.extend([0x7fff_ffff_i32; 6].iter().flat_map(|counts| counts.to_le_bytes()));
    bytes.extend(1_000_000_i32.to_le_bytes());
    bytes.extend(1_000_000_i32.to_le_bytes());
    bytes.resize(278, 0x55);
    bytes
}

fn sensor() -> Controller<Device> {
    let identity =
        Identity { name: "force sensor", device_type: 0, vendor_id: 0x0000_0732, product_code: 0x2648_3052, serial: 3 };
    let shown = |object: Object| object.access(Access::ReadOnly).mappable(Mappable::Tpdo);
    let bytes = calibration();
    let od = ObjectDictionary::builder()
        .objects(common(&identity, &SENSOR_OUTPUTS, &SENSOR_INPUTS))
        .highest_sub(0x6000, 6)
        .objects((1..=6).map(|axis| shown(Object::new(0x6000, axis, -i32::from(axis)))))
        .objects([shown(Object::new(0x6010, 0, 0u32)), shown(Object::new(0x6020, 0, 0u32))])
        .highest_sub(0x7010, 2)
        .objects((1..=2).map(|word| Object::new(0x7010, word, 0u32).mappable(Mappable::Rpdo)))
        .highest_sub(0x2040, 1)
        .object(Object::bytes(0x2040, 1, DataType::OctetString, &bytes, bytes.len()).access(Access::ReadOnly));
    let device = Device { od: od.build().expect("no object twice"), drive: None };
    let settings = ControllerSettings {
        mailbox_time: Duration::from_micros(200),
        ..ControllerSettings::new(sii(&identity, &SENSOR_OUTPUTS, &SENSOR_INPUTS))
    };
    Controller::new(device, settings)
}

/// Two drives whose clocks differ, and a sensor that takes its time for a mailbox.
pub fn segment(now: Time) -> Segment<Device> {
    Segment::new(now, [servo(1, 20_000), servo(2, -35_000), sensor()])
}
