//! Near the singularities of the arm: which virtual mass is stable, and where the arm is refused.

use nalgebra::Vector2;
use serde_json::Value;

use super::held::{Links, NudgeEffect, PLAIN, Setting};
use super::{Agreement, STUDY, cell, cells_below};
use crate::chart::{Axis, Chart, Color, Mark, Panel, Series};
use crate::sweep::{Clock, Report, Row, Sweep, Table};
use yieldwall_motion::linkage::Side;

const GAPS: u64 = 36;
const MASSES: u64 = 27;
const GAPS_M: [f64; 2] = [1e-4, 0.1];
const MASSES_KG: [f64; 2] = [0.01, 10.0];
const HAND_N_PER_M: f64 = 500.0;
const DURATION_S: f64 = 4.0;
const CELL: u32 = 27;
/// The virtual mass of the paper.
const PAPER_KG: f64 = 2.0;

const NUDGE_SHARE: f64 = 0.05;
const DRY_NUDGE_N: f64 = 30.0;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    /// Both chains almost stretched; the gap is that of their reach.
    Stretched,
    /// Both chains almost folded; the gap is that of their reach.
    Folded,
    /// The distal links almost on one line; the gap is that of the elbows.
    DistalStretched,
    /// The elbows almost meet; the gap is the distance between them.
    DistalFolded,
}

struct Case {
    name: &'static str,
    kind: Kind,
    setting: Setting,
}

const DRY: Setting = Setting { coulomb_n_m: 10.0, friction_n: 3.0, ..LATE };
const LATE: Setting = Setting { servo_delay: 1, ..PLAIN };

const CASES: [Case; 8] = [
    Case { name: "chains stretched (type 1)", kind: Kind::Stretched, setting: LATE },
    Case { name: "chains folded (type 1)", kind: Kind::Folded, setting: LATE },
    Case { name: "distal links in line (type 2)", kind: Kind::DistalStretched, setting: LATE },
    Case { name: "elbows meet (type 2)", kind: Kind::DistalFolded, setting: LATE },
    Case { name: "chains stretched, dry joints, F 3 N", kind: Kind::Stretched, setting: DRY },
    Case { name: "chains folded, dry joints, F 3 N", kind: Kind::Folded, setting: DRY },
    Case { name: "distal links in line, dry joints, F 3 N", kind: Kind::DistalStretched, setting: DRY },
    Case { name: "elbows meet, dry joints, F 3 N", kind: Kind::DistalFolded, setting: DRY },
];

/// A way across from the length of a link and its other projection.
fn leg_m(link_m: f64, other_m: f64) -> f64 {
    (link_m * link_m - other_m * other_m).sqrt()
}

impl Kind {
    /// The links with which a pose of this kind can be had away from all others.
    fn links(self) -> Links {
        match self {
            Self::Stretched => PLAIN.links,
            // Proximal links of 0.25 m fold where the distal ones lie on one line.
            Self::Folded => Links { proximal_m: 0.15, ..PLAIN.links },
            // Longer ones never come to lie on one line.
            Self::DistalStretched => Links { distal_m: 0.25, ..PLAIN.links },
            // With elbows outward and the tool before them they are never near each other; on a narrow base they meet
            // where the chains are almost stretched.
            Self::DistalFolded => Links { half_base_m: 0.15, elbows: [Side::Right, Side::Left], ..PLAIN.links },
        }
    }

    /// How far along the axis of symmetry the tool is at a gap.
    fn tool_m(self, gap_m: f64) -> f64 {
        let Links { half_base_m, proximal_m, distal_m, .. } = self.links();
        match self {
            Self::Stretched => leg_m(proximal_m + distal_m - gap_m, half_base_m),
            Self::Folded => leg_m(distal_m - proximal_m + gap_m, half_base_m),
            Self::DistalStretched => {
                let half_m = distal_m - 0.5 * gap_m;
                leg_m(proximal_m, half_m - half_base_m) + leg_m(distal_m, half_m)
            }
            Self::DistalFolded => {
                let half_m = 0.5 * gap_m;
                leg_m(proximal_m, half_base_m - half_m) + leg_m(distal_m, half_m)
            }
        }
    }
}

