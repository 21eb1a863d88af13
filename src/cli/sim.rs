//! `yieldwall sim`: simulated devices on a real bus.

mod segment;

use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use serde_json::json;

use super::commission::add_defects;
use super::ending::rig_failure;
use super::failure::{Exit, Failure};
use super::faults::FaultArgument;
use super::interfaces::Interfaces;
use super::interrupt::on_interrupt;
use super::on_bus::{link_failure, open_failure};
use super::output::Output;
use super::pace::PaceArgument;
use super::page::{Page, PageOf, ViewArgument};
use yieldwall_bus::{MasterSetup, SensorLink, Signs};
use yieldwall_config::{self as config, Source};
use yieldwall_drives::cia402;
use yieldwall_drives::watchdog::Watchdog;
use yieldwall_fieldbus::canopen::{BusId, Frame};
use yieldwall_link::{CanLink, CobFilter, Role, SocketCan, SocketCanSettings};
use yieldwall_motion::guard::DeviceSet;
use yieldwall_rig::live::{AttachError, Attached, Entrance, ServeError, attach, serve};
use yieldwall_rig::{DeviceServer, simulated_drive, simulated_force_sensor};
use yieldwall_run::assembly::{bus_id, bus_plan};
use yieldwall_run::host::open_buses;
use yieldwall_service::listen;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Rig file; `builtin:paper-admittance.yaml` is the copy in the program
    #[arg(value_name = "RIG.yaml")]
    rig: String,
    /// Interface of the bus; for a rig with several buses once for each, as NAME=INTERFACE
    #[arg(long, value_name = "INTERFACE", required = true)]
    bus: Vec<String>,
    /// Clock of the simulated time, as with `run`
    #[arg(long, value_enum, default_value_t = PaceArgument::Free)]
    pace: PaceArgument,
    /// Seed of tremor and sensor noise; default: the scene's seed
    #[arg(long, value_name = "N", value_parser = super::usage::whole::<u64>, allow_negative_numbers = true)]
    seed: Option<u64>,
    /// EtherCAT: inject a fault, TIME seconds after the start; repeatable. `yieldwall faults` lists names
    #[arg(long, value_name = "NAME@TIME[+DURATION][:TARGET]")]
    fault: Vec<FaultArgument>,
    /// Scene; default: the rig's scene
    #[arg(long, value_name = "SCENE.yaml")]
    scene: Option<String>,
    /// Devices of this process, by name or EtherCAT position; default: all devices of the rig
    #[arg(long, value_delimiter = ',', value_name = "NAME,..")]
    nodes: Vec<String>,
    /// Inject a defect into the machine, for `commission` to find; repeatable
    ///
    /// `yieldwall commission --defect list` lists names.
    #[arg(long, value_name = "NAME[=SIZE][:left|right]", conflicts_with = "attach")]
    defect: Vec<String>,
    /// Simulate a tool that nobody holds, as while `jog` moves joints
    #[arg(long, conflicts_with = "attach")]
    no_hand: bool,
    /// Create a socket at this path, through which other processes attach the missing devices
    #[arg(long, value_name = "SOCKET")]
    plant: Option<PathBuf>,
    /// Attach the one device of this process to the arm of the process that created this socket
    #[arg(long, value_name = "SOCKET", requires = "nodes", conflicts_with_all = ["plant", "pace", "seed", "view"])]
    attach: Option<PathBuf>,
    #[command(flatten)]
    page: ViewArgument,
    /// Disable this watchdog in the simulated drives, so that `drill` fails; repeatable
    #[arg(long, value_enum, value_name = "WHAT")]
    unwatched: Vec<Unwatched>,
    /// Milliseconds from a drive's reset or power-on to its boot-up message
    #[arg(long, value_name = "MS", value_parser = clap::value_parser!(u64).range(..=60_000))]
    reset_ms: Option<u64>,
    /// Milliseconds until a drive answers an SDO request
    #[arg(long, value_name = "MS", value_parser = clap::value_parser!(u64).range(..=60_000))]
    sdo_ms: Option<u64>,
}

