//! Read and write access of a device's SDO server: the dictionary under the rules of its communication objects.

use super::super::communication::HEARTBEAT_PRODUCERS;
use super::super::{cob, pdo, sdo};
use super::application::Application;
use super::emergency::forget_history;
use crate::objects::{AbortCode, Address, DataType, ObjectDictionary, load_le};

/// Object that stores parameters, and the text "save" that has to be written to it.
const STORE: u16 = 0x1010;
const SAVE: u64 = u32::from_le_bytes(*b"save") as u64;
/// Object that restores what the device was delivered with, and the text "load" that has to be written to it.
const RESTORE: u16 = 0x1011;
const LOAD: u64 = u32::from_le_bytes(*b"load") as u64;

/// The objects of a device as its SDO server sees them.
pub(super) struct Service<'a, A> {
    pub(super) app: &'a mut A,
    /// The object that was written.
    pub(super) written: Option<Address>,
    /// Objects that are sent with another length than that of their type.
    pub(super) sent_lengths: &'a [(Address, usize)],
}

impl<A: Application> sdo::Objects for Service<'_, A> {
    fn read(&mut self, at: Address, value: &mut Vec<u8>) -> Result<(), AbortCode> {
        let od = self.app.od();
        od.read(at)?;
        if at.index == 0x1003 && u64::from(at.sub) > od.raw(0x1003, 0) {
            return Err(AbortCode::NO_DATA);
        }
        self.app.before_read(at)?;
        let od = self.app.od();
        value.extend_from_slice(od.read(at)?);
        if let Some((_, bytes)) = self.sent_lengths.iter().find(|(known, _)| *known == at) {
            let is_negative =
                od.data_type(at).is_some_and(DataType::is_signed) && value.last().is_some_and(|top| top >> 7 != 0);
            value.resize(*bytes, if is_negative { u8::MAX } else { 0 });
        }
        Ok(())
    }

    fn check_download(&self, at: Address, len: Option<usize>) -> Result<(), AbortCode> {
        match len {
            Some(len) => self.app.od().check_write_len(at, len),
            None => self.app.od().check_writable(at),
        }
    }

    fn size(&self, at: Address) -> Option<usize> {
        self.app.od().data_type(at)?.size()
    }

    fn write(&mut self, at: Address, value: &[u8]) -> Result<(), AbortCode> {
        let od = self.app.od();
        od.check_write(at, value)?;
        check_communication(od, at, load_le(value))?;
        self.app.before_write(at, value)?;
        let od = self.app.od_mut();
        match at.index {
            STORE => od.store_parameters(),
            RESTORE => od.forget_stored(),
            _ => od.store(at, value),
        }
        if at.index == 0x1003 {
            forget_history(od);
        }
        self.written = Some(at);
        self.app.after_write(at);
        Ok(())
    }
}

/// Rules of the communication objects beyond type, access and limits.
///
/// # Source
/// CiA 301, objects 1003h, 1005h, 1010h to 1012h, 1014h, 1016h, 1019h and those of the PDOs.
fn check_communication(od: &ObjectDictionary, at: Address, value: u64) -> Result<(), AbortCode> {
    match at.index {
        0x1003 if value != 0 => Err(AbortCode::VALUE),
        // This includes bit 30, a SYNC producer, which a device of this engine is not.
        0x1005 if cob::is_restricted(value as u32) => Err(AbortCode::VALUE),
        STORE if value != SAVE => Err(AbortCode::TRANSFER),
        RESTORE if value != LOAD => Err(AbortCode::TRANSFER),
        // Bit 31 makes the device a consumer; bit 30, a producer, is refused as for SYNC.
        0x1012 if cob::is_restricted(value as u32 & !cob::INVALID) => Err(AbortCode::VALUE),
        0x1019 if value == 1 => Err(AbortCode::VALUE),
        0x1019 if value != od.raw(0x1019, 0) && od.raw(0x1006, 0) != 0 => Err(AbortCode::DEVICE_STATE),
        0x1014 => pdo::check_cob_id(od.raw(0x1014, 0) as u32, value as u32),
        0x1016 => check_heartbeat_producer(od, at.sub, value),
        0x1400..=0x1bff => pdo::check_write(od, at, value),
        _ => Ok(()),
    }
}

/// One node may be watched by one entry only.
fn check_heartbeat_producer(od: &ObjectDictionary, sub: u8, value: u64) -> Result<(), AbortCode> {
    let (node, is_used) = ((value >> 16) & 0xff, value & 0xffff != 0);
    if value >> 24 != 0 || (is_used && node > 127) {
        return Err(AbortCode::VALUE);
    }
    let is_same = |other: u64| other & 0xffff != 0 && (other >> 16) & 0xff == node;
    let has_other = (1..=HEARTBEAT_PRODUCERS).any(|other| other != sub && is_same(od.raw(0x1016, other)));
    if is_used && node != 0 && has_other { Err(AbortCode::PARAMETER_INCOMPATIBLE) } else { Ok(()) }
}
