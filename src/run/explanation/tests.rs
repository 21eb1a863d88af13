use super::*;
use yieldwall_drives::cia402::State;
use yieldwall_drives::codes::{About, ErrorCode};

fn table() -> ErrorCodes {
    let code = ErrorCode {
        code: 0x8130,
        name: "own-name".to_owned(),
        meaning: "own meaning".to_owned(),
        cause: "own cause".to_owned(),
        next: "own advice".to_owned(),
        source: "manual".to_owned(),
    };
    let sources = [("manual".to_owned(), "the manual".to_owned())].into();
    ErrorCodes { error_codes: About { name: "maker".to_owned(), sources }, codes: vec![code] }
}

#[test]
fn a_vendors_words_stand_before_the_standards() {
    let table = table();
    let of_vendor = error_code(0x8130, Some(&table));
    assert_eq!(of_vendor.to_string(), "8130h own meaning (own cause)");
    assert_eq!((&*of_vendor.next, of_vendor.source.as_deref()), ("own advice", Some("the manual (table maker)")));
    assert_eq!(error_code(0x8120, Some(&table)), error_code(0x8120, None));
    assert_eq!(error_code(0x8130, None).name, "heartbeat-lost");
}

#[test]
fn messages_have_code_meaning_and_cause() {
    assert_eq!(
        abort(AbortCode::NO_SUB_INDEX).to_string(),
        "06090011h the object has no such sub-index (fewer entries on this device than expected)"
    );
    assert_eq!(
        fault(Fault::HeartbeatLost).to_string(),
        "heartbeat-lost: a node's heartbeat stayed away, or it left Operational (the node stopped, or its cable is loose)"
    );
    let word = statusword(0x1208);
    assert_eq!((&*word.name, word.code.as_deref()), ("Fault", Some("1208h")));
    assert!(word.meaning.contains("the drive has found a fault") && word.meaning.contains("follows the set-point"));
}

#[test]
fn every_word_has_a_meaning_a_cause_and_advice() {
    for word in 0..=u16::MAX {
        for Explanation { name, meaning, cause, next, .. } in [error_code(word, None), statusword(word)] {
            assert!([name, meaning, cause, next].iter().all(|text| !text.is_empty()), "{word:04x}");
        }
    }
    for state in State::ALL {
        assert_eq!(state_name(Some(state)).replace(' ', ""), format!("{state:?}"));
    }
}
