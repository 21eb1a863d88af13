use super::*;
use proptest::prelude::*;

fn sample() -> Sii {
    let manager = |start, len, control, kind| SyncManagerUse {
        settings: SyncManager { start, len, control, is_enabled: true, repeat: false },
        kind,
    };
    let entry = |index, name: &str, bits| PdoEntry { index, sub: 0, name: name.to_owned(), data_type: 6, bits };
    Sii {
        pdi: [0x0c05, 0, 0, 0],
        vendor_id: 0xffff_5957,
        product_code: 0x402,
        revision: 1,
        serial: 7,
        receive_mailbox: MailboxArea { start: 0x1000, len: 128 },
        send_mailbox: MailboxArea { start: 0x1400, len: 128 },
        protocols: protocols::COE,
        order: "servo".to_owned(),
        name: "servo".to_owned(),
        coe_details: coe_details::SDO | coe_details::COMPLETE_ACCESS,
        e_bus_ma: -20,
        ports: [PortUse::MII, PortUse::EBUS, PortUse::UNUSED, PortUse::FAST_HOT_CONNECT],
        fmmus: vec![FmmuUse::OUTPUTS, FmmuUse::INPUTS, FmmuUse::MAILBOX_STATE],
        sync_managers: vec![manager(0x1000, 128, 0x26, 1), manager(0x1400, 128, 0x22, 2)],
        tx_pdos: vec![Pdo {
            index: 0x1a00,
            sync_manager: 3,
            name: "in".to_owned(),
            entries: vec![entry(0x6041, "statusword", 16)],
        }],
        ..Sii::default()
    }
}

#[test]
fn an_image_word_by_word() {
    let image = sample().write();
    let word = |at: usize| super::super::u16_at(&image, 2 * at);
    let expected = [
        (0x00, 0x0c05),
        (0x04, 0x0000),
        (0x08, 0x5957),
        (0x09, 0xffff),
        (0x0a, 0x0402),
        (0x0c, 0x0001),
        (0x0e, 0x0007),
        (0x18, 0x1000),
        (0x19, 0x0080),
        (0x1a, 0x1400),
        (0x1b, 0x0080),
        (0x1c, 0x0004),
        (0x3e, 0x000f),
        (0x3f, 0x0001),
        // Strings: three of them, "servo", "in", "statusword".
        (0x40, 0x000a),
        (0x41, 0x000b),
        (0x42, 0x0503),
        (0x43, 0x6573),
        // General: no group, order 1, name 1.
        (0x4d, 0x001e),
        (0x4e, 0x0010),
        (0x4f, 0x0000),
        (0x50, 0x0101),
        (0x51, 0x2100),
        (0x55, 0xffec),
        (0x57, 0x4031),
        // FMMU: outputs, inputs, mailbox state, filler.
        (0x5f, 0x0028),
        (0x60, 0x0002),
        (0x61, 0x0201),
        (0x62, 0xff03),
        // Sync managers.
        (0x63, 0x0029),
        (0x64, 0x0008),
        (0x65, 0x1000),
        (0x66, 0x0080),
        (0x67, 0x0026),
        (0x68, 0x0101),
        // TxPDO.
        (0x6d, 0x0032),
        (0x6e, 0x0008),
        (0x6f, 0x1a00),
        (0x70, 0x0301),
        (0x71, 0x0200),
        (0x73, 0x6041),
        (0x74, 0x0300),
        (0x75, 0x1006),
        (0x77, 0xffff),
    ];
    for (at, value) in expected {
        assert_eq!(word(at), value, "word {at:02X}h");
    }
    assert_eq!(Sii::read(&image), Ok(sample()));
}

