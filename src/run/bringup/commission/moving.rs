//! The steps in which the rig is enabled.

use super::bench::{Bench, Found, Halt, RATE, Travel};
use super::resting::{NOBODY_PULLS, PULL_N};
use super::{Curve, Figure};
use crate::bringup::drill::drill;
use crate::bringup::jog::Jogged;
use crate::drilled::{DRILL_LIMIT, Demands, TORQUE_LIMIT};
use crate::pace::Pace;
use crate::scene::Ended;
use yieldwall_motion::guard::{Cause, Fault, State};
use yieldwall_motion::quantity::{Force, JointAngles};

/// How far each link is turned in a step, rad.
pub(super) const ROTATION_RAD: f64 = 4.0 * std::f64::consts::PI / 180.0;
pub(super) const TRAVEL_RAD: f64 = 8.0 * std::f64::consts::PI / 180.0;
/// How far a joint may go beyond its way, rad. A reference is stopped at 0.02; an arm that is stopped still slides.
pub(super) const BEYOND_RAD: f64 = 0.05;
/// How far the reference may be guided beyond the travel, rad.
pub(super) const LED_BEYOND_RAD: f64 = 0.02;
/// Shares of the rated torque with which a joint is tried to be moved, one after the other: with little torque nothing runs away far.
pub(super) const TORQUE_SHARES: [f64; 5] = [0.1, 0.15, 0.22, 0.33, 0.5];
/// A joint that has gone so far the other way runs away, rad.
const AWAY_RAD: f64 = 2e-3;
/// Largest difference between the turn of a link and the one that its encoder reports, %.
const TURNED_PERCENT: f64 = 5.0;
/// From this difference between both ways on it is play, %.
const PLAY_PERCENT: f64 = 2.5;
/// Largest permitted difference between a motor's torque and the torque that its drive reports, %.
const MOTOR_PERCENT: f64 = 15.0;
/// Friction may be so much more than what the rig file feeds forward; where that is none, this share of the rated torque.
const FRICTION_FACTOR: f64 = 1.5;
const FRICTION_SHARE: f64 = 0.3;
/// Half of the way from the least torque to the greatest along a way, as a share of the rated torque.
const RIPPLE_SHARE: f64 = 0.04;
/// A ripple shorter than this is noise, rad.
const RIPPLE_RAD: f64 = 0.6 * std::f64::consts::PI / 180.0;
/// Samples of torque that a travel has at least.
const LEAST_SAMPLES: usize = 20;

/// A link that was turned with as little torque as it took.
struct Gentle {
    /// The travel that came to its end.
    travel: Travel,
    /// The torque limit of it, N m.
    torque_n_m: f64,
    /// How far the link has gone by its encoder since the first travel, which had less torque, began, rad.
    way_rad: f64,
}

