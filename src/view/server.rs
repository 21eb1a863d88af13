//! The server: one thread, connections of this computer alone.

use std::convert::Infallible;
use std::io;
use std::net::SocketAddr;
use std::pin::pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use axum::body::Body;
use axum::extract::ws::{Utf8Bytes, WebSocketUpgrade};
use axum::extract::{FromRequestParts, Request};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use serde::Serialize;
use thiserror::Error;
use tokio::net::{TcpListener, TcpStream};
use tokio::runtime::Runtime;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, broadcast, watch};
use tokio::time::{sleep, timeout};
use yieldwall_record::recording::Layout;

use crate::client::{self, MAX_MESSAGE};
use crate::gate::{File, Gate, Head, SUBPROTOCOL, Token, Wanted};
use crate::hello::{Hello, RecordingMessage};
use crate::order::Desk;
use crate::patient::Patient;
use crate::recordings::RecordingFile;
use crate::stream::{Published, Stream};
use crate::{files::PageFile, metrics};

/// Headers of every response.
const HEADERS: [(HeaderName, &str); 6] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    ),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::CACHE_CONTROL, "no-store"),
];
const PLAIN_TEXT: &str = "text/plain; charset=utf-8";
/// Threads that read recordings at most.
const READERS: usize = 4;
/// Notices that wait for the slowest client.
const NOTICES: usize = 16;

/// Records that a server shows.
#[derive(Clone, Debug)]
pub enum Source {
    /// A rig that runs.
    Live(Stream),
    /// A simulation that takes orders from its page.
    Play(Stream, Desk),
    /// Recordings, at least one, all of rigs or all of impedance devices.
    Recordings(Vec<RecordingFile>),
}

/// Load of a bus.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BusLoad {
    /// Name of the bus in the rig file.
    pub name: String,
    /// Greatest share of the bus time that frames take, in per cent.
    pub load_percent: f64,
}

/// Reason why a server could not be started.
#[derive(Debug, Error)]
pub enum StartError {
    /// The address can be reached from other computers.
    #[error("{0} is not a loopback address, and the page is served on loopback addresses only")]
    NotLoopback(SocketAddr),
    /// There is no recording to show.
    #[error("there is no recording to show")]
    NoRecording,
    /// Rigs and impedance devices have different records.
    #[error("the recordings are not all of one kind of machine")]
    MixedRecordings,
    /// The description has no form in JSON.
    #[error("the description of the rig cannot be sent: {0}")]
    Hello(serde_json::Error),
    /// The address is taken, or the system has no thread or no randomness.
    #[error("the live page cannot be served on {address}: {error}")]
    Io {
        /// The address.
        address: SocketAddr,
        /// Reason.
        error: io::Error,
    },
}

impl StartError {
    /// Returns the remedy, where there is one command for it.
    pub fn help(&self) -> Option<String> {
        let Self::NotLoopback(address) = self else { return None };
        // Port 0 is any free port, and both ends of a tunnel need a fixed one.
        let port = if address.port() == 0 { 8080 } else { address.port() };
        Some(format!(
            "serve it on 127.0.0.1:{port}; on the other computer run `ssh -L {port}:127.0.0.1:{port} USER@THIS_COMPUTER`, \
             and open the printed address there"
        ))
    }
}

/// Limits of a server.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Clients of the stream.
    pub(crate) clients: usize,
    /// Connections of all kinds.
    pub(crate) connections: usize,
    /// Bytes of a request up to the end of its headers.
    pub(crate) header_bytes: usize,
    /// Time until the headers are there.
    pub(crate) handshake: Duration,
    /// Time in which a client takes at least some of what waits for it.
    pub(crate) patience: Duration,
    /// Time for a client to answer the end of its stream.
    pub(crate) closing: Duration,
    /// Time for all clients to take the rest when the server ends.
    pub(crate) ending: Duration,
    /// Time from one status to the next.
    pub(crate) status: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            clients: 4,
            connections: 32,
            header_bytes: 16 << 10,
            handshake: Duration::from_secs(5),
            // A browser that is stopped for less loses records and nothing else.
            patience: Duration::from_secs(30),
            closing: Duration::from_secs(1),
            ending: Duration::from_secs(2),
            status: Duration::from_secs(1),
        }
    }
}

