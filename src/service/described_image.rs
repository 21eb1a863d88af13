//! The SII image of a device, made of its description (ESI).
//!
//! # Source
//! ETG.2000, element `Eeprom`; ETG.2010, categories; numbers of data types: ETG.1020, base data types.

use yieldwall_drives::esi::{self, Esi};
use yieldwall_fieldbus::ethercat::SyncManager;
use yieldwall_fieldbus::ethercat::sii::{
    FmmuUse, MailboxArea, Pdo, PdoEntry, Sii, SyncManagerUse, chip_words, coe_details, protocols, seal,
};

/// Bytes that `ConfigData` may say: words 0 to 7. Those of words 4 and 7, alias and checksum, are not taken from it.
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
    /// Parts for which the chip has no room: names of entries, or the process data objects, which the device reports by CoE as well.
    pub left_out: Option<&'static str>,
}

/// The image of a device of a description, with this alias and serial number: the head, names, general part, FMMUs, sync managers and process
/// data objects. The modes of its clock are left out: masters take them from the description.
///
/// # Errors
/// If the description does not say how the controller is configured, or the chip has no room for the image.
pub fn described_image(esi: &Esi, device: &esi::Device, alias: u16, serial: u32) -> Result<DescribedImage, ImageError> {
    if device.config_data.is_empty() {
        return Err(ImageError::NoConfiguration);
    }
    let config = bytes("ConfigData", &device.config_data, 2, MOST_CONFIG)?;
    let mut sii = Sii { alias, serial, ..sii_of(esi, device, &config)? };
    let room = device.eeprom_bytes.map(|bytes| bytes as usize);
    let fits = |sii: &Sii| room.is_none_or(|room| sii.write().len() <= room);
    let mut left_out = None;
    if !fits(&sii) {
        left_out = Some("names of entries");
        let pdos = sii.rx_pdos.iter_mut().chain(&mut sii.tx_pdos);
        pdos.flat_map(|pdo| &mut pdo.entries).for_each(|entry| entry.name.clear());
    }
    if !fits(&sii) && sii.has_coe() {
        left_out = Some("process data objects");
        (sii.rx_pdos, sii.tx_pdos) = (Vec::new(), Vec::new());
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
        fmmus: device.fmmus.iter().map(|word| fmmu(word)).collect(),
        sync_managers,
        tx_pdos: device.tx_pdos.iter().map(pdo).collect::<Result<_, _>>()?,
        rx_pdos: device.rx_pdos.iter().map(pdo).collect::<Result<_, _>>()?,
        ..Sii::default()
    })
}

/// Bytes in hexadecimal digits.
fn bytes(element: &'static str, text: &str, least: usize, most: usize) -> Result<Vec<u8>, ImageError> {
    let digits: Option<Vec<u8>> = text.chars().map(|char| Some(char.to_digit(16)? as u8)).collect();
    let (pairs, rest) = digits.as_deref().unwrap_or_default().as_chunks::<2>();
    if !rest.is_empty() || !(least..=most).contains(&pairs.len()) {
        return Err(ImageError::Digits { element, least, most });
    }
    Ok(pairs.iter().map(|[high, low]| high << 4 | low).collect())
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
