//! Phones and other devices at `/imu`: who may send, what is refused, and what becomes of many at once.

use std::fs;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_rustls::rustls;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::http::StatusCode;
use tokio_tungstenite::tungstenite::{self, Message};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

use super::process::{PATIENCE, Posed, ok, record_start, replays, until};
use super::recordings::FULL;

const SENSOR: &str = "a-token-for-sensors";
const WATCH: &str = "a-token-that-watches";
const OPERATE: &str = "a-token-that-operates";

/// A stage with a phone of each of these ids, and tokens if wished.
fn stage(folder: &Path, ids: &[String], with_tokens: bool) -> std::path::PathBuf {
    use std::fmt::Write;
    let mut text = format!(
        "name = \"hall\"\n[server]\nphones = \"127.0.0.1:0\"\n[[device]]\nname = \"phones\"\ndriver = \"open-imu\"\n\
         port = \"websocket\"\ndevices = {ids:?}\n"
    );
    for (number, id) in (1..).zip(ids) {
        write!(text, "[[sensor]]\nname = \"of {id}\"\ndevice = \"phones\"\naddress = {number}\n").unwrap();
    }
    let tokens = [(SENSOR, "sensor"), (WATCH, "watch"), (OPERATE, "operate")];
    for (secret, role) in tokens.into_iter().filter(|_| with_tokens) {
        write!(text, "[[server.token]]\nsecret = \"{secret}\"\nrole = \"{role}\"\n").unwrap();
    }
    let path = folder.join("stage.toml");
    fs::write(&path, text).unwrap();
    path
}

fn run(stage: &Path) -> Posed {
    Posed::start(["run", stage.to_str().unwrap()])
}

/// A device that speaks the open format, as a browser sends it: 60 samples a second of 0.1 units, four in a block.
pub(crate) struct Emulated {
    id: String,
    socket: WebSocketStream<MaybeTlsStream<TcpStream>>,
    next: u32,
    chance: ChaCha8Rng,
}

impl Emulated {
    pub(crate) async fn connect(address: SocketAddr, query: &str, id: &str) -> Result<Self, StatusCode> {
        let mut request = format!("ws://{address}/imu{query}").into_client_request().unwrap();
        request.headers_mut().insert("sec-websocket-protocol", "imu.v1".parse().unwrap());
        let socket = match connect_async(request).await {
            Ok((socket, _)) => socket,
            Err(tungstenite::Error::Http(answer)) => return Err(answer.status()),
            Err(error) => panic!("{error}"),
        };
        let seed = id.bytes().map(u64::from).sum();
        Ok(Self { id: id.to_owned(), socket, next: 0, chance: ChaCha8Rng::seed_from_u64(seed) })
    }

    pub(crate) async fn send(&mut self, message: Value) {
        self.socket.send(Message::text(message.to_string())).await.unwrap();
    }

    /// The next message that has this key.
    pub(crate) async fn hear(&mut self, key: &str) -> Value {
        let heard = async {
            loop {
                match self.socket.next().await {
                    Some(Ok(Message::Text(text))) => {
                        let message: Value = serde_json::from_str(&text).unwrap();
                        if !message[key].is_null() {
                            return message;
                        }
                    }
                    Some(Ok(Message::Close(frame))) => panic!("{}: no {key}, but {frame:?}", self.id),
                    Some(Ok(_)) => {}
                    other => panic!("{}: no {key}, but {other:?}", self.id),
                }
            }
        };
        tokio::time::timeout(PATIENCE, heard).await.expect("an answer")
    }

    /// The code that it is closed with.
    async fn closed(&mut self) -> u16 {
        let closed = async {
            loop {
                match self.socket.next().await {
                    Some(Ok(Message::Close(Some(frame)))) => return frame.code.into(),
                    Some(Ok(_)) => {}
                    other => panic!("{other:?}"),
                }
            }
        };
        tokio::time::timeout(PATIENCE, closed).await.expect("a close")
    }

