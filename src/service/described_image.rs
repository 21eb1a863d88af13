//! The SII image of a device, made of its description (ESI).
//!
//! # Source
//! ETG.2000, element `Eeprom`; ETG.2010, categories; numbers of data types: ETG.1020, base data types.

use yieldwall_drives::esi::{self, Esi};
use yieldwall_fieldbus::ethercat::SyncManager;
use yieldwall_fieldbus::ethercat::sii::{
    FmmuUse, MOST_WORDS, MailboxArea, OtherCategory, Pdo, PdoEntry, PortUse, Sii, SyncManagerUse, category, chip_words,
    coe_details, protocols, seal,
};

/// Bytes that `ConfigData` may hold: words 0 to 7. The bytes of words 4 and 7, alias and checksum, are not taken from it.
const MOST_CONFIG: usize = 16;
/// Bytes of `BootStrap`: two mailboxes.
const BOOTSTRAP: usize = 8;
/// The reserved words 5 and 6, which some controllers use, as bytes of the image.
const RESERVED: std::ops::Range<usize> = 10..14;
/// The word with the size of the chip in kbit less 1.
const SIZE: usize = 0x3e;
/// An `Sm` that carries no process data object.
const NO_MANAGER: u8 = 0xff;

/// Why a description makes no image.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// The configuration of the controller is not there; a wrong one can damage a device.
    #[error("the file has no ConfigData of this device, by which its controller is configured")]
    NoConfiguration,
    /// An element does not hold as many bytes as it should.
    #[error("{element} of this device is no hexadecimal number of {least} to {most} bytes")]
    Digits {
        /// The element.
        element: &'static str,
        /// Fewest bytes.
        least: usize,
        /// Most bytes.
        most: usize,
    },
    /// A controller has no such ports.
    #[error(
        "Physics of this device is `{0}`: a controller has 4 ports, Y for Ethernet, K for E-bus, H for fast hot connect, a space for none"
    )]
    Physics(String),
    /// The image has no room for an entry.
    #[error("PDO {pdo:04X}h has an entry of {bits} bits, and an image has room for 255")]
    Entry {
        /// Index of the process data object.
        pdo: u16,
        /// Bits of the entry.
        bits: u16,
    },
    /// The chip has no room for the image.
    #[error("the image has {bytes} bytes, and the file says that the chip has {room}")]
    TooLong {
        /// Bytes of the image.
        bytes: usize,
        /// Bytes of the chip.
        room: usize,
    },
}

/// An image made of a description.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DescribedImage {
    /// Its bytes.
    pub image: Vec<u8>,
    /// Parts of the description that are not in it.
    pub left_out: Vec<LeftOutOfImage>,
}

/// A part of a description that is not in the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeftOutOfImage {
    /// Names of entries.
    EntryNames,
    /// Process data objects, which the device reports by CoE.
    ProcessData,
    /// Process data objects of the modules in its slots.
    Modules,
    /// A category for which the chip has no room.
    Category(u16),
    /// A category that the image makes of other elements, or whose type is the end of an image.
    OwnCategory(u16),
}

impl std::fmt::Display for LeftOutOfImage {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::EntryNames => write!(formatter, "names of entries, for which the chip has no room"),
            Self::ProcessData => write!(formatter, "process data objects, for which the chip has no room"),
            Self::Modules => {
                write!(
                    formatter,
                    "process data objects of modules: they depend on the plugged modules, which a device with CoE reports itself"
                )
            }
            Self::Category(number) => write!(formatter, "category {number}, for which the chip has no room"),
            Self::OwnCategory(number) => {
                write!(formatter, "category {number}, whose type belongs to another part of the image")
            }
        }
    }
}

/// Returns the image of a device of a description, with this alias and serial number. It has the head, names, general part,
/// FMMUs, sync managers and process data objects, then the further categories of the description.
///
/// The image leaves out the modes of the device's clock: masters take them from the description. It also leaves out the process
/// data of modules, because they change with the modules. In a small chip, further categories have precedence over names of
/// entries and over process data objects that CoE reports.
///
/// # Errors
/// If the description does not say how the controller is configured or has impossible ports, or the chip has no room for the image.
pub fn described_image(esi: &Esi, device: &esi::Device, alias: u16, serial: u32) -> Result<DescribedImage, ImageError> {
    if device.config_data.is_empty() {
        return Err(ImageError::NoConfiguration);
    }
    let config = bytes("ConfigData", &device.config_data, 2, MOST_CONFIG)?;
    let mut sii = Sii { alias, serial, ..sii_of(esi, device, &config)? };
    let room = device.eeprom_bytes.map(|bytes| bytes as usize);
    let (others, mut left_out) = other_categories(&sii, device, room.unwrap_or(2 * MOST_WORDS));
    sii.other_categories = others;
    if !device.slots.is_empty() {
        left_out.insert(0, LeftOutOfImage::Modules);
    }
    let fits = |sii: &Sii| room.is_none_or(|room| sii.write().len() <= room);
    if !fits(&sii) {
        left_out.push(LeftOutOfImage::EntryNames);
        sii = without_names(sii);
    }
    if !fits(&sii) && sii.has_coe() {
        left_out.push(LeftOutOfImage::ProcessData);
        sii = without_pdos(sii);
    }
    let mut image = sii.write();
    if let Some(room) = room {
        if image.len() > room {
            return Err(ImageError::TooLong { bytes: image.len(), room });
        }
        // 2048 bytes are 16 kbit; the word holds one less.
        if room > 2 * chip_words(&image) {
            let kbit = u16::try_from(room / 128 - 1).unwrap_or(u16::MAX);
            image[2 * SIZE..2 * SIZE + 2].copy_from_slice(&kbit.to_le_bytes());
        }
    }
    if let Some(reserved) = config.get(RESERVED) {
        image[RESERVED].copy_from_slice(reserved);
    }
    seal(&mut image);
    Ok(DescribedImage { image, left_out })
}

