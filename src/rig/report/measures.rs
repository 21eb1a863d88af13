//! Measures of one run, taken from its rows.

use nalgebra::Vector3;
use serde::Serialize;

use yieldwall_motion::fixture::{EXCESS_FORGETTING_S, Excess, Port, prediction};
use yieldwall_motion::guard::State;
use yieldwall_record::{ForceMeaning, ON_SURFACE_M, Row, Trace};

/// Time after a crossing in which a penetration belongs to the impact, in s.
const IMPACT_WINDOW_S: f64 = 0.2;
/// Time left out of steady tracing after an impact or a reversal, in s.
const SETTLING_S: f64 = 0.1;
/// Greatest tool speed that counts as steady tracing, in m/s.
const TRACING_SPEED_M_PER_S: f64 = 0.1;
/// A proxy slower than this, in m/s, rests: resting on the surface is not tracing it.
const RESTING_SPEED_M_PER_S: f64 = 1e-3;
/// Share of R above which a force counts as R, apart from rounding: the surface yields.
const YIELDING_SHARE: f64 = 1.0 - 1e-6;
/// Share of R up to which a force counts as pressing on the surface below the yield force.
const PRESSED_SHARE: f64 = 0.95;

/// Energy beyond the law that a rig without oscillation may give, in J. At a surface that holds the proxy, the servo stops the arm,
/// and the arm's momentum acts on the hand. An oscillating rig exceeds it within some periods.
const EXCESS_BOUND_J: f64 = 0.02;

/// One crossing of the surface by a proxy that came from off it, pushed by less than R.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Impact {
    /// Row of the crossing.
    #[serde(skip)]
    pub row: usize,
    /// Time of the crossing in s.
    pub time_s: f64,
    /// Speed of the proxy along the normal before the crossing, in m/s.
    pub speed_m_per_s: f64,
    /// Greatest distance of the proxy beyond the surface while the sensed force stays below R, in mm.
    pub depth_mm: f64,
    /// Depth that the proxy's equation of motion predicts, in mm, for this speed and the mean normal force until the proxy stopped.
    /// `None` if the law does not apply (impedance type, or a hold).
    pub predicted_depth_mm: Option<f64>,
    /// Predicted depth for the least and the greatest normal force until the proxy stopped: the law is for a constant force.
    pub predicted_range_mm: Option<[f64; 2]>,
    /// Greatest distance of the tool beyond the surface in the same time, in mm.
    pub tool_depth_mm: f64,
    /// Greatest sensed normal force within the window, in N.
    pub force_normal_max_n: f64,
}

