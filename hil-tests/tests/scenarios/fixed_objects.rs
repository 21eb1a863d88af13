//! Drives whose objects cannot all be written: what they hold already passes, and what differs is refused by name.

use std::process::Command;

use yieldwall::bus::BootFailure;
use yieldwall::config::{Source, load_rig};
use yieldwall::rig::{EmbeddedRig, RigError};

/// A rig in position mode whose simulated drives have these objects, as items of YAML.
fn boot(network: &str, objects: &[&str]) -> Result<(), BootFailure> {
    let objects: String = objects.iter().map(|object| format!("      - {{{object}}}\n")).collect();
    let text = format!(
        "like: builtin:paper-admittance.yaml\nrig: {{name: odd, command_mode: position}}\n{network}simulation:\n  drive_model:\n    profile: \
         simulated-servo\n    has_dummies: true\n    refuses_mode: false\n    sdo_server: {{answer_ms: 0, segments_only: false, \
         lengths: []}}\n    objects:\n{objects}"
    );
    let rig = load_rig(Source::memory("rig.yaml", text.as_str())).unwrap_or_else(|error| panic!("{error:?}: {text}"));
    let scene = rig.scene().unwrap().value;
    let mut machine = EmbeddedRig::new(&rig.value, &scene, &rig.value.fixture, 1).unwrap();
    match machine.enable() {
        Ok(_) => Ok(()),
        Err(RigError::Boot(error)) => Err(error.failure),
        Err(other) => panic!("{other}: {text}"),
    }
}

const CAN: &str = "";
const SEGMENT: &str = "buses: {main: {ethercat: {}}}\ndrives: [{name: left, address: {ethercat: {position: 0}}}, {name: right, address: \
                       {ethercat: {position: 1}}}]\nsensor:\n  protocol: {ethercat: {position: 2}}\n  sample_rate_hz: 8000\n  calibration: \
                       [[1.0e-6, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 1.0e-6, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0e-6, 0.0, 0.0, 0.0], [0.0, \
                       0.0, 0.0, 1.0e-6, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 1.0e-6, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0e-6]]\n  \
                       range_counts: 500000000\n";

