//! The checker finds each violation in a run that is sound except for one doctored value.

use super::super::draw::{Machine, Shipped};
use super::super::excuse::Excuse;
use super::super::invariant::{Invariant, Violation};
use super::super::observation::{Observation, Sender, Sighting};
use super::super::segment::OnCable;
use super::super::session::{Course, play_watched};
use super::{Checker, Limits};
use yieldwall_config::Rig;
use yieldwall_fieldbus::canopen::Frame;
use yieldwall_motion::elementary;
use yieldwall_motion::guard::{Request, State};

/// Cycles of the runs: the rig is enabled and moves.
const CYCLES: u32 = 1500;

/// A run that is sound.
struct Run {
    limits: Limits,
    seen: Vec<Observation>,
}

/// Runs the rig of `file`; the seed is one whose hand keeps the proxy moving.
fn sound(file: &str) -> Run {
    sound_on(file, |rig| !Rig::is_on_ethercat(rig))
}

/// Returns a sound run on buses of a kind.
fn sound_on(file: &str, is_meant: impl Fn(&Rig) -> bool) -> Run {
    let shipped = Shipped::load().unwrap();
    let play = |seed| {
        let machine = Machine::draw(&shipped, seed);
        let is_wanted = machine.file == file && machine.rig.fixture.hold_steps == 0 && is_meant(&machine.rig);
        if !is_wanted {
            return None;
        }
        let mut seen = Vec::new();
        play_watched(&Course { machine: &machine, script: &[], seed, cycles: CYCLES }, |observation| {
            seen.push(observation.clone());
        });
        let run = Run { limits: Limits::of(&machine.rig), seen };
        run.first_moving().is_some().then_some(run)
    };
    (0..200).find_map(play).expect("a seed whose hand keeps the proxy moving")
}

fn torque() -> Run {
    sound("paper-admittance.yaml")
}

fn position() -> Run {
    sound("paper-admittance-csp.yaml")
}

impl Run {
    fn found(&self) -> Vec<Violation> {
        self.judged().0
    }

    /// Returns the violations, and how often `excuse` was counted for `invariant`.
    fn excused(&self, invariant: Invariant, excuse: Excuse) -> (Vec<Violation>, u64) {
        let (found, checker) = self.judged();
        let name = format!("{} {}", invariant.name(), excuse.name());
        (found, checker.excused().by_name().get(&name).copied().unwrap_or(0))
    }

    fn judged(&self) -> (Vec<Violation>, Checker) {
        let mut checker = Checker::new(self.limits, State::Idle);
        let mut found = Vec::new();
        for seen in &self.seen {
            checker.check(seen, &mut found);
        }
        (found, checker)
    }

    /// The first cycle in which the rig runs.
    fn running(&self) -> usize {
        self.seen.iter().position(|seen| seen.state == State::Running).unwrap()
    }

    /// A cycle well within the run in which the proxy moves.
    fn moving(&self) -> usize {
        self.first_moving().expect("the proxy moves")
    }

    fn first_moving(&self) -> Option<usize> {
        let speed = |at: usize| {
            let [now, before] = [self.seen[at].reported.proxy_m, self.seen[at - 1].reported.proxy_m];
            elementary::hypot(now[0] - before[0], now[1] - before[1]) / self.limits.period_s
        };
        let start = self.running() + 100;
        (start..self.seen.len() - 100).find(|at| (0..5).all(|step| speed(at + step) > 0.01))
    }

    /// The set-point of joint `joint` that was computed in the cycle before `at`.
    fn set_point(&mut self, at: usize, joint: usize) -> &mut Sighting {
        let id = self.limits.set_point_ids[joint];
        let frames = &mut self.seen[at].frames;
        frames.iter_mut().find(|seen| seen.sender == Some(Sender::Master) && seen.frame.id() == id).unwrap()
    }