impl Case {
    /// The setting at a gap, with the tool on the axis of symmetry.
    fn at(&self, gap_m: f64) -> Setting {
        // A nudge that moves a frictionless arm by a small share of the gap; dry joints need one that moves them.
        let nudge_n = if self.setting.coulomb_n_m > 0.0 { DRY_NUDGE_N } else { NUDGE_SHARE * gap_m * HAND_N_PER_M };
        let start_m = Vector2::new(0.0, self.kind.tool_m(gap_m));
        Setting { links: self.kind.links(), start_m, nudge_n, ..self.setting }
    }
}

/// Every virtual mass at every gap.
pub(super) struct Map;

impl Sweep for Map {
    fn name(&self) -> &'static str {
        "singular"
    }

    fn columns(&self) -> Vec<&str> {
        vec!["case", "gap_m", "virtual_mass_kg", "outcome"]
    }

    fn points(&self) -> u64 {
        CASES.len() as u64 * GAPS * MASSES
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let (rest, mass) = (index / MASSES, index % MASSES);
        let case = &CASES[(rest / GAPS) as usize];
        let gap_m = cell(rest % GAPS, GAPS, GAPS_M);
        let mass_kg = cell(mass, MASSES, MASSES_KG);
        let outcome = case.at(gap_m).run(HAND_N_PER_M, mass_kg, DURATION_S);
        vec![case.name.into(), gap_m.into(), mass_kg.into(), outcome.word().into()]
    }
}

pub(super) fn report(map: &Table, report: &mut Report) {
    let mut panels = Vec::new();
    for case in &CASES {
        let points: Vec<_> = map.rows().filter(|row| row.word("case") == case.name).collect();
        let bound: Vec<_> = (0..GAPS)
            .map(|gap| cell(gap, GAPS, GAPS_M))
            .map(|gap_m| (gap_m, case.at(gap_m).least_mass_kg(HAND_N_PER_M)))
            .collect();
        let is_dead = |row: &&Row<'_>| row.word("outcome") == NudgeEffect::Dies.word();
        if case.setting.coulomb_n_m == 0.0 {
            let mut agreement = Agreement::default();
            let mut refused = Vec::new();
            for &(gap_m, least_kg) in &bound {
                let column: Vec<_> = points.iter().filter(|row| row.number("gap_m") == gap_m).collect();
                // Where the arm is refused at every mass there is no boundary to compare.
                if column.iter().all(|row| row.word("outcome") == NudgeEffect::Refused.word()) {
                    refused.extend(column.first().map(|row| row.command(STUDY)));
                    continue;
                }
                let measured = column.iter().rposition(|row| !is_dead(row)).map_or(0, |last| last as u64 + 1);
                let computed = if least_kg.is_finite() { cells_below(least_kg, MASSES, MASSES_KG) } else { MASSES };
                agreement.add(measured, computed, || {
                    let again = column.get(measured.saturating_sub(1) as usize).map(|row| row.command(STUDY));
                    format!("{:.2} mm: {measured}, theory {computed}: {}", gap_m * 1e3, again.unwrap_or_default())
                });
            }
            report.notes.push(agreement.line(case.name));
            if let Some(last) = refused.last() {
                report
                    .notes
                    .push(format!("    refused whatever the mass: {} of {GAPS} gaps, the last {last}", refused.len()));
            }
            report.notes.extend(agreement.ends().map(|line| format!("    masses not stable of {MASSES} at {line}")));
        }
        // The cell that holds the mass of the paper.
        let paper = cell(cells_below(PAPER_KG, MASSES, MASSES_KG).saturating_sub(1), MASSES, MASSES_KG);
        let fails = points
            .iter()
            .filter(|row| row.number("virtual_mass_kg") == paper && !is_dead(row))
            .map(|row| row.number("gap_m"))
            .fold(0.0, f64::max);
        report.notes.push(format!(
            "{}: a virtual mass of {paper:.1} kg and a hand of {HAND_N_PER_M} N/m fail at gaps of up to {:.2} mm",
            case.name,
            fails * 1e3
        ));
        panels.push(panel(case, &points, bound));
    }
    let chart =
        Chart { title: format!("Near singularities, a hand of {HAND_N_PER_M} N/m: does a nudge die away?"), panels };
    report.charts.push(("study-stability-singular", chart));
}

