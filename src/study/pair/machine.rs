//! Two devices far apart that move as one: a master in the hand, a slave at the work, and one fixture for both.
//!
//! ```text
//! master's side    hand -> force h, tool p ------------------- delay --> slave's side (fixture there)
//!                  fixture here or there: h + e -> proxy q
//!                  servo -> master         <-- delay -- q or e         servo -> slave -> surroundings -> force e
//! ```
//! Both tools track the proxy of the fixture. The forces of the hand and of the surroundings move the proxy together. The place
//! of the fixture decides which of the two forces is late. At the master, the hand's loop is closed at once, and the loop of the
//! surroundings has the delay to and fro. At the slave it is the other way about.

use std::collections::VecDeque;

use nalgebra::SVector;

use yieldwall_motion::fixture::{Fixture, Step, Surface};
use yieldwall_motion::setvalued::sat;
use yieldwall_rig::RigError;
use yieldwall_sim::hand::{Hand, HandLoad};
use yieldwall_sim::point_mass::{PointMass, PointMassParameters};

/// On which side of the delay the fixture stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Placement {
    /// With the hand.
    Master,
    /// With the work.
    Slave,
}

/// Spring and damper from a tool to the proxy, in every direction, with a limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairServo {
    /// N/m.
    pub stiffness_n_per_m: f64,
    /// N s/m, on the difference of both velocities.
    pub damping_n_s_per_m: f64,
    /// Greatest force in N.
    pub limit_n: f64,
}

/// Parameters of a pair, besides fixture, hand and surroundings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairParameters {
    /// Where the fixture stands.
    pub placement: Placement,
    /// Periods that a message takes from one side to the other.
    pub delay_steps: u32,
    /// The device in the hand.
    pub master: PointMassParameters,
    /// The device at the work.
    pub slave: PointMassParameters,
    /// Servo of both devices.
    pub servo: PairServo,
    /// Longest step of the simulation in s.
    pub plant_step_s: f64,
}

/// State of one period, sampled at its beginning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairRow<const N: usize> {
    /// Time in s.
    pub time_s: f64,
    /// Master and slave in m.
    pub tools_m: [SVector<f64, N>; 2],
    /// Where they are asked to be, in m.
    pub targets_m: [SVector<f64, N>; 2],
    /// Force of the hand on the master in N, as a sensor reads it.
    pub hand_n: SVector<f64, N>,
    /// Force of the surroundings on the slave in N.
    pub surroundings_n: SVector<f64, N>,
    /// Step of the fixture.
    pub step: Step<N>,
}

/// A message on its way.
#[derive(Clone, Debug)]
struct Line<T>(VecDeque<T>);

impl<T: Copy> Line<T> {
    fn new(first: T, delay_steps: u32) -> Self {
        Self(std::iter::repeat_n(first, delay_steps as usize).collect())
    }

    /// Sends one and gives what arrives.
    fn pass(&mut self, sent: T) -> T {
        self.0.push_back(sent);
        self.0.pop_front().unwrap_or(sent)
    }
}

/// Load of the surroundings on a slave at a position, at a time.
pub type Surroundings<const N: usize> = Box<dyn FnMut(f64, SVector<f64, N>) -> HandLoad<N> + Send>;

/// A telemanipulation pair in virtual time.
pub struct Pair<S, const N: usize> {
    parameters: PairParameters,
    fixture: Fixture<S, N>,
    hand: Hand<N>,
    surroundings: Surroundings<N>,
    master: Tool<N>,
    slave: Tool<N>,
    /// Hand force and master's position to the slave.
    there: Line<[SVector<f64, N>; 2]>,
    /// Proxy from the fixture's side to the other.
    proxies: Line<SVector<f64, N>>,
    /// Force of the surroundings to the master.
    back: Line<SVector<f64, N>>,
    sample: u64,
}

/// A device under its servo.
struct Tool<const N: usize> {
    mass: PointMass<N>,
    target: SVector<f64, N>,
}

impl<const N: usize> Tool<N> {
    /// The servo's force towards a target, whose velocity is its backward difference.
    fn servo_n(&mut self, servo: &PairServo, target: SVector<f64, N>, period_s: f64) -> SVector<f64, N> {
        let rate = (target - self.target) / period_s;
        self.target = target;
        let pull = (target - self.mass.reported_position_m()) * servo.stiffness_n_per_m;
        sat(pull + (rate - self.mass.velocity_m_per_s()) * servo.damping_n_s_per_m, servo.limit_n)
    }
}

impl<S: Surface<N>, const N: usize> Pair<S, N> {
    /// Both tools and the proxy at rest where the hand's path starts.
    ///
    /// # Errors
    /// If the fixture is not of the admittance type, or a device is refused.
    pub fn new(
        parameters: PairParameters,
        mut fixture: Fixture<S, N>,
        mut hand: Hand<N>,
        surroundings: Surroundings<N>,
    ) -> Result<Self, RigError> {
        if !matches!(fixture.parameters().coupling, yieldwall_motion::fixture::Coupling::Admittance(_)) {
            return Err(RigError::NoAdmittance);
        }
        let start = hand.target(0.0).position_m;
        fixture.reset(&start)?;
        let tool = |of, hand_kg| Ok::<_, RigError>(Tool { mass: PointMass::new(of, hand_kg, start)?, target: start });
        let delay = parameters.delay_steps;
        Ok(Self {
            master: tool(parameters.master, hand.mass_kg())?,
            slave: tool(parameters.slave, 0.0)?,
            there: Line::new([SVector::zeros(), start], delay),
            proxies: Line::new(start, delay),
            back: Line::new(SVector::zeros(), delay),
            parameters,
            fixture,
            hand,
            surroundings,
            sample: 0,
        })
    }

