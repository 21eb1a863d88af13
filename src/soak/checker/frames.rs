//! Frames on the wire: senders, commands and their times.

use super::super::excuse::Excuse;
use super::super::invariant::Invariant;
use super::super::observation::{Observation, Sender, Setpoint, Sighting, Status};
use super::super::segment::OnCable;
use super::super::tolerance;
use super::{Findings, Limits, Peaks};
use yieldwall_config::CommandMode;
use yieldwall_motion::guard::{Request, State};
use yieldwall_sim::can::frame_bits;

/// SYNC.
pub(super) const SYNC: u16 = 0x080;
/// Emergencies of nodes 1 to 127.
const EMERGENCIES: std::ops::RangeInclusive<u16> = 0x081..=0x0ff;

/// SDO answers of nodes 1 to 127, and the requests to them.
const SDO_ANSWERS: std::ops::RangeInclusive<u16> = 0x581..=0x5ff;
const SDO_REQUESTS: std::ops::RangeInclusive<u16> = 0x601..=0x67f;

/// A set-point on which the next SYNC makes the drive act, and the known reports when it was computed.
#[derive(Clone, Copy, Debug)]
struct Sent {
    setpoint: Setpoint,
    known: [Option<Status>; 2],
    known_also: [Option<Status>; 2],
    is_fresh: bool,
    is_permitted: bool,
    /// SYNC of the cycle that computed it, ns; an earlier one for what was kept.
    computed_ns: u64,
    /// A broken link had kept the set-point: its cycle is unknown, so it is not judged.
    is_kept: bool,
    /// No SYNC came in its cycle: the next one may take its place.
    has_waited: bool,
}

/// Content of the frames of the last cycles.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Frames {
    /// When a foreign set-point ended, ns, after which the master has sent none that stops the drive.
    foreign_ns: [Option<u64>; 2],
    /// Last reports of the drives.
    told: [Option<Status>; 2],
    /// Reports of the drives as known at the last computation.
    known: [Option<Status>; 2],
    /// Second reports after SYNC: if two reports follow a cycle without any, the frames do not show which of them is late.
    told_also: [Option<Status>; 2],
    /// Joints that reported something between SYNC and the last computation.
    is_fresh: [bool; 2],
    /// The set-points since the last SYNC.
    sent: [Option<Sent>; 2],
    /// Whether nothing was sent between the last two SYNCs: what comes next may have waited.
    had_gap: [bool; 2],
    /// The last set-points before the last SYNC.
    before: [Option<Setpoint>; 2],
    /// SYNC of the cycle that computed them, ns.
    before_ns: u64,
    /// SYNC of the last computation, ns.
    computed_ns: u64,
    /// Whether both drives were enabled and commanded at the last SYNC.
    were_moving: bool,
    /// The person has asked to enable since the last latched or idle state.
    is_permitted: bool,
    /// Cycles in which a reset edge is still expected, and which drives have had it.
    resets: u32,
    had_reset: [bool; 2],
    state: State,
    /// Nodes whose last SDO request came from a foreign node, one bit each.
    answers_stranger: u128,
    /// Bits of the rig's own frames since the last SYNC.
    bits: u64,
    /// Cycle of that SYNC, ns.
    synced_ns: Option<u64>,
    /// On a segment, of the output frame that left last: whether each drive has taken it, once it is back.
    taken: Option<[bool; 2]>,
    /// Drives that had not when the next cycle began.
    missed: [bool; 2],
}

impl Frames {
    /// Checks the frames up to the computation, and notes the state that the computation then knows.
    pub(super) fn check(
        &mut self,
        limits: &Limits,
        seen: &Observation,
        peaks: &mut Peaks,
        findings: &mut Findings<'_>,
    ) {
        self.is_fresh = self.watch(limits, seen, peaks, findings);
        if limits.is_on_segment {
            self.check_inputs(seen, findings);
        }
        self.known = self.told;
        self.computed_ns = seen.sync_ns;
        self.note_requests(seen);
        self.state = seen.state;
    }

