//! `yieldwall completions` and `yieldwall man`: shell completions and manual pages, generated from the definitions of the
//! arguments.

use std::fs;
use std::path::PathBuf;

use clap::CommandFactory;
use clap_complete::Shell;
use serde_json::json;

use super::failure::{Exit, Failure};
use super::output::Output;
use super::replace::make_folder;
use super::replace::unwritten;

/// Name of the program.
const NAME: &str = "yieldwall";

#[derive(Debug, clap::Args)]
pub(super) struct Completions {
    /// Shell, such as bash
    #[arg(value_enum)]
    shell: Shell,
}

#[derive(Debug, clap::Args)]
pub(super) struct Man {
    /// Folder for the pages of the program and of each command; default: the program's page on standard output
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Prints the completions of a shell.
pub(super) fn completions(arguments: &Completions, output: &mut Output) -> Result<(), Failure> {
    let mut text = Vec::new();
    clap_complete::generate(arguments.shell, &mut super::Arguments::command(), NAME, &mut text);
    let text = String::from_utf8_lossy(&text);
    if output.is_json() {
        return output.report(json!({ "shell": arguments.shell.to_string(), "completions": text }));
    }
    output.verbatim(&text)
}

/// Prints the manual page of the program, or writes all into a folder.
pub(super) fn man(arguments: &Man, output: &mut Output) -> Result<(), Failure> {
    let page = |command: &clap::Command| {
        let mut text = Vec::new();
        let rendered = clap_mangen::Man::new(command.clone()).render(&mut text);
        rendered.map_err(|error| Failure::new(Exit::Internal, format!("manual page: {error}"), ""))?;
        Ok::<_, Failure>(text)
    };
    let mut program = super::examples::with_examples(super::Arguments::command());
    program.build();
    let Some(folder) = &arguments.out else {
        let text = page(&program)?;
        let text = String::from_utf8_lossy(&text);
        return if output.is_json() { output.report(json!({ "page": text })) } else { output.verbatim(&text) };
    };
    make_folder(folder)?;
    let mut pages = Vec::new();
    let mut open = vec![program];
    while let Some(command) = open.pop() {
        // `yieldwall od read` is yieldwall-od-read(1).
        let name = command.get_display_name().unwrap_or(command.get_name()).to_owned();
        let path = folder.join(format!("{name}.1"));
        fs::write(&path, page(&command)?).map_err(|error| unwritten(&path, &error))?;
        pages.push(path);
        open.extend(command.get_subcommands().filter(|one| one.get_name() != "help").cloned());
    }
    pages.sort();
    if output.is_json() {
        return output.report(json!({ "files": pages }));
    }
    output.news(&format!("written   {} pages into {}", pages.len(), folder.display()))
}