    /// The fixture.
    pub fn fixture(&self) -> &Fixture<S, N> {
        &self.fixture
    }

    /// One period.
    ///
    /// # Errors
    /// If a simulated device cannot go on.
    pub fn run_cycle(&mut self) -> Result<PairRow<N>, RigError> {
        let PairParameters { placement, servo, plant_step_s, .. } = self.parameters;
        let period_s = self.fixture.parameters().period_s;
        let time_s = self.sample as f64 * period_s;
        let (master, slave) = (&self.master.mass, &self.slave.mass);
        let (held, at_work) = (master.reported_position_m(), slave.reported_position_m());
        let speed = master.velocity_m_per_s();
        let hand_n = self.hand.force_on_tool(time_s, master.position_m(), speed, master.acceleration_m_per_s2());
        let load = (self.surroundings)(time_s, slave.position_m());
        let surroundings_n = load.force_n - slave.velocity_m_per_s() * load.damping_n_s_per_m;

        // The port to the hand is what the passivity controller watches, with force and position of one moment.
        let arrived = self.there.pass([hand_n, held]);
        let late = self.back.pass(surroundings_n);
        let ([hand_read, held_read], surroundings_read) = match placement {
            Placement::Master => ([hand_n, held], late),
            Placement::Slave => (arrived, surroundings_n),
        };
        let step = self.fixture.step_admittance(&(hand_read + surroundings_read));
        let near = self.fixture.dissipate(&held_read, &hand_read);
        let far = self.proxies.pass(near);
        let targets_m = match placement {
            Placement::Master => [near, far],
            Placement::Slave => [far, near],
        };
        let row = PairRow { time_s, tools_m: [held, at_work], targets_m, hand_n, surroundings_n, step };

        let [to_master, to_slave] = targets_m;
        let master_n = self.master.servo_n(&servo, to_master, period_s);
        let slave_n = self.slave.servo_n(&servo, to_slave, period_s);
        self.sample += 1;
        let end_s = self.sample as f64 * period_s;
        let (hand, surroundings) = (&mut self.hand, &mut self.surroundings);
        self.master.mass.advance_to(end_s, plant_step_s, master_n, |time, at| hand.load(time, at))?;
        self.slave.mass.advance_to(end_s, plant_step_s, slave_n, surroundings)?;
        Ok(row)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector1;
    use yieldwall_motion::fixture::{Admittance, Coupling, Curvature, Limits, Parameters, Plane, Rearm, Side};
    use yieldwall_sim::hand::{HandParameters, Leg, Path};

    /// A hand that goes 15 mm beyond a wall of 20 N at 0, by 6 N, on a pair with this delay; the rows of 2 s.
    fn rows(placement: Placement, delay_steps: u32) -> Vec<PairRow<1>> {
        let parameters = Parameters {
            coupling: Coupling::Admittance(Admittance { mass_kg: 2.0 }),
            limits: Limits { friction_n: 3.0, yield_n: 20.0 },
            side: Side::Unilateral,
            hold_steps: 20,
            rearm: Rearm::OffSurface,
            curvature: Curvature::Tangent,
            period_s: 1e-3,
        };
        let fixture = Fixture::new(Plane::new(Vector1::zeros(), Vector1::x()).unwrap(), parameters).unwrap();
        let hand = HandParameters {
            mass_kg: 0.5,
            stiffness_n_per_m: 400.0,
            damping_n_s_per_m: 8.0,
            voluntary_force_limit_n: 40.0,
            tremor: None,
            aim_error: None,
        };
        let path = [Leg::To { point_m: Vector1::new(-0.015), in_s: 0.8 }];
        let hand = Hand::new(hand, Path::new(Vector1::new(0.04), &path).unwrap(), 1).unwrap();
        let device = PointMassParameters { mass_kg: 2.0, damping_n_s_per_m: 5.0, position_resolution_m: 0.0 };
        let servo = PairServo { stiffness_n_per_m: 50e3, damping_n_s_per_m: 500.0, limit_n: 200.0 };
        let pair = PairParameters { placement, delay_steps, master: device, slave: device, servo, plant_step_s: 1e-4 };
        let mut pair = Pair::new(pair, fixture, hand, Box::new(|_, _| HandLoad::default())).unwrap();
        (0..2000).map(|_| pair.run_cycle().unwrap()).collect()
    }

    /// Without a delay it does not matter where the fixture stands, to the last bit.
    #[test]
    fn without_a_delay_both_places_are_one() {
        assert_eq!(rows(Placement::Master, 0), rows(Placement::Slave, 0));
    }

    /// The side without the fixture does what the other did a delay ago, and the wall holds on both.
    #[test]
    fn the_far_side_follows_by_the_delay() {
        for (placement, near) in [(Placement::Master, 0), (Placement::Slave, 1)] {
            let rows = rows(placement, 10);
            for pair in rows.windows(11) {
                assert_eq!(pair[10].targets_m[1 - near], pair[0].targets_m[near], "{placement:?}");
            }
            let last = rows.last().unwrap();
            assert!(last.tools_m.iter().all(|tool| tool.x.abs() < 1e-3), "{placement:?} {last:?}");
            assert!((last.hand_n.x + 6.0).abs() < 0.5, "{placement:?} {last:?}");
        }
    }

    #[test]
    fn the_hand_is_late_at_the_slave_and_at_once_at_the_master() {
        let [here, there] = [Placement::Master, Placement::Slave].map(|placement| rows(placement, 10));
        let began = |rows: &[PairRow<1>]| rows.iter().position(|row| row.targets_m[0] != rows[0].targets_m[0]).unwrap();
        assert_eq!(began(&there), began(&here) + 20, "to and fro");
    }
}
