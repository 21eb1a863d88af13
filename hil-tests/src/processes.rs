//! Processes that tests start, and a limit for each test that starts any.
//!
//! The output of a process is read while it runs, so that it never waits for a reader. When a test reaches its limit, a report goes to
//! standard error: of each process of the test where its threads wait, and what it wrote last. Then the processes are killed, and the test
//! fails. No process outlives its test.

use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::fs::read_dir;
use std::io::{ErrorKind, Read, Write};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::thread;
use std::time::Duration;

/// Limit of a test that starts processes; only one that hangs reaches it.
pub const LIMIT: Duration = Duration::from_secs(240);
/// Time that a test has left once its processes are killed.
const GRACE: Duration = Duration::from_secs(10);
/// Time between two looks at a process that may have ended.
const POLL: Duration = Duration::from_millis(10);
/// Bytes of an output that a report has.
const LAST_BYTES: usize = 4096;

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Output of a process so far, and whether it can write no more.
#[derive(Debug, Default)]
struct Written {
    bytes: Vec<u8>,
    is_over: bool,
}

#[derive(Debug, Default)]
struct Pipe {
    written: Mutex<Written>,
    has_changed: Condvar,
}

impl Pipe {
    fn of(mut from: impl Read + Send + 'static) -> Arc<Self> {
        let pipe = Arc::<Self>::default();
        let own = Arc::clone(&pipe);
        thread::spawn(move || {
            let mut buffer = [0; 4096];
            loop {
                let length = match from.read(&mut buffer) {
                    Ok(length) => length,
                    Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                    Err(_) => 0,
                };
                let mut written = lock(&own.written);
                written.bytes.extend(&buffer[..length]);
                written.is_over = length == 0;
                own.has_changed.notify_all();
                if length == 0 {
                    return;
                }
            }
        });
        pipe
    }

    fn last(&self) -> String {
        let written = lock(&self.written);
        let from = written.bytes.len().saturating_sub(LAST_BYTES);
        String::from_utf8_lossy(&written.bytes[from..]).into_owned()
    }
}

/// Reads what a process writes, from where the last read ended.
#[derive(Clone, Debug, Default)]
pub struct PipeReader {
    pipe: Arc<Pipe>,
    at: usize,
}

impl Read for PipeReader {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let is_waiting = |written: &mut Written| written.bytes.len() == self.at && !written.is_over;
        let written = self.pipe.has_changed.wait_while(lock(&self.pipe.written), is_waiting);
        let written = written.unwrap_or_else(PoisonError::into_inner);
        let length = (&written.bytes[self.at..]).read(buffer)?;
        self.at += length;
        Ok(length)
    }
}

/// A child, shared by its test and the watch over the test.
#[derive(Debug)]
struct Started {
    child: Mutex<Child>,
    pid: u32,
    outputs: Vec<(&'static str, Arc<Pipe>)>,
}

/// A test that has started processes.
#[derive(Debug)]
struct Test {
    name: String,
    limit: Duration,
    started: Mutex<Vec<Weak<Started>>>,
    has_expired: AtomicBool,
    /// Dropped with the test.
    _runs: Sender<()>,
}

thread_local! {
    /// Each test has a thread of its own.
    static TEST: OnceCell<Arc<Test>> = const { OnceCell::new() };
}

/// Sets the limit of this test, which starts now.
///
/// # Panics
/// If the test has one already.
pub fn set_limit(limit: Duration) {
    TEST.with(|test| assert!(test.set(Test::begin(limit)).is_ok(), "a test has one limit"));
}

impl Test {
    fn begin(limit: Duration) -> Arc<Self> {
        let (runs, ended) = channel();
        let name = thread::current().name().unwrap_or("a test").to_owned();
        let started = Mutex::default();
        let test = Arc::new(Self { name, limit, started, has_expired: AtomicBool::new(false), _runs: runs });
        let watched = Arc::downgrade(&test);
        thread::spawn(move || watch(&watched, &ended, limit));
        test
    }

