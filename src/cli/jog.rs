//! `yieldwall jog`: one joint moved by an angle or while a key is pressed, slowly and with little torque, while the other one holds.

mod keys;

use std::f64::consts::PI;
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde_json::json;

use super::bus::check_buses;
use super::ending::{rig_failure, stopped_by};
use super::failure::{self, Exit, Failure, both};
use super::faults::FaultArgument;
use super::interrupt::{interrupted, on_interrupt};
use super::on_bus::live_failure;
use super::output::Output;
use super::report_text::stopped_verdict;
use keys::{KEYS, Reader, Shown};
use yieldwall_config::{self as config, Positive, Source};
use yieldwall_motion::cycle::LeadLimits;
use yieldwall_motion::guard::{DeviceSet, Fault};
use yieldwall_motion::quantity::JointAngles;
use yieldwall_record::CycleRecord;
use yieldwall_rig::EmbeddedRig;
use yieldwall_run::{Bounds, Ended, Jog, Jogged, Keys, settling_on_bus};

/// Greatest rate, rad/s.
const MOST_RATE: f64 = 30.0 * PI / 180.0;
/// Time in which the joint reaches its rate, s.
const COMES_UP_S: f64 = 0.2;
/// Default share of a drive's rated torque: the share of dry friction, and a little more.
const TORQUE_SHARE: f64 = 0.25;
/// Largest travel of a joint beyond its range before the rig is stopped, and largest distance from its target at rest, rad.
const BEYOND_RAD: f64 = 0.02;
const OFF_RAD: f64 = 2e-3;

#[derive(Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("way").required(true).args(["by", "keys"]))]
pub(super) struct Arguments {
    /// Rig file; `builtin:paper-admittance.yaml` is the copy in the program
    #[arg(value_name = "RIG.yaml")]
    rig: String,
    /// Joint, by the name of its drive in the rig, or `left` or `right`
    joint: String,
    /// Signed angle with unit, 5deg or -0.1rad; counter-clockwise is positive
    #[arg(long, value_name = "ANGLE", value_parser = angle, allow_hyphen_values = true)]
    by: Option<f64>,
    /// Move while a key is pressed; q quits
    ///
    /// Right or + moves counter-clockwise, left or - clockwise. The joint stops 200 ms after the last key, at the end of the input, and if
    /// the terminal closes.
    #[arg(long)]
    keys: bool,
    /// With --keys: largest travel to either side, with unit
    #[arg(long, value_name = "ANGLE", value_parser = angle, default_value = "10deg", conflicts_with = "by", allow_hyphen_values = true)]
    within: f64,
    /// Angle per second, with unit; at most 30deg
    #[arg(long, value_name = "ANGLE", value_parser = angle, default_value = "6deg", allow_hyphen_values = true)]
    rate: f64,
    /// Torque limit of each drive in N m, written to 6072h; default: a quarter of the rated torque
    #[arg(long, value_name = "N_M", value_parser = torque, allow_hyphen_values = true)]
    torque: Option<Positive>,
    /// Inject a fault, as with `run --fault`; TIME counts from the end of the boot, in s
    #[cfg_attr(target_os = "linux", arg(conflicts_with = "bus"))]
    #[arg(long, value_name = "NAME@TIME[+DURATION][:TARGET]")]
    fault: Vec<FaultArgument>,
    #[cfg(target_os = "linux")]
    #[command(flatten)]
    on_bus: super::first_motion::OnBus,
}

/// Parses an angle with its unit, in rad.
pub(super) fn angle(text: &str) -> Result<f64, String> {
    let wanted = || format!("write an angle with its unit, such as 5deg or -0.1rad, not `{text}`");
    let (number, unit) = match (text.strip_suffix("deg"), text.strip_suffix("rad")) {
        (Some(number), _) => (number, PI / 180.0),
        (_, Some(number)) => (number, 1.0),
        _ => return Err(wanted()),
    };
    let value: f64 = number.trim().parse().map_err(|_| wanted())?;
    if value.is_finite() { Ok(value * unit) } else { Err(wanted()) }
}

