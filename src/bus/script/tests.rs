//! Steps against a device whose objects are written by hand.

use super::*;
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::time::Duration;
use yieldwall_fieldbus::objects::{AbortCode, ObjectError, ObjectRequest};
use yieldwall_fieldbus::time::Time;

const MS: Duration = Duration::from_millis(1);

/// A device by what it holds, and by what it refuses.
#[derive(Clone, Debug, Default)]
struct Device {
    held: BTreeMap<Address, u32>,
    read_only: Vec<Address>,
    written: Vec<(Address, u32)>,
    reads: usize,
}

impl Device {
    fn holding(held: &[(u16, u8, u32)]) -> Self {
        let held = held.iter().map(|(index, sub, value)| (Address::new(*index, *sub), *value)).collect();
        Self { held, ..Self::default() }
    }

    fn fixed(mut self, at: &[(u16, u8)]) -> Self {
        self.read_only = at.iter().map(|(index, sub)| Address::new(*index, *sub)).collect();
        self
    }

    fn answer(&mut self, request: ObjectRequest<'_>) -> Result<Vec<u8>, ObjectError> {
        let refused = |code| Err(ObjectError::Aborted(code));
        match request {
            ObjectRequest::Read(at) => {
                self.reads += 1;
                let held = self.held.get(&at).map(|value| value.to_le_bytes().to_vec());
                held.ok_or(ObjectError::Aborted(AbortCode::NO_OBJECT))
            }
            ObjectRequest::Write(at, _) if !self.held.contains_key(&at) => refused(AbortCode::NO_OBJECT),
            ObjectRequest::Write(at, _) if self.read_only.contains(&at) => refused(AbortCode::READ_ONLY),
            ObjectRequest::Write(at, bytes) => {
                self.held.insert(at, little_endian(bytes));
                self.written.push((at, little_endian(bytes)));
                Ok(Vec::new())
            }
        }
    }

    /// Takes it through all steps; why it cannot be used.
    fn take(&mut self, steps: &[Step]) -> Result<(), BootFailure> {
        let identity =
            Identity { device_type: Some(0), vendor_id: 0, product_codes: vec![1], revisions: Revisions::Any };
        let mut script = Script::new(identity, 20 * MS, steps.to_vec());
        let mut now = Time(0);
        for _ in 0..10_000 {
            let Some(wanted) = script.wanted()? else { return Ok(()) };
            let answer = self.answer(wanted.request());
            script.on_answer(now, answer.as_ref().map(Vec::as_slice).map_err(|error| *error))?;
            if script.again_at != Time::NEVER {
                now = script.again_at;
                script.again_at = Time::NEVER;
            }
        }
        panic!("the steps do not end")
    }
}

fn at(index: u16, sub: u8, bytes: u8, action: Action) -> Step {
    Step { doing: "try", index, sub, bytes, action }
}

fn holds(index: u16, sub: u8, bytes: u8, value: u32) -> Step {
    at(index, sub, bytes, Action::State { value, kept: 0 })
}

/// Two objects that are exchanged, and the assignment that chooses them.
fn process_data() -> Vec<Step> {
    let off = Action::Off { value: 0, kept: 0 };
    let mapping = vec![
        at(0x1600, 0, 1, off),
        holds(0x1600, 1, 4, 0x6040_0010),
        holds(0x1600, 2, 4, 0x607a_0020),
        holds(0x1600, 0, 1, 2),
    ];
    let mut all = vec![at(0x1c12, 0, 1, off)];
    all.extend(unit(mapping));
    all.extend([holds(0x1c12, 1, 2, 0x1600), holds(0x1c12, 0, 1, 1)]);
    unit(all).collect()
}

const MAPPED: [(u16, u8, u32); 5] =
    [(0x1600, 0, 2), (0x1600, 1, 0x6040_0010), (0x1600, 2, 0x607a_0020), (0x1c12, 0, 1), (0x1c12, 1, 0x1600)];
const ALL_OF_IT: [(u16, u8); 5] = [(0x1600, 0), (0x1600, 1), (0x1600, 2), (0x1c12, 0), (0x1c12, 1)];

#[test]
fn process_data_that_are_fixed_and_as_wanted_are_not_touched() {
    let mut device = Device::holding(&MAPPED).fixed(&ALL_OF_IT);
    assert_eq!(device.take(&process_data()), Ok(()));
    assert_eq!((device.written.len(), device.reads), (0, 5));
}

