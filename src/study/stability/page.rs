//! The study's parts of `docs/studies.md`.

use super::super::page::{PageError, Rows, Tables, bullets, digits, markdown, relation};

const HANDS_N_PER_M: [f64; 5] = [300.0, 500.0, 1000.0, 3000.0, 10_000.0];
/// Settings of the table `mass-rows`, in words, and whether theory knows them.
const SETTINGS: [(&str, &str, bool); 9] = [
    ("no delay", "no delay", true),
    ("1 cycle", "force 1 cycle late", true),
    ("3 cycles", "force 3 cycles late", true),
    ("low pass 30 Hz", "low pass of 30 Hz", true),
    ("1 cycle, servo x2", "1 cycle, servo twice as fast", true),
    ("1 cycle, servo /2", "1 cycle, servo half as fast", true),
    ("dry, 1 cycle, b 30", "1 cycle, joints of 10 N m, b = 30 N s/m", false),
    ("dry, 1 cycle", "1 cycle, joints of 10 N m", false),
    ("dry, 1 cycle, F 3 N", "1 cycle, joints of 10 N m, F = 3 N", false),
];

/// A mass; the grid ends at 0.02 and 10 kg, and an empty cell is a mass beyond it.
fn kg(row: &Rows<'_>, column: &str) -> Result<String, PageError> {
    let mass_kg = row.one()?.cell(column).as_f64().unwrap_or(f64::INFINITY);
    Ok(match mass_kg {
        ..0.02 => "<0.02".to_owned(),
        10.0.. => ">10".to_owned(),
        _ => format!("{mass_kg:.2}"),
    })
}

pub(crate) fn masses(tables: &Tables<'_>) -> Result<String, PageError> {
    let rows = tables.read("mass-rows")?;
    let mut lines = Vec::new();
    for (setting, words, has_theory) in SETTINGS {
        let mut line = vec![words.to_owned()];
        for hand_n_per_m in HANDS_N_PER_M {
            let row = rows.all().with("setting", setting).with("hand_n_per_m", hand_n_per_m);
            let theory = if has_theory { format!(" / {}", kg(&row, "theory_kg")?) } else { String::new() };
            line.push(kg(&row, "measured_kg")? + &theory);
        }
        lines.push(line);
    }
    Ok(markdown(&["setting, kg: simulated / theory", "300 N/m", "500", "1000", "3000", "10 000"], &lines))
}

pub(crate) fn findings(tables: &Tables<'_>) -> Result<String, PageError> {
    let rows = tables.read("mass-rows")?;
    let stiff = rows.all().with("hand_n_per_m", 3000);
    let late = stiff.filter("up to 3 cycles", |row| ["no delay", "1 cycle", "3 cycles"].contains(&row.word("setting")));
    late.check("the crossover formula is too heavy", |row| row.number("crossover_kg") > row.number("theory_kg"))?;
    let ends = |column| Ok::<_, PageError>([digits(late.least(column)?, 2), digits(late.greatest(column)?, 2)]);
    let ([crossover, crossover_most], [exact, exact_most]) = (ends("crossover_kg")?, ends("theory_kg")?);
    let soft = rows.all().with("setting", "1 cycle").filter("up to 1 kN/m", |row| row.number("hand_n_per_m") <= 1000.0);
    soft.check("the crossover formula is too light", |row| row.number("crossover_kg") < row.number("theory_kg"))?;
    let share = soft.iter().map(|row| row.number("crossover_kg") / row.number("theory_kg")).fold(1.0, f64::min);
    let friction = tables.read("friction")?;
    let below = friction.all().filter("push below F", |row| row.number("push_over_friction") < 1.0);
    below.with("law", "proxy").check("the proxy stands still", |row| row.number("moved_m") == 0.0)?;
    let smooth = below.filter("law = tanh", |row| row.word("law").starts_with("tanh"));
    smooth.check("friction smoothed by tanh creeps", |row| row.number("moved_m") > 1e-4)?;

    let samples = tables.read("samples")?;
    let lost =
        samples.all().with("trouble", "lost, 10 in a row").with("hand_n_per_m", 3000).with("virtual_mass_kg", 0.5);
    let mean_mj = |share: f64| {
        let given = lost.with("share", share).numbers("given_j")?;
        Ok::<_, PageError>(1e3 * given.iter().sum::<f64>() / given.len() as f64)
    };
    samples
        .all()
        .with("share", 0.0)
        .check("with all samples the rig gives back no energy", |row| row.number("given_j") == 0.0)?;
    let (some, many) = (mean_mj(0.2)?, mean_mj(0.7)?);
    relation(many > some && some > 0.0, "the more samples are lost, the more energy comes back", lost.iter())?;
    Ok(bullets(&[
        format!(
            "With the plain servo, a hand of 3000 N/m and 15 N s/m, and up to 3 cycles of delay the crossover formula asks for \
             **{crossover} to {crossover_most} kg**. The sampled loop needs {exact} to {exact_most} kg of virtual mass. With hands \
             of up to 1000 N/m, one cycle late, the formula asks for as little as {} of the need. Rows: {}, {}.",
            digits(share, 2),
            late.places(),
            soft.places()
        ),
        format!(
            "A constant push of up to {} F moves the proxy of the fixture **by nothing, to the last bit**. With tanh of the last velocity in place of its friction the proxy creeps or chatters by {} to {} mm in 1 s. Rows: {}, {}.",
            digits(below.greatest("push_over_friction")?, 2),
            digits(1e3 * smooth.least("moved_m")?, 2),
            digits(1e3 * smooth.greatest("moved_m")?, 2),
            below.with("law", "proxy").places(),
            smooth.places()
        ),
        format!(
            "A rig that loses ten force samples in a row **can give back energy** to a hand of 3000 N/m with a proxy of 0.5 kg. Means \
             of 8 runs are {} mJ with 20 % of the samples lost and {} mJ with 70 %. Rows: {}.",
            digits(some, 2),
            digits(many, 2),
            lost.places()
        ),
    ]))
}
