//! Names that are planted, and every byte of the zip.

use std::fs;
use std::io::Read;

use super::contents::{Content, Entry, Folders, contents};
use super::strip::Stripper;
use super::{stripped, zipped};
use yieldwall_record::CycleRecord;
use yieldwall_record::recording::{About, BlackBox, Machine, Recorded, Writer};

const USER: &str = "wilhelmina";
const HOST: &str = "benchbox-17";
const SERIAL: &str = "88776655";

fn folder(name: &str) -> std::path::PathBuf {
    let path = std::env::temp_dir().join(format!("yieldwall-report-{name}-{}", std::process::id()));
    fs::create_dir_all(&path).unwrap();
    path
}

/// A black box of a rig whose description has names in it.
fn black_box(path: &std::path::Path) {
    let text = format!("# by {USER} on {HOST}\nrig: {{name: planted}}\nprofile: /home/{USER}/own.yaml\n");
    let about = About {
        machine: Machine::Rig(text.clone()),
        scene: text.clone(),
        profiles: [(format!("/home/{USER}/own.yaml"), text)].into(),
        overrides: format!("--figure /home/{USER}/a.svg"),
        commit: format!("abc-{HOST}"),
        ..About::default()
    };
    let mut writer: Writer<_, CycleRecord> = Writer::new(fs::File::create(path).unwrap(), &about).unwrap();
    for _ in 0..10 {
        writer.write(&CycleRecord::blank()).unwrap();
    }
    writer.finish().unwrap();
}

/// Every file of a zip, with its name.
fn unzipped(zip: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut archive = zip::ZipArchive::new(std::io::Cursor::new(zip)).unwrap();
    (0..archive.len())
        .map(|index| {
            let mut file = archive.by_index(index).unwrap();
            let mut bytes = Vec::new();
            file.read_to_end(&mut bytes).unwrap();
            (file.name().unwrap().into_owned(), bytes)
        })
        .collect()
}

fn has(bytes: &[u8], word: &str) -> bool {
    let wide: Vec<u8> = word.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let lower = bytes.to_ascii_lowercase();
    lower.windows(word.len()).any(|part| part == word.as_bytes()) || lower.windows(wide.len()).any(|part| part == wide)
}