/// The measures of one run; see the fields.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Measures {
    /// All impacts, in order of time.
    pub impacts: Vec<Impact>,
    /// Greatest depth of all impacts in mm; 0 without one.
    pub penetration_mm: f64,
    /// Greatest distance from the surface of a proxy that the fixture holds on it, in mm.
    pub proxy_on_surface_max_mm: Option<f64>,
    /// Share of the rows with a pressing force between F and 0.95 R, since the proxy came to lie on the surface, in
    /// which it lies there. `None` without such a row.
    pub on_surface_fraction_when_pressed: Option<f64>,
    /// Number of times that the proxy left the surface in such a row while pressed. The push is above F and below 0.95 of the force
    /// at which the surface yields on that side.
    pub unintended_releases: u32,
    /// Number of times that the surface gave way under a push as strong as its yield force ([`Trace::break_outs`]).
    pub break_outs: u32,
    /// Time in s for which the fixture held the proxy on the surface.
    pub on_surface_s: f64,
    /// RMS distance of the tool from the surface in steady tracing up to 0.1 m/s, in mm.
    pub tool_rms_tracing_mm: Option<f64>,
    /// RMS distance of the tool from the surface over all rows with the proxy on it, in mm.
    pub tool_rms_on_surface_mm: Option<f64>,
    /// Greatest such distance in mm.
    pub tool_max_on_surface_mm: Option<f64>,
    /// Greatest sensed normal force while the proxy was on the surface, in N.
    pub peak_force_on_surface_n: Option<f64>,
    /// Mean age of the sample that the force comes from, in ms, from its arrival; `None` without a force sensor.
    pub force_age_mean_ms: Option<f64>,
    /// Greatest such age, in ms.
    pub force_age_max_ms: Option<f64>,
    /// Work of the tool on the hand where it is positive, summed, in J.
    pub energy_given_j: f64,
    /// Work of the hand on the tool where it is positive, summed, in J.
    pub energy_taken_j: f64,
    /// Share of the rows with a positive power of the tool on the hand.
    pub power_positive_fraction: f64,
    /// Greatest commanded joint torque in N m; `None` where no torque is commanded.
    pub peak_torque_n_m: Option<f64>,
    /// Time in s in which a torque was at its limit; `None` where no torque is commanded.
    pub torque_limit_s: Option<f64>,
    /// The part of it in s that is not within 0.2 s after an impact, in which the arm is stopped as fast as it can be.
    pub torque_limit_apart_s: Option<f64>,
    /// Greatest net work of the tool on the hand over any stretch of the run, in J.
    pub energy_rise_j: f64,
    /// Largest energy burst into the hand beyond what the proxy held and moving surfaces brought, in J, forgotten within a second
    /// ([`Excess`]). The value is the one nearest to its bound or furthest beyond it. `None` if no mass holds energy (impedance
    /// type, elastic law).
    pub energy_excess_j: Option<f64>,
    /// Bound of the energy, in J. For the impedance type it bounds `energy_rise_j` and is `R^2 / (2 K)`. For the admittance type it
    /// bounds `energy_excess_j` and is the sum of three terms:
    /// - 0.02 J, which the stop of an arm may leave;
    /// - the work of one count of the force sensor over the tool's travel;
    /// - the largest kinetic energy that the proxy had until then, forgotten as fast.
    ///
    /// The kinetic energy stands for moves. Let a hand move the mass with minimum jerk in the time `T`. A tool that follows its
    /// proxy late by `lag` then returns about `10 lag / T` of that energy beyond the hand's own work. A move does so once, an
    /// oscillation in each of its halves.
    pub energy_bound_j: f64,
}

impl Measures {
    /// Returns the energy that the bound limits, in J: the largest burst into the hand, less what the proxy held and what moving
    /// surfaces brought (admittance type).
    pub fn bounded_energy_j(&self) -> f64 {
        self.energy_excess_j.unwrap_or(self.energy_rise_j)
    }

    /// Whether the energy keeps within its bound.
    pub fn is_within_bound(&self) -> bool {
        self.bounded_energy_j() <= self.energy_bound_j
    }
}

/// Properties of the fixture and the loop that the measures need.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Context {
    /// Cycle time in s.
    pub period_s: f64,
    /// Proxy mass in kg; `None` for the impedance type, and if a spring or a capture holds energy besides the mass.
    pub mass_kg: Option<f64>,
    /// Torque limit in N m; `None` where no torque is commanded.
    pub torque_limit_n_m: Option<f64>,
    /// Whether the law predicts the depth of impacts: not with a hold, fixed or automatic, nor on a surface that moves.
    pub has_depth_law: bool,
    /// Stiffness of the impedance coupling in N/m; 0 for the admittance type.
    pub stiffness_n_per_m: f64,
    /// Force of one count of the sensor in N; 0 without a sensor.
    pub force_resolution_n: f64,
}

