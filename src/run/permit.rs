//! What it takes to enable a rig, as a type.

use super::place::Place;
use crate::guard::Request;

/// That a rig may be enabled. A proof makes one ([`Runner::prove`](super::Runner::prove)), or somebody who says by name why there is none
/// ([`Permit::without_proof`]); nothing else does, as only the guard makes an [`Allowed`](crate::guard::Allowed) command.
///
/// ```compile_fail
/// use yieldwall::run::Permit;
/// // Private to the module that proves.
/// let permit = Permit::proved();
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
pub struct Permit(Scope);

#[derive(Clone, Debug, PartialEq, Eq)]
enum Scope {
    /// All that the rig file allows, and why if that was not proved.
    Whole(Option<String>),
    /// To rest at the pose at which the rig was enabled.
    Rest,
}

impl Permit {
    /// Without proof, for a reason that [`Permit::unproved`] tells: the drives may go on when their master dies. No command of the
    /// program uses it. Who does has to keep the reason with what is recorded.
    pub fn without_proof(why: &str) -> Self {
        Self(Scope::Whole(Some(why.to_owned())))
    }

    /// What is proved.
    pub(super) fn proved() -> Self {
        Self(Scope::Whole(None))
    }

    /// In a place of virtual time nothing moves.
    pub(crate) fn in_virtual_time<P: Place>() -> Self {
        const { assert!(P::IS_VIRTUAL, "a computer needs a proof") };
        Self::proved()
    }

    /// For the watchdog drill, which enables before there is any proof.
    pub(crate) fn for_drill() -> Self {
        Self(Scope::Rest)
    }

    /// Why nothing was proved; `None` if it was.
    pub fn unproved(&self) -> Option<&str> {
        match &self.0 {
            Scope::Whole(why) => why.as_deref(),
            Scope::Rest => None,
        }
    }

    /// Whether the rig has to rest.
    pub fn is_for_rest(&self) -> bool {
        self.0 == Scope::Rest
    }
}

/// What is asked of a rig with a cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ask<'a> {
    /// Nothing.
    #[default]
    Nothing,
    /// To enable it, if it idles.
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
