//! Faults that come of a computer that did not run, in words: before cable, node or arm are blamed.

use yieldwall_drives::profiles::Tried;

use crate::failure::Failure;
use yieldwall_config as config;
use yieldwall_motion::guard::Fault;
use yieldwall_record::Standstill;

/// Next step for a computer that does not run in time.
const NEXT: &str = "stop other programs, or measure this computer with `yieldwall latency`; then run again";

/// Names the standstill of this computer and its length.
pub(crate) fn stood(standstill: Standstill) -> String {
    let Standstill { lasted, ago } = standstill;
    let [lasted, ago] = [lasted, ago].map(|time| match time.as_secs_f64() {
        seconds if seconds < 1.0 => format!("{:.0} ms", 1e3 * seconds),
        seconds => format!("{seconds:.1} s"),
    });
    format!("this computer stood still for {lasted}, until {ago} before")
}

/// Explains why a fault may not point to cable, node or arm. Either this computer stood still before it, or a program that has to run
/// in time simulates the devices. Returns `None` if neither applies.
pub(crate) fn not_in_time(fault: Fault, standstill: Option<Standstill>, rig: &config::Rig) -> Option<String> {
    if !fault.may_follow_standstill() {
        return None;
    }
    let is_simulated =
        |drive: &config::Drive| drive.profile.get().is_some_and(|profile| profile.profile.tried == Tried::Simulation);
    match standstill {
        Some(standstill) => Some(stood(standstill)),
        // Overspeed means motion, and a late device moves nothing.
        None if fault != Fault::OverSpeed && rig.drives.iter().all(is_simulated) => {
            Some("the program that simulates the drives may not have run in time".to_owned())
        }
        None => None,
    }
}

/// Returns cause and next step, with `why` before the cause.
pub(crate) fn said_first(why: Option<String>, mut words: Vec<(&'static str, String)>) -> Vec<(&'static str, String)> {
    let Some(why) = why else { return words };
    for (key, text) in &mut words {
        *text = match *key {
            "cause" => format!("{why}; if not: {text}"),
            _ => format!("{NEXT}; if it stays: {text}"),
        };
    }
    words
}

/// Returns the failure as a consequence of a computer that did not run in time, which it names first.
pub(crate) fn after_standstill(mut failure: Failure, why: Option<String>) -> Failure {
    if let (Some(first), Some(why)) = (failure.report.diagnostics.first_mut(), why) {
        first.message = format!("{why}, and this may follow from it: {}", first.message);
        let help = first.help.take().map_or_else(String::new, |help| format!("; if it stays: {help}"));
        first.help = Some(format!("{NEXT}{help}"));
    }
    failure
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::failure::Exit;
    use yieldwall_config::{Source, load_rig};

    #[test]
    fn a_computer_that_stood_still_is_named_before_cable_and_node() {
        let rig = load_rig(Source::named("builtin:paper-admittance.yaml")).unwrap().value;
        let standstill = Standstill { lasted: Duration::from_millis(2100), ago: Duration::from_millis(300) };
        let why = not_in_time(Fault::HeartbeatLost, Some(standstill), &rig);
        assert_eq!(why.as_deref(), Some("this computer stood still for 2.1 s, until 300 ms before"));
        let words = vec![("cause", "a loose cable".to_owned()), ("next", "check the cable".to_owned())];
        let said = said_first(why.clone(), words.clone());
        assert_eq!(said[0].1, "this computer stood still for 2.1 s, until 300 ms before; if not: a loose cable");
        assert!(said[1].1.starts_with("stop other programs") && said[1].1.ends_with("; if it stays: check the cable"));
        let failure = after_standstill(Failure::new(Exit::SafetyStop, "heartbeat-lost", "check the cable"), why);
        let first = &failure.report.diagnostics[0];
        assert!(first.message.starts_with("this computer stood still for 2.1 s"), "{}", first.message);
        // A late computer cannot bring this about.
        assert_eq!(not_in_time(Fault::Intruder, Some(standstill), &rig), None);
        assert_eq!(said_first(None, words.clone()), words);
        // Simulated drives come from a program that has to run in time.
        assert!(not_in_time(Fault::PdoMissed, None, &rig).unwrap().contains("simulates the drives"));
    }
}
