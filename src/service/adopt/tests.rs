//! A device of modules, adopted by its device description.

use std::collections::BTreeMap;
use std::time::Duration;

use yieldwall_drives::esi::Esi;
use yieldwall_drives::profiles::Fieldbus;
use yieldwall_fieldbus::objects::{AbortCode, Address};
use yieldwall_fieldbus::time::Time;

use super::{Carrier, Refusal, StandingPdo, Survey, TrialAccess, contradictions, originals, profile, survey};
use crate::Bytes;
use crate::connection::Error;
use crate::object_access::ObjectAccess;

/// The module is in the second slot; its process data lie 20h further on and are exchanged by default.
const MODULAR: &str = r##"<EtherCATInfo><Vendor><Id>1</Id></Vendor><Descriptions>
  <Devices><Device><Type ProductCode="2" RevisionNo="1">M</Type>
    <Slots SlotPdoIncrement="#x20"><Slot MinInstances="0"><Name>Option</Name></Slot>
      <Slot MinInstances="1"><Name>Axis</Name><ModuleIdent>7</ModuleIdent></Slot></Slots>
  </Device></Devices>
  <Modules><Module><Type ModuleIdent="7">Position</Type>
    <RxPdo Sm="2" Fixed="1"><Index DependOnSlot="1">#x1600</Index>
      <Entry><Index>#x6040</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry></RxPdo>
    <RxPdo Sm="2" Fixed="1"><Index DependOnSlot="1">#x1601</Index>
      <Entry><Index>#x607A</Index><SubIndex>0</SubIndex><BitLen>32</BitLen></Entry></RxPdo>
    <TxPdo Sm="3" Fixed="1"><Index DependOnSlot="1">#x1A00</Index>
      <Entry><Index>#x6041</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry>
      <Entry><Index>#x6064</Index><SubIndex>0</SubIndex><BitLen>32</BitLen></Entry></TxPdo>
  </Module></Modules></Descriptions></EtherCATInfo>"##;

/// A device at rest that exchanges no process data yet. Its mappings are read only.
struct Modular {
    objects: BTreeMap<(u16, u8), Vec<u8>>,
    now: Time,
}

impl Modular {
    fn new() -> Self {
        let mut objects: BTreeMap<(u16, u8), Vec<u8>> = BTreeMap::new();
        for (index, sub, value) in [
            (0x1000, 0, 0x0002_0192_u32),
            (0x6064, 0, 0),
            (0x607a, 0, 0),
            (0x6502, 0, 0x80),
            (0x1620, 1, 0x6040_0010),
            (0x1621, 1, 0x607a_0020),
            (0x1a20, 1, 0x6041_0010),
            (0x1a20, 2, 0x6064_0020),
        ] {
            objects.insert((index, sub), value.to_le_bytes().to_vec());
        }
        for (index, value) in [(0x6040, 0_u16), (0x6041, 0x0040)] {
            objects.insert((index, 0), value.to_le_bytes().to_vec());
        }
        for (index, value) in
            [(0x6060, 0), (0x6061, 0), (0x1620, 1), (0x1621, 1), (0x1a20, 2), (0x1c12, 0), (0x1c13, 0)]
        {
            objects.insert((index, 0), vec![value]);
        }
        Self { objects, now: Time(0) }
    }
}

impl ObjectAccess for Modular {
    fn read(&mut self, at: Address) -> Result<Bytes, Error> {
        self.objects.get(&(at.index, at.sub)).cloned().ok_or(Error::Refused(AbortCode::NO_OBJECT))
    }

    fn write(&mut self, at: Address, value: &[u8]) -> Result<(), Error> {
        if matches!(at.index, 0x1600..0x1c00) {
            return Err(Error::Refused(AbortCode::READ_ONLY));
        }
        *self.objects.get_mut(&(at.index, at.sub)).ok_or(Error::Refused(AbortCode::NO_OBJECT))? = value.to_vec();
        if at.index == 0x6060 {
            self.objects.insert((0x6061, 0), value.to_vec());
        }
        Ok(())
    }
}

impl TrialAccess for Modular {
    fn bus(&self) -> Fieldbus {
        Fieldbus::Ethercat
    }

    fn node_id(&self) -> u8 {
        0
    }

    fn check_rest(&mut self) -> Result<(), Refusal> {
        Ok(())
    }

    fn bring_to_rest(&mut self) -> Result<(), Error> {
        Ok(())
    }

    fn now(&self) -> Time {
        self.now
    }

    fn wait(&mut self, time: Duration) -> Result<(), Error> {
        self.now = self.now + time;
        Ok(())
    }

    fn finish(&mut self) {}
}

/// The device adopted, by a description or without one.
fn adopted(text: Option<&str>) -> Result<Survey, Refusal> {
    let mut device = Modular::new();
    let values = originals(&mut device).unwrap();
    let described = text.map(|text| {
        let esi = Esi::read(text.as_bytes()).unwrap();
        esi.devices[0].with_modules(&esi.plugged(&esi.devices[0], &BTreeMap::new()).unwrap()).unwrap()
    });
    let found = survey(&mut device, &values, None, described.as_ref());
    assert_eq!(device.objects, Modular::new().objects, "all objects have their values again");
    found
}

#[test]
fn process_data_of_a_module_are_found_by_the_slot_of_the_description() {
    let found = adopted(Some(MODULAR)).unwrap();
    let fixed = |is_tpdo, number, entries: &[u32]| {
        Carrier::Fixed(StandingPdo { is_tpdo, number, entries: entries.to_vec(), is_assigned: true })
    };
    assert_eq!(found.rpdos, [[fixed(false, 33, &[0x6040_0010]), fixed(false, 34, &[0x607a_0020])]]);
    assert_eq!(found.tpdos, [fixed(true, 33, &[0x6041_0010, 0x6064_0020])]);
    assert_eq!(contradictions(None, &found), [""; 0]);
    let (text, _) = profile(&found, None, "found", "0");
    assert!(
        text.contains("{number: 33, fixed: true, transmission_type: 1, maps: [controlword]}, {number: 34,"),
        "{text}"
    );
    // Its indices are none that makers often use.
    assert!(matches!(adopted(None), Err(Refusal::NoMode(..))));
}

#[test]
fn a_description_of_another_module_contradicts_the_device_whose_word_counts() {
    let other = MODULAR.replace("#x6064", "#x6063").replace("#x1601", "#x1602");
    let found = adopted(Some(&other)).unwrap_err();
    assert!(matches!(found, Refusal::NoMode(..)), "its target is at no index of the description");
    let found = adopted(Some(&MODULAR.replace("#x6064", "#x6063"))).unwrap();
    let lines = contradictions(None, &found);
    assert_eq!(
        lines,
        ["1A20h maps 6041h:0/16 6063h:0/32 by the device description, 6041h:0/16 6064h:0/32 by the drive"]
    );
    let (text, _) = profile(&found, None, "found", "0");
    assert!(text.contains(&format!("# - {}\n", lines[0])), "{text}");
    let more = MODULAR.replace(
        "<TxPdo",
        "<TxPdo><Index>#x1AFF</Index><Entry><Index>#x6077</Index><BitLen>16</BitLen></Entry></TxPdo><TxPdo",
    );
    let lines = contradictions(None, &adopted(Some(&more)).unwrap());
    assert_eq!(lines, ["1AFFh: in the device description, and the drive maps nothing there"]);
}
