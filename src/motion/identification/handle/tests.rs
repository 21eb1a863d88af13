use super::*;
use proptest::prelude::*;

/// Steps in which a cycle is integrated.
const STEPS: usize = 100;

/// A simulated tool with its force sensor.
#[derive(Clone, Copy, Debug)]
struct Planted {
    mass_kg: f64,
    /// A delay, and the time constant of a low pass behind it, s.
    late_s: f64,
    lag_s: f64,
    /// Greatest noise of a force, N, without a pattern.
    noise_n: f64,
}

const PLANTED: Planted = Planted { mass_kg: 0.3, late_s: 0.0, lag_s: 0.0, noise_n: 0.04 };

/// Numbers without a pattern, -1 to 1.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

fn record(period_s: f64) -> u32 {
    (0.5 / period_s).round() as u32
}

fn excitation(period_s: f64) -> Excitation {
    Excitation::new(period_s, record(period_s), 0.087)
}

/// A tool on a crank of 0.4 m whose acceleration is held from SYNC to SYNC, felt at SYNC before it changes.
fn shaken(planted: Planted, period_s: f64, seed: u64) -> Vec<Shaken> {
    let (excitation, before, record) = (excitation(period_s), lead_in(period_s), record(period_s) as usize);
    let mut noise = Noise(seed);
    let step_s = period_s / STEPS as f64;
    let late = (planted.late_s / step_s).round() as usize;
    let taken = if planted.lag_s > 0.0 { 1.0 - elementary::exp(-step_s / planted.lag_s) } else { 1.0 };
    [1.0, -1.0, 1.0, -1.0, 1.0, -1.0]
        .map(|sign| {
            let run_in = record / 2;
            let (mut place, mut rate, mut filtered) = (0.0, 0.4 * 0.17 * sign, 0.0);
            let mut accelerations: Vec<f64> = Vec::new();
            let mut shaken = Shaken::default();
            for cycle in 0..run_in + before + record + BEHIND {
                if cycle >= run_in {
                    let noise = [noise.next(), noise.next()].map(|noise| planted.noise_n * noise);
                    let force = -planted.mass_kg * filtered;
                    shaken.tips_m.push([0.8 * place, 0.6 * place]);
                    shaken.forces_n.push([0.8 * force + noise[0], 0.6 * force + noise[1]]);
                }
                let angle = |by: u32| excitation.angle_rad(cycle as u32 + by);
                let held = 0.4 * (angle(2) - 2.0 * angle(1) + angle(0)) / (period_s * period_s);
                for _ in 0..STEPS {
                    accelerations.push(held);
                    place += step_s * rate + 0.5 * step_s * step_s * held;
                    rate += step_s * held;
                    let seen = accelerations.len().checked_sub(1 + late).map_or(0.0, |at| accelerations[at]);
                    filtered += taken * (seen - filtered);
                }
            }
            shaken
        })
        .into()
}

fn found(planted: Planted, period_s: f64, seed: u64) -> Result<Handle, NotIdentified> {
    handle(&shaken(planted, period_s, seed), &excitation(period_s), period_s)
}

#[test]
fn behind_a_low_pass_the_age_is_found_to_a_share_of_a_cycle() {
    for period_s in [4e-3, 1e-3, 250e-6] {
        for (late, lag) in [(0.0, 2.0), (0.37, 2.0), (1.3, 2.0), (0.0, 4.0), (0.7, 3.0)] {
            // At 250 Hz the lines end at 30 Hz, and of a force behind four cycles little is left there.
            if lag * period_s > 10e-3 {
                continue;
            }
            let (late_s, lag_s) = (late * period_s, lag * period_s);
            for seed in 1..4 {
                let found = found(Planted { late_s, lag_s, ..PLANTED }, period_s, seed).unwrap();
                let beside = found.age_s.value - late_s - lag_s;
                assert!(beside.abs() < 0.06 * period_s, "{period_s} {late} {lag}: {:.1} us, {found:?}", 1e6 * beside);
                assert!((found.mass_kg.value / 0.3 - 1.0).abs() < 0.03, "{found:?}");
                let [low, high] = found.between_s;
                assert!((low..=high).contains(&(late_s + lag_s)), "{found:?}");
            }
        }
    }
}

#[test]
fn without_one_the_age_is_known_to_half_a_cycle_and_says_so() {
    let period_s = 1e-3;
    for late in [0.0, 0.3, 0.6, 0.95, 2.4, 11.5] {
        let found = found(Planted { late_s: late * period_s, ..PLANTED }, period_s, 3).unwrap();
        let [low, high] = found.between_s.map(|age| age / period_s);
        assert!(low - 0.02 < late && late < high + 0.02, "{late}: {low} to {high}");
        assert!((1.0..1.2).contains(&(high - low)), "{late}: {low} to {high}");
    }
}

#[test]
fn a_handle_that_is_too_light_is_told_with_the_most_that_it_may_be() {
    for (mass_kg, seed) in [(0.0, 1), (0.0, 2), (0.0, 3), (1e-4, 4)] {
        let error = found(Planted { mass_kg, ..PLANTED }, 1e-3, seed).unwrap_err();
        let NotIdentified::NoHandle { mass_kg: fitted, up_to_kg } = error else { panic!("{error:?}") };
        assert!(fitted.abs() < 2e-3 && up_to_kg < 4e-3 && up_to_kg >= mass_kg, "{error}");
    }
}

#[test]
fn what_is_beyond_the_range_or_no_number_is_refused() {
    let long = found(Planted { late_s: 0.05, ..PLANTED }, 1e-3, 1);
    assert!(long.is_err(), "{long:?}");
    let mut passages = shaken(PLANTED, 1e-3, 1);
    assert_eq!(handle(&[], &excitation(1e-3), 1e-3), Err(NotIdentified::TooFew));
    passages[2].forces_n.pop();
    assert_eq!(handle(&passages, &excitation(1e-3), 1e-3), Err(NotIdentified::TooFew));
    passages[2].forces_n.push([f64::NAN, 0.0]);
    assert_eq!(handle(&passages, &excitation(1e-3), 1e-3), Err(NotIdentified::NotFinite));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn whatever_the_age_is_it_lies_where_it_is_said_to(
        late in 0.0..6.0f64, lag in prop::option::of(0.3..6.0f64), mass_kg in 0.1..0.8f64, seed in 1u64..1000,
    ) {
        let period_s = 1e-3;
        let (late_s, lag_s) = (late * period_s, lag.unwrap_or(0.0) * period_s);
        let found = found(Planted { mass_kg, late_s, lag_s, ..PLANTED }, period_s, seed).unwrap();
        let [low, high] = found.between_s;
        // An interval of 95 % misses one case in twenty. One that is twice as wide misses one in ten thousand.
        let slack_s = 20e-6 + found.age_s.high - found.age_s.value;
        prop_assert!(low - slack_s < late_s + lag_s && late_s + lag_s < high + slack_s, "{late} {lag:?}: {found:?}");
    }
}
