//! Checks of a device profile against the standards and against itself.

use yieldwall_drives::cia402::State;
use yieldwall_drives::profiles::{
    BrakeHolder, DeviceProfile, Entry, Fieldbus, ForceSensor, HeartbeatWatch, Homing, Limits, Numbers, Pdo, PdoMap,
    Quantity, Revisions, Role, Scaling, Servo, SetPointWatch, Setting, SyncWatch, Unused,
};

use super::Findings;
use crate::suggest::nearest;

/// First index of an object; the indices before it are types of data, and stand for gaps in a mapping.
const COMMUNICATION: u16 = 0x1000;
/// Distance of the objects of two axes in CiA 402.
const AXIS_STEP: u16 = 0x800;
/// Bytes of a CAN frame, and number of PDOs of a direction that have CANopen identifiers.
const FRAME_BYTES: usize = 8;
const CANOPEN_PDOS: u16 = 4;
/// Largest number of PDOs of a direction.
const MOST_PDOS: u16 = 512;
/// Largest number of bits of an object, of a value that the master reads or writes, and of a gap.
const OBJECT_BITS: u8 = 64;
const VALUE_BITS: u8 = 32;
/// Abort connection option code and quick stop option code of CiA 402.
const ABORT_CONNECTION: u16 = 0x6007;
const QUICK_STOP: u16 = 0x605a;
/// Bits of the statusword that CiA 402 leaves to the manufacturer.
const REFERENCED_BITS: [u8; 3] = [8, 14, 15];

/// All rules of a profile.
pub(crate) fn check_profile(findings: &mut Findings, profile: &DeviceProfile) {
    if let Revisions::Range { from, to } = profile.identity.revisions
        && from > to
    {
        let message = format!("`identity.revisions` goes from {from:#x} to {to:#x}, and no revision lies between them");
        findings.error("identity.revisions", message, "write the lower end at `from`, or `any`");
    }
    match &profile.device {
        Role::Servo(servo) => check_servo(findings, profile, servo),
        Role::ForceSensor(sensor) => check_sensor(findings, profile, sensor),
    }
}

fn check_servo(findings: &mut Findings, profile: &DeviceProfile, servo: &Servo) {
    let mut check = Checked { findings, profile };
    let own = &servo.objects;
    let at = |key: &str| format!("device.servo.objects.{key}");
    for (key, entry, bits) in [
        ("controlword", &own.controlword, 16),
        ("statusword", &own.statusword, 16),
        ("mode_of_operation", &own.mode_of_operation, 8),
        ("mode_display", &own.mode_display, 8),
        ("supported_modes", &own.supported_modes, 32),
        ("position_actual", &own.position_actual, 32),
    ] {
        check.entry(&at(key), entry, Some(bits));
    }
    for (key, entry, bits) in [
        ("target_position", &own.target_position, 32),
        ("target_velocity", &own.target_velocity, 32),
        ("target_torque", &own.target_torque, 16),
    ] {
        check.optional(&at(key), entry.as_ref(), bits);
    }
    if let Some(cycle_time) = &own.cycle_time {
        check.entry(&at("cycle_time.value"), &cycle_time.value, Some(8));
        check.entry(&at("cycle_time.exponent"), &cycle_time.exponent, Some(8));
    }
    let limits = &servo.limits;
    check.optional("device.servo.limits.torque", limits.torque.as_ref(), 16);
    check.current_limit(limits);
    check.optional("device.servo.limits.following_error", limits.following_error.as_ref(), 32);
    if let Some(speed) = &limits.motor_speed {
        for (key, entry) in
            [("limit", &speed.limit), ("increments", &speed.increments), ("revolutions", &speed.revolutions)]
        {
            check.entry(&format!("device.servo.limits.motor_speed.{key}"), entry, Some(32));
        }
    }
    check.option_codes(servo);
    for (index, setting) in servo.settings.iter().enumerate() {
        check.setting(&format!("device.servo.settings[{index}]"), Some(setting), None);
    }
    check.watchdogs(servo);
    if let Some(homing) = &servo.homing {
        check.homing(homing);
    }
    if !servo.mode_changes_in.contains(&State::SwitchOnDisabled) {
        check.findings.error(
            "device.servo.mode_changes_in",
            "`device.servo.mode_changes_in` lacks `switch_on_disabled`, in which the mode is set",
            "a drive whose mode cannot change there cannot be used",
        );
    }
    let modes = servo.process_data.modes();
    if modes.iter().all(|mode| mode.3.is_none()) {
        check.findings.error(
            "device.servo.process_data",
            "`device.servo.process_data` has no mode",
            "write the process data of `torque`, `velocity` or `position`",
        );
    }
    for (_, word, set_point, map) in modes {
        let Some(map) = map else { continue };
        let key = format!("device.servo.process_data.{word}");
        let is_braked = servo.brake.of_master().is_some();
        let brake = is_braked.then_some(Quantity::DigitalOutputs);
        let sent: Vec<Quantity> = [Quantity::Controlword, set_point].into_iter().chain(brake).collect();
        check.pdos(&format!("{key}.rpdo"), &map.rpdo, &sent);
        check.computed(&format!("{key}.rpdo"), servo, &map.rpdo);
        check.pdos(&format!("{key}.tpdo"), &map.tpdo, &[Quantity::Statusword, Quantity::PositionActual]);
        check.drive_pdos(&key, map, set_point);
        if is_braked && !map.rpdo.iter().any(|pdo| pdo.maps.contains(&Quantity::DigitalOutputs)) {
            let message = format!("`{key}.rpdo` does not carry `digital_outputs`, by which the brake is held");
            let help = match set_point {
                Quantity::TargetTorque => "map it behind the set-point",
                _ => "map it behind the set-point; a frame of CAN has no room beside a target of 32 bits, EtherCAT has",
            };
            check.findings.error(&format!("{key}.rpdo"), message, help);
        }
    }
    check.brake(servo);
    check.axes(servo);
}

