//! The virtual masses of a rig that are stable, for a person and for a program to read.

mod measured;

use serde_json::{Value, json};

use self::measured::Measured;
use crate::bus::{Plan, plans};
use crate::fit;
use yieldwall_config::{Coupling, Diagnostic, Loaded, Rig, Scene, Severity};
use yieldwall_motion::control::Grip;
use yieldwall_rig::RigError;
use yieldwall_rig::analysis::{
    DriveLimits, HeldMasses, Holding, Remedy, UnevenSamples, drive_limits, hand_of, held_masses,
    held_masses_identified, remedies, stiffer, uneven_samples, unmodelled, usual_hands,
};
use yieldwall_rig::report::{Overrides, replay};
use yieldwall_run::{ForceFound, JointFound};

/// Remedy if the loop closes in the drives, of which nothing was identified.
const UNKNOWN: &str = "least virtual mass: not measurable, since the loop closes in the drives; `yieldwall tune fixture` computes it for the \
                       simulated drives";
/// Effects that the numbers leave out.
const LEFT_OUT: &str = "not in the model: dry friction, torque limits, encoder counts; test in a run";

/// Effects of a bus where the sensor has its own clock.
const SYNC_WAITS: &str = "not in the model: SYNC waits for frames of the sensor's own clock. At some phases of this clock the rig \
                          may need more mass. Without dry friction it may swing slowly at every mass";
const SAMPLE_MISSED: &str = "not in the model: heartbeats that delay SYNC can make a sample of the sensor's own clock late. At some \
                             phases of this clock the rig may need more mass (1.5 times the least in the worst of 60 drawn rigs)";

/// Smallest stable virtual masses of a rig, by hands; the first hand is the scene's, if it has a spring.
pub(crate) struct Masses {
    name: String,
    configured_kg: f64,
    has_scene_hand: bool,
    uneven: Option<UnevenSamples>,
    /// Parts of the scene that the masses leave out.
    unmodelled: Vec<String>,
    /// Limits of drives that close a loop of their own.
    drives: Option<DriveLimits>,
    /// Measured values, if they replace those of the rig file.
    measured: Option<Measured>,
    /// `None` where the loop is not known.
    holdings: Option<Vec<Holding>>,
}

impl Masses {
    /// Computes the masses for the scene's hand and the usual hands, or for hands with `stiffnesses` in N/m.
    pub(crate) fn of(rig: &Loaded<Rig>, stiffnesses: &[f64]) -> Result<Self, RigError> {
        let others = |hand: &Grip| match stiffnesses {
            [] => usual_hands(hand).to_vec(),
            _ => stiffnesses.iter().map(|&stiffness| stiffer(hand, stiffness)).collect(),
        };
        Self::with(rig, others, held_masses)
    }

    /// For the hand of the scene alone.
    pub(crate) fn of_scene(rig: &Loaded<Rig>) -> Result<Self, RigError> {
        Self::with(rig, |_| Vec::new(), held_masses)
    }

    /// Computes the masses for the scene's hand and for others, from the identified joints and force.
    pub(super) fn of_identified(
        rig: &Loaded<Rig>,
        found: &[JointFound; 2],
        force: Option<&ForceFound>,
        others: impl Fn(&Grip) -> Vec<Grip>,
    ) -> Result<Self, RigError> {
        let held = |rig: &Rig, scene: &Scene, hands: &[Grip], configured_kg| {
            held_masses_identified((rig, scene), (found, force), hands, configured_kg)
        };
        Self::with(rig, others, held)
    }