fn without_names(mut sii: Sii) -> Sii {
    let pdos = sii.rx_pdos.iter_mut().chain(&mut sii.tx_pdos);
    pdos.flat_map(|pdo| &mut pdo.entries).for_each(|entry| entry.name.clear());
    sii
}

fn without_pdos(sii: Sii) -> Sii {
    Sii { rx_pdos: Vec::new(), tx_pdos: Vec::new(), ..sii }
}

/// The further categories of a description that fit beside the smallest image of the device, and those that are left out.
fn other_categories(sii: &Sii, device: &esi::Device, room: usize) -> (Vec<OtherCategory>, Vec<LeftOutOfImage>) {
    use category::{END, FMMU, GENERAL, RX_PDO, STRINGS, SYNC_MANAGERS, TX_PDO};

    let smallest = without_names(sii.clone());
    let smallest = if sii.has_coe() { without_pdos(smallest) } else { smallest };
    let mut bytes = smallest.write().len();
    let (mut kept, mut left_out) = (Vec::new(), Vec::new());
    for esi::Category { number, bytes: content } in &device.categories {
        let other = OtherCategory { kind: *number, bytes: content.clone() };
        if matches!(*number, STRINGS | GENERAL | FMMU | SYNC_MANAGERS | TX_PDO | RX_PDO | END) {
            left_out.push(LeftOutOfImage::OwnCategory(*number));
        } else if bytes + other.written_len() > room {
            left_out.push(LeftOutOfImage::Category(*number));
        } else {
            bytes += other.written_len();
            kept.push(other);
        }
    }
    (kept, left_out)
}

/// The ports of the letters of a description.
fn ports(physics: &str) -> Result<[PortUse; 4], ImageError> {
    let impossible = || ImageError::Physics(physics.chars().filter(|char| !char.is_control()).take(40).collect());
    let mut ports = [PortUse::UNUSED; 4];
    for (place, letter) in physics.chars().enumerate() {
        *ports.get_mut(place).ok_or_else(impossible)? = match letter {
            'Y' => PortUse::MII,
            'K' => PortUse::EBUS,
            'H' => PortUse::FAST_HOT_CONNECT,
            ' ' => PortUse::UNUSED,
            _ => return Err(impossible()),
        };
    }
    Ok(ports)
}

fn sii_of(esi: &Esi, device: &esi::Device, config: &[u8]) -> Result<Sii, ImageError> {
    let word = |at: usize| config.get(2 * at..2 * at + 2).map_or(0, |word| u16::from_le_bytes([word[0], word[1]]));
    let sync_managers: Vec<SyncManagerUse> = device.sync_managers.iter().map(|own| manager(own, device)).collect();
    let mailbox = |kind: u8| {
        let of_kind = sync_managers.iter().find(|manager| manager.kind == kind);
        of_kind.map_or(MailboxArea::default(), |SyncManagerUse { settings, .. }| MailboxArea {
            start: settings.start,
            len: settings.len,
        })
    };
    let protocol = |is_there: bool, bit: u16| if is_there { bit } else { 0 };
    Ok(Sii {
        pdi: [0, 1, 2, 3].map(word),
        vendor_id: esi.vendor_id,
        product_code: device.product_code,
        revision: device.revision,
        receive_mailbox: mailbox(1),
        send_mailbox: mailbox(2),
        bootstrap_mailboxes: bootstrap(&device.bootstrap)?,
        protocols: protocol(device.coe.is_some(), protocols::COE)
            | protocol(device.has_eoe, protocols::EOE)
            | protocol(device.has_foe, protocols::FOE),
        group: device.group.clone(),
        order: device.type_name.clone(),
        name: device.name.clone(),
        coe_details: device.coe.map_or(0, details),
        e_bus_ma: device.e_bus_ma.and_then(|ma| i16::try_from(ma).ok()).unwrap_or_default(),
        ports: ports(&device.physics)?,
        fmmus: device.fmmus.iter().map(|word| fmmu(word)).collect(),
        sync_managers,
        tx_pdos: device.tx_pdos.iter().map(pdo).collect::<Result<_, _>>()?,
        rx_pdos: device.rx_pdos.iter().map(pdo).collect::<Result<_, _>>()?,
        ..Sii::default()
    })
}

