//! Reading an image.

use super::super::{SyncManager, array, u16_at, u32_at};
use super::warning::{Flaws, SiiWarning, uniform};
use super::{
    CHECKSUM, FIRST_CATEGORY, FmmuUse, MOST_ENTRIES, MOST_ITEMS, MOST_WORDS, MailboxArea, OtherCategory, Pdo, PdoEntry,
    PortUse, SIZE, Sii, SiiError, SyncManagerUse, UNCHECKED, category, checksum,
};

/// Zero words in place of a category after which the list of categories has ended.
const MOST_ZEROS: usize = 64;
/// Words that the smallest usual chip has, of 2 kB. A size below it in word 3Eh is not believed.
const FEWEST_WORDS: usize = 0x400;
/// Bytes that a general category has at least.
const GENERAL_LEN: usize = 14;
/// Place of the ports in the general category.
const PORTS: usize = 16;

/// One category of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Category<'a> {
    /// Its type.
    pub kind: u16,
    /// First word of its header.
    pub word: usize,
    /// Its bytes, as far as the image has them.
    pub bytes: &'a [u8],
    /// Word behind its last one, by its header.
    pub end: usize,
}

/// The content of a place where a category may begin.
enum CategoryWord {
    /// The header of a category: its word, type and length in words.
    Header(usize, u16, usize),
    /// The end of the list.
    End(usize),
    /// Zeros from this word on, and no end of the list.
    Zeros(usize),
    /// The image ends before this word.
    Missing(usize),
}

fn word_at(image: &[u8], word: usize) -> Option<u16> {
    image.get(2 * word..2 * word + 2).map(|bytes| u16_at(bytes, 0))
}

/// Looks at a word at which a category may begin. A filler of two zero words or more is passed over.
fn place(image: &[u8], from: usize) -> CategoryWord {
    let zeros = (from..from + MOST_ZEROS).take_while(|word| word_at(image, *word) == Some(0)).count();
    let word = match zeros {
        MOST_ZEROS.. => return CategoryWord::Zeros(from),
        2.. => from + zeros,
        _ => from,
    };
    match (word_at(image, word), word_at(image, word + 1)) {
        (None, _) => CategoryWord::Missing(word),
        (Some(category::END), _) => CategoryWord::End(word),
        (_, None) => CategoryWord::Missing(word + 1),
        (Some(kind), Some(words)) => CategoryWord::Header(word, kind, words.into()),
    }
}

/// Returns the categories of an image, one after the other; the last one may be cut off by the end of the image.
pub fn categories(image: &[u8]) -> impl Iterator<Item = Category<'_>> {
    let mut next = FIRST_CATEGORY;
    std::iter::from_fn(move || {
        let CategoryWord::Header(word, kind, words) = place(image, next) else { return None };
        let (first, end) = (word + 2, word + 2 + words);
        let bytes = image.get(2 * first..2 * end).or_else(|| image.get(2 * first..)).unwrap_or_default();
        next = end;
        Some(Category { kind, word, bytes, end })
    })
}

/// Words of a chip by its head (word 3Eh); 1024 at least, since not all vendors fill that in.
pub fn chip_words(image: &[u8]) -> usize {
    ((usize::from(u16_at(image, 2 * SIZE)) + 1) * 64).clamp(FEWEST_WORDS, MOST_WORDS)
}

/// Words that an image has up to the end of what is known of it: of the head, and of each category whose header is there.
pub fn words_needed(image: &[u8]) -> usize {
    let most = chip_words(image);
    let mut word = FIRST_CATEGORY;
    while word < most {
        match place(image, word) {
            CategoryWord::Header(at, _, words) => word = at + 2 + words,
            CategoryWord::End(at) => return at + 1,
            CategoryWord::Zeros(at) => return at + MOST_ZEROS,
            CategoryWord::Missing(at) => return (at + 1).min(most),
        }
    }
    // A category that leaves the chip is cut off: the reader says which.
    most
}

impl Sii {
    /// Reads an image; words are little-endian. Categories that this reader does not know are skipped. Damaged or missing parts are
    /// left out, and named in [`Sii::warnings`].
    ///
    /// # Errors
    /// If the image is shorter than its head, or empty.
    pub fn read(image: &[u8]) -> Result<Sii, SiiError> {
        let words = image.len() / 2;
        let start = image.first_chunk::<{ 2 * FIRST_CATEGORY }>();
        let start = start.ok_or(SiiError::Short { words, needed: FIRST_CATEGORY - 1 })?;
        if let Some(byte) = uniform(image) {
            return Err(SiiError::Empty { byte });
        }
        let word = |at: usize| u16_at(start, 2 * at);
        let double = |at: usize| u32_at(start, 2 * at);
        let mailbox = |at: usize| MailboxArea { start: word(at), len: word(at + 1) };
        let sii = Sii {
            pdi: [word(0), word(1), word(2), word(3)],
            alias: word(4),
            vendor_id: double(0x08),
            product_code: double(0x0a),
            revision: double(0x0c),
            serial: double(0x0e),
            receive_mailbox: mailbox(0x18),
            send_mailbox: mailbox(0x1a),
            bootstrap_mailboxes: [mailbox(0x14), mailbox(0x16)],
            protocols: word(0x1c),
            ..Sii::default()
        };
        let mut reader = Reader { sii, strings: Vec::new(), flaws: Flaws::default() };
        reader.check_head(start, image.len());
        reader.take_categories(image);
        reader.check_mailboxes();
        Ok(Sii { warnings: reader.flaws.into_warnings(), ..reader.sii })
    }
}