    fn change_set_point(&mut self, at: usize, joint: usize, change: impl Fn(&mut [u8])) {
        let sighting = self.set_point(at, joint);
        let mut data = sighting.frame.data().to_vec();
        change(&mut data);
        sighting.frame = Frame::new(sighting.frame.id(), &data);
    }

    /// Changes the statusword in the frame from drive `joint` in cycle `at`.
    fn change_statusword(&mut self, at: usize, joint: usize, word: u16) {
        self.change_status(at, joint, |data| data[..2].copy_from_slice(&word.to_le_bytes()));
    }

    fn change_status(&mut self, at: usize, joint: usize, change: impl Fn(&mut [u8])) {
        let place = self.status_place(at, joint);
        let status = &mut self.seen[at].frames[place];
        let mut data = status.frame.data().to_vec();
        change(&mut data);
        status.frame = Frame::new(status.frame.id(), &data);
    }

    /// Where the first that arrived from drive `joint` in cycle `at` stands among the frames.
    fn status_place(&self, at: usize, joint: usize) -> usize {
        let id = self.limits.status_ids[joint];
        let is_it = |seen: &Sighting| seen.sender.is_none() && seen.frame.id() == id;
        self.seen[at].frames.iter().position(is_it).unwrap()
    }
}

/// Adds to the position or target in the last four bytes.
fn add_counts(data: &mut [u8], counts: i32) {
    let value = i32::from_le_bytes(data[2..6].try_into().unwrap());
    data[2..6].copy_from_slice(&value.wrapping_add(counts).to_le_bytes());
}

#[track_caller]
fn expect_found(run: &Run, invariant: Invariant, cycle: usize) {
    let found = run.found();
    let cycle = run.seen[cycle].cycle;
    let is_there = |found: &Violation| found.invariant == invariant && (cycle..=cycle + 1).contains(&found.cycle);
    assert!(found.iter().any(is_there), "{invariant:?} in {cycle}: {found:?}");
}

#[test]
fn a_sound_run_has_no_violation() {
    for file in super::super::RIGS {
        assert_eq!(sound(file).found(), []);
        assert_eq!(sound_on(file, Rig::is_on_ethercat).found(), []);
    }
}

/// The torque rig on EtherCAT.
fn on_cable() -> Run {
    sound_on("paper-admittance.yaml", Rig::is_on_ethercat)
}

impl Run {
    /// Changes the content of the cable in cycle `at`.
    fn change_on_cable(&mut self, at: usize, change: impl Fn(&mut OnCable)) {
        self.seen[at].on_cable.iter_mut().for_each(|passed| change(&mut passed.what));
    }
}

#[test]
fn on_a_cable_a_torque_for_a_drive_that_is_not_enabled() {
    let mut run = on_cable();
    let at = run.moving();
    run.change_on_cable(at, |what| {
        if let OnCable::Inputs([Some(left), _]) = what {
            left.statusword = 0x1633;
        }
    });
    expect_found(&run, Invariant::MovesEnabled, at + 1);
}

#[test]
fn on_a_cable_one_axis_goes_on_alone() {
    let mut run = on_cable();
    let at = run.moving();
    run.change_on_cable(at, |what| {
        if let OnCable::Outputs([_, Some(right)]) = what {
            right.controlword = 0x02;
        }
    });
    expect_found(&run, Invariant::Together, at);
}

#[test]
fn on_a_cable_an_input_that_did_not_come_and_outputs_that_were_not_taken() {
    let doctored = |change: fn(&mut OnCable)| {
        let mut run = on_cable();
        let at = run.moving();
        run.change_on_cable(at, change);
        expect_found(&run, Invariant::FreshInput, at);
    };
    doctored(|what| {
        if let OnCable::Inputs([_, right]) = what {
            *right = None;
        }
    });
    doctored(|what| {
        if let OnCable::Taken([left, _]) = what {
            *left = false;
        }
    });
}

