//! Segments that do not come up: each with one message that says where, what and what to try.

use super::*;
use yieldwall_fieldbus::ethercat::registers as register;
use yieldwall_sim::ethercat::Manner;

/// Why a segment of these devices does not come up.
fn refused(setup: &SegmentSetup, devices: Vec<Controller<SimulatedDevice>>) -> String {
    let mut bench = Bench::new(setup, devices);
    let message = bench.start().unwrap_err();
    assert!(!message.contains('\u{1b}') && message.len() < 400, "{message}");
    message
}

#[test]
fn nothing_is_written_where_somebody_else_is_the_master() {
    let mut bench = Bench::usual();
    bench.start().unwrap();
    bench.cycles(5, &REST);
    // Another one looks while this one runs.
    let mut other = EthercatNetwork::new(&setup()).unwrap();
    let mut sent = Vec::new();
    other.start(bench.now, &mut sent);
    for _ in 0..10 {
        let Some(mut frame) = sent.pop() else { break };
        assert!(matches!(frame[16], 1 | 7), "command {}", frame[16]);
        let now = bench.now;
        bench.segment.process(now, &mut frame);
        other.on_frame(now, &frame, &mut sent);
    }
    let Phase::Failed(error) = other.phase() else { panic!("{:?}", other.phase()) };
    assert_eq!(
        error.to_string(),
        "left (position 0): look for another master: a master is on this segment; nothing was written: the device at position 0 is \
         in OP, where somebody has put it"
    );
    assert_eq!(bench.al(0), "OP");
}

#[test]
fn a_device_that_somebody_holds_in_safe_op_is_led_by_a_master() {
    // SAFE-OP with another error than that of a master that has died.
    let mut bench = Bench::usual();
    bench.start().unwrap();
    let now = bench.now;
    bench.segment.controller_mut(1).unwrap().fail(now, AlStatusCode::SYNC_ERROR);
    let mut other = Bench::usual();
    std::mem::swap(&mut other.segment, &mut bench.segment);
    other.now = now;
    other.segment.controller_mut(0).unwrap().fail(now, AlStatusCode::SYNC_MANAGER_WATCHDOG);
    other.keeps = true;
    let message = other.start().unwrap_err();
    assert_eq!(
        message,
        "right (position 1): look for another master: a master is on this segment; nothing was written: the device at position 1 is in \
         SAFE-OP+ERR, where somebody has put it"
    );
    assert!(other.sent.iter().all(|frame| matches!(frame[16], 1 | 7)), "APRD and BRD");
}

#[test]
fn a_frame_of_somebody_else_is_a_master() {
    let mut network = EthercatNetwork::new(&setup()).unwrap();
    let mut other = EthercatNetwork::new(&setup()).unwrap();
    let (mut sent, mut out) = (Vec::new(), Vec::new());
    other.start(Time(0), &mut sent);
    network.on_frame(Time(5), &sent[0], &mut out);
    let Phase::Failed(error) = network.phase() else { panic!("{:?}", network.phase()) };
    assert_eq!(
        error.to_string(),
        "master: listen: a master is on this segment; nothing was written: an EtherCAT frame came from 10:10:10:10:10:10"
    );
    network.start(Time(9), &mut out);
    assert!(out.is_empty(), "it stays silent");
}

#[test]
fn an_empty_wire_and_a_short_segment_are_told() {
    let mut bench = Bench::usual();
    bench.segment.set_cable(0, false);
    let message = bench.start().unwrap_err();
    assert_eq!(
        message,
        "master: look for devices: 10 frames were sent and none came back: plug in the cable, or name the interface that the devices \
         are at"
    );
    let mut bench = Bench::usual();
    bench.segment.set_cable(2, false);
    let message = bench.start().unwrap_err();
    assert!(message.starts_with("force sensor (position 2): look for devices: 2 devices answer"), "{message}");
}

