//! A computation in parts: by processes that know nothing of one another, and by job arrays of a scheduler.

use std::collections::BTreeSet;
use std::num::{NonZeroU64, NonZeroUsize};
use std::path::Path;

use serde_json::json;

use super::failure::{Exit, Failure};
use super::output::Output;
use super::usage::at_least_one;
use yieldwall_rig::batch::Shard;

/// The part to compute, or a question about parts.
#[derive(Debug, clap::Args)]
pub(super) struct Parts {
    /// Compute only part I of N, counted from 1, and keep it in the folder of --out: for job arrays
    ///
    /// Several computers can compute parts at the same time, with the same build. When all parts are in one folder, --merge
    /// combines them. A part leaves out tables that measure time: compute these in one run, without --shard.
    #[arg(long, value_name = "I/N", conflicts_with = "merge")]
    pub(super) shard: Option<Shard>,
    /// Compute nothing: combine the parts in the folder of --out
    ///
    /// The folder has to hold all results, in whichever parts; the command names what is missing. The result equals that of a run
    /// without parts. The parts stay unchanged.
    #[arg(long)]
    pub(super) merge: bool,
    /// Compute nothing: print a script that submits N parts to Slurm as a job array, and a job that combines them
    ///
    /// The header of the script shows how to submit it. --jobs is the number of processors of each task; default: 1. The script
    /// contains the absolute paths of this program, the folder of --out and the present folder. Each computer needs access to them.
    #[arg(long, value_name = "N", conflicts_with_all = ["shard", "merge", "missing"], value_parser = at_least_one::<NonZeroU64>)]
    pub(super) slurm: Option<NonZeroU64>,
    /// Compute nothing: print the numbers of the incomplete parts, in the format of `sbatch --array=` (3,7-9)
    #[arg(long, requires = "of", conflicts_with_all = ["shard", "merge"])]
    pub(super) missing: bool,
    /// With --missing: number of parts
    #[arg(long, value_name = "N", requires = "missing", value_parser = at_least_one::<NonZeroU64>)]
    pub(super) of: Option<NonZeroU64>,
}

impl Parts {
    /// Whether anything may be computed.
    pub(super) fn computes(&self) -> bool {
        !self.merge && self.slurm.is_none() && !self.missing
    }

    /// Whether the command concerns parts at all.
    pub(super) fn is_in_parts(&self) -> bool {
        self.shard.is_some() || !self.computes()
    }

    /// Prints the parts that hold any of `numbers`, if this is requested, and returns whether it is.
    pub(super) fn print_missing(
        &self,
        numbers: impl FnOnce() -> Result<Vec<u64>, Failure>,
        output: &mut Output,
    ) -> Result<bool, Failure> {
        let Some(of) = self.of.filter(|_| self.missing) else { return Ok(false) };
        let missing = Shard::holding(numbers()?, of);
        let array = ranges(&missing);
        if output.is_json() {
            output.report(json!({ "parts": of, "missing": missing, "array": array }))?;
        } else if !missing.is_empty() {
            output.verbatim(&format!("{array}\n"))?;
        }
        Ok(true)
    }

    /// Prints the script of a job array, if this is requested, and returns whether it is.
    pub(super) fn print_script(&self, array: &Array<'_>, output: &mut Output) -> Result<bool, Failure> {
        let Some(parts) = self.slurm else { return Ok(false) };
        let path = |path: std::io::Result<std::path::PathBuf>| {
            let path = path.map_err(|error| Failure::new(Exit::Usage, error.to_string(), ""))?;
            written(&path).ok_or_else(|| {
                let message = format!("{}: a script cannot name this path", path.display());
                Failure::new(Exit::Usage, message, "choose a path of UTF-8 without control characters")
            })
        };
        let places = Places {
            program: path(std::env::current_exe())?,
            here: path(std::env::current_dir())?,
            out: path(std::path::absolute(array.out))?,
        };
        let script = script(array, parts, &places);
        if output.is_json() {
            output.report(json!({ "parts": parts, "script": script }))?;
        } else {
            output.verbatim(&script)?;
        }
        Ok(true)
    }
}