/// Takes all measures of `trace`.
pub fn measure(trace: &Trace, context: &Context) -> Measures {
    let impacts = impacts(trace, context);
    let Work { given_j: energy_given_j, taken_j: energy_taken_j, rise_j: energy_rise_j, way_m } = work(trace);
    let given = context.mass_kg.map(|mass| given(trace, context, mass));
    let energy_bound_j = match given {
        Some(given) => EXCESS_BOUND_J + context.force_resolution_n * way_m + given.moved_j,
        None => prediction::stored_energy_limit_j(
            trace.yield_against_n(1.0).max(trace.yield_against_n(-1.0)),
            context.stiffness_n_per_m,
        ),
    };
    let on: Vec<&Row> = trace.rows.iter().filter(|row| row.is_on_surface).collect();
    let distance_mm = |row: &Row| 1e3 * row.tool_distance_m.abs();
    let tracing: Vec<&Row> = steady_tracing(trace, context, &impacts).collect();
    let pressed = pressed(trace);
    let peak_torque =
        trace.rows.iter().flat_map(|row| row.torques_n_m).fold(0.0f64, |peak, torque| peak.max(torque.abs()));
    let positive = trace.rows.iter().filter(|row| row.power_w > 0.0).count();
    let ages_ms = || trace.rows.iter().map(|row| 1e3 * row.force_age_s).filter(|_| context.force_resolution_n > 0.0);
    Measures {
        penetration_mm: impacts.iter().map(|impact| impact.depth_mm).fold(0.0, f64::max),
        proxy_on_surface_max_mm: greatest(on.iter().map(|row| 1e3 * row.signed_distance_m.abs())),
        on_surface_fraction_when_pressed: (pressed.rows > 0).then(|| f64::from(pressed.on) / f64::from(pressed.rows)),
        unintended_releases: pressed.releases,
        break_outs: trace.break_outs().count() as u32,
        on_surface_s: context.period_s * on.len() as f64,
        tool_rms_tracing_mm: root_mean_square(tracing.iter().map(|row| distance_mm(row))),
        tool_rms_on_surface_mm: root_mean_square(on.iter().map(|row| distance_mm(row))),
        tool_max_on_surface_mm: greatest(on.iter().map(|row| distance_mm(row))),
        peak_force_on_surface_n: greatest(on.iter().map(|row| trace.normal_force_n(row).abs())),
        force_age_mean_ms: greatest(ages_ms()).map(|_| ages_ms().sum::<f64>() / trace.rows.len() as f64),
        force_age_max_ms: greatest(ages_ms()),
        energy_given_j,
        energy_taken_j,
        power_positive_fraction: positive as f64 / trace.rows.len().max(1) as f64,
        peak_torque_n_m: context.torque_limit_n_m.map(|_| peak_torque),
        torque_limit_s: context.torque_limit_n_m.map(|limit| at_limit_s(trace, context, limit, &[])),
        torque_limit_apart_s: context.torque_limit_n_m.map(|limit| at_limit_s(trace, context, limit, &impacts)),
        energy_rise_j,
        energy_excess_j: given.map(|given| given.excess_j),
        energy_bound_j,
        impacts,
    }
}

/// Returns the time in s in which a torque is at its limit, except within the window after one of `impacts`.
fn at_limit_s(trace: &Trace, context: &Context, limit_n_m: f64, impacts: &[Impact]) -> f64 {
    let is_at_limit = |row: &&Row| row.torques_n_m.iter().any(|torque| torque.abs() >= limit_n_m * (1.0 - 1e-9));
    let is_after =
        |row: &Row| impacts.iter().any(|impact| (0.0..IMPACT_WINDOW_S).contains(&(row.time_s - impact.time_s)));
    context.period_s * trace.rows.iter().filter(is_at_limit).filter(|row| !is_after(row)).count() as f64
}

fn greatest(values: impl Iterator<Item = f64>) -> Option<f64> {
    values.fold(None, |known: Option<f64>, value| Some(known.map_or(value, |known| known.max(value))))
}

fn root_mean_square(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0u32), |(sum, count), value| (sum + value * value, count + 1));
    (count > 0).then(|| (sum / f64::from(count)).sqrt())
}

/// Returns a push of the hand with this component along the normal, as a share of the force at which the surface yields.
fn pressed_share(trace: &Trace, along_normal_n: f64) -> f64 {
    along_normal_n.abs() / trace.yield_against_n(along_normal_n)
}

