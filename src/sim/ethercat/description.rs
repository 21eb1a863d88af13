//! Self-description of a device: communication objects, and the SII image and device description made from them.
//!
//! Both are made from the dictionary, so that the three agree by making.

use super::process_data::{Flow, entry};
use yieldwall_drives::esi;
use yieldwall_fieldbus::ethercat::sii::{
    FmmuUse, MailboxArea, Pdo, PdoEntry, PortUse, Sii, SyncManagerUse, coe_details, protocols,
};
use yieldwall_fieldbus::ethercat::{SyncManager, registers};
use yieldwall_fieldbus::objects::{Access, Address, DataType, DeviceIdentity, Object, ObjectDictionary};

/// Where the mailboxes lie, and how long they are.
const RECEIVE_MAILBOX: MailboxArea = MailboxArea { start: 0x1000, len: 128 };
const SEND_MAILBOX: MailboxArea = MailboxArea { start: 0x1400, len: 128 };
/// Where outputs and inputs lie, three buffers each.
const OUTPUTS_START: u16 = 0x1800;
const INPUTS_START: u16 = 0x1c00;

/// A mapping object at power-on.
#[derive(Clone, Debug)]
pub(crate) struct PdoMapping {
    /// 1600h to 17FFh for outputs, 1A00h to 1BFFh for inputs.
    pub(crate) index: u16,
    /// Index, sub-index and bits of each entry.
    pub(crate) entries: Vec<(u16, u8, u8)>,
    pub(crate) is_fixed: bool,
    /// Whether it is exchanged.
    pub(crate) is_assigned: bool,
}

/// The communication objects of a device.
#[derive(Clone, Debug)]
pub(crate) struct Communication<'a> {
    pub(crate) identity: &'a DeviceIdentity,
    pub(crate) outputs: Vec<PdoMapping>,
    pub(crate) inputs: Vec<PdoMapping>,
    /// Entries that a mapping may have which can be changed.
    pub(crate) mapping_entries: u8,
    /// Shortest cycle that the device works with, in ns.
    pub(crate) shortest_cycle_ns: u32,
}

impl Communication<'_> {
    /// 1000h to 1FFFh.
    pub(crate) fn objects(&self) -> Vec<Object> {
        let mut objects = self.identity.objects().to_vec();
        let fixed = |index, sub, value: u8, name| Object::new(index, sub, value).access(Access::ReadOnly).named(name);
        objects.push(fixed(0x1001, 0, 0, "Error register"));
        objects.push(Object::highest_sub(0x10f1, 2).named("Error settings"));
        objects.push(Object::new(0x10f1, 1, 1u32).named("Local error reaction"));
        objects.push(Object::new(0x10f1, 2, 0u16).named("Sync error counter limit"));
        objects.push(Object::highest_sub(0x1c00, 4).named("Sync manager types"));
        objects.extend((1..=4).map(|kind| fixed(0x1c00, kind, kind, "Sync manager type")));
        for (flow, mappings, name) in
            [(Flow::Outputs, &self.outputs, "Outputs"), (Flow::Inputs, &self.inputs, "Inputs")]
        {
            objects.extend(mappings.iter().flat_map(|mapping| self.mapping(mapping, name)));
            let assigned: Vec<u16> =
                mappings.iter().filter(|mapping| mapping.is_assigned).map(|mapping| mapping.index).collect();
            let most = mappings.len().max(1) as u8;
            objects.push(Object::new(flow.assignment(), 0, assigned.len() as u8).limits(0u8, most).named(name));
            let places = assigned.into_iter().chain(std::iter::repeat(0)).zip(1..=most);
            objects.extend(places.map(|(index, sub)| Object::new(flow.assignment(), sub, index).named("PDO")));
        }
        for (index, name) in [(0x1c32, "Synchronisation of outputs"), (0x1c33, "Synchronisation of inputs")] {
            let shown = |sub, value: u32, name| Object::new(index, sub, value).access(Access::ReadOnly).named(name);
            objects.push(Object::highest_sub(index, 12).named(name));
            // 2 with SYNC0; outputs on arrival all the same with 1, which a master has to write.
            objects.push(Object::new(index, 1, 0u16).named("Synchronisation type"));
            objects.push(Object::new(index, 2, 0u32).named("Cycle time"));
            objects.push(shown(3, 0, "Shift time"));
            // Bit 0 as frames come, bit 1 with outputs, bit 2 with SYNC0.
            let types = Object::new(index, 4, 0x0007u16).access(Access::ReadOnly);
            objects.push(types.named("Supported types"));
            objects.push(shown(5, self.shortest_cycle_ns, "Minimum cycle time"));
            objects.push(shown(6, 0, "Calculation and copy time"));
            objects.push(shown(9, 0, "Delay time"));
            for (sub, name) in [(11, "Missed outputs"), (12, "Cycle exceeded")] {
                objects.push(Object::new(index, sub, 0u16).access(Access::ReadOnly).named(name));
            }
        }
        objects
    }

    fn mapping(&self, mapping: &PdoMapping, name: &'static str) -> Vec<Object> {
        let PdoMapping { index, entries: mapped, is_fixed, .. } = mapping;
        let (index, count) = (*index, mapped.len() as u8);
        let most = if *is_fixed { count } else { self.mapping_entries.max(count) };
        let rights = |object: Object| if *is_fixed { object.access(Access::ReadOnly) } else { object };
        let counted = Object::new(index, 0, count).limits(0, most).named(name);
        let raw = |(index, sub, bits): (u16, u8, u8)| u32::from(index) << 16 | u32::from(sub) << 8 | u32::from(bits);
        let all = mapped.iter().copied().map(raw).chain(std::iter::repeat(0)).zip(1..=most);
        let all = all.map(|(raw, sub)| rights(Object::new(index, sub, raw)).named("Mapped object"));
        std::iter::once(rights(counted)).chain(all).collect()
    }
}