    /// For the hand of the scene and for others.
    fn with(
        rig: &Loaded<Rig>,
        others: impl Fn(&Grip) -> Vec<Grip>,
        held: impl Fn(&Rig, &Scene, &[Grip], f64) -> Result<Option<Vec<Holding>>, RigError>,
    ) -> Result<Self, RigError> {
        let scene = rig.scene().map_err(|_| RigError::NoScene)?;
        let hand = hand_of(&scene.value);
        let others = others(&hand);
        let has_scene_hand = hand.stiffness_n_per_m > 0.0;
        // The scene's hand may be one of the usual ones.
        let further = others.into_iter().filter(|other| !(has_scene_hand && is_same(other, &hand)));
        let hands: Vec<Grip> = has_scene_hand.then_some(hand).into_iter().chain(further).collect();
        let configured_kg = match rig.value.fixture.coupling {
            Coupling::Admittance { mass_kg } => mass_kg.get(),
            Coupling::Impedance { .. } => return Err(RigError::NoAdmittance),
        };
        let holdings = held(&rig.value, &scene.value, &hands, configured_kg)?;
        Ok(Self {
            name: rig.value.rig.name.clone(),
            configured_kg,
            has_scene_hand,
            uneven: uneven_samples(&rig.value),
            unmodelled: unmodelled(&scene.value),
            drives: drive_limits(&rig.value, &scene.value, configured_kg)?,
            measured: None,
            holdings,
        })
    }

    /// Returns the masses and their limits, a line each.
    pub(crate) fn lines(&self) -> Vec<String> {
        let Some(holdings) = &self.holdings else {
            return note(UNKNOWN);
        };
        let mut lines = vec!["stable virtual masses at the worst pose, by stiffness of the hand:".to_owned()];
        lines.extend(holdings.iter().enumerate().map(|(index, holding)| {
            let whose = if index == 0 && self.has_scene_hand { " (the scene's hand)" } else { "" };
            format!("{:>6} N/m  {}{whose}", holding.grip.stiffness_n_per_m, range_words(holding.masses.as_ref()))
        }));
        lines.extend(self.beside().iter().flat_map(|words| note(words)));
        lines
    }

    /// Returns the finding on a rig whose mass is unstable with its scene's hand.
    pub(crate) fn finding(&self, rig: &Loaded<Rig>) -> Option<Diagnostic> {
        let scenes = self.holdings.as_ref()?.first().filter(|_| self.has_scene_hand)?;
        if scenes.is_configured_stable {
            return None;
        }
        let allowed = match scenes.masses {
            Some(masses) if self.configured_kg > masses.greatest_kg => {
                format!("the largest at {} is {:.3} kg", place_words(masses.greatest_at_m), masses.greatest_kg)
            }
            Some(masses) => format!("the smallest at {} is {:.3} kg", place_words(masses.least_at_m), masses.least_kg),
            None => "no mass is stable with it".to_owned(),
        };
        let message = format!(
            "without friction a virtual mass of {} kg is unstable with the scene's hand ({}): {allowed}",
            self.configured_kg,
            grip_words(&scenes.grip)
        );
        let scene = rig.scene().ok()?.value;
        let help = remedy_words(&rig.value, &scene, &scenes.grip, self.configured_kg);
        let see =
            [("control.gains", "the servo's gains"), ("sensor.low_pass_hz", "the low pass"), ("scene", "the hand")];
        Some(rig.finding(Severity::Warning, "fixture.coupling.admittance.mass_kg", message, help, &see))
    }

    /// Limits of this rig and parts of its scene that the numbers leave out.
    fn beside(&self) -> Vec<String> {
        let mut beside = Vec::new();
        if let Some(drives) = &self.drives {
            let DriveLimits { saturating_n, count_n_m, torque_limit_n_m: limit, is_saturated_soon } = drives;
            if *is_saturated_soon {
                let of = self.configured_kg;
                beside.push(format!(
                    "with {of} kg, a force of {saturating_n:.2} N makes the drives' loop ask for the torque limit of {limit} N m; the masses are not \
                     valid beyond it"
                ));
            }
            if let Some(count_n_m) = count_n_m.filter(|_| drives.is_coarse()) {
                beside.push(format!(
                    "one count of the target makes the drives' loop ask for {count_n_m:.1} N m (limit {limit} N m)"
                ));
            }
        }
        if !self.unmodelled.is_empty() {
            beside.push(format!("not in the model, of the scene: {}", self.unmodelled.join("; ")));
        }
        beside
    }

