//! The PDOs of a drive: its mappings as they stand, and those that carry what a mode needs.

use yieldwall_drives::cia402::OperationMode;
use yieldwall_drives::esi;
use yieldwall_drives::objects::{self as cia, Object as Standard};

use super::{ObjectReading, Probe};
use crate::connection::Error;
use crate::scan::number;
use yieldwall_fieldbus::objects::Address;

/// Bit 31 of a COB-ID.
const NOT_USED: u32 = 0x8000_0000;
/// PDO 1 of each direction: communication and mapping parameter, and what is assigned on EtherCAT.
pub(super) const RPDO: Direction = Direction { communication: 0x1400, mapping: 0x1600, assignment: 0x1c12 };
pub(super) const TPDO: Direction = Direction { communication: 0x1800, mapping: 0x1a00, assignment: 0x1c13 };
/// PDOs of a direction that have identifiers, and those that EtherCAT has indices for.
pub(super) const PDOS: u16 = 4;
const ETHERCAT_PDOS: u16 = 512;
/// Bits that a PDO carries.
const PDO_BITS: u32 = 64;
/// Most entries of a mapping that are looked for.
pub(super) const MOST_MAPPED: u8 = 64;
/// A byte that an RPDO skips: the type UNSIGNED8 mapped.
pub(super) const DUMMY: u32 = 0x0005_0008;

/// The objects of PDOs of one direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Direction {
    pub(super) communication: u16,
    pub(super) mapping: u16,
    pub(super) assignment: u16,
}

/// Mappings in words.
pub(super) fn mapped(pdos: &[StandingPdo]) -> String {
    let one = |pdo: &StandingPdo| format!("{:04X}h maps {}", pdo.mapping(), listed(&pdo.entries));
    pdos.iter().map(one).collect::<Vec<_>>().join(", ")
}

/// Entries of a mapping in words.
fn listed(entries: &[u32]) -> String {
    let entry = |raw: &u32| format!("{:04X}h:{}/{}", raw >> 16, raw >> 8 & 0xff, raw & 0xff);
    let entries: Vec<String> = entries.iter().map(entry).collect();
    if entries.is_empty() { "nothing".to_owned() } else { entries.join(" ") }
}

/// Entries of a process data object of a device description, as a mapping holds them.
fn described_entries(pdo: &esi::Pdo) -> Vec<u32> {
    let raw = |entry: &esi::PdoEntry| {
        u32::from(entry.index) << 16 | u32::from(entry.sub) << 8 | u32::from(entry.bits.min(0xff))
    };
    pdo.entries.iter().map(raw).collect()
}

/// A PDO as the device has it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StandingPdo {
    /// Whether the device sends it.
    pub is_tpdo: bool,
    /// Its number: 1 to 4 on CANopen, 1 to 512 on EtherCAT.
    pub number: u16,
    /// Its mapped objects as 16xxh and 1Axxh hold them.
    pub entries: Vec<u32>,
    /// Whether it is exchanged now, on EtherCAT; by the device description where the drive exchanges none yet.
    pub is_assigned: bool,
}

impl StandingPdo {
    fn direction(&self) -> Direction {
        if self.is_tpdo { TPDO } else { RPDO }
    }

    pub(super) fn mapping(&self) -> u16 {
        self.direction().mapping + self.number - 1
    }
}

/// A PDO that carries what a mode needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Carrier {
    /// The first one, whose mapping takes it.
    Writable,
    /// A PDO that carries the object and takes no other mapping.
    Fixed(StandingPdo),
}

impl Carrier {
    pub(super) fn communication(&self, direction: Direction) -> u16 {
        match self {
            Carrier::Writable => direction.communication,
            Carrier::Fixed(pdo) => direction.communication + pdo.number - 1,
        }
    }
}

