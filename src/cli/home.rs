//! `yieldwall home`: each drive finds its reference by itself, while the other one holds; once, or again and again.

mod repeated;

use serde_json::json;

use super::bus::check_buses;
use super::commission::add_defects;
use super::ending::{rig_failure, stopped_by};
use super::failure::{self, Exit, Failure, both};
use super::interrupt::{interrupted, on_interrupt};
use super::on_bus::live_failure;
use super::output::Output;
use super::report_text::stopped_verdict;
use yieldwall_config::{self as config, Positive, Source};
use yieldwall_motion::guard::Cause;
use yieldwall_rig::EmbeddedRig;
use yieldwall_run::{
    Bounds, Ended, HOMING_BEYOND_RAD, HomePlan, Homed, JointHomed, NotHome, NotProven, Repeated, RunError,
    settling_on_bus,
};

/// Default share of a drive's rated torque.
const TORQUE_SHARE: f64 = 0.25;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Rig file; `builtin:paper-incremental.yaml` is one in the program
    #[arg(value_name = "RIG.yaml")]
    rig: String,
    /// Joint, by the name of its drive in the rig, or `left` or `right`; default: both, one after the other
    joint: Option<String>,
    /// Torque limit of each drive in N m, written to 6072h; default: a quarter of the rated torque
    #[arg(long, value_name = "N_M", value_parser = super::jog::torque, allow_hyphen_values = true)]
    torque: Option<Positive>,
    /// Home 2 to 100 times, and report the shift of the references
    ///
    /// The joints move back in between. The drives must be freshly switched on.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=100))]
    repeat: Option<u32>,
    /// With --repeat: fail if a reference shifts by more than this between two homings; with unit, 0.05deg or 0.001rad
    #[arg(long, value_name = "ANGLE", value_parser = within, requires = "repeat", allow_hyphen_values = true)]
    within: Option<f64>,
    /// Inject a defect into the simulated machine, as with `commission`; repeatable
    #[cfg_attr(target_os = "linux", arg(conflicts_with = "bus"))]
    #[arg(long, value_name = "NAME[=SIZE][:left|right]")]
    defect: Vec<String>,
    #[cfg(target_os = "linux")]
    #[command(flatten)]
    on_bus: super::first_motion::OnBus,
}

/// Parses an angle with its unit above 0, in rad.
fn within(text: &str) -> Result<f64, String> {
    let angle = super::jog::angle(text)?;
    if angle > 0.0 { Ok(angle) } else { Err(format!("write an angle above 0, such as 0.05deg, not `{text}`")) }
}

/// Plan of the motion, with its bounds.
struct Plan {
    home: HomePlan,
    /// Number of homings.
    times: u32,
    /// By how much a reference may shift, rad.
    within_rad: Option<f64>,
    bounds: Bounds,
}