/// A computation that a job array is to do.
pub(super) struct Array<'a> {
    /// Name of its jobs.
    pub(super) name: String,
    /// Words of the command behind the program, without --out.
    pub(super) words: Vec<String>,
    /// Further words of the job after the array; `--merge` among them unless that job computes.
    pub(super) last: Vec<String>,
    /// Folder of the results.
    pub(super) out: &'a Path,
    /// Processors of a task.
    pub(super) jobs: Option<NonZeroUsize>,
}

/// Absolute paths as a shell takes them.
struct Places {
    program: String,
    here: String,
    out: String,
}

fn script(array: &Array<'_>, parts: NonZeroU64, places: &Places) -> String {
    let Places { program, here, out } = places;
    let jobs = array.jobs.map_or(1, NonZeroUsize::get);
    let name = &array.name;
    let command = format!("{program} {} --out {out}", line(&array.words));
    let last = if array.last.is_empty() { String::new() } else { format!(" {}", line(&array.last)) };
    format!(
        r#"#!/usr/bin/env bash
# A job array of {parts} parts for Slurm, and a job that puts them together once each part has ended well. This submits both:
#
#     bash FILE
#
# If parts failed, were cancelled or ran out of time, this submits those that are missing, and the last job:
#
#     missing=$(cd {here} && {command} --missing --of {parts}) && bash FILE "$missing"
#
# Lines #SBATCH for a partition, an account or a time limit go below the others; both jobs take them.
#SBATCH --job-name={name}
#SBATCH --array=1-{parts}
#SBATCH --cpus-per-task={jobs}
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --signal=B:TERM@60
set -e
if [ -z "${{SLURM_ARRAY_TASK_ID-}}" ]; then
    parts=${{1-1-{parts}}}
    after=
    if [ -n "$parts" ]; then
        array=$(sbatch --parsable --array="$parts" "$0")
        after=--dependency=afterok:${{array%%;*}}
        echo "array ${{array%%;*}}: parts $parts of {parts}"
    fi
    exec sbatch --array=1 --job-name={name}-last --kill-on-invalid-dep=yes ${{after:+"$after"}} "$0" last
fi
cd {here}
if [ "${{1-}}" = last ]; then
    exec {command}{last}
fi
# {parts} is not SLURM_ARRAY_TASK_COUNT: that one is 1 if one part alone is submitted again.
if ! {{ [ "$SLURM_ARRAY_TASK_ID" -ge 1 ] && [ "$SLURM_ARRAY_TASK_ID" -le {parts} ]; }}; then
    echo "error: there is no part $SLURM_ARRAY_TASK_ID of {parts}" >&2
    exit 2
fi
exec {command} --shard "$SLURM_ARRAY_TASK_ID/{parts}"
"#
    )
}

/// Words as a shell takes them.
pub(super) fn line(words: &[String]) -> String {
    words.iter().map(|word| quoted(word)).collect::<Vec<_>>().join(" ")
}

