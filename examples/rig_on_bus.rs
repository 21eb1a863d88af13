//! A rig on a bus: boots the drives and the force sensor on a CAN interface, runs the fixture for a while and stops.
//!
//! ```sh
//! cargo run --release -p yieldwall --no-default-features --features config,socketcan --example rig_on_bus -- RIG.yaml can0 10
//! ```
//!
//! **It moves real drives.** `yieldwall latency` and `yieldwall drill RIG.yaml --bus can0` come first: without their records the
//! rig is refused. To try it without drives, serve simulated ones with `yieldwall sim RIG.yaml --bus vcan0`.
//! There are CAN interfaces under Linux only.

#[cfg(target_os = "linux")]
mod on_linux {
    use std::error::Error;
    use std::path::PathBuf;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::SystemTime;

    use yieldwall::config::{Source, load_rig};
    use yieldwall::host::{Evidence, News, RigOnBus, Terms};
    use yieldwall::run::{Ended, Pace};
    use yieldwall::service::journal::Journals;

    /// Runs the rig of a file on an interface for a time in s.
    pub(super) fn run(arguments: &[String]) -> Result<(), Box<dyn Error>> {
        let [rig, interface, duration_s] = arguments else {
            return Err("name a rig, a CAN interface and a time in s, for example: rig.yaml can0 10".into());
        };
        let duration_s: f64 = duration_s.parse().map_err(|_| format!("`{duration_s}` is no time in s"))?;
        let rig = load_rig(Source::named(rig))?.value;
        let records = records().ok_or("neither XDG_STATE_HOME nor HOME says where the records are")?;
        let now_unix_s = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH)?.as_secs();
        // Takes the interface as its only master, and sends nothing yet. A rig on several buses has one interface for each.
        // Refuses an interface on which a bring-up was killed, until `yieldwall commission --restore` gives the devices back what they held.
        let journals = Journals { folder: Some(records.join("journals")), command: "run".into(), now_unix_s };
        let on_bus = RigOnBus::open(&rig, std::slice::from_ref(interface), Pace::Free, &journals)?;
        let terms = Terms {
            // What shows that the drives stop by themselves, and that this computer is in time.
            evidence: Evidence::OnRecord {
                drills: records.join("drills"),
                latency: records.join("latency"),
                now_unix_s,
            },
            needs_realtime: false,
            ignores_latency: false,
            ignores_bus_budget: false,
        };
        let is_interrupted = stop_on_enter();
        let mut greatest_n = 0.0_f64;
        // Boots, proves, enables, runs and stops, whatever happens. The closure gets every cycle on the thread of the cycle.
        let outcome = on_bus.run(
            &terms,
            duration_s,
            &is_interrupted,
            |record| greatest_n = greatest_n.max(record.signals.force.norm()),
            |news| match news {
                News::Refused(what) | News::Waiting(Some(what)) => println!("{what}"),
                News::Step(step) => println!("{step}"),
                _ => {}
            },
        )?;
        let played = outcome.played?;
        println!("{} cycles; the hand pushed with {greatest_n:.1} N at most", played.cycles);
        match played.ended {
            Ended::Whole | Ended::Interrupted => Ok(()),
            ended => {
                let why = played.cause.map_or("there was no fault", |cause| cause.fault.row().meaning);
                Err(format!("the rig ended as {ended:?}: {why}").into())
            }
        }
    }

    /// Where `yieldwall drill` and `yieldwall latency` keep what they found.
    fn records() -> Option<PathBuf> {
        let folder = |name| std::env::var_os(name).map(PathBuf::from);
        Some(folder("XDG_STATE_HOME").or_else(|| Some(folder("HOME")?.join(".local/state")))?.join("yieldwall"))
    }

    /// The Enter key ends the run with a controlled stop. Ctrl-C would kill the program, and leave the stop to the drives' watchdogs.
    fn stop_on_enter() -> Arc<AtomicBool> {
        let is_interrupted = Arc::new(AtomicBool::new(false));
        let asked = Arc::clone(&is_interrupted);
        std::thread::spawn(move || {
            // Nobody has pressed it where the input is at its end.
            if std::io::stdin().read_line(&mut String::new()).is_ok_and(|bytes| bytes > 0) {
                asked.store(true, Ordering::Relaxed);
            }
        });
        is_interrupted
    }

    #[test]
    fn without_the_interface_nothing_runs_and_the_message_says_why() {
        let arguments = ["builtin:paper-admittance.yaml", "can-none", "1"].map(str::to_owned);
        let refused = run(&arguments).unwrap_err().to_string();
        let is_clear = |said: &str| refused.contains(said);
        assert!(is_clear("there is no interface `can-none`") || is_clear("CAN sockets"), "{refused}");
    }
}

#[cfg(target_os = "linux")]
fn main() -> std::process::ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match on_linux::run(&arguments) {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            std::process::ExitCode::FAILURE
        }
    }
}

#[cfg(not(target_os = "linux"))]
fn main() -> std::process::ExitCode {
    eprintln!("error: there are CAN interfaces under Linux only");
    std::process::ExitCode::FAILURE
}
