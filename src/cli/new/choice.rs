//! Choices for a new rig: flags, answers, and defaults for the rest.

use std::io::{BufRead, Write};
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use yieldwall_drives::profiles::{DeviceProfile, EncoderKind, Fieldbus};

use super::Arguments;
use crate::confirm::answer;
use crate::failure::{Exit, Failure};
use crate::fit;
use yieldwall_config::{ProfileName, Source, load_profile, nearest_word};

/// Node id of this program.
pub(super) const OWN_NODE: u8 = 127;
/// Longest cycle in torque mode, us: drives have to stop within 10 ms when set-points stay away, and watch for five cycles.
const LONGEST_IN_TORQUE_US: u32 = 2000;

/// Command mode of the drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Mode {
    /// Torque (CST): the control loop closes in this program
    Torque,
    /// Velocity (CSV): the velocity loop closes in the drives
    Velocity,
    /// Position (CSP): the position loop closes in the drives
    Position,
}

/// Control law of torque mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Law {
    /// Proxy-based sliding mode control
    Psmc,
    /// PID
    Pid,
}

/// The bus of the devices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum BusKind {
    /// CAN of 1 Mbit/s
    Can,
    /// EtherCAT segment: left drive, right drive and force sensor, in this order from the computer
    Ethercat,
}

/// Protocol of the force sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Protocol {
    /// CANopen: a node that answers SYNC
    Canopen,
    /// Plain CAN: the sensor sends by its own clock, as the Robotous RFT series does
    Streaming,
    /// Plain CAN: the master polls the sensor in every cycle, as with the ATI Net F/T
    Polled,
    /// EtherCAT, selected by `--bus`
    #[value(skip)]
    Ethercat,
}

/// Profiles that are files: as the rig writes them, and where they are.
type ProfileFiles = Vec<(String, PathBuf)>;

/// All that is chosen.
#[derive(Clone, Debug)]
pub(super) struct Choice {
    pub(super) mode: Mode,
    pub(super) law: Law,
    pub(super) period_us: u32,
    pub(super) sensor: Protocol,
    /// Profiles of the left and of the right drive, as the rig writes them.
    pub(super) profiles: [String; 2],
    /// Profiles that are files: as the rig writes them, and their paths.
    pub(super) profile_files: ProfileFiles,
    pub(super) encoder: Option<EncoderKind>,
    /// Node ids of the left and of the right drive and of the sensor.
    pub(super) nodes: [u8; 3],
    /// Lengths of the proximal and of the distal links, m.
    pub(super) links_m: [f64; 2],
    /// Distance of the base joints, m.
    pub(super) base_m: f64,
}

pub(super) fn parse_length(text: &str) -> Result<f64, String> {
    let length = text.trim().parse().ok().filter(|length| (0.05..=2.0).contains(length));
    length.ok_or_else(|| "a length from 0.05 to 2 m".to_owned())
}

pub(super) fn parse_period(text: &str) -> Result<u32, &'static str> {
    text.parse().ok().filter(|period| (500..=10_000).contains(period)).ok_or("write 500 to 10000")
}

pub(super) fn parse_encoder(text: &str) -> Result<EncoderKind, String> {
    match text {
        "multi_turn" => Ok(EncoderKind::MultiTurn),
        "single_turn" => Ok(EncoderKind::SingleTurn),
        _ => Err("multi_turn or single_turn; other encoders lose their zero at a reset".to_owned()),
    }
}

