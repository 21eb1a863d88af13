//! What it takes to enable a rig, as a type.

use std::sync::atomic::{AtomicU64, Ordering};

use super::place::Place;
use super::runner::Runner;
use crate::guard::Request;

/// One boot of one network, unlike every other one of this process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Boot(u64);

impl Boot {
    /// Of a network that was never booted.
    pub(super) const NONE: Self = Self(0);

    /// One that has not been before.
    pub(super) fn another() -> Self {
        static BOOTS: AtomicU64 = AtomicU64::new(1);
        Self(BOOTS.fetch_add(1, Ordering::Relaxed))
    }
}

/// That a rig may be enabled. A proof makes one ([`Runner::prove`](super::Runner::prove)), or somebody who says by name why there is none
/// ([`Permit::without_proof`]); nothing else does, as only the guard makes an [`Allowed`](crate::guard::Allowed) command. It is of one
/// boot of one rig: drives that were booted anew may be others, and [`Runner::check_permit`] refuses it.
///
/// ```compile_fail
/// use yieldwall::run::Permit;
/// // Private to the module that proves.
/// fn permit<P: yieldwall::run::Place>(rig: &yieldwall::run::Runner<P>) -> Permit {
///     Permit::proved(rig)
/// }
/// ```
/// What is asked of a rig with a cycle has no word for enabling it without one:
/// ```
/// use yieldwall::run::{Ask, Permit, Place, Runner};
/// fn enable<P: Place>(rig: &mut Runner<P>, permit: &Permit) {
///     rig.run_cycle(Ask::Enable(permit));
/// }
/// ```
/// ```compile_fail
/// use yieldwall::run::{Ask, Permit, Place, Runner};
/// fn enable<P: Place>(rig: &mut Runner<P>) {
///     rig.run_cycle(Ask::Enable);
/// }
/// ```
#[derive(Debug, PartialEq, Eq)]
pub struct Permit {
    scope: Scope,
    boot: Boot,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Scope {
    /// All that the rig file allows, and why if that was not proved.
    Whole(Option<String>),
    /// To rest at the pose at which the rig was enabled.
    Rest,
}

impl Permit {
    /// Without proof, for a reason that [`Permit::unproved`] tells: the drives may go on when their master dies. No command of the
    /// program uses it. Who does has to keep the reason with what is recorded. It is of the present boot of the rig.
    pub fn without_proof<P: Place>(rig: &Runner<P>, why: &str) -> Self {
        Self::of(rig, Scope::Whole(Some(why.to_owned())))
    }

    /// What is proved.
    pub(super) fn proved<P: Place>(rig: &Runner<P>) -> Self {
        Self::of(rig, Scope::Whole(None))
    }

    /// In a place of virtual time nothing moves.
    pub(crate) fn in_virtual_time<P: Place>(rig: &Runner<P>) -> Self {
        const { assert!(P::IS_VIRTUAL, "a computer needs a proof") };
        Self::proved(rig)
    }

    /// For the watchdog drill, which enables before there is any proof.
    pub(crate) fn for_drill<P: Place>(rig: &Runner<P>) -> Self {
        Self::of(rig, Scope::Rest)
    }

    fn of<P: Place>(rig: &Runner<P>, scope: Scope) -> Self {
        Self { scope, boot: rig.boot }
    }

    pub(super) fn is_of(&self, boot: Boot) -> bool {
        self.boot == boot
    }

    /// Why nothing was proved; `None` if it was.
    pub fn unproved(&self) -> Option<&str> {
        match &self.scope {
            Scope::Whole(why) => why.as_deref(),
            Scope::Rest => None,
        }
    }

    /// Whether the rig has to rest.
    pub fn is_for_rest(&self) -> bool {
        self.scope == Scope::Rest
    }
}

/// What is asked of a rig with a cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ask<'a> {
    /// Nothing.
    #[default]
    Nothing,
    /// To enable it, if it idles and the permit is of its present boot; else nothing.
    Enable(&'a Permit),
    /// To stop it along its ramp.
    Stop,
    /// To forget what stopped it; nothing is enabled.
    Reset,
}

impl Ask<'_> {
    pub(super) fn request(self) -> Request {
        match self {
            Ask::Nothing => Request::None,
            Ask::Enable(_) => Request::Enable,
            Ask::Stop => Request::Stop,
            Ask::Reset => Request::Reset,
        }
    }
}
