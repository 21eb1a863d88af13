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

#[test]
fn what_is_wrong_is_named_with_its_word() {
    let good = sample().write();
    let told = |image: &[u8]| Sii::read(image).unwrap_err().to_string();
    assert_eq!(told(&good[..100]), "the image ends at word 0032h, but the head needs word 003Fh");
    let changed = |word: usize, value: u16| {
        let mut image = good.clone();
        image[2 * word..2 * word + 2].copy_from_slice(&value.to_le_bytes());
        image
    };
    assert!(told(&changed(4, 1)).starts_with("word 0007h: the checksum is "));
    assert_eq!(told(&changed(0x50, 0x0901)), "word 0050h: string 9 is named, but there are 3");
    assert_eq!(
        told(&changed(0x64, 7)),
        "word 0069h: a sync manager does not fit the category that begins at word 0063h"
    );
    assert_eq!(told(&changed(0x41, 0x7000)), "the image ends at word 0078h, but a category needs word 7041h");
    assert_eq!(told(&good[..good.len() - 2]), "the image ends at word 0077h, but a category needs word 0077h");
    let pdo = "word 0077h: an entry of a process data object does not fit the category that begins at word 006Dh";
    assert_eq!(told(&changed(0x70, 0x0302)), pdo);
}

/// A thousand images with flipped bits are read or refused.
#[test]
fn flipped_bits_are_survived() {
    let good = sample().write();
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut refused = 0;
    for _ in 0..1000 {
        let mut image = good.clone();
        for _ in 0..4 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let bit = (state >> 33) as usize % (8 * image.len());
            image[bit / 8] ^= 1 << (bit % 8);
        }
        refused += usize::from(Sii::read(&image).is_err());
    }
    assert!((100..900).contains(&refused), "{refused} were refused");
}

proptest! {
    #[test]
    fn what_is_written_is_read(alias: u16, vendor_id: u32, names in proptest::collection::vec("[ -~]{0,40}", 3), bits: u8) {
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
