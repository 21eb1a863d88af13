//! The loop for a real bus, on a cable in memory: the rig against the same simulated devices, on a clock of its own.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use hil_tests::{Scenario, cable::Cable};
use yieldwall::guard::{Fault, Request, State};
use yieldwall::live::{Ended, LiveRig, Play, Played};
use yieldwall::record::Row;
use yieldwall::rig::{DeviceServer, Enable, Enabling, Pace};

type Rig = LiveRig<Cable, Cable>;

fn wired(scenario: &Scenario, pace: Pace) -> (Cable, Rig) {
    let server = DeviceServer::new(&scenario.rig, &scenario.scene, scenario.seed, pace).unwrap();
    let cable = Cable::new(server);
    let rig = LiveRig::new(&scenario.rig, cable.clone(), cable.clone(), pace).unwrap();
    (cable, rig)
}

fn play(rig: &mut Rig, cycles: u64) -> (Played, Vec<Row>) {
    let mut rows = Vec::new();
    let play = Play { cycles, settling: 50 };
    let played = rig.play(&play, &AtomicBool::new(false), |record| rows.push(record.row())).unwrap();
    (played, rows)
}

/// The rig, enabled and run for `cycles` cycles.
fn running(scenario: &Scenario, pace: Pace, cycles: u32) -> (Cable, Rig) {
    let (cable, mut rig) = wired(scenario, pace);
    rig.boot().unwrap();
    let mut enabling = Enabling::new(scenario.period_s());
    while let Enable::Ask(request) = enabling.next(rig.state()) {
        rig.run_cycle(request);
    }
    for _ in 0..cycles {
        rig.run_cycle(Request::None);
    }
    assert_eq!(rig.state(), State::Running);
    (cable, rig)
}

fn deepest_mm(rows: &[Row]) -> f64 {
    rows.iter().filter(|row| row.is_on_surface).map(|row| 1e3 * row.signed_distance_m.abs()).fold(0.0, f64::max)
}

#[test]
fn the_scene_is_that_of_the_embedded_simulation_in_both_paces_and_modes() {
    for scenario in [Scenario::torque(), Scenario::position()] {
        let mut embedded = scenario.enabled();
        embedded.run(4000);
        for pace in [Pace::Lockstep, Pace::Free] {
            let (cable, mut rig) = wired(&scenario, pace);
            rig.boot().unwrap();
            let (played, rows) = play(&mut rig, 4000);
            let what = format!("{} {pace:?}: {played:?}", scenario.file);
            assert_eq!((played.ended, played.state, played.cause), (Ended::Whole, State::Running, None), "{what}");
            // The devices' clocks start at other moments: the same motion within a cycle, not the same bits.
            let farthest = rows.iter().zip(&embedded.rows).map(|(live, embedded)| {
                let [x, y] = [0, 1].map(|axis| live.proxy_m[axis] - embedded.proxy_m[axis]);
                x.hypot(y)
            });
            let farthest = farthest.fold(0.0, f64::max);
            assert!(farthest < 2e-3, "{what}: {farthest} m apart");
            assert!(rows.iter().any(|row| row.is_on_surface), "{what}: never on the surface");
            assert!((deepest_mm(&rows) - deepest_mm(&embedded.rows)).abs() < 1.0, "{what}");
            let counts = rig.counts();
            assert_eq!((counts.overflowed, counts.refused), (0, 0), "{what}");
            cable.look(|server| {
                assert!(server.drives().iter().all(|drive| drive.torque_n_m() == 0.0), "{what}");
                assert!(server.counts().syncs > 4000, "{what}");
            });
        }
    }
}
