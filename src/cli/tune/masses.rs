//! The virtual masses of a rig that are stable, for a person and for a program to read.

use serde_json::{Value, json};

use crate::analysis::{HeldMasses, Holding, UnevenSamples, hand_of, held_masses, stiffer, uneven_samples, usual_hands};
use crate::config::{Coupling, Diagnostic, Loaded, Rig, Severity};
use crate::control::Grip;
use crate::rig::RigError;

/// What to do where the loop is not known.
const UNKNOWN: &str = "least virtual mass: not known, since the velocity loop closes in the drives; try masses by `yieldwall run`, with \
                       the stiffest hand (`hand.stiffness_n_per_m` of the scene): it tells a rig that swings by its energy";
/// What the numbers leave out.
const LEFT_OUT: &str = "dry friction, torque limits and elastic joints are left out: try the numbers in a run";

/// What a bus adds where the sensor's clock is its own; the figures are those of `yieldwall study edge`.
const SYNC_WAITS: &str = "SYNC waits for frames that the sensor sends by its own clock, which is left out: at some of its phases the rig \
                          may need more mass, and without dry friction it may swing slowly at every mass";
const SAMPLE_MISSED: &str = "heartbeats that delay SYNC can decide whether a sample of the sensor's own clock is in time, which is left out: \
                             at some of its phases the rig may need more mass, 1.5 times the least in the worst of 60 drawn rigs";

/// How light a rig may be, by hands; the first is the scene's, if it has a spring.
pub(in crate::cli) struct Masses {
    name: String,
    configured_kg: f64,
    has_scene_hand: bool,
    uneven: Option<UnevenSamples>,
    /// `None` where the loop is not known.
    holdings: Option<Vec<Holding>>,
}

impl Masses {
    /// For the hand of the scene and for the usual ones, or those of `stiffnesses` in N/m.
    pub(in crate::cli) fn of(rig: &Loaded<Rig>, stiffnesses: &[f64]) -> Result<Self, RigError> {
        Self::with(rig, |hand| match stiffnesses {
            [] => usual_hands(hand).to_vec(),
            _ => stiffnesses.iter().map(|&stiffness| stiffer(hand, stiffness)).collect(),
        })
    }

    /// For the hand of the scene alone.
    pub(in crate::cli) fn of_scene(rig: &Loaded<Rig>) -> Result<Self, RigError> {
        Self::with(rig, |_| Vec::new())
    }

    /// For the hand of the scene and for others.
    fn with(rig: &Loaded<Rig>, others: impl Fn(&Grip) -> Vec<Grip>) -> Result<Self, RigError> {
        let scene = rig.scene().map_err(|_| RigError::Mismatch("the scene cannot be read".into()))?;
        let hand = hand_of(&scene.value);
        let others = others(&hand);
        let has_scene_hand = hand.stiffness_n_per_m > 0.0;
        let hands: Vec<Grip> = has_scene_hand.then_some(hand).into_iter().chain(others).collect();
        let configured_kg = match rig.value.fixture.coupling {
            Coupling::Admittance { mass_kg } => mass_kg.get(),
            Coupling::Impedance { .. } => return Err(RigError::Mismatch("a rig needs an admittance".into())),
        };
        let holdings = held_masses(&rig.value, &hands, configured_kg)?;
        Ok(Self {
            name: rig.value.rig.name.clone(),
            configured_kg,
            has_scene_hand,
            uneven: uneven_samples(&rig.value),
            holdings,
        })
    }

    /// One line for `config check`.
    pub(in crate::cli) fn line(&self) -> String {
        let Some(holdings) = &self.holdings else {
            return UNKNOWN.to_owned();
        };
        let masses: Vec<String> = holdings
            .iter()
            .enumerate()
            .map(|(index, holding)| {
                let whose = if index == 0 && self.has_scene_hand { " (the scene's hand)" } else { "" };
                format!("{} at {} N/m{whose}", range_words(holding.masses.as_ref()), holding.grip.stiffness_n_per_m)
            })
            .collect();
        format!("stable virtual masses by stiffness of the hand, worst pose: {}", masses.join(", "))
    }

