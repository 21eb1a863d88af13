//! Place and reach of a new rig's arm, from the lengths of its links.

use crate::failure::{Exit, Failure};
use yieldwall_config::{Finite, Positive, builtin, load_rig};
use yieldwall_motion::linkage::FiveBar;
use yieldwall_motion::quantity::TipPoint;

/// Clearance of the tool from singular poses and from the edge of the workspace, m, as in the rig's guard.
pub(super) const MARGIN_M: f64 = 0.02;
/// Least radius of a working disc, m.
const LEAST_M: f64 = 0.05;
/// Share of the greatest disc that is worked in.
const SHARE: f64 = 0.9;
/// Places of the base line that are tried.
const PLACES: usize = 40;
/// Halvings of the radius.
const HALVINGS: usize = 12;

/// Numbers in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Geometry {
    pub(super) links_m: [f64; 2],
    /// Half the distance of the base joints.
    pub(super) half_base_m: f64,
    /// Distance of the base line below the origin.
    pub(super) below_m: f64,
    /// Radius of the working disc.
    pub(super) working_m: f64,
    /// Radius of the circle of the fixture.
    pub(super) circle_m: f64,
}

impl Geometry {
    /// Returns the place of the base line at which the working disc is largest.
    pub(super) fn of(links_m: [f64; 2], base_m: f64) -> Result<Self, Failure> {
        let [proximal_m, distal_m] = links_m;
        // In whole micrometres, as the rig file has it.
        let half_base_m = (base_m / 2.0 * 1e6).round() / 1e6;
        let reach_m = proximal_m + distal_m;
        let places = (1..PLACES).map(|place| two_digits(reach_m * place as f64 / PLACES as f64));
        let greatest = places
            .filter_map(|below_m| Some((below_m, greatest_disc_m(links_m, half_base_m, below_m)?)))
            .max_by(|(_, one), (_, other)| one.total_cmp(other));
        let working = greatest.map(|(below_m, radius_m)| (below_m, two_digits(SHARE * radius_m - 0.005)));
        match working.filter(|(_, working_m)| *working_m >= LEAST_M) {
            Some((below_m, working_m)) => {
                let circle_m = two_digits(0.75 * working_m);
                Ok(Self { links_m, half_base_m, below_m, working_m, circle_m })
            }
            None => {
                let message = format!(
                    "links of {proximal_m} m and {distal_m} m on base joints {base_m} m apart leave no disc of {LEAST_M} m to work in"
                );
                let help = "give --links with the distal ones longer than the proximal ones, or another --base";
                Err(Failure::new(Exit::Usage, message, help))
            }
        }
    }
}

/// Radius of the greatest disc about the origin that the arm reaches with its margin; `None` if it does not reach the origin.
fn greatest_disc_m([proximal_m, distal_m]: [f64; 2], half_base_m: f64, below_m: f64) -> Option<f64> {
    let mut arm = load_rig(builtin("paper-admittance.yaml")).ok()?.value.linkage;
    arm.base_m =
        [[Finite::new(-half_base_m)?, Finite::new(-below_m)?], [Finite::new(half_base_m)?, Finite::new(-below_m)?]];
    (arm.proximal_m, arm.distal_m) = ([Positive::new(proximal_m)?; 2], [Positive::new(distal_m)?; 2]);
    let linkage = FiveBar::new(arm.geometry()).ok()?;
    let reaches = |radius_m: f64| linkage.reaches_disc(TipPoint::new(0.0, 0.0), radius_m, MARGIN_M).is_ok();
    let (mut low, mut high) = (0.0, proximal_m + distal_m);
    if !reaches(low) {
        return None;
    }
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if reaches(middle) { low = middle } else { high = middle }
    }
    Some(low)
}

/// Rounds down to whole centimetres.
fn two_digits(value: f64) -> f64 {
    (value * 100.0 + 1e-9).floor() / 100.0
}
