//! The permits of a rig.

use super::Runner;
use crate::run::permit::{Bounds, Permit, Scope};
use crate::run::place::Place;

impl Permit {
    /// Without proof, for a reason that [`Permit::unproved`] tells: the drives may go on when their master dies. No command of the
    /// program uses it. Who does has to keep the reason with what is recorded. It is of the present boot of the rig.
    pub fn without_proof<P: Place>(rig: &Runner<P>, why: &str) -> Self {
        Self::of(rig.boot, Scope::Whole(Some(why.to_owned())))
    }

    /// What is proved.
    pub(in crate::run) fn proved<P: Place>(rig: &Runner<P>) -> Self {
        Self::of(rig.boot, Scope::Whole(None))
    }

    /// What is proved, within bounds that the drives were told.
    pub(crate) fn for_bring_up<P: Place>(rig: &Runner<P>, bounds: Bounds) -> Self {
        Self::of(rig.boot, Scope::BringUp(bounds))
    }

    /// In a place of virtual time nothing moves.
    #[cfg(feature = "sim")]
    pub(crate) fn in_virtual_time<P: Place>(rig: &Runner<P>) -> Self {
        const { assert!(P::IS_VIRTUAL, "a computer needs a proof") };
        Self::proved(rig)
    }

    /// For the watchdog drill, which enables before there is any proof.
    pub(crate) fn for_drill<P: Place>(rig: &Runner<P>) -> Self {
        Self::of(rig.boot, Scope::Rest)
    }
}
