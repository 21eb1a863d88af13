//! The gate of the live page: heads of requests.

use yieldwall_view::gate::{Gate, Head, Refusal, Token, Wanted};

/// Address of the server.
const ADDRESS: &str = "127.0.0.1:8080";
/// Digits of its token.
const TOKEN: &str = "5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a";

/// Bytes read as a head: method and target up to the first line's end, then a header a line.
struct Text<'a> {
    method: String,
    target: String,
    headers: Vec<(String, &'a [u8])>,
}

impl<'a> Text<'a> {
    fn of(bytes: &'a [u8]) -> Self {
        let mut lines = bytes.split(|byte| *byte == b'\n');
        let first = String::from_utf8_lossy(lines.next().unwrap_or_default()).into_owned();
        let (method, target) = first.split_once(' ').unwrap_or((&first, ""));
        let header = |line: &'a [u8]| {
            let colon = line.iter().position(|byte| *byte == b':')?;
            let (name, value) = line.split_at(colon);
            Some((String::from_utf8_lossy(name).to_lowercase(), value[1..].trim_ascii()))
        };
        Self { method: method.to_owned(), target: target.to_owned(), headers: lines.filter_map(header).collect() }
    }

    /// The answer of a gate to this head with more headers behind its own.
    fn at(&self, gate: &Gate, more: &[(&str, &[u8])]) -> Result<Wanted, Refusal> {
        let own = self.headers.iter().map(|(name, value)| (name.as_str(), *value));
        let headers: Vec<_> = own.chain(more.iter().copied()).collect();
        gate.admit(Head { method: &self.method, target: &self.target, headers: &headers })
    }

    fn values(&self, name: &str) -> Vec<&'a [u8]> {
        self.headers.iter().filter(|(this, _)| this == name).map(|(_, value)| *value).collect()
    }
}

fn gate(byte: u8) -> Gate {
    Gate::new(ADDRESS.parse().expect("an address"), Token::of_bytes([byte; 16]))
}

/// Any head of a request: it is refused, or is GET with a host and an origin of the server, and with the token where it asks
/// for data. A foreign origin, a second host or another token turns an admission into a refusal.
///
/// # Panics
/// If a law is broken.
pub fn handshake(bytes: &[u8]) {
    let text = Text::of(bytes);
    let gate = gate(0x5a);
    let wanted = match text.at(&gate, &[]) {
        Ok(wanted) => wanted,
        Err(refusal) => {
            assert!((400..500).contains(&refusal.status()) && !refusal.to_string().is_empty());
            return;
        }
    };
    assert_eq!(text.method, "GET");
    let own: [&[u8]; 2] = [ADDRESS.as_bytes(), b"localhost:8080"];
    let hosts = text.values("host");
    assert!(hosts.len() == 1 && own.contains(&hosts[0]), "{hosts:?}");
    let origins = text.values("origin");
    let is_own = |origin: &[u8]| origin.strip_prefix(b"http://").is_some_and(|host| own.contains(&host));
    assert!(origins.len() <= 1 && origins.iter().all(|origin| is_own(origin)), "{origins:?}");
    assert!(matches!(text.at(&gate, &[("host", own[0])]), Err(Refusal::Host)));
    assert!(matches!(text.at(&gate, &[("origin", b"http://evil.example")]), Err(Refusal::Origin)));
    let elsewhere = text.at(&self::gate(0xa5), &[]);
    let secret = match wanted {
        Wanted::File(_) => return assert!(elsewhere.is_ok()),
        Wanted::Stream => {
            assert_eq!(origins.len(), 1);
            "sec-websocket-protocol"
        }
        Wanted::Recording(_) | Wanted::Metrics => "authorization",
    };
    assert!(matches!(elsewhere, Err(Refusal::Token)));
    let has_token = |value: &[u8]| value.windows(TOKEN.len()).any(|part| part == TOKEN.as_bytes());
    assert!(text.values(secret).into_iter().any(has_token));
}

pub(super) fn heads() -> Vec<Vec<u8>> {
    let own = format!("host: {ADDRESS}\norigin: http://{ADDRESS}");
    let bearer = format!("authorization: Bearer {TOKEN}");
    [
        format!("GET /\n{own}"),
        format!("GET /stream\n{own}\nsec-websocket-protocol: yieldwall.v1, token.{TOKEN}"),
        format!("GET /recordings/3\nhost: localhost:8080\n{bearer}"),
        format!("GET /metrics\n{own}\n{bearer}"),
    ]
    .map(String::into_bytes)
    .into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn good_heads_are_admitted() {
        for head in heads() {
            assert!(Text::of(&head).at(&gate(0x5a), &[]).is_ok(), "{}", String::from_utf8_lossy(&head));
        }
    }
}
