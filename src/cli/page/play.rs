//! A simulated rig whose hand is the pointer of a page.

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::serve::{VIRTUAL_TIME, announce, fed, hello, loads, start};
use super::{PlayArguments, description};
use crate::ending::rig_failure;
use crate::failure::{Exit, Failure};
use crate::faults::at_first_target;
use crate::interrupt::on_interrupt;
use crate::keep::{Keep, described};
use crate::output::Output;
use crate::run::simulated_interfaces;
use yieldwall_config::injection::{Injection, Kind};
use yieldwall_config::{self as config, Source as File};
use yieldwall_record::CycleRecord;
use yieldwall_record::recording::Producer;
use yieldwall_rig::Playground;
use yieldwall_rig::report::{Overrides, replay};
use yieldwall_run::recorder::{Wanted, Watched};
use yieldwall_run::{Observer, Watch};
use yieldwall_view::{Choice, Hello, Injectable, Order, Play, RING, Server, Setting, Source, orders};

/// Longest time by which the simulation catches up with the wall clock; it skips the rest.
const CATCH_UP: Duration = Duration::from_millis(50);
/// Greatest force of the hand where its scene names none, N.
const HAND_LIMIT_N: f64 = 60.0;
/// Spring of the elastic wall, N/m, as in `config/play-spring.yaml`. No damper removes the energy that it stores.
const SPRING_N_PER_M: f64 = 1500.0;
/// Damping of the viscous wall across and along, N s/m.
const VISCOUS_N_S_PER_M: [f64; 2] = [200.0, 10.0];

/// Faults that each show another reaction of the supervisor on the page.
const FAULTS: [Kind; 8] = [
    Kind::DriveFault,
    Kind::NodeReset,
    Kind::SensorSilent,
    Kind::SensorJump,
    Kind::EncoderStuck,
    Kind::ArmBlocked,
    Kind::ComputeLate,
    Kind::StopRequest,
];

/// Laws to choose from.
const LAWS: [Choice; 4] = [
    Choice { key: "plastic", name: "plastic wall" },
    Choice { key: "elastic", name: "spring" },
    Choice { key: "viscous", name: "viscous" },
    Choice { key: "free", name: "none" },
];

/// Rig, scene and law at present.
#[derive(Clone)]
struct Table {
    rig: config::Rig,
    scene: config::Scene,
    /// The fixture of the rig file.
    own: config::Fixture,
    /// A hold has no use with a law that keeps nothing on the surface, and returns with the plastic law.
    hold_steps: u32,
}

/// Effect of a change on the simulation.
enum Change {
    /// The rig is built anew.
    Fixture,
    /// The hand holds the tool by another spring.
    Hand(f64),
}

impl Table {
    fn of(file: &config::Loaded<config::Rig>) -> Result<Self, Failure> {
        let mut scene = file.scene()?.value;
        scene.hand.voluntary_force_limit_n.get_or_insert(positive(HAND_LIMIT_N)?);
        let rig = file.value.clone();
        Ok(Self { own: rig.fixture.clone(), hold_steps: rig.fixture.hold_steps, rig, scene })
    }

    fn hello(&self) -> Hello {
        Hello {
            play: Some(self.play()),
            ..hello("play", Some(VIRTUAL_TIME.to_owned()), description::of_rig(&self.rig))
        }
    }

