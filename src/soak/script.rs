//! Faults of a seed and their times.

use std::fmt;
use std::str::FromStr;

use super::dice::{Dice, Purpose};
use super::draw::Machine;
use super::{Shipped, nature};
use yieldwall_config::injection::{CATALOGUE, Injection, InjectionError, Kind, Lasts, Target};

/// One seed in this many brings faults that are present from switching on.
const BOOT_EVERY: u64 = 10;
/// One seed in this many brings several faults at once.
const TANGLE_EVERY: u64 = 4;
/// Share of the seeds that end with the end of the process.
const ENDING_SHARE: f64 = 0.3;
/// Time in s from the begin of the scene to the first fault: the hand has taken the tool and moves.
const FIRST_AFTER_S: f64 = 0.4;
/// Time in s from the end of a fault to the next. Meanwhile the rig has stopped, and the person has reset and enabled it, after
/// booting the network anew if needed.
const APART_S: [f64; 2] = [0.9, 1.4];
/// Time in s between faults of a tangle, on average.
const TANGLE_APART_S: f64 = 0.25;
/// Cycles by which a frame is late at most.
const MOST_LATE_CYCLES: f64 = 2.5;
/// Time in s that the end of the process takes with all that follows.
const ENDING_S: f64 = 0.3;

/// Injections of a seed.
#[derive(Clone, Debug, PartialEq)]
pub struct Script {
    /// The faults, by their start.
    pub injections: Vec<Injection>,
    /// Whether the faults may overlap. Their effects then cannot be separated.
    pub is_tangle: bool,
}

impl Script {
    /// Draws the script of `seed` for a run of `cycles` cycles.
    pub fn draw(machine: &Machine, seed: u64, cycles: u32) -> Self {
        let mut dice = Dice::new(seed, Purpose::Faults);
        let duration_s = f64::from(cycles) * machine.period_s();
        // The seeds of one rig are six apart: the choice below has to run over all of them.
        let turn = seed / super::RIGS.len() as u64;
        if seed % BOOT_EVERY == BOOT_EVERY - 1 {
            let kinds: Vec<Kind> = kinds(machine, nature::is_from_boot).collect();
            let kind = kinds[(seed / BOOT_EVERY % kinds.len() as u64) as usize];
            return Self { injections: vec![at(&mut dice, machine, kind, 0.0)], is_tangle: false };
        }
        let is_tangle = turn % TANGLE_EVERY == TANGLE_EVERY - 1;
        let mut injections =
            if is_tangle { tangle(&mut dice, machine, duration_s) } else { one_by_one(&mut dice, machine, duration_s) };
        if dice.chance(ENDING_SHARE) && duration_s > 2.0 * ENDING_S {
            let ends: Vec<Kind> = kinds(machine, nature::is_last).collect();
            let from_s = duration_s - ENDING_S;
            injections.retain(|injection| nature::settled_s(injection) < from_s || is_tangle);
            let kind = dice.one_of(&ends);
            injections.push(at(&mut dice, machine, kind, from_s));
        }
        Self { injections, is_tangle }
    }

    /// Whether the rig of a seed can have the faults.
    ///
    /// # Errors
    /// The first that means nothing on its bus, or at its target.
    pub fn check(&self, shipped: &Shipped, seed: u64) -> Result<(), InjectionError> {
        let machine = Machine::draw(shipped, seed);
        self.injections.iter().try_for_each(|injection| injection.check_on(machine.rig.medium(injection)))
    }
}

/// Returns the kinds that have a target on the buses of a machine.
fn kinds(machine: &Machine, belongs: impl Fn(Kind) -> bool) -> impl Iterator<Item = Kind> {
    let all = CATALOGUE.iter().map(|row| row.kind);
    all.filter(|kind| !machine.targets(*kind).is_empty()).filter(move |kind| belongs(*kind))
}

fn at(dice: &mut Dice, machine: &Machine, kind: Kind, start_s: f64) -> Injection {
    Injection::new(kind, start_s).on(dice.one_of(&machine.targets(kind)))
}

/// Draws faults one after the other, each with time to recover from it. A deck holds no kind twice, so that all kinds come.
fn one_by_one(dice: &mut Dice, machine: &Machine, duration_s: f64) -> Vec<Injection> {
    let mut deck: Vec<Kind> = kinds(machine, |kind| !nature::is_from_boot(kind) && !nature::is_last(kind)).collect();
    let mut injections = Vec::new();
    let mut time_s = FIRST_AFTER_S + dice.between(0.0, 0.3);
    while !deck.is_empty() {
        let kind = deck.swap_remove(dice.whole(0, deck.len() as u32 - 1) as usize);
        let target = dice.one_of(&machine.targets(kind));
        let mut injection = nature::usual(kind, time_s, machine.period_s()).on(target);
        if dice.chance(0.3) {
            vary(dice, &mut injection);
        }
        choose_moment(dice, machine, &mut injection);
        let over_s = nature::over_s(&injection);
        let end_s = if over_s.is_finite() { over_s } else { time_s };
        if end_s + APART_S[0] > duration_s {
            if time_s + APART_S[1] > duration_s {
                break;
            }
            continue;
        }
        injections.push(injection);
        time_s = end_s + dice.between(APART_S[0], APART_S[1]);
    }
    injections
}

fn tangle(dice: &mut Dice, machine: &Machine, duration_s: f64) -> Vec<Injection> {
    let deck: Vec<Kind> = kinds(machine, |kind| !nature::is_from_boot(kind) && !nature::is_last(kind)).collect();
    let mut injections = Vec::new();
    let mut time_s = FIRST_AFTER_S;
    while time_s < duration_s {
        let kind = dice.one_of(&deck);
        let mut injection = at(dice, machine, kind, time_s);
        vary(dice, &mut injection);
        choose_moment(dice, machine, &mut injection);
        injections.push(injection);
        // A burst now and then, else a pause in which the rig can come back.
        time_s += if dice.chance(0.3) { dice.between(0.5, 1.5) } else { dice.between(0.0, 2.0 * TANGLE_APART_S) };
    }
    injections
}

