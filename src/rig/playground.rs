//! A simulated rig whose hand a person moves.

use nalgebra::Vector2;

use crate::{EmbeddedRig, RigError};
use yieldwall_config as config;
use yieldwall_motion::guard::{Request, State};
use yieldwall_run::Watch;
use yieldwall_sim::hand::PathPoint;

/// Natural frequency with which the aim of the hand follows the pointer, rad/s: nine tenths of a step in 0.13 s.
const FOLLOWING_RAD_PER_S: f64 = 30.0;
/// Greatest speed of the aim, m/s.
const MOST_SPEED_M_PER_S: f64 = 0.6;

/// A rig in the simulation, with a person at its tool and at its supervisor.
///
/// It is made over [`EmbeddedRig`], whose place is the simulation: it reaches no interface of the computer. Time goes on by
/// [`Playground::run_cycle`] alone.
pub struct Playground {
    machine: EmbeddedRig,
    period_s: f64,
    pointer: Option<Pointer>,
    /// Request to the supervisor that is still open.
    asks: Option<Request>,
}

/// A point of the screen that the aim of the hand follows, critically damped.
struct Pointer {
    at_m: Vector2<f64>,
    aim: PathPoint<2>,
}

impl Pointer {
    fn follow(&mut self, period_s: f64) -> PathPoint<2> {
        let PathPoint { position_m, velocity_m_per_s } = &mut self.aim;
        let pull = (self.at_m - *position_m) * FOLLOWING_RAD_PER_S - *velocity_m_per_s * 2.0;
        *velocity_m_per_s =
            (*velocity_m_per_s + pull * (FOLLOWING_RAD_PER_S * period_s)).cap_magnitude(MOST_SPEED_M_PER_S);
        *position_m += *velocity_m_per_s * period_s;
        self.aim
    }
}

impl Playground {
    /// Starts a rig, with its tool where the scene's hand starts, and no hand on it. `watch` observes it from the boot on.
    ///
    /// # Errors
    /// If the rig cannot be built, booted or enabled.
    pub fn start(rig: &config::Rig, scene: &config::Scene, watch: Watch) -> Result<Self, RigError> {
        let mut machine = EmbeddedRig::new(rig, scene, &rig.fixture, scene.seed)?;
        machine.set_watch(watch);
        machine.enable()?;
        machine.move_hand(None);
        let period_s = f64::from(rig.cycle.period_us) * 1e-6;
        Ok(Self { machine, period_s, pointer: None, asks: None })
    }

    /// Returns the place of the tool in the base frame, m.
    pub fn tool_m(&self) -> [f64; 2] {
        self.machine.tool().0.into()
    }

    /// Returns the state of the supervisor.
    pub fn state(&self) -> State {
        self.machine.state()
    }

    /// Makes the hand hold the tool and aim at this point in m in the base frame. The hand takes the tool where the tool is. A
    /// point that is not finite is ignored.
    pub fn hold(&mut self, point_m: [f64; 2]) {
        if !point_m.iter().all(|coordinate| coordinate.is_finite()) {
            return;
        }
        let at_m = Vector2::from(point_m);
        match &mut self.pointer {
            Some(pointer) => pointer.at_m = at_m,
            None => {
                let aim = PathPoint { position_m: self.machine.tool().0, velocity_m_per_s: Vector2::zeros() };
                self.pointer = Some(Pointer { at_m, aim });
            }
        }
    }

    /// Makes the hand let go of the tool.
    pub fn let_go(&mut self) {
        self.pointer = None;
        self.machine.move_hand(None);
    }

    /// Sets the stiffness of the hand, N/m.
    ///
    /// # Errors
    /// For a number that is negative or not finite.
    pub fn set_hand_stiffness(&mut self, stiffness_n_per_m: f64) -> Result<(), RigError> {
        self.machine.set_hand_stiffness(stiffness_n_per_m)
    }

    /// Begins an injection with the next cycle, whatever its own start.
    ///
    /// # Errors
    /// If it is not possible on this rig.
    pub fn inject(&mut self, injection: config::injection::Injection) -> Result<(), RigError> {
        let start_s = self.machine.scene_time_s().max(0.0);
        self.machine.inject(config::injection::Injection { start_s, ..injection })
    }

    /// Asks the supervisor to stop the rig.
    pub fn stop(&mut self) {
        self.asks = Some(Request::Stop);
    }

    /// Asks the supervisor to forget the fault that stopped the rig.
    pub fn reset(&mut self) {
        self.asks = Some(Request::Reset);
    }

    /// Resets and enables the rig; where that is not enough, as after the reset of a node, its network is booted before. Nobody
    /// holds the tool meanwhile.
    ///
    /// # Errors
    /// If it does not come to run.
    pub fn enable(&mut self) -> Result<(), RigError> {
        self.asks = None;
        let enabled = self.machine.enable_again().or_else(|_| self.machine.restart());
        self.let_go();
        enabled
    }