/// Takes the values of the flags, asks a person for the rest if there is one, and checks that they fit together.
pub(super) fn ask(arguments: &Arguments, person: Option<Person<'_>>) -> Result<Choice, Failure> {
    let mut asking = Asking { person };
    let mode = asking.word("command mode of the drives", arguments.mode, Mode::Torque)?;
    let law = match mode {
        Mode::Torque => asking.word("control law", arguments.law, Law::Psmc)?,
        _ if arguments.law.is_some() => {
            let message = "--law is for torque mode; in the other modes the drives have their own control laws";
            return Err(Failure::new(Exit::Usage, message, "omit --law, or write --mode torque"));
        }
        _ => Law::Psmc,
    };
    let longest_us = if mode == Mode::Torque { LONGEST_IN_TORQUE_US } else { 10_000 };
    let period_us = asking.value(
        &format!("cycle time in us, 500 to {longest_us}"),
        arguments.period_us,
        1000,
        ToString::to_string,
        |text| {
            let number = text.parse().ok().filter(|number| (500..=longest_us).contains(number));
            number.ok_or_else(|| format!("a whole number from 500 to {longest_us}"))
        },
    )?;
    if period_us > longest_us {
        let message = format!(
            "--period-us {period_us}: in torque mode drives have to stop within 10 ms after the master fails, and their watchdogs take five cycles"
        );
        return Err(Failure::new(Exit::Usage, message, format!("write {longest_us} or less, or another --mode")));
    }
    let bus = asking.word("bus of the devices", arguments.bus, BusKind::Can)?;
    let sensor = match bus {
        BusKind::Can => asking.word("protocol of the force sensor", arguments.sensor, Protocol::Canopen)?,
        BusKind::Ethercat => Protocol::Ethercat,
    };
    if bus == BusKind::Ethercat && arguments.sensor.is_some() {
        let message = "drives and force sensor of a new rig are on the same kind of bus";
        let help = "omit --sensor, or edit the file; docs/configuration.md shows a rig on two buses";
        return Err(Failure::new(Exit::Usage, message, help));
    }
    let given = Some(arguments.drives.clone()).filter(|drives| !drives.is_empty());
    let fieldbus = if bus == BusKind::Ethercat { Fieldbus::Ethercat } else { Fieldbus::Canopen };
    let fits = |profile: &DeviceProfile| profile.servo().is_some() && profile.is_for(fieldbus);
    let names: Vec<&str> = ProfileName::shipped().filter(|(_, profile)| fits(profile)).map(|(name, _)| name).collect();
    let question = format!("profile of the drives, a file or one of {}", names.join(", "));
    let usual = vec!["simulated-servo".to_owned()];
    let drives = asking.value(
        &question,
        given,
        usual,
        |drives| drives.join(","),
        |text| {
            let drives: Vec<String> = text.split(',').map(|one| one.trim().to_owned()).collect();
            if drives.len() > 2 {
                return Err("one profile, or two, separated by a comma".to_owned());
            }
            drives.iter().try_for_each(|name| known_profile(name, &names, fieldbus))?;
            Ok(drives)
        },
    )?;
    if drives.len() > 2 {
        let message = format!("--drives {}: there are two drives", drives.join(","));
        let help = "write one profile for both drives, or two, separated by a comma, such as \
                    --drives simulated-servo,simulated-servo";
        return Err(Failure::new(Exit::Usage, message, help));
    }
    for name in &drives {
        known_profile(name, &names, fieldbus)
            .map_err(|message| Failure::new(Exit::Usage, format!("--drives: {message}"), ""))?;
    }
    let (profiles, profile_files) = profiles(&drives, &arguments.rig)?;
    let count = if sensor == Protocol::Canopen { 3 } else { 2 };
    if bus == BusKind::Ethercat && !arguments.nodes.is_empty() {
        let message = "--nodes: devices on EtherCAT have positions, not node ids";
        return Err(Failure::new(Exit::Usage, message, "omit --nodes; the positions follow the cable"));
    }
    let given = Some(arguments.nodes.clone()).filter(|nodes| !nodes.is_empty());
    // A segment does not have this property, so there is no question about it.
    let given = given.or_else(|| (bus == BusKind::Ethercat).then(|| vec![1, 2]));
    let usual = [1, 2, 10];
    let question =
        if count == 3 { "node ids of left drive, right drive, sensor" } else { "node ids of left and right drive" };
    let shown = |nodes: &Vec<u8>| nodes.iter().map(ToString::to_string).collect::<Vec<_>>().join(",");
    let nodes = asking.value(question, given, usual.into_iter().take(count).collect(), shown, |text| {
        let nodes: Option<Vec<u8>> = text.split(',').map(|one| one.trim().parse().ok()).collect();
        let nodes = nodes.filter(|nodes| nodes.len() == count && nodes.iter().all(|id| (1..OWN_NODE).contains(id)));
        let nodes = nodes.ok_or_else(|| format!("{count} numbers from 1 to 126, separated by commas"))?;
        if are_different(&nodes) { Ok(nodes) } else { Err("each device needs its own node id".to_owned()) }
    })?;
    if !are_different(&nodes) {
        let message = format!("--nodes {}: a node id occurs twice", shown(&nodes));
        return Err(Failure::new(Exit::Usage, message, "write a different id for each device, such as --nodes 1,2,10"));
    }
    let nodes = match *nodes.as_slice() {
        [left, right] if sensor != Protocol::Canopen => [left, right, 0],
        // The sensor's is not given: the usual one, or the next that is free.
        [left, right] => [left, right, (10..OWN_NODE).find(|id| *id != left && *id != right).unwrap_or(10)],
        [left, right, id] if sensor == Protocol::Canopen => [left, right, id],
        [_, _, _] => {
            let message =
                format!("--nodes {}: the third id is not needed; a sensor on plain CAN has no node id", shown(&nodes));
            return Err(Failure::new(Exit::Usage, message, "write two ids, such as --nodes 1,2, or --sensor canopen"));
        }
        _ => {
            let message = format!("--nodes {}: write one id for each device", shown(&nodes));
            return Err(Failure::new(
                Exit::Usage,
                message,
                "write the ids of both drives and of a CANopen sensor, such as --nodes 1,2,10",
            ));
        }
    };
    let given = Some(arguments.links.clone()).filter(|links| !links.is_empty());
    let shown = |links: &Vec<f64>| links.iter().map(ToString::to_string).collect::<Vec<_>>().join(",");
    let links =
        asking.value("lengths of the proximal and of the distal links in m", given, vec![0.3, 0.4], shown, |text| {
            let links: Result<Vec<f64>, String> = text.split(',').map(parse_length).collect();
            links.and_then(|links| {
                if links.len() == 2 { Ok(links) } else { Err("two lengths, separated by a comma".to_owned()) }
            })
        })?;
    if links.len() != 2 {
        let message = format!("--links {}: write one length for each kind of link", shown(&links));
        return Err(Failure::new(
            Exit::Usage,
            message,
            "write the lengths of the proximal and of the distal links in m, such as --links 0.3,0.4",
        ));
    }
    let links_m = [links.first().copied().unwrap_or(0.3), links.get(1).copied().unwrap_or(0.4)];
    let base_m = arguments.base.unwrap_or(links_m[0] * 2.0 / 3.0);
    let encoder = arguments.encoder;
    Ok(Choice { mode, law, period_us, sensor, profiles, profile_files, encoder, nodes, links_m, base_m })
}

