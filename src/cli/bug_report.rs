//! `yieldwall report`: the contents of a bug report in one zip, without names of people and computers.

mod contents;
mod strip;

use std::io::{Cursor, Write};
use std::path::PathBuf;

use serde_json::json;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use self::contents::{Entry, contents};
use self::strip::Stripper;
use super::failure::{Exit, Failure};
use super::fit;
use super::keep::state_folder;
use super::output::Output;
use super::replace::Replace;
use yieldwall_config::Source;

/// Largest file of messages that is taken, bytes.
const MOST_MESSAGES: u64 = 1 << 20;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Rig that the report is about; the rig file may be one that the program refuses
    #[arg(value_name = "RIG.yaml")]
    rig: Option<String>,
    /// Zip file to create
    #[arg(long, value_name = "FILE.zip", default_value = "yieldwall-report.zip")]
    out: PathBuf,
    /// File with the program's messages, saved by `2> messages.txt` after the command
    #[arg(long, value_name = "FILE")]
    messages: Option<PathBuf>,
    /// Keep the serial numbers of devices in the report
    #[arg(long)]
    with_serials: bool,
    #[command(flatten)]
    replace: Replace,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    if let Some(rig) = &arguments.rig {
        // A refused file is reported; a missing one is a typing error.
        Source::named(rig).read()?;
    }
    arguments.replace.check_new(&arguments.out)?;
    let messages = arguments.messages.as_ref().map(messages).transpose()?;
    let state = |name: &str| state_folder(name).unwrap_or_default();
    let folders =
        contents::Folders { black_boxes: state("black-box"), drills: state("drills"), latency: state("latency") };
    let found = contents(arguments.rig.as_deref(), messages, &folders);
    let stripper = Stripper::of_this_computer(arguments.with_serials, &found);
    let (entries, left_out) = stripped(found, &stripper);
    let zip = zipped(&entries).map_err(|error| Failure::new(Exit::Internal, format!("zip: {error}"), ""))?;
    arguments.replace.write(&arguments.out, &zip)?;
    if output.is_json() {
        let files: Vec<_> = entries.iter().map(|(name, bytes)| json!({ "name": name, "bytes": bytes.len() })).collect();
        let document = json!({ "file": arguments.out, "files": files, "left_out": left_out });
        return output.report(document);
    }
    let mut text = format!("wrote {} ({} bytes)\n", arguments.out.display(), zip.len());
    for (name, bytes) in &entries {
        text += &format!("  {:>8}  {name}\n", bytes.len());
    }
    for why in &left_out {
        text += &format!("  left out: {why}\n");
    }
    let serials = if arguments.with_serials { "" } else { ", serial numbers" };
    let advice = format!(
        "Names of users and computers, home folders{serials} are taken out. Names that you have written into files yourself stay: look \
         into it before you send it.\n"
    );
    text += &fit::fitted(&advice, fit::USUAL);
    output.result(&text)
}

/// Returns the messages that the program has printed.
fn messages(path: &PathBuf) -> Result<String, Failure> {
    let refused = |message: String| {
        Failure::about_file(Exit::Usage, path, format!("{}: {message}", path.display()), "name a file of text")
    };
    let facts = std::fs::metadata(path).map_err(|error| refused(error.to_string()))?;
    if !facts.is_file() || facts.len() > MOST_MESSAGES {
        return Err(refused(format!("is no file of at most {MOST_MESSAGES} bytes")));
    }
    let bytes = std::fs::read(path).map_err(|error| refused(error.to_string()))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// Returns the entries as bytes without personal data, and the entries that are missing.
fn stripped(found: Vec<Entry>, stripper: &Stripper) -> (Vec<(String, Vec<u8>)>, Vec<String>) {
    let (mut entries, mut left_out) = (Vec::new(), Vec::new());
    for entry in found {
        let name = stripper.name(&entry.name);
        match entry.content.bytes(stripper) {
            Ok(bytes) => entries.push((name, bytes)),
            Err(why) => left_out.push(stripper.text(&format!("{}: {why}", entry.name))),
        }
    }
    (entries, left_out)
}

/// Returns one zip, with times that carry no information.
fn zipped(entries: &[(String, Vec<u8>)]) -> zip::result::ZipResult<Vec<u8>> {
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Deflated)
        .last_modified_time(zip::DateTime::default())
        .unix_permissions(0o644);
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in entries {
        zip.start_file(name.as_str(), options)?;
        zip.write_all(bytes)?;
    }
    Ok(zip.finish()?.into_inner())
}

#[cfg(test)]
mod tests;
