//! Why there is no link to an address: zenoh tries again for ever and says nothing, so this tries once, and says how far it came.
//!
//! In: an address to connect to, and with what. Out: what stands in the way, as a problem for status or log. Never: a link of its own that
//! lasts, or a secret in a sentence.

use std::fmt::Display;
use std::io::{self, ErrorKind, Read};
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::time::Duration;

use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use tokio_rustls::rustls::{self, ClientConfig, ClientConnection, RootCertStore};

use posed_protocol::Problem;
use posed_stage::{Zenoh, ZenohTls};

/// Longest wait for an answer. A TLS end says within it that it does not take a certificate; a plain one waits for us.
const PATIENCE: Duration = Duration::from_secs(1);

/// What is in the way of a link to `end`, an address of `settings.connect`; blocks for some seconds. Everything up to zenoh's own greeting is tried:
/// where that works, it is there that the link is refused.
pub(crate) fn obstacle(end: &str, settings: &Zenoh) -> Problem {
    let problem = |code: &str, message: String| {
        Problem::new(code, format!("no link to {end}: {message}")).with("at", end)
    };
    let (protocol, address) = end.split_once('/').unwrap_or(("tcp", end));
    let mut stream = match connected(address) {
        Ok(stream) => stream,
        Err(error) => {
            let message = format!("{error}; is it running, and is the address right?");
            return problem("zenoh_unreachable", message).with("reason", error);
        }
    };
    let found = match (protocol, &settings.tls) {
        ("tls", Some(tls)) => handshake(&mut stream, address, tls),
        _ if greets_in_tls(&mut stream) => Err(Found::SpeaksTls),
        _ => Ok(()),
    };
    match found {
        Err(Found::SpeaksTls) => problem(
            "zenoh_speaks_tls",
            "it takes encrypted links only: write tls/ before the address, and [zenoh.tls]".to_owned(),
        ),
        Err(Found::SpeaksPlain) => problem(
            "zenoh_speaks_plain",
            "its links are not encrypted: write tcp/ before the address, or give it [zenoh.tls]".to_owned(),
        ),
        Err(Found::Certificate(reason)) => {
            problem("zenoh_certificate", format!("the certificates do not fit: {reason}"))
                .with("reason", reason)
        }
        Ok(()) if settings.user.is_some() => problem(
            "zenoh_password",
            "it is there, and refuses this name and password, or speaks another version of zenoh".to_owned(),
        ),
        Ok(()) => {
            let message = "it is there, and refuses the link: it asks for a name and a password, or speaks another version of zenoh";
            problem("zenoh_refused", message.to_owned())
        }
    }
}

/// Where it ended.
enum Found {
    SpeaksTls,
    SpeaksPlain,
    Certificate(String),
}

fn connected(address: &str) -> io::Result<TcpStream> {
    let mut last = io::Error::new(ErrorKind::NotFound, "it has no address");
    for address in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, PATIENCE) {
            Ok(stream) => {
                stream.set_read_timeout(Some(PATIENCE))?;
                stream.set_write_timeout(Some(PATIENCE))?;
                return Ok(stream);
            }
            Err(error) => last = error,
        }
    }
    Err(last)
}

/// Whether the other end answers the beginning of TLS with TLS.
fn greets_in_tls(stream: &mut TcpStream) -> bool {
    const HANDSHAKE: u8 = 22;
    const ALERT: u8 = 21;
    let begun = || -> Result<ClientConnection, Found> {
        let config = builder()?.with_root_certificates(RootCertStore::empty()).with_no_client_auth();
        let name = ServerName::try_from("localhost").map_err(certificate)?;
        ClientConnection::new(Arc::new(config), name).map_err(certificate)
    };
    let Ok(mut connection) = begun() else { return false };
    let mut first = [0];
    connection.write_tls(stream).is_ok()
        && stream.read_exact(&mut first).is_ok()
        && matches!(first[0], HANDSHAKE | ALERT)
}

/// Greets by TLS as zenoh does.
fn handshake(stream: &mut TcpStream, address: &str, tls: &ZenohTls) -> Result<(), Found> {
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let name = ServerName::try_from(host.trim_matches(['[', ']']).to_owned()).map_err(certificate)?;
    let mut roots = RootCertStore::empty();
    for authority in chain(&tls.authority)? {
        roots.add(authority).map_err(certificate)?;
    }
    let key = PrivateKeyDer::from_pem_file(&tls.key).map_err(|error| unread(&tls.key, error))?;
    let config = builder()?.with_root_certificates(roots);
    let config = config.with_client_auth_cert(chain(&tls.certificate)?, key).map_err(certificate)?;
    let mut connection = ClientConnection::new(Arc::new(config), name).map_err(certificate)?;
    let refused = |error: io::Error| {
        let of_tls = error.get_ref().and_then(|error| error.downcast_ref::<rustls::Error>());
        match of_tls {
            Some(rustls::Error::InvalidMessage(_)) => Found::SpeaksPlain,
            Some(error) => Found::Certificate(error.to_string()),
            // It hangs up, or waits for a greeting that it understands.
            None => Found::SpeaksPlain,
        }
    };
    while connection.is_handshaking() {
        connection.complete_io(stream).map_err(refused)?;
    }
    // Whether it takes our certificate it says only now, or says nothing and waits for zenoh.
    match connection.complete_io(stream) {
        Err(error)
            if !matches!(
                error.kind(),
                ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::UnexpectedEof
            ) =>
        {
            Err(refused(error))
        }
        _ => Ok(()),
    }
}

fn builder() -> Result<rustls::ConfigBuilder<ClientConfig, rustls::WantsVerifier>, Found> {
    let provider = Arc::new(ring::default_provider());
    // The only version that ends with certificates take, both ways.
    ClientConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&rustls::version::TLS13])
        .map_err(certificate)
}

fn chain(path: &std::path::Path) -> Result<Vec<CertificateDer<'static>>, Found> {
    let read = CertificateDer::pem_file_iter(path).and_then(Iterator::collect);
    read.map_err(|error| unread(path, error))
}

fn unread(path: &std::path::Path, error: impl Display) -> Found {
    Found::Certificate(format!("{}: {error}", path.display()))
}

fn certificate(error: impl Display) -> Found {
    Found::Certificate(error.to_string())
}
