//! A simulated user on an impedance device: a light point mass that renders a force from its position. The sampled loop limits
//! the stiffness of its springs.
//!
//! A spring to the way is rendered as `-K d - B d'` from the reported position, without friction. A plastic fixture has the same `K` and `B`
//! in its coupling. So both have one stiffness at the tool, and one limit on it.

use nalgebra::Vector2;

use super::aid::{Aid, Law};
use super::trial::{LET_GO_S, Moment, Trial};
use super::way::vector;
use yieldwall_motion::fixture::{Coupling, Curvature, Fixture, Impedance, Limits, Parameters, Rearm, Shape2, Side};
use yieldwall_motion::setvalued::sat;
use yieldwall_sim::hand::HandLoad;
use yieldwall_sim::point_mass::{PointMass, PointMassParameters};

/// Stiffnesses in N/m, of springs and of the coupling.
pub(super) const STIFFNESSES_N_PER_M: [f64; 7] = [300.0, 1e3, 3e3, 1e4, 3e4, 1e5, 1e6];
/// Yield forces in N; the paper has 3 N.
pub(super) const YIELDS_N: [f64; 3] = [1.5, 3.0, 6.0];
/// Press off the way, in N: above the first two, below the last.
pub(super) const PRESS_N: f64 = 4.0;

/// Device, coupling and friction of the paper's impedance type; mass and damping are those of `paper-impedance.yaml`.
const DEVICE: PointMassParameters =
    PointMassParameters { mass_kg: 0.05, damping_n_s_per_m: 0.5, position_resolution_m: 5.5e-5 };
const PERIOD_S: f64 = 1e-3;
const STEP_S: f64 = 1e-4;
const DAMPING_N_S_PER_M: f64 = 1.5;
const FRICTION_N: f64 = 0.5;
/// A tool that is so far from the origin has been thrown off, in m.
const THROWN_M: f64 = 0.5;

/// The stiffest spring in N/m that this device renders without a swing when nobody holds it: `b + B >= K T/2`.
///
/// # Source
/// J. E. Colgate, G. G. Schenkel, *Passivity of a class of sampled-data systems: application to haptic interfaces* (1997).
pub(super) const STIFFEST_N_PER_M: f64 = 2.0 * (DEVICE.damping_n_s_per_m + DAMPING_N_S_PER_M) / PERIOD_S;

/// Renderer of the force.
enum Renderer {
    Nothing,
    Spring { stiffness_n_per_m: f64, most_n: f64, height_m: Option<f64> },
    Plastic(Box<Fixture<Shape2, 2>>),
}

impl Renderer {
    fn new(trial: &Trial) -> Result<Self, String> {
        let Aid { law, hardness, yield_n } = trial.aid;
        let stiffness_n_per_m = hardness.unwrap_or_default();
        Ok(match law {
            Law::None | Law::Viscous => Self::Nothing,
            Law::Spring => Self::Spring { stiffness_n_per_m, most_n: f64::INFINITY, height_m: None },
            Law::Saturated => {
                Self::Spring { stiffness_n_per_m, most_n: yield_n.unwrap_or(f64::INFINITY), height_m: None }
            }
            Law::Plastic => {
                let coupling =
                    Coupling::Impedance(Impedance { stiffness_n_per_m, damping_n_s_per_m: DAMPING_N_S_PER_M });
                let parameters = Parameters {
                    coupling,
                    limits: Limits { friction_n: FRICTION_N, yield_n: yield_n.unwrap_or_default() },
                    side: Side::Bilateral,
                    hold_steps: 0,
                    rearm: Rearm::OffSurface,
                    curvature: Curvature::Tangent,
                    period_s: PERIOD_S,
                };
                let shape = trial.way.surface().planar().map_err(|error| error.to_string())?.ok_or("a way in space")?;
                let mut fixture = Fixture::new(shape, parameters).map_err(|error| error.to_string())?;
                fixture.reset(&vector(trial.way.start_m())).map_err(|error| error.to_string())?;
                Self::Plastic(Box::new(fixture))
            }
        })
    }

    fn force_n(&mut self, trial: &Trial, reported_m: Vector2<f64>) -> Vector2<f64> {
        let at = [reported_m.x, reported_m.y];
        match self {
            Self::Nothing => Vector2::zeros(),
            Self::Spring { stiffness_n_per_m, most_n, height_m: before } => {
                let height_m = trial.way.height_m(at);
                let rate = (height_m - before.unwrap_or(height_m)) / PERIOD_S;
                *before = Some(height_m);
                let force_n = -*stiffness_n_per_m * height_m - DAMPING_N_S_PER_M * rate;
                vector(trial.way.normal(at)) * sat(nalgebra::Vector1::new(force_n), *most_n).x
            }
            Self::Plastic(fixture) => fixture.step_impedance(&reported_m).force_n,
        }
    }
}

/// How the run ended, and its moments.
pub(super) fn run(trial: &Trial) -> Result<(String, Vec<Moment>), String> {
    let start = vector(trial.way.start_m());
    let mut hand = trial.hand()?;
    let hand_kg = hand.parameters().mass_kg;
    let mut held = PointMass::new(DEVICE, hand_kg, start).map_err(|error| error.to_string())?;
    let mut renderer = Renderer::new(trial)?;
    let mut moments = Vec::new();
    let mut let_go = None;
    for cycle in 0_u32.. {
        let time_s = f64::from(cycle) * PERIOD_S;
        if time_s > trial.let_go_s() + LET_GO_S {
            break;
        }
        // The hand lets go with its mass: what is left is the device, where it is.
        if time_s >= trial.let_go_s() && let_go.is_none() {
            let_go = Some(Released::new(&held)?);
        }
        let end_s = f64::from(cycle + 1) * PERIOD_S;
        let step_s = STEP_S * trial.step_share;
        let device = match &let_go {
            Some(released) => &released.device,
            None => &held,
        };
        let offset_s = let_go.as_ref().map_or(0.0, |released| released.at_s);
        let reported_m = device.reported_position_m();
        let force_n = renderer.force_n(trial, reported_m);
        let (at, velocity) = (device.position_m(), device.velocity_m_per_s());
        moments.push(Moment {
            time_s,
            tool_m: [at.x, at.y],
            velocity_m_per_s: [velocity.x, velocity.y],
            force_n: [force_n.x, force_n.y],
        });
        if at.norm() > THROWN_M {
            return Ok(("thrown off".to_owned(), moments));
        }
        let advanced = match &mut let_go {
            Some(released) => released.device.advance_to(end_s - offset_s, step_s, force_n, |_, _| HandLoad::default()),
            None => held.advance_to(end_s, step_s, force_n, |time, handle| hand.load(time, handle)),
        };
        advanced.map_err(|error| error.to_string())?;
    }
    Ok(("ran".to_owned(), moments))
}

/// The device without a hand, from the moment of release.
struct Released {
    device: PointMass<2>,
    at_s: f64,
}

impl Released {
    /// Returns the device at rest where it was: a hand that lets go after a press does so at rest, except for its tremor.
    fn new(held: &PointMass<2>) -> Result<Self, String> {
        let device = PointMass::new(DEVICE, 0.0, held.position_m()).map_err(|error| error.to_string())?;
        Ok(Self { device, at_s: held.time_s() })
    }
}