    fn law(&self) -> &'static str {
        match &self.rig.fixture.law {
            Some(law) if law.guidance().is_some() => law.name(),
            _ => "plastic",
        }
    }

    fn settings(&self) -> Vec<Setting> {
        let fixture = &self.rig.fixture;
        let mut settings = vec![
            setting(("yield_n", "yield force R", "N"), (2.0, 60.0, 0.5), *fixture.yield_n),
            setting(("friction_n", "friction F", "N"), (0.0, 20.0, 0.5), *fixture.friction_n),
        ];
        if let config::Coupling::Admittance { mass_kg } = fixture.coupling {
            settings.push(setting(("mass_kg", "virtual mass M", "kg"), (0.5, 10.0, 0.1), *mass_kg));
        }
        if fixture.automatic_hold.is_none() {
            let steps = f64::from(self.hold_steps);
            settings.push(setting(("hold_steps", "hold N_wait", "cycles"), (0.0, 300.0, 2.0), steps));
        }
        let stiffness = *self.scene.hand.stiffness_n_per_m;
        settings.push(setting(
            ("hand_stiffness_n_per_m", "stiffness of the hand", "N/m"),
            (100.0, 1500.0, 10.0),
            stiffness,
        ));
        settings
    }

    fn play(&self) -> Play {
        let faults = FAULTS.iter().filter(|kind| self.injection(**kind).is_some()).map(|kind| {
            let row = kind.row();
            Injectable { name: row.name, meaning: row.meaning }
        });
        Play { settings: self.settings(), laws: LAWS.to_vec(), law: self.law(), faults: faults.collect() }
    }

    /// Returns the usual injection of this kind, if it can be made on this rig.
    fn injection(&self, kind: Kind) -> Option<Injection> {
        at_first_target(Injection::new(kind, 0.0), &self.rig)
    }

    /// Sets a number.
    fn set(&mut self, key: &str, value: f64) -> Result<Change, Failure> {
        let known = self.settings().into_iter().find(|setting| setting.key == key);
        let Some(Setting { name, unit, least, most, .. }) = known else {
            return Err(refused(format!("there is no setting {key}")));
        };
        if !(least..=most).contains(&value) {
            return Err(refused(format!("{name} is {value} {unit}: it lies between {least} and {most} {unit}")));
        }
        let fixture = &mut self.rig.fixture;
        match key {
            "yield_n" if value <= *fixture.friction_n => {
                let friction_n = *fixture.friction_n;
                return Err(refused(format!(
                    "Yield force R must be above friction F ({friction_n} N). Lower F first."
                )));
            }
            "friction_n" if value >= *fixture.yield_n => {
                let yield_n = *fixture.yield_n;
                return Err(refused(format!("Friction F must be below yield force R ({yield_n} N). Raise R first.")));
            }
            "yield_n" => fixture.yield_n = positive(value)?,
            "friction_n" => fixture.friction_n = not_negative(value)?,
            "mass_kg" => fixture.coupling = config::Coupling::Admittance { mass_kg: positive(value)? },
            "hold_steps" => {
                self.hold_steps = value.round() as u32;
                self.keep_hold();
            }
            _ => {
                self.scene.hand.stiffness_n_per_m = positive(value)?;
                return Ok(Change::Hand(value));
            }
        }
        Ok(Change::Fixture)
    }

    /// Takes another law.
    fn take_law(&mut self, key: &str) -> Result<Change, Failure> {
        let [across, along] = VISCOUS_N_S_PER_M;
        let fixture = &mut self.rig.fixture;
        fixture.law = match key {
            "plastic" => self.own.law.filter(|law| law.guidance().is_none()),
            "elastic" => Some(config::FixtureLaw::Elastic {
                stiffness_n_per_m: positive(SPRING_N_PER_M)?,
                damping_n_s_per_m: not_negative(0.0)?,
                is_saturated: false,
            }),
            "viscous" => Some(config::FixtureLaw::Viscous {
                across_n_s_per_m: not_negative(across)?,
                along_n_s_per_m: not_negative(along)?,
            }),
            "free" => Some(config::FixtureLaw::Free {}),
            _ => return Err(refused(format!("there is no law {key}"))),
        };
        let is_plastic = key == "plastic";
        // Groups of the file that a law without a yield force refuses.
        fixture.automatic_hold = self.own.automatic_hold.filter(|_| is_plastic);
        fixture.passivity = self.own.passivity.filter(|_| is_plastic);
        self.keep_hold();
        Ok(Change::Fixture)
    }

    fn keep_hold(&mut self) {
        self.rig.fixture.hold_steps = if self.law() == "plastic" { self.hold_steps } else { 0 };
    }

    /// Returns rig and scene, checked as files are.
    fn checked(&self) -> Result<(config::Rig, config::Scene), Failure> {
        let about = described(replay::about(&self.rig, Some(&self.scene), &Overrides::default()))?;
        let scene = replay::scene(&about)?.unwrap_or_else(|| self.scene.clone());
        Ok((replay::rig(&about)?, scene))
    }
}

