//! Many independent computations, each addressed by a number. They run on several threads and are stored on disk as they finish, so
//! that an interrupted batch resumes.

mod lines;
mod shard;

pub use lines::{Lines, LinesError};
pub use shard::Shard;

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread;

/// Works on all `numbers`, each on the next of `jobs` threads that is free, and calls `finished` on this thread with every
/// result, in the order in which they come. Once `is_stopped` is set nothing else begins; what is running comes to its end, and
/// `finished` is called with it too.
///
/// # Errors
/// The first error of `finished`; what is running then comes to its end, nothing else begins.
pub fn run<T: Send, E>(
    numbers: &[u64],
    jobs: usize,
    is_stopped: &AtomicBool,
    work: impl Fn(u64) -> T + Sync,
    mut finished: impl FnMut(u64, T) -> Result<(), E>,
) -> Result<(), E> {
    let next = AtomicUsize::new(0);
    let is_over = AtomicBool::new(false);
    let (results, inbox) = mpsc::channel();
    thread::scope(|scope| {
        for _ in 0..jobs.max(1).min(numbers.len()) {
            let results = results.clone();
            let (next, is_over, work) = (&next, &is_over, &work);
            scope.spawn(move || {
                while !is_over.load(Ordering::Relaxed)
                    && !is_stopped.load(Ordering::Relaxed)
                    && let Some(&number) = numbers.get(next.fetch_add(1, Ordering::Relaxed))
                {
                    if results.send((number, work(number))).is_err() {
                        return;
                    }
                }
            });
        }
        drop(results);
        for (number, result) in inbox {
            finished(number, result).inspect_err(|_| is_over.store(true, Ordering::Relaxed))?;
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_is_worked_on_once() {
        let numbers: Vec<u64> = (0..100).map(|number| 3 * number).collect();
        let mut seen = vec![];
        let all = run(
            &numbers,
            4,
            &AtomicBool::new(false),
            |number| number + 1,
            |number, result| {
                assert_eq!(result, number + 1);
                seen.push(number);
                Ok::<(), ()>(())
            },
        );
        assert_eq!(all, Ok(()));
        seen.sort_unstable();
        assert_eq!(seen, numbers);
    }

    #[test]
    fn an_error_ends_the_work() {
        let numbers: Vec<u64> = (0..1000).collect();
        let begun = AtomicUsize::new(0);
        let work = |number| {
            begun.fetch_add(1, Ordering::Relaxed);
            std::thread::sleep(std::time::Duration::from_millis(1));
            number
        };
        let finished = |number, _| if number == 0 { Err("full") } else { Ok(()) };
        assert_eq!(run(&numbers, 2, &AtomicBool::new(false), work, finished), Err("full"));
        assert!(begun.load(Ordering::Relaxed) < 500);
    }

    #[test]
    fn all_that_had_begun_when_the_work_was_stopped_is_handed_over() {
        let numbers: Vec<u64> = (0..1000).collect();
        let (begun, is_stopped) = (AtomicUsize::new(0), AtomicBool::new(false));
        let work = |number| {
            begun.fetch_add(1, Ordering::Relaxed);
            is_stopped.fetch_or(number == 20, Ordering::Relaxed);
            number
        };
        let mut seen = vec![];
        let all = run(&numbers, 3, &is_stopped, work, |number, _| {
            seen.push(number);
            Ok::<(), ()>(())
        });
        assert_eq!(all, Ok(()));
        assert_eq!(seen.len(), begun.load(Ordering::Relaxed));
        assert!(seen.contains(&20) && seen.len() < 1000);
        assert_eq!(run(&numbers, 3, &is_stopped, |_| (), |_, ()| Err("begun")), Ok(()));
    }
}
