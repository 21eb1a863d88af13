//! SII: what a device keeps in its memory chip for the master: identity, mailbox, sync managers, process data.
//!
//! ```text
//! words 0..8    configuration of the controller, checked by a CRC
//! words 8..40h  identity, mailboxes, protocols, size
//! words 40h..   categories: type, length in words, data; the last one has the type FFFFh
//! ```
//!
//! The reader takes hostile images: nothing is indexed unchecked, and categories and entries are bounded. It takes what is whole of a damaged
//! image; a warning names the word of what it leaves out.
//!
//! # Source
//! ETG.2010, SII specification; ETG.1000.6, 5.4. Checksum 88A4h: data sheet of the ET1100, section II, ESI EEPROM.

mod read;
#[cfg(test)]
mod tests;
mod text;
mod warning;
mod write;

pub use read::{Category, categories, chip_words, words_needed};
pub use warning::SiiWarning;

use super::{SyncManager, mailbox, registers, u16_at};

/// Words before the first category.
pub const FIRST_CATEGORY: usize = 0x40;
/// Words that an image may have: a chip of 64 kB.
pub const MOST_WORDS: usize = 0x8000;
/// Sync managers, FMMUs, process data objects and other categories that are kept of an image, each.
pub const MOST_ITEMS: usize = 256;
/// Entries of all process data objects together.
pub const MOST_ENTRIES: usize = 4096;

/// Types of categories.
pub mod category {
    /// Strings, numbered from 1.
    pub const STRINGS: u16 = 10;
    /// General.
    pub const GENERAL: u16 = 30;
    /// Use of the FMMUs.
    pub const FMMU: u16 = 40;
    /// Sync managers.
    pub const SYNC_MANAGERS: u16 = 41;
    /// Process data objects that the master reads.
    pub const TX_PDO: u16 = 50;
    /// Process data objects that the master writes.
    pub const RX_PDO: u16 = 51;
    /// Distributed clocks.
    pub const DC: u16 = 60;
    /// The end.
    pub const END: u16 = 0xffff;
}

/// Bits of the protocols that a mailbox carries (word 1Ch).
pub mod protocols {
    /// EoE.
    pub const EOE: u16 = 1 << 1;
    /// CoE.
    pub const COE: u16 = 1 << 2;
    /// FoE.
    pub const FOE: u16 = 1 << 3;
}

/// Bits of what a device's CoE can do.
pub mod coe_details {
    /// SDO.
    pub const SDO: u8 = 1 << 0;
    /// SDO information.
    pub const INFORMATION: u8 = 1 << 1;
    /// The master can choose the process data objects.
    pub const PDO_ASSIGN: u8 = 1 << 2;
    /// The master can choose the contents of process data objects.
    pub const PDO_CONFIGURATION: u8 = 1 << 3;
    /// Process data objects are read at the start.
    pub const UPLOAD: u8 = 1 << 4;
    /// Complete access.
    pub const COMPLETE_ACCESS: u8 = 1 << 5;
}

/// A mailbox: where it begins and how long it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MailboxArea {
    /// First byte of memory.
    pub start: u16,
    /// Bytes.
    pub len: u16,
}

/// Purpose of an FMMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FmmuUse(pub u8);

impl FmmuUse {
    /// Outputs.
    pub const OUTPUTS: FmmuUse = FmmuUse(1);
    /// Inputs.
    pub const INPUTS: FmmuUse = FmmuUse(2);
    /// State of the mailbox that the master reads.
    pub const MAILBOX_STATE: FmmuUse = FmmuUse(3);
}

/// Kind of a port of a controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PortUse(pub u8);

impl PortUse {
    /// Not used.
    pub const UNUSED: PortUse = PortUse(0);
    /// Ethernet, by MII.
    pub const MII: PortUse = PortUse(1);
    /// E-bus.
    pub const EBUS: PortUse = PortUse(3);
    /// Ethernet without autonegotiation, for fast hot connect.
    pub const FAST_HOT_CONNECT: PortUse = PortUse(4);
}

/// A category for whose content [`Sii`] has no field: the clock, and categories of vendors.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OtherCategory {
    /// Type.
    pub kind: u16,
    /// Content.
    pub bytes: Vec<u8>,
}

