//! Admission of requests, by their head alone: a pure function of method, target and headers.
//!
//! A web page of a foreign origin can make a browser on this computer send requests to the server, also under a host name
//! that resolves to 127.0.0.1. `Host` and `Origin` are therefore each compared with an exact list; neither is compared
//! with the other. Another user of the computer can send any header, and lacks the token.

use std::fmt;
use std::hint::black_box;
use std::io;
use std::net::SocketAddr;

use crate::files::{FILES, PageFile};

/// Subprotocol of the stream.
pub const SUBPROTOCOL: &str = "yieldwall.v1";
/// Prefix of the token among the subprotocols of a WebSocket.
const TOKEN_PROTOCOL: &str = "token.";
/// Prefix of the token in the header `Authorization`.
const BEARER: &str = "Bearer ";

/// Secret of 128 bits, 32 hexadecimal digits, which the page sends with each request for data. `Debug` hides it.
#[derive(Clone)]
pub struct Token(String);

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(..)")
    }
}

impl Token {
    /// Draws a token from the randomness of the operating system.
    ///
    /// # Errors
    /// If the operating system has none.
    pub fn draw() -> io::Result<Self> {
        let mut bytes = [0; 16];
        getrandom::fill(&mut bytes)?;
        Ok(Self::of_bytes(bytes))
    }

    /// Returns the token of these bytes.
    pub fn of_bytes(bytes: [u8; 16]) -> Self {
        Self(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
    }

    /// Returns the digits.
    pub fn digits(&self) -> &str {
        &self.0
    }

    /// Compares in a time that does not depend on the place of a difference.
    fn is(&self, offered: &[u8]) -> bool {
        let differences = self.0.bytes().zip(offered).fold(0, |all, (ours, theirs)| black_box(all | (ours ^ theirs)));
        offered.len() == self.0.len() && differences == 0
    }
}

/// Head of a request.
#[derive(Clone, Copy, Debug)]
pub struct Head<'a> {
    /// Method, such as `GET`.
    pub method: &'a str,
    /// Target as it stands in the first line.
    pub target: &'a str,
    /// Headers: names in lower case, and values.
    pub headers: &'a [(&'a str, &'a [u8])],
}

impl<'a> Head<'a> {
    /// The values of the headers with this name.
    fn values(self, name: &'static str) -> impl Iterator<Item = &'a [u8]> {
        self.headers.iter().filter(move |(this, _)| *this == name).map(|(_, value)| *value)
    }

    /// The value of the only header with this name.
    fn value(self, name: &'static str) -> Option<&'a [u8]> {
        let mut values = self.values(name);
        values.next().filter(|_| values.next().is_none())
    }
}

/// A request that was admitted.
#[derive(Clone, Copy, Debug)]
pub enum Wanted {
    /// A file of the page.
    File(File),
    /// The stream, over a WebSocket.
    Stream,
    /// The recording of this number.
    Recording(usize),
    /// The metrics.
    Metrics,
}

/// A file of the page.
#[derive(Clone, Copy, Debug)]
pub struct File(pub(crate) &'static PageFile);

/// Reason why a request was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// A method other than GET.
    #[error("this server answers GET alone")]
    Method,
    /// `Host` is missing, repeated or not an address of this server.
    #[error("the header Host is not an address of this server")]
    Host,
    /// `Origin` is repeated or not an address of this server, or a WebSocket has none.
    #[error("the header Origin is not an address of this server")]
    Origin,
    /// A path that does not exist.
    #[error("this server has no such path")]
    Target,
    /// The token is missing or wrong.
    #[error("the token is missing or wrong; the command that serves the page prints it as part of the address")]
    Token,
}

impl Refusal {
    /// Returns the status of the response.
    pub fn status(self) -> u16 {
        match self {
            Refusal::Method => 405,
            Refusal::Host | Refusal::Origin => 403,
            Refusal::Target => 404,
            Refusal::Token => 401,
        }
    }
}

/// Gate of a server.
#[derive(Clone, Debug)]
pub struct Gate {
    /// Values of `Host`.
    hosts: Vec<String>,
    /// Values of `Origin`.
    origins: Vec<String>,
    token: Token,
}

impl Gate {
    /// Returns the gate of a server that is bound to `address`, a loopback address.
    pub fn new(address: SocketAddr, token: Token) -> Self {
        let port = address.port();
        // Without a scope, which no browser sends.
        let mut hosts = vec![SocketAddr::new(address.ip(), port).to_string(), format!("localhost:{port}")];
        if port == 80 {
            // A browser leaves the usual port out.
            let short: Vec<_> = hosts.iter().filter_map(|host| host.strip_suffix(":80").map(str::to_owned)).collect();
            hosts.extend(short);
        }
        let origins = hosts.iter().map(|host| format!("http://{host}")).collect();
        Self { hosts, origins, token }
    }

    /// Returns the token.
    pub fn token(&self) -> &Token {
        &self.token
    }

    /// Admits a request or refuses it.
    ///
    /// # Errors
    /// The first reason for a refusal: method, `Host`, `Origin`, path, token.
    pub fn admit(&self, head: Head<'_>) -> Result<Wanted, Refusal> {
        let is_of = |list: &[String], value: &[u8]| list.iter().any(|entry| entry.as_bytes() == value);
        if head.method != "GET" {
            return Err(Refusal::Method);
        }
        if !head.value("host").is_some_and(|host| is_of(&self.hosts, host)) {
            return Err(Refusal::Host);
        }
        let origin = head.value("origin");
        if head.values("origin").count() > 1 || origin.is_some_and(|origin| !is_of(&self.origins, origin)) {
            return Err(Refusal::Origin);
        }
        if let Some(file) = FILES.iter().find(|file| file.path == head.target) {
            return Ok(Wanted::File(File(file)));
        }
        let wanted = match head.target {
            "/stream" => Wanted::Stream,
            "/metrics" => Wanted::Metrics,
            target => Wanted::Recording(recording(target).ok_or(Refusal::Target)?),
        };
        let has_token = match wanted {
            Wanted::Stream if origin.is_none() => return Err(Refusal::Origin),
            Wanted::Stream => self.is_token_among_protocols(head),
            _ => {
                let bearer = head.value("authorization").and_then(|value| value.strip_prefix(BEARER.as_bytes()));
                bearer.is_some_and(|token| self.token.is(token))
            }
        };
        if has_token { Ok(wanted) } else { Err(Refusal::Token) }
    }

    /// Whether the subprotocols are the stream's and the token, in any order.
    fn is_token_among_protocols(&self, head: Head<'_>) -> bool {
        let values = head.values("sec-websocket-protocol");
        let mut protocols = values.flat_map(|value| value.split(|byte| *byte == b',')).map(<[u8]>::trim_ascii);
        let (mut is_ours, mut has_token) = (false, false);
        let is_known = protocols.all(|protocol| match protocol.strip_prefix(TOKEN_PROTOCOL.as_bytes()) {
            Some(token) => {
                has_token = self.token.is(token);
                has_token
            }
            None => {
                is_ours = protocol == SUBPROTOCOL.as_bytes();
                is_ours
            }
        });
        is_known && is_ours && has_token
    }
}

/// The number in `/recordings/N`, written in one way only.
fn recording(target: &str) -> Option<usize> {
    let digits = target.strip_prefix("/recordings/")?;
    let number = digits.parse::<usize>().ok()?;
    (number.to_string() == digits).then_some(number)
}