    /// Runs one period.
    ///
    /// # Errors
    /// If the simulated arm cannot go on.
    pub fn run_cycle(&mut self) -> Result<(), RigError> {
        if let Some(pointer) = &mut self.pointer {
            let aim = pointer.follow(self.period_s);
            self.machine.move_hand(Some(aim));
        }
        let request = self.asks.unwrap_or(Request::None);
        self.machine.run_cycle(request)?;
        // A stop is asked for until the rig rests.
        let goes_on =
            matches!(self.machine.state(), State::Enabling | State::Running | State::Holding | State::Stopping);
        self.asks = self.asks.filter(|asks| *asks == Request::Stop && goes_on);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Arc, Mutex};
    use yieldwall_config::injection::{Injection, Kind};
    use yieldwall_record::CycleRecord;

    const WALL_M: f64 = 0.0;

    type Seen = Arc<Mutex<Option<CycleRecord>>>;

    /// A rig with a wall along x = 0, and its last record.
    fn playground(change: impl Fn(&mut config::Fixture)) -> (Playground, Seen) {
        let mut rig = config::load_rig(config::builtin("play.yaml")).unwrap();
        let scene = rig.scene().unwrap().value;
        change(&mut rig.value.fixture);
        let seen = Seen::default();
        let last = Arc::clone(&seen);
        let observer: yieldwall_run::Observer = Box::new(move |record| *last.lock().unwrap() = Some(*record));
        let watch = Watch { observer: Some(observer), ..Watch::default() };
        (Playground::start(&rig.value, &scene, watch).unwrap(), seen)
    }

    fn run(playground: &mut Playground, time_s: f64) {
        (0..(time_s * 1e3) as u32).for_each(|_| playground.run_cycle().unwrap());
    }

    /// Pushes slowly until the hand presses with this force, and rests there for a second.
    fn press(playground: &mut Playground, force_n: f64) {
        let from_m = playground.tool_m()[0];
        let to_m = WALL_M - force_n / 400.0;
        for step in 1..=200 {
            playground.hold([from_m + (to_m - from_m) * f64::from(step) / 200.0, 0.0]);
            run(playground, 0.01);
        }
        run(playground, 1.0);
    }

    fn elastic(fixture: &mut config::Fixture) {
        let law = serde_json::json!({
            "elastic": { "stiffness_n_per_m": 1500.0, "damping_n_s_per_m": 0.0, "is_saturated": false }
        });
        fixture.law = Some(serde_json::from_value(law).unwrap());
    }

    #[test]
    fn a_wall_holds_below_the_yield_force_and_passes_above_and_gives_nothing_back() {
        let (mut playground, _) = playground(|_| ());
        press(&mut playground, 15.0);
        assert!(playground.tool_m()[0].abs() < 5e-4, "{:?}", playground.tool_m());
        press(&mut playground, 25.0);
        let yielded_m = playground.tool_m()[0];
        assert!(yielded_m < -5e-3, "{yielded_m}");
        playground.let_go();
        run(&mut playground, 1.0);
        let back_m = playground.tool_m()[0] - yielded_m;
        assert!(back_m.abs() < 1e-3, "{back_m}");
        assert_eq!(playground.state(), State::Running);
    }

    #[test]
    fn a_spring_throws_the_tool_back() {
        let (mut playground, _) = playground(elastic);
        press(&mut playground, 25.0);
        let pressed_m = playground.tool_m()[0];
        playground.let_go();
        run(&mut playground, 1.0);
        let back_m = playground.tool_m()[0] - pressed_m;
        assert!(back_m > 0.03, "{back_m}");
    }

    #[test]
    fn a_person_stops_enables_and_breaks_the_rig() {
        let (mut playground, seen) = playground(|_| ());
        playground.hold([0.03, 0.0]);
        run(&mut playground, 0.5);
        playground.stop();
        run(&mut playground, 2.0);
        assert_eq!(playground.state(), State::Stopped);
        playground.reset();
        run(&mut playground, 1.0);
        assert_eq!(playground.state(), State::Idle);
        playground.enable().unwrap();
        assert_eq!(playground.state(), State::Running);
        playground.inject(Injection::new(Kind::DriveFault, 0.0)).unwrap();
        run(&mut playground, 1.0);
        assert!(playground.state().is_latched());
        // The rig stays latched by itself.
        run(&mut playground, 3.0);
        assert!(playground.state().is_latched());
        playground.enable().unwrap();
        playground.inject(Injection::new(Kind::NodeReset, 0.0)).unwrap();
        run(&mut playground, 1.0);
        assert!(playground.state().is_latched());
        playground.enable().unwrap();
        assert_eq!(playground.state(), State::Running);
        assert!(seen.lock().unwrap().is_some());
    }

    #[test]
    fn a_point_that_is_none_moves_nothing() {
        let (mut playground, _) = playground(|_| ());
        let before_m = playground.tool_m();
        playground.hold([f64::NAN, 0.0]);
        run(&mut playground, 0.5);
        assert!((playground.tool_m()[0] - before_m[0]).abs() < 1e-4);
        playground.hold([1e300, -1e300]);
        run(&mut playground, 2.0);
        assert!(playground.tool_m().iter().all(|coordinate| coordinate.is_finite()));
    }
}
