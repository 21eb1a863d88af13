//! An incremental encoder, and how a drive finds its reference: the homing mode of CiA 402.

use crate::standard_normal;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;

/// State of homing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Run {
    /// It was not started, or broken off.
    #[default]
    Resting,
    /// The joint moves this way, -1 or 1, and was here last.
    Seeking { leg: Leg, way: i8, last: i64 },
    /// Home was found.
    Done,
    /// It cannot be found.
    Failed,
}

/// Leg of the search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Leg {
    /// Until it is on the limit switch.
    OntoSwitch,
    /// Until it comes off the limit switch.
    OffSwitch,
    /// Until it passes the index.
    ToIndex,
}

/// Speed of a joint that moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Speed {
    /// Speed of the search for a switch (6099h:1), in this direction.
    Switch(i8),
    /// Speed of the search for zero (6099h:2), in this direction.
    Zero(i8),
    /// None.
    None,
}

/// An encoder that knows nothing at power-on, and its mark: the index, or the edge of the limit switch.
///
/// Counts are those of the machine, whatever the drive takes for zero.
#[derive(Clone, Debug)]
pub(super) struct Home {
    mark: i64,
    /// By how much it is found beside its mark, one homing and another.
    loose: Option<Loose>,
    /// By how much it is found beside its mark this time, counts.
    beside: i64,
    /// Where the drive counts from; nothing from power-on to the first measurement.
    origin: Option<i64>,
    is_referenced: bool,
    run: Run,
    /// Whether the master asks for homing.
    is_asked: bool,
}

/// A mark that is not at the same place each time.
#[derive(Clone, Debug)]
struct Loose {
    /// Standard deviation, counts.
    deviation_counts: f64,
    stream: Xoshiro256PlusPlus,
}

impl Home {
    pub(super) fn new(mark: i64) -> Self {
        let run = Run::Resting;
        Self { mark, loose: None, beside: 0, origin: None, is_referenced: false, run, is_asked: false }
    }

    /// Gives the mark a random error with this standard deviation, counts, drawn for each homing.
    pub(super) fn loosen(&mut self, deviation_counts: f64, seed: u64) {
        self.loose = Some(Loose { deviation_counts, stream: Xoshiro256PlusPlus::seed_from_u64(seed) });
    }

    /// Forgets all.
    pub(super) fn power_on(&mut self) {
        *self = Self { loose: self.loose.take(), ..Self::new(self.mark) };
    }

    /// Takes where the joint is.
    pub(super) fn measure(&mut self, counts: i64) {
        self.origin.get_or_insert(counts);
    }

    /// Where the drive counts from.
    pub(super) fn origin(&self) -> i64 {
        self.origin.unwrap_or_default()
    }

    pub(super) fn is_referenced(&self) -> bool {
        self.is_referenced
    }

    pub(super) fn is_done(&self) -> bool {
        self.run == Run::Done
    }

    pub(super) fn has_failed(&self) -> bool {
        self.run == Run::Failed
    }

    pub(super) fn is_seeking(&self) -> bool {
        matches!(self.run, Run::Seeking { .. })
    }

    /// The drive was homed before: it counts as the machine does.
    pub(super) fn refer_to_machine(&mut self) {
        (self.origin, self.is_referenced) = (Some(0), true);
    }

    /// The drive is in another mode, or without torque.
    pub(super) fn rest(&mut self) {
        (self.run, self.is_asked) = (Run::Resting, false);
    }

    /// Takes bit 4 of the controlword, with the method (6098h) and where the joint is.
    pub(super) fn ask(&mut self, is_asked: bool, method: i8, counts: i64, at_home: i64) {
        if self.is_asked == is_asked {
            return;
        }
        self.is_asked = is_asked;
        if !is_asked {
            if self.is_seeking() {
                self.run = Run::Resting;
            }
            return;
        }
        self.beside = self
            .loose
            .as_mut()
            .map_or(0, |loose| (loose.deviation_counts * standard_normal(&mut loose.stream)).round() as i64);
        let seeking = |leg, way| Run::Seeking { leg, way, last: counts };
        self.run = match method {
            17 => seeking(Leg::OntoSwitch, -1),
            18 => seeking(Leg::OntoSwitch, 1),
            33 => seeking(Leg::ToIndex, -1),
            34 => seeking(Leg::ToIndex, 1),
            35 | 37 => {
                self.find(counts + self.beside, at_home);
                Run::Done
            }
            _ => Run::Failed,
        };
    }