/// The runs of a simulation, one for each fixture that it has had.
struct Runs {
    producer: Arc<Mutex<Producer<CycleRecord>>>,
    /// Folder with a folder for each run.
    folder: Option<PathBuf>,
    count: u32,
    keep: Option<Keep>,
}

impl Runs {
    /// Starts the next run, with the tool at a point or where the scene has it.
    fn start(
        &mut self,
        rig: &config::Rig,
        scene: &config::Scene,
        tool_m: Option<[f64; 2]>,
    ) -> Result<Playground, Failure> {
        let mut scene = scene.clone();
        if let Some(point_m) = tool_m {
            scene.hand.start_m = point_m.into_iter().filter_map(config::Finite::new).collect();
        }
        let producer = Arc::clone(&self.producer);
        let observer: Observer =
            Box::new(move |record| producer.lock().unwrap_or_else(PoisonError::into_inner).push(record));
        let mut watch = Watch { observer: Some(observer), ..Watch::default() };
        if let Some(folder) = &self.folder {
            self.count += 1;
            let folder = folder.join(self.count.to_string());
            let wanted = Wanted { record: Some(&folder), ..Wanted::default() };
            let about = described(replay::about(rig, Some(&scene), &Overrides::default()))?;
            let (keep, kept) = Keep::start(Watched::Simulation(&simulated_interfaces(rig)), rig, &about, &wanted)?;
            self.keep = Some(keep);
            watch = watch.and(kept);
        }
        Playground::start(rig, &scene, watch).map_err(|error| rig_failure(&error))
    }

    /// Waits until the recording of the last run is on disk.
    fn finish(&mut self) -> Result<(), Failure> {
        self.keep.take().map_or(Ok(()), |keep| keep.finish()?.is_written())
    }
}

/// A rig on its table, and the page that shows it.
struct Game {
    table: Table,
    playground: Playground,
    runs: Runs,
    server: Server,
}

impl Game {
    /// Carries out an order. A refused order changes nothing, and the page shows the reason.
    fn obey(&mut self, order: Order) -> Result<(), Failure> {
        let done = match order {
            Order::Hold(point_m) => {
                self.playground.hold(point_m);
                return Ok(());
            }
            Order::LetGo => {
                self.playground.let_go();
                return Ok(());
            }
            Order::Stop => {
                self.playground.stop();
                return Ok(());
            }
            Order::Reset => {
                self.playground.reset();
                return Ok(());
            }
            Order::Enable => self.playground.enable().map_err(|error| rig_failure(&error)),
            Order::Fault(name) => self.inject(&name),
            Order::Set { key, value } => self.change(|table| table.set(&key, value)),
            Order::Law(key) => self.change(|table| table.take_law(&key)),
        };
        if let Err(failure) = done {
            failure.report.diagnostics.iter().for_each(|finding| self.server.notify(&finding.message));
        }
        self.describe()
    }

    /// Sends the current settings to the page.
    fn describe(&self) -> Result<(), Failure> {
        let described = self.server.describe(&self.table.hello());
        described.map_err(|error| Failure::new(Exit::Internal, error.to_string(), ""))
    }

    fn inject(&mut self, name: &str) -> Result<(), Failure> {
        let kind = FAULTS.into_iter().find(|kind| kind.row().name == name);
        let injection = kind.and_then(|kind| self.table.injection(kind));
        let injection = injection.ok_or_else(|| refused(format!("there is no fault {name} to inject here")))?;
        self.playground.inject(injection).map_err(|error| rig_failure(&error))
    }

