use super::*;
use proptest::prelude::*;

const DRIVE: &str = r##"<?xml version="1.0" encoding="utf-8"?>
<EtherCATInfo xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" Version="1.6">
  <Vendor><Id>#x00000732</Id><Name LcId="1033">A &amp; B</Name></Vendor>
  <Descriptions>
    <Groups><Group><Type>Drives</Type><Name>Drives</Name></Group></Groups>
    <Devices>
      <Device Physics="YY">
        <Type ProductCode="#x00000402" RevisionNo="1">S1</Type>
        <Name LcId="1031">Servoregler</Name>
        <Name LcId="1033"><![CDATA[Servo <drive>]]></Name>
        <Info>
          <StateMachine><Timeout><PreopTimeout>3000</PreopTimeout><SafeopOpTimeout>10000</SafeopOpTimeout></Timeout></StateMachine>
          <Mailbox><Timeout><RequestTimeout>100</RequestTimeout><ResponseTimeout>2000</ResponseTimeout></Timeout></Mailbox>
        </Info>
        <GroupType>Drives</GroupType>
        <Profile><ProfileNo>402</ProfileNo><AddInfo>2</AddInfo></Profile>
        <Fmmu>Outputs</Fmmu><Fmmu>Inputs</Fmmu><Fmmu>MBoxState</Fmmu>
        <Sm DefaultSize="128" MinSize="34" MaxSize="256" StartAddress="#x1000" ControlByte="#x26" Enable="1">MBoxOut</Sm>
        <Sm StartAddress="#x1800" ControlByte="#x64" Enable="#x01">Outputs</Sm>
        <RxPdo Fixed="true" Mandatory="0" Sm="2">
          <Index>#x1600</Index><Name>Outputs</Name><Exclude>#x1601</Exclude>
          <Entry><Index>#x6040</Index><SubIndex>0</SubIndex><BitLen>16</BitLen><Name>Controlword</Name><DataType>UINT</DataType></Entry>
          <Entry><Index>0</Index><BitLen>8</BitLen></Entry>
        </RxPdo>
        <TxPdo Sm="3"><Index>#x1A00</Index><Name>Inputs</Name></TxPdo>
        <Mailbox DataLinkLayer="true"><CoE SdoInfo="true" PdoAssign="1" CompleteAccess="0"/><FoE/></Mailbox>
        <Dc><OpMode><Name>DC</Name><AssignActivate>#x300</AssignActivate><CycleTimeSync0 Factor="1">0</CycleTimeSync0><ShiftTimeSync0>-250</ShiftTimeSync0></OpMode></Dc>
        <Eeprom><ByteSize>2048</ByteSize><ConfigData>080C</ConfigData>
          <Category><CatNo>2048</CatNo><Data>0a1B</Data></Category>
          <Category><CatNo>#x801</CatNo><DataString> a</DataString></Category>
          <Category><CatNo>2050</CatNo><DataUINT>258</DataUINT></Category>
          <Category><CatNo>2051</CatNo><DataUDINT>#x01020304</DataUDINT></Category>
        </Eeprom>
      </Device>
    </Devices>
  </Descriptions>
</EtherCATInfo>
"##;