/// The part of an image that was read so far.
struct Reader<'a> {
    sii: Sii,
    strings: Vec<&'a [u8]>,
    flaws: Flaws,
}

impl<'a> Reader<'a> {
    fn check_head(&mut self, start: &[u8; 2 * FIRST_CATEGORY], bytes: usize) {
        let (is, should_be) = (u16_at(start, 2 * CHECKSUM), checksum(&array(start, 0)));
        if is == UNCHECKED {
            self.flaws.add(SiiWarning::Unchecked { should_be });
        } else if is & 0xff != u16::from(should_be) {
            self.flaws.add(SiiWarning::Checksum { is: is as u8, should_be });
        }
        if matches!(self.sii.vendor_id, 0 | u32::MAX) {
            self.flaws.add(SiiWarning::NoVendor { is: self.sii.vendor_id });
        }
        if !bytes.is_multiple_of(2) {
            self.flaws.add(SiiWarning::HalfWord { word: bytes / 2 });
        }
    }

    fn take_categories(&mut self, image: &'a [u8]) {
        // Masters take the first one.
        if let Some(category) = categories(image).find(|category| category.kind == category::STRINGS) {
            self.take_strings(&category);
        }
        let (mut end, mut has_general) = (FIRST_CATEGORY, false);
        for category in categories(image) {
            end = category.end;
            if 2 * end > image.len() {
                let words = image.len() / 2;
                self.flaws.add(SiiWarning::Cut { category: category.word, words, needed: end - 1 });
            }
            has_general |= category.kind == category::GENERAL;
            self.take(&category);
        }
        match place(image, end) {
            _ if 2 * end > image.len() => {}
            CategoryWord::Zeros(word) | CategoryWord::Missing(word) => self.flaws.add(SiiWarning::NoEnd { word }),
            CategoryWord::Header(..) | CategoryWord::End(_) => {}
        }
        if !has_general {
            self.flaws.add(SiiWarning::NoGeneral { word: FIRST_CATEGORY });
        }
    }

    fn take(&mut self, category: &Category<'a>) {
        match category.kind {
            category::GENERAL => self.take_general(category),
            category::FMMU => {
                let room = MOST_ITEMS.saturating_sub(self.sii.fmmus.len());
                // A category has whole words: the last byte may be a filler.
                let used = category.bytes.iter().filter(|byte| !matches!(byte, 0 | 0xff));
                self.sii.fmmus.extend(used.take(room).map(|byte| FmmuUse(*byte)));
            }
            category::SYNC_MANAGERS => self.take_sync_managers(category),
            category::TX_PDO => self.take_pdos(category, |sii| &mut sii.tx_pdos),
            category::RX_PDO => self.take_pdos(category, |sii| &mut sii.rx_pdos),
            category::STRINGS => {}
            kind => {
                if self.sii.other_categories.len() < MOST_ITEMS {
                    self.sii.other_categories.push(OtherCategory { kind, bytes: category.bytes.to_vec() });
                }
            }
        }
    }

    /// Reads all strings, by number less one.
    fn take_strings(&mut self, category: &Category<'a>) {
        let Some((count, mut rest)) = category.bytes.split_first() else { return };
        for _ in 0..*count {
            let at = category.bytes.len() - rest.len();
            let whole = rest.split_first().and_then(|(len, text)| text.split_at_checked(usize::from(*len)));
            let Some((text, behind)) = whole else {
                return self.flaws.add(category.torn(at, "a string"));
            };
            self.strings.push(text);
            rest = behind;
        }
    }

    fn take_general(&mut self, category: &Category<'_>) {
        let mut bytes = [0; PORTS + 2];
        bytes.iter_mut().zip(category.bytes).for_each(|(to, from)| *to = *from);
        if category.bytes.len() < GENERAL_LEN {
            let (word, bytes) = (category.word, category.bytes.len());
            self.flaws.add(SiiWarning::ShortGeneral { word, bytes, needed: GENERAL_LEN });
        }
        let [group, _image, order, name, _, coe, ..] = bytes;
        self.sii.group = self.string(category, 0, group);
        self.sii.order = self.string(category, 2, order);
        self.sii.name = self.string(category, 3, name);
        self.sii.coe_details = coe;
        self.sii.e_bus_ma = i16::from_le_bytes(array(&bytes, 12));
        let ports = u16_at(&bytes, PORTS);
        self.sii.ports = [0, 4, 8, 12].map(|bit| PortUse((ports >> bit & 0x0f) as u8));
    }