    /// Evaluates the frames on the wire, and returns which joints reported something after SYNC.
    pub(super) fn watch(
        &mut self,
        limits: &Limits,
        seen: &Observation,
        peaks: &mut Peaks,
        findings: &mut Findings<'_>,
    ) -> [bool; 2] {
        let (mut is_after_sync, mut has_told) = (false, [false; 2]);
        for sighting in &seen.frames {
            let frame = &sighting.frame;
            let is_ours = sighting.sender == Some(Sender::Master);
            if self.is_own_load(sighting) {
                self.bits += u64::from(frame_bits(frame));
            }
            self.watch_strangers(limits, seen, sighting, findings);
            if is_ours && frame.id() == SYNC {
                if !limits.is_on_segment {
                    self.end_of_epoch(limits, seen, findings);
                }
                self.check_load(limits, seen, peaks, findings);
                is_after_sync = true;
            }
            for (joint, has_told) in has_told.iter_mut().enumerate() {
                if is_ours && frame.id() == limits.set_point_ids[joint] {
                    self.note_set_point(seen, joint, Setpoint::decode(frame), is_after_sync, findings);
                }
                if sighting.sender.is_none()
                    && frame.id() == limits.status_ids[joint]
                    && let Some(status) = Status::decode(frame)
                {
                    // Of what arrives between SYNC and the computation the first counts; before it, what is late.
                    if is_after_sync && std::mem::replace(has_told, true) {
                        self.told_also[joint] = Some(status).filter(|_| !self.is_fresh[joint]);
                    } else {
                        self.note_wrap(joint, &status, peaks);
                        (self.told[joint], self.told_also[joint]) = (Some(status), None);
                    }
                }
            }
        }
        if limits.is_on_segment {
            (is_after_sync, has_told) = self.watch_cable(limits, seen, peaks, findings);
        }
        if !is_after_sync {
            self.sent.iter_mut().flatten().for_each(|sent| sent.has_waited = true);
        }
        has_told
    }

    /// Evaluates the frames on the cable of a segment, and returns whether a cycle has begun and which joints have reported
    /// something since.
    fn watch_cable(
        &mut self,
        limits: &Limits,
        seen: &Observation,
        peaks: &mut Peaks,
        findings: &mut Findings<'_>,
    ) -> (bool, [bool; 2]) {
        let (mut has_begun, mut has_told) = (false, [false; 2]);
        for passed in &seen.on_cable {
            match passed.what {
                OnCable::Open => {
                    self.end_of_epoch(limits, seen, findings);
                    self.note_not_taken();
                    has_begun = true;
                }
                OnCable::Outputs(told) => {
                    self.taken = Some([false; 2]);
                    for (joint, setpoint) in told.into_iter().enumerate() {
                        self.note_set_point(seen, joint, setpoint, has_begun, findings);
                    }
                }
                OnCable::Taken(taken) => self.taken = self.taken.map(|_| taken),
                // What comes when the cycle is over is not used, and neither is what comes again.
                OnCable::Inputs(told) if has_begun && has_told == [false; 2] => {
                    has_told = told.map(|status| status.is_some());
                    for (joint, status) in told.into_iter().enumerate() {
                        let Some(status) = status else { continue };
                        self.note_wrap(joint, &status, peaks);
                        (self.told[joint], self.told_also[joint]) = (Some(status), None);
                    }
                }
                OnCable::Inputs(_) => {}
            }
        }
        // The input frame did not leave, and the cycle ran all the same.
        if !has_begun && seen.ran {
            self.note_not_taken();
        }
        (has_begun, has_told)
    }

    /// Marks outputs as missed that a drive has not taken by now: it does not take them any more.
    fn note_not_taken(&mut self) {
        self.missed = self.taken.take().map_or([false; 2], |taken| taken.map(|is_taken| !is_taken));
    }

    /// Checks fresh-input.
    fn check_inputs(&self, seen: &Observation, findings: &mut Findings<'_>) {
        let reported = &seen.reported;
        for joint in 0..2 {
            findings.expect(Invariant::FreshInput, self.is_fresh[joint] || !reported.has_inputs[joint], || {
                format!("the drive of joint {joint} reported nothing in this cycle, but the cycle used an input of it")
            });
            findings.expect(Invariant::FreshInput, !self.missed[joint] || reported.outputs_missed[joint], || {
                format!("the drive of joint {joint} did not take its outputs, and that was not missed")
            });
        }
    }

