//! `explain` says what `run` and the commands for devices say.

use super::*;
use crate::ending::stopped_by;
use crate::on_bus::{different, text as emergency_text, with_told};
use yieldwall_bus::EmergencyReport;
use yieldwall_config::shipped_error_codes;
use yieldwall_drives::codes::SHIPPED;
use yieldwall_fieldbus::canopen::{EmcyCode, ErrorRegister};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::guard::{Cause, Device, DeviceSet, Fault};

fn told(word: &str, codes: Option<&ErrorCodes>) -> String {
    let found = meanings(word, codes).unwrap_or_else(|failure| panic!("{word}: {failure:?}"));
    let each = found.iter().map(|Meaning { explanation, more }| {
        let more: String = more.iter().map(|(key, says)| format!("{key}: {says}\n")).collect();
        let Explanation { name, meaning, cause, next, .. } = explanation;
        format!("name: {name}\nmeaning: {meaning}\ncause: {cause}\nnext: {next}\n{more}")
    });
    each.collect()
}

fn shipped_rig() -> Rig {
    config::load_rig(Source::named("builtin:paper-admittance.yaml")).unwrap().value
}

/// Every fault of the table and every injection, in the words that `run` says of them.
#[test]
fn faults_and_injections_are_explained_in_the_words_of_run() {
    let rig = shipped_rig();
    for row in &TABLE {
        let text = told(row.name, None);
        assert!([row.meaning, row.cause, row.next].iter().all(|words| text.contains(words)), "{text}");
        let cause = Cause { fault: row.fault, devices: DeviceSet::LEFT_DRIVE };
        let failure = stopped_by(Some(cause), 1.0, &rig);
        let finding = &failure.report.diagnostics[0];
        let explained = explanation::fault(row.fault);
        assert!(finding.message.contains(&*explained.meaning), "{}", finding.message);
        assert!(finding.message.contains(&*explained.cause), "{}", finding.message);
        assert_eq!(finding.help.as_deref(), Some(&*explained.next));
    }
    for row in &CATALOGUE {
        let text = told(row.name, None);
        assert!(text.contains(row.meaning) && text.contains(&faults::consequence(row)), "{text}");
        for fault in row.expected.faults {
            assert!(text.contains(fault.row().next), "{}: {text}", row.name);
        }
    }
}

#[test]
fn each_defect_is_explained_with_the_step_that_finds_it() {
    for row in &DEFECTS {
        let text = told(row.name, None);
        assert!(text.contains(row.meaning) && text.contains(&format!("`{}`", row.found_by.name())), "{text}");
        assert_eq!(text.contains("unless it is given"), row.size.is_some(), "{text}");
    }
}

/// Each code of each vendor's table: `explain`, and the message and the advice of a run that the code has stopped.
#[test]
fn codes_of_vendors_are_explained_in_the_words_of_run() {
    let mut count = 0;
    for (name, _) in SHIPPED {
        let table = shipped_error_codes(name).unwrap_or_else(|| panic!("{name} cannot be read"));
        let mut rig = shipped_rig();
        rig.drives[0].profile = ProfileName::from((*name).to_owned());
        assert_eq!(rig.drives[0].profile.error_codes().map(|table| &table.error_codes.name[..]), Some(*name));
        for code in &table.codes {
            count += 1;
            let explained = told(&format!("{:04X}h", code.code), Some(&table));
            let (device, register, vendor) = (Device::LeftDrive, ErrorRegister(1), [0; 5]);
            let (time, is_withdrawn, code_told) = (Time::default(), false, EmcyCode(code.code));
            let heard = [EmergencyReport { time, device, code: code_told, register, vendor, is_withdrawn }];
            let said = emergency_text(&heard[0], &rig);
            for words in [&code.meaning, &code.cause] {
                assert!(explained.contains(words.as_str()) && said.contains(words.as_str()), "{explained}\n{said}");
            }
            let cause = Cause { fault: Fault::Emergency, devices: DeviceSet::LEFT_DRIVE };
            let failure = with_told(stopped_by(Some(cause), 1.0, &rig), &different(heard.into_iter()), &[], &rig);
            let help = failure.report.diagnostics[0].help.clone().unwrap();
            assert!(explained.contains(&code.next) && help.contains(&code.next), "{explained}\n{help}");
            assert!(explained.contains(&format!("name: {}\n", code.name)), "{explained}");
        }
    }
    assert!(count >= 40, "{count}");
}

#[test]
fn codes_are_explained_however_they_are_written() {
    for word in ["8130h", "0x8130", "8130", "0X8130", "8130H"] {
        assert!(told(word, None).contains("meaning: heartbeat or life guarding lost"), "{word}");
    }
    for code in AbortCode::ALL {
        let text = told(&format!("{:08X}h", code.0), None);
        assert!([code.meaning(), code.likely_cause(), code.next()].iter().all(|words| text.contains(words)), "{text}");
    }
    for code in AlStatusCode::ALL.iter().filter(|code| code.0 != 0) {
        let text = told(&format!("{:04X}h", code.0), None);
        assert!(text.contains(code.meaning()) && text.contains(code.likely_cause()), "{text}");
    }
    assert!(told("0x0637", None).contains("name: Operation Enabled"), "{}", told("0x0637", None));
    assert!(told("1208h", None).contains("name: Fault"), "{}", told("1208h", None));
    for word in ["node-rest", "xyzzy", "", "123456789", "-1", "8130x"] {
        assert!(meanings(word, None).is_err(), "{word}");
    }
}

