//! Permit to enable a rig, as a type.

use std::sync::atomic::{AtomicU64, Ordering};

use yieldwall_config::Positive;
use yieldwall_motion::guard::Request;

/// How far the joints of a rig that has to rest may be guided away, rad.
pub const REST_RAD: f64 = 0.02;

/// One boot of one network, unlike every other one of this process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Boot(u64);

impl Boot {
    /// Boot of a network that was never booted.
    pub(super) const NONE: Self = Self(0);

    /// Returns a boot that differs from all earlier ones.
    pub(super) fn another() -> Self {
        static BOOTS: AtomicU64 = AtomicU64::new(1);
        Self(BOOTS.fetch_add(1, Ordering::Relaxed))
    }
}

/// How far and how hard a rig may be moved that is moved for the first time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// How far a joint may be guided from where it was enabled, rad. Beyond it the rig is stopped along its ramp.
    pub motion_rad: Positive,
    /// Most torque of each drive, N m. The rig's own limit counts where it is less.
    pub torque_n_m: Positive,
}

/// Permit to enable a rig. It comes from a proof ([`Runner::prove`](super::Runner::prove)), or from a caller that names the reason
/// why there is none ([`Permit::without_proof`]). Nothing else makes one, as only the guard makes an
/// [`Allowed`](yieldwall_motion::guard::Allowed) command. A permit belongs to one boot of one rig. After another boot the drives
/// may be others, so [`Runner::check_permit`](super::Runner::check_permit) refuses it.
///
/// ```compile_fail
/// use yieldwall_run::Permit;
/// // Private to the module that proves.
/// fn permit<P: yieldwall_run::Place>(rig: &yieldwall_run::Runner<P>) -> Permit {
///     Permit::proved(rig)
/// }
/// ```
/// A request for a cycle cannot ask for enabling without a permit:
/// ```
/// use yieldwall_run::{Ask, Permit, Place, Runner};
/// fn enable<P: Place>(rig: &mut Runner<P>, permit: &Permit) {
///     rig.run_cycle(Ask::Enable(permit));
/// }
/// ```
/// ```compile_fail
/// use yieldwall_run::{Ask, Permit, Place, Runner};
/// fn enable<P: Place>(rig: &mut Runner<P>) {
///     rig.run_cycle(Ask::Enable);
/// }
/// ```
#[derive(Debug, PartialEq)]
pub struct Permit {
    scope: Scope,
    boot: Boot,
}

/// Extent of a permit.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Scope {
    /// All that the rig file allows, and why if that was not proved.
    Whole(Option<String>),
    /// A small motion with little torque; the drives have their lowered torque limit.
    BringUp(Bounds),
    /// To rest at the pose at which the rig was enabled.
    Rest,
}

impl Permit {
    pub(super) fn of(boot: Boot, scope: Scope) -> Self {
        Self { scope, boot }
    }

    pub(super) fn is_of(&self, boot: Boot) -> bool {
        self.boot == boot
    }

    /// Returns why nothing was proved; `None` if it was proved.
    pub fn unproved(&self) -> Option<&str> {
        match &self.scope {
            Scope::Whole(why) => why.as_deref(),
            Scope::BringUp(_) | Scope::Rest => None,
        }
    }

    /// Returns how far a joint may be guided from where the rig was enabled, rad; `None` as far as the rig file allows.
    pub fn motion_bound_rad(&self) -> Option<f64> {
        match &self.scope {
            Scope::Whole(_) => None,
            Scope::BringUp(bounds) => Some(bounds.motion_rad.get()),
            Scope::Rest => Some(REST_RAD),
        }
    }

    /// Returns the largest torque of each drive, N m; `None` as much as the rig file allows.
    pub(super) fn torque_bound_n_m(&self) -> Option<f64> {
        match &self.scope {
            Scope::BringUp(bounds) => Some(bounds.torque_n_m.get()),
            Scope::Whole(_) | Scope::Rest => None,
        }
    }
}

/// Request for a cycle of a rig.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
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