    fn change(&mut self, change: impl FnOnce(&mut Table) -> Result<Change, Failure>) -> Result<(), Failure> {
        let mut table = self.table.clone();
        match change(&mut table)? {
            Change::Hand(stiffness_n_per_m) => {
                let set = self.playground.set_hand_stiffness(stiffness_n_per_m);
                set.map_err(|error| rig_failure(&error))?;
            }
            Change::Fixture => {
                let (rig, scene) = table.checked()?;
                self.runs.finish()?;
                let tool_m = self.playground.tool_m();
                // A rig does not start everywhere where a tool can be pushed to.
                let started =
                    self.runs.start(&rig, &scene, Some(tool_m)).or_else(|_| self.runs.start(&rig, &scene, None));
                self.playground = started?;
            }
        }
        self.table = table;
        Ok(())
    }

    fn run_cycle(&mut self) -> Result<(), Failure> {
        if let Err(error) = self.playground.run_cycle() {
            self.server.notify(&format!("The simulation could not go on and starts again. Reason: {error}."));
            self.runs.finish()?;
            let (rig, scene) = self.table.checked()?;
            self.playground = self.runs.start(&rig, &scene, None)?;
            return self.describe();
        }
        Ok(())
    }
}

/// Serves the page of a simulation until Ctrl-C.
pub(crate) fn play(arguments: &PlayArguments, output: &mut Output) -> Result<(), Failure> {
    let file = config::load_rig(File::named(&arguments.rig))?;
    output.configuration(&file.warnings)?;
    let table = Table::of(&file)?;
    let is_interrupted = on_interrupt()?;
    // The cycles of a boot come as fast as they can be computed.
    let (live, producer, feed) = fed(8 * RING)?;
    let producer = Arc::new(Mutex::new(producer));
    let mut runs = Runs { producer, folder: arguments.record.clone(), count: 0, keep: None };
    let (rig, scene) = table.checked()?;
    let (desk, orders) = orders();
    // First: an address that is refused leaves no recording.
    let server = start(arguments.view, table.hello(), Source::Play(live, desk))?;
    server.set_buses(loads(&table.rig));
    let playground = runs.start(&rig, &scene, None)?;
    let _opened = announce(&server, arguments.no_open, output)?;
    let period = Duration::from_micros(file.value.cycle.period_us.into());
    let mut game = Game { table, playground, runs, server };
    let mut due = Instant::now();
    while !is_interrupted.load(Ordering::Relaxed) {
        // After an order that builds a rig the next cycle comes first.
        let mut is_light = true;
        while is_light && let Ok(order) = orders.try_recv() {
            is_light = matches!(order, Order::Hold(_) | Order::LetGo);
            game.obey(order)?;
        }
        game.run_cycle()?;
        due = due.max(Instant::now().checked_sub(CATCH_UP).unwrap_or(due)) + period;
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
    }
    let Game { playground, mut runs, server, .. } = game;
    drop(playground);
    let kept = runs.finish();
    let _ = feed.finish();
    server.end("The program has ended.");
    kept
}

fn setting(
    (key, name, unit): (&'static str, &'static str, &'static str),
    (least, most, step): (f64, f64, f64),
    value: f64,
) -> Setting {
    // The values of a rig file can be outside the usual range.
    Setting { key, name, unit, least: least.min(value), most: most.max(value), step, value }
}

fn refused(message: String) -> Failure {
    Failure::new(Exit::Usage, message, "")
}

fn positive(value: f64) -> Result<config::Positive, Failure> {
    config::Positive::new(value).ok_or_else(|| refused(format!("{value} is not above 0")))
}

fn not_negative(value: f64) -> Result<config::NotNegative, Failure> {
    config::NotNegative::new(value).ok_or_else(|| refused(format!("{value} is below 0")))
}
