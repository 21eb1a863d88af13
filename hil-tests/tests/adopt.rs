//! A drive that nobody has written a profile of: adopted on the embedded simulation, checked, and run by what was found.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn yieldwall(folder: &Path, line: &str) -> Output {
    Command::new(hil_tests::program())
        .args(line.split(' '))
        .current_dir(folder)
        .env("XDG_STATE_HOME", folder.join("state"))
        .output()
        .unwrap()
}

fn well(folder: &Path, line: &str) -> String {
    let seen = yieldwall(folder, line);
    let [text, said] = [seen.stdout, seen.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    assert_eq!(seen.status.code(), Some(0), "{line}: {text}{said}");
    text
}

#[test]
fn an_adopted_drive_runs_by_its_profile() {
    let folder = Folder(std::env::temp_dir().join(format!("yieldwall-adopt-{}", std::process::id())));
    std::fs::create_dir_all(&folder.0).unwrap();
    well(&folder.0, "drive adopt --node left --out found.yaml --name found");
    // Not over the one that is there.
    assert_eq!(yieldwall(&folder.0, "drive adopt --node left --out found.yaml").status.code(), Some(2));
    well(&folder.0, "config check found.yaml");
    let rig = well(&folder.0, "config show builtin:paper-admittance-csp.yaml");
    assert_eq!(rig.matches("profile: simulated-servo").count(), 2);
    // What the drive cannot tell, a person has to: what its encoder knows at power-on.
    let without = rig.replace("profile: simulated-servo", "profile: found.yaml");
    std::fs::write(folder.0.join("without.yaml"), &without).unwrap();
    let refused = yieldwall(&folder.0, "config check without.yaml");
    assert_eq!(refused.status.code(), Some(3));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("encoder"));
    let with = without.replace("profile: found.yaml", "profile: found.yaml\n  encoder: multi_turn");
    std::fs::write(folder.0.join("with.yaml"), with).unwrap();
    // What shows in Operation Enabled alone counts as missing until somebody has seen it: the simulated drive of such a profile goes on,
    // and its drill refuses it.
    let unseen = yieldwall(&folder.0, "run with.yaml --duration 3");
    assert_eq!(unseen.status.code(), Some(7));
    assert!(String::from_utf8_lossy(&unseen.stderr).contains("set-points stay away"));
    let found = std::fs::read_to_string(folder.0.join("found.yaml")).unwrap();
    assert_eq!(found.matches("reaction: unknown").count(), 1, "{found}");
    std::fs::write(folder.0.join("found.yaml"), found.replace("reaction: unknown", "reaction: fault")).unwrap();
    well(&folder.0, "run with.yaml --duration 3");
}
