//! One hand and one surface in the plane.

use nalgebra::Vector2;
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use crate::config;
use crate::elementary;
use crate::fixture::{
    Admittance, AutomaticHold, Coupling, Curvature, Fixture, Limits, Motion, Parameters, Rearm, Shape2, Side,
};
use crate::setvalued::sat;
use crate::sim::share_of_one;

const PERIOD_S: f64 = 1e-3;
const SUBSTEPS: u32 = 10;
pub(super) const YIELD_N: f64 = 20.0;
const FRICTION_N: f64 = 3.0;
const TOOL_KG: f64 = 4.0;
const PROXY_KG: f64 = 2.0;
const SERVO_N_PER_M: f64 = 111e3;
const SERVO_N_S_PER_M: f64 = 1055.0;
const SERVO_LIMIT_N: f64 = 200.0;
/// The proxy has this way up to the surface to come to speed, m, along its aim: to a plane wall, and within a circle or a corner.
const RUN_UP_M: f64 = 0.25;
const RUN_UP_WITHIN_M: f64 = 0.1;
/// Radius of the circle from whose inside the hand comes, m: that of the paper.
const CIRCLE_M: f64 = 0.12;
/// Half of the angle of the inner corner, rad: that of a hexagonal room.
const HALF_CORNER_RAD: f64 = std::f64::consts::FRAC_PI_3;
/// Greatest angle between the aim and the normal of the surface, rad.
const ASKEW_RAD: f64 = 1.0;
/// How long a run goes on after the impact, s.
const AFTER_S: f64 = 1.0;
/// Duration of one swing of a wall that moves, s: its speed changes by less than a tenth within half a second about the middle
/// of its way.
const SWING_S: f64 = 8.0;
/// How long a wall has been on its way when the hand starts, s, and how far away from it.
const WALL_AHEAD_S: f64 = 1.7;
const WALL_START_M: f64 = 0.1;
/// A proxy that is farther beyond the surface than this, in m, is through.
pub(super) const THROUGH_M: f64 = 1e-9;

/// How long the surface holds after an impact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Rule {
    /// N_wait.
    Fixed(u32),
    /// The automatic hold with this window, ms.
    Automatic(u32),
}

/// All rules: the windows in ms, which are steps of N_wait at 1 kHz.
pub(super) const RULES: [Rule; 13] = [
    Rule::Fixed(0),
    Rule::Fixed(15),
    Rule::Fixed(50),
    Rule::Fixed(100),
    Rule::Fixed(150),
    Rule::Fixed(200),
    Rule::Fixed(300),
    Rule::Automatic(50),
    Rule::Automatic(100),
    Rule::Automatic(150),
    Rule::Automatic(200),
    Rule::Automatic(300),
    Rule::Automatic(500),
];

impl Rule {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Fixed(_) => "N_wait",
            Self::Automatic(_) => "automatic",
        }
    }

    /// Longest hold after an impact, ms.
    pub(super) fn window_ms(self) -> u32 {
        let (Self::Fixed(window_ms) | Self::Automatic(window_ms)) = self;
        window_ms
    }

    fn fixture(self, place: Place) -> Fixture<Shape2, 2> {
        let parameters = Parameters {
            coupling: Coupling::Admittance(Admittance { mass_kg: PROXY_KG }),
            limits: Limits { friction_n: FRICTION_N, yield_n: YIELD_N },
            side: if place == Place::Guide { Side::Bilateral } else { Side::Unilateral },
            hold_steps: if let Self::Fixed(steps) = self { steps } else { 0 },
            rearm: Rearm::OffSurface,
            curvature: Curvature::Tangent,
            period_s: PERIOD_S,
        };
        let shape = place.surface().planar().ok().flatten().expect("a shape in the plane");
        let fixture = Fixture::new(shape, parameters).expect("a wall above friction");
        match self {
            Self::Fixed(_) => fixture,
            Self::Automatic(window_ms) => {
                let hold = AutomaticHold { longest_s: 1e-3 * f64::from(window_ms), ..AutomaticHold::default() };
                fixture.with_automatic_hold(hold).expect("a window in its range, in an admittance")
            }
        }
    }
}

/// What the hand strikes. It comes along the negative x axis, and the surface is met at the origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// A plane wall, head-on.
    Wall,
    /// A wall round the hand's room, at an angle.
    Circle,
    /// The inner corner of two walls, at an angle.
    Corner,
    /// A circular guide, at an angle: what is caught goes on along it.
    Guide,
}

pub(super) const PLACES: [Place; 4] = [Place::Wall, Place::Circle, Place::Corner, Place::Guide];

