//! The table of models: times real time and change of the outputs of each model of a scene.

use std::sync::{Arc, OnceLock};

use serde_json::Value;

use super::model::Model;
use super::outputs::{Change, Outcome, is_alike};
use super::subject::Subject;
use super::terms::{Case, case};
use crate::sweep::{Clock, Sweep};

/// One scene each in torque mode, in position mode, with elastic gears and with walls that move: arms and buses matter to them
/// in different ways.
pub(super) const SHIPPED: [Case; 4] = [
    case("paper-admittance", "circle-tour", None),
    case("paper-admittance-csp", "circle-tour", None),
    case("paper-admittance", "circle-tour-elastic", None),
    case("moving-walls", "moving-walls", None),
];

/// Names of their panels.
pub(super) const LABELS: [&str; 4] = ["torque mode", "position mode", "gears", "moving walls"];

/// Most runs of a model that are timed. All are timed once before one is timed again, so that a slow spell of the computer
/// meets all.
const ROUNDS: usize = 5;
/// After how many seconds in all that is enough.
const ENOUGH_S: f64 = 1.0;
/// A model counts as equally fast if its fastest run is at most by this share slower than the median run of the fastest model.
pub(super) const ALIKE: f64 = 0.05;

/// All models of some subjects, timed.
pub(super) struct Models {
    own: Option<Arc<Subject>>,
    subjects: OnceLock<Vec<Timed>>,
}

/// A subject, and its models once they are timed.
type Timed = (Arc<Subject>, OnceLock<Vec<Found>>);

/// Facts about one model.
#[derive(Clone, Debug)]
pub(super) struct Found {
    /// Times of the runs in s, the shortest first.
    seconds: Vec<f64>,
    pub(super) outcome: Outcome,
    pub(super) change: Option<Change>,
    /// Whether no output of this model, and of each that has its terms and more, changes by more than its tolerance beside the
    /// dearest model. Where errors of two terms cancel, one of them alone does not.
    pub(super) is_enough: bool,
    /// Whether no other model is both faster and nearer to the dearest.
    pub(super) is_on_front: bool,
    /// Whether it is the proposal: the plainest of the fastest models that are enough.
    pub(super) is_needed: bool,
}

impl Found {
    /// Simulated time over core time, from the boot to the measures: by the median run, the slowest and the fastest. NaN for a
    /// model that does not run.
    pub(super) fn realtime_factors(&self) -> [f64; 3] {
        let last = self.seconds.len().saturating_sub(1);
        [last / 2, last, 0].map(|place| {
            let seconds = self.seconds.get(place).copied().filter(|_| self.outcome.values.is_some());
            seconds.map_or(f64::NAN, |seconds| self.outcome.simulated_s / seconds)
        })
    }

    fn realtime_factor(&self) -> f64 {
        self.realtime_factors()[0]
    }
}

/// Runs and times all models of a subject, and chooses.
pub(super) fn measure(subject: &Subject, clock: Clock<'_>) -> Vec<Found> {
    let mut all: Vec<Found> = Vec::new();
    for _ in 0..ROUNDS {
        for (index, model) in subject.models.iter().enumerate() {
            if all.get(index).is_some_and(|found| found.seconds.iter().sum::<f64>() > ENOUGH_S) {
                continue;
            }
            let before = clock();
            let outcome = subject.run(model);
            let seconds = clock().saturating_sub(before).as_secs_f64();
            match all.get_mut(index) {
                Some(found) => found.seconds.push(seconds),
                None => all.push(Found {
                    seconds: vec![seconds],
                    outcome,
                    change: None,
                    is_enough: false,
                    is_on_front: false,
                    is_needed: false,
                }),
            }
        }
    }
    all.iter_mut().for_each(|found| found.seconds.sort_by(f64::total_cmp));
    if let Some(reference) = all.last().map(|found| found.outcome.clone()) {
        all.iter_mut().for_each(|found| found.change = found.outcome.change_from(&reference, &subject.tolerance));
        let are_alike: Vec<bool> = all.iter().map(|found| is_alike(&found.outcome, &reference, found.change)).collect();
        let alike = || subject.models.iter().zip(&are_alike);
        for (found, model) in all.iter_mut().zip(&subject.models) {
            found.is_enough = alike().all(|(other, is_alike)| *is_alike || !other.has_terms_of(model));
        }
    }
    choose(&subject.models, &mut all);
    all
}

