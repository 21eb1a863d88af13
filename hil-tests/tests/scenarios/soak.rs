//! A small soak: it holds, it repeats, and it can be interrupted. The large one is a step of `.ci/run`.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};

use yieldwall::soak::{self, Campaign, SeedResult, Shipped, Store, Tally};

const CYCLES: u32 = 6000;
/// Nobody stops the campaign.
static RUNS_ON: AtomicBool = AtomicBool::new(false);

fn campaign(jobs: usize) -> Campaign {
    Campaign { seeds: 0..36, shard: None, cycles: CYCLES, jobs }
}

fn tally(outcomes: &BTreeMap<u64, SeedResult>) -> Tally {
    let mut tally = Tally::default();
    outcomes.values().for_each(|outcome| tally.add(outcome));
    tally
}

#[test]
fn every_cycle_of_some_seeds_holds() {
    let shipped = Shipped::load().unwrap();
    let outcomes = soak::run(&shipped, &campaign(2), None, &RUNS_ON, |_| {}).unwrap();
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
    let short = |seeds, jobs| Campaign { seeds, shard: None, cycles: 800, jobs };
    let alone = tally(&soak::run(&shipped, &short(0..12, 1), None, &RUNS_ON, |_| {}).unwrap());
    assert_eq!(tally(&soak::run(&shipped, &short(0..12, 3), None, &RUNS_ON, |_| {}).unwrap()), alone);
    // Half of it first, then all of it: what is finished is not run again.
    let folder = std::env::temp_dir().join(format!("yieldwall-soak-{}", std::process::id()));
    let store = Store::open(&folder, 800, None).unwrap();
    soak::run(&shipped, &short(3..9, 2), Some(store), &RUNS_ON, |_| {}).unwrap();
    let mut new = Vec::new();
    let store = Store::open(&folder, 800, None).unwrap();
    let all = soak::run(&shipped, &short(0..12, 2), Some(store), &RUNS_ON, |outcome| new.push(outcome.seed)).unwrap();
    new.sort_unstable();
    assert_eq!(new, [0, 1, 2, 9, 10, 11]);
    assert_eq!(tally(&all), alone);
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn parts_of_which_one_was_stopped_come_to_the_summary_of_all() {
    let shipped = Shipped::load().unwrap();
    let whole = Campaign { seeds: 5..17, shard: None, cycles: 800, jobs: 2 };
    let alone = tally(&soak::run(&shipped, &whole, None, &RUNS_ON, |_| {}).unwrap());
    let folder = std::env::temp_dir().join(format!("yieldwall-soak-parts-{}", std::process::id()));
    let part = |shard: &str, is_stopped: &AtomicBool| {
        let campaign = Campaign { shard: Some(shard.parse().unwrap()), jobs: 1, ..whole.clone() };
        let store = Store::open(&folder, 800, campaign.shard).unwrap();
        let mut new = 0;
        let outcomes = soak::run(&shipped, &campaign, Some(store), is_stopped, |_| {
            new += 1;
            is_stopped.store(!std::ptr::eq(is_stopped, &RUNS_ON), Ordering::Relaxed);
        });
        (new, campaign.missing(&outcomes.unwrap()).len())
    };
    assert_eq!(part("1/3", &RUNS_ON), (4, 0));
    let (new, missing) = part("2/3", &AtomicBool::new(false));
    assert!((1..=4).contains(&new) && new + missing == 4, "{new} new, {missing} missing");
    assert_eq!(part("3/3", &RUNS_ON), (4, 0));
    assert_eq!(whole.missing(&Store::read(&folder, 800).unwrap()).len(), missing);
    assert_eq!(part("2/3", &RUNS_ON), (missing, 0), "it went on where it stood");
    assert_eq!(tally(&Store::read(&folder, 800).unwrap()), alone);
    std::fs::remove_dir_all(&folder).unwrap();
}
