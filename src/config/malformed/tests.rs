use std::collections::BTreeSet;
use std::path::PathBuf;

use proptest::prelude::*;

use crate::malformed::{CASES, base, base_text, with};
use crate::{
    Diagnostic, Document, MAX_FILE_BYTES, Report, Severity, Source, builtin, builtin_names, load, load_device,
    load_figure, load_rig, load_scene, to_yaml,
};

fn refuse(source: Source) -> Report {
    match load(source.clone()) {
        Ok(_) => panic!("{source} was accepted"),
        Err(report) => report,
    }
}

#[test]
fn the_table_is_wide() {
    let classes: BTreeSet<&str> = CASES.iter().map(|case| case.class).collect();
    let names: BTreeSet<(&str, &str)> = CASES.iter().map(|case| (case.class, case.name)).collect();
    assert!(CASES.len() >= 60 && classes.len() >= 12, "{} cases, {} classes", CASES.len(), classes.len());
    assert_eq!(names.len(), CASES.len(), "a name is used twice");
    let together = CASES.chunk_by(|one, other| one.class == other.class).count();
    assert_eq!(together, classes.len(), "a class stands in two places");
}

#[test]
fn what_the_table_changes_is_right() {
    for name in
        ["device.yaml", "figure.yaml", "rig.yaml", "scene.yaml", "simulation.yaml", "space.yaml", "variant.yaml"]
    {
        let warnings = match load(base(name)).unwrap_or_else(|report| panic!("{report}")) {
            Document::Rig(rig) => rig.warnings,
            Document::Device(device) => device.warnings,
            Document::Scene(scene) => scene.warnings,
            Document::Figure(figure) => figure.warnings,
            Document::Profile(profile) => profile.warnings,
            Document::Simulation(simulation) => simulation.warnings,
            Document::ErrorCodes(codes) => codes.warnings,
        };
        assert_eq!(warnings, [], "{name}");
    }
}

#[test]
fn every_change_is_refused_at_a_place_with_help() {
    for case in CASES {
        let report = refuse(case.source());
        assert!(report.errors() > 0, "{}: {}", case.class, case.name);
        for finding in &report.diagnostics {
            let title = format!("{}: {}: {finding}", case.class, case.name);
            assert!(finding.help.as_ref().is_some_and(|help| !help.is_empty()), "{title}: no help");
            assert!(finding.place.is_some() || ["empty", "wrong kind"].contains(&case.class), "{title}: no place");
            if let Some(place) = finding.place {
                let text = finding.text.as_ref().unwrap();
                assert!(place.line >= 1 && place.column >= 1 && place.offset + place.length <= text.len(), "{title}");
                assert!(text.is_char_boundary(place.offset) && text.is_char_boundary(place.offset + place.length));
            }
        }
    }
}

#[test]
fn findings_stand_in_the_order_of_the_lines() {
    for case in CASES {
        let report = refuse(case.source());
        let lines: Vec<_> =
            report.diagnostics.iter().map(|finding| (finding.file.clone(), finding.place.map(|at| at.line))).collect();
        assert!(lines.windows(2).all(|pair| pair[0].0 != pair[1].0 || pair[0].1 <= pair[1].1), "{lines:?}");
    }
}

/// A value that a case changed is the value that the message points at.
#[test]
fn the_place_is_that_of_the_change() {
    let line_of = |name: &str| {
        let case = CASES.iter().find(|case| case.name == name).unwrap();
        let text = base_text(case.base);
        let offset = text.find(case.from).unwrap();
        let report = refuse(case.source());
        let finding = report.diagnostics.iter().find(|finding| finding.severity == Severity::Error).unwrap();
        (1 + text[..offset].matches('\n').count(), finding.place.unwrap().line)
    };
    for name in [
        "word for a number",
        "number with unit",
        "null for a number",
        "choice without its group",
        "one link",
        "unit left out",
        "mode by its abbreviation",
        "NaN",
        "infinity",
        "overflow",
        "negative mass",
        "yield below friction",
        "step after SYNC",
        "circle too large",
        "force limit below yield",
        "sample rate",
        "bit rate of no standard",
        "missing file",
        "unknown anchor",
    ] {
        let (changed, pointed) = line_of(name);
        assert_eq!(changed, pointed, "{name}");
    }
}

struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("yieldwall-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[test]
fn what_is_no_text_is_refused_by_name() {
    let folder = Folder::new("no-text");
    let says = |path: PathBuf, wanted: &str| {
        let message = refuse(Source::disk(&path)).to_string();
        assert!(message.contains(wanted), "{message}");
    };
    says(folder.0.clone(), "is a directory");
    let recording = Folder::new("recording");
    recording.file("cycles.mcap", b"");
    says(recording.0.clone(), "is a recording, not a rig");
    says(folder.0.join("absent.yaml"), "does not exist");
    says(folder.file("binary.yaml", b"rig:\0\x01\x02"), "is a binary file");
    says(folder.file("elf.yaml", b"\x7fELF\x02\x01\x01\0\0"), "is a binary file");
    says(folder.file("latin1.yaml", b"rig:\n  name: Gr\xfcn\n"), "is not UTF-8: line 2, byte 15");
    says(folder.file("utf16.yaml", b"\xff\xfer\0i\0g\0"), "is text in UTF-16");
    says(folder.file("utf16-be.yaml", b"\xfe\xff\0r\0i\0g"), "is text in UTF-16");
    says(folder.file("utf16-no-mark.yaml", b"r\0i\0g\0"), "is text in UTF-16LE");
    says(folder.file("utf32.yaml", b"\xff\xfe\0\0r\0\0\0"), "is text in UTF-32");
    says(folder.file("large.yaml", &vec![b' '; MAX_FILE_BYTES + 1]), "is larger than 1048576 bytes");
    says(folder.file("empty.yaml", b""), "is empty");
    #[cfg(unix)]
    says(PathBuf::from("/dev/zero"), "is not a regular file");
}

#[test]
fn absent_file_names_its_neighbours() {
    let folder = Folder::new("neighbours");
    folder.file("rig.yaml", b"");
    let report = refuse(Source::disk(folder.0.join("rgi.yaml")));
    assert!(report.diagnostics[0].help.as_ref().unwrap().contains("rig.yaml"), "{report:?}");
}

#[test]
fn nesting_of_any_depth_is_refused_at_once() {
    for text in ["[".repeat(200_000), "{a: ".repeat(100_000), "- ".repeat(200_000), "rig: &a\n  - *a\n".to_owned()] {
        assert!(refuse(Source::memory("deep.yaml", text)).errors() > 0);
    }
}

#[test]
fn every_kind_is_refused_where_another_is_wanted() {
    let says = |report: Report, wanted: &str| assert!(report.to_string().contains(wanted), "{report}");
    says(load_rig(builtin("scenes/circle-tour.yaml")).unwrap_err(), "is a scene, not a rig");
    says(load_scene(builtin("paper-admittance.yaml")).unwrap_err(), "is a rig, not a scene");
    says(load_device(builtin("figures/fig8.yaml")).unwrap_err(), "is a figure, not an impedance device");
    says(load_figure(builtin("paper-impedance.yaml")).unwrap_err(), "is an impedance device, not a figure");
}

#[test]
fn shipped_files_are_those_in_the_folder_and_load_without_warning() {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../config");
    let mut on_disk: Vec<String> = Vec::new();
    for folder in ["", "figures", "scenes", "simulations", "vendors", "vendors/profiles"] {
        for entry in std::fs::read_dir(root.join(folder)).unwrap() {
            let name = entry.unwrap().file_name().into_string().unwrap();
            if name.ends_with(".yaml") {
                on_disk.push(if folder.is_empty() { name } else { format!("{folder}/{name}") });
            }
        }
    }
    on_disk.sort();
    assert_eq!(on_disk, builtin_names().collect::<Vec<_>>());
    for name in builtin_names() {
        for source in [builtin(name), Source::disk(root.join(name))] {
            let mut warnings = match load(source).unwrap_or_else(|report| panic!("{report}")) {
                Document::Rig(rig) => rig.warnings,
                Document::Device(device) => device.warnings,
                Document::Scene(scene) => scene.warnings,
                Document::Figure(figure) => figure.warnings,
                Document::Profile(profile) => profile.warnings,
                Document::Simulation(simulation) => simulation.warnings,
                Document::ErrorCodes(codes) => codes.warnings,
            };
            // Odd vendors are odd in what their devices lack.
            let lacks = ["have no watchdog for", "has no sample counter"];
            let is_lack = |warning: &Diagnostic| lacks.iter().any(|lack| warning.message.contains(lack));
            warnings.retain(|warning| !(name.starts_with("vendors/") && is_lack(warning)));
            assert_eq!(warnings, [], "{name}");
        }
    }
}

#[test]
fn normal_form_loads_again_as_the_same_tree() {
    let rig = load_rig(builtin("paper-admittance.yaml")).unwrap().value;
    let again = Source::memory("paper-admittance.yaml", to_yaml(&rig).unwrap());
    assert_eq!(load_rig(again).unwrap().value, rig);
    let device = load_device(builtin("paper-impedance.yaml")).unwrap().value;
    let again = Source::memory("paper-impedance.yaml", to_yaml(&device).unwrap());
    assert_eq!(load_device(again).unwrap().value, device);
    let scene = load_scene(builtin("scenes/circle-tour.yaml")).unwrap().value;
    let again = Source::memory("scenes/circle-tour.yaml", to_yaml(&scene).unwrap());
    assert_eq!(load_scene(again).unwrap().value, scene);
    let figure = load_figure(builtin("figures/fig11.yaml")).unwrap().value;
    let again = Source::memory("figures/fig11.yaml", to_yaml(&figure).unwrap());
    assert_eq!(load_figure(again).unwrap().value, figure);
}

#[test]
fn small_radius_is_a_warning() {
    let text = base_text("rig.yaml").replace("radius_m: 0.12", "radius_m: 3.0e-5");
    let rig = load_rig(with("rig.yaml", "rig.yaml", &text)).unwrap_or_else(|report| panic!("{report}"));
    // R / kappa = 20 N (1 ms)^2 / 2 kg = 10 um, so that 30 um is 3 of them.
    assert!(rig.warnings[0].message.contains("only 3 times R/kappa = 0.01 mm"), "{}", rig.warnings[0]);
    let exact = text.replace("curvature: tangent", "curvature: exact");
    assert_eq!(load_rig(with("rig.yaml", "rig.yaml", &exact)).unwrap().warnings, []);
}

#[test]
fn rate_gain_is_refused_or_warned_of_by_the_cycles_delay() {
    let text = base_text("rig.yaml").replace("command_mode: torque", "command_mode: velocity");
    let (before, rest) = text.split_once("    joint:").unwrap();
    let after = rest.split_once("  sliding_time_s").unwrap().1;
    let rig = |gain: f64| {
        let text = format!("{before}    rate: {{gain_per_s: {gain:?}}}\n  sliding_time_s{after}");
        load_rig(with("rig.yaml", "rig.yaml", &text))
    };
    assert_eq!(rig(60.0).unwrap().warnings, []);
    assert!(rig(300.0).unwrap().warnings[0].message.contains("overshoots"));
    assert!(rig(1000.0).unwrap_err().to_string().contains("unstable"));
}

/// At 1 kHz the sensor's 500 Hz are a warning; at 250 Hz its 200 Hz are the best that it has, and 500 Hz are refused.
#[test]
fn sample_rate_is_held_against_what_the_profile_offers() {
    let text = base_text("rig.yaml");
    let rig = |period_us: u32, rate_hz: u32| {
        let text = text.replace("  period_us: 1000", &format!("  period_us: {period_us}"));
        let text = text.replace("sample_rate_hz: 1000", &format!("sample_rate_hz: {rate_hz}"));
        load_rig(with("rig.yaml", "rig.yaml", &text))
    };
    assert!(rig(1000, 500).unwrap().warnings[0].message.contains("older than it has to be"));
    assert_eq!(rig(4000, 200).unwrap().warnings, []);
    assert_eq!(rig(10_000, 200).unwrap().warnings, []);
    assert!(rig(4000, 500).unwrap_err().to_string().contains("are lost"));
}

/// In position mode no gain is used, so none is refused.
#[test]
fn position_mode_takes_any_gains() {
    let text = base_text("rig.yaml").replace("command_mode: torque", "command_mode: position");
    assert_eq!(load_rig(with("rig.yaml", "rig.yaml", &text)).unwrap().warnings, []);
}

#[test]
fn a_text_in_memory_finds_its_neighbours_first() {
    let source = base("figure.yaml");
    assert_eq!(source.relative("./rig.yaml").to_string(), "rig.yaml");
    assert_eq!(source.relative("paper-admittance.yaml").to_string(), "builtin:paper-admittance.yaml");
    assert!(refuse(Source::among("absent.yaml", [])).to_string().contains("not among the texts"));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_are_answered(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        let folder = Folder::new("any-bytes");
        let _ = load(Source::disk(folder.file("any.yaml", &bytes)));
    }

    #[test]
    fn any_text_is_answered(text in "[ -~\n\t\u{e9}\u{feff}:{}\\[\\],&*#-]{0,300}") {
        let _ = load(Source::memory("any.yaml", text));
    }

    /// A shipped rig with a piece cut out, doubled or overwritten.
    #[test]
    fn any_damage_to_a_rig_is_answered(
        at in 0.0..1.0_f64, length in 0..80_usize, filling in "[ -~\n\u{e9}]{0,12}", again in any::<bool>(),
    ) {
        let original = builtin("paper-admittance.yaml").read().unwrap().to_string();
        let start = (at * original.len() as f64) as usize;
        let end = (start + length).min(original.len());
        let piece = if again { &original[start..end] } else { "" };
        let text = format!("{}{filling}{piece}{}", &original[..end.max(start)], &original[end..]);
        if let Err(report) = load(Source::memory("damaged.yaml", text)) {
            prop_assert!(report.errors() > 0);
        }
    }
}

/// A group without a value is found at its key, and not as a key that another line lacks.
#[test]
fn a_group_that_is_null_is_named_at_its_key() {
    let shipped = builtin("paper-admittance.yaml").read().unwrap();
    let found = |text: String| {
        let finding = refuse(Source::memory("rig.yaml", text)).diagnostics.remove(0);
        (finding.key, finding.message, finding.place.unwrap().line)
    };
    let line = |text: &str, key: &str| text.lines().position(|line| line.starts_with(key)).unwrap() + 1;
    for (group, null) in [("guard", "null"), ("fixture", "~"), ("cycle", "")] {
        // What stands below goes into a group that no rig has.
        let text = shipped.replacen(&format!("\n{group}:"), &format!("\n{group}: {null}\nspare:"), 1);
        let said = if null.is_empty() { "empty".to_owned() } else { format!("`{null}`") };
        let (key, message, at) = found(text.clone());
        assert_eq!((key.as_str(), message), (group, format!("`{group}` is {said}")));
        assert_eq!(at, line(&text, &format!("{group}:")));
    }
}

#[test]
fn the_file_that_was_meant_is_named() {
    let folder = Folder::new("meant");
    folder.file("circle.yaml", b"");
    folder.file("other.yaml", b"");
    let help = |name: &str| refuse(Source::disk(folder.0.join(name))).diagnostics.remove(0).help.unwrap();
    assert!(help("cricle.yaml").ends_with("circle.yaml`?"), "{}", help("cricle.yaml"));
    assert!(help("nothing-like-it.yaml").contains("there are circle.yaml, other.yaml"));
}
