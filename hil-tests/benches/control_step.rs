//! Cost of one control step, `cycle::Cycle::step`, on the inputs of a recorded run.

mod on_core;

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use hil_tests::machine::Machine;
use hil_tests::tape::Tape;
use on_core::OnCore;

/// The tool meets the circle, is pressed onto it and pulled off it in this stretch of the tour.
const SKIP: usize = 1000;
const PERIODS: usize = 8192;

fn control_step(criterion: &mut Criterion<OnCore>) {
    for rig in ["paper-admittance", "paper-admittance-csp"] {
        let tape = Tape::record(Machine::builtin(rig, "circle-tour"), SKIP, PERIODS).expect("a run");
        let mut cycle = tape.cycle().clone();
        let mut at = 0;
        criterion.bench_function(&format!("control step, {rig}"), |bencher| {
            bencher.iter(|| {
                if at == 0 {
                    // Once in 8192 steps; less than a nanosecond each.
                    cycle = tape.cycle().clone();
                }
                let inputs = black_box(&tape.periods[at].inputs);
                at = (at + 1) % PERIODS;
                cycle.step(inputs)
            });
        });
    }
}

criterion_group!(name = benches; config = on_core::criterion(); targets = control_step);
criterion_main!(benches);
