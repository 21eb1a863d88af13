//! Conversion of cycles into events: describes the news of a cycle.

use serde_json::{Value, json};
use yieldwall_drives::cia402;

use super::Event;
use crate::ending::{bus_names, describe};
use crate::on_bus::{drive_error_json, drive_error_text, not_in_time, said_first, words_of_code, words_of_fault};
use yieldwall_config as config;
use yieldwall_fieldbus::canopen::{Emergency, Frame};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::elementary::hypot;
use yieldwall_motion::guard::{Cause, Device, Fault, State};
use yieldwall_record::{CycleRecord, Standstill};
use yieldwall_run::DriveError;
use yieldwall_run::explanation::state_name;

/// Current state of the rig, for a line.
#[derive(Clone, Copy, Debug, Default)]
struct Now {
    state: State,
    time_s: Option<f64>,
    /// Time of the cycle on the clock of the rig, s.
    boot_s: Option<f64>,
    force_n: f64,
    /// Distance of the tool from the proxy, mm.
    off_proxy_mm: f64,
    /// The latest that SYNC or the computation ever was, us.
    worst_late_us: f64,
}

/// Narrator of new events.
pub(super) struct Narrator {
    rig: config::Rig,
    is_on_bus: bool,
    buses: Vec<String>,
    /// States in the last cycle; `None` before the first cycle.
    drives: Option<[cia402::State; 2]>,
    cause: Option<Cause>,
    /// Last reported fault, with all its devices.
    reported: Option<Cause>,
    /// Last standstill of the computer before the present cycle.
    standstill: Option<Standstill>,
    now: Now,
    /// Faults that held or stopped the rig.
    faults: u32,
}

impl Narrator {
    /// Creates the narrator of a rig on interfaces, or of the embedded simulation, which has no deadlines to miss.
    pub(super) fn new(rig: &config::Rig, is_on_bus: bool) -> Self {
        let buses = bus_names(rig);
        Self {
            rig: rig.clone(),
            is_on_bus,
            buses,
            drives: None,
            cause: None,
            reported: None,
            standstill: None,
            now: Now::default(),
            faults: 0,
        }
    }

    /// Reports the new events of a cycle.
    pub(super) fn record(&mut self, record: &CycleRecord, tell: &mut impl FnMut(Event)) {
        self.now.time_s = Some(record.moment.scene_time_s).filter(|time_s| time_s.is_finite());
        self.now.boot_s = Some(Time(record.moment.sync_ns).as_secs_f64());
        let state = record.directive.state;
        let drives = record.inputs.drives.each_ref().map(|drive| drive.state);
        if self.drives.is_none() {
            tell(self.event("booted", "all devices exchange process data"));
        }
        for (drive, (now, before)) in Device::DRIVES.into_iter().zip(drives.iter().zip(self.drives.unwrap_or(drives))) {
            if *now != before {
                let (name, state) = (self.name(drive), state_name(Some(*now)));
                let event = self.event("drive", format!("{name}: {state}"));
                tell(event.with("drive", name).with("state", state));
            }
        }
        let before = std::mem::replace(&mut self.now.state, state);
        self.standstill = record.moment.standstill;
        // A fault that alternates between devices is reported once for each of them.
        let reported = match (self.reported, record.cause) {
            (Some(known), Some(cause)) if known.fault == cause.fault => {
                Some(Cause { devices: known.devices | cause.devices, ..known })
            }
            (_, cause) => cause,
        };
        let is_new = std::mem::replace(&mut self.reported, reported) != reported;
        self.cause = record.cause;
        if before != state {
            self.state_changed(before, is_new, tell);
        } else if let (true, Some(cause)) = (is_new, record.cause) {
            let name = if state == State::Idle { "refused" } else { "fault" };
            self.fault(name, cause, tell);
        }
        self.drives = Some(drives);
        let timing = &record.inputs.timing;
        let late_us = f64::from(timing.sync_late_ns.max(timing.compute_late_ns)) * 1e-3;
        let [x, y] = record.signals.force.to_array();
        let ([tool_x, tool_y], [proxy_x, proxy_y]) = (record.signals.tool.to_array(), record.signals.proxy.to_array());
        self.now.force_n = hypot(x, y);
        self.now.off_proxy_mm = 1e3 * hypot(tool_x - proxy_x, tool_y - proxy_y);
        self.now.worst_late_us = self.now.worst_late_us.max(late_us);
    }

