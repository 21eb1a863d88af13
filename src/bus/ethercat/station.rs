//! State of one device of the rig as the master sees it, and the place of its process data.

use super::failure::SegmentFailure;
use super::held::Held;
use super::limits::Limits;
use super::setup::{Acts, MOST_ENTRIES, Mapped, ProcessData, StationSetup};
use super::writes::Altered;
use crate::axis::{DriveOrders, DriveWords};
use crate::sample::NO_SAMPLE;
use crate::script::Script;
use crate::turns::Turns;
use std::time::Duration;
use yieldwall_drives::cia402::State;
use yieldwall_drives::profiles::Quantity;
use yieldwall_fieldbus::ethercat::mailbox::MailboxClient;
use yieldwall_fieldbus::ethercat::sii::{MailboxArea, Sii};
use yieldwall_fieldbus::ethercat::{AlState, AlStatus, AlStatusCode};
use yieldwall_fieldbus::objects::{Address, ObjectAnswer, ObjectError, ObjectRequest, load_le, mask, sign_extend};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::guard::{Device, DeviceSet};
use yieldwall_motion::sensing::RawSample;

/// Station addresses of devices: this and their position.
pub(super) const FIRST_STATION: u16 = 0x1000;
/// Distance between the logical addresses of devices; inputs lie half of it from outputs.
const STRIDE: u32 = 0x1000;
const FIRST_LOGICAL: u32 = 0x1_0000;
/// Time for which an answer stays for whoever has asked, before limits are asked for.
const ANSWER_STAYS: Duration = Duration::from_millis(200);

/// Time for which a drive may be in Operation Enabled in SAFE-OP: its own stop takes less.
const KEEPS_TORQUE: Duration = Duration::from_millis(300);

/// How far a drive was brought that keeps its torque in SAFE-OP.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Disarming {
    No,
    /// It has been in Operation Enabled since then.
    Seen(Time),
    /// Disable Voltage was written to the controlword of this number.
    Asked(usize),
    /// It is asked for PRE-OP.
    Leaves,
}

/// Bits that a value in process data has at most.
const MOST_BITS: u8 = 32;

/// A value in process data: its first bit, and its bits, 1 to 32.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Field {
    bit: usize,
    bits: u8,
}

/// Process data of one direction.
#[derive(Clone, Debug)]
pub(super) struct Area {
    pub(super) logical: u32,
    pub(super) len: usize,
    /// Values that mean something to the rig, of the drive of a joint, or of a sensor.
    fields: Vec<(usize, Quantity, Field)>,
    /// Values of outputs that are nothing to the rig.
    constants: Vec<(Field, i32)>,
}

impl Area {
    fn new(logical: u32, pdos: &[ProcessData]) -> Result<Self, SegmentFailure> {
        let mut area = Area { logical, len: 0, fields: Vec::new(), constants: Vec::new() };
        let mut bit = 0;
        for ProcessData { index, entries, .. } in pdos {
            if entries.len() > MOST_ENTRIES.into() {
                return Err(SegmentFailure::TooManyObjects { index: *index, objects: entries.len() });
            }
        }
        let all = pdos.iter().flat_map(|pdo| pdo.entries.iter().map(|entry| (joint(pdo.device), entry)));
        for (joint, Mapped { at, bits, quantity, value }) in all {
            let field = Field { bit, bits: (*bits).min(MOST_BITS) };
            let is_used = quantity.is_some() || *value != 0;
            if *bits == 0 || is_used && *bits > MOST_BITS {
                return Err(SegmentFailure::Bits { index: at.index, sub: at.sub, bits: *bits });
            }
            match *quantity {
                Some(quantity) => area.fields.push((joint, quantity, field)),
                None if *value != 0 => area.constants.push((field, *value)),
                None => {}
            }
            bit += usize::from(*bits);
        }
        area.len = bit.div_ceil(8);
        Ok(area)
    }
}

impl Field {
    /// The bytes that the value lies in, and how far from the first bit of them.
    fn place(&self) -> (std::ops::Range<usize>, usize) {
        (self.bit / 8..(self.bit + usize::from(self.bits)).div_ceil(8), self.bit % 8)
    }

    /// The value as unsigned.
    fn get(&self, data: &[u8]) -> u64 {
        let (bytes, shift) = self.place();
        load_le(data.get(bytes).unwrap_or_default()) >> shift & mask(self.bits)
    }

