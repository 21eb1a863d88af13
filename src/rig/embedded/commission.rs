//! A simulated rig that is commissioned, with a person at the arm who sees the truth.

use std::sync::atomic::AtomicBool;

use super::EmbeddedRig;
use super::boot::bring_up;
use crate::error::RigError;
use yieldwall_config as config;
use yieldwall_motion::quantity::{Force, JointAngles};
use yieldwall_run::bringup;
use yieldwall_run::commission::{Attendant, Begin, Commissioned, StepReport};
use yieldwall_run::{Bounds, Drilled, DriveIdentity, NotProven, Permit, Place, Runner, Task};

/// A person at a simulated arm.
#[derive(Default)]
struct Onlooker {
    /// Positions of the links at the last look.
    seen: JointAngles,
}

impl Attendant for Onlooker {
    fn prove(
        &mut self,
        runner: &mut Runner<dyn Place>,
        rig: &config::Rig,
        bounds: Bounds,
    ) -> Result<Permit, NotProven> {
        bring_up(runner, rig, bounds)
    }

    fn keep(&mut self, _: &config::Rig, _: [DriveIdentity; 2], _: &Drilled) -> Result<Option<String>, String> {
        // What is simulated proves nothing of a rig on a bus.
        Ok(None)
    }

    fn look(&mut self, place: &dyn Place, _: usize) {
        self.seen = place.seen_angles().unwrap_or_default();
    }

    fn turned(&mut self, place: &dyn Place, joint: usize) -> Option<f64> {
        (place.seen_angles()? - self.seen).to_array().get(joint).copied()
    }

    fn power_cycle(&mut self, _: &config::Rig, place: &mut dyn Place) -> bool {
        place.power_cycle()
    }

    fn accepts_drive_limit(&mut self, _: &str) -> bool {
        // Nothing real moves.
        true
    }

    fn pull(&mut self, place: &mut dyn Place, force: Force) -> bool {
        place.attend(Task::Pull(force))
    }
}

impl EmbeddedRig {
    /// Switches everything on and takes the steps of a commissioning, as
    /// [`bringup::commission`](fn@bringup::commission). No hand takes the tool.
    ///
    /// # Errors
    /// [`RigError::Boot`] if a node is missing or is not what it should be, and if the simulated arm cannot go on.
    pub fn commission(
        &mut self,
        rig: &config::Rig,
        begin: Begin,
        is_interrupted: &AtomicBool,
        told: impl FnMut(&StepReport),
    ) -> Result<Commissioned, RigError> {
        self.boot()?;
        // Injections count their time from here.
        self.take_tool();
        self.place_mut().far.world.let_go();
        let commissioned =
            bringup::commission(&mut self.runner, rig, begin, &mut Onlooker::default(), is_interrupted, told);
        self.go_on()?;
        Ok(commissioned)
    }
}