fn impacts(trace: &Trace, context: &Context) -> Vec<Impact> {
    let rows = &trace.rows;
    trace
        .contacts()
        .filter(|&at| at >= 2)
        // Against a unilateral surface only an approach from the free side is an impact.
        .filter(|&at| !trace.is_unilateral || rows[at - 1].signed_distance_m > 0.0)
        .filter(|&at| pressed_share(trace, -trace.normal_force_n(&rows[at])) < YIELDING_SHARE)
        .map(|at| impact_at(trace, context, at))
        .collect()
}

fn impact_at(trace: &Trace, context: &Context, at: usize) -> Impact {
    let rows = &trace.rows;
    let side = rows[at - 1].signed_distance_m.signum();
    // A distance that grows or shrinks by more than the way is one from another surface.
    let approach = (rows[at - 1].signed_distance_m - rows[at - 2].signed_distance_m).abs();
    let speed = approach.min(trace.way_m(at - 1)) / context.period_s;
    let window = (IMPACT_WINDOW_S / context.period_s).round() as usize;
    let mut impact = Impact {
        row: at,
        time_s: rows[at].time_s,
        speed_m_per_s: speed,
        depth_mm: 0.0,
        predicted_depth_mm: None,
        predicted_range_mm: None,
        tool_depth_mm: 0.0,
        force_normal_max_n: 0.0,
    };
    let mut below_yield = true;
    let mut came_back = false;
    let mut is_this_surface = true;
    let mut push = Vec::new();
    for (place, row) in rows.iter().enumerate().skip(at).take(window) {
        let force = -trace.normal_force_n(row);
        impact.force_normal_max_n = impact.force_normal_max_n.max(force.abs());
        below_yield &= pressed_share(trace, force) < YIELDING_SHARE;
        let change = (row.signed_distance_m - rows[place - 1].signed_distance_m).abs();
        is_this_surface &= change <= trace.way_m(place) + ON_SURFACE_M;
        let depth = -side * row.signed_distance_m;
        came_back |= depth < -ON_SURFACE_M;
        if !below_yield || came_back || !is_this_surface {
            continue;
        }
        if 1e3 * depth > impact.depth_mm {
            push.push(-side * force);
        }
        impact.depth_mm = impact.depth_mm.max(1e3 * depth);
        impact.tool_depth_mm = impact.tool_depth_mm.max(-side * 1e3 * row.tool_distance_m);
    }
    if let (Some(mass), true) = (context.mass_kg, context.has_depth_law) {
        let law = |hand_force_n: f64| {
            let law = prediction::Impact {
                mass_kg: mass,
                yield_n: trace.yield_against_n(-side),
                hand_force_n,
                speed_m_per_s: speed,
                last_distance_m: rows[at - 1].signed_distance_m.abs(),
                period_s: context.period_s,
            };
            law.penetration_depth_m().map(|depth| 1e3 * depth)
        };
        let mean = push.iter().sum::<f64>() / push.len().max(1) as f64;
        let ends = push.iter().fold([mean; 2], |[least, most], &force| [least.min(force), most.max(force)]);
        impact.predicted_depth_mm = law(mean);
        impact.predicted_range_mm = law(ends[0]).zip(law(ends[1])).map(Into::into);
    }
    impact
}

struct Pressed {
    rows: u32,
    on: u32,
    releases: u32,
}

/// Walks through the contacts. A contact begins with the second consecutive row with the proxy on the surface (a single row is a
/// landing in flight). It ends when the push reaches 0.95 R, or points to the free side of a unilateral surface.
fn pressed(trace: &Trace) -> Pressed {
    let mut pressed = Pressed { rows: 0, on: 0, releases: 0 };
    let mut in_contact = false;
    let mut was_on = false;
    for row in &trace.rows {
        // While a fault holds or stops the rig, the fixture lets go of the proxy by design.
        if row.supervisor_state > State::Running as u8 {
            (in_contact, was_on) = (false, false);
            continue;
        }
        // By the proxy, which may have come round a corner when the tool has not, or the other way about.
        let push = -trace.normal_force_at_proxy_n(row);
        let is_freeing = trace.is_unilateral && push > 0.0;
        if pressed_share(trace, push) >= PRESSED_SHARE || is_freeing {
            in_contact = false;
        } else if row.is_on_surface && was_on {
            in_contact = true;
        }
        if in_contact && push.abs() > trace.friction_n {
            pressed.rows += 1;
            pressed.on += u32::from(row.is_on_surface);
            pressed.releases += u32::from(was_on && !row.is_on_surface);
        }
        was_on = row.is_on_surface;
    }
    pressed
}

