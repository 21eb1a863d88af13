//! The rig's own loop, from the sensed force over the fixture to the drives, with nobody at the handle.

use super::bench::{Bench, Found, Halt};
use super::moving::{LED_BEYOND_RAD, TORQUE_SHARES, TRAVEL_RAD};
use super::resting::unsigned_zero;
use super::{Curve, Figure};
use crate::permit::{Ask, Bounds};
use crate::scene::Ended;
use yieldwall_config::FixtureLaw;
use yieldwall_motion::guard::{Cause, Fault, State};
use yieldwall_motion::quantity::{Force, TipPoint};

/// How long the handle is left alone, s. A wrong zero makes it run off within a second, or is too small to show in a minute.
const ALONE_S: f64 = 10.0;
/// Longest time before that for a fixture that moves the handle by itself, s.
const SETTLING_S: f64 = 3.0;
/// How far tool and reference may go, mm.
const WAY_MM: f64 = 1.0;
/// How fast the tool may go to and fro, as a root mean square, mm/s.
const SPEED_MM_PER_S: f64 = 5.0;
/// Window of the root mean square, s: it hides the steps of the encoders.
const SPEED_OVER_S: f64 = 5e-3;
/// Number of turns from which on the tool counts as moving to and fro: a tool that moves to its place and overshoots turns two or
/// three times.
const TURNS: usize = 6;
/// Ratio of path to range above which a motion counts as to and fro.
const PATHS: u32 = 4;
/// A way back of this share of the whole is a turn.
const TURN_SHARE: f64 = 0.25;
/// Points of a curve.
const CURVE_POINTS: usize = 2000;

/// State of the handle in a cycle.
#[derive(Clone, Copy, Debug)]
struct HandleSample {
    time_s: f64,
    tool: TipPoint,
    reference: TipPoint,
    force: Force,
}

/// A time in which nobody held the handle.
struct Alone {
    ended: Ended,
    state: State,
    cause: Option<Cause>,
    is_led_away: bool,
    seen: Vec<HandleSample>,
}

/// Motion of a point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Way {
    /// How far it goes from where it began at most, mm.
    farthest_mm: f64,
    /// From one end of its way to the other, mm.
    whole_mm: f64,
    /// How often it turns round.
    turns: usize,
    /// Root mean square of its speed, mm/s.
    speed_mm_per_s: f64,
    /// How far it goes in all, mm.
    path_mm: f64,
}

impl Way {
    /// Computes the motion of points with their times in s.
    fn of(points: &[(f64, TipPoint)]) -> Self {
        let Some((_, first)) = points.first() else { return Self::default() };
        let from: Vec<[f64; 2]> =
            points.iter().map(|(_, point)| *point - *first).map(|by| [1e3 * by.0.x, 1e3 * by.0.y]).collect();
        let range = |axis: usize| {
            let (low, high) =
                from.iter().fold((0.0_f64, 0.0_f64), |(low, high), by| (low.min(by[axis]), high.max(by[axis])));
            high - low
        };
        let (along, whole_mm) = if range(0) >= range(1) { (0, range(0)) } else { (1, range(1)) };
        let farthest_mm = from.iter().map(|[x, y]| yieldwall_motion::elementary::hypot(*x, *y)).fold(0.0, f64::max);
        // The last end of the way, and whether it goes up from there.
        let (mut end, mut goes_up, mut turns) = (0.0, None, 0);
        for by in from.iter().map(|by| by[along]) {
            let gone = by - end;
            match goes_up {
                Some(true) if gone >= 0.0 => end = by,
                Some(false) if gone <= 0.0 => end = by,
                _ if gone.abs() > TURN_SHARE * whole_mm => {
                    turns += usize::from(goes_up.is_some());
                    (end, goes_up) = (by, Some(gone > 0.0));
                }
                _ => {}
            }
        }
        let (mut squares, mut path_mm) = ((0.0, 0_u32), 0.0);
        let mut before = 0;
        for (at, (time_s, point)) in points.iter().enumerate() {
            let (before_s, from) = points[before];
            if time_s - before_s < SPEED_OVER_S {
                continue;
            }
            let gone_mm = 1e3 * (*point - from).0.norm();
            let speed = gone_mm / (time_s - before_s);
            path_mm += gone_mm;
            squares = (squares.0 + speed * speed, squares.1 + 1);
            before = at;
        }
        let speed_mm_per_s = (squares.0 / f64::from(squares.1.max(1))).sqrt();
        Self { farthest_mm, whole_mm, turns, speed_mm_per_s, path_mm }
    }

    fn goes_to_and_fro(&self) -> bool {
        let is_beyond = self.farthest_mm > WAY_MM || self.speed_mm_per_s > SPEED_MM_PER_S;
        let turns = self.turns >= TURNS && self.farthest_mm > WAY_MM;
        // A small one on a drift has no turns, and goes much farther than it comes.
        turns || (is_beyond && self.path_mm > f64::from(PATHS) * self.whole_mm)
    }
}

