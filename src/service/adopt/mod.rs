//! Survey of a drive: requests and trials that find its features, and the device profile that describes them.
//!
//! The survey tries objects in Pre-operational and in Switch On Disabled, with the PDOs out of use; afterwards each object has
//! its value again. Features that show only in Operation Enabled stay unknown. The device is on CAN or on EtherCAT; the two
//! differ in how a PDO is taken out of use.

mod access;
mod process_data;
mod profile;
mod sheet;
#[cfg(test)]
mod tests;

pub use access::TrialAccess;
pub use process_data::{Carrier, StandingPdo};
pub use profile::profile;
pub use sheet::{ObjectReading, contradictions};

use std::time::Duration;

use yieldwall_drives::cia402::{OperationMode, State, Statusword};
use yieldwall_drives::eds::Eds;
use yieldwall_drives::esi::{self, AxisSteps};
use yieldwall_drives::objects::{self as cia, Object as Standard};

use super::connection::Error;
use super::inventory::sheet_of;
use super::restore::{WriteOutcome, carry_out, plan};
use super::scan::{Identity, number};
use process_data::{DUMMY, Direction, MOST_MAPPED, PDOS, RPDO, TPDO, mapped};
use yieldwall_drives::profiles::Fieldbus;
use yieldwall_fieldbus::canopen::NmtState;
use yieldwall_fieldbus::ethercat::AlState;
use yieldwall_fieldbus::objects::{AbortCode, Address};

/// The name that a device gives itself.
const NAME: Address = Address::new(0x1008, 0);
/// How long a drive may take to change its mode.
const MODE_CHANGE: Duration = Duration::from_secs(1);
/// Values that are tried: a time in ms, and the node that a heartbeat is watched of, which nobody has.
const TIMER_MS: u16 = 100;
const WATCHED: u32 = 127 << 16 | 1000;

/// The cyclic synchronous modes with the objects of their set-points.
pub(super) const MODES: [(OperationMode, Standard); 3] = [
    (OperationMode::CyclicTorque, cia::TARGET_TORQUE),
    (OperationMode::CyclicVelocity, cia::TARGET_VELOCITY),
    (OperationMode::CyclicPosition, cia::TARGET_POSITION),
];

