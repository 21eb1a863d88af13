//! `yieldwall compare`: runs and recordings side by side.

mod differences;
mod item;
mod table;

use std::path::PathBuf;

use serde_json::json;

use self::differences::differences;
use self::item::Item;
pub(super) use self::table::Table;
use self::table::measures_table;
use super::failure::{Exit, Failure};
use super::interrupt::on_interrupt;
use super::output::Output;
use super::picture::{check_picture, drawing_failure, write_drawing};
use super::progress::Progress;
use super::replace::Replace;
use super::run::{check_duration, with_files};
use yieldwall_figures::{MOST_MOVING, Options, animation, comparison, differences as differences_drawn};
use yieldwall_record::Trace;
use yieldwall_rig::report::Overrides;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Two to six items: rigs, impedance devices or recordings
    ///
    /// Rigs and devices run on the embedded simulation. A recording is a cycles.mcap, its folder, or a black-box file.
    #[arg(value_name = "RIG.yaml|RECORDING", required = true, num_args = 2..=6)]
    items: Vec<String>,
    /// Overlay paths, forces and distances in this .svg or .png file; missing folders are created
    #[arg(long, value_name = "PATH")]
    figure: Option<PathBuf>,
    /// Draw the tools side by side into this animated .svg file; at most three items
    #[arg(long, value_name = "FILE.svg")]
    animation: Option<PathBuf>,
    #[command(flatten)]
    replace: Replace,
    /// Seconds to run; default: each scene's duration. Recordings keep theirs
    #[arg(long, value_name = "S", value_parser = super::usage::seconds, allow_negative_numbers = true)]
    duration: Option<f64>,
    /// Seed of tremor and sensor noise; default: each scene's seed. Recordings keep theirs
    #[arg(long, value_name = "N", value_parser = super::usage::whole::<u64>, allow_negative_numbers = true)]
    seed: Option<u64>,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    check_duration(arguments.duration)?;
    if let Some(path) = &arguments.figure {
        check_picture(path, arguments.replace)?;
    }
    if let Some(path) = &arguments.animation {
        check_picture(path, arguments.replace)?;
        if path.extension().is_none_or(|ending| ending != "svg") {
            let message = format!("--animation {}: a picture that moves is an .svg", path.display());
            return Err(Failure::new(Exit::Usage, message, "end the name in .svg"));
        }
        if arguments.items.len() > MOST_MOVING {
            let message =
                format!("--animation is for up to {MOST_MOVING} items, and {} are named", arguments.items.len());
            return Err(Failure::new(Exit::Usage, message, "name fewer, or draw them with --figure"));
        }
    }
    let overrides = Overrides { duration_s: arguments.duration, seed: arguments.seed, ..Overrides::default() };
    let is_interrupted = on_interrupt()?;
    let progress = Progress::new(output);
    let mut items = Vec::new();
    for (name, label) in arguments.items.iter().zip('A'..) {
        items.push(Item::of(name, label, &overrides, &is_interrupted, &progress, output)?);
    }
    progress.end();
    let table = measures_table(&items);
    let documents: Vec<_> = items.iter().map(|item| item.document.clone()).collect();
    let differences = differences(&documents);
    let traces: Vec<&Trace> = items.iter().map(|item| &item.trace).collect();
    let drawn = arguments.figure.as_deref().map_or(Ok(()), |path| {
        let names = labelled(&items, &names(&traces));
        let runs: Vec<(&str, &Trace)> = names.iter().map(String::as_str).zip(traces.iter().copied()).collect();
        let options = Options { heading: Some(String::new()), ..Options::default() };
        let drawing = comparison(&runs, &options).map_err(|error| drawing_failure(&error))?;
        write_drawing(&drawing, path)
    });
    let moved = arguments.animation.as_deref().map_or(Ok(()), |path| {
        let names = names(&traces);
        let names = if are_distinct(&names) { names } else { labelled(&items, &names) };
        let runs: Vec<(&str, &Trace)> = names.iter().map(String::as_str).zip(traces.iter().copied()).collect();
        let picture = animation(&runs).map_err(|error| drawing_failure(&error))?;
        arguments.replace.write(path, picture.as_bytes())
    });
    let drawn = with_files(drawn, [moved, Ok(())]);
    if output.is_json() {
        let figure = arguments.figure.as_ref().filter(|_| drawn.is_ok());
        let document = json!({
            "items": items.iter().map(Item::to_json).collect::<Vec<_>>(),
            "differences": differences.iter().map(|one| json!({ "key": one.key, "values": one.values })).collect::<Vec<_>>(),
            "figure": figure,
            "animation": arguments.animation.as_ref().filter(|_| drawn.is_ok()),
        });
        return output.end(document, drawn);
    }
    let mut lines: Vec<String> = items.iter().map(Item::line).collect();
    lines.push(String::new());
    lines.extend(table.lines());
    lines.push(String::new());
    if differences.is_empty() {
        lines.push("no key of the configurations differs".to_owned());
    } else {
        let head =
            std::iter::once("key that differs".to_owned()).chain(items.iter().map(|item| item.label.to_string()));
        let mut table = Table::new(head.collect());
        let laws: Vec<String> = traces.iter().map(|trace| trace.setup.law.clone()).collect();
        for one in &differences {
            // A law is a group of keys or none: words say more.
            let is_law = one.key == "fixture.law" && laws.iter().any(|law| *law != laws[0]);
            let cells = if is_law { [vec![one.key.clone()], laws.clone()].concat() } else { one.cells() };
            table.push(cells);
        }
        lines.extend(table.lines());
    }
    let pictures = [("figure   ", &arguments.figure), ("animation", &arguments.animation)];
    for (name, path) in pictures.into_iter().filter(|_| drawn.is_ok()) {
        lines.extend(path.as_ref().map(|path| format!("\n{name} {}", path.display())));
    }
    output.news(&lines.join("\n"))?;
    drawn
}

