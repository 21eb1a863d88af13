//! A simulated user who chooses speed by what is seen. `docs/user-model.md` has the model with its sources.

use nalgebra::Vector2;

use super::super::task::{Grip, HAND_LIMIT_N, TREMOR};
use super::track::{Station, Track};
use yieldwall_motion::setvalued::sat;
use yieldwall_sim::hand::{AimError, Hand, HandError, HandLoad, HandParameters, Path};

/// Corner of the error of the aim in Hz: people move by intent below some 2 Hz.
const AIM_CORNER_HZ: f64 = 0.8;
/// Time in which a user slows down to a chosen speed, to 63 %, in s.
const SLOWS_S: f64 = 0.15;
/// From this speed in m/s on a user pays for all of the friction felt; below, in proportion.
const PAYS_FROM_M_PER_S: f64 = 0.005;
/// Added to the seed of the tremor, so that the aim knows nothing of it.
const AIM_STREAM: u64 = 0x5eed;

/// By what a user acts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Policy {
    pub(super) grip: Grip,
    /// From what happens to what the user does about it, in s.
    pub(super) delay_s: f64,
    /// Speed given up for the error seen: 1 stops at the edge of the band, 2 half-way to it.
    pub(super) caution: f64,
    /// How fast the aim is moved against the error seen, 1/s.
    pub(super) correction_per_s: f64,
    /// Speed without an error, in m/s, and the time in which a user comes back to a greater speed, to 63 %, in s.
    pub(super) free_m_per_s: f64,
    pub(super) regains_s: f64,
    /// Error of the aim at rest, RMS on each axis, in m, and what speed adds to it, in m per m/s.
    pub(super) rest_m: f64,
    pub(super) per_speed_s: f64,
}

/// A user on the way.
pub(super) struct User {
    policy: Policy,
    errand: Errand,
    /// Error of one unit, on both axes.
    error: Hand<2>,
    tremor: Hand<2>,
    /// How far off the way the tool was in the last cycles of the delay: the oldest is seen.
    heights_m: Vec<f64>,
    place: usize,
    /// Aim without its error: length along the path, speed, and distance off the path.
    progress_m: f64,
    speed_m_per_s: f64,
    correction_m: f64,
    /// How speed and correction change.
    pace_m_per_s2: f64,
    correction_m_per_s: f64,
    aim: Aim,
}

/// Where the aim is at a time, how it moves, and the force with which friction is paid for that way.
#[derive(Clone, Copy, Debug)]
struct Aim {
    time_s: f64,
    point_m: Vector2<f64>,
    velocity_m_per_s: Vector2<f64>,
    paid_n: Vector2<f64>,
}

/// Task of a user.
#[derive(Clone, Copy, Debug)]
pub(super) struct Errand {
    pub(super) track: Track,
    /// Width of the band in whose middle the way runs, in m.
    pub(super) width_m: f64,
    /// Where the tool starts off the way, in m.
    pub(super) start_off_m: f64,
    /// Friction of the fixture, in N.
    pub(super) friction_n: f64,
    pub(super) period_s: f64,
}

impl User {
    /// Returns a user at rest at the start of the path. Equal numbers give the same error of the aim and the same tremor.
    ///
    /// # Errors
    /// A quantity out of its range.
    pub(super) fn new(policy: Policy, errand: Errand, number: u64) -> Result<Self, HandError> {
        let still = HandParameters {
            mass_kg: 0.0,
            stiffness_n_per_m: 0.0,
            damping_n_s_per_m: 0.0,
            voluntary_force_limit_n: f64::INFINITY,
            tremor: None,
            aim_error: None,
        };
        let path = || Path::new(Vector2::zeros(), &[]);
        let unit = Some(AimError { rms_m: 1.0, corner_hz: AIM_CORNER_HZ });
        let seed = 1 + number;
        let seen = ((policy.delay_s / errand.period_s).round() as usize).max(1);
        Ok(Self {
            policy,
            errand,
            error: Hand::new(HandParameters { aim_error: unit, ..still }, path()?, seed.wrapping_add(AIM_STREAM))?,
            tremor: Hand::new(HandParameters { tremor: Some(TREMOR), ..still }, path()?, seed)?,
            heights_m: vec![errand.start_off_m; seen],
            place: 0,
            progress_m: 0.0,
            speed_m_per_s: 0.0,
            correction_m: 0.0,
            pace_m_per_s2: 0.0,
            correction_m_per_s: 0.0,
            aim: Aim {
                time_s: 0.0,
                point_m: errand.track.at(0.0).point_m,
                velocity_m_per_s: Vector2::zeros(),
                paid_n: Vector2::zeros(),
            },
        })
    }

    /// One cycle that begins at `time_s` with the tool so far off the way.
    pub(super) fn look(&mut self, time_s: f64, height_m: f64, has_started: bool) {
        let seen_m = std::mem::replace(&mut self.heights_m[self.place], height_m);
        self.place = (self.place + 1) % self.heights_m.len();
        let Policy { caution, correction_per_s, free_m_per_s, regains_s, .. } = self.policy;
        let off = seen_m.abs() / (0.5 * self.errand.width_m);
        let is_lost = off > 1.0;
        let wanted_m_per_s = match has_started && !is_lost {
            true => free_m_per_s * (1.0 - caution * off).max(0.0),
            false => 0.0,
        };
        let change_m_per_s = wanted_m_per_s - self.speed_m_per_s;
        self.pace_m_per_s2 = change_m_per_s / if change_m_per_s < 0.0 { SLOWS_S } else { regains_s };
        self.correction_m_per_s = -correction_per_s * seen_m;
        self.aim = self.aim_at(time_s);
        self.speed_m_per_s += self.pace_m_per_s2 * self.errand.period_s;
        self.progress_m += self.speed_m_per_s * self.errand.period_s;
        self.correction_m += self.correction_m_per_s * self.errand.period_s;
    }

