//! Results read from the tables.

use super::contestant::{Contestant, MUJOCO, OURS};
use super::speed::REFERENCE_STEP_S;
use crate::chart::{Axis, Chart, Color, Mark, Panel, Series};
use crate::page::in_unit;
use crate::sweep::{Report, Row, Table};

/// Step at which MuJoCo is usually run, in s.
const USUAL_STEP_S: f64 = 1e-3;

/// Colours of the series, each its own: with its shape every series is known, in grey too.
const OURS_IN: [Color; 5] = [Color::Blue, Color::Vermilion, Color::Green, Color::Purple, Color::Orange];
const MUJOCO_IN: [Color; 5] = [Color::Black, Color::Sky, Color::Wine, Color::Olive, Color::Gray];

/// Below it the reference is compared with itself and rounding shows.
const LEAST_SHOWN_UM: f64 = 1e-7;

pub(super) fn read(speed: &Table, hold: &Table, stiff: &Table, lock: &Table) -> Report {
    let mut notes = vec![format!("{:46} {:>8} {:>14} {:>12}", "", "step", "x real time", "max error")];
    for row in speed.rows() {
        notes.push(format!(
            "{:46} {:>8} {:>14.0} {:>12}{}",
            name(&row),
            duration(row.number("step_s")),
            row.number("realtime_factor"),
            length(row.number("max_error_m")),
            if row.word("stopped").is_empty() { String::new() } else { format!("  stopped: {}", row.word("stopped")) },
        ));
    }
    notes.extend(verdicts(speed));
    notes.push(still(hold));
    notes.extend(worst_with_stiff_hands(stiff));
    notes.extend(locked(lock));
    if speed.rows().all(|row| row.word("engine") != "mujoco") {
        notes.push(
            "MuJoCo was not asked for: build its runner with hil-tests/peers/mujoco and give what that prints to --mujoco"
                .to_owned(),
        );
    }
    Report { notes, charts: vec![("study-plant", chart(speed, hold))] }
}

fn name(row: &Row<'_>) -> String {
    format!("{} {}", row.word("engine"), row.word("method"))
}

/// A length with a unit near its size.
fn length(metres: f64) -> String {
    if metres.is_nan() {
        return "-".to_owned();
    }
    if metres == 0.0 {
        return "0".to_owned();
    }
    let (value, unit) = in_unit(metres, 0.9995);
    format!("{value:.3} {unit}")
}

fn duration(seconds: f64) -> String {
    format!("{} ms", seconds * 1e3)
}

/// How the fastest of ours that is no worse stands beside each of MuJoCo's, and what the reference is worth.
fn verdicts(speed: &Table) -> Vec<String> {
    let mut notes = Vec::new();
    let peers = speed.rows().filter(|row| row.word("engine") == "mujoco" && row.number("step_s") == USUAL_STEP_S);
    for peer in peers.filter(|row| row.number("max_error_m").is_finite()) {
        let ours = speed.rows().filter(|row| row.word("engine") == "yieldwall");
        let as_good = ours.filter(|row| row.number("max_error_m") <= peer.number("max_error_m"));
        let best = as_good.max_by(|a, b| a.number("realtime_factor").total_cmp(&b.number("realtime_factor")));
        let Some(best) = best else { continue };
        notes.push(format!(
            "no worse than {} at 1 ms ({}): {} in steps of {} ({}), {:.0} times its speed",
            name(&peer),
            length(peer.number("max_error_m")),
            best.word("method"),
            duration(best.number("step_s")),
            length(best.number("max_error_m")),
            best.number("realtime_factor") / peer.number("realtime_factor"),
        ));
    }
    let nearest = |engine: &str, is_reference: bool| {
        speed
            .rows()
            .filter(|row| row.word("engine") == engine && is_of(row, &OURS[2]) == is_reference)
            .filter(|row| row.number("step_s") != REFERENCE_STEP_S || !is_reference)
            .min_by(|a, b| a.number("max_error_m").total_cmp(&b.number("max_error_m")))
    };
    for row in [nearest("yieldwall", true), nearest("yieldwall", false), nearest("mujoco", false)].into_iter().flatten()
    {
        notes.push(format!(
            "the reference (RK4 + events, 0.1 ms) and {} in steps of {} are {} apart",
            name(&row),
            duration(row.number("step_s")),
            length(row.number("max_error_m"))
        ));
    }
    notes
}

fn is_of(row: &Row<'_>, contestant: &Contestant) -> bool {
    row.word("engine") == contestant.engine() && row.word("method") == contestant.method()
}

fn still(hold: &Table) -> String {
    let mut names: Vec<String> = hold.rows().filter(|row| row.is("is_exactly_still")).map(|row| name(&row)).collect();
    names.dedup();
    format!("held to the last bit under a push of 20 N: {}", names.join("; "))
}

/// The largest error of the shipped method at 1 ms over the stiff hands.
fn worst_with_stiff_hands(stiff: &Table) -> Option<String> {
    let shipped = stiff.rows().filter(|row| is_of(row, &OURS[0]) && row.number("step_s") == USUAL_STEP_S);
    let worst = shipped.max_by(|a, b| a.number("max_error_m").total_cmp(&b.number("max_error_m")))?;
    Some(format!(
        "greatest error of midpoint + gsat at 1 ms with stiff hands: {} at {} N/m and {} N s/m",
        length(worst.number("max_error_m")),
        worst.number("hand_n_per_m"),
        worst.number("hand_n_s_per_m"),
    ))
}