fn expected() -> Esi {
    let text = str::to_owned;
    Esi {
        vendor_id: 0x732,
        vendor: text("A & B"),
        devices: vec![Device {
            physics: text("YY"),
            type_name: text("S1"),
            product_code: 0x402,
            revision: 1,
            name: text("Servo <drive>"),
            group: text("Drives"),
            profile: Some(402),
            fmmus: ["Outputs", "Inputs", "MBoxState"].map(text).to_vec(),
            sync_managers: vec![
                SyncManager {
                    kind: text("MBoxOut"),
                    start: 0x1000,
                    control: 0x26,
                    default_size: Some(128),
                    min_size: Some(34),
                    max_size: Some(256),
                    is_enabled: true,
                },
                SyncManager {
                    kind: text("Outputs"),
                    start: 0x1800,
                    control: 0x64,
                    is_enabled: true,
                    ..SyncManager::default()
                },
            ],
            rx_pdos: vec![Pdo {
                index: 0x1600,
                name: text("Outputs"),
                sync_manager: Some(2),
                is_fixed: true,
                excludes: vec![0x1601],
                entries: vec![
                    PdoEntry {
                        index: 0x6040,
                        sub: 0,
                        bits: 16,
                        name: text("Controlword"),
                        data_type: text("UINT"),
                        ..PdoEntry::default()
                    },
                    PdoEntry { bits: 8, ..PdoEntry::default() },
                ],
                ..Pdo::default()
            }],
            tx_pdos: vec![Pdo { index: 0x1a00, name: text("Inputs"), sync_manager: Some(3), ..Pdo::default() }],
            coe: Some(Coe { information: true, pdo_assign: true, ..Coe::default() }),
            op_modes: vec![OpMode {
                name: text("DC"),
                assign_activate: 0x300,
                sync0_cycle_ns: 0,
                sync0_factor: 1,
                sync0_shift_ns: -250,
                ..OpMode::default()
            }],
            mailbox_response_ms: Some(2000),
            pre_op_ms: Some(3000),
            safe_op_ms: Some(10_000),
            has_foe: true,
            eeprom_bytes: Some(2048),
            config_data: text("080C"),
            categories: vec![
                Category { number: 0x800, bytes: vec![0x0a, 0x1b] },
                Category { number: 0x801, bytes: b" a\0".to_vec() },
                Category { number: 0x802, bytes: vec![2, 1] },
                Category { number: 0x803, bytes: vec![4, 3, 2, 1] },
            ],
            ..Device::default()
        }],
        modules: Vec::new(),
    }
}

#[test]
fn a_drive_is_read_and_written() {
    assert_eq!(Esi::read(DRIVE.as_bytes()), Ok(expected()));
    assert_eq!(Esi::read(expected().write().as_bytes()), Ok(expected()));
}

#[test]
fn what_is_wrong_is_named_with_its_line() {
    let told = |text: &str| Esi::read(text.as_bytes()).unwrap_err().to_string();
    assert_eq!(told(""), "the file has no element EtherCATInfo: it is no device description");
    assert_eq!(told("<html></html>"), "the file has no element EtherCATInfo: it is no device description");
    let bad = DRIVE.replace("#x1600", "#x16000");
    assert_eq!(told(&bad), "line 21: Index of a PDO is `#x16000`, which is no number from 0 to 65535");
    let typed = DRIVE.replacen('\n', "\n<!DOCTYPE x [<!ENTITY a \"b\">]>\n", 1);
    assert_eq!(told(&typed), "line 2: a document type is refused: a device description needs none");
    let entity = DRIVE.replace("A &amp; B", "&bomb;");
    assert_eq!(told(&entity), "line 3: an entity of its own is refused: a device description needs none");
    let deep = format!("<EtherCATInfo>{}", "<a>".repeat(100));
    assert_eq!(told(&deep), "line 1: more than 64 elements within one another");
    let long = format!("<EtherCATInfo>{}</EtherCATInfo>", "x".repeat(MAX_TEXT + 1));
    assert_eq!(told(&long), "line 1: more than 65536 bytes of text in an element");
    let odd = DRIVE.replace("0a1B", "0a1");
    assert_eq!(told(&odd), "line 29: Data of a category is no even number of hexadecimal digits");
    let many = DRIVE.replace("<Eeprom>", &format!("<Eeprom>{}", "<Category/>".repeat(300)));
    assert_eq!(told(&many), "line 28: more than 256 categories for the SII of a device");
    let long = DRIVE.replace(" a</DataString>", &format!("{}</DataString>", "a".repeat(MAX_TEXT / 2)));
    assert_eq!(told(&long), "line 30: more than 32768 bytes of text in a category");
    assert!(told("<EtherCATInfo>").starts_with("line 1: this is no XML"));
    assert!(told("<EtherCATInfo></b>").starts_with("line 1: this is no XML"));
}

#[test]
fn old_files_are_latin_1() {
    let mut latin: Vec<u8> = DRIVE.replace("Servoregler", "x").replace("A &amp; B", "K?rber").into_bytes();
    let at = latin.windows(6).position(|part| part == b"K?rber").unwrap();
    latin[at + 1] = 0xf6;
    assert_eq!(Esi::read(&latin).unwrap().vendor, "K\u{f6}rber");
}

