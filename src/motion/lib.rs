//! From a sensed force to the command of two joints, without I/O: time, randomness and input are arguments.
//!
//! ```text
//! RawSample -> sensing -> Force -> fixture -> proxy -> linkage -> JointAngles -> control -> JointCommand -> guard -> Allowed<JointCommand>
//! ```
//! Only [`cycle::Cycle::step`] names all stages. Only [`guard`] makes an [`Allowed`](guard::Allowed), and only an `Allowed` leaves. The
//! code of a cycle allocates nothing, and never blocks or panics.
//!
//! SI units in `f64`, base frame.

pub mod control;
pub mod cycle;
pub mod elementary;
pub mod fixture;
pub mod guard;
pub mod identification;
pub mod linkage;
pub mod quantity;
pub mod sensing;
pub mod setvalued;

#[cfg(test)]
#[path = "../sample.rs"]
mod sample;