/// Returns the names of items in drawings: law and numbers that differ, with the names of the machines if that makes a difference.
fn names(traces: &[&Trace]) -> Vec<String> {
    let facts = differences_drawn(traces);
    let join = |(facts, trace): (&String, &&Trace)| match facts.is_empty() {
        true => trace.title.clone(),
        false => format!("{}, {facts}", trace.title),
    };
    let with_titles: Vec<String> = facts.iter().zip(traces).map(join).collect();
    if !are_distinct(&facts) && are_distinct(&with_titles) { with_titles } else { facts }
}

fn are_distinct(names: &[String]) -> bool {
    names.iter().enumerate().all(|(at, name)| !names[..at].contains(name))
}

/// Returns the letters of items with their names, which may be empty.
fn labelled(items: &[Item], names: &[String]) -> Vec<String> {
    let label = |(item, name): (&Item, &String)| match name.is_empty() {
        true => item.label.to_string(),
        false => format!("{}: {name}", item.label),
    };
    items.iter().zip(names).map(label).collect()
}

/// Returns the failure that a run's saved text cannot be read.
fn not_kept(what: &str, error: impl std::fmt::Display) -> Failure {
    Failure::new(Exit::Internal, format!("{what}: {error}"), "")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use std::sync::atomic::AtomicBool;

    const RIG: &str = "builtin:paper-admittance.yaml";

    fn item(name: &str, duration_s: f64) -> Result<Item, Failure> {
        let mut output = Output::new(true, false, false);
        let progress = Progress::new(&output);
        let overrides = Overrides { duration_s: Some(duration_s), ..Overrides::default() };
        Item::of(name, 'A', &overrides, &AtomicBool::new(false), &progress, &mut output)
    }

    fn keys_that_differ(one: &Item, other: &Item) -> Vec<String> {
        differences(&[one.document.clone(), other.document.clone()]).into_iter().map(|one| one.key).collect()
    }

    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("yieldwall-compare-{name}-{}", std::process::id()));
            std::fs::create_dir_all(&path).unwrap();
            Self(path)
        }

        fn at(&self, name: &str) -> String {
            self.0.join(name).to_str().unwrap().to_owned()
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    fn exit(line: &str) -> Exit {
        super::super::run(line.split(' ').map(std::ffi::OsString::from))
    }

    #[test]
    fn a_change_of_the_yield_force_is_all_that_differs() {
        let folder = Folder::new("changed");
        let path = folder.at("rig.yaml");
        std::fs::write(&path, "like: builtin:paper-admittance.yaml\nfixture: {yield_n: 10.0}\n").unwrap();
        let (shipped, again, changed) = (item(RIG, 3.0).unwrap(), item(RIG, 3.0).unwrap(), item(&path, 3.0).unwrap());
        assert!(keys_that_differ(&shipped, &again).is_empty());
        assert_eq!(shipped.measures, again.measures);
        assert_eq!(keys_that_differ(&shipped, &changed), ["fixture.yield_n"]);
        assert!(shipped.measures != changed.measures);
        let device = item("builtin:sphere.yaml", 1.0).unwrap();
        let lines = measures_table(&[shipped, device]).lines();
        assert!(lines.iter().any(|line| line.starts_with("torque, peak") && line.ends_with('-')), "{lines:#?}");
    }

    /// The recording of a run equals the run: the measures to the last bit, and the documents.
    #[test]
    fn a_recording_compares_as_its_run_and_is_exported_as_it_was_recorded() {
        let folder = Folder::new("recorded");
        let record = folder.at("record");
        assert_eq!(exit(&format!("yieldwall -q run {RIG} --duration 2 --record {record}")), Exit::Ok);
        let (run, read) = (item(RIG, 2.0).unwrap(), item(&record, 1.0).unwrap());
        assert_eq!(run.measures, read.measures);
        assert!(run.trace == read.trace && run.period_s == read.period_s);
        assert!(keys_that_differ(&run, &read).is_empty(), "{:?}", keys_that_differ(&run, &read));
        let csv = folder.at("again.csv");
        let export = format!("yieldwall -q record export {record} --csv {csv}");
        assert_eq!(exit(&export), Exit::Ok);
        let [recorded, exported] =
            [Path::new(&record).join("cycles.csv"), PathBuf::from(&csv)].map(|path| std::fs::read(path).unwrap());
        assert!(recorded == exported, "the text is another one");
        assert_eq!(exit(&export), Exit::Usage, "it is there already");
        assert_eq!(exit(&format!("{export} --force")), Exit::Ok);
        // The text of the recording itself stays.
        assert_eq!(exit(&format!("yieldwall -q record export {record}")), Exit::Usage);
        assert_eq!(exit(&format!("yieldwall -q record export {record}/cycles.csv")), Exit::ConfigInvalid);
        // A fault stops the run that left this box: it is compared, and said.
        let fault = format!("yieldwall -q run {RIG} --duration 2 --fault node-reset@0.5 --black-box {record}");
        assert_eq!(exit(&fault), Exit::SafetyStop);
        let black_box = format!("{record}/paper-admittance-000001.black-box.mcap");
        let stopped = item(&black_box, 1.0).unwrap();
        assert!(stopped.line().contains("stopped by node-reset at 0.5"), "{}", stopped.line());
        assert_eq!(exit(&format!("yieldwall -q record export {black_box}")), Exit::Ok);
        let text = std::fs::read_to_string(black_box.replace(".mcap", ".csv")).unwrap();
        assert!(text.lines().count() > 2000, "the 2 s after the fault");
        let figure = folder.at("both.svg");
        let both = format!("yieldwall -q compare {record} {black_box} --figure {figure}");
        assert_eq!(exit(&both), Exit::Ok);
        assert!(std::fs::read_to_string(figure).unwrap().contains(">B</text>"));
    }

    #[test]
    fn a_picture_that_moves_says_what_wall_and_spring_do_after_the_hand() {
        let folder = Folder::new("moving");
        let (recording, picture) = (folder.at("spring"), folder.at("push.svg"));
        assert_eq!(exit(&format!("yieldwall -q run builtin:play-spring.yaml --record {recording}")), Exit::Ok);
        let line = format!("yieldwall -q compare builtin:play.yaml {recording} --animation {picture}");
        assert_eq!((exit(&line), exit(&format!("{line} --force"))), (Exit::Ok, Exit::Ok));
        let svg = std::fs::read_to_string(picture).unwrap();
        let moved = svg.split("let go: thrown back ").skip(1).map(|rest| rest.split_once(" mm").unwrap().0);
        let moved_mm: Vec<f64> = moved.map(|text| text.parse().unwrap()).collect();
        assert_eq!(moved_mm.len(), 2);
        assert!(moved_mm[0] < 0.2 && moved_mm[1] > 10.0, "{moved_mm:?}");
        assert_eq!((svg.matches("attributeName=\"cx\"").count(), svg.contains("NaN")), (3, false));
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        for (line, expected) in [
            (format!("compare {RIG}"), Exit::Usage),
            (format!("compare {RIG} {RIG} --duration -1"), Exit::Usage),
            (format!("compare {RIG} {RIG} --figure x.txt"), Exit::Usage),
            (format!("compare {RIG} {RIG} --animation x.png"), Exit::Usage),
            (format!("compare {RIG} {RIG} {RIG} {RIG} --animation x.svg"), Exit::Usage),
            (format!("compare {RIG} builtin:scenes/room-walk.yaml --duration 0.1"), Exit::ConfigInvalid),
            (format!("compare {RIG} absent.mcap --duration 0.1"), Exit::ConfigInvalid),
            (format!("compare {RIG} absent.yaml --duration 0.1"), Exit::ConfigInvalid),
        ] {
            assert_eq!(exit(&format!("yieldwall -q {line}")), expected, "{line}");
        }
    }
}
