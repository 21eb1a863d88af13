//! `yieldwall state` on EtherCAT: the AL state of devices, and the way to INIT, PRE-OP or SAFE-OP.

use serde_json::{Value, json};

use super::{Device, SegmentSession};
use crate::explain;
use crate::failure::Failure;
use crate::output::Output;
use yieldwall_fieldbus::ethercat::{AlState, AlStatus, AlStatusCode};
use yieldwall_run::explanation;

/// Target state of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(in crate::desk) enum Target {
    /// Go to INIT: only registers work. Acknowledges the device's error
    Init,
    /// Go to PRE-OP: objects can be read and written, process data stop
    Preop,
    /// Go to SAFE-OP: inputs are exchanged, outputs are ignored
    Safeop,
    /// Acknowledge the device's error, and keep its state
    Ack,
}

impl Target {
    fn state(self) -> Option<AlState> {
        match self {
            Self::Init => Some(AlState::Init),
            Self::Preop => Some(AlState::PreOperational),
            Self::Safeop => Some(AlState::SafeOperational),
            Self::Ack => None,
        }
    }

    fn words(self) -> String {
        self.state().map_or_else(|| "acknowledging its error".to_owned(), |state| format!("asking for {state}"))
    }
}

/// Result of a state change of a device.
pub(super) struct StateChange {
    pub(super) device: Device,
    pub(super) before: AlStatus,
    pub(super) now: AlStatus,
    pub(super) code: AlStatusCode,
}

pub(in crate::desk) fn run(
    word: &str,
    target: Option<Target>,
    (is_forced, is_dry): (bool, bool),
    mut desk: SegmentSession,
    output: &mut Output,
) -> Result<(), Failure> {
    let devices = match word {
        "all" => (0..desk.devices()?).map(|position| desk.at(position)).collect(),
        word => vec![desk.device(word)?],
    };
    if target.is_some() && !is_forced {
        desk.refuse_led()?;
    }
    let (mut seen, mut end) = (Vec::new(), Ok(()));
    for device in devices {
        let (one, ended) = change(&mut desk, device, target.filter(|_| !is_dry))?;
        seen.push(one);
        end = end.and(ended);
    }
    let asked = target.filter(|_| is_dry).map(|target| format!("would go on by {}", target.words()));
    if output.is_json() {
        let devices: Vec<Value> = seen.iter().map(document).collect();
        return output.end(json!({ "place": desk.place, "dry_run": is_dry, "devices": devices }), end);
    }
    output.result(&text(&seen, asked.as_deref()))?;
    end
}

/// Requests a state from a device, if one is given. Returns its states, and the reason if it did not reach the state. An obstacle
/// that keeps all devices from answering is a failure at once.
pub(super) fn change(
    desk: &mut SegmentSession,
    device: Device,
    target: Option<Target>,
) -> Result<(StateChange, Result<(), Failure>), Failure> {
    let position = device.position;
    let (before, _) =
        desk.service.state(position).map_err(|error| desk.failure(&device, "reading its state", error))?;
    let asked = match target {
        None => Ok(before),
        Some(target) => match target.state() {
            Some(state) => desk.service.change_state(position, state),
            None => desk.service.acknowledge(position),
        },
    };
    let doing = target.map(Target::words).unwrap_or_default();
    let end = asked.map(|_| ()).map_err(|error| desk.failure(&device, &doing, error));
    let (now, code) =
        desk.service.state(position).map_err(|error| desk.failure(&device, "reading its state", error))?;
    Ok((StateChange { device, before, now, code }, end))
}

pub(super) fn text(seen: &[StateChange], more: Option<&str>) -> String {
    let mut text = String::new();
    for StateChange { device, before, now, code } in seen {
        text.push_str(&format!("{}\n", device.words()));
        let state = if before == now { now.to_string() } else { format!("{before} -> {now}") };
        text.push_str(&explain::line(0, "state", &state));
        if *code != AlStatusCode::NONE {
            text.push_str(&explain::line(0, "code", &format!("{:04X}h {}", code.0, code.meaning())));
            if let Some(explanation) = explanation::al_status(*code) {
                text.push_str(&explain::lines(0, &explanation));
            }
        }
        more.into_iter().for_each(|more| text.push_str(&format!("{more}\n")));
    }
    text
}

fn document(seen: &StateChange) -> Value {
    json!({
        "position": seen.device.position,
        "rig_entry": seen.device.entry.as_ref().map(|entry| entry.name.clone()),
        "before": seen.before.to_string(),
        "state": seen.now.to_string(),
        "al_status_code": seen.code.0,
        "explained": explanation::al_status(seen.code).map(|explanation| explain::document(&explanation)),
    })
}
