use proptest::prelude::*;

use crate::gate::{Gate, Head, Refusal, Token, Wanted};

const PORT: &str = "127.0.0.1:8080";

fn gate() -> Gate {
    Gate::new(PORT.parse().unwrap(), Token::of_bytes([0xab; 16]))
}

fn admit(target: &str, headers: &[(&str, &str)]) -> Result<Wanted, Refusal> {
    let headers: Vec<_> = headers.iter().map(|(name, value)| (*name, value.as_bytes())).collect();
    gate().admit(Head { method: "GET", target, headers: &headers })
}

const TOKEN: &str = "abababababababababababababababab";

#[test]
fn hosts_and_origins_are_compared_with_exact_lists() {
    for host in ["127.0.0.1:8080", "localhost:8080"] {
        assert!(matches!(admit("/", &[("host", host)]), Ok(Wanted::File(_))), "{host}");
        let origin = format!("http://{host}");
        assert!(admit("/", &[("host", "localhost:8080"), ("origin", &origin)]).is_ok(), "{host}");
    }
    let foreign = [
        "evil.example:8080",
        "127.0.0.1.evil.example:8080",
        "127.0.0.2:8080",
        "127.0.0.1:8081",
        "127.0.0.1",
        "[::1]:8080",
        "LOCALHOST:8080",
        "localhost:8080 ",
        "",
    ];
    for host in foreign {
        assert_eq!(admit("/", &[("host", host)]).unwrap_err(), Refusal::Host, "{host}");
        // Equal to each other, as under a host name that an attacker controls.
        let origin = format!("http://{host}");
        assert_eq!(admit("/", &[("host", host), ("origin", &origin)]).unwrap_err(), Refusal::Host, "{host}");
        let headers = [("host", PORT), ("origin", origin.as_str())];
        assert_eq!(admit("/", &headers).unwrap_err(), Refusal::Origin, "{host}");
    }
    for origin in ["null", "https://127.0.0.1:8080", "http://127.0.0.1:8080/", "127.0.0.1:8080"] {
        assert_eq!(admit("/", &[("host", PORT), ("origin", origin)]).unwrap_err(), Refusal::Origin, "{origin}");
    }
    assert_eq!(admit("/", &[]).unwrap_err(), Refusal::Host);
    assert_eq!(admit("/", &[("host", PORT), ("host", PORT)]).unwrap_err(), Refusal::Host);
    let own = "http://127.0.0.1:8080";
    assert_eq!(admit("/", &[("host", PORT), ("origin", own), ("origin", own)]).unwrap_err(), Refusal::Origin);
}

#[test]
fn a_server_has_the_names_of_its_own_address() {
    let admits = |address: &str, host: &str| {
        let gate = Gate::new(address.parse().unwrap(), Token::of_bytes([0; 16]));
        gate.admit(Head { method: "GET", target: "/", headers: &[("host", host.as_bytes())] }).is_ok()
    };
    assert!(admits("[::1]:8080", "[::1]:8080") && admits("[::1]:8080", "localhost:8080"));
    assert!(!admits("[::1]:8080", "127.0.0.1:8080"));
    assert!(admits("127.0.0.5:8080", "127.0.0.5:8080") && !admits("127.0.0.5:8080", PORT));
    assert!(admits("127.0.0.1:80", "localhost") && admits("127.0.0.1:80", "127.0.0.1:80"));
}

#[test]
fn data_needs_the_token() {
    let bearer = |value: &str| admit("/metrics", &[("host", PORT), ("authorization", value)]);
    assert!(matches!(bearer(&format!("Bearer {TOKEN}")), Ok(Wanted::Metrics)));
    let longer = format!("Bearer {TOKEN}0");
    let other = format!("Bearer {}", TOKEN.replace('a', "c"));
    for value in ["", "Bearer ", "Bearer", TOKEN, "Basic YTpi", &longer[..longer.len() - 2], &longer, &other] {
        assert_eq!(bearer(value).unwrap_err(), Refusal::Token, "{value}");
    }
    assert_eq!(admit("/metrics", &[("host", PORT)]).unwrap_err(), Refusal::Token);
    assert_eq!(admit(&format!("/metrics?token={TOKEN}"), &[("host", PORT)]).unwrap_err(), Refusal::Target);
    let authorization = format!("Bearer {TOKEN}");
    let recording = |target: &str| admit(target, &[("host", PORT), ("authorization", &authorization)]);
    assert!(matches!(recording("/recordings/12"), Ok(Wanted::Recording(12))));
    for target in ["/recordings/", "/recordings/01", "/recordings/+1", "/recordings/1/", "/recordings/../view.js"] {
        assert_eq!(recording(target).unwrap_err(), Refusal::Target, "{target}");
    }
}

#[test]
fn a_stream_needs_its_origin_and_the_token_among_its_protocols() {
    let with = |protocols: &[&str]| {
        let mut headers = vec![("host", PORT), ("origin", "http://localhost:8080")];
        headers.extend(protocols.iter().map(|protocols| ("sec-websocket-protocol", *protocols)));
        admit("/stream", &headers)
    };
    let token = format!("token.{TOKEN}");
    let both = format!("yieldwall.v1, {token}");
    assert!(matches!(with(&[&both]), Ok(Wanted::Stream)));
    assert!(matches!(with(&[&token, "yieldwall.v1"]), Ok(Wanted::Stream)));
    let wrong = both.replace("ab", "ba");
    for protocols in [&[][..], &["yieldwall.v1"], &[&token], &[&wrong], &[&both, &wrong], &[&both, "other"]] {
        assert_eq!(with(protocols).unwrap_err(), Refusal::Token, "{protocols:?}");
    }
    let headers = [("host", PORT), ("sec-websocket-protocol", both.as_str())];
    assert_eq!(admit("/stream", &headers).unwrap_err(), Refusal::Origin);
}

#[test]
fn get_is_the_only_method() {
    for method in ["POST", "HEAD", "OPTIONS", "PUT", "get", "CONNECT", ""] {
        let head = Head { method, target: "/", headers: &[("host", PORT.as_bytes())] };
        assert_eq!(gate().admit(head).unwrap_err(), Refusal::Method);
    }
}

#[test]
fn tokens_are_drawn_and_do_not_show() {
    let (one, other) = (Token::draw().unwrap(), Token::draw().unwrap());
    assert!(one.digits() != other.digits() && one.digits().len() == 32);
    assert!(!format!("{:?}", Gate::new(PORT.parse().unwrap(), one.clone())).contains(one.digits()));
}

proptest! {
    /// A token with one other byte opens no door.
    #[test]
    fn a_token_with_one_change_is_refused(place in 0..32_usize, byte in any::<u8>()) {
        let mut offered = TOKEN.as_bytes().to_vec();
        offered[place] = byte;
        let authorization = [b"Bearer ", &offered[..]].concat();
        let headers = [("host", PORT.as_bytes()), ("authorization", &authorization[..])];
        let admitted = gate().admit(Head { method: "GET", target: "/metrics", headers: &headers });
        prop_assert_eq!(admitted.is_ok(), offered == TOKEN.as_bytes());
    }
}