/// Bytes in hexadecimal digits.
fn bytes(element: &'static str, text: &str, least: usize, most: usize) -> Result<Vec<u8>, ImageError> {
    let bytes = esi::hex_bytes(text).filter(|bytes| (least..=most).contains(&bytes.len()));
    bytes.ok_or(ImageError::Digits { element, least, most })
}

fn bootstrap(text: &str) -> Result<[MailboxArea; 2], ImageError> {
    if text.is_empty() {
        return Ok(Default::default());
    }
    let bytes = bytes("BootStrap", text, BOOTSTRAP, BOOTSTRAP)?;
    let word = |at: usize| bytes.get(2 * at..2 * at + 2).map_or(0, |word| u16::from_le_bytes([word[0], word[1]]));
    Ok([0, 2].map(|at| MailboxArea { start: word(at), len: word(at + 1) }))
}

fn details(coe: esi::Coe) -> u8 {
    let bit = |is_there: bool, bit: u8| if is_there { bit } else { 0 };
    coe_details::SDO
        | bit(coe.information, coe_details::INFORMATION)
        | bit(coe.pdo_assign, coe_details::PDO_ASSIGN)
        | bit(coe.pdo_configuration, coe_details::PDO_CONFIGURATION)
        | bit(coe.complete_access, coe_details::COMPLETE_ACCESS)
}

fn fmmu(word: &str) -> FmmuUse {
    match word {
        "Outputs" => FmmuUse::OUTPUTS,
        "Inputs" => FmmuUse::INPUTS,
        "MBoxState" => FmmuUse::MAILBOX_STATE,
        _ => FmmuUse(0xff),
    }
}

/// A sync manager. Process data without a size have that of the process data objects it carries.
fn manager(own: &esi::SyncManager, device: &esi::Device) -> SyncManagerUse {
    let (kind, pdos) = match own.kind.as_str() {
        "MBoxOut" => (1, None),
        "MBoxIn" => (2, None),
        "Outputs" => (3, Some(&device.rx_pdos)),
        "Inputs" => (4, Some(&device.tx_pdos)),
        _ => (0, None),
    };
    let number = device.sync_managers.iter().position(|other| std::ptr::eq(other, own));
    let carried = pdos.into_iter().flatten().filter(|pdo| pdo.sync_manager.map(usize::from) == number);
    let bits: usize = carried.flat_map(|pdo| &pdo.entries).map(|entry| usize::from(entry.bits)).sum();
    let len = own.default_size.or_else(|| u16::try_from(bits.div_ceil(8)).ok()).unwrap_or_default();
    let settings =
        SyncManager { start: own.start, len, control: own.control, is_enabled: own.is_enabled, repeat: false };
    SyncManagerUse { settings, kind }
}

fn pdo(pdo: &esi::Pdo) -> Result<Pdo, ImageError> {
    let entry = |entry: &esi::PdoEntry| {
        let bits = u8::try_from(entry.bits).map_err(|_| ImageError::Entry { pdo: pdo.index, bits: entry.bits })?;
        let (name, data_type) = (entry.name.clone(), data_type(&entry.data_type));
        Ok(PdoEntry { index: entry.index, sub: entry.sub, name, data_type, bits })
    };
    Ok(Pdo {
        index: pdo.index,
        sync_manager: pdo.sync_manager.unwrap_or(NO_MANAGER),
        name: pdo.name.clone(),
        entries: pdo.entries.iter().map(entry).collect::<Result<_, _>>()?,
    })
}

/// The number of a data type, 0 for one that has none below 256.
fn data_type(name: &str) -> u8 {
    match name {
        "BOOL" => 0x01,
        "SINT" => 0x02,
        "INT" => 0x03,
        "DINT" => 0x04,
        "USINT" => 0x05,
        "UINT" => 0x06,
        "UDINT" => 0x07,
        "REAL" => 0x08,
        "LREAL" => 0x11,
        "LINT" => 0x15,
        "ULINT" => 0x1b,
        "BYTE" => 0x1e,
        "WORD" => 0x1f,
        "DWORD" => 0x20,
        // BIT1 to BIT8.
        _ => match name.strip_prefix("BIT").and_then(|bits| bits.parse::<u8>().ok()) {
            Some(bits @ 1..=8) => 0x2f + bits,
            _ => 0,
        },
    }
}

#[cfg(test)]
mod tests;