    /// Returns the speed of the joint from its present position.
    pub(super) fn seek(&mut self, counts: i64, at_home: i64) -> Speed {
        let Run::Seeking { leg, way, last } = self.run else { return Speed::None };
        let mark = self.mark + self.beside;
        // How far the mark lies ahead.
        let ahead = |counts: i64| i64::from(way) * (mark - counts);
        let (before, now) = (ahead(last), ahead(counts));
        let (leg, way) = match leg {
            Leg::OntoSwitch if now <= 0 => (Leg::OffSwitch, -way),
            leg => (leg, way),
        };
        let is_home = match leg {
            Leg::OntoSwitch => false,
            // It has come off the switch, the way back.
            Leg::OffSwitch => i64::from(way) * (counts - mark) > 0,
            Leg::ToIndex => now == 0 || (before > 0 && now < 0),
        };
        if is_home {
            self.find(mark, at_home);
            self.run = Run::Done;
            return Speed::None;
        }
        self.run = Run::Seeking { leg, way, last: counts };
        if leg == Leg::OntoSwitch { Speed::Switch(way) } else { Speed::Zero(way) }
    }

    /// Home is here.
    fn find(&mut self, counts: i64, at_home: i64) {
        (self.origin, self.is_referenced) = (Some(counts - at_home), true);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Homes from `from` counts, the mark at 1000 counts and `at_home` the position there; the position at the end, and the farthest counts
    /// either way.
    fn homed(method: i8, from: i64, at_home: i64) -> Option<(i64, [i64; 2])> {
        let mut home = Home::new(1000);
        home.measure(from);
        assert_eq!(home.origin(), from, "it counts from where it was switched on");
        home.ask(true, method, from, at_home);
        let (mut counts, mut ends) = (from, [from; 2]);
        for _ in 0..10_000 {
            match home.seek(counts, at_home) {
                Speed::Switch(way) => counts += 7 * i64::from(way),
                Speed::Zero(way) => counts += 3 * i64::from(way),
                Speed::None => break,
            }
            ends = [ends[0].min(counts), ends[1].max(counts)];
        }
        assert_eq!(home.is_done(), home.is_referenced());
        home.is_done().then(|| (counts - home.origin(), ends))
    }

    #[test]
    fn each_method_ends_with_the_mark_at_its_position() {
        for (method, from) in [(17, 1500), (17, 900), (18, 500), (18, 1100), (33, 1200), (34, 800)] {
            let (position, ends) = homed(method, from, -40).unwrap();
            // It stands within a step of the mark.
            assert!((position + 40).abs() <= 7, "method {method} from {from}: {position}");
            assert!(ends[0] >= from.min(1000) - 7 && ends[1] <= from.max(1000) + 7, "{method} from {from}: {ends:?}");
        }
        for method in [35, 37] {
            assert_eq!(homed(method, 700, 123), Some((123, [700, 700])));
        }
    }

    #[test]
    fn an_index_that_lies_behind_and_a_method_that_it_lacks_lead_nowhere() {
        assert_eq!(homed(33, 900, 0), None);
        assert_eq!(homed(34, 1100, 0), None);
        assert_eq!(homed(1, 1100, 0), None);
    }

    #[test]
    fn one_that_is_broken_off_has_no_reference() {
        let mut home = Home::new(1000);
        home.measure(0);
        home.ask(true, 34, 0, 0);
        assert_eq!(home.seek(500, 0), Speed::Zero(1));
        home.ask(false, 34, 500, 0);
        assert_eq!((home.seek(2000, 0), home.is_referenced()), (Speed::None, false));
        home.refer_to_machine();
        assert_eq!((home.is_referenced(), home.origin()), (true, 0));
        home.power_on();
        assert!(!home.is_referenced());
    }

    #[test]
    fn a_loose_mark_is_elsewhere_each_time_and_as_far_as_it_should_be() {
        let mut home = Home::new(1000);
        home.loosen(20.0, 7);
        home.measure(0);
        let mut found = Vec::new();
        for _ in 0..400 {
            home.ask(true, 34, 800, 0);
            (800..1200).find(|counts| home.seek(*counts, 0) == Speed::None).expect("home is on the way");
            found.push((home.origin() - 1000) as f64);
            home.rest();
        }
        let mean = found.iter().sum::<f64>() / 400.0;
        let deviation = (found.iter().map(|it| (it - mean) * (it - mean)).sum::<f64>() / 399.0).sqrt();
        assert!(mean.abs() < 4.0 && (deviation - 20.0).abs() < 3.0, "{mean} {deviation}");
    }
}