/// Quotes a word for a shell.
fn quoted(word: &str) -> String {
    let is_plain = |one: char| one.is_ascii_alphanumeric() || "/._-+,:@%=".contains(one);
    if !word.is_empty() && word.chars().all(is_plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

/// Quotes a path for a shell, on one line.
fn written(path: &Path) -> Option<String> {
    path.to_str().filter(|path| !path.contains(char::is_control)).map(quoted)
}

/// Returns numbers as ranges: `3,7-9`.
fn ranges(numbers: &BTreeSet<u64>) -> String {
    let mut ranges: Vec<(u64, u64)> = Vec::new();
    for &number in numbers {
        match ranges.last_mut() {
            Some((_, last)) if *last + 1 == number => *last = number,
            _ => ranges.push((number, number)),
        }
    }
    let text = |(first, last): &(u64, u64)| if first == last { first.to_string() } else { format!("{first}-{last}") };
    ranges.iter().map(text).collect::<Vec<_>>().join(",")
}

/// Returns the number of threads: the given one, or that of Slurm for the task, or that of this process's processors.
pub(super) fn threads(given: Option<NonZeroUsize>) -> usize {
    let allotted = std::env::var("SLURM_CPUS_PER_TASK").ok();
    let own = || std::thread::available_parallelism().ok();
    threads_of(given, allotted.as_deref()).or_else(own).map_or(1, NonZeroUsize::get)
}

fn threads_of(given: Option<NonZeroUsize>, allotted: Option<&str>) -> Option<NonZeroUsize> {
    given.or_else(|| allotted?.trim().parse().ok())
}

/// Returns the failure of an interrupted computation: `kept` names the place of its results, if any are kept.
pub(super) fn interrupted(missing: usize, of: usize, what: &str, kept: Option<&str>) -> Failure {
    let message = format!("interrupted: {missing} of {of} {what} are missing; {}", kept.unwrap_or("no result is kept"));
    let again = "give the command again: it goes on where it stood";
    Failure::new(Exit::Interrupted, message, if kept.is_some() { again } else { "give the command again" })
}

/// Returns the failure of a merge without any part: `command` are the words behind the program that compute the results.
pub(super) fn nothing_to_merge(message: &str, command: &str, out: &Path, is_timed: bool) -> Failure {
    let whole = format!("yieldwall {command} --out {}", written(out).unwrap_or_else(|| out.display().to_string()));
    let help = if is_timed {
        format!("this table measures time and has no parts: `{whole}` computes it")
    } else {
        format!(
            "compute the parts first, as `{whole} --shard 1/4` to `--shard 4/4`; --slurm 4 prints a script for it. \
             Without --merge and --shard the command computes everything"
        )
    };
    Failure::new(Exit::Usage, format!("{message}: there is nothing to merge"), help)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_printed_as_sbatch_takes_them() {
        for (numbers, text) in [
            (&[][..], ""),
            (&[3], "3"),
            (&[3, 7, 8, 9], "3,7-9"),
            (&[1, 2, 4, 6, 7], "1-2,4,6-7"),
            (&[u64::MAX], "18446744073709551615"),
        ] {
            assert_eq!(ranges(&numbers.iter().copied().collect()), text);
        }
    }

    #[test]
    fn a_task_has_the_threads_that_it_was_given() {
        let number = NonZeroUsize::new;
        for (given, allotted, expected) in [
            (number(3), Some("8"), number(3)),
            (None, Some("8"), number(8)),
            (None, Some("0"), None),
            (None, Some("-1"), None),
            (None, Some("8(x2)"), None),
            (None, None, None),
        ] {
            assert_eq!(threads_of(given, allotted), expected, "{given:?} {allotted:?}");
        }
        assert!(threads(None) >= 1);
    }

    #[test]
    fn words_are_quoted_where_a_shell_would_read_them() {
        let words = ["study", "a b", "", "it's", "$(x)", "--set=a=1,2"].map(str::to_owned);
        assert_eq!(line(&words), r"study 'a b' '' 'it'\''s' '$(x)' --set=a=1,2");
        assert_eq!(written(Path::new("/a\nb")), None);
    }

    fn sample(words: &[&str], last: &[&str]) -> String {
        let owned = |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect();
        let array = Array {
            name: "yieldwall-study-pair".to_owned(),
            words: owned(words),
            last: owned(last),
            out: Path::new("out"),
            jobs: NonZeroUsize::new(2),
        };
        let places = Places {
            program: "/opt/yieldwall".to_owned(),
            here: "/home/me".to_owned(),
            out: "'/data/my results'".to_owned(),
        };
        script(&array, NonZeroU64::new(16).unwrap(), &places)
    }

    #[test]
    fn the_script_of_an_array_reads() {
        insta::assert_snapshot!("slurm", sample(&["study", "pair"], &["--merge"]));
    }

    /// Runs the script as a task of an array or as a user. Programs that print their arguments replace `sbatch` and this program.
    #[cfg(target_os = "linux")]
    fn run(script: &str, task: Option<&str>, arguments: &[&str]) -> (Option<i32>, String) {
        use std::fs;
        use std::os::unix::fs::PermissionsExt;
        use std::process::Command;
        static COUNT: std::sync::atomic::AtomicU32 = std::sync::atomic::AtomicU32::new(0);
        let count = COUNT.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        let folder = std::env::temp_dir().join(format!("yieldwall-slurm-{}-{count}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let program = folder.join("program");
        for (path, text) in [
            (&program, "#!/bin/sh\necho \"program $*\"\n"),
            (
                &folder.join("sbatch"),
                "#!/bin/sh\necho \"sbatch $*\" >>\"$0.log\"\n[ \"$1\" != --parsable ] || echo '41;here'\n",
            ),
        ] {
            fs::write(path, text).unwrap();
            fs::set_permissions(path, fs::Permissions::from_mode(0o755)).unwrap();
        }
        let script = script.replace("/opt/yieldwall", program.to_str().unwrap()).replace("cd /home/me", "cd /");
        fs::write(folder.join("array.sh"), script).unwrap();
        let path = format!("{}:{}", folder.display(), std::env::var("PATH").unwrap_or_default());
        let mut bash = Command::new("bash");
        bash.current_dir(&folder).arg("array.sh").args(arguments).env("PATH", path).env_remove("SLURM_ARRAY_TASK_ID");
        if let Some(task) = task {
            bash.env("SLURM_ARRAY_TASK_ID", task).env("SLURM_ARRAY_TASK_COUNT", "1");
        }
        let output = bash.output().unwrap();
        let log = fs::read_to_string(folder.join("sbatch.log")).unwrap_or_default();
        fs::remove_dir_all(&folder).unwrap();
        (output.status.code(), format!("{log}{}", String::from_utf8(output.stdout).unwrap()))
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn the_script_submits_itself_and_runs_a_part_of_the_number_that_stands_in_it() {
        let script = sample(&["study", "pair"], &["--merge"]);
        let submitted = |array: &str| format!("sbatch --parsable --array={array} array.sh\n");
        let last = |after: &str| {
            format!(
                "sbatch --array=1 --job-name=yieldwall-study-pair-last --kill-on-invalid-dep=yes{after} array.sh last\n"
            )
        };
        let after = " --dependency=afterok:41";
        let out = "--out /data/my results";
        for (task, arguments, exit, printed) in [
            (None, &[][..], 0, format!("{}{}array 41: parts 1-16 of 16\n", submitted("1-16"), last(after))),
            (None, &["3,7-9"], 0, format!("{}{}array 41: parts 3,7-9 of 16\n", submitted("3,7-9"), last(after))),
            (None, &[""], 0, last("")),
            (Some("3"), &[], 0, format!("program study pair {out} --shard 3/16\n")),
            (Some("16"), &[], 0, format!("program study pair {out} --shard 16/16\n")),
            (Some("1"), &["last"], 0, format!("program study pair {out} --merge\n")),
            (Some("17"), &[], 2, String::new()),
            (Some("0"), &[], 2, String::new()),
            (Some("x"), &[], 2, String::new()),
        ] {
            assert_eq!(run(&script, task, arguments), (Some(exit), printed), "{task:?} {arguments:?}");
        }
        let computes = sample(&["study", "it's"], &[]);
        assert_eq!(run(&computes, Some("1"), &["last"]), (Some(0), format!("program study it's {out}\n")));
    }
}
