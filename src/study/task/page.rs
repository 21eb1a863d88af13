//! The study's parts of `docs/studies.md`.

use super::super::page::{PageError, Rows, Tables, bullets, digits, markdown};
use super::aid::{Aid, Law, YIELDS_N};
use super::draw::{Field, GIVES_WAY, THROWN_M, winner};
use super::runs::{AIM_M, AIMS_M, PRESS_N, USERS};
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

pub(crate) fn findings(tables: &Tables<'_>) -> Result<String, PageError> {
    let (table, device) = (tables.read("errors")?, tables.read("device")?);
    let soft = table.all().with("grip", GRIPS[0].name);
    let beyond = soft.with("aim_rms_m", AIM_M);
    let plastic = of_aid(&beyond, &Aid::plastic(5.0));
    let springs = beyond
        .with("law", Law::Saturated.name())
        .with("yield_n", 5.0)
        .filter("hardness >= 1e4", |row| row.number("hardness") >= 1e4);
    let [error_low, error, energy, energy_high, jump] =
        ["error_low_m", "error_rms_m", "energy_across_j", "energy_high_j", "jump_m"]
            .map(|column| plastic.number(column));
    let (error_low, error, energy, energy_high, jump) = (error_low?, error?, energy?, energy_high?, jump?);
    springs.check("stiff springs err less than plastic, give more energy and throw the tool", |row| {
        let is_thrown = row.number("jump_m") > THROWN_M && jump < THROWN_M;
        row.number("error_high_m") < error_low && row.number("energy_low_j") > energy_high && is_thrown
    })?;

    let cells = || {
        GRIPS
            .into_iter()
            .flat_map(|grip| YIELDS_N.into_iter().flat_map(move |yield_n| AIMS_M.map(|aim_m| (grip, yield_n, aim_m))))
    };
    let won = |law| {
        cells().filter(|(grip, yield_n, aim_m)| winner(&table, grip.name, *yield_n, *aim_m, Field::All) == law).count()
    };
    let free_m = soft.with("law", Law::None.name()).least("press_m")?;
    let pressed = soft.filter("R below the press", |row| row.number("yield_n") < PRESS_N);
    pressed.check("plastic alone gives way and does not throw the tool", |row| {
        let yields = row.number("press_m") > GIVES_WAY * free_m && row.number("jump_m") < THROWN_M;
        yields == (row.word("law") == Law::Plastic.name())
    })?;

    let device = device.all();
    let spring = device.with("law", Law::Spring.name());
    let is_soft = |row: &super::Row<'_>| row.number("hardness") <= 3000.0;
    spring.check("springs run up to 3000 N/m and not beyond", |row| {
        row.number("ran") == if is_soft(row) { USERS as f64 } else { 0.0 }
    })?;
    let least = spring.filter("too stiff", |row| !is_soft(row)).least("hardness")?;
    let coupled = device.with("law", Law::Plastic.name());
    coupled.check("plastic runs with each coupling", |row| row.number("ran") == USERS as f64)?;
    let share = |of: f64| digits(of / error, 2);
    Ok(bullets(&[
        format!(
            "**Beyond R a stiff spring is more exact than plastic, and throws the tool.** At 0.08 m/s, with the soft hand, an aim off by 5 mm and springs of 1e4 N/m and more, at most R = 5 N, the error is {} to {} of that of plastic. \
             The springs give {:.0} to {:.0} times the energy, and the tool jumps by {:.0} mm when the press ends.",
            share(springs.least("error_rms_m")?),
            share(springs.greatest("error_rms_m")?),
            springs.least("energy_across_j")? / energy,
            springs.greatest("energy_across_j")? / energy,
            1e3 * springs.least("jump_m")?
        ),
        format!(
            "**Viscous fields win {} of the {} cells of the map, plastic {}, springs {}; no law wins the other {}.** The map is of 0.08 m/s: viscous fields drift off a curve that the hand takes faster. \
             At R = 5 and 10 N, with the soft hand, plastic alone gives way to a press above R without a jump of 1 mm.",
            won(Some(Law::Viscous)),
            cells().count(),
            won(Some(Law::Plastic)),
            won(Some(Law::Saturated)),
            won(None)
        ),
        format!(
            "**On an impedance device the sampled loop caps the spring.** Springs without limit run with all {USERS} users up to 3000 N/m, and with none from {least:.0e} N/m on. \
             Plastic fixtures run with each coupling, up to {:.0e} N/m.",
            coupled.greatest("hardness")?
        ),
    ]))
}
