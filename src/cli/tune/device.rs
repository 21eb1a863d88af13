//! Limits of the virtual coupling of an impedance device, as text and as data.

use serde_json::{Value, json};

use yieldwall_config::{Coupling, Diagnostic, ImpedanceDevice, Loaded, Severity};
use yieldwall_rig::analysis::Coupled;

/// Rounds a number to four significant digits.
fn four_digits(value: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value)
}

/// Returns the limits of a device's coupling as text.
pub(crate) fn coupled_lines(device: &ImpedanceDevice, coupled: &Coupled, reserve: f64) -> Vec<String> {
    let Coupling::Impedance { stiffness_n_per_m, damping_n_s_per_m } = device.fixture.coupling else { return vec![] };
    let own = device.plant.damping_n_s_per_m.get();
    let bound = |value: Option<f64>| value.map_or("none".to_owned(), |value| four_digits(value).to_string());
    let (stiffness, damping) = (*stiffness_n_per_m, damping_n_s_per_m.get());
    vec![
        format!("coupling  {} with the hand off", if coupled.is_stable { "stable" } else { "UNSTABLE" }),
        format!(
            "stiffness K = {stiffness} N/m (limit {} N/m with this B, reserve {reserve})",
            bound(coupled.greatest_stiffness_n_per_m)
        ),
        format!(
            "damping   B = {damping} N s/m (limit {} N s/m with this K, reserve {reserve})",
            bound(coupled.greatest_damping_n_s_per_m)
        ),
        format!(
            "          device and B: {:.3} N s/m (this K needs about {:.3} N s/m)",
            own + damping,
            coupled.damping_needed_n_s_per_m
        ),
    ]
}

/// Returns the limits of a device's coupling as data.
pub(crate) fn coupled_json(coupled: &Coupled, reserve: f64) -> Value {
    json!({
        "reserve": reserve,
        "stable": coupled.is_stable,
        "damping_needed_n_s_per_m": coupled.damping_needed_n_s_per_m,
        "greatest_stiffness_n_per_m": coupled.greatest_stiffness_n_per_m,
        "greatest_damping_n_s_per_m": coupled.greatest_damping_n_s_per_m,
    })
}

/// Returns the finding on a device whose coupling is unstable.
pub(crate) fn coupled_finding(device: &Loaded<ImpedanceDevice>, coupled: &Coupled) -> Option<Diagnostic> {
    if coupled.is_stable {
        return None;
    }
    let message = "spring and damper of the virtual coupling are unstable on the free device".to_owned();
    let help = format!(
        "a spring needs a damping of K T/2 at least, while B T/m stays small; `yieldwall tune fixture {}` computes both",
        device.source
    );
    let see = [("cycle.period_us", "the period"), ("plant.damping_n_s_per_m", "the device's own damping")];
    Some(device.finding(Severity::Warning, "fixture.coupling.impedance", message, help, &see))
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_config::{builtin, load_device};
    use yieldwall_rig::analysis::coupled_device;

    #[test]
    fn bounds_are_told_to_four_digits() {
        let device = load_device(builtin("paper-impedance.yaml")).unwrap();
        let coupled = coupled_device(&device.value, 2.0).unwrap().unwrap();
        let coupled = Coupled { greatest_stiffness_n_per_m: Some(1944.4191), ..coupled };
        let lines = coupled_lines(&device.value, &coupled, 2.0);
        assert!(lines[1].contains("limit 1944 N/m with this B"), "{lines:?}");
        assert_eq!(four_digits(0.000_123_456), 0.000_123_5);
    }

    #[test]
    fn a_device_is_told_what_its_coupling_bears() {
        let device = load_device(builtin("paper-impedance.yaml")).unwrap();
        let coupled = coupled_device(&device.value, 2.0).unwrap().unwrap();
        assert!(coupled_finding(&device, &coupled).is_none());
        // (0.5 + 1.5) N s/m over 0.5 ms by the rule; the exact loop has B T/m = 0.03.
        let greatest = coupled.greatest_stiffness_n_per_m.unwrap();
        assert!((greatest / 2000.0 - 1.0).abs() < 0.05, "{greatest}");
        let unstable = Coupled { is_stable: false, ..coupled };
        assert!(coupled_finding(&device, &unstable).unwrap().place.is_some());
    }
}