    fn state_changed(&mut self, before: State, is_new: bool, tell: &mut impl FnMut(Event)) {
        let fault = self.cause.filter(|cause| cause.fault != Fault::StopRequested);
        match (self.now.state, fault) {
            (State::Idle, _) => tell(self.event("reset", "the fault is cleared; nothing is enabled")),
            (State::Enabling, _) => tell(self.event("enabling", "both drives go to Operation Enabled together")),
            (State::Running, _) if before == State::Holding => tell(self.event("released", "the rig runs on")),
            (State::Running, _) => tell(self.event("enabled", "the rig runs")),
            (State::Holding, Some(cause)) => self.fault("held", cause, tell),
            (State::Stopping, None) => tell(self.event("stopping", "the rig stops along its ramp, as requested")),
            (State::Stopping, Some(cause)) => self.fault("fault", cause, tell),
            (State::Holding, None) => {}
            (state @ (State::Stopped | State::Disabled | State::Lost), fault) => {
                // A fault that caused the ramp was reported before.
                if let Some(cause) = fault.filter(|_| is_new || before != State::Stopping) {
                    self.fault("fault", cause, tell);
                }
                let text = match state {
                    State::Stopped => "both drives are in quick stop",
                    State::Disabled => "both drives have no torque",
                    _ => "the master sends nothing; the drives stop by their watchdogs",
                };
                tell(self.event("stopped", text).with("state", format!("{state:?}")));
            }
        }
    }

    fn fault(&mut self, name: &'static str, cause: Cause, tell: &mut impl FnMut(Event)) {
        self.faults += u32::from(name != "refused");
        let row = cause.fault.row();
        let at = describe(cause, &self.buses);
        let event = self.event(name, format!("{} ({at}): {}", row.name, row.meaning));
        let event = event.with("fault", row.name).with("where", at).with("state", format!("{:?}", self.now.state));
        let why = not_in_time(cause.fault, self.standstill, &self.rig).filter(|_| self.is_on_bus);
        tell(event.meaning(said_first(why, words_of_fault(cause.fault))));
    }

    /// Returns an event of the present cycle.
    fn event(&self, name: &'static str, text: impl Into<String>) -> Event {
        Event { boot_s: self.now.boot_s, ..Event::new(name, self.now.time_s, text) }
    }

    /// Returns the time of the scene in the last cycle, s.
    pub(super) fn time_s(&self) -> Option<f64> {
        self.now.time_s
    }

    /// Returns the event for a device's emergency message at this time of the rig's clock; `None` for any other frame.
    pub(super) fn emergency(&self, time: Time, frame: &Frame) -> Option<Event> {
        let emergency = Emergency::decode(frame)?;
        let node = emergency.node.raw();
        let device = self.device(frame.bus().index(), node);
        let who =
            device.map_or_else(|| format!("node {node}"), |device| format!("node {node} ({})", self.name(device)));
        let (meaning, words) = words_of_code(emergency.code, device, &self.rig);
        let code = format!("{:04X}h", emergency.code.0);
        let event = self.event("emergency", format!("{who}: {code} {meaning}"));
        let event = Event { boot_s: Some(time.as_secs_f64()), ..event };
        let event = event.with("node_id", node).with("name", device.map(|device| self.name(device)));
        let event = event.with("code", code).with("meaning", meaning);
        let event = event.with("error_register", emergency.register.0).with("vendor_bytes", json!(emergency.vendor));
        // Communication and its monitoring.
        let why = matches!(emergency.code.0, 0x8100..=0x82ff).then_some(Fault::Emergency);
        let why = why.filter(|_| self.is_on_bus).and_then(|fault| not_in_time(fault, self.standstill, &self.rig));
        Some(event.meaning(said_first(why, words)))
    }