/// Signal that a drive does not watch.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Unwatched {
    /// SYNC
    Sync,
    /// The set-points
    SetPoints,
    /// The master's heartbeat
    Heartbeat,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let rig = config::load_rig(Source::named(&arguments.rig))?;
    output.configuration(&rig.warnings)?;
    let mut scene = match &arguments.scene {
        Some(path) => config::load_scene(Source::named(path))?,
        None => rig.scene()?,
    };
    let rig = rig.value;
    add_defects(&mut scene.value, &rig, &arguments.defect)?;
    let seed = arguments.seed.unwrap_or(scene.value.seed);
    if rig.is_on_ethercat() {
        return segment::run(arguments, &rig, &scene.value, seed, output);
    }
    if let Some(fault) = arguments.fault.first() {
        let message = format!("--fault {}: sim breaks things on EtherCAT, and this rig is on CAN", fault.name());
        return Err(Failure::new(Exit::Usage, message, "break it on the embedded simulation: `yieldwall run --fault`"));
    }
    let here = chosen(arguments, &rig)?;
    if let Some(path) = &arguments.attach {
        return attach_one(arguments, path, here, &rig, &scene.value, output);
    }
    let server = DeviceServer::new(&rig, &scene.value, seed, arguments.pace.pace());
    let mut server = server.map_err(|error| rig_failure(&error))?.only(here);
    if arguments.no_hand {
        server.take_hand_away();
    }
    arguments.unwatched.iter().for_each(|unwatched| server.ignore(unwatched.watchdog()));
    server.set_reset_time(milliseconds(arguments.reset_ms));
    server.set_sdo_time(milliseconds(arguments.sdo_ms));
    let is_interrupted = on_interrupt()?;
    let interfaces = Interfaces::of(&rig, &arguments.bus)?;
    let own = Own::new(&rig, here)?;
    let everything = |_| (vec![CobFilter::EVERYTHING], Vec::new());
    let link = open_buses(&rig, interfaces.names(), |bus| own.roles(bus), everything);
    let mut link = link.map_err(|error| open_failure(&error))?;
    own.listen(&mut link, &is_interrupted, |frame| *frame)?;
    let mut page = Page::default();
    page.open(&arguments.page, &rig, PageOf { command: "sim", pace: arguments.pace.into() })?;
    let entrance = match &arguments.plant {
        Some(path) => Some(Entrance::open(path, arguments.pace.pace()).map_err(|error| no_socket(path, &error))?),
        None => None,
    };
    let names = names(&rig, here).join(", ");
    output.news(&format!(
        "simulated {names} on {}, {}; Ctrl-C ends it",
        interfaces.shown(&rig),
        arguments.pace.name()
    ))?;
    let mut show = page.show_devices(&rig);
    let served = serve(&mut server, &mut link, &is_interrupted, |server| {
        show(server.now(), &mut || server.record());
        if let Some(entrance) = &entrance {
            entrance.admit(server);
        }
    });
    drop(show);
    if let Some(path) = &arguments.plant {
        // It may be gone already.
        let _ = std::fs::remove_file(path);
    }
    let counts = server.counts();
    let time_s = server.now().as_secs_f64();
    let end = served.map_err(|error| match &error {
        ServeError::Rig(error) => rig_failure(error),
        ServeError::Gone => Failure::new(Exit::BusUnavailable, error.to_string(), "plug the adapter in again"),
    });
    page.end(&end);
    if output.is_json() {
        let drive =
            |(state, torque): (cia402::State, f64)| json!({ "state": format!("{state:?}"), "torque_n_m": torque });
        let drives: Vec<_> = server.drive_states().into_iter().zip(server.torques_n_m()).map(drive).collect();
        let document = json!({ "time_s": time_s, "syncs": counts.syncs, "sent": counts.sent, "drives": drives });
        return output.end(document, end);
    }
    output.news(&format!("served    {} SYNC, {} frames sent, {time_s:.3} s simulated", counts.syncs, counts.sent))?;
    end
}

impl Unwatched {
    fn watchdog(self) -> Watchdog {
        match self {
            Unwatched::Sync => Watchdog::Sync,
            Unwatched::SetPoints => Watchdog::SetPoints,
            Unwatched::Heartbeat => Watchdog::Heartbeat,
        }
    }
}