fn yieldwall(line: &str) -> (Option<i32>, String) {
    let folder = std::env::temp_dir().join(format!("yieldwall-fixed-{}", std::process::id()));
    let mut program = Command::new(hil_tests::program());
    let seen = hil_tests::processes::output(program.args(line.split(' ')).env("XDG_STATE_HOME", folder));
    (seen.status.code(), [seen.stdout, seen.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat())
}

#[test]
fn drives_of_vendors_with_fixed_objects_are_drilled_and_run() {
    for vendor in [
        "ethercat-fixed-mapping",
        "ethercat-own-synchronisation",
        "fixed-exponent",
        "fixed-standard-mapping",
        "no-remote-frames",
        "slow-memory",
    ] {
        let (code, text) = yieldwall(&format!("run builtin:vendors/{vendor}.yaml --duration 0.3"));
        assert_eq!(code, Some(0), "{vendor}: {text}");
    }
}

/// The objects of position mode in the first PDOs.
const MAPPED: [&str; 6] = [
    "index: 0x1600, sub: 0, holds: 2, read_only: true",
    "index: 0x1600, sub: 1, holds: 0x60400010, read_only: true",
    "index: 0x1600, sub: 2, holds: 0x607a0020, read_only: true",
    "index: 0x1a00, sub: 0, holds: 2, read_only: true",
    "index: 0x1a00, sub: 1, holds: 0x60410010, read_only: true",
    "index: 0x1a00, sub: 2, holds: 0x60640020, read_only: true",
];

#[test]
fn process_data_that_are_fixed_pass_as_they_are_wanted() {
    // Types too, on CAN; the assignment too, on EtherCAT.
    let types =
        ["index: 0x1400, sub: 2, holds: 1, read_only: true", "index: 0x1800, sub: 2, holds: 1, read_only: true"];
    let assignment = ["index: 0x1c12, read_only: true", "index: 0x1c13, read_only: true"];
    for (base, more) in [(CAN, &[][..]), (CAN, &types[..]), (SEGMENT, &[]), (SEGMENT, &assignment)] {
        assert_eq!(boot(base, &[&MAPPED, more].concat()), Ok(()), "{base} {more:?}");
    }
    // The assignment alone is fixed, and what it assigns is mapped anew.
    assert_eq!(boot(SEGMENT, &assignment), Ok(()));
    // How many objects count can be written, which ones cannot.
    let mut counted = MAPPED;
    counted[0] = "index: 0x1600, sub: 0, holds: 1";
    assert_eq!(boot(CAN, &counted), Ok(()));
    // Nothing is assigned yet.
    let unassigned = ["index: 0x1c12, sub: 0, holds: 0", "index: 0x1c13, sub: 0, holds: 0"];
    assert_eq!(boot(SEGMENT, &[&MAPPED[..], &unassigned].concat()), Ok(()));
}

#[test]
fn process_data_that_are_fixed_and_differ_are_refused_by_name() {
    for base in [CAN, SEGMENT] {
        let mut other = MAPPED;
        other[2] = "index: 0x1600, sub: 2, holds: 0x60ff0020, read_only: true";
        let failure = boot(base, &other).unwrap_err();
        let BootFailure::Keeps { index: 0x1600, sub: 2, held, wanted, .. } = failure else { panic!("{failure}") };
        assert_eq!((held, wanted), (0x60ff_0020, 0x607a_0020));
        assert!(failure.to_string().contains("read-only") && failure.to_string().contains("pdo show"), "{failure}");
    }
}

#[test]
fn identifiers_keep_bit_30_of_tpdos_alone() {
    // A device that does not insist on it, and one that is switched to make SYNC and TIME.
    assert_eq!(boot(CAN, &["index: 0x1800, sub: 1, holds: 0x40000181"]), Ok(()));
    assert_eq!(boot(CAN, &["index: 0x1800, sub: 1, needed_bits: 0x40000000"]), Ok(()));
    let failure = boot(CAN, &["index: 0x1005, sub: 0, holds: 0x40000080, read_only: true"]).unwrap_err();
    let BootFailure::Keeps { index: 0x1005, held: 0x4000_0080, wanted: 0x80, .. } = failure else {
        panic!("{failure}")
    };
    let failure = boot(CAN, &["index: 0x1800, sub: 1, holds: 0xc0000190, read_only: true"]).unwrap_err();
    assert!(matches!(failure, BootFailure::Keeps { index: 0x1800, sub: 1, held: 0xc000_0190, .. }), "{failure}");
}

#[test]
fn a_fixed_unit_of_the_cycle_time_is_used_or_refused_by_name() {
    for base in [CAN, SEGMENT] {
        let exponent = |value: i8, rest: &str| format!("index: 0x60c2, sub: 2, holds: {value}{rest}");
        let value = "index: 0x60c2, sub: 1, holds: 1, read_only: true";
        assert_eq!(boot(base, &[&exponent(-4, ", read_only: true")]), Ok(()), "10 times 10^-4 s");
        assert_eq!(boot(base, &[value, &exponent(-3, ", read_only: true")]), Ok(()), "all of it is fixed");
        assert_eq!(boot(base, &[&exponent(-6, "")]), Ok(()), "1000 us are too many");
        for fixed in [-6, -2] {
            let failure = boot(base, &[&exponent(fixed, ", read_only: true")]).unwrap_err();
            assert!(
                matches!(failure, BootFailure::FixedExponent { period_us: 1000, exponent, .. } if exponent == fixed),
                "{failure}"
            );
            assert!(failure.to_string().contains("60C2h:2 holds"), "{failure}");
        }
    }
}

#[test]
fn a_drive_that_sets_its_synchronisation_by_itself_is_judged_by_it() {
    let fixed = ["index: 0x1c32, sub: 1, read_only: true", "index: 0x1c33, sub: 1, read_only: true"];
    assert_eq!(boot(SEGMENT, &fixed), Ok(()), "2 as soon as SYNC0 is there");
    assert_eq!(boot(SEGMENT, &["index: 0x1c32, absent: true", "index: 0x1c33, absent: true"]), Ok(()));
    assert_eq!(boot(SEGMENT, &["index: 0x1c33, absent: true"]), Ok(()));
    let on_arrival = SEGMENT.replace("ethercat: {}", "ethercat: {outputs: on_arrival}");
    assert_eq!(boot(&on_arrival, &["index: 0x1c32, sub: 1"]), Ok(()));
    let failure = boot(&on_arrival, &fixed).unwrap_err();
    assert!(
        matches!(failure, BootFailure::Synchronisation { index: 0x1c32, sub: 1, wanted: 1, received: 2 }),
        "{failure}"
    );
}

#[test]
fn a_slow_memory_is_waited_for_ten_seconds() {
    let (code, text) = yieldwall("od write left max-torque 900 --save --yes --rig builtin:vendors/slow-memory.yaml");
    assert_eq!(code, Some(0), "{text}");
    assert!(text.contains("stored"), "{text}");
}

#[test]
fn a_device_that_does_not_store_on_command_is_named_before_it_is_told_to() {
    let file = std::env::temp_dir().join(format!("yieldwall-stores-{}.yaml", std::process::id()));
    let text = |answer: u8| {
        format!(
            "like: builtin:paper-admittance.yaml\nsimulation:\n  drive_model:\n    profile: simulated-servo\n    has_dummies: true\n    \
             refuses_mode: false\n    sdo_server: {{answer_ms: 0, segments_only: false, lengths: []}}\n    objects: [{{index: 0x1010, sub: 1, \
             holds: {answer}}}]\n"
        )
    };
    for (answer, says) in
        [(0, Some("does not store on command, by its 1010h:1")), (2, Some("stores by itself")), (3, None)]
    {
        std::fs::write(&file, text(answer)).unwrap();
        let (code, text) = yieldwall(&format!("od write left max-torque 900 --save --yes --rig {}", file.display()));
        assert_eq!(code, Some(0), "{text}");
        assert_eq!(text.contains("⚠"), says.is_some(), "{text}");
        assert!(says.is_none_or(|says| text.contains(says)) && text.contains("stored"), "{text}");
    }
    std::fs::remove_file(&file).unwrap();
}

#[test]
fn a_drive_in_fault_that_takes_no_mode_is_named_with_the_command_that_resets_it() {
    let file = std::env::temp_dir().join(format!("yieldwall-in-fault-{}.yaml", std::process::id()));
    for vendor in ["fixed-standard-mapping", "ethercat-fixed-assignment"] {
        let shipped = Source::named(&format!("builtin:vendors/{vendor}.yaml")).read().unwrap().to_string();
        let rig = shipped.replace("../", "builtin:").replace(" profiles/", " builtin:vendors/profiles/");
        assert_eq!(rig.matches("    has_dummies: true\n").count(), 1, "{rig}");
        let rig = rig.replace("    has_dummies: true\n", "    has_dummies: true\n    fault_code: 0x7121\n");
        std::fs::write(&file, rig).unwrap();
        let (code, text) = yieldwall(&format!("run {} --duration 0.3", file.display()));
        assert_eq!(code, Some(5), "{text}");
        let words = text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(words.contains("a drive in Fault takes no other mode"), "{text}");
        assert!(words.contains("`yieldwall state NODE --reset-fault`"), "{text}");
    }
    std::fs::remove_file(&file).unwrap();
}
