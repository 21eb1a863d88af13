//! A study of one's own: a rig or an impedance device in every combination of values that a user sets over its own and those of its scene.

use std::num::NonZeroU32;

use serde_json::Value;
use thiserror::Error;

use super::chart::{Axis, Chart, Color, Estimate, Mark, Panel, Series};
use super::machine::Machine;
use super::need::outputs::Outcome;
use super::page::digits;
use super::sweep::{Clock, Report, Row, Study, Sweep, Table, median, median_interval};
use yieldwall_config::{self as config, Document, SetValue, SetValueError, Source};
use yieldwall_rig::report::Overrides;

/// Measures of a run that the table has.
pub const OUTPUTS: [&str; 14] = [
    "unintended_releases",
    "penetration_mm",
    "tool_rms_tracing_mm",
    "tool_rms_on_surface_mm",
    "tool_max_on_surface_mm",
    "peak_force_on_surface_n",
    "force_age_mean_ms",
    "energy_given_j",
    "energy_taken_j",
    "energy_rise_j",
    "energy_excess_j",
    "peak_torque_n_m",
    "torque_limit_s",
    "power_positive_fraction",
];

/// Outputs that are drawn unless others are chosen.
const DRAWN: [&str; 4] = ["penetration_mm", "tool_rms_on_surface_mm", "peak_force_on_surface_n", "energy_given_j"];
/// Most combinations of a sweep.
const MOST_SETTINGS: u64 = 2000;
/// Settings that are printed; the table has all of them.
const MOST_PRINTED: usize = 50;
/// Greatest over least value of a key from which on its axis is logarithmic.
const LOGARITHMIC_FROM: f64 = 30.0;
/// Share by which an output has to change to be drawn.
const CHANGE: f64 = 1e-3;
/// Outputs up to here are zero except for rounding, whatever their unit.
const ROUNDING: f64 = 1e-9;
/// Outcome of a run that came to its end.
const RAN: &str = "ran";
/// Name of the study and of its chart.
const NAME: &str = "sweep";

