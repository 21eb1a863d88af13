//! Node guarding, TIME and LSS of a device.

use super::super::lss::LssEvent;
use super::super::{EmcyCode, Frame, NmtState, NodeId, Outbox, cob, time};
use super::application::Application;
use super::{LIFE_GUARDING, Node, PDOS};
use crate::objects::{Address, ObjectDictionary, Reset};
use crate::time::Time;

impl Node {
    /// Handles a remote frame: node guarding, which a device with a heartbeat does not do. PDOs are not sent on request.
    pub(super) fn on_remote(&mut self, now: Time, id: u16, app: &mut impl Application, out: &mut impl Outbox) {
        let is_guarded = self.state != NmtState::Initialising && self.heartbeat_period.is_zero();
        if id != cob::heartbeat(self.id) || !is_guarded {
            return;
        }
        let (answer, was_lost) = self.life_guard.answer(now, self.id, self.state);
        out.push(answer);
        if was_lost {
            let message = self.emergencies.clear_one(app.od_mut(), EmcyCode::HEARTBEAT, LIFE_GUARDING);
            self.send_emergency(message, out);
            app.on_life_guarding(now, false);
        }
        self.next = self.earliest();
    }

    pub(super) fn on_time(&mut self, now: Time, frame: &Frame, app: &mut impl Application) {
        if let (Some(time), NmtState::PreOperational | NmtState::Operational) = (time::decode(frame), self.state) {
            app.on_time(now, time);
        }
    }

    pub(super) fn on_lss(&mut self, now: Time, frame: &Frame, app: &mut impl Application, out: &mut impl Outbox) {
        if frame.len() != 8 || !self.is_powered {
            return;
        }
        let (answer, event) = self.lss.on_request(frame.bytes());
        if let Some(payload) = answer {
            out.push(Frame::new(cob::LSS_ANSWER, &payload));
        }
        match event {
            Some(LssEvent::Configured) => self.reset(now, Reset::Node, app, out),
            Some(LssEvent::BitRate { bit_rate, delay }) => app.on_bit_rate(now, bit_rate, delay),
            None => {}
        }
    }

    /// Takes a node id over, and with it the identifiers that follow it: those of the predefined connection set.
    pub(super) fn take_node_id(&mut self, id: NodeId, od: &mut ObjectDictionary) {
        let before = std::mem::replace(&mut self.id, id);
        if before == id {
            return;
        }
        let mut follow = |index: u16, sub: u8, old: u16, new: u16| {
            let is_default = |raw: u32| raw & 0x1fff_ffff == u32::from(old);
            let change = |raw| if is_default(raw) { raw & 0xe000_0000 | u32::from(new) } else { raw };
            od.change_everywhere(Address::new(index, sub), change);
        };
        follow(0x1014, 0, cob::emcy(before), cob::emcy(id));
        follow(0x1200, 1, cob::sdo_request(before), cob::sdo_request(id));
        follow(0x1200, 2, cob::sdo_response(before), cob::sdo_response(id));
        for (place, number) in (0..PDOS as u16).zip(1..) {
            for (base, of) in [(0x1400, cob::rpdo as fn(u8, NodeId) -> Option<u16>), (0x1800, cob::tpdo)] {
                if let (Some(old), Some(new)) = (of(number, before), of(number, id)) {
                    follow(base + place, 1, old, new);
                }
            }
        }
    }
}
