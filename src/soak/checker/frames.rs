//! What is seen on the wire: who is commanded to do what, and when.

use super::super::invariant::Invariant;
use super::super::observation::{Observation, Sender, Setpoint, Status};
use super::super::tolerance;
use super::{Findings, Limits, Peaks};
use crate::config::CommandMode;
use crate::guard::{Request, State};
use crate::sim::can::frame_bits;

/// SYNC.
const SYNC: u16 = 0x080;

/// What the frames of the last cycles said.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Frames {
    /// What the drives told last.
    told: [Option<Status>; 2],
    /// The same, as known at the last computation.
    known: [Option<Status>; 2],
    /// The set-points since the last SYNC, and what was known when they were computed.
    sent: [Option<Setpoint>; 2],
    known_then: [Option<Status>; 2],
    /// Joints that told something in the cycle of the last computation.
    is_fresh: [bool; 2],
    fresh_then: [bool; 2],
    /// What the last set-points were, those before the last SYNC.
    before: [Option<Setpoint>; 2],
    /// SYNC of the cycle in which they were seen, ns.
    before_ns: u64,
    /// Whether both drives were enabled and commanded at the last SYNC.
    were_moving: bool,
    /// The person has asked to enable since the last latched or idle state.
    is_permitted: bool,
    /// Cycles in which a reset edge is still expected, and which drives have had it.
    resets: u32,
    had_reset: [bool; 2],
    state: State,
    /// Bits of the rig's own frames since the last SYNC.
    bits: u64,
    has_synced: bool,
}

impl Frames {
    pub(super) fn check(
        &mut self,
        limits: &Limits,
        seen: &Observation,
        peaks: &mut Peaks,
        findings: &mut Findings<'_>,
    ) {
        let (mut is_after_sync, mut has_told) = (false, [false; 2]);
        for sighting in &seen.frames {
            let frame = &sighting.frame;
            let is_ours = sighting.sender == Some(Sender::Master);
            if sighting.sender.is_some() {
                self.bits += u64::from(frame_bits(frame));
            }
            if is_ours && frame.id() == SYNC {
                let sent = std::mem::take(&mut self.sent);
                self.end_of_epoch(limits, seen, &sent, findings);
                self.check_load(limits, seen, peaks, findings);
                is_after_sync = true;
            }
            for joint in 0..2 {
                if is_ours && frame.id() == limits.set_point_ids[joint] {
                    findings.expect(
                        Invariant::I12,
                        !is_after_sync || seen.falsified.timing || seen.falsified.link,
                        || format!("the set-point {:?} of the cycle before came after SYNC", Setpoint::decode(frame)),
                    );
                    findings.expect(Invariant::I12, self.sent[joint].is_none(), || {
                        format!("two set-points for joint {joint} before one SYNC")
                    });
                    self.sent[joint] = Setpoint::decode(frame);
                    (self.known_then, self.fresh_then) = (self.known, self.is_fresh);
                }
                // Of what arrives between SYNC and the computation the first counts; before it, what is late.
                if sighting.sender.is_none()
                    && frame.id() == limits.status_ids[joint]
                    && let Some(status) = Status::decode(frame)
                    && !(is_after_sync && std::mem::replace(&mut has_told[joint], true))
                {
                    self.note_wrap(joint, &status, peaks);
                    self.told[joint] = Some(status);
                }
            }
        }
        (self.known, self.is_fresh) = (self.told, has_told);
        self.note_requests(seen);
        self.state = seen.state;
    }

    fn note_wrap(&self, joint: usize, status: &Status, peaks: &mut Peaks) {
        if let Some(before) = self.told[joint] {
            let jump = i64::from(status.position) - i64::from(before.position);
            peaks.wraps += u32::from(jump.abs() > i64::from(i32::MAX));
        }
    }

    /// I19.
    fn check_load(&mut self, limits: &Limits, seen: &Observation, peaks: &mut Peaks, findings: &mut Findings<'_>) {
        let share = self.bits as f64 / (limits.bit_rate * limits.period_s);
        self.bits = 0;
        if std::mem::replace(&mut self.has_synced, true) && !seen.falsified.timing && !seen.falsified.link {
            peaks.bus_share = peaks.bus_share.max(share);
            findings.expect(Invariant::I19, share <= tolerance::BUS_SHARE, || {
                format!("the rig's own frames took {:.1} % of a cycle", 100.0 * share)
            });
        }
    }

    /// Permission and resets as they stand from this computation on.
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

