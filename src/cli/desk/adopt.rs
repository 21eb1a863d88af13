//! `yieldwall drive adopt`: a drive nobody has a profile of, and the profile that follows.

use std::path::{Path, PathBuf};

use serde_json::json;
use yieldwall_drives::cia402::OperationMode;

use super::keeping::{Named, back_up};
use super::od::sheet_of;
use super::place::{DeviceSession, Place};
use super::words::{mode_words, name, titled};
use crate::failure::{Exit, Failure};
use crate::output::Output;
use crate::replace::Replace;
use yieldwall_config::ProfileName;
use yieldwall_service::adopt::{Refusal, contradictions, originals, profile, survey};

/// Columns of a terminal.
const WIDTH: usize = 80;

#[derive(Debug, clap::Subcommand)]
pub(crate) enum Command {
    /// Write the profile of a drive: asked of it and tried out in Switch On Disabled; all values are put back
    Adopt(Arguments),
}

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// A node id, or the name of a drive in the rig
    #[arg(long)]
    node: String,
    /// The profile's file; standard output unless one is named
    #[arg(long, value_name = "PROFILE.yaml")]
    out: Option<PathBuf>,
    /// Name of the profile; made of the drive's own name unless given
    #[arg(long)]
    name: Option<String>,
    /// A data sheet (EDS or DCF): names objects, saves asking, and is compared with the drive, whose word counts
    #[arg(long, value_name = "FILE.eds")]
    eds: Option<PathBuf>,
    /// Say which objects would be tried out, and write nothing
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    replace: Replace,
    #[command(flatten)]
    place: Place,
}

pub(crate) fn run(command: &Command, output: &mut Output) -> Result<(), Failure> {
    let Command::Adopt(arguments) = command;
    if let Some(name) = arguments.name.as_ref().filter(|name| kebab(name) != **name || name.is_empty()) {
        let help = format!("write for example --name {}", kebab(name));
        return Err(Failure::new(
            Exit::Usage,
            format!("--name {name}: small letters, digits and dashes make a name"),
            help,
        ));
    }
    if let Some(name) = arguments.name.as_ref().filter(|name| is_shipped(name)) {
        let message = format!("--name {name}: a profile that comes with the program is called so");
        return Err(Failure::new(Exit::Usage, message, format!("write for example --name {name}{ADOPTED}")));
    }
    let eds = sheet_of(arguments.eds.as_deref(), output)?;
    let mut desk = DeviceSession::open(&arguments.place, output)?;
    let node = desk.node(&arguments.node)?;
    let refused = |desk: &DeviceSession, refusal: Refusal| match refusal {
        Refusal::Service(error) => desk.failure(&node, "asking what it can do", error),
        Refusal::State(_) => {
            let help = format!("{} says why; --reset-fault takes it out of Fault", desk.command("state", &node));
            Failure::new(Exit::DeviceFault, format!("{}: {refusal}; nothing was written", node.words()), help)
        }
        Refusal::Nmt(_) => {
            let help = format!("`yieldwall nmt {} preop{}` first", node.id.raw(), desk.arguments);
            Failure::new(Exit::Usage, format!("{}: {refusal}; nothing was written", node.words()), help)
        }
        Refusal::NoDrive(_) => {
            let message = format!("{}: {refusal}; nothing was written", node.words());
            Failure::new(Exit::DeviceMismatch, message, format!("`yieldwall scan{}` shows the drives", desk.arguments))
        }
        Refusal::Lacks(_) => Failure::new(Exit::DeviceMismatch, format!("{}: {refusal}", node.words()), ""),
        Refusal::NotRestored(_) => Failure::new(
            Exit::DeviceMismatch,
            format!("{}: {refusal}", node.words()),
            format!("`yieldwall nmt {} reset{}` has it start with its stored values", node.id.raw(), desk.arguments),
        ),
    };
    let values = originals(&mut desk.service, node.id).map_err(|refusal| refused(&desk, refusal))?;
    if arguments.dry_run {
        let each: Vec<String> = values.iter().map(|(at, _)| titled(*at, &name(*at, eds.as_ref()))).collect();
        if output.is_json() {
            return output.report(json!({ "place": desk.place, "dry_run": true, "tries": each }));
        }
        return output.result(&format!("would try out, and put back:\n{}\n", each.join("\n")));
    }
    if let Some(path) = &arguments.out {
        arguments.replace.check_new(path)?;
    }
    if let Some(path) = back_up(desk.is_simulated, Named::Node(node.id), &values, eds.as_ref())? {
        output.aside(&format!("kept      {}", path.display()));
    }
    let found = survey(&mut desk.service, node.id, &values, eds.as_ref()).map_err(|refusal| refused(&desk, refusal))?;
    let named = arguments.name.clone().or_else(|| {
        let product = eds.as_ref().map(|eds| eds.device.product.as_str());
        found.name.as_deref().into_iter().chain(product).map(kebab).find(|name| !name.is_empty())
    });
    let named = named.unwrap_or_else(|| format!("node-{}", node.id.raw()));
    let named = if is_shipped(&named) { format!("{named}{ADOPTED}") } else { named };
    let file = arguments.eds.as_deref().and_then(Path::file_name).unwrap_or_default().to_string_lossy();
    let sheet = eds.as_ref().map(|eds| (eds, &*file));
    let (text, missing) = profile(&found, sheet, &named, env!("CARGO_PKG_VERSION"));
    let contradictions = eds.as_ref().map_or_else(Vec::new, |eds| contradictions(eds, &found));
    if let Some(path) = &arguments.out {
        arguments.replace.write(path, text.as_bytes())?;
    }
    let modes: Vec<&str> = found.modes.iter().map(|mode: &OperationMode| mode_words(*mode)).collect();
    if output.is_json() {
        return output.report(json!({
            "place": desk.place,
            "node_id": node.id.raw(),
            "name": named,
            "file": arguments.out,
            "modes": modes,
            "mapping_entries": found.mapping_entries,
            "has_dummies": found.has_dummies,
            "has_rpdo_timer": found.has_rpdo_timer,
            "missing": missing,
            "contradictions": contradictions,
            "profile": text,
        }));
    }
    let Some(path) = &arguments.out else { return output.verbatim(&text) };
    let mut told = format!(
        "{}: {named}, {}\n",
        node.words(),
        if modes.is_empty() { "no mode that `run` could use".to_owned() } else { modes.join(", ") }
    );
    missing.iter().for_each(|line| told.push_str(&item(line)));
    if !contradictions.is_empty() {
        told.push_str("the data sheet contradicts the drive, whose word counts:\n");
        contradictions.iter().for_each(|line| told.push_str(&item(line)));
    }
    told.push_str(&format!("written   {}; `yieldwall config check` checks it\n", path.display()));
    output.result(&told)
}

/// What is put behind the name of a profile that is another one's.
const ADOPTED: &str = "-adopted";

/// Whether a profile that comes with the program is called so.
fn is_shipped(name: &str) -> bool {
    ProfileName::shipped().any(|(shipped, _)| shipped == name)
}

/// A line of a list, not wider than a terminal.
fn item(line: &str) -> String {
    let options = textwrap::Options::new(WIDTH).initial_indent("  - ").subsequent_indent("    ");
    textwrap::fill(line, options) + "\n"
}

/// A name as profiles have it.
fn kebab(name: &str) -> String {
    let lower: String =
        name.chars().map(|one| if one.is_ascii_alphanumeric() { one.to_ascii_lowercase() } else { '-' }).collect();
    lower.split('-').filter(|part| !part.is_empty()).collect::<Vec<_>>().join("-")
}
