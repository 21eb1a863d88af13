//! How late this computer wakes up, and how long a frame takes to the bus and back.

use std::fmt;
use std::ops::ControlFlow;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::histogram::Histogram;
use crate::Metronome;
use yieldwall_fieldbus::canopen::Frame;
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{CanLink, Received};

/// Identifier of the frames that are sent: of the lowest priority, and none that CiA 301 lets a device use.
pub const PROBE: u16 = 0x7ff;
/// Cycles for which the highest tier has to be shown: 27.8 h at 1 kHz.
pub const PROVING_CYCLES: u64 = 100_000_000;
/// Cycles for which the next one has to be shown: where none of 3000 is too late, fewer than 1 in 1000 are, with a confidence
/// of 95 %.
pub const STOCK_CYCLES: u64 = 3000;

/// Result of a measurement.
#[derive(Clone, Debug, Default)]
pub struct Latency {
    /// Time from each grid point to the moment at which the loop ran.
    pub wake: Histogram,
    /// Time from handing a frame to the interface to seeing it on the bus.
    pub round_trip: Histogram,
    /// Grid points that passed without a wake-up.
    pub missed: u64,
    /// Frames that were never seen on the bus, or could not be sent.
    pub lost: u64,
}

/// Timing class of a computer. Bounds are shares of the cycle: half a millisecond of delay is nothing at 100 ms and half of the
/// cycle at 1 ms.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Tier {
    /// Real-time: late by at most a tenth of the cycle, by at most a twentieth in 99.99 % of the cycles, and no cycle missed.
    A,
    /// A stock kernel: late by at most half of the cycle in 99.9 % of the cycles, and no maximum.
    B,
    /// Neither: simulation in virtual time, or a slower cycle.
    C,
}

impl fmt::Display for Tier {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self, f)
    }
}

/// Values of a measurement that decide the tier. Times are delays of the loop's wake-ups, in us.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lateness {
    /// Wake-ups.
    pub cycles: u64,
    /// Grid points that passed without one.
    pub missed: u64,
    /// Not exceeded in 99.9 %.
    pub p999_us: f64,
    /// Not exceeded in 99.99 %.
    pub p9999_us: f64,
    /// The longest.
    pub max_us: f64,
}

impl Lateness {
    /// Returns the tier whose bounds were kept, for a rig of this cycle in us; see [`Lateness::proven`].
    pub fn tier(&self, period_us: u32) -> Tier {
        let share = |share: f64| f64::from(period_us) * share;
        if self.cycles == 0 {
            Tier::C
        } else if self.missed == 0 && self.max_us <= share(0.1) && self.p9999_us <= share(0.05) {
            Tier::A
        } else if self.p999_us <= share(0.5) {
            Tier::B
        } else {
            Tier::C
        }
    }

    /// Returns the highest tier that was shown by enough cycles: [`PROVING_CYCLES`] for A, [`STOCK_CYCLES`] for B.
    pub fn proven(&self, period_us: u32) -> Tier {
        let shown = match self.cycles {
            PROVING_CYCLES.. => Tier::A,
            STOCK_CYCLES.. => Tier::B,
            _ => Tier::C,
        };
        self.tier(period_us).max(shown)
    }
}

impl Latency {
    /// Returns the values that decide the tier.
    pub fn lateness(&self) -> Lateness {
        let us = |time: Duration| 1e6 * time.as_secs_f64();
        Lateness {
            cycles: self.wake.count(),
            missed: self.missed,
            p999_us: us(self.wake.quantile(0.999)),
            p9999_us: us(self.wake.quantile(0.9999)),
            max_us: us(self.wake.max()),
        }
    }
}

