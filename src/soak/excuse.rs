//! Why a judgement that does not hold is no violation, and how often that was so.

use std::collections::BTreeMap;

use super::invariant::Invariant;

/// A reason why a broken invariant is no violation. Excuses are counted, by invariant and reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Excuse {
    /// An injection falsifies the judged value.
    Falsified,
    /// Several faults at once, whose effects cannot be separated.
    SeveralAtOnce,
    /// A fault counted over a window of cycles, which an earlier injection has filled.
    EarlierInjection,
    /// A jump of an encoder that the joint could have turned.
    SmallJump,
    /// A broken link had kept the set-point.
    Kept,
    /// The drive reported nothing in the cycle.
    Unreported,
    /// The drive reported twice in the cycle.
    ReportedTwice,
    /// The drives are not enabled, and the target follows the joint.
    Follows,
    /// The joint turned so far between the two moments that are compared.
    Turned,
    /// The first cycles after a start from rest.
    Start,
    /// The guard brakes before the edge of the workspace.
    Edge,
    /// An impact, or the hold after it.
    Impact,
    /// The proxy was drawn back since the torques reached their limit.
    DrawnBack,
    /// Near the centre of a round surface.
    Centre,
    /// A hand alone brings it.
    Hand,
    /// The arm is far outside of where the rig promises to work.
    Far,
    /// The arm moved outside of there when the drives were enabled.
    Carried,
    /// A drive gave all the torque that it may.
    TorqueLimit,
    /// The sensor has no noise.
    Noiseless,
    /// Too few for a rate.
    TooFew,
    /// Nobody held the arm.
    Unheld,
}

impl Excuse {
    /// All of them.
    pub const ALL: [Self; 21] = [
        Self::Falsified,
        Self::SeveralAtOnce,
        Self::EarlierInjection,
        Self::SmallJump,
        Self::Kept,
        Self::Unreported,
        Self::ReportedTwice,
        Self::Follows,
        Self::Turned,
        Self::Start,
        Self::Edge,
        Self::Impact,
        Self::DrawnBack,
        Self::Centre,
        Self::Hand,
        Self::Far,
        Self::Carried,
        Self::TorqueLimit,
        Self::Noiseless,
        Self::TooFew,
        Self::Unheld,
    ];

    /// Returns the name for reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Falsified => "falsified",
            Self::SeveralAtOnce => "several-at-once",
            Self::EarlierInjection => "earlier-injection",
            Self::SmallJump => "small-jump",
            Self::Kept => "kept",
            Self::Unreported => "unreported",
            Self::ReportedTwice => "reported-twice",
            Self::Follows => "follows",
            Self::Turned => "turned",
            Self::Start => "start",
            Self::Edge => "edge",
            Self::Impact => "impact",
            Self::DrawnBack => "drawn-back",
            Self::Centre => "centre",
            Self::Hand => "hand",
            Self::Far => "far",
            Self::Carried => "carried",
            Self::TorqueLimit => "torque-limit",
            Self::Noiseless => "noiseless",
            Self::TooFew => "too-few",
            Self::Unheld => "unheld",
        }
    }

    /// Describes the physical event.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Falsified => "an injection falsifies what is judged, while it lasts and for 0.5 s",
            Self::SeveralAtOnce => "several injections overlap, and nobody can say which of them did what",
            Self::EarlierInjection => "the fault counts over a window of cycles, which an earlier injection has filled",
            Self::SmallJump => "the encoder's jump is within what a joint may turn in three cycles",
            Self::Kept => "a broken link had kept the set-point, and nobody knows of which cycle it is",
            Self::Unreported => "the drive reported nothing in this cycle: its angle is predicted",
            Self::ReportedTwice => {
                "the drive reported twice in one cycle after a cycle without a report, and either may be late"
            }
            Self::Follows => "the drives are not enabled yet: the target moves nothing and follows the joint",
            Self::Turned => {
                "a hand turns a joint faster than twice its limit, and it turned so far between both moments"
            }
            Self::Start => "in its first three cycles a run starts from rest: the steps before are not the fixture's",
            Self::Edge => "the guard may brake the reference before the edge of the workspace",
            Self::Impact => "an impact stops the proxy, and a hold keeps it, by any force",
            Self::DrawnBack => "the torques reached their limit, and the proxy was drawn back",
            Self::Centre => "near the centre of a circle the direction away from the surface turns within a step",
            Self::Hand => "a hand is free to hit, to throw and to shake the tool",
            Self::Far => "a hand has pushed an arm that nobody held beyond 0.24 m",
            Self::Carried => {
                "the drives were enabled, or being enabled, on an arm that a hand carried outward: it takes way to stop"
            }
            Self::TorqueLimit => {
                "a drive is at its torque limit, or was so just before: the arm follows the hand, not the reference"
            }
            Self::Noiseless => "without noise a hand at rest looks like a converter that hangs",
            Self::TooFew => "the run broke off after so few reactions that they are no rate",
            Self::Unheld => "nobody held the arm when a hand pushed it to where its model ends",
        }
    }
}

/// How often what was excused, by invariant and reason.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Excused(BTreeMap<(Invariant, Excuse), u64>);

impl Excused {
    /// Counts one more excuse.
    pub(super) fn note(&mut self, invariant: Invariant, excuse: Excuse) {
        *self.0.entry((invariant, excuse)).or_default() += 1;
    }

    /// Adds what another one has counted.
    pub(super) fn join(&mut self, other: &Self) {
        for (key, times) in &other.0 {
            *self.0.entry(*key).or_default() += times;
        }
    }

    /// Returns the counts, by `name of the invariant` `name of the reason`.
    pub(super) fn by_name(&self) -> BTreeMap<String, u64> {
        let named = |((invariant, excuse), times): (&(Invariant, Excuse), &u64)| {
            (format!("{} {}", invariant.name(), excuse.name()), *times)
        };
        self.0.iter().map(named).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_are_listed_once_and_explained_in_the_page() {
        let page = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/soak.md")).unwrap();
        for (at, excuse) in Excuse::ALL.iter().enumerate() {
            assert_eq!(*excuse as usize, at);
            let row = format!("| {} | {} |", excuse.name(), excuse.text());
            assert!(page.contains(&row), "docs/soak.md lacks: {row}");
        }
    }

    #[test]
    fn counts_add_up_by_name() {
        let mut first = Excused::default();
        first.note(Invariant::YieldLevels, Excuse::Edge);
        let mut sum = first.clone();
        sum.join(&first);
        sum.note(Invariant::FalseAlarm, Excuse::Hand);
        let expected = BTreeMap::from([("yield-levels edge".to_owned(), 2), ("false-alarm hand".to_owned(), 1)]);
        assert_eq!(sum.by_name(), expected);
    }
}
