//! Every injection of the catalogue on the shipped torque and position rigs: what the rig makes of it, how soon, where it
//! ends, that nothing comes back by itself, and that the rig runs again when a person has done what the catalogue says.

use hil_tests::{ObservedFrame, Recording, Scenario, Session, setpoint};
use yieldwall::bus::BootFailure;
use yieldwall::guard::fault::{Bound, Rate, Stage, TABLE};
use yieldwall::guard::{Fault, Reaction, Request, State};
use yieldwall::injection::{
    CATALOGUE, CatalogueRow, Ending, Expected, Injection, Kind, Lasts, Medium, Recovery, Target,
};
use yieldwall::rig::RigError;
use yieldwall_drives::cia402;

/// Cycles from the begin of the scene to the injection: the tool moves.
const BEFORE: usize = 700;
/// Cycles after the end of an injection in which the rig has come to its end, and stays there.
const AFTER: usize = 600;
/// Time in s within which a register is read back that safety rests on.
const HIDDEN_S: f64 = 1.0;
/// A heartbeat every 20 ms, lost after two, and one cycle.
const HEARTBEAT_CYCLES: usize = 41;

fn on_ethercat() -> Scenario {
    Scenario::shipped("paper-ethercat.yaml")
}

fn on_both() -> Scenario {
    Scenario::shipped("paper-ethercat-can-sensor.yaml")
}

/// What has to follow of an injection on this rig; where it acts on buses of both kinds, what one of them has follow.
fn expected(scenario: &Scenario, injection: &Injection) -> Vec<&'static Expected> {
    scenario.rig.media(injection).map(|medium| injection.kind.row().expected_on(medium)).collect()
}

fn both() -> [Scenario; 2] {
    [Scenario::torque(), Scenario::position()]
}

/// Injections whose first sign does not come in their first cycle, or hangs on the motion.
const SIGN_COMES_LATER: [Kind; 18] = [
    Kind::SensorDrift,
    Kind::SetPointsLost,
    Kind::NodeSilent,
    Kind::DuplicateNode,
    Kind::ForeignSetPoint,
    Kind::ForeignDownload,
    Kind::DriveRunaway,
    Kind::EncoderStuck,
    Kind::ArmBlocked,
    Kind::MasterStopped,
    Kind::Suspend,
    Kind::PdoCorrupt,
    Kind::TransmitStalled,
    Kind::CableOut,
    // A mailbox and ports are looked at now and then.
    Kind::Emergency,
    Kind::EmergencyInSdo,
    Kind::FrameCorrupt,
    Kind::HiddenRegisterWrite,
];

/// What became of an injection.
#[derive(Debug, Default)]
struct Course {
    /// The states in the order in which they came, with the cycles since the injection began and the cause.
    states: Vec<(State, usize, Option<Fault>)>,
    /// Which of the expected faults showed.
    seen: Vec<Fault>,
}

/// Injects and runs on, for some time after the end.
fn run(scenario: &Scenario, injection: Injection) -> (Session, Course) {
    let mut session = scenario.run(BEFORE);
    session.inject(injection);
    // Registers are read back within a second.
    let usual_s = if injection.kind == Kind::HiddenRegisterWrite { HIDDEN_S } else { 0.0 };
    let lasts_s = injection.duration_s.unwrap_or(usual_s);
    let mut course = Course::default();
    let mut state = session.machine.state();
    let mut rest = AFTER;
    for cycle in 1..=(lasts_s / scenario.period_s()).round() as usize + AFTER {
        session.step(Request::None);
        let counts = session.machine.master().cycle().faults();
        for fault in expected(scenario, &injection).into_iter().flat_map(|expected| expected.faults) {
            if counts.count(*fault) > 0 && !course.seen.contains(fault) {
                course.seen.push(*fault);
            }
        }
        if session.machine.state() != state {
            state = session.machine.state();
            course.states.push((state, cycle, session.fault()));
        }
        // What lasts long need not be waited for when the rig has stopped.
        rest -= usize::from(state.is_latched());
        if rest == 0 {
            break;
        }
    }
    (session, course)
}

/// The reaction that led to a state, given the one before.
fn reaction_to(before: State, state: State) -> Option<Reaction> {
    match state {
        State::Holding => Some(Reaction::Freeze),
        State::Stopping => Some(Reaction::StopRamp),
        State::Lost | State::Stopped | State::Disabled if before != State::Stopping => Some(Reaction::QuickStop),
        _ => None,
    }
}

