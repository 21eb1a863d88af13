//! Cost of one step of the fixture, along a motion that meets the surface, lies on it and leaves it.

mod on_core;

use std::hint::black_box;
use yieldwall::elementary;

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{SVector, Vector2, Vector3};
use on_core::OnCore;
use yieldwall::fixture::{
    Admittance, Chain, Circle, Coupling, Cuboid, Curvature, Cylinder, Fixture, Forbidden, Impedance, Limits, Line,
    ON_SURFACE_TOLERANCE_M, Parameters, Plane, Rearm, Shape2, Shape3, Side, Sphere, Surface,
};

const PERIOD_S: f64 = 1e-3;
/// Length of the motion, after which it starts anew.
const STEPS: usize = 8192;
/// Size of the surfaces and of the motion across them.
const RADIUS_M: f64 = 0.12;
const SWING_M: f64 = 0.08;
/// Spring and damper that pull the tool.
const PULL_N_PER_M: f64 = 400.0;
const PULL_N_S_PER_M: f64 = 8.0;

/// `M = 2 kg`, `F = 3 N`, `R = 20 N` as in the second experiment of [KTF08].
fn admittance(curvature: Curvature) -> Parameters {
    Parameters {
        coupling: Coupling::Admittance(Admittance { mass_kg: 2.0 }),
        limits: Limits { friction_n: 3.0, yield_n: 20.0 },
        side: Side::Bilateral,
        // Without a hold a tool of 2 kg at hand speed passes through: only below R T / M = 10 mm/s does R stop it at once.
        hold_steps: 100,
        rearm: Rearm::default(),
        curvature,
        period_s: PERIOD_S,
    }
}

/// `K = 1000 N/m`, `B = 1.5 N s/m`, `F = 0.5 N`, `R = 3 N` as in the first.
fn impedance() -> Parameters {
    Parameters {
        coupling: Coupling::Impedance(Impedance { stiffness_n_per_m: 1000.0, damping_n_s_per_m: 1.5 }),
        limits: Limits { friction_n: 0.5, yield_n: 3.0 },
        ..admittance(Curvature::Tangent)
    }
}

/// Swings across the surfaces while it turns about the z axis.
fn target<const N: usize>(step: usize) -> SVector<f64, N> {
    let turn = step as f64 / STEPS as f64 * std::f64::consts::TAU;
    let radius_m = RADIUS_M + SWING_M * elementary::sin(2.0 * turn);
    let full = [
        radius_m * elementary::cos(turn),
        radius_m * elementary::sin(turn),
        0.5 * SWING_M * elementary::sin(3.0 * turn),
    ];
    SVector::from_fn(|axis, _| full[axis])
}

/// Where the motion starts, and the input of every step, made once with the loop closed so that a replay is the same.
struct Motion<const N: usize> {
    start: SVector<f64, N>,
    inputs: Vec<SVector<f64, N>>,
}

fn motion<S: Surface<N> + Clone, const N: usize>(name: &str, fixture: &Fixture<S, N>) -> Motion<N> {
    let mut fixture = fixture.clone();
    let is_admittance = matches!(fixture.parameters().coupling, Coupling::Admittance(_));
    let start = target(0);
    fixture.reset(&start).expect("a finite start");
    let mut before = start;
    let mut on_surface = 0;
    let inputs = (0..STEPS)
        .map(|step| {
            let proxy = *fixture.proxy();
            let rate = (proxy - before) / PERIOD_S;
            before = proxy;
            let input = if is_admittance {
                (target(step) - proxy) * PULL_N_PER_M - rate * PULL_N_S_PER_M
            } else {
                target(step)
            };
            let step = if is_admittance { fixture.step_admittance(&input) } else { fixture.step_impedance(&input) };
            on_surface += usize::from(step.signed_distance_m.abs() <= ON_SURFACE_TOLERANCE_M);
            input
        })
        .collect();
    println!("{name}: {} % of the steps end on the surface", 100 * on_surface / STEPS);
    Motion { start, inputs }
}

fn bench<S: Surface<N> + Clone, const N: usize>(
    criterion: &mut Criterion<OnCore>,
    name: &str,
    fixture: &Fixture<S, N>,
) {
    let mut fixture = fixture.clone();
    let is_admittance = matches!(fixture.parameters().coupling, Coupling::Admittance(_));
    let motion = motion(name, &fixture);
    let mut step = 0;
    criterion.bench_function(name, |bencher| {
        bencher.iter(|| {
            if step == 0 {
                fixture.reset(&motion.start).expect("a finite start");
            }
            let input = black_box(&motion.inputs[step]);
            step = (step + 1) % STEPS;
            if is_admittance { fixture.step_admittance(input) } else { fixture.step_impedance(input) }
        });
    });
}