impl Plan {
    fn of(arguments: &Arguments, rig: &config::Rig) -> Result<Self, Failure> {
        let joint = arguments.joint.as_deref().map(|name| super::jog::joint(rig, name)).transpose()?;
        let joints = [0, 1].map(|one| joint.is_none_or(|joint| joint == one));
        let home = HomePlan::of(rig, joints, settling_on_bus(rig)).ok_or_else(|| {
            let message = format!("the drives of {} need no homing: their encoders are absolute", rig.rig.name);
            let help = "for an incremental encoder write `encoder: incremental` and `homing`; see docs/bringup.md";
            Failure::new(Exit::Usage, message, help)
        })?;
        let rated = rig.drives.iter().map(|drive| drive.rated_torque_n_m.get()).fold(f64::INFINITY, f64::min);
        let torque = arguments.torque.map_or(TORQUE_SHARE * rated, Positive::get);
        let positive = |value| {
            let none = || Failure::new(Exit::Usage, "the torque is 0", "write a larger --torque");
            Positive::new(value).ok_or_else(none)
        };
        let torque_n_m = positive(torque.min(rig.guard.torque_limit_n_m.get()))?;
        let asked = rig.drives.iter().zip(joints).filter(|(_, is_asked)| *is_asked).map(|(drive, _)| drive);
        let in_a_jig = |drive: &config::Drive| drive.homing.is_some_and(|homing| matches!(homing.method, 35 | 37));
        if let Some(drive) = asked.into_iter().find(|drive| arguments.repeat.is_some() && in_a_jig(drive)) {
            let message = format!("--repeat: {} homes at its present position, in a jig", drive.name);
            let help = "this method searches for no mark, so that there is nothing to repeat; put the joint into its jig again, and compare \
                        with `yieldwall calibrate kinematics`";
            return Err(Failure::new(Exit::Usage, message, help));
        }
        let bounds = Bounds { motion_rad: positive(home.bound_rad())?, torque_n_m };
        Ok(Self { home, times: arguments.repeat.unwrap_or(1), within_rad: arguments.within, bounds })
    }
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let rig = config::load_rig(Source::named(&arguments.rig))?;
    output.configuration(&rig.warnings)?;
    check_buses(&rig, None, output)?;
    let plan = Plan::of(arguments, &rig.value)?;
    super::jog::note_lowered(&rig.value, arguments.torque, output);
    #[cfg(target_os = "linux")]
    if arguments.on_bus.is_asked() {
        return on_bus(arguments, &plan, &rig, output);
    }
    let (rig, mut scene) = (&rig.value, rig.scene()?.value);
    add_defects(&mut scene, rig, &arguments.defect)?;
    let is_interrupted = on_interrupt()?;
    let machine = EmbeddedRig::new(rig, &scene, &rig.fixture, scene.seed);
    let mut machine = machine.map_err(|error| rig_failure(&error))?;
    output.simulated("arm", rig, "just switched on");
    let mut done = 0;
    let told = |homed: &Homed| count(&mut done, plan.times, homed, output);
    let repeated = machine.home_repeatedly(rig, (&plan.home, plan.times), plan.bounds, &is_interrupted, told);
    let repeated = repeated.map_err(|error| rig_failure(&error))?.map_err(|error| match error {
        NotProven::Run(error) => not_begun(&error),
        NotProven::Unproven(error) => Failure::new(Exit::Internal, error.to_string(), ""),
    })?;
    let failure = match ending(&repeated) {
        (Ended::Whole, ..) => None,
        (Ended::Interrupted, _, time_s) => Some(interrupted(time_s)),
        (_, cause, time_s) => Some(stopped_by(cause, time_s, rig)),
    };
    end(&plan, rig, &repeated, failure.map_or(Ok(()), Err), output)
}

/// Counts homings that ended well for a person who waits.
fn count(done: &mut u32, times: u32, homed: &Homed, output: &Output) {
    let is_well = homed.ended == Ended::Whole && homed.failed.is_none();
    *done += u32::from(is_well);
    if times > 1 && is_well {
        output.aside(&format!("homed {done} of {times} times"));
    }
}

/// Returns the end of all homings, the fault behind it, and the time since the drives were last enabled, s.
fn ending(repeated: &Repeated) -> (Ended, Option<Cause>, f64) {
    let homed = || repeated.homed.last().map(|homed| (homed.ended, homed.cause, homed.time_s));
    let led = repeated.stopped.map(|jogged| (jogged.ended, jogged.cause, jogged.time_s));
    led.or_else(homed).unwrap_or((Ended::Whole, None, 0.0))
}