/// Index of a joint by the name of its drive or by its side, 0 the left one.
pub(super) fn joint(rig: &config::Rig, name: &str) -> Result<usize, Failure> {
    let names = rig.drives.each_ref().map(|drive| drive.name.as_str());
    let by_side = || ["left", "right"].iter().position(|side| *side == name);
    names.iter().position(|known| *known == name).or_else(by_side).ok_or_else(|| {
        let message = format!("{name} is not a joint of the rig");
        Failure::new(Exit::Usage, message, format!("write {}", names.join(" or ")))
    })
}

pub(super) fn torque(text: &str) -> Result<Positive, String> {
    let value = text.parse().ok().and_then(Positive::new);
    value.ok_or_else(|| format!("write a torque in N m above 0, such as 2.5, not `{text}`"))
}

/// Returns the notice for a torque limit above the rig's own one, which stays in force.
fn lowered(rig: &config::Rig, torque: Option<Positive>) -> Option<String> {
    let (torque, most) = (torque?.get(), rig.guard.torque_limit_n_m.get());
    (torque > most).then(|| {
        format!("--torque {torque} N m is above `guard.torque_limit_n_m`: the limit of each drive is {most} N m")
    })
}

/// Prints a notice if the rig's own torque limit is below the one of --torque.
pub(super) fn note_lowered(rig: &config::Rig, torque: Option<Positive>, output: &Output) {
    lowered(rig, torque).iter().for_each(|notice| output.aside(notice));
}

/// Plan of the motion, with its bounds.
struct Plan<'a> {
    /// Index of the joint, 0 the left one.
    joint: usize,
    jog: Jog<'a>,
    bounds: Bounds,
}

impl<'a> Plan<'a> {
    fn of(arguments: &Arguments, rig: &config::Rig, keys: &'a Keys) -> Result<Self, Failure> {
        let usage = |message: String, help: &str| Failure::new(Exit::Usage, message, help);
        let joint = joint(rig, &arguments.joint)?;
        let (option, way) = arguments.by.map_or(("--within", arguments.within), |by| ("--by", by));
        let refused = match way.abs() {
            0.0 => Some("the angle is 0".to_owned()),
            size if size > PI => Some(format!("{:.1}deg is more than half a turn", way.to_degrees())),
            _ => None,
        };
        if let Some(refused) = refused {
            let help = format!("write, for example, {option} 5deg");
            return Err(usage(format!("{option}: {refused}"), &help));
        }
        if !(arguments.rate > 0.0 && arguments.rate <= MOST_RATE) {
            return Err(usage(
                "--rate: write more than 0 and at most 30deg (per second)".to_owned(),
                "write, for example, --rate 6deg",
            ));
        }
        let rated = rig.drives.iter().map(|drive| drive.rated_torque_n_m.get()).fold(f64::INFINITY, f64::min);
        let most = rig.guard.torque_limit_n_m.get();
        let torque = arguments.torque.map_or(TORQUE_SHARE * rated, Positive::get).min(most);
        let positive = |value| {
            Positive::new(value).ok_or_else(|| usage("torque and angle are 0".to_owned(), "write larger values"))
        };
        let mut by = [0.0; 2];
        by.iter_mut().skip(joint).take(1).for_each(|by| *by = way);
        let limits =
            LeadLimits { rate_rad_per_s: arguments.rate, acceleration_rad_per_s2: arguments.rate / COMES_UP_S };
        let keys = arguments.keys.then_some(keys);
        let jog = Jog { by: JointAngles::from(by), keys, limits, settling: settling_on_bus(rig), is_metered: false };
        let motion_rad = positive(way.abs() + BEYOND_RAD)?;
        Ok(Self { joint, jog, bounds: Bounds { motion_rad, torque_n_m: positive(torque)? } })
    }

    /// Returns the difference between a joint's travel and the requested travel, rad. With keys, no travel is known in advance.
    fn off(&self, jogged: &Jogged) -> [f64; 2] {
        let mut off = (jogged.to - jogged.from - self.jog.by).to_array();
        if self.jog.keys.is_some() {
            off.iter_mut().skip(self.joint).take(1).for_each(|off| *off = 0.0);
        }
        off
    }