/// Checks every step of the course against the bounds of the fault table, counted from the first cycle whose values can show the
/// injection: what a cycle reads of a device on EtherCAT was taken at its SYNC0, before the cycle began.
fn check_bounds(scenario: &Scenario, injection: &Injection, course: &Course, what: &str) {
    let (row, begun) = (injection.kind.row(), usize::from(scenario.rig.medium(injection) == Medium::Ethercat));
    let mut before = State::Running;
    for (state, cycles, cause) in &course.states {
        let reaction = reaction_to(before, *state);
        before = *state;
        let (Some(reaction), Some(cause)) = (reaction, cause) else { continue };
        let is_motion = matches!(cause.row().stage, Stage::Motion | Stage::Arm);
        if SIGN_COMES_LATER.contains(&row.kind) || is_motion || row.targets == [Target::Hand] {
            continue;
        }
        let steps = cause.row().steps.iter().rev();
        // A quick stop or anything beyond it.
        let step = steps.into_iter().find(|step| match reaction {
            Reaction::QuickStop => step.reaction >= Reaction::QuickStop,
            other => step.reaction == other,
        });
        let Some(step) = step else { panic!("{what}: {cause:?} does not ask for {reaction:?}") };
        let bound = match (step.rate, step.bound) {
            // From the observation that makes the number full, which is not seen here.
            (Rate::Within { .. }, _) => continue,
            (_, Bound::Cycles(cycles) | Bound::Samples(cycles)) => usize::from(cycles),
            (_, Bound::HeartbeatTime) => HEARTBEAT_CYCLES,
        };
        let bound = begun + bound;
        assert!(*cycles <= bound, "{what}: {state:?} by {cause:?} after {cycles} cycles, at most {bound}");
    }
}

/// The controlwords of both drives, cycle by cycle; `None` where the master sent none.
fn controlwords(recording: &Recording) -> Vec<[Option<u16>; 2]> {
    let word = |cycle: &[ObservedFrame], id: u16| {
        cycle.iter().find(|seen| seen.frame.id() == id).map(|seen| setpoint(seen).controlword)
    };
    recording.cycles().iter().map(|cycle| [word(cycle, 0x201), word(cycle, 0x202)]).collect()
}

/// Checks that both drives were told to run up to the same cycle, and neither afterwards.
fn check_same_cycle(session: &Session, what: &str) {
    let enables = |word: Option<u16>| word.is_some_and(|word| word & 0x8f == 0x0f);
    let words = match session.machine.master().networks().segment() {
        Some(_) => session.segment_controlwords(),
        None => controlwords(&session.recording()),
    };
    let last = |joint: usize| words.iter().rposition(|words| enables(words[joint]));
    assert_eq!(last(0), last(1), "{what}: both axes stop in the same cycle");
}

fn check_latched(session: &mut Session, states: &[State], what: &str) {
    assert!(states.contains(&session.machine.state()), "{what}: {:?}", session.machine.state());
    let check_off = |session: &Session| {
        for (state, torque_n_m) in session.machine.drive_states().into_iter().zip(session.machine.drive_torques_n_m()) {
            assert_ne!(state, cia402::State::OperationEnabled, "{what}");
            assert_eq!(torque_n_m, 0.0, "{what}");
        }
    };
    check_off(session);
    // Asking to be enabled does not help, and a stop neither.
    for request in [Request::Enable, Request::Stop] {
        session.step(request);
        session.run(20);
        assert!(session.machine.state().is_latched(), "{what}: {request:?}");
        check_off(session);
    }
}

/// Does what the catalogue asks a person to do, and checks that the rig runs.
fn recover(session: &mut Session, recovery: Recovery, what: &str) {
    let result = match recovery {
        Recovery::None => Ok(()),
        Recovery::Reset => session.machine.enable_again(),
        Recovery::Restart => session.machine.restart(),
        Recovery::NewProcess => {
            for result in [session.machine.enable_again(), session.machine.restart()] {
                assert!(matches!(result, Err(RigError::NotEnabled { .. })), "{what}: {result:?}");
            }
            return;
        }
    };
    result.unwrap_or_else(|error| panic!("{what}: {error}"));
    session.run(300);
    assert_eq!((session.machine.state(), session.fault()), (State::Running, None), "{what}");
}

