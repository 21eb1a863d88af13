//! The catalogue of injections.

mod boot;
mod bus;
mod host;
mod motion;
mod segment;
mod sensor;

use super::Ending::Latched;
use super::Target::{LeftDrive, RightDrive};
use super::{CatalogueRow, Ending, Expected, Kind, Lasts, Medium, Recovery, Size, Target};
use yieldwall_motion::guard::Fault as F;
use yieldwall_motion::guard::Reaction;
use yieldwall_motion::guard::State::{Disabled, Lost, Stopped};

const ONE_DRIVE: &[Target] = &[LeftDrive, RightDrive];
const STOPPED: Ending = Latched(&[Stopped]);
const DISABLED: Ending = Latched(&[Disabled]);
const LOST: Ending = Latched(&[Lost]);
const STOPPED_OR_LOST: Ending = Latched(&[Stopped, Lost]);
/// Several faults compete; which is seen first hangs on the moment.
const ANY: Ending = Latched(&[Stopped, Disabled, Lost]);

const fn row(
    (kind, name): (Kind, &'static str),
    matrix: &'static [u8],
    targets: &'static [Target],
    lasts: Lasts,
    meaning: &'static str,
    faults: &'static [F],
    (reaction, ending, recovery): (Reaction, Ending, Recovery),
) -> CatalogueRow {
    let expected = Expected { faults, reaction, ending, recovery };
    CatalogueRow {
        kind,
        name,
        meaning,
        matrix,
        targets,
        media: &[Medium::Can],
        lasts,
        size: None,
        expected,
        on_ethercat: None,
    }
}

/// Extends a row to EtherCAT segments.
const fn on_any(row: CatalogueRow) -> CatalogueRow {
    CatalogueRow { media: &[Medium::Can, Medium::Ethercat], ..row }
}

/// Extends a row to EtherCAT segments, where every device behind a device or a cable is lost.
const fn cut_off_on_ethercat(row: CatalogueRow) -> CatalogueRow {
    CatalogueRow { on_ethercat: Some(CUT_OFF), ..on_any(row) }
}

const CUT_OFF: &Expected = &Expected {
    faults: &[F::PdoMissed, F::SensorStale, F::SensorLost, F::DeviceState, F::ClockLost, F::PortErrors],
    reaction: Reaction::StopRamp,
    ending: STOPPED_OR_LOST,
    recovery: Recovery::Restart,
};

const fn sized(row: CatalogueRow, what: &'static str, usual: f64, (least, most): (f64, f64)) -> CatalogueRow {
    CatalogueRow { size: Some(Size { what, usual, least, most }), ..row }
}

/// All injections, in the order of [`Kind`].
pub const CATALOGUE: [CatalogueRow; Kind::COUNT] =
    joined(&[&sensor::ROWS, &bus::ROWS, &motion::ROWS, &host::ROWS, &boot::ROWS, &segment::ROWS]);

const fn joined(parts: &[&[CatalogueRow]]) -> [CatalogueRow; Kind::COUNT] {
    let mut rows = [sensor::ROWS[0]; Kind::COUNT];
    let (mut at, mut part) = (0, 0);
    while part < parts.len() {
        let mut row = 0;
        while row < parts[part].len() {
            rows[at] = parts[part][row];
            (at, row) = (at + 1, row + 1);
        }
        part += 1;
    }
    assert!(at == Kind::COUNT);
    rows
}

#[cfg(test)]
mod tests {
    use super::super::Ending::{DrivesStop, GoesOn, NotEnabled};
    use super::super::{Injection, InjectionError};
    use super::*;
    use Reaction::{Freeze, StopRamp};
    use Recovery::None as Nothing;

    /// Rows of the fault matrix that no injection covers, and the test that does.
    const ELSEWHERE: [(u8, &str); 4] = [
        (31, "record::recording::tests: a_full_disk_is_told_with_what_was_lost, a_device_that_is_full_is_a_full_disk"),
        (32, "record::recording::tests: a_full_ring_drops_and_counts; nothing else listens to a run"),
        (33, "config::malformed: every case of the table is refused with a place"),
        (34, "drives: the proptests of scaling"),
    ];

    /// Faults that no injection brings about, and the test that does.
    const NOT_INJECTED: [(F, &str); 3] = [
        (F::NotFinite, "cycle::tests: a defect of this program, fed at the cycle's inputs"),
        (F::WorkspaceLeft, "cycle::tests: the loops hold the arm at the edge, so that it is put beyond it"),
        (F::EnergyLimit, "report::run::energy_tests: a virtual mass that is too small for its hand"),
    ];

    #[test]
    fn the_catalogue_is_in_the_order_of_the_kinds_and_every_row_is_possible() {
        for (index, row) in CATALOGUE.iter().enumerate() {
            assert_eq!(row.kind as usize, index, "{}", row.name);
            assert_eq!(Kind::named(row.name), Some(row.kind), "names are unique");
            assert!(!row.meaning.is_empty() && !row.targets.is_empty());
            assert_eq!(Injection::new(row.kind, 1.0).check(), Ok(()), "{}", row.name);
            for expected in row.media.iter().map(|medium| row.expected_on(*medium)) {
                let strongest = expected.reaction;
                let follows = match expected.ending {
                    GoesOn => strongest <= Freeze,
                    Latched(states) => strongest >= StopRamp && states.iter().all(|state| state.is_latched()),
                    NotEnabled | DrivesStop => true,
                };
                assert!(follows, "{}", row.name);
                assert_eq!(expected.recovery == Nothing, expected.ending == GoesOn, "{}", row.name);
            }
            assert!(row.on_ethercat.is_none() || row.media.contains(&Medium::Ethercat), "{}", row.name);
        }
    }

    #[test]
    fn every_fault_is_brought_about() {
        for row in &yieldwall_motion::guard::fault::TABLE {
            let injected = CATALOGUE.iter().any(|injection| {
                let each = injection.media.iter().map(|medium| injection.expected_on(*medium));
                each.into_iter().any(|expected| expected.faults.contains(&row.fault))
            });
            let elsewhere = NOT_INJECTED.iter().any(|(fault, _)| *fault == row.fault);
            assert!(injected != elsewhere, "{}", row.name);
        }
    }

    #[test]
    fn every_row_of_the_matrix_is_covered() {
        for number in (1..=43).chain([46]) {
            let injected = CATALOGUE.iter().any(|row| row.matrix.contains(&number));
            let elsewhere = ELSEWHERE.iter().any(|(row, _)| *row == number);
            assert!(injected != elsewhere, "row {number}");
        }
    }

    #[test]
    fn what_is_not_possible_is_refused() {
        let stuck = Injection::new(Kind::SensorStuck, 1.0);
        assert!(matches!(stuck.on(LeftDrive).check(), Err(InjectionError::Target { .. })));
        assert!(matches!(stuck.sized(1.0).check(), Err(InjectionError::NoSize { .. })));
        assert!(matches!(stuck.lasting(Some(0.0)).check(), Err(InjectionError::Duration { .. })));
        assert!(matches!(Injection::new(Kind::SensorStuck, f64::NAN).check(), Err(InjectionError::Start { .. })));
        assert!(matches!(Injection::new(Kind::SensorStuck, -1.0).check(), Err(InjectionError::Start { .. })));
        let jump = Injection::new(Kind::EncoderJump, 1.0);
        for size in [f64::NAN, 4.0, f64::INFINITY] {
            assert!(matches!(jump.sized(size).check(), Err(InjectionError::Size { .. })));
        }
        let sync = Injection::new(Kind::SyncLost, 1.0);
        assert_eq!(sync.check_on(Medium::Can), Ok(()));
        let refused = sync.check_on(Medium::Ethercat).unwrap_err().to_string();
        assert_eq!(refused, "sync-lost does not exist on EtherCAT, only on CAN");
        let once = Injection::new(Kind::DriveFault, 1.0).lasting(Some(1.0));
        assert!(matches!(once.check(), Err(InjectionError::NoDuration { .. })));
    }
}