/// Returns the displayed name of an object: its own, or the name of its record.
fn name(od: &ObjectDictionary, at: Address) -> String {
    let named = |at| od.describe(at).ok().map(|object| object.name).filter(|name| !name.is_empty());
    named(at).or_else(|| named(Address::new(at.index, 0))).unwrap_or_default().to_owned()
}

fn pdos(od: &ObjectDictionary, flow: Flow, sync_manager: u8) -> Vec<Pdo> {
    let assigned = (1..=od.raw(flow.assignment(), 0) as u8).map(|sub| od.raw(flow.assignment(), sub) as u16);
    let entries = |index: u16| {
        (1..=od.raw(index, 0) as u8).map(move |sub| {
            let (at, bits) = entry(od.raw(index, sub) as u32);
            let data_type = od.data_type(at).map_or(0, |data_type| data_type as u8);
            PdoEntry { index: at.index, sub: at.sub, name: name(od, at), data_type, bits }
        })
    };
    assigned
        .filter(|index| flow.has_mapping(*index))
        .map(|index| Pdo {
            index,
            sync_manager,
            name: name(od, Address::new(index, 0)),
            entries: entries(index).collect(),
        })
        .collect()
}

/// The SII of a device with this dictionary.
pub fn sii(od: &ObjectDictionary) -> Sii {
    let number = |sub| od.raw(0x1018, sub) as u32;
    let text = od.bytes(Address::new(0x1008, 0)).unwrap_or_default();
    let text: String = text.iter().map(|byte| char::from(*byte)).collect();
    let (rx_pdos, tx_pdos) = (pdos(od, Flow::Outputs, 2), pdos(od, Flow::Inputs, 3));
    let bytes = |pdos: &[Pdo]| {
        let bits = pdos.iter().flat_map(|pdo| &pdo.entries).map(|entry| usize::from(entry.bits)).sum::<usize>();
        bits.div_ceil(8) as u16
    };
    let manager = |start, len, control, kind| SyncManagerUse {
        settings: SyncManager { start, len, control, is_enabled: len > 0, repeat: false },
        kind,
    };
    let (mailbox, outputs) =
        (SyncManager::MAILBOX | SyncManager::INTERRUPT, SyncManager::WRITE | SyncManager::INTERRUPT);
    Sii {
        // An asynchronous microcontroller interface; SYNC0 and SYNC1 are outputs, 10 us long.
        pdi: [0x0c08, 0xee00, 1000, 0],
        alias: 0,
        vendor_id: number(1),
        product_code: number(2),
        revision: number(3),
        serial: number(4),
        receive_mailbox: RECEIVE_MAILBOX,
        send_mailbox: SEND_MAILBOX,
        protocols: protocols::COE,
        group: "yieldwall simulation".to_owned(),
        order: text.clone(),
        name: text,
        coe_details: coe_details::SDO
            | coe_details::INFORMATION
            | coe_details::PDO_ASSIGN
            | coe_details::PDO_CONFIGURATION
            | coe_details::COMPLETE_ACCESS,
        e_bus_ma: 0,
        ports: [PortUse::MII, PortUse::MII, PortUse::UNUSED, PortUse::UNUSED],
        fmmus: vec![FmmuUse::OUTPUTS, FmmuUse::INPUTS, FmmuUse::MAILBOX_STATE],
        sync_managers: vec![
            manager(RECEIVE_MAILBOX.start, RECEIVE_MAILBOX.len, mailbox | SyncManager::WRITE, 1),
            manager(SEND_MAILBOX.start, SEND_MAILBOX.len, mailbox, 2),
            manager(OUTPUTS_START, bytes(&rx_pdos), outputs | SyncManager::WATCHDOG, 3),
            manager(INPUTS_START, bytes(&tx_pdos), SyncManager::INTERRUPT, 4),
        ],
        tx_pdos,
        rx_pdos,
        ..Sii::default()
    }
}

