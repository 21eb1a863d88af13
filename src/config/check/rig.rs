//! Relations between the keys of a rig.

use super::Findings;
use super::axes::check_axes;
use super::bus::{check_heartbeats, check_nodes};
use super::fixture::{Host, check_capture_beside_guard, check_fixture, check_passivity_beside_guard};
use super::guards::{check_guards, check_handle};
use super::limits::{check_control, check_drive_limits, check_guard};
use super::machine::check_machine;
use super::models::check_profiles;
use super::reach::check_linkage;
use super::segment::check_segment;
use super::sensor::check_sensor;
use crate::tree::Rig;

/// All rules of a rig. `in_range` says that every single number is in its range, so that derived ones make sense.
pub(crate) fn check_rig(findings: &mut Findings, rig: &Rig, in_range: bool) {
    check_cycle(findings, rig);
    check_nodes(findings, rig);
    check_segment(findings, rig);
    check_axes(findings, rig);
    check_heartbeats(findings, rig);
    check_profiles(findings, rig);
    check_sensor(findings, rig);
    check_control(findings, rig);
    check_guard(findings, rig);
    let period_s = if in_range { f64::from(rig.cycle.period_us) * 1e-6 } else { 0.0 };
    check_fixture(findings, "fixture", &rig.fixture, Host::Rig, period_s);
    check_passivity_beside_guard(findings, "fixture", &rig.fixture, &rig.guard);
    if in_range {
        check_capture_beside_guard(findings, "fixture", &rig.fixture, &rig.guard, period_s);
        check_drive_limits(findings, rig);
        check_linkage(findings, rig);
        check_guards(findings, rig);
        check_handle(findings, rig);
        check_machine(findings, rig);
    }
}

fn check_cycle(findings: &mut Findings, rig: &Rig) {
    let (period, compute) = (rig.cycle.period_us, rig.cycle.compute_at_us);
    if compute >= period {
        findings
            .error(
                "cycle.compute_at_us",
                format!(
                    "`cycle.compute_at_us` is {compute} us, not below `cycle.period_us` of {period} us: the control step \
                     would run after the next SYNC"
                ),
                "leave time for the TPDOs before it and for the RPDOs after it. A CAN bus of 1 Mbit/s with two drives and a sensor \
                 needs about 1000 us, and `yieldwall bus budget` shows the range",
            )
            .see("cycle.period_us", "period_us");
    }
    check_interpolation_time(findings, period);
    let Ok(simulation) = rig.simulated() else { return };
    let inner = simulation.drive_position_loop.period_us;
    if inner == 0 || !period.is_multiple_of(inner) {
        findings
            .error(
                "simulation.drive_position_loop.period_us",
                format!(
                    "`simulation.drive_position_loop.period_us` is {inner} us, and `cycle.period_us` of {period} us is not a \
                     whole multiple of it"
                ),
                "drives close their position loop a whole number of times a cycle, such as every 125 of 1000 us",
            )
            .see("cycle.period_us", "period_us");
    }
}

/// Checks that the drives can represent the period: 60C2h holds one byte and a power of ten of a second.
fn check_interpolation_time(findings: &mut Findings, period_us: u32) {
    let mut value = period_us;
    while value > 0 && value.is_multiple_of(10) {
        value /= 10;
    }
    if value > u32::from(u8::MAX) {
        findings.error(
            "cycle.period_us",
            format!("`cycle.period_us` is {period_us} us; drives accept only 1 to 255 times a power of ten"),
            "write a rounder period, such as 500, 1000 or 1250",
        );
    }
}

#[cfg(test)]
mod tests {
    use crate::load_rig;
    use crate::malformed;

    #[test]
    fn a_period_that_the_drives_cannot_be_told_is_refused() {
        // 1125 us is a multiple of the drives' 125 us, and its low byte would be another period.
        for (period, is_refused) in [("1125", true), ("1250", false)] {
            let text = malformed::base_text("rig.yaml").replace("period_us: 1000", &format!("period_us: {period}"));
            let report = load_rig(malformed::with("rig.yaml", "rig.yaml", &text)).err();
            let is_it = |report: &crate::Report| {
                report.diagnostics.iter().any(|finding| finding.message.contains("1 to 255 times"))
            };
            assert_eq!(report.as_ref().is_some_and(is_it), is_refused, "{period}: {report:?}");
        }
    }
}
