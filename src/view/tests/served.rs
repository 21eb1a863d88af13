use std::io::Write;
use std::time::Duration;

use yieldwall_motion::guard::{Cause, DeviceSet, Fault, State};
use yieldwall_record::DeviceRecord;
use yieldwall_record::recording::{About, Machine, Recorder, Sink, layout, pack};

use super::*;
use crate::files::FILES;
use crate::{RecordingFile, StartError};

/// A handshake of the stream with other headers than the page's.
fn handshake(lines: &str) -> String {
    format!(
        "GET /stream HTTP/1.1\nConnection: Upgrade\nUpgrade: websocket\nSec-WebSocket-Version: 13\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\n{lines}\n\n"
    )
}

#[test]
fn the_page_needs_no_token_and_has_strict_headers() {
    let (server, _sink) = live(Limits::default());
    for file in FILES {
        let response = ask(&server, &format!("GET {} HTTP/1.1\nHost: 127.0.0.1:PORT\n\n", file.path));
        assert!(response.ends_with(file.bytes));
        let head = text(response[..response.len() - file.bytes.len()].to_vec());
        assert!(head.starts_with("HTTP/1.1 200 OK\r\n"), "{head}");
        for line in [
            &format!("content-type: {}", file.media_type),
            "content-security-policy: default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
            "x-content-type-options: nosniff",
            "cross-origin-resource-policy: same-origin",
            "cross-origin-opener-policy: same-origin",
            "referrer-policy: no-referrer",
            "cache-control: no-store",
        ] {
            assert!(head.contains(&format!("\r\n{line}\r\n")), "{head}");
        }
        assert!(!head.contains("set-cookie") && !head.contains("access-control"));
    }
    assert_eq!(server.refused(), 0);
}

#[test]
fn every_file_of_the_page_is_served() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/page");
    for entry in std::fs::read_dir(folder).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        let path = if name == "index.html" { "/".to_owned() } else { format!("/{name}") };
        let is_licence = name.ends_with("LICENSE");
        assert_eq!(FILES.iter().filter(|file| file.path == path).count(), usize::from(!is_licence), "{name}");
    }
}

#[test]
fn the_address_has_port_and_token() {
    let (server, _sink) = live(Limits::default());
    let line = server.address_line();
    let rest = line.strip_prefix("http://127.0.0.1:").unwrap();
    let (port, token) = rest.split_once("/#").unwrap();
    assert_eq!(port, server.address().port().to_string());
    assert!(token.len() == 32 && token.bytes().all(|byte| byte.is_ascii_hexdigit()));
    assert!(!format!("{server:?}").contains(token));
}

