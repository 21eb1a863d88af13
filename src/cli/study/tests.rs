use std::fs;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use clap::Parser;

use super::*;
use yieldwall_study::sweep::{Clock, Report};
use yieldwall_study::{Options, study};

/// Points that need no time: a table of halves and one of squares.
struct Small([Box<dyn Sweep>; 2]);

struct Powers {
    name: &'static str,
    of: fn(f64) -> f64,
    /// The point in which somebody interrupts the study.
    stop: Option<(u64, Arc<AtomicBool>)>,
}

impl Sweep for Powers {
    fn name(&self) -> &'static str {
        self.name
    }
    fn columns(&self) -> Vec<&str> {
        vec!["side_m", "value"]
    }
    fn points(&self) -> u64 {
        25
    }
    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        if let Some((_, flag)) = self.stop.iter().find(|(at, _)| *at == index) {
            flag.store(true, Ordering::Relaxed);
        }
        let side = 0.1 * index as f64;
        vec![side.into(), (self.of)(side).into()]
    }
}

impl Study for Small {
    fn name(&self) -> &'static str {
        "small"
    }
    fn about(&self) -> &'static str {
        "tables for a test"
    }
    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.0
    }
    fn report(&self, tables: &[Table]) -> Report {
        Report { notes: vec![format!("{} tables", tables.len())], charts: Vec::new() }
    }
}

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    points: Points,
}

/// A folder that goes with the test.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("yieldwall-study-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Runs the small study with the arguments of a command line.
fn study_of(folder: &Folder, line: &str) -> Result<(), Failure> {
    study_until(folder, line, None)
}

/// Runs the study, and interrupts it while the point `last` of the halves is computed.
fn study_until(folder: &Folder, line: &str, last: Option<u64>) -> Result<(), Failure> {
    let flag = Arc::new(AtomicBool::new(false));
    let stop = last.map(|last| (last, Arc::clone(&flag)));
    let study = Small([
        Box::new(Powers { name: "halves", of: |side| 0.5 * side, stop }),
        Box::new(Powers { name: "squares", of: |side| side * side, stop: None }),
    ]);
    let words = ["study", "--out"].into_iter().map(str::to_owned);
    let out = folder.0.display().to_string();
    let Line { points } = Line::parse_from(words.chain([out]).chain(line.split_whitespace().map(str::to_owned)));
    let mut output = Output::new(true, false, false);
    let words = ["study", "small"].map(str::to_owned).to_vec();
    let origin = Origin { words, folder: "small".to_owned(), is_anew: false, hangs_on: String::new(), mujoco: None };
    points.compute_or_draw(&study, &origin, &flag, &mut output).map(|_| ())
}

fn read(folder: &Folder, name: &str) -> String {
    fs::read_to_string(folder.0.join("small").join(name)).unwrap()
}

fn document(folder: &Folder) -> Value {
    serde_json::from_str(&read(folder, "small.json")).unwrap()
}

#[test]
fn two_shards_merged_are_the_whole() {
    let (whole, parts) = (Folder::new("whole"), Folder::new("parts"));
    study_of(&whole, "").unwrap();
    let none = study_of(&parts, "--merge").unwrap_err().report.diagnostics.remove(0);
    assert!(none.message.contains("holds no points of the table halves: there is nothing to merge"), "{none:?}");
    assert!(
        none.help.is_some_and(|help| help.contains("yieldwall study small --out ") && help.contains("--shard 1/4"))
    );
    study_of(&parts, "--shard 1/2").unwrap();
    let missing = study_of(&parts, "--merge").unwrap_err();
    assert_eq!(missing.exit, Exit::Usage, "half of the points are missing");
    study_of(&parts, "--shard 2/2").unwrap();
    assert!(!parts.0.join("small/halves.csv").exists(), "a part draws nothing");
    study_of(&parts, "--merge").unwrap();
    for name in ["halves.csv", "squares.csv"] {
        assert_eq!(read(&parts, name), read(&whole, name));
    }
    let [mut one, mut other] = [document(&parts), document(&whole)];
    assert_eq!(one["computed"], json!([]), "nothing was computed by the merge");
    assert_eq!(other["computed"].as_array().unwrap().len(), 2);
    for document in [&mut one, &mut other] {
        document.as_object_mut().unwrap().remove("computed");
    }
    assert_eq!(one, other);
}

#[test]
fn a_torn_file_is_gone_on_with() {
    let (whole, torn) = (Folder::new("untorn"), Folder::new("torn"));
    study_of(&whole, "").unwrap();
    study_of(&torn, "").unwrap();
    let path = torn.0.join("small/halves.whole.jsonl");
    let kept = fs::read_to_string(&path).unwrap();
    let lines: Vec<&str> = kept.lines().collect();
    // The last line broke off, and of those before it the last ten never came.
    let (last, before) = (lines[lines.len() - 11], lines[..lines.len() - 11].join("\n"));
    fs::write(&path, format!("{before}\n{}", &last[..last.len() / 2])).unwrap();
    fs::remove_file(torn.0.join("small/halves.csv")).unwrap();
    study_of(&torn, "").unwrap();
    assert_eq!(read(&torn, "halves.csv"), read(&whole, "halves.csv"));
    assert_eq!(document(&torn)["computed"][0]["runs"], 11, "what was there was not computed again");
    assert_eq!(document(&torn)["computed"].as_array().unwrap().len(), 1);
}

