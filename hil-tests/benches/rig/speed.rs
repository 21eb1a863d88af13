//! Simulated seconds per second.

use hil_tests::machine::Machine;
use hil_tests::stopwatch::{Spread, Stopwatch};
use yieldwall::guard::Request;
use yieldwall::record::Row;
use yieldwall::rig::{EmbeddedRig, RigError};

use crate::Effort;

/// Rig and step of the plant in us.
const CASES: [(&str, u32); 4] = [
    ("paper-admittance", 100),
    ("paper-admittance", 1000),
    ("paper-admittance-csp", 100),
    ("paper-admittance-csp", 1000),
];

pub(crate) fn measure(effort: &Effort) -> Result<(), RigError> {
    println!(
        "whole rig in virtual time, scene circle-tour, rows not kept, {} runs each: median (least, most)",
        effort.runs
    );
    println!(
        "{:<26} {:>22} {:>18} {:>22}   hash of rows",
        "rig/plant step in us", "ns per cycle", "x real time", "wall clock ns"
    );
    for (name, plant_step_us) in CASES {
        let label = format!("{name}/{plant_step_us}");
        if !effort.is_wanted(&label) {
            continue;
        }
        let machine = Machine::builtin(name, "circle-tour").with_plant_step_us(plant_step_us);
        let cycles = machine.cycles().min(effort.cycles);
        let hash = hash_run(machine.enabled()?, cycles)?;
        let (mut on_core, mut wall) = (Vec::new(), Vec::new());
        for _ in 0..effort.runs {
            let mut rig = machine.enabled()?;
            let start = Stopwatch::start();
            for _ in 0..cycles {
                std::hint::black_box(rig.run_cycle(Request::None)?);
            }
            let elapsed = start.elapsed();
            on_core.push(elapsed.on_core_ns / cycles as f64);
            wall.push(elapsed.wall_ns / cycles as f64);
        }
        let (on_core, wall) = (Spread::of(on_core), Spread::of(wall));
        let period_ns = machine.period_s() * 1e9;
        let speed = Spread {
            median: period_ns / on_core.median,
            least: period_ns / on_core.most,
            most: period_ns / on_core.least,
        };
        let columns = [on_core, speed, wall].map(|spread| format!("{spread:.0}"));
        println!("{label:<26} {:>22} {:>18} {:>22}   {hash:016x}", columns[0], columns[1], columns[2]);
    }
    Ok(())
}

/// All bits of all rows of a run.
fn hash_run(mut rig: EmbeddedRig, cycles: usize) -> Result<u64, RigError> {
    let mut hash = Hash::new();
    for _ in 0..cycles {
        hash.take_row(&rig.run_cycle(Request::None)?);
    }
    Ok(hash.0)
}

/// FNV-1a, 64 bits, over whole words.
struct Hash(u64);

impl Hash {
    fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    fn take(&mut self, word: u64) {
        for byte in word.to_le_bytes() {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }

    fn take_row(&mut self, row: &Row) {
        let scalars = [row.time_s, row.power_w, row.signed_distance_m];
        let vectors = [row.tool_m, row.proxy_m, row.tool_velocity_m_per_s, row.force_n];
        let pairs = [row.torques_n_m, row.target_angles_rad, row.measured_angles_rad];
        let numbers = scalars.iter().chain(vectors.iter().flatten()).chain(pairs.iter().flatten());
        numbers.for_each(|number| self.take(number.to_bits()));
        let flags = [row.is_on_surface.into(), row.hold_counter, row.is_impact.into(), row.supervisor_state.into()];
        flags.into_iter().for_each(|flag| self.take(u64::from(flag)));
    }
}