fn locked(lock: &Table) -> Vec<String> {
    let shipped = lock.rows().filter(|row| is_of(row, &OURS[0]));
    shipped
        .map(|row| {
            format!(
                "distal links pulled {} into line, steps of {} s: {}",
                row.word("pull"),
                row.number("step_s"),
                if row.word("stopped").is_empty() { "never refused" } else { row.word("stopped") },
            )
        })
        .collect()
}

fn chart(speed: &Table, hold: &Table) -> Chart {
    let mut series = [Vec::new(), Vec::new()];
    for (contestants, mark, colors) in [(&OURS, Mark::MarkedLine, OURS_IN), (&MUJOCO, Mark::MarkedDashes, MUJOCO_IN)] {
        for (contestant, color) in contestants.iter().zip(colors) {
            let timed = speed.rows().filter(|row| is_of(row, contestant));
            let held = hold.rows().filter(|row| is_of(row, contestant));
            let curves: [Vec<_>; 2] = [
                timed
                    .map(|row| (row.number("realtime_factor"), row.number("max_error_m") * 1e6))
                    .filter(|&(_, error_um)| error_um >= LEAST_SHOWN_UM)
                    .collect(),
                held.map(|row| (row.number("step_s") * 1e3, row.number("creep_m_per_s") * 1e6)).collect(),
            ];
            for (series, points) in series.iter_mut().zip(curves) {
                if points.is_empty() {
                    continue;
                }
                let title = format!("{}: {}", contestant.engine(), contestant.method());
                series.push(Series { name: title, points, mark, color });
            }
        }
    }
    let [mut error, creep] = series;
    let is_shipped = |row: &Row<'_>| is_of(row, &OURS[0]) && row.number("step_s") == USUAL_STEP_S;
    let points =
        speed.rows().filter(is_shipped).map(|row| (row.number("realtime_factor"), row.number("max_error_m") * 1e6));
    let name = "ring: the shipped method at 1 ms".to_owned();
    error.push(Series { points: points.collect(), ..Series::new(name, Mark::Rings, Color::Black) });
    let panels = vec![
        Panel {
            title: "steps of 1 ms (right) to 10 us (left)".to_owned(),
            x: Axis::logarithmic("x real time").over(1.0, 1e4),
            y: Axis::logarithmic("greatest error of the tool over 2 s (um)").over(LEAST_SHOWN_UM, 1e3),
            series: error,
        },
        Panel {
            title: "a push that dry friction holds".to_owned(),
            x: Axis::logarithmic("step (ms)").over(0.08, 1.25),
            y: Axis::logarithmic("creep (um/s)").over(1e-3, 1e4),
            series: creep,
        },
    ];
    Chart { title: "Five-bar with dry friction: methods and engines on one scene".to_owned(), panels }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::super::speed::Speed;
    use super::*;

    fn row(engine: &str, method: &str, step_s: f64, factor: f64, error_m: f64) -> Vec<Value> {
        let rest = [json!(factor), json!(factor), json!(error_m), json!(error_m), json!(0.0), Value::Null];
        [json!(engine), json!(method), json!(step_s), json!(factor)].into_iter().chain(rest).collect()
    }

    #[test]
    fn the_fastest_that_is_no_worse_is_compared() {
        let mut table = Table::new(&Speed::new(None));
        let rows = [
            row("yieldwall", "midpoint + gsat", 1e-3, 4000.0, 3e-7),
            row("yieldwall", "midpoint + gsat", 1e-4, 400.0, 3e-9),
            row("yieldwall", "semi-implicit Euler + gsat", 1e-3, 5000.0, 3.6e-5),
            row("yieldwall", "RK4 + events", 1e-4, 200.0, 0.0),
            row("mujoco", "implicitfast, tuned", 1e-3, 500.0, 3.7e-5),
            row("mujoco", "RK4, tuned", 1e-3, 100.0, 1e-6),
            row("mujoco", "RK4, tuned, no refsafe, noslip", 1e-3, 100.0, 1e-8),
            row("mujoco", "RK4, tuned", 1e-4, 10.0, 1e-8),
        ];
        for (index, row) in rows.into_iter().enumerate() {
            table.insert(index as u64, row);
        }
        let notes = verdicts(&table);
        let ends = |end: &str| notes.iter().filter(|note| note.ends_with(end)).count();
        assert_eq!(ends("semi-implicit Euler + gsat in steps of 1 ms (36.000 um), 10 times its speed"), 1, "{notes:?}");
        assert_eq!(ends("midpoint + gsat in steps of 1 ms (300.000 nm), 40 times its speed"), 1, "{notes:?}");
        assert_eq!(ends("in steps of 0.1 ms (3.000 nm), 4 times its speed"), 1, "{notes:?}");
        assert_eq!(ends("midpoint + gsat in steps of 0.1 ms are 3.000 nm apart"), 1, "{notes:?}");
        assert_eq!(ends("mujoco RK4, tuned, no refsafe, noslip in steps of 1 ms are 10.000 nm apart"), 1, "{notes:?}");
    }

    #[test]
    fn lengths_are_written_with_a_unit_of_their_size() {
        for (metres, text) in
            [(0.0, "0"), (f64::NAN, "-"), (2.5e-7, "250.000 nm"), (1e-3, "1.000 mm"), (1e-20, "0.000 fm")]
        {
            assert_eq!(length(metres), text);
        }
    }
}
