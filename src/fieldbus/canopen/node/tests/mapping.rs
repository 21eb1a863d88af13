//! PDO mappings: which are taken, and how they are written.

use super::*;
use crate::objects::DictionaryError;

/// The order of CiA 301 for RPDO 2 and these entries; stops at the first refusal.
fn remap(device: &mut Device, entries: &[u32], transmission_type: u8) -> Result<(), AbortCode> {
    device.write_u32(0x1401, 1, 0x8000_0303)?;
    device.write(0x1601, 0, &[0])?;
    for (sub, &entry) in (1..).zip(entries) {
        device.write_u32(0x1601, sub, entry)?;
    }
    device.write(0x1601, 0, &[entries.len() as u8])?;
    device.write(0x1401, 2, &[transmission_type])?;
    device.write_u32(0x1401, 1, 0x303)
}

#[test]
fn fault_12_dummy_entries_skip_their_bits() {
    let mut device = booted();
    let entries = [0x0006_0010, 0x607a_0020, 0x0001_0001, 0x2001_0001, 0x0002_0008];
    remap(&mut device, &entries, 255).unwrap();
    device.take(0, &[1, 3]);
    device.take(0x303, &[0xaa, 0xbb, 1, 2, 3, 4, 0b10, 0]);
    assert_eq!((device.value(0x607a, 0), device.value(0x2001, 0), device.value(0x6040, 0)), (0x0403_0201, 1, 0));
    device.take(0x303, &[0xaa, 0xbb, 1, 2, 3, 4, 0b01, 0]);
    assert_eq!(device.value(0x2001, 0), 0);
}

#[test]
fn remapping_in_order_takes_effect_at_once() {
    let mut device = operational();
    remap(&mut device, &[0x6060_0008, 0x6040_0010], 255).unwrap();
    device.take(0x303, &[8, 0x0f, 0x01]);
    assert_eq!((device.value(0x6060, 0), device.value(0x6040, 0)), (8, 0x010f));
    // Switched off again, it hears nothing.
    device.write_u32(0x1401, 1, 0x8000_0303).unwrap();
    assert_eq!(device.take(0x303, &[9]), []);
    assert_eq!(device.value(0x6060, 0), 8);
}

#[test]
fn remapping_out_of_order_is_refused() {
    let mut device = booted();
    let (value, state) = (Err(AbortCode(0x0609_0030)), Err(AbortCode(0x0800_0022)));
    // RPDO 1 is in use: neither mapping nor identifier may change.
    assert_eq!(device.write(0x1600, 0, &[0]), state);
    assert_eq!(device.write_u32(0x1600, 1, 0x6060_0008), state);
    assert_eq!(device.write_u32(0x1400, 1, 0x204), value);
    assert_eq!(device.write_u32(0x1400, 1, 0x203), Ok(()));
    // Switched off, but entries still count.
    assert_eq!(device.write_u32(0x1400, 1, 0x8000_0203), Ok(()));
    assert_eq!(device.write_u32(0x1600, 1, 0x6060_0008), state);
    assert_eq!(device.write(0x1600, 0, &[0]), Ok(()));
    assert_eq!(device.write_u32(0x1600, 1, 0x6060_0008), Ok(()));
    assert_eq!(device.write(0x1600, 0, &[1]), Ok(()));
    // Restricted, extended and too wide identifiers.
    for cob_id in [0x000, 0x07f, 0x181 - 1, 0x601, 0x701, 0x2000_0203, 0x800] {
        assert_eq!(device.write_u32(0x1400, 1, cob_id), value, "{cob_id:X}");
    }
    assert_eq!(device.write_u32(0x1400, 1, 0x204), Ok(()));
}

#[test]
fn bad_mappings_have_their_own_abort_codes() {
    let mut device = booted();
    let not_mappable = Err(AbortCode(0x0604_0041));
    for (entry, expected) in [
        (0x5fff_0010, Err(AbortCode(0x0602_0000))),
        (0x6040_0110, Err(AbortCode(0x0609_0011))),
        (0x6041_0010, not_mappable),
        (0x1017_0010, not_mappable),
        (0x6040_0020, not_mappable),
        (0x0006_0008, not_mappable),
        (0x0006_0110, not_mappable),
        (0x2001_0008, not_mappable),
    ] {
        assert_eq!(remap(&mut device, &[entry], 1), expected, "{entry:08X}");
    }
    let too_long = Err(AbortCode(0x0604_0042));
    assert_eq!(remap(&mut device, &[0x2000_0040, 0x6060_0008], 1), too_long);
    assert_eq!(device.write(0x1601, 0, &[9]), too_long);
    // A gap in the record: entry 3 is empty.
    assert!(device.write(0x1601, 0, &[3]).is_err());
    assert_eq!(device.value(0x1601, 0), 0);
    for reserved in [241, 251, 252, 253] {
        assert_eq!(device.write(0x1401, 2, &[reserved]), Err(AbortCode(0x0609_0030)));
    }
    // TPDOs take what the master reads, and no dummies.
    device.write_u32(0x1801, 1, 0x8000_0283).unwrap();
    assert_eq!(device.write_u32(0x1a01, 1, 0x6040_0010), not_mappable);
    assert_eq!(device.write_u32(0x1a01, 1, 0x0006_0010), not_mappable);
    assert_eq!(device.write_u32(0x1a01, 1, 0x6041_0010), Ok(()));
}

#[test]
fn bad_default_pdos_are_found_at_construction() {
    let id = node_id(3).unwrap();
    let with = |parameters: &PdoParameters| Node::new(id, &dictionary(communication().rpdo(3, parameters))).err();
    let pdo = |mapping: &[(u16, u8, u8)]| PdoParameters::default_rpdo(3, id, mapping).unwrap();
    assert_eq!(with(&pdo(&[(0x607a, 0, 32)])), None);
    let not_mappable = CanopenError::NotMappable { index: 0x6041, sub: 0, bits: 16 };
    assert_eq!(with(&pdo(&[(0x6041, 0, 16)])), Some(not_mappable));
    assert_eq!(with(&pdo(&[(0x2000, 0, 64), (0x6060, 0, 8)])), Some(CanopenError::PdoBits(72)));
    assert_eq!(with(&PdoParameters { cob_id: 0x601, ..pdo(&[]) }), Some(CanopenError::CobId(0x601)));
    let reserved = PdoParameters { transmission_type: 252, ..pdo(&[]) };
    assert_eq!(with(&reserved), Some(CanopenError::TransmissionType(252)));
    let bare = ObjectDictionary::builder().build().unwrap();
    assert!(matches!(Node::new(id, &bare), Err(CanopenError::Dictionary(DictionaryError::NoObject { .. }))));
}