/// Reason why there is nothing to sweep.
#[derive(Debug, Error)]
pub enum SettingsError {
    /// Two keys set the same, or none is set.
    #[error(transparent)]
    Key(#[from] SetValueError),
    /// A value is refused by the checks of the machine or of its scene.
    #[error("{setting}: {report}")]
    Refused {
        /// The value with its key.
        setting: String,
        /// The findings.
        report: config::Report,
    },
    /// The file is neither a rig with a simulation nor an impedance device.
    #[error("{0} is no rig and no impedance device")]
    NoMachine(String),
    /// There are too many combinations.
    #[error("{0} combinations are more than {MOST_SETTINGS}")]
    TooMany(u64),
    /// A key has a value twice.
    #[error("{0} is given twice")]
    Repeated(String),
    /// A key and an option set the same.
    #[error("{key} and {option} contradict each other")]
    Twice {
        /// The key.
        key: &'static str,
        /// The option.
        option: &'static str,
    },
    /// No measure has this name.
    #[error("{0} is not a measure of a run")]
    NoOutput(String),
}

/// The study of a machine in all combinations of some values.
pub struct Settings {
    sweeps: [Box<dyn Sweep>; 1],
    keys: Vec<String>,
    drawn: Vec<&'static str>,
    /// Texts of all machines and scenes.
    texts: Vec<String>,
}

struct Runs {
    settings: Vec<Combination>,
    columns: Vec<String>,
    seeds: u64,
    duration_s: Option<f64>,
}

/// A combination of values, read once.
struct Combination {
    /// The values, as the table has them.
    cells: Vec<Value>,
    /// The machine with its scene, or the reason why they are refused.
    machine: Result<(Machine, config::Scene), String>,
}

/// A machine with its scene.
fn load(source: Source) -> Result<Option<(Machine, config::Scene)>, config::Report> {
    Ok(match config::load(source)? {
        Document::Rig(rig) => {
            let scene = rig.scene()?.value;
            Some((Machine::Rig(Box::new(rig.value)), scene))
        }
        Document::Device(device) => {
            let scene = device.scene()?.value;
            Some((Machine::Device(Box::new(device.value)), scene))
        }
        Document::Scene(_)
        | Document::Figure(_)
        | Document::Profile(_)
        | Document::Simulation(_)
        | Document::ErrorCodes(_) => None,
    })
}

impl Settings {
    /// Returns the study of `source` in all combinations of the values of `axes`, each a key with its values. It uses `seeds`
    /// seeds, from the seed of the scene on. It draws `outputs`; without any, it draws four of [`OUTPUTS`]. Each value is
    /// checked, with the other keys at their first value. If a combination is still refused, its row says so.
    ///
    /// # Errors
    /// As [`SettingsError`] has them.
    pub fn new(
        source: Source,
        axes: Vec<Vec<SetValue>>,
        seeds: NonZeroU32,
        duration_s: Option<f64>,
        outputs: &[String],
    ) -> Result<Self, SettingsError> {
        let name = source.to_string();
        let count = axes.iter().map(|values| values.len() as u64).fold(1, u64::saturating_mul);
        if count > MOST_SETTINGS {
            return Err(SettingsError::TooMany(count));
        }
        let set = |key: &str| axes.iter().flatten().any(|value| value.key() == key);
        for (key, option, is_given) in
            [("scene.duration_s", "--duration", duration_s.is_some()), ("scene.seed", "--seeds", seeds.get() > 1)]
        {
            if is_given && set(key) {
                return Err(SettingsError::Twice { key, option });
            }
        }
        let drawn = outputs.iter().map(|output| {
            let known = OUTPUTS.into_iter().find(|name| name == output);
            known.ok_or_else(|| SettingsError::NoOutput(output.clone()))
        });
        let drawn = drawn.collect::<Result<Vec<_>, _>>()?;
        let named = |value: &SetValue| format!("{}={}", value.key(), value.value());
        for (place, values) in axes.iter().enumerate() {
            for (number, value) in values.iter().enumerate() {
                if values[..number].iter().any(|other| other.value() == value.value()) {
                    return Err(SettingsError::Repeated(named(value)));
                }
                let mut set: Vec<SetValue> = axes.iter().filter_map(|values| values.first().cloned()).collect();
                set[place] = value.clone();
                let refused = |report| SettingsError::Refused { setting: named(value), report };
                if load(source.clone().with_values(&set)?).map_err(refused)?.is_none() {
                    return Err(SettingsError::NoMachine(name));
                }
            }
        }
        let keys: Vec<String> = axes.iter().filter_map(|values| Some(values.first()?.key())).collect();
        let found = ["seed", "outcome"].into_iter().chain(OUTPUTS).map(str::to_owned);
        let columns = keys.iter().cloned().chain(found).collect();
        let settings = (0..count).map(|index| Combination::new(&source, &axes, index)).collect();
        let runs = Runs { settings, columns, seeds: seeds.get().into(), duration_s };
        let drawn = if drawn.is_empty() { DRAWN.to_vec() } else { drawn };
        let texts = runs.settings.iter().map(|setting| format!("{:?}", setting.machine)).collect();
        Ok(Self { sweeps: [Box::new(runs)], keys, drawn, texts })
    }

    /// All that the runs hang on, for one sweep to be known from another: each machine with its scene.
    pub fn texts(&self) -> &[String] {
        &self.texts
    }
}

impl Combination {
    /// The combination of a number, the last key's value changing first.
    fn new(source: &Source, axes: &[Vec<SetValue>], index: u64) -> Self {
        let mut rest = index;
        let mut set: Vec<SetValue> = Vec::new();
        for values in axes.iter().rev() {
            let count = values.len() as u64;
            set.extend(values.get((rest % count) as usize).cloned());
            rest /= count;
        }
        set.reverse();
        let machine = match source.clone().with_values(&set).map(load) {
            Ok(Ok(Some(machine))) => Ok(machine),
            Ok(Err(report)) => Err(report.diagnostics.first().map_or_else(String::new, |first| first.message.clone())),
            Ok(Ok(None)) => Err("no rig and no impedance device".to_owned()),
            Err(error) => Err(error.to_string()),
        };
        Self { cells: set.iter().map(|set| cell(set.value())).collect(), machine }
    }
}

impl Sweep for Runs {
    fn name(&self) -> &str {
        "runs"
    }

    fn columns(&self) -> Vec<&str> {
        self.columns.iter().map(String::as_str).collect()
    }

