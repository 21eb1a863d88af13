//! `yieldwall home`: each drive finds its reference by itself, while the other one holds.

use serde_json::json;

use super::ending::{rig_failure, stopped_by};
use super::failure::{Exit, Failure};
use super::interrupt::{interrupted, on_interrupt};
use super::on_bus::live_failure;
use super::output::Output;
use super::run::check_buses;
use crate::config::{self, Positive, Source};
use crate::rig::EmbeddedRig;
use crate::run::{Bounds, Ended, HOMING_BEYOND_RAD, HomePlan, Homed, NotHome, RunError, settling_on_bus};

/// Share of the rated torque of a drive, unless said otherwise.
const TORQUE_SHARE: f64 = 0.25;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The rig; `builtin:paper-incremental.yaml` names one inside the program
    #[arg(value_name = "RIG.yaml")]
    rig: String,
    /// The joint, by the name of its drive in the rig; `left` and `right` are names too. Both, one after the other, unless said
    joint: Option<String>,
    /// Most torque of each drive, N m, which the drives are told (6072h); a quarter of their rated torque unless said
    #[arg(long, value_name = "N_M", value_parser = super::jog::torque, allow_hyphen_values = true)]
    torque: Option<Positive>,
    #[cfg(target_os = "linux")]
    #[command(flatten)]
    on_bus: super::first_motion::OnBus,
}

/// What is done, and within which bounds.
struct Plan {
    home: HomePlan,
    bounds: Bounds,
}

impl Plan {
    fn of(arguments: &Arguments, rig: &config::Rig) -> Result<Self, Failure> {
        let joint = arguments.joint.as_deref().map(|name| super::jog::joint(rig, name)).transpose()?;
        let joints = [0, 1].map(|one| joint.is_none_or(|joint| joint == one));
        let home = HomePlan::of(rig, joints, settling_on_bus(rig)).ok_or_else(|| {
            let message =
                format!("the drives of {} are not homed: their encoders know their angle at power-on", rig.rig.name);
            let help = "an encoder that does not gets `encoder: incremental` and `homing`, as docs/bringup.md says";
            Failure::new(Exit::Usage, message, help)
        })?;
        let rated = rig.drives.iter().map(|drive| drive.rated_torque_n_m.get()).fold(f64::INFINITY, f64::min);
        let torque = arguments.torque.map_or(TORQUE_SHARE * rated, Positive::get);
        let positive = |value| {
            let none = || Failure::new(Exit::Usage, "no torque is left", "write a greater --torque");
            Positive::new(value).ok_or_else(none)
        };
        let torque_n_m = positive(torque.min(rig.guard.torque_limit_n_m.get()))?;
        Ok(Self { home, bounds: Bounds { motion_rad: positive(home.bound_rad())?, torque_n_m } })
    }
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let rig = config::load_rig(Source::named(&arguments.rig))?;
    output.configuration(&rig.warnings)?;
    check_buses(&rig, None, output)?;
    let plan = Plan::of(arguments, &rig.value)?;
    #[cfg(target_os = "linux")]
    if arguments.on_bus.is_asked() {
        return on_bus(arguments, &plan, &rig, output);
    }
    let (rig, scene) = (&rig.value, rig.scene()?.value);
    let is_interrupted = on_interrupt()?;
    let machine = EmbeddedRig::new(rig, &scene, &rig.fixture, scene.seed);
    let mut machine = machine.map_err(|error| rig_failure(&error))?;
    let name = &rig.rig.name;
    output.aside(&format!("the simulated arm of {name}, switched on just now; a real one with --bus INTERFACE"));
    let homed = machine.home(rig, &plan.home, plan.bounds.torque_n_m, &is_interrupted);
    let homed = homed.map_err(|error| rig_failure(&error))?.map_err(|error| not_begun(&error))?;
    let failure = match homed.ended {
        Ended::Whole => None,
        Ended::Interrupted => Some(interrupted(homed.time_s)),
        _ => Some(stopped_by(homed.cause, homed.time_s, rig)),
    };
    end(&plan, rig, &homed, failure.map_or(Ok(()), Err), output)
}

