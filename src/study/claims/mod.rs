//! What `docs/studies.md` says is held against the tables in `docs/data`.
//!
//! # Claims
//!
//! A claim stands in a comment behind its sentence, and several are divided by semicolons:
//! ```text
//! <!-- claim: max(hold-pushes delay_max_s rule=automatic) < 0.2; sum(hold-pushes never) = 0 -->
//! ```
//! A claim compares two formulas by `=`, `!=`, `<`, `<=`, `>` or `>=`, or a formula with numbers:
//! ```text
//! <!-- claim: max(fixture tangent_error_f_kappa) in 5..6; max(fixture tangent_error_f_kappa) ~ 5.3 -->
//! ```
//! `in` means between the two, or one of them. `~` means equal when rounded to as many digits; `~ 48e1` is 480 with two digits.
//!
//! A formula has numbers, `+ - * /` between blanks, brackets, `abs(...)` and calls:
//! - `value(TABLE FORMULA CONDITION ...)`: what the formula gives in the one row that meets all conditions,
//! - `max(...)`, `min(...)`, `sum(...)`: of all rows that do, at least one,
//! - `count(TABLE CONDITION ...)`: how many do.
//!
//! In the formula of a call the name of a column is the number in it:
//! ```text
//! <!-- claim: max(energy-swinging virtual_kg / least_kg) < 0.9; count(stability-mass-rows reference_kg>1.25*measured_kg) = 8 -->
//! ```
//! A condition is `COLUMN` `=`, `!=`, `<`, `<=`, `>` or `>=` a word, a word in quotes, a number, or a number times another column, all
//! without blanks. Empty cells are `''`.
//!
//! # What several claims are about
//!
//! A table and conditions before a colon hold for the claims up to the next colon. Calls leave out the table then, and the name of a column
//! is the number in the one row that there is. Square brackets have more conditions. What a call or brackets say of a column takes
//! the place of what stands before the colon. Conditions alone before a colon are added to those that stand with the last table:
//! ```text
//! <!-- claim: pair fixture=master delay_s=0.02: max(depth_m) = 0; hand_n_per_m=300: peak_n[tissue_n_per_m=0] > 27 -->
//! ```
//! The rows of another table that a call names have to meet these conditions too, as far as it has their columns.
//!
//! `each` and columns make a claim for each combination of what stands in them; how many there are is said first:
//! ```text
//! <!-- claim: control-settings law=pid is_elastic=false: each 96 rate_hz delay_cycles space feeds_forward: crossover_hz > 0 -->
//! <!-- claim: cycle-again outcome=ran each 80 variant bus mode period_ms: impacts = value(cycle-rigs impacts) -->
//! <!-- claim: cycle-rigs bus=EtherCAT mode=torque each 6 period_ms: printed_least_kg ~ 0.50..0.54 -->
//! <!-- claim: control-bus-load rate_hz<8000 each 5 rate_hz: cyclic_load[rate_hz=2*rate_hz] = 2 * cyclic_load -->
//! ```
//! `~ LOW..HIGH` means that the least and the greatest of them are, rounded, these two. In square brackets `rate_hz=2*rate_hz` wants
//! twice what the combination has.
//!
//! # Tables of the page
//!
//! Comments directly above a table of the page have formulas for the numbers in its cells, in their order, divided by commas. A number
//! has to be the value when rounded to as many digits:
//! ```text
//! <!-- cells: hold-impacts variant='' place=wall: through, 100 * share; row '{rule}, {window_ms} ms' -->
//! <!-- cells: column 'usual grips' grip=usual; column '{grip}' -->
//! | rule, window | usual grips | soft |
//! |---|---|---|
//! | N_wait, 15 ms | 1455 (48.5 %) | 99 (3.3 %) |
//! ```
//! - `row` and `column` have the text of a row's first cell or of a heading, and conditions. `{name}` stands for any text, which is put for
//!   `{name}` in the conditions, such as `column '{mm} mm' width_m={mm}e-3`, and is a condition itself if the table has such a column.
//!   The first that fits is taken; a row or a heading for which there is none is an error.
//! - A text with ` | ` in it is that of several cells. Where one is empty, it is the one above it.
//! - Formulas behind the colon of a `column` or a `row` are taken in place of those behind the table, in this order. `-` in their place
//!   stands for what no table has.
//! - A number that is left out is the same as the one before it, or its cell in the table is empty.
//! - `max_error_m as m` is printed with its unit, such as `3 nm`.
//! - With `limits .02 10`, `>10` may stand for more than 10 or for an empty cell, and `<.02` for less than 0.02.
//! - `corner` has the heading of a row's first cell, and conditions. `head 'cycle'` says that the row which begins so is a second line
//!   of headings, which is joined to the first.