    fn aim_at(&mut self, time_s: f64) -> Aim {
        let unit = self.error.target(time_s);
        let Policy { rest_m, per_speed_s, .. } = self.policy;
        let size_m = rest_m + per_speed_s * self.speed_m_per_s;
        // Along the way first, then across it.
        let error_m = unit.position_m * size_m;
        let rate_m_per_s = unit.velocity_m_per_s * size_m + unit.position_m * (per_speed_s * self.pace_m_per_s2);
        let Station { point_m, along, across, curvature_per_m } = self.errand.track.at(self.progress_m);
        let off_m = self.correction_m + error_m.y;
        let turn_per_s = curvature_per_m * self.speed_m_per_s;
        let along_m_per_s = self.speed_m_per_s + turn_per_s * off_m + rate_m_per_s.x;
        let across_m_per_s = self.correction_m_per_s + rate_m_per_s.y - turn_per_s * error_m.x;
        let planned_m_per_s = along * self.speed_m_per_s + across * self.correction_m_per_s;
        let friction_n = self.errand.friction_n;
        Aim {
            time_s,
            paid_n: sat(planned_m_per_s * (friction_n / PAYS_FROM_M_PER_S), friction_n),
            point_m: point_m + along * error_m.x + across * off_m,
            velocity_m_per_s: along * along_m_per_s + across * across_m_per_s,
        }
    }

    /// Returns the load of the hand on a tool at a point: a spring and a damper towards the aim, a force against friction, and
    /// the tremor.
    pub(super) fn load(&mut self, time_s: f64, tool_m: Vector2<f64>) -> HandLoad<2> {
        let Aim { time_s: since_s, point_m, velocity_m_per_s, paid_n } = self.aim;
        let Grip { stiffness_n_per_m, damping_n_s_per_m, .. } = self.policy.grip;
        let pull = (point_m + velocity_m_per_s * (time_s - since_s) - tool_m) * stiffness_n_per_m;
        let at_limit = pull.norm_squared() > HAND_LIMIT_N * HAND_LIMIT_N;
        let tremor_n = self.tremor.load(time_s, Vector2::zeros()).force_n;
        HandLoad {
            force_n: sat(pull, HAND_LIMIT_N) + velocity_m_per_s * damping_n_s_per_m + paid_n + tremor_n,
            damping_n_s_per_m,
            stiffness_n_per_m: if at_limit { 0.0 } else { stiffness_n_per_m },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::task::GRIPS;
    use super::*;

    const POLICY: Policy = Policy {
        grip: GRIPS[0],
        delay_s: 0.2,
        caution: 1.0,
        correction_per_s: 2.0,
        free_m_per_s: 0.3,
        regains_s: 0.2,
        rest_m: 0.0,
        per_speed_s: 0.0,
    };

    const ERRAND: Errand =
        Errand { track: Track::Circle, width_m: 0.01, start_off_m: 0.0, friction_n: 3.0, period_s: 1e-3 };

    /// Speed and correction of a user who has seen an error for a second.
    fn after(policy: Policy, height_m: f64, for_s: f64) -> (f64, f64) {
        let mut user = User::new(policy, ERRAND, 0).unwrap();
        (0..(for_s * 1e3) as u32).for_each(|cycle| user.look(1e-3 * f64::from(cycle), height_m, true));
        (user.speed_m_per_s, user.correction_m)
    }

    #[test]
    fn a_user_slows_down_with_the_error_seen_and_stops_beyond_the_band() {
        assert!((after(POLICY, 0.0, 2.0).0 - 0.3).abs() < 1e-3);
        assert!((after(POLICY, 0.0025, 2.0).0 - 0.15).abs() < 1e-3);
        assert!(after(POLICY, 0.0051, 3.0).0 < 1e-3);
        // Half the caution: at the edge still half the speed, beyond it none.
        let bold = Policy { caution: 0.5, ..POLICY };
        assert!((after(bold, 0.0049, 2.0).0 - 0.153).abs() < 1e-3);
        assert!(after(bold, 0.0051, 3.0).0 < 1e-3);
    }

    #[test]
    fn what_happens_is_seen_after_the_delay() {
        let (unseen, none) = after(POLICY, 0.005, 0.2);
        assert!(unseen > 0.18 && none == 0.0, "{unseen}");
        let (_, corrected) = after(POLICY, 0.005, 0.7);
        assert!((corrected + 2.0 * 0.005 * 0.5).abs() < 1e-9, "{corrected}");
    }

    #[test]
    fn the_aim_moves_as_its_velocity_says() {
        let policy = Policy { rest_m: 0.001, per_speed_s: 0.05, ..POLICY };
        let mut user = User::new(policy, ERRAND, 7).unwrap();
        let mut aims = Vec::new();
        for cycle in 0..1500 {
            user.look(1e-3 * f64::from(cycle), 0.002, true);
            aims.push(user.aim);
        }
        let way: Vector2<f64> = aims[1000..1499].iter().map(|aim| aim.velocity_m_per_s * 1e-3).sum();
        let moved = aims[1499].point_m - aims[1000].point_m;
        assert!((way - moved).norm() < 0.01 * moved.norm() && moved.norm() > 0.02, "{way} {moved}");
    }
}