    pub(crate) async fn greet(&mut self) -> Value {
        let id = self.id.clone();
        self.send(
            json!({"imu": 1, "id": id, "name": "", "rate": 60, "unit": "us", "bits": 0, "src": "browser"}),
        )
        .await;
        self.hear("ok").await
    }

    /// Four samples of somebody who turns to and fro about z, rounded as browsers do.
    fn block(&mut self) -> Value {
        let rows: Vec<Value> = (0..4)
            .map(|_| {
                let n = self.next;
                self.next += 1;
                let t_s = f64::from(n) / 60.0;
                let (rate_rad_s, angle_rad) = (0.6 * libm::cos(2.0 * t_s), 0.3 * libm::sin(2.0 * t_s));
                let rate_rad_s = (rate_rad_s.to_degrees() * 10.0).round().to_radians() / 10.0;
                let (w, z) = (libm::cos(angle_rad / 2.0), libm::sin(angle_rad / 2.0));
                json!([n, (t_s * 1e6).round(), 0.0, 0.0, rate_rad_s, 0.0, 0.0, 9.8, w, 0.0, 0.0, z])
            })
            .collect();
        json!({"s": 0, "b": rows})
    }

    /// Sends for so many blocks; a share of them gets lost on the way, and each comes when the radio lets it. How many samples were lost.
    #[expect(clippy::disallowed_methods, reason = "a phone sends in real time")]
    pub(crate) async fn stream(&mut self, blocks: usize, loss: f64) -> u32 {
        let begun = tokio::time::Instant::now();
        let (mut lost, mut clear) = (0, begun);
        for block in 0..blocks {
            let message = self.block();
            // The first and the last arrive, so that what lies between is known to be missing.
            if block > 0 && block + 1 < blocks && self.chance.random::<f64>() < loss {
                lost += 4;
                continue;
            }
            let jitter_ms = 5.0 + 75.0 * self.chance.random::<f64>().powi(4);
            let at = begun + Duration::from_secs_f64((block + 1) as f64 * 4.0 / 60.0 + jitter_ms * 1e-3);
            // What is behind another one in the queue does not overtake it.
            clear = clear.max(at);
            tokio::time::sleep_until(clear).await;
            self.send(message).await;
        }
        lost
    }
}

#[tokio::test]
async fn a_token_for_sensors_opens_imu_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let posed = run(&stage(folder.path(), &["p-1".to_owned()], true));
    let connect = async |query: &str| Emulated::connect(posed.address, query, "p-1").await.map(drop);
    assert_eq!(connect(&format!("?k={SENSOR}")).await, Ok(()));
    assert_eq!(connect(&format!("?token={OPERATE}")).await, Ok(()));
    assert_eq!(connect(&format!("?k={WATCH}")).await, Err(StatusCode::FORBIDDEN));
    assert_eq!(connect("?k=another-token-of-nobody").await, Err(StatusCode::UNAUTHORIZED));
    assert_eq!(connect("").await, Err(StatusCode::UNAUTHORIZED));
    let own = fs::read_to_string(folder.path().join("phones/token")).unwrap();
    for token in [SENSOR, &own] {
        let websocket = connect_async(format!("ws://{}/ws?token={token}", posed.address)).await;
        assert!(
            matches!(websocket, Err(tungstenite::Error::Http(answer)) if answer.status().is_client_error())
        );
        for path in ["metrics", "recordings/take-1.mcap", "takes/take-1.mcap/ws"] {
            let answer = posed.get(&format!("/{path}?token={token}")).await;
            assert!(answer.starts_with("HTTP/1.1 4"), "{path}: {answer}");
        }
    }
    // Pages of others may not, whatever they know.
    let mut request = format!("ws://{}/imu?k={SENSOR}", posed.address).into_client_request().unwrap();
    request.headers_mut().insert("origin", "https://evil.example".parse().unwrap());
    let refused = connect_async(request).await;
    assert!(
        matches!(refused, Err(tungstenite::Error::Http(answer)) if answer.status() == StatusCode::FORBIDDEN)
    );
}

