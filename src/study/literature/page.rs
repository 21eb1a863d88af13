//! The study's parts of `docs/studies.md`.

use super::super::page::{PageError, Rows, Tables, bullets, digits, markdown, relation};
use crate::sweep::Row;

/// Differences from a closed form below this are of rounding, percent.
const MET_PERCENT: f64 = 1e-4;

fn places(rows: &Rows<'_>, column: &str, places: usize) -> Result<String, PageError> {
    Ok(format!("{:.places$}", rows.number(column)?))
}

/// The rows of the paper of Keemink et al.
pub(crate) fn keemink(tables: &Tables<'_>) -> Result<String, PageError> {
    let table = tables.read("keemink")?;
    let limit = table.all().with("cycle_ms", 0.0).with("hand_damping_n_s_per_m", 15.0);
    let mut lines = Vec::new();
    for row in limit.iter() {
        let case = table.all().with("case", row.word("case"));
        let both = |cycle_ms: f64, column: &str, digits: usize| {
            let of = |damping: f64| {
                places(&case.with("cycle_ms", cycle_ms).with("hand_damping_n_s_per_m", damping), column, digits)
            };
            Ok::<_, PageError>(format!("{} / {}", of(15.0)?, of(5.0)?))
        };
        lines.push(vec![
            format!("{} (Fig. {})", row.word("case"), row.word("figure"))
                .replace("Fig. none", "no figure in the paper"),
            both(0.0, "closed_form_n_per_m", 1)?,
            both(0.0, "found_n_per_m", 1)?,
            format!("{} ({} %)", both(1.0, "found_n_per_m", 1)?, both(1.0, "difference_percent", 1)?),
            format!("{:.0} at {:.1} Hz", row.number("least_phase_deg"), row.number("least_phase_hz")),
            format!("{:.1} / {:.1}", row.number("mass_at_0_kg"), row.number("mass_at_infinity_kg")),
        ]);
    }
    Ok(markdown(
        &[
            "row of the paper",
            "closed form, N/m; hand of 15 / 5 N s/m",
            "here, continuous (T to 0)",
            "here, T = 1 ms (difference)",
            "least phase here, deg",
            "apparent mass here at 0 / infinity, kg",
        ],
        &lines,
    ))
}

