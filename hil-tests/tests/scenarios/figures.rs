//! What the paper's figures show holds on the simulated machines, for the hand of the scenes and for hands 30 % softer,
//! stiffer, lighter and heavier.
//!
//! A failing run is repeated with `yieldwall reproduce FIGURE --hand-stiffness X --hand-mass Y`.

use yieldwall::guard::State;
use yieldwall::report::measures::Impact;
use yieldwall::study::reproduce::{FigureRun, HandScale, Mode, reproduce};

const HANDS: [HandScale; 5] = [
    HandScale::SAME,
    HandScale { stiffness: 0.7, mass: 1.0 },
    HandScale { stiffness: 1.3, mass: 1.0 },
    HandScale { stiffness: 1.0, mass: 0.7 },
    HandScale { stiffness: 1.0, mass: 1.3 },
];

/// Cycle time of the rigs in s.
const PERIOD_S: f64 = 1e-3;
/// Speed up to which an impact is always caught without a hold, `R T / M`, in m/s.
const CAPTURE_SPEED_M_PER_S: f64 = 20.0 * PERIOD_S / 2.0;

/// Runs a figure with every hand and checks each run; gives the runs back, hand by hand.
fn each(figure: &'static str, check: impl Fn(&FigureRun, &str)) -> Vec<Vec<FigureRun>> {
    let of_hand = |hand: HandScale| {
        let runs = reproduce(figure, hand, |_, _, _| {}).unwrap_or_else(|error| panic!("{figure}: {error:?}"));
        assert!(!runs.is_empty());
        for run in &runs {
            let replay = format!(
                "yieldwall reproduce {figure} --hand-stiffness {} --hand-mass {} ({}, N_wait {})",
                hand.stiffness, hand.mass, run.mode, run.hold_steps
            );
            assert!(run.report.state.is_none_or(|state| state == State::Running), "{replay}: {:?}", run.report.cause);
            common(run, &replay);
            check(run, &replay);
        }
        runs
    };
    HANDS.into_iter().map(of_hand).collect()
}

/// What holds in every run.
fn common(run: &FigureRun, replay: &str) {
    let measures = run.measures();
    assert!(!measures.impacts.is_empty(), "{replay}: no impact");
    assert_eq!(measures.unintended_releases, 0, "{replay}");
    if let Some(share) = measures.on_surface_fraction_when_pressed {
        assert_eq!(share, 1.0, "{replay}: pressed below R, the proxy left the surface");
    }
    if let Some(most) = measures.proxy_on_surface_max_mm {
        assert!(most <= 1e-9, "{replay}: {most} mm off the surface");
    }
    if run.mode == Mode::Impedance {
        assert!(measures.energy_rise_j <= measures.energy_bound_j, "{replay}: {} J", measures.energy_rise_j);
        assert_eq!(measures.penetration_mm, 0.0, "{replay}");
    } else {
        let (given, bound) = (measures.bounded_energy_j(), measures.energy_bound_j);
        assert!(given <= bound, "{replay}: given {given} J beyond what was held, bound {bound} J");
        if run.hold_steps >= 2 {
            assert!(measures.penetration_mm <= 1e-9, "{replay}: {} mm", measures.penetration_mm);
        } else {
            measures.impacts.iter().for_each(|impact| follows_the_law(impact, replay));
        }
        if let Some(tracing) = measures.tool_rms_tracing_mm {
            assert!(tracing <= 0.1, "{replay}: {tracing} mm");
        }
    }
}

/// An impact above twice the capture speed never stays on the surface, and the depth (none where one is caught) is what
/// the proxy's equation of motion gives for the least to the greatest force of the hand during the stop, to a quarter of the
/// way of one period at the capture speed (discretisation).
fn follows_the_law(impact: &Impact, replay: &str) {
    let speed = impact.speed_m_per_s;
    let [least, most] = impact.predicted_range_mm.unwrap_or_else(|| panic!("{replay}: no law at {} s", impact.time_s));
    if speed > 2.0 * CAPTURE_SPEED_M_PER_S {
        assert!(impact.depth_mm > 0.0, "{replay}: caught at {speed} m/s");
    }
    let slack = 0.25 * 1e3 * CAPTURE_SPEED_M_PER_S * PERIOD_S;
    let depth = impact.depth_mm;
    let holds = (least - slack..=most + slack).contains(&depth);
    assert!(holds, "{replay}: {depth} mm at {speed} m/s, by the law {least} to {most} mm");
}

#[test]
fn fig_8_bilateral_cylinder_impedance() {
    each("fig8", |_, _| {});
}

#[test]
fn fig_9_unilateral_cylinder_impedance() {
    each("fig9", |_, _| {});
}

#[test]
fn fig_11_bilateral_circle_admittance() {
    each("fig11", |run, replay| {
        assert!(run.measures().tool_rms_tracing_mm.is_some(), "{replay}: nothing was traced");
        assert!(run.measures().penetration_mm > 0.5, "{replay}: no impact went through");
    });
}

#[test]
fn fig_12_unilateral_circle_admittance() {
    each("fig12", |run, replay| {
        assert!(run.measures().tool_rms_tracing_mm.is_some(), "{replay}: nothing was traced");
    });
}

#[test]
fn fig_14_hold_impedance() {
    each("fig14", |_, _| {});
}

#[test]
fn fig_15_hold_admittance() {
    let hands = each("fig15", |run, replay| {
        let depth = run.measures().impacts[0].depth_mm;
        assert!(run.hold_steps > 0 || depth > 0.5, "{replay}: {depth} mm");
    });
    for runs in hands {
        for [free, held] in [Mode::Cst, Mode::Csp].map(|mode| [0, 5].map(|hold| force_n(&runs, mode, hold))) {
            assert!(held > free, "a hold makes a higher force at the impact: {held} N against {free} N");
        }
    }
}

fn force_n(runs: &[FigureRun], mode: Mode, hold_steps: u32) -> f64 {
    let run = runs.iter().find(|run| run.mode == mode && run.hold_steps == hold_steps).expect("run of the figure");
    run.measures().impacts[0].force_normal_max_n
}

#[test]
fn fig_16_hold_on_a_circle_admittance() {
    each("fig16", |_, _| {});
}
