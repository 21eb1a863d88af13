//! Reading an image.

use super::super::{SyncManager, array, u16_at, u32_at};
use super::{
    FIRST_CATEGORY, FmmuUse, MOST_ENTRIES, MOST_ITEMS, MOST_WORDS, MailboxArea, Pdo, PdoEntry, Sii, SiiError,
    SyncManagerUse, category, checksum,
};

/// One category of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Category<'a> {
    /// Its type.
    pub kind: u16,
    /// First word of its header.
    pub word: usize,
    /// Its bytes.
    pub bytes: &'a [u8],
}

/// The categories of an image, one after the other; after an error there are no more.
pub fn categories(image: &[u8]) -> impl Iterator<Item = Result<Category<'_>, SiiError>> {
    let mut next = Some(FIRST_CATEGORY);
    std::iter::from_fn(move || {
        let word = next.take()?;
        let words = image.len() / 2;
        let short = |needed| SiiError::Short { what: "a category", words, needed };
        let Some(header) = image.get(2 * word..2 * word + 2) else { return Some(Err(short(word))) };
        let kind = u16_at(header, 0);
        if kind == category::END {
            return None;
        }
        let Some(len) = image.get(2 * word + 2..2 * word + 4) else { return Some(Err(short(word + 1))) };
        let (first, end) = (word + 2, word + 2 + usize::from(u16_at(len, 0)));
        let Some(bytes) = image.get(2 * first..2 * end) else { return Some(Err(short(end - 1))) };
        next = (end < MOST_WORDS).then_some(end);
        Some(Ok(Category { kind, word, bytes }))
    })
}

/// Words that an image has up to the end of what is known of it: of the head, and of each category whose header is there.
pub fn words_needed(image: &[u8]) -> usize {
    let size = (usize::from(u16_at(image, 2 * 0x3e)) + 1) * 64;
    let most = size.clamp(FIRST_CATEGORY + 2, MOST_WORDS);
    let mut word = FIRST_CATEGORY;
    loop {
        let Some(header) = image.get(2 * word..2 * word + 4) else { return (word + 2).min(most) };
        if u16_at(header, 0) == category::END {
            return word + 1;
        }
        word += 2 + usize::from(u16_at(header, 2));
        if word >= most {
            // A category that leaves the chip is torn: the reader says which.
            return most;
        }
    }
}

impl Sii {
    /// Reads an image; words are little-endian. Categories that this reader does not know are skipped.
    ///
    /// # Errors
    /// If it is too short, its checksum is wrong or a category is torn. The error names the word.
    pub fn read(image: &[u8]) -> Result<Sii, SiiError> {
        let words = image.len() / 2;
        let start = image.first_chunk::<{ 2 * FIRST_CATEGORY }>();
        let start = start.ok_or(SiiError::Short { what: "the head", words, needed: FIRST_CATEGORY - 1 })?;
        let (is, should_be) = (start[14], checksum(&array(start, 0)));
        if is != should_be {
            return Err(SiiError::Checksum { is, should_be });
        }
        let word = |at: usize| u16_at(start, 2 * at);
        let double = |at: usize| u32_at(start, 2 * at);
        let mailbox = |at: usize| MailboxArea { start: word(at), len: word(at + 1) };
        let mut sii = Sii {
            pdi: [word(0), word(1), word(2), word(3)],
            alias: word(4),
            vendor_id: double(0x08),
            product_code: double(0x0a),
            revision: double(0x0c),
            serial: double(0x0e),
            receive_mailbox: mailbox(0x18),
            send_mailbox: mailbox(0x1a),
            protocols: word(0x1c),
            ..Sii::default()
        };
        let strings = strings(image)?;
        for category in categories(image) {
            sii.take(&category?, &strings)?;
        }
        Ok(sii)
    }

    fn take(&mut self, category: &Category<'_>, strings: &[&[u8]]) -> Result<(), SiiError> {
        match category.kind {
            category::GENERAL => self.take_general(category, strings),
            category::FMMU => {
                let room = MOST_ITEMS.saturating_sub(self.fmmus.len());
                // A category has whole words: the last byte may be a filler.
                let used = category.bytes.iter().filter(|byte| !matches!(byte, 0 | 0xff));
                self.fmmus.extend(used.take(room).map(|byte| FmmuUse(*byte)));
                Ok(())
            }
            category::SYNC_MANAGERS => {
                let (chunks, rest) = category.bytes.as_chunks::<8>();
                if !rest.is_empty() {
                    return Err(category.torn(8 * chunks.len(), "a sync manager"));
                }
                for (place, chunk) in chunks.iter().enumerate() {
                    category.check(8 * place, self.sync_managers.len() < MOST_ITEMS, "sync managers", MOST_ITEMS)?;
                    let [.., kind] = *chunk;
                    self.sync_managers.push(SyncManagerUse { settings: SyncManager::decode(chunk), kind });
                }
                Ok(())
            }
            category::TX_PDO => take_pdos(category, strings, &mut self.tx_pdos),
            category::RX_PDO => take_pdos(category, strings, &mut self.rx_pdos),
            _ => Ok(()),
        }
    }

