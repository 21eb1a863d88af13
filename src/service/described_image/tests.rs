//! Images word by word, and read back.

use super::*;
use yieldwall_fieldbus::ethercat::sii::categories;

const DRIVE: &str = r##"<EtherCATInfo>
  <Vendor><Id>#x00000732</Id><Name>A</Name></Vendor>
  <Descriptions><Devices><Device Physics="YY">
    <Type ProductCode="#x00000402" RevisionNo="#x00010002">S1</Type><Name>Servo 1</Name><GroupType>Drives</GroupType>
    <Info><Electrical><EBusCurrent>120</EBusCurrent></Electrical></Info>
    <Fmmu>Outputs</Fmmu><Fmmu>Inputs</Fmmu><Fmmu>MBoxState</Fmmu>
    <Sm DefaultSize="128" StartAddress="#x1000" ControlByte="#x26" Enable="1">MBoxOut</Sm>
    <Sm DefaultSize="256" StartAddress="#x1400" ControlByte="#x22" Enable="1">MBoxIn</Sm>
    <Sm StartAddress="#x1800" ControlByte="#x64" Enable="1">Outputs</Sm>
    <Sm DefaultSize="2" StartAddress="#x1c00" ControlByte="#x20" Enable="1">Inputs</Sm>
    <RxPdo Fixed="1" Sm="2"><Index>#x1600</Index><Name>Out</Name>
      <Entry><Index>#x6040</Index><SubIndex>0</SubIndex><BitLen>16</BitLen><Name>Controlword</Name><DataType>UINT</DataType></Entry>
      <Entry><Index>0</Index><BitLen>7</BitLen></Entry>
      <Entry><Index>#x2000</Index><SubIndex>1</SubIndex><BitLen>1</BitLen><Name>Bit</Name><DataType>BIT1</DataType></Entry>
    </RxPdo>
    <RxPdo><Index>#x1601</Index><Name>Other</Name></RxPdo>
    <TxPdo Sm="3"><Index>#x1A00</Index><Name>In</Name>
      <Entry><Index>#x6041</Index><SubIndex>0</SubIndex><BitLen>16</BitLen><Name>Statusword</Name><DataType>UINT</DataType></Entry>
    </TxPdo>
    <Mailbox><EoE/><CoE SdoInfo="1" PdoAssign="0" PdoConfig="1"/><FoE/></Mailbox>
    <Eeprom><ByteSize>4096</ByteSize><ConfigData>080E00CC8813ED00000000010203</ConfigData><BootStrap>0010000400140004</BootStrap></Eeprom>
  </Device></Devices></Descriptions>
</EtherCATInfo>"##;

fn made(text: &str) -> Result<DescribedImage, ImageError> {
    let esi = Esi::read(text.as_bytes()).unwrap();
    described_image(&esi, &esi.devices[0], 7, 99)
}

fn word(image: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([image[2 * at], image[2 * at + 1]])
}

#[test]
fn an_image_holds_what_the_description_says() {
    let DescribedImage { image, left_out } = made(DRIVE).unwrap();
    assert_eq!(left_out, []);
    for (at, expected) in [
        // ConfigData, the alias of the chip, and the reserved words of ConfigData.
        (0x00, 0x0e08),
        (0x01, 0xcc00),
        (0x02, 0x1388),
        (0x03, 0x00ed),
        (0x04, 7),
        (0x05, 0x0100),
        (0x06, 0x0302),
        (0x08, 0x0732),
        (0x0a, 0x0402),
        (0x0c, 0x0002),
        (0x0d, 0x0001),
        (0x0e, 99),
        // BootStrap, then the mailboxes of sync managers 0 and 1.
        (0x14, 0x1000),
        (0x15, 0x0400),
        (0x16, 0x1400),
        (0x17, 0x0400),
        (0x18, 0x1000),
        (0x19, 128),
        (0x1a, 0x1400),
        (0x1b, 256),
        // EoE, CoE and FoE.
        (0x1c, 0x000e),
        // 4096 bytes are 32 kbit.
        (0x3e, 31),
        (0x3f, 1),
    ] {
        assert_eq!(word(&image, at), expected, "word {at:02X}h");
    }
    let sii = Sii::read(&image).unwrap();
    assert_eq!(sii.warnings, []);
    assert_eq!((sii.order.as_str(), sii.name.as_str(), sii.group.as_str()), ("S1", "Servo 1", "Drives"));
    assert_eq!((sii.e_bus_ma, sii.coe_details), (120, 0b1011));
    assert_eq!(sii.ports, [PortUse::MII, PortUse::MII, PortUse::UNUSED, PortUse::UNUSED]);
    assert_eq!(sii.fmmus, [FmmuUse::OUTPUTS, FmmuUse::INPUTS, FmmuUse::MAILBOX_STATE]);
    let managers = sii.sync_managers.iter().map(|one| (one.kind, one.settings.start, one.settings.len));
    assert_eq!(
        managers.collect::<Vec<_>>(),
        [(1, 0x1000, 128), (2, 0x1400, 256), (3, 0x1800, 3), (4, 0x1c00, 2)],
        "outputs without a size have that of their process data"
    );
    let entry = |index, sub, name: &str, data_type, bits| PdoEntry { index, sub, name: name.into(), data_type, bits };
    let pdo = |index, sync_manager, name: &str, entries| Pdo { index, sync_manager, name: name.into(), entries };
    let outputs = vec![entry(0x6040, 0, "Controlword", 6, 16), entry(0, 0, "", 0, 7), entry(0x2000, 1, "Bit", 0x30, 1)];
    assert_eq!(sii.rx_pdos, [pdo(0x1600, 2, "Out", outputs), pdo(0x1601, 0xff, "Other", vec![])]);
    assert_eq!(sii.tx_pdos, [pdo(0x1a00, 3, "In", vec![entry(0x6041, 0, "Statusword", 6, 16)])]);
}

