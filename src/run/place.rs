//! Place where a rig runs: a clock, and its buses.

use std::time::Duration;

use super::metronome::Metronome;
use yieldwall_fieldbus::canopen::Frame;
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{Arrival, CanLink, EthernetArrival, SendError, Wires};
use yieldwall_motion::cycle::Outputs;
use yieldwall_motion::quantity::{Force, JointAngles, TipPoint};
use yieldwall_record::Truth;

/// Whether the process that runs the loop can run a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Process {
    /// It can.
    Runs,
    /// It is stopped for this period, and knows afterwards that a grid point has passed.
    Stopped,
    /// The computer is suspended for this period, and so is its clock.
    Suspended,
    /// It never runs again.
    Dead,
}

/// Task for a person at the arm. The network is left meanwhile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Task {
    /// Let this force in N, in the base frame, pull at the tool, or remove it if the force is zero.
    Pull(Force),
    /// Lead the tool to this point of the base frame; the first number counts from 0.
    LeadTo(usize, TipPoint),
}

/// A clock and the buses of a rig: those of a computer ([`OnLink`]), or simulated ones.
pub trait Place: Wires {
    /// Lets time pass up to a moment of [`CanLink::now`]; returns at once if that has passed. In virtual time it ends before, where
    /// something has come to be received, or at `deadline`, each when all that happens up to then has happened.
    ///
    /// Real-time: yes.
    fn sleep_until(&mut self, moment: Time, deadline: Time);

    /// Begins a cycle at its grid point, and returns whether the process can run it. The loop calls it only in virtual time, since
    /// a process that is stopped cannot ask.
    fn begin_cycle(&mut self, _grid: Time) -> Process {
        Process::Runs
    }

    /// Whether a person has asked for a stop; each request counts once. The loop calls it only in virtual time.
    fn takes_stop(&mut self) -> bool {
        false
    }

    /// Returns how long the computer was suspended since it was switched on; [`CanLink::now`] stood still meanwhile.
    ///
    /// Real-time: yes.
    fn suspended(&self) -> Duration;

    /// Notes that a cycle was computed and that its set-points have not been sent. In virtual time the computation takes the time
    /// that the simulation sets; on a computer that time has passed already.
    ///
    /// Real-time: yes.
    fn computed(&mut self, _outputs: &Outputs) {}

    /// Drops the frames that the master's interfaces have not sent yet, since the master has fallen silent. A link of a computer
    /// cannot take them back.
    ///
    /// Real-time: yes.
    fn drop_queue(&mut self) {}

    /// Returns the state of the machine that a simulation knows and no device reports.
    ///
    /// Real-time: yes.
    fn truth(&self) -> Option<Truth> {
        None
    }

    /// Makes a person at a simulated arm do this task, and returns whether it was done. On a computer it does nothing.
    fn attend(&mut self, _task: Task) -> bool {
        false
    }

    /// Makes a person at a simulated arm switch the drives off and on again, and returns whether it was done.
    fn power_cycle(&mut self) -> bool {
        false
    }

    /// Returns the angles of the joints as a person at a simulated arm sees them.
    fn seen_angles(&self) -> Option<JointAngles> {
        None
    }
}

/// A place in which time is simulated and no real drive listens. Nobody else is on its buses, and no time passes while the loop
/// computes. The loop takes every frame at the moment of its arrival; elsewhere it looks at two moments of a cycle. A
/// [`Permit`](super::Permit) for such a place needs no proof, so no place that reaches a real bus may be one: the compiler refuses
/// a place by the wall clock.
///
/// ```compile_fail
/// use yieldwall_run::{OnLink, VirtualPlace};
///
/// impl<L, M> VirtualPlace for OnLink<L, M> where OnLink<L, M>: yieldwall_run::Place {}
/// ```
pub trait VirtualPlace: Place {}

/// A computer: a link to its buses, and a metronome on the same clock.
#[derive(Debug)]
pub struct OnLink<L, M> {
    /// The link.
    pub link: L,
    /// Timer that wakes the loop.
    pub metronome: M,
}

impl<L: CanLink, M> CanLink for OnLink<L, M> {
    fn now(&self) -> Time {
        self.link.now()
    }

    fn receive(&mut self) -> Option<Arrival> {
        self.link.receive()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        self.link.send(frame)
    }

    fn wait(&mut self, until: Time) -> bool {
        self.link.wait(until)
    }
}

impl<L: Wires, M> Wires for OnLink<L, M> {
    fn source(&self) -> [u8; 6] {
        self.link.source()
    }

    fn receive_ethernet(&mut self, buffer: &mut [u8]) -> Option<EthernetArrival> {
        self.link.receive_ethernet(buffer)
    }

    fn send_ethernet(&mut self, bytes: &[u8]) -> Result<(), SendError> {
        self.link.send_ethernet(bytes)
    }
}

impl<L: Wires, M: Metronome> Place for OnLink<L, M> {
    fn sleep_until(&mut self, moment: Time, _: Time) {
        self.metronome.sleep_until(moment);
    }

    fn suspended(&self) -> Duration {
        self.metronome.suspended()
    }
}
