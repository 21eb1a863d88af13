//! The table of terms: what each modelled term changes in each shipped scene.
//!
//! A scene need not model a term whose absence changes no output by more than the scene's own tolerance. A figure that depended
//! on such a term would depend on nothing.

use serde_json::Value;
use yieldwall_motion::elementary;

use super::outputs::{Outcome, is_alike};
use super::term::TERMS;
use crate::machine::Machine;
use crate::sweep::{Clock, Row, Sweep, Table};
use yieldwall_config as config;
use yieldwall_rig::report::{Overrides, RunReport};

/// A scene and a machine that plays it; of a figure its fixture and its first hold.
pub(super) struct Case {
    pub(super) machine: &'static str,
    pub(super) scene: &'static str,
    figure: Option<&'static str>,
}

pub(super) const fn case(machine: &'static str, scene: &'static str, figure: Option<&'static str>) -> Case {
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

/// The table of each term and the change that it makes.
pub(super) struct Terms;

impl Case {
    pub(super) fn load(&self) -> Result<(Machine, config::Scene, Overrides), config::Report> {
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

    /// Each case with its whole model, then with each term left out.
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
        let outcome = Outcome::of(&run);
        let mut cells = vec![case.machine.into(), case.scene.into(), name, is_modelled, outcome.end.as_str().into()];
        match &reference {
            Some(reference) => {
                let of_reference = Outcome::of(reference);
                let change = outcome.change_from(&of_reference, &tolerance);
                let way_change_mm = match (reference, &run) {
                    (Ok(reference), Ok(run)) => Some(way_change_mm(reference, run)),
                    _ => None,
                };
                cells.extend([
                    (!is_alike(&outcome, &of_reference, change)).into(),
                    change.map(|change| change.column).into(),
                    change.map(|change| change.change).into(),
                    change.map(|change| change.over_tolerance).into(),
                    way_change_mm.into(),
                ]);
            }
            None => cells.resize(10, Value::Null),
        }
        match outcome.values {
            Some(values) => cells.extend(values.map(Value::from)),
            None => cells.resize(self.columns().len(), Value::Null),
        }
        cells
    }
}

/// Lines about each term of each case.
pub(super) fn notes(table: &Table) -> Vec<String> {
    let mut notes = Vec::new();
    for Case { machine, scene, .. } in &CASES {
        notes.push(format!("{scene} on {machine}"));
        let of_case = |row: &Row<'_>| row.word("machine") == *machine && row.word("scene") == *scene;
        for row in table.rows().filter(|row| of_case(row) && row.is("is_modelled")) {
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
    notes
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
        assert!(Terms.columns().ends_with(&super::super::outputs::columns()));
    }
}