    /// Returns the effect of the bus on the numbers.
    fn bus_words(&self) -> Option<&'static str> {
        self.holdings.as_ref()?;
        self.uneven.map(|uneven| match uneven {
            UnevenSamples::SyncWaits => SYNC_WAITS,
            UnevenSamples::SampleMissed => SAMPLE_MISSED,
        })
    }

    /// Returns a table for a person to read.
    pub(crate) fn text(&self, reserve: f64) -> String {
        let Some(holdings) = &self.holdings else { return self.lines().join("\n") + "\n" };
        let unstable: Vec<String> = holdings
            .iter()
            .filter(|holding| !holding.is_configured_stable)
            .map(|holding| format!("{} N/m", holding.grip.stiffness_n_per_m))
            .collect();
        let mut text = match unstable.as_slice() {
            [] => format!("verdict   ok: {} kg is stable with each of these hands\n", self.configured_kg),
            hands => {
                format!("verdict   NOT OK: {} kg is unstable with hands of {}\n", self.configured_kg, hands.join(", "))
            }
        };
        text += &format!("rig       {}\nmasses    stable virtual masses in kg, worst pose on the surface\n", self.name);
        let mut row = |cells: [&str; 7]| {
            let [stiffness, damping, mass, stable, reserved, configured, place] = cells;
            let line = format!(
                "{stiffness:>8} {damping:>6} {mass:>4}  {stable:>14}  {reserved:>14}  {configured:>8}  {place:>14}"
            );
            text += &format!("{}\n", line.trim_end());
        };
        let (reserve_head, configured) = (format!("reserve of {reserve}"), format!("{} kg", self.configured_kg));
        row(["hand", "", "", "stable", &reserve_head, &configured, "smallest at"]);
        row(["N/m", "N s/m", "kg", "", "", "", "x, y in m"]);
        for Holding { grip, masses, is_configured_stable, .. } in holdings {
            let reserved = masses.as_ref().and_then(|masses| with_reserve(masses, reserve));
            row([
                &grip.stiffness_n_per_m.to_string(),
                &format!("{:.1}", grip.damping_n_s_per_m),
                &grip.mass_kg.to_string(),
                &range(masses.as_ref()),
                &range(reserved.as_ref()),
                if *is_configured_stable { "stable" } else { "UNSTABLE" },
                &masses.map_or_else(String::new, |masses| coordinates(masses.least_at_m)),
            ]);
        }
        if self.has_scene_hand {
            text += "  the first hand is the scene's\n";
        }
        for holding in holdings {
            text += &why(holding);
        }
        let passive_kg = holdings.iter().map(|holding| holding.passive_kg).fold(0.0, f64::max);
        text += &format!("  no mass below {passive_kg:.1} kg (the arm's own) is passive with every hand\n");
        let measured = self.measured.iter().map(Measured::words);
        let model = self.bus_words().into_iter().chain([LEFT_OUT]).map(str::to_owned);
        for line in measured.chain(model).chain(self.beside()).flat_map(|words| note(&words)) {
            text += &format!("{line}\n");
        }
        text
    }

    /// Returns the data for a program. A mass that does not exist is `null`, and so is a greatest one where none drifts.
    pub(crate) fn to_json(&self, reserve: f64) -> Value {
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
        let measured = self.measured.map(Measured::to_json);
        let drives = self.drives.map(|drives| {
            json!({ "saturating_force_n": drives.saturating_n, "target_count_n_m": drives.count_n_m, "torque_limit_n_m": drives.torque_limit_n_m })
        });
        json!({ "configured_kg": self.configured_kg, "reserve": reserve, "hands": hands, "note": note, "unmodelled": self.unmodelled, "drives": drives,
            "measured": measured })
    }
}

/// Returns a note in lines of 80 columns at most.
fn note(words: &str) -> Vec<String> {
    fit::filled("  ", "    ", words, fit::USUAL).lines().map(str::to_owned).collect()
}

