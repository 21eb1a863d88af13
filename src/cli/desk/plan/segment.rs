//! The part of a boot that brings up an EtherCAT segment.

use super::{CONFIGURE, Line, Owner, Place, What};
use crate::desk::segment::SegmentSession;
use crate::ending::rig_failure;
use crate::failure::Failure;
use yieldwall_bus::ethercat::{Acts, StationSetup};
use yieldwall_bus::{BootError, words_to_enable};
use yieldwall_config::{Bus, Rig};
use yieldwall_drives::watchdog::WATCHED_CYCLES;
use yieldwall_fieldbus::ethercat::{AlState, AlStatus};
use yieldwall_fieldbus::objects::Address;
use yieldwall_run::assembly;
use yieldwall_service::{Error, ObjectAccess};

/// The part in which devices get addresses and mailboxes.
pub(super) const PART: &str = "bring_up";

/// Whether `NAME=INTERFACE`, or the one interface of a rig, is for a segment.
pub(super) fn is_one(rig: &Rig, bus: &str) -> bool {
    let named = bus.split_once('=').and_then(|(name, _)| rig.buses.get(name));
    matches!(named.or_else(|| rig.buses.values().next()), Some(Bus::Ethercat(_)))
}

pub(super) const HEADING: &str = "\nAll devices to INIT; addresses and mailboxes, then PRE-OP\n";

/// Returns the lines of a segment, and the obstacle if the boot would not complete.
pub(super) fn lines(rig: &Rig, desk: &mut SegmentSession) -> Result<(Vec<Line>, Result<(), Failure>), Failure> {
    let segment = assembly::segment(rig).map_err(|error| rig_failure(&error.into()))?;
    let bus = segment.bus;
    let owner = |station: &StationSetup| Owner { place: Place::Position(station.position), name: station.name.clone() };
    let set = |part, station: &StationSetup, what: String| Line {
        part,
        bus,
        owner: Some(owner(station)),
        what: What::Set(what),
    };
    let mut lines =
        vec![Line { part: PART, bus, owner: None, what: What::Set("INIT, errors acknowledged".to_owned()) }];
    for station in &segment.stations {
        let address = FIRST_STATION + station.position;
        let what = format!("address {address:04X}h (0010h), mailboxes by its SII, PRE-OP");
        lines.push(set(PART, station, what));
    }
    let mut end = Ok(());
    for station in &segment.stations {
        let (writes, refused) = ask(station, desk)?;
        end = end.and(refused);
        let owner = Some(owner(station));
        lines.extend(writes.into_iter().map(|write| Line {
            part: CONFIGURE,
            bus,
            owner: owner.clone(),
            what: What::Write(write),
        }));
    }
    for station in &segment.stations {
        for what in process_data(station, segment.period) {
            lines.push(set("start", station, what));
        }
    }
    let drives = || segment.stations.iter().filter(|station| station.set_point.is_some());
    let mut old = None;
    for new in words_to_enable() {
        for station in drives() {
            let what = What::Controlword { old, new };
            lines.push(Line { part: "enable", bus, owner: Some(owner(station)), what });
        }
        old = Some(new);
    }
    lines.extend(segment.stations.iter().map(|station| set("leave", station, "PRE-OP".to_owned())));
    Ok((lines, end))
}

/// The station address of the device at position 0.
const FIRST_STATION: u16 = 0x1000;

/// Returns the registers of process data and clock.
fn process_data(station: &StationSetup, period: std::time::Duration) -> Vec<String> {
    let mut all = vec![
        format!("{} bytes of outputs, {} of inputs: SM 2 and 3, FMMUs", station.output_bytes(), station.input_bytes()),
        format!("watchdog {} ms (0420h)", 1e3 * (period * WATCHED_CYCLES).as_secs_f64()),
    ];
    if station.acts != Acts::ByItself {
        let sync1 = station.sync1.map_or(String::new(), |after| format!(", SYNC1 {} us later", after.as_micros()));
        all.push(format!("its clock set; SYNC0 every {} us{sync1}", period.as_micros()));
    }
    all
}

/// Returns the writes of the boot to one device, and whether it does not answer or would be refused.
fn ask(
    station: &StationSetup,
    desk: &mut SegmentSession,
) -> Result<(Vec<yieldwall_bus::PlannedWrite>, Result<(), Failure>), Failure> {
    let device = desk.device(&station.position.to_string())?;
    let position = device.position;
    let (before, _) =
        desk.service.state(position).map_err(|error| desk.failure(&device, "reading its state", error))?;
    let is_in_init = before == AlStatus::new(AlState::Init, false);
    if is_in_init {
        desk.refuse_led()?;
    }
    let mut broken: Option<(Address, Error)> = None;
    let planned = desk.objects(&device).map(|mut objects| {
        station.plan().writes(|at| {
            // A device that does not answer once is not asked again.
            if broken.is_some() {
                return None;
            }
            match objects.read(at) {
                Ok(bytes) => Some(bytes.to_vec()),
                Err(Error::Refused(_)) => None,
                Err(error) => {
                    broken = Some((at, error));
                    None
                }
            }
        })
    });
    if is_in_init {
        // Nobody ends the way back.
        desk.service.end_later();
        let back = desk.service.change_state(position, AlState::Init);
        back.map_err(|error| desk.failure(&device, "bringing it back to INIT", error))?;
    }
    let (writes, refused) = planned?;
    match broken {
        Some((at, error @ (Error::Interrupted | Error::Link(_)))) => {
            return Err(desk.object_failure(&device, &format!("reading {at}"), error));
        }
        Some((at, error)) => {
            return Ok((writes, Err(desk.object_failure(&device, &format!("reading {at}"), error))));
        }
        None => {}
    }
    let refused = refused.map_err(|(step, failure)| {
        let name = format!("{} (position {position})", station.name);
        rig_failure(&BootError { node_id: None, name, step, failure }.into())
    });
    Ok((writes, refused))
}

/// Joins the lines of a segment with those of a CAN bus of the same rig: part by part, the segment first.
pub(super) fn joined(segment: Vec<Line>, can: Vec<Line>) -> Vec<Line> {
    let mut all = [segment, can].concat();
    let parts = [PART, "boot", CONFIGURE, "start", "enable", "leave"];
    all.sort_by_key(|line| parts.iter().position(|part| *part == line.part));
    all
}
