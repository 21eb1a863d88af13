use std::time::Duration;

use serde_json::Value;

use super::*;
use crate::sweep::{Clock, Report, Sweep};
use crate::{NAMES, Options, study};

#[test]
fn the_page_is_what_its_tables_show() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
    let mut pages = PAGES.map(|page| std::fs::read_to_string(docs.join(page)).unwrap());
    for name in NAMES {
        let study = study(name, &Options::default()).unwrap();
        let changed = refresh(&mut pages, study.as_ref(), &docs.join("data")).unwrap_or_else(|error| panic!("{error}"));
        assert!(
            changed.is_empty(),
            "{changed:?} are not those of docs/data; `yieldwall study {name} --page` writes them"
        );
    }
}

/// A page that is read in one sitting.
#[test]
fn the_page_of_findings_is_short() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
    let page = std::fs::read_to_string(docs.join(PAGES[0])).unwrap();
    let words = page.split_whitespace().count();
    assert!(words <= 2500, "{words} words");
    let charts = page.matches("![").count();
    assert!(charts <= 8, "{charts} charts");
    let findings = page.lines().filter(|line| line.starts_with("- ") && line.contains("**")).count();
    assert!(findings <= 15, "{findings} findings");
}

/// Sides and their squares.
struct Small([Box<dyn Sweep>; 1]);

struct Squares;

impl Sweep for Squares {
    fn name(&self) -> &'static str {
        "squares"
    }
    fn columns(&self) -> Vec<&str> {
        vec!["side_m", "square_m2", "remark"]
    }
    fn points(&self) -> u64 {
        4
    }
    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let square = if index == 3 { f64::NAN } else { (index * index) as f64 };
        vec![(index as f64).into(), square.into(), if index == 0 { "".into() } else { "some".into() }]
    }
}

impl Study for Small {
    fn name(&self) -> &'static str {
        "small"
    }
    fn about(&self) -> &'static str {
        "a table for a test"
    }
    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.0
    }
    fn report(&self, _: &[Table]) -> Report {
        Report::default()
    }
}

fn most(tables: &Tables<'_>) -> Result<String, PageError> {
    let squares = tables.read("squares")?;
    let small = squares.all().filter("side_m < 3", |row| row.number("side_m") < 3.0);
    small.check("a square is below 5", |row| row.number("square_m2") < 5.0)?;
    Ok(format!("The greatest is {}.", small.greatest("square_m2")?))
}

fn squares() -> Table {
    let mut table = Table::new(&Squares);
    (0..4).for_each(|index| table.insert(index, Squares.point(index, &|| Duration::ZERO)));
    table
}

/// The new page, if this text is the table.
fn written(page: &str, csv: &str, name: &str) -> Result<(String, Vec<&'static str>), String> {
    let folder = std::env::temp_dir().join(format!("yieldwall-page-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("study-small-squares.csv"), csv).unwrap();
    let study = Small([Box::new(Squares)]);
    let mut pages = ["No block.\n".to_owned(), page.to_owned()];
    let changed = refresh_blocks(&mut pages, &study, &folder, &[("small-most", most)]);
    std::fs::remove_dir_all(&folder).unwrap();
    let [other, page] = pages;
    assert_eq!(other, "No block.\n");
    changed.map(|changed| (page, changed)).map_err(|error| error.to_string())
}

const PAGE: &str = "Before.\n<!-- begin: small-most -->\nOld.\n<!-- end -->\nAfter.\n";

#[test]
fn a_block_is_written_between_its_markers_and_the_rest_stays() {
    let (page, changed) = written(PAGE, &squares().csv(), "written").unwrap();
    assert_eq!(page, PAGE.replace("Old.", "The greatest is 4."));
    assert_eq!(changed, ["small-most"]);
    assert_eq!(written(&page, &squares().csv(), "again").unwrap(), (page, Vec::new()));
}

#[test]
fn a_finding_that_the_table_does_not_show_is_an_error_with_its_rows() {
    let csv = squares().csv();
    let told = [
        (
            csv.replace("2.0,4.0", "2.0,6.0"),
            "block small-most: the tables do not show that a square is below 5: rows squares:2",
        ),
        (
            csv.replace("2.0,4.0", "2.0,"),
            "block small-most: the tables do not show that a square is below 5: rows squares:2",
        ),
    ];
    for (csv, error) in told {
        assert_eq!(written(PAGE, &csv, "false").unwrap_err(), error);
    }
    let bad = written(PAGE, &csv.replace("square_m2", "square"), "column").unwrap_err();
    assert!(bad.ends_with("study-small-squares.csv: the first line has no column square_m2"), "{bad}");
}

#[test]
fn a_page_without_a_place_for_a_block_is_refused() {
    let begin = "<!-- begin: small-most -->";
    let pages = [
        (String::new(), format!("block small-most: no page has the line {begin}")),
        (format!("{begin}\n"), format!("block small-most: the page has no line <!-- end --> behind {begin}")),
        (PAGE.repeat(2), format!("block small-most: the line {begin} is there twice")),
        (format!("{PAGE}<!-- begin: small-former -->\n"), "no study writes the block small-former".to_owned()),
    ];
    for (page, error) in pages {
        assert_eq!(written(&page, &squares().csv(), "marker").unwrap_err(), error);
    }
}

#[test]
fn rows_are_selected_by_their_cells() {
    let table = squares();
    let all = table.all();
    assert_eq!(all.with("side_m", 2).number("square_m2").unwrap(), 4.0);
    assert_eq!((all.with("remark", "").count(), all.with("remark", Value::Null).count()), (1, 1));
    assert_eq!([all.places(), all.with("side_m", 2).places()], ["`squares` 0 to 3", "`squares` 2"]);
    assert_eq!((all.with("remark", "some").least("side_m").unwrap(), all.greatest("side_m").unwrap()), (1.0, 3.0));
    let errors = [
        (all.number("side_m").unwrap_err(), "4 rows of table squares, one is wanted"),
        (all.with("side_m", 9).least("side_m").unwrap_err(), "no row of table squares, side_m = 9"),
        (all.greatest("square_m2").unwrap_err(), "no square_m2 in row squares:3"),
        (
            all.check("sides are small", |row| row.number("side_m") < 2.0).unwrap_err(),
            "the tables do not show that sides are small: rows squares:2, squares:3",
        ),
        (all.with("side_m", 9).check("all", |_| true).unwrap_err(), "no row of table squares, side_m = 9"),
    ];
    for (error, text) in errors {
        assert_eq!(error.to_string(), text);
    }
}

#[test]
fn numbers_have_their_significant_digits() {
    let numbers = [
        (0.0, 2, "0.0"),
        (9.96, 2, "10"),
        (0.0996, 2, "0.10"),
        (0.0004567, 2, "0.00046"),
        (7074.9, 3, "7070"),
        (99.96, 3, "100"),
        (-1.25e3, 1, "-1000"),
    ];
    for (value, count, text) in numbers {
        assert_eq!(digits(value, count), text, "{value}");
    }
    let lengths = [
        (0.0, "0"),
        (0.00909, "9.1 mm"),
        (0.0999, "100 mm"),
        (0.9996e-3, "1.0 mm"),
        (33e-12, "33 pm"),
        (45e-6, "45 um"),
    ];
    for (value_m, text) in lengths {
        assert_eq!(length(value_m), text);
    }
    assert_eq!(markdown(&["a", "b"], &[vec!["1".into(), "2".into()]]), "| a | b |\n|---|---|\n| 1 | 2 |\n");
}
