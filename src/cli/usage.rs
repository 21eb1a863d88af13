//! Tips for common slips, besides the messages of the command-line parser.

use std::ffi::OsString;
use std::str::FromStr;

use clap::Command;
use clap::builder::StyledStr;
use clap::error::{ContextKind, ContextValue, Error, ErrorKind};
use yieldwall_config::nearest_word;

/// Options whose values have commas between, each with such a list.
const LISTS: [(&str, &str); 3] =
    [("--nodes", "1,2,10"), ("--links", "0.3,0.4"), ("--drives", "simulated-servo,simulated-servo")];

/// Adds tips to the error, if any are known.
pub(super) fn with_tip(mut error: Error, program: &Command, arguments: &[OsString]) -> Error {
    let words: Vec<String> = arguments.iter().skip(1).map(|word| word.to_string_lossy().into_owned()).collect();
    let tips = tips(&error, program, &words).unwrap_or_default();
    // The parser advises to pass an unknown option as a value, which no command wants.
    if error.kind() == ErrorKind::UnknownArgument
        && let Some(ContextValue::StyledStrs(several)) = error.remove(ContextKind::Suggested)
    {
        let kept: Vec<StyledStr> = several.into_iter().filter(|tip| !tip.to_string().contains("to pass '--")).collect();
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(kept));
    }
    if !tips.is_empty() {
        let tips = tips.into_iter().map(StyledStr::from).collect();
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(tips));
    }
    error
}

/// Returns the subcommand for these words, and its name: `od read`.
fn reached<'a>(program: &'a Command, words: &[String]) -> (&'a Command, String) {
    let (mut command, mut names) = (program, Vec::new());
    for word in words {
        let Some(next) = command.find_subcommand(word) else { continue };
        command = next;
        names.push(word.as_str());
    }
    (command, names.join(" "))
}

/// Reads a time in seconds.
pub(super) fn seconds(text: &str) -> Result<f64, &'static str> {
    text.parse().map_err(|_| "write seconds without a unit, such as 3")
}

/// Reads a whole number from 0 on.
pub(super) fn whole<T: FromStr>(text: &str) -> Result<T, &'static str> {
    text.parse().map_err(|_| "write a whole number from 0 on")
}

/// Reads a whole number from 1 on, such as a `NonZeroU32`.
pub(super) fn at_least_one<T: FromStr>(text: &str) -> Result<T, &'static str> {
    text.parse().map_err(|_| "write a whole number from 1 on")
}

fn tips(error: &Error, program: &Command, words: &[String]) -> Option<Vec<String>> {
    let (command, name) = reached(program, words);
    // The parser itself finds the near ones.
    let has_none = error.get(ContextKind::SuggestedSubcommand).is_none();
    if let (Some(ContextValue::String(word)), true) = (error.get(ContextKind::InvalidSubcommand), has_none) {
        let meant = nearest_word(word, command.get_subcommands().map(Command::get_name))?;
        return Some(vec![format!("did you mean '{}'?", [name.as_str(), meant].join(" ").trim())]);
    }
    let invalid: Vec<String> = match error.get(ContextKind::InvalidArg)? {
        ContextValue::String(word) => vec![word.clone()],
        ContextValue::Strings(several) => several.clone(),
        _ => return None,
    };
    let first = invalid.first()?.as_str();
    let takes_rig = command.get_positionals().any(|argument| is_rig(argument.get_value_names()));
    let has_rig = command.get_arguments().any(|argument| argument.get_long() == Some("rig"));
    match error.kind() {
        ErrorKind::UnknownArgument if first == "--rig" && takes_rig => {
            let behind = words.iter().skip_while(|word| *word != "--rig").nth(1).filter(|word| !word.starts_with('-'));
            let rig = behind.map_or("RIG.yaml", String::as_str);
            Some(vec![format!("the rig stands here without an option: 'yieldwall {name} {rig}'")])
        }
        ErrorKind::UnknownArgument if has_rig && is_file(first) => {
            Some(vec![format!("a rig is named by an option here: '--rig {first}'")])
        }
        ErrorKind::TooManyValues | ErrorKind::TooFewValues | ErrorKind::WrongNumberOfValues if name == "compare" => {
            Some(vec!["'yieldwall compare' takes two to six items".to_owned()])
        }
        ErrorKind::UnknownArgument => {
            let set = words.windows(3).find_map(|three| match three {
                [option, key, word] if option == "--set" && word == first && !key.contains('=') => {
                    Some(vec![format!("write '--set {key}={word}'")])
                }
                _ => None,
            });
            if set.is_some() {
                return set;
            }
            let list = words.windows(3).find_map(|three| match three {
                [option, value, word] if word == first && LISTS.iter().any(|(list, _)| list == option) => {
                    Some(format!("{option} {value},{word}"))
                }
                _ => None,
            });
            Some(vec![format!("a list has commas between, and no blanks: '{}'", list?)])
        }
        ErrorKind::InvalidValue | ErrorKind::ValueValidation => {
            let option = first.split(' ').next()?;
            let (_, list) = LISTS.iter().find(|(list, _)| *list == option)?;
            Some(vec![format!("for example '{option} {list}'")])
        }
        ErrorKind::MissingRequiredArgument if invalid.iter().any(|word| word.starts_with("--bus")) => {
            let rig = words.iter().find(|word| is_file(word)).map_or("RIG.yaml", String::as_str);
            let (of_bus, what) = match name.as_str() {
                "sim" => (
                    vec![
                        "'--bus vcan0' names the interface; these two make one:".to_owned(),
                        "'sudo ip link add vcan0 type vcan' and 'sudo ip link set vcan0 up'".to_owned(),
                    ],
                    "has the same devices in one process",
                ),
                "drill" => (
                    vec!["'--bus can0' names the interface; '--dry-run' needs none".to_owned()],
                    "drills the simulated drives first",
                ),
                _ => return Some(vec!["'--bus can0' names the interface".to_owned()]),
            };
            let without = format!("without a bus 'yieldwall run {rig}' {what}");
            Some(of_bus.into_iter().chain([without]).collect())
        }
        _ => None,
    }
}

