//! The page of a rig that runs: what is recorded does not depend on it, and it is served to this computer alone.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use hil_tests::processes::Process;
use hil_tests::program;

const RIG: &str = "builtin:paper-admittance.yaml";

/// `run` for two seconds, recorded into this folder, with standard error beside its output.
fn run(folder: &Path, arguments: &[&str]) -> Process {
    let mut run = Command::new("sh");
    run.args(["-c", "exec \"$@\" 2>&1", "sh"]).arg(program());
    run.args(["--quiet", "run", RIG, "--duration", "2", "--record"]).arg(folder).args(arguments);
    Process::start(run.env("XDG_STATE_HOME", folder).stdout(Stdio::piped()).stderr(Stdio::piped()))
}

fn folder(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("yieldwall-page-{name}-{}", std::process::id()))
}

/// A client of the stream by the address that a command has printed; the bytes of the answer up to the end of its head.
fn client(address: SocketAddr, token: &str) -> (TcpStream, String) {
    let mut socket = TcpStream::connect(address).unwrap();
    let request = format!(
        "GET /stream HTTP/1.1\r\nHost: {address}\r\nOrigin: http://{address}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Protocol: yieldwall.v1, token.{token}\r\n\r\n"
    );
    socket.write_all(request.as_bytes()).unwrap();
    let (mut answer, mut byte) = (Vec::new(), [0]);
    while !answer.ends_with(b"\r\n\r\n") && socket.read(&mut byte).unwrap() == 1 {
        answer.push(byte[0]);
    }
    (socket, String::from_utf8(answer).unwrap())
}

#[test]
fn a_recording_is_that_of_a_run_without_the_page_whoever_looks_on() {
    let folder = folder("recorded");
    let [looked_at, alone] = ["looked-at", "alone"].map(|name| folder.join(name));
    let mut viewed = run(&looked_at, &["--view"]);
    let mut line = String::new();
    BufReader::with_capacity(1, viewed.stdout()).read_line(&mut line).unwrap();
    let (address, token) = line.trim().rsplit_once("http://").unwrap().1.split_once("/#").unwrap();
    let address: SocketAddr = address.parse().unwrap();
    assert!(address.ip().is_loopback());
    let (reader, answer) = client(address, token);
    assert!(answer.starts_with("HTTP/1.1 101"), "{answer}");
    let (_never_reads, _) = client(address, token);
    let (_, refused) = client(address, "00000000000000000000000000000000");
    assert!(refused.starts_with("HTTP/1.1 401"), "{refused}");
    let mut seen = Vec::new();
    BufReader::new(reader).read_to_end(&mut seen).unwrap();
    assert!(contains(&seen, "\"kind\":\"hello\""), "no description");
    assert!(contains(&seen, "\"kind\":\"end\""), "no end");
    assert!(viewed.output().status.success());
    assert!(run(&alone, &[]).output().status.success());
    let [looked_at, alone] = [looked_at, alone].map(|folder| fs::read(folder.join("cycles.mcap")).unwrap());
    assert!(looked_at == alone, "{} bytes, and {} without the page", looked_at.len(), alone.len());
    fs::remove_dir_all(folder).unwrap();
}

/// Sends a message of at most 125 bytes; the mask of zeros leaves it as it is.
fn send(socket: &mut TcpStream, message: &str) {
    let head = [0x81, 0x80 | u8::try_from(message.len()).unwrap(), 0, 0, 0, 0];
    socket.write_all(&[&head, message.as_bytes()].concat()).unwrap();
}

/// Reads the stream until it has this text.
fn read_until(socket: &mut TcpStream, text: &str) {
    let (mut seen, mut part) = (Vec::new(), [0; 4096]);
    while !contains(&seen, text) {
        seen.drain(..seen.len().saturating_sub(text.len()));
        let count = socket.read(&mut part).unwrap();
        assert!(count > 0, "the stream ends without {text}");
        seen.extend_from_slice(&part[..count]);
    }
}

#[test]
fn the_page_of_play_breaks_and_changes_a_rig_whose_recordings_repeat_bit_by_bit() {
    let folder = folder("played");
    let mut play = Command::new(program());
    play.args(["play", "--no-open", "--record"]).arg(folder.join("runs")).env("XDG_STATE_HOME", &folder);
    let mut play = Process::start(play.stdout(Stdio::piped()).stderr(Stdio::piped()));
    let mut line = String::new();
    BufReader::with_capacity(1, play.stdout()).read_line(&mut line).unwrap();
    let (address, token) = line.trim().rsplit_once("http://").unwrap().1.split_once("/#").unwrap();
    let (mut page, answer) = client(address.parse().unwrap(), token);
    assert!(answer.starts_with("HTTP/1.1 101"), "{answer}");
    read_until(&mut page, "\"law\":\"plastic\"");
    send(&mut page, r#"{"hold": [-0.05, 0.0]}"#);
    // A surface that yields sooner than free motion is no rig; this one and the next change nothing.
    send(&mut page, r#"{"set": {"key": "friction_n", "value": 20}}"#);
    read_until(&mut page, "Friction F must be below yield force R (20 N)");
    send(&mut page, r#"{"set": {"key": "mass_kg", "value": -1}}"#);
    read_until(&mut page, "virtual mass M is -1 kg: it lies between");
    send(&mut page, r#"{"fault": "drive-fault"}"#);
    send(&mut page, r#""enable""#);
    send(&mut page, r#"{"law": "elastic"}"#);
    read_until(&mut page, "\"law\":\"elastic\",\"faults\"");
    send(&mut page, r#"{"hold": [-0.02, 0.0]}"#);
    send(&mut page, r#"{"law": "free"}"#);
    read_until(&mut page, "\"law\":\"free\",\"faults\"");
    drop(page);
    play.signal("INT");
    let done = play.output();
    assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
    for number in ["1", "2", "3"] {
        let recording = folder.join("runs").join(number).join("cycles.mcap");
        let replayed = Command::new(program()).arg("replay").arg(&recording).output().unwrap();
        assert!(replayed.status.success(), "{number}: {}", String::from_utf8_lossy(&replayed.stderr));
    }
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_page_is_served_on_loopback_alone() {
    let folder = folder("refused");
    let done = run(&folder.join("refused"), &["--view=192.0.2.1:8080"]).output();
    let error = String::from_utf8(done.stdout).unwrap();
    assert_eq!(done.status.code(), Some(2), "{error}");
    assert!(error.contains("ssh -L 8080:127.0.0.1:8080"), "{error}");
    let _ = fs::remove_dir_all(folder);
}

fn contains(bytes: &[u8], text: &str) -> bool {
    bytes.windows(text.len()).any(|part| part == text.as_bytes())
}
