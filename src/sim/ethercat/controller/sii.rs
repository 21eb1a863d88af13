//! The memory chip with the SII image, behind registers.

use std::time::Duration;
use yieldwall_fieldbus::ethercat::registers::sii_control as control;
use yieldwall_fieldbus::ethercat::sii::{FIRST_CATEGORY, is_loaded};
use yieldwall_fieldbus::ethercat::u16_at;
use yieldwall_fieldbus::time::Time;

/// How long a read takes, and a write.
const READ_TIME: Duration = Duration::from_micros(60);
const WRITE_TIME: Duration = Duration::from_millis(2);
/// From so many bytes on the chip has addresses of two bytes.
const LARGE: usize = 2048;

/// The chip.
#[derive(Clone, Debug)]
pub(super) struct Chip {
    image: Vec<u8>,
    busy_until: Time,
    errors: u16,
    /// Result of a read.
    pub(super) data: [u8; 8],
}

impl Chip {
    /// A chip with this image; the rest of it, up to the size that the image says, is erased.
    pub(super) fn new(mut image: Vec<u8>) -> Self {
        let kbit = usize::from(u16_at(&image, 2 * 0x3e)) + 1;
        image.resize(image.len().max((kbit * 128).min(1 << 16)).max(2 * FIRST_CATEGORY), 0xff);
        Chip { image, busy_until: Time(0), errors: 0, data: [0; 8] }
    }

    pub(super) fn image(&self) -> &[u8] {
        &self.image
    }

    pub(super) fn image_mut(&mut self) -> &mut [u8] {
        &mut self.image
    }

    /// Takes the configuration, as after power-on; gives the alias, or 0 if the checksum is wrong.
    pub(super) fn load(&mut self) -> u16 {
        let is_good = is_loaded(&self.image);
        self.errors = if is_good { 0 } else { control::CHECKSUM_ERROR };
        if is_good { u16_at(&self.image, 8) } else { 0 }
    }

    /// Control and status as the register shows them.
    pub(super) fn status(&self, now: Time) -> u16 {
        let bit = |is_set: bool, mask: u16| if is_set { mask } else { 0 };
        control::EIGHT_BYTES
            | bit(self.image.len() > LARGE, control::LARGE)
            | self.errors
            | bit(now < self.busy_until, control::BUSY)
    }

    /// Carries out a command at a word; gives a new alias if it loads the configuration.
    pub(super) fn command(&mut self, now: Time, command: u16, word: u32, data: [u8; 2]) -> Option<u16> {
        if now < self.busy_until {
            return None;
        }
        self.errors &= control::CHECKSUM_ERROR;
        let at = 2 * word as usize;
        match command & (control::READ | control::WRITE | control::RELOAD) {
            0 => {}
            control::READ => {
                let rest = self.image.get(at..).unwrap_or_default().iter().copied().chain(std::iter::repeat(0xff));
                self.data.iter_mut().zip(rest).for_each(|(to, from)| *to = from);
                self.busy_until = now + READ_TIME;
            }
            control::WRITE if command & control::WRITE_ENABLE == 0 => self.errors |= control::WRITE_ENABLE_ERROR,
            control::WRITE => match self.image.get_mut(at..).and_then(|rest| rest.first_chunk_mut()) {
                Some(to) => {
                    *to = data;
                    self.busy_until = now + WRITE_TIME;
                }
                None => self.errors |= control::COMMAND_ERROR,
            },
            control::RELOAD => {
                self.busy_until = now + READ_TIME;
                return Some(self.load());
            }
            _ => self.errors |= control::COMMAND_ERROR,
        }
        None
    }
}