impl Bench<'_> {
    /// Drills the watchdogs of the drives.
    pub(super) fn watchdogs(&mut self, found: &mut Found) -> Result<(), Halt> {
        if self.runner.pace() == Pace::Lockstep {
            return Err(Halt::Skipped("no drill in lockstep; it was done in virtual time".to_owned()));
        }
        self.boot()?;
        let identities = self.runner.identities()?;
        let drilled = drill(self.runner, self.settling, self.is_interrupted, |_| ())?;
        let demands = Demands::of(self.rig);
        let limit = if demands.is_torque { TORQUE_LIMIT } else { DRILL_LIMIT };
        // The one that is fastest when the master dies counts.
        let mut fastest_ms = [f64::INFINITY; 2];
        for finding in &drilled.findings {
            let ms = finding.stopped_after.map(|after| after.map(|after| 1e3 * after.as_secs_f64()));
            let guards = finding.watchdog.guards_against_silence();
            for (fastest, ms) in fastest_ms.iter_mut().zip(ms).filter(|_| guards) {
                *fastest = fastest.min(ms.unwrap_or(f64::INFINITY));
            }
            let text = |ms: Option<f64>| ms.map_or("goes on".to_owned(), |ms| format!("stops after {ms:.1} ms"));
            let [left, right] = ms.map(text);
            found.note(
                format!("without {}", finding.watchdog.name()),
                format!("{} {left}, {} {right}", self.name(0), self.name(1)),
            );
        }
        let [left, right] = fastest_ms;
        found.measure(Figure {
            what: "time to stop after the master fails".into(),
            value: left.max(right),
            limit: 1e3 * limit.as_secs_f64(),
            unit: "ms".into(),
        });
        for settled in drilled.settled(self.rig) {
            found.note(
                format!("a line for the profile `{}`", settled.profile),
                format!("{}: {}", settled.key, settled.value),
            );
        }
        // One that was not passed is kept too: it takes the place of an older one.
        let record = self.attendant.keep(self.rig, identities, &drilled).map_err(Halt::Failed)?;
        if let Some(record) = record {
            found.note("record", record);
        }
        let judged = drilled.judge(demands).map_err(|error| Halt::Failed(error.to_string()));
        self.drilled = Some(drilled);
        judged
    }

    /// Turns each link, and asks who looks at it by how much.
    pub(super) fn rotation(&mut self, found: &mut Found) -> Result<(), Halt> {
        let mut unseen = None;
        for joint in 0..2 {
            let name = self.name(joint);
            let by_rad = self.free_way(joint, ROTATION_RAD)?;
            // A person is asked with nothing booted.
            self.runner.leave();
            self.attendant.look(&self.runner.place, joint);
            let Gentle { torque_n_m, way_rad: measured_rad, .. } = self.travel_gently(joint, by_rad)?;
            self.runner.leave();
            found.note(
                format!("{name}: turned"),
                format!("{:.3} deg by its encoder (torque limit {torque_n_m:.1} N m)", measured_rad.to_degrees()),
            );
            let seen = self.attendant.turned(&self.runner.place, joint);
            if seen.is_some() {
                self.attendant.look(&self.runner.place, joint);
            }
            // One that went on while its encoder stood still is not led back all the way.
            let most_rad = ROTATION_RAD + LED_BEYOND_RAD;
            let back_rad = self.travel_gently(joint, -measured_rad.clamp(-most_rad, most_rad))?.way_rad;
            self.runner.leave();
            let Some((seen_rad, seen_back_rad)) = seen.zip(self.attendant.turned(&self.runner.place, joint)) else {
                unseen = Some(name);
                continue;
            };
            found.note(
                format!("{name}: seen to turn"),
                format!("{:.3} deg, then {:.3} deg back", seen_rad.to_degrees(), seen_back_rad.to_degrees()),
            );
            self.judge_rotation(joint, [[measured_rad, seen_rad], [back_rad, seen_back_rad]], found)?;
        }
        let told = |name| {
            Halt::Skipped(format!("moved, not judged: no link ran away, and nobody measured the turn of {name}"))
        };
        unseen.map_or(Ok(()), |name| Err(told(name)))
    }

    /// Compares the turn of a link there and back by its encoder with the turn that was seen, rad.
    fn judge_rotation(&self, joint: usize, ways: [[f64; 2]; 2], found: &mut Found) -> Result<(), Halt> {
        let name = self.name(joint);
        let [[forth_rad, seen_rad], [back_rad, seen_back_rad]] = ways;
        if forth_rad * back_rad < 0.0 && seen_rad * seen_back_rad > 0.0 {
            // Nothing is told of the drive by what cannot be.
            return Err(Halt::Failed(format!(
                "the encoder of {name} turned back and forth, but both angles of its link have the same sign: one sign is wrong \
                 (counter-clockwise, seen from above, is positive)"
            )));
        }
        for [measured_rad, seen_rad] in ways {
            found.measure(Figure {
                what: "error of the encoder angle".into(),
                value: 100.0 * (measured_rad / seen_rad - 1.0).abs(),
                limit: TURNED_PERCENT,
                unit: "%".into(),
            });
            if seen_rad == 0.0 {
                return Err(Halt::Failed(format!(
                    "the link of {name} does not turn with its encoder: check the coupling between them"
                )));
            }
            if seen_rad * measured_rad < 0.0 {
                return Err(Halt::Failed(format!(
                    "the link of {name} turned opposite to its encoder: invert `direction` of the drive"
                )));
            }
        }
        if !found.is_bad() {
            return Ok(());
        }
        let [forth, back] = ways.map(|[measured_rad, seen_rad]| seen_rad / measured_rad);
        if 100.0 * (forth - back).abs() > PLAY_PERCENT {
            let play_deg = (1.0 - forth.min(back)) * ways[0][0].abs().to_degrees();
            return Err(Halt::Failed(format!(
                "the link of {name} turned by {forth:.3} of its encoder angle, and by {back:.3} on the way back: about {play_deg:.1} \
                 deg of play between motor and link. Check gear and coupling"
            )));
        }
        let counts = self.rig.drives[joint].encoder_counts_per_rev;
        let wanted = f64::from(counts) / forth;
        Err(Halt::Failed(format!(
            "the link of {name} turned by {forth:.3} of its encoder angle: `encoder_counts_per_rev` is about {wanted:.0}, not {counts}"
        )))
    }

    /// Turns a link counter-clockwise, or the other way where that is not free, with as little torque as it takes.
    fn travel_freely(&mut self, joint: usize, by_rad: f64) -> Result<Gentle, Halt> {
        let by_rad = self.free_way(joint, by_rad)?;
        self.travel_gently(joint, by_rad)
    }

    /// Turns a link by an angle with as little torque as it takes.
    fn travel_gently(&mut self, joint: usize, by_rad: f64) -> Result<Gentle, Halt> {
        let (mut last, mut first_rad, mut way_rad) = (None, None, 0.0);
        // One that is homed may not be homed yet, and begins anew with each boot then.
        let begins_anew = self.rig.drives[joint].homing.is_some();
        for share in TORQUE_SHARES {
            let torque_n_m = self.torque_n_m(share);
            if last == Some(torque_n_m) {
                break;
            }
            last = Some(torque_n_m);
            let travel = self.travel(joint, by_rad, by_rad.abs() + LED_BEYOND_RAD, torque_n_m)?;
            let gone = way(&travel.jogged, joint);
            let [from_rad, to_rad] = [travel.jogged.from, travel.jogged.to].map(|angles| angles.to_array()[joint]);
            way_rad = if begins_anew { way_rad + gone } else { to_rad - *first_rad.get_or_insert(from_rad) };
            if gone * by_rad < 0.0 && gone.abs() > AWAY_RAD {
                return Err(Halt::Failed(format!(
                    "the joint of {} moved opposite to its reference by {:.1} deg: its encoder counts against its motor; check the polarity \
                     (607Eh) and the wires",
                    self.name(joint),
                    gone.abs().to_degrees()
                )));
            }
            if travel.jogged.ended == Ended::Whole {
                return Ok(Gentle { travel, torque_n_m, way_rad });
            }
            if !is_too_weak(&travel.jogged) {
                return Err(Halt::Failed(self.stopped(joint, &travel.jogged)));
            }
        }
        let torque_n_m = last.unwrap_or_default();
        Err(Halt::Failed(format!(
            "{torque_n_m:.1} N m do not turn the link of {}: check for a closed brake, a blocked arm, a motor without current",
            self.name(joint)
        )))
    }

    /// Returns a travel of this length that the linkage allows, counter-clockwise if possible.
    fn free_way(&mut self, joint: usize, by_rad: f64) -> Result<f64, Halt> {
        self.boot()?;
        self.idle(0.05, |_| ())?;
        for by_rad in [by_rad, -by_rad] {
            let mut way = [0.0; 2];
            way.iter_mut().skip(joint).take(1).for_each(|way| *way = by_rad);
            if self.runner.master().cycle().free_share(self.angles() + JointAngles::from(way)) >= 1.0 {
                return Ok(by_rad);
            }
        }
        Err(Halt::Failed(format!(
            "the joint of {} cannot turn by {:.0} deg in either direction, since a singularity or the edge of the workspace is near. \
             Move the arm to the middle of the workspace by hand",
            self.name(joint),
            by_rad.to_degrees()
        )))
    }

    /// Turns a link to and fro, and takes the torques of both ways: counter-clockwise, then clockwise.
    fn both_ways(&mut self, joint: usize, by_rad: f64) -> Result<[Travel; 2], Halt> {
        let one = self.travel_freely(joint, by_rad)?.travel;
        let other = self.travel_gently(joint, -way(&one.jogged, joint))?.travel;
        for travel in [&one, &other] {
            self.check_torques(joint, travel)?;
        }
        Ok(if way(&one.jogged, joint) > 0.0 { [one, other] } else { [other, one] })
    }

    fn check_torques(&self, joint: usize, travel: &Travel) -> Result<(), Halt> {
        if travel.torques.len() < LEAST_SAMPLES {
            return Err(Halt::Skipped(format!("the drive {} does not report its torque (6077h)", self.name(joint))));
        }
        Ok(())
    }

    fn stopped(&self, joint: usize, jogged: &Jogged) -> String {
        let name = self.name(joint);
        match (jogged.ended, jogged.cause) {
            (Ended::StillMoving, _) => {
                format!("a drive still reports torque after the stop of {name}: press the emergency stop")
            }
            (Ended::Panicked, _) => {
                format!("the cycle has panicked during the motion of {name}: please report it")
            }
            (_, Some(Cause { fault, devices })) => {
                let row = fault.row();
                format!(
                    "{0} ({devices}) stopped the joint of {name}: {1}; `yieldwall explain {0}` lists the checks",
                    row.name, row.meaning
                )
            }
            (_, None) if jogged.state == State::Running => {
                format!("the joint of {name} did not reach its target in time")
            }
            (_, None) => format!("the joint of {name} moved too far"),
        }
    }

    /// Turns each link without and with a known force at the tool. Averaging over both directions cancels friction, so the change
    /// of the mean is the force's torque at the joint.
    pub(super) fn motor(&mut self, found: &mut Found) -> Result<(), Halt> {
        let mut free_n_m = [0.0; 2];
        for (joint, free_n_m) in free_n_m.iter_mut().enumerate() {
            let free = self.both_ways(joint, TRAVEL_RAD)?;
            self.check_ripple(joint, &free, found)?;
            *free_n_m = mean_n_m(&free);
        }
        for (joint, free_n_m) in free_n_m.into_iter().enumerate() {
            let (force, expected_n_m) = self.best_pull(joint)?;
            self.runner.leave();
            if !self.attendant.pull(&mut self.runner.place, force) {
                return Err(Halt::Skipped(format!("moved, not judged: {NOBODY_PULLS}")));
            }
            let loaded = self.both_ways(joint, TRAVEL_RAD);
            self.runner.leave();
            self.attendant.pull(&mut self.runner.place, Force::default());
            self.judge_motor(joint, force, [expected_n_m, mean_n_m(&loaded?) - free_n_m], found)?;
        }
        Ok(())
    }

    /// Compares a joint's change of torque in N m by the geometry with the one that the drive reports.
    fn judge_motor(
        &self,
        joint: usize,
        force: Force,
        [expected_n_m, told_n_m]: [f64; 2],
        found: &mut Found,
    ) -> Result<(), Halt> {
        let name = self.name(joint);
        found.note(
            format!("{name}: {:.0} N along x, {:.0} N along y", force.x(), force.y()),
            format!("geometry {expected_n_m:.2} N m, drive {told_n_m:.2} N m"),
        );
        found.measure(Figure {
            what: "error of the reported torque".into(),
            value: 100.0 * (told_n_m / expected_n_m - 1.0).abs(),
            limit: MOTOR_PERCENT,
            unit: "%".into(),
        });
        let share = expected_n_m / told_n_m;
        if found.is_bad() && share.is_finite() && share > 0.0 {
            return Err(Halt::Failed(format!(
                "the motor of {name} makes {share:.2} of the torque that its drive reports: check rated torque (6076h), torque constant and gear"
            )));
        }
        if found.is_bad() {
            return Err(Halt::Failed(format!(
                "the torque that {name} reports (6077h) does not follow the force at the tool, or has the wrong sign"
            )));
        }
        Ok(())
    }

    /// Returns the pull, along x or along y, that loads a joint more, and the torque in N m by which its drive has to answer.
    fn best_pull(&self, joint: usize) -> Result<(Force, f64), Halt> {
        let posture = self.runner.master().cycle().linkage().forward(self.angles());
        let posture = posture.map_err(|error| Halt::Failed(error.to_string()))?;
        let answer = |force: Force| posture.joint_torques(force).map(|torques| -torques.to_array()[joint]);
        let (along_x, along_y) = (Force::new(PULL_N, 0.0), Force::new(0.0, PULL_N));
        let both = answer(along_x).and_then(|x| Ok((x, answer(along_y)?)));
        let (x, y) = both.map_err(|error| Halt::Failed(error.to_string()))?;
        Ok(if x.abs() >= y.abs() { (along_x, x) } else { (along_y, y) })
    }

    /// Looks at what changes along a way: the torque goes up and down where a motor cogs, or a gear is damaged.
    fn check_ripple(&self, joint: usize, both: &[Travel; 2], found: &mut Found) -> Result<(), Halt> {
        let name = self.name(joint);
        let [up, down] = both;
        let ripple_n_m = ripple_n_m(&up.torques).max(ripple_n_m(&down.torques));
        found.note(format!("{name}: ripple of the torque along the way"), format!("{ripple_n_m:.2} N m"));
        found.curves.push(Curve {
            title: format!("torque along the travel of {name}"),
            across: "angle in deg",
            up: "torque in N m",
            lines: [("counter-clockwise", up), ("clockwise", down)]
                .map(|(way, travel)| {
                    let points = travel.torques.iter().map(|[angle, torque]| [angle.to_degrees(), *torque]);
                    (way.to_owned(), points.collect())
                })
                .into(),
        });
        let limit = RIPPLE_SHARE * self.rig.drives[joint].rated_torque_n_m.get();
        found.measure(Figure {
            what: "torque ripple along the travel".into(),
            value: ripple_n_m,
            limit,
            unit: "N m".into(),
        });
        if found.is_bad() {
            return Err(Halt::Failed(format!(
                "the torque of {name} has a ripple of {ripple_n_m:.1} N m along the travel: cogging, a damaged gear, or something that rubs"
            )));
        }
        Ok(())
    }

    /// Turns each link to and fro: half of the difference of both torques is friction.
    pub(super) fn friction(&mut self, found: &mut Found) -> Result<(), Halt> {
        for joint in 0..2 {
            let name = self.name(joint);
            let both = self.both_ways(joint, TRAVEL_RAD)?;
            let [up, down] = &both;
            let friction_n_m = 0.5 * (up.mean_n_m() - down.mean_n_m());
            let (fed_n_m, limit) = (self.fed_friction_n_m(joint), self.most_friction_n_m(joint));
            found.note(format!("{name}: friction"), format!("{friction_n_m:.2} N m (feed-forward {fed_n_m:.2} N m)"));
            found.measure(Figure {
                what: "largest friction of a joint".into(),
                value: friction_n_m,
                limit,
                unit: "N m".into(),
            });
            if friction_n_m <= 0.0 {
                return Err(Halt::Failed(format!(
                    "the torque that {name} reports (6077h) does not reverse with the motion: it is not a torque, or has the wrong sign"
                )));
            }
            if fed_n_m > friction_n_m {
                return Err(Halt::Failed(format!(
                    "`control.feed_forward` of {name} is {fed_n_m:.1} N m, but its friction is {friction_n_m:.1} N m: the excess pushes a joint at \
                     rest; write less"
                )));
            }
            if found.is_bad() {
                return Err(Halt::Failed(format!(
                    "the joint of {name} has {friction_n_m:.1} N m of friction: check bearings, gear and brake; if the friction is right, write it \
                     into `control.feed_forward`"
                )));
            }
        }
        Ok(())
    }

    /// Returns the friction of a joint that the rig file feeds forward, N m.
    fn fed_friction_n_m(&self, joint: usize) -> f64 {
        let feed_forward = &self.rig.control.feed_forward;
        feed_forward.coulomb_n_m[joint].get() + RATE * feed_forward.viscous_n_m_s_per_rad[joint].get()
    }

    /// Returns the largest friction that a joint may have, N m.
    pub(super) fn most_friction_n_m(&self, joint: usize) -> f64 {
        let fed_n_m = self.fed_friction_n_m(joint);
        let rated_n_m = self.rig.drives[joint].rated_torque_n_m.get();
        if fed_n_m > 0.0 { FRICTION_FACTOR * fed_n_m } else { FRICTION_SHARE * rated_n_m }
    }
}

