//! The readings of a master of the devices of a segment, and where two masters differ.

use serde::{Deserialize, Serialize};

/// Largest difference between two delays that rounding makes, in ns: 1 ns a device.
const ROUNDING_NS: u32 = 64;

/// The reading of one device by one master; `None` marks a value that the master does not read or show.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct DeviceReading {
    /// Vendor, product code, revision and serial number in the SII.
    pub(super) identity: [Option<u32>; 4],
    /// Name of the device in the SII; empty if there is none.
    pub(super) name: Option<String>,
    /// Full name in the SII; empty for none.
    pub(super) full_name: Option<String>,
    /// Mailboxes to the device and from it, as the master sets them up.
    pub(super) mailboxes: [Option<Area>; 2],
    /// Protocols of its mailboxes, in the order of their bits.
    pub(super) protocols: Option<Vec<String>>,
    /// Bytes of its outputs.
    pub(super) outputs: Option<u32>,
    /// Bytes of its inputs.
    pub(super) inputs: Option<u32>,
    /// Ports with a link, in ascending order.
    pub(super) ports: Option<Vec<u8>>,
    /// Position of the device before it; `None` for the first device too.
    pub(super) parent: Option<u16>,
    /// Delay from the first device that has a clock, in ns.
    pub(super) delay_ns: Option<u32>,
}

/// Memory of a mailbox; no bytes for no mailbox.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Area {
    /// First byte.
    pub(super) start: u16,
    /// Number of bytes.
    pub(super) len: u16,
}

/// A value of a device, or the number of devices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Subject {
    Devices,
    Vendor,
    Product,
    Revision,
    Serial,
    Name,
    FullName,
    MailboxTo,
    MailboxFrom,
    Protocols,
    Outputs,
    Inputs,
    Ports,
    Parent,
    Delay,
}

/// A value that two masters read differently.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Difference {
    /// Position of the device; `None` for the whole segment.
    pub(super) position: Option<u16>,
    pub(super) subject: Subject,
    /// As this program reads it.
    pub(super) own: String,
    /// As the other master reads it.
    pub(super) other: String,
}

impl Subject {
    /// Returns its word.
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Devices => "devices",
            Self::Vendor => "vendor",
            Self::Product => "product",
            Self::Revision => "revision",
            Self::Serial => "serial",
            Self::Name => "name",
            Self::FullName => "full name",
            Self::MailboxTo => "mailbox to",
            Self::MailboxFrom => "mailbox from",
            Self::Protocols => "protocols",
            Self::Outputs => "outputs",
            Self::Inputs => "inputs",
            Self::Ports => "ports",
            Self::Parent => "parent",
            Self::Delay => "delay",
        }
    }
}

impl DeviceReading {
    /// Returns its values as a person reads them. Two values are equal if their texts are, except delays.
    pub(super) fn values(&self) -> [(Subject, Option<String>); 14] {
        let [vendor, product, revision, serial] = self.identity.map(|value| value.map(|value| format!("{value:08X}h")));
        let [mailbox_to, mailbox_from] = self.mailboxes.map(|area| area.map(Area::words));
        let bytes = |count: Option<u32>| count.map(|count| format!("{count} bytes"));
        [
            (Subject::Vendor, vendor),
            (Subject::Product, product),
            (Subject::Revision, revision),
            (Subject::Serial, serial),
            (Subject::Name, self.name.as_deref().map(shown)),
            (Subject::FullName, self.full_name.as_deref().map(shown)),
            (Subject::MailboxTo, mailbox_to),
            (Subject::MailboxFrom, mailbox_from),
            (Subject::Protocols, self.protocols.as_deref().map(listed)),
            (Subject::Outputs, bytes(self.outputs)),
            (Subject::Inputs, bytes(self.inputs)),
            (Subject::Ports, self.ports.as_deref().map(listed)),
            (Subject::Parent, self.parent.map(|parent| format!("position {parent}"))),
            (Subject::Delay, self.delay_ns.map(|delay| format!("{delay} ns"))),
        ]
    }

    /// Whether both have the same delays, except for rounding.
    fn has_delay_of(&self, other: &Self) -> bool {
        self.delay_ns.zip(other.delay_ns).is_some_and(|(own, other)| own.abs_diff(other) <= ROUNDING_NS)
    }
}

impl Area {
    fn words(self) -> String {
        if self.len == 0 { "none".to_owned() } else { format!("{:04X}h, {} bytes", self.start, self.len) }
    }
}

/// Returns a name as every master can show it: some show a byte that is not ASCII as a question mark.
fn shown(name: &str) -> String {
    let mut plain = String::new();
    for one in name.chars().map(|one| if one.is_ascii() { one } else { '?' }) {
        if one != '?' || !plain.ends_with('?') {
            plain.push(one);
        }
    }
    if plain.is_empty() { "none".to_owned() } else { format!("`{plain}`") }
}

fn listed(items: &[impl ToString]) -> String {
    let items: Vec<String> = items.iter().map(ToString::to_string).collect();
    if items.is_empty() { "none".to_owned() } else { items.join(", ") }
}

/// Values that both masters read, and read differently: in the order of positions, and of [`DeviceReading::values`].
pub(super) fn differences(own: &[DeviceReading], other: &[DeviceReading]) -> Vec<Difference> {
    let count = (own.len() != other.len()).then(|| Difference {
        position: None,
        subject: Subject::Devices,
        own: own.len().to_string(),
        other: other.len().to_string(),
    });
    let of_device = |(position, (own, other)): (u16, (&DeviceReading, &DeviceReading))| {
        let values = own.values().into_iter().zip(other.values());
        let differing = values.filter_map(|((subject, one), (_, another))| {
            let (one, another) = one.zip(another)?;
            let is_equal = one == another || subject == Subject::Delay && own.has_delay_of(other);
            (!is_equal).then_some(Difference { position: Some(position), subject, own: one, other: another })
        });
        differing.collect::<Vec<_>>()
    };
    count.into_iter().chain((0..).zip(own.iter().zip(other)).flat_map(of_device)).collect()
}