#[test]
fn a_chip_that_is_too_small_gets_less_and_not_a_torn_image() {
    let of_room = |bytes: usize| made(&DRIVE.replace("4096", &bytes.to_string()));
    let whole = made(DRIVE).unwrap().image.len();
    let unnamed = of_room(whole - 1).unwrap();
    assert_eq!(unnamed.left_out, [LeftOutOfImage::EntryNames]);
    let sii = Sii::read(&unnamed.image).unwrap();
    assert!(sii.warnings.is_empty() && sii.rx_pdos[0].entries[0].name.is_empty());
    let without = of_room(unnamed.image.len() - 1).unwrap();
    assert_eq!(without.left_out, [LeftOutOfImage::EntryNames, LeftOutOfImage::ProcessData]);
    assert!(Sii::read(&without.image).unwrap().rx_pdos.is_empty());
    let bytes = without.image.len();
    assert_eq!(of_room(bytes - 1), Err(ImageError::TooLong { bytes, room: bytes - 1 }));
    // Without CoE nothing else reports the process data.
    let no_coe = DRIVE.replace("<CoE SdoInfo=\"1\" PdoAssign=\"0\" PdoConfig=\"1\"/>", "");
    assert!(matches!(made(&no_coe.replace("4096", "300")), Err(ImageError::TooLong { .. })));
}

#[test]
fn a_description_without_its_configuration_makes_no_image() {
    let config = "<ConfigData>080E00CC8813ED00000000010203</ConfigData>";
    assert_eq!(made(&DRIVE.replace(config, "")), Err(ImageError::NoConfiguration));
    for bad in ["08", "080", "080E0", "080G", "080E00CC8813ED000000000102030405060708"] {
        let text = DRIVE.replace(config, &format!("<ConfigData>{bad}</ConfigData>"));
        let digits = ImageError::Digits { element: "ConfigData", least: 2, most: 16 };
        assert_eq!(made(&text), Err(digits), "{bad}");
    }
    let text = DRIVE.replace("0010000400140004", "00100004");
    assert_eq!(made(&text), Err(ImageError::Digits { element: "BootStrap", least: 8, most: 8 }));
    let text = DRIVE.replace("<BitLen>7</BitLen>", "<BitLen>256</BitLen>");
    assert_eq!(made(&text), Err(ImageError::Entry { pdo: 0x1600, bits: 256 }));
}

