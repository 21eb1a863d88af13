//! `yieldwall tune loop`: inertia, friction and delay of each joint from its motion, and gains from them.

mod force;
mod page;

use std::path::PathBuf;

use serde_json::{Value, json};

use super::gains::{Proposal, file, nothing, set};
use crate::bus::check_buses;
use crate::commission::add_defects;
use crate::ending::{rig_failure, stopped_by};
use crate::failure::{self, Exit, Failure, both};
use crate::fit;
use crate::interrupt::{interrupted, on_interrupt};
use crate::margins::Margins;
use crate::masses::Masses;
use crate::output::Output;
use crate::replace::Replace;
use crate::report_text::stopped_verdict;
use yieldwall_config::{self as config, CommandMode, ControlLaw, Loaded, Positive, Rig, Source};
use yieldwall_motion::control::Grip;
use yieldwall_motion::guard::Fault;
use yieldwall_motion::identification::{Estimate, Friction, NotIdentified};
use yieldwall_rig::EmbeddedRig;
use yieldwall_rig::analysis::{
    PROPOSED_MARGINS, PoseMargins, has_margins, identified_margins, proposed_gains, usual_hands,
};
use yieldwall_run::{
    Ended, ForceFound, JointFound, JointLoop, LOOP_BOUND_RAD, LoopPlan, LoopTraced, NotProven, STEP_RISE_S,
};

/// Beside the exact bound: so much more sliding time keeps an axis from overshooting after a saturation.
///
/// # Source
/// [`Psmc`](yieldwall_motion::control::Psmc).
const SLIDING_FACTOR: f64 = 1.3;
/// Share of the identified dry friction that a feed-forward may have: an excess over the real friction pushes a joint at rest.
const FED_SHARE: f64 = 0.8;
/// Columns of a reason beside the joint and the label.
const REASON_COLUMNS: usize = fit::USUAL - 20;

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Rig file; `builtin:paper-admittance.yaml` is the copy in the program
    #[arg(value_name = "RIG.yaml")]
    rig: String,
    /// Torque limit of each drive in N m, written to 6072h; default: 25 % of the lower rated torque, then 35 and 50 %
    #[arg(long, value_name = "N_M", value_parser = torque)]
    torque: Option<Positive>,
    /// Write the gains into the file after a person confirms; change nothing else in it
    #[arg(long)]
    write: bool,
    /// Confirm the motion on a bus and the gains without a question, for scripts
    #[arg(long)]
    yes: bool,
    /// Write the measurements as an HTML page, with Bode plot and step response
    #[arg(long, value_name = "FILE.html")]
    html: Option<PathBuf>,
    #[command(flatten)]
    replace: Replace,
    /// Inject a defect into the simulated machine, as with `commission`; repeatable
    #[cfg_attr(target_os = "linux", arg(conflicts_with = "bus"))]
    #[arg(long, value_name = "NAME[=SIZE][:left|right]")]
    defect: Vec<String>,
    #[cfg(target_os = "linux")]
    #[command(flatten)]
    on_bus: crate::first_motion::OnBus,
}

fn torque(text: &str) -> Result<Positive, String> {
    let value = text.parse().ok().and_then(Positive::new);
    value.ok_or_else(|| format!("write a torque in N m above 0, such as 15, not `{text}`"))
}