/// A drive of two axes: position modules in both slots by default, torque modules on request, and a third slot for an extension.
const MODULAR: &str = r##"<EtherCATInfo><Vendor><Id>1</Id></Vendor><Descriptions>
  <Devices><Device Physics="YY"><Type ProductCode="#x5001" RevisionNo="1">Two axes</Type>
    <RxPdo Sm="2" Fixed="1"><Index>#x16F0</Index><Name>Device</Name><Entry><Index>#x2FFF</Index><SubIndex>1</SubIndex><BitLen>8</BitLen></Entry></RxPdo>
    <RxPdo><Index>#x1610</Index><Name>Overwritten</Name></RxPdo>
    <Slots SlotIndexIncrement="#x800" SlotPdoIncrement="16">
      <Slot MinInstances="1" MaxInstances="1"><Name>Axis 1</Name>
        <ModuleIdent Default="1">#x100</ModuleIdent><ModuleIdent Default="0">#x200</ModuleIdent></Slot>
      <Slot MinInstances="1" MaxInstances="1"><Name>Axis 2</Name>
        <ModuleIdent Default="1">#x100</ModuleIdent><ModuleIdent>#x200</ModuleIdent></Slot>
      <Slot MinInstances="0" MaxInstances="2" SlotPdoIncrement="1"><Name>Extension</Name><ModuleClass><Class>io</Class></ModuleClass></Slot>
    </Slots>
  </Device></Devices>
  <Modules>
    <Module><Type ModuleIdent="#x100">Position</Type><Name LcId="1033">Position mode</Name>
      <RxPdo Sm="2"><Index DependOnSlot="1">#x1600</Index><Exclude>#x1601</Exclude><Name>Targets</Name>
        <Entry><Index DependOnSlot="true">#x6040</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry>
        <Entry><Index DependOnSlot="1">#x2100</Index><SubIndex>1</SubIndex><BitLen>32</BitLen></Entry>
        <Entry><Index>#x5FFE</Index><SubIndex>0</SubIndex><BitLen>8</BitLen></Entry>
        <Entry><Index>0</Index><BitLen>8</BitLen></Entry></RxPdo>
      <TxPdo Sm="3"><Index DependOnSlot="1">#x1A00</Index><Name>Actuals</Name>
        <Entry><Index DependOnSlot="1">#x6041</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry></TxPdo>
    </Module>
    <Module><Type ModuleIdent="#x200">Torque</Type><Name>Torque mode</Name>
      <RxPdo Sm="2"><Index DependOnSlot="1">#x1602</Index><Name>Torques</Name>
        <Entry><Index DependOnSlot="1">#x6071</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry></RxPdo>
    </Module>
    <Module><Type ModuleIdent="#x300" ModuleClass="io">Inputs</Type>
      <TxPdo><Index DependOnSlot="1">#x1AF0</Index><Name>Inputs</Name></TxPdo></Module>
  </Modules></Descriptions></EtherCATInfo>"##;

/// The PDOs of the device of a file with the modules of its slots: indices, then the objects of each.
fn resolved(text: &str, named: &[(u32, &str)]) -> Result<Vec<(u16, Vec<u16>)>, ModuleError> {
    let esi = Esi::read(text.as_bytes()).unwrap();
    let named = named.iter().map(|(place, word)| (*place, (*word).to_owned())).collect();
    let device = esi.devices[0].with_modules(&esi.plugged(&esi.devices[0], &named)?)?;
    let pdos = device.rx_pdos.iter().chain(&device.tx_pdos);
    Ok(pdos.map(|pdo| (pdo.index, pdo.entries.iter().map(|entry| entry.index).collect())).collect())
}