#[test]
fn requests_from_elsewhere_are_refused_and_counted() {
    let (server, _sink) = live(Limits::default());
    let own = "Host: 127.0.0.1:PORT\nOrigin: http://127.0.0.1:PORT";
    let protocols = "Sec-WebSocket-Protocol: yieldwall.v1, token.TOKEN";
    let wrong = "Sec-WebSocket-Protocol: yieldwall.v1, token.00000000000000000000000000000000";
    let requests = [
        (405, "POST / HTTP/1.1\nHost: 127.0.0.1:PORT\nContent-Length: 0\n\n".to_owned()),
        (405, "HEAD / HTTP/1.1\nHost: 127.0.0.1:PORT\n\n".into()),
        (405, "OPTIONS /metrics HTTP/1.1\nHost: 127.0.0.1:PORT\n\n".into()),
        (403, "GET / HTTP/1.1\nHost: evil.example:PORT\n\n".into()),
        (403, "GET / HTTP/1.1\n\n".into()),
        (403, "GET / HTTP/1.0\n\n".into()),
        (403, "GET / HTTP/1.1\nHost: 127.0.0.1:PORT\nHost: 127.0.0.1:PORT\n\n".into()),
        (403, "GET / HTTP/1.1\nHost: 127.0.0.1:PORT\nOrigin: http://evil.example\n\n".into()),
        (404, "GET http://evil.example/ HTTP/1.1\nHost: 127.0.0.1:PORT\n\n".into()),
        (404, "GET /other HTTP/1.1\nHost: 127.0.0.1:PORT\n\n".into()),
        (401, "GET /metrics HTTP/1.1\nHost: 127.0.0.1:PORT\n\n".into()),
        (401, "GET /metrics HTTP/1.1\nHost: 127.0.0.1:PORT\nAuthorization: Bearer 0\n\n".into()),
        (401, handshake(own)),
        (401, handshake(&format!("{own}\n{wrong}"))),
        (403, handshake(&format!("Host: 127.0.0.1:PORT\n{protocols}"))),
        (403, handshake(&format!("Host: 127.0.0.1:PORT\nOrigin: http://evil.example\n{protocols}"))),
        // A name that resolves to this computer: host and origin agree.
        (403, handshake(&format!("Host: evil.example:PORT\nOrigin: http://evil.example:PORT\n{protocols}"))),
        (400, format!("GET /stream HTTP/1.1\n{own}\n{protocols}\n\n")),
        (400, "not HTTP\n\n".into()),
        (431, format!("GET / HTTP/1.1\nHost: 127.0.0.1:PORT\nX: {}\n\n", "x".repeat(20_000))),
    ];
    for (number, (status, request)) in (1..).zip(requests) {
        let response = text(ask(&server, &request));
        assert!(
            response.starts_with(&format!("HTTP/1.{} {status} ", u8::from(!request.contains("HTTP/1.0")))),
            "{request}: {response}"
        );
        until(|| server.refused() == number);
    }
    // With the token there is data, and no recording while a rig runs.
    for (path, status) in [("/metrics", 200), ("/recordings/0", 404)] {
        let response = text(get(&server, path));
        assert!(response.starts_with(&format!("HTTP/1.1 {status} ")), "{response}");
    }
}

#[test]
fn a_handshake_that_does_not_come_to_its_end_is_cut_off() {
    let (server, _sink) = live(Limits { handshake: Duration::from_millis(20), ..Limits::default() });
    for (number, begin) in (1..).zip(["", "GET", "GET / HTTP/1.1\r\nHost: 127.0.0.1"]) {
        let mut slow = connect(&server);
        slow.write_all(begin.as_bytes()).unwrap();
        rest(slow);
        until(|| server.refused() == number);
    }
}

/// Bytes that differ from each other, the same in every run.
fn noise(seed: u64) -> Vec<u8> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    (0..next() % 300).map(|_| next().to_le_bytes()[3]).collect()
}

#[test]
fn noise_before_and_behind_a_handshake_does_no_harm() {
    let (server, _sink) = live(Limits::default());
    let good = handshake(
        "Host: 127.0.0.1:PORT\nOrigin: http://127.0.0.1:PORT\nSec-WebSocket-Protocol: yieldwall.v1, token.TOKEN",
    );
    for seed in 0..300 {
        let noise = noise(seed);
        let mut head = good.clone().into_bytes();
        match seed % 3 {
            0 => head = noise,
            1 => noise.chunks(2).for_each(|pair| head[usize::from(pair[0]) % good.len()] = *pair.last().unwrap()),
            // Frames of a client that was admitted.
            _ => {}
        }
        let head = String::from_utf8_lossy(&head).replace('\0', "?");
        let mut connection = connect(&server);
        let head = head.replace("PORT", &server.address().port().to_string()).replace("TOKEN", &token(&server));
        // The server may have closed.
        let _ = connection.write_all(head.replace('\n', "\r\n").as_bytes());
        let _ = connection.write_all(&self::noise(seed + 1000));
        let _ = connection.shutdown(std::net::Shutdown::Write);
        rest(connection);
    }
    until(|| metric(&server, "yieldwall_view_clients") == 0.0);
    assert!(server.refused() > 100, "{}", server.refused());
    assert!(client(&server).read().unwrap().to_text().unwrap().contains("hello"));
}

