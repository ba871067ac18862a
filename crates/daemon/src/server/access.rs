//! Who may connect: tokens and roles, the Origin of browsers, the Host they believe to speak to.

use std::net::IpAddr;

use axum::http::uri::{Authority, Uri};
use axum::http::{HeaderMap, StatusCode, header};
use subtle::{Choice, ConstantTimeEq};

use posed_stage::{Role, Secret, Token};

/// The rules of one server.
#[derive(Clone, Debug)]
pub(super) struct Access {
    pub(super) tokens: Vec<Token>,
    /// Origins from the stage file, in lower case.
    pub(super) allowed_origins: Vec<String>,
    /// Host of the listening address as it was written.
    pub(super) listen_host: String,
    pub(super) port: u16,
    pub(super) tls: bool,
}

/// A refusal: status and a sentence.
pub(super) type Refusal = (StatusCode, String);

impl Access {
    /// What the bearer of this request may do. Without tokens in the stage file (loopback only) everybody operates.
    pub(super) fn role(&self, headers: &HeaderMap, uri: &Uri) -> Result<Role, Refusal> {
        if self.tokens.is_empty() {
            return Ok(Role::Operate);
        }
        match self.role_of_token(headers, uri)? {
            Role::Sensor => {
                let message = "this token is for sensors: it may send to /imu, and nothing else";
                Err((StatusCode::FORBIDDEN, message.into()))
            }
            role => Ok(role),
        }
    }

    /// Whether the bearer of this request may send measurements, where a token is asked for.
    pub(super) fn may_send(&self, headers: &HeaderMap, uri: &Uri) -> Result<(), Refusal> {
        match self.role_of_token(headers, uri)? {
            Role::Sensor | Role::Operate => Ok(()),
            Role::Watch => {
                let message = "this token may watch; a sensor needs one with the role `sensor`";
                Err((StatusCode::FORBIDDEN, message.into()))
            }
        }
    }

    /// Whether the request has this token.
    pub(super) fn is_given(headers: &HeaderMap, uri: &Uri, token: &Secret) -> bool {
        given(headers, uri).is_some_and(|given| bool::from(token.reveal().as_bytes().ct_eq(given.as_bytes())))
    }

    fn role_of_token(&self, headers: &HeaderMap, uri: &Uri) -> Result<Role, Refusal> {
        let Some(given) = given(headers, uri) else {
            let message = "this daemon asks for a token: `Authorization: Bearer TOKEN`, or `?token=TOKEN` in the address";
            return Err((StatusCode::UNAUTHORIZED, message.into()));
        };
        // Every token is compared in full, so that the time tells nothing about which one was nearly right.
        let mut role = None;
        for token in &self.tokens {
            // One whose file was not read lets nobody in.
            let Some(secret) = &token.secret else { continue };
            let equal: Choice = secret.reveal().as_bytes().ct_eq(given.as_bytes());
            if bool::from(equal) {
                role = role.max(Some(token.role));
            }
        }
        role.ok_or_else(|| (StatusCode::UNAUTHORIZED, "the stage file has no such token".into()))
    }

    /// Refuses a browser that was led here under a foreign name (DNS rebinding).
    pub(super) fn check_host(&self, headers: &HeaderMap, uri: &Uri) -> Result<(), Refusal> {
        let host = match headers.get(header::HOST) {
            Some(host) => host.to_str().ok().and_then(|host| host.parse::<Authority>().ok()),
            None => uri.authority().cloned(),
        };
        let Some(host) = host else {
            return Err((StatusCode::BAD_REQUEST, "the request needs a Host header".into()));
        };
        let name = host.host();
        let known = is_address(name)
            || is_localhost(name)
            || name.eq_ignore_ascii_case(&self.listen_host)
            || self.allowed_origins.iter().any(|origin| {
                Origin::parse(origin).is_some_and(|origin| origin.host.eq_ignore_ascii_case(name))
            });
        if known {
            return Ok(());
        }
        let message = format!(
            "this daemon does not answer to the name {name}: add its origin to server.allowed_origins"
        );
        Err((StatusCode::MISDIRECTED_REQUEST, message))
    }

    /// Refuses pages of other sites. Programs send no Origin.
    pub(super) fn check_origin(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        let Some(origin) = headers.get(header::ORIGIN) else { return Ok(()) };
        let text = origin.to_str().unwrap_or("").to_ascii_lowercase();
        if self.allowed_origins.contains(&text)
            || Origin::parse(&text).is_some_and(|o| self.is_own(&o, headers))
        {
            return Ok(());
        }
        let message =
            format!("pages of {text} may not connect: add it to server.allowed_origins if they should");
        Err((StatusCode::FORBIDDEN, message))
    }

