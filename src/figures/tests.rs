//! Every figure, from made-up runs: what must be in it, and what is refused.

use super::*;
use proptest::prelude::*;
use yieldwall_motion::elementary;
use yieldwall_record::{FaultMark, ForceMeaning, Phase, Reference, Setup};

const CIRCLE: Reference = Reference::Circle { center_m: [0.0, 0.0], radius_m: 0.12, is_inside_forbidden: true };

/// A tool that circles in and out across the reference circle while the force turns and trembles.
fn tour(row_count: usize) -> Trace {
    let rows = (0..row_count).map(|step| {
        let time_s = step as f64 * 1e-3;
        let radius_m = 0.12 + 0.03 * elementary::sin(0.9 * time_s);
        let (sine, cosine) = elementary::sin_cos(0.5 * time_s);
        let force_n = 15.0 * elementary::sin(0.9 * time_s) + 0.2 * elementary::sin(12.9898 * step as f64);
        Row {
            time_s,
            tool_m: [radius_m * cosine, radius_m * sine, 0.0],
            proxy_m: [(radius_m - 1e-4) * cosine, (radius_m - 1e-4) * sine, 0.0],
            force_n: [force_n * cosine, force_n * sine, 0.0],
            power_w: -0.03 * force_n.abs(),
            signed_distance_m: if step < row_count / 2 { 0.01 } else { 0.0 },
            tool_distance_m: radius_m - 0.12,
            tool_normal: [cosine, sine, 0.0],
            proxy_normal: [cosine, sine, 0.0],
            is_impact: step == row_count / 2,
            ..Row::default()
        }
    });
    let phase = |letter: &str, from_s, to_s| Phase { letter: letter.to_owned(), from_s, to_s };
    Trace {
        title: "tour".to_owned(),
        references: vec![CIRCLE],
        friction_n: 3.0,
        yield_n: 20.0,
        hold_steps: 15,
        setup: Setup {
            drive: "torque mode",
            law: "plastic".to_owned(),
            mass_kg: Some(2.0),
            period_s: Some(1e-3),
            ..Setup::default()
        },
        phases: vec![phase("a", 0.0, 1.0), phase("b", 1.0, 2.5)],
        rows: rows.collect(),
        ..Trace::default()
    }
}

fn near_circle() -> Window {
    Window { center_m: [0.12, 0.0], half_width_m: 0.01 }
}

/// All figures of one trace, or the first error.
fn draw_all(trace: &Trace, options: &Options) -> Result<Vec<Drawing>, Error> {
    Ok(vec![
        trajectory_and_time(trace, options)?,
        magnified(&[View { trace, window: near_circle() }], options)?,
        hold_comparison(&[trace, trace], options)?,
    ])
}

/// Width and height in the header of a PNG picture.
fn picture_size(png: &[u8]) -> (u32, u32) {
    assert_eq!(&png[..8], b"\x89PNG\r\n\x1a\n");
    let number = |at: usize| u32::from_be_bytes(png[at..at + 4].try_into().unwrap());
    (number(16), number(20))
}

