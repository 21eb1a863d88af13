//! The study's parts of `docs/studies.md`.

use super::super::page::{PageError, Tables, bullets, digits, markdown};

const MODES: [&str; 3] = ["torque", "velocity", "position"];

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
    let shortest = tables.read("shortest")?;
    let ends = |bus: &str| {
        let of_bus = shortest.all().with("bus", bus);
        Ok::<_, PageError>([of_bus.least("shortest_ms")?, of_bus.greatest("shortest_ms")?])
    };
    let ([can, can_most], [_, ethercat]) = (ends("CAN")?, ends("EtherCAT")?);
    let can = if can == can_most { can.to_string() } else { format!("{can} to {can_most}") };
    let rigs = tables.read("rigs")?;
    let of_mode = |mode| rigs.all().with("bus", "EtherCAT").with("outcome", "ran").with("mode", mode);
    let (torque, position) = (of_mode(MODES[0]), of_mode(MODES[2]));
    Ok(bullets(&[
        format!(
            "From the shortest cycle to the longest the path error on EtherCAT grows **from {} um to {} mm in torque mode**, which \
             `run` refuses from 2 ms on. In position mode with the drives as shipped it is {} to {} um. Rows: {}, {}.",
            digits(1e6 * torque.least("error_rms_m")?, 2),
            digits(1e3 * torque.greatest("error_rms_m")?, 2),
            digits(1e6 * position.least("error_rms_m")?, 2),
            digits(1e6 * position.greatest("error_rms_m")?, 2),
            torque.places(),
            position.places()
        ),
        format!(
            "By the bus budget the shortest cycle for the frames of this rig is **{can} ms on CAN** at 1 Mbit/s, and {ethercat} ms \
             on EtherCAT. Rows: {}.",
            shortest.all().places()
        ),
    ]))
}