mod cells;
mod formula;
mod tables;

use std::path::{Path, PathBuf};

use tables::Tables;

/// Sections in which a bullet point without a claim, or a table without formulas, is an error.
const CHECKED: [&str; 12] = [
    "ablation",
    "control",
    "cycle",
    "edge",
    "energy",
    "fixture",
    "hold",
    "pair",
    "plant",
    "speed",
    "stability",
    "task",
];
const CLAIM: &str = "<!-- claim:";
const CELLS: &str = "<!-- cells:";
const END: &str = "-->";

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs")
}

/// What a comment in a line says: `None` without such a comment, an error where it does not end.
fn comment<'a>(line: &'a str, begin: &str) -> Option<Result<&'a str, ()>> {
    let (_, rest) = line.split_once(begin)?;
    Some(rest.split_once(END).map(|(text, _)| text.trim()).ok_or(()))
}

/// All that is wrong with a page, a line each.
fn refuted(name: &str, page: &str, tables: &mut Tables) -> (usize, Vec<String>) {
    let (mut count, mut wrong) = (0, Vec::new());
    let (mut section, mut unproved): (&str, Option<usize>) = ("", None);
    let mut layout: Vec<&str> = Vec::new();
    let bare = |unproved: &mut Option<usize>, wrong: &mut Vec<String>| {
        wrong.extend(unproved.take().map(|line| format!("{name}:{line}: no claim stands behind this point")));
    };
    let lines: Vec<&str> = page.lines().collect();
    let mut is_in_table = false;
    for (index, line) in lines.iter().enumerate() {
        let number = index + 1;
        if let Some(heading) = line.strip_prefix("## ") {
            bare(&mut unproved, &mut wrong);
            section = heading;
        }
        let is_checked = CHECKED.contains(&section);
        if is_checked && (line.starts_with("- ") || line.starts_with("* ")) {
            bare(&mut unproved, &mut wrong);
            unproved = Some(number);
        }
        if line.starts_with('|') && !is_in_table {
            let end =
                lines[index..].iter().position(|line| !line.starts_with('|')).map_or(lines.len(), |rows| index + rows);
            if !layout.is_empty() {
                let (cells, told) = cells::refute(&layout.join("; "), &lines[index..end], tables);
                count += cells;
                wrong.extend(told.into_iter().map(|(row, why)| format!("{name}:{}: {why}", number + row)));
            } else if is_checked {
                wrong.push(format!("{name}:{number}: no formulas stand above this table"));
            }
            layout.clear();
        }
        is_in_table = line.starts_with('|');
        for begin in [CLAIM, CELLS] {
            match comment(line, begin) {
                None => {}
                Some(Err(())) => wrong.push(format!("{name}:{number}: a claim has to end in its line")),
                Some(Ok(text)) if begin == CELLS => layout.push(text),
                Some(Ok(text)) => {
                    unproved = None;
                    let (claims, told) = formula::refute(text, tables);
                    count += claims;
                    wrong.extend(told.into_iter().map(|why| format!("{name}:{number}: {why}")));
                }
            }
        }
        if !layout.is_empty() && comment(line, CELLS).is_none() {
            wrong.push(format!("{name}:{number}: a table has to stand below its formulas"));
            layout.clear();
        }
    }
    bare(&mut unproved, &mut wrong);
    if !layout.is_empty() {
        wrong.push(format!("{name}:{}: a table has to stand below its formulas", lines.len()));
    }
    (count, wrong)
}

#[test]
fn what_the_studies_are_said_to_show_stands_in_their_tables() {
    let page = std::fs::read_to_string(root().join("studies.md")).unwrap();
    let (count, wrong) = refuted("docs/studies.md", &page, &mut Tables::in_folder(root().join("data")));
    assert!(wrong.is_empty(), "{} of {count} claims do not hold:\n{}", wrong.len(), wrong.join("\n"));
    for section in CHECKED {
        assert!(page.contains(&format!("\n## {section}\n")), "no section {section}");
    }
    assert!(count >= 2000, "{count} claims are left");
}