    /// The same for what sends measurements: a page without an origin (an app's, a file's) may, where it brings a token.
    pub(super) fn check_origin_of_sensor(&self, headers: &HeaderMap, has_token: bool) -> Result<(), Refusal> {
        match headers.get(header::ORIGIN) {
            Some(origin) if has_token && origin == "null" => Ok(()),
            _ => self.check_origin(headers),
        }
    }

    /// Our own page, however this machine was named, or another name of this machine's loopback.
    fn is_own(&self, origin: &Origin<'_>, headers: &HeaderMap) -> bool {
        let scheme = if self.tls { "https" } else { "http" };
        if origin.scheme != scheme {
            return false;
        }
        let host = headers.get(header::HOST).and_then(|host| host.to_str().ok()).unwrap_or("");
        origin.authority.eq_ignore_ascii_case(host)
            || origin.port == Some(self.port) && (is_localhost(origin.host) || is_loopback(origin.host))
    }
}

/// The token that a request brings.
fn given(headers: &HeaderMap, uri: &Uri) -> Option<String> {
    let bearer = headers
        .get(header::AUTHORIZATION)
        .and_then(|value| value.to_str().ok())
        .and_then(|value| value.split_once(' '))
        .filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer"))
        .map(|(_, token)| token.trim().to_owned());
    bearer.or_else(|| query_token(uri))
}

/// An `Origin` header taken apart: `scheme://host[:port]`, nothing behind.
struct Origin<'a> {
    scheme: &'a str,
    authority: &'a str,
    host: &'a str,
    port: Option<u16>,
}

impl<'a> Origin<'a> {
    fn parse(text: &'a str) -> Option<Self> {
        let (scheme, authority) = text.split_once("://")?;
        if authority.contains(['/', '@', '?', '#']) {
            return None;
        }
        let (host, port) = match authority.rsplit_once(':') {
            Some((host, port)) if !port.ends_with(']') => (host, Some(port.parse().ok()?)),
            _ => (authority, None),
        };
        Some(Self { scheme, authority, host, port })
    }
}

fn is_localhost(host: &str) -> bool {
    host.eq_ignore_ascii_case("localhost")
}

fn address(host: &str) -> Option<IpAddr> {
    host.trim_start_matches('[').trim_end_matches(']').parse().ok()
}

fn is_address(host: &str) -> bool {
    address(host).is_some()
}

fn is_loopback(host: &str) -> bool {
    address(host).is_some_and(|address| address.is_loopback())
}