fn steady_tracing<'a>(trace: &'a Trace, context: &'a Context, impacts: &'a [Impact]) -> impl Iterator<Item = &'a Row> {
    let settling = SETTLING_S;
    let mut next_impact = 0;
    let mut quiet_from = f64::NEG_INFINITY;
    let mut last_direction: Option<[f64; 3]> = None;
    trace.rows.windows(2).filter_map(move |pair| {
        let [before, row] = pair else { return None };
        while impacts.get(next_impact).is_some_and(|impact| impact.time_s <= row.time_s) {
            quiet_from = impacts[next_impact].time_s + settling;
            next_impact += 1;
        }
        let step = std::array::from_fn::<f64, 3, _>(|axis| row.proxy_m[axis] - before.proxy_m[axis]);
        let speed = norm(step) / context.period_s;
        if !row.is_on_surface {
            last_direction = None;
            quiet_from = quiet_from.max(row.time_s + settling);
            return None;
        }
        if speed < RESTING_SPEED_M_PER_S {
            return None;
        }
        let turned = last_direction.is_some_and(|last| dot(last, step) < 0.0);
        if turned {
            quiet_from = quiet_from.max(row.time_s + settling);
        }
        last_direction = Some(step);
        (row.time_s >= quiet_from && speed <= TRACING_SPEED_M_PER_S).then_some(row)
    })
}

struct Work {
    given_j: f64,
    taken_j: f64,
    rise_j: f64,
    way_m: f64,
}

/// Returns the work of the tool on the hand from row to row: a sensed force by the trapezoidal rule, an actuator force as it is
/// held.
fn work(trace: &Trace) -> Work {
    let mut sums = Work { given_j: 0.0, taken_j: 0.0, rise_j: 0.0, way_m: 0.0 };
    let mut rise: f64 = 0.0;
    for pair in trace.rows.windows(2) {
        let [before, row] = pair else { continue };
        let (f0, f1) = (trace.force_on_hand_n(before), trace.force_on_hand_n(row));
        let step = std::array::from_fn::<f64, 3, _>(|axis| row.tool_m[axis] - before.tool_m[axis]);
        let work = match trace.force_meaning {
            ForceMeaning::HandOnTool => 0.5 * (dot(f0, step) + dot(f1, step)),
            ForceMeaning::ActuatorOnTool => dot(f0, step),
        };
        sums.given_j += work.max(0.0);
        sums.taken_j += (-work).max(0.0);
        rise = (rise + work).max(0.0);
        sums.rise_j = sums.rise_j.max(rise);
        sums.way_m += norm(step);
    }
    sums
}

/// Energy given to the hand when it was most beyond what moves account for.
#[derive(Clone, Copy)]
struct Given {
    /// Beyond what the proxy held and moving surfaces brought, in J.
    excess_j: f64,
    /// The most kinetic energy of the proxy until then, forgotten as the excess is, in J.
    moved_j: f64,
}