#[test]
fn the_document_says_with_what_it_was_computed_and_how_fast() {
    let folder = Folder::new("document");
    study_of(&folder, "--jobs 2").unwrap();
    let document = document(&folder);
    assert_eq!(document["command"], "yieldwall study small");
    assert_eq!(document["notes"], json!(["2 tables"]));
    assert_eq!(document["rows"][3], json!({ "index": 3, "side_m": 0.1 * 3.0, "value": 0.5 * (0.1 * 3.0) }));
    assert_eq!(document["tables"]["squares"].as_array().unwrap().len(), 25);
    let machine = &document["machine"];
    assert!(machine["rustc"].as_str().unwrap().starts_with("rustc 1."), "{machine}");
    assert!(machine["build"].as_str().unwrap().len() == 8 && machine["mujoco"].is_null(), "{machine}");
    assert!(["0", "1", "2", "3", "s", "z"].contains(&machine["opt_level"].as_str().unwrap()), "{machine}");
    let pace = &document["computed"][0];
    assert_eq!((&pace["table"], &pace["runs"], &pace["jobs"]), (&json!("halves"), &json!(25), &json!(2)));
    let (rate, wall_s) = (pace["runs_per_s"].as_f64().unwrap(), pace["wall_s"].as_f64().unwrap());
    assert!((rate * wall_s / 25.0 - 1.0).abs() < 1e-9 && pace["busy_share"].as_f64().unwrap() >= 0.0, "{pace}");
}

/// The study that is computed soonest, by its command.
#[test]
fn a_point_alone_is_its_row() {
    let folder = Folder::new("point");
    let out = folder.0.display();
    let line = format!("yieldwall -q study pair --out {out}");
    assert_eq!(crate::run(line.split(' ').map(Into::into)), Exit::Ok);
    let text = fs::read_to_string(folder.0.join("pair/pair.json")).unwrap();
    let document: Value = serde_json::from_str(&text).unwrap();
    let pair = study("pair", &Options::default()).unwrap();
    let name = pair.sweeps()[0].name();
    for index in [0, 77, 191] {
        let (_, one) = point(pair.as_ref(), &parse_point(&format!("{name}:{index}")).unwrap()).unwrap();
        assert_eq!(one.json()[0], document["rows"][index as usize]);
    }
    for (name, message, help) in [
        (format!("{name}:192"), format!("{name} has no point 192"), "its points are 0 to 191".to_owned()),
        ("none:0".to_owned(), "pair has no table none".to_owned(), format!("such as --point {name}:0;")),
        ("5".to_owned(), "--point 5 names no table of pair".to_owned(), format!("such as --point {name}:5;")),
    ] {
        let failure = point(pair.as_ref(), &parse_point(&name).unwrap()).map(|_| ()).unwrap_err();
        let finding = &failure.report.diagnostics[0];
        assert_eq!((failure.exit, finding.message.as_str()), (Exit::Usage, message.as_str()));
        assert!(finding.help.as_ref().is_some_and(|text| text.contains(&help)), "{finding:?}");
    }
    for chart in ["study-pair.svg", "study-pair.png"] {
        assert!(folder.0.join("pair").join(chart).exists(), "{chart}");
    }
}

#[test]
fn a_machine_of_ones_own_has_one_proposal_in_a_folder_of_its_own_and_is_computed_anew() {
    let folder = Folder::new("own");
    let line = format!("yieldwall -q study need builtin:paper-impedance.yaml --out {}", folder.0.display());
    let (mut sources, of_own) = (Vec::new(), folder.0.join("need-own"));
    for line in [line.clone(), line.replace("paper-impedance", "sphere"), format!("{line} --merge")] {
        let wanted = if sources.len() == 2 { Exit::Usage } else { Exit::Ok };
        assert_eq!(crate::run(line.split(' ').map(Into::into)), wanted, "{line}");
        let document: Value = serde_json::from_str(&fs::read_to_string(of_own.join("need.json")).unwrap()).unwrap();
        let rows = document["rows"].as_array().unwrap();
        assert_eq!(rows.iter().filter(|row| row["is_needed"] == true).count(), 1, "{rows:?}");
        sources.push(rows[0]["machine"].clone());
        assert!(of_own.join("study-need.svg").exists() && of_own.join("models.csv").exists());
    }
    let [first, second] = ["builtin:paper-impedance.yaml", "builtin:sphere.yaml"];
    assert_eq!(sources, [first, second, second], "points of another machine are not drawn");
}

#[test]
fn points_are_read() {
    let read = |text: &str| parse_point(text).map(|point| (point.table, point.index));
    assert_eq!(read("mass:17"), Ok((Some("mass".to_owned()), 17)));
    assert_eq!(read("17"), Ok((None, 17)));
    assert!(parse_point("mass").is_err());
}

#[test]
fn an_interrupted_study_goes_on_where_it_stood() {
    let (whole, parts) = (Folder::new("uninterrupted"), Folder::new("interrupted"));
    study_of(&whole, "").unwrap();
    // Of the points 1, 4, 7, ..., 22 the fourth is the last that begins.
    let interrupted = study_until(&parts, "--shard 2/3 --jobs 1", Some(10)).unwrap_err();
    assert_eq!(interrupted.exit, Exit::Interrupted);
    let message = &interrupted.report.diagnostics[0].message;
    assert!(message.starts_with("interrupted: 4 of 8 points of halves are missing; "), "{message}");
    assert_eq!(read(&parts, "halves.2-of-3.jsonl").lines().count(), 1 + 4);
    assert!(!parts.0.join("small/squares.2-of-3.jsonl").exists(), "no other table was begun");
    for part in 1..=3 {
        study_of(&parts, &format!("--shard {part}/3")).unwrap();
    }
    assert_eq!(read(&parts, "halves.2-of-3.jsonl").lines().count(), 1 + 8, "no point was computed twice");
    study_of(&parts, "--merge").unwrap();
    for name in ["halves.csv", "squares.csv"] {
        assert_eq!(read(&parts, name), read(&whole, name));
    }
}