    /// All set-points between two SYNCs are in: those of the computation before.
    fn end_of_epoch(
        &mut self,
        limits: &Limits,
        seen: &Observation,
        sent: &[Option<Setpoint>; 2],
        findings: &mut Findings<'_>,
    ) {
        let enabled = self.known_then.map(|status| status.is_some_and(|status| status.is_enabled()));
        let commanded = sent.map(|sent| sent.is_some_and(|sent| sent.enables()));
        let is_moving = enabled == [true; 2] && commanded == [true; 2];
        for (joint, sent) in sent.iter().enumerate() {
            let Some(sent) = sent else { continue };
            self.check_enabling(limits, joint, sent, enabled, findings);
            self.check_resets(joint, sent, findings);
            self.check_target(limits, seen, joint, sent, findings);
            if is_moving && !self.were_moving && !seen.falsified.angles {
                self.check_first(limits, joint, sent, findings);
            }
        }
        // What is not said changes nothing: a drive goes on with what it heard last.
        if sent.iter().all(Option::is_none) {
            return;
        }
        // I17: what moves both may end only for both.
        if self.were_moving && !is_moving && !seen.falsified.link {
            findings.expect(Invariant::I17, commanded[0] == commanded[1], || {
                format!("the set-points after a common motion were {sent:x?}")
            });
        }
        self.were_moving = is_moving;
        (self.before, self.before_ns) = (*sent, seen.sync_ns);
        self.resets = self.resets.saturating_sub(1);
    }

    /// I1, and the second half of I18.
    fn check_enabling(
        &self,
        limits: &Limits,
        joint: usize,
        sent: &Setpoint,
        enabled: [bool; 2],
        findings: &mut Findings<'_>,
    ) {
        if !sent.enables() {
            return;
        }
        let is_motion = match limits.mode {
            CommandMode::Torque | CommandMode::Velocity => sent.target != 0,
            CommandMode::Position => {
                self.fresh_then[joint]
                    && self.known_then[joint].is_none_or(|status| {
                        let away = i64::from(sent.target.wrapping_sub(status.position));
                        away.abs() > tolerance::FIRST_TARGET_COUNTS
                    })
            }
        };
        findings.expect(Invariant::I1, !is_motion || enabled == [true; 2], || {
            format!("joint {joint} was told to move by {sent:x?} while the drives told {:x?}", self.known_then)
        });
        findings.expect(Invariant::I18, self.is_permitted, || {
            format!("joint {joint} was enabled by {sent:x?} and nobody had asked for it")
        });
    }

    /// The first half of I18.
    fn check_resets(&mut self, joint: usize, sent: &Setpoint, findings: &mut Findings<'_>) {
        if sent.resets() {
            let had = std::mem::replace(&mut self.had_reset[joint], true);
            findings.expect(Invariant::I18, self.resets > 0 && !had, || {
                format!("joint {joint} got a fault reset {sent:x?} that nobody had asked for, or a second one")
            });
        }
    }

    /// I2 and I3 of what is on the wire.
    fn check_target(
        &self,
        limits: &Limits,
        seen: &Observation,
        joint: usize,
        sent: &Setpoint,
        findings: &mut Findings<'_>,
    ) {
        let most_rate = limits.joint_speed_rad_per_s * limits.counts_per_rad[joint];
        match limits.mode {
            CommandMode::Torque => {
                let most = limits.torque_per_mille[joint] + tolerance::TORQUE_PER_MILLE;
                findings.expect(Invariant::I3, f64::from(sent.target.abs()) <= most, || {
                    format!("joint {joint} was told a torque of {} per mille, at most {most}", sent.target)
                });
            }
            CommandMode::Velocity => {
                let most = most_rate + tolerance::TARGET_COUNTS;
                findings.expect(Invariant::I2, f64::from(sent.target).abs() <= most, || {
                    format!("joint {joint} was told a rate of {} counts/s, at most {most}", sent.target)
                });
            }
            CommandMode::Position => {
                let Some(before) = self.before[joint].filter(|before| before.enables() && sent.enables()) else {
                    return;
                };
                let step = f64::from(sent.target.wrapping_sub(before.target)).abs();
                // A host that is late leaves set-points out: the next one makes up for the time.
                let elapsed_s = ((seen.sync_ns - self.before_ns) as f64 * 1e-9).max(limits.period_s);
                let most = most_rate * elapsed_s + tolerance::TARGET_COUNTS;
                findings.expect(Invariant::I2, step <= most, || {
                    format!("the target of joint {joint} went {step} counts in a cycle, at most {most:.1}")
                });
            }
        }
    }

    /// I9.
    fn check_first(&self, limits: &Limits, joint: usize, sent: &Setpoint, findings: &mut Findings<'_>) {
        let away = match limits.mode {
            CommandMode::Torque | CommandMode::Velocity => i64::from(sent.target),
            CommandMode::Position => {
                self.known_then[joint].map_or(0, |status| i64::from(sent.target.wrapping_sub(status.position)))
            }
        };
        findings.expect(Invariant::I9, away.abs() <= tolerance::FIRST_TARGET_COUNTS, || {
            format!(
                "the first set-point of joint {joint} was {sent:x?}, and the drive told {:x?}",
                self.known_then[joint]
            )
        });
    }
}
