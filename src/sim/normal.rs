//! Normally distributed draws.

use std::sync::LazyLock;

use rand_xoshiro::rand_core::Rng;

use super::share_of_one;
use yieldwall_motion::elementary;

/// Layers of equal area that cover the density on one side.
const LAYERS: usize = 256;
/// Where the tail begins, and the area of a layer of `e^(-x^2 / 2)`, that of the lowest with the tail.
const TAIL: f64 = 3.654_152_885_361_009;
const AREA: f64 = 0.004_928_673_233_99;

/// Widths of the layers from the lowest on, and the density at each.
struct Layers {
    width: [f64; LAYERS + 1],
    density: [f64; LAYERS + 1],
}

static TABLES: LazyLock<Layers> = LazyLock::new(|| {
    let mut width = [0.0; LAYERS + 1];
    (width[0], width[1]) = (AREA / density(TAIL), TAIL);
    for layer in 2..LAYERS {
        let last = width[layer - 1];
        width[layer] = (-2.0 * elementary::ln(AREA / last + density(last))).sqrt();
    }
    Layers { width, density: width.map(density) }
});

fn density(x: f64) -> f64 {
    elementary::exp(-x * x / 2.0)
}

/// A number from above 0 to below 1, of 52 bits of a draw and half a step.
fn open_share(stream: &mut impl Rng) -> f64 {
    ((stream.next_u64() >> 12) as f64 + 0.5) / (1_u64 << 52) as f64
}

/// A draw with mean 0 and standard deviation 1, by the ziggurat method; it takes one number of the stream or more.
///
/// # Source
/// J. A. Doornik (2005), An improved ziggurat method to generate normal random samples: ZIGNOR with 256 layers.
pub fn standard_normal(stream: &mut impl Rng) -> f64 {
    let Layers { width, density: height } = &*TABLES;
    loop {
        let bits = stream.next_u64();
        let layer = (bits % LAYERS as u64) as usize;
        // From -1 to below 1.
        let side = (bits >> 12) as f64 / (1_u64 << 51) as f64 - 1.0;
        let x = side * width[layer];
        if x.abs() < width[layer + 1] {
            return x;
        }
        if layer == 0 {
            return tail(stream).copysign(side);
        }
        if height[layer + 1] + (height[layer] - height[layer + 1]) * share_of_one(stream) < density(x) {
            return x;
        }
    }
}

/// A draw from beyond the lowest layer.
fn tail(stream: &mut impl Rng) -> f64 {
    loop {
        let beyond = -elementary::ln(open_share(stream)) / TAIL;
        let exponent = -elementary::ln(open_share(stream));
        if 2.0 * exponent >= beyond * beyond {
            return TAIL + beyond;
        }
    }
}

#[cfg(test)]
mod tests {
    use rand_xoshiro::Xoshiro256PlusPlus;
    use rand_xoshiro::rand_core::SeedableRng;

    use super::*;

    #[test]
    fn the_layers_meet_at_the_top() {
        let Layers { width, density: height } = &*TABLES;
        assert!(width.windows(2).all(|pair| pair[0] > pair[1]) && width[LAYERS] == 0.0 && height[LAYERS] == 1.0);
        let area = |layer: usize| width[layer] * (height[layer + 1] - height[layer]);
        assert!((1..LAYERS).all(|layer| (area(layer) / AREA - 1.0).abs() < 1e-6), "{}", area(LAYERS - 1));
    }

    #[test]
    fn draws_have_the_moments_and_the_tails_of_the_distribution() {
        let mut stream = Xoshiro256PlusPlus::seed_from_u64(1);
        let (mut sums, mut beyond) = ([0.0; 4], [0_u32; 3]);
        let count = 1_000_000;
        for _ in 0..count {
            let x = standard_normal(&mut stream);
            for (power, sum) in (1..).zip(&mut sums) {
                *sum += elementary::powi(x, power) / f64::from(count);
            }
            for (bound, over) in [1.0, 2.0, 3.8].into_iter().zip(&mut beyond) {
                *over += u32::from(x.abs() > bound);
            }
        }
        // Moments 0, 1, 0 and 3 with standard errors 0.0010, 0.0014, 0.0039 and 0.0098.
        for ((sum, moment), error) in sums.into_iter().zip([0.0, 1.0, 0.0, 3.0]).zip([1.0e-3, 1.4e-3, 3.9e-3, 9.8e-3]) {
            assert!((sum - moment).abs() < 4.0 * error, "{sums:?}");
        }
        // 317 310.5, 45 500.3 and 144.7 are expected; the last ones all come from the tail.
        for (over, expected) in beyond.into_iter().zip([317_310.5_f64, 45_500.3, 144.7]) {
            assert!((f64::from(over) - expected).abs() < 4.0 * expected.sqrt(), "{beyond:?}");
        }
    }
}
