//! Kinds of fixture: the plastic law, springs with and without a limit, viscous fields, none.

use super::super::drawn::{not_negative, positive};
use yieldwall_config::FixtureLaw;

/// Yield forces of the admittance rig, in N.
pub(super) const YIELDS_N: [f64; 4] = [5.0, 10.0, 20.0, 40.0];
/// Stiffnesses of springs, in N/m.
pub(super) const SPRINGS_N_PER_M: [f64; 4] = [1e3, 1e4, 1e5, 1e6];
/// Speeds in m/s at which a push of R drives the tool across a viscous field: the field is R over this. R sizes the field and does not limit its
/// force.
pub(super) const DRIFTS_M_PER_S: [f64; 3] = [0.01, 0.001, 0.0001];
/// Damping of a viscous field along the way, in N s/m.
const ALONG_N_S_PER_M: f64 = 10.0;
/// Virtual mass of the rig in kg. The damping of a spring is half the critical one of this mass, `sqrt(K M)`.
const MASS_KG: f64 = 2.0;

/// A law.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Law {
    None,
    Plastic,
    /// A spring whose force is cut to R.
    Saturated,
    /// A spring without limit.
    Spring,
    Viscous,
}

impl Law {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Plastic => "plastic",
            Self::Saturated => "saturated",
            Self::Spring => "spring",
            Self::Viscous => "viscous",
        }
    }
}

/// A law and its numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Aid {
    pub(crate) law: Law,
    /// Stiffness of a spring in N/m, damping across a viscous field in N s/m.
    pub(crate) hardness: Option<f64>,
    /// R in N, of a plastic fixture or a saturated spring; of a viscous field the push by which it is sized.
    pub(crate) yield_n: Option<f64>,
}

impl Aid {
    pub(crate) const NONE: Self = Self { law: Law::None, hardness: None, yield_n: None };

    pub(crate) const fn plastic(yield_n: f64) -> Self {
        Self { law: Law::Plastic, hardness: None, yield_n: Some(yield_n) }
    }

    pub(crate) fn saturated(stiffness_n_per_m: f64, yield_n: f64) -> Self {
        Self { law: Law::Saturated, hardness: Some(stiffness_n_per_m), yield_n: Some(yield_n) }
    }

    pub(crate) fn viscous(drift_m_per_s: f64, yield_n: f64) -> Self {
        Self { law: Law::Viscous, hardness: Some(yield_n / drift_m_per_s), yield_n: Some(yield_n) }
    }

    /// Returns the aids that are compared at one R.
    pub(super) fn at(yield_n: f64) -> Vec<Self> {
        let springs = SPRINGS_N_PER_M.map(|stiffness| Self::saturated(stiffness, yield_n));
        let fields = DRIFTS_M_PER_S.map(|drift| Self::viscous(drift, yield_n));
        [Self::plastic(yield_n)].into_iter().chain(springs).chain(fields).collect()
    }

    /// All of them: none, those at each R, and springs without limit.
    pub(super) fn all() -> Vec<Self> {
        let springs =
            SPRINGS_N_PER_M.map(|stiffness| Self { law: Law::Spring, hardness: Some(stiffness), yield_n: None });
        [Self::NONE].into_iter().chain(YIELDS_N.into_iter().flat_map(Self::at)).chain(springs).collect()
    }

    /// In words, without R.
    pub(crate) fn name(&self) -> String {
        let hardness = self.hardness.unwrap_or(f64::NAN);
        let n_per_mm = hardness / 1000.0;
        match self.law {
            Law::None | Law::Plastic => self.law.name().to_owned(),
            Law::Saturated => format!("saturated spring of {n_per_mm} N/mm"),
            Law::Spring => format!("spring of {n_per_mm} N/mm"),
            Law::Viscous => {
                let drift_um_per_s = 1e6 * self.yield_n.unwrap_or(f64::NAN) / hardness;
                format!("viscous, R at {} mm/s", drift_um_per_s.round() / 1e3)
            }
        }
    }

    /// As a rig's file has it.
    pub(crate) fn config(&self) -> Option<FixtureLaw> {
        let hardness = self.hardness.unwrap_or_default();
        let elastic = |is_saturated| FixtureLaw::Elastic {
            stiffness_n_per_m: positive(hardness),
            damping_n_s_per_m: not_negative((hardness * MASS_KG).sqrt()),
            is_saturated,
        };
        match self.law {
            Law::Plastic => None,
            Law::None => Some(FixtureLaw::Free {}),
            Law::Saturated => Some(elastic(true)),
            Law::Spring => Some(elastic(false)),
            Law::Viscous => Some(FixtureLaw::Viscous {
                across_n_s_per_m: not_negative(hardness),
                along_n_s_per_m: not_negative(ALONG_N_S_PER_M),
            }),
        }
    }
}
