//! `yieldwall study`: tables and charts of speed, accuracy and stability.

mod document;
mod page;
mod points;

use std::path::PathBuf;
use std::sync::Arc;

use clap::builder::{PossibleValue, PossibleValuesParser};
use serde_json::json;

pub(super) use self::points::{Origin, Points};
use super::failure::{Exit, Failure};
use super::interrupt::on_interrupt;
use super::output::Output;
use yieldwall_config::Source;
use yieldwall_study::need::Subject;
use yieldwall_study::{NAMES, NEED, Options, OptionsError, PLANT, study};

/// All studies, one after the other.
const ALL: &str = "all";

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Study to compute
    #[arg(value_name = "NAME", value_parser = names())]
    name: String,
    /// For `need`: rig or impedance device, such as `builtin:play.yaml`; default: the shipped scenes
    ///
    /// Its scene has to state a `tolerance`. The command runs each model that the rig and its scene can have, from the simplest (no arm) to
    /// the fullest (elastic gears). It prints the simplest of the fastest models that change no output of the scene by more than its tolerance, with the
    /// lines of your files for that model. Its results are in DIR/need-own, and each run computes them again.
    #[arg(value_name = "RIG.yaml")]
    rig: Option<String>,
    #[command(flatten)]
    points: Points,
    /// Compute nothing: write the study's findings and tables into DIR/studies.md and DIR/study-tables.md; default DIR: docs
    ///
    /// The pages hold them between the lines `<!-- begin: STUDY-NAME -->` and `<!-- end -->`. Text outside these lines stays
    /// unchanged. If the tables do not support a finding, the command names the rows and writes nothing.
    #[arg(
        long,
        value_name = "DIR",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "docs",
        conflicts_with_all = ["out", "jobs", "shard", "merge", "slurm", "missing", "point", "any_build", "fresh", "mujoco"]
    )]
    page: Option<PathBuf>,
    /// With --page: folder of the tables, DIR/study-STUDY-TABLE.csv
    #[arg(long, value_name = "DIR", default_value = "docs/data", requires = "page")]
    tables: PathBuf,
    /// For `plant`: program that runs its scene in MuJoCo; hil-tests/peers/mujoco builds it and prints its name
    #[arg(long, value_name = "PROGRAM")]
    mujoco: Option<PathBuf>,
}

/// Returns the studies, each with its question.
fn names() -> PossibleValuesParser {
    let each = NAMES.map(|name| {
        let about = study(name, &Options::default()).map_or("", |study| study.about());
        PossibleValue::new(name).help(about)
    });
    let all = PossibleValue::new(ALL).help("each of these, one after the other");
    PossibleValuesParser::new(each.into_iter().chain([all]))
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let own = arguments.rig.as_deref().map(|file| own(file, arguments, output)).transpose()?;
    let options = Options { mujoco: arguments.mujoco.clone(), own };
    let named = |name: &str, options: &Options| {
        study(name, options).ok_or_else(|| Failure::new(Exit::Internal, format!("no study {name}"), ""))
    };
    let names = NAMES.into_iter().filter(|name| [*name, ALL].contains(&arguments.name.as_str()));
    if let Some(path) = &arguments.page {
        let studies = names.map(|name| named(name, &options)).collect::<Result<Vec<_>, _>>()?;
        return page::write(path, &arguments.tables, &studies, output);
    }
    let points = &arguments.points;
    let is_all = arguments.name == ALL;
    if is_all && points.point.is_some() {
        return Err(Failure::new(Exit::Usage, "--point: `all` has no tables", "name the study"));
    }
    let takes_options = if is_all { PLANT } else { &arguments.name };
    options.check(takes_options, points.parts.computes()).map_err(|error| options_failure(&error))?;
    let mut studies = Vec::new();
    for name in names {
        let options = if name == takes_options { &options } else { &Options::default() };
        studies.push((named(name, options)?, origin(name, arguments, options)));
    }
    if points.answer(&words(&arguments.name, arguments), &studies, output)? {
        return Ok(());
    }
    // A point alone is not kept, so there is nothing to finish.
    let is_interrupted = if points.point.is_some() { Arc::default() } else { on_interrupt()? };
    let mut documents = serde_json::Map::new();
    for (study, origin) in &studies {
        if is_all {
            output.news(&format!("{}: {}", study.name(), study.about()))?;
        }
        let document = points.compute_or_draw(study.as_ref(), origin, &is_interrupted, output)?;
        match document {
            Some(document) if is_all => documents.extend([(study.name().to_owned(), document)]),
            Some(document) => output.report(document)?,
            None => {}
        }
    }
    if is_all && output.is_json() { output.report(json!({ "studies": documents })) } else { Ok(()) }
}

/// Returns a machine of the user's own, for the study that takes one.
fn own(file: &str, arguments: &Arguments, output: &mut Output) -> Result<Arc<Subject>, Failure> {
    let name = &arguments.name;
    if name != NEED {
        let message = format!("the study {name} takes no file, and {file} is given");
        let help = format!("leave out {file}, or run `yieldwall study {NEED} {file}`");
        return Err(Failure::new(Exit::Usage, message, help));
    }
    let parts = &arguments.points.parts;
    let refused = [
        ("--page", arguments.page.is_some()),
        ("--shard", parts.shard.is_some()),
        ("--merge", parts.merge),
        ("--slurm", parts.slurm.is_some()),
        ("--missing", parts.missing),
    ];
    if let Some((option, _)) = refused.into_iter().find(|(_, is_given)| *is_given) {
        let why = match option {
            "--page" => "the pages are about the shipped scenes, and this table belongs to your files",
            _ => "its table has times, which one computer measures in one run",
        };
        let message = format!("`study {NEED} {file}` takes no {option}: {why}");
        let folder = arguments.points.out.join(format!("{NEED}-own"));
        let help = format!("leave out {option}; the table is written to {}", folder.display());
        return Err(Failure::new(Exit::Usage, message, help));
    }
    let subject = Subject::load(Source::named(file))?;
    output.configuration(subject.warnings())?;
    Ok(Arc::new(subject))
}

/// Words of the command that computes a study, or all.
fn words(name: &str, arguments: &Arguments) -> Vec<String> {
    let mut words = vec!["study".to_owned(), name.to_owned()];
    words.extend(arguments.rig.clone());
    if [PLANT, ALL].contains(&name) {
        let program = arguments.mujoco.iter();
        words.extend(program.flat_map(|program| ["--mujoco".to_owned(), program.display().to_string()]));
    }
    words
}

fn origin(name: &str, arguments: &Arguments, options: &Options) -> Origin {
    let own = options.own.as_ref();
    let machine = own.map_or_else(String::new, |own| format!(" of {:08x}", crc32fast::hash(own.text().as_bytes())));
    let mujoco = if options.mujoco.is_some() { " with MuJoCo" } else { "" };
    Origin {
        words: words(name, arguments),
        folder: if own.is_some() { format!("{name}-own") } else { name.to_owned() },
        // Machines of one's own change often, and are soon computed.
        is_anew: own.is_some(),
        hangs_on: format!("{machine}{mujoco}"),
        mujoco: if arguments.points.parts.computes() { options.mujoco_version() } else { None },
    }
}

fn options_failure(error: &OptionsError) -> Failure {
    let help = match error {
        OptionsError::WithoutMujoco { .. } => "leave out --mujoco; it is for `plant`",
        OptionsError::Mujoco { .. } => {
            "give --mujoco what hil-tests/peers/mujoco prints, or leave it out: our methods alone"
        }
    };
    Failure::new(Exit::Usage, error.to_string(), help)
}