pub(crate) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let rig = config::load_rig(Source::named(&arguments.rig))?;
    output.configuration(&rig.warnings)?;
    check_buses(&rig, None, output)?;
    if let Some(html) = &arguments.html {
        arguments.replace.check_can_write(html)?;
    }
    if arguments.write {
        file::check_can_write(&rig)?;
    }
    crate::jog::note_lowered(&rig.value, arguments.torque, output);
    let plans = [0, 1].map(|joint| LoopPlan { joint, torque_n_m: arguments.torque });
    #[cfg(target_os = "linux")]
    if arguments.on_bus.is_asked() {
        return on_bus(arguments, &plans, &rig, output);
    }
    let mut scene = rig.scene()?.value;
    add_defects(&mut scene, &rig.value, &arguments.defect)?;
    let is_interrupted = on_interrupt()?;
    let machine = EmbeddedRig::new(&rig.value, &scene, &rig.value.fixture, scene.seed);
    let mut machine = machine.map_err(|error| rig_failure(&error))?;
    output.simulated("arm", &rig.value, "hands off");
    let mut traced = Vec::new();
    for plan in &plans {
        let one = machine.tune_loop(&rig.value, plan, &is_interrupted).map_err(|error| rig_failure(&error))?;
        traced.push(one.map_err(|error| match error {
            NotProven::Run(error) => crate::on_bus::live_failure(&error),
            NotProven::Unproven(error) => Failure::new(Exit::SafetyStop, error.to_string(), ""),
        })?);
        if traced.last().is_none_or(|last| last.found.is_none()) {
            break;
        }
    }
    end(arguments, &rig, &traced, (|_: &LoopTraced, failure| failure, Ok(())), output)
}

#[cfg(target_os = "linux")]
fn on_bus(arguments: &Arguments, plans: &[LoopPlan], rig: &Loaded<Rig>, output: &mut Output) -> Result<(), Failure> {
    use crate::confirm::agreed;
    use crate::events::Events;
    use crate::first_motion::{Opened, concluded};
    use crate::live::{ended, not_run};
    use crate::on_bus::warn;
    use yieldwall_run::host::News;

    let what = format!(
        "Each joint moves back and forth for half a minute: by {:.1} degrees at most, at up to 20 degrees per second, with small vibrations. Confirm: \
         the arm is free to move, nobody holds it, and one hand is on the emergency stop",
        LOOP_BOUND_RAD.to_degrees()
    );
    if !arguments.yes && !agreed(&what) {
        return Err(Failure::new(Exit::Usage, "nothing was done", "answer yes, or add --yes"));
    }
    let events = Events::of(output);
    let opened = arguments.on_bus.open("tune loop", &arguments.rig, rig, output)?;
    let Opened { on_bus, terms, interfaces, is_interrupted } = opened;
    let outcome = on_bus.tune_loop(&terms, plans, &is_interrupted, |news| match news {
        News::Refused(refusal) => warn(output, refusal),
        // It is booted for every joint.
        News::Step(_) | News::Proved => {}
        news => events.news(news),
    });
    let (outcome, given_back) = concluded(&events, outcome, output)?;
    let traced = match &outcome.played {
        Ok(traced) => traced.clone(),
        Err(error) => {
            let failure = not_run(error, &outcome, &interfaces, &rig.value, &arguments.rig);
            return both(Err(failure), given_back);
        }
    };
    let told = |traced: &LoopTraced, failure| match (traced.ended, traced.cause) {
        (Ended::Stopped, None) => failure,
        end => ended(end, traced.time_s, &outcome, &rig.value).unwrap_or(failure),
    };
    let (record, given_back) = match keep(&traced, rig, arguments.on_bus.is_by_the_clock()) {
        Ok(record) => (record, given_back),
        Err(failure) => (None, both(given_back, Err(failure))),
    };
    end(arguments, rig, &traced, (told, given_back), output)?;
    record.map_or(Ok(()), |path| output.news(&format!("record    {}", path.display())))
}

/// Saves the measurements on a bus for runs with this configuration, and returns their path.
#[cfg(target_os = "linux")]
fn keep(traced: &[LoopTraced], rig: &Loaded<Rig>, is_by_the_clock: bool) -> Result<Option<PathBuf>, Failure> {
    use yieldwall_run::MeasuredLoop;

    let found: Vec<&JointLoop> = traced.iter().filter_map(|traced| traced.found.as_ref()).collect();
    // In lockstep, time is that of the devices, and gives no information on a bus.
    let Some(joints) = joints_found(&found, &rig.value).filter(|_| is_by_the_clock) else { return Ok(None) };
    let folder = crate::live::loops()?;
    // Without the weight that has shown it the age of the force stays as it was measured.
    let before = || MeasuredLoop::load(&rig.value, &folder).ok().flatten().and_then(|before| before.force(&rig.value));
    let force = ForceFound::of(&found).or_else(before);
    let stored = MeasuredLoop::new(&rig.value, joints, force).store(&folder);
    stored.map(Some).map_err(|error| {
        Failure::new(Exit::Usage, format!("{}: {error}", folder.display()), "make this folder writable")
    })
}

