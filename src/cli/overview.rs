//! The first screen of the help: the commands in groups, by what one wants to do.

use clap::{Command, CommandFactory};

use super::{Arguments, examples, fit};

/// Groups of commands. The help of the program has each command once.
const GROUPS: [(&str, &[&str]); 6] = [
    ("Start", &["new", "run", "play", "compare", "reproduce", "explain", "help"]),
    ("Design a rig", &["config", "tune", "bus", "sweep", "study", "soak"]),
    (
        "Bring up a rig",
        &["doctor", "commission", "jog", "home", "calibrate", "sensor", "latency", "drill", "sim", "faults"],
    ),
    ("Look at results", &["view", "plot", "record", "replay", "report"]),
    (
        "Single devices",
        &[
            "scan", "info", "od", "pdo", "state", "emcy", "drive", "monitor", "nmt", "lss", "dc", "errors", "sii",
            "alias", "reg",
        ],
    ),
    ("Shell", &["completions", "man"]),
];
/// Columns of a name with the blanks around it.
const NAME: usize = 15;

/// Returns the command line of the program. Its help lists the commands in groups.
pub(super) fn program() -> Command {
    let mut program = examples::with_examples(Arguments::command());
    let mut list = String::new();
    for (heading, names) in GROUPS {
        list.push_str(&format!("{heading}:\n"));
        for name in names {
            let found = program.find_subcommand(name).and_then(|command| command.get_about());
            let about = match (found, *name) {
                (Some(about), _) => about.to_string(),
                (None, "help") => "Print this message or the help of a command".to_owned(),
                // A command that this system does not have.
                (None, _) => continue,
            };
            let rest = " ".repeat(NAME);
            list.push_str(&fit::filled(&format!("  {name:13}"), &rest, &about, fit::USUAL));
            list.push('\n');
        }
        list.push('\n');
    }
    // They stand in `list`.
    let names: Vec<String> = program.get_subcommands().map(|command| command.get_name().to_owned()).collect();
    for name in names {
        program = program.mut_subcommand(name, |command| command.hide(true));
    }
    let list = list.replace('{', "{{").replace('}', "}}");
    program.override_usage("yieldwall [OPTIONS] <COMMAND>").help_template(format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{list}{{all-args}}{{after-help}}"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_command_is_in_one_group() {
        let grouped: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| names.iter().copied()).collect();
        let program = Arguments::command();
        for command in program.get_subcommands().map(Command::get_name).chain(["help"]) {
            assert_eq!(grouped.iter().filter(|name| **name == command).count(), 1, "{command}");
        }
    }

    #[test]
    fn the_help_fits_a_terminal_and_names_each_command_once() {
        let text = program().term_width(fit::USUAL).render_help().to_string();
        assert!(text.lines().all(|line| line.chars().count() <= fit::USUAL), "{text}");
        for command in Arguments::command().get_subcommands().map(Command::get_name) {
            let heads = text.lines().filter(|line| line.starts_with(&format!("  {command:13}")));
            assert_eq!(heads.count(), 1, "{command}: {text}");
        }
        assert!(text.contains("Global options:") && text.contains("Exit codes:"), "{text}");
    }
}
