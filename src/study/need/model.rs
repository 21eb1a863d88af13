//! Models of one machine and scene: each combination of the choices that it has.

use serde_json::{Value, json};

use crate::machine::Machine;
use yieldwall_config::{self as config, BusTiming, CommandMode, EncoderModel, ForceSensorModel, Tracking};

/// Steps of the integration that are tried beside that of the scene, us: the longest divisor of the period up to each of these.
const STEPS_US: [u32; 2] = [1000, 100];

/// The mechanics that move the tool, the plainest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Body {
    /// No arm: the tool is where the proxy is.
    Ideal,
    /// The arm with stiff gears.
    Rigid,
    /// The arm with the gears of the scene.
    Elastic,
    /// The point mass of an impedance device.
    Point,
}

/// Choices of a rig alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct OfRig {
    pub(super) timing: BusTiming,
    pub(super) encoder: EncoderModel,
    pub(super) force_sensor: ForceSensorModel,
}

/// One of each choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Model {
    pub(super) body: Body,
    /// Step of the integration in us.
    pub(super) step_us: u32,
    /// Number of the choices that are not the plainest; each finer step counts.
    pub(super) terms: usize,
    /// `None` for an impedance device, which has none of these.
    pub(super) of_rig: Option<OfRig>,
}

/// All models of a machine and scene, from the plainest to the dearest: every term on, at the finest step. Noise and gears are choices
/// where the scene has them. Encoder counts are a choice where the drives close a loop: angles on the bus always have counts.
///
/// Without an arm there is one step, since nothing is integrated. A rig whose file has `timing: ideal` keeps it if `keeps_timing`.
pub(super) fn models(machine: &Machine, scene: &config::Scene, keeps_timing: bool) -> Vec<Model> {
    let own_us = scene.plant_step_us().unwrap_or(STEPS_US[1]);
    let (rig, model) = match (machine, &scene.model) {
        (Machine::Rig(rig), Some(model)) => (rig, model),
        (Machine::Rig(rig), None) => return vec![of_point(rig.cycle.period_us, 0)],
        (Machine::Device(device), _) => {
            let steps = steps(device.cycle.period_us, own_us, STEPS_US[0]);
            return (0..).zip(steps).map(|(terms, step_us)| of_point(step_us, terms)).collect();
        }
    };
    let is_position = rig.rig.command_mode == CommandMode::Position;
    let mut bodies = vec![(Body::Rigid, 1)];
    if is_position && !rig.has_drives_on_ethercat() {
        bodies.insert(0, (Body::Ideal, 0));
    }
    if model.joint_elasticity.is_some() {
        bodies.push((Body::Elastic, 2));
    }
    let simulation = rig.simulation.as_ref();
    // The drives' own loop stops the integration once a period.
    let loop_us = simulation.map_or(STEPS_US[0], |simulation| simulation.drive_position_loop.period_us);
    let most_us = if rig.rig.command_mode == CommandMode::Torque { STEPS_US[0] } else { loop_us.min(STEPS_US[0]) };
    let steps = steps(rig.cycle.period_us, own_us, most_us);
    let timings = match simulation.map(|simulation| simulation.timing) {
        Some(BusTiming::Ideal) if keeps_timing => vec![(BusTiming::Ideal, 0)],
        _ if !rig.is_on_can() => vec![(simulation.map_or(BusTiming::Ideal, |simulation| simulation.timing), 0)],
        _ => vec![(BusTiming::Ideal, 0), (BusTiming::Arbitrated, 1)],
    };
    let encoders = match rig.rig.command_mode {
        CommandMode::Torque => vec![(model.encoder, 0)],
        _ => vec![(EncoderModel::Exact, 0), (EncoderModel::Quantised, 1)],
    };
    let forces = match model.force_noise_counts.get() > 0.0 {
        true => vec![(ForceSensorModel::Quantised, 0), (ForceSensorModel::Noisy, 1)],
        false => vec![(model.force_sensor, 0)],
    };
    let mut models = Vec::new();
    for &(body, of_body) in &bodies {
        let steps = if body == Body::Ideal { &steps[..1] } else { &steps };
        for (of_step, &step_us) in steps.iter().enumerate() {
            for &(timing, of_timing) in &timings {
                for &(encoder, of_encoder) in &encoders {
                    for &(force_sensor, of_force) in &forces {
                        let of_rig = Some(OfRig { timing, encoder, force_sensor });
                        let terms = of_body + of_step + of_timing + of_encoder + of_force;
                        models.push(Model { body, step_us, terms, of_rig });
                    }
                }
            }
        }
    }
    models
}