#[tokio::test]
async fn what_is_no_imu_is_refused_and_a_flood_is_closed() {
    let folder = tempfile::tempdir().unwrap();
    let posed = run(&stage(folder.path(), &["p-1".to_owned()], false));
    let mut good = Emulated::connect(posed.address, "", "p-1").await.unwrap();
    good.greet().await;
    let mut other = Emulated::connect(posed.address, "", "p-2").await.unwrap();
    other.socket.send(Message::binary(vec![1, 2, 3])).await.unwrap();
    assert_eq!(other.hear("err").await["err"], "bad_type");
    for _ in 0..3 {
        other.socket.send(Message::binary(vec![1, 2, 3])).await.unwrap();
    }
    assert_eq!(other.closed().await, 1008);
    let mut large = Emulated::connect(posed.address, "", "p-3").await.unwrap();
    large.socket.send(Message::text(" ".repeat(20_000))).await.unwrap();
    assert_eq!(large.closed().await, 1009);
    let mut flood = Emulated::connect(posed.address, "", "p-4").await.unwrap();
    flood.greet().await;
    let flooding = async {
        for n in 0..10_000 {
            let sample = json!({"n": n, "t": n, "g": [0, 0, 0]}).to_string();
            if flood.socket.feed(Message::text(sample)).await.is_err() {
                break;
            }
        }
        let _ = flood.socket.flush().await;
    };
    flooding.await;
    assert_eq!(flood.closed().await, 1008);
    // The one beside them has noticed nothing.
    good.send(json!({"ping": 5})).await;
    assert_eq!(good.hear("pong").await["pong"], 5);
}

/// A GET over TLS, by who trusts this authority.
async fn get_trusting(authority: &Path, address: &str, path: &str) -> std::io::Result<String> {
    let mut roots = rustls::RootCertStore::empty();
    roots.add(rustls::pki_types::CertificateDer::from_pem_file(authority).unwrap()).unwrap();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let client = rustls::ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    let name = address.split(':').next().unwrap().to_owned().try_into().unwrap();
    let tcp = TcpStream::connect(address).await?;
    let mut stream = tokio_rustls::TlsConnector::from(Arc::new(client)).connect(name, tcp).await?;
    stream.write_all(format!("GET {path} HTTP/1.1\r\nHost: {address}\r\n\r\n").as_bytes()).await?;
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer).await;
    // The certificate is no text.
    Ok(String::from_utf8_lossy(&answer).into_owned())
}

#[tokio::test]
async fn phones_come_over_tls_to_an_address_that_has_nothing_else_and_stays_when_the_stage_changes() {
    let folder = tempfile::tempdir().unwrap();
    let posed = run(&stage(folder.path(), &["p-1".to_owned()], false));
    let mut client = posed.client().await;
    let invitation = ok(&mut client, json!({"type": "phone.invite"})).await;
    let page = invitation["page"].as_str().unwrap().to_owned();
    let address = page.strip_prefix("https://").unwrap().split('/').next().unwrap().to_owned();
    assert!(page.contains("/phone#k=") && invitation["qr"]["width"].as_u64().unwrap() > 20, "{invitation}");
    assert_eq!(invitation["fingerprint"].as_str().unwrap().len(), 95);
    let authority = folder.path().join("phones/authority.pem");
    let get = async |path: &str| get_trusting(&authority, &address, path).await.unwrap();
    assert!(get("/phone").await.starts_with("HTTP/1.1 200"));
    assert!(get("/phone/authority.crt").await.starts_with("HTTP/1.1 200"));
    for path in ["/ws", "/metrics", "/health", "/recordings/a.mcap", "/takes/a.mcap/"] {
        assert!(get(path).await.starts_with("HTTP/1.1 404"), "{path}");
    }
    // Without a token nobody sends there, though the stage has none.
    let upgrade = "/imu HTTP/1.1\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
                   Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nX-Rest:";
    assert!(get(upgrade).await.starts_with("HTTP/1.1 401"));
    // Browsers leave at a certificate that they do not know, for each file of the page, and come again once somebody lets them.
    for _ in 0..20 {
        let stranger = folder.path().join("stranger.pem");
        fs::write(&stranger, rcgen::generate_simple_self_signed(Vec::new()).unwrap().cert.pem()).unwrap();
        assert!(get_trusting(&stranger, &address, "/phone").await.is_err());
    }
    assert!(get("/phone").await.starts_with("HTTP/1.1 200"));
    let revision = ok(&mut client, json!({"type": "setup.read"})).await["revision"].clone();
    let changes = json!([{"change": "name_stage", "name": "other"}]);
    ok(&mut client, json!({"type": "setup.save", "changes": changes, "revision": revision})).await;
    assert_eq!(client.closed().await.0, 1012);
    let mut client = posed.client().await;
    assert_eq!(ok(&mut client, json!({"type": "phone.invite"})).await["page"], page);
    assert!(get("/phone").await.starts_with("HTTP/1.1 200"));
}