    /// The value with its sign.
    fn get_signed(&self, data: &[u8]) -> i32 {
        sign_extend(self.get(data), self.bits) as i32
    }

    fn put(&self, data: &mut [u8], value: i32) {
        let (bytes, shift) = self.place();
        let to = data.get_mut(bytes).unwrap_or_default();
        let taken = mask(self.bits) << shift;
        let word = load_le(to) & !taken | (value as u64) << shift & taken;
        to.iter_mut().zip(word.to_le_bytes()).for_each(|(to, byte)| *to = byte);
    }
}

/// The joint that a device is the drive of; 0 for a sensor.
const fn joint(device: Device) -> usize {
    match device {
        Device::LeftDrive | Device::Sensor => 0,
        Device::RightDrive => 1,
    }
}

/// The controlwords among outputs.
fn controlwords(outputs: &[ProcessData]) -> Vec<Address> {
    let entries = outputs.iter().flat_map(|pdo| &pdo.entries);
    entries.filter(|entry| entry.quantity == Some(Quantity::Controlword)).map(|entry| entry.at).collect()
}

/// One device of the rig.
#[derive(Clone, Debug)]
pub(super) struct Station {
    pub(super) setup: StationSetup,
    pub(super) address: u16,
    pub(super) mailbox: MailboxClient,
    pub(super) script: Script,
    pub(super) sii: Option<Sii>,
    pub(super) outputs: Area,
    pub(super) inputs: Area,
    pub(super) status: AlStatus,
    pub(super) code: AlStatusCode,
    /// Its registers as they were set.
    pub(super) held: Held,
    /// Its objects as they were set.
    limits: Limits,
    /// Since when nothing that was asked is open.
    answered_at: Option<Time>,
    /// First register or object that a foreign master has set since the network was started.
    pub(super) altered: Option<Altered>,
    /// How far a drive was brought that keeps its torque in SAFE-OP.
    disarming: Disarming,
    /// State that is requested from the device so that it takes no more outputs; `None` if it is there.
    pub(super) wanted: Option<AlState>,
    /// Whether it was asked for more than INIT since the network was started.
    pub(super) is_led: bool,
    /// Whether its status came in this cycle.
    pub(super) has_status: bool,
    /// Whether its status came with the last input frame that came back.
    pub(super) was_there: bool,
    /// State and code with which it left OP since the network was started.
    pub(super) left: Option<(AlStatus, AlStatusCode)>,
    /// Whether its inputs came in this cycle, and what they were.
    pub(super) has_inputs: bool,
    /// Words of the drives of both joints, as far as they are this device.
    words: [DriveWords; 2],
    /// Controlwords of its drives.
    controlwords: Vec<Address>,
    /// Turns of its drives to ask for objects.
    turns: Turns,
    sample: Option<RawSample>,
    sampled_at: Time,
    /// How far its clock is from that of the reference, when that was read last.
    pub(super) difference_ns: Option<i64>,
    /// That difference at the moment when its clock was lost.
    pub(super) lost_ns: Option<i64>,
    /// Cycles in which it did not take its outputs.
    pub(super) outputs_missed: u64,
    /// Cycles in which its inputs did not come.
    pub(super) inputs_missed: u64,
}

impl Station {
    pub(super) fn new(setup: &StationSetup) -> Result<Self, SegmentFailure> {
        let logical = FIRST_LOGICAL + STRIDE * u32::from(setup.position);
        let address = FIRST_STATION + setup.position;
        let steps = setup.script();
        let is_mapped = |at| setup.outputs.iter().flat_map(|pdo| &pdo.entries).any(|entry| entry.at == at);
        let limits = Limits::of(&steps, is_mapped);
        Ok(Station {
            address,
            mailbox: MailboxClient::new(address, setup.waits.sdo),
            script: Script::new(setup.identity.clone(), setup.waits.sdo, steps),
            sii: None,
            outputs: Area::new(logical, &setup.outputs)?,
            inputs: Area::new(logical + STRIDE / 2, &setup.inputs)?,
            status: AlStatus::new(AlState::Init, false),
            code: AlStatusCode::NONE,
            held: Held::default(),
            limits,
            answered_at: None,
            altered: None,
            disarming: Disarming::No,
            wanted: None,
            is_led: false,
            has_status: false,
            was_there: false,
            left: None,
            has_inputs: false,
            words: Default::default(),
            controlwords: controlwords(&setup.outputs),
            turns: Turns::new(setup.axes.map(|axis| axis.offset)),
            sample: None,
            sampled_at: Time(0),
            difference_ns: None,
            lost_ns: None,
            outputs_missed: 0,
            inputs_missed: 0,
            setup: setup.clone(),
        })
    }

