//! Readings of a segment's devices by ethercrab, an independent EtherCAT master.
//!
//! It takes all devices through INIT to PRE-OP and gives them station addresses. Its frames go over the link of this program; its
//! timers use the clock of that link.

use std::cell::Cell;
use std::future::Future;
use std::pin::pin;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use ethercrab::error::Error;
use ethercrab::{MainDevice, MainDeviceConfig, PduRx, PduStorage, PduTx, RetryBehaviour, SubDevice, Timeouts};
use serde::{Deserialize, Serialize};

use super::reading::{Area, DeviceReading};
use yieldwall_fieldbus::ethercat::frame;
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{EthernetLink, EthernetReceived};

/// Devices that it takes, as many as this program's master.
const MOST_DEVICES: usize = 64;
/// Bytes of process data of all devices.
const MOST_BYTES: usize = 1 << 14;
/// Frames on their way, and bytes of each.
const FRAMES: usize = 16;
const FRAME_LEN: usize = PduStorage::element_size(1100);
/// Number of times that it sends a frame again that does not come back.
const TRIES: usize = 5;
/// Longest interval between checks of its timers.
const LOOK_UP: Duration = Duration::from_micros(100);

/// Its report.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Answer {
    /// The devices, and why it has no process data, if it has none.
    Read { devices: Vec<DeviceReading>, without_process_data: Option<String> },
    /// Reason why the devices did not reach PRE-OP.
    Failed(String),
}

thread_local! {
    static NOW: Cell<Time> = const { Cell::new(Time(0)) };
}

/// The clock of its timers.
struct Clock;

impl embassy_time_driver::Driver for Clock {
    fn now(&self) -> u64 {
        NOW.get().0 / 1000
    }

    /// Nobody sleeps: [`carry`] looks at all timers again and again.
    fn schedule_wake(&self, _: u64, _: &Waker) {}
}

embassy_time_driver::time_driver_impl!(static CLOCK: Clock = Clock);

/// Brings all devices to PRE-OP with ethercrab, and returns its readings of them.
///
/// # Panics
/// If ethercrab panics, as it does on some damaged memory chips. It may hang as well.
pub(super) fn read(link: &mut impl EthernetLink) -> Answer {
    let storage = PduStorage::<FRAMES, FRAME_LEN>::new();
    let Ok((tx, rx, pdu_loop)) = storage.try_split() else { return Answer::Failed("its storage is taken".to_owned()) };
    let timeouts = Timeouts {
        state_transition: Duration::from_secs(10),
        pdu: Duration::from_millis(100),
        eeprom: Duration::from_secs(1),
        mailbox_echo: Duration::from_secs(1),
        mailbox_response: Duration::from_secs(2),
        ..Timeouts::default()
    };
    let config = MainDeviceConfig { dc_static_sync_iterations: 0, retry_behaviour: RetryBehaviour::Count(TRIES) };
    let main = MainDevice::new(pdu_loop, timeouts, config);
    carry(link, tx, rx, Box::pin(gather(&main))).unwrap_or_else(|error| Answer::Failed(error.to_string()))
}

/// Carries frames until the master has ended.
fn carry<T>(link: &mut impl EthernetLink, mut tx: PduTx<'_>, mut rx: PduRx<'_>, master: impl Future<Output = T>) -> T {
    let mut master = pin!(master);
    let mut buffer = [0; frame::LONGEST];
    loop {
        NOW.set(link.now());
        if let Poll::Ready(result) = master.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
            return result;
        }
        while let Some(sendable) = tx.next_sendable_frame() {
            // It sends a frame again that does not come back, and so one that could not leave.
            let _ = sendable.send_blocking(|bytes| {
                let _ = link.send(bytes);
                Ok(bytes.len())
            });
        }
        link.wait(link.now() + LOOK_UP);
        while let Some(arrival) = link.receive(&mut buffer) {
            let EthernetReceived::Frame { length } = arrival.what else { continue };
            // ethercrab skips frames of other senders.
            let _ = rx.receive_frame(buffer.get(..length).unwrap_or_default());
        }
    }
}

async fn gather(main: &MainDevice<'_>) -> Result<Answer, Error> {
    let group = main.init_single_group::<MOST_DEVICES, MOST_BYTES>(|| NOW.get().0).await?;
    let mut devices = Vec::new();
    for device in group.iter(main) {
        let full_name = device.description().await.ok().map(|name| name.as_deref().unwrap_or_default().to_owned());
        devices.push(DeviceReading { full_name, ..of_device(&device) });
    }
    let without_process_data = match group.into_pre_op_pdi(main).await {
        Ok(group) => {
            for (device, reading) in group.iter(main).zip(&mut devices) {
                let data = device.io_raw();
                let bytes = |data: &[u8]| u32::try_from(data.len()).ok();
                (reading.outputs, reading.inputs) = (bytes(data.outputs()), bytes(data.inputs()));
            }
            None
        }
        Err(error) => Some(error.to_string()),
    };
    Ok(Answer::Read { devices, without_process_data })
}

fn of_device(device: &SubDevice) -> DeviceReading {
    let identity = device.identity();
    let (vendor, product, serial) = (identity.vendor_id, identity.product_id, identity.serial);
    // By this it calls a device without a name.
    let nameless = format!("manu. {vendor:#010x}, device {product:#010x}, serial {serial:#010x}");
    let name = if device.name() == nameless { "" } else { device.name() };
    DeviceReading {
        identity: [vendor, product, identity.revision, serial].map(Some),
        name: Some(name.to_owned()),
        delay_ns: device.dc_support().any().then(|| device.propagation_delay()),
        ..in_debug_output(&format!("{device:?}"))
    }
}

/// Returns mailboxes, protocols, ports and parent, which ethercrab 0.7.1 shows only in its debug output. `None` marks a value that
/// is not found there.
pub(super) fn in_debug_output(text: &str) -> DeviceReading {
    // A name with arbitrary content is between the mailboxes and the ports.
    let mailbox = |key: &str| {
        let text = after(text, key)?;
        if text.starts_with("None") {
            return Some(Area::default());
        }
        let value = |key| number(after(text, key)?);
        Some(Area { start: value("address: ")?, len: value("len: ")? })
    };
    let protocols = after(text, "supported_protocols: MailboxProtocols(").and_then(|rest| rest.split_once(')'));
    let protocols = protocols.map(|(names, _)| names.split(" | ").filter(|name| *name != "0x0").map(str::to_owned));
    let ports = text.rsplit_once("ports: Ports([").and_then(|(_, rest)| rest.split_once("])")).map(|(ports, _)| {
        let open = ports.split("Port {").filter(|port| port.contains("active: true"));
        let mut open: Vec<u8> = open.filter_map(|port| number(after(port, "number: ")?)).collect();
        open.sort_unstable();
        open
    });
    let parent = text.rsplit_once("parent_index: Some(").and_then(|(_, rest)| number(rest));
    DeviceReading {
        mailboxes: [mailbox("write: "), mailbox("read: ")],
        protocols: protocols.map(Iterator::collect),
        ports,
        parent,
        ..DeviceReading::default()
    }
}

fn after<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    text.split_once(key).map(|(_, rest)| rest)
}

/// Returns the number with which a text begins.
fn number<T: std::str::FromStr>(text: &str) -> Option<T> {
    text.split(|one: char| !one.is_ascii_digit()).next()?.parse().ok()
}
