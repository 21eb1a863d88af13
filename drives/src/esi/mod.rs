//! EtherCAT slave information (ESI): the data sheet of an EtherCAT device, an XML file of its vendor.
//!
//! The reader is streamed and safe against hostile files: it refuses document types and own entities, and it limits sizes, depth
//! and numbers of items. It skips unknown elements. Texts are as in the file: not checked for control characters.
//!
//! # Source
//! ETG.2000, *EtherCAT slave information specification*; names are those of the file format.

mod modules;
mod read;
#[cfg(test)]
mod tests;
mod write;

pub use modules::{AxisSteps, ModuleError, PluggedModule, axis_steps};
pub use read::hex_bytes;

/// Largest file that is read, in bytes.
pub const MAX_BYTES: usize = 64 << 20;
/// Deepest nesting of elements.
pub const MAX_DEPTH: usize = 64;
/// Most devices, process data objects, entries and other items together.
pub const MAX_ITEMS: usize = 1_000_000;
/// Most categories for the SII of a device.
pub const MAX_CATEGORIES: usize = 256;
/// Most slots of a device: F030h and F050h have a sub-index for each.
///
/// # Source
/// ETG.5001.1, modular device profile.
pub const MAX_SLOTS: usize = 255;
/// Longest text of an element, in bytes.
pub const MAX_TEXT: usize = 1 << 16;

/// Contents of a device description file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Esi {
    /// Vendor: its number, 1018h:1.
    pub vendor_id: u32,
    /// Its name.
    pub vendor: String,
    /// Devices, in the order of the file.
    pub devices: Vec<Device>,
    /// Modules for the slots of the devices, in the order of the file.
    pub modules: Vec<Module>,
}

/// One device, in one revision.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Device {
    /// Ports 0 to 3, a letter each: `Y` Ethernet, `K` E-bus, `H` Ethernet for fast hot connect, a space for a port without use.
    pub physics: String,
    /// Type, a short name.
    pub type_name: String,
    /// Product code, 1018h:2.
    pub product_code: u32,
    /// Revision, 1018h:3.
    pub revision: u32,
    /// Name; the one in English if there are several.
    pub name: String,
    /// Its group.
    pub group: String,
    /// Number of the device profile, as 402.
    pub profile: Option<u32>,
    /// Purposes of its FMMUs: `Outputs`, `Inputs`, `MBoxState`.
    pub fmmus: Vec<String>,
    /// Sync managers, in order.
    pub sync_managers: Vec<SyncManager>,
    /// Process data objects that the master writes.
    pub rx_pdos: Vec<Pdo>,
    /// Process data objects that the master reads.
    pub tx_pdos: Vec<Pdo>,
    /// Places for modules.
    pub slots: Vec<Slot>,
    /// Abilities of its CoE; `None` without CoE.
    pub coe: Option<Coe>,
    /// Ways to work with distributed clocks.
    pub op_modes: Vec<OpMode>,
    /// Time for an answer of the mailbox, in ms.
    pub mailbox_response_ms: Option<u32>,
    /// Time from INIT to PRE-OP, in ms.
    pub pre_op_ms: Option<u32>,
    /// Time to SAFE-OP or OP, in ms.
    pub safe_op_ms: Option<u32>,
    /// Whether its mailboxes carry EoE.
    pub has_eoe: bool,
    /// Whether its mailboxes carry FoE.
    pub has_foe: bool,
    /// Current that it takes from the E-bus, mA.
    pub e_bus_ma: Option<i32>,
    /// Size of its SII, in bytes.
    pub eeprom_bytes: Option<u32>,
    /// The first bytes of its SII, which configure the controller, in hexadecimal digits as the file has them. Empty if it has none.
    pub config_data: String,
    /// Words 14h to 17h of its SII, the mailboxes in BOOT, likewise.
    pub bootstrap: String,
    /// Further categories of its SII.
    pub categories: Vec<Category>,
}

/// One or more places of a device for modules. A module in the second place of a device has its PDOs and objects further on by the increments,
/// and so on.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Slot {
    /// Name.
    pub name: String,
    /// Fewest modules.
    pub min_instances: u32,
    /// Most modules, as many places as the device has in a row.
    pub max_instances: u32,
    /// Distance of PDOs from a place to the next.
    pub pdo_increment: u16,
    /// Distance of objects from a place to the next.
    pub index_increment: u16,
    /// Modules that fit, by their identification.
    pub idents: Vec<u32>,
    /// The module that is there unless another one is named.
    pub default: Option<u32>,
    /// Classes of modules that fit.
    pub classes: Vec<String>,
}