    /// Explains a failure for a guided joint. A joint that hardly moves has too little torque, or is blocked. A joint that has
    /// moved may be running away, which more torque makes worse; so may a joint that had to hold. The following-error limit of
    /// `run` does not apply to a guided joint.
    fn told(&self, mut failure: Failure, jogged: &Jogged) -> Failure {
        let led = DeviceSet::drive(self.joint);
        let is_behind = jogged.cause.is_some_and(|cause| cause.fault == Fault::FollowingError && cause.devices == led);
        let gone = (jogged.to - jogged.from).to_array().get(self.joint).copied().unwrap_or_default();
        let led_rad =
            self.jog.by.to_array().get(self.joint).copied().filter(|_| self.jog.keys.is_none()).unwrap_or_default();
        let stands = (jogged.to - jogged.from).max_abs() <= OFF_RAD;
        if let Some(first) = failure.report.diagnostics.first_mut().filter(|_| is_behind) {
            let torque = self.bounds.torque_n_m.get();
            first.help = Some(if stands {
                format!(
                    "the joint does not follow with {torque:.1} N m: check for an obstacle, a closed brake or a frozen encoder; raise --torque only if \
                     the friction is larger"
                )
            } else if gone * led_rad < 0.0 {
                format!(
                    "its encoder reports {:.2} deg of motion opposite to the reference: compare `direction` and the encoder's polarity with the machine \
                     (step `rotation` of `yieldwall commission`); do not raise the torque",
                    gone.abs().to_degrees()
                )
            } else {
                "check for a frozen encoder, an obstacle and a joint that runs away; do not raise the torque".to_owned()
            });
        }
        failure
    }

    /// Returns the measured angle of the joint, rad.
    fn angle(&self, record: &CycleRecord) -> f64 {
        record.signals.measured_angles.to_array().get(self.joint).copied().unwrap_or_default()
    }

    /// Checks that each joint is at its target.
    fn judge(&self, jogged: &Jogged, rig: &config::Rig) -> Result<(), Failure> {
        let off = self.off(jogged);
        let Some((drive, off)) = rig.drives.iter().zip(off).find(|(_, off)| off.abs() > OFF_RAD) else { return Ok(()) };
        let message = format!(
            "the joint of {} is {:.2} deg off its target (limit {:.2} deg)",
            drive.name,
            off.to_degrees(),
            OFF_RAD.to_degrees()
        );
        let torque = self.bounds.torque_n_m.get();
        let help = format!("{torque:.1} N m do not move it there: check friction and obstacles, or raise --torque");
        Err(Failure::new(Exit::OutOfTolerance, message, help))
    }

