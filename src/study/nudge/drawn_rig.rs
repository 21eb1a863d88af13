//! A rig and a hand from a number.

use std::f64::consts::TAU;

use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use super::super::drawn::{finite, not_negative, positive, shipped};
use yieldwall_config::{self as config, CommandMode, ControlGains, SensorProtocol, Surface};
use yieldwall_motion::control::Grip;
use yieldwall_motion::elementary;
use yieldwall_sim::share_of_one;

/// Seed of all rigs.
const SEED: u64 = 2027;
/// Periods that are drawn, us, and with them where a drawn torque servo is as stiff as at 1 ms in cycles of its own.
const PERIODS_US: [u32; 8] = [500, 1000, 1000, 1200, 2000, 4000, 5000, 10_000];

/// A stream of random numbers. Equal seeds give equal numbers.
struct Dice(SplitMix64);

impl Dice {
    fn new(seed: u64) -> Self {
        Self(SplitMix64::seed_from_u64(seed))
    }

    /// Evenly.
    fn between(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * share_of_one(&mut self.0)
    }

    /// Evenly in the logarithm.
    fn log_between(&mut self, least: f64, most: f64) -> f64 {
        least * elementary::powf(most / least, share_of_one(&mut self.0))
    }

    fn chance(&mut self, probability: f64) -> bool {
        share_of_one(&mut self.0) < probability
    }

    fn one_of<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[(share_of_one(&mut self.0) * choices.len() as f64) as usize]
    }
}

/// A rig with its hand.
#[derive(Clone, Debug)]
pub(super) struct Drawn {
    pub(super) rig: config::Rig,
    pub(super) scene: config::Scene,
    pub(super) grip: Grip,
}

impl Drawn {
    /// Returns the rig of a number: the modes alternate, everything else is random.
    ///
    /// # Errors
    /// If the file from which it is made is refused.
    pub(super) fn of(number: u64) -> Result<Self, String> {
        let mut seeds = SplitMix64::seed_from_u64(SEED);
        (0..number).for_each(|_| _ = seeds.next_u64());
        let dice = &mut Dice::new(seeds.next_u64());
        let file = match number % 4 {
            0 | 2 => "paper-admittance-csp.yaml",
            1 => "paper-admittance.yaml",
            _ => "paper-admittance-cartesian.yaml",
        };
        let (mut rig, scene) = shipped(file)?;
        draw_cycle(dice, &mut rig);
        draw_sensor(dice, &mut rig);
        draw_arm(dice, &mut rig);
        draw_servo(dice, &mut rig);
        draw_surface(dice, &mut rig);
        let stiffness_n_per_m = dice.log_between(100.0, 20_000.0);
        let grip = Grip {
            stiffness_n_per_m,
            damping_n_s_per_m: dice.between(0.2, 0.8) * stiffness_n_per_m.sqrt(),
            mass_kg: if dice.chance(0.15) { 0.0 } else { dice.between(0.0, 1.5) },
        };
        Ok(Self { rig, scene, grip })
    }
}

fn draw_cycle(dice: &mut Dice, rig: &mut config::Rig) {
    let period_us = dice.one_of(&PERIODS_US);
    rig.cycle.period_us = period_us;
    rig.cycle.compute_at_us = match period_us {
        1000 => 700,
        _ => period_us / 2,
    };
    let heartbeat_ms = if period_us > 2000 { 100 } else { 20 };
    rig.buses.values_mut().filter_map(config::Bus::canopen_mut).for_each(|bus| bus.heartbeat_ms = heartbeat_ms);
    let drives = rig.drives.iter_mut().filter_map(|drive| drive.address.canopen_mut());
    drives.for_each(|node| node.heartbeat_ms = heartbeat_ms);
    if let SensorProtocol::Canopen { heartbeat_ms: of_sensor, .. } = &mut rig.sensor.protocol {
        *of_sensor = heartbeat_ms;
    }
    if period_us < 1000 {
        // A bus of 1 Mbit/s carries no cycle of half a millisecond.
        rig.simulation.iter_mut().for_each(|simulation| simulation.timing = config::BusTiming::Ideal);
    }
}

fn draw_sensor(dice: &mut Dice, rig: &mut config::Rig) {
    let cycle_hz = 1e6 / f64::from(rig.cycle.period_us);
    let of_canopen = [1000.0, 500.0, 200.0].into_iter().find(|&rate| rate <= cycle_hz).unwrap_or(200.0);
    rig.sensor.sample_rate_hz = positive(of_canopen);
    let kind = if cycle_hz > 1000.0 { 0 } else { dice.one_of(&[0, 1, 2]) };
    if kind == 1 {
        let rates: &[f64] =
            if cycle_hz == 1000.0 { &[200.0, 400.0, 500.0] } else { &[200.0, 400.0, 500.0, 700.0, 1000.0] };
        rig.sensor.sample_rate_hz = positive(dice.one_of(rates));
        rig.sensor.protocol = SensorProtocol::Streaming {
            command_id: 0x35f,
            data_ids: [0x360, 0x361],
            pair_gap_us: 600,
            zero_at_start: true,
        };
    } else if kind == 2 {
        rig.sensor.sample_rate_hz = positive(dice.one_of(&[200.0, 500.0, 700.0, 1000.0, 2000.0, 3000.0]));
        rig.sensor.protocol = SensorProtocol::Polled {
            base_id: 0x1b0,
            byte_order: config::ByteOrder::BigEndian,
            overload_bits: 0x0002,
            invalid_bits: 0x8000,
            pair_gap_us: 300,
            zero_at_start: true,
        };
    }
    if dice.chance(1.0 / 3.0) {
        rig.sensor.low_pass_hz = Some(positive(dice.log_between(20.0, 0.4 * cycle_hz.min(500.0))));
    }
}