/// State that all connections share.
pub(crate) struct Site {
    gate: Gate,
    pub(crate) hello: watch::Sender<Utf8Bytes>,
    pub(crate) notices: broadcast::Sender<String>,
    source: Source,
    pub(crate) packets: broadcast::Sender<Published>,
    connections: Arc<Semaphore>,
    seats: Arc<Semaphore>,
    refused: AtomicU64,
    buses: Mutex<Vec<BusLoad>>,
    pub(crate) limits: Limits,
    /// The message with which the run ended.
    ending: watch::Receiver<Option<String>>,
}

impl Site {
    pub(crate) fn stream(&self) -> Option<&Stream> {
        match &self.source {
            Source::Live(stream) | Source::Play(stream, _) => Some(stream),
            Source::Recordings(_) => None,
        }
    }

    /// Desk that takes the orders of clients, if there is one.
    pub(crate) fn desk(&self) -> Option<&Desk> {
        match &self.source {
            Source::Play(_, desk) => Some(desk),
            Source::Live(_) | Source::Recordings(_) => None,
        }
    }

    pub(crate) fn buses(&self) -> MutexGuard<'_, Vec<BusLoad>> {
        self.buses.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Clients of the stream.
    pub(crate) fn clients(&self) -> usize {
        self.limits.clients - self.seats.available_permits()
    }

    pub(crate) fn refused(&self) -> u64 {
        self.refused.load(Ordering::Relaxed)
    }

    pub(crate) fn refuse(&self) {
        self.refused.fetch_add(1, Ordering::Relaxed);
    }

    /// Returns when the server ends, with the message; `None` if it was dropped.
    pub(crate) async fn ended(&self) -> Option<String> {
        self.ending.clone().wait_for(Option::is_some).await.ok().and_then(|message| message.clone())
    }

    /// Records for which the ring of the stream had no room.
    pub(crate) fn lost(&self) -> u64 {
        self.stream().map_or(0, |stream| stream.figures().lost)
    }
}

/// A place among the clients of the stream; held for as long as the client is there.
pub(crate) type Seat = OwnedSemaphorePermit;

/// A server with its thread. It ends when it is dropped; [`Server::end`] also says why.
pub struct Server {
    address: SocketAddr,
    site: Arc<Site>,
    end: Option<watch::Sender<Option<String>>>,
    thread: Option<JoinHandle<()>>,
}

impl std::fmt::Debug for Server {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Server").field("address", &self.address).finish_non_exhaustive()
    }
}

impl Server {
    /// Starts to serve on `address`, with port 0 on any free port. The new thread has the scheduling policy and the processors
    /// of the calling thread, which therefore must not be a real-time thread.
    ///
    /// # Errors
    /// If the address is not a loopback address or taken, `source` has nothing to show, or the system has no thread.
    pub fn start(address: SocketAddr, hello: Hello, source: Source) -> Result<Self, StartError> {
        Self::start_within(Limits::default(), address, hello, source)
    }

    pub(crate) fn start_within(
        limits: Limits,
        address: SocketAddr,
        hello: Hello,
        source: Source,
    ) -> Result<Self, StartError> {
        if !address.ip().is_loopback() {
            return Err(StartError::NotLoopback(address));
        }
        let hello = first_message(&hello, &source)?;
        let packets = match &source {
            Source::Live(stream) | Source::Play(stream, _) => stream.packets().clone(),
            // No packet is ever sent.
            Source::Recordings(_) => broadcast::Sender::new(1),
        };
        let start = || {
            let runtime = tokio::runtime::Builder::new_current_thread()
                .enable_all()
                .max_blocking_threads(READERS)
                .thread_name("view reader")
                .build()?;
            let listener = std::net::TcpListener::bind(address)?;
            listener.set_nonblocking(true)?;
            let address = listener.local_addr()?;
            let listener = {
                let _context = runtime.enter();
                TcpListener::from_std(listener)?
            };
            let (end, ending) = watch::channel(None);
            let site = Arc::new(Site {
                gate: Gate::new(address, Token::draw()?),
                hello: watch::Sender::new(hello.into()),
                notices: broadcast::Sender::new(NOTICES),
                source,
                packets,
                connections: Arc::new(Semaphore::new(limits.connections)),
                seats: Arc::new(Semaphore::new(limits.clients)),
                refused: AtomicU64::new(0),
                buses: Mutex::default(),
                limits,
                ending,
            });
            let served = Arc::clone(&site);
            let thread = std::thread::Builder::new().name("view server".to_owned());
            let thread = thread.spawn(move || run(runtime, listener, &served))?;
            Ok(Self { address, site, end: Some(end), thread: Some(thread) })
        };
        start().map_err(|error| StartError::Io { address, error })
    }