fn check_sensor(findings: &mut Findings, profile: &DeviceProfile, sensor: &ForceSensor) {
    let mut check = Checked { findings, profile };
    let objects = &sensor.objects;
    for (index, entry) in objects.channels.iter().enumerate() {
        let key = format!("device.force_sensor.objects.channels[{index}]");
        check.number(&key, entry);
        if objects.numbers == Numbers::Real && entry.bits != 32 {
            let at = format!("{key}.bits");
            let message = format!("`{at}` is {}, and numbers that are `real` have 32 bits", entry.bits);
            check.findings.error(&at, message, "compare the length with the source");
        }
    }
    for (key, entry) in
        [("status", &objects.status), ("overload", &objects.overload), ("sample_counter", &objects.sample_counter)]
    {
        if let Some(entry) = entry {
            check.number(&format!("device.force_sensor.objects.{key}"), entry);
        }
    }
    check.sensor_pdos(sensor);
    check.status_bits(sensor);
    check.scaling(sensor);
    for (index, setting) in sensor.zero.iter().enumerate() {
        check.setting(&format!("device.force_sensor.zero[{index}]"), Some(setting), None);
    }
    if let Some(index) = sensor.sample_rates_hz.iter().position(|rate| *rate == 0) {
        let key = format!("device.force_sensor.sample_rates_hz[{index}]");
        check.findings.error(&key, format!("`{key}` is 0"), "write the rates that the sensor has, in Hz");
    }
}

struct Checked<'a> {
    findings: &'a mut Findings,
    profile: &'a DeviceProfile,
}

