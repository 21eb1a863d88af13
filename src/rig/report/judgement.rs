//! Judgement of a run: did it end as it should?

use super::RunReport;
use yieldwall_config as config;
use yieldwall_config::injection::{Injection, Lasts};
use yieldwall_motion::guard::{Fault, State};

/// Share of a run for which faults that were not injected may hold the rig, and for which a joint may be at its torque limit
/// other than after impacts.
const HELD_SHARE: f64 = 0.01;

/// Reason why a run did not end as it should.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shortcoming {
    /// A fault stopped the rig, or its process died.
    Stopped,
    /// The end came while this fault held the rig at rest, which no injection brings.
    EndedHeld(Fault),
    /// Faults that no injection brings held the rig at rest for more than 1 % of the run.
    HeldLong {
        /// The fault that held it longest.
        fault: Fault,
        /// Time of all such faults in s.
        held_s: f64,
    },
    /// The run ended before this injection began: nothing was tried.
    NeverCame(Injection),
    /// A joint was at its torque limit for more than 1 % of the run, though nothing stopped the arm hard: the loop swings.
    AtLimit {
        /// Time at the limit in s.
        at_limit_s: f64,
    },
    /// The hand got more energy than a fixture that stores none can give.
    AboveBound,
}

impl RunReport {
    /// Returns the first reason why a run of `scene` did not end as it should. `injected` are the injections beyond those of the
    /// scene, which have to begin. Torque limits and energy count only in a run without injections: a push by injection is no fault
    /// of the loop.
    pub fn shortcoming(&self, scene: &config::Scene, injected: &[Injection]) -> Option<Shortcoming> {
        if self.is_stopped() {
            return Some(Shortcoming::Stopped);
        }
        let of_scene = scene.faults.iter().filter_map(|fault| fault.injection().ok());
        let all: Vec<Injection> = of_scene.chain(injected.iter().copied()).collect();
        let held = self.held(&all).or_else(|| self.never_came(injected));
        if held.is_some() || !all.is_empty() {
            return held;
        }
        self.at_limit().or((!self.measures.is_within_bound()).then_some(Shortcoming::AboveBound))
    }

    /// Faults that held the rig for long, or in the end, which nothing that was injected brings.
    fn held(&self, injected: &[Injection]) -> Option<Shortcoming> {
        let is_own =
            |fault: Fault| injected.iter().all(|injection| !injection.kind.row().expected.faults.contains(&fault));
        let at_end = self.cause.filter(|cause| self.state == Some(State::Holding) && is_own(cause.fault));
        let own = self.held_by.iter().copied().filter(|(fault, _)| is_own(*fault));
        let held_s: f64 = own.clone().map(|(_, held_s)| held_s).sum();
        let longest = own.max_by(|one, other| one.1.total_cmp(&other.1)).map(|(fault, _)| fault);
        let is_long = held_s > HELD_SHARE * self.simulated_s();
        let long = longest.filter(|_| is_long).map(|fault| Shortcoming::HeldLong { fault, held_s });
        at_end.map(|cause| Shortcoming::EndedHeld(cause.fault)).or(long)
    }

    fn never_came(&self, injected: &[Injection]) -> Option<Shortcoming> {
        let is_late = |injection: &&Injection| {
            injection.kind.row().lasts != Lasts::FromBoot && injection.start_s >= self.simulated_s()
        };
        injected.iter().find(is_late).copied().map(Shortcoming::NeverCame)
    }

    fn at_limit(&self) -> Option<Shortcoming> {
        let at_limit_s = self.measures.torque_limit_apart_s.unwrap_or_default();
        (at_limit_s > HELD_SHARE * self.simulated_s()).then_some(Shortcoming::AtLimit { at_limit_s })
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::*;
    use crate::report::{Overrides, Watch, run_rig};
    use yieldwall_config::injection::Kind;
    use yieldwall_motion::guard::{Cause, DeviceSet};

    #[test]
    fn a_run_that_ends_while_it_is_held_is_none_that_is_well_unless_that_was_injected() {
        let loaded = config::load_rig(config::builtin("paper-admittance.yaml")).unwrap();
        let (scene, overrides) =
            (loaded.scene().unwrap().value, Overrides { duration_s: Some(0.1), ..Overrides::default() });
        let whole = |_| ControlFlow::Continue(());
        let mut report = run_rig(&loaded.value, &scene, &overrides, Watch::default(), whole).unwrap();
        assert_eq!(report.shortcoming(&scene, &[]), None);
        report.cause = Some(Cause { fault: Fault::ForceStep, devices: DeviceSet::SENSOR });
        assert_eq!(report.shortcoming(&scene, &[]), None, "it was held before");
        report.state = Some(State::Holding);
        assert_eq!(report.shortcoming(&scene, &[]), Some(Shortcoming::EndedHeld(Fault::ForceStep)));
        let injected = Injection::new(Kind::SensorJump, 0.0);
        assert_eq!(report.shortcoming(&scene, &[injected]), None);
        let late = Injection::new(Kind::SensorJump, 1.0);
        assert_eq!(report.shortcoming(&scene, &[late]), Some(Shortcoming::NeverCame(late)));
        report.held_by = vec![(Fault::ForceStep, 0.05), (Fault::SensorStale, 0.01)];
        report.state = Some(State::Running);
        let long = Shortcoming::HeldLong { fault: Fault::ForceStep, held_s: 0.060_000_000_000_000_005 };
        assert_eq!(report.shortcoming(&scene, &[]), Some(long));
    }
}
