//! Writing an image.

use super::{FIRST_CATEGORY, OtherCategory, Pdo, Sii, category, checksum};

/// The strings of an image, each once, numbered from 1.
#[derive(Default)]
struct Strings(Vec<Vec<u8>>);

impl Strings {
    /// Returns the number of a string: 0 for an empty one, and for one that has no number left. 255 bytes are kept of it at most.
    fn number(&mut self, text: &str) -> u8 {
        let bytes = super::text::encode(text);
        if bytes.is_empty() {
            return 0;
        }
        let place = self.0.iter().position(|known| *known == bytes).unwrap_or_else(|| {
            if self.0.len() < 255 {
                self.0.push(bytes);
                self.0.len() - 1
            } else {
                255
            }
        });
        u8::try_from(place + 1).unwrap_or(0)
    }

    fn bytes(&self) -> Vec<u8> {
        let count = [self.0.len() as u8];
        let each = self.0.iter().flat_map(|text| [&[text.len() as u8][..], text].concat());
        count.into_iter().chain(each).collect()
    }
}

fn append(image: &mut Vec<u8>, kind: u16, mut bytes: Vec<u8>) {
    if bytes.is_empty() {
        return;
    }
    bytes.resize(bytes.len().next_multiple_of(2), 0);
    image.extend(kind.to_le_bytes());
    image.extend(((bytes.len() / 2) as u16).to_le_bytes());
    image.extend(bytes);
}

fn pdos(pdos: &[Pdo], strings: &mut Strings) -> Vec<u8> {
    let mut bytes = Vec::new();
    for pdo in pdos {
        let entries = pdo.entries.get(..255).unwrap_or(&pdo.entries);
        bytes.extend(pdo.index.to_le_bytes());
        bytes.extend([entries.len() as u8, pdo.sync_manager, 0, strings.number(&pdo.name), 0, 0]);
        for entry in entries {
            bytes.extend(entry.index.to_le_bytes());
            bytes.extend([entry.sub, strings.number(&entry.name), entry.data_type, entry.bits, 0, 0]);
        }
    }
    bytes
}

impl Sii {
    /// Returns the image with its checksum, as long as it has to be.
    pub fn write(&self) -> Vec<u8> {
        let mut strings = Strings::default();
        let mut general = [0; 32];
        // SOEM takes the first string for the name of the device.
        general[2] = strings.number(&self.order);
        general[3] = strings.number(&self.name);
        general[0] = strings.number(&self.group);
        general[5] = self.coe_details;
        general[6] = u8::from(self.protocols & super::protocols::FOE != 0);
        general[7] = u8::from(self.protocols & super::protocols::EOE != 0);
        general[12..14].copy_from_slice(&self.e_bus_ma.to_le_bytes());
        let [a, b, c, d] = self.ports.map(|port| port.0 & 0x0f);
        general[16..18].copy_from_slice(&[b << 4 | a, d << 4 | c]);
        let mut fmmus: Vec<u8> = self.fmmus.iter().map(|fmmu| fmmu.0).collect();
        fmmus.resize(fmmus.len().next_multiple_of(2), 0xff);
        let managers = self.sync_managers.iter().flat_map(|manager| {
            let mut bytes = manager.settings.encode();
            bytes[7] = manager.kind;
            bytes
        });
        let managers = managers.collect();
        let (tx, rx) = (pdos(&self.tx_pdos, &mut strings), pdos(&self.rx_pdos, &mut strings));

        let mut image = self.head();
        append(&mut image, category::STRINGS, strings.bytes());
        append(&mut image, category::GENERAL, general.to_vec());
        append(&mut image, category::FMMU, fmmus);
        append(&mut image, category::SYNC_MANAGERS, managers);
        append(&mut image, category::TX_PDO, tx);
        append(&mut image, category::RX_PDO, rx);
        for OtherCategory { kind, bytes } in &self.other_categories {
            append(&mut image, *kind, bytes.clone());
        }
        image.extend(category::END.to_le_bytes());
        // The size of the chip, in kbit less 1: the next power of two.
        let kbit = (image.len() * 8).div_ceil(1024).next_power_of_two().max(16);
        image[2 * 0x3e..2 * 0x3f].copy_from_slice(&((kbit - 1) as u16).to_le_bytes());
        image
    }

    fn head(&self) -> Vec<u8> {
        let mut head = vec![0; 2 * FIRST_CATEGORY];
        let mut put = |word: usize, bytes: &[u8]| head[2 * word..2 * word + bytes.len()].copy_from_slice(bytes);
        for (word, value) in self.pdi.iter().enumerate() {
            put(word, &value.to_le_bytes());
        }
        put(0x04, &self.alias.to_le_bytes());
        put(0x08, &self.vendor_id.to_le_bytes());
        put(0x0a, &self.product_code.to_le_bytes());
        put(0x0c, &self.revision.to_le_bytes());
        put(0x0e, &self.serial.to_le_bytes());
        let [boot_receive, boot_send] = self.bootstrap_mailboxes;
        let areas = [boot_receive, boot_send, self.receive_mailbox, self.send_mailbox];
        for (word, area) in [0x14, 0x16, 0x18, 0x1a].into_iter().zip(areas) {
            put(word, &area.start.to_le_bytes());
            put(word + 1, &area.len.to_le_bytes());
        }
        put(0x1c, &self.protocols.to_le_bytes());
        put(0x3f, &1u16.to_le_bytes());
        let sum = checksum(&super::super::array(&head, 0));
        head[14] = sum;
        head
    }
}
