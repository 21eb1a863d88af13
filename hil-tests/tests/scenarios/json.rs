//! What commands print: with `--json` one object, with the exit code of the process and a list of diagnostics; without it tables that fit a
//! terminal.

use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::Command;

use hil_tests::processes::{Process, output};
use serde_json::Value;

struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// What asks or changes the simulated devices of a rig on EtherCAT, with the exit code. In this order: a file is written before it is read.
const ON_ETHERCAT: [(&str, i32); 37] = [
    ("scan --rig builtin:paper-ethercat.yaml", 0),
    ("info sensor --rig builtin:paper-ethercat.yaml", 0),
    ("info 3 --rig builtin:paper-ethercat.yaml", 5),
    ("reg read left al-status 0300h --rig builtin:paper-ethercat.yaml", 0),
    ("reg read left al-statsu --rig builtin:paper-ethercat.yaml", 2),
    ("reg read left", 2),
    ("state left --rig builtin:paper-ethercat.yaml", 0),
    ("state all preop --rig builtin:paper-ethercat.yaml", 0),
    ("state left safeop --rig builtin:paper-ethercat.yaml", 5),
    ("state left preop", 2),
    ("errors --rig builtin:paper-ethercat.yaml", 0),
    ("errors wrist --clear --rig builtin:paper-ethercat.yaml", 0),
    ("dc --rig builtin:paper-ethercat.yaml", 0),
    ("od read left statusword 1018h:4 --rig builtin:paper-ethercat.yaml", 0),
    ("od read left 5000h --rig builtin:paper-ethercat.yaml", 5),
    ("od write left max-torque 900 --rig builtin:paper-ethercat.yaml", 0),
    ("od write left controlword 15 --rig builtin:paper-ethercat.yaml", 2),
    ("od dump wrist --out wrist.dcf --rig builtin:paper-ethercat.yaml", 0),
    ("od diff left right --rig builtin:paper-ethercat.yaml", 0),
    ("od diff left wrist.dcf --rig builtin:paper-ethercat.yaml", 7),
    ("od restore wrist.dcf wrist --rig builtin:paper-ethercat.yaml", 0),
    ("od restore wrist.dcf left --rig builtin:paper-ethercat.yaml", 5),
    ("state left --reset-fault --rig builtin:paper-ethercat.yaml", 2),
    ("emcy left --clear --rig builtin:paper-ethercat.yaml", 0),
    ("pdo show left --rig builtin:paper-ethercat.yaml", 0),
    ("emcy --rig builtin:paper-ethercat.yaml", 0),
    ("sii read left --rig builtin:paper-ethercat.yaml", 0),
    ("sii check --rig builtin:paper-ethercat.yaml", 0),
    ("sii read left --out left.sii --rig builtin:paper-ethercat.yaml", 0),
    ("sii read left --out left.sii --rig builtin:paper-ethercat.yaml", 2),
    ("sii write right left.sii --yes --rig builtin:paper-ethercat.yaml", 0),
    ("sii write wrist left.sii --yes --rig builtin:paper-ethercat.yaml", 5),
    ("sii write left bad.yaml --yes --rig builtin:paper-ethercat.yaml", 3),
    ("alias left 7 --yes --rig builtin:paper-ethercat.yaml", 0),
    ("alias left --rig builtin:paper-ethercat.yaml", 0),
    ("reg write left watchdog-sync-manager 100 --rig builtin:paper-ethercat.yaml", 0),
    ("reg write left al-control 8 --rig builtin:paper-ethercat.yaml", 2),
];