    fn points(&self) -> u64 {
        self.settings.len() as u64 * self.seeds
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let Some(setting) = self.settings.get((index / self.seeds) as usize) else {
            return vec![Value::Null; self.columns.len()];
        };
        let mut cells = setting.cells.clone();
        match &setting.machine {
            Ok((machine, scene)) => {
                let seed = scene.seed.wrapping_add(index % self.seeds);
                let overrides = Overrides { duration_s: self.duration_s, seed: Some(seed), ..Overrides::default() };
                let run = machine.run(scene, &overrides, |_| {});
                cells.extend([seed.into(), Outcome::of(&run).end.into()]);
                let measures = run.ok().and_then(|run| serde_json::to_value(&run.measures).ok()).unwrap_or_default();
                cells.extend(OUTPUTS.iter().map(|output| measures.get(output).cloned().unwrap_or_default()));
            }
            Err(why) => cells.extend([Value::Null, format!("refused: {why}").into()]),
        }
        cells.resize(self.columns.len(), Value::Null);
        cells
    }
}

/// A number, or else the text.
fn cell(value: &str) -> Value {
    let number = value.parse::<f64>().ok().filter(|number| number.is_finite());
    number
        .and_then(|_| serde_json::from_str(value).ok())
        .or_else(|| number.map(Value::from))
        .unwrap_or_else(|| value.into())
}

/// Rows of one setting: all its seeds.
struct Setting<'a>(Vec<Row<'a>>);

impl Setting<'_> {
    fn estimate(&self, output: &str) -> Estimate {
        // A run that a fault ended early has other energies and peaks.
        let values = || self.0.iter().filter(|row| row.word("outcome") == RAN).map(|row| row.number(output));
        let value = median(values()).unwrap_or(f64::NAN);
        match median_interval(values()) {
            Some([low, high]) => Estimate { value, low, high },
            None => value.into(),
        }
    }

    fn text(&self, key: &str) -> String {
        self.0.first().map_or(String::new(), |row| match row.cell(key) {
            Value::String(word) => word.clone(),
            other => other.to_string(),
        })
    }

    fn name(&self, keys: &[String]) -> String {
        keys.iter().map(|key| format!("{key} {}", self.text(key))).collect::<Vec<_>>().join(", ")
    }

    /// Returns the values of these keys as the name of a series.
    fn label(&self, keys: &[String]) -> String {
        let value = |key: &String| {
            let (words, unit) = words_and_unit(key);
            format!("{words} {} {}", self.text(key), unit.unwrap_or_default()).trim_end().to_owned()
        };
        keys.iter().map(value).collect::<Vec<_>>().join(", ")
    }

    /// Cells of the printed table: the values, the outcomes, the medians of some outputs.
    fn cells(&self, keys: &[String], outputs: &[&str]) -> Vec<String> {
        let others: Vec<&str> =
            self.0.iter().map(|row| row.word("outcome")).filter(|outcome| *outcome != RAN).collect();
        let outcome = match (self.0.len(), others.as_slice()) {
            (_, []) => "all ran".to_owned(),
            (1, [other]) => (*other).to_owned(),
            (all, [first, ..]) => format!("{} of {all} not: {first}", others.len()),
        };
        let estimates = outputs.iter().map(|output| {
            let Estimate { value, low, high } = self.estimate(output);
            let text = |value: f64| if value.abs() < ROUNDING { "0".to_owned() } else { digits(value, 3) };
            match (value.is_finite(), low.is_finite() && high.is_finite()) {
                (false, _) => "-".to_owned(),
                (true, false) => text(value),
                (true, true) => format!("{} ({} to {})", text(value), text(low), text(high)),
            }
        });
        keys.iter().map(|key| self.text(key)).chain([outcome]).chain(estimates).collect()
    }
}

/// Leaves out the columns that have no value in any row below the head.
fn with_values(rows: Vec<Vec<String>>) -> Vec<Vec<String>> {
    let has_value = |column: &usize| rows.iter().skip(1).any(|row| row.get(*column).is_some_and(|cell| cell != "-"));
    let kept: Vec<usize> = (0..rows.first().map_or(0, Vec::len)).filter(has_value).collect();
    let of_row = |row: &Vec<String>| kept.iter().filter_map(|column| row.get(*column).cloned()).collect();
    rows.iter().map(of_row).collect()
}