#[test]
fn on_a_cable_nothing_is_enabled_that_nobody_has_asked_for() {
    let mut run = on_cable();
    let at = run.running();
    run.seen.iter_mut().for_each(|seen| seen.request = Request::None);
    let found = run.found();
    let is_early = |found: &&Violation| found.invariant == Invariant::AskedFor && found.cycle <= run.seen[at].cycle;
    assert!(found.iter().any(|found| is_early(&found)), "{found:?}");
}

#[test]
fn i1_a_torque_for_a_drive_that_is_not_enabled() {
    let mut run = torque();
    let at = run.moving();
    // Switched On.
    run.change_statusword(at, 1, 0x1633);
    expect_found(&run, Invariant::MovesEnabled, at + 1);
}

/// Nothing from a drive in one cycle, and two reports in the next: the master takes the second, since the first was owed.
#[test]
fn i1_i9_of_two_reports_after_none_either_may_be_the_one_that_counts() {
    for mut run in [torque(), position()] {
        let at = run.moving();
        let place = run.status_place(at, 1);
        run.seen[at].frames.remove(place);
        let place = run.status_place(at + 1, 1);
        let second = run.seen[at + 1].frames[place];
        run.change_statusword(at + 1, 1, 0x1235);
        run.seen[at + 1].frames.insert(place + 1, second);
        assert_eq!(
            run.excused(Invariant::MovesEnabled, Excuse::ReportedTwice),
            (Vec::new(), 2),
            "{:?}",
            run.limits.mode
        );
        // It is still the last one where the next cycle brings none.
        let next = run.status_place(at + 2, 1);
        let third = run.seen[at + 2].frames.remove(next);
        assert_eq!(run.excused(Invariant::MovesEnabled, Excuse::ReportedTwice).0, Vec::new(), "{:?}", run.limits.mode);
        run.seen[at + 2].frames.insert(next, third);
        run.seen[at + 1].frames.remove(place + 1);
        expect_found(&run, Invariant::MovesEnabled, at + 2);
    }
}

#[test]
fn i2_a_target_that_leaps() {
    let mut run = position();
    let at = run.moving();
    run.change_set_point(at, 0, |data| data[4] = data[4].wrapping_add(1));
    expect_found(&run, Invariant::BoundedMotion, at);
}

/// If a drive comes to Operation Enabled a cycle later, it gets the position of its joint twice. A hand turns that joint by 9.4
/// rad/s.
#[test]
fn i2_a_target_that_follows_a_joint_before_the_drives_are_enabled() {
    let delayed = || {
        let mut run = position();
        let at = run.running();
        (0..2).for_each(|joint| run.change_statusword(at, joint, 0x1233));
        (run, at)
    };
    let (mut run, at) = delayed();
    run.change_status(at - 1, 0, |data| add_counts(data, -1200));
    run.change_set_point(at, 0, |data| add_counts(data, -1200));
    let (found, times) = run.excused(Invariant::BoundedMotion, Excuse::Follows);
    assert!(found.iter().all(|found| found.invariant != Invariant::BoundedMotion), "{found:?}");
    assert_eq!(times, 1);
    // One that nobody told, and faster than the guard lets a joint turn.
    let (mut run, at) = delayed();
    run.change_set_point(at + 1, 0, |data| add_counts(data, 3000));
    expect_found(&run, Invariant::BoundedMotion, at + 1);
}

#[test]
fn i2_a_stop_that_is_too_hard() {
    let mut run = torque();
    let at = run.moving();
    let speed = 0.5;
    for (step, seen) in run.seen[at..].iter_mut().enumerate() {
        seen.state = State::Stopping;
        let way = if step < 3 { speed * 1e-3 * step as f64 } else { speed * 3e-3 };
        seen.reported.proxy_m = [way, 0.0];
    }
    expect_found(&run, Invariant::BoundedMotion, at + 4);
}

