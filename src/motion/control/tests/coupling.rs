//! The virtual coupling of the impedance type.

use crate::control::*;

const PERIOD_S: f64 = 1e-3;

fn coupling(stiffness: f64, damping: f64, delay_cycles: f64) -> ServoLoop {
    ServoLoop { gains: Gains { stiffness, damping, integral: 0.0 }, period_s: PERIOD_S, delay_cycles }
}

/// 1 N/mm at 1 ms needs 0.5 N s/m, 1.5 with a cycle of delay.
#[test]
fn the_damping_that_a_spring_needs() {
    assert_eq!(damping_needed_n_s_per_m(1000.0, PERIOD_S, 0.0), 0.5);
    assert_eq!(damping_needed_n_s_per_m(1000.0, PERIOD_S, 1.0), 1.5);
}

/// A heavy device keeps `B T/m` small: there the rule of thumb is exact to some percent.
#[test]
fn the_rule_is_good_for_small_dampers() {
    for delay in [0.0, 1.0, 2.0] {
        for (virtual_damping, device) in [(0.0, 2.0), (1.0, 0.5), (2.0, 0.0)] {
            let exact = greatest_stiffness_n_per_m(&coupling(1.0, virtual_damping, delay), 5.0, device, 1.0).unwrap();
            let rule = (virtual_damping + device) / damping_needed_n_s_per_m(1.0, PERIOD_S, delay);
            let exact = exact.unwrap();
            assert!((exact / rule - 1.0).abs() < 0.02, "{exact} N/m, {rule} N/m by the rule, delay {delay}");
        }
    }
}

#[test]
fn the_greatest_are_stable_by_their_reserve_and_no_more() {
    let servo = coupling(1000.0, 3.0, 1.0);
    for reserve in [1.0, 2.0] {
        let stiffness = greatest_stiffness_n_per_m(&servo, 0.05, 0.5, reserve).unwrap().unwrap();
        assert!(is_stable(&coupling(0.999 * reserve * stiffness, 3.0, 1.0), 0.05, 0.5).unwrap());
        assert!(!is_stable(&coupling(1.001 * reserve * stiffness, 3.0, 1.0), 0.05, 0.5).unwrap());
        let damping = greatest_damping_n_s_per_m(&servo, 0.05, 0.5, reserve).unwrap().unwrap();
        assert!(is_stable(&coupling(1000.0, 0.999 * reserve * damping, 1.0), 0.05, 0.5).unwrap());
        assert!(!is_stable(&coupling(1000.0, 1.001 * reserve * damping, 1.0), 0.05, 0.5).unwrap());
    }
    // Without any damping no spring is stable on a device without friction.
    assert_eq!(greatest_stiffness_n_per_m(&coupling(1.0, 0.0, 0.0), 0.05, 0.0, 1.0).unwrap(), None);
    assert!(greatest_damping_n_s_per_m(&servo, 0.05, 0.5, f64::NAN).is_err());
}