#[test]
fn every_command_prints_one_object_with_its_exit_code_and_its_diagnostics() {
    let folder = Folder(std::env::temp_dir().join(format!("yieldwall-json-{}", std::process::id())));
    std::fs::create_dir_all(&folder.0).unwrap();
    std::fs::write(folder.0.join("bad.yaml"), "rig: 5\n").unwrap();
    let rig = "builtin:paper-admittance.yaml";
    let run = format!("run {rig} --duration 0.2");
    // In this order: a recording is made before it is looked into.
    let cases: [(&str, i32); 85] = [
        (&format!("{run} --record rec"), 0),
        (&format!("run {rig} --duration 3 --fault node-reset@2.5 --black-box rec"), 8),
        (&format!("{run} --figure x.txt"), 2),
        (&format!("{run} --fault node-rest@0.1"), 2),
        ("run builtin:sphere.yaml --duration 0.2", 0),
        ("run bad.yaml", 3),
        ("run absent.yaml", 3),
        (&format!("config check {rig}"), 0),
        (&format!("config check {rig} bad.yaml absent.yaml"), 3),
        ("config check", 2),
        ("config chek", 2),
        ("faults", 0),
        ("faults node-reset", 0),
        ("faults node-rest", 2),
        ("explain node-reset 8130h 06090011 0x0637", 0),
        ("explain node-rest", 2),
        (&format!("bus budget {rig}"), 0),
        ("bus budget builtin:paper-admittance-two-buses.yaml", 0),
        ("bus budget builtin:paper-ethercat.yaml", 0),
        ("bus budget builtin:paper-ethercat.yaml --no-fifo", 2),
        (&format!("tune fixture {rig}"), 0),
        (&format!("tune loop {rig}"), 0),
        (&format!("sensor monitor {rig} --for 0.5"), 0),
        (&format!("sensor tare {rig} --up-to 0.001"), 7),
        ("home builtin:paper-incremental.yaml", 0),
        ("home builtin:paper-incremental.yaml --repeat 2", 0),
        ("home builtin:paper-incremental.yaml right --repeat 3 --within 0.001deg --defect loose-home:right", 7),
        (&format!("home {rig} left"), 2),
        (&format!("calibrate kinematics {rig}"), 0),
        (&format!("calibrate kinematics {rig} --points missing.csv"), 3),
        (&format!("sensor calibrate {rig}"), 0),
        (&format!("sensor calibrate {rig} --force 0.1"), 7),
        ("tune fixture builtin:sphere.yaml", 0),
        ("tune fixture builtin:scenes/room-walk.yaml", 2),
        ("record info rec", 0),
        ("record repair rec --out whole.mcap", 0),
        ("record export rec --csv rec.csv", 0),
        ("record export rec --csv rec.csv", 2),
        ("record info bad.yaml", 3),
        ("replay rec", 0),
        ("replay rec/paper-admittance-000001.black-box.mcap", 3),
        ("plot rec --figure rec.svg", 0),
        ("compare rec builtin:sphere.yaml --duration 0.1", 0),
        ("reproduce fig9 --out figures", 0),
        ("soak --seeds 0..2 --cycles 500", 0),
        ("soak --seeds 0..2 --cycles 500 --out soaked --shard 1/2", 0),
        ("soak --seeds 0..2 --cycles 500 --out soaked --missing --of 2", 0),
        ("soak --seeds 0..2 --cycles 500 --out soaked --merge", 2),
        ("study pair --slurm 4", 0),
        ("study all --missing --of 4", 0),
        ("scan", 0),
        ("scan --listen", 0),
        (&format!("run {rig} --fault wrong-bit-rate"), 5),
        ("doctor node left", 0),
        ("doctor node 5", 5),
        ("doctor node left --fault bus-off", 4),
        ("doctor node left --fault bus-of", 2),
        ("scan --rig builtin:paper-admittance-two-buses.yaml", 0),
        ("scan --rig absent.yaml", 3),
        ("info left", 0),
        ("info 77", 5),
        ("od read left statusword 1018h:4 position-actual", 0),
        ("od read left 5000h statusword", 5),
        ("od read lefft statusword", 2),
        ("od write left max-torque 900", 0),
        ("od write left max-torque 900 --dry-run", 0),
        ("od write left controlword 15", 2),
        ("od dump right --out right.dcf", 0),
        ("od dump right --out right.dcf", 2),
        ("od diff left right.dcf", 0),
        ("od diff left bad.yaml", 3),
        ("od restore right.dcf right --dry-run", 0),
        ("od restore right.dcf wrist", 5),
        ("pdo show wrist", 0),
        ("drive adopt --node left --out found.yaml", 0),
        ("drive adopt --node left --dry-run", 0),
        ("drive adopt --node wrist", 5),
        ("nmt left reset", 0),
        ("emcy", 0),
        ("state right", 0),
        ("state right --reset-fault", 2),
        ("monitor --for 0.5", 0),
        ("completions bash", 0),
        ("man", 0),
        ("man --out pages", 0),
    ];
    for (line, code) in cases.into_iter().chain(ON_ETHERCAT) {
        let mut program = Command::new(hil_tests::program());
        program.args(line.split(' ').chain(["--json"])).current_dir(&folder.0);
        let seen = output(program.env("XDG_STATE_HOME", folder.0.join("state")));
        let text = String::from_utf8(seen.stdout).unwrap();
        assert_eq!(seen.status.code(), Some(code), "{line}: {text}");
        let document: Value = serde_json::from_str(&text).unwrap_or_else(|error| panic!("{line}: {error}: {text}"));
        assert_eq!(document["exit_code"], code, "{line}: {text}");
        let diagnostics = document["diagnostics"].as_array().unwrap_or_else(|| panic!("{line}: {text}"));
        assert_eq!(diagnostics.iter().any(|one| one["severity"] == "error"), code != 0, "{line}: {text}");
        assert!(diagnostics.iter().all(|one| one["message"].is_string()), "{line}: {text}");
    }
}

