//! A small soak: it holds, it repeats, and it can be interrupted. The large one is a step of `.ci/run`.

use std::collections::BTreeMap;

use yieldwall::soak::{self, Campaign, SeedResult, Shipped, Store, Tally};

const CYCLES: u32 = 6000;

fn campaign(jobs: usize) -> Campaign {
    Campaign { seeds: 0..36, cycles: CYCLES, jobs }
}

fn tally(outcomes: &BTreeMap<u64, SeedResult>) -> Tally {
    let mut tally = Tally::default();
    outcomes.values().for_each(|outcome| tally.add(outcome));
    tally
}

#[test]
fn every_cycle_of_some_seeds_holds() {
    let shipped = Shipped::load().unwrap();
    let outcomes = soak::run(&shipped, &campaign(2), None, |_| {}).unwrap();
    for outcome in outcomes.values() {
        let replay = outcome.replay.as_deref().unwrap_or_default();
        assert!(outcome.violations.is_empty(), "{:?}\nreplay: yieldwall soak {replay}", outcome.violations);
    }
    let tally = tally(&outcomes);
    assert_eq!(tally.seeds, 36);
    assert!(tally.peaks.wraps > 0, "no counter wrapped");
    let hits: u64 = tally.injections.values().map(|injection| injection.hits).sum();
    assert!(hits > 60, "{hits} injections met a rig that ran");
}

#[test]
fn the_summary_knows_neither_threads_nor_interruptions() {
    let shipped = Shipped::load().unwrap();
    let short = |seeds, jobs| Campaign { seeds, cycles: 800, jobs };
    let alone = tally(&soak::run(&shipped, &short(0..12, 1), None, |_| {}).unwrap());
    assert_eq!(tally(&soak::run(&shipped, &short(0..12, 3), None, |_| {}).unwrap()), alone);
    // Half of it first, then all of it: what is finished is not run again.
    let folder = std::env::temp_dir().join(format!("yieldwall-soak-{}", std::process::id()));
    let store = Store::open(&folder, 800).unwrap();
    soak::run(&shipped, &short(3..9, 2), Some(store), |_| {}).unwrap();
    let mut new = Vec::new();
    let store = Store::open(&folder, 800).unwrap();
    let all = soak::run(&shipped, &short(0..12, 2), Some(store), |outcome| new.push(outcome.seed)).unwrap();
    new.sort_unstable();
    assert_eq!(new, [0, 1, 2, 9, 10, 11]);
    assert_eq!(tally(&all), alone);
    std::fs::remove_dir_all(&folder).unwrap();
}