#[test]
fn the_default_modules_of_slots_have_their_process_data_further_on_in_each_slot() {
    let position = [
        (0x16f0, vec![0x2fff]),
        (0x1600, vec![0x6040, 0x2100, 0x5ffe, 0]),
        (0x1610, vec![0x6840, 0x2900, 0x5ffe, 0]),
        (0x1a00, vec![0x6041]),
        (0x1a10, vec![0x6841]),
    ];
    assert_eq!(resolved(MODULAR, &[]), Ok(position.to_vec()));
    // A word is a type, a name or a number; the extension has an increment of its own and lies in the third and fourth place.
    for torque in ["torque", "Torque mode", "#x200", "512"] {
        let pdos = resolved(MODULAR, &[(2, torque), (4, "Inputs")]).unwrap();
        assert_eq!(pdos[2..5], [(0x1600, position[1].1.clone()), (0x1612, vec![0x6871]), (0x1a00, vec![0x6041])]);
        assert_eq!(pdos[5..], [(0x1af3, vec![])]);
    }
    let esi = Esi::read(MODULAR.as_bytes()).unwrap();
    assert_eq!(Esi::read(esi.write().as_bytes()), Ok(esi.clone()));
    let plugged = esi.plugged(&esi.devices[0], &Default::default()).unwrap();
    let places: Vec<(u8, &str)> = plugged.iter().map(|own| (own.place, own.module.title())).collect();
    assert_eq!(places, [(1, "Position"), (2, "Position")]);
    assert_eq!(axis_steps(&plugged), Some(AxisSteps { objects: 0x800, pdos: 16, vendor_objects: 0x800 }));
    assert_eq!(axis_steps(&plugged[1..]), None);
    let device = esi.devices[0].with_modules(&plugged).unwrap();
    assert_eq!(device.rx_pdos[2].excludes, [0x1611]);
}

#[test]
fn a_slot_without_a_default_needs_a_name_unless_it_may_be_empty_or_has_one_module() {
    let without = MODULAR.replace(" Default=\"1\"", "");
    let error = resolved(&without, &[]).unwrap_err();
    assert_eq!(error.place(), Some(1));
    assert_eq!(
        error.to_string(),
        "slot 1 (Axis 1) takes one of several modules, and the file names no default: Position (#x00000100), Torque (#x00000200)"
    );
    assert_eq!(resolved(&without, &[(1, "Position"), (2, "Torque")]).unwrap().len(), 5);
    let only = without
        .replace("<ModuleIdent Default=\"0\">#x200</ModuleIdent>", "")
        .replace("<ModuleIdent>#x200</ModuleIdent>", "");
    assert_eq!(resolved(&only, &[]), resolved(MODULAR, &[]));
    let empty = MODULAR.replace("MinInstances=\"1\"", "MinInstances=\"0\"");
    assert_eq!(resolved(&empty, &[]), resolved(MODULAR, &[]));
    assert_eq!(resolved(&empty, &[(2, "none")]).unwrap().len(), 4);
    assert_eq!(resolved(&without.replace("MinInstances=\"1\"", "MinInstances=\"0\""), &[]).unwrap().len(), 2);
}

#[test]
fn modules_that_cannot_be_are_named_with_their_slot() {
    let told = |text: &str, named: &[(u32, &str)]| resolved(text, named).unwrap_err().to_string();
    let unknown = MODULAR.replace("<ModuleIdent Default=\"1\">#x100", "<ModuleIdent Default=\"1\">#x7");
    assert_eq!(told(&unknown, &[]), "slot 1 (Axis 1) needs module 00000007h, which the file does not describe");
    let taken = "it takes Position (#x00000100), Torque (#x00000200)";
    assert_eq!(told(MODULAR, &[(2, "Velocity")]), format!("slot 2 (Axis 2) takes no module `Velocity`; {taken}"));
    assert_eq!(told(MODULAR, &[(1, "none")]), format!("slot 1 (Axis 1) takes no module `none`; {taken}"));
    for place in [0, 5, u32::MAX] {
        assert_eq!(told(MODULAR, &[(place, "x")]), format!("the device has no slot {place}: the file describes 4"));
    }
    let far = MODULAR.replace("SlotPdoIncrement=\"16\"", "SlotPdoIncrement=\"#x200\"");
    assert_eq!(
        told(&far, &[]),
        "slot 2 (Axis 2): 1600h of module `Position` would be 1800h by the increment of the slot, and 17FFh is the last one"
    );
    let far = MODULAR.replace("SlotIndexIncrement=\"#x800\"", "SlotIndexIncrement=\"#xFFFF\"");
    assert!(told(&far, &[]).contains("6040h of module `Position` would be 1603Fh"));
    let twice = MODULAR.replace("SlotPdoIncrement=\"16\"", "");
    assert_eq!(told(&twice, &[]), "PDO 1600h is in slot 1 and again in slot 2; two PDOs need two indices");
    let groups = MODULAR.replace("<Index DependOnSlot=\"1\">#x1602", "<Index DependOnSlotGroup=\"1\">#x1602");
    assert!(resolved(&groups, &[]).is_ok());
    assert!(
        told(&groups, &[(1, "Torque")]).starts_with("slot 1 (Axis 1): indices of module `Torque` depend on a group")
    );
    let many = MODULAR.replace(
        "<Slot MinInstances=\"1\" MaxInstances=\"1\"",
        "<Slot MinInstances=\"4000000000\" MaxInstances=\"4294967295\"",
    );
    assert_eq!(told(&many, &[]), "slot 1 (Axis 1) needs modules beyond slot 255, the last one that a device can have");
    let many = MODULAR.replace("MaxInstances=\"2\"", "MaxInstances=\"4294967295\"");
    assert!(told(&many, &[(300, "Inputs")]).starts_with("slot 300 (Extension) needs modules beyond slot 255"));
    // The process data of a module are not kept for each of many slots.
    let name = "n".repeat(60_000);
    let large = MODULAR.replace("MinInstances=\"0\" MaxInstances=\"2\"", "MinInstances=\"200\" MaxInstances=\"200\"");
    let pdos: String = (0..40)
        .map(|at| format!("<TxPdo><Index DependOnSlot=\"1\">{}</Index><Name>{name}</Name></TxPdo>", 0x100 + 64 * at))
        .collect();
    let large = large
        .replace("<Name LcId=\"1033\">Position mode</Name>", "<Name/>")
        .replace("</TxPdo></Module>", &format!("</TxPdo>{pdos}</Module>"));
    let told = told(&large, &[]);
    assert!(told.contains("take more than the 64 MiB that are kept"), "{told}");
}