impl Place {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Wall => "wall",
            Self::Circle => "circle",
            Self::Corner => "corner",
            Self::Guide => "guide",
        }
    }

    fn surface(self) -> config::Surface {
        let finite = |value: f64| config::Finite::new(value).expect("a finite number");
        let point = |x: f64, y: f64| [finite(x), finite(y)];
        match self {
            Self::Wall => config::Surface::Line { point_m: point(0.0, 0.0), normal: point(1.0, 0.0) },
            Self::Circle | Self::Guide => config::Surface::Circle {
                center_m: point(CIRCLE_M, 0.0),
                radius_m: config::Positive::new(CIRCLE_M).expect("above zero"),
                forbidden: config::Forbidden::Outside,
            },
            Self::Corner => {
                let (x, y) = (elementary::cos(HALF_CORNER_RAD), elementary::sin(HALF_CORNER_RAD));
                config::Surface::Polygon {
                    points_m: vec![point(0.0, 0.0), point(x, -y), point(3.0, -y), point(3.0, y), point(x, y)],
                    forbidden: config::Forbidden::Outside,
                }
            }
        }
    }
}

/// From which hands a row draws.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Grips {
    pub(super) name: &'static str,
    /// Stiffness in N/m, evenly in the logarithm.
    stiffness_n_per_m: [f64; 2],
    /// Damping as a share of the critical one.
    damping: [f64; 2],
}

pub(super) const GRIPS: [Grips; 3] = [
    Grips { name: "usual", stiffness_n_per_m: [1e3, 3e4], damping: [0.3, 0.7] },
    Grips { name: "soft", stiffness_n_per_m: [200.0, 1e3], damping: [0.3, 0.7] },
    Grips { name: "little damped", stiffness_n_per_m: [1e3, 3e4], damping: [0.05, 0.3] },
];

/// A hand, by its numbers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hand {
    pub(super) mass_kg: f64,
    /// Speed at which it aims.
    pub(super) speed_m_per_s: f64,
    /// Its greatest voluntary force.
    pub(super) limit_n: f64,
    /// Force per error of speed, N s/m.
    gain: f64,
    /// Stiffness of the grip, N/m.
    grip_n_per_m: f64,
    /// Damping of the grip as a share of the critical one.
    grip_damping: f64,
    /// From the normal to the aim, as a share of the greatest angle, -1 to 1.
    askew: f64,
}

impl Hand {
    /// The hand of a case, drawn from its number: 0.5 to 1.5 kg, 0.05 to 0.5 m/s, 0.4 to 0.9 R.
    pub(super) fn of_case(grips: &Grips, seed: u64, case: u64) -> Self {
        let mut stream = SplitMix64::seed_from_u64(seed);
        (0..7 * case).for_each(|_| _ = stream.next_u64());
        let mut uniform = |low: f64, high: f64| low + (high - low) * share_of_one(&mut stream);
        let [softest, stiffest] = grips.stiffness_n_per_m;
        Self {
            mass_kg: uniform(0.5, 1.5),
            speed_m_per_s: uniform(0.05, 0.5),
            limit_n: uniform(0.4, 0.9) * YIELD_N,
            gain: uniform(20.0, 80.0),
            grip_n_per_m: softest * elementary::powf(stiffest / softest, uniform(0.0, 1.0)),
            grip_damping: uniform(grips.damping[0], grips.damping[1]),
            askew: uniform(-1.0, 1.0),
        }
    }
}

/// The speed of the wall of a case where it is greatest, towards the hand, in m/s: 0.05 to 0.25, receding in every other
/// case, and no faster than the hand follows; and the hand of that case.
pub(super) fn wall_of_case(grips: &Grips, seed: u64, case: u64) -> (f64, Hand) {
    let mut stream = SplitMix64::seed_from_u64(seed ^ 0x57a1);
    (0..2 * case).for_each(|_| _ = stream.next_u64());
    let mut uniform = |low: f64, high: f64| low + (high - low) * share_of_one(&mut stream);
    let (speed, faster) = (uniform(0.05, 0.25), uniform(0.05, 0.5));
    let hand = Hand::of_case(grips, seed, case);
    if case.is_multiple_of(2) {
        (speed, hand)
    } else {
        (-speed, Hand { speed_m_per_s: hand.speed_m_per_s.max(speed + faster), ..hand })
    }
}

/// What came of one hand.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Outcome {
    /// Whether the surface was met at all.
    pub(super) is_met: bool,
    /// Greatest depth of the proxy beyond the surface before a push, in m.
    pub(super) depth_m: f64,
    /// The same of the tool.
    pub(super) tool_depth_m: f64,
    /// From the onset of a push to the first motion of the proxy beyond the surface, in s.
    pub(super) delay_s: Option<f64>,
}

impl Outcome {
    /// Whether the proxy went through with the impact.
    pub(super) fn is_through(&self) -> bool {
        self.depth_m > THROUGH_M
    }
}