    /// Notes a set-point that leaves.
    fn note_set_point(
        &mut self,
        seen: &Observation,
        joint: usize,
        setpoint: Option<Setpoint>,
        is_after_sync: bool,
        findings: &mut Findings<'_>,
    ) {
        let is_false = seen.falsified.timing || seen.falsified.link;
        findings.expect_unless(Invariant::FreshSetPoint, !is_after_sync, is_false.then_some(Excuse::Falsified), || {
            format!("the set-point {setpoint:?} of the cycle before came after SYNC")
        });
        findings.expect(Invariant::FreshSetPoint, self.sent[joint].is_none_or(|sent| sent.has_waited), || {
            format!("two set-points for joint {joint} before one SYNC")
        });
        let is_kept = is_after_sync || (self.had_gap[joint] && seen.falsified.link);
        self.sent[joint] = setpoint.map(|setpoint| Sent {
            setpoint,
            known: self.known,
            known_also: self.told_also,
            is_fresh: self.is_fresh[joint],
            is_permitted: self.is_permitted,
            computed_ns: if is_kept { self.before_ns } else { self.computed_ns },
            is_kept,
            has_waited: false,
        });
    }

    /// Checks foreign-set-point. If a foreign frame ends after SYNC was due, the master does not know it when it sends SYNC.
    fn watch_strangers(
        &mut self,
        limits: &Limits,
        seen: &Observation,
        sighting: &Sighting,
        findings: &mut Findings<'_>,
    ) {
        let Sighting { time_ns, sender, frame } = sighting;
        let joints = limits.set_point_ids.iter().zip(&mut self.foreign_ns);
        if let Some((_, foreign_ns)) = joints.into_iter().find(|(id, _)| **id == frame.id()) {
            match sender {
                Some(Sender::Stranger) => *foreign_ns = Some(*time_ns),
                Some(Sender::Master) if Setpoint::decode(frame).is_some_and(|own| !own.enables()) => *foreign_ns = None,
                _ => {}
            }
        }
        if *sender == Some(Sender::Master) && frame.id() == SYNC && !seen.falsified.timing && !seen.falsified.link {
            for (joint, foreign_ns) in self.foreign_ns.iter().enumerate() {
                findings.expect(
                    Invariant::ForeignSetPoint,
                    foreign_ns.is_none_or(|end_ns| end_ns > seen.sync_ns),
                    || format!("SYNC made joint {joint} act on a foreign set-point, heard at {foreign_ns:?} ns"),
                );
            }
        }
    }

    /// Whether the frame belongs to the rig's own load in bus-load. An emergency does not, nor does a node's answer to a foreign
    /// node.
    fn is_own_load(&mut self, sighting: &Sighting) -> bool {
        let id = sighting.frame.id();
        let node = 1_u128 << (id & 0x7f);
        let is_stranger = sighting.sender.is_none_or(|sender| sender == Sender::Stranger);
        if SDO_REQUESTS.contains(&id) {
            self.answers_stranger &= !node;
            self.answers_stranger |= if is_stranger { node } else { 0 };
        }
        let is_for_stranger = SDO_ANSWERS.contains(&id) && self.answers_stranger & node != 0;
        !(is_stranger || is_for_stranger || EMERGENCIES.contains(&id))
    }

    fn note_wrap(&self, joint: usize, status: &Status, peaks: &mut Peaks) {
        if let Some(before) = self.told[joint] {
            let jump = i64::from(status.position) - i64::from(before.position);
            peaks.wraps += u32::from(jump.abs() > i64::from(i32::MAX));
        }
    }

    /// Checks bus-load.
    fn check_load(&mut self, limits: &Limits, seen: &Observation, peaks: &mut Peaks, findings: &mut Findings<'_>) {
        let bits = std::mem::take(&mut self.bits);
        if let Some(before_ns) = self.synced_ns.replace(seen.sync_ns) {
            // After a stranger's set-point SYNC stays out for some cycles, in which set-points go on.
            let cycles = ((seen.sync_ns.saturating_sub(before_ns)) as f64 * 1e-9 / limits.period_s).round().max(1.0);
            let share = bits as f64 / (limits.bit_rate * limits.period_s * cycles);
            let is_false = seen.falsified.timing || seen.falsified.link;
            if !is_false {
                peaks.bus_share = peaks.bus_share.max(share);
            }
            let excuse = is_false.then_some(Excuse::Falsified);
            findings.expect_unless(Invariant::BusLoad, share <= tolerance::BUS_SHARE, excuse, || {
                format!("the rig's own frames took {:.1} % of a cycle", 100.0 * share)
            });
        }
    }

