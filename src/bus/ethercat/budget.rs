//! Whether a segment carries a rig: the frames of a cycle, how long they are on their way, and what they leave of it.
//!
//! ```text
//! 0              input frame is sent      -> back before the computation
//! compute_at     computation; the output frame is sent behind it
//!                                         -> at the last device before SYNC0, or before the next cycle
//! behind it      service frame            -> back before the next cycle
//! before SYNC0   the outputs once more    -> at the last device before SYNC0, of devices that act there
//! ```
//! A byte takes 80 ns, a device 1 us there and back. The time in which the computer wakes up and sends is not included: it must
//! fit into the rest of the cycle.

use std::time::Duration;

use super::flight::Purpose;
use super::setup::{Acts, SegmentSetup, StationSetup};
use super::{exchange, ports, repeat};
use crate::budget::PERIODS_US;
use yieldwall_fieldbus::ethercat::frame::{self, BYTE_NS, Command, DEVICE_NS};

/// Time that is counted for the computation of a cycle and for a device to take its outputs over.
const COMPUTING: Duration = Duration::from_micros(40);
/// Length of a mailbox that is counted with. Devices say theirs when they are asked, up to 1486 bytes.
pub(super) const MAILBOX: usize = 128;
/// Short periods that can be an answer, us.
const SHORT_PERIODS_US: [u64; 3] = [200, 250, 500];
/// Bytes of the system time.
const SYSTEM_TIME: usize = 8;

/// One datagram that is sent in every cycle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlannedDatagram {
    /// Command of the datagram.
    pub command: Command,
    /// The device that it is for; `None` if it is for all.
    pub device: Option<String>,
    /// Bytes of data.
    pub len: usize,
}

/// One frame of a cycle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlannedFrame {
    /// Purpose of the datagram.
    pub purpose: Purpose,
    /// Its datagrams, in their order.
    pub datagrams: Vec<PlannedDatagram>,
}

impl PlannedFrame {
    /// Bytes from the destination address to the last datagram, without padding.
    pub fn len(&self) -> usize {
        let each = |datagram: &PlannedDatagram| frame::DATAGRAM_HEADER + datagram.len + frame::WORKING_COUNTER;
        frame::HEADER + self.datagrams.iter().map(each).sum::<usize>()
    }

    /// Whether it has no datagram, and is not sent.
    pub fn is_empty(&self) -> bool {
        self.datagrams.is_empty()
    }

    /// Bytes on the wire: preamble, frame of at least 60 bytes, check sequence and the gap to the next one. 0 if it is not sent.
    pub fn wire_bytes(&self) -> usize {
        const AROUND: usize = frame::PREAMBLE + frame::CHECK_SEQUENCE + frame::GAP;
        if self.is_empty() { 0 } else { self.len().max(frame::SHORTEST) + AROUND }
    }

    /// Time on the wire in ns, the gap included.
    pub fn wire_ns(&self) -> u64 {
        self.wire_bytes() as u64 * BYTE_NS
    }

    /// Time from its first bit to its last one, in ns.
    fn duration_ns(&self) -> u64 {
        self.wire_ns().saturating_sub(frame::GAP as u64 * BYTE_NS)
    }
}

/// When a frame has done what it is sent for, and when it has to. Times count from the input frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameBudget {
    /// The frame.
    pub frame: PlannedFrame,
    /// When it is sent, in ns.
    pub sent_ns: u64,
    /// When it is back, of an output frame when the last device has it, in ns.
    pub done_ns: u64,
    /// The latest moment that is early enough for that, in ns.
    pub deadline_ns: u64,
}

impl FrameBudget {
    /// Time that is left, in ns; negative if it comes too late.
    pub fn left_ns(&self) -> i64 {
        self.deadline_ns as i64 - self.done_ns as i64
    }

    /// Whether it is in time.
    pub fn is_in_time(&self) -> bool {
        self.frame.is_empty() || self.left_ns() >= 0
    }
}

