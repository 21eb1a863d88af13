use proptest::prelude::*;

use super::*;

fn at(index: u16, sub: u8) -> Address {
    Address::new(index, sub)
}

fn sample() -> ObjectDictionary {
    ObjectDictionary::builder()
        .object(Object::new(0x6040, 0, 0u16))
        .object(Object::new(0x6041, 0, 0x0240u16).access(Access::ReadOnly))
        .object(Object::new(0x2000, 0, 7u8).access(Access::WriteOnly))
        .object(Object::new(0x2001, 0, -5i8).limits(-10i8, 10))
        .object(Object::new(0x2002, 0, 1.5f32).limits(-2.0f32, 2.0))
        .object(Object::narrow(0x2003, 0, DataType::Integer24, -2i32))
        .object(Object::new(0x2004, 0, true))
        .highest_sub(0x607d, 2)
        .object(Object::new(0x607d, 1, -1000i32))
        .object(Object::new(0x607d, 2, 1000i32))
        .object(Object::text(0x1008, 0, "a name that is longer than thirty-two bytes"))
        .object(Object::bytes(0x1f22, 1, DataType::Domain, &[], 300))
        .build()
        .unwrap()
}

#[test]
fn values_are_little_endian() {
    let mut od = sample();
    assert_eq!(od.read(at(0x6041, 0)), Ok(&[0x40, 0x02][..]));
    assert_eq!(od.read(at(0x607d, 1)), Ok(&[0x18, 0xfc, 0xff, 0xff][..]));
    assert_eq!(od.read(at(0x2003, 0)), Ok(&[0xfe, 0xff, 0xff][..]));
    assert_eq!(od.read(at(0x2002, 0)), Ok(&[0x00, 0x00, 0xc0, 0x3f][..]));
    assert_eq!(od.write(at(0x6040, 0), &[0x0f, 0x00]), Ok(()));
    assert_eq!(od.get(od.handle::<u16>(0x6040, 0).unwrap()), 0x000f);
}

#[test]
fn missing_objects_and_missing_sub_indices_differ() {
    let mut od = sample();
    assert_eq!(od.read(at(0x6042, 0)), Err(AbortCode(0x0602_0000)));
    assert_eq!(od.read(at(0x0000, 0)), Err(AbortCode(0x0602_0000)));
    assert_eq!(od.read(at(0xffff, 255)), Err(AbortCode(0x0602_0000)));
    assert_eq!(od.read(at(0x6041, 1)), Err(AbortCode(0x0609_0011)));
    assert_eq!(od.read(at(0x607d, 3)), Err(AbortCode(0x0609_0011)));
    assert_eq!(od.write(at(0x1f22, 0), &[1]), Err(AbortCode(0x0609_0011)));
}

#[test]
fn access_rights_bind_the_bus_and_not_the_device() {
    let mut od = sample();
    assert_eq!(od.write(at(0x6041, 0), &[0, 0]), Err(AbortCode(0x0601_0002)));
    assert_eq!(od.write(at(0x1008, 0), b"x"), Err(AbortCode(0x0601_0002)));
    assert_eq!(od.read(at(0x2000, 0)), Err(AbortCode(0x0601_0001)));
    assert_eq!(od.write(at(0x2000, 0), &[9]), Ok(()));
    assert_eq!(od.bytes(at(0x2000, 0)), Some(&[9][..]));
    assert_eq!(od.set_bytes(at(0x6041, 0), &[0x37, 0x02]), Ok(()));
    assert_eq!(od.read(at(0x6041, 0)), Ok(&[0x37, 0x02][..]));
}

#[test]
fn a_value_of_the_wrong_length_is_too_long_or_too_short() {
    let mut od = sample();
    assert_eq!(od.write(at(0x607d, 2), &[1]), Err(AbortCode(0x0607_0013)));
    assert_eq!(od.write(at(0x6040, 0), &[1, 2, 3, 4]), Err(AbortCode(0x0607_0012)));
    assert_eq!(od.write(at(0x6040, 0), &[]), Err(AbortCode(0x0607_0013)));
    assert_eq!(od.write(at(0x1f22, 1), &[0; 301]), Err(AbortCode(0x0607_0012)));
    assert_eq!(od.check_write_len(at(0x6040, 0), 1), Err(AbortCode(0x0607_0013)));
    assert_eq!(od.write(at(0x1f22, 1), &[5; 300]), Ok(()));
    assert_eq!(od.read(at(0x1f22, 1)), Ok(&[5; 300][..]));
    assert_eq!(od.write(at(0x1f22, 1), &[]), Ok(()));
    assert_eq!(od.read(at(0x1f22, 1)), Ok(&[][..]));
}

#[test]
fn limits_give_their_own_abort_codes() {
    let mut od = sample();
    assert_eq!(od.write(at(0x2001, 0), &[11]), Err(AbortCode(0x0609_0031)));
    assert_eq!(od.write(at(0x2001, 0), &[0xf5]), Err(AbortCode(0x0609_0032)));
    assert_eq!(od.write(at(0x2001, 0), &[0xf6]), Ok(()));
    assert_eq!(od.write(at(0x2002, 0), &2.1f32.to_le_bytes()), Err(AbortCode(0x0609_0031)));
    assert_eq!(od.write(at(0x2002, 0), &f32::NAN.to_le_bytes()), Err(AbortCode(0x0609_0030)));
    assert_eq!(od.write(at(0x2004, 0), &[2]), Err(AbortCode(0x0609_0030)));
    assert_eq!(od.read(at(0x2001, 0)), Ok(&[0xf6][..]));
}