    fn all(&self) -> Vec<Arc<Started>> {
        lock(&self.started).iter().filter_map(Weak::upgrade).collect()
    }

    /// Fails the test if it has reached its limit.
    fn check(&self) {
        let Self { name, limit, .. } = self;
        assert!(
            !self.has_expired.load(Ordering::Relaxed),
            "{name} has reached its limit of {limit:?}, see the report above"
        );
    }
}

/// Ends a test that reaches its limit.
fn watch(test: &Weak<Test>, ended: &Receiver<()>, limit: Duration) {
    let is_over = |wait: Duration| ended.recv_timeout(wait) != Err(RecvTimeoutError::Timeout);
    if is_over(limit) {
        return;
    }
    let Some(test) = test.upgrade() else { return };
    test.has_expired.store(true, Ordering::Relaxed);
    let all = test.all();
    let children = children();
    let mut report = format!("\ntest {} has reached its limit of {limit:?}\n", test.name);
    let mut descendants = Vec::new();
    for started in &all {
        let below = below(started.pid, &children);
        let ended = lock(&started.child).try_wait();
        report += &format!("process {}, {}\n{}", started.pid, how(ended), place(started.pid));
        below.iter().for_each(|pid| report += &format!("process {pid}, started by it\n{}", place(*pid)));
        for (name, pipe) in &started.outputs {
            report += &format!("its last {name}:\n{}\n", pipe.last());
        }
        descendants.extend(below);
    }
    report += &format!("the test itself, process {}\n{}", std::process::id(), place(std::process::id()));
    // The macros write to what the test captures, which is lost if the process has to end.
    let say = |text: &str| _ = std::io::stderr().write_all(text.as_bytes());
    say(&report);
    for started in &all {
        let _ = lock(&started.child).kill();
    }
    for pid in descendants {
        let _ = Command::new("kill").args(["-s", "KILL", &pid.to_string()]).status();
    }
    let name = test.name.clone();
    drop((test, all));
    if !is_over(GRACE.min(limit)) {
        say(&format!("test {name} ... FAILED: it goes on without its processes\n"));
        std::process::exit(101);
    }
}

fn how(ended: std::io::Result<Option<ExitStatus>>) -> String {
    match ended {
        Ok(None) => "which runs".to_owned(),
        Ok(Some(status)) => format!("which has ended: {status}"),
        Err(error) => format!("which cannot be asked: {error}"),
    }
}

/// The processes that each process has started.
fn children() -> BTreeMap<u32, Vec<u32>> {
    let mut children = BTreeMap::<u32, Vec<u32>>::new();
    for entry in read_dir("/proc").into_iter().flatten().flatten() {
        let stat = std::fs::read_to_string(entry.path().join("stat")).unwrap_or_default();
        // The name in parentheses may hold anything; state and parent follow it.
        let parent = stat.rsplit_once(')').and_then(|(_, rest)| rest.split_whitespace().nth(1)?.parse().ok());
        let pid = entry.file_name().to_str().and_then(|name| name.parse().ok());
        if let (Some(parent), Some(pid)) = (parent, pid) {
            children.entry(parent).or_default().push(pid);
        }
    }
    children
}

/// All processes that one has started, directly or not.
fn below(pid: u32, children: &BTreeMap<u32, Vec<u32>>) -> Vec<u32> {
    let direct = children.get(&pid).into_iter().flatten();
    direct.flat_map(|child| [vec![*child], below(*child, children)].concat()).collect()
}

/// The command line of a process, and where each of its threads waits.
fn place(pid: u32) -> String {
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default().replace('\0', " ");
    let mut text = format!("  {}\n", read(&format!("/proc/{pid}/cmdline")).trim_end());
    for thread in read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten() {
        let of = |what: &str| read(&format!("{}/{what}", thread.path().display())).trim_end().to_owned();
        let is_told =
            |line: &&str| ["State", "ShdPnd", "SigBlk", "SigIgn", "SigCgt"].iter().any(|key| line.starts_with(key));
        let status = of("status");
        let status = status.lines().filter(is_told).collect::<Vec<_>>().join(", ");
        text += &format!("  thread {}: {status}, in {}, call {}\n", of("comm"), of("wchan"), of("syscall"));
        // Root alone may read the stack.
        of("stack").lines().for_each(|line| text += &format!("    {line}\n"));
    }
    text
}

/// A process that does not outlive its test.
#[derive(Debug)]
pub struct Process {
    started: Arc<Started>,
    test: Arc<Test>,
    stdout: PipeReader,
    stderr: PipeReader,
}

impl Process {
    /// Starts a program.
    ///
    /// # Panics
    /// If it cannot be started.
    pub fn start(command: &mut Command) -> Self {
        let child = command.spawn();
        Self::of(child.unwrap_or_else(|error| panic!("{}: {error}", command.get_program().display())))
    }

