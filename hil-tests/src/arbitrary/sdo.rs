//! The SDO client while a device, or somebody in its place, answers anything.

use std::time::Duration;

use yieldwall::canopen::{Frame, Outbox, SdoClient, SdoOutcome, cob, node_id};
use yieldwall::time::Time;

use super::bytes::{Bytes, Script};

const NODE: u8 = 5;
const TIMEOUT: Duration = Duration::from_millis(250);

/// What the client sent, and how much of it in the present transfer.
#[derive(Default)]
struct Sent {
    frames: usize,
}

impl Outbox for Sent {
    fn push(&mut self, frame: Frame) {
        assert_eq!((frame.id(), frame.len()), (0x600 + u16::from(NODE), 8), "{frame:x?}");
        assert!(matches!(frame.bytes()[0] >> 5, 0..=4), "{frame:x?}");
        self.frames += 1;
    }
}

/// An SDO client with a request under way: a transfer ends, after a bounded number of frames and within its time, and
/// holds no more than its capacity, whatever is answered.
///
/// # Panics
/// If a law is broken.
pub fn sdo_client(bytes: &[u8]) {
    let mut bytes = Bytes::new(bytes);
    let capacity = usize::from(bytes.u8());
    let mut client = SdoClient::new(node_id(NODE).expect("a node id"), TIMEOUT, capacity);
    let capacity = capacity.max(4);
    let (mut now, mut sent, mut written) = (Time::default(), Sent::default(), None);
    while !bytes.is_empty() {
        if !client.is_busy() {
            assert_eq!(client.next_deadline(), Time::NEVER);
            sent.frames = 0;
            let (index, sub) = (bytes.u16(), bytes.u8());
            written = bytes.bool().then(|| bytes.slice());
            let started = match written {
                Some(data) => client.start_download(now, index, sub, data, &mut sent),
                None => client.start_upload(now, index, sub, &mut sent),
            };
            assert_eq!(started.is_ok(), written.is_none_or(|data| data.len() <= capacity));
            assert_eq!((client.is_busy(), sent.frames), (started.is_ok(), usize::from(started.is_ok())));
            continue;
        }
        let before = sent.frames;
        let outcome = match bytes.u8() % 8 {
            0 => {
                now = now + bytes.wait();
                client.poll(now, &mut sent)
            }
            1 => {
                assert!(client.start_upload(now, 0x1000, 0, &mut sent).is_err(), "one transfer at a time");
                None
            }
            2 if bytes.u8() < 16 => {
                client.cancel(&mut sent);
                assert!(!client.is_busy());
                continue;
            }
            _ => client.on_frame(now, &bytes.frame(&[cob::sdo_response(client.node())]), &mut sent),
        };
        // A read that is begun anew is given up first.
        assert!(sent.frames - before <= 2);
        // Every segment that goes on carries something: at worst one byte of an upload each. A read is begun three times
        // at most.
        assert!(sent.frames <= 3 * (capacity + 3), "{} frames for {capacity} bytes", sent.frames);
        assert_eq!(outcome.is_some(), !client.is_busy());
        assert!(!client.is_busy() || client.next_deadline() > now, "it waits for what is over");
        assert!(client.data().len() <= capacity);
        assert!(written.is_none_or(|data| data == client.data()), "what is written stays as it is");
        if let Some(SdoOutcome::Uploaded { len, is_size_indicated, .. }) = outcome {
            assert_eq!(len, client.data().len());
            assert_eq!(client.value::<u64>().is_some(), len == 8 && is_size_indicated);
            assert_eq!(client.value::<u16>().is_some(), len == 2 || !is_size_indicated);
        }
    }
}

pub(super) fn transfers() -> Vec<Vec<u8>> {
    let start = |index: u16| Script::new().raw(&[64]).raw(&index.to_le_bytes()).raw(&[0]);
    let answers = |script: Script, payloads: &[[u8; 8]]| {
        payloads
            .iter()
            .fold(script, |script, payload| script.raw(&[7]).frame(0x580 + u16::from(NODE), payload))
            .finish()
    };
    vec![
        answers(start(0x1000).raw(&[0]), &[[0x43, 0, 0x10, 0, 0x92, 1, 2, 0]]),
        answers(
            start(0x1008).raw(&[0]),
            &[[0x41, 8, 0x10, 0, 10, 0, 0, 0], [0x00, 1, 2, 3, 4, 5, 6, 7], [0x19, 8, 9, 10, 0, 0, 0, 0]],
        ),
        answers(
            start(0x2004).raw(&[1, 9, 1, 2, 3, 4, 5, 6, 7, 8, 9]),
            &[[0x60, 4, 0x20, 0, 0, 0, 0, 0], [0x20, 0, 0, 0, 0, 0, 0, 0], [0x30, 0, 0, 0, 0, 0, 0, 0]],
        ),
        answers(start(0x1000).raw(&[0]), &[[0x80, 0, 0x10, 0, 0, 0, 2, 6]]),
    ]
}
