//! The study's parts of `docs/studies.md`.

use super::super::page::{PageError, Rows, Tables, bullets, length, markdown, relation};

const FIXTURES: [&str; 4] = ["master", "slave", "master, with passivity", "slave, with passivity"];
const TISSUES_N_PER_M: [f64; 3] = [0.0, 300.0, 3000.0];
/// A master that moves by less, in m/s, is at rest.
const REST_M_PER_S: f64 = 0.005;

fn at_rest<'a>(rows: &Rows<'a>) -> Rows<'a> {
    rows.filter("at rest", |row| row.number("unrest_m_per_s") < REST_M_PER_S)
}

pub(crate) fn delays(tables: &Tables<'_>) -> Result<String, PageError> {
    let table = tables.read("delays")?;
    let mut lines = Vec::new();
    for fixture in FIXTURES {
        let mut line = vec![format!("at the {fixture}")];
        for hand_n_per_m in [300.0, 3000.0] {
            let mut longest = Vec::new();
            for tissue_n_per_m in TISSUES_N_PER_M {
                let pairs = table
                    .all()
                    .with("fixture", fixture)
                    .with("hand_n_per_m", hand_n_per_m)
                    .with("tissue_n_per_m", tissue_n_per_m);
                let most_s = at_rest(&pairs).greatest("delay_s")?;
                let shorter = pairs.filter("shorter delays", |row| row.number("delay_s") <= most_s);
                shorter.check("pairs with shorter delays come to rest too", |row| {
                    row.number("unrest_m_per_s") < REST_M_PER_S
                })?;
                longest.push(format!("{:.0}", 1e3 * most_s));
            }
            line.push(longest.join(" / "));
        }
        lines.push(line);
    }
    Ok(markdown(
        &["fixture", "soft hand: longest delay at rest, ms; tissue of 0 / 300 / 3000 N/m", "braced hand"],
        &lines,
    ))
}

pub(crate) fn findings(tables: &Tables<'_>) -> Result<String, PageError> {
    let table = tables.read("delays")?;
    let with = table.all().filter("with passivity", |row| row.word("fixture").ends_with("passivity"));
    let without = table.all().filter("without", |row| !row.word("fixture").ends_with("passivity"));
    with.check("all pairs with the passivity controller come to rest", |row| {
        row.number("unrest_m_per_s") < REST_M_PER_S
    })?;
    let resting = at_rest(&without).count();
    relation(resting < without.count(), "some pairs without it do not", without.iter())?;
    Ok(bullets(&[format!(
        "With the passivity controller of 0.02 J **all {} pairs come to rest**, and {resting} of {} without it; the slave still gets up to {} beyond the wall. Rows: {}.",
        with.count(),
        without.count(),
        length(with.greatest("slave_depth_m")?),
        table.all().places()
    )]))
}