fn of_point(step_us: u32, terms: usize) -> Model {
    Model { body: Body::Point, step_us, terms, of_rig: None }
}

/// Steps that divide a period, the longest first.
fn steps(period_us: u32, own_us: u32, most_us: u32) -> Vec<u32> {
    let divisor = |most: u32| (1..=most.min(period_us)).rev().find(|step| period_us.is_multiple_of(*step)).unwrap_or(1);
    let mut steps: Vec<u32> = STEPS_US.iter().map(|&step| divisor(step.min(most_us))).chain([own_us]).collect();
    steps.sort_unstable_by(|one, other| other.cmp(one));
    steps.dedup();
    steps
}

impl Model {
    /// Makes machine and scene those of the model.
    pub(super) fn apply(&self, machine: &mut Machine, scene: &mut config::Scene) {
        if let Some(model) = &mut scene.device_model {
            model.plant_step_us = self.step_us;
        }
        let (Machine::Rig(rig), Some(model), Some(choices)) = (machine, &mut scene.model, self.of_rig) else { return };
        rig.simulation.iter_mut().for_each(|simulation| simulation.timing = choices.timing);
        model.tracking = if self.body == Body::Ideal { Tracking::Ideal } else { Tracking::Rigid };
        if self.body != Body::Elastic {
            model.joint_elasticity = None;
        }
        model.plant_step_us = self.step_us;
        model.encoder = choices.encoder;
        model.force_sensor = choices.force_sensor;
    }

    /// The model in words: what moves the tool, the step and the other terms that are on.
    pub(super) fn name(&self) -> String {
        let step = format!("{} ms", 1e-3 * f64::from(self.step_us));
        let body = match self.body {
            Body::Ideal => "no arm".to_owned(),
            Body::Rigid => format!("stiff arm, {step}"),
            Body::Elastic => format!("elastic gears, {step}"),
            Body::Point => format!("point mass, {step}"),
        };
        let Some(OfRig { timing, encoder, force_sensor }) = self.of_rig else { return body };
        let terms = [
            (timing == BusTiming::Arbitrated, "bus timing"),
            (encoder == EncoderModel::Quantised, "counts"),
            (force_sensor == ForceSensorModel::Noisy, "noise"),
        ];
        let of_rig = terms.iter().filter(|(is_on, _)| *is_on).map(|(_, name)| *name);
        std::iter::once(body.as_str()).chain(of_rig).collect::<Vec<_>>().join(", ")
    }

    /// Whether it has each term of another model: no plainer body, no longer step, no term fewer.
    pub(super) fn has_terms_of(&self, other: &Self) -> bool {
        let of_rig = |model: &Self| {
            model.of_rig.map_or([false; 3], |OfRig { timing, encoder, force_sensor }| {
                [
                    timing == BusTiming::Arbitrated,
                    encoder == EncoderModel::Quantised,
                    force_sensor == ForceSensorModel::Noisy,
                ]
            })
        };
        self.body >= other.body
            && self.step_us <= other.step_us
            && of_rig(self).iter().zip(of_rig(other)).all(|(own, other)| *own >= other)
    }

    /// Each choice as it stands in the files: body, step, timing, encoder, force sensor.
    pub(super) fn cells(&self) -> [Value; 5] {
        let body = match self.body {
            Body::Ideal => "ideal",
            Body::Rigid => "rigid",
            Body::Elastic => "elastic",
            Body::Point => "point",
        };
        let [timing, encoder, force] = match self.of_rig {
            Some(OfRig { timing, encoder, force_sensor }) => [json!(timing), json!(encoder), json!(force_sensor)],
            None => [Value::Null, Value::Null, Value::Null],
        };
        [body.into(), self.step_us.into(), timing, encoder, force]
    }
}
