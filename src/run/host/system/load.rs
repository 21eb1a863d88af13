//! Work for a computer that is to show what it keeps when it is busy.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};

/// Bytes that each thread of arithmetic reads and writes, more than a processor's caches hold for one.
const MEMORY: usize = 16 << 20;
/// Bytes that are written to the disk at a time, again and again from the begin of the file.
const WRITTEN: usize = 4 << 20;
/// Steps of arithmetic between two looks at the wish to end: well under a millisecond.
const STEPS: usize = 4096;

/// Threads of ordinary priority that keep processors, memory and disk busy until this is dropped. They belong to this process:
/// nothing of them outlives it, however it ends.
#[derive(Debug)]
pub struct Load {
    is_over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
    processors: usize,
    has_disk: bool,
}

impl Load {
    /// Starts one thread for each processor, and one that writes to a file in `folder`. The file has no name any more when the
    /// first byte is written. If there can be no such file, the disk is left alone, and [`Load::told`] mentions it.
    ///
    /// # Errors
    /// If the system refuses a thread; none is left then.
    pub fn start(folder: &Path) -> io::Result<Self> {
        let processors = thread::available_parallelism().map_or(1, usize::from);
        let mut load = Self { is_over: Arc::default(), threads: Vec::new(), processors, has_disk: false };
        for number in 0..processors {
            load.spawn(format!("load {number}"), compute)?;
        }
        if let Ok(file) = nameless(folder) {
            load.spawn("load disk".to_owned(), move |is_over| write(file, is_over))?;
            load.has_disk = true;
        }
        Ok(load)
    }

    fn spawn(&mut self, name: String, work: impl FnOnce(&AtomicBool) + Send + 'static) -> io::Result<()> {
        let is_over = Arc::clone(&self.is_over);
        self.threads.push(thread::Builder::new().name(name).spawn(move || work(&is_over))?);
        Ok(())
    }

    /// Returns a description of the load, for a person and for the record.
    pub fn told(&self) -> String {
        let Self { processors, has_disk, .. } = self;
        let disk = if *has_disk { "one thread that writes to the disk" } else { "no thread that writes to the disk" };
        let mebibytes = MEMORY >> 20;
        format!("{processors} threads of arithmetic ({mebibytes} MiB each), {disk}")
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // One that has panicked is over too.
            let _ = thread.join();
        }
    }
}

/// Goes through memory with arithmetic that nothing can leave out.
fn compute(is_over: &AtomicBool) {
    let mut memory = vec![1_u64; MEMORY / 8];
    let mut state = 1_u64;
    while !is_over.load(Ordering::Relaxed) {
        for _ in 0..STEPS {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let place = (state >> 33) as usize % memory.len();
            memory[place] = memory[place].wrapping_add(state);
        }
        std::hint::black_box(&memory);
    }
}

/// Writes and waits for the disk; ends when it refuses, as a full one does.
fn write(mut file: File, is_over: &AtomicBool) {
    use std::io::Seek;
    let data = vec![0x5a; WRITTEN];
    while !is_over.load(Ordering::Relaxed) {
        let written = file.rewind().and_then(|()| file.write_all(&data)).and_then(|()| file.sync_data());
        if written.is_err() {
            return;
        }
    }
}

/// Creates a file that is gone when it is closed.
fn nameless(folder: &Path) -> io::Result<File> {
    let path = folder.join(format!("load-{}.unfinished", std::process::id()));
    let file = File::options().write(true).create_new(true).open(&path)?;
    fs::remove_file(&path)?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_left_of_it() {
        let folder = std::env::temp_dir().join(format!("yieldwall-load-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let load = Load::start(&folder).unwrap();
        let (is_over, threads) = (Arc::clone(&load.is_over), load.threads.len());
        assert_eq!(threads, load.processors + 1);
        assert!(load.told().contains("one thread that writes to the disk"), "{}", load.told());
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
        drop(load);
        // No thread holds it any more.
        assert_eq!(Arc::strong_count(&is_over), 1);
        fs::remove_dir(&folder).unwrap();
    }

    #[test]
    fn without_a_place_the_disk_is_left_alone_and_that_is_said() {
        let load = Load::start(Path::new("/nonexistent")).unwrap();
        assert_eq!(load.threads.len(), load.processors);
        assert!(load.told().contains("no thread that writes to the disk"));
    }
}