#[test]
fn process_data_that_differ_are_written_as_a_whole() {
    for (place, other) in [(0, 1), (1, 0x6040_0008), (2, 0), (3, 0), (4, 0x1601)] {
        let mut held = MAPPED;
        held[place].2 = other;
        let mut device = Device::holding(&held);
        assert_eq!(device.take(&process_data()), Ok(()));
        let assignment = [(0x1c12, 1, 0x1600), (0x1c12, 0, 1)];
        let mapping = [(0x1600, 0, 0), (0x1600, 1, 0x6040_0010), (0x1600, 2, 0x607a_0020), (0x1600, 0, 2)];
        // A mapping that is right stays while others are chosen.
        let mapping = if place < 3 { &mapping[..] } else { &[] };
        let expected: Vec<_> = [(0x1c12, 0, 0)].iter().chain(mapping).chain(&assignment).copied().collect();
        let written: Vec<_> = device.written.iter().map(|(at, value)| (at.index, at.sub, *value)).collect();
        assert_eq!(written, expected);
    }
}

#[test]
fn of_what_is_fixed_only_what_differs_is_refused_and_by_name() {
    // The assignment is fixed, and the mapping can be written.
    let mut held = MAPPED;
    held[2].2 = 0x6071_0010;
    let mut device = Device::holding(&held).fixed(&[(0x1c12, 0), (0x1c12, 1)]);
    assert_eq!(device.take(&process_data()), Ok(()));
    assert_eq!(device.held[&Address::new(0x1600, 2)], 0x607a_0020);
    // Another mapping that is fixed, and another one that is chosen.
    for (place, (index, sub), held_value, wanted) in
        [(2, (0x1600, 2), 0x6071_0010, 0x607a_0020), (0, (0x1600, 0), 1, 2), (4, (0x1c12, 1), 0x1701, 0x1600)]
    {
        let mut held = MAPPED;
        held[place].2 = held_value;
        let failure = Device::holding(&held).fixed(&ALL_OF_IT).take(&process_data()).unwrap_err();
        let code = AbortCode::READ_ONLY;
        assert_eq!(failure, BootFailure::Keeps { index, sub, held: held_value, wanted, code });
        let text = failure.to_string();
        assert!(text.contains(&format!("{index:04X}h:{sub}")) && text.contains("process_data"), "{text}");
    }
}

/// Setter of the cycle time.
fn cycle(period_us: u32) -> [Step; 3] {
    let part = |part| Action::CycleTime { period_us, part };
    [
        at(0x60c2, 2, 1, Action::Exponent),
        at(0x60c2, 1, 1, part(CyclePart::Value)),
        at(0x60c2, 2, 1, part(CyclePart::Exponent)),
    ]
}

#[test]
fn the_cycle_time_is_said_in_the_drives_own_unit_where_it_can_be() {
    let raw = |exponent: i8| u32::from(exponent as u8);
    // Period in us; value and power of ten before and after; how many objects are written.
    for (period_us, before, after, writes) in [
        (1000, (1, -3), (1, -3), 0),
        (4000, (1, -3), (4, -3), 1),
        (1000, (1, -4), (10, -4), 1),
        (1000, (10, -4), (10, -4), 0),
        (500, (1, -3), (5, -4), 2),
        (250, (1, -6), (250, -6), 1),
        (1000, (1, -6), (1, -3), 1),
        (10_000, (1, -3), (10, -3), 1),
    ] {
        let held = [(0x60c2, 1, before.0), (0x60c2, 2, raw(before.1))];
        let mut device = Device::holding(&held);
        assert_eq!(device.take(&cycle(period_us)), Ok(()), "{period_us} us");
        let is = |sub| device.held[&Address::new(0x60c2, sub)];
        assert_eq!((is(1), is(2), device.written.len()), (after.0, raw(after.1), writes), "{period_us} us");
        // With a unit that is fixed it is the same, or it is refused by name.
        let mut fixed = Device::holding(&held).fixed(&[(0x60c2, 2)]);
        let end = fixed.take(&cycle(period_us));
        if before.1 == after.1 {
            assert_eq!(end, Ok(()));
        } else {
            let (code, exponent) = (AbortCode::READ_ONLY, before.1);
            assert_eq!(end, Err(BootFailure::FixedExponent { index: 0x60c2, sub: 2, period_us, exponent, code }));
        }
    }
}