const SMALL: &str = "index,law,grip,step_s,error_m,width_m\n\
    0,plastic,little damped,1,0.5,4\n\
    1,\"spring, cut\",soft,1,2,4\n\
    2,plastic,,2,4,5\n\
    3,\"spring, cut\",,2,6,\n";

/// Tables of which one is small, another has the same laws again, and the third lacks a row.
fn small(name: &str) -> (PathBuf, Tables) {
    let folder = std::env::temp_dir().join(format!("yieldwall-claims-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("study-small.csv"), SMALL).unwrap();
    std::fs::write(folder.join("study-small-again.csv"), "law,error_m\nplastic,1\n\"spring, cut\",3\n").unwrap();
    std::fs::write(folder.join("study-gap.csv"), "index,error_m\n0,1\n2,3\n").unwrap();
    (folder.clone(), Tables::in_folder(folder))
}

#[test]
fn a_claim_that_holds_is_not_told() {
    let (folder, mut tables) = small("holds");
    let right = [
        ("value(small error_m law=plastic grip='little damped') = 0.5", 1),
        ("2 * max(small error_m) - 1 + 6 / 3 > 12.9", 1),
        ("sum(small error_m law=plastic) in 4.4..4.6", 1),
        ("min(small error_m index>=1 index<2) = value(small error_m law='spring, cut' grip=soft)", 1),
        ("count(small grip='') + count(small grip!='') = 4; count(small) = 4", 2),
        ("10 - 2 * 3 - 1 = 3; 2 * (3 - 1) = 4; abs(2 - 5) = 3; 1000 * 0.021 = 21", 4),
        ("max(small error_m / width_m width_m>0) ~ 0.8; max(small abs(error_m - 5)) = 4.5", 2),
        ("count(small error_m<0.5*width_m) = 1; count(small error_m<=0.5*width_m) = 2", 2),
        ("2.44 ~ 2.4; 2.45 ~ 2.4; 2.45 ~ 2.5; 479.4 ~ 48e1; 1e-9 * 3 ~ 3e-9", 5),
        ("small law=plastic: error_m[step_s=1] = 0.5; count() = 2; step_s=2: error_m = 4; step_s=1: error_m = 0.5", 4),
        ("small step_s=1: law=plastic: error_m < error_m[law='spring, cut']", 1),
        (
            "small law=plastic step_s=1: error_m[step_s=2] = 4; max(error_m step_s>0) = 4; error_m[step_s=2*step_s] = 4",
            3,
        ),
        ("small each 2 step_s: error_m[law='spring, cut'] - error_m[law=plastic] > 1; max(error_m) ~ 2..6", 4),
        (
            "small step_s=1 each 2 law: error_m / value(small-again error_m) ~ 0.5..0.7; max(small-again error_m) > 0.9",
            4,
        ),
        ("small each 4 law step_s: error_m < 7", 4),
    ];
    for (claims, count) in right {
        assert_eq!(formula::refute(claims, &mut tables), (count, Vec::new()));
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_claim_that_does_not_hold_is_told_with_the_reason() {
    let (folder, mut tables) = small("told");
    let wrong = [
        ("value(small error_m index=2) < 4", "4 < 4"),
        ("max(small error_m) in 6.1..7", "6 in 6.1..7"),
        ("max(small error_m) in 5..5.9", "6 in 5..5.9"),
        ("value(small error_m law=plastic) > 0", "2 rows for value"),
        ("max(small error_m index>7) > 0", "no row for max"),
        ("max(small error_mm) > 0", "no column error_mm"),
        ("max(small error_m gripp=soft) > 0", "no column gripp"),
        ("max(small error_m error_m>2*widht_m) > 0", "no column widht_m"),
        ("max(small grip grip!='') > 0", "no number in grip"),
        ("max(small width_m) > 0", "an empty cell of width_m"),
        ("max(large error_m) > 0", "study-large.csv"),
        ("max(gap error_m) > 0", "row 1 has another index"),
        ("mean(small error_m) > 0", "no function mean"),
        ("max(small error_m)", "nothing is compared"),
        ("max(small error_m) error_m > 0", "\"error_m\" does not belong there"),
        ("max(small error_m > 0", "the formula ends too soon"),
        ("some > 0", "no table"),
        ("some-table > 0", "no column and no number"),
        ("2.46 ~ 2.4", "2.46 ~ 2.4"),
        ("2.4 ~ more", "no range or number"),
        ("2.4 in 2", "no range or number"),
        ("2.4 in 2..x", "no range or number"),
        ("abs(1 - 3) = 1", "2 = 1"),
        ("small law=plastic: error_m > 0", "2 rows for error_m"),
        ("small law=elastic: error_m > 0", "no row for error_m"),
        ("small law=plastic step_s=1: error_m[step_s=3*step_s] > 0", "no row for error_m"),
        ("step_s=1: error_m > 0", "conditions on no table"),
        ("small: step_s: error_m > 0", "study-step_s.csv"),
        ("small each 3 step_s: max(error_m) > 0", "2 combinations of [\"step_s\"]"),
        ("small index>7 each 0 step_s: max(error_m) > 0", "0 combinations"),
        ("small each 1: max(error_m) > 0", "combinations of []"),
        ("small each 2 step_s: error_m[law=plastic] < 4", "4 < 4 (row 2)"),
        ("small each 2 step_s: max(error_m) ~ 2..5", "2..6 ~ 2..5"),
        ("small each 2 step_s: max(error_m) ~ 1..6", "2..6 ~ 1..6"),
        ("small each 2 step_s: error_m[law=plastic] = value(small-again error_m law=plastic)", "0.5 = 1"),
    ];
    for (claim, why) in wrong {
        let (_, told) = formula::refute(claim, &mut tables);
        assert!(told.first().is_some_and(|told| told.contains(why)), "{claim}: {told:?}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

/// What is wrong with a table of the page whose rows are of the small table, by step and law.
fn told_of_cells(comment: &str, page: &str) -> Vec<String> {
    let (folder, mut tables) = small(&format!("cells-{:?}", std::thread::current().id()));
    let lines: Vec<&str> = page.lines().collect();
    let (_, told) = cells::refute(comment, &lines, &mut tables);
    std::fs::remove_dir_all(&folder).unwrap();
    told.into_iter().map(|(row, why)| format!("{row}: {why}")).collect()
}

#[test]
fn cells_are_held_against_their_formulas() {
    let comment = "small: 1000 * error_m, width_m; row '{t} ms' step_s={t}e0; column 'plastic, mm' law=plastic; \
        column 'spring, mm' law='spring, cut'; corner 'step'";
    let table = "| step | plastic, mm | spring, mm |\n|---|---|---|\n| 1 ms | 500 (4) | 2 000, 4 |\n| 2 ms | 4000 to 5 | 6000 |";
    assert_eq!(told_of_cells(comment, table), [""; 0]);
    let changes = [
        ("500", "501", "2: \"501 (4)\" says otherwise than 1000 * error_m: 500"),
        ("500", "-500", "2: \"-500 (4)\" says otherwise than 1000 * error_m: 500"),
        ("500 (4)", "500", "2: \"500\" says otherwise than width_m: 4"),
        ("500 (4)", "", "2: \"\" says otherwise than 1000 * error_m: 500"),
        ("500 (4)", "500 (4) 3", "2: 3 numbers and 2 formulas for \"500 (4) 3\""),
        ("| 6000", "| 6000, 7", "3: an empty cell of width_m"),
        ("2 ms", "3 ms", "3: no row for error_m"),
        ("2 ms", "2 s", "3: no row of the comment above is for this one"),
        ("spring, mm", "spring, um", "2: no column of the comment above is for \"spring, um\""),
        ("| step |", "| steps |", "2: another corner than step: steps"),
        ("| 6000 |", "|", "3: 2 cells under 3 headings"),
    ];
    for (from, to, why) in changes {
        assert_eq!(told_of_cells(comment, &table.replacen(from, to, 1)).first().map(String::as_str), Some(why));
    }
    for (wrong, why) in [("", "0: an empty part"), ("row", "0: row of what?"), ("small of", "0: no condition: of")] {
        assert_eq!(told_of_cells(wrong, table), [why]);
    }
    let nothing = "small law=plastic: 0 * error_m, 0 * error_m as m; row '{step_s} ms'; column 'loss'";
    let zeros = "| step | loss |\n|---|---|\n| 1 ms | 0.0, 0 |\n| 2 ms | 0 |";
    assert_eq!(told_of_cells(nothing, zeros), [""; 0]);
    for (from, to) in [("0.0,", "-0.0,"), (", 0 |", ", -0 |"), ("ms | 0 |", "ms | -0 |"), (", 0 |", ", 1 mm |")] {
        assert_eq!(told_of_cells(nothing, &zeros.replacen(from, to, 1)).len(), 1, "{to}");
    }
    let without = "small; row '{step_s} ms'; column 'plastic, mm' law=plastic: -; column '{law}' law='spring, cut'";
    assert_eq!(told_of_cells(without, table)[0], "2: no formula for \"2000, 4\"");
}

#[test]
fn cells_have_limits_units_and_a_second_line_of_headings() {
    let comment = "small: error_m as m; limits 3.9 4.1 10; head 'law'; row '{} | cut' law='spring, cut'; row '{law} | {}'; \
        column 'error {t}' step_s={t}; column 'width {step_s}': width_m";
    let table = "| | | error | | width | |\n|---|---|---|---|---|---|\n| law | | 1 | 2 | 1 | 2 |\n\
        | plastic | whole | 500 mm | 4 m | <4.1 | 5 |\n| | | 0.5 m | 4.0 m | >3.9 | 5 |\n| spring | cut | 2 m | 6 m | 4 | >10 |";
    assert_eq!(told_of_cells(comment, table), [""; 0]);
    let changes = [
        ("500 mm", "500 um", "3: \"500 um\" says otherwise than error_m: 0.5"),
        ("500 mm", "0.5", "3: 0.5 is not counted in m"),
        ("<4.1", "<4", "3: 4 is no limit of this table"),
        ("<4.1", "<3.9", "3: \"<3.9\" says otherwise than width_m: 4"),
        (">3.9", ">4.1", "4: \">4.1\" says otherwise than width_m: 4"),
        ("| 1 | 2 | 1 |", "| 2 | 1 | 1 |", "3: \"500 mm\" says otherwise than error_m: 4"),
        (">10", "10", "5: an empty cell of width_m"),
        ("| spring | cut |", "| spring | |", "5: no row for error_m"),
    ];
    for (from, to, why) in changes {
        assert_eq!(told_of_cells(comment, &table.replacen(from, to, 1)).first().map(String::as_str), Some(why));
    }
}

#[test]
fn what_is_wrong_with_a_page_is_told_with_its_line() {
    let (folder, mut tables) = small("page");
    let page = "## hold\n\n- One.\n  <!-- claim: 1 < 2; 2 < 1 -->\n- Two.\n* Three. <!-- claim: 3 = 3 -->\n- Four.\n\n\
        <!-- cells: small; row '{step_s}' -->\n<!-- cells: column '{law}': error_m -->\n\
        | step | plastic |\n|---|---|\n| 1 | 0.5 |\n| 2 | 5 |\n\n\
        | a |\n|---|\n\n<!-- cells: small -->\ntext\n<!-- claim: 1 < 2\n## other\n- Five.\n| b |\n|---|\n";
    let (count, wrong) = refuted("page.md", page, &mut tables);
    assert_eq!(count, 4);
    let told = [
        "page.md:4: 2 < 1: 2 < 1",
        "page.md:5: no claim stands behind this point",
        "page.md:14: \"5\" says otherwise than error_m: 4",
        "page.md:16: no formulas stand above this table",
        "page.md:20: a table has to stand below its formulas",
        "page.md:21: a claim has to end in its line",
        "page.md:7: no claim stands behind this point",
    ];
    assert_eq!(wrong, told);
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn the_examples_hold() {
    let lines = include_str!("mod.rs").lines().map_while(|line| line.strip_prefix("//!"));
    let page: Vec<&str> = lines.map(|line| line.strip_prefix(' ').unwrap_or(line)).collect();
    let (count, wrong) = refuted("mod.rs", &page.join("\n"), &mut Tables::in_folder(root().join("data")));
    assert_eq!(wrong, [""; 0]);
    assert!(count > 150, "{count}");
}
