//! The steps in which nothing is enabled.

use super::bench::{Bench, Found, Halt, with_restored};
use super::{Curve, Figure};
use crate::assembly::torque_limits_per_mille;
use crate::proof::{DriveIdentity, DriveLimit};
use yieldwall_config::Positive;
use yieldwall_drives::objects::{self, DEVICE_TYPE, Object};
use yieldwall_drives::profiles::TorqueLimit;
use yieldwall_fieldbus::objects::{Address, sign_extend};
use yieldwall_motion::guard::Device;
use yieldwall_motion::quantity::Force;
use yieldwall_service::{number, torque_limit};

/// How often each drive is read, and for how long at most, s.
const READS: usize = 1000;
const READING_S: f64 = 10.0;
/// Reads that may go unanswered before it is given up.
const MOST_UNANSWERED: u32 = 5;
/// How long the force sensor is listened to, s, after it has settled.
const LISTENING_S: f64 = 1.0;
const SETTLING_S: f64 = 0.3;
/// Time after which a torque limit is checked again, s.
const KEPT_S: f64 = 0.05;
/// Share of the rated torque that a drive gets as its limit.
const LIMIT_SHARE: f64 = 0.25;
/// Noise of each axis of force, as a share of the yield force: the admittance moves the tool by it.
const NOISE_SHARE: f64 = 0.01;
/// Share of the greatest force of the hand that the sensor may show at rest.
const BIAS_SHARE: f64 = 0.1;
/// Force that pulls at the tool, N.
pub(super) const PULL_N: f64 = 8.0;
/// By how much what is felt of it may differ: in direction, degrees, and in size.
const DIRECTION_DEG: f64 = 10.0;
const SIZE_SHARE: f64 = 0.1;
/// Share of the pull below which nothing is felt and the direction is meaningless.
const FELT_SHARE: f64 = 0.1;

/// Objects that no boot writes, whether each is a limit of torque, and what it does. The others add to set-points and have to be 0.
const NEUTRAL: [(Object, bool, &str); 5] = [
    (objects::POSITION_OFFSET, false, "which adds to each target position"),
    (objects::VELOCITY_OFFSET, false, "which adds to each velocity"),
    (objects::TORQUE_OFFSET, false, "which adds to each torque"),
    (objects::POSITIVE_TORQUE_LIMIT, true, "which limits torque in the positive direction"),
    (objects::NEGATIVE_TORQUE_LIMIT, true, "which limits torque in the negative direction"),
];
/// The rated torque, per mille of itself.
const RATED: i64 = 1000;

/// Returns the value of an object that has to be neutral and is not, and the value that it has to hold; `None` if it is neutral.
fn left_over(object: Object, is_limit: bool, held: &[u8], limit: u16) -> Option<(i64, i64)> {
    if is_limit {
        let own = torque_limit(held);
        let wanted = RATED.max(i64::from(limit)) * if own < 0 { -1 } else { 1 };
        return (own.abs() < i64::from(limit)).then_some((own, wanted));
    }
    let own = sign_extend(u64::from(number(held)), object.bits());
    (own != 0).then_some((own, 0))
}

