//! The commands that ask devices one by one, on an interface with simulated devices.

use std::io::{BufRead, BufReader, Write};
use std::process::{Command, Stdio};
use std::time::Instant;

use hil_tests::processes::{Process, output};
use serde_json::Value;

use super::programs::*;

/// A command on the interface with the names of a rig.
fn ask_of(rig: &str, line: &str) -> (i32, Value) {
    let bus = bus();
    let arguments: Vec<&str> = line.split(' ').chain(["--bus", &bus, "--rig", rig, "--json"]).collect();
    Running::start(&arguments).document()
}

fn ask(line: &str) -> (i32, Value) {
    ask_of(RIG, line)
}

/// What `run` or `drill` would send.
fn dry_run(command: &str) -> (i32, Value) {
    Running::start(&[command, RIG, "--bus", &bus(), "--dry-run", "--json"]).document()
}

fn well_of(rig: &str, line: &str) -> Value {
    let (code, document) = ask_of(rig, line);
    assert_eq!(code, OK, "{line}: {document:#}");
    document
}

fn well(line: &str) -> Value {
    well_of(RIG, line)
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn devices_are_found_read_changed_compared_and_put_back() {
    let sim = Running::sim(RIG, &[]);
    let begun = Instant::now();
    let found = well("scan");
    let took = begun.elapsed();
    let nodes: Vec<_> = found["nodes"].as_array().unwrap().iter().collect();
    let fits: Vec<(u64, &str)> =
        nodes.iter().map(|node| (node["node_id"].as_u64().unwrap(), node["fits"].as_str().unwrap())).collect();
    assert_eq!(fits, [(1, "left"), (2, "right"), (10, "wrist")], "{found:#}");
    println!("scan took {:.2} s", took.as_secs_f64());

    let file = std::env::temp_dir().join(format!("yieldwall-desk-{}.dcf", std::process::id()));
    let path = file.to_str().unwrap();
    let _ = std::fs::remove_file(&file);
    well(&format!("od dump left --out {path}"));
    assert_eq!(well(&format!("od diff left {path}"))["differences"], Value::Array(vec![]));
    // Neither is written by saying what a run or a drill would write.
    for command in ["run", "drill"] {
        let (code, told) = dry_run(command);
        assert_eq!(code, OK, "{command}: {told:#}");
        let sends = told["sends"].as_array().unwrap();
        let writes = sends.iter().filter(|send| send["part"] == "configure");
        assert!(writes.clone().count() > 60 && writes.clone().all(|write| write["old"].is_object()), "{told:#}");
    }
    assert_eq!(well(&format!("od diff left {path}"))["differences"], Value::Array(vec![]));
    for (object, value) in
        [("max-torque", "900"), ("605ah", "6"), ("1017h", "100"), ("6065h", "1000"), ("60c2h:1", "2")]
    {
        let written = well(&format!("od write left {object} {value}"));
        assert_eq!(written["writes"].as_array().unwrap().len(), 1, "{written:#}");
    }
    let (code, differs) = ask(&format!("od diff left {path}"));
    assert_eq!((code, differs["differences"].as_array().unwrap().len()), (OUT_OF_TOLERANCE, 5), "{differs:#}");
    // Nothing is changed by saying what would be.
    let dry = well(&format!("od restore {path} left --dry-run"));
    assert_eq!(dry["writes"].as_array().unwrap().len(), 5, "{dry:#}");
    assert_eq!(ask(&format!("od diff left {path}")).0, OUT_OF_TOLERANCE);
    well(&format!("od restore {path} left"));
    assert_eq!(well(&format!("od diff left {path}"))["differences"], Value::Array(vec![]));
    // What was written over was kept, and can be put back.
    let kept = own_state().join("yieldwall/backups");
    let backups: Vec<_> = std::fs::read_dir(&kept).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert!(backups.len() >= 6, "{backups:?}");
    let oldest = backups.iter().min().unwrap().to_str().unwrap();
    assert_eq!(well(&format!("od restore {oldest} left"))["writes"], Value::Array(vec![]));

    assert_eq!(well("nmt left start")["state"], "Operational");
    let (code, _) = ask(&format!("od restore {path} left"));
    assert_eq!(code, 2, "not while process data run");
    assert_eq!(well("nmt left reset")["state"], "Pre-operational");
    assert_eq!(well("state left")["state"], "SwitchOnDisabled");
    assert_eq!(well("info wrist")["name"], "simulated-force-sensor");
    assert_eq!(well("emcy left")["nodes"][0]["errors"], Value::Array(vec![]));
    assert_eq!(ask("od read 77 statusword").0, DEVICE_MISMATCH);
    let _ = std::fs::remove_file(&file);
    sim.interrupted();
}

/// Scanned, read, adopted and run, from files alone.
#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn drives_of_five_odd_vendors_run_by_what_was_found_of_them() {
    let folder = std::env::temp_dir().join(format!("yieldwall-vendors-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    for vendor in ["four-entries", "mode-below-enabled", "no-rpdo-timer", "slow-segments", "wrong-lengths"] {
        let rig = format!("builtin:vendors/{vendor}.yaml");
        let sim = lockstep(&rig);
        if vendor == "slow-segments" {
            let begun = Instant::now();
            assert_eq!(well_of(&rig, "scan")["nodes"].as_array().unwrap().len(), 3);
            println!("scan of slow drives took {:.2} s", begun.elapsed().as_secs_f64());
        }
        assert_eq!(well_of(&rig, "info right")["name"], vendor);
        let read = well_of(&rig, "od read left statusword");
        assert_eq!(read["objects"][0]["means"], "Switch On Disabled", "{vendor}: {read:#}");
        let profile = folder.join(format!("{vendor}.yaml"));
        let begun = Instant::now();
        let adopted = well_of(&rig, &format!("drive adopt --node left --out {}", profile.display()));
        println!("adopting {vendor} took {:.2} s", begun.elapsed().as_secs_f64());
        assert_eq!(adopted["modes"].as_array().unwrap().len(), 3, "{adopted:#}");
        let shown = output(Command::new(program()).args(["config", "show", &rig]));
        let shown = String::from_utf8(shown.stdout).unwrap();
        let own = format!("  profile: builtin:vendors/profiles/{vendor}.yaml\n");
        let found = shown.replacen(&own, &format!("  profile: {vendor}.yaml\n  encoder: multi_turn\n"), 2);
        assert_eq!(found.matches(&own).count(), 1, "{found}");
        let path = folder.join("rig.yaml");
        std::fs::write(&path, found).unwrap();
        let program = Running::run(path.to_str().unwrap(), &["--pace", "lockstep", "--duration", "0.3"]);
        let (code, document) = program.document();
        assert_eq!(code, OK, "{vendor}: {document:#}");
        sim.interrupted();
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_device_gets_another_node_id_by_lss() {
    let sim = Running::sim(RIG, &[]);
    let (code, taken) = ask("lss set-id left 2");
    assert_eq!(code, 2, "{taken:#}");
    assert_eq!(well("lss set-id left 9")["node_id"], 9);
    let (code, moved) = ask("nmt left reset");
    assert_eq!(code, DEVICE_MISMATCH, "it boots as node 9: {moved:#}");
    let nodes: Vec<u64> =
        well("scan")["nodes"].as_array().unwrap().iter().filter_map(|node| node["node_id"].as_u64()).collect();
    assert_eq!(nodes, [2, 9, 10]);
    sim.interrupted();
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn beside_a_rig_that_runs_nothing_is_sent_and_all_is_heard() {
    let sim = lockstep(RIG);
    let observer = Observer::new();
    let rig = run_for("3600");
    observer.until_moving(300);
    for line in ["scan", "info left", "od read left statusword", "nmt left stop", "lss find", "emcy", "state left"] {
        let (code, refused) = ask(line);
        assert_eq!(code, BUS_UNAVAILABLE, "{line}: {refused:#}");
    }
    for command in ["run", "drill"] {
        let (code, refused) = dry_run(command);
        assert_eq!(code, BUS_UNAVAILABLE, "{command}: {refused:#}");
    }
    let heard = well("scan --listen");
    let nodes: Vec<u64> =
        heard["nodes"].as_array().unwrap().iter().filter_map(|node| node["node_id"].as_u64()).collect();
    assert!([1, 2, 10].iter().all(|node| nodes.contains(node)), "{heard:#}");
    // More than a pipe holds: it is read while it is written.
    let bus = bus();
    let monitor = ["monitor", "--for", "0.3", "--bus", &bus, "--rig", RIG, "--json"];
    let seen = output(Command::new(program()).args(monitor));
    let frames: Value = serde_json::from_slice(&seen.stdout).unwrap();
    let texts: Vec<&str> =
        frames["frames"].as_array().unwrap().iter().filter_map(|frame| frame["what"].as_str()).collect();
    for wanted in ["SYNC", "RPDO 1 of 1 (left): controlword 000Fh", "TPDO 1 of 2 (right): statusword"] {
        assert!(
            texts.iter().any(|text| text.starts_with(wanted)),
            "{wanted} is not in {:#?}",
            &texts[..texts.len().min(30)]
        );
    }
    rig.signal("INT");
    let (code, document) = rig.document();
    assert_eq!((code, &document["state"]), (INTERRUPTED, &"Running".into()), "{document:#}");
    sim.interrupted();
}

/// A check of `doctor` by its subject.
fn check<'a>(document: &'a Value, subject: &str) -> &'a Value {
    let checks = document["checks"].as_array().unwrap();
    checks.iter().find(|check| check["subject"] == subject).unwrap_or_else(|| panic!("{subject}: {document:#}"))
}

/// Runs the command that a check prints; `sudo` is left out, since these tests are root.
fn fix(check: &Value) {
    let command = check["fix"].as_str().unwrap_or_else(|| panic!("{check:#}"));
    let with_program = command.replace("sudo ", "").replace("yieldwall ", &format!("{} ", program().display()));
    let done = output(Command::new("sh").args(["-c", &with_program]));
    assert!(done.status.success(), "{command}: {}", String::from_utf8_lossy(&done.stderr));
}

fn doctor(line: &str) -> (i32, Value) {
    let arguments: Vec<&str> = ["doctor"].into_iter().chain(line.split(' ')).chain(["--json"]).collect();
    Running::start(&arguments).document()
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn doctor_finds_troubles_of_the_interface_and_its_commands_mend_them() {
    let bus = bus();
    let sim = Running::sim(RIG, &[]);
    let asked = format!("{RIG} --bus {bus}");
    let (_, well) = doctor(&asked);
    assert_eq!(check(&well, "interface")["verdict"], "ok", "{well:#}");
    assert_eq!(check(&well, "devices")["found"], "1, 2 and 10 are heard");
    assert_eq!(check(&well, "identifiers")["verdict"], "ok", "{well:#}");

    Command::new("ip").args(["link", "set", &bus, "txqueuelen", "10000"]).status().unwrap();
    Command::new("tc").args(["qdisc", "replace", "dev", &bus, "root", "pfifo_fast"]).status().unwrap();
    let (_, long) = doctor(&format!("--bus {bus}"));
    let queue = check(&long, "queue");
    assert!(queue["verdict"] == "warning" && queue["found"].as_str().unwrap().contains("10000"), "{queue:#}");
    fix(queue);
    let (_, mended) = doctor(&format!("--bus {bus}"));
    assert_eq!(check(&mended, "queue")["found"], "128 frames", "{mended:#}");
    Command::new("tc").args(["qdisc", "del", "dev", &bus, "root"]).status().unwrap();
    Command::new("ip").args(["link", "set", &bus, "txqueuelen", "0"]).status().unwrap();
    sim.interrupted();

    let down = PutBack::down(&bus);
    for line in [asked.clone(), format!("node left --rig {RIG} --bus {bus}")] {
        let (code, refused) = doctor(&line);
        assert_eq!((code, &check(&refused, "interface")["verdict"]), (BUS_UNAVAILABLE, &"wrong".into()), "{refused:#}");
        fix(check(&refused, "interface"));
        let (_, mended) = doctor(&asked);
        assert_eq!(check(&mended, "interface")["verdict"], "ok", "{mended:#}");
        Command::new("ip").args(["link", "set", &bus, "down"]).status().unwrap();
    }
    drop(down);
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn doctor_says_why_a_node_does_not_answer() {
    let bus = bus();
    let node = |word: &str| doctor(&format!("node {word} --bus {bus} --rig {RIG}"));
    let (code, alone) = node("left");
    assert_eq!((code, &check(&alone, "silence")["verdict"]), (BUS_UNAVAILABLE, &"wrong".into()), "{alone:#}");

    let sim = Running::sim(RIG, &[]);
    let (code, well) = node("left");
    assert_eq!((code, &well["answers"]), (OK, &true.into()), "{well:#}");
    let (code, silent) = node("5");
    assert_eq!(code, DEVICE_MISMATCH, "{silent:#}");
    assert_eq!(check(&silent, "silent")["found"], "node 5 is silent; 1, 2 and 10 answered");

    assert_eq!(ask("nmt right stop").0, OK);
    let (code, stopped) = node("right");
    assert_eq!((code, &check(&stopped, "stopped")["found"]), (DEVICE_MISMATCH, &"node 2 (right) is in Stopped".into()));
    fix(check(&stopped, "stopped"));
    assert_eq!(node("right").0, OK);

    let doubles = Doubles::start(RIG, None, yieldwall::run::Pace::Free);
    let (code, double) = node("left");
    let found = check(&double, "node id")["found"].as_str().unwrap();
    assert!(code == DEVICE_MISMATCH && found.starts_with("two devices answer as node 1 (left)"), "{double:#}");
    drop(doubles);
    sim.interrupted();
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn run_and_drill_name_who_is_silent_who_answered_and_what_finds_out_why() {
    let bus = bus();
    let sim = Running::sim(RIG, &["--pace", "lockstep"]);
    assert_eq!(ask("lss set-id right 9").0, OK);
    let (code, _) = ask("nmt right reset");
    assert_eq!(code, DEVICE_MISMATCH, "it boots as node 9");
    let drill = ["drill", RIG, "--bus", &bus, "--json"];
    // One after the other: two masters refuse each other.
    for is_drill in [false, true] {
        let program = if is_drill { Running::start(&drill) } else { run_for("1") };
        let (code, message, help) = refusal(program);
        assert_eq!(code, DEVICE_MISMATCH, "{message}");
        assert!(message.starts_with("node 2 (right) is silent; 1 and 10 answered"), "{message}");
        assert!(
            help.starts_with(&format!("`yieldwall doctor node 2 --bus {bus} --rig {RIG}` finds out why")),
            "{help}"
        );
    }
    let (_, found) = doctor(&format!("node 2 --bus {bus} --rig {RIG}"));
    let silent = check(&found, "silent");
    assert_eq!(silent["fix"], format!("yieldwall lss set-id 9 2 --bus {bus} --rig {RIG}"), "{found:#}");
    fix(silent);
    assert_eq!(ask("nmt 9 reset").0, DEVICE_MISMATCH, "it boots as node 2 again");
    assert_eq!(doctor(&format!("node 2 --bus {bus} --rig {RIG}")).0, OK);
    sim.interrupted();
}

/// A user without any privilege, whose shell runs `doctor` before and after the command that it prints.
#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn no_real_time_priority_is_mended_for_the_shell_that_asked() {
    let user = ["--reuid", "65534", "--regid", "65534", "--clear-groups", "--inh-caps=-all", "sh"];
    let mut shell = Command::new("prlimit")
        .args(["--rtprio=0:0", "setpriv"])
        .args(user)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("util-linux is installed");
    // `prlimit` and `setpriv` become the shell.
    let pid = shell.id().to_string();
    let mut stdin = shell.stdin.take().unwrap();
    let mut shell = Process::of(shell);
    let mut lines = BufReader::new(shell.stdout().clone()).lines();
    let mut ask = || {
        writeln!(stdin, "{} doctor --json; echo END", program().display()).unwrap();
        let said: Vec<String> = lines.by_ref().map(Result::unwrap).take_while(|line| line != "END").collect();
        let text = said.join("\n");
        serde_json::from_str::<Value>(&text).unwrap_or_else(|error| panic!("{error}: {text}"))
    };
    let refused = ask();
    let priority = check(&refused, "priority");
    assert_eq!((&priority["verdict"], &refused["exit_code"]), (&"wrong".into(), &TIMING_MISSED.into()), "{refused:#}");
    // The command is for the shell in which it is typed.
    let command = priority["fix"].as_str().unwrap();
    assert!(command.contains("--pid $$"), "{command}");
    let command = command.replace("$$", &pid).replace("sudo ", "");
    let done = output(Command::new("sh").args(["-c", &command]));
    assert!(done.status.success(), "{command}: {}", String::from_utf8_lossy(&done.stderr));
    let granted = ask();
    assert_eq!(check(&granted, "priority")["verdict"], "ok", "{granted:#}");
    drop(stdin);
    shell.output();
}