/// Checks one injection; which of its faults showed.
fn check(scenario: &Scenario, row: &CatalogueRow, injection: Injection) -> Vec<Fault> {
    let what = format!("{} on {}; replay: {}", row.name, injection.target.name(), scenario.replay());
    let (mut session, course) = run(scenario, injection);
    let what = format!("{what}\n{course:?}");
    check_bounds(scenario, &injection, &course, &what);
    let all = expected(scenario, &injection);
    let is_one = |expected: &&&Expected| session.fault().is_some_and(|cause| expected.faults.contains(&cause));
    let expected = all.iter().find(is_one).unwrap_or(&all[0]);
    let strongest = course.states.iter().map(|(state, ..)| *state);
    match expected.ending {
        Ending::GoesOn => {
            assert_eq!((session.machine.state(), session.fault()), (State::Running, None), "{what}");
            let has_held = strongest.into_iter().any(|state| state == State::Holding);
            assert_eq!(has_held, expected.reaction == Reaction::Freeze, "{what}");
            assert!(!course.seen.is_empty() || expected.faults.is_empty(), "{what}: nothing was counted");
        }
        Ending::Latched(states) => {
            let cause = session.fault();
            assert!(cause.is_some_and(|cause| expected.faults.contains(&cause)), "{what}: {cause:?}");
            // Of set-points that do not arrive there is nothing to see.
            if row.kind != Kind::SetPointsLost {
                check_same_cycle(&session, &what);
            }
            check_latched(&mut session, states, &what);
        }
        Ending::DrivesStop => {
            check_same_cycle(&session, &what);
            check_latched(&mut session, &[State::Lost], &what);
        }
        Ending::NotEnabled => unreachable!("tested apart"),
    }
    session.machine.set_injections(&[]).expect("nothing is always possible");
    recover(&mut session, expected.recovery, &what);
    course.seen.into_iter().chain(course.states.into_iter().filter_map(|(.., cause)| cause)).collect()
}

/// Faults that are found before the rig runs, or that no injection brings about.
const NOT_WHILE_RUNNING: [Fault; 5] =
    [Fault::Posture, Fault::EnablingTimeout, Fault::NotFinite, Fault::WorkspaceLeft, Fault::EnergyLimit];

/// Faults of devices on EtherCAT, which a rig on CAN cannot have.
const OF_A_SEGMENT: [Fault; 3] = [Fault::DeviceState, Fault::ClockLost, Fault::PortErrors];

/// Where an injection is tried: what holds for the left drive holds for the right one.
fn targets(scenario: &Scenario, row: &CatalogueRow) -> Vec<Target> {
    let is_possible = |target: &&Target| {
        let injection = Injection::new(row.kind, 0.0).on(**target);
        injection.check_on(scenario.rig.medium(&injection)).is_ok()
    };
    let possible: Vec<Target> = row.targets.iter().filter(is_possible).copied().collect();
    let is_on_its_own_bus = |target: Target| target == Target::Sensor && scenario.rig.buses.len() > 1;
    let is_tried =
        |target: &Target| *target == possible[0] || *target == Target::RightDrive || is_on_its_own_bus(*target);
    possible.iter().copied().filter(is_tried).collect()
}

fn check_all(scenario: &Scenario) {
    let mut seen = Vec::new();
    let elsewhere = match (scenario.rig.is_on_can(), scenario.rig.is_on_ethercat()) {
        (true, false) => &OF_A_SEGMENT[..],
        (true, true) => &OF_DRIVES_ON_CAN[..],
        _ => &OF_CAN[..],
    };
    for row in CATALOGUE.iter().filter(|row| row.lasts != Lasts::FromBoot) {
        for target in targets(scenario, row) {
            seen.extend(check(scenario, row, Injection::new(row.kind, 0.0).on(target)));
        }
    }
    // Without the torques, which a position rig does not know, there is no balance.
    let is_known = |fault: Fault| fault != Fault::ForceImplausible || scenario.file != Scenario::position().file;
    let missing = TABLE.iter().map(|row| row.fault).filter(|fault| is_known(*fault) && !seen.contains(fault));
    let missing: Vec<_> =
        missing.filter(|fault| ![&NOT_WHILE_RUNNING[..], elsewhere].concat().contains(fault)).collect();
    assert_eq!(missing, [], "no injection showed it; {}", scenario.replay());
}

#[test]
fn the_torque_rig_answers_every_injection_as_the_catalogue_says() {
    check_all(&Scenario::torque());
}

#[test]
fn the_position_rig_answers_every_injection_as_the_catalogue_says() {
    check_all(&Scenario::position());
}

/// Faults that only a bus of CAN has, or a node on it.
const OF_CAN: [Fault; 8] = [
    Fault::NodeReset,
    Fault::HeartbeatLost,
    Fault::DuplicateNode,
    Fault::BusOff,
    Fault::ErrorPassive,
    Fault::TransmitStalled,
    Fault::PdoLength,
    Fault::EmergencyWarning,
];

/// Of these, what only drives on CAN bring about.
const OF_DRIVES_ON_CAN: [Fault; 1] = [Fault::PdoLength];