    /// Returns the event for a fault that a drive reports.
    pub(super) fn error(&self, error: &DriveError) -> Event {
        let mut event = self.event("error", drive_error_text(error, &self.rig));
        if let Value::Object(facts) = drive_error_json(error, &self.rig) {
            event.facts = facts;
        }
        let code = error.code.filter(|code| *code != 0).map(yieldwall_fieldbus::canopen::EmcyCode);
        event.meaning(code.map_or_else(Vec::new, |code| words_of_code(code, Some(error.drive), &self.rig).1))
    }

    /// Returns the current state of the rig, in 77 columns.
    pub(super) fn line(&self) -> String {
        let Now { state, time_s, force_n, off_proxy_mm, worst_late_us, .. } = self.now;
        let state = format!("{state:?}");
        let time = time_s.map_or_else(|| "-".to_owned(), |time_s| format!("{time_s:.2}"));
        format!(
            "{state:8} {time:>8} s  force {force_n:>5.1} N  proxy {off_proxy_mm:>6.2} mm  late {worst_late_us:>6.0} us  faults {}",
            self.faults
        )
    }

    fn name(&self, device: Device) -> String {
        let [left, right] = &self.rig.drives;
        match device {
            Device::LeftDrive => left.name.clone(),
            Device::RightDrive => right.name.clone(),
            Device::Sensor => self.rig.sensor.name.clone(),
        }
    }

    /// Returns the rig's device with this node id on a bus.
    fn device(&self, bus: usize, node: u8) -> Option<Device> {
        let is_there = |name: &str| self.buses.iter().position(|known| known == name) == Some(bus);
        let mut drives = Device::DRIVES.into_iter().zip(&self.rig.drives);
        let drive = drives.find(|(_, drive)| drive.address.node_id() == Some(node) && is_there(&drive.bus));
        let sensor = self.rig.sensor.protocol.node_id() == Some(node) && is_there(&self.rig.sensor.bus);
        drive.map(|(device, _)| device).or(sensor.then_some(Device::Sensor))
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;
    use std::sync::mpsc::channel;

    use super::*;
    use crate::faults::FaultArgument;
    use yieldwall_config::injection::Injection;
    use yieldwall_rig::report::{Overrides, Watch, run_rig};

    enum Heard {
        Cycle(Box<CycleRecord>),
        Frame(Time, Frame),
        Error(DriveError),
    }

    /// Returns the events of a shipped rig with a fault, and its final message.
    fn told(fault: &str, duration_s: f64) -> (Vec<Event>, String) {
        let rig = config::load_rig(config::Source::named("builtin:paper-admittance.yaml")).unwrap();
        let scene = rig.scene().unwrap().value;
        let faults: Vec<Injection> = fault
            .split(' ')
            .filter(|word| !word.is_empty())
            .map(|one| one.parse::<FaultArgument>().unwrap().of_rig(&rig.value).unwrap())
            .collect();
        let (heard, all) = channel();
        let (cycles, frames, errors) = (heard.clone(), heard.clone(), heard);
        let watch = Watch {
            observer: Some(Box::new(move |record| cycles.send(Heard::Cycle(Box::new(*record))).unwrap())),
            tap: Some(Box::new(move |time, packet| {
                packet.can().into_iter().for_each(|frame| frames.send(Heard::Frame(time, *frame)).unwrap());
            })),
            errors: Some(Box::new(move |error| errors.send(Heard::Error(*error)).unwrap())),
            ..Watch::default()
        };
        let overrides = Overrides { duration_s: Some(duration_s), faults, ..Overrides::default() };
        run_rig(&rig.value, &scene, &overrides, watch, |_| ControlFlow::Continue(())).unwrap();
        let mut narrator = Narrator::new(&rig.value, false);
        let mut events = Vec::new();
        for heard in all {
            match heard {
                Heard::Cycle(record) => narrator.record(&record, &mut |event| events.push(event)),
                Heard::Frame(time, frame) => events.extend(narrator.emergency(time, &frame)),
                Heard::Error(error) => events.push(narrator.error(&error)),
            }
        }
        (events, narrator.line())
    }

    fn names(events: &[Event]) -> Vec<&'static str> {
        events.iter().map(|event| event.name).filter(|name| *name != "drive").collect()
    }

