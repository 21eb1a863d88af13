//! Two masters on one cable that begin at any moments of each other: at most one of them enables the rig, and the other resets
//! nothing.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use hil_tests::Scenario;
use hil_tests::cable::permit;
use hil_tests::shared_cable::{DELAY, Plug, SharedCable};
use yieldwall::bus::{LISTENING, Sign};
use yieldwall::canopen::{Frame, cob};
use yieldwall::live::serve;
use yieldwall::rig::DeviceServer;
use yieldwall::run::{Ended, Pace, Play, Played, RunError, Runner};
use yieldwall::time::Time;

/// Cycles of a master that runs: more than it takes to boot.
const CYCLES: u64 = 300;
/// The first master begins then.
const FIRST: Time = Time(1_000_000_000);

/// Who is who on the cable.
const DEVICES: usize = 0;
const MASTERS: [usize; 2] = [1, 2];

fn master(plug: Plug, pace: Pace) -> Result<Played, RunError> {
    let _turn = plug.begin();
    let mut rig = Runner::on_link(&Scenario::torque().rig, plug.clone(), plug, pace)?;
    let play = Play { cycles: CYCLES, settling: 70 };
    let result = rig.boot().and_then(|()| {
        let permit = permit(&rig);
        rig.play(&play, &permit, &AtomicBool::new(false), |_| ())
    });
    // As the program does, whatever has happened.
    rig.leave();
    result
}

fn devices(plug: Plug, pace: Pace, is_over: &AtomicBool) {
    let scenario = Scenario::torque();
    let mut server = DeviceServer::new(&scenario.rig, &scenario.scene, scenario.seed, pace).unwrap();
    let mut link = plug.clone();
    let _turn = plug.begin();
    serve(&mut server, &mut link, is_over, |_| ()).unwrap();
}

/// What becomes of both.
type Outcomes = [Result<Played, RunError>; 2];

/// What becomes of both, the second of which begins so much later, and what was sent by whom.
fn meet(pace: Pace, later: Duration) -> (Outcomes, Vec<(usize, Frame)>) {
    let (cable, plugs) = SharedCable::new(&[Time(0), FIRST, FIRST + later]);
    let [for_devices, first, second] = <[Plug; 3]>::try_from(plugs).unwrap_or_else(|_| unreachable!());
    let (is_over, ended) = (AtomicBool::new(false), AtomicUsize::new(0));
    let results = std::thread::scope(|scope| {
        scope.spawn(|| devices(for_devices, pace, &is_over));
        let run = |plug: Plug| {
            let result = master(plug, pace);
            is_over.store(ended.fetch_add(1, Ordering::SeqCst) + 1 == MASTERS.len(), Ordering::SeqCst);
            result
        };
        let masters = [first, second].map(|plug| scope.spawn(move || run(plug)));
        masters.map(|master| master.join().unwrap())
    });
    (results, cable.log().into_iter().map(|(_, who, frame)| (who, frame)).collect())
}

fn sent_by(log: &[(usize, Frame)], who: usize) -> impl Iterator<Item = &Frame> {
    log.iter().filter(move |(by, _)| *by == who).map(|(_, frame)| frame)
}

fn is_refused(result: &Result<Played, RunError>, had_sent: bool) -> bool {
    matches!(result, Err(RunError::OtherMaster { has_sent, .. }) if *has_sent == had_sent)
}

#[test]
fn a_master_that_begins_later_sends_nothing_and_the_first_one_runs_to_its_end() {
    for pace in [Pace::Free, Pace::Lockstep] {
        // While the first one listens, announces itself, resets, configures, starts, enables and runs.
        for later_us in [200, 1_000, 20_000, 49_000, 51_000, 60_000, 100_000, 300_000, 900_000, 1_000_000, 1_100_000] {
            let ([first, second], log) = meet(pace, Duration::from_micros(later_us));
            let what = format!("{pace:?}, {later_us} us later: {first:?} {second:?}");
            assert!(matches!(first, Ok(Played { ended: Ended::Whole, cause: None, .. })), "{what}");
            assert!(is_refused(&second, false), "{what}");
            assert_eq!(sent_by(&log, MASTERS[1]).count(), 0, "{what}");
        }
    }
}

#[test]
fn of_two_that_begin_at_the_same_moment_neither_resets_or_enables_anything() {
    for pace in [Pace::Free, Pace::Lockstep] {
        for later_us in [0, 1, 50, 99] {
            assert!(Duration::from_micros(later_us) < DELAY);
            let (results, log) = meet(pace, Duration::from_micros(later_us));
            let what = format!("{pace:?}, {later_us} us later: {results:?}");
            assert!(results.iter().all(|result| is_refused(result, true)), "{what}");
            for result in &results {
                let Err(RunError::OtherMaster { heard, .. }) = result else { unreachable!() };
                assert_eq!(heard.sign, Sign::Master { node_id: 127 }, "{what}");
            }
            for master in MASTERS {
                // Its heartbeat, and nothing that moves or resets anybody.
                assert!(sent_by(&log, master).all(|frame| cob::is_heartbeat(frame.id())), "{what}");
                assert_eq!(sent_by(&log, master).count(), 1, "{what}");
            }
            // They were switched on, and nothing happened to them.
            assert_eq!(sent_by(&log, DEVICES).count(), 3, "{what}");
        }
    }
}

#[test]
fn a_master_that_begins_after_the_end_of_the_other_runs() {
    let later = LISTENING * 4;
    let (results, log) = meet(Pace::Lockstep, later);
    assert!(results.iter().all(|result| matches!(result, Ok(Played { ended: Ended::Whole, .. }))), "{results:?}");
    let commands = |who| sent_by(&log, who).filter(|frame| frame.id() == cob::NMT).map(|frame| frame.data().to_vec());
    for master in MASTERS {
        // A reset, a start and a farewell for each node of the rig, and no other node is told anything.
        let expected = [[0x81, 1], [0x81, 2], [0x81, 10], [1, 1], [1, 2], [1, 10], [0x80, 1], [0x80, 2], [0x80, 10]];
        assert!(commands(master).eq(expected), "{:x?}", commands(master).collect::<Vec<_>>());
    }
}