/// Returns the devices of the rig that `--nodes` names.
fn named(arguments: &Arguments, rig: &config::Rig) -> Result<[bool; 3], Failure> {
    let [left, right] = &rig.drives;
    let devices = [
        (&left.name, left.address.position()),
        (&right.name, right.address.position()),
        (&rig.sensor.name, rig.sensor.protocol.position()),
    ];
    let is_meant = |node: &String, (name, position): (&String, Option<u16>)| {
        node == name || position.is_some_and(|position| *node == position.to_string())
    };
    if let Some(unknown) = arguments.nodes.iter().find(|node| !devices.iter().any(|device| is_meant(node, *device))) {
        let message = format!("--nodes names {unknown}, which the rig does not have");
        let known = names(rig, [true; 3]).join(", ");
        return Err(Failure::new(Exit::Usage, message, format!("its devices are {known}")));
    }
    let is_here = |device| arguments.nodes.is_empty() || arguments.nodes.iter().any(|node| is_meant(node, device));
    let [left, right, sensor] = devices.map(is_here);
    // Axes of one device are in one process.
    let either = rig.has_one_device() && (left || right);
    Ok([left || either, right || either, sensor])
}

/// Returns the devices of the rig that this process simulates.
fn chosen(arguments: &Arguments, rig: &config::Rig) -> Result<[bool; 3], Failure> {
    let here = named(arguments, rig)?;
    let count = here.iter().filter(|is_here| **is_here).count();
    match (&arguments.attach, &arguments.plant) {
        (Some(_), _) if rig.has_one_device() && here[0] => {
            let message = "--attach is for a device of one drive, and both drives of this rig are axes of one device";
            Err(Failure::new(Exit::Usage, message, "leave the drives in the process with --plant"))
        }
        (Some(_), _) if count != 1 => {
            let help = "start one process for each device, such as --nodes left";
            Err(Failure::new(Exit::Usage, "--attach is for one device", help))
        }
        (None, None) if count < 3 => {
            let help = "name a socket with --plant, and the same one with --attach where the other devices are";
            Err(Failure::new(Exit::Usage, "the arm needs all its devices, and some are not in this process", help))
        }
        _ => Ok(here),
    }
}

fn names(rig: &config::Rig, here: [bool; 3]) -> Vec<&str> {
    let [left, right] = &rig.drives;
    let names = [&left.name, &right.name, &rig.sensor.name];
    names.into_iter().zip(here).filter(|(_, is_here)| *is_here).map(|(name, _)| name.as_str()).collect()
}

fn milliseconds(time: Option<u64>) -> Duration {
    Duration::from_millis(time.unwrap_or_default())
}

/// The devices of this process as others know them on the buses.
struct Own {
    setup: MasterSetup,
    devices: DeviceSet,
}

impl Own {
    fn new(rig: &config::Rig, [has_left, has_right, has_sensor]: [bool; 3]) -> Result<Self, Failure> {
        let setup = bus_plan(rig).map_err(|error| rig_failure(&error.into()))?.0;
        let devices = DeviceSet::drives_where([has_left, has_right]) | DeviceSet::SENSOR.only_if(has_sensor);
        Ok(Self { setup, devices })
    }

    /// Returns the roles on a bus that only one process may have.
    fn roles(&self, bus: BusId) -> Vec<Role> {
        let drives = (0..).zip(&self.setup.drives).map(|(at, drive)| {
            let role = Role::Node(drive.node_id);
            (DeviceSet::drive(at), drive.bus, role)
        });
        let sensor = match &self.setup.sensor.link {
            SensorLink::Canopen(node) => Role::Node(node.node_id),
            SensorLink::PlainCan(link) => Role::PlainCan(link.protocol.data_ids()[0]),
        };
        let all = drives.chain([(DeviceSet::SENSOR, self.setup.sensor.bus, sensor)]);
        let mut roles: Vec<Role> = Vec::new();
        for (.., role) in all.filter(|(device, on, _)| self.devices.contains(*device) && *on == bus) {
            // Axes of one node are one.
            if !roles.contains(&role) {
                roles.push(role);
            }
        }
        roles
    }

