//! A rig, a scene and a hand from a seed.
//!
//! A drawn rig passes the checks of the configuration, like a loaded file.

mod hand;
mod rig;

use yieldwall_config::injection::{Injection, Kind, Target};
use yieldwall_config::{self as config, Report, Source};

use super::dice::{Dice, Purpose};

/// The rigs that come with the program, in the order in which seeds choose them.
pub const RIGS: [&str; 6] = [
    "paper-admittance.yaml",
    "paper-admittance-csp.yaml",
    "paper-admittance-csv.yaml",
    "paper-admittance-cartesian.yaml",
    "paper-admittance-2ms.yaml",
    "paper-admittance-4ms.yaml",
];

/// Rigs whose buses and devices the others can have instead of their own.
const ON_ETHERCAT: &str = "paper-ethercat.yaml";
const ON_BOTH: &str = "paper-ethercat-can-sensor.yaml";

/// Buses of the machines in turn; each entry holds for as many seeds as there are rigs.
const TURNS: [On; 7] = [On::Can, On::Segment, On::Both, On::Can, On::Segment, On::Can, On::Segment];

/// On which buses drives and sensor are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum On {
    Can,
    Segment,
    /// The drives on a segment, the sensor on CAN.
    Both,
}

/// The rigs that come with the program, read once.
#[derive(Clone, Debug)]
pub struct Shipped {
    rigs: Vec<(config::Rig, config::Scene)>,
    on_ethercat: config::Rig,
    on_both: config::Rig,
}

impl Shipped {
    /// Reads them.
    ///
    /// # Errors
    /// If a file inside the program is refused.
    pub fn load() -> Result<Self, Report> {
        let mut rigs = Vec::new();
        for name in RIGS {
            let rig = config::load_rig(Source::named(&format!("builtin:{name}")))?;
            let scene = rig.scene()?;
            rigs.push((rig.value, scene.value));
        }
        let load = |name: &str| Ok::<_, Report>(config::load_rig(Source::named(&format!("builtin:{name}")))?.value);
        Ok(Self { rigs, on_ethercat: load(ON_ETHERCAT)?, on_both: load(ON_BOTH)? })
    }
}

/// A rig with its scene, as drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Machine {
    /// The shipped file that it was drawn from.
    pub file: &'static str,
    /// The rig.
    pub rig: config::Rig,
    /// The scene.
    pub scene: config::Scene,
    /// Whether the encoders were set so that their counts wrap near the start.
    pub wraps: bool,
}

impl Machine {
    /// Draws the machine of `seed`. It is the same for any number of cycles, so that a shorter run is the beginning of a
    /// longer one.
    pub fn draw(shipped: &Shipped, seed: u64) -> Self {
        let mut dice = Dice::new(seed, Purpose::Rig);
        let (choice, turn) = ((seed % RIGS.len() as u64) as usize, seed / RIGS.len() as u64);
        let (mut rig, mut scene) = shipped.rigs[choice].clone();
        let on = TURNS[(turn % TURNS.len() as u64) as usize];
        let counts_before = rig.sensor.calibration[0][0].get();
        match on {
            On::Can => {}
            On::Segment => rig::move_to(&mut rig, &shipped.on_ethercat),
            On::Both => {
                // Of a sensor on CAN no cycle may miss a sample.
                let sample_rate_hz = rig.sensor.sample_rate_hz;
                rig::move_to(&mut rig, &shipped.on_both);
                rig.sensor.sample_rate_hz = sample_rate_hz;
            }
        }
        rig::vary_fixture(&mut dice, &mut rig);
        let wraps = rig::vary_devices(&mut dice, &mut rig);
        rig::vary_model(&mut dice, &rig, &mut scene, counts_before / rig.sensor.calibration[0][0].get());
        if on != On::Can {
            rig::vary_segment(&mut dice, &mut rig);
        }
        let mut dice = Dice::new(seed, Purpose::Hand);
        scene.hand = hand::draw(&mut dice, &rig);
        scene.seed = seed;
        Self { file: RIGS[choice], rig, scene, wraps }
    }

    /// Returns the name of the shipped file, and the buses of its devices if they are not on CAN.
    pub fn title(&self) -> String {
        let on = match (self.rig.is_on_can(), self.rig.is_on_ethercat()) {
            (true, true) => " on EtherCAT and CAN",
            (false, true) => " on EtherCAT",
            _ => "",
        };
        format!("{}{on}", self.file)
    }

    /// Returns the targets of an injection: the targets of its kind on whose bus the kind has a meaning.
    pub(super) fn targets(&self, kind: Kind) -> Vec<Target> {
        let is_possible = |target: &Target| {
            let injection = Injection::new(kind, 0.0).on(*target);
            kind.row().media.contains(&self.rig.medium(&injection))
        };
        kind.row().targets.iter().copied().filter(is_possible).collect()
    }

    /// Returns the cycle time in s.
    pub fn period_s(&self) -> f64 {
        f64::from(self.rig.cycle.period_us) * 1e-6
    }
}

fn positive(value: f64) -> config::Positive {
    config::Positive::new(value).unwrap_or_else(|| unreachable!("{value} is drawn above zero"))
}

fn not_negative(value: f64) -> config::NotNegative {
    config::NotNegative::new(value).unwrap_or_else(|| unreachable!("{value} is drawn from zero up"))
}

fn finite(value: f64) -> config::Finite {
    config::Finite::new(value).unwrap_or_else(|| unreachable!("{value} is drawn finite"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drawn_rig_could_have_been_written() {
        let shipped = Shipped::load().unwrap();
        let mut files = std::collections::BTreeSet::new();
        let folder = std::env::temp_dir().join(format!("yieldwall-draw-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        for seed in 0..126 {
            let Machine { file, mut rig, scene, .. } = Machine::draw(&shipped, seed);
            files.insert((file, rig.is_on_can(), rig.is_on_ethercat()));
            rig.simulated_mut().unwrap().scene = "scene.yaml".into();
            let write = |name: &str, text: String| std::fs::write(folder.join(name), text).unwrap();
            write("scene.yaml", config::to_yaml(&scene).unwrap());
            write("rig.yaml", config::to_yaml(&rig).unwrap());
            let read = config::load_rig(Source::disk(folder.join("rig.yaml")));
            let read = read.unwrap_or_else(|report| panic!("seed {seed}: {report}"));
            assert_eq!(read.value, rig, "seed {seed}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
        assert_eq!(files.len(), 3 * RIGS.len(), "each on CAN, on EtherCAT and on both");
    }

    #[test]
    fn the_same_seed_draws_the_same_machine() {
        let shipped = Shipped::load().unwrap();
        assert_eq!(Machine::draw(&shipped, 11), Machine::draw(&shipped, 11));
        assert_ne!(Machine::draw(&shipped, 11), Machine::draw(&shipped, 17));
    }
}
