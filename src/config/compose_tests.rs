use std::path::PathBuf;
use std::sync::Arc;

use proptest::prelude::*;

use super::malformed::{base, base_text, with};
use super::{
    Coupling, Loaded, Report, Rig, SensorProtocol, Severity, Source, Surface, builtin, builtin_names, load, load_rig,
    to_yaml,
};

/// A variant of the rig of the malformed files, which is its neighbour.
fn variant(keys: &str) -> Result<Loaded<Rig>, Report> {
    load_rig(with("variant.yaml", "variant.yaml", &format!("like: rig.yaml\n{keys}")))
}

fn is(keys: &str) -> Rig {
    variant(keys).unwrap_or_else(|report| panic!("{keys}: {report}")).value
}

/// The errors of the rig with a text replaced everywhere, each with its help.
fn errors(from: &str, to: &str) -> Vec<(String, String)> {
    let text = base_text("rig.yaml");
    assert!(text.contains(from), "{from}");
    let report = load_rig(with("rig.yaml", "rig.yaml", &text.replace(from, to))).unwrap_err();
    let errors = report.diagnostics.into_iter().filter(|finding| finding.severity == Severity::Error);
    errors.map(|finding| (finding.message, finding.help.unwrap_or_default())).collect()
}

#[test]
fn an_error_names_the_cause_and_not_a_consequence() {
    let buses = errors("bus: main", "bus: mian");
    assert_eq!(buses.len(), 3, "{buses:?}");
    assert!(buses.iter().all(|(_, help)| help == "did you mean `main`?"), "{buses:?}");
    let [(message, help), ..] = &errors("proximal_m: [0.30, 0.30]", "proximal_m: [300, 300]")[..] else { panic!() };
    assert_eq!((message.as_str(), help.as_str()), ("`linkage.proximal_m` is 300 m", "write metres, such as 0.3"));
    let [(message, help)] = &errors("cycle:", "period_us: 100\ncycle:")[..] else { panic!() };
    assert_eq!(message, "there is no top-level key `period_us`");
    assert!(help.starts_with("did you mean `cycle.period_us`?"), "{help}");
}

/// The rig with some of its text replaced.
fn changed(changes: &[(&str, &str)]) -> Rig {
    let text = changes.iter().fold(base_text("rig.yaml").to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replacen(from, to, 1)
    });
    load_rig(with("rig.yaml", "rig.yaml", &text)).unwrap_or_else(|report| panic!("{report}")).value
}

#[test]
fn a_variant_is_its_base_with_its_own_keys_in_place() {
    assert_eq!(is(""), changed(&[]));
    assert_eq!(is("fixture: {yield_n: 25.0}"), changed(&[("yield_n: 20.0", "yield_n: 25.0")]));
    assert_eq!(is("sensor:\n  low_pass_hz: 200"), changed(&[("low_pass_hz: null", "low_pass_hz: 200")]));
    let inertia = is("control: {feed_forward: {inertia: null}}").control.feed_forward.inertia;
    assert!(inertia.is_none());
    let lists = is("control: {feed_forward: {coulomb_n_m: [1.0, 2.0]}}").control.feed_forward.coulomb_n_m;
    assert_eq!(lists.map(|value| value.get()), [1.0, 2.0]);
    // A group that the base lacks is added.
    assert_eq!(is("fixture: {passivity: {bound_j: 0.05}}").fixture.passivity.unwrap().bound_j.get(), 0.05);
}

#[test]
fn a_variant_of_a_variant_is_merged_from_the_bottom_up() {
    let rig = |path: &str, text: &str| (PathBuf::from(path), Arc::<str>::from(text));
    let files = [
        rig("a/rig.yaml", "like: ../b/rig.yaml\nfixture: {yield_n: 26.0}\n"),
        rig(
            "b/rig.yaml",
            "like: builtin:paper-ethercat.yaml\nrig: {name: b}\nfixture: {yield_n: 25.0, friction_n: 4.0}\ndrives: [{name: left, profile: own.yaml}]\n",
        ),
        rig("b/own.yaml", &builtin("profiles/simulated-servo.yaml").read().unwrap()),
    ];
    let loaded = load_rig(Source::among("a/rig.yaml", files)).unwrap_or_else(|report| panic!("{report}"));
    let fixture = &loaded.value.fixture;
    assert_eq!((fixture.yield_n.get(), fixture.friction_n.get()), (26.0, 4.0));
    assert_eq!(loaded.value.rig.name, "b");
    // Buses are those of the lowest but one, and the path starts where it stands.
    assert!(loaded.value.is_on_ethercat());
    assert!(
        loaded.value.drives[0].profile.as_str().ends_with("b/own.yaml"),
        "{}",
        loaded.value.drives[0].profile.as_str()
    );
}