    /// Forgets all that was heard of it.
    pub(super) fn restart(&mut self) {
        self.script.restart();
        self.mailbox.start(MailboxArea::default(), MailboxArea::default());
        self.sii = None;
        (self.status, self.code) = (AlStatus::new(AlState::Init, false), AlStatusCode::NONE);
        (self.difference_ns, self.lost_ns) = (None, None);
        (self.was_there, self.left) = (false, None);
        (self.altered, self.is_led, self.disarming, self.wanted) = (None, false, Disarming::No, None);
        self.held.forget();
        self.limits.restart();
        self.answered_at = None;
        self.turns.restart();
        self.forget_missed();
        self.begin_cycle();
    }

    /// Restarts the counts of missing inputs and of outputs that were not taken.
    pub(super) fn forget_missed(&mut self) {
        (self.outputs_missed, self.inputs_missed) = (0, 0);
    }

    /// Reads or writes an object for a caller.
    pub(super) fn ask(&mut self, now: Time, request: ObjectRequest<'_>) -> Result<(), ObjectError> {
        if std::mem::take(&mut self.limits.is_asked) {
            self.mailbox.forget();
        }
        self.mailbox.ask(now, request)?;
        if let ObjectRequest::Write(at, _) = request {
            self.limits.note_write(at);
        }
        Ok(())
    }

    /// Sends a request for one of its drives, or for the sensor.
    pub(super) fn ask_as(&mut self, now: Time, device: Device, request: ObjectRequest<'_>) -> Result<(), ObjectError> {
        let mut turns = self.turns;
        let begun = turns.begin(device, self.answer());
        self.turns = turns;
        begun?;
        self.ask(now, turns.moved(device, request))?;
        self.turns.note_asked(device);
        Ok(())
    }

