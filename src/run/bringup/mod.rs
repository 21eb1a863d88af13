//! Bring-up of a rig on a [`Runner`](crate::Runner) of any place: watchdog drill, commissioning, homing, jog, identification of joints,
//! calibration.
//!
//! Each takes `&mut Runner<dyn Place>`, so that it is compiled once: a cycle costs a call by table more here, and nowhere else.

mod calibration;
pub mod commission;
mod drill;
mod home;
mod jog;
mod keys;
mod lead_watch;
mod push;
mod torque_meter;
mod tune_loop;

pub use calibration::{Helper, Pulled, pulls, visit};
pub use commission::commission;
pub use drill::drill;
pub use home::{HOMING_BEYOND_RAD, HomePlan, Homed, JointHomed, NoShift, NotHome, Repeated, home, home_repeatedly};
pub use jog::{Jog, Jogged, jog};
pub use keys::{Key, Keys};
pub use lead_watch::ToldTorque;
pub use tune_loop::{
    Follows, ForceFound, JointFound, JointLoop, LOOP_BOUND_RAD, LoopPlan, LoopTraced, LoopUnreadable, MeasuredLoop,
    Prove, STEP_RISE_S, StepAnswer, tune_loop,
};
