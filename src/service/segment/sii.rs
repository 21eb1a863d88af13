//! The memory chip of a device, word by word through its controller.

use std::time::Duration;

use super::{LOOK_AGAIN, SegmentError, SegmentService, TRIES};
use crate::Bytes;
use yieldwall_bus::ethercat::SegmentFailure;
use yieldwall_fieldbus::ethercat::registers::{self as register, sii_control};
use yieldwall_fieldbus::ethercat::sii::{MOST_WORDS, Sii, chip_words, words_needed};
use yieldwall_fieldbus::ethercat::{u16_at, u32_at};
use yieldwall_link::EthernetLink;

/// Time between two looks at the chip, and how long it may take.
const CHIP_AGAIN: Duration = Duration::from_micros(50);
const CHIP_WAIT: Duration = Duration::from_millis(100);
/// Words of the largest chip that is not called large.
const SMALL_WORDS: usize = 1024;
/// Length of the chip's registers: control, address, data.
const CHIP_LEN: usize = 14;

impl<L: EthernetLink> SegmentService<L> {
    /// The SII image of a device as it is on the chip, damaged or not: up to the end of its categories, or of the chip.
    ///
    /// # Errors
    /// If the chip does not answer, and as [`SegmentService::read`].
    pub fn sii_image(&mut self, position: u16) -> Result<Bytes, SegmentError> {
        self.sii_up_to(position, 0)
    }

    /// Reads the SII image of a device, and the data behind it up to an image of this many words.
    ///
    /// # Errors
    /// As [`SegmentService::sii_image`].
    pub fn sii_up_to(&mut self, position: u16, words: usize) -> Result<Bytes, SegmentError> {
        let words = words.min(MOST_WORDS);
        self.with_chip(position, |service| {
            let mut image = Vec::new();
            while image.len() / 2 < words_needed(&image).max(words) {
                let word = (image.len() / 2) as u16;
                image.extend(service.sii_words(position, word)?);
            }
            Ok(image)
        })
    }

    /// Words that fit into the chip of a device, by its controller and by what the chip holds; `None` if neither says it.
    ///
    /// # Errors
    /// As [`SegmentService::read`].
    pub fn chip_size(&mut self, position: u16, held: &[u8]) -> Result<Option<usize>, SegmentError> {
        let status = u16_at(&self.read(position, register::SII_CONTROL, 2)?, 0);
        // An emulated chip has any size.
        let is_small = status & (sii_control::LARGE | sii_control::EMULATED) == 0;
        let by_head = Sii::read(held).is_ok().then(|| chip_words(held));
        Ok(if is_small { Some(SMALL_WORDS) } else { by_head })
    }

    /// Takes the chip from the device, if that has it, and offers it again afterwards.
    fn with_chip<T>(
        &mut self,
        position: u16,
        act: impl FnOnce(&mut Self) -> Result<T, SegmentError>,
    ) -> Result<T, SegmentError> {
        let was_offered = self.read(position, register::SII_CONFIGURATION, 2)? != [0, 0];
        if was_offered {
            self.write(position, register::SII_CONFIGURATION, &[2])?;
            self.write(position, register::SII_CONFIGURATION, &[0])?;
        }
        let done = act(self);
        if was_offered {
            self.write(position, register::SII_CONFIGURATION, &[1])?;
        }
        done
    }

    /// Two or four words from this one on.
    fn sii_words(&mut self, position: u16, word: u16) -> Result<Bytes, SegmentError> {
        let command: Vec<u8> =
            sii_control::READ.to_le_bytes().into_iter().chain(u32::from(word).to_le_bytes()).collect();
        self.write(position, register::SII_CONTROL, &command)?;
        let until = self.now() + CHIP_WAIT;
        loop {
            let held = self.read(position, register::SII_CONTROL, CHIP_LEN)?;
            let status = u16_at(&held, 0);
            let is_busy = status & sii_control::BUSY != 0;
            let is_refused = status & sii_control::COMMAND_ERROR != 0;
            if !is_busy && !is_refused && u32_at(&held, 2) == u32::from(word) {
                let len = if status & sii_control::EIGHT_BYTES != 0 { 8 } else { 4 };
                return Ok(held.get(6..6 + len).unwrap_or_default().to_vec());
            }
            if is_refused && !is_busy || self.now() >= until {
                return Err(SegmentFailure::SiiAccess { word, status }.into());
            }
            if !is_busy {
                // Of a command before, as the chip was busy.
                self.write(position, register::SII_CONTROL, &command)?;
            }
            self.pause(CHIP_AGAIN);
        }
    }

    /// Writes words of the SII of a device and reads each back. It writes the words of the head (0 to 7), which have a checksum,
    /// last.
    ///
    /// # Errors
    /// If the chip does not take a word, and as [`SegmentService::read`].
    pub fn write_sii(&mut self, position: u16, words: &[(u16, [u8; 2])]) -> Result<(), SegmentError> {
        let (head, rest): (Vec<_>, Vec<_>) = words.iter().copied().partition(|(word, _)| *word < 8);
        self.with_chip(position, |service| {
            for (word, value) in rest.into_iter().chain(head) {
                service.write_word(position, word, value)?;
                let held = service.sii_words(position, word)?;
                if !held.starts_with(&value) {
                    let digits =
                        |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>().into();
                    let (written, received) = (digits(&value), digits(held.get(..2).unwrap_or_default()));
                    return Err(SegmentFailure::ReadBack { register: register::SII_DATA, written, received }.into());
                }
            }
            Ok(())
        })
    }

    /// A chip that is busy with itself does not acknowledge, and takes the word a little later.
    fn write_word(&mut self, position: u16, word: u16, value: [u8; 2]) -> Result<(), SegmentError> {
        let command = sii_control::WRITE | sii_control::WRITE_ENABLE;
        let address = u32::from(word).to_le_bytes();
        let bytes = [&command.to_le_bytes()[..], &address, &value].concat();
        let mut status = 0;
        for _ in 0..TRIES {
            self.write(position, register::SII_CONTROL, &bytes)?;
            let until = self.now() + CHIP_WAIT;
            loop {
                status = u16_at(&self.read(position, register::SII_CONTROL, 2)?, 0);
                if status & sii_control::BUSY == 0 || self.now() >= until {
                    break;
                }
                self.pause(LOOK_AGAIN);
            }
            let refused = sii_control::BUSY | sii_control::COMMAND_ERROR | sii_control::WRITE_ENABLE_ERROR;
            if status & refused == 0 {
                return Ok(());
            }
            self.pause(LOOK_AGAIN);
        }
        Err(SegmentFailure::SiiAccess { word, status }.into())
    }
}
