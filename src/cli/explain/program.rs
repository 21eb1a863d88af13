//! Words of the program itself: symbols of the fixture, keys of files, exit codes, commands.

use std::borrow::Cow;

use clap::CommandFactory;
use yieldwall_config::{key_description, nearest_key, nearest_word};
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
        "steps in which the proxy stays on the surface after an impact, so that a blow does not break through",
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
    let key = key.map(|text| own("a key of a file", text, "docs/configuration.md describes the files".to_owned()));
    let program = super::super::Arguments::command();
    let command = program.get_subcommands().find(|command| command.get_name() == word);
    let command = command.and_then(|command| {
        let about = command.get_about()?.to_string();
        Some(own("a command", about, format!("`yieldwall {word} --help` shows its options")))
    });
    symbol.into_iter().chain(exit).chain(key).chain(command).collect()
}

/// Returns help for a word that is similar to one of the program: a symbol, a key, an exit code or a command.
pub(super) fn similar(word: &str) -> Option<String> {
    if word.starts_with("exit-") {
        let codes: Vec<String> = EXITS.iter().map(|meaning| format!("exit-{}", meaning.exit.code())).collect();
        return Some(format!("the exit codes are {}", codes.join(", ")));
    }
    let symbol = SYMBOLS.iter().map(|(symbol, ..)| *symbol).find(|symbol| symbol.eq_ignore_ascii_case(word));
    let program = super::super::Arguments::command();
    let command = || nearest_word(word, program.get_subcommands().map(|command| command.get_name())).map(str::to_owned);
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
    fn keys_and_commands_are_explained() {
        assert!(explained("fixture.yield_n")[0].meaning.contains("R in N"));
        assert_eq!(explained("commission")[0].what, "a command");
        assert!(explained("fixture.nothing").is_empty());
    }
}
