use yieldwall::soak::*;
fn main() {
    let a: Vec<String> = std::env::args().skip(1).collect();
    let (seed, cycles, from, to): (u64, u32, u32, u32) =
        (a[0].parse().unwrap(), a[1].parse().unwrap(), a[2].parse().unwrap(), a[3].parse().unwrap());
    let shipped = Shipped::load().unwrap();
    let machine = Machine::draw(&shipped, seed, cycles);
    let script: Script = a[4].parse().unwrap();
    println!("{:?}", machine.rig.fixture);
    println!("{:?}", machine.scene.model);
    let show = a.len() > 5;
    let p = play_watched(&Course { machine: &machine, script: &script.injections, seed, cycles }, |o| {
        if o.cycle >= from && o.cycle <= to {
            let r = &o.reported;
            let t = &o.truth;
            println!(
                "{} {:.4} {:?} {:?} {:?} ran{} F({:.2},{:.2}) hand({:.2},{:.2}) q({:.6},{:.6}) tool({:.6},{:.6}) v({:.3},{:.3}) tgt({:.5},{:.5}) meas({:.5},{:.5}) tq({:.1},{:.1}) {:?} d{:.6} on{} hold{}",
                o.cycle,
                o.sync_ns as f64 * 1e-9,
                o.state,
                o.cause,
                o.request,
                o.ran,
                r.force_n[0],
                r.force_n[1],
                t.hand_n[0],
                t.hand_n[1],
                r.proxy_m[0],
                r.proxy_m[1],
                t.tool_m[0],
                t.tool_m[1],
                t.velocity_m_per_s[0],
                t.velocity_m_per_s[1],
                r.target_rad[0],
                r.target_rad[1],
                r.measured_rad[0],
                r.measured_rad[1],
                t.torques_n_m[0],
                t.torques_n_m[1],
                t.drives,
                r.distance_m,
                r.is_on_surface,
                r.hold_counter
            );
            if show {
                for f in &o.frames {
                    println!(
                        "      {:.6} {:?} {:03x} {:02x?}",
                        f.time_ns as f64 * 1e-9,
                        f.sender,
                        f.frame.id(),
                        f.frame.data()
                    );
                }
            }
        }
    });
    for e in &p.events {
        println!("    {e:?}");
    }
    for v in &p.violations {
        println!("  !! {} @{} {:.3}s {}", v.invariant.name(), v.cycle, v.time_s, v.seen);
    }
    println!("{:?}", p.end);
}