    #[test]
    fn a_run_without_a_fault_tells_its_way() {
        let (events, line) = told("", 0.5);
        assert_eq!(names(&events), ["booted", "enabling", "enabled", "stopping", "stopped"]);
        assert!(line.starts_with("Stopped ") && line.ends_with("faults 0") && line.len() <= 80, "{line}");
        let enabled = events.iter().find(|event| event.text == "left: Operation Enabled").unwrap();
        assert_eq!((enabled.time_s, &enabled.facts["drive"]), (None, &json!("left")));
        let times: Vec<f64> = events.iter().map(|event| event.boot_s.unwrap()).collect();
        assert!(times[0] > 0.0 && times.is_sorted(), "{times:?}");
    }

    /// The drive's own words are read when it has faulted, before anybody asks for them.
    #[test]
    fn a_drive_that_faults_says_why_by_emergency_and_when_it_is_asked() {
        let (events, line) = told("drive-fault@0.2:left_drive", 0.5);
        let names = names(&events);
        let at = |name| names.iter().position(|known| *known == name).unwrap_or_else(|| panic!("{name}: {names:?}"));
        assert!(
            at("emergency") <= at("fault") && at("fault") < at("stopped") && at("stopped") < at("error"),
            "{names:?}"
        );
        let of = |name| events.iter().find(|event| event.name == name).unwrap();
        let (fault, emergency, error) = (of("fault"), of("emergency"), of("error"));
        assert!((fault.time_s.unwrap() - 0.2).abs() < 0.01, "{fault:?}");
        assert!(fault.words.iter().map(|(key, _)| *key).eq(["cause", "next"]), "{fault:?}");
        assert!(emergency.text.starts_with("node 1 (left): "), "{emergency:?}");
        assert_eq!(
            (&error.facts["name"], &error.facts["code"]),
            (&json!("left"), &emergency.facts["code"]),
            "{error:?}"
        );
        assert!(error.facts["state"].as_str().unwrap().contains("Fault"), "{error:?}");
        assert_eq!(events.iter().filter(|event| event.name == "error").count(), 2, "one of each drive");
        assert!(line.ends_with("faults 1"), "{line}");
    }

    /// Without the bus, the drives' own watchdogs have to act: there is no question.
    #[test]
    fn nobody_is_asked_where_nothing_may_be_sent() {
        for fault in ["interface-down@0.2", "intruder-sync@0.2+0.2", "duplicate-node@0.2:left_drive"] {
            let (events, _) = told(fault, 0.5);
            assert!(names(&events).contains(&"fault"), "{fault}: {:?}", names(&events));
            assert!(!names(&events).contains(&"error"), "{fault}: {:?}", names(&events));
        }
    }

    #[test]
    fn a_fault_that_comes_in_every_second_cycle_is_reported_once() {
        let (events, _) = told("cycle-overrun@0.2", 0.5);
        let faults =
            events.iter().filter(|event| matches!(event.name, "held" | "fault") && event.text.contains("overrun"));
        let texts: Vec<&str> = faults.map(|event| event.text.as_str()).collect();
        assert!(texts.len() <= 2 && texts.iter().all(|text| text.starts_with("overrun (host): ")), "{texts:#?}");
    }

    #[test]
    fn a_fault_that_holds_is_told_with_its_end() {
        let (events, _) = told("sensor-stale@0.2+0.005", 2.0);
        let names = names(&events);
        let held = names.iter().position(|name| *name == "held").unwrap_or_else(|| panic!("{names:?}"));
        assert!(names[held..].contains(&"released"), "{names:?}");
    }
}