fn kinds(word: &str) -> Vec<&'static str> {
    meanings(word, None)
        .unwrap()
        .iter()
        .map(|meaning| meaning.explanation.what.split([' ', ',']).nth(1).unwrap())
        .collect()
}

/// An improbable reading does not appear beside a likely one.
#[test]
fn the_likeliest_reading_comes_first_and_an_unlikely_one_not_at_all() {
    for (word, wanted) in [
        ("8130h", &["error"][..]),
        ("8250h", &["error", "statusword"]),
        ("7380h", &["error"]),
        ("0250h", &["statusword"]),
        ("0637h", &["statusword"]),
        ("6041h", &["object", "error"]),
        ("0027h", &["AL", "statusword"]),
        ("0200h", &["error", "statusword"]),
        ("06090011h", &["SDO"]),
        ("60410010h", &["mapped"]),
        ("007F0028h", &["watched"]),
        ("00050008h", &["mapped", "watched"]),
        ("80000201h", &["COB-ID"]),
        ("0F00FFC0h", &["SDO"]),
        ("12345678h", &["SDO"]),
        ("1018h:2", &["object"]),
    ] {
        assert_eq!(kinds(word), wanted, "{word}");
    }
    assert!(told("007F0028h", None).contains("heartbeat of node 127 is watched: it comes within 40 ms"));
    assert!(told("60410010h", None).contains("6041h:0 statusword, 16 bits"));
}

#[test]
fn names_of_objects_and_codes_are_explained_and_slips_understood() {
    for (word, wanted) in [
        ("statusword", "statusword (CiA 402)"),
        ("max-torque", "torque limit in per mille"),
        ("no-sub-index", "the object has no such sub-index"),
        ("following-error-window", "allowed following error"),
        ("over-current", "continuous over-current"),
        ("heartbeat-lost", "heartbeat or life guarding lost"),
    ] {
        assert!(told(word, None).contains(wanted), "{word}: {}", told(word, None));
    }
    assert_eq!(kinds("heartbeat-lost"), ["fault", "error"]);
    for (word, wanted) in
        [("statuswrod", "statusword"), ("no-sub-indx", "no-sub-index"), ("over-curent", "over-current")]
    {
        let failure = meanings(word, None).err().unwrap();
        assert_eq!(failure.report.diagnostics[0].help, Some(format!("did you mean {wanted}?")), "{word}");
    }
    let table = shipped_error_codes("maxon-epos4").unwrap();
    assert!(told("position-sensor-breach", Some(&table)).contains("signals of the position sensor"));
}

#[test]
fn a_code_is_meant_by_the_vendor_of_the_device() {
    let table = shipped_error_codes("zeroerr-edriver").unwrap();
    let (of_vendor, of_standard) = (told("730Dh", Some(&table)), told("730Dh", None));
    assert!(of_vendor.contains("battery") && !of_standard.contains("battery"), "{of_vendor}{of_standard}");
    // What a table does not have is said by the standards.
    assert_eq!(told("8120h", Some(&table)), told("8120h", None));
    let mut output = Output::new(true, false, false);
    let arguments = |profile: Option<&str>, rig: Option<&str>, node: Option<&str>| Arguments {
        words: Vec::new(),
        profile: profile.map(str::to_owned),
        rig: rig.map(str::to_owned),
        node: node.map(str::to_owned),
    };
    let mut found = |profile, rig, node| codes(&arguments(profile, rig, node), &mut output);
    assert_eq!(found(Some("elmo-gold"), None, None).unwrap().unwrap().error_codes.name, "elmo-gold");
    let rig = Some("builtin:paper-admittance.yaml");
    for node in ["left", "2", "wrist"] {
        assert!(
            found(None, rig, Some(node)).unwrap().is_none(),
            "{node}: the simulated devices have the standard's codes"
        );
    }
    assert_eq!(found(None, rig, Some("nobody")).unwrap_err().exit, Exit::Usage);
    let refused = found(Some("elmo-glod"), None, None).unwrap_err();
    assert_eq!(refused.report.diagnostics[0].help.as_deref(), Some("did you mean elmo-gold?"));
}

/// Paragraphs keep to 80 columns.
#[test]
fn lines_are_not_longer_than_a_terminal_is_wide() {
    for row in &TABLE {
        let text = lines(4, &explanation::fault(row.fault));
        assert!(text.lines().all(|line| line.chars().count() <= COLUMNS), "{text}");
    }
}