/// Judges, proposes, writes and prints; `told` adds the drives' reports to a failure.
fn end(
    arguments: &Arguments,
    rig: &Loaded<Rig>,
    traced: &[LoopTraced],
    (told, given_back): (impl Fn(&LoopTraced, Failure) -> Failure, Result<(), Failure>),
    output: &mut Output,
) -> Result<(), Failure> {
    let found: Vec<&JointLoop> = traced.iter().filter_map(|traced| traced.found.as_ref()).collect();
    let stopped = traced.iter().zip(&rig.value.drives).enumerate().find_map(|(joint, (traced, drive))| {
        traced.found.is_none().then(|| told(traced, failure(traced, joint, &drive.name, &rig.value)))
    });
    let judged = stopped.map_or_else(|| judge(&found, &rig.value), Err);
    // Only values of both joints allow conclusions on the rig.
    let joints = joints_found(&found, &rig.value).filter(|_| judged.is_ok());
    let (proposal, judged) = match joints.map(|joints| propose(rig, &joints)) {
        Some(Ok(proposal)) => (Some(proposal), judged),
        Some(Err(error)) => (None, judged.and(Err(error))),
        None => (None, judged),
    };
    let mut judged = both(judged, given_back);
    // With the gains that are proposed; a rig without a scene has no hand to be held by.
    let held = proposal.as_ref().map_or(rig, Proposal::tuned);
    let force = ForceFound::of(&found);
    let usual = |hand: &Grip| usual_hands(hand).to_vec();
    let masses = joints.and_then(|joints| Masses::of_identified(held, &joints, force.as_ref(), usual).ok());
    if let Some(masses) = &masses {
        output.warnings(&masses.finding(held).into_iter().collect::<Vec<_>>());
    }
    if let Some(html) = &arguments.html {
        let page = page::html(&rig.value, &found, proposal.as_ref().map(|proposal| &proposal.tuned().value));
        // The results are printed, whatever happens to the file.
        match arguments.replace.write(html, page.as_bytes()) {
            Ok(()) => output.news(&format!("page      {}", html.display()))?,
            Err(failure) => judged = both(judged, Err(failure)),
        }
    }
    if !output.is_json() {
        let stop =
            traced.iter().find(|traced| traced.found.is_none() && !traced.ran_away && traced.ended == Ended::Stopped);
        let stop = stop.and_then(|traced| Some((traced.time_s, traced.cause?)));
        let mut text = match (&judged, stop) {
            (Err(failure), Some((time_s, cause))) => stopped_verdict(failure, time_s, cause, &rig.value),
            _ => failure::verdict(&judged, || match &proposal {
                Some(_) => "both joints identified, gains proposed".to_owned(),
                None => "friction of both joints identified".to_owned(),
            }),
        };
        text += "\n";
        text += &found.iter().map(|joint| joint_text(joint, &rig.value)).collect::<String>();
        for advice in advice(&found, &rig.value) {
            text += &format!("{}\n", fit::filled("advice    ", "          ", &advice, fit::USUAL));
        }
        if let Some(proposal) = &proposal {
            text += &proposal.text(&rig.value);
        }
        for line in masses.iter().flat_map(Masses::lines) {
            text += &format!("{line}\n");
        }
        output.result(&text)?;
    }
    let written = match &proposal {
        Some(proposal) => match proposal.write(rig, arguments.write, arguments.yes) {
            Ok(written) => written,
            Err(failure) => {
                judged = both(judged, Err(failure));
                None
            }
        },
        None => None,
    };
    if output.is_json() {
        let gains = proposal.as_ref().map(|proposal| proposal.document(&rig.value, written.as_deref()));
        let joints = found.iter().map(|joint| joint_json(joint, &rig.value));
        return output.end(
            json!({
                "rig": rig.value.rig.name,
                "joints": joints.collect::<Vec<_>>(),
                "advice": advice(&found, &rig.value),
                "force": force::json(&found, &rig.value),
                "proposal": gains,
                "masses": masses.as_ref().map(|masses| masses.to_json(super::RESERVE)),
            }),
            judged,
        );
    }
    judged?;
    match &proposal {
        Some(proposal) => proposal.tell(written.as_deref(), output),
        None => Ok(()),
    }
}

