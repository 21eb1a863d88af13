//! Checks of the arm's reach.

use std::f64::consts::TAU;
use yieldwall_motion::elementary;

use super::Findings;
use super::words::{round, shorten_numbers};
use crate::number::Positive;
use crate::tree::{Fixture, Rig, Surface};
use yieldwall_motion::fixture::Shape2;
use yieldwall_motion::linkage::{FiveBar, LinkageError};
use yieldwall_motion::quantity::TipPoint;

/// Largest disc that the advice names, mm.
const MOST_MM: f64 = 1e5;
/// Smallest number that is a length of a link in mm, as no arm has such a length in m.
const MILLIMETRES_FROM: f64 = 20.0;
/// Points of a circle for the check of reach.
const CIRCLE_SAMPLES: u32 = 96;

/// Checks that the arm exists and reaches its working disc and the surface of its fixture.
pub(super) fn check_linkage(findings: &mut Findings, rig: &Rig) {
    let lengths = [("linkage.proximal_m", rig.linkage.proximal_m), ("linkage.distal_m", rig.linkage.distal_m)];
    let longest = |(key, [left, right]): (&'static str, [Positive; 2])| (key, left.get().max(right.get()));
    if let Some((key, length_m)) = lengths.map(longest).into_iter().find(|(_, length_m)| *length_m >= MILLIMETRES_FROM)
    {
        let help = format!("write metres, such as {}", length_m / 1e3);
        findings.error(key, format!("`{key}` is {length_m} m"), help);
        return;
    }
    let five_bar = match FiveBar::new(rig.linkage.geometry()) {
        Ok(five_bar) => five_bar,
        Err(error) => {
            findings.error(
                "linkage",
                format!("no five-bar arm has this geometry: {}", shorten_numbers(&error.to_string())),
                "check the lengths",
            );
            return;
        }
    };
    let margin_m = *rig.guard.singularity_margin_m;
    let radius_m = *rig.linkage.working_radius_m;
    if let Err(error) = five_bar.reaches_disc(TipPoint::new(0.0, 0.0), radius_m, margin_m) {
        findings
            .error(
                "linkage.working_radius_m",
                format!(
                    "the arm does not reach all of the disc of `linkage.working_radius_m` = {radius_m} m: at {}, {}",
                    point(error.tip),
                    shorten_numbers(&error.cause.to_string())
                ),
                reach_help(&five_bar, radius_m, margin_m, &error.cause),
            )
            .see("linkage.base_m", "base_m")
            .see("guard.singularity_margin_m", "margin");
        return;
    }
    check_surface_reach(findings, "fixture", &rig.fixture, rig);
}

/// Advice on a disc out of reach: the largest disc within reach, in whole millimetres, and the change of the arm.
fn reach_help(five_bar: &FiveBar, radius_m: f64, margin_m: f64, cause: &LinkageError) -> String {
    let is_reached = |mm: u32| five_bar.reaches_disc(TipPoint::new(0.0, 0.0), 1e-3 * f64::from(mm), margin_m).is_ok();
    let (mut reached, mut missed) = (0, (1e3 * radius_m).min(MOST_MM).ceil() as u32);
    while missed - reached > 1 {
        let middle = (reached + missed) / 2;
        if is_reached(middle) { reached = middle } else { missed = middle }
    }
    let links = match cause {
        LinkageError::TooClose { .. } => "shorten the longer links, make the links more equal",
        _ => "lengthen the links",
    };
    let others = format!("{links}, or move `base_m`: the origin is the middle of the disc");
    match reached {
        0 => others,
        mm => format!("write {}, which it reaches; or {others}", f64::from(mm) / 1e3),
    }
}

/// Checks that the tool can follow the surface. `at` is the key of the fixture.
pub(super) fn check_surface_reach(findings: &mut Findings, at: &str, fixture: &Fixture, rig: &Rig) {
    let Ok(five_bar) = FiveBar::new(rig.linkage.geometry()) else { return };
    let margin_m = *rig.guard.singularity_margin_m;
    for (key, surface) in fixture.surfaces() {
        check_reach(findings, &format!("{at}.{key}"), surface, rig, &five_bar, margin_m);
    }
}

fn check_reach(findings: &mut Findings, at: &str, surface: &Surface, rig: &Rig, five_bar: &FiveBar, margin_m: f64) {
    if let Surface::Line { point_m, normal } = surface {
        let length = elementary::hypot(*normal[0], *normal[1]);
        let distance = (*point_m[0] * *normal[0] + *point_m[1] * *normal[1]).abs() / length;
        if distance > *rig.linkage.working_radius_m {
            let key = format!("{at}.line.point_m");
            findings.error(
                &key,
                format!(
                    "the line passes {} m from the origin, outside of the disc of `linkage.working_radius_m` = {} m",
                    round(distance),
                    *rig.linkage.working_radius_m
                ),
                "move `point_m` nearer to the origin",
            );
        }
        return;
    }
    // A surface in space and a chain without shape are refused already.
    let Ok(Some(shape)) = surface.planar() else { return };
    for tip in samples(surface, &shape) {
        let reached = five_bar
            .inverse(tip)
            .and_then(|angles| five_bar.forward(angles))
            .and_then(|posture| five_bar.require_clearance(&posture, margin_m));
        if let Err(error) = reached {
            let place = if matches!(surface, Surface::Point { .. }) { "point_m" } else { surface.size_key() };
            let key = format!("{at}.{}.{place}", surface.name());
            let message = format!(
                "the arm does not reach all of the {}: at {}, {}",
                surface.summary(),
                point(tip),
                shorten_numbers(&error.to_string())
            );
            let help = format!(
                "make it smaller or move it; the arm reaches the disc of {} m about the origin",
                *rig.linkage.working_radius_m
            );
            findings.error(&key, message, help);
            return;
        }
    }
}

/// Returns places all along a bounded surface.
fn samples(surface: &Surface, shape: &Shape2) -> Vec<TipPoint> {
    match (surface, shape) {
        (Surface::Circle { center_m, radius_m, .. }, _) => (0..CIRCLE_SAMPLES)
            .map(|sample| {
                let (sine, cosine) = elementary::sin_cos(TAU * f64::from(sample) / f64::from(CIRCLE_SAMPLES));
                TipPoint::new(*center_m[0] + **radius_m * cosine, *center_m[1] + **radius_m * sine)
            })
            .collect(),
        (_, Shape2::Chain(chain)) => chain.outline_m().into_iter().map(TipPoint).collect(),
        _ => Vec::new(),
    }
}

fn point(tip: TipPoint) -> String {
    let [x, y] = tip.to_array();
    format!("({x:.3}, {y:.3}) m")
}