    /// Returns the address to which the server is bound.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Returns the address of the page with the token: `http://127.0.0.1:PORT/#TOKEN`. It is a secret: with it any
    /// user of this computer can look at the rig.
    pub fn address_line(&self) -> String {
        format!("http://{}/#{}", self.address, self.site.gate.token().digits())
    }

    /// Sets the loads of the buses, which clients get within a second.
    pub fn set_buses(&self, loads: Vec<BusLoad>) {
        *self.site.buses() = loads;
    }

    /// Sends all clients, now and from now on, another description of the machine.
    ///
    /// # Errors
    /// If the description has no form in JSON.
    pub fn describe(&self, hello: &Hello) -> Result<(), StartError> {
        self.site.hello.send_replace(first_message(hello, &self.site.source)?.into());
        Ok(())
    }

    /// Sends a sentence to the people at the page.
    pub fn notify(&self, message: &str) {
        // Without a client there is nobody to read it.
        let _ = self.site.notices.send(message.to_owned());
    }

    /// Returns how many connections, requests and messages were refused.
    pub fn refused(&self) -> u64 {
        self.site.refused()
    }

    /// Sends the end to all clients and stops, within a few seconds. `message` is one sentence. The feed of the stream should
    /// have finished before, so that its last records arrive.
    pub fn end(mut self, message: &str) {
        if let Some(end) = &self.end {
            end.send_replace(Some(message.to_owned()));
        }
        self.stop();
    }

