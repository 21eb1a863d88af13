//! SYNC, PDOs and SDO requests of a device.

use super::super::pdo::{self, NO_ID, Pdo, Reception, Rpdo, Tpdo};
use super::super::{EmcyCode, ErrorRegister, Frame, NmtState, Outbox, cob};
use super::application::Application;
use super::service::Service;
use super::{Node, SYNC_REST};
use crate::objects::ObjectDictionary;
use crate::time::Time;
use std::time::Duration;

impl Node {
    /// Synchronous RPDOs to the dictionary, then the device, then TPDOs.
    pub(super) fn on_sync(&mut self, now: Time, frame: &Frame, app: &mut impl Application, out: &mut impl Outbox) {
        let is_operational = self.state == NmtState::Operational;
        if !(is_operational || self.state == NmtState::PreOperational) {
            return;
        }
        self.synced_until = now + SYNC_REST;
        // Without a counter of its own (1019h) the device takes SYNC with and without one.
        if frame.len() > 1 || (self.has_sync_counter && frame.is_empty()) {
            let bits = ErrorRegister(ErrorRegister::COMMUNICATION);
            return self.raise_emergency(app.od_mut(), EmcyCode::SYNC_LENGTH, bits, [0, 0, 0, 0, 0], out);
        }
        if self.emergencies.has_any() {
            let message = self.emergencies.clear_one(app.od_mut(), EmcyCode::SYNC_LENGTH, 0);
            self.send_emergency(message, out);
        }
        self.window_until = if self.sync_window.is_zero() { Time::NEVER } else { now + self.sync_window };
        if is_operational {
            // A bit each.
            let mut are_applied = 0u64;
            for (at, rpdo) in self.rpdos.iter_mut().enumerate() {
                are_applied |= u64::from(rpdo.on_sync(app.od_mut())) << (at % 64);
            }
            for (_, place) in self.places.iter().enumerate().filter(|(at, _)| are_applied >> (at % 64) & 1 != 0) {
                app.outputs_applied(now, place + 1);
            }
        }
        app.sample(now);
        if is_operational {
            let count = frame.data().first().copied();
            for tpdo in &mut self.tpdos {
                if let Some(frame) = tpdo.on_sync(count, app.od()) {
                    out.push(frame);
                }
            }
        }
    }

    pub(super) fn on_rpdo(
        &mut self,
        now: Time,
        place: usize,
        frame: &Frame,
        app: &mut impl Application,
        out: &mut impl Outbox,
    ) {
        let Some(rpdo) = self.rpdos.get_mut(place).filter(|_| self.state == NmtState::Operational) else { return };
        // After the synchronous window (1007h) set-points wait for the next cycle's, and their deadline runs on.
        if rpdo.is_synchronous() && now > self.window_until {
            return;
        }
        let reception = rpdo.receive(now, frame, app.od_mut());
        self.next = self.next.min(rpdo.deadline());
        let number = self.places.get(place).map_or(0, |place| place + 1);
        if reception == Reception::TooShort {
            let bits = ErrorRegister(ErrorRegister::COMMUNICATION);
            return self.raise_emergency(app.od_mut(), EmcyCode::PDO_LENGTH, bits, [number, 0, 0, 0, 0], out);
        }
        if self.emergencies.has_any() {
            for code in [EmcyCode::PDO_LENGTH, EmcyCode::RPDO_TIMEOUT] {
                let message = self.emergencies.clear_one(app.od_mut(), code, number);
                self.send_emergency(message, out);
            }
        }
        if reception == Reception::Applied {
            app.outputs_applied(now, number);
        }
    }