#[test]
fn ports_are_those_of_the_letters() {
    use PortUse as Port;

    let (y, k, h, none) = (Port::MII, Port::EBUS, Port::FAST_HOT_CONNECT, Port::UNUSED);
    for (letters, word, ports) in [
        ("YKY", 0x0131, [y, k, y, none]),
        ("KK", 0x0033, [k, k, none, none]),
        ("Y  H", 0x4001, [y, none, none, h]),
        ("", 0, [none; 4]),
    ] {
        let DescribedImage { image, .. } = made(&DRIVE.replace("\"YY\"", &format!("\"{letters}\""))).unwrap();
        assert_eq!(Sii::read(&image).unwrap().ports, ports, "{letters}");
        let general = categories(&image).find(|category| category.kind == category::GENERAL).unwrap();
        assert_eq!(general.bytes[16..18], u16::to_le_bytes(word), "{letters}");
    }
    for letters in ["YX", "YYYYY", "y"] {
        let text = DRIVE.replace("\"YY\"", &format!("\"{letters}\""));
        assert_eq!(made(&text), Err(ImageError::Physics(letters.to_owned())));
    }
    let message = ImageError::Physics("YX".to_owned()).to_string();
    assert!(message.starts_with("Physics of this device is `YX`: a controller has 4 ports"), "{message}");
}

/// The drive with further categories.
fn with_categories(categories: &str) -> String {
    DRIVE.replace("</Eeprom>", &format!("{categories}</Eeprom>"))
}

#[test]
fn categories_of_the_vendor_stand_behind_those_of_the_standard() {
    let text = with_categories(
        "<Category><CatNo>2048</CatNo><Data>010203</Data></Category><Category><CatNo>60</CatNo><DataUINT>7</DataUINT></Category>\
         <Category><CatNo>41</CatNo><Data>00</Data></Category><Category><CatNo>65535</CatNo><Data>00</Data></Category>",
    );
    let DescribedImage { image, left_out } = made(&text).unwrap();
    assert_eq!(left_out, [41, 0xffff].map(LeftOutOfImage::OwnCategory));
    let kinds: Vec<u16> = categories(&image).map(|category| category.kind).collect();
    assert_eq!(kinds, [10, 30, 40, 41, 50, 51, 2048, 60]);
    let sii = Sii::read(&image).unwrap();
    let held: Vec<(u16, &[u8])> = sii.other_categories.iter().map(|other| (other.kind, &*other.bytes)).collect();
    assert_eq!(held, [(2048, &[1, 2, 3, 0][..]), (60, &[7, 0])]);
    assert_eq!((sii.warnings.len(), sii.sync_managers.len()), (0, 4));
}

#[test]
fn a_small_chip_has_its_vendors_categories_before_names_and_no_category_that_does_not_fit() {
    let big = format!("<Category><CatNo>2049</CatNo><Data>{}</Data></Category>", "5A".repeat(5000));
    let text = with_categories(&format!("<Category><CatNo>2048</CatNo><Data>0102</Data></Category>{big}"));
    let large = made(&text).unwrap();
    assert_eq!(large.left_out, [LeftOutOfImage::Category(2049)]);
    assert_eq!(large.left_out[0].to_string(), "category 2049, for which the chip has no room");
    let whole = large.image.len();
    assert_eq!(whole, made(DRIVE).unwrap().image.len() + 6);
    let small = made(&text.replace("4096", &(whole - 1).to_string())).unwrap();
    assert_eq!(small.left_out, [LeftOutOfImage::Category(2049), LeftOutOfImage::EntryNames]);
    assert_eq!(Sii::read(&small.image).unwrap().other_categories.len(), 1);
    // A chip of unknown size is not larger than the largest.
    let endless = text.replace("<ByteSize>4096</ByteSize>", "");
    let endless = endless.replace("</Eeprom>", &format!("{}</Eeprom>", big.repeat(20)));
    let DescribedImage { image, left_out } = made(&endless).unwrap();
    assert!(image.len() <= 2 * MOST_WORDS && left_out.len() == 8, "{} {left_out:?}", image.len());
}

#[test]
fn process_data_of_modules_are_left_out_and_said() {
    let slots = "<Slots SlotPdoIncrement=\"1\"><Slot><ModuleIdent Default=\"1\">1</ModuleIdent></Slot></Slots>";
    let modules = "</Devices><Modules><Module><Type ModuleIdent=\"1\"/><TxPdo Sm=\"3\"><Index>#x1A10</Index></TxPdo></Module></Modules>";
    let text = DRIVE.replace("<Mailbox>", &format!("{slots}<Mailbox>")).replace("</Devices>", modules);
    let modular = made(&text).unwrap();
    assert_eq!((modular.image, modular.left_out), (made(DRIVE).unwrap().image, vec![LeftOutOfImage::Modules]));
    let said = LeftOutOfImage::Modules.to_string();
    assert_eq!(
        said,
        "process data objects of modules: they depend on the plugged modules, which a device with CoE reports itself"
    );
}
