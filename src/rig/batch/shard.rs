//! Parts of many computations, for several processes or computers.

use std::collections::BTreeSet;
use std::fmt;
use std::num::NonZeroU64;
use std::str::FromStr;

/// Part `number`, from 1, of `of`: the numbers that are `number - 1` modulo `of`. As text it is such as `3/16`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    number: u64,
    of: NonZeroU64,
}

impl Shard {
    /// Whether a number is of this part.
    pub fn holds(self, number: u64) -> bool {
        number % self.of == self.number - 1
    }

    /// Returns the name for a file, such as `3-of-16`.
    pub fn name(self) -> String {
        format!("{}-of-{}", self.number, self.of)
    }

    /// Returns the numbers, from 1, of the parts of `of` that hold any of `numbers`.
    pub fn holding(numbers: impl IntoIterator<Item = u64>, of: NonZeroU64) -> BTreeSet<u64> {
        numbers.into_iter().map(|number| number % of + 1).collect()
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl FromStr for Shard {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let read = || {
            let (number, of) = text.split_once('/')?;
            Some(Self { number: number.parse().ok()?, of: of.parse().ok()? })
        };
        let shard = read().filter(|shard| (1..=shard.of.get()).contains(&shard.number));
        shard.ok_or("write PART/PARTS, such as 3/16; parts count from 1")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn parts_are_read() {
        let shard: Shard = "3/16".parse().unwrap();
        assert_eq!((shard.number, shard.of.get()), (3, 16));
        assert_eq!((shard.to_string().as_str(), shard.name().as_str()), ("3/16", "3-of-16"));
        for wrong in ["0/4", "5/4", "1", "a/2", "1/0", "0/0", "-1/4", "1/2/3"] {
            assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn every_number_is_of_one_part_and_that_part_is_named(number: u64, of in 1..40u64) {
            let of = NonZeroU64::new(of).unwrap();
            let holding: BTreeSet<u64> =
                (1..=of.get()).filter(|part| format!("{part}/{of}").parse::<Shard>().unwrap().holds(number)).collect();
            prop_assert_eq!(holding.len(), 1);
            prop_assert_eq!(Shard::holding([number], of), holding);
        }
    }
}
