//! The device as the mailbox sees it: with the rules of CoE for the objects of the process data.

use super::super::process_data::{Flow, entry};
use yieldwall_fieldbus::ethercat::AlState;
use yieldwall_fieldbus::objects::{AbortCode, Address, ObjectDictionary, ServedDevice};

/// A device, and the state that it is in.
pub(super) struct Guarded<'a, D> {
    pub(super) device: &'a mut D,
    pub(super) state: AlState,
}

impl<D: ServedDevice> Guarded<'_, D> {
    /// Whether the objects that say what process data carry may be written so: in PRE-OP, with sub-index 0 at 0 first.
    fn check(&self, at: Address, data: &[u8]) -> Result<(), AbortCode> {
        let flow = [Flow::Outputs, Flow::Inputs];
        let Some(flow) = flow.into_iter().find(|flow| flow.assignment() == at.index || flow.has_mapping(at.index))
        else {
            return Ok(());
        };
        let (od, is_assignment) = (self.device.od(), flow.assignment() == at.index);
        if self.state != AlState::PreOperational {
            return Err(AbortCode::DEVICE_STATE);
        }
        let check = |raw: u32| -> Result<(), AbortCode> {
            match raw {
                0 => Ok(()),
                _ if is_assignment => {
                    let is_there = flow.has_mapping(raw as u16) && od.describe(Address::new(raw as u16, 0)).is_ok();
                    if is_there { Ok(()) } else { Err(AbortCode::VALUE) }
                }
                _ => {
                    let (mapped, bits) = entry(raw);
                    if mapped.index == 0 {
                        Ok(())
                    } else {
                        od.mappable_offset(mapped, bits, flow.mappable()).map(|_| ())
                    }
                }
            }
        };
        match (at.sub, data) {
            (0, &[count, ..]) => (1..=count).try_for_each(|sub| {
                od.describe(Address::new(at.index, sub)).map_err(|_| AbortCode::VALUE_HIGH)?;
                check(od.raw(at.index, sub) as u32)
            }),
            _ if od.raw(at.index, 0) != 0 => Err(AbortCode::SUB_ZERO_NOT_ZERO),
            _ => check(yieldwall_fieldbus::objects::load_le(data) as u32),
        }
    }
}

impl<D: ServedDevice> ServedDevice for Guarded<'_, D> {
    fn od(&self) -> &ObjectDictionary {
        self.device.od()
    }

    fn od_mut(&mut self) -> &mut ObjectDictionary {
        self.device.od_mut()
    }

    fn before_write(&mut self, at: Address, data: &[u8]) -> Result<(), AbortCode> {
        self.check(at, data)?;
        self.device.before_write(at, data)
    }

    fn after_write(&mut self, at: Address) {
        self.device.after_write(at);
    }

    fn before_read(&mut self, at: Address) -> Result<(), AbortCode> {
        self.device.before_read(at)
    }
}