/// A module for a slot.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Module {
    /// Identification, as in F030h and F050h.
    pub ident: u32,
    /// Class; empty if it has none.
    pub class: String,
    /// Type, a short name.
    pub type_name: String,
    /// Name; the one in English if there are several.
    pub name: String,
    /// Process data objects that the master writes, as in the first place of a device.
    pub rx_pdos: Vec<Pdo>,
    /// Process data objects that the master reads, as in the first place of a device.
    pub tx_pdos: Vec<Pdo>,
    /// Whether an index of it depends on a group of slots.
    pub has_slot_groups: bool,
}

/// A category for the SII of a device.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Category {
    /// Type.
    pub number: u16,
    /// Content.
    pub bytes: Vec<u8>,
}

/// A sync manager.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SyncManager {
    /// `MBoxOut`, `MBoxIn`, `Outputs` or `Inputs`.
    pub kind: String,
    /// First byte of memory.
    pub start: u16,
    /// Control byte.
    pub control: u8,
    /// Bytes as delivered, at least, at most.
    pub default_size: Option<u16>,
    /// Least bytes.
    pub min_size: Option<u16>,
    /// Most bytes.
    pub max_size: Option<u16>,
    /// Whether it is in use.
    pub is_enabled: bool,
}

/// A process data object.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pdo {
    /// Index.
    pub index: u16,
    /// Name.
    pub name: String,
    /// Sync manager that carries it as delivered.
    pub sync_manager: Option<u8>,
    /// Whether its contents cannot be changed.
    pub is_fixed: bool,
    /// Whether it has to be exchanged.
    pub is_mandatory: bool,
    /// Whether index and `excludes` of a module's process data object depend on its slot.
    pub depends_on_slot: bool,
    /// Others that cannot be exchanged with it.
    pub excludes: Vec<u16>,
    /// Objects that it carries.
    pub entries: Vec<PdoEntry>,
}

/// One object in a process data object; index 0 is a gap.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PdoEntry {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Length in bits.
    pub bits: u16,
    /// Name.
    pub name: String,
    /// Data type by name, as `UINT`.
    pub data_type: String,
    /// Whether the index of a module's entry depends on its slot.
    pub depends_on_slot: bool,
}

/// Abilities of the CoE of a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Coe {
    /// Whether it supports SDO information.
    pub information: bool,
    /// Whether the master can choose the process data objects that are exchanged.
    pub pdo_assign: bool,
    /// Whether the master can choose the contents of the process data objects.
    pub pdo_configuration: bool,
    /// Whether it supports complete access.
    pub complete_access: bool,
    /// Whether it supports segmented transfers.
    pub segmented: bool,
}

/// A way to work with distributed clocks.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OpMode {
    /// Name.
    pub name: String,
    /// Value for registers 0980h and 0981h.
    pub assign_activate: u16,
    /// Cycle of SYNC0 in ns; 0 for that of the master.
    pub sync0_cycle_ns: u32,
    /// Factor to the cycle of the master.
    pub sync0_factor: i32,
    /// Shift of SYNC0 in ns.
    pub sync0_shift_ns: i32,
    /// Cycle of SYNC1 in ns; 0 for that of SYNC0.
    pub sync1_cycle_ns: u32,
    /// Shift of SYNC1 against SYNC0 in ns.
    pub sync1_shift_ns: i32,
}

impl OpMode {
    /// Whether it switches SYNC1 on: bit 2 of 0981h.
    pub fn has_sync1(&self) -> bool {
        self.assign_activate & 0x0400 != 0
    }
}

/// Why a file cannot be read; lines are counted from 1.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EsiError {
    /// It is larger than [`MAX_BYTES`].
    #[error("the file has {0} bytes, more than the 64 MiB that are read")]
    TooLarge(usize),
    /// It is no XML.
    #[error("line {line}: this is no XML: {what}")]
    Xml {
        /// Line.
        line: usize,
        /// Message of the XML reader.
        what: String,
    },
    /// It brings a document type or an entity of its own.
    #[error("line {line}: {what} is refused: a device description needs none")]
    Refused {
        /// Line.
        line: usize,
        /// Name of the refused item.
        what: &'static str,
    },
    /// Too deep, too long or too many.
    #[error("line {line}: more than {most} {what}")]
    TooMuch {
        /// Line.
        line: usize,
        /// Name of the limited quantity.
        what: &'static str,
        /// Largest allowed number.
        most: usize,
    },
    /// A number that is none, or too large for what it means.
    #[error("line {line}: {element} is `{text}`, which is no number from 0 to {most}")]
    Number {
        /// Line.
        line: usize,
        /// Element or attribute.
        element: &'static str,
        /// Text of the element or attribute, shortened, without control characters.
        text: String,
        /// Greatest number there.
        most: u64,
    },
    /// Digits that are no bytes.
    #[error("line {line}: {element} is no even number of hexadecimal digits")]
    Digits {
        /// Line.
        line: usize,
        /// Element.
        element: &'static str,
    },
    /// Its outermost element is not `EtherCATInfo`.
    #[error("the file has no element EtherCATInfo: it is no device description")]
    NoDescription,
}