#[test]
fn a_device_that_stays_in_safe_op_without_an_error_is_named() {
    let mut bench = Bench::usual();
    bench.segment.controller_mut(1).unwrap().set_stays_in_safe_op(true);
    let message = bench.start().unwrap_err();
    assert!(message.starts_with("right (position 1): ") && message.contains(": it is in SAFE-OP "), "{message}");
    let told = "after the request of OP, and reports no error; look whether output frames reach it and whether its own errors are gone";
    assert!(message.contains(told), "{message}");
}

#[test]
fn swapped_devices_are_told_by_where_the_right_one_is() {
    let devices = vec![controller(drive(1), 0), controller(sensor(), 0), controller(drive(2), 0)];
    assert_eq!(
        refused(&setup(), devices),
        "right (position 1): check its identity: the vendor is 0x732 and should be 0xffff5957: the device at position 2 fits, so look at \
         the order of the cables"
    );
    let mut of_serial = setup();
    of_serial.stations[0].serial = Some(1);
    of_serial.stations[1].serial = Some(2);
    let devices = vec![controller(drive(2), 0), controller(drive(1), 0), controller(sensor(), 0)];
    let message = refused(&of_serial, devices);
    assert!(message.contains("the serial number is 0x2 and should be 0x1: the device at position 1 fits"), "{message}");
}

#[test]
fn an_sii_is_used_as_far_as_it_is_whole() {
    for damage in [
        |image: &mut [u8]| image[14] ^= 1,
        |image: &mut [u8]| image[14..16].copy_from_slice(&[0xa4, 0x88]),
        // The first category is longer than the chip.
        |image: &mut [u8]| image[0x82..0x84].copy_from_slice(&[0xff, 0x7f]),
        // The head alone, and zeros behind it.
        |image: &mut [u8]| image[0x80..].fill(0),
        // The list of categories ends at once.
        |image: &mut [u8]| image[0x80..].fill(0xff),
    ] {
        let mut bench = Bench::usual();
        damage(bench.segment.controller_mut(1).unwrap().sii_mut());
        bench.start().unwrap();
    }
    for empty in [0, 0xff] {
        let mut bench = Bench::usual();
        bench.segment.controller_mut(1).unwrap().sii_mut().fill(empty);
        let message = bench.start().unwrap_err();
        let told = format!(
            "right (position 1): read its SII: its SII cannot be used: the chip is empty: all its bytes are {empty:02X}h: "
        );
        assert!(message.starts_with(&told), "{message}");
    }
}

#[test]
fn reserved_bits_of_al_status_and_a_counter_that_stands_still_are_no_obstacle() {
    let manner = |al_status_bits, mailbox_counter| Manner { al_status_bits, mailbox_counter, ..Manner::default() };
    for manner in [manner(0x0020, None), manner(0xff00, Some(0)), manner(0, Some(1)), manner(0, Some(7))] {
        let device = drive(2);
        let image = sii(device.od()).write();
        let odd = Controller::new(device, ControllerSettings { manner, ..ControllerSettings::new(image) });
        let mut bench = Bench::new(&setup(), vec![controller(drive(1), 0), odd, controller(sensor(), 0)]);
        bench.start().unwrap();
        bench.cycles(20, &REST);
        assert_eq!(bench.al(1), "OP", "{manner:?}");
    }
}

#[test]
fn a_memory_chip_that_tells_another_word_for_ever_is_given_up() {
    let mut bench = Bench::usual();
    bench.fate = Box::new(|_| Fate::IsOfAnotherWord);
    let message = bench.start().unwrap_err();
    assert!(message.starts_with("left (position 0): read its SII:"), "{message}");
    // One that does so for a while is read.
    let mut bench = Bench::usual();
    bench.fate = Box::new(|count| if count % 4 == 0 { Fate::IsOfAnotherWord } else { Fate::Passes });
    bench.start().unwrap();
}

