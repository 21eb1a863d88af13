//! Active errors of a device: error register 1001h, history 1003h and emergency messages.

use super::super::communication::ERROR_HISTORY;
use super::super::pdo::NO_ID;
use super::super::{CanopenError, EmcyCode, ErrorRegister, Frame, cob, emcy};
use crate::objects::{Address, Handle, ObjectDictionary};

/// Most errors that are active at once; one more is reported but cannot be cleared alone.
const MAX_ACTIVE: usize = 16;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Active {
    code: EmcyCode,
    source: u8,
    bits: u8,
}

/// Keeps track of active errors.
#[derive(Clone, Debug)]
pub(super) struct Emergencies {
    id: u16,
    register: Handle<u8>,
    history: [Handle<u32>; ERROR_HISTORY as usize],
    count: Handle<u8>,
    active: [Option<Active>; MAX_ACTIVE],
    active_count: usize,
}

impl Emergencies {
    pub(super) fn new(od: &ObjectDictionary) -> Result<Self, CanopenError> {
        let mut history = [Handle::NOWHERE; ERROR_HISTORY as usize];
        for (handle, sub) in history.iter_mut().zip(1..) {
            *handle = od.handle(0x1003, sub)?;
        }
        let mut emergencies = Emergencies {
            id: NO_ID,
            register: od.handle(0x1001, 0)?,
            history,
            count: od.handle(0x1003, 0)?,
            active: [None; MAX_ACTIVE],
            active_count: 0,
        };
        od.handle::<u32>(0x1014, 0)?;
        emergencies.reload(od);
        Ok(emergencies)
    }

    /// Takes over 1014h.
    pub(super) fn reload(&mut self, od: &ObjectDictionary) {
        let cob_id = od.raw(0x1014, 0) as u32;
        self.id = if cob_id & cob::INVALID == 0 { (cob_id & 0x7ff) as u16 } else { NO_ID };
    }

    /// Forgets all errors, as after a reset.
    pub(super) fn reset(&mut self) {
        self.active = [None; MAX_ACTIVE];
        self.active_count = 0;
    }

    /// Whether any error is active.
    pub(super) fn has_any(&self) -> bool {
        self.active_count > 0
    }

    /// Registers an error; returns the message to send unless the error was active already. `vendor[0]` distinguishes errors of one code.
    pub(super) fn raise(
        &mut self,
        od: &mut ObjectDictionary,
        code: EmcyCode,
        bits: ErrorRegister,
        vendor: [u8; 5],
    ) -> Option<Frame> {
        let error = Active { code, source: vendor[0], bits: bits.0 | ErrorRegister::GENERIC };
        let is_same = |active: &Active| active.code == error.code && active.source == error.source;
        if code.is_reset() || self.active.iter().flatten().any(is_same) {
            return None;
        }
        if let Some(free) = self.active.iter_mut().find(|slot| slot.is_none()) {
            *free = Some(error);
            self.active_count += 1;
        }
        let register = od.get(self.register) | error.bits;
        od.set(self.register, register);
        self.remember(od, code, vendor);
        self.message(code, register, vendor)
    }

    /// Clears the errors that `is_gone` selects; the message to send if there were any.
    fn clear(&mut self, od: &mut ObjectDictionary, is_gone: impl Fn(&Active) -> bool) -> Option<Frame> {
        let before = self.active_count;
        for slot in &mut self.active {
            if slot.as_ref().is_some_and(&is_gone) {
                *slot = None;
                self.active_count -= 1;
            }
        }
        if self.active_count == before {
            return None;
        }
        let register = self.active.iter().flatten().fold(0, |register, active| register | active.bits);
        od.set(self.register, register);
        self.message(EmcyCode::RESET, register, [0; 5])
    }

    pub(super) fn clear_code(&mut self, od: &mut ObjectDictionary, code: EmcyCode) -> Option<Frame> {
        self.clear(od, |active| active.code == code)
    }

    pub(super) fn clear_one(&mut self, od: &mut ObjectDictionary, code: EmcyCode, source: u8) -> Option<Frame> {
        self.clear(od, |active| active.code == code && active.source == source)
    }

    pub(super) fn clear_all(&mut self, od: &mut ObjectDictionary) -> Option<Frame> {
        self.clear(od, |_| true)
    }

    /// Puts an error first into 1003h; the oldest one drops out.
    fn remember(&self, od: &mut ObjectDictionary, code: EmcyCode, vendor: [u8; 5]) {
        let [first, second, ..] = vendor;
        let mut entry = u32::from(code.0) | u32::from(first) << 16 | u32::from(second) << 24;
        for &handle in &self.history {
            let older = od.get(handle);
            od.set(handle, entry);
            entry = older;
        }
        od.set(self.count, od.get(self.count).saturating_add(1).min(ERROR_HISTORY));
    }

    fn message(&self, code: EmcyCode, register: u8, vendor: [u8; 5]) -> Option<Frame> {
        (self.id != NO_ID).then(|| emcy::frame(self.id, code, ErrorRegister(register), vendor))
    }
}

/// Empties 1003h, as writing 0 to its sub-index 0 asks for.
pub(super) fn forget_history(od: &mut ObjectDictionary) {
    for sub in 1..=ERROR_HISTORY {
        od.store(Address::new(0x1003, sub), &[0; 4]);
    }
}
