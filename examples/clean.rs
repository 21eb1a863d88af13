use yieldwall::soak::*;
fn main() {
    let a: Vec<u64> = std::env::args().skip(1).map(|x| x.parse().unwrap()).collect();
    let shipped = Shipped::load().unwrap();
    let t = std::time::Instant::now();
    let mut peaks = Peaks::default();
    let mut n = 0u64;
    for seed in a[0]..a[1] {
        let machine = Machine::draw(&shipped, seed, a[2] as u32);
        let p = play(&Course { machine: &machine, script: &[], seed, cycles: a[2] as u32 });
        n += u64::from(p.cycles);
        peaks.join(&p.peaks);
        let f = &machine.rig.fixture;
        println!(
            "{seed} {} {:?} R{:.1} F{:.1} M{:?} hold{} {:?} hand k{:.0} m{:.1} lim{:.0} ret {:.1}mJ",
            machine.file,
            p.end,
            f.yield_n.get(),
            f.friction_n.get(),
            f.coupling,
            f.hold_steps,
            f.side,
            machine.scene.hand.stiffness_n_per_m.get(),
            machine.scene.hand.mass_kg.get(),
            machine.scene.hand.voluntary_force_limit_n.get(),
            p.peaks.returned_j * 1e3
        );
        for e in &p.events {
            if e.cause.is_some() {
                println!("    {e:?}");
            }
        }
        for v in &p.violations {
            println!("  !! {} @{} {:.3}s {}", v.invariant.name(), v.cycle, v.time_s, v.seen);
        }
    }
    println!("{peaks:?} {:.0} cycles/s", n as f64 / t.elapsed().as_secs_f64());
}
