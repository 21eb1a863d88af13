//! Times for which the boot waits for devices.

use garde::Validate;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Times for which the boot of the network waits for one device, ms. A key that is left out takes the value of the device's
/// profile; for a force sensor on plain CAN it is 5000 ms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(default, deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Waits {
    /// Time from the reset to the boot-up message, ms. 1 to 60 000.
    #[garde(range(min = 1, max = 60_000))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub boot_up_ms: Option<u32>,
    /// Time for the answer to one SDO request, ms. 1 to 60 000.
    #[garde(range(min = 1, max = 60_000))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sdo_ms: Option<u32>,
    /// Time from the start command to the first heartbeat in Operational, or to the first sample of a force sensor on plain CAN,
    /// ms. 1 to 60 000.
    #[garde(range(min = 1, max = 60_000))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start_ms: Option<u32>,
}

/// Value of `enabling_ms` if a drive has none.
pub(super) fn enabling_ms() -> u32 {
    5000
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{load_rig, malformed};

    fn with(waits: &str) -> Result<crate::Rig, crate::Report> {
        let text =
            malformed::base_text("rig.yaml").replacen("  - name: left\n", &format!("  - name: left\n{waits}"), 1);
        load_rig(malformed::with("rig.yaml", "rig.yaml", &text)).map(|rig| rig.value)
    }

    #[test]
    fn a_device_is_waited_for_the_usual_times_unless_its_entry_says_otherwise() {
        let usual = with("").unwrap();
        let [left, right] = &usual.drives;
        assert_eq!((left.waits, left.enabling_ms), (Waits::default(), 5000));
        assert_eq!((right.waits, usual.sensor.waits), (left.waits, left.waits));
        let [left, right] = &with("    waits: {boot_up_ms: 9000}\n    enabling_ms: 700\n").unwrap().drives;
        assert_eq!((left.waits, left.enabling_ms), (Waits { boot_up_ms: Some(9000), ..Waits::default() }, 700));
        assert_eq!((right.waits, right.enabling_ms), (Waits::default(), 5000));
    }

    #[test]
    fn a_wait_that_does_not_end_soon_or_is_not_known_is_refused() {
        for (waits, told) in [
            ("    waits: {sdo_ms: 0}\n", "`drives[0].waits.sdo_ms` is `0`, lower than 1"),
            ("    waits: {boot_up_ms: 60001}\n", "greater than 60000"),
            ("    enabling_ms: 0\n", "`drives[0].enabling_ms` is `0`"),
            ("    waits: {bootup_ms: 5}\n", "has no key `bootup_ms`"),
        ] {
            let report = with(waits).unwrap_err();
            assert!(report.diagnostics[0].message.contains(told), "{waits}: {report}");
            assert!(report.diagnostics[0].place.is_some(), "{waits}");
        }
    }
}
