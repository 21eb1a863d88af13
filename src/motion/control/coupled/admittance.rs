//! The admittance that a hand feels, where the cycle is short against everything else.

use std::f64::consts::TAU;

use nalgebra::{Complex, Matrix2, SMatrix};

use super::super::error::{ControlError, positive};
use super::super::{Gains, principal_inertias};
use super::{Compensation, Follower, Gears, Outer, Pose, inverse_jacobian};

/// Blocks of the unknowns: motors, links, reference.
const MOTOR: usize = 0;
const LINK: usize = 2;
const REFERENCE: usize = 4;

/// Returns the velocity of the tool per force on it, in m/(N s), both in the base frame, at a frequency in Hz. This is the limit of the
/// loop of [`HeldLoop`](super::HeldLoop) for a cycle, delays and ages of samples that go to zero.
///
/// The equations use the coordinates of the controllers, with
///
/// - `s = 2 pi j f`,
/// - the low pass `P = 1/(1 + s/(2 pi f_c))`,
/// - the servo `C = K + B s + L/s`, multiplied by `1 + k/s` for a servo of the drive that follows a rate,
/// - the compensation `N = m s^2/(tau s + 1)`:
///
/// ```text
/// (M s^2 + b s) r = P (J^-1 F - m_H s^2 (q - r) + N q_m)
/// rigid:    (J s^2 + D s) q = C (r - q) + (feed-forward) r + J^T F,    q_m = q
/// elastic:  (J_m s^2 + D s + G) q_m - G q = C (r - q_m) + (feed-forward) r,    (J_l s^2 + G) q - G q_m = J^T F
/// ```
/// A spring `K_h` with a damper `B_h` is at the edge of stability where `1/Y = -B_h + j K_h/(2 pi f)`. If a weak spring is stable, the edge
/// is the least `K_h > 0` of all frequencies with this real part.
///
/// # Errors
/// [`ControlError::OutOfRange`] for a number that is not finite or outside its range, and where nothing resists the force;
/// [`ControlError::NotPositiveDefinite`] for a mass matrix that is not positive definite.
///
/// # Source
/// Keemink, van der Kooij, Stienen, *Admittance control for physical human-robot interaction* (2018). The paper has the apparent admittance
/// of two robots. One is rigid, under a velocity servo with an integral, which is `K` and `B` here. The other has an elastic transmission.
pub fn admittance(
    follower: &Follower,
    pose: &Pose,
    outer: &Outer,
    mass_kg: f64,
    frequency_hz: f64,
) -> Result<Matrix2<Complex<f64>>, ControlError> {
    let Gains { stiffness, damping, integral } = follower.checked()?;
    let outer = outer.checked()?;
    positive("virtual mass", mass_kg)?;
    let s = Complex::new(0.0, TAU * positive("frequency", frequency_hz)?);
    principal_inertias(&pose.mass)?;
    let inverse = inverse_jacobian(pose)?.map(Complex::from);
    let [mass, viscous, jacobian] = [pose.mass, pose.viscous, pose.jacobian].map(|matrix| matrix.map(Complex::from));
    let one = Matrix2::<Complex<f64>>::identity();

    let servo = s * damping + stiffness + Complex::from(integral) / s;
    let (servo, ahead) = match follower {
        Follower::Host { .. } => {
            (servo, pose.forward_mass.map(Complex::from) * (s * s) + pose.forward_viscous.map(Complex::from) * s)
        }
        Follower::Drive { .. } => (servo, Matrix2::zeros()),
        Follower::Rate { gain_per_s, .. } => {
            let gain_per_s = positive("rate gain", *gain_per_s)?;
            (servo * (Complex::from(gain_per_s) / s + 1.0), Matrix2::zeros())
        }
    };
    let low_pass = outer
        .low_pass
        .map_or(Complex::from(1.0), |(cut_off_hz, _)| Complex::from(1.0) / (s / (TAU * cut_off_hz) + 1.0));
    let compensated = outer.compensation.map_or(Complex::from(0.0), |Compensation { mass_kg, time_constant_s }| {
        s * s * mass_kg / (s * time_constant_s + 1.0)
    });
    let handle = s * s * outer.handle_kg;

    let mut loop_matrix = SMatrix::<Complex<f64>, 6, 6>::zeros();
    let mut put = |row: usize, column: usize, block: Matrix2<Complex<f64>>| {
        loop_matrix.fixed_view_mut::<2, 2>(row, column).copy_from(&block);
    };
    let mut load = SMatrix::<Complex<f64>, 6, 2>::zeros();
    put(MOTOR, REFERENCE, -(one * servo + ahead));
    match pose.gears {
        None => {
            put(MOTOR, MOTOR, mass * (s * s) + viscous * s + one * servo);
            put(LINK, LINK, one);
            put(LINK, MOTOR, -one);
            load.fixed_view_mut::<2, 2>(MOTOR, 0).copy_from(&jacobian.transpose());
        }
        Some(Gears { motor, stiffness, damping }) => {
            principal_inertias(&motor)?;
            principal_inertias(&(pose.mass - motor))?;
            let motor = motor.map(Complex::from);
            let gear = stiffness.map(Complex::from) + damping.map(Complex::from) * s;
            put(MOTOR, MOTOR, motor * (s * s) + viscous * s + gear + one * servo);
            put(MOTOR, LINK, -gear);
            put(LINK, LINK, (mass - motor) * (s * s) + gear);
            put(LINK, MOTOR, -gear);
            load.fixed_view_mut::<2, 2>(LINK, 0).copy_from(&jacobian.transpose());
        }
    }
    put(REFERENCE, REFERENCE, one * (s * s * mass_kg + s * outer.damping_n_s_per_m - low_pass * handle));
    put(REFERENCE, LINK, one * (low_pass * handle));
    put(REFERENCE, MOTOR, one * (-low_pass * compensated));
    load.fixed_view_mut::<2, 2>(REFERENCE, 0).copy_from(&(inverse * low_pass));

    let motion = loop_matrix.lu().solve(&load).map(|motion| jacobian * motion.fixed_view::<2, 2>(LINK, 0) * s);
    let is_finite =
        |found: &Matrix2<Complex<f64>>| found.iter().all(|entry| entry.re.is_finite() && entry.im.is_finite());
    motion.filter(is_finite).ok_or(ControlError::OutOfRange {
        name: "determinant of the loop",
        value: 0.0,
        requirement: "finite and not zero at this frequency",
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::{Grip, HeldLoop, Sampling};
    use super::*;

    const RIGID: Pose = Pose {
        mass: Matrix2::new(10.0, 0.0, 0.0, 10.0),
        viscous: Matrix2::new(5.0, 0.0, 0.0, 5.0),
        jacobian: Matrix2::new(1.0, 0.0, 0.0, 1.0),
        forward_mass: Matrix2::new(0.0, 0.0, 0.0, 0.0),
        forward_viscous: Matrix2::new(0.0, 0.0, 0.0, 0.0),
        gears: None,
    };

    fn outer(period_s: f64) -> Outer {
        let sampling = Sampling::at_sync(period_s);
        Outer { period_s, sampling, low_pass: None, damping_n_s_per_m: 0.0, handle_kg: 0.0, compensation: None }
    }

    fn servo(stiffness: f64) -> Follower {
        Follower::Host { gains: Gains { stiffness, damping: 100.0, integral: 0.0 }, delay_cycles: 0.0 }
    }

    fn is_near(one: Complex<f64>, other: Complex<f64>, share: f64) -> bool {
        (one - other).norm_sqr() <= share * share * other.norm_sqr()
    }

    /// The rigid closed form of the paper's appendix: `Y = (m_v s^2 + K_p s + K_i)/(m_r m_v s^3 + (K_p + b_r) m_v s^2 + K_i m_v s)`, here
    /// with no mass beyond the sensor, and with `m_p` there as the hand's part of the impedance `1/Y`.
    #[test]
    fn a_rigid_robot_has_the_published_closed_form() {
        let (mv, mr, mp, br, kp, ki) = (2.0, 10.0, 2.0, 5.0, 100.0, 2000.0);
        for hz in [0.01, 0.3, 4.0, 30.0] {
            let s = Complex::new(0.0, TAU * hz);
            let numerator = s * s * mv + s * kp + ki;
            let denominator = s * s * s * ((mr + mp) * mv) + s * s * ((kp + br) * mv + kp * mp) + s * (ki * (mv + mp));
            let bare = admittance(&servo(ki), &RIGID, &outer(1e-3), mv, hz).unwrap()[(0, 0)];
            // A mass behind the sensor moves with the tool, so that only its inertia is felt.
            let found = Complex::from(1.0) / (Complex::from(1.0) / bare + s * mp);
            assert!(is_near(found, numerator / denominator, 1e-12), "{hz} Hz: {found} {}", numerator / denominator);
        }
    }

    /// Returns the greatest stable stiffness of a hand by the sampled loop.
    fn held_n_per_m(follower: &Follower, pose: &Pose, outer: &Outer, damping_n_s_per_m: f64) -> f64 {
        let is_stable = |stiffness_n_per_m: f64| {
            let grip = Grip { stiffness_n_per_m, damping_n_s_per_m, mass_kg: 2.0 };
            HeldLoop::new(follower, pose, &grip, outer, 0).unwrap().is_stable(2.0)
        };
        let (mut low, mut high) = (1.0, 2.0);
        assert!(is_stable(low));
        while is_stable(high) {
            (low, high) = (high, 1.3 * high);
        }
        while high / low > 1.0 + 1e-6 {
            let middle = 0.5 * (low + high);
            if is_stable(middle) { low = middle } else { high = middle }
        }
        low
    }

    /// At the edge of the sampled loop the continuous one has nearly no reserve: the distance of `1/Y` from the hand's impedance goes with the cycle.
    #[test]
    fn the_sampled_loop_goes_to_the_continuous_one() {
        let compensation = Some(Compensation { mass_kg: 2.0, time_constant_s: 0.1 });
        let gears = Gears {
            motor: Matrix2::identity() * 5.0,
            stiffness: Matrix2::identity() * 1000.0,
            damping: Matrix2::identity() * 100.0,
        };
        // Literal values by the roots of the polynomials of the paper's closed forms, with B_h = 15 N s/m.
        let cases = [
            ("baseline", servo(2000.0), RIGID, outer(1e-3), 588.784849557519),
            (
                "low pass",
                servo(2000.0),
                RIGID,
                Outer { low_pass: Some((1.0 / (TAU * 0.05), 1e-3)), ..outer(1e-3) },
                357.142857142857,
            ),
            ("compensation", servo(2000.0), RIGID, Outer { compensation, ..outer(1e-3) }, 222.337173359994),
            (
                "virtual damping",
                servo(2000.0),
                RIGID,
                Outer { damping_n_s_per_m: 2.0, ..outer(1e-3) },
                625.070188337567,
            ),
            ("no integral", servo(0.0), RIGID, outer(1e-3), 434.210526315790),
            ("elastic", servo(2000.0), Pose { gears: Some(gears), ..RIGID }, outer(1e-3), 393.443525520135),
        ];
        for (name, follower, pose, outer, published) in cases {
            let at = |period_s: f64| {
                let low_pass = outer.low_pass.map(|(cut_off_hz, _)| (cut_off_hz, period_s));
                let outer = Outer { period_s, sampling: Sampling::at_sync(period_s), low_pass, ..outer };
                held_n_per_m(&follower, &pose, &outer, 15.0)
            };
            let [coarse, fine] = [at(4e-4), at(2e-4)];
            let limit = 2.0 * fine - coarse;
            assert!((limit / published - 1.0).abs() < 1e-3, "{name}: {coarse} {fine} {limit} {published}");
            // There the hand's impedance is that of the tool, turned round, at some frequency.
            let distance = |hz: f64| {
                let s = Complex::new(0.0, TAU * hz);
                let tool = admittance(&follower, &pose, &outer, 2.0, hz).unwrap()[(0, 0)];
                let hand = s * 2.0 + 15.0 + Complex::from(published) / s;
                (tool * hand + 1.0).norm_sqr().sqrt()
            };
            let least = (0..4000).map(|place| distance(1.0 + 1e-3 * f64::from(place))).fold(f64::INFINITY, f64::min);
            assert!(least < 1e-3, "{name}: {least}");
        }
    }

    #[test]
    fn nonsense_is_refused() {
        let of = |follower: &Follower, outer: &Outer, mass, hz| admittance(follower, &RIGID, outer, mass, hz);
        assert!(of(&servo(2000.0), &outer(1e-3), 2.0, 1.0).is_ok());
        assert!(of(&servo(2000.0), &outer(1e-3), 2.0, 0.0).is_err());
        assert!(of(&servo(2000.0), &outer(1e-3), f64::NAN, 1.0).is_err());
        assert!(of(&servo(-1.0), &outer(1e-3), 2.0, 1.0).is_err());
        let compensation = Some(Compensation { mass_kg: 2.0, time_constant_s: 0.0 });
        assert!(of(&servo(2000.0), &Outer { compensation, ..outer(1e-3) }, 2.0, 1.0).is_err());
        let still = Follower::Host { gains: Gains { stiffness: 0.0, damping: 0.0, integral: 0.0 }, delay_cycles: 0.0 };
        assert!(of(&still, &outer(1e-3), 2.0, 1.0).is_err());
    }

    proptest! {
        /// Forces and masses have one unit, and stiff gears count as none.
        #[test]
        fn the_admittance_scales_with_all_forces(
            factor in 0.2_f64..5.0, lever in 0.2_f64..2.0, hz in 0.1_f64..30.0, handle in 0.0_f64..1.0,
        ) {
            let of = |factor: f64, lever: f64, gears: Option<Gears>| {
                let inertia = factor * lever * lever;
                let gains = Gains { stiffness: 2000.0 * inertia, damping: 100.0 * inertia, integral: 300.0 * inertia };
                let pose = Pose {
                    mass: RIGID.mass * inertia,
                    viscous: RIGID.viscous * inertia,
                    jacobian: Matrix2::identity() * lever,
                    gears,
                    ..RIGID
                };
                let outer = Outer { handle_kg: handle * factor, damping_n_s_per_m: factor, ..outer(1e-3) };
                let servo = Follower::Host { gains, delay_cycles: 1.0 };
                admittance(&servo, &pose, &outer, 2.0 * factor, hz).unwrap()[(0, 0)]
            };
            let one = of(1.0, 1.0, None);
            prop_assert!(is_near(of(factor, lever, None) * factor, one, 1e-9), "{one}");
            let stiff = Gears {
                motor: Matrix2::identity() * 4.0,
                stiffness: Matrix2::identity() * 1e10,
                damping: Matrix2::zeros(),
            };
            prop_assert!(is_near(of(1.0, 1.0, Some(stiff)), one, 1e-4), "{one}");
        }
    }
}
