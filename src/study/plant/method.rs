//! The methods that the study compares, behind one face, and a run of a scene by one of them.

use nalgebra::Vector2;
use std::fmt;

use super::contrast::{SemiImplicit, Smooth};
use super::events::Events;
use super::scene::{Aim, CYCLE_S, Plant, Scene};
use yieldwall_motion::quantity::{JointAngles, JointTorques, TipPoint};
use yieldwall_sim::arm::{Arm, ArmError};
use yieldwall_sim::hand::HandLoad;

/// How the equations of motion are integrated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// Euler's semi-implicit step with exact implicit dry friction.
    SemiImplicit,
    /// [`Arm`], the simulation that the program ships: midpoint step with exact implicit dry friction.
    Midpoint,
    /// [`Events`], the reference.
    Events,
    /// Fourth-order Runge-Kutta with dry friction made smooth, `tanh(rate / scale)`.
    Smooth {
        /// Rate at which friction is three quarters of its size.
        scale_rad_per_s: f64,
    },
}

impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SemiImplicit => f.write_str("semi-implicit Euler + gsat"),
            Self::Midpoint => f.write_str("midpoint + gsat"),
            Self::Events => f.write_str("RK4 + events"),
            Self::Smooth { scale_rad_per_s } => write!(f, "RK4 + tanh {scale_rad_per_s} rad/s"),
        }
    }
}

/// The shipped simulation with what pulls at its tool.
#[derive(Clone, Debug)]
struct Shipped<F> {
    arm: Arm,
    load: F,
}

impl<F: Fn(f64, Vector2<f64>) -> HandLoad<2>> Plant for Shipped<F> {
    #[inline]
    fn run_to(&mut self, end_s: f64, step_s: f64, torque_n_m: Vector2<f64>) -> Result<(), ArmError> {
        let load = &self.load;
        self.arm.advance_to(end_s, step_s, JointTorques(torque_n_m), |time_s, tip: TipPoint| load(time_s, tip.0))
    }

    #[inline]
    fn angles(&self) -> Vector2<f64> {
        self.arm.angles().0
    }

    #[inline]
    fn rates(&self) -> Vector2<f64> {
        self.arm.rates().0
    }
}

/// A scene that is ready to run: everything that is not part of the timed stretch is done.
#[derive(Clone, Debug)]
pub struct Run<'a> {
    scene: &'a Scene,
    plan: Vec<Aim>,
    /// Joint angles at the end of each cycle so far, in rad.
    pub angles: Vec<Vector2<f64>>,
}

impl<'a> Run<'a> {
    /// Returns the method for this scene.
    pub fn new(scene: &'a Scene) -> Self {
        Self { scene, plan: scene.plan(), angles: Vec::with_capacity(scene.cycles) }
    }

    /// Runs the first `cycles` of the scene from its start: controller, steps, and a copy of the angles.
    ///
    /// # Errors
    /// Where the method stops; [`Run::angles`] then holds the cycles before.
    pub fn run(&mut self, method: Method, step_s: f64, cycles: usize) -> Result<(), ArmError> {
        let scene = self.scene;
        let load = |time_s: f64, tip: Vector2<f64>| scene.load(time_s, tip);
        let start = scene.start();
        let parameters = || {
            scene.arm.parameters().map_err(|_| {
                let name = "geometry of the study (its links must have lengths)";
                ArmError::BadParameter { name, value: scene.arm.proximal_m }
            })
        };
        match method {
            Method::SemiImplicit => self.drive(SemiImplicit::new(&parameters()?, start, load), step_s, cycles),
            Method::Midpoint => {
                let arm = Arm::new(&parameters()?, JointAngles(start))?;
                self.drive(Shipped { arm, load }, step_s, cycles)
            }
            Method::Events => self.drive(Events::new(scene.arm, start, load), step_s, cycles),
            Method::Smooth { scale_rad_per_s } => {
                self.drive(Smooth::new(&parameters()?, scale_rad_per_s, start, load), step_s, cycles)
            }
        }
    }

    fn drive(&mut self, mut plant: impl Plant, step_s: f64, cycles: usize) -> Result<(), ArmError> {
        self.angles.clear();
        for (cycle, aim) in self.plan.iter().take(cycles).enumerate() {
            let torque_n_m = self.scene.torque(aim, plant.angles(), plant.rates());
            plant.run_to((cycle + 1) as f64 * CYCLE_S, step_s, torque_n_m)?;
            self.angles.push(plant.angles());
        }
        Ok(())
    }

    /// Tool points at the end of each cycle so far, in m.
    pub fn tips(&self) -> Vec<Vector2<f64>> {
        self.angles.iter().map(|&angles| self.scene.arm.motion(angles, Vector2::zeros()).tip).collect()
    }
}
