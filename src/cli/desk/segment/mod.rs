//! The commands of the desk on an EtherCAT segment: on an interface, or on the simulated devices of a rig.

#[cfg(target_os = "linux")]
pub(super) mod doctor;
pub(super) mod emcy;
pub(super) mod info;
pub(super) mod pdo;
pub(super) mod scan;
#[cfg(all(target_os = "linux", feature = "ethercrab"))]
pub(crate) mod second_opinion;
#[cfg(all(target_os = "linux", not(feature = "ethercrab")))]
#[path = "second_opinion/lacking.rs"]
pub(crate) mod second_opinion;
pub(super) mod state;
#[cfg(test)]
mod tests;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use yieldwall_drives::codes::ErrorCodes;
use yieldwall_drives::profiles::{AxisOffset, DeviceProfile};
use yieldwall_drives::scaling::AxisScaling;

use super::place::{BusArguments, object_failure, placed};
use super::scan::DeviceKind;
use crate::ending::rig_failure;
use crate::failure::{Exit, Failure};
use crate::interrupt::on_interrupt;
use crate::output::Output;
use yieldwall_bus::ethercat::{SegmentFailure, SegmentSign};
use yieldwall_config::{self as config, Bus, Loaded, Rig, Source};
use yieldwall_fieldbus::ethercat::{AlState, AlStatus};
use yieldwall_link::EthernetLink;
use yieldwall_rig::live::VirtualSegment;
use yieldwall_run::assembly::scaling;
use yieldwall_run::explanation::{self, Explanation};
use yieldwall_service::{AnySegmentService, DeviceObjects, Error, SegmentError, SegmentService};

/// A rig's entry for a device on its segment.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    pub(super) name: String,
    pub(super) position: u16,
    pub(super) profile: Option<Arc<DeviceProfile>>,
    /// Meanings of its vendor's error codes.
    pub(super) codes: Option<Arc<ErrorCodes>>,
    /// Scaling of the axis; only of a drive.
    pub(super) scaling: Option<AxisScaling>,
}

/// The selected device, and the rig's entry for it.
#[derive(Clone, Debug)]
pub(super) struct Device {
    pub(super) position: u16,
    pub(super) entry: Option<Entry>,
    /// Offset of the objects of the selected axis.
    pub(super) axis: AxisOffset,
}

/// The devices of a segment, and the rig that they may belong to.
pub(super) struct SegmentSession {
    pub(super) service: AnySegmentService,
    pub(super) entries: Vec<Entry>,
    /// Place of the device, as text.
    pub(super) place: String,
    /// Arguments with which another command reaches the same devices, after a space.
    pub(super) arguments: String,
    pub(super) is_simulated: bool,
    /// Sign of another master, if one was heard.
    pub(super) heard: Option<SegmentSign>,
}

/// Mode of opening a place.
#[derive(Clone, Copy, Debug, Default)]
struct Opening {
    /// Whether nothing but a segment is wanted.
    is_for_segments: bool,
    /// Whether frames of another master are no reason not to.
    is_forced: bool,
    /// Whether nothing will be sent.
    is_silent: bool,
}

impl Entry {
    /// Returns its axis of the device; 0 on a device with one axis.
    pub(super) fn axis(&self) -> u8 {
        self.profile.as_ref().and_then(|profile| profile.axis()).unwrap_or_default()
    }
}

impl Device {
    /// Returns a device, for the axis of its entry.
    pub(super) fn of(position: u16, entry: Option<Entry>) -> Self {
        let axis = entry.as_ref().and_then(|entry| Some(entry.profile.as_ref()?.offset())).unwrap_or_default();
        Self { position, entry, axis }
    }

    /// `left (position 0)`.
    pub(super) fn words(&self) -> String {
        match &self.entry {
            Some(entry) => format!("{} (position {})", entry.name, self.position),
            None => format!("the device at position {}", self.position),
        }
    }

    /// Returns name and kind of its entry in the rig.
    pub(super) fn of_rig(&self) -> Option<(&str, Option<DeviceKind<'_>>)> {
        let entry = self.entry.as_ref()?;
        Some((entry.name.as_str(), entry.profile.as_deref().map(DeviceKind::of)))
    }
}

impl SegmentSession {
    /// Returns the devices of a segment, if the place is one: an Ethernet interface, or a rig on EtherCAT.
    pub(super) fn open(place: &BusArguments, output: &mut Output) -> Result<Option<Self>, Failure> {
        Self::taking_over(place, false, output)
    }

    /// Opens the place; with `is_forced`, even if frames of another master are heard.
    pub(super) fn taking_over(
        place: &BusArguments,
        is_forced: bool,
        output: &mut Output,
    ) -> Result<Option<Self>, Failure> {
        Self::at_place(place, Opening { is_forced, ..Opening::default() }, output)
    }

