//! Examples of each command, at the end of its help.
//!
//! They run on rigs that are in the program. Where a command reads a file, its first example writes that file.

use clap::Command;

/// Commands by their words after the name of the program, each with its examples, again without that name.
const EXAMPLES: &[(&str, &[&str])] = &[
    ("", &["run builtin:paper-admittance.yaml", "new my-rig.yaml"]),
    ("new", &["new my-rig.yaml", "new ethercat-rig.yaml --bus ethercat --yes"]),
    (
        "run",
        &["run builtin:paper-admittance.yaml --record out/first", "run builtin:play.yaml --set fixture.yield_n=25"],
    ),
    ("sim", &["sim builtin:paper-admittance.yaml --bus vcan0"]),
    ("drill", &["drill builtin:paper-admittance.yaml --dry-run", "drill builtin:paper-admittance.yaml --bus can0"]),
    (
        "jog",
        &[
            "jog builtin:paper-admittance.yaml left --by 2deg",
            "jog builtin:paper-admittance.yaml left --keys --bus can0",
        ],
    ),
    ("home", &["home builtin:paper-incremental.yaml", "home builtin:paper-incremental.yaml left --repeat 3"]),
    ("calibrate", &["calibrate kinematics builtin:paper-admittance.yaml"]),
    (
        "calibrate kinematics",
        &[
            "calibrate kinematics builtin:play.yaml --out points.csv",
            "calibrate kinematics builtin:play.yaml --points points.csv",
        ],
    ),
    ("sensor", &["sensor monitor builtin:paper-admittance.yaml"]),
    ("sensor monitor", &["sensor monitor builtin:paper-admittance.yaml --for 2"]),
    ("sensor tare", &["sensor tare builtin:paper-admittance.yaml"]),
    ("sensor calibrate", &["sensor calibrate builtin:paper-admittance.yaml"]),
    ("commission", &["commission builtin:paper-admittance.yaml --html report.html", "commission --defect list"]),
    ("latency", &["latency --period-us 1000 --duration 60", "latency --load --duration 60"]),
    ("doctor", &["doctor builtin:paper-admittance.yaml", "doctor --bus can0"]),
    ("doctor node", &["doctor node left", "doctor node 1 --bus can0"]),
    ("scan", &["scan --rig builtin:paper-ethercat.yaml", "scan --bus can0"]),
    ("info", &["info left", "info 1 --bus can0"]),
    ("od", &["od read left statusword"]),
    ("od read", &["od read left statusword 1018h:2", "od read 1 statusword --bus can0"]),
    ("od write", &["od write left max-torque 300 --dry-run"]),
    ("od dump", &["od dump left --out left.dcf"]),
    ("od diff", &["od diff left right"]),
    ("od restore", &["od dump left --out left.dcf", "od restore left.dcf left --dry-run"]),
    ("drive", &["drive adopt --node left --name my-drive"]),
    ("drive adopt", &["drive adopt --node left --name my-drive", "drive adopt --node 1 --bus can0"]),
    ("pdo", &["pdo show left"]),
    ("pdo show", &["pdo show left", "pdo show wrist --rig builtin:paper-ethercat.yaml"]),
    ("nmt", &["nmt left preop", "nmt all start --dry-run"]),
    ("emcy", &["emcy", "emcy left --clear"]),
    ("state", &["state left", "state left preop --rig builtin:paper-ethercat.yaml"]),
    ("lss", &["lss find"]),
    ("lss find", &["lss find", "lss find --bus can0"]),
    ("lss set-id", &["lss set-id left 11 --save"]),
    ("dc", &["dc --rig builtin:paper-ethercat.yaml"]),
    ("errors", &["errors --rig builtin:paper-ethercat.yaml"]),
    ("sii", &["sii check --rig builtin:paper-ethercat.yaml"]),
    ("sii read", &["sii read left --rig builtin:paper-ethercat.yaml --out left.sii"]),
    (
        "sii write",
        &[
            "sii read left --rig builtin:paper-ethercat.yaml --out left.sii",
            "sii write left left.sii --rig builtin:paper-ethercat.yaml --dry-run",
        ],
    ),
    ("sii check", &["sii check --rig builtin:paper-ethercat.yaml"]),
    (
        "alias",
        &["alias left --rig builtin:paper-ethercat.yaml", "alias left 12 --rig builtin:paper-ethercat.yaml --dry-run"],
    ),
    ("reg", &["reg read left al-status --rig builtin:paper-ethercat.yaml"]),
    ("reg read", &["reg read left al-status --rig builtin:paper-ethercat.yaml"]),
    ("reg write", &["reg write left 0420h 1000 --rig builtin:paper-ethercat.yaml"]),
    ("monitor", &["monitor --for 1", "monitor --services --bus can0"]),
    ("faults", &["faults", "faults node-reset"]),
    ("explain", &["explain node-reset 8130h", "explain exit-7"]),
    ("reproduce", &["reproduce fig9", "reproduce all --out figures"]),
    ("replay", &["run builtin:paper-admittance.yaml --record out/first", "replay out/first"]),
    ("plot", &["run builtin:paper-admittance.yaml --record out/first", "plot out/first --figure first.svg"]),
    ("view", &["run builtin:paper-admittance.yaml --record out/first", "view out/first"]),
    ("play", &["play"]),
    ("compare", &["compare builtin:play.yaml builtin:play-spring.yaml --figure both.svg"]),
    ("record", &["run builtin:paper-admittance.yaml --record out/first", "record info out/first"]),
    ("record info", &["run builtin:paper-admittance.yaml --record out/first", "record info out/first"]),
    ("record repair", &["run builtin:paper-admittance.yaml --record out/first", "record repair out/first"]),
    (
        "record export",
        &["run builtin:paper-admittance.yaml --record out/first", "record export out/first --csv first.csv"],
    ),
    ("soak", &["soak --seeds 0..20", "soak --seed 7"]),
    ("study", &["study need builtin:play.yaml", "study stability --point mass:17"]),
    ("sweep", &["sweep builtin:play.yaml --set fixture.yield_n=10,20 --duration 2"]),
    ("bus", &["bus budget builtin:paper-admittance.yaml"]),
    ("bus budget", &["bus budget builtin:paper-admittance.yaml"]),
    ("tune", &["tune fixture builtin:paper-admittance.yaml"]),
    ("tune fixture", &["tune fixture builtin:paper-admittance.yaml --hand-stiffness 500"]),
    ("tune gains", &["tune gains builtin:paper-admittance.yaml"]),
    ("tune loop", &["tune loop builtin:paper-admittance.yaml --html loop.html"]),
    ("report", &["report builtin:paper-admittance.yaml"]),
    ("config", &["config check builtin:paper-admittance.yaml"]),
    ("config check", &["config check builtin:paper-admittance.yaml"]),
    ("config show", &["config show builtin:paper-admittance.yaml > my-rig.yaml"]),
    ("config schema", &["config schema > schema.json"]),
    ("completions", &["completions bash > yieldwall.bash"]),
    ("man", &["man --out man"]),
];

