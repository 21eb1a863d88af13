//! The study's parts of `docs/studies.md`.

use super::super::page::{PageError, Rows, Tables, bullets, digits, markdown};
use super::super::sweep::median;
use super::aid::{Aid, Law};
use super::draw::THROWN_M;
use super::runs::{AIM_M, PRESS_N, USERS};
use super::trial::GRIPS;

fn of_aid<'a>(rows: &Rows<'a>, aid: &Aid) -> Rows<'a> {
    rows.with("law", aid.law.name()).with("hardness", aid.hardness).with("yield_n", aid.yield_n)
}

pub(crate) fn errors(tables: &Tables<'_>) -> Result<String, PageError> {
    let errors = tables.read("errors")?;
    let soft =
        errors.all().with("grip", GRIPS[0].name).with("aim_rms_m", AIM_M).with("users", USERS).with("ran", USERS);
    let at = |yield_n| {
        let stiff = [Aid::saturated(1e3, yield_n), Aid::saturated(1e5, yield_n)];
        [Aid::plastic(yield_n)]
            .into_iter()
            .chain(stiff)
            .chain([Aid::viscous(1e-2, yield_n), Aid::viscous(1e-4, yield_n)])
    };
    let mut lines = Vec::new();
    for aid in [Aid::NONE].into_iter().chain(at(5.0)).chain(at(20.0)) {
        let row = of_aid(&soft, &aid);
        let milli = |column| Ok::<_, PageError>(digits(1e3 * row.number(column)?, 2));
        lines.push(vec![
            aid.name(),
            aid.yield_n.map_or(String::new(), |yield_n| format!("{yield_n} N")),
            format!("{} ({} to {})", milli("error_rms_m")?, milli("error_low_m")?, milli("error_high_m")?),
            row.number("inside")?.to_string(),
            milli("energy_across_j")?,
            milli("press_m")?,
            // A zero without its sign.
            format!("{:.1}", (1e4 * row.number("jump_m")?).round() / 10.0 + 0.0),
        ]);
    }
    let inside = format!("never off by 2 mm, of {USERS}");
    let press = format!("off when pressed with {PRESS_N} N, mm");
    Ok(markdown(
        &[
            "law",
            "R",
            "RMS error, mm (95 %)",
            &inside,
            "energy given across the way, mJ",
            &press,
            "jump when let go, mm",
        ],
        &lines,
    ))
}

/// Errors of the users of a row in um, in order; a run that did not come to its end is not a number.
fn each_um(row: &super::Row<'_>) -> Vec<f64> {
    row.word("each_error_um").split(' ').map(|error_um| error_um.parse().unwrap_or(f64::NAN)).collect()
}

pub(crate) fn findings(tables: &Tables<'_>) -> Result<String, PageError> {
    let (table, device) = (tables.read("errors")?, tables.read("device")?);
    let soft = table.all().with("grip", GRIPS[0].name);
    let beyond = soft.with("aim_rms_m", AIM_M);
    let plastic = of_aid(&beyond, &Aid::plastic(5.0));
    let springs = beyond
        .with("law", Law::Saturated.name())
        .with("yield_n", 5.0)
        .filter("hardness >= 1e4", |row| row.number("hardness") >= 1e4);
    let [error_low, energy, energy_high, jump] =
        ["error_low_m", "energy_across_j", "energy_high_j", "jump_m"].map(|column| plastic.number(column));
    let (error_low, energy, energy_high, jump) = (error_low?, energy?, energy_high?, jump?);
    springs.check("stiff springs err less than plastic, give more energy and throw the tool", |row| {
        let is_thrown = row.number("jump_m") > THROWN_M && jump < THROWN_M;
        row.number("error_high_m") < error_low && row.number("energy_low_j") > energy_high && is_thrown
    })?;

    let device = device.all();
    let spring = device.with("law", Law::Spring.name());
    let is_soft = |row: &super::Row<'_>| row.number("hardness") <= 3000.0;
    spring.check("springs run up to 3000 N/m and not beyond", |row| {
        row.number("ran") == if is_soft(row) { USERS as f64 } else { 0.0 }
    })?;
    let least = spring.filter("too stiff", |row| !is_soft(row)).least("hardness")?;
    let coupled = device.with("law", Law::Plastic.name());
    for law in [Law::Plastic, Law::Saturated] {
        let limited = device.with("law", law.name());
        limited.check("a law with R runs at each stiffness", |row| row.number("ran") == USERS as f64)?;
    }
    let with_plastic = each_um(&plastic.one()?);
    let shares: Vec<f64> = springs
        .iter()
        .filter_map(|row| median(each_um(row).iter().zip(&with_plastic).map(|(spring, plastic)| spring / plastic)))
        .collect();
    let field = of_aid(&beyond, &Aid::viscous(1e-4, 5.0));
    let chatter = |law: Law| {
        let stiff = device.with("law", law.name()).filter("hardness >= 1e4", |row| row.number("hardness") >= 1e4);
        stiff.filter("released", |row| row.number("resting_m_per_s").is_finite()).greatest("resting_m_per_s")
    };
    Ok(bullets(&[
        format!(
            "At 0.08 m/s, R = 5 N and an aim off by 5 mm, springs from 10 N/mm on have {} to {} of plastic's error (soft hand, \
             median of users). After a press of 16 N they **give {:.0} to {:.0} times the energy, and throw the tool** by \
             {:.0} mm. The viscous field with R at 0.1 mm/s errs {} mm and does not give way. Rows: {}, {}, {}.",
            digits(shares.iter().copied().fold(f64::INFINITY, f64::min), 2),
            digits(shares.iter().copied().fold(0.0, f64::max), 2),
            springs.least("energy_across_j")? / energy,
            springs.greatest("energy_across_j")? / energy,
            1e3 * springs.least("jump_m")?,
            digits(1e3 * field.number("error_rms_m")?, 2),
            plastic.places(),
            springs.places(),
            field.places()
        ),
        format!(
            "On an impedance device at 1 kHz springs without limit run up to 3 N/mm and not from {} N/mm on. Plastic fixtures and \
             springs cut at R run up to {} N/mm, **and chatter**. From 10 N/mm on the released tool moves at up to {} m/s with \
             plastic, and at up to {} m/s with the springs. Rows: {}.",
            least / 1000.0,
            coupled.greatest("hardness")? / 1000.0,
            digits(chatter(Law::Plastic)?, 2),
            digits(chatter(Law::Saturated)?, 2),
            device.places()
        ),
    ]))
}