/// Lines of a table whose columns are aligned.
fn aligned(rows: &[Vec<String>]) -> Vec<String> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let wide = |column: usize| rows.iter().filter_map(|row| Some(row.get(column)?.chars().count())).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns).map(wide).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).map(|(cell, width)| format!("{cell:width$}"));
        cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    rows.iter().map(line).collect()
}

impl Study for Settings {
    fn name(&self) -> &str {
        NAME
    }

    fn about(&self) -> &'static str {
        "a rig in every combination of some values"
    }

    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.sweeps
    }

    fn report(&self, tables: &[Table]) -> Report {
        let mut settings: Vec<Setting<'_>> = Vec::new();
        for row in tables.iter().flat_map(Table::rows) {
            let is_same = |setting: &Setting<'_>| {
                setting.0.first().is_some_and(|first| self.keys.iter().all(|key| first.cell(key) == row.cell(key)))
            };
            match settings.last_mut().filter(|setting| is_same(setting)) {
                Some(setting) => setting.0.push(row),
                None => settings.push(Setting(vec![row])),
            }
        }
        let heads = self.keys.iter().map(String::as_str).chain(["outcome"]).chain(self.drawn.iter().copied());
        let mut printed = vec![heads.map(str::to_owned).collect()];
        printed.extend(settings.iter().take(MOST_PRINTED).map(|setting| setting.cells(&self.keys, &self.drawn)));
        let mut notes = aligned(&with_values(printed));
        if settings.len() > MOST_PRINTED {
            notes.push(format!("{} more settings are in runs.csv", settings.len() - MOST_PRINTED));
        }
        match self.chart(&settings) {
            Ok(chart) => Report { notes, charts: vec![(NAME, chart)] },
            Err(why) => {
                notes.push(why);
                Report { notes, charts: Vec::new() }
            }
        }
    }
}