    fn take_sync_managers(&mut self, category: &Category<'_>) {
        let (chunks, rest) = category.bytes.as_chunks::<8>();
        for (place, chunk) in chunks.iter().enumerate() {
            if self.sii.sync_managers.len() >= MOST_ITEMS {
                return self.flaws.add(category.too_many(8 * place, "sync managers", MOST_ITEMS));
            }
            let [.., kind] = *chunk;
            self.sii.sync_managers.push(SyncManagerUse { settings: SyncManager::decode(chunk), kind });
        }
        if !rest.is_empty() {
            self.flaws.add(category.leftover(8 * chunks.len(), rest, "a sync manager"));
        }
    }

    fn take_pdos(&mut self, category: &Category<'_>, pdos: fn(&mut Sii) -> &mut Vec<Pdo>) {
        let mut at = 0;
        let mut entries = pdos(&mut self.sii).iter().map(|pdo| pdo.entries.len()).sum::<usize>();
        while let Some(rest) = category.bytes.get(at..).filter(|rest| !rest.is_empty()) {
            let head = rest.first_chunk::<8>().filter(|_| uniform(rest).is_none());
            let Some(head) = head else {
                return self.flaws.add(category.leftover(at, rest, "a process data object"));
            };
            if uniform(head).is_some() {
                self.flaws.add(category.leftover(at, head, "a process data object"));
                at += head.len();
                continue;
            }
            let [low, high, count, sync_manager, _, name, ..] = head;
            let index = u16::from_le_bytes([*low, *high]);
            if pdos(&mut self.sii).len() >= MOST_ITEMS {
                return self.flaws.add(category.too_many(at, "process data objects", MOST_ITEMS));
            }
            entries += usize::from(*count);
            if entries > MOST_ENTRIES {
                return self.flaws.add(category.too_many(at, "entries of process data objects", MOST_ENTRIES));
            }
            let (chunks, _) = rest.get(8..).unwrap_or_default().as_chunks::<8>();
            let Some(chunks) = chunks.get(..usize::from(*count)) else {
                let what = "an entry of a process data object";
                return self.flaws.add(category.torn(at + 8 + 8 * chunks.len(), what));
            };
            let name = self.string(category, at + 5, *name);
            let entries = chunks.iter().enumerate().map(|(place, bytes)| {
                let [_, _, sub, name, data_type, bits, ..] = *bytes;
                let name = self.string(category, at + 8 + 8 * place + 3, name);
                PdoEntry { index: u16_at(bytes, 0), sub, name, data_type, bits }
            });
            let pdo = Pdo { index, sync_manager: *sync_manager, entries: entries.collect(), name };
            pdos(&mut self.sii).push(pdo);
            at += 8 + 8 * chunks.len();
        }
    }

    /// Returns the string of a number that stands at a byte of a category; 0 is none.
    fn string(&mut self, category: &Category<'_>, byte: usize, number: u8) -> String {
        let Some(place) = usize::from(number).checked_sub(1) else { return String::new() };
        match self.strings.get(place) {
            Some(text) => super::text::decode(text),
            None => {
                let (word, strings) = (category.word_of(byte), self.strings.len());
                self.flaws.add_once(category.word, SiiWarning::NoString { word, number, strings });
                String::new()
            }
        }
    }

    /// Both places that say where the mailboxes are should say the same.
    fn check_mailboxes(&mut self) {
        for (word, kind, area) in [(0x18, 1, self.sii.receive_mailbox), (0x1a, 2, self.sii.send_mailbox)] {
            let of_manager = self.sii.manager_area(kind).filter(|of_manager| *of_manager != area);
            if let Some(manager) = of_manager.filter(|_| area.len > 0) {
                self.flaws.add(SiiWarning::TwoMailboxes { word, area, manager });
            }
        }
    }
}

impl Category<'_> {
    /// Whether this reader knows its type.
    pub fn is_known(&self) -> bool {
        use category::*;
        matches!(self.kind, STRINGS | GENERAL | FMMU | SYNC_MANAGERS | TX_PDO | RX_PDO | DC)
    }

    /// Returns the word of a byte of this category.
    fn word_of(&self, byte: usize) -> usize {
        self.word + 2 + byte / 2
    }

    fn torn(&self, byte: usize, what: &'static str) -> SiiWarning {
        SiiWarning::Torn { word: self.word_of(byte), what, category: self.word }
    }

    fn too_many(&self, byte: usize, what: &'static str, most: usize) -> SiiWarning {
        SiiWarning::TooMany { word: self.word_of(byte), what, most }
    }

    /// Returns the kind of the bytes behind the last whole part.
    fn leftover(&self, byte: usize, rest: &[u8], what: &'static str) -> SiiWarning {
        match uniform(rest) {
            Some(_) => SiiWarning::Filler { word: self.word_of(byte), bytes: rest.len(), category: self.word },
            None => self.torn(byte, what),
        }
    }
}
