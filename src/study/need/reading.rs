//! Chart and text of the tables.

use super::models::LABELS;
use super::outputs::{self, RAN};
use super::subject::Subject;
use super::terms;
use crate::chart::{Axis, Chart, Color, Mark, Panel, Series};
use crate::page::{Rows, digits};
use crate::sweep::{Report, Row, Table};

/// Kinds of models in the chart: body, whether the step is the finest, name, colour, which has the shape.
const KINDS: [(&str, bool, &str, Color); 7] = [
    ("ideal", true, "no arm", Color::Black),
    ("rigid", false, "stiff arm, longer step", Color::Blue),
    ("rigid", true, "stiff arm, shortest step", Color::Vermilion),
    ("elastic", false, "elastic gears, longer step", Color::Green),
    ("elastic", true, "elastic gears, shortest step", Color::Purple),
    ("point", false, "point mass, longer step", Color::Blue),
    ("point", true, "point mass, shortest step", Color::Vermilion),
];
/// Changes over the tolerance that the chart shows; those below stand at its edge.
const SHOWN: [f64; 2] = [1e-3, 1e3];

/// The shipped scenes.
pub(super) fn shipped(models: &Table, terms: &Table) -> Report {
    let all = models.all();
    let mut notes = Vec::new();
    for rows in of_scenes(&all) {
        notes.extend(heading(&rows));
        notes.extend(lines(&rows.filter("on the front", |row| row.is("is_on_front") || row.is("is_needed"))));
        notes.extend(proposal(&rows));
    }
    notes.extend(terms::notes(terms));
    Report { notes, charts: vec![("study-need", chart(&all, &LABELS))] }
}

/// A user's machine and scene: all models, the proposal, and how to have it.
pub(super) fn own(models: &Table, subject: &Subject) -> Report {
    let all = models.all();
    let mut notes: Vec<String> = heading(&all).into_iter().collect();
    notes.extend(lines(&all));
    notes.extend(proposal(&all));
    let place = all.iter().position(|row| row.is("is_needed"));
    match place.and_then(|place| subject.models.get(place)).map(|model| subject.lines(model)) {
        Some(lines) if lines.is_empty() => notes.push("The files have this model.".to_owned()),
        Some(lines) => {
            if lines.iter().any(|lines| lines.place.starts_with("builtin:")) {
                notes.push("Files inside the program cannot be edited. Change copies of them:".to_owned());
                notes.push("  yieldwall config show builtin:FILE > my-FILE".to_owned());
            }
            for lines in lines {
                notes.push(format!("{}:", lines.place));
                notes.extend(lines.yaml.lines().map(|line| format!("  {line}")));
            }
        }
        None => {
            notes.push("No model is proposed: a fault stops the model with all terms for some hands.".to_owned());
            notes.push("`yieldwall run` with other values of --seed shows it.".to_owned());
        }
    }
    Report { notes, charts: vec![("study-need", chart(&all, &["your scene"]))] }
}

/// The rows of each scene on its machine.
pub(super) fn of_scenes<'a>(all: &Rows<'a>) -> Vec<Rows<'a>> {
    let mut names: Vec<(&str, &str)> = all.iter().map(|row| (row.word("machine"), row.word("scene"))).collect();
    names.dedup();
    names.into_iter().map(|(machine, scene)| all.with("machine", machine).with("scene", scene)).collect()
}

fn heading(rows: &Rows<'_>) -> Option<String> {
    let first = rows.iter().next()?;
    Some(format!("{} on {}:", first.word("scene"), first.word("machine")))
}

/// A line for each model, the fastest first.
fn lines(rows: &Rows<'_>) -> Vec<String> {
    let mut rows: Vec<&Row<'_>> = rows.iter().collect();
    rows.sort_by(|one, other| other.number("realtime_factor").total_cmp(&one.number("realtime_factor")));
    let head = format!("  {:43} {:>6}  {:>11}  largest in", "model", "x real", "change/tol.");
    let foot = [
        "  + sufficient, * proposed: the simplest of the fastest sufficient models",
        "  A change is the largest of all outputs, beside the model with all terms.",
    ];
    let line = |row: &&Row<'_>| {
        let speed = match row.number("realtime_factor") {
            speed if speed.is_finite() => format!("{speed:.0}"),
            _ => "-".to_owned(),
        };
        let end = match row.word("outcome") {
            RAN => String::new(),
            outcome => format!("; {outcome}"),
        };
        let mark = match row.is("is_needed") {
            true => "*",
            false if row.is("is_enough") => "+",
            false => " ",
        };
        let (model, output) = (short(row.word("model")), outputs::short(row.word("most_changed")));
        format!("{mark} {model:43} {speed:>6}  {:>11}  {output}{end}", change(row))
    };
    std::iter::once(head).chain(rows.iter().map(line)).chain(foot.map(str::to_owned)).collect()
}

