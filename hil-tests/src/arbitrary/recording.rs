//! The reader of recordings.

use std::io::{self, Write};
use std::sync::{Arc, LazyLock, Mutex};

use yieldwall::config::{self, builtin};
use yieldwall::guard::Request;
use yieldwall::record::CycleRecord;
use yieldwall::record::recording::{
    About, Machine, ReadError, Reader, Writer, csv_header, csv_row, decode, difference, encode,
};
use yieldwall::rig::EmbeddedRig;

/// Most places of damage that are told.
const MOST_TOLD: usize = 16;

/// Some cycles of a rig that is enabled.
static CYCLES: LazyLock<Vec<CycleRecord>> = LazyLock::new(|| {
    let source = builtin("paper-admittance.yaml");
    let rig = config::load_rig(source).expect("a shipped rig");
    let scene = rig.scene().expect("a shipped scene").value;
    let rig = rig.value;
    let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, 1).expect("a rig that can be built");
    machine.enable().expect("a rig that can be enabled");
    let records = Arc::new(Mutex::new(Vec::new()));
    let kept = Arc::clone(&records);
    machine.set_observer(Box::new(move |record| kept.lock().expect("one thread").push(*record)));
    for _ in 0..3 {
        machine.run_cycle(Request::None).expect("it goes on");
    }
    std::mem::take(&mut records.lock().expect("one thread"))
});

/// The begin of a recording: what it says of itself, and one cycle.
static BEGIN: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let file = Shared::default();
    let mut writer = Writer::new(file.clone(), &about()).expect("memory can be written");
    writer.write(&CYCLES[0]).expect("memory can be written");
    writer.flush().expect("memory can be written");
    // When it is dropped it writes what belongs at the end.
    file.taken()
});

/// Memory that can be looked at while it is written.
#[derive(Clone, Default)]
struct Shared(Arc<Mutex<Vec<u8>>>);

impl Shared {
    fn taken(&self) -> Vec<u8> {
        std::mem::take(&mut self.0.lock().expect("one thread"))
    }
}

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().expect("one thread").write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn about() -> About {
    About {
        version: "0.1.0".into(),
        machine: Machine::Rig("rig".into()),
        scene: "scene".into(),
        seed: 1,
        ..About::default()
    }
}

/// A file, or what follows a good begin of one: it is refused, or gives no more cycles than its bytes hold, each of which
/// can be written again; what is told of its damage is fit for a terminal.
///
/// # Panics
/// If a law is broken.
pub fn recording(bytes: &[u8]) {
    let (kind, rest) = bytes.split_first().unwrap_or((&0, &[]));
    let file = if kind & 1 == 0 { rest.to_vec() } else { [&BEGIN[..], rest].concat() };
    if let Ok(record) = decode(rest) {
        check(&record);
    }
    let mut reader = match Reader::new(&file[..]) {
        Ok(reader) => reader,
        Err(error) => return assert_is_plain(&error.to_string()),
    };
    let (mut size, mut count) = (0, 0);
    loop {
        match reader.next_record() {
            Ok(Some(record)) => size = check(&record),
            Ok(None) => break,
            // Cycles with other fields may follow those that are read.
            Err(error @ ReadError::OtherFields { .. }) => return assert_is_plain(&error.to_string()),
            Err(error) => panic!("memory can be read: {error}"),
        }
        count += 1;
    }
    assert!(count * size <= file.len(), "{count} records of {size} bytes in a file of {}", file.len());
    let told = reader.damage();
    assert!(told.len() <= MOST_TOLD && told.len() as u64 <= reader.damage_count());
    for damage in told {
        assert!(damage.offset <= file.len() as u64);
        assert_is_plain(&damage.to_string());
    }
}

/// Its size in bytes.
fn check(record: &CycleRecord) -> usize {
    let (mut bytes, mut row) = (Vec::new(), String::new());
    encode(record, &mut bytes);
    let again = decode(&bytes).expect("a record that was written");
    assert!(difference(record, &again).is_none(), "{:?}", difference(record, &again));
    csv_row(record, &mut row);
    let columns = |line: &str| line.trim_end().split(',').count();
    assert_eq!((columns(&row), row.trim_end().lines().count()), (columns(&csv_header::<CycleRecord>()), 1), "{row}");
    bytes.len()
}

fn assert_is_plain(text: &str) {
    assert!(!text.is_empty() && !text.chars().any(char::is_control), "{text:?}");
}

pub(super) fn recordings() -> Vec<Vec<u8>> {
    let mut file = vec![0];
    let mut writer = Writer::new(&mut file, &about()).expect("memory can be written");
    CYCLES.iter().for_each(|cycle| writer.write(cycle).expect("memory can be written"));
    writer.finish().expect("memory can be written");
    drop(writer);
    // The same cycles as messages outside of chunks, whose sums refuse what was altered.
    let mut messages = vec![1];
    for cycle in CYCLES.iter() {
        let mut data = Vec::new();
        encode(cycle, &mut data);
        messages.push(0x05);
        messages.extend((22 + data.len() as u64).to_le_bytes());
        // Channel 1, the only one; number and times do not matter.
        messages.extend([1, 0]);
        messages.extend([0; 20]);
        messages.extend(data);
    }
    vec![file, messages]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recordings_hold_their_cycles() {
        for (seed, begin) in recordings().iter().zip([&[][..], &BEGIN]) {
            let file = [begin, &seed[1..]].concat();
            let mut reader: Reader<_> = Reader::new(&file[..]).expect("a recording");
            for number in 0..3 {
                let record = reader.next_record().expect("memory can be read");
                assert!(record.is_some(), "{number}: {:?}", reader.damage());
            }
        }
    }
}