impl Bench<'_> {
    /// Reads an object of each drive again and again.
    pub(super) fn communication(&mut self, found: &mut Found) -> Result<(), Halt> {
        self.boot()?;
        let mut unanswered = 0_u32;
        for (joint, device) in Device::DRIVES.into_iter().enumerate() {
            let mut times_ms = Vec::with_capacity(READS);
            let begun = self.runner.now();
            for _ in 0..READS {
                self.check_interrupt()?;
                if self.runner.now().since(begun).as_secs_f64() > READING_S {
                    break;
                }
                if unanswered >= MOST_UNANSWERED {
                    return Err(Halt::Failed(format!(
                        "{} does not answer {unanswered} reads: check its cable and termination, and run `yieldwall doctor`",
                        self.name(joint)
                    )));
                }
                let asked = self.runner.now();
                match self.runner.read(device, DEVICE_TYPE.index, DEVICE_TYPE.sub) {
                    Ok(_) => times_ms.push(1e3 * self.runner.now().since(asked).as_secs_f64()),
                    Err(_) => unanswered += 1,
                }
            }
            times_ms.sort_by(f64::total_cmp);
            let at = |share: f64| times_ms.get((share * (times_ms.len().max(1) - 1) as f64) as usize).copied();
            if let (Some(median), Some(late), Some(most)) = (at(0.5), at(0.99), at(1.0)) {
                let name = format!("{}: answers of {} reads", self.name(joint), times_ms.len());
                found.note(name, format!("median {median:.2}, 99 % {late:.2}, max {most:.2} ms"));
            }
        }
        found.measure(Figure {
            what: "reads without an answer".into(),
            value: unanswered.into(),
            limit: 0.0,
            unit: "".into(),
        });
        Ok(())
    }

    /// Asks both drives for their identities. The boot has already checked them against the expected ones.
    pub(super) fn identity(&mut self, found: &mut Found) -> Result<(), Halt> {
        self.boot()?;
        let drives = self.runner.identities()?;
        self.drives = Some(drives);
        for (joint, drive) in drives.iter().enumerate() {
            let DriveIdentity { vendor_id, product_code, revision, serial_number, .. } = drive;
            found.note(
                self.name(joint),
                format!("vendor {vendor_id:08X}h, product {product_code:08X}h, revision {revision:08X}h, serial number {serial_number}"),
            );
        }
        let of = |drive: &DriveIdentity| (drive.vendor_id, drive.product_code, drive.serial_number);
        let [left, right] = &drives;
        if of(left) == of(right) && left.serial_number != 0 && !self.rig.has_one_device() {
            let message = "both drives report the same serial number: one device answers to both addresses, or one has a copied memory";
            return Err(Halt::Failed(message.to_owned()));
        }
        let wanted = self.wanted.unwrap_or(drives);
        if let Some(joint) = (0..2).find(|joint| wanted[*joint] != drives[*joint]) {
            return Err(Halt::Failed(format!(
                "{} is not the drive of the report, which has serial number {}",
                self.name(joint),
                wanted[joint].serial_number
            )));
        }
        Ok(())
    }

    /// Sets a torque limit in both drives, checks whether they keep it, and restores the limit before.
    pub(super) fn limits(&mut self, found: &mut Found) -> Result<(), Halt> {
        self.boot()?;
        self.note_drive_limits(found)?;
        self.confirm_drive_limits()?;
        let before = self.torque_limits()?;
        // Another one than it has, so that a drive that takes none is found.
        let torque_n_m = self.torque_n_m(LIMIT_SHARE).min(0.5 * self.rig.guard.torque_limit_n_m.get());
        let limit =
            Positive::new(torque_n_m).ok_or_else(|| Halt::Failed("the rig file allows no torque".to_owned()))?;
        let told = self.runner.limit_torque(self.rig, limit);
        let kept = told.map_err(Halt::from).and_then(|()| {
            let first = self.torque_limits()?;
            self.idle(KEPT_S, |_| ())?;
            Ok((first, self.torque_limits()?))
        });
        let restored = self.restore_torque_limits(before);
        let (first, later) = with_restored(kept, restored)?;
        for joint in 0..2 {
            let limits = [before, first, later].map(|limits| limits.get(joint).copied().flatten());
            if let [Some(before), Some(first), Some(later)] = limits {
                let servo = self.rig.drives.get(joint).and_then(|drive| drive.profile.get()?.servo());
                let unit = match servo.and_then(|servo| servo.limits.of_torque()) {
                    Some(TorqueLimit::PerMille(_)) => "per mille of rated torque",
                    _ => "object units",
                };
                let text = format!("{before} before, {first} written, {later} later ({unit})");
                found.note(format!("{}: torque limit", self.name(joint)), text);
            }
        }
        if first != later {
            return Err(Halt::Failed("a drive has changed its torque limit by itself".to_owned()));
        }
        Ok(())
    }

    /// Compares the torque limits that drives keep by themselves with that of the rig file.
    fn note_drive_limits(&mut self, found: &mut Found) -> Result<(), Halt> {
        let limits = torque_limits_per_mille(self.rig).map_err(|error| Halt::Failed(error.to_string()))?;
        for (joint, (device, per_mille)) in Device::DRIVES.into_iter().zip(limits).enumerate() {
            let name = self.name(joint);
            let own = match self.runner.drive_limit(self.rig, device)? {
                DriveLimit::OfMaster => continue,
                DriveLimit::Untold => {
                    found.note(format!("{name}: torque limit"), "no object");
                    continue;
                }
                DriveLimit::Kept(own) => own,
            };
            found.note(
                format!("{name}: its own torque limit"),
                format!("{} in {}, {:.2} N m", own.held, own.at, own.torque_n_m),
            );
            if own.per_mille > u32::from(per_mille) {
                return Err(Halt::Failed(format!(
                    "{name} keeps a torque limit of {:.2} N m ({} is {}), above the {:.2} N m of the rig file (`guard.torque_limit_n_m`): lower it with \
                     the manufacturer's tool and store it there",
                    own.torque_n_m,
                    own.at,
                    own.held,
                    self.rig.guard.torque_limit_n_m.get()
                )));
            }
        }
        Ok(())
    }

    /// Reads the objects that add to set-points or cut them, and again after a power cycle: values left there by another program
    /// act each time.
    pub(super) fn parameters(&mut self, found: &mut Found) -> Result<(), Halt> {
        let before = self.left_there(found)?;
        self.runner.leave();
        let is_kept = self.attendant.power_cycle(self.rig, &mut self.runner.place);
        let text = if is_kept {
            let after = self.left_there(&mut Found::default())?;
            if after != before {
                return Err(Halt::Failed(
                    "objects that this program does not write have changed after a power cycle: store their values in the drive \
                     (`yieldwall od write` with --save)"
                        .to_owned(),
                ));
            }
            "unchanged"
        } else {
            "not tested: nobody switched the drives off and on"
        };
        found.note("after a power cycle", text);
        Ok(())
    }

    /// Returns the values of the objects that have to be neutral in each drive, or a failure that names the first that is not.
    fn left_there(&mut self, found: &mut Found) -> Result<[Vec<Option<Vec<u8>>>; 2], Halt> {
        self.boot()?;
        let limits = torque_limits_per_mille(self.rig).map_err(|error| Halt::Failed(error.to_string()))?;
        let mut all: [Vec<Option<Vec<u8>>>; 2] = Default::default();
        for (joint, (device, limit)) in Device::DRIVES.into_iter().zip(limits).enumerate() {
            let name = self.name(joint);
            let mut read = 0;
            for (object, is_limit, meaning) in NEUTRAL {
                self.check_interrupt()?;
                // One that does not report an object does not have it.
                let held = self.runner.read_bytes(device, Address::new(object.index, object.sub)).ok();
                all[joint].push(held);
                let Some(Some(held)) = all[joint].last() else { continue };
                read += 1;
                if let Some((own, wanted)) = left_over(object, is_limit, held, limit) {
                    let model = self.rig.model(&self.rig.drives[joint]);
                    let offset = model.map(|model| model.offset()).unwrap_or_default();
                    let at = Address::new(offset.index(object.index), object.sub);
                    return Err(Halt::Failed(format!(
                        "{at} of {name} is {own}, {meaning}, and this program does not write it: `yieldwall od write {name} {:04X}h {wanted} \
                         --save` with --bus and --rig",
                        at.index
                    )));
                }
            }
            found.note(name, format!("{read} of {} objects exist, all neutral", NEUTRAL.len()));
        }
        Ok(all)
    }

    /// Listens to the force sensor while nobody touches the handle.
    pub(super) fn sensor_rest(&mut self, found: &mut Found) -> Result<(), Halt> {
        self.boot()?;
        let mut wrenches = Vec::with_capacity(self.cycles_in(LISTENING_S) as usize);
        let shown = self.runner.sense(self.rig, LISTENING_S, self.is_interrupted, |time_s, wrench| {
            wrenches.push((time_s, *wrench));
        })?;
        self.check_interrupt()?;
        let (count, means, noises) = (shown.count() as f64, shown.mean().0, shown.deviation().0);
        let (mean, noise) = (|axis: usize| means[axis], |axis: usize| noises[axis]);
        let rate_hz = self.rig.sensor.sample_rate_hz.get().min(1.0 / self.runner.period().as_secs_f64());
        if count < 0.9 * LISTENING_S * rate_hz {
            let wanted = LISTENING_S * rate_hz;
            return Err(Halt::Failed(format!(
                "the force sensor has sent {count:.0} samples in {LISTENING_S} s instead of {wanted:.0}"
            )));
        }
        let bias_n = mean(0).abs().max(mean(1).abs());
        let axes = ["x", "y", "z"].into_iter().enumerate();
        let texts =
            axes.map(|(axis, name)| format!("{name} {:.3} N +- {:.3} N", unsigned_zero(mean(axis)), noise(axis)));
        found.note(
            format!("{}: mean and standard deviation", self.rig.sensor.name),
            texts.collect::<Vec<_>>().join(", "),
        );
        found.curves.push(Curve {
            title: "force at rest".to_owned(),
            across: "time in s",
            up: "force in N",
            lines: [(0, "x"), (1, "y")]
                .map(|(axis, name)| {
                    (name.to_owned(), wrenches.iter().map(|(time, wrench)| [*time, wrench.0[axis]]).collect())
                })
                .into(),
        });
        found.measure(Figure {
            what: "largest noise of a force axis".into(),
            value: noise(0).max(noise(1)),
            limit: NOISE_SHARE * self.rig.fixture.yield_n.get(),
            unit: "N".into(),
        });
        let most_n = BIAS_SHARE * self.rig.guard.force_limit_n.get();
        if bias_n > most_n {
            return Err(Halt::Failed(format!(
                "the force sensor shows {bias_n:.2} N at rest (limit {most_n:.2} N): check that nothing touches the handle, and set the zero at the sensor"
            )));
        }
        if found.is_bad() {
            return Err(Halt::Failed(format!(
                "a force axis has {:.2} N of noise: check the shield of the sensor's cable, its ground, and vibrations of the arm",
                noise(0).max(noise(1))
            )));
        }
        Ok(())
    }

    /// Returns the mean force of the hand that the rig senses, N.
    fn sensed(&mut self) -> Result<Force, Halt> {
        self.boot()?;
        self.idle(SETTLING_S, |_| ())?;
        let (mut sum, mut cycles) = (Force::default(), 0_u32);
        self.idle(LISTENING_S, |record| {
            sum += record.signals.force;
            cycles += 1;
        })?;
        // A person is asked with nothing booted.
        self.runner.leave();
        Ok(sum / f64::from(cycles.max(1)))
    }

    /// Pulls at the tool along both axes, and looks at what is felt.
    pub(super) fn sensor_axes(&mut self, found: &mut Found) -> Result<(), Halt> {
        if self.rig.sensor.protocol.zero_at_start() {
            return Err(Halt::Skipped(
                "each boot zeroes the force sensor, even under a force (`zero_at_start`)".to_owned(),
            ));
        }
        let none = self.sensed()?;
        for (name, pulled) in [("x", Force::new(PULL_N, 0.0)), ("y", Force::new(0.0, PULL_N))] {
            let felt = self.pulled(pulled)? - none;
            let off_deg = angle_between_deg(felt, pulled);
            let size = felt.norm() / PULL_N;
            if size < FELT_SHARE {
                return Err(Halt::Failed(format!(
                    "the sensor reads {:.2} N under {PULL_N} N along {name}: nothing pulled at the handle beyond the sensor, the sensor does not \
                     measure, or `calibration` is far too small",
                    felt.norm()
                )));
            }
            found.note(
                format!("{PULL_N} N along {name}"),
                format!(
                    "read as {:.2} N along x and {:.2} N along y",
                    unsigned_zero(felt.x()),
                    unsigned_zero(felt.y())
                ),
            );
            found.measure(Figure {
                what: "direction error of a force".into(),
                value: off_deg,
                limit: DIRECTION_DEG,
                unit: "deg".into(),
            });
            if found.is_bad() {
                let why = if off_deg > 45.0 {
                    "an axis has the wrong sign, axes are swapped, or `mounted_on` or `mounting_angle_rad` is wrong"
                } else {
                    "`mounting_angle_rad` is wrong, or axes have cross-talk: check `calibration`"
                };
                return Err(Halt::Failed(format!(
                    "the sensor reads a force along {name} with {off_deg:.0} deg of rotation: {why}"
                )));
            }
            if (size - 1.0).abs() > SIZE_SHARE {
                return Err(Halt::Failed(format!(
                    "the sensor reads {:.2} N under {PULL_N} N along {name}: check `calibration`",
                    felt.norm()
                )));
            }
        }
        Ok(())
    }

    /// Returns the sensed force while a force pulls at the tool.
    fn pulled(&mut self, force: Force) -> Result<Force, Halt> {
        self.check_interrupt()?;
        if !self.attendant.pull(&mut self.runner.place, force) {
            return Err(Halt::Skipped(NOBODY_PULLS.to_owned()));
        }
        let felt = self.sensed();
        self.runner.leave();
        self.attendant.pull(&mut self.runner.place, Force::default());
        felt
    }
}

