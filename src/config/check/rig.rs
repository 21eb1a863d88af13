//! Relations between the keys of a rig.

use yieldwall_drives::cia402::OperationMode;
use yieldwall_drives::profiles::{self, Role};

use super::Findings;
use super::fixture::{Host, check_fixture};
use super::reach::check_linkage;
use super::words::round;
use crate::config::number::Finite;
use crate::config::suggest::nearest;
use crate::config::tree::{CommandMode, Rig};

/// Bit rates of CiA 301, bit/s.
const BIT_RATES: [u32; 8] = [10_000, 20_000, 50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000];
/// Least squared sine of the angle between the rows Fx and Fy of a calibration; below it they say the same.
const LEAST_ROW_ANGLE: f64 = 1e-12;

/// All rules of a rig. `in_range` says that every single number is in its range, so that derived ones make sense.
pub(in crate::config) fn check_rig(findings: &mut Findings, rig: &Rig, in_range: bool) {
    check_cycle(findings, rig);
    check_nodes(findings, rig);
    check_profiles(findings, rig);
    check_sensor(findings, rig);
    check_guard(findings, rig);
    let period_s = if in_range { f64::from(rig.cycle.period_us) * 1e-6 } else { 0.0 };
    check_fixture(findings, "fixture", &rig.fixture, Host::Rig, period_s);
    if in_range {
        check_linkage(findings, rig);
    }
}

fn check_cycle(findings: &mut Findings, rig: &Rig) {
    let (period, compute) = (rig.cycle.period_us, rig.cycle.compute_at_us);
    if compute >= period {
        findings
            .error(
                "cycle.compute_at_us",
                format!(
                    "`cycle.compute_at_us` is {compute} us, not below `cycle.period_us` of {period} us: the control step \
                     would run after the next SYNC"
                ),
                "leave time for the TPDOs before it and for the RPDOs after it; 700 of 1000 us fits two drives at 1 Mbit/s",
            )
            .see("cycle.period_us", "period_us");
    }
    let inner = rig.plant.drive_position_loop.period_us;
    if inner == 0 || !period.is_multiple_of(inner) {
        findings
            .error(
                "plant.drive_position_loop.period_us",
                format!(
                    "`plant.drive_position_loop.period_us` is {inner} us, and `cycle.period_us` of {period} us is not a \
                     whole multiple of it"
                ),
                "drives close their position loop a whole number of times a cycle, such as every 125 of 1000 us",
            )
            .see("cycle.period_us", "period_us");
    }
}

fn check_nodes(findings: &mut Findings, rig: &Rig) {
    for (name, bus) in &rig.buses {
        if !BIT_RATES.contains(&bus.bit_rate_bit_per_s) {
            let key = format!("buses.{name}.bit_rate_bit_per_s");
            let message = format!("`{key}` is {}, which is no bit rate of CiA 301", bus.bit_rate_bit_per_s);
            findings.error(
                &key,
                message,
                format!("write one of {}", BIT_RATES.map(|rate| rate.to_string()).join(", ")),
            );
        }
    }
    let names: Vec<&str> = rig.buses.keys().map(String::as_str).collect();
    let mut taken: Vec<(&str, u8, String)> = Vec::new();
    let devices = [
        ("drives[0]", &rig.drives[0].bus, rig.drives[0].node_id),
        ("drives[1]", &rig.drives[1].bus, rig.drives[1].node_id),
        ("sensor", &rig.sensor.bus, rig.sensor.node_id),
    ];
    for (device, bus, node_id) in devices {
        let key = format!("{device}.bus");
        if !names.contains(&bus.as_str()) {
            let help = match nearest(bus, names.iter().copied()) {
                Some(meant) => format!("did you mean `{meant}`?"),
                None => format!("the buses of this rig are {}", names.join(", ")),
            };
            findings.error(&key, format!("`{key}` is `{bus}`, which is not among `buses`"), help).see("buses", "buses");
        }
        let key = format!("{device}.node_id");
        let other = taken.iter().find(|(on, id, _)| on == bus && *id == node_id).map(|(_, _, other)| other.clone());
        let other = other.or_else(|| (node_id == rig.master.node_id).then(|| "master.node_id".to_owned()));
        if let Some(other) = other {
            findings
                .error(
                    &key,
                    format!("`{key}` is {node_id}, and so is `{other}` on the same bus"),
                    "give each node of a bus its own node-ID from 1 to 127, here and in the device",
                )
                .see(&other, "the other");
        }
        taken.push((bus, node_id, key));
    }
    if rig.drives[0].name == rig.drives[1].name {
        let message = format!("`drives[1].name` is `{}`, and so is `drives[0].name`", rig.drives[1].name);
        findings
            .error("drives[1].name", message, "give each drive a name of its own")
            .see("drives[0].name", "the other");
    }
    for (index, drive) in rig.drives.iter().enumerate() {
        if !matches!(drive.direction, 1 | -1) {
            let key = format!("drives[{index}].direction");
            let message = format!("`{key}` is {}, and a direction is 1 or -1", drive.direction);
            findings.error(&key, message, "write 1 when counts grow with a positive angle, else -1");
        }
    }
}