    /// How that has ended which was asked as `device`.
    ///
    /// Real-time: yes.
    pub(super) fn answer_to(&self, device: Device) -> ObjectAnswer<'_> {
        self.turns.answer(device, self.answer())
    }

    /// How that has ended.
    ///
    /// Real-time: yes.
    pub(super) fn answer(&self) -> ObjectAnswer<'_> {
        if self.limits.is_asked { ObjectAnswer::NotAsked } else { self.mailbox.answer() }
    }

    /// Makes the device leave OP, so that it takes no outputs any more. If a drive stays in Operation Enabled in SAFE-OP while
    /// the drives are being stopped, the master sends Disable Voltage through the mailbox and then requests PRE-OP.
    ///
    /// Real-time: yes.
    pub(super) fn disarm(&mut self, now: Time, leaves: bool, is_stopping: bool) {
        let state = self.status.state().filter(|_| self.has_status);
        if !leaves || state == Some(AlState::Operational) || state.is_none() {
            self.wanted = leaves.then_some(AlState::SafeOperational);
            return;
        }
        let is_enabled = |words: &DriveWords| {
            words.statusword.is_some_and(|word| State::decode(word) == Some(State::OperationEnabled))
        };
        let is_enabled = is_stopping && state == Some(AlState::SafeOperational) && self.words.iter().any(is_enabled);
        match self.disarming {
            Disarming::No if is_enabled => self.disarming = Disarming::Seen(now),
            Disarming::Seen(_) if !is_enabled => self.disarming = Disarming::No,
            Disarming::Seen(since) if now.since(since) >= KEEPS_TORQUE => {
                self.disable(now, 0);
            }
            Disarming::Asked(axis) if self.answer() != ObjectAnswer::Pending => self.disable(now, axis + 1),
            _ => {}
        }
        let is_left = matches!(state, Some(AlState::PreOperational | AlState::Init));
        self.wanted = (self.disarming == Disarming::Leaves && !is_left).then_some(AlState::PreOperational);
    }

    /// Sends Disable Voltage to the drive of this controlword; after the last drive only PRE-OP is left.
    fn disable(&mut self, now: Time, axis: usize) {
        let Some(at) = self.controlwords.get(axis).copied() else {
            self.disarming = Disarming::Leaves;
            return;
        };
        // While another request runs the next cycle tries again; without an answer PRE-OP is what is left.
        if self.ask(now, ObjectRequest::Write(at, &[0, 0])) != Err(ObjectError::Busy) {
            self.disarming = Disarming::Asked(axis);
        }
    }

    /// Reads one of its limits, if one is due and no other request waits.
    ///
    /// Real-time: yes.
    pub(super) fn check_limits(&mut self, now: Time) {
        if self.mailbox.answer() == ObjectAnswer::Pending {
            self.answered_at = None;
            return;
        }
        let answered_at = *self.answered_at.get_or_insert(now);
        if now.since(answered_at) >= ANSWER_STAYS
            && !self.mailbox.is_busy()
            && let Some(request) = self.limits.due(now)
        {
            self.limits.is_asked = self.mailbox.ask(now, request).is_ok();
        }
    }

    /// Returns the new state of one of its limits after a read.
    ///
    /// Real-time: yes.
    pub(super) fn take_limit(&mut self) -> Option<Altered> {
        if !self.limits.is_asked || self.mailbox.answer() == ObjectAnswer::Pending {
            return None;
        }
        let altered = self.limits.take(self.mailbox.answer());
        self.mailbox.forget();
        altered
    }

    /// Whether its clock is one that SYNC0 comes from.
    pub(super) fn is_synchronous(&self) -> bool {
        self.setup.acts != Acts::ByItself
    }

    /// Begins a cycle. Data of the cycle before are not used again.
    ///
    /// Real-time: yes.
    pub(super) fn begin_cycle(&mut self) {
        (self.has_inputs, self.has_status) = (false, false);
        (self.words, self.sample) = (Default::default(), None);
    }

    /// Notes that the device did not take its outputs, or that this is unknown. Returns its drives, if any.
    ///
    /// Real-time: yes.
    pub(super) fn miss_outputs(&mut self) -> DeviceSet {
        self.outputs_missed = self.outputs_missed.saturating_add(1);
        self.setup.devices & DeviceSet::DRIVES
    }

    /// Takes the inputs of this cycle.
    ///
    /// Real-time: yes.
    pub(super) fn take_inputs(&mut self, now: Time, data: &[u8]) {
        self.has_inputs = true;
        self.sampled_at = now;
        let mut sample = NO_SAMPLE;
        let mut has_counts = false;
        for (joint, quantity, field) in &self.inputs.fields {
            let Some(words) = self.words.get_mut(*joint) else { continue };
            match *quantity {
                Quantity::Statusword => words.statusword = Some(field.get(data) as u16),
                Quantity::PositionActual => words.position = Some(field.get_signed(data)),
                quantity => {
                    has_counts |= self.setup.codec.take(quantity, field.get(data), field.bits, &mut sample);
                }
            }
        }
        self.sample = has_counts.then_some(sample);
    }

    /// Words of the drives in this cycle, each with its joint.
    ///
    /// Real-time: yes.
    pub(super) fn words(&self) -> impl Iterator<Item = (usize, DriveWords)> {
        let own = |device: &Device| self.setup.devices.contains(device.set());
        let drives = Device::DRIVES.into_iter().zip(self.words).enumerate();
        drives.filter(move |(_, (device, _))| own(device)).map(|(joint, (_, words))| (joint, words))
    }

    /// Returns the sample of a sensor in this cycle.
    ///
    /// Real-time: yes.
    pub(super) fn sample(&self, now: Time) -> Option<RawSample> {
        let age_ns = now.since(self.sampled_at).as_nanos().min(u128::from(u32::MAX)) as u32;
        self.sample.map(|sample| RawSample { age_ns, ..sample })
    }

    /// Writes what its drives are sent, and the constants of a drive or a sensor, into its outputs, which are 0 before.
    ///
    /// Real-time: yes.
    pub(super) fn put_outputs(&self, orders: &[DriveOrders; 2], data: &mut [u8]) {
        for (field, value) in &self.outputs.constants {
            field.put(data, *value);
        }
        for (joint, quantity, field) in &self.outputs.fields {
            let Some((orders, axis)) = orders.get(*joint).zip(self.setup.axes.get(*joint)) else { continue };
            if *quantity == Quantity::Controlword {
                field.put(data, orders.controlword.into());
            } else if self.setup.set_point == Some(*quantity) {
                field.put(data, orders.target);
            } else if let (Quantity::DigitalOutputs, Some(words)) = (*quantity, axis.brake) {
                field.put(data, words.word(orders.releases) as i32);
            }
        }
    }

    /// How messages name it.
    pub(super) fn title(&self) -> String {
        format!("{} (position {})", self.setup.name, self.setup.position)
    }

    /// Returns the first part of a device's SII that differs from the rig: its name, the expected value, the value found.
    pub(super) fn mismatch(&self, sii: &Sii) -> Option<(&'static str, String, u32)> {
        let wanted = &self.setup.identity;
        if sii.vendor_id != wanted.vendor_id {
            return Some(("the vendor", format!("{:#x}", wanted.vendor_id), sii.vendor_id));
        }
        if !wanted.product_codes.contains(&sii.product_code) {
            let codes: Vec<String> = wanted.product_codes.iter().map(|code| format!("{code:#x}")).collect();
            return Some(("the product code", codes.join(" or "), sii.product_code));
        }
        if !wanted.revisions.includes(sii.revision) {
            return Some(("the revision", wanted.revisions.to_string(), sii.revision));
        }
        if let Some(serial) = self.setup.serial.filter(|serial| *serial != sii.serial) {
            return Some(("the serial number", format!("{serial:#x}"), sii.serial));
        }
        let alias = self.setup.alias.filter(|alias| *alias != sii.alias)?;
        Some(("the alias", format!("{alias:#x}"), sii.alias.into()))
    }
}