/// Whether an output is another one in some settings, by more than a thousandth and more than rounding leaves.
fn changes(settings: &[Setting<'_>], output: &str) -> bool {
    let values: Vec<f64> =
        settings.iter().map(|setting| setting.estimate(output).value).filter(|value| value.is_finite()).collect();
    let greatest = values.iter().fold(0.0, |greatest: f64, value| greatest.max(value.abs()));
    let span =
        values.iter().copied().fold(f64::NEG_INFINITY, f64::max) - values.iter().copied().fold(f64::INFINITY, f64::min);
    span > CHANGE * greatest && greatest > ROUNDING
}

/// Units at the ends of names, the longest first.
const UNITS: [(&str, &str); 24] = [
    ("_n_m_s_per_rad", "N m s/rad"),
    ("_n_m_per_rad", "N m/rad"),
    ("_rad_per_s", "rad/s"),
    ("_n_s_per_m", "N s/m"),
    ("_m_per_s", "m/s"),
    ("_n_per_m", "N/m"),
    ("_counts", "counts"),
    ("_share", "share"),
    ("_n_m", "N m"),
    ("_rad", "rad"),
    ("_deg", "deg"),
    ("_kg", "kg"),
    ("_mm", "mm"),
    ("_um", "um"),
    ("_us", "us"),
    ("_ms", "ms"),
    ("_mj", "mJ"),
    ("_hz", "Hz"),
    ("_w", "W"),
    ("_j", "J"),
    ("_n", "N"),
    ("_m", "m"),
    ("_s", "s"),
    ("_v", "V"),
];

/// Returns the name of a key or of a measure in words, and its unit: `scene.hand.mass_kg` as `hand mass` and `kg`.
fn words_and_unit(key: &str) -> (String, Option<&'static str>) {
    // The last two parts are enough.
    let from = key.rmatch_indices('.').nth(1).map_or(0, |(dot, _)| dot + 1);
    let key = &key[from..];
    let found = UNITS.iter().find_map(|(end, unit)| Some((key.strip_suffix(end)?, Some(*unit))));
    let (name, unit) = found.unwrap_or((key, None));
    (name.replace(['.', '_'], " "), unit)
}

/// Returns the name of a key or of a measure as the name of an axis.
fn in_words(key: &str) -> String {
    let (words, unit) = words_and_unit(key);
    unit.map_or_else(|| words.clone(), |unit| format!("{words} ({unit})"))
}

impl Settings {
    /// The outputs over the first key, a series for each combination of the others.
    fn chart(&self, settings: &[Setting<'_>]) -> Result<Chart, String> {
        let Some((across, others)) = self.keys.split_first() else { return Err("no key is set".to_owned()) };
        let mut words: Vec<String> = Vec::new();
        let mut numbers: Vec<f64> = Vec::new();
        let (mut names, mut labels): (Vec<String>, Vec<String>) = Default::default();
        for setting in settings {
            let (word, name) = (setting.text(across), setting.name(others));
            if !words.contains(&word) {
                numbers.extend(word.parse::<f64>());
                words.push(word);
            }
            if !names.contains(&name) {
                names.push(name);
                labels.push(setting.label(others));
            }
        }
        let marks = [Mark::MarkedLine, Mark::MarkedDashes];
        if names.len() > marks.len() * Color::LINES.len() {
            return Err(format!(
                "{} series are too many for a chart: set the key with the most values first",
                names.len()
            ));
        }
        let is_numeric = numbers.len() == words.len();
        let [least, most] = [
            numbers.iter().copied().fold(f64::INFINITY, f64::min),
            numbers.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        ];
        // One range for all panels, with a margin beyond the outermost values.
        let margin = if most > least { 0.05 * (most - least) } else { 0.5 };
        let x = || match is_numeric {
            false => Axis::of_words(&in_words(across), words.clone()),
            true if least > 0.0 && most / least >= LOGARITHMIC_FROM => {
                Axis::logarithmic(&in_words(across)).over(least / 1.2, most * 1.2)
            }
            true => Axis::linear(&in_words(across)).over(least - margin, most + margin),
        };
        let place = |setting: &Setting<'_>| {
            let word = setting.text(across);
            let at = if is_numeric {
                word.parse().ok()
            } else {
                words.iter().position(|known| *known == word).map(|place| place as f64 + 1.0)
            };
            at.unwrap_or(f64::NAN)
        };
        let panel = |output: &&str| {
            let series = names.iter().zip(&labels).enumerate().flat_map(|(number, (name, label))| {
                let of_name = settings.iter().filter(|setting| setting.name(others) == *name);
                let points: Vec<_> = of_name.map(|setting| (place(setting).into(), setting.estimate(output))).collect();
                let colors = Color::LINES;
                Series::new(label.clone(), marks[number / colors.len()], colors[number % colors.len()]).through(&points)
            });
            Panel { title: String::new(), x: x(), y: Axis::linear(&in_words(output)), series: series.collect() }
        };
        let panels: Vec<Panel> = self.drawn.iter().filter(|output| changes(settings, output)).map(panel).collect();
        if panels.is_empty() {
            return Err(
                "these measures are the same in all settings, or no run has them: there is nothing to draw".to_owned()
            );
        }
        Ok(Chart { title: format!("Medians over {}, intervals of 95 %", words_and_unit(across).0), panels })
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn settings(axes: &[&str], seeds: u32) -> Result<Settings, SettingsError> {
        let axes = axes.iter().map(|text| SetValue::each(text)).collect::<Result<Vec<_>, _>>()?;
        Settings::new(config::builtin("play.yaml"), axes, NonZeroU32::new(seeds).unwrap(), Some(1.6), &[])
    }

    #[test]
    fn an_option_that_would_override_a_key_is_refused() {
        for (key, seeds) in [("scene.duration_s=1,2", 1), ("scene.seed=1,2", 2)] {
            assert!(matches!(settings(&[key], seeds), Err(SettingsError::Twice { .. })), "{key}");
        }
        let source = config::builtin("play.yaml");
        let axes = vec![SetValue::each("scene.seed=1,2").unwrap()];
        assert!(Settings::new(source, axes, NonZeroU32::MIN, None, &[]).is_ok());
    }

    #[test]
    fn each_combination_is_run_with_each_seed() {
        let study = settings(&["fixture.yield_n=20,25", "scene.hand.mass_kg=0.5,1.0,1.5"], 2).unwrap();
        let sweep = &study.sweeps()[0];
        assert_eq!(sweep.points(), 12);
        assert_eq!(sweep.columns()[..4], ["fixture.yield_n", "scene.hand.mass_kg", "seed", "outcome"]);
        let mut table = Table::new(sweep.as_ref());
        (0..12).for_each(|index| table.insert(index, sweep.point(index, &|| Duration::ZERO)));
        let rows: Vec<_> = table
            .rows()
            .map(|row| ["fixture.yield_n", "scene.hand.mass_kg", "seed"].map(|key| row.number(key)))
            .collect();
        assert_eq!(rows[..3], [[20.0, 0.5, 1.0], [20.0, 0.5, 2.0], [20.0, 1.0, 1.0]]);
        assert_eq!(rows[11], [25.0, 1.5, 2.0]);
        assert!(table.rows().all(|row| row.word("outcome") == "ran"), "{}", table.csv());
        // Values reach the run: two seeds differ, and two masses do.
        let given = |index: usize| table.rows().nth(index).unwrap().number("energy_taken_j");
        assert!(given(0) != given(1) && given(0) != given(2), "{}", table.csv());
        let report = study.report(&[table]);
        assert_eq!(report.notes.len(), 7);
        let line = |number: usize| report.notes[number].split_whitespace().collect::<Vec<_>>();
        assert_eq!(line(0)[..4], ["fixture.yield_n", "scene.hand.mass_kg", "outcome", "penetration_mm"]);
        assert_eq!(line(1)[..4], ["20", "0.5", "all", "ran"]);
        let chart = &report.charts[0].1;
        assert_eq!(chart.panels[0].x.name, "fixture yield (N)");
        assert_eq!(chart.panels[0].series.iter().filter(|series| !series.points.is_empty()).count(), 3);
        assert_eq!(chart.panels[0].series[0].name, "hand mass 0.5 kg");
    }

    #[test]
    fn names_of_keys_and_measures_are_words_with_units() {
        let names = [
            ("fixture.yield_n", "fixture yield (N)"),
            ("scene.hand.stiffness_n_per_m", "hand stiffness (N/m)"),
            ("fixture.coupling.admittance.mass_kg", "admittance mass (kg)"),
            ("peak_torque_n_m", "peak torque (N m)"),
            ("fixture.hold_steps", "fixture hold steps"),
        ];
        for (key, name) in names {
            assert_eq!(in_words(key), name);
        }
    }

    #[test]
    fn a_value_that_is_refused_is_named_and_a_combination_is_a_row() {
        let error = settings(&["fixture.yield_n=20,-1"], 1).err().unwrap();
        assert!(matches!(&error, SettingsError::Refused { setting, .. } if setting == "fixture.yield_n=-1"), "{error}");
        assert!(matches!(settings(&["fixture.yield_n=20", "fixture.yield_n=21"], 1), Err(SettingsError::Key(_))));
        let repeated = settings(&["fixture.yield_n=20,21,20"], 1).err().unwrap();
        assert!(matches!(&repeated, SettingsError::Repeated(setting) if setting == "fixture.yield_n=20"), "{repeated}");
        // R has to be above F.
        let study = settings(&["fixture.friction_n=3,15", "fixture.yield_n=20,10"], 1).unwrap();
        let cells = study.sweeps()[0].point(3, &|| Duration::ZERO);
        assert!(cells[3].as_str().is_some_and(|outcome| outcome.starts_with("refused: ")), "{cells:?}");
    }

    #[test]
    fn columns_without_a_value_are_not_printed() {
        let rows = [["key", "a", "b"], ["1", "-", "2"], ["3", "-", "-"]];
        let kept = with_values(rows.iter().map(|row| row.map(str::to_owned).to_vec()).collect());
        assert_eq!(kept, [["key", "b"], ["1", "2"], ["3", "-"]]);
    }

    #[test]
    fn every_output_is_a_measure_of_a_run() {
        let study = settings(&["fixture.law=null"], 1).unwrap();
        let (machine, scene) = load(config::builtin("play.yaml")).unwrap().unwrap();
        let run = machine.run(&scene, &Overrides { duration_s: Some(0.2), ..Overrides::default() }, |_| {}).unwrap();
        let measures = serde_json::to_value(&run.measures).unwrap();
        for output in OUTPUTS {
            assert!(measures.get(output).is_some(), "{output}");
            assert!(study.sweeps()[0].columns().contains(&output));
        }
        assert!(DRAWN.iter().all(|output| OUTPUTS.contains(output)));
    }
}
