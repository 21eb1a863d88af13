//! Age of the force that a cycle of a rig uses, by the rig file's sensor and bus, and by identification.

use crate::RigError;
use yieldwall_bus::budget::{Budget, PlannedFrame, Use};
use yieldwall_config as config;
use yieldwall_motion::control::{Outer, Sampling};
use yieldwall_run::ForceFound;
use yieldwall_run::assembly::{bus_id, bus_plan, period_s, sampled_before};
use yieldwall_sim::SYNC_RATE_HZ;

/// Number of phases of a sensor's own clock that are computed.
const PHASES: u32 = 17;
/// Share of a cycle by which an identified age has to exceed the rig file's to count as different.
const OLDER_CYCLES: f64 = 0.05;

/// Effect of frames that wait on a bus on the samples of a sensor with its own clock. The computed masses leave this effect out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UnevenSamples {
    /// The sensor sends by its clock, and SYNC waits for its frames: then the drives sample and act late.
    SyncWaits,
    /// SYNC or a request has the newest sample sent, and a heartbeat that delays it decides now and then whether one is in time.
    SampleMissed,
}

/// Returns which of the two effects can happen on the rig's bus; `None` if SYNC triggers the sample.
pub fn uneven_samples(rig: &config::Rig) -> Option<UnevenSamples> {
    match rig.sensor.protocol {
        config::SensorProtocol::Canopen { .. } => (!is_sampled_at_sync(rig)).then_some(UnevenSamples::SampleMissed),
        config::SensorProtocol::Streaming { .. } => Some(UnevenSamples::SyncWaits),
        config::SensorProtocol::Polled { .. } => Some(UnevenSamples::SampleMissed),
        config::SensorProtocol::Ethercat { .. } => None,
    }
}

/// Whether the sensor takes its samples at SYNC.
pub fn is_sampled_at_sync(rig: &config::Rig) -> bool {
    matches!(rig.sensor.protocol, config::SensorProtocol::Canopen { .. })
        && *rig.sensor.sample_rate_hz == f64::from(SYNC_RATE_HZ)
}

/// Returns the force paths with the oldest samples that the sensor's clock can make the cycle use. If frames decide which sample
/// that is, it returns one path for the shortest and one for the longest frames.
pub(super) fn outers(rig: &config::Rig) -> Result<Vec<Outer>, RigError> {
    let period_s = period_s(rig);
    let interval_s = rig.sensor.sample_rate_hz.get().recip();
    let own_clock = |latest_s: f64| Sampling { interval_s, oldest_s: interval_s - latest_s, phases: PHASES };
    let samplings = match rig.sensor.protocol {
        config::SensorProtocol::Canopen { .. } if is_sampled_at_sync(rig) => vec![Sampling::at_sync(period_s)],
        // SYNC has the newest sample of the sensor's own clock sent.
        config::SensorProtocol::Canopen { .. } => vec![own_clock(0.0)],
        // The input frame takes the newest one along, some time after SYNC0, at which the drives act.
        config::SensorProtocol::Ethercat { .. } => vec![own_clock(sampled_before(rig).as_secs_f64())],
        config::SensorProtocol::Streaming { .. } | config::SensorProtocol::Polled { .. } => {
            let mut latest_s = latest_samples_s(rig)?.to_vec();
            latest_s.dedup();
            latest_s.into_iter().map(own_clock).collect()
        }
    };
    let outer = |sampling| Outer {
        period_s,
        sampling,
        // More than one sample in a cycle cannot be seen.
        low_pass: rig.sensor.low_pass_hz.map(|cut_off_hz| (cut_off_hz.get(), interval_s.max(period_s))),
        damping_n_s_per_m: 0.0,
        handle_kg: rig.sensor.handle_mass_kg.get(),
        compensation: None,
    };
    Ok(samplings.into_iter().map(outer).collect())
}

/// Returns the latest moment after the end of SYNC, in s, at which a sensor on plain CAN may take a sample that the same cycle
/// still uses. It returns one value for the shortest and one for the longest frames, since the number of stuff bits depends on the
/// data. A negative value means before SYNC. The values hold for the regular course of the bus: they ignore a heartbeat that makes
/// one sample late now and then.
fn latest_samples_s(rig: &config::Rig) -> Result<[f64; 2], RigError> {
    let bus = bus_id(rig, &rig.sensor.bus)?;
    let (setup, conditions) = bus_plan(rig)?;
    let conditions = conditions.into_iter().find(|conditions| conditions.bus == bus);
    let conditions = conditions.ok_or(RigError::NoPlan)?;
    let budget = Budget::new(&setup, conditions)?;
    let frames = || budget.frames.iter().map(|budgeted| &budgeted.frame);
    let request = frames().find(|frame| frame.usage == Use::Request);
    // Behind SYNC the devices of SYNC answer, and the request waits for those that go before it.
    let goes_first = |frame: &&PlannedFrame| match frame.usage {
        Use::Sync => true,
        Use::Measured if !frame.is_answer => request.is_none_or(|request| frame.cob_id < request.cob_id),
        _ => false,
    };
    let takes_time = rig.frames_take_time();
    let latest_s = |bits: &dyn Fn(&PlannedFrame) -> u32| {
        let duration_s = |frame: &PlannedFrame| match takes_time {
            true => f64::from(bits(frame)) / f64::from(conditions.bit_rate),
            false => 0.0,
        };
        let first_s: f64 = frames().filter(goes_first).map(duration_s).sum();
        // The drives act when SYNC is over; the computation is planned from its begin.
        let sync_s: f64 = frames().filter(|frame| frame.usage == Use::Sync).map(duration_s).sum();
        if let Some(request) = request {
            return first_s + duration_s(request) - sync_s;
        }
        let sample_s: f64 = frames().filter(|frame| frame.usage == Use::Streamed).map(duration_s).sum();
        let latest_s = f64::from(rig.cycle.compute_at_us) * 1e-6 - sample_s;
        // Where the bus is not free again in time, the sample has to go before SYNC.
        (if latest_s >= first_s { latest_s } else { -sample_s }) - sync_s
    };
    Ok([latest_s(&PlannedFrame::bits_shortest), latest_s(&|frame| frame.bits(conditions.is_plain()))])
}

