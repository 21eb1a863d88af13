//! Filters of the identifiers that a socket lets through.

use socketcan::CanFilter;

/// Bits of an identifier.
const IDENTIFIER: u16 = 0x7ff;

/// Lets frames through whose identifier agrees with `id` in the bits of `mask`; remote frames only where the mask leaves
/// something open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CobFilter {
    id: u16,
    mask: u16,
}

impl CobFilter {
    /// Every frame with an 11-bit identifier.
    pub const EVERYTHING: Self = Self { id: 0, mask: 0 };

    /// Passes the data frames of one identifier (its low 11 bits). The kernel finds these without searching, however many there
    /// are.
    pub const fn only(id: u16) -> Self {
        Self { id: id & IDENTIFIER, mask: IDENTIFIER }
    }

    /// Passes all identifiers that agree with `id` in the bits of `mask`, data and remote frames.
    pub const fn matching(id: u16, mask: u16) -> Self {
        Self { id: id & mask & IDENTIFIER, mask: mask & IDENTIFIER }
    }

    /// Whether frames with this identifier pass.
    pub const fn passes(&self, id: u16) -> bool {
        (id ^ self.id) & self.mask == 0
    }

    /// Returns the filter in the form of the kernel. Frames with 29-bit identifiers never pass.
    pub(super) fn of_kernel(&self) -> CanFilter {
        let remote = if self.mask == IDENTIFIER { libc::CAN_RTR_FLAG } else { 0 };
        CanFilter::new(self.id.into(), u32::from(self.mask) | libc::CAN_EFF_FLAG | remote)
    }
}

/// Passes every frame, also with 29-bit identifiers.
pub(super) fn no_filter() -> CanFilter {
    CanFilter::new(0, 0)
}

/// A set of identifiers.
#[derive(Clone, Debug)]
pub(super) struct Identifiers([u64; 32]);

impl Identifiers {
    /// Returns the identifiers that at least one of the filters lets through.
    pub(super) fn passing(filters: &[CobFilter]) -> Self {
        let mut bits = [0; 32];
        for id in (0..=IDENTIFIER).filter(|id| filters.iter().any(|filter| filter.passes(*id))) {
            bits[usize::from(id / 64)] |= 1 << (id % 64);
        }
        Self(bits)
    }

    pub(super) fn has(&self, id: u16) -> bool {
        self.0.get(usize::from(id / 64)).is_some_and(|word| word >> (id % 64) & 1 == 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn as_the_kernel_takes_them() {
        let kernel = |filter: CobFilter| {
            let filter = filter.of_kernel();
            (filter.as_ref().can_id, filter.as_ref().can_mask)
        };
        assert_eq!(kernel(CobFilter::only(0x181)), (0x181, 0xc000_07ff));
        assert_eq!(kernel(CobFilter::matching(0x5ff, 0x780)), (0x580, 0x8000_0780));
        assert_eq!(kernel(CobFilter::EVERYTHING), (0, 0x8000_0000));
    }

    proptest! {
        #[test]
        fn a_set_has_what_its_filters_let_through(id in 0u16..0x800, filters in prop::collection::vec((0u16..0x1000, 0u16..0x1000), 0..4)) {
            let filters: Vec<_> = filters.into_iter().map(|(id, mask)| CobFilter::matching(id, mask)).collect();
            let passes = filters.iter().any(|filter| filter.passes(id));
            prop_assert_eq!(Identifiers::passing(&filters).has(id), passes);
        }
    }
}
