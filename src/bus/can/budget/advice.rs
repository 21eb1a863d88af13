//! Advice on the change that makes a bus carry a rig.

use std::time::Duration;

use super::{Budget, Conditions, Moment, Use};
use crate::error::BootError;
use crate::setup::MasterSetup;

/// Bit rates of CiA 301 that can be an answer, bit/s.
const BIT_RATES: [u32; 6] = [50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000];
/// Periods that can be an answer, us.
pub(crate) const PERIODS_US: [u64; 10] = [1000, 2000, 4000, 5000, 10_000, 20_000, 25_000, 40_000, 50_000, 100_000];
/// Steps to the earliest control step; each is one more frame that is waited for.
const STEPS: usize = 64;

/// The least change of cycle or bit rate with which everything arrives in time, and the moments at which the control
/// step may then run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Advice {
    /// Bit rate in bit/s.
    pub bit_rate: u32,
    /// Period.
    pub period: Duration,
    /// Earliest and latest moment of the control step, in whole us.
    pub compute_at_us: [u64; 2],
}

/// Returns the first change that is sufficient: another moment for the control step, a higher bit rate, a longer period. The
/// rig's other buses, under their conditions, must keep the cycle too, except for a bit rate that must rise anyway.
///
/// # Errors
/// As [`Budget::new`].
pub fn advise(setup: &MasterSetup, conditions: Conditions, others: &[Conditions]) -> Result<Option<Advice>, BootError> {
    let rates = BIT_RATES.into_iter().filter(|rate| *rate > conditions.bit_rate).map(|rate| (rate, setup.period));
    let periods = PERIODS_US.into_iter().map(Duration::from_micros).filter(|period| *period > setup.period);
    let periods = periods.map(|period| (conditions.bit_rate, period));
    for (bit_rate, period) in [(conditions.bit_rate, setup.period)].into_iter().chain(rates).chain(periods) {
        let setup = MasterSetup { period, ..setup.clone() };
        let Some([mut earliest, mut latest]) = compute_range_us(&setup, Conditions { bit_rate, ..conditions })? else {
            continue;
        };
        for other in others {
            if let Some(range) = compute_range_us(&setup, *other)? {
                (earliest, latest) = (earliest.max(range[0]), latest.min(range[1]));
            }
        }
        if earliest <= latest {
            return Ok(Some(Advice { bit_rate, period, compute_at_us: [earliest, latest] }));
        }
    }
    Ok(None)
}

/// Earliest and latest whole us at which the control step may run; `None` if there is no such moment.
fn compute_range_us(setup: &MasterSetup, conditions: Conditions) -> Result<Option<[u64; 2]>, BootError> {
    let period_us = u64::try_from(setup.period.as_micros()).unwrap_or(u64::MAX);
    let at =
        |compute_us| Budget::new(setup, Conditions { compute_at: Duration::from_micros(compute_us), ..conditions });
    let mut earliest = 1;
    for _ in 0..STEPS {
        let budget = at(earliest)?;
        // A later control step leaves more time to measured values, and less to the set-points.
        let Some(measured) = longest_us(&budget, Moment::Sync) else { return Ok(None) };
        if measured > earliest && measured < period_us {
            earliest = measured;
            continue;
        }
        let Some(set_points) = longest_us(&budget, Moment::Compute).filter(|_| budget.is_schedulable()) else {
            return Ok(None);
        };
        let latest = period_us.saturating_sub(set_points.max(1));
        let is_whole = latest >= earliest && at(latest)?.is_schedulable();
        return Ok(Some([earliest, if is_whole { latest } else { earliest }]));
    }
    Ok(None)
}

/// The longest time of the process data that count from a moment, in whole us; `None` if there is no bound.
fn longest_us(budget: &Budget, from: Moment) -> Option<u64> {
    let process_data = budget.regular().filter(|each| each.frame.usage < Use::Heartbeat && each.from == from);
    process_data.map(|each| Some(each.response_ns?.div_ceil(1000))).try_fold(0, |most, us| Some(most.max(us?)))
}
