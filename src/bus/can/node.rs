//! State of one node as the master sees it.

use std::time::Duration;

use super::boot::Boot;
use super::transfer::Transfer;
use crate::error::{BootFailure, Said};
use crate::phase::Phase;
use crate::setup::Waits;
use crate::turns::Turns;
use yieldwall_fieldbus::canopen::{BusId, Frame, NmtState, NodeId, Outbox, cob};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::guard::DeviceSet;

/// So many heartbeats of one node ...
const HEARTBEATS_OF_TWO: usize = 4;
/// ... within this many of its periods come from two nodes. A single node takes at least three periods less the delay of the
/// first heartbeat. That delay does not reach one and a quarter periods while every later heartbeat is in time: a bus that was
/// blocked for that long loses process data too.
const PERIODS_OF_TWO: f64 = 1.75;
/// More SDO answers than requests by so many are those of two nodes. CAN itself doubles a frame whose last bit is disturbed
/// (CAN 2.0, end of frame), but rarely.
const ANSWERS_OF_TWO: i32 = 3;
/// An SDO abort, which nobody answers (CiA 301).
const ABORT: u8 = 0x80;
/// Command specifier that begins an SDO download, segmented or expedited: the three highest bits ...
const DOWNLOAD: u8 = 1;
/// ... and by block, of which the lowest bit ends one (CiA 301).
const BLOCK_DOWNLOAD: u8 = 6;

#[derive(Clone)]
pub(super) struct Node {
    /// The bus that it is on.
    pub(super) bus: BusId,
    pub(super) id: NodeId,
    /// Devices of the rig that it is: one, or drives that are axes of one device.
    pub(super) devices: DeviceSet,
    /// Turns of its drives to ask for objects.
    pub(super) turns: Turns,
    pub(super) name: String,
    pub(super) transfer: Transfer,
    pub(super) boot: Boot,
    pub(super) has_booted: bool,
    /// Last messages of the node since the boot began.
    pub(super) said: Said,
    /// Whether its last heartbeat said Operational and is not too old.
    pub(super) is_operational: bool,
    /// Whether it restarted after it was configured: its watchdogs and limits are gone until the master starts anew.
    pub(super) has_restarted: bool,
    /// Period of its heartbeat.
    pub(super) heartbeat: Duration,
    /// How long it is waited for.
    waits: Waits,
    /// Shortest time in which one node sends [`HEARTBEATS_OF_TWO`] heartbeats.
    shortest: Duration,
    /// When its last heartbeats came, the oldest first.
    heard: [Option<Time>; HEARTBEATS_OF_TWO - 1],
    /// SDO requests of the master less the answers, as both were seen on the bus.
    unanswered: i32,
    /// Whether somebody else asks it too, so that its answers say nothing.
    has_other_client: bool,
    /// Whether another device uses its identifier.
    pub(super) is_double: bool,
    /// Whether somebody else wrote to it while the rig was enabled: its watchdogs and limits may be gone until the master
    /// starts anew.
    pub(super) is_altered: bool,
}

impl Node {
    pub(super) fn new(
        bus: BusId,
        id: NodeId,
        (devices, turns): (DeviceSet, Turns),
        name: &str,
        heartbeat: Duration,
        waits: Waits,
        boot: Boot,
    ) -> Self {
        Self {
            bus,
            id,
            devices,
            turns,
            name: name.to_owned(),
            transfer: Transfer::new(id, waits.sdo),
            boot,
            has_booted: false,
            said: Said::default(),
            is_operational: false,
            has_restarted: false,
            heartbeat,
            waits,
            shortest: heartbeat.mul_f64(PERIODS_OF_TWO),
            heard: [None; HEARTBEATS_OF_TWO - 1],
            unanswered: 0,
            has_other_client: false,
            is_double: false,
            is_altered: false,
        }
    }

    /// Whether it is this one.
    pub(super) fn is(&self, bus: BusId, id: NodeId) -> bool {
        (self.bus, self.id) == (bus, id)
    }

