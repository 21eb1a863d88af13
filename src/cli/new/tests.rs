//! Every combination that is offered, and what is refused.

use std::ffi::OsString;

use clap::{Parser, ValueEnum};

use super::choice::{Law, Mode, Person, Protocol, ask};
use super::{compose, names};
use crate::config::Checked;
use crate::failure::Exit;
use crate::run;
use crate::sample::share;

fn word<T: ValueEnum>(value: &T) -> String {
    value.to_possible_value().unwrap().get_name().to_owned()
}

fn exit(arguments: &[&str]) -> Exit {
    let words = ["yieldwall", "-q", "--deny-warnings"].into_iter().chain(arguments.iter().copied());
    run(words.map(OsString::from))
}

/// A folder that is empty, and gone in the end.
struct Folder(std::path::PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("yieldwall-new-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn file(&self, name: &str) -> String {
        self.0.join(name).display().to_string()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// The flags of `new`, without the rest of the program.
#[derive(clap::Parser)]
struct Flags {
    #[command(flatten)]
    arguments: super::Arguments,
}

/// Returns the findings of `config check` on a rig with these flags, or the exit code with which the flags are refused. The check runs
/// the scene as `run` does, and an exit code other than 0 is a warning.
fn findings(flags: &[&str]) -> Result<Vec<yieldwall_config::Diagnostic>, Exit> {
    let flags = Flags::try_parse_from(["new", "rig.yaml", "--yes"].iter().chain(flags)).map_err(|_| Exit::Usage)?;
    let made = ask(&flags.arguments, None).and_then(|choice| {
        let files = compose(&choice, &names(&flags.arguments.rig)?)?;
        files.source(&choice)
    });
    let mut checked = Checked::of(made.map_err(|failure| failure.exit)?);
    checked.rehearse();
    Ok(checked.findings)
}

#[test]
fn every_combination_that_is_offered_passes_the_check_without_a_warning() {
    let mut all = Vec::new();
    for mode in Mode::value_variants() {
        for sensor in Protocol::value_variants() {
            let laws = if *mode == Mode::Torque { Law::value_variants() } else { &[Law::Psmc] };
            for law in laws {
                all.extend(["1000", "2000", "5000"].map(|period| (mode, sensor, law, period)));
            }
        }
    }
    let is_offered = |(mode, sensor, _, period): &(&Mode, &Protocol, &Law, &str)| match (**mode, **sensor, *period) {
        (Mode::Torque, _, "5000") => false,
        // Longer set-points and two answers more do not fit 1 Mbit/s.
        (Mode::Velocity | Mode::Position, Protocol::Polled, "1000") => false,
        _ => true,
    };
    assert_eq!(all.iter().filter(|case| is_offered(case)).count(), 12 + 8 + 8);
    for case in share(all, 8) {
        let (mode, sensor, law, period) = case;
        let (mode_word, sensor_word, law_word) = (word(mode), word(sensor), word(law));
        let mut flags = vec!["--mode", &mode_word, "--sensor", &sensor_word, "--period-us", period];
        if *mode == Mode::Torque {
            flags.extend(["--law", &law_word]);
        }
        let wanted = if is_offered(&case) { Ok(Vec::new()) } else { Err(Exit::Usage) };
        assert_eq!(findings(&flags), wanted, "{flags:?}");
    }
}

#[test]
fn a_rig_on_ethercat_is_offered_in_each_mode() {
    for (mode, period) in [("torque", "1000"), ("torque", "500"), ("velocity", "1000"), ("position", "2000")] {
        let flags = ["--bus", "ethercat", "--mode", mode, "--period-us", period];
        assert_eq!(findings(&flags), Ok(Vec::new()), "{flags:?}");
    }
}

#[test]
fn links_and_node_ids_are_the_users_own() {
    let folder = Folder::new("links");
    for links in ["0.2,0.25", "0.25,0.35", "0.5,0.7"] {
        let rig = folder.file(&format!("links-{}.yaml", links.replace([',', '.'], "-")));
        assert_eq!(exit(&["new", "--yes", &rig, "--links", links, "--nodes", "5,6,7"]), Exit::Ok, "{links}");
        assert_eq!(exit(&["run", &rig]), Exit::Ok, "{links}");
        let written = yieldwall_config::load_rig(yieldwall_config::Source::disk(&rig)).unwrap().value;
        assert_eq!(written.drives.each_ref().map(|drive| drive.address.node_id()), [Some(5), Some(6)]);
    }
}

#[test]
fn what_does_not_go_together_is_refused_before_anything_is_written() {
    let folder = Folder::new("refused");
    let rig = folder.file("rig.yaml");
    for more in [
        &["--mode", "position", "--law", "pid"][..],
        &["--mode", "torque", "--period-us", "5000"],
        &["--nodes", "1,1,2"],
        &["--nodes", "1,2,3", "--sensor", "polled"],
        &["--nodes", "0,1"],
        &["--drives", "simulated-serv"],
        &["--drives", "no-such.yaml"],
        &["--drives", "simulated-force-sensor"],
        &["--bus", "ethercat", "--drives", "maxon-epos4", "--encoder", "multi_turn"],
        &["--drives", "inovance-sv660n", "--encoder", "multi_turn"],
        &["--links", "0.5,0.05"],
        &["--links", "0.5"],
        &["--links", "NaN,0.4"],
        &["--encoder", "incremental"],
        &["--bus", "ethercat", "--nodes", "1,2"],
        &["--bus", "ethercat", "--sensor", "polled"],
    ] {
        let arguments: Vec<&str> = ["new", "--yes", &rig].into_iter().chain(more.iter().copied()).collect();
        assert_eq!(exit(&arguments), Exit::Usage, "{more:?}");
    }
    // A drive whose encoder may have forgotten where it is.
    assert_eq!(exit(&["new", "--yes", &rig, "--drives", "maxon-epos4"]), Exit::ConfigInvalid);
    assert_eq!(exit(&["new", "--yes", &folder.file("rig.txt")]), Exit::Usage);
    assert_eq!(std::fs::read_dir(&folder.0).unwrap().count(), 0);
    assert_eq!(exit(&["new", "--yes", &rig]), Exit::Ok);
    let before = std::fs::read_to_string(&rig).unwrap();
    assert_eq!(exit(&["new", "--yes", &rig, "--mode", "position"]), Exit::Usage);
    assert_eq!(std::fs::read_to_string(&rig).unwrap(), before);
    assert_eq!(exit(&["new", "--yes", &rig, "--mode", "position", "--force"]), Exit::Ok);
    assert_ne!(std::fs::read_to_string(&rig).unwrap(), before);
}

/// A profile in a file is read where it lies, also from a rig in another folder.
#[test]
fn a_profile_of_ones_own_is_a_file() {
    let folder = Folder::new("profile");
    let profile = folder.file("own.yaml");
    let shipped = yieldwall_drives::profiles::SHIPPED.iter().find(|(name, _)| *name == "simulated-servo").unwrap().1;
    std::fs::write(&profile, shipped).unwrap();
    let rig = folder.file("in/here/rig.yaml");
    assert_eq!(exit(&["new", "--yes", &rig, "--drives", &profile]), Exit::Ok);
    assert_eq!(exit(&["config", "check", &rig]), Exit::Ok);
}

/// An empty answer at a terminal takes the default, a wrong answer repeats the question, and without an answer no rig is created.
#[test]
fn what_is_not_given_is_asked() {
    let asked = |flags: &[&str], said: &str| {
        let flags = Flags::try_parse_from(["new", "rig.yaml"].iter().chain(flags)).unwrap();
        let (mut answers, mut questions) = (said.as_bytes(), Vec::new());
        let person = Person { answers: &mut answers, questions: &mut questions, columns: 80 };
        let choice = ask(&flags.arguments, Some(person));
        (choice, String::from_utf8(questions).unwrap(), answers.len())
    };
    let usual = ask(&Flags::try_parse_from(["new", "rig.yaml"]).unwrap().arguments, None).unwrap();
    let (choice, questions, left) = asked(&[], &"\n".repeat(8));
    assert_eq!((format!("{:?}", choice.unwrap()), left), (format!("{usual:?}"), 0));
    assert!(questions.contains("command mode of the drives: torque, velocity, position [torque] "), "{questions}");
    // What is answered is not among it, nor the end of its line.
    let each = questions.split_inclusive("] ").flat_map(str::lines);
    assert!(each.clone().count() >= 8 && each.clone().all(|line| line.chars().count() <= 80), "{questions}");

    let answers =
        "speed\nposition\n400\n 2000 \ncan\nstreaming\nsimulated-serv\nsimulated-servo\n5,5\n5,6\n0.3\n0.2,0.25\n";
    let (choice, questions, left) = asked(&[], answers);
    let choice = choice.unwrap();
    assert_eq!((choice.mode, choice.period_us, choice.sensor), (Mode::Position, 2000, Protocol::Streaming));
    assert_eq!((choice.nodes, choice.links_m, left), ([5, 6, 0], [0.2, 0.25], 0));
    for wanted in [
        "write one of torque, velocity, position",
        "a whole number from 500 to 10000",
        "did you mean simulated-servo?",
        "each device needs its own node id",
        "two lengths, separated by a comma",
    ] {
        assert!(questions.contains(&format!("\n  {wanted}\n")) || questions.contains(wanted), "{wanted}: {questions}");
    }

    // What a flag says is not asked.
    let (choice, questions, left) =
        asked(&["--mode", "velocity", "--nodes", "5,6,7", "--links", "0.2,0.25"], "\n\n\n\n");
    assert_eq!((choice.unwrap().mode, left), (Mode::Velocity, 0));
    assert!(!questions.contains("command mode") && !questions.contains("node ids"), "{questions}");

    let (refused, questions, _) = asked(&[], "torque\n");
    assert_eq!(refused.unwrap_err().exit, Exit::Usage);
    assert!(questions.ends_with(" \n"), "what follows begins a line: {questions:?}");
}

/// The next steps name the values that a real drive's profile leaves open; for simulated drives they name none.
#[test]
fn what_comes_next_is_what_the_profile_allows() {
    let next = |flags: &[&str]| {
        let flags = Flags::try_parse_from(["new", "rig.yaml", "--yes"].iter().chain(flags)).unwrap();
        let choice = ask(&flags.arguments, None).unwrap();
        let files = compose(&choice, &names(&flags.arguments.rig).unwrap()).unwrap();
        let mut checked = Checked::of(files.source(&choice).unwrap());
        checked.rehearse();
        super::next("rig.yaml", &checked).join("\n")
    };
    let simulated = next(&[]);
    assert!(simulated.contains("`yieldwall run rig.yaml` runs it") && !simulated.contains("drill"), "{simulated}");
    let real = next(&["--drives", "maxon-epos4", "--encoder", "multi_turn", "--mode", "position"]);
    for wanted in [
        "the drive has no watchdog for SYNC; time until the drive stops without set-points",
        "`yieldwall run rig.yaml` refuses it",
        "`yieldwall drill rig.yaml --bus can0`",
    ] {
        assert!(real.contains(wanted), "{wanted}: {real}");
    }
    assert!(!real.contains("runs it on the embedded simulation"), "{real}");
    let segment = next(&["--bus", "ethercat", "--drives", "inovance-sv660n", "--encoder", "multi_turn"]);
    assert!(segment.contains("`yieldwall drill rig.yaml --bus eth0`"), "{segment}");
    assert!(!segment.contains("can0") && !segment.contains("SYNC"), "{segment}");
}