#[test]
fn i3_a_torque_beyond_its_limit_on_the_bus_and_in_the_drive() {
    let mut run = torque();
    let at = run.moving();
    run.change_set_point(at, 0, |data| data[2..4].copy_from_slice(&1010i16.to_le_bytes()));
    expect_found(&run, Invariant::BoundedEffort, at);
    let mut run = torque();
    run.seen[at].truth.torques_n_m[1] = -60.2;
    expect_found(&run, Invariant::BoundedEffort, at);
    let mut run = torque();
    run.seen[at].reported.force_n = [0.0, 150.1];
    expect_found(&run, Invariant::BoundedEffort, at);
}

#[test]
fn i4_a_proxy_that_leaps() {
    let mut run = torque();
    let at = run.moving();
    run.seen[at].reported.proxy_m[0] += 1.6e-3;
    expect_found(&run, Invariant::BoundedProxy, at);
}

#[test]
fn i5_a_rig_that_pushes_the_hand() {
    let mut run = torque();
    let at = run.moving();
    // 20 N over 0.1 mm in each cycle are 2 W: the bound of some 0.6 J is passed within 400 cycles.
    for (step, seen) in run.seen[at..].iter_mut().enumerate() {
        seen.truth.hand_n = [-20.0, 0.0];
        seen.truth.tool_m = [1e-4 * step as f64, 0.0];
    }
    let found = run.found();
    assert!(found.iter().any(|found| found.invariant == Invariant::Passivity), "{found:?}");
}

/// A stretched servo returns the energy that the hand had put in, and no more.
#[test]
fn i5_a_servo_that_takes_the_tool_back_to_the_proxy() {
    let has_given = |lowest: i32| {
        let mut run = torque();
        let at = run.moving();
        let proxy = run.seen[at].reported.proxy_m;
        // 90 N hold the tool, which goes 14 mm ahead of the proxy and back: 1.3 J.
        let way = (0..140).chain((lowest..140).rev()).map(|step| 1e-4 * f64::from(step));
        for (seen, ahead_m) in run.seen[at..].iter_mut().zip(way) {
            seen.reported.proxy_m = proxy;
            (seen.truth.hand_n, seen.truth.tool_m) = ([90.0, 0.0], [proxy[0] + ahead_m, proxy[1]]);
            seen.state = State::Running;
        }
        run.found().iter().any(|found| found.invariant == Invariant::Passivity)
    };
    assert!(!has_given(0));
    // On to 10 mm behind the proxy: another 0.9 J.
    assert!(has_given(-100));
}

/// The kinetic energy of arm and proxy is given back however long the hand takes to stop them.
#[test]
fn i5_a_hand_that_stops_a_fast_arm_gently() {
    let has_given = |stopping_n: f64| {
        let mut run = torque();
        let at = run.running() + 100;
        let [x, y] = run.seen[at - 1].truth.tool_m;
        // To 1.5 m/s and back to rest, 0.6 s each. 20 N are 9 J, what 8 kg hold; 25 N are 11 J.
        for (step, seen) in run.seen[at..].iter_mut().enumerate() {
            let t = step as f64 * 1e-3;
            let (way, force_n) = match t {
                _ if t < 0.6 => (1.25 * t * t, 20.0),
                _ if t < 1.2 => (0.9 - 1.25 * (1.2 - t) * (1.2 - t), -stopping_n),
                _ => (0.9, 0.0),
            };
            (seen.reported.proxy_m, seen.truth.tool_m) = ([x + way, y], [x + way, y]);
            (seen.truth.hand_n, seen.state) = ([force_n, 0.0], State::Running);
        }
        run.found().into_iter().find(|found| found.invariant == Invariant::Passivity)
    };
    assert_eq!(has_given(20.0), None);
    assert!(has_given(25.0).is_some());
}

#[test]
fn i6_a_fixture_that_holds_too_hard() {
    let mut run = torque();
    let at = run.moving();
    // A force that the motion does not answer.
    let force = 3.0 * elementary::hypot(run.limits.friction_n, run.limits.yield_n);
    run.seen[at].reported.force_n = [force.min(149.0), 0.0];
    expect_found(&run, Invariant::YieldLevels, at);
}

