//! Complete access: all sub-indices of an object in one transfer.
//!
//! Sub-index 0 takes two bytes, the others follow without gaps. A transfer begins at sub-index 0 or 1.

use crate::objects::{AbortCode, Access, Address, Description, ObjectDictionary, ServedDevice};

/// Returns the sub-indices that are transferred, from 1 on: those that sub-index 0 counts.
fn members(od: &ObjectDictionary, index: u16) -> impl Iterator<Item = Description> {
    let highest = od.raw(index, 0);
    od.under(index).filter(move |member| member.at.sub > 0 && u64::from(member.at.sub) <= highest)
}

/// Whether an object has complete access.
///
/// # Errors
/// 06020000h no object, 06010004h one value, 06090011h another start than sub-index 0 or 1.
fn check(od: &ObjectDictionary, at: Address) -> Result<(), AbortCode> {
    let is_record = od.under(at.index).any(|member| member.at.sub > 0);
    match (od.under(at.index).next(), is_record, at.sub) {
        (None, ..) => Err(AbortCode::NO_OBJECT),
        (_, false, _) => Err(AbortCode::NO_COMPLETE_ACCESS),
        (_, true, 0 | 1) => Ok(()),
        _ => Err(AbortCode::NO_SUB_INDEX),
    }
}

/// Puts all members into `value`, which is empty and has room for `capacity` bytes. A member that may not be read is zero.
pub(super) fn read<D: ServedDevice + ?Sized>(
    device: &mut D,
    at: Address,
    value: &mut Vec<u8>,
    capacity: usize,
) -> Result<(), AbortCode> {
    check(device.od(), at)?;
    if at.sub == 0 {
        let start = Address::new(at.index, 0);
        device.before_read(start)?;
        value.extend_from_slice(&[device.od().raw(at.index, 0) as u8, 0]);
    }
    // Sub-index by sub-index: the device brings each up to date before it is read.
    for sub in 1..=u8::MAX {
        let member = Address::new(at.index, sub);
        if u64::from(sub) > device.od().raw(at.index, 0) {
            break;
        }
        let Ok(description) = device.od().describe(member) else { continue };
        let end = value.len() + description.capacity;
        if end > capacity {
            return Err(AbortCode::OUT_OF_MEMORY);
        }
        if description.access != Access::WriteOnly {
            device.before_read(member)?;
            value.extend_from_slice(device.od().bytes(member).unwrap_or_default());
        }
        value.resize(end, 0);
    }
    Ok(())
}

/// Writes all members. A member that may not be written is skipped. Sub-index 0 is cleared first and written last, in the same way as by a
/// master that writes one by one.
pub(super) fn write<D: ServedDevice + ?Sized>(device: &mut D, at: Address, value: &[u8]) -> Result<(), AbortCode> {
    check(device.od(), at)?;
    let start = Address::new(at.index, 0);
    let counts = device.od().check_writable(start).is_ok();
    let (count, mut rest) = match (at.sub, value) {
        (0, [count, _, rest @ ..]) => (Some(*count), rest),
        (0, _) => return Err(AbortCode::TOO_SHORT),
        _ => (None, value),
    };
    let highest = match count {
        Some(count) if counts => u64::from(count),
        _ => device.od().raw(at.index, 0),
    };
    let is_writable = |member: &Description| member.access == Access::ReadWrite || member.access == Access::WriteOnly;
    if !counts && !members(device.od(), at.index).any(|member| is_writable(&member)) {
        return Err(AbortCode::READ_ONLY);
    }
    if let Some(count) = count.filter(|_| counts) {
        write_one(device, start, &[0])?;
        rest = write_members(device, at.index, highest, rest)?;
        write_one(device, start, &[count])?;
    } else {
        rest = write_members(device, at.index, highest, rest)?;
    }
    if rest.is_empty() { Ok(()) } else { Err(AbortCode::TOO_LONG) }
}

fn write_members<'a, D: ServedDevice + ?Sized>(
    device: &mut D,
    index: u16,
    highest: u64,
    mut rest: &'a [u8],
) -> Result<&'a [u8], AbortCode> {
    for sub in (1..=u8::MAX).take_while(|sub| u64::from(*sub) <= highest) {
        let member = Address::new(index, sub);
        let Ok(description) = device.od().describe(member) else { continue };
        let (bytes, behind) = rest.split_at_checked(description.capacity).ok_or(AbortCode::TOO_SHORT)?;
        if device.od().check_writable(member).is_ok() {
            write_one(device, member, bytes)?;
        }
        rest = behind;
    }
    Ok(rest)
}

/// Writes one object, with the rules of its device.
pub(super) fn write_one<D: ServedDevice + ?Sized>(device: &mut D, at: Address, data: &[u8]) -> Result<(), AbortCode> {
    device.od().check_write(at, data)?;
    device.before_write(at, data)?;
    device.od_mut().store(at, data);
    device.after_write(at);
    Ok(())
}