/// Returns the failure of a joint that did not complete its course.
fn failure(traced: &LoopTraced, joint: usize, name: &str, rig: &Rig) -> Failure {
    let torque = traced.torque_n_m;
    let is_weak = traced.cause.is_some_and(|cause| cause.fault == Fault::FollowingError);
    match traced.ended {
        Ended::Interrupted => interrupted(traced.time_s),
        _ if traced.ran_away => Failure::new(
            Exit::SafetyStop,
            format!("the joint of {name} moved opposite to its reference"),
            "check `direction` of the drive and its encoder; `yieldwall commission` finds which one is inverted",
        ),
        Ended::Stopped if is_weak => {
            let mut failure = stopped_by(traced.cause, traced.time_s, rig);
            let help = format!(
                "the joint of {name} does not follow its course with {torque:.1} N m: raise --torque, or check whether `control.gains` are too soft"
            );
            failure.report.diagnostics.iter_mut().take(1).for_each(|diagnostic| diagnostic.help = Some(help.clone()));
            failure
        }
        Ended::Whole => Failure::new(
            Exit::OutOfTolerance,
            format!(
                "{torque:.1} N m were too little for the course of the joint of {name}: torque at its limit shows no inertia"
            ),
            "raise --torque",
        ),
        Ended::Stopped if traced.cause.is_none() => Failure::new(
            Exit::SafetyStop,
            format!(
                "the rig stopped after {:.3} s, before joint {joint} ({name}) reached the end of its course",
                traced.time_s
            ),
            "move the arm to the middle of its workspace by hand",
        ),
        _ => stopped_by(traced.cause, traced.time_s, rig),
    }
}

/// Checks that all values were identified.
fn judge(found: &[&JointLoop], rig: &Rig) -> Result<(), Failure> {
    for joint in found {
        let name = rig.drives.get(joint.joint).map_or("", |drive| drive.name.as_str());
        // What a drive keeps to itself is no failure.
        let of_dynamics = joint.dynamics.as_ref().err().copied().filter(|error| *error != NotIdentified::InDrive);
        let errors = [("friction", joint.friction.err()), ("inertia", of_dynamics)];
        let Some((what, error)) = errors.into_iter().find_map(|(what, error)| Some((what, error?))) else { continue };
        let help = match error {
            NotIdentified::TooFew if joint.is_told => {
                "the drive reports its torque (6077h) too seldom: check its answers with `yieldwall commission`"
            }
            NotIdentified::Stands => "the joint sticks at 10 degrees per second: check its loop and its friction",
            NotIdentified::NoDelay { .. } => "check what delays the torque, such as filters of the drive",
            _ => "check the joint with `yieldwall commission`, and measure again",
        };
        return Err(Failure::new(Exit::OutOfTolerance, format!("{what} of {name}: {error}"), help));
    }
    Ok(())
}

/// Returns the identified values of both joints, if this program closes their loop.
fn joints_found(found: &[&JointLoop], rig: &Rig) -> Option<[JointFound; 2]> {
    let [left, right] = found else { return None };
    (rig.rig.command_mode == CommandMode::Torque).then_some([left.found()?, right.found()?])
}