    /// Opens the place for a command that sends nothing, also beside a running master.
    pub(super) fn only_listening(place: &BusArguments, output: &mut Output) -> Result<Option<Self>, Failure> {
        Self::at_place(place, Opening { is_silent: true, ..Opening::default() }, output)
    }

    fn at_place(place: &BusArguments, opening: Opening, output: &mut Output) -> Result<Option<Self>, Failure> {
        let rig = match &place.rig {
            None => None,
            Some(named) => {
                let rig = config::load_rig(Source::named(named))?;
                if !rig.value.is_on_ethercat() {
                    return Ok(None);
                }
                output.names_of(&rig.warnings)?;
                Some(rig)
            }
        };
        let is_over = on_interrupt()?;
        let desk = match (&place.bus, &rig) {
            (Some(bus), rig) => Self::on_interface(bus, rig.as_ref(), opening, is_over)?,
            (None, Some(rig)) => Some(Self::simulated(rig, is_over)?),
            (None, None) => None,
        };
        if let Some(desk) = &desk {
            output.aside(&desk.place);
        }
        Ok(desk.map(|desk| Self { arguments: place.arguments(), ..desk }))
    }

    /// Opens the place for a command on EtherCAT only.
    pub(super) fn only(place: &BusArguments, output: &mut Output) -> Result<Self, Failure> {
        let opening = Opening { is_for_segments: true, ..Opening::default() };
        Self::at_place(place, opening, output)?.ok_or_else(|| {
            let help =
                "name an Ethernet interface with --bus, or a rig with --rig, such as builtin:paper-ethercat.yaml";
            Failure::new(Exit::Usage, "this command is for EtherCAT, and no EtherCAT rig is given", help)
        })
    }

    /// Opens the segment of a rig on an interface without a master, or that of its simulation.
    pub(super) fn of_rig(rig: &Loaded<Rig>, bus: Option<&str>) -> Result<Self, Failure> {
        let is_over = on_interrupt()?;
        let Some(bus) = bus else { return Self::simulated(rig, is_over) };
        let opening = Opening { is_for_segments: true, ..Opening::default() };
        let desk = Self::on_interface(bus, Some(rig), opening, is_over)?;
        let desk =
            desk.ok_or_else(|| Failure::new(Exit::BusUnavailable, format!("{bus} is no Ethernet interface"), ""))?;
        Ok(Self { arguments: format!(" --bus {bus}"), ..desk })
    }

    fn simulated(rig: &Loaded<Rig>, is_over: Arc<AtomicBool>) -> Result<Self, Failure> {
        let scene = rig.scene()?.value;
        let link = VirtualSegment::new(&rig.value, &scene, scene.seed).map_err(|error| rig_failure(&error))?;
        Ok(Self {
            service: SegmentService::new(Box::new(link), is_over),
            entries: entries(&rig.value)?,
            place: format!("simulated devices of {}; those of a segment with --bus INTERFACE", rig.value.rig.name),
            arguments: String::new(),
            is_simulated: true,
            heard: None,
        })
    }

    #[cfg(target_os = "linux")]
    fn on_interface(
        argument: &str,
        rig: Option<&Loaded<Rig>>,
        opening: Opening,
        is_over: Arc<AtomicBool>,
    ) -> Result<Option<Self>, Failure> {
        use yieldwall_bus::SEGMENT_LISTENING;
        use yieldwall_link::{PacketSocket, Role, is_ethernet};

        let (named, interface) = argument.split_once('=').map_or((None, argument), |(name, rest)| (Some(name), rest));
        match (rig, named) {
            (None, _) if !opening.is_for_segments && !is_ethernet(interface) => return Ok(None),
            (Some(rig), Some(name)) if !matches!(rig.value.buses.get(name), Some(Bus::Ethercat(_))) => {
                let names: Vec<&str> = rig.value.buses.keys().map(String::as_str).collect();
                let message = format!("--bus {argument} names no EtherCAT segment of the rig");
                let help = format!("write {}={interface}", names.join(&format!("={interface} or ")));
                return Err(Failure::new(Exit::Usage, message, help));
            }
            (None, Some(name)) => {
                let message = format!("--bus {argument} names the bus {name} of a rig, and no rig is given");
                let help = format!("write --bus {interface}, or name the rig with --rig");
                return Err(Failure::new(Exit::Usage, message, help));
            }
            _ => {}
        }
        let link = match opening.is_silent {
            true => PacketSocket::listening(interface),
            false => PacketSocket::open(interface, Role::Master),
        };
        let link: Box<dyn EthernetLink> =
            Box::new(link.map_err(|error| Failure::new(Exit::BusUnavailable, error.to_string(), ""))?);
        let mut desk = Self {
            service: SegmentService::new(link, is_over),
            entries: rig.map_or(Ok(Vec::new()), |rig| entries(&rig.value))?,
            place: format!("devices on {interface}"),
            arguments: String::new(),
            is_simulated: false,
            heard: None,
        };
        desk.heard = desk.service.listen(SEGMENT_LISTENING).map_err(|error| desk.segment_failure(error))?;
        match desk.heard {
            Some(sign) if !opening.is_forced && !opening.is_silent => Err(desk.other_master(sign)),
            _ => Ok(Some(desk)),
        }
    }