/// Marks the front and the proposal.
fn choose(models: &[Model], all: &mut [Found]) {
    let places: Vec<_> = all.iter().map(|found| (found.realtime_factor(), over(found))).collect();
    for (found, &(speed, change)) in all.iter_mut().zip(&places) {
        let is_better = |&(other_speed, other_change): &(f64, f64)| {
            other_speed >= speed && other_change <= change && (other_speed, other_change) != (speed, change)
        };
        found.is_on_front = speed.is_finite() && change.is_finite() && !places.iter().any(is_better);
    }
    let fastest = all.iter().filter(|found| found.is_enough).map(Found::realtime_factor).fold(0.0, f64::max);
    let by_terms = models.iter().zip(all).filter(|(_, found)| found.is_enough);
    let fast = by_terms.filter(|(_, found)| found.realtime_factors()[2] >= (1.0 - ALIKE) * fastest);
    let plainest = fast.min_by(|(one, one_found), (other, other_found)| {
        let by_speed = other_found.realtime_factor().total_cmp(&one_found.realtime_factor());
        one.terms.cmp(&other.terms).then(by_speed)
    });
    if let Some((_, found)) = plainest {
        found.is_needed = true;
    }
}

/// Greatest change over its tolerance; infinite without one.
fn over(found: &Found) -> f64 {
    found.change.map_or(f64::INFINITY, |change| change.over_tolerance)
}

impl Models {
    /// The table of the shipped scenes, or of one subject.
    pub(super) fn new(own: Option<Arc<Subject>>) -> Self {
        Self { own, subjects: OnceLock::new() }
    }

    fn subjects(&self) -> &[Timed] {
        self.subjects.get_or_init(|| {
            let shipped = |case: &Case| {
                let subject = Subject::shipped(case);
                Arc::new(subject.unwrap_or_else(|report| panic!("a shipped file is refused: {report}")))
            };
            let subjects = match &self.own {
                Some(subject) => vec![subject.clone()],
                None => SHIPPED.iter().map(shipped).collect(),
            };
            subjects.into_iter().map(|subject| (subject, OnceLock::new())).collect()
        })
    }
}

impl Sweep for Models {
    fn name(&self) -> &'static str {
        "models"
    }

    fn columns(&self) -> Vec<&str> {
        vec![
            "machine",
            "scene",
            "model",
            "body",
            "plant_step_us",
            "timing",
            "encoder",
            "force_sensor",
            "terms",
            "outcome",
            "realtime_factor",
            "realtime_factor_least",
            "realtime_factor_most",
            "most_changed",
            "change",
            "change_over_tolerance",
            "is_enough",
            "is_on_front",
            "is_needed",
        ]
    }

    fn points(&self) -> u64 {
        self.subjects().iter().map(|(subject, _)| subject.models.len() as u64).sum()
    }

    fn is_timed(&self) -> bool {
        true
    }

    /// The first point of a subject times all its models: they are to be timed in turn.
    fn point(&self, index: u64, clock: Clock<'_>) -> Vec<Value> {
        let mut place = index as usize;
        let of_point = self.subjects().iter().find(|(subject, _)| match place.checked_sub(subject.models.len()) {
            Some(rest) => {
                place = rest;
                false
            }
            None => true,
        });
        let Some((subject, measured)) = of_point else { return vec![Value::Null; self.columns().len()] };
        let found = &measured.get_or_init(|| measure(subject, clock))[place];
        let model = &subject.models[place];
        let names = [subject.machine_name.as_str(), subject.scene_name.as_str()];
        let mut cells: Vec<Value> = names.map(Value::from).into();
        cells.push(model.name().into());
        cells.extend(model.cells());
        cells.extend([model.terms.into(), found.outcome.end.as_str().into()]);
        cells.extend(found.realtime_factors().map(Value::from));
        cells.extend([
            found.change.map(|change| change.column).into(),
            found.change.map(|change| change.change).into(),
            found.change.map(|change| change.over_tolerance).into(),
            found.is_enough.into(),
            found.is_on_front.into(),
            found.is_needed.into(),
        ]);
        cells
    }
}
