//! `yieldwall record`: what is in a recording, and what can be saved of a damaged one.

use std::fs::{self, OpenOptions};
use std::path::{Path, PathBuf};

use serde_json::json;

use super::failure::{Exit, Failure};
use super::output::Output;
use super::replay::{damage, open, read_failure};
use crate::record::CycleRecord;
use crate::record::recording::Writer;

#[derive(Debug, clap::Subcommand)]
pub(super) enum Command {
    /// Say what is in a recording: cycles, time, gaps, damage
    Info {
        /// The recording
        #[arg(value_name = "FILE")]
        file: PathBuf,
        /// Print the message definition too: each field with its unit
        #[arg(long)]
        schema: bool,
    },
    /// Write what can be read of a cut or damaged recording into a whole one
    Repair {
        /// The recording
        #[arg(value_name = "FILE")]
        file: PathBuf,
        /// The new file; by default FILE with .repaired before its ending
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
}

pub(super) fn run(command: &Command, output: &mut Output) -> Result<(), Failure> {
    match command {
        Command::Info { file, schema } => info(file, *schema, output),
        Command::Repair { file, out } => repair(file, out.as_deref(), output),
    }
}

/// What the cycles of a recording have in common.
#[derive(Default)]
struct Content {
    cycles: u64,
    first: Option<CycleRecord>,
    last: Option<CycleRecord>,
    gaps: u64,
    missing: u64,
}

impl Content {
    fn take(&mut self, record: &CycleRecord) {
        if let Some(last) = &self.last {
            let missing = record.moment.index.saturating_sub(last.moment.index).saturating_sub(1);
            self.gaps += u64::from(missing > 0);
            self.missing = self.missing.saturating_add(missing);
        }
        self.cycles += 1;
        self.first.get_or_insert(*record);
        self.last = Some(*record);
    }

    /// Numbers and times of the first and the last cycle.
    fn ends(&self) -> Option<[(u64, f64); 2]> {
        let end = |record: CycleRecord| (record.moment.index, record.moment.sync_ns as f64 * 1e-9);
        Some([end(self.first?), end(self.last?)])
    }
}

fn info(file: &Path, schema: bool, output: &mut Output) -> Result<(), Failure> {
    let mut reader = open(file)?;
    let mut content = Content::default();
    while let Some(record) = reader.next_record().map_err(|error| read_failure(file, &error))? {
        content.take(&record);
    }
    let definition = schema.then(crate::record::recording::definition);
    let damage = damage(&reader, file);
    let about = reader.about();
    if output.is_json() {
        let ends = content.ends();
        return output.json(&json!({
            "file": file,
            "version": about.version,
            "commit": about.commit,
            "target": about.target,
            "seed": about.seed,
            "overrides": about.overrides,
            "cycles": content.cycles,
            "first_cycle": ends.map(|[(first, _), _]| first),
            "last_cycle": ends.map(|[_, (last, _)]| last),
            "from_s": ends.map(|[(_, from), _]| from),
            "to_s": ends.map(|[_, (_, to)]| to),
            "gaps": content.gaps,
            "missing_cycles": content.missing,
            "is_whole": damage.is_empty(),
            "damage": reader.damage_count(),
            "schema": definition,
            "diagnostics": damage,
        }));
    }
    output.warnings(&damage);
    let mut text = format!("recorded  by {}, seed {}", super::replay::maker(about), about.seed);
    if !about.overrides.is_empty() {
        text.push_str(&format!(", {}", about.overrides.escape_debug()));
    }
    text.push_str(&match content.ends() {
        Some([(first, from_s), (last, to_s)]) => format!(
            "\ncycles    {}, number {first} to {last}, {from_s:.3} to {to_s:.3} s since switching on",
            content.cycles
        ),
        None => "\ncycles    none".to_owned(),
    });
    text.push_str(&match content.gaps {
        0 => "\ngaps      none".to_owned(),
        gaps => format!("\ngaps      {gaps}, {} cycles are missing", content.missing),
    });
    text.push_str(&match reader.damage_count() {
        0 => "\nfile      whole".to_owned(),
        1 => "\nfile      damaged at 1 place".to_owned(),
        count => format!("\nfile      damaged at {count} places"),
    });
    if let Some(definition) = definition {
        text.push_str("\n\n");
        text.push_str(definition.trim_end());
    }
    output.news(&text)
}

fn repair(file: &Path, out: Option<&Path>, output: &mut Output) -> Result<(), Failure> {
    let mut reader = open(file)?;
    let out = out.map_or_else(|| file.with_extension("repaired.mcap"), Path::to_owned);
    let cannot = |error: std::io::Error| {
        let help = "choose a new file in a folder that can be written, with --out";
        Failure::new(Exit::Usage, format!("{}: {error}", out.display()), help)
    };
    let target = OpenOptions::new().write(true).create_new(true).open(&out).map_err(cannot)?;
    let mut content = Content::default();
    let save = || -> Result<(), Failure> {
        let mut writer = Writer::new(target, reader.about()).map_err(cannot)?;
        while let Some(record) = reader.next_record().map_err(|error| read_failure(file, &error))? {
            content.take(&record);
            writer.write(&record).map_err(cannot)?;
        }
        writer.finish().map_err(cannot)
    };
    if let Err(failure) = save() {
        // Half a file is of no use to anybody.
        let _ = fs::remove_file(&out);
        return Err(failure);
    }
    let damage = damage(&reader, file);
    if output.is_json() {
        return output.json(&json!({
            "file": file,
            "out": out,
            "kept_cycles": content.cycles,
            "gaps": content.gaps,
            "missing_cycles": content.missing,
            "damage": reader.damage_count(),
            "diagnostics": damage,
        }));
    }
    output.warnings(&damage);
    let lost = match (content.missing, reader.damage_count()) {
        (0, 0) => "nothing is lost".to_owned(),
        (0, _) => "no cycle between the first and the last is lost".to_owned(),
        (missing, _) => format!("{missing} cycles are missing in {} gaps", content.gaps),
    };
    output.news(&format!("{}: {} cycles kept; {lost}", out.display(), content.cycles))
}