fn are_different(nodes: &[u8]) -> bool {
    nodes.iter().enumerate().all(|(at, id)| !nodes.iter().skip(at + 1).any(|other| other == id))
}

fn is_file(name: &str) -> bool {
    name.ends_with(".yaml") || name.ends_with(".yml")
}

/// Checks that a name is that of a drive profile for a bus. `names` are the shipped ones.
fn known_profile(name: &str, names: &[&str], bus: Fieldbus) -> Result<(), String> {
    if is_file(name) {
        let profile = load_profile(Source::disk(name));
        let profile =
            profile.map_err(|report| report.diagnostics.first().map_or(String::new(), ToString::to_string))?;
        return if profile.value.servo().is_some() {
            Ok(())
        } else {
            Err(format!("{name} is not a profile of a drive"))
        };
    }
    if names.contains(&name) {
        return Ok(());
    }
    let mut shipped = ProfileName::shipped().filter(|(shipped, profile)| *shipped == name && profile.servo().is_some());
    if let Some((_, profile)) = shipped.next() {
        let own = profile.profile.buses.first().map_or("", |bus| bus.name());
        return Err(format!("{name} is a profile for {own}; the profiles for {} are {}", bus.name(), names.join(", ")));
    }
    Err(match nearest_word(name, names.iter().copied()) {
        Some(meant) => format!("there is no profile {name}; did you mean {meant}?"),
        None => format!("there is no profile {name}; write one of {}, or a file that ends in .yaml", names.join(", ")),
    })
}