/// Why a device cannot be adopted. Nothing of it has changed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// It does not answer as it should.
    #[error(transparent)]
    Service(#[from] Error),
    /// Its type is another one.
    #[error("its type (1000h) is {0:08X}h, and not that of a drive of CiA 402")]
    NoDrive(u32),
    /// It has an error, or is nearer to Operation Enabled than Switch On Disabled.
    #[error("it is in {}, and not in Switch On Disabled", .0.map_or("no state of CiA 402".to_owned(), |state| format!("{state:?}")))]
    State(Option<State>),
    /// Process data run.
    #[error("it is {0:?}, and not in Pre-operational")]
    Nmt(NmtState),
    /// Process data run, or could.
    #[error("it is in {0}, and not in PRE-OP")]
    Al(AlState),
    /// It lacks what no drive does without.
    #[error("it has no {:04X}h:{} ({}), which a master needs", .0.index, .0.sub, .0.meaning)]
    Lacks(Standard),
    /// None of its modes gets its words by process data; the reasons, and the mappings that it has.
    #[error("it has no mode that can be used: {}; {}", reasons(.0), mapped(.1))]
    NoMode(Vec<(OperationMode, &'static str)>, Vec<StandingPdo>),
    /// It does not have its values again.
    #[error("{} of its objects could not be put back: {}", .0.len(), .0.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "))]
    NotRestored(Vec<Address>),
}

fn reasons(modes: &[(OperationMode, &'static str)]) -> String {
    if modes.is_empty() {
        return "6502h names none of the cyclic synchronous ones".to_owned();
    }
    modes.iter().map(|(mode, reason)| format!("{mode:?}: {reason}")).collect::<Vec<_>>().join(", ")
}

/// Abilities of a drive, as far as they show in Switch On Disabled.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Survey {
    /// Whether it is on EtherCAT.
    pub is_on_ethercat: bool,
    /// 1000h.
    pub device_type: u32,
    /// 1018h:1 to 4.
    pub identity: [Option<u32>; 4],
    /// 1008h.
    pub name: Option<String>,
    /// Number of its axes; the rest is of the first one.
    pub axes: u8,
    /// Distances of its axes, where its device description says them.
    pub axis_steps: Option<AxisSteps>,
    /// 6502h.
    pub supported_modes: u32,
    /// The cyclic synchronous modes that it says it has, takes in Switch On Disabled, and whose set-point it maps.
    pub modes: Vec<OperationMode>,
    /// The PDOs by which each of these gets its set-point; on CANopen one.
    pub rpdos: Vec<Vec<Carrier>>,
    /// The PDOs by which statusword and position come; on CANopen one, empty if there is none.
    pub tpdos: Vec<Carrier>,
    /// Modes that it lists but does not take or map, with the reason.
    pub refused_modes: Vec<(OperationMode, &'static str)>,
    /// Entries that one RPDO can carry.
    pub mapping_entries: u8,
    /// Whether bytes can be skipped in an RPDO.
    pub has_dummies: bool,
    /// Whether RPDOs and TPDOs follow every SYNC.
    pub follows_sync: [bool; 2],
    /// Whether an RPDO has an event timer, 1400h:5.
    pub has_rpdo_timer: bool,
    /// Whether it takes a cycle time, 60C2h.
    pub takes_cycle_time: bool,
    /// The value of 6007h that stops it best, of those that it takes: 3 quick stop, 2 disable voltage, 1 fault.
    pub lost_master: Option<i16>,
    /// Whether it goes to Pre-operational on a communication error: 1029h:1 takes 0.
    pub stops_on_error: bool,
    /// Whether 605Ah takes 2: a ramp that ends in Switch On Disabled.
    pub takes_quick_stop: bool,
    /// Whether it watches a heartbeat: 1016h:1.
    pub watches_heartbeat: bool,
    /// Whether it has 6072h, 6065h, and 6080h with 608Fh.
    pub limits: [bool; 3],
    /// Time from SYNC0 to SYNC1, us, where its device description switches both on.
    pub sync1_us: Option<u32>,
    /// Contradictions between its device description and the drive, a line each.
    pub pdo_contradictions: Vec<String>,
    /// The longest time that it took to answer.
    pub slowest: Duration,
    /// Objects whose values have another length than the standard says: bytes sent, and meant.
    pub lengths: Vec<(Address, usize, usize)>,
    /// Readings of its objects, in the order of the requests.
    pub told: Vec<(Address, ObjectReading)>,
}

const fn at(object: Standard) -> Address {
    Address::new(object.index, object.sub)
}

/// The values of all objects that are tried out, as they are now. Nothing is written.
///
/// # Errors
/// If the device is no drive, or is not at rest.
pub fn originals(objects: &mut dyn TrialAccess) -> Result<Vec<(Address, Vec<u8>)>, Refusal> {
    let device_type = number(&objects.read(at(cia::DEVICE_TYPE))?);
    if device_type & 0xffff != 402 {
        return Err(Refusal::NoDrive(device_type));
    }
    let state = match objects.read(at(cia::STATUSWORD)) {
        Ok(word) => Statusword(number(&word) as u16).state(),
        Err(Error::Refused(_)) => return Err(Refusal::Lacks(cia::STATUSWORD)),
        Err(error) => return Err(error.into()),
    };
    if state != Some(State::SwitchOnDisabled) {
        return Err(Refusal::State(state));
    }
    objects.check_rest()?;
    let mut wanted: Vec<Address> = [
        cia::CONSUMER_HEARTBEAT,
        cia::ERROR_BEHAVIOUR,
        cia::ABORT_CONNECTION_OPTION,
        cia::QUICK_STOP_OPTION,
        cia::MODE_OF_OPERATION,
        cia::INTERPOLATION_TIME,
        cia::INTERPOLATION_EXPONENT,
    ]
    .map(at)
    .to_vec();
    for Direction { communication, mapping, assignment } in [RPDO, TPDO] {
        wanted.extend([0, 1, 2].map(|sub| Address::new(mapping, sub)));
        match objects.bus() {
            // The mapping of the others is only read.
            Fieldbus::Canopen => {
                wanted.extend((0..PDOS).flat_map(|more| [1, 2, 5].map(|sub| Address::new(communication + more, sub))))
            }
            Fieldbus::Ethercat => wanted.push(Address::new(assignment, 0)),
        }
    }
    let mut values = Vec::new();
    for at in wanted {
        match objects.read(at) {
            Ok(bytes) => values.push((at, bytes)),
            Err(Error::Refused(_) | Error::Senseless(_)) => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok(values)
}

/// Tries out what a drive can do. Afterwards its objects have their values of before again, `originals`, also after a failure. A
/// data sheet's declaration saves a trial, as long as the drive does not contradict it. A device description, with the process data of
/// its modules, gives the indices of the PDOs. It also names the PDOs to exchange where the drive exchanges none yet.
///
/// # Errors
/// If the device falls silent, lacks what a master needs, or does not take back a value.
pub fn survey(
    objects: &mut dyn TrialAccess,
    originals: &[(Address, Vec<u8>)],
    sheet: Option<&Eds>,
    description: Option<&esi::Device>,
) -> Result<Survey, Refusal> {
    objects.bring_to_rest()?;
    let is_on_ethercat = objects.bus() == Fieldbus::Ethercat;
    let survey = Survey { is_on_ethercat, ..Survey::default() };
    let mut probe = Probe { objects, survey, sheet, description, standing: Vec::new() };
    let tried = probe.all(originals);
    let survey = std::mem::take(&mut probe.survey);
    let standing = std::mem::take(&mut probe.standing);
    // Whoever wants to end waits for this.
    objects.finish();
    put_back(objects, originals)?;
    tried?;
    if survey.modes.is_empty() {
        return Err(Refusal::NoMode(survey.refused_modes, standing));
    }
    Ok(survey)
}

struct Probe<'a> {
    objects: &'a mut dyn TrialAccess,
    survey: Survey,
    sheet: Option<&'a Eds>,
    description: Option<&'a esi::Device>,
    standing: Vec<StandingPdo>,
}

impl Probe<'_> {
    fn all(&mut self, originals: &[(Address, Vec<u8>)]) -> Result<(), Refusal> {
        (self.survey.identity, self.survey.name) = self.identity()?;
        self.survey.device_type = self.has(cia::DEVICE_TYPE)?.unwrap_or_default();
        for needed in
            [cia::CONTROLWORD, cia::STATUSWORD, cia::MODE_OF_OPERATION, cia::MODE_DISPLAY, cia::POSITION_ACTUAL]
        {
            self.has(needed)?.ok_or(Refusal::Lacks(needed))?;
        }
        self.survey.supported_modes = self.has(cia::SUPPORTED_MODES)?.ok_or(Refusal::Lacks(cia::SUPPORTED_MODES))?;
        self.survey.limits = [
            self.has(cia::MAX_TORQUE)?.is_some(),
            self.has(cia::FOLLOWING_ERROR_WINDOW)?.is_some(),
            self.has(cia::MAX_MOTOR_SPEED)?.is_some()
                && self.has(cia::ENCODER_INCREMENTS)?.is_some_and(|increments| increments > 0)
                && self.has(cia::ENCODER_REVOLUTIONS)?.is_some_and(|revolutions| revolutions > 0),
        ];
        self.read_mappings()?;
        self.survey.mapping_entries = self.mapping_entries()?;
        self.survey.watches_heartbeat = self.takes(at(cia::CONSUMER_HEARTBEAT), &WATCHED.to_le_bytes())?;
        self.survey.stops_on_error = self.takes(at(cia::ERROR_BEHAVIOUR), &[0])?;
        for value in [3_i16, 2, 1] {
            if self.survey.lost_master.is_none()
                && self.takes(at(cia::ABORT_CONNECTION_OPTION), &value.to_le_bytes())?
            {
                self.survey.lost_master = Some(value);
            }
        }
        self.survey.takes_quick_stop = self.takes(at(cia::QUICK_STOP_OPTION), &2_i16.to_le_bytes())?;
        self.survey.takes_cycle_time = self.takes(at(cia::INTERPOLATION_EXPONENT), &[(-3_i8) as u8])?
            && self.takes(at(cia::INTERPOLATION_TIME), &[1])?;
        let of = |at: Address| originals.iter().find(|(known, _)| *known == at).map(|(_, value)| number(value));
        self.survey.tpdos = self.carriers(TPDO, &of, [cia::STATUSWORD, cia::POSITION_ACTUAL])?;
        self.survey.follows_sync = [true; 2];
        for carrier in self.survey.tpdos.clone() {
            self.survey.follows_sync[1] &= self.follows_sync(TPDO, &carrier)?;
        }
        let supported = self.survey.supported_modes;
        for (mode, set_point) in MODES.into_iter().filter(|(mode, _)| mode.is_in(supported)) {
            match self.rpdo(mode, set_point, &of)? {
                Err(reason) => self.survey.refused_modes.push((mode, reason)),
                Ok(carriers) => {
                    for carrier in &carriers {
                        self.survey.follows_sync[0] &= self.follows_sync(RPDO, carrier)?;
                        let timer = Address::new(carrier.communication(RPDO), 5);
                        self.survey.has_rpdo_timer =
                            !self.survey.is_on_ethercat && self.takes(timer, &TIMER_MS.to_le_bytes())?;
                    }
                    self.survey.modes.push(mode);
                    self.survey.rpdos.push(carriers);
                }
            }
        }
        self.survey.has_dummies = !self.survey.is_on_ethercat && self.maps(RPDO.mapping, &[DUMMY])?;
        Ok(())
    }

    fn identity(&mut self) -> Result<Identity, Error> {
        let mut identity = [None; 4];
        for (sub, value) in (1..).zip(&mut identity) {
            *value = self.value(Address::new(cia::VENDOR_ID.index, sub))?;
        }
        let name = match self.objects.read(NAME) {
            Ok(bytes) => Some(String::from_utf8_lossy(&bytes).trim_end_matches('\0').trim().to_owned()),
            Err(Error::Refused(_) | Error::Senseless(_)) => None,
            Err(error) => return Err(error),
        };
        Ok((identity, name.filter(|name| !name.is_empty())))
    }

    /// Whether a PDO follows every SYNC; on EtherCAT they do so by the device's clock.
    fn follows_sync(&mut self, direction: Direction, carrier: &Carrier) -> Result<bool, Error> {
        Ok(self.survey.is_on_ethercat || self.takes(Address::new(carrier.communication(direction), 2), &[1])?)
    }

    fn timed<T>(&mut self, ask: impl FnOnce(&mut dyn TrialAccess) -> Result<T, Error>) -> Result<T, Error> {
        let begun = self.objects.now();
        let answer = ask(self.objects);
        self.survey.slowest = self.survey.slowest.max(self.objects.now().since(begun));
        answer
    }

    /// The value of an object; `None` if the device has no such object, or sends nonsense.
    fn has(&mut self, object: Standard) -> Result<Option<u32>, Error> {
        match self.timed(|objects| objects.read(at(object))) {
            Ok(bytes) => {
                self.survey.told.push((at(object), ObjectReading::Sent(bytes.len())));
                let meant = usize::from(object.bits()) / 8;
                if bytes.len() != meant && !self.survey.lengths.iter().any(|(known, ..)| *known == at(object)) {
                    self.survey.lengths.push((at(object), bytes.len(), meant));
                }
                Ok(bytes.get(..meant.min(bytes.len())).map(number))
            }
            // It has it, and does not report.
            Err(Error::Refused(AbortCode::WRITE_ONLY)) => Ok(Some(0)),
            Err(Error::Refused(code)) => {
                if matches!(code, AbortCode::NO_OBJECT | AbortCode::NO_SUB_INDEX) {
                    self.survey.told.push((at(object), ObjectReading::Absent));
                }
                Ok(None)
            }
            Err(Error::Senseless(_)) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Whether an object takes a value and holds it.
    fn takes(&mut self, at: Address, value: &[u8]) -> Result<bool, Error> {
        let number = signed(value);
        match self.timed(|objects| objects.write(at, value)) {
            Ok(()) => {}
            Err(Error::Refused(code)) => {
                let is_absent = matches!(code, AbortCode::NO_OBJECT | AbortCode::NO_SUB_INDEX);
                self.survey
                    .told
                    .push((at, if is_absent { ObjectReading::Absent } else { ObjectReading::Refused(number, code) }));
                return Ok(false);
            }
            Err(Error::Senseless(_)) => return Ok(false),
            Err(error) => return Err(error),
        }
        self.survey.told.push((at, ObjectReading::Took(number)));
        match self.timed(|objects| objects.read(at)) {
            Ok(held) => Ok(is_extended(&held, value)),
            Err(Error::Refused(_) | Error::Senseless(_)) => Ok(false),
            Err(error) => Err(error),
        }
    }

    fn takes_mode(&mut self, mode: OperationMode) -> Result<bool, Error> {
        if !self.takes(at(cia::MODE_OF_OPERATION), &[mode.code() as u8])? {
            return Ok(false);
        }
        let until = self.objects.now() + MODE_CHANGE;
        loop {
            if self.has(cia::MODE_DISPLAY)? == Some(u32::from(mode.code() as u8)) {
                return Ok(true);
            }
            if self.objects.now() >= until {
                return Ok(false);
            }
            self.objects.wait(Duration::from_millis(10))?;
        }
    }

    /// How many entries the mapping of the first RPDO has room for.
    fn mapping_entries(&mut self) -> Result<u8, Error> {
        if let Some(declared) = self.sheet.and_then(sheet::mapping_entries)
            && self.has_mapping_entry(declared)?
            && !self.has_mapping_entry(declared + 1)?
        {
            return Ok(declared);
        }
        for sub in 1..=MOST_MAPPED {
            if !self.has_mapping_entry(sub)? {
                return Ok(sub - 1);
            }
        }
        Ok(MOST_MAPPED)
    }

    fn has_mapping_entry(&mut self, sub: u8) -> Result<bool, Error> {
        match self.objects.read(Address::new(RPDO.mapping, sub)) {
            Err(Error::Refused(AbortCode::NO_SUB_INDEX | AbortCode::NO_OBJECT)) => Ok(false),
            Ok(_) | Err(Error::Refused(_) | Error::Senseless(_)) => Ok(true),
            Err(error) => Err(error),
        }
    }
}

/// The number that bytes are in two's complement, the lowest first.
fn signed(bytes: &[u8]) -> i64 {
    let number = bytes.iter().take(8).rev().fold(0_u64, |number, byte| number << 8 | u64::from(*byte));
    let unused = 64 - 8 * bytes.len().clamp(1, 8);
    (number << unused) as i64 >> unused
}

/// Whether what a device sent is a value, or one with more bytes that repeat its sign or are zero.
fn is_extended(sent: &[u8], value: &[u8]) -> bool {
    let has_sign = value.last().is_some_and(|top| top >> 7 != 0);
    let more = sent.get(value.len()..).unwrap_or_default();
    sent.starts_with(value)
        && (more.iter().all(|byte| *byte == 0) || has_sign && more.iter().all(|byte| *byte == u8::MAX))
}

/// Gives all objects their values again, and reads them back.
fn put_back(objects: &mut dyn TrialAccess, originals: &[(Address, Vec<u8>)]) -> Result<(), Refusal> {
    let node = objects.node_id();
    let plan = plan(objects, node, &sheet_of(node, originals, None), None)?;
    for step in &plan.steps {
        // What is not taken is found below.
        let _: WriteOutcome = carry_out(objects, step)?;
    }
    let mut lost = Vec::new();
    for (at, value) in originals {
        if at.index == cia::MODE_OF_OPERATION.index {
            // It has one byte, however many are sent.
            match objects.write(*at, value.get(..1).unwrap_or_default()) {
                // A drive that had no mode before may refuse to have none again; `run` sets one at each start.
                Err(Error::Refused(_)) if number(value) == 0 => continue,
                Ok(()) | Err(Error::Refused(_)) => {}
                Err(error) => return Err(error.into()),
            }
        }
        match objects.read(*at) {
            Ok(held) if held == *value => {}
            Ok(_) => lost.push(*at),
            Err(error) => return Err(error.into()),
        }
    }
    if lost.is_empty() { Ok(()) } else { Err(Refusal::NotRestored(lost)) }
}
