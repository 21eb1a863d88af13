//! Joints that the drives have stopped: from when on their torque may go.

use crate::quantity::JointAngles;

/// A joint rests that stays within this band, rad ...
const BAND_RAD: f64 = 5e-3;
/// ... for so long, s: it moves by less than 3 degrees a second.
const RESTING_S: f64 = 0.1;
/// Longest time for which drives may hold joints that do not come to rest, s.
const MOVING_LIMIT_S: f64 = 1.0;

/// Whether the joints of a rig rest after a quick stop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointRest {
    /// Angles at which the joints came to rest, if they have been measured.
    place: Option<JointAngles>,
    resting_s: f64,
    stopped_s: f64,
}

impl JointRest {
    /// Computes one cycle of `period_s` after the quick stop, by the angles of both joints where they are known. Returns whether torque may
    /// be removed. This needs joints that have rested for 0.1 s or had 1 s for it, and the closing of brakes that close within `brake_s` of
    /// the quick stop.
    ///
    /// Real-time: yes.
    pub fn step(&mut self, angles: Option<JointAngles>, period_s: f64, brake_s: f64) -> bool {
        self.stopped_s += period_s;
        let stays = self.place.zip(angles).is_some_and(|(place, angles)| {
            (angles - place).to_array().into_iter().all(|moved| moved.abs() <= BAND_RAD)
        });
        if stays {
            self.resting_s += period_s;
        } else {
            (self.place, self.resting_s) = (angles, 0.0);
        }
        let is_over = self.resting_s >= RESTING_S || self.stopped_s >= MOVING_LIMIT_S;
        is_over && self.stopped_s >= brake_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 1e-3;

    /// Returns the cycle after the quick stop in which torque may go.
    fn goes_after(brake_s: f64, angle: impl Fn(f64) -> Option<f64>) -> usize {
        let mut rest = JointRest::default();
        let at = |cycle: usize| angle(cycle as f64 * PERIOD_S).map(|angle| JointAngles::new(0.3, angle));
        (1..10_000).find(|cycle| rest.step(at(*cycle), PERIOD_S, brake_s)).unwrap()
    }

    #[test]
    fn torque_goes_once_the_joints_rest_and_the_brakes_are_closed() {
        assert!((101..=102).contains(&goes_after(0.0, |_| Some(1.0))));
        // A ramp of 0.2 s from 1 rad/s.
        let ramp = |t: f64| Some(if t < 0.2 { t - 2.5 * t * t } else { 0.1 });
        assert!((250..=302).contains(&goes_after(0.0, ramp)), "{}", goes_after(0.0, ramp));
        assert!((400..=401).contains(&goes_after(0.4, ramp)));
    }

    #[test]
    fn joints_that_do_not_rest_or_are_not_heard_have_a_second() {
        let unheard: [fn(f64) -> Option<f64>; 3] = [|t| Some(0.2 * t), |_| None, |_| Some(f64::NAN)];
        for angle in unheard {
            assert!((1000..=1001).contains(&goes_after(0.0, angle)));
            assert!((1300..=1301).contains(&goes_after(1.3, angle)));
        }
    }
}
