//! This project's CANopen engines for a foreign stack to talk to, on the interface that `YIELDWALL_CAN` names, else vcan0.
//!
//! ```text
//! canopen_peer device                    node 5 with a domain 2001h:0 of up to 1 MiB, which can be stored (1010h)
//! canopen_peer bare-device               the same without a node id: waits for LSS
//! canopen_peer read 2001 0 [block]       reads an object of node 5, prints `= DATA` and ends
//! canopen_peer write 2001 0 HEX [block]  writes it, prints `= ok` and ends
//! canopen_peer speed N BYTES ROUNDS BLOCK
//!                                        reads 2000h:0 of node 5 N times; writes BYTES bytes to 2001h:0 and reads them
//!                                        ROUNDS times in segments; writes BLOCK bytes there in blocks and reads them in
//!                                        blocks, unless BLOCK is 0. Prints
//!                                        `= READS_PER_S BYTES_PER_S [READ_PER_S WRITTEN_PER_S]` and ends
//! ```
//!
//! A device prints `= ready` when it is on the bus, and is there until it is killed.

use std::process::ExitCode;

#[cfg(target_os = "linux")]
mod peer {
    use std::time::Instant;

    use hil_tests::network::{Network, Participant, Real, bare, client, device, transfer};
    use yieldwall::canopen::{SdoClient, SdoOutcome};
    use yieldwall::link::SocketCan;

    const NODE: u8 = 5;

    pub(super) fn run(words: &[&str]) -> Result<(), String> {
        match words {
            ["device"] => serve(device(NODE)),
            ["bare-device"] => serve(bare()),
            ["read", index, sub, options @ ..] => pass(index, sub, None, options).map(|data| say(&hex(&data))),
            ["write", index, sub, data, options @ ..] => pass(index, sub, Some(data), options).map(|_| say("ok")),
            ["speed", reads, bytes, rounds, block] => {
                speed(number(reads)?, number(bytes)?, number(rounds)?, number(block)?)
            }
            _ => Err("device | bare-device | read INDEX SUB [block] | write INDEX SUB HEX [block] | \
                      speed N BYTES ROUNDS BLOCK"
                .into()),
        }
    }

    fn serve(device: impl Participant + 'static) -> Result<(), String> {
        let mut bus = Real::new();
        bus.attach(device);
        say("ready");
        loop {
            std::thread::park();
        }
    }

    fn pass(index: &str, sub: &str, data: Option<&str>, options: &[&str]) -> Result<Vec<u8>, String> {
        let index = u16::from_str_radix(index, 16).map_err(|error| format!("{index}: {error}"))?;
        let sub = number(sub)? as u8;
        let data = data.map(|text| unhex(text).ok_or("the data are not hexadecimal")).transpose()?;
        let mut link = Real::new().client(NODE);
        let mut client = client(NODE);
        let is_block = options == ["block"];
        let outcome = transfer(&mut link, &mut client, |client, now, out| {
            match (&data, is_block) {
                (Some(data), true) => client.start_block_download(now, index, sub, data, out),
                (Some(data), false) => client.start_download(now, index, sub, data, out),
                (None, true) => client.start_block_upload(now, index, sub, out),
                (None, false) => client.start_upload(now, index, sub, out),
            }
            .expect("idle, and within the capacity");
        });
        check(outcome)?;
        Ok(client.data().to_vec())
    }

    fn check(outcome: SdoOutcome) -> Result<(), String> {
        match outcome {
            SdoOutcome::Uploaded { .. } | SdoOutcome::Downloaded { .. } => Ok(()),
            SdoOutcome::Aborted { code, .. } => Err(code.to_string()),
            SdoOutcome::TimedOut { may_be_written, .. } => Err(format!("no answer; may be written: {may_be_written}")),
        }
    }

    fn speed(reads: usize, bytes: usize, rounds: usize, block: usize) -> Result<(), String> {
        let mut link = Real::new().client(NODE);
        let mut client = client(NODE);
        let mut time = |times: usize, way: Way<'_>| {
            let start = Instant::now();
            for _ in 0..times {
                pass_once(&mut link, &mut client, way)?;
            }
            Ok::<_, String>(times as f64 / start.elapsed().as_secs_f64())
        };
        let short = time(reads, Way::Read(0x2000, &[0; 4]))?;
        let data = bytes_of(bytes);
        time(1, Way::Write(&data))?;
        let long = bytes as f64 * time(rounds, Way::Read(0x2001, &data))?;
        if block == 0 {
            say(&format!("{short:.0} {long:.0}"));
            return Ok(());
        }
        let data = bytes_of(block);
        let written = block as f64 * time(1, Way::WriteBlocks(&data))?;
        let read = block as f64 * time(1, Way::ReadBlocks(&data))?;
        say(&format!("{short:.0} {long:.0} {read:.0} {written:.0}"));
        Ok(())
    }

    /// A transfer, with what is written or has to be read.
    #[derive(Clone, Copy)]
    enum Way<'a> {
        Read(u16, &'a [u8]),
        Write(&'a [u8]),
        ReadBlocks(&'a [u8]),
        WriteBlocks(&'a [u8]),
    }

    fn pass_once(link: &mut SocketCan, client: &mut SdoClient, way: Way<'_>) -> Result<(), String> {
        let outcome = transfer(link, client, |client, now, out| {
            match way {
                Way::Read(index, _) => client.start_upload(now, index, 0, out),
                Way::Write(data) => client.start_download(now, 0x2001, 0, data, out),
                Way::ReadBlocks(_) => client.start_block_upload(now, 0x2001, 0, out),
                Way::WriteBlocks(data) => client.start_block_download(now, 0x2001, 0, data, out),
            }
            .expect("idle, and within the capacity");
        });
        check(outcome)?;
        let (Way::Read(_, data) | Way::ReadBlocks(data) | Way::Write(data) | Way::WriteBlocks(data)) = way;
        if client.data() == data { Ok(()) } else { Err(format!("other than the {} bytes", data.len())) }
    }

    fn bytes_of(len: usize) -> Vec<u8> {
        (0..=249).cycle().take(len).collect()
    }

    fn number(text: &str) -> Result<usize, String> {
        text.parse().map_err(|error| format!("{text}: {error}"))
    }

    fn hex(data: &[u8]) -> String {
        data.iter().map(|byte| format!("{byte:02X}")).collect()
    }

    fn unhex(text: &str) -> Option<Vec<u8>> {
        let digits: Option<Vec<u8>> = text.chars().map(|digit| digit.to_digit(16).map(|value| value as u8)).collect();
        let digits = digits.filter(|digits| digits.len().is_multiple_of(2))?;
        Some(digits.chunks(2).map(|pair| pair[0] << 4 | pair[1]).collect())
    }

    fn say(result: &str) {
        println!("= {result}");
    }
}

#[cfg(not(target_os = "linux"))]
mod peer {
    pub(super) fn run(_: &[&str]) -> Result<(), String> {
        Err("CAN interfaces exist on Linux only".into())
    }
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match peer::run(&words) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}