    /// What to say of a rig whose mass its scene's hand does not allow.
    pub(in crate::cli) fn finding(&self, rig: &Loaded<Rig>) -> Option<Diagnostic> {
        let scenes = self.holdings.as_ref()?.first().filter(|_| self.has_scene_hand)?;
        if scenes.is_configured_stable {
            return None;
        }
        let (allowed, help) = match scenes.masses {
            Some(masses) if self.configured_kg > masses.greatest_kg => (
                format!("the greatest at {} is {:.3} kg", place_words(masses.greatest_at_m), masses.greatest_kg),
                "make it lighter, the loop faster or the low pass of the force weaker",
            ),
            Some(masses) => (
                format!("the least at {} is {:.3} kg", place_words(masses.least_at_m), masses.least_kg),
                "make it heavier, the loop faster or the low pass of the force weaker",
            ),
            None => ("none is stable with it".to_owned(), "make the loop faster or the low pass of the force weaker"),
        };
        let message = format!(
            "without friction a virtual mass of {} kg is unstable with the scene's hand ({}): {allowed}",
            self.configured_kg,
            grip_words(&scenes.grip)
        );
        let help = format!("{help}; `yieldwall tune fixture {}` tells the stable masses", rig.source);
        let see =
            [("control.gains", "the servo's gains"), ("sensor.low_pass_hz", "the low pass"), ("scene", "the hand")];
        Some(rig.finding(Severity::Warning, "fixture.coupling.admittance.mass_kg", message, help, &see))
    }

    /// What the bus adds to the numbers.
    fn bus_words(&self) -> Option<&'static str> {
        self.holdings.as_ref()?;
        self.uneven.map(|uneven| match uneven {
            UnevenSamples::SyncWaits => SYNC_WAITS,
            UnevenSamples::SampleMissed => SAMPLE_MISSED,
        })
    }

    /// A table for a person to read.
    pub(in crate::cli) fn text(&self, reserve: f64) -> String {
        let Some(holdings) = &self.holdings else { return self.line() + "\n" };
        let mut text = format!(
            "{}: virtual mass, {} kg configured, at the worst pose along its surface\n  {:34}{:>24}{:>24}  {:12}least at\n",
            self.name,
            self.configured_kg,
            "hand",
            "stable",
            format!("reserve of {reserve}"),
            format!("{} kg", self.configured_kg),
        );
        for (index, holding) in holdings.iter().enumerate() {
            let whose = if index == 0 && self.has_scene_hand { ", scene" } else { "" };
            let reserved = holding.masses.as_ref().and_then(|masses| with_reserve(masses, reserve));
            text += &format!(
                "  {:34}{:>24}{:>24}  {:12}{}\n",
                format!("{}{whose}", grip_words(&holding.grip)),
                range_words(holding.masses.as_ref()),
                range_words(reserved.as_ref()),
                if holding.is_configured_stable { "stable" } else { "UNSTABLE" },
                holding.masses.map_or_else(String::new, |masses| place_words(masses.least_at_m)),
            );
        }
        for holding in holdings {
            text += &why(holding);
        }
        let passive_kg = holdings.iter().map(|holding| holding.passive_kg).fold(0.0, f64::max);
        text += &format!("  no mass below {passive_kg:.1} kg, the arm's own, is passive for every hand\n");
        for words in self.bus_words().into_iter().chain([LEFT_OUT]) {
            text += &format!("  {words}\n");
        }
        text
    }

    /// For a program to read. A mass that does not exist is `null`, and so is a greatest one where none drifts.
    pub(in crate::cli) fn to_json(&self, reserve: f64) -> Value {
        let hands = self.holdings.as_ref().map(|holdings| {
            let each = holdings.iter().enumerate().map(|(index, holding)| {
                let reserved = holding.masses.as_ref().and_then(|masses| with_reserve(masses, reserve));
                json!({
                    "is_of_scene": index == 0 && self.has_scene_hand,
                    "stiffness_n_per_m": holding.grip.stiffness_n_per_m,
                    "damping_n_s_per_m": holding.grip.damping_n_s_per_m,
                    "mass_kg": holding.grip.mass_kg,
                    "is_any_stable": holding.masses.is_some(),
                    "is_configured_stable": holding.is_configured_stable,
                    "least_virtual_mass_kg": holding.masses.map(|masses| masses.least_kg),
                    "greatest_virtual_mass_kg": holding.masses.map(|masses| masses.greatest_kg),
                    "virtual_mass_with_reserve_kg": reserved.map(|masses| masses.least_kg),
                    "greatest_virtual_mass_with_reserve_kg": reserved.map(|masses| masses.greatest_kg),
                    "worst_tool_m": holding.masses.map(|masses| masses.least_at_m),
                    "worst_tool_for_greatest_m": holding.masses.map(|masses| masses.greatest_at_m),
                    // Below zero the tool is ahead of a mass by a part of a cycle.
                    "lag_s": holding.lag_s.max(0.0),
                    "passive_mass_kg": holding.passive_kg,
                })
            });
            each.collect::<Vec<_>>()
        });
        let note = if hands.is_none() { Some(UNKNOWN) } else { self.bus_words() };
        json!({ "configured_kg": self.configured_kg, "reserve": reserve, "hands": hands, "note": note })
    }
}

