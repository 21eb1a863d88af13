use std::sync::mpsc::Receiver;

use tungstenite::Message;
use tungstenite::protocol::frame::coding::CloseCode;

use super::*;
use crate::{Order, orders};

/// A server of a simulation that takes orders, their other end, and the sink that takes its records.
pub(super) fn played() -> (Server, Receiver<Order>, ViewSink<CycleRecord>) {
    let ((stream, sink), (desk, orders)) = (stream(), orders());
    let address = "127.0.0.1:0".parse().unwrap();
    let server = Server::start_within(Limits::default(), address, hello(), Source::Play(stream, desk));
    (server.unwrap(), orders, sink)
}

fn next(orders: &Receiver<Order>) -> Order {
    orders.recv_timeout(TOO_LONG).unwrap()
}

#[test]
fn orders_reach_the_simulation_in_their_order() {
    let (server, orders, _sink) = played();
    let mut client = client(&server);
    client.send(Message::text(r#"{"hold": [0.01, -0.02]}"#)).unwrap();
    client.send(Message::text(r#"{"law": "elastic"}"#)).unwrap();
    client.send(Message::text(r#""let_go""#)).unwrap();
    let expected = [Order::Hold([0.01, -0.02]), Order::Law("elastic".into()), Order::LetGo];
    assert_eq!([next(&orders), next(&orders), next(&orders)], expected);
    server.end("over");
    // A hand that has let go does not let go again.
    assert_eq!((watch(client).code, orders.try_recv().ok()), (Some(CloseCode::Normal), None));
}

#[test]
fn the_hand_lets_go_when_its_client_goes_away() {
    let (server, orders, _sink) = played();
    let mut client = client(&server);
    client.send(Message::text(r#"{"hold": [0, 0]}"#)).unwrap();
    assert_eq!(next(&orders), Order::Hold([0.0, 0.0]));
    drop(client);
    assert_eq!(next(&orders), Order::LetGo);
}

#[test]
fn a_message_that_is_no_order_closes_the_connection_and_the_hand_lets_go() {
    let (server, orders, _sink) = played();
    for (number, message) in
        (1..).zip([Message::text(r#"{"boot": 1}"#), Message::binary(vec![1]), Message::text("x".repeat(4000))])
    {
        let mut client = client(&server);
        client.send(Message::text(r#"{"hold": [0, 0]}"#)).unwrap();
        client.send(message).unwrap();
        assert_eq!(watch(client).code, Some(CloseCode::Unsupported));
        assert_eq!([next(&orders), next(&orders)], [Order::Hold([0.0, 0.0]), Order::LetGo]);
        until(|| server.refused() == number);
    }
}

#[test]
fn a_flood_of_orders_fills_the_queue_alone_and_a_release_waits_for_room() {
    let (server, orders, _sink) = played();
    let mut client = client(&server);
    (0..5000).for_each(|_| client.send(Message::text(r#"{"hold": [0, 0]}"#)).unwrap());
    client.send(Message::text(r#""let_go""#)).unwrap();
    let seen = std::thread::spawn(move || watch(client));
    let mut held = 0;
    while next(&orders) != Order::LetGo {
        held += 1;
    }
    assert!(held > 0);
    server.end("over");
    assert_eq!((seen.join().unwrap().code, orders.try_recv().ok()), (Some(CloseCode::Normal), None));
}

#[test]
fn another_description_reaches_those_who_look_on_and_those_who_come() {
    let (server, _orders, _sink) = played();
    let mut here = client(&server);
    assert!(here.read().unwrap().to_text().unwrap().contains("bench"));
    let changed = Hello { machine: Description { name: "changed".into(), ..machine() }, ..hello() };
    server.describe(&changed).unwrap();
    server.notify("it is another rig now");
    let mut later = client(&server);
    assert!(later.read().unwrap().to_text().unwrap().contains("changed"));
    let mut missing = vec![r#""name":"changed""#, r#""message":"it is another rig now""#];
    while !missing.is_empty() {
        let message = here.read().unwrap().into_text().unwrap();
        missing.retain(|part| !message.contains(part));
    }
}

#[test]
fn no_other_page_takes_an_order() {
    let (server, _sink) = live(Limits::default());
    let mut client = client(&server);
    client.send(Message::text(r#"{"hold": [0, 0]}"#)).unwrap();
    assert_eq!(watch(client).code, Some(CloseCode::Unsupported));
}
