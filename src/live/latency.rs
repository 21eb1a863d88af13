//! How late this computer wakes up, and how long a frame takes to the bus and back.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::histogram::Histogram;
use super::metronome::Metronome;
use crate::canopen::{Frame, Time};
use crate::link::{CanLink, Received};

/// Identifier of the frames that are sent: of the lowest priority, and none that CiA 301 lets a device use.
pub const PROBE: u16 = 0x7ff;
/// Cycles for which the highest tier has to be shown: 27.8 h at 1 kHz.
pub const PROVING_CYCLES: u64 = 100_000_000;

/// What was measured.
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

/// What a computer may be promised to keep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tier {
    /// Real-time: late by at most 100 us, by at most 50 us in 99.99 % of the cycles, and no cycle missed.
    A,
    /// A stock kernel: late by at most 500 us in 99.9 % of the cycles, and no maximum.
    B,
    /// Neither: simulation in virtual time only.
    C,
}

impl Latency {
    /// The tier whose bounds were kept. Tier A is shown only by [`PROVING_CYCLES`]; see [`Latency::is_proven`].
    pub fn tier(&self) -> Tier {
        let us = Duration::from_micros;
        if self.wake.count() == 0 {
            Tier::C
        } else if self.missed == 0 && self.wake.max() <= us(100) && self.wake.quantile(0.9999) <= us(50) {
            Tier::A
        } else if self.wake.quantile(0.999) <= us(500) {
            Tier::B
        } else {
            Tier::C
        }
    }

    /// Whether there were enough cycles for what the tier promises.
    pub fn is_proven(&self) -> bool {
        self.tier() != Tier::A || self.wake.count() >= PROVING_CYCLES
    }
}

/// Wakes up every `period` for so many cycles, and sends one frame each time if there is a link; `now` is the clock of the
/// metronome.
pub fn measure_latency<L: CanLink, M: Metronome>(
    metronome: &mut M,
    now: impl Fn() -> Time,
    mut link: Option<&mut L>,
    period: Duration,
    cycles: u64,
    is_over: &AtomicBool,
) -> Latency {
    let mut latency = Latency::default();
    let mut grid = now() + period;
    let mut sent: Option<(Frame, Time)> = None;
    for cycle in 0..cycles {
        if is_over.load(Ordering::Relaxed) {
            break;
        }
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
        grid = grid + period * (passed.min(u128::from(u32::MAX - 1)) as u32 + 1);
    }
    latency
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::{Arrival, SendError};
    use std::cell::Cell;
    use std::rc::Rc;

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
            self.echo = Some(Arrival { time, what: Received::Echo(*frame) });
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
        measure_latency(&mut computer, || now.get(), Some(&mut bus), period, 10_000, &AtomicBool::new(false))
    }

    #[test]
    fn tiers_follow_from_what_was_measured() {
        let good = measured(&[5, 20, 40], false);
        assert_eq!((good.tier(), good.is_proven(), good.missed), (Tier::A, false, 0));
        let mut late_us = vec![20; 2000];
        late_us[1000] = 3000;
        let stock = measured(&late_us, false);
        assert_eq!((stock.tier(), stock.is_proven()), (Tier::B, true));
        // Each such wake-up covers three more grid points, none of which is made up for.
        assert_eq!(stock.missed, 5 * 3);
        assert_eq!(measured(&[20, 600], false).tier(), Tier::C);
        assert_eq!(Latency::default().tier(), Tier::C);
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