#[test]
fn a_run_is_drawn_with_names_units_levels_and_phases() {
    let drawing = trajectory_and_time(&tour(5000), &Options::default()).unwrap();
    let svg = drawing.svg();
    assert!(svg.starts_with(r#"<svg xmlns="http://www.w3.org/2000/svg" width="160mm" "#), "{}", &svg[..200]);
    for text in
        ["x (mm)", "y (mm)", "radial force on the hand, \u{2212}h (N)", "power (W)", "time t (s)", "tool", "proxy"]
    {
        assert!(svg.contains(&format!(">{text}</text>")), "{text}");
    }
    assert!(svg.contains(">20 N (force on the hand, \u{2212}h)</text>"));
    for level in ["R", "F"] {
        assert_eq!(svg.matches(&format!(r#"<tspan font-style="italic">{level}</tspan>"#)).count(), 2, "{level}");
    }
    assert_eq!(svg.matches(">a</text>").count(), 2, "beside the way and below the curve");
    let (width, height) = picture_size(&drawing.png(800).unwrap());
    assert_eq!(width, 800);
    assert!((300..800).contains(&height));
}

#[test]
fn an_impedance_run_shows_the_actuator_force() {
    let trace = Trace { force_meaning: ForceMeaning::ActuatorOnTool, ..tour(2000) };
    let svg = trajectory_and_time(&trace, &Options::default()).unwrap().svg();
    assert!(svg.contains(">radial force on the hand, f (N)</text>"));
    assert!(!svg.contains("\u{2212}h"));
}

const SWUNG: &str = ">where it swings to</text>";

/// All of several surfaces, and one that moves twice: where it is at rest and where it is farthest.
#[test]
fn every_surface_is_drawn_and_a_moving_one_also_where_it_swings_to() {
    let line = |x_m: f64| Reference::Plane { point_m: [x_m, 0.0, 0.0], normal: [1.0, 0.0, 0.0] };
    let point = Reference::Point { point_m: [0.13, 0.01], capture_radius_m: 0.005 };
    let drawn = |references: Vec<Reference>, swing_m: f64| {
        let mut trace = Trace { references, ..tour(2000) };
        let count = trace.rows.len() as f64;
        let share = |step: usize| elementary::sin(std::f64::consts::PI * step as f64 / count);
        trace.rows.iter_mut().enumerate().for_each(|(step, row)| row.surface_m[0] = swing_m * share(step));
        trajectory_and_time(&trace, &Options::default()).unwrap().svg()
    };
    let paths = |svg: &str| svg.matches("<polyline").count() + svg.matches("<path").count();
    let dots = |svg: &str| svg.matches("<circle").count();
    let (none, one) = (drawn(Vec::new(), 0.0), drawn(vec![line(0.12)], 0.0));
    let (two, moving) = (drawn(vec![line(0.12), line(0.13)], 0.0), drawn(vec![line(0.12)], 0.02));
    assert!(one.contains(">reference surface</text>") && !one.contains(SWUNG));
    assert!(moving.contains(">reference surface</text>") && moving.contains(SWUNG));
    assert_eq!(paths(&two), paths(&one) + 2, "a band and a line more");
    assert!(paths(&moving) > paths(&one) + 20, "the dashes of the line and of its sample in the legend");
    assert!(paths(&one) > paths(&none));
    assert_eq!(dots(&drawn(vec![point], 0.0)), dots(&one) + 1);
}

/// A black box is drawn to see what the fault did: it is within the drawing, by name, with the time after it.
#[test]
fn a_fault_is_named_and_what_came_after_it_is_drawn() {
    let mut trace = tour(2000);
    trace.after = trace.rows.split_off(1200);
    trace.faults =
        vec![FaultMark { time_s: 0.4, fault: "sensor-stale" }, FaultMark { time_s: 1.199, fault: "node-reset" }];
    let svg = trajectory_and_time(&trace, &Options::default()).unwrap().svg();
    for text in ["sensor-stale", "node-reset", "fault"] {
        assert!(svg.contains(&format!(">{text}</text>")), "{text}");
    }
    let last = trace.after.last().unwrap().time_s;
    let excerpt = Excerpt::new(&trace, TimeSpan::Whole).unwrap();
    assert_eq!((excerpt.span[1], excerpt.led().count(), excerpt.rows.len()), (last, 1200, 2000));
    let before = Options { time_span: TimeSpan::Between { from_s: 0.0, to_s: 1.0 }, ..Options::default() };
    let svg = trajectory_and_time(&trace, &before).unwrap().svg();
    assert!(svg.contains(">sensor-stale</text>") && !svg.contains(">node-reset</text>"), "the other is outside");
}

/// Forty faults of one moment do not cover the curve with their names.
#[test]
fn no_more_names_of_faults_than_have_room() {
    let at = |step: u32| FaultMark { time_s: 1.0 + 1e-3 * f64::from(step), fault: "lag" };
    let trace = Trace { faults: (0..40).map(at).collect(), ..tour(2000) };
    let svg = trajectory_and_time(&trace, &Options::default()).unwrap().svg();
    assert_eq!(svg.matches(">lag</text>").count(), 4);
}

/// The strokes of a hatch end on the forbidden side of every surface that has one.
#[test]
fn the_forbidden_side_is_hatched() {
    let near = |reference: Reference, is_unilateral: bool| {
        let trace = Trace { references: vec![reference], is_unilateral, ..tour(3000) };
        let excerpt = Excerpt::new(&trace, TimeSpan::Whole).unwrap();
        let axes =
            axes::Axes::with_equal_scales(plane::frame(0.0, 0.0, 700.0, 700.0), [-200.0, 200.0], [-200.0, 200.0]);
        let places = plane::Places::new(&trace, &excerpt);
        let line = places.ends().next().and_then(|place| plane::line(&trace.references[0], place, &axes)).unwrap();
        let paper: Vec<_> = line.iter().map(|(x, y)| axes.place(*x, *y)).collect();
        let per_mm = axes.length_per_unit();
        let tips = marks::hatch_strokes(&paper).map(|[_, (x, y)]| (x / per_mm - 200.0, 200.0 - y / per_mm));
        let svg = trajectory_and_time(&trace, &Options::default()).unwrap().svg();
        assert_eq!(svg.contains("(hatched side forbidden)</text>"), is_unilateral);
        tips.collect::<Vec<_>>()
    };
    let round = |is_inside_forbidden| Reference::Circle { center_m: [0.0, 0.0], radius_m: 0.12, is_inside_forbidden };
    let boxed = |is_inside_forbidden| Reference::Box {
        center_m: [0.0; 3],
        half_size_m: [0.12, 0.12, 0.1],
        is_inside_forbidden,
    };
    let ball = |is_inside_forbidden| Reference::Sphere { center_m: [0.0; 3], radius_m: 0.12, is_inside_forbidden };
    let greatest = |(x, y): (f64, f64)| x.abs().max(y.abs());
    let radius = |(x, y): (f64, f64)| elementary::hypot(x, y);
    for is_inside in [true, false] {
        for tips in [near(round(is_inside), true), near(ball(is_inside), true)] {
            assert!(tips.len() > 20 && tips.iter().all(|tip| (radius(*tip) < 120.0) == is_inside), "{tips:?}");
        }
        // But for the first stroke behind a corner.
        let mut tips = near(boxed(is_inside), true);
        tips.retain(|(x, y)| (x.abs() - y.abs()).abs() > 12.0);
        assert!(tips.len() > 20 && tips.iter().all(|tip| (greatest(*tip) < 120.0) == is_inside), "{tips:?}");
    }
    let line = Reference::Plane { point_m: [0.1, 0.0, 0.0], normal: [1.0, 0.0, 0.0] };
    assert!(near(line, true).iter().all(|(x, _)| *x < 100.0), "against the normal");
    let curve = Reference::Curve { points_m: vec![[-0.1, 0.05], [0.1, 0.05]], is_closed: false };
    assert!(near(curve, true).iter().all(|(_, y)| *y < 50.0), "to the right of the way");
    near(round(true), false);
}

/// A sphere is cut where the tool is: the proxy lies on what is drawn, not inside an outline.
#[test]
fn surfaces_in_space_are_cut_at_the_heights_of_the_proxy() {
    let ball = Reference::Sphere { center_m: [0.0, 0.0, -0.03], radius_m: 0.05, is_inside_forbidden: true };
    let on = |height_m: f64| {
        let mut trace = Trace { references: vec![ball.clone()], ..tour(2000) };
        trace.rows.iter_mut().for_each(|row| (row.proxy_m[2], row.is_on_surface) = (height_m * row.time_s / 2.0, true));
        trajectory_and_time(&trace, &Options::default()).unwrap().svg()
    };
    let flat = on(0.0);
    assert!(flat.contains(">reference surface at z = 0.0 mm</text>") && flat.contains(">outline</text>"));
    assert!(flat.contains(">distance from the surface (mm)</text>"));
    assert!(on(0.01).contains(">reference surface at z = 0.0 to 10.0 mm</text>"));
    let mut middle = Trace { references: vec![ball.clone()], ..tour(2000) };
    middle.rows.iter_mut().for_each(|row| (row.proxy_m[2], row.is_on_surface) = (-0.03, true));
    let svg = trajectory_and_time(&middle, &Options::default()).unwrap().svg();
    assert!(svg.contains(" at z = \u{2212}30.0 mm</text>") && !svg.contains(">outline</text>"));
    // Above the sphere there is no section, and nothing in the legend that is not in the drawing.
    let mut above = Trace { references: vec![ball.clone()], ..tour(2000) };
    above.rows.iter_mut().for_each(|row| row.tool_m[2] = 0.03);
    let svg = trajectory_and_time(&above, &Options::default()).unwrap().svg();
    assert!(svg.contains(">outline</text>") && !svg.contains(">reference surface"));
}

/// Each run has its line in the plane and in both panels over time, and its name once.
#[test]
fn runs_are_drawn_over_one_another_each_with_a_line_of_its_own() {
    let long = &"a name that is longer than any legend has room for".repeat(3);
    let names = ["A", "B", "C", "D", "E", long];
    let traces: Vec<Trace> = (0..6).map(|number| Trace { yield_n: 20.0 + f64::from(number), ..tour(900) }).collect();
    let runs: Vec<(&str, &Trace)> = names.into_iter().zip(&traces).collect();
    let svg = comparison(&runs, &Options::default()).unwrap().svg();
    for name in &names[..5] {
        assert_eq!(svg.matches(&format!(">{name}</text>")).count(), 1, "{name}");
    }
    assert!(svg.contains("\u{2026}</text>") && !svg.contains(long));
    for color in ["#56b4e9", "#a83200", "#009e73", "#e69f00", "#cc79a7"] {
        let strokes = svg.matches(&format!(r#"stroke="{color}""#)).count();
        assert!(strokes >= 4, "{color}: {strokes} of legend, way, force and distance");
    }
    // F and R are drawn where they are those of all.
    let level = r#"<tspan font-style="italic">R</tspan>"#;
    assert!(!svg.contains(level));
    assert!(comparison(&[runs[0], runs[0]], &Options::default()).unwrap().svg().contains(level));
    let free = Trace { references: Vec::new(), ..tour(100) };
    let svg = comparison(&[runs[0], ("free", &free)], &Options::default()).unwrap().svg();
    assert!(!svg.contains(">distance of the tool") && svg.contains(">force along the normal (N)</text>"));
    for count in [0, 7] {
        let runs: Vec<(&str, &Trace)> = (0..count).map(|_| runs[0]).collect();
        assert!(matches!(comparison(&runs, &Options::default()), Err(Error::PanelCount { .. })));
    }
}

/// A mark that is not in the picture is not in its legend.
#[test]
fn every_entry_of_the_legend_has_a_mark() {
    let far = Reference::Plane { point_m: [5.0, 0.0, 0.0], normal: [1.0, 0.0, 0.0] };
    let mut trace = Trace { references: vec![far], ..tour(2000) };
    trace.rows.iter_mut().for_each(|row| row.force_n = [0.0; 3]);
    let svg = trajectory_and_time(&trace, &Options::default()).unwrap().svg();
    assert!(!svg.contains(">reference surface") && !svg.contains("(force on the hand"));
    assert!(svg.contains(">tool</text>") && svg.contains(">proxy</text>"));
}

/// A yield force of its own against pushes outward is not the same as `-R`.
#[test]
fn an_outward_yield_force_has_a_name_of_its_own() {
    let named = |trace: Trace| {
        let svg = trajectory_and_time(&trace, &Options::default()).unwrap().svg();
        svg.matches(">out</text>").count()
    };
    assert_eq!(named(tour(5000)), 0);
    assert_eq!(named(Trace { outward_yield_n: Some(8.0), ..tour(5000) }), 1);
}

#[test]
fn no_more_arrows_than_allowed() {
    let arrows = |arrow_limit| {
        let svg = trajectory_and_time(&tour(20_000), &Options { arrow_limit, ..Options::default() }).unwrap().svg();
        // Arrow heads are the only closed paths; one of them is the scale's.
        svg.matches(" Z\"").count() - 1
    };
    assert!((20..=140).contains(&arrows(140)), "{}", arrows(140));
    assert!((5..=30).contains(&arrows(30)), "{}", arrows(30));
}

#[test]
fn views_and_columns_are_headed_by_their_hold() {
    let (zero, five) = (Trace { hold_steps: 0, ..tour(3000) }, Trace { hold_steps: 5, ..tour(3000) });
    let views = [&zero, &five].map(|trace| View { trace, window: near_circle() });
    let around = TimeSpan::AroundImpact { before_s: 0.02, after_s: 0.04 };
    let options = Options { time_span: around, heading: Some("A & B".to_owned()), ..Options::default() };
    let views = magnified(&views, &Options { time_span: TimeSpan::Whole, ..options.clone() }).unwrap().svg();
    let columns = hold_comparison(&[&zero, &five], &options).unwrap().svg();
    for svg in [&views, &columns] {
        for text in ["N_wait 0", "N_wait 5", "A &amp; B", "torque mode, plastic, R 20 N, F 3 N, M 2 kg, T 1 ms"] {
            assert!(svg.contains(&format!(">{text}</text>")), "{text}");
        }
        assert!(!svg.contains("(force on the hand"), "no arrows");
    }
    assert_eq!(columns.matches(">time since impact (ms)</text>").count(), 2);
    assert_eq!(columns.matches(">force along the normal (N)</text>").count(), 2);
}

#[test]
fn a_minute_at_a_kilohertz_stays_small() {
    for drawing in draw_all(&tour(60_000), &Options::default()).unwrap() {
        let bytes = drawing.svg().len();
        assert!(bytes < 400_000, "{bytes} bytes");
    }
}

#[test]
fn the_same_trace_gives_the_same_figure() {
    let svg = || trajectory_and_time(&tour(3000), &Options::default()).unwrap().svg();
    assert_eq!(svg(), svg());
}

#[test]
fn runs_without_change_have_axes_too() {
    let one = tour(1);
    let still = Trace { rows: vec![Row { force_n: [0.0; 3], ..one.rows[0] }; 50], ..one.clone() };
    let free = Trace { references: Vec::new(), friction_n: 0.0, yield_n: 0.0, ..tour(100) };
    for trace in [one, still, free] {
        let svg = trajectory_and_time(&trace, &Options::default()).unwrap().svg();
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
    }
}

#[test]
fn an_embedded_font_goes_into_the_file() {
    let options = Options { is_font_embedded: true, ..Options::default() };
    assert!(trajectory_and_time(&tour(10), &options).unwrap().svg().contains("@font-face"));
}

#[test]
fn values_that_cannot_be_drawn_are_named() {
    let spoil = |change: fn(&mut Row)| {
        let mut trace = tour(10);
        change(&mut trace.rows[7]);
        draw_all(&trace, &Options::default()).unwrap_err().to_string()
    };
    assert_eq!(spoil(|row| row.force_n[2] = f64::NAN), "row 7: force_n is NaN, not a finite number up to 1e9");
    assert!(spoil(|row| row.tool_m[0] = f64::INFINITY).starts_with("row 7: tool_m is inf"));
    assert!(spoil(|row| row.time_s = -2e9).starts_with("row 7: time_s is -2000000000"));
}

#[test]
fn traces_that_cannot_be_drawn_are_refused() {
    let refuse = |trace: &Trace, options: &Options| draw_all(trace, options).unwrap_err();
    let options = Options::default();
    assert!(matches!(refuse(&tour(0), &options), Error::Empty { .. }));
    let spans = |time_span| Options { time_span, ..Options::default() };
    let late = spans(TimeSpan::Between { from_s: 9.0, to_s: 10.0 });
    assert!(matches!(refuse(&tour(10), &late), Error::EmptySpan { from_s: 9.0, .. }));
    let mut smooth = tour(10);
    smooth.rows.iter_mut().for_each(|row| row.signed_distance_m = 0.01);
    let around = spans(TimeSpan::AroundImpact { before_s: 0.1, after_s: 0.1 });
    assert!(matches!(refuse(&smooth, &around), Error::NoImpact { .. }));
    let level = Reference::Plane { point_m: [0.0; 3], normal: [0.0, 0.0, 1.0] };
    assert!(matches!(refuse(&Trace { references: vec![level], ..tour(10) }, &options), Error::NoLine { .. }));
    let lying = Reference::Cylinder {
        axis_point_m: [0.0; 3],
        axis_direction: [1.0, 0.0, 0.0],
        radius_m: 0.1,
        is_inside_forbidden: false,
    };
    assert!(matches!(refuse(&Trace { references: vec![lying], ..tour(10) }, &options), Error::NoLine { .. }));
    let empty = Reference::Circle { center_m: [0.0, 0.0], radius_m: 0.0, is_inside_forbidden: false };
    assert!(matches!(
        refuse(&Trace { references: vec![empty], ..tour(10) }, &options),
        Error::Setting { field: "radius_m", .. }
    ));
    assert!(matches!(refuse(&Trace { yield_n: f64::NAN, ..tour(10) }, &options), Error::Setting { .. }));
}

#[test]
fn settings_that_cannot_be_drawn_are_refused() {
    let (trace, options) = (tour(10), Options::default());
    let view = View { trace: &trace, window: Window { center_m: [0.0, 0.0], half_width_m: 0.0 } };
    assert!(matches!(magnified(&[view], &options), Err(Error::Setting { value: 0.0, .. })));
    let near = View { trace: &trace, window: near_circle() };
    assert!(matches!(magnified(&[near; 10], &options), Err(Error::PanelCount { count: 10, most: 9 })));
    assert!(matches!(hold_comparison(&[], &options), Err(Error::PanelCount { count: 0, most: 3 })));
    let free = Trace { references: Vec::new(), ..tour(10) };
    assert!(matches!(hold_comparison(&[&free], &options), Err(Error::NoLine { .. })));
    let drawing = trajectory_and_time(&trace, &options).unwrap();
    assert!(matches!(drawing.png(99), Err(Error::PictureWidth { width_px: 99 })));
    let nowhere = Path::new("/nowhere at all/figure.svg");
    assert!(matches!(drawing.write_svg(nowhere), Err(Error::Write { .. })));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_finite_numbers_are_drawn_without_panic(
        numbers in prop::collection::vec((any::<bool>(), -1.0..1.0f64, -12..10i32), 22..110),
        radius_power in -9..10i32,
    ) {
        let value = |(is_zero, part, power): (bool, f64, i32)| {
            if is_zero { 0.0 } else { (part * elementary::powi(10.0, power)).clamp(-1e9, 1e9) }
        };
        let numbers: Vec<f64> = numbers.into_iter().map(value).collect();
        let rows = numbers.chunks_exact(11).map(|n| Row {
            time_s: n[0],
            tool_m: [n[1], n[2], n[3]],
            proxy_m: [n[4], n[5], n[6]],
            force_n: [n[7], n[8], n[9]],
            power_w: n[10],
            ..Row::default()
        });
        let reference = Reference::Circle {
            center_m: [0.0, 0.0],
            radius_m: elementary::powi(10.0, radius_power),
            is_inside_forbidden: false,
        };
        let trace = Trace { rows: rows.collect(), references: vec![reference], ..tour(0) };
        let options = Options::default();
        let mut drawings = vec![
            trajectory_and_time(&trace, &options).unwrap(),
            magnified(&[View { trace: &trace, window: near_circle() }], &options).unwrap(),
        ];
        match hold_comparison(&[&trace], &options) {
            Ok(drawing) => drawings.push(drawing),
            Err(error) => prop_assert!(matches!(error, Error::NoLine { .. }), "{error}"),
        }
        for drawing in drawings {
            let svg = drawing.svg();
            prop_assert!(!svg.contains("NaN") && !svg.contains("inf"));
            prop_assert!(drawing.png(200).is_ok());
        }
    }
}

/// The figures that the program draws.
fn drawn(trace: &Trace) -> Vec<String> {
    let options = Options { heading: Some("A title".to_owned()), ..Options::default() };
    let other = Trace { setup: Setup { period_s: Some(5e-4), ..trace.setup.clone() }, yield_n: 12.5, ..trace.clone() };
    let mut all: Vec<String> = draw_all(trace, &options).unwrap().iter().map(Drawing::svg).collect();
    all.push(comparison(&[("A", trace), ("B", &other)], &options).unwrap().svg());
    all.extend((1..=MOST_MOVING).map(|count| animation(&vec![("run", trace); count]).unwrap()));
    all
}

/// Every text has at least 7 pt where the figure is 160 mm wide, and no number has an exponent.
#[test]
fn texts_can_be_read_in_print() {
    let tube = Trace { outward_yield_n: Some(8.0), ..tour(5000) };
    for svg in [tour(5000), tube].iter().flat_map(drawn) {
        let after = |text: &str, from: &str| text.split_once(from).unwrap().1.to_owned();
        let number = |text: &str| text.split('"').next().unwrap().parse::<f64>().unwrap();
        let width = after(&svg, "viewBox=\"0 0 ").split(' ').next().unwrap().parse::<f64>().unwrap();
        let texts: Vec<&str> = svg.split("<text ").skip(1).collect();
        assert!(texts.len() > 5);
        for text in texts {
            let points = number(&after(text, "font-size=\"")) * 160.0 / width * 72.0 / 25.4;
            assert!(points >= 7.0, "{points} pt: {text}");
            let words = after(text, ">").split("</text>").next().unwrap().to_owned();
            let has_exponent = words.as_bytes().windows(3).any(|at| {
                at[0].is_ascii_digit() && at[1].eq_ignore_ascii_case(&b'e') && (at[2].is_ascii_digit() || at[2] == b'-')
            });
            assert!(!has_exponent, "{words}");
        }
    }
}

/// A heading has what is known and common; what differs is named for each run.
#[test]
fn headings_have_the_numbers_of_the_run_with_units() {
    let heading = |trace: &Trace| heading::in_common(&[trace]);
    let whole = tour(10);
    assert_eq!(heading(&whole), "torque mode, plastic, R 20 N, F 3 N, M 2 kg, T 1 ms, N_wait 15");
    let spring = Setup { law: "spring of 1500 N/m".to_owned(), is_unyielding: true, ..whole.setup.clone() };
    let spring = Trace { setup: spring, ..whole.clone() };
    assert_eq!(heading(&spring), "torque mode, spring of 1500 N/m, F 3 N, M 2 kg, T 1 ms, N_wait 15");
    let bare = Trace {
        setup: Setup { is_hold_automatic: true, ..Setup::default() },
        friction_n: 0.25,
        yield_n: 2.0 / 3.0,
        ..whole.clone()
    };
    assert_eq!(heading(&bare), "R 0.6667 N, F 0.25 N");
    assert_eq!(heading(&Trace { references: Vec::new(), ..bare }), "F 0.25 N");
    assert_eq!(differences(&[&whole, &spring]), ["plastic, R 20 N", "spring of 1500 N/m"]);
    assert_eq!(differences(&[&whole, &whole]), ["", ""]);
    let svg = run(&whole, String::new()).unwrap().svg();
    assert!(svg.contains(">torque mode, plastic, R 20 N, F 3 N, M 2 kg, T 1 ms, N_wait 15</text>"));
    let svg = trajectory_and_time(&whole, &Options::default()).unwrap().svg();
    assert!(!svg.contains("torque mode"), "a paper has its caption");
}

/// Start, end and break-outs are in the plane, break-outs in the force too, and each has a name.
#[test]
fn start_end_and_break_outs_are_marked() {
    let mut trace = Trace { yield_n: 8.0, ..tour(2000) };
    trace.rows.iter_mut().skip(400).take(300).for_each(|row| row.is_on_surface = true);
    let marked = |trace: &Trace| {
        let svg = trajectory_and_time(trace, &Options::default()).unwrap().svg();
        let named = ["start", "end", "surface gives way"].map(|name| svg.contains(&format!(">{name}</text>")));
        (named, svg.matches("#f5b02e").count())
    };
    assert_eq!(marked(&trace), ([true; 3], 3), "in the legend, in the plane and over time");
    assert_eq!(marked(&tour(2000)), ([true, true, false], 0));
    // Where the run stands at its window is not all of it.
    let window = Some(Window { center_m: [0.0, 0.12], half_width_m: 0.005 });
    let svg = trajectory_and_time(&trace, &Options { window, ..Options::default() }).unwrap().svg();
    assert!(!svg.contains(">start</text>") && !svg.contains(">end</text>"));
}

/// The plane has the part that the tool used, with a margin: no whole circle around a short arc.
#[test]
fn the_plane_shows_what_the_tool_used() {
    let drawn = |rows: usize| {
        let mut trace = tour(rows);
        trace.rows.iter_mut().for_each(|row| row.force_n = [0.0; 3]);
        trajectory_and_time(&trace, &Options::default()).unwrap().svg()
    };
    let left = format!(">{}</text>", axes::number(-100.0, 0));
    assert!(!drawn(1000).contains(&left), "half a radian");
    assert!(drawn(13_000).contains(&left), "all of the circle");
}