impl OtherCategory {
    /// Words before the content of a category: type and length.
    const HEAD: usize = 2;

    /// Returns the bytes that it adds to an image; none without content.
    pub fn written_len(&self) -> usize {
        if self.bytes.is_empty() { 0 } else { 2 * Self::HEAD + self.bytes.len().next_multiple_of(2) }
    }
}

/// A sync manager as the device wants it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SyncManagerUse {
    /// Settings.
    pub settings: SyncManager,
    /// 1 mailbox to the device, 2 mailbox from it, 3 outputs, 4 inputs; 0 unused.
    pub kind: u8,
}

/// One object in a process data object.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PdoEntry {
    /// Index; 0 for a gap.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Name; empty if the image has none.
    pub name: String,
    /// Index of the data type.
    pub data_type: u8,
    /// Length in bits.
    pub bits: u8,
}

/// A process data object as delivered.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pdo {
    /// Index.
    pub index: u16,
    /// Sync manager that carries it; FFh if none does.
    pub sync_manager: u8,
    /// Name.
    pub name: String,
    /// Its entries.
    pub entries: Vec<PdoEntry>,
}

/// Contents of a device's SII image.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Sii {
    /// Words 0 to 3: PDI control, PDI configuration, pulse length of SYNC in 10 ns, extended PDI configuration.
    pub pdi: [u16; 4],
    /// Alias address, word 4; 0 for none.
    pub alias: u16,
    /// Vendor, product code, revision and serial number: as in 1018h.
    pub vendor_id: u32,
    /// Product code.
    pub product_code: u32,
    /// Revision.
    pub revision: u32,
    /// Serial number.
    pub serial: u32,
    /// Mailbox to the device; no bytes without a mailbox.
    pub receive_mailbox: MailboxArea,
    /// Mailbox from the device.
    pub send_mailbox: MailboxArea,
    /// Mailboxes to the device and from it in BOOT (words 14h to 17h).
    pub bootstrap_mailboxes: [MailboxArea; 2],
    /// Protocols of the mailboxes: [`protocols`].
    pub protocols: u16,
    /// Name of the group of devices.
    pub group: String,
    /// Name of the device, by which masters show it.
    pub order: String,
    /// Full name of the device.
    pub name: String,
    /// Abilities of its CoE: [`coe_details`]; 0 where the image does not say.
    pub coe_details: u8,
    /// Current that it takes from the E-bus, mA.
    pub e_bus_ma: i16,
    /// Ports 0 to 3.
    pub ports: [PortUse; 4],
    /// Use of its FMMUs.
    pub fmmus: Vec<FmmuUse>,
    /// Sync managers.
    pub sync_managers: Vec<SyncManagerUse>,
    /// Process data objects that the master reads.
    pub tx_pdos: Vec<Pdo>,
    /// Process data objects that the master writes.
    pub rx_pdos: Vec<Pdo>,
    /// Other categories, in the order of the image.
    pub other_categories: Vec<OtherCategory>,
    /// Parts of the image that are damaged, missing or unusual. [`Sii::write`] takes no notice of them.
    pub warnings: Vec<SiiWarning>,
}

impl Sii {
    /// Returns the mailboxes to the device and from it. The sync managers define them, or else the head of the image (words 18h to 1Bh).
    /// Returns `None` for a device without mailboxes, or with impossible mailboxes.
    pub fn mailbox_areas(&self) -> Option<[MailboxArea; 2]> {
        let is_possible = |area: &MailboxArea| {
            (mailbox::SHORTEST..=mailbox::LONGEST).contains(&area.len.into()) && area.start >= registers::PROCESS_DATA
        };
        let area = |kind, of_head| self.manager_area(kind).into_iter().chain([of_head]).find(is_possible);
        Some([area(1, self.receive_mailbox)?, area(2, self.send_mailbox)?])
    }