#[test]
fn variants_in_a_circle_and_without_end_are_refused_where_they_name_each_other() {
    let rig = |path: String, like: String| {
        (PathBuf::from(path), Arc::<str>::from(format!("like: {like}\nrig: {{name: x}}\n")))
    };
    let circle = [rig("a.yaml".into(), "b.yaml".into()), rig("b.yaml".into(), "a.yaml".into())];
    let report = load_rig(Source::among("a.yaml", circle)).unwrap_err();
    assert!(
        report.to_string().contains("b.yaml:1:7: error: `like`: a.yaml is itself a variant of this file"),
        "{report}"
    );
    let chain = (0..20).map(|level| rig(format!("{level}.yaml"), format!("{}.yaml", level + 1)));
    let report = load_rig(Source::among("0.yaml", chain)).unwrap_err();
    assert!(report.to_string().contains("the variant of a variant at the 8th level"), "{report}");
}

#[test]
fn a_choice_is_merged_with_itself_and_replaced_by_another() {
    let Coupling::Admittance { mass_kg } = is("fixture: {coupling: {admittance: {mass_kg: 3.0}}}").fixture.coupling
    else {
        panic!("another coupling")
    };
    assert_eq!(mass_kg.get(), 3.0);
    let Surface::Circle { radius_m, center_m, .. } =
        is("fixture: {surface: {circle: {radius_m: 0.1}}}").fixture.surface
    else {
        panic!("another surface")
    };
    assert_eq!((radius_m.get(), center_m.map(|value| value.get())), (0.1, [0.0, 0.0]));
    let line = is("fixture: {surface: {line: {point_m: [0.0, 0.05], normal: [0.0, 1.0]}}}").fixture.surface;
    assert!(matches!(line, Surface::Line { .. }));
    let sensor = load_rig(base("variant.yaml")).unwrap().value.sensor;
    assert!(matches!(sensor.protocol, SensorProtocol::Polled { base_id: 0x1b0, .. }));
    // An optional choice is taken away by null.
    let law = is("fixture: {law: null}").fixture.law;
    assert!(law.is_none());
}

#[test]
fn drives_are_told_apart_by_their_names() {
    let rig = is("drives:\n  - {name: right, address: {canopen: {heartbeat_ms: 40}}}\n  - {name: left, direction: -1}");
    let [left, right] = &rig.drives;
    assert_eq!((left.name.as_str(), left.address.heartbeat_ms(), left.direction), ("left", Some(20), -1));
    assert_eq!((right.name.as_str(), right.address.heartbeat_ms(), right.direction), ("right", Some(40), 1));
    let waits = is("drives:\n  - {name: left, waits: {sdo_ms: 700}}").drives;
    assert_eq!((waits[0].waits.sdo_ms, waits[0].waits.boot_up_ms, waits[1].waits.sdo_ms), (Some(700), None, None));
}

