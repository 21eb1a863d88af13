//! Each shipped servo profile, in each mode that it has, as a process on a bus: no command leaves torque.
//!
//! Every profile in every mode is run to its end and by Ctrl-C, on EtherCAT to a fault too. Longer commands are tried in one mode of each profile,
//! in another mode from command to command. The longest of them are tried with some profiles alone.

use std::path::PathBuf;

use hil_tests::network::Real;
use serde_json::Value;
use yieldwall::canopen::{Frame, cob};
use yieldwall::config::{ProfileName, builtin};
use yieldwall::link::{CanLink, SocketCanSettings};
use yieldwall_drives::cia402::OperationMode;
use yieldwall_drives::profiles::{DeviceProfile, Fieldbus};

use super::programs::*;

/// A mode, as rigs name it.
struct Mode {
    mode: OperationMode,
    name: &'static str,
    /// The shipped rig on CAN that has it.
    can: &'static str,
}

const MODES: [Mode; 3] = [
    Mode { mode: OperationMode::CyclicTorque, name: "torque", can: "paper-admittance.yaml" },
    Mode { mode: OperationMode::CyclicVelocity, name: "velocity", can: "paper-admittance-csv.yaml" },
    Mode { mode: OperationMode::CyclicPosition, name: "position", can: "paper-admittance-csp.yaml" },
];

/// The columns of the table.
const COMMANDS: [&str; 8] = ["run", "Ctrl-C", "fault", "jog", "commission", "last step", "home", "drill"];

/// Differences between the rigs of a profile and a mode.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    /// A cycle of 1 ms.
    Usual,
    /// Incremental encoders, and homing.
    Incremental,
    /// A cycle that a computer keeps by the wall clock.
    Slow,
}

/// A profile on a bus, in a mode.
struct Shipped<'a> {
    name: &'static str,
    profile: &'a DeviceProfile,
    mode: &'a Mode,
    bus: Fieldbus,
    near: &'a str,
    far: &'a str,
    /// Folder of its files.
    folder: PathBuf,
}

/// The exit code and the document of a command, and what the devices print at their end.
type End = (i32, Value, Value);

