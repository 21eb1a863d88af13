//! One hand and one surface in the plane.

use nalgebra::Vector2;
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use yieldwall_config as config;
use yieldwall_motion::elementary;
use yieldwall_motion::fixture::{
    Admittance, AutomaticHold, Coupling, Curvature, Fixture, Limits, Motion, Parameters, Rearm, Shape2, Side,
};
use yieldwall_motion::setvalued::sat;
use yieldwall_sim::share_of_one;

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
/// Cycles of a run at most.
const LONGEST_CYCLES: u32 = 8000;
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

    fn fixture(self, place: StruckSurface) -> Fixture<Shape2, 2> {
        let parameters = Parameters {
            coupling: Coupling::Admittance(Admittance { mass_kg: PROXY_KG }),
            limits: Limits { friction_n: FRICTION_N, yield_n: YIELD_N },
            side: if place == StruckSurface::Guide { Side::Bilateral } else { Side::Unilateral },
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

/// Surface that the hand strikes. The hand comes along the negative x axis, and meets the surface at the origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StruckSurface {
    /// A plane wall, head-on.
    Wall,
    /// A wall round the hand's room, at an angle.
    Circle,
    /// The inner corner of two walls, at an angle.
    Corner,
    /// A circular guide, at an angle: what is caught goes on along it.
    Guide,
}

pub(super) const PLACES: [StruckSurface; 4] =
    [StruckSurface::Wall, StruckSurface::Circle, StruckSurface::Corner, StruckSurface::Guide];

impl StruckSurface {
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

/// Returns the speed of the wall of a case where it is greatest, towards the hand, in m/s, and the hand of that case. The speed
/// is 0.05 to 0.25, receding in every other case, and no faster than the hand follows.
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

/// Result of one hand.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StrikeResult {
    /// Whether the surface was met at all.
    pub(super) is_met: bool,
    /// Greatest depth of the proxy beyond the surface before a push, in m.
    pub(super) depth_m: f64,
    /// Greatest depth of the tool beyond the surface before a push, in m.
    pub(super) tool_depth_m: f64,
    /// From the onset of a push to the first motion of the proxy beyond the surface, in s.
    pub(super) delay_s: Option<f64>,
}

impl StrikeResult {
    /// Whether the proxy went through with the impact.
    pub(super) fn is_through(&self) -> bool {
        self.depth_m > THROUGH_M
    }
}

/// How a hand meets a surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Strike {
    pub(super) rule: Rule,
    pub(super) place: StruckSurface,
    /// From the impact to a push of 1.5 R, in s; `None` for none.
    pub(super) onset_s: Option<f64>,
    /// Greatest speed of the surface towards the hand, in m/s; zero for one at rest.
    pub(super) wall_m_per_s: f64,
    /// Steps of the plant in one cycle, over the usual ones.
    pub(super) finer: u32,
}

impl Strike {
    /// At rest, without a push.
    pub(super) fn at(rule: Rule, place: StruckSurface) -> Self {
        Self { rule, place, onset_s: None, wall_m_per_s: 0.0, finer: 1 }
    }

    fn substeps(&self) -> u32 {
        SUBSTEPS * self.finer
    }
}

/// Runs hands against surfaces, each until 1 s after its impact, or until its push is through; their outcomes, in the same order.
///
/// A step waits for the last one of the same hand. So several hands take turns, and the processor goes on with the others meanwhile.
pub(super) fn run_all(strikes: impl IntoIterator<Item = (Strike, Hand)>) -> Vec<StrikeResult> {
    const HANDS: usize = 8;
    let mut waiting = strikes.into_iter();
    let mut outcomes = Vec::new();
    let mut running: Vec<(usize, Run)> = Vec::with_capacity(HANDS);
    loop {
        running.retain_mut(|(index, run)| {
            let goes_on = run.begin_cycle();
            if !goes_on {
                outcomes[*index] = run.outcome;
            }
            goes_on
        });
        while running.len() < HANDS
            && let Some((strike, hand)) = waiting.next()
        {
            let mut run = Run::new(strike, hand);
            run.begin_cycle();
            running.push((outcomes.len(), run));
            outcomes.push(StrikeResult::default());
        }
        let Some(substeps) = running.iter().map(|(_, run)| run.strike.substeps()).max() else { return outcomes };
        for substep in 0..substeps {
            for (_, run) in running.iter_mut().filter(|(_, run)| substep < run.strike.substeps()) {
                run.bodies.step();
            }
        }
    }
}

/// A hand on its way.
struct Run {
    strike: Strike,
    fixture: Fixture<Shape2, 2>,
    bodies: Bodies,
    cycle: u32,
    /// Position and rate of the proxy in the last two cycles: the servo is a cycle late.
    targets: [(Vector2<f64>, Vector2<f64>); 2],
    before: Vector2<f64>,
    impact_s: Option<f64>,
    outcome: StrikeResult,
}