impl Probe<'_> {
    /// The PDOs by which a mode gets its set-point, or why there are none.
    pub(super) fn rpdo(
        &mut self,
        mode: OperationMode,
        set_point: Standard,
        of: &dyn Fn(Address) -> Option<u32>,
    ) -> Result<Result<Vec<Carrier>, &'static str>, Error> {
        if self.has(set_point)?.is_none() {
            return Ok(Err("its set-point is not there"));
        }
        if self.survey.tpdos.is_empty() {
            return Ok(Err("statusword and position do not go into one TPDO"));
        }
        let carriers = self.carriers(RPDO, of, [cia::CONTROLWORD, set_point])?;
        if carriers.is_empty() {
            return Ok(Err("controlword and set-point do not go into one RPDO"));
        }
        let takes_mode = self.takes_mode(mode)?;
        Ok(if takes_mode { Ok(carriers) } else { Err("it does not take the mode in Switch On Disabled") })
    }

    /// The mappings that the device has. Nothing is written.
    pub(super) fn read_mappings(&mut self) -> Result<(), Error> {
        let is_on_ethercat = self.survey.is_on_ethercat;
        for (is_tpdo, Direction { mapping, assignment, .. }) in [(false, RPDO), (true, TPDO)] {
            let described = self.description.map(|device| if is_tpdo { &device.tx_pdos } else { &device.rx_pdos });
            let described = described.map_or(&[][..], |pdos| pdos);
            let mut assigned = Vec::new();
            let mut numbers: Vec<u16> = (1..=PDOS).collect();
            if is_on_ethercat {
                assigned = self.list(assignment)?.into_iter().map(|index| index as u16).collect();
                if assigned.is_empty() && self.value(Address::new(assignment, 0))? == Some(0) {
                    let by_default = described.iter().filter(|pdo| pdo.sync_manager.is_some());
                    assigned = by_default.map(|pdo| pdo.index).collect();
                }
                // Numbers of the standard, and others that makers often use.
                numbers = (1..=8).chain(0x101..=0x108).collect();
                let more = assigned.iter().copied().chain(described.iter().map(|pdo| pdo.index));
                let more = more.filter_map(|index| index.checked_sub(mapping - 1));
                numbers.extend(more.filter(|number| (1..=ETHERCAT_PDOS).contains(number)));
                numbers.sort_unstable();
                numbers.dedup();
            }
            for number in numbers {
                let index = mapping + number - 1;
                let entries = self.list(index)?;
                if let Some(pdo) = described.iter().find(|pdo| pdo.index == index) {
                    self.compare(pdo, &entries);
                }
                if !entries.is_empty() {
                    let is_assigned = assigned.contains(&index);
                    self.standing.push(StandingPdo { is_tpdo, number, entries, is_assigned });
                }
            }
        }
        Ok(())
    }

    /// Compares a process data object of the device description with the mapping that the drive has.
    fn compare(&mut self, pdo: &esi::Pdo, entries: &[u32]) {
        let (index, described) = (pdo.index, described_entries(pdo));
        let line = match entries {
            [] if !described.is_empty() => {
                format!("{index:04X}h: in the device description, and the drive maps nothing there")
            }
            _ if pdo.is_fixed && described != entries => {
                let [described, own] = [&described, entries].map(listed);
                format!("{index:04X}h maps {described} by the device description, {own} by the drive")
            }
            _ => return,
        };
        self.survey.pdo_contradictions.push(line);
    }

    /// The entries of a list whose length is at sub-index 0; none if the device does not have it.
    fn list(&mut self, index: u16) -> Result<Vec<u32>, Error> {
        let count = self.value(Address::new(index, 0))?.unwrap_or_default() & 0xff;
        let mut entries = Vec::new();
        for sub in 1..=count.min(MOST_MAPPED.into()) as u8 {
            entries.extend(self.value(Address::new(index, sub))?);
        }
        Ok(entries)
    }

    pub(super) fn value(&mut self, at: Address) -> Result<Option<u32>, Error> {
        match self.objects.read(at) {
            Ok(bytes) => Ok(Some(number(&bytes))),
            Err(Error::Refused(_) | Error::Senseless(_)) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Returns the PDOs that carry two objects, and takes them out of use. It takes the first PDO if its mapping accepts the
    /// objects, otherwise a PDO that already carries them. On EtherCAT the last choice is all PDOs that are exchanged.
    pub(super) fn carriers(
        &mut self,
        direction: Direction,
        of: &dyn Fn(Address) -> Option<u32>,
        objects: [Standard; 2],
    ) -> Result<Vec<Carrier>, Error> {
        let wanted = objects.map(mapping_entry);
        let is_out = self.takes_out_of_use(direction, direction.communication, of)?;
        if is_out && self.maps(direction.mapping, &wanted)? {
            return Ok(vec![Carrier::Writable]);
        }
        let of_direction: Vec<StandingPdo> =
            self.standing.iter().filter(|pdo| pdo.direction() == direction).cloned().collect();
        let carries =
            |pdos: &[StandingPdo]| wanted.iter().all(|entry| pdos.iter().any(|pdo| pdo.entries.contains(entry)));
        if self.survey.is_on_ethercat {
            let assigned: Vec<StandingPdo> = of_direction.iter().filter(|pdo| pdo.is_assigned).cloned().collect();
            let one = || of_direction.iter().find(|pdo| is_out && carries(std::slice::from_ref(*pdo))).cloned();
            let chosen = if carries(&assigned) { assigned } else { one().into_iter().collect() };
            return Ok(chosen.into_iter().map(Carrier::Fixed).collect());
        }
        let fits = |pdo: &&StandingPdo| pdo.entries.iter().map(|raw| raw & 0xff).sum::<u32>() <= PDO_BITS;
        let Some(pdo) = of_direction.iter().filter(fits).find(|pdo| carries(std::slice::from_ref(*pdo))) else {
            return Ok(Vec::new());
        };
        let carrier = Carrier::Fixed(pdo.clone());
        let is_out = self.takes_out_of_use(direction, carrier.communication(direction), of)?;
        Ok(if is_out { vec![carrier] } else { Vec::new() })
    }

    /// Takes a PDO out of use: on CAN by its identifier, on EtherCAT with all others of its direction.
    fn takes_out_of_use(
        &mut self,
        direction: Direction,
        communication: u16,
        of: &dyn Fn(Address) -> Option<u32>,
    ) -> Result<bool, Error> {
        if self.survey.is_on_ethercat {
            return self.takes(Address::new(direction.assignment, 0), &[0]);
        }
        let identifier = Address::new(communication, 1);
        match of(identifier) {
            Some(cob_id) => self.takes(identifier, &(cob_id | NOT_USED).to_le_bytes()),
            None => Ok(false),
        }
    }

    pub(super) fn maps(&mut self, mapping: u16, entries: &[u32]) -> Result<bool, Error> {
        if !self.takes(Address::new(mapping, 0), &[0])? {
            return Ok(false);
        }
        for (sub, entry) in (1..).zip(entries) {
            let is_mapped = self.takes(Address::new(mapping, sub), &entry.to_le_bytes())?;
            if *entry != DUMMY {
                let mapped = Address::new((entry >> 16) as u16, (entry >> 8) as u8);
                self.survey.told.push((mapped, ObjectReading::Mapped(is_mapped)));
            }
            if !is_mapped {
                return Ok(false);
            }
        }
        self.takes(Address::new(mapping, 0), &[entries.len() as u8])
    }
}

fn mapping_entry(object: Standard) -> u32 {
    u32::from(object.index) << 16 | u32::from(object.sub) << 8 | u32::from(object.bits())
}
