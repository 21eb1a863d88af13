//! The devices on a segment.

use super::{SegmentError, SegmentService};
use yieldwall_bus::ethercat::SegmentFailure;
use yieldwall_fieldbus::ethercat::sii::{FIRST_CATEGORY, Sii};
use yieldwall_fieldbus::ethercat::{AlStatus, AlStatusCode, u16_at, u32_at};
use yieldwall_link::EthernetLink;

/// Words of the SII with vendor, product code, revision and serial number.
const IDENTITY: [usize; 4] = [0x08, 0x0a, 0x0c, 0x0e];
/// The word with the alias.
const ALIAS: usize = 0x04;

/// A device that was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Present {
    /// Its position, 0 at the master.
    pub position: u16,
    /// Its state.
    pub status: AlStatus,
    /// Why it has an error, if it has one.
    pub code: AlStatusCode,
    /// Content of its SII, or the reason why it could not be read.
    pub sii: Result<Sii, SegmentFailure>,
    /// Vendor, product code, revision and serial number, of a damaged SII too as far as it has them.
    pub identity: [Option<u32>; 4],
    /// The alias in its SII; 0 for none.
    pub alias: Option<u16>,
}

impl<L: EthernetLink> SegmentService<L> {
    /// Asks a device who it is and how it is. A device without a legible SII is found all the same.
    ///
    /// # Errors
    /// As [`SegmentService::read`], but what is wrong with the SII stands in the answer.
    pub fn present(&mut self, position: u16) -> Result<Present, SegmentError> {
        let (status, code) = self.state(position)?;
        let image = match self.sii_image(position) {
            Ok(image) => Ok(image),
            Err(SegmentError::Failed(failure)) => Err(failure),
            Err(error) => return Err(error),
        };
        let head = image.as_deref().ok().filter(|image| image.len() >= 2 * FIRST_CATEGORY);
        let identity = IDENTITY.map(|word| head.map(|head| u32_at(head, 2 * word)));
        let alias = head.map(|head| u16_at(head, 2 * ALIAS));
        let sii = image.and_then(|image| Sii::read(&image).map_err(SegmentFailure::from));
        Ok(Present { position, status, code, sii, identity, alias })
    }
}