/// Returns the energy given to the hand, counted anew each time the rig begins to run.
fn given(trace: &Trace, context: &Context, mass_kg: f64) -> Given {
    let kept = (1.0 - context.period_s / EXCESS_FORGETTING_S).max(0.0);
    let mut most = Given { excess_j: 0.0, moved_j: 0.0 };
    for stretch in trace.rows.split(|row| row.supervisor_state != State::Running as u8) {
        let mut excess = Excess::<3>::new(context.period_s, mass_kg, EXCESS_FORGETTING_S);
        let mut moved_j = 0.0_f64;
        // The tool was led to the proxy of the row before; the two rows before that tell how it came there.
        for rows in stretch.windows(4) {
            let [earliest, earlier, last, row] = rows else { continue };
            let [proxy, before, two_before] = [last, earlier, earliest].map(|row| Vector3::from(row.proxy_m));
            let way = Vector3::from(last.surface_m) - Vector3::from(earlier.surface_m);
            // The fixture's force, by the law of the proxy.
            let bend = (proxy - before * 2.0 + two_before) * (mass_kg / (context.period_s * context.period_s));
            let brought_j = (bend - Vector3::from(last.force_n)).dot(&way);
            let (tool, force_n) = (Vector3::from(row.tool_m), Vector3::from(row.force_n));
            let excess_j = excess.step(Port { tool, force_n, proxy, stored_j: 0.0, brought_j });
            moved_j = (moved_j * kept).max(excess.kinetic_j());
            if excess_j - moved_j > most.excess_j - most.moved_j {
                most = Given { excess_j, moved_j };
            }
        }
    }
    most
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn norm(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A proxy in the plane that goes outward along x to a circle of 0.12 m, under a push of 10 N, and stays on it.
    fn pressed_outward() -> Trace {
        let row = |at: usize| {
            let gap = (5.0 - at as f64).max(0.0) * 1e-4;
            let tool_m = [0.12 - gap + if at >= 5 { 2e-4 } else { 0.0 }, 0.0, 0.0];
            Row {
                time_s: at as f64 * 1e-3,
                tool_m,
                proxy_m: [0.12 - gap, 0.0, 0.0],
                force_n: [10.0, 0.0, 0.0],
                // Forbidden outside: the fixture counts positive inside.
                signed_distance_m: gap,
                tool_distance_m: 0.12 - tool_m[0],
                tool_normal: [-1.0, 0.0, 0.0],
                proxy_normal: [-1.0, 0.0, 0.0],
                is_on_surface: at >= 5,
                ..Row::default()
            }
        };
        Trace {
            friction_n: 3.0,
            yield_n: 20.0,
            is_unilateral: true,
            rows: (0..40).map(row).collect(),
            ..Trace::default()
        }
    }

    const CONTEXT: Context = Context {
        period_s: 1e-3,
        mass_kg: Some(2.0),
        torque_limit_n_m: None,
        has_depth_law: true,
        stiffness_n_per_m: 0.0,
        force_resolution_n: 0.0,
    };

    #[test]
    fn a_hand_that_breaks_out_is_counted_apart_from_a_fixture_that_lets_go() {
        let leaving = |push_n: f64| {
            let mut trace = pressed_outward();
            for (step, row) in trace.rows[20..].iter_mut().enumerate() {
                (row.force_n[0], row.signed_distance_m, row.is_on_surface) = (push_n, -1e-4 * step as f64, false);
            }
            let Measures { break_outs, unintended_releases, on_surface_s, .. } = measure(&trace, &CONTEXT);
            assert!((on_surface_s - 15e-3).abs() < 1e-12, "{on_surface_s}");
            (break_outs, unintended_releases)
        };
        assert_eq!(leaving(20.0), (1, 0));
        assert_eq!(leaving(10.0), (0, 1));
        assert_eq!(leaving(-20.0), (0, 0), "a pull off a wall is no way through it");
        let kept = measure(&pressed_outward(), &CONTEXT);
        assert_eq!((kept.break_outs, kept.unintended_releases), (0, 0));
        let mut stopped = pressed_outward();
        for row in &mut stopped.rows[20..] {
            (row.is_on_surface, row.supervisor_state) = (false, State::Stopped as u8);
        }
        assert_eq!(measure(&stopped, &CONTEXT).unintended_releases, 0, "the fault lets go, not the fixture");
    }

    #[test]
    fn a_surface_that_forbids_its_outside_is_pressed_outward() {
        let measures = measure(&pressed_outward(), &CONTEXT);
        assert_eq!(measures.on_surface_fraction_when_pressed, Some(1.0), "the push is no way off the surface");
        assert_eq!(measures.impacts.len(), 1);
        assert!((measures.impacts[0].tool_depth_mm - 0.2).abs() < 1e-9, "{measures:?}");
    }
}
