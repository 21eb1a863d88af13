// Each of its users takes a part of it.
#[allow(dead_code, unused_imports, clippy::duplicate_mod)]
#[path = "../config/malformed/mod.rs"]
mod malformed;

use super::failure::{Exit, exit_codes};
use super::*;
use crate::sample::share;
use malformed::CASES;
use yieldwall_config::Source;

#[test]
fn arguments_are_consistent() {
    Arguments::command().debug_assert();
}

#[test]
fn help_lists_every_exit_code() {
    for exit in [
        Exit::Ok,
        Exit::Internal,
        Exit::Usage,
        Exit::ConfigInvalid,
        Exit::BusUnavailable,
        Exit::DeviceMismatch,
        Exit::DeviceFault,
        Exit::OutOfTolerance,
        Exit::SafetyStop,
        Exit::TimingMissed,
        Exit::Interrupted,
    ] {
        assert!(exit_codes().lines().any(|line| line.trim().starts_with(&format!("{} ", exit.code()))), "{exit:?}");
    }
}

/// Messages for a newcomer on each malformed file, one snapshot for each class.
#[test]
fn messages_of_malformed_files() {
    let renderer = super::render::Renderer::new(false);
    let mut classes: Vec<(&str, String)> = Vec::new();
    for case in CASES {
        let report =
            yieldwall_config::load(case.source()).err().unwrap_or_else(|| panic!("{} was accepted", case.name));
        let text = format!("## {}\n{}\n", case.name, renderer.render(&report.diagnostics));
        match classes.last_mut() {
            Some((class, all)) if *class == case.class => all.push_str(&text),
            _ => classes.push((case.class, text)),
        }
    }
    for (class, text) in classes {
        insta::assert_snapshot!(class.replace(' ', "-"), text);
    }
}

#[test]
fn values_are_set_for_one_run() {
    let exit = |line: &str| run(line.split(' ').map(OsString::from));
    let rig = "yieldwall -q run builtin:play.yaml --duration 0.1";
    assert_eq!(exit(&format!("{rig} --set fixture.yield_n=25 --set simulation.arm.tool_kg=1.2")), Exit::Ok);
    assert_eq!(exit(&format!("{rig} --set fixture.yield_n=-1")), Exit::ConfigInvalid);
    assert_eq!(exit(&format!("{rig} --set fixture.yield_n")), Exit::Usage);
    assert_eq!(exit(&format!("{rig} --set fixture.yield_n=25 --set fixture.yield_n=26")), Exit::Usage);
}