/// The sample that a sensor sends by these inputs.
#[cfg(test)]
pub(crate) fn sample_of(setup: &StationSetup, inputs: &[u8]) -> Option<RawSample> {
    let mut station = Station::new(setup).ok()?;
    station.take_inputs(Time(0), inputs);
    station.sample(Time(0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn mapped(bits: u8, quantity: Option<Quantity>, value: i32) -> Mapped {
        Mapped { at: Address::new(0x2000, 0), bits, quantity, value }
    }

    fn area(entries: Vec<Mapped>) -> Result<Area, SegmentFailure> {
        Area::new(0, &[ProcessData { device: Device::LeftDrive, index: 0x1600, is_fixed: true, entries }])
    }

    #[test]
    fn words_lie_one_behind_the_other_to_the_bit() {
        let entries = vec![
            mapped(5, None, 0),
            mapped(16, Some(Quantity::Controlword), 0),
            mapped(3, None, -1),
            mapped(32, Some(Quantity::TargetPosition), 0),
            mapped(201, None, 0),
        ];
        let area = area(entries).unwrap();
        assert_eq!(area.len, 33);
        let mut data = [0; 33];
        area.constants.iter().for_each(|(field, value)| field.put(&mut data, *value));
        area.fields[0].2.put(&mut data, 0x0f1f);
        area.fields[1].2.put(&mut data, -2);
        assert_eq!(data[..8], [0xe0, 0xe3, 0xe1, 0xfe, 0xff, 0xff, 0xff, 0x00]);
        assert_eq!((area.fields[0].2.get(&data), area.fields[1].2.get_signed(&data)), (0x0f1f, -2));
    }

    #[test]
    fn an_entry_without_bits_and_a_word_that_is_too_long_are_refused() {
        for entry in [mapped(0, None, 0), mapped(33, Some(Quantity::Statusword), 0), mapped(33, None, 1)] {
            assert!(matches!(area(vec![entry]), Err(SegmentFailure::Bits { index: 0x2000, .. })), "{entry:?}");
        }
    }

    proptest! {
        #[test]
        fn a_value_is_read_as_it_was_written_and_leaves_the_rest(
            bit in 0usize..96, bits in 1u8..=32, value: i32, before: [u8; 16],
        ) {
            let field = Field { bit, bits };
            let mut data = before;
            field.put(&mut data, value);
            let shift = 32 - u32::from(bits);
            prop_assert_eq!(field.get_signed(&data), (value << shift) >> shift);
            let bits_of = |data: [u8; 16]| u128::from_le_bytes(data);
            let own = u128::from(u32::MAX >> shift) << bit;
            prop_assert_eq!((bits_of(data) ^ bits_of(before)) & !own, 0);
        }

        #[test]
        fn short_data_never_panic(bit in 0usize..200, bits in 1u8..=32, mut data: Vec<u8>) {
            let field = Field { bit, bits };
            field.put(&mut data, -1);
            let _ = (field.get(&data), field.get_signed(&data));
        }
    }
}