/// The device description (ESI) of a device with this dictionary, of a vendor with this name.
pub fn esi(od: &ObjectDictionary, vendor: &str) -> esi::Esi {
    let sii = sii(od);
    let pdos = |pdos: &[Pdo]| {
        let entry = |entry: &PdoEntry| esi::PdoEntry {
            index: entry.index,
            sub: entry.sub,
            bits: entry.bits.into(),
            name: entry.name.clone(),
            data_type: type_name(od.data_type(Address::new(entry.index, entry.sub))).to_owned(),
            depends_on_slot: false,
        };
        let pdo = |pdo: &Pdo| esi::Pdo {
            index: pdo.index,
            name: pdo.name.clone(),
            sync_manager: Some(pdo.sync_manager),
            is_fixed: od.check_writable(Address::new(pdo.index, 0)).is_err(),
            is_mandatory: false,
            depends_on_slot: false,
            excludes: Vec::new(),
            entries: pdo.entries.iter().map(entry).collect(),
        };
        pdos.iter().map(pdo).collect()
    };
    let kinds = ["MBoxOut", "MBoxIn", "Outputs", "Inputs"];
    let manager = |(manager, kind): (&SyncManagerUse, &str)| esi::SyncManager {
        kind: kind.to_owned(),
        start: manager.settings.start,
        control: manager.settings.control,
        default_size: Some(manager.settings.len),
        min_size: None,
        max_size: None,
        is_enabled: manager.settings.is_enabled,
    };
    let profile = od.raw(0x1000, 0) as u16;
    let mode = |name: &str, assign_activate| esi::OpMode {
        name: name.to_owned(),
        assign_activate,
        sync0_factor: 1,
        ..esi::OpMode::default()
    };
    let device = esi::Device {
        physics: "YY".to_owned(),
        type_name: sii.order.clone(),
        product_code: sii.product_code,
        revision: sii.revision,
        name: sii.name.clone(),
        group: sii.group.clone(),
        profile: (profile != 0).then_some(profile.into()),
        fmmus: ["Outputs", "Inputs", "MBoxState"].map(str::to_owned).to_vec(),
        sync_managers: sii.sync_managers.iter().zip(kinds).map(manager).collect(),
        rx_pdos: pdos(&sii.rx_pdos),
        tx_pdos: pdos(&sii.tx_pdos),
        coe: Some(esi::Coe {
            information: true,
            pdo_assign: true,
            pdo_configuration: true,
            complete_access: true,
            segmented: true,
        }),
        op_modes: vec![mode("Synchron", 0), mode("DC", 0x0300)],
        mailbox_response_ms: Some(2000),
        pre_op_ms: Some(3000),
        safe_op_ms: Some(10_000),
        config_data: sii.pdi.iter().flat_map(|word| word.to_le_bytes()).map(|byte| format!("{byte:02X}")).collect(),
        eeprom_bytes: Some(2048.max(sii.write().len().next_power_of_two() as u32)),
        ..esi::Device::default()
    };
    esi::Esi { vendor_id: sii.vendor_id, vendor: vendor.to_owned(), devices: vec![device], modules: Vec::new() }
}

/// The name of a type in a device description.
fn type_name(data_type: Option<DataType>) -> &'static str {
    use DataType::*;
    match data_type {
        Some(Boolean) => "BOOL",
        Some(Integer8) => "SINT",
        Some(Integer16) => "INT",
        Some(Integer32) => "DINT",
        Some(Integer64) => "LINT",
        Some(Unsigned8) => "USINT",
        Some(Unsigned16) => "UINT",
        Some(Unsigned32) => "UDINT",
        Some(Unsigned64) => "ULINT",
        Some(Real32) => "REAL",
        Some(Real64) => "LREAL",
        _ => "",
    }
}

const _: () = assert!(RECEIVE_MAILBOX.start >= registers::PROCESS_DATA);
