//! `yieldwall study`: tables and charts of speed, accuracy and stability.

mod document;
mod page;
mod points;

use std::path::PathBuf;

use clap::builder::{PossibleValue, PossibleValuesParser};
use serde_json::{Value, json};

pub(super) use self::points::{Origin, Points};
use super::failure::{Exit, Failure};
use super::output::Output;
use yieldwall_study::sweep::Study;
use yieldwall_study::{NAMES, Options, OptionsError, PLANT, study};

/// All studies, one after the other.
const ALL: &str = "all";

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The study
    #[arg(value_name = "NAME", value_parser = names())]
    name: String,
    #[command(flatten)]
    points: Points,
    /// Compute nothing: write the findings and tables of the study into DIR/studies.md and DIR/study-tables.md; DIR is docs unless given
    ///
    /// The pages hold them between the lines `<!-- begin: STUDY-NAME -->` and `<!-- end -->`. Text outside these lines stays as it
    /// is. If the tables do not show a finding, the command names the rows and writes nothing.
    #[arg(
        long,
        value_name = "DIR",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "docs",
        conflicts_with_all = ["out", "jobs", "shard", "merge", "point", "any_build", "fresh", "mujoco"]
    )]
    page: Option<PathBuf>,
    /// With --page: folder of the tables, DIR/study-STUDY-TABLE.csv
    #[arg(long, value_name = "DIR", default_value = "docs/data", requires = "page")]
    tables: PathBuf,
    /// For `plant`: the program that runs its scene in MuJoCo; hil-tests/peers/mujoco builds it and prints its name
    #[arg(long, value_name = "PROGRAM")]
    mujoco: Option<PathBuf>,
}

/// The studies, each with what it asks.
fn names() -> PossibleValuesParser {
    let each = NAMES.map(|name| {
        let about = study(name, &Options::default()).map_or("", |study| study.about());
        PossibleValue::new(name).help(about)
    });
    let all = PossibleValue::new(ALL).help("each of these, one after the other");
    PossibleValuesParser::new(each.into_iter().chain([all]))
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let options = Options { mujoco: arguments.mujoco.clone() };
    let named = |name: &str, options: &Options| {
        study(name, options).ok_or_else(|| Failure::new(Exit::Internal, format!("no study {name}"), ""))
    };
    if let Some(path) = &arguments.page {
        let names = NAMES.into_iter().filter(|name| [*name, ALL].contains(&arguments.name.as_str()));
        let studies = names.map(|name| named(name, &options)).collect::<Result<Vec<_>, _>>()?;
        return page::write(path, &arguments.tables, &studies, output);
    }
    if arguments.name != ALL {
        options.check(&arguments.name, !arguments.points.merge).map_err(|error| options_failure(&error))?;
        let study = named(&arguments.name, &options)?;
        let document = compute_or_draw(study.as_ref(), &options, arguments, output)?;
        return document.map_or(Ok(()), |document| output.report(document));
    }
    if arguments.points.point.is_some() {
        return Err(Failure::new(Exit::Usage, "--point: `all` has no tables", "name the study"));
    }
    options.check(PLANT, !arguments.points.merge).map_err(|error| options_failure(&error))?;
    let mut documents = serde_json::Map::new();
    for name in NAMES {
        let options = if name == PLANT { &options } else { &Options::default() };
        let study = named(name, options)?;
        output.news(&format!("{name}: {}", study.about()))?;
        let document = compute_or_draw(study.as_ref(), options, arguments, output)?;
        documents.extend(document.map(|document| (name.to_owned(), document)));
    }
    if output.is_json() { output.report(json!({ "studies": documents })) } else { Ok(()) }
}

/// Computes and draws a study; the JSON document of that, if it is asked for and not printed yet.
fn compute_or_draw(
    study: &dyn Study,
    options: &Options,
    arguments: &Arguments,
    output: &mut Output,
) -> Result<Option<Value>, Failure> {
    let mujoco = options.mujoco.as_ref().map_or_else(String::new, |program| format!(" --mujoco {}", program.display()));
    let origin = Origin {
        command: format!("yieldwall study {}{mujoco}", study.name()),
        hangs_on: if options.mujoco.is_some() { " with MuJoCo" } else { "" }.to_owned(),
        mujoco: if arguments.points.merge { None } else { options.mujoco_version() },
    };
    arguments.points.compute_or_draw(study, &origin, output)
}

fn options_failure(error: &OptionsError) -> Failure {
    let help = match error {
        OptionsError::WithoutMujoco { .. } => "leave --mujoco away; it is for `plant`",
        OptionsError::Mujoco { .. } => {
            "give --mujoco what hil-tests/peers/mujoco prints, or leave it away: our methods alone"
        }
    };
    Failure::new(Exit::Usage, error.to_string(), help)
}