/// Whether two hands look the same in a table.
fn is_same(one: &Grip, other: &Grip) -> bool {
    let near = |a: f64, b: f64| (a - b).abs() <= 1e-9 * a.abs().max(b.abs());
    near(one.stiffness_n_per_m, other.stiffness_n_per_m) && near(one.damping_n_s_per_m, other.damping_n_s_per_m)
}

/// Returns the advice for a rig that oscillates with its scene's hand, as far as its linear model shows.
pub(crate) fn advice(rig: &Rig, scene: &Scene) -> String {
    let Coupling::Admittance { mass_kg } = rig.fixture.coupling else { return String::new() };
    let hand = hand_of(scene);
    match held_masses(rig, scene, &[hand], mass_kg.get()).ok().flatten().as_deref() {
        Some([holding, ..]) if !holding.is_configured_stable => remedy_words(rig, scene, &hand, mass_kg.get()),
        Some(_) => "in the rig's linear model this mass is stable with this hand. Check dry friction, torque limits and encoders, \
                    which the model leaves out, and the figure of the run (`--figure`)"
            .to_owned(),
        None => "the loop of the rig is not known; try a heavier virtual mass and a softer hand".to_owned(),
    }
}

/// Returns the changes that make a mass stable with a hand. Each one was tested in the rig's own linear model, and as a rig that
/// passes the check.
fn remedy_words(rig: &Rig, scene: &Scene, hand: &Grip, mass_kg: f64) -> String {
    let found = remedies(rig, scene, hand, mass_kg).unwrap_or_default();
    let is_tried = |remedy: &Remedy| remedy.is_of_hand() || is_accepted(&remedy.of_rig(rig), scene);
    let words: Vec<String> =
        found.into_iter().filter(is_tried).map(|remedy| one_remedy_words(rig, hand, remedy)).collect();
    match words.as_slice() {
        [] => "in the rig's linear model no single change makes it stable: neither another mass, low pass, rate or period, nor a \
               softer hand or one with more damping"
            .to_owned(),
        [only] => format!("in the rig's linear model this makes it stable: {only}"),
        several => format!("in the rig's linear model each of these alone makes it stable: {}", several.join("; ")),
    }
}

fn one_remedy_words(rig: &Rig, hand: &Grip, remedy: Remedy) -> String {
    match remedy {
        Remedy::Mass(mass_kg) => format!("`mass_kg: {mass_kg:?}`"),
        Remedy::LowPass(Some(cut_off_hz)) => format!("`low_pass_hz: {cut_off_hz:?}` of the sensor"),
        Remedy::LowPass(None) => "`low_pass_hz: null` of the sensor".to_owned(),
        Remedy::SampleRate(rate_hz) => format!("`sample_rate_hz: {rate_hz:?}` of the sensor"),
        Remedy::Period(period_us) => {
            format!("`period_us: {period_us}` with `compute_at_us: {}`", remedy.of_rig(rig).cycle.compute_at_us)
        }
        Remedy::Damping(damping_n_s_per_m) if hand.mass_kg > 0.0 => {
            let ratio = damping_n_s_per_m / (2.0 * (hand.stiffness_n_per_m * hand.mass_kg).sqrt());
            format!("a hand that damps {damping_n_s_per_m} N s/m (damping ratio {ratio:.2})")
        }
        Remedy::Damping(damping_n_s_per_m) => format!("a hand that damps {damping_n_s_per_m} N s/m"),
        Remedy::Stiffness(stiffness) => format!("a hand of {stiffness} N/m with the same damping ratio"),
    }
}

/// Whether a rig passes its check with this scene, and its buses carry it.
fn is_accepted(rig: &Rig, scene: &Scene) -> bool {
    let about = replay::about(rig, Some(scene), &Overrides::default()).ok();
    let accepted = about.and_then(|about| replay::rig(&about).ok());
    accepted.is_some_and(|rig| plans(&rig).is_ok_and(|plans| plans.iter().all(Plan::is_kept)))
}

fn grip_words(grip: &Grip) -> String {
    format!("{} N/m, {:.1} N s/m, {} kg", grip.stiffness_n_per_m, grip.damping_n_s_per_m, grip.mass_kg)
}