    /// Listens for others that are the same devices; `placed` gives a frame its bus.
    fn listen(
        &self,
        link: &mut impl CanLink,
        is_over: &AtomicBool,
        placed: impl Fn(&Frame) -> Frame,
    ) -> Result<(), Failure> {
        let signs = Signs::of_devices(&self.setup, self.devices);
        let heard = listen(link, self.setup.listening(), is_over, |frame| signs.find(&placed(frame)));
        heard.map_or(Ok(()), |heard| {
            let bus = DeviceSet::interface(heard.frame.bus().index());
            let message = format!(
                "a device of this process is on the bus already; nothing was sent. Heard: {heard}, on the {bus}"
            );
            let help = "switch that device off, or leave it out of --nodes";
            Err(Failure::new(Exit::BusUnavailable, message, help))
        })
    }
}

/// Returns the failure to create a socket.
fn no_socket(path: &Path, error: &io::Error) -> Failure {
    let help = match error.kind() {
        io::ErrorKind::AddrInUse => {
            "another process has the arm, or one that was killed has left its socket: remove it"
        }
        _ => "name a socket in a folder that is there and can be written",
    };
    Failure::new(Exit::Usage, format!("--plant {}: {error}", path.display()), help)
}

/// Returns the failure for a device that the arm does not accept.
fn not_attached(path: &Path, error: &AttachError) -> Failure {
    let (exit, help) = match error {
        AttachError::NoArm(_) => (Exit::Usage, "start the process with --plant first"),
        AttachError::NotTaken => (Exit::Usage, "leave the device out of --nodes of the process with --plant"),
        AttachError::Gone => (Exit::BusUnavailable, "start the process with --plant again, and then this one"),
        AttachError::Wait(_) => (Exit::Internal, ""),
    };
    Failure::new(exit, format!("--attach {}: {error}", path.display()), help)
}

/// Attaches one device to an arm in another process.
fn attach_one(
    arguments: &Arguments,
    path: &Path,
    here: [bool; 3],
    rig: &config::Rig,
    scene: &config::Scene,
    output: &mut Output,
) -> Result<(), Failure> {
    let is_drive = |joint: usize| here.get(joint) == Some(&true);
    let bus = match rig.drives.iter().enumerate().find(|(joint, _)| is_drive(*joint)) {
        Some((_, drive)) => &drive.bus,
        None => &rig.sensor.bus,
    };
    let device = match rig.drives.iter().enumerate().find(|(joint, _)| is_drive(*joint)) {
        Some((joint, drive)) => simulated_drive(rig, scene, drive, joint as u32 + 1).map(|mut drive| {
            arguments.unwatched.iter().for_each(|unwatched| drive.ignore(unwatched.watchdog()));
            drive.set_reset_time(milliseconds(arguments.reset_ms));
            drive.set_sdo_time(milliseconds(arguments.sdo_ms));
            Attached::Drive(joint, Box::new(drive))
        }),
        None => simulated_force_sensor(rig).map(|sensor| Attached::Sensor(Box::new(sensor))),
    };
    let mut device = device.map_err(|error| rig_failure(&error))?;
    let is_interrupted = on_interrupt()?;
    // The device is on one bus, and hears no other.
    let interface = Interfaces::one(rig, &arguments.bus, bus)?;
    let bit_rate = rig.buses.get(bus).and_then(config::Bus::canopen).map(|bus| bus.bit_rate_bit_per_s);
    let own = Own::new(rig, here)?;
    let on = bus_id(rig, bus).map_err(|error| rig_failure(&error.into()))?;
    let roles = own.roles(on);
    let settings = SocketCanSettings { bit_rate, roles, ..SocketCanSettings::everything(&interface) };
    let mut link = SocketCan::open(&settings).map_err(|error| link_failure(&error))?;
    // An attached device has little time to answer, so the process listens first.
    own.listen(&mut link, &is_interrupted, |frame| frame.on_bus(on))?;
    output.news(&format!("simulated {} on {interface}; Ctrl-C ends it", names(rig, here).join(", ")))?;
    attach(&mut device, &mut link, path, &is_interrupted).map_err(|error| not_attached(path, &error))
}
