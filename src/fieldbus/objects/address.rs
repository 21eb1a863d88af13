//! Address of an object in a dictionary.

use std::fmt;

/// The address of an object: its index, and its sub-index in a record or an array. Sub-index 0 of those is the highest
/// sub-index; an object that is one value lies at 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Address {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
}

impl Address {
    /// Creates an address from its two numbers.
    pub const fn new(index: u16, sub: u8) -> Self {
        Self { index, sub }
    }
}

/// As in manuals: `6041h:0`.
impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04X}h:{}", self.index, self.sub)
    }
}