/// Reports the result of each joint, and judges it.
fn end(
    plan: &Plan,
    rig: &config::Rig,
    repeated: &Repeated,
    end: Result<(), Failure>,
    output: &mut Output,
) -> Result<(), Failure> {
    let Some(homed) = repeated.homed.last() else { return end };
    let failed = homed.failed.map_or(Ok(()), |(joint, why)| Err(not_home(rig, joint, why)));
    let short = repeated.stopped.filter(|jogged| jogged.ended == Ended::Stopped && jogged.cause.is_none());
    let short = short.map_or(Ok(()), |jogged| Err(super::jog::short_of(&jogged)));
    // The observation of a drive is more specific than the fault with which it stopped the rig.
    let end = failed.and(short).and(end);
    let shifts = repeated::Shifts::of(plan, rig, repeated);
    let end = end.and_then(|()| shifts.iter().try_for_each(|shifts| shifts.judge(plan, rig, repeated)));
    let joints = rig.drives.iter().zip(homed.joints).zip(plan.home.joints);
    if output.is_json() {
        let document = |(joint, ((drive, homed), is_asked)): (usize, ((&config::Drive, JointHomed), bool))| {
            json!({
                "joint": drive.name,
                "asked": is_asked,
                "homed": homed.is_homed,
                "referenced": homed.is_referenced,
                "method": drive.homing.map(|homing| homing.method),
                "home_rad": drive.homing.map(|homing| homing.angle_rad),
                "angle_rad": homed.angle_rad,
                "farthest_rad": homed.farthest_rad,
                "repeatability": shifts.as_ref().and_then(|shifts| shifts.document(joint)),
            })
        };
        return output.end(
            json!({
                "joints": joints.enumerate().map(document).collect::<Vec<_>>(),
                "homings": repeated.homed.len(),
                "within_rad": plan.within_rad,
                "torque_limit_n_m": plan.bounds.torque_n_m.get(),
                "time_s": repeated.homed.iter().map(|homed| homed.time_s).sum::<f64>(),
                "state": format!("{:?}", homed.state),
                "cause": ending(repeated).1.map(|cause| cause.fault.row().name),
            }),
            end,
        );
    }
    let asked = joints.clone().filter(|(_, is_asked)| *is_asked).map(|((drive, _), _)| drive.name.as_str());
    let asked = asked.collect::<Vec<_>>().join(" and ");
    let (how, cause, time_s) = ending(repeated);
    let mut text = match (&end, cause.filter(|_| how == Ended::Stopped && homed.failed.is_none())) {
        (Err(failure), Some(cause)) => stopped_verdict(failure, time_s, cause, rig),
        _ => failure::verdict(&end, || format!("{asked} homed")),
    };
    text.push('\n');
    for ((drive, joint), is_asked) in joints {
        let word = match (joint.is_homed, is_asked) {
            (true, _) => "homed",
            (false, true) => "not homed",
            (false, false) => "held",
        };
        let reference = if joint.is_referenced { "" } else { " (by the encoder, without a reference)" };
        text.push_str(&format!(
            "{word:9} {}: at {:.3} deg{reference}\n          largest travel {:.3} deg\n",
            drive.name,
            joint.angle_rad.to_degrees(),
            joint.farthest_rad.to_degrees()
        ));
    }
    text.extend(shifts.iter().map(|shifts| shifts.lines(rig, plan.within_rad)));
    let torque = plan.bounds.torque_n_m.get();
    text.push_str(&format!("torque    limit {torque:.1} N m, set in both drives\n"));
    let unknown: Vec<&str> = rig
        .drives
        .iter()
        .zip(homed.joints)
        .filter(|(_, joint)| !joint.is_referenced)
        .map(|(drive, _)| drive.name.as_str())
        .collect();
    if end.is_ok() && !unknown.is_empty() {
        text.push_str(&format!(
            "missing   {} is not homed since power-on: home it before `run`\n",
            unknown.join(" and ")
        ));
    }
    output.result(&text)?;
    end
}

/// Returns the failure that kept the drives from being enabled.
fn not_begun(error: &RunError) -> Failure {
    let mut failure = live_failure(error);
    if let RunError::WayBlocked { .. } = error {
        let help = "nothing was enabled: both joints may travel twice `within_rad`, and the arm has no room for it. Write a smaller \
                    `within_rad` and move the arm nearer to home by hand, or home where the arm has more room";
        failure.report.diagnostics.iter_mut().for_each(|finding| finding.help = Some(help.to_owned()));
    }
    failure
}

