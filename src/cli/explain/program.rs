//! Words of the program itself: symbols of the fixture, keys of files, exit codes, commands.

use std::borrow::Cow;

use clap::CommandFactory;
use yieldwall_config::key_description;
use yieldwall_run::explanation::Explanation;

use crate::failure::EXITS;

/// Symbols of the papers: symbol, key of the rig file, meaning.
const SYMBOLS: [(&str, &str, &str); 5] = [
    ("R", "fixture.yield_n", "yield force in N: the wall or guide stands below this force and slides above it"),
    ("F", "fixture.friction_n", "friction in N off the surface: the tool stays where it is below this force"),
    ("M", "fixture.coupling.admittance.mass_kg", "virtual mass in kg: the hand feels this mass when the tool is free"),
    ("T", "cycle.period_us", "period of the control cycle, in us in the file"),
    (
        "N_wait",
        "fixture.hold_steps",
        "steps in which the proxy stays on the surface after an impact, so that a blow does not break through",
    ),
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
            "a symbol of the fixture",
            (*meaning).to_owned(),
            format!("the key `{key}` sets it; docs/notation.md has all symbols"),
        )
    });
    let number = word.strip_prefix("exit-").and_then(|number| number.parse().ok());
    let exit = EXITS.iter().find(|meaning| Some(meaning.exit.code()) == number);
    let exit = exit.map(|exit| {
        let meaning =
            [exit.brief, exit.more].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(": ");
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn symbols_name_keys_that_exist() {
        for (symbol, key, _) in SYMBOLS {
            assert!(key_description(key).is_some(), "{symbol}: {key}");
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
    fn keys_and_commands_are_explained() {
        assert!(explained("fixture.yield_n")[0].meaning.contains("R in N"));
        assert_eq!(explained("commission")[0].what, "a command");
        assert!(explained("fixture.nothing").is_empty());
    }
}