    fn stop(&mut self) {
        self.end = None;
        if let Some(thread) = self.thread.take() {
            // A panic of the server does not stop the rig.
            let _ = thread.join();
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop();
    }
}

fn first_message(hello: &Hello, source: &Source) -> Result<String, StartError> {
    let (layout, recordings): (&Layout, Option<Vec<RecordingMessage<'_>>>) = match source {
        Source::Live(stream) | Source::Play(stream, _) => (stream.layout(), None),
        Source::Recordings(files) => {
            let layout = files.first().ok_or(StartError::NoRecording)?.layout();
            if files.iter().any(|file| file.layout() != layout) {
                return Err(StartError::MixedRecordings);
            }
            (layout, Some(files.iter().map(RecordingFile::message).collect()))
        }
    };
    hello.first_message(layout, recordings.as_deref()).map_err(StartError::Hello)
}

/// Runs the server until it is ended or dropped.
fn run(runtime: Runtime, listener: TcpListener, site: &Arc<Site>) {
    runtime.block_on(async {
        tokio::select! {
            () = accept(&listener, site) => {}
            _ = site.ended() => {}
        }
        drop(listener);
        // All permits are back when all connections are gone.
        let all = u32::try_from(site.limits.connections).unwrap_or(u32::MAX);
        let _ = timeout(site.limits.ending, site.connections.acquire_many(all)).await;
    });
    // Readers of recordings end with their clients.
    runtime.shutdown_background();
}

async fn accept(listener: &TcpListener, site: &Arc<Site>) {
    loop {
        match listener.accept().await {
            Ok((connection, _)) => match Arc::clone(&site.connections).try_acquire_owned() {
                Ok(permit) => drop(tokio::spawn(connect(connection, Arc::clone(site), permit))),
                Err(_) => site.refuse(),
            },
            // The process has no more descriptors, or the client is gone.
            Err(_) => sleep(Duration::from_millis(50)).await,
        }
    }
}

/// Serves one connection, which has one request.
async fn connect(connection: TcpStream, site: Arc<Site>, permit: OwnedSemaphorePermit) {
    // Without it a packet waits for the acknowledgement of the one before.
    let _ = connection.set_nodelay(true);
    let Limits { header_bytes, handshake, patience, .. } = site.limits;
    let permit = Arc::new(permit);
    let service = service_fn(|request: hyper::Request<Incoming>| {
        let (site, permit) = (Arc::clone(&site), Arc::clone(&permit));
        async move { Ok::<_, Infallible>(answer(request.map(Body::new), site, permit).await) }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(handshake)
        .max_buf_size(header_bytes)
        .serve_connection(TokioIo::new(Patient::new(connection, patience)), service)
        .with_upgrades();
    let mut connection = pin!(connection);
    let served = tokio::select! {
        served = connection.as_mut() => served,
        _ = site.ended() => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if served.is_err_and(|error| error.is_parse() || error.is_timeout()) {
        site.refuse();
    }
}

/// Answers a request. `permit` is that of its connection, and goes with a WebSocket.
async fn answer(request: Request, site: Arc<Site>, permit: Arc<OwnedSemaphorePermit>) -> Response {
    let (mut parts, _) = request.into_parts();
    let target = parts.uri.to_string();
    let headers: Vec<_> = parts.headers.iter().map(|(name, value)| (name.as_str(), value.as_bytes())).collect();
    let head = Head { method: parts.method.as_str(), target: &target, headers: &headers };
    let mut response = match site.gate.admit(head) {
        Ok(Wanted::File(File(PageFile { media_type, bytes, .. }))) => content(media_type, *bytes),
        Ok(Wanted::Metrics) => content(metrics::MEDIA_TYPE, metrics::render(&site)),
        Ok(Wanted::Recording(number)) => recording(&site, number).await,
        Ok(Wanted::Stream) => match WebSocketUpgrade::from_request_parts(&mut parts, &()).await {
            Ok(upgrade) => stream(upgrade, Arc::clone(&site), permit),
            Err(rejection) => {
                site.refuse();
                rejection.into_response()
            }
        },
        Err(refusal) => {
            site.refuse();
            let status = StatusCode::from_u16(refusal.status()).unwrap_or(StatusCode::FORBIDDEN);
            let mut response = (status, content(PLAIN_TEXT, format!("{refusal}\n"))).into_response();
            let hint = match status {
                StatusCode::METHOD_NOT_ALLOWED => Some((header::ALLOW, "GET")),
                StatusCode::UNAUTHORIZED => Some((header::WWW_AUTHENTICATE, "Bearer")),
                _ => None,
            };
            response.headers_mut().extend(hint.map(|(name, value)| (name, HeaderValue::from_static(value))));
            response
        }
    };
    response.headers_mut().extend(HEADERS.map(|(name, value)| (name, HeaderValue::from_static(value))));
    if response.status() != StatusCode::SWITCHING_PROTOCOLS {
        // A connection has one request; hyper's own switch for that also strikes the header of an upgrade.
        response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    response
}

fn content(media_type: &'static str, body: impl Into<Body>) -> Response {
    let mut response = Response::new(body.into());
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(media_type));
    response
}

async fn recording(site: &Site, number: usize) -> Response {
    let file = match &site.source {
        Source::Recordings(files) => files.get(number),
        Source::Live(_) | Source::Play(..) => None,
    };
    let Some(file) = file else {
        return (StatusCode::NOT_FOUND, content(PLAIN_TEXT, "there is no such recording\n")).into_response();
    };
    match file.body().await {
        Ok(body) => content("application/octet-stream", body),
        Err(error) => {
            let text = format!("{} {error}\n", file.path().display());
            (StatusCode::INTERNAL_SERVER_ERROR, content(PLAIN_TEXT, text)).into_response()
        }
    }
}

fn stream(upgrade: WebSocketUpgrade, site: Arc<Site>, permit: Arc<OwnedSemaphorePermit>) -> Response {
    let upgrade = upgrade.protocols([SUBPROTOCOL]).max_message_size(MAX_MESSAGE).max_frame_size(MAX_MESSAGE);
    let seat = Arc::clone(&site.seats).try_acquire_owned();
    if seat.is_err() {
        site.refuse();
    }
    upgrade.on_upgrade(async move |socket| {
        // The connection counts for as long as its socket is there.
        let _permit = permit;
        match seat {
            Ok(seat) => client::serve(socket, site, seat).await,
            Err(_) => client::turn_away(socket, site).await,
        }
    })
}
