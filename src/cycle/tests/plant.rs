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
            self.angles.0 += self.rates.0 * step;
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
                plant.angles.0 += rates.0 * PERIOD_S;
                bench.angles = plant.angles.to_array().map(Some);
                worst = worst.max((outputs.signals.proxy.0 - outputs.signals.tool.0).norm());
                continue;
            }
            JointCommand::Position(_) => unreachable!(),
        };
        plant.advance(&bench.cycle.linkage, applied);
        bench.angles = plant.angles.to_array().map(Some);
        worst = worst.max((outputs.signals.proxy.0 - outputs.signals.tool.0).norm());
    }
    let way = (bench.reference().point.0 - Vector2::new(-0.05, 0.02)).norm();
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
