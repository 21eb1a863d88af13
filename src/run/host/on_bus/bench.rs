//! A rig on the interfaces of this computer that is commissioned.

use crate::commission::Attendant;
use crate::{Bounds, Drilled, DriveIdentity, NotProven, Permit, Place, Proof, Restarts, Runner, Subject};
use yieldwall_config as config;
use yieldwall_motion::quantity::Force;

/// Somebody at the arm of a rig that is commissioned. They are asked while the network is left: nothing is enabled, and nothing has to be
/// in time.
pub trait Person {
    /// Looks where the link of a joint (0 the left one) is.
    fn look(&mut self, joint: usize);

    /// Returns the angle by which that link has turned since, counter-clockwise, in rad; `None` without an earlier look.
    fn turned(&mut self, joint: usize) -> Option<f64>;

    /// Switches the drives off and on again, and returns whether both were. `restarted` returns which drives have restarted. It
    /// hears them only while it is called, a few times a second.
    fn power_cycle(&mut self, restarted: &mut dyn FnMut() -> [bool; 2]) -> bool;

    /// Whether a drive that keeps its own torque limit may be moved with it; `text` names the limit.
    fn accepts_drive_limit(&mut self, text: &str) -> bool;

    /// Lets this force in N, in the base frame, pull at the tool, or removes it if the force is zero. Returns whether the force
    /// pulls.
    fn pull(&mut self, force: Force) -> bool;
}

/// A person, and what shows that the drives stop by themselves.
pub(super) struct OnTheBench<'a> {
    pub(super) person: &'a mut (dyn Person + Send),
    pub(super) proof: Proof,
}

impl Attendant for OnTheBench<'_> {
    fn prove(
        &mut self,
        runner: &mut Runner<dyn Place>,
        rig: &config::Rig,
        bounds: Bounds,
    ) -> Result<Permit, NotProven> {
        runner.prove_for_bring_up(rig, &self.proof, bounds)
    }

    fn keep(
        &mut self,
        rig: &config::Rig,
        drives: [DriveIdentity; 2],
        drilled: &Drilled,
    ) -> Result<Option<String>, String> {
        let Proof::OnRecord(folder) = &self.proof else { return Ok(None) };
        let kept = Subject::new(rig, drives).store(drilled, folder);
        kept.map(|path| Some(path.display().to_string())).map_err(|error| format!("{}: {error}", folder.display()))
    }

    fn look(&mut self, _: &dyn Place, joint: usize) {
        self.person.look(joint);
    }

    fn turned(&mut self, _: &dyn Place, joint: usize) -> Option<f64> {
        self.person.turned(joint)
    }

    fn power_cycle(&mut self, rig: &config::Rig, place: &mut dyn Place) -> bool {
        // A rig that was booted has its buses.
        let Ok(mut restarts) = Restarts::of(rig, place) else { return false };
        self.person.power_cycle(&mut || restarts.look(place))
    }

    fn accepts_drive_limit(&mut self, text: &str) -> bool {
        self.person.accepts_drive_limit(text)
    }

    fn pull(&mut self, _: &mut dyn Place, force: Force) -> bool {
        self.person.pull(force)
    }
}
