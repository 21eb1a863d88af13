//! The force sensor.

use super::super::Ending::GoesOn;
use super::super::Lasts::For;
use super::super::Recovery::{None as Nothing, Reset};
use super::super::Target::Sensor;
use super::super::{CatalogueRow, Kind};
use super::{STOPPED, on_any, row, sized};
use yieldwall_motion::guard::Fault as F;
use yieldwall_motion::guard::Reaction::{Count, Freeze, StopRamp};

pub(super) const ROWS: [CatalogueRow; 8] = [
    on_any(row(
        (Kind::SensorStuck, "sensor-stuck"),
        &[1],
        &[Sensor],
        For(0.3),
        "the force sensor repeats its last counts on all channels, while its counter runs",
        &[F::SensorStuck, F::ForceImplausible],
        (StopRamp, STOPPED, Reset),
    )),
    on_any(row(
        (Kind::SensorInvalid, "sensor-invalid"),
        &[2],
        &[Sensor],
        For(0.1),
        "the force sensor marks its samples as invalid",
        &[F::SensorInvalid],
        (StopRamp, STOPPED, Reset),
    )),
    on_any(row(
        (Kind::SensorSaturated, "sensor-saturated"),
        &[3],
        &[Sensor],
        For(0.1),
        "the first two channels of the force sensor saturate",
        &[F::SensorSaturated, F::ForceLimit, F::ForceStep],
        (StopRamp, STOPPED, Reset),
    )),
    on_any(row(
        (Kind::SensorStale, "sensor-stale"),
        &[4],
        &[Sensor],
        For(0.1),
        "the force sensor repeats its last sample, with the same counter",
        &[F::SensorStale, F::SensorLost],
        (StopRamp, STOPPED, Reset),
    )),
    row(
        (Kind::SensorSilent, "sensor-silent"),
        &[5, 11],
        &[Sensor],
        For(0.1),
        "the force sensor's process data do not arrive; its heartbeat does",
        &[F::SensorStale, F::SensorLost],
        (StopRamp, STOPPED, Reset),
    ),
    on_any(sized(
        row(
            (Kind::SensorJump, "sensor-jump"),
            &[6],
            &[Sensor],
            For(0.002),
            "the force sensor's zero jumps, and returns at the end",
            &[F::ForceStep],
            (Freeze, GoesOn, Nothing),
        ),
        "a force in N",
        100.0,
        (-200.0, 200.0),
    )),
    on_any(sized(
        row(
            (Kind::SensorDrift, "sensor-drift"),
            &[7],
            &[Sensor],
            For(6.0),
            "the force sensor's zero drifts steadily",
            &[F::ForceImplausible, F::OverSpeed, F::ForceLimit, F::FollowingError],
            (StopRamp, STOPPED, Reset),
        ),
        "a drift in N/s",
        40.0,
        (-1000.0, 1000.0),
    )),
    on_any(sized(
        row(
            (Kind::SensorClockDrift, "sensor-clock-drift"),
            &[4],
            &[Sensor],
            For(2.0),
            "the force sensor's clock runs at another rate",
            &[],
            (Count, GoesOn, Nothing),
        ),
        "a share of its rate",
        0.9,
        (0.01, 1.0),
    )),
];
