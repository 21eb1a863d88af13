//! Errors of figures.

use std::path::PathBuf;
use yieldwall_record::{Phase, Reference, Row, Trace};

/// Magnitude up to which a value is drawn: far beyond any rig, and small enough that no sum overflows.
const LARGEST: f64 = 1e9;

/// Reason why a figure was not drawn or not written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A trace has no rows.
    #[error("the trace {title:?} has no rows to draw")]
    Empty {
        /// Title of the trace.
        title: String,
    },
    /// No row lies in the span that was asked for.
    #[error("the trace {title:?} has no rows between {from_s} s and {to_s} s")]
    EmptySpan {
        /// Title of the trace.
        title: String,
        /// Begin of the span in s.
        from_s: f64,
        /// End of the span in s.
        to_s: f64,
    },
    /// No row is marked as an impact.
    #[error("the trace {title:?} has no impact to draw the surroundings of")]
    NoImpact {
        /// Title of the trace.
        title: String,
    },
    /// A value cannot be drawn: not a number, infinite, or above 1e9 in magnitude.
    #[error("row {row}: {field} is {value}, not a finite number up to 1e9")]
    Value {
        /// Number of the row, from 0.
        row: usize,
        /// Field of the row.
        field: &'static str,
        /// The value.
        value: f64,
    },
    /// A number that belongs to the whole trace, a window or a span cannot be drawn.
    #[error("{field} is {value}: {wanted}")]
    Setting {
        /// Name of the number.
        field: &'static str,
        /// The value.
        value: f64,
        /// Allowed values.
        wanted: &'static str,
    },
    /// The reference surface does not show as a line in the plane of x and y, or a figure needs one and there is none.
    #[error("the reference surface of {title:?} is not a line in the plane of x and y")]
    NoLine {
        /// Title of the trace.
        title: String,
    },
    /// The number of panels is zero or does not fit the page.
    #[error("{count} panels; this figure takes 1 to {most}")]
    PanelCount {
        /// Number of panels in the request.
        count: usize,
        /// Largest number.
        most: usize,
    },
    /// The width of the picture is out of range.
    #[error("a picture {width_px} pixels wide; 100 to 20000 can be drawn")]
    PictureWidth {
        /// Width in pixels.
        width_px: u32,
    },
    /// The picture could not be encoded.
    #[error("the picture could not be encoded: {reason}")]
    Encode {
        /// Error of the encoder.
        reason: String,
    },
    /// The file could not be written.
    #[error("{path} could not be written")]
    Write {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        source: std::io::Error,
    },
}

/// Whether all numbers of a trace can be drawn.
pub(super) fn check(trace: &Trace) -> Result<(), Error> {
    if trace.rows.is_empty() {
        return Err(Error::Empty { title: trace.title.clone() });
    }
    for (row, values) in trace.rows.iter().chain(&trace.after).enumerate() {
        if let Some((field, value)) = drawn(values).find(|(_, value)| !is_drawable(*value)) {
            return Err(Error::Value { row, field, value });
        }
    }
    for (field, value) in [("friction_n", trace.friction_n), ("yield_n", trace.yield_n)] {
        expect(field, value, value >= 0.0, "a finite force of zero or more")?;
    }
    for Phase { from_s, to_s, .. } in &trace.phases {
        expect("from_s of a phase", *from_s, true, "a finite time")?;
        expect("to_s of a phase", *to_s, to_s >= from_s, "a finite time after the phase's begin")?;
    }
    for mark in &trace.faults {
        expect("time_s of a fault", mark.time_s, true, "a finite time")?;
    }
    trace.references.iter().try_for_each(check_reference)
}

fn check_reference(reference: &Reference) -> Result<(), Error> {
    let (points, radius): (Vec<f64>, Option<f64>) = match reference {
        Reference::Circle { center_m, radius_m, .. } => (center_m.to_vec(), Some(*radius_m)),
        Reference::Sphere { center_m, radius_m, .. } => (center_m.to_vec(), Some(*radius_m)),
        Reference::Box { center_m, half_size_m, .. } => ([*center_m, *half_size_m].concat(), None),
        Reference::Cylinder { axis_point_m, axis_direction, radius_m, .. } => {
            ([*axis_point_m, *axis_direction].concat(), Some(*radius_m))
        }
        Reference::Point { point_m, capture_radius_m } => ([&point_m[..], &[*capture_radius_m]].concat(), None),
        Reference::Plane { point_m, normal } => ([*point_m, *normal].concat(), None),
        Reference::Curve { points_m, .. } => (points_m.concat(), None),
    };
    for value in points {
        expect("a coordinate of the reference surface", value, true, "a finite number up to 1e9")?;
    }
    radius.map_or(Ok(()), |value| expect("radius_m", value, value > 0.0, "a finite length above zero"))
}

/// Refuses a number that is not drawable or that fails `holds`.
pub(super) fn expect(field: &'static str, value: f64, holds: bool, wanted: &'static str) -> Result<(), Error> {
    if holds && is_drawable(value) { Ok(()) } else { Err(Error::Setting { field, value, wanted }) }
}

fn is_drawable(value: f64) -> bool {
    value.abs() <= LARGEST
}

fn drawn(row: &Row) -> impl Iterator<Item = (&'static str, f64)> {
    let single = [
        ("time_s", row.time_s),
        ("power_w", row.power_w),
        ("signed_distance_m", row.signed_distance_m),
        ("tool_distance_m", row.tool_distance_m),
    ];
    let vectors = [
        ("tool_m", row.tool_m),
        ("proxy_m", row.proxy_m),
        ("force_n", row.force_n),
        ("surface_m", row.surface_m),
        ("tool_normal", row.tool_normal),
    ];
    single.into_iter().chain(vectors.into_iter().flat_map(|(field, values)| values.map(|value| (field, value))))
}