/// A command that starts on a terminal of 80 columns, on which this was typed before, and the side of the person.
#[cfg(target_os = "linux")]
fn start_on_terminal(line: &str, folder: &Path, typed: &str) -> (Process, File) {
    use rustix::pty::{OpenptFlags, grantpt, ioctl_tiocgptpeer, openpt, unlockpt};
    use rustix::termios::{Winsize, tcsetwinsize};

    let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
    let master = openpt(flags).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let slave = ioctl_tiocgptpeer(&master, flags).unwrap();
    tcsetwinsize(&slave, Winsize { ws_row: 40, ws_col: 80, ws_xpixel: 0, ws_ypixel: 0 }).unwrap();
    let [input, shown, error] = [&slave; 3].map(|slave| slave.try_clone().unwrap());
    let mut program = Command::new(hil_tests::program());
    program.args(line.split(' ')).current_dir(folder).env("XDG_STATE_HOME", folder.join("state")).env("NO_COLOR", "1");
    let mut master = File::from(master);
    master.write_all(typed.as_bytes()).unwrap();
    let process = Process::start(program.stdin(input).stdout(shown).stderr(error));
    (process, master)
}

/// A terminal of 80 columns on which a command runs: its exit code, and the lines that are left on it.
#[cfg(target_os = "linux")]
fn on_terminal(line: &str, folder: &Path, typed: &str) -> (Option<i32>, Vec<String>) {
    let (process, mut master) = start_on_terminal(line, folder, typed);
    let mut seen = Vec::new();
    // It ends with an error once nobody has the other side open.
    let _ = master.read_to_end(&mut seen);
    let status = process.output().status;
    let text = String::from_utf8(seen).unwrap();
    let lines = text.split('\n').map(|line| {
        // What was drawn over is gone.
        let line = line.trim_end_matches('\r').rsplit('\r').next().unwrap_or_default();
        let mut parts = line.split('\u{1b}');
        let first = parts.next().unwrap_or_default().to_owned();
        let behind =
            |part: &str| part.trim_start_matches(|one: char| !one.is_ascii_alphabetic()).chars().skip(1).collect();
        first + &parts.map(behind).collect::<Vec<String>>().concat()
    });
    (status.code(), lines.collect())
}

