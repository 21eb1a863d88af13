//! The loop closed over a rigid arm with viscous friction.

use super::*;

const VISCOUS: f64 = 0.5;
/// Steps of the integration in a period.
const SUBSTEPS: u32 = 20;

/// Joints under torque.
struct Plant {
    angles: JointAngles,
    rates: JointRates,
}

impl Plant {
    fn advance(&mut self, linkage: &FiveBar, torques: JointTorques) {
        let step = PERIOD_S / f64::from(SUBSTEPS);
        for _ in 0..SUBSTEPS {
            let dynamics = linkage.dynamics(&mass_model(), self.angles, self.rates).unwrap();
            let net = torques.0 - self.rates.0 * VISCOUS - dynamics.bias.0;
            self.rates.0 += dynamics.mass.try_inverse().unwrap() * net * step;
            self.angles += self.rates.for_s(step);
        }
    }
}

/// Largest distance of the tool from the proxy over a push of 0.4 s and a rest, torques applied one cycle late.
fn worst_error(servo: Servo) -> f64 {
    let mut bench = Bench::new(servo, [-0.05, 0.02]);
    bench.enable();
    let angles = JointAngles::from(bench.angles.map(Option::unwrap));
    let mut plant = Plant { angles, rates: JointRates::default() };
    let mut pending = JointTorques::default();
    let mut worst: f64 = 0.0;
    for cycle in 0..600 {
        bench.force = match cycle {
            0..200 => [6.0, 3.0],
            200..400 => [-1.0, 3.5],
            _ => [0.0, 0.0],
        };
        let outputs = bench.step(Request::None);
        assert_eq!(outputs.directive.state, State::Running, "{:?}", bench.cycle.cause());
        let applied = match outputs.command.get() {
            JointCommand::Torque(torques) => std::mem::replace(&mut pending, *torques),
            JointCommand::Velocity(rates) => {
                plant.rates = *rates;
                plant.angles += rates.for_s(PERIOD_S);
                bench.angles = plant.angles.to_array().map(Some);
                worst = worst.max((outputs.signals.proxy - outputs.signals.tool).norm());
                continue;
            }
            JointCommand::Position(_) => unreachable!(),
        };
        plant.advance(&bench.cycle.linkage, applied);
        bench.angles = plant.angles.to_array().map(Some);
        worst = worst.max((outputs.signals.proxy - outputs.signals.tool).norm());
    }
    let way = (bench.reference().point - TipPoint::new(-0.05, 0.02)).norm();
    assert!(way > 0.03, "the proxy went somewhere: {way}");
    worst
}

#[test]
fn the_arm_follows_the_proxy_in_every_law_and_space() {
    for law in [Law::Psmc, Law::Pid] {
        for is_cartesian in [false, true] {
            let error = worst_error(torque_servo(law, is_cartesian));
            assert!(error < 1.5e-3, "{law:?} cartesian {is_cartesian}: {error}");
        }
    }
    let error = worst_error(velocity_servo());
    assert!(error < 1e-3, "velocity: {error}");
}

#[test]
fn a_broken_law_does_not_follow() {
    let Servo::Torque(mut servo) = torque_servo(Law::Psmc, true) else { unreachable!() };
    servo.inertia = None;
    let weak = Gains { stiffness: 4_000.0, damping: 200.0, integral: 0.0 };
    servo.axes = [0, 1].map(|_| Law::Pid.controller(weak, 0.0, PERIOD_S).unwrap());
    assert!(worst_error(Servo::Torque(servo)) > 1.5e-3, "the bound tells a good loop from a bad one");
}

/// Returns two results of a blocked arm, in m. The first is the greatest distance of the proxy from the tool, while blocked and afterwards.
/// The second is the overshoot of the tool beyond the proxy after its release.
fn blocked(servo: Servo) -> [f64; 2] {
    let start = Vector2::new(-0.05, 0.02);
    let mut bench = Bench::new(servo, start.into());
    // Torque without motion is what is asked for here.
    bench.cycle.settings.residual_limit_n_m = None;
    bench.enable();
    let angles = JointAngles::from(bench.angles.map(Option::unwrap));
    let mut plant = Plant { angles, rates: JointRates::default() };
    let mut pending = JointTorques::default();
    let (mut farthest, mut beyond, mut saturated) = (0.0_f64, 0.0_f64, 0);
    for cycle in 0..3000 {
        let is_blocked = cycle < 2000;
        bench.force = if is_blocked { [30.0, 0.0] } else { [0.0, 0.0] };
        let outputs = bench.step(Request::None);
        assert_eq!(outputs.directive.state, State::Running, "{cycle}: {:?}", bench.cycle.cause());
        let JointCommand::Torque(torques) = outputs.command.get() else { unreachable!() };
        let applied = std::mem::replace(&mut pending, *torques);
        let (tool, proxy) = (outputs.signals.tool, outputs.signals.proxy);
        farthest = farthest.max((proxy - tool).norm());
        if is_blocked {
            saturated += i32::from(outputs.signals.is_saturated);
        } else {
            plant.advance(&bench.cycle.linkage, applied);
            bench.angles = plant.angles.to_array().map(Some);
            beyond = beyond.max((tool - proxy).x());
        }
    }
    assert!(saturated > 1800, "blocked at the limit: {saturated} cycles");
    let (proxy, rates) = (bench.reference().point, plant.rates.norm());
    let left = (bench.cycle.posture.unwrap().tip - proxy).norm();
    assert!(left < 2e-4 && rates < 1e-2, "it comes to rest: {left} m, {rates} rad/s");
    [farthest, beyond]
}

/// 30 N of the hand alone would take the proxy 27 m away in 2 s.
#[test]
fn the_proxy_of_a_blocked_arm_stays_and_the_arm_does_not_shoot_past_it() {
    for law in [Law::Psmc, Law::Pid] {
        for is_cartesian in [false, true] {
            let [farthest, beyond] = blocked(torque_servo(law, is_cartesian));
            // Limit over what the integral leaves of the spring, F/(K - L B/K): 12.4 mrad at the joints, which turn the tool by
            // 0.4 m/rad, and 2.6 mm at the tool; and what the sliding adds on the way there.
            let stated = if is_cartesian { 3.7e-3 } else { 5.5e-3 };
            assert!(farthest < stated, "{law:?} cartesian {is_cartesian}: {farthest} m from the tool");
            // At the joints spring and damping do not overshoot; with the damping ratio of 0.7 at the tool they do by 3 %.
            let passed = if is_cartesian { 1.5e-4 } else { 1e-5 };
            assert!(beyond < passed, "{law:?} cartesian {is_cartesian}: {beyond} m beyond, {farthest} m");
        }
    }
}