#[test]
fn no_name_is_in_any_byte_of_the_zip() {
    let home = folder("names").join(USER);
    let state = home.join("state");
    fs::create_dir_all(state.join("drills")).unwrap();
    let scene = format!("# {USER}'s hand\n{}", yieldwall_config::builtin("scenes/circle-tour.yaml").read().unwrap());
    let profile = yieldwall_drives::profiles::SHIPPED.iter().find(|(name, _)| *name == "simulated-servo").unwrap().1;
    let rig = format!(
        "# {USER} made this on {HOST}, for a drive with the serial number {SERIAL}\nlike: base.yaml\nrig: {{name: planted}}\n\
         drives:\n  - {{name: left, profile: {USER}-servo.yaml}}\n"
    );
    let base = yieldwall_config::builtin("paper-admittance.yaml").read().unwrap().to_string();
    let simulation = yieldwall_config::builtin("simulations/paper-arm.yaml").read().unwrap();
    for (name, text) in [
        ("scene.yaml", scene),
        (&format!("{USER}-servo.yaml"), format!("# {HOST}\n{profile}")),
        ("rig.yaml", rig),
        ("base.yaml", base.replace("simulations/paper-arm.yaml", "simulation.yaml")),
        ("simulation.yaml", simulation.replace("../scenes/circle-tour.yaml", "scene.yaml")),
        ("state/drills/0.json", format!("{{\"drives\": [{{\"serial_number\": {SERIAL}, \"product_code\": 4}}]}}")),
    ] {
        fs::write(home.join(name), text).unwrap();
    }
    black_box(&state.join("planted-000001.black-box.mcap"));
    black_box(&state.join("planted-000003.black-box.mcap"));
    black_box(&state.join("other-000009.black-box.mcap"));
    let folders = Folders { black_boxes: state.clone(), drills: state.join("drills"), latency: state.join("latency") };
    let messages = format!("error: {}/rig.yaml:3: drive {SERIAL} at {HOST}: {USER}", home.display());
    let path = home.join("rig.yaml").display().to_string();
    let of = |with_serials: bool| {
        let found = contents(Some(&path), Some(messages.clone()), &folders);
        let [users, hosts] = [USER, HOST].map(|name| vec![name.to_owned()]);
        let stripper = Stripper::new(&users, &hosts, &[home.display().to_string()], with_serials, &found);
        let (entries, left_out) = stripped(found, &stripper);
        assert!(left_out.is_empty(), "{left_out:?}");
        let zip = zipped(&entries).unwrap();
        (unzipped(&zip), zip)
    };
    let (files, zip) = of(false);
    let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
    for wanted in [
        "version.txt",
        "doctor.txt",
        "messages.txt",
        "config-check.txt",
        "config-show.yaml",
        "black-box.mcap",
        "config/1-rig.yaml",
        "drills/0.json",
    ] {
        assert!(names.contains(&wanted), "{wanted}: {names:?}");
    }
    for part in ["base.yaml", "simulation.yaml", "scene.yaml", "USER-servo.yaml"] {
        assert!(names.iter().any(|name| name.ends_with(part)), "{part}: {names:?}");
    }
    let whole = [("the zip".to_owned(), zip)];
    for (name, bytes) in files.iter().chain(&whole) {
        for word in [USER, HOST, SERIAL] {
            assert!(!has(bytes, word) && !has(name.as_bytes(), word), "{word} in {name}");
        }
    }
    // What was recorded is still there, and can be read.
    let mcap = &files.iter().find(|(name, _)| name == "black-box.mcap").unwrap().1;
    let mut reader: yieldwall_record::recording::Reader<_> =
        yieldwall_record::recording::Reader::new(mcap.as_slice()).unwrap();
    assert!(reader.about().scene.contains("by USER on HOST"), "{:?}", reader.about());
    let mut cycles = 0;
    while reader.next_record().unwrap().is_some() {
        cycles += 1;
    }
    assert!(cycles == 10 && reader.damage().is_empty());
    // Asked for, serial numbers stay, and nothing else does.
    let (files, _) = of(true);
    assert!(files.iter().any(|(name, bytes)| name.starts_with("drills/") && has(bytes, SERIAL)));
    assert!(files.iter().all(|(_, bytes)| !has(bytes, USER) && !has(bytes, HOST)));
    // The test can fail: without names to take out they are found.
    let found = contents(Some(&path), Some(messages), &folders);
    let (entries, _) = stripped(found, &Stripper::default());
    assert!(entries.iter().any(|(_, bytes)| has(bytes, HOST)));
    let _ = fs::remove_dir_all(home.parent().unwrap());
}

#[test]
fn a_rig_that_is_refused_is_in_its_report_with_what_is_wrong() {
    let folder = folder("refused");
    let rig = folder.join("rig.yaml");
    fs::write(&rig, "like: builtin:paper-admittance.yaml\nrig: {nmae: x}\n").unwrap();
    let folders = Folders { black_boxes: folder.clone(), drills: folder.clone(), latency: folder.clone() };
    let found = contents(Some(&rig.display().to_string()), None, &folders);
    let text = |name: &str| {
        found.iter().find(|entry| entry.name == name).map(|entry| match &entry.content {
            Content::Text(text) => text.clone(),
            Content::Recording(_) => String::new(),
        })
    };
    assert!(text("config/1-rig.yaml").unwrap().contains("nmae"));
    assert!(text("config-check.txt").unwrap().contains("nmae"));
    assert!(text("config-show.yaml").is_none());
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn what_cannot_be_read_is_told_and_the_rest_is_there() {
    let entries = vec![
        Entry { name: "black-box.mcap".into(), content: Content::Recording("no-such-file.mcap".into()) },
        Entry { name: "a.txt".into(), content: Content::Text("a".into()) },
    ];
    let (entries, left_out) = stripped(entries, &Stripper::default());
    assert_eq!((entries.len(), left_out.len()), (1, 1));
    assert_eq!(unzipped(&zipped(&entries).unwrap()), [("a.txt".to_owned(), b"a".to_vec())]);
}

/// The newest black box is that with the greatest number, of this rig and no other.
#[test]
fn black_boxes_are_told_by_the_name_of_the_rig() {
    let folder = folder("boxes");
    for name in ["a-000001", "a-000010", "a-b-000020", "b-000030", "a-1"] {
        fs::write(folder.join(format!("{name}.black-box.mcap")), "").unwrap();
    }
    let names: Vec<_> = BlackBox::files_of(&folder, "a")
        .iter()
        .filter_map(|path| Some(path.file_name()?.to_str()?.to_owned()))
        .collect();
    assert_eq!(names, ["a-000010.black-box.mcap", "a-000001.black-box.mcap"]);
    fs::remove_dir_all(&folder).unwrap();
}
