//! Device descriptions (ESI) that vendors have written, read here and by the XML reader of Python: the same devices, and an SII image of each that
//! reads as the description.
//!
//! `hil-tests/run --all` fetches them and runs this; alone:
//! `YIELDWALL_DEVICE_DESCRIPTIONS=$(hil-tests/peers/device_descriptions) YIELDWALL_PYTHON=python3 cargo test -p hil-tests --test scenarios
//! device_descriptions:: -- --ignored`

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::{Value as Json, json};
use yieldwall::ethercat::sii::{PortUse, Sii};
use yieldwall::service::{ImageError, LeftOutOfImage, described_image};
use yieldwall_drives::esi::{Device, Esi, EsiError, ModuleError, Pdo};

fn named(variable: &str) -> PathBuf {
    std::env::var_os(variable).map(PathBuf::from).unwrap_or_else(|| panic!("{variable} is not set"))
}

/// The devices that Python reads in a file.
fn of_python(path: &Path) -> Json {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/device_descriptions.py");
    let seen = Command::new(named("YIELDWALL_PYTHON")).arg(script).arg(path).output().unwrap();
    assert!(seen.status.success(), "{}", String::from_utf8_lossy(&seen.stderr));
    let mut all: Vec<Json> = serde_json::from_slice(&seen.stdout).unwrap();
    all.remove(0)
}

fn pdos(pdos: &[Pdo]) -> Json {
    let entries = |pdo: &Pdo| -> Vec<Json> {
        pdo.entries.iter().map(|entry| json!([entry.index, entry.sub, entry.bits])).collect()
    };
    pdos.iter().map(|pdo| json!([pdo.index, entries(pdo)])).collect()
}

fn document(device: &Device) -> Json {
    let managers = device.sync_managers.iter().map(|own| json!([own.start, own.control, own.kind]));
    json!({
        "type": device.type_name,
        "product": device.product_code,
        "revision": device.revision,
        "managers": managers.collect::<Vec<_>>(),
        "outputs": pdos(&device.rx_pdos),
        "inputs": pdos(&device.tx_pdos),
        "configuration": device.config_data,
    })
}

/// The letter of a port in a description.
fn letter(port: PortUse) -> char {
    match port {
        PortUse::MII => 'Y',
        PortUse::EBUS => 'K',
        PortUse::FAST_HOT_CONNECT => 'H',
        _ => ' ',
    }
}

/// Whether a description makes an image; it then reads as the device.
fn has_image(esi: &Esi, device: &Device) -> bool {
    let made = match described_image(esi, device, 0, 7) {
        Ok(made) => made,
        Err(ImageError::NoConfiguration) if device.config_data.is_empty() => return false,
        Err(error) => panic!("{}: {error}", device.type_name),
    };
    let sii = Sii::read(&made.image).unwrap();
    let who = (sii.vendor_id, sii.product_code, sii.revision, sii.serial);
    assert_eq!(who, (esi.vendor_id, device.product_code, device.revision, 7), "{}", device.type_name);
    assert_eq!(sii.warnings, [], "{}", device.type_name);
    assert_eq!(sii.sync_managers.len(), device.sync_managers.len(), "{}", device.type_name);
    let letters: String = sii.ports.iter().map(|port| letter(*port)).collect();
    assert_eq!(letters.trim_end(), device.physics.trim_end(), "{}", device.type_name);
    let has_slots = made.left_out.contains(&LeftOutOfImage::Modules);
    assert_eq!(has_slots, !device.slots.is_empty(), "{}", device.type_name);
    if !made.left_out.contains(&LeftOutOfImage::ProcessData) {
        let bits =
            |pdos: &[Pdo]| pdos.iter().flat_map(|pdo| &pdo.entries).map(|entry| u32::from(entry.bits)).sum::<u32>();
        let held = sii.rx_pdos.iter().chain(&sii.tx_pdos).flat_map(|pdo| &pdo.entries);
        let held: u32 = held.map(|entry| u32::from(entry.bits)).sum();
        assert_eq!(held, bits(&device.rx_pdos) + bits(&device.tx_pdos), "{}", device.type_name);
    }
    true
}

/// The modules of a coupler whose slots have no default: refused by name, and one step of objects and PDOs further on in the second slot.
fn check_modules(esi: &Esi, device: &Device) {
    let refused = esi.plugged(device, &BTreeMap::new());
    assert!(matches!(refused, Err(ModuleError::Several { place: 1, .. })), "{}: {refused:?}", device.type_name);
    let named = [1, 2].into_iter().zip(&esi.modules).map(|(place, module)| (place, module.type_name.clone()));
    let plugged = esi.plugged(device, &named.collect()).unwrap();
    let whole = device.with_modules(&plugged).unwrap();
    let [first, second] = [0, 1].map(|at| &esi.modules[at]);
    let added = &whole.tx_pdos[device.tx_pdos.len()..];
    let expected = [first.tx_pdos[0].index, second.tx_pdos[0].index + device.slots[0].pdo_increment];
    assert_eq!([added[0].index, added[first.tx_pdos.len()].index], expected, "{}", device.type_name);
    let objects = [&second.tx_pdos[0], &added[first.tx_pdos.len()]].map(|pdo| pdo.entries[0].index);
    assert_eq!(objects[1], objects[0] + device.slots[0].index_increment, "{}", device.type_name);
}

#[test]
#[ignore = "needs Python and the descriptions: hil-tests/run --all fetches them"]
fn descriptions_of_vendors_are_read_as_python_reads_them_and_make_images() {
    let folder = std::fs::read_dir(named("YIELDWALL_DEVICE_DESCRIPTIONS")).unwrap();
    let mut paths: Vec<PathBuf> = folder.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    assert!(paths.len() >= 4, "{paths:?}");
    let (mut images, mut couplers) = (0, 0);
    for path in paths {
        let shown = path.display();
        let (esi, theirs) = (Esi::read(&std::fs::read(&path).unwrap()), of_python(&path));
        // A description of modules has no devices, and is refused as none of a device.
        if theirs["root"] != "EtherCATInfo" {
            assert_eq!((esi, &theirs["devices"]), (Err(EsiError::NoDescription), &json!([])), "{shown}");
            continue;
        }
        let esi = esi.unwrap_or_else(|error| panic!("{shown}: {error}"));
        assert_eq!(json!(esi.vendor_id), theirs["vendor"], "{shown}");
        let ours: Vec<Json> = esi.devices.iter().map(document).collect();
        assert_eq!(json!(ours), theirs["devices"], "{shown}");
        let made = esi.devices.iter().filter(|device| has_image(&esi, device)).count();
        for device in esi.devices.iter().filter(|device| !device.slots.is_empty()) {
            check_modules(&esi, device);
            couplers += 1;
        }
        println!("{shown}: {} devices, {made} images", ours.len());
        images += made;
    }
    assert!(images >= 20 && couplers >= 2, "{images} {couplers}");
}