/// Draws a duration and a size other than the usual ones.
fn vary(dice: &mut Dice, injection: &mut Injection) {
    let row = injection.kind.row();
    if let (Lasts::For(usual_s), true) = (row.lasts, dice.chance(0.7)) {
        injection.duration_s = Some(usual_s * dice.between(0.1, 1.5));
    }
    if let Some(size) = row.size
        && dice.chance(0.5)
    {
        let drawn = size.usual * dice.between(0.3, 1.5);
        injection.size = drawn.clamp(size.least, size.most);
    }
}

/// Draws a moment of the cycle, or a register if the size selects one; half of the late frames are late by up to some cycles.
fn choose_moment(dice: &mut Dice, machine: &Machine, injection: &mut Injection) {
    if injection.kind == Kind::FrameDelayed && dice.chance(0.5) {
        injection.size = dice.between(0.1, MOST_LATE_CYCLES) * machine.period_s();
    }
    if let (true, Some(size)) = (nature::is_alike_at_any_size(injection.kind), injection.kind.row().size) {
        injection.size = dice.between(size.least, size.most);
        if nature::is_a_register(injection.kind) {
            injection.size = injection.size.round();
        }
    }
}

/// `name:target@start`, then `+duration` and `=size` where there is one, in s and the kind's unit; commas between.
impl fmt::Display for Script {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, injection) in self.injections.iter().enumerate() {
            let separator = if at == 0 { "" } else { "," };
            let Injection { kind, target, start_s, duration_s, size } = injection;
            write!(f, "{separator}{}:{}@{start_s}", kind.row().name, target.name())?;
            if let Some(duration_s) = duration_s {
                write!(f, "+{duration_s}")?;
            }
            if kind.row().size.is_some() {
                write!(f, "={size}")?;
            }
        }
        Ok(())
    }
}

impl FromStr for Script {
    type Err = String;

    /// Reads what [`Script`] prints; faults one by one. Whether they mean something on the buses of a rig is not asked.
    fn from_str(text: &str) -> Result<Self, String> {
        let injections = text.split(',').filter(|part| !part.is_empty()).map(parse).collect::<Result<_, _>>()?;
        Ok(Self { injections, is_tangle: false })
    }
}

fn parse(part: &str) -> Result<Injection, String> {
    let wanted = || format!("`{part}` is no injection: name:target@start, then +duration and =size, in that order");
    let number = |text: &str| text.parse::<f64>().map_err(|_| wanted());
    let (rest, size) = match part.split_once('=') {
        Some((rest, size)) => (rest, Some(number(size)?)),
        None => (part, None),
    };
    let (what, when) = rest.split_once('@').ok_or_else(wanted)?;
    let (start, duration) = match when.split_once('+') {
        Some((start, duration)) => (start, Some(number(duration)?)),
        None => (when, None),
    };
    let (name, target) = what.split_once(':').ok_or_else(wanted)?;
    let kind = Kind::named(name).ok_or_else(|| format!("there is no injection named `{name}`"))?;
    let target = Target::named(target).ok_or_else(|| format!("there is no target named `{target}`"))?;
    let usual = Injection::new(kind, number(start)?);
    let injection = usual.on(target).lasting(duration).sized(size.unwrap_or(usual.size));
    injection.check().map_err(|error| error.to_string())?;
    Ok(injection)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;
    use yieldwall_config::injection::Medium;

    #[test]
    fn a_fault_that_the_bus_of_a_seed_lacks_is_refused() {
        let shipped = Shipped::load().unwrap();
        let script: Script = "mailbox-stuck:left_drive@0.5".parse().unwrap();
        let seeds: Vec<u64> = (0..20).filter(|seed| script.check(&shipped, *seed).is_ok()).collect();
        let on_ethercat =
            |seed: &u64| Machine::draw(&shipped, *seed).rig.medium(&script.injections[0]) == Medium::Ethercat;
        assert_eq!(seeds, (0..20).filter(on_ethercat).collect::<Vec<_>>());
        assert!(!seeds.is_empty() && seeds.len() < 20);
    }

    #[test]
    fn two_hundred_seeds_bring_every_kind_and_every_injection_is_possible() {
        let shipped = Shipped::load().unwrap();
        let mut drawn: BTreeMap<&str, u32> = BTreeMap::new();
        for seed in 0..200 {
            let machine = Machine::draw(&shipped, seed);
            for injection in Script::draw(&machine, seed, 10_000).injections {
                let read: Script =
                    Script { injections: vec![injection], is_tangle: false }.to_string().parse().unwrap();
                assert_eq!(read.injections, [injection], "seed {seed}");
                read.check(&shipped, seed).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
                *drawn.entry(injection.kind.row().name).or_default() += 1;
            }
        }
        for row in &CATALOGUE {
            let times = drawn.get(row.name).copied().unwrap_or_default();
            assert!(times >= 2, "{} is drawn {times} times", row.name);
        }
    }

    #[test]
    fn what_is_no_script_is_refused() {
        for text in [
            "pdo-lost",
            "pdo-lost@1",
            "pdo-lost:left_drive",
            "pdo-lost:hand@1",
            "nothing:hand@1",
            "pdo-lost:left_drive@x",
        ] {
            assert!(text.parse::<Script>().is_err(), "{text}");
        }
        assert_eq!("".parse::<Script>().unwrap().injections, []);
    }
}
