//! Observations of every fault: how often, and where.

use super::{DeviceSet, Fault, FaultRow, Rate, Reaction, TABLE};

/// A fault that led to a state of the rig, and the devices that showed it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Cause {
    /// The fault.
    pub fault: Fault,
    /// The devices; none where the fault has no device.
    pub devices: DeviceSet,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Count {
    in_a_row: u16,
    devices: DeviceSet,
    /// Cycles of the last observations, as a ring.
    recent: [u32; FaultCounts::MAX_WITHIN as usize],
    next: u8,
    /// Observations so far, as far as the ring goes.
    seen: u16,
    /// Cycles in which it was observed.
    cycles: u32,
}

impl Count {
    const NONE: Self = Self {
        in_a_row: 0,
        devices: DeviceSet::NONE,
        recent: [0; FaultCounts::MAX_WITHIN as usize],
        next: 0,
        seen: 0,
        cycles: 0,
    };

    fn note(&mut self, cycle: u32) {
        let size = self.recent.len();
        let newest = (usize::from(self.next) + size - 1) % size;
        if self.seen > 0 && self.recent.get(newest) == Some(&cycle) {
            return;
        }
        if let Some(slot) = self.recent.get_mut(usize::from(self.next)) {
            *slot = cycle;
        }
        self.next = ((usize::from(self.next) + 1) % size) as u8;
        self.seen = (self.seen + 1).min(FaultCounts::MAX_WITHIN);
        self.cycles = self.cycles.saturating_add(1);
    }

    fn has_reached(&self, rate: Rate, cycle: u32) -> bool {
        match rate {
            Rate::InARow(times) => self.in_a_row >= times,
            Rate::Within { count, cycles } => {
                let size = self.recent.len();
                let place = (usize::from(self.next) + size - usize::from(count.min(FaultCounts::MAX_WITHIN))) % size;
                let since = self.recent.get(place).map_or(u32::MAX, |seen| cycle.wrapping_sub(*seen));
                self.seen >= count && since < u32::from(cycles)
            }
        }
    }
}

/// Observations of every fault: in a row, and the last ones by cycle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FaultCounts {
    counts: [Count; Fault::COUNT],
    cycle: u32,
    /// The faults whose counts may ask for something, a bit each: those of all others are as at the begin. Mostly there are none, and
    /// the counts are many lines of a cache.
    suspects: u64,
}

/// The faults whose observations count on after they are gone, a bit each.
const LASTING: u64 = {
    let mut bits = 0;
    let mut row = 0;
    while row < TABLE.len() {
        let steps = TABLE[row].steps;
        let mut step = 0;
        while step < steps.len() {
            if matches!(steps[step].rate, Rate::Within { .. } | Rate::InARow(0)) {
                bits |= 1 << TABLE[row].fault as u32;
            }
            step += 1;
        }
        row += 1;
    }
    bits
};

impl Default for FaultCounts {
    fn default() -> Self {
        Self { counts: [Count::NONE; Fault::COUNT], cycle: 0, suspects: 0 }
    }
}

impl FaultCounts {
    /// Most observations that [`Rate::Within`] can ask for.
    pub const MAX_WITHIN: u16 = 10;

    /// Begins a cycle.
    ///
    /// Real-time: yes.
    pub fn begin_cycle(&mut self) {
        self.cycle = self.cycle.wrapping_add(1);
    }

    /// Counts one more observation of `fault` if it is `present`, and starts again from zero if not; for faults without
    /// a device.
    ///
    /// Real-time: yes.
    pub fn observe(&mut self, fault: Fault, present: bool) {
        let bit = 1 << fault as u32;
        if !present && self.suspects & bit == 0 {
            return;
        }
        self.suspects = if present || LASTING & bit != 0 { self.suspects | bit } else { self.suspects & !bit };
        let count = &mut self.counts[fault as usize];
        count.in_a_row = if present { count.in_a_row.saturating_add(1) } else { 0 };
        count.devices = DeviceSet::NONE;
        if present {
            count.note(self.cycle);
        }
    }

