//! Even draws.

use rand_xoshiro::rand_core::Rng;

/// A number from 0 to below 1, with the upper 53 bits of a draw: every such number is as likely as any other.
pub fn share_of_one(stream: &mut impl Rng) -> f64 {
    (stream.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use rand_xoshiro::SplitMix64;
    use rand_xoshiro::rand_core::SeedableRng;

    use super::*;

    #[test]
    fn draws_are_even() {
        let mut stream = SplitMix64::seed_from_u64(1);
        let mut tenths = [0u32; 10];
        for _ in 0..10_000 {
            tenths[(10.0 * share_of_one(&mut stream)) as usize] += 1;
        }
        assert!(tenths.iter().all(|count| (850..1150).contains(count)), "{tenths:?}");
    }
}