    #[cfg(not(target_os = "linux"))]
    fn on_interface(_: &str, _: Option<&Loaded<Rig>>, _: Opening, _: Arc<AtomicBool>) -> Result<Option<Self>, Failure> {
        Ok(None)
    }

    /// Returns the device for a word: a position, the name of a device in the rig, or `sensor` for the rig's sensor. The device
    /// answers.
    pub(super) fn device(&mut self, word: &str) -> Result<Device, Failure> {
        let by_name = self.entries.iter().find(|entry| entry.name == word);
        let is_sensor = |entry: &&Entry| entry.scaling.is_none();
        let by_role = || (word == "sensor").then(|| self.entries.iter().find(is_sensor))?;
        let device = match (by_name.or_else(by_role), word.parse::<u16>()) {
            (Some(entry), _) => Device::of(entry.position, Some(entry.clone())),
            (None, Ok(position)) => self.at(position),
            (None, Err(_)) => {
                let names: Vec<&str> = self.entries.iter().map(|entry| entry.name.as_str()).collect();
                let help = match config::nearest_word(word, names.iter().copied()) {
                    Some(meant) => format!("did you mean {meant}?"),
                    None if names.is_empty() => {
                        "write a position, 0 for the first device; names are those of a rig, with --rig".to_owned()
                    }
                    None => format!("write a position, 0 for the first device, or one of {}", names.join(", ")),
                };
                let message = format!("{word} is neither a position nor a device of the rig");
                return Err(Failure::new(Exit::Usage, message, help));
            }
        };
        let devices = self.devices()?;
        if device.position >= devices {
            let failure = SegmentFailure::Missing { found: devices, position: device.position };
            let message = format!("{}: {failure}", device.words());
            let help = format!("`yieldwall scan{}` shows who answers", self.arguments);
            return Err(Failure::new(Exit::DeviceMismatch, message, help));
        }
        Ok(device)
    }

    /// Returns the device for a word, or all that answer.
    pub(super) fn devices_of(&mut self, word: Option<&str>) -> Result<Vec<Device>, Failure> {
        match word {
            Some(word) => Ok(vec![self.device(word)?]),
            None => Ok((0..self.devices()?).map(|position| self.at(position)).collect()),
        }
    }

    /// Refuses a segment with a device in a state that only a master maintains.
    pub(super) fn refuse_led(&mut self) -> Result<(), Failure> {
        let devices = self.devices()?;
        match self.service.led(devices).map_err(|error| self.segment_failure(error))? {
            Some(sign) => Err(self.other_master(sign)),
            None => Ok(()),
        }
    }

    /// Opens the mailbox of a device. One in INIT is brought to PRE-OP, where it has one, unless a master has other devices.
    pub(super) fn reach(&mut self, device: &Device, output: &Output) -> Result<(), Failure> {
        let (before, _) =
            self.service.state(device.position).map_err(|error| self.failure(device, "reading its state", error))?;
        let is_in_init = before == AlStatus::new(AlState::Init, false);
        if is_in_init {
            self.refuse_led()?;
        }
        self.objects(device)?;
        if is_in_init && !self.is_simulated {
            output
                .aside(&format!("{} was in INIT: it is in PRE-OP now, where its objects are reached", device.words()));
        }
        Ok(())
    }