#[test]
fn i7_a_proxy_that_drifts() {
    let mut run = torque();
    let at = run.running() + 2;
    for (step, seen) in run.seen[at..at + 600].iter_mut().enumerate() {
        seen.reported.force_n = [0.0; 2];
        seen.reported.proxy_m = [1e-9 * step as f64, 0.0];
    }
    let found = run.found();
    assert!(found.iter().any(|found| found.invariant == Invariant::ComesToRest), "{found:?}");

    // Not while drives at their torque limit have it drawn back.
    run.seen.iter_mut().for_each(|seen| seen.reported.is_saturated = true);
    let found = run.found();
    assert!(found.iter().all(|found| found.invariant != Invariant::ComesToRest), "{found:?}");
}

#[test]
fn i8_a_number_that_is_none() {
    let mut run = torque();
    let at = run.moving();
    run.seen[at].reported.target_rad[1] = f64::NAN;
    expect_found(&run, Invariant::Finite, at);
}

#[test]
fn i9_a_first_target_that_is_not_the_measured_one() {
    for mut run in [torque(), position()] {
        let at = run.running() + 1;
        run.change_set_point(at, 0, |data| data[2] = data[2].wrapping_add(2));
        expect_found(&run, Invariant::StartsInPlace, at);
    }
}

#[test]
fn i10_a_latched_state_that_ends_by_itself() {
    let mut run = torque();
    let at = run.moving();
    run.seen[at].state = State::Stopped;
    expect_found(&run, Invariant::StaysLatched, at + 1);
    // A reset leads to Idle and nowhere else.
    run.seen[at + 1].request = Request::Reset;
    expect_found(&run, Invariant::StaysLatched, at + 1);
}

#[test]
fn i12_a_second_set_point_and_a_late_one() {
    let mut run = torque();
    let at = run.moving();
    let twin = *run.set_point(at, 0);
    run.seen[at].frames.insert(0, twin);
    expect_found(&run, Invariant::FreshSetPoint, at);
    let mut run = torque();
    let late = *run.set_point(at, 0);
    run.seen[at].frames.push(late);
    expect_found(&run, Invariant::FreshSetPoint, at);
}

#[test]
fn i16_a_measurement_that_is_a_turn_away() {
    let mut run = torque();
    let at = run.moving();
    run.seen[at].reported.measured_rad[0] += std::f64::consts::TAU;
    expect_found(&run, Invariant::WrappingCounters, at);
}

/// 30 rad/s, with the angle as it was two thirds of a cycle ago.
#[test]
fn i16_a_joint_that_a_hand_turns_faster_than_the_rig_ever_does() {
    let turned = |away: f64| {
        let mut run = torque();
        let at = run.moving();
        for (step, seen) in (1..=20).zip(&mut run.seen[at..]) {
            let turned = 0.03 * f64::from(step);
            seen.truth.angles_rad[0] += turned;
            seen.reported.measured_rad[0] += turned - away;
        }
        (run, at)
    };
    let (found, times) = turned(0.02).0.excused(Invariant::WrappingCounters, Excuse::Turned);
    assert!(found.iter().all(|found| found.invariant != Invariant::WrappingCounters), "{found:?}");
    assert_eq!(times, 20);
    let (run, at) = turned(0.04);
    expect_found(&run, Invariant::WrappingCounters, at);
}

#[test]
fn what_is_falsified_is_counted() {
    let mut run = torque();
    let at = run.moving();
    run.seen[at].reported.measured_rad[0] += 1.0;
    run.seen[at].falsified.angles = true;
    let (found, times) = run.excused(Invariant::WrappingCounters, Excuse::Falsified);
    assert_eq!((found, times), (Vec::new(), 1));
}

#[test]
fn i17_one_drive_stops_and_the_other_goes_on() {
    let mut run = torque();
    let at = run.moving();
    run.change_set_point(at, 1, |data| data[0] = 0x02);
    expect_found(&run, Invariant::Together, at);
}

