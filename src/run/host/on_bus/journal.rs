//! A rig on a bus that is brought up: its devices get back at the end what they held before.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::{OpenError, RigOnBus};
use crate::assembly::{homing_master, master};
use crate::{Pace, RunError};
use yieldwall_bus::{Master, Written};
use yieldwall_config as config;
use yieldwall_service::OnInterfaces;
use yieldwall_service::journal::{BusInterface, Journal, Journals, Restored};

/// A rig on a bus that is brought up: commissioned, homed, jogged or measured. Its devices get back what they held.
#[derive(Clone, Copy, Debug)]
pub enum BringUp {}

/// Journal of the devices of a rig; none for a rig that runs, and in lockstep, whose devices are simulated.
#[derive(Default)]
pub(super) struct Kept {
    journal: Option<Journal>,
    /// The boot may have written something.
    is_written: bool,
}

impl Kept {
    /// Marks that something may be written from now on.
    pub(super) fn written(self) -> Self {
        let mut kept = self;
        kept.is_written = true;
        kept
    }

    /// Gives the devices back what they held.
    pub(super) fn restore(&mut self) -> Restored {
        self.journal.take().map(|journal| journal.restore(&mut OnInterfaces)).unwrap_or_default()
    }
}

/// After a panic of the caller the devices get back what they held, and what remains shows in the journal that stays open.
impl Drop for Kept {
    fn drop(&mut self) {
        if self.is_written {
            self.restore();
        } else if let Some(journal) = self.journal.take() {
            journal.discard();
        }
    }
}

impl RigOnBus<BringUp> {
    /// Opens a rig that is brought up: reads all objects that a boot writes, of homing too, keeps their values in a journal, and takes the
    /// interfaces. On EtherCAT the devices are in PRE-OP then; nothing else is sent. `is_interrupted` ends the reading.
    ///
    /// The journal goes once the devices have got their values back, or with this rig if nothing was done with it. In lockstep there is
    /// none, since all devices are simulated.
    ///
    /// ```no_run
    /// use std::sync::{Arc, atomic::AtomicBool};
    /// use yieldwall_config as config;
    /// use yieldwall_run::{Pace, host::{Evidence, RigOnBus, Terms}};
    /// use yieldwall_service::journal::Journals;
    ///
    /// # fn sense(now_unix_s: u64) -> Result<(), Box<dyn std::error::Error>> {
    /// let rig = config::load_rig(config::Source::named("rig.yaml"))?.value;
    /// let journals = Journals { folder: Some("journals".into()), command: "sense".into(), now_unix_s };
    /// let is_interrupted = Arc::new(AtomicBool::new(false));
    /// let on_bus = RigOnBus::open_for_bring_up(&rig, &["can0".to_owned()], Pace::Free, &journals, &is_interrupted)?;
    /// let evidence = Evidence::OnRecord { drills: "drills".into(), latency: "latency".into(), now_unix_s };
    /// let terms = Terms { evidence, needs_realtime: false, ignores_latency: true, ignores_bus_budget: false };
    /// let outcome = on_bus.sense(&terms, [2.0, 0.5], &is_interrupted, |news| println!("{news:?}"))?;
    /// println!("{:?}", outcome.played?.mean());
    /// outcome.restored.end?;
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// As [`RigOnBus::open`], and if a device does not answer or the journal cannot be written.
    pub fn open_for_bring_up(
        rig: &config::Rig,
        interfaces: &[String],
        pace: Pace,
        journals: &Journals,
        is_interrupted: &Arc<AtomicBool>,
    ) -> Result<Self, OpenError> {
        journals.refuse_left(interfaces)?;
        let mut kept = Kept::default();
        if pace == Pace::Free {
            let of_buses = rig.buses.values().zip(interfaces);
            let interfaces: Vec<BusInterface> = of_buses
                .map(|(bus, name)| BusInterface {
                    name: name.clone(),
                    is_on_ethercat: matches!(bus, config::Bus::Ethercat(_)),
                })
                .collect();
            let written = written(&masters(rig)?);
            kept.journal = Some(journals.begin(&written, &interfaces, &mut OnInterfaces, is_interrupted)?);
        }
        Self::opened(rig, interfaces, pace, kept)
    }
}

/// Returns the masters that may boot a rig.
fn masters(rig: &config::Rig) -> Result<Vec<Master>, RunError> {
    // A rig without homing has no master for it, and is never homed.
    Ok([master(rig, &rig.fixture)?].into_iter().chain(homing_master(rig)).collect())
}

/// Returns the objects that the boots of these masters write, each once.
fn written(masters: &[Master]) -> Vec<Written> {
    let mut all: Vec<Written> = Vec::new();
    for one in masters.iter().flat_map(|master| master.networks().written()) {
        match all.iter_mut().find(|known| (known.bus, known.number) == (one.bus, one.number)) {
            Some(known) => one.objects.into_iter().for_each(|object| {
                if !known.objects.contains(&object) {
                    known.objects.push(object);
                }
            }),
            None => all.push(one),
        }
    }
    all
}