/// Whether a line has to be wider than a terminal: it quotes a line of a file, or has one thing that is there to be copied and so is not
/// broken, a path or what stands between back quotes.
fn may_be_wide(line: &str) -> bool {
    let quotes_file = line.trim_start().split_once(' ').is_some_and(|(number, rest)| {
        (number.parse::<u32>().is_ok() && rest.starts_with('│')) || number.starts_with(['·', '╭'])
    });
    let body = line.trim();
    let body = body.strip_prefix("help: ").unwrap_or(body);
    let behind_key = body.split_once("  ").map_or(body, |(_, behind)| behind.trim());
    let is_one = |text: &str| match text.strip_prefix('`') {
        Some(rest) => rest.find('`').is_none_or(|end| !rest[end..].contains(' ')),
        None => text.contains('/') && !text.contains(' '),
    };
    quotes_file || is_one(body) || is_one(behind_key)
}

#[test]
#[cfg(target_os = "linux")]
fn what_a_person_reads_fits_a_terminal_of_eighty_columns() {
    let folder = Folder(std::env::temp_dir().join(format!("yieldwall-columns-{}", std::process::id())));
    std::fs::create_dir_all(&folder.0).unwrap();
    std::fs::write(folder.0.join("bad.yaml"), "rig: 5\n").unwrap();
    let rig = "builtin:paper-admittance.yaml";
    let run = format!("run {rig} --duration 0.2");
    let new = "new real.yaml --yes --drives maxon-epos4 --encoder multi_turn --mode position";
    // In this order: a recording is made before it is looked into.
    let cases: [(&str, i32); 95] = [
        ("--help", 0),
        ("run --help", 0),
        ("run", 2),
        (&format!("{run} --record rec --candump bus.log --figure fig.svg"), 0),
        (&format!("{run} --record rec"), 2),
        (&format!("run {rig} --duration 3 --fault node-reset@2.5:left --black-box rec"), 8),
        (&format!("run {rig} --duration 3 --fault emergency@0.5:left_drive --black-box rec"), 8),
        (&format!("{run} --fault node-rest@0.1"), 2),
        (&format!("{run} --fault node-reset@0.1:lefft"), 2),
        (&format!("run {rig} --dry-run"), 0),
        ("run builtin:paper-ethercat.yaml --dry-run", 0),
        ("run builtin:paper-ethercat-can-sensor.yaml --dry-run", 0),
        (&format!("run {rig} --fault wrong-bit-rate"), 5),
        ("run builtin:sphere.yaml --duration 0.2", 0),
        ("run builtin:vendors/four-entries.yaml --duration 0.2", 0),
        ("run bad.yaml", 3),
        ("run paper-admitance.yaml", 3),
        (&format!("config check {rig} builtin:sphere.yaml builtin:paper-admittance-csv.yaml"), 0),
        ("config check builtin:vendors/four-entries.yaml builtin:figures/fig11.yaml", 0),
        (&format!("config check {rig} bad.yaml absent.yaml"), 3),
        ("config chek", 2),
        ("faults", 0),
        ("faults node-reset wrong-bit-rate", 0),
        ("faults node-rest", 2),
        ("explain node-reset 8130h 06090011 0x0637", 0),
        ("explain 7380h --rig builtin:vendors/four-entries.yaml --node left", 0),
        ("explain node-rest", 2),
        (&format!("bus budget {rig}"), 0),
        ("bus budget builtin:paper-admittance-two-buses.yaml", 0),
        (&format!("tune fixture {rig} --hand-stiffness 100000 --hand-stiffness 20"), 0),
        ("tune fixture builtin:paper-admittance-csv.yaml", 0),
        ("tune fixture builtin:sphere.yaml", 0),
        (&format!("tune gains {rig}"), 0),
        (&format!("tune gains {rig} --write --yes"), 2),
        ("tune gains builtin:paper-admittance-csv.yaml", 0),
        ("tune gains builtin:paper-admittance-csp.yaml", 2),
        (&format!("tune loop {rig} --html loop.html"), 0),
        (&format!("sensor monitor {rig} --for 0.5"), 0),
        (&format!("sensor tare {rig} --up-to 3"), 0),
        ("home builtin:paper-incremental.yaml", 0),
        ("home builtin:paper-incremental.yaml --repeat 2", 0),
        ("home builtin:paper-incremental.yaml right --repeat 3 --within 0.001deg --defect loose-home:right", 7),
        (&format!("home {rig} left"), 2),
        (&format!("calibrate kinematics {rig}"), 0),
        (&format!("calibrate kinematics {rig} --points missing.csv"), 3),
        (&format!("sensor calibrate {rig}"), 0),
        (&format!("sensor calibrate {rig} --force 0.1"), 7),
        ("tune loop builtin:paper-admittance-csp.yaml", 0),
        ("record info rec", 0),
        ("record repair rec --out whole.mcap", 0),
        ("record export rec --csv rec.csv", 0),
        ("record export rec --csv rec.csv", 2),
        ("replay rec", 0),
        ("plot rec --figure rec.svg", 0),
        ("compare rec builtin:paper-admittance-csp.yaml --duration 0.1", 0),
        ("reproduce fig9 --out figures", 0),
        ("soak --seeds 0..2 --cycles 500", 0),
        (new, 0),
        ("run real.yaml", 7),
        ("new builtin.yaml --yes --drives simulated-serv", 2),
        (&format!("report {rig}"), 0),
        ("report absent.yaml", 3),
        ("scan", 0),
        ("scan --listen", 0),
        ("scan --rig builtin:paper-admittance-two-buses.yaml", 0),
        ("doctor node left", 0),
        ("doctor node 5", 5),
        ("doctor node left --fault bus-off", 4),
        ("info left", 0),
        ("info wrist", 0),
        ("info 77", 5),
        ("od read left statusword position-actual 1008h 1018h:2 max-torque 1400h:1", 0),
        ("od read lefft statusword", 2),
        ("od write left max-torque 900", 0),
        ("od write left max-torque 900 --dry-run", 0),
        ("od write left controlword 15", 2),
        ("od dump right --out right.dcf", 0),
        ("od dump right --out right.dcf", 2),
        ("od diff left right --all", 7),
        ("od restore right.dcf right --dry-run", 0),
        ("pdo show left", 0),
        ("pdo show wrist", 0),
        ("drive adopt --node left --out found.yaml", 0),
        ("drive adopt --node left --dry-run", 0),
        ("nmt left reset", 0),
        ("emcy", 0),
        ("state left", 0),
        ("state right --reset-fault", 2),
        ("lss find", 0),
        ("monitor --for 0.2", 0),
        (&format!("jog {rig} left --by 1deg --rate 20deg"), 0),
        (&format!("jog {rig} left --by 150deg"), 8),
        (&format!("jog {rig} left --by 5"), 2),
        ("commission --defect list", 0),
        (&format!("commission {rig} --from motor --defect cogging"), 7),
    ];
    let mut wide = Vec::new();
    for (line, code) in cases.into_iter().chain(ON_ETHERCAT) {
        let (exit, lines) = on_terminal(line, &folder.0, "");
        assert_eq!(exit, Some(code), "{line}: {}", lines.join("\n"));
        assert!(lines.iter().any(|line| !line.is_empty()), "{line}");
        let too_wide = lines.into_iter().filter(|line| line.chars().count() > 80 && !may_be_wide(line));
        wide.extend(too_wide.map(|seen| format!("{line}: {seen}")));
    }
    assert_eq!(wide, Vec::<String>::new(), "{}", wide.join("\n"));
    // Eight questions, each of which has a usual answer.
    let (exit, lines) = on_terminal("new asked.yaml", &folder.0, &"\n".repeat(8));
    assert_eq!(exit, Some(0), "{}", lines.join("\n"));
    // What is typed ahead is echoed before the questions, which then follow each other in one line.
    let of_answers = lines.iter().filter(|line| !line.contains('['));
    assert!(of_answers.clone().all(|line| line.chars().count() <= 80), "{}", lines.join("\n"));
    assert_eq!(lines.iter().filter(|line| line.contains("written   asked")).count(), 3, "{}", lines.join("\n"));
}