#[test]
fn other_categories_stand_behind_those_with_fields() {
    let other = |kind, bytes: &[u8]| OtherCategory { kind, bytes: bytes.to_vec() };
    let with = Sii { other_categories: vec![other(0x0800, &[1, 2]), other(category::DC, &[0; 4])], ..sample() };
    let image = with.write();
    let added: usize = with.other_categories.iter().map(OtherCategory::written_len).sum();
    assert_eq!(image.len(), sample().write().len() + added);
    let words: Vec<u16> = (0x77..0x7e).map(|at| super::super::u16_at(&image, 2 * at)).collect();
    assert_eq!(words, [0x0800, 1, 0x0201, 0x003c, 2, 0, 0]);
    assert_eq!(Sii::read(&image), Ok(with));
    assert_eq!([other(1, &[]), other(1, &[1])].map(|other| other.written_len()), [0, 6]);
}

/// Known sums: of an image that vendors print, and of nothing at all.
#[test]
fn the_checksum_is_crc_8_from_ff() {
    assert_eq!(
        checksum(&[0x08, 0x0c, 0x00, 0xee, 0x64, 0, 0, 0, 0, 0, 0, 0, 0, 0]),
        by_division(&[0x08, 0x0c, 0x00, 0xee, 0x64, 0, 0, 0, 0, 0, 0, 0, 0, 0])
    );
    assert_eq!(
        checksum(&[0x80, 0x00, 0x00, 0x00, 0x00, 0, 0, 0, 0, 0, 0, 0, 0, 0]),
        by_division(&[0x80, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0])
    );
}

/// The sum by long division of polynomials, bit by bit: the first byte complemented, eight zeros behind.
fn by_division(bytes: &[u8; 14]) -> u8 {
    let mut bits: Vec<u8> = bytes.iter().flat_map(|byte| (0..8).rev().map(move |bit| byte >> bit & 1)).collect();
    bits.extend([0; 8]);
    bits[..8].iter_mut().for_each(|bit| *bit ^= 1);
    for at in 0..112 {
        if bits[at] == 1 {
            for (offset, term) in [1, 0, 0, 0, 0, 0, 1, 1, 1].into_iter().enumerate() {
                bits[at + offset] ^= term;
            }
        }
    }
    bits[112..].iter().fold(0, |sum, bit| sum << 1 | bit)
}

/// The words of an image of the length of a usual chip, some of them changed; behind the image is `rest`.
fn changed(words: &[(usize, u16)], rest: Option<u8>) -> Vec<u8> {
    let mut image = sample().write();
    if let Some(rest) = rest {
        image.resize(2048, rest);
    }
    for (word, value) in words {
        image[2 * word..2 * word + 2].copy_from_slice(&value.to_le_bytes());
    }
    image
}

fn told(image: &[u8]) -> Vec<String> {
    Sii::read(image).unwrap().warnings.iter().map(ToString::to_string).collect()
}

#[test]
fn only_an_image_that_says_nothing_is_refused() {
    let refused = |image: &[u8]| Sii::read(image).unwrap_err().to_string();
    assert_eq!(refused(&sample().write()[..100]), "the image ends at word 0032h, but the head needs word 003Fh");
    assert_eq!(refused(&[]), "the image ends at word 0000h, but the head needs word 003Fh");
    assert_eq!(refused(&[0xff; 130]), "the chip is empty: all its bytes are FFh");
    assert_eq!(refused(&[0; 2048]), "the chip is empty: all its bytes are 00h");
    // The alias alone was programmed, with its checksum.
    let mut image = vec![0xff; 130];
    image[..16].fill(0);
    set_alias(&mut image, 5);
    let read = Sii::read(&image).unwrap();
    assert_eq!((read.alias, read.mailbox_areas()), (5, None));
    assert_eq!(told(&image)[0], "word 0008h: the vendor is FFFFFFFFh: the identity is not programmed");
}

