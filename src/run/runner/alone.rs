//! Nothing is sent on a bus that has a master.

use std::time::Duration;

use super::Runner;
use crate::error::RunError;
use crate::place::Place;
use yieldwall_bus::ethercat::SegmentFailure;
use yieldwall_bus::{BootError, BootFailure, Master, Phase};
use yieldwall_fieldbus::time::Time;
use yieldwall_link::LinkOutbox;

/// How long a master that has sent its first heartbeat listens for that of another one, before it resets its nodes.
pub const ANNOUNCED: Duration = Duration::from_millis(50);

impl<P: Place + ?Sized> Runner<P> {
    /// Listens for another master before it sends anything that could disturb one; the first time for long. Frames from that time
    /// are not evidence about the time after the reset.
    pub(super) fn make_sure_to_be_alone(&mut self) -> Result<(), RunError> {
        if self.has_listened {
            // Since the network was left.
            self.check_alone()?;
            self.master.networks_mut().listen();
            self.drain();
            return self.check_alone();
        }
        self.master.networks_mut().listen();
        self.listen_until(self.now() + self.listening, |_, _, _| ())?;
        self.send_or_fail(|master, now, out| master.networks_mut().announce(now, out))?;
        self.listen_until(self.now() + ANNOUNCED, |master, now, out| {
            master.networks_mut().repeat_heartbeat(now, out);
        })?;
        self.has_listened = true;
        Ok(())
    }

    /// Takes all that comes before `until` or waits then, and sends what `send` does meanwhile.
    fn listen_until(
        &mut self,
        until: Time,
        send: impl Fn(&mut Master, Time, &mut LinkOutbox<'_, P>),
    ) -> Result<(), RunError> {
        let end = self.started + until.since(Time(0));
        loop {
            self.drain();
            self.check_alone()?;
            // What has come while this process was stopped is looked at as well.
            if self.now() >= until && !self.wait_until(end) {
                return Ok(());
            }
            self.send(&send);
            let until = end.min(self.place.now() + self.between_heartbeats());
            self.wait_until(until);
        }
    }

    /// Returns an error if another master was heard.
    pub(super) fn check_alone(&mut self) -> Result<(), RunError> {
        match self.master.networks().phase() {
            Phase::Failed(BootError { failure: BootFailure::OtherMaster { heard, has_sent }, .. }) => {
                self.has_listened = false;
                Err(RunError::OtherMaster { heard: *heard, has_sent: *has_sent })
            }
            Phase::Failed(error) if matches!(&error.failure, BootFailure::Segment(failure) if matches!(**failure, SegmentFailure::OtherMaster { .. })) =>
            {
                self.has_listened = false;
                Err(error.clone().into())
            }
            _ => Ok(()),
        }
    }
}