/// A `yes` that was typed before the question was there is no answer to it, and neither is `y`: the program writes nothing to a chip.
#[cfg(target_os = "linux")]
#[test]
fn only_a_yes_that_answers_the_question_counts() {
    let folder = Folder(std::env::temp_dir().join(format!("yieldwall-asked-{}", std::process::id())));
    std::fs::create_dir_all(&folder.0).unwrap();
    let rig = "--rig builtin:paper-ethercat.yaml";
    let (exit, lines) = on_terminal(&format!("sii read left --out left.sii {rig}"), &folder.0, "");
    assert_eq!(exit, Some(0), "{}", lines.join("\n"));
    let write = format!("sii write right left.sii {rig}");
    for (typed, answer, code) in [("yes\n", "no\n", 2), ("", "y\n", 2), ("yes\nye", "yes\n", 0)] {
        let (process, mut master) = start_on_terminal(&write, &folder.0, typed);
        let (mut seen, mut bytes, mut answered) = (String::new(), [0; 256], 0);
        // It ends with an error once nobody has the other side open.
        while let Ok(count @ 1..) = master.read(&mut bytes) {
            seen += &String::from_utf8_lossy(&bytes[..count]);
            if seen.matches("stops here: ").count() > answered {
                answered += 1;
                // An answer that comes at once does not count; the question comes again then.
                std::thread::sleep(std::time::Duration::from_secs(1));
                master.write_all(answer.as_bytes()).unwrap();
            }
        }
        assert_ne!(answered, 0, "{typed:?} is no answer: {seen}");
        assert_eq!(process.output().status.code(), Some(code), "{typed:?}, then {answer:?}: {seen}");
    }
}

