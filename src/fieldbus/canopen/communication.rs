//! The communication objects of a device, 1000h to 1FFFh.

use super::pdo::PdoParameters;
use super::{CanopenError, MappingEntry, NodeId, cob};
use crate::objects::{Access, DeviceIdentity, Mappable, Object};

/// Most PDOs of each direction that an axis of a device can declare.
pub(super) const MAX_PDOS: u8 = 4;
/// PDO numbers from one axis to the next.
///
/// # Source
/// CiA 402-3: PDOs of axes are 64 apart.
const AXIS_PDOS: u8 = 64;

/// Whether a PDO has one of the first places of an axis, counted from 0.
pub(super) const fn is_place(place: u8) -> bool {
    place % AXIS_PDOS < MAX_PDOS
}
/// Most objects in one PDO of a device.
pub(super) const MAX_MAPPED: usize = 8;
/// Entries of the error history 1003h.
pub(super) const ERROR_HISTORY: u8 = 8;
/// Nodes whose heartbeat a device can watch (1016h).
pub(super) const HEARTBEAT_PRODUCERS: u8 = 4;

/// Value of 1010h and 1011h: parameters are stored and restored on command.
const ON_COMMAND: u32 = 1;

/// Objects that a CANopen device declares beside its own: its communication profile and its PDOs.
///
/// ```
/// use yieldwall_fieldbus::canopen::{CommunicationProfile, PdoParameters, node_id};
/// use yieldwall_fieldbus::objects::{DeviceIdentity, Mappable, Object, ObjectDictionary};
///
/// let node = node_id(3)?;
/// let controlword = PdoParameters::default_rpdo(1, node, &[(0x6040, 0, 16)])?;
/// let od = ObjectDictionary::builder()
///     .object(Object::new(0x6040, 0, 0u16).mappable(Mappable::Rpdo))
///     .objects(CommunicationProfile::new(node, &DeviceIdentity::default()).rpdo(1, &controlword).objects()?)
///     .build()?;
/// assert!(od.handle::<u16>(0x1017, 0).is_ok());
/// # Ok::<(), yieldwall_fieldbus::canopen::CanopenError>(())
/// ```
#[derive(Clone, Debug)]
pub struct CommunicationProfile {
    objects: Vec<Object>,
    mapping_entries: usize,
    has_rpdo_timers: bool,
    fault: Option<CanopenError>,
}

impl CommunicationProfile {
    /// Creates the objects that [`Node`](super::Node) needs: 1000h, 1001h, 1003h, 1005h to 1008h, 100Ch, 100Dh, 1010h to 1012h, 1014h,
    /// 1016h to 1019h, 1029h and 1200h. SYNC is at 080h without counter and window, EMCY at 080h + node id. There is no error control, TIME
    /// is not consumed, and the error behaviour is 0.
    pub fn new(node: NodeId, identity: &DeviceIdentity) -> Self {
        let own_u32 = |index, sub, value: u32| Object::new(index, sub, value).access(Access::ReadOnly);
        let mut objects = identity.objects().to_vec();
        objects.extend([
            Object::new(0x1001, 0, 0u8).access(Access::ReadOnly).mappable(Mappable::Tpdo),
            Object::new(0x1003, 0, 0u8),
            Object::new(0x1005, 0, u32::from(cob::SYNC)),
            Object::new(0x1006, 0, 0u32),
            Object::new(0x1007, 0, 0u32),
            Object::new(0x100c, 0, 0u16),
            Object::new(0x100d, 0, 0u8),
            Object::highest_sub(0x1010, 1),
            Object::new(0x1010, 1, ON_COMMAND),
            Object::highest_sub(0x1011, 1),
            Object::new(0x1011, 1, ON_COMMAND),
            Object::new(0x1012, 0, u32::from(cob::TIME)),
            Object::new(0x1014, 0, u32::from(cob::emcy(node))),
            Object::highest_sub(0x1016, HEARTBEAT_PRODUCERS),
            Object::new(0x1017, 0, 0u16),
            Object::new(0x1019, 0, 0u8).limits(0u8, 240),
            Object::highest_sub(0x1029, 1),
            Object::new(0x1029, 1, 0u8).limits(0u8, 2),
            Object::highest_sub(0x1200, 2),
            own_u32(0x1200, 1, cob::sdo_request(node).into()),
            own_u32(0x1200, 2, cob::sdo_response(node).into()),
        ]);
        objects.extend((1..=ERROR_HISTORY).map(|sub| own_u32(0x1003, sub, 0)));
        objects.extend((1..=HEARTBEAT_PRODUCERS).map(|sub| Object::new(0x1016, sub, 0u32)));
        Self { objects, mapping_entries: MAX_MAPPED, has_rpdo_timers: true, fault: None }
    }

