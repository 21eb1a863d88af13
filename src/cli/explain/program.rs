//! Words of the program itself: symbols of the fixture, keys of files, exit codes, commands and their steps.

use std::borrow::Cow;

use clap::CommandFactory;
use yieldwall_config::{key_description, nearest_key, nearest_word};
use yieldwall_run::bringup::commission::{STEPS, Step};
use yieldwall_run::explanation::Explanation;

use crate::failure::EXITS;

/// Symbols of the papers: symbol, key of the rig file (empty for a measured value), meaning.
const SYMBOLS: [(&str, &str, &str); 10] = [
    ("R", "fixture.yield_n", "yield force in N: the wall or guide stands below this force and slides above it"),
    ("F", "fixture.friction_n", "force in N below which the tool does not move, off the surface and along it"),
    ("M", "fixture.coupling.admittance.mass_kg", "virtual mass in kg: the hand feels this mass when the tool is free"),
    ("T", "cycle.period_us", "period of the control cycle, in us in the file"),
    (
        "N_wait",
        "fixture.hold_steps",
        "number of cycles in which the proxy stays on the surface after an impact, so that a blow does not break through",
    ),
    (
        "K",
        "control.gains.joint.stiffness_n_m_per_rad",
        "stiffness of a joint controller in N m/rad; for an impedance device, stiffness of its coupling in N/m",
    ),
    (
        "B",
        "control.gains.joint.damping_n_m_s_per_rad",
        "damping of a joint controller in N m s/rad; for an impedance device, damping of its coupling in N s/m",
    ),
    ("H", "control.sliding_time_s", "time constant of the sliding line of PSMC in s"),
    ("h", "", "force of the hand on the tool in N, from the force sensor"),
    ("PSMC", "control.law", "proxy-based sliding mode control: the control law of the joints in torque mode"),
];

/// Pages of commands, in `docs`.
const PAGES: [(&str, &str); 16] = [
    ("new run config", "configuration.md"),
    ("play view", "live-page.md"),
    ("compare reproduce plot", "figures.md"),
    ("explain", "faults.md"),
    ("faults", "fault-injection.md"),
    ("tune", "bringup.md#the-loop"),
    ("bus", "bus-budget.md"),
    ("sweep study", "study-tables.md"),
    ("soak", "soak.md"),
    ("doctor", "doctor.md"),
    ("commission jog home calibrate drill", "bringup.md"),
    ("sensor", "force-sensors.md"),
    ("latency", "realtime.md"),
    ("sim", "hardware-in-the-loop.md"),
    ("record replay report", "recording.md"),
    ("scan info od pdo state emcy drive monitor nmt lss dc errors sii alias reg", "devices.md"),
];

/// Sections of `docs/configuration.md` for groups of keys; the other keys are in the last one.
const SECTIONS: [(&str, &str); 4] = [
    ("control.gains", "gains"),
    ("simulation", "the-simulation"),
    ("buses", "buses-and-addresses"),
    ("", "the-keys-that-matter-most"),
];

/// Returns the command of a path such as `config check`.
fn command(path: &str) -> Option<clap::Command> {
    let program = super::super::Arguments::command();
    path.split(' ').try_fold(program, |above, name| above.find_subcommand(name).cloned())
}

/// Whether these words together name a command.
pub(super) fn is_command(words: &[String]) -> bool {
    words.len() > 1 && command(&words.join(" ")).is_some()
}

/// Returns the meanings of a word of the program: at most one of each kind.
pub(super) fn explained(word: &str) -> Vec<Explanation> {
    let own = |what: &'static str, meaning: String, next: String| Explanation {
        what,
        code: None,
        name: Cow::Owned(word.to_owned()),
        meaning: Cow::Owned(meaning),
        cause: Cow::Borrowed(""),
        next: Cow::Owned(next),
        source: None,
    };
    let symbol = SYMBOLS.iter().find(|(symbol, ..)| *symbol == word).map(|(_, key, meaning)| {
        own(
            "a symbol of the papers",
            (*meaning).to_owned(),
            match *key {
                "" => "docs/notation.md has all symbols".to_owned(),
                key => format!("the key `{key}` sets it; docs/notation.md has all symbols"),
            },
        )
    });
    let number = word.strip_prefix("exit-").and_then(|number| number.parse().ok());
    let exit = EXITS.iter().find(|meaning| Some(meaning.exit.code()) == number);
    let exit = exit.map(|exit| {
        // A line for each command.
        let lines = std::iter::once(exit.brief).chain(exit.more.split("; ").filter(|part| !part.is_empty()));
        let meaning = lines.collect::<Vec<_>>().join("\n");
        own("an exit code", meaning, exit.next.to_owned())
    });
    // A key stands in a group: a bare word may be a name of anything.
    let key = word.contains('.').then(|| key_description(word)).flatten();
    let section = SECTIONS.iter().find(|(group, _)| word.starts_with(group)).map_or("", |(_, section)| section);
    let key = key.map(|text| {
        let next =
            format!("docs/configuration.md#{section}; `yieldwall config show RIG.yaml` shows the value of a rig");
        own("a key of a file", text, next)
    });
    let step = Step::named(word).map(|step| {
        let next = format!(
            "docs/bringup.md#the-guided-commissioning has its limits; `yieldwall commission RIG.yaml --from {word}` begins there"
        );
        own("a step of `yieldwall commission`", step.does().to_owned(), next)
    });
    let command = command(word).and_then(|command| {
        let about = command.get_about()?.to_string();
        let options = format!("`yieldwall {word} --help` shows its options");
        Some(own("a command", about, page(word).map_or(options.clone(), |page| format!("{options}; docs/{page}"))))
    });
    symbol.into_iter().chain(exit).chain(key).chain(step).chain(command).collect()
}

