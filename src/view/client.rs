//! One client of the stream.

use std::pin::pin;
use std::sync::Arc;

use axum::extract::ws::{CloseFrame, Message, Utf8Bytes, WebSocket, close_code};
use serde::Serialize;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::{RecvError, TryRecvError};
use tokio::time::{MissedTickBehavior, interval, timeout};

use crate::order::Order;
use crate::server::{BusLoad, Seat, Site};
use crate::stream::Published;

/// Largest message that is read from a client before its connection is closed, bytes.
pub(crate) const MAX_MESSAGE: usize = 1024;

/// A message of text.
#[derive(Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
enum Text<'a> {
    Lagged { records: u64 },
    Status { buses: &'a [BusLoad], clients: usize, refused: u64, lost: u64 },
    Notice { message: &'a str },
    End { message: &'a str },
}

impl Text<'_> {
    fn message(&self) -> Message {
        // Numbers and text have a form in JSON.
        Message::text(serde_json::to_string(self).unwrap_or_default())
    }
}

/// The end of a connection: it is lost, or there is nothing more to send.
struct Gone;

/// A connected client.
struct Client {
    socket: WebSocket,
    /// Records of the stream up to the last packet that was sent; `None` before the first.
    position: Option<u64>,
    /// Whether its hand holds the tool of a simulation.
    holds: bool,
}

impl Client {
    async fn send(&mut self, message: Message) -> Result<(), Gone> {
        self.socket.send(message).await.map_err(|_| Gone)
    }

    /// Sends a packet, and before it how many records the client has missed.
    async fn send_packet(&mut self, Published { before, count, bytes }: Published) -> Result<(), Gone> {
        let missed = before - self.position.unwrap_or(before);
        if missed > 0 {
            self.send(Text::Lagged { records: missed }.message()).await?;
        }
        self.position = Some(before + u64::from(count));
        self.send(Message::Binary(bytes)).await
    }

    /// Sends what is still there, and the end.
    async fn send_end(&mut self, packets: &mut Receiver<Published>, message: &str) -> Result<(), Gone> {
        loop {
            match packets.try_recv() {
                Ok(packet) => self.send_packet(packet).await?,
                Err(TryRecvError::Lagged(_)) => {}
                Err(TryRecvError::Empty | TryRecvError::Closed) => break,
            }
        }
        self.send(Text::End { message }.message()).await
    }

    /// Closes with a code and waits a moment for the answer: unread data would make the system reset the connection, and the
    /// client would lose the code.
    async fn close(mut self, site: &Site, code: u16, reason: &'static str) {
        let frame = CloseFrame { code, reason: Utf8Bytes::from_static(reason) };
        let closing = async {
            self.send(Message::Close(Some(frame))).await?;
            while let Some(Ok(_)) = self.socket.recv().await {}
            Ok::<_, Gone>(())
        };
        // A client that does not answer is left.
        let _ = timeout(site.limits.closing, closing).await;
    }
}

/// Closes a client that found no seat.
pub(crate) async fn turn_away(socket: WebSocket, site: Arc<Site>) {
    let client = Client { socket, position: None, holds: false };
    client.close(&site, close_code::AGAIN, "too many clients").await;
}

/// Serves a client until it leaves, the run ends, or the client sends data.
pub(crate) async fn serve(socket: WebSocket, site: Arc<Site>, _seat: Seat) {
    let mut client = Client { socket, position: None, holds: false };
    let mut packets = site.packets.subscribe();
    let end = follow(&mut client, &mut packets, &site).await.unwrap_or(None);
    if let Some(desk) = site.desk().filter(|_| client.holds) {
        desk.take(Order::LetGo).await;
    }
    if let Some((code, reason)) = end {
        client.close(&site, code, reason).await;
    }
}

/// Returns the code to close with; `None` if the client closed.
async fn follow(
    client: &mut Client,
    packets: &mut Receiver<Published>,
    site: &Site,
) -> Result<Option<(u16, &'static str)>, Gone> {
    let mut ended = pin!(site.ended());
    let mut status = interval(site.limits.status);
    status.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let (mut hello, mut notices) = (site.hello.subscribe(), site.notices.subscribe());
    let description = hello.borrow_and_update().clone();
    client.send(Message::Text(description)).await?;
    loop {
        tokio::select! {
            incoming = client.socket.recv() => match incoming {
                None | Some(Ok(Message::Close(_))) => return Ok(None),
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => {}
                Some(Ok(Message::Text(text))) if let (Some(desk), Some(order)) = (site.desk(), Order::of(&text)) => {
                    match order {
                        Order::Hold(_) => client.holds = true,
                        Order::LetGo => client.holds = false,
                        _ => {}
                    }
                    desk.take(order).await;
                }
                Some(Ok(Message::Text(_) | Message::Binary(_)) | Err(_)) => {
                    site.refuse();
                    let reason = if site.desk().is_some() { "the message is no order" } else { "this server takes no data" };
                    return Ok(Some((close_code::UNSUPPORTED, reason)));
                }
            },
            packet = packets.recv() => match packet {
                Ok(packet) => client.send_packet(packet).await?,
                // The next packet shows how many records are missing.
                Err(RecvError::Lagged(_)) => {}
                Err(RecvError::Closed) => return Ok(Some((close_code::AWAY, "the stream is closed"))),
            },
            Ok(()) = hello.changed() => {
                let description = hello.borrow_and_update().clone();
                client.send(Message::Text(description)).await?;
            }
            // A client that missed some has others.
            Ok(notice) = notices.recv() => client.send(Text::Notice { message: &notice }.message()).await?,
            _ = status.tick() => {
                let text = {
                    let buses = site.buses();
                    Text::Status { buses: &buses, clients: site.clients(), refused: site.refused(), lost: site.lost() }.message()
                };
                client.send(text).await?;
            }
            message = &mut ended => {
                let Some(message) = message else { return Ok(Some((close_code::AWAY, "the server ends"))) };
                client.send_end(packets, &message).await?;
                return Ok(Some((close_code::NORMAL, "the run has ended")));
            }
        }
    }
}