/// Wakes up every `period` for this number of cycles, and sends one frame each time if there is a link. `now` is the clock of the
/// metronome. `each` receives the result so far after every wake-up, on the thread that measures, and returns whether to go on.
pub fn measure_latency<L: CanLink, M: Metronome>(
    metronome: &mut M,
    now: impl Fn() -> Time,
    mut link: Option<&mut L>,
    period: Duration,
    cycles: u64,
    mut each: impl FnMut(&Latency) -> ControlFlow<()>,
) -> Latency {
    let mut latency = Latency::default();
    let mut grid = now() + period;
    let mut sent: Option<(Frame, Time)> = None;
    for cycle in 0..cycles {
        metronome.sleep_until(grid);
        let woke = now();
        latency.wake.add(woke.since(grid));
        if let Some(link) = &mut link {
            while let Some(arrival) = link.receive() {
                if let (Received::Echo(frame), Some((probe, at))) = (arrival.what, sent)
                    && frame == probe
                {
                    latency.round_trip.add(arrival.time.since(at));
                    sent = None;
                }
            }
            latency.lost += u64::from(sent.is_some());
            let frame = Frame::new(PROBE, &cycle.to_le_bytes());
            let at = now();
            sent = link.send(&frame).is_ok().then_some((frame, at));
            latency.lost += u64::from(sent.is_none());
        }
        let passed = now().since(grid).as_nanos() / period.as_nanos().max(1);
        latency.missed += passed as u64;
        if each(&latency).is_break() {
            break;
        }
        grid = grid + period * (passed.min(u128::from(u32::MAX - 1)) as u32 + 1);
    }
    latency
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;
    use std::rc::Rc;
    use yieldwall_fieldbus::canopen::BusId;
    use yieldwall_link::{Arrival, SendError};

    /// A computer that is late by a pattern, with a bus that echoes after 80 us.
    struct Pretended {
        now: Rc<Cell<Time>>,
        late_us: Vec<u64>,
        wakes: usize,
    }

    impl Metronome for Pretended {
        fn sleep_until(&mut self, moment: Time) {
            let late = self.late_us[self.wakes % self.late_us.len()];
            self.wakes += 1;
            self.now.set(moment.max(self.now.get()) + Duration::from_micros(late));
        }

        fn suspended(&self) -> Duration {
            Duration::ZERO
        }
    }

    struct Bus {
        now: Rc<Cell<Time>>,
        echo: Option<Arrival>,
        refuses: bool,
    }

    impl CanLink for Bus {
        fn now(&self) -> Time {
            self.now.get()
        }

        fn receive(&mut self) -> Option<Arrival> {
            self.echo.take()
        }

        fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
            if self.refuses {
                return Err(SendError::Full);
            }
            let time = self.now.get() + Duration::from_micros(80);
            self.echo = Some(Arrival { time, bus: BusId::FIRST, what: Received::Echo(*frame) });
            Ok(())
        }

        fn wait(&mut self, _until: Time) -> bool {
            self.echo.is_some()
        }
    }

    fn measured(late_us: &[u64], refuses: bool) -> Latency {
        let now = Rc::new(Cell::new(Time(0)));
        let mut computer = Pretended { now: Rc::clone(&now), late_us: late_us.to_vec(), wakes: 0 };
        let mut bus = Bus { now: Rc::clone(&now), echo: None, refuses };
        let period = Duration::from_millis(1);
        measure_latency(&mut computer, || now.get(), Some(&mut bus), period, 10_000, |_| ControlFlow::Continue(()))
    }

    #[test]
    fn tiers_follow_from_what_was_measured() {
        let judged = |latency: &Latency| [latency.lateness().tier(1000), latency.lateness().proven(1000)];
        let good = measured(&[5, 20, 40], false);
        assert_eq!((judged(&good), good.missed), ([Tier::A, Tier::B], 0));
        let long = Lateness { cycles: PROVING_CYCLES, ..good.lateness() };
        assert_eq!(long.proven(1000), Tier::A);
        assert_eq!(Lateness { missed: 1, ..long }.proven(1000), Tier::B);
        assert_eq!(Lateness { cycles: STOCK_CYCLES - 1, ..long }.proven(1000), Tier::C);
        let mut late_us = vec![20; 2000];
        late_us[1000] = 3000;
        let stock = measured(&late_us, false);
        assert_eq!(judged(&stock), [Tier::B; 2]);
        // Each such wake-up covers three more grid points, none of which is made up for.
        assert_eq!(stock.missed, 5 * 3);
        let late = measured(&[20, 600], false);
        assert_eq!(judged(&late), [Tier::C; 2]);
        // The same is little of a slower cycle, and only what was measured at one of 1 ms is known of it.
        assert_eq!([1300, 1000, 700].map(|period_us| late.lateness().tier(period_us)), [Tier::B, Tier::C, Tier::C]);
        assert_eq!(late.lateness().tier(100_000), Tier::A);
        assert_eq!(judged(&Latency::default()), [Tier::C; 2]);
    }

    #[test]
    fn every_frame_is_seen_or_lost() {
        let seen = measured(&[5], false);
        assert_eq!((seen.round_trip.count(), seen.lost), (9999, 0), "the last one is not waited for");
        assert_eq!(seen.round_trip.max(), Duration::from_micros(80));
        let refused = measured(&[5], true);
        assert_eq!((refused.round_trip.count(), refused.lost), (0, 10_000));
    }
}