    /// Returns the objects of a device.
    pub(super) fn objects(&mut self, device: &Device) -> Result<DeviceObjects<'_, Box<dyn EthernetLink>>, Failure> {
        let (arguments, words) = (self.arguments.clone(), device.words());
        let objects = self.service.objects(device.position);
        objects.map_err(|error| no_objects(&words, device.position, &arguments, &error))
    }

    /// Returns the failure of a request on an object of a device.
    pub(super) fn object_failure(&self, device: &Device, doing: &str, error: Error) -> Failure {
        let message = format!("{}: {doing}: {error}", device.words());
        device_failure(message, error, device.position, &self.arguments)
    }

    /// Returns the meaning of a device's error code, with advice for this place.
    pub(super) fn explained(&self, device: &Device, code: u16) -> Explanation {
        let codes = device.entry.as_ref().and_then(|entry| entry.codes.as_deref());
        placed(explanation::error_code(code, codes), device.position, &self.arguments, None)
    }

    /// Returns the device at a position.
    pub(super) fn at(&self, position: u16) -> Device {
        Device::of(position, self.entries.iter().find(|entry| entry.position == position).cloned())
    }

    /// Names of the rig for a position: of all drives that are axes of the device there.
    pub(super) fn names(&self, position: u16) -> Option<String> {
        let own = self.entries.iter().filter(|entry| entry.position == position);
        let names: Vec<&str> = own.map(|entry| entry.name.as_str()).collect();
        (!names.is_empty()).then(|| names.join(" and "))
    }

    /// Devices that answer.
    pub(super) fn devices(&mut self) -> Result<u16, Failure> {
        self.service.devices().map_err(|error| self.segment_failure(error))
    }

    /// Returns the failure of a request to a device.
    pub(super) fn failure(&self, device: &Device, doing: &str, error: SegmentError) -> Failure {
        state_failure(&device.words(), doing, error)
    }

    /// Returns the failure for an error that no single device caused.
    pub(super) fn segment_failure(&self, error: SegmentError) -> Failure {
        segment_failure(error)
    }

    /// Returns the failure for another master.
    pub(super) fn other_master(&self, sign: SegmentSign) -> Failure {
        other_master(sign, &self.arguments)
    }
}

/// Returns the failure that the objects of a device cannot be reached.
pub(super) fn no_objects(words: &str, position: u16, arguments: &str, error: &SegmentError) -> Failure {
    let help = match error {
        SegmentError::NoMailbox { .. } => {
            format!("`yieldwall state {position} preop{arguments}` acknowledges its error and goes there")
        }
        _ => String::new(),
    };
    Failure::new(Exit::DeviceMismatch, format!("{words}: cannot access its objects: {error}"), help)
}

/// Returns the failure of a request on an object of a device.
pub(super) fn device_failure(message: String, error: Error, position: u16, arguments: &str) -> Failure {
    object_failure(message, error, format!("`yieldwall state {position}{arguments}` shows its state"))
}

/// Returns the failure of a request to a device.
pub(super) fn state_failure(words: &str, doing: &str, error: SegmentError) -> Failure {
    match &error {
        SegmentError::Failed(SegmentFailure::NoReply { .. } | SegmentFailure::CameBack { .. })
        | SegmentError::Link(_)
        | SegmentError::Interrupted => segment_failure(error),
        error => Failure::new(Exit::DeviceMismatch, format!("{words}: {doing}: {error}"), ""),
    }
}

/// Returns the failure of a segment where no single device is to blame.
pub(super) fn segment_failure(error: SegmentError) -> Failure {
    let message = error.to_string();
    match error {
        SegmentError::Interrupted => Failure::new(Exit::Interrupted, message, ""),
        SegmentError::Link(_) => {
            Failure::new(Exit::BusUnavailable, message, "look whether the interface is up: `ip link` shows it")
        }
        SegmentError::Failed(_) | SegmentError::NoMailbox { .. } => Failure::new(Exit::BusUnavailable, message, ""),
    }
}

/// Returns the failure for another master.
pub(super) fn other_master(sign: SegmentSign, arguments: &str) -> Failure {
    let failure = SegmentFailure::OtherMaster { sign, has_written: false };
    let help = match sign {
        SegmentSign::Frame(_) => "end the other master".to_owned(),
        SegmentSign::State { .. } => {
            let way_out = format!("yieldwall state all init --take-over{}", arguments);
            format!(
                "end the other master; if there is none any more, or `yieldwall state` has put the device there, `{way_out}` takes the devices back"
            )
        }
    };
    Failure::new(Exit::BusUnavailable, failure.to_string(), help)
}

/// Returns the devices of a rig on its segment.
fn entries(rig: &Rig) -> Result<Vec<Entry>, Failure> {
    let mut entries = Vec::new();
    for drive in &rig.drives {
        let Some(position) = drive.address.position() else { continue };
        entries.push(Entry {
            name: drive.name.clone(),
            position,
            profile: rig.model(drive),
            codes: drive.profile.error_codes().cloned(),
            scaling: Some(scaling(drive).map_err(|error| rig_failure(&error.into()))?),
        });
    }
    let of_sensor = rig.sensor.protocol.profile();
    entries.extend(rig.sensor.protocol.position().map(|position| Entry {
        name: rig.sensor.name.clone(),
        position,
        profile: of_sensor.and_then(|profile| profile.get().cloned()),
        codes: of_sensor.and_then(|profile| profile.error_codes().cloned()),
        scaling: None,
    }));
    Ok(entries)
}
