//! The permits of a rig.

use super::Runner;
use crate::permit::{Bounds, Permit, Scope};
use crate::place::{Place, VirtualPlace};

impl Permit {
    /// Creates a permit without proof, for a reason that [`Permit::unproved`] returns: the drives may go on when their master dies.
    /// No command of the program uses it. A caller must keep the reason with its recordings. The permit belongs to the present boot
    /// of the rig.
    pub fn without_proof<P: Place + ?Sized>(rig: &Runner<P>, why: &str) -> Self {
        Self::of(rig.boot, Scope::Whole(Some(why.to_owned())))
    }

    /// Creates the permit of a proof.
    pub(crate) fn proved<P: Place + ?Sized>(rig: &Runner<P>) -> Self {
        Self::of(rig.boot, Scope::Whole(None))
    }

    /// Creates the permit of a proof, within bounds that the drives have as their limits.
    pub(crate) fn bounded<P: Place + ?Sized>(rig: &Runner<P>, bounds: Bounds) -> Self {
        Self::of(rig.boot, Scope::BringUp(bounds))
    }

    /// Creates the permit for the watchdog drill, which enables before there is any proof.
    pub(crate) fn at_rest<P: Place + ?Sized>(rig: &Runner<P>) -> Self {
        Self::of(rig.boot, Scope::Rest)
    }

    /// Creates the permit of a rig in virtual time, in which no real drive moves.
    pub fn in_virtual_time<P: VirtualPlace>(rig: &Runner<P>) -> Self {
        Self::proved(rig)
    }

    /// Creates the permit of a watchdog drill in virtual time: no motion at all.
    pub fn for_drill<P: VirtualPlace>(rig: &Runner<P>) -> Self {
        Self::at_rest(rig)
    }
}
