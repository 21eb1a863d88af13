//! Servers on real connections of this computer. No test asserts how long something takes.

mod gate;
mod malformed;
mod packets;
mod played;
mod served;
mod streamed;

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tungstenite::handshake::client::generate_key;
use tungstenite::http::Request;
use tungstenite::protocol::frame::coding::CloseCode;
use tungstenite::{Message, WebSocket};
use yieldwall_record::CycleRecord;
use yieldwall_record::recording::{Recorded, Sink};

use crate::server::Limits;
use crate::{Description, Fixture, Hello, Server, Source, ViewSink, faults, stream};

/// A test that waits longer than this has failed.
const TOO_LONG: Duration = Duration::from_secs(30);

fn hello() -> Hello {
    Hello {
        program: "yieldwall 0.1.0".into(),
        command: "run",
        tier: None,
        machine: machine(),
        faults: faults(),
        play: None,
    }
}

fn machine() -> Description {
    Description {
        name: "bench".into(),
        period_s: 0.001,
        arm: None,
        surfaces: Vec::new(),
        view_m: [-0.2, 0.0, 0.2, 0.4],
        fixture: Fixture { law: "plastic".into(), yield_force_n: Some(20.0), rows: vec![("R".into(), "20 N".into())] },
    }
}

/// A server of a rig that runs, and the sink that takes its records.
fn live(limits: Limits) -> (Server, ViewSink<CycleRecord>) {
    let (stream, sink) = stream();
    let server = Server::start_within(limits, "127.0.0.1:0".parse().unwrap(), hello(), Source::Live(stream));
    (server.unwrap(), sink)
}

fn record(index: u64) -> CycleRecord {
    let mut record = CycleRecord::blank();
    record.moment.index = index;
    record
}

fn push(sink: &mut ViewSink<CycleRecord>, indices: std::ops::Range<u64>) {
    indices.for_each(|index| sink.take(&record(index)).unwrap());
}

fn token(server: &Server) -> String {
    server.address_line().split_once('#').unwrap().1.to_owned()
}

fn connect(server: &Server) -> TcpStream {
    let connection = TcpStream::connect(server.address()).unwrap();
    connection.set_read_timeout(Some(TOO_LONG)).unwrap();
    connection
}

/// Everything up to the end of the connection. A reset ends it as well.
fn rest(mut connection: TcpStream) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut part = [0; 4096];
    loop {
        match connection.read(&mut part) {
            Ok(0) => return bytes,
            Ok(count) => bytes.extend_from_slice(&part[..count]),
            Err(error) if error.kind() == std::io::ErrorKind::ConnectionReset => return bytes,
            Err(error) => panic!("{error}"),
        }
    }
}

/// The response to a head of a request; `PORT` and `TOKEN` in it stand for those of the server.
fn ask(server: &Server, head: &str) -> Vec<u8> {
    let head = head.replace("PORT", &server.address().port().to_string()).replace("TOKEN", &token(server));
    let mut connection = connect(server);
    connection.write_all(head.replace('\n', "\r\n").as_bytes()).unwrap();
    rest(connection)
}

fn text(response: Vec<u8>) -> String {
    String::from_utf8(response).unwrap()
}

/// The response to GET with the token.
fn get(server: &Server, path: &str) -> Vec<u8> {
    ask(server, &format!("GET {path} HTTP/1.1\nHost: localhost:PORT\nAuthorization: Bearer TOKEN\n\n"))
}

type Client = WebSocket<TcpStream>;

/// A client of the stream, as the page makes it.
fn client(server: &Server) -> Client {
    let address = server.address();
    let request = Request::get(format!("ws://{address}/stream"))
        .header("Host", address.to_string())
        .header("Origin", format!("http://{address}"))
        .header("Connection", "Upgrade")
        .header("Upgrade", "websocket")
        .header("Sec-WebSocket-Version", "13")
        .header("Sec-WebSocket-Key", generate_key())
        .header("Sec-WebSocket-Protocol", format!("yieldwall.v1, token.{}", token(server)))
        .body(())
        .unwrap();
    let (client, response) = tungstenite::client(request, connect(server)).unwrap();
    assert_eq!(response.headers()["sec-websocket-protocol"], "yieldwall.v1");
    client
}

/// Messages that a client got.
#[derive(Debug, Default)]
struct Seen {
    packets: Vec<Vec<u8>>,
    texts: Vec<serde_json::Value>,
    code: Option<CloseCode>,
}

impl Seen {
    fn of_kind(&self, kind: &str) -> Vec<&serde_json::Value> {
        self.texts.iter().filter(|text| text["kind"] == kind).collect()
    }

    fn records(&self) -> u64 {
        self.packets.iter().map(|packet| u64::from(u32::from_le_bytes(packet[4..8].try_into().unwrap()))).sum()
    }
}

/// Reads until the connection ends.
fn watch(mut client: Client) -> Seen {
    let mut seen = Seen::default();
    loop {
        match client.read() {
            Ok(Message::Binary(packet)) => seen.packets.push(packet.to_vec()),
            Ok(Message::Text(text)) => seen.texts.push(serde_json::from_str(&text).unwrap()),
            Ok(Message::Close(frame)) => seen.code = frame.map(|frame| frame.code),
            Ok(_) => {}
            Err(_) => return seen,
        }
    }
}

/// Waits until `is_so`.
#[track_caller]
fn until(is_so: impl Fn() -> bool) {
    let (pause, mut waited) = (Duration::from_millis(2), Duration::ZERO);
    while !is_so() {
        assert!(waited < TOO_LONG, "it never is so");
        std::thread::sleep(pause);
        waited += pause;
    }
}

/// Value of a metric.
fn metric(server: &Server, name: &str) -> f64 {
    let response = text(get(server, "/metrics"));
    let line = response.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
    line.unwrap_or_else(|| panic!("{response}")).parse().unwrap()
}

/// A folder of this test's own, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("yieldwall-view-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