#[test]
fn handles_need_the_right_type() {
    let mut od = sample();
    let narrow = od.handle::<i32>(0x2003, 0).unwrap();
    assert_eq!(od.get(narrow), -2);
    od.set(narrow, -3);
    assert_eq!(od.read(at(0x2003, 0)), Ok(&[0xfd, 0xff, 0xff][..]));
    od.set(narrow, 0x0123_4567);
    assert_eq!(od.get(narrow), 0x23_4567);
    let flag = od.handle::<bool>(0x2004, 0).unwrap();
    assert!(od.get(flag));
    let (is, wanted) = (DataType::Unsigned16, DataType::Integer16);
    assert_eq!(od.handle::<i16>(0x6041, 0), Err(DictionaryError::TypeMismatch { index: 0x6041, sub: 0, is, wanted }));
    assert_eq!(od.handle::<u8>(0x5fff, 0), Err(DictionaryError::NoObject { index: 0x5fff, sub: 0 }));
    assert!(od.handle::<u8>(0x1008, 0).is_err());
    assert_eq!(od.get(Handle::<i32>::NOWHERE), 0);
    od.set(Handle::<i32>::NOWHERE, 1);
    assert_eq!(od.data_type(at(0x2003, 0)), Some(DataType::Integer24));
}

#[test]
fn power_on_values_come_back_within_a_range_only() {
    let mut od = sample();
    od.write(at(0x6040, 0), &[1, 0]).unwrap();
    od.write(at(0x1f22, 1), b"abc").unwrap();
    od.restore_power_on_values(0x1000, 0x1fff);
    assert_eq!((od.bytes(at(0x1f22, 1)), od.bytes(at(0x6040, 0))), (Some(&[][..]), Some(&[1, 0][..])));
    od.restore_power_on_values(0, u16::MAX);
    assert_eq!(od.bytes(at(0x6040, 0)), Some(&[0, 0][..]));
}

#[test]
fn what_cannot_be_built_is_named() {
    let build = |object: Object| ObjectDictionary::builder().object(object).build().map(|_| ());
    let twice = ObjectDictionary::builder().objects([Object::new(1, 0, 0u8), Object::new(1, 0, 0u16)]);
    assert_eq!(twice.build().map(|_| ()), Err(DictionaryError::Duplicate { index: 1, sub: 0 }));
    let limits = Err(DictionaryError::Limits { index: 1, sub: 0 });
    assert_eq!(build(Object::new(1, 0, 0i8).limits(1i8, -1)), limits);
    assert_eq!(build(Object::new(1, 0, 5i8).limits(-1i8, 1)), limits);
    assert_eq!(build(Object::new(1, 0, 0f64).limits(f64::NAN, 1.0)), limits);
    assert_eq!(build(Object::text(1, 0, "x").limits(0u8, 1)), limits);
    let length = DictionaryError::Length { index: 1, sub: 0, len: 3, capacity: 2 };
    assert_eq!(build(Object::bytes(1, 0, DataType::OctetString, &[0; 3], 2)), Err(length));
    assert_eq!(build(Object::bytes(1, 0, DataType::Unsigned16, &[0; 3], 9)), Err(length));
}

proptest! {
    #[test]
    fn an_integer_of_any_width_comes_back(value: i64, place in 0usize..8) {
        use DataType::*;
        let types = [Integer8, Integer16, Integer24, Integer32, Integer40, Integer48, Integer56, Integer64];
        let bits = types[place].bits().unwrap();
        let kept = sign_extend(value as u64, bits);
        let od = ObjectDictionary::builder().object(Object::narrow(0x2000, 0, types[place], value)).build().unwrap();
        let bytes = od.read(at(0x2000, 0)).unwrap();
        prop_assert_eq!(bytes, &value.to_le_bytes()[..usize::from(bits / 8)]);
        let read = match types[place] {
            Integer8 => od.get(od.handle::<i8>(0x2000, 0).unwrap()).into(),
            Integer16 => od.get(od.handle::<i16>(0x2000, 0).unwrap()).into(),
            Integer24 | Integer32 => od.get(od.handle::<i32>(0x2000, 0).unwrap()).into(),
            _ => od.get(od.handle::<i64>(0x2000, 0).unwrap()),
        };
        prop_assert_eq!(read, kept);
    }

    #[test]
    fn every_declared_object_is_found_and_no_other(keys in proptest::collection::btree_set(0u32..600, 0..60), probe in 0u32..600) {
        let address = |key: u32| at(0x2000 + (key / 20) as u16, (key % 20) as u8);
        let objects = keys.iter().map(|&key| Object::new(address(key).index, address(key).sub, key));
        let od = ObjectDictionary::builder().objects(objects).build().unwrap();
        let expected = if keys.contains(&probe) {
            Ok(probe)
        } else if keys.iter().any(|key| key / 20 == probe / 20) {
            Err(AbortCode::NO_SUB_INDEX)
        } else {
            Err(AbortCode::NO_OBJECT)
        };
        prop_assert_eq!(od.read(address(probe)).map(|bytes| u32::from_le_bytes(bytes.try_into().unwrap())), expected);
    }
}
