//! Virtual masses from the measurements of `tune loop` on a bus.

use std::path::Path;

use serde_json::{Value, json};

use super::{Masses, range_words};
use crate::ending::rig_failure;
use crate::failure::{Exit, Failure};
use yieldwall_config::{Diagnostic, Loaded, Rig, Severity};
use yieldwall_motion::control::Grip;
use yieldwall_rig::analysis::{later_s, stiffer, usual_hands};
use yieldwall_run::MeasuredLoop;
use yieldwall_run::assembly::period_s;

/// Stiffness of a usual hand, N/m: softer ones ask for less.
const USUAL_N_PER_M: f64 = 500.0;

/// Measured values that replace those of the rig file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Measured {
    delay_cycles: f64,
    force_later_s: f64,
}

impl Measured {
    /// In words.
    pub(super) fn words(&self) -> String {
        let Self { delay_cycles, force_later_s } = self;
        let force = if *force_later_s > 0.0 {
            format!(", force up to {:.2} ms older than by the rig file", 1e3 * force_later_s)
        } else {
            String::new()
        };
        format!("`tune loop` has measured on a bus: inertia, delay {delay_cycles:.2} cycles{force}")
    }

    /// Returns the data for a program.
    pub(super) fn to_json(self) -> Value {
        json!({ "delay_cycles": self.delay_cycles, "force_later_s": self.force_later_s })
    }
}

impl Masses {
    /// Computes them as [`Masses::of`] does, from the rig's measurements in a folder; `None` if there are none.
    pub(crate) fn of_recorded(rig: &Loaded<Rig>, stiffnesses: &[f64], folder: &Path) -> Result<Option<Self>, Failure> {
        let loaded = MeasuredLoop::load(&rig.value, folder).map_err(|error| {
            let help = "delete the record, or measure again with `yieldwall tune loop` and --bus";
            Failure::new(Exit::OutOfTolerance, error.to_string(), help)
        })?;
        let Some(recorded) = loaded else { return Ok(None) };
        let force = recorded.force(&rig.value);
        let others = |hand: &Grip| match stiffnesses {
            [] => usual_hands(hand).to_vec(),
            _ => stiffnesses.iter().map(|&stiffness| stiffer(hand, stiffness)).collect(),
        };
        let masses = Self::of_identified(rig, &recorded.joints, force.as_ref(), others);
        let mut masses = masses.map_err(|error| rig_failure(&error))?;
        let force_later_s = force.map_or(Ok(0.0), |force| later_s(&rig.value, &force));
        let delay_s = recorded.joints.iter().map(|joint| joint.delay_s).fold(0.0, f64::max);
        masses.measured = Some(Measured {
            delay_cycles: delay_s / period_s(&rig.value),
            force_later_s: force_later_s.map_err(|error| rig_failure(&error))?,
        });
        Ok(Some(masses))
    }

    /// Returns the finding before a run on a bus, where the operator's hand is unknown: the mass is unstable with the softest usual
    /// hand.
    pub(crate) fn measured_finding(&self, rig: &Loaded<Rig>) -> Option<Diagnostic> {
        let measured = self.measured?;
        let usual = self.holdings.as_ref()?.iter().filter(|holding| holding.grip.stiffness_n_per_m >= USUAL_N_PER_M);
        let holding = usual.min_by(|one, other| one.grip.stiffness_n_per_m.total_cmp(&other.grip.stiffness_n_per_m))?;
        if holding.is_configured_stable {
            return None;
        }
        let message = format!(
            "without friction a virtual mass of {} kg is unstable with a hand of {} N/m (stable: {}); {}",
            self.configured_kg,
            holding.grip.stiffness_n_per_m,
            range_words(holding.masses.as_ref()),
            measured.words()
        );
        let help = "write a mass well within the stable range; `yieldwall tune fixture` prints it for other hands";
        let key = "fixture.coupling.admittance.mass_kg";
        Some(rig.finding(Severity::Warning, key, message, help, &[("sensor", "the force sensor")]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_config::{Coupling, Positive, builtin, load_rig};
    use yieldwall_run::{ForceFound, JointFound};

    #[test]
    fn a_force_that_was_measured_to_be_old_asks_for_more_mass_and_a_light_rig_is_told_so() {
        let folder = std::env::temp_dir().join(format!("yieldwall-measured-masses-{}", std::process::id()));
        let mut rig = load_rig(builtin("paper-admittance.yaml")).unwrap();
        rig.value.fixture.coupling = Coupling::Admittance { mass_kg: Positive::new(0.7).unwrap() };
        assert!(Masses::of_recorded(&rig, &[], &folder).unwrap().is_none(), "nothing was measured");
        let joint = |pose_rad| JointFound { inertia_kg_m2: 0.34, pose_rad, delay_s: 1e-3, viscous_n_m_s_per_rad: 0.5 };
        let joints = [[2.2, 0.69], [2.1, 0.79]].map(joint);
        let mut least_kg = Vec::new();
        for (between_s, is_told) in [([0.0, 1.0e-3], false), ([1.9e-3, 2.1e-3], true), ([9.8e-3, 10.2e-3], true)] {
            let force = ForceFound { between_s, mass_kg: 0.3 };
            MeasuredLoop::new(&rig.value, joints, Some(force)).store(&folder).unwrap();
            let masses = Masses::of_recorded(&rig, &[500.0], &folder).unwrap().unwrap();
            let [_, usual] = masses.holdings.as_deref().unwrap() else { panic!("{:?}", masses.lines()) };
            least_kg.extend(usual.masses.map(|masses| masses.least_kg));
            let finding = masses.measured_finding(&rig);
            assert_eq!(finding.is_some(), is_told, "{between_s:?}: {}", masses.text(2.0));
            let words = format!("{:.2} ms older", 1e3 * between_s[1]);
            assert!(finding.is_none_or(|finding| finding.message.contains(&words)), "{words}");
            assert!(masses.text(2.0).contains("`tune loop` has measured"), "{}", masses.text(2.0));
        }
        assert!(least_kg[1..].iter().all(|kg| *kg > 1.5 * least_kg[0]), "{least_kg:?}");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