/// Proposes gains from the identified values.
fn propose(rig: &Loaded<Rig>, joints: &[JointFound; 2]) -> Result<Proposal, Failure> {
    let margins = |rig: &Rig| -> Result<PoseMargins, Failure> {
        identified_margins(rig, joints).map_err(|error| rig_failure(&error))?.ok_or_else(nothing)
    };
    let before = margins(&rig.value)?;
    let gains = proposed_gains(&rig.value, &before).ok_or_else(nothing)?;
    let mut tuned = rig.clone();
    set(&mut tuned.value.control.gains, gains.gains);
    let after = margins(&tuned.value)?;
    let worst = [after.worst.without_friction, after.worst.with_friction];
    if !worst.iter().all(|worst| has_margins(worst, PROPOSED_MARGINS)) {
        return Err(nothing());
    }
    Ok(Proposal::new(rig, tuned, [before, after].map(Margins::Torque)))
}

/// Returns the viscous friction if it was identified: in position mode, the drive's reaction within a cycle changes with the rate
/// too.
fn viscous<'a>(friction: &'a Friction, rig: &Rig) -> Option<&'a Estimate> {
    (rig.rig.command_mode != CommandMode::Position).then_some(&friction.viscous_n_m_s_per_rad)
}

fn plus_minus(estimate: &Estimate, factor: f64, digits: usize) -> String {
    format!("{:.digits$} +- {:.digits$}", factor * estimate.value, factor * estimate.half_width())
}

/// Returns the identified values of a joint, a line each: the joint, a label, the value.
fn joint_text(joint: &JointLoop, rig: &Rig) -> String {
    let name = rig.drives.get(joint.joint).map_or("", |drive| drive.name.as_str());
    let [left, right] = joint.pose.to_array().map(f64::to_degrees);
    let period_s = f64::from(rig.cycle.period_us) * 1e-6;
    let mut lines = Vec::new();
    match &joint.dynamics {
        Ok(dynamics) => {
            lines.push(("inertia", format!("{} kg m^2", plus_minus(&dynamics.inertia_kg_m2, 1.0, 4))));
            lines.push(("", format!("mean over the travel, near {left:.1} and {right:.1} deg")));
            let cycles = dynamics.delay_s.value / period_s;
            let delay = plus_minus(&dynamics.delay_s, 1e3, 3);
            lines.push(("delay", format!("{delay} ms from angle to torque ({cycles:.2} cycles)")));
            lines.push(("residual", format!("{:.1} % of the torque not explained", 100.0 * dynamics.misfit)));
        }
        Err(error) => lines.extend(not_identified("inertia", "", error)),
    }
    match &joint.friction {
        Ok(friction) => {
            lines.push(("friction", format!("dry {} N m", plus_minus(&friction.coulomb_n_m, 1.0, 3))));
            let viscous = match viscous(friction, rig) {
                Some(viscous) => format!("viscous {} N m s/rad", plus_minus(viscous, 1.0, 3)),
                None => "viscous not identified".to_owned(),
            };
            lines.push(("", viscous));
            // Zero has no sign.
            let offset = (100.0 * friction.offset_n_m).round() / 100.0 + 0.0;
            lines.push(("offset", format!("{offset:.2} N m in both directions (gravity, cables)")));
        }
        Err(error) => lines.extend(not_identified("friction", "", error)),
    }
    lines.extend(force::lines(&joint.handle));
    if let Some(lag_s) = joint.lag_s.filter(|_| joint.is_told) {
        lines.push(("lag", format!("{:.2} ms from set-point to angle, loop in the drive", 1e3 * lag_s)));
    }
    if let Some(step) = &joint.step {
        let rise = step.rise_s.map_or("none: the angle does not reach the step".to_owned(), |rise| {
            // It is seen once a cycle.
            let rise = if rise > 0.0 { format!("{:.1} ms", 1e3 * rise) } else { "less than a cycle".to_owned() };
            format!("{rise} (reference {:.1} ms)", 1e3 * STEP_RISE_S)
        });
        lines.push(("step", format!("rise time {rise}")));
        lines.push(("", format!("overshoot {:.0} % (reference 0 %)", 100.0 * step.overshoot)));
    }
    lines.push(("torque", format!("limit {:.1} N m, set in both drives", joint.torque_n_m)));
    if joint.left_out > 0 {
        lines.push(("cycles", format!("{} parts of the course omitted, since cycles are missing", joint.left_out)));
    }
    lines.iter().map(|(label, text)| format!("{name:9} {label:9} {text}\n")).collect()
}

