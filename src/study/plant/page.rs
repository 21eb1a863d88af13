//! The study's parts of `docs/studies.md`.

use super::super::page::{PageError, Tables, bullets, digits, length, markdown};

/// The shipped method.
const SHIPPED: &str = "midpoint + gsat";
const STEP_S: f64 = 1e-3;

pub(crate) fn methods(tables: &Tables<'_>) -> Result<String, PageError> {
    let (plant, hold) = (tables.read("plant")?, tables.read("hold")?);
    let (plant, hold) = (plant.all().with("step_s", STEP_S), hold.all().with("step_s", STEP_S));
    let mut lines = Vec::new();
    for row in plant.iter() {
        let of = |rows: &super::super::page::Rows<'_>, column| {
            rows.with("engine", row.word("engine")).with("method", row.word("method")).number(column)
        };
        let mark = if row.word("method") == SHIPPED { ", shipped" } else { "" };
        lines.push(vec![
            row.word("engine").to_owned(),
            format!("{}{mark}", row.word("method")),
            digits(of(&plant, "realtime_factor")?, 3),
            length(of(&plant, "max_error_m")?),
            creep(of(&hold, "creep_m_per_s")?),
        ]);
    }
    Ok(markdown(&["engine", "method", "x real time", "greatest error", "creep when held"], &lines))
}

fn creep(speed_m_per_s: f64) -> String {
    match speed_m_per_s {
        0.0 => "0".to_owned(),
        0.0..1e-12 => "<1 pm/s".to_owned(),
        _ => format!("{}/s", length(speed_m_per_s)),
    }
}

pub(crate) fn findings(tables: &Tables<'_>) -> Result<String, PageError> {
    let plant = tables.read("plant")?;
    let at = plant.all().with("step_s", STEP_S);
    let ours = at.with("method", SHIPPED);
    let (speed, error_m) = (ours.number("realtime_factor")?, ours.number("max_error_m")?);
    let mujoco = at.with("engine", "mujoco");
    mujoco.check("the shipped method is faster and errs less", |row| {
        row.number("realtime_factor") < speed && row.number("max_error_m") > error_m
    })?;
    let fastest = mujoco.with("realtime_factor", mujoco.greatest("realtime_factor")?);
    let (faster, more) = (speed / fastest.number("realtime_factor")?, fastest.number("max_error_m")? / error_m);
    Ok(bullets(&[format!(
        "At steps of 1 ms the shipped method is **{faster:.0} times as fast** as MuJoCo's fastest tried setting (`{}`), in one scene \
         without contacts. Its greatest error is {more:.0} times less than with that setting. Rows: {}.",
        fastest.one()?.word("method"),
        at.places()
    )]))
}
