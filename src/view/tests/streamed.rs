use std::time::Duration;

use tungstenite::Message;
use tungstenite::protocol::frame::coding::CloseCode;
use yieldwall_record::recording::Sink;

use super::*;
use crate::BusLoad;

#[test]
fn a_client_gets_the_description_the_records_and_the_end() {
    let (server, mut sink) = live(Limits::default());
    server.set_buses(vec![BusLoad { name: "can0".into(), load_percent: 12.5 }]);
    let mut client = client(&server);
    let first = client.read().unwrap();
    let first: serde_json::Value = serde_json::from_str(first.to_text().unwrap()).unwrap();
    assert_eq!(first["kind"], "hello");
    let (stride, fields) = (&first["record"]["bytes"], first["record"]["fields"].as_array().unwrap());
    assert_eq!((&fields[0]["name"], &fields[0]["offset"]), (&"index".into(), &0.into()));
    let stride = stride.as_u64().unwrap() as usize;
    push(&mut sink, 0..40);
    sink.finish().unwrap();
    server.end("The scene is over.");
    let seen = watch(client);
    let counts: Vec<_> = seen.packets.iter().map(|packet| packet[4]).collect();
    assert_eq!((counts, seen.records()), (vec![16, 16, 8], 40));
    let indices = seen.packets.iter().flat_map(|packet| packet[16..].chunks(stride));
    let indices: Vec<_> = indices.map(|record| u64::from_le_bytes(record[..8].try_into().unwrap())).collect();
    assert_eq!(indices, (0..40).collect::<Vec<_>>());
    let status = serde_json::json!({
        "kind": "status", "buses": [{"name": "can0", "load_percent": 12.5}], "clients": 1, "refused": 0, "lost": 0,
    });
    assert!(seen.of_kind("status").into_iter().all(|seen| *seen == status), "{seen:?}");
    let end = serde_json::json!({"kind": "end", "message": "The scene is over."});
    assert_eq!((seen.texts.last(), seen.code), (Some(&end), Some(CloseCode::Normal)));
    assert!(seen.of_kind("lagged").is_empty());
}

#[test]
fn the_status_comes_again_and_again() {
    let (server, _sink) = live(Limits { status: Duration::from_millis(5), ..Limits::default() });
    let mut client = client(&server);
    let mut next = || client.read().unwrap().into_text().unwrap();
    assert!(next().contains("hello"));
    (0..5).for_each(|_| assert!(next().contains("status")));
}

#[test]
fn data_of_a_client_closes_its_connection() {
    let messages = [
        Message::text("{}"),
        Message::text(""),
        Message::binary(vec![1]),
        // Longer than what is read of a client.
        Message::binary(vec![0; 100_000]),
    ];
    let (server, mut sink) = live(Limits::default());
    for (number, message) in (1..).zip(messages) {
        let mut client = client(&server);
        client.send(message).unwrap();
        assert_eq!(watch(client).code, Some(CloseCode::Unsupported));
        until(|| server.refused() == number);
    }
    // Pings are not data.
    let mut client = client(&server);
    client.send(Message::Ping(vec![1].into())).unwrap();
    push(&mut sink, 0..16);
    server.end("over");
    assert_eq!(watch(client).code, Some(CloseCode::Normal));
}

#[test]
fn a_fifth_client_is_turned_away_until_another_leaves() {
    let (server, _sink) = live(Limits::default());
    let mut clients: Vec<_> = (0..4).map(|_| client(&server)).collect();
    clients.iter_mut().for_each(|client| assert!(client.read().unwrap().to_text().unwrap().contains("hello")));
    let fifth = watch(client(&server));
    assert_eq!((fifth.code, fifth.texts.len(), server.refused()), (Some(CloseCode::Again), 0, 1));
    assert_eq!(metric(&server, "yieldwall_view_clients"), 4.0);
    drop(clients.pop());
    until(|| metric(&server, "yieldwall_view_clients") == 3.0);
    assert!(client(&server).read().unwrap().to_text().unwrap().contains("hello"));
}

#[test]
fn a_slow_client_gets_the_number_of_the_records_that_it_missed() {
    let (server, mut sink) = live(Limits::default());
    let mut slow = client(&server);
    assert!(slow.read().unwrap().to_text().unwrap().contains("hello"));
    // More than the system holds for a connection; every packet before the next, so that another client sees them all.
    let mut fast = client(&server);
    assert!(fast.read().unwrap().to_text().unwrap().contains("hello"));
    let total = 16 * 3000;
    for start in (0..total).step_by(16) {
        push(&mut sink, start..start + 16);
        while !matches!(fast.read().unwrap(), Message::Binary(_)) {}
    }
    let slow = std::thread::spawn(move || watch(slow));
    server.end("over");
    let slow = slow.join().unwrap();
    let missed: u64 = slow.of_kind("lagged").iter().map(|text| text["records"].as_u64().unwrap()).sum();
    assert!(missed > 0);
    assert_eq!((slow.records() + missed, slow.code), (total, Some(CloseCode::Normal)));
}

#[test]
fn a_client_that_never_reads_is_dropped_and_holds_up_nobody() {
    let (server, mut sink) = live(Limits { patience: Duration::from_millis(50), ..Limits::default() });
    let idle = client(&server);
    let mut fast = client(&server);
    assert!(fast.read().unwrap().to_text().unwrap().contains("hello"));
    let mut index = 0;
    while metric(&server, "yieldwall_view_clients") > 1.0 {
        for _ in 0..100 {
            push(&mut sink, index..index + 16);
            index += 16;
            while !matches!(fast.read().unwrap(), Message::Binary(_)) {}
        }
    }
    drop(idle);
}

#[test]
fn a_server_that_is_dropped_goes_away() {
    let (server, _sink) = live(Limits::default());
    let mut client = client(&server);
    assert!(client.read().unwrap().to_text().unwrap().contains("hello"));
    let address = server.address();
    drop(server);
    assert_eq!(watch(client).code, Some(CloseCode::Away));
    std::net::TcpListener::bind(address).unwrap();
}

#[test]
fn the_end_does_not_wait_for_a_client_that_never_reads() {
    let (server, mut sink) = live(Limits { ending: Duration::from_millis(50), ..Limits::default() });
    let idle = client(&server);
    let open = connect(&server);
    push(&mut sink, 0..16 * 3000);
    // Returns although the limit for a client that takes nothing is 30 s.
    server.end("over");
    drop((idle, open));
}
