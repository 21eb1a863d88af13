//! Draws that a seed decides.

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use yieldwall_sim::share_of_one;

/// A stream of draws. Streams of one seed with different purposes know nothing of each other, so that leaving a fault
/// out does not change the hand.
#[derive(Clone, Debug)]
pub(super) struct Dice(Xoshiro256PlusPlus);

/// Purpose of a stream of draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub(super) enum Purpose {
    /// The rig and how it is modelled.
    Rig = 1,
    /// The hand and its path.
    Hand = 2,
    /// Faults and their times.
    Faults = 3,
    /// The person at the rig.
    Operator = 4,
}

impl Dice {
    /// Creates the stream of `seed` for `purpose`.
    pub(super) fn new(seed: u64, purpose: Purpose) -> Self {
        // Seeds one after the other are far apart after the multiplication, which is odd and so loses nothing.
        let seed = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (purpose as u64) << 56;
        Self(Xoshiro256PlusPlus::seed_from_u64(seed))
    }

    /// Draws a number from 0 to below 1, with 53 random bits.
    pub(super) fn share(&mut self) -> f64 {
        share_of_one(&mut self.0)
    }

    /// Draws a number from `least` to below `most`.
    pub(super) fn between(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * self.share()
    }

    /// Draws a number from `least` to `most`, both included.
    pub(super) fn whole(&mut self, least: u32, most: u32) -> u32 {
        let span = u64::from(most.saturating_sub(least)) + 1;
        // The upper half of a product: even to 2^-32.
        let draw = ((self.0.next_u64() >> 32) * span) >> 32;
        least + draw as u32
    }

    /// Yes with this probability.
    pub(super) fn chance(&mut self, probability: f64) -> bool {
        self.share() < probability
    }

    /// Draws one of `choices`, which are not empty.
    pub(super) fn one_of<T: Copy>(&mut self, choices: &[T]) -> T {
        let last = choices.len().saturating_sub(1) as u32;
        choices[self.whole(0, last) as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_repeat_and_purposes_differ() {
        let draws = |seed, purpose| {
            let mut dice = Dice::new(seed, purpose);
            [dice.share(), dice.between(2.0, 3.0), f64::from(dice.whole(4, 6))]
        };
        assert_eq!(draws(1, Purpose::Hand), draws(1, Purpose::Hand));
        assert_ne!(draws(1, Purpose::Hand), draws(1, Purpose::Rig));
        assert_ne!(draws(1, Purpose::Hand), draws(2, Purpose::Hand));
    }

    #[test]
    fn draws_fill_their_range_and_keep_within_it() {
        let mut dice = Dice::new(7, Purpose::Faults);
        let mut seen = [0u32; 3];
        for _ in 0..3000 {
            assert!((2.0..3.0).contains(&dice.between(2.0, 3.0)));
            seen[dice.whole(0, 2) as usize] += 1;
        }
        assert!(seen.iter().all(|count| (850..1150).contains(count)), "{seen:?}");
        assert_eq!(dice.whole(5, 5), 5);
    }
}