    /// Returns sync managers 0 and 1 for its mailboxes, to the device and from it; `None` as [`Sii::mailbox_areas`].
    pub fn mailbox_managers(&self) -> Option<[SyncManager; 2]> {
        let [to, from] = self.mailbox_areas()?;
        let control = SyncManager::MAILBOX | SyncManager::INTERRUPT;
        let settings = |area: MailboxArea, control| SyncManager {
            start: area.start,
            len: area.len,
            control,
            is_enabled: true,
            repeat: false,
        };
        Some([settings(to, control | SyncManager::WRITE), settings(from, control)])
    }

    /// Whether its mailboxes carry CoE.
    pub fn has_coe(&self) -> bool {
        self.protocols & protocols::COE != 0
    }

    /// Whether it says that it has neither mailboxes nor a protocol for them, as couplers and digital terminals do.
    pub fn is_without_mailbox(&self) -> bool {
        self.protocols == 0 && self.mailbox_areas().is_none()
    }

    /// Whether it says that its CoE has SDO and no SDO information.
    pub fn lacks_information(&self) -> bool {
        self.coe_details & (coe_details::SDO | coe_details::INFORMATION) == coe_details::SDO
    }

    /// Returns the area of the first sync manager of a kind; `None` without one, or if it has no bytes.
    fn manager_area(&self, kind: u8) -> Option<MailboxArea> {
        let manager = self.sync_managers.iter().find(|manager| manager.kind == kind)?.settings;
        (manager.len > 0).then_some(MailboxArea { start: manager.start, len: manager.len })
    }
}

/// Reason why an image cannot be read. Words are counted from 0, as tools show them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SiiError {
    /// It is shorter than its head.
    #[error("the image ends at word {words:04X}h, but the head needs word {needed:04X}h")]
    Short {
        /// Words that are there.
        words: usize,
        /// The last word of the head.
        needed: usize,
    },
    /// Nothing is programmed.
    #[error("the chip is empty: all its bytes are {byte:02X}h")]
    Empty {
        /// The value of all bytes.
        byte: u8,
    },
}

/// Returns the checksum of the first 14 bytes: CRC-8 with the polynomial 07h, from FFh.
pub fn checksum(bytes: &[u8; 14]) -> u8 {
    bytes.iter().fold(0xff, |crc, byte| {
        (0..8).fold(crc ^ byte, |crc: u8, _| if crc & 0x80 != 0 { crc << 1 ^ 0x07 } else { crc << 1 })
    })
}

/// The words with the alias, the checksum, and the size of the chip in kbit less 1.
const ALIAS: usize = 0x04;
const CHECKSUM: usize = 0x07;
const SIZE: usize = 0x3e;
/// In place of the checksum: the controller does not check.
const UNCHECKED: u16 = 0x88a4;

/// Whether a controller loads words 0 to 6 of an image: their checksum is right, or switched off by 88A4h.
pub fn is_loaded(image: &[u8]) -> bool {
    let (Some(head), word) = (image.first_chunk(), u16_at(image, 2 * CHECKSUM)) else { return false };
    word == UNCHECKED || word & 0xff == u16::from(checksum(head))
}

/// Updates the checksum of an image; does nothing without a head.
pub fn seal(image: &mut [u8]) {
    let Some(head) = image.first_chunk().copied() else { return };
    let sum = checksum(&head);
    if let Some(word) = image.get_mut(2 * CHECKSUM..2 * CHECKSUM + 2) {
        word.copy_from_slice(&[sum, 0]);
    }
}

/// Sets another alias in an image, 0 for none, and updates its checksum.
pub fn set_alias(image: &mut [u8], alias: u16) {
    if let Some(word) = image.get_mut(2 * ALIAS..2 * ALIAS + 2) {
        word.copy_from_slice(&alias.to_le_bytes());
    }
    seal(image);
}

/// Returns the words of an image that differ from those that a chip holds, with their numbers.
pub fn changes(held: &[u8], image: &[u8]) -> Vec<(u16, [u8; 2])> {
    let (words, _) = image.as_chunks::<2>();
    let (held, _) = held.as_chunks::<2>();
    let each = words.iter().take(MOST_WORDS).enumerate();
    each.filter(|(at, word)| held.get(*at) != Some(word)).map(|(at, word)| (at as u16, *word)).collect()
}