    fn end(
        &self,
        arguments: &Arguments,
        rig: &config::Rig,
        jogged: &Jogged,
        end: Result<(), Failure>,
        output: &mut Output,
    ) -> Result<(), Failure> {
        let end = end.and_then(|()| self.judge(jogged, rig));
        if output.is_json() {
            return output.end(
                json!({
                    "joint": rig.drives.get(self.joint).map(|drive| &drive.name),
                    "by_rad": arguments.by,
                    "within_rad": arguments.keys.then_some(arguments.within),
                    "from_rad": jogged.from.to_array(),
                    "to_rad": jogged.to.to_array(),
                    "deviation_rad": jogged.deviation.to_array(),
                    "torque_limit_n_m": self.bounds.torque_n_m.get(),
                    "time_s": jogged.time_s,
                    "state": format!("{:?}", jogged.state),
                    "cause": jogged.cause.map(|cause| cause.fault.row().name),
                }),
                end,
            );
        }
        let name = rig.drives.get(self.joint).map_or("", |drive| drive.name.as_str());
        let mut text = match (&end, jogged.cause.filter(|_| jogged.ended == Ended::Stopped)) {
            (Err(failure), Some(cause)) => stopped_verdict(failure, jogged.time_s, cause, rig),
            _ => failure::verdict(&end, || format!("{name} was jogged, the other joint held")),
        };
        text.push('\n');
        let each =
            rig.drives.iter().zip(jogged.from.to_array()).zip(jogged.to.to_array()).zip(jogged.deviation.to_array());
        for (joint, (((drive, from), to), deviation)) in each.enumerate() {
            let has_moved = joint == self.joint && (to - from).abs() > OFF_RAD;
            let word = if has_moved { "moved" } else { "held" };
            text.push_str(&format!(
                "{word:9} {}: {:.3} -> {:.3} deg\n          max deviation from the reference: {:.3} deg\n",
                drive.name,
                from.to_degrees(),
                to.to_degrees(),
                deviation.to_degrees()
            ));
        }
        text.push_str(&format!("torque    limit {:.1} N m, set in both drives\n", self.bounds.torque_n_m.get()));
        output.result(&text)?;
        end
    }
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let rig = config::load_rig(Source::named(&arguments.rig))?;
    output.configuration(&rig.warnings)?;
    check_buses(&rig, None, output)?;
    let (keys, shown) = (Arc::<Keys>::default(), Arc::<Shown>::default());
    let plan = Plan::of(arguments, &rig.value, &keys)?;
    note_lowered(&rig.value, arguments.torque, output);
    let name = rig.value.drives.get(plan.joint).map(|drive| drive.name.clone()).unwrap_or_default();
    let read = |output: &Output| {
        arguments
            .keys
            .then(|| {
                Reader::start(Arc::clone(&keys), Arc::clone(&shown), (&name, arguments.within), !output.is_quiet())
            })
            .transpose()
    };
    #[cfg(target_os = "linux")]
    if arguments.on_bus.is_asked() {
        return on_bus(arguments, &plan, &rig, (&shown, read), output);
    }
    let (rig, scene) = (&rig.value, rig.scene()?.value);
    let is_interrupted = on_interrupt()?;
    let machine = EmbeddedRig::new(rig, &scene, &rig.fixture, scene.seed);
    let mut machine = machine.map_err(|error| rig_failure(&error))?;
    for fault in &arguments.fault {
        machine.inject(fault.of_rig(rig)?).map_err(|error| rig_failure(&error))?;
    }
    output.simulated("arm", rig, "hands off");
    let reader = read(output)?;
    reader.iter().for_each(|_| output.aside(KEYS));
    let period = Duration::from_micros(rig.cycle.period_us.into());
    let (begun, mut cycles) = (Instant::now(), 0);
    // A person has time to press keys: the simulation waits for the clock then.
    let each = |record: &CycleRecord| {
        shown.tell(plan.angle(record));
        cycles += 1;
        if let Some(ahead) = (period * cycles).checked_sub(begun.elapsed()).filter(|_| reader.is_some()) {
            std::thread::sleep(ahead);
        }
    };
    let jogged = machine.jog(rig, &plan.jog, plan.bounds, &is_interrupted, each);
    drop(reader);
    let jogged = jogged.map_err(|error| rig_failure(&error))?.map_err(|error| live_failure(&error))?;
    let failure = match jogged.ended {
        Ended::Whole => None,
        Ended::Stopped if jogged.cause.is_none() => Some(short_of(&jogged)),
        Ended::Interrupted => Some(interrupted(jogged.time_s)),
        _ => Some(plan.told(stopped_by(jogged.cause, jogged.time_s, rig), &jogged)),
    };
    plan.end(arguments, rig, &jogged, failure.map_or(Ok(()), Err), output)
}

/// Returns the failure for joints that did not reach their targets, although no fault stopped the rig.
pub(super) fn short_of(jogged: &Jogged) -> Failure {
    let message = format!("the rig stopped after {:.3} s, before its joints reached their targets", jogged.time_s);
    Failure::new(
        Exit::SafetyStop,
        message,
        "move less far: the path leads near a singularity or the edge of the workspace",
    )
}