/// The name of a model in little space.
fn short(model: &str) -> String {
    model.replace("bus timing", "bus")
}

/// The greatest change over its tolerance, in words.
pub(super) fn change(row: &Row<'_>) -> String {
    match row.number("change_over_tolerance") {
        0.0 => "0".to_owned(),
        change if change.is_finite() && change < 0.005 => "<0.01".to_owned(),
        change if change.is_finite() => digits(change, 2),
        _ => "-".to_owned(),
    }
}

fn proposal(rows: &Rows<'_>) -> Vec<String> {
    let (Some(needed), Some(dearest)) = (rows.iter().find(|row| row.is("is_needed")), rows.iter().last()) else {
        return Vec::new();
    };
    let [speed, of_dearest] = [needed, dearest].map(|row| row.number("realtime_factor"));
    vec![
        format!("The scene needs: {}", needed.word("model")),
        format!("  speed   {:.2} times that of the model with all terms", speed / of_dearest),
        format!("  change  at most {} times the tolerance", change(needed)),
    ]
}

fn chart(all: &Rows<'_>, labels: &[&str]) -> Chart {
    let speeds = || all.iter().map(|row| row.number("realtime_factor")).filter(|speed| speed.is_finite());
    let (slowest, fastest) = (speeds().fold(f64::MAX, f64::min), speeds().fold(f64::MIN_POSITIVE, f64::max));
    let across = [slowest / 1.4, fastest * 1.4];
    let scenes = of_scenes(all);
    let panels: Vec<Panel> = scenes.iter().zip(labels).map(|(rows, label)| panel(rows, label, across)).collect();
    let title = "Speed and accuracy of each model of a scene".to_owned();
    Chart { title, panels }
}

fn panel(rows: &Rows<'_>, label: &str, across: [f64; 2]) -> Panel {
    let place = |row: &Row<'_>| (row.number("realtime_factor"), row.number("change_over_tolerance"));
    let finest = rows.iter().map(|row| row.number("plant_step_us")).fold(f64::INFINITY, f64::min);
    let mut front: Vec<(f64, f64)> = rows.iter().filter(|row| row.is("is_on_front")).map(place).collect();
    front.sort_by(|one, other| one.0.total_cmp(&other.0));
    // The dearest model has no change; the line comes up from the edge.
    front.iter_mut().for_each(|point| point.1 = point.1.max(SHOWN[0]));
    let tolerance = across.iter().map(|&speed| (speed, 1.0)).collect();
    let mut series = vec![
        Series { points: tolerance, ..Series::new("tolerance of the scene".to_owned(), Mark::Dashed, Color::Black) },
        Series {
            points: front,
            ..Series::new("Pareto front: no model is faster and more accurate".to_owned(), Mark::Line, Color::Black)
        },
    ];
    for (body, is_finest, name, color) in KINDS {
        let is_of = |row: &&Row<'_>| {
            row.word("body") == body && (body == "ideal" || (row.number("plant_step_us") <= finest) == is_finest)
        };
        let points = rows.iter().filter(is_of).map(place).collect();
        series.push(Series { points, ..Series::new(name.to_owned(), Mark::Marks, color) });
    }
    let needed = rows.iter().find(|row| row.is("is_needed"));
    let points = needed.map(place).into_iter().collect();
    series.push(Series {
        points,
        ..Series::new("ring: simplest sufficient model".to_owned(), Mark::Rings, Color::Black)
    });
    Panel {
        title: label.to_owned(),
        x: Axis::logarithmic("times real time").over(across[0], across[1]),
        y: Axis::logarithmic("greatest change / tolerance").over(SHOWN[0], SHOWN[1]),
        series,
    }
}
