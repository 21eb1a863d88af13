use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc;

use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use proptest::prelude::*;

use super::fields::{Field, Visitor};
use super::scalar::Scalar;
use super::*;
use crate::{CycleRecord, DeviceRecord, Stages};
use yieldwall_drives::cia402;
use yieldwall_motion::cycle::DriveSample;
use yieldwall_motion::guard::{Cause, DeviceSet, Fault, State};

/// A folder of this test's own, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("yieldwall-recording-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn files(&self) -> Vec<String> {
        let names = std::fs::read_dir(&self.0).unwrap().map(|entry| entry.unwrap().file_name());
        let mut names: Vec<_> = names.map(|name| name.to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Gives every field a value made of the bits in turn.
struct Fill<'a>(std::iter::Cycle<std::slice::Iter<'a, u64>>);

impl Visitor for Fill<'_> {
    fn visit<S: Scalar>(&mut self, _: Field, value: &mut S) {
        let bits = *self.0.next().unwrap();
        let codes = S::codes();
        let bits = match S::TYPE {
            "bool" => bits & 1,
            _ if !codes.is_empty() => codes[bits as usize % codes.len()].1,
            _ => bits & (u64::MAX >> (64 - 8 * S::SIZE)),
        };
        *value = S::of_bits(bits).unwrap();
    }
}

fn any_record<T: Recorded + std::fmt::Debug>() -> impl Strategy<Value = T> {
    // Numbers that are not, with bits that have to stay, more often than chance has them.
    let bits = prop_oneof![
        4 => any::<u64>(),
        1 => any::<f64>().prop_map(f64::to_bits),
        1 => (0u64..1 << 52).prop_map(|payload| 0x7ff0_0000_0000_0000 | payload),
    ];
    proptest::collection::vec(bits, 97).prop_map(|bits| {
        let mut record = T::blank();
        record.walk(&mut Fill(bits.iter().cycle()));
        record
    })
}

fn about() -> About {
    About {
        version: "1.2.3".into(),
        commit: "0123456789ab-dirty".into(),
        target: "aarch64-unknown-linux-gnu".into(),
        machine: Machine::Rig("rig: {}".into()),
        scene: "hand: {}".into(),
        profiles: [("profile-1.yaml".to_owned(), "profile: {}".to_owned())].into(),
        seed: 7,
        overrides: String::new(),
        is_damaged: false,
    }
}

/// The cycles of one run at 1 ms, in state Running.
fn records(count: u64) -> Vec<CycleRecord> {
    let record = |index| {
        let mut record = CycleRecord::blank();
        record.moment.index = index;
        record.moment.sync_ns = 45_000_000 + index * 1_000_000;
        record.moment.compute_ns = record.moment.sync_ns + 620_000;
        record.moment.scene_time_s = index as f64 * 1e-3;
        record.signals.tool.0.x = (index as f64).sqrt();
        record.directive.state = State::Running;
        record
    };
    (0..count).map(record).collect()
}

fn file_of(records: &[CycleRecord]) -> Vec<u8> {
    let mut file = Vec::new();
    let mut writer = Writer::new(&mut file, &about()).unwrap();
    records.iter().for_each(|record| writer.write(record).unwrap());
    writer.finish().unwrap();
    drop(writer);
    file
}

fn read(file: &[u8]) -> Result<(Vec<CycleRecord>, Vec<Damage>), ReadError> {
    let mut reader = Reader::new(file)?;
    let mut records = Vec::new();
    while let Some(record) = reader.next_record()? {
        records.push(record);
    }
    Ok((records, reader.damage().to_vec()))
}

fn comes_back<T: Recorded>(record: &T) -> Result<(), TestCaseError> {
    let (mut bytes, mut again) = (Vec::new(), Vec::new());
    encode(record, &mut bytes);
    let decoded: T = decode(&bytes).unwrap();
    encode(&decoded, &mut again);
    prop_assert_eq!(&bytes, &again);
    prop_assert_eq!(difference(record, &decoded), None);
    prop_assert!(decode::<T>(&bytes[..bytes.len() - 1]).is_err());
    bytes.push(0);
    prop_assert!(decode::<T>(&bytes).is_err());
    Ok(())
}