impl Shipped<'_> {
    /// Writes the files of a rig; the path of the rig.
    fn rig(&self, kind: Kind) -> String {
        std::fs::create_dir_all(&self.folder).expect("the folder for temporary files can be written");
        let write = |path: &PathBuf, text: &str| {
            std::fs::write(path, text).expect("the folder for temporary files can be written");
        };
        // Watches of which no document says more: five periods, and a fault. Without these no drill is passed.
        let text = builtin(format!("profiles/{}.yaml", self.name)).read().expect("a shipped profile");
        let text = text.replace("periods: null", "periods: 5").replace("reaction: unknown", "reaction: fault");
        let file = self.folder.join(format!("{}.yaml", self.name));
        write(&file, &text);
        let (can, is_slow, is_shared) = (self.bus == Fieldbus::Canopen, kind == Kind::Slow, self.profile.axes() > 1);
        let homing = |method: i8, angle: f64| match kind {
            Kind::Incremental => format!(
                "encoder: incremental, homing: {{method: {method}, angle_rad: {angle}, within_rad: 0.15, rate_rad_per_s: 0.05}}"
            ),
            Kind::Usual | Kind::Slow => "encoder: multi_turn".to_owned(),
        };
        let heartbeat = "{canopen: {heartbeat_ms: 200}}";
        let drive = |place: u8, side: &str, encoder: &str| {
            let address = match (can, is_shared) {
                (true, _) if is_slow => format!(", address: {heartbeat}"),
                (true, _) => String::new(),
                (false, false) => format!(", address: {{ethercat: {{position: {place}}}}}"),
                (false, true) => format!(", address: {{ethercat: {{position: 0, axis: {place}}}}}"),
            };
            format!("  - {{name: {side}, profile: {}, {encoder}{address}}}\n", file.display())
        };
        let mut rig = match can {
            true => format!("like: builtin:{}\n", self.mode.can),
            false => format!("like: builtin:paper-ethercat.yaml\nrig: {{command_mode: {}}}\n", self.mode.name),
        };
        // A loop in the drives is stable with less than a quarter of a period.
        if self.mode.name == "velocity" {
            rig += &format!("control: {{gains: {{rate: {{gain_per_s: {}}}}}}}\n", if is_slow { 5 } else { 60 });
        }
        if is_slow {
            let period_us = if can { 20_000 } else { 5_000 };
            rig += &format!("cycle: {{period_us: {period_us}, compute_at_us: {}}}\n", period_us / 2);
            rig += "guard: {tool_speed_limit_m_per_s: 0.25, force_limit_n: 140.0}\n";
        }
        rig += &format!("drives:\n{}{}", drive(0, "left", &homing(34, 2.15)), drive(1, "right", &homing(33, 0.64)));
        match (can, is_shared) {
            (true, _) if is_slow => {
                rig +=
                    &format!("buses: {{main: {heartbeat}}}\nsensor: {{protocol: {heartbeat}, sample_rate_hz: 200}}\n");
            }
            (false, true) => rig += "sensor: {protocol: {ethercat: {position: 1}}}\n",
            _ => {}
        }
        let path = self.folder.join(format!("{}-{}.rig.yaml", self.name, kind as u8));
        write(&path, &rig);
        path.to_str().expect("a plain path").to_owned()
    }

    /// Runs a command beside simulated devices.
    fn beside(&self, rig: &str, pace: &str, sim: &[&str], program: impl FnOnce() -> (i32, Value)) -> End {
        let devices = [&["sim", rig, "--bus", self.far, "--pace", pace, "--json"][..], sim].concat();
        let devices = Running::start(&devices);
        let (code, document) = program();
        devices.signal("INT");
        let (served, end) = devices.document();
        assert_eq!(served, OK, "{end:#}");
        (code, document, end)
    }

    /// Runs a command in lockstep with simulated devices.
    fn command(&self, kind: Kind, sim: &[&str], words: &[&str]) -> End {
        let rig = self.rig(kind);
        let common = [&*rig, "--bus", self.near, "--pace", "lockstep", "--json"];
        let words = [&words[..1], &common[..], &words[1..]].concat();
        self.beside(&rig, "lockstep", sim, || Running::start(&words).document())
    }

    /// Does something to a run once both drives are enabled.
    fn enabled(&self, act: impl FnOnce(&Running)) -> End {
        let rig = self.rig(Kind::Usual);
        let run = ["run", &rig, "--bus", self.near, "--pace", "lockstep", "--jsonl", "--duration", "600"];
        self.beside(&rig, "lockstep", &[], || {
            let mut run = Running::start(&run);
            run.until_event("enabled");
            std::thread::sleep(std::time::Duration::from_millis(100));
            act(&run);
            run.last_line()
        })
    }

    fn interrupted(&self) -> End {
        let end = self.enabled(|run| run.signal("INT"));
        assert!(end.1["cycles"].as_u64().is_some_and(|cycles| cycles > 0), "{:#}", end.1);
        end
    }

    /// Breaks the right drive of a rig that runs: on EtherCAT by its own fault. On CAN, where `sim` breaks nothing, a foreign node resets it.
    fn broken(&self) -> (i32, End) {
        match self.bus {
            Fieldbus::Ethercat => {
                let fault = ["--fault", "drive-fault@3:right"];
                (DEVICE_FAULT, self.command(Kind::Usual, &fault, &["run", "--duration", "5"]))
            }
            Fieldbus::Canopen => {
                let reset = |_: &Running| {
                    let mut foreign = Real::open(&SocketCanSettings::everything(self.near));
                    foreign.send(&Frame::new(cob::NMT, &[0x81, 2])).expect("the bus takes a frame");
                };
                (SAFETY_STOP, self.enabled(reset))
            }
        }
    }

    /// Drills the rig by the wall clock. It is tried again if this computer stood still meanwhile.
    fn drilled(&self) -> End {
        let rig = self.rig(Kind::Slow);
        let drill = ["drill", &rig, "--bus", self.near, "--json"];
        for attempt in 1.. {
            let end = self.beside(&rig, "free", &["--no-hand"], || Running::start(&drill).document());
            let what = format!("{} {} drill", self.name, self.mode.name);
            assert_no_torque(&what, &end.1, &end.2);
            if attempt == TRIES || !is_late(end.0, &end.1) {
                return end;
            }
            println!("{what}: this computer was too late, try {attempt} of {TRIES}: {:#}", end.1["diagnostics"]);
        }
        unreachable!("the last try is returned")
    }
}

/// Whether a command failed because this computer stood still: by its own timing, by process data that devices in another process did not send in
/// time, or by watches of drives that had to wait for the master.
fn is_late(code: i32, document: &Value) -> bool {
    let said = document["diagnostics"].to_string();
    match code {
        TIMING_MISSED => true,
        SAFETY_STOP => said.contains("because of pdo-missed ("),
        DEVICE_FAULT => said.contains("because of drive-fault (") && said.contains(": 8250h RPDO did not come in time"),
        _ => false,
    }
}

fn assert_no_torque(what: &str, document: &Value, devices: &Value) {
    for drive in devices["drives"].as_array().expect("two drives") {
        assert_eq!(drive["torque_n_m"], 0.0, "{what}: {devices:#}\n{document:#}");
        assert_ne!(drive["state"], "OperationEnabled", "{what}: {devices:#}\n{document:#}");
    }
}

