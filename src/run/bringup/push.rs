//! Watch for a joint that is pushed and does not move. A blocked joint looks so, and so does a frozen encoder.

/// Share of its torque limit from which on a drive counts as pushing.
const PUSHES: f64 = 0.9;
/// How long it may push without moving its joint, s.
const PUSH_S: f64 = 0.01;
/// Share of the torque that moved the joint, from which on a drive at rest counts as pushing too.
const RESTS_AND_PUSHES: f64 = 1.2;
/// How long it may do so, s: a controller comes to rest.
const REST_PUSH_S: f64 = 0.05;
/// Share of the commanded travel below which a joint counts as not moving.
const MOVES: f64 = 0.5;
/// A joint that is slower does not move either, rad/s.
const CREEPS: f64 = 2e-3;

/// Distance from its target within which a joint counts as there, rad.
const NEAR_RAD: f64 = 3e-4;

/// Actual and commanded angle of a joint at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stand {
    /// When, s.
    pub(super) time_s: f64,
    /// Actual angle, rad.
    pub(super) angle_rad: f64,
    /// Commanded angle, rad, counted from any origin.
    pub(super) led_rad: f64,
}

impl Stand {
    /// Whether the joint has not moved since `from` as commanded.
    fn is_still(&self, from: &Self) -> bool {
        let led_rad = MOVES * (self.led_rad - from.led_rad).abs();
        (self.angle_rad - from.angle_rad).abs() < led_rad.max(CREEPS * (self.time_s - from.time_s))
    }
}

/// Looks at one joint and what its drive makes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Push {
    limit_n_m: f64,
    /// Since when it pushes.
    since: Option<Stand>,
    /// When its torque was known before.
    before: Option<Stand>,
    /// Sum of what it made while the joint moved, N m, and how often that was seen.
    moving_n_m: f64,
    moved: u32,
}

impl Push {
    /// Creates the watch of a joint whose drive may make this torque, N m.
    pub(super) fn new(limit_n_m: f64) -> Self {
        Self { limit_n_m, since: None, before: None, moving_n_m: 0.0, moved: 0 }
    }

    /// Whether the drive has pushed for a while and has not moved its joint. `rests` means that the joint is to rest and that its
    /// drive has finished its move.
    ///
    /// Real-time: yes.
    pub(super) fn is_blocked(&mut self, now: Stand, torque_n_m: f64, rests: bool) -> bool {
        self.take(now, torque_n_m);
        let rest_n_m = RESTS_AND_PUSHES * self.moving_n_m();
        let pushes_n_m = PUSHES * self.limit_n_m;
        if rests && self.moved > 0 && rest_n_m < pushes_n_m && torque_n_m.abs() < pushes_n_m {
            self.stands(now, torque_n_m, rest_n_m, REST_PUSH_S)
        } else {
            self.stands(now, torque_n_m, pushes_n_m, PUSH_S)
        }
    }

    /// Whether a joint that is guided to an angle in each cycle is blocked. At its target it may hold about as much torque as it
    /// took to move it, whatever its drive may make.
    ///
    /// Real-time: yes.
    pub(super) fn is_blocked_while_led(&mut self, now: Stand, torque_n_m: f64) -> bool {
        self.take(now, torque_n_m);
        let is_there = (now.angle_rad - now.led_rad).abs() < NEAR_RAD;
        let holds_n_m = if is_there { RESTS_AND_PUSHES * self.moving_n_m() } else { 0.0 };
        self.stands(now, torque_n_m, holds_n_m.max(PUSHES * self.limit_n_m), PUSH_S)
    }

    /// Learns what it takes to move the joint.
    fn take(&mut self, now: Stand, torque_n_m: f64) {
        let is_moving = self.before.is_some_and(|before| !now.is_still(&before));
        if is_moving {
            (self.moving_n_m, self.moved) = (self.moving_n_m + torque_n_m.abs(), self.moved.saturating_add(1));
        }
        self.before = Some(now);
    }

    /// Returns the mean torque that moved the joint, N m.
    fn moving_n_m(&self) -> f64 {
        self.moving_n_m / f64::from(self.moved.max(1))
    }