    /// Notes the permission and the resets that hold from this computation on.
    fn note_requests(&mut self, seen: &Observation) {
        if seen.request == Request::Reset && self.state.is_latched() {
            self.resets = tolerance::RESET_CYCLES;
            self.had_reset = [false; 2];
        }
        if seen.request == Request::Enable && self.state == State::Idle {
            self.is_permitted = true;
        } else if seen.state.is_latched() || seen.state == State::Idle {
            self.is_permitted = false;
        }
    }

    /// Evaluates all set-points between two SYNCs, which are those of the computation before.
    fn end_of_epoch(&mut self, limits: &Limits, seen: &Observation, findings: &mut Findings<'_>) {
        let sent = std::mem::take(&mut self.sent);
        let commanded = sent.map(|sent| sent.is_some_and(|sent| sent.setpoint.enables()));
        let is_moving = commanded == [true; 2] && sent.iter().flatten().all(Sent::was_told_both_enabled);
        for (joint, sent) in sent.iter().enumerate() {
            self.had_gap[joint] = sent.is_none_or(|sent| sent.is_kept);
            let Some(sent) = sent else { continue };
            self.check_target(limits, joint, sent, findings);
            Self::check_enabling(limits, joint, sent, findings);
            if sent.is_kept {
                continue;
            }
            self.check_resets(joint, &sent.setpoint, findings);
            if is_moving && !self.were_moving {
                Self::check_first(limits, joint, sent, findings);
            }
        }
        // What is not said changes nothing: a drive goes on with what it heard last.
        if sent.iter().all(Option::is_none) {
            return;
        }
        // together: what moves both may end only for both.
        if self.were_moving && !is_moving {
            // The output frame of a segment is one for both.
            let excuse = (seen.falsified.link && !limits.is_on_segment).then_some(Excuse::Falsified);
            findings.expect_unless(Invariant::Together, commanded[0] == commanded[1], excuse, || {
                format!(
                    "the set-points after a common motion were {:x?}",
                    sent.map(|sent| sent.map(|sent| sent.setpoint))
                )
            });
        }
        self.were_moving = is_moving;
        self.before = sent.map(|sent| sent.map(|sent| sent.setpoint));
        self.before_ns = sent.iter().flatten().map(|sent| sent.computed_ns).min().unwrap_or(self.before_ns);
        self.resets = self.resets.saturating_sub(1);
    }

    /// Checks moves-enabled, and the second half of asked-for.
    fn check_enabling(limits: &Limits, joint: usize, sent: &Sent, findings: &mut Findings<'_>) {
        let setpoint = &sent.setpoint;
        if !setpoint.enables() {
            return;
        }
        let is_position = limits.mode == CommandMode::Position;
        let is_motion = match limits.mode {
            CommandMode::Torque | CommandMode::Velocity => setpoint.target != 0,
            CommandMode::Position => sent.away(joint).is_none_or(|away| away > tolerance::FIRST_TARGET_COUNTS),
        };
        let kept = sent.is_kept.then_some(Excuse::Kept);
        let unreported = (is_position && !sent.is_fresh).then_some(Excuse::Unreported);
        let reported_twice = sent.was_told_both_enabled().then_some(Excuse::ReportedTwice);
        let excuse = kept.or(unreported).or(reported_twice);
        findings.expect_unless(Invariant::MovesEnabled, !is_motion || sent.knew_both_enabled(), excuse, || {
            format!("set-point {setpoint:x?} moves joint {joint} while the drives report {:x?}", sent.known)
        });
        findings.expect_unless(Invariant::AskedFor, sent.is_permitted, kept, || {
            format!("joint {joint} was enabled by {setpoint:x?} and nobody had asked for it")
        });
    }

