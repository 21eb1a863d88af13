//! A simulated rig in twenty lines: drives and force sensor on a virtual CAN bus, arm and hand between them.
//!
//! ```sh
//! cargo run --release -p yieldwall --no-default-features --features sim --example simulated_rig
//! ```

use std::error::Error;

use yieldwall::config::{Source, load_rig};
use yieldwall::guard::{Request, State};
use yieldwall::record::Row;
use yieldwall::rig::EmbeddedRig;

fn main() -> Result<(), Box<dyn Error>> {
    // A shipped rig. `Source::named` takes the path of a file of yours as well.
    let loaded = load_rig(Source::named("builtin:paper-admittance.yaml"))?;
    let (rig, scene) = (&loaded.value, loaded.scene()?.value);
    let mut machine = EmbeddedRig::new(rig, &scene, &rig.fixture, scene.seed)?;
    machine.enable()?;
    // Eleven seconds of its scene at 1 kHz.
    let rows: Vec<Row> = (0..11_000).map(|_| machine.run_cycle(Request::None)).collect::<Result<_, _>>()?;
    assert_eq!(machine.state(), State::Running);
    machine.stop()?;

    println!("    time    tool x    tool y   hand x   hand y   proxy off the circle");
    for Row { time_s, tool_m: [x_m, y_m, _], force_n: [x_n, y_n, _], signed_distance_m, .. } in rows.iter().step_by(500)
    {
        let [x_mm, y_mm, off_mm] = [*x_m, *y_m, signed_distance_m.abs()].map(|length_m| 1e3 * length_m);
        println!("{time_s:6.1} s {x_mm:6.1} mm {y_mm:6.1} mm {x_n:6.1} N {y_n:6.1} N {off_mm:7.2} mm");
    }
    // After 1 s the hand hits the circle so fast that the proxy comes to rest 0.36 mm beyond; `hold_steps` of the fixture is 0.
    // From 4 s to 9 s it presses with 15 N at most, below the yield force of 20 N. After 10 s it presses with more than that.
    assert!(rows[4000..9000].iter().all(|row| row.signed_distance_m.abs() < 1e-9), "the circle holds the proxy");
    assert!(rows[10_500].signed_distance_m.abs() > 0.02, "the circle gives way");
    Ok(())
}

#[test]
fn what_the_example_says_is_so() -> Result<(), Box<dyn Error>> {
    main()
}