impl Bench<'_> {
    /// Runs the rig with its own fixture and nobody at the handle: it has to stay in place.
    pub(super) fn admittance(&mut self, found: &mut Found) -> Result<(), Halt> {
        let fixture = &self.rig.fixture;
        if fixture.motion.is_some() {
            return Err(Halt::Skipped(
                "the surfaces of the fixture move (`fixture.motion`), and move the tool by themselves".to_owned(),
            ));
        }
        let leads = matches!(fixture.law, Some(FixtureLaw::Elastic { .. }));
        let (settling_s, bound_rad) =
            if leads { (SETTLING_S, TRAVEL_RAD + LED_BEYOND_RAD) } else { (0.0, LED_BEYOND_RAD) };
        // As much as the friction of a joint may be, which the step before has looked at, and more if the joints do not follow.
        let [least_n_m, .., most_n_m] = TORQUE_SHARES.map(|share| self.torque_n_m(share));
        let friction_n_m = self.most_friction_n_m(0).max(self.most_friction_n_m(1));
        let first_n_m = friction_n_m.max(least_n_m).min(most_n_m);
        let further = TORQUE_SHARES.map(|share| self.torque_n_m(share)).into_iter().filter(|more| *more > first_n_m);
        let torques: Vec<f64> = [first_n_m].into_iter().chain(further).collect();
        for (at, torque_n_m) in torques.iter().enumerate() {
            let alone = self.within(bound_rad, *torque_n_m, |bench, bounds| bench.left_alone(settling_s, bounds))?;
            let is_too_weak = alone.cause.is_some_and(|cause| cause.fault == Fault::FollowingError);
            if leads && is_too_weak && at + 1 < torques.len() {
                continue;
            }
            return self.judge_alone(&alone, *torque_n_m, settling_s, found);
        }
        Ok(())
    }

    fn left_alone(&mut self, settling_s: f64, bounds: Bounds) -> Result<Alone, Halt> {
        let permit = self.attendant.prove(self.runner, self.rig, bounds)?;
        let cycles = self.cycles_in(settling_s + ALONE_S);
        let mut seen = Vec::with_capacity(cycles as usize);
        self.runner.enable(self.settling, &permit, self.is_interrupted)?;
        self.runner.begin_scene();
        let (mut ended, period_s) = (Ended::Whole, self.runner.period().as_secs_f64());
        for cycle in 0..cycles {
            if self.check_interrupt().is_err() {
                ended = Ended::Interrupted;
                break;
            }
            let record = self.runner.run_cycle(Ask::Nothing);
            if self.runner.has_panicked() {
                ended = Ended::Panicked;
                break;
            }
            let time_s = f64::from(cycle) * period_s;
            seen.extend(record.map(|record| record.signals).map(|signals| HandleSample {
                time_s,
                tool: signals.tool,
                reference: signals.proxy,
                force: signals.force,
            }));
            if !matches!(self.runner.state(), State::Running | State::Holding) {
                ended = Ended::Stopped;
                break;
            }
        }
        let (state, cause, is_led_away) = (self.runner.state(), self.runner.cause(), self.runner.is_led_away());
        let ended = self.runner.end(ended);
        if ended == Ended::Interrupted {
            return Err(Halt::Interrupted);
        }
        Ok(Alone { ended, state, cause, is_led_away, seen })
    }

    fn judge_alone(&self, alone: &Alone, torque_n_m: f64, settling_s: f64, found: &mut Found) -> Result<(), Halt> {
        let settled: Vec<HandleSample> = alone.seen.iter().copied().filter(|seen| seen.time_s >= settling_s).collect();
        // One that was stopped before is looked at as a whole.
        let seen = if settled.is_empty() { &alone.seen } else { &settled };
        let of = |point: fn(&HandleSample) -> TipPoint| {
            Way::of(&seen.iter().map(|seen| (seen.time_s, point(seen))).collect::<Vec<_>>())
        };
        let (tool, reference) = (of(|seen| seen.tool), of(|seen| seen.reference));
        let count = seen.len().max(1) as f64;
        let mean = seen.iter().fold(Force::default(), |sum, seen| sum + seen.force) / count;
        let noise_n = (seen.iter().map(|seen| (seen.force - mean).0.norm_squared()).sum::<f64>() / count).sqrt();
        let time_s = seen.last().map_or(0.0, |last| last.time_s - seen[0].time_s);
        found.note("left alone for", format!("{time_s:.1} s (torque limit {torque_n_m:.1} N m)"));
        found.note(
            "tool",
            format!("largest travel {:.3} mm, speed {:.2} mm/s RMS", tool.farthest_mm, tool.speed_mm_per_s),
        );
        found.note("reference", format!("largest travel {:.3} mm", reference.farthest_mm));
        found.note(
            format!("{}: force felt", self.rig.sensor.name),
            format!(
                "mean {:.2} N along x, {:.2} N along y; noise {noise_n:.2} N RMS",
                unsigned_zero(mean.x()),
                unsigned_zero(mean.y())
            ),
        );
        found.curves.push(curve(seen));
        found.measure(Figure {
            what: "tool speed, hands off".into(),
            value: tool.speed_mm_per_s,
            limit: SPEED_MM_PER_S,
            unit: "mm/s RMS".into(),
        });
        let farthest = if reference.farthest_mm > tool.farthest_mm { reference } else { tool };
        found.measure(Figure {
            what: "reference travel, hands off".into(),
            value: reference.farthest_mm,
            limit: WAY_MM,
            unit: "mm".into(),
        });
        found.measure(Figure {
            what: "tool travel, hands off".into(),
            value: tool.farthest_mm,
            limit: WAY_MM,
            unit: "mm".into(),
        });
        let stopped = self.stopped_alone(alone);
        let beside = stopped.as_ref().map_or(String::new(), |stopped| format!("; {stopped}"));
        if let Some((name, way)) =
            [("tool", tool), ("reference", reference)].into_iter().find(|(_, way)| way.goes_to_and_fro())
        {
            return Err(Halt::Failed(format!(
                "the {name} oscillates by {:.2} mm without a hand, at {:.0} mm/s RMS: gains or virtual mass do not fit the delay of \
                 the loop. `yieldwall tune loop` measures it and proposes gains{beside}",
                way.whole_mm, way.speed_mm_per_s
            )));
        }
        if farthest.farthest_mm > WAY_MM {
            let lead = if settling_s > 0.0 { ", or move the arm by hand nearer to its fixture" } else { "" };
            return Err(Halt::Failed(format!(
                "the arm drifted by {:.1} mm within {time_s:.1} s without a hand, while {} shows {:.1} N: its zero is wrong, or a \
                 weight is attached to the handle. Set the zero at the sensor, or tare it (`sensor.tare_up_to_n`){lead}{beside}",
                farthest.farthest_mm,
                self.rig.sensor.name,
                mean.norm()
            )));
        }
        stopped.map_or(Ok(()), |stopped| Err(Halt::Failed(stopped)))
    }

    /// Returns the cause that stopped a rig that was left alone.
    fn stopped_alone(&self, alone: &Alone) -> Option<String> {
        match (alone.ended, alone.cause) {
            (Ended::Whole, _) => None,
            (Ended::StillMoving, _) => {
                Some("a drive still reports torque after the stop of the rig: press the emergency stop".to_owned())
            }
            (Ended::Panicked, _) => Some("the cycle has panicked: please report it".to_owned()),
            _ if alone.is_led_away => Some("the rig stopped at the limit of this step".to_owned()),
            (_, Some(Cause { fault, devices })) => {
                let row = fault.row();
                Some(format!("{} ({devices}) stopped the rig: {}", row.name, row.meaning))
            }
            (_, None) => Some(format!("the rig stopped ({:?})", alone.state)),
        }
    }
}