#[test]
fn any_damage_of_sii_ends_with_a_message_or_in_op() {
    let mut random = numbers(7);
    let mut refused = 0;
    for _ in 0..60 {
        let mut bench = Bench::usual();
        let image = bench.segment.controller_mut(1).unwrap().sii_mut();
        for _ in 0..4 {
            let bit = random() as usize % (8 * 0x200);
            image[bit / 8] ^= 1 << (bit % 8);
        }
        refused += u32::from(bench.start().is_err());
    }
    // By what is written into its identity or its mailboxes.
    assert!((1..30).contains(&refused), "{refused} of 60 were refused");
}

#[test]
fn each_transition_that_is_refused_names_device_code_and_what_to_try() {
    // PRE-OP: the mailbox is not where the device wants it.
    let image = |change: fn(&mut yieldwall_fieldbus::ethercat::sii::Sii)| {
        let device = drive(2);
        let mut written = sii(device.od());
        change(&mut written);
        Controller::new(device, ControllerSettings::new(written.write()))
    };
    let with = |second| vec![controller(drive(1), 0), second, controller(sensor(), 0)];
    // Both mailboxes at one place.
    let message = refused(
        &setup(),
        with(image(|sii| {
            sii.send_mailbox.start = sii.receive_mailbox.start;
            sii.sync_managers[1].settings.start = sii.receive_mailbox.start;
        })),
    );
    assert_eq!(
        message,
        "right (position 1): go to PRE-OP: INIT+ERR to PRE-OP refused with 0017h sync manager configuration not valid (a sync manager lies \
         outside the memory or over another one); compare its SII with its ESI, words 0018h to 001Bh"
    );
    let message = refused(&setup(), with(image(|sii| sii.protocols = 0)));
    assert_eq!(
        message,
        "right (position 1): set up its mailbox: it has no mailbox with CoE (SII words 0018h to 001Ch), over which objects are read and written"
    );
    // SAFE-OP: the outputs of the SII lie over the mailbox.
    let message = refused(&setup(), with(image(|sii| sii.sync_managers[2].settings.start = 0x1010)));
    assert!(
        message.starts_with("right (position 1): go to SAFE-OP: PRE-OP+ERR to SAFE-OP refused with 0017h"),
        "{message}"
    );
    // A cycle that is too short for it.
    let short = Duration::from_micros(50);
    let mut fast = setup();
    (fast.period, fast.compute_at, fast.sync0_phase) = (short, Duration::ZERO, Duration::ZERO);
    let message = refused(&fast, devices());
    assert!(message.contains("go to SAFE-OP: PRE-OP+ERR to SAFE-OP refused with 0035h"), "{message}");
    assert!(message.ends_with("compare cycle.period_us with 1C32h:05 and the modes in its ESI"), "{message}");
    // OP: it has an error of its own.
    let mut bench = Bench::usual();
    bench.network.start(bench.now, &mut bench.outbox);
    bench.flush();
    while !matches!(bench.network.phase(), Phase::Starting | Phase::Failed(_)) {
        let until = bench.now + Duration::from_micros(50);
        bench.run_until(until);
    }
    let now = bench.now;
    bench.segment.controller_mut(2).unwrap().fail(now, AlStatusCode::NO_INPUTS);
    let until = bench.now + Duration::from_secs(1);
    bench.run_until(until);
    let Phase::Failed(error) = bench.network.phase() else { panic!("{:?}", bench.network.phase()) };
    assert_eq!(
        error.to_string(),
        "force sensor (position 2): go to OP: SAFE-OP+ERR to OP refused with 0018h no valid inputs (the device measures nothing valid: look \
         at its own error objects); look whether output frames reach it and whether its own errors are gone (1001h, 603Fh)"
    );
}