/// The frames of a cycle on a segment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Budget {
    /// Cycle time.
    pub period: Duration,
    /// Time from the input frame to the computation.
    pub compute_at: Duration,
    /// Time from SYNC0 to the input frame.
    pub sync0_phase: Duration,
    /// Devices that a frame passes: up to the last one of the rig.
    pub devices: usize,
    /// Whether outputs of a device act at SYNC0.
    pub has_sync0: bool,
    /// Input frame, output frame, the longest service frame, and the repeated outputs if there is room for them.
    pub frames: [FrameBudget; 4],
    /// Time before SYNC0, or before the next cycle, in which outputs that somebody else sends act, in ns.
    pub exposed_ns: u64,
    /// Time that output and service frame leave before the outputs act, in ns.
    room_ns: u64,
    /// Time from the first bit of the repeat to its last one at the last device, in ns.
    repeat_delay_ns: u64,
}

/// The least change with which everything is in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Advice {
    /// Period.
    pub period: Duration,
    /// Earliest and latest moment of the computation, in whole us.
    pub compute_at_us: [u64; 2],
}

impl Budget {
    /// The budget of a segment.
    pub fn new(setup: &SegmentSetup) -> Self {
        let stations = &setup.stations;
        let devices = stations.iter().map(|station| usize::from(station.position) + 1).max().unwrap_or(0);
        let has_sync0 = stations.iter().any(|station| station.acts == Acts::AtSync0);
        let [inputs, outputs, service, repeated] = frames(stations, devices);
        let [period, compute_at, phase] = [setup.period, setup.compute_at, setup.sync0_phase].map(nanoseconds);
        let there_and_back = devices as u64 * DEVICE_NS;
        let outputs_at = compute_at.saturating_add(nanoseconds(COMPUTING));
        let service_at = outputs_at.saturating_add(outputs.wire_ns());
        let back = |sent_ns: u64, frame: &PlannedFrame| sent_ns + frame.duration_ns() + there_and_back;
        let budget =
            |frame: PlannedFrame, sent_ns, done_ns, deadline_ns| FrameBudget { frame, sent_ns, done_ns, deadline_ns };
        let (inputs_back, service_back) = (back(0, &inputs), back(service_at, &service));
        let outputs_there = outputs_at + outputs.duration_ns() + there_and_back / 2;
        let repeat_delay_ns = repeated.duration_ns() + there_and_back / 2;
        let act_by = if has_sync0 { period.saturating_sub(phase) } else { period };
        let room_ns = act_by.saturating_sub(service_back);
        let lead_ns = repeat_delay_ns + nanoseconds(repeat::spare(setup.period));
        let is_repeated = !repeated.is_empty() && lead_ns <= room_ns;
        let repeated = if is_repeated { repeated } else { PlannedFrame { datagrams: Vec::new(), ..repeated } };
        let repeat_at = act_by.saturating_sub(lead_ns);
        Budget {
            period: setup.period,
            compute_at: setup.compute_at,
            sync0_phase: setup.sync0_phase,
            devices,
            has_sync0,
            frames: [
                budget(inputs, 0, inputs_back, compute_at),
                budget(outputs, outputs_at, outputs_there, act_by),
                budget(service, service_at, service_back, period),
                budget(repeated, repeat_at, repeat_at + repeat_delay_ns, act_by),
            ],
            exposed_ns: act_by.saturating_sub(if is_repeated { repeat_at } else { outputs_at }),
            room_ns,
            repeat_delay_ns,
        }
    }

    /// Whether every frame is in time.
    pub fn is_schedulable(&self) -> bool {
        self.frames.iter().all(FrameBudget::is_in_time)
    }

    /// The frame with the least time left. The repeat is none: it is sent as late as it may be.
    pub fn latest(&self) -> &FrameBudget {
        let [first, others @ .., _] = &self.frames;
        others.iter().fold(first, |least, other| if other.left_ns() < least.left_ns() { other } else { least })
    }