#[test]
fn what_is_damaged_is_named_with_its_word_and_the_rest_is_taken() {
    assert_eq!(told(&changed(&[], Some(0xff))), [""; 0]);
    for (words, rest, warning) in [
        (&[(0x07, 0x0155)][..], None, "word 0007h: the checksum is 55h, and words 0 to 6 give "),
        (&[(0x07, 0x88a4)], None, "word 0007h: 88A4h switches the checksum of words 0 to 6 off, which would be "),
        (&[(0x50, 0x0901)], None, "word 0050h: string 9 is named, but there are 3: the name is left empty"),
        // A category of the vendor in place of the strings: three categories name some.
        (&[(0x40, 0x0800)], None, "word 0050h: string 1 is named, but there are 0: the name is left empty"),
        (&[(0x42, 0x0505)], None, "word 004Dh: a string does not fit the category that begins at word 0040h"),
        (&[(0x41, 0x7000)], None, "word 0040h: this category needs word 7041h, and the image ends at word 0078h"),
        (&[(0x77, 0)], Some(0), "word 0077h: neither a category nor the end (FFFFh) of the categories is here"),
        (&[(0x4d, 0x001f)], None, "word 0040h: no general category (001Eh) is among the categories"),
        (
            &[(0x70, 0x0302)],
            None,
            "word 0077h: an entry of a process data object does not fit the category that begins",
        ),
        (
            &[(0x1a, 0x1200)],
            None,
            "word 001Ah: the mailbox is at 1200h with 128 bytes here, and its sync manager has it",
        ),
    ] {
        let all = told(&changed(words, rest));
        assert!(all[0].starts_with(warning), "{all:?}");
        let read = Sii::read(&changed(words, rest)).unwrap();
        assert_eq!((read.vendor_id, read.product_code), (0xffff_5957, 0x402));
        assert!(read.mailbox_managers().is_some(), "{warning}");
    }
    let good = sample().write();
    assert_eq!(
        told(&good[..good.len() - 2]),
        ["word 0077h: neither a category nor the end (FFFFh) of the categories is here"]
    );
    assert_eq!(told(&[&good[..], &[0]].concat()), ["word 0078h: the image ends in the middle of this word"]);
}

/// An image of categories behind the head of the sample: type, bytes.
fn with_categories(categories: &[(u16, &[u8])]) -> Vec<u8> {
    let mut image = sample().write()[..2 * FIRST_CATEGORY].to_vec();
    for (kind, bytes) in categories {
        image.extend(kind.to_le_bytes());
        image.extend(((bytes.len() / 2) as u16).to_le_bytes());
        image.extend(*bytes);
    }
    image.extend(category::END.to_le_bytes());
    image
}

const PDO: [u8; 16] = [0x00, 0x1a, 1, 3, 0, 0, 0, 0, 0x41, 0x60, 0, 0, 6, 16, 0, 0];

#[test]
fn fillers_are_passed_over_wherever_they_are() {
    let of_pdos = |bytes: &[u8]| {
        let read = Sii::read(&with_categories(&[(category::GENERAL, &[0; 16]), (category::TX_PDO, bytes)])).unwrap();
        (read.tx_pdos.iter().map(|pdo| pdo.index).collect::<Vec<_>>(), read.warnings)
    };
    let filler = |word, bytes| SiiWarning::Filler { word, bytes, category: 0x4a };
    assert_eq!(of_pdos(&PDO), (vec![0x1a00], vec![]));
    assert_eq!(of_pdos(&[&PDO[..], &[0; 2]].concat()), (vec![0x1a00], vec![filler(0x54, 2)]));
    assert_eq!(of_pdos(&[&PDO[..], &[0xff; 12]].concat()), (vec![0x1a00], vec![filler(0x54, 12)]));
    assert_eq!(of_pdos(&[&PDO[..], &[0; 8], &PDO[..]].concat()), (vec![0x1a00; 2], vec![filler(0x54, 8)]));
    let torn = SiiWarning::Torn { word: 0x54, what: "a process data object", category: 0x4a };
    assert_eq!(of_pdos(&[&PDO[..], &[1, 2]].concat()), (vec![0x1a00], vec![torn]));
    // Categories of type 0, with bytes and without, and zeros in odd number.
    let general = [0u8, 0, 0, 0, 0, 0x0f, 0, 0, 0, 0, 0, 0, 7, 0];
    let manager = [0, 0x10, 128, 0, 0x26, 0, 1, 1];
    let image = with_categories(&[
        (0, &[5; 6]),
        (0, &[]),
        (0, &[]),
        (category::GENERAL, &general),
        (0, &[]),
        (category::SYNC_MANAGERS, &manager),
    ]);
    let read = Sii::read(&image).unwrap();
    assert_eq!((read.e_bus_ma, read.coe_details, read.sync_managers.len(), read.warnings.len()), (7, 0x0f, 1, 0));
    // A sync manager that is not whole does not take the others with it.
    let image =
        with_categories(&[(category::GENERAL, &general), (category::SYNC_MANAGERS, &[&manager[..], &[0; 4]].concat())]);
    let read = Sii::read(&image).unwrap();
    assert_eq!(
        (read.sync_managers.len(), read.warnings),
        (1, vec![SiiWarning::Filler { word: 0x4f, bytes: 4, category: 0x49 }])
    );
}

