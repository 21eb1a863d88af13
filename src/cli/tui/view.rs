//! Content of the screen, as the thread of the events leaves it.

use std::collections::VecDeque;

use yieldwall_drives::cia402;

use crate::events::Event;
use yieldwall_motion::guard::{JointCommand, State};
use yieldwall_record::CycleRecord;

/// Classes of the histogram: below 1, 2, 4, .. us, and all that is later.
pub(super) const CLASSES: usize = 18;
/// Events that are kept.
const LOG: usize = 200;

/// One axis.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Axis {
    pub(super) name: String,
    pub(super) state: Option<cia402::State>,
    pub(super) position_rad: f64,
    pub(super) target_rad: f64,
    /// Commanded torque in torque mode; otherwise the torque of a simulation, if there is one.
    pub(super) torque_n_m: Option<f64>,
}

/// Full content of the screen.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct View {
    pub(super) rig: String,
    pub(super) place: String,
    pub(super) state: State,
    pub(super) time_s: Option<f64>,
    pub(super) duration_s: f64,
    pub(super) axes: [Axis; 2],
    pub(super) force_n: [f64; 2],
    pub(super) tool_m: [f64; 2],
    pub(super) proxy_m: [f64; 2],
    pub(super) is_on_surface: bool,
    /// Cycles by how late they were.
    pub(super) late: [u64; CLASSES],
    pub(super) worst_us: f64,
    pub(super) log: VecDeque<Event>,
}

impl View {
    /// Returns the view of a rig with drives of these names, at this place and for this duration.
    pub(crate) fn new(rig: &str, drives: [&str; 2], place: &str, duration_s: f64) -> Self {
        let axes = drives.map(|name| Axis { name: name.to_owned(), ..Axis::default() });
        Self { rig: rig.to_owned(), place: place.to_owned(), duration_s, axes, ..Self::default() }
    }

    /// Takes a cycle.
    pub(crate) fn take(&mut self, record: &CycleRecord) {
        let signals = &record.signals;
        self.state = record.directive.state;
        self.time_s = Some(record.moment.scene_time_s).filter(|time_s| time_s.is_finite());
        let torques = match record.command {
            JointCommand::Torque(torques) => Some(torques.to_array()),
            _ => record.truth.map(|truth| truth.torques.to_array()),
        };
        let [measured, target] = [signals.measured_angles, signals.target_angles].map(|angles| angles.to_array());
        for (at, (axis, drive)) in self.axes.iter_mut().zip(&record.inputs.drives).enumerate() {
            axis.state = Some(drive.state);
            (axis.position_rad, axis.target_rad) = (measured[at], target[at]);
            axis.torque_n_m = torques.map(|torques| torques[at]);
        }
        self.force_n = signals.force.to_array();
        (self.tool_m, self.proxy_m) = (signals.tool.to_array(), signals.proxy.to_array());
        self.is_on_surface = signals.is_on_surface;
        let timing = &record.inputs.timing;
        let late_us = f64::from(timing.sync_late_ns.max(timing.compute_late_ns)) * 1e-3;
        self.worst_us = self.worst_us.max(late_us);
        let class = (late_us as u64 + 1).ilog2() as usize;
        self.late[class.min(CLASSES - 1)] += 1;
    }

    /// Takes an event; the log omits the values that every cycle shows.
    pub(crate) fn tell(&mut self, event: &Event) {
        if self.log.len() == LOG {
            self.log.pop_front();
        }
        self.log.push_back(event.clone());
    }
}