/// Each line is an event, and the last one what `--json` prints, on one line.
#[test]
fn a_stream_has_an_object_a_line_and_ends_with_the_document() {
    let folder = Folder(std::env::temp_dir().join(format!("yieldwall-jsonl-{}", std::process::id())));
    std::fs::create_dir_all(&folder.0).unwrap();
    let lines = |line: &str| {
        let mut program = Command::new(hil_tests::program());
        let seen = output(program.args(line.split(' ')).current_dir(&folder.0).env("XDG_STATE_HOME", &folder.0));
        let text = String::from_utf8(seen.stdout).unwrap();
        let each =
            text.lines().map(|one| serde_json::from_str(one).unwrap_or_else(|error| panic!("{line}: {error}: {one}")));
        (seen.status.code().unwrap(), each.collect::<Vec<Value>>())
    };
    let run = "run builtin:paper-admittance.yaml --duration 0.3";
    for (line, code, must) in [
        (format!("{run} --jsonl"), 0, vec!["booted", "enabled", "stopped", "end"]),
        (
            format!("{run} --jsonl --fault drive-fault@0.2:left_drive"),
            6,
            vec!["enabled", "emergency", "fault", "error", "end"],
        ),
        ("latency --duration 0.05 --jsonl".to_owned(), 0, vec!["begun", "end"]),
        ("run absent.yaml --jsonl".to_owned(), 3, vec![]),
    ] {
        let (exit, lines) = lines(&line);
        assert_eq!(exit, code, "{line}: {lines:?}");
        let (last, events) = lines.split_last().unwrap();
        assert!(
            last["exit_code"] == code && last["diagnostics"].is_array() && last["event"].is_null(),
            "{line}: {last}"
        );
        let mut names = events.iter().map(|event| event["event"].as_str().unwrap());
        assert!(events.iter().all(|event| event["text"].is_string() && event.get("time_s").is_some()), "{line}");
        for name in must {
            assert!(names.any(|known| known == name), "{line}: no {name} in its place: {events:?}");
        }
    }
}