/// Returns the program's command line with the examples at the end of each help, before the text that is there already.
pub(super) fn with_examples(program: Command) -> Command {
    with_those_of(program, "")
}

fn with_those_of(mut command: Command, words: &str) -> Command {
    let names: Vec<String> = command.get_subcommands().map(|one| one.get_name().to_owned()).collect();
    for name in names {
        let inner = format!("{words} {name}");
        command = command.mut_subcommand(name, |one| with_those_of(one, inner.trim_start()));
    }
    let Some((_, lines)) = EXAMPLES.iter().find(|(known, _)| *known == words) else { return command };
    let mut text = if lines.len() == 1 { "Example:" } else { "Examples:" }.to_owned();
    for line in *lines {
        text.push_str(&format!("\n  yieldwall {line}"));
    }
    if let Some(rest) = command.get_after_help() {
        text.push_str(&format!("\n\n{rest}"));
    }
    command.after_help(text)
}

#[cfg(test)]
mod tests {
    use std::ffi::OsString;

    use clap::{CommandFactory, Parser};

    use super::super::{Arguments, fit, overview};
    use super::*;

    /// Returns the words of each command of the program.
    fn commands(command: &Command, words: &str, found: &mut Vec<String>) {
        found.push(words.to_owned());
        for one in command.get_subcommands().filter(|one| !one.is_hide_set()) {
            commands(one, format!("{words} {}", one.get_name()).trim_start(), found);
        }
    }

    #[cfg(all(target_os = "linux", feature = "full"))]
    #[test]
    fn each_command_has_examples() {
        let mut words = Vec::new();
        commands(&Arguments::command(), "", &mut words);
        let mut with: Vec<&str> = EXAMPLES.iter().map(|(words, _)| *words).collect();
        words.sort();
        with.sort_unstable();
        assert_eq!(with, words);
    }

    #[test]
    fn an_example_uses_its_command_and_files_of_the_program() {
        let mut known = Vec::new();
        commands(&Arguments::command(), "", &mut known);
        for (words, lines) in EXAMPLES.iter().filter(|(words, _)| known.iter().any(|one| one == words)) {
            assert!(lines.last().is_some_and(|line| line.starts_with(words)), "{words}");
            for line in *lines {
                assert!("  yieldwall ".len() + line.len() <= fit::USUAL, "{line}");
                let all = ["yieldwall"].into_iter().chain(line.split(' ')).take_while(|word| *word != ">");
                if let Err(error) = Arguments::try_parse_from(all.map(OsString::from)) {
                    panic!("{line}: {error}");
                }
                for file in line.split(' ').filter_map(|word| word.strip_prefix("builtin:")) {
                    assert!(yieldwall_config::builtin_names().any(|name| name == file), "{line}");
                }
            }
        }
    }

    #[test]
    fn examples_are_the_end_of_the_help() {
        let mut program = overview::program().term_width(fit::USUAL);
        program.build();
        let text = |command: &mut Command| command.render_long_help().to_string();
        let jog = text(program.find_subcommand_mut("jog").unwrap());
        let end = "\n\nExamples:\n  yieldwall jog builtin:paper-admittance.yaml left --by 2deg\n  \
                   yieldwall jog builtin:paper-admittance.yaml left --keys --bus can0";
        assert!(jog.trim_end().ends_with(end), "{jog}");
        let root = text(&mut program);
        assert!(root.find("Examples:").unwrap() < root.find("Exit codes:").unwrap(), "{root}");
    }
}