/// Names and bits of the fields.
struct Named(Vec<(&'static str, u64)>);

impl Visitor for Named {
    fn visit<S: Scalar>(&mut self, field: Field, value: &mut S) {
        self.0.push((field.name, value.bits()));
    }
}

/// Two records behind an odd byte are read back field by field, each from where the layout has it.
fn is_where_the_layout_says<T: Recorded>(records: [T; 2]) -> Result<(), TestCaseError> {
    let layout = layout::<T>();
    let mut bytes = vec![0xff];
    records.iter().for_each(|record| pack(record, &mut bytes));
    prop_assert_eq!(bytes.len(), 1 + 2 * layout.stride);
    for (mut record, packed) in records.into_iter().zip(bytes[1..].chunks(layout.stride)) {
        let mut named = Named(Vec::new());
        record.walk(&mut named);
        let read = layout.fields.iter().map(|field| (field.name, field.bits(packed).unwrap()));
        prop_assert_eq!(read.collect::<Vec<_>>(), named.0);
        let (mut message, mut data) = (Vec::new(), 0);
        encode(&record, &mut message);
        layout.fields.iter().for_each(|field| data = field.offset + field.size);
        prop_assert_eq!(&message[4..], &packed[..data]);
    }
    Ok(())
}

proptest! {
    #[test]
    fn a_packed_record_has_its_fields_where_the_layout_says(
        cycles in any_record::<CycleRecord>().prop_map(|cycle| [cycle, CycleRecord::blank()]),
        one in any_record::<DeviceRecord>(),
        other in any_record::<DeviceRecord>(),
    ) {
        is_where_the_layout_says(cycles)?;
        is_where_the_layout_says([one, other])?;
    }

    #[test]
    fn a_record_comes_back_bit_by_bit(cycle in any_record::<CycleRecord>(), sample in any_record::<DeviceRecord>()) {
        comes_back(&cycle)?;
        comes_back(&sample)?;
    }

    #[test]
    fn a_difference_of_one_bit_is_found(record in any_record::<CycleRecord>(), place in any::<proptest::sample::Index>(), bit in 0..8u8) {
        let mut bytes = Vec::new();
        encode(&record, &mut bytes);
        *place.get_mut(&mut bytes[4..]) ^= 1 << bit;
        // The other record is another one unless the bit means nothing: padding, or a value whose flag is not set.
        if let Ok(other) = decode(&bytes) {
            let mut again = Vec::new();
            encode(&other, &mut again);
            prop_assert_eq!(difference(&record, &other).is_some(), { encode(&record, &mut bytes); again != bytes });
        }
    }

    #[test]
    fn bytes_that_are_no_record_are_refused(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
        let _ = decode::<CycleRecord>(&bytes);
        let _ = decode::<DeviceRecord>(&bytes);
    }

    #[test]
    fn a_cut_file_gives_a_prefix(count in 1u64..600, cut in any::<proptest::sample::Index>()) {
        let records = records(count);
        let file = file_of(&records);
        let cut = cut.index(file.len());
        match read(&file[..cut]) {
            Ok((kept, damage)) => {
                prop_assert_eq!(&kept[..], &records[..kept.len()]);
                prop_assert!(!damage.is_empty(), "{cut} of {} bytes were taken for a whole file", file.len());
            }
            Err(error) => prop_assert!(cut < 1000, "at {cut}: {error}"),
        }
    }

    #[test]
    fn a_damaged_file_gives_no_wrong_record_and_is_not_taken_for_whole(
        place in any::<proptest::sample::Index>(), is_near_an_end in any::<bool>(), mask in 1..=255u8
    ) {
        let records = records(600);
        let mut file = file_of(&records);
        let near = place.index(1600);
        let place = if is_near_an_end { if near < 800 { near } else { file.len() - 1600 + near } } else { place.index(file.len()) };
        file[place] ^= mask;
        if let Ok((kept, damage)) = read(&file) {
            prop_assert!(!damage.is_empty(), "byte {place} of {} by {mask:#04x}", file.len());
            for record in kept {
                prop_assert_eq!(Some(&record), records.get(record.moment.index as usize));
            }
        }
    }

    #[test]
    fn bytes_that_are_no_file_do_no_harm(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        let mut file = file_of(&records(1))[..700].to_vec();
        file.extend(bytes);
        let _ = read(&file);
    }
}

#[test]
fn a_changed_description_and_junk_behind_the_end_are_told_and_stay_told() {
    let file = file_of(&records(3));
    assert_eq!(read(&file).unwrap().1, []);
    let (_, damage) = read(&[&file[..], b"\n"].concat()).unwrap();
    assert_eq!(
        damage,
        [Damage { offset: file.len() as u64, what: "there is more behind the end of the recording".into() }]
    );
    let text = b"rig: {}";
    let at = file.windows(text.len()).position(|bytes| bytes == text).unwrap();
    let mut changed = file.clone();
    changed[at + 5] = b'[';
    let mut reader: Reader<_> = Reader::new(&changed[..]).unwrap();
    assert!(reader.about().is_damaged && reader.damage()[0].what.contains("description"), "{:?}", reader.damage());
    // A copy is not sound.
    let mut copy = Vec::new();
    let mut writer = Writer::new(&mut copy, reader.about()).unwrap();
    while let Some(record) = reader.next_record().unwrap() {
        writer.write(&record).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    let (kept, damage) = read(&copy).unwrap();
    assert_eq!((kept.len(), damage.len()), (3, 1), "{damage:?}");
}

#[test]
fn what_a_file_says_of_itself_does_nothing_to_a_terminal() {
    let error = ReadError::OtherFields { version: "1\u{1b}[2J".to_owned() };
    assert!(error.to_string().ends_with("version 1\\u{1b}[2J"), "{error}");
}

#[test]
fn a_message_has_these_bytes() {
    let mut record = CycleRecord::blank();
    record.moment.index = 0x0102;
    record.moment.sync_ns = 3;
    record.moment.compute_ns = 4;
    record.moment.scene_time_s = 0.5;
    record.moment.stages = Stages { sync_woke_ns: 5, woke_ns: 6, stepped_ns: 0x0708, sent_ns: 0x090a_0b0c };
    record.inputs.drives[0] = DriveSample {
        angle_rad: Some(-2.0),
        state: cia402::State::OperationEnabled,
        follows_command: true,
        has_voltage: true,
        has_warning: false,
    };
    let mut bytes = Vec::new();
    encode(&record, &mut bytes);
    #[rustfmt::skip]
    let begin = [
        0, 1, 0, 0,                    // CDR, little-endian
        2, 1, 0, 0, 0, 0, 0, 0,        // index
        3, 0, 0, 0, 0, 0, 0, 0,        // sync_ns
        4, 0, 0, 0, 0, 0, 0, 0,        // compute_ns
        0, 0, 0, 0, 0, 0, 0xe0, 0x3f,  // scene_time_s
        5, 0, 0, 0, 6, 0, 0, 0,        // sync_woke_ns, woke_ns
        8, 7, 0, 0, 0x0c, 0x0b, 0x0a, 9, // stepped_ns, sent_ns
        1, 0, 0, 0, 0, 0, 0, 0,        // left_has_angle, and the way to a multiple of 8
        0, 0, 0, 0, 0, 0, 0, 0xc0,     // left_angle_rad
        4, 1, 1, 0, 0, 0, 0, 0,        // left_state, _follows_command, _has_voltage, _has_warning, right_has_angle
        0, 0, 0, 0, 0, 0, 0, 0,        // right_angle_rad
    ];
    assert_eq!(bytes[..begin.len()], begin);
}

fn check_names<T: Recorded>() {
    let header = csv_header::<T>();
    let names: Vec<&str> = header.split(',').collect();
    for (at, name) in names.iter().enumerate() {
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
        assert!(name.starts_with(|c: char| c.is_ascii_lowercase()) && name.chars().all(plain), "{name}");
        assert!(!name.contains("__") && !name.ends_with('_'), "{name}");
        assert!(!names[..at].contains(name), "{name} twice");
    }
    let mut row = String::new();
    csv_row(&T::blank(), &mut row);
    assert_eq!(row.split(',').count(), names.len());
    assert_eq!(definition::<T>().lines().filter(|line| line.contains("  # ")).count(), names.len());
}

#[test]
fn names_are_those_that_a_message_definition_may_have() {
    check_names::<CycleRecord>();
    check_names::<DeviceRecord>();
}

#[test]
fn the_document_lists_the_fields() {
    let document = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/recording.md");
    let text = std::fs::read_to_string(document).unwrap();
    for table in [table::<CycleRecord>(), table::<DeviceRecord>()] {
        assert!(text.contains(&table), "docs/recording.md lists other fields; it should have\n{table}");
    }
}

#[test]
fn the_same_cycles_give_the_same_file_and_come_back() {
    let records = records(1000);
    let file = file_of(&records);
    assert_eq!(file, file_of(&records));
    let mut reader: Reader<_> = Reader::new(&file[..]).unwrap();
    assert_eq!(reader.about(), &about());
    let (kept, damage) = read(&file).unwrap();
    assert_eq!((kept, damage), (records, Vec::new()));
    assert!(reader.next_record().unwrap().is_some());
}

#[test]
fn a_damaged_chunk_is_left_out_and_the_next_ones_are_read() {
    let records = records(1000);
    let mut file = file_of(&records);
    let middle = file.len() / 2;
    file[middle] ^= 1;
    let (kept, damage) = read(&file).unwrap();
    assert_eq!(damage.len(), 1, "{damage:?}");
    assert!(damage[0].what.contains("sum"), "{damage:?}");
    assert!(kept.len() >= 700 && kept.len() < 1000, "{}", kept.len());
    assert!(kept.iter().all(|record| records[record.moment.index as usize] == *record));
}

#[test]
fn lengths_are_not_believed() {
    let whole = file_of(&records(1));
    let mut chunk = whole[..700].to_vec();
    // Where the first chunk begins, a record of all the bytes that there could be.
    let metadata = 8 + 9 + u64::from_le_bytes(whole[9..17].try_into().unwrap()) as usize;
    let at = metadata + 9 + u64::from_le_bytes(whole[metadata + 1..metadata + 9].try_into().unwrap()) as usize;
    for (opcode, length) in [(6, u64::MAX), (6, 65 << 20), (5, 5 << 20), (0x0c, u64::MAX), (0x77, u64::MAX)] {
        chunk.truncate(at);
        chunk.push(opcode);
        chunk.extend(length.to_le_bytes());
        chunk.extend([0; 64]);
        let (kept, damage) = read(&chunk).unwrap();
        assert_eq!((kept.len(), damage.len()), (0, 1), "{opcode} {length}");
        assert_eq!(damage[0].offset as usize, at);
    }
}

#[test]
fn other_fields_are_refused() {
    let mut file = file_of(&records(3));
    let place = file.windows(9).position(|bytes| bytes == b"# One con").unwrap();
    file[place + 3] = b'o';
    // The sum of the chunk no longer fits; an unknown schema in a whole chunk is what another version writes.
    let (kept, damage) = read(&file).unwrap();
    assert_eq!((kept.len(), damage.len()), (0, 1));
    let cut = &file[..place + definition::<CycleRecord>().len() + 10];
    assert!(matches!(read(cut), Err(ReadError::OtherFields { version }) if version == "1.2.3"));
}

#[test]
fn other_files_are_refused() {
    assert!(matches!(read(b""), Err(ReadError::NotMcap)));
    assert!(matches!(read(b"rig:\n  name: paper"), Err(ReadError::NotMcap)));
    assert!(matches!(read(mcap::MAGIC), Err(ReadError::NoDescription(Some(_)))));
}

/// Takes items only on request.
struct Gate {
    open: mpsc::Receiver<()>,
    taken: Vec<u32>,
}

impl Sink<u32> for Gate {
    type Report = Vec<u32>;

    fn take(&mut self, item: &u32) -> io::Result<()> {
        // A sender that is gone leaves the gate open.
        let _ = self.open.recv();
        self.taken.push(*item);
        Ok(())
    }

    fn finish(&mut self) -> io::Result<()> {
        Ok(())
    }

    fn stored(&self) -> u64 {
        self.taken.len() as u64
    }

    fn report(self) -> Vec<u32> {
        self.taken
    }
}

#[test]
fn a_full_ring_drops_and_counts() {
    let (open, gate) = mpsc::channel();
    let sink = Gate { open: gate, taken: Vec::new() };
    let (mut producer, feed) = Feed::start("test", 4, Backpressure::Drop, sink).unwrap();
    (0..20).for_each(|item| producer.push(&item));
    drop(open);
    let end = feed.finish().unwrap();
    // Four in the ring, and at most one that the thread had taken out before it waited.
    assert!((4..=5).contains(&end.counts.kept), "{:?}", end.counts);
    assert_eq!(end.counts.kept + end.counts.dropped, 20);
    assert_eq!(end.report, (0..end.counts.kept as u32).collect::<Vec<_>>());
}

#[test]
fn a_slow_thread_is_waited_for() {
    let (open, gate) = mpsc::channel();
    let (mut producer, feed) =
        Feed::start("test", 4, Backpressure::Wait, Gate { open: gate, taken: Vec::new() }).unwrap();
    let opener = std::thread::spawn(move || (0..50).for_each(|_| open.send(()).unwrap()));
    (0..50).for_each(|item| producer.push(&item));
    opener.join().unwrap();
    let end = feed.finish().unwrap();
    assert_eq!((end.counts, end.report), (Counts { kept: 50, ..Counts::default() }, (0..50).collect()));
}

#[test]
fn a_thread_that_stands_still_is_not_waited_for_twice() {
    let (open, gate) = mpsc::channel();
    let (mut producer, feed) =
        Feed::start("test", 4, Backpressure::Wait, Gate { open: gate, taken: Vec::new() }).unwrap();
    // Waits once, and not for each of the many that follow: this would take a day.
    (0..100_000).for_each(|item| producer.push(&item));
    drop(open);
    let counts = feed.finish().unwrap().counts;
    assert!(counts.kept <= 5 && counts.lost() == 100_000 - counts.kept, "{counts:?}");
}

/// A disk with so many bytes left.
struct Full(usize);

impl Write for Full {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.0 == 0 {
            return Err(io::ErrorKind::StorageFull.into());
        }
        let count = bytes.len().min(self.0);
        self.0 -= count;
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_full_disk_is_told_with_what_was_lost() {
    let records = records(2000);
    let whole = file_of(&records).len();
    let write = |_| {
        let recorder = Recorder::new(Full(whole / 2), Full(usize::MAX), &about()).unwrap();
        let (mut producer, feed) = Feed::start("test", 64, Backpressure::Wait, recorder).unwrap();
        records.iter().for_each(|record| producer.push(record));
        feed.finish().unwrap()
    };
    // A writing thread that gets no core for a second is not waited for.
    let end = (0..10).map(write).find(|end| end.counts.dropped == 0).unwrap();
    assert_eq!(end.error.unwrap().kind(), io::ErrorKind::StorageFull);
    assert_eq!(end.counts.kept + end.counts.refused, 2000);
    // Half of the file holds a little less than half of the cycles, in whole chunks.
    assert!((500..1000).contains(&end.counts.kept), "{:?}", end.counts);
}

#[test]
#[cfg(target_os = "linux")]
fn a_device_that_is_full_is_a_full_disk() {
    let folder = Folder::new();
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let mcap = std::fs::File::create(folder.0.join("cycles.mcap")).unwrap();
    let (mut producer, feed) =
        Feed::start("test", 64, Backpressure::Wait, Recorder::new(mcap, full, &about()).unwrap()).unwrap();
    records(2000).iter().for_each(|record| producer.push(record));
    let end = feed.finish().unwrap();
    assert_eq!(end.error.unwrap().kind(), io::ErrorKind::StorageFull);
    // The other file is whole, and has what is said to be kept.
    let mut reader: Reader<_> = Reader::open(&folder.0.join("cycles.mcap")).unwrap();
    let mut kept = 0;
    while reader.next_record().unwrap().is_some() {
        kept += 1;
    }
    assert_eq!((kept, reader.damage()), (end.counts.kept, &[][..]));
    assert_eq!(end.counts.kept + end.counts.refused, 2000);
}

/// Returns the files that a black box saves for 20 s of a rig at 1 ms whose state follows `state`.
fn black_box(folder: &Folder, name: &str, state: impl Fn(u64) -> Option<State>) -> Vec<Saved> {
    let mut sink = BlackBox::new(Some(folder.0.clone()), name, 1e-3, about());
    for mut record in records(20_000) {
        if let Some(state) = state(record.moment.index) {
            record.directive.state = state;
            record.cause = Some(Cause { fault: Fault::SensorStuck, devices: DeviceSet::SENSOR });
        }
        sink.take(&record).unwrap();
    }
    sink.finish().unwrap();
    sink.report()
}

fn span(saved: &Saved) -> (u64, u64) {
    let mut reader: Reader<_> = Reader::open(saved.file.as_ref().unwrap()).unwrap();
    let first = reader.next_record().unwrap().unwrap().moment.index;
    let mut last = first;
    while let Some(record) = reader.next_record().unwrap() {
        assert_eq!(record.moment.index, last + 1);
        last = record.moment.index;
    }
    assert!(reader.damage().is_empty());
    (first, last)
}

#[test]
fn the_black_box_has_two_seconds_before_and_after_each_fault() {
    let folder = Folder::new();
    // Held, held again within the time after it, stopped much later.
    let saved = black_box(&folder, "lab/../rig 2", |index| match index {
        5000..5100 | 6000..6100 => Some(State::Holding),
        15_000.. => Some(State::Stopped),
        _ => None,
    });
    assert_eq!(saved.iter().map(span).collect::<Vec<_>>(), [(3000, 6999), (13_000, 16_999)]);
    assert_eq!(saved.iter().map(|saved| saved.state).collect::<Vec<_>>(), [State::Holding, State::Stopped]);
    assert_eq!(saved[0].cause.fault, Fault::SensorStuck);
    let names = ["lab----rig-2-000001.black-box.mcap", "lab----rig-2-000002.black-box.mcap"];
    assert_eq!(folder.files(), names);
}

#[test]
fn a_hold_that_becomes_a_stop_later_is_another_fault() {
    let folder = Folder::new();
    let saved = black_box(&folder, "rig", |index| match index {
        0..100 => None,
        100..9000 => Some(State::Holding),
        _ => Some(State::Disabled),
    });
    assert_eq!(saved.iter().map(span).collect::<Vec<_>>(), [(0, 2099), (7000, 10_999)]);
}

#[test]
fn only_the_newest_black_boxes_stay() {
    let folder = Folder::new();
    std::fs::write(folder.0.join("notes-000000.txt"), "mine").unwrap();
    std::fs::write(folder.0.join("rig-000007.black-box.mcap"), "old").unwrap();
    for _ in 0..12 {
        // A fault at the begin and one in the middle.
        black_box(&folder, "rig", |index| (index % 10_000 < 10).then_some(State::Holding));
    }
    let files = folder.files();
    assert_eq!(files.len(), 21, "{files:?}");
    assert_eq!((files[0].as_str(), files[1].as_str()), ("notes-000000.txt", "rig-000012.black-box.mcap"));
    assert_eq!(files[20], "rig-000031.black-box.mcap");
}

#[test]
#[cfg(unix)]
fn the_black_box_follows_no_link() {
    let (folder, target) = (Folder::new(), Folder::new());
    let link = folder.0.join("link");
    std::os::unix::fs::symlink(&target.0, &link).unwrap();
    let mut sink = BlackBox::new(Some(link), "rig", 1e-3, about());
    for mut record in records(10) {
        record.directive.state = State::Lost;
        record.cause = Some(Cause { fault: Fault::BusOff, devices: DeviceSet::HOST });
        sink.take(&record).unwrap();
    }
    sink.finish().unwrap();
    let saved = sink.report();
    assert!(saved[0].file.as_ref().unwrap_err().to_string().contains("link"), "{saved:?}");
    assert!(target.files().is_empty());
}

#[test]
fn a_stop_that_was_asked_for_is_no_fault() {
    let folder = Folder::new();
    let mut sink = BlackBox::new(Some(folder.0.clone()), "rig", 1e-3, about());
    for mut record in records(10) {
        record.directive.state = State::Stopped;
        record.cause = Some(Cause { fault: Fault::StopRequested, devices: DeviceSet::NONE });
        sink.take(&record).unwrap();
    }
    sink.finish().unwrap();
    assert!(sink.report().is_empty() && folder.files().is_empty());
}

#[test]
fn cycles_that_come_before_any_description_are_refused_and_not_gathered() {
    let mut file = Vec::new();
    let mut writer = mcap::WriteOptions::new().disable_seeking(true).create(NoSeek::new(&mut file)).unwrap();
    let schema = writer.add_schema(CycleRecord::SCHEMA, "ros2msg", definition::<CycleRecord>().as_bytes()).unwrap();
    let channel_id = writer.add_channel(schema, CycleRecord::TOPIC, "cdr", &BTreeMap::new()).unwrap();
    let mut message = Vec::new();
    for (sequence, record) in (0..).zip(records(3)) {
        encode(&record, &mut message);
        let header = MessageHeader { channel_id, sequence, log_time: 0, publish_time: 0 };
        writer.write_to_known_channel(&header, &message).unwrap();
        writer.flush().unwrap();
    }
    writer.write_metadata(&about().metadata()).unwrap();
    writer.finish().unwrap();
    drop(writer);
    let refused = Reader::<_, CycleRecord>::new(&file[..]).map(|_| ());
    assert!(matches!(refused, Err(ReadError::NoDescription(_))), "{refused:?}");
}