/// Returns the curve of the tool's place.
fn curve(seen: &[HandleSample]) -> Curve {
    let Some(first) = seen.first().copied() else { return Curve::default() };
    let every = seen.len().div_ceil(CURVE_POINTS).max(1);
    let line = |axis: fn(&HandleSample, &HandleSample) -> f64| {
        seen.iter().step_by(every).map(|seen| [seen.time_s, 1e3 * axis(seen, &first)]).collect()
    };
    Curve {
        title: "tool, hands off".to_owned(),
        across: "time in s",
        up: "travel in mm",
        lines: vec![
            ("x".to_owned(), line(|seen, first| (seen.tool - first.tool).0.x)),
            ("y".to_owned(), line(|seen, first| (seen.tool - first.tool).0.y)),
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_motion::elementary::{exp, sin};

    fn way(x_mm: impl Fn(f64) -> f64) -> Way {
        let points = (0..2000).map(|at| 1e-3 * f64::from(at));
        Way::of(&points.map(|time_s| (time_s, TipPoint::new(0.1, 0.2 + 1e-3 * x_mm(time_s)))).collect::<Vec<_>>())
    }

    #[test]
    fn a_drift_does_not_turn_round_and_an_oscillation_does() {
        let drift = way(|time_s| 3.0 * time_s * time_s);
        assert!((drift.farthest_mm - 12.0).abs() < 0.02 && drift.turns == 0 && !drift.goes_to_and_fro(), "{drift:?}");
        let swings = way(|time_s| sin(20.0 * time_s));
        assert!(swings.goes_to_and_fro() && (11..=14).contains(&swings.turns), "{swings:?}");
        assert!((swings.speed_mm_per_s - 14.1).abs() < 0.3, "{swings:?}");
        let small = way(|time_s| time_s + 0.2 * sin(80.0 * time_s));
        assert!(small.turns < TURNS && small.goes_to_and_fro(), "{small:?}");
        // It is led to its place and goes beyond.
        let settles =
            way(|time_s| 30.0 * (1.0 - exp(-8.0 * time_s) * yieldwall_motion::elementary::cos(25.0 * time_s)));
        assert!(!settles.goes_to_and_fro() && settles.farthest_mm > 30.0, "{settles:?}");
        // What encoders count is nothing.
        let rests = way(|time_s| if ((time_s * 1e3) as u64).is_multiple_of(2) { 0.003 } else { 0.0 });
        assert!(!rests.goes_to_and_fro() && rests.speed_mm_per_s < 1.0, "{rests:?}");
        assert_eq!(Way::of(&[]), Way::default());
    }
}
