//! Common parts of all simulated force sensors, for any protocol: channels, range, zero, and a clock.

use std::time::Duration;

use yieldwall_fieldbus::time::Time;

/// Channels: Fx Fy Fz Tx Ty Tz.
pub(super) const CHANNELS: usize = 6;

/// Converters and clock.
#[derive(Clone, Debug)]
pub(super) struct Sampler {
    range_counts: i32,
    /// Period of its own clock; `None` if the caller is the clock.
    period: Option<Duration>,
    phase: Duration,
    next_tick: Time,
    present: [i32; CHANNELS],
    zero: [i32; CHANNELS],
    clock_rate: f64,
    /// Share of a sample period that has passed since the last sample.
    clock_phase: f64,
    is_invalid: bool,
}

/// One sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Conversion {
    pub(super) counts: [i32; CHANNELS],
    /// A channel is at the end of its range.
    pub(super) is_overloaded: bool,
    /// The sensor's own monitoring says so.
    pub(super) is_invalid: bool,
}

impl Conversion {
    /// The counts as a sensor with 16 bits sends them.
    pub(super) fn narrow(&self) -> [i16; CHANNELS] {
        self.counts.map(|counts| counts.clamp(i16::MIN.into(), i16::MAX.into()) as i16)
    }
}

impl Sampler {
    pub(super) fn new(range_counts: i32, period: Option<Duration>, phase: Duration) -> Self {
        Self {
            range_counts,
            period,
            phase,
            next_tick: Time::NEVER,
            present: [0; CHANNELS],
            zero: [0; CHANNELS],
            clock_rate: 1.0,
            clock_phase: 0.0,
            is_invalid: false,
        }
    }

    /// As after power-on.
    pub(super) fn reset(&mut self, now: Time) {
        self.zero = [0; CHANNELS];
        self.next_tick = if self.period.is_some() { now + self.phase } else { Time::NEVER };
    }

    /// Starts its own clock at `now`, with a sample at once. The next sample comes after the time that passed from power-on to
    /// the first sample; without a phase it follows directly.
    pub(super) fn begin_clock(&mut self, now: Time) {
        if let Some(period) = self.period {
            self.next_tick = Time(now.0.saturating_sub(period.saturating_sub(self.phase).as_nanos() as u64));
        }
    }

    /// If the sensor has its own clock, sets the next sample to `next` and the period to `period`.
    pub(super) fn set_clock(&mut self, next: Time, period: Duration) {
        if self.period.is_some() {
            (self.period, self.next_tick) = (Some(period), next);
        }
    }

    pub(super) fn measure(&mut self, counts: [i32; CHANNELS]) {
        self.present = counts;
    }

    pub(super) fn set_clock_rate(&mut self, share: f64) {
        self.clock_rate = share.clamp(0.0, 1.0);
    }

    pub(super) fn set_invalid(&mut self, is_invalid: bool) {
        self.is_invalid = is_invalid;
    }

    /// Whether it has its own clock.
    pub(super) fn has_clock(&self) -> bool {
        self.period.is_some()
    }

    pub(super) fn next_tick(&self) -> Time {
        self.next_tick
    }

    /// Returns a sample of its own clock, if one is due.
    pub(super) fn poll(&mut self, now: Time) -> Option<Conversion> {
        let period = self.period.filter(|_| self.next_tick <= now)?;
        self.next_tick = (self.next_tick + period).max(now + Duration::from_nanos(1));
        self.tick()
    }

    /// One period of the clock at its true rate.
    pub(super) fn tick(&mut self) -> Option<Conversion> {
        self.clock_phase += self.clock_rate;
        if self.clock_phase < 1.0 {
            return None;
        }
        self.clock_phase -= 1.0;
        Some(self.convert())
    }

    fn convert(&self) -> Conversion {
        let mut conversion = Conversion { counts: [0; CHANNELS], is_overloaded: false, is_invalid: self.is_invalid };
        for ((to, &present), &zero) in conversion.counts.iter_mut().zip(&self.present).zip(&self.zero) {
            // At the end of the range the converter is cut off before the zero is taken.
            let raw = present.clamp(-self.range_counts, self.range_counts);
            if raw.abs() == self.range_counts {
                conversion.is_overloaded = true;
            }
            *to = raw.saturating_sub(zero);
        }
        conversion
    }

    /// Takes what one channel measures for its zero.
    pub(super) fn take_zero(&mut self, channel: usize) {
        if let (Some(zero), Some(present)) = (self.zero.get_mut(channel), self.present.get(channel)) {
            *zero = (*present).clamp(-self.range_counts, self.range_counts);
        }
    }
}