impl Checked<'_> {
    fn source(&mut self, key: &str, source: &str) {
        let known = &self.profile.profile.sources;
        if known.contains_key(source) {
            return;
        }
        let names: Vec<&str> = known.keys().map(String::as_str).collect();
        let help = match nearest(source, names.iter().copied()) {
            Some(meant) => format!("did you mean `{meant}`?"),
            None => format!("the sources are {}; what no source says stays out of a profile", names.join(", ")),
        };
        let message = format!("`{key}` is `{source}`, which is not among `profile.sources`");
        self.findings.error(key, message, help).see("profile.sources", "sources");
    }

    fn entry(&mut self, key: &str, entry: &Entry, bits: Option<u8>) {
        self.source(&format!("{key}.source"), &entry.source);
        let at = format!("{key}.bits");
        match bits {
            Some(bits) if bits != entry.bits => {
                let message = format!("`{at}` is {}, and this object has {bits} bits in CiA 402", entry.bits);
                self.findings.error(
                    &at,
                    message,
                    "an object of another length has another meaning; compare with the source",
                );
            }
            None if !matches!(entry.bits, 8 | 16 | 32) => {
                self.findings.error(&at, format!("`{at}` is {}", entry.bits), "write 8, 16 or 32");
            }
            _ => {}
        }
    }

    /// An object of a force sensor.
    fn number(&mut self, key: &str, entry: &Entry) {
        self.source(&format!("{key}.source"), &entry.source);
        if !matches!(entry.bits, 8 | 16 | 24 | 32) {
            let at = format!("{key}.bits");
            self.findings.error(&at, format!("`{at}` is {}", entry.bits), "write 8, 16, 24 or 32");
        }
    }

    /// Checks which process data of a force sensor carry which quantity, and their direction.
    fn sensor_pdos(&mut self, sensor: &ForceSensor) {
        const KEY: &str = "device.force_sensor.process_data";
        let PdoMap { rpdo, tpdo } = &sensor.process_data;
        // The master sends zeros alone.
        self.pdos(&format!("{KEY}.rpdo"), rpdo, &[]);
        let sent = [&Quantity::CHANNELS[..], &[Quantity::Status, Quantity::Overload, Quantity::SampleCounter]].concat();
        self.pdos(&format!("{KEY}.tpdo"), tpdo, &sent);
        let carried: Vec<Quantity> = tpdo.iter().flat_map(|pdo| pdo.maps.iter().copied()).collect();
        let bits = sensor.status_bits;
        let of_overload = if sensor.objects.overload.is_some() { Quantity::Overload } else { Quantity::Status };
        let needs = [(Quantity::Status, bits.invalid != 0), (of_overload, bits.overload != 0)];
        let needs = needs.into_iter().filter(|(quantity, is_used)| *is_used && sensor.object(*quantity).is_some());
        for quantity in Quantity::CHANNELS.into_iter().chain(needs.map(|(quantity, _)| quantity)) {
            if !carried.contains(&quantity) {
                let message = format!("`{KEY}.tpdo` does not carry `{}`", quantity.word());
                let help = "the six channels come with process data, and so does a status of which bits are named";
                self.findings.error(&format!("{KEY}.tpdo"), message, help);
            }
        }
    }

    /// Checks that the bits of the status exist.
    fn status_bits(&mut self, sensor: &ForceSensor) {
        let objects = &sensor.objects;
        let has =
            |entry: Option<&Entry>, bits: u32| u64::from(bits) >> entry.map_or(0, |entry| entry.bits.min(32)) == 0;
        let overload = objects.overload.as_ref().or(objects.status.as_ref());
        let bits = sensor.status_bits;
        for (word, entry, bits) in
            [("overload", overload, bits.overload), ("invalid", objects.status.as_ref(), bits.invalid)]
        {
            if !has(entry, bits) {
                let key = format!("device.force_sensor.status_bits.{word}");
                let message = format!("`{key}` names bits of a status that the sensor does not have");
                self.findings
                    .error(&key, message, "write 0, or the object of the status with its length")
                    .see("device.force_sensor.objects.status", "status");
            }
        }
    }

    fn scaling(&mut self, sensor: &ForceSensor) {
        const KEY: &str = "device.force_sensor.scaling";
        match &sensor.scaling {
            Some(Scaling::Objects { per_n, per_n_m }) => {
                self.number(&format!("{KEY}.objects.per_n"), per_n);
                self.number(&format!("{KEY}.objects.per_n_m"), per_n_m);
            }
            Some(Scaling::Constant { per_n, per_n_m }) => {
                for (word, counts) in [("per_n", per_n), ("per_n_m", per_n_m)] {
                    if *counts == 0 {
                        let at = format!("{KEY}.constant.{word}");
                        self.findings.error(
                            &at,
                            format!("`{at}` is 0"),
                            "write a whole number from 1, such as 1000000",
                        );
                    }
                }
                return;
            }
            None => {}
        }
        if sensor.objects.numbers == Numbers::Real {
            let message = format!("numbers that are `real` are counted by `{KEY}.constant`, which is not there");
            let help =
                "write `scaling: {constant: {per_n: 1000000, per_n_m: 1000000}}` for counts of 1e-6 N and 1e-6 N m";
            self.findings.error(KEY, message, help).see("device.force_sensor.objects.numbers", "numbers");
        }
    }

    fn pdo_number(&mut self, at: &str, pdo: &Pdo, is_taken: bool) {
        let at = format!("{at}.number");
        let indices = if at.contains(".rpdo[") { 0x1600..=0x17ff } else { 0x1a00..=0x1bff };
        if !(1..=512).contains(&pdo.number) && !indices.contains(&pdo.number) {
            let message = format!("`{at}` is {:#x}, which is no mapping of this direction", pdo.number);
            let help = format!("write 1 to 512, or an object from {:#x} to {:#x}", indices.start(), indices.end());
            self.findings.error(&at, message, help);
        } else if is_taken {
            let message = format!("`{at}` is {}, and so is that of another", pdo.number);
            self.findings.error(&at, message, "give each PDO of a direction a number of its own");
        }
    }

    fn transmission_type(&mut self, at: &str, transmission_type: u8) {
        if (241..=253).contains(&transmission_type) {
            let message = format!("`{at}.transmission_type` is {transmission_type}, which sends nothing by itself");
            let help = "write 1 for each SYNC, 2 to 240 for each n-th, or 254";
            self.findings.error(&format!("{at}.transmission_type"), message, help);
        }
    }

    fn entries(&mut self, at: &str, pdo: &Pdo) {
        let (entries, most) = (pdo.maps.len(), usize::from(self.profile.mapping_entries()));
        if !pdo.fixed && entries > most {
            let message = format!("`{at}.maps` has {entries} objects, and a PDO of this device carries {most}");
            self.findings.error(&format!("{at}.maps"), message, "spread them over two PDOs");
        }
    }

    fn optional(&mut self, key: &str, entry: Option<&Entry>, bits: u8) {
        if let Some(entry) = entry {
            self.entry(key, entry, Some(bits));
        }
    }

    fn current_limit(&mut self, limits: &Limits) {
        const KEY: &str = "device.servo.limits.current";
        let Some(current) = &limits.current else { return };
        for (key, entry) in [("limit", &current.limit), ("rated", &current.rated)] {
            let at = format!("{KEY}.{key}");
            self.entry(&at, entry, None);
            if entry.bits < 16 {
                let message = format!("`{at}.bits` is {}, and a torque in another unit has 16 or 32 bits", entry.bits);
                self.findings.error(&at, message, "compare the length with the source");
            }
        }
        if limits.torque.is_some() {
            let message = format!("`{KEY}` and `device.servo.limits.torque` are both there, and a drive has one limit");
            self.findings.error(KEY, message, "leave out `current`");
        }
    }

    fn setting(&mut self, key: &str, setting: Option<&Setting>, bits: Option<u8>) {
        let Some(setting) = setting else { return };
        self.entry(&format!("{key}.object"), &setting.object, bits);
        if !setting.fits() {
            let at = format!("{key}.value");
            let message = format!("`{at}` is {}, which {} bits do not hold", setting.value, setting.object.bits);
            self.findings.error(&at, message, "compare value and length with the source");
        }
    }

    fn option_codes(&mut self, servo: &Servo) {
        let options = &servo.option_codes;
        self.setting("device.servo.option_codes.lost_master", options.lost_master.as_ref(), None);
        self.setting("device.servo.option_codes.communication_error", options.communication_error.as_ref(), None);
        self.setting("device.servo.option_codes.quick_stop", options.quick_stop.as_ref(), None);
        let code = |setting: &Option<Setting>, index: u16| {
            setting.as_ref().filter(|setting| setting.object.index == index).map(|setting| setting.value)
        };
        if let Some(value) = code(&options.lost_master, ABORT_CONNECTION).filter(|value| !(1..=3).contains(value)) {
            self.findings.error(
                "device.servo.option_codes.lost_master.value",
                format!("`device.servo.option_codes.lost_master.value` is {value}, by which the drive does not stop"),
                "write 3 for a quick stop, 1 for a fault or 2 for torque off, whichever the drive has",
            );
        }
        if let Some(value) = code(&options.quick_stop, QUICK_STOP).filter(|value| !(1..=8).contains(value)) {
            self.findings.error(
                "device.servo.option_codes.quick_stop.value",
                format!("`device.servo.option_codes.quick_stop.value` is {value}, by which the drive runs out"),
                "write 2 for the quick stop ramp, or another from 1 to 8 that the drive has",
            );
        }
    }

    fn watchdogs(&mut self, servo: &Servo) {
        let key = "device.servo.watchdogs";
        if let HeartbeatWatch::Consumer(entry) = &servo.watchdogs.heartbeat {
            self.entry(&format!("{key}.heartbeat.consumer"), entry, Some(32));
        }
        match &servo.watchdogs.set_points {
            SetPointWatch::None => {}
            SetPointWatch::BuiltIn(watch) => self.source(&format!("{key}.set_points.built_in.source"), &watch.source),
            SetPointWatch::EventTimer { source, .. } => {
                self.source(&format!("{key}.set_points.event_timer.source"), source)
            }
            SetPointWatch::Object(timed) => self.entry(&format!("{key}.set_points.object.object"), &timed.object, None),
        }
        match &servo.watchdogs.sync {
            SyncWatch::None => {}
            SyncWatch::BuiltIn(watch) => self.source(&format!("{key}.sync.built_in.source"), &watch.source),
            SyncWatch::Object(timed) => self.entry(&format!("{key}.sync.object.object"), &timed.object, None),
        }
    }

    fn homing(&mut self, homing: &Homing) {
        let key = "device.servo.homing";
        for (name, entry, bits) in [
            ("method", &homing.method, 8),
            ("switch_speed", &homing.switch_speed, 32),
            ("zero_speed", &homing.zero_speed, 32),
            ("acceleration", &homing.acceleration, 32),
            ("offset", &homing.offset, 32),
        ] {
            self.entry(&format!("{key}.{name}"), entry, Some(bits));
        }
        if let Some(bit) = homing.referenced_bit.filter(|bit| !REFERENCED_BITS.contains(bit)) {
            let at = format!("{key}.referenced_bit");
            let message = format!("`{at}` is {bit}, which has another meaning in CiA 402");
            self.findings.error(&at, message, "the bits that a manufacturer may use are 8, 14 and 15; or write null");
        }
    }

    fn brake(&mut self, servo: &Servo) {
        let key = "device.servo.brake";
        match (servo.brake.held_by, &servo.brake.output) {
            (BrakeHolder::Output, None) => {
                let message = format!("`{key}` has `held_by: output`, and no output is given");
                let help = "write `output: {value: .., mask: .., bit: 0, closed_if: set, closes_in_ms: ..}`; the manual of the drive \
                            has the values (often of 60FEh)";
                self.findings.error(key, message, help);
            }
            (BrakeHolder::Output, Some(output)) => {
                self.entry(&format!("{key}.output.value"), &output.value, Some(32));
                self.entry(&format!("{key}.output.mask"), &output.mask, Some(32));
            }
            (_, Some(_)) => {
                let message = format!("`{key}.output` is written, and the brake is not held by an output");
                self.findings.error(&format!("{key}.output"), message, "leave it out, or write `held_by: output`");
            }
            (_, None) => {}
        }
    }

    /// Checks that each axis of a device with several axes has its own objects and PDOs.
    fn axes(&mut self, servo: &Servo) {
        const KEY: &str = "device.servo.axes";
        let Some(axes) = &servo.axes else { return };
        if !axes.object_step.is_multiple_of(AXIS_STEP) {
            let message =
                format!("`{KEY}.object_step` is {:#x}, which is no multiple of {AXIS_STEP:#x}", axes.object_step);
            let help = "CiA 402 has 0x800; compare with the manual, which has both axes";
            self.findings.error(&format!("{KEY}.object_step"), message, help);
        }
        if let Some(Entry { index, sub, .. }) = axes.misplaced(servo) {
            let last = axes.index(*index, axes.count.saturating_sub(1));
            let message = match last == *index {
                true => {
                    format!("object {index:04X}h:{sub:02X} is one of each axis, and `{KEY}` gives it one place for all")
                }
                false => {
                    format!("object {index:04X}h:{sub:02X} of the last axis would be {last:04X}h, which is not for it")
                }
            };
            let step = if *index < 0x6000 { "vendor_object_step" } else { "object_step" };
            let help =
                format!("write the index offset from one axis to the next in `{step}`: the manual has both axes");
            self.findings.error(KEY, message, help);
        }
        if axes.gap_step.saturating_mul(axes.count.saturating_sub(1).into()) >= COMMUNICATION {
            let message =
                format!("`{KEY}.gap_step` is {:#x}, by which a gap of the last axis is an object", axes.gap_step);
            let help = "write what the device's mapping has as index of a gap of the second axis, such as 0x800, or leave it out";
            self.findings.error(&format!("{KEY}.gap_step"), message, help);
        }
        for bus in Fieldbus::all().into_iter().filter(|bus| self.profile.is_for(*bus)) {
            let step = axes.pdo_step_on(bus);
            let maps = servo.process_data.modes().into_iter().filter_map(|mode| mode.3);
            let numbers = maps.flat_map(|map| map.rpdo.iter().chain(&map.tpdo)).map(Pdo::number);
            let (least, most) =
                numbers.fold((u16::MAX, 0), |(least, most), number| (least.min(number), most.max(number)));
            let key = format!("{KEY}.pdo_step");
            if most.saturating_sub(least) >= step {
                let message = format!(
                    "`{key}` is {step} on {}, and PDOs {least} to {most} of an axis reach into the next one",
                    bus.name()
                );
                self.findings.error(
                    &key,
                    message,
                    "write the distance of PDO numbers from one axis to the next by the manual",
                );
            } else if most.saturating_add(step.saturating_mul((axes.count - 1).into())) > MOST_PDOS {
                let message = format!(
                    "`{key}` is {step} on {}, and PDO {most} of the last axis would be beyond {MOST_PDOS}",
                    bus.name()
                );
                self.findings.error(&key, message, "compare the step and the number of axes with the manual");
            }
        }
    }

    /// Checks PDOs of one direction; each may carry the quantities in `known`.
    fn pdos(&mut self, key: &str, pdos: &[Pdo], known: &[Quantity]) {
        let mut carried: Vec<Quantity> = Vec::new();
        for (index, pdo) in pdos.iter().enumerate() {
            let at = format!("{key}[{index}]");
            self.pdo_number(&at, pdo, pdos.iter().take(index).any(|other| other.number() == pdo.number()));
            self.transmission_type(&at, pdo.transmission_type);
            for (place, quantity) in pdo.maps.iter().enumerate() {
                let at = format!("{at}.maps[{place}]");
                let word = quantity.word();
                if self.fills(&at, *quantity) {
                    continue;
                }
                if !known.contains(quantity) {
                    let words: Vec<&str> = known.iter().map(|quantity| quantity.word()).collect();
                    let message = format!("`{at}` is `{word}`, which does not go this way");
                    let help = match words.as_slice() {
                        [] => "write its object as `unused: {index: .., sub: .., bits: ..}`".to_owned(),
                        words => format!("here {} can be mapped", words.join(", ")),
                    };
                    self.findings.error(&at, message, help);
                } else if self.profile.object(*quantity).is_none() {
                    let message = format!("`{at}` is `{word}`, which the device does not have");
                    self.findings.error(&at, message, "write its object, or leave it out");
                } else if carried.contains(quantity) {
                    self.findings.error(
                        &at,
                        format!("`{at}` is `{word}`, which is mapped before"),
                        "map each object once",
                    );
                }
                carried.push(*quantity);
            }
            if self.profile.is_for(Fieldbus::Canopen) {
                self.of_canopen(&at, pdo);
            }
            self.entries(&at, pdo);
        }
    }

    /// Checks that CANopen has room and an identifier for a PDO.
    fn of_canopen(&mut self, at: &str, pdo: &Pdo) {
        let bytes = self.profile.mapped_pdo(pdo).bytes();
        const OTHERWISE: &str = "or write `buses: [ethercat]` in `profile` if that is its only bus";
        if bytes > FRAME_BYTES {
            let message = format!("`{at}.maps` make {bytes} bytes, and a CAN frame carries {FRAME_BYTES}");
            self.findings.error(&format!("{at}.maps"), message, format!("spread them over two PDOs, {OTHERWISE}"));
        }
        if pdo.number() > CANOPEN_PDOS {
            let message = format!("`{at}.number` is {}, and CANopen has identifiers for 1 to 4", pdo.number);
            self.findings.error(&format!("{at}.number"), message, format!("write one of these, {OTHERWISE}"));
        }
    }

    /// Whether a mapped quantity has no meaning to the rig; checks its lengths in that case.
    fn fills(&mut self, at: &str, quantity: Quantity) -> bool {
        let (at, bits, most) = match quantity {
            Quantity::Gap(bits) => (format!("{at}.gap"), bits, u8::MAX),
            Quantity::Unused(Unused { bits, value, .. }) => {
                (format!("{at}.unused.bits"), bits, if value.is_some() { VALUE_BITS } else { OBJECT_BITS })
            }
            _ => return false,
        };
        if !(1..=most).contains(&bits) {
            self.findings.error(&at, format!("`{at}` is {bits}"), format!("write 1 to {most}"));
        }
        true
    }

    /// Checks that process data do not carry objects whose value the boot computes from values of the drive, unless the profile
    /// gives their value.
    fn computed(&mut self, key: &str, servo: &Servo, pdos: &[Pdo]) {
        let limits = [
            servo.limits.current.as_ref().map(|current| &current.limit),
            servo.limits.motor_speed.as_ref().map(|speed| &speed.limit),
        ];
        for (index, pdo) in pdos.iter().enumerate() {
            for (place, quantity) in pdo.maps.iter().enumerate() {
                let Quantity::Unused(Unused { index: object, sub, value: None, .. }) = *quantity else { continue };
                if limits.iter().flatten().any(|limit| (limit.index, limit.sub) == (object, sub)) {
                    let at = format!("{key}[{index}].maps[{place}]");
                    let message = format!("`{at}` is a limit of the drive, and every cycle would set it to 0");
                    self.findings.error(&at, message, "write its `value` in the unit of the object");
                }
            }
        }
    }

    /// Checks that the process data of a drive carry the quantities that it needs, and when they carry them.
    fn drive_pdos(&mut self, key: &str, map: &PdoMap, set_point: Quantity) {
        // A frame of EtherCAT carries all of them.
        let is_one = self.profile.is_for(Fieldbus::Canopen);
        let together = if is_one { 1 } else { map.rpdo.len() };
        for quantity in [Quantity::Controlword, set_point] {
            if !map.rpdo.iter().take(together).any(|pdo| pdo.maps.contains(&quantity)) {
                let message = format!("the first PDO of `{key}.rpdo` does not carry `{}`", quantity.word());
                self.findings.error(&format!("{key}.rpdo"), message, "controlword and set-point are sent in one frame");
            }
        }
        if is_one && map.rpdo.len() > 1 {
            let message = format!("`{key}.rpdo` has {} PDOs, and one is sent on CANopen", map.rpdo.len());
            let help = "write one PDO with controlword and set-point, or `buses: [ethercat]` in `profile` if that is its only bus";
            self.findings.error(&format!("{key}.rpdo"), message, help);
        }
        for quantity in [Quantity::Statusword, Quantity::PositionActual] {
            if !map.tpdo.iter().any(|pdo| pdo.maps.contains(&quantity)) {
                let message = format!("`{key}.tpdo` does not carry `{}`", quantity.word());
                self.findings.error(&format!("{key}.tpdo"), message, "both come in every cycle");
            }
        }
        let directions = [("rpdo", &map.rpdo), ("tpdo", &map.tpdo)];
        for (word, pdos) in directions {
            for (index, pdo) in pdos.iter().enumerate().filter(|(_, pdo)| pdo.transmission_type != 1) {
                let at = format!("{key}.{word}[{index}].transmission_type");
                let message = format!("`{at}` is {}, and a drive follows every SYNC", pdo.transmission_type);
                self.findings.error(&at, message, "write 1");
            }
        }
    }
}