    /// Time that output and service frame leave before the outputs act.
    pub(super) fn room(&self) -> Duration {
        Duration::from_nanos(self.room_ns)
    }

    /// Time from the first bit of the repeat to its last one at the last device.
    pub(super) fn repeat_delay(&self) -> Duration {
        Duration::from_nanos(self.repeat_delay_ns)
    }

    /// Longest time from the SYNC0 at which inputs are sampled to the moment at which the matching outputs act. If outputs act at
    /// SYNC0, this is a period; otherwise it ends when the last device has the output frame.
    pub fn delay(&self) -> Duration {
        let [_, outputs, ..] = &self.frames;
        if self.has_sync0 { self.period } else { self.sync0_phase + Duration::from_nanos(outputs.done_ns) }
    }

    /// Share of the time that the frames take on the wire: 1 is all of it.
    pub fn load(&self) -> f64 {
        self.frames.iter().map(|each| each.frame.wire_ns() as f64).sum::<f64>() / self.period.as_nanos() as f64
    }

    /// Time that is counted for computing and for a device to take its outputs over.
    pub fn computing() -> Duration {
        COMPUTING
    }
}

/// The first that fits: another moment for the computation, then a longer period.
pub fn advise(setup: &SegmentSetup) -> Option<Advice> {
    let longer = SHORT_PERIODS_US.into_iter().chain(PERIODS_US).map(Duration::from_micros);
    let periods = [setup.period].into_iter().chain(longer.filter(|period| *period > setup.period));
    let fitting = periods.filter_map(|period| {
        let phase = setup.sync0_phase.as_nanos() * period.as_nanos() / setup.period.as_nanos().max(1);
        let sync0_phase = Duration::from_nanos(u64::try_from(phase).unwrap_or(u64::MAX));
        let at = |compute_at| Budget::new(&SegmentSetup { period, compute_at, sync0_phase, ..setup.clone() });
        let [inputs, outputs, service, _] = at(Duration::ZERO).frames;
        let latest_ns = outputs.left_ns().min(service.left_ns());
        let earliest_us = inputs.done_ns.div_ceil(1000).max(1);
        let latest_us = u64::try_from(latest_ns).ok()? / 1000;
        (earliest_us <= latest_us).then_some(Advice { period, compute_at_us: [earliest_us, latest_us] })
    });
    fitting.into_iter().next()
}

/// Input frame, output frame, the longest service frame, and the outputs of devices that act at SYNC0.
fn frames(stations: &[StationSetup], devices: usize) -> [PlannedFrame; 4] {
    let for_all = |command, len| PlannedDatagram { command, device: None, len };
    let of =
        |station: &StationSetup, command, len| PlannedDatagram { command, device: Some(station.name.clone()), len };
    let mut inputs = vec![for_all(Command::Frmw, SYSTEM_TIME)];
    for station in stations {
        let len = station.input_bytes();
        inputs.extend((len > 0).then(|| of(station, Command::Lrd, len)));
        inputs.push(of(station, Command::Fprd, exchange::STATUS_LEN));
    }
    let outputs = |is_meant: fn(&StationSetup) -> bool| {
        let stations = stations.iter().filter(|station| station.output_bytes() > 0 && is_meant(station));
        stations.map(|station| of(station, Command::Lwr, station.output_bytes())).collect()
    };
    let watched = ports::reads(devices).map(|len| for_all(Command::Fprd, len)).collect();
    let frame = |purpose, datagrams| PlannedFrame { purpose, datagrams };
    let mailbox = frame(Purpose::Service, vec![for_all(Command::Fpwr, MAILBOX)]);
    let ports = frame(Purpose::Service, watched);
    let service = if ports.len() > mailbox.len() { ports } else { mailbox };
    let repeated = frame(Purpose::Repeat, outputs(|station| station.acts == Acts::AtSync0));
    [frame(Purpose::Inputs, inputs), frame(Purpose::Outputs, outputs(|_| true)), service, repeated]
}

fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}
