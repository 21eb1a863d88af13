//! A shipped machine, whatever its kind.

use std::ops::ControlFlow;

use yieldwall_config::{self as config, Document, Report, Source};
use yieldwall_rig::RigError;
use yieldwall_rig::report::{Overrides, RunReport, Stage, Watch, run_device, run_rig};

/// An admittance rig or an impedance device.
#[derive(Clone, Debug)]
pub(super) enum Machine {
    Rig(Box<config::Rig>),
    Device(Box<config::ImpedanceDevice>),
}

impl Machine {
    /// Reads a file of either kind.
    ///
    /// # Panics
    /// If the file is neither: only files that name a machine are read.
    pub(super) fn load(source: Source) -> Result<Self, Report> {
        Ok(match config::load(source)? {
            Document::Rig(rig) => Self::Rig(Box::new(rig.value)),
            Document::Device(device) => Self::Device(Box::new(device.value)),
            Document::Scene(_)
            | Document::Figure(_)
            | Document::Profile(_)
            | Document::Simulation(_)
            | Document::ErrorCodes(_) => {
                panic!("a machine is a rig or a device")
            }
        })
    }

    pub(super) fn fixture(&self) -> &config::Fixture {
        match self {
            Self::Rig(rig) => &rig.fixture,
            Self::Device(device) => &device.fixture,
        }
    }

    /// Plays a scene, as [`run_rig`] and [`run_device`].
    pub(super) fn run(
        &self,
        scene: &config::Scene,
        overrides: &Overrides,
        progress: impl FnMut(Stage),
    ) -> Result<RunReport, RigError> {
        match self {
            Self::Rig(rig) => run_rig(rig, scene, overrides, Watch::default(), to_the_end(progress)),
            Self::Device(device) => run_device(device, scene, overrides, |_| {}, to_the_end(progress)),
        }
    }
}

/// Looks on, and never breaks off.
pub(super) fn to_the_end(mut progress: impl FnMut(Stage)) -> impl FnMut(Stage) -> ControlFlow<()> {
    move |stage| {
        progress(stage);
        ControlFlow::Continue(())
    }
}