    /// Returns the step for which the master waits in this phase, and its time limit since the phase began; nothing if the node
    /// has done it. The node's [`Boot`] limits the time of each answer.
    pub(super) fn owes(&self, phase: &Phase) -> Option<(&'static str, Duration)> {
        match phase {
            Phase::Resetting if !self.has_booted => Some(("wait for the boot-up message", self.waits.boot_up)),
            Phase::Starting if !self.is_operational => Some(("start the node", self.waits.start)),
            _ => None,
        }
    }

    /// Forgets all that was heard of it.
    pub(super) fn restart(&mut self) {
        self.transfer.restart();
        self.turns.restart();
        self.boot.reset();
        self.said = Said::default();
        (self.has_booted, self.is_operational, self.has_restarted) = (false, false, false);
        (self.heard, self.is_double) = (Default::default(), false);
        (self.unanswered, self.has_other_client, self.is_altered) = (0, false, false);
    }

    /// Begins to configure it.
    pub(super) fn start_boot(&mut self, now: Time, out: &mut impl Outbox) -> Result<(), BootFailure> {
        self.boot.start(now, &mut self.transfer.client, &mut out.on(self.bus))
    }

    /// Begins to configure it anew, since it has restarted.
    pub(super) fn restart_boot(&mut self, now: Time, out: &mut impl Outbox) -> Result<(), BootFailure> {
        self.boot.restart(now, &mut self.transfer.client, &mut out.on(self.bus))
    }

    /// Brings its configuration forward when something is due.
    pub(super) fn poll_boot(&mut self, now: Time, out: &mut impl Outbox) -> Result<(), BootFailure> {
        self.boot.poll(now, &mut self.transfer.client, &mut out.on(self.bus))
    }

    /// Brings its configuration forward by a frame of its bus.
    pub(super) fn hear_boot(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) -> Result<(), BootFailure> {
        self.boot.on_frame(now, frame, &mut self.transfer.client, &mut out.on(self.bus))
    }

    /// When its configuration goes on.
    pub(super) fn boot_deadline(&self) -> Time {
        self.boot.next_deadline(&self.transfer.client)
    }

    /// Forgets when its heartbeats came.
    pub(super) fn forget_times(&mut self) {
        self.heard = Default::default();
    }

    /// Notes an own frame that was seen on its bus.
    pub(super) fn on_echo(&mut self, frame: &Frame) {
        if frame.id() == cob::sdo_request(self.id) && frame.data().first() != Some(&ABORT) {
            self.unanswered = self.unanswered.saturating_add(1);
        }
    }

    /// Notes an SDO answer of it, or a request of somebody else; `has_echo` says whether own requests are noted.
    pub(super) fn on_sdo(&mut self, frame: &Frame, has_echo: bool) {
        self.has_other_client |= frame.id() == cob::sdo_request(self.id);
        if has_echo && !self.has_other_client && frame.id() == cob::sdo_response(self.id) {
            self.unanswered = self.unanswered.saturating_sub(1);
            self.is_double |= self.unanswered <= -ANSWERS_OF_TWO;
        }
    }

    /// Whether a frame of somebody else begins to write to it, after it was configured.
    pub(super) fn is_written_by(&self, frame: &Frame) -> bool {
        let command = frame.data().first().copied().unwrap_or_default();
        let begins = command >> 5 == DOWNLOAD || (command >> 5 == BLOCK_DOWNLOAD && command & 1 == 0);
        begins && frame.id() == cob::sdo_request(self.id) && self.boot.is_done()
    }

    /// Notes a heartbeat, and whether it is one too many.
    pub(super) fn on_heartbeat(&mut self, now: Time, state: NmtState) {
        if state == NmtState::Initialising {
            self.heard = Default::default();
            return;
        }
        // A node that restarted waits for its start command; one that goes on is another one.
        self.is_double |= self.has_restarted && state == NmtState::Operational;
        let [oldest, later @ ..] = self.heard;
        self.is_double |= oldest.is_some_and(|oldest| now.since(oldest) <= self.shortest);
        let [second, third] = later;
        self.heard = [second, third, Some(now)];
    }
}