#[test]
fn the_rig_on_ethercat_answers_every_injection_as_the_catalogue_says() {
    check_all(&on_ethercat());
}

#[test]
fn the_rig_on_both_buses_answers_every_injection_as_the_catalogue_says() {
    check_all(&on_both());
}

#[test]
fn registers_that_a_foreign_node_writes_stop_the_rig_seen_at_once_and_unseen_within_a_second() {
    for scenario in [on_ethercat(), on_both()] {
        for kind in [Kind::ForeignRegisterWrite, Kind::HiddenRegisterWrite] {
            for (target, register) in
                kind.row().targets.iter().flat_map(|target| (0..3).map(move |size| (*target, size)))
            {
                let injection = Injection::new(kind, 0.0).on(target).sized(f64::from(register));
                let (session, course) = run(&scenario, injection);
                let what = format!(
                    "{} of {register} on {}; {course:?}; {}",
                    kind.row().name,
                    target.name(),
                    scenario.replay()
                );
                let hidden_cycles = (HIDDEN_S / scenario.period_s()) as usize;
                // The left drive has the reference clock, whose time the cycle asks for by its address.
                let expected = match (kind, target, register) {
                    (Kind::HiddenRegisterWrite, Target::LeftDrive, 2) => (State::Lost, Fault::ClockLost, 4),
                    (Kind::HiddenRegisterWrite, ..) => (State::Stopped, Fault::Intruder, hidden_cycles),
                    _ => (State::Stopped, Fault::Intruder, 2),
                };
                let [(state, cycles, Some(cause)), ..] = course.states[..] else { panic!("{what}") };
                assert_eq!((state, cause), (expected.0, expected.1), "{what}");
                assert!(cycles <= expected.2, "{what}");
                assert_eq!((session.machine.state(), session.fault()), (state, Some(cause)), "{what}");
            }
        }
    }
}

#[test]
fn another_bit_rate_is_refused_with_the_device_that_nobody_hears() {
    for scenario in both() {
        for (target, name, is_alone) in [
            (Target::LeftDrive, "left", false),
            (Target::RightDrive, "right", false),
            (Target::Sensor, "wrist", false),
            (Target::Link, "left", true),
        ] {
            let what = format!("{}; {}", target.name(), scenario.replay());
            let mut session = scenario.start();
            session.inject(Injection::new(Kind::WrongBitRate, 0.0).on(target));
            let Err(RigError::Boot(error)) = session.enable() else { panic!("{what}: it was booted") };
            assert_eq!((error.name.as_str(), error.step), (name, "wait for the boot-up message"), "{what}");
            let BootFailure::Missing { is_unheard, .. } = error.failure else { panic!("{what}: {error}") };
            assert_eq!(is_unheard, is_alone, "{what}: who is alone on the bus is told by its own interface");
            for drive in session.machine.drives() {
                assert_eq!(drive.state(), cia402::State::SwitchOnDisabled, "{what}");
            }
        }
    }
}

#[test]
fn what_is_wrong_from_switching_on_keeps_the_rig_from_running() {
    for scenario in both().into_iter().chain([on_ethercat(), on_both()]) {
        for row in CATALOGUE.iter().filter(|row| row.lasts == Lasts::FromBoot) {
            let Some(target) = targets(&scenario, row).first().copied() else { continue };
            let what = format!("{} on {}; {}", row.name, target.name(), scenario.replay());
            assert_eq!(row.expected.ending, Ending::NotEnabled, "{what}");
            let mut session = scenario.start();
            session.inject(Injection::new(row.kind, 0.0).on(target));
            let error = session.enable().expect_err(&what);
            let name = if target == Target::Sensor { "wrist" } else { "left" };
            match (row.expected.faults, error) {
                ([], RigError::Boot(error)) => assert_eq!(error.name, name, "{what}"),
                (faults, RigError::NotEnabled { .. }) => {
                    assert!(
                        session.fault().is_some_and(|fault| faults.contains(&fault)),
                        "{what}: {:?}",
                        session.fault()
                    );
                }
                (_, error) => panic!("{what}: {error}"),
            }
            let states = session.machine.drive_states();
            assert!(!states.contains(&cia402::State::OperationEnabled), "{what}: {states:?}");
            session.machine.set_injections(&[]).expect("nothing is always possible");
            recover(&mut session, row.expected.recovery, &what);
        }
    }
}

