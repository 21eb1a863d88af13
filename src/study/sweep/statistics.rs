//! Confidence intervals of a count and of a median.

/// Normal quantile of a two-sided interval of 95 %.
const Z: f64 = 1.959_963_984_540_054;
/// Share of repetitions in which an interval is to hold the true value.
const CONFIDENCE: f64 = 0.95;

/// Up to so many values the binomial distribution is summed: half to this power is still a number.
const EXACT: usize = 1000;

/// The interval of 95 % of a share, of which `hits` of `trials` were seen: 0 to 1. Without a trial it is all of that.
///
/// # Source
/// E. B. Wilson, *Probable inference, the law of succession, and statistical inference* (1927).
pub fn wilson(hits: u64, trials: u64) -> [f64; 2] {
    if trials == 0 {
        return [0.0, 1.0];
    }
    let (count, share) = (trials as f64, hits as f64 / trials as f64);
    let scale = 1.0 + Z * Z / count;
    let center = (share + Z * Z / (2.0 * count)) / scale;
    let half = Z / scale * (share * (1.0 - share) / count + Z * Z / (4.0 * count * count)).sqrt();
    // At the ends the formula is exact, and rounding is not.
    [if hits == 0 { 0.0 } else { center - half }, if hits == trials { 1.0 } else { center + half }]
}

/// An interval that holds the median of what the values are drawn from in at least 95 % of repetitions, whatever its shape: two of the
/// values, counted from both ends. Values that are not finite are left out; `None` for fewer than six others, of which no two will do.
///
/// # Source
/// H. A. David, H. N. Nagaraja, *Order Statistics* (2003), section 7.1.
pub fn median_interval(values: impl IntoIterator<Item = f64>) -> Option<[f64; 2]> {
    let mut sorted: Vec<f64> = values.into_iter().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let count = sorted.len();
    if count > EXACT {
        // By the normal distribution, one value wider.
        let place = (0.5 * (count as f64 - Z * (count as f64).sqrt())).floor() as usize - 1;
        return Some([sorted[place], sorted[count - 1 - place]]);
    }
    // At most `below` of the values lie under the median with this probability, which doubles for both ends.
    let (mut below, mut probability, mut term) = (None, 0.0, (0..count).fold(1.0, |term, _| 0.5 * term));
    for place in 0..count / 2 {
        probability += term;
        if 2.0 * probability > 1.0 - CONFIDENCE {
            break;
        }
        below = Some(place);
        term *= (count - place) as f64 / (place + 1) as f64;
    }
    below.map(|place| [sorted[place], sorted[count - 1 - place]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_have_the_intervals_of_the_textbook() {
        let near = |[low, high]: [f64; 2], [least, most]: [f64; 2]| {
            assert!((low - least).abs() < 5e-5 && (high - most).abs() < 5e-5, "{low} {high}");
        };
        // Of none of 3000, of 1 and of 4: the first two overlap.
        near(wilson(0, 3000), [0.0, 0.00128]);
        near(wilson(1, 3000), [0.00006, 0.00189]);
        near(wilson(4, 3000), [0.00052, 0.00342]);
        // R. G. Newcombe (1998), table I: 81 of 263 and 15 of 148.
        near(wilson(81, 263), [0.2553, 0.3662]);
        near(wilson(15, 148), [0.0624, 0.1605]);
        assert_eq!(wilson(7, 7)[1], 1.0);
        assert_eq!(wilson(0, 0), [0.0, 1.0]);
    }

    #[test]
    fn medians_lie_between_the_values_that_order_statistics_name() {
        let of = |count: i32| median_interval((1..=count).map(f64::from));
        assert_eq!(of(5), None);
        assert_eq!(of(6), Some([1.0, 6.0]));
        assert_eq!(of(12), Some([3.0, 10.0]));
        assert_eq!(of(24), Some([7.0, 18.0]));
        assert_eq!(of(1000), Some([469.0, 532.0]));
        assert_eq!(of(3000), Some([1446.0, 1555.0]));
    }
}
