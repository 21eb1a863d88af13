use yieldwall::{config, study};
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let rig = match config::load_rig(std::path::Path::new(&args[1])) {
        Ok(r) => r,
        Err(e) => {
            println!("{e:#?}");
            return;
        }
    };
    let scene_path = args.get(2).cloned().unwrap_or_else(|| format!("config/{}", rig.value.scene));
    let scene = match config::load_scene(std::path::Path::new(&scene_path)) {
        Ok(r) => r,
        Err(e) => {
            println!("{e:#?}");
            return;
        }
    };
    let mut o = study::Overrides::default();
    let mut f = rig.value.fixture.clone();
    if let Some(n) = args.get(3) {
        f.hold_steps = n.parse().unwrap();
    }
    o.fixture = Some(f);
    println!("{:#?}", yieldwall::rig::pose_margins(&rig.value));
    let t0 = std::time::Instant::now();
    match study::run_rig(&rig.value, &scene.value, &o, None, |_| {}) {
        Ok(r) => {
            let el = t0.elapsed().as_secs_f64();
            println!("{:#?}", r.measures);
            println!(
                "state {:?} cause {:?} rows {} bus {:?} x{}",
                r.state,
                r.cause,
                r.trace.rows.len(),
                r.bus,
                r.trace.rows.len() as f64 * r.period_s / el
            );
            if let Some(p) = args.get(4) {
                use std::io::Write;
                let mut w = std::io::BufWriter::new(std::fs::File::create(p).unwrap());
                for row in &r.trace.rows {
                    writeln!(
                        w,
                        "{} {} {} {} {} {} {} {} {} {} {} {} {}",
                        row.time_s,
                        row.tool_m[0],
                        row.tool_m[1],
                        row.proxy_m[0],
                        row.proxy_m[1],
                        row.force_n[0],
                        row.force_n[1],
                        row.torques_n_m[0],
                        row.torques_n_m[1],
                        row.signed_distance_m,
                        row.is_on_surface as u8,
                        row.target_angles_rad[0] - row.measured_angles_rad[0],
                        row.power_w
                    )
                    .unwrap();
                }
            }
        }
        Err(e) => println!("ERR {e}"),
    }
}