#[test]
fn a_head_alone_gives_identity_and_mailboxes() {
    let mut image = sample().write()[..2 * FIRST_CATEGORY].to_vec();
    image.resize(2048, 0);
    let read = Sii::read(&image).unwrap();
    let areas = [(0x1000, 128), (0x1400, 128)].map(|(start, len)| MailboxArea { start, len });
    assert_eq!((read.mailbox_areas(), read.has_coe(), read.lacks_information()), (Some(areas), true, false));
    assert_eq!(read.warnings, [SiiWarning::NoEnd { word: 0x40 }, SiiWarning::NoGeneral { word: 0x40 }]);
    // A chip is not read much further than that.
    let words = (0..).find(|words| words_needed(&image[..2 * words]) <= *words).unwrap();
    assert_eq!(words, 0x80);
    // A general part of four bytes has names and nothing else.
    let image = with_categories(&[(category::STRINGS, &[1, 2, b'a', b'b']), (category::GENERAL, &[0, 0, 1, 0])]);
    let read = Sii::read(&image).unwrap();
    assert_eq!((read.order.as_str(), read.coe_details), ("ab", 0));
    assert_eq!(read.warnings, [SiiWarning::ShortGeneral { word: 0x44, bytes: 4, needed: 14 }]);
}

#[test]
fn mailboxes_are_where_the_sync_managers_have_them() {
    let area = |start, len| MailboxArea { start, len };
    let mut sii = sample();
    sii.sync_managers[1].settings.start = 0x1200;
    assert_eq!(sii.mailbox_areas(), Some([area(0x1000, 128), area(0x1200, 128)]));
    sii.sync_managers[1].settings.len = 4;
    assert_eq!(sii.mailbox_areas(), Some([area(0x1000, 128), area(0x1400, 128)]));
    sii.send_mailbox = MailboxArea::default();
    assert_eq!((sii.mailbox_areas(), sii.is_without_mailbox()), (None, false));
    sii.protocols = 0;
    assert!(sii.is_without_mailbox() && !sii.has_coe());
    for (details, lacks) in [
        (0, false),
        (coe_details::SDO, true),
        (coe_details::SDO | coe_details::INFORMATION, false),
        (coe_details::UPLOAD, false),
    ] {
        sii.coe_details = details;
        assert_eq!(sii.lacks_information(), lacks, "{details:02x}");
    }
}

#[test]
fn names_are_text_that_a_terminal_shows() {
    for (bytes, name) in [
        (&b"DRIVE-A1\0\0\0\0"[..], "DRIVE-A1"),
        (b"DRIVE\0A1", "DRIVE"),
        (b"\0\0", ""),
        ("Förderer µ".as_bytes(), "Förderer µ"),
        (b"F\xf6rderer", "Förderer"),
        (b"a\x1b[2Jb", "a [2Jb"),
        // Also a control of Latin-1, and one that turns the direction of text.
        (b"a\x9b2J", "a 2J"),
        ("a\u{202e}b\u{85}".as_bytes(), "a b "),
    ] {
        assert_eq!(text::decode(bytes), name);
    }
    assert_eq!(text::encode(&"é".repeat(200)), "é".repeat(127).into_bytes());
}

#[test]
fn a_size_that_is_not_filled_in_is_not_believed() {
    let mut image = changed(&[(0x3e, 0)], None);
    assert_eq!((chip_words(&image), words_needed(&image)), (0x400, 0x78));
    image[2 * 0x3e..2 * 0x3f].fill(0xff);
    assert_eq!(chip_words(&image), MOST_WORDS);
}