fn draw_arm(dice: &mut Dice, rig: &mut config::Rig) {
    let linkage = &mut rig.linkage;
    let half_base_m = dice.between(0.06, 0.12);
    linkage.base_m = [[-half_base_m, -0.45], [half_base_m, -0.45]].map(|point| point.map(finite));
    linkage.proximal_m = [positive(dice.between(0.29, 0.32)); 2];
    linkage.distal_m = [positive(dice.between(0.39, 0.42)); 2];
    let Some(config::Simulation { arm, .. }) = &mut rig.simulation else { return };
    arm.motor_kg_m2 = [positive(dice.between(0.1, 0.4)), positive(dice.between(0.1, 0.4))];
    arm.proximal_kg = [not_negative(dice.between(0.0, 1.0)); 2];
    arm.distal_kg = [not_negative(dice.between(0.0, 0.5)); 2];
    arm.tool_kg = not_negative(dice.between(0.5, 2.0));
    arm.viscous_n_m_s_per_rad = [not_negative(dice.between(0.0, 2.0)); 2];
    let forward = &mut rig.control.feed_forward;
    forward.viscous_n_m_s_per_rad = arm.viscous_n_m_s_per_rad;
    forward.inertia = dice.chance(0.5).then_some(config::ArmInertia {
        motor_kg_m2: arm.motor_kg_m2,
        proximal_kg: arm.proximal_kg,
        distal_kg: arm.distal_kg,
        tool_kg: arm.tool_kg,
    });
}

/// A servo of the host is as stiff as its cycle allows: with all times in cycles it is that of the file.
fn draw_servo(dice: &mut Dice, rig: &mut config::Rig) {
    let slower = f64::from(rig.cycle.period_us) / 1000.0;
    let bandwidth = dice.between(0.5, 1.0) / slower;
    let scaled = |gain: f64, power: i32| gain * elementary::powi(bandwidth, power);
    match &mut rig.control.gains {
        ControlGains::Joint { stiffness_n_m_per_rad: k, damping_n_m_s_per_rad: b, integral_n_m_per_rad_s: l }
        | ControlGains::Cartesian { stiffness_n_per_m: k, damping_n_s_per_m: b, integral_n_per_m_s: l } => {
            (*k, *b) = (positive(scaled(k.get(), 2)), not_negative(scaled(b.get(), 1)));
            *l = not_negative(if dice.chance(0.5) { scaled(l.get(), 3) } else { 0.0 });
        }
        ControlGains::Rate { .. } => {}
    }
    let Some(config::Simulation { drive_position_loop: drive, .. }) = &mut rig.simulation else { return };
    let bandwidth = dice.between(0.6, 1.2);
    drive.stiffness_n_m_per_rad = positive(drive.stiffness_n_m_per_rad.get() * elementary::powi(bandwidth, 2));
    drive.damping_n_m_s_per_rad = not_negative(drive.damping_n_m_s_per_rad.get() * bandwidth);
    let integral = drive.integral_n_m_per_rad_s.get() * elementary::powi(bandwidth, 3);
    drive.integral_n_m_per_rad_s = not_negative(if dice.chance(0.7) { integral } else { 0.0 });
    drive.period_us = if rig.rig.command_mode == CommandMode::Position && rig.cycle.period_us.is_multiple_of(250) {
        dice.one_of(&[125, 250])
    } else if rig.cycle.period_us.is_multiple_of(125) {
        125
    } else {
        100
    };
}

fn draw_surface(dice: &mut Dice, rig: &mut config::Rig) {
    let center_m = [dice.between(-0.03, 0.03), dice.between(-0.03, 0.03)];
    let radius_m = dice.between(0.05, 0.11);
    let forbidden = config::Forbidden::Inside;
    rig.fixture.surface = if dice.chance(0.5) {
        Surface::Circle { center_m: center_m.map(finite), radius_m: positive(radius_m), forbidden }
    } else {
        let corners = dice.one_of(&[3, 4, 5, 6]);
        let turn = dice.between(0.0, TAU);
        let corner = |number: u32| {
            let (sin, cos) = elementary::sin_cos(turn + TAU * f64::from(number) / f64::from(corners));
            [center_m[0] + radius_m * cos, center_m[1] + radius_m * sin].map(finite)
        };
        Surface::Polygon { points_m: (0..corners).map(corner).collect(), forbidden }
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_config::{Source, load_rig, to_yaml};

    #[test]
    fn a_drawn_rig_could_have_been_written() {
        for number in 0..60 {
            let drawn = Drawn::of(number).unwrap();
            let source = Source::among("rig.yaml", [("rig.yaml".into(), to_yaml(&drawn.rig).unwrap().into())]);
            let read = load_rig(source).unwrap_or_else(|report| panic!("{number}: {report}"));
            assert_eq!(read.value, drawn.rig, "{number}");
        }
    }
}