    /// Takes a child over with the pipes that it still has.
    pub fn of(mut child: Child) -> Self {
        let no_pipe = || {
            Arc::new(Pipe { written: Mutex::new(Written { is_over: true, ..Written::default() }), ..Pipe::default() })
        };
        let stdout = child.stdout.take().map_or_else(no_pipe, Pipe::of);
        let stderr = child.stderr.take().map_or_else(no_pipe, Pipe::of);
        let outputs = vec![("output", Arc::clone(&stdout)), ("errors", Arc::clone(&stderr))];
        let started = Arc::new(Started { pid: child.id(), child: Mutex::new(child), outputs });
        let test = TEST.with(|test| Arc::clone(test.get_or_init(|| Test::begin(LIMIT))));
        lock(&test.started).push(Arc::downgrade(&started));
        let [stdout, stderr] = [stdout, stderr].map(|pipe| PipeReader { pipe, at: 0 });
        Self { started, test, stdout, stderr }
    }

    /// Number of the process.
    pub fn pid(&self) -> u32 {
        self.started.pid
    }

    /// Its standard output. [`Process::output`] has the rest.
    pub fn stdout(&mut self) -> &mut PipeReader {
        &mut self.stdout
    }

    /// Sends a signal by its name, such as `INT`.
    ///
    /// # Panics
    /// If the process was waited for already.
    pub fn signal(&self, name: &str) {
        let id = self.pid().to_string();
        assert!(Command::new("kill").args(["-s", name, &id]).status().expect("procps").success());
    }

    /// Whether it has ended.
    ///
    /// # Panics
    /// If the test has reached its limit.
    pub fn has_ended(&mut self) -> bool {
        self.status().is_some()
    }

    fn status(&self) -> Option<ExitStatus> {
        let status = lock(&self.started.child).try_wait().expect("it is a child");
        self.test.check();
        status
    }

    /// Waits for the end: exit status, and what of its output nobody has read.
    ///
    /// # Panics
    /// If the test has reached its limit.
    pub fn output(mut self) -> Output {
        let status = loop {
            match self.status() {
                Some(status) => break status,
                None => thread::sleep(POLL),
            }
        };
        let [mut stdout, mut stderr] = [Vec::new(), Vec::new()];
        self.stdout.read_to_end(&mut stdout).expect("it is in memory");
        self.stderr.read_to_end(&mut stderr).expect("it is in memory");
        self.test.check();
        Output { status, stdout, stderr }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let ask = || lock(&self.started.child).try_wait();
        let ended = ask();
        let _ = lock(&self.started.child).kill();
        while matches!(ask(), Ok(None)) {
            thread::sleep(POLL);
        }
        if thread::panicking() {
            let said = self.started.outputs.iter().map(|(_, pipe)| pipe.last()).collect::<Vec<_>>().join("\n");
            eprintln!("process {}, {} at the failure, has said:\n{said}", self.pid(), how(ended));
        } else {
            self.test.check();
        }
    }
}

/// Runs a program to its end without an input, as [`Command::output`] does.
///
/// # Panics
/// If it cannot be started, or the test reaches its limit.
pub fn output(command: &mut Command) -> Output {
    Process::start(command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped())).output()
}