#[test]
fn a_command_is_written_whatever_stands_and_a_fixed_one_that_is_as_wanted_passes() {
    let command = [at(0x1016, 1, 4, Action::Command { value: 7, is_verified: true })];
    let mode = [at(0x6060, 0, 1, Action::Command { value: 8, is_verified: false })];
    for (steps, index, sub, value) in [(command, 0x1016, 1, 7), (mode, 0x6060, 0, 8)] {
        let mut device = Device::holding(&[(index, sub, value)]);
        assert_eq!(device.take(&steps), Ok(()));
        assert_eq!(device.written, [(Address::new(index, sub), value)]);
        let mut fixed = Device::holding(&[(index, sub, value)]).fixed(&[(index, sub)]);
        assert_eq!(fixed.take(&steps), Ok(()));
        let mut other = Device::holding(&[(index, sub, 1)]).fixed(&[(index, sub)]);
        assert!(matches!(other.take(&steps), Err(BootFailure::Keeps { held: 1, .. })));
    }
}

#[test]
fn bits_that_would_make_a_node_a_producer_are_cleared_and_a_lack_of_the_object_is_good() {
    let steps = [at(0x1005, 0, 4, Action::Bits { mask: 1 << 30, value: 0 })];
    for (held, after, writes) in [(0x4000_0080, 0x80, 1), (0x80, 0x80, 0)] {
        let mut device = Device::holding(&[(0x1005, 0, held)]);
        assert_eq!(device.take(&steps), Ok(()));
        assert_eq!((device.held[&Address::new(0x1005, 0)], device.written.len()), (after, writes));
    }
    assert_eq!(Device::default().take(&steps), Ok(()));
    let failure = Device::holding(&[(0x1005, 0, 0x4000_0080)]).fixed(&[(0x1005, 0)]).take(&steps).unwrap_err();
    assert!(matches!(failure, BootFailure::Keeps { index: 0x1005, held: 0x4000_0080, wanted: 0x80, .. }), "{failure}");
}

#[test]
fn the_synchronisation_is_set_where_it_can_be_and_judged_where_it_is_told() {
    let steps = |value| {
        let step = |action| at(0x1c32, 1, 2, action);
        [step(Action::SyncType { value }), step(Action::Synchronised { value })]
    };
    let mut device = Device::holding(&[(0x1c32, 1, 0)]);
    assert_eq!(device.take(&steps(2)), Ok(()));
    assert_eq!(device.written.len(), 1);
    assert_eq!(Device::default().take(&steps(2)), Ok(()), "it tells nothing of it");
    assert_eq!(Device::holding(&[(0x1c32, 1, 2)]).fixed(&[(0x1c32, 1)]).take(&steps(2)), Ok(()));
    let failure = Device::holding(&[(0x1c32, 1, 0)]).fixed(&[(0x1c32, 1)]).take(&steps(2)).unwrap_err();
    assert_eq!(failure, BootFailure::Synchronisation { index: 0x1c32, sub: 1, wanted: 2, received: 0 });
    let text = failure.to_string();
    assert!(text.contains("free run") && text.contains("SYNC0"), "{text}");
}

proptest! {
    /// Whatever a device holds and refuses: at the end each state is as wanted, or the boot says which object is not. A second way through
    /// the steps writes nothing.
    #[test]
    fn every_state_is_as_wanted_or_named(
        held in prop::collection::vec(0u32..4, 8),
        fixed in prop::collection::vec(any::<bool>(), 8),
        wanted in prop::collection::vec(0u32..4, 8),
    ) {
        let objects: Vec<(u16, u8, u32)> = (0x2000..).zip(&held).map(|(index, value)| (index, 0, *value)).collect();
        let fixed: Vec<(u16, u8)> =
            (0x2000..).zip(fixed).filter(|(_, is_fixed)| *is_fixed).map(|(index, _)| (index, 0)).collect();
        let of = |places: std::ops::Range<u16>| -> Vec<Step> {
            places.map(|place| holds(0x2000 + place, 0, 1, wanted[usize::from(place)])).collect()
        };
        // Two alone, a unit of six with one of three in it.
        let mut inner = vec![at(0x2002, 0, 1, Action::Off { value: 0, kept: 0 })];
        inner.extend(of(2..5));
        let mut outer = vec![at(0x2007, 0, 1, Action::Off { value: 0, kept: 0 })];
        outer.extend(unit(inner));
        outer.extend(of(5..8));
        let steps: Vec<Step> = of(0..2).into_iter().chain(unit(outer)).collect();
        let mut device = Device::holding(&objects).fixed(&fixed);
        match device.take(&steps) {
            Ok(()) => {
                for (place, wanted) in wanted.iter().enumerate() {
                    prop_assert_eq!(device.held[&Address::new(0x2000 + place as u16, 0)], *wanted);
                }
                device.written.clear();
                prop_assert_eq!(device.take(&steps), Ok(()));
                prop_assert!(device.written.is_empty());
            }
            Err(BootFailure::Keeps { index, held, wanted: asked, .. }) => {
                let place = usize::from(index - 0x2000);
                prop_assert!(fixed.contains(&(index, 0)) && asked == wanted[place] && held != asked);
            }
            Err(other) => prop_assert!(false, "{}", other),
        }
    }

    /// Bytes of any length, refusals and silence in any order end the steps, and nothing panics.
    #[test]
    fn any_answers_end_the_steps(answers in prop::collection::vec(
        prop_oneof![
            prop::collection::vec(any::<u8>(), 0..10).prop_map(Ok),
            any::<u32>().prop_map(|code| Err(ObjectError::Aborted(AbortCode(code)))),
            prop::sample::select(AbortCode::ALL).prop_map(|code| Err(ObjectError::Aborted(code))),
            Just(Err(ObjectError::NoAnswer)),
        ],
        1..200,
    )) {
        let identity = Identity { device_type: Some(0), vendor_id: 0, product_codes: vec![1], revisions: Revisions::Any };
        let steps: Vec<Step> = process_data().into_iter().chain(cycle(500)).collect();
        let mut script = Script::new(identity, MS, steps);
        for answer in answers {
            let Ok(Some(_)) = script.wanted() else { break };
            let before = script.doing();
            if script.on_answer(Time(0), answer.as_ref().map(Vec::as_slice).map_err(|error| *error)).is_err() {
                break;
            }
            prop_assert!(!before.is_empty());
        }
    }
}