/// How a hand meets a surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Strike {
    pub(super) rule: Rule,
    pub(super) place: Place,
    /// From the impact to a push of 1.5 R, in s; `None` for none.
    pub(super) onset_s: Option<f64>,
    /// Greatest speed of the surface towards the hand, in m/s; zero for one at rest.
    pub(super) wall_m_per_s: f64,
    /// Steps of the plant in one cycle, over the usual ones.
    pub(super) finer: u32,
}

impl Strike {
    /// At rest, without a push.
    pub(super) fn at(rule: Rule, place: Place) -> Self {
        Self { rule, place, onset_s: None, wall_m_per_s: 0.0, finer: 1 }
    }

    /// Runs until 1 s after the impact, or until a push is through.
    pub(super) fn run(&self, hand: &Hand) -> Outcome {
        let mut fixture = self.rule.fixture(self.place);
        let angle = if self.place == Place::Wall { 0.0 } else { ASKEW_RAD * hand.askew };
        let aim = -Vector2::new(elementary::cos(angle), elementary::sin(angle));
        let mut start = aim * -(if self.place == Place::Wall { RUN_UP_M } else { RUN_UP_WITHIN_M });
        if self.wall_m_per_s != 0.0 {
            let amplitude_m = Vector2::x() * (self.wall_m_per_s * SWING_S / std::f64::consts::PI);
            fixture =
                fixture.with_motion(Motion { amplitude_m, swing_s: SWING_S }).expect("no faster than a surface may be");
            // Far ahead of the wall, where nothing meets it.
            fixture.reset(&(Vector2::x() * 10.0)).expect("a finite start");
            for _ in 0..(WALL_AHEAD_S / PERIOD_S) as u32 {
                fixture.step_admittance(&Vector2::zeros());
            }
            start = fixture.origin() + Vector2::x() * WALL_START_M;
        }
        self.strike(fixture, hand, aim, start)
    }

    fn strike(&self, mut fixture: Fixture<Shape2, 2>, hand: &Hand, aim: Vector2<f64>, start: Vector2<f64>) -> Outcome {
        fixture.reset(&start).expect("a finite start");
        let rest = Vector2::zeros();
        let (mut tool, mut tool_v, mut sensed) = (start, rest, rest);
        let (mut holder, mut holder_v) = (start, rest);
        let grip_n_s_per_m = 2.0 * hand.grip_damping * (hand.grip_n_per_m * hand.mass_kg).sqrt();
        let mut targets = [(start, rest); 2];
        let mut before = start;
        let mut impact_s: Option<f64> = None;
        let mut outcome = Outcome::default();
        let substeps = SUBSTEPS * self.finer;
        let dt = PERIOD_S / f64::from(substeps);
        for cycle in 0..8000 {
            let time = f64::from(cycle) * PERIOD_S;
            let since = impact_s.map_or(0.0, |impact| time - impact);
            if since > AFTER_S || outcome.delay_s.is_some() {
                break;
            }
            let is_pushing = impact_s.is_some() && self.onset_s.is_some_and(|onset| since >= onset);
            let step = fixture.step_admittance(&sensed);
            let depth = -step.signed_distance_m;
            if impact_s.is_none() && (step.is_impact || depth > 0.0) {
                impact_s = Some(time);
                outcome.is_met = true;
            }
            if impact_s.is_some() {
                if !is_pushing {
                    outcome.depth_m = outcome.depth_m.max(depth);
                    outcome.tool_depth_m = outcome.tool_depth_m.max(-fixture.signed_distance_m(&tool));
                } else if depth > outcome.depth_m.max(THROUGH_M) {
                    outcome.delay_s = self.onset_s.map(|onset| since - onset);
                }
            }
            targets = [targets[1], (step.proxy, (step.proxy - before) / PERIOD_S)];
            before = step.proxy;
            let (target, rate) = targets[0];
            // Stiffness and damping with a limit on the force, held over the cycle as a drive holds its torque.
            let servo = sat((target - tool) * SERVO_N_PER_M + (rate - tool_v) * SERVO_N_S_PER_M, SERVO_LIMIT_N);
            for _ in 0..substeps {
                let voluntary = if is_pushing {
                    Vector2::x() * (-1.5 * YIELD_N)
                } else {
                    // Friction is paid for.
                    sat((aim * hand.speed_m_per_s - holder_v) * hand.gain + aim * FRICTION_N, hand.limit_n)
                };
                sensed = (holder - tool) * hand.grip_n_per_m + (holder_v - tool_v) * grip_n_s_per_m;
                tool_v += (servo + sensed) * (dt / TOOL_KG);
                holder_v += (voluntary - sensed) * (dt / hand.mass_kg);
                tool += tool_v * dt;
                holder += holder_v * dt;
            }
        }
        outcome
    }
}