    /// Objects that one PDO carries at most, 1 to 8; 8 unless set. For the PDOs that are declared after this.
    pub fn mapping_entries(mut self, most: u8) -> Self {
        self.mapping_entries = usize::from(most).clamp(1, MAX_MAPPED);
        self
    }

    /// Sets whether RPDOs have an event timer, 14xxh:5; the default is that they have one. The setting applies to RPDOs declared after this
    /// call.
    pub fn rpdo_timers(mut self, has: bool) -> Self {
        self.has_rpdo_timers = has;
        self
    }

    /// Declares RPDO `number` (1 to 4, of a second axis 65 to 68, and so on): 14xxh and 16xxh.
    pub fn rpdo(self, number: u8, parameters: &PdoParameters) -> Self {
        self.pdo(0x1400, number, parameters)
    }

    /// Declares TPDO `number` (1 to 4, of a second axis 65 to 68, and so on): 18xxh and 1Axxh.
    pub fn tpdo(self, number: u8, parameters: &PdoParameters) -> Self {
        self.pdo(0x1800, number, parameters)
    }

    fn pdo(mut self, base: u16, number: u8, parameters: &PdoParameters) -> Self {
        if !number.checked_sub(1).is_some_and(is_place) {
            self.fault.get_or_insert(CanopenError::PdoNumber(number));
            return self;
        }
        let most = self.mapping_entries;
        if parameters.mapping.len() > most {
            self.fault.get_or_insert(CanopenError::PdoEntries(parameters.mapping.len()));
            return self;
        }
        let (communication, mapping) = (base + u16::from(number) - 1, base + 0x200 + u16::from(number) - 1);
        let is_tpdo = base == 0x1800;
        let entry = |place: usize| {
            let mapped = parameters.mapping.get(place).copied();
            mapped.map_or(0u32, |(index, sub, bits)| MappingEntry::new(index, sub, bits).to_u32())
        };
        let highest = match (is_tpdo, self.has_rpdo_timers) {
            (true, _) => 6,
            (false, true) => 5,
            (false, false) => 2,
        };
        if highest >= 5 {
            self.objects.push(Object::new(communication, 5, parameters.event_timer_ms));
        }
        let number_mapped = Object::new(mapping, 0, parameters.mapping.len() as u8);
        self.objects.extend([
            Object::highest_sub(communication, highest),
            Object::new(communication, 1, parameters.cob_id),
            Object::new(communication, 2, parameters.transmission_type),
            if most < MAX_MAPPED { number_mapped.limits(0u8, most as u8) } else { number_mapped },
        ]);
        if is_tpdo {
            self.objects.extend([
                Object::new(communication, 3, parameters.inhibit_time_100_us),
                Object::new(communication, 6, 0u8).limits(0u8, 240),
            ]);
        }
        self.objects.extend((0..most).map(|place| Object::new(mapping, place as u8 + 1, entry(place))));
        self
    }

    /// Returns the objects. Mappings are checked by [`Node::new`](super::Node::new).
    ///
    /// # Errors
    /// [`CanopenError::PdoNumber`] or [`CanopenError::PdoEntries`] for a PDO that cannot be declared.
    pub fn objects(self) -> Result<Vec<Object>, CanopenError> {
        match self.fault {
            Some(fault) => Err(fault),
            None => Ok(self.objects),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::canopen::node_id;

    #[test]
    fn pdos_that_cannot_be_declared_are_named() {
        let profile = || CommunicationProfile::new(node_id(3).unwrap(), &DeviceIdentity::default());
        let refused = |profile: CommunicationProfile| profile.objects().map(|_| ());
        let pdo = PdoParameters::synchronous(0x201, &[]);
        assert_eq!(refused(profile().rpdo(5, &pdo)), Err(CanopenError::PdoNumber(5)));
        assert_eq!(refused(profile().tpdo(0, &pdo)), Err(CanopenError::PdoNumber(0)));
        assert_eq!(refused(profile().tpdo(69, &pdo)), Err(CanopenError::PdoNumber(69)));
        assert_eq!(refused(profile().tpdo(68, &pdo)), Ok(()));
        let pdo = PdoParameters::synchronous(0x201, &[(0x6040, 0, 16); 9]);
        assert_eq!(refused(profile().rpdo(1, &pdo)), Err(CanopenError::PdoEntries(9)));
    }
}