    fn take_general(&mut self, category: &Category<'_>, strings: &[&[u8]]) -> Result<(), SiiError> {
        let [group, _image, order, name, _, coe, ..] =
            *category.bytes.first_chunk::<18>().ok_or(category.torn(0, "the general part"))?;
        self.group = category.string(0, group, strings)?;
        self.order = category.string(2, order, strings)?;
        self.name = category.string(3, name, strings)?;
        self.coe_details = coe;
        self.e_bus_ma = i16::from_le_bytes(array(category.bytes, 12));
        Ok(())
    }
}

impl Category<'_> {
    /// The word of a byte of this category.
    fn word_of(&self, byte: usize) -> usize {
        self.word + 2 + byte / 2
    }

    fn torn(&self, byte: usize, what: &'static str) -> SiiError {
        SiiError::Torn { word: self.word_of(byte), what, category: self.word }
    }

    fn check(&self, byte: usize, is_good: bool, what: &'static str, most: usize) -> Result<(), SiiError> {
        if is_good { Ok(()) } else { Err(SiiError::TooMany { word: self.word_of(byte), what, most }) }
    }

    /// The string of a number that stands at a byte of this category; 0 is none.
    fn string(&self, byte: usize, number: u8, strings: &[&[u8]]) -> Result<String, SiiError> {
        let Some(place) = usize::from(number).checked_sub(1) else { return Ok(String::new()) };
        let no_string = SiiError::NoString { word: self.word_of(byte), number, strings: strings.len() };
        let text = strings.get(place).ok_or(no_string)?;
        // Old images hold Latin-1.
        Ok(text.iter().map(|byte| char::from(*byte)).collect())
    }
}

/// All strings, by number less one.
fn strings(image: &[u8]) -> Result<Vec<&[u8]>, SiiError> {
    let mut strings = Vec::new();
    for category in categories(image) {
        let category = category?;
        if category.kind != category::STRINGS {
            continue;
        }
        let Some((count, mut rest)) = category.bytes.split_first() else { continue };
        for _ in 0..*count {
            let at = category.bytes.len() - rest.len();
            let torn = || category.torn(at, "a string");
            let (len, text) = rest.split_first().ok_or_else(torn)?;
            let (text, behind) = text.split_at_checked(usize::from(*len)).ok_or_else(torn)?;
            strings.push(text);
            rest = behind;
        }
        // Masters take the first one.
        break;
    }
    Ok(strings)
}

fn take_pdos(category: &Category<'_>, strings: &[&[u8]], pdos: &mut Vec<Pdo>) -> Result<(), SiiError> {
    let mut at = 0;
    let mut entries = pdos.iter().map(|pdo| pdo.entries.len()).sum::<usize>();
    while at < category.bytes.len() {
        let head: &[u8; 8] = category
            .bytes
            .get(at..)
            .and_then(|rest| rest.first_chunk())
            .ok_or_else(|| category.torn(at, "a process data object"))?;
        category.check(at, pdos.len() < MOST_ITEMS, "process data objects", MOST_ITEMS)?;
        let [_, _, count, sync_manager, _, name, ..] = *head;
        let mut pdo = Pdo {
            index: u16_at(head, 0),
            sync_manager,
            name: category.string(at + 5, name, strings)?,
            entries: Vec::new(),
        };
        at += 8;
        for _ in 0..count {
            let bytes: &[u8; 8] = category
                .bytes
                .get(at..)
                .and_then(|rest| rest.first_chunk())
                .ok_or_else(|| category.torn(at, "an entry of a process data object"))?;
            entries += 1;
            category.check(at, entries <= MOST_ENTRIES, "entries of process data objects", MOST_ENTRIES)?;
            let [_, _, sub, name, data_type, bits, ..] = *bytes;
            let name = category.string(at + 3, name, strings)?;
            pdo.entries.push(PdoEntry { index: u16_at(bytes, 0), sub, name, data_type, bits });
            at += 8;
        }
        pdos.push(pdo);
    }
    Ok(())
}
