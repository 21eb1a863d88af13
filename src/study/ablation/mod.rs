//! What each modelled term changes in each shipped scene.
//!
//! A term whose absence changes no output of a scene by more than the scene's own tolerance is one that the scene need not
//! model: a figure that hung on it would hang on nothing.

pub(super) mod page;
mod term;

use serde_json::Value;
use yieldwall_motion::elementary;

use self::term::TERMS;
use super::machine::{Machine, outcome};
use super::sweep::{Clock, Report, Study, Sweep, Table};
use yieldwall_config::{self as config, SceneTolerance};
use yieldwall_rig::report::measures::Measures;
use yieldwall_rig::report::{Overrides, RunReport};

/// A scene and a machine that plays it; of a figure its fixture and its first hold.
struct Case {
    machine: &'static str,
    scene: &'static str,
    figure: Option<&'static str>,
}

const fn case(machine: &'static str, scene: &'static str, figure: Option<&'static str>) -> Case {
    Case { machine, scene, figure }
}

const CASES: [Case; 13] = [
    case("paper-admittance", "circle-tour", None),
    case("paper-admittance-csp", "circle-tour", None),
    case("paper-admittance", "circle-hold", None),
    case("paper-admittance", "circle-tour-elastic", None),
    case("paper-admittance", "circle-wall", Some("fig12")),
    case("paper-admittance", "line-push", Some("fig15")),
    case("curve-guide", "curve-tour", None),
    case("moving-walls", "moving-walls", None),
    case("room", "room-walk", None),
    case("paper-impedance", "cylinder-tour", None),
    case("paper-impedance", "cylinder-wall", Some("fig9")),
    case("paper-impedance", "plane-push", Some("fig14")),
    case("play", "push-and-let-go", None),
];

/// The study `ablation`.
pub(super) struct Ablation([Box<dyn Sweep>; 1]);

impl Ablation {
    pub(super) fn new() -> Self {
        Self([Box::new(Terms)])
    }
}

struct Terms;

/// An output of a scene.
struct Output {
    column: &'static str,
    of: fn(&Measures) -> Option<f64>,
    tolerance: fn(&SceneTolerance) -> f64,
}

const OUTPUTS: [Output; 9] = [
    // Whether a proxy that comes to rest on the surface touches it once or twice is no output.
    Output { column: "impacts", of: |m| Some(m.impacts.len() as f64), tolerance: |_| f64::INFINITY },
    Output { column: "unintended_releases", of: |m| Some(f64::from(m.unintended_releases)), tolerance: |_| 0.5 },
    Output { column: "penetration_mm", of: |m| Some(m.penetration_mm), tolerance: |t| *t.distance_mm },
    Output { column: "tool_depth_mm", of: tool_depth_mm, tolerance: |t| *t.distance_mm },
    Output { column: "tool_rms_on_surface_mm", of: |m| m.tool_rms_on_surface_mm, tolerance: |t| *t.distance_mm },
    Output { column: "tool_max_on_surface_mm", of: |m| m.tool_max_on_surface_mm, tolerance: |t| *t.distance_mm },
    Output { column: "peak_force_on_surface_n", of: |m| m.peak_force_on_surface_n, tolerance: |t| *t.force_n },
    Output { column: "peak_torque_n_m", of: |m| m.peak_torque_n_m, tolerance: |t| *t.torque_n_m },
    Output { column: "energy_given_mj", of: |m| Some(1e3 * m.energy_given_j), tolerance: |t| *t.energy_mj },
];

fn tool_depth_mm(measures: &Measures) -> Option<f64> {
    measures.impacts.iter().map(|impact| impact.tool_depth_mm).max_by(f64::total_cmp)
}

impl Case {
    fn load(&self) -> Result<(Machine, config::Scene, Overrides), config::Report> {
        let machine = Machine::load(config::builtin(format!("{}.yaml", self.machine)))?;
        let scene = config::load_scene(config::builtin(format!("scenes/{}.yaml", self.scene)))?.value;
        let fixture = match self.figure {
            None => None,
            Some(name) => {
                let figure = config::load_figure(config::builtin(format!("figures/{name}.yaml")))?.value;
                let mut fixture = figure.fixture.unwrap_or_else(|| machine.fixture().clone());
                fixture.hold_steps = figure.hold_steps.first().copied().unwrap_or(fixture.hold_steps);
                Some(fixture)
            }
        };
        Ok((machine, scene, Overrides { fixture, ..Overrides::default() }))
    }
}

/// Greatest distance between the tools of two runs at the same time, in mm.
fn way_change_mm(one: &RunReport, other: &RunReport) -> f64 {
    let pairs = one.trace.rows.iter().zip(&other.trace.rows);
    pairs.map(|(a, b)| 1e3 * (0..3).map(|i| a.tool_m[i] - b.tool_m[i]).fold(0.0, elementary::hypot)).fold(0.0, f64::max)
}