/// Returns the range of the mean age of the force by the rig file's sensor and bus, in s before the sample of the angles of its
/// cycle. A sensor with its own clock may keep any phase to the cycle.
///
/// # Errors
/// If the bus has no plan.
pub fn believed_age_s(rig: &config::Rig) -> Result<[f64; 2], RigError> {
    let of = |outer: &Outer| {
        let sampling = outer.sampling;
        if sampling.phases == 1 {
            return [sampling.oldest_s; 2];
        }
        let middle_s = sampling.oldest_s - 0.5 * sampling.interval_s;
        let half_s = 0.5 * sampling.interval_s.min(outer.period_s);
        [middle_s - half_s, middle_s + half_s]
    };
    let ages = outers(rig)?;
    Ok(ages
        .iter()
        .map(of)
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], [low, high]| [least.min(low), most.max(high)]))
}

/// Returns by how much the force may be older than in the rig file, s. It is 0 if the identified age does not contradict the file,
/// and if the force is younger.
///
/// # Errors
/// As [`believed_age_s`].
pub fn later_s(rig: &config::Rig, force: &ForceFound) -> Result<f64, RigError> {
    later_between_s(rig, force).map(|[_, most]| most)
}

/// Returns the least and the most by which the force may be older, s: an older force does not ask for more mass everywhere.
pub(super) fn later_between_s(rig: &config::Rig, force: &ForceFound) -> Result<[f64; 2], RigError> {
    let [least, most] = believed_age_s(rig)?;
    let [low, high] = force.between_s;
    Ok(if low > most + OLDER_CYCLES * period_s(rig) { [low - most, high - least] } else { [0.0; 2] })
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use super::*;
    use crate::EmbeddedRig;
    use yieldwall_config::Source;
    use yieldwall_motion::guard::Request;

    #[test]
    fn a_polled_sensor_takes_its_sample_when_the_request_has_come_to_drives_that_sync_has_reached() {
        let loaded = config::load_rig(Source::named("builtin:paper-admittance-polled.yaml")).unwrap();
        let scene = loaded.scene().unwrap().value;
        let rig = loaded.value;
        let config::SensorProtocol::Polled { base_id, .. } = rig.sensor.protocol else { panic!("it is polled") };
        let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, 1).unwrap();
        machine.enable().unwrap();
        let ends = Arc::new(Mutex::new(Vec::new()));
        let seen = Arc::clone(&ends);
        machine.set_witness(Box::new(move |passage| {
            seen.lock().unwrap().push((passage.sent.id(), passage.time));
        }));
        (0..20).for_each(|_| _ = machine.run_cycle(Request::None).unwrap());
        let ends = ends.lock().unwrap();
        let mut sync = None;
        let mut between_s = Vec::new();
        for (id, end) in ends.iter() {
            match (*id, sync) {
                (0x080, _) => sync = Some(*end),
                (id, Some(begun)) if id == base_id => between_s.push(end.since(begun).as_secs_f64()),
                _ => {}
            }
        }
        // In the run frames have as many stuff bits as their data give. The plan counts an interframe space more.
        let [shortest_s, longest_s] = latest_samples_s(&rig).unwrap();
        assert!(between_s.len() > 10);
        for took_s in between_s {
            assert!((shortest_s - 3e-6..=longest_s).contains(&took_s), "{shortest_s} to {longest_s}: {took_s}");
        }
    }

    #[test]
    fn a_force_counts_as_older_where_it_contradicts_the_file_alone() {
        let shipped = |file| config::load_rig(config::builtin(file)).unwrap().value;
        let rig = &shipped("paper-admittance.yaml");
        assert_eq!(believed_age_s(rig).unwrap(), [0.0; 2]);
        let later = |between_s| later_s(rig, &ForceFound { between_s, mass_kg: 0.3 }).unwrap();
        assert_eq!([later([-0.01e-3, 1.01e-3]), later([-0.9e-3, -0.2e-3])], [0.0; 2]);
        assert_eq!(later([1.9e-3, 2.1e-3]), 2.1e-3);
        let streaming = shipped("paper-admittance-streaming.yaml");
        let [least, most] = believed_age_s(&streaming).unwrap();
        assert!(most - least >= 1e-3, "its clock may stand at any phase: {least} {most}");
    }
}