/// Returns the lines of a value that was not identified, with the reason.
fn not_identified(label: &'static str, what: &str, error: &NotIdentified) -> Vec<(&'static str, String)> {
    let reason = fit::filled("", "", &error.to_string(), REASON_COLUMNS);
    let reason = reason.lines().map(|line| ("", line.to_owned()));
    [(label, format!("{what}not identified:"))].into_iter().chain(reason).collect()
}

/// Returns further conclusions on the rig file from the identified values.
fn advice(found: &[&JointLoop], rig: &Rig) -> Vec<String> {
    let mut lines = Vec::new();
    for joint in found {
        let (Some(drive), Ok(friction)) = (rig.drives.get(joint.joint), &joint.friction) else { continue };
        let fed = rig.control.feed_forward.coulomb_n_m[joint.joint].get();
        let most = FED_SHARE * friction.coulomb_n_m.low;
        if rig.rig.command_mode == CommandMode::Torque && fed > friction.coulomb_n_m.low {
            lines.push(format!(
                "`control.feed_forward.coulomb_n_m` of {} is {fed:.1} N m, above its friction, and pushes a joint at rest; write {most:.1}",
                drive.name
            ));
        } else if rig.rig.command_mode == CommandMode::Torque && fed < 0.8 * most {
            lines.push(format!(
                "`control.feed_forward.coulomb_n_m` of {} is {fed:.1} N m; its friction allows up to {most:.1} N m",
                drive.name
            ));
        }
    }
    let bound = found
        .iter()
        .filter_map(|joint| {
            let (dynamics, friction) = (joint.dynamics.as_ref().ok()?, joint.friction.as_ref().ok()?);
            let torque = rig.guard.torque_limit_n_m.get() + friction.coulomb_n_m.low;
            let most = rig.guard.joint_speed_limit_rad_per_s.get();
            Some(SLIDING_FACTOR * most * dynamics.inertia_kg_m2.value / (2.0 * torque))
        })
        .fold(0.0, f64::max);
    let is_psmc = rig.rig.command_mode == CommandMode::Torque && rig.control.law == ControlLaw::Psmc;
    if is_psmc && bound > rig.control.sliding_time_s.get() {
        lines.push(format!(
            "`control.sliding_time_s` is {} s: from {bound:.4} s on, PSMC does not overshoot after a saturation at \
             `guard.joint_speed_limit_rad_per_s`",
            rig.control.sliding_time_s.get()
        ));
    }
    lines.extend(force::advice(found, rig));
    match rig.rig.command_mode {
        CommandMode::Torque => {}
        CommandMode::Velocity => lines.push(
            "the velocity loop closes in the drives, which hides inertia and torque delay; `yieldwall tune gains` proposes the rate gain".to_owned(),
        ),
        CommandMode::Position => lines.push(
            "the position loop closes in the drives, which hides inertia, viscous friction and torque delay; this program has no gains: tune the \
             drives with their manufacturer's program"
                .to_owned(),
        ),
    }
    lines
}

fn estimate_json(estimate: &Estimate) -> Value {
    json!({ "value": estimate.value, "low": estimate.low, "high": estimate.high })
}