#[test]
fn combinations_of_values_are_swept() {
    let folder = std::env::temp_dir().join(format!("yieldwall-swept-{}", std::process::id()));
    let exit = |arguments: &str| {
        let line = format!("yieldwall -q sweep {arguments} --duration 0.1 --out {}", folder.display());
        run(line.split(' ').map(OsString::from))
    };
    let yields = "builtin:play.yaml --set fixture.yield_n=20,25";
    assert_eq!(exit(&format!("{yields} --set scene.hand.mass_kg=0.5,1.0")), Exit::Ok);
    let rows = std::fs::read_to_string(folder.join("sweep/runs.csv")).unwrap();
    assert_eq!(rows.lines().count(), 5, "{rows}");
    // The folder holds another sweep.
    assert_eq!(exit(yields), Exit::Usage);
    assert_eq!(exit(&format!("{yields} --fresh")), Exit::Ok);
    assert_eq!(exit(&format!("{yields},-1")), Exit::ConfigInvalid);
    assert_eq!(exit(&format!("{yields} --set fixture.yield_n=26")), Exit::Usage);
    assert_eq!(exit(&format!("{yields} --output none")), Exit::Usage);
    assert_eq!(exit("builtin:scenes/circle-tour.yaml --set duration_s=1.0"), Exit::Usage);
    assert_eq!(exit("builtin:play.yaml"), Exit::Usage);
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn exit_codes_tell_what_happened() {
    let exit = |line: &str| run(line.split(' ').map(OsString::from));
    assert_eq!(exit("yieldwall --help"), Exit::Ok);
    assert_eq!(exit("yieldwall --version"), Exit::Ok);
    assert_eq!(exit("yieldwall"), Exit::Usage);
    assert_eq!(exit("yieldwall confg"), Exit::Usage);
    assert_eq!(exit("yieldwall config check"), Exit::Usage);
    for name in share(yieldwall_config::builtin_names(), 12) {
        // Drives of odd vendors lack watchdogs, of which is warned.
        let denied = if name.starts_with("vendors/") { "" } else { " --deny-warnings" };
        assert_eq!(exit(&format!("yieldwall --quiet{denied} config check builtin:{name}")), Exit::Ok, "{name}");
    }
    assert_eq!(exit("yieldwall -q config check builtin:paper-admittance.yaml no-such-file.yaml"), Exit::ConfigInvalid);
    assert_eq!(exit("yieldwall config show no-such-file.yaml --json"), Exit::ConfigInvalid);
    for command in ["replay", "plot", "record info", "record repair"] {
        assert_eq!(exit(&format!("yieldwall -q {command} no-such-file.mcap")), Exit::ConfigInvalid, "{command}");
        assert_eq!(exit(&format!("yieldwall -q {command} Cargo.toml")), Exit::ConfigInvalid, "{command}");
    }
    assert_eq!(exit("yieldwall -q run builtin:paper-admittance.yaml --record Cargo.toml"), Exit::Usage);
    for (arguments, wanted) in [("paper-admittance.yaml", Exit::Ok), ("paper-impedance.yaml", Exit::Usage)] {
        let line = format!("yieldwall -q tune fixture --json --hand-stiffness 500 builtin:{arguments}");
        assert_eq!(exit(&line), wanted, "{arguments}");
    }
    // Refused before anything is computed or written.
    for study in [
        "hold --mujoco mujoco",
        "plant --mujoco no-such-program",
        "all --point mass:1",
        "all --mujoco no-such-program",
        "all --merge --out no-such-folder",
        "hold --page --merge",
        "hold --tables docs/data",
        "hold --slurm 0",
        "hold --slurm 4 --shard 1/4",
        "hold --slurm 4 --fresh",
        "hold --missing",
        "hold --of 4",
        "hold --missing --of 0",
        "hold --missing --of 4 --merge",
        "hold --shard 5/4",
        "hold --page --missing --of 4",
        "hold builtin:paper-admittance.yaml",
        "need builtin:paper-admittance.yaml --shard 1/2",
        "need builtin:paper-admittance.yaml --merge",
        "need builtin:paper-admittance.yaml --page",
        "hold --point 5",
        "hold --point impacts:a",
    ] {
        assert_eq!(exit(&format!("yieldwall -q study {study}")), Exit::Usage, "{study}");
    }
    for soak in [
        "--shard 1/4",
        "--slurm 4",
        "--missing --of 4",
        "--merge",
        "--seed 3 --out no-such-folder --shard 1/4",
        "--seed 3 --out no-such-folder --slurm 4",
        "--out no-such-folder --merge",
    ] {
        assert_eq!(exit(&format!("yieldwall -q soak {soak}")), Exit::Usage, "{soak}");
    }
    for study in [
        "hold --page=no-such-folder",
        "hold --page=../../docs --tables no-such-folder",
        "need no-such-file.yaml",
        "need builtin:scenes/circle-tour.yaml",
    ] {
        assert_eq!(exit(&format!("yieldwall -q study {study}")), Exit::ConfigInvalid, "{study}");
    }
}

/// The summary of a soak in parts is the one of a single run, and parts that are complete are not run again.
#[test]
fn a_soak_in_parts_is_judged_as_one_run() {
    let folder = std::env::temp_dir().join(format!("yieldwall-soak-parts-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let place = folder.display();
    let exit =
        |rest: &str| run(format!("yieldwall -q soak --seeds 3..9 --cycles 300 {rest}").split(' ').map(OsString::from));
    assert_eq!(exit(&format!("--markdown {place}/one.md")), Exit::Ok);
    for part in ["1/4", "2/4", "4/4"] {
        assert_eq!(exit(&format!("--out {place} --shard {part}")), Exit::Ok, "{part}");
    }
    assert_eq!(exit(&format!("--out {place} --merge --markdown {place}/parts.md")), Exit::Usage, "seed 6 is missing");
    let outcomes = std::fs::read_to_string(folder.join("outcomes.1-of-4.jsonl")).unwrap();
    assert_eq!(outcomes.lines().count(), 2, "seeds 4 and 8");
    assert_eq!(exit(&format!("--out {place} --shard 3/4")), Exit::Ok);
    assert_eq!(exit(&format!("--out {place} --shard 1/4")), Exit::Ok, "there is nothing left of it");
    assert_eq!(std::fs::read_to_string(folder.join("outcomes.1-of-4.jsonl")).unwrap(), outcomes);
    assert_eq!(exit(&format!("--out {place} --merge --markdown {place}/parts.md")), Exit::Ok);
    let [one, parts] = ["one.md", "parts.md"].map(|name| std::fs::read_to_string(folder.join(name)).unwrap());
    assert_eq!(parts, one);
    std::fs::remove_dir_all(&folder).unwrap();
}

/// The exit code distinguishes a missing device from a device that refuses.
#[test]
fn devices_that_are_not_there_are_no_success() {
    let folder = std::env::temp_dir().join(format!("yieldwall-absent-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let file = folder.join("left.dcf").display().to_string();
    let exit = |line: &str| run(line.split(' ').map(OsString::from));
    assert_eq!(exit(&format!("yieldwall -q od dump left --out {file}")), Exit::Ok);
    // Its drive fills answers up, and the standards give the types of these values.
    let odd = folder.join("odd.dcf");
    let dump = format!("yieldwall -q od dump left --out {} --rig builtin:vendors/wrong-lengths.yaml", odd.display());
    assert_eq!(exit(&dump), Exit::Ok);
    assert!(std::fs::read_to_string(&odd).unwrap().contains("[1600sub1]"));
    for (line, wanted) in [
        ("nmt 55 start", Exit::DeviceMismatch),
        ("nmt 55 stop", Exit::DeviceMismatch),
        ("nmt 55 reset", Exit::DeviceMismatch),
        ("nmt left stop", Exit::Ok),
        ("nmt all start", Exit::Ok),
        ("lss set-id 50 51", Exit::DeviceMismatch),
        ("lss set-id left 51 --save", Exit::Ok),
        ("drive adopt --node left --name maxon-epos4", Exit::Usage),
        (&format!("od restore left {file}"), Exit::Usage),
        (&format!("od restore {file} left"), Exit::Ok),
    ] {
        assert_eq!(exit(&format!("yieldwall -q {line}")), wanted, "{line}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

/// A concise DCF is read back by `od diff` and `od restore`, and is no data sheet.
#[test]
fn a_concise_dump_is_compared_and_restored() {
    let folder = std::env::temp_dir().join(format!("yieldwall-concise-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let [whole, cut, empty] = ["left.cdcf", "cut.cdcf", "empty.cdcf"].map(|name| folder.join(name));
    let exit = |line: &str| run(line.split(' ').map(OsString::from));
    let file = whole.display();
    assert_eq!(exit(&format!("yieldwall -q od dump left --concise --out {file}")), Exit::Ok);
    let bytes = std::fs::read(&whole).unwrap();
    std::fs::write(&cut, &bytes[..bytes.len() - 1]).unwrap();
    std::fs::write(&empty, [0; 4]).unwrap();
    let (cut, empty) = (cut.display(), empty.display());
    for (line, wanted) in [
        (format!("diff {file} left"), Exit::Ok),
        (format!("diff {file} right"), Exit::OutOfTolerance),
        (format!("diff {file} {file}"), Exit::Ok),
        (format!("restore {file} left"), Exit::Ok),
        (format!("read left statusword --eds {file}"), Exit::ConfigInvalid),
        (format!("diff {cut} left"), Exit::ConfigInvalid),
        (format!("restore {cut} left"), Exit::ConfigInvalid),
        (format!("restore {empty} left"), Exit::ConfigInvalid),
    ] {
        assert_eq!(exit(&format!("yieldwall -q od {line}")), wanted, "{line}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

/// A run that was broken only by what was injected is fine; one that faults of its own held is not, and one that ends before its injection is refused.
#[test]
fn a_run_is_judged_by_what_was_not_injected() {
    let folder = std::env::temp_dir().join(format!("yieldwall-judged-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let rig = folder.join("nervous.yaml");
    let text = "like: builtin:paper-admittance.yaml\nguard: {force_step_limit_n: 0.5}\n";
    std::fs::write(&rig, text).unwrap();
    let exit = |rig: &str, more: &str| {
        let boxes = folder.display();
        let line = format!("yieldwall -q run {rig} --duration 2 --black-box {boxes}{more}");
        run(line.split(' ').map(OsString::from))
    };
    let shipped = "builtin:paper-admittance-csp.yaml";
    assert_eq!(exit(shipped, " --fault drive-warning@1"), Exit::Ok);
    assert_eq!(exit(shipped, " --fault pdo-lost@99"), Exit::Usage);
    let nervous = rig.display().to_string();
    assert_eq!(exit(&nervous, ""), Exit::SafetyStop);
    // What holds this rig is not what was injected.
    assert_eq!(exit(&nervous, " --fault drive-warning@1"), Exit::SafetyStop);
    std::fs::remove_dir_all(&folder).unwrap();
}

/// Neither a log nor a drawing takes the place of anything else, and a drawing that fails costs nothing but itself.
#[test]
fn files_of_another_kind_stay_as_they_are() {
    let folder = std::env::temp_dir().join(format!("yieldwall-files-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let rig = folder.join("rig.yaml");
    std::fs::write(&rig, "like: builtin:paper-admittance.yaml\n").unwrap();
    let exit = |more: &str| {
        let line = format!("yieldwall -q run {} --duration 0.1 {more}", rig.display());
        run(line.split(' ').map(OsString::from))
    };
    let (own, log) = (rig.display(), folder.join("bus.log"));
    let before = std::fs::read(&rig).unwrap();
    assert_eq!(exit(&format!("--candump {own}")), Exit::Usage);
    assert_eq!(exit(&format!("--figure {own}.svg")), Exit::Ok);
    std::fs::copy(&rig, folder.join("kept.svg")).unwrap();
    assert_eq!(exit(&format!("--figure {}", folder.join("kept.svg").display())), Exit::Usage);
    assert_eq!(std::fs::read(&rig).unwrap(), before);
    for _ in 0..2 {
        assert_eq!(exit(&format!("--candump {}", log.display())), Exit::Ok, "a log replaces a log");
    }
    assert_eq!(exit(&format!("--candump {} --figure {}", log.display(), folder.display())), Exit::Usage);
    std::fs::remove_dir_all(&folder).unwrap();
}

/// A command runs every kind of file that `config check` accepts: a device, and a figure in a file.
#[test]
fn devices_and_figures_in_files_are_run_and_drawn() {
    let out = std::env::temp_dir().join(format!("yieldwall-files-{}", std::process::id()));
    let folder = out.display();
    let exit = |line: &str| run(line.split(' ').map(OsString::from));
    let drawn = |name: &str| std::fs::read(out.join(name)).is_ok_and(|bytes| !bytes.is_empty());
    let device = format!("yieldwall -q run builtin:sphere.yaml --duration 1 --figure {folder}/sphere.svg");
    assert_eq!(exit(&device), Exit::Ok);
    assert!(drawn("sphere.svg"));
    assert_eq!(exit("yieldwall -q run builtin:sphere.yaml --fault node-reset@1"), Exit::Usage);
    assert_eq!(exit("yieldwall -q run builtin:scenes/cylinder-tour.yaml"), Exit::ConfigInvalid);
    assert_eq!(exit(&format!("yieldwall -q reproduce builtin:figures/fig9.yaml --out {folder}")), Exit::Ok);
    assert!(drawn("fig9-impedance.svg") && drawn("fig9-impedance.png"));
    assert_eq!(exit("yieldwall -q reproduce builtin:sphere.yaml"), Exit::ConfigInvalid);
    assert_eq!(exit("yieldwall -q reproduce fig10"), Exit::Usage);
    std::fs::remove_dir_all(&out).unwrap();
}

#[test]
fn a_warning_is_drawn_as_one() {
    let text = malformed::base_text("rig.yaml").replace("radius_m: 0.12", "radius_m: 3.0e-5");
    let rig = yieldwall_config::load_rig(malformed::with("rig.yaml", "rig.yaml", &text)).unwrap();
    insta::assert_snapshot!("warning", super::render::Renderer::new(false).render(&rig.warnings));
}

#[test]
fn findings_as_json_have_line_and_column() {
    let case = CASES.iter().find(|case| case.name == "yield below friction").unwrap();
    let report = yieldwall_config::load(case.source()).unwrap_err();
    insta::assert_snapshot!("json", serde_json::to_string_pretty(&report).unwrap());
}

/// Returns the texts in backquotes that begin with the name of the program, from all sources and pages.
fn advised() -> Vec<(String, String)> {
    fn files(folder: &std::path::Path, found: &mut Vec<std::path::PathBuf>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            match path.extension().and_then(|end| end.to_str()) {
                _ if path.is_dir() => files(&path, found),
                Some("rs" | "md" | "yaml") => found.push(path),
                _ => {}
            }
        }
    }
    let root = &std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut paths = vec![root.join("README.md"), root.join("CONTRIBUTING.md")];
    for folder in ["src", "docs", "config", "drives"] {
        files(&root.join(folder), &mut paths);
    }
    let mut advised = Vec::new();
    for path in paths {
        let text = std::fs::read_to_string(&path).unwrap();
        let mut code_block = false;
        for line in text.lines() {
            let quoted = line.split('`').skip(1).step_by(2);
            let is_fence = line.trim_start().starts_with("```");
            code_block = code_block != is_fence;
            let whole = line.split('#').next().filter(|_| code_block && !is_fence);
            let commands = quoted.chain(whole).filter(|text| text.starts_with("yieldwall "));
            advised.extend(commands.map(|command| (path.display().to_string(), command.trim().to_owned())));
        }
    }
    advised
}

/// A command in a message or on a page is one that the program has, with options that it has.
#[test]
fn every_command_that_is_advised_exists() {
    use clap::error::ErrorKind;
    let advised = advised();
    assert!(advised.len() > 100, "{}", advised.len());
    for place in
        ["drives/codes/maxon-epos4.yaml", "drives/codes/elmo-gold.yaml", "emcy/codes.rs", "explanation/status.rs"]
    {
        assert!(advised.iter().any(|(file, _)| file.ends_with(place)), "{place} advises nothing");
    }
    let mut unknown = Vec::new();
    for (file, command) in advised {
        let words = command.split_whitespace().take_while(|word| *word != ">");
        let words: Vec<&str> = words.filter(|word| !matches!(*word, "..." | ".." | "&")).collect();
        if words.iter().any(|word| word.contains("..=") || word.contains('$') || matches!(*word, "|" | "\\")) {
            continue;
        }
        let is_a_command = |words: &mut dyn Iterator<Item = String>| {
            let kind = Arguments::try_parse_from(words.map(OsString::from)).err().map(|error| error.kind());
            matches!(
                kind,
                None | Some(
                    ErrorKind::MissingRequiredArgument
                        | ErrorKind::DisplayHelp
                        | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand
                        | ErrorKind::MissingSubcommand
                        // An option that a value has to follow, of whatever kind.
                        | ErrorKind::InvalidValue
                        | ErrorKind::ValueValidation
                        | ErrorKind::TooFewValues
                )
            )
        };
        let plain = |word: &&str| word.trim_matches(['[', ']', ',', '"']).split('|').next().unwrap_or(word).to_owned();
        // Where a message has a place for something, a value stands there, or options, or nothing.
        let filled = |word: &&str| if word.contains('{') { "1".to_owned() } else { plain(word) };
        let is_known = is_a_command(&mut words.iter().map(filled))
            || is_a_command(&mut words.iter().filter(|word| !word.contains('{')).map(plain));
        if !is_known {
            unknown.push(format!("{file}: `{command}`"));
        }
    }
    assert_eq!(unknown, Vec::<String>::new());
}