/// Returns the mean torque of both directions, N m, in which friction cancels.
fn mean_n_m([one, other]: &[Travel; 2]) -> f64 {
    0.5 * (one.mean_n_m() + other.mean_n_m())
}

/// Returns the travel of a joint, rad.
fn way(jogged: &Jogged, joint: usize) -> f64 {
    (jogged.to - jogged.from).to_array().get(joint).copied().unwrap_or_default()
}

/// Whether a joint was stopped because it does not follow; more torque may help.
fn is_too_weak(jogged: &Jogged) -> bool {
    match (jogged.ended, jogged.cause) {
        (Ended::Stopped, None) => jogged.state == State::Running,
        (Ended::Stopped, Some(cause)) => cause.fault == Fault::FollowingError,
        _ => false,
    }
}

/// Returns half of the range from the least to the greatest torque, N m, without noise and a steady rise.
fn ripple_n_m(torques: &[[f64; 2]]) -> f64 {
    let (Some([first, _]), Some([last, _])) = (torques.first(), torques.last()) else { return 0.0 };
    let count = torques.len();
    let window = ((RIPPLE_RAD / (last - first).abs().max(1e-9) * count as f64) as usize).clamp(1, count);
    let smooth: Vec<[f64; 2]> = torques
        .windows(window)
        .map(|some| {
            let sum = some.iter().fold([0.0, 0.0], |[angle, torque], [a, t]| [angle + a, torque + t]);
            sum.map(|sum| sum / window as f64)
        })
        .collect();
    let many = smooth.len() as f64;
    let mean = smooth.iter().fold([0.0, 0.0], |[angle, torque], [a, t]| [angle + a / many, torque + t / many]);
    let spread = smooth.iter().map(|[a, _]| (a - mean[0]) * (a - mean[0])).sum::<f64>();
    let together = smooth.iter().map(|[a, t]| (a - mean[0]) * (t - mean[1])).sum::<f64>();
    let slope = if spread > 0.0 { together / spread } else { 0.0 };
    let rest = smooth.iter().map(|[a, t]| t - mean[1] - slope * (a - mean[0]));
    let (least, most) = rest.fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), t| (least.min(t), most.max(t)));
    0.5 * (most - least).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ripple_is_what_a_rise_and_noise_leave() {
        let of = |torque: fn(f64) -> f64| -> Vec<[f64; 2]> {
            (0..400).map(|at| f64::from(at) * 3.5e-4).map(|angle| [angle, torque(angle)]).collect()
        };
        assert!(ripple_n_m(&of(|angle| 10.0 + 30.0 * angle)) < 1e-9);
        let cogging =
            ripple_n_m(&of(|angle| 10.0 + 30.0 * angle + 4.0 * yieldwall_motion::elementary::sin(100.0 * angle)));
        assert!((cogging - 4.0).abs() < 0.7, "{cogging}");
        assert!(ripple_n_m(&of(|angle| if ((angle * 1e6) as u64).is_multiple_of(2) { 1.0 } else { -1.0 })) < 0.5);
        assert_eq!(ripple_n_m(&[]), 0.0);
    }
}
