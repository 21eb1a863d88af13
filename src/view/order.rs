//! Orders of a person at the page to a simulation.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

use serde::Deserialize;

/// Orders that wait at most.
const WAITING: usize = 64;
/// Time from one attempt to hand over an order that must not be lost to the next.
const AGAIN: Duration = Duration::from_millis(10);

/// An order, as a message of JSON has it: `{"hold": [0.01, 0.05]}`, `"let_go"`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Order {
    /// The hand holds the tool and aims at this point of the plane, x and y in m in the base frame.
    Hold([f64; 2]),
    /// The hand lets go of the tool.
    LetGo,
    /// A setting gets a value.
    Set {
        /// Key of the setting.
        key: String,
        /// Value in the unit of the setting.
        value: f64,
    },
    /// The fixture answers by the law with this key.
    Law(String),
    /// A fault is injected, by its name.
    Fault(String),
    /// The supervisor forgets the fault that stopped the rig.
    Reset,
    /// The rig is enabled.
    Enable,
    /// The rig is stopped.
    Stop,
}

impl Order {
    /// Returns the order in a message of a client.
    pub(crate) fn of(message: &str) -> Option<Self> {
        serde_json::from_str(message).ok()
    }
}

/// The page's end of the orders. The other end belongs to a simulation.
#[derive(Clone, Debug)]
pub struct Desk(SyncSender<Order>);

/// Returns both ends of the orders.
pub fn orders() -> (Desk, Receiver<Order>) {
    let (sender, receiver) = sync_channel(WAITING);
    (Desk(sender), receiver)
}

impl Desk {
    /// Hands over an order. A full queue drops [`Order::Hold`]: the next movement of the pointer replaces it. Any other order waits
    /// for room.
    pub(crate) async fn take(&self, order: Order) {
        let mut left = order;
        while let Err(TrySendError::Full(order)) = self.0.try_send(left) {
            if matches!(order, Order::Hold(_)) {
                return;
            }
            left = order;
            tokio::time::sleep(AGAIN).await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn each_order_has_its_message() {
        for (message, order) in [
            (r#"{"hold": [0.01, -0.05]}"#, Order::Hold([0.01, -0.05])),
            (r#""let_go""#, Order::LetGo),
            (r#"{"set": {"key": "yield_n", "value": 25}}"#, Order::Set { key: "yield_n".into(), value: 25.0 }),
            (r#"{"law": "elastic"}"#, Order::Law("elastic".into())),
            (r#"{"fault": "drive-fault"}"#, Order::Fault("drive-fault".into())),
            (r#""reset""#, Order::Reset),
            (r#""enable""#, Order::Enable),
            (r#""stop""#, Order::Stop),
        ] {
            assert_eq!(Order::of(message), Some(order), "{message}");
        }
        for message in
            ["", "{}", "let_go", r#"{"hold": [1e999, 0]}"#, r#"{"hold": [1]}"#, r#"{"set": {"key": "a"}}"#, r#""boot""#]
        {
            assert_eq!(Order::of(message), None, "{message}");
        }
    }

    proptest! {
        #[test]
        fn no_text_panics_and_every_number_is_finite(text in r#"\{?"?(hold|set|law|let_go)?"?:? ?\[?[-0-9eE.,"{}]{0,20}\]?\}?"#) {
            if let Some(Order::Hold(point)) = Order::of(&text) {
                prop_assert!(point.iter().all(|coordinate| coordinate.is_finite()));
            }
        }
    }
}