    /// Counts an observation of a fault that `devices` show; it is present if any device shows it.
    ///
    /// Real-time: yes.
    pub fn observe_on(&mut self, fault: Fault, devices: DeviceSet) {
        self.observe(fault, !devices.is_empty());
        if !devices.is_empty() {
            self.counts[fault as usize].devices = devices;
        }
    }

    /// Observations of `fault` in a row.
    pub fn count(&self, fault: Fault) -> u16 {
        self.counts[fault as usize].in_a_row
    }

    /// Returns the faults that hold nothing when they show ([`Reaction::Count`]) and that were observed, each with the number of
    /// cycles in which it was.
    pub fn counted(&self) -> impl Iterator<Item = (Fault, u32)> {
        let rows = TABLE.iter().filter(|row| row.steps.iter().any(|step| step.reaction == Reaction::Count));
        rows.map(|row| (row.fault, self.counts[row.fault as usize].cycles)).filter(|(_, cycles)| *cycles > 0)
    }

    /// Returns the devices that showed `fault` in its last observation.
    pub fn devices(&self, fault: Fault) -> DeviceSet {
        self.counts[fault as usize].devices
    }

    /// Returns the reaction that the observations of `fault` ask for, if they do.
    ///
    /// Real-time: yes.
    pub fn reaction(&self, fault: Fault) -> Option<Reaction> {
        let count = &self.counts[fault as usize];
        let mut steps = fault.row().steps.iter().rev();
        steps.find(|step| count.has_reached(step.rate, self.cycle)).map(|step| step.reaction)
    }

