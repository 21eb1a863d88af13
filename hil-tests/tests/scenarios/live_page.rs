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
