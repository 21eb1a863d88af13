//! The interfaces of a rig's buses.

use thiserror::Error;

use crate::RunError;
use yieldwall_bus::{MasterSetup, SensorLink};
use yieldwall_config as config;
use yieldwall_fieldbus::canopen::{BusId, cob};
use yieldwall_link::{
    CobFilter, EthernetError, Interfaces, LinkError, PacketSocket, Role, SocketCan, SocketCanSettings, SocketCans,
};
use yieldwall_service::journal::JournalError;

/// Why the interfaces of a rig could not be opened. Nothing was sent.
#[derive(Debug, Error)]
pub enum OpenError {
    /// Parts of the configuration do not fit together.
    #[error(transparent)]
    Run(#[from] RunError),
    /// An interface cannot be used.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The interface of a segment cannot be used.
    #[error(transparent)]
    Ethernet(#[from] EthernetError),
    /// A journal is open on an interface, or none could begin.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// There is not one interface for each bus.
    #[error("the rig has {buses} buses, and {interfaces} interfaces were given")]
    Count {
        /// How many buses the rig has.
        buses: usize,
        /// How many interfaces there are.
        interfaces: usize,
    },
}

/// Opens one interface for each of the rig's buses, in the order of their names, each at the bit rate of its bus. `filters` gives what is
/// wanted of a CAN bus, process data and the rest; `roles` what only one process may do there, on a segment the first of them.
///
/// # Errors
/// If an interface cannot be used, or there are too few or too many.
pub fn open_buses(
    rig: &config::Rig,
    interfaces: &[String],
    roles: impl Fn(BusId) -> Vec<Role>,
    filters: impl Fn(BusId) -> (Vec<CobFilter>, Vec<CobFilter>),
) -> Result<Interfaces, OpenError> {
    if interfaces.len() != rig.buses.len() {
        return Err(OpenError::Count { buses: rig.buses.len(), interfaces: interfaces.len() });
    }
    let (mut links, mut segment) = (Vec::new(), None);
    for ((bus, configured), interface) in BusId::all().zip(rig.buses.values()).zip(interfaces) {
        let Some(can) = configured.canopen() else {
            let role = roles(bus).first().copied().unwrap_or(Role::Segment);
            segment = Some(PacketSocket::open(interface, role)?);
            links.push(None);
            continue;
        };
        let (process, services) = filters(bus);
        let settings = SocketCanSettings {
            process,
            services,
            bit_rate: Some(can.bit_rate_bit_per_s),
            roles: roles(bus),
            ..SocketCanSettings::everything(interface)
        };
        links.push(Some(SocketCan::open(&settings)?));
    }
    Ok(Interfaces::new(SocketCans::new(links), segment))
}

/// Returns a master's filters on a bus: for process data, and for all other frames.
pub(super) fn filters(setup: &MasterSetup, bus: BusId) -> (Vec<CobFilter>, Vec<CobFilter>) {
    let mut process = vec![CobFilter::only(cob::SYNC)];
    let mut nodes: Vec<u8> = setup.drives.iter().filter(|drive| drive.bus == bus).map(|drive| drive.node_id).collect();
    match &setup.sensor.link {
        _ if setup.sensor.bus != bus => {}
        SensorLink::Canopen(sensor) => nodes.push(sensor.node_id),
        SensorLink::PlainCan(sensor) => {
            let [first, second] = sensor.protocol.data_ids();
            process.extend([first, second, sensor.protocol.order_id()].map(CobFilter::only));
        }
    }
    let mut services = vec![CobFilter::only(cob::NMT), CobFilter::matching(0x700, 0x780)];
    for node in nodes.into_iter().filter_map(|node| cob::node_id(node).ok()) {
        let pdos = (1..=4).flat_map(|number| [cob::tpdo(number, node), cob::rpdo(number, node)]);
        process.extend(pdos.flatten().map(CobFilter::only));
        let answers = [cob::emcy(node), cob::sdo_request(node), cob::sdo_response(node)];
        services.extend(answers.map(CobFilter::only));
    }
    (process, services)
}