    /// Returns the strongest reaction that is asked for, with its cause. Among equals the one that latches more severely, then the
    /// first of the table.
    ///
    /// Real-time: yes.
    pub fn worst(&self) -> Option<(Cause, Reaction)> {
        let mut worst: Option<(Cause, Reaction)> = None;
        let mut suspects = self.suspects;
        while let Some(row) = TABLE.get(suspects.trailing_zeros() as usize) {
            suspects &= suspects - 1;
            let rank = |row: &FaultRow, reaction| (reaction, row.final_state(reaction).severity());
            if let Some(reaction) = self.reaction(row.fault)
                && worst.is_none_or(|(cause, known)| rank(row, reaction) > rank(cause.fault.row(), known))
            {
                worst = Some((Cause { fault: row.fault, devices: self.devices(row.fault) }, reaction));
            }
        }
        worst
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn observations_far_apart_are_not_within_so_many_cycles() {
        // An overrun freezes the rig when it was seen three times within 100 cycles.
        let seen_every = |cycles: u32| {
            let mut counts = FaultCounts::default();
            for _ in 0..3 {
                (1..cycles).for_each(|_| {
                    counts.begin_cycle();
                    counts.observe(Fault::Overrun, false);
                });
                counts.begin_cycle();
                counts.observe(Fault::Overrun, true);
            }
            counts.reaction(Fault::Overrun)
        };
        assert_eq!((seen_every(200), seen_every(20)), (Some(Reaction::Count), Some(Reaction::Freeze)));
    }

    #[test]
    fn what_holds_nothing_is_counted_by_the_cycle() {
        let mut counts = FaultCounts::default();
        for cycle in 0..40 {
            counts.begin_cycle();
            counts.observe(Fault::PdoDuplicated, cycle % 2 == 0);
            // Seen twice in one cycle, and one that holds the rig.
            counts.observe(Fault::PdoDuplicated, cycle % 2 == 0);
            counts.observe(Fault::SensorStale, true);
        }
        assert_eq!(counts.counted().collect::<Vec<_>>(), [(Fault::PdoDuplicated, 20)]);
        assert_eq!(counts.reaction(Fault::PdoDuplicated), Some(Reaction::StopRamp), "as often as late ones may come");
        let mut once = FaultCounts::default();
        once.begin_cycle();
        once.observe(Fault::PdoDuplicated, true);
        assert_eq!(once.reaction(Fault::PdoDuplicated), Some(Reaction::Count));
    }

    #[test]
    fn among_equals_the_first_of_the_table_is_the_cause() {
        let mut counts = FaultCounts::default();
        for _ in 0..2 {
            counts.observe(Fault::Emergency, true);
            counts.observe(Fault::NodeReset, true);
        }
        assert_eq!((counts.count(Fault::Emergency), counts.count(Fault::BusOff)), (2, 0));
        let cause = Cause { fault: Fault::NodeReset, devices: DeviceSet::NONE };
        assert_eq!(counts.worst(), Some((cause, Reaction::QuickStop)));
    }

    #[test]
    fn misses_escalate_and_a_good_cycle_starts_again() {
        let mut counts = FaultCounts::default();
        let cause = Cause { fault: Fault::PdoMissed, devices: DeviceSet::LEFT_DRIVE };
        let mut see = |devices| {
            counts.begin_cycle();
            counts.observe_on(Fault::PdoMissed, devices);
            counts.worst()
        };
        assert_eq!(see(DeviceSet::LEFT_DRIVE), None);
        assert_eq!(see(DeviceSet::LEFT_DRIVE), Some((cause, Reaction::Freeze)));
        for _ in 0..2 {
            assert_eq!(see(DeviceSet::LEFT_DRIVE), Some((cause, Reaction::Freeze)));
        }
        assert_eq!(see(DeviceSet::LEFT_DRIVE), Some((cause, Reaction::QuickStop)));
        assert_eq!(see(DeviceSet::NONE), None);
    }

    #[test]
    fn the_strongest_reaction_wins() {
        let mut counts = FaultCounts::default();
        counts.observe(Fault::SensorSaturated, true);
        counts.observe_on(Fault::BusOff, DeviceSet::HOST);
        let cause = Cause { fault: Fault::BusOff, devices: DeviceSet::HOST };
        assert_eq!(counts.worst(), Some((cause, Reaction::Silence)));
    }

    proptest! {
        /// What is looked at is enough: nothing that was left out would have been worse.
        #[test]
        fn the_worst_of_the_suspects_is_the_worst_of_all(
            seen in proptest::collection::vec((0..Fault::COUNT, any::<bool>(), 0..3_u32), 1..400),
        ) {
            let mut counts = FaultCounts::default();
            for (row, present, cycles) in seen {
                (0..cycles).for_each(|_| counts.begin_cycle());
                counts.observe(TABLE[row].fault, present);
                let asked = TABLE.iter().filter_map(|row| Some((row, counts.reaction(row.fault)?)));
                // Of equals the first.
                let all = asked.rev().max_by_key(|(row, reaction)| (*reaction, row.final_state(*reaction).severity()));
                prop_assert_eq!(counts.worst().map(|(cause, reaction)| (cause.fault, reaction)), all.map(|(row, reaction)| (row.fault, reaction)));
            }
        }

        /// The ring answers as a list of all observations would.
        #[test]
        fn a_rate_within_cycles_is_that_of_the_last_cycles(seen in proptest::collection::vec(any::<bool>(), 1..400)) {
            let rate = Rate::Within { count: 3, cycles: 20 };
            let mut count = Count::NONE;
            for (cycle, present) in seen.iter().enumerate() {
                if *present {
                    count.note(cycle as u32);
                    count.note(cycle as u32);
                }
                let from = (cycle + 1).saturating_sub(20);
                let expected = seen[from..=cycle].iter().filter(|seen| **seen).count() >= 3;
                prop_assert_eq!(count.has_reached(rate, cycle as u32), expected, "cycle {}", cycle);
            }
        }
    }
}