fn planar(criterion: &mut Criterion<OnCore>) {
    let circle = Shape2::Circle(Circle::new(Vector2::zeros(), RADIUS_M, Forbidden::Inside).expect("a circle"));
    let line = Shape2::Line(Line::new(Vector2::zeros(), Vector2::new(0.6, 0.8)).expect("a line"));
    for (name, shape, curvature) in [
        ("2-D circle", circle.clone(), Curvature::Tangent),
        ("2-D circle, exact curvature", circle, Curvature::Exact),
        ("2-D line", line, Curvature::Tangent),
    ] {
        bench(criterion, name, &Fixture::new(shape, admittance(curvature)).expect("a fixture"));
    }
}

/// A closed curve near the circle, with a waist, and a square about its place.
fn chains(criterion: &mut Criterion<OnCore>) {
    let ring = |count: usize, waist: f64| -> Vec<Vector2<f64>> {
        let turn = |index: usize| index as f64 / count as f64 * std::f64::consts::TAU;
        (0..count)
            .map(|index| {
                Vector2::new(elementary::cos(turn(index)), elementary::sin(turn(index)))
                    * (RADIUS_M + waist * elementary::cos(2.0 * turn(index)))
            })
            .collect()
    };
    let square = Chain::polygon(&ring(4, 0.0), Forbidden::Inside).expect("a square");
    let polygon = Chain::polygon(&ring(64, 0.01), Forbidden::Inside).expect("a polygon");
    let fine = Chain::polygon(&ring(4096, 0.01), Forbidden::Inside).expect("a polygon");
    let finest = Chain::polygon(&ring(32_768, 0.01), Forbidden::Inside).expect("a polygon");
    let curve = Chain::closed_curve(&ring(16, 0.01), Forbidden::Inside).expect("a curve");
    println!("the curve has {} pieces", curve.pieces());
    for (name, chain) in [
        ("2-D polygon, 4 corners", square),
        ("2-D polygon, 64 corners", polygon),
        ("2-D polygon, 4096 corners", fine),
        ("2-D polygon, 32768 corners", finest),
        ("2-D closed curve", curve),
    ] {
        bench(criterion, name, &Fixture::new(Shape2::Chain(chain), admittance(Curvature::Tangent)).expect("a fixture"));
    }
    let cuboid = Cuboid::new(Vector3::zeros(), Vector3::new(0.1, 0.12, 0.2), Forbidden::Inside).expect("a box");
    bench(
        criterion,
        "3-D box",
        &Fixture::new(Shape3::Cuboid(cuboid), admittance(Curvature::Tangent)).expect("a fixture"),
    );
    let points: Vec<Vector3<f64>> = ring(16, 0.0).iter().map(|point| Vector3::new(point.x, point.y, 0.0)).collect();
    let curve = Chain::space_curve(&points, true, 2e-4).expect("a curve in space");
    bench(
        criterion,
        "3-D curve",
        &Fixture::new(Shape3::Chain(curve), admittance(Curvature::Tangent)).expect("a fixture"),
    );
    let point = Chain::point(Vector3::new(RADIUS_M, 0.0, 0.0), 2e-4).expect("a point");
    bench(
        criterion,
        "3-D point",
        &Fixture::new(Shape3::Chain(point), admittance(Curvature::Tangent)).expect("a fixture"),
    );
}

fn spatial(criterion: &mut Criterion<OnCore>) {
    let sphere = Shape3::Sphere(Sphere::new(Vector3::zeros(), RADIUS_M, Forbidden::Inside).expect("a sphere"));
    let axis = Vector3::new(0.0, 0.0, 1.0);
    let cylinder = Cylinder::new(Vector3::zeros(), axis, RADIUS_M, Forbidden::Inside).expect("a cylinder");
    let plane = Shape3::Plane(Plane::new(Vector3::zeros(), Vector3::new(0.6, 0.8, 0.0)).expect("a plane"));
    for (name, shape, parameters) in [
        ("3-D sphere", sphere.clone(), admittance(Curvature::Tangent)),
        ("3-D sphere, exact curvature", sphere, admittance(Curvature::Exact)),
        ("3-D cylinder", Shape3::Cylinder(cylinder), admittance(Curvature::Tangent)),
        ("3-D cylinder, impedance", Shape3::Cylinder(cylinder), impedance()),
        ("3-D plane", plane, admittance(Curvature::Tangent)),
    ] {
        bench(criterion, name, &Fixture::new(shape, parameters).expect("a fixture"));
    }
}

criterion_group!(name = benches; config = on_core::criterion(); targets = planar, chains, spatial);
criterion_main!(benches);