fn check_profiles(findings: &mut Findings, rig: &Rig) {
    let (mode, cia402) = match rig.rig.command_mode {
        CommandMode::Torque => ("torque", OperationMode::CyclicTorque),
        CommandMode::Velocity => ("velocity", OperationMode::CyclicVelocity),
        CommandMode::Position => ("position", OperationMode::CyclicPosition),
    };
    for (index, drive) in rig.drives.iter().enumerate() {
        let key = format!("drives[{index}].profile");
        match profiles::find(&drive.profile).map(|profile| (profile, profile.role)) {
            Some((profile, Role::Servo { modes, .. })) if profile.pdos(Some(cia402)).is_none() => {
                let known: Vec<String> = modes.iter().map(|map| format!("{:?}", map.mode)).collect();
                findings
                    .error(
                        "rig.command_mode",
                        format!(
                            "`rig.command_mode` is {mode}, which the profile `{}` of `drives[{index}]` does not have",
                            drive.profile
                        ),
                        format!("the profile has {}", known.join(", ")),
                    )
                    .see(&key, "profile");
            }
            Some((_, Role::Servo { .. })) => {}
            Some(_) => refuse_profile(findings, &key, &drive.profile, "is not one of a drive", is_servo),
            None => refuse_profile(findings, &key, &drive.profile, "is not known", is_servo),
        }
    }
    let sensor = &rig.sensor;
    match profiles::find(&sensor.profile).map(|profile| profile.role) {
        Some(Role::ForceSensor { sample_rates_hz, .. }) => {
            if !sample_rates_hz.iter().any(|rate| f64::from(*rate) == *sensor.sample_rate_hz) {
                let known: Vec<String> = sample_rates_hz.iter().map(u32::to_string).collect();
                let rate = *sensor.sample_rate_hz;
                findings
                    .error(
                        "sensor.sample_rate_hz",
                        format!(
                            "`sensor.sample_rate_hz` is {rate}, which the profile `{}` does not have",
                            sensor.profile
                        ),
                        format!("write one of {}", known.join(", ")),
                    )
                    .see("sensor.profile", "profile");
            }
        }
        Some(_) => {
            refuse_profile(findings, "sensor.profile", &sensor.profile, "is not one of a force sensor", is_sensor)
        }
        None => refuse_profile(findings, "sensor.profile", &sensor.profile, "is not known", is_sensor),
    }
}

fn is_servo(role: &Role) -> bool {
    matches!(role, Role::Servo { .. })
}

fn is_sensor(role: &Role) -> bool {
    matches!(role, Role::ForceSensor { .. })
}

fn refuse_profile(findings: &mut Findings, key: &str, name: &str, why: &str, fits: fn(&Role) -> bool) {
    let known: Vec<&str> =
        profiles::ALL.iter().filter(|profile| fits(&profile.role)).map(|profile| profile.name).collect();
    let help = match nearest(name, known.iter().copied()) {
        Some(meant) => format!("did you mean `{meant}`?"),
        None => format!("the profiles that fit are {}", known.join(", ")),
    };
    findings.error(key, format!("`{key}` is `{name}`, which {why}"), help);
}