/// Tells what became of each joint, and judges.
fn end(
    plan: &Plan,
    rig: &config::Rig,
    homed: &Homed,
    end: Result<(), Failure>,
    output: &mut Output,
) -> Result<(), Failure> {
    let failed = homed.failed.map_or(Ok(()), |(joint, why)| Err(not_home(rig, joint, why)));
    // What was seen of a drive says more than the fault that stopped the rig for it.
    let end = failed.and(end);
    let joints = rig.drives.iter().zip(homed.joints).zip(plan.home.joints);
    if output.is_json() {
        let document = |((drive, joint), is_asked): ((&config::Drive, crate::run::JointHomed), bool)| {
            json!({
                "joint": drive.name,
                "asked": is_asked,
                "homed": joint.is_homed,
                "referenced": joint.is_referenced,
                "method": drive.homing.map(|homing| homing.method),
                "home_rad": drive.homing.map(|homing| homing.angle_rad),
                "angle_rad": joint.angle_rad,
                "farthest_rad": joint.farthest_rad,
            })
        };
        return output.end(
            json!({
                "joints": joints.map(document).collect::<Vec<_>>(),
                "torque_limit_n_m": plan.bounds.torque_n_m,
                "time_s": homed.time_s,
                "state": format!("{:?}", homed.state),
                "cause": homed.cause.map(|cause| cause.fault.row().name),
            }),
            end,
        );
    }
    let mut text = String::new();
    for ((drive, joint), is_asked) in joints {
        let word = match (joint.is_homed, is_asked) {
            (true, _) => "homed",
            (false, true) => "not homed",
            (false, false) => "held",
        };
        let reference = if joint.is_referenced { "" } else { ", as far as it is known without a reference" };
        text.push_str(&format!(
            "{word:9} {}: went {:.3} deg at most, stands at {:.3} deg{reference}\n",
            drive.name,
            joint.farthest_rad.to_degrees(),
            joint.angle_rad.to_degrees()
        ));
    }
    let torque = plan.bounds.torque_n_m.get();
    text.push_str(&format!("torque    {torque:.1} N m at most, which both drives were told\n"));
    let unknown: Vec<&str> = rig
        .drives
        .iter()
        .zip(homed.joints)
        .filter(|(_, joint)| !joint.is_referenced)
        .map(|(drive, _)| drive.name.as_str())
        .collect();
    if end.is_ok() && !unknown.is_empty() {
        text.push_str(&format!(
            "{} was not homed since it was switched on, and no rig runs with it\n",
            unknown.join(" and ")
        ));
    }
    output.result(&text)?;
    end
}

/// The failure that kept the drives from being enabled.
fn not_begun(error: &RunError) -> Failure {
    let mut failure = live_failure(error);
    if let RunError::WayBlocked { .. } = error {
        let help = "nothing was enabled; a joint may be `within_rad` from home and go as far again, the other one as far off too: write a smaller \
                    `within_rad` and lead the arm nearer to home by hand, or home where the arm has more room";
        failure.report.diagnostics.iter_mut().for_each(|finding| finding.help = Some(help.to_owned()));
    }
    failure
}