#[test]
fn a_finding_points_into_the_file_where_the_value_stands() {
    let at = |report: &Report, index: usize| {
        let finding = &report.diagnostics[index];
        let (place, text) = (finding.place.unwrap(), finding.text.as_ref().unwrap());
        (finding.file.clone(), text[place.offset..place.offset + place.length].to_owned(), place.line)
    };
    // The value of the variant does not suit one of the base.
    let report = variant("\nfixture:\n  yield_n: 2.0\n").unwrap_err();
    assert_eq!(at(&report, 0), ("variant.yaml".to_owned(), "2.0".to_owned(), 4));
    let related = &report.diagnostics[0].related[0];
    assert_eq!((related.file.as_str(), related.label.as_str()), ("rig.yaml", "friction_n"));
    let line = base_text("rig.yaml").lines().nth(related.place.line - 1).unwrap();
    assert!(line.contains("friction_n: 3.0"), "{line}");
    // A value of the base does not suit the variant.
    let report = variant("cycle: {period_us: 1050}").unwrap_err();
    assert_eq!(at(&report, 0).0, "rig.yaml");
    assert!(report.diagnostics[0].related.iter().any(|other| other.file == "variant.yaml"), "{report}");
    // The type of a value, and its range.
    for (keys, value) in [("fixture: {yield_n: strong}", "strong"), ("fixture: {yield_n: -1}", "-1")] {
        assert_eq!(at(&variant(keys).unwrap_err(), 0), ("variant.yaml".to_owned(), value.to_owned(), 2));
    }
    let wrong = base_text("rig.yaml").replace("yield_n: 20.0", "yield_n: strong");
    let report = load_rig(with("variant.yaml", "rig.yaml", &wrong)).err();
    assert!(report.is_none(), "the variant has a yield force of its own: {report:?}");
    let wrong = base_text("rig.yaml").replace("friction_n: 3.0", "friction_n: weak");
    let report = load_rig(with("variant.yaml", "rig.yaml", &wrong)).unwrap_err();
    assert_eq!((at(&report, 0).0, at(&report, 0).1), ("rig.yaml".to_owned(), "weak".to_owned()));
    // Several, the file that is named first.
    let report = variant("guard: {force_limit_n: 15.0}\nfixture: {yield_n: 2.0}").unwrap_err();
    let files: Vec<&str> = report.diagnostics.iter().map(|finding| finding.file.as_str()).collect();
    assert!(files.is_sorted_by(|one, other| one == other || *one == "variant.yaml"), "{files:?}");
}