impl Run {
    fn new(strike: Strike, hand: Hand) -> Self {
        let mut fixture = strike.rule.fixture(strike.place);
        let angle = if strike.place == StruckSurface::Wall { 0.0 } else { ASKEW_RAD * hand.askew };
        let aim = -Vector2::new(elementary::cos(angle), elementary::sin(angle));
        let mut start = aim * -(if strike.place == StruckSurface::Wall { RUN_UP_M } else { RUN_UP_WITHIN_M });
        if strike.wall_m_per_s != 0.0 {
            let amplitude_m = Vector2::x() * (strike.wall_m_per_s * SWING_S / std::f64::consts::PI);
            fixture =
                fixture.with_motion(Motion { amplitude_m, swing_s: SWING_S }).expect("no faster than a surface may be");
            // Far ahead of the wall, where nothing meets it.
            fixture.reset(&(Vector2::x() * 10.0)).expect("a finite start");
            for _ in 0..(WALL_AHEAD_S / PERIOD_S) as u32 {
                fixture.step_admittance(&Vector2::zeros());
            }
            start = fixture.origin() + Vector2::x() * WALL_START_M;
        }
        fixture.reset(&start).expect("a finite start");
        Self {
            strike,
            fixture,
            bodies: Bodies::at_rest(&hand, aim, start, PERIOD_S / f64::from(strike.substeps())),
            cycle: 0,
            targets: [(start, Vector2::zeros()); 2],
            before: start,
            impact_s: None,
            outcome: StrikeResult::default(),
        }
    }

    /// The fixture's step of a cycle and the servo's force; whether the run goes on.
    fn begin_cycle(&mut self) -> bool {
        let Self { strike, fixture, bodies, outcome, .. } = self;
        let time = f64::from(self.cycle) * PERIOD_S;
        let since = self.impact_s.map_or(0.0, |impact| time - impact);
        if self.cycle == LONGEST_CYCLES || since > AFTER_S || outcome.delay_s.is_some() {
            return false;
        }
        self.cycle += 1;
        bodies.is_pushing = self.impact_s.is_some() && strike.onset_s.is_some_and(|onset| since >= onset);
        let step = fixture.step_admittance(&bodies.sensed);
        let depth = -step.signed_distance_m;
        if self.impact_s.is_none() && (step.is_impact || depth > 0.0) {
            self.impact_s = Some(time);
            outcome.is_met = true;
        }
        if self.impact_s.is_some() {
            if !bodies.is_pushing {
                outcome.depth_m = outcome.depth_m.max(depth);
                outcome.tool_depth_m = outcome.tool_depth_m.max(-fixture.signed_distance_m(&bodies.tool));
            } else if depth > outcome.depth_m.max(THROUGH_M) {
                outcome.delay_s = strike.onset_s.map(|onset| since - onset);
            }
        }
        self.targets = [self.targets[1], (step.proxy, (step.proxy - self.before) / PERIOD_S)];
        self.before = step.proxy;
        let (target, rate) = self.targets[0];
        // Stiffness and damping with a limit on the force, held over the cycle as a drive holds its torque.
        let Bodies { tool, tool_v, .. } = *bodies;
        bodies.servo = sat((target - tool) * SERVO_N_PER_M + (rate - tool_v) * SERVO_N_S_PER_M, SERVO_LIMIT_N);
        true
    }
}

/// Tool, and the hand that holds it by its grip.
struct Bodies {
    tool: Vector2<f64>,
    tool_v: Vector2<f64>,
    holder: Vector2<f64>,
    holder_v: Vector2<f64>,
    /// Force of the grip on the tool.
    sensed: Vector2<f64>,
    /// Force of the servo on the tool.
    servo: Vector2<f64>,
    is_pushing: bool,
    /// Velocity at which the hand aims, and what it presses beside that: friction is paid for.
    aim_v: Vector2<f64>,
    paid: Vector2<f64>,
    gain: f64,
    limit_n: f64,
    grip_n_per_m: f64,
    grip_n_s_per_m: f64,
    dt: f64,
    per_tool: f64,
    per_holder: f64,
}

impl Bodies {
    fn at_rest(hand: &Hand, aim: Vector2<f64>, start: Vector2<f64>, dt: f64) -> Self {
        let rest = Vector2::zeros();
        Self {
            tool: start,
            tool_v: rest,
            holder: start,
            holder_v: rest,
            sensed: rest,
            servo: rest,
            is_pushing: false,
            aim_v: aim * hand.speed_m_per_s,
            paid: aim * FRICTION_N,
            gain: hand.gain,
            limit_n: hand.limit_n,
            grip_n_per_m: hand.grip_n_per_m,
            grip_n_s_per_m: 2.0 * hand.grip_damping * (hand.grip_n_per_m * hand.mass_kg).sqrt(),
            dt,
            per_tool: dt / TOOL_KG,
            per_holder: dt / hand.mass_kg,
        }
    }

    #[inline]
    fn step(&mut self) {
        let voluntary = if self.is_pushing {
            Vector2::x() * (-1.5 * YIELD_N)
        } else {
            sat((self.aim_v - self.holder_v) * self.gain + self.paid, self.limit_n)
        };
        self.sensed =
            (self.holder - self.tool) * self.grip_n_per_m + (self.holder_v - self.tool_v) * self.grip_n_s_per_m;
        self.tool_v += (self.servo + self.sensed) * self.per_tool;
        self.holder_v += (voluntary - self.sensed) * self.per_holder;
        self.tool += self.tool_v * self.dt;
        self.holder += self.holder_v * self.dt;
    }
}