#[test]
fn connections_beyond_the_limit_are_closed() {
    let (server, _sink) = live(Limits { connections: 2, ..Limits::default() });
    let open = [connect(&server), connect(&server)];
    // Until both are accepted.
    until(|| rest(connect(&server)).is_empty());
    assert!(server.refused() > 0);
    drop(open);
    until(|| ask(&server, "GET / HTTP/1.1\nHost: 127.0.0.1:PORT\n\n").starts_with(b"HTTP/1.1 200"));
}

#[test]
fn addresses_of_other_computers_are_refused() {
    for (address, port) in
        [("0.0.0.0:9000", 9000), ("192.168.1.5:0", 8080), ("[::]:80", 80), ("[::ffff:127.0.0.1]:80", 80)]
    {
        let (stream, _sink) = stream::<CycleRecord>();
        let error = Server::start(address.parse().unwrap(), hello(), Source::Live(stream)).unwrap_err();
        assert!(matches!(error, StartError::NotLoopback(_)), "{error}");
        assert!(error.help().unwrap().contains(&format!("`ssh -L {port}:127.0.0.1:{port} USER@THIS_COMPUTER`")));
    }
}

#[test]
fn an_address_that_is_taken_is_named() {
    let (server, _sink) = live(Limits::default());
    let (stream, _other) = stream::<CycleRecord>();
    let error = Server::start(server.address(), hello(), Source::Live(stream)).unwrap_err();
    assert!(error.to_string().contains(&server.address().to_string()) && error.help().is_none(), "{error}");
}

#[test]
fn metrics_are_as_prometheus_reads_them() {
    let (server, mut sink) = live(Limits::default());
    assert!(!text(get(&server, "/metrics")).contains("state="));
    let mut record = record(0);
    record.inputs.timing.compute_late_ns = 1500;
    record.directive.state = State::Stopped;
    record.cause = Some(Cause { fault: Fault::SensorLost, devices: DeviceSet::SENSOR });
    sink.take(&record).unwrap();
    record.inputs.timing.compute_late_ns = 500;
    sink.take(&record).unwrap();
    sink.rest(3);
    sink.finish().unwrap();
    let response = text(get(&server, "/metrics"));
    let (head, body) = response.split_once("\r\n\r\n").unwrap();
    assert!(head.contains("content-type: text/plain; version=0.0.4\r\n"), "{head}");
    for line in [
        "yieldwall_cycles_total 2",
        "yieldwall_view_lost_cycles_total 3",
        "yieldwall_cycle_lateness_seconds 0.0000005",
        "yieldwall_cycle_lateness_max_seconds 0.0000015",
        "yieldwall_supervisor_state{state=\"stopped\"} 1",
        "yieldwall_supervisor_state{state=\"running\"} 0",
        "yieldwall_fault{fault=\"sensor-lost\"} 1",
        "yieldwall_fault{fault=\"overrun\"} 0",
        "yieldwall_view_refused_total 0",
        "yieldwall_view_clients 0",
    ] {
        assert!(body.lines().any(|this| this == line), "{line}\n{body}");
    }
    // Each sample belongs to the type that stands before it, each type once.
    let mut types = std::collections::BTreeSet::new();
    let mut name = "";
    for line in body.lines() {
        match line.strip_prefix("# TYPE ") {
            Some(rest) => {
                name = rest.split(' ').next().unwrap();
                assert!(types.insert(name) && rest.ends_with("counter") == name.ends_with("_total"), "{line}");
            }
            None => assert!(line.starts_with("# HELP ") || line.starts_with(name), "{line}"),
        }
    }
}

