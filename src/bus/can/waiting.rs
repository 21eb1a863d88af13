//! The step for which the boot waits, for display.

use std::fmt;
use std::time::Duration;

use super::CanNetwork;
use crate::error::named;
use crate::phase::Phase;
use yieldwall_fieldbus::time::Time;

/// The step for which the boot waits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Waiting<'a> {
    /// Node id; `None` for a sensor on plain CAN.
    pub node_id: Option<u8>,
    /// The node's name in the configuration.
    pub name: &'a str,
    /// Step that the device must do.
    pub step: &'static str,
    /// Since when the network is reset, configured or started.
    pub waited: Duration,
    /// How long it is still waited for.
    pub left: Duration,
}

/// `node 1 (left): wait for the boot-up message, for 3.9 s at most`.
impl fmt::Display for Waiting<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = named(self.node_id, self.name);
        write!(out, "{name}: {}, for {:.1} s at most", self.step, self.left.as_secs_f64())
    }
}

impl CanNetwork {
    /// Returns the step for which the boot waits; of several devices the device whose time ends first. `None` when no boot is
    /// under way.
    pub(super) fn awaited(&self, now: Time) -> Option<Waiting<'_>> {
        let nodes = self.nodes.iter().filter_map(|node| {
            let (step, until) = match self.phase {
                Phase::Configuring if !node.boot.is_done() => (node.boot.doing(), node.boot_deadline()),
                _ => node.owes(&self.phase).map(|(step, wait)| (step, self.phase_since + wait))?,
            };
            Some((Some(node.id.raw()), node.name.as_str(), step, until))
        });
        let sensor = self.owes_samples();
        let sensor = sensor.map(|(step, wait)| (None, self.sensor_name.as_str(), step, self.phase_since + wait));
        let (node_id, name, step, until) = nodes.chain(sensor).min_by_key(|(_, _, _, until)| *until)?;
        Some(Waiting { node_id, name, step, waited: now.since(self.phase_since), left: until.since(now) })
    }
}
