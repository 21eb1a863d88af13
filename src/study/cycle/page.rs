//! The study's parts of `docs/studies.md`.

use super::super::page::{PageError, Tables, bullets, digits, markdown, relation};

const MODES: [&str; 3] = ["torque", "velocity", "position"];
const STIFF: &str = "position (stiff drives)";

pub(crate) fn rigs(tables: &Tables<'_>) -> Result<String, PageError> {
    let rigs = tables.read("rigs")?;
    let all = rigs.all();
    let mut lines = Vec::new();
    for row in ["EtherCAT", "CAN"]
        .iter()
        .flat_map(|bus| all.with("bus", *bus).with("mode", MODES[0]).iter().copied().collect::<Vec<_>>())
    {
        let here = all.with("bus", row.word("bus")).with("period_ms", row.number("period_ms"));
        let of = |column: &str, factor: f64| {
            let cell = |mode| {
                let one = here.with("mode", mode);
                let is_refused = one.one()?.word("outcome") != "ran";
                if is_refused { Ok("refused".to_owned()) } else { Ok(digits(factor * one.number(column)?, 2)) }
            };
            MODES.into_iter().map(cell).collect::<Result<Vec<_>, PageError>>()
        };
        let load = 100.0 * here.with("mode", MODES[0]).number("bus_load")?;
        let mut line = vec![format!("{}, {} ms", row.word("bus"), row.number("period_ms"))];
        line.extend(of("error_rms_m", 1e6)?);
        line.extend(of("run_least_kg", 1.0)?);
        line.push(format!("{load:.1} %"));
        lines.push(line);
    }
    let head = [
        "bus, cycle",
        "path error, RMS um: torque",
        "velocity",
        "position",
        "least virtual mass, kg: torque",
        "velocity",
        "position",
        "bus load, torque",
    ];
    Ok(markdown(&head, &lines))
}

pub(crate) fn findings(tables: &Tables<'_>) -> Result<String, PageError> {
    let (rigs, shortest) = (tables.read("rigs")?, tables.read("shortest")?);
    let ends = |bus: &str| {
        Ok::<_, PageError>([
            shortest.all().with("bus", bus).least("shortest_ms")?,
            shortest.all().with("bus", bus).greatest("shortest_ms")?,
        ])
    };
    let ([can, can_most], [_, ethercat]) = (ends("CAN")?, ends("EtherCAT")?);

    let ran = rigs.all().with("outcome", "ran");
    let stiff = ran.with("mode", STIFF);
    let through = stiff.filter("held_through > 0", |row| row.number("held_through") > 0.0);
    relation(through.count() > 0, "stiff drives let a proxy through", stiff.iter())?;
    for mode in MODES {
        ran.with("mode", mode).check("with the gains of `tune gains` the hold keeps each proxy", |row| {
            row.number("held_through") == 0.0
        })?;
    }
    Ok(bullets(&[
        format!(
            "**CAN ends at {can} to {can_most} ms, by mode, EtherCAT at {ethercat} ms.** At shorter cycles the frames do not all arrive in time. A late computer needs a reserve besides: [the bus budget](bus-budget.md)."
        ),
        format!(
            "**Margins of the drives' loop alone do not make a rig stable.** With the stiffest gains that leave 6 dB and 45 degrees, {} of {} rigs in position mode let a proxy of 2 kg through the circle despite the hold. \
             Without dry friction they need {} to {} kg. With the gains of `tune gains` no rig does.",
            through.count(),
            stiff.count(),
            digits(through.least("run_least_kg")?, 2),
            digits(through.greatest("run_least_kg")?, 2)
        ),
    ]))
}
