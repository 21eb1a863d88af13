//! `yieldwall tune`: stable parameters of a fixture and stable gains of a rig, with a reserve.

mod device;
mod gains;
mod joint_loop;

pub(super) use device::{coupled_finding, coupled_json, coupled_lines};

use super::failure::{Exit, Failure};
use super::keep::state_folder;
use super::masses::Masses;
use super::output::Output;
use yieldwall_config::{self as config, Document, Source};
use yieldwall_rig::RigError;
use yieldwall_rig::analysis::coupled_device;

/// Reserve unless another is asked for.
const RESERVE: f64 = 2.0;

#[derive(Debug, clap::Subcommand)]
pub(super) enum Command {
    /// Compute a rig's stable virtual masses, or a device's top stiffness and damping
    ///
    /// The analysis takes the sampled loop with its real delays, at the worst pose along the surface and the worst phase of a
    /// sensor with its own clock. For a rig the hand is on the tool, for a device it is off. docs/studies.md compares the result
    /// with simulation. If `tune loop` has measured the rig on its bus in torque mode, the analysis uses that inertia, delay and
    /// age of the force.
    Fixture(Arguments),
    /// Compute gains with margins of 6 dB and 45 degrees, from the arm's model alone
    ///
    /// Torque mode: the command finds the stiffest gains that have these margins at every pose along the surface. The model takes
    /// the inertia of the feed-forward or of the simulated arm, the delay of its bus and the zero-order hold. Velocity mode: the
    /// command finds the largest gain without overshoot. In position mode this program has no gains.
    Gains(gains::Arguments),
    /// Identify the dynamics of each joint, and compute gains with stable margins
    ///
    /// The command identifies inertia, friction and delay of each joint, and the age of the force. It prints the gains that leave
    /// margins of 6 dB and 45 degrees.
    ///
    /// One joint after the other moves back and forth by 12 degrees while the other one holds. The motions are slow ones at five
    /// rates, small vibrations (a sum of sines instead of a chirp), and small steps. In torque mode this program sets the torque.
    /// It also identifies the delay from an angle to the torque that was computed from it. In the other modes the drive closes the
    /// loop and reports its torque (6077h), which shows friction and no inertia. Meanwhile the force sensor feels the mass of the
    /// handle, which shows the age of its force. A light handle needs an extra weight of about 0.3 kg. Nobody may hold the handle.
    /// docs/bringup.md describes the details.
    Loop(Box<joint_loop::Arguments>),
}

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Rig or device; `builtin:paper-admittance.yaml` is the copy in the program
    #[arg(value_name = "RIG.yaml")]
    file: String,
    /// Factor between the printed numbers and the edge of stability, at least 1
    #[arg(long, value_name = "FACTOR", default_value_t = RESERVE, value_parser = parse_reserve)]
    reserve: f64,
    /// For a rig: stiffness of a further hand in N/m; repeatable
    ///
    /// The scene's hands count in any case. The further hands have the damping and the mass of the scene's hand.
    #[arg(long, value_name = "N/M", value_parser = parse_stiffness)]
    hand_stiffness: Vec<f64>,
}

fn parse_reserve(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|factor| (1.0..=1e3).contains(factor))
        .ok_or_else(|| "write a factor from 1 to 1000".to_owned())
}

fn parse_stiffness(text: &str) -> Result<f64, String> {
    let stiffness = text.parse().ok().filter(|stiffness| (1e-3..=1e7).contains(stiffness));
    stiffness.ok_or_else(|| "write a stiffness from 0.001 to 10000000 N/m, without the unit".to_owned())
}

pub(super) fn run(command: &Command, output: &mut Output) -> Result<(), Failure> {
    let arguments = match command {
        Command::Gains(arguments) => return gains::run(arguments, output),
        Command::Loop(arguments) => return joint_loop::run(arguments, output),
        Command::Fixture(arguments) => arguments,
    };
    let reserve = arguments.reserve;
    match config::load(Source::named(&arguments.file))? {
        Document::Rig(rig) => {
            output.configuration(&rig.warnings)?;
            let folder = state_folder("loops");
            let recorded = folder
                .map(|folder| Masses::of_recorded(&rig, &arguments.hand_stiffness, &folder))
                .transpose()?
                .flatten();
            let masses = match recorded {
                Some(masses) => masses,
                None => Masses::of(&rig, &arguments.hand_stiffness).map_err(|error| failure(&error))?,
            };
            if output.is_json() { output.report(masses.to_json(reserve)) } else { output.result(&masses.text(reserve)) }
        }
        Document::Device(device) => {
            output.configuration(&device.warnings)?;
            if !arguments.hand_stiffness.is_empty() {
                let message = "--hand-stiffness is for rigs; the worst case of a device is the hand off";
                return Err(Failure::new(Exit::Usage, message, "omit --hand-stiffness"));
            }
            let coupled = coupled_device(&device.value, reserve).map_err(|error| failure(&error))?;
            match coupled {
                Some(coupled) if output.is_json() => output.report(coupled_json(&coupled, reserve)),
                Some(coupled) => output.result(&(coupled_lines(&device.value, &coupled, reserve).join("\n") + "\n")),
                None => {
                    Err(Failure::new(Exit::Usage, "this device is not an impedance", "name a rig for an admittance"))
                }
            }
        }
        _ => Err(Failure::new(
            Exit::Usage,
            format!("{} is neither a rig nor a device", arguments.file),
            "name a file with a fixture, such as config/paper-admittance.yaml",
        )),
    }
}

fn failure(error: &RigError) -> Failure {
    Failure::new(Exit::ConfigInvalid, error.to_string(), "run `yieldwall config check` on the file")
}