    pub(super) fn poll_pdos(&mut self, now: Time, app: &mut impl Application, out: &mut impl Outbox) {
        for at in 0..self.rpdos.len() {
            let is_late = self.rpdos.get_mut(at).is_some_and(|rpdo| rpdo.is_late(now));
            if is_late {
                let number = self.places.get(at).map_or(0, |place| place + 1);
                let bits = ErrorRegister(ErrorRegister::COMMUNICATION);
                self.raise_emergency(app.od_mut(), EmcyCode::RPDO_TIMEOUT, bits, [number, 0, 0, 0, 0], out);
                app.outputs_late(now, number);
            }
        }
        for tpdo in &mut self.tpdos {
            if let Some(frame) = tpdo.poll(now, app.od()) {
                out.push(frame);
            }
        }
    }

    /// Segments of a block, repetitions and aborts that are due.
    pub(super) fn poll_sdo(&mut self, now: Time, out: &mut impl Outbox) {
        while self.answers.front().is_some_and(|(time, _)| now >= *time) {
            self.answers.pop_front().into_iter().for_each(|(_, frame)| out.push(frame));
        }
        let is_exchanging = self.state == NmtState::Operational || now < self.synced_until;
        let (id, due, is_slow) = (cob::sdo_response(self.id), now + self.sdo_time, !self.sdo_time.is_zero());
        let answers = &mut self.answers;
        let payload = self.sdo.poll(now, is_exchanging, |payload| {
            let frame = Frame::new(id, &payload);
            if is_slow {
                answers.push_back((due, frame));
            }
            is_slow || out.offer(frame)
        });
        if let Some(payload) = payload {
            self.answer(now, self.sdo_time, &payload, out);
        }
    }

    /// Answers after a time.
    fn answer(&mut self, now: Time, time: Duration, payload: &[u8; 8], out: &mut impl Outbox) {
        let frame = Frame::new(cob::sdo_response(self.id), payload);
        if time.is_zero() {
            out.push(frame);
        } else {
            self.answers.push_back((now + time, frame));
        }
    }

    /// Takes over a changed PDO parameter; other indices do nothing.
    pub(super) fn take_over_pdo(&mut self, now: Time, index: u16, od: &ObjectDictionary) {
        match pdo::locate(index) {
            Some((Pdo::Receive(place), _)) => {
                let fresh = Rpdo::new(od, place);
                let Some(at) = self.at(place) else { return };
                if let (Some(rpdo), Some(id)) = (self.rpdos.get_mut(at), self.rpdo_ids.get_mut(at)) {
                    *id = fresh.id();
                    *rpdo = fresh;
                }
            }
            Some((Pdo::Transmit(place), _)) => {
                if let Some(tpdo) = self.at(place).and_then(|at| self.tpdos.get_mut(at)) {
                    *tpdo = Tpdo::new(od, place);
                    if self.state == NmtState::Operational { tpdo.start(now) } else { tpdo.stop() }
                }
            }
            None => {}
        }
    }

    pub(super) fn on_sdo(&mut self, now: Time, frame: &Frame, app: &mut impl Application, out: &mut impl Outbox) {
        let is_served = matches!(self.state, NmtState::PreOperational | NmtState::Operational);
        if frame.len() != 8 || !is_served {
            return;
        }
        let mut service = Service { app, written: None, sent_lengths: &self.sent_lengths };
        let answer = self.sdo.on_request(now, frame.bytes(), &mut service);
        let written = service.written;
        if let Some(payload) = answer {
            let slow = self.write_times.iter().find(|(at, _)| Some(*at) == written);
            self.answer(now, slow.map_or(self.sdo_time, |(_, time)| *time), &payload, out);
        }
        let changed = written.map(|at| at.index).filter(|index| (0x1000..0x2000).contains(index));
        self.poll_sdo(now, out);
        if let Some(index) = changed {
            self.take_over(now, index, app.od());
            // The watch starts anew, and with it the errors it found.
            if index == 0x1016 {
                self.clear_emergency(app.od_mut(), EmcyCode::HEARTBEAT, out);
            }
        }
        self.next = self.earliest();
    }
}

// An unused PDO must never match a frame.
const _: () = assert!(NO_ID > 0x7ff);