/// The statements of the other papers.
pub(crate) fn statements(tables: &Tables<'_>) -> Result<String, PageError> {
    let [laws, walls, swings] = ["kikuuwe", "zwidth", "budai"].map(|name| tables.read(name));
    let (laws, walls, swings) = (laws?, walls?, swings?);
    let law = |name: &str| laws.all().with("law", name);
    let pid = law("PID, integral clamped");
    let within = walls.all().with("is_within_bound", true);
    let beyond = walls.all().with("is_within_bound", false);
    within.check("couplings within the bound come to rest", |row| row.word("outcome") == "rests")?;
    let between = walls.all().filter("viscous friction suffices", |row| row.number("viscous_share") >= 1.0);
    let swinging = between.with("outcome", "swings");
    let stopped = swings.all().with("outcome", "stops");
    stopped.check("starts below the even swing stop", |row| row.number("start_share") < 1.0)?;
    let others = swings.all().with("outcome", "grows");
    others.check("starts above it grow", |row| row.number("start_share") > 1.0)?;
    let many = stopped.filter("with three turns", |row| row.number("turns") >= 3.0);
    many.check("the envelope is concave", |row| row.is("is_concave"))?;
    let drawn_back = laws.all().filter("drawn back", |row| row.word("law").ends_with("drawn back"));
    let most = drawn_back.greatest("fastest_rad_per_s")?;
    relation(pid.number("fastest_rad_per_s")? > 10.0 * most, "PID alone snaps back ten times as fast", pid.iter())?;
    law("PSMC").check("PSMC does not overshoot", |row| row.number("overshoot_rad") < 1e-6)?;
    let number = |rows: &Rows<'_>, column: &str, count: usize| Ok::<_, PageError>(digits(rows.number(column)?, count));
    let line = |source: &str, published: &str, here: String| vec![source.to_owned(), published.to_owned(), here];
    Ok(markdown(
        &["source", "published", "here"],
        &[
            line(
                "Kikuuwe 2019",
                "a bounded law is the unbounded one until it saturates",
                format!(
                    "with the same errors, PSMC and PID differ in the last {:.0} of 53 bits: their sums have another order",
                    law("PSMC").number("differing_bits")?.ceil()
                ),
            ),
            line(
                "Kikuuwe 2019",
                "after saturation it neither snaps back nor overshoots",
                format!(
                    "PID {} rad/s, {} rad over; PSMC {} rad/s, 0 rad; reference drawn back, either: {} rad/s, {} mrad",
                    number(&pid, "fastest_rad_per_s", 2)?,
                    number(&pid, "overshoot_rad", 2)?,
                    number(&law("PSMC"), "fastest_rad_per_s", 2)?,
                    digits(most, 2),
                    digits(1e3 * drawn_back.greatest("overshoot_rad")?, 2)
                ),
            ),
            line(
                "Colgate, Brown 1994; Abbott, Okamura 2005",
                "a wall is passive for K up to min(2 b/T, 2 f_c/Delta)",
                format!(
                    "{} of {} couplings within come to rest",
                    within.with("outcome", "rests").count(),
                    within.count()
                ),
            ),
            line(
                "Abbott, Okamura 2005",
                "beyond, one mode is unstable and another is felt",
                format!(
                    "{} of {} with enough viscous friction only swing for ever, by {} to {} counts; {} others grow",
                    swinging.count(),
                    between.with("is_within_bound", false).count(),
                    digits(swinging.least("swing_counts")?, 2),
                    digits(swinging.greatest("swing_counts")?, 2),
                    beyond.with("outcome", "grows").count()
                ),
            ),
            line(
                "Diolaiti et al. 2006",
                "many devices are stable beyond passivity",
                format!(
                    "{} of {} couplings beyond come to rest",
                    beyond.with("outcome", "rests").count(),
                    beyond.count()
                ),
            ),
            line(
                "Budai et al. 2019",
                "dry friction stops an unstable loop, from small starts, with a concave envelope",
                format!(
                    "{} of {} starts stop, after {:.0} to {:.0} ms (first harmonic: {:.0} to {:.0} ms), with a concave envelope",
                    stopped.count(),
                    swings.all().count(),
                    1e3 * stopped.least("time_s")?,
                    1e3 * stopped.greatest("time_s")?,
                    1e3 * stopped.least("expected_s")?,
                    1e3 * stopped.greatest("expected_s")?
                ),
            ),
        ],
    ))
}

pub(crate) fn findings(tables: &Tables<'_>) -> Result<String, PageError> {
    let stiffness = tables.read("keemink")?;
    let limit = stiffness.all().with("cycle_ms", 0.0);
    limit.check("the closed forms are met", |row| row.number("difference_percent").abs() < MET_PERCENT)?;
    let slow = stiffness.all().with("cycle_ms", 1.0);
    slow.check("a cycle of 1 ms leaves more stiffness", |row| row.number("difference_percent") > 0.0)?;
    let is_assumed = |row: &Row<'_>| ["no integral part", "elastic transmission"].contains(&row.word("case"));
    Ok(bullets(&[format!(
        "The continuous admittance agrees with **all {} limits of stiffness by the closed forms after Keemink et al.** to {} %. A \
         sampled loop with a cycle of 1 ms raises them by {} to {} %. An assumption of ours is in {} of them. Rows: {}.",
        limit.count(),
        digits(MET_PERCENT, 1),
        digits(slow.least("difference_percent")?, 2),
        digits(slow.greatest("difference_percent")?, 2),
        limit.filter("with an assumption", is_assumed).count(),
        stiffness.all().places()
    )]))
}
