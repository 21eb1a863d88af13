//! Gains in files of every layout.

use std::ffi::OsString;
use std::fs;
use std::path::PathBuf;

use crate::failure::Exit;
use crate::run;
use yieldwall_config::{Source, builtin, load_rig};
use yieldwall_rig::analysis::{PROPOSED_MARGINS, has_margins, pose_margins};

struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("yieldwall-gains-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn file(&self, name: &str, text: &str) -> String {
        let path = self.0.join(name);
        fs::write(&path, text).unwrap();
        path.display().to_string()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn exit(arguments: &[&str]) -> Exit {
    run(["yieldwall", "-q", "--json"].into_iter().chain(arguments.iter().copied()).map(OsString::from))
}

/// A shipped rig that can lie in any folder.
fn text_of(name: &str) -> String {
    let text = builtin(name).read().unwrap().to_string();
    text.replace("simulation: simulations/", "simulation: builtin:simulations/")
        .replace("like: paper", "like: builtin:paper")
}

#[test]
fn three_numbers_change_and_every_other_byte_stays() {
    let folder = Folder::new("bytes");
    for (name, from, to) in [
        ("paper-admittance.yaml", "stiffness_n_m_per_rad: 10000.0\n", "stiffness_n_m_per_rad: 3e4   # too stiff\r\n"),
        ("paper-admittance.yaml", "law: psmc  ", "law: pid   "),
        ("paper-admittance-cartesian.yaml", "like: builtin:", "like: builtin:"),
    ] {
        let text = text_of(name);
        assert!(text.contains(from), "{name}: {from}");
        let before = text.replace(from, to);
        let rig = folder.file("rig.yaml", &before);
        let old = load_rig(Source::disk(&rig)).unwrap().value;
        assert_eq!(exit(&["tune", "gains", &rig]), Exit::Ok);
        assert_eq!(fs::read_to_string(&rig).unwrap(), before, "nothing is written without being asked to");
        assert_eq!(exit(&["tune", "gains", &rig, "--write", "--yes"]), Exit::Ok);
        let after = fs::read_to_string(&rig).unwrap();
        let words = |text: &str| {
            let kept = |word: &&str| word.trim_end_matches([',', '}']).parse::<f64>().is_err();
            text.split(' ').filter(kept).map(str::to_owned).collect::<Vec<_>>()
        };
        assert_eq!(words(&before).len(), words(&after).len());
        let differ: Vec<_> = before.split('\n').zip(after.split('\n')).filter(|(one, other)| one != other).collect();
        assert!((1..=3).contains(&differ.len()) && before.lines().count() == after.lines().count(), "{differ:?}");
        for (one, other) in differ {
            let comment = |line: &str| line.split_once('#').map(|(_, comment)| comment.to_owned());
            assert_eq!(comment(one), comment(other));
            assert!(one.contains("_per_rad") || one.contains("_per_m"), "{one}");
        }
        let new = load_rig(Source::disk(&rig)).unwrap().value;
        let found = pose_margins(&new).unwrap().unwrap();
        assert!(has_margins(&found.worst.without_friction, PROPOSED_MARGINS), "{name}: {found:?}");
        let mut same = new.clone();
        same.control.gains = old.control.gains;
        assert!(same == old && new.control.gains != old.control.gains);
        assert_eq!(fs::read_dir(&folder.0).unwrap().count(), 1, "nothing is left beside it");
    }
}

#[test]
fn a_variant_gets_gains_of_its_own_or_the_lines_to_write() {
    let folder = Folder::new("variant");
    let base = text_of("paper-admittance.yaml");
    folder.file("base.yaml", &base);
    let variant = "like: base.yaml # the other\nrig: {name: mine}";
    let rig = folder.file("rig.yaml", variant);
    assert_eq!(exit(&["tune", "gains", &rig, "--write", "--yes"]), Exit::Ok);
    let after = fs::read_to_string(&rig).unwrap();
    assert!(after.starts_with(variant) && after.contains("control:\n  gains:\n    joint:\n"), "{after}");
    let found = pose_margins(&load_rig(Source::disk(&rig)).unwrap().value).unwrap().unwrap();
    assert!(has_margins(&found.worst.without_friction, PROPOSED_MARGINS), "{found:?}");
    // Once more it is its own, and stays what it is.
    assert_eq!(exit(&["tune", "gains", &rig, "--write", "--yes"]), Exit::Ok);
    assert_eq!(fs::read_to_string(&rig).unwrap().matches("control:").count(), 1);
    let other = "like: base.yaml\ncontrol: {law: pid}\n";
    let rig = folder.file("rig.yaml", other);
    assert_eq!(exit(&["tune", "gains", &rig]), Exit::Ok);
    assert_eq!(exit(&["tune", "gains", &rig, "--write", "--yes"]), Exit::Usage);
    assert_eq!(fs::read_to_string(&rig).unwrap(), other);
    let own = "like: base.yaml\ncontrol: {gains: {joint: {stiffness_n_m_per_rad: 2e4, damping_n_m_s_per_rad: 95, integral_n_m_per_rad_s: 1e5}}}\n";
    let rig = folder.file("rig.yaml", own);
    assert_eq!(exit(&["tune", "gains", &rig, "--write", "--yes"]), Exit::Ok);
    let after = fs::read_to_string(&rig).unwrap();
    assert!(
        after.starts_with("like: base.yaml\ncontrol: {gains: {joint: {stiffness_n_m_per_rad: ")
            && after.ends_with("}}}\n")
    );
    assert_eq!(fs::read_to_string(folder.0.join("base.yaml")).unwrap(), base);
}

#[test]
fn what_cannot_be_replaced_is_left_alone() {
    let folder = Folder::new("alone");
    let text = text_of("paper-admittance.yaml")
        .replace("coulomb_n_m: [8.0, 8.0]", "coulomb_n_m: [&b 8.0, 8.0]")
        .replace("joint: ", "joint:  ");
    assert!(text.contains("&b"));
    // The gains stand before the anchor in the file: an alias needs it first.
    let text = text.replace("handle_mass_kg: 0.0", "handle_mass_kg: &b 0.0").replace("[&b 8.0", "[8.0");
    let text = text.replace("integral_n_m_per_rad_s: 150000.0", "integral_n_m_per_rad_s: *b");
    let rig = folder.file("rig.yaml", &text);
    assert_eq!(exit(&["tune", "gains", &rig, "--write", "--yes"]), Exit::Usage);
    assert_eq!(fs::read_to_string(&rig).unwrap(), text);
    assert_eq!(exit(&["tune", "gains", "builtin:paper-admittance.yaml"]), Exit::Ok);
    assert_eq!(exit(&["tune", "gains", "builtin:paper-admittance.yaml", "--write", "--yes"]), Exit::Usage);
    assert_eq!(exit(&["tune", "gains", "builtin:paper-admittance-csp.yaml"]), Exit::Usage);
}

#[test]
fn a_rate_gain_is_the_greatest_without_overshoot() {
    let folder = Folder::new("rate");
    let rig = folder.file("rig.yaml", &text_of("paper-admittance-csv.yaml"));
    assert_eq!(exit(&["tune", "gains", &rig, "--write", "--yes"]), Exit::Ok);
    let text = fs::read_to_string(&rig).unwrap();
    assert!(text.contains("gain_per_s: 250.0 "), "{text}");
    assert_eq!(exit(&["--deny-warnings", "config", "check", &rig]), Exit::Ok);
}