/// The table of all profiles that have a mode, for a bus whose two ends are `near` and `far`.
pub(super) fn no_command_leaves_torque(bus: Fieldbus, mode: OperationMode, near: &str, far: &str) {
    let mode = MODES.iter().find(|known| known.mode == mode).expect("a mode of rigs");
    let cells = |cells: &[String]| cells.iter().map(|cell| format!(" {cell:>10}")).collect::<String>();
    println!("exit codes, none of which leaves torque; - is not tried");
    println!("{:18} {:9}{}", "profile", "mode", cells(&COMMANDS.map(str::to_owned)));
    let folder = std::env::temp_dir().join(format!("yieldwall-shipped-{}-{}", mode.name, std::process::id()));
    let is_ethercat = bus == Fieldbus::Ethercat;
    let servos = ProfileName::shipped().filter_map(|(name, profile)| Some((name, profile, profile.servo()?)));
    let mut tried = 0;
    for (place, (name, profile, servo)) in servos.filter(|(_, profile, _)| profile.is_for(bus)).enumerate() {
        let has = |known: &Mode| servo.process_data.of(known.mode).is_some();
        if !has(mode) {
            continue;
        }
        tried += 1;
        let modes: Vec<&str> = MODES.iter().filter(|known| has(known)).map(|known| known.name).collect();
        // One of the modes of this profile: another one for the next command, and for the next profile.
        let is_turn = |command: usize, modes: &[&str]| modes[(place + command) % modes.len()] == mode.name;
        let shipped = Shipped { name, profile, mode, bus, near, far, folder: folder.clone() };
        let mut ends = vec![
            ("run", OK, shipped.command(Kind::Usual, &[], &["run", "--duration", "0.2"])),
            ("Ctrl-C", INTERRUPTED, shipped.interrupted()),
        ];
        if is_ethercat || is_turn(1, &modes) {
            let (wanted, end) = shipped.broken();
            ends.push(("fault", wanted, end));
        }
        if is_turn(2, &modes) {
            let jog = ["jog", "left", "--by", "-0.5deg", "--rate", "20deg", "--accept-drive-limit"];
            ends.push(("jog", OK, shipped.command(Kind::Usual, &["--no-hand"], &jog)));
        }
        // A whole commissioning takes most of a minute, and on CAN its last step takes ten seconds.
        if is_turn(0, &modes) && (is_ethercat || place == 0) {
            let (column, from) = match is_ethercat && place == 0 {
                true => ("commission", &[][..]),
                false => ("last step", &["--from", "admittance"][..]),
            };
            let words = [&["commission", "--yes", "--accept-drive-limit"], from].concat();
            ends.push((column, OK, shipped.command(Kind::Usual, &["--no-hand"], &words)));
        }
        if servo.homing.is_some() && (is_ethercat || is_turn(0, &modes)) {
            ends.push(("home", OK, shipped.command(Kind::Incremental, &["--no-hand"], &["home"])));
        }
        // In torque mode drives have to stop within 10 ms, which no cycle that is slow enough allows. On CAN a drill takes ten seconds.
        let slow: Vec<&str> = modes.iter().copied().filter(|mode| *mode != "torque").collect();
        if is_turn(0, &slow) && (is_ethercat || place % 3 == 0) {
            ends.push(("drill", OK, shipped.drilled()));
        }
        for (end, wanted, (code, document, devices)) in &ends {
            let what = format!("{name} {} {end}", mode.name);
            assert_eq!(code, wanted, "{what}: {document:#}");
            assert_no_torque(&what, document, devices);
        }
        let row = COMMANDS.map(|command| {
            let end = ends.iter().find(|(end, ..)| *end == command);
            end.map_or_else(|| "-".to_owned(), |(_, code, _)| code.to_string())
        });
        println!("{name:18} {:9}{}", mode.name, cells(&row));
    }
    assert!(tried >= 2, "{tried}");
    std::fs::remove_dir_all(folder).expect("it is there");
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn no_command_leaves_torque_on_can_in_torque_mode() {
    no_command_leaves_torque(Fieldbus::Canopen, OperationMode::CyclicTorque, &bus(), &bus());
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn no_command_leaves_torque_on_can_in_velocity_mode() {
    no_command_leaves_torque(Fieldbus::Canopen, OperationMode::CyclicVelocity, &bus(), &bus());
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn no_command_leaves_torque_on_can_in_position_mode() {
    no_command_leaves_torque(Fieldbus::Canopen, OperationMode::CyclicPosition, &bus(), &bus());
}
