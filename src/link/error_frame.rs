//! Error frames, in which a CAN controller reports its own state.
//!
//! # Source
//! Linux, `include/uapi/linux/can/error.h`: classes in the identifier of an error frame, details in its eight bytes.

use yieldwall_fieldbus::LinkEvent;

const ARBITRATION_LOST: u32 = 0x002;
const CONTROLLER: u32 = 0x004;
const PROTOCOL: u32 = 0x008;
const NO_ACKNOWLEDGEMENT: u32 = 0x020;
const BUS_OFF: u32 = 0x040;
const BUS_ERROR: u32 = 0x080;
const RESTARTED: u32 = 0x100;
const COUNTERS: u32 = 0x200;

/// Byte 1: receive overflow, transmit overflow, warning (both ways), passive (both ways), active again.
const RX_OVERFLOW: u8 = 0x01;
const TX_OVERFLOW: u8 = 0x02;
const WARNING: u8 = 0x04 | 0x08;
const PASSIVE: u8 = 0x10 | 0x20;
const ACTIVE: u8 = 0x40;

/// An error frame, decoded. One frame may report several events.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ErrorFrame {
    /// The controller has left the bus.
    pub is_bus_off: bool,
    /// The controller has an error counter of 128 or more and may no longer destroy frames of others.
    pub is_error_passive: bool,
    /// The controller has an error counter of 96 or more.
    pub is_warning: bool,
    /// The controller is error-active again.
    pub is_active_again: bool,
    /// The controller was restarted after bus-off.
    pub is_restarted: bool,
    /// Nobody acknowledged a frame.
    pub is_unacknowledged: bool,
    /// Arbitration was lost, where a frame is not sent again.
    pub has_lost_arbitration: bool,
    /// A frame was destroyed on the wire.
    pub is_bus_error: bool,
    /// The controller lost frames on the way in.
    pub has_receive_overflow: bool,
    /// The controller lost frames on the way out.
    pub has_transmit_overflow: bool,
    /// Error counters for transmission and reception, if the driver reports them.
    pub counters: Option<(u8, u8)>,
}

impl ErrorFrame {
    /// Decodes the class bits of the identifier and the eight bytes.
    ///
    /// Real-time: yes.
    pub fn decode(classes: u32, data: &[u8; 8]) -> Self {
        let has = |class: u32| classes & class != 0;
        let controller = if has(CONTROLLER) { data[1] } else { 0 };
        Self {
            is_bus_off: has(BUS_OFF),
            is_error_passive: controller & PASSIVE != 0,
            is_warning: controller & WARNING != 0,
            is_active_again: controller & ACTIVE != 0,
            is_restarted: has(RESTARTED),
            is_unacknowledged: has(NO_ACKNOWLEDGEMENT),
            has_lost_arbitration: has(ARBITRATION_LOST),
            is_bus_error: has(BUS_ERROR | PROTOCOL),
            has_receive_overflow: controller & RX_OVERFLOW != 0,
            has_transmit_overflow: controller & TX_OVERFLOW != 0,
            counters: has(COUNTERS).then_some((data[6], data[7])),
        }
    }

    /// Returns the event that the master has to know. A frame that nobody acknowledged counts as error-passive: with the cable unplugged a
    /// controller stays in that state.
    pub fn link_event(&self) -> Option<LinkEvent> {
        match self {
            Self { is_bus_off: true, .. } => Some(LinkEvent::BusOff),
            Self { is_error_passive: true, .. } | Self { is_unacknowledged: true, .. } => Some(LinkEvent::ErrorPassive),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bus_off_with_counters() {
        let error = ErrorFrame::decode(0x240, &[0, 0, 0, 0, 0, 0, 0xf8, 0x05]);
        let expected = ErrorFrame { is_bus_off: true, counters: Some((0xf8, 5)), ..ErrorFrame::default() };
        assert_eq!((error, error.link_event()), (expected, Some(LinkEvent::BusOff)));
    }

    #[test]
    fn a_symmetric_warning_is_no_event_and_passive_is_one() {
        let warning = ErrorFrame::decode(0x004, &[0, 0x0c, 0, 0, 0, 0, 9, 9]);
        assert_eq!(warning, ErrorFrame { is_warning: true, ..ErrorFrame::default() });
        assert_eq!(warning.link_event(), None);
        for passive in [0x10, 0x20, 0x30] {
            let error = ErrorFrame::decode(0x204, &[0, passive, 0, 0, 0, 0, 128, 0]);
            let expected = ErrorFrame { is_error_passive: true, counters: Some((128, 0)), ..ErrorFrame::default() };
            assert_eq!((error, error.link_event()), (expected, Some(LinkEvent::ErrorPassive)));
        }
    }

    #[test]
    fn a_cable_that_is_out() {
        let error = ErrorFrame::decode(0x0a8, &[0, 0, 0, 0x19, 0, 0, 0, 0]);
        let expected = ErrorFrame { is_unacknowledged: true, is_bus_error: true, ..ErrorFrame::default() };
        assert_eq!((error, error.link_event()), (expected, Some(LinkEvent::ErrorPassive)));
    }

    #[test]
    fn details_count_only_with_their_class() {
        let error = ErrorFrame::decode(0x102, &[0xff; 8]);
        let expected = ErrorFrame { is_restarted: true, has_lost_arbitration: true, ..ErrorFrame::default() };
        assert_eq!((error, error.link_event()), (expected, None));
        let all = ErrorFrame::decode(0x004, &[0, 0x43, 0, 0, 0, 0, 0, 0]);
        let expected = ErrorFrame {
            is_active_again: true,
            has_receive_overflow: true,
            has_transmit_overflow: true,
            ..ErrorFrame::default()
        };
        assert_eq!(all, expected);
    }
}