/// Returns the page of a command in `docs`.
fn page(command: &str) -> Option<&'static str> {
    let first = command.split(' ').next()?;
    PAGES.iter().find(|(commands, _)| commands.split(' ').any(|known| known == first)).map(|(_, page)| *page)
}

/// Returns help for a word that is similar to one of the program: a symbol, a key, an exit code or a command.
pub(super) fn similar(word: &str) -> Option<String> {
    if word.starts_with("exit-") {
        let codes: Vec<String> = EXITS.iter().map(|meaning| format!("exit-{}", meaning.exit.code())).collect();
        return Some(format!("the exit codes are {}", codes.join(", ")));
    }
    let symbol = SYMBOLS.iter().map(|(symbol, ..)| *symbol).find(|symbol| symbol.eq_ignore_ascii_case(word));
    let program = super::super::Arguments::command();
    let names = program.get_subcommands().map(|command| command.get_name()).chain(STEPS.map(Step::name));
    let names: Vec<&str> = names.collect();
    let command = || nearest_word(word, names).map(str::to_owned);
    let meant = symbol.map(str::to_owned).or_else(command).or_else(|| nearest_key(word))?;
    Some(format!("did you mean {meant}?"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn symbols_name_keys_that_exist() {
        for (symbol, key, _) in SYMBOLS {
            assert!(key.is_empty() || key_description(key).is_some(), "{symbol}: {key}");
            assert_eq!(explained(symbol).len(), 1, "{symbol}");
        }
    }

    #[test]
    fn each_command_and_each_key_has_a_page_that_exists() {
        let docs = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
        let is_there = |page: &str| {
            let (file, section) = page.split_once('#').unwrap_or((page, ""));
            let text = std::fs::read_to_string(docs.join(file)).unwrap();
            let anchor = |line: &str| line.strip_prefix("## ").map(|title| title.to_lowercase().replace(' ', "-"));
            section.is_empty() || text.lines().filter_map(anchor).any(|title| title == section)
        };
        let program = crate::Arguments::command();
        let all = program.get_subcommands().filter(|command| !command.is_hide_set()).map(|command| command.get_name());
        for name in all.filter(|name| !["help", "man", "completions"].contains(name)) {
            assert!(page(name).is_some_and(is_there), "{name}: {:?}", page(name));
        }
        for (_, section) in SECTIONS {
            assert!(is_there(&format!("configuration.md#{section}")), "{section}");
        }
        assert!(is_there("bringup.md#the-guided-commissioning"));
    }

    #[test]
    fn exit_codes_are_explained() {
        for exit in EXITS {
            let code = exit.exit.code();
            let explained = explained(&format!("exit-{code}"));
            assert_eq!(explained[0].what, "an exit code", "{code}");
            assert!(explained[0].meaning.starts_with(exit.brief), "{code}");
        }
        assert!(explained("exit-42").is_empty());
    }

    #[test]
    fn a_slip_is_answered_with_the_word_that_was_meant() {
        for (slip, meant) in [
            ("r", "did you mean R?"),
            ("comission", "did you mean commission?"),
            ("fixture.yeild_n", "did you mean fixture.yield_n?"),
            ("yield", "did you mean fixture.yield_n?"),
            ("exit-77", "the exit codes are exit-0, exit-1, "),
        ] {
            assert!(similar(slip).is_some_and(|help| help.starts_with(meant)), "{slip}: {:?}", similar(slip));
        }
        assert_eq!(similar("xyzzy"), None);
    }

    #[test]
    fn keys_steps_and_commands_are_explained() {
        assert!(explained("fixture.yield_n")[0].meaning.contains("R in N"));
        for key in ["drives.left.direction", "scene.duration_s", "scene.hand.mass_kg", "duration_s.x"] {
            assert_eq!(explained(key).is_empty(), key == "duration_s.x", "{key}");
        }
        assert_eq!(explained("commission")[0].what, "a command");
        assert_eq!(explained("config check")[0].what, "a command");
        for step in STEPS {
            assert_eq!(explained(step.name())[0].meaning, step.does(), "{}", step.name());
        }
        assert!(explained("fixture.nothing").is_empty());
    }
}
