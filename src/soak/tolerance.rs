//! Tolerances: by how much an observed value may exceed an invariant's limit, and why. There are no other tolerances.

/// Share by which a float may pass a limit that was computed from the same numbers in another order.
pub(super) const ROUNDING: f64 = 1e-9;

/// bounded-motion: a target on the bus is a whole count, so that a step of two rounded targets is off by one at most.
pub(super) const TARGET_COUNTS: f64 = 1.0;

/// bounded-motion: largest permitted deceleration of a ramp, as a share of the configured one. In the middle of the ramp the
/// deceleration is exactly `1.5 v / t`. Differences over one cycle stay below that peak, except if the ramp ends between two grid
/// points. In that cycle two half steps fall together, so twice is allowed.
pub(super) const RAMP_SHARE: f64 = 2.0;

/// bounded-motion: before both drives are enabled a position target moves nothing. It equals the reported position of the joint, or
/// the position predicted from its last rate. An arm that nobody holds turns as fast as a hand pushes it. Up to this multiple of
/// the greatest rate the guard takes a change for motion. Above it the guard takes it for a jump of the encoder, and the rig is not
/// enabled.
pub(super) const TURNING_SHARE: f64 = 2.0;

/// bounded-effort: torques on the bus are whole per mille of the rated torque, rounded.
pub(super) const TORQUE_PER_MILLE: f64 = 1.0;

/// passivity: permitted error of the guard as a share of the energy limit at which it holds the rig. The guard multiplies a force
/// and a motion that are a cycle apart. For a hand that trembles at 25 Hz, the fastest here, and 4 ms that is 1 - cos(2 pi 25
/// 0.004).
pub(super) const GUARD_SHARE: f64 = 0.2;

/// passivity: time in s over which the balance is forgotten, as the guard does: steps of sensor and encoder would add up for ever.
pub(super) const FORGETTING_S: f64 = 1.0;

/// passivity: mass in kg with which the tool holds kinetic energy: that of the proxy or that of the arm, whichever is more. The
/// arm of the shipped rigs weighs 2.6 to 7.4 kg at the tool along their circle, motors included.
pub(super) const ARM_KG: f64 = 8.0;

/// yield-levels: force in N, beyond rounding, by which a fixture on a curved surface may pass its levels in the tangent step.
pub(super) const LEVEL_N: f64 = 1e-6;

/// yield-levels: share of `hypot(F, R)` by which a fixture on a curved surface may pass its levels while it lies there: the
/// tangent step is projected onto the curve, as printed.
pub(super) const CURVED_SHARE: f64 = 0.25;

/// yield-levels: a proxy nearer to the surface than this, in m, lies on it: far above rounding, far below any encoder.
pub(super) const LANDED_M: f64 = 1e-9;

/// comes-to-rest: a proxy that moves less in a cycle, in m, rests: below one unit in the last place of a coordinate.
pub(super) const RESTING_STEP_M: f64 = 1e-15;

/// comes-to-rest: additional cycles beyond the time in which friction stops the proxy. The difference that gives the proxy's speed
/// is a cycle old, and the step in which it stops is not a whole one.
pub(super) const RESTING_CYCLES: u32 = 3;

/// starts-in-place: the first position target may differ by the rounding of one count.
pub(super) const FIRST_TARGET_COUNTS: i64 = 1;

/// wrapping-counters: the truth is taken at the computation, the measurement at SYNC. They differ by the joint's turn in between
/// and by the counts of the encoder. The turn is at most twice the joint's greatest rate times one period, since the guard takes a
/// faster encoder for one that has jumped. An arm that nobody holds may turn faster under a hand of 200 N. Then they differ at most
/// by the joint's true turn from one computation to the next, since SYNC lies between the two.
pub(super) const MEASURED_COUNTS: f64 = 2.0;

/// asked-for: cycles with set-points from a request for a reset to the reset edge: one low word, then the edge.
pub(super) const RESET_CYCLES: u32 = 2;

/// bus-load: share of the cycle that the rig's own frames may take, their real stuff bits counted: all of it. Process data and
/// heartbeats of all nodes in one cycle take 93 % at 1 ms. Emergencies are left out, as in the verdict of the bus budget: those of both
/// drives take another 25 % of a cycle, in which the rig has stopped.
pub(super) const BUS_SHARE: f64 = 1.0;

/// bounded-queues: frames that may wait in one port. The master's port holds two set-points, a heartbeat and SYNC; a node's port
/// holds its answers to SYNC plus a heartbeat and an emergency. The number is doubled, since another SYNC may come in the same
/// cycle.
pub(super) const QUEUED_FRAMES: usize = 8;

/// bounded-queues: SYNCs in a cycle beyond which the bus carries no more of what they ask for: queues grow as long as they come.
pub(super) const SYNCS: usize = 2;

/// Watchdog: cycles from the last set-point to the drives' own reaction. The deadline of the RPDO is five cycles, and the drive
/// notices it with the next tick of its own clock.
pub(super) const WATCHDOG_CYCLES: u32 = 7;

/// Watchdog: time in s that the drives' quick stop may take: from the greatest rate of a joint (6 rad/s) at the slowest
/// deceleration that the profiles leave as delivered.
pub(super) const QUICK_STOP_S: f64 = 0.5;

/// Distance in m of the tool from the task's origin above which an arm is far outside of the rig's promised workspace
/// (0.16 m). A hand has pushed it there while nobody held it.
pub(super) const FAR_M: f64 = 0.24;

/// Speed in m/s above which a hand has carried the arm, if the drives take it over outside of the rig's promised workspace. The arm
/// is then still on its way outward: at 1.2 m/s 60 N m take 15 mm to stop it. For as long as a quick stop may take
/// ([`QUICK_STOP_S`]), motion at the edge is due to the hand, not to the reference.
pub(super) const CARRIED_M_PER_S: f64 = 0.05;

/// False alarm: cycles for which a time at the torque limit still shows in `force-implausible`. The guard's mean over so many
/// cycles takes the reference's motion for the arm's, and the arm is behind then.
pub(super) const BALANCE_CYCLES: u32 = 20;

/// False alarm: reactions to a hand alone below which their rate over a run is none. A run of 10 000 cycles in which the hand is
/// held all the time has 50.
pub(super) const LEAST_REACTIONS: usize = 10;

/// reaction: jump of an encoder above which it cannot be motion, in cycles at the joint's greatest rate. The guard takes two
/// cycles' worth for a jump, and the joint may turn by one the other way.
pub(super) const JUMP_CYCLES: f64 = 3.0;
