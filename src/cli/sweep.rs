//! `yieldwall sweep`: a study of the user's own, over any numbers of a rig, its simulation and its scene.

use std::num::NonZeroU32;
use std::sync::Arc;

use super::failure::{Exit, Failure};
use super::interrupt::on_interrupt;
use super::output::Output;
use super::run::check_duration;
use super::study::{Origin, Points};
use super::usage::at_least_one;
use yieldwall_config::{SetValue, SetValueError, Source};
use yieldwall_study::settings::{OUTPUTS, Settings, SettingsError};
use yieldwall_study::sweep::Study;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Rig or impedance device; `builtin:paper-admittance.yaml` is the copy in the program
    #[arg(value_name = "RIG.yaml")]
    rig: String,
    /// Key with its values; repeatable: every combination is run. Keys of the scene begin with `scene.`
    ///
    /// --set fixture.yield_n=10,20,30 --set scene.hand.mass_kg=0.5,1.5 makes six. A drive has its name as key. A value is YAML;
    /// commas within brackets belong to the value.
    #[arg(long, value_name = "KEY=A,B,..", required = true, value_parser = SetValues::read)]
    set: Vec<SetValues>,
    /// Runs of each combination, with seeds from the scene's seed on; with six or more, medians get 95 % intervals
    #[arg(long, value_name = "N", default_value = "1", value_parser = at_least_one::<NonZeroU32>)]
    seeds: NonZeroU32,
    /// Seconds to run; default: the scene's duration
    #[arg(long, value_name = "S", value_parser = super::usage::seconds, allow_negative_numbers = true)]
    duration: Option<f64>,
    /// Measure to draw and to print; repeatable. The table has all measures
    #[arg(long, value_name = "MEASURE")]
    output: Vec<String>,
    #[command(flatten)]
    points: Points,
}

/// The values of a key.
#[derive(Clone, Debug)]
struct SetValues(Vec<SetValue>);

impl SetValues {
    fn read(text: &str) -> Result<Self, SetValueError> {
        SetValue::each(text).map(Self)
    }
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    check_duration(arguments.duration)?;
    let source = Source::named(&arguments.rig);
    let axes = arguments.set.iter().map(|values| values.0.clone()).collect();
    let (seeds, duration) = (arguments.seeds, arguments.duration);
    let study = Settings::new(source, axes, seeds, duration, &arguments.output).map_err(failure)?;
    let mut words = vec!["sweep".to_owned(), arguments.rig.clone()];
    words.extend(arguments.set.iter().flat_map(|values| ["--set".to_owned(), text(&values.0)]));
    words.extend(["--seeds".to_owned(), seeds.to_string()]);
    words.extend(duration.iter().flat_map(|duration| ["--duration".to_owned(), duration.to_string()]));
    let mut sum = crc32fast::Hasher::new();
    study.texts().iter().for_each(|text| sum.update(text.as_bytes()));
    let hangs_on = format!(" of {:08x}: {}", sum.finalize(), words.join(" "));
    words.extend(arguments.output.iter().flat_map(|output| ["--output".to_owned(), output.clone()]));
    let origin = Origin { words: words.clone(), folder: "sweep".to_owned(), is_anew: false, hangs_on, mujoco: None };
    let studies: [(Box<dyn Study>, Origin); 1] = [(Box::new(study), origin)];
    if arguments.points.answer(&words, &studies, output)? {
        return Ok(());
    }
    let [(study, origin)] = &studies;
    let is_alone = arguments.points.point.is_some();
    let is_interrupted = if is_alone { Arc::default() } else { on_interrupt()? };
    let document = arguments.points.compute_or_draw(study.as_ref(), origin, &is_interrupted, output)?;
    document.map_or(Ok(()), |document| output.report(document))
}

/// Returns a key with its values, as they were given.
fn text(values: &[SetValue]) -> String {
    let key = values.first().map_or(String::new(), SetValue::key);
    format!("{key}={}", values.iter().map(SetValue::value).collect::<Vec<_>>().join(","))
}

/// Returns `KEY=A;B`, `KEY=A..B`, `KEY=A:B` or `KEY=A-B` as `KEY=A,B`; `None` if the value is no such list of numbers.
fn with_commas(setting: &str) -> Option<String> {
    let (key, value) = setting.split_once('=')?;
    let spaced = value.replace("..", " ").replace([';', '|', ':'], " ");
    // A minus between two numbers separates them; one before a number, or in an exponent, is its sign.
    let spaced = match spaced.split_once('-') {
        Some((first, last)) if first.ends_with(|one: char| one.is_ascii_digit()) => format!("{first} {last}"),
        _ => spaced,
    };
    let numbers: Vec<&str> = spaced.split_whitespace().collect();
    let is_list = numbers.len() > 1 && numbers.iter().all(|number| number.parse::<f64>().is_ok());
    is_list.then(|| format!("{key}={}", numbers.join(",")))
}

fn failure(error: SettingsError) -> Failure {
    let help = match &error {
        SettingsError::Refused { setting, report } => {
            let mut failure = Failure::from(report.clone());
            if let (Some(list), Some(first)) = (with_commas(setting), failure.report.diagnostics.first_mut()) {
                first.help = Some(format!("separate values by commas: --set {list}"));
            }
            return failure;
        }
        SettingsError::Key(_) => "give each key once, with all its values: --set KEY=A,B".to_owned(),
        SettingsError::NoMachine(_) => {
            "name a rig or an impedance device, such as builtin:paper-admittance.yaml".to_owned()
        }
        SettingsError::TooMany(_) => "give fewer values, in several sweeps".to_owned(),
        SettingsError::Repeated(_) => "give each value once; --seeds N runs each combination again".to_owned(),
        SettingsError::Twice { key, option } => format!("leave out {option} or the key {key}"),
        SettingsError::NoOutput(_) => format!("the measures are {}", OUTPUTS.join(", ")),
    };
    Failure::new(Exit::Usage, error.to_string(), help)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_without_commas_is_shown_with_them() {
        for value in ["5;10", "5..10", "5 10", "5; 10", "5|10", "5:10", "5-10"] {
            let setting = format!("fixture.yield_n={value}");
            let values = SetValue::each(&setting).unwrap();
            let source = Source::named("builtin:play.yaml");
            let refused = Settings::new(source, vec![values], NonZeroU32::MIN, None, &[]).err().unwrap();
            let failure = failure(refused);
            let help = failure.report.diagnostics[0].help.as_deref();
            assert_eq!(help, Some("separate values by commas: --set fixture.yield_n=5,10"), "{value}");
            assert_eq!(failure.exit, Exit::ConfigInvalid);
        }
        for setting in ["fixture.yield_n=-1", "fixture.law=elipse", "rig.name=a;b", "fixture.yield_n="] {
            assert_eq!(with_commas(setting), None, "{setting}");
        }
    }
}
