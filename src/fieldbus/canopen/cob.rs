//! Identifiers of the predefined connection set.
//!
//! # Source
//! CiA 301, predefined connection set and list of restricted CAN-IDs.

use canopen_rs::{NodeId, PdoKind};

use super::CanopenError;

/// NMT commands.
pub const NMT: u16 = 0x000;
/// SYNC unless 1005h says otherwise.
pub const SYNC: u16 = 0x080;
/// TIME unless 1012h says otherwise.
pub const TIME: u16 = 0x100;
/// LSS answers of a device.
pub const LSS_ANSWER: u16 = 0x7e4;
/// LSS requests of the master.
pub const LSS_REQUEST: u16 = 0x7e5;
/// Bit 31 of a PDO or EMCY COB-ID: set means that the object does not exist.
pub const INVALID: u32 = 0x8000_0000;

/// Returns a node id.
///
/// # Errors
/// Outside 1 to 127.
pub fn node_id(raw: u8) -> Result<NodeId, CanopenError> {
    NodeId::new(raw).map_err(|_| CanopenError::NodeId(raw))
}

/// Returns the emergency messages of a node, 081h to 0FFh.
pub const fn emcy(node: NodeId) -> u16 {
    0x080 + node.raw() as u16
}

/// Returns the SDO requests to a node, 601h to 67Fh.
pub const fn sdo_request(node: NodeId) -> u16 {
    0x600 + node.raw() as u16
}

/// Returns the SDO responses of a node, 581h to 5FFh.
pub const fn sdo_response(node: NodeId) -> u16 {
    0x580 + node.raw() as u16
}

/// Whether frames with this identifier are heartbeats, boot-up messages or answers to node guarding.
pub const fn is_heartbeat(id: u16) -> bool {
    id > 0x700 && id < 0x780
}

/// Returns the heartbeat and boot-up of a node, 701h to 77Fh.
pub const fn heartbeat(node: NodeId) -> u16 {
    0x700 + node.raw() as u16
}

/// Returns the default RPDO `number` (1 to 4) of a node, 201h to 57Fh; `None` for another number.
pub const fn rpdo(number: u8, node: NodeId) -> Option<u16> {
    canopen_rs::pdo::default_cob_id(PdoKind::Receive, number, node)
}

/// Returns the default TPDO `number` (1 to 4) of a node, 181h to 4FFh; `None` for another number.
pub const fn tpdo(number: u8, node: NodeId) -> Option<u16> {
    canopen_rs::pdo::default_cob_id(PdoKind::Transmit, number, node)
}

/// Whether CiA 301 forbids a configurable object (PDO, SYNC, EMCY) to use this identifier, or it is wider than 11 bits.
pub const fn is_restricted(id: u32) -> bool {
    matches!(id, 0x000..=0x07f | 0x101..=0x180 | 0x581..=0x5ff | 0x601..=0x67f | 0x6e0..=0x6ff | 0x701..)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn predefined_connection_set_of_node_5() {
        let node = node_id(5).unwrap();
        assert_eq!((emcy(node), sdo_request(node), sdo_response(node), heartbeat(node)), (0x085, 0x605, 0x585, 0x705));
        assert_eq!([1, 2, 3, 4].map(|n| rpdo(n, node)), [Some(0x205), Some(0x305), Some(0x405), Some(0x505)]);
        assert_eq!([1, 2, 3, 4].map(|n| tpdo(n, node)), [Some(0x185), Some(0x285), Some(0x385), Some(0x485)]);
        assert_eq!((rpdo(0, node), tpdo(5, node)), (None, None));
    }

    #[test]
    fn node_ids_are_1_to_127() {
        assert_eq!((node_id(0), node_id(128)), (Err(CanopenError::NodeId(0)), Err(CanopenError::NodeId(128))));
        assert!(node_id(1).is_ok() && node_id(127).is_ok());
    }

    #[test]
    fn no_default_pdo_is_restricted_and_service_ids_are() {
        for raw in 1..=127 {
            let node = node_id(raw).unwrap();
            for number in 1..=4 {
                assert!(!is_restricted(u32::from(rpdo(number, node).unwrap())));
                assert!(!is_restricted(u32::from(tpdo(number, node).unwrap())));
            }
            assert!(
                [sdo_request(node), sdo_response(node), heartbeat(node)].iter().all(|&id| is_restricted(id.into()))
            );
        }
        assert!(!is_restricted(SYNC.into()) && is_restricted(NMT.into()) && is_restricted(0x800));
    }
}