#[cfg(target_os = "linux")]
fn on_bus(
    arguments: &Arguments,
    plan: &Plan<'_>,
    rig: &config::Loaded<config::Rig>,
    (shown, read): (&Arc<Shown>, impl Fn(&Output) -> Result<Option<Reader>, Failure>),
    output: &mut Output,
) -> Result<(), Failure> {
    use super::events::Events;
    use super::first_motion::{Opened, concluded};
    use super::live::{ended, not_run};
    use super::on_bus::warn;
    use yieldwall_run::host::News;

    let events = Events::of(output);
    let opened = arguments.on_bus.open("jog", &arguments.rig, rig, output)?;
    let Opened { mut on_bus, terms, interfaces, is_interrupted } = opened;
    let rig = &rig.value;
    let reader = read(output)?;
    if reader.is_some() {
        let (shown, joint) = (Arc::clone(shown), plan.joint);
        on_bus.set_observer(Box::new(move |record| {
            shown.tell(record.signals.measured_angles.to_array().get(joint).copied().unwrap_or_default());
        }));
        output.aside(KEYS);
    }
    output.aside("one joint will move, the other one will hold; nobody may hold the handle");
    let outcome = on_bus.jog(&terms, &plan.jog, plan.bounds, &is_interrupted, |news| match news {
        News::Refused(refusal) => warn(output, refusal),
        // The steps of the boot are for --verbose.
        News::Step(_) | News::Proved => {}
        news => events.news(news),
    });
    drop(reader);
    let (outcome, given_back) = concluded(&events, outcome, output)?;
    let jogged = match &outcome.played {
        Ok(jogged) => *jogged,
        Err(error) => {
            let failure = not_run(error, &outcome, &interfaces, rig, &arguments.rig);
            return both(Err(failure), given_back);
        }
    };
    let failure = match jogged.ended {
        Ended::Stopped if jogged.cause.is_none() => Some(short_of(&jogged)),
        end => ended((end, jogged.cause), jogged.time_s, &outcome, rig).map(|failure| plan.told(failure, &jogged)),
    };
    let end = both(failure.map_or(Ok(()), Err), given_back);
    plan.end(arguments, rig, &jogged, end, output)
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_motion::guard::{Cause, State};

    #[test]
    fn an_angle_has_a_unit_and_is_a_number() {
        assert!((angle("5deg").unwrap() - 0.087_266_462_599_716_47).abs() < 1e-15);
        assert_eq!(angle("-0.1rad"), Ok(-0.1));
        for text in ["5", "deg", "5 grad", "NaNdeg", "infrad", "", "1e400rad"] {
            assert!(angle(text).unwrap_err().contains("5deg or -0.1rad"), "{text}");
        }
    }

    #[test]
    fn a_torque_above_the_limit_of_the_rig_is_noted() {
        let rig = config::load_rig(config::builtin("paper-admittance.yaml")).unwrap().value;
        let note = |torque| lowered(&rig, Positive::new(torque));
        assert_eq!(note(60.0), None);
        let text = note(500.0).unwrap();
        assert!(text.starts_with("--torque 500 N m is above") && text.ends_with("is 60 N m"), "{text}");
    }

    #[test]
    fn more_torque_is_advised_for_the_joint_that_is_led_and_stands_and_for_no_other() {
        let limits = LeadLimits { rate_rad_per_s: 0.1, acceleration_rad_per_s2: 0.5 };
        let bound = Positive::new(0.1).unwrap();
        let plan = Plan {
            joint: 0,
            jog: Jog { by: JointAngles::new(0.08, 0.0), keys: None, limits, settling: 1, is_metered: false },
            bounds: Bounds { motion_rad: bound, torque_n_m: Positive::new(5.0).unwrap() },
        };
        let advice = |fault, devices, gone_rad| {
            let from = JointAngles::new(1.0, 0.5);
            let jogged = Jogged {
                ended: Ended::Stopped,
                state: State::Disabled,
                cause: Some(Cause { fault, devices }),
                time_s: 0.1,
                from,
                to: from + JointAngles::new(gone_rad, 0.0),
                deviation: JointAngles::default(),
            };
            let failure = plan.told(Failure::new(Exit::SafetyStop, "stopped", "as the fault says"), &jogged);
            failure.report.diagnostics[0].help.clone().unwrap()
        };
        let [left, right] = [0, 1].map(DeviceSet::drive);
        assert!(advice(Fault::FollowingError, left, 1e-4).contains("raise --torque"));
        // A joint that ran away, or did not continue.
        assert!(advice(Fault::FollowingError, left, -5e-3).contains("0.29 deg of motion opposite to the reference"));
        assert!(advice(Fault::FollowingError, left, 5e-3).contains("a frozen encoder"));
        // The one that was to hold, and another fault.
        for (fault, devices, gone_rad) in [
            (Fault::FollowingError, right, 0.0),
            (Fault::FollowingError, left | right, 0.0),
            (Fault::EncoderJump, left, 0.0),
        ] {
            assert_eq!(advice(fault, devices, gone_rad), "as the fault says", "{fault:?}");
        }
    }
}