/// Profiles as the rig writes them, and where files are: as they are named where the rig lies in this folder, or from the root.
fn profiles(drives: &[String], rig: &Path) -> Result<([String; 2], ProfileFiles), Failure> {
    let lies_here = rig.parent().is_none_or(|folder| folder.as_os_str().is_empty());
    let mut files = Vec::new();
    let mut written = |name: &String| {
        if !is_file(name) {
            return Ok(name.clone());
        }
        let path = PathBuf::from(name);
        // A way up and down again is by the folders of the disk.
        let is_plain = path.is_relative() && !path.components().any(|part| part == std::path::Component::ParentDir);
        let written = if lies_here && is_plain {
            path.clone()
        } else {
            path.canonicalize()
                .map_err(|error| Failure::new(Exit::Usage, format!("{name}: {error}"), "name an existing profile"))?
        };
        let Some(text) = written.to_str().map(str::to_owned) else {
            return Err(Failure::new(Exit::Usage, format!("{name} is not UTF-8 text"), "rename the file"));
        };
        files.push((text.clone(), path));
        Ok(text)
    };
    let left = written(drives.first().unwrap_or(&String::new()))?;
    let right = match drives.get(1) {
        Some(name) => written(name)?,
        None => left.clone(),
    };
    Ok(([left, right], files))
}

/// The person to ask: the source of the answers, and the output for the questions.
pub(super) struct Person<'a> {
    pub(super) answers: &'a mut dyn BufRead,
    pub(super) questions: &'a mut dyn Write,
    /// Columns of the output for the questions.
    pub(super) columns: usize,
}

/// The person to ask, if there is one.
struct Asking<'a> {
    person: Option<Person<'a>>,
}

impl Asking<'_> {
    /// Asks for a word out of several.
    fn word<T: ValueEnum>(&mut self, question: &str, given: Option<T>, usual: T) -> Result<T, Failure> {
        let name = |word: &T| word.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default();
        let all: Vec<String> = T::value_variants().iter().map(name).collect();
        let question = format!("{question}: {}", all.join(", "));
        self.value(&question, given, usual, name, |text| {
            T::from_str(text, true).map_err(|_| format!("write one of {}", all.join(", ")))
        })
    }

    /// Returns a value: given, answered, or the default.
    fn value<T>(
        &mut self,
        question: &str,
        given: Option<T>,
        usual: T,
        shown: impl Fn(&T) -> String,
        parse: impl Fn(&str) -> Result<T, String>,
    ) -> Result<T, Failure> {
        if let Some(given) = given {
            return Ok(given);
        }
        let Some(Person { answers, questions, columns }) = &mut self.person else { return Ok(usual) };
        let question = fit::fitted(&format!("{question} [{}]", shown(&usual)), *columns);
        loop {
            let answer = answer(answers, questions, &question).ok_or_else(|| {
                Failure::new(Exit::Usage, "nothing written: no answer on standard input", "add flags and --yes")
            })?;
            if answer.is_empty() {
                return Ok(usual);
            }
            match parse(&answer) {
                Ok(value) => return Ok(value),
                // Asked once more below it.
                Err(wanted) => {
                    let _ = writeln!(questions, "{}", fit::fitted(&format!("  {wanted}"), *columns));
                }
            }
        }
    }
}
