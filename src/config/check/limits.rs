//! Checks of control law and limits against the command mode and the drives.

use super::Findings;
use super::words::round;
use crate::tree::{CommandMode, ControlGains, Rig};

/// Product of rate gain and period above which an ideal drive overshoots, and the product at which the loop is unstable, with the
/// delay of one cycle.
const RATE_GAIN_BOUNDS: [f64; 2] = [0.25, 1.0];
/// Largest set-point of a torque, per mille of rated (6071h is an `i16`).
const MOST_PER_MILLE: f64 = i16::MAX as f64;
/// Largest following error window, counts: 6065h is a `u32`, and its last value switches the monitoring off.
const MOST_COUNTS: f64 = (u32::MAX - 1) as f64;

/// Checks that the gains fit the command mode.
pub(super) fn check_control(findings: &mut Findings, rig: &Rig) {
    let gains = &rig.control.gains;
    let (found, is_rate) = match gains {
        ControlGains::Joint { .. } => ("joint", false),
        ControlGains::Cartesian { .. } => ("cartesian", false),
        ControlGains::Rate { .. } => ("rate", true),
    };
    let (mode, wanted, fits) = match rig.rig.command_mode {
        CommandMode::Torque => ("torque", "joint` or `cartesian", !is_rate),
        CommandMode::Velocity => ("velocity", "rate", is_rate),
        // The drives close the loop: no gain is used.
        CommandMode::Position => return,
    };
    let key = format!("control.gains.{found}");
    if !fits {
        let message = format!("`control.gains` is `{found}`, and `rig.command_mode` {mode} takes `{wanted}`");
        let help = match is_rate {
            true => "a torque needs stiffness, damping and integral gains; or write `command_mode: velocity`",
            false => "write `rate: {gain_per_s: 60.0}`; or write `command_mode: torque`",
        };
        findings.error(&key, message, help).see("rig.command_mode", "mode");
        return;
    }
    let ControlGains::Rate { gain_per_s } = gains else { return };
    let key = format!("{key}.gain_per_s");
    let product = **gain_per_s * f64::from(rig.cycle.period_us) * 1e-6;
    let message =
        |what: &str| format!("`{key}` is {} 1/s, {} times a control period: {what}", **gain_per_s, round(product));
    let help = "stay below a quarter of a control period, such as 60 1/s at 1 kHz";
    let [overshoots, unstable] = RATE_GAIN_BOUNDS;
    if product >= unstable {
        let message = message("with the delay of one cycle the loop is unstable");
        findings.error(&key, message, help).see("cycle.period_us", "period_us");
    } else if product > overshoots {
        let message = message("with the delay of one cycle even an ideal drive overshoots");
        findings.warning(&key, message, help).see("cycle.period_us", "period_us");
    }
}

/// Checks the limits against the fixture and against each other.
pub(super) fn check_guard(findings: &mut Findings, rig: &Rig) {
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
    let coulomb = rig.control.feed_forward.coulomb_n_m.map(|torque| *torque);
    let largest = coulomb[0].max(coulomb[1]);
    if let Some(limit) = guard.residual_limit_n_m.filter(|limit| **limit <= largest) {
        findings
            .error(
                "guard.residual_limit_n_m",
                format!(
                    "`guard.residual_limit_n_m` is {} N m, not above the friction of {largest} N m in \
                     `control.feed_forward.coulomb_n_m`: friction alone would stop the rig",
                    *limit
                ),
                "raise the limit to twice the friction or more, or write null",
            )
            .see("control.feed_forward.coulomb_n_m", "coulomb_n_m");
    }
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

/// Checks that the drives can represent the limits. One finding covers all drives of one kind.
pub(super) fn check_drive_limits(findings: &mut Findings, rig: &Rig) {
    let [left, right] = &rig.drives;
    if left.rated_torque_n_m == right.rated_torque_n_m {
        check_torque(findings, rig, 0, "each drive");
    } else {
        check_torque(findings, rig, 0, "`drives[0]`");
        check_torque(findings, rig, 1, "`drives[1]`");
    }
    if left.encoder_counts_per_rev == right.encoder_counts_per_rev {
        check_window(findings, rig, 0, "each drive");
    } else {
        check_window(findings, rig, 0, "`drives[0]`");
        check_window(findings, rig, 1, "`drives[1]`");
    }
}

fn check_torque(findings: &mut Findings, rig: &Rig, index: usize, name: &str) {
    let Some(drive) = rig.drives.get(index) else { return };
    let (limit, rated) = (*rig.guard.torque_limit_n_m, *drive.rated_torque_n_m);
    let per_mille = 1000.0 * limit / rated;
    let head = format!("`guard.torque_limit_n_m` is {limit} N m");
    if per_mille > MOST_PER_MILLE {
        let most = MOST_PER_MILLE / 1000.0;
        let message = format!("{head}, more than the largest set-point of {name}: {most} times its rated {rated} N m");
        findings.error(
            "guard.torque_limit_n_m",
            message,
            "check both: drives receive torque in 0.1 % of the rated torque",
        )
    } else if per_mille < 1.0 {
        let message = format!("{head}, less than one per mille of the rated {rated} N m of {name}");
        findings.error(
            "guard.torque_limit_n_m",
            message,
            "check both: drives receive torque in 0.1 % of the rated torque",
        )
    } else if limit > rated {
        let message = format!("{head}, above the rated {rated} N m of {name}");
        let help = "lower it to the rated torque; above it the drive heats up and may limit or trip";
        findings.warning("guard.torque_limit_n_m", message, help)
    } else {
        return;
    }
    .see(&format!("drives[{index}].rated_torque_n_m"), "rated");
}

fn check_window(findings: &mut Findings, rig: &Rig, index: usize, name: &str) {
    let Some(drive) = rig.drives.get(index) else { return };
    let limit = *rig.guard.following_error_limit_rad;
    let counts_per_rad = f64::from(drive.encoder_counts_per_rev) / std::f64::consts::TAU;
    // The drive's own window is twice the guard's.
    let counts = 2.0 * limit * counts_per_rad;
    let (what, help) = if counts > MOST_COUNTS {
        ("more counts than its window holds", "lower the limit; 0.05 rad is about 3 degrees")
    } else if counts < 1.0 {
        ("less than one count", "raise the limit; 0.05 rad is about 3 degrees")
    } else {
        return;
    };
    let key = "guard.following_error_limit_rad";
    let message = format!("`{key}` is {limit} rad, for {name} a window of {} counts: {what}", round(counts));
    findings.error(key, message, help).see(&format!("drives[{index}].encoder_counts_per_rev"), "counts");
}
