//! Each shipped servo profile as a process on a bus: jog and a run to its end and by Ctrl-C, on EtherCAT commissioning and a fault too. None
//! leaves torque.

use serde_json::Value;
use yieldwall::config::{ProfileName, builtin};
use yieldwall_drives::cia402::OperationMode;
use yieldwall_drives::profiles::{DeviceProfile, Fieldbus};

use super::programs::*;

/// A mode and the shipped rig on CAN that has it.
const MODES: [(OperationMode, &str, &str); 3] = [
    (OperationMode::CyclicTorque, "torque", "paper-admittance.yaml"),
    (OperationMode::CyclicPosition, "position", "paper-admittance-csp.yaml"),
    (OperationMode::CyclicVelocity, "velocity", "paper-admittance-csv.yaml"),
];

/// A rig with drives of a profile, in the first mode that this has.
struct Shipped {
    rig: String,
    mode: &'static str,
}

impl Shipped {
    /// Files of its own; `None` for a profile that is for another bus.
    fn new(name: &str, profile: &DeviceProfile, bus: Fieldbus) -> Option<Self> {
        let servo = profile.servo().filter(|_| profile.is_for(bus))?;
        let (_, mode, can) = MODES.into_iter().find(|(mode, ..)| servo.process_data.of(*mode).is_some())?;
        // Watches of which no document says more: five periods, and a fault. Without these no drill is passed.
        let text = builtin(format!("profiles/{name}.yaml")).read().expect("a shipped profile");
        let text = text.replace("periods: null", "periods: 5").replace("reaction: unknown", "reaction: fault");
        let file = std::env::temp_dir().join(format!("yieldwall-shipped-{name}-{}.yaml", std::process::id()));
        std::fs::write(&file, text).expect("the folder for temporary files can be written");
        let drive = |place: u8, side: &str| {
            let address = match (bus, profile.axes()) {
                (Fieldbus::Canopen, _) => String::new(),
                (Fieldbus::Ethercat, 1) => format!(", address: {{ethercat: {{position: {place}}}}}"),
                (Fieldbus::Ethercat, _) => format!(", address: {{ethercat: {{position: 0, axis: {place}}}}}"),
            };
            format!("  - {{name: {side}, profile: {}, encoder: multi_turn{address}}}\n", file.display())
        };
        let like = match bus {
            Fieldbus::Canopen => format!("like: builtin:{can}\n"),
            Fieldbus::Ethercat => format!("like: builtin:paper-ethercat.yaml\nrig: {{command_mode: {mode}}}\n"),
        };
        let sensor = if profile.axes() > 1 { "sensor: {protocol: {ethercat: {position: 1}}}\n" } else { "" };
        let rig = format!("{like}drives:\n{}{}{sensor}", drive(0, "left"), drive(1, "right"));
        let path = file.with_extension("rig.yaml");
        std::fs::write(&path, rig).expect("the folder for temporary files can be written");
        Some(Self { rig: path.to_str().expect("a plain path").to_owned(), mode })
    }

    /// Runs a program beside simulated devices: its exit code and document, and what the devices say at their end.
    fn beside(&self, far: &str, sim: &[&str], program: impl FnOnce() -> Running) -> (i32, Value, Value) {
        let devices = [&["sim", &self.rig, "--bus", far, "--pace", "lockstep", "--json"][..], sim].concat();
        let devices = Running::start(&devices);
        let (code, document) = program().document();
        devices.signal("INT");
        let (served, end) = devices.document();
        assert_eq!(served, OK, "{end:#}");
        (code, document, end)
    }
}

fn assert_no_torque(what: &str, document: &Value, devices: &Value) {
    for drive in devices["drives"].as_array().expect("two drives") {
        assert_eq!(drive["torque_n_m"], 0.0, "{what}: {devices:#}\n{document:#}");
        assert_ne!(drive["state"], "OperationEnabled", "{what}: {devices:#}\n{document:#}");
    }
}

/// The table of all profiles for a bus, whose two ends are `near` and `far`.
pub(super) fn no_command_leaves_torque(bus: Fieldbus, near: &str, far: &str) {
    let mut tried = 0;
    for (name, profile) in ProfileName::shipped() {
        let Some(shipped) = Shipped::new(name, profile, bus) else { continue };
        tried += 1;
        let common = [&*shipped.rig, "--bus", near, "--pace", "lockstep", "--json"];
        let command = |words: &[&str]| Running::start(&[&words[..1], &common[..], &words[1..]].concat());
        let jog = ["jog", "left", "--by", "-2deg", "--rate", "20deg", "--accept-drive-limit"];
        let commission = ["commission", "--yes", "--accept-drive-limit"];
        let interrupted = || {
            let run = command(&["run", "--duration", "600"]);
            std::thread::sleep(std::time::Duration::from_millis(1500));
            run.signal("INT");
            run
        };
        let mut ends = vec![
            ("jog", OK, shipped.beside(far, &["--no-hand"], || command(&jog))),
            ("run", OK, shipped.beside(far, &[], || command(&["run", "--duration", "0.4"]))),
            ("Ctrl-C", INTERRUPTED, shipped.beside(far, &[], interrupted)),
        ];
        // `sim` breaks devices on EtherCAT alone.
        if bus == Fieldbus::Ethercat {
            let fault = ["--fault", "drive-fault@3:right"];
            ends.push(("fault", DEVICE_FAULT, shipped.beside(far, &fault, || command(&["run", "--duration", "5"]))));
            // Commissioning takes most of a minute.
            if tried == 1 {
                ends.push(("commission", OK, shipped.beside(far, &["--no-hand"], || command(&commission))));
            }
        }
        for (end, wanted, (code, document, devices)) in &ends {
            let what = format!("{name} {} {end}", shipped.mode);
            assert_eq!(code, wanted, "{what}: {document:#}");
            assert_no_torque(&what, document, devices);
        }
        let ends: Vec<_> = ends.iter().map(|(end, ..)| *end).collect();
        println!("{name:18} {:9} no torque after {}", shipped.mode, ends.join(", "));
    }
    assert!(tried >= 4, "{tried}");
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn no_command_leaves_torque_on_can() {
    no_command_leaves_torque(Fieldbus::Canopen, &bus(), &bus());
}