/// `token` of the query, percent-decoded; `k`, as devices of the open format write it, says the same.
fn query_token(uri: &Uri) -> Option<String> {
    let of_key = |key: &str| uri.query()?.split('&').find_map(|pair| pair.strip_prefix(key));
    let token = of_key("token=").or_else(|| of_key("k="))?;
    let mut bytes = token.bytes();
    let mut decoded = Vec::with_capacity(token.len());
    while let Some(byte) = bytes.next() {
        decoded.push(match byte {
            b'%' => {
                let mut digit = || bytes.next().and_then(|digit| (digit as char).to_digit(16));
                (digit()? * 16 + digit()?) as u8
            }
            b'+' => b' ',
            byte => byte,
        });
    }
    String::from_utf8(decoded).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn access(tokens: &[(&str, Role)]) -> Access {
        Access {
            tokens: tokens
                .iter()
                .map(|(secret, role)| Token {
                    secret: Some((*secret).to_owned().into()),
                    secret_file: None,
                    role: *role,
                })
                .collect(),
            allowed_origins: vec!["https://trainer.example".into()],
            listen_host: "stage-a.local".into(),
            port: 8787,
            tls: false,
        }
    }

    fn headers(pairs: &[(header::HeaderName, &str)]) -> HeaderMap {
        pairs.iter().map(|(name, value)| (name.clone(), value.parse().unwrap())).collect()
    }

    fn role(access: &Access, authorization: Option<&str>, uri: &str) -> Result<Role, StatusCode> {
        let pairs: Vec<_> = authorization.map(|value| (header::AUTHORIZATION, value)).into_iter().collect();
        access.role(&headers(&pairs), &uri.parse().unwrap()).map_err(|(status, _)| status)
    }

    #[test]
    fn a_token_gives_its_role() {
        let open = access(&[]);
        assert_eq!(role(&open, None, "/ws"), Ok(Role::Operate));
        let closed = access(&[("watch-watch-watch", Role::Watch), ("operate/operate+1", Role::Operate)]);
        assert_eq!(role(&closed, None, "/ws"), Err(StatusCode::UNAUTHORIZED));
        assert_eq!(role(&closed, Some("Bearer watch-watch-watch"), "/ws"), Ok(Role::Watch));
        assert_eq!(role(&closed, Some("bearer operate/operate+1"), "/ws"), Ok(Role::Operate));
        assert_eq!(role(&closed, None, "/ws?a=b&token=operate%2Foperate%2B1"), Ok(Role::Operate));
        for wrong in ["", "watch-watch-watc", "watch-watch-watch2", "%", "%2", "%zz"] {
            assert_eq!(role(&closed, None, &format!("/ws?token={wrong}")), Err(StatusCode::UNAUTHORIZED));
        }
    }

    #[test]
    fn a_token_for_sensors_sends_and_opens_nothing_else() {
        let access = access(&[
            ("sensor-sensor-sensor", Role::Sensor),
            ("watch-watch-watch", Role::Watch),
            ("operate-operate", Role::Operate),
        ]);
        let sends = |token: &str| {
            let uri = format!("/imu?k={token}").parse().unwrap();
            access.may_send(&HeaderMap::new(), &uri).map_err(|(status, _)| status)
        };
        assert_eq!(role(&access, Some("Bearer sensor-sensor-sensor"), "/ws"), Err(StatusCode::FORBIDDEN));
        assert_eq!((sends("sensor-sensor-sensor"), sends("operate-operate")), (Ok(()), Ok(())));
        assert_eq!(sends("watch-watch-watch"), Err(StatusCode::FORBIDDEN));
        assert_eq!(sends("another"), Err(StatusCode::UNAUTHORIZED));
        let own = Secret::from("own-own-own-own-own".to_owned());
        let given = |uri: &str| Access::is_given(&HeaderMap::new(), &uri.parse().unwrap(), &own);
        assert!(given("/imu?k=own-own-own-own-own") && !given("/imu?k=own-own-own-own-ow") && !given("/imu"));
        let of = |origin: &str| headers(&[(header::HOST, "127.0.0.1:8787"), (header::ORIGIN, origin)]);
        assert!(access.check_origin_of_sensor(&of("null"), true).is_ok());
        assert!(access.check_origin_of_sensor(&of("null"), false).is_err());
        assert!(access.check_origin_of_sensor(&of("http://evil.example"), true).is_err());
    }

    #[test]
    fn only_own_and_listed_origins_pass() {
        let access = access(&[]);
        let status = |host: &str, origin: &str| {
            let headers = headers(&[(header::HOST, host), (header::ORIGIN, origin)]);
            access.check_origin(&headers).err().map(|(status, _)| status)
        };
        assert!(access.check_origin(&HeaderMap::new()).is_ok(), "programs send none");
        assert_eq!(status("127.0.0.1:8787", "http://127.0.0.1:8787"), None);
        assert_eq!(status("127.0.0.1:8787", "http://localhost:8787"), None);
        assert_eq!(status("[::1]:8787", "http://[::1]:8787"), None);
        assert_eq!(status("192.168.1.5:8787", "http://192.168.1.5:8787"), None);
        assert_eq!(status("127.0.0.1:8787", "https://trainer.example"), None);
        for foreign in [
            "http://evil.example",
            "http://localhost:9999",
            "https://localhost:8787",
            "http://trainer.example",
            "http://127.0.0.1:8787@evil.example",
            "http://127.0.0.1:8787.evil.example",
            "null",
            "",
        ] {
            assert_eq!(status("127.0.0.1:8787", foreign), Some(StatusCode::FORBIDDEN), "{foreign}");
        }
    }

    #[test]
    fn only_known_hosts_are_answered() {
        let access = access(&[]);
        let status = |host: &str| {
            access
                .check_host(&headers(&[(header::HOST, host)]), &Uri::default())
                .err()
                .map(|(status, _)| status)
        };
        for host in
            ["127.0.0.1:8787", "[::1]:8787", "localhost", "10.0.0.7:80", "STAGE-A.local", "trainer.example"]
        {
            assert_eq!(status(host), None, "{host}");
        }
        assert_eq!(status("rebound.evil.example:8787"), Some(StatusCode::MISDIRECTED_REQUEST));
        assert_eq!(status("a b"), Some(StatusCode::BAD_REQUEST));
        assert!(access.check_host(&HeaderMap::new(), &Uri::default()).is_err());
    }
}