/// Returns a range in words.
fn range_words(masses: Option<&HeldMasses>) -> String {
    let unit = if masses.is_some() { " kg" } else { "" };
    range(masses) + unit
}

/// Returns the range without its unit.
fn range(masses: Option<&HeldMasses>) -> String {
    let three = |mass_kg: f64| if mass_kg < 10.0 { format!("{mass_kg:.3}") } else { format!("{mass_kg:.0}") };
    match masses {
        None => "none".to_owned(),
        Some(HeldMasses { least_kg, greatest_kg, .. }) if greatest_kg.is_finite() => {
            format!("{} to {}", three(*least_kg), three(*greatest_kg))
        }
        Some(HeldMasses { least_kg, .. }) => format!("from {}", three(*least_kg)),
    }
}

/// Returns the rest of a range whose two ends keep a factor of `reserve` from the edge.
fn with_reserve(masses: &HeldMasses, reserve: f64) -> Option<HeldMasses> {
    let [least_kg, greatest_kg] = [masses.least_kg * reserve, masses.greatest_kg / reserve];
    (least_kg <= greatest_kg).then_some(HeldMasses { least_kg, greatest_kg, ..*masses })
}

/// Explains the end of a range of masses, or its absence, as a line; `None` for a range without an upper end.
fn why(holding: &Holding) -> String {
    let Holding { grip, masses, lag_s, .. } = holding;
    let [lag_ms, allowed_ms] = [*lag_s, grip.damping_n_s_per_m / grip.stiffness_n_per_m].map(|time| 1e3 * time);
    let lags = format!("low-frequency lag {lag_ms:.1} ms; the hand's damping compensates {allowed_ms:.1} ms");
    let stiffness = grip.stiffness_n_per_m;
    match masses {
        Some(masses) if masses.greatest_kg.is_finite() => {
            format!("  heavier masses are slowly unstable at {stiffness} N/m:\n    {lags}\n")
        }
        Some(_) => String::new(),
        None if lag_ms > allowed_ms => format!("  no stable mass at {stiffness} N/m:\n    {lags}\n"),
        None => {
            format!(
                "  no stable mass at {stiffness} N/m:\n    the servo with this hand is unstable by itself, or nearly so\n"
            )
        }
    }
}

fn place_words(tool_m: [f64; 2]) -> String {
    format!("({}) m", coordinates(tool_m))
}

