//! Axes of a device as its objects show them.

use yieldwall_drives::objects as cia;
use yieldwall_drives::profiles::AxisOffset;
use yieldwall_fieldbus::objects::Address;

/// Axes that a device of CiA 402 has at most.
pub const MOST_AXES: u8 = 8;

/// The statusword of an axis, 0 to 7, by CiA 402.
pub fn statusword_of(axis: u8) -> Address {
    Address::new(AxisOffset::standard(axis).index(cia::STATUSWORD.index), cia::STATUSWORD.sub)
}

/// The supported modes of an axis.
pub(crate) fn supported_modes(offset: AxisOffset) -> Address {
    Address::new(offset.index(cia::SUPPORTED_MODES.index), cia::SUPPORTED_MODES.sub)
}

/// Number of axes of a device: the first ones that have supported modes (6502h, 6D02h and so on). `has` says whether the device has an object.
///
/// # Errors
/// The first error of `has`.
pub fn count_axes<E>(has: impl FnMut(Address) -> Result<bool, E>) -> Result<u8, E> {
    count_axes_by(AxisOffset::standard, has)
}

/// Number of axes of a device whose axes have these offsets, as [`count_axes`].
///
/// # Errors
/// The first error of `has`.
pub fn count_axes_by<E>(
    offset: impl Fn(u8) -> AxisOffset,
    mut has: impl FnMut(Address) -> Result<bool, E>,
) -> Result<u8, E> {
    for axis in 0..MOST_AXES {
        if !has(supported_modes(offset(axis)))? {
            return Ok(axis);
        }
    }
    Ok(MOST_AXES)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_counted_up_to_the_first_that_lacks_modes() {
        for axes in 0..=MOST_AXES {
            let mut asked = Vec::new();
            let count = count_axes(|at| {
                asked.push(at.index);
                Ok::<_, ()>(usize::from(axes) >= asked.len())
            });
            assert_eq!(count, Ok(axes));
            assert!([0x6502, 0x6d02, 0x7502].starts_with(&asked[..asked.len().min(3)]), "{asked:04x?}");
        }
        assert_eq!(count_axes(|_| Err(1)), Err(1));
        assert_eq!(statusword_of(2), Address::new(0x7041, 0));
    }
}