#[tokio::test(flavor = "multi_thread")]
async fn many_phones_stream_at_once_what_the_radio_loses_is_counted_and_the_recording_replays() {
    let folder = tempfile::tempdir().unwrap();
    let ids: Vec<String> = (0..6).map(|n| format!("p-{n}")).collect();
    let path = stage(folder.path(), &ids, false);
    fs::write(&path, fs::read_to_string(&path).unwrap() + FULL).unwrap();
    let posed = run(&path);
    let mut client = posed.subscriber(&["status"]).await;
    ok(&mut client, record_start("phones")).await;
    let mut streaming = Vec::new();
    for id in ids.clone() {
        let address = posed.address;
        streaming.push(tokio::spawn(async move {
            let mut phone = Emulated::connect(address, "", &id).await.unwrap();
            phone.greet().await;
            let lost = phone.stream(75, 0.02).await;
            (phone.next - lost, lost, phone)
        }));
    }
    let mut sent = Vec::new();
    for phone in streaming {
        sent.push(phone.await.unwrap());
    }
    let all: Vec<(u64, u64)> =
        sent.iter().map(|(came, lost, _)| (u64::from(*came), u64::from(*lost))).collect();
    assert!(all.iter().any(|(_, lost)| *lost > 0), "{all:?}");
    let counts = |status: &Value, key: &str| -> Option<Vec<u64>> {
        status["sensors"].as_array()?.iter().map(|sensor| sensor[key].as_u64()).collect()
    };
    let came: Vec<u64> = all.iter().map(|(came, _)| *came).collect();
    let status =
        until(&mut client, "all samples", |message| counts(message, "samples").as_ref() == Some(&came)).await;
    let lost: Vec<u64> = all.iter().map(|(_, lost)| *lost).collect();
    assert_eq!(counts(&status, "missed"), Some(lost));
    // Each gets what the stage thinks of it.
    let (_, _, phone) = &mut sent[0];
    let thought = phone.hear("stage").await;
    assert_eq!((&thought["stage"]["sensor"], &thought["stage"]["name"]), (&json!("of p-0"), &json!("hall")));
    // What waits for it is older.
    let mut lost = thought["stage"]["lost"].clone();
    while lost != all[0].1 {
        lost = phone.hear("stage").await["stage"]["lost"].clone();
    }
    // Whoever looks for it has it blink.
    ok(&mut client, json!({"type": "phone.blink", "phone_id": "p-0"})).await;
    assert_eq!(phone.hear("blink").await["blink"], true);
    let refused = client.ask(json!({"type": "phone.blink", "phone_id": "p-9"})).await;
    assert_eq!(refused["code"], "not_connected", "{refused}");
    ok(&mut client, json!({"type": "record.stop"})).await;
    replays(&folder.path().join("recordings/phones.mcap"));
}
