use std::io::{Read, Write};
use std::net::Shutdown;

use super::played::played;
use super::*;
use crate::Order;

/// Bytes that differ from one round to the next, and are the same in every run.
struct Dice(u64);

impl Dice {
    fn below(&mut self, most: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % most
    }

    fn byte(&mut self) -> u8 {
        self.below(256) as u8
    }

    /// Replaces, removes or adds up to eight bytes.
    fn spoil(&mut self, bytes: &mut Vec<u8>) {
        for _ in 0..=self.below(8) {
            let at = self.below(bytes.len());
            match self.below(3) {
                0 => bytes[at] = self.byte(),
                1 => drop(bytes.remove(at)),
                _ => bytes.insert(at, self.byte()),
            }
        }
    }
}

/// Sends all bytes and the end, and reads everything that comes back.
fn exchange(server: &Server, bytes: &[u8]) -> Vec<u8> {
    let mut connection = connect(server);
    // The server may close before it has read everything.
    let _ = connection.write_all(bytes);
    let _ = connection.shutdown(Shutdown::Write);
    let mut answer = Vec::new();
    let _ = connection.read_to_end(&mut answer);
    answer
}

fn head(server: &Server) -> Vec<u8> {
    let address = server.address();
    format!(
        "GET /stream HTTP/1.1\r\nHost: {address}\r\nOrigin: http://{address}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
         Sec-WebSocket-Protocol: yieldwall.v1, token.{}\r\n\r\n",
        token(server)
    )
    .into_bytes()
}

#[test]
fn ten_thousand_malformed_handshakes_and_frames_are_refused_and_the_next_client_is_served() {
    let (server, orders, _sink) = played();
    let (head, mut dice) = (head(&server), Dice(1));
    let mut accepted = 0;
    for _ in 0..8000 {
        let mut spoilt = head.clone();
        dice.spoil(&mut spoilt);
        // Some changes leave a good handshake, such as those of its key.
        accepted += u64::from(exchange(&server, &spoilt).starts_with(b"HTTP/1.1 101"));
    }
    let refused = server.refused();
    assert!(accepted < 4000 && refused + accepted >= 4000, "{accepted} accepted, {refused} refused");
    for _ in 0..2000 {
        // Without any data hyper may see the end before it has answered, and then does not answer.
        let frames = (0..=dice.below(200)).map(|_| dice.byte());
        let sent: Vec<u8> = head.iter().copied().chain(frames).collect();
        assert!(exchange(&server, &sent).starts_with(b"HTTP/1.1 101"));
        orders.try_iter().for_each(drop);
    }
    until(|| metric(&server, "yieldwall_view_clients") == 0.0);
    orders.try_iter().for_each(drop);
    let mut good = client(&server);
    good.send(tungstenite::Message::text(r#""stop""#)).unwrap();
    assert_eq!(orders.recv_timeout(TOO_LONG).unwrap(), Order::Stop);
}