#[test]
fn the_cycle_time_is_written_in_the_largest_fitting_unit() {
    for (period_us, value, exponent) in [(1000, 1, -3i8), (4000, 4, -3), (500, 5, -4), (125, 125, -6), (10_000, 1, -2)]
    {
        assert_eq!(interpolation_time(period_us), Some((value, u32::from(exponent as u8))), "{period_us} us");
    }
    // 113 would be its low byte.
    assert_eq!(interpolation_time(625), None);
}

#[test]
fn a_speed_limit_is_told_in_turns_of_the_motor() {
    // 10 000 counts a turn, and 2 500 in 3 turns.
    assert_eq!(motor_speed(10_000, [10_000, 1]), Ok(60));
    assert_eq!(motor_speed(1_000, [2_500, 3]), Ok(72));
    assert_eq!(motor_speed(0, [10_000, 1]), Ok(1));
    assert_eq!(motor_speed(u32::MAX, [1, u32::MAX]), Ok(u32::MAX));
    for resolution in [[0, 1], [10_000, 0]] {
        let failure = motor_speed(10_000, resolution).unwrap_err();
        assert!(failure.to_string().contains("608Fh"), "{failure}");
    }
}

/// The steps of a drive that limits its torque by its current, 500 per mille of rated.
fn of_current(action: Action) -> [Step; 2] {
    let step = |sub, action| Step { doing: "set the torque limit", index: 0x3001, sub, bytes: 4, action };
    [step(1, Action::RatedCurrent), step(2, action)]
}

#[test]
fn a_limit_of_the_current_is_the_share_of_the_rated_current() {
    let mut device = Device::holding(&[(0x3001, 1, 4760), (0x3001, 2, 9520)]);
    device.take(&of_current(Action::LimitCurrent { per_mille: 500 })).unwrap();
    assert_eq!(device.written, [(Address::new(0x3001, 2), 2380)]);
    // It stands now.
    device.take(&of_current(Action::LimitCurrent { per_mille: 500 })).unwrap();
    assert_eq!(device.written.len(), 1);
    let mut empty = Device::holding(&[(0x3001, 1, 0), (0x3001, 2, 9520)]);
    let refused = empty.take(&of_current(Action::LimitCurrent { per_mille: 500 }));
    assert_eq!(refused, Err(BootFailure::NoRating { index: 0x3001, sub: 1 }));
    assert!(empty.written.is_empty());
}

#[test]
fn a_limit_that_the_drive_keeps_allows_no_more_than_the_rig() {
    for (held, end) in
        [(2380, Ok(())), (2381, Err(BootFailure::KeepsMore { index: 0x3001, sub: 2, held: 2381, most: 2380 }))]
    {
        let mut device = Device::holding(&[(0x3001, 1, 4760), (0x3001, 2, held)]).fixed(&[(0x3001, 2)]);
        assert_eq!(device.take(&of_current(Action::KeepsCurrent { per_mille: 500 })), end);
        assert!(device.written.is_empty());
    }
}