    /// Whether the joint has stood for this time while its drive made this torque.
    fn stands(&mut self, now: Stand, torque_n_m: f64, most_n_m: f64, most_s: f64) -> bool {
        if torque_n_m.abs() < most_n_m {
            self.since = None;
            return false;
        }
        let since = *self.since.get_or_insert(now);
        if now.time_s - since.time_s < most_s {
            return false;
        }
        let stands = now.is_still(&since);
        if !stands {
            self.since = Some(now);
        }
        stands
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A joint that goes at 0.05 rad/s.
    fn stand(time_s: f64, angle_rad: f64) -> Stand {
        Stand { time_s, angle_rad, led_rad: 0.05 * time_s }
    }

    /// When a joint is found blocked that goes at its rate until it stands, and whose torque is this from then on; asked every 4 ms.
    fn blocked_at(stands_s: f64, rests: bool, torque: impl Fn(f64) -> f64) -> Option<f64> {
        let mut push = Push::new(15.0);
        let times = (0..500).map(|at| 0.004 * f64::from(at));
        let mut times = times.map(|time_s| (time_s, 0.05 * f64::min(time_s, stands_s)));
        let found = times.find(|(time_s, angle_rad)| {
            let torque = if *time_s < stands_s { 10.0 } else { torque(*time_s) };
            push.is_blocked(stand(*time_s, *angle_rad), torque, rests && *time_s > stands_s)
        });
        found.map(|(time_s, _)| time_s)
    }

    #[test]
    fn a_joint_that_stands_while_its_drive_pushes_is_found_soon() {
        for sign in [1.0, -1.0] {
            let at_s = blocked_at(1.0, false, |_| sign * 14.0).unwrap();
            assert!((1.0..1.02).contains(&at_s), "{at_s}");
            let at_s = blocked_at(1.0, true, |_| sign * 12.1).unwrap();
            assert!((1.05..1.07).contains(&at_s), "{at_s}");
        }
    }

    #[test]
    fn friction_and_a_push_that_moves_are_none() {
        // What moved it holds it too.
        assert_eq!(blocked_at(1.0, true, |_| 10.0), None);
        // Before it moves again it may have to break loose.
        assert_eq!(blocked_at(1.0, false, |_| 13.0), None);
        // It moves with all that its drive may make.
        assert_eq!(blocked_at(9.0, false, |_| 0.0), None);
        let mut push = Push::new(15.0);
        for at in 0..200 {
            let time_s = 0.004 * f64::from(at);
            assert!(!push.is_blocked(stand(time_s, 0.05 * time_s), 15.0, false));
        }
        // A peak is none, however high.
        assert_eq!(blocked_at(1.0, true, |time_s| if time_s < 1.009 { 15.0 } else { 10.0 }), None);
    }

    #[test]
    fn a_joint_that_goes_as_slowly_as_it_is_led_is_none_and_one_that_stands_where_it_is_led_no_more_is() {
        let run = |gain: f64| {
            let mut push = Push::new(15.0);
            (0..200).map(|at| 1e-3 * f64::from(at)).find(|time_s| {
                let led_rad = 5e-3 * time_s;
                push.is_blocked_while_led(Stand { time_s: *time_s, angle_rad: gain * led_rad - 1e-3, led_rad }, 14.0)
            })
        };
        assert_eq!([run(1.0), run(0.6)], [None; 2]);
        assert!(run(0.3).is_some_and(|found_s| found_s < 0.02));
        // What has moved with a torque stands short of where it is led, with more.
        let stands = |moving_n_m: f64, short_rad: f64| {
            let mut push = Push::new(15.0);
            (0..400).map(|at| 1e-3 * f64::from(at)).any(|time_s| {
                let led_rad = 0.1 * time_s.min(0.2);
                let torque_n_m = if time_s < 0.2 { moving_n_m } else { 14.0 };
                push.is_blocked_while_led(Stand { time_s, angle_rad: led_rad - short_rad, led_rad }, torque_n_m)
            })
        };
        assert!(!stands(13.0, 1e-4), "it is there, and holds");
        assert!(stands(10.0, 1e-4), "it is pushed where it is");
        assert!(stands(13.0, 1e-3));
    }
}
