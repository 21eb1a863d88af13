//! The table of models: times real time and change of the outputs of each model of a scene.

use std::sync::{Arc, OnceLock};

use serde_json::Value;

use super::model::Model;
use super::outputs::{Change, Outcome, RAN, is_alike};
use super::subject::Subject;
use super::terms::{Case, case};
use crate::sweep::{Clock, Sweep, median};

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

/// Runs of each model: one for each of so many hands, which differ in their seed. All models run with a hand before the next one comes, so
/// that a slow spell of the computer meets all.
pub(super) const ROUNDS: u64 = 5;
/// A model counts as equally fast if it is slower than the fastest by at most this share: the median over the rounds.
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
    /// Simulated time over core time of each round, from the boot to the measures. NaN where the model does not run.
    factors: Vec<f64>,
    /// Outcome with the hand that changes the outputs most.
    pub(super) outcome: Outcome,
    pub(super) change: Option<Change>,
    /// Whether no output of this model, and of each that has its terms and more, changes by more than its tolerance beside the
    /// dearest model, with any hand. Where errors of two terms cancel, one of them alone does not.
    pub(super) is_enough: bool,
    /// Whether no other model is both faster and nearer to the dearest.
    pub(super) is_on_front: bool,
    /// Whether it is the proposal: the plainest of the fastest models that are enough.
    pub(super) is_needed: bool,
}

impl Found {
    /// Simulated time over core time: the median, the least and the greatest.
    pub(super) fn realtime_factors(&self) -> [f64; 3] {
        let ends =
            self.factors.iter().fold([f64::NAN; 2], |[least, most], &factor| [least.min(factor), most.max(factor)]);
        [self.realtime_factor(), ends[0], ends[1]]
    }

    fn realtime_factor(&self) -> f64 {
        median(self.factors.iter().copied()).unwrap_or(f64::NAN)
    }

    /// Its speed over that of another model, round by round.
    fn beside(&self, other: &Self) -> f64 {
        median(self.factors.iter().zip(&other.factors).map(|(own, other)| own / other)).unwrap_or(0.0)
    }
}

/// Runs and times all models of a subject, and chooses.
pub(super) fn measure(subject: &Subject, clock: Clock<'_>) -> Vec<Found> {
    // By rounds, then by models.
    let mut factors = Vec::new();
    let mut outcomes = Vec::new();
    for round in 0..ROUNDS {
        for model in &subject.models {
            let before = clock();
            let outcome = subject.run(model, round);
            let seconds = clock().saturating_sub(before).as_secs_f64();
            factors.push(if outcome.values.is_some() { outcome.simulated_s / seconds } else { f64::NAN });
            outcomes.push(outcome);
        }
    }
    let count = subject.models.len();
    let rounds = || outcomes.chunks(count).filter_map(|round| Some((round, round.last()?)));
    // Beside a run that a fault stopped, a change means nothing.
    let has_reference = rounds().all(|(_, reference)| reference.end == RAN);
    let mut are_alike = Vec::new();
    let mut all: Vec<Found> = Vec::new();
    for place in 0..count {
        let changes = rounds().map(|(round, reference)| {
            let outcome = &round[place];
            let change = outcome.change_from(reference, &subject.tolerance);
            (is_alike(outcome, reference, change), change, outcome)
        });
        let most = changes.max_by(|(is_one, one, _), (is_other, other, _)| {
            is_other.cmp(is_one).then(over(*one).total_cmp(&over(*other)))
        });
        let Some((is_alike, change, outcome)) = most else { continue };
        are_alike.push(is_alike);
        all.push(Found {
            factors: factors.iter().skip(place).step_by(count).copied().collect(),
            outcome: outcome.clone(),
            change,
            is_enough: false,
            is_on_front: false,
            is_needed: false,
        });
    }
    let alike = || subject.models.iter().zip(&are_alike);
    for (found, model) in all.iter_mut().zip(&subject.models) {
        found.is_enough = has_reference && alike().all(|(other, is_alike)| *is_alike || !other.has_terms_of(model));
    }
    choose(&subject.models, &mut all);
    all
}

/// Marks the front and the proposal.
fn choose(models: &[Model], all: &mut [Found]) {
    let places: Vec<_> = all.iter().map(|found| (found.realtime_factor(), over(found.change))).collect();
    for (found, &(speed, change)) in all.iter_mut().zip(&places) {
        let is_better = |&(other_speed, other_change): &(f64, f64)| {
            other_speed >= speed && other_change <= change && (other_speed, other_change) != (speed, change)
        };
        found.is_on_front = speed.is_finite() && change.is_finite() && !places.iter().any(is_better);
    }
    let speed = |found: &Found| found.realtime_factor();
    let enough = || all.iter().zip(models).filter(|(found, _)| found.is_enough);
    let Some((fastest, _)) = enough().max_by(|(one, _), (other, _)| speed(one).total_cmp(&speed(other))) else {
        return;
    };
    let fast = enough().filter(|(found, _)| found.beside(fastest) >= 1.0 - ALIKE);
    let plainest = fast.min_by(|(one, one_model), (other, other_model)| {
        one_model.terms.cmp(&other_model.terms).then(speed(other).total_cmp(&speed(one)))
    });
    let needed = plainest.map(|(_, model)| *model);
    for (found, model) in all.iter_mut().zip(models) {
        found.is_needed = Some(*model) == needed;
    }
}

/// A change over its tolerance; infinite for a model that does not run.
fn over(change: Option<Change>) -> f64 {
    change.map_or(f64::INFINITY, |change| change.over_tolerance)
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