/// Returns the failure of a drive that did not find its reference.
fn not_home(rig: &config::Rig, joint: usize, why: NotHome) -> Failure {
    let name = |joint: usize| rig.drives.get(joint).map_or("", |drive| drive.name.as_str());
    let homing = rig.drives.get(joint).and_then(|drive| drive.homing);
    let within = homing.map_or(0.0, |homing| homing.within_rad.get()).to_degrees();
    let joint_name = name(joint);
    let (exit, message, help) = match why {
        NotHome::GaveUp => (
            Exit::DeviceFault,
            format!("the drive {joint_name} reports a homing error (statusword bit 13)"),
            "`yieldwall state` shows its error code; check its switches and `homing.method`".to_owned(),
        ),
        NotHome::NotBegun => (
            Exit::DeviceFault,
            format!("the drive {joint_name} has not begun to home: it still reports the previous homing"),
            "switch it off and on, and try again; check whether it supports the method and the mode".to_owned(),
        ),
        NotHome::TooLong(longest_s) => (
            Exit::OutOfTolerance,
            format!("the drive {joint_name} did not find home within {longest_s:.1} s"),
            "check friction and obstacles, or raise --torque".to_owned(),
        ),
        NotHome::NotReferenced => (
            Exit::DeviceMismatch,
            format!("the drive {joint_name} reports that homing is complete, but not that its position refers to home"),
            "compare `referenced_bit` of its profile with the manual".to_owned(),
        ),
        NotHome::Elsewhere(off_rad) => (
            Exit::OutOfTolerance,
            format!("the position of {joint_name} is {:.2} deg off home", off_rad.to_degrees()),
            "compare `position_at_home` of its profile with the manual: some drives take the home offset with the other sign"
                .to_owned(),
        ),
        NotHome::Blocked(blocked, torque_n_m) => (
            Exit::SafetyStop,
            format!(
                "the drive {} pushed with {:.1} N m, at or near its limit, and its position did not change",
                name(blocked),
                torque_n_m.abs()
            ),
            "torque is off; check for an obstacle, and whether the encoder counts (`yieldwall monitor` while you move the joint by hand); raise \
             --torque only if friction is the reason"
                .to_owned(),
        ),
        NotHome::Silent(silent) => (
            Exit::DeviceFault,
            format!("the drive {} no longer reports its torque (6077h), which shows whether a joint is blocked", name(silent)),
            "check the cable and the bus load".to_owned(),
        ),
        NotHome::Jumped(jumped) => (
            Exit::SafetyStop,
            format!("while {joint_name} was homed, the position of {}, which holds, jumped", name(jumped)),
            "check its encoder and its cable".to_owned(),
        ),
        NotHome::TooFar(moved, gone_rad) if moved != joint => (
            Exit::SafetyStop,
            format!("while {joint_name} was homed, the joint of {} moved by {:.2} deg", name(moved), gone_rad.to_degrees()),
            "this joint has to hold: check its brake, the gains of the drive's own loop, and whether somebody holds the arm"
                .to_owned(),
        ),
        NotHome::TooFar(_, gone_rad) => (
            Exit::SafetyStop,
            format!(
                "the joint of {joint_name} moved by {:.2} deg and did not find home (limit: `within_rad` of {within:.2} deg and {:.2} deg more)",
                gone_rad.to_degrees(),
                HOMING_BEYOND_RAD.to_degrees()
            ),
            "by hand or with `yieldwall jog`, move the joint to where home lies ahead in the direction of homing, and try again. \
             After a homing it is beyond its home. Check `homing.method` and the wires of the switch"
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
    use super::first_motion::{Opened, concluded};
    use super::live::{ended, not_run};
    use super::on_bus::warn;
    use yieldwall_run::host::{News, NotRun};

    let events = Events::of(output);
    let opened = arguments.on_bus.open("home", &arguments.rig, rig, output)?;
    let Opened { on_bus, terms, interfaces, is_interrupted } = opened;
    let rig = &rig.value;
    output.aside("one joint moves after the other, while the other one holds; nobody may hold the handle");
    let mut done = 0;
    let outcome = on_bus.home(&terms, (&plan.home, plan.times), plan.bounds, &is_interrupted, |news| match news {
        News::Refused(refusal) => warn(output, refusal),
        News::Homed(homed) => {
            events.clear();
            count(&mut done, plan.times, &homed, output);
        }
        // The steps of the boot are for --verbose.
        News::Step(_) | News::Proved => {}
        news => events.news(news),
    });
    let (outcome, given_back) = concluded(&events, outcome, output)?;
    let repeated = match &outcome.played {
        Ok(repeated) => repeated,
        Err(error) => {
            let failure = match error {
                NotRun::Run(error @ RunError::WayBlocked { .. }) => not_begun(error),
                error => not_run(error, &outcome, &interfaces, rig, &arguments.rig),
            };
            return both(Err(failure), given_back);
        }
    };
    let (how, cause, time_s) = ending(repeated);
    let failure = ended((how, cause), time_s, &outcome, rig);
    end(plan, rig, repeated, both(failure.map_or(Ok(()), Err), given_back), output)
}
