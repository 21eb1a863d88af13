//! Damaged, missing or unusual parts of an image whose rest is taken.

use super::MailboxArea;

/// Warnings that are kept of an image.
const MOST_WARNINGS: usize = 32;

/// A part of an image that was left out, or that is not as the standard has it. Words are counted from 0, as tools show them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SiiWarning {
    /// The checksum of words 0 to 6 is wrong: the controller does not load such a configuration.
    #[error(
        "word 0007h: the checksum is {is:02X}h, and words 0 to 6 give {should_be:02X}h: the controller does not load them"
    )]
    Checksum {
        /// The value in the image.
        is: u8,
        /// The right value.
        should_be: u8,
    },
    /// The checksum is the value by which controllers do not check, which is meant for development.
    #[error("word 0007h: 88A4h switches the checksum of words 0 to 6 off, which would be {should_be:02X}h")]
    Unchecked {
        /// The right value.
        should_be: u8,
    },
    /// No vendor is programmed.
    #[error("word 0008h: the vendor is {is:08X}h: the identity is not programmed")]
    NoVendor {
        /// The value in the image.
        is: u32,
    },
    /// The image ends in the middle of a word.
    #[error("word {word:04X}h: the image ends in the middle of this word")]
    HalfWord {
        /// The word.
        word: usize,
    },
    /// The list of categories does not end with FFFFh.
    #[error("word {word:04X}h: neither a category nor the end (FFFFh) of the categories is here")]
    NoEnd {
        /// Word at which the next category would begin.
        word: usize,
    },
    /// The image ends within a category.
    #[error("word {category:04X}h: this category needs word {needed:04X}h, and the image ends at word {words:04X}h")]
    Cut {
        /// First word of the category.
        category: usize,
        /// Words that are there.
        words: usize,
        /// The last word that it needs.
        needed: usize,
    },
    /// There is no general category.
    #[error("word {word:04X}h: no general category (001Eh) is among the categories from here on: no name is known")]
    NoGeneral {
        /// First word of the categories.
        word: usize,
    },
    /// The general category is too short.
    #[error("word {word:04X}h: the general category has {bytes} bytes instead of {needed}: the rest counts as 0")]
    ShortGeneral {
        /// First word of the category.
        word: usize,
        /// Bytes that it has.
        bytes: usize,
        /// Bytes that are read of it.
        needed: usize,
    },
    /// A category ends within one of its parts, which is left out.
    #[error("word {word:04X}h: {what} does not fit the category that begins at word {category:04X}h")]
    Torn {
        /// Word at which the part begins.
        word: usize,
        /// Name of the part.
        what: &'static str,
        /// First word of the category.
        category: usize,
    },
    /// Bytes that are all 00h or all FFh follow the last part of a category.
    #[error("word {word:04X}h: {bytes} filler bytes end the category that begins at word {category:04X}h")]
    Filler {
        /// Word at which they begin.
        word: usize,
        /// Their number.
        bytes: usize,
        /// First word of the category.
        category: usize,
    },
    /// A number names a string that there is not; the first one of its category.
    #[error("word {word:04X}h: string {number} is named, but there are {strings}: the name is left empty")]
    NoString {
        /// Word that names it.
        word: usize,
        /// Its number.
        number: u8,
        /// Strings that there are.
        strings: usize,
    },
    /// More parts than a device can have; the others are left out.
    #[error("word {word:04X}h: more than {most} {what}")]
    TooMany {
        /// Word at which the first one too many begins.
        word: usize,
        /// The kind of part.
        what: &'static str,
        /// The greatest number.
        most: usize,
    },
    /// Two places say where a mailbox is, and differ. The sync managers count.
    #[error(
        "word {word:04X}h: the mailbox is at {:04X}h with {} bytes here, and its sync manager has it at {:04X}h with {} bytes",
        .area.start, .area.len, .manager.start, .manager.len
    )]
    TwoMailboxes {
        /// First of the two words in the head.
        word: usize,
        /// Area by these words.
        area: MailboxArea,
        /// Area by the sync manager.
        manager: MailboxArea,
    },
}

/// Whether all bytes are 00h or all are FFh, and which; `None` for none.
pub(super) fn uniform(bytes: &[u8]) -> Option<u8> {
    let first = bytes.first().copied().filter(|first| matches!(first, 0 | 0xff))?;
    bytes.iter().all(|byte| *byte == first).then_some(first)
}

/// The warnings of an image that is being read.
#[derive(Default)]
pub(super) struct Flaws {
    warnings: Vec<SiiWarning>,
    /// First word of the category of the last warning that is reported once.
    told: Option<usize>,
}

impl Flaws {
    pub(super) fn add(&mut self, warning: SiiWarning) {
        if self.warnings.len() < MOST_WARNINGS {
            self.warnings.push(warning);
        }
    }

    /// The first of a kind in the category that begins at this word.
    pub(super) fn add_once(&mut self, category: usize, warning: SiiWarning) {
        if self.told.replace(category) != Some(category) {
            self.add(warning);
        }
    }

    pub(super) fn into_warnings(self) -> Vec<SiiWarning> {
        self.warnings
    }
}
