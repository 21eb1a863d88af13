//! What it takes to enable a rig, as a type.

use crate::guard::Request;

/// That a rig may be enabled. Only a proof makes one, as only the guard makes an [`Allowed`](crate::guard::Allowed) command.
///
/// ```compile_fail
/// use yieldwall::run::Permit;
/// // Nobody else can make one.
/// let permit = Permit(None);
/// ```
/// ```compile_fail
/// # use yieldwall::run::{OnLink, Runner, Metronome};
/// # use yieldwall::link::CanLink;
/// fn enable<L: CanLink, M: Metronome>(rig: &mut Runner<OnLink<L, M>>) {
///     // What is asked of a rig with every cycle has no word for enabling but with a permit.
///     rig.run_cycle(yieldwall::guard::Request::Enable);
/// }
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Permit(Scope);

#[derive(Clone, Debug, PartialEq, Eq)]
enum Scope {
    /// All that the rig file allows, and why if that was not proved.
    Whole(Option<String>),
    /// To rest at the pose at which the rig was enabled.
    Rest,
}

impl Permit {
    /// Without proof, for a reason that is told by [`Permit::unproved`] and that a recording has to hold: the drives may go on
    /// when their master dies.
    pub fn without_proof(why: &str) -> Self {
        Self(Scope::Whole(Some(why.to_owned())))
    }

    /// What is proved.
    pub(super) fn proved() -> Self {
        Self(Scope::Whole(None))
    }

    /// What nothing real needs a proof for: simulated time, or simulated devices.
    pub(crate) fn simulated() -> Self {
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
