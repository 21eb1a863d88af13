//! Force sensors that are described by their files alone, on CANopen and EtherCAT.

use std::path::PathBuf;
use std::process::Command;
use std::sync::Arc;

use hil_tests::Scenario;
use yieldwall::config::{self, Loaded, Report, Rig, Source, builtin, load_rig};
use yieldwall::guard::State;
use yieldwall::rig;
use yieldwall::run::Demands;

/// The rig of a text, with a profile beside it.
fn load(rig: &str, profile: &str) -> Result<Loaded<Rig>, Report> {
    let texts = [("rig.yaml", rig.to_owned()), ("sensor.yaml", profile.to_owned())];
    load_rig(Source::among("rig.yaml", texts.map(|(name, text)| (PathBuf::from(name), Arc::from(text)))))
}

fn text(name: &str) -> String {
    builtin(name).read().unwrap().to_string()
}

/// The rig on CAN with this profile of its sensor.
fn on_can(profile: &str, changes: &[(&str, &str)]) -> Result<Loaded<Rig>, Report> {
    let rig = text("paper-admittance.yaml").replace("profile: simulated-force-sensor", "profile: sensor.yaml");
    let rig = changes.iter().fold(rig, |rig, (from, to)| {
        assert!(rig.contains(from), "{from}");
        rig.replace(from, to)
    });
    load(&rig, profile)
}

fn run(rig: &Rig) -> State {
    let mut scenario = Scenario::torque();
    scenario.rig.sensor = rig.sensor.clone();
    scenario.run(2000).machine.state()
}

/// Floats over three TPDOs of CANopen, without status and counter.
fn floats_on_can() -> String {
    let whole = text("profiles/simulated-force-sensor.yaml");
    let objects = whole[..whole.find("      status: {").unwrap()].replace("bits: 16", "bits: 32");
    objects
        + "      numbers: real\n      status: null\n      sample_counter: null\n    mapping_entries: 8\n    process_data:\n      rpdo: []\n      \
           tpdo:\n        - {number: 1, maps: [fx, fy]}\n        - {number: 2, maps: [fz, tx]}\n        - {number: 3, maps: [ty, tz]}\n    \
           status_bits: {overload: 0, invalid: 0}\n    sample_rates_hz: [200, 500, 1000]\n    scaling: {constant: {per_n: 160, per_n_m: \
           3333}}\n"
}

#[test]
fn a_sensor_with_floats_on_canopen_runs_by_its_file() {
    let rig = on_can(&floats_on_can(), &[]);
    let rig = rig.unwrap_or_else(|report| panic!("{report}")).value;
    assert_eq!(run(&rig), State::Running);
}

#[test]
fn process_data_for_ethercat_are_refused_on_can() {
    let report = on_can(&text("profiles/ati-ethercat.yaml"), &[]).unwrap_err().to_string();
    assert!(report.contains("is not written for CANopen"), "{report}");
}

#[test]
fn a_sensor_on_canopen_zeroes_itself_by_the_objects_of_its_profile() {
    let profile = text("profiles/simulated-force-sensor.yaml");
    let key = "profile: sensor.yaml";
    let zeroed = on_can(&profile, &[(key, "profile: sensor.yaml\n      zero_at_start: true")]).unwrap().value;
    assert!(zeroed.sensor.protocol.zero_at_start());
    assert_eq!(run(&zeroed), State::Running);
    let without = &profile[..profile.find("    zero:").unwrap()];
    let report = on_can(without, &[(key, "profile: sensor.yaml\n      zero_at_start: true")]).unwrap_err();
    assert!(report.to_string().contains("does not say how the sensor zeroes itself"), "{report}");
}