fn panel(case: &Case, points: &[Row<'_>], bound: Vec<(f64, f64)>) -> Panel {
    let cells = |outcome: NudgeEffect, color| Series {
        name: outcome.word().to_owned(),
        points: points
            .iter()
            .filter(|row| row.word("outcome") == outcome.word())
            .map(|row| (row.number("gap_m") * 1e3, row.number("virtual_mass_kg")))
            .collect(),
        mark: Mark::Cells(CELL),
        color,
    };
    let line = bound.into_iter().map(|(gap_m, least_kg)| (gap_m * 1e3, least_kg)).collect();
    Panel {
        title: case.name.to_owned(),
        x: Axis::logarithmic("gap to the singularity (mm)").over(GAPS_M[0] * 1e3, GAPS_M[1] * 1e3),
        y: Axis::logarithmic("virtual mass (kg)").over(MASSES_KG[0], MASSES_KG[1]),
        series: vec![
            cells(NudgeEffect::Dies, Color::Pale),
            cells(NudgeEffect::Lasts, Color::Orange),
            cells(NudgeEffect::Lost, Color::Vermilion),
            cells(NudgeEffect::Refused, Color::Blue),
            Series { name: "theory, no dry friction".to_owned(), points: line, mark: Mark::Line, color: Color::Black },
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_motion::quantity::TipPoint;

    /// The tool would move thirty times as fast as the elbows: the arm says so before anything is not finite.
    #[test]
    fn an_arm_whose_elbows_almost_meet_is_refused() {
        let case = CASES.iter().find(|case| case.kind == Kind::DistalFolded).unwrap();
        assert_eq!(case.at(5e-3).run(HAND_N_PER_M, PAPER_KG, DURATION_S), NudgeEffect::Refused);
    }

    #[test]
    fn each_pose_is_near_its_own_singularity_and_no_other() {
        for case in &CASES {
            for gap_m in [0.5e-3, 20e-3] {
                let setting = case.at(gap_m);
                let linkage = setting.arm().unwrap().linkage;
                let posture = linkage.forward(linkage.inverse(TipPoint(setting.start_m)).unwrap()).unwrap();
                assert_eq!(posture.elbow_sides, setting.links.elbows);
                let clearance = linkage.clearance(&posture);
                let gaps = [
                    (Kind::Stretched, clearance.stretched_m[0].min(clearance.stretched_m[1])),
                    (Kind::Folded, clearance.folded_m[0].min(clearance.folded_m[1])),
                    (Kind::DistalStretched, clearance.distal_stretched_m),
                    (Kind::DistalFolded, clearance.distal_folded_m),
                ];
                for (kind, found_m) in gaps {
                    if kind == case.kind {
                        assert!((found_m - gap_m).abs() < 1e-9, "{kind:?}: {found_m} m, {gap_m} m");
                    } else {
                        assert!(found_m > 20e-3, "{:?} at {gap_m} m: {found_m} m from {kind:?}", case.kind);
                    }
                }
            }
        }
    }

    #[test]
    fn the_boundary_holds_near_every_kind() {
        for case in CASES.iter().filter(|case| case.setting.coulomb_n_m == 0.0) {
            // Nearer than this the arm refuses elbows that almost meet.
            for gap_m in [if case.kind == Kind::DistalFolded { 9e-3 } else { 0.5e-3 }, 12e-3] {
                let setting = case.at(gap_m);
                let least = setting.least_mass_kg(HAND_N_PER_M);
                assert_eq!(
                    setting.run(HAND_N_PER_M, 1.1 * least, DURATION_S),
                    NudgeEffect::Dies,
                    "{} {gap_m}",
                    case.name
                );
                assert_ne!(
                    setting.run(HAND_N_PER_M, 0.9 * least, DURATION_S),
                    NudgeEffect::Dies,
                    "{} {gap_m}",
                    case.name
                );
            }
        }
    }
}