fn check_sensor(findings: &mut Findings, rig: &Rig) {
    let sensor = &rig.sensor;
    let cycle_hz = 1e6 / f64::from(rig.cycle.period_us);
    if let Some(corner) = sensor.low_pass_hz
        && *corner >= cycle_hz / 2.0
    {
        findings
            .error(
                "sensor.low_pass_hz",
                format!(
                    "`sensor.low_pass_hz` is {} Hz, not below half of the {} Hz of `cycle.period_us`",
                    *corner,
                    round(cycle_hz)
                ),
                "lower it, or write null for no filter",
            )
            .see("cycle.period_us", "period_us");
    }
    if *sensor.sample_rate_hz > 0.0 && *sensor.sample_rate_hz < cycle_hz * 0.999 {
        findings
            .warning(
                "sensor.sample_rate_hz",
                format!(
                    "`sensor.sample_rate_hz` is {} Hz, below the {} Hz of the cycle: some cycles see an old force",
                    *sensor.sample_rate_hz,
                    round(cycle_hz)
                ),
                "raise it if the sensor can; stability suffers from the delay",
            )
            .see("cycle.period_us", "period_us");
    }
    let [fx, fy] = [&sensor.calibration[0], &sensor.calibration[1]];
    let dot = |a: &[Finite; 6], b: &[Finite; 6]| a.iter().zip(b).map(|(a, b)| **a * **b).sum::<f64>();
    let (xx, yy, xy) = (dot(fx, fx), dot(fy, fy), dot(fx, fy));
    let determinant = xx * yy - xy * xy;
    // Entries so large that the product overflows are no calibration either.
    if determinant.is_nan() || determinant <= LEAST_ROW_ANGLE * xx * yy {
        findings.error(
            "sensor.calibration",
            "the rows Fx and Fy of `sensor.calibration` do not tell two directions of force apart",
            "copy the matrix from the sensor's calibration sheet: row by row, N and N m per count",
        );
        return;
    }
    check_force_range(findings, rig);
}

/// Whether the sensor can measure the forces that matter.
fn check_force_range(findings: &mut Findings, rig: &Rig) {
    let sensor = &rig.sensor;
    let largest = |row: &[Finite; 6]| row.iter().map(|gain| gain.abs()).sum::<f64>() * f64::from(sensor.range_counts);
    let [x, y] = [largest(&sensor.calibration[0]), largest(&sensor.calibration[1])];
    let (axis, largest) = if x < y { ("Fx", x) } else { ("Fy", y) };
    let (yield_n, limit) = (*rig.fixture.yield_n, *rig.guard.force_limit_n);
    if largest < yield_n {
        findings
            .error(
                "sensor.range_counts",
                format!(
                    "the sensor saturates at {} N in {axis}, below `fixture.yield_n` of {yield_n} N: the surface could \
                     never yield",
                    round(largest)
                ),
                "check `calibration` and `range_counts`, or lower `yield_n`",
            )
            .see("fixture.yield_n", "yield_n");
    } else if largest < limit {
        findings
            .warning(
                "guard.force_limit_n",
                format!(
                    "`guard.force_limit_n` is {limit} N, and the sensor saturates at {} N in {axis}: the limit is never \
                     seen",
                    round(largest)
                ),
                "lower the limit below what the sensor can measure",
            )
            .see("sensor.range_counts", "range_counts");
    }
}

fn check_guard(findings: &mut Findings, rig: &Rig) {
    let guard = &rig.guard;
    if *guard.force_limit_n <= *rig.fixture.yield_n {
        findings
            .error(
                "guard.force_limit_n",
                format!(
                    "`guard.force_limit_n` is {} N, not above `fixture.yield_n` of {} N: the rig would stop before the \
                     surface yields",
                    *guard.force_limit_n, *rig.fixture.yield_n
                ),
                "raise the limit or lower `yield_n`",
            )
            .see("fixture.yield_n", "yield_n");
    }
    for (index, drive) in rig.drives.iter().enumerate() {
        if *guard.torque_limit_n_m > *drive.rated_torque_n_m {
            findings
                .warning(
                    "guard.torque_limit_n_m",
                    format!(
                        "`guard.torque_limit_n_m` is {} N m, above the rated {} N m of `drives[{index}]`",
                        *guard.torque_limit_n_m, *drive.rated_torque_n_m
                    ),
                    "lower it to the rated torque; above it the drive heats up and may limit or trip",
                )
                .see(&format!("drives[{index}].rated_torque_n_m"), "rated");
        }
    }
    let coulomb = rig.control.feed_forward.coulomb_n_m.map(|torque| *torque);
    let largest = coulomb[0].max(coulomb[1]);
    if largest >= *guard.torque_limit_n_m {
        findings
            .error(
                "control.feed_forward.coulomb_n_m",
                format!(
                    "`control.feed_forward.coulomb_n_m` is {largest} N m, not below `guard.torque_limit_n_m` of {} N m: \
                     friction alone takes all the torque",
                    *guard.torque_limit_n_m
                ),
                "raise the limit, or check the friction",
            )
            .see("guard.torque_limit_n_m", "torque_limit_n_m");
    }
}
