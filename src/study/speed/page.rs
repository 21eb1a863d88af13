//! The study's parts of `docs/studies.md`.

use super::super::page::{PageError, Rows, Tables, bullets, digits, markdown, relation};
use super::super::task::{Aid, Law};
use super::runs::{WIDTHS_M, YIELDS_N};

/// R of the findings, in N.
const YIELD_N: f64 = YIELDS_N[1];

fn of_aid<'a>(rows: &Rows<'a>, aid: &Aid) -> Rows<'a> {
    rows.with("law", aid.law.name()).with("hardness", aid.hardness).with("yield_n", aid.yield_n)
}

pub(crate) fn widths(tables: &Tables<'_>) -> Result<String, PageError> {
    let widths = tables.read("widths")?;
    let circle = widths.all().with("way", "circle");
    let springs = [Aid::saturated(1e3, YIELD_N), Aid::saturated(1e5, YIELD_N)];
    let fields = [Aid::viscous(0.1, YIELD_N), Aid::viscous(0.01, YIELD_N)];
    let mut lines = Vec::new();
    for aid in [Aid::NONE].into_iter().chain(YIELDS_N.map(Aid::plastic)).chain(springs).chain(fields) {
        let mut line = vec![aid.name(), aid.yield_n.map_or(String::new(), |yield_n| format!("{yield_n} N"))];
        for width_m in [0.002, 0.008, 0.032] {
            let row = of_aid(&circle.with("width_m", width_m), &aid);
            let [time_s, low_s, high_s] =
                [row.number("time_s")?, row.number("time_low_s")?, row.number("time_high_s")?];
            line.push(format!(
                "{time_s:.2} ({low_s:.2} to {high_s:.2}), {}",
                digits(1e3 * row.number("error_rms_m")?, 2)
            ));
        }
        lines.push(line);
    }
    Ok(markdown(&["law", "R", "band of 2 mm: time, s (95 %), RMS error, mm", "8 mm", "32 mm"], &lines))
}

pub(crate) fn findings(tables: &Tables<'_>) -> Result<String, PageError> {
    let widths = tables.read("widths")?;
    let circle = widths.all().with("way", "circle");
    let free = circle.with("law", Law::None.name());
    let time_s = |width_m: f64| free.with("width_m", width_m).number("time_s");
    let (wide_s, narrow_s) = (time_s(WIDTHS_M[4])?, time_s(WIDTHS_M[0])?);
    relation(
        narrow_s > 2.0 * wide_s,
        "a narrow band takes a free hand more than twice as long",
        free.with("width_m", WIDTHS_M[0]).iter(),
    )?;
    let plastic = of_aid(&circle, &Aid::plastic(YIELD_N));
    let held_s = plastic.least("time_s")?;
    plastic.check("the time with plastic is within 1 % in all bands", |row| row.number("time_s") < 1.01 * held_s)?;
    let beside = tables.read("beside")?;
    let edge = beside.all().with("beside_m", 0.004);
    let [held, gives] = [YIELD_N, YIELDS_N[0]].map(|yield_n| of_aid(&edge, &Aid::plastic(yield_n)));
    let without = of_aid(&edge, &Aid::NONE);
    let (low_s, high_s) = (without.number("time_low_s")?, without.number("time_high_s")?);
    held.check("a stiff fixture on the edge of the band is slower than none", |row| row.number("time_low_s") > high_s)?;
    gives.check("plastic that gives way there is faster than none", |row| row.number("time_high_s") < low_s)?;
    Ok(bullets(&[
        format!(
            "A user who slows down with the error seen takes **{held_s:.1} s in every band** of 2 to 32 mm with plastic of {YIELD_N} \
             N. Without a fixture it takes {wide_s:.1} to {narrow_s:.1} s. Rows: {}, {}.",
            plastic.places(),
            free.places()
        ),
        format!(
            "**A fixture on the edge of the band can hold users there**. With its reference 4 mm beside the way they take {:.1} s \
             with plastic of {YIELD_N} N. They take {:.1} s without a fixture, and {:.1} s with plastic of {} N, which gives way. Rows: {}.",
            held.number("time_s")?,
            without.number("time_s")?,
            gives.number("time_s")?,
            YIELDS_N[0],
            edge.places()
        ),
    ]))
}