#[test]
fn a_controller_loads_a_head_whose_checksum_is_right_or_switched_off() {
    let mut image = sample().write();
    assert!(is_loaded(&image));
    image[15] = 0x12;
    assert!(is_loaded(&image), "the high byte is not the checksum");
    image[14] ^= 1;
    assert!(!is_loaded(&image) && !is_loaded(&[]));
    image[14..16].copy_from_slice(&[0xa4, 0x88]);
    assert!(is_loaded(&image));
}

proptest! {
    /// Whatever bytes follow a head: what is read is bounded and can be written and read again.
    #[test]
    fn any_bytes_are_read(head in proptest::collection::vec(any::<u8>(), 128), bytes in proptest::collection::vec(any::<u8>(), 0..2000)) {
        let image = [head, bytes].concat();
        if let Ok(read) = Sii::read(&image) {
            prop_assert!(read.warnings.len() <= 32 && read.sync_managers.len() <= MOST_ITEMS);
            let again = Sii::read(&read.write()).unwrap();
            prop_assert!(again.vendor_id == read.vendor_id && read.name.starts_with(&again.name));
        }
        prop_assert!(words_needed(&image) <= MOST_WORDS);
        prop_assert!(categories(&image).count() <= image.len() / 4);
    }

    /// Whatever one word of a good image becomes: the head is taken, and a category before the word is what it was.
    #[test]
    fn damage_leaves_what_is_before_it(word in 0x40..0x77_usize, value: u16) {
        let read = Sii::read(&changed(&[(word, value)], None)).unwrap();
        let good = sample();
        prop_assert_eq!((read.vendor_id, read.serial, read.protocols), (good.vendor_id, good.serial, good.protocols));
        prop_assert!(read.mailbox_areas().is_some());
        if word > 0x6c {
            prop_assert_eq!(&read.sync_managers, &good.sync_managers);
        }
        if word > 0x5e {
            prop_assert_eq!((&read.order, read.coe_details), (&good.order, good.coe_details));
        }
    }

    /// However a chip is read, by two words or four at a time, it comes to an end that is no further than the chip.
    #[test]
    fn reading_a_chip_ends(bytes in proptest::collection::vec(prop_oneof![Just(0u8), any::<u8>()], 4096), step in prop_oneof![Just(4_usize), Just(8)]) {
        let mut read = 0;
        while read / 2 < words_needed(&bytes[..read]) && read < bytes.len() {
            read += step;
        }
        prop_assert!(read >= 2 * FIRST_CATEGORY);
        prop_assert!(read / 2 <= chip_words(&bytes) + 4 || read >= bytes.len());
    }

    #[test]
    fn what_is_written_is_read(alias: u16, vendor_id: u32, names in proptest::collection::vec("[ -~¡-ÿΩ€]{0,40}", 3), bits: u8) {
        let mut sii = sample();
        (sii.alias, sii.vendor_id) = (alias, vendor_id);
        (sii.group, sii.order, sii.name) = (names[0].clone(), names[1].clone(), names[2].clone());
        sii.tx_pdos[0].entries[0].bits = bits;
        prop_assert_eq!(Sii::read(&sii.write()), Ok(sii));
    }
}

#[test]
fn an_alias_comes_with_its_checksum_and_only_what_differs_is_written() {
    let held = sample().write();
    let mut image = held.clone();
    set_alias(&mut image, 0x1234);
    let wanted = Sii { alias: 0x1234, ..Sii::read(&held).unwrap() };
    assert_eq!(Sii::read(&image).unwrap(), wanted);
    let sum = checksum(image.first_chunk().unwrap());
    assert_eq!(changes(&held, &image), [(4, [0x34, 0x12]), (7, [sum, 0])]);
    assert_eq!(changes(&held, &held), []);
    assert_eq!(changes(&held[..2], &held[..4]), [(1, [held[2], held[3]])]);
    let mut short = [0; 9];
    set_alias(&mut short, 5);
}