#[test]
fn a_variant_of_a_file_elsewhere_runs_the_scene_of_that_file() {
    let texts = |like: &str| {
        let scene: Arc<str> = base_text("scene.yaml").into();
        let simulation = base_text("simulation.yaml").replace("scene: ", "scene: ../scenes/");
        Source::among(
            "mine/variant.yaml",
            [
                (PathBuf::from("mine/variant.yaml"), Arc::from(format!("like: {like}\n"))),
                (PathBuf::from("theirs/rig.yaml"), base_text("rig.yaml").into()),
                (PathBuf::from("theirs/simulation.yaml"), Arc::from(simulation)),
                (PathBuf::from("scenes/scene.yaml"), scene),
            ],
        )
    };
    let rig = load_rig(texts("../theirs/rig.yaml")).unwrap();
    assert_eq!(rig.value.simulated().unwrap().scene, "../scenes/scene.yaml");
    assert_eq!(rig.scene().unwrap().source.to_string(), "scenes/scene.yaml");
    assert_eq!(rig.like.unwrap().to_string(), "theirs/rig.yaml");

    let folder = std::env::temp_dir().join(format!("yieldwall-variant-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let file = folder.join("mine.yaml");
    std::fs::write(&file, "like: builtin:paper-admittance.yaml\nrig: {name: mine}\n").unwrap();
    let mine = load_rig(Source::disk(&file)).unwrap();
    assert_eq!(mine.value.simulated().unwrap().scene, "builtin:scenes/circle-tour.yaml");
    let mut shipped = load_rig(builtin("paper-admittance.yaml")).unwrap().value;
    shipped.rig.name = "mine".to_owned();
    shipped.simulated_mut().unwrap().scene = "builtin:scenes/circle-tour.yaml".to_owned();
    assert_eq!(mine.value, shipped);
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_simulation_is_named_or_stands_in_the_rig_and_a_variant_changes_a_key_of_it() {
    let named = changed(&[]);
    let text = to_yaml(&named).unwrap();
    assert!(text.contains("drive_position_loop:"), "{text}");
    assert_eq!(load_rig(with("rig.yaml", "rig.yaml", &text)).unwrap().value, named);
    let ideal = is("simulation: {timing: ideal}");
    assert_eq!(ideal.simulated().unwrap().timing, super::BusTiming::Ideal);
    assert_eq!(ideal.simulated().unwrap().arm, named.simulated().unwrap().arm);
    let named_again = is("simulation: simulation.yaml");
    assert_eq!(named_again, named);
}

#[test]
fn a_rig_without_simulation_is_right_and_has_no_scene() {
    let text = base_text("rig.yaml").replace("simulation: simulation.yaml", "");
    let rig = load_rig(with("rig.yaml", "rig.yaml", &text)).unwrap();
    assert_eq!((rig.warnings.len(), &rig.value.simulation), (0, &None));
    let report = rig.scene().unwrap_err();
    assert!(report.to_string().contains("rig.yaml: the rig has no `simulation`"), "{report}");
    assert!(report.diagnostics[0].help.as_ref().unwrap().contains("simulation: simulations/"), "{report:?}");
    assert!(is("simulation: null").simulation.is_none());
}

/// A recording keeps this form.
#[test]
fn normal_form_of_a_variant_needs_no_other_file() {
    for name in builtin_names().filter(|name| !name.contains('/')) {
        let Ok(rig) = load_rig(builtin(name)) else { continue };
        let text = to_yaml(&rig.value).unwrap();
        assert!(!text.contains("like:"), "{name}");
        assert_eq!(load_rig(Source::memory(name, text)).unwrap().value, rig.value, "{name}");
    }
}

#[test]
fn aliases_and_quotes_mean_the_same_in_a_variant() {
    let text = base_text("rig.yaml")
        .replace("friction_n: 3.0", "friction_n: &f 3.0")
        .replace("coulomb_n_m: [8.0, 8.0]", "coulomb_n_m: [*f, *f]");
    let original = load_rig(with("rig.yaml", "rig.yaml", &text));
    let merged = load_rig(with("variant.yaml", "rig.yaml", &text));
    match (original, merged) {
        (Ok(original), Ok(merged)) => {
            assert_eq!(merged.value.control.feed_forward, original.value.control.feed_forward);
        }
        // The anchor stands below its alias.
        (original, merged) => assert_eq!(original.is_err(), merged.is_err()),
    }
    let rig = is(
        "rig: {name: '3'}\nsensor: {name: \"a: \\\"b\\\" # c\"}\nfixture: &g\n  friction_n: &f 4.0\nguard: {energy_limit_j: *f}",
    );
    assert_eq!((rig.rig.name.as_str(), rig.sensor.name.as_str()), ("3", "a: \"b\" # c"));
    assert_eq!((rig.fixture.friction_n.get(), rig.guard.energy_limit_j.get()), (4.0, 4.0));
    let report = variant("fixture: &g\n  friction_n: &f 40.0\nguard: {energy_limit_j: *f}").unwrap_err();
    assert_eq!(report.diagnostics[0].related[0].file, "variant.yaml", "{report}");
    assert!(report.diagnostics.iter().all(|finding| finding.severity == Severity::Error || finding.place.is_some()));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    /// A variant or its base with a piece cut out, doubled or overwritten.
    #[test]
    fn any_damage_to_a_variant_is_answered(
        of_base in any::<bool>(), at in 0.0..1.0_f64, length in 0..80_usize, filling in "[ -~\n\u{e9}]{0,12}", again in any::<bool>(),
    ) {
        let name = if of_base { "rig.yaml" } else { "variant.yaml" };
        let original = base_text(name);
        let start = (at * original.len() as f64) as usize;
        let end = (start + length).min(original.len());
        let piece = if again { &original[start..end] } else { "" };
        let text = format!("{}{filling}{piece}{}", &original[..end.max(start)], &original[end..]);
        if let Err(report) = load(with("variant.yaml", name, &text)) {
            prop_assert!(report.errors() > 0);
            for finding in &report.diagnostics {
                if let (Some(place), Some(text)) = (finding.place, &finding.text) {
                    prop_assert!(place.offset + place.length <= text.len(), "{}", finding);
                }
            }
        }
    }
}

#[test]
fn the_model_of_the_simulated_drives_is_one_of_a_drive() {
    let with = |profile: &str| {
        let text = format!(
            "like: paper-admittance.yaml\nsimulation:\n  drive_model:\n    profile: {profile}\n    has_dummies: true\n    \
             refuses_mode: false\n    sdo_server: {{answer_ms: 0, segments_only: false, lengths: []}}\n"
        );
        load_rig(Source::memory("odd.yaml", text))
    };
    assert!(with("maxon-epos4").is_ok());
    for (profile, says) in [("simulated-force-sensor", "is not one of a drive"), ("maxon-epos5", "is no known profile")]
    {
        let report = with(profile).unwrap_err();
        let finding = &report.diagnostics[0];
        assert!(
            finding.message.contains("simulation.drive_model.profile") && finding.message.contains(says),
            "{finding:?}"
        );
        assert_eq!(finding.place.map(|place| place.line), Some(4), "{finding:?}");
    }
}