fn joint_json(joint: &JointLoop, rig: &Rig) -> Value {
    let estimate = estimate_json;
    let complex = |hz: f64, z: nalgebra::Complex<f64>| json!({ "frequency_hz": hz, "re": z.re, "im": z.im });
    let dynamics = joint.dynamics.as_ref().ok();
    let friction = joint.friction.as_ref().ok();
    let responses = dynamics.map(|dynamics| {
        dynamics.responses.iter().map(|response| complex(response.frequency_hz, response.plant)).collect::<Vec<_>>()
    });
    json!({
        "joint": rig.drives.get(joint.joint).map(|drive| &drive.name),
        "pose_rad": joint.pose.to_array(),
        "inertia_kg_m2": dynamics.map(|dynamics| estimate(&dynamics.inertia_kg_m2)),
        "coulomb_n_m": friction.map(|friction| estimate(&friction.coulomb_n_m)),
        "viscous_n_m_s_per_rad": friction.and_then(|friction| viscous(friction, rig)).map(estimate),
        "offset_n_m": friction.map(|friction| friction.offset_n_m),
        "delay_s": dynamics.map(|dynamics| estimate(&dynamics.delay_s)),
        "misfit": dynamics.map(|dynamics| dynamics.misfit),
        "force": force::handle_json(&joint.handle),
        "lag_s": joint.lag_s,
        "is_torque_told": joint.is_told,
        "torque_limit_n_m": joint.torque_n_m,
        "left_out": joint.left_out,
        "step": joint.step.as_ref().map(|step| json!({ "rise_s": step.rise_s, "overshoot": step.overshoot })),
        "plant_rad_per_n_m": responses,
        "angle_over_reference": joint.follows.iter().map(|it| complex(it.frequency_hz, it.ratio)).collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use std::ffi::OsString;
    use std::fs;

    use super::*;
    use crate::run;
    use yieldwall_config::{ControlGains, builtin, load_rig};

    fn exit(arguments: &[&str]) -> Exit {
        run(["yieldwall", "-q", "--json"].into_iter().chain(arguments.iter().copied()).map(OsString::from))
    }

    #[test]
    fn three_gains_are_written_when_that_is_confirmed_and_every_other_byte_stays() {
        let folder = std::env::temp_dir().join(format!("yieldwall-tune-loop-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let text = builtin("paper-admittance.yaml").read().unwrap().to_string();
        let before = text.replace("simulation: simulations/", "simulation: builtin:simulations/");
        let (file, html) = (folder.join("rig.yaml"), folder.join("loop.html"));
        fs::write(&file, &before).unwrap();
        let [rig, page] = [&file, &html].map(|path| path.display().to_string());
        assert_eq!(exit(&["tune", "loop", &rig, "--html", &page]), Exit::Ok);
        assert_eq!(fs::read_to_string(&file).unwrap(), before, "nothing is written without being asked to");
        let page = fs::read_to_string(&html).unwrap();
        assert_eq!(page.matches("<svg").count(), 4, "a Bode plot and a step of each joint");
        assert_eq!(exit(&["tune", "loop", &rig, "--write", "--yes"]), Exit::Ok);
        let after = fs::read_to_string(&file).unwrap();
        let differ: Vec<&str> =
            before.lines().zip(after.lines()).filter(|(one, other)| one != other).map(|(_, other)| other).collect();
        let gains = |rig: &str| load_rig(Source::named(rig)).unwrap().value.control.gains;
        assert!(differ.len() == 3 && differ.iter().all(|line| line.contains("_n_m_")), "{differ:?}");
        assert!(matches!(gains(&rig), ControlGains::Joint { .. }) && before.lines().count() == after.lines().count());
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn what_comes_with_the_program_is_not_written_to_and_too_little_torque_is_said() {
        assert_eq!(exit(&["tune", "loop", "builtin:paper-admittance.yaml", "--write", "--yes"]), Exit::Usage);
        let weak = exit(&["tune", "loop", "builtin:paper-admittance.yaml", "--torque", "8"]);
        assert!(matches!(weak, Exit::SafetyStop | Exit::OutOfTolerance), "{weak:?}");
        assert_eq!(exit(&["tune", "loop", "builtin:paper-admittance.yaml", "--torque", "-8"]), Exit::Usage);
    }
}
