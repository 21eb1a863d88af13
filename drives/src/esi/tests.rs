use super::*;

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
                    PdoEntry { index: 0x6040, sub: 0, bits: 16, name: text("Controlword"), data_type: text("UINT") },
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