/// The failure of a drive that did not find its reference.
fn not_home(rig: &config::Rig, joint: usize, why: NotHome) -> Failure {
    let name = |joint: usize| rig.drives.get(joint).map_or("", |drive| drive.name.as_str());
    let homing = rig.drives.get(joint).and_then(|drive| drive.homing);
    let within = homing.map_or(0.0, |homing| homing.within_rad.get()).to_degrees();
    let joint_name = name(joint);
    let (exit, message, help) = match why {
        NotHome::GaveUp => (
            Exit::DeviceFault,
            format!("the drive {joint_name} has given up homing (statusword, bit 13)"),
            "`yieldwall state` tells its error code; look at its switches and at `homing.method`".to_owned(),
        ),
        NotHome::NotBegun => (
            Exit::DeviceFault,
            format!("the drive {joint_name} has not begun to home: it still tells how it homed before"),
            "switch it off and on, and try again; look whether it has the method and the mode".to_owned(),
        ),
        NotHome::TooLong(longest_s) => (
            Exit::OutOfTolerance,
            format!("the drive {joint_name} did not find home within {longest_s:.1} s"),
            "look for friction and for what blocks the joint, or raise --torque".to_owned(),
        ),
        NotHome::NotReferenced => (
            Exit::DeviceMismatch,
            format!("the drive {joint_name} says that homing is over, and not that its position refers to home"),
            "compare `referenced_bit` of its profile with the manual".to_owned(),
        ),
        NotHome::Elsewhere(off_rad) => (
            Exit::OutOfTolerance,
            format!("by its position the joint of {joint_name} stands {:.2} deg beside home", off_rad.to_degrees()),
            "compare `position_at_home` of its profile with the manual: some drives take the home offset with the other sign"
                .to_owned(),
        ),
        NotHome::Blocked(blocked, torque_n_m) => (
            Exit::SafetyStop,
            format!(
                "the drive {} pushed with {:.1} N m, all that it may or nearly so, and its position stood still",
                name(blocked),
                torque_n_m.abs()
            ),
            "torque is off; look whether the joint is blocked and whether its encoder counts (`yieldwall monitor` while you lead it by hand), \
             then at friction, and raise --torque only if that is the reason"
                .to_owned(),
        ),
        NotHome::Silent(silent) => (
            Exit::DeviceFault,
            format!("the drive {} does not tell its torque (6077h) any more, by which a joint that is blocked is seen", name(silent)),
            "look at the cable and at the load of the bus".to_owned(),
        ),
        NotHome::Jumped(jumped) => (
            Exit::SafetyStop,
            format!("while {joint_name} was homed the position of {}, which holds, jumped", name(jumped)),
            "look at its encoder and its cable".to_owned(),
        ),
        NotHome::TooFar(moved, gone_rad) if moved != joint => (
            Exit::SafetyStop,
            format!("while {joint_name} was homed the joint of {} went {:.2} deg", name(moved), gone_rad.to_degrees()),
            "it has to hold: look at its brake, at the gains of the drive's own loop, and whether somebody holds the arm"
                .to_owned(),
        ),
        NotHome::TooFar(_, gone_rad) => (
            Exit::SafetyStop,
            format!(
                "the joint of {joint_name} went {:.2} deg and did not find home, which is to lie within {within:.2} deg of where it began; \
                 {:.2} deg more are its bound",
                gone_rad.to_degrees(),
                HOMING_BEYOND_RAD.to_degrees()
            ),
            "lead the arm by hand to where home lies ahead on its way, switch the drives off and on, and try again; look at \
             `homing.method` and at the wires of the switch"
                .to_owned(),
        ),
    };
    Failure::new(exit, message, help)
}

#[cfg(target_os = "linux")]
fn on_bus(
    arguments: &Arguments,
    plan: &Plan,
    rig: &config::Loaded<config::Rig>,
    output: &mut Output,
) -> Result<(), Failure> {
    use super::events::Events;
    use super::failure::both;
    use super::first_motion::{Opened, concluded};
    use super::live::{ended, not_run};
    use super::on_bus::warn;
    use crate::assembly::homing_master;
    use crate::host::{News, NotRun};

    let events = Events::of(output);
    let opened = arguments.on_bus.open_for("home", &arguments.rig, rig, homing_master, output)?;
    let Opened { on_bus, terms, interfaces, is_interrupted, journal } = opened;
    let rig = &rig.value;
    output.aside("one joint moves after the other, and the other one holds; nobody may hold the handle");
    let outcome = on_bus.home(&terms, &plan.home, plan.bounds, &is_interrupted, |news| match news {
        News::Refused(refusal) => warn(output, refusal),
        // The steps of the boot are for --verbose.
        News::Step(_) | News::Proved => {}
        news => events.news(news),
    });
    let (outcome, given_back) = concluded(&events, journal, outcome, output)?;
    let homed = match &outcome.played {
        Ok(homed) => *homed,
        Err(error) => {
            let failure = match error {
                NotRun::Run(error @ RunError::WayBlocked { .. }) => not_begun(error),
                error => not_run(error, &outcome, &interfaces, rig, &arguments.rig),
            };
            return both(Err(failure), given_back);
        }
    };
    let failure = ended((homed.ended, homed.cause), homed.time_s, &outcome, rig);
    end(plan, rig, &homed, both(failure.map_or(Ok(()), Err), given_back), output)
}