fn yieldwall(line: &str) -> (Option<i32>, String) {
    let folder = std::env::temp_dir().join(format!("yieldwall-sensors-{}", std::process::id()));
    let mut program = Command::new(hil_tests::program());
    let seen = hil_tests::processes::output(program.args(line.split(' ')).env("XDG_STATE_HOME", folder));
    (seen.status.code(), [seen.stdout, seen.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat())
}

#[test]
fn sensors_of_files_are_drilled_and_run_on_the_segment() {
    for name in ["float-sensor", "sensor-without-counter"] {
        let rig = load_rig(builtin(format!("vendors/{name}.yaml"))).unwrap();
        let warnings: Vec<&str> = rig.warnings.iter().map(|warning| warning.message.as_str()).collect();
        assert!(matches!(warnings[..], [one] if one.contains("has no sample counter")), "{warnings:?}");
        let scene = rig.scene().unwrap().value;
        let drilled = rig::drill(&rig.value, &scene, |_| ()).unwrap();
        drilled.judge(Demands::of(&rig.value)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let (code, said) = yieldwall(&format!("run builtin:vendors/{name}.yaml --duration 0.3"));
        assert!(code == Some(0) && said.contains("has no sample counter"), "{name}: {said}");
    }
}

#[test]
fn a_profile_that_contradicts_rig_or_itself_is_refused_at_its_key() {
    let rig = |profile: &str| {
        let rig =
            text("vendors/float-sensor.yaml").replace("../paper-admittance.yaml", "builtin:paper-admittance.yaml");
        load(&rig.replace("profiles/float-sensor.yaml", "sensor.yaml"), profile)
    };
    let good = text("vendors/profiles/float-sensor.yaml");
    assert!(rig(&good).is_ok());
    for (from, to, key, says) in [
        ("numbers: real", "numbers: double", "device.force_sensor.objects.numbers", "double"),
        ("sub: 3, bits: 32", "sub: 3, bits: 20", "device.force_sensor.objects.channels[0].bits", "is 20"),
        ("sub: 3, bits: 32", "sub: 3, bits: 24", "device.force_sensor.objects.channels[0].bits", "`real` have 32 bits"),
        (
            "number: 0x1a00",
            "number: 0x1600",
            "device.force_sensor.process_data.tpdo[0].number",
            "no mapping of this direction",
        ),
        ("            - tz\n", "", "device.force_sensor.process_data.tpdo", "does not carry `tz`"),
        (
            "            - tz\n",
            "            - ty\n",
            "device.force_sensor.process_data.tpdo[0].maps[7]",
            "mapped before",
        ),
        ("            - status\n", "", "device.force_sensor.process_data.tpdo", "does not carry `status`"),
        (
            "            - tz\n",
            "            - sample_counter\n",
            "device.force_sensor.process_data.tpdo[0].maps[7]",
            "does not have",
        ),
        ("            - tz\n", "            - torque\n", "device.force_sensor.process_data.tpdo[0].maps[7]", "torque"),
        ("mapping_entries: 16", "mapping_entries: 4", "device.force_sensor.process_data.tpdo[0].maps", "11 objects"),
        (
            "rpdo: []",
            "rpdo: [{number: 1, maps: [fx]}]",
            "device.force_sensor.process_data.rpdo[0].maps[0]",
            "does not go this way",
        ),
        ("overload: 0xffff,", "overload: 0x10000,", "device.force_sensor.status_bits.overload", "does not have"),
        ("per_n: 1000000,", "per_n: 0,", "device.force_sensor.scaling.constant.per_n", "is 0"),
        ("per_n: 1000000,", "per_n: 1000,", "sensor.calibration", "1000000 counts per N, and the profile"),
        (
            "sub: 1, bits: 8, source: here}, value: 1}",
            "sub: 1, bits: 8, source: here}, value: 300}",
            "device.force_sensor.zero[0].value",
            "300",
        ),
        ("sample_rates_hz: [400, 800, 1000]", "sample_rates_hz: [400]", "sensor.sample_rate_hz", "does not have"),
    ] {
        assert!(good.contains(from), "{from}");
        let report = rig(&good.replace(from, to)).err().unwrap_or_else(|| panic!("{from} -> {to} was accepted"));
        let is_it = |finding: &config::Diagnostic| finding.key == key && finding.message.contains(says);
        assert!(report.diagnostics.iter().any(is_it), "{from} -> {to}: {:?}", report.diagnostics);
    }
    let without = &good[..good.find("    scaling:").unwrap()];
    assert!(rig(without).unwrap_err().to_string().contains("counted by"));
}

/// A sensor that repeats its last sample: without a counter its noise alone shows that.
#[test]
fn without_a_counter_a_sensor_that_repeats_itself_is_stuck_and_not_stale() {
    for (rig, fault) in
        [("paper-ethercat.yaml", "sensor-stale"), ("vendors/sensor-without-counter.yaml", "sensor-stuck")]
    {
        let (_, said) = yieldwall(&format!("run builtin:{rig} --duration 1 --fault sensor-stale@0.5"));
        assert!(said.contains(fault), "{rig}: {said}");
    }
}
