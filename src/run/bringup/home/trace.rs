//! The positions of a joint that homes, and by how much they jump when its drive takes its reference.
//!
//! The joint moves at its rate when home is found. The shift of the reference is the first position after the jump against the line
//! through the positions before it. A shift may be smaller than the travel in a cycle. So the first jump, which is large if the
//! drive was just switched on, shows how long before statusword bit 12 the drive takes its reference. Later shifts are looked for
//! at the same distance from that bit.

/// Positions before the jump through which the line is laid, and how many of them have to be there.
const BEFORE: usize = 10;
const LEAST_BEFORE: usize = 6;
/// Largest distance in cycles from the expected cycle in which a drive may take its reference.
const BESIDE: usize = 1;

/// Positions that a drive reported while it homed.
#[derive(Debug, Default)]
pub(super) struct HomingTrace {
    /// Its position in each cycle, counts; none where it has not come.
    counts: Vec<Option<i64>>,
    /// First cycle in which the drive reported that home is found.
    found_at: Option<usize>,
    /// The first cycle in which its position had jumped.
    jumped_at: Option<usize>,
}

impl HomingTrace {
    /// Creates an empty trace with room for this number of cycles; later cycles are not stored.
    pub(super) fn with_room(cycles: u32) -> Self {
        Self { counts: Vec::with_capacity(cycles as usize), ..Self::default() }
    }

    /// Takes the drive's report of a cycle, `missed` cycles after the one before.
    ///
    /// Real-time: yes.
    pub(super) fn take(&mut self, counts: Option<i64>, missed: u32, is_found: bool, has_jumped: bool) {
        for counts in (0..missed).map(|_| None).chain([counts]) {
            if self.counts.len() < self.counts.capacity() {
                self.counts.push(counts);
            }
        }
        let Some(at) = self.counts.len().checked_sub(1) else { return };
        if is_found {
            self.found_at.get_or_insert(at);
        }
        if has_jumped {
            self.jumped_at.get_or_insert(at);
        }
    }

    /// Returns the number of cycles from the jump of the position to the report that home is found; `None` if the position did not
    /// jump.
    pub(super) fn lead(&self) -> Option<isize> {
        Some(self.found_at? as isize - self.jumped_at? as isize)
    }

    /// Returns the shift of the reference in counts, for a drive that takes it so many cycles before it reports it. The shift is
    /// the new home, in positions before the jump, minus the previous home. `None` if positions are missing there.
    pub(super) fn shift_counts(&self, lead: isize) -> Option<f64> {
        let at = usize::try_from(self.found_at? as isize - lead).ok()?;
        let from = at.checked_sub(BEFORE + BESIDE)?;
        let before = self.counts.get(from..at - BESIDE)?;
        let after = (*self.counts.get(at + BESIDE)?)?;
        let points: Vec<[f64; 2]> = before
            .iter()
            .enumerate()
            .filter_map(|(x, counts)| counts.map(|counts| [x as f64, (counts - after) as f64]))
            .collect();
        if points.len() < LEAST_BEFORE {
            return None;
        }
        let many = points.len() as f64;
        let [x, y] = points.iter().fold([0.0; 2], |[sum_x, sum_y], [x, y]| [sum_x + x / many, sum_y + y / many]);
        let spread: f64 = points.iter().map(|[at, _]| (at - x) * (at - x)).sum();
        let together: f64 = points.iter().map(|[at, counts]| (at - x) * (counts - y)).sum();
        Some(y + together / spread * ((BEFORE + 2 * BESIDE) as f64 - x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A joint that goes `rate` counts in a cycle until its drive finds home in cycle 100, and then comes to rest; positions are whole
    /// counts, and refer from then on to a home that lies `shift` counts farther. It says so `lead` cycles later.
    fn traced(rate: f64, shift: i64, lead: isize, jumps: bool, is_missing: impl Fn(usize) -> bool) -> HomingTrace {
        let mut trace = HomingTrace::with_room(200);
        let (mut true_counts, mut now) = (0.3_f64, rate);
        for at in 0..200_usize {
            let position = true_counts.round() as i64 - if at >= 100 { shift } else { 0 };
            let is_found = at as isize >= 100 + lead;
            trace.take((!is_missing(at)).then_some(position), 0, is_found, jumps && at == 100);
            true_counts += now;
            if at >= 100 {
                now *= 0.98;
            }
        }
        trace
    }

    proptest! {
        #[test]
        fn a_shift_is_found_to_a_count_or_two_whenever_the_drive_says_so(
            rate in -20.0..20.0f64, shift in -500..500i64, lead in -20..40isize, late in -1..=1isize, missing in 0..9usize,
        ) {
            let first = traced(rate, 100_000, lead, true, |_| false);
            prop_assert_eq!(first.lead(), Some(lead));
            let again = traced(rate, shift, lead + late, false, |at| at == 90 + missing);
            let found = again.shift_counts(lead).unwrap();
            // It comes to rest meanwhile: 2 % of its rate in a cycle.
            prop_assert!((found - shift as f64).abs() < 1.5 + 0.1 * rate.abs(), "{found} {shift}");
            prop_assert_eq!(again.lead(), None);
        }
    }

    #[test]
    fn positions_that_are_missing_show_nothing() {
        assert_eq!(traced(5.0, 10, 0, false, |at| at == 101).shift_counts(0), None);
        assert_eq!(traced(5.0, 10, 0, false, |at| (90..96).contains(&at)).shift_counts(0), None);
        assert_eq!(traced(5.0, 10, 0, false, |_| false).shift_counts(95), None);
        assert_eq!(HomingTrace::with_room(0).shift_counts(0), None);
        let mut late = HomingTrace::with_room(4);
        late.take(Some(1), 2, true, true);
        assert_eq!((late.counts.as_slice(), late.found_at), (&[None, None, Some(1)][..], Some(2)));
    }
}
