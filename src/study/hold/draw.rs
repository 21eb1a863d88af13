//! The charts of the study.

use super::super::chart::{Axis, Chart, Color, Estimate, Mark, Panel, Series};
use super::super::sweep::Table;
use super::trial::{GRIPS, PLACES, RULES, Rule, StruckSurface};
use super::{CASES, ONSETS_MS, impacts_of, of_rule, pushes_of};

/// The push of the curve begins this long after the impact, in ms.
const ONSET_MS: u32 = 100;
/// Rules whose delays are drawn over the onset: among them the default.
const SHOWN: [Rule; 6] = [
    Rule::Fixed(50),
    Rule::Fixed(150),
    Rule::Fixed(200),
    Rule::Automatic(150),
    Rule::Automatic(200),
    Rule::Automatic(300),
];

/// All charts.
pub(super) fn charts(impacts: &Table, pushes: &Table) -> Vec<(&'static str, Chart)> {
    vec![
        ("study-hold-window", window(impacts, pushes)),
        ("study-hold-delay", delay(pushes)),
        ("study-hold-places", places(impacts)),
    ]
}

fn rules(name: &str) -> impl Iterator<Item = Rule> + '_ {
    RULES.into_iter().filter(move |rule| rule.name() == name)
}

fn color(name: &str) -> Color {
    if name == "automatic" { Color::Blue } else { Color::Vermilion }
}

fn mark(name: &str) -> Mark {
    if name == "automatic" { Mark::MarkedLine } else { Mark::MarkedDashes }
}

/// The hands that break through, in percent.
const SHARE: [&str; 3] = ["share", "share_low", "share_high"];

/// Break-through against delay, over the windows.
fn window(impacts: &Table, pushes: &Table) -> Chart {
    let panel = |grips| {
        let mut series = Vec::new();
        for name in ["N_wait", "automatic"] {
            let (mut points, mut default) = (Vec::new(), Vec::new());
            for rule in rules(name) {
                let row = of_rule(impacts_of(impacts, StruckSurface::Wall, grips), rule);
                let Some((row, push)) = row.zip(of_rule(pushes_of(pushes, grips, ONSET_MS), rule)) else { continue };
                let x = 1e3 * push.number("delay_s");
                if !x.is_finite() {
                    continue;
                }
                let share = row.estimate(SHARE, 100.0);
                points.push((Estimate::from(x), share));
                if rule == DEFAULT {
                    default.push((x, share.value));
                }
            }
            series.extend(Series::new(name.to_owned(), mark(name), color(name)).through(&points));
            if !default.is_empty() {
                let name = format!("{name}, {} ms: the default", DEFAULT.window_ms());
                series.push(Series { name, points: default, mark: Mark::Marks, color: Color::Black });
            }
        }
        Panel {
            title: format!("{} grips", grips.name),
            x: Axis::linear("median delay of a push (ms)").over(-10.0, 330.0),
            y: Axis::logarithmic("hands that break through (%)").over(LEAST, 100.0),
            series,
        }
    };
    Chart {
        title: format!("Windows of 15 to 500 ms, plane wall, {CASES} hands a mark, intervals of 95 %"),
        panels: GRIPS.iter().map(panel).collect(),
    }
}

/// Rule of a rig whose file names none.
pub(super) const DEFAULT: Rule = Rule::Automatic(150);

/// Lower edge of the axis of shares, in percent.
const LEAST: f64 = 0.005;

fn delay(pushes: &Table) -> Chart {
    let panel = |title: &str, column: &str| Panel {
        title: title.to_owned(),
        x: Axis::linear("push begins after the impact (ms)").over(0.0, 420.0),
        y: Axis::linear("delay of the push (ms)").over(-10.0, 330.0),
        series: (SHOWN.into_iter().zip([
            Color::Orange,
            Color::Vermilion,
            Color::Purple,
            Color::Sky,
            Color::Blue,
            Color::Green,
        ]))
        .map(|(rule, color)| Series {
            name: format!("{} {} ms", rule.name(), rule.window_ms()),
            points: ONSETS_MS
                .into_iter()
                .filter_map(|onset_ms| {
                    let row = of_rule(pushes_of(pushes, &GRIPS[0], onset_ms), rule)?;
                    Some((f64::from(onset_ms), 1e3 * row.number(column)))
                })
                .collect(),
            mark: mark(rule.name()),
            color,
        })
        .collect(),
    };
    Chart {
        title: "How long a push of 1.5 R waits, usual grips".to_owned(),
        panels: vec![panel("median", "delay_s"), panel("95 %", "delay_95_s"), panel("longest", "delay_max_s")],
    }
}

fn places(impacts: &Table) -> Chart {
    let colors = [Color::Black, Color::Vermilion, Color::Green, Color::Blue];
    let panel = |grips| {
        let mut series = Vec::new();
        for (place, color) in PLACES.into_iter().zip(colors) {
            let mut points = Vec::new();
            for rule in rules("automatic") {
                let Some(row) = of_rule(impacts_of(impacts, place, grips), rule) else { continue };
                let x = f64::from(rule.window_ms());
                points.push((Estimate::from(x), row.estimate(SHARE, 100.0)));
            }
            series.extend(Series::new(place.name().to_owned(), Mark::MarkedLine, color).through(&points));
        }
        Panel {
            title: format!("{} grips", grips.name),
            x: Axis::logarithmic("window of the automatic hold (ms)").over(40.0, 650.0),
            y: Axis::logarithmic("hands that break through (%)").over(LEAST, 100.0),
            series,
        }
    };
    Chart {
        title: format!("The automatic hold at other surfaces, {CASES} hands a mark with intervals of 95 %"),
        panels: GRIPS.iter().map(panel).collect(),
    }
}