fn coordinates(tool_m: [f64; 2]) -> String {
    // A zero without its sign.
    let [x, y] = tool_m.map(|value| 1e-3 * (1e3 * value).round() + 0.0);
    format!("{x:.3}, {y:.3}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_config::{Source, builtin, load_rig};

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
            assert!(masses.finding(&shipped).is_none(), "{name}: {}", flat(&masses));
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
        assert!(message.contains("no mass") || message.contains("the largest"), "{message}");
        assert!(slow_masses.text(2.0).contains("low-frequency lag 5"), "{}", slow_masses.text(2.0));
    }

    #[test]
    fn a_braced_hand_needs_more_mass_and_the_reserve_is_a_factor() {
        let shipped = rig(&[]);
        let masses = Masses::of(&shipped, &[500.0, 3000.0]).unwrap();
        let [_, soft, braced] = masses.holdings.as_deref().unwrap() else { panic!("{}", flat(&masses)) };
        assert!(braced.masses.unwrap().least_kg > soft.masses.unwrap().least_kg, "{soft:?} {braced:?}");
        let json = masses.to_json(3.0);
        let [least, with] = ["least_virtual_mass_kg", "virtual_mass_with_reserve_kg"]
            .map(|key| json["hands"][1][key].as_f64().unwrap());
        assert!((with / least - 3.0).abs() < 1e-12);
        assert!(masses.text(3.0).contains("  0.000, -0.120\n"), "{}", masses.text(3.0));
    }

    /// Returns the lines without their breaks.
    fn flat(masses: &Masses) -> String {
        masses.lines().join(" ").split_whitespace().collect::<Vec<_>>().join(" ")
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
        let joint = |pose_rad| JointFound { inertia_kg_m2: 0.34, pose_rad, delay_s: 1e-3, viscous_n_m_s_per_rad: 0.5 };
        let joints = [[2.2, 0.69], [2.1, 0.79]].map(joint);
        let masses = Masses::of_identified(&velocity, &joints, None, |_| Vec::new()).unwrap();
        assert!(flat(&masses).contains("`yieldwall tune fixture`"), "{}", flat(&masses));
        assert_eq!(masses.to_json(2.0)["note"], flat(&masses));
        assert!(Masses::of(&rig(&[]), &[]).unwrap().to_json(2.0)["note"].is_null());
    }

    #[test]
    fn limits_of_stiff_drives_stand_beside_the_masses() {
        let mut rig = load_rig(builtin("paper-admittance-csp.yaml")).unwrap();
        let shipped = Masses::of_scene(&rig).unwrap();
        assert!(!flat(&shipped).contains("torque limit"), "{}", flat(&shipped));
        let of_shipped = shipped.to_json(2.0)["drives"].clone();
        (rig.value.cycle.period_us, rig.value.cycle.compute_at_us) = (250, 150);
        let servo = &mut rig.value.simulation.as_mut().unwrap().drive_position_loop;
        servo.stiffness_n_m_per_rad = yieldwall_config::Positive::new(1.35e6).unwrap();
        servo.damping_n_m_s_per_rad = yieldwall_config::NotNegative::new(1232.0).unwrap();
        rig.value.fixture.coupling = Coupling::Admittance { mass_kg: yieldwall_config::Positive::new(0.8).unwrap() };
        let stiff = Masses::of_scene(&rig).unwrap();
        let (text, json) = (stiff.text(2.0), stiff.to_json(2.0)["drives"].clone());
        // 2 pi/800 000 counts of 1232 N m s/rad in 0.25 ms.
        assert!(text.contains("one count of the target makes the drives' loop ask for 38.7 N m (limit"), "{text}");
        assert!(flat(&stiff).contains("makes the drives' loop ask for the torque limit of 60 N m"), "{}", flat(&stiff));
        let force_n = |json: &Value| json["saturating_force_n"].as_f64().unwrap();
        // The lever is the same, M T B are not.
        let expected = force_n(&of_shipped) * (0.8 / 2.0) * (150.0 / 1232.0) * (1000.0 / 250.0);
        assert!((force_n(&json) / expected - 1.0).abs() < 1e-9 && (30.0..60.0).contains(&force_n(&json)), "{json}");
    }

    #[test]
    fn what_of_a_scene_the_masses_leave_out_stands_beside_them() {
        let source = builtin("scenes/circle-tour.yaml").read().unwrap();
        let of = |scene: &str| {
            let names = ["paper-admittance-csp.yaml", "paper-admittance.yaml", "simulations/paper-arm.yaml"];
            let files = names.map(|name| (name.into(), builtin(name).read().unwrap()));
            let scene: [(std::path::PathBuf, _); 1] = [("scenes/circle-tour.yaml".into(), scene.to_owned().into())];
            let rig = load_rig(Source::among(names[0], files.into_iter().chain(scene))).unwrap();
            Masses::of_scene(&rig).unwrap()
        };
        let plain = of(&source);
        assert!(!flat(&plain).contains("not in the model") && plain.to_json(2.0)["unmodelled"] == json!([]));
        let ideal = of(&source.replace("tracking: rigid", "tracking: ideal"));
        let defective = of(&(source.to_string() + "defects: [{defect: backlash, drive: left}]\n"));
        for (masses, part) in [(ideal, "`model.tracking: ideal`"), (defective, "`backlash`")] {
            let text = masses.text(2.0);
            assert!(flat(&masses).contains(part) && text.contains(part), "{part}: {text}");
            assert!(masses.to_json(2.0)["unmodelled"][0].as_str().unwrap().contains(part), "{part}");
        }
    }

    #[test]
    fn what_a_bus_adds_is_told_of_sensors_with_a_clock_of_their_own() {
        for (name, words) in [
            ("paper-admittance.yaml", None),
            ("paper-admittance-streaming.yaml", Some("SYNC waits")),
            ("paper-admittance-polled.yaml", Some("own clock late")),
        ] {
            let masses = Masses::of(&load_rig(builtin(name)).unwrap(), &[]).unwrap();
            let note = masses.to_json(2.0)["note"].as_str().map(str::to_owned);
            assert_eq!(note.is_some(), words.is_some(), "{name}: {note:?}");
            if let (Some(note), Some(words)) = (note, words) {
                let text = masses.text(2.0).split_whitespace().collect::<Vec<_>>().join(" ");
                assert!(note.contains(words) && text.contains(&note), "{name}: {note}");
            }
        }
    }

    /// Returns the rig on a period of 2 ms with the scene's hand at 3000 N/m, with and without damping as arms have it.
    fn braced(damping_n_s_per_m: &str) -> Loaded<Rig> {
        let mut texts: Vec<(std::path::PathBuf, std::sync::Arc<str>)> = Vec::new();
        for name in ["paper-admittance-2ms.yaml", "paper-admittance.yaml", "simulations/paper-arm.yaml"] {
            texts.push((name.into(), builtin(name).read().unwrap()));
        }
        let scene = builtin("scenes/circle-tour.yaml").read().unwrap().to_string();
        let changed = scene
            .replace("stiffness_n_per_m: 400.0", "stiffness_n_per_m: 3000.0")
            .replace("damping_n_s_per_m: 8.0", &format!("damping_n_s_per_m: {damping_n_s_per_m}"));
        assert!(changed.contains("3000.0") && changed.contains(damping_n_s_per_m));
        texts.push(("scenes/circle-tour.yaml".into(), changed.into()));
        load_rig(Source::among("paper-admittance-2ms.yaml", texts)).unwrap()
    }

    /// Heavier ones drift with a hand that rings: that once was the advice.
    #[test]
    fn advice_for_a_hand_that_rings_is_tried_in_the_rigs_own_model_before_it_is_given() {
        let rig = braced("7.75");
        let damping = rig.warnings.iter().find(|warning| warning.key == "hand.damping_n_s_per_m").unwrap();
        assert!(damping.message.contains("damping ratio of 0.10"), "{}", damping.message);
        let finding = Masses::of(&rig, &[]).unwrap().finding(&rig).unwrap();
        let help = finding.help.unwrap();
        assert!(help.contains("`mass_kg: 0.71`") && help.contains("a hand that damps 12 N s/m"), "{help}");
        let hand = hand_of(&rig.scene().unwrap().value);
        let scene = rig.scene().unwrap().value;
        let found = remedies(&rig.value, &scene, &hand, 2.0).unwrap();
        assert!(found.len() >= 4, "{found:?}");
        for remedy in found {
            let (changed, hand) = (remedy.of_rig(&rig.value), remedy.of_hand(&hand));
            let Coupling::Admittance { mass_kg } = changed.fixture.coupling else { panic!("{changed:?}") };
            let holding = held_masses(&changed, &scene, &[hand], mass_kg.get()).unwrap().unwrap()[0];
            assert!(holding.is_configured_stable, "{remedy:?}");
        }
        assert_eq!(damped_warnings(&braced("20.0")), 0);
    }

    fn damped_warnings(rig: &Loaded<Rig>) -> usize {
        rig.warnings.iter().filter(|warning| warning.key == "hand.damping_n_s_per_m").count()
    }

    #[test]
    fn a_hand_has_one_row_also_where_the_scenes_is_a_usual_one() {
        let masses = Masses::of(&braced("7.75"), &[]).unwrap();
        let stiffnesses: Vec<f64> =
            masses.holdings.unwrap().iter().map(|holding| holding.grip.stiffness_n_per_m).collect();
        assert_eq!(stiffnesses, [3000.0, 500.0, 1000.0]);
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