impl Sweep for Terms {
    fn name(&self) -> &'static str {
        "terms"
    }

    fn columns(&self) -> Vec<&str> {
        vec![
            "machine",
            "scene",
            "term",
            "is_modelled",
            "outcome",
            "has_effect",
            "most_changed",
            "change",
            "change_over_tolerance",
            "way_change_mm",
            "impacts",
            "unintended_releases",
            "penetration_mm",
            "tool_depth_mm",
            "tool_rms_on_surface_mm",
            "tool_max_on_surface_mm",
            "peak_force_on_surface_n",
            "peak_torque_n_m",
            "energy_given_mj",
        ]
    }

    /// Of each case the whole model, then each term left out.
    fn points(&self) -> u64 {
        (CASES.len() * (1 + TERMS.len())) as u64
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let (case, place) = (&CASES[index as usize / (1 + TERMS.len())], index as usize % (1 + TERMS.len()));
        let (mut machine, mut scene, overrides) =
            case.load().unwrap_or_else(|report| panic!("a shipped file is refused: {report}"));
        let Some(tolerance) = scene.tolerance else { panic!("{} states no tolerance", case.scene) };
        let whole = |machine: &Machine, scene: &config::Scene| machine.run(scene, &overrides, |_| {});
        let [mut name, mut is_modelled] = [Value::from("none left out"), Value::Null];
        let mut reference = None;
        if let Some(term) = place.checked_sub(1).map(|place| TERMS[place]) {
            name = term.name().into();
            let full = (machine.clone(), scene.clone());
            let removed = term.remove(&mut machine, &mut scene);
            is_modelled = removed.into();
            if !removed {
                let mut cells = vec![case.machine.into(), case.scene.into(), name, is_modelled];
                cells.resize(self.columns().len(), Value::Null);
                return cells;
            }
            reference = Some(whole(&full.0, &full.1));
        }
        let run = whole(&machine, &scene);
        let mut cells = vec![case.machine.into(), case.scene.into(), name, is_modelled, outcome(&run).into()];
        match (&reference, &run) {
            (Some(Ok(reference)), Ok(run)) => {
                let change = |output: &Output| {
                    let change = match ((output.of)(&reference.measures), (output.of)(&run.measures)) {
                        (Some(with), Some(without)) => without - with,
                        (None, None) => 0.0,
                        _ => f64::INFINITY,
                    };
                    (output.column, change, (change / (output.tolerance)(&tolerance)).abs())
                };
                let most = OUTPUTS.iter().map(change).max_by(|a, b| a.2.total_cmp(&b.2)).unwrap_or(("", 0.0, 0.0));
                let ends_alike = outcome(&Ok(reference.clone())) == outcome(&Ok(run.clone()));
                cells.extend([
                    (most.2 > 1.0 || !ends_alike).into(),
                    most.0.into(),
                    most.1.into(),
                    most.2.into(),
                    way_change_mm(reference, run).into(),
                ]);
            }
            (Some(_), _) => cells.extend([true.into(), Value::Null, Value::Null, Value::Null, Value::Null]),
            (None, _) => cells.resize(10, Value::Null),
        }
        match &run {
            Ok(run) => cells.extend(OUTPUTS.iter().map(|output| Value::from((output.of)(&run.measures)))),
            Err(_) => cells.resize(self.columns().len(), Value::Null),
        }
        cells
    }
}

impl Study for Ablation {
    fn name(&self) -> &'static str {
        "ablation"
    }

    fn about(&self) -> &'static str {
        "what each modelled term changes in each shipped scene, and which terms a scene could do without"
    }

    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.0
    }

    fn report(&self, tables: &[Table]) -> Report {
        let mut notes = Vec::new();
        for Case { machine, scene, .. } in &CASES {
            notes.push(format!("{scene} on {machine}"));
            let rows = tables.iter().flat_map(Table::rows);
            for row in rows.filter(|row| row.word("machine") == *machine && row.word("scene") == *scene) {
                if !row.is("is_modelled") {
                    continue;
                }
                let verdict = if row.is("has_effect") { "" } else { "no effect: " };
                let end = match row.word("outcome") {
                    "ran" => String::new(),
                    outcome => format!("; {outcome}"),
                };
                let change = match (row.number("change"), row.number("change_over_tolerance")) {
                    (change, share) if change.is_finite() => format!("by {change:+.3}, {share:.1} of the tolerance"),
                    _ => "appears or vanishes".to_owned(),
                };
                let (term, output) = (row.word("term"), row.word("most_changed"));
                notes.push(format!("  without {term:18} {verdict}{output} {change}{end}"));
            }
        }
        Report { notes, charts: Vec::new() }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn every_shipped_scene_is_played_and_states_its_tolerance() {
        for name in config::builtin_names().filter_map(|name| name.strip_prefix("scenes/")) {
            let scene = name.trim_end_matches(".yaml");
            assert!(CASES.iter().any(|case| case.scene == scene), "{scene}");
            let loaded = config::load_scene(config::builtin(format!("scenes/{name}"))).unwrap();
            assert!(loaded.value.tolerance.is_some(), "{scene}");
        }
        for case in &CASES {
            case.load().unwrap();
        }
    }

    #[test]
    fn what_is_not_modelled_is_not_run_and_what_is_changes_something() {
        let push = CASES.iter().position(|case| case.scene == "plane-push").unwrap() * (1 + TERMS.len());
        let cells = |place: usize| {
            let mut table = Table::new(&Terms);
            table.insert(0, Terms.point((push + place) as u64, &|| Duration::ZERO));
            table.rows().next().unwrap().json()
        };
        let place = |name: &str| 1 + TERMS.iter().position(|term| term.name() == name).unwrap();
        assert_eq!(cells(0)["outcome"], "ran");
        assert_eq!(cells(place("encoder counts"))["is_modelled"], false);
        let bare = cells(place("hand mass"));
        assert_eq!(bare["has_effect"], true, "{bare}");
        assert!(bare["way_change_mm"].as_f64().unwrap() > 0.0);
    }

    #[test]
    fn columns_name_the_outputs_in_their_order() {
        let outputs: Vec<_> = OUTPUTS.iter().map(|output| output.column).collect();
        assert!(Terms.columns().ends_with(&outputs));
    }
}