#[test]
fn a_process_that_was_stopped_for_long_moves_nothing_when_it_goes_on() {
    for scenario in both() {
        for duration_s in [0.01, 0.1, 1.0] {
            let what = format!("{duration_s} s; {}", scenario.replay());
            let injection = Injection::new(Kind::MasterStopped, 0.0).lasting(Some(duration_s));
            let (mut session, course) = run(&scenario, injection);
            let [(state, cycle, _), ..] = course.states[..] else { panic!("{what}: {course:?}") };
            let asleep = (duration_s / scenario.period_s()).round() as usize;
            assert!(state.is_latched() && cycle == asleep + 1, "{what}: {course:?}");
            check_latched(&mut session, &[State::Stopped, State::Disabled, State::Lost], &what);
            session.machine.restart().unwrap_or_else(|error| panic!("{what}: {error}"));
        }
    }
}

#[test]
fn a_short_injection_passes_and_leaves_nothing_behind() {
    for scenario in both() {
        for kind in [Kind::PdoLost, Kind::SensorInvalid, Kind::SensorSilent, Kind::SensorStale, Kind::DriveWarning] {
            let (session, course) = run(&scenario, Injection::new(kind, 0.0).lasting(Some(0.001)));
            let what = format!("{}; {}; {course:?}", kind.row().name, scenario.replay());
            assert_eq!((session.machine.state(), session.fault()), (State::Running, None), "{what}");
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_frames_with_injections() {
    for kind in [Kind::PdoCorrupt, Kind::HandTremble, Kind::CableOut] {
        let frames = || run(&Scenario::torque(), Injection::new(kind, 0.0)).0.candump();
        assert_eq!(frames(), frames(), "{}", kind.row().name);
    }
}

/// Cycles in each twentieth of which, at random, a frame of EtherCAT is bad in one of these ways.
const BAD_CYCLES: u32 = 100_000;
const BAD_FRAMES: [Kind; 6] = [
    Kind::FrameLost,
    Kind::FrameDelayed,
    Kind::FrameDuplicated,
    Kind::FrameForeign,
    Kind::FrameShort,
    Kind::FrameCorrupt,
];

/// Random numbers, the same for the same seed.
fn numbers(mut seed: u64) -> impl FnMut(u64) -> u64 {
    move |below| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) % below
    }
}

/// Checks that no drive was told to go on when the other one was told to stop.
fn check_together(words: &[[Option<u16>; 2]], what: &str) {
    let is_told = |word: Option<u16>, mask: u16, bits: u16| word.is_some_and(|word| word & mask == bits);
    let enables = |word| is_told(word, 0x8f, 0x0f);
    let (mut were_moving, mut moved) = (false, 0);
    for [left, right] in words.iter().copied() {
        let are_moving = enables(left) && enables(right);
        let goes_on_alone = were_moving && enables(left) != enables(right);
        assert!(!goes_on_alone, "{what}: after a common motion {left:04x?} and {right:04x?}");
        (were_moving, moved) = (are_moving, moved + u32::from(are_moving));
    }
    assert!(moved > BAD_CYCLES / 10, "{what}: the rig moved in {moved} cycles");
}

#[test]
fn with_bad_frames_in_each_twentieth_cycle_both_axes_stop_together_and_the_rig_is_restarted_each_time() {
    let scenario = on_ethercat();
    let mut session = scenario.run(BEFORE);
    let mut random = numbers(41);
    let (mut met, mut stops) = ([0_u32; BAD_FRAMES.len()], 0);
    for cycle in 0..BAD_CYCLES {
        let what = format!("cycle {cycle}, seed 41; {}", scenario.replay());
        if random(20) == 0 {
            let which = random(BAD_FRAMES.len() as u64) as usize;
            let bad = Injection::new(BAD_FRAMES[which], 0.0).lasting(Some(scenario.period_s()));
            session.inject(match bad.kind {
                Kind::FrameDelayed => bad.sized(1e-6 * random(2500) as f64),
                Kind::FrameCorrupt => bad.sized(1.0 + random(48) as f64),
                _ => bad,
            });
            met[which] += 1;
        }
        let row = session.machine.run_cycle(Request::None);
        row.unwrap_or_else(|error| panic!("{what}: {error}"));
        if session.machine.state().is_latched() {
            stops += 1;
            session.machine.set_injections(&[]).expect("nothing is always possible");
            // A frame that is held and damaged would be that of another master while the segment is brought up.
            for _ in 0..3 {
                session.machine.run_cycle(Request::None).unwrap_or_else(|error| panic!("{what}: {error}"));
            }
            session.machine.restart().unwrap_or_else(|error| panic!("{what}: {error}"));
        }
    }
    assert!(met.iter().all(|times| *times > 500) && stops > 300, "{met:?}, {stops} stops");
    check_together(&session.segment_controlwords(), &scenario.replay());
}