fn grip_words(grip: &Grip) -> String {
    format!("{} N/m, {:.1} N s/m, {} kg", grip.stiffness_n_per_m, grip.damping_n_s_per_m, grip.mass_kg)
}

/// A range in words.
fn range_words(masses: Option<&HeldMasses>) -> String {
    let three = |mass_kg: f64| if mass_kg < 10.0 { format!("{mass_kg:.3}") } else { format!("{mass_kg:.0}") };
    match masses {
        None => "none".to_owned(),
        Some(HeldMasses { least_kg, greatest_kg, .. }) if greatest_kg.is_finite() => {
            format!("{} to {} kg", three(*least_kg), three(*greatest_kg))
        }
        Some(HeldMasses { least_kg, .. }) => format!("from {} kg", three(*least_kg)),
    }
}

/// What is left of a range when both ends keep a factor of `reserve` away from the edge.
fn with_reserve(masses: &HeldMasses, reserve: f64) -> Option<HeldMasses> {
    let [least_kg, greatest_kg] = [masses.least_kg * reserve, masses.greatest_kg / reserve];
    (least_kg <= greatest_kg).then_some(HeldMasses { least_kg, greatest_kg, ..*masses })
}

/// Why a range of masses ends, or why there is none, as a line; nothing of a range without an upper end.
fn why(holding: &Holding) -> String {
    let Holding { grip, masses, lag_s, .. } = holding;
    let [lag_ms, allowed_ms] = [*lag_s, grip.damping_n_s_per_m / grip.stiffness_n_per_m].map(|time| 1e3 * time);
    let lags =
        format!("the loop lags by {lag_ms:.1} ms in slow motion, the hand's damping makes up for {allowed_ms:.1} ms");
    let stiffness = grip.stiffness_n_per_m;
    match masses {
        Some(masses) if masses.greatest_kg.is_finite() => {
            format!("  heavier ones drift at {stiffness} N/m: {lags}\n")
        }
        Some(_) => String::new(),
        None if lag_ms > allowed_ms => format!("  none at {stiffness} N/m: {lags}\n"),
        None => format!("  none at {stiffness} N/m: the servo with this hand is unstable by itself, or nearly\n"),
    }
}