#[test]
fn a_device_without_a_clock_is_refused_where_outputs_act_at_sync0() {
    let device = drive(2);
    let image = sii(device.od()).write();
    let bare = Controller::new(device, ControllerSettings { has_dc: false, ..ControllerSettings::new(image) });
    let message = refused(&setup(), vec![controller(drive(1), 0), bare, controller(sensor(), 0)]);
    assert!(message.contains("right (position 1)") && message.contains("no distributed clock"), "{message}");
}

#[test]
fn a_mailbox_that_hangs_and_an_object_that_is_not_there_are_told() {
    let mut bench = Bench::usual();
    bench.segment.controller_mut(0).unwrap().set_mailbox_stuck(true);
    let message = bench.start().unwrap_err();
    assert_eq!(message, "left (position 0): check the device type: no answer from object 1000h:0");
    let mut other = setup();
    other.stations[2].inputs[0].entries[3].at = Address::new(0x6000, 5);
    let message = refused(&other, devices());
    assert!(message.starts_with("force sensor (position 2): map the process data: object 1A00h:4 is"), "{message}");
}

#[test]
fn a_plan_that_cannot_be_is_refused_at_once() {
    let mut twice = setup();
    twice.stations[1].position = 0;
    let message = EthercatNetwork::new(&twice).err().unwrap().to_string();
    assert_eq!(message, "right (position 0): plan the process data: position 0 is used twice");
    let mut long = setup();
    let entry = long.stations[2].inputs[0].entries[0];
    long.stations[2].inputs[0].entries = vec![entry; 255];
    let message = EthercatNetwork::new(&long).err().unwrap().to_string();
    assert!(message.ends_with("1A00h would map 255 objects, of which it can hold 254"), "{message}");
    long.stations[2].inputs[0].entries = vec![entry; 200];
    long.stations[2].inputs = vec![long.stations[2].inputs[0].clone(); 2];
    let message = EthercatNetwork::new(&long).err().unwrap().to_string();
    assert!(message.contains("the input frame of a cycle would have"), "{message}");
}

#[test]
fn registers_hold_what_was_written() {
    let mut bench = Bench::usual();
    bench.start().unwrap();
    let mut read = |ado, len: usize| bench.unseen(Command::Fprd, frame::address(0x1000, ado), &[0; 16][..len]);
    assert_eq!(read(register::WATCHDOG_SYNC_MANAGER, 2), [50, 0], "5 ms");
    assert_eq!(read(register::DC_SYNC0_CYCLE, 4), 1_000_000u32.to_le_bytes());
    assert_eq!(read(register::DC_ACTIVATION, 1), [3]);
    assert_eq!(read(0x0810, 5), [0x00, 0x18, 6, 0, 0x64]);
    assert_eq!(read(0x0818, 5), [0x00, 0x1c, 6, 0, 0x20]);
}

/// Some drives show their mode (6061h) only while they exchange process data.
#[test]
fn the_mode_in_force_is_looked_at_in_safe_op() {
    let mut bench = Bench::usual();
    bench.keeps = true;
    bench.start().unwrap();
    let has = |frame: &[u8], bytes: &[u8]| frame.windows(bytes.len()).any(|part| part == bytes);
    for station in [0x1000, 0x1001] {
        let is_of_station = |frame: &&Vec<u8>| u16_at(frame, 18) == station;
        let of = |is_wanted: &dyn Fn(&[u8]) -> bool| {
            let mut frames = bench.sent.iter().filter(|frame| frame[16] == Command::Fpwr as u8).filter(is_of_station);
            frames.position(|frame| is_wanted(frame)).unwrap()
        };
        let safe_op = of(&|frame| u16_at(frame, 20) == register::AL_CONTROL && frame[26] == 4);
        let mode = of(&|frame| has(frame, &[0x40, 0x61, 0x60, 0]));
        let limit = of(&|frame| has(frame, &[0x72, 0x60, 0]));
        assert!(limit < safe_op && safe_op < mode, "{station:04x}h: {limit} {safe_op} {mode}");
    }
}