/// Why a step that needs a known force is skipped.
pub(super) const NOBODY_PULLS: &str = "nobody can pull at the tool with a known force";

/// Returns a force in N that is read with two or three decimals, without the sign of zero.
pub(super) fn unsigned_zero(force_n: f64) -> f64 {
    if force_n.abs() < 5e-4 { 0.0 } else { force_n }
}

fn angle_between_deg(one: Force, other: Force) -> f64 {
    let cosine = one.dot(other) / (one.norm() * other.norm()).max(f64::MIN_POSITIVE);
    yieldwall_motion::elementary::acos(cosine.clamp(-1.0, 1.0)).to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn torque_limits_of_either_sign_are_neutral_at_the_limit_of_the_rig() {
        let negative = |held: &[u8]| left_over(objects::NEGATIVE_TORQUE_LIMIT, true, held, 600);
        for held in [&[0xe8, 0x03][..], &[0x18, 0xfc], &[0xa8, 0xfd], &[0x18, 0xfc, 0xff, 0xff], &[0xff, 0xff]] {
            assert_eq!(negative(held), None, "{held:02x?}");
        }
        // -500, -599, 500 and 0 per mille, and -100 in one byte.
        assert_eq!(negative(&[0x0c, 0xfe]), Some((-500, -1000)));
        assert_eq!(negative(&[0xa9, 0xfd]), Some((-599, -1000)));
        assert_eq!(negative(&[0xf4, 0x01]), Some((500, 1000)));
        assert_eq!(negative(&[0, 0]), Some((0, 1000)));
        assert_eq!(negative(&[0x9c]), Some((-100, -1000)));
        assert_eq!(left_over(objects::NEGATIVE_TORQUE_LIMIT, true, &[0x18, 0xfc], 1200), Some((-1000, -1200)));
        assert_eq!(left_over(objects::TORQUE_OFFSET, false, &[0xfb, 0xff], 600), Some((-5, 0)));
        assert_eq!(left_over(objects::TORQUE_OFFSET, false, &[0xfb, 0xff, 0xff, 0xff], 600), Some((-5, 0)));
        assert_eq!(left_over(objects::POSITION_OFFSET, false, &[0; 4], 600), None);
    }
}