fn place_words(tool_m: [f64; 2]) -> String {
    // A zero without its sign.
    let [x, y] = tool_m.map(|value| 1e-3 * (1e3 * value).round() + 0.0);
    format!("({x:.3}, {y:.3}) m")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Source, builtin, load_rig};

    fn rig(changes: &[(&str, &str)]) -> Loaded<Rig> {
        let source = builtin("paper-admittance.yaml");
        let mut text = source.read().unwrap().to_string();
        for (from, to) in changes {
            assert!(text.contains(from), "{from}");
            text = text.replace(from, to);
        }
        let scene = builtin("scenes/circle-tour.yaml").read().unwrap();
        load_rig(Source::among(
            "rig.yaml",
            [("rig.yaml".into(), text.into()), ("scenes/circle-tour.yaml".into(), scene)],
        ))
        .unwrap()
    }

    #[test]
    fn the_shipped_rigs_are_heavy_enough_and_light_ones_are_told() {
        for name in ["paper-admittance.yaml", "paper-admittance-csp.yaml", "paper-admittance-cartesian.yaml"] {
            let shipped = load_rig(builtin(name)).unwrap();
            let masses = Masses::of(&shipped, &[]).unwrap();
            assert!(masses.finding(&shipped).is_none(), "{name}: {}", masses.line());
            assert_eq!(masses.holdings.as_ref().unwrap().len(), 4);
        }
        let light = rig(&[("mass_kg: 2.0}", "mass_kg: 0.02}")]);
        let finding = Masses::of(&light, &[]).unwrap().finding(&light).unwrap();
        assert_eq!(
            (finding.key.as_str(), finding.severity),
            ("fixture.coupling.admittance.mass_kg", Severity::Warning)
        );
        assert!(finding.place.is_some(), "{finding:?}");
        let slow = rig(&[("low_pass_hz: null ", "low_pass_hz: 3.0 ")]);
        let slow_masses = Masses::of(&slow, &[]).unwrap();
        let message = slow_masses.finding(&slow).unwrap().message;
        assert!(message.contains("none") || message.contains("the greatest"), "{message}");
        assert!(slow_masses.text(2.0).contains("the loop lags by 5"), "{}", slow_masses.text(2.0));
    }

    #[test]
    fn a_braced_hand_needs_more_mass_and_the_reserve_is_a_factor() {
        let shipped = rig(&[]);
        let masses = Masses::of(&shipped, &[500.0, 3000.0]).unwrap();
        let [_, soft, braced] = masses.holdings.as_deref().unwrap() else { panic!("{}", masses.line()) };
        assert!(braced.masses.unwrap().least_kg > soft.masses.unwrap().least_kg, "{soft:?} {braced:?}");
        let json = masses.to_json(3.0);
        let [least, with] = ["least_virtual_mass_kg", "virtual_mass_with_reserve_kg"]
            .map(|key| json["hands"][1][key].as_f64().unwrap());
        assert!((with / least - 3.0).abs() < 1e-12);
        assert!(masses.text(3.0).contains("(0."), "{}", masses.text(3.0));
    }

    fn least_kg(rig: &Loaded<Rig>) -> f64 {
        Masses::of(rig, &[500.0]).unwrap().holdings.unwrap()[0].masses.unwrap().least_kg
    }

    #[test]
    fn position_mode_uses_nothing_of_the_control() {
        let mut other = load_rig(builtin("paper-admittance-csp.yaml")).unwrap();
        let before = least_kg(&other);
        assert!((before / 0.179 - 1.0).abs() < 0.01, "{before}");
        other.value.control.feed_forward.inertia = None;
        assert_eq!(least_kg(&other), before);
    }

    #[test]
    fn a_sensor_with_its_own_clock_asks_for_more_than_one_that_sync_clocks() {
        for (name, exact_kg) in [("paper-admittance-2ms.yaml", 0.477), ("paper-admittance-5ms.yaml", 1.19)] {
            let found = least_kg(&load_rig(builtin(name)).unwrap());
            assert!((0.98..1.15).contains(&(found / exact_kg)), "{name}: {found}");
        }
    }

    #[test]
    fn every_corner_of_a_polygon_counts_whichever_comes_first() {
        let circle = "circle: {center_m: [0.0, 0.0], radius_m: 0.12, forbidden: inside}";
        let [first, second] = [
            "[[0.14, 0.0], [0.0, 0.14], [-0.14, 0.0], [0.0, -0.14]]",
            "[[0.0, -0.14], [0.14, 0.0], [0.0, 0.14], [-0.14, 0.0]]",
        ]
        .map(|points| least_kg(&rig(&[(circle, &format!("polygon: {{points_m: {points}, forbidden: inside}}"))])));
        assert!((first / second - 1.0).abs() < 0.003, "{first} {second}");
    }

    #[test]
    fn a_further_surface_counts_whichever_comes_first() {
        let circle = "surface:\n    circle: {center_m: [0.0, 0.0], radius_m: 0.12, forbidden: inside}";
        let near = "circle: {center_m: [0.0, 0.0], radius_m: 0.03, forbidden: inside}";
        let far = "circle: {center_m: [0.0, 0.0], radius_m: 0.14, forbidden: inside}";
        let least = |text: String| least_kg(&rig(&[(circle, &text)]));
        let alone = [near, far].map(|one| least(format!("surface: {{{one}}}")));
        assert!(alone[1] > 1.02 * alone[0], "{alone:?}");
        for [first, second] in [[near, far], [far, near]] {
            let both = least(format!("surface: {{{first}}}\n  also: [{{{second}}}]"));
            assert!((both / alone[1] - 1.0).abs() < 0.01, "{both} {alone:?}");
        }
    }

    #[test]
    fn a_stiff_hand_has_stable_masses_and_a_greatest_one() {
        for (name, [least, greatest]) in
            [("paper-admittance.yaml", [0.603, 56.3]), ("paper-admittance-csp.yaml", [0.187, 94.6])]
        {
            let stiff = Masses::of(&load_rig(builtin(name)).unwrap(), &[8000.0]).unwrap().holdings.unwrap()[1];
            let masses = stiff.masses.unwrap();
            assert!(stiff.is_configured_stable, "{name}: 2 kg");
            assert!((masses.least_kg / least - 1.0).abs() < 0.01, "{name}: {masses:?}");
            assert!((masses.greatest_kg / greatest - 1.0).abs() < 0.02, "{name}: {masses:?}");
        }
    }

    #[test]
    fn where_the_loop_is_not_known_the_next_step_is_named() {
        let velocity = load_rig(builtin("paper-admittance-csv.yaml")).unwrap();
        let masses = Masses::of(&velocity, &[]).unwrap();
        assert!(masses.line().contains("`yieldwall run`"), "{}", masses.line());
        assert_eq!(masses.to_json(2.0)["note"], masses.line());
        assert!(Masses::of(&rig(&[]), &[]).unwrap().to_json(2.0)["note"].is_null());
    }

    #[test]
    fn what_a_bus_adds_is_told_of_sensors_with_a_clock_of_their_own() {
        for (name, words) in [
            ("paper-admittance.yaml", None),
            ("paper-admittance-streaming.yaml", Some("SYNC waits")),
            ("paper-admittance-polled.yaml", Some("in time")),
        ] {
            let masses = Masses::of(&load_rig(builtin(name)).unwrap(), &[]).unwrap();
            let note = masses.to_json(2.0)["note"].as_str().map(str::to_owned);
            assert_eq!(note.is_some(), words.is_some(), "{name}: {note:?}");
            if let (Some(note), Some(words)) = (note, words) {
                assert!(note.contains(words) && masses.text(2.0).contains(&note), "{name}: {note}");
            }
        }
    }

    #[test]
    fn a_zero_has_no_sign() {
        assert_eq!(place_words([-2e-17, -0.0004]), "(0.000, 0.000) m");
        assert_eq!(place_words([-0.12, 0.0125]), "(-0.120, 0.013) m");
    }

    #[test]
    fn a_lag_is_never_negative() {
        let json = Masses::of(&rig(&[]), &[]).unwrap().to_json(2.0);
        let lags = json["hands"].as_array().unwrap().iter().map(|hand| hand["lag_s"].as_f64().unwrap());
        assert!(lags.clone().all(|lag_s| lag_s >= 0.0 && lag_s.is_sign_positive()), "{json}");
    }
}
