//! Variation of a shipped rig.

use std::f64::consts::TAU;
use yieldwall_motion::elementary;

use super::{finite, not_negative, positive};
use crate::dice::Dice;
use yieldwall_config as config;
use yieldwall_motion::linkage::FiveBar;
use yieldwall_motion::quantity::TipPoint;

/// Distance from the wrap of the 32-bit counter, in counts, within which an encoder starts that is to wrap. It is a tenth of the
/// arm's travel in the working disc.
const NEAR_WRAP_COUNTS: f64 = 10_000.0;
/// The half of the range of a 32-bit counter.
const HALF_RANGE_COUNTS: f64 = 2_147_483_648.0;

/// Gives a rig the buses of another one, and puts its devices where those of the other are.
pub(super) fn move_to(rig: &mut config::Rig, other: &config::Rig) {
    rig.buses = other.buses.clone();
    for (drive, there) in rig.drives.iter_mut().zip(&other.drives) {
        (drive.bus, drive.address) = (there.bus.clone(), there.address);
    }
    rig.sensor = other.sensor.clone();
}

/// Sets when the drives of a segment have their outputs act.
pub(super) fn vary_segment(dice: &mut Dice, rig: &mut config::Rig) {
    let outputs = if dice.chance(0.3) { config::OutputsAct::OnArrival } else { config::OutputsAct::Sync0 };
    for bus in rig.buses.values_mut() {
        if let config::Bus::Ethercat(segment) = bus {
            segment.outputs = outputs;
        }
    }
}

pub(super) fn vary_fixture(dice: &mut Dice, rig: &mut config::Rig) {
    let fixture = &mut rig.fixture;
    let yield_n = dice.between(8.0, 35.0);
    fixture.yield_n = positive(yield_n);
    fixture.friction_n = not_negative(dice.between(1.0, 5.0f64.min(0.5 * yield_n)));
    fixture.coupling = config::Coupling::Admittance { mass_kg: positive(dice.between(2.0, 5.0)) };
    fixture.side = if dice.chance(0.5) { config::Side::Bilateral } else { config::Side::Unilateral };
    // One held step is refused: the input position depends on two past ones.
    fixture.hold_steps = if dice.chance(0.5) { 0 } else { dice.whole(2, 100) };
    let forbidden = if dice.chance(0.5) { config::Forbidden::Inside } else { config::Forbidden::Outside };
    if dice.chance(0.7) {
        let center_m = [finite(dice.between(-0.02, 0.02)), finite(dice.between(-0.02, 0.02))];
        fixture.surface = config::Surface::Circle { center_m, radius_m: positive(dice.between(0.07, 0.13)), forbidden };
        fixture.curvature = if dice.chance(0.5) { config::Curvature::Tangent } else { config::Curvature::Exact };
    } else {
        let (sine, cosine) = elementary::sin_cos(dice.between(0.0, TAU));
        let point_m = [finite(dice.between(-0.05, 0.05)), finite(dice.between(-0.05, 0.05))];
        fixture.surface = config::Surface::Line { point_m, normal: [finite(cosine), finite(sine)] };
        fixture.curvature = config::Curvature::Tangent;
    }
}

/// Sets encoders and the sensor's rate; whether the counts are to wrap.
pub(super) fn vary_devices(dice: &mut Dice, rig: &mut config::Rig) -> bool {
    let wraps = dice.chance(0.5);
    let home = FiveBar::new(rig.linkage.geometry()).ok().and_then(|arm| arm.inverse(TipPoint::new(0.0, 0.0)).ok());
    let home = home.map_or([0.0; 2], |angles| angles.to_array());
    for (drive, angle) in rig.drives.iter_mut().zip(home) {
        let counts_per_rad = f64::from(drive.encoder_counts_per_rev) / TAU;
        drive.direction = if dice.chance(0.5) { 1 } else { -1 };
        // counts = direction * (angle - offset) * counts_per_rad
        let counts = if wraps {
            HALF_RANGE_COUNTS + dice.between(-NEAR_WRAP_COUNTS, NEAR_WRAP_COUNTS)
        } else {
            dice.between(-1e6, 1e6)
        };
        drive.zero_offset_rad = finite(angle - f64::from(drive.direction) * counts / counts_per_rad);
    }
    let cycle_hz = 1e6 / f64::from(rig.cycle.period_us);
    let rates: Vec<f64> = [200.0, 500.0, 1000.0].into_iter().filter(|rate| *rate <= cycle_hz).collect();
    if !rates.is_empty() && dice.chance(0.3) {
        rig.sensor.sample_rate_hz = positive(dice.one_of(&rates));
    }
    wraps
}

/// Varies the accuracy of the machine's model. If the drives do not divide the cycle themselves, the plant's step is coarser than
/// in the shipped scenes. The loop that this program closes has no dynamics faster than its own cycle, and the arm's friction is
/// exact at any step. Noise is drawn in counts of the shipped sensor; one of them is `counts` counts of this sensor.
pub(super) fn vary_model(dice: &mut Dice, rig: &config::Rig, scene: &mut config::Scene, counts: f64) {
    let Some(model) = &mut scene.model else { return };
    model.plant_step_us = match rig.rig.command_mode {
        config::CommandMode::Torque => dice.one_of(&[200, 250, 500]),
        // Drives close their loop every 125 us, and the plant stops there in any case.
        _ => rig.simulated().map_or(125, |simulation| simulation.drive_position_loop.period_us),
    };
    model.encoder = if dice.chance(0.7) { config::EncoderModel::Quantised } else { config::EncoderModel::Exact };
    let noise = if dice.chance(0.8) { dice.between(1.0, 6.0) } else { 0.0 };
    model.force_noise_counts = not_negative(noise * counts);
    model.force_sensor =
        if noise > 0.0 { config::ForceSensorModel::Noisy } else { config::ForceSensorModel::Quantised };
    model.joint_elasticity = None;
}