fn is_rig(names: Option<&[clap::builder::Str]>) -> bool {
    names.is_some_and(|names| names.iter().any(|name| name.as_str() == "RIG.yaml"))
}

fn is_file(word: &str) -> bool {
    word.ends_with(".yaml") || word.ends_with(".yml")
}

#[cfg(test)]
mod tests {
    use clap::{CommandFactory, Parser};

    use super::super::Arguments;
    use super::*;

    /// Returns the printed form of a refused line.
    fn told(line: &str) -> String {
        let words: Vec<OsString> = line.split(' ').map(OsString::from).collect();
        let error = Arguments::try_parse_from(&words).unwrap_err();
        with_tip(error, &Arguments::command(), &words).to_string()
    }

    #[test]
    fn usual_slips_get_the_line_that_is_taken() {
        for (line, tip) in [
            ("yieldwall run --rig my.yaml", "'yieldwall run my.yaml'"),
            ("yieldwall doctor --rig my.yaml --bus can0", "'yieldwall doctor my.yaml'"),
            ("yieldwall bus budget --rig my.yaml", "'yieldwall bus budget my.yaml'"),
            ("yieldwall scan my.yaml", "'--rig my.yaml'"),
            ("yieldwall drill my.yaml", "'--bus can0' names the interface"),
            ("yieldwall sim my.yaml", "'yieldwall run my.yaml' has the same devices"),
            ("yieldwall new a.yaml --nodes 5 6", "'--nodes 5,6'"),
            ("yieldwall new a.yaml --nodes 5 5", "'--nodes 5,5'"),
            ("yieldwall new a.yaml --nodes 1,2,300", "for example '--nodes 1,2,10'"),
            ("yieldwall new a.yaml --links 0.3,x", "for example '--links 0.3,0.4'"),
            ("yieldwall rnu", "did you mean 'run'?"),
            ("yieldwall run my.yaml --set fixture.yield_n 25", "write '--set fixture.yield_n=25'"),
        ] {
            let told = told(line);
            assert!(told.contains("tip: ") && told.contains(tip), "{line}: {told}");
            assert!(!told.contains("to pass '--rig' as a value"), "{told}");
            assert!(told.lines().all(|line| line.chars().count() <= 80), "{told}");
        }
        for line in ["yieldwall run my.yaml --duration 3s", "yieldwall latency --duration 3s"] {
            assert!(told(line).contains("write seconds without a unit"), "{}", told(line));
        }
        assert!(told("yieldwall compare a b c d e f g").contains("takes two to six items"));
        assert!(!told("yieldwall plot cycles.mcap --from 5").contains("tip: "));
        assert!(!told("yieldwall run").contains("tip: "), "{}", told("yieldwall run"));
    }
}
