//! The table in `docs/faults.md`, which is this one.

use std::fmt::Write;

use super::*;

/// Start of the table in the page.
const MARK: &str = "<!-- From here on: the table of src/motion/guard/fault/table.rs, compared by a test. -->\n";

fn stage(stage: Stage) -> &'static str {
    match stage {
        Stage::Operator => "The person",
        Stage::Sensing => "Force sensor",
        Stage::Bus => "Frames that arrive",
        Stage::Drives => "Drives",
        Stage::Arm => "Arm",
        Stage::Motion => "Reference and command",
        Stage::Host => "This computer",
        Stage::Link => "Way to the bus",
    }
}

fn rendered() -> String {
    let mut text = String::new();
    let stages = [
        Stage::Operator,
        Stage::Sensing,
        Stage::Bus,
        Stage::Drives,
        Stage::Arm,
        Stage::Motion,
        Stage::Host,
        Stage::Link,
    ];
    for at in stages {
        let _ = write!(text, "\n## {}\n\n", stage(at));
        text.push_str("| fault | when: reaction, within, final state | meaning | frequent cause | what to do |\n");
        text.push_str("|---|---|---|---|---|\n");
        for row in TABLE.iter().filter(|row| row.stage == at) {
            let FaultRow { name, meaning, cause, next, .. } = row;
            let mut ends = (format!("`{name}`"), format!("{meaning} | {cause} | {next}"));
            for step in row.steps {
                let state = row.final_state(step.reaction);
                let Step { reaction, bound, .. } = step;
                let (first, last) = std::mem::replace(&mut ends, (String::new(), " | | ".to_owned()));
                let rate = row.rate_in_words(step);
                let _ = writeln!(text, "| {first} | {rate}: **{reaction}**, {bound}, {state:?} | {last} |");
            }
        }
    }
    text
}

#[test]
fn the_page_shows_this_table() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/faults.md");
    let page = std::fs::read_to_string(path).unwrap();
    let (head, shown) = page.split_once(MARK).expect("the mark before the table");
    if std::env::var_os("REFRESH_PAGES").is_some() {
        std::fs::write(path, format!("{head}{MARK}{}", rendered())).unwrap();
        return;
    }
    assert!(
        shown == rendered(),
        "docs/faults.md is stale; refresh it with\n  REFRESH_PAGES=1 cargo test -p yieldwall-motion --lib the_page_shows_this_table"
    );
}

#[test]
fn every_fault_stands_on_the_page_once() {
    let page = rendered();
    for row in &TABLE {
        assert_eq!(page.matches(&format!("| `{}` |", row.name)).count(), 1, "{}", row.name);
    }
}
