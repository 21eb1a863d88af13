//! Watchdogs with which a simulated drive monitors its master, as its profile describes.

use std::time::Duration;

use yieldwall_drives::profiles::{BuiltInWatch, Reaction, Servo, SetPointWatch, SyncWatch, TimeUnit, TimedObject};

use super::super::device::Unsigned;
use yieldwall_fieldbus::objects::{DictionaryError, ObjectDictionary};

/// How one thing is watched for.
#[derive(Clone, Copy, Debug)]
pub(super) enum Watch {
    /// It may stay away.
    None,
    /// By what the node itself watches: the event timers of the RPDOs.
    Node(Reaction),
    /// For so many interpolation periods.
    Periods { periods: u32, reaction: Reaction },
    /// For the time that an object holds; 0 switches the watch off.
    Object { time: Unsigned, unit: TimeUnit, reaction: Reaction },
}

/// The watches of a drive beside that for heartbeats.
#[derive(Clone, Copy, Debug)]
pub(super) struct Watches {
    pub(super) sync: Watch,
    pub(super) set_points: Watch,
}

impl Watches {
    pub(super) fn new(od: &ObjectDictionary, servo: &Servo) -> Result<Self, DictionaryError> {
        let sync = match &servo.watchdogs.sync {
            SyncWatch::None => Watch::None,
            SyncWatch::BuiltIn(watch) => Watch::built_in(watch),
            SyncWatch::Object(timed) => Watch::object(od, timed)?,
        };
        let set_points = match &servo.watchdogs.set_points {
            SetPointWatch::None => Watch::None,
            SetPointWatch::BuiltIn(watch) => Watch::built_in(watch),
            SetPointWatch::EventTimer { reaction, .. } => Watch::Node(*reaction),
            SetPointWatch::Object(timed) => Watch::object(od, timed)?,
        };
        Ok(Self { sync, set_points })
    }
}

impl Watch {
    /// One whose time nobody knows is none.
    fn built_in(watch: &BuiltInWatch) -> Self {
        let reaction = watch.reaction;
        watch.periods.map_or(Self::None, |periods| Self::Periods { periods, reaction })
    }

    fn object(od: &ObjectDictionary, timed: &TimedObject) -> Result<Self, DictionaryError> {
        let time = Unsigned::of(od, &timed.object)?;
        Ok(Self::Object { time, unit: timed.unit, reaction: timed.reaction })
    }

    /// How long what is watched for may stay away; `None` for as long as it likes.
    pub(super) fn wait(self, od: &ObjectDictionary, period_s: f64) -> Option<Duration> {
        let cycles = |number: u32| Duration::from_secs_f64(period_s * f64::from(number));
        match self {
            Watch::None | Watch::Node(_) => None,
            Watch::Periods { periods, .. } => Some(cycles(periods)),
            Watch::Object { time, unit, .. } => {
                let value = time.get(od);
                let wait = match unit {
                    TimeUnit::Us(unit) => Duration::from_micros(u64::from(value) * u64::from(unit)),
                    TimeUnit::Cycles => cycles(value),
                };
                (value > 0).then_some(wait)
            }
        }
    }

    /// Reaction of the drive when the message stays away for longer.
    pub(super) fn reaction(self) -> Reaction {
        match self {
            Watch::None => Reaction::Nothing,
            Watch::Node(reaction) | Watch::Periods { reaction, .. } | Watch::Object { reaction, .. } => reaction,
        }
    }
}