#[test]
fn i18_a_reset_and_an_enabling_that_nobody_asked_for() {
    let mut run = torque();
    let at = run.moving();
    run.change_set_point(at, 0, |data| data[0] = 0x80);
    expect_found(&run, Invariant::AskedFor, at);
    let mut run = torque();
    for seen in &mut run.seen {
        seen.request = Request::None;
    }
    let first = run.found().into_iter().find(|found| found.invariant == Invariant::AskedFor).expect("asked-for");
    assert!((first.cycle as usize) <= run.running() + 2, "{first:?}");
}

#[test]
fn i19_more_frames_than_fit() {
    let mut run = torque();
    let at = run.moving();
    let frame = Frame::new(0x581, &[0; 8]);
    let extra = Sighting { time_ns: 0, sender: Some(Sender::Drive(0)), frame };
    run.seen[at].frames.extend([extra; 8]);
    expect_found(&run, Invariant::BusLoad, at + 1);

    // Emergencies come when the rig has stopped, and are not in the budget's verdict either.
    let mut run = torque();
    let emergency = Sighting { frame: Frame::new(0x081, &[0; 8]), ..extra };
    run.seen[at].frames.extend([emergency; 8]);
    assert!(run.found().iter().all(|found| found.invariant != Invariant::BusLoad));

    // A node has to answer a stranger: that is the stranger's load. What it answers the master is the rig's again.
    let asked = |sender| Sighting { sender: Some(sender), frame: Frame::new(0x601, &[0; 8]), ..extra };
    let mut run = torque();
    run.seen[at].frames.push(asked(Sender::Stranger));
    run.seen[at].frames.extend([extra; 8]);
    assert!(run.found().iter().all(|found| found.invariant != Invariant::BusLoad));
    run.seen[at].frames.push(asked(Sender::Master));
    run.seen[at].frames.extend([extra; 8]);
    expect_found(&run, Invariant::BusLoad, at + 1);
}

#[test]
fn i20_a_queue_that_grows_and_one_that_is_full() {
    let mut run = torque();
    let at = run.moving();
    run.seen[at].queue_high_water = 9;
    expect_found(&run, Invariant::BoundedQueues, at);
    // Two strangers with a SYNC each ask for more than the bus carries.
    let sync = Sighting { time_ns: 0, sender: Some(Sender::Stranger), frame: Frame::new(0x080, &[]) };
    run.seen[at].frames.extend([sync; 2]);
    expect_found(&run, Invariant::BoundedQueues, at);
    run.seen[at].falsified.timing = true;
    assert!(run.found().iter().all(|found| found.invariant != Invariant::BoundedQueues));
    let mut run = torque();
    for seen in &mut run.seen[at..] {
        seen.queue_lost += 1;
    }
    expect_found(&run, Invariant::BoundedQueues, at);
}

#[test]
fn i21_sync_after_a_set_point_of_a_stranger() {
    let mut run = torque();
    let at = run.moving();
    let foreign = Frame::new(run.limits.set_point_ids[0], &[0x0f, 0, 0xf4, 0x01]);
    let heard = |ns: u64| Sighting { time_ns: ns, sender: Some(Sender::Stranger), frame: foreign };
    // Behind the set-points of the cycle before, and heard when SYNC is due.
    let sync_ns = run.seen[at].sync_ns;
    let is_sync = |seen: &Sighting| seen.sender == Some(Sender::Master) && seen.frame.id() == 0x080;
    let place = run.seen[at].frames.iter().position(is_sync).unwrap();
    run.seen[at].frames.insert(place, heard(sync_ns));
    expect_found(&run, Invariant::ForeignSetPoint, at);
    // One that nobody could hear in time is not the master's doing, if it stops both drives in the cycle.
    run.seen[at].frames[place] = heard(sync_ns + 1);
    for joint in 0..2 {
        run.change_set_point(at + 1, joint, |data| data.copy_from_slice(&[0x02, 0, 0, 0]));
    }
    assert!(run.found().iter().all(|found| found.invariant != Invariant::ForeignSetPoint), "{:?}", run.found());
}
