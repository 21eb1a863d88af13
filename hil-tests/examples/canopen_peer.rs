//! This project's CANopen engines against a foreign stack, without a CAN interface: frames are lines on stdin and stdout.
//!
//! A line is `ID#DATA` in hexadecimal as candump writes it, `ID#R1` for a remote frame. Time is that of the machine.
//!
//! ```text
//! canopen_peer device                    node 5 with a domain 2001h:0 of up to 1 MiB, which can be stored (1010h)
//! canopen_peer bare-device               the same without a node id: waits for LSS
//! canopen_peer read 2001 0 [block]       reads an object of node 5, prints `= DATA` and ends
//! canopen_peer write 2001 0 HEX [block]  writes it, prints `= ok` and ends
//! ```

use std::io::{BufRead, Write};
use std::process::ExitCode;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use yieldwall::canopen::{
    CanopenError, DataType, DeviceIdentity, Frame, Node, Object, ObjectDictionary, SdoClient, SdoOutcome, Time, node_id,
};

const NODE: u8 = 5;
const DOMAIN: usize = 1 << 20;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let done = match words.as_slice() {
        ["device"] => device(false),
        ["bare-device"] => device(true),
        ["read", index, sub, options @ ..] => transfer(index, sub, None, options),
        ["write", index, sub, data, options @ ..] => transfer(index, sub, Some(data), options),
        _ => Err("device | bare-device | read INDEX SUB [block] | write INDEX SUB HEX [block]".into()),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

/// The two ends of the line protocol, and the clock.
struct Line {
    frames: Receiver<Frame>,
    start: Instant,
}

impl Line {
    fn open() -> Self {
        let (sender, frames) = channel();
        std::thread::spawn(move || {
            for line in std::io::stdin().lock().lines().map_while(Result::ok) {
                if let Some(frame) = parse(&line)
                    && sender.send(frame).is_err()
                {
                    break;
                }
            }
        });
        Line { frames, start: Instant::now() }
    }

    fn now(&self) -> Time {
        Time(self.start.elapsed().as_nanos() as u64)
    }

    /// The next frame, or nothing at `deadline`; an error when the other side has gone.
    fn wait(&self, deadline: Time) -> Result<Option<Frame>, RecvTimeoutError> {
        match self.frames.recv_timeout(deadline.since(self.now()).min(Duration::from_secs(3600))) {
            Ok(frame) => Ok(Some(frame)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(gone) => Err(gone),
        }
    }
}

fn send(frames: &mut Vec<Frame>) -> Result<(), String> {
    let mut out = std::io::stdout().lock();
    for frame in frames.drain(..) {
        let text = if frame.is_remote() { format!("R{}", frame.length_code()) } else { hex(frame.data()) };
        writeln!(out, "{:03X}#{text}", frame.id()).map_err(|error| error.to_string())?;
    }
    out.flush().map_err(|error| error.to_string())
}

fn hex(data: &[u8]) -> String {
    data.iter().map(|byte| format!("{byte:02X}")).collect()
}

fn unhex(text: &str) -> Option<Vec<u8>> {
    let digits: Option<Vec<u8>> = text.chars().map(|digit| digit.to_digit(16).map(|value| value as u8)).collect();
    let digits = digits.filter(|digits| digits.len().is_multiple_of(2))?;
    Some(digits.chunks(2).map(|pair| pair[0] << 4 | pair[1]).collect())
}

fn parse(line: &str) -> Option<Frame> {
    let (id, rest) = line.trim().split_once('#')?;
    let id = u16::from_str_radix(id, 16).ok()?;
    match rest.strip_prefix('R') {
        Some(len) => Some(Frame::remote(id, len.parse().unwrap_or(0))),
        None => unhex(rest).map(|data| Frame::new(id, &data)),
    }
}

fn device(is_bare: bool) -> Result<(), String> {
    let mut node = build(is_bare).map_err(|error| error.to_string())?;
    let line = Line::open();
    let mut out = Vec::new();
    node.boot(line.now(), &mut (), &mut out);
    loop {
        send(&mut out)?;
        let Ok(frame) = line.wait(node.next_deadline()) else { return Ok(()) };
        match frame {
            Some(frame) => node.on_frame(line.now(), &frame, &mut (), &mut out),
            None => node.poll(line.now(), &mut (), &mut out),
        }
    }
}

fn build(is_bare: bool) -> Result<Node, CanopenError> {
    let id = node_id(NODE)?;
    let identity = DeviceIdentity {
        device_type: 0x0002_0192,
        name: "a peer for other stacks".into(),
        vendor_id: 0x0102_0304,
        product_code: 0x8000_0001,
        revision: 1,
        serial: 0xffff_fffe,
    };
    let od = ObjectDictionary::builder()
        .communication_profile(id, &identity)
        .object(Object::new(0x2000, 0, 0u32))
        .object(Object::bytes(0x2001, 0, DataType::Domain, &[], DOMAIN))
        .build()?;
    let mut node = Node::new(id, od)?;
    if is_bare {
        node.forget_node_id();
    }
    Ok(node)
}

fn transfer(index: &str, sub: &str, data: Option<&str>, options: &[&str]) -> Result<(), String> {
    let index = u16::from_str_radix(index, 16).map_err(|error| error.to_string())?;
    let sub = sub.parse().map_err(|error| format!("{sub}: {error}"))?;
    let is_block = options == ["block"];
    let id = node_id(NODE).map_err(|error| error.to_string())?;
    let mut client = SdoClient::new(id, Duration::from_secs(1), SdoClient::DEFAULT_CAPACITY);
    let line = Line::open();
    let mut out = Vec::new();
    let now = line.now();
    let started = match data {
        Some(text) => {
            let data = unhex(text).ok_or("the data are not hexadecimal")?;
            if is_block {
                client.start_block_download(now, index, sub, &data, &mut out)
            } else {
                client.start_download(now, index, sub, &data, &mut out)
            }
        }
        None if is_block => client.start_block_upload(now, index, sub, &mut out),
        None => client.start_upload(now, index, sub, &mut out),
    };
    started.map_err(|error| error.to_string())?;
    loop {
        send(&mut out)?;
        let frame = line.wait(client.next_deadline()).map_err(|error| error.to_string())?;
        let outcome = match frame {
            Some(frame) => client.on_frame(line.now(), &frame, &mut out),
            None => client.poll(line.now(), &mut out),
        };
        let Some(outcome) = outcome else { continue };
        send(&mut out)?;
        return match outcome {
            SdoOutcome::Uploaded { .. } => say(&hex(client.data())),
            SdoOutcome::Downloaded { .. } => say("ok"),
            SdoOutcome::Aborted { code, .. } => Err(code.to_string()),
            SdoOutcome::TimedOut { may_be_written, .. } => Err(format!("no answer; may be written: {may_be_written}")),
        };
    }
}

fn say(result: &str) -> Result<(), String> {
    writeln!(std::io::stdout(), "= {result}").map_err(|error| error.to_string())
}