/// A recording in a folder, with records of numbers from 0 on.
fn recorded<T: Recorded>(folder: &Folder, machine: Machine, records: &[T]) -> PathBuf {
    let about = About { machine, ..About::default() };
    let mut recorder = Recorder::<_, T>::create(&folder.0, &about).unwrap();
    records.iter().for_each(|record| recorder.take(record).unwrap());
    recorder.finish().unwrap();
    folder.0.join("cycles.mcap")
}

/// The body of a response in chunks.
fn body(response: &[u8]) -> Vec<u8> {
    let start = response.windows(4).position(|part| part == b"\r\n\r\n").unwrap() + 4;
    let (mut rest, mut body) = (&response[start..], Vec::new());
    loop {
        let end = rest.windows(2).position(|part| part == b"\r\n").unwrap();
        let length = usize::from_str_radix(std::str::from_utf8(&rest[..end]).unwrap(), 16).unwrap();
        if length == 0 {
            return body;
        }
        body.extend_from_slice(&rest[end + 2..end + 2 + length]);
        rest = &rest[end + 4 + length..];
    }
}

#[test]
fn a_recording_is_the_packets_of_its_records() {
    let folder = Folder::new();
    let records: Vec<_> = (0..2500).map(record).collect();
    let path = recorded(&folder, Machine::Rig("rig".into()), &records);
    let file = RecordingFile::open(&path, machine()).unwrap();
    assert_eq!((file.records(), file.path()), (2500, path.as_path()));
    let source = Source::Recordings(vec![file.clone(), file]);
    let server = Server::start("127.0.0.1:0".parse().unwrap(), hello(), source).unwrap();
    let first = client(&server).read().unwrap();
    let first: serde_json::Value = serde_json::from_str(first.to_text().unwrap()).unwrap();
    assert_eq!(first["is_live"], false);
    let second = &first["recordings"][1];
    assert_eq!((&second["records"], &second["machine"]["name"]), (&2500.into(), &"bench".into()));
    // The name is that of the file in its folder.
    let name = second["name"].as_str().unwrap();
    assert!(path.ends_with(name) && name.split('/').count() == 2, "{name}");
    let mut expected = Vec::new();
    for part in records.chunks(1024) {
        expected.extend([1, 0, 0, 0]);
        expected.extend((part.len() as u32).to_le_bytes());
        expected.extend([0; 8]);
        part.iter().for_each(|record| pack(record, &mut expected));
    }
    let response = get(&server, "/recordings/0");
    assert!(response.starts_with(b"HTTP/1.1 200 OK"));
    assert!(body(&response) == expected);
    assert!(get(&server, "/recordings/1").ends_with(b"0\r\n\r\n"));
    assert!(get(&server, "/recordings/2").starts_with(b"HTTP/1.1 404"));
    assert!(!text(get(&server, "/metrics")).contains("cycles"));
    drop(folder);
    let gone = text(get(&server, "/recordings/0"));
    assert!(gone.starts_with("HTTP/1.1 500") && gone.ends_with("cycles.mcap does not exist\n"), "{gone}");
}

#[test]
fn recordings_of_one_page_are_of_one_kind_of_machine() {
    let (rig, device) = (Folder::new(), Folder::new());
    let rig = RecordingFile::open(&recorded(&rig, Machine::Rig("rig".into()), &[record(0)]), machine()).unwrap();
    let sample = DeviceRecord::default();
    let path = recorded(&device, Machine::Device("device".into()), &[sample]);
    let device = RecordingFile::open(&path, machine()).unwrap();
    let start = |files| Server::start("127.0.0.1:0".parse().unwrap(), hello(), Source::Recordings(files));
    assert!(matches!(start(vec![rig, device.clone()]), Err(StartError::MixedRecordings)));
    assert!(matches!(start(Vec::new()), Err(StartError::NoRecording)));
    let server = start(vec![device]).unwrap();
    assert_eq!(body(&get(&server, "/recordings/0")).len(), 16 + layout::<DeviceRecord>().stride);
}