    /// Checks the first half of asked-for.
    fn check_resets(&mut self, joint: usize, sent: &Setpoint, findings: &mut Findings<'_>) {
        if sent.resets() {
            let had = std::mem::replace(&mut self.had_reset[joint], true);
            findings.expect(Invariant::AskedFor, self.resets > 0 && !had, || {
                format!("joint {joint} got a fault reset {sent:x?} that nobody had asked for, or a second one")
            });
        }
    }

    /// Checks bounded-motion and bounded-effort of the set-points on the wire.
    fn check_target(&self, limits: &Limits, joint: usize, sent: &Sent, findings: &mut Findings<'_>) {
        let follows = sent.follows(joint);
        let sent = &sent.setpoint;
        let most_rate = limits.joint_speed_rad_per_s * limits.counts_per_rad[joint];
        match limits.mode {
            CommandMode::Torque => {
                let most = limits.torque_per_mille[joint] + tolerance::TORQUE_PER_MILLE;
                findings.expect(Invariant::BoundedEffort, f64::from(sent.target.abs()) <= most, || {
                    format!("torque set-point of joint {joint}: {} per mille (limit {most})", sent.target)
                });
            }
            CommandMode::Velocity => {
                let most = most_rate + tolerance::TARGET_COUNTS;
                findings.expect(Invariant::BoundedMotion, f64::from(sent.target).abs() <= most, || {
                    format!("rate set-point of joint {joint}: {} counts/s (limit {most})", sent.target)
                });
            }
            CommandMode::Position => {
                let Some(before) = self.before[joint].filter(|before| before.enables() && sent.enables()) else {
                    return;
                };
                let step = f64::from(sent.target.wrapping_sub(before.target)).abs();
                // A host that is late leaves set-points out: the next one makes up for the time.
                let elapsed_s = (self.computed_ns.saturating_sub(self.before_ns) as f64 * 1e-9).max(limits.period_s);
                let most = most_rate * elapsed_s + tolerance::TARGET_COUNTS;
                let as_joint = tolerance::TURNING_SHARE * most_rate * elapsed_s + tolerance::TARGET_COUNTS;
                let excuse = follows.filter(|is_there| *is_there || step <= as_joint).map(|_| Excuse::Follows);
                findings.expect_unless(Invariant::BoundedMotion, step <= most, excuse, || {
                    format!("the target of joint {joint} went {step} counts in a cycle, at most {most:.1}")
                });
            }
        }
    }

    /// Checks starts-in-place.
    fn check_first(limits: &Limits, joint: usize, sent: &Sent, findings: &mut Findings<'_>) {
        let away = match limits.mode {
            CommandMode::Torque | CommandMode::Velocity => i64::from(sent.setpoint.target).abs(),
            CommandMode::Position => sent.away(joint).unwrap_or(0),
        };
        findings.expect(Invariant::StartsInPlace, away <= tolerance::FIRST_TARGET_COUNTS, || {
            format!(
                "the first set-point of joint {joint} was {:x?}, but the drive reported {:x?}",
                sent.setpoint, sent.known
            )
        });
    }
}

impl Sent {
    /// Whether both drives were enabled by the first report of each after SYNC.
    fn knew_both_enabled(&self) -> bool {
        self.known.iter().all(|status| status.is_some_and(|status| status.is_enabled()))
    }

    /// Whether both drives were enabled by any report of each: of two reports, the master may have taken the second.
    fn was_told_both_enabled(&self) -> bool {
        let is_enabled = |status: &Option<Status>| status.is_some_and(|status| status.is_enabled());
        self.known.iter().zip(&self.known_also).all(|(first, second)| is_enabled(first) || is_enabled(second))
    }

    /// Whether a target sent while no drive reports that it is enabled equals the reported position. `None` for a target that moves
    /// a joint.
    fn follows(&self, joint: usize) -> Option<bool> {
        let is_there = || self.away(joint).is_some_and(|away| away <= tolerance::FIRST_TARGET_COUNTS);
        (!self.was_told_both_enabled()).then(is_there)
    }

    /// Returns the distance of the position target from the reported position, counts; `None` if the drive had reported none.
    fn away(&self, joint: usize) -> Option<i64> {
        let told = [self.known[joint], self.known_also[joint]];
        let away =
            told.iter().flatten().map(|status| i64::from(self.setpoint.target.wrapping_sub(status.position)).abs());
        away.min()
    }
}
