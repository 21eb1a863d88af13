//! The permits of a rig.

use super::Runner;
use crate::permit::{Bounds, Permit, Scope};
use crate::place::{Place, VirtualPlace};

impl Permit {
    /// Without proof, for a reason that [`Permit::unproved`] tells: the drives may go on when their master dies. No command of the
    /// program uses it. Who does has to keep the reason with what is recorded. It is of the present boot of the rig.
    pub fn without_proof<P: Place + ?Sized>(rig: &Runner<P>, why: &str) -> Self {
        Self::of(rig.boot, Scope::Whole(Some(why.to_owned())))
    }

    /// What is proved.
    pub(crate) fn proved<P: Place + ?Sized>(rig: &Runner<P>) -> Self {
        Self::of(rig.boot, Scope::Whole(None))
    }

    /// What is proved, within bounds that the drives were told.
    pub(crate) fn bounded<P: Place + ?Sized>(rig: &Runner<P>, bounds: Bounds) -> Self {
        Self::of(rig.boot, Scope::BringUp(bounds))
    }

    /// For the watchdog drill, which enables before there is any proof.
    pub(crate) fn at_rest<P: Place + ?Sized>(rig: &Runner<P>) -> Self {
        Self::of(rig.boot, Scope::Rest)
    }

    /// The permit of a rig in virtual time, in which no real drive moves.
    pub fn in_virtual_time<P: VirtualPlace>(rig: &Runner<P>) -> Self {
        Self::proved(rig)
    }

    /// The permit of a watchdog drill in virtual time: no motion at all.
    pub fn for_drill<P: VirtualPlace>(rig: &Runner<P>) -> Self {
        Self::at_rest(rig)
    }
}
