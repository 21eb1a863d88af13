//! ethercrab, an EtherCAT master that nobody here wrote, on the simulated segment of two drives and a force sensor.
//!
//! ```text
//! cargo run --locked -p hil-tests-ethercrab --bin ethercrab_master -- [CAPTURE.pcap]
//! ```
//!
//! It finds the devices, reads their identity by SII and by SDO, sets up distributed clocks, reaches OP and exchanges 10 000 cycles with
//! the full working counter, in virtual time. Both ways of each frame up to the first cycles in OP go to the capture. A check that
//! fails ends it with a message and another exit code than 0.
//!
//! ethercrab 0.7.1 reads no value in segments: it takes the command specifier 0 of a segment, which ETG.1000.6 prescribes, for invalid.

use std::fs::File;
use std::io::BufWriter;
use std::time::Duration;

use ethercrab::error::Error;
use ethercrab::subdevice_group::DcConfiguration;
use ethercrab::{DcSync, MainDevice, MainDeviceConfig, PduStorage, Timeouts};

use hil_tests_ethercrab::capture::Capture;
use hil_tests_ethercrab::pump::{self, now, sleep_until};
use yieldwall::config::{builtin, load_rig};
use yieldwall::ethercat::frame::{BYTE_NS, DEVICE_NS};
use yieldwall::rig::SegmentServer;
use yieldwall::run::Pace;

/// Cycles with the full working counter.
const CYCLES: u32 = 10_000;
/// A cycle of the master, and of SYNC0.
const PERIOD: Duration = Duration::from_millis(1);
/// Cycles in which the devices have to reach OP.
const TO_OP: u32 = 2000;
/// Frames of the capture.
const CAPTURED: u32 = 6000;

/// What the master has seen.
struct Seen {
    devices: Vec<(String, u32, u32)>,
    cycles_to_op: u32,
    expected: u16,
    statusword: u16,
}

async fn master(main: &MainDevice<'_>) -> Result<Seen, Error> {
    let mut group = main.init_single_group::<4, 256>(|| now().0).await?;
    let mut devices = Vec::new();
    for mut device in group.iter_mut(main) {
        let identity = device.identity();
        devices.push((device.name().to_owned(), identity.vendor_id, identity.product_id));
        let by_sdo: u32 = device.sdo_read(0x1018, 2).await?;
        assert_eq!(by_sdo, identity.product_id, "{}: 1018h:2 and the product code of the SII", device.name());
        device.set_dc_sync(DcSync::Sync0);
    }
    let group = group.into_pre_op_pdi(main).await?;
    let configuration =
        DcConfiguration { start_delay: Duration::from_millis(10), sync0_period: PERIOD, sync0_shift: PERIOD / 2 };
    let group = group.configure_dc_sync(main, configuration).await?;
    let group = group.into_safe_op(main).await?;
    // Outputs have to arrive before a device enters OP.
    let group = group.request_into_op(main).await?;
    let mut expected = 0;
    for device in group.iter(main) {
        let io = device.io_raw();
        expected += u16::from(!io.inputs().is_empty()) + 2 * u16::from(!io.outputs().is_empty());
    }
    let mut cycles_to_op = 0;
    loop {
        let start = now();
        let response = group.tx_rx_dc(main).await?;
        sleep_until(start + response.extra.next_cycle_wait.max(PERIOD / 4)).await;
        if response.all_op() {
            break;
        }
        cycles_to_op += 1;
        assert!(
            cycles_to_op < TO_OP,
            "not all devices are in OP after {TO_OP} cycles: {:?}",
            response.subdevice_states
        );
    }
    for cycle in 0..CYCLES {
        let start = now();
        let response = group.tx_rx_dc(main).await?;
        assert_eq!(response.working_counter, expected, "working counter of cycle {cycle}");
        assert!(response.all_op(), "cycle {cycle}: {:?}", response.subdevice_states);
        sleep_until(start + response.extra.next_cycle_wait.max(PERIOD / 4)).await;
    }
    let inputs = group.subdevice(main, 0)?;
    let statusword = u16::from_le_bytes(inputs.inputs_raw()[..2].try_into().expect("two bytes"));
    Ok(Seen { devices, cycles_to_op, expected, statusword })
}

fn main() {
    let mut capture = std::env::args().nth(1).map(|path| {
        let file = File::create(&path).unwrap_or_else(|error| panic!("{path}: {error}"));
        Capture::new(BufWriter::new(file)).expect("the file takes its head")
    });
    let storage = PduStorage::<16, { PduStorage::element_size(1100) }>::new();
    let (tx, rx, pdu_loop) = storage.try_split().expect("nobody has split it before");
    let configuration = MainDeviceConfig { dc_static_sync_iterations: 1000, ..MainDeviceConfig::default() };
    let main = MainDevice::new(pdu_loop, Timeouts::default(), configuration);
    let rig = load_rig(builtin("paper-ethercat.yaml")).expect("a shipped rig");
    let scene = rig.scene().expect("a shipped scene").value;
    let server = SegmentServer::new(&rig.value, &scene, scene.seed, Pace::Free, [true; 3], now());
    let mut server = server.expect("a rig on EtherCAT");
    server.set_sdo_time(Duration::from_micros(200));
    // Preamble and check sequence are 12 bytes beside the frame.
    let on_wire = |bytes: usize| Duration::from_nanos((bytes.max(60) as u64 + 12) * BYTE_NS + 3 * DEVICE_NS);
    let segment = |at, frame: &mut [u8]| {
        let mut is_back = false;
        server.on_frame(at, frame, |_| is_back = true).expect("the arm goes on");
        assert!(is_back, "the cable is in");
        at + on_wire(frame.len())
    };
    let mut frames = 0_u32;
    let tap = |at, bytes: &[u8]| {
        frames += 1;
        if let Some(capture) = capture.as_mut().filter(|_| frames <= CAPTURED) {
            capture.frame(at, bytes).expect("the file takes a frame");
        }
    };
    let seen = pump::run(tx, rx, segment, tap, master(&main));
    let seen = seen.unwrap_or_else(|error| panic!("ethercrab: {error}"));
    for (name, vendor, product) in &seen.devices {
        println!("found     {name}: vendor {vendor:08X}h, product {product:08X}h");
    }
    assert_eq!(seen.devices.len(), 3, "two drives and a sensor");
    assert_eq!(seen.statusword & 0x4f, 0x40, "a drive that nobody has enabled is in Switch On Disabled");
    println!("OP        after {} cycles", seen.cycles_to_op);
    println!("exchanged {CYCLES} cycles, working counter {} in each; {} frames both ways", seen.expected, frames);
    println!("\ntest result: ok. 1 passed; 0 failed; 0 ignored; 0 measured; 0 filtered out; ethercrab");
    if let Some(capture) = capture {
        capture.end().expect("the file takes its end");
    }
}