#[test]
fn numbers_and_counts_of_slots_are_bounded_with_their_line() {
    let told = |text: &str| Esi::read(text.as_bytes()).unwrap_err().to_string();
    let wide = MODULAR.replace("SlotPdoIncrement=\"16\"", "SlotPdoIncrement=\"65536\"");
    assert_eq!(told(&wide), "line 5: SlotPdoIncrement is `65536`, which is no number from 0 to 65535");
    let negative = MODULAR.replace("MinInstances=\"0\"", "MinInstances=\"-1\"");
    assert_eq!(told(&negative), "line 10: MinInstances is `-1`, which is no number from 0 to 4294967295");
    let odd = MODULAR.replace("<ModuleIdent>#x200", "<ModuleIdent>axis");
    assert_eq!(told(&odd), "line 9: ModuleIdent is `axis`, which is no number from 0 to 4294967295");
    let many = MODULAR.replace("<Slots ", &format!("<Slots>{}</Slots><Slots ", "<Slot/>".repeat(1000)));
    assert_eq!(told(&many), "line 5: more than 255 slots of a device");
    // A module within a module is passed over.
    let nested = MODULAR.replace(
        "<Module><Type ModuleIdent=\"#x300\"",
        "<Module><Module><Type ModuleIdent=\"#x9\"/></Module><Type ModuleIdent=\"#x300\"",
    );
    assert_eq!(Esi::read(nested.as_bytes()), Esi::read(MODULAR.as_bytes()));
    assert_eq!(
        told(&MODULAR.replace("<Modules>", &"<Modules>".repeat(100))),
        "line 13: more than 64 elements within one another"
    );
}

proptest! {
    /// Parts of a description that are lost, doubled or changed: read or refused, resolved or refused.
    #[test]
    fn damaged_modules_never_panic(at in 0..MODULAR.len(), len in 0..200_usize, with in "[<>/\"#x0-9A-Fa-z ]{0,12}", twice: bool) {
        let (start, end) = (at, (at + len).min(MODULAR.len()));
        let part = if twice { &MODULAR[start..end] } else { "" };
        let text = format!("{}{with}{part}{part}{}", &MODULAR[..start], &MODULAR[end..]);
        if let Ok(esi) = Esi::read(text.as_bytes()) {
            for device in &esi.devices {
                let plugged = esi.plugged(device, &Default::default());
                let _ = plugged.map(|plugged| (axis_steps(&plugged), device.with_modules(&plugged)));
            }
            prop_assert!(Esi::read(esi.write().as_bytes()).is_ok());
        }
    }
}
